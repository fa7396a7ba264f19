"""Whether a .mat file of version 5 is what it says, before it is read.

The reader of scipy trusts the sizes and types that such a file states, and a damaged one can end the whole process.
This walk through the elements (MathWorks, "MAT-File Format", 2019) refuses every file whose sizes and types contradict
each other.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from navfilter.io.trust import Allowance

_HEADER = 128
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF8 = 1, 5, 6, 14, 15, 16
#: Bytes of one number, by the type of the element that holds it.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
_CHARACTERS = {1: 1, 2: 1, 4: 2, 16: 1, 17: 2, 18: 4}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_DEEPEST = 30


class _Damaged(ValueError):
    """What the file says of itself is not so."""


def check_mat5(path: Path, allowance: Allowance | None = None) -> None:
    """Walk through a .mat file of version 5; one of version 4 passes, its reader trusts nothing.

    Parameters
    ----------
    path : Path
        A file that is not empty.
    allowance : Allowance, optional
        What it may unpack to.

    Raises
    ------
    ValueError
        When sizes or types contradict each other, or it unpacks to more than is allowed.
    """
    data = memoryview(path.read_bytes())
    head = bytes(data[:_HEADER])
    if 0 in head[:4]:
        return
    if len(head) < _HEADER or head[126:128] not in (b"IM", b"MI"):
        raise _Damaged("it has no header of a .mat file")
    _variables(data[_HEADER:], "<" if head[126:128] == b"IM" else ">", allowance or Allowance())


def _unpacked(body: memoryview, allowance: Allowance) -> memoryview:
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(body, allowance.left + 1)
    except zlib.error as error:
        raise _Damaged(f"a compressed variable cannot be unpacked ({error})") from None
    allowance.take(len(data))
    if not unpacker.eof:
        raise _Damaged("a compressed variable cannot be unpacked (it is truncated)")
    return memoryview(data)


def _variables(view: memoryview, order: str, allowance: Allowance) -> None:
    at = 0
    while at < len(view):
        if len(view) - at < 8:
            raise _Damaged("it ends inside a variable")
        kind, size = struct.unpack_from(f"{order}II", view, at)
        body = view[at + 8 : at + 8 + size]
        if size == 0 or len(body) < size:
            raise _Damaged("it ends inside a variable")
        if kind == _COMPRESSED:
            elements = list(_elements(_unpacked(body, allowance), order))
            if len(elements) != 1:
                raise _Damaged("a compressed variable is not one matrix")
            kind, body = elements[0]
        if kind != _MATRIX:
            raise _Damaged(f"a variable is of type {kind}, not a matrix")
        _matrix(body, order, 0)
        at += 8 + size


def _elements(view: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element inside a matrix."""
    at = 0
    while at < len(view):
        if len(view) - at < 8:
            raise _Damaged("it ends inside an element")
        kind, size = struct.unpack_from(f"{order}II", view, at)
        if kind >> 16:
            # A small element: its size stands beside its type, and its content where the size would be.
            kind, size, begin, whole = kind & 0xFFFF, kind >> 16, at + 4, 8
            if size > 4:
                raise _Damaged("a small element has more than four bytes")
        else:
            begin, whole = at + 8, 8 + size + (-size % 8 if kind != _MATRIX else 0)
        if begin + size > len(view):
            raise _Damaged("an element is longer than its matrix")
        yield kind, view[begin : begin + size]
        at += whole


def _matrix(body: memoryview, order: str, depth: int) -> None:
    if depth > _DEEPEST:
        raise _Damaged("matrices are nested too deeply")
    if not len(body):
        return  # an empty cell
    elements = _elements(body, order)
    flags = _next(elements, {_UINT32}, "flags")
    if len(flags) != 8:
        raise _Damaged("a matrix has no flags")
    word = struct.unpack_from(f"{order}I", flags)[0]
    kind, is_complex = word & 0xFF, bool(word & 0x800)
    if kind == _OPAQUE:
        for part, content in elements:
            if part == _MATRIX:
                _matrix(content, order, depth + 1)
        return
    count = _count(_next(elements, {_INT32}, "dimensions"), order)
    _next(elements, {_INT8}, "name")
    if kind in (_CELL, _STRUCT, _OBJECT, _FUNCTION):
        _nested(kind, count, elements, order, depth)
    elif kind == _CHAR:
        _text(count, elements)
    elif kind == _SPARSE:
        for what in ("rows", "columns", *(("values",) * (1 + is_complex))):
            _next(elements, set(_SIZES), what)
    elif 6 <= kind <= 15:
        for what in ("values", "imaginary values")[: 1 + is_complex]:
            _numbers(count, elements, what)
    else:
        raise _Damaged(f"a matrix is of the unknown class {kind}")


def _next(elements: Iterator[tuple[int, memoryview]], kinds: set[int], what: str) -> memoryview:
    kind, content = next(elements, (0, memoryview(b"")))
    if kind not in kinds:
        raise _Damaged(f"the {what} of a matrix are of type {kind}")
    if kind in _SIZES and len(content) % _SIZES[kind]:
        raise _Damaged(f"the {what} of a matrix end inside a number")
    return content


def _count(content: memoryview, order: str) -> int:
    dimensions = struct.unpack(f"{order}{len(content) // 4}i", content)
    if not 2 <= len(dimensions) <= 32 or min(dimensions) < 0:
        raise _Damaged(f"a matrix has the dimensions {dimensions[:4]}")
    return math.prod(dimensions)


def _nested(kind: int, count: int, elements: Iterator[tuple[int, memoryview]], order: str, depth: int) -> None:
    if kind == _FUNCTION:
        count = 1
    if kind == _OBJECT:
        _next(elements, {_INT8}, "class name")
    if kind in (_STRUCT, _OBJECT):
        length = struct.unpack(
            f"{order}i", _next(elements, {_INT32}, "length of field names")[:4].tobytes().ljust(4, b"\0")
        )[0]
        names = _next(elements, {_INT8}, "field names")
        if length <= 0 or len(names) % length:
            raise _Damaged("the field names of a structure have no length")
        count *= len(names) // length
    found = 0
    for part, content in elements:
        if part != _MATRIX:
            raise _Damaged(f"an element of a cell or structure is of type {part}, not a matrix")
        _matrix(content, order, depth + 1)
        found += 1
    if found != count:
        raise _Damaged(f"a cell or structure has {found} elements instead of {count}")


def _text(count: int, elements: Iterator[tuple[int, memoryview]]) -> None:
    kind, content = next(elements, (0, memoryview(b"")))
    if kind not in _CHARACTERS or len(content) % _CHARACTERS[kind]:
        raise _Damaged(f"text is of type {kind}")
    length = len(content) // _CHARACTERS[kind]
    if kind == _UTF8:
        length = len(content.tobytes().decode("utf-8", "replace"))
    if length != count:
        raise _Damaged(f"text has {length} characters instead of {count}")


def _numbers(count: int, elements: Iterator[tuple[int, memoryview]], what: str) -> None:
    kind, content = next(elements, (0, memoryview(b"")))
    if kind not in _SIZES or len(content) != count * _SIZES[kind]:
        raise _Damaged(f"the {what} of a matrix are {len(content)} bytes of type {kind} for {count} numbers")

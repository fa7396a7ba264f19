"""A store of vectors that stays in memory while it is small, and goes to a temporary file when it is not, so that a
day-long mission needs no more memory than an hour.
"""

from __future__ import annotations

import bisect
import contextlib
import itertools
import mmap
import tempfile
import weakref
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array, Ints

#: Bytes of memory that are asked for at a time: sixteen huge pages, which a system clears ten times as quickly as as
#: much memory in small ones.
BLOCK, PAGE = 32 << 20, 2 << 20
#: So many bytes are kept for the next run, at most: an hour at 100 Hz with its rows needs 142 MB. Memory that is new to
#: a virtual machine takes 1 to 2 s per GB there, as long as all else that is done with it.
KEPT = 256 << 20
_idle: list[mmap.mmap] = []


def _block(size: int) -> Array:
    """A piece of memory for so many elements at least, which is used again when nobody looks at it any more."""
    needed = -(-8 * size // PAGE) * PAGE
    block = None
    for idle in sorted(_idle, key=len):
        if 4 * needed <= 4 * len(idle) <= 5 * needed:  # none that is much too large: who needs that would miss it
            with contextlib.suppress(ValueError):  # another thread has taken it
                _idle.remove(idle)
                block = idle
                break
    if block is None:
        private = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
        block = mmap.mmap(-1, needed, **private)
        if hasattr(mmap, "MADV_HUGEPAGE"):
            with contextlib.suppress(OSError):  # a kernel without them
                block.madvise(mmap.MADV_HUGEPAGE)
    array = np.frombuffer(block)
    weakref.finalize(array, _left, block).atexit = False
    return array


def _left(block: mmap.mmap) -> None:
    if len(block) + sum(map(len, _idle)) <= KEPT:
        if hasattr(mmap, "MADV_FREE"):  # the system may take it as soon as it is short of memory
            block.madvise(mmap.MADV_FREE)
        _idle.append(block)


class RecordStore:
    """Append-only store of float64 vectors, in memory up to `memory_bytes`; beyond that all but the latest go to a
    temporary file. What it gives out are views, to be used before the next one is asked for.

    Parameters
    ----------
    memory_bytes : int
    chunk : int
        So many elements are to stand in one piece.

    Raises
    ------
    OSError
        When the temporary file cannot be written (disk full).
    """

    CHUNK = 1 << 18  # 2 MiB of float64

    def __init__(self, memory_bytes: int, chunk: int = 0) -> None:
        self._chunk_size = max(self.CHUNK, chunk)
        self._keep = max(2, memory_bytes // (8 * self._chunk_size))
        self._block = np.empty(0)  # room for the next chunks
        self._chunks: list[Array | None] = []
        self._firsts: list[int] = []  # number of the first vector of each chunk
        self._sizes = array("i")  # a flat array: a day has millions of vectors
        self._end = 0
        self._file: Any = None
        self._written: list[tuple[int, int]] = []  # of each chunk in the file: where, and how many elements
        self._loaded: tuple[int, Array] = -1, np.empty(0)

    def __len__(self) -> int:
        return len(self._sizes)

    def new(self, size: int) -> Array:
        """A writable view of `size` elements, appended."""
        self._make_room(size)
        self._sizes.append(size)
        self._end += size
        return self[-1]

    def tail(self, size: int, last: bool = False) -> tuple[Array, bool]:
        """Where the next vectors may be written, this size of them at least (`took` says which are); with the last one
        before them where that is wanted, has this size, and stands there.
        """
        self._make_room(size)
        held = last and len(self) > self._firsts[-1] and self._sizes[-1] == size
        chunk = self._chunks[-1]
        assert chunk is not None
        return chunk[self._end - (size if held else 0) :], held

    def took(self, sizes: Ints) -> None:
        """Vectors of these sizes have been written one behind the other at the beginning of what is free."""
        self._sizes.frombytes(sizes.astype(np.intc).tobytes())
        self._end += int(sizes.sum())

    def extend(self, flat: Array, sizes: Ints) -> None:
        """Append vectors of these sizes that stand one behind the other in `flat`."""
        ends = np.cumsum(sizes)
        done = 0
        while done < len(sizes):
            begin = int(ends[done] - sizes[done])
            if not self._room(int(sizes[done])):
                self.new(int(sizes[done]))[:] = flat[begin : int(ends[done])]
                done += 1
                continue
            chunk = self._chunks[-1]
            assert chunk is not None
            last = int(np.searchsorted(ends, begin + len(chunk) - self._end, side="right"))
            size = int(ends[last - 1]) - begin
            chunk[self._end : self._end + size] = flat[begin : begin + size]
            self.took(sizes[done:last])
            done = last

    def drop(self) -> None:
        """Forget the last vector."""
        size = self._sizes.pop()
        if self._firsts[-1] <= len(self):
            self._end -= size
        else:  # it stood in a chunk before, and the last one is empty
            self._firsts = [min(first, len(self)) for first in self._firsts]

    def _room(self, size: int) -> bool:
        """Whether one more vector goes into the last chunk."""
        return bool(self._chunks) and self._end + size <= len(self._chunks[-1])  # type: ignore[arg-type]

    def _make_room(self, size: int) -> None:
        if not self._room(size):
            self._chunks.append(self._buffer(max(self._chunk_size, size)))
            self._firsts.append(len(self))
            self._end = 0

    def _buffer(self, size: int) -> Array:
        """For the next chunk. Once there is a file, that of the last but one, which goes there."""
        if self._file is None and len(self._chunks) >= self._keep:
            self.to_file()
        elif self._file is not None and len(self._chunks) > 1 and self._chunks[-2] is not None:
            chunk = self._stored(len(self._chunks) - 2)
            return chunk if len(chunk) == size else np.empty(size)
        if self._file is not None:
            return np.empty(size)
        if len(self._block) < size:
            self._block = _block(size if self._chunk_size > self.CHUNK else max(size, BLOCK // 8))
        chunk, self._block = self._block[:size], self._block[size:]
        return chunk

    @property
    def in_file(self) -> bool:
        """Whether all but the latest go to a file."""
        return self._file is not None

    def to_file(self) -> None:
        """From now on all but the latest go to a file, as if they were more than are to be in memory."""
        self._file = tempfile.TemporaryFile(prefix="navfilter-")  # noqa: SIM115  (lives as long as the spool)
        weakref.finalize(self, self._file.close)
        for number in range(len(self._chunks) - 1):
            self._stored(number)
        self._chunks[-1:] = [chunk.copy() for chunk in self._chunks[-1:] if chunk is not None]
        self._block = np.empty(0)
        _idle.clear()  # a long run needs its memory for other things

    def _stored(self, number: int) -> Array:
        """Where a chunk stood that goes to the file; all before it are there."""
        chunk, self._chunks[number] = self._chunks[number], None
        assert chunk is not None
        at = sum(self._written[-1]) if self._written else 0
        self._file.seek(8 * at)
        self._file.write(chunk)
        self._written.append((at, len(chunk)))
        return chunk

    def __getitem__(self, index: int) -> Array:
        index = index if index >= 0 else len(self) + index
        number, size = bisect.bisect_right(self._firsts, index) - 1, self._sizes[index]
        last = index == len(self) - 1 and number == len(self._chunks) - 1
        begin = self._end - size if last else sum(self._sizes[self._firsts[number] : index])
        return self._chunk(number)[begin : begin + size]

    def run(self, first: int, last: int) -> tuple[Array, Ints]:
        """Vectors before the one of number `last`, back to number `first` or as far as they stand in one piece: the
        array in which they stand, and where each of them begins.
        """
        if first >= last:
            return np.empty(0), np.empty(0, np.int64)
        number = bisect.bisect_right(self._firsts, last - 1) - 1
        begin = self._firsts[number]
        sizes = np.array(self._sizes[begin:last], np.int64)
        return self._chunk(number), (np.cumsum(sizes) - sizes)[max(first - begin, 0) :]

    def pieces(self, count: int) -> Iterator[tuple[Array, Ints]]:
        """The first so many vectors, as `extend` takes them."""
        for number, (first, end) in enumerate(itertools.pairwise([*self._firsts, len(self)])):
            sizes = np.array(self._sizes[first : min(end, count)], np.int64)
            if len(sizes):
                yield self._chunk(number)[: sizes.sum()], sizes

    def _chunk(self, number: int) -> Array:
        chunk = self._chunks[number]
        if chunk is not None:
            return chunk
        if self._loaded[0] != number:
            at, size = self._written[number]
            self._loaded = number, self._loaded[1] if len(self._loaded[1]) == size else np.empty(size)
            self._file.seek(8 * at)
            self._file.readinto(self._loaded[1])
        return self._loaded[1]

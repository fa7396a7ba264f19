"""What users hand over: made into what the rest works on where it comes in, or refused in words."""

import math
from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def numbers(values: ArrayLike, owner: str) -> NDArray[np.float64]:
    """What users hand over as an array of float64, without a copy where it is one; masked values are NaN.

    Raises
    ------
    ValueError
        For what is no array of numbers; it names the `owner`.

    Examples
    --------
    >>> numbers(np.ma.masked_array([1, 2], [False, True]), "value").tolist()
    [1.0, nan]
    >>> numbers(["a"], "value")
    Traceback (most recent call last):
    ...
    ValueError: value must be real numbers, found ['a'].
    """
    try:
        if isinstance(values, np.ma.MaskedArray):
            return np.where(np.ma.getmaskarray(values), math.nan, np.ma.getdata(values).astype(np.float64))
        if np.asarray(values).dtype.kind in "fiubOUS":  # neither dates nor complex numbers, which NumPy converts too
            return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{owner} must be real numbers, found {short(values)}.")


def needs(owner: str, value: object, *kinds: type, hint: str = "") -> None:
    """Refuse what is of another class than a caller needs, in words.

    Raises
    ------
    ValueError

    Examples
    --------
    >>> needs("replay: mission", 3, dict, hint="Read one by nf.read_mission(path).")
    Traceback (most recent call last):
    ...
    ValueError: replay: mission must be a dict, found 3. Read one by nf.read_mission(path).
    """
    if isinstance(value, kinds):
        return
    wanted = " or ".join(_WORDS.get(kind, _one(kind)) for kind in kinds)
    named = isinstance(value, str | int | float | type(None))
    found = short(value) if named else f"the class {value.__name__}" if isinstance(value, type) else _one(type(value))
    raise ValueError(f"{owner} must be {wanted}, found {found}.{hint and f' {hint}'}")


#: What is not called by the name of its class.
_WORDS: dict[type, str] = {str: "text", bytes: "bytes", PathLike: "a path", Mapping: "a dict", type(None): "None"}


def _one(kind: type) -> str:
    return f"{'an' if kind.__name__[0] in 'AEIOUn' else 'a'} {kind.__name__}"


def intervals(pairs: Any, owner: str) -> tuple[tuple[float, float], ...]:
    """Pairs of times [s] as floats.

    Raises
    ------
    ValueError
        For what is none; it names the `owner`.
    """
    try:
        if all(isinstance(t, int | float | np.integer | np.floating) for a, b in pairs for t in (a, b)):
            return tuple((float(a), float(b)) for a, b in pairs)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{owner} takes pairs of mission times (t0_s, t1_s) in seconds, found {short(pairs)}.")


def within(time_s: NDArray[np.float64], windows: Iterable[tuple[float, float]]) -> NDArray[np.bool_]:
    """Which times lie in one of the closed intervals."""
    found = np.zeros(len(time_s), dtype=bool)
    for begin_s, end_s in windows:
        found |= (time_s >= begin_s) & (time_s <= end_s)
    return found


def rows_of(rows: Any) -> Any:
    """What picks rows, one of them too: a mask, a slice or indices.

    Raises
    ------
    ValueError
        For what picks none.
    """
    if isinstance(rows, slice):
        return rows
    picked = np.atleast_1d(rows)
    if picked.size and picked.dtype.kind not in "biu":
        raise ValueError(f"keep takes a mask, a slice or indices of rows, found {short(rows)}.")
    return picked if picked.size else picked.astype(int)


def short(value: object) -> str:
    """What was found, for a message."""
    text = " ".join(repr(value).split())
    return text if len(text) < 100 else f"{text[:90]} ... ({type(value).__name__})"

"""How descriptions and results show themselves: as text at a prompt and in a debugger, as a small table of HTML in a
notebook, both by the same title and rows; and when two of them are equal.
"""

import dataclasses
import re
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The plural that a phrase begins with, be it the second word: its singular, and what it has beyond that.
_PLURAL = re.compile(r"((?:\w+ )??\w+?)(?:(?<=x)e)?s\b")


def card(title: str, rows: Mapping[str, object]) -> str:
    """A titled table of two columns; all text is escaped, rows that are None are left out.

    Examples
    --------
    >>> card("Track", {"rows": 3, "UTC": None})
    '<table><caption>Track</caption><tr><th>rows</th><td>3</td></tr></table>'
    """
    cells = (
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in rows.items()
        if value is not None
    )
    return f"<table><caption>{escape(title)}</caption>{''.join(cells)}</table>"


def lines(title: str, rows: Mapping[str, object]) -> str:
    """The same as text: the title, and a line each.

    Examples
    --------
    >>> print(lines("Track", {"rows": 3, "UTC": None, "travelled": "12 m"}))
    Track
      rows       3
      travelled  12 m
    """
    there = {name: str(value) for name, value in rows.items() if value is not None}
    wide = max(map(len, there), default=0)
    return "\n".join([title, *(f"  {name:{wide}}  {value}" for name, value in there.items())])


def counted(count: int, what: str) -> str:
    """So many things; `what` begins with their plural.

    Examples
    --------
    >>> counted(2, "rows cut short"), counted(1, "rows cut short"), counted(1, "infinite values"), counted(1, "fixes")
    ('2 rows cut short', '1 row cut short', '1 infinite value', '1 fix')
    """
    if count == 1 and (plural := _PLURAL.match(what)):
        what = plural[1] + what[plural.end() :]
    return f"{count} {what}"


def often(time_s: NDArray[np.float64], rows: str) -> str:
    """How many rows there are, and how often, in words.

    Examples
    --------
    >>> often(np.array([1.0, 1.5, 2.0]), "readings"), often(np.zeros(0), "rows")
    ('3 readings, 2 Hz', '0 rows')
    """
    span_s = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    return f"{len(time_s)} {rows}" + (f", {(len(time_s) - 1) / span_s:.3g} Hz" if span_s > 0.0 else "")


def few(values: NDArray[np.float64]) -> str:
    """Numbers with as many digits as one reads.

    Examples
    --------
    >>> few(np.array([0.123456, -20.0]))
    '0.1235, -20'
    """
    return ", ".join(f"{value:.4g}" for value in values)


def span(time_s: NDArray[np.float64]) -> str:
    """From when to when, in words; nothing of no times."""
    return f", {time_s[0]:.1f} to {time_s[-1]:.1f} s" if len(time_s) else ""


class Shown:
    """What shows itself by a title and rows; a dataclass of it is made with ``repr=False``."""

    def _shown(self) -> tuple[str, dict[str, object]]:
        raise NotImplementedError

    def __repr__(self) -> str:
        try:
            return lines(*self._shown())
        except AttributeError:  # a debugger looks at values that are not finished
            return object.__repr__(self)

    def _repr_html_(self) -> str:
        return card(*self._shown())


class Value(Shown):
    """A frozen dataclass of arrays, made with ``eq=False, repr=False``: equal to one of its class with the same
    numbers.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return same(self, other)

    def __hash__(self) -> int:
        # shapes alone: large ones are hardly ever keys, and those of one shape are then told apart by their numbers
        return hash(tuple(getattr(value, "shape", ()) for value in vars(self).values()))


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal, to the last bit and with NaN where the other has it: arrays, and what holds some.

    Examples
    --------
    >>> same({"x": np.array([1.0, np.nan])}, {"x": np.array([1.0, np.nan])}), same(np.zeros(2), np.zeros(3))
    (True, False)
    """
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return type(one) is type(other) and np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if isinstance(one, list | tuple):
        return type(one) is type(other) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if dataclasses.is_dataclass(one) and type(one) is type(other):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one) if f.compare)
    return bool(one == other) or (isinstance(one, float) and one != one and other != other)

"""Columns of one file or of one topic of a log: what every reader hands over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from navfilter.models.mission import MissionError

__all__ = ["BLANK", "Table", "listing"]

Array = npt.NDArray[np.float64]

#: Texts that say that there is no value.
BLANK = ("", "nan", "na", "n/a", "null", "none")


@dataclass(frozen=True)
class Table:
    """Columns of one file, by name or by position.

    Parameters
    ----------
    path : str
        Where the columns come from, for messages.
    columns : dict of str to ndarray
        Arrays of equal or unequal length, in file order.
    notes : tuple of str
        What had to be skipped.
    units : dict of str to str
        Units of columns where the file itself says so; they hold where the mapping says nothing.
    quoted : bool
        Whether messages may show what is written in the file.
    clock : str
        What `log_time` counts by where that is not UTC, see `navfilter.io.logs.topic_names`.
    """

    path: str
    columns: Mapping[str, npt.NDArray[Any]]
    notes: tuple[str, ...] = field(default=())
    units: Mapping[str, str] = field(default_factory=dict)
    quoted: bool = True
    clock: str = ""

    def raw(self, reference: str | int) -> npt.NDArray[Any]:
        """A column as it stands in the file (numbers or text); reference is its name or its 0-based position."""
        names = list(self.columns)
        if isinstance(reference, int):
            if not -len(names) <= reference < len(names):
                raise MissionError(
                    f"{self.path}: there is no column {reference}, the file has {len(names)} (0 to {len(names) - 1})."
                    " If each row is a quantity, set transpose = true."
                )
            return self.columns[names[reference]]
        if reference not in self.columns:
            known = listing("columns", names, self.quoted)
            raise MissionError(f'{self.path}: there is no column "{reference}" ({known}).')
        return self.columns[reference]

    def joined(self, reference: str | int | tuple[str | int, ...]) -> npt.NDArray[Any]:
        """A column, or the texts of several with a blank between, row by row: a date and its time, a number and its
        letter.
        """
        if not isinstance(reference, tuple):
            return self.raw(reference)
        cells = zip(*(self.raw(one) for one in reference), strict=True)
        return np.array([" ".join(str(cell).strip() for cell in row) for row in cells], dtype=object)

    def first_strange(self, reference: str | int) -> str:
        """The first cell that is neither a number nor blank, with its row: for messages."""
        values, _ = self.numbers(reference)
        cells = zip(self.raw(reference).tolist(), np.isnan(values).tolist(), strict=True)
        row, cell = next((k, c) for k, (c, bad) in enumerate(cells) if bad and str(c).strip().lower() not in BLANK)
        return f'"{str(cell)[:40]}" in row {row + 1} of {reference}' if self.quoted else f"row {row + 1}"

    def numbers(self, reference: str | int) -> tuple[Array, int]:
        """A column as float64 with NaN for what is no number, and how many cells were text that is no number."""
        raw = self.raw(reference)
        if raw.dtype.kind in "fiub":
            return raw.astype(np.float64), 0
        import pandas as pd

        def coerced(cells: Any) -> Array:
            column = pd.to_numeric(pd.Series(cells, dtype=object), errors="coerce")
            return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan))

        try:
            values = coerced(raw)
        except OverflowError:  # an integer of hundreds of digits, which is infinite like the same with an exponent
            values = coerced([_finite_or_infinite(cell) for cell in raw])
        wrong = [isinstance(cell, str) and cell.strip().lower() not in BLANK for cell in raw[np.isnan(values)]]
        return values, sum(wrong)


def _finite_or_infinite(cell: Any) -> Any:
    """The cell, or infinity with its sign where it is an integer, or the text of one, beyond all floats."""
    try:
        float(cell)
    except OverflowError:
        return math.inf if cell > 0 else -math.inf
    except (TypeError, ValueError):
        return cell
    return float(cell) if isinstance(cell, str) and cell.strip().lstrip("+-").isdecimal() else cell


def listing(what: str, names: list[str], quoted: bool = True, most: int = 40) -> str:
    """The first names in quotes, and how many more there are; of a file that is not quoted only their number."""
    if not quoted:
        return f"{len(names)} {what}, not shown: the file lies outside the folder of the mission"
    shown = ", ".join(f'"{name}"' for name in names[:most])
    return f"{what}: {shown or 'none'}" + (f" and {len(names) - most} more" if len(names) > most else "")

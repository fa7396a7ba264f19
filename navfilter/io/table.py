"""Columns of one file or of one topic of a log: what every reader hands over."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import Field, field_validator, model_validator

from navfilter.foundation.arrays import AnyArray, Array, Mask
from navfilter.io.validation import Strict
from navfilter.models.mission import MissionError

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
    columns: Mapping[str, AnyArray]
    notes: tuple[str, ...] = field(default=())
    units: Mapping[str, str] = field(default_factory=dict)
    quoted: bool = True
    clock: str = ""

    def raw(self, reference: str | int) -> AnyArray:
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

    def name_of(self, reference: str) -> str:
        """Name of a column given by its name or, as text, by its position."""
        if reference not in self.columns and reference.lstrip("-").isdecimal():
            self.raw(int(reference))
            return list(self.columns)[int(reference)]
        self.raw(reference)
        return reference

    def joined(self, reference: str | int | tuple[str | int, ...]) -> AnyArray:
        """A column, or the texts of several with a blank between, row by row: a date and its time, a number and its
        letter.
        """
        if not isinstance(reference, tuple) or len(reference) == 1:
            return self.raw(reference[0] if isinstance(reference, tuple) else reference)
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


class Where(Strict):
    """One condition on one column; exactly one of the four keys beside `column`.

    Parameters
    ----------
    column : str or int
        Name or position of the column.
    equals : str, bool, float or a list of them
        The row counts where the cell is (one of) this; text is compared without the blanks around it.
    at_least, at_most : float
        The row counts where the number is known and not below, not above this.
    known : bool
        True: the row counts where the cell is a finite number, or text that is not empty.
    """

    column: str | int
    equals: str | bool | float | tuple[str | bool | float, ...] | None = None
    at_least: float | None = None
    at_most: float | None = None
    known: bool | None = None

    @model_validator(mode="after")
    def _one_condition(self) -> "Where":
        if self.equals is None and self.at_least is None and self.at_most is None and self.known is None:
            raise ValueError("give equals, at_least, at_most or known")
        return self

    def rows(self, table: Table) -> Mask:
        """Mask of the rows of a table that fulfil the condition, shape (n,)."""
        keep = np.ones(table.raw(self.column).shape[0], dtype=bool)
        if self.equals is not None:
            choices = self.equals if isinstance(self.equals, tuple) else (self.equals,)
            keep &= np.logical_or.reduce([self._is(table, choice) for choice in choices])
        if self.at_least is not None:
            keep &= table.numbers(self.column)[0] >= self.at_least
        if self.at_most is not None:
            keep &= table.numbers(self.column)[0] <= self.at_most
        if self.known is not None:
            keep &= self._known(table) == self.known
        return keep

    def words(self) -> str:
        """The condition as a note has it: ``velocity_valid = true``."""
        given: list[str] = []
        if self.equals is not None:
            given.append(f"= {_shown(self.equals)}")
        given += [] if self.at_least is None else [f">= {self.at_least:g}"]
        given += [] if self.at_most is None else [f"<= {self.at_most:g}"]
        given += [] if self.known is None else ["known" if self.known else "unknown"]
        return f"{self.column} {' and '.join(given)}"

    def _is(self, table: Table, choice: str | bool | float) -> Mask:
        if isinstance(choice, str):
            return np.array([str(cell).strip() == choice for cell in table.raw(self.column)], dtype=bool)
        raw = table.raw(self.column)
        if isinstance(choice, bool) and raw.dtype.kind in "OUT":
            return np.array([str(cell).strip().lower() == str(choice).lower() for cell in raw], dtype=bool)
        return table.numbers(self.column)[0] == float(choice)

    def _known(self, table: Table) -> Mask:
        raw = table.raw(self.column)
        if raw.dtype.kind in "fiub":
            return np.isfinite(raw.astype(np.float64))
        return np.array([str(cell).strip().lower() not in ("", "nan", "none") for cell in raw], dtype=bool)


class TableOptions(Strict):
    """How a file is laid out; the defaults recognise most files by themselves.

    Parameters
    ----------
    table : str
        Which array of a container (.npz, .mat), such as ``"data.imu"``; an index picks one plane: ``"data[0]"``.
    transpose : bool
        True where each row of the array is a quantity and each column a sample.
    header : bool, tuple of str or None
        Whether a text file has a line of names, or the names themselves; None: a first line without any number is one.
    delimiter : str or None
        ``","``, ``";"``, ``"\\t"``, ``"whitespace"`` or None (recognised from the first line).
    decimal : str or None
        Decimal point or comma; None: a comma where the numbers of the first rows have one and none has a point.
    comment : str
        What begins a line of comment, or a comment behind a whole row; within a cell it is text.
    skip_lines, skip_rows : int
        Lines to skip before the header; rows of data to skip after it.
    topic : str
        Of a log (see `navfilter.io.logs`): which of its topics.
    where : tuple of Where
        Only the rows that fulfil all these conditions.
    """

    table: str = ""
    transpose: bool = False
    header: bool | tuple[str, ...] | None = None
    delimiter: str | None = None
    decimal: str | None = Field(default=None, min_length=1, max_length=1)
    comment: str = "#"
    skip_lines: int = Field(default=0, ge=0)
    skip_rows: int = Field(default=0, ge=0)
    topic: str = ""
    where: tuple[Where, ...] = ()

    @field_validator("where", mode="before")
    @classmethod
    def _single_condition(cls, value: Any) -> Any:
        return [value] if isinstance(value, dict) else value


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return " or ".join(map(_shown, value))
    return str(value).lower() if isinstance(value, bool) else value if isinstance(value, str) else f"{value:g}"

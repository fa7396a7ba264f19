"""Which rows of a table count: the conditions of ``where = {...}``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from navfilter.io.validation import Strict

if TYPE_CHECKING:
    from navfilter.io.table import Table

__all__ = ["Where"]

Bool = npt.NDArray[np.bool_]


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
    def _one_condition(self) -> Where:
        if self.equals is None and self.at_least is None and self.at_most is None and self.known is None:
            raise ValueError("give equals, at_least, at_most or known")
        return self

    def rows(self, table: Table) -> Bool:
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

    def _is(self, table: Table, choice: str | bool | float) -> Bool:
        if isinstance(choice, str):
            return np.array([str(cell).strip() == choice for cell in table.raw(self.column)], dtype=bool)
        raw = table.raw(self.column)
        if isinstance(choice, bool) and raw.dtype.kind in "OUT":
            return np.array([str(cell).strip().lower() == str(choice).lower() for cell in raw], dtype=bool)
        return table.numbers(self.column)[0] == float(choice)

    def _known(self, table: Table) -> Bool:
        raw = table.raw(self.column)
        if raw.dtype.kind in "fiub":
            return np.isfinite(raw.astype(np.float64))
        return np.array([str(cell).strip().lower() not in ("", "nan", "none") for cell in raw], dtype=bool)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return " or ".join(map(_shown, value))
    return str(value).lower() if isinstance(value, bool) else f"{value}"

"""Samples of the drive that a busy computer has stamped when it got round to them: a burst, taken apart again.

A computer that is busy for half a second finds the samples of that time in its buffer, and a driver that stamps on
receipt gives all of them the same instant, or nearly. Taken as they are, one sample stands for half a second and fifty
for none. Their order is right, though, and so is the rate of the unit: they are put a period apart from each other,
behind the sample before the silence, and none of them later than its own stamp.

What tells a burst from samples that are missing is the second sample behind the silence, so the first waits for it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation.state_values import misfit

Array = NDArray[np.float64]


@dataclass
class BurstsMemory:
    """What is remembered.

    Attributes
    ----------
    own_s, given_s : float
        Stamp of the last sample, as it came and as it went on [s].
    first : ndarray, shape (0 or 1, 7)
        A sample behind a silence, which waits for the next.
    spread : bool
        Whether the last sample was of a burst.
    count : int
        Samples that were, so far.
    """

    own_s: float = math.nan
    given_s: float = math.nan
    first: Array = field(default_factory=lambda: np.empty((0, 7)))
    spread: bool = False
    count: int = 0


class Bursts:
    """Stamps of a drive whose samples come in bursts.

    Parameters
    ----------
    period_s : float
        Of the drive.
    longest_s : float
        A longer silence may be another clock, and is left alone [s].
    """

    #: Stamps less than so many periods apart are those of their receipt.
    SHORT_PERIODS = 0.25
    #: A silence is longer than so many periods.
    SILENT_PERIODS = 5.0

    def __init__(self, period_s: float, longest_s: float) -> None:
        self._period_s, self._longest_s = period_s, longest_s
        self.short_s, self.silent_s = self.SHORT_PERIODS * period_s, self.SILENT_PERIODS * period_s
        self.memory = BurstsMemory()

    def take(self, samples: Array) -> Array:
        """The samples that go on now, with the stamps that they should have; changed in place."""
        memory = self.memory
        quiet = not (memory.spread or len(memory.first))
        if quiet and len(samples) == 1 and not (stamp_s := samples.item(0)) - memory.own_s > self.silent_s:
            memory.own_s = memory.given_s = stamp_s
            return samples
        with np.errstate(invalid="ignore"):  # of stamps that are infinite
            steps = np.diff(samples[:, 0], prepend=memory.own_s)
        if quiet and not (steps > self.silent_s).any():
            memory.own_s = memory.given_s = float(samples[-1, 0])
            return samples
        rows: list[Array] = []
        for row, step in zip(samples, steps.tolist(), strict=True):
            received = 0.0 <= step < self.short_s
            if len(memory.first):
                memory.spread = received
                rows.append(self._given(memory.first[0]))
                memory.first = memory.first[:0]
            memory.spread = memory.spread and received
            memory.own_s = float(row[0])
            if self.silent_s < step <= self._longest_s:
                memory.first = row[None, :].copy()
            else:
                rows.append(self._given(row))
        return np.array(rows) if rows else samples[:0]

    def _given(self, row: Array) -> Array:
        memory = self.memory
        if memory.spread:
            row[0] = min(memory.given_s + self._period_s, row[0])
            memory.count += 1
        memory.given_s = float(row[0])
        return row

    def go_on(self, memory: BurstsMemory) -> None:
        """Be where another was.

        Raises
        ------
        ValueError
            For what is no memory of bursts.
        """
        first = memory.first.shape if isinstance(memory.first, np.ndarray) else ()
        if len(first) != 2 or first[0] > 1 or first[1] != 7:
            raise ValueError("what is kept of the drive's bursts has another form")
        if problem := misfit(replace(memory, first=self.memory.first), self.memory, "bursts"):
            raise ValueError(problem)
        self.memory = memory

    def rest(self) -> Array:
        """The sample that still waits when no more comes."""
        first, self.memory.first = self.memory.first, self.memory.first[:0]
        return first

"""The readings of one sensor that have been refused on end, as one value: what a channel remembers of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from navfilter.faults import settings
from navfilter.faults.heading_fault import TrackRotationFit
from navfilter.foundation.chi_square import chi_square_limit

__all__ = ["RejectionRun"]


@dataclass(frozen=True)
class RejectionRun:
    """The readings of one sensor that have been refused on end, seen as one offset.

    Attributes
    ----------
    confirmed : bool
        The sensor had confirmed the state for long, until right before.
    jumped : bool
        It had, and was far beyond its gate at once.
    first, offset, variance : tuple of float
        Residual of the first of them; by how much they are off, and the variance of that, per axis; NaN where missing.
    seen : tuple of float
        Variance of the state that the last of them saw, per axis.
    began_s, last_s : float
        Times of the first and the last reading that agree [s].
    count : int
        How many agree.
    misfit : float
        Sum of their normalised innovations squared about the offset.
    dof : int
        Components in that sum.
    odd : bool
        The last reading did not agree.
    course : TrackRotationFit or None
        Of fixes: the way that they have made, beside the one reckoned meanwhile.
    back : int
        Of a sensor that has jumped: so many of the last ones on end agree with the state as if it had not.
    """

    confirmed: bool
    jumped: bool
    first: tuple[float, ...]
    offset: tuple[float, ...]
    variance: tuple[float, ...]
    seen: tuple[float, ...]
    began_s: float
    last_s: float
    count: int = 1
    misfit: float = 0.0
    dof: int = 0
    odd: bool = False
    back: int = 0
    course: TrackRotationFit | None = None

    @property
    def scatters(self) -> bool:
        """Whether they differ by more than the sensor's noise and dead reckoning explain."""
        return self.dof > 0 and self.misfit > _limit(self.dof)

    def agree(self, span_s: float) -> bool:
        """Whether there are enough of them, over a long enough time, and their scatter is that of the sensor."""
        return self.count >= settings.RUN_LEAST and self.last_s - self.began_s >= span_s and not self.scatters

    def from_the_first(self) -> bool:
        """Whether the sensor jumped by the whole offset at once: the first refused reading showed it already."""
        off = np.array(self.first) - np.array(self.offset)
        size = np.abs(np.array(self.offset))
        return self.jumped and bool(np.nanmax(np.abs(off), initial=0.0) <= 0.5 * np.nanmax(size, initial=0.0))


@lru_cache(maxsize=64)  # of a sensor that is refused for good it grows with each reading
def _limit(dof: int) -> float:
    return float(chi_square_limit(1.0 - settings.TURNED_DOWN, dof))

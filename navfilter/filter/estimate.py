"""What is known now: the views of a filter's memory that others read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.state_layout import Layout
from navfilter.kernels import kalman, strapdown
from navfilter.models.state import NavState

__all__ = ["Estimate"]

Array = NDArray[np.float64]


class Estimate:
    """State, covariance and error states as they are in a memory.

    Attributes
    ----------
    memory : FilterMemory
    layout : Layout
        Of its states.
    """

    memory: FilterMemory
    layout: Layout

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""
        return self.memory.time_s

    @property
    def nav(self) -> Array:
        """Nominal state, see `NavState.pack`; shape (17,)."""
        return self.memory.nav

    @property
    def x(self) -> Array:
        """Estimated error states behind the nine of navigation, shape (n - 9,)."""
        return self.memory.x

    @property
    def P(self) -> Array:
        """Covariance of all error states as of the last fold, shape (n, n)."""
        return self.memory.P

    @property
    def counts(self) -> dict[str, int]:
        """Irregularities so far."""
        return self.memory.counts

    @property
    def state(self) -> NavState:
        """The state with its covariance, now; a copy."""
        return NavState.unpack(self.memory.time_s, self.memory.nav, self.present[:81].reshape(9, 9))

    @property
    def present(self) -> Array:
        """Covariance of navigation (81 elements), then the variances of all other states, now; shape (72 + n,)."""
        memory, n = self.memory, self.layout.size
        out = np.empty(72 + n)
        inertial, work = memory.drv[strapdown.INERTIAL] != 0.0, np.empty(9 * (n + self.layout.head + 9))
        kalman.present(memory.P, memory.acc, memory.nav, inertial, memory.drv[strapdown.OWN], work, out)
        return out

    @property
    def errors(self) -> dict[str, float]:
        """Estimates of all error states and parameters by name."""
        return dict(zip(self.layout.names, self.memory.x.tolist(), strict=True))

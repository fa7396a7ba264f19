"""What is known now: the views of a filter's memory that others read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.layout import Layout
from navfilter.state import NavState

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
        memory, m = self.memory, self.layout.head
        P, Phi, Q = memory.P[:m, :m], memory.acc[:9], memory.acc[m : m + 9, :9]
        covariance = Phi @ P @ Phi.T + Q
        return NavState.unpack(memory.time_s, memory.nav, 0.5 * (covariance + covariance.T))

    @property
    def errors(self) -> dict[str, float]:
        """Estimates of all error states and parameters by name."""
        return dict(zip(self.layout.names, self.memory.x.tolist(), strict=True))

"""What is heard of one sensor, and what changes while it is listened to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.foundation.display import Value
from navfilter.learning.axis_learner import LearnerMemory
from navfilter.models.error_models import ErrorModel
from navfilter.models.navigation_drift import Drift


@dataclass(frozen=True, eq=False, repr=False)
class ChannelSeries(Value):
    """Readings of one axis minus what an open loop would have predicted.

    Attributes
    ----------
    value : ndarray, shape (n,)
        One element per tick of the sensor [unit of the sensor]; NaN where there was no reading.
    drift : Drift
        Known noise of the slow navigation error in it.
    period_s : float
    white : float
        Known white variance in it.
    """

    value: Array
    drift: Drift
    period_s: float
    white: float

    def _shown(self) -> tuple[str, dict[str, object]]:
        known = int(np.count_nonzero(np.isfinite(self.value)))
        return f"ChannelSeries, {known} of {len(self.value)} ticks of {self.period_s:.4g} s", {}


@dataclass(frozen=True, eq=False)
class Hop:
    """What a hop learns from, fixed when it begins.

    Attributes
    ----------
    heard : ndarray, shape (axes or axes + 1, n)
        The newest ticks that it learns from, as the ring has them, oldest first; its last row where a drift needs it.
    left_out : ndarray of int, shape (LEFT_OUT, 2)
        As of the listener, from the first of these ticks.
    fresh : int
        Ticks that came since the hop before.
    taken : int
        Its answer is taken when so many ticks have been noted.
    """

    heard: Array
    left_out: Ints
    fresh: int
    taken: int

    def is_same(self, other: Hop) -> bool:
        """Whether another hop has the same answer."""
        return (
            (self.fresh, self.taken) == (other.fresh, other.taken)
            and np.array_equal(self.left_out, other.left_out)
            and np.array_equal(self.heard, other.heard, equal_nan=True)
        )


@dataclass
class OpenLoopMemory:
    """What a listener remembers.

    Attributes
    ----------
    ring : ndarray, shape (axes + 1, capacity)
        Open-loop residuals, one element per tick [unit of the sensor], and the force that was found while the vehicle
        pitched or rolled [m/s^2]; the tick with number k stands at ``k % capacity``.
    cursor : ndarray of int, shape (1,)
        Ticks noted so far.
    left_out : ndarray of int, shape (LEFT_OUT, 2)
        Stretches of ticks, first and end, that nothing is learnt from: the newest last.
    due : int
        The next hop comes when so many have been noted.
    heard : int
        Ticks that have been learnt from.
    level : float
        How many times as large as learnt the error is in the models in force, as a variance.
    odds : ndarray, shape (LEVELS,)
        How probable the levels of `navfilter.kernels.open_loop_residual` are.
    models : tuple of ErrorModel
        Of each axis, as learnt last.
    learners : tuple of LearnerMemory or None
        What the learner of each axis knows; None where nothing is learnt.
    hop : Hop or None
        The hop whose answer has not been taken yet.
    ended : bool
        What was learnt has been given up, and nothing is learnt any more.
    """

    SHARED: ClassVar = ("ring",)

    ring: Array
    cursor: Ints
    left_out: Ints
    due: int
    heard: int
    level: float
    odds: Array
    models: tuple[ErrorModel, ...]
    learners: tuple[LearnerMemory | None, ...]
    hop: Hop | None
    ended: bool

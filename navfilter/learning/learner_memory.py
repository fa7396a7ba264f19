"""What learners know between hops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.likelihood import Followed
from navfilter.learning.slow_posterior import Line

Array = NDArray[np.float64]
Order = tuple[int, int]
#: AR and MA order of a fast part, and order of the slow part beside it, 0 without one.
Kind = tuple[int, int, int]


@dataclass(frozen=True)
class LearnerMemory:
    """What a learner knows between hops; nothing in it is changed.

    Attributes
    ----------
    thetas : dict of (p, q, order of the slow part) to ndarray
        Estimates of all that has been fitted, in the unit of the series; see `Likelihood`. With a slow part of second
        order that of the order that it was tried with last.
    chosen : dict of (p, q, order of the slow part) to float
        The most probable, and how probable: at most two.
    followed : dict of the same to Followed
        What the recursion makes of them.
    scale : (float, float, int)
        Unit and level of the series that it goes on from, and how many samples the last look knew.
    lines : dict of the same to dict of (order, number of tau) to Line
        Of the posteriors of their slow parts, see `SlowPosterior`: those that are possible.
    """

    thetas: dict[Kind, Array]
    chosen: dict[Kind, float]
    followed: dict[Kind, Followed]
    scale: tuple[float, float, int]
    lines: dict[Kind, dict[tuple[int, int], Line]]


class Remembers(Protocol):
    """A learner."""

    memory: LearnerMemory


def memories(learners: Sequence[Remembers | None]) -> tuple[LearnerMemory | None, ...]:
    """What the learners of a sensor's axes know; None where nothing is learnt."""
    return tuple(None if learner is None else learner.memory for learner in learners)


def recall(
    learners: Sequence[Remembers | None], now: Sequence[LearnerMemory | None], then: Sequence[LearnerMemory | None]
) -> None:
    """Let learners that know `now` know `then`; those for which the two are one value stay as they are."""
    for learner, present, other in zip(learners, now, then, strict=True):
        if learner is not None and other is not None and other is not present:
            learner.memory = other

"""What learners know between hops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.slow_posterior import Line

__all__ = ["LearnerMemory", "Order", "memories", "recall"]

Array = NDArray[np.float64]
Order = tuple[int, int]


@dataclass(frozen=True)
class LearnerMemory:
    """What a learner knows between hops; nothing in it is changed.

    Attributes
    ----------
    thetas : dict of (p, q) to ndarray
        Estimates of every order that has been fitted, in the unit of the series; see `Likelihood`.
    scores : dict of (p, q) to float
        Half the BIC above that of the best, when fitted last.
    smooth : dict of (p, q) to ndarray
        As `thetas`, with a slow part of second order: of the order that it was tried with last.
    lines : dict of (order, number of tau) to Line
        Of the posterior of the slow part, see `SlowPosterior`: those that are possible.
    chosen : ((p, q), order of the slow part)
        The best estimate.
    turn : int
        Turns of the orders that are not among the best.
    heard : int
        Samples so far.
    grown, fitted : int
        As `heard`, when the larger orders were last begun from smaller ones, and when orders were fitted last.
    """

    thetas: dict[Order, Array]
    scores: dict[Order, float]
    smooth: dict[Order, Array]
    lines: dict[tuple[int, int], Line]
    chosen: tuple[Order, int]
    turn: int
    heard: int
    grown: int
    fitted: int


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

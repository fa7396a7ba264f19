"""What a sensor's description has its learner believe, and what was learnt, put into that description."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from navfilter.learning.axis_learner import Learner, LearnerMemory
from navfilter.learning.learned_model import LearnedModel
from navfilter.learning.slow_prior import SlowPrior, slow_prior
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import LONGEST_SPAN_S, LearnedArma, learned_part, with_learned
from navfilter.models.navigation_drift import Drift
from navfilter.models.sensors import Sensor


def with_learnt(model: ErrorModel, found: LearnedModel | None, frozen: bool = False) -> ErrorModel:
    """An error model with what was found in force, and with nothing more to be learnt where it is `frozen`."""
    part = learned_part(model)
    if part is None or found is None:
        return model
    slow = sum(found.slow[1:], start=found.slow[0]) if found.slow else None
    return with_learned(model, replace(part, model=found.model, slow=slow, spectrum=found.spectrum, frozen=frozen))


def learner_of(part: LearnedArma, sensor: Sensor, drift: Drift, white: float, window: int | None = None) -> Learner:
    """The learner of one axis of a correcting sensor.

    Parameters
    ----------
    part : LearnedArma
        Of the axis.
    sensor : Sensor
    drift : Drift
    white : float
        Known white variance in the series.
    window : int, optional
        Samples; default: that of the part.
    """
    part = part if window is None else replace(part, window=window)
    period_s = 1.0 / sensor.rate_hz
    prior = believed(part, period_s, sensor.prior)
    return Learner(part.orders, part.window, drift, white=white, prior=prior, described=part.prior)


def believed(part: LearnedArma, period_s: float, kind: ErrorModel | None = None) -> SlowPrior | None:
    """The prior of the slow error of a part that learns at this period; `kind`: see `slow_prior`."""
    return slow_prior(part.prior or part, period_s, span_s(part, period_s), part.prior_within, kind)


def span_s(part: LearnedArma, period_s: float) -> float:
    """Time that the window of a learnt part holds, as far as it counts [s]."""
    return min(part.window * period_s, LONGEST_SPAN_S)


def memories(learners: Sequence[Learner | None]) -> tuple[LearnerMemory | None, ...]:
    """What the learners of a sensor's axes know; None where nothing is learnt."""
    return tuple(None if learner is None else learner.memory for learner in learners)


def recall(
    learners: Sequence[Learner | None], now: Sequence[LearnerMemory | None], then: Sequence[LearnerMemory | None]
) -> None:
    """Let learners that know `now` know `then`; those for which the two are one value stay as they are."""
    for learner, present, other in zip(learners, now, then, strict=True):
        if learner is not None and other is not None and other is not present:
            learner.memory = other

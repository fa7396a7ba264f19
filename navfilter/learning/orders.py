"""Candidate orders of one channel on one window: how they are fitted, which of them pass, and which is preferred."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.learning.fit import CHANNEL_CHOICE, ChannelFit, channel_fit, with_upward_spread
from navfilter.learning.likelihood import Likelihood, Point, maximise
from navfilter.learning.low_frequency import log_s0

__all__ = ["Candidate", "finds_more_low_frequency_power", "fit_candidate", "preferred"]

Array = NDArray[np.float64]
Order = tuple[int, int]


@dataclass(frozen=True)
class Proof:
    """BIC believes a parameter only on strong evidence; for power at zero frequency the burden of proof is the other
    way round.

    A larger candidate that passes the gate and finds far more of it is preferred unless it is ruled out.

    Attributes
    ----------
    ruled_out : float
        So much worse by BIC: two or three parameters that gain next to nothing.
    deviations, factor : float
        Far more is by so many standard deviations of ln S(0), and at least by this factor.
    """

    ruled_out: float = 20.0
    deviations: float = 2.0
    factor: float = 2.0


PROOF = Proof()


@dataclass(frozen=True, eq=False)
class Candidate:
    """One order fitted to a window."""

    order: Order
    fit: ChannelFit
    point: Point

    @property
    def theta(self) -> Array:
        """``[ar, ma, ln sd]`` in the unit of the series."""
        model = self.fit.model
        return np.r_[model.ar, model.ma, math.log(max(model.sd, 1e-300))]

    @property
    def cancels(self) -> bool:
        """Whether a pole and a zero are closer than two standard deviations, or nothing is known about them."""
        model = self.fit.model
        if model.covariance is None or not np.all(np.isfinite(model.covariance)):
            return True
        return CHANNEL_CHOICE.cancels(model.ar, model.ma, model.covariance)

    @cached_property
    def passes(self) -> bool:
        """Whether the gate lets it through: white innovations, no cancelling pair."""
        return not self.cancels and self.fit.is_white

    def model(self, likelihood: Likelihood) -> ArmaModel:
        """The model as it is handed out, its sd of ln S(0) checked upwards."""
        return with_upward_spread(self.fit, likelihood, self.point).model


def fit_candidate(likelihood: Likelihood, order: Order, starts: list[Array], passes: int) -> Candidate | None:
    """Fit one order; None where the likelihood is not finite."""
    point = maximise(likelihood, starts, order[0], passes, likelihood.recent)
    if not (math.isfinite(point.value) and np.all(np.isfinite(point.info))):
        return None
    return Candidate(order, channel_fit(likelihood, point), point)


def preferred(candidates: Iterable[Candidate]) -> Candidate | None:
    """The best by BIC that passes the gate, unless one not ruled out finds far more power at zero frequency."""
    ranked = sorted(candidates, key=lambda c: c.fit.bic)
    first = next((i for i, candidate in enumerate(ranked) if candidate.passes), None)
    if first is None:
        return None
    best = ranked[first]
    for other in ranked[first + 1 :]:
        if (
            other.fit.bic <= ranked[first].fit.bic + PROOF.ruled_out
            and finds_more_low_frequency_power(other, best)
            and other.passes
        ):
            best = other
    return best


def finds_more_low_frequency_power(one: Candidate, other: Candidate) -> bool:
    """Whether `one`, not ruled out against `other`, finds far more power at zero frequency, see `Proof`."""
    if one.fit.bic > other.fit.bic + PROOF.ruled_out:
        return False
    excess = log_s0(one.theta, one.order[0]) - log_s0(other.theta, other.order[0])
    return excess > max(PROOF.deviations * (other.fit.model.sd_log_s0 or 0.0), math.log(PROOF.factor))

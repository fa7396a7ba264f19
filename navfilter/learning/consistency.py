"""Whether the constants of a vehicle contradict what is believed of them: a sign of error models that are wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.monitor import FilterState
from navfilter.kernels import open_loop_residual

__all__ = [
    "BETTER",
    "CONTRADICTED",
    "WORSE",
    "ConsistencyRecord",
    "departure",
    "is_better",
    "is_near",
    "stretched",
    "told_by",
]

Array = NDArray[np.float64]

#: Constants that have gone further from what is believed of them speak against the error models [sd of a normal
#: variate]: one ask in 700 by chance, and those of a mission are nearly one.
CONTRADICTED = 3.0
#: By so much less must they speak against the models as described, for those to be taken instead [the same].
BETTER = 2.0
#: By so much less likely are fixes where models are wrong [nat]: twenty to one.
WORSE = 3.0
#: What successive stretches tell may differ by so much more than they say of themselves [1, of the variance]: slopes by
#: constants have noise, too, and of missions whose models are right the mean is 0.7 to 1.3.
AGREED = 1.5
#: A direction of which a stretch has told less of the variance before than this says nothing [1].
HARDLY_TOLD = 0.003


@dataclass(frozen=True, eq=False)
class ConsistencyRecord:
    """What successive stretches of a mission have told of the constants.

    An error that goes with the motion (a body on its springs, wheels that slip) is no noise: it tells a constant
    something else in each turn, and what is learnt of its size makes all of that certain.

    Attributes
    ----------
    time_s : float
        End of the last stretch [s]; infinite before the first has begun.
    estimate, covariance : ndarray, shapes (k,) and (k, k)
        Of all constants then.
    length, freedom : float
        Sum of the squares by which the estimates have changed, in standard deviations of what they should have changed
        by, and how many there were.
    """

    time_s: float = math.inf
    estimate: Array = field(default_factory=lambda: np.zeros(0))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    length: float = 0.0
    freedom: float = 0.0

    @property
    def disagreement(self) -> float:
        """By how much more they differ than `AGREED`, in standard deviations of a normal variate: see `departure`."""
        return _normal(self.length / (AGREED * self.freedom), self.freedom) if self.freedom else 0.0


def stretched(filter: FilterState, before: ConsistencyRecord, time_s: float) -> ConsistencyRecord:
    """With the stretch that ends at a time [s]; without any before, one begins there.

    Notes
    -----
    Where models are right the estimates of constants change by ``N(0, P_before - P_after)``, and each change is
    independent of those before. Along its eigenvectors, in units of the sd before, it is a sum of ``chi2(1)``; what has
    been opened meanwhile, or hardly told, does not count.
    """
    at = filter.layout.constants[0]
    if before.time_s == math.inf or before.estimate.size != at.size:
        return ConsistencyRecord(time_s, filter.x[at - 9], filter.P[at[:, np.newaxis], at])
    if before.time_s >= time_s or not at.size:
        return before
    now, lost = np.empty((2, at.size + 1, at.size))
    told = open_loop_residual.information_since(
        filter.x, filter.P, at, before.estimate, before.covariance, HARDLY_TOLD, now, lost
    )
    return ConsistencyRecord(time_s, now[0], now[1:], before.length + told[0], before.freedom + told[1])


def is_better(described: FilterState, learnt: FilterState, told: ConsistencyRecord) -> bool:
    """Whether the constants speak less against a filter with the models as described than against one with those that
    were learnt: by how far they have gone from their prior, or as they are less sure where they disagree with
    themselves.
    """
    against = departure(described)
    if departure(learnt) - against >= BETTER:
        return True
    (at, *_), (beside, *_) = described.layout.constants, learnt.layout.constants
    less_sure = np.prod(described.P[at, at] / np.maximum(learnt.P[beside, beside], 1e-300)) > 1.0
    return told.disagreement >= CONTRADICTED > against and bool(less_sure)


def told_by(filter: FilterState) -> set[str]:
    """Sensors that tell the position of a vehicle whose constants are not known for certain."""
    sensors = filter.vehicle.sensors if filter.layout.constants[0].size else {}
    return {name for name, sensor in sensors.items() if sensor.open_loop == open_loop_residual.POSITION}


def is_near(filter: FilterState) -> bool:
    """Whether the constants are so near to what was believed of them that their `departure` is below `CONTRADICTED`,
    for certain: that is so nearly always, and told without a decomposition.

    Notes
    -----
    With k constants the freedom of the scaled chi-square lies between 1 and k, and the limit of its length, in units of
    its mean, falls with the freedom. Its mean, the sum of the eigenvalues as far as they are positive, is no less than
    the sum of the diagonal as far as that is (Schur-Horn).
    """
    at, mean, variance = filter.layout.constants
    spread = 2.0 / (9.0 * max(1, len(at)))
    limit = 0.99 * (1.0 - spread + CONTRADICTED * math.sqrt(spread)) ** 3
    return bool(open_loop_residual.is_within(filter.x, filter.P, at, mean, variance, limit))


def departure(filter: FilterState) -> float:
    """How far all constants together have gone from what was believed of them at the start, in standard deviations of a
    normal variate: about N(0, 1) where prior and error models are right, 0 while nothing tells them.

    Notes
    -----
    With a right prior ``N(m, P0)`` the estimates scatter about m by ``P0 - P``. In units of the prior's sd, with the
    eigenvalues l of that covariance, their squared length is a sum of ``l * chi2(1)``, here a scaled chi-square of the
    same mean and variance (Satterthwaite, 1946), made normal by its cube root (Wilson and Hilferty, 1931). What a
    mission does not tell has l = 0 and does not count.
    """
    at, mean, variance = filter.layout.constants
    if not len(at):
        return 0.0
    sd = np.sqrt(variance)
    told = np.linalg.eigvalsh(np.eye(len(at)) - filter.P[np.ix_(at, at)] / np.outer(sd, sd)).clip(0.0, 1.0)
    length, total, squares = float(np.sum(((filter.x[at - 9] - mean) / sd) ** 2)), float(told.sum()), float(told @ told)
    if squares == 0.0:
        return 0.0
    return _normal(length / total, total * total / squares)


def _normal(ratio: float, freedom: float) -> float:
    """The normal variate of a chi-square variate over its mean."""
    spread = 2.0 / (9.0 * freedom)
    return (math.cbrt(ratio) - (1.0 - spread)) / math.sqrt(spread)

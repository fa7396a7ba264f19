"""Whether the constants of a vehicle contradict what is believed of them: a sign of error models that are wrong."""

from __future__ import annotations

import math

import numpy as np

from navfilter.filter.filter import Filter
from navfilter.kernels import listen

__all__ = ["BETTER", "CONTRADICTED", "departure", "is_near"]

#: Constants that have gone further from what is believed of them speak against the error models [sd of a normal
#: variate]: one ask in 700 by chance, and those of a mission are nearly one.
CONTRADICTED = 3.0
#: By so much less must they speak against the models as described, for those to be taken instead [the same].
BETTER = 2.0


def is_near(filter: Filter) -> bool:
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
    return bool(listen.is_within(filter.x, filter.P, at, mean, variance, limit))


def departure(filter: Filter) -> float:
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
    freedom = total * total / squares
    spread = 2.0 / (9.0 * freedom)
    return (math.cbrt(length / total) - (1.0 - spread)) / math.sqrt(spread)

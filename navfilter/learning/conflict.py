"""Whether the constants of a vehicle contradict what is believed of them: a sign of error models that are wrong."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.filter import Filter
from navfilter.filter.layout import Group, Layout

__all__ = ["BETTER", "CONTRADICTED", "constants", "departure"]

Array = NDArray[np.float64]
#: Constants that have gone further from what is believed of them speak against the error models [sd of a normal
#: variate]: one ask in 700 by chance, and those of a mission are nearly one.
CONTRADICTED = 3.0
#: By so much less must they speak against the models as described, for those to be taken instead [the same].
BETTER = 2.0


def constants(layout: Layout) -> tuple[NDArray[np.intp], Array, Array]:
    """Places of all constant states that are not known for certain, their means and variances at the start."""
    places, means, variances = [], [], []
    for g in (layout.drive, *layout.groups.values()):
        own = _of(g)
        places += [g.start + i for i in own]
        means += [g.x0[i] for i in own]
        variances += [g.P0[i, i] for i in own]
    return np.array(places, np.intp), np.array(means), np.array(variances)


def _of(g: Group) -> list[int]:
    return [i for i in range(g.errors, g.size) if not g.Q[i].any() and g.P0[i, i] > 0.0]


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
    at, mean, variance = constants(filter.layout)
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

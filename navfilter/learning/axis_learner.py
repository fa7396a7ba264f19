"""The learner of one channel: a posterior over error models, and the one model that it hands out at each hop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.learning.initial_values import cold_starts, grown_starts, padded_starts, with_slow_parts
from navfilter.learning.learned_model import LearnedModel, learnt_from
from navfilter.learning.learner_memory import LearnerMemory, Order
from navfilter.learning.likelihood import Likelihood, Point, maximise
from navfilter.learning.mixture import mixed
from navfilter.learning.settings import EFFORT
from navfilter.learning.slow_posterior import SlowPosterior, slow_posterior
from navfilter.learning.slow_prior import SlowPrior
from navfilter.models.error_models import ErrorModel, RandomWalk, Sum
from navfilter.models.navigation_drift import Drift
from navfilter.models.window_limits import LEAST, PER_PARAMETER, WILDEST
from navfilter.timeseries.order_criterion import criterion

__all__ = ["AxisFit", "Learner", "LearnerMemory"]

Array = NDArray[np.float64]


class AxisFit(NamedTuple):
    """What a learner has found in one series.

    Attributes
    ----------
    likelihood : Likelihood
    point : Point
        The fast part, beside the slow one where the learner has a prior of that.
    posterior : SlowPosterior or None
    n : int
        Samples that count.
    """

    likelihood: Likelihood
    point: Point
    posterior: SlowPosterior | None
    n: int


class Learner:
    """Follows the error of one channel from hop to hop; each hop hands out one immutable, stable model.

    The error is a slow part beside a fast ARMA part. The fast part is fitted with the slow one, for each order; the
    orders are weighed by BIC. Of the slow part there is a posterior: one model with its mean covariance is handed out.
    What the data cannot tell is thereby carried as variance. A hop tells what its window says; of earlier ones only the
    estimates are known, from which it begins.

    Parameters
    ----------
    orders : sequence of (p, q)
        Candidates of the fast part. Include the reductions of each.
    window : int
        Most samples behind an estimate.
    drift : Drift
        The slow navigation error beside the sensor's, and the period.
    white : float
        Variance of known white noise in the series.
    prior : SlowPrior, optional
        Of the slow part; without one the error has none.
    described : ErrorModel, optional
        What stays a hypothesis beside what is learnt, see `navfilter.learning.mixture`.

    Raises
    ------
    ValueError
        For no orders, negative orders, a window that is too short, a bad variance.

    Examples
    --------
    >>> import navfilter as nf
    >>> learner = Learner([(0, 0), (1, 0), (1, 1)], 2000, Drift((1e-3, 0.0), 0.125))
    >>> model = learner.hop(nf.simulate_arma([-0.9], [], 1.0, 2000, seed=3)).model
    >>> model.ar.round(1)
    array([-0.9])
    """

    def __init__(
        self,
        orders: Sequence[Order],
        window: int,
        drift: Drift,
        *,
        white: float = 0.0,
        prior: SlowPrior | None = None,
        described: ErrorModel | None = None,
    ) -> None:
        self.orders = tuple(sorted({(int(p), int(q)) for p, q in orders}, key=lambda pq: (sum(pq), pq)))
        if not self.orders or min(min(order) for order in self.orders) < 0:
            raise ValueError(f"orders must be at least one (p, q) of numbers not below 0, found {orders!r}.")
        if int(window) != window or window < LEAST:
            raise ValueError(f"window must be a whole number of samples, at least {LEAST}, found {window}.")
        if not (math.isfinite(white) and white >= 0.0):
            raise ValueError(f"white must be a variance (finite, not negative), found {white}.")
        self.window, self.drift, self.white, self.prior = int(window), drift, float(white), prior
        parts = described.parts if isinstance(described, Sum) else () if described is None else (described,)
        self.described = tuple(part for part in parts if not isinstance(part, RandomWalk))  # those are the drift's
        self._memory = LearnerMemory({}, {}, {}, {}, ((0, 0), 0), 0, 0, 0, 0)

    @property
    def memory(self) -> LearnerMemory:
        """All that the learner knows; setting one goes on from it, to the last bit."""
        return self._memory

    @memory.setter
    def memory(self, memory: LearnerMemory) -> None:
        extra = 0 if self.prior is None else 2
        for order, theta in memory.thetas.items():
            if order not in self.orders or theta.shape != (sum(order) + 1 + extra,):
                raise ValueError(
                    f"a learner of orders {self.orders} cannot go on from {theta.size} coefficients of order {order}."
                )
        self._memory = memory

    def hop(self, series: ArrayLike, fresh: int | None = None) -> LearnedModel | None:
        """Learn from the last `window` samples (fewer at first).

        Parameters
        ----------
        series : array_like, shape (N,)
            Oldest first; NaN is a missing tick.
        fresh : int, optional
            How many of them came since the last hop; default: all are looked at as if for the first time.

        Returns
        -------
        Learnt or None
            In the unit of the series; None where it holds too little, or never changes.

        Raises
        ------
        ValueError
            For a series that is not one-dimensional.
        """
        found = self.look(series, fresh)
        return None if found is None else mixed(learnt_from(*found), found.posterior, found.likelihood, self.described)

    def look(self, series: ArrayLike, fresh: int | None = None) -> AxisFit | None:
        """What a hop finds in the series, see there."""
        y = np.array(series, dtype=np.float64, order="C")
        if y.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {y.shape}. Use one learner per channel.")
        y = np.where(np.abs(y) <= WILDEST, y, np.nan)[-self.window :]
        n = int(np.isfinite(y).sum())
        able = [order for order in self.orders if n - self.drift.order >= max(LEAST, PER_PARAMETER * (sum(order) + 1))]
        if not able:
            return None
        try:
            likelihood = Likelihood(y, self.drift, self.white, self.prior)
        except ValueError:
            return None
        fresh = y.size if fresh is None else fresh
        heard = fresh + self._memory.heard
        if self._is_fitted(able, heard):
            order, slow = self._memory.chosen
            point = likelihood.point(self._known(likelihood, order, slow), order[0], slow)
            if _is_usable(point):
                posterior = self._slow(likelihood, point, same=True)
                lines = {} if posterior is None else posterior.lines
                self._memory = replace(self._memory, heard=heard, lines=lines)
                return AxisFit(likelihood, point, posterior, n)
        # what is heard for the first time is half of it
        again = heard >= 2 * self._memory.grown
        fits = self._fits(likelihood, able, n, again)
        if not fits:
            return None
        scores = {order: self._score(point, n) for order, point in fits.items()}
        best = min(scores, key=lambda order: scores[order])
        point, tried = self._smooth(likelihood, fits, scores, best, n)
        posterior = self._slow(likelihood, point)
        self._keep(likelihood, fits, scores, point, posterior, heard, again, tried)
        return AxisFit(likelihood, point, posterior, n)

    def _slow(self, likelihood: Likelihood, point: Point, same: bool = False) -> SlowPosterior | None:
        """The posterior of the slow part beside the fast one of a point, which may be the `same` as before."""
        if self.prior is None:
            return None
        return slow_posterior(likelihood, point.theta, point.p, self._memory.lines, same)

    def _is_fitted(self, able: list[Order], heard: int) -> bool:
        """Whether the fast part stays as it is, for some of what it was fitted to is in the window still."""
        memory = self._memory
        known = memory.heard >= self.window // 2 and all(order in memory.scores for order in able)
        return known and heard < memory.fitted + self.window

    def _known(self, likelihood: Likelihood, order: Order, slow: int) -> Array:
        """An earlier estimate, in the unit of a likelihood."""
        theta = (self._memory.smooth if slow == 2 else self._memory.thetas)[order].copy()
        at = sum(order)
        theta[at : at + 1 + bool(slow)] += likelihood.log_unit
        confined: Array = likelihood.confine([theta], order[0], slow)[0]
        return confined

    def _score(self, point: Point, n: int) -> float:
        """Half of BIC; the slow part is there for every order."""
        fast = point.theta.size - 2 * bool(point.slow)
        return point.value + 0.5 * criterion("bic", 0.0, fast, n)

    def _fits(self, likelihood: Likelihood, able: list[Order], n: int, again: bool) -> dict[Order, Point]:
        """The orders whose turn it is, each from its last estimate; large ones also from smaller ones, `again` and
        again: what was found of few readings may be near a lower maximum, and a step never leaves it.
        """
        memory, slow = self._memory, 0 if self.prior is None else 1
        fits: dict[Order, Point] = {}
        for order in self._ration(able):
            known, (p, q) = memory.thetas.get(order), order
            # what it costs to be larger comes off what an order may be worth
            best = min((self._score(point, n) for point in fits.values()), default=math.inf)
            enough = best + EFFORT.hopeless - 0.5 * criterion("bic", 0.0, p + q + 1, n)
            below = {k: point for k, point in fits.items() if k[0] <= p and k[1] <= q}
            if known is not None:
                grown = grown_starts(likelihood, below, p, q) if again and p + q > EFFORT.one_maximum else []
                starts = [self._known(likelihood, order, slow), *(grown or padded_starts(likelihood, below, p, q))]
                point = maximise(likelihood, starts, p, EFFORT.late_passes, slow, 2 if grown else 1, enough)
            else:
                starts = [*padded_starts(likelihood, below, p, q), *grown_starts(likelihood, below, p, q)]
                if p + q <= 2 or not starts:
                    cold = cold_starts(likelihood, p, q)
                    like = min(below.values(), key=lambda point: point.value).theta if below else None
                    starts += with_slow_parts(likelihood, cold, p, 1, like) if slow and cold else cold
                point = maximise(likelihood, starts, p, EFFORT.first_passes, slow, enough=enough)
            if _is_usable(point):
                fits[order] = point
        return fits

    def _ration(self, able: list[Order]) -> list[Order]:
        """The orders to fit: all while the window fills, then the two best, and one of the others in turn."""
        memory = self._memory
        if memory.heard < self.window // 2 or any(order not in memory.scores for order in able):
            return able
        ranked = sorted(able, key=lambda order: (memory.scores[order], sum(order)))
        others = sorted(ranked[2:])
        turn = [others[memory.turn % len(others)]] if others else []
        return sorted([*ranked[:2], *turn], key=lambda pq: (sum(pq), pq))

    def _smooth(
        self, likelihood: Likelihood, fits: dict[Order, Point], scores: dict[Order, float], best: Order, n: int
    ) -> tuple[Point, tuple[Order, Point] | None]:
        """The best point, with a slow part of second order where that serves better; and what was tried for that."""
        found, lowest = fits[best], scores[best]
        lines = self._memory.lines
        if self.prior is None or (lines and all(order < 2 for order, _ in lines)):
            return found, None
        # beside a smooth slow part the fast one is often the smallest; an earlier estimate may be in the wrong optimum
        young = self._memory.heard < self.window // 2
        starts = [
            (order, with_slow_parts(likelihood, [likelihood.fast(fits[order].theta, 1)], order[0], 2)[0])
            for order in ({best, min(fits)} if young or not self._memory.smooth else {min(fits)})
        ]
        starts += [(order, self._known(likelihood, order, 2)) for order in self._memory.smooth]
        values = [likelihood.penalised([start], k[0], 2)[0] + 0.5 * sum(k) * math.log(n) for k, start in starts]
        order, start = starts[int(np.argmin(values))]
        point = maximise(likelihood, [start], order[0], EFFORT.smooth_passes if young else EFFORT.late_smooth_passes, 2)
        if not math.isfinite(point.value):
            return found, None
        return (point if self._score(point, n) < lowest else found), (order, point)

    def _keep(
        self,
        likelihood: Likelihood,
        fits: dict[Order, Point],
        scores: dict[Order, float],
        point: Point,
        posterior: SlowPosterior | None,
        heard: int,
        again: bool,
        tried: tuple[Order, Point] | None,
    ) -> None:
        memory, slow = self._memory, 0 if self.prior is None else 1

        def kept(order: Order, point: Point) -> Array:
            theta = point.theta.copy()
            theta[sum(order) : sum(order) + 1 + slow] -= likelihood.log_unit
            return theta

        thetas = {**memory.thetas, **{order: kept(order, point) for order, point in fits.items()}}
        smooth = {} if tried is None else {tried[0]: kept(*tried)}
        lowest = min(scores.values())
        gaps = {**memory.scores, **{order: score - lowest for order, score in scores.items()}}
        order = (point.p, point.theta.size - 1 - point.p - 2 * bool(point.slow))
        lines = {} if posterior is None else posterior.lines
        grown = heard if again else memory.grown
        chosen = order, point.slow
        self._memory = LearnerMemory(thetas, gaps, smooth, lines, chosen, memory.turn + 1, heard, grown, fitted=heard)


def _is_usable(point: Point) -> bool:
    return math.isfinite(point.value) and bool(np.all(np.isfinite(point.info)))

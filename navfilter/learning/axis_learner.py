"""The learner of one channel: a posterior over error models, and the one model that it hands out at each hop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arrays import Array
from navfilter.kernels.arma_likelihood import COST, GAIN
from navfilter.learning.initial_values import Growth, padded, white_point, with_slow_parts
from navfilter.learning.learned_model import Found, LearnedModel, learnt_from
from navfilter.learning.likelihood import Followed, Likelihood, Point, maximise
from navfilter.learning.mixture import mixed
from navfilter.learning.settings import EFFORT
from navfilter.learning.slow_posterior import Line, SlowPosterior, log_share, slow_posterior
from navfilter.learning.slow_prior import SlowPrior, believed
from navfilter.models.error_models import ErrorModel, RandomWalk
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.navigation_drift import Drift
from navfilter.models.sensors import Sensor
from navfilter.models.window_limits import LEAST, PER_PARAMETER, WILDEST

Order = tuple[int, int]
#: What a learner has found in one series.
AxisFit = tuple[Likelihood, tuple[Found, ...]]
#: AR and MA order of a fast part, and order of the slow part beside it, 0 without one.
Kind = tuple[int, int, int]
#: A hypothesis less probable than this is left out [1] (chosen: it counts where its power is ten times as large).
LEAST_WEIGHT = 0.1
#: What information on a coefficient is worth nothing [1]
#: (derived: with it one of white noise costs what it does that is uniform from -1 to 1 beforehand).
BEFOREHAND = math.pi


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


NOTHING_KNOWN = LearnerMemory({}, {}, {}, (1.0, 0.0, 0), {})


class Learner:
    """Follows the error of one channel; what it hands out is an immutable, stable model.

    The error is a slow part beside a fast ARMA part. A look fits the fast part for each order, with a slow part and
    without; orders are weighed by their evidence. Beside the likeliest ones the slow part has a posterior. One model is
    handed out, with the mean spectrum of a white and a coloured fast part and the mean covariance of all slow ones.
    What the data cannot tell is thereby carried as variance. A look tells what its window says; of earlier ones only
    the estimates are known, from which it begins. From then on every reading moves the likeliest ones by recursive
    prediction-error steps (Ljung 1979), which forget by half a window.

    At a hop a model is handed out where they have told readings better than the last one by as much as makes a
    difference, and a look comes where they are further from what the last one found than two windows are by chance, by
    as much; or where the window holds twice or half the readings that it did.

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
        parts = () if described is None else described.terms
        self.described = tuple(part for part in parts if not isinstance(part, RandomWalk))  # those are the drift's
        self._memory = NOTHING_KNOWN

    @property
    def memory(self) -> LearnerMemory:
        """All that the learner knows; setting one goes on from it, to the last bit."""
        return self._memory

    @memory.setter
    def memory(self, memory: LearnerMemory) -> None:
        for kind, theta in memory.thetas.items():
            extra = 2 * bool(kind[2])
            if kind[:2] not in self.orders or theta.size != sum(kind[:2]) + 1 + extra or (extra and not self.prior):
                raise ValueError(
                    f"a learner of orders {self.orders} cannot go on from {theta.size} coefficients of {kind[:2]}."
                )
        self._memory = memory

    def hop(self, series: ArrayLike, fresh: int | None = None) -> LearnedModel | None:
        """Learn from a series, oldest first, in which NaN is a missing tick; of a look the last `window` count.

        Parameters
        ----------
        series : array_like, shape (N,)
        fresh : int, optional
            How many of them came since the last hop; default: all are looked at as if for the first time.

        Returns
        -------
        Learnt or None
            In the unit of the series; None where it holds too little or nothing new, or never changes.
        """
        found = self.look(series, fresh)
        return None if found is None else mixed(*learnt_from(*found), found[0], self.described)

    def look(self, series: ArrayLike, fresh: int | None = None) -> AxisFit | None:
        """What a hop finds in the series, see there: the hypothesis that there is no quick colour, before the likeliest
        other; or one of them alone.
        """
        y = np.array(series, dtype=np.float64, order="C")
        if y.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {y.shape}. Use one learner per channel.")
        y = np.where(np.abs(y) <= WILDEST, y, np.nan)
        fresh, memory, window = y.size if fresh is None else fresh, self._memory, y[-self.window :]
        if memory.followed and not fresh:
            return None
        followed, known = self._followed(y, fresh), int(np.isfinite(window).sum())
        self._memory = replace(memory, followed=followed)
        if not followed or not memory.scale[2] < 2 * known < 4 * memory.scale[2]:
            return self._fitted(window)
        scores = {kind: float(one.told[COST]) - math.log(memory.chosen[kind]) for kind, one in followed.items()}
        # what the hypotheses have told, weighed by what they told before, against how they stand at their weights
        stand = sum(memory.chosen[kind] * (one.told[COST] + one.told[GAIN]) for kind, one in followed.items())
        gain = float(stand + np.logaddexp.reduce([-score for score in scores.values()]))
        if math.isnan(gain) or any(one.distance > one.theta.size + EFFORT.hopeless for one in followed.values()):
            return self._fitted(window)
        return self._moved(window, scores) if gain > EFFORT.hopeless else None

    def _followed(self, y: Array, fresh: int) -> dict[Kind, Followed]:
        """What the `fresh` ones at the end of a series make of the models that are followed."""
        memory, before, new = self._memory, y[: y.size - fresh], y[max(y.size - fresh, 0) :]
        if not memory.followed or fresh > y.size:
            return {}
        goes_on = Likelihood(new, self.drift, self.white, self.prior, scale=memory.scale)
        # what was heard may have been found wanting since
        gap, keep = int(np.argmax(np.isfinite(np.append(0.0, before))[::-1])), math.exp(-2.0 / self.window)
        return {kind: goes_on.gone_on(one, kind[0], kind[2], keep, gap) for kind, one in memory.followed.items()}

    def _moved(self, y: Array, scores: dict[Kind, float]) -> AxisFit | None:
        """What the recursion has found is handed out, with what the last readings say of its slow part."""
        memory, likelihood, chosen = (
            self._memory,
            Likelihood(y, self.drift, self.white, self.prior),
            self._weighed(scores),
        )
        followed = {kind: memory.followed[kind].handed_out() for kind in chosen}
        thetas = {kind: _in_unit(one.theta, kind, -math.log(memory.scale[0])) for kind, one in followed.items()}
        self._memory = replace(memory, thetas=memory.thetas | thetas, chosen=chosen, followed=followed)
        points = {kind: likelihood.point(self._known(likelihood, kind), kind[0], kind[2]) for kind in chosen}
        if not all(map(_is_usable, points.values())):
            return self._fitted(y)
        return self._handed_out(likelihood, points, chosen)

    def _handed_out(self, likelihood: Likelihood, points: dict[Kind, Point], chosen: dict[Kind, float]) -> AxisFit:
        """With the posterior of the slow part beside each."""
        lines, posteriors = self._memory.lines, dict[Kind, SlowPosterior]()
        for kind in chosen if self.prior is not None else ():
            known = lines.get(kind) or next(iter(lines.values()), None)
            posteriors[kind] = slow_posterior(likelihood, points[kind], known)
        self._memory = replace(self._memory, lines={kind: one.lines for kind, one in posteriors.items()})
        return likelihood, tuple(Found(points[kind], posteriors.get(kind), share) for kind, share in chosen.items())

    def _fitted(self, y: Array) -> AxisFit | None:
        """What is found in a series by itself."""
        n = int(np.isfinite(y).sum())
        able = [
            (p, q, slow)
            for p, q in self.orders
            for slow in (0, 1)[: 1 + (self.prior is not None)]
            if n - self.drift.order >= max(LEAST, PER_PARAMETER * (p + q + 1))
        ]
        if not able:
            return None
        try:
            likelihood = Likelihood(y, self.drift, self.white, self.prior)
        except ValueError:
            return None
        # a drift that scatters by more than the readings do is not that of the instruments: it hides the sensor's error
        known = np.flatnonzero(np.isfinite(likelihood.y))
        scatter = float(np.mean(np.diff(likelihood.y[known]) ** 2 / np.diff(known)))
        if scatter < likelihood.chain[1, 0, 0]:
            return None
        fits, scores = self._fits(likelihood, able, n)
        if not fits:
            return None
        self._smooth(likelihood, fits, scores, n)
        chosen = self._weighed(scores)
        self._keep(likelihood, fits, chosen)
        return self._handed_out(likelihood, fits, chosen)

    def _weighed(self, scores: dict[Kind, float]) -> dict[Kind, float]:
        """The most probable kind without quick colour, then the most probable other, and how probable; one alone where
        the other is not by `LEAST_WEIGHT`.
        """
        best = _best_of_each(scores)
        odds = np.exp(min(scores[kind] for kind in best) - np.array([scores[kind] for kind in best]))
        weights = (odds / odds.sum()).tolist()
        if min(weights) < LEAST_WEIGHT:
            return {best[int(np.argmax(weights))]: 1.0}
        return dict(zip(best, weights, strict=True))

    def _known(self, likelihood: Likelihood, kind: Kind) -> Array:
        """An earlier estimate, in the unit of a likelihood."""
        theta = _in_unit(self._memory.thetas[kind], kind, likelihood.log_unit)
        confined: Array = likelihood.confine([theta], kind[0], kind[2])[0]
        return confined

    def _score(self, likelihood: Likelihood, point: Point, n: int) -> tuple[float, float]:
        """Minus the log of how probable it is beforehand and makes the readings: fast and slow part are integrated out
        (Laplace's approximation). And what the slow one makes of it. A pole that a zero nearly cancels may stand
        anywhere, and the best of many places is no evidence: no coefficient costs less than one of white noise does.
        """
        k, share = point.theta.size - 2 * bool(point.slow), log_share(likelihood, point)
        _, volume = np.linalg.slogdet((n * np.eye(k) + point.info[:k, :k]) / BEFOREHAND)
        shape = likelihood.log_shape(point.theta, point.p, point.slow)
        return point.value + 0.5 * float(volume) - shape - share, share

    def _fits(self, likelihood: Likelihood, able: list[Kind], n: int) -> tuple[dict[Kind, Point], dict[Kind, float]]:
        """Orders without a slow part and beside one of first order, and their scores. Each begins from its last
        estimate, and from smaller ones: what was found of few readings may be near a lower maximum, which no step
        leaves. Those that cannot become good enough by what smaller ones leave are not fitted.
        """
        fits, scores = dict[Kind, Point](), dict[Kind, float]()
        best, shares, growth = math.inf, [0.0, 0.0], Growth(likelihood)
        # what it costs to be larger, and a slow part, comes off what an order may be worth
        price = 0.5 * math.log(2.0 * n / BEFOREHAND)
        for kind in able:
            p, q, slow = kind
            enough = best + EFFORT.hopeless - price * (p + q + 1) + shares[slow]
            known = kind in self._memory.thetas
            starts = [self._known(likelihood, kind)] if known else []
            if p + q:
                below = {k[:2]: point for k, point in fits.items() if k[0] <= p and k[1] <= q and k[2] == slow}
                below = below or {(0, 0): white_point(likelihood, slow)}
                grown = growth.starts(below, p, q, price, enough)
                # one that is as good without a slow part may stand where that stands for a quick colour
                if not grown and scores.get((p, q, 1 - slow), math.inf) > best + EFFORT.hopeless:
                    continue
                starts += grown or padded(below, p, q)
            if slow and (p, q, 0) in fits:
                starts += with_slow_parts(likelihood, [fits[p, q, 0].theta], p)
            passes = EFFORT.late_passes if known else EFFORT.first_passes
            enough += max((likelihood.log_shape(start, p, slow) for start in starts), default=0.0)
            point = maximise(likelihood, starts, p, passes, slow, enough) if starts else white_point(likelihood, slow)
            if _is_usable(point):
                fits[kind] = point
                scores[kind], shares[slow] = self._score(likelihood, point, n)
                best = min(best, scores[kind])
        return fits, scores

    def _smooth(self, likelihood: Likelihood, fits: dict[Kind, Point], scores: dict[Kind, float], n: int) -> None:
        """An order beside a slow part of second order, put to the others."""
        first, memory = [kind for kind in fits if kind[2]], self._memory
        if not first or (memory.lines and all(order < 2 for of in memory.lines.values() for order, _ in of)):
            return
        # beside a smooth slow part the fast one is often the smallest; an earlier estimate may be in the wrong optimum
        second = [kind for kind in memory.thetas if kind[2] == 2]
        best = min(first, key=lambda kind: scores[kind])
        starts = [
            (kind[:2], with_slow_parts(likelihood, [likelihood.fast(fits[kind].theta, 1)], kind[0], 2)[0])
            for kind in {best, min(first)}
        ]
        starts += [(kind[:2], self._known(likelihood, kind)) for kind in second]
        values = [likelihood.penalised([start], k[0], 2)[0] + 0.5 * sum(k) * math.log(n) for k, start in starts]
        (p, q), start = starts[int(np.argmin(values))]
        point = maximise(likelihood, [start], p, EFFORT.smooth_passes, 2)
        if _is_usable(point):
            fits[p, q, 2], (scores[p, q, 2], _) = point, self._score(likelihood, point, n)

    def _keep(self, likelihood: Likelihood, fits: dict[Kind, Point], chosen: dict[Kind, float]) -> None:
        memory = self._memory
        # of the smooth ones the one that was tried last
        thetas = {kind: theta for kind, theta in memory.thetas.items() if kind[2] < 2}
        thetas |= {kind: _in_unit(point.theta, kind, -likelihood.log_unit) for kind, point in fits.items()}
        followed = {kind: likelihood.followed(fits[kind].theta, kind[0], kind[2]) for kind in chosen}
        self._memory = LearnerMemory(thetas, chosen, followed, likelihood.scale, memory.lines)


def _in_unit(theta: Array, kind: Kind, log_unit: float) -> Array:
    """Parameters in a unit so many times as small, as a logarithm."""
    p, q, slow = kind
    moved = theta.copy()
    moved[p + q : p + q + 1 + bool(slow)] += log_unit
    return moved


def _best_of_each(scores: dict[Kind, float]) -> list[Kind]:
    """The most probable kind without quick colour, and the most probable with one; of those that there are."""
    kinds = ([kind for kind in scores if any(kind[:2]) == coloured] for coloured in (False, True))
    return [min(some, key=lambda kind: scores[kind]) for some in kinds if some]


def _is_usable(point: Point) -> bool:
    return math.isfinite(point.value) and bool(np.all(np.isfinite(point.info)))


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

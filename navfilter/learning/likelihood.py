"""The likelihood of one channel as a function of the fast ARMA part and the slow part, and its maximisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arrays import Array, Ints
from navfilter.kernels import arma_fit as roots
from navfilter.kernels import arma_likelihood as kernel
from navfilter.kernels.arma_likelihood import LANES
from navfilter.learning.settings import EFFORT
from navfilter.learning.slow_prior import SlowPrior, drift_chain, slow_belief
from navfilter.models.navigation_drift import Drift
from navfilter.models.window_limits import CLIP, LONGEST_GAP
from navfilter.timeseries.roots import resolved_radius

#: Ticks over which innovations are compared with each other.
LAGS = 512
#: What is believed of coefficients of a stable model, and of logarithms of sizes within reason, as information
#: [1] (derived: they are of the order of one).
PRESUMED = 0.1
#: Where innovations are not wanted.
_UNWANTED = np.empty((0, LANES))
_DIFFERENCES, _DAMPINGS = np.array([*EFFORT.differences, EFFORT.slow_difference]), np.array(EFFORT.dampings)


class Followed(NamedTuple):
    """A model that every reading moves, see `navfilter.kernels.arma_likelihood.channel_recursion`; in scaled units.

    Attributes
    ----------
    theta, stands, fitted : ndarray, shape (k,)
        As it is now, as it is in what is handed out, and as the last look found it.
    known, info : ndarray, shape (k, k)
        Information of that look and what is believed, and information now.
    steps : ndarray, shape (k,)
        By how much each parameter is moved for its derivative.
    state, past : ndarray
        Of the filters.
    told : ndarray, shape (TOLD,)
        How well it has told readings since it was handed out.
    """

    theta: Array
    stands: Array
    fitted: Array
    known: Array
    info: Array
    steps: Array
    state: Array
    past: Ints
    told: Array

    @property
    def distance(self) -> float:
        """How far it is from what the last look found: by how much less likely that look's readings are [nat]."""
        off = self.theta - self.fitted
        return float(0.5 * off @ self.known @ off)

    def handed_out(self) -> Followed:
        """The same where it is handed out as it is now."""
        of, lane = divmod(self.theta.size + 1, LANES)
        state = self.state.copy()
        state[of, :, lane] = state[0, :, 0]
        return self._replace(stands=self.theta, state=state, told=np.zeros(kernel.TOLD))


class Likelihood:
    """Likelihood of ``y = drift + slow part + ARMA error + white noise`` over a series with gaps, in scaled units.

    A parameter vector ``theta`` is ``[ar, ma, ln sd]``, and with a slow part ``[..., ln sd, ln tau]`` of that behind
    it: standard deviations in the scaled unit, tau in seconds. The number p of AR coefficients and the order of the
    slow part (0: none) are given beside it.

    Parameters
    ----------
    series : ndarray, shape (N,)
        Samples; NaN where missing.
    drift : Drift
        The slow navigation error beside the sensor's, and the period.
    white : float
        Variance of known white noise.
    prior : SlowPrior, optional
        Of the slow part; without one there is none, and poles are only kept where the series can tell them from 1.
    clip : float
        Innovations beyond this many standard deviations are clipped.
    scale : (float, float, int), optional
        That of another series, which this one goes on from.

    Attributes
    ----------
    scale : (float, float, int)
        Unit and level of the series, and how many samples are known.

    Raises
    ------
    ValueError
        For a series with too few samples, or a constant one.
    """

    def __init__(
        self,
        series: Array,
        drift: Drift,
        white: float,
        prior: SlowPrior | None = None,
        clip: float = CLIP,
        scale: tuple[float, float, int] | None = None,
    ) -> None:
        diffuse = int(np.isinf(drift.start_sd).sum())
        self.scale = self._scaled(series, drift, diffuse) if scale is None else scale
        self.unit, level, count = self.scale
        self.log_unit = math.log(self.unit)
        self.y = np.ascontiguousarray(series - level) * self.unit
        self.drift, self.prior = drift, prior
        self.chain = drift_chain(drift, self.unit)
        r = self.chain.shape[1]
        # the kernel is written out for chains with a slow part: where there is none, a state that is always zero
        idle = np.pad(self.chain, ((0, 0), (0, 1), (0, 1)))
        self._chains = idle, self.chain, self.chain
        self._sees = [np.eye(r + slow)[0] + (np.arange(r + slow) == r) for slow in (1, 1, 2)]
        self.rules = np.array([diffuse, LONGEST_GAP, clip, white * self.unit**2])
        self.n = count - diffuse
        radius = resolved_radius(max(count, 8))
        nearest = 0.0 if prior is None else drift.period_s / prior.quickest_s
        self.least_level = max(nearest, 1.0 - radius)  # A(1) of the slowest pole that a fast part may have
        self._limits = np.array([nearest, radius, EFFORT.zero_radius, -14.0, 40.0])
        if prior is not None:
            sizes = np.log(prior.sd_limits) + self.log_unit
            self._limits = np.concatenate([self._limits, sizes, np.log(prior.taus_s[[0, -1]])])
        self._space = np.empty(2 * self.y.size * LANES)
        self._beliefs = [slow_belief(slow, prior, drift.period_s, self.log_unit) for slow in range(3)]
        self._unbelieved = [slow_belief(slow, None, drift.period_s, self.log_unit) for slow in range(3)]

    @staticmethod
    def _scaled(series: Array, drift: Drift, diffuse: int) -> tuple[float, float, int]:
        known = series[np.isfinite(series)]
        if known.size < drift.order + 8:
            raise ValueError(
                f"the channel likelihood needs at least {drift.order + 8} known samples, found {known.size}."
            )
        step = np.diff(known)
        top = float(np.max(np.abs(step)))
        if not top > 1e-13 * float(np.max(np.abs(known))):
            raise ValueError("the series is constant: it has no error to learn.")
        # A power of two, so that scaling is exact; without a level that a diffuse state takes up numbers are small.
        unit = 2.0 ** -round(math.log2(top * max(float(np.sqrt(np.mean((step / top) ** 2))), 1e-6)))
        return unit, float(known[0]) if diffuse else 0.0, int(known.size)

    def fast(self, theta: Array, slow: int) -> Array:
        """``[ar, ma, ln sd]`` of a parameter vector, or of several, one a row."""
        return theta[..., :-2] if slow else theta

    def log_shape(self, theta: Array, p: int, slow: int) -> float:
        """Log of how much denser the prior of the coefficients is than an even one from -1 to 1. Nobody knows the time
        of a colour: of each partial correlation k ``ln(1 + k)`` is even. Their product is A(1), or C(1).
        """
        coefs, least = self.fast(theta, slow)[:-1], self.least_level
        levels = [max(1.0 + float(part.sum()), least) for part in (coefs[:p], coefs[p:])]
        return -coefs.size * math.log(0.5 * math.log(2.0 / least)) - sum(map(math.log, levels))

    def standardised(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> tuple[Array, Array]:
        """Minus the log-likelihood of some models, shape (K,), and their innovations in standard deviations (N, K), NaN
        where nothing counts, which hold until the next call.
        """
        rows = np.array(thetas)
        E, V = self._noted(len(rows))
        return self._values(rows, p, slow, self._unbelieved[slow], 0, E, V), E[:, : len(rows)]

    def _noted(self, count: int) -> Array:
        """Where the kernel notes innovations and variances of so many models, shape (2, N, a multiple of `LANES`)."""
        n, wide = self.y.size, -(-count // LANES) * LANES
        if self._space.size < 2 * n * wide:
            self._space = np.empty(2 * n * wide)
        return self._space[: 2 * n * wide].reshape(2, n, wide)

    def correlations(self, point: Point) -> Array:
        """Autocorrelations of the innovations at a point, shape (LAGS,)."""
        z, size = self.standardised([point.theta], point.p, point.slow)[1][:, 0], (self.y.size // LAGS + 2) * LAGS
        known = np.isfinite(z)
        both = np.array([np.where(known, z, 0.0).clip(-CLIP, CLIP), known])
        products, pairs = np.fft.irfft(np.abs(np.fft.rfft(both, size)) ** 2)[:, :LAGS]
        # missing ticks make pairs fewer, as the ends do, which damps what is known of few
        shares = np.maximum(pairs / pairs[0], 1.0 / pairs[0]) / np.maximum(1.0 - np.arange(LAGS) / z.size, 1.0 / z.size)
        return np.asarray(products / (products[0] * shares))

    def penalised(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> Array:
        """What is minimised, of any number of models, shape (K,): minus the log-likelihood less the log-density of the
        slow part's prior.
        """
        return self._values(np.array(thetas), p, slow, self._beliefs[slow])

    def _values(
        self, rows: Array, p: int, slow: int, belief: Array, first: int = 0, E: Array = _UNWANTED, V: Array = _UNWANTED
    ) -> Array:
        values = np.empty(len(rows))
        fixed = self._chains[slow], self._sees[slow], self.rules
        kernel.channel_values(self.y, rows, p, slow, *fixed, belief, first, E, V, values)
        return values

    def lines(self, fast: Array, p: int, slow: int, log_tau: ArrayLike, log_sd: ArrayLike, first: int = 0) -> Array:
        """Minus the log-likelihood of the samples from `first` on, given those before, for several slow parts beside
        one fast part: ln tau, and ln sd in the unit of the series, shape (k,).
        """
        rows = np.empty((np.size(log_sd), fast.size + 2))
        rows[:, :-2], rows[:, -2], rows[:, -1] = fast, log_sd, log_tau
        rows[:, -2] += self.log_unit
        return self._values(rows, p, slow, self._unbelieved[slow], first)

    def point(self, theta: Array, p: int, slow: int = 0) -> Point:
        """Penalised value, gradient and Fisher information at `theta`."""
        return self.points(theta, p, slow)[0]

    def points(
        self, theta: Array, p: int, slow: int, beside: Sequence[Array] | Array = ()
    ) -> tuple[Point, list[float]]:
        """The point at `theta`, and the penalised values of others, which fill the lanes that it leaves free first."""
        k = theta.size
        rows = np.empty((k + 1 + len(beside), k))
        rows[0] = theta
        if len(beside):
            rows[k + 1 :] = beside
        values, info, gradient = np.empty(len(rows)), np.empty((k, k)), np.empty(k)
        fixed = self._chains[slow], self._sees[slow], self.rules, self._beliefs[slow], _DIFFERENCES, *self._noted(k + 1)
        kernel.channel_point(self.y, rows, p, slow, *fixed, values, info, gradient)
        return Point(theta, p, slow, float(values[0]), gradient, info), values[k + 1 :].tolist()

    def followed(self, theta: Array, p: int, slow: int) -> Followed:
        """A model that has gone through the whole series as it is, for a recursion to go on from."""
        k = theta.size
        steps, told, info = np.empty(k), np.zeros(kernel.TOLD), np.zeros((k, k))
        kernel.difference_steps(theta, p, slow, _DIFFERENCES, steps)
        state = np.zeros(kernel.state_shape(k, p, slow, self._chains[slow], self.rules))
        one = Followed(theta, theta, theta, info, info, steps, state, np.array([LONGEST_GAP + 1, 0]), told)
        now = self.gone_on(one, p, slow, -1.0)
        return now._replace(known=now.info + np.diag(self._believed(one, slow)[0]), told=told)

    def gone_on(self, one: Followed, p: int, slow: int, keep: float, gap: int = 0) -> Followed:
        """What a recursion makes of this series, which begins where the other one ended, with a `gap` at least: of what
        is known the part `keep` is left a sample later; where that is negative the model stays.
        """
        moving = {name: getattr(one, name).copy() for name in ("theta", "info", "state", "past", "told")}
        now, fixed = one._replace(**moving), (self._chains[slow], self._sees[slow], self.rules)
        now.past[0] = max(int(now.past[0]), gap)
        kernel.channel_recursion(
            *(self.y, now.theta, now.stands, now.steps, p, slow, *fixed, self._beliefs[slow], self._limits),
            *(*self._believed(one, slow), keep, EFFORT.hopeless, now.state, now.past, now.info, now.told),
        )
        return now

    def _believed(self, one: Followed, slow: int) -> tuple[Array, Array]:
        """What is believed of the parameters, as information, and about which values."""
        information, centre = np.full(one.fitted.size, PRESUMED), one.fitted.copy()
        if slow:
            assert self.prior is not None
            information[-2:] = self.prior.spread**-2.0, self.prior.tau_spread**-2.0
            centre[-2:] = self.prior.centre[0] + self.log_unit, self.prior.centre[1]
        return information, centre

    def confine(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> Array:
        """Parameter vectors, one a row, with poles and zeros pulled inside their radii, fast poles away from 1, and
        sizes within reason.
        """
        rows = np.array(thetas, dtype=np.float64, order="C")
        roots.confine(rows, p, rows.shape[1] - 1 - p - 2 * bool(slow), self._limits)
        return rows


@dataclass(frozen=True, eq=False)
class Point:
    """Minus the log-likelihood (less that of the prior) at one parameter vector, with its derivatives."""

    theta: Array
    p: int
    slow: int
    value: float
    gradient: Array
    info: Array

    @property
    def covariance(self) -> Array:
        """Inverse Fisher information and what is known beforehand."""
        return np.asarray(np.linalg.inv(self.info + PRESUMED * np.eye(self.theta.size)), dtype=np.float64)


def maximise(
    likelihood: Likelihood,
    starts: Sequence[Array],
    p: int,
    passes: int,
    slow: int = 0,
    enough: float = math.inf,
) -> Point:
    """Fisher scoring from some parameter vectors: a short race between them, then at most `passes` of the leader alone.
    What should stay above `enough`, though it gained `EFFORT.optimism` times what its slope says, is not improved.
    """
    leaders = [likelihood.point(theta, p, slow) for theta in likelihood.confine(starts, p, slow)]
    if len(leaders) > 1:
        runs = [_climb(likelihood, point, EFFORT.race_passes, enough) for point in leaders]
        best = min(runs, key=lambda point: point.value)
        if best in leaders:
            return best
        leaders = [likelihood.point(best.theta, p, slow)]
    return _climb(likelihood, leaders[0], passes, enough)


def _climb(likelihood: Likelihood, point: Point, passes: int, enough: float) -> Point:
    """Scoring passes from a point; the information is that of the last but one point, a small step away."""
    usual = 0
    for left in range(passes, 0, -1):
        trials, gains = _trials(likelihood, point)
        if not gains or point.value - EFFORT.optimism * gains[0] > enough:
            break
        # most often what did before will do; its derivatives, which the next step wants, come with it
        usual = min(usual, len(gains) - 1)
        if left > 1:
            others = np.delete(trials, usual, axis=0)
            ahead, rest = likelihood.points(trials[usual], point.p, point.slow, others)
            values = [*rest[:usual], ahead.value, *rest[usual:]]
        else:
            values = likelihood.penalised(trials, point.p, point.slow).tolist()
        chosen = next(
            (i for i, gain in enumerate(gains) if values[i] < point.value - 1e-2 * min(gain, 1.0)),
            None,
        )
        if chosen is None:
            break
        if left == 1 or point.value - values[chosen] < EFFORT.small_gain:
            return replace(point, theta=trials[chosen], value=values[chosen])
        point = ahead if chosen == usual else likelihood.point(trials[chosen], point.p, point.slow)
        usual = chosen
    return point


def _trials(likelihood: Likelihood, point: Point) -> tuple[Array, list[float]]:
    """Where steps lead that are damped more and more, and what they should gain; as long as there is something."""
    moved, gains = np.empty((_DAMPINGS.size, point.theta.size)), np.empty(_DAMPINGS.size)
    sizes = point.theta.size - (3 if point.slow else 1)
    at = point.theta, point.gradient, point.info
    count = kernel.damped_steps(*at, _DAMPINGS, sizes, EFFORT.converged, EFFORT.longest_step, moved, gains)
    return likelihood.confine(moved[:count], point.p, point.slow), gains[:count].tolist()

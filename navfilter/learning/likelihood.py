"""The likelihood of one channel as a function of the fast ARMA part and the slow part, and its maximisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.arma.roots import resolved_radius
from navfilter.kernels import channel as kernel
from navfilter.kernels import fit as roots
from navfilter.kernels.channel import LANES
from navfilter.learning.drift import Drift
from navfilter.learning.effort import EFFORT
from navfilter.learning.limits import CLIP, LONGEST_GAP
from navfilter.learning.slow import SlowPrior, drift_chain, slow_chains

__all__ = ["Likelihood", "Point", "maximise"]

Array = NDArray[np.float64]

#: Where innovations are not wanted.
_UNWANTED = np.empty((0, LANES))


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

    Raises
    ------
    ValueError
        For a series with too few samples, or a constant one.
    """

    def __init__(
        self, series: Array, drift: Drift, white: float, prior: SlowPrior | None = None, clip: float = CLIP
    ) -> None:
        known = series[np.isfinite(series)]
        if known.size < drift.order + 8:
            raise ValueError(
                f"the channel likelihood needs at least {drift.order + 8} known samples, found {known.size}."
            )
        step = np.diff(known)
        top = float(np.max(np.abs(step)))
        if not top > 1e-13 * float(np.max(np.abs(known))):
            raise ValueError("the series is constant: it has no error to learn.")
        # A power of two, so that scaling is exact.
        self.unit = 2.0 ** -round(math.log2(top * max(float(np.sqrt(np.mean((step / top) ** 2))), 1e-6)))
        self.log_unit = math.log(self.unit)
        diffuse = int(np.isinf(drift.start_sd).sum())
        # A diffuse level takes up any constant: without it, arithmetic is with small numbers.
        self.y = np.ascontiguousarray(series - (known[0] if diffuse else 0.0)) * self.unit
        self.drift, self.prior = drift, prior
        self._chain = drift_chain(drift, self.unit)
        r = self._chain.shape[1]
        self._sees = [np.eye(r + slow)[0] + (np.arange(r + slow) == r) for slow in range(3)]
        self.rules = np.array([diffuse, LONGEST_GAP, clip, white * self.unit**2])
        self.n = known.size - diffuse
        self.pole_radius = resolved_radius(max(known.size, 8))
        nearest = 0.0 if prior is None else drift.period_s / prior.quickest_s
        self._limits = np.array([nearest, self.pole_radius, EFFORT.zero_radius, -14.0, 40.0])
        if prior is not None:
            sizes = np.log(prior.sd_limits) + self.log_unit
            self._limits = np.concatenate([self._limits, sizes, np.log(prior.taus_s[[0, -1]])])
        self._space = np.empty(2 * self.y.size * LANES)

    def _chains(self, rows: Array, slow: int) -> Array:
        """Drift and slow part of several parameter vectors, one a row, as the kernel wants them."""
        r = self._chain.shape[1]
        out = np.zeros((len(rows), 3, r + slow, r + slow))
        out[:, :, :r, :r] = self._chain
        if slow:
            out[:, :, r:, r:] = slow_chains(slow, np.exp(rows[:, -2]), np.exp(rows[:, -1]), self.drift.period_s)
        return out

    def fast(self, theta: Array, slow: int) -> Array:
        """``[ar, ma, ln sd]`` of a parameter vector, or of several, one a row."""
        return theta[..., :-2] if slow else theta

    def standardised(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> tuple[Array, Array]:
        """Minus the log-likelihood of some models, shape (K,), and their innovations in standard deviations (N, K),
        which hold until the next call.
        """
        rows = np.array(thetas)
        E, V = self._noted(len(rows))
        return self._filtered(rows, p, slow, E, V), E[:, : len(rows)]

    def _noted(self, count: int) -> Array:
        """Where the kernel notes innovations and variances of so many models, shape (2, N, a multiple of `LANES`)."""
        n, wide = self.y.size, -(-count // LANES) * LANES
        if self._space.size < 2 * n * wide:
            self._space = np.empty(2 * n * wide)
        return self._space[: 2 * n * wide].reshape(2, n, wide)

    def value(self, theta: Array, p: int, slow: int = 0) -> float:
        """Minus the log-likelihood; the innovations stay in `innovations`."""
        return float(self.standardised([theta], p, slow)[0][0])

    @property
    def innovations(self) -> Array:
        """Standardised innovations of the last `value`, NaN where nothing counts."""
        return self._noted(1)[0, :, 0].copy()

    def penalised(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> Array:
        """What is minimised, of any number of models, shape (K,): minus the log-likelihood less the log-density of the
        slow part's prior.
        """
        rows = np.array(thetas)
        values = self._filtered(rows, p, slow)
        return values if not slow or self.prior is None else values - self._log_densities(rows, slow)

    def _log_densities(self, rows: Array, slow: int) -> Array:
        assert self.prior is not None
        return self.prior.log_densities(slow, rows[:, -2] - self.log_unit, rows[:, -1])

    def _filtered(self, rows: Array, p: int, slow: int, E: Array = _UNWANTED, V: Array = _UNWANTED) -> Array:
        thetas, chains = _padded(self.fast(rows, slow), p), self._chains(rows, slow)
        return filtered(self.y, thetas, chains, self._sees[slow], self.rules, 0, E, V)

    def lines(self, fast: Array, p: int, slow: int, log_tau: ArrayLike, log_sd: ArrayLike, first: int) -> Array:
        """Minus the log-likelihood of the samples from `first` on, given those before, for several slow parts beside
        one fast part: ln tau, and ln sd in the unit of the series, shape (k,).
        """
        chains = self._chains(np.column_stack([np.add(log_sd, self.log_unit), log_tau]), slow)
        thetas = np.tile(_padded(fast[None], p), (len(chains), 1))
        return filtered(self.y, thetas, chains, self._sees[slow], self.rules, first)

    def point(self, theta: Array, p: int, slow: int = 0) -> Point:
        """Penalised value, gradient and Fisher information at `theta`."""
        return self.points(theta, p, slow)[0]

    def points(
        self, theta: Array, p: int, slow: int, beside: Sequence[Array] | Array = ()
    ) -> tuple[Point, list[float]]:
        """The point at `theta`, and the penalised values of others, which fill the lanes that it leaves free first."""
        k = theta.size
        steps = np.full(k, EFFORT.slow_difference)
        fast = self.fast(theta, slow)
        steps[: fast.size] = self._steps(fast, p)
        rows = np.empty((k + 1 + len(beside), k))
        rows[: k + 1], rows[k + 1 :] = theta, np.reshape(beside, (-1, k))
        rows[range(1, k + 1), range(k)] += steps
        info, gradient = np.empty((k, k)), np.empty(k)
        thetas, chains = _padded(self.fast(rows, slow), p), self._chains(rows, slow)
        E, V = self._noted(k + 1)
        values = scores(self.y, thetas, chains, self._sees[slow], self.rules, steps, E, V, info, gradient)
        if slow and self.prior is not None:
            prior, log_sd = self.prior, theta[-2] - self.log_unit
            values -= self._log_densities(rows, slow)
            spreads = np.array([prior.spread, prior.tau_spread])
            gradient[-2:] += prior.offsets(log_sd, theta[-1]) / spreads
            info[[-2, -1], [-2, -1]] += spreads**-2.0
        return Point(theta, p, slow, float(values[0]), gradient, info), values[k + 1 :].tolist()

    def _steps(self, theta: Array, p: int) -> Array:
        """Difference steps that stay where a stationary start exists."""
        steps = np.full(theta.size, EFFORT.differences[0])
        (padded,) = _padded(theta[None], p)
        m = padded.size // 2
        spare = np.empty((m, m))
        for i in range(p):
            for size in EFFORT.differences:
                moved = padded[:m].copy()
                moved[i] += size
                steps[i] = size
                if kernel.stationary(moved, padded[m:-1], spare):
                    break
        return steps

    def confine(self, thetas: Sequence[Array] | Array, p: int, slow: int = 0) -> Array:
        """Parameter vectors, one a row, with poles and zeros pulled inside their radii, fast poles away from 1, and
        sizes within reason.
        """
        rows = np.array(thetas, dtype=np.float64, order="C")
        roots.confine(rows, p, self.fast(rows[0], slow).size - 1 - p, self._limits)
        return rows


def filtered(
    y: Array,
    thetas: Array,
    chains: Array,
    sees: Array,
    rules: Array,
    first: int = 0,
    E: Array = _UNWANTED,
    V: Array = _UNWANTED,
) -> Array:
    """Minus the log-likelihood of some models (K,), of the samples from `first` on given those before; see
    `kernel.channel_filter`, which stands alone, so that the dearest kernel of all is compiled once.
    """
    values = np.empty(len(thetas))
    kernel.channel_filter(y, thetas, chains, sees, rules, first, E, V, values)
    return values


def scores(
    y: Array,
    thetas: Array,
    chains: Array,
    sees: Array,
    rules: Array,
    steps: Array,
    E: Array,
    V: Array,
    info: Array,
    gradient: Array,
) -> Array:
    """Minus the log-likelihood of some models (K,); of ``thetas[0]`` and ``chains[0]`` gradient and Fisher information.

    The next k rows of `thetas` (K, 2m+1) and `chains` (K, 3, r, r) are those of this model with one of its k parameters
    moved by ``steps[i]``, the others are any. `E` and `V` receive innovations and their variances. A step that leaves
    the stationary region gives an infinite value: the caller chooses steps that do not.
    """
    values = filtered(y, thetas, chains, sees, rules, 0, E, V)
    if values[: steps.size + 1].max() < math.inf:
        kernel.channel_scores(E, V, steps, rules[kernel.CLIP], info, gradient)
    else:
        values[0], info[:], gradient[:] = math.inf, math.nan, math.nan
    return values


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
        """Inverse Fisher information and what is known beforehand: coefficients of a stable model, and logarithms of
        sizes within reason, are of the order of one.
        """
        return np.asarray(np.linalg.inv(self.info + 0.1 * np.eye(self.theta.size)), dtype=np.float64)


def _padded(rows: Array, p: int) -> Array:
    """The kernel's parameter vectors of several ``[ar, ma, ln sd]``, one a row."""
    q = rows.shape[1] - 1 - p
    out = np.zeros((len(rows), 2 * max(p, q) + 1))
    out[:, _places(p, q)] = rows
    return out


@cache
def _places(p: int, q: int) -> NDArray[np.int64]:
    """Where the elements of ``[ar, ma, ln sd]`` are in the kernel's parameter vector."""
    m = max(p, q)
    return np.r_[np.arange(p), m + np.arange(q), 2 * m]


def maximise(
    likelihood: Likelihood,
    starts: Sequence[Array],
    p: int,
    passes: int,
    slow: int = 0,
    race: int = 2,
    enough: float = math.inf,
) -> Point:
    """Fisher scoring: a short race between the best starts, then the leader alone.

    Parameters
    ----------
    likelihood : Likelihood
    starts : sequence of ndarray
        Parameter vectors.
    p : int
        Number of AR coefficients.
    passes : int
        Most scoring passes of the leader.
    slow : int
        Order of the slow part, 0 without one.
    race : int
        How many of the starts run.
    enough : float
        A point that should stay above this value, though it gained `EFFORT.optimism` times what its slope says, is not
        improved.
    """
    inside = likelihood.confine(starts, p, slow)
    first, others = likelihood.points(inside[0], p, slow, inside[1:])
    ranked = np.argsort([first.value, *others], kind="stable")[:race].tolist()
    leaders = [likelihood.point(inside[i], p, slow) if i else first for i in ranked]
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
    if not (np.all(np.isfinite(point.gradient)) and np.all(np.isfinite(point.info))):
        return np.empty((0, point.theta.size)), []
    damped = np.multiply.outer(EFFORT.dampings, np.diag(np.maximum(point.info.diagonal(), 1e-9)))
    steps = np.linalg.solve(point.info + damped, -point.gradient[:, None])[..., 0]
    gains = [-0.5 * float(step @ point.gradient) for step in steps]
    count = next((i for i, gain in enumerate(gains) if not gain > EFFORT.converged), len(gains))
    sizes = slice(-3, None) if point.slow else slice(-1, None)
    if not count:
        return steps[:0], []
    longest = np.maximum(np.abs(steps[:count, sizes]).max(axis=1), 1e-300)
    moved = point.theta + steps[:count] * np.minimum(1.0, EFFORT.longest_step / longest)[:, None]
    return likelihood.confine(moved, point.p, point.slow), gains[:count]

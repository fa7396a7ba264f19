"""The likelihood of one channel as a function of the fast ARMA part and the slow part, and its maximisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.roots import cap_poles, is_stable, pull_inside, push_from_one, resolved_radius
from navfilter.kernels import channel as kernel
from navfilter.learning.drift import Drift
from navfilter.learning.effort import EFFORT
from navfilter.learning.limits import CLIP, LONGEST_GAP
from navfilter.learning.slow import SlowNode, SlowPrior, drift_chain, with_slow

__all__ = ["Likelihood", "Point", "maximise"]

Array = NDArray[np.float64]


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
        self.rules = np.array([diffuse, LONGEST_GAP, clip, white * self.unit**2, EFFORT.gain_tolerance])
        self.n = known.size - diffuse
        self.pole_radius = resolved_radius(max(known.size, 8))
        self.nearest = 0.0 if prior is None else drift.period_s / prior.quickest_s
        if prior is not None:
            self._sd_limits = (np.log(prior.sd_limits) + self.log_unit).tolist()
            self._tau_limits = np.log(prior.taus_s[[0, -1]]).tolist()
        self._E, self._LNS = np.empty((2, self.y.size)), np.empty((2, self.y.size))
        # Drift and slow part of unit size, by order and ln tau.
        self._shapes: dict[tuple[int, float], Array] = {}
        # Where the likelihood was evaluated last, and what it was there.
        self._at: tuple[int, int, bytes] = (-1, 0, b"")
        self._last = math.inf

    def _parts(self, theta: Array, slow: int) -> Array:
        """Drift and slow part, as the kernel wants them."""
        if not slow:
            return self._chain
        parts, r = self._shape(slow, float(theta[-1])).copy(), self._chain.shape[1]
        parts[1:, r:, r:] *= math.exp(2.0 * theta[-2])
        return parts

    def _shape(self, slow: int, log_tau: float) -> Array:
        """Drift and a slow part of unit size."""
        at = (slow, log_tau)
        if at not in self._shapes:
            node = SlowNode(slow, 1.0 / self.unit, math.exp(log_tau))
            self._shapes[at] = with_slow(self._chain, node, self.drift.period_s, self.unit)
        return self._shapes[at]

    def fast(self, theta: Array, slow: int) -> Array:
        """``[ar, ma, ln sd]`` of a parameter vector."""
        return theta[:-2] if slow else theta

    def value(self, theta: Array, p: int, slow: int = 0) -> float:
        """Minus the log-likelihood; the innovations stay in `innovations`."""
        at = (p, slow, theta.tobytes())
        if at != self._at:
            parts, sees = self._parts(theta, slow), self._sees[slow]
            padded = _padded(self.fast(theta, slow), p)
            self._at = at
            self._last = filtered(self.y, padded, parts, sees, self.rules, self._E[0], self._LNS[0])
        return self._last

    def line(self, fast: Array, p: int, slow: int, log_tau: float, log_sd: Array, first: int) -> Array:
        """Minus the log-likelihood of the samples from `first` on, given those before, for several sizes of the slow
        part: `log_sd` in the unit of the series, shape (k,).
        """
        values, sizes = np.empty(log_sd.size), np.exp(2.0 * (log_sd + self.log_unit))
        self._at = (-1, 0, b"")
        parts, sees, beside = self._shape(slow, log_tau), self._sees[slow], self._chain.shape[1]
        e, lns = self._E[0], self._LNS[0]
        line(self.y, _padded(fast, p), parts, sees, self.rules, beside, sizes, first, e, lns, values)
        return values

    def penalised(self, theta: Array, p: int, slow: int = 0) -> float:
        """What is minimised: `value` less the log-density of the slow part's prior."""
        if not slow or self.prior is None:
            return self.value(theta, p, slow)
        return self.value(theta, p, slow) - self.prior.log_density(slow, theta[-2] - self.log_unit, theta[-1])

    @property
    def innovations(self) -> Array:
        """Standardised innovations of the last `value`, NaN where nothing counts."""
        return self._E[0].copy()

    def point(self, theta: Array, p: int, slow: int = 0) -> Point:
        """Penalised value, gradient and Fisher information at `theta`."""
        k = theta.size
        if len(self._E) < k + 1:
            self._E, self._LNS = np.empty((k + 1, self.y.size)), np.empty((k + 1, self.y.size))
        steps = np.full(k, EFFORT.slow_difference)
        fast = self.fast(theta, slow)
        steps[: fast.size] = self._steps(fast, p)
        moved = theta + np.vstack([np.zeros(k), np.diag(steps)])
        parts, sees = self._parts(theta, slow), self._sees[slow]
        chains = np.tile(parts, (k + 1, 1, 1, 1))
        for i in range(fast.size, k):
            chains[i + 1] = self._parts(moved[i + 1], slow)
        thetas = np.array([_padded(self.fast(row, slow), p) for row in moved])
        info, gradient = np.empty((k, k)), np.empty(k)
        E, LNS = self._E[: k + 1], self._LNS[: k + 1]
        value = scores(self.y, thetas, chains, sees, self.rules, steps, E, LNS, info, gradient)
        self._at, self._last = ((p, slow, theta.tobytes()) if value < math.inf else (-1, 0, b"")), value
        if slow and self.prior is not None:
            prior, log_sd = self.prior, theta[-2] - self.log_unit
            value -= prior.log_density(slow, log_sd, theta[-1])
            spreads = np.array([prior.spread, prior.tau_spread])
            gradient[-2:] += prior.offsets(log_sd, theta[-1]) / spreads
            info[[-2, -1], [-2, -1]] += spreads**-2.0
        return Point(theta, p, slow, value, gradient, info)

    def _steps(self, theta: Array, p: int) -> Array:
        """Difference steps that stay where a stationary start exists."""
        steps = np.full(theta.size, EFFORT.differences[0])
        padded = _padded(theta, p)
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

    def confine(self, theta: Array, p: int, slow: int = 0) -> Array:
        """`theta` with poles and zeros pulled inside their radii, fast poles away from 1, and sizes within reason."""
        out = theta.copy()
        q = self.fast(theta, slow).size - 1 - p
        if self.nearest and p:
            out[:p] = push_from_one(out[:p], self.nearest)
        if p and not is_stable(out[:p], self.pole_radius):
            out[:p] = cap_poles(out[:p], self.pole_radius - 1e-12)
        if q and not is_stable(out[p : p + q], EFFORT.zero_radius):
            out[p : p + q] = pull_inside(out[p : p + q], EFFORT.zero_radius - 1e-12)
        out[p + q] = min(max(out[p + q], -14.0), 40.0)
        if slow and self.prior is not None:
            (low, high), (quickest, slowest) = self._sd_limits, self._tau_limits
            out[-2] = min(max(out[-2], low), high)
            out[-1] = min(max(out[-1], quickest), slowest)
        return out


def filtered(y: Array, theta: Array, chain: Array, sees: Array, rules: Array, e: Array, lns: Array) -> float:
    """Minus the log-likelihood of a series, its innovations and ln S into `e` and `lns`; see `kernel.channel_filter`,
    which stands alone, so that the dearest kernel of all is compiled once.
    """
    plan = np.zeros(y.size, np.int64)
    return float(kernel.channel_filter(y, theta, chain, sees, rules, plan, rules[kernel.TOLERANCE], e, lns))


def line(
    y: Array,
    theta: Array,
    chain: Array,
    sees: Array,
    rules: Array,
    integrators: int,
    sizes: Array,
    first: int,
    e: Array,
    lns: Array,
    values: Array,
) -> None:
    """Minus the log-likelihood of the samples from `first` on, given those before, into `values` (k,): for states after
    the first `integrators` with noise and start of `chain` times each of the variances `sizes` (k,).
    """
    for k, size in enumerate(sizes.tolist()):
        parts = chain.copy()
        parts[1:, integrators:, integrators:] *= size
        whole = filtered(y, theta, parts, sees, rules, e, lns)
        values[k] = kernel.contribution(e[first:], lns[first:], rules[kernel.CLIP]) if whole < math.inf else math.inf


def scores(
    y: Array,
    thetas: Array,
    chains: Array,
    sees: Array,
    rules: Array,
    steps: Array,
    E: Array,
    LNS: Array,
    info: Array,
    gradient: Array,
) -> float:
    """Minus the log-likelihood at ``thetas[0]`` and ``chains[0]``, its gradient and the Fisher information.

    The other rows of `thetas` (k+1, 2m+1) and `chains` (k+1, 3, r, r) are those of a model with one of its k parameters
    moved by ``steps[i]``; they leap where the first has leapt. `E` and `LNS` (k+1, N) receive innovations and ln S in
    row 0, derivatives in the others. A step that leaves the stationary region gives an infinite value: the caller
    chooses steps that do not.
    """
    plan, tolerance, values = np.zeros(y.size, np.int64), rules[kernel.TOLERANCE], []
    for theta, chain, e, lns in zip(thetas, chains, E, LNS, strict=True):
        values.append(float(kernel.channel_filter(y, theta, chain, sees, rules, plan, tolerance, e, lns)))
        tolerance = -1.0
    if not max(values[1:], default=0.0) < math.inf:
        return math.inf
    kernel.channel_scores(E, LNS, steps, rules[kernel.CLIP], info, gradient)
    return values[0]


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


def _padded(theta: Array, p: int) -> Array:
    """The kernel's parameter vector."""
    q = theta.size - 1 - p
    m = max(p, q, 1)
    out = np.zeros(2 * m + 1)
    out[_places(p, q)] = theta
    return out


@cache
def _places(p: int, q: int) -> NDArray[np.int64]:
    """Where the elements of ``[ar, ma, ln sd]`` are in the kernel's parameter vector."""
    m = max(p, q, 1)
    return np.r_[np.arange(p), m + np.arange(q), 2 * m]


def maximise(
    likelihood: Likelihood, starts: Sequence[Array], p: int, passes: int, slow: int = 0, race: int = 2
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
    """
    inside = [likelihood.confine(start, p, slow) for start in starts]
    if len(inside) > 1:
        inside.sort(key=lambda start: likelihood.penalised(start, p, slow))
    if min(len(inside), race) > 1:
        runs = [_climb(likelihood, start, p, EFFORT.race_passes, slow) for start in inside[:race]]
        inside = [min(runs, key=lambda point: point.value).theta]
    return _climb(likelihood, inside[0], p, passes, slow)


def _climb(likelihood: Likelihood, theta: Array, p: int, passes: int, slow: int) -> Point:
    """Scoring passes from `theta`; the information is that of the last but one point, a small step away."""
    point = likelihood.point(theta, p, slow)
    for left in range(passes, 0, -1):
        found = _step(likelihood, point)
        if found is None:
            break
        theta, value, gain = found
        if left == 1 or gain < EFFORT.small_gain:
            return replace(point, theta=theta, value=value)
        point = likelihood.point(theta, p, slow)
    return point


def _step(likelihood: Likelihood, point: Point) -> tuple[Array, float, float] | None:
    """A Levenberg-damped scoring step that lowers the value: where, to what, and by how much; None if nothing is
    left.
    """
    if not (np.all(np.isfinite(point.gradient)) and np.all(np.isfinite(point.info))):
        return None
    scale = np.maximum(np.diag(point.info), 1e-9)
    sizes = slice(-3, None) if point.slow else slice(-1, None)
    for damping in EFFORT.dampings:
        step = np.linalg.solve(point.info + np.diag(damping * scale), -point.gradient)
        gain = -0.5 * float(step @ point.gradient)
        if not gain > EFFORT.converged:
            return None
        step *= min(1.0, EFFORT.longest_step / max(float(np.max(np.abs(step[sizes]))), 1e-300))
        trial = likelihood.confine(point.theta + step, point.p, point.slow)
        value = likelihood.penalised(trial, point.p, point.slow)
        if value < point.value - 1e-2 * min(gain, 1.0):
            return trial, value, point.value - value
    return None

"""The likelihood of one channel as a function of [ar, ma, ln sd], and its maximisation by Fisher scoring."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.roots import cap_poles, is_stable, pull_inside, resolved_radius
from navfilter.kernels import channel as kernel
from navfilter.learning.effort import EFFORT
from navfilter.learning.limits import CLIP, LONGEST_GAP

__all__ = ["Likelihood", "Point", "maximise"]

Array = NDArray[np.float64]

# Below the lowest frequency that the series resolves, the spectrum is taken to stay level within a factor of about e:
# mean and standard deviation of ln S(0) - ln S(lowest resolved).
LEVEL_MEAN, LEVEL_SD = 0.3, 1.0


class Likelihood:
    """Likelihood of ``y = drift + ARMA error + white noise`` over a series with gaps, in scaled units.

    Parameters
    ----------
    series : ndarray, shape (N,)
        Samples; NaN where missing.
    drift : ndarray, shape (r+1, r)
        Noise of the drift per tick, states in units per tick, and the variances of their start (infinite: diffuse).
    white : float
        Variance of known white noise.
    clip : float
        Innovations beyond this many standard deviations are clipped.
    """

    def __init__(self, series: Array, drift: Array, white: float, clip: float = CLIP) -> None:
        known = series[np.isfinite(series)]
        r = drift.shape[1]
        if known.size < r + 8:
            raise ValueError(f"the channel likelihood needs at least {r + 8} known samples, found {known.size}.")
        step = np.diff(known)
        top = float(np.max(np.abs(step)))
        if not top > 1e-13 * float(np.max(np.abs(known))):
            raise ValueError("the series is constant: it has no error to learn.")
        # A power of two, so that scaling is exact.
        self.unit = 2.0 ** -round(math.log2(top * max(float(np.sqrt(np.mean((step / top) ** 2))), 1e-6)))
        diffuse = int(np.isinf(drift[r]).sum())
        # A diffuse level takes up any constant: without it, arithmetic is with small numbers.
        self.y = np.ascontiguousarray(series - (known[0] if diffuse else 0.0)) * self.unit
        self.Q = np.zeros((2, 1)) if r == 0 else np.ascontiguousarray(drift * self.unit**2)
        self.rules = np.array([diffuse, LONGEST_GAP, clip, white * self.unit**2, EFFORT.gain_tolerance])
        self.n = known.size - diffuse
        self.pole_radius = resolved_radius(max(known.size, 8))
        self.lowest = 2.0 * math.pi / max(known.size, 8)
        self._E, self._LNS = np.empty((2, self.y.size)), np.empty((2, self.y.size))
        self._turn = [complex(np.exp(-1j * self.lowest * k)) for k in range(1, 11)]
        # Where the likelihood was evaluated last, and what it was there.
        self._at, self._last = (-1, b""), math.inf

    @cached_property
    def recent(self) -> Likelihood:
        """The likelihood of the newer half, in the same units: enough to tell good starts from bad ones."""
        if self.y.size < 2 * EFFORT.recent_samples:
            return self
        half = copy(self)
        half.y = np.ascontiguousarray(self.y[self.y.size // 2 :])
        if int(np.isfinite(half.y).sum()) < EFFORT.recent_samples // 2:
            return self
        half._E, half._LNS, half._at = np.empty((2, half.y.size)), np.empty((2, half.y.size)), (-1, b"")
        return half

    def value(self, theta: Array, p: int) -> float:
        """Minus the log-likelihood at ``theta = [ar, ma, ln sd]``; the innovations stay in `innovations`."""
        at = (p, theta.tobytes())
        if at != self._at:
            self._at, padded = at, _padded(theta, p)
            self._last = float(kernel.channel_filter(self.y, padded, self.Q, self.rules, self._E[0], self._LNS[0]))
        return self._last

    def penalised(self, theta: Array, p: int) -> float:
        """What is minimised: `value` plus the weak prior on the spectrum below the lowest resolved frequency."""
        return self.value(theta, p) + 0.5 * ((self._rise(theta, p) - LEVEL_MEAN) / LEVEL_SD) ** 2

    def _sums(self, c: Array) -> tuple[float, complex]:
        """``1 + c1 q^-1 + ...`` at zero frequency and at the lowest that the series resolves."""
        at_zero, at_low = 1.0, 1.0 + 0.0j
        for value, turn in zip(c.tolist(), self._turn, strict=False):
            at_zero += value
            at_low += value * turn
        return at_zero, at_low

    def _rise(self, theta: Array, p: int) -> float:
        """``ln S(0) - ln S(lowest)``."""
        (a0, a1), (c0, c1) = self._sums(theta[:p]), self._sums(theta[p:-1])
        ratio = max(abs(c0), 1e-300) * max(abs(a1), 1e-300) / (max(abs(a0), 1e-300) * max(abs(c1), 1e-300))
        return 2.0 * math.log(ratio)

    def _slope(self, theta: Array, p: int) -> Array:
        """Gradient of `_rise`."""
        gradient = np.zeros(theta.size)
        for part, sign in ((slice(0, p), -2.0), (slice(p, theta.size - 1), 2.0)):
            at_zero, at_low = self._sums(theta[part])
            gradient[part] = [
                sign * (1.0 / at_zero - (turn / at_low).real) for turn in self._turn[: part.stop - part.start]
            ]
        return gradient

    @property
    def innovations(self) -> Array:
        """Standardised innovations of the last `value`, NaN where nothing counts."""
        return self._E[0].copy()

    def point(self, theta: Array, p: int) -> Point:
        """Value, gradient and Fisher information at `theta`."""
        k = theta.size
        if len(self._E) < k + 1:
            self._E, self._LNS = np.empty((k + 1, self.y.size)), np.empty((k + 1, self.y.size))
        info, gradient = np.empty((k, k)), np.empty(k)
        padded, free, steps = _padded(theta, p), _places(p, k - 1 - p), self._steps(theta, p)
        E, LNS = self._E[: k + 1], self._LNS[: k + 1]
        value = float(kernel.channel_scores(self.y, padded, self.Q, self.rules, free, steps, E, LNS, info, gradient))
        self._at, self._last = ((p, theta.tobytes()) if value < math.inf else (-1, b"")), value
        off, slope = (self._rise(theta, p) - LEVEL_MEAN) / LEVEL_SD**2, self._slope(theta, p)
        value += 0.5 * LEVEL_SD**2 * off * off
        return Point(theta, p, value, gradient + off * slope, info + np.outer(slope, slope) / LEVEL_SD**2)

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

    def confine(self, theta: Array, p: int) -> Array:
        """`theta` with poles and zeros pulled inside their radii, and ln sd within floating point."""
        out = theta.copy()
        if not is_stable(theta[:p], self.pole_radius):
            out[:p] = cap_poles(theta[:p], self.pole_radius - 1e-12)
        if not is_stable(theta[p:-1], EFFORT.zero_radius):
            out[p:-1] = pull_inside(theta[p:-1], EFFORT.zero_radius - 1e-12)
        out[-1] = min(max(theta[-1], -14.0), 40.0)
        return out


@dataclass(frozen=True, eq=False)
class Point:
    """Minus the log-likelihood at one ``theta = [ar, ma, ln sd]``, with its derivatives."""

    theta: Array
    p: int
    value: float
    gradient: Array
    info: Array

    @property
    def covariance(self) -> Array:
        """Inverse Fisher information, with a trace of regularisation for directions the series says nothing about."""
        scale = np.sqrt(np.maximum(np.diag(self.info), 1e-12))
        correlation = self.info / np.outer(scale, scale) + 1e-10 * np.eye(scale.size)
        return np.asarray(np.linalg.inv(correlation), dtype=np.float64) / np.outer(scale, scale)


def _padded(theta: Array, p: int) -> Array:
    """The kernel's parameter vector."""
    q = theta.size - 1 - p
    m = max(p, q, 1)
    out = np.zeros(2 * m + 1)
    out[:p], out[m : m + q], out[-1] = theta[:p], theta[p:-1], theta[-1]
    return out


@cache
def _places(p: int, q: int) -> NDArray[np.int64]:
    """Where the elements of ``[ar, ma, ln sd]`` are in the kernel's parameter vector."""
    m = max(p, q, 1)
    return np.r_[np.arange(p), m + np.arange(q), 2 * m]


def maximise(
    likelihood: Likelihood, starts: Sequence[Array], p: int, passes: int, race: Likelihood | None = None
) -> Point:
    """Fisher scoring: a short race between the starts, then the leader alone.

    Parameters
    ----------
    likelihood : Likelihood
    starts : sequence of ndarray
        ``[ar, ma, ln sd]`` each.
    p : int
        Number of AR coefficients.
    passes : int
        Most scoring passes of the leader.
    race : Likelihood, optional
        Where several starts race; default: where the leader goes on.
    """
    starts = [likelihood.confine(start, p) for start in starts]
    if len(starts) > 1:
        runs = [_climb(race or likelihood, start, p, EFFORT.race_passes) for start in starts]
        starts = [min(runs, key=lambda point: point.value).theta]
    return _climb(likelihood, starts[0], p, passes)


def _climb(likelihood: Likelihood, theta: Array, p: int, passes: int) -> Point:
    """Scoring passes from `theta`; the information is that of the last but one point, a small step away."""
    point = likelihood.point(theta, p)
    for left in range(passes, 0, -1):
        found = _step(likelihood, point)
        if found is None:
            break
        theta, value, gain = found
        if left == 1 or gain < EFFORT.small_gain:
            return replace(point, theta=theta, value=value)
        point = likelihood.point(theta, p)
    return point


def _step(likelihood: Likelihood, point: Point) -> tuple[Array, float, float] | None:
    """A Levenberg-damped scoring step that lowers the value: where, to what, and by how much; None if nothing is
    left.
    """
    if not (np.all(np.isfinite(point.gradient)) and np.all(np.isfinite(point.info))):
        return None
    scale = np.maximum(np.diag(point.info), 1e-9)
    for damping in EFFORT.dampings:
        step = np.linalg.solve(point.info + np.diag(damping * scale), -point.gradient)
        gain = -0.5 * float(step @ point.gradient)
        if not gain > EFFORT.converged:
            return None
        step *= min(1.0, EFFORT.longest_step / max(abs(float(step[-1])), 1e-300))
        trial = likelihood.confine(point.theta + step, point.p)
        value = likelihood.penalised(trial, point.p)
        if value < point.value - 1e-2 * min(gain, 1.0):
            return trial, value, point.value - value
    return None

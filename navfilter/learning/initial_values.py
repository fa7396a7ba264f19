"""Where the channel likelihood's maximisation begins: at lower orders with poles and zeros more, those that best
explain what these leave, as far as it is not white.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.learning.likelihood import LAGS, Likelihood, Point, maximise
from navfilter.learning.settings import EFFORT

Order = tuple[int, int]

#: ln sd of white noise in the scaled unit, in which differences are of the order of one.
LOG_SDS = -np.arange(8.0)[:, None]
# A pole or a zero more: time constants in ticks. With both, the zero raises S(0) by these factors.
TAUS, FACTORS = np.geomspace(0.25, 90.0, 14), (1.5, 4.0, 12.0)
# A pair of each more: periods in ticks, cycles in which the oscillation decays, factors by which it raises its power.
PERIODS, DECAYS, PEAKS = np.geomspace(2.5, 160.0, 11), (1.0, 4.0), (1.5, 8.0, 40.0)
# A slow part: of the prior's standard deviation, correlation times among its nodes.
SLOW_SDS, SLOW_NODES = (0.08, 0.22, 0.5, 1.2), (0, 2, 4)


@cache
def _factors() -> dict[Order, tuple[Array, Array, Array]]:
    """By how many poles and zeros more: polynomials of both, one pair a row, and what the variance of a series becomes
    that they whiten, as a product with its autocorrelations, shape (n, LAGS).
    """
    slow = np.exp(-1.0 / TAUS)
    one, none = np.concatenate([-slow, slow])[:, None], np.empty((2 * slow.size, 0))
    pole, rise = (a.reshape(-1, 1) for a in np.meshgrid(slow, np.sqrt(FACTORS)))
    bump = -np.maximum(1.0 - rise * (1.0 - pole), -0.5)
    period, cycles, root = (a.ravel() for a in np.meshgrid(PERIODS, DECAYS, np.sqrt(PEAKS)))
    turn, radius = 2.0 * np.cos(2.0 * np.pi / period), np.exp(-1.0 / (cycles * period))
    inner = np.maximum(1.0 - (1.0 - radius) * root, 0.2)
    outer, within = (np.stack([-turn * size, size**2], axis=1) for size in (radius, inner))
    shapes = {(1, 0): (one, none), (0, 1): (none, 0.9 * one), (1, 1): (-pole, bump), (2, 2): (outer, within)}
    return {more: (ar, ma, _whitened(ar, ma)) for more, (ar, ma) in shapes.items()}


def _whitened(ar: Array, ma: Array) -> Array:
    padded = (np.pad(c, ((0, 0), (1, 0)), constant_values=1.0) for c in (ar, ma))
    A, C = (np.fft.rfft(c, 4 * LAGS) for c in padded)
    weights: Array = np.fft.irfft(np.abs(A / C) ** 2)[:, :LAGS]
    weights[:, 1:] *= 2.0
    return weights


def padded_start(theta: Array, p: int, up_p: int, up_q: int, slow: int = 0) -> Array:
    """``[ar, ma, ln sd]`` of a lower order, and what is behind it, as a start for a higher one."""
    q = theta.size - 1 - p - 2 * bool(slow)
    return np.concatenate([theta[:p], np.zeros(up_p - p), theta[p : p + q], np.zeros(up_q - q), theta[p + q :]])


def white_point(likelihood: Likelihood, slow: int = 0) -> Point:
    """The best white noise, beside a slow part if there is to be one."""
    starts = with_slow_parts(likelihood, list(LOG_SDS), 0, slow) if slow else list(LOG_SDS)
    best = starts[int(np.argmin(likelihood.penalised(starts, 0, slow)))]
    return maximise(likelihood, [best], 0, EFFORT.first_passes, slow)


def with_slow_parts(likelihood: Likelihood, fasts: Sequence[Array], p: int, slow: int = 1) -> list[Array]:
    """Each of ``[ar, ma, ln sd]`` with the slow part that serves best, of a few; needs a prior."""
    prior = likelihood.prior
    assert prior is not None
    parts = [
        (math.log(share * prior.sd) + likelihood.log_unit, math.log(prior.taus_s[node]))
        for share in SLOW_SDS
        for node in SLOW_NODES
    ]
    nodes = np.array([[*fast, *part] for fast in fasts for part in parts])
    values = likelihood.penalised(nodes, p, slow).reshape(len(fasts), -1)
    return [of[best] for of, best in zip(np.split(nodes, len(fasts)), values.argmin(axis=1), strict=True)]


class Growth:
    """Starts of larger orders from estimates of smaller ones beside the same slow part, or beside none."""

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood = likelihood
        self._promised: dict[Point, dict[Order, tuple[float, int]]] = {}

    def promised(self, point: Point) -> dict[Order, tuple[float, int]]:
        """By how many poles and zeros more: by how much the variance of a point's innovations falls at best, as a
        logarithm, and the number of those polynomials.
        """
        if point not in self._promised:
            correlations, found = self.likelihood.correlations(point), {}
            for more, (_, _, weights) in _factors().items():
                left = weights @ correlations
                of = int(np.argmin(left))
                found[more] = -math.log(max(float(left[of]), 1e-6)), of
            self._promised[point] = found
        return self._promised[point]

    def starts(
        self, below: Mapping[Order, Point], p: int, q: int, price: float = 0.0, enough: float = math.inf
    ) -> list[Array]:
        """Of each number of poles and zeros more those that promise most, the best of them first. There are none where
        no gain is worth the `price` of each pole and zero more, nor may be `enough`: minus the log-likelihood becomes
        less by at most `EFFORT.optimism` times what one of them should gain.

        `below` are estimates of orders that may become (p, q), at least one.
        """
        found, lowest, pays, shape = list[tuple[float, Order, Array]](), math.inf, False, self.likelihood.log_shape
        for more, (ar, ma, _) in _factors().items():
            lower = [k for k in below if k[0] + more[0] <= p and k[1] + more[1] <= q]
            if not lower:
                continue
            best = min(lower, key=lambda k: below[k].value)
            point, at = below[best], sum(best)
            fall, of = self.promised(point)[more]
            poles, zeros = _product(point.theta[: best[0]], ar[of]), _product(point.theta[best[0] : at], ma[of])
            theta = np.concatenate([poles, zeros, point.theta[at:]])
            theta[at + sum(more)] -= 0.5 * fall
            start = padded_start(theta, poles.size, p, q, point.slow)
            gain = 0.5 * self.likelihood.n * max(fall, 0.0)
            found.append((point.value - gain, more, start))
            lowest = min(lowest, point.value - EFFORT.optimism * gain - shape(start, p, point.slow))
            pays = pays or gain > price * (p + q - at)
        if not pays and lowest > enough:
            return []
        return [start for _, _, start in sorted(found, key=lambda one: one[:2])]


def grown_point(likelihood: Likelihood, p: int, q: int, passes: int) -> Point:
    """The best estimate of one order, without a slow part: by a pole and a zero more from order to order."""
    below, growth = {(0, 0): white_point(likelihood)}, Growth(likelihood)
    for order in [(min(k, p), min(k, q)) for k in range(1, max(p, q) + 1)]:
        starts = growth.starts(below, *order)
        below[order] = maximise(likelihood, starts, order[0], passes if order == (p, q) else EFFORT.below_passes)
    return below[p, q]


def padded(below: Mapping[Order, Point], p: int, q: int) -> list[Array]:
    """The best of several estimates as a start for a larger order."""
    best = min(below, key=lambda k: below[k].value)
    return [padded_start(below[best].theta, best[0], p, q, below[best].slow)]


def _product(of: Array, by: Array) -> Array:
    """Coefficients of the product of two polynomials that begin with 1."""
    return np.convolve([1.0, *of.tolist()], [1.0, *by.tolist()])[1:]

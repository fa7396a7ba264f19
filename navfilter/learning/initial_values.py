"""Where the channel likelihood's maximisation begins: Gauss-Markov grids, padded neighbours, Hannan-Rissanen, and lower
orders with a pole and a zero, or a pair of both, more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.likelihood import Likelihood, Point
from navfilter.timeseries.initial_values import default_long_order, hannan_rissanen_start, long_residuals
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.polynomials import add_arma
from navfilter.timeseries.roots import pull_inside, slowest_real

Array = NDArray[np.float64]
Order = tuple[int, int]

# Time constants in ticks, and shares of white noise in the variance.
TAUS, SHARES = (2.0, 8.0, 30.0, 120.0, 500.0), (0.0, 0.5, 0.95)
# A pole and a zero more: time constants in ticks, factors by which they raise S(0).
BUMP_TAUS, BUMP_FACTORS = (1.5, 5.0, 16.0, 50.0), (12.0,)
# A pair of each more: periods in ticks, cycles in which the oscillation decays, factors by which they raise its power.
PERIODS, DECAYS, PEAKS = np.geomspace(2.5, 160.0, 11), (1.0, 4.0), (40.0,)
# A slow part: of the prior's standard deviation, correlation times among its nodes.
SLOW_SDS, SLOW_NODES = (0.08, 0.22, 0.5, 1.2), (0, 2, 4)


def _bumps() -> tuple[Array, Array]:
    """Polynomials of a pole, and of a zero below it: they raise S(0) and leave higher frequencies as they are."""
    tau, root = (a.ravel() for a in np.meshgrid(BUMP_TAUS, np.sqrt(BUMP_FACTORS), indexing="ij"))
    pole = np.exp(-1.0 / tau)
    zero = np.maximum(1.0 - root * (1.0 - pole), -0.5)
    return -pole[:, None], -zero[:, None]


def _resonances() -> tuple[Array, Array]:
    """Polynomials of a pair of poles, and of zeros inside of it: they raise the spectrum around one frequency."""
    period, cycles, root = (a.ravel() for a in np.meshgrid(PERIODS, DECAYS, np.sqrt(PEAKS), indexing="ij"))
    turn, radius = 2.0 * np.cos(2.0 * np.pi / period), np.exp(-1.0 / (cycles * period))
    inner = np.maximum(1.0 - (1.0 - radius) * root, 0.2)
    return np.stack([-turn * radius, radius**2], axis=1), np.stack([-turn * inner, inner**2], axis=1)


BUMPS, RESONANCES = _bumps(), _resonances()


def padded_start(theta: Array, p: int, up_p: int, up_q: int) -> Array:
    """``[ar, ma, ln sd]`` of a lower order as a start for a higher one."""
    q = theta.size - 1 - p
    return np.concatenate([theta[:p], np.zeros(up_p - p), theta[p:-1], np.zeros(up_q - q), theta[-1:]])


def cold_starts(likelihood: Likelihood, p: int, q: int) -> list[Array]:
    """Starts that need no earlier estimate, their sd matched to the series."""
    if p == 0 and q == 0:
        return _matched(likelihood, [np.zeros(1)], 0)
    shapes = [*_rough(likelihood, p, q)]
    if p:
        taus = [tau for tau in TAUS if tau < likelihood.y.size / 3]
        shares = SHARES if q else SHARES[:1]
        tried = _matched(likelihood, [_gauss_markov(tau, share, q) for tau in taus for share in shares], 1)
        shapes.append(padded_start(tried[int(np.argmin(likelihood.penalised(tried, 1)))], 1, p, q))
    return _matched(likelihood, shapes, p) if shapes else []


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


def padded_starts(likelihood: Likelihood, below: Mapping[Order, Point], p: int, q: int) -> list[Array]:
    """The best estimate of a lower order, padded; empty where there is none."""
    lower = [k for k in below if k != (p, q)]
    if not lower:
        return []
    best = min(lower, key=lambda k: below[k].value)
    return [_padded(likelihood, below[best].theta, best[0], below[best].slow, p, q)]


def grown_starts(likelihood: Likelihood, below: Mapping[Order, Point], p: int, q: int) -> list[Array]:
    """Starts from estimates of lower orders: the best with a pole and a zero more, and the best with a pair of each."""
    out, slow = [], 0
    for kind in (1, 2):
        lower = [k for k in below if k[0] + kind <= p and k[1] + kind <= q]
        if not lower:
            continue
        best = min(lower, key=lambda k: below[k].value)
        point, at = below[best], best[0] + kind
        slow, fast = point.slow, likelihood.fast(point.theta, point.slow)
        shapes = _times(fast, best[0], *(BUMPS if kind == 1 else RESONANCES))
        slow_parts = np.tile(point.theta[fast.size :], (len(shapes), 1))
        tried = likelihood.confine(np.hstack([shapes, slow_parts]), at, slow)
        grown = tried[int(np.argmin(likelihood.penalised(tried, at, slow)))]
        out.append(_padded(likelihood, grown, at, slow, p, q))
    return _matched(likelihood, out, p, slow) if out else []


def _padded(likelihood: Likelihood, theta: Array, at: int, slow: int, p: int, q: int) -> Array:
    """A parameter vector of a lower order (with `at` AR coefficients) as one of a higher order."""
    fast = likelihood.fast(theta, slow)
    return np.concatenate([padded_start(fast, at, p, q), theta[fast.size :]])


def _times(fast: Array, p: int, ar: Array, ma: Array) -> Array:
    """``[ar, ma, ln sd]`` times other pairs of polynomials, one a row of their coefficients."""
    count, more = ar.shape
    out = np.zeros((count, fast.size + 2 * more))
    for of, by, begin in ((fast[:p], ar, 0), (fast[p:-1], ma, p + more)):
        out[:, begin : begin + of.size] = of
        for j, factor in enumerate(by.T, begin):
            out[:, j] += factor
            out[:, j + 1 : j + 1 + of.size] += np.outer(factor, of)
    out[:, -1] = fast[-1]
    return out


@cache
def _gauss_markov(tau: float, share: float, q: int) -> Array:
    phi = math.exp(-1.0 / tau)
    parts = [ArmaModel(np.array([-phi]), np.zeros(0), math.sqrt((1.0 - share) * (1.0 - phi * phi)))]
    if q == 0 or share == 0.0:
        return np.r_[-phi, np.zeros(q), 0.0] if q == 0 else np.r_[-phi, -1e-3, np.zeros(q - 1), 0.0]
    both = add_arma([*parts, ArmaModel(np.zeros(0), np.zeros(0), math.sqrt(share))])
    return np.r_[both.ar, both.ma, np.zeros(q - both.q), 0.0]


def _matched(likelihood: Likelihood, starts: Sequence[Array], p: int, slow: int = 0, rounds: int = 2) -> list[Array]:
    """Each start with its ln sd such that the innovations have about unit variance, where that is better."""
    found = likelihood.confine(starts, p, slow)
    at = found.shape[1] - 1 - 2 * bool(slow)
    values, E = likelihood.standardised(found, p, slow)
    sizes = _sizes(E, np.isfinite(values))
    for left in range(rounds, 0, -1):
        able, moved = np.isfinite(values), found.copy()
        moved[:, at] += np.clip(np.log(np.maximum(sizes, 1e-6)), -5.0, 5.0)
        if slow or left > 1:
            new, E = likelihood.standardised(moved, p, slow)
            able &= (new < values) | (not slow)
            values = np.where(able, new, values)
            if left > 1:
                sizes = np.where(able, _sizes(E, able & np.isfinite(new)), sizes)
        found = np.where(able[:, None], moved, found)
    return list(found)


def _sizes(E: Array, able: NDArray[np.bool_]) -> Array:
    """Standard deviations of innovations, column by column, by their median; 1 for models that are not `able`."""
    sizes = np.ones(able.size)
    sizes[able] = np.median(np.abs(E[np.isfinite(E[:, 0])].T[able]), axis=1) / 0.6745
    return sizes


def _rough(likelihood: Likelihood, p: int, q: int) -> list[Array]:
    """Hannan-Rissanen on the detrended series, as it is and with one slow pole and zero more, which are then
    dropped.
    """
    x = _detrended(likelihood)
    out = []
    for extra in (0, 1):
        P, Q = p + extra, q + extra
        residuals = long_residuals(x, default_long_order(x.size, P, Q))
        theta = hannan_rissanen_start(x, P, Q, residuals)
        if not np.all(np.isfinite(theta)):
            continue
        ar, ma = (theta[:p], theta[p:]) if not extra else (_without_slowest(theta[:P]), _without_slowest(theta[P:]))
        out.append(np.r_[pull_inside(ar, 0.99), pull_inside(ma, 0.99), 0.0])
    return out


def _detrended(likelihood: Likelihood) -> Array:
    """The series less its polynomial trend, over its sd, zero where missing."""
    y = likelihood.y
    known = np.isfinite(y)
    order = likelihood.drift.order
    t = np.linspace(-1.0, 1.0, y.size)
    x = np.where(known, y, 0.0)
    if order:
        basis = np.polynomial.legendre.legvander(t, order - 1)
        fit = np.linalg.lstsq(basis[known], y[known], rcond=None)[0]
        x = np.where(known, y - basis @ fit, 0.0)
    sd = float(np.sqrt(np.mean(x[known] ** 2)))
    return np.ascontiguousarray(x / (sd if sd > 0.0 else 1.0))


def _without_slowest(c: Array) -> Array:
    """Coefficients without the real root nearest to 1 (or, where there is none, without the last coefficient)."""
    roots = np.roots(np.r_[1.0, c])
    slowest = slowest_real(roots)
    if slowest is None:
        return c[:-1]
    kept = np.delete(roots, slowest)
    return np.atleast_1d(np.poly(kept)).real[1:]

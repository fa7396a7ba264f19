"""Where the channel likelihood's maximisation begins: Gauss-Markov grids, padded neighbours, Hannan-Rissanen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.algebra import add_arma
from navfilter.arma.model import ArmaModel
from navfilter.arma.roots import pull_inside, slowest_real
from navfilter.arma.starts import default_long_order, hannan_rissanen_start, long_residuals
from navfilter.learning.likelihood import Likelihood

__all__ = ["cold_starts", "grown_starts", "padded_start", "slow_part_start"]

Array = NDArray[np.float64]

# Time constants in ticks, factors by which a slow part raises S(0), and shares of white noise in the variance.
SLOW_TAUS, SLOW_FACTORS = (60.0, 400.0), (10.0, 300.0)
TAUS, SHARES = (2.0, 8.0, 30.0, 120.0, 500.0), (0.0, 0.5, 0.95)


def padded_start(theta: Array, p: int, up_p: int, up_q: int) -> Array:
    """``[ar, ma, ln sd]`` of a lower order as a start for a higher one."""
    q = theta.size - 1 - p
    return np.r_[theta[:p], np.zeros(up_p - p), theta[p:-1], np.zeros(up_q - q), theta[-1]]


def cold_starts(likelihood: Likelihood, p: int, q: int) -> list[Array]:
    """Starts that need no earlier estimate, their sd matched to the series."""
    if p == 0 and q == 0:
        return [_matched(likelihood, np.zeros(1), 0)]
    shapes = [*_rough(likelihood, p, q)]
    if p:
        taus = [tau for tau in TAUS if tau < likelihood.y.size / 3]
        best = min(
            (
                _matched(likelihood, _gauss_markov(tau, share, q), 1)
                for tau in taus
                for share in (SHARES if q else SHARES[:1])
            ),
            key=lambda start: likelihood.value(start, 1),
        )
        shapes.append(padded_start(best, 1, p, q))
    return [_matched(likelihood, shape, p) for shape in shapes]


def grown_starts(likelihood: Likelihood, below: dict[tuple[int, int], Array], p: int, q: int) -> list[Array]:
    """Starts from estimates of lower orders: padded, with an independent slow part added, and Hannan-Rissanen's."""
    lower = {k: theta for k, theta in below.items() if k[0] <= p and k[1] <= q}
    if not lower:
        return cold_starts(likelihood, p, q)
    values = {k: likelihood.penalised(theta, k[0]) for k, theta in lower.items()}
    order = sorted(values, key=lambda k: values[k])
    rough = [_matched(likelihood, shape, p) for shape in _rough(likelihood, p, q)]
    out = [padded_start(lower[order[0]], order[0][0], p, q), *_best(likelihood, rough, p)]
    for k in order:
        slow = slow_part_start(likelihood, lower[k], k[0], p, q)
        if slow:
            return [*out, *slow]
    return out


def _best(likelihood: Likelihood, starts: list[Array], p: int) -> list[Array]:
    return [min(starts, key=lambda start: likelihood.penalised(start, p))] if starts else []


def slow_part_start(likelihood: Likelihood, theta: Array, at: int, p: int, q: int) -> list[Array]:
    """A lower order (with `at` AR coefficients) with the slow part that serves best; empty where (p, q) has no room.

    A pole of time constant tau and a zero below it raise S(0) by a factor and leave higher frequencies as they are.
    """
    if at + 1 > p or theta.size - at > q:
        return []
    out = []
    for tau in SLOW_TAUS:
        for factor in SLOW_FACTORS:
            pole = 1.0 - 1.0 / tau
            zero = max(1.0 - math.sqrt(factor) / tau, 0.0)
            ar, ma = (
                np.convolve(np.r_[1.0, theta[:at]], [1.0, -pole])[1:],
                np.convolve(np.r_[1.0, theta[at:-1]], [1.0, -zero])[1:],
            )
            out.append(likelihood.confine(padded_start(np.r_[ar, ma, theta[-1]], at + 1, p, q), p))
    return _best(likelihood, out, p)


def _gauss_markov(tau: float, share: float, q: int) -> Array:
    phi = math.exp(-1.0 / tau)
    parts = [ArmaModel(np.array([-phi]), np.zeros(0), math.sqrt((1.0 - share) * (1.0 - phi * phi)))]
    if q == 0 or share == 0.0:
        return np.r_[-phi, np.zeros(q), 0.0] if q == 0 else np.r_[-phi, -1e-3, np.zeros(q - 1), 0.0]
    both = add_arma([*parts, ArmaModel(np.zeros(0), np.zeros(0), math.sqrt(share))])
    return np.r_[both.ar, both.ma, np.zeros(q - both.q), 0.0]


def _matched(likelihood: Likelihood, start: Array, p: int) -> Array:
    """The start with its ln sd such that the innovations have about unit variance."""
    start = likelihood.confine(start, p)
    for _ in range(2):
        if not math.isfinite(likelihood.value(start, p)):
            return start
        z = likelihood.innovations
        size = float(np.nanmedian(np.abs(z))) / 0.6745
        start = np.r_[start[:-1], start[-1] + min(max(math.log(max(size, 1e-6)), -5.0), 5.0)]
    return start


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
    order = int(likelihood.rules[0])
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

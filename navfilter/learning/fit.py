"""One channel of a correcting sensor: a slow navigation error with known noise, and the sensor's ARMA error.

``y[k] = d1[k] + n[k] + v[k]``. The drift d1 is the first of a chain of integrators whose noise is known from the
instruments that drive the filter; it starts diffuse. n is the ARMA error to learn, v known white noise. Reading minus
prediction would hide the low frequencies of n, because the prediction follows them; here both compete in one
likelihood, and how well they can be told apart is in the covariance (Harvey 1989, chapter 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.arma.model import ArmaModel
from navfilter.arma.roots import is_stable
from navfilter.arma.starts import tidy_series
from navfilter.diagnostics import whiteness
from navfilter.learning.likelihood import Likelihood, Point, maximise
from navfilter.learning.low_frequency import log_s0_spread, with_upward_spread
from navfilter.learning.starts import cold_starts, grown_starts, padded_start

__all__ = ["ChannelFit", "Drift", "fit_channel"]

Array = NDArray[np.float64]

LEVEL = 0.01
# Scoring passes of a lower order that only serves as a start.
BELOW = 8


@dataclass(frozen=True)
class Drift:
    """A chain of integrators driven by white noise: ``d1' = d2 + w1, d2' = d3 + w2, ...``, diffuse at the start.

    Parameters
    ----------
    density : tuple of float
        Root power spectral densities of w1, w2, ... (unit per s^(i-1) and sqrt(Hz)), 0 to 4 of them; empty: no drift.
    period_s : float
        Sampling period, s.
    start_sd : tuple of float, optional
        What is known of the states at the start of a series (unit per s^(i-1)), infinite for nothing, which is the
        default. A finite one, such as the filter's own for the gyro bias, tells more of the low frequencies of a short
        series; those after the first finite one must be finite too.

    Raises
    ------
    ValueError
        For more than four integrators, densities that are negative or not finite, a period that is not positive, a
        start that does not fit.

    Examples
    --------
    >>> drift = Drift((1e-4, 1e-6), 0.125)          # heading: angular random walk, then the walk of the gyro bias
    >>> drift.transition()
    array([[1.   , 0.125],
           [0.   , 1.   ]])
    """

    density: tuple[float, ...]
    period_s: float
    start_sd: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        density = tuple(float(value) for value in self.density)
        object.__setattr__(self, "density", density)
        object.__setattr__(self, "period_s", float(self.period_s))
        if len(density) > 4:
            raise ValueError(f"a drift has at most 4 integrators, found {len(density)} densities.")
        if not all(math.isfinite(value) and value >= 0.0 for value in density):
            raise ValueError(f"densities must be finite and not negative, found {density}.")
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise ValueError(f"period_s must be positive, found {self.period_s}.")

        start = tuple(float(value) for value in self.start_sd) or (math.inf,) * len(density)
        object.__setattr__(self, "start_sd", start)
        free = sum(math.isinf(value) for value in start)
        if len(start) != len(density) or not all(value >= 0.0 for value in start) or not all(math.isinf(v) for v in start[:free]):
            raise ValueError(f"start_sd must be {len(density)} numbers not below 0, the infinite ones first, found {start}.")

    @property
    def order(self) -> int:
        """Number of integrators r."""
        return len(self.density)

    def transition(self) -> Array:
        """Transition over one period, shape (r, r): ``period^(j-i) / (j-i)!`` above the diagonal."""
        return _chain_transition(self.order, self.period_s)

    def noise(self) -> Array:
        """Covariance of the noise added over one period, shape (r, r).

        ``sum over k >= i, j of density[k]^2 T^(2k-i-j+1) / ((k-i)! (k-j)! (2k-i-j+1))`` (Van Loan 1978, in closed form).
        """
        return _chain_noise(self.density, self.period_s)

    def per_tick(self) -> Array:
        """Noise with states in units per tick (state i times period^i) and, as last row, the variances of the start.

        Shape (r+1, r). In these units the transition has period 1.
        """
        scale = self.period_s ** np.arange(self.order)
        return np.vstack([self.noise() * np.outer(scale, scale), np.square(scale * self.start_sd)])


def _chain_transition(r: int, period_s: float) -> Array:
    out = np.eye(r)
    for i in range(r):
        for j in range(i + 1, r):
            out[i, j] = period_s ** (j - i) / math.factorial(j - i)
    return out


def _chain_noise(density: tuple[float, ...], period_s: float) -> Array:
    r = len(density)
    out = np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(max(i, j), r):
                power = 2 * k - i - j + 1
                weight = math.factorial(k - i) * math.factorial(k - j) * power
                out[i, j] += density[k] ** 2 * period_s**power / weight
    return out


@dataclass(frozen=True, eq=False)
class ChannelFit:
    """An ARMA error fitted by the channel likelihood.

    Attributes
    ----------
    model : ArmaModel
        With the covariance of ``[ar, ma]`` and `sd_log_s0` from the joint information, ln sd included.
    loglik : float
        Log-likelihood, the diffuse start integrated out.
    bic : float
        ``-2 loglik + (p + q + 1) ln n``.
    innovations : ndarray, shape (N,)
        Standardised; NaN where a sample is missing or belongs to a diffuse start.
    n : int
        Innovations that count.
    """

    model: ArmaModel
    loglik: float
    bic: float
    innovations: Array
    n: int

    @cached_property
    def is_white(self) -> bool:
        """Whether the innovations are white: Ljung-Box and cumulative periodogram together at 1 %."""
        return _is_white(self.innovations, self.model.p + self.model.q)


def fit_channel(
    series: ArrayLike,
    drift: Drift,
    p: int,
    q: int,
    *,
    white: float = 0.0,
    start: ArmaModel | None = None,
    passes: int = 30,
) -> ChannelFit:
    """Fit an ARMA(p, q) error beside a drift of known noise, by Fisher scoring of the exact likelihood.

    Parameters
    ----------
    series : array_like, shape (N,)
        Samples on a uniform grid; NaN is a missing one.
    drift : Drift
        The slow error and the period.
    p, q : int
        Orders.
    white : float
        Variance of known white noise in the series beside the ARMA error.
    start : ArmaModel, optional
        Where to begin (of the same or a lower order); default: several starts, the best of which is followed.
    passes : int
        Most scoring passes.

    Returns
    -------
    ChannelFit

    Raises
    ------
    ValueError
        For a series with infinite, too few or constant samples, and for bad orders or variances.

    Examples
    --------
    >>> import navfilter as nf
    >>> noise = nf.simulate_arma([-0.95], [], 0.2, 3000, seed=1)
    >>> fit = fit_channel(noise + 0.001 * np.arange(3000), Drift((0.0, 0.0), 0.125), 1, 0)
    >>> fit.model.ar.round(2), round(fit.model.sd, 2)
    (array([-0.95]), 0.2)
    """
    if min(p, q) < 0 or int(p) != p or int(q) != q:
        raise ValueError(f"orders must be whole numbers, at least 0, found ({p}, {q}).")
    if not (math.isfinite(white) and white >= 0.0):
        raise ValueError(f"white must be a variance (finite, not negative), found {white}.")
    y = tidy_series(series, 10 + 3 * (p + q) + drift.order, "fit_channel", gaps=True)
    likelihood = Likelihood(y, drift.per_tick(), white)
    if start is None:
        starts = cold_starts(likelihood, p, q)
        if p >= 2 and q >= 1:
            # A slow part that a lower order leaves out is found by adding one to its estimate, and hardly otherwise.
            below = min(p - 1, q), q - 1
            simple = maximise(likelihood, cold_starts(likelihood, *below), below[0], BELOW)
            starts += grown_starts(likelihood, {below: simple.theta}, p, q)
    elif start.p > p or start.q > q:
        raise ValueError(f"start has orders ({start.p}, {start.q}), above ({p}, {q}).")
    else:
        starts = [padded_start(theta_of(start, likelihood), start.p, p, q)]
    point = maximise(likelihood, starts, p, passes)
    return with_upward_spread(channel_fit(likelihood, point), likelihood, point)


def theta_of(model: ArmaModel, likelihood: Likelihood) -> Array:
    """``[ar, ma, ln sd]`` of a model in the units of a likelihood."""
    return np.r_[model.ar, model.ma, math.log(max(model.sd * likelihood.unit, 1e-300))]


def channel_fit(likelihood: Likelihood, point: Point) -> ChannelFit:
    """What a maximum says, in the units of the series."""
    p, theta = point.p, point.theta
    value = likelihood.value(theta, p)
    z = likelihood.innovations
    n = int(np.isfinite(z).sum())
    covariance = point.covariance
    flags = frozenset({"capped"}) if at_cap(likelihood, theta[:p]) else frozenset()
    model = ArmaModel(
        theta[:p],
        theta[p:-1],
        math.exp(theta[-1]) / likelihood.unit,
        covariance[:-1, :-1],
        log_s0_spread(theta, p, covariance),
        float(n),
        flags,
    )
    loglik = -value + n * math.log(likelihood.unit)
    return ChannelFit(model, loglik, -2.0 * loglik + theta.size * math.log(max(n, 2)), z, n)


def at_cap(likelihood: Likelihood, ar: Array) -> bool:
    """Whether a pole sits at the largest radius that the series can tell from a bias."""
    return not is_stable(ar, 1.0 - 1.01 * (1.0 - likelihood.pole_radius))


def _is_white(z: Array, fitted: int) -> bool:
    known = np.isfinite(z)
    if int(known.sum()) < fitted + 30:
        return False
    first, last = np.flatnonzero(known)[[0, -1]]
    clipped = np.clip(z[first : last + 1], -4.0, 4.0)
    return bool(whiteness(clipped, fitted, level=LEVEL).is_white)

"""Gauss-Markov processes of order n: correlation, exact sampling as ARMA(n, n-1), and fits.

An order-n process obeys ``(d/dt + beta)^n x = w``. With ``u = 2 beta |t|`` its autocorrelation is
``e^(-u/2) sum_k Gamma(n) Gamma(n+k) u^(n-k-1) / ((2n-2)! k! Gamma(n-k))``, k = 0 ... n-1 (Gelb 1974, with the factor
Gamma(n+k) that Ah-Chong (2003), eq. 2.42, lacks).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import brentq, minimize_scalar

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.timeseries.diagnostics import acf
from navfilter.timeseries.fit import Problem, fitted
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.polynomials import spectral_factor


def gauss_markov_correlation(order: int, beta_tau: ArrayLike) -> Array:
    """Autocorrelation (1 at zero) of an order-n Gauss-Markov process at ``beta * |tau|``."""
    _check_order(order)
    u = 2.0 * np.abs(np.asarray(beta_tau, dtype=np.float64))
    total = np.zeros_like(u)
    for k in range(order):
        weight = math.gamma(order) * math.gamma(order + k)
        weight /= math.factorial(2 * order - 2) * math.factorial(k) * math.gamma(order - k)
        total = total + weight * u ** (order - k - 1)
    return np.asarray(np.exp(-0.5 * u) * total)


def correlation_product(order: int) -> float:
    """``beta * tau`` at the 1/e point of the autocorrelation: 1, 2.1462, 2.9046, 3.5126 for orders 1 to 4.

    Examples
    --------
    >>> [round(correlation_product(n), 4) for n in (1, 2, 3, 4)]
    [1.0, 2.1462, 2.9046, 3.5126]
    """
    return float(brentq(lambda x: float(gauss_markov_correlation(order, x)) - math.exp(-1.0), 0.1, 60.0, xtol=1e-13))


def _check_order(order: int) -> None:
    if order != int(order) or not 1 <= order <= 8:
        raise ValueError(f"the Gauss-Markov order must be a whole number from 1 to 8, found {order}.")


def gauss_markov_arma(order: int, sd: float, beta: float, rate_hz: float) -> ArmaModel:
    """Exact ARMA(n, n-1) model of the sampled order-n process.

    ``(1 - e^(-beta D) B)^n x`` is the driving noise seen through the spline ``e^(-beta s) B_n(s)``, whose overlaps give
    the moving average without cancellation however short the period D.

    Parameters
    ----------
    order : int
        Order n.
    sd : float
        Standard deviation of the process.
    beta : float
        Inverse time constant, 1/s.
    rate_hz : float
        Sampling rate, Hz.

    Examples
    --------
    >>> gauss_markov_arma(2, 1.0, 1e-4, 1.0).ma.round(5)        # 2 - sqrt(3) for short periods
    array([0.26795])
    """
    _check_order(order)
    if not (sd > 0.0 and beta > 0.0 and rate_hz > 0.0):
        raise ValueError(f"sd, beta and rate_hz must be positive, found {sd}, {beta}, {rate_hz}.")
    step = beta / rate_hz
    ar = np.array([1.0])
    for _ in range(order):
        ar = np.convolve(ar, [1.0, -math.exp(-step)])
    node, weight = np.polynomial.legendre.leggauss(20)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    spline = BSpline.basis_element(np.arange(order + 1), extrapolate=False)
    pieces = [np.nan_to_num(spline(i + node)) * np.exp(-step * (i + node)) for i in range(order)]
    gamma = [sum(float(weight @ (pieces[i] * pieces[i + k])) for i in range(order - k)) for k in range(order)]
    # Process variance for unit driving power, in samples: (2n-2)! / (((n-1)!)^2 (2 beta D)^(2n-1)).
    unit = math.factorial(2 * order - 2) / math.factorial(order - 1) ** 2 / (2.0 * step) ** (2 * order - 1)
    ma, drive = spectral_factor(np.array(gamma))
    return ArmaModel(ar[1:], ma, sd * drive / math.sqrt(unit))


@dataclass(frozen=True)
class GaussMarkovFit:
    """A fitted Gauss-Markov process: standard deviation, ``beta`` (1/s), 1/e time ``tau_s``, log-likelihood.

    `loglik` is NaN for a 1/e fit whose model is too smooth for double precision.
    """

    order: int
    sd: float
    beta: float
    tau_s: float
    loglik: float
    model: ArmaModel


def fit_gauss_markov(
    series: ArrayLike, order: int, rate_hz: float, method: str = "likelihood", trend: str = "constant"
) -> GaussMarkovFit:
    """Fit an order-n Gauss-Markov process.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; NaN is a missing one.
    order : int
        Order n of the process.
    rate_hz : float
        Sampling rate, Hz.
    method : {"likelihood", "1/e"}
        Exact likelihood of the sampled process (orders above 1: of a few samples per tau), or the lag at
        which the sample autocorrelation falls to 1/e (quick, biased to short times unless the record is many tau long).
    trend : {"constant", "none", "linear"}
        As in `fit_arma`.

    Raises
    ------
    ValueError
        For unusable series and options.
    """
    _check_order(order)
    if method not in ("likelihood", "1/e"):
        raise ValueError(f'method must be "likelihood" or "1/e", found "{method}".')
    if not (isinstance(rate_hz, int | float | np.integer | np.floating) and rate_hz > 0.0):
        raise ValueError(f"rate_hz must be a positive number, found {rate_hz!r}.")
    x = numbers(series, "series")
    lag = _one_over_e_lag(x)
    # An n-fold pole near 1 loses n-1 times the digits of its distance: keep so many samples per tau.
    thin = max(int(lag / {1: np.inf, 2: 200.0}.get(order, 12.0)), 1)
    problem = Problem(x[::thin], order, order - 1, "likelihood", 0, trend, None)
    objective = problem.objective(order, order - 1)

    def value(log_step: float) -> float:
        model = gauss_markov_arma(order, 1.0, math.exp(log_step), 1.0)
        return objective.evaluate(np.r_[model.ar, model.ma]).value

    product = correlation_product(order)
    if method == "1/e":
        log_step = math.log(product / lag * thin)
    else:
        grid = np.linspace(math.log(product / min(20.0 * lag / thin, problem.y.size)), math.log(10.0), 25)
        values = [value(float(g)) for g in grid]
        i = int(np.argmin(values))
        low, high = float(grid[max(i - 1, 0)]), float(grid[min(i + 1, grid.size - 1)])
        log_step = float(minimize_scalar(value, bounds=(low, high), method="bounded", options={"xatol": 1e-6}).x)
    unit = gauss_markov_arma(order, 1.0, math.exp(log_step), 1.0)
    point = objective.evaluate(np.r_[unit.ar, unit.ma])
    sd, loglik = float(np.nanstd(x)), math.nan
    if math.isfinite(point.value):
        fit = fitted(problem, point, objective, True)
        loglik = fit.loglik
        sd = fit.sd / unit.sd if method == "likelihood" else sd
    elif method == "likelihood":
        raise ValueError(f"order {order} is too smooth at this rate for double precision. Use a lower order or 1/e.")
    beta = math.exp(log_step) * rate_hz / thin
    return GaussMarkovFit(order, sd, beta, product / beta, loglik, gauss_markov_arma(order, sd, beta, rate_hz))


def _one_over_e_lag(x: Array) -> float:
    """Lag in samples, interpolated, at which the autocorrelation first falls below 1/e."""
    level = math.exp(-1.0)
    span = 64
    # It does fall: with the mean removed, all lags together sum to -1/2.
    while True:
        span = min(span, x.size - 1)
        r = acf(x, span)
        below = np.flatnonzero(r < level)
        if below.size:
            i = int(below[0])
            return i - 1 + float((r[i - 1] - level) / (r[i - 1] - r[i]))
        span *= 4

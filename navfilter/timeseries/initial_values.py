"""Estimates without iteration: Yule-Walker, Burg and Hannan-Rissanen. Useful alone, and as starts for the exact fit."""

import math

import numpy as np

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.kernels import arma_fit as kernels
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.roots import pull_inside


def tidy_series(series: ArrayLike, least: int, what: str, gaps: bool = False) -> Array:
    """`series` as a 1-D float64 array, refused when it cannot carry the estimate `what`.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; integers are converted.
    least : int
        Smallest number of known samples.
    what : str
        Named in the error.
    gaps : bool
        Whether NaN (missing sample) is allowed.
    """
    x = np.ascontiguousarray(numbers(series, f"the series of {what}"))
    if np.ndim(series) != 1:
        raise ValueError(f"{what} needs one series, shape (n,), found shape {x.shape}. Pass one column.")
    if np.any(np.isinf(x)):
        raise ValueError(f"{what}: {int(np.isinf(x).sum())} samples are infinite. Replace them with NaN (missing).")
    missing = int(np.isnan(x).sum())
    if missing and missing == x.size:
        raise ValueError(f"{what}: all {x.size} samples are NaN.")
    if missing and not gaps:
        raise ValueError(f"{what}: {missing} of {x.size} samples are NaN. Cut them out, or interpolate.")
    if x.size - missing < least:
        raise ValueError(f"{what} needs at least {least} samples, found {x.size - missing}. Lower the order.")
    return x


def _centred(series: ArrayLike, order: int, what: str) -> tuple[Array, float]:
    """The series minus its mean and over its sd, and that sd; refused when constant."""
    if order < 0 or order != int(order):
        raise ValueError(f"the order must be a whole number, at least 0, found {order}.")
    x = tidy_series(series, max(2 * order + 2, 4), what)
    x = x - x.mean()
    x = x - x.mean()
    top = float(np.abs(x).max())
    if top == 0.0:
        raise ValueError(f"{what}: the series is constant, it has no error to model.")
    x = x / top
    sd = math.sqrt(float(x @ x) / x.size)
    return x / sd, sd * top


def yule_walker(series: ArrayLike, order: int) -> ArmaModel:
    """AR model from the biased sample autocovariance (Yule 1927, Walker 1931); always stable.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; the mean is removed.
    order : int
        Number of AR coefficients.
    """
    x, sd = _centred(series, order, "yule_walker")
    gamma, ar, pacf = np.empty(order + 1), np.zeros(order), np.empty(order)
    kernels.lag_products(x, x, gamma)
    power = kernels.levinson(gamma / x.size, ar, pacf)
    return ArmaModel(ar, np.zeros(0), sd * math.sqrt(max(power, 0.0)))


def burg(series: ArrayLike, order: int) -> ArmaModel:
    """AR model by Burg's method (1967): forward and backward prediction errors, always stable, little bias.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; the mean is removed.
    order : int
        Number of AR coefficients.
    """
    x, sd = _centred(series, order, "burg")
    ar = np.zeros(order)
    power = kernels.burg_recursion(x, ar)
    return ArmaModel(ar, np.zeros(0), sd * math.sqrt(max(power, 0.0)))


def hannan_rissanen(series: ArrayLike, p: int, q: int, long_order: int | None = None) -> ArmaModel:
    """ARMA model in two regressions (Hannan and Rissanen 1982): a long AR gives residuals, which serve as inputs.

    A start value, not an estimate to hand on: with zeros near the unit circle its excess prediction error is many
    times the attainable one. Roots outside the circle are reflected and all are held inside radius 0.995.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; the mean is removed.
    p, q : int
        Orders.
    long_order : int, optional
        Order of the first AR; by default grows with ln n and with p + q.
    """
    x, sd = _centred(series, p + q, "hannan_rissanen")
    if long_order is None:
        long_order = default_long_order(x.size, p, q)
    theta = hannan_rissanen_start(x, p, q, long_residuals(x, long_order))
    e = np.empty_like(x)
    r = max(p, q, 1)
    a, c = np.zeros(r), np.zeros(r)
    a[:p], c[:q] = theta[:p], theta[p:]
    kernels.arma_filter(x, a, c, np.zeros(r), e)
    return ArmaModel(theta[:p], theta[p:], sd * math.sqrt(float(e @ e) / e.size))


def default_long_order(n: int, p: int, q: int) -> int:
    """Order of the first AR of Hannan and Rissanen: a little faster than ln n, and enough for p + q."""
    return max(min(max(int(1.3 * math.log(n) ** 1.3), 6 * (p + q)), n // 4), 1)


def long_residuals(x: Array, order: int) -> Array:
    """Residuals of a Burg AR of the given order."""
    ar, e = np.zeros(order), np.empty_like(x)
    kernels.burg_recursion(x, ar)
    kernels.arma_filter(x, ar, np.zeros(order), np.zeros(order), e)
    e[:order] = 0.0
    return e


def hannan_rissanen_start(x: Array, p: int, q: int, e: Array) -> Array:
    """Second stage: regression of x on its own past and on past residuals `e`; returns ``[ar, ma]``, made stable."""
    n = p + q
    if not n:
        return np.zeros(0)
    A, right = np.empty((n, n)), np.empty(n)
    own, drive, cross = np.empty((p + 1, p + 1)), np.empty((q + 1, q + 1)), np.empty((p + 1, q + 1))
    kernels.shift_gram(x, x, 0, own)
    kernels.shift_gram(e, e, 0, drive)
    kernels.shift_gram(x, e, 0, cross)
    A[:p, :p], A[p:, p:] = own[1:, 1:], drive[1:, 1:]
    A[:p, p:], A[p:, :p] = -cross[1:, 1:], -cross[1:, 1:].T
    right[:p], right[p:] = -own[0, 1:], cross[0, 1:]
    solution = np.asarray(np.linalg.lstsq(A, right, rcond=1e-12)[0], dtype=np.float64)
    return np.r_[pull_inside(solution[:p]), pull_inside(solution[p:])]

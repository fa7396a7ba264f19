"""Intervals over the runs of a campaign. Within a run the errors depend on each other; the runs do not."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from navfilter.foundation.arrays import Array, Ints

#: Value, lower end, upper end.
Estimate = tuple[float, float, float]

RESAMPLES = 4000
#: All intervals hold 95 %.
_TAILS = (0.5 - 0.5 * 0.95, 0.5 + 0.5 * 0.95)
_NOTHING: Estimate = (math.nan, math.nan, math.nan)


def mean_interval(values: ArrayLike) -> Estimate:
    """Mean over runs with its interval by Student's t.

    Parameters
    ----------
    values : array_like, shape (n,)
        One per run; NaN is left out.

    Returns
    -------
    value, low, high : float
        No interval (NaN) for a single run.

    Examples
    --------
    >>> [round(v, 4) for v in mean_interval([1.0, 2.0, 3.0])]
    [2.0, -0.4841, 4.4841]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    mean = float(x.mean())
    if x.size == 1:
        return mean, math.nan, math.nan
    half = float(stats.t.ppf(_TAILS[1], x.size - 1) * x.std(ddof=1) / math.sqrt(x.size))
    return mean, mean - half, mean + half


def rms_interval(values: ArrayLike) -> Estimate:
    """Root mean square over runs of their root mean squares, with its percentile bootstrap interval (Efron &
    Tibshirani, 1993, ch. 13).
    """
    return ratio_interval(values, np.ones_like(values, dtype=np.float64))


def ratio_interval(values: ArrayLike, others: ArrayLike) -> Estimate:
    """Ratio of the root mean squares of two models over the same missions, resampled in pairs.

    Parameters
    ----------
    values, others : array_like, shape (n,)
        Of the model and of the one that it is compared with, run by run; a run that one of them lacks (NaN) is left
        out.

    Returns
    -------
    value, low, high : float

    Examples
    --------
    >>> ratio_interval([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    (0.5, 0.5, 0.5)
    """
    a, b = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"the two models must have the same runs, found {a.shape} and {b.shape}.")
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both] ** 2, b[both] ** 2
    if a.size == 0 or not b.any():
        return _NOTHING
    value = math.sqrt(a.mean() / b.mean())
    if a.size == 1:
        return value, math.nan, math.nan
    pick = _resampled(a.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sqrt(a[pick].mean(axis=1) / b[pick].mean(axis=1))
    low, high = np.quantile(ratios, _TAILS)
    return value, float(low), float(high)


def share_interval(values: ArrayLike) -> Estimate:
    """Share of the runs for which something holds (1, not 0), with Wilson's interval (1927).

    Examples
    --------
    >>> [round(v, 4) for v in share_interval([1, 1, 1, 0])]
    [0.75, 0.3006, 0.9544]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    n, p, z = x.size, float(x.mean()), float(stats.norm.ppf(_TAILS[1]))
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return p, max(centre - half, 0.0), min(centre + half, 1.0)


def estimate(quantity: str, values: ArrayLike) -> Estimate:
    """A figure of a campaign by its kind: a root mean square, a share of the runs, or a mean."""
    if "rms" in quantity or quantity == "end_m":
        return rms_interval(values)
    if quantity in ("white", "adopted"):
        return share_interval(values)
    value, low, high = mean_interval(values)
    # with few runs Student's interval does not know that no figure is negative, and that no share is more than all
    most = 1.0 if quantity.startswith("beyond") else math.inf
    return value, max(low, 0.0) if math.isfinite(low) else low, min(high, most) if math.isfinite(high) else high


def interval_text(value: float, low: float = math.nan, high: float = math.nan, form: str = ".3f") -> str:
    """A value with its interval, as far as there are any.

    Examples
    --------
    >>> interval_text(1.0, 0.5, 2.0, ".1f"), interval_text(1.0), interval_text(math.nan)
    ('1.0 (0.5..2.0)', '1.000', '-')
    """
    if not math.isfinite(value):
        return "-"
    return format(value, form) + (f" ({format(low, form)}..{format(high, form)})" if math.isfinite(low) else "")


def _finite(values: ArrayLike) -> Array:
    x = np.asarray(values, dtype=np.float64).ravel()
    return x[np.isfinite(x)]


def _resampled(n: int) -> Ints:
    """Rows of resampled runs; the same ones every time, so that a table can be made again."""
    return np.random.default_rng(20030501).integers(0, n, size=(RESAMPLES, n))

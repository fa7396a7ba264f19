"""Long series thinned so that what is drawn looks the same."""

from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array

#: A line gets two points, lowest and highest, for each of so many stretches: about one stretch per pixel.
STRETCHES = 400


def broken(time_s: Array, *values: Array) -> Any:
    """Insert a NaN in every long gap of one or more series over the same times, so that no line is drawn across it.

    Returns
    -------
    time_s, values... : tuple of ndarray
        As many series as were given.
    """
    if len(time_s) < 3:
        return (time_s, *values)
    step = np.diff(time_s)
    gap = np.flatnonzero(step > max(8.0 * float(np.median(step)), 0.004 * (time_s[-1] - time_s[0])))
    middle = 0.5 * (time_s[gap] + time_s[gap + 1])
    return np.insert(time_s, gap + 1, middle), *(np.insert(value, gap + 1, np.nan) for value in values)


def _stretches(value: Array, stretches: int, fill: float) -> Array:
    size = -(-len(value) // stretches)
    padded = np.full(stretches * size, fill)
    padded[: len(value)] = np.where(np.isfinite(value), value, fill)
    return padded.reshape(stretches, size)


def envelope(time: Array, value: Array, stretches: int = STRETCHES) -> tuple[Array, Array]:
    """Thin a series to the lowest and the highest point of every stretch; what is drawn looks the same.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
    stretches : int
        Stretches of equal numbers of points.

    Returns
    -------
    time, value : ndarray, shape (m,)
        m <= 4 stretches; the first NaN of every gap is kept, so that gaps stay gaps.

    Examples
    --------
    >>> t = np.arange(10_000.0)
    >>> thin_t, thin = envelope(t, np.where(t == 5000, 9.0, 0.0), stretches=100)
    >>> len(thin) <= 400, float(thin.max())
    (True, 9.0)
    """
    n = len(time)
    if n <= 4 * stretches:
        return time, value
    low, high = _stretches(value, stretches, np.inf), _stretches(value, stretches, -np.inf)
    size = low.shape[1]
    index = (
        np.sort(np.stack([low.argmin(axis=1), high.argmax(axis=1)], axis=1), axis=1)
        + size * np.arange(stretches)[:, None]
    )
    missing = ~np.isfinite(value)
    gaps = np.flatnonzero(missing & ~np.concatenate([[False], missing[:-1]]))[:stretches]
    index = np.unique(np.concatenate([np.minimum(index, n - 1).ravel(), gaps]))
    return time[index], value[index]


def extremes(time: Array, low: Array, high: Array, stretches: int = STRETCHES) -> tuple[Array, Array, Array]:
    """Thin a band to the outermost edges of every stretch."""
    n = len(time)
    if n <= 2 * stretches:
        return time, low, high
    bottom, top = _stretches(low, stretches, np.inf).min(axis=1), _stretches(high, stretches, -np.inf).max(axis=1)
    size = -(-n // stretches)
    middle = np.minimum(np.arange(stretches) * size + size // 2, n - 1)
    gone = ~(np.isfinite(bottom) & np.isfinite(top))
    bottom[gone] = top[gone] = np.nan
    inside = np.arange(stretches) * size < n
    return time[middle][inside], bottom[inside], top[inside]


def straightened(x: Array, y: Array, tolerance: float) -> tuple[Array, Array]:
    """Leave out points that a straight line between their neighbours replaces.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        NaN rows stay.
    tolerance : float
        Each pass moves the line by less than this, in the unit of y. There are at most four, so that of sixteen points
        at least one stays: what scales itself to the points in view finds some.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> len(straightened(x, 2.0 * x, 0.1)[0]) < 100
    True
    """
    for _ in range(4):
        n = len(x)
        if n < 4:
            break
        middle = np.arange(1, n - 1, 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = (x[middle] - x[middle - 1]) / (x[middle + 1] - x[middle - 1])
            off = np.abs(y[middle - 1] + share * (y[middle + 1] - y[middle - 1]) - y[middle])
        keep = np.ones(n, bool)
        keep[middle[off < tolerance]] = False  # not of a NaN
        if keep.all():
            break
        x, y = x[keep], y[keep]
    return x, y

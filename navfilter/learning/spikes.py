"""Single readings that stand out from their neighbours: nothing is learnt from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["without_spikes"]

Array = NDArray[np.float64]
#: A sample so many robust deviations from its neighbours is a spike.
SPIKE = 8.0


def without_spikes(series: Array) -> Array:
    """A copy with NaN where a sample stands out from the median of the five around it by more than `SPIKE` robust
    deviations.

    The filter's gate cannot do this: it judges by what is believed of the sensor, which is what is to be learnt.
    """
    result = np.array(series, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(result))
    if known.size < 5:
        return result
    # the drift may run away by metres per tick: most of it is a low polynomial, and what that leaves is smooth
    y = result[known]
    place = (known - known[0]) * (2.0 / (known[-1] - known[0])) - 1.0
    basis = np.polynomial.chebyshev.chebvander(place, 5)
    y -= basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ y, rcond=None)[0]
    padded = np.concatenate([y[[2, 1]], y, y[[-2, -3]]])
    size = np.abs(y - _middle(*(padded[i : i + y.size] for i in range(5))))
    # where most samples equal their median (quantised readings), the mean of the others says how much is ordinary
    median, most = np.interp([0.5 * (y.size - 1), 0.99 * (y.size - 1)], np.arange(y.size), np.sort(size))
    scale = max(1.4826 * float(median), float(np.mean(np.minimum(size, most))))
    result[known[size > SPIKE * scale]] = np.nan
    return result


def _middle(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    """Median of each five."""
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))

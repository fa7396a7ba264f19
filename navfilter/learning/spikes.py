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
    # the drift may run away by metres per tick: most of it is a low polynomial
    place = known / max(float(known[-1]), 1.0) * 2.0 - 1.0
    y = result[known]
    basis = np.polynomial.chebyshev.chebvander(place, 5)
    y = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    padded = np.concatenate([y[[2, 1]], y, y[[-2, -3]]])
    off = y - _middle(*(padded[i : i + y.size] for i in range(5)))
    size = np.abs(off)
    # where most samples equal their median (quantised readings), the mean of the others says how much is ordinary
    scale = max(float(np.median(size)) * 1.4826, float(np.mean(np.minimum(size, np.quantile(size, 0.99)))))
    result[known[size > SPIKE * scale]] = np.nan
    return result


def _middle(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    """Median of each five."""
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))

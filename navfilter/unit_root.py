"""Does a pole of an ARMA model belong to a random-walk bias?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["has_unit_root"]

# One per cent points of the t statistic of a unit root, with and without an estimated mean (Fuller 1976, table 8.5.2):
# a slow pole taken for a bias does little harm, a bias taken for a slow pole gets a correlation time far too short.
WITH_MEAN, WITHOUT_MEAN = -3.43, -2.58


def has_unit_root(ar: ArrayLike, covariance: ArrayLike, window: float, mean: bool = True) -> bool:
    """Whether the slowest real pole cannot be told from 1 with `window` samples.

    True for a pole above ``1 - 3/window``, and for a pole above ``1 - 20/window`` (a correlation time longer than a
    twentieth of the window) when the Dickey-Fuller t test on A(1) does not reject the unit root at 1 %. A bias state
    describes such a pole better: a stationary model fitted to it has its correlation time too short.

    Parameters
    ----------
    ar : array_like, shape (p,)
        Autoregressive coefficients.
    covariance : array_like, shape (p, p) or larger
        Their covariance (leading block).
    window : float
        Number of samples behind them.
    mean : bool
        Whether a mean was estimated along.

    Examples
    --------
    >>> has_unit_root([-0.999], [[1e-6]], 4000), has_unit_root([-0.95], [[2.5e-5]], 4000)
    (True, False)
    """
    a = np.asarray(ar, dtype=np.float64)
    if a.size == 0:
        return False
    poles = np.roots(np.r_[1.0, a])
    real = poles[np.abs(poles.imag) < 1e-9].real
    largest = float(real.max()) if real.size else -1.0
    if largest > 1.0 - 3.0 / window:
        return True
    if largest < 1.0 - 20.0 / window:
        return False
    at_one = 1.0 + float(a.sum())
    spread = math.sqrt(max(float(np.asarray(covariance, dtype=np.float64)[: a.size, : a.size].sum()), 0.0))
    return -at_one > (WITH_MEAN if mean else WITHOUT_MEAN) * spread

"""Does a pole of an ARMA model belong to a random-walk bias, and what is left when the bias takes it?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.arma.algebra import spectral_factor
from navfilter.arma.model import ArmaModel, log_s0_sd

__all__ = ["cap_poles", "has_unit_root", "split_bias"]

Array = NDArray[np.float64]

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


def split_bias(model: ArmaModel) -> tuple[float, ArmaModel]:
    """Split a model with a pole at (or near) 1 into a random-walk bias and the independent rest.

    The slowest real pole is taken as 1. Then ``sd^2 |C|^2 / |A|^2 = walk_sd^2 / |1 - z|^2 + |N|^2 / |A'|^2`` with
    ``walk_sd = sd C(1) / A'(1)``; the rest's moving average N is the spectral factor of what remains. For ARMA(1, 1)
    it is random walk + white noise (Muth 1960).

    Parameters
    ----------
    model : ArmaModel
        With at least one real positive pole.

    Returns
    -------
    walk_sd : float
        Standard deviation of the walk's step per sample.
    rest : ArmaModel
        Independent of the walk, with its covariance carried over to first order; ``sd`` 0 if nothing remains.

    Raises
    ------
    ValueError
        If no such sum has the model's spectrum (the rest would need a negative power somewhere).

    Examples
    --------
    >>> walk_sd, rest = split_bias(ArmaModel([-1.0], [-0.9], 1.0))
    >>> round(walk_sd, 6), rest.p, rest.q, round(rest.sd, 6)
    (0.1, 0, 0, 0.948683)
    """
    walk_sd, ar, ma, sd = _split(model.ar, model.ma, model.sd)
    if model.covariance is None:
        return walk_sd, ArmaModel(ar, ma, sd, None, None, model.effective_window, model.flags)
    theta, p = np.r_[model.ar, model.ma], model.p
    jacobian = np.zeros((ar.size + ma.size, theta.size))
    for i in range(theta.size):
        # Towards a larger white part for the pole, away from the boundary of what can be split.
        step = 1e-6 * max(1.0, abs(theta[i]))
        try:
            other = theta + step * (np.arange(theta.size) == i)
            moved = _split(other[:p], other[p:], model.sd)
        except ValueError:
            continue
        jacobian[:, i] = (np.r_[moved[1], moved[2]] - np.r_[ar, ma]) / step
    covariance = jacobian @ model.covariance @ jacobian.T
    window = model.effective_window or 1.0
    spread = log_s0_sd(ar, ma, covariance, window)
    return walk_sd, ArmaModel(ar, ma, sd, covariance, spread, model.effective_window, model.flags)


def _split(ar: Array, ma: Array, sd: float) -> tuple[float, Array, Array, float]:
    poles = np.roots(np.r_[1.0, ar])
    real = np.flatnonzero((np.abs(poles.imag) < 1e-9) & (poles.real > 0.0))
    if real.size == 0:
        raise ValueError(f"no real positive pole to split off, found {poles}.")
    others = np.delete(poles, real[np.argmax(poles[real].real)])
    rest = np.atleast_1d(np.poly(others)).real
    lead = np.r_[1.0, ma]
    walk = float(lead.sum() / rest.sum())
    reach = max(lead.size, rest.size) - 1
    power = np.zeros(2 * reach + 1)
    for poly, weight in ((lead, 1.0), (rest, -(walk**2))):
        both = weight * np.convolve(poly, poly[::-1])
        power[reach - poly.size + 1 : reach + poly.size] += both
    if reach == 0:
        return abs(walk) * sd, rest[1:], np.zeros(0), 0.0
    quotient = np.polydiv(power, np.array([-1.0, 2.0, -1.0]))[0]
    numerator, scale = spectral_factor(quotient[reach - 1 :])
    return abs(walk) * sd, rest[1:], numerator, scale * sd


def cap_poles(ar: ArrayLike, radius: float) -> Array:
    """Coefficients with every pole beyond `radius` pulled back to it."""
    poles = np.roots(np.r_[1.0, np.asarray(ar, dtype=np.float64)])
    size = np.maximum(np.abs(poles), 1e-300)
    return np.atleast_1d(np.poly(poles * np.minimum(1.0, radius / size))).real[1:]

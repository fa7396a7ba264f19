"""The spectrum of a learnt error, with its uncertainty."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike

#: A logarithm that is known no better than this is not known: at a notch first order says anything.
LARGEST_SPREAD = 10.0


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density of a learnt error over its posterior.

    Attributes
    ----------
    frequency_hz : tuple of float
        From half a cycle in the window up to half the sensor's rate [Hz].
    low, median, high : tuple of float
        One-sided density that the posterior is below with a probability of 5, 50 and 95 % [unit^2/Hz].
    sd_log_s0 : float
        Standard deviation of the logarithm at the lowest frequency.
    """

    POINTS: ClassVar[int] = 40

    frequency_hz: tuple[float, ...]
    low: tuple[float, ...]
    median: tuple[float, ...]
    high: tuple[float, ...]
    sd_log_s0: float

    @classmethod
    def weighted(cls, frequency_hz: Array, density: Array, weight: Array) -> "Spectrum":
        """Of spectra, shape (n, frequencies), with weights whose sum is one."""
        low, median, high = (tuple(each) for each in quantiles(density, weight, (0.05, 0.5, 0.95)).tolist())
        log = np.log(np.maximum(density[:, 0], 1e-300))
        spread = float(np.sqrt(max(weight @ log**2 - float(weight @ log) ** 2, 0.0)))
        return cls(tuple(frequency_hz.tolist()), low, median, high, spread)


def quantiles(density: Array, weight: Array, shares: ArrayLike) -> Array:
    """Of each column of an array, shape (n, columns), those below which these shares of the weights lie, which together
    are one; shape (shares, columns).
    """
    at = np.ascontiguousarray(density.T)
    order = np.argsort(at, axis=1)
    sums = np.cumsum(weight[order], axis=1)
    ranks = np.minimum((sums[:, None] < np.reshape(shares, (-1, 1))).sum(axis=2), len(weight) - 1)
    return np.take_along_axis(at, np.take_along_axis(order, ranks, axis=1), axis=1).T


def log_spread(ar: Array, ma: Array, covariance: Array, turn: Array) -> Array:
    """Standard deviation of the logarithm of an ARMA spectrum, shape (n,).

    Parameters
    ----------
    ar, ma : ndarray, shapes (p,) and (q,)
    covariance : ndarray, shape (p+q+1, p+q+1)
        Of ``[ar, ma, ln sd]``.
    turn : ndarray, shape (n,)
        Angular frequencies [rad/sample].

    Notes
    -----
    To first order: ``ln S = 2 ln sd + 2 ln |C| - 2 ln |A|`` varies with the coefficients by ``2 Re(z^-k / C)`` and ``-2
    Re(z^-k / A)``.
    """
    z = np.exp(-1j * turn)
    by = [
        sign * 2.0 * np.real(z**k / np.polynomial.polynomial.polyval(z, np.r_[1.0, coefficients]))
        for sign, coefficients in ((-1.0, ar), (1.0, ma))
        for k in range(1, len(coefficients) + 1)
    ]
    gradient = np.array([*by, np.full(len(turn), 2.0)])
    variance = np.einsum("in,ij,jn->n", gradient, covariance, gradient)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, LARGEST_SPREAD**2)))

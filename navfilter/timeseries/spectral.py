"""Spectral factorisation: the moving average that has a given autocovariance."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from navfilter.foundation.arrays import Array

#: Largest misfit of a factor, relative to lag 0: beyond it there is none.
ACCEPTED = 1e-6
#: A factor that fits worse than this is looked for once more, its zeros on the unit circle taken out first.
RETRIED = 1e-9
#: Zeros are on the circle where taking them out leaves no more than this, relative to lag 0: rounding.
ON_CIRCLE = 1e-12


def spectral_factor(autocovariance: ArrayLike) -> tuple[Array, float]:
    """Invertible moving average with a given autocovariance.

    Newton's method of G. Wilson (SIAM J. Numer. Anal. 6, 1969): quadratic, and from its start every iterate keeps
    all zeros inside the circle. A multiple zero on the circle makes its equations singular; such zeros are found by
    themselves and divided out, and the method is applied to what is left.

    Parameters
    ----------
    autocovariance : array_like, shape (q+1,)
        Lags 0 ... q; all further lags are zero.

    Returns
    -------
    ma : ndarray, shape (q,)
        Coefficients with zeros inside or on the unit circle.
    sd : float
        Standard deviation of the innovation.

    Raises
    ------
    ValueError
        When no moving average of order q has this autocovariance.

    Examples
    --------
    >>> ma, sd = spectral_factor([20.0, -15.0, 6.0, -1.0])
    >>> ma.round(6), round(sd, 6)
    (array([-3.,  3., -1.]), 1.0)
    """
    gamma = np.array(autocovariance, dtype=np.float64)
    n = gamma.size
    if n == 0 or not np.all(np.isfinite(gamma)) or gamma[0] <= 0.0:
        raise ValueError("the autocovariance must be finite and positive at lag 0.")
    scale = gamma[0]
    gamma = gamma / scale
    c = _newton(gamma)
    if not _misfit(c, gamma) < RETRIED:
        circle, rest = _without_circle_zeros(gamma)
        if circle.size > 1 and rest[0] > 0.0:
            c = min(c, np.convolve(circle, _newton(rest)), key=lambda found: _misfit(found, gamma))
    worst = _misfit(c, gamma)
    if not worst < ACCEPTED:
        raise ValueError(f"not an autocovariance: no moving average of order {n - 1} has it (misfit {worst:.1e}).")
    return c[1:] / c[0], float(c[0] * np.sqrt(scale))


def _products(c: Array) -> Array:
    """Autocovariance of ``c0 + c1 q^-1 + ...``, shape (n,)."""
    return np.array([c[: c.size - k] @ c[k:] for k in range(c.size)])


def _misfit(c: Array, gamma: Array) -> float:
    worst = float(np.abs(_products(c) - gamma).max())
    return worst if np.isfinite(worst) else np.inf


def _newton(gamma: Array) -> Array:
    """Wilson's iteration: ``c0 + c1 q^-1 + ...`` with this autocovariance, as far as it converges."""
    n = gamma.size
    c = np.zeros(n)
    c[0] = 1.0
    for _ in range(200):
        lead = np.array([[c[j - i] if j >= i else 0.0 for j in range(n)] for i in range(n)])
        lag = np.array([[c[i + j] if i + j < n else 0.0 for j in range(n)] for i in range(n)])
        try:
            new = np.linalg.solve(lead + lag, gamma + _products(c))
        except np.linalg.LinAlgError:
            break
        change, c = np.abs(new - c).max(), new
        if change < 1e-15:
            break
    return c


# ---------------------------------------------------------------- zeros on the circle


def _without_circle_zeros(gamma: Array) -> tuple[Array, Array]:
    """Polynomial of the zeros on the unit circle, and the autocovariance that they leave over.

    As a polynomial of x = cos w the spectrum touches zero there: a zero at 1 or -1 is a root at an end of [-1, 1], and
    a pair of multiplicity m a root of multiplicity 2m between, where the derivative of order 2m - 1 has a simple one.
    """
    circle, rest = np.ones(1), gamma
    for degree in range(gamma.size - 1, 0, -1):
        while (taken := _multiple_zero(rest, degree)) is not None:
            circle, rest = np.convolve(circle, taken[0]), taken[1]
    return circle, rest


def _multiple_zero(gamma: Array, degree: int) -> tuple[Array, Array] | None:
    """One multiple zero on the circle, as a polynomial of this degree, and what is left without it; None if there is
    none.
    """
    if degree >= gamma.size:
        return None
    factors = [_power([1.0, -1.0], degree), _power([1.0, 1.0], degree)]
    if degree % 2 == 0:
        roots = chebyshev.chebroots(chebyshev.chebder(np.r_[gamma[0], 2.0 * gamma[1:]], degree - 1))
        between = roots[(roots.imag == 0.0) & (np.abs(roots) < 1.0)].real
        factors += [_power([1.0, -2.0 * x, 1.0], degree // 2) for x in between]
    for factor in factors:
        quotient, left = _divided(gamma, factor)
        if left < ON_CIRCLE * gamma[0]:
            return factor, quotient
    return None


def _power(factor: list[float], times: int) -> Array:
    product = np.ones(1)
    for _ in range(times):
        product = np.convolve(product, factor)
    return product


def _divided(gamma: Array, factor: Array) -> tuple[Array, float]:
    """Autocovariance of what gives `gamma` when filtered by `factor`, by least squares, and the largest misfit."""
    both = np.convolve(factor, factor[::-1])
    n, order = gamma.size, factor.size - 1
    table = np.zeros((2 * n - 1, n - order))
    for k in range(n - order):
        for lag in {k, -k}:
            first = n - 1 + lag - order
            table[first : first + both.size, k] += both
    wanted = np.r_[gamma[:0:-1], gamma]
    quotient = np.asarray(np.linalg.lstsq(table, wanted, rcond=None)[0], dtype=np.float64)
    return quotient, float(np.abs(table @ quotient - wanted).max())

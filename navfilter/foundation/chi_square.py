"""Limits of chi-square."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv


def chi_square_limit(probability: float, dof: ArrayLike) -> NDArray[np.float64]:
    """What chi-square stays below with this probability.

    To the last bit `scipy.stats.chi2.ppf`, whose package takes longer to import than all of navfilter.

    Parameters
    ----------
    probability : float
    dof : int or array of int
        Degrees of freedom.

    Returns
    -------
    ndarray
        Of the shape of `dof`.

    Examples
    --------
    >>> round(float(chi_square_limit(0.95, 3)), 3)
    7.815
    """
    return np.asarray(2.0 * gammaincinv(np.asarray(dof) / 2.0, probability))


def chi_square_range(dof: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where 95 % of the means of chi-square per degree of freedom lie: low, high (Bar-Shalom et al., 2001, sec. 5.4).

    Examples
    --------
    >>> [round(float(v), 2) for v in chi_square_range(50)]
    [0.65, 1.43]
    """
    freedom = np.asarray(dof)
    return chi_square_limit(0.025, freedom) / freedom, chi_square_limit(0.975, freedom) / freedom

"""Gauss-Markov processes of equal poles, taken from continuous time to a sensor's period."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from navfilter.foundation.arrays import Array

#: Time constants in a period, beyond which it is no longer: nothing is left of the process then.
LONGEST = 350.0


@lru_cache(maxsize=256)
def gauss_markov(n: int, sd: float, step: float) -> tuple[Array, Array, Array]:
    """Transition, noise of one period and stationary covariance of a process of order n; its state has the error and
    its derivatives in time constants.

    Asked for at each change of the layout, and by learners under way, who find orders 1 and 2: these are in closed
    form, for no import may hold up the navigation. Above it is Van Loan's method (IEEE Trans. AC 23, 1978).

    Parameters
    ----------
    n : int
    sd : float
    step : float
        Period, in time constants of the poles.
    """
    step = min(step, LONGEST)
    P0 = _stationary(n) * sd**2
    if n == 1:
        return np.array([[math.exp(-step)]]), np.array([[-math.expm1(-2.0 * step) * sd**2]]), P0
    if n == 2:
        return *_second_order(sd**2, step), P0
    if step > 2.0:
        # Van Loan's matrix holds exp(+step), which swallows all digits of Q when much decays between two samples;
        # what has decayed is what the stationary variance makes up for. F has the one eigenvalue -1, so that the
        # series of exp((F + 1) step) ends.
        N = _dynamics(n) + np.eye(n)
        terms = [np.linalg.matrix_power(N, k) * (step**k / math.factorial(k)) for k in range(n)]
        Phi = math.exp(-step) * np.sum(terms, axis=0)
        Q = P0 - Phi @ P0 @ Phi.T
    else:
        from filterpy.common import van_loan_discretization  # costs half a second to import

        # White noise of this spectral density drives the last state; the process then has this variance (thesis
        # eq 2.42, corrected).
        density = sd**2 * 2.0 ** (2 * n - 1) * math.factorial(n - 1) ** 2 / math.factorial(2 * n - 2)
        Phi, Q = van_loan_discretization(_dynamics(n), math.sqrt(density) * np.eye(n)[:, -1:], step)
    return np.ascontiguousarray(Phi), np.ascontiguousarray((Q + Q.T) / 2), P0


def _dynamics(n: int) -> Array:
    F = np.diag(np.ones(n - 1), 1)
    F[-1] = [-math.comb(n, k) for k in range(n)]
    return F


def _second_order(variance: float, step: float) -> tuple[Array, Array]:
    """Elements of Q are integrals of ``g_i g_j``, ``g = [u exp(-u), (1 - u) exp(-u)]``, from 0 to `step`, times the
    spectral density ``4 variance``.
    """
    decay, twice = math.exp(-step), 2.0 * step
    # what exp(2 step) is above the beginning of its series: by its terms where the difference would cancel
    if twice < 2.0:
        above = sum(twice**k / math.factorial(k) for k in range(3, 24))
    else:
        above = math.exp(twice) - 1.0 - twice - twice**2 / 2.0
    value, cross = above * decay**2, 2.0 * (step * decay) ** 2
    Q = variance * np.array([[value, cross], [cross, value + 4.0 * step * decay**2]])
    return decay * np.array([[1.0 + step, step], [-step, 1.0 - step]]), Q


def _stationary(n: int) -> Array:
    """Stationary covariance of the scaled states for unit variance: E[x^(i) x^(j)] = (-1)^j R^(i+j)(0), odd derivatives
    vanish.
    """
    # Partial moments of the spectrum 1/(1 + w^2)^n: m_2k = integral of w^2k S(w), ratio by the beta function.
    moment = [math.gamma(k + 0.5) * math.gamma(n - k - 0.5) / (math.gamma(0.5) * math.gamma(n - 0.5)) for k in range(n)]
    P = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            if (i + j) % 2 == 0:
                P[i, j] = (-1.0) ** ((j - i) // 2) * moment[(i + j) // 2]
    return P

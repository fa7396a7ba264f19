"""State forms of an ARMA process, and the covariance that a stable one settles at."""

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from navfilter.foundation.arrays import Array


def observer(a: Array, c: Array) -> tuple[Array, Array]:
    """Transition M and input g of the observer form ``z+ = M z + g e``, ``y = z[0] + e``; a and c of the same
    length.
    """
    M = np.eye(a.size, k=1)
    M[:, :1] -= a[:, None]
    return M, c - a


def stationary_covariance(Phi: Array, Q: Array) -> Array:
    """Solution of ``P = Phi P Phi' + Q``, symmetric to the last bit."""
    P = solve_discrete_lyapunov(Phi, Q)
    return np.ascontiguousarray(0.5 * (P + P.T))


def settled(M: Array, Q: Array) -> Array:
    """The same as a sum ``Q + M Q M' + ...`` by doubling: exact to rounding with poles however near to the circle,
    where solving is not.
    """
    P, power = Q, M
    # after k rounds P holds 2^k terms; 60 rounds exceed any memory
    for _ in range(60):
        more = power @ P @ power.T
        P = P + more
        if not np.any(np.abs(more) > 1e-17 * np.abs(P).max(initial=0.0)):
            break
        power = power @ power
    return P

"""How likely a model makes the sums of a series over stretches of time, for `navfilter.learning.mixture`."""

import math

import numpy as np

from navfilter.kernels import arma_fit
from navfilter.kernels.compiling.decorators import njit


@njit(cache=True)
def _moved(A, P, noise, out, work):
    """A P A' and the noise into `out`, which may be P."""
    arma_fit.matrix_product(A, P, work)
    arma_fit.matrix_product_transposed(work, A, out)
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            out[i, j] += noise[i, j]


@njit(cache=True)
def _double(A, Q, work):
    """From the transition and noise of one tick, at 0, those of 2, 4, 8 ... ticks: A, Q (k, n, n)."""
    for k in range(1, A.shape[0]):
        arma_fit.matrix_product(A[k - 1], A[k - 1], A[k])
        _moved(A[k - 1], Q[k - 1], Q[k - 1], Q[k], work)


@njit(cache=True)
def sum_likelihood(y, length, skipped, F, Q, C, P, r):
    """Gaussian log-likelihood of the sums over each `length` ticks, with what the sums before have told, but for a
    constant; how many sums count: all but the first `skipped`, and those of ticks without a reading; and the log of the
    product of their variances.

    y (N,): NaN where there is no reading. F, Q, P (n, n), C (n,): transition over a tick, its noise, covariance of the
    start, what is read of the states; r: white variance of a reading.

    The states go on from stretch to stretch beside a sum that begins at 0 in each; only sums correct them.
    """
    n, most = F.shape[0], 1
    while 1 << most <= length:
        most += 1
    # without a reading, and with one: then the sum takes up what is read
    moves, noises = np.zeros((2, most, n + 1, n + 1)), np.zeros((2, most, n + 1, n + 1))
    sees, x, cov = np.zeros((n + 1, n + 1)), np.zeros(n + 1), np.zeros((n + 1, n + 1))
    then, work = np.empty(n + 1), np.empty((n + 1, n + 1))
    moves[0, 0, n, n] = sees[n, n] = 1.0
    for i in range(n):
        sees[i, i], sees[n, i] = 1.0, C[i]
        for j in range(n):
            moves[0, 0, i, j], noises[0, 0, i, j], cov[i, j] = F[i, j], Q[i, j], P[i, j]
    arma_fit.matrix_product(sees, moves[0, 0], moves[1, 0])
    _moved(sees, noises[0, 0], np.zeros((n + 1, n + 1)), noises[1, 0], work)
    _double(moves[0], noises[0], work)
    _double(moves[1], noises[1], work)
    total, count, logs, corrected = 0.0, 0, 0.0, 0
    for first in range(0, y.size - length + 1, length):
        t, end, read, summed = first, first + length, 0, 0.0
        while t < end:
            is_read, run = math.isfinite(y[t]), 0
            while t < end and math.isfinite(y[t]) == is_read:
                summed += y[t] if is_read else 0.0
                run, t = run + 1, t + 1
            read += run if is_read else 0
            which = 1 if is_read else 0
            for k in range(most):
                if run >> k & 1:
                    for i in range(n + 1):
                        then[i] = 0.0
                        for j in range(n + 1):
                            then[i] += moves[which, k, i, j] * x[j]
                    for i in range(n + 1):
                        x[i] = then[i]
                    _moved(moves[which, k], cov, noises[which, k], cov, work)
        if read:
            variance, e = cov[n, n] + read * r, summed - x[n]
            if corrected >= skipped:
                total -= 0.5 * (e * e / variance + math.log(variance))
                count, logs = count + 1, logs + math.log(variance)
            for i in range(n + 1):
                then[i] = cov[i, n] / variance
                x[i] += then[i] * e
            for i in range(n + 1):
                for j in range(n + 1):
                    cov[i, j] -= then[i] * then[j] * variance
            corrected += 1
        x[n] = 0.0
        for i in range(n + 1):
            cov[n, i] = cov[i, n] = 0.0
    return total, count, logs

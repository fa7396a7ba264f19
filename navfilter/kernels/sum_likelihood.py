"""How likely a model makes the sums of a series over stretches of time, for `navfilter.learning.mixture`."""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import njit


@njit(cache=True)
def _powers(A, Q, most):
    """Transitions over 1, 2, 4 ... up to `most` ticks, and the noise that comes in by then."""
    transitions, noises, ticks = [A], [Q], 1
    while 2 * ticks <= most:
        ticks *= 2
        noises.append(transitions[-1] @ noises[-1] @ transitions[-1].T + noises[-1])
        transitions.append(transitions[-1] @ transitions[-1])
    return transitions, noises


@njit(cache=True)
def sum_likelihood(y, length, skipped, F, Q, C, P, r):
    """Gaussian log-likelihood of the sums over each `length` ticks, with what the sums before have told, but for a
    constant; and how many sums count: all but the first `skipped`, and those of ticks without a reading.

    y (N,): NaN where there is no reading. F, Q, P (n, n), C (n,): transition over a tick, its noise, covariance of the
    start, what is read of the states; r: white variance of a reading.

    The states go on from stretch to stretch beside a sum that begins at 0 in each; only sums correct them.
    """
    n = F.shape[0]
    move, sees, noise, cov = np.eye(n + 1), np.eye(n + 1), np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for i in range(n):
        sees[n, i] = C[i]
        for j in range(n):
            move[i, j], noise[i, j], cov[i, j] = F[i, j], Q[i, j], P[i, j]
    missing, known = _powers(move, noise, length), _powers(sees @ move, sees @ noise @ sees.T, length)
    x, total, count, corrected = np.zeros(n + 1), 0.0, 0, 0
    for first in range(0, y.size - length + 1, length):
        t, end, read, summed = first, first + length, 0, 0.0
        while t < end:
            is_read, run = math.isfinite(y[t]), 0
            while t < end and math.isfinite(y[t]) == is_read:
                summed += y[t] if is_read else 0.0
                run, t = run + 1, t + 1
            read += run if is_read else 0
            transitions, noises = known if is_read else missing
            for k in range(len(transitions)):
                if run >> k & 1:
                    x = transitions[k] @ x
                    cov = transitions[k] @ cov @ transitions[k].T + noises[k]
        if read:
            variance, e = cov[n, n] + read * r, summed - x[n]
            if corrected >= skipped:
                total -= 0.5 * (e * e / variance + math.log(variance))
                count += 1
            gain = cov[:, n] / variance
            x = x + gain * e
            cov = cov - np.outer(gain, gain) * variance
            corrected += 1
        x[n] = 0.0
        for i in range(n + 1):
            cov[n, i] = cov[i, n] = 0.0
    return total, count

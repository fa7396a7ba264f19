"""One or two Gauss-Markov processes in place of the many that a posterior holds to be possible."""

from __future__ import annotations

import math

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.error_models import CORRELATION_CONSTANTS, GaussMarkov

#: Shares of the variance that the quicker process is tried with.
QUICK_SHARES = np.linspace(0.05, 0.95, 10)
#: So many correlation times are tried for it, by equal ratios.
QUICK_TIMES = 12
#: Frequencies that are compared, by equal ratios: from a tenth of the knee of the slowest process, where all are flat,
#: to three times that of the quickest, from where on all fall as they go on.
OCTAVES, BELOW, ABOVE = 17, 0.1, 3.0
#: One process does where two are no nearer by this [nat]: its spectrum is right within a tenth.
FITS = 0.005


def nearest(moments: Array) -> tuple[GaussMarkov, ...]:
    """At most two processes with the variance of a sum of many and its power at zero frequency, as near to its spectrum
    as can be.

    What is nearest is told by the divergence of Itakura and Saito (1968), `r - ln r - 1` of the ratio r of the true
    spectrum to that of the model: what a reading of the one costs in log-likelihood who believes in the other, and most
    where the model has too little. Each octave counts alike, for which of them matters depends on what else errs.

    Parameters
    ----------
    moments : ndarray, shape (m, 4)
        Order, correlation time [s], weight and mean variance [unit^2] of each.
    """
    order, tau, variance = moments[:, 0], moments[:, 1], moments[:, 2] * moments[:, 3]
    total = float(variance.sum())
    if not total > 0.0:
        return ()
    mean = float(variance @ tau) / total
    slowest, quickest = float(tau.max()), float(tau.min())
    first, last = BELOW / (2.0 * np.pi * slowest), ABOVE / (2.0 * np.pi * quickest)
    frequency = first * (last / first) ** np.linspace(0.0, 1.0, OCTAVES)
    # what is quicker than the mean ln tau, and what is slower: exact where there are two
    half = np.log(tau) <= float(variance @ np.log(tau)) / total + 1e-9  # of one alone but for rounding
    size = float(variance[half].sum())
    quick = quickest * (mean / quickest) ** np.linspace(0.0, 1.0, QUICK_TIMES).repeat(QUICK_SHARES.size)
    share, quick = (
        np.append(np.tile(QUICK_SHARES, QUICK_TIMES), size / total),
        np.append(quick, float(variance[half] @ tau[half]) / size),
    )
    slow = (mean - share * quick) / np.maximum(1.0 - share, 1e-300)
    share, quick, slow = (one[(slow <= slowest) & (slow > 0.0) & (share < 1.0)] for one in (share, quick, slow))
    # rows: what many are, one process, the quicker ones, the slower ones; of either order
    times, count = np.concatenate([[mean], quick, slow]), share.size
    kinds = np.repeat([1, 2], times.size)
    shapes = slow_psd(
        np.concatenate([order, kinds]), np.ones(tau.size + kinds.size), np.concatenate([tau, times, times]), frequency
    )
    truth, shapes = variance @ shapes[: tau.size] / total, shapes[tau.size :].reshape(2, times.size, OCTAVES)
    apart = _divergence(truth, shapes[:, 0])
    best = int(np.argmin(apart))
    both = share[:, None] * shapes[:, None, 1 : 1 + count] + (1.0 - share)[:, None] * shapes[None, :, 1 + count :]
    two = _divergence(truth, both)
    if not count or two.min() >= apart[best] - FITS:
        return (GaussMarkov(sd=math.sqrt(total), tau_s=mean, order=best + 1),)
    one, other, k = np.unravel_index(int(np.argmin(two)), two.shape)
    parts = (share[k], quick[k], one + 1), (1.0 - share[k], slow[k], other + 1)
    return tuple(GaussMarkov(math.sqrt(total * part), float(time_s), int(n)) for part, time_s, n in parts)


def _divergence(truth: Array, model: Array) -> Array:
    ratio = truth / model
    return np.asarray((ratio - np.log(ratio) - 1.0).mean(axis=-1), dtype=np.float64)


def slow_psd(order: Array, sd: Array, tau_s: Array, frequency_hz: Array) -> Array:
    """One-sided power spectral density of Gauss-Markov processes [unit^2/Hz], shape (nodes, frequencies)."""
    order, w2 = np.asarray(order, int), (2.0 * np.pi * np.asarray(frequency_hz)) ** 2
    beta = np.array([CORRELATION_CONSTANTS[1], CORRELATION_CONSTANTS[2]])[order - 1] / tau_s
    b, smooth = beta[:, None], order == 2
    found = np.square(sd)[:, None] * 4.0 * b / (b**2 + w2)
    found[smooth] *= 2.0 * b[smooth] ** 2 / (b[smooth] ** 2 + w2)
    return np.asarray(found, dtype=np.float64)

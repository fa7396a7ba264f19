"""One or two Gauss-Markov processes in place of the many that a posterior holds to be possible."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from navfilter.models.error_models import CORRELATION_CONSTANTS, GaussMarkov

Array = NDArray[np.float64]

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
    frequency = np.geomspace(BELOW / (2.0 * np.pi * slowest), ABOVE / (2.0 * np.pi * quickest), OCTAVES)
    truth = variance @ slow_psd(order, np.ones(tau.size), tau, frequency) / total
    # what is quicker than the mean ln tau, and what is slower: exact where there are two
    half = np.log(tau) <= float(variance @ np.log(tau)) / total + 1e-9  # of one alone but for rounding
    size = float(variance[half].sum())
    share, quick = (one.ravel() for one in np.meshgrid(QUICK_SHARES, np.geomspace(quickest, mean, QUICK_TIMES)))
    share, quick = np.append(share, size / total), np.append(quick, float(variance[half] @ tau[half]) / size)
    slow = (mean - share * quick) / np.maximum(1.0 - share, 1e-300)
    share, quick, slow = (one[(slow <= slowest) & (slow > 0.0) & (share < 1.0)] for one in (share, quick, slow))
    quicker, slower, alone = (_by_order(times, frequency) for times in (quick, slow, np.array([mean])))
    apart = {n: _divergence(truth, alone[n])[0] for n in alone}
    best = min(apart, key=lambda n: apart[n])
    found: tuple[GaussMarkov, ...] = (GaussMarkov(sd=math.sqrt(total), tau_s=mean, order=best),)
    least = apart[best] - FITS
    for one, other in product(quicker, slower):
        both = _divergence(truth, share[:, None] * quicker[one] + (1.0 - share)[:, None] * slower[other])
        k = int(np.argmin(both)) if both.size else -1
        if k >= 0 and both[k] < least:
            least = float(both[k])
            parts = ((share[k], quick[k], one), (1.0 - share[k], slow[k], other))
            found = tuple(GaussMarkov(math.sqrt(total * part), float(time_s), n) for part, time_s, n in parts)
    return found


def _by_order(tau_s: Array, frequency: Array) -> dict[int, Array]:
    """Spectra of processes of variance one, by their order."""
    return {n: slow_psd(np.full(tau_s.size, n), np.ones(tau_s.size), tau_s, frequency) for n in (1, 2)}


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

"""The one model that a hop hands out of what was found, and how sure its spectrum is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from navfilter.foundation.arrays import Array
from navfilter.learning.likelihood import Likelihood, Point
from navfilter.learning.slow_posterior import SlowPosterior
from navfilter.models.error_models import CORRELATION_CONSTANTS, ErrorModel, GaussMarkov, White, sum_of
from navfilter.models.learned_arma import learned_part, with_learned
from navfilter.models.spectrum import Spectrum, log_spread, quantiles
from navfilter.timeseries.model import ArmaModel

#: Middles of nine equally probable parts of a distribution: the outer ones are its 5 and 95 %; and of a standard normal
#: one.
EQUAL = (np.arange(9) + 0.5) / 9.0
ALIKE = ndtri(EQUAL)
#: Shares of the variance that the quicker process is tried with.
QUICK_SHARES = np.linspace(0.05, 0.95, 10)
#: So many correlation times are tried for it, by equal ratios.
QUICK_TIMES = 12
#: Frequencies that are compared, by equal ratios: from a tenth of the knee of the slowest process, where all are flat,
#: to half the rate of readings.
OCTAVES, BELOW = 17, 0.1
#: One process does where two are no nearer by this [nat]: its spectrum is right within a tenth.
FITS = 0.005


class LearnedModel(NamedTuple):
    """What one hop hands out.

    Attributes
    ----------
    model : ArmaModel
        The fast part; its `sd_log_s0` is that of the whole error.
    slow : tuple of ErrorModel
        What stands beside it: at most two Gauss-Markov processes that carry the mean covariance of the slow part, and
        white noise where the error may be white, or is described so.
    spectrum : Spectrum
        Of the whole error, with its uncertainty.
    """

    model: ArmaModel
    slow: tuple[ErrorModel, ...]
    spectrum: Spectrum


class Found(NamedTuple):
    """One hypothesis of what a series is: its fast part, the posterior of the slow one beside it, and how probable."""

    point: Point
    posterior: SlowPosterior | None
    weight: float


def learnt_from(likelihood: Likelihood, found: Sequence[Found]) -> tuple[LearnedModel, Array]:
    """What a hop hands out, in the unit of the series, and the moments of its slow part, see `SlowPosterior`.

    Of two hypotheses, the first of which has no quick colour, the model has the mean spectrum: the fast part of the
    second one and white noise, each with its share of the variance.
    """
    n = int(np.isfinite(likelihood.y).sum())
    models = [_fast_model(likelihood, one.point, n) for one in found]
    shares = np.array([one.weight for one in found])
    frequency = np.geomspace(0.5 / n, 0.5, Spectrum.POINTS) / likelihood.drift.period_s
    densities = [_densities(likelihood, one, model, frequency) for one, model in zip(found, models, strict=True)]
    weights = [share * weight for share, (_, weight) in zip(shares, densities, strict=True)]
    spectrum = Spectrum.weighted(frequency, np.concatenate([each for each, _ in densities]), np.concatenate(weights))
    moments = np.concatenate(
        [one.posterior.moments * [1.0, 1.0, one.weight, 1.0] for one in found if one.posterior is not None]
        or [np.empty((0, 4))]
    )
    fast, share = models[-1], float(shares[-1])
    sd, white = fast.sd * math.sqrt(share), models[0].sd ** 2 * (1.0 - share) if len(found) > 1 else 0.0
    model = ArmaModel(fast.ar, fast.ma, sd, fast.covariance, spectrum.sd_log_s0, fast.effective_window)
    return LearnedModel(model, nearest(moments, model, white, likelihood.drift.period_s), spectrum), moments


def _fast_model(likelihood: Likelihood, point: Point, n: int) -> ArmaModel:
    """The fast part of a point, in the unit of the series."""
    p, fast = point.p, likelihood.fast(point.theta, point.slow)
    covariance = point.covariance[: fast.size - 1, : fast.size - 1]
    return ArmaModel(fast[:p], fast[p:-1], math.exp(fast[-1]) / likelihood.unit, covariance, None, float(n))


def _densities(likelihood: Likelihood, found: Found, model: ArmaModel, frequency: Array) -> tuple[Array, Array]:
    """Spectra of the whole error, shape (n, frequencies), and their weights: equally probable ones of the fast part,
    each with equally probable ones of the slow part.
    """
    period_s, k = likelihood.drift.period_s, model.p + model.q + 1
    covariance = np.asarray(np.linalg.inv(found.point.info[:k, :k] + 0.1 * np.eye(k)), dtype=np.float64)
    spread = log_spread(model.ar, model.ma, covariance, 2.0 * np.pi * frequency * period_s)
    # beyond twenty powers of e nothing is known
    fast = model.spectrum(frequency, 1.0 / period_s) * np.exp(np.clip(np.outer(ALIKE, spread), -20.0, 20.0))
    posterior = found.posterior
    if posterior is None:
        return fast, np.full(len(ALIKE), 1.0 / len(ALIKE))
    slow = slow_psd(posterior.order, np.exp(posterior.log_sd), posterior.tau_s, frequency)
    both = (fast[:, None] + quantiles(slow, posterior.weight, EQUAL)[None]).reshape(-1, frequency.size)
    return both, np.full(len(both), 1.0 / len(both))


def with_learnt(model: ErrorModel, found: LearnedModel | None, frozen: bool = False) -> ErrorModel:
    """An error model with what was found in force, and with nothing more to be learnt where it is `frozen`."""
    part = learned_part(model)
    if part is None or found is None:
        return model
    slow = sum_of(found.slow) if found.slow else None
    return with_learned(model, replace(part, model=found.model, slow=slow, spectrum=found.spectrum, frozen=frozen))


def nearest(moments: Array, fast: ArmaModel, white: float, period_s: float) -> tuple[ErrorModel, ...]:
    """What stands beside a fast part: white noise, and at most two processes with the variance of a sum of many and its
    power at zero frequency, with which the spectrum of the whole is as near as can be.

    What is nearest is told by the divergence of Itakura and Saito (1968), `r - ln r - 1` of the ratio r of the true
    spectrum to that of the model: what a reading of the one costs in log-likelihood who believes in the other, and most
    where the model has too little. Each octave counts alike, for which of them matters depends on what else errs.

    Parameters
    ----------
    moments : ndarray, shape (m, 4)
        Order, correlation time [s], weight and mean variance [unit^2] of each.
    fast : ArmaModel
    white : float
        Variance of the white noise.
    period_s : float
        Of readings [s].
    """
    noise = (White(math.sqrt(white)),) if white > 0.0 else ()
    order, tau, variance = moments[:, 0], moments[:, 1], moments[:, 2] * moments[:, 3]
    total = float(variance.sum())
    if not total > 0.0:
        return noise
    mean = float(variance @ tau) / total
    slowest, quickest = float(tau.max()), float(tau.min())
    frequency = np.geomspace(BELOW / (2.0 * np.pi * slowest), 0.5 / period_s, OCTAVES)
    rest = (fast.spectrum(frequency, 1.0 / period_s) + 2.0 * period_s * white) / total
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
    truth, shapes = variance @ shapes[: tau.size] / total + rest, shapes[tau.size :].reshape(2, times.size, OCTAVES)
    apart = _divergence(truth, shapes[:, 0] + rest)
    best = int(np.argmin(apart))
    both = share[:, None] * shapes[:, None, 1 : 1 + count] + (1.0 - share)[:, None] * shapes[None, :, 1 + count :]
    two = _divergence(truth, both + rest)
    if not count or two.min() >= apart[best] - FITS:
        return GaussMarkov(sd=math.sqrt(total), tau_s=mean, order=best + 1), *noise
    one, other, k = np.unravel_index(int(np.argmin(two)), two.shape)
    parts = (share[k], quick[k], one + 1), (1.0 - share[k], slow[k], other + 1)
    return *(GaussMarkov(math.sqrt(total * part), float(time_s), int(n)) for part, time_s, n in parts), *noise


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

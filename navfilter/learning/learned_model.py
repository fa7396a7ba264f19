"""The one model that a hop hands out of what was found, and how sure its spectrum is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from navfilter.learning.likelihood import Likelihood, Point
from navfilter.learning.moment_matching import slow_psd
from navfilter.learning.slow_posterior import SlowPosterior
from navfilter.models.error_models import ErrorModel
from navfilter.models.spectrum import Spectrum, log_spread
from navfilter.timeseries.model import ArmaModel

__all__ = ["LearnedModel", "fast_model", "learnt_from"]

Array = NDArray[np.float64]

#: Middles of nine equally probable parts of a standard normal distribution: the outer ones are its 5 and 95 %.
ALIKE = ndtri((np.arange(9) + 0.5) / 9.0)


class LearnedModel(NamedTuple):
    """What one hop hands out.

    Attributes
    ----------
    model : ArmaModel
        The fast part; its `sd_log_s0` is that of the whole error.
    slow : tuple of ErrorModel
        What stands beside it: at most two Gauss-Markov processes that carry the mean covariance of the slow part, and
        white noise where the description has some.
    spectrum : Spectrum
        Of the whole error, with its uncertainty.
    """

    model: ArmaModel
    slow: tuple[ErrorModel, ...]
    spectrum: Spectrum


def fast_model(likelihood: Likelihood, point: Point, n: int) -> ArmaModel:
    """The fast part of a point, in the unit of the series."""
    p, fast = point.p, likelihood.fast(point.theta, point.slow)
    covariance = point.covariance[: fast.size - 1, : fast.size - 1]
    return ArmaModel(fast[:p], fast[p:-1], math.exp(fast[-1]) / likelihood.unit, covariance, None, float(n))


def learnt_from(likelihood: Likelihood, point: Point, posterior: SlowPosterior | None, n: int) -> LearnedModel:
    """What a hop hands out, in the unit of the series."""
    model, fast = fast_model(likelihood, point, n), likelihood.fast(point.theta, point.slow)
    k = fast.size
    given_slow = np.asarray(np.linalg.inv(point.info[:k, :k] + 0.1 * np.eye(k)), dtype=np.float64)
    spectrum = _spectrum(model, given_slow, posterior, likelihood.drift.period_s, n)
    slow = () if posterior is None else posterior.parts()
    sd = spectrum.sd_log_s0
    return LearnedModel(
        ArmaModel(model.ar, model.ma, model.sd, model.covariance, sd, model.effective_window), slow, spectrum
    )


def _spectrum(
    model: ArmaModel, covariance: Array, posterior: SlowPosterior | None, period_s: float, n: int
) -> Spectrum:
    """Of the whole error: the fast part as far as it is known given the slow one, and that over its posterior."""
    frequency = np.geomspace(0.5 / (n * period_s), 0.5 / period_s, Spectrum.POINTS)
    spread = log_spread(model.ar, model.ma, covariance, 2.0 * np.pi * frequency * period_s)
    # beyond twenty powers of e nothing is known
    fast = model.spectrum(frequency, 1.0 / period_s) * np.exp(np.clip(np.outer(ALIKE, spread), -20.0, 20.0))
    if posterior is None:
        return Spectrum.weighted(frequency, fast, np.full(len(ALIKE), 1.0 / len(ALIKE)))
    kept = posterior.weight > 1e-6 * posterior.weight.max()
    weight = posterior.weight[kept] / posterior.weight[kept].sum()
    slow = slow_psd(posterior.order[kept], np.exp(posterior.log_sd[kept]), posterior.tau_s[kept], frequency)
    both = (fast[:, None] + slow[None]).reshape(-1, frequency.size)
    return Spectrum.weighted(frequency, both, np.tile(weight, len(ALIKE)) / len(ALIKE))

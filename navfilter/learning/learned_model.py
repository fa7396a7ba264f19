"""The one model that a hop hands out of what was found, and how sure its spectrum is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from navfilter.foundation.arrays import Array
from navfilter.learning.likelihood import Likelihood, Point
from navfilter.learning.moment_matching import nearest, slow_psd
from navfilter.learning.slow_posterior import SlowPosterior
from navfilter.models.error_models import ErrorModel, White
from navfilter.models.spectrum import Spectrum, log_spread, quantiles
from navfilter.timeseries.model import ArmaModel

#: Middles of nine equally probable parts of a distribution: the outer ones are its 5 and 95 %; and of a standard normal
#: one.
EQUAL = (np.arange(9) + 0.5) / 9.0
ALIKE = ndtri(EQUAL)


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


def learnt_from(likelihood: Likelihood, found: Sequence[Found], n: int) -> tuple[LearnedModel, Array]:
    """What a hop hands out, in the unit of the series, and the moments of its slow part, see `SlowPosterior`.

    Of two hypotheses, the first of which has no quick colour, the model has the mean spectrum: the fast part of the
    second one and white noise, each with its share of the variance.
    """
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
    slow: tuple[ErrorModel, ...] = nearest(moments)
    if len(found) > 1:
        slow = (*slow, White(math.sqrt(1.0 - share) * models[0].sd))
    sd = fast.sd * math.sqrt(share)
    model = ArmaModel(fast.ar, fast.ma, sd, fast.covariance, spectrum.sd_log_s0, fast.effective_window)
    return LearnedModel(model, slow, spectrum), moments


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

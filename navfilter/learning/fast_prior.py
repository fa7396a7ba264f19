"""What a description of quick errors alone says of slow ones, as long as readings bear it out.

A data sheet is hardly believed in its correlation times (`navfilter.learning.slow_prior`): a slow error may be there
that it does not mention. Beside a noisy inertial unit readings never exclude one, and then the prior decides: wheels
that were described with errors of a second had slow ones of a minute, with tens of times their power at zero frequency.
Where the readings show nothing that exceeds the description, it is believed in this, too: a slow error beside it is
unlikely, and what is believed of low frequencies is the power there that was described.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.likelihood import Likelihood
from navfilter.learning.slow_prior import SLOWER, described_blocks, slow_prior
from navfilter.learning.white_prior import WhitePriorTest
from navfilter.models.error_models import Block, ErrorModel, block_level
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.spectral import spectral_factor

__all__ = ["ShortCorrelationPrior", "quick_description"]

Array = NDArray[np.float64]
#: What is quicker than so much of the quickest slow error that is looked for is none [1]: its power there is a third.
QUICK = 0.5
#: Readings that show so much more power than was described contradict it [1]: of noise as described 1.46 was the most.
EXCEEDED = 1.5
#: Up to so many times the frequency of the slowest fast part the drift hides much [1], and estimates scatter by more:
#: by up to 2.6 [1].
HIDDEN, HIDDEN_BY = 4.0, 3.0
#: By so much less likely must readings be where they are as described, for them to contradict it [nat]: twenty to one.
DENIED = 3.0
#: That there is a slow error beside what was described, and was not [probability].
UNLIKELY = 0.05
#: Of its power, at each of these frequencies [1].
EXACT = 1e-3
#: Frequencies that are compared.
POINTS = 60


@dataclass(frozen=True)
class ShortCorrelationPrior:
    """An error that is described without slow parts, but with quick coloured ones.

    Parameters
    ----------
    blocks : tuple of Block
        Its parts, per sample.
    period_s : float
    span_s : float
        Time that the window holds [s].
    tau_s : float
        Correlation time of its coloured parts together [s].
    low : WhitePriorTest
        What it says of low frequencies, and of slow errors as its kind has them.
    """

    blocks: tuple[Block, ...]
    period_s: float
    span_s: float
    tau_s: float
    low: WhitePriorTest

    @cached_property
    def arma(self) -> ArmaModel | None:
        """The same as one process; None where rounding has made it another one: many smooth parts, often sampled."""
        ar = np.ones(1)
        for block in self.blocks:
            ar = np.convolve(ar, np.poly(block.Phi)) if block.size else ar
        covariance = np.zeros(2 * ar.size - 1)
        for block in self.blocks:
            covariance[0] += block.r
            if block.size:
                state = block.P0 @ block.C
                for k in range(covariance.size):
                    covariance[k] += block.C @ state
                    state = block.Phi @ state
        # without its poles it is a moving average
        weights, reach = np.correlate(ar, ar, "full"), np.arange(1 - ar.size, ar.size)
        lags = covariance[np.abs(np.arange(ar.size)[:, None] + reach)] @ weights
        try:
            model = ArmaModel(ar[1:], *spectral_factor(lags))
        except ValueError:
            return None
        z = np.exp(2j * math.pi * np.geomspace(self.period_s / self.span_s, 0.5, POINTS))
        ratio = _density(model, z) / sum(_power(block, z) for block in self.blocks)
        return model if bool(np.all(np.abs(ratio - 1.0) < EXACT)) else None

    def is_denied(self, likelihood: Likelihood, score: float) -> bool:
        """Whether readings are much less likely as described than as a model that was found, by the `score` of that
        (half of BIC).
        """
        model = self.arma
        if model is None:
            return True
        theta = np.concatenate([model.ar, model.ma, [math.log(model.sd) + likelihood.log_unit]])
        return likelihood.value(theta, model.ar.size) > score + DENIED

    def holds(self, fast: ArmaModel) -> bool:
        """Whether a fast part that was found has nowhere much more power than was described, as far as it is slower
        than the description's own correlation time.
        """
        slowest = 30.0 / (math.pi * self.span_s)
        frequency = np.geomspace(slowest, min(1.0 / (math.pi * self.tau_s), 0.5 / self.period_s), POINTS)
        z = np.exp(2j * math.pi * self.period_s * frequency)
        found = _density(fast, z)
        most = np.where(frequency < HIDDEN * slowest, HIDDEN_BY, EXCEEDED)
        return bool(np.all(found <= most * sum(_power(block, z) for block in self.blocks)))


def _density(model: ArmaModel, z: NDArray[np.complex128]) -> Array:
    """Spectral density per sample [unit^2]."""
    return np.asarray(model.sd**2 * np.abs(_polynomial(model.ma, z) / _polynomial(model.ar, z)) ** 2)


def _polynomial(coefficients: Array, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.asarray(1.0 + sum(c * z ** -(i + 1.0) for i, c in enumerate(coefficients.tolist())))


def _power(block: Block, z: NDArray[np.complex128]) -> Array:
    """Spectral density per sample [unit^2]."""
    if not block.size:
        return np.full(z.size, block.r)
    response = np.linalg.solve(z[:, None, None] * np.eye(block.size) - block.Phi.T, block.C[None, :, None])[..., 0]
    return np.einsum("ki,ij,kj->k", response, block.Q, response.conj()).real + block.r


def quick_description(
    model: ErrorModel, period_s: float, span_s: float, kind: ErrorModel
) -> ShortCorrelationPrior | None:
    """What a description without slow parts says; None where it has some, or nothing but white noise.

    Parameters
    ----------
    model : ErrorModel
        Of the vehicle file; random walks in it are the drift's.
    period_s : float
        Of the sensor [s].
    span_s : float
        Time that the window holds [s].
    kind : ErrorModel
        Usual error of the sensor's kind.
    """
    blocks = described_blocks(model, period_s)
    # of a Gauss-Markov process S(0) is twice variance times correlation time
    sizes = [(float(b.C @ b.P0 @ b.C), 0.5 * (block_level(b) - b.r) * period_s) for b in blocks if b.size]
    if not sizes or any(SLOWER * power >= QUICK * variance * span_s / 50.0 for variance, power in sizes):
        return None
    variance, level = sum(one for one, _ in sizes), sum(block_level(block) for block in blocks)
    usual = slow_prior(kind, period_s, span_s)
    if not variance > 0.0 or usual is None:
        return None
    sd = math.sqrt(variance + sum(block.r for block in blocks))
    low = WhitePriorTest(level, span_s, replace(usual, sd=sd, absent=1.0 - UNLIKELY))
    return ShortCorrelationPrior(blocks, period_s, span_s, sum(power for _, power in sizes) / variance, low)

"""S(0), the power at zero frequency, which is what makes a filter overconfident: of models, of blocks, and what is not
known of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.arma.roots import slowest_real
from navfilter.error_models import block_level

if TYPE_CHECKING:
    from navfilter.learning.likelihood import Likelihood, Point

__all__ = [
    "HOPS_REMEMBERED",
    "UNOBSERVABLE",
    "block_level",
    "cautious",
    "log_s0",
    "log_s0_spread",
    "slow_pole",
    "steadied",
    "upward_spread",
    "with_zero_frequency",
    "zero_frequency",
]

Array = NDArray[np.float64]

#: sd ln S(0) counts at most so much: beyond it the window says nothing about the low frequencies.
LARGEST_SPREAD = 1.5
#: S(0) is raised by exp(share * sd ln S(0)).
SHARE = 0.25
#: No pole comes nearer to 1.
NEAREST = 1e-5
#: A real pole beyond this shapes the low frequencies: its spectrum falls to half within a tenth of the sampling rate.
SLOW = 0.5
#: A model whose S(0) is uncertain by more than this many powers of e is not adopted: the drift hides its low
#: frequencies.
UNOBSERVABLE = 3.0
#: S(0) is averaged over so many hops: two windows.
HOPS_REMEMBERED = 4


# ---------------------------------------------------------------- of a model, and of a block


def zero_frequency(model: ArmaModel) -> float:
    """Spectral density at zero frequency per sample, ``S(0) = sd^2 (C(1) / A(1))^2`` [unit^2]."""
    return float(model.sd**2 * ((1.0 + model.ma.sum()) / (1.0 + model.ar.sum())) ** 2)


def slow_pole(model: ArmaModel) -> int | None:
    """Which of ``model.poles`` is real and slow, the slowest of them; None when there is none."""
    return slowest_real(model.poles, above=SLOW)


def with_zero_frequency(model: ArmaModel, factor: float) -> tuple[Array, float]:
    """AR coefficients and driving variance of the model with S(0) times `factor`.

    Where the model has a real slow pole, that pole moves: only the low frequencies change, and the innovation keeps its
    size. Otherwise the driving variance takes it, but it is never lowered.
    """
    poles, first = model.poles, slow_pole(model)
    if first is None:
        return model.ar, model.sd**2 * max(factor, 1.0)
    own = 1.0 - poles[first].real
    poles[first] = 1.0 - min(max(own / math.sqrt(factor), min(own, NEAREST)), 0.5)
    return np.atleast_1d(np.poly(poles)).real[1:], model.sd**2


# ---------------------------------------------------------------- what is not known of it


def cautious(model: ArmaModel) -> tuple[Array, float]:
    """AR coefficients and driving variance with S(0) raised by what is not known of it."""
    spread = 0.0 if model.sd_log_s0 is None else min(model.sd_log_s0, LARGEST_SPREAD)
    return with_zero_frequency(model, math.exp(SHARE * spread))


def steadied(model: ArmaModel, levels: Sequence[float]) -> ArmaModel:
    """The model with S(0) at the mean of what the last windows found, and sd ln S(0) accordingly smaller.

    One window holds few correlation times of a slow error: its S(0) swings by a factor, and the low ones claim to be
    sure. Windows overlap by half, so n of them are worth (n + 1) / 2.
    """
    if slow_pole(model) is None or not levels[-1] > 0.0:
        return model
    factor = float(np.mean(levels)) / levels[-1]
    ar, variance = with_zero_frequency(model, factor)
    spread = None if model.sd_log_s0 is None else model.sd_log_s0 / math.sqrt((len(levels) + 1) / 2.0)
    return replace(model, ar=ar, sd=math.sqrt(variance), sd_log_s0=spread)


# ---------------------------------------------------------------- of [ar, ma, ln sd]


def log_s0(theta: Array, p: int) -> float:
    """``ln S(0)`` of ``[ar, ma, ln sd]``."""
    a1, c1 = 1.0 + float(np.sum(theta[:p])), 1.0 + float(np.sum(theta[p:-1]))
    return 2.0 * (float(theta[-1]) + math.log(max(abs(c1), 1e-300)) - math.log(max(abs(a1), 1e-300)))


def log_s0_gradient(theta: Array, p: int) -> Array:
    """Gradient of ``ln S(0) = 2 ln sd + 2 ln C(1) - 2 ln A(1)`` in ``[ar, ma, ln sd]``."""
    a1, c1 = 1.0 + float(np.sum(theta[:p])), 1.0 + float(np.sum(theta[p:-1]))
    return 2.0 * np.r_[np.full(p, -1.0 / a1), np.full(theta.size - 1 - p, 1.0 / c1), 1.0]


def log_s0_spread(theta: Array, p: int, covariance: Array) -> float:
    """Standard deviation of ln S(0) from the covariance of all parameters."""
    g = log_s0_gradient(theta, p)
    return float(math.sqrt(max(float(g @ covariance @ g), 0.0)))


def upward_spread(likelihood: Likelihood, point: Point) -> float:
    """How far ln S(0) can rise before minus the log-likelihood does by one half, along its most probable direction.

    The information at an estimate that came out too quick or too quiet claims too much: S(0) is limited downwards by
    what the series shows and upwards by hardly anything. Of a Gaussian this is the standard deviation.
    """
    theta, p, covariance = point.theta, point.p, point.covariance
    g = log_s0_gradient(theta, p)
    spread = math.sqrt(max(float(g @ covariance @ g), 0.0))
    if not 0.0 < spread < math.inf:
        return 0.0
    direction, length, rise = covariance @ g / spread, 1.0, 0.0
    for _ in range(3):
        trial = likelihood.confine(theta + length * direction, p)
        rise = likelihood.penalised(trial, p) - point.value
        if abs(rise - 0.5) < 0.1:
            break
        if not 1e-3 < rise < 1e3:
            return 0.0
        # Minus the log-likelihood grows about as the square of the length.
        length *= min(max(math.sqrt(0.5 / rise), 0.3), 2.0)
    return log_s0(trial, p) - log_s0(theta, p) if 0.3 < rise < 0.8 else 0.0

"""S(0), the power at zero frequency, of ARMA models: what makes a filter overconfident where it is too small."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navfilter.timeseries.model import ArmaModel

__all__ = ["log_s0", "log_s0_spread", "zero_frequency"]

Array = NDArray[np.float64]


def zero_frequency(model: ArmaModel) -> float:
    """Spectral density at zero frequency per sample, ``S(0) = sd^2 (C(1) / A(1))^2`` [unit^2]."""
    return float(model.sd**2 * ((1.0 + model.ma.sum()) / (1.0 + model.ar.sum())) ** 2)


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

"""Simulated noise of an inertial axis: the terms of IEEE Std 952, with known sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

Array = NDArray[np.float64]


def flicker(n: int, rng: np.random.Generator) -> Array:
    """1/f noise of B = 1 by fractional integration of white noise (Kasdin, 1995)."""
    k = np.arange(1, n)
    return np.asarray(fftconvolve(rng.standard_normal(2 * n), np.cumprod(np.r_[1.0, (k - 0.5) / k]))[n : 2 * n])


def noise(
    n: int,
    seed: int | list[int],
    rate_hz: float,
    white: float,
    b: float = 0.0,
    walk: float = 0.0,
    angle: float = 0.0,
) -> Array:
    """Samples of white noise (root density), flicker (B), walk (K) and the noise of rounded angles (Q).

    Parameters
    ----------
    n : int
    seed : int or list of int
    rate_hz : float
    white, b, walk, angle : float
        N [unit/sqrt(Hz)], B [unit], K [unit/s/sqrt(Hz)], Q [unit s].
    """
    rng = np.random.default_rng(seed)
    x = white * np.sqrt(rate_hz) * rng.standard_normal(n)
    x += walk / np.sqrt(rate_hz) * np.cumsum(rng.standard_normal(n))
    if b:
        x += b * flicker(n, rng)
    if angle:
        x += angle * rate_hz * np.diff(rng.standard_normal(n + 1))
    return x

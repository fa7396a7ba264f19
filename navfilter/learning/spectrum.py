"""The spectrum of a learnt error, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Spectrum"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density of a learnt error over its posterior.

    Attributes
    ----------
    frequency_hz : tuple of float
        From half a cycle in the window up to half the sensor's rate [Hz].
    low, median, high : tuple of float
        One-sided density that the posterior is below with a probability of 5, 50 and 95 % [unit^2/Hz].
    sd_log_s0 : float
        Standard deviation of the logarithm at the lowest frequency.
    """

    POINTS: ClassVar[int] = 40

    frequency_hz: tuple[float, ...]
    low: tuple[float, ...]
    median: tuple[float, ...]
    high: tuple[float, ...]
    sd_log_s0: float

    @classmethod
    def certain(cls, frequency_hz: Array, density: Array) -> Spectrum:
        """One spectrum, known."""
        values = tuple(density.tolist())
        return cls(tuple(frequency_hz.tolist()), values, values, values, 0.0)

    @classmethod
    def weighted(cls, frequency_hz: Array, density: Array, weight: Array) -> Spectrum:
        """Of spectra, shape (n, frequencies), with weights whose sum is one."""
        order = np.argsort(density, axis=0)
        sums = np.cumsum(weight[order], axis=0)
        ranked = np.take_along_axis(density, order, axis=0)
        rows = [np.minimum((sums < share).sum(axis=0), len(weight) - 1) for share in (0.05, 0.5, 0.95)]
        bands = [tuple(np.take_along_axis(ranked, row[None], axis=0)[0].tolist()) for row in rows]
        log = np.log(np.maximum(density[:, 0], 1e-300))
        spread = float(np.sqrt(max(weight @ log**2 - float(weight @ log) ** 2, 0.0)))
        return cls(tuple(frequency_hz.tolist()), bands[0], bands[1], bands[2], spread)

"""The spectrum of a series at rest, in bands of the cosine transform, and the spectra of the terms that noise is made
of.

Of white noise and of a random walk the coefficients of the discrete cosine transform (DCT-II) are independent, exactly,
with the variances that their densities say, and a random walk does not leak from low to high frequencies as in a
periodogram. Terms and densities (two-sided) are those of IEEE Std 952.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from navfilter.foundation.arrays import Array

#: Bands per decade of frequency.
PER_DECADE = 12


def shape(kind: str, frequency_hz: Array, period_s: float, tau_s: float = math.nan) -> Array:
    """Two-sided spectral density of a sampled term of size one [1/Hz].

    Parameters
    ----------
    kind : {"white", "tilt", "flicker", "walk", "gauss-markov"}
        The tilt is zero at zero frequency and 2 at the Nyquist frequency.
    frequency_hz : ndarray
    period_s : float
        Of the samples.
    tau_s : float
        Of the Gauss-Markov term.
    """
    sine = np.sin(np.pi * np.asarray(frequency_hz) * period_s)
    if kind == "white":
        return np.ones_like(sine)
    if kind == "tilt":
        return np.asarray(2.0 * sine**2)
    if kind == "flicker":
        return np.asarray(period_s / (2.0 * sine))
    if kind == "walk":
        return np.asarray(period_s**2 / (4.0 * sine**2))
    fading = math.exp(-period_s / tau_s)
    gone = -math.expm1(-period_s / tau_s)
    return np.asarray(period_s * gone * (1.0 + fading) / (gone**2 + 4.0 * fading * sine**2))


@dataclass(frozen=True, eq=False)
class Bands:
    """Power of a series in bands of frequency.

    Attributes
    ----------
    power : ndarray, shape (m,)
        Mean two-sided spectral density in each band [unit^2/Hz].
    low, high : ndarray, shape (m,)
        Its lowest and highest frequency [Hz].
    count : ndarray, shape (m,)
        Coefficients in it: degrees of freedom.
    rate_hz : float
        Of the samples.
    """

    power: Array
    low: Array
    high: Array
    count: Array
    rate_hz: float

    def below(self, frequency_hz: float) -> Bands:
        """The bands up to a frequency."""
        keep = self.high <= frequency_hz
        return Bands(self.power[keep], self.low[keep], self.high[keep], self.count[keep], self.rate_hz)

    def mean(self, kind: str, tau_s: float = math.nan) -> Array:
        """Density of a term of size one in each band, by Simpson's rule."""
        low, middle, high = (
            shape(kind, at, 1.0 / self.rate_hz, tau_s) for at in (self.low, 0.5 * (self.low + self.high), self.high)
        )
        return np.asarray((low + 4.0 * middle + high) / 6.0)

    @property
    def longest_s(self) -> float:
        """Length of the longest stretch [s]."""
        return 0.5 / float(self.low.min())


def bands_of(stretches: Sequence[Array], rate_hz: float, leave_out: Sequence[tuple[float, float]] = ()) -> Bands:
    """Bands of one or several stretches of a series, each of which has a level of its own.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps.
    rate_hz : float
    leave_out : sequence of (low, high)
        Frequencies that do not count, such as lines [Hz].
    """
    rows = [row for x in stretches for row in _bands_of_one(x, rate_hz, leave_out)]
    power, low, high, count = np.array(rows).T
    return Bands(power, low, high, count, rate_hz)


def _bands_of_one(
    x: Array, rate_hz: float, leave_out: Sequence[tuple[float, float]]
) -> list[tuple[float, float, float, float]]:
    density = fft.dct(x - x.mean(), norm="ortho")[1:] ** 2 / rate_hz
    frequency = np.arange(1, x.size) * (0.5 * rate_hz / x.size)
    keep = np.ones(frequency.size, dtype=bool)
    for begin, end in leave_out:
        keep[(frequency >= begin) & (frequency <= end)] = False
    grid = np.arange(int(PER_DECADE * math.log10(x.size)) + 1) / PER_DECADE
    edges = np.unique(np.r_[np.round(10.0**grid).astype(np.int64), x.size])
    rows = []
    for first, after in itertools.pairwise(edges.tolist()):
        inside = np.flatnonzero(keep[first - 1 : after - 1]) + first - 1
        if inside.size:
            rows.append(
                (float(density[inside].mean()), frequency[inside[0]], frequency[inside[-1]], float(inside.size))
            )
    return rows

"""Spectral lines in the noise of a sensor at rest: fans, mains, converters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal, stats

from navfilter.foundation.arrays import Array

#: Samples of a segment at most, and segments at least.
SEGMENT, SEGMENTS = 16384, 8
#: Frequencies around a line that give its background; lines are not looked for among the lowest.
AROUND, LOWEST = 101, 12
#: Probability of finding a line in white noise; a line stands above its background by this factor at least, which no
#: slope or filter of a unit does within a few frequencies.
FALSE_ALARM, ABOVE = 1e-3, 1.6
#: A broader rise than this share of its frequency is no line.
BROAD = 0.05


@dataclass(frozen=True)
class Line:
    """A spectral line.

    Attributes
    ----------
    frequency_hz, width_hz : float
        Where it is strongest, and within how much it was found (at least the resolution).
    amplitude, sd : float
        Of a sine of the same power [unit], and how uncertain.
    density : float
        Two-sided density of the noise around it [unit^2/Hz].
    """

    frequency_hz: float
    width_hz: float
    amplitude: float
    sd: float
    density: float


def spectral_lines(stretches: Sequence[Array], rate_hz: float) -> tuple[Line, ...]:
    """The lines of a series, the strongest first.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps; the longest is looked at.
    rate_hz : float
    """
    x = max(stretches, key=len)
    size = min(SEGMENT, 2 * x.size // (SEGMENTS + 1))
    if size < 4 * AROUND:
        return ()
    frequency, power = signal.welch(x, rate_hz, nperseg=size)
    background = ndimage.median_filter(power, AROUND, mode="nearest")
    # 50 % overlap with Hann's window: each pair of segments is as good as 1.9 of them
    free = 1.9 * (2.0 * x.size / size - 1.0)
    limit = max(float(stats.chi2.isf(FALSE_ALARM / power.size, free)) / free, ABOVE)
    # The median of a chi-square lies below its mean.
    background = background * free / float(stats.chi2.median(free))
    high = power > limit * background
    # at the Nyquist frequency there are fewer degrees of freedom
    high[:LOWEST], high[-6:] = False, False
    places = np.flatnonzero(high)
    runs = np.split(places, np.flatnonzero(np.diff(places) > 2) + 1) if places.size else []
    found = [_line(run, frequency, power, background, x.size / rate_hz, free) for run in runs]
    return tuple(sorted((line for line in found if line is not None), key=lambda line: -line.amplitude))


def _line(
    run: NDArray[np.intp], frequency: Array, power: Array, background: Array, length_s: float, free: float
) -> Line | None:
    step = float(frequency[1])
    if (run[-1] - run[0]) * step > max(BROAD * float(frequency[run[0]]), 6.0 * step):
        return None
    wide = slice(max(run[0] - 2, 0), min(run[-1] + 3, power.size))
    above = power[wide] - background[wide]
    variance = max(float(above.sum()) * step, 0.0)
    peak = int(run[np.argmax(power[run])])
    # one-sided to two-sided
    density = 0.5 * float(background[peak])
    middle = float(frequency[wide] @ np.maximum(above, 0.0) / np.maximum(above, 0.0).sum())
    width = max((run[-1] - run[0]) * step, step)
    amplitude = math.sqrt(2.0 * variance)
    # of a sine in white noise, and of the background that was taken off the bins
    bins = step * 2.0 * density * math.sqrt(2.0 * above.size / free)
    sd = math.hypot(math.sqrt(2.0 * density / length_s), bins / max(amplitude, 1e-300))
    return Line(middle, width, amplitude, sd, density)


def reach(line: Line, length_s: float) -> tuple[float, float]:
    """Frequencies over which a line spoils the spectrum of a record that ends within one of its periods [Hz].

    Parameters
    ----------
    line : Line
    length_s : float
        Of the record.
    """
    # Amplitude of the coefficient m places beside the line: A sqrt(n / 2) / (pi m); it should be lost in the noise.
    places = 3.0 * line.amplitude * math.sqrt(length_s / line.density) / math.pi
    half = 0.5 * line.width_hz + (places + 4.0) * 0.5 / length_s
    half = max(half, 1.5 * line.width_hz)
    return line.frequency_hz - half, line.frequency_hz + half

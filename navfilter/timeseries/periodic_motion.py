"""Sensor noise under a periodic motion of the vehicle: waves rocking a moored boat."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import welch

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike


def find_motion_band(series: ArrayLike, rate_hz: float) -> tuple[float, float] | None:
    """Band in which the spectrum stands at least four times above its surroundings, in Hz; None if there is none.

    Parameters
    ----------
    series : array_like, shape (N,)
        Evenly sampled, without gaps.
    rate_hz : float
        Sampling rate.
    """
    freq, power = _spectrum(series, rate_hz)
    # On a logarithmic axis, so that the surroundings of a low frequency are not all above it.
    axis = np.geomspace(freq[1], freq[-1], 400)
    level = np.interp(axis, freq[1:], np.log(power[1:] + 1e-300))
    floor = median_filter(level, size=161, mode="nearest")
    above = level - floor > np.log(4.0)
    if not above.any():
        return None
    peak = int(np.argmax(np.where(above, level - floor, -np.inf)))
    low, high = peak, peak
    while low > 0 and level[low - 1] > floor[low - 1] + np.log(1.5):
        low -= 1
    while high < axis.size - 1 and level[high + 1] > floor[high + 1] + np.log(1.5):
        high += 1
    return float(axis[low]), float(axis[high])


def subtract_motion(series: ArrayLike, rate_hz: float, band_hz: tuple[float, float] | None = None) -> Array:
    """Take a periodic motion out of a series by subtracting its power spectrum (proposed in Ah-Chong 2003, chapter 5).

    The noise under the motion is taken to be the line, in log power against log frequency, between the two sides of
    the band; each Fourier coefficient in the band is reduced to that power and keeps its phase. What comes out has the
    spectrum of the noise alone, so that any estimator may be fed with it.

    Against reading the motion as oscillators in a larger ARMA model: on the gyros of a boat moored on a lake (rocking
    below 2.5 Hz, 200 Hz samples, models from the first half judged above 3 Hz on the second) the subtraction was
    nearer to the noise spectrum than the model of the raw series in six series of six, and the oscillators left no
    usable rest, because the noise is itself coloured near the Nyquist frequency. Give the band where it is known:
    in a record of a few dozen periods it cannot be found safely.

    Parameters
    ----------
    series : array_like, shape (N,)
        Evenly sampled, without gaps.
    rate_hz : float
        Sampling rate.
    band_hz : (low, high), optional
        Band of the motion; found by `find_motion_band` when not given (nothing is changed if there is none).

    Raises
    ------
    ValueError
        For a band outside (0, rate/2) or a series with gaps.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise = rng.normal(size=20_000)
    >>> moved = noise + 3.0 * np.sin(2 * np.pi * 0.5 * np.arange(20_000) / 10.0)
    >>> bool(abs(subtract_motion(moved, 10.0, (0.4, 0.6)).std() - 1.0) < 0.02)
    True
    """
    x = numbers(series, "series")
    if x.ndim != 1 or x.size < 256 or not np.all(np.isfinite(x)):
        raise ValueError(f"series must be one finite series of at least 256 samples, found shape {x.shape}.")
    band = find_motion_band(x, rate_hz) if band_hz is None else band_hz
    if band is None:
        return x.copy()
    low, high = band
    if not 0.0 <= low < high <= 0.5 * rate_hz:
        raise ValueError(f"band_hz must lie within 0 and {0.5 * rate_hz} Hz, found {band}.")
    mean = float(x.mean())
    coefficients = np.fft.rfft(x - mean)
    freq = np.fft.rfftfreq(x.size, 1.0 / rate_hz)
    floor = _floor(x, rate_hz, low, high)
    inside = (freq >= low) & (freq <= high)
    target = np.sqrt(floor(np.asarray(freq[inside], dtype=np.float64)) * rate_hz * x.size / 2.0)
    size = np.abs(coefficients[inside])
    smooth = np.sqrt(np.convolve(np.pad(size**2, 8, mode="edge"), np.ones(17) / 17.0, mode="valid"))
    coefficients[inside] *= np.minimum(1.0, target / np.maximum(smooth, 1e-300))
    return mean + np.fft.irfft(coefficients, x.size)


def _spectrum(series: ArrayLike, rate_hz: float) -> tuple[Array, Array]:
    x = numbers(series, "series")
    freq, power = welch(x, rate_hz, nperseg=min(x.size, max(256, x.size // 8)), detrend="linear")
    return freq, power


def _floor(x: Array, rate_hz: float, low: float, high: float) -> Callable[[Array], Array]:
    """One-sided noise density inside the band as a function of frequency, from a third of an octave on either side."""
    freq, power = _spectrum(x, rate_hz)
    at, level = [], []
    for lo, hi in ((low / 1.26, low), (high, high * 1.26)):
        side = (freq >= lo) & (freq <= hi) & (freq > 0.0)
        if side.any():
            at.append(float(np.mean(np.log(freq[side]))))
            level.append(float(np.log(np.mean(power[side]))))
    if not at:
        raise ValueError(f"no spectrum on either side of {low} to {high} Hz. Narrow the band.")
    return lambda f: np.exp(np.interp(np.log(np.maximum(f, 1e-12)), at, level))

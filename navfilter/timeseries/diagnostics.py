"""What kind of noise is this series, and is a residual white: correlation functions, whiteness, Allan deviation."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.kernels import arma_fit as kernels
from navfilter.timeseries.initial_values import tidy_series

# Truly white noise exceeds its limits at a fraction int_0^1 2 Phi(-1.96/sqrt(1-x)) dx of all N lags, because the
# biased autocorrelation shrinks with the lag; 0.05 over that fraction is what the thesis's measure scores then.
WT_WHITE = 3.855


def _centred(series: ArrayLike, least: int, what: str) -> tuple[Array, int]:
    """Series minus its mean over its largest value, zero where missing, and the number of known samples."""
    x = tidy_series(series, least, what, gaps=True)
    known = np.isfinite(x)
    x = x - x[known].mean()
    x = np.where(known, x - x[known].mean(), 0.0)
    top = float(np.abs(x).max())
    if top == 0.0:
        raise ValueError(f"{what}: the series is constant, its correlation is not defined.")
    return np.ascontiguousarray(x / top), int(known.sum())


def acf(x: ArrayLike, lags: int) -> Array:
    """Normalised autocorrelation (biased estimate), lags 0 ... `lags`; white noise stays within 1.96/sqrt(n).

    Parameters
    ----------
    x : array_like, shape (n,)
        Samples; the mean is removed, NaN is a missing sample.
    lags : int
        Largest lag, below n.

    Returns
    -------
    ndarray, shape (lags+1,)
    """
    y, _ = _centred(x, 2, "acf")
    _check_lags(lags, y.size)
    out = np.empty(lags + 1)
    kernels.lag_products(y, y, out)
    return out / out[0]


def pacf(x: ArrayLike, lags: int) -> Array:
    """Partial autocorrelation by Durbin-Levinson, lags 0 ... `lags` (1 at lag 0).

    Parameters
    ----------
    x : array_like, shape (n,)
        Samples; the mean is removed.
    lags : int
        Largest lag, below n.

    Returns
    -------
    ndarray, shape (lags+1,)
    """
    partial = np.empty(lags)
    kernels.levinson(acf(x, lags), np.zeros(lags), partial)
    return np.r_[1.0, partial]


def cross_correlation(x: ArrayLike, y: ArrayLike, lags: int) -> Array:
    """Cross-correlation coefficient of ``x[t]`` and ``y[t+k]``, k = -`lags` ... `lags`.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Two series of the same length; means are removed.
    lags : int
        Largest lag, below n.

    Returns
    -------
    ndarray, shape (2*lags+1,)
        Lag 0 is in the middle.
    """
    u, _ = _centred(x, 2, "cross_correlation")
    v, _ = _centred(y, 2, "cross_correlation")
    if u.size != v.size:
        raise ValueError(f"the series must have the same length, found {u.size} and {v.size}.")
    _check_lags(lags, u.size)
    after, before = np.empty(lags + 1), np.empty(lags + 1)
    kernels.lag_products(u, v, after)
    kernels.lag_products(v, u, before)
    return np.r_[before[:0:-1], after] / math.sqrt(float(u @ u) * float(v @ v))


def _check_lags(lags: int, n: int) -> None:
    if not isinstance(lags, int | float | np.integer) or lags < 0 or lags != int(lags) or lags >= n:
        raise ValueError(f"lags must be a whole number from 0 to {n - 1} for {n} samples, found {lags!r}.")


@dataclass(frozen=True)
class Whiteness:
    """Result of `whiteness`.

    Attributes
    ----------
    is_white : bool
        Verdict of Ljung-Box and cumulative periodogram together, false alarms at `level`.
    ljung_box, ljung_box_p : float
        Statistic over `lags` lags, and its probability under whiteness with ``lags - fitted`` degrees of freedom.
    periodogram, periodogram_p : float
        Largest distance of the cumulative periodogram from the straight line (Bartlett), and its probability.
    wt : float
        The measure of Ah-Chong (2003), eq. 3.17: 0.05 over the exceeding fraction of all n lags. Not a test: white
        noise scores `wt_white`, not 1, and clearly coloured series pass "WT > 1".
    wt_white : float
        3.855, the expected value of `wt` for white noise.
    n, lags, fitted : int
        Known samples, lags used, coefficients fitted.
    level : float
        Probability of calling white noise coloured.
    """

    is_white: bool
    ljung_box: float
    ljung_box_p: float
    periodogram: float
    periodogram_p: float
    wt: float
    wt_white: float
    n: int
    lags: int
    fitted: int
    level: float


def whiteness(residuals: ArrayLike, fitted: int = 0, lags: int | None = None, level: float = 0.01) -> Whiteness:
    """Test whether residuals are white.

    Parameters
    ----------
    residuals : array_like, shape (n,)
        Prediction errors; NaN is a missing sample.
    fitted : int
        Number of coefficients p + q fitted to the series, which cost degrees of freedom.
    lags : int, optional
        Lags of Ljung-Box; default 20, more when many coefficients were fitted.
    level : float
        False-alarm probability of the verdict, shared by the two tests.

    Examples
    --------
    >>> import numpy as np
    >>> result = whiteness(np.random.default_rng(1).standard_normal(4000))
    >>> result.is_white, result.lags
    (True, 20)
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, found {level}.")
    x, n = _centred(residuals, 8, "whiteness")
    if lags is None:
        lags = min(max(20, fitted + 10), max(x.size // 2, fitted + 1))
    if not fitted < lags < x.size:
        raise ValueError(f"lags must lie between fitted + 1 = {fitted + 1} and {x.size - 1}, found {lags}.")
    full = _all_lags(x)
    r = full[1 : lags + 1]
    pairs = x.size - np.arange(1.0, lags + 1.0)
    if n < x.size:
        known = np.isfinite(numbers(residuals, "residuals")).astype(np.float64)
        pairs = np.array([known[k:] @ known[:-k] for k in range(1, lags + 1)])
    box = float(n * (n + 2.0) * np.sum(r**2 / np.maximum(pairs, 1.0)))
    box_p = float(scipy.stats.chi2.sf(box, lags - fitted))
    distance, distance_p = _cumulative_periodogram(x)
    limit = 1.959964 / math.sqrt(n)
    everywhere = int(np.sum(np.abs(full[1:]) > limit))
    return Whiteness(
        is_white=min(box_p, distance_p) >= 0.5 * level,
        ljung_box=box,
        ljung_box_p=box_p,
        periodogram=distance,
        periodogram_p=distance_p,
        wt=0.05 * x.size / everywhere if everywhere else math.inf,
        wt_white=WT_WHITE,
        n=n,
        lags=lags,
        fitted=fitted,
        level=level,
    )


def _all_lags(x: Array) -> Array:
    """Biased autocorrelation at all lags, by FFT."""
    size = scipy.fft.next_fast_len(2 * x.size, real=True)
    power = np.abs(scipy.fft.rfft(x, size)) ** 2
    r = scipy.fft.irfft(power, size)[: x.size]
    return np.asarray(r / r[0])


def _cumulative_periodogram(x: Array) -> tuple[float, float]:
    """Kolmogorov distance of the cumulative periodogram from whiteness, and its probability."""
    power = np.abs(scipy.fft.rfft(x)[1 : (x.size - 1) // 2 + 1]) ** 2
    m = power.size
    rise = np.cumsum(power) / power.sum()
    step = np.arange(1, m + 1) / m
    distance = float(max(np.max(step - rise), np.max(rise - step + 1.0 / m)))
    # Stephens (1970): the limit distribution with this argument is right to a per cent from a dozen ordinates on.
    return distance, float(scipy.stats.kstwobign.sf(distance * (math.sqrt(m) + 0.12 + 0.11 / math.sqrt(m))))


def allan_deviation(series: ArrayLike, rate_hz: float, averaging: ArrayLike | None = None) -> tuple[Array, Array]:
    """Overlapping Allan deviation of a rate-like series (gyro rate, acceleration, heading rate).

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples, without gaps.
    rate_hz : float
        Sampling rate, Hz.
    averaging : array_like of int, optional
        Samples per average; default about ten per decade up to n/3.

    Returns
    -------
    tau_s, deviation : ndarray
        Averaging times, s, and the deviation in the unit of the series. White noise falls as tau^-1/2 through
        ``density/sqrt(2)`` times the one-sided root density, a random walk rises as tau^+1/2.
    """
    x = tidy_series(series, 4, "allan_deviation")
    if not rate_hz > 0.0:
        raise ValueError(f"rate_hz must be positive, found {rate_hz}.")
    if averaging is None:
        top = math.log10(max(x.size // 3, 1))
        counts = np.unique(np.round(np.logspace(0.0, top, int(10 * top) + 2)).astype(np.int64))
    else:
        counts = np.atleast_1d(np.asarray(averaging, dtype=np.int64))
    if counts.min() < 1 or 2 * counts.max() > x.size:
        raise ValueError(f"averages must span 1 to {x.size // 2} samples, found {counts.min()} to {counts.max()}.")
    total = np.r_[0.0, np.cumsum(x - x.mean())]
    out = np.empty(counts.size)
    for i, m in enumerate(counts):
        difference = total[2 * m :] - 2.0 * total[m:-m] + total[: -2 * m]
        out[i] = math.sqrt(float(difference @ difference) / (2.0 * difference.size)) / m
    return counts / rate_hz, out


#: Averages are looked at in so many steps each: finer ones hold nothing new.
_STEPS = 16
#: Lags, in averages, beyond which second differences of averages no longer correlate.
_REACH = 64


def allan_edf(
    averaging: ArrayLike, n: int, density: Callable[[Array], Array] | None = None, rate_hz: float = 1.0
) -> Array:
    """Equivalent degrees of freedom of `allan_deviation`: ``edf * variance / true variance`` is about chi-square.

    Parameters
    ----------
    averaging : array_like of int
        Samples per average.
    n : int
        Samples of the series.
    density : callable, optional
        Two-sided power spectral density of the noise at frequencies [Hz], up to a factor. Default: white.
    rate_hz : float
        Sampling rate [Hz].

    Returns
    -------
    ndarray
        ``2 mean^2 / variance`` of the estimated Allan variance, for Gaussian noise of this spectrum, whatever mixture
        it is. Tables and formulas in use hold for one power law each (Greenhall and Riley, 2003).

    Examples
    --------
    >>> allan_edf([1, 100], 1000).round(1)
    array([666.2,  12.8])
    """
    counts = np.atleast_1d(np.asarray(averaging, dtype=np.int64))
    if counts.size == 0 or counts.min() < 1 or 2 * counts.max() > n:
        raise ValueError(f"averages must span 1 to {n // 2} samples, found {counts.tolist()}.")
    return np.array([_edf(int(m), n, density, rate_hz) for m in counts])


def _edf(m: int, n: int, density: Callable[[Array], Array] | None, rate_hz: float) -> float:
    """By the covariance of the differences of averages: their variance scatters by 2/M sum (1 - k/M) rho_k^2."""
    steps = min(m, _STEPS)
    stride = m / steps
    pairs = n / stride - 2 * steps + 1.0
    size = scipy.fft.next_fast_len(int(2 * (min(pairs, _REACH * steps) + 4 * steps)), real=False)
    # half-way between the usual frequencies: 0, where a walk has no density, is not among them
    cycles = (np.arange(size) + 0.5) / size
    cycles = np.minimum(cycles, 1.0 - cycles)
    gain = np.sin(np.pi * cycles * steps) ** 4 / np.sin(np.pi * cycles) ** 2
    power = gain if density is None else gain * density(cycles * rate_hz / stride)
    lags = np.arange(math.ceil(min(pairs, size // 2)))
    covariance = (np.exp(1j * np.pi * lags / size) * scipy.fft.ifft(power)[: lags.size]).real
    share = np.square(covariance / covariance[0]) * (1.0 - lags / pairs)
    return max(float(pairs / (2.0 * share.sum() - share[0])), 1.0)

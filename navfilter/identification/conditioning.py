"""What is done to a recorded series before a model is fitted to it: cut, thin, reject, difference; every step is
noted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from navfilter.foundation.arrays import Array
from navfilter.io.inertial import Series

MAX_SAMPLES = 50_000
LEAST_SAMPLES = 50
#: A whole circle in degrees, their tenths, hundredths and minutes, in radians, gon and counts of 16 bits.
CIRCLES = (360.0, 3600.0, 36000.0, 21600.0, 2.0 * np.pi, 400.0, 65536.0)
#: No noise lies so many robust standard deviations off; a transmission error does.
GROSS = 50.0
#: A share of repeated values above this, in a series that is not coarsely quantised, means a sensor slower than its
#: logger.
HELD_SHARE = 0.4


@dataclass(frozen=True, eq=False)
class Conditioned:
    """Samples ready to be fitted.

    Attributes
    ----------
    name, source : str
    value : ndarray, shape (n,)
        Samples that are fitted, NaN where missing.
    whole : ndarray
        The whole record at the same rate, before the part was chosen and before seasonal differences.
    rate_hz, begin_s : float
        After decimation; time of ``value[0]``.
    step : float
        Quantisation step, 0 if none is seen.
    seasonal_lag : int
        Lag of the difference taken, 0 for none.
    notes : tuple of str
    """

    name: str
    source: str
    value: Array
    whole: Array
    rate_hz: float
    begin_s: float
    step: float
    seasonal_lag: int
    notes: tuple[str, ...]


def condition(
    series: Series,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    decimate: int = 1,
    seasonal_lag: int = 0,
    reject: float = GROSS,
    max_samples: int = MAX_SAMPLES,
) -> Conditioned:
    """Cut, thin and clean a series.

    Parameters
    ----------
    series : Series
    from_s, to_s : float, optional
        Part to use, in seconds of the file's clock (from its first sample if it has none).
    decimate : int
        Keep every so many-th sample. Nothing is averaged: `navfilter.timeseries.resample_arma` relates the models.
    seasonal_lag : int
        Fit ``x[t] - x[t - lag]`` (a periodic disturbance of that many samples).
    reject : float
        Make samples missing that lie further than so many robust standard deviations from the median of the 11 around
        them (0: none). The default only catches what cannot be noise.
    max_samples : int
        Of a longer record the middle is fitted.

    Raises
    ------
    ValueError
        When nothing usable is left.
    """
    _check(series, decimate, seasonal_lag, max_samples)
    notes = list(series.notes)
    x, begin = _cut(series, from_s, to_s, notes)
    size = float(np.max(np.abs(x[np.isfinite(x)]), initial=0.0))
    if size and not 1e-100 < size < 1e100:
        raise ValueError(
            f"{series.name} is of size {size:.1e}, beyond what can be squared. Is it the right column, the right unit?"
        )
    infinite = int(np.isinf(x).sum())
    if infinite:
        notes.append(f"{infinite} infinite samples count as missing")
        x = np.where(np.isinf(x), np.nan, x)
    x = _without_wraps(x, notes)
    if reject and np.isfinite(x).sum() >= LEAST_SAMPLES:
        x = _without_impulses(x, reject, notes)
    step = quantisation_step(x)
    held = _held(x, step, notes) if decimate == 1 else 1
    if decimate > 1:
        notes.append(f"every {decimate}th sample kept: {series.rate_hz / decimate:.6g} Hz")
    x = np.ascontiguousarray(x[:: decimate * held])
    rate = series.rate_hz / (decimate * held)
    known = np.flatnonzero(np.isfinite(x))
    if known.size < LEAST_SAMPLES:
        raise ValueError(f"{series.name} has {known.size} usable samples, at least {LEAST_SAMPLES} are needed.")
    if np.ptp(x[known]) == 0.0:
        raise ValueError(
            f"{series.name} is constant ({x[known[0]]:g}): it has no error to model. Is it the right column?"
        )
    begin, x = begin + float(known[0]) / rate, x[known[0] : known[-1] + 1]
    missing = int(np.isnan(x).sum())
    if missing:
        notes.append(f"{missing} of {x.size} samples are missing")
    whole = x
    if x.size > max_samples:
        first = (x.size - max_samples) // 2
        x, begin = x[first : first + max_samples], begin + first / rate
        notes.append(
            f"the model is fitted to the middle {max_samples} of {whole.size} samples ({begin:.6g} to "
            f"{begin + x.size / rate:.6g} s); choose others with --from-s, --to-s, --decimate or --max-samples"
        )
    if seasonal_lag:
        if x.size <= seasonal_lag + LEAST_SAMPLES:
            raise ValueError(f"a seasonal lag of {seasonal_lag} leaves too few of {x.size} samples.")
        x = x[seasonal_lag:] - x[:-seasonal_lag]
        notes.append(f"differences over {seasonal_lag} samples are modelled")
    return Conditioned(
        series.name, series.source, np.ascontiguousarray(x), whole, rate, begin, step, seasonal_lag, tuple(notes)
    )


def _check(series: Series, decimate: int, seasonal_lag: int, max_samples: int) -> None:
    if not (np.isfinite(series.rate_hz) and series.rate_hz > 0.0):
        raise ValueError(f"rate_hz must be positive, found {series.rate_hz}.")
    if np.asarray(series.value).ndim != 1:
        raise ValueError(f"one series of shape (n,) is needed, found shape {np.shape(series.value)}. Pass one column.")
    if np.asarray(series.value).dtype.kind not in "biuf":
        raise ValueError(f"{series.name} holds {np.asarray(series.value).dtype}, not real numbers.")
    if decimate < 1 or seasonal_lag < 0 or max_samples < LEAST_SAMPLES:
        raise ValueError(
            f"decimate must be at least 1, seasonal_lag at least 0 and max_samples at least {LEAST_SAMPLES}, "
            f"found {decimate}, {seasonal_lag} and {max_samples}."
        )


def _cut(series: Series, from_s: float | None, to_s: float | None, notes: list[str]) -> tuple[Array, float]:
    x = np.asarray(series.value, dtype=np.float64)
    low = -np.inf if from_s is None else from_s
    high = np.inf if to_s is None else to_s
    if not low < high:
        raise ValueError(f"--from-s must lie before --to-s, found {from_s} and {to_s}.")
    end = series.begin_s + (x.size - 1) / series.rate_hz
    first = int(np.ceil(max(low - series.begin_s, 0.0) * series.rate_hz - 1e-9))
    last = int(np.floor(min(high - series.begin_s, end - series.begin_s) * series.rate_hz + 1e-9)) + 1
    if last - first < 1:
        raise ValueError(
            f"{series.name} has no samples from {low:g} to {high:g} s: it lasts from {series.begin_s:.6g} to {end:.6g} "
            "s."
        )
    return x[first:last], series.begin_s + first / series.rate_hz


def _without_wraps(x: Array, notes: list[str]) -> Array:
    """An angle at rest that goes through the end of its circle (359, 0, 1 deg) as it is, without the jumps."""
    known = np.flatnonzero(np.isfinite(x))
    step = np.abs(np.diff(x[known]))
    for circle in CIRCLES:
        jumps = step > 0.5 * circle
        low, high = (float(f(x[known], initial=0.0)) for f in (np.min, np.max))
        inside = (low >= 0.0 and high <= circle) or (low >= -0.5 * circle and high <= 0.5 * circle)
        if not (inside and jumps.any() and np.all((step > 0.75 * circle) | (step < 0.25 * circle))):
            continue
        whole = np.unwrap(x[known], period=circle)
        if np.ptp(whole) < 0.5 * circle:
            notes.append(
                f"an angle that passes the end of its circle {int(jumps.sum())} times: {circle:.4g} is taken off"
            )
            x = x.copy()
            x[known] = whole
            break
    return x


def _without_impulses(x: Array, reject: float, notes: list[str]) -> Array:
    smooth = median_filter(bridged(x), size=11, mode="nearest")
    away = np.abs(x - smooth)
    limit = reject * 1.4826 * float(np.nanmedian(away))
    # More than half of the samples on one value: a coarse sensor, whose rare steps are no impulses.
    far = away > limit if limit > 0.0 else np.zeros(x.size, dtype=bool)
    if far.mean() > 0.2:
        raise ValueError(
            f"--reject {reject:g} would reject {100 * far.mean():.0f} % of the samples. Take a larger number."
        )
    if far.any():
        notes.append(f"{int(far.sum())} samples beyond {reject:g} robust standard deviations count as missing")
    return np.where(far, np.nan, x)


def _held(x: Array, step: float, notes: list[str]) -> int:
    """How many times every sample is repeated when the sensor is slower than its logger; 1 if it is not."""
    same = x[1:] == x[:-1]
    change = np.flatnonzero(~same)
    if change.size < LEAST_SAMPLES or same.mean() < HELD_SHARE:
        return 1
    # Steps of a coarse sensor repeat by chance; of the values that do change, most then change by a single step.
    jump = np.abs(np.diff(x)[change])
    if step > 0.0 and float(np.mean(jump < 1.5 * step)) > 0.5:
        notes.append(f"{100 * same.mean():.0f} % of the samples repeat the one before: coarse quantisation")
        return 1
    run = np.diff(change)
    length = int(np.median(run))
    if length > 1 and float(np.mean(run == length)) > 0.9:
        notes.append(f"every value is repeated {length} times (sensor slower than its logger): one of each is kept")
        return length
    notes.append(
        f"{100 * same.mean():.0f} % of the samples repeat the one before: a sensor slower than its logger, or stuck; "
        "see --decimate"
    )
    return 1


def quantisation_step(x: Array) -> float:
    """Step of a quantised series; 0 when its values lie on no grid coarser than a ten-thousandth of its spread.

    Examples
    --------
    >>> x = np.random.default_rng(1).standard_normal(1000)
    >>> quantisation_step(np.round(x / 0.25) * 0.25), quantisation_step(x)
    (0.25, 0.0)
    """
    known = x[np.isfinite(x)]
    values = np.unique(known)
    if values.size < 2:
        return 0.0
    spacing = np.diff(values)
    spacing = spacing[spacing > 1e-9 * (values[-1] - values[0])]
    multiples = np.maximum(np.round(spacing / np.quantile(spacing, 0.1)), 1.0)
    step = float(np.median(spacing / multiples))
    # Files often print too few digits, so that the steps of one converter come in two sizes: a fifth is allowed.
    on_grid = float(np.mean(np.abs(spacing / step - multiples) < 0.2))
    spread = float(np.std(np.diff(known))) or step
    repeating = values.size < 0.6 * known.size
    return step if repeating and on_grid > 0.95 and step > 1e-4 * spread else 0.0


def bridged(x: Array) -> Array:
    """The series with missing samples interpolated."""
    missing = np.isnan(x)
    if not missing.any():
        return x
    where = np.arange(x.size)
    return np.asarray(np.interp(where, where[~missing], x[~missing]))


def gap_free(x: Array) -> Array:
    """The longest stretch without a missing sample."""
    missing = np.flatnonzero(np.isnan(x))
    edges = np.r_[-1, missing, x.size]
    longest = int(np.argmax(np.diff(edges)))
    return np.ascontiguousarray(x[edges[longest] + 1 : edges[longest + 1]])

"""What one run says of itself: errors, honesty of the covariance, and what is left in the innovations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.arguments import within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.chi_square import chi_square_range
from navfilter.models.mission import Stream
from navfilter.models.sensors import Sensor, traits
from navfilter.timeseries.diagnostics import Whiteness, acf, whiteness
from navfilter.track.track import ERRORS, Track

Windows = tuple[tuple[float, float], ...]

#: Innovations are tested for whiteness over so many lags, and only where there are so many of them.
LAGS, LEAST = 20, 100


def figures_of(track: Track, truth: Stream | None, windows: Windows, common: Mapping[str, Array]) -> dict[str, Any]:
    """All figures of one run as plain values, None where there is no truth or there are too few readings.

    Parameters
    ----------
    track : Track
        Its residuals are all scored.
    truth : Stream or None
    windows : tuple of (float, float)
        Times [s] of the states that are scored.
    common : dict of str to ndarray
        Times [s] of the readings of each sensor on which prediction errors and whiteness rest.
    """
    summary = track.summary(truth, windows)
    run: dict[str, Any] = {key: summary[key] for key in ERRORS}
    run["nees"] = _consistency(track, truth, windows)
    means = [nis for nis in summary["nis"].values() if nis is not None]
    run["nis"] = float(np.mean(means)) if means else None
    run["sensors"] = {}
    for name, r in track.residuals.items():
        if name in track.vehicle.sensors:
            about = {"nis": summary["nis"][name], "used": summary["used"][name], "rejected": summary["rejected"][name]}
            run["sensors"][name] = {**about, **_sensor(name, track.vehicle.sensors[name], r, common[name])}
    run["cpu_s"] = track.cpu_s
    return run


def _consistency(track: Track, truth: Stream | None, windows: Windows) -> dict[str, dict[str, Any]]:
    """Mean NEES of position and heading, its 95 % range with the number of independent errors, and the share beyond 3
    sigma.
    """
    if truth is None or not len(truth):
        return {}
    errors, rows, result = track.errors(truth), within(track.time_s, windows), {}
    nees = track.nees(errors)
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    each = {
        "position": errors.position_n / sd[:, :3],
        "heading": np.sqrt(nees["heading"])[:, None] * np.sign(errors.heading)[:, None],
    }
    for name, z in each.items():
        z = z[rows][:, np.isfinite(z[rows]).any(axis=0)]
        value = nees[name][rows]
        if not z.size or not np.isfinite(value).any():
            continue
        n = min(independent(column) for column in z.T)
        result[name] = {
            "mean": float(np.nanmean(value)),
            "n": n,
            "band": tuple(map(float, chi_square_range(n * z.shape[1]))),
            "outside_3_sigma": float(np.mean(np.abs(z[np.isfinite(z)]) > 3.0)),
        }
    return result


def independent(z: Array, most: int = 4000) -> float:
    """How many independent errors a series of correlated ones is worth, for the mean of its square.

    The squares of a Gaussian series correlate as the square of its autocorrelation r, so n errors are worth n / (1 + 2
    sum r^2) (Bartlett, 1946). The mean of an error is known to be zero and is not removed; the sum ends at the first
    zero of r, beyond which it gathers nothing but noise.
    """
    z = np.where(np.isfinite(z), z, 0.0)[:: max(1, len(z) // most)]
    power = float(z @ z)
    if power == 0.0:
        return 1.0
    r = np.fft.irfft(np.abs(np.fft.rfft(z, 2 * len(z))) ** 2)[: len(z)] / power
    ends = np.flatnonzero(r <= 0.0)
    return max(1.0, len(z) / (1.0 + 2.0 * float(np.sum(r[1 : ends[0] if ends.size else None] ** 2))))


def _sensor(name: str, sensor: Sensor, r: Residuals, common: Array) -> dict[str, Any]:
    """What the innovations of one sensor say: NIS with its range, share beyond 3 sigma, prediction errors and whiteness
    per axis.

    The only axis of a scalar sensor is called like the sensor.
    """
    valid = r.used | (r.outcome == OUTCOMES.index("rejected"))
    z = np.abs(r.value[valid] / r.sd[valid])
    z = z[np.isfinite(z)]
    freedom = float(np.nansum(r.dof[r.used]))
    unit, factor = traits.shown_unit(sensor.unit)
    together = r.used & np.isin(r.time_s, common)
    axes = {}
    for i, axis in enumerate(sensor.axis_names):
        value = r.value[together, i] if i < r.value.shape[1] else np.empty(0)
        value = value[np.isfinite(r.sd[together, i])] if len(value) else value  # not what was left out alone
        if not np.isfinite(value).any():
            continue
        test, largest = _colour(innovation_series(r, i, together))
        axes[axis or name] = {
            "prediction_rms": float(factor * np.sqrt(np.nanmean(value**2))),
            "is_white": None if test is None else test.is_white,
            "ljung_box_p": None if test is None else test.ljung_box_p,
            "largest_acf": largest,
        }
    return {
        "band": tuple(map(float, chi_square_range(freedom))) if freedom > 0 else None,
        "outside_3_sigma": float(np.mean(z > 3.0)) if z.size else None,
        "unit": unit,
        "compared": int(together.sum()),
        "axes": axes,
    }


def innovation_series(residuals: Residuals, axis: int, rows: Mask | None = None) -> Array:
    """Innovations of one axis over their predicted sd, on the ticks of the sensor; NaN where a reading is missing or
    not among `rows`.

    Parameters
    ----------
    residuals : Residuals
    axis : int
    rows : ndarray of bool, shape (n,), optional
        Default: the readings that were used.

    Returns
    -------
    ndarray, shape (m,)
        A gap longer than twice the lags that are tested is cut to that length: no correlation reaches across it.
    """
    rows = residuals.used if rows is None else rows
    value = np.where(rows, residuals.value[:, axis] / residuals.sd[:, axis], np.nan)
    step = np.diff(residuals.time_s)
    if not (step > 0.0).any():
        return value
    ticks = np.clip(np.rint(step / float(np.median(step[step > 0.0]))), 1, 2 * LAGS).astype(int)
    at = np.concatenate([[0], np.cumsum(ticks)])
    series = np.full(at[-1] + 1, np.nan)
    series[at] = value
    return series


def _colour(series: Array) -> tuple[Whiteness | None, float | None]:
    """Test of whiteness, and the autocorrelation that is largest over the tested lags (by magnitude, with its sign)."""
    known = series[np.isfinite(series)]
    if known.size < LEAST or np.ptp(known) == 0.0:
        return None, None
    r = acf(series, LAGS)[1:]
    return whiteness(series, lags=LAGS), float(r[np.argmax(np.abs(r))])

"""Compare runs of one mission: errors, honesty of the covariance, what the innovations say; one table for all of
them.

What one run says of itself: errors, honesty of the covariance, and what is left in the innovations.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.arguments import intervals, needs, within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.chi_square import chi_square_range
from navfilter.foundation.quoting import json_value
from navfilter.models.mission import Stream
from navfilter.models.sensors import Sensor, traits
from navfilter.timeseries.diagnostics import Whiteness, acf, whiteness
from navfilter.track.track import ERRORS, Track, Tracks

if TYPE_CHECKING:
    import pandas as pd

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


#: Rows of the table that need a truth: name, key, format, whether a ratio to the baseline makes sense.
_ROWS = (
    ("position rms [m]", "position_rms_m", "{:.2f}", True),
    ("position max [m]", "position_max_m", "{:.2f}", True),
    ("position end [m]", "position_end_m", "{:.2f}", False),
    ("position end [% of distance]", "position_end_pct", "{:.3f}", False),
    ("heading rms [deg]", "heading_rms_deg", "{:.4f}", True),
    ("velocity rms [m/s]", "velocity_rms_m_s", "{:.4f}", True),
)


def compare(
    tracks: Tracks,
    truth: Stream | None = None,
    *,
    begin_s: float | None = None,
    windows: Windows = (),
    baseline: str | None = None,
) -> Comparison:
    """Put runs of one mission side by side.

    Parameters
    ----------
    tracks : dict of str to Track
        Runs by label. A smoothed track is judged by its smoothed states; its innovations are those of its forward run.
    truth : Stream, optional
        ``mission.truth``; without it only what the readings themselves tell is there.
    begin_s : float, optional
        Nothing before this time [s] is scored: a filter that learns on the way is given its first window.
    windows : tuple of (float, float)
        Times [s] to be scored, such as ``mission.windows``; default all.
    baseline : str, optional
        Label of the run that the ratios of the table refer to.

    Returns
    -------
    Comparison
        Its text is the table.

    Raises
    ------
    ValueError
        Without tracks, for an unknown baseline, or when nothing is left to be scored.

    Notes
    -----
    Prediction errors and whiteness are those of the readings that *every* run has used, so that a run gains nothing by
    rejecting more. Innovations of an honest filter are independent, so the 95 % range of a mean NIS is that of
    chi-square. Navigation errors are not: the range of a NEES counts as many independent errors as their
    autocorrelation leaves (Bar-Shalom, Li & Kirubarajan, 2001, sec. 5.4.2, for the statistic; Bartlett, 1946, for the
    count), which for the position of a single mission is often hardly more than one.
    """
    needs("compare: tracks", tracks, Mapping, hint='By label: {"GM1": track}.')
    for label, track in tracks.items():
        needs(f'compare: tracks["{label}"]', track, Track)
    needs("compare: truth", truth, Stream, type(None), hint="That of a mission is mission.truth.")
    windows = intervals(windows, "compare: windows")
    if not tracks:
        raise ValueError(
            'compare needs at least one track, found none. Example: nf.compare({"GM1": track}, truth=mission.truth).'
        )
    if baseline is not None and baseline not in tracks:
        raise ValueError(f'the baseline "{baseline}" is none of the runs ({", ".join(tracks)}).')
    scored = _scored_windows(tracks, begin_s, windows)
    cut = {label: _cut(track, scored) for label, track in tracks.items()}
    common = _common(cut)
    runs = {label: figures_of(track, truth, scored, common) for label, track in cut.items()}
    return Comparison(runs, scored, baseline)


def _scored_windows(tracks: Tracks, begin_s: float | None, windows: Windows) -> Windows:
    """The times that are scored: what is left of the windows after `begin_s`."""
    first, last = (f(float(t.time_s[i]) for t in tracks.values()) for f, i in ((min, 0), (max, -1)))
    start = first if begin_s is None else float(begin_s)
    scored = tuple((max(a, start), b) for a, b in windows or ((first, last),) if b > max(a, start))
    if not scored or not any(within(t.time_s, scored).any() for t in tracks.values()):
        raise ValueError(
            f"nothing is left to be scored after {start:g} s: the runs end at {last:g} s. Give an earlier begin_s."
        )
    return scored


def _cut(track: Track, windows: Windows) -> Track:
    """The same track with only those residuals that are scored; `Track.summary` then counts and averages no others."""
    kept = {}
    for name, r in track.residuals.items():
        rows = within(r.time_s, windows)
        kept[name] = Residuals(r.time_s[rows], r.value[rows], r.sd[rows], r.nis[rows], r.dof[rows], r.outcome[rows])
    return dataclasses.replace(track, residuals=kept)


def _common(tracks: Tracks) -> dict[str, Array]:
    """Times of the readings of each sensor that all runs with that sensor have used."""
    result: dict[str, Array] = {}
    for track in tracks.values():
        for name, r in track.residuals.items():
            used = r.time_s[r.used]
            result[name] = np.intersect1d(result[name], used) if name in result else np.unique(used)
    return result


# --- the result -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Comparison:
    """Runs of one mission side by side; ``print`` it.

    Attributes
    ----------
    runs : dict of str to dict
        Figures by label of the run; None where there is no truth or there are too few readings.
    windows : tuple of (float, float)
        Times [s] that were scored.
    baseline : str or None
        Label of the run that the ratios refer to.
    remarks : tuple of str
        What else has to be known to judge the table; printed below it.
    """

    runs: Mapping[str, Mapping[str, Any]]
    windows: Windows
    baseline: str | None = None
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        from navfilter.rendering.page import table_text

        return "\n".join([table_text(["", *self.runs], self.rows()), *self.notes()])

    def rows(self) -> list[list[str]]:
        """The table without its header: name of the figure, then the figure of every run, as text."""
        rows = [
            [name, *self._cells(key, form, ratio)]
            for name, key, form, ratio in _ROWS
            if any(run[key] is not None for run in self.runs.values())
        ]
        for name in ("position", "heading"):
            found = [run["nees"].get(name) for run in self.runs.values()]
            if any(found):
                rows.append([f"NEES {name}", *(_marked(f and f["mean"], f and f["band"]) for f in found)])
                rows.append([f"{name} beyond 3 sigma [%]", *(_percent(f and f["outside_3_sigma"]) for f in found)])
        rows.append(["NIS, mean of the sensors", *(number_text(run["nis"], "{:.3f}") for run in self.runs.values())])
        for name in self._sensors():
            rows += self._sensor_rows(name)
        rows.append(["processor time [s]", *(number_text(run["cpu_s"], "{:.1f}") for run in self.runs.values())])
        return rows

    def _cells(self, key: str, form: str, ratio: bool) -> Iterator[str]:
        values = {label: run[key] for label, run in self.runs.items()}
        for label, value in values.items():
            yield number_text(value, form) + (self._ratio(label, values) if ratio else "")

    def _ratio(self, label: str, values: Mapping[str, float | None]) -> str:
        """The ratio to the baseline in brackets; nothing for the baseline itself."""
        if self.baseline is None or label == self.baseline:
            return ""
        value, base = values[label], values[self.baseline]
        return f" ({value / base:.2f})" if value is not None and base else ""

    def _sensors(self) -> list[str]:
        """Sensors of any run, in the order of their first appearance, that have given readings."""
        found = [name for run in self.runs.values() for name, sensor in run["sensors"].items() if sensor["axes"]]
        return list(dict.fromkeys(found))

    def _sensor_rows(self, name: str) -> list[list[str]]:
        sensors = {label: run["sensors"].get(name) for label, run in self.runs.items()}
        unit = next(s["unit"] for s in sensors.values() if s)
        rms = {label: _rms_of_axes(s) for label, s in sensors.items()}
        cells = [number_text(rms[label], "{:.4g}") + self._ratio(label, rms) for label in sensors]
        return [
            [f"{name}: NIS", *(_marked(s and s["nis"], s and s["band"]) for s in sensors.values())],
            [f"{name}: prediction error rms [{unit}]", *cells],
            [f"{name}: largest autocorrelation", *(_white_cell(s) for s in sensors.values())],
            [f"{name}: beyond 3 sigma [%]", *(_percent(s and s["outside_3_sigma"]) for s in sensors.values())],
        ]

    def notes(self) -> list[str]:
        """How the table is to be read, one line each."""
        when = ", ".join(f"{a:.0f} to {b:.0f} s" for a, b in self.windows[:4]) + (
            " ..." if len(self.windows) > 4 else ""
        )
        lines = [f"scored: {when}."]
        if self.baseline is not None:
            lines.append(f"(...) is the ratio to {self.baseline}; below 1 is better.")
        lines.append(
            "NEES and NIS are per degree of freedom, 1 is honest; * is outside the 95 % range. Autocorrelations of the "
            "innovations"
        )
        lines.append(
            'over 20 lags, the largest of the axes; "white" where every axis passes. 0.27 % of honest errors lie '
            "beyond 3 sigma."
        )
        return [*lines, *self.remarks]

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values: "windows_s", "baseline", "remarks" and "runs"."""
        windows = [list(w) for w in self.windows]
        return {
            "windows_s": windows,
            "baseline": self.baseline,
            "remarks": list(self.remarks),
            "runs": json_value(self.runs),
        }

    def to_frame(self) -> pd.DataFrame:
        """One row per run; a column per figure, nested keys joined by dots, such as
        ``sensors.dvl.axes.x.prediction_rms``.
        """
        import pandas as pd

        return pd.DataFrame.from_dict({label: dict(_flat(run)) for label, run in self.runs.items()}, orient="index")


def number_text(value: float | None, form: str) -> str:
    """A number, or a dash where there is none."""
    return "–" if value is None else form.format(value)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.2f}"


def _marked(value: float | None, band: tuple[float, float] | None) -> str:
    """The number, starred when it lies outside its range."""
    if value is None:
        return "–"
    return f"{value:.3f}" + ("*" if band is not None and not band[0] <= value <= band[1] else " ")


def _rms_of_axes(sensor: Mapping[str, Any] | None) -> float | None:
    """Root of the mean square over the axes."""
    axes = sensor["axes"].values() if sensor else ()
    return math.sqrt(sum(a["prediction_rms"] ** 2 for a in axes) / len(axes)) if axes else None


def _white_cell(sensor: Mapping[str, Any] | None) -> str:
    tested = [a for a in (sensor["axes"].values() if sensor else ()) if a["is_white"] is not None]
    if not tested:
        return "–"
    largest = max((a["largest_acf"] for a in tested), key=abs)
    return ("white " if all(a["is_white"] for a in tested) else "") + f"{largest:+.3f}"


def _flat(run: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in run.items():
        name = f"{before}.{key}" if before else key
        if isinstance(value, Mapping):
            yield from _flat(value, name)
        elif isinstance(value, tuple):
            yield f"{name}_low", value[0]
            yield f"{name}_high", value[1]
        else:
            yield name, value

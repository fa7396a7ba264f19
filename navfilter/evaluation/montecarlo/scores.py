"""What is kept of one run: a few figures and thinned curves, for the forward track and for the smoothed one."""

import math

import numpy as np

from navfilter.evaluation.montecarlo.slots import SLOT_SCORES, Slots, slot_figures
from navfilter.filter.records import Residuals
from navfilter.foundation.arrays import Array, Ints
from navfilter.models.mission import Mission
from navfilter.timeseries.diagnostics import whiteness
from navfilter.track.track import Track, TrackErrors

TRACKS = ("forward", "smoothed")
#: Of each track, over the scored part. What belongs to the run stands with its forward track.
SCORES = (
    "heading_rms_deg", "position_rms_m", "end_m", "end_pct", "anees_position", "anees_heading",
    "nis_sensor", "nis_all", "white", "ljung_box", "rejected_pct", "adopted", "adoptions",
)  # fmt: skip
#: Over time: errors [m, deg], their predicted standard deviations, NEES per degree of freedom.
CURVES: tuple[str, ...] = ("north_m", "north_sd_m", "east_m", "east_sd_m")
CURVES += ("heading_deg", "heading_sd_deg", "nees_position", "nees_heading")


def curve_times(duration_s: float) -> Array:
    """Times of the curves [s]: about 400, never closer than a second."""
    return np.arange(0.0, duration_s + 1e-6, max(1.0, math.ceil(duration_s / 400.0)))


def run_record(track: Track, mission: Mission, sensor: str, score_from_s: float, cut: Slots = ()) -> dict[str, Array]:
    """The figures and curves of one run.

    Parameters
    ----------
    track : Track
        Smoothed (then its forward track is scored too) or forward.
    mission : Mission
        With truth.
    sensor : str
        The correcting sensor that is studied.
    score_from_s : float
        Time [s] from which the run is scored.
    cut : Slots
        That are scored apart.

    Returns
    -------
    dict of str to ndarray
        "scores" (2, len(SCORES)), "slots" (2, len(cut), len(SLOT_SCORES)) and "curves" (2, len(CURVES), m) by track,
        NaN where there is none; "cpu_s" ().
    """
    times = curve_times(mission.duration_s)
    scores, curves = np.full((2, len(SCORES)), np.nan), np.full((2, len(CURVES), times.size), np.nan)
    apart = np.full((2, len(cut), len(SLOT_SCORES)), np.nan)
    forward = track.forward or track
    for i, one in enumerate((forward, track)[: 1 if track.forward is None else 2]):
        if mission.truth is None:
            raise ValueError("A run can only be scored against a mission that holds the truth.")
        errors = one.errors(mission.truth)
        nees = one.nees(errors)
        figures, curves[i] = _track_figures(one, mission, errors, nees, score_from_s, times)
        apart[i] = slot_figures(one, errors, nees, cut)
        if i == 0:
            figures |= _sensor_figures(one, sensor, score_from_s)
        scores[i] = [figures.get(name, np.nan) for name in SCORES]
    record = {"scores": scores, "slots": apart, "curves": curves.astype(np.float32)}
    return record | {"cpu_s": np.array(track.cpu_s)}


def _track_figures(
    track: Track, mission: Mission, errors: TrackErrors, nees: dict[str, Array], score_from_s: float, times: Array
) -> tuple[dict[str, float], Array]:
    scored = slot_figures(track, errors, nees, ((score_from_s, math.inf),))[0]
    figures = dict(zip(SLOT_SCORES, scored.tolist(), strict=True))
    begin, end = _dive(mission)
    row = _rows(track, np.array([end]))[0]
    figures["end_m"] = float(errors.horizontal[row])
    way = _way(mission, begin, end)
    figures["end_pct"] = 100.0 * figures["end_m"] / way if way > 0.0 else math.nan
    at = _rows(track, times)
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        heading_sd = np.abs(errors.heading) / np.sqrt(nees["heading"])
    north, east = errors.position_n[:, 0], errors.position_n[:, 1]
    degrees = np.degrees(errors.heading), np.degrees(heading_sd)
    curves = np.stack([north, sd[:, 0], east, sd[:, 1], *degrees, nees["position"], nees["heading"]])
    return figures, curves[:, at]


def _sensor_figures(track: Track, sensor: str, score_from_s: float) -> dict[str, float]:
    """NIS, whiteness and adoptions, from the innovations of the forward run."""
    total, freedom = 0.0, 0.0
    figures: dict[str, float] = {}
    for name, residuals in track.residuals.items():
        used = residuals.used & (residuals.time_s >= score_from_s)
        nis, dof = float(residuals.nis[used].sum()), float(residuals.dof[used].sum())
        total, freedom = total + nis, freedom + dof
        if name == sensor:
            figures["nis_sensor"] = nis / dof if dof else math.nan
            seen = np.isfinite(residuals.nis) & (residuals.time_s >= score_from_s)
            figures["rejected_pct"] = 100.0 * (1.0 - used.sum() / seen.sum()) if seen.any() else math.nan
            period_s = 1.0 / track.vehicle.sensors[name].rate_hz
            figures["white"], figures["ljung_box"] = _whiteness(residuals, score_from_s, period_s)
    figures["nis_all"] = total / freedom if freedom else math.nan
    figures["adoptions"] = float(len(track.error_models.get(sensor, ())) - 1)
    figures["adopted"] = float(figures["adoptions"] > 0)
    return figures


def _whiteness(residuals: Residuals, score_from_s: float, period_s: float) -> tuple[float, float]:
    """Whether the standardised innovations of all axes are white (1 % level, shared by them), and the largest Ljung-Box
    over its dof.
    """
    rows = residuals.used & (residuals.time_s >= score_from_s)
    if np.count_nonzero(rows) < 100:
        return math.nan, math.nan
    tick = np.round((residuals.time_s[rows] - residuals.time_s[rows][0]) / period_s).astype(int)
    axes = residuals.value.shape[1]
    verdicts, boxes = [], []
    for axis in range(axes):
        # missing and rejected readings are gaps in a regular series, not neighbours
        series = np.full(tick[-1] + 1, np.nan)
        series[tick] = residuals.value[rows, axis] / residuals.sd[rows, axis]
        result = whiteness(series, level=0.01 / axes)
        verdicts.append(result.is_white)
        boxes.append(result.ljung_box / result.lags)
    return float(all(verdicts)), max(boxes)


def _dive(mission: Mission) -> tuple[float, float]:
    """The longest time without fixes [s]; its end is where a dive is judged, before the fixes of the surface help."""
    first, last = 0.0, mission.duration_s
    if mission.truth is not None:
        first, last = float(mission.truth.time_s[0]), float(mission.truth.time_s[-1])
    fixes = mission.streams["gps"].time_s if "gps" in mission.streams else np.empty(0)
    edges = np.concatenate([[first], fixes, [last]])
    longest = int(np.argmax(np.diff(edges)))
    return float(edges[longest]), float(edges[longest + 1])


def _way(mission: Mission, begin_s: float, end_s: float) -> float:
    """Horizontal way really travelled between two times [m]."""
    if mission.truth is None:
        return math.nan
    t = mission.truth.time_s
    speed = np.hypot(mission.truth.column("v_north_m_s"), mission.truth.column("v_east_m_s"))
    inside = (t[1:] > begin_s) & (t[1:] <= end_s)
    return float(np.sum((0.5 * (speed[1:] + speed[:-1]) * np.diff(t))[inside]))


def _rows(track: Track, times: Array) -> Ints:
    """The last row of the track before each of these times (the first row for times before it)."""
    return np.maximum(np.searchsorted(track.time_s, times - 1e-6, side="right") - 1, 0)

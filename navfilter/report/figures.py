"""The figures of a report over time. Each takes the runs as a dict of label to Track, so that several models stand side
by side.

Bounds, trust and lanes along a run: how far the truth may be, when and why the state is not to be trusted, and which
lane was in force.

Figures of the states behind the nine of navigation: biases, coloured errors, calibration parameters; and of what
drives, which has no innovations.

Figures of what was learnt: the spectrum beside the one that was believed, and the models over time.
"""

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from navfilter.evaluation.over_dives_text import LearnedText
from navfilter.filter.records import OUTCOMES
from navfilter.foundation.arrays import Array
from navfilter.foundation.chi_square import chi_square_range
from navfilter.models.error_models import ErrorModel
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors.traits import shown_unit
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import Apart
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Level, Line, Mark, Panel, Part, Points, Stack, short
from navfilter.rendering.thinning import broken
from navfilter.track.track import DegradedInterval, Track, Tracks, spells

#: Told apart in grey by their brightness.
HUES = {"degraded": "#e69f00", "lost": "#8b1a1a"}
#: Below this an error is no longer told from none: the axes are logarithmic [m], [deg].
LEAST = (1e-2, 1e-3)
#: Share of the median below which nothing is shown [1].
SHOWN = 0.02
#: So many spells are listed one by one.
MOST = 30
CAPTION = (
    "Solid: how far the truth may be, in 99.9 % of the time, under any single fault of a sensor that has not been "
    "found (protection radius of the position, bound of the heading); a gap where nothing bounds it. "
)
_WITH_TRUTH = "Dotted: where the truth was. "
_SHADES = "Shaded: times in which something spoke against the state; darker, it was lost."
LANES = (
    "Top: the lane in force. Gain: the mean by which a lane foretold each component of the readings of the last minute "
    "better than as an outlier (logarithm of the densities), 8.3 for one that is foretold as surely as its sensor "
    "errs; the higher one is believed. NIS: squared residuals over their predicted variances; 1 is honest, and a lane "
    "that says little has a small one. Marked: a lane was left."
)
#: Of the marks where a lane is left.
HUE = "#d55e00"
#: Half the height of a bar of the lane in force [1]: the next lane's is a distance of 1 away.
HALF = 0.35
#: NIS below and beyond which nothing is drawn: the axis is logarithmic.
LEAST_NIS, MOST_NIS = 1e-3, 1e4


def trust_figure(tracks: Tracks, truth: Stream | None) -> tuple[Stack, str] | None:
    """Protection radius and bound of the heading of every forward run, with its caption; None where there are none.

    Parameters
    ----------
    tracks : dict of str to Track
    truth : Stream, optional
        Its distance is drawn beside the bounds.
    """
    bounded = {label: track for label, track in tracks.items() if track.bounds is not None and len(track)}
    if not bounded:
        return None
    parts: tuple[list[Part], list[Part]] = ([], [])
    for number, (label, track) in enumerate(bounded.items()):
        assert track.bounds is not None
        hue, dash = colour(number + 1)
        for panel, values in zip(parts, (track.bounds[:, 0], np.degrees(track.bounds[:, 1])), strict=True):
            panel.append(
                Line(track.time_s, np.where(np.isfinite(values), values, np.nan), f"{label}, bound", hue, dash)
            )
        if truth is None:
            continue
        errors = track.errors(truth)
        for panel, off, least in zip(parts, (errors.horizontal, np.degrees(errors.attitude[:, 2])), LEAST, strict=True):
            if np.isfinite(off).any():
                seen = np.maximum(np.abs(off), least)
                panel.append(Line(track.time_s, seen, f"{label}, error", "#000000", (0, (1, 1.2)), 0.8))
    labels = ("horizontal [m]", "heading [deg]")
    panels = tuple(
        Panel(label, tuple(lines), _limits(lines, least), log=True)
        for label, lines, least in zip(labels, parts, LEAST, strict=True)
    )
    marks = tuple(_mark(spell) for spell in spells(next(iter(bounded.values()))))
    caption = f"{CAPTION}{'' if truth is None else _WITH_TRUTH}{_SHADES if marks else ''}"
    return Stack(panels, 1.9, marks), caption


def _limits(lines: list[Part], least: float) -> tuple[float, float] | None:
    """From the smallest to the largest of what is drawn, without errors of next to nothing."""
    values = np.concatenate([part.y for part in lines if isinstance(part, Line)])
    values = values[np.isfinite(values) & (values > 0.0)]
    if not values.size:
        return None
    return max(0.7 * float(values.min()), SHOWN * float(np.median(values)), least), 1.5 * float(values.max())


def _mark(spell: DegradedInterval) -> Mark:
    """A spell as a band; its reason appears below the pointer."""
    return Mark(spell.begin_s, spell.end_s, spell.level, short(str(spell), 80), HUES[spell.level])


def spell_rows(track: Track) -> tuple[list[str], list[list[str]]]:
    """The spells of a run as a table: from, to, level, reason; the longest ones where there are many."""
    found = spells(track)
    shown = sorted(found, key=lambda spell: spell.begin_s - spell.end_s)[:MOST]
    rows = [
        [f"{spell.begin_s:.0f}", f"{spell.end_s:.0f}", spell.level, spell.reason]
        for spell in sorted(shown, key=lambda spell: spell.begin_s)
    ]
    if len(found) > MOST:
        rows.append(["", "", "", f"and {len(found) - MOST} shorter ones"])
    return ["from [s]", "to [s]", "trust", "because"], rows


# --- lanes -----------------------------------------------------------------------------------------------------------


def lane_figure(track: Track) -> Stack | None:
    """Lane in force, gain and NIS of each over the run; None for a vehicle without lanes.

    Parameters
    ----------
    track : Track
        A smoothed one shows its forward run.
    """
    run = track.forward or track
    history = run.lane_history
    if history is None or not len(run):
        return None
    bars, gains, squares = [], [], []
    for i, name in enumerate(history.names):
        hue, dash = colour(i)
        title = short(name)
        bars += [_bar(begin_s, end_s, i, title, hue) for begin_s, end_s, lane in _stretches(run) if lane == name]
        gains.append(Line(history.time_s, history.gain[:, i], title, hue, dash))
        squares.append(Line(history.time_s, np.clip(history.nis[:, i], LEAST_NIS, MOST_NIS), title, hue, dash))
    ticks = tuple((float(i), short(name)) for i, name in enumerate(history.names))
    limits = (-0.5, len(history.names) - 0.5)
    panels = (
        Panel("in force", tuple(bars), limits, ticks=ticks),
        Panel("gain", tuple(gains), shape="from zero"),
        Panel("NIS", tuple(squares), log=True, lines_at=(1.0,)),
    )
    return Stack(panels, 1.4, lane_marks(run))


def lane_marks(track: Track) -> tuple[Mark, ...]:
    """The moments at which a lane was left for another."""
    return tuple(
        Mark(float(at_s), float(at_s), "lane left", short(f"{left} left for {taken}: {why}", 80), HUE)
        for at_s, left, taken, why in lane_rows(track)[1]
    )


def _stretches(run: Track) -> list[tuple[float, float, str]]:
    """From when to when [s] each lane was in force."""
    begins = [*(time_s for time_s, _ in run.lanes), float(run.time_s[-1])]
    return [(begin, end, name) for begin, end, (_, name) in zip(begins, begins[1:], run.lanes, strict=False)]


def _bar(begin_s: float, end_s: float, row: int, label: str, hue: str) -> Band:
    ends = np.array([begin_s, max(begin_s, end_s)])
    return Band(ends, np.full(2, row - HALF), np.full(2, row + HALF), label, hue, 0.8)


def lane_rows(track: Track) -> tuple[list[str], list[list[str]]]:
    """The changes of lane as a table: when, from which, to which, and why."""
    run = track.forward or track
    reasons = () if run.lane_history is None else run.lane_history.reasons
    pairs = zip(run.lanes, run.lanes[1:], reasons, strict=False)
    rows = [[f"{time_s:.2f}", left, taken, why] for (_, left), (time_s, taken), why in pairs]
    return ["at [s]", "left", "taken", "because"], rows


#: How the truth is drawn.
TRUTH: dict[str, Any] = {"label": "truth", "hue": "#000000", "dash": (0, (1, 1.2))}
#: Captions.
NEES = "Squared error in units of its predicted variance. Above the grey range: too confident; below it: too modest."
NIS = (
    "Squared innovation in units of its predicted variance, mean over a moving window. Honest is 1; the grey range "
    "holds 95 % of such means."
)
SEPARATION = (
    "Forward minus smoothed track: what the later readings say against the earlier ones, with the band that honest "
    "tracks differ by. An error that lasts stays on one side; beyond three bands something pulls that vehicle.toml "
    "does not describe."
)
BACKWARD = (
    "The run from beginning to end minus one from end to beginning, which have no reading in common. Of honest ones "
    "95 % of the differences lie inside the band; where one stays outside, one of the two met what vehicle.toml does "
    "not describe. The first hundredth of either run may lie beyond the axes: its start is known badly."
)
USED, REJECTED = "#0072b2", "#d55e00"


def filters(tracks: Tracks) -> dict[str, Track]:
    """One run per set of residuals: a smoothed track has those of its forward track."""
    first: dict[int, tuple[str, Track]] = {}
    for label, track in tracks.items():
        first.setdefault(id(track.forward or track), (label, track))
    return dict(first.values())


def depth_figure(tracks: Tracks, mission: Mission) -> Stack:
    """Height (under water minus the depth) and horizontal speed over time."""
    truth = mission.truth
    heights = [(track.height, np.sqrt(track.covariance[:, 2, 2])) for track in tracks.values()]
    speeds = [(np.hypot(*track.velocity_n[:, :2].T), None) for track in tracks.values()]
    true = (None, None) if truth is None else (truth.value[:, 2], np.hypot(*truth.value[:, 3:5].T))
    speed = Panel("speed [m/s]", _states(tracks, speeds, truth, true[1]), shape="from zero")
    return Stack((Panel("height [m]", _states(tracks, heights, truth, true[0])), speed))


def attitude_figure(tracks: Tracks, mission: Mission) -> Stack:
    """Roll, pitch and heading over time."""
    truth, panels = mission.truth, []
    for i, name in enumerate(("roll", "pitch", "heading")):
        true = None if truth is None else _unbroken(np.degrees(truth.value[:, 6 + i]), i == 2)
        shown = [(_unbroken(np.degrees(track.attitude[:, i]), i == 2), None) for track in tracks.values()]
        panels.append(Panel(f"{name} [deg]", _states(tracks, shown, truth, true)))
    return Stack(tuple(panels))


def _unbroken(angle_deg: Array, turns: bool) -> Array:
    """A heading within 0 and 360 deg, with a NaN where it passes north."""
    if not turns:
        return angle_deg
    angle_deg = angle_deg % 360.0
    angle_deg[1:][np.abs(np.diff(angle_deg)) > 180.0] = np.nan
    return angle_deg


def _states(
    tracks: Tracks, shown: Sequence[tuple[Array, Array | None]], truth: Stream | None, true: Array | None
) -> tuple[Part, ...]:
    """Value and band of every run, and the truth where it is known."""
    parts: list[Part] = []
    for number, ((label, track), (value, sd)) in enumerate(zip(tracks.items(), shown, strict=True)):
        hue, dash = colour(number)
        if sd is not None:
            parts.append(Band(track.time_s, value - sd, value + sd, f"{label} ±1σ", hue))
        parts.append(Line(track.time_s, value, label, hue, dash))
    if truth is not None and true is not None and np.isfinite(true).any():
        begin_s, end_s = (f(t.time_s[i] for t in tracks.values()) for f, i in ((min, 0), (max, -1)))
        inside = (truth.time_s >= begin_s) & (truth.time_s <= end_s)
        parts.append(Line(truth.time_s[inside], true[inside], **TRUTH))
    return tuple(parts)


def position_figure(tracks: Tracks, truth: Stream | None) -> Stack:
    """Position error north, east, down with its 1-sigma band, and in per cent of the distance travelled.

    Without truth the bands alone are drawn: what the filter believes.
    """
    parts: list[list[Part]] = [[], [], [], []]
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        t, sd = track.time_s, np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
        error = np.full((len(track), 3), np.nan) if truth is None else track.errors(truth).position_n
        for i in range(3):
            parts[i].append(Band(t, -sd[:, i], sd[:, i], f"{label} ±1σ", hue))
            if truth is not None:
                parts[i].append(Line(t, error[:, i], label, hue, dash))
        far = track.travelled()
        far[far < max(50.0, 0.02 * far[-1])] = np.nan
        if truth is not None:
            parts[3].append(Line(t, 100 * np.hypot(error[:, 0], error[:, 1]) / far, label, hue, dash))
        predicted = 100 * track.horizontal_sd() / far
        parts[3].append(Line(t, predicted, f"{label}, predicted rms", hue, (0, (1, 1.2)), 0.9))
    names = ("north [m]", "east [m]", "down [m]")
    panels = [Panel(name, tuple(parts[i]), shape="symmetric", lines_at=(0.0,)) for i, name in enumerate(names)]
    if any(np.isfinite(part.y).any() for part in parts[3] if isinstance(part, Line)):  # far enough for per cents
        panels.append(Panel("horizontal\n[% of distance]", tuple(parts[3]), shape="from zero"))
    return Stack(tuple(panels))


def separation_figure(forward: Track, smoothed: Track) -> Stack:
    """Forward minus smoothed track over time, with the standard deviation that honest ones differ by: the root of
    P_forward - P_smoothed.
    """
    if not np.array_equal(forward.time_s, smoothed.time_s):
        smoothed = smoothed.at(forward.time_s)
    origin = float(forward.latitude[0]), float(forward.longitude[0])
    apart = forward.local(*origin) - smoothed.local(*origin)
    turned = np.degrees(forward.attitude[:, 2] - smoothed.attitude[:, 2])
    values = np.column_stack([apart, (turned + 180.0) % 360.0 - 180.0])
    rows, scale = [0, 1, 2, 8], np.array([1.0, 1.0, 1.0, 180.0 / np.pi])
    variance = np.diagonal(forward.covariance - smoothed.covariance, axis1=1, axis2=2)[:, rows]
    sd, (hue, dash) = scale * np.sqrt(np.maximum(variance, 0.0)), colour(0)
    panels = []
    for i, name in enumerate(("north [m]", "east [m]", "down [m]", "heading [deg]")):
        band = Band(forward.time_s, -sd[:, i], sd[:, i], "±1σ", hue)
        line = Line(forward.time_s, values[:, i], "forward - smoothed", hue, dash)
        panels.append(Panel(name, (band, line), shape="symmetric", lines_at=(0.0,)))
    return Stack(tuple(panels))


def backward_figure(apart: Apart) -> Stack:
    """Forward minus backward run over time, with twice the standard deviation that independent runs differ by, and
    that of the smoothed track.
    """
    hue, dash = colour(0)
    known = slice(len(apart.time_s) // 100, len(apart.time_s) - len(apart.time_s) // 100)
    values = np.column_stack([apart.north_m, apart.east_m, apart.down_m, np.degrees(apart.heading_rad)])
    scale, panels = np.array([1.0, 1.0, 1.0, 180.0 / np.pi]), []
    for i, name in enumerate(("north [m]", "east [m]", "down [m]", "heading [deg]")):
        bands = [(apart.sd, "±2σ of both", hue)]
        if apart.smoothed_sd is not None:
            bands.append((apart.smoothed_sd, "±2σ smoothed", colour(1)[0]))
        widths = [(2.0 * scale[i] * sd[:, i], label, shade) for sd, label, shade in bands]
        parts: list[Part] = [Band(apart.time_s, -width, width, label, shade) for width, label, shade in widths]
        parts.append(Line(apart.time_s, values[:, i], "forward - backward", hue, dash))
        shown = np.abs(np.concatenate([values[known, i], widths[0][0][known]]))
        most = 1.05 * float(np.max(shown, where=np.isfinite(shown), initial=0.0)) or 1.0
        panels.append(Panel(name, tuple(parts), limits=(-most, most), lines_at=(0.0,)))
    return Stack(tuple(panels))


def heading_figure(tracks: Tracks, truth: Stream | None) -> Stack:
    """Heading error with its 1-sigma band."""
    parts: list[Part] = []
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        sd = np.degrees(np.sqrt(track.covariance[:, 8, 8]))
        parts.append(Band(track.time_s, -sd, sd, f"{label} ±1σ", hue))
        if truth is not None and np.isfinite(truth.value[:, 8]).any():
            parts.append(Line(track.time_s, np.degrees(track.errors(truth).heading), label, hue, dash))
    return Stack((Panel("heading error [deg]", tuple(parts), shape="symmetric", lines_at=(0.0,)),), 2.2)


def consistency_figure(tracks: Tracks, truth: Stream) -> Stack | None:
    """NEES of position and heading per degree of freedom over time, with the 95 % range of chi-square; None without
    truth of either.
    """
    errors = {label: track.errors(truth) for label, track in tracks.items()}
    freedom = {
        "position": max(int(np.isfinite(e.position_n).any(axis=0).sum()) for e in errors.values()),
        "heading": int(any(np.isfinite(e.heading).any() for e in errors.values())),
    }
    panels = []
    for name, dof in freedom.items():
        if not dof:
            continue
        parts, top = [], 10.0
        for number, (label, track) in enumerate(tracks.items()):
            nees = np.maximum(track.nees(errors[label])[name], 1e-3)
            parts.append(Line(track.time_s, nees, label, *colour(number)))
            top = max(top, 1.3 * _quantile(nees, 1.0))
        low, high = map(float, chi_square_range(dof))
        level = Level(max(low, 1e-3), high, "95 % of chi-square")
        limits = (1e-2, top)
        panels.append(Panel(f"{name}\nNEES per dof", tuple(parts), limits, log=True, lines_at=(1.0,), level=level))
    return Stack(tuple(panels), 1.6) if panels else None


def innovation_figure(track: Track, name: str) -> Stack:
    """Innovations of one sensor, each axis with its 3-sigma bounds; rejected readings are crossed, at the edge when off
    the scale.
    """
    residuals, sensor = track.residuals[name], track.vehicle.sensors[name]
    measured = np.flatnonzero(np.isfinite(residuals.value).any(axis=0)).tolist() or [0]
    rejected = residuals.outcome == OUTCOMES.index("rejected")
    panels = []
    for i in measured:
        unit, factor = shown_unit(sensor.units[i]) if i < sensor.axes else ("", 1.0)
        seen = residuals.used & np.isfinite(residuals.sd[:, i])
        t, value = residuals.time_s[seen], factor * residuals.value[seen, i]
        bound = 3 * factor * residuals.sd[seen, i]
        limit = 1.25 * max(_quantile(bound, 0.98), _quantile(np.abs(value), 0.998), 1e-12)
        parts: list[Part] = [
            Points(t, value, "used", USED) if len(t) <= 1500 else Line(t, value, "used", USED, width=0.5)
        ]
        parts += [Line(t, sign * bound, "±3σ", "#000000", width=0.8) for sign in (-1, 1)]
        against = rejected | (residuals.used & ~seen)  # also what was left out alone
        out = capped(np.column_stack([residuals.time_s[against], factor * residuals.value[against, i]]))
        out = out[np.isfinite(out[:, 1])]
        near = np.abs(out[:, 1]) <= limit
        if near.any():
            parts.append(Points(out[near, 0], out[near, 1], "rejected", REJECTED, "x"))
        if not near.all():
            edge = np.sign(out[~near, 1]) * 0.96 * limit
            parts.append(Points(out[~near, 0], edge, "rejected, off the scale", REJECTED, "D"))
        axis = sensor.axis_names[i] if i < len(sensor.axis_names) else str(i)
        panels.append(Panel(f"{short(name)} {axis}".strip() + f"\n[{unit}]", tuple(parts), (-limit, limit)))
    return Stack(tuple(panels), 1.45)


def nis_figure(tracks: Tracks) -> Stack | None:
    """Moving mean of NIS per degree of freedom, sensor by sensor, with the 95 % range of such means; None without
    readings.
    """
    names = dict.fromkeys(name for track in tracks.values() for name, r in track.residuals.items() if r.used.sum() >= 5)
    panels = []
    for name in names:
        top = 2.0
        parts: list[Part] = []
        for number, (label, track) in enumerate(tracks.items()):
            if name not in track.residuals or track.residuals[name].used.sum() < 5:
                continue
            t, mean, low, high = moving_nis(track, name)
            if number == 0:
                parts.append(Band(t, low, high, "95 % of chi-square", "#bbbbbb", 0.45))
            parts.append(Line(t, mean, label, *colour(number if len(tracks) > 1 else 1)))
            top = max(top, 1.1 * _quantile(mean, 0.995), 1.05 * float(np.nanmax(high)))
        panels.append(Panel(f"{short(name)}\nNIS per dof", tuple(parts), (0.0, min(top, 12.0)), lines_at=(1.0,)))
    return Stack(tuple(panels), 1.25) if panels else None


def moving_nis(track: Track, name: str) -> tuple[Array, Array, Array, Array]:
    """Moving mean of NIS per degree of freedom over the used readings of a sensor.

    Returns
    -------
    time_s, mean, low, high : ndarray, shape (n,)
        The bounds hold 95 % of such means when the filter is honest; a NaN row stands in every gap.
    """
    residuals = track.residuals[name]
    used = residuals.used & np.isfinite(residuals.nis)
    t, nis, dof = residuals.time_s[used], residuals.nis[used], residuals.dof[used]
    window = int(np.clip(len(t) // 60, min(15, len(t)), 400))
    nis_sum, dof_sum = (np.concatenate([[0.0], np.cumsum(x)]) for x in (nis, dof))
    count = dof_sum[window:] - dof_sum[:-window]
    mean = (nis_sum[window:] - nis_sum[:-window]) / count
    low, high = chi_square_range(count)
    middle = t[window // 2 : window // 2 + len(mean)]
    step = max(1, len(mean) // 700)
    middle, mean, low, high = middle[::step], mean[::step], low[::step], high[::step]
    time, mean, low, high = broken(middle, mean, low, high)
    return time, mean, low, high


def capped(points: Array, most: int = 1500) -> Array:
    """Of many points some, evenly."""
    return points if len(points) <= most else points[np.linspace(0, len(points) - 1, most).astype(int)]


def _quantile(values: Array, p: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, p)) if finite.size else 0.0


#: Of residuals of the drive, under their figure.
STEPS = (
    "{name}: residuals of what drives (smoothed run): the step that it would have had to say too much at each time for "
    "all later readings to fit best, in standard deviations of that step. Of honest ones 95 % lie within 2; a hill is "
    "an error that lasted. The largest: {largest}."
)


@dataclass(frozen=True)
class ShownState:
    """One state worth a panel.

    Attributes
    ----------
    owner : str
        Sensor, or "gyro", "accel", "drive".
    name : str
        As in `Track.state_names`.
    label, unit : str
        For the axis.
    factor : float
        From SI to the unit.
    """

    owner: str
    name: str
    label: str
    unit: str
    factor: float


def shown_states(vehicle: Vehicle) -> tuple[ShownState, ...]:
    """The states that mean something by themselves: the first of every part of an error model, and all parameters."""
    found: list[ShownState] = []
    drive = vehicle.drive
    for axis, model, unit in zip(drive.axis_names, drive.models, drive.units, strict=True):
        owner = axis.rsplit("_", 1)[0] if drive.inertial else "drive"
        found += _parts(owner, axis, model, drive.period_s, unit)
    found += [ShownState("drive", p.name, p.name, *shown_unit(p.unit)) for p in drive.all_parameters()]
    for key, sensor in vehicle.sensors.items():
        for axis, model, unit in zip(sensor.axis_names, sensor.models, sensor.units, strict=True):
            label = "_".join(part for part in (key, axis) if part)
            found += _parts(key, label, model, 1.0 / sensor.rate_hz, unit)
        found += [ShownState(key, f"{key}.{p.name}", p.name, *shown_unit(p.unit)) for p in sensor.all_parameters()]
    return tuple(found)


def _parts(owner: str, axis: str, model: ErrorModel, period_s: float, unit: str) -> list[ShownState]:
    """The first state of each part of one axis's model."""
    sizes = [part.block(period_s).size for part in model.terms]
    found, offset = [], 0
    for part, size in zip(model.terms, sizes, strict=True):
        if size:
            kind = f" ({type(part).__name__})" if sum(map(bool, sizes)) > 1 else ""
            found.append(ShownState(owner, f"{axis}[{offset}]", f"{axis}{kind}", *shown_unit(unit)))
        offset += size
    return found


def states_figure(tracks: Tracks, states: tuple[ShownState, ...]) -> Stack:
    """Estimates over time with their 1-sigma bands, one panel per state.

    Parameters
    ----------
    tracks : dict of str to Track
    states : tuple of ShownState
        Of one owner, see `shown_states`; a run that has no such state is left out of its panel.
    """
    panels = []
    for state in states:
        parts: list[Part] = []
        for number, (label, track) in enumerate(tracks.items()):
            if state.name not in track.state_names:
                continue
            hue, dash = colour(number)
            value, sd = (state.factor * part for part in track.state(state.name))
            parts.append(Band(track.time_s, value - sd, value + sd, f"{label} ±1σ", hue))
            parts.append(Line(track.time_s, value, label, hue, dash))
        lines = textwrap.wrap(short(state.label, 48).replace("_", " ").replace(".", " "), 16)
        panels.append(Panel("\n".join([*lines, f"[{state.unit}]"]), tuple(parts), lines_at=(0.0,)))
    return Stack(tuple(panels), 1.2)


def drive_residuals(track: Track) -> dict[str, list[tuple[str, Array, Array, str]]]:
    """Residuals of what drives, by its parts as `shown_states` calls them: axis, step and its sd, unit; nothing of a
    track that is not smoothed.
    """
    if track.drive_steps is None:
        return {}
    parts = (("accel", "m/s", 1.0), ("gyro", "deg", 180.0 / np.pi))
    found: dict[str, list[tuple[str, Array, Array, str]]] = {}
    for column in range(track.drive_steps.shape[2]):
        owner, unit, factor = parts[column // 3] if track.vehicle.drive.inertial else ("drive", "m", 1.0)
        step, sd = factor * track.drive_steps[:, :, column].T
        found.setdefault(owner, []).append(("xyz"[column % 3], step, sd, unit))
    return {owner: axes for owner, axes in found.items() if any(np.isfinite(step).any() for _, step, _, _ in axes)}


def steps_figure(track: Track, owner: str) -> tuple[Stack, str]:
    """Residuals of a part of what drives, in standard deviations, and their caption."""
    panels, largest = [], []
    for axis, step, sd, unit in drive_residuals(track)[owner]:
        value, (hue, dash) = step / sd, colour(0)
        level = Level(-2.0, 2.0, "95 %")
        line = Line(track.time_s, value, "residual", hue, dash)
        panels.append(Panel(f"{owner} {axis}\n[sd]", (line,), None, "symmetric", level=level))
        if np.isfinite(value).any():
            at = int(np.nanargmax(np.abs(value)))
            largest.append(
                (abs(value[at]), f"{axis} {value[at]:.1f} at {track.time_s[at]:.0f} s, {step[at]:.2g} {unit}")
            )
    return Stack(tuple(panels), 1.2), STEPS.format(name=owner, largest=max(largest)[1])


#: Frequencies of a spectrum that nobody has learnt, from one period in so many samples up.
FREQUENCIES, LONGEST = 400, 20000


class SpectrumBand(NamedTuple):
    """What is known of a spectrum: frequencies [Hz], and its density, low, median and high, in the unit that is shown,
    shape (n,) each.
    """

    freq_hz: Array
    low: Array
    median: Array
    high: Array


def learnt_figures(found: tuple[LearnedText, ...], end_s: float) -> Iterator[tuple[str, Stack]]:
    """Caption and figure, spectrum and history of every axis, one after the other.

    Parameters
    ----------
    found : tuple of LearnedText
    end_s : float
        Until when the last models are in force [s].
    """
    for history in found:
        caption = (
            "Spectrum at the end, with the range from 5 to 95 % that its posterior leaves, and that of vehicle.toml."
        )
        yield f"{history}. {caption}", spectrum_figure(history)
        last = history.models[-1]
        text = f"{history.title}: {len(history.models)} models, the last one of order ({last.p}, {last.q})."
        yield f"{text} A pole radius of 1 would be a random walk.", adopted_figure(history, end_s)


def learnt_band(history: LearnedText) -> SpectrumBand:
    """The learnt spectrum with the range from 5 to 95 % that its posterior leaves; empty for a model from a file."""
    freq_hz, low, median, high = history.spectrum
    if not freq_hz.size:
        freq_hz = np.geomspace(history.scale.rate_hz / LONGEST, 0.5 * history.scale.rate_hz, FREQUENCIES)
        low = median = high = np.full(freq_hz.size, np.nan)
    return SpectrumBand(freq_hz, low, median, high)


def spectrum_figure(history: LearnedText, band: SpectrumBand | None = None) -> Stack:
    """Density of the learnt error with its range, and of what was believed, over frequency.

    Parameters
    ----------
    history : LearnedText
    band : SpectrumBand, optional
        Default `learnt_band`.
    """
    band = learnt_band(history) if band is None else band
    believed = history.believed_spectrum(band.freq_hz)
    (prior, _), (learnt, dash) = colour(0), colour(1)
    parts: tuple[Part, ...] = (Line(band.freq_hz, believed, "believed", prior),)
    if np.isfinite(band.median).any():
        parts = (
            Band(band.freq_hz, band.low, band.high, "5 to 95 %", learnt),
            *parts,
            Line(band.freq_hz, band.median, "learnt", learnt, dash),
        )
    curves = np.concatenate([believed[believed > 0.0], band.median[band.median > 0.0]])
    limits = (0.3 * float(curves.min()), 3.0 * float(curves.max())) if curves.size else (0.1, 10.0)
    label = f"{short(history.title)}\n[({history.scale.unit})²/Hz]"
    return Stack((Panel(label, parts, limits, log=True),), 2.2, x_label="frequency [Hz]", log_x=True)


def adopted_figure(history: LearnedText, end_s: float) -> Stack:
    """Coefficients, radii of the poles and innovation sd of the adopted models over time.

    Parameters
    ----------
    history : LearnedText
    end_s : float
        Until when the last model is in force.
    """
    t = np.array([*history.time_s, max(end_s, history.time_s[-1])])
    models = history.models
    panels = []
    for kind, name in (("ar", "autoregressive"), ("ma", "moving average")):
        count = max(len(getattr(m, kind)) for m in models)
        series = [_steps(t, [_at(getattr(m, kind), k) for m in models], k, f"{kind}[{k}]") for k in range(count)]
        if count:
            panels.append(Panel(f"{name}\ncoefficients", tuple(part for pair in series for part in pair)))
    order = max(m.p for m in models)
    radii = [[_nines(_at(np.abs(m.poles), k)) for m in models] for k in range(order)]
    if order:
        names = ["largest", *(f"{k + 1}." for k in range(1, order))]
        steps = [_steps(t, values, k, names[k]) for k, values in enumerate(radii)]
        top = max(2.0, float(np.ceil(np.nanmax(radii))))
        ticks = tuple((tick, f"{1.0 - 10.0**-tick:.{int(tick)}f}") for tick in np.arange(top + 1.0))
        parts = tuple(part for pair in steps for part in pair)
        panels.append(Panel("pole radius", parts, (0.0, top), ticks=ticks))
    sds = _steps(t, [history.scale.factor * m.sd for m in models], 0, "innovation sd")
    panels.append(Panel(f"sd [{history.scale.unit}]", sds, shape="from zero"))
    return Stack(tuple(panels), 1.25)


def _nines(radius: float) -> float:
    """Radius of a pole on a scale that counts its nines: what happens near 1 is what matters."""
    return -float(np.log10(max(1.0 - radius, 1e-6)))


def _at(values: Array, k: int) -> float:
    return float(values[k]) if k < len(values) else np.nan


def _steps(t: Array, values: list[float], number: int, label: str) -> tuple[Part, ...]:
    hue, dash = colour(number)
    held = np.array([*values, values[-1]])
    return Line(t, held, label, hue, dash, steps=True), Points(t[:-1], held[:-1], label, hue, "o")

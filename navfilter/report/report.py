"""The report of a run: one HTML page that needs nothing but itself."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from typing import Any

import numpy as np

from navfilter.calibration.lights import Light
from navfilter.evaluation.assessment import Assessment, Control, Verdict, assess
from navfilter.evaluation.comparison import number_text
from navfilter.evaluation.diagnostics import OUTAGE_S, OUTAGE_STEPS, Evidence, Surfacing
from navfilter.evaluation.over_dives_text import LearnedText, Scale, error_words, in_force
from navfilter.filter.records import OUTCOMES
from navfilter.io.write import summarise
from navfilter.models.during import same_sensor
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors.traits import shown_unit
from navfilter.rendering.clock import clock_of
from navfilter.rendering.page import Section, escape, list_html, page, table_html
from navfilter.rendering.panels import Mark, Stack, short
from navfilter.report import figures
from navfilter.report.constant_table import ABOUT, lights_html
from navfilter.report.figures import LANES, lane_figure, lane_marks, lane_rows, spell_rows, trust_figure
from navfilter.report.instrument import Instrument, plan_view
from navfilter.report.run_tables import Rows, headline_rows, sensor_rows
from navfilter.track.track import Track, Tracks

_SURFACING = (
    "A surfacing is the first fix after a time without any: its horizontal distance from what was predicted for it, in "
    "metres and in per cent of the distance travelled since the fix before, beside the rms that the filter predicted "
    "(error of the fix included). Of honest ones 95 % lie inside."
)
#: A figure with more panels than this does not fit on a printed page.
_PANELS = 6
SURFACING, ADOPTION = "#006d2c", "#d94801"
#: Of the outages of one sensor after the other.
OUTAGES = ("#8c6bb1", "#7fa8c9", "#c9a227", "#b0647a")
#: Of more adoptions than this the figures over all sensors show every n-th.
MOST = 60


def render_report(
    tracks: Tracks,
    mission: Mission,
    progress: Callable[[], Any] | None = None,
    assessment: Assessment | None = None,
    beside: Tracks | None = None,
    tiles: str | os.PathLike[str] | None = None,
) -> str:
    """One HTML page with tables and figures. It loads nothing: what makes the figures live is inside, and without
    scripts they are there all the same.

    Parameters
    ----------
    tracks : dict of str to Track
        Runs by label, see `navfilter.io.write.labelled`.
    mission : Mission
    progress : callable, optional
        Called after each figure.
    assessment : Assessment, optional
        Default: as `navfilter.evaluation.assessment.assess` makes it.
    beside : dict of str to Track, optional
        Other runs by label, shown with these over time and from above.
    tiles : path-like, optional
        For a chart under the track, see `navfilter.report.instrument.chart_of`.
    """
    result, first = list(tracks.values())[-1], next(iter(tracks.values()))
    summary = summarise(tracks, mission)
    assessment = assessment or assess(tracks, mission)
    instrument = Instrument(clock_of(tracks, mission), result, first, progress)
    *others, last = tracks
    shown = {**{label: tracks[label] for label in others}, **(beside or {}), last: tracks[last]}
    if not others:  # what is first says where metres count from
        shown = {last: tracks[last], **(beside or {})}
    reading = [list_html(line for line in assessment.lines() if line not in map(str, assessment.control))]
    if assessment.evidence.surfacings:
        reading += [table_html(*_surfacings(assessment.evidence)), f"<p>{_SURFACING}</p>"]
    if assessment.control:
        reading.append(table_html(*_control(assessment.control)))
    body = [
        _verdict(assessment.verdict),
        Section("Result", (table_html(*headline_rows(tracks, mission)), f"<p>{_reading(mission)}</p>")),
        Section("What the readings say of the track", tuple(reading)),
        *_constants(assessment.lights),
        *_over_time(tracks, shown, mission, instrument, assessment, tiles),
        instrument.any_section(),
        *_learnt(assessment.learnt),
        *sensor_sections(tracks, assessment.learnt, instrument),
        Section("Readings", (table_html(*sensor_rows(result)), _notes(result, mission))),
        Section("Error models", (table_html(*_models(result), text_columns=(1, 2)),)),
    ]
    subtitle = _subtitle(result, mission, summary)
    return page(mission.name, mission.name, subtitle, body, instrument.scripts())


# --- figures with their captions ------------------------------------------------------------------------------------


def _over_time(
    tracks: Tracks,
    shown: Tracks,
    mission: Mission,
    instrument: Instrument,
    assessment: Assessment,
    tiles: str | os.PathLike[str] | None,
) -> Iterator[Section]:
    """The sections with the figures of the whole run; some show other runs beside it."""
    truth = mission.truth
    noted = marks(list(tracks.values())[-1], assessment.evidence.surfacings, assessment.learnt)

    def drawn(stack: Stack, caption: str) -> str:
        return instrument.figure(replace(stack, marks=noted), caption)

    plan = plan_view(shown, mission, tiles=tiles)
    kind = "Circles" if plan.shape.endswith("circle") else "Ellipses"
    caption = f"{kind} hold the vehicle with 95 % probability, if the filter is honest. Crosses: fixes that were used."
    caption += " A zoom in a figure over time shows its part here."
    if tiles is not None:
        caption += f" Chart: {'from' if plan.chart else 'nothing of this place is in'} the tiles given."
    yield Section("Track", (instrument.figure(plan, caption),))
    caption = "Height over time, under water minus the depth, with its 1-sigma band; horizontal speed."
    turned = drawn(figures.attitude_figure(shown, mission), "Attitude of the vehicle.")
    yield Section("Depth, speed, attitude", (drawn(figures.depth_figure(shown, mission), caption), turned))
    errors = figures.position_figure(shown, truth)
    divided = " The lowest panel divides by the distance travelled so far." if len(errors.panels) > 3 else ""
    caption = f"{_band_caption(truth, slice(0, 2))}{divided}"
    yield Section("Position error", (drawn(errors, caption),))
    caption = _band_caption(truth, slice(8, 9))
    yield Section("Heading error", (drawn(figures.heading_figure(shown, truth), caption),))
    result = list(tracks.values())[-1]
    if result.forward is not None:
        yield Section("Separation", (drawn(figures.separation_figure(result.forward, result), figures.SEPARATION),))
    if assessment.apart is not None:
        both = drawn(figures.backward_figure(assessment.apart), figures.BACKWARD)
        yield Section("Forward and backward", (f"<p>{escape(str(assessment.apart))}.</p>", both))
    yield from _trusted(tracks, truth, instrument)
    yield from _lanes(list(tracks.values())[-1], instrument)
    nees = None if truth is None else figures.consistency_figure(tracks, truth)
    if nees is not None:
        yield Section("Honesty of the covariance", (drawn(nees, figures.NEES),))
    nis = figures.nis_figure(figures.filters(tracks))
    if nis is not None:
        yield Section("NIS per sensor", (drawn(nis, figures.NIS),))


def _trusted(tracks: Tracks, truth: Stream | None, instrument: Instrument) -> Iterator[Section]:
    """Bounds along the run, and what spoke against it when."""
    shown = trust_figure(tracks, truth)
    if shown is None:
        return
    header, rows = spell_rows(next(track for track in tracks.values() if track.bounds is not None))
    parts = [instrument.figure(*shown)]
    parts.append(table_html(header, rows, text_columns=(2, 3)) if rows else "<p>Nothing spoke against the state.</p>")
    yield Section("Trust and bounds", tuple(parts))


def _lanes(track: Track, instrument: Instrument) -> Iterator[Section]:
    """Which lane was in force, and why others were left."""
    shown = lane_figure(track)
    if shown is None:
        return
    header, rows = lane_rows(track)
    table = table_html(header, rows, text_columns=(1, 2, 3)) if rows else "<p>No lane was left.</p>"
    yield Section("Lanes", (instrument.figure(shown, LANES), table))


def _band_caption(truth: Stream | None, columns: slice) -> str:
    if truth is None or not np.isfinite(truth.value[:, columns]).any():
        return "This mission has no truth of it: the bands show what the filter believes of itself."
    return "Estimated minus true. Two thirds of the errors should lie inside the 1-sigma band."


def _constants(lights: tuple[Light, ...]) -> list[Section]:
    """How far each constant is told."""
    return [Section("Calibration", (lights_html(lights), f"<p>{ABOUT}</p>"))] if lights else []


def _learnt(found: tuple[LearnedText, ...]) -> list[Section]:
    """What every axis has learnt, in words; the spectra stand with the sensors."""
    return [Section("What was learnt", (list_html(map(str, found)),))] if found else []


# --- tables ---------------------------------------------------------------------------------------------------------


def _verdict(verdict: Verdict) -> Section:
    """What was found, then how to look further."""
    text = [f"<p><strong>{escape(verdict.headline)}</strong></p>", list_html(verdict.lines())]
    text += ["<p>How to look further:</p>", list_html(verdict.cures())] if verdict.cures() else []
    doubted = any(finding.severity == "warning" for finding in verdict.findings)
    mood = "bad" if not verdict.trusted else "care" if doubted else "good"
    return Section("Verdict", tuple(text), mood=mood)


def _surfacings(evidence: Evidence) -> tuple[list[str], Rows]:
    header = ["surfacing", "at [s]", "without [s]", "travelled [m]"]
    header += ["error [m]", "[% of it]", "predicted sd [m]", "95 %"]
    rows = [
        [
            s.sensor,
            *(f"{value:.0f}" for value in (s.time_s, s.without_s, s.distance_m)),
            f"{s.error_m:.2f}",
            number_text(s.percent if math.isfinite(s.percent) else None, "{:.2f}"),
            f"{s.sd_m:.2f}",
            ("inside" if s.inside else "outside") + ("" if s.used else ", rejected"),
        ]
        for s in evidence.surfacings
    ]
    return header, rows


def _control(points: Sequence[Control]) -> tuple[list[str], Rows]:
    header = ["control point", "at [s]", "north [m]", "east [m]", "up [m]", "off [m]", "predicted sd [m]", "95 %"]
    rows = []
    for one in points:
        lengths = (one.north_m, one.east_m, one.up_m, one.distance_m, one.sd_m)
        where = "no track" if one.inside is None else "inside" if one.inside else "outside"
        at = f"{one.time_s:.1f}{', nearest' * one.nearest}"
        rows.append([one.name, at, *("" if math.isnan(v) else f"{v:.2f}" for v in lengths), where])
    return header, rows


def _models(track: Track) -> tuple[list[str], Rows]:
    """Error models of every channel; of a long history the first and the last ones."""
    drive = track.vehicle.drive
    rows = []
    for axis, model, unit in zip(drive.axis_names, drive.models, drive.units, strict=True):
        rows.append([axis, "", error_words(model, Scale(*shown_unit(unit), 1.0 / drive.period_s))])
    for name, history in track.error_models.items():
        whole = len(history) <= 6
        shown = [
            [name, f"{t:.1f}", in_force(track, name, history[k][1])]
            for k, (t, _) in enumerate(history)
            if whole or k < 2 or k >= len(history) - 3
        ]
        rows += shown if whole else [*shown[:2], [name, "", f"... {len(history) - 5} more"], *shown[2:]]
    return ["channel", "from [s]", "model"], rows


def _subtitle(track: Track, mission: Mission, summary: Mapping[str, Any]) -> str:
    when = f", {mission.date.isoformat()}" if mission.date is not None else ""
    return (
        f"Vehicle {track.vehicle.name}{when}. {summary['duration_s'] / 60:.1f} min, {summary['distance_m']:.0f} m "
        f"travelled, {len(track.state_names) + 9} error states, {track.cpu_s:.1f} s of processor time. navfilter "
        f"{metadata.version('navfilter')}."
    )


def _reading(mission: Mission) -> str:
    if mission.truth is None:
        return (
            "There is no truth in this mission, so only NIS can be judged: the mean over all sensors should be near 1."
        )
    return (
        "Position errors are horizontal. NEES and NIS are means per degree of freedom: 1 is honest, well above 1 means "
        "that the filter believes itself too much, well below 1 too little. One run is one draw: NEES of a single "
        "mission scatters widely."
    )


def _notes(track: Track, mission: Mission) -> str:
    lines = [f"drive: {count} {what}" for what, count in track.counts.items() if count] + list(mission.notes)
    return list_html(lines)


# --- a section for each sensor ---------------------------------------------------------------------------------------


def sensor_sections(tracks: Tracks, learnt: tuple[LearnedText, ...], instrument: Instrument) -> Iterator[str | Section]:
    """A menu, and one section for each sensor and each part of the drive that has something to show.

    Parameters
    ----------
    tracks : dict of str to Track
    learnt : tuple of LearnedText
        Of the result.
    instrument : Instrument
    """
    states = _states(tracks)
    runs = figures.filters(tracks)
    judged = {n: None for t in runs.values() for n, r in t.residuals.items() if r.used.any() and n in t.vehicle.sensors}
    driven = next((track for track in reversed(list(tracks.values())) if figures.drive_residuals(track)), None)
    steps = {} if driven is None else figures.drive_residuals(driven)
    owners = list(judged | dict.fromkeys(states) | dict.fromkeys(steps))
    by_owner = {name: tuple(found for found in learnt if _owner(found.title, owners) == name) for name in owners}
    if owners:
        options = "".join(f'<option value="{escape(name)}">{escape(name)}</option>' for name in owners)
        yield f'<p class="choice"><label>Sensor <select class="sensors">{options}</select></label></p>'
    for name in owners:
        parts = [*_innovations(runs, name, by_owner[name], instrument)]
        if driven is not None and name in steps:
            parts.append(instrument.figure(*figures.steps_figure(driven, name)))
        end_s = max(float(track.time_s[-1]) for track in tracks.values())
        for caption, stack in figures.learnt_figures(by_owner[name], end_s):
            parts.append(instrument.figure(stack, caption))
        shown = states.get(name, ())
        for first in range(0, len(shown), _PANELS):
            stack = figures.states_figure(tracks, shown[first : first + _PANELS])
            marked = _marked(stack, next(iter(runs.values())), name, by_owner[name])
            parts.append(instrument.figure(marked, f"{name}: estimated error, with its 1-sigma band."))
        yield Section(name, tuple(parts), sensor=name)


def _owner(title: str, owners: list[str]) -> str | None:
    """Whose axis this is: "dvl x" is of "dvl"."""
    return max((name for name in owners if title == name or title.startswith(f"{name} ")), key=len, default=None)


def _innovations(runs: Tracks, name: str, learnt: tuple[LearnedText, ...], instrument: Instrument) -> Iterator[str]:
    for label, track in runs.items():
        if name not in track.residuals or name not in track.vehicle.sensors or not track.residuals[name].used.any():
            continue
        many = f" ({label})" if len(runs) > 1 else ""
        stack = _marked(figures.innovation_figure(track, name), track, name, learnt)
        yield instrument.figure(stack, f"{name}{many}: innovations, measured minus predicted, {_count(track, name)}.")


def _marked(stack: Stack, track: Track, name: str, learnt: tuple[LearnedText, ...]) -> Stack:
    """With the outages of the sensor, and the adoptions of its models."""
    found: list[Mark] = outages(track, name) + adoptions(learnt, float(track.time_s[0]))
    return replace(stack, marks=tuple(found))


def _states(tracks: Tracks) -> dict[str, tuple[figures.ShownState, ...]]:
    """The states worth showing, by owner."""
    by_owner: dict[str, dict[str, figures.ShownState]] = {}
    for track in tracks.values():
        for state in figures.shown_states(track.vehicle):
            # A state that nothing excites, such as a temperature term without temperatures, has nothing to show.
            if state.name in track.state_names and track.state(state.name)[1].any():
                by_owner.setdefault(state.owner, {})[state.name] = state
    return {owner: tuple(found.values()) for owner, found in by_owner.items()}


def _count(track: Track, name: str) -> str:
    r = track.residuals[name]
    return ", ".join(f"{r.count(outcome)} {outcome}" for outcome in OUTCOMES if r.count(outcome))


# --- what is marked in all figures over time -------------------------------------------------------------------------


def marks(track: Track, surfacings: tuple[Surfacing, ...], learnt: tuple[LearnedText, ...]) -> tuple[Mark, ...]:
    """Everything worth a mark in the figures over time.

    Parameters
    ----------
    track : Track
        For its outages.
    surfacings : tuple of Surfacing
    learnt : tuple of LearnedText
    """
    found = [mark for name in track.residuals for mark in outages(track, name)]
    found += [Mark(s.time_s, s.time_s, "surfacing", str(s), SURFACING) for s in surfacings]
    adopted = adoptions(learnt, float(track.time_s[0]))
    return (*found, *lane_marks(track), *adopted[:: -(-len(adopted) // MOST) or 1])


def outages(track: Track, name: str) -> list[Mark]:
    """Times in which no reading of a sensor was used: longer than 30 s and than five of its usual steps.

    Parameters
    ----------
    track : Track
    name : str
        The sensor.
    """
    run = track.forward or track
    names = same_sensor(name, run.vehicle.sensors)
    if name not in run.residuals or not names:
        return []
    hue = OUTAGES[list(run.vehicle.sensors).index(name) % len(OUTAGES)]
    used = np.sort(np.concatenate([r.time_s[r.used] for r in map(run.residuals.get, names) if r is not None]))
    ends = np.concatenate([[run.time_s[0]], used, [run.time_s[-1]]])
    steps = np.diff(ends)
    least_s = max(OUTAGE_S, OUTAGE_STEPS * float(np.median(np.diff(used))) if len(used) > 1 else 0.0)
    return [
        Mark(float(ends[k]), float(ends[k + 1]), f"no {short(name)}", f"no {name} used for {steps[k]:.0f} s", hue)
        for k in np.flatnonzero(steps > least_s)
    ]


def adoptions(learnt: tuple[LearnedText, ...], begin_s: float) -> list[Mark]:
    """The moments after `begin_s` at which a learnt model came into force; a run may begin with one."""
    return [
        Mark(t, t, "model adopted", f"{history.title}: model of order ({model.p}, {model.q}) adopted", ADOPTION)
        for history in learnt
        for t, model in zip(history.time_s, history.models, strict=True)
        if t > begin_s
    ]

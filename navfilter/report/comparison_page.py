"""The report of a comparison: one HTML page with the runs side by side."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import metadata
from typing import Any

import numpy as np

from navfilter.evaluation.comparison import LAGS, Comparison, innovation_series
from navfilter.evaluation.over_dives_text import in_force, learnt
from navfilter.foundation.arrays import Array
from navfilter.models.mission import Mission, Stream
from navfilter.rendering.clock import clock_of
from navfilter.rendering.drawing import colour
from navfilter.rendering.page import Section, escape, page, table_html
from navfilter.rendering.panels import Band, Level, Line, Mark, Panel, Stack
from navfilter.report import figures
from navfilter.report.instrument import Instrument, Plan, plan_view
from navfilter.timeseries.diagnostics import acf
from navfilter.track.track import Tracks

#: A figure with more panels than this does not fit on a printed page.
_PANELS = 8


def render_comparison(
    comparison: Comparison, tracks: Tracks, mission: Mission, progress: Callable[[], Any] | None = None
) -> str:
    """One HTML page with table and figures of all runs. It loads nothing, see `navfilter.report.report`.

    Parameters
    ----------
    comparison : Comparison
    tracks : dict of str to Track
        What was compared.
    mission : Mission
    progress : callable, optional
        Called after each figure.
    """
    first = next(iter(tracks.values()))
    instrument = Instrument(clock_of(tracks, mission), first, first, progress)
    notes = f"<p>{escape(' '.join(comparison.notes()))}</p>"
    body = [Section("Result", (table_html(["", *comparison.runs], comparison.rows()), notes))]
    for title, caption, what in drawn(comparison, tracks, mission):
        figure = instrument.figure(what, caption)
        if title:
            body.append(Section(title, (figure,)))
        else:
            body[-1] = replace(body[-1], parts=(*body[-1].parts, figure))
    body.append(Section("Innovations, axis by axis", (table_html(*_axes_table(comparison), text_columns=(1,)),)))
    body.append(Section("Error models at the end", (table_html(*_models_table(tracks), text_columns=(1, 2)),)))
    return page(
        mission.name,
        f"{mission.name}: {', '.join(tracks)}",
        f"Vehicle {first.vehicle.name}. {mission.duration_s / 60:.1f} min, {first.distance_m:.0f} m travelled. "
        f"navfilter {metadata.version('navfilter')}.",
        body,
        instrument.scripts(),
    )


def drawn(comparison: Comparison, tracks: Tracks, mission: Mission) -> Iterator[tuple[str, str, Stack | Plan]]:
    """Heading of a new section (or nothing), caption and what is to be drawn, one after the other."""
    truth = mission.truth
    begin_s, first_s = comparison.windows[0][0], min(float(track.time_s[0]) for track in tracks.values())
    unscored = (Mark(first_s, begin_s, "not scored", f"not scored before {begin_s:.0f} s", "#555555"),)

    def shaded(stack: Stack) -> Stack:
        return replace(stack, marks=unscored if begin_s > first_s + 1e-9 else ())

    caption = "Ellipses hold the vehicle with 95 % probability, if the run is honest."
    yield "Track", caption, plan_view(tracks, mission, ellipses=8)
    if truth is not None and any("heading" in run["nees"] for run in comparison.runs.values()):
        caption = "Two thirds of the errors should lie inside the band; what is shaded is not scored."
        yield "Error against 1 sigma", caption, shaded(against_sigma(tracks, truth, "heading"))
    if truth is not None and any("position" in run["nees"] for run in comparison.runs.values()):
        caption = "Where the error keeps above the coloured area, the run believes itself too much."
        yield "", caption, shaded(against_sigma(tracks, truth, "horizontal"))
    nees = None if truth is None else figures.consistency_figure(tracks, truth)
    if nees is not None:
        yield "Honesty of the covariance", figures.NEES, shaded(nees)
    runs = {label: track.forward or track for label, track in tracks.items()}
    nis = figures.nis_figure(runs)
    if nis is not None:
        yield "NIS per sensor", figures.NIS, shaded(nis)
    axes = _tested_axes(comparison, runs)
    for first in range(0, len(axes), _PANELS):
        caption = "Autocorrelation of the innovations over the whole run: a filter that knows its sensors leaves none."
        title = "" if first else "What is left in the innovations"
        yield title, caption, correlation_figure(runs, axes[first : first + _PANELS])
    yield from _learnt(runs)


def _tested_axes(comparison: Comparison, tracks: Tracks) -> list[tuple[str, int, str]]:
    """Sensor, number of the axis and title of all axes whose innovations were tested in some run."""
    found: dict[tuple[str, int], str] = {}
    for label, run in comparison.runs.items():
        for name, about in run["sensors"].items():
            names = tracks[label].vehicle.sensors[name].axis_names
            for i, axis in enumerate(names):
                if about["axes"].get(axis or name, {}).get("largest_acf") is not None:
                    found[name, i] = f"{name} {axis}".strip()
    return [(name, i, title) for (name, i), title in found.items()]


def _learnt(tracks: Tracks) -> Iterator[tuple[str, str, Stack]]:
    title = "Models learnt under way"
    for label, track in tracks.items():
        for history in learnt(track):
            last = history.models[-1]
            radius = f", largest pole {abs(last.poles[0]):.4f}" if last.p else ""
            caption = (
                f"{label}, {history.title}: {len(history.models)} models adopted, the last one of order ({last.p}, "
                f"{last.q}){radius}. A pole radius of 1 would be a random walk."
            )
            yield title, caption, figures.adopted_figure(history, float(track.time_s[-1]))
            title = ""


def adopted_models(tracks: Tracks) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Every model that was learnt, by run and sensor axis, see `navfilter.track.track.Track.adopted`."""
    return {label: found for label, track in tracks.items() if (found := track.adopted())}


def _axes_table(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    rows = []
    for label, run in comparison.runs.items():
        for name, about in run["sensors"].items():
            for axis, value in about["axes"].items():
                where = name if axis == name else f"{name} {axis}"
                p, r = value["ljung_box_p"], value["largest_acf"]
                verdict = ["–"] * 3 if p is None else ["yes" if value["is_white"] else "no", f"{p:.2g}", f"{r:+.3f}"]
                rows.append(
                    [label, where, f"{value['prediction_rms']:.4g} {about['unit']}", str(about["compared"]), *verdict]
                )
    return ["run", "axis", "prediction error rms", "readings", "white", "Ljung-Box p", "largest autocorrelation"], rows


def _models_table(tracks: Tracks) -> tuple[list[str], list[list[str]]]:
    rows = []
    for label, track in tracks.items():
        for name, history in track.error_models.items():
            rows.append([label, name, in_force(track, name, history[-1][1])])
    return ["run", "sensor", "model"], rows


# --- figures that only a comparison has ------------------------------------------------------------------------------


def against_sigma(tracks: Tracks, truth: Stream, name: str) -> Stack:
    """Error of the heading, or of the horizontal position, and how large it is predicted to be (1 sigma, rms): one
    panel per run, all on the same scale.
    """
    limit, panels = 0.0, []
    for number, (label, track) in enumerate(tracks.items()):
        hue, errors = colour(number)[0], track.errors(truth)
        if name == "heading":
            sd, error = np.degrees(np.sqrt(track.covariance[:, 8, 8])), np.degrees(errors.heading)
            low, words, most, unit = -sd, "±1σ", 1.1 * _scale(sd, 0.9), "deg"
        else:
            sd, error = track.horizontal_sd(), errors.horizontal
            low, words, most, unit = np.zeros(len(track)), "up to the predicted rms", _scale(sd), "m"
        band = Band(track.time_s, low, sd, f"{label}: {words}", hue, 0.3)
        line = Line(track.time_s, error, f"{label}: error", hue, width=0.9)
        limit = max(limit, _scale(error), most)
        panels.append((f"{label}\n{name} [{unit}]", (band, line)))
    limits = (-limit if name == "heading" else 0.0, limit)
    return Stack(tuple(Panel(label, parts, limits, lines_at=(0.0,)) for label, parts in panels), 1.2)


def _scale(values: Array, p: float = 0.998) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return 1.1 * float(np.quantile(finite, p)) if finite.size else 0.0


def correlation_figure(tracks: Tracks, axes: list[tuple[str, int, str]]) -> Stack:
    """Autocorrelation of the innovations, one panel per sensor axis, with the 95 % limits of white noise.

    Parameters
    ----------
    tracks : dict of str to Track
        Filtered runs.
    axes : list of (str, int, str)
        Sensor, number of its axis, and what the panel is called.
    """
    panels = []
    for name, i, title in axes:
        lines, count = [], 1
        for number, (label, track) in enumerate(tracks.items()):
            series = innovation_series(track.residuals[name], i) if name in track.residuals else np.empty(0)
            known = series[np.isfinite(series)]
            if known.size > LAGS and np.ptp(known) > 0.0:
                lines.append(Line(np.arange(1.0, LAGS + 1.0), acf(series, LAGS)[1:], label, *colour(number)))
                count = max(count, known.size)
        limit = 1.96 / math.sqrt(count)
        white = Level(-limit, limit, "95 % of white noise")
        panels.append(Panel(title, tuple(lines), lines_at=(0.0,), level=white))
    return Stack(tuple(panels), 1.1, x_label="lag [readings]")

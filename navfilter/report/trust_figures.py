"""Bounds, trust and lanes along a run: how far the truth may be, when and why the state is not to be trusted, and which
lane was in force.
"""

from __future__ import annotations

import numpy as np

from navfilter.models.mission import Stream
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Line, Mark, Panel, Part, Stack, short
from navfilter.track.track import Track, Tracks
from navfilter.track.trust import DegradedInterval, spells

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

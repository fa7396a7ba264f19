"""Lanes along a run: which was in force, why it was left, and how well each of them foretold the readings."""

from __future__ import annotations

import numpy as np

from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Line, Mark, Panel, Stack, short
from navfilter.track.track import Track

CAPTION = (
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
LEAST, MOST = 1e-3, 1e4


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
        squares.append(Line(history.time_s, np.clip(history.nis[:, i], LEAST, MOST), title, hue, dash))
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

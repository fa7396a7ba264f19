"""Bounds and trust along a run: how far the truth may be, and when and why the state is not to be trusted."""

from __future__ import annotations

import numpy as np

from navfilter.models.mission import Stream
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Line, Mark, Panel, Part, Stack, short
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

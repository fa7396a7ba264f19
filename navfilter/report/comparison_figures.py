"""Figures of a comparison: errors against what each run believes of itself, what is left in the innovations, the models
learnt.
"""

from __future__ import annotations

import math

import numpy as np

from navfilter.evaluation.consistency import LAGS, innovation_series
from navfilter.foundation.arrays import Array
from navfilter.models.mission import Stream
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Level, Line, Panel, Part, Stack
from navfilter.timeseries.diagnostics import acf
from navfilter.track.track import Tracks


def heading_against_sigma(tracks: Tracks, truth: Stream) -> Stack:
    """Heading error and its 1-sigma band, one panel per run, all on the same scale."""
    limit = 0.0
    found: list[tuple[str, tuple[Part, ...]]] = []
    for number, (label, track) in enumerate(tracks.items()):
        hue, _ = colour(number)
        sd = np.degrees(np.sqrt(track.covariance[:, 8, 8]))
        error = np.degrees(track.errors(truth).heading)
        parts = (
            Band(track.time_s, -sd, sd, f"{label}: ±1σ", hue, 0.3),
            Line(track.time_s, error, f"{label}: error", hue, width=0.9),
        )
        limit = max(limit, _scale(error), 1.1 * _scale(sd, 0.9))
        found.append((f"{label}\nheading [deg]", parts))
    return _on_one_scale(found, (-limit, limit))


def position_against_sigma(tracks: Tracks, truth: Stream) -> Stack:
    """Horizontal position error and its predicted rms, one panel per run, all on the same scale."""
    limit = 0.0
    found: list[tuple[str, tuple[Part, ...]]] = []
    for number, (label, track) in enumerate(tracks.items()):
        hue, _ = colour(number)
        predicted = track.horizontal_sd()
        error = track.errors(truth).horizontal
        parts = (
            Band(track.time_s, np.zeros(len(track)), predicted, f"{label}: up to the predicted rms", hue, 0.3),
            Line(track.time_s, error, f"{label}: error", hue, width=0.9),
        )
        limit = max(limit, _scale(error), _scale(predicted))
        found.append((f"{label}\nhorizontal [m]", parts))
    return _on_one_scale(found, (0.0, limit))


def _on_one_scale(found: list[tuple[str, tuple[Part, ...]]], limits: tuple[float, float]) -> Stack:
    return Stack(tuple(Panel(label, parts, limits, lines_at=(0.0,)) for label, parts in found), 1.2)


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

"""Figures of a comparison: errors against what each run believes of itself, what is left in the innovations, the models
learnt.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter.evaluation.consistency import LAGS, innovation_series
from navfilter.models.mission import Stream
from navfilter.rendering.drawing import WIDTH_IN, colour, no_formula
from navfilter.rendering.panels import Band, Line, Panel, Part, Stack
from navfilter.timeseries.diagnostics import acf
from navfilter.track.track import Track

Array = NDArray[np.float64]
Tracks = Mapping[str, Track]


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


def correlation_figure(tracks: Tracks, axes: list[tuple[str, int, str]]) -> Figure:
    """Autocorrelation of the innovations, one panel per sensor axis, with the 95 % limits of white noise.

    Parameters
    ----------
    tracks : dict of str to Track
        Filtered runs.
    axes : list of (str, int, str)
        Sensor, number of its axis, and what the panel is called.
    """
    rows = -(-len(axes) // 2) if len(axes) > 1 else 1
    columns = 2 if len(axes) > 1 else 1
    figure = Figure(figsize=(WIDTH_IN, 1.7 * rows + 0.6), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    shown = grid.ravel().tolist()
    for ax in shown[len(axes) :]:
        ax.set_axis_off()
    for ax, (name, i, title) in zip(shown, axes, strict=False):
        count = 0
        for number, (label, track) in enumerate(tracks.items()):
            if name not in track.residuals:
                continue
            series = innovation_series(track.residuals[name], i)
            known = series[np.isfinite(series)]
            if known.size <= LAGS or np.ptp(known) == 0.0:
                continue
            hue, dash = colour(number)
            how: dict[str, Any] = {"color": hue, "linestyle": dash, "marker": "o", "markersize": 2.2}
            ax.plot(range(1, LAGS + 1), acf(series, LAGS)[1:], label=no_formula(label), **how)
            count = max(count, known.size)
        limit = 1.96 / np.sqrt(max(count, 1))
        ax.axhspan(-limit, limit, color="#bbbbbb", alpha=0.5, linewidth=0, label="95 % of white noise", zorder=0)
        ax.axhline(0.0, color="black", linewidth=0.6)
        low, high = ax.get_ylim()
        ax.set_ylim(min(low, -0.1), max(high, 0.1))
        ax.set_title(no_formula(title))
    for ax in grid[:, 0]:
        ax.set_ylabel("autocorrelation")
    for ax in [grid[-1, 0], *([grid[-1 - len(axes) % 2, 1]] if columns == 2 else [])]:
        ax.set_xlabel("lag [readings]")
        ax.tick_params(labelbottom=True)
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 5))
    return figure

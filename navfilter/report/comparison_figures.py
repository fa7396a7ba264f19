"""Figures of a comparison: errors against what each run believes of itself, what is left in the innovations, the models
learnt.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter.diagnostics import acf
from navfilter.evaluation.consistency import LAGS, innovation_series
from navfilter.mission import Stream
from navfilter.report.drawing import WIDTH_IN, band, colour, line, panels
from navfilter.report.figures import clock_of
from navfilter.track import Track

__all__ = ["correlation_figure", "heading_against_sigma", "position_against_sigma", "shade"]

Array = NDArray[np.float64]
Tracks = Mapping[str, Track]


def heading_against_sigma(tracks: Tracks, truth: Stream) -> Figure:
    """Heading error and its 1-sigma band, one panel per run, all on the same scale."""
    clock = clock_of(tracks)
    figure, axes = panels(len(tracks), 1.2)
    limit = 0.0
    for number, (ax, (label, track)) in enumerate(zip(axes, tracks.items(), strict=True)):
        hue, _ = colour(number)
        sd = np.degrees(np.sqrt(track.covariance[:, 8, 8]))
        error = np.degrees(track.errors(truth).heading)
        band(ax, clock(track.time_s), sd, color=hue, alpha=0.3, label=r"$\pm 1\sigma$")
        line(ax, clock(track.time_s), error, color=hue, linewidth=0.9, label="error")
        limit = max(limit, _scale(error), 1.1 * _scale(sd, 0.9))
        _named(ax, label, "heading [deg]")
    for ax in axes:
        ax.set_ylim(-limit, limit)
        ax.axhline(0.0, color="black", linewidth=0.6, zorder=1)
    clock.label(axes[-1])
    return figure


def position_against_sigma(tracks: Tracks, truth: Stream) -> Figure:
    """Horizontal position error and its predicted rms, one panel per run, all on the same scale."""
    clock = clock_of(tracks)
    figure, axes = panels(len(tracks), 1.2)
    limit = 0.0
    for number, (ax, (label, track)) in enumerate(zip(axes, tracks.items(), strict=True)):
        hue, _ = colour(number)
        predicted = np.sqrt(np.maximum(track.covariance[:, 0, 0] + track.covariance[:, 1, 1], 0.0))
        error = track.errors(truth).horizontal
        band(
            ax,
            clock(track.time_s),
            0.5 * predicted,
            0.5 * predicted,
            color=hue,
            alpha=0.3,
            label="up to the predicted rms",
        )
        line(ax, clock(track.time_s), error, color=hue, linewidth=0.9, label="error")
        limit = max(limit, _scale(error), _scale(predicted))
        _named(ax, label, "horizontal [m]")
    for ax in axes:
        ax.set_ylim(0.0, limit)
    clock.label(axes[-1])
    return figure


def _scale(values: Array, p: float = 0.998) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return 1.1 * float(np.quantile(finite, p)) if finite.size else 0.0


def _named(ax: Axes, label: str, quantity: str) -> None:
    ax.set_ylabel(f"{label}\n{quantity}", fontsize=7.5)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, borderaxespad=0.1, fontsize=7.0)


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
            ax.plot(
                range(1, LAGS + 1),
                acf(series, LAGS)[1:],
                color=hue,
                linestyle=dash,
                marker="o",
                markersize=2.2,
                label=label,
            )
            count = max(count, known.size)
        limit = 1.96 / np.sqrt(max(count, 1))
        ax.axhspan(-limit, limit, color="#bbbbbb", alpha=0.5, linewidth=0, label="95 % of white noise", zorder=0)
        ax.axhline(0.0, color="black", linewidth=0.6)
        low, high = ax.get_ylim()
        ax.set_ylim(min(low, -0.1), max(high, 0.1))
        ax.set_title(title)
    for ax in grid[:, 0]:
        ax.set_ylabel("autocorrelation")
    for ax in [grid[-1, 0], *([grid[-1 - len(axes) % 2, 1]] if columns == 2 else [])]:
        ax.set_xlabel("lag [readings]")
        ax.tick_params(labelbottom=True)
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 5))
    return figure


def shade(figure: Figure, tracks: Tracks, begin_s: float) -> Figure:
    """Shade what is not scored, before `begin_s`, in every panel over time."""
    clock = clock_of(tracks)
    if begin_s > clock.begin_s + 1e-9:
        for ax in figure.axes:
            low, high = ax.get_xlim()
            ax.axvspan(
                low,
                clock(np.array([begin_s]))[0],
                facecolor="none",
                edgecolor="#c8c8c8",
                hatch="///",
                linewidth=0,
                zorder=0,
            )
            ax.set_xlim(low, high)
    return figure

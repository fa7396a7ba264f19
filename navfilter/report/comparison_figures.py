"""Figures of a comparison: errors against what each run believes of itself, what is left in the innovations, the models learnt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.diagnostics import acf
from navfilter.error_models import ErrorModel, Sum, per_axis
from navfilter.evaluation.consistency import LAGS, innovation_series
from navfilter.mission import Stream
from navfilter.report.drawing import WIDTH_IN, band, colour, line, panels
from navfilter.report.figures import clock_of
from navfilter.track import Track

__all__ = ["Adopted", "adopted", "adopted_figure", "correlation_figure", "heading_against_sigma", "position_against_sigma", "shade"]

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
        band(ax, clock(track.time_s), 0.5 * predicted, 0.5 * predicted, color=hue, alpha=0.3, label="up to the predicted rms")
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
            ax.plot(range(1, LAGS + 1), acf(series, LAGS)[1:], color=hue, linestyle=dash, marker="o", markersize=2.2, label=label)
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


# --- learnt models ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Adopted:
    """The models that one axis of a sensor has adopted, in the order of their time.

    Attributes
    ----------
    title : str
        Sensor and axis.
    factor, unit : float, str
        From SI to the unit in which the innovation sd is shown.
    time_s : tuple of float
    models : tuple of ArmaModel
    """

    title: str
    factor: float
    unit: str
    time_s: tuple[float, ...]
    models: tuple[ArmaModel, ...]


def adopted(track: Track, unit_of: Any) -> list[Adopted]:
    """What every axis has learnt; axes that have adopted nothing are left out.

    Parameters
    ----------
    track : Track
    unit_of : callable
        Takes a sensor, returns unit and factor, see `navfilter.evaluation.consistency.shown_unit`.
    """
    found = []
    for name, sensor in track.vehicle.sensors.items():
        unit, factor = unit_of(sensor)
        history = [(t, per_axis(error, sensor.axes, name)) for t, error in track.error_models.get(name, [])]
        for i, axis in enumerate(sensor.axis_names):
            steps = [(t, model) for t, models in history if (model := _arma_of(models[i])) is not None]
            # What has not changed since the adoption before is the adoption of another axis.
            steps = [step for k, step in enumerate(steps) if k == 0 or step[1] != steps[k - 1][1]]
            if steps:
                found.append(Adopted(f"{name} {axis}".strip(), factor, unit, *map(tuple, zip(*steps, strict=True))))
    return found


def _arma_of(error: ErrorModel) -> ArmaModel | None:
    """The model that the learnt part of an error carries, if there is one."""
    for part in error.parts if isinstance(error, Sum) else (error,):
        model = getattr(part, "model", None)
        if isinstance(model, ArmaModel):
            return model
    return None


def adopted_figure(tracks: Tracks, history: Adopted, end_s: float) -> Figure:
    """Coefficients, radii of the poles and innovation sd of the adopted models over time.

    Parameters
    ----------
    tracks : dict of str to Track
        For the time axis.
    history : Adopted
    end_s : float
        Until when the last model is in force.
    """
    clock = clock_of(tracks)
    order = max(m.p for m in history.models), max(m.q for m in history.models)
    kinds = [(kind, count) for kind, count in zip(("ar", "ma"), order, strict=True) if count]
    figure, axes = panels(len(kinds) + 1 + bool(order[0]), 1.25)
    t = clock(np.array([*history.time_s, max(end_s, history.time_s[-1])]))
    remaining = iter(axes)
    for kind, count in kinds:
        ax = next(remaining)
        for k in range(count):
            _steps(ax, t, [_at(getattr(m, kind), k) for m in history.models], k, f"{kind}[{k}]")
        ax.set_ylabel(f"{'autoregressive' if kind == 'ar' else 'moving average'}\ncoefficients", fontsize=7.5)
    if order[0]:
        ax = next(remaining)
        for k in range(order[0]):
            _steps(ax, t, [_nines(_at(np.abs(m.poles), k)) for m in history.models], k, "largest" if k == 0 else f"{k + 1}.")
        _nines_axis(ax)
    ax = next(remaining)
    _steps(ax, t, [history.factor * m.sd for m in history.models], 0, "innovation sd")
    ax.set_ylim(0.0, 1.15 * ax.get_ylim()[1])
    ax.set_ylabel(f"sd [{history.unit}]", fontsize=7.5)
    for ax in axes:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=8, borderaxespad=0.1, fontsize=7.0)
    clock.label(axes[-1])
    return figure


def _nines(radius: float) -> float:
    """Radius of a pole on a scale that counts its nines: what happens near 1 is what matters."""
    return -float(np.log10(max(1.0 - radius, 1e-6)))


def _nines_axis(ax: Axes) -> None:
    top = max(2.0, np.ceil(ax.get_ylim()[1]))
    ticks = np.arange(top + 1.0)
    ax.set_ylim(0.0, top)
    ax.set_yticks(ticks, [f"{1.0 - 10.0**-tick:.{int(tick)}f}" for tick in ticks])
    ax.set_ylabel("pole radius", fontsize=7.5)


def _at(values: Array, k: int) -> float:
    return float(values[k]) if k < len(values) else np.nan


def _steps(ax: Axes, t: Array, values: list[float], number: int, label: str) -> None:
    hue, dash = colour(number)
    ax.step(t, [*values, values[-1]], where="post", color=hue, linestyle=dash, label=label)
    ax.plot(t[:-1], values, ".", color=hue, markersize=3)


def shade(figure: Figure, tracks: Tracks, begin_s: float) -> Figure:
    """Shade what is not scored, before `begin_s`, in every panel over time."""
    clock = clock_of(tracks)
    if begin_s > clock.begin_s + 1e-9:
        for ax in figure.axes:
            low, high = ax.get_xlim()
            ax.axvspan(low, clock(np.array([begin_s]))[0], facecolor="none", edgecolor="#c8c8c8", hatch="///", linewidth=0, zorder=0)
            ax.set_xlim(low, high)
    return figure

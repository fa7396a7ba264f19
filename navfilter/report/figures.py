"""The figures of a report. Each takes the runs as a dict of label to Track, so that several models stand side by
side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from scipy.stats import chi2

from navfilter.filter.tape import OUTCOMES
from navfilter.mission import Mission, Stream
from navfilter.report.drawing import WIDTH_IN, Clock, band, broken, colour, line, panels
from navfilter.sensors.traits import shown_unit
from navfilter.track import Track

__all__ = [
    "consistency_figure",
    "depth_figure",
    "heading_figure",
    "innovation_figure",
    "nis_figure",
    "position_figure",
    "track_figure",
]

Array = NDArray[np.float64]
Tracks = Mapping[str, Track]

GREY = "#555555"
#: Half axes of an ellipse that holds 95 % of a plane Gaussian, in standard deviations.
ELLIPSE_95 = float(np.sqrt(chi2.ppf(0.95, 2)))


def clock_of(tracks: Tracks) -> Clock:
    """The time axis that all tracks share."""
    return Clock(min(t.time_s[0] for t in tracks.values()), max(t.time_s[-1] for t in tracks.values()))


def track_figure(tracks: Tracks, mission: Mission, ellipses: int = 16) -> Figure:
    """Plan view, north over east with equal axes: runs with 95 % ellipses, truth, position fixes.

    Parameters
    ----------
    tracks : dict of str to Track
    mission : Mission
        For truth and fixes.
    ellipses : int
        About so many per run, at equal steps of time.

    Returns
    -------
    matplotlib.figure.Figure
    """
    first = next(iter(tracks.values()))
    origin = (float(first.latitude[0]), float(first.longitude[0]))
    plans = {label: track.local(*origin) for label, track in tracks.items()}
    plan = np.concatenate([p[:, :2] for p in plans.values()])
    north, east = np.ptp(plan, axis=0) + 1.0
    height = float(np.clip(WIDTH_IN * 0.9 * north / east, 3.2, 7.0)) + 0.5
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    ax = figure.subplots()
    for name, sensor in first.vehicle.sensors.items():
        if sensor.gives == "position" and name in mission.streams:
            fixes = _used_fixes(first, mission.streams[name], name, origin)
            ax.plot(
                *_capped(fixes)[:, 1::-1].T,
                "+",
                color="#888888",
                markersize=4,
                markeredgewidth=0.7,
                label=f"{name} fixes used",
                zorder=1.5,
            )
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        ax.plot(
            *_thinned_path(plans[label])[:, 1::-1].T,
            color=hue,
            linestyle=dash,
            label=label,
            zorder=2.0 + number,
            linewidth=1.6,
        )
        for k in np.unique(np.linspace(0, len(track) - 1, ellipses).astype(int)):
            shape = _ellipse(plans[label][k], track.covariance[k, :2, :2])
            shape.set(edgecolor=hue, facecolor="none", linewidth=0.8, linestyle=dash, zorder=2.0 + number)
            ax.add_patch(shape)
    if mission.truth is not None:
        true = _local(mission.truth, origin, (first.time_s[0], first.time_s[-1]))
        if len(true):
            ax.plot(
                *_thinned_path(true)[:, 1::-1].T,
                color="black",
                linestyle=(0, (1, 1.2)),
                linewidth=1.0,
                label="truth",
                zorder=9,
            )
    _mark_ends(ax, list(plans.values())[-1])
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    _legend(ax, ("95 % ellipse", Line2D([], [], marker="o", linestyle="", markerfacecolor="none", color=GREY)))
    return figure


def depth_figure(tracks: Tracks, mission: Mission) -> Figure:
    """Height above the start (depth downwards) over time."""
    clock = clock_of(tracks)
    figure, (ax,) = panels(1, 1.6)
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        line(ax, clock(track.time_s), track.height, color=hue, linestyle=dash, label=label)
    if mission.truth is not None and np.isfinite(mission.truth.value[:, 2]).any():
        line(
            ax,
            clock(mission.truth.time_s),
            mission.truth.value[:, 2],
            color="black",
            linestyle=(0, (1, 1.2)),
            label="truth",
        )
    ax.set_ylabel("height [m]")
    clock.label(ax)
    _legend(ax)
    return figure


def position_figure(tracks: Tracks, truth: Stream | None) -> Figure:
    """Position error north, east, down with its 1-sigma band, and in per cent of the distance travelled.

    Without truth the bands alone are drawn: what the filter believes.
    """
    clock = clock_of(tracks)
    figure, axes = panels(4)
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
        error = np.full((len(track), 3), np.nan) if truth is None else track.errors(truth).position_n
        for i in range(3):
            band(axes[i], clock(track.time_s), sd[:, i], color=hue, alpha=0.25, label=rf"{label} $\pm 1\sigma$")
            if truth is not None:
                line(axes[i], clock(track.time_s), error[:, i], color=hue, linestyle=dash, label=label)
        far = track.travelled()
        far[far < max(50.0, 0.02 * far[-1])] = np.nan
        if truth is not None:
            horizontal = np.hypot(error[:, 0], error[:, 1])
            line(axes[3], clock(track.time_s), 100 * horizontal / far, color=hue, linestyle=dash, label=label)
        predicted = 100 * np.sqrt(sd[:, 0] ** 2 + sd[:, 1] ** 2) / far
        line(
            axes[3],
            clock(track.time_s),
            predicted,
            color=hue,
            linestyle=(0, (1, 1.2)),
            linewidth=0.9,
            label=rf"{label}, predicted rms",
        )
    for ax, name in zip(axes, ("north [m]", "east [m]", "down [m]", "horizontal\n[% of distance]"), strict=True):
        ax.set_ylabel(name)
    for ax in axes[:3]:
        _symmetric(ax)
    axes[3].set_ylim(bottom=0.0)
    clock.label(axes[-1])
    _legend(axes[0], above=True, columns=len(tracks))
    _legend(axes[3], above=True, columns=2)
    return figure


def heading_figure(tracks: Tracks, truth: Stream | None) -> Figure:
    """Heading error with its 1-sigma band."""
    clock = clock_of(tracks)
    figure, (ax,) = panels(1, 2.2)
    for number, (label, track) in enumerate(tracks.items()):
        hue, dash = colour(number)
        sd = np.degrees(np.sqrt(track.covariance[:, 8, 8]))
        band(ax, clock(track.time_s), sd, color=hue, alpha=0.25, label=rf"{label} $\pm 1\sigma$")
        if truth is not None and np.isfinite(truth.value[:, 8]).any():
            line(
                ax, clock(track.time_s), np.degrees(track.errors(truth).heading), color=hue, linestyle=dash, label=label
            )
    ax.set_ylabel("heading error [deg]")
    _symmetric(ax)
    clock.label(ax)
    _legend(ax, above=True, columns=len(tracks))
    return figure


def consistency_figure(tracks: Tracks, truth: Stream) -> Figure | None:
    """NEES of position and heading per degree of freedom over time, with the 95 % range of chi-square; None without
    truth of either.
    """
    clock = clock_of(tracks)
    errors = {label: track.errors(truth) for label, track in tracks.items()}
    freedom = {
        "position": max(int(np.isfinite(e.position_n).any(axis=0).sum()) for e in errors.values()),
        "heading": int(any(np.isfinite(e.heading).any() for e in errors.values())),
    }
    freedom = {name: dof for name, dof in freedom.items() if dof}
    if not freedom:
        return None
    figure, axes = panels(len(freedom), 1.6)
    for ax, (name, dof) in zip(axes, freedom.items(), strict=True):
        for number, (label, track) in enumerate(tracks.items()):
            hue, dash = colour(number)
            nees = np.maximum(track.nees(errors[label])[name], 1e-3)
            line(ax, clock(track.time_s), nees, color=hue, linestyle=dash, label=label)
        low, high = chi2.ppf([0.025, 0.975], dof) / dof
        ax.axhspan(max(low, 1e-3), high, color="#bbbbbb", alpha=0.35, linewidth=0, label="95 % of chi-square", zorder=0)
        ax.axhline(1.0, color="black", linewidth=0.7)
        ax.set_yscale("log")
        ax.set_ylim(1e-2, max(10.0, ax.get_ylim()[1]))
        ax.set_ylabel(f"{name}\nNEES per dof")
    clock.label(axes[-1])
    _legend(axes[0], above=True, columns=3)
    return figure


def innovation_figure(track: Track, name: str) -> Figure:
    """Innovations of one sensor, each axis with its 3-sigma bounds; rejected readings are crossed, at the edge when off
    the scale.
    """
    residuals, sensor = track.residuals[name], track.vehicle.sensors[name]
    clock = Clock(track.time_s[0], track.time_s[-1])
    measured = np.flatnonzero(np.isfinite(residuals.value).any(axis=0)).tolist() or [0]
    figure, axes = panels(len(measured), 1.45)
    rejected = residuals.outcome == OUTCOMES.index("rejected")
    for i, ax in zip(measured, axes, strict=True):
        unit, factor = shown_unit(sensor.units[i]) if i < sensor.axes else ("", 1.0)
        seen = residuals.used & np.isfinite(residuals.sd[:, i])
        t, value, bound = (
            clock(residuals.time_s[seen]),
            factor * residuals.value[seen, i],
            3 * factor * residuals.sd[seen, i],
        )
        limit = 1.25 * max(_quantile(bound, 0.98), _quantile(np.abs(value), 0.998), 1e-12)
        if len(t) <= 1500:
            ax.plot(t, value, ".", color="#0072b2", markersize=2.5, label="used")
        else:
            line(ax, t, value, color="#0072b2", linewidth=0.5, label="used")
        for sign in (-1, 1):
            line(ax, t, sign * bound, color="black", linewidth=0.8, label=r"$\pm 3\sigma$" if sign > 0 else None)
        against = rejected | (residuals.used & ~seen)  # also what was left out alone
        out = _capped(np.column_stack([clock(residuals.time_s[against]), factor * residuals.value[against, i]]))
        out = out[np.isfinite(out[:, 1])]
        near = np.abs(out[:, 1]) <= limit
        edge = np.sign(out[~near, 1]) * 0.96 * limit
        for x, y, marker, label in (
            (*out[near].T, "x", "rejected"),
            (out[~near, 0], edge, "D", "rejected, off the scale"),
        ):
            if len(x):
                ax.plot(x, y, marker, color="#d55e00", markerfacecolor="none", markersize=4, label=label)
        ax.set_ylim(-limit, limit)
        axis = sensor.axis_names[i] if i < len(sensor.axis_names) else str(i)
        ax.set_ylabel(f"{name} {axis}".strip() + f"\n[{unit}]")
    clock.label(axes[-1])
    _legend(axes[0], above=True, columns=4)
    return figure


def nis_figure(tracks: Tracks) -> Figure | None:
    """Moving mean of NIS per degree of freedom, sensor by sensor, with the 95 % range of such means; None without
    readings.
    """
    clock = clock_of(tracks)
    names = list(
        dict.fromkeys(name for track in tracks.values() for name, r in track.residuals.items() if r.used.sum() >= 5)
    )
    if not names:
        return None
    figure, axes = panels(len(names), 1.25)
    for ax, name in zip(axes, names, strict=True):
        top = 2.0
        for number, (label, track) in enumerate(tracks.items()):
            if name not in track.residuals or track.residuals[name].used.sum() < 5:
                continue
            hue, dash = colour(number if len(tracks) > 1 else 1)
            t, mean, low, high = moving_nis(track, name)
            t = clock(t)
            if number == 0:
                ax.fill_between(
                    t, low, high, color="#bbbbbb", alpha=0.45, linewidth=0, label="95 % of chi-square", zorder=0
                )
            line(ax, t, mean, color=hue, linestyle=dash, label=label)
            top = max(top, 1.1 * _quantile(mean, 0.995), 1.05 * float(np.nanmax(high)))
        ax.axhline(1.0, color="black", linewidth=0.7)
        ax.set_ylim(0.0, min(top, 12.0))
        ax.set_ylabel(f"{name}\nNIS per dof")
    clock.label(axes[-1])
    _legend(axes[0], above=True, columns=3)
    return figure


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
    low, high = (chi2.ppf(p, count) / count for p in (0.025, 0.975))
    middle = t[window // 2 : window // 2 + len(mean)]
    step = max(1, len(mean) // 700)
    middle, mean, low, high = middle[::step], mean[::step], low[::step], high[::step]
    time, mean = broken(middle, mean)
    return time, mean, broken(middle, low)[1], broken(middle, high)[1]


def _ellipse(centre: Array, P: Array) -> Ellipse:
    variance, axes = np.linalg.eigh(P[::-1, ::-1])  # east, north
    width, height = 2 * ELLIPSE_95 * np.sqrt(np.maximum(variance, 0.0))
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    return Ellipse((centre[1], centre[0]), width, height, angle=angle)


def _local(stream: Stream, origin: tuple[float, float], between: tuple[float, float]) -> Array:
    """North, east [m] of the known positions of a stream within a time."""
    from navfilter.io.write import local_enu

    known = np.isfinite(stream.value[:, :2]).all(axis=1) & (stream.time_s >= between[0]) & (stream.time_s <= between[1])
    place = np.column_stack([stream.value[known, :2], np.zeros(int(known.sum()))])
    return local_enu(place, (*origin, 0.0))[:, 1::-1]


def _used_fixes(track: Track, stream: Stream, name: str, origin: tuple[float, float]) -> Array:
    used = stream
    if name in track.residuals:
        r = track.residuals[name]
        used = stream.keep(np.isin(stream.time_s, r.time_s[r.used]))
    return _local(used, origin, (track.time_s[0], track.time_s[-1]))


def _thinned_path(plan: Array, most: int = 4000) -> Array:
    return plan[:: max(1, len(plan) // most)]


def _capped(points: Array, most: int = 1500) -> Array:
    return points if len(points) <= most else points[np.linspace(0, len(points) - 1, most).astype(int)]


def _mark_ends(ax: Axes, plan: Array) -> None:
    for row, marker, name in ((plan[0], "o", "start"), (plan[-1], "s", "end")):
        ax.plot(row[1], row[0], marker, color="black", markersize=5, markerfacecolor="white", zorder=10, label=name)


def _quantile(values: Array, p: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, p)) if finite.size else 0.0


def _symmetric(ax: Axes) -> None:
    limit = max(abs(v) for v in ax.get_ylim())
    ax.set_ylim(-limit, limit)
    ax.axhline(0.0, color="black", linewidth=0.6, zorder=1)


def _legend(ax: Axes, *more: tuple[str, Any], above: bool = False, columns: int = 1) -> None:
    handles, labels = ax.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True)) | dict(more)
    if not named:
        return
    if above:
        ax.legend(
            named.values(),
            named.keys(),
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=max(columns, 2),
            borderaxespad=0.1,
        )
    else:
        ax.legend(named.values(), named.keys(), loc="best", frameon=True, framealpha=0.85, edgecolor="none")

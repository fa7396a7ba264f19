"""A track as a figure; matplotlib is imported with this module, which nothing imports before it is asked for."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter.foundation import utc

if TYPE_CHECKING:
    from navfilter.track.track import Track

__all__ = ["TrackFigure", "plot"]

Array = NDArray[np.float64]


class TrackFigure(Figure):
    """A figure that notebooks show without pyplot, whose list of open figures would keep it for ever."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def plot(track: Track) -> TrackFigure:
    """See `Track.plot`."""
    if not len(track):
        raise ValueError("this track has no rows: there is nothing to plot.")
    figure = TrackFigure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.1, 1.0))
    left, right = halves
    _from_above(left.subplots(), track)
    _over_time(right.subplots(3, 1, sharex=True), track)
    figure.suptitle(f"{track.mission_name}, {track.label}")
    return figure


def _from_above(ax: Axes, track: Track) -> None:
    north, east, _ = track.local().T
    ax.plot(east, north, color="#0072b2", linewidth=1.1)
    ax.plot(east[:1], north[:1], "o", color="#0072b2", label="begin")
    ax.plot(east[-1:], north[-1:], "s", color="#d55e00", label="end")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="east [m]", ylabel="north [m]")
    ax.legend(frameon=False)
    ax.grid(alpha=0.3)


def _over_time(axes: NDArray[np.object_], track: Track) -> None:
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    heading, heading_sd = np.degrees(np.unwrap(track.attitude[:, 2])), np.degrees(track.attitude_sd()[:, 2])
    time = _axis(axes[-1], track)
    for ax, value, spread, name in (
        (axes[0], -track.height, sd[:, 2], "depth [m]"),
        (axes[1], heading, heading_sd, "heading [deg]"),
    ):
        ax.fill_between(time, value - spread, value + spread, color="#0072b2", alpha=0.25, linewidth=0.0)
        ax.plot(time, value, color="#0072b2", linewidth=1.0)
        ax.set_ylabel(name)
    axes[0].invert_yaxis()
    axes[2].plot(time, np.hypot(sd[:, 0], sd[:, 1]), color="#0072b2", linewidth=1.0)
    axes[2].set_ylabel("sd of position [m]")
    axes[2].set_ylim(bottom=0.0)
    for ax in axes:
        ax.grid(alpha=0.3)


def _axis(ax: Axes, track: Track) -> Array | NDArray[np.datetime64]:
    """The times as they are drawn: dates where they are known, else seconds."""
    if track.time_utc is None:
        zero, since = utc.axis_from(float(track.time_s[0]))
        ax.set_xlabel(f"mission time{since} [s]")
        return track.time_s - zero
    locator = AutoDateLocator()
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    ax.set_xlabel("UTC")
    return track.time_utc

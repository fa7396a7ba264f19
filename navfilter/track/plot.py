"""A track as a figure; matplotlib is imported with this module, which nothing imports before it is asked for."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from navfilter.foundation import utc
from navfilter.foundation.arrays import AnyArray, Array

Times = AnyArray  # float64, or datetime64
COLOUR, END_COLOUR = "#0072b2", "#d55e00"


class TrackFigure(Figure):
    """A figure that notebooks show without pyplot, whose list of open figures would keep it for ever."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def track_figure(
    title: str, place: Array, times: Times, curves: Mapping[str, tuple[Array, Array | None]]
) -> TrackFigure:
    """A track seen from above, and quantities over its time.

    Parameters
    ----------
    title : str
    place : ndarray, shape (n, 3)
        North, east, down [m].
    times : ndarray, shape (n,)
        Mission time [s], or dates.
    curves : mapping of str to (ndarray, ndarray or None)
        By label: values (n,), and their standard deviation. Depth grows downwards; what has no standard deviation is
        not negative.
    """
    figure = TrackFigure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.1, 1.0))
    left, right = halves
    _from_above(left.subplots(), place)
    _over_time(right.subplots(len(curves), 1, sharex=True), times, curves)
    figure.suptitle(title)
    return figure


def _from_above(ax: Axes, place: Array) -> None:
    north, east, _ = place.T
    ax.plot(east, north, color=COLOUR, linewidth=1.1)
    ax.plot(east[:1], north[:1], "o", color=COLOUR, label="begin")
    ax.plot(east[-1:], north[-1:], "s", color=END_COLOUR, label="end")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="east [m]", ylabel="north [m]")
    ax.legend(frameon=False)
    ax.grid(alpha=0.3)


def _over_time(axes: Any, times: Times, curves: Mapping[str, tuple[Array, Array | None]]) -> None:
    time = _axis(axes[-1], times)
    for ax, (label, (value, sd)) in zip(axes, curves.items(), strict=True):
        if sd is not None:
            ax.fill_between(time, value - sd, value + sd, color=COLOUR, alpha=0.25, linewidth=0.0)
        ax.plot(time, value, color=COLOUR, linewidth=1.0)
        ax.set_ylabel(label)
        if label.startswith("depth"):
            ax.invert_yaxis()
        if sd is None:
            ax.set_ylim(bottom=0.0)
        ax.grid(alpha=0.3)


def _axis(ax: Axes, times: Times) -> Times:
    """The times as they are drawn: dates where they are known, else seconds."""
    if times.dtype.kind == "M":
        locator = AutoDateLocator()
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        ax.set_xlabel("UTC")
        return times
    zero, since = utc.axis_from(float(times[0]))
    ax.set_xlabel(f"mission time{since} [s]")
    return np.asarray(times - zero)

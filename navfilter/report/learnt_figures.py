"""Figures of what was learnt: the spectrum beside the one that was believed, and the models over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter.evaluation.wording import Learnt
from navfilter.report.drawing import WIDTH_IN, colour, panels
from navfilter.report.figures import clock_of
from navfilter.track import Track

__all__ = ["adopted_figure", "learnt_figures", "spectrum_figure"]

Array = NDArray[np.float64]
Tracks = Mapping[str, Track]

#: Frequencies of a spectrum that nobody has learnt, from one period in so many samples up.
FREQUENCIES, LONGEST = 400, 20000


def learnt_figures(tracks: Tracks, found: tuple[Learnt, ...]) -> Iterator[tuple[str, Figure]]:
    """Caption and figure, spectrum and history of every axis, one after the other.

    Parameters
    ----------
    tracks : dict of str to Track
        For the time axis.
    found : tuple of Learnt
    """
    end_s = max(float(track.time_s[-1]) for track in tracks.values())
    for history in found:
        caption = (
            "Spectrum at the end, with the range from 5 to 95 % that its posterior leaves, and that of vehicle.toml."
        )
        yield f"{history}. {caption}", spectrum_figure(history)
        last = history.models[-1]
        text = f"{history.title}: {len(history.models)} models, the last one of order ({last.p}, {last.q})."
        yield f"{text} A pole radius of 1 would be a random walk.", adopted_figure(tracks, history, end_s)


def spectrum_figure(history: Learnt) -> Figure:
    """Density of the learnt error, with the range that its posterior leaves, and of what was believed, over
    frequency.
    """
    freq_hz, below, median, above = history.spectrum
    if not freq_hz.size:
        freq_hz = np.geomspace(history.scale.rate_hz / LONGEST, 0.5 * history.scale.rate_hz, FREQUENCIES)
    figure = Figure(figsize=(WIDTH_IN, 2.9), layout="constrained")
    ax = figure.subplots()
    hue, dash = colour(0)
    ax.loglog(freq_hz, history.believed_spectrum(freq_hz), color=hue, linestyle=dash, label="believed")
    if median.size:
        hue, dash = colour(1)
        ax.loglog(freq_hz, median, color=hue, linestyle=dash, label="learnt")
        ax.fill_between(freq_hz, below, above, color=hue, alpha=0.25, linewidth=0.0, label="5 to 95 %")
    low, high = ax.get_ylim()
    ax.set_ylim(0.3 * low, 3.0 * high)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"{history.title}\n[({history.scale.unit})$^2$/Hz]")
    ax.legend(loc="lower left")
    return figure


def adopted_figure(tracks: Tracks, history: Learnt, end_s: float) -> Figure:
    """Coefficients, radii of the poles and innovation sd of the adopted models over time.

    Parameters
    ----------
    tracks : dict of str to Track
        For the time axis.
    history : Learnt
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
            _steps(
                ax,
                t,
                [_nines(_at(np.abs(m.poles), k)) for m in history.models],
                k,
                "largest" if k == 0 else f"{k + 1}.",
            )
        _nines_axis(ax)
    ax = next(remaining)
    _steps(ax, t, [history.scale.factor * m.sd for m in history.models], 0, "innovation sd")
    ax.set_ylim(0.0, 1.15 * ax.get_ylim()[1])
    ax.set_ylabel(f"sd [{history.scale.unit}]", fontsize=7.5)
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

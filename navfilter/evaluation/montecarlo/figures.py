"""Figures of a campaign: error envelope against predicted sigma, NEES over time with its band, distribution of the end
error.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from navfilter.evaluation.montecarlo.campaign import Results
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES
from navfilter.evaluation.montecarlo.store import write_whole
from navfilter.foundation.arrays import Array
from navfilter.foundation.chi_square import chi_square_range
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import WIDTH_IN, colour, style, time_axis

#: Components of the NEES of a position, of a heading.
_FREEDOM = {"nees_position": 3, "nees_heading": 1}


def write_figures(results: Results, folder: Path) -> list[str]:
    """Draw all figures as PNG; returns their names."""
    figures = {f"envelope-{track}.png": envelope_figure(results, track) for track in results.tracks}
    figures |= {"nees.png": nees_figure(results), "end-error.png": end_error_figure(results)}
    for name, figure in figures.items():
        write_whole(folder / name, _png(figure))
    return list(figures)


def envelope_figure(results: Results, track: str) -> Figure:
    """Heading and north error of every model: 95 % of the runs, and 1.96 predicted standard deviations."""
    t, n = results.tracks.index(track), len(results.models)
    with style():
        figure = Figure(figsize=(WIDTH_IN + 1.6, 1.45 * n + 0.8), layout="constrained")
        axes = figure.subplots(n, 2, sharex=True, sharey="col", squeeze=False)
        clock = _clock(results)
        for m, model in enumerate(results.models):
            for ax, (what, unit) in zip(axes[m], (("heading", "deg"), ("north", "m")), strict=True):
                error, sd = (_curve(results, m, t, f"{what}{key}_{unit}") for key in ("", "_sd"))
                _envelope(ax, clock(results.time_s), error, sd, colour(m)[0])
                _mark_score(ax, results, clock)
                ax.set_ylabel(f"{model}\n{what} error [{unit}]" if what == "heading" else f"{what} error [{unit}]")
        _limit(axes, results, t)
        for ax in axes[-1]:
            time_axis(ax, clock)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        axes[0][0].set_title(f"{results.campaign.name}, {track}", loc="left")
        axes[0][1].set_title(f"{len(results.seeds)} runs", loc="right")
    return figure


def nees_figure(results: Results) -> Figure:
    """NEES per degree of freedom over time, averaged over the runs, with the band in which an honest filter stays."""
    clock, runs = _clock(results), len(results.seeds)
    with style():
        figure = Figure(figsize=(WIDTH_IN + 1.6, 2.0 * 2 + 0.9), layout="constrained")
        axes = figure.subplots(2, len(results.tracks), sharex=True, sharey=True, squeeze=False)
        for t, track in enumerate(results.tracks):
            for ax, (key, dof) in zip(axes[:, t], _FREEDOM.items(), strict=True):
                low, high = chi_square_range(runs * dof)
                ax.axhspan(
                    low, high, color="#bbbbbb", alpha=0.5, linewidth=0, label=f"95 % of honest filters, {runs} runs"
                )
                for m, model in enumerate(results.models):
                    tone, dashes = colour(m)
                    mean = _over_runs(np.nanmean, _curve(results, m, t, key))
                    ax.plot(clock(results.time_s), np.maximum(mean, 1e-3), color=tone, linestyle=dashes, label=model)
                ax.set_yscale("log")
                _mark_score(ax, results, clock)
                ax.set_title(f"{key.split('_')[1]}, {track}")
        _limit_nees(axes, results)
        for ax in axes[:, 0]:
            ax.set_ylabel("NEES / dof, mean of runs")
        for ax in axes[-1]:
            time_axis(ax, clock)
        handles, labels = axes[1][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def end_error_figure(results: Results) -> Figure:
    """Share of the runs whose position error at the end of the dive is below a limit."""
    q = SCORES.index("end_m")
    with style():
        figure = Figure(figsize=(WIDTH_IN, 3.0), layout="constrained")
        axes = figure.subplots(1, len(results.tracks), sharex=True, sharey=True, squeeze=False)[0]
        for t, (ax, track) in enumerate(zip(axes, results.tracks, strict=True)):
            for m, model in enumerate(results.models):
                values = np.sort(results.scores[m, t, :, q])
                values = values[np.isfinite(values)]
                share = np.arange(values.size + 1) / max(values.size, 1)
                tone, dashes = colour(m)
                steps = np.concatenate([[0.0], values])
                ax.plot(steps, share, drawstyle="steps-post", color=tone, linestyle=dashes, label=model)
            ax.set_title(track)
            ax.set_xlabel("position error at the end of the dive [m]")
            ax.set_xlim(left=0.0)
        axes[0].set_ylabel("share of the runs")
        axes[0].legend(loc="lower right")
    return figure


def _envelope(ax: Axes, time: Array, error: Array, sd: Array, tone: str) -> None:
    many = len(error) >= 20
    low, high = (_over_runs(np.nanquantile, error, q) for q in ((0.025, 0.975) if many else (0.0, 1.0)))
    predicted = 1.96 * np.sqrt(_over_runs(np.nanmean, sd**2))
    ax.fill_between(
        time, low, high, color="#9a9a9a", alpha=0.55, linewidth=0, label="95 % of the runs" if many else "all runs"
    )
    ax.plot(time, predicted, color=tone if tone else "k", label="1.96 predicted sd (colour of the model)")
    ax.plot(time, -predicted, color=tone)


def _limit(axes: Any, results: Results, t: int) -> None:
    """The axes show the scored part, and what the errors are there; the uncertain start may leave the picture."""
    later = results.time_s >= 0.15 * results.time_s[-1]
    for ax, what in zip(axes[0], ("heading_deg", "north_m"), strict=True):
        top = max(_largest(_curve(results, m, t, what)[:, later]) for m in range(len(results.models)))
        ax.set_ylim(-1.25 * top, 1.25 * top)


def _limit_nees(axes: Any, results: Results) -> None:
    later = results.time_s >= 0.15 * results.time_s[-1]
    values = [
        _over_runs(np.nanmean, _curve(results, m, t, key))[later]
        for m in range(len(results.models))
        for t in range(len(results.tracks))
        for key in _FREEDOM
    ]
    finite = np.concatenate(values)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return
    low, high = max(min(0.3, 0.7 * float(finite.min())), 0.02), max(3.0, 1.4 * float(finite.max()))
    axes[0][0].set_ylim(low, high)
    steps = (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)
    for ax in axes.ravel():
        ax.yaxis.set_major_locator(LogLocator(10.0, subs=steps))
        ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        ax.yaxis.set_minor_formatter(NullFormatter())


def _largest(values: Array) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.quantile(finite, 0.995)), 1e-6) if finite.size else 1.0


def _mark_score(ax: Axes, results: Results, clock: Clock) -> None:
    begin = float(clock(np.array(float(results.campaign.score_from_s or 0.0))))
    ax.axvline(begin, color="#444444", linewidth=0.8, linestyle=":")


def _clock(results: Results) -> Clock:
    return Clock(float(results.time_s[0]), float(results.time_s[-1]))


def _curve(results: Results, m: int, t: int, name: str) -> Array:
    """One curve of all runs, shape (runs, times)."""
    return results.curves[m, t, :, CURVES.index(name)].astype(np.float64)


def _over_runs(how: Any, values: Array, *more: Any) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # times at which no run has a value
        return np.asarray(how(values, *more, axis=0))


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    with style():
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
        return buffer.getvalue()

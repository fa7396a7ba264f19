"""Figures of a campaign: error envelope against predicted sigma, NEES over time with its band, distribution of the end
error.
"""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from navfilter.evaluation.montecarlo.campaign import Results, write_whole
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES
from navfilter.foundation.arrays import Array
from navfilter.foundation.chi_square import chi_square_range
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import colour, draw, style
from navfilter.rendering.panels import Band, Level, Line, Mark, Panel, Stack

#: Components of the NEES of a position, of a heading.
_FREEDOM = {"nees_position": 3, "nees_heading": 1}


def write_figures(results: Results, folder: Path) -> list[str]:
    """Draw all figures as PNG; returns their names."""
    stacks = {f"envelope-{track}.png": envelope_figure(results, track) for track in results.tracks}
    stacks |= {"nees.png": nees_figure(results), "end-error.png": end_error_figure(results)}
    for name, stack in stacks.items():
        write_whole(folder / name, _png(stack, results, name.removesuffix(".png")))
    return list(stacks)


def envelope_figure(results: Results, track: str) -> Stack:
    """Heading and north error of every model: 95 % of the runs, and 1.96 predicted standard deviations."""
    t, panels, many = results.tracks.index(track), list[Panel](), len(results.seeds) >= 20
    ends, label = ((0.025, 0.975), "95 % of the runs") if many else ((0.0, 1.0), "all runs")
    for what, unit in (("heading", "deg"), ("north", "m")):
        errors = [_curve(results, m, t, f"{what}_{unit}") for m in range(len(results.models))]
        top = 1.25 * max(_largest(error[:, _later(results)]) for error in errors)
        for m, (model, error) in enumerate(zip(results.models, errors, strict=True)):
            low, high = (_over_runs(np.nanquantile, error, q) for q in ends)
            sd = 1.96 * np.sqrt(_over_runs(np.nanmean, _curve(results, m, t, f"{what}_sd_{unit}") ** 2))
            hue, _ = colour(m)
            predicted = Line(results.time_s, sd, "1.96 predicted sd (colour of the model)", hue)
            below = Line(results.time_s, -sd, "", hue)
            parts = (Band(results.time_s, low, high, label, "#9a9a9a", 0.55), predicted, below)
            panels.append(Panel(f"{model}\n{what} [{unit}]", parts, (-top, top)))
    return Stack(tuple(panels), 1.2, _scored(results))


def nees_figure(results: Results) -> Stack:
    """NEES per degree of freedom over time, averaged over the runs, with the band in which an honest filter stays."""
    means = {
        (t, key): [_over_runs(np.nanmean, _curve(results, m, t, key)) for m in range(len(results.models))]
        for t in range(len(results.tracks))
        for key in _FREEDOM
    }
    shown = np.concatenate([mean[_later(results)] for own in means.values() for mean in own])
    shown = shown[np.isfinite(shown)]
    limits = (
        max(min(0.3, 0.7 * float(shown.min(initial=1.0))), 0.02),
        max(3.0, 1.4 * float(shown.max(initial=1.0))),
    )
    panels = []
    for (t, key), own in means.items():
        low, high = map(float, chi_square_range(len(results.seeds) * _FREEDOM[key]))
        level = Level(low, high, f"95 % of honest filters, {len(results.seeds)} runs")
        pairs = enumerate(zip(results.models, own, strict=True))
        lines = [Line(results.time_s, np.maximum(mean, 1e-3), model, *colour(m)) for m, (model, mean) in pairs]
        label = f"{results.tracks[t]}, {key.split('_')[1]}\nNEES / dof"
        panels.append(Panel(label, tuple(lines), limits, log=True, level=level))
    return Stack(tuple(panels), 1.7, _scored(results))


def end_error_figure(results: Results) -> Stack:
    """Share of the runs whose position error at the end of the dive is below a limit."""
    panels = []
    for t, track in enumerate(results.tracks):
        lines = []
        for m, model in enumerate(results.models):
            values = np.sort(results.scores[m, t, :, SCORES.index("end_m")])
            values = values[np.isfinite(values)]
            share = np.arange(values.size + 1) / max(values.size, 1)
            lines.append(Line(np.concatenate([[0.0], values]), share, model, *colour(m), steps=True))
        panels.append(Panel(f"{track}\nshare of the runs", tuple(lines), (0.0, 1.03)))
    return Stack(tuple(panels), 2.4, x_label="position error at the end of the dive [m]")


def _later(results: Results) -> Any:
    """The times whose errors the axes show; the uncertain start may leave the picture."""
    return results.time_s >= 0.15 * results.time_s[-1]


def _largest(values: Array) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.quantile(finite, 0.995)), 1e-6) if finite.size else 1.0


def _scored(results: Results) -> tuple[Mark, ...]:
    begin_s = float(results.campaign.score_from_s or 0.0)
    return (Mark(begin_s, begin_s, "scored from here", "", "#444444"),)


def _curve(results: Results, m: int, t: int, name: str) -> Array:
    """One curve of all runs, shape (runs, times)."""
    return results.curves[m, t, :, CURVES.index(name)].astype(np.float64)


def _over_runs(how: Any, values: Array, *more: Any) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # times at which no run has a value
        return np.asarray(how(values, *more, axis=0))


def _png(stack: Stack, results: Results, name: str) -> bytes:
    buffer = io.BytesIO()
    with style():
        figure = draw(stack, Clock(float(results.time_s[0]), float(results.time_s[-1])))
        figure.suptitle(f"{results.campaign.name}, {len(results.seeds)} runs: {name}", fontsize=9.0)
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()

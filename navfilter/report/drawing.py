"""How figures are drawn: one style, long series thinned to their envelopes, SVG that fits into a page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from navfilter import utc

__all__ = ["Clock", "band", "broken", "colour", "envelope", "extremes", "line", "panels", "style", "svg"]

Array = NDArray[np.float64]

#: Told apart by people who see few colours, and in grey by their brightness (after Okabe and Ito, 2008).
COLOURS = ("#e69f00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
DASHES: tuple[Any, ...] = ("-", "-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
WIDTH_IN = 6.2
#: A line gets two points, lowest and highest, for each of so many stretches: about one stretch per pixel.
STRETCHES = 400

_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.solid_joinstyle": "round",
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "svg.fonttype": "path",
    "svg.hashsalt": "navfilter",
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style; the settings of the program around are untouched."""
    with matplotlib.rc_context(_STYLE):  # type: ignore[arg-type]
        yield


def colour(number: int) -> tuple[str, Any]:
    """Colour and dashes of the run with this number."""
    return COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)]


class Clock:
    """Time axis of a mission in the unit that suits its length; a clock that counts from 1970 is drawn from the
    beginning.
    """

    def __init__(self, begin_s: float, end_s: float) -> None:
        length = end_s - begin_s
        self.zero_s, self._from = utc.axis_from(begin_s)
        self.begin_s, self.end_s = begin_s, end_s
        self.unit, self.factor = (
            ("h", 1 / 3600) if length > 3 * 3600 else ("min", 1 / 60) if length > 600 else ("s", 1.0)
        )

    def __call__(self, time_s: Array) -> Array:
        return (np.asarray(time_s) - self.zero_s) * self.factor

    def label(self, ax: Axes) -> None:
        """Name the axis and set its range."""
        ax.set_xlabel(f"mission time{self._from} [{self.unit}]")
        margin = 0.01 * max(self.end_s - self.begin_s, 1e-3)
        ax.set_xlim(*self(np.array([self.begin_s - margin, self.end_s + margin])))


def panels(rows: int, height_in: float = 1.5, extra_in: float = 0.75) -> tuple[Figure, list[Axes]]:
    """A figure with panels one above the other that share the time axis."""
    figure = Figure(figsize=(WIDTH_IN, rows * height_in + extra_in), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)
    return figure, list(axes[:, 0])


def broken(time_s: Array, value: Array) -> tuple[Array, Array]:
    """Insert a NaN in every long gap, so that no line is drawn across it."""
    if len(time_s) < 3:
        return time_s, value
    step = np.diff(time_s)
    gap = np.flatnonzero(step > max(8.0 * float(np.median(step)), 0.004 * (time_s[-1] - time_s[0])))
    middle = 0.5 * (time_s[gap] + time_s[gap + 1])
    return np.insert(time_s, gap + 1, middle), np.insert(value, gap + 1, np.nan)


def _stretches(value: Array, stretches: int, fill: float) -> Array:
    size = -(-len(value) // stretches)
    padded = np.full(stretches * size, fill)
    padded[: len(value)] = np.where(np.isfinite(value), value, fill)
    return padded.reshape(stretches, size)


def envelope(time: Array, value: Array, stretches: int = STRETCHES) -> tuple[Array, Array]:
    """Thin a series to the lowest and the highest point of every stretch; what is drawn looks the same.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
    stretches : int
        Stretches of equal numbers of points.

    Returns
    -------
    time, value : ndarray, shape (m,)
        m <= 4 stretches; the first NaN of every gap is kept, so that gaps stay gaps.

    Examples
    --------
    >>> t = np.arange(10_000.0)
    >>> thin_t, thin = envelope(t, np.where(t == 5000, 9.0, 0.0), stretches=100)
    >>> len(thin) <= 400, float(thin.max())
    (True, 9.0)
    """
    n = len(time)
    if n <= 4 * stretches:
        return time, value
    low, high = _stretches(value, stretches, np.inf), _stretches(value, stretches, -np.inf)
    size = low.shape[1]
    index = (
        np.sort(np.stack([low.argmin(axis=1), high.argmax(axis=1)], axis=1), axis=1)
        + size * np.arange(stretches)[:, None]
    )
    missing = ~np.isfinite(value)
    gaps = np.flatnonzero(missing & ~np.concatenate([[False], missing[:-1]]))[:stretches]
    index = np.unique(np.concatenate([np.minimum(index, n - 1).ravel(), gaps]))
    return time[index], value[index]


def extremes(time: Array, low: Array, high: Array, stretches: int = STRETCHES) -> tuple[Array, Array, Array]:
    """Thin a band to the outermost edges of every stretch."""
    n = len(time)
    if n <= 2 * stretches:
        return time, low, high
    bottom, top = _stretches(low, stretches, np.inf).min(axis=1), _stretches(high, stretches, -np.inf).max(axis=1)
    size = -(-n // stretches)
    middle = np.minimum(np.arange(stretches) * size + size // 2, n - 1)
    gone = ~(np.isfinite(bottom) & np.isfinite(top))
    bottom[gone] = top[gone] = np.nan
    inside = np.arange(stretches) * size < n
    return time[middle][inside], bottom[inside], top[inside]


def line(ax: Axes, time: Array, value: Array, **options: Any) -> None:
    """Draw a series, thinned, with its gaps left open."""
    ax.plot(*envelope(*broken(time, value)), **options)


def band(ax: Axes, time: Array, sd: Array, centre: Array | None = None, **options: Any) -> None:
    """Draw the band of one sd about a series (default: about zero), thinned."""
    t, s = broken(time, sd)
    c = np.zeros_like(s) if centre is None else broken(time, centre)[1]
    ax.fill_between(*extremes(t, c - s, c + s), linewidth=0.0, **options)


def svg(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    with style():
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    # Hundredths of a point are finer than any screen or printer; the six digits of matplotlib double the size of a
    # report.
    return re.sub(rb' d="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path.group()), buffer.getvalue())

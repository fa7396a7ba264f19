"""What a figure shows, before anything draws it: panels one above the other, with lines, bands and points.

The same description becomes the figure for print (`navfilter.rendering.drawing`) and the one that can be zoomed.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from navfilter.foundation.arrays import Array


@dataclass(frozen=True, eq=False)
class Line:
    """A series.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        x is mission time [s] or what `Stack.x_label` says; a NaN in y breaks the line.
    label : str
        For the legend; "" for none.
    hue : str
        ``#rrggbb``.
    dash : object
        As matplotlib has it: "-", or (offset, (on, off, ...)) in line widths.
    width : float
        [pt].
    steps : bool
        Each value holds until the next one.
    """

    x: Array
    y: Array
    label: str
    hue: str
    dash: Any = "-"
    width: float = 1.1
    steps: bool = False


def stems(x: Array, low: Array, high: Array, hue: str, width: float = 1.1) -> Line:
    """A vertical line at each x."""
    ends = np.column_stack([low, high, np.full(len(x), np.nan)])
    return Line(np.repeat(x, 3), ends.ravel(), "", hue, width=width)


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two series over the same x."""

    x: Array
    low: Array
    high: Array
    label: str
    hue: str
    alpha: float = 0.25


@dataclass(frozen=True, eq=False)
class Points:
    """Single points: "." used readings, "x" rejected ones, "D" rejected ones off the scale, "o" models."""

    x: Array
    y: Array
    label: str
    hue: str
    marker: Literal[".", "x", "D", "o"] = "."


@dataclass(frozen=True)
class Level:
    """A range of y that something should keep to, over the whole width."""

    low: float
    high: float
    label: str


Part = Line | Band | Points


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes.

    Attributes
    ----------
    label : str
        Of the y axis, unit included; may have two lines.
    parts : tuple of Line, Band or Points
        Drawn in this order.
    limits : tuple of float or None
        Of y; otherwise as `shape` says.
    shape : str
        "symmetric" about zero, "from zero", or "free".
    log : bool
        Logarithmic y.
    lines_at : tuple of float
        Thin horizontal lines.
    level : Level or None
    ticks : tuple of (float, str)
        Where y has ticks of its own.
    """

    label: str
    parts: tuple[Part, ...]
    limits: tuple[float, float] | None = None
    shape: Literal["free", "symmetric", "from zero"] = "free"
    log: bool = False
    lines_at: tuple[float, ...] = ()
    level: Level | None = None
    ticks: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Mark:
    """Something that happened, shown in all panels over time.

    Attributes
    ----------
    begin_s, end_s : float
        Mission time [s]; the same for a moment.
    label : str
        What kind it is, for the legend.
    text : str
        What it was.
    hue : str
    """

    begin_s: float
    end_s: float
    label: str
    text: str
    hue: str


@dataclass(frozen=True, eq=False)
class Stack:
    """Panels above each other that share their x axis.

    Attributes
    ----------
    panels : tuple of Panel
    height_in : float
        Of one panel, in print [in].
    marks : tuple of Mark
    x_label : str
        "" for mission time.
    log_x : bool
    """

    panels: tuple[Panel, ...]
    height_in: float = 1.5
    marks: tuple[Mark, ...] = ()
    x_label: str = ""
    log_x: bool = False


def extent(panel: Panel) -> tuple[float, float] | None:
    """Lowest and highest y that a panel shows; None where the drawing library may choose."""
    if panel.limits is not None:
        return panel.limits
    if panel.shape == "free":
        return None
    values = [np.abs(v[np.isfinite(v)]) for part in panel.parts for v in _heights(part)]
    most = 1.05 * max((float(v.max()) for v in values if v.size), default=0.0) or 1.0
    return (-most if panel.shape == "symmetric" else 0.0), most


def by_label(marks: tuple[Mark, ...]) -> dict[str, list[Mark]]:
    """Marks of the same kind together."""
    found: dict[str, list[Mark]] = {}
    for mark in marks:
        found.setdefault(mark.label, []).append(mark)
    return found


def short(name: str, most: int = 24) -> str:
    """A name of any length as it stands at an axis or in a legend."""
    return name if len(name) <= most else f"{name[: most - 1]}…"


def _heights(part: Part) -> tuple[Array, ...]:
    return (part.low, part.high) if isinstance(part, Band) else (part.y,)


def legend_of(stack: Stack, row: int) -> list[Part | Level]:
    """What the legend of one panel lists: every label that no panel above has."""
    above = {part.label for panel in stack.panels[:row] for part in _labelled(panel)}
    found: dict[str, Part | Level] = {}
    for part in _labelled(stack.panels[row]):
        if part.label not in above:
            found.setdefault(part.label, part)
    return list(found.values())


def _labelled(panel: Panel) -> list[Part | Level]:
    parts: list[Part | Level] = [*panel.parts, *([panel.level] if panel.level is not None else [])]
    return [part for part in parts if part.label]

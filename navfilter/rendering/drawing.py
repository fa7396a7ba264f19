"""How figures are drawn: one style, long series thinned to their envelopes, SVG that fits into a page."""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from navfilter.rendering.clock import Clock
from navfilter.rendering.panels import Band, Mark, Panel, Part, Points, Stack, by_label, extent, legend_of
from navfilter.rendering.thinning import broken, envelope, extremes

#: Told apart by people who see few colours, and in grey by their brightness (after Okabe and Ito, 2008).
COLOURS = ("#e69f00", "#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
DASHES: tuple[Any, ...] = ("-", "-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
WIDTH_IN = 6.2

_STYLE = matplotlib.rc_params_from_file(Path(__file__).with_suffix(".mplstyle"), use_default_template=False)


@contextmanager
def style() -> Iterator[None]:
    """Draw in the project's style; the settings of the program around are untouched."""
    with matplotlib.rc_context(_STYLE):
        yield


def colour(number: int) -> tuple[str, Any]:
    """Colour and dashes of the run with this number."""
    return COLOURS[number % len(COLOURS)], DASHES[number % len(DASHES)]


def no_formula(text: str) -> str:
    """Text of people, which is no formula whatever signs are in it."""
    return text.replace("$", r"\$")


def draw(stack: Stack, clock: Clock | None = None) -> Figure:
    """Draw panels one above the other.

    Parameters
    ----------
    stack : Stack
    clock : Clock, optional
        Of the time axis; not used where x is something else.
    """
    clock, rows = clock or Clock(0.0, 1.0), len(stack.panels)
    figure = Figure(figsize=(WIDTH_IN, rows * stack.height_in + 0.75), layout="constrained")
    axes = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    x = (lambda values: values) if stack.x_label else clock
    for row, (ax, panel) in enumerate(zip(axes, stack.panels, strict=True)):
        handles = {part.label: _drawn(ax, part, x, not stack.log_x) for part in panel.parts}
        if panel.level is not None:
            low, high = panel.level.low, panel.level.high
            handles[panel.level.label] = ax.axhspan(low, high, color=LEVEL, alpha=0.4, linewidth=0, zorder=0)
        for y in panel.lines_at:
            ax.axhline(y, color="black", linewidth=0.6, zorder=1)
        handles |= {label: _marked(ax, found, clock) for label, found in by_label(stack.marks).items()}
        _scaled(ax, panel)
        ax.set_ylabel(no_formula(panel.label), fontsize=9.0 if len(panel.label) < 24 and rows < 4 else 7.5)
        _legend(ax, [part.label for part in legend_of(stack, row)], handles, stack.marks if row == 0 else ())
    if stack.x_label:
        axes[-1].set_xlabel(stack.x_label)
        axes[-1].set_xscale("log" if stack.log_x else "linear")
    else:
        time_axis(axes[-1], clock)
    return figure


#: Of the range that something should keep to.
LEVEL = "#bbbbbb"


def _drawn(ax: Axes, part: Part, x: Any, linear: bool) -> Any:
    """Draw one part, thinned and with its gaps left open where x is linear; what the legend shows of it."""
    if isinstance(part, Band):
        t, low, high = extremes(*(broken(part.x, part.low, part.high) if linear else (part.x, part.low, part.high)))
        return ax.fill_between(x(t), low, high, color=part.hue, alpha=part.alpha, linewidth=0.0)
    if isinstance(part, Points):
        filled = "none" if part.marker == "D" else part.hue
        size = {".": 2.5, "o": 3.0}.get(part.marker, 4.0)
        return ax.plot(x(part.x), part.y, part.marker, color=part.hue, markerfacecolor=filled, markersize=size)[0]
    series = envelope(*broken(part.x, part.y)) if linear and not part.steps else (part.x, part.y)
    how: dict[str, Any] = {"color": part.hue, "linestyle": part.dash, "linewidth": part.width}
    return ax.plot(x(series[0]), series[1], drawstyle="steps-post" if part.steps else "default", **how)[0]


def _marked(ax: Axes, marks: list[Mark], clock: Clock) -> Any:
    """All marks of one label at once: there may be thousands."""
    begin, end = clock(np.array([[mark.begin_s, mark.end_s] for mark in marks])).T
    over: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "color": marks[0].hue}
    if (end > begin).any():
        spans = list(zip(begin, end - begin, strict=True))
        return ax.broken_barh(spans, (0.0, 1.0), alpha=0.13, linewidth=0, zorder=0, **over)
    return ax.vlines(begin, 0.0, 1.0, linewidth=0.7, alpha=0.8, zorder=1, **over)


def _scaled(ax: Axes, panel: Panel) -> None:
    if panel.log:
        ax.set_yscale("log")
    limits = extent(panel)
    if limits is not None:
        ax.set_ylim(*limits)
    if panel.ticks:
        ax.set_yticks(*zip(*panel.ticks, strict=True))


def _legend(ax: Axes, labels: list[str], handles: dict[str, Any], marks: tuple[Mark, ...]) -> None:
    labels = list(dict.fromkeys([*labels, *(mark.label for mark in marks)]))
    if labels:
        place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
        ax.legend([handles[label] for label in labels], map(no_formula, labels), ncols=min(len(labels), 4), **place)


def time_axis(ax: Axes, clock: Clock) -> None:
    """Name the time axis, and set its range and its ticks."""
    ax.set_xlabel(clock.label if clock.utc_s is None else f"{clock.label}, UTC")
    ax.set_xlim(*clock.range)
    ax.xaxis.set_major_formatter(clock.tick)


def svg(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    with style():
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    # matplotlib writes six digits, a line for each point, and the indentation of a book: half the size of a report.
    text = re.sub(rb"<!--.*?-->|<metadata>.*?</metadata>", b"", buffer.getvalue(), flags=re.DOTALL)
    text = re.sub(rb'<g id="[^"]*"', b"<g", re.sub(rb"\s+", b" ", text).replace(b"> <", b"><"))
    for k, name in enumerate(re.findall(rb' id="([mp][0-9a-f]{10})"', text)):
        text = text.replace(name, b"m%d" % k)
    # A style that many marks share stands once, about them.
    text = re.sub(rb'<use [^>]*( style="[^"]*")/>(?:<use [^>]*\1/>)+', _of_one_style, text)
    return re.sub(rb' (?:d|x|y)="[^"]*"', _shortened, text)


def _of_one_style(found: re.Match[bytes]) -> bytes:
    return b"<g%b>%b</g>" % (found[1], found[0].replace(found[1], b""))


def _shortened(found: re.Match[bytes]) -> bytes:
    """Coordinates with as many digits as a printer shows: tenths of a point, of small shapes hundredths; those of long
    lines as steps from point to point.
    """
    text = found.group()
    if len(text) < 400:
        return re.sub(rb"(\.\d\d)\d+", rb"\1", text)
    if not text.startswith(b' d="') or re.search(rb"[^-\d.MLdz=\" ]", text):
        return re.sub(rb"(\.\d)\d+", rb"\1", text)
    steps, x, y = [], 0, 0
    for letter, right, down in re.findall(rb"([MLz]) ?(?:([-\d.]+) ([-\d.]+))?", text):
        if letter == b"z":
            steps.append("z")
            continue
        new_x, new_y = round(10.0 * float(right)), round(10.0 * float(down))
        ahead = (new_x, new_y) if letter == b"M" else (new_x - x, new_y - y)
        if letter == b"M" or all(ahead):
            steps.append(f"{'M' if letter == b'M' else 'l'}{ahead[0] / 10:g} {ahead[1] / 10:g}")
        else:
            steps.append(f"{'v' if ahead[1] else 'h'}{sum(ahead) / 10:g}")
        x, y = new_x, new_y
    return re.sub(rb"(?<!\d)0\.", b".", f' d="{"".join(steps)}"'.encode()).replace(b" -", b"-")

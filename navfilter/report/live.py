"""Figures that can be zoomed, of the same description as those for print; `instrument.js` shows and links them."""

from typing import Any, NamedTuple

import numpy as np
from bokeh import __version__, models
from bokeh.document import Document
from bokeh.layouts import gridplot
from bokeh.plotting import figure

from navfilter.foundation.arrays import Array
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import LEVEL
from navfilter.rendering.panels import Band, Level, Mark, Panel, Part, Points, Stack, by_label, extent, legend_of
from navfilter.rendering.thinning import broken, envelope, extremes, straightened

#: A line gets two points for each of so many stretches before what is straight is left out.
STRETCHES = 1000
#: What is straight: within this share of the range that the panel shows.
STRAIGHT = 1e-3
PIXELS_PER_INCH = 96
#: Room for the numbers of the y axis, the same in all panels, so that they stand above one another [px].
LEFT = 72


class Key(NamedTuple):
    """One button of a legend: it hides and shows everything of this label."""

    label: str
    hue: str
    kind: str


class Live(NamedTuple):
    """A figure as it stands in the page.

    Attributes
    ----------
    item : dict
        As `item_of` makes it.
    keys : list of Key
    height_px : int
    """

    item: dict[str, Any]
    keys: list[Key]
    height_px: int


def plain(text: str) -> str:
    """Text that the drawing library takes for nothing but text: it would read formulas between these signs."""
    for sign in ("$$", "\\[", "\\("):
        text = text.replace(sign, "\N{ZERO WIDTH SPACE}".join(sign))
    return text


def item_of(model: Any) -> dict[str, Any]:
    """What ``Bokeh.embed.embed_item`` takes: as ``bokeh.embed.json_item`` makes it, which looks through all models four
    times more for what is not there (callbacks, another theme, another document).
    """
    document = Document(title="")
    document.add_root(model)
    content = document.to_json(deferred=False)
    return {"target_id": None, "root_id": content["roots"][0]["id"], "doc": content, "version": __version__}


def live_stack(stack: Stack, clock: Clock) -> Live:
    """The panels of a stack, one above the other, with one time axis.

    Parameters
    ----------
    stack : Stack
    clock : Clock
        Of the time axis.
    """
    over_time = not stack.x_label
    x_range = models.Range1d(*clock.range, name="time") if over_time else models.DataRange1d(range_padding=0.02)
    plots, keys, heights = [], [], []
    for row, panel in enumerate(stack.panels):
        last = row == len(stack.panels) - 1
        heights.append(_height(stack, row == 0 and over_time and clock.utc_s is not None, last))
        plot = _plot(stack, panel, x_range, heights[-1])
        for part in panel.parts:
            _drawn(plot, part, panel, clock if over_time else None)
        _scaled(plot, panel)
        if over_time:
            _marked(plot, stack.marks, clock)
            plot.add_layout(
                models.Span(dimension="height", name="cursor", level="overlay", line_alpha=0.7, visible=False)
            )
        if over_time and row == 0 and clock.utc_s is not None:
            _utc_axis(plot, clock)
        plot.xaxis[-1].axis_label = (stack.x_label or clock.label) if last else None
        if not last:
            plot.xaxis[-1].major_label_text_font_size = "0px"
        keys += [_key(part) for part in legend_of(stack, row)]
        plots.append(plot)
    keys += [Key(m.label, m.hue, "band" if m.end_s > m.begin_s else "line") for m in stack.marks]
    how: dict[str, Any] = {"sizing_mode": "stretch_width", "toolbar_location": "above"}
    grid = gridplot([[plot] for plot in plots], toolbar_options={"logo": None}, **how)
    return Live(item_of(grid), list(dict.fromkeys(keys)), sum(heights) + 40)


def _height(stack: Stack, utc: bool, last: bool) -> int:
    alone = 60 * (len(stack.panels) == 1)
    return int(stack.height_in * PIXELS_PER_INCH) + 45 * last + 55 * utc + alone


def toolbox(dimensions: str) -> dict[str, Any]:
    """Tools of a plot: drag a box to zoom, the wheel with Ctrl, pan, back, save."""
    box, wheel = (
        models.BoxZoomTool(dimensions=dimensions),
        models.WheelZoomTool(dimensions=dimensions, modifiers={"ctrl": True}),
    )
    tools = [box, wheel, models.PanTool(dimensions=dimensions), models.ResetTool(), models.SaveTool()]
    return {"tools": tools, "active_drag": box, "active_scroll": wheel}


def _plot(stack: Stack, panel: Panel, x_range: Any, height: int) -> Any:
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        x_range=x_range,
        y_range=_y_range(panel),
        x_axis_type="log" if stack.log_x else "linear",
        y_axis_type="log" if panel.log else "linear",
        y_axis_label=plain(panel.label),
        min_border_left=LEFT,
        min_border_right=14,
        min_border_top=4,
        min_border_bottom=4,
        lod_threshold=None,
        **toolbox("both" if stack.x_label else "width"),
    )
    if panel.limits is None and not stack.x_label:
        plot.window_axis = "x"
    plot.yaxis.axis_label_text_font_size = "12px"
    return plain_look(plot)


def plain_look(plot: Any) -> Any:
    """A plot without a frame, with upright labels and a grid that does not stand out."""
    plot.axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = "#e3e3e3"
    plot.outline_line_color = None
    return plot


def _y_range(panel: Panel) -> Any:
    """As the panel says, or that of what is in view."""
    if panel.limits is None:
        return models.DataRange1d(only_visible=True, range_padding=0.06)
    return models.Range1d(start=panel.limits[0], end=panel.limits[1])


def _utc_axis(plot: Any, clock: Clock) -> None:
    """A second time axis above; `instrument.js` keeps its range at offset + factor x that of the mission time."""
    factor = 1000.0 / clock.factor
    offset = 1000.0 * ((clock.utc_s or 0.0) + clock.zero_s)
    low, high = (offset + factor * x for x in clock.range)
    plot.extra_x_ranges = {"utc": models.Range1d(low, high, name="utc", tags=[offset, factor])}
    plot.add_layout(
        models.DatetimeAxis(x_range_name="utc", axis_label="UTC", axis_label_text_font_style="normal"), "above"
    )


def _scaled(plot: Any, panel: Panel) -> None:
    limits = extent(panel)
    if limits is not None and panel.limits is None and panel.shape == "from zero":
        plot.y_range.start = 0.0
    for y in panel.lines_at:
        plot.add_layout(models.Span(dimension="width", location=y, line_width=0.8, level="underlay"))
    if panel.level is not None:
        box = models.BoxAnnotation(bottom=panel.level.low, top=panel.level.high, fill_color=LEVEL, fill_alpha=0.4)
        box.update(line_color=None, level="underlay", name=panel.level.label)
        plot.add_layout(box)
    if panel.ticks:
        plot.yaxis.ticker = models.FixedTicker(ticks=[y for y, _ in panel.ticks])
        plot.yaxis.major_label_overrides = dict(panel.ticks)


def _drawn(plot: Any, part: Part, panel: Panel, clock: Clock | None) -> None:
    """Draw one part, thinned to what a screen shows at some zoom."""
    step = STRAIGHT * _height_of(panel)
    if isinstance(part, Band):
        x, low, high = part.x, part.low, part.high
        if clock is not None:
            x, low, high = broken(x, low, high)
            x, low, high = extremes(x, low, high, STRETCHES // 2)
        data = _source(x, clock, step, low=low, high=high)
        glyph = models.glyphs.VArea(x="x", y1="low", y2="high", fill_color=part.hue, fill_alpha=part.alpha)
    elif isinstance(part, Points):
        data = _source(part.x, clock, step, y=part.y)
        shape = {".": "circle", "o": "circle", "x": "x", "D": "diamond"}[part.marker]
        size, fill = {".": 3, "o": 5}.get(part.marker, 7), None if part.marker in "xD" else part.hue
        glyph = models.glyphs.Scatter(x="x", y="y", marker=shape, size=size, line_color=part.hue, fill_color=fill)
    else:
        x, y = part.x, part.y
        if clock is not None and not part.steps:
            x, y = broken(x, y)
            x, y = straightened(*envelope(x, y, STRETCHES), step)
        data = _source(x, clock, step, y=y)
        glyph = models.glyphs.Step(x="x", y="y", mode="after") if part.steps else models.glyphs.Line(x="x", y="y")
        glyph.update(line_color=part.hue, line_dash=_dashes(part.dash, part.width), line_width=1.3 * part.width)
    plot.add_glyph(data, glyph, name=part.label)


def _height_of(panel: Panel) -> float:
    """Range of y that a panel shows; 0 where it is logarithmic, so that nothing is left out."""
    if panel.log:
        return 0.0
    shown = extent(panel)
    if shown is None:
        values = [v for part in panel.parts for v in ((part.low, part.high) if isinstance(part, Band) else (part.y,))]
        finite = np.concatenate([v[np.isfinite(v)] for v in values]) if values else np.empty(0)
        shown = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    return shown[1] - shown[0]


def _source(x: Array, clock: Clock | None, step: float, **columns: Array) -> models.ColumnDataSource:
    """Columns in single precision, y in steps of less than a quarter of what a line may be off: both pack well."""
    shown = x if clock is None else clock(x)
    fine = 2.0 ** np.floor(np.log2(0.25 * step)) if step > 0.0 else 0.0
    rounded = {k: (np.round(v / fine) * fine if fine else v).astype(np.float32) for k, v in columns.items()}
    return models.ColumnDataSource({"x": shown.astype(np.float32), **rounded})


def _dashes(dash: Any, width: float) -> Any:
    return "solid" if dash == "-" else [max(1, round(1.5 * width * length)) for length in dash[1]]


def _marked(plot: Any, marks: tuple[Mark, ...], clock: Clock) -> None:
    """One glyph for each kind of mark, so that the legend hides it; its text appears below the pointer."""
    hovered = []
    for label, kind in by_label(marks).items():
        begin, end = clock(np.array([[m.begin_s, m.end_s] for m in kind])).T
        data = models.ColumnDataSource({"begin": begin, "end": end, "text": [m.text for m in kind]})
        hue = kind[0].hue
        if (end > begin).any():
            glyph = models.glyphs.VStrip(x0="begin", x1="end", fill_color=hue, fill_alpha=0.13, line_color=None)
        else:
            glyph = models.glyphs.VSpan(x="begin", line_color=hue, line_alpha=0.8, line_width=1.2)
        hovered.append(plot.add_glyph(data, glyph, name=label, level="underlay"))
    if hovered:
        plot.add_tools(models.HoverTool(renderers=hovered, tooltips=[("", "@text")], visible=False))


def _key(part: Part | Level) -> Key:
    if isinstance(part, Level):
        return Key(part.label, LEVEL, "band")
    if isinstance(part, Points):
        return Key(part.label, part.hue, {"x": "x", "D": "points diamond"}.get(part.marker, "points"))
    kind = "band" if isinstance(part, Band) else "dashed" if part.dash != "-" else "line"
    return Key(part.label, part.hue, kind)

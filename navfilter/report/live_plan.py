"""The plan view that can be zoomed: the track coloured by time, by its predicted rms, or by run."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from bokeh.models import (
    BasicTicker,
    BasicTickFormatter,
    ColorBar,
    ColumnDataSource,
    DataRange1d,
    LinearAxis,
    LinearColorMapper,
    LogColorMapper,
    Metric,
    Range1d,
    ScaleBar,
)
from bokeh.plotting import figure
from bokeh.transform import transform

from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import short
from navfilter.report.figures import TRUTH
from navfilter.report.live import Key, Live, item_of, plain, plain_look, toolbox
from navfilter.report.plan_view import CHART_ALPHA, Plan, PlanRun

#: By what the track may be coloured: name of the glyphs, and what the page calls it.
COLOURINGS = {"run": "run", "sd": "predicted rms", "time": "time"}
HEIGHT = 560
#: So many pieces of the coloured track, and points of a path.
PIECES = 1500
FIX, END = "#777777", "#000000"


def live_plan(plan: Plan, clock: Clock) -> Live:
    """The plan view; what `instrument.js` shows of it is chosen by name: "colour run", "colour sd", "colour time".

    Parameters
    ----------
    plan : Plan
    clock : Clock
        For the colours of time.
    """
    plot = _plot(plan)
    keys = []
    if plan.chart is not None:
        _chart(plot, plan)
        keys.append(Key("chart", "#999999", "band"))
    for name, fixes in plan.fixes.items():
        label = f"{short(name)} fixes used"
        east, north = fixes.T.astype(np.float32)
        plot.scatter(east, north, marker="cross", size=6, color=FIX, line_width=0.9, name=label, level="underlay")
        keys.append(Key(label, FIX, "cross"))
    for number, run in enumerate(plan.runs):
        hue, _ = colour(number)
        _path(plot, run, hue, plan.shape)
        keys.append(Key(run.label, hue, "line"))
    if len(plan.truth):
        east, north = plan.truth[:: max(1, len(plan.truth) // PIECES)].T.astype(np.float32)
        plot.line(east, north, color=TRUTH["hue"], line_dash="dotted", line_width=1.2, name="truth")
        keys.append(Key("truth", "#000000", "dashed"))
    _coloured(plot, plan.runs[-1], clock)
    last = plan.runs[-1]
    for k, marker, name in ((0, "circle", "start"), (-1, "square", "end")):
        plot.scatter(
            [last.east[k]], [last.north[k]], marker=marker, size=8, line_color=END, fill_color="white", name=name
        )
        keys.append(Key(name, END, f"points {marker}"))
    zoomed = ColumnDataSource({"x": [], "y": []})
    plot.line("x", "y", source=zoomed, line_color="#d7191c", line_width=4, line_alpha=0.5, name="zoomed")
    here = ColumnDataSource({"x": [], "y": []})
    plot.scatter("x", "y", source=here, size=13, line_color="#d7191c", line_width=2.5, fill_color=None, name="here")
    return Live(item_of(plot), [*keys, Key(plan.shape, "#555555", "points")], HEIGHT)


def _plot(plan: Plan) -> Any:
    plot = figure(
        height=HEIGHT,
        sizing_mode="stretch_width",
        match_aspect=True,
        x_range=DataRange1d(name="east"),
        y_range=DataRange1d(name="north"),
        x_axis_label="east [m]",
        y_axis_label="north [m]",
        min_border_right=14,
        lod_threshold=None,
        toolbar_location="above",
        **toolbox("both"),
    )
    plot.tools[0].match_aspect = True
    plot.toolbar.logo = None
    # Kept by the script at offset + factor x those of east and north.
    plot.extra_x_ranges = {"deg": Range1d(0, 1, name="longitude", tags=[plan.longitude_deg, plan.east_deg])}
    plot.extra_y_ranges = {"deg": Range1d(0, 1, name="latitude", tags=[plan.latitude_deg, plan.north_deg])}
    how = {"ticker": BasicTicker(desired_num_ticks=4), "formatter": BasicTickFormatter(use_scientific=False)}
    plot.add_layout(LinearAxis(x_range_name="deg", axis_label="longitude [deg]", **how), "above")
    plot.add_layout(LinearAxis(y_range_name="deg", axis_label="latitude [deg]", **how), "right")
    plain_look(plot)
    metric = Metric(base_unit="m", exclude=["dm", "dam", "hm"])
    bar = ScaleBar(range=plot.x_range, unit="m", dimensional=metric, location="bottom_left", bar_length=0.2)
    plot.add_layout(bar)
    return plot


def _chart(plot: Any, plan: Plan) -> None:
    """The chart under everything; the picture stands in the page."""
    assert plan.chart is not None
    west, east, south, north = plan.chart_edges()
    url = f"data:image/png;base64,{base64.b64encode(plan.chart.png).decode()}"
    where = [url], [west], [south], [east - west], [north - south]
    plot.image_url(*where, anchor="bottom_left", alpha=CHART_ALPHA, level="image", name="chart")


def _path(plot: Any, run: PlanRun, hue: str, shape: str) -> None:
    step = max(1, len(run.east) // PIECES)
    east, north = run.east[::step].astype(np.float32), run.north[::step].astype(np.float32)
    line = plot.line(east, north, color=hue, line_width=2, name=run.label)
    line.tags = ["colour run"]
    shapes = [(s.east, s.north, s.width, s.height, s.angle) for s in run.ellipses]
    columns = dict(zip(("x", "y", "width", "height", "angle"), map(list, zip(*shapes, strict=True)), strict=True))
    source = ColumnDataSource(columns)
    how: dict[str, Any] = {"line_color": hue, "fill_color": None, "name": shape, "level": "underlay"}
    plot.ellipse("x", "y", "width", "height", "angle", source=source, **how)


def _coloured(plot: Any, run: PlanRun, clock: Clock) -> None:
    """The result in pieces, once coloured by its predicted rms and once by time; hidden until asked for."""
    rows = np.unique(np.linspace(0, len(run.east) - 1, PIECES + 1).astype(int))
    east, north = run.east[rows].astype(np.float32), run.north[rows].astype(np.float32)
    rms, time = run.rms[rows].astype(np.float32), clock(run.time_s[rows]).astype(np.float32)
    columns = {"x0": east[:-1], "y0": north[:-1], "x1": east[1:], "y1": north[1:]}
    source = ColumnDataSource(columns | {"sd": rms[1:], "time": time[1:]})
    low, high = float(rms.min()), float(rms.max())
    # From centimetres with fixes to hundreds of metres without: equal colours for equal ratios.
    spread = high > 10.0 * low > 0.0
    mappers = {
        "sd": (LogColorMapper if spread else LinearColorMapper)(
            palette="Plasma256", low=low, high=max(high, low + 1e-6)
        ),
        "time": LinearColorMapper(palette="Viridis256", low=float(time[0]), high=float(time[-1])),
    }
    titles = {"sd": f"predicted rms of {run.label} [m]", "time": clock.label}
    for name, mapper in mappers.items():
        line = plot.segment(
            "x0", "y0", "x1", "y1", source=source, line_width=3, line_color=transform(name, mapper), visible=False
        )
        line.tags = [f"colour {name}"]
        bar = ColorBar(
            color_mapper=mapper, title=plain(titles[name]), height=10, visible=False, tags=[f"colour {name}"]
        )
        bar.update(orientation="horizontal", title_text_font_style="normal", padding=4)
        plot.add_layout(bar, "below")

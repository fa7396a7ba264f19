"""The figures of a page, each for print and live, and the script and data that make them live.

The plan view that can be zoomed: the track coloured by time, by its predicted rms, or by run.
"""

import base64
import gzip
import json
from collections.abc import Callable, Iterator, Mapping
from functools import cache
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
from bokeh.resources import Resources
from bokeh.transform import transform

from navfilter.foundation.arrays import Array, Ints
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import colour, draw, style, svg
from navfilter.rendering.page import Scripts, Section, escape, figure_html, resource
from navfilter.rendering.panels import Line, Panel, Stack, short
from navfilter.report.figures import TRUTH, drive_residuals, shown_states
from navfilter.report.live import Key, Live, item_of, live_stack, plain, plain_look, toolbox
from navfilter.report.plan_view import CHART_ALPHA, Plan, PlanRun, draw_plan
from navfilter.track.track import Track

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


ANY_HEIGHT = 380
#: What is shown until something else is chosen.
ANY_FIRST = ("travelled", "rms")
ANY = "Any quantity of the run against any other, at rows of the part that figures over time show."
#: The cursor knows the track at so many times.
ROWS = 2000


class Instrument:
    """Collects the figures of a page.

    Parameters
    ----------
    clock : Clock
        The time axis of all figures.
    track : Track
        What the cursor tells: place, depth, heading, speed.
    origin : Track
        Where the metres of the plan view begin.
    progress : callable, optional
        Called after each figure.
    """

    def __init__(self, clock: Clock, track: Track, origin: Track, progress: Callable[[], Any] | None = None) -> None:
        self.clock = clock
        self._rows, self._names = _rows(clock, track, origin)
        self._figures: list[dict[str, Any]] = []
        self._progress = progress

    def figure(self, what: Stack | Plan, caption: str) -> str:
        """HTML of one figure."""
        with style():
            if isinstance(what, Stack):
                drawn, live = svg(draw(what, self.clock)), live_stack(what, self.clock)
            else:
                drawn, live = svg(draw_plan(what)), live_plan(what, self.clock)
        return self._done(figure_html(drawn, caption, self._place(live, isinstance(what, Plan))))

    def _done(self, figure: str) -> str:
        if self._progress is not None:
            self._progress()
        return figure

    def _place(self, live: Live, plan: bool) -> str:
        number = len(self._figures)
        self._figures.append({"item": live.item, "keys": live.keys, "plan": plan})
        return (
            f'{_colouring() if plan else ""}<div class="keys"><span></span></div>'
            f'<div class="live" id="live-{number}" data-figure="{number}" style="min-height:{live.height_px}px"></div>'
        )

    def any_section(self) -> Section:
        """Any quantity of the run against any other; for print the predicted rms over the way."""
        shown = any_figure(self._rows)
        options = "".join(f'<option value="{escape(k)}">{escape(name)}</option>' for k, name in self._names.items())
        menus = "".join(
            f'<label>{side} <select class="any" data-axis="{side}">{options}</select></label>' for side in ("x", "y")
        )
        with style():
            drawn = svg(draw(shown, self.clock))
        place = f'<div class="choice">{menus}</div>{self._place(Live(any_item(), [], ANY_HEIGHT), False)}'
        return Section("Any against any", (self._done(figure_html(drawn, ANY, place)),))

    def scripts(self) -> Scripts:
        """What makes the figures of the page live."""
        clock = self.clock
        utc = None if clock.utc_s is None else 1000.0 * (clock.utc_s + clock.zero_s)
        about = {"unit": clock.unit, "factor": clock.factor, "range": clock.range, "utc": utc}
        figures = json.dumps(
            {"figures": self._figures, "rows": self._rows, "names": self._names, "clock": about}, separators=(",", ":")
        )
        data = f'{_packed("library", library())}{_packed("figures", figures)}<output id="readout"></output>'
        return Scripts((resource("instrument.js", "navfilter.report"),), library(), data)


@cache
def library() -> str:
    """The drawing library's own script, as its package ships it."""
    return "\n".join(Resources(mode="inline", components=["bokeh"], minified=True, log_level="error").js_raw)


def _packed(name: str, text: str) -> str:
    """Text that the script unpacks; a browser does not run it."""
    data = base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
    return f'<script type="application/gzip" id="{name}">{data}</script>\n'


def _colouring() -> str:
    chosen = "".join(
        f'<label><input type="radio" name="colouring" value="{key}"{" checked" if key == "run" else ""}> '
        f"{escape(text)}</label>"
        for key, text in COLOURINGS.items()
    )
    return f'<div class="choice">Colour by {chosen}</div>'


def _rows(clock: Clock, track: Track, origin: Track) -> tuple[dict[str, list[float | None]], dict[str, str]]:
    """Quantities of the run at some of its rows, and the names of those."""
    rows = np.unique(np.linspace(0, len(track) - 1, ROWS).astype(int))
    north, east = track.local(float(origin.latitude[0]), float(origin.longitude[0]))[rows, :2].T
    sd, speeds = np.sqrt(np.maximum(np.diagonal(track.covariance[rows], axis1=1, axis2=2), 0.0)), track.velocity_n[rows]
    columns = {
        "time": (clock.label, clock(track.time_s[rows]), 5),
        "east": ("east [m]", east, 2),
        "north": ("north [m]", north, 2),
        "latitude": ("latitude [deg]", np.degrees(track.latitude[rows]), 6),
        "longitude": ("longitude [deg]", np.degrees(track.longitude[rows]), 6),
        "depth": ("depth [m]", -track.height[rows], 2),
        "heading": ("heading [deg]", np.degrees(track.attitude[rows, 2]) % 360.0, 2),
        "speed": ("speed [m/s]", np.hypot(*speeds[:, :2].T), 3),
        "rms": ("predicted rms of the position [m]", track.horizontal_sd()[rows], 4),
        "travelled": ("distance travelled [m]", track.travelled()[rows], 2),
        "roll": ("roll [deg]", np.degrees(track.attitude[rows, 0]), 3),
        "pitch": ("pitch [deg]", np.degrees(track.attitude[rows, 1]), 3),
        **{f"v{i}": (f"velocity {a} [m/s]", speeds[:, i], 4) for i, a in enumerate(("north", "east", "down"))},
        "heading_sd": ("sd of the heading [deg]", np.degrees(sd[:, 8]), 4),
        "up_sd": ("sd of the height [m]", sd[:, 2], 4),
    }
    columns |= {f"state {n}": (f"{n} [{unit}]", v, 9) for n, unit, v in _states(track, rows)}
    columns |= {
        f"innovation {n}": (f"innovation of {n} [sd]", v, 3) for n, v in _innovations(track, track.time_s[rows])
    }
    columns |= {
        f"residual {owner} {axis}": (f"residual of {owner} {axis} [sd]", (step / sd)[rows], 3)
        for owner, axes in drive_residuals(track).items()
        for axis, step, sd, _ in axes
    }
    found = {key: np.round(values, digits).tolist() for key, (_, values, digits) in columns.items()}
    plain_rows = {key: [None if value != value else value for value in values] for key, values in found.items()}
    return plain_rows, {key: plain(name) for key, (name, _, _) in columns.items()}


def _states(track: Track, rows: Ints) -> Iterator[tuple[str, str, Array]]:
    """The states worth showing."""
    for state in shown_states(track.vehicle):
        if state.name in track.state_names:
            yield state.name, state.unit, state.factor * track.state(state.name)[0][rows]


def _innovations(track: Track, time_s: Array) -> Iterator[tuple[str, Array]]:
    """Of each axis of each sensor, the latest reading used at these times, in units of what was predicted."""
    for name, r in track.residuals.items():
        if name not in track.vehicle.sensors or not len(r.time_s):
            continue
        for axis, title in enumerate(track.vehicle.sensors[name].axis_names):
            known = np.isfinite(r.value[:, axis]) & (r.sd[:, axis] > 0.0) & np.isfinite(r.sd[:, axis])
            good = np.flatnonzero(known & r.used)
            if not good.size:
                continue
            last = np.searchsorted(r.time_s[good], time_s, side="right") - 1
            values = r.value[good, axis][last] / r.sd[good, axis][last]
            recent = (last >= 0) & (time_s - r.time_s[good][last] < 2.0 * max(1.0, np.median(np.diff(time_s))))
            yield f"{name} {title}".strip(), np.where(recent, values, np.nan)


def any_figure(rows: Mapping[str, list[float | None]]) -> Stack:
    """For print: the predicted rms over the way."""
    x, y = (np.array([np.nan if v is None else v for v in rows[key]], dtype=float) for key in ANY_FIRST)
    return Stack((Panel("predicted rms [m]", (Line(x, y, "", colour(0)[0]),)),), 2.2, x_label="distance travelled [m]")


def any_item() -> dict[str, Any]:
    """The live one, which `instrument.js` fills."""
    plot = figure(
        height=ANY_HEIGHT, sizing_mode="stretch_width", toolbar_location="above", lod_threshold=None, **toolbox("both")
    )
    plot.toolbar.logo = None
    source = ColumnDataSource({"x": [], "y": []})
    hue = colour(0)[0]
    plot.line("x", "y", source=source, line_color=hue, line_alpha=0.35, name="any")
    plot.scatter("x", "y", source=source, size=4, color=hue, fill_alpha=0.6, line_color=None, name="any")
    plain_look(plot)
    return item_of(plot)

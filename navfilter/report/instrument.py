"""The figures of a page, each for print and live, and the script and data that make them live.

The plan view that can be zoomed: the track coloured by time, by its predicted rms, or by run.

The track from above: runs, truth, fixes, ends and 95 % ellipses in metres from the first position, and the figure
for print.
"""

import base64
import gzip
import io
import json
import math
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bokeh import models
from bokeh.plotting import figure
from bokeh.resources import Resources
from bokeh.transform import transform
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from numpy.typing import NDArray
from PIL import Image

from navfilter.foundation.arrays import Array, Ints
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.mission import Mission, Stream
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import WIDTH_IN, colour, draw, no_formula, style, svg
from navfilter.rendering.page import Scripts, Section, escape, figure_html, resource
from navfilter.rendering.panels import Line, Panel, Stack, short
from navfilter.report.figures import TRUTH, capped, drive_residuals, shown_states
from navfilter.report.live import Key, Live, item_of, live_stack, plain, plain_look, toolbox
from navfilter.track.track import Track, Tracks

#: Half axes of an ellipse that holds 95 % of a plane Gaussian, in standard deviations.
ELLIPSE_95 = float(np.sqrt(chi_square_limit(0.95, 2)))
#: So many points of a path are drawn.
POINTS = 4000
#: Axes of an ellipse that differ by less than this share make a circle.
ROUND = 0.05
#: A chart is paler than what stands on it [1].
CHART_ALPHA = 0.75
_PLACE = ("latitude", "longitude")
#: Pixels of a tile, and so many tiles at most make a chart.
TILE, MOST_TILES = 256, 24
#: No tile is larger [pixel], or read from more than this [bytes].
LARGEST_TILE, LARGEST_FILE = 2048, 16 << 20
#: Around the track there is so much more of the chart, of its larger extent [1], but not less than this [m].
MARGIN, LEAST_M = 0.15, 50.0
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")

Read = Callable[[int, int, int], bytes | None]


@dataclass(frozen=True)
class Shape:
    """An ellipse: centre and full axes [m], and its turn from east to north [rad]."""

    east: float
    north: float
    width: float
    height: float
    angle: float


@dataclass(frozen=True, eq=False)
class PlanRun:
    """One run from above: time [s], east and north [m] and predicted rms [m], shape (n,), and ellipses."""

    label: str
    time_s: Array
    east: Array
    north: Array
    rms: Array
    ellipses: tuple[Shape, ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """What the plan view shows.

    Attributes
    ----------
    runs : tuple of PlanRun
        The result last.
    truth : ndarray, shape (n, 2)
        East, north [m]; of no rows where there is none.
    fixes : dict of str to ndarray, shape (n, 2)
        Those that were used, by sensor.
    latitude_deg, longitude_deg : float
        Of the zero point.
    north_deg, east_deg : float
        Degrees of latitude and longitude per metre there.
    chart : Chart or None
        Under the track.
    """

    runs: tuple[PlanRun, ...]
    truth: Array
    fixes: dict[str, Array]
    latitude_deg: float
    longitude_deg: float
    north_deg: float
    east_deg: float
    chart: "Chart | None" = None

    @property
    def shape(self) -> str:
        """What holds the vehicle with 95 %: as long as they look like circles, these are called so."""
        all_round = all(abs(s.width - s.height) < ROUND * s.width for run in self.runs for s in run.ellipses)
        return "95 % circle" if all_round else "95 % ellipse"

    def chart_edges(self) -> tuple[float, float, float, float]:
        """Of the chart, west, east, south, north [m] from the zero point."""
        assert self.chart is not None
        sides = [(deg - self.longitude_deg) / self.east_deg for deg in (self.chart.west, self.chart.east)]
        ends = [(deg - self.latitude_deg) / self.north_deg for deg in (self.chart.south, self.chart.north)]
        return sides[0], sides[1], ends[0], ends[1]


def plan_view(
    tracks: Tracks, mission: Mission, ellipses: int = 16, tiles: str | os.PathLike[str] | None = None
) -> Plan:
    """Collect what the plan view shows.

    Parameters
    ----------
    tracks : dict of str to Track
    mission : Mission
        For truth and fixes.
    ellipses : int
        About so many per run, at equal steps of time.
    tiles : path-like, optional
        For a chart under the track, see `navfilter.report.instrument.chart_of`.
    """
    first = next(iter(tracks.values()))
    origin = (float(first.latitude[0]), float(first.longitude[0]))
    fixes = {
        name: capped(_used_fixes(first, mission.streams[name], name, origin))
        for name, sensor in first.vehicle.sensors.items()
        if sensor.gives == "position" and name in mission.streams
    }
    true = np.empty((0, 2))
    if mission.truth is not None:
        true = _local(mission.truth, origin, (first.time_s[0], first.time_s[-1]))
    step = 1e-5
    per_rad = _metres(np.array([[origin[0] + step, origin[1] + step]]), origin)[0] / step
    chart = None
    if tiles is not None:
        latitude, longitude = (np.degrees(np.concatenate([getattr(t, a) for t in tracks.values()])) for a in _PLACE)
        chart = chart_of(Path(tiles), latitude.min(), longitude.min(), latitude.max(), longitude.max())
    return Plan(
        tuple(_run(label, track, origin, ellipses) for label, track in tracks.items()),
        true[:: max(1, len(true) // POINTS)],
        fixes,
        latitude_deg=float(np.degrees(origin[0])),
        longitude_deg=float(np.degrees(origin[1])),
        north_deg=float(np.degrees(1.0 / per_rad[1])),
        east_deg=float(np.degrees(1.0 / per_rad[0])),
        chart=chart,
    )


def _run(label: str, track: Track, origin: tuple[float, float], ellipses: int) -> PlanRun:
    north, east = track.local(*origin)[:, :2].T
    rows = np.unique(np.linspace(0, len(track) - 1, ellipses).astype(int))
    shapes = tuple(_ellipse(east[k], north[k], track.covariance[k, :2, :2]) for k in rows)
    thin = slice(None, None, max(1, len(track) // POINTS))
    return PlanRun(label, track.time_s[thin], east[thin], north[thin], track.horizontal_sd()[thin], shapes)


def _ellipse(east: float, north: float, P: Array) -> Shape:
    variance, axes = np.linalg.eigh(P[::-1, ::-1])  # east, north
    width, height = 2 * ELLIPSE_95 * np.sqrt(np.maximum(variance, 0.0))
    return Shape(float(east), float(north), float(width), float(height), float(np.arctan2(axes[1, 0], axes[0, 0])))


def _metres(place: Array, origin: tuple[float, float]) -> Array:
    """East, north [m] of latitudes and longitudes [rad], shape (n, 2)."""
    from navfilter.io.geodesy import local_enu

    return local_enu(np.column_stack([place, np.zeros(len(place))]), (*origin, 0.0))[:, :2]


def _local(stream: Stream, origin: tuple[float, float], between: tuple[float, float]) -> Array:
    """East, north [m] of the known positions of a stream within a time."""
    known = np.isfinite(stream.value[:, :2]).all(axis=1) & (stream.time_s >= between[0]) & (stream.time_s <= between[1])
    return _metres(stream.value[known, :2], origin)


def _used_fixes(track: Track, stream: Stream, name: str, origin: tuple[float, float]) -> Array:
    used = stream
    if name in track.residuals:
        r = track.residuals[name]
        used = stream.keep(np.isin(stream.time_s, r.time_s[r.used]))
    return _local(used, origin, (track.time_s[0], track.time_s[-1]))


# --- for print ------------------------------------------------------------------------------------------------------


def draw_plan(plan: Plan) -> Figure:
    """Plan view, north over east with equal axes, with degrees and a scale bar."""
    east, north = (np.ptp(np.concatenate([getattr(r, axis) for r in plan.runs])) + 1.0 for axis in ("east", "north"))
    height = float(np.clip(WIDTH_IN * 0.9 * north / east, 3.2, 7.0)) + 0.7
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    ax = figure.subplots()
    if plan.chart is not None:
        ax.imshow(plan.chart.picture, extent=plan.chart_edges(), zorder=0, alpha=CHART_ALPHA)
    for name, fixes in plan.fixes.items():
        cross: dict[str, Any] = {"color": "#888888", "markersize": 4, "markeredgewidth": 0.7, "zorder": 1.5}
        ax.plot(*fixes.T, "+", label=f"{short(name)} fixes used", **cross)
    for number, run in enumerate(plan.runs):
        hue, dash = colour(number)
        ax.plot(run.east, run.north, color=hue, linestyle=dash, label=run.label, zorder=2.0 + number, linewidth=1.6)
        for s in run.ellipses:
            shape = Ellipse((s.east, s.north), s.width, s.height, angle=float(np.degrees(s.angle)))
            shape.set(edgecolor=hue, facecolor="none", linewidth=0.8, linestyle=dash, zorder=2.0 + number)
            ax.add_patch(shape)
    if len(plan.truth):
        ax.plot(*plan.truth.T, color=TRUTH["hue"], linestyle=TRUTH["dash"], linewidth=1.0, label="truth", zorder=9)
    last = plan.runs[-1]
    for k, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        white: dict[str, Any] = {"color": "black", "markersize": 5, "markerfacecolor": "white", "zorder": 10}
        ax.plot(last.east[k], last.north[k], marker, label=name, **white)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    _degrees(ax, plan)
    _scale_bar(ax)
    handles, labels = ax.get_legend_handles_labels()
    handles.append(Line2D([], [], marker="o", linestyle="", markerfacecolor="none", color="#555555"))
    ax.legend(
        handles, [*map(no_formula, labels), plan.shape], loc="best", frameon=True, framealpha=0.85, edgecolor="none"
    )
    return figure


def _degrees(ax: Axes, plan: Plan) -> None:
    """Longitude above and latitude on the right."""

    def both(zero: float, per_m: float) -> tuple[Any, Any]:
        return lambda m: zero + per_m * m, lambda deg: (deg - zero) / per_m

    above = ax.secondary_xaxis("top", functions=both(plan.longitude_deg, plan.east_deg))
    right = ax.secondary_yaxis("right", functions=both(plan.latitude_deg, plan.north_deg))
    above.set_xlabel("longitude [deg]")
    right.set_ylabel("latitude [deg]")
    for axis in (above.xaxis, right.yaxis):
        axis.set_major_locator(MaxNLocator(5))
        axis.set_major_formatter(ScalarFormatter(useOffset=False))
        axis.set_tick_params(labelsize=7.0)


def _round_length(width_m: float) -> float:
    """A round length [m], about a fifth of a width."""
    fifth = 0.25 * width_m
    decade = 10.0 ** np.floor(np.log10(fifth))
    return float(decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= fifth))


def _scale_bar(ax: Axes) -> None:
    low, high = ax.get_xlim()
    length = _round_length(high - low)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    bar = AnchoredSizeBar(ax.transData, length, text, "lower left", frameon=False, size_vertical=0.0)
    ax.add_artist(bar)


# --- a chart under the track -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Chart:
    """A picture and where it lies.

    Attributes
    ----------
    picture : ndarray of uint8, shape (rows, columns, 3)
        North above, rows at equal steps of latitude.
    png : bytes
        The same.
    west, east, south, north : float
        Its edges [deg].
    """

    picture: NDArray[np.uint8]
    png: bytes
    west: float
    east: float
    south: float
    north: float


def check_tiles(path: Path) -> None:
    """Refuse before a long run what holds no tiles.

    Raises
    ------
    ValueError
        For no file ``.mbtiles`` and no folder with ``zoom/x/y.png``.
    """
    if not _zooms(path):
        raise ValueError(
            f"{path} holds no tiles: give a .mbtiles file, or a folder with zoom/x/y.png (or .jpg, .webp)."
        )


def chart_of(path: Path, south: float, west: float, north: float, east: float) -> Chart | None:
    """The chart around a track.

    Parameters
    ----------
    path : Path
        An .mbtiles file, or a folder with tiles as ``zoom/x/y.png`` in Web Mercator.
    south, west, north, east : float
        Extent of the track [deg].

    Returns
    -------
    Chart or None
        None where the tiles hold nothing of this place.
    """
    per_m = 1.0 / 111_320.0
    wide = (
        max((north - south), (east - west) * math.cos(math.radians(south)), LEAST_M * per_m) * MARGIN + LEAST_M * per_m
    )
    south, north = south - wide, north + wide
    wide /= max(math.cos(math.radians(0.5 * (south + north))), 0.05)
    west, east = west - wide, east + wide
    read, zooms = _reader(path), _zooms(path)
    for zoom in sorted(zooms, reverse=True):
        (left, top), (right, bottom) = _tile(west, north, zoom), _tile(east, south, zoom)
        columns, rows = range(int(left), int(right) + 1), range(int(top), int(bottom) + 1)
        if len(columns) * len(rows) > MOST_TILES:
            continue
        whole, found = Image.new("RGB", (TILE * len(columns), TILE * len(rows)), "white"), False
        for i, x in enumerate(columns):
            for j, y in enumerate(rows):
                tile = _image(read(zoom, x % (1 << zoom), y))
                if tile is not None:
                    found = True
                    whole.paste(tile, (TILE * i, TILE * j))
        if found:
            box = [TILE * (left - columns[0]), TILE * (top - rows[0]), TILE * (right - columns[0])]
            cut = np.asarray(whole)[:, round(box[0]) : max(round(box[2]), round(box[0]) + 1)]
            # rows of Web Mercator -> rows at equal steps of latitude
            latitude = np.linspace(north, south, max(2, round(TILE * (bottom - top))))
            at = TILE * (np.array([_tile(west, one, zoom)[1] for one in latitude]) - rows[0])
            picture = np.ascontiguousarray(cut[np.clip(at.astype(int), 0, len(cut) - 1)])
            file = io.BytesIO()
            Image.fromarray(picture).save(file, "PNG", optimize=True)
            return Chart(picture, file.getvalue(), west, east, south, north)
    return None


def _tile(longitude: float, latitude: float, zoom: int) -> tuple[float, float]:
    """Column and row of a place, with the fraction inside the tile."""
    phi = math.radians(min(max(latitude, -85.05), 85.05))
    across = (longitude + 180.0) / 360.0
    down = 0.5 - math.asinh(math.tan(phi)) / (2.0 * math.pi)
    return across * (1 << zoom), down * (1 << zoom)


def _image(data: bytes | None) -> Image.Image | None:
    """A tile in its size; None for what is none."""
    if not data or len(data) > LARGEST_FILE:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as tile:
            return tile.convert("RGBA").resize((TILE, TILE)).convert("RGB") if max(tile.size) <= LARGEST_TILE else None
    except (OSError, ValueError, SyntaxError):
        return None


def _zooms(path: Path) -> list[int]:
    if path.is_dir():
        return [
            int(each.name) for each in path.iterdir() if each.is_dir() and each.name.isdecimal() and int(each.name) < 25
        ]
    try:
        with _database(path) as file:
            return [int(zoom) for (zoom,) in file.execute("SELECT DISTINCT zoom_level FROM tiles")]
    except sqlite3.Error:
        return []


def _database(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)


def _reader(path: Path) -> Read:
    if path.is_dir():

        def of_folder(zoom: int, x: int, y: int) -> bytes | None:
            for suffix in SUFFIXES:
                file = path / str(zoom) / str(x) / f"{y}{suffix}"
                if file.is_file():
                    return file.read_bytes()
            return None

        return of_folder

    def of_database(zoom: int, x: int, y: int) -> bytes | None:
        asked = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        with _database(path) as file:  # rows of this format are counted from the south
            found = file.execute(asked, (zoom, x, (1 << zoom) - 1 - y)).fetchone()
        return None if found is None else bytes(found[0])

    return of_database


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
    zoomed = models.ColumnDataSource({"x": [], "y": []})
    plot.line("x", "y", source=zoomed, line_color="#d7191c", line_width=4, line_alpha=0.5, name="zoomed")
    here = models.ColumnDataSource({"x": [], "y": []})
    plot.scatter("x", "y", source=here, size=13, line_color="#d7191c", line_width=2.5, fill_color=None, name="here")
    return Live(item_of(plot), [*keys, Key(plan.shape, "#555555", "points")], HEIGHT)


def _plot(plan: Plan) -> Any:
    plot = figure(
        height=HEIGHT,
        sizing_mode="stretch_width",
        match_aspect=True,
        x_range=models.DataRange1d(name="east"),
        y_range=models.DataRange1d(name="north"),
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
    plot.extra_x_ranges = {"deg": models.Range1d(0, 1, name="longitude", tags=[plan.longitude_deg, plan.east_deg])}
    plot.extra_y_ranges = {"deg": models.Range1d(0, 1, name="latitude", tags=[plan.latitude_deg, plan.north_deg])}
    how = {
        "ticker": models.BasicTicker(desired_num_ticks=4),
        "formatter": models.BasicTickFormatter(use_scientific=False),
    }
    plot.add_layout(models.LinearAxis(x_range_name="deg", axis_label="longitude [deg]", **how), "above")
    plot.add_layout(models.LinearAxis(y_range_name="deg", axis_label="latitude [deg]", **how), "right")
    plain_look(plot)
    metric = models.Metric(base_unit="m", exclude=["dm", "dam", "hm"])
    bar = models.ScaleBar(range=plot.x_range, unit="m", dimensional=metric, location="bottom_left", bar_length=0.2)
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
    source = models.ColumnDataSource(columns)
    how: dict[str, Any] = {"line_color": hue, "fill_color": None, "name": shape, "level": "underlay"}
    plot.ellipse("x", "y", "width", "height", "angle", source=source, **how)


def _coloured(plot: Any, run: PlanRun, clock: Clock) -> None:
    """The result in pieces, once coloured by its predicted rms and once by time; hidden until asked for."""
    rows = np.unique(np.linspace(0, len(run.east) - 1, PIECES + 1).astype(int))
    east, north = run.east[rows].astype(np.float32), run.north[rows].astype(np.float32)
    rms, time = run.rms[rows].astype(np.float32), clock(run.time_s[rows]).astype(np.float32)
    columns = {"x0": east[:-1], "y0": north[:-1], "x1": east[1:], "y1": north[1:]}
    source = models.ColumnDataSource(columns | {"sd": rms[1:], "time": time[1:]})
    low, high = float(rms.min()), float(rms.max())
    # From centimetres with fixes to hundreds of metres without: equal colours for equal ratios.
    spread = high > 10.0 * low > 0.0
    mappers = {
        "sd": (models.LogColorMapper if spread else models.LinearColorMapper)(
            palette="Plasma256", low=low, high=max(high, low + 1e-6)
        ),
        "time": models.LinearColorMapper(palette="Viridis256", low=float(time[0]), high=float(time[-1])),
    }
    titles = {"sd": f"predicted rms of {run.label} [m]", "time": clock.label}
    for name, mapper in mappers.items():
        line = plot.segment(
            "x0", "y0", "x1", "y1", source=source, line_width=3, line_color=transform(name, mapper), visible=False
        )
        line.tags = [f"colour {name}"]
        bar = models.ColorBar(
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
    source = models.ColumnDataSource({"x": [], "y": []})
    hue = colour(0)[0]
    plot.line("x", "y", source=source, line_color=hue, line_alpha=0.35, name="any")
    plot.scatter("x", "y", source=source, size=4, color=hue, fill_alpha=0.6, line_color=None, name="any")
    plain_look(plot)
    return item_of(plot)

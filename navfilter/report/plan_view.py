"""The track from above: runs, truth, fixes, ends and 95 % ellipses in metres from the first position, and the figure
for print.
"""

import io
import math
import os
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from numpy.typing import NDArray
from PIL import Image

from navfilter.foundation.arrays import Array
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.mission import Mission, Stream
from navfilter.rendering.drawing import WIDTH_IN, colour, no_formula
from navfilter.rendering.panels import short
from navfilter.report.figures import TRUTH, capped
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
        For a chart under the track, see `navfilter.report.plan_view.chart_of`.
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

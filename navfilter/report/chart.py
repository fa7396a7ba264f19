"""A chart or map under the track, put together from tiles on the disk: nothing is loaded from anywhere."""

from __future__ import annotations

import io
import math
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

#: Pixels of a tile, and so many tiles at most make a chart.
TILE, MOST_TILES = 256, 24
#: No tile is larger [pixel], or read from more than this [bytes].
LARGEST_TILE, LARGEST_FILE = 2048, 16 << 20
#: Around the track there is so much more of the chart, of its larger extent [1], but not less than this [m].
MARGIN, LEAST_M = 0.15, 50.0
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")

Read = Callable[[int, int, int], bytes | None]


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

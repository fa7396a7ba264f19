"""track.shp and track.gpkg for GIS and charting software: the line of the track, and its rows as points with sds."""

import sqlite3
import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arrays import Array
from navfilter.foundation.atomic_files import pieces, replaced_by
from navfilter.io.tracks.geojson import degrees_east
from navfilter.models.mission import Mission
from navfilter.track.track import Track

#: Columns of the points: name (ten characters, as dBase has them), decimals.
_POINTS = {"time_s": 3, "height_m": 3, "depth_m": 3, "heading": 3, "speed_m_s": 3, "sd_north": 4, "sd_east": 4}
_POINTS |= {"sd_down": 4}
#: Longitude and latitude in degrees on WGS-84, as .prj files say it.
_WGS84 = (
    'GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],'
    'UNIT["Degree",0.0174532925199433]]'
)
_EPSG, _GPKG_VERSION, _GPKG_ID = 4326, 10300, 0x47504B47
_LINE_Z, _POINT_Z = 1002, 1001


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """By the ending."""
    (_write_shapefiles if path.suffix.lower() == ".shp" else _write_geopackage)(track, path)


def _places(track: Track) -> Array:
    """Longitude, latitude [deg], height [m] of each row."""
    return np.column_stack([degrees_east(track.longitude), np.degrees(track.latitude), track.height])


def _parts(places: Array) -> list[Array]:
    """The line, cut where it goes across the antimeridian."""
    cuts = np.flatnonzero(np.abs(np.diff(places[:, 0])) > 180.0) + 1
    return [part for part in np.split(places, cuts) if len(part) > 1]


def _rows(track: Track) -> Iterator[tuple[list[float], list[float | str | None]]]:
    """Place, and what stands beside it: the columns of `_POINTS`, and UTC or None."""
    places = _places(track)
    for rows in pieces(len(track)):
        part = track.keep(rows)
        sd = np.sqrt(np.maximum(np.diagonal(part.covariance[:, :3, :3], axis1=1, axis2=2), 0.0))
        heading, speed = np.degrees(part.attitude[:, 2]) % 360.0, np.hypot(*part.velocity_n[:, :2].T)
        values = np.column_stack([part.time_s, part.height, -part.height, heading, speed, sd])
        dates = [None] * len(part)
        if track.epoch_utc_s is not None:
            dates = utc.text(part.time_s, track.epoch_utc_s, "ms").tolist()
        for place, row, date in zip(places[rows].tolist(), values.tolist(), dates, strict=True):
            yield place, [*row, date]


# --- shapefiles -----------------------------------------------------------------------------------------------------


def _write_shapefiles(track: Track, path: Path) -> None:
    """The line, and beside it the points as NAME_points.shp."""
    import shapefile

    with replaced_by(path.parent) as beside:
        line, points = beside / path.stem, beside / f"{path.stem}_points"
        with shapefile.Writer(str(line), shapeType=shapefile.POLYLINEZ) as writer:
            writer.field("mission", "C", 80)
            writer.field("vehicle", "C", 80)
            writer.field("distance_m", "N", 18, 3)
            parts = [part.tolist() for part in _parts(_places(track))]
            writer.linez(parts) if parts else writer.null()
            writer.record(track.mission_name[:80], track.vehicle.name[:80], track.distance_m)
        with shapefile.Writer(str(points), shapeType=shapefile.POINTZ) as writer:
            for name, decimals in _POINTS.items():
                writer.field(name, "N", 18, decimals)
            writer.field("time_utc", "C", 24)
            for place, row in _rows(track):
                writer.pointz(*place)
                writer.record(*row[:-1], row[-1] or "")
        for part in (line, points):
            part.with_suffix(".prj").write_text(_WGS84, encoding="ascii")


# --- GeoPackage -----------------------------------------------------------------------------------------------------

_TABLES = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
    organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
    description TEXT DEFAULT '', last_change DATETIME NOT NULL, min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
    srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys(srs_id),
    z TINYINT NOT NULL, m TINYINT NOT NULL, PRIMARY KEY (table_name, column_name));
CREATE TABLE track (fid INTEGER PRIMARY KEY, geom BLOB, mission TEXT, vehicle TEXT, label TEXT, distance_m DOUBLE);
"""


def _write_geopackage(track: Track, path: Path) -> None:
    """Layers "track" (lines) and "points", as the OGC's standard 12-128r19 has them."""
    places = _places(track)
    with replaced_by(path.parent) as beside:
        file = sqlite3.connect(beside / path.name)
        try:
            _fill(file, track, places)
            file.commit()
        finally:
            file.close()


def _fill(file: sqlite3.Connection, track: Track, places: Array) -> None:
    file.execute(f"PRAGMA application_id = {_GPKG_ID}")
    file.execute(f"PRAGMA user_version = {_GPKG_VERSION}")
    columns = ", ".join(f"{name} DOUBLE" for name in _POINTS)
    file.executescript(_TABLES)
    file.execute(f"CREATE TABLE points (fid INTEGER PRIMARY KEY, geom BLOB, {columns}, time_utc DATETIME)")
    systems = [
        ("Undefined Cartesian", -1, "NONE", -1, "undefined", None),
        ("Undefined geographic", 0, "NONE", 0, "undefined", None),
        ("WGS 84", _EPSG, "EPSG", _EPSG, _WGS84, None),
    ]
    file.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?,?,?,?,?,?)", systems)
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")
    low, high = places[:, :2].min(axis=0).tolist(), places[:, :2].max(axis=0).tolist()
    for layer, kind in (("track", "LINESTRING"), ("points", "POINT")):
        file.execute(
            "INSERT INTO gpkg_contents VALUES (?,'features',?,'',?,?,?,?,?,?)", (layer, layer, now, *low, *high, _EPSG)
        )
        file.execute("INSERT INTO gpkg_geometry_columns VALUES (?,'geom',?,?,1,0)", (layer, kind, _EPSG))
    for part in _parts(places):
        shape = struct.pack("<BII", 1, _LINE_Z, len(part)) + part.astype("<f8").tobytes()
        own = track.mission_name, track.vehicle.name, track.label, track.distance_m
        file.execute("INSERT INTO track VALUES (NULL,?,?,?,?,?)", (_blob(shape), *own))
    marks = ",".join("?" * (len(_POINTS) + 2))
    rows = ((_blob(struct.pack("<BI3d", 1, _POINT_Z, *place)), *row) for place, row in _rows(track))
    file.executemany(f"INSERT INTO points VALUES (NULL,{marks})", rows)


def _blob(shape: bytes) -> bytes:
    """A shape with the head that the standard puts before it: version 0, little endian, no envelope."""
    return b"GP" + struct.pack("<BBi", 0, 1, _EPSG) + shape

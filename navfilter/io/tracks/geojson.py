"""track.geojson: track, truth and position fixes for a map (RFC 7946: longitude, latitude, height).

Beside the coordinates of the track, and in the same order, stand ``time_s``, ``sd_north_m``, ``sd_east_m``,
``sd_down_m``, and ``coordTimes`` where UTC is known (the name that converters from KML and GPX have made usual).
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arrays import AnyArray, Array, Ints
from navfilter.foundation.atomic_files import replacing
from navfilter.models.mission import Mission
from navfilter.models.state import wrap
from navfilter.track.track import Track

#: A line on a map needs no more points than this.
_MAP_POINTS = 4000


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track, and of the mission its truth and fixes."""
    features = [_track(track), *(() if mission is None else _beside(track, mission))]
    content = {"type": "FeatureCollection", "features": features}
    with replacing(path) as file:
        json.dump(content, file, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _beside(track: Track, mission: Mission) -> Iterator[dict[str, Any]]:
    if mission.truth is not None:
        known = mission.truth.value[np.isfinite(mission.truth.value[:, :2]).all(axis=1), :3]
        if len(known) > 1:
            yield _line(known, {"name": "truth", "mission": mission.name, "stroke": "#000000"}, {})
    for name, sensor in track.vehicle.sensors.items():
        if sensor.gives == "position" and name in mission.streams:
            yield _fixes(name, mission)


def _track(track: Track) -> dict[str, Any]:
    about: dict[str, Any] = {
        "name": track.label,
        "mission": track.mission_name,
        "vehicle": track.vehicle.name,
        "begin_s": float(track.time_s[0]),
        "end_s": float(track.time_s[-1]),
        "begin_utc": utc.date_text(track.time_s[0], track.epoch_utc_s),
        "end_utc": utc.date_text(track.time_s[-1], track.epoch_utc_s),
        "distance_m": round(track.distance_m, 3),
        "stroke": "#0072b2",
    }
    rows = _thinned(len(track))
    sd = np.sqrt(np.diagonal(track.covariance[rows, :3, :3], axis1=1, axis2=2))
    beside: dict[str, AnyArray] = _times(track.time_s[rows], track.epoch_utc_s)
    beside |= {f"sd_{axis}_m": sd[:, i].round(4) for i, axis in enumerate(("north", "east", "down"))}
    return _line(np.column_stack([track.latitude, track.longitude, track.height])[rows], about, beside)


def _fixes(name: str, mission: Mission) -> dict[str, Any]:
    stream = mission.streams[name]
    known = np.flatnonzero(np.isfinite(stream.value[:, :2]).all(axis=1))
    rows = known[_thinned(len(known))]
    beside = {key: cells.tolist() for key, cells in _times(stream.time_s[rows], mission.epoch_utc_s).items()}
    shape = {"type": "MultiPoint", "coordinates": _coordinates(stream.value[rows, :3])}
    return {"type": "Feature", "properties": {"name": name, "mission": mission.name, **beside}, "geometry": shape}


def _times(time_s: Array, epoch_utc_s: float | None) -> dict[str, AnyArray]:
    times: dict[str, AnyArray] = {"time_s": time_s.round(6)}
    return times if epoch_utc_s is None else times | {"coordTimes": utc.text(time_s, epoch_utc_s, "ms")}


def _line(place: Array, properties: dict[str, Any], beside: dict[str, AnyArray]) -> dict[str, Any]:
    """A line of places, with a list for each of `beside` that has one element per place."""
    if not beside:
        place = place[_thinned(len(place))]
    # A line across the antimeridian is cut there (RFC 7946, 3.1.9), or it would run round the Earth.
    cuts = np.flatnonzero(np.abs(np.diff(wrap(place[:, 1]))) > np.pi) + 1
    parts = [part for part in np.split(np.arange(len(place)), cuts) if len(part) > 1]
    lines = [_coordinates(place[part]) for part in parts]
    one = len(parts) == 1
    for name, cells in beside.items():
        split = [cells[part].tolist() for part in parts]
        properties[name] = split[0] if one else split
    shape = {"type": "LineString" if one else "MultiLineString", "coordinates": lines[0] if one else lines}
    return {"type": "Feature", "properties": properties, "geometry": shape}


def _thinned(rows: int) -> Ints:
    return np.linspace(0, rows - 1, min(rows, _MAP_POINTS)).astype(int)


def degrees_east(longitude: Array) -> Array:
    """Longitudes [rad] in degrees, from -180 to 180."""
    return np.degrees(wrap(longitude))


def _coordinates(place: Array) -> list[list[float]]:
    degrees = np.column_stack([degrees_east(place[:, 1]), np.degrees(place[:, 0])]).round(8).tolist()
    return [
        [*pair, round(h, 3)] if math.isfinite(h) else pair
        for pair, h in zip(degrees, place[:, 2].tolist(), strict=True)
    ]

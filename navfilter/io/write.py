"""The files of a run: track.csv, track.tum, truth.tum, track.geojson, summary.json, and vehicle_learned.toml where it
learnt.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from navfilter.io.geodesy import ecef_from_geodetic, matrix_from_euler, ned_axes
from navfilter.io.learned_toml import write_learned
from navfilter.learning.learned import learned_part
from navfilter.mission import Mission, Stream
from navfilter.track import Track
from navfilter.vehicle import Vehicle

__all__ = [
    "labelled",
    "learned_vehicle",
    "local_enu",
    "summarise",
    "write_csv",
    "write_geojson",
    "write_json",
    "write_outputs",
    "write_summary",
    "write_tum",
]

Array = npt.NDArray[np.float64]

#: North, east, down -> east, north, up.
_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: A line on a map needs no more points than this.
_MAP_POINTS = 4000


def labelled(track: Track) -> dict[str, Track]:
    """The runs inside a track by label: ``{"forward": ..}``, or ``{"forward": .., "smoothed": ..}``."""
    runs = {} if track.forward is None else {track.forward.label: track.forward}
    return {**runs, track.label: track}


def write_outputs(
    tracks: Mapping[str, Track],
    mission: Mission,
    folder: str | os.PathLike[str],
    more: Mapping[str, Any] | None = None,
    vehicle_file: str | os.PathLike[str] | None = None,
    remarks: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write every data file of a run; the last track is the result, the others only appear in the summary.

    Parameters
    ----------
    tracks : dict of str to Track
        By label, see `labelled`.
    mission : Mission
        Whose replay they are.
    folder : path-like
        Made when missing; files of the same name are replaced.
    more : dict, optional
        Further entries of ``summary.json``.
    vehicle_file, remarks : optional
        For `navfilter.io.learned_toml.write_learned`: the file that the vehicle was read from, and comments.

    Returns
    -------
    list of Path
        The files written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    result = list(tracks.values())[-1]
    learnt = learned_vehicle(result)
    return [
        write_csv(result, folder / "track.csv"),
        *write_tum(result, folder, mission.truth),
        write_geojson(result, mission, folder / "track.geojson"),
        write_summary(tracks, mission, folder / "summary.json", more),
        *([] if learnt is None else [write_learned(learnt, folder / "vehicle_learned.toml", vehicle_file, remarks)]),
    ]


def learned_vehicle(track: Track) -> Vehicle | None:
    """The vehicle of a run with the error models that were in force at its end: the next dive can begin with them.

    Parameters
    ----------
    track : Track

    Returns
    -------
    Vehicle or None
        None where no model has been learnt.
    """
    last: dict[str, Any] = {}
    for name, history in track.error_models.items():
        error = history[-1][1] if history else None
        models = error if isinstance(error, tuple) else (error,)
        if any(
            learned is not None and learned.model is not None for learned in map(learned_part, filter(None, models))
        ):
            last[name] = models[0] if len(models) == 1 else models
    return track.vehicle.with_error(**last) if last else None


def summarise(tracks: Mapping[str, Track], mission: Mission) -> dict[str, Any]:
    """What `write_summary` writes: figures of every run by label; None where there is no truth.

    Parameters
    ----------
    tracks : dict of str to Track
    mission : Mission
        Its truth and its windows are what is scored.

    Returns
    -------
    dict
        "mission", "vehicle", "duration_s", "distance_m" (of the last track), "runs".
    """
    result = list(tracks.values())[-1]
    runs = {label: track.summary(mission.truth, mission.windows) for label, track in tracks.items()}
    summary = {
        "mission": mission.name,
        "vehicle": result.vehicle.name,
        "duration_s": float(result.time_s[-1] - result.time_s[0]),
        "distance_m": result.distance_m,
        "runs": runs,
    }
    return _finite(summary)


def write_summary(
    tracks: Mapping[str, Track], mission: Mission, path: str | os.PathLike[str], more: Mapping[str, Any] | None = None
) -> Path:
    """Write `summarise`, and `more` behind it, as JSON with keys in a fixed order; what is not a finite number becomes
    null.
    """
    return write_json({**summarise(tracks, mission), **(more or {})}, path)


def write_json(value: Any, path: str | os.PathLike[str]) -> Path:
    """Write plain values as JSON; what is not a finite number becomes null."""
    with _replacing(path) as file:
        json.dump(_finite(value), file, indent=2, allow_nan=False, ensure_ascii=False)
        file.write("\n")
    return Path(path)


def write_csv(track: Track, path: str | os.PathLike[str]) -> Path:
    """Write `Track.to_frame`: one row per time, degrees and metres, the unit in the name of every column."""
    frame = track.to_frame()
    # 1e-10 degrees are 0.01 mm; seven digits are more than any other quantity has.
    special = {
        "time_s": "%.6f",
        "latitude_deg": "%.10f",
        "longitude_deg": "%.10f",
        "height_m": "%.5f",
        "depth_m": "%.5f",
    }
    with _replacing(path) as file:
        formats = [special.get(name, "%.7g") for name in frame.columns]
        np.savetxt(file, frame.to_numpy(), fmt=formats, delimiter=",", header=",".join(frame.columns), comments="")
    return Path(path)


def write_tum(track: Track, folder: str | os.PathLike[str], truth: Stream | None = None) -> list[Path]:
    """Write track.tum, and truth.tum where there is a truth, as tools for comparing trajectories read them.

    Parameters
    ----------
    track : Track
    folder : path-like
    truth : Stream, optional
        Unknown heights and attitudes are taken from the track, so that they count as no error.

    Returns
    -------
    list of Path

    Notes
    -----
    ``timestamp tx ty tz qx qy qz qw``: metres east, north, up in the plane tangent to the ellipsoid at the first
    position of the track, and the rotation from the body (forward, right, down) to that plane.
    """
    origin = (float(track.latitude[0]), float(track.longitude[0]), float(track.height[0]))
    place = np.column_stack([track.latitude, track.longitude, track.height])
    written = [_tum(Path(folder) / "track.tum", track.time_s, place, track.attitude, origin)]
    if truth is None:
        return written
    known = np.isfinite(truth.value[:, :2]).all(axis=1)
    known &= (truth.time_s >= track.time_s[0]) & (truth.time_s <= track.time_s[-1])
    if known.any():
        t, value = truth.time_s[known], truth.value[known]
        own = np.column_stack([track.height, np.unwrap(track.attitude, axis=0)])
        for column, from_track in zip((2, 6, 7, 8), own.T, strict=True):
            value[:, column] = np.where(
                np.isfinite(value[:, column]), value[:, column], np.interp(t, track.time_s, from_track)
            )
        written.append(_tum(Path(folder) / "truth.tum", t, value[:, :3], value[:, 6:9], origin))
    return written


def local_enu(place: Array, origin: tuple[float, float, float]) -> Array:
    """East, north, up [m], shape (n, 3), of latitude, longitude [rad], height [m], shape (n, 3), in the tangent plane
    at the origin.
    """
    first = np.array([origin])
    axes = ned_axes(first[:, 0], first[:, 1])[0]
    return (ecef_from_geodetic(place) - ecef_from_geodetic(first)) @ axes.T @ _ENU.T


def _tum(path: Path, time_s: Array, place: Array, attitude: Array, origin: tuple[float, float, float]) -> Path:
    here = ned_axes(place[:, 0], place[:, 1])
    plane = _ENU @ ned_axes(np.array([origin[0]]), np.array([origin[1]]))[0]
    C = plane @ np.swapaxes(here, 1, 2) @ matrix_from_euler(*attitude.T)
    rows = np.column_stack([time_s, local_enu(place, origin), Rotation.from_matrix(C).as_quat()])
    with _replacing(path) as file:
        np.savetxt(file, rows, fmt=["%.6f", *["%.5f"] * 3, *["%.9f"] * 4])
    return path


def write_geojson(track: Track, mission: Mission, path: str | os.PathLike[str]) -> Path:
    """Write the track, the truth and the position fixes for a map (RFC 7946: longitude, latitude, height).

    Parameters
    ----------
    track : Track
    mission : Mission
    path : path-like

    Returns
    -------
    Path
    """
    place = np.column_stack([track.latitude, track.longitude, track.height])
    about: dict[str, Any] = {
        "name": track.label,
        "mission": mission.name,
        "vehicle": track.vehicle.name,
        "begin_s": float(track.time_s[0]),
        "end_s": float(track.time_s[-1]),
        "distance_m": round(track.distance_m, 3),
    }
    features = [_line(place, {**about, "stroke": "#0072b2"})]
    if mission.truth is not None:
        known = mission.truth.value[np.isfinite(mission.truth.value[:, :2]).all(axis=1), :3]
        if len(known) > 1:
            features.append(_line(known, {"name": "truth", "mission": mission.name, "stroke": "#000000"}))
    for name, sensor in track.vehicle.sensors.items():
        if sensor.gives == "position" and name in mission.streams:
            fixes = mission.streams[name].value[:, :3]
            fixes = _thinned(fixes[np.isfinite(fixes[:, :2]).all(axis=1)])
            shape = {"type": "MultiPoint", "coordinates": _coordinates(fixes)}
            features.append(
                {"type": "Feature", "properties": {"name": name, "mission": mission.name}, "geometry": shape}
            )
    with _replacing(path) as file:
        json.dump(
            {"type": "FeatureCollection", "features": features},
            file,
            allow_nan=False,
            ensure_ascii=False,
            separators=(",", ":"),
        )
    return Path(path)


def _line(place: Array, properties: dict[str, Any]) -> dict[str, Any]:
    place = _thinned(place)
    # A line across the antimeridian is cut there (RFC 7946, 3.1.9), or it would run round the Earth.
    cuts = np.flatnonzero(np.abs(np.diff(_wrapped(place[:, 1]))) > np.pi) + 1
    parts = [_coordinates(part) for part in np.split(place, cuts) if len(part) > 1]
    shape = (
        {"type": "LineString", "coordinates": parts[0]}
        if len(parts) == 1
        else {"type": "MultiLineString", "coordinates": parts}
    )
    return {"type": "Feature", "properties": properties, "geometry": shape}


def _thinned(rows: Array) -> Array:
    return rows if len(rows) <= _MAP_POINTS else rows[np.linspace(0, len(rows) - 1, _MAP_POINTS).astype(int)]


def _wrapped(longitude: Array) -> Array:
    return np.remainder(longitude + np.pi, 2.0 * np.pi) - np.pi


def _coordinates(place: Array) -> list[list[float]]:
    degrees = np.column_stack([np.degrees(_wrapped(place[:, 1])), np.degrees(place[:, 0])]).round(8).tolist()
    return [
        [*pair, round(h, 3)] if math.isfinite(h) else pair
        for pair, h in zip(degrees, place[:, 2].tolist(), strict=True)
    ]


def _finite(value: Any) -> Any:
    """The same with None for every number that JSON has not."""
    if isinstance(value, Mapping):
        return {str(key): _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def _replacing(path: str | os.PathLike[str]) -> Iterator[TextIO]:
    """Write beside the file and move it there at the end: nobody ever reads half a file."""
    path = Path(path)
    part = path.with_name(path.name + ".part")
    try:
        with part.open("w", encoding="utf-8", newline="\n") as file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)

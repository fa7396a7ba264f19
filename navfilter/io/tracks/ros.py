"""track.mcap and track.rosbag: a track as messages of ROS 2, which Foxglove and PlotJuggler open too.

=============================  ================================  =====================================================
topic                          type                              what
=============================  ================================  =====================================================
``/navfilter/odometry``        nav_msgs/msg/Odometry             ``map`` (east, north, up from the first position) to
                                                                 ``base_link`` (forward, left, up), with covariances
``/navfilter/fix``             sensor_msgs/msg/NavSatFix         latitude, longitude [deg], height, covariance
``/navfilter/SENSOR/nis``      std_msgs/msg/Float64              NIS per component of each reading: 1 is honest
``/diagnostics``               diagnostic_msgs/DiagnosticArray   once a second the condition of each sensor
=============================  ================================  =====================================================

A track has no angular rates: they are zero with a variance of 1e6. Stamps are UTC; where that is unknown, mission time.
"""

import heapq
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation import utc
from navfilter.foundation.arrays import Array
from navfilter.foundation.atomic_files import pieces, replacing_tree
from navfilter.io.geodesy import ENU, local_enu, origin_of, plane_from_n
from navfilter.io.tracks.formats import is_nowhere
from navfilter.models.health import SensorHealth
from navfilter.models.mission import Mission
from navfilter.models.state import matrix_from_euler
from navfilter.track.track import Track

Stamped = Iterator[tuple[int, int, Any]]

#: Forward, right, down -> forward, left, up.
_FLU = np.diag([1.0, -1.0, -1.0])
#: Variance of what is not known.
_UNKNOWN = 1e6
_NS = 10**9
#: Condition of a sensor -> level of a DiagnosticStatus: OK, WARN, ERROR, STALE.
_LEVELS = {"good": 0, "noisy": 1, "jumped": 1, "partial": 1, "rejected": 2, "waiting": 3, "silent": 3}
_STORE = get_typestore(Stores.LATEST)


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track as a file (.mcap) or as the folder of a bag.

    Raises
    ------
    ValueError
        For times before 1970, or after 2038, which a stamp of ROS cannot hold.
    """
    ends = utc.nanoseconds(track.time_s[[0, -1]], track.epoch_utc_s)
    if ends[0] < 0 or ends[1] >= 2**31 * _NS:
        raise ValueError(
            f"{path}: stamps of ROS lie from 0 to 2^31 s, this track's from {ends[0] / _NS:.1f} to"
            f' {ends[1] / _NS:.1f} s. Give zero_s = "first", or the right epoch, in the mission.toml.'
        )
    if path.suffix.lower() == ".mcap":
        with tempfile.TemporaryDirectory(prefix=".navfilter-", dir=path.parent) as beside:
            folder = Path(beside) / "bag"
            _write(track, folder, StoragePlugin.MCAP)
            (folder / "bag.mcap").replace(path)
    else:
        with replacing_tree(path, "metadata.yaml") as folder:
            _write(track, folder, StoragePlugin.SQLITE3)


def _write(track: Track, folder: Path, storage: StoragePlugin) -> None:
    writer = Writer(folder, version=9, storage_plugin=storage)
    if storage is StoragePlugin.MCAP:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        topics: list[tuple[str, str, Iterator[tuple[int, Any]]]] = [
            ("/navfilter/odometry", "nav_msgs/msg/Odometry", _odometry(track)),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", _diagnostics(track)),
        ]
        if not is_nowhere(float(track.latitude[0]), float(track.longitude[0])):
            topics.append(("/navfilter/fix", "sensor_msgs/msg/NavSatFix", _fixes(track)))
        names = _topic_names(track)
        for name, residuals in track.residuals.items():
            topics.append((f"/navfilter/{names[name]}/nis", "std_msgs/msg/Float64", _nis(track, residuals)))
        connections = [writer.add_connection(topic, kind, typestore=_STORE) for topic, kind, _ in topics]
        for stamp, k, message in heapq.merge(*(_numbered(k, topic[2]) for k, topic in enumerate(topics))):
            writer.write(connections[k], stamp, _STORE.serialize_cdr(message, connections[k].msgtype))


def _numbered(number: int, messages: Iterator[tuple[int, Any]]) -> Stamped:
    return ((stamp, number, message) for stamp, message in messages)


def _topic_names(track: Track) -> dict[str, str]:
    """Names of sensors as parts of topics: letters, digits and underscores, each its own."""
    names: dict[str, str] = {}
    for name in track.residuals:
        word = re.sub(r"[^A-Za-z0-9_]", "_", name)
        word = f"_{word}" if not word or word[0].isdigit() else word
        while word in names.values():
            word += "_"
        names[name] = word
    return names


def _message(kind: str, *fields: Any) -> Any:
    return _STORE.types[kind](*fields)


def _header(stamp: int, frame: str) -> Any:
    return _message("std_msgs/msg/Header", _message("builtin_interfaces/msg/Time", stamp // _NS, stamp % _NS), frame)


# --- the track ------------------------------------------------------------------------------------------------------


def _odometry(track: Track) -> Iterator[tuple[int, Any]]:
    origin = origin_of(track)
    for rows in pieces(len(track)):
        part = track.keep(rows)
        place = np.column_stack([part.latitude, part.longitude, part.height])
        plane, C_nb = plane_from_n(place, origin), matrix_from_euler(*part.attitude.T)
        at = local_enu(place, origin)
        turned = Rotation.from_matrix(plane @ C_nb @ _FLU).as_quat()
        body = _FLU @ np.swapaxes(C_nb, 1, 2)
        velocity = np.einsum("nij,nj->ni", body, part.velocity_n)
        pose_P, twist_P = _pose_covariance(part, plane), _twist_covariance(part, body)
        stamps = utc.nanoseconds(part.time_s, part.epoch_utc_s).tolist()
        for i, stamp in enumerate(stamps):
            point = _message("geometry_msgs/msg/Point", *at[i])
            pose = _message("geometry_msgs/msg/Pose", point, _message("geometry_msgs/msg/Quaternion", *turned[i]))
            linear = _message("geometry_msgs/msg/Vector3", *velocity[i])
            twist = _message("geometry_msgs/msg/Twist", linear, _message("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0))
            placed = _message("geometry_msgs/msg/PoseWithCovariance", pose, pose_P[i])
            moving = _message("geometry_msgs/msg/TwistWithCovariance", twist, twist_P[i])
            yield stamp, _message("nav_msgs/msg/Odometry", _header(stamp, "map"), "base_link", placed, moving)


def _pose_covariance(track: Track, plane: Array) -> Array:
    """Of east, north, up and of the rotation about these axes, (n, 36), row by row."""
    turn = np.zeros((len(track), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = plane
    chosen = [0, 1, 2, 6, 7, 8]
    P = track.covariance[:, chosen][:, :, chosen]
    return (turn @ P @ np.swapaxes(turn, 1, 2)).reshape(-1, 36)


def _twist_covariance(track: Track, body: Array) -> Array:
    """Of the velocity in the body, which errs with velocity and attitude, (n, 36); that of rates is `_UNKNOWN`."""
    north, east, down = track.velocity_n.T
    zero = np.zeros_like(north)
    cross = np.stack([[zero, -down, east], [down, zero, -north], [-east, north, zero]]).transpose(2, 0, 1)
    J = np.concatenate([body, body @ cross], axis=2)
    result = np.zeros((len(track), 6, 6))
    result[:, :3, :3] = J @ track.covariance[:, 3:, 3:] @ np.swapaxes(J, 1, 2)
    result[:, [3, 4, 5], [3, 4, 5]] = _UNKNOWN
    return result.reshape(-1, 36)


def _fixes(track: Track) -> Iterator[tuple[int, Any]]:
    # no satellite receiver: a fix of unknown service, whose covariance is known
    status = _message("sensor_msgs/msg/NavSatStatus", 0, 0)
    for rows in pieces(len(track)):
        stamps = utc.nanoseconds(track.time_s[rows], track.epoch_utc_s).tolist()
        latitude, longitude = np.degrees(track.latitude[rows]), (np.degrees(track.longitude[rows]) + 180.0) % 360.0
        P = (ENU @ track.covariance[rows, :3, :3] @ ENU.T).reshape(-1, 9)
        for stamp, north, east, up, own in zip(stamps, latitude, longitude - 180.0, track.height[rows], P, strict=True):
            yield (
                stamp,
                _message("sensor_msgs/msg/NavSatFix", _header(stamp, "base_link"), status, north, east, up, own, 3),
            )


# --- the sensors ----------------------------------------------------------------------------------------------------


def _nis(track: Track, residuals: Residuals) -> Iterator[tuple[int, Any]]:
    judged = np.flatnonzero(np.isfinite(residuals.nis) & (residuals.dof > 0))
    judged = judged[np.argsort(residuals.time_s[judged], kind="stable")]
    stamps = utc.nanoseconds(residuals.time_s[judged], track.epoch_utc_s)
    for stamp, nis in zip(stamps.tolist(), residuals.nis[judged] / residuals.dof[judged], strict=True):
        yield stamp, _message("std_msgs/msg/Float64", nis)


def _diagnostics(track: Track) -> Iterator[tuple[int, Any]]:
    """Once a second what a live run would have said of its sensors (whether one is stuck is not in a track)."""
    watches = {name: SensorMonitor.of(track.vehicle.sensors[name]) for name in track.residuals}
    heard = {name: _heard(residuals) for name, residuals in track.residuals.items()}
    coming = {name: next(readings, None) for name, readings in heard.items()}
    for now_s in np.arange(np.ceil(track.time_s[0]), track.time_s[-1] + 1e-9, 1.0).tolist():
        for name, watch in watches.items():
            while (reading := coming[name]) is not None and reading[0] <= now_s:
                time_s, outcome, nis, dof = reading
                watch.on_outcome(outcome, time_s, nis, dof)
                coming[name] = next(heard[name], None)
        stamp = int(utc.nanoseconds(np.array([now_s]), track.epoch_utc_s)[0])
        statuses = [_status(name, watch.health(now_s)) for name, watch in watches.items()]
        yield stamp, _message("diagnostic_msgs/msg/DiagnosticArray", _header(stamp, ""), statuses)


def _heard(residuals: Residuals) -> Iterator[tuple[float, str, float, int]]:
    """Readings of a sensor in the order of their times."""
    for i in np.argsort(residuals.time_s, kind="stable").tolist():
        yield (
            float(residuals.time_s[i]),
            OUTCOMES[residuals.outcome[i]],
            float(residuals.nis[i]),
            int(residuals.dof[i]),
        )


def _status(name: str, health: SensorHealth) -> Any:
    values = {"age_s": f"{health.age_s:.3f}", "nis": f"{health.nis:.4g}"}
    values |= {outcome: str(count) for outcome, count in health.outcomes.items()}
    pairs = [_message("diagnostic_msgs/msg/KeyValue", key, value) for key, value in values.items()]
    return _message(
        "diagnostic_msgs/msg/DiagnosticStatus", _LEVELS[health.condition], f"navfilter: {name}", health.condition,
        "navfilter", pairs,
    )  # fmt: skip

"""Reading logs: time against the library underneath, in one run with calls alternating; memory on a large bag."""

from __future__ import annotations

import contextlib
import json
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import Options, Table, data_root, flag, in_turn, main, quick

from navfilter.io.logs import Shelf
from navfilter.io.logs.survey import survey

_ROS = {
    "/imu/data": ["header.stamp"]
    + [f"{part}.{axis}" for part in ("angular_velocity", "linear_acceleration") for axis in "xyz"],
    "/jackal_velocity_controller/odom": ["header.stamp", *(f"twist.twist.linear.{axis}" for axis in "xyz")],
}
_BEAMS = [f"velocity[{k}]" for k in range(3)]
_ANGLES = ["heading", "pitch", "roll"]
#: Sample -> what a mission wants of it: topic -> columns.
SAMPLES: dict[str, dict[str, list[str]]] = {
    "ros1/robot_localization_test2.bag": _ROS,
    "ros2/derived_from_test2_db3": _ROS,
    "ros2/derived_from_test2_mcap": _ROS,
    "nmea/ugps_nmea_log.txt": {"GPRMC": ["status", "spd", "cog"], "GPGGA": ["lat", "lon", "alt", "quality"]},
    "px4/sample_log_small.ulg": {
        "sensor_combined": [f"{part}[{k}]" for part in ("gyro_rad", "accelerometer_m_s2") for k in range(3)],
        "vehicle_gps_position": ["lat", "lon", "alt"],
    },
    "ardupilot/ardusub_small.BIN": {
        "IMU": ["GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"],
        "ATT": ["Roll", "Pitch", "Yaw"],
    },
    "ardupilot/ardusub_small.tlog": {
        "ATTITUDE": ["roll", "pitch", "yaw"],
        "SCALED_PRESSURE2": ["press_abs"],
        "GPS_INPUT": ["lat", "lon", "fix_type"],
    },
    "pd0/RDI_withBT.000": {"bottom_track": [*_BEAMS, "frame"], "sensors": _ANGLES},
    "pd0/vmdas01_wh.ENX": {"navigation": ["latitude", "longitude"], "sensors": _ANGLES},
    "nortek/VelEchoBT01.ad2cp": {"bottom_track": [*_BEAMS, "frame"], "sensors": _ANGLES},
    "../glider-slocum-ru28/ru28_2017_113_3_0_dbd.dat.xz": {
        "glider": ["m_heading", "m_pitch", "m_roll", "m_depth", "m_gps_lat", "m_gps_lon"]
    },
    "../yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz": {
        "IIRMC": ["lat", "lon", "status"],
        "IIHDG": ["headingM"],
        "IIVHW": ["spdN"],
    },
}


def library_alone(path: Path) -> Callable[[], object] | None:
    """Decode every record with the library underneath; None where there is none."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in (".bag", ".db3", ".mcap"):
        return lambda: _rosbags(path)
    if suffix == ".ulg":
        return lambda: _pyulog(path)
    if suffix in (".bin", ".tlog"):
        return lambda: _pymavlink(path)
    return (lambda: _pynmeagps(path)) if "nmea" in path.name.lower() else None


def _rosbags(path: Path) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def _pyulog(path: Path) -> None:
    from pyulog import ULog

    ULog(str(path))


def _pymavlink(path: Path) -> None:
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    while log.recv_match() is not None:
        pass


def _pynmeagps(path: Path) -> None:
    import lzma

    from pynmeagps import NMEAReader
    from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

    with (lzma.open if path.suffix == ".xz" else open)(path, "rb") as file:
        for line in file:
            if (begin := line.find(b"$")) >= 0:
                with contextlib.suppress(NMEAMessageError, NMEAParseError, NMEATypeError):
                    NMEAReader.parse(line[begin:])


def samples(options: Options) -> list[dict[str, Any]]:
    """The samples below NAVFILTER_DATA/logs, for what a mission wants of them and with the library alone.

    The library decodes every record and keeps nothing. The best of alternating runs of each reader, processor time; the
    memory is the most that reading holds at one time, the result included.
    """
    root = data_root() / "logs"
    table = Table("log<36 records>9d readings>9d seconds>9.3f library_s>10.3f ratio>7.2f peak_mb>8.1f left_out<60")
    for name, columns in [*SAMPLES.items()][: 2 if options.quick else None]:
        path = root / name
        alone = library_alone(path)
        calls: dict[str, Callable[[], object]] = {"ours": lambda p=path, c=columns: _ours(p, c)}  # type: ignore[misc]
        times = in_turn(calls | ({} if alone is None else {"library": alone}), 1 if options.quick else options.repeats)
        best = {key: float(values.min()) for key, values in times.items()}
        found = survey(path)
        library = best.get("library", np.nan)
        table.add(
            {
                "log": name,
                "records": sum(topic.count for topic in found.topics),
                "readings": _ours(path, columns),
                "seconds": best["ours"],
                "library_s": library,
                "ratio": best["ours"] / library,
                "peak_mb": peak_mb(path, columns),
                "left_out": "; ".join(found.notes) or "-",
            }
        )
    return table.rows


def _ours(path: Path, columns: dict[str, list[str]]) -> int:
    shelf = Shelf({path: columns})
    return sum(shelf.table(path, topic).raw("log_time").size for topic in columns)


def peak_mb(path: Path, columns: dict[str, list[str]]) -> float:
    """Most memory that reading holds at one time [MB], the result included."""
    tracemalloc.start()
    _ours(path, columns)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def _apart(call: str) -> Any:
    """What a call of this module returns in a process of its own."""
    code = f"import json, logs, pathlib; print(json.dumps({call}))"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=Path(__file__).parent
    )
    return json.loads(done.stdout.splitlines()[-1])


# --- a large bag ----------------------------------------------------------------------------------------------------


def write_large(path: Path, megabytes: float) -> None:
    """A ROS 2 bag (MCAP): images of 1 MB at 10 Hz, an inertial unit at 100 Hz, a velocity log at 5 Hz."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"](x=0.1, y=0.2, z=0.3)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    nine, pixels = np.zeros(9), np.random.default_rng(0).integers(0, 255, 1_000_000).astype(np.uint8)
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {
            "/camera": "sensor_msgs/msg/Image",
            "/imu": "sensor_msgs/msg/Imu",
            "/dvl": "geometry_msgs/msg/TwistStamped",
        }
        links = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for k in range(int(megabytes * 10)):
            ns = 1_700_000_000_000_000_000 + k * 10_000_000
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="b")
            imu = types[kinds["/imu"]](header, turn, nine, vector, nine, vector, nine)
            writer.write(links["/imu"], ns, store.serialize_cdr(imu, kinds["/imu"]))
            if k % 20 == 0:
                twist = types[kinds["/dvl"]](header, types["geometry_msgs/msg/Twist"](vector, vector))
                writer.write(links["/dvl"], ns, store.serialize_cdr(twist, kinds["/dvl"]))
            if k % 10 == 0:
                image = types[kinds["/camera"]](header, 1000, 1000, "mono8", 0, 1000, pixels)
                writer.write(links["/camera"], ns, store.serialize_cdr(image, kinds["/camera"]))


def read_large(path: Path) -> dict[str, float]:
    """Readings, seconds and the peak of this process's memory [MB]."""
    began = time.perf_counter()
    columns = {"/imu": [f"{part}.{axis}" for part in ("angular_velocity", "linear_acceleration") for axis in "xyz"]}
    columns |= {"/dvl": [f"twist.linear.{axis}" for axis in "xyz"]}
    shelf = Shelf({path: columns})
    readings = sum(shelf.table(path, topic).raw("log_time").size for topic in columns)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"readings": readings, "seconds": round(time.perf_counter() - began, 1), "peak_mb": round(peak)}


def large(options: Options) -> dict[str, Any]:
    """Write a ROS 2 bag (images, an inertial unit, a velocity log), read two streams of it, and say what memory it
    took.

    Reading has a process of its own: the peak of this one is that of writing.
    """
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        write_large(bag, 20.0 if options.quick else options.megabytes)
        size = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
        read = _apart(f"logs.read_large(pathlib.Path({str(bag)!r}))")
    table = Table("megabytes>10.0f " + " ".join(f"{key}>12.2f" for key in read))
    table.add({"megabytes": size} | read)
    return table.rows[0]


if __name__ == "__main__":
    repeats = flag("--repeats", type=int, default=3, help="alternating runs of each reader (default: %(default)s)")
    megabytes = flag("--megabytes", type=float, default=2000.0, help="size of the bag (default: %(default)s)")
    main(__doc__, {samples: [repeats, quick("two samples, once")], large: [megabytes, quick("20 MB")]})

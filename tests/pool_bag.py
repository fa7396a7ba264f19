"""A ROS 2 bag with a DVL, from the recording of an AUV in a pool: what its drivers would have published."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import navfilter as nf
from navfilter.models.mission import Mission

#: As in the package dvl_msgs, without the beams.
DVL = "std_msgs/Header header\nfloat64 time\ngeometry_msgs/Vector3 velocity\nfloat64 fom\nbool velocity_valid\n"
#: Forward, right, down of the mission to forward, left, up of ROS (REP 103).
FLU = np.array([1.0, -1.0, -1.0])
#: The DVL is turned by this in the vehicle; its driver was told so.
TURNED_DEG = -45.0


def write_bag(path: Path, mission: Mission, begin_s: float = 1_457_190_000.0) -> None:
    """Write an MCAP bag with /imu/data, /imu/mag, /dvl/data and /pressure.

    Parameters
    ----------
    path : Path
        Folder of the bag, made here.
    mission : Mission
        With the streams imu, compass, dvl and depth, in SI.
    begin_s : float
        Its beginning, in seconds since 1970.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DVL, "dvl_msgs/msg/DVL"))
    types, nine = store.types, np.zeros(9)
    vector = types["geometry_msgs/msg/Vector3"]
    nobody = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    unknown = np.r_[-1.0, np.zeros(8)]

    def imu(header, value):
        rate, force = value[:3] * FLU, value[3:6] * FLU
        return types["sensor_msgs/msg/Imu"](header, nobody, unknown, vector(*rate), nine, vector(*force), nine)

    def field(header, value):
        return types["sensor_msgs/msg/MagneticField"](header, vector(*(value[:3] * FLU)), nine)

    def dvl(header, value):
        c, s = np.cos(np.radians(TURNED_DEG)), np.sin(np.radians(TURNED_DEG))
        x, y, z = np.nan_to_num(value[:3])
        valid = bool(np.isfinite(value[:3]).all())
        velocity = vector(c * x - s * y, s * x + c * y, z)
        return types["dvl_msgs/msg/DVL"](header, 0.0, velocity, 0.01, valid)

    def pressure(header, value):
        return types["sensor_msgs/msg/FluidPressure"](header, float(value[0]), 0.0)

    topics = {
        "imu": ("/imu/data", "sensor_msgs/msg/Imu", imu),
        "compass": ("/imu/mag", "sensor_msgs/msg/MagneticField", field),
        "dvl": ("/dvl/data", "dvl_msgs/msg/DVL", dvl),
        "depth": ("/pressure", "sensor_msgs/msg/FluidPressure", pressure),
    }
    rows = sorted(
        (float(time), name, k) for name in topics for k, time in enumerate(mission.streams[name].time_s.tolist())
    )
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        links = {name: writer.add_connection(topic, kind, typestore=store) for name, (topic, kind, _) in topics.items()}
        for time_s, name, k in rows:
            ns = round((begin_s + time_s) * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            message = topics[name][2](types["std_msgs/msg/Header"](stamp, name), mission.streams[name].value[k])
            writer.write(links[name], ns, store.serialize_cdr(message, topics[name][1]))


def pool_mission(folder: Path) -> Mission:
    """The mission that a mission.toml of tests/recordings maps, pressures kept as they are."""
    return nf.read_mission(folder)

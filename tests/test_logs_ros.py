"""ROS bags: the same readings from each of the three storages, DVL messages of four shapes, damage, what is missing."""

import tempfile
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import navfilter as nf
from navfilter.io.inertial import read_series
from navfilter.io.logs import Shelf
from navfilter.io.table import TableOptions, Where
from navfilter.io.text_tables import read_table
from navfilter.models.mission import MissionError

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason='rosbags is not installed: pip install "navfilter[ros]"')
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

BAG = "ros1/robot_localization_test2.bag"
MCAP = "ros2/derived_from_test2_mcap/derived_from_test2_mcap.mcap"
DB3 = "ros2/derived_from_test2_db3"
MISSION = """
zero_s = "first"
[streams.imu]
file = "{log}"
topic = "/imu/data"
time = {{column = "header.stamp"}}
rate = {{columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"], axes = "x,-y,-z"}}
force = {{columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"], axes = "x,-y,-z"}}
[streams.wheels]
file = "{log}"
topic = "/jackal_velocity_controller/odom"
time = {{column = "header.stamp"}}
velocity = {{columns = ["twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.linear.z"], axes = "x,-y,-z"}}
where = {{column = "twist.covariance[0]", at_most = 0.01}}
"""
#: Types of DVL messages in use, with the fields that matter; the validity is said in a different way by each.
DVL_TYPES = {
    "dvl_msgs/msg/DVL": "std_msgs/Header header\nfloat64 time\ngeometry_msgs/Vector3 velocity\nfloat64 fom\n"
    "bool velocity_valid\n",
    "marine_acoustic_msgs/msg/Dvl": "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\n"
    "float64[9] velocity_covar\nuint8 num_good_beams\n",
    "uuv_sensor_ros_plugins_msgs/msg/DVL": "std_msgs/Header header\ngeometry_msgs/Vector3 velocity\n"
    "float64[9] velocity_covariance\nfloat64 altitude\n",
}


def mission_of(log, folder):
    (folder / "mission.toml").write_text(MISSION.format(log=log))
    return nf.read_mission(folder)


def test_the_readings_of_a_ros_1_bag(log_sample, tmp_path):
    mission = mission_of(log_sample(BAG), tmp_path)
    imu, wheels = mission.streams["imu"], mission.streams["wheels"]
    assert len(imu) == 3061 and len(wheels) == 3060
    assert mission.duration_s == pytest.approx(61.2, abs=1e-6)
    # The first message as rostopic prints it, turned from forward-left-up to forward-right-down.
    expected = [0.006656444803353631, 0.00236638747633773, -0.04275138193045083]
    np.testing.assert_array_equal(imu.value[0, :3], expected)
    np.testing.assert_array_equal(imu.value[0, 3:], [-0.5942556862503618, -0.15657528786590588, -9.703827518410009])
    assert wheels.time_s[0] == pytest.approx(0.004, abs=1e-6)  # of stamps 47.58 and 47.584 s


@pytest.mark.parametrize("other", [MCAP, DB3, f"{DB3}/derived_from_test2_db3.db3"])
def test_each_storage_holds_the_same(log_sample, tmp_path, other):
    one = mission_of(log_sample(BAG), tmp_path)
    two = mission_of(log_sample(other), tmp_path)
    for name, stream in one.streams.items():
        np.testing.assert_array_equal(two.streams[name].time_s, stream.time_s)
        np.testing.assert_array_equal(two.streams[name].value, stream.value)


def test_a_pose_in_east_north_up_is_a_local_position(log_sample, tmp_path):
    pose = [f"pose.pose.position.{axis}" for axis in "xyz"]
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.usbl]
file = "{log_sample(MCAP)}"
topic = "/jackal_velocity_controller/odom"
time = {{column = "header.stamp"}}
[streams.usbl.local]
columns = {pose}
axes = "y,x,-z"
origin = {{latitude_deg = 45.0, longitude_deg = 9.0}}
"""
    )
    position = nf.read_mission(tmp_path).streams["usbl"].value
    raw = Shelf().table(log_sample(MCAP), "/jackal_velocity_controller/odom")
    # Within 30 m of the origin a degree of latitude is 111 131 m, one of longitude 78 847 m.
    north, east = np.degrees(position[:, 0]) - 45.0, np.degrees(position[:, 1]) - 9.0
    np.testing.assert_allclose(111_131.75 * north, raw.raw(pose[1]), atol=1e-2)
    np.testing.assert_allclose(78_846.8 * east, raw.raw(pose[0]), atol=1e-2)


def test_a_series_for_identify(log_sample):
    series = read_series(
        log_sample(BAG), "angular_velocity.z", time_column="header.stamp", options=TableOptions(topic="/imu/data")
    )
    assert series.value.size == 3061 and series.rate_hz == pytest.approx(50.0, rel=1e-3)


def test_what_is_not_there_is_said_with_what_is(log_sample):
    path = log_sample(MCAP)
    with pytest.raises(MissionError, match=r'no topic "/dvl".*\(topics: /imu/data, /jackal_velocity_controller/odom\)'):
        Shelf().table(path, "/dvl")
    with pytest.raises(MissionError, match=r'no field "linear.x" \(fields: "log_time", "header.stamp"'):
        Shelf({path: {"/imu/data": {"linear.x"}}}).table(path, "/imu/data")
    with pytest.raises(MissionError, match="is a log: say which topic"):
        read_table(path)


def write_bag(path, messages, storage=rosbag2.StoragePlugin.MCAP):
    """A ROS 2 bag of DVL messages: topic -> (type, list of dicts of fields)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DVL_TYPES.items():
        store.register(get_types_from_msg(text, name))
    types = store.types
    with rosbag2.Writer(path, version=8, storage_plugin=storage) as writer:
        for topic, (kind, records) in messages.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, fields in enumerate(records):
                stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + k, nanosec=250_000_000)
                header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="dvl")
                fields = {**fields, "velocity": types["geometry_msgs/msg/Vector3"](*fields["velocity"])}
                raw = store.serialize_cdr(types[kind](header=header, **fields), kind)
                writer.write(connection, 1_700_000_001_000_000_000 + k * 1_000_000_000, raw)


def test_three_kinds_of_dvl_message_and_their_flags(tmp_path):
    covariance = np.diag([1e-4] * 3).ravel()
    speeds = [(1.0, 0.1, 0.0), (1.1, 0.2, 0.0), (0.0, 0.0, 0.0)]
    messages = {
        "/a50/data": (
            "dvl_msgs/msg/DVL",
            [{"time": 1.0, "velocity": v, "fom": 0.01, "velocity_valid": any(v)} for v in speeds],
        ),
        "/marine/dvl": (
            "marine_acoustic_msgs/msg/Dvl",
            [{"velocity": v, "velocity_covar": covariance, "num_good_beams": 4 if any(v) else 1} for v in speeds],
        ),
        "/uuv/dvl": (
            "uuv_sensor_ros_plugins_msgs/msg/DVL",
            # -1 in a covariance: this reading is invalid.
            [
                {"velocity": v, "velocity_covariance": covariance if any(v) else -covariance, "altitude": 3.0}
                for v in speeds
            ],
        ),
    }
    write_bag(tmp_path / "bag", messages)
    conditions = {
        "/a50/data": Where(column="velocity_valid", equals=True),
        "/marine/dvl": Where(column="num_good_beams", at_least=3),
        "/uuv/dvl": Where(column="velocity_covariance[0]", at_least=0),
    }
    for topic, condition in conditions.items():
        table = read_table(tmp_path / "bag", TableOptions(topic=topic, where=(condition,)))
        np.testing.assert_array_equal(table.raw("velocity.x"), [1.0, 1.1])
        np.testing.assert_array_equal(table.raw("header.stamp"), [1_700_000_000.25, 1_700_000_001.25])
        np.testing.assert_array_equal(table.raw("log_time"), [1_700_000_001.0, 1_700_000_002.0])
        assert any("1 of 3 rows left out by where" in note for note in table.notes)


def written(path, topic, kind, make, absent):
    """A bag of one topic; `make(types, covariance)` gives its fields, with -1 in front where the part is absent."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for k, is_absent in enumerate(absent):
            stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + k, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="body")
            message = types[kind](header=header, **make(types, -1.0 if is_absent else 0.5))
            writer.write(connection, 1_700_000_000_000_000_000 + k * 1_000_000_000, store.serialize_cdr(message, kind))


def twist(types, first):
    vector = types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    both = types["geometry_msgs/msg/Twist"](linear=vector, angular=vector)
    covariance = np.r_[first, np.zeros(35)]
    return {"twist": types["geometry_msgs/msg/TwistWithCovariance"](twist=both, covariance=covariance)}


def pose(types, first):
    point = types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    both = types["geometry_msgs/msg/Pose"](
        position=point, orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    return {"pose": types["geometry_msgs/msg/PoseWithCovariance"](pose=both, covariance=np.r_[first, np.zeros(35)])}


def inertial(part):
    def make(types, first):
        vector = types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
        fields = {"angular_velocity": vector, "linear_acceleration": vector}
        fields["orientation"] = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        known = {f"{name}_covariance": np.r_[0.5, np.zeros(8)] for name in fields}
        return {**fields, **known, f"{part}_covariance": np.r_[first, np.zeros(8)]}

    return make


@pytest.mark.parametrize(
    ("kind", "make", "lost", "kept"),
    [
        ("sensor_msgs/msg/Imu", inertial("orientation"), "orientation.w", "angular_velocity.z"),
        ("sensor_msgs/msg/Imu", inertial("angular_velocity"), "angular_velocity.z", "orientation.w"),
        ("sensor_msgs/msg/Imu", inertial("linear_acceleration"), "linear_acceleration.x", "angular_velocity.x"),
        ("geometry_msgs/msg/TwistWithCovarianceStamped", twist, "twist.twist.linear.x", "header.stamp"),
        ("geometry_msgs/msg/PoseWithCovarianceStamped", pose, "pose.pose.orientation.w", "header.stamp"),
    ],
)
@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(absent=st.lists(st.booleans(), min_size=2, max_size=6))
def test_what_a_message_says_is_absent_has_no_value(tmp_path, kind, make, lost, kept, absent):
    with tempfile.TemporaryDirectory(dir=tmp_path) as folder:
        written(Path(folder) / "bag", "/x", kind, make, absent)
        table = read_table(Path(folder) / "bag", TableOptions(topic="/x"))
        np.testing.assert_array_equal(np.isnan(table.numbers(lost)[0]), absent)
        assert np.isfinite(table.numbers(kept)[0]).all()
        assert any(f"{sum(absent)} message" in note for note in table.notes) == any(absent)


def test_an_old_bag_without_definitions_takes_those_beside_it(tmp_path):
    import sqlite3

    speeds = [{"velocity": (0.1 * k, 0.0, 0.0), "time": 0.0, "fom": 0.01, "velocity_valid": True} for k in range(3)]
    write_bag(tmp_path / "bag", {"/dvl": ("dvl_msgs/msg/DVL", speeds)}, rosbag2.StoragePlugin.SQLITE3)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    with pytest.raises(MissionError, match=r"3 messages of /dvl left out .*put dvl_msgs/msg/DVL.msg beside it"):
        Shelf().table(tmp_path / "bag", "/dvl")
    (tmp_path / "dvl_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "dvl_msgs" / "msg" / "DVL.msg").write_text(DVL_TYPES["dvl_msgs/msg/DVL"])
    np.testing.assert_allclose(Shelf().table(tmp_path / "bag", "/dvl").raw("velocity.x"), [0.0, 0.1, 0.2])


@pytest.mark.parametrize(("log", "readings", "reason"), [(BAG, 1394, "damaged"), (MCAP, 2721, "missing")])
def test_damage_in_the_middle_is_counted(log_sample, tmp_path, log, readings, reason):
    data = bytearray(log_sample(log).read_bytes())
    middle = slice(len(data) // 2, len(data) // 2 + 300)
    data[middle] = bytes(byte ^ 0x55 for byte in data[middle])
    path = tmp_path / f"damaged.{log[-4:].lstrip('.')}"
    path.write_bytes(data)
    table = Shelf().table(path, "/imu/data")
    assert len(table.raw("log_time")) == readings  # whole chunks are lost
    assert any(reason in note for note in table.notes)


@pytest.mark.parametrize("log", [BAG, MCAP])
def test_a_bag_cut_short_is_one_line_with_its_cure(log_sample, tmp_path, log):
    whole = log_sample(log).read_bytes()
    path = tmp_path / f"cut.{log[-4:].lstrip('.')}"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(MissionError, match=r"cut short, .* mends it"):
        Shelf().table(path, "/imu/data")


def test_garbage_is_one_line(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(200))
    with pytest.raises(MissionError, match="cannot be read as a ROS bag"):
        Shelf().table(tmp_path / "x.mcap", "/imu")


def test_without_the_package_the_error_says_what_to_install(tmp_path, monkeypatch):
    import importlib.util

    (tmp_path / "x.mcap").write_bytes(b"x")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissionError, match=r'pip install "navfilter\[ros\]"'):
        Shelf().table(tmp_path / "x.mcap", "/imu")

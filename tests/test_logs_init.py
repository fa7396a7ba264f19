"""From a log to a replayed mission with the commands of the manual, and no line of code."""

import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io.logs import FORMATS, formats
from navfilter.io.logs.guessed_columns import READINGS
from navfilter.io.logs.survey import survey, survey_text
from navfilter.io.mission_schema import mission_spec
from navfilter.io.validation import validate
from navfilter.models.mission import MissionError

for package, extra in (("rosbags", "ros"), ("pynmeagps", "nmea"), ("pyulog", "px4"), ("pymavlink", "ardupilot")):
    pytest.importorskip(package, reason=f'{package} is not installed: pip install "navfilter[{extra}]"')

#: Log, streams with their readings, and how many of each sensor's readings a replay must use at least.
LOGS = {
    "ros1/robot_localization_test2.bag": ({"imu": 3061, "odometry": 3060}, {"odometry": 2900}),
    "ros2/derived_from_test2_mcap/derived_from_test2_mcap.mcap": ({"imu": 3061, "odometry": 3060}, {"odometry": 2900}),
    "nmea/ugps_nmea_log.txt": ({"attitude": 16, "velocity": 16, "gps": 16}, {"gps": 16}),
    "ardupilot/ardusub_small.BIN": ({"attitude": 237, "velocity": 237, "depth": 237}, {"depth": 230}),
    "ardupilot/ardusub_small.tlog": ({"depth": 635, "gps": 936}, {"depth": 500, "gps": 700}),
    "px4/sample_log_small.ulg": ({"imu": 1298, "compass": 319, "gps": 32}, {"compass": 300, "gps": 32}),
    "nortek/VelEchoBT01.ad2cp": ({"attitude": 319, "velocity": 319}, {}),
    "pd0/RDI_withBT.000": ({"attitude": 1721, "velocity": 1721}, {}),
    "pd0/vmdas01_wh.ENX": ({"attitude": 3713, "velocity": 3713, "gps": 3713}, {"gps": 3700}),
}


@pytest.mark.parametrize("log", LOGS)
def test_a_log_replays_as_it_is_mapped(log_sample, tmp_path, capsys, log):
    readings, used = LOGS[log]
    assert main(["mission", str(log_sample(log)), "--init", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Guessed, and marked in the files:" in out and "navfilter replay" in out
    mission, vehicle = nf.read_mission(tmp_path), nf.read_vehicle(tmp_path)
    assert {name: len(mission.streams[name]) for name in readings} == readings
    track = nf.replay(vehicle, mission)
    for name, least in used.items():
        assert track.residuals[name].used.sum() >= least, name
    text = (tmp_path / "mission.toml").read_text() + (tmp_path / "vehicle.toml").read_text()
    assert text.count("# GUESSED: ") >= 2


def test_check_takes_a_bare_log(log_sample, capsys):
    assert main(["check", str(log_sample("pd0/vmdas01_wh.ENX"))]) in (0, 1)
    out = capsys.readouterr().out
    for part in (
        "navigation",
        "latitude = 48.0805 deg",
        "Left out while reading:",
        "1 ensemble cut short",
        "gps: 3713 readings",
    ):
        assert part in out


def test_a_log_is_no_mission_but_can_become_one(log_sample):
    with pytest.raises(MissionError, match='is a PX4 log, not a mission: "navfilter mission --init'):
        nf.read_mission(log_sample("px4/sample_log_small.ulg"))


def test_the_list_of_topics(log_sample):
    found = survey(log_sample("ardupilot/ardusub_small.BIN"))
    imu = next(topic for topic in found.topics if topic.name == "IMU[0]")
    assert (imu.count, round(imu.rate_hz), imu.gaps.size, imu.units["GyrX"]) == (594, 25, 0, "rad/s")
    line = next(line for line in survey_text(found).splitlines() if line.startswith("IMU[0]"))
    assert line.split()[:3] == ["IMU[0]", "594", "25"]


def test_a_glider_by_a_pattern(log_sample, tmp_path):
    log = log_sample("../glider-slocum-ru28") / "ru28*_3_[01]_dbd.dat.xz"
    assert main(["mission", str(log), "--init", "--vehicle-like", "glider", "--out", str(tmp_path), "--quiet"]) == 0
    mission = nf.read_mission(tmp_path)
    track = nf.replay(nf.read_vehicle(tmp_path), mission)
    assert track.residuals["gps"].used.sum() >= 5 and track.residuals["depth"].used.sum() > 400
    assert "there is no velocity in this log" in (tmp_path / "mission.toml").read_text()


def test_a_ros_driver_that_counts_downwards(tmp_path):
    """Gravity tells forward-right-down from the forward-left-up that ROS asks for."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector, nine = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    kinds = {"/imu": "sensor_msgs/msg/Imu", "/dvl": "geometry_msgs/msg/TwistStamped"}
    with Writer(tmp_path / "bag", version=8) as writer:
        links = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for k in range(200):
            ns = 1_700_000_000_000_000_000 + 20_000_000 * k
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="b")
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            force = vector(x=0.01 * (k % 3), y=0.0, z=-9.81)
            imu = types[kinds["/imu"]](header, turn, nine, vector(x=0.0, y=0.001 * (k % 2), z=0.0), nine, force, nine)
            writer.write(links["/imu"], ns, store.serialize_cdr(imu, kinds["/imu"]))
            twist = types["geometry_msgs/msg/Twist"](vector(x=1.0, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=0.0))
            writer.write(links["/dvl"], ns, store.serialize_cdr(types[kinds["/dvl"]](header, twist), kinds["/dvl"]))
    assert main(["mission", str(tmp_path / "bag"), "--init", "--out", str(tmp_path / "dive"), "--quiet"]) == 0
    mission = nf.read_mission(tmp_path / "dive")
    assert mission.streams["imu"].column("force_z_m_s2").mean() == pytest.approx(-9.81)
    assert mission.date.isoformat() == "2023-11-14"
    assert "because gravity points that way" in (tmp_path / "dive" / "mission.toml").read_text()


def test_a_log_beside_its_mission_is_named_relative_to_it(tmp_path):
    log = tmp_path / "dvl.json"
    line = '{"type": "position_local", "ts": %.1f, "roll": 1, "pitch": 2, "yaw": 3, "format": "json_v3"}'
    log.write_text("\n".join(line % (1.7e9 + 0.2 * k) for k in range(50)))
    assert main(["mission", str(log), "--init", "--out", str(tmp_path / "dive"), "--quiet"]) == 0
    assert 'file = "../dvl.json"' in (tmp_path / "dive" / "mission.toml").read_text()
    assert len(nf.read_mission(tmp_path / "dive").streams["attitude"]) == 50
    assert main(["mission", str(log), "--init", "--out", str(tmp_path / "dive"), "--quiet"]) == 2  # it is there already


def test_a_log_that_cannot_drive_says_what_it_has(log_sample, tmp_path, capsys):
    log = tmp_path / "x.alog"
    log.write_text("%% LOGSTART 1\n0.1 DEPTH a 1.5\n0.2 DEPTH a 1.6\n")
    assert main(["mission", str(log), "--init", "--out", str(tmp_path)]) == 2
    assert "nothing in this log can drive" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["x.alog"]
    with pytest.raises(MissionError, match="is no log that navfilter knows"):
        (tmp_path / "x.csv").write_text("a,b\n1,2\n")
        survey(Path(tmp_path / "x.csv"))


def test_the_examples_of_the_manual_are_valid():
    text = (Path(__file__).parents[1] / "docs" / "pages" / "logs.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert len(blocks) >= 3
    for block in blocks:
        validate(mission_spec(), tomllib.loads(block), Path("docs/pages/logs.md"), MissionError)


def test_every_format_is_in_the_manual_and_every_row_has_its_format():
    text = (Path(__file__).parents[1] / "docs" / "pages" / "logs.md").read_text(encoding="utf-8")
    for known in FORMATS:
        assert all(f"`{ending}`" in text for ending in known.suffixes), known.title
    rows = tomllib.loads((Path(formats.__file__).parent / "known_topics.toml").read_text(encoding="utf-8"))["use"]
    assert {row["format"] for row in rows} == {known.module for known in FORMATS}
    assert {row["reading"] for row in rows} <= set(READINGS)

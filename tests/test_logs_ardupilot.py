"""ArduPilot logs: DataFlash with the units that it states itself, telemetry with MAVLink's, velocity logs as deltas."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf
from navfilter.mission import MissionError

mavutil = pytest.importorskip(
    "pymavlink.mavutil", reason='pymavlink is not installed: pip install "navfilter[ardupilot]"'
)

BIN, TLOG = "ardupilot/ardusub_small.BIN", "ardupilot/ardusub_small.tlog"


def test_a_dataflash_log_in_its_own_units(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.imu]
file = "{log_sample(BIN)}"
topic = "IMU"
time = {{column = "TimeUS"}}
rate = ["GyrX", "GyrY", "GyrZ"]
force = ["AccX", "AccY", "AccZ"]
[streams.compass]
file = "{log_sample(BIN)}"
topic = "MAG[0]"
time = {{column = "log_time"}}
field = ["MagX", "MagY", "MagZ"]
[streams.attitude]
file = "{log_sample(BIN)}"
topic = "ATT"
time = {{column = "log_time"}}
attitude = ["Roll", "Pitch", "Yaw"]
"""
    )
    mission = nf.read_mission(tmp_path)
    imu = mission.streams["imu"]
    assert {name: len(stream) for name, stream in mission.streams.items()} == {
        "imu": 594,
        "compass": 237,
        "attitude": 237,
    }
    assert imu.time_s[0] == pytest.approx(265.678654, abs=1e-9)
    np.testing.assert_array_equal(imu.value[0, [0, 5]], np.float32([-0.007749793119728565, -9.770174026489258]))
    # Microseconds, mGauss and degrees: by the log's own UNIT and MULT, nothing is said in the mission.toml.
    np.testing.assert_allclose(mission.streams["compass"].value[0], np.array([-140, 63, 900]) * 1e-7, rtol=1e-12)
    np.testing.assert_allclose(
        np.degrees(mission.streams["attitude"].value[0]), [-0.08, -0.63, 213.93 - 360], atol=1e-9
    )


def test_one_topic_by_two_names(log_sample):
    path = log_sample(BIN)
    shelf = Shelf({path: {"IMU": {"GyrX"}, "IMU[0]": {"GyrY"}}})
    assert shelf.table(path, "IMU").raw("GyrX").size == shelf.table(path, "IMU[0]").raw("GyrY").size == 594


def test_a_unit_of_the_log_must_fit(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f'[streams.depth]\nfile = "{log_sample(BIN)}"\ntopic = "BARO[0]"\n'
        'time = {column = "log_time"}\ndepth = "Press"\n'
    )
    with pytest.raises(MissionError, match='column "Press" is in Pa by the file itself, depth needs length'):
        nf.read_mission(tmp_path)


def test_telemetry_of_a_bluerov(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.attitude]
file = "{log_sample(TLOG)}"
topic = "ATTITUDE"
time = {{column = "time_boot_ms", unit = "ms"}}
attitude = ["roll", "pitch", "yaw"]
[streams.depth]
file = "{log_sample(TLOG)}"
topic = "SCALED_PRESSURE2"
time = {{column = "time_boot_ms", unit = "ms"}}
pressure = "press_abs"
[streams.usbl]
file = "{log_sample(TLOG)}"
topic = "GPS_INPUT"
time = {{column = "log_time"}}
position = ["lat", "lon"]
"""
    )
    mission = nf.read_mission(tmp_path)
    counts = {name: len(stream) for name, stream in mission.streams.items()}
    assert counts["depth"] == 635 and counts["usbl"] == 1011 and counts["attitude"] > 5000
    assert mission.streams["depth"].value[0, 0] == pytest.approx(101580.0, abs=0.01)
    np.testing.assert_allclose(np.degrees(mission.streams["usbl"].value[0, :2]), [48.3861418, -124.6305732], atol=1e-9)
    assert any("4 messages with a wrong checksum" in note for note in mission.notes)
    with pytest.raises(MissionError, match=r"HEARTBEAT\[255.190\] \(265 records\) and HEARTBEAT\[1.100\]"):
        Shelf().table(log_sample(TLOG), "HEARTBEAT")


def test_position_changes_of_a_velocity_log_are_velocities(tmp_path):
    import struct

    from pymavlink.dialects.v20 import ardupilotmega

    sender = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=197)
    with (tmp_path / "dvl.tlog").open("wb") as file:
        for k in range(5):
            changes = ([0.0, 0.0, 0.001], [0.02 + 0.001 * k, -0.01, 0.0])
            message = sender.vision_position_delta_encode(1_000_000 + 100_000 * k, 100_000, *changes, 90.0)
            file.write(struct.pack(">Q", 1_700_000_000_000_000 + 100_000 * k) + message.pack(sender))
    table = Shelf().table(tmp_path / "dvl.tlog", "VISION_POSITION_DELTA")
    np.testing.assert_allclose(table.raw("velocity_x"), 0.2 + 0.01 * np.arange(5), rtol=1e-6)
    np.testing.assert_allclose(table.raw("velocity_y"), -0.1, rtol=1e-6)
    np.testing.assert_allclose(table.raw("log_time"), 1.7e9 + 0.1 * np.arange(5), atol=1e-5)
    assert table.raw("angle_delta[2]")[0] == np.float32(0.001)


def test_logs_that_are_cut_short_or_none(log_sample, tmp_path):
    for name, whole in (("cut.bin", log_sample(BIN).read_bytes()), ("cut.tlog", log_sample(TLOG).read_bytes())):
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    assert 100 < Shelf().table(tmp_path / "cut.bin", "IMU").raw("log_time").size < 594
    assert 1000 < Shelf().table(tmp_path / "cut.tlog", "ATTITUDE").raw("log_time").size < 5245
    (tmp_path / "no.bin").write_bytes(b"")
    with pytest.raises(MissionError, match="cannot be read as an ArduPilot log"):
        Shelf().table(tmp_path / "no.bin", "IMU")

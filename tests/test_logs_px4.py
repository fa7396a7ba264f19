"""PX4 logs: numbers as pyulog gives them, instruments told apart, what the autopilot lost."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf
from navfilter.models.mission import MissionError

pytest.importorskip("pyulog", reason='pyulog is not installed: pip install "navfilter[px4]"')

LOG = "px4/sample_log_small.ulg"


def test_imu_fixes_and_attitude(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.imu]
file = "{log_sample(LOG)}"
topic = "sensor_combined"
time = {{column = "timestamp", unit = "us"}}
rate = ["gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"]
force = ["accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"]
[streams.gps]
file = "{log_sample(LOG)}"
topic = "vehicle_gps_position"
time = {{column = "log_time"}}
where = {{column = "fix_type", at_least = 3}}
[streams.gps.position]
columns = [{{column = "lat", scale = 1e-7}}, {{column = "lon", scale = 1e-7}}, {{column = "alt", scale = 1e-3}}]
unit = ["deg", "deg", "m"]
[streams.attitude]
file = "{log_sample(LOG)}"
topic = "vehicle_attitude"
time = {{column = "log_time"}}
quaternion = ["q[0]", "q[1]", "q[2]", "q[3]"]
"""
    )
    mission = nf.read_mission(tmp_path)
    imu, gps = mission.streams["imu"], mission.streams["gps"]
    assert {name: len(stream) for name, stream in mission.streams.items()} == {"imu": 1298, "gps": 32, "attitude": 1298}
    assert imu.time_s[0] == pytest.approx(20.326716, abs=1e-9)
    np.testing.assert_array_equal(imu.value[0, :3], np.float32([0.0029683835, 0.0036462399, 0.0009424961]))
    assert imu.value[0, 5] == np.float32(-9.634243)
    np.testing.assert_allclose(np.degrees(gps.value[0, :2]), [63.4170622, 10.4082151], atol=1e-9)
    assert gps.value[0, 2] == pytest.approx(66.814)
    assert np.degrees(mission.streams["attitude"].value[0, 2]) == pytest.approx(13.9, abs=0.1)
    assert any("the autopilot could not write its log" in note for note in mission.notes)


def test_instruments_of_one_kind_are_told_apart(log_sample):
    shelf, path = Shelf(), log_sample(LOG)
    with pytest.raises(MissionError, match=r'"sensor_accel" is sensor_accel\[0\] \(6 records\) and'):
        shelf.table(path, "sensor_accel")
    assert shelf.table(path, "sensor_accel[2]").raw("x").size == 6
    with pytest.raises(MissionError, match=r'no field "q" \(fields: "log_time", "timestamp", "q\[0\]"'):
        Shelf({path: {"vehicle_attitude": {"q"}}}).table(path, "vehicle_attitude")
    with pytest.raises(MissionError, match='no topic "vehicle_nothing"'):
        shelf.table(path, "vehicle_nothing")


def test_a_log_cut_short_gives_what_it_holds(log_sample, tmp_path):
    whole = log_sample(LOG).read_bytes()
    (tmp_path / "cut.ulg").write_bytes(whole[: len(whole) // 2])
    readings = Shelf().table(tmp_path / "cut.ulg", "sensor_combined").raw("log_time").size
    assert 300 < readings < 1298
    (tmp_path / "no.ulg").write_bytes(whole[100:200])
    with pytest.raises(MissionError, match="cannot be read as a PX4 log"):
        Shelf().table(tmp_path / "no.ulg", "sensor_combined")

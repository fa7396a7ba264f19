"""Water Linked reports, one JSON object a line, as the instrument's manual describes them."""

import json

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf, format_of

VALID_US = 1_638_191_471_563_017


def velocity(k, valid=True, **others):
    transducers = [
        {"id": i, "velocity": 0.1, "distance": 0.55, "rssi": -30.5, "nsd": -88.7, "beam_valid": valid} for i in range(4)
    ]
    covariance = [[2.4e-8, -3.4e-9, -1.7e-9], [-3.4e-9, 1.5e-8, 4.0e-10], [-1.7e-9, 4.0e-10, 1.6e-9]]
    report = {"time": 106.4, "vx": 0.5 + 0.01 * k, "vy": -0.1, "vz": 0.02, "fom": 0.002, "covariance": covariance}
    report |= {"altitude": 1.2, "transducers": transducers, "velocity_valid": valid, "status": 0, "format": "json_v3.1"}
    times = {"time_of_validity": VALID_US + 100_000 * k, "time_of_transmission": VALID_US + 100_000 * k + 150_000}
    return report | {"type": "velocity"} | times | others


def position(k):
    return {
        "ts": 1_638_191_471.5 + 0.2 * k,
        "x": 12.4,
        "y": 64.6,
        "z": 1.8,
        "std": 0.002,
        "roll": 0.6,
        "pitch": 0.6,
    } | {
        "yaw": 19.3,
        "type": "position_local",
        "status": 0,
        "format": "json_v3.1",
    }


def test_a_captured_session(tmp_path):
    reports = [velocity(0), position(0), velocity(1), velocity(2, valid=False, vx=-8.1), position(1), velocity(3)]
    lines = [f"2021-11-29 13:11:11 INFO {json.dumps(r)}" for r in reports]
    (tmp_path / "dvl.log").write_text("\n".join([*lines, '{"response_to": "get_config", "type": "resp', "connected"]))
    assert format_of(tmp_path / "dvl.log").module == "waterlinked"
    (tmp_path / "mission.toml").write_text(
        """
[streams.dvl]
file = "dvl.log"
topic = "velocity"
time = {column = "log_time"}
velocity = ["vx", "vy", "vz"]
where = {column = "velocity_valid", equals = true}
[streams.attitude]
file = "dvl.log"
topic = "position_local"
time = {column = "log_time"}
attitude = {columns = ["roll", "pitch", "yaw"], unit = "deg"}
"""
    )
    mission = nf.read_mission(tmp_path)
    dvl = mission.streams["dvl"]
    np.testing.assert_array_equal(dvl.value, [[0.5, -0.1, 0.02], [0.51, -0.1, 0.02], [0.53, -0.1, 0.02]])
    np.testing.assert_allclose(dvl.time_s, 1e-6 * VALID_US + np.array([0.0, 0.1, 0.3]), atol=1e-6)
    assert np.degrees(mission.streams["attitude"].value[0, 2]) == pytest.approx(19.3)
    notes = " ".join(mission.notes)
    for reason in (
        "1 report cut short",
        "1 line without a report",
        "1 of 4 rows left out by where (velocity_valid = true)",
    ):
        assert reason in notes


def test_elements_of_lists_have_names(tmp_path):
    (tmp_path / "dvl.json").write_text(json.dumps(velocity(0)))
    table = Shelf().table(tmp_path / "dvl.json", "velocity")
    assert table.raw("covariance[1][1]")[0] == 1.5e-8
    assert table.raw("transducers[3].distance")[0] == 0.55


def test_old_reports_without_a_time_of_validity(tmp_path):
    old = [{key: value for key, value in velocity(k).items() if "time_of" not in key} for k in range(3)]
    (tmp_path / "dvl.json").write_text("\n".join(map(json.dumps, old)))
    time_s = Shelf().table(tmp_path / "dvl.json", "velocity").raw("log_time")
    np.testing.assert_allclose(np.diff(time_s), 0.1064, atol=1e-12)

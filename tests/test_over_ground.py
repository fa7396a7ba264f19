"""Speed and course over ground in a table are mapped: as what drives, or beside what does."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main

T = np.arange(600.0)
HEADING = np.radians(40.0) + 0.8 * np.sin(T / 40.0)
SPEED = 2.0 + 0.5 * np.sin(T / 25.0)
PLANE = np.cumsum(SPEED * np.exp(1j * HEADING))
FIXES = {"lat": 45.0 + np.degrees(PLANE.real / 6.371e6), "lon": 13.0 + np.degrees(PLANE.imag / 6.371e6) / np.sqrt(0.5)}
HDG = {"heading_true": np.degrees(HEADING)}
COG = {"COG": np.degrees(HEADING) % 360.0}


def drafted(folder, columns):
    table = {"time": T, **columns}
    rows = (",".join(f"{x:.8f}" for x in row) for row in zip(*table.values(), strict=True))
    (folder / "x.csv").write_text("\n".join([",".join(table), *rows]) + "\n")
    assert main(["mission", str(folder / "x.csv"), "--init", "--out", str(folder / "made"), "--quiet"]) == 0
    text = (folder / "made" / "mission.toml").read_text(encoding="utf-8")
    return nf.read_mission(folder / "made"), nf.read_vehicle(folder / "made"), text


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("SOG", 1.0),
        ("sog", 0.514444),
        ("Speed Over Ground [kn]", 0.514444),
        ("speed", 1 / 3.6),
        ("ground_speed_kn", 0.514444),
    ],
)
def test_speed_and_course_drive_where_nothing_else_does(tmp_path, name, factor):
    mission, _, text = drafted(tmp_path, {**FIXES, name: SPEED / factor, **COG})
    np.testing.assert_allclose(mission.streams["velocity"].value[:, 0], SPEED, rtol=1e-4)
    np.testing.assert_allclose(np.unwrap(mission.streams["attitude"].value[:, 2]), HEADING, atol=1e-6)
    assert "# GUESSED: the heading is COG" in text and "all forward" in text
    assert "course" not in mission.streams


def test_speed_alone_beside_a_heading(tmp_path):
    mission, _, text = drafted(tmp_path, {**HDG, "speed": SPEED})
    np.testing.assert_allclose(mission.streams["velocity"].value[:, 0], SPEED, rtol=1e-6)
    assert "# GUESSED: speed in m/s, over ground, is taken as all forward" in text


def test_speed_and_course_correct_where_a_log_drives(tmp_path):
    mission, vehicle, text = drafted(
        tmp_path, {**FIXES, **HDG, "stw": SPEED / 0.514444, "SOG": SPEED / 0.514444, **COG}
    )
    course = mission.streams["course"]
    np.testing.assert_allclose(course.value[:, 0], SPEED, rtol=1e-4)
    np.testing.assert_allclose(np.unwrap(course.value[:, 1]), HEADING, atol=1e-6)
    assert type(vehicle.sensors["course"]).__name__ == "Course" and "# GUESSED: SOG in kn, by the fixes" in text
    assert nf.replay(vehicle, mission).residuals["course"].count("used") > 500

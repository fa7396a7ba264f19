"""Surveyed places: read, compared by time or by the nearest approach, and through the command."""

import json
import math

import numpy as np
import pytest
from small_run import small_run

from navfilter.commands.cli import main
from navfilter.evaluation.assessment import ControlPoint, control_residuals, read_control_points
from navfilter.io import write_vehicle
from navfilter.models.mission import MissionError

EARTH_M = 6_371_000.0


@pytest.fixture(scope="module")
def track():
    return list(small_run()[1].values())[-1]


def beside(track, k, right_m, **more):
    """A place to the right of the way at a row."""
    north, east = np.diff(track.local()[k : k + 2, :2], axis=0)[0]
    away = np.array([-east, north]) / math.hypot(north, east) * right_m
    latitude = track.latitude[k] + away[0] / EARTH_M
    return ControlPoint("p", latitude, track.longitude[k] + away[1] / EARTH_M / math.cos(latitude), **more)


def test_the_nearest_approach_is_across_the_way(track):
    k = len(track) // 2
    (found,) = control_residuals(track, [beside(track, k, 0.7)])
    assert found.nearest and abs(found.time_s - track.time_s[k]) < 0.3
    assert found.distance_m == pytest.approx(0.7, rel=0.02) and math.isnan(found.up_m)
    covariance = track.covariance[k, :2, :2]
    low, high = np.sqrt(np.linalg.eigvalsh(covariance))
    assert 0.99 * low <= found.sd_m <= 1.01 * high and found.inside == (found.distance_m < 1.96 * found.sd_m)


def test_at_a_time_both_directions_count(track):
    k = len(track) // 2
    there = ControlPoint("p", track.latitude[k], track.longitude[k], track.height[k] - 2.0, track.time_s[k])
    (found,) = control_residuals(track, [there])
    assert not found.nearest and found.distance_m < 1e-6 and found.up_m == pytest.approx(2.0) and found.inside
    (far,) = control_residuals(track, [beside(track, k, 500.0, time_s=track.time_s[k])])
    assert not far.inside and far.distance_m == pytest.approx(500.0, rel=0.02) and "outside the 95 %" in str(far)
    (none,) = control_residuals(track, [ControlPoint("late", 0.1, 0.1, time_s=1e5)])
    assert none.inside is None and str(none) == "control point late: there is no track at its 100000.0 s"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,lat,longitude_deg\nA,1,2\n", "no column latitude_deg. Control points have"),
        ("name,latitude_deg,longitude_deg\nA,47.1,8\nB,4706.5,8\n", "row 2 is no place"),
    ],
)
def test_a_table_that_is_none_of_places_is_refused(tmp_path, text, words):
    (tmp_path / "gates.csv").write_text(text)
    with pytest.raises(MissionError, match=words):
        read_control_points(tmp_path / "gates.csv")


def test_a_replay_compares_its_track_with_them(tmp_path, capsys, track):
    mission, _ = small_run()
    mission.save(tmp_path / "dive.npz")
    write_vehicle(track.vehicle, tmp_path / "vehicle.toml")
    k = len(track) // 2
    latitude, longitude = np.degrees(track.latitude[k]), np.degrees(track.longitude[k])
    rows = f"gate <1>,{latitude:.9f},{longitude:.9f},\nend,{latitude:.9f},{longitude:.9f},{track.time_s[k]}\n"
    (tmp_path / "gates.csv").write_text("name,latitude_deg,longitude_deg,time_s\n" + rows)
    common = ["replay", str(tmp_path / "dive.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), "--smooth"]
    main([*common, "--out", str(tmp_path / "out"), "--control", str(tmp_path / "gates.csv")])
    assert "control point gate <1>, nearest at" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["control"]
    assert [one["nearest"] for one in found] == [True, False] and all(one["distance_m"] < 0.01 for one in found)
    assert "<td>gate &lt;1&gt;</td>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")

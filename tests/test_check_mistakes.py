"""Mistakes that a mapping makes, in missions as vehicles bring them: each is found, and none where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_check import MOTION, codes, mission, said

from navfilter.check import Finding, check_mission
from navfilter.io import read_mission, read_vehicle
from navfilter.models.mission import Mission, Stream
from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario

RECORDED = sorted(
    str(toml.parent.relative_to(Path(__file__).parent / "recordings"))
    for toml in (Path(__file__).parent / "recordings").glob("*/*/mission.toml")
)
#: True of these recordings, and said: the pool's iron and its depth gauge that is read too often, gaps of the DVL.
TRUE = ("iron", "held", "leaps", "gap")


def graver(findings: tuple[Finding, ...]) -> list[Finding]:
    return [f for f in findings if f.severity != "info" and f.code not in TRUE]


@pytest.fixture(scope="module")
def dive():
    """The mission of the manual's page "Replay your mission": fixes for 83 s at both ends, 2 m of error in each."""
    vehicle, mission = simulate_scenario("lawnmower", seed=42, duration_s=600)
    velocity = mission.streams["dvl"].value.copy()
    velocity[1200:1300] = np.nan
    return vehicle, replace(mission.with_stream("dvl", replace(mission.streams["dvl"], value=velocity)), truth=None)


def changed(mission: Mission, name: str, factor: object = 1.0, clock: float = 1.0) -> Mission:
    stream = mission.streams[name]
    return mission.with_stream(name, Stream(stream.time_s * clock, stream.value * factor, stream.columns))


def exchanged(mission: Mission, name: str) -> Mission:
    stream = mission.streams[name]
    return mission.with_stream(name, replace(stream, value=stream.value[:, [1, 0, 2]]))


# --- no false alarm -------------------------------------------------------------------------------------------------


def test_the_manual_s_own_example_is_sound(dive):
    vehicle, mission = dive
    for found in (check_mission(mission, vehicle), check_mission(mission)):
        assert [f for f in found if f.severity != "info"] == []
        assert any(f.code == "gap" and "434 s" in f.text for f in found)


@pytest.mark.parametrize("name", [name for name in SCENARIOS if name != "miscalibrated"])  # that one is not meant to be
def test_a_simulated_mission_is_sound(name):
    vehicle, mission = simulate_scenario(name, 1, min(SCENARIOS[name].duration_s, 600.0))
    assert graver(check_mission(mission, vehicle)) == []


@pytest.mark.parametrize("name", RECORDED)
def test_a_recording_is_read_and_is_sound(recording, name):
    mission = read_mission(recording(name))
    assert mission.duration_s > 50.0
    for stream_name, stream in mission.streams.items():
        assert len(stream) > 50, stream_name
        assert np.isfinite(stream.value).any(axis=0)[:2].all(), stream_name
    if "imu" in mission.streams:
        # Specific force at rest is -g along z (down); the pool vehicle was pitched by 17 degrees in one test.
        assert -10.2 < mission.streams["imu"].value[:, 5].mean() < -9.0
    found = check_mission(mission, read_vehicle(recording(name)))
    assert graver(found) == [] and not any(f.severity == "error" for f in found)


def test_fixes_at_the_surface_are_no_bursts_but_an_emptied_buffer_is():
    t = np.concatenate([np.arange(80.0), 500.0 + np.arange(80.0)])
    held = np.repeat(np.arange(32.0), 5) + 0.001 * np.random.default_rng(1).random(160).cumsum()
    for time_s, bursts in ((t, False), (np.sort(held), True)):
        series = Stream(time_s, np.random.default_rng(2).normal(size=160), ("depth_m",))
        assert (("depth", "stamps") in codes(Mission("x", {"depth": series}), "warning")) == bursts


# --- each mistake ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_vehicle", [True, False])
def test_milliseconds_read_as_seconds(dive, with_vehicle):
    vehicle, mission = dive
    found = check_mission(changed(mission, "imu", clock=1e3), vehicle if with_vehicle else None)
    assert [(f.stream, f.cure) for f in graver(found)] == [
        ("imu", 'Are these ms, read as seconds? Then unit = "ms" in time of [streams.imu].')
    ]


def test_the_clock_of_a_lone_inertial_unit_and_of_one_against_its_vehicle(dive):
    vehicle, mission = dive
    alone = replace(mission, streams={"imu": mission.streams["imu"]})
    assert "a sample every 10 s" in said(changed(alone, "imu", clock=1e3), "error")
    assert 'unit = "us"' in said(changed(alone, "imu", clock=1e6), "error")
    fast = check_mission(changed(mission, "imu", clock=1e-3), vehicle)
    assert any('unit = "s" in time of [streams.imu], not "ms"' in f.cure for f in fast if f.severity == "error")


def test_a_depth_that_counts_up(dive):
    vehicle, mission = dive
    found = graver(check_mission(changed(mission, "depth", -1.0), vehicle))
    assert [(f.severity, f.stream, f.code) for f in found] == [("error", "depth", "sign")]
    assert "scale = -1 in depth of [streams.depth]" in found[0].cure


def test_a_shallow_depth_that_counts_up_is_known_by_the_motion():
    # Too shallow to be told by its level: 0.8 m up and down, with the bow.
    t = MOTION["t"]
    pitch = 0.1 * np.sin(0.37 * t)
    depth = 1.0 + 1.5 * 0.1 / 0.37 * (np.cos(0.37 * t) - 1.0)
    attitude = Stream(t, np.column_stack([0.0 * t, pitch, MOTION["yaw"]]), ("roll_rad", "pitch_rad", "yaw_rad"))
    sound = mission().with_stream("attitude", attitude)
    for sign in (1.0, -1.0):
        text = said(sound.with_stream("depth", Stream(t[::20], sign * depth[::20], ("depth_m",))), "error")
        assert ("set scale = -1 in depth of [streams.depth]" in text) == (sign < 0.0)


@pytest.mark.parametrize("with_vehicle", [True, False])
def test_latitude_and_longitude_exchanged(dive, with_vehicle):
    vehicle, mission = dive
    found = graver(check_mission(exchanged(mission, "gps"), vehicle if with_vehicle else None))
    assert {f.stream for f in found} == {"gps"} and found[0].severity == "error"
    assert found[0].code == "exchanged"
    assert "Exchange the first two columns of position in [streams.gps]" in found[0].cure


def test_latitude_and_longitude_exchanged_where_both_are_usual():
    # 45 north, 7 east
    assert ("gps", "exchanged") in codes(exchanged(mission(), "gps"), "error")


def test_a_mirrored_velocity(dive):
    vehicle, mission = dive
    for factor in ([1, -1, 1], [1, -1, -1]):
        found = graver(check_mission(changed(mission, "dvl", factor), vehicle))
        assert [(f.severity, f.stream, f.code) for f in found] == [("error", "dvl", "axes")]
        assert 'axes = "x,-y,z" in velocity of [streams.dvl]' in found[0].cure


def test_fixes_that_err_mirror_no_velocity_that_is_hardly_sideways():
    vehicle, mission = simulate_scenario("lawnmower", seed=111, duration_s=600.0)
    assert not any(finding.code == "axes" for finding in check_mission(replace(mission, truth=None), vehicle))


def test_a_velocity_mirrored_and_not_turned_is_known_by_the_positions():
    assert ("dvl", "axes") in codes(mission(velocity=MOTION["v_b"] * [1, -1, 1]), "error")


def test_a_velocity_whose_z_axis_points_up(recording):
    sound, vehicle = read_mission(recording("snapir-auv-1hz/12")), read_vehicle(recording("snapir-auv-1hz/12"))
    found = graver(check_mission(changed(sound, "velocity", [1, 1, -1]), vehicle))
    assert [(f.severity, f.stream, f.code) for f in found] == [("error", "velocity", "sign")]
    assert 'axes = "x,-y,-z"' in found[0].cure


def test_a_mounting_error_is_still_found_in_the_manual_s_example(dive):
    vehicle, mission = dive
    c, s = np.cos(np.radians(15.0)), np.sin(np.radians(15.0))
    dvl = mission.streams["dvl"]
    turned = mission.with_stream("dvl", replace(dvl, value=dvl.value @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T))
    found = graver(check_mission(turned, vehicle))
    assert [(f.stream, f.code) for f in found] == [("dvl", "mounting")] and "by -1" in found[0].text

"""Smoothed more than once: a heading that was hardly known at the start, linearised anew."""

import json
from functools import cache

import numpy as np
import pytest

import navfilter as nf
from navfilter.calibration.parts import constants_of
from navfilter.calibration.passes import again, smoothed
from navfilter.commands.cli import main
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import survey_vehicle
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
WAY = Motion((ChangeSpeed(2.0, 20.0), Straight(120.0)), latitude_deg=54.0)
TURNS = Motion((ChangeSpeed(2.0, 20.0), *(Straight(20.0), Turn(60.0, 6.0)) * 4), latitude_deg=54.0)
#: No fix in between, and 200 m of way.
GAP_S = (8.0, 112.0)


def vehicle():
    """A velocity of unknown scale, a compass of unknown bias, fixes that are worth centimetres."""
    dvl = nf.BodyVelocity(rate_hz=5.0, error=nf.White(sd=0.01), scale_sd=0.005)
    compass = nf.Heading(rate_hz=5.0, error=nf.White(sd=2.0 * DEG), bias_sd_rad=6.0 * DEG)
    fixes = nf.Position(rate_hz=1.0, error=nf.White(sd=0.02), gate_timeout_s=0.5)
    return nf.Vehicle(survey_vehicle().drive, {"dvl": dvl, "compass": compass, "gps": fixes}, "vehicle")


@cache
def mission(seed):
    return simulate(vehicle(), WAY, seed=seed, duration_s=120.0, start=StartErrors(heading_sd_deg=8.0)).hide(
        "gps", GAP_S
    )


def judged(seed, passes):
    """Track; rms of the position and its NEES where there was no fix."""
    track = smoothed(vehicle(), mission(seed), passes)
    errors = track.errors(mission(seed).truth)
    gap = (track.time_s > GAP_S[0]) & (track.time_s < GAP_S[1])
    return track, np.sqrt(np.mean(errors.horizontal[gap] ** 2)), np.mean(track.nees(errors)["position"][gap])


def test_a_second_pass_gives_back_what_a_wrong_heading_took():
    found = np.array([[judged(seed, passes)[1:] for passes in (1, 2, 3)] for seed in range(16)])
    once, twice, thrice = np.sqrt(np.mean(found[..., 0] ** 2, axis=0))
    assert twice < 0.7 * once, found
    assert thrice < 1.05 * twice
    assert np.mean(found[:, 1, 1]) < np.mean(found[:, 0, 1])
    assert 0.5 < np.mean(found[:, 1, 1]) < 2.0, found


def test_another_pass_begins_where_the_smoother_says_and_believes_no_more():
    track = judged(1, 1)[0]
    before = mission(1).start
    moved, start = again(vehicle(), before, track)
    assert start.heading_deg == pytest.approx(np.degrees(track.attitude[0, 2]))
    assert (start.heading_sd_deg, start.position_sd_m) == (before.heading_sd_deg, before.position_sd_m)
    old, new = ({one.name: one for one in constants_of(of)} for of in (vehicle(), moved))
    for name, one in old.items():
        value = track.state(name)[0][-1]
        assert new[name].sd == one.sd
        of_heading = name.startswith("compass")
        assert new[name].value == pytest.approx(value if of_heading else one.value, abs=1e-12)
    assert abs(new["compass.bias"].value) > 0.5 * new["compass.bias"].sd / 6.0


def test_a_clock_of_the_compass_goes_into_its_key():
    """In both kinds of drives."""
    clock = {"time_offset_s": 0.2, "time_offset_sd_s": 0.1, "bias_sd_rad": 3.0 * DEG}
    compass = nf.Heading(rate_hz=5.0, error=nf.White(sd=1.0 * DEG), **clock)
    velocity = nf.BodyVelocity(rate_hz=5.0, error=nf.White(sd=0.01), scale_sd=0.01)
    reckoned = nf.DeadReckoning(rate_hz=5.0, attitude=compass, velocity=velocity)
    inertial = nf.Vehicle(vehicle().drive, vehicle().sensors | {"compass": compass})
    fixes = {"gps": nf.Position(error=nf.White(sd=1.0))}
    for made, name in ((inertial, "compass"), (nf.Vehicle(reckoned, fixes), "attitude")):
        run = simulate(made, TURNS, seed=2, duration_s=120.0)
        track = nf.replay(made, run, smooth=True)
        moved, _ = again(made, run.start, track)
        found = moved.drive.attitude if name == "attitude" else moved.sensors[name]
        value = track.state(f"{name}.time_offset")[0][-1]
        assert value != 0.0 and found.time_offset_s == pytest.approx(0.2 + value, abs=1e-12)
        assert found.time_offset_sd_s == 0.1


def test_one_pass_is_the_replay_and_passes_need_a_smoother(tmp_path, capsys):
    once, default = judged(1, 1)[0], nf.replay(vehicle(), mission(1), smooth=True)
    np.testing.assert_array_equal(once.latitude, default.latitude)
    with pytest.raises(ValueError, match="passes must be at least 1, found 0"):
        smoothed(vehicle(), mission(1), 0)
    lanes = nf.Vehicle(vehicle().drive, vehicle().sensors, dead_reckoning_lane=True)
    with pytest.raises(ValueError, match="a vehicle with lanes is smoothed once"):
        smoothed(lanes, mission(1))
    toml = write_vehicle(vehicle(), tmp_path / "vehicle.toml")
    mission(1).save(tmp_path / "m.npz")
    order = ["replay", str(tmp_path / "m.npz"), "--vehicle", str(toml), "--no-report", "--quiet", "--out"]
    assert main([*order, str(tmp_path / "out"), "--passes", "2", "--smooth"]) in (0, 1)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]["smoothed"]
    errors = smoothed(vehicle(), mission(1)).errors(mission(1).truth)
    assert summary["position_rms_m"] == pytest.approx(np.sqrt(np.mean(errors.horizontal**2)), rel=0.2)
    assert main([*order, str(tmp_path / "two"), "--passes", "2"]) == 2
    assert "give --smooth too" in capsys.readouterr().err

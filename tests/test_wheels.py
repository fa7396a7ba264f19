"""Wheels that do not slip, and a receiver's speed and course: what they bound, what spins, honest covariances."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from honest_runs import assert_honest

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import StartErrors, simulate

SEEDS = range(12)
MOTION = Motion((Wait(5.0), ChangeSpeed(5.0, 10.0), Lawnmower(4, 150.0)), latitude_deg=45.0, heading_deg=40.0)
#: The simulated vehicle slips not at all: what the filter takes for possible is as little.
FIRM = (nf.White(sd=0.05), nf.White(sd=0.01), nf.White(sd=0.01))


def vehicle_with(**sensors):
    gps = nf.Position(rate_hz=1.0, error=nf.White(sd=1.0))
    return nf.Vehicle(imu=nf.Imu(rate_hz=20), sensors={**sensors, "gps": gps})


@cache
def runs(kind):
    vehicle = vehicle_with(
        **{
            "wheels": {"wheels": nf.Odometer(rate_hz=10.0, error=FIRM, scale_sd=0.01, misalignment_sd_rad=0.01)},
            "course": {"course": nf.Course(rate_hz=1.0, lever_arm_b_m=(1.0, 0.2, -1.0))},
            "velocity": {"course": nf.Course(rate_hz=1.0, velocity=True, lever_arm_b_m=(1.0, 0.2, -1.0))},
        }[kind]
    )
    missions = [simulate(vehicle, MOTION, seed=seed, duration_s=150.0, start=StartErrors()) for seed in SEEDS]
    return [(mission, nf.replay(vehicle, mission)) for mission in missions]


@pytest.mark.parametrize("kind", ["wheels", "course", "velocity"])
def test_the_covariance_is_honest(kind):
    # nothing slips sideways: with wheels the filter is a little too modest
    assert_honest(runs(kind), 60.0, 149.0, least=0.3 if kind == "wheels" else 1.0)
    if kind != "wheels":
        nis = np.concatenate([t.residuals["course"].nis / t.residuals["course"].dof for _, t in runs(kind)])
        assert 0.9 < float(np.mean(nis)) < 1.1  # 1800 readings of two components: sd 0.024


def without_fixes(mission, from_s):
    return mission.hide("gps", (from_s, 1e9))


def test_wheels_carry_the_position():
    """A minute and a half without fixes: the inertial unit alone is lost, wheels err by their share of the way."""
    vehicle = vehicle_with(wheels=nf.Odometer(rate_hz=10.0, error=FIRM, scale_sd=0.01))
    mission = without_fixes(simulate(vehicle, MOTION, seed=3, duration_s=150.0), 60.0)
    alone = nf.replay(vehicle.without("wheels"), mission).errors(mission.truth).horizontal[-1]
    track = nf.replay(vehicle, mission)
    held = track.errors(mission.truth).horizontal[-1]
    assert held < 10.0 and held < 0.3 * alone  # 450 m; 1 % of scale, fitted a little before
    forward = replace(vehicle.sensors["wheels"], constrained=False)
    loose = nf.replay(vehicle_with(wheels=forward), mission)
    free, bound = (np.sqrt(np.trace(t.covariance[-1, 3:6, 3:6])) for t in (loose, track))
    assert bound < 0.7 * free  # sideways and upwards only the constraints bound the velocity


def test_a_wheel_that_spins_is_left_out_alone():
    mission, _ = runs("wheels")[0]
    stream = mission.streams["wheels"]
    value = stream.value.copy()
    value[800:830, 0] += 3.0
    vehicle = vehicle_with(wheels=nf.Odometer(rate_hz=10.0, error=FIRM, scale_sd=0.01, misalignment_sd_rad=0.01))
    track = nf.replay(vehicle, mission.with_stream("wheels", replace(stream, value=value)))
    residuals = track.residuals["wheels"]
    assert np.all(residuals.dof[800:830] == 2.0) and np.isnan(residuals.sd[800:830, 0]).all()
    assert residuals.count("rejected") == 0 and np.all(residuals.dof[:790] == 3.0)


def test_scale_comes_out():
    z = []
    for mission, track in runs("wheels"):
        note = next(note for note in mission.notes if note.startswith("wheels: scale"))
        value, sd = track.state("wheels.scale")
        z.append((value[-1] - float(note.split()[3])) / sd[-1])
        assert sd[-1] < 0.5 * sd[0]
    assert 0.2 < float(np.mean(np.square(z))) < 2.7  # of twelve squares, all but one case of a thousand


def test_a_course_bounds_the_velocity_without_fixes():
    mission, _ = runs("course")[1]
    vehicle = vehicle_with(course=nf.Course(rate_hz=1.0, lever_arm_b_m=(1.0, 0.2, -1.0)))
    lost = without_fixes(mission, 60.0)
    errors = nf.replay(vehicle, lost).errors(mission.truth)
    alone = nf.replay(vehicle.without("course"), lost).errors(mission.truth)
    level = np.hypot(errors.velocity_n[:, 0], errors.velocity_n[:, 1])
    assert level[-1] < 0.4 and errors.horizontal[-1] < 0.3 * alone.horizontal[-1]


def test_what_is_no_reading():
    wheels, course, velocity = nf.Odometer(), nf.Course(), nf.Course(velocity=True)
    assert wheels.read(np.array([0.0])).tolist() == [0.0, 0.0, 0.0]
    assert wheels.read(np.array([math.nan])) is None and wheels.read(np.array([1e3])) is None
    assert np.isnan(nf.Odometer(constrained=False).read(np.array([2.0]))[1:]).all()
    north, east, down = course.read(np.array([2.0, 0.5 * math.pi]))
    assert (north, east) == pytest.approx((0.0, 2.0)) and math.isnan(down)
    assert course.read(np.array([0.0, math.nan]))[:2].tolist() == [0.0, 0.0]
    for value in ([2.0, math.nan], [-1.0, 0.0], [1e3, 0.0], [math.nan, 0.0]):
        assert course.read(np.array(value)) is None
    assert velocity.read(np.array([1.0, 2.0, 3.0])).tolist() == [1.0, 2.0, 3.0]
    assert math.isnan(velocity.read(np.array([1.0, 2.0]))[2]) and velocity.read(np.array([1e3, 0.0, 0.0])) is None


def test_words_and_files(tmp_path):
    vehicle = vehicle_with(
        wheels=nf.Odometer(rate_hz=10.0, scale_sd=0.01),
        course=nf.Course(rate_hz=1.0),
        doppler=nf.Course(rate_hz=5.0, velocity=True),
    )
    text = describe_vehicle(vehicle)
    assert 'Sensor "wheels": forward speed of wheels, and none sideways or upwards, 10 Hz' in text
    assert 'Sensor "course": speed and course over ground, 1 Hz' in text and "error y and z" in text
    assert 'Sensor "doppler": velocity over ground, north, east, down, 5 Hz' in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    odd = vehicle_with(
        wheels=nf.Odometer(error=(nf.White(sd=0.05), nf.White(sd=0.001), nf.White(sd=0.1))),
        course=nf.Course(error=nf.White(sd=0.002)),
    )
    assert {f.stream for f in check_vehicle(odd) if f.severity == "warning"} == {
        "sensors.wheels.error.y",
        "sensors.course.error",
    }
    (tmp_path / "w.csv").write_text("t,rpm,kn,cog,vn,ve,vd\n0,60,2,350,1,2,3\n")
    head = 'file = "w.csv"\ntime = {column = "t"}\n'
    (tmp_path / "mission.toml").write_text(
        f'[streams.wheels]\n{head}wheel_speed = {{column = "rpm", unit = "rpm", radius_m = 0.5}}\n'
        f'[streams.course]\n{head}course = {{columns = ["kn", "cog"], unit = ["kn", "deg"]}}\n'
        f'[streams.doppler]\n{head}velocity_n = ["vn", "ve", "vd"]\n'
    )
    streams = nf.read_mission(tmp_path).streams
    np.testing.assert_allclose(streams["wheels"].value, [[math.pi]])
    np.testing.assert_allclose(streams["course"].value, [[2.0 * 1852.0 / 3600.0, math.radians(-10.0)]])
    np.testing.assert_allclose(streams["doppler"].value, [[1.0, 2.0, 3.0]])


def test_wrong_ones_are_refused():
    with pytest.raises(ValueError, match=r"Course\.lever_arm_b_m must be 3 finite"):
        nf.Course(lever_arm_b_m=(1.0,))
    with pytest.raises(ValueError, match="tuple of 3"):
        nf.Odometer(error=(nf.White(sd=0.1),))

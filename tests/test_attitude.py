"""An AHRS as a sensor: it bounds tilt and heading, its mounting is found, and without a yaw it still levels."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from honest_runs import assert_honest
from scipy.spatial.transform import Rotation

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.kernels import measurement
from navfilter.models.state import NavState, euler_from_matrix, matrix_from_euler
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

DEG = math.pi / 180.0
SEEDS = range(12)
WAY = (Wait(5.0), ChangeSpeed(1.5, 10.0), Dive(10.0), Lawnmower(3, 50.0))
MOTION = Motion(WAY, latitude_deg=26.0, heading_deg=40.0)
SLOW = (nf.GaussMarkov(sd=0.2 * DEG, tau_s=10.0),) * 2 + (nf.GaussMarkov(sd=0.5 * DEG, tau_s=20.0),)


def vehicle_with(**ahrs):
    given = {"error": SLOW, "mounting_rad": (0.05, -0.1, 1.5)} | ahrs
    # a poor inertial unit: its tilt is that of the AHRS
    gyro = nf.White(density=1e-3) + nf.RandomWalk(density=1e-5, start_sd=2e-3)
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20, gyro=gyro, accel=nf.White(density=5e-3) + nf.RandomWalk(density=1e-4, start_sd=0.05)),
        sensors={
            "ahrs": nf.Attitude(rate_hz=5.0, **given),
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01)),
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.05)),
            "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=1.0)),
        },
    )


def simulated(vehicle, seed, **faults):
    return simulate(vehicle, MOTION, seed=seed, duration_s=150.0, faults=faults, start=StartErrors(tilt_sd_deg=1.0))


@cache
def runs(misalignment_sd_rad):
    vehicle = vehicle_with(misalignment_sd_rad=misalignment_sd_rad)
    return [(mission, nf.replay(vehicle, mission)) for mission in (simulated(vehicle, seed) for seed in SEEDS)]


@pytest.mark.parametrize("misalignment_sd_rad", [0.0, 0.02])
def test_the_covariance_is_honest(misalignment_sd_rad):
    assert_honest(runs(misalignment_sd_rad), 60.0, 149.0, names=("position", "velocity", "attitude"))
    nis = np.concatenate([track.residuals["ahrs"].nis for _, track in runs(misalignment_sd_rad)])
    assert 0.95 < float(np.mean(nis)) / 3.0 < 1.05  # 9000 readings: sd 0.009


def test_the_mounting_is_found():
    mission, track = runs(0.02)[1]
    note = next(note for note in mission.notes if note.startswith("ahrs: misalignment"))
    for axis, truth in zip("xyz", map(float, note.split()[3:]), strict=True):
        value, sd = track.state(f"ahrs.misalignment_{axis}")
        assert sd[-1] < 0.8 * sd[0] and abs(value[-1] - truth) < 4.0 * sd[-1]


def test_without_a_yaw_it_levels():
    vehicle = vehicle_with(mounting_rad=(0.0, 0.0, 0.0))
    mission = simulated(vehicle, 4)
    stream = mission.streams["ahrs"]
    value = stream.value.copy()
    value[:, 2] = np.nan
    track = nf.replay(vehicle, mission.with_stream("ahrs", replace(stream, value=value)))
    assert np.all(track.residuals["ahrs"].dof == 2.0)
    assert np.abs(track.errors(mission.truth).attitude[track.time_s > 10.0, :2]).max() < 1.0 * DEG


def test_magnetic_north():
    vehicle = vehicle_with(magnetic=True, declination_rad=0.2)
    mission = simulated(vehicle, 2)
    plain = simulated(vehicle_with(), 2)
    apart = plain.streams["ahrs"].value[:, 2] - mission.streams["ahrs"].value[:, 2]
    np.testing.assert_allclose(np.mod(apart, 2.0 * math.pi), 0.2, atol=1e-9)
    errors = nf.replay(vehicle, mission).errors(mission.truth)
    assert np.abs(errors.heading[-1]) < 3.0 * DEG


def test_the_angles_are_those_of_the_instruments_own_axes():
    """Against rotations multiplied out; across half a turn, and none straight up."""
    mounting, turn = Rotation.from_euler("ZYX", [1.5, -0.1, 0.05]), np.array([0.01, -0.02, 0.03])
    state = NavState(0.0, 0.5, 0.1, 0.0, np.zeros(3), matrix_from_euler(0.3, -0.4, 3.1))
    axes = Rotation.from_matrix(state.C_nb) * mounting * Rotation.from_rotvec(turn).inv()
    cfg = np.concatenate([[0.0], mounting.as_matrix().ravel()])
    H, res = np.zeros((3, 12)), np.zeros(3)
    angles = euler_from_matrix(axes.as_matrix())
    angles[2] += 2.0 * math.pi
    measurement.attitude(angles, state.pack(), np.zeros(3), turn, cfg, H, res)
    np.testing.assert_allclose(res, 0.0, atol=2e-3)  # second order of 0.04 rad
    up = NavState(0.0, 0.5, 0.1, 0.0, np.zeros(3), matrix_from_euler(0.0, 0.5 * math.pi, 0.0))
    cfg[1:] = np.eye(3).ravel()
    measurement.attitude(np.zeros(3), up.pack(), np.zeros(3), np.zeros(3), cfg, H, res)
    assert np.isnan(res).all()


def test_words_and_files(tmp_path):
    vehicle = vehicle_with(misalignment_sd_rad=0.02)
    text = describe_vehicle(vehicle)
    assert 'Sensor "ahrs": attitude, 5 Hz' in text and "error roll and pitch" in text and "error yaw" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    odd = vehicle_with(mounting_rad=(0.0, 0.0, 30.0), misalignment_sd_rad=1.0, declination_rad=9.0, magnetic=True)
    assert {f.stream for f in check_vehicle(odd) if f.severity == "warning"} == {
        f"sensors.ahrs.{field}" for field in ("mounting_rad", "misalignment_sd_rad", "declination_rad")
    }
    (tmp_path / "a.csv").write_text("t,r,p,y,s\n0,1,2,350,0.5\n")
    (tmp_path / "mission.toml").write_text(
        '[streams.ahrs]\nfile = "a.csv"\ntime = {column = "t"}\n'
        'attitude = {columns = ["r", "p", "y"], unit = "deg"}\nsd = {column = "s", unit = "deg"}\n'
    )
    stream = nf.read_mission(tmp_path).streams["ahrs"]
    np.testing.assert_allclose(stream.value, [[1.0 * DEG, 2.0 * DEG, -10.0 * DEG]])
    np.testing.assert_allclose(stream.sd, [[0.5 * DEG]])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"mounting_rad": (1.0, 2.0)}, "mounting_rad"), ({"misalignment_sd_rad": -1.0}, "misalignment_sd_rad")],
)
def test_wrong_ones_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        nf.Attitude(**wrong)


def test_a_jump_of_one_angle_is_an_outlier():
    vehicle = vehicle_with()
    mission = simulated(vehicle, 6, ahrs=Faults(outlier_probability=0.02, outlier_sd=1.0))
    track = nf.replay(vehicle, mission)
    assert track.residuals["ahrs"].count("rejected") > 10
    assert np.abs(track.errors(mission.truth).heading[track.time_s > 20.0]).max() < 4.0 * DEG

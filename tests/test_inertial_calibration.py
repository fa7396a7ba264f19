"""Scale and misalignment of gyros and accelerometers: found with an honest sd, said where not, and cheap."""

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.calibration.parts import constants_of
from navfilter.check.plausibility import check_vehicle
from navfilter.evaluation.correlations import constants
from navfilter.filter.state_layout import Layout
from navfilter.io import write_vehicle
from navfilter.kernels import strapdown
from navfilter.models.mechanisation import CROSSED
from navfilter.models.sensors import Attitude
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, SpiralDive, Straight, Turn
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
SEEDS = 24
#: A MEMS unit: per cent and half degrees.
IMU = nf.Imu(
    rate_hz=20.0,
    gyro=nf.White(density=3e-4) + nf.RandomWalk(density=1e-6, start_sd=0.05 * DEG),
    accel=nf.White(density=2e-3) + nf.RandomWalk(density=1e-5, start_sd=0.02),
    gyro_scale_sd=0.01,
    gyro_misalignment_sd_rad=0.005,
    accel_scale_sd=0.005,
    accel_misalignment_sd_rad=0.004,
)
LEGS = (Straight(10.0), Turn(220.0, 15.0), Dive(8.0, pitch_deg=20.0), ChangeSpeed(2.5, 4.0), Turn(-180.0, 15.0))
LEGS += (SpiralDive(-8.0), ChangeSpeed(1.0, 3.0))
WAY = Motion((ChangeSpeed(1.5, 5.0), *LEGS, *LEGS), latitude_deg=45.0, depth_m=5.0, wander=Wander())


def vehicle_of(imu=IMU):
    angle = nf.White(sd=0.2 * DEG)
    sensors = {
        "ahrs": Attitude(rate_hz=5.0, error=angle),
        "gps": nf.Position(rate_hz=2.0, error=nf.White(sd=0.05)),
    }
    return nf.Vehicle(imu=imu, sensors=sensors)


def drawn(mission, triple):
    found = {}
    for what, names in (("scales", "xyz"), ("axes", [f"{'xyz'[i]}{'xyz'[j]}" for i, j in CROSSED[triple]])):
        note = next(note for note in mission.notes if note.startswith(f"{triple}: {what} error"))
        label = "scale" if what == "scales" else "misalignment"
        values = note.split("error ")[1].split()
        found |= {f"{triple}.{label}_{n}": float(v) for n, v in zip(names, values, strict=True)}
    return found


@pytest.mark.parametrize("increments", [False, True])
def test_calibration_is_found_with_an_honest_sd(increments):
    """Prior drawn as it is described; the squared error over the variance is 1 in the mean, that of the state too."""
    from dataclasses import replace

    vehicle = vehicle_of(replace(IMU, increments=increments))
    names = [p.name for p in vehicle.drive.parameters()]
    assert len(names) == 15
    square, gained, nees = [], [], []
    for seed in range(SEEDS if not increments else 8):
        mission = simulate(vehicle, WAY, seed=seed, start=StartErrors(heading_sd_deg=2.0))
        track = nf.replay(vehicle, mission)
        true = drawn(mission, "gyro") | drawn(mission, "accel")
        at = [track.state_names.index(name) for name in names]
        sd = track.states_sd[-1, at]
        square.append(((track.states[-1, at] - [true[name] for name in names]) / sd) ** 2)
        gained.append(sd / track.states_sd[0, at])
        figures = track.nees(track.errors(mission.truth))
        nees.append([figures[name][-1] for name in ("position", "velocity", "heading")])
    # 360 (120) nearly independent squares, and 24 (8) of three; 99.9 %
    low, high = (0.75, 1.3) if not increments else (0.6, 1.5)
    assert low < np.mean(square) < high, np.mean(square, axis=0)
    assert np.all((np.mean(nees, axis=0) > 0.3) & (np.mean(nees, axis=0) < 2.2)), np.mean(nees, axis=0)
    gained = dict(zip(names, np.median(gained, axis=0), strict=True))
    # turns tell the scale of the third gyro, gravity that of the third accelerometer but for its bias
    assert gained["gyro.scale_z"] < 0.3 and gained["gyro.misalignment_xz"] < 0.5
    assert {c.name for c in constants(track)} == set(names)


def test_scales_that_wander_are_followed_with_an_honest_sd():
    """Drawn as described, with a correlation time of a fifth of the mission: errors by their sd all along."""
    from dataclasses import replace

    imu = replace(IMU, gyro_misalignment_sd_rad=0.0, accel_misalignment_sd_rad=0.0)
    imu = replace(imu, gyro_scale_sd=0.02, gyro_scale_tau_s=30.0, accel_scale_tau_s=3000.0)
    vehicle, nees = vehicle_of(imu), []
    assert list(imu.wandering()) == [p.name for p in imu.parameters()]
    assert constants_of(vehicle) == ()
    for seed in range(8):
        mission = simulate(vehicle, WAY, seed=seed, start=StartErrors(heading_sd_deg=2.0))
        track = nf.replay(vehicle, mission)
        figures = track.nees(track.errors(mission.truth))
        nees.append([np.mean(figures[name][50:]) for name in ("position", "velocity", "heading")])
        sd = track.state("gyro.scale_z")[1]
    # what a turn has told is forgotten in the straight that follows
    assert sd.min() < 0.5 * sd.max() < 0.011
    assert np.all((np.mean(nees, axis=0) > 0.5) & (np.mean(nees, axis=0) < 1.6)), np.mean(nees, axis=0)


def test_without_the_keys_nothing_changes_and_with_them_live_is_replay(tmp_path):
    """Blocks, single samples and a snapshot half-way: the same to the last bit."""
    vehicle = vehicle_of()
    mission = simulate(vehicle, WAY, seed=3, duration_s=30.0)
    events = events_of(vehicle, mission)
    whole, half = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(whole, events)
    one_by_one(half, events[: len(events) // 2])
    half.snapshot(tmp_path / "state.nav")
    rest = nf.Navigator.restore(vehicle, tmp_path / "state.nav")
    one_by_one(rest, events[len(events) // 2 :])
    same_runs.assert_same_bits(whole, rest)
    assert Layout.of(nf.Vehicle(imu=nf.Imu(rate_hz=20.0))).drive.size == 6
    assert nf.Imu(rate_hz=20.0).memory(6)[strapdown.CALIBRATED] == 0.0


def test_rates_for_lever_arms_and_for_the_past_are_those_of_a_calibrated_unit():
    drv, x = IMU.memory(6), 0.01 * np.random.default_rng(0).normal(size=21)
    recent = np.column_stack([np.full(5, 0.05), np.random.default_rng(1).normal(size=(5, 6))])
    drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 6] = reading = recent[0, 1:].copy()
    drv[strapdown.CALIBRATION + drv[strapdown.ELEMENTS :][:15].astype(int)] = x[6:]
    M = np.zeros((6, 6))
    for q, (channel, axis, _) in enumerate(IMU._elements()):
        M[channel, 3 * (channel // 3) + axis] = x[6 + q]
    _, errors = IMU.outputs(np.hstack([np.eye(6), np.zeros((6, 15))]), drv, x)
    true = reading - M @ reading - x[:6]
    np.testing.assert_allclose(IMU.body_rate(drv, errors[:3]), true[:3], atol=1e-14)
    uncalibrated = drv.copy()
    uncalibrated[strapdown.CALIBRATED], uncalibrated[strapdown.CALIBRATION :][:18] = 0.0, 0.0
    plain, _ = nf.Imu(rate_hz=20.0).motion(recent, np.zeros(17), uncalibrated, np.zeros(6))
    moved, _ = IMU.motion(recent, np.zeros(17), drv, errors)
    np.testing.assert_allclose(moved[:, 1:], plain[:, 1:] - plain[:, 1:] @ M.T - x[:6], atol=1e-14)


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf])
def test_a_correlation_time_is_positive(value):
    with pytest.raises(ValueError, match="accel_scale_tau_s must be a finite number > 0"):
        nf.Imu(rate_hz=100.0, accel_scale_sd=0.01, accel_scale_tau_s=value)


def test_a_scale_that_wanders_cannot_be_calibrated():
    with pytest.raises(ValueError, match="is no constant state of it"):
        nf.Imu(rate_hz=100.0, gyro_scale_sd=0.01, gyro_scale_tau_s=9.0, calibrated=(("gyro.scale_x", 0.01, 0.001),))


@pytest.mark.parametrize(
    ("key", "value"),
    [("gyro_scale_sd", -0.1), ("accel_scale_sd", (0.1, 0.2)), ("gyro_misalignment_sd_rad", np.nan)],
)
def test_what_is_no_sd_is_refused(key, value):
    with pytest.raises(ValueError, match=f"Imu.{key} must be a finite number"):
        nf.Imu(rate_hz=100.0, **{key: value})


def test_keys_of_a_vehicle_toml(tmp_path):
    text = """
    [drive]
    type = "imu"
    rate_hz = 100
    gyro_scale_sd = 0.5
    gyro_misalignment_sd_deg = 0.3
    accel_scale_sd = [0.01, 0.02, 0.03]
    accel_scale_tau_s = 7200
    accel_misalignment_sd_deg = 30
    """
    (tmp_path / "vehicle.toml").write_text(text)
    vehicle = nf.read_vehicle(tmp_path)
    assert vehicle.drive.accel_scale_sd == (0.01, 0.02, 0.03) and vehicle.drive.gyro_scale_tau_s is None
    assert list(vehicle.drive.wandering()) == [f"accel.scale_{axis}" for axis in "xyz"]
    assert vehicle.drive.gyro_misalignment_sd_rad == pytest.approx(0.3 * DEG)
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")).drive == vehicle.drive
    doubted = {finding.stream for finding in check_vehicle(vehicle) if finding.severity == "warning"}
    assert {"drive.gyro_scale_sd", "drive.accel_misalignment_sd_rad"} <= doubted

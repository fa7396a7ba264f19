"""Fixes say that the antenna is above water: the depth gauge's offset is found by surfacings, with an honest sd."""

from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.check import check_mission
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Surface
from navfilter.simulation.motion import Motion
from navfilter.simulation.presets import tactical_imu
from navfilter.simulation.simulate import Faults, StartErrors, simulate

#: How well it is known how high the antenna stands above the water [m].
TRIM_M = 0.1
LEVEL = nf.White(sd=2.0)
GPS = nf.Position(
    error=(LEVEL, LEVEL, nf.GaussMarkov(sd=TRIM_M, tau_s=1e4)), lever_arm_b_m=(-0.4, 0.0, -0.2), antenna_height_m=0.2
)
DEPTH = nf.Depth(rate_hz=2.0, error=nf.White(sd=0.03), lever_arm_b_m=(0.2, 0.0, 0.1), offset_sd_m=0.5)
DVL = nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01))
VEHICLE = nf.Vehicle(imu=tactical_imu(20.0), sensors={"depth": DEPTH, "dvl": DVL, "gps": GPS})
START = StartErrors(position_sd_m=(2.0, 2.0, 1.0))


def dive(seed, vehicle=VEHICLE):
    way = (ChangeSpeed(1.5, 10.0), Straight(20.0), Dive(8.0), Straight(60.0), Surface(), Straight(20.0))
    motion = Motion(way, latitude_deg=45.0)
    afloat = (0.0, 30.0), (motion.duration_s - 20.0, motion.duration_s)
    faults = {"gps": Faults(available=afloat)}
    return simulate(vehicle, motion, seed=seed, faults=faults, start=START, truth_rate_hz=2.0)


def offset_of(mission):
    return float(next(note for note in mission.notes if note.startswith("depth: offset")).split()[-1])


def test_surfacings_tell_the_offset_with_an_honest_sd():
    square, gained, height = [], [], []
    for seed in range(20):
        mission = dive(seed)
        # it floats higher or deeper than is thought
        wrong_m = TRIM_M * np.random.default_rng(seed).standard_normal()
        gps = replace(GPS, antenna_height_m=0.2 + wrong_m)
        track = nf.replay(replace(VEHICLE, sensors={**VEHICLE.sensors, "gps": gps}), mission)
        at = track.state_names.index("depth.offset")
        sd = track.states_sd[-1, at]
        square.append((track.states[-1, at] - offset_of(mission)) ** 2 / sd**2)
        gained.append(sd)
        deep = track.time_s > 60.0
        error = track.errors(mission.truth).position_n[deep, 2]
        height.append(np.mean(error**2 / track.covariance[deep, 2, 2]))
    # 20 squares of one and the same normal variable each: 99.9 %
    assert 0.3 < np.mean(square) < 2.3 and 0.3 < np.mean(height) < 2.3
    assert 0.5 * TRIM_M < np.median(gained) < 1.3 * TRIM_M  # 0.5 m at the start


def test_calibrate_finds_the_offset_by_a_surfacing():
    """A gauge that is thought to be right; under water nothing tells the height, so the fixes at the surface decide."""
    sure, mission = replace(VEHICLE, sensors={**VEHICLE.sensors, "depth": replace(DEPTH, offset_sd_m=0.0)}), dive(5)
    result = nf.calibrate(sure, [mission], kinds=["offset"])
    (offset,) = result.found
    assert offset.name == "depth.offset" and offset.told and result.kept
    assert abs(offset.value - offset_of(mission)) < 3.0 * offset.sd < 0.6 * abs(offset_of(mission))
    assert result.vehicle.sensors["depth"].calibrated == (("offset", offset.value, offset.sd),)


def test_without_it_the_fixes_own_height_is_used_as_ever():
    own = replace(GPS, antenna_height_m=None)
    fix = np.array([0.8, 0.1, 55.0])
    assert own.read(fix).tolist() == fix.tolist() and GPS.read(fix).tolist() == [0.8, 0.1, 0.2]
    assert GPS.read(np.array([0.8, 0.1, np.nan])).tolist() == [0.8, 0.1, 0.2]
    assert GPS.read(np.array([0.0, 0.0, 1.0])) is None


def test_a_run_may_begin_by_it():
    vehicle = replace(VEHICLE, sensors={**VEHICLE.sensors, "compass": nf.Heading(rate_hz=4.0)})
    start = nf.align(vehicle, replace(dive(3, vehicle), start=None))
    # the antenna's arm of a vehicle that is not quite level
    assert start.height_m == pytest.approx(0.0, abs=0.02) and start.position_sd_m[2] == 1.0


def test_check_names_a_gauge_that_is_off():
    sure = replace(DEPTH, offset_sd_m=0.0)
    gps = replace(GPS, antenna_height_m=None, error=nf.White(sd=3.0))
    plain = replace(VEHICLE, sensors={"depth": sure, "gps": gps})
    told = replace(VEHICLE, sensors={"depth": sure, "gps": GPS})
    mission, good = dive(6), dive(6, told)
    off = offset_of(mission)
    assert abs(off) > 0.6
    found = [f for f in check_mission(mission, plain) if f.stream == "depth" and f.code == "datum"]
    assert len(found) == 1 and "offset_sd_m" in found[0].cure and "antenna_height_m" in found[0].cure
    found = [f for f in check_mission(mission, told) if f.code == "datum"]
    assert len(found) == 1 and "antenna_height_m" not in found[0].cure
    assert not [f for f in check_mission(good, plain) if f.code == "datum"]
    assert not [f for f in check_mission(mission, VEHICLE) if f.code == "datum"]
    doubted = {f.stream for f in check_vehicle(told)}
    assert "sensors.depth.offset_sd_m" in doubted
    assert "sensors.depth.offset_sd_m" not in {f.stream for f in check_vehicle(VEHICLE)}


def test_keys_of_a_vehicle_toml(tmp_path):
    text = """
    [drive]
    type = "imu"
    rate_hz = 100
    [sensors.gps]
    type = "position"
    antenna_height_cm = 20
    error = {north = {model = "white", sd = 2}, east = {model = "white", sd = 2}, down = {model = "white", sd_cm = 10}}
    """
    (tmp_path / "vehicle.toml").write_text(text)
    vehicle = nf.read_vehicle(tmp_path)
    assert vehicle.sensors["gps"].antenna_height_m == pytest.approx(0.2)
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")).sensors == vehicle.sensors

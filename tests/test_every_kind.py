"""Every kind of sensor and drive in the compiled path: in stretches as reading by reading and as live, to the last bit;
and as by the Python that users' own kinds go through.
"""

from dataclasses import replace
from functools import cache

import feeding
import numpy as np
import pytest
import same_runs
from test_passage import assert_same, changed, one_by_one

import navfilter as nf
from navfilter.navigation import runner
from navfilter.playback.replay import at_the_end
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

DEG = np.pi / 180.0
MOTION = Motion(
    (
        Wait(4.0),
        ChangeSpeed(1.5, 3.0),
        Turn(90.0, 8.0),
        Straight(6.0),
        Turn(-120.0, 10.0),
        ChangeSpeed(0.0, 3.0),
        Wait(4.0),
    ),
    latitude_deg=26.0,
    heading_deg=40.0,
)
BEACONS = ((26.0009, 0.0, -40.0), (26.0, 0.001, -40.0), (25.9994, -0.0007, -40.0))
COLOURED = nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.01)
ARM = {"lever_arm_b_m": (0.5, 0.0, 0.1), "lever_arm_sd_m": (0.2, 0.1, 0.1)}
COMPASS = nf.Heading(rate_hz=4, error=nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG))
DVL = nf.BodyVelocity(rate_hz=4, error=COLOURED, scale_sd=0.003)
DEPTH = nf.Depth(rate_hz=1, error=nf.White(sd=0.05))
FIX = nf.Position(rate_hz=1, error=nf.White(sd=1.0))


def calibrating(imu):
    """Everything about a survey vehicle that may be a constant state."""
    return nf.Vehicle(
        imu=imu,
        sensors={
            "compass": replace(COMPASS, time_offset_sd_s=0.1, bias_sd_rad=0.05, deviation_sd_rad=(0.02, 0.02)),
            "dvl": replace(DVL, scale_sd=(0.01,) * 3, misalignment_sd_rad=0.02, time_offset_sd_s=0.2, **ARM),
            "depth": replace(DEPTH, time_offset_sd_s=0.3, offset_sd_m=0.2, **ARM),
            "gps": replace(FIX, time_offset_sd_s=0.2, **ARM),
            "log": nf.WaterVelocity(rate_hz=2, lever_arm_sd_m=(0.1, 0.1, 0.0)),
        },
    )


def reckoning(**others):
    velocity = nf.BodyVelocity(rate_hz=5.0, error=nf.White(sd=0.02), scale_sd=0.01, **others)
    heading = nf.Heading(rate_hz=5.0, error=nf.GaussMarkov(sd=0.01, tau_s=20.0), deviation_sd_rad=(0.02, 0.02))
    return nf.DeadReckoning(rate_hz=5.0, attitude=heading, velocity=velocity)


CALIBRATION = {
    "gyro_scale_sd": 0.01,
    "gyro_misalignment_sd_rad": 0.01,
    "accel_scale_sd": 0.01,
    "accel_misalignment_sd_rad": 0.01,
}
VEHICLES = {
    "constants": calibrating(nf.Imu(rate_hz=50, **CALIBRATION)),
    "increments": calibrating(nf.Imu(rate_hz=50, increments=True, **CALIBRATION)),
    "acoustics": nf.Vehicle(
        imu=nf.Imu(rate_hz=50),
        sensors={
            "compass": COMPASS,
            "beams": nf.DvlBeams(rate_hz=4, current_sd_m_s=0.2, scale_sd=0.01, lever_arm_b_m=(0.5, 0.0, 0.1)),
            "lbl": nf.Range(rate_hz=1, beacons=BEACONS, beacon_sd_m=(3.0, 3.0, 0.3), scale_sd=0.01, offset_sd_m=0.5),
            "usbl": nf.Usbl(rate_hz=0.5, scale_sd=0.01, misalignment_sd_rad=0.01, ship_sd_m=(1.0, 1.0, 0.3)),
            "depth": DEPTH,
        },
    ),
    "late acoustics": nf.Vehicle(
        imu=nf.Imu(rate_hz=50),
        sensors={
            "compass": COMPASS,
            "beams": nf.DvlBeams(rate_hz=4, time_offset_sd_s=0.1, **ARM),
            "lbl": nf.Range(rate_hz=1, beacons=BEACONS, time_offset_sd_s=0.1, **ARM),
            "usbl": nf.Usbl(rate_hz=0.5, time_offset_sd_s=0.2, **ARM),
            "depth": DEPTH,
        },
    ),
    "on land": nf.Vehicle(
        imu=nf.Imu(rate_hz=50),
        sensors={
            "still": nf.ZeroVelocity(rate_hz=1),
            "turning": nf.ZeroRate(rate_hz=1),
            "ahrs": nf.Attitude(rate_hz=5, misalignment_sd_rad=0.02),
            "course": nf.Course(rate_hz=2, lever_arm_b_m=(0.5, 0.0, 0.1)),
            "wheels": nf.Odometer(rate_hz=10, scale_sd=0.02, time_offset_sd_s=0.1),
            "field": nf.Heading(rate_hz=4, magnetometer=True, declination_rad=0.0, hard_iron_sd=2.0, soft_iron_sd=0.02),
            "bottom": nf.Altitude(rate_hz=1),
            "gps": FIX,
        },
    ),
    "reckoned": nf.Vehicle(reckoning(), {"gps": FIX, "depth": DEPTH}),
    "reckoned, clocks": nf.Vehicle(
        reckoning(time_offset_sd_s=0.2, **ARM), {"gps": replace(FIX, time_offset_sd_s=0.3, **ARM), "depth": DEPTH}
    ),
}


@cache
def mission_of(name):
    vehicle = VEHICLES[name]
    faults = {sensor: Faults(time_offset_s=0.03) for sensor, kind in vehicle.sensors.items() if not kind.from_drive}
    return simulate(vehicle, MOTION, seed=5, faults=faults, start=StartErrors((2.0, 2.0, 0.5)))


def defective(mission, vehicle):
    """Outliers, a value repeated for long, stamps that come twice, samples that are missing."""
    for name, sensor in vehicle.sensors.items():
        if sensor.from_drive:
            continue
        stream = mission.streams[name]
        value, stamps = stream.value.copy(), stream.time_s.copy()
        value[len(value) // 3] += 5.0
        value[len(value) // 2 :][:4] = value[len(value) // 2]
        stamps[-2] = stamps[-3]
        mission = changed(mission, name, value=value, time_s=stamps)
    if vehicle.drive.inertial:
        imu = mission.streams["imu"]
        keep = np.ones(len(imu.time_s), bool)
        keep[700:712] = False
        return changed(mission, "imu", time_s=imu.time_s[keep], value=imu.value[keep])
    return mission


@pytest.mark.parametrize("defects", [False, True])
@pytest.mark.parametrize("name", VEHICLES)
def test_in_stretches_as_one_by_one_and_live(name, defects, monkeypatch):
    vehicle, mission = VEHICLES[name], mission_of(name)
    if defects:
        mission = defective(mission, vehicle)
    monkeypatch.setattr(runner, "READINGS", 60)
    calls = []
    call = runner.BatchRunner._call
    monkeypatch.setattr(runner.BatchRunner, "_call", lambda self: calls.append(call(self)) or calls[-1])
    together = nf.replay(vehicle, mission, smooth=True)
    taken = sum(residuals.count("used") for residuals in together.residuals.values())
    assert 0 < len(calls) < 0.5 * taken or defects
    end_state = at_the_end(vehicle, mission)
    one_by_one(monkeypatch)
    assert_same(together, nf.replay(vehicle, mission, smooth=True))
    nav = nf.Navigator(vehicle, mission.start, history_s=0.0)
    feeding.one_by_one(nav, feeding.events_of(vehicle, mission))
    nav.finish()
    same_runs.assert_same_bits(nav, end_state)
    assert {n: w.health(nav.time_s) for n, w in nav.sensor_monitors.items()} == {
        n: w.health(nav.time_s) for n, w in end_state.sensor_monitors.items()
    }


def test_beams_that_are_learnt_go_reading_by_reading():
    """They have more directions than an ear of the kernel holds."""
    vehicle = VEHICLES["acoustics"]
    learning = vehicle.with_error(beams=(nf.LearnedArma(),) * 4 + (nf.White(sd=0.02),) * 4)
    track = nf.replay(learning, mission_of("acoustics"))
    assert track.residuals["beams"].count("used") > 100

"""A DVL that is read beam by beam speaks against the drive like one with three axes."""

import dataclasses

import numpy as np
import pytest
from faults_run import dived
from feeding import DRIVE, events_of, one_by_one

import navfilter as nf
from navfilter.faults import alternative_path, ground_velocity
from navfilter.faults.imu import realignment
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import simulate

FAULT_S, END_S = 120.0, 170.0


@pytest.fixture(scope="module")
def dive():
    plain = survey_vehicle()
    dvl = nf.DvlBeams(rate_hz=4.0, error=nf.White(sd=0.02), lever_arm_b_m=plain.sensors["dvl"].lever_arm_b_m)
    vehicle = dataclasses.replace(plain, sensors={**plain.sensors, "dvl": dvl})
    return vehicle, simulate(vehicle, survey(END_S, surface_s=100.0), seed=1, duration_s=END_S)


@pytest.mark.parametrize(
    ("sensor", "change"),
    [
        (DRIVE, lambda v: v + 0.5 * np.eye(6)[3]),
        (DRIVE, lambda v: v[[0, 1, 2, 4, 3, 5]]),
        ("dvl", lambda v: -v),
    ],
    ids=["accelerometer +50 mg", "accelerometers exchanged", "sign of the beams"],
)
def test_a_fault_of_the_drive_or_of_the_beams_loses_nothing(dive, sensor, change):
    """A kilometre and a half, and 500 m, in four minutes before."""
    nav, error_m = dived(*dive, sensor, change, FAULT_S)
    assert error_m < 6.0 and error_m < nav.state.bounds.horizontal_m
    if sensor == DRIVE:
        assert nav.counts["contradicted"] or nav.counts["realigned"]
    else:
        assert nav.counts["jumped"] == 1


def test_residuals_of_beams_are_a_velocity(dive):
    vehicle, mission = dive
    nav, _ = dived(vehicle, mission, "dvl", lambda v: v, FAULT_S)
    channel, state = nav.filter.channels["dvl"], nav.filter.memory.nav
    off_b, seen = np.array([0.3, -0.2, 0.1]), np.ones(4, bool)
    beams = vehicle.sensors["dvl"].beams() @ off_b
    for _ in range(2):  # three beams of four tell it, too
        off = ground_velocity.as_velocity(channel, seen) @ beams[seen]
        np.testing.assert_allclose(state[6:15].reshape(3, 3).T @ off, off_b, atol=1e-3)
        seen[0] = False


def test_a_water_track_that_is_refused_says_nothing_of_the_velocity_over_ground(dive):
    vehicle, mission = dive
    water = dataclasses.replace(vehicle.sensors["dvl"], current_sd_m_s=0.3)
    vehicle = dataclasses.replace(vehicle, sensors={**vehicle.sensors, "dvl": water})
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(nav, [e for e in events_of(vehicle, mission.between(0.0, 20.0)) if e.sensor != "dvl"])
    channel = nav.filter.channels["dvl"]
    channel.faults.rejected_since_s = channel.memory.last_s = nav.time_s
    channel.note[3 : 3 + channel.axes] = [np.nan] * 4 + [0.5] * 4
    assert realignment._refused_velocity(nav.filter) is None
    way = alternative_path.with_rejected(nav.filter, channel, nav.time_s + 0.5)
    assert (way.north, way.east, way.length) == (0.0, 0.0, 0.0)

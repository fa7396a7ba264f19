"""An AHRS and a magnetometer are compasses, wheels and a log speak of the velocity, and fixes are all that a boat has,
where something goes wrong.
"""

import dataclasses
import math

import numpy as np
import pytest
from faults_run import dived, truth_at
from feeding import DRIVE

import navfilter as nf
from navfilter.kernels import batch
from navfilter.models.fault_bias import FaultBias, deviations, offset_states, with_offsets
from navfilter.simulation.scenarios import COMPASS, survey, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG = math.pi / 180.0
FAULT_S, END_S = 120.0, 170.0


def mission_of(leave_out, **sensors):
    plain = survey_vehicle()
    kept = {name: sensor for name, sensor in plain.sensors.items() if name != leave_out}
    vehicle = dataclasses.replace(plain, sensors={**kept, **sensors})
    return vehicle, simulate(vehicle, survey(END_S, surface_s=100.0), seed=1, duration_s=END_S)


@pytest.fixture(scope="module")
def ahrs():
    tilt = nf.GaussMarkov(sd=0.3 * DEG, tau_s=30.0) + nf.White(sd=0.05 * DEG)
    errors = (tilt, tilt, COMPASS + nf.White(sd=0.1 * DEG))
    return mission_of("compass", ahrs=nf.Attitude(rate_hz=8.0, error=errors))


@pytest.fixture(scope="module")
def wheels():
    sideways = nf.White(sd=0.05)
    return mission_of("dvl", wheels=nf.Odometer(rate_hz=10.0, error=(nf.White(sd=0.02), sideways, sideways)))


def heading_error(nav, mission):
    return abs(nav.state.minus(truth_at(mission.truth, nav.time_s))[8])


def test_a_start_that_looks_the_wrong_way_is_turned_by_an_ahrs(ahrs):
    """500 m off in the dive, with a sd of 17 m, where nobody heard it."""
    vehicle, mission = ahrs
    start = dataclasses.replace(mission.start, heading_deg=mission.start.heading_deg + 180.0, heading_sd_deg=5.0)
    nav, error_m = dived(vehicle, dataclasses.replace(mission, start=start), "ahrs", lambda v: v, FAULT_S)
    assert nav.counts["reset"] == 1 and error_m < 6.0 and heading_error(nav, mission) < 2.0 * DEG


def test_an_ahrs_that_is_turned_has_jumped(ahrs):
    """Refused for good, it took position and bounds with it once the gate had widened."""
    vehicle, mission = ahrs
    nav, error_m = dived(vehicle, mission, "ahrs", lambda v: v + math.pi * np.eye(3)[2], FAULT_S)
    assert nav.health.sensors["ahrs"].condition == "jumped"
    assert error_m < 6.0 and error_m < nav.state.bounds.horizontal_m
    assert heading_error(nav, mission) < min(2.0 * DEG, nav.state.bounds.heading_rad)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("ahrs", lambda v: v + 0.5 * np.eye(6)[3]),
        ("ahrs", lambda v: v[[0, 1, 2, 4, 3, 5]]),
        ("ahrs", lambda v: v * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]),
        ("wheels", lambda v: v + 0.5 * np.eye(6)[3]),
        ("wheels", lambda v: v[[0, 1, 2, 4, 3, 5]]),
    ],
    ids=["ahrs +50 mg", "ahrs swapped", "ahrs gyro z mirrored", "wheels +50 mg", "wheels swapped"],
)
def test_a_fault_of_the_unit_loses_nothing(request, kind, change):
    """With wheels five kilometres, for the speed alone was left out for good; with an AHRS half of one."""
    nav, error_m = dived(*request.getfixturevalue(kind), DRIVE, change, FAULT_S)
    assert error_m < 12.0 and error_m < nav.state.bounds.horizontal_m
    assert nav.counts["contradicted"] or nav.counts["realigned"]


def test_a_speed_that_is_left_out_for_five_seconds_is_refused_whole(wheels):
    """Until then sideways and upwards it goes on to count."""
    vehicle, mission = wheels
    track = nf.replay(vehicle, mission)
    assert track.residuals["wheels"].count("rejected") == 0
    stream = mission.streams["wheels"]
    value, at = stream.value.copy(), np.searchsorted(stream.time_s, FAULT_S)
    value[at:] += 1.0
    wrong = mission.with_stream("wheels", dataclasses.replace(stream, value=value))
    residuals = nf.replay(vehicle, wrong).residuals["wheels"]
    first = int(np.flatnonzero(residuals.outcome != residuals.outcome[0])[0])
    assert residuals.time_s[first] - FAULT_S == pytest.approx(5.0, abs=0.11)
    assert np.all(residuals.dof[at:first] == 2.0) and residuals.dof[first] == 3.0


@pytest.fixture(scope="module")
def boat():
    return mission_of("dvl")


@pytest.mark.parametrize(
    "change",
    [lambda v: v + 0.5 * np.eye(6)[3], lambda v: v[[1, 0, 2, 3, 4, 5]]],
    ids=["accelerometer +50 mg", "gyros swapped"],
)
def test_fixes_bring_a_state_back_that_goes_away_from_them(boat, change):
    """It went 5 and 40 km away from them, a fix a second, for they were refused and nothing else spoke for them."""
    nav, error_m = dived(*boat, DRIVE, change, 60.0, math.inf)
    assert error_m < 40.0 and error_m < nav.state.bounds.horizontal_m
    assert nav.counts["opened"] < 6 and nav.counts["opened"] + nav.counts["contradicted"] > 0


def test_fixes_that_jump_are_not_followed_without_a_velocity(boat):
    north = np.array([100.0 / 6.371e6, 0.0, 0.0])
    nav, error_m = dived(*boat, "gps", lambda v: v + north, 130.0, math.inf)
    assert nav.counts["opened"] == 0 and error_m < 30.0  # 40 s by the unit alone


def test_without_a_velocity_fixes_confirm_no_compass(boat):
    """The way that they show says nothing of the heading: its bound was 3 degrees, and it was 25 degrees off."""
    vehicle, mission = boat
    nav, error_m = dived(vehicle, mission, "compass", lambda v: v + 25.0 * DEG, 0.0, math.inf)
    assert heading_error(nav, mission) < nav.state.bounds.heading_rad and error_m < 10.0


@pytest.fixture(scope="module")
def magnetometer():
    plain = survey_vehicle()
    field = nf.Heading(rate_hz=8.0, error=COMPASS, magnetometer=True)
    vehicle = dataclasses.replace(plain, sensors={**plain.sensors, "compass": field})
    return vehicle, simulate(vehicle, survey(320.0, surface_s=100.0), seed=1, duration_s=320.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v * [-1.0, -1.0, 1.0],
        lambda v: v[[1, 0, 2]],
        lambda v: v * [-1.0, 1.0, 1.0],
        lambda v: v * [0.0, 1.0, 1.0],
        lambda v: v + 2.5,
    ],
    ids=["turned", "swapped", "mirrored", "one axis dead", "hard iron"],
)
def test_a_field_that_goes_wrong_takes_no_heading_with_it(magnetometer, change):
    """It was followed once the gate had widened, or drew the heading along in each turn: up to 180 degrees, at a sd of
    one.
    """
    nav, error_m = dived(*magnetometer, "compass", change, FAULT_S)
    assert error_m < 10.0 and error_m < nav.state.bounds.horizontal_m
    assert heading_error(nav, magnetometer[1]) < min(2.0 * DEG, nav.state.bounds.heading_rad)


def test_fixes_turn_a_magnetometer_that_is_mounted_the_wrong_way_round(magnetometer):
    """800 m off in the dive, with a sd of 2 m."""
    nav, error_m = dived(*magnetometer, "compass", lambda v: v * [-1.0, -1.0, 1.0], 0.0)
    assert nav.counts["jumped"] >= 1 and error_m < 15.0
    assert heading_error(nav, magnetometer[1]) < min(6.0 * DEG, nav.state.bounds.heading_rad)


def test_a_compass_near_iron_deviates_with_the_heading():
    """What iron does to it at one heading it does not do at another: beside the constant there are a sine and a
    cosine; a compass that looks the other way round has none.
    """
    near, other = (with_offsets((COMPASS,), size, only=0, deviates=True) for size in (0.2, math.pi))
    states, of_rad = deviations(near, 0.125)
    assert len(offset_states(near, 0.125)) == 3 and of_rad.tolist() == [0.0, 0.5 * math.pi]
    assert len(offset_states(other, 0.125)) == 1 and not deviations(other, 0.125)[0].size
    vehicle = survey_vehicle().with_error(compass=near[0])
    filter = nf.Navigator(vehicle, nf.Start(latitude_deg=26.0, longitude_deg=-80.0)).filter
    channel = filter.channels["compass"]
    nav, x = np.zeros(17), np.zeros(channel.group.start + channel.group.size)
    nav[6], nav[9] = math.cos(1.0), math.sin(1.0)
    table, at = filter.bench[channel.spot[batch.FAULTS] :], channel.group.start
    seen = channel.C, channel.near, channel.res
    batch.fault_states(table, np.zeros(1), nav, x, np.zeros(6), at, channel.spot[batch.NORTH], *seen, np.zeros(1), 0.0)
    np.testing.assert_allclose(channel.C[0, states], [math.cos(1.0), math.sin(1.0)], atol=1e-15)


@pytest.fixture(scope="module")
def log():
    return mission_of("dvl", water=nf.WaterVelocity(rate_hz=4.0, current_sd_m_s=0.1, current_tau_s=21600.0))


@pytest.mark.parametrize(
    "change",
    [lambda v: v + 0.5 * np.eye(6)[3], lambda v: v[[1, 0, 2, 3, 4, 5]]],
    ids=["accelerometer +50 mg", "gyros swapped"],
)
def test_a_log_speaks_against_the_unit_where_no_water_moves_so(log, change):
    """It was refused for good: three kilometres in four minutes."""
    nav, error_m = dived(*log, DRIVE, change, FAULT_S)
    assert error_m < 15.0 and error_m < nav.state.bounds.horizontal_m
    assert nav.counts["contradicted"] or nav.counts["realigned"]


def test_constants_of_one_component_only():
    models = with_offsets((nf.White(sd=0.1),) * 3, 2.0, at_m_s=1.5, only=0)
    assert [isinstance(model, nf.White) for model in models] == [False, True, True]
    assert offset_states(models, 1.0).tolist() == [0, 1] == offset_states(models, 1.0, 0).tolist()
    assert offset_states(models, 1.0, 2).size == 0
    assert with_offsets((nf.White(sd=0.1),) * 2, 2.0)[1] == nf.White(sd=0.1) + FaultBias(start_sd=2.0)

"""Velocities that are refused because the sensor is described wrongly, or the unit errs, in missions."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one
from scipy.linalg import expm
from test_alternatives import since
from test_fault_bank import SHIFT_S, long_dive

import navfilter as nf
from navfilter.evaluation.diagnostics import doubts, evidence
from navfilter.kernels import batch
from navfilter.kernels.strapdown import gravity
from navfilter.models.fault_bias import FaultDescription
from navfilter.models.state import matrix_from_euler

DEG = math.pi / 180.0


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rms(vehicle, mission):
    track = nf.replay(vehicle, mission)
    return track, math.sqrt(np.nanmean(np.sum(track.errors(mission.truth).position_n[:, :2] ** 2, axis=1)))


def told(vehicle, **wrong):
    sensors = {name: sensor for name, sensor in vehicle.sensors.items() if name != "gps"}
    sensors["dvl"] = dataclasses.replace(sensors["dvl"], **wrong)
    return dataclasses.replace(vehicle, sensors=sensors)


@pytest.mark.parametrize("states", [{}, {"lever_arm_sd_m": (0.2, 0.2, 0.2)}])
def test_a_lever_arm_told_wrongly_is_no_jump_of_the_sensor(states):
    """Each turn used to make a constant of it, which the next straight leg took for a velocity."""
    vehicle, mission = long_dive()
    wrong = told(vehicle, lever_arm_b_m=(3.0, 0.0, 0.0), **states)
    track, error = rms(wrong, mission)
    _, right = rms(told(vehicle), mission)
    every = {k: dataclasses.replace(s, gate_probability=1.0 - 1e-15) for k, s in wrong.sensors.items()}
    _, ungated = rms(dataclasses.replace(wrong, sensors=every), mission)
    assert track.counts["jumped"] == 0
    said = {finding.code for finding in doubts(track, mission, evidence(track))}
    assert ("arm-or-clock" in said) == (track.counts["arm-or-clock"] > 0) == (not states)  # a state follows by itself
    assert error < max(1.1 * ungated, 2.0 * right)
    if not states:
        assert estimates(track, 0, 3) == pytest.approx([-2.5, 0.0, 0.1], abs=0.3)
        assert track.bounds[-1, 0] < 300.0  # what the prior of an arm makes of a velocity is no drift


def estimates(track, first, count):
    """What is found of the description of the DVL, at the end."""
    at = track.state_names.index("dvl_x[0]") + first
    assert (track.states_sd[-1, at : at + count] < 0.3).all()
    return track.states[-1, at : at + count].tolist()


def test_a_lever_arm_told_wrongly_beside_a_clock_that_is_a_state():
    """The rate that it turns with is that of the stamp, whatever the clock's then is."""
    vehicle, mission = long_dive()
    track, _ = rms(told(vehicle, lever_arm_b_m=(3.0, 0.0, 0.0), time_offset_sd_s=0.1), mission)
    assert estimates(track, 0, 3) == pytest.approx([-2.5, 0.0, 0.1], abs=0.3)


def test_a_clock_told_wrongly_becomes_a_state():
    vehicle, mission = long_dive()
    dvl = mission.streams["dvl"]
    late = mission.with_stream("dvl", nf.Stream(dvl.time_s + 0.7, dvl.value, dvl.columns))
    track, error = rms(told(vehicle), late)
    _, right = rms(told(vehicle), mission)
    assert track.counts["arm-or-clock"] >= 1
    # by the acceleration at the stamp: turns that are shorter than that show less
    found = [error for _, models in track.error_models["dvl"][1:] for error in models]
    assert {part.component for part in found[0].terms if isinstance(part, FaultDescription)} == {3}
    assert error < 1.5 * right


@pytest.mark.parametrize("states", [{}, {"scale_sd": 0.005}])
def test_a_velocity_mounted_wrongly_keeps_no_depth_gauge_out(states):
    """Turned by 5 deg, it says that the vehicle sinks; a gauge was refused for as long as that went on."""
    vehicle, mission = long_dive()
    dvl, C = mission.streams["dvl"], matrix_from_euler(0.0, 5.0 * DEG, 0.0)
    error = nf.GaussMarkov(sd=0.003, tau_s=30.0) + nf.White(sd=0.01)
    turned = mission.with_stream("dvl", nf.Stream(dvl.time_s, dvl.value @ C, dvl.columns))
    track, _ = rms(told(vehicle, error=error, **states), turned)
    down = np.abs(track.errors(mission.truth).position_n[:, 2])
    assert down.max() < 10.0 and down[track.time_s > 300.0].max() < 1.0
    assert track.state("dvl_x[2]")[0][-1] == pytest.approx(5.0 * DEG, abs=1.0 * DEG)
    said = [finding for finding in doubts(track, mission, evidence(track)) if finding.code == "arm-or-clock"]
    assert [finding.stream for finding in said] == ["dvl"]
    assert float(said[0].text.split()[-2]) == pytest.approx(5.0, abs=1.0)  # of roll and pitch the latter


def test_what_is_found_of_a_description_is_the_same_live_and_restored():
    vehicle, mission = long_dive()
    wrong, mission = told(vehicle, lever_arm_b_m=(3.0, 0.0, 0.0)), mission.between(0.0, 400.0)
    events = events_of(wrong, mission)
    live, half = nf.Navigator(wrong, mission.start), nf.Navigator(wrong, mission.start)
    one_by_one(live, events)
    adopted = [time_s for time_s, _ in nf.replay(wrong, mission).error_models["dvl"]][1]
    one_by_one(half, [event for event in events if event.time_s <= adopted + 5.0])
    assert half.counts["arm-or-clock"] == 1
    again = nf.Navigator.restore(wrong, half.snapshot())
    one_by_one(again, [event for event in events if event.time_s > adopted + 5.0])
    same_runs.assert_same_bits(live, again)
    np.testing.assert_array_equal(nf.replay(wrong, mission).covariance[-1], live.covariance)


def test_jacobian_of_a_description_is_that_of_the_reading():
    """By differences: a velocity over ground, in the axes of an instrument that is turned, with a lever arm, late."""
    rng = np.random.default_rng(11)
    angles, rate, force, velocity = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    C, nav = matrix_from_euler(*angles), np.zeros(17)
    nav[0], nav[3:6], nav[6:15] = 0.5, velocity, C.reshape(-1)
    accelerated = C @ force + [0.0, 0.0, gravity(0.5, 0.0)]

    def reading(of):
        C_then = C @ expm(-of[3] * skew(rate))
        then = C_then.T @ (velocity - of[3] * accelerated) + np.cross(rate, of[:3])
        return expm(-skew([*of[4:], 0.0])) @ then

    table = np.array([0, 0, 0, 6, *itertools.chain(*([i, i, 3] for i in range(6)))], dtype=float)
    J, near = np.zeros((3, 6)), np.zeros((3, 9))
    near[:, 3:6] = C.T
    motion, none = np.concatenate([rate, force]), np.zeros(3)
    batch.fault_states(table, none, nav, np.zeros(20), motion, 9, -1, J, near, none, none, 0.0)
    steps = 1e-6 * np.eye(6)
    expected = np.column_stack([(reading(step) - reading(-step)) / 2e-6 for step in steps])
    np.testing.assert_allclose(J, expected, atol=1e-8)


def test_a_jump_that_begins_in_a_turn_is_told_after_it():
    """Until then a lever arm explains it as well."""
    vehicle, mission = long_dive()
    jumped = since(mission, "dvl", lambda v, age_s, C_nb: v + np.array([0.0, 0.3, 0.0]))
    track = nf.replay(vehicle, jumped, output_rate_hz=1.0)
    assert track.counts["jumped"] >= 1 and track.counts["arm-or-clock"] == 0
    named = [time_s for time_s, _ in track.error_models["dvl"][1:]]
    assert SHIFT_S < named[0] < SHIFT_S + 90.0


def test_a_unit_runs_away_from_a_velocity_that_nobody_had_tried_for_long():
    """Half a minute after the start an accelerometer jumps: what moved off from the DVL went on by itself, 450 m."""
    vehicle, mission = long_dive()
    imu = mission.streams["imu"]
    value = imu.value.copy()
    value[imu.time_s > imu.time_s[0] + 40.0, 4] += 0.3
    _, error = rms(told(vehicle), mission.with_stream("imu", dataclasses.replace(imu, value=value)))
    assert error < 25.0


@pytest.mark.parametrize("deg_s", [0.05, 0.1])
def test_a_gyro_that_jumps_is_not_taken_for_a_force(deg_s):
    """Without accelerometers nothing levels what it turns: the attitude ran away, known to a hundredth of a degree."""
    vehicle, mission = long_dive(500.0)
    jump = np.array([deg_s * DEG, 0.0, 0.0, 0.0, 0.0, 0.0])
    track = nf.replay(vehicle, since(mission, "imu", lambda v, age_s, C_nb: v + jump), output_rate_hz=1.0)
    late = track.time_s > SHIFT_S + 120.0
    assert np.nanmean(track.nees(track.errors(mission.truth))["attitude"][late]) < 2.0

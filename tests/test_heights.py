"""A depth gauge that leaves the state slowly: it or what carries the height is wrong, and the height is as unsure."""

import dataclasses
import functools
import math

import faults_run as watched
import numpy as np
from feeding import once_a_second

import navfilter as nf
from navfilter.faults import fault_bank
from navfilter.simulation.scenarios import lawnmower, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DURATION_S, DIVE_S, BACK_S, FAULT_S = 260.0, 100.0, 210.0, 120.0
#: Drift of the gauge, or of the height that the DVL makes [m/s].
DRIFT = 0.1


@functools.cache
def dive():
    """Fixes until the dive and after it; a gauge of which the gate does not wait for minutes."""
    plain = survey_vehicle()
    depth = dataclasses.replace(plain.sensors["depth"], gate_timeout_s=5.0)
    vehicle = dataclasses.replace(plain, sensors={**plain.sensors, "depth": depth})
    fixes = {"gps": Faults(available=((0.0, DIVE_S), (BACK_S, DURATION_S)))}
    return vehicle, simulate(vehicle, survey(DURATION_S), seed=4, duration_s=DURATION_S, faults=fixes)


def fly(name, drift):
    """Height error and its sd once a second, and the navigator; the readings of a sensor drift off."""
    vehicle, mission = dive()
    stream = mission.streams[name]
    value = stream.value + np.maximum(stream.time_s - FAULT_S, 0.0)[:, None] * drift
    mission = mission.with_stream(name, nf.Stream(stream.time_s, value, stream.columns))
    nav, rows = nf.Navigator(vehicle, mission.start), []
    for state in once_a_second(nav, vehicle, mission):
        down = state.minus(watched.truth_at(mission.truth, state.time_s))[2]
        rows.append((state.time_s, down, state.sd[2]))
    return np.array(rows), nav


def of(name):
    """What makes the gauge and the height part by `DRIFT`: a gauge, or a DVL that says that the vehicle sinks."""
    return np.array([DRIFT]) if name == "depth" else np.array([0.0, 0.0, 2e-3])


def test_a_gauge_that_leaves_slowly_makes_the_height_unsure():
    rows, nav = fly("depth", of("depth"))
    opened = rows[np.argmax(rows[:, 2] > 0.5) :]
    assert FAULT_S < opened[0, 0] < BACK_S and nav.counts["jumped"] > 1
    assert (np.abs(opened[:, 1]) < 3.0 * opened[:, 2]).all()


def test_a_vertical_velocity_that_drifts_is_found_and_leaves_the_height():
    rows, nav = fly("dvl", of("dvl"))
    assert nav.counts["jumped"] == 1 and nav.filter.channels["dvl"].offset
    assert np.abs(rows[rows[:, 0] > FAULT_S + 40.0, 1]).max() < 0.2


def test_what_innovations_told_before_a_gauge_was_opened_again_accuses_nothing_else():
    """The unit's gyros were given up for a gauge that drifts, and the state with them."""
    _, nav = fly("depth", of("depth"))
    opened_s = nav.filter.channels["depth"].faults.jumped_s
    assert nav.counts["jumped"] > 2 and opened_s > FAULT_S
    assert (fault_bank.parts(nav.filter.memory.monitor.bank)[0][:-1] >= opened_s).all()


def test_fixes_tell_the_height_then():
    rows, _ = fly("depth", of("depth"))
    late = rows[rows[:, 0] > BACK_S + 10.0]
    # their slow error is 3 m
    assert late[:, 2].max() < 3.5 and np.abs(late[:, 1]).max() < 9.0


def test_a_gauge_that_jumps_says_nothing_of_the_height():
    vehicle, mission = dive()
    stream = mission.streams["depth"]
    value = stream.value + np.where(stream.time_s > FAULT_S, 5.0, 0.0)[:, None]
    nav = nf.Navigator(vehicle, mission.start)
    states = list(once_a_second(nav, vehicle, mission.with_stream("depth", dataclasses.replace(stream, value=value))))
    assert nav.counts["jumped"] == 1 and max(s.sd[2] for s in states if s.time_s > FAULT_S) < 0.2
    assert not nav.filter.channels["depth"].faults.either and math.isclose(nav.errors["depth[0]"], 5.0, abs_tol=0.3)


def test_gauge_and_fixes_together_beat_the_height():
    """The DVL sinks, the unit's bias follows; after the dive fixes and gauge were refused for good, 26 m off at 1.3 m,
    for compass and DVL agreed.
    """
    vehicle = survey_vehicle().with_error(gps=nf.White(sd=0.1))
    mission = simulate(vehicle, lawnmower(400.0), seed=2, duration_s=400.0).hide("gps", (60.0, 300.0))
    dvl = mission.streams["dvl"]
    age_s = dvl.time_s - 120.0
    off = np.where((age_s > 0.0) & (age_s < 60.0), 0.005 * age_s, 0.0)[:, None] * np.eye(3)[2]
    track = nf.replay(vehicle, mission.with_stream("dvl", nf.Stream(dvl.time_s, dvl.value + off, dvl.columns)))
    down = track.errors(mission.truth).position_n[:, 2]
    late = track.time_s > 340.0
    assert np.abs(down[late]).max() < 0.3 and np.degrees(np.abs(track.errors(mission.truth).heading[late])).max() < 3.0


def test_a_gauge_whose_constant_turns_out_to_be_none_is_good_again():
    """It was right, and the DVL led the height off: fixes told so, and its constant stayed."""
    vehicle = dive()[0].with_error(gps=nf.White(sd=0.1))
    fixes = {"gps": Faults(available=((0.0, DIVE_S), (BACK_S, 320.0)))}
    mission = simulate(vehicle, survey(320.0), seed=4, duration_s=320.0, faults=fixes)
    dvl = mission.streams["dvl"]
    age_s = np.where(dvl.time_s < FAULT_S + 30.0, np.maximum(dvl.time_s - FAULT_S, 0.0), 0.0)
    value = dvl.value + age_s[:, None] * of("dvl")
    nav = nf.Navigator(vehicle, mission.start)
    list(once_a_second(nav, vehicle, mission.with_stream("dvl", dataclasses.replace(dvl, value=value))))
    assert nav.counts["jumped"] and nav.health.sensors["depth"].condition == "good"


def boat(velocity, gps, drift, end_s):
    """Errors of the height and their sd over the last 60 s of 400 s, with fixes throughout; the gauge drifts off from
    100 s on [m/s] until it is itself again.
    """
    depth = nf.Depth(error=nf.GaussMarkov(sd=0.02, tau_s=20.0))
    sensors = {"compass": nf.Heading(bias_sd_rad=0.01), **velocity, "depth": depth, "gps": gps}
    vehicle = nf.Vehicle(nf.Imu(rate_hz=20.0), sensors)
    always = {"gps": Faults(available="always")}
    mission = simulate(vehicle, lawnmower(400.0), seed=6, duration_s=400.0, faults=always)
    stream = mission.streams["depth"]
    off = np.where(stream.time_s < end_s, drift * np.maximum(stream.time_s - 100.0, 0.0), 0.0)
    mission = mission.with_stream("depth", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))
    track = nf.replay(vehicle, mission)
    late = track.time_s > 340.0
    return track.errors(mission.truth).position_n[late, 2], np.sqrt(track.covariance[late, 2, 2]), track


def test_a_gauge_that_drifts_is_not_followed_away_from_fixes():
    """Nothing but fixes carries the height: they were refused, place and all, for the gauge had been believed."""
    down, sd, track = boat({}, nf.Position(rate_hz=5.0, error=nf.White(sd=0.4)), 0.05, math.inf)
    assert np.mean((down / sd) ** 2) < 4.0 and sd.max() < 0.5
    assert track.residuals["gps"].count("rejected") < 0.05 * len(track.residuals["gps"].time_s)


def test_a_gauge_that_comes_back_from_a_drift_is_told_from_one_that_jumps_by_fixes():
    """By 1 cm/s the DVL's slow error follows; the height was then taken for right, 1.2 m off at 0.04 m."""
    dvl = nf.BodyVelocity(rate_hz=8.0, error=nf.GaussMarkov(sd=0.045, tau_s=3.0) + nf.White(sd=0.014))
    gps = nf.Position(rate_hz=0.5, error=nf.GaussMarkov(sd=0.8, tau_s=6.0) + nf.White(sd=0.3))
    down, sd, _ = boat({"dvl": dvl}, gps, 0.01, 220.0)
    assert np.mean((down / sd) ** 2) < 4.0 and sd.max() < 0.5

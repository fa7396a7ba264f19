"""Lanes of a vehicle that learns, and lanes whose unit something else stands in for."""

import math

import numpy as np
import pytest
from test_lanes import changed, fed, swapped, vehicle_of

import navfilter as nf
from navfilter.faults import settings as fault_settings
from navfilter.faults.lane_selection import LaneChoice
from navfilter.filter.records import Tape
from navfilter.learning.schedule import LearningSchedule
from navfilter.navigation.lanes.navigator import LaneReplay
from navfilter.simulation.scenarios import survey
from navfilter.simulation.simulate import Faults, simulate

END_S = 230.0
LEARNT = {
    "compass": nf.LearnedArma(prior=nf.GaussMarkov(sd=0.03, tau_s=60.0)),
    "depth": nf.LearnedArma(prior=nf.White(sd=0.5)),
}


def heard(gains, carried, seconds=20.0):
    """A choice between two units after readings of two sensors that each foretold with errors and sds [1], which
    something stood in for or not.
    """
    sensors = {"compass": nf.Heading(error=nf.White(sd=0.01)), "depth": nf.Depth(error=nf.White(sd=0.1))}
    choice = LaneChoice([True] * len(gains), sensors, 0.0)
    for k in range(round(seconds / fault_settings.LANE_STEP_S)):
        choice.decide_until((k + 0.5) * fault_settings.LANE_STEP_S)
        for lane, told in enumerate(gains):
            for sensor, (error, wider) in enumerate(told):
                sd = (0.01, 0.1)[sensor] * wider
                choice.compare(lane, sensor, k * fault_settings.LANE_STEP_S, [error * sd], [sd**2], carried[lane])
    choice.decide_until(seconds)
    return choice


def test_one_sensor_does_not_bring_back_a_unit_that_is_stood_in_for():
    """It follows a compass as dead reckoning does, right or wrong."""
    sound, follower = [(0.5, 4.0), (0.0, 1.0)], [(0.5, 1.0), (0.0, 1.0)]
    assert heard([sound, follower], [False, False]).memory.lane == 1
    assert heard([sound, follower], [False, True]).memory.lane == 0
    both = [(0.5, 4.0), (0.0, 2.0)]
    assert heard([both, follower], [False, True]).memory.lane == 1


def test_a_unit_that_is_stood_in_for_gives_way_to_one_that_feels():
    """What it loses, heading and place, shows in no reading before it is far off."""
    modest, sure = [(0.0, 1.05), (0.0, 1.0)], [(0.0, 1.0), (0.0, 1.0)]
    assert heard([modest, sure], [False, False]).memory.lane == 0
    choice = heard([modest, sure], [True, False])
    assert choice.memory.lane == 1 and choice.reason == "something stood in for the unit of the lane before"
    assert heard([sure, modest], [True, False]).memory.lane == 0
    assert heard([modest, sure], [True, True]).memory.lane == 0


def test_a_lane_that_foretells_better_is_not_doubted():
    """One that is sure of itself, and errs by more than it says, is short of more than one that says little."""
    modest, wrong, sure = (0.0, 16.0), (3.5, 2.0), (1.9, 1.0)
    choice = heard([[modest, modest], [sure, sure]], [False, False], 6.0)
    short = choice.memory.ring[..., 1].sum(axis=(0, 2))
    assert short[1] - short[0] > fault_settings.LANE_MARGIN and not choice.memory.doubted.any()
    assert heard([[modest, modest], [wrong, wrong]], [False, False], 6.0).memory.doubted.tolist() == [0.0, 1.0]


@pytest.fixture(scope="module")
def dive():
    """Of two units one fails for a while, and later the other one for good."""
    vehicle = vehicle_of("a", "b")
    fixes = {"gps": Faults(available=((0.0, 50.0),))}
    mission = simulate(vehicle, survey(END_S, surface_s=20.0), seed=31, duration_s=END_S, faults=fixes)
    mission = changed(mission, "a", swapped, begin_s=70.0, end_s=80.0)
    return vehicle.with_error(**LEARNT), changed(mission, "b", swapped, begin_s=160.0, end_s=math.inf)


def honest(vehicle, mission):
    """The replay, smoothed; both ways it is honest."""
    track = nf.replay(vehicle, mission, smooth=True)
    nees, dive = track.nees(track.errors(mission.truth)), track.time_s > 50.0
    assert max(np.nanmean(nees[what][dive]) for what in ("position", "velocity", "attitude")) < 2.0
    assert track.forward.errors(mission.truth).horizontal[track.forward.time_s > 50.0].max() < 5.0
    return track


def test_a_lane_that_was_left_is_used_again_while_models_are_early(dive):
    vehicle, mission = dive
    assert LearningSchedule.EARLY_S[-1] > END_S
    assert [name for _, name in honest(vehicle, mission).lanes] == ["a", "b", "a"]


def test_a_lane_that_began_from_another_keeps_how_when_that_begins_again(dive, monkeypatch):
    vehicle, mission = dive
    monkeypatch.setattr(LearningSchedule, "ANOTHER", 0.0)  # every early model is another one
    run = LaneReplay(vehicle, mission, mission.start, 1.0, True)
    run.run()
    piece = run.lanes[0].pieces[-1]
    assert piece.before.tape.times_begun > piece.times_begun > 0
    assert len(piece.before.tape.as_of(piece.times_begun).records) >= piece.records > 0
    assert [name for _, name in honest(vehicle, mission).lanes] == ["a", "b", "a"]


def test_a_tape_keeps_the_records_of_a_beginning_that_was_lent():
    tape, dims = Tape(), np.zeros(8, np.int64)
    tape.begin(None)
    tape.record(np.ones(3), 1, dims)
    tape.begin_again(None, 1.0)
    assert tape.times_begun == 1 and len(tape.records) == len(tape.as_of(0).records) == 0
    tape.record(np.ones(3), 1, dims)
    tape.lent = True
    tape.begin_again(None, 2.0)
    assert not tape.lent and tape.times_begun == 2 and tape.as_of(2) is tape
    assert len(tape.as_of(1).records) == 1 and len(tape.records) == 0


def test_a_lane_that_has_begun_anew_learns(dive):
    vehicle, mission = dive
    run = LaneReplay(vehicle, mission.between(0.0, 180.0).with_start(mission.start), mission.start, 1.0, False)
    run.run()
    begun = run.lanes[0].pieces[-1]
    assert begun.begin_s >= 90.0
    assert any(time_s > begun.begin_s for time_s, _ in begun.tape.models["compass"])


@pytest.mark.parametrize("begin_s", [75.0, 75.02])
def test_live_is_the_replay_where_a_unit_falls_silent(begin_s):
    vehicle = vehicle_of("a", "b")
    fixes = {"gps": Faults(available=((0.0, 50.0),))}
    mission = simulate(vehicle, survey(130.0, surface_s=20.0), seed=31, duration_s=130.0, faults=fixes)
    stream = mission.streams["a"]
    silent = (stream.time_s > begin_s) & (stream.time_s < 100.0)
    mission = mission.with_stream("a", stream.keep(~silent))
    track = nf.replay(vehicle, mission, output_rate_hz=None)
    nav, states, lanes = nf.LaneNavigator(vehicle, mission.start), {}, []
    for _ in fed(nav, vehicle, mission):
        states[nav.pose.time_s] = nav.pose
        lanes += [nav.health.lane] if lanes[-1:] != [nav.health.lane] else []
    assert lanes == ["a", "b"] == [name for _, name in track.lanes]
    compared = 0
    for i, time_s in enumerate(track.time_s.tolist()):
        if time_s in states and time_s > 1.0 and abs(time_s - track.lanes[1][0]) > 0.5:
            pose, compared = states[time_s], compared + 1
            assert (pose.latitude, pose.longitude) == (track.latitude[i], track.longitude[i])
    assert compared > 500

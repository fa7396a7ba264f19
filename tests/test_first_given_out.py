"""The forward track is what the vehicle had at each time: what is run again later does not change it, and hindsight has
its own label.
"""

import numpy as np
import pytest
from feeding import DRIVE, events_of

import navfilter as nf
from navfilter.filter.records import Tape
from navfilter.learning.schedule import LearningSchedule
from navfilter.simulation.scenarios import stage

RUN = ("latitude", "longitude", "height", "velocity_n", "attitude", "covariance")


@pytest.fixture(scope="module")
def missions():
    staged = stage("compass-rolling", duration_s=600.0, imu_rate_hz=20.0)
    learning = staged.vehicle.with_error(compass=nf.LearnedArma(prior=staged.vehicle.sensors["compass"].error))
    return staged.vehicle, learning, staged.mission(1)


@pytest.fixture(scope="module")
def forward(missions):
    _, learning, mission = missions
    return nf.replay(learning, mission, output_rate_hz=1.0)


def again_s(track):
    """When the run began again: for the first time, and for the last time (the mission ends before a hop)."""
    times = [time_s for time_s, _ in track.error_models["compass"][1:]]
    assert len(times) == len(LearningSchedule.EARLY_S)
    return times[0], times[-1]


def test_before_an_adoption_the_vehicle_had_what_its_file_says(missions, forward):
    vehicle, _, mission = missions
    error = vehicle.sensors["compass"].error
    block = error.block(1.0 / vehicle.sensors["compass"].rate_hz)
    # an error that may be quick: as much white noise as it is large stands beside it
    may_be_quick = error + nf.White(sd=float(np.sqrt(block.C @ block.P0 @ block.C)))
    plain = nf.replay(vehicle.with_error(compass=may_be_quick), mission, output_rate_hz=1.0)
    first_s, _ = again_s(forward)
    n = int(np.searchsorted(forward.time_s, first_s, side="left"))
    assert 31 < n < 35  # the first hop is at 30 s; its answer is taken 2 s later, the beginning done again by 33 s
    for name in RUN:
        assert np.array_equal(getattr(forward, name)[:n], getattr(plain, name)[:n]), name
    for name, residuals in forward.residuals.items():
        then = residuals.time_s < first_s
        assert np.array_equal(residuals.value[then], plain.residuals[name].value[then], equal_nan=True), name
        assert np.array_equal(residuals.time_s, plain.residuals[name].time_s), name


def test_live_the_vehicle_had_every_row_of_it(missions, forward):
    """Reading by reading, without a tape and with the history of the vehicle's own loop."""
    _, learning, mission = missions
    nav, had = nf.Navigator(learning, mission.start), {}
    wanted = set(forward.time_s.tolist())
    for event in events_of(learning, mission):
        if event.sensor == DRIVE:
            nav.step(event.time_s, event.value[:3], event.value[3:])
            continue
        nav.correct(event.sensor, event.time_s, event.value)
        if event.time_s in wanted:
            had[event.time_s] = nav.state
    rows = [i for i, time_s in enumerate(forward.time_s.tolist()) if time_s in had]
    assert len(rows) > 590
    for i in rows:
        state = had[forward.time_s[i]]
        assert (state.latitude, state.longitude, state.height) == (
            forward.latitude[i],
            forward.longitude[i],
            forward.height[i],
        )
        assert np.array_equal(state.covariance, forward.covariance[i])


def test_after_it_the_track_is_the_one_that_was_run_again(forward):
    revised = forward.revised
    assert forward.label == "forward" and revised is not None and revised.label == "revised"
    assert np.array_equal(forward.time_s, revised.time_s)
    # the reading at the last such moment was the first one that was used with the new model
    _, last_s = again_s(forward)
    after = forward.time_s >= last_s
    assert 90 < after.sum() < 110
    for name in RUN:
        here, there = getattr(forward, name), getattr(revised, name)
        assert np.array_equal(here[after], there[after]), name
    # hindsight is worth something, or there would be no second label
    assert not np.array_equal(forward.attitude[~after], revised.attitude[~after])
    for name, residuals in forward.residuals.items():
        later = residuals.time_s >= last_s
        assert np.array_equal(residuals.nis[later], revised.residuals[name].nis[later], equal_nan=True), name


def test_a_model_was_in_force_from_its_adoption_on(forward):
    (begin_s, prior), (time_s, first) = forward.error_models["compass"][:2]
    assert begin_s == forward.time_s[0] and prior.model is None and first[0].model is not None
    # 30 s, 2 s for the answer, 0.6 s for doing the beginning again
    assert 32.55 < time_s < 32.75
    assert forward.revised.error_models["compass"][0][0] == begin_s
    # nothing was adopted for the others
    assert all(len(history) == 1 for name, history in forward.error_models.items() if name != "compass")


def test_the_smoother_works_on_what_was_run_again(missions, forward):
    _, learning, mission = missions
    track = nf.replay(learning, mission, output_rate_hz=1.0, smooth=True)
    for name in RUN:
        assert np.array_equal(getattr(track.forward, name), getattr(forward, name)), name
    assert track.error_models == forward.revised.error_models
    # at its last row a smoother knows no more than the filter
    assert np.array_equal(track.latitude[-1:], forward.latitude[-1:])


def test_without_running_again_there_is_no_hindsight(missions):
    vehicle, _, mission = missions
    assert nf.replay(vehicle, mission).revised is None


class Layout:
    size = 9


def written(tape, times, height):
    for time_s in times:
        nav = np.full(17, height)
        tape.row(time_s, nav, np.empty(0), np.eye(9))
        tape.column("depth", 1).append(time_s, 0, np.array([height, 1.0, 0.0, height, 1.0]))


def test_a_run_may_begin_again_many_times():
    tape = Tape(smoothable=False)
    tape.begin(Layout())
    tape.models["depth"] = [(0.0, "prior")]
    written(tape, (1.0, 2.0), 1.0)
    for again, (ended_s, times) in enumerate(((2.5, (1.0, 2.0, 3.0)), (3.0, (1.0, 2.0, 3.0, 4.0, 5.0))), start=2):
        tape.begin_again(Layout(), ended_s)
        tape.models["depth"] = [(0.0, f"model {again}")]
        written(tape, times, float(again))
    tape.models["depth"].append((4.5, "last"))
    rows = [(part.row_times[i], part.rows[i][0]) for part, those in tape.first_rows() for i in those]
    assert rows == [(1.0, 1.0), (2.0, 1.0), (3.0, 2.0), (4.0, 3.0), (5.0, 3.0)]
    assert tape.first_residuals()["depth"].value[:, 0].tolist() == [1.0, 1.0, 2.0, 3.0, 3.0]
    assert tape.residuals()["depth"].value[:, 0].tolist() == [3.0] * 5
    assert tape.first_models()["depth"] == [(0.0, "prior"), (2.5, "model 2"), (3.0, "model 3"), (4.5, "last")]
    tape.begin(Layout())
    assert tape.given is None and list(tape.first_rows()) == [(tape, range(0))]

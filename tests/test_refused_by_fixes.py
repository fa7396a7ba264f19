"""Learnt models by which fixes, or readings beside constants as states, are less likely are refused: the beginning is
run with both.
"""

import dataclasses
import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from feeding import events_of, fed
from state_differences import differences

import navfilter as nf
from navfilter.evaluation.baselines import learnable, rivals
from navfilter.evaluation.comparison import compare
from navfilter.evaluation.montecarlo.campaign import Campaign
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.learned_arma import learned_part
from navfilter.simulation.scenarios import stage

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
#: The first early age ends at 18 s, and the beginning done again has come as far 0.3 s later.
PENDING_S, DONE_S = 18.1, 18.5


@pytest.fixture
def early(monkeypatch):
    """Early ages of a short mission; every model is worth doing the beginning again."""
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (16.0, 21.0, 26.0))
    monkeypatch.setattr(LearningSchedule, "ANOTHER", -1.0)


@pytest.fixture
def refused(early, monkeypatch):
    monkeypatch.setattr(LearningSchedule, "WORSE", -math.inf)  # whatever fixes say


@pytest.fixture(scope="module")
def mission():
    staged = stage("compass-rolling", duration_s=33.0, imu_rate_hz=20.0)
    prior = nf.LearnedArma(prior=staged.vehicle.sensors["compass"].error, orders=((0, 0), (1, 0), (2, 0)), hop=30)
    recorded = staged.mission(1)
    return staged.vehicle, staged.vehicle.with_error(compass=prior), recorded, events_of(staged.vehicle, recorded)


@pytest.mark.parametrize("taken", [0, 1])
def test_refused_to_the_end_the_sensor_is_as_described_or_as_was_taken_before(mission, early, monkeypatch, taken):
    """While something may still be learnt, white noise stands beside the prior; a model that was taken stays."""
    described, learning, recorded, _ = mission
    is_worse, asked = LearningSchedule.is_worse, []

    def refuses(own, than):
        asked.append(own)
        monkeypatch.setattr(LearningSchedule, "WORSE", math.inf if len(asked) <= taken else -math.inf)
        return is_worse(own, than)

    monkeypatch.setattr(LearningSchedule, "is_worse", refuses)
    track = nf.replay(learning, recorded)
    assert len(asked) > taken
    ends = track.error_models["compass"][-1][1]
    if taken:
        assert learned_part(ends if isinstance(ends, nf.ErrorModel) else ends[0]).model is not None
    else:
        assert ends in (described.sensors["compass"].error, described.sensors["compass"].models)


def test_live_with_threads_and_from_a_snapshot_it_is_the_same(mission, refused):
    _, vehicle, recorded, events = mission
    alone = nf.Navigator(vehicle, recorded.start, threads=False)
    rows = fed(alone, events)
    assert alone.counts["adopted"] == 1  # in the end the prior itself
    track = nf.replay(vehicle, recorded)
    np.testing.assert_array_equal(track.covariance[-1], alone.state.covariance)
    assert track.revised is None and np.all(np.diff(track.time_s) > 0.0)
    live = nf.Navigator(vehicle, recorded.start)
    np.testing.assert_array_equal(fed(live, events), rows)
    assert differences(live.memory.filter, alone.memory.filter) == []
    for until_s in (PENDING_S, DONE_S):
        nav = nf.Navigator(vehicle, recorded.start)
        number = next(i for i, event in enumerate(events) if event.time_s > until_s)
        fed(nav, events[:number])
        assert (nav.learning.again is not None) == (until_s == PENDING_S)
        restored = nf.Navigator.restore(vehicle, nav.snapshot())
        after = fed(restored, events[number:])
        np.testing.assert_array_equal(after, rows[-len(after) :])
        assert differences(restored.memory.filter, alone.memory.filter) == []


@pytest.mark.parametrize("at_s", [15.9, 17.5, 18.2])
def test_a_late_reading_over_it_finds_its_place(mission, refused, at_s):
    """1.5 s late, it goes back over the comparison."""
    _, vehicle, recorded, events = mission
    alone = nf.Navigator(vehicle, recorded.start, threads=False)
    fed(alone, events)
    number = next(i for i, e in enumerate(events) if e.time_s > at_s and e.sensor == "compass")
    behind = next(i for i, e in enumerate(events) if e.time_s > at_s + 1.5)
    nav = nf.Navigator(vehicle, recorded.start)
    fed(nav, [*events[:number], *events[number + 1 : behind], events[number], *events[behind:]])
    np.testing.assert_allclose(nav.filter.nav, alone.filter.nav, rtol=0.0, atol=1e-12)
    assert differences(nav.memory.filter, alone.memory.filter, tolerance=1e-9) == []


@pytest.mark.parametrize("of_fixes, of_readings", [(0.0, 0.0), (9.0, -2.0), (-4.0, 9.0), (9.0, -4.0)])
def test_neither_fixes_nor_readings_may_be_less_likely(mission, of_fixes, of_readings):
    _, vehicle, recorded, _ = mission
    own, other = (nf.Navigator(vehicle, recorded.start, threads=False).learning for _ in range(2))
    other.feedback[-2:] = of_fixes, of_readings
    assert other.is_worse(own.feedback) == (min(of_fixes, of_readings) < -LearningSchedule.WORSE)


def test_readings_have_a_say_where_constants_of_their_sensor_are_states(mission):
    _, vehicle, recorded, events = mission
    biased = dataclasses.replace(vehicle.sensors["compass"], bias_sd_rad=0.01)
    calibrating = nf.Vehicle(vehicle.drive, {**vehicle.sensors, "compass": biased})
    said = []
    for one in (vehicle, calibrating):
        nav = nf.Navigator(one, recorded.start, threads=False)
        fed(nav, events[:200])
        said.append(float(nav.learning.feedback[-1]))
    assert said[0] == 0.0 < said[1]


# --- missions -------------------------------------------------------------------------------------------------------


def learnt(scenario, gyro, seed):
    campaign = Campaign(scenario, gyro=gyro, smooth=False, imu_rate_hz=50.0)
    staged = campaign.staged
    recorded = staged.mission(seed)
    vehicle = rivals(("arma",), staged.vehicle, recorded, sensors=(staged.learnt,))["arma"]
    track = nf.replay(vehicle, recorded, output_rate_hz=1.0)
    nees = track.nees(track.errors(recorded.truth))["position"]
    return track, float(np.nanmean(nees[track.time_s > (campaign.score_from_s or 0.0)]))


def test_a_dvl_learnt_beside_a_drifting_unit_is_no_longer_overconfident():
    """NEES 15.6, of a seed that nothing was set with, while the unit's noise drew the DVL's scale to where it spoke
    against what was learnt; 3.4 where that was given up for it.
    """
    track, nees = learnt("dvl-coloured", "mems", 77)
    assert track.counts["adopted"] > 0
    assert nees < 3.0


def test_an_honest_model_stays():
    track, nees = learnt("dvl-coloured", "tactical", 72)
    assert track.counts["adopted"] > 0
    assert nees < 4.0


def test_a_wrong_clock_of_the_unit_is_no_error_of_the_velocity(recording, monkeypatch):
    """A dive with stamps and lever arm as its files have them, constants as states: the velocity would err by 0.5 m/s
    for ten seconds at a time. 304 m off with that, 9 m as described.
    """
    recording("snapir-auv-100hz/05")
    monkeypatch.syspath_prepend(BENCHMARKS)
    dives = importlib.import_module("dive_cases")
    case = next(case for case in dives.cases("printed", 5, 2) if case.constants)
    off_m = {name: dives.figures_of(dives.track_of(name, case), case)["rms_m"] for name in ("described", "learnt")}
    assert off_m["learnt"] < 1.1 * off_m["described"]


@pytest.mark.parametrize("draw", range(3))
def test_a_velocity_that_alone_holds_the_state_is_not_weighed_by_its_scatter(recording, monkeypatch, draw):
    """Stamps as the files have them, no constants as states, no fix, no compass: its refused readings contradict each
    other in turns. Let in as mere noise they hold nothing: 0.3 to 2 km off. 1.2 times the filter without a gate is what
    gates may cost.
    """
    recording("snapir-auv-100hz/06")
    monkeypatch.syspath_prepend(BENCHMARKS)
    dives = importlib.import_module("dive_cases")
    case = next(case for case in dives.cases("printed", 6, draw) if not case.constants)
    off_m = {name: dives.figures_of(dives.track_of(name, case), case)["rms_m"] for name in ("described", "no gate")}
    assert off_m["described"] < 1.2 * off_m["no gate"]


@pytest.fixture
def on_the_car(recording, monkeypatch):
    recording("wid-car-rtk/00")
    monkeypatch.syspath_prepend(BENCHMARKS)
    case = importlib.import_module("arma_vs_gm1").car("00")
    sensors = [name for name in learnable(case.vehicle, case.mission) if name in ("compass", "odometer")]
    vehicles = rivals(("vehicle", "arma"), case.vehicle, case.mission, sensors=sensors)
    tracks = {name: nf.replay(vehicle, case.mission) for name, vehicle in vehicles.items()}
    return compare(tracks, case.truth, begin_s=case.begin_s).runs


def test_on_the_car_learning_is_honest(on_the_car):
    assert on_the_car["arma"]["nees"]["position"]["mean"] < 2.0


@pytest.mark.xfail(
    strict=True, reason="its wheels err with the motion, and learnt ones count that as noise: 0.62 m, 0.37 by the file"
)
def test_on_the_car_learning_is_hardly_worse_than_its_file(on_the_car):
    assert on_the_car["arma"]["position_rms_m"] < 1.2 * on_the_car["vehicle"]["position_rms_m"]

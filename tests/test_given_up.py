"""Learnt models against which the constants of the vehicle speak are given up."""

import importlib
import math
from dataclasses import replace
from pathlib import Path

import naive
import numpy as np
import pytest
from feeding import events_of, fed
from scipy.stats import kstest

import navfilter as nf
from navfilter.evaluation.baselines import learnable, rivals
from navfilter.evaluation.comparison import compare
from navfilter.evaluation.diagnostics import doubts
from navfilter.evaluation.fix_reacquisition import evidence
from navfilter.evaluation.montecarlo.campaign import Campaign
from navfilter.faults.monitor import FaultMonitor
from navfilter.filter.filter import Filter
from navfilter.foundation.state_values import differences
from navfilter.kernels import open_loop_residual
from navfilter.learning import consistency, schedule
from navfilter.learning.consistency import CONTRADICTED, departure, is_near
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.learned_arma import learned_part
from navfilter.models.start import Start
from navfilter.simulation.campaigns import stage
from navfilter.simulation.scenarios import survey_vehicle

START = Start(latitude_deg=45.0, longitude_deg=8.0)
BENCHMARKS = Path(__file__).parent.parent / "benchmarks"

# --- the measure ----------------------------------------------------------------------------------------------------


def with_monitor(vehicle):
    return Filter(vehicle, START, FaultMonitor(vehicle))


def with_constants():
    plain = survey_vehicle()
    arm, bent = (0.1, 0.1, 0.05), (0.0, 0.01, 0.01)
    dvl = replace(
        plain.sensors["dvl"], scale_sd=0.01, misalignment_sd_rad=bent, lever_arm_sd_m=arm, time_offset_sd_s=0.05
    )
    return with_monitor(replace(plain, sensors={**plain.sensors, "dvl": dvl}))


def test_constants_are_those_with_a_prior_that_nothing_drives():
    filter = with_constants()
    at, mean, variance = filter.layout.constants
    assert len(at) >= 4 and len(set(at)) == len(at)
    np.testing.assert_array_equal(np.diag(filter.P)[at], variance)
    np.testing.assert_array_equal(filter.x[at - 9], mean)


@pytest.mark.parametrize("told", [0.3, 3.0, 100.0])
def test_departure_is_a_standard_normal_where_prior_and_models_are_right(told):
    """Estimates drawn from what an honest filter says of them, whatever it has been told."""
    filter, rng = with_constants(), np.random.default_rng(5)
    at, mean, variance = filter.layout.constants
    sd = np.sqrt(variance)
    H = rng.standard_normal((len(at), len(at)))
    P = np.linalg.inv(np.eye(len(at)) + told * H.T @ H)
    root = np.linalg.cholesky(np.eye(len(at)) - P)
    filter.P[np.ix_(at, at)] = P * np.outer(sd, sd)

    def drawn(shift):
        found = []
        for _ in range(2000):
            filter.x[at - 9] = mean + sd * (root @ rng.standard_normal(len(at)) + shift)
            found.append(departure(filter))
        return np.array(found)

    z = drawn(0.0)
    # an approximation of the distribution: mean and sd to a tenth, and no heavy tail where the limit stands
    assert abs(z.mean()) < 0.1 and abs(z.std() - 1.0) < 0.1
    assert kstest(z, "norm").statistic < 0.06
    assert np.mean(z > CONTRADICTED) < 0.01
    assert np.mean(drawn(8.0) > CONTRADICTED) > 0.99


@pytest.mark.parametrize("told", [0.3, 3.0, 100.0])
def test_what_is_near_does_not_depart(told):
    """The quick answer is never a wrong one, and nearly always given, also where a covariance was opened again."""
    filter, rng = with_constants(), np.random.default_rng(6)
    at, mean, variance = filter.layout.constants
    sd, near = np.sqrt(variance), []
    for size in np.repeat([0.5, 1.0, 2.0, 4.0], 250):
        H = rng.standard_normal((len(at), len(at)))
        P = np.linalg.inv(np.eye(len(at)) + told * H.T @ H) + np.diag(rng.choice([0.0, 0.0, 0.3], len(at)))
        filter.P[np.ix_(at, at)] = P * np.outer(sd, sd)
        filter.x[at - 9] = mean + sd * size * rng.standard_normal(len(at))
        near.append(is_near(filter))
        given = filter.x, filter.P, at, mean, variance, rng.uniform(0.1, 3.0)
        assert open_loop_residual.is_within(*given) == naive.is_within(*given)
        assert not near[-1] or departure(filter) < CONTRADICTED
    assert np.mean(near[:250]) > 0.5 and not all(near)


@pytest.mark.parametrize("k", [1, 2, 5, 12])
def test_what_constants_were_told_since_is_the_twins(k):
    """Also where most directions were told nothing, or the same: then eigenvectors are anything."""
    rng = np.random.default_rng(k)
    for told in (k, max(1, k // 2), 0):
        sd = 10.0 ** rng.uniform(-3.0, 3.0, k)
        H = np.eye(k)[:told] if rng.random() < 0.3 else rng.standard_normal((told, k))
        x, P, at = rng.standard_normal(9 + k), np.zeros((18 + k, 18 + k)), 9 + rng.permutation(k + 9)[:k]
        x, before = np.append(x, np.zeros(9)), np.outer(sd, sd) * np.eye(k)
        P[np.ix_(at, at)] = np.outer(sd, sd) * np.linalg.inv(np.eye(k) + H.T @ H)
        x[at - 9] *= sd
        estimate = 0.1 * sd * rng.standard_normal(k)
        ours, twins = np.empty((2, 2, k + 1, k))
        found = open_loop_residual.information_since(x, P, at, estimate, before, 0.003, *ours)
        expected = naive.information_since(x, P, at, estimate, before, 0.003, *twins)
        assert found == pytest.approx(expected, rel=1e-9)
        np.testing.assert_array_equal(ours[0], twins[0])


def test_constants_that_nothing_tells_do_not_speak():
    filter = with_constants()
    assert departure(filter) == 0.0
    assert departure(with_monitor(nf.Vehicle(filter.vehicle.drive, {}))) == 0.0


# --- the beginning done again as described --------------------------------------------------------------------------

#: Asked at 20 s; done again 2.4 s later.
PENDING_S, DONE_S = 21.0, 22.6


def speaks(against_described):
    return lambda filter: against_described if filter.counts["given-up"] else 9.0


@pytest.fixture
def few_hops(monkeypatch):
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (16.0, 40.0))
    monkeypatch.setattr(LearningSchedule, "REVISED_S", 80.0)
    for module in (schedule, consistency):
        monkeypatch.setattr(module, "departure", speaks(0.0))
    monkeypatch.setattr(schedule, "is_near", lambda filter: False)


@pytest.fixture(scope="module")
def mission():
    staged = stage("compass-rolling", duration_s=33.0, imu_rate_hz=20.0)
    prior = nf.LearnedArma(prior=staged.vehicle.sensors["compass"].error, orders=((0, 0), (1, 0), (2, 0)), hop=30)
    recorded = staged.mission(1)
    return staged.vehicle, staged.vehicle.with_error(compass=prior), recorded, events_of(staged.vehicle, recorded)


def test_the_run_goes_on_as_if_nothing_had_been_learnt(mission, few_hops):
    described, learning, recorded, _ = mission
    track, plain = nf.replay(learning, recorded), nf.replay(described, recorded)
    assert track.counts["given-up"] == 1 and track.counts["adopted"] >= 1
    later = track.time_s > DONE_S
    assert later.any() and not np.array_equal(track.covariance[~later], plain.covariance[~later])
    np.testing.assert_array_equal(track.covariance[later], plain.covariance[later])
    np.testing.assert_array_equal(track.latitude[later], plain.latitude[later])
    said = [f for f in doubts(track, recorded, evidence(track)) if f.code == "given-up"]
    assert [f.severity for f in said] == ["warning"]


def test_learnt_models_stay_where_the_constants_speak_against_any(mission, few_hops, monkeypatch):
    """They are wrong themselves; asking costs the beginning once more, so it becomes rare."""
    _, learning, recorded, _ = mission
    asked = []
    monkeypatch.setattr(LearningSchedule, "ASKED_S", math.inf)
    undisturbed = nf.replay(learning, recorded)
    monkeypatch.undo()
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (16.0, 40.0))
    monkeypatch.setattr(LearningSchedule, "REVISED_S", 80.0)
    for module in (schedule, consistency):
        monkeypatch.setattr(module, "departure", speaks(8.5))
    no_better = LearningSchedule.is_no_better
    monkeypatch.setattr(LearningSchedule, "is_no_better", lambda *given: asked.append(1) or no_better(*given))
    track = nf.replay(learning, recorded)
    assert asked and track.counts["given-up"] == 0
    np.testing.assert_array_equal(track.covariance, undisturbed.covariance)
    np.testing.assert_array_equal(track.latitude, undisturbed.latitude)


@pytest.mark.parametrize("taken", [0, 1])
def test_refused_to_the_end_the_sensor_is_as_described_or_as_was_taken_before(mission, few_hops, monkeypatch, taken):
    """While something may still be learnt, white noise stands beside the prior; a model that was taken stays."""
    described, learning, recorded, _ = mission
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (16.0, 21.0))
    monkeypatch.setattr(LearningSchedule, "REVISED_S", 26.0)
    monkeypatch.setattr(LearningSchedule, "ASKED_S", math.inf)
    monkeypatch.setattr(LearningSchedule, "ANOTHER", -1.0)  # every model is worth it
    monkeypatch.setattr(LearningSchedule, "compares", property(lambda one: one.again is not None))
    no_better, asked = LearningSchedule.is_no_better, []

    def refuses(own, other):
        asked.append(own)
        monkeypatch.setattr(consistency, "WORSE", math.inf if len(asked) <= taken else -math.inf)  # whatever fixes say
        return no_better(own, other)

    monkeypatch.setattr(LearningSchedule, "is_no_better", refuses)
    track = nf.replay(learning, recorded)
    assert len(asked) > taken
    ends = track.error_models["compass"][-1][1]
    if taken:
        assert learned_part(ends if isinstance(ends, nf.ErrorModel) else ends[0]).model is not None
    else:
        assert ends in (described.sensors["compass"].error, described.sensors["compass"].models)


def test_live_with_threads_and_from_a_snapshot_it_is_the_same(mission, few_hops):
    _, vehicle, recorded, events = mission
    alone = nf.Navigator(vehicle, recorded.start, threads=False)
    rows = fed(alone, events)
    assert alone.counts["given-up"] == 1
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


@pytest.mark.parametrize("at_s", [19.9, 21.0, 22.3])
def test_a_late_reading_over_it_finds_its_place(mission, few_hops, at_s):
    """1.5 s late, it goes back over the question, or over the beginning done again."""
    _, vehicle, recorded, events = mission
    alone = nf.Navigator(vehicle, recorded.start, threads=False)
    fed(alone, events)
    number = next(i for i, e in enumerate(events) if e.time_s > at_s and e.sensor == "compass")
    behind = next(i for i, e in enumerate(events) if e.time_s > at_s + 1.5)
    nav = nf.Navigator(vehicle, recorded.start)
    fed(nav, [*events[:number], *events[number + 1 : behind], events[number], *events[behind:]])
    assert nav.counts["given-up"] == 1
    np.testing.assert_allclose(nav.filter.nav, alone.filter.nav, rtol=0.0, atol=1e-12)
    assert differences(nav.memory.filter, alone.memory.filter, tolerance=1e-9) == []


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
    assert track.counts["given-up"] == 0 and track.counts["adopted"] > 0
    assert nees < 3.0


def test_an_honest_model_stays():
    track, nees = learnt("dvl-coloured", "tactical", 72)
    assert track.counts["given-up"] == 0 and track.counts["adopted"] > 0
    assert nees < 4.0


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
    strict=True, reason="learnt wheels are in force until the constants disagree, after 48 s: 0.70 m, 0.45"
)
def test_on_the_car_learning_is_hardly_worse_than_its_file(on_the_car):
    """It was given up as long as the noise of the unit drew the scale of its wheels: 0.78 m, 0.56 by the file."""
    assert on_the_car["arma"]["position_rms_m"] < 1.2 * on_the_car["vehicle"]["position_rms_m"]

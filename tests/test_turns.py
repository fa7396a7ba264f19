"""A gyro that turns by a multiple of what the compass does is left out, until it turns with it again."""

import math

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one
from test_ramp import spoiled

import navfilter as nf
from navfilter.evaluation.baselines import rivals
from navfilter.evaluation.montecarlo.campaign import Campaign
from navfilter.faults.imu.gyro_scale import agrees, wrong_since
from navfilter.navigation import runner
from navfilter.simulation.scenarios import simulate_scenario

DEG = math.pi / 180.0
FAULT_S, END_S = 175.0, 300.0  # between two quarter turns


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 3, 360.0)
    return vehicle, mission.hide("gps", (60.0, 1e9)).between(0.0, END_S)


def times(axis, factor):
    return lambda v: v * np.where(np.arange(6) == axis, factor, 1.0)


@pytest.mark.parametrize("factor", [-1.0, 2.0, 0.5])
def test_a_gyro_with_another_factor_is_left_out_at_the_first_turn(dive, factor):
    vehicle, mission = dive
    track = nf.replay(vehicle, spoiled(mission, times(2, factor), begin_s=FAULT_S), output_rate_hz=1.0)
    errors, late = track.errors(mission.truth), track.time_s > FAULT_S
    assert track.counts["contradicted"] == 1
    assert np.nanmax(errors.horizontal[late]) < 6.0  # without it 25 m and more, in a minute
    assert np.nanmean(track.nees(errors)["heading"][late & (track.time_s > END_S - 30.0)]) < 4.0
    assert track.counts["opened"] == track.counts["jumped"] == 0


def test_it_is_used_again_once_it_turns_with_the_compass(dive):
    vehicle, mission = dive
    wrong = spoiled(spoiled(mission, times(2, -1.0), begin_s=FAULT_S), times(2, -1.0), begin_s=197.0)
    nav = nf.Navigator(vehicle, mission.start)
    said = {}
    for event in events_of(vehicle, wrong):
        one_by_one(nav, [event])
        said[math.floor(event.time_s)] = nav.filter.monitor.conditions(nav.filter.memory.monitor)["gyro_z"]
    assert said[196] == "contradicted" and said[round(END_S) - 1] == "good"
    assert nav.counts["contradicted"] == 1


COMPASSES = {
    "deviation of 15 deg": lambda v: v + 15.0 * DEG * np.sin(v),
    "mirrored": lambda v: -v,
    "stuck": lambda v: np.full_like(v, v[0]),
    "25 deg off": lambda v: v + 25.0 * DEG,
    "noisy": lambda v: v + 5.0 * DEG * np.random.default_rng(1).normal(size=v.shape),
    "2 s late": lambda v: np.roll(np.unwrap(v, axis=0), 16, axis=0),
}


@pytest.mark.parametrize("name", COMPASSES)
@pytest.mark.parametrize("begin_s", [0.0, FAULT_S])
def test_a_compass_that_is_wrong_accuses_no_gyro(dive, name, begin_s):
    vehicle, mission = dive
    track = nf.replay(vehicle, spoiled(mission, COMPASSES[name], "compass", begin_s), output_rate_hz=1.0)
    assert track.counts["contradicted"] == 0


def steps(factor, turn=0.1, sd=0.01, count=12, seed=1):
    rng = np.random.default_rng(seed)
    c = turn * rng.normal(size=count)
    return tuple((float(k), c[k] + sd * rng.normal(), factor * c[k], sd**2) for k in range(count))


@pytest.mark.parametrize("seed", range(5))
def test_what_steps_say(seed):
    for factor in (-1.0, -0.5, 0.4, 2.0, 3.0):
        assert wrong_since(steps(factor, seed=seed)) is not None
        assert not agrees(steps(factor, seed=seed))
    for factor in (0.85, 1.0, 1.2):  # of a deviation
        assert wrong_since(steps(factor, seed=seed)) is None
    assert agrees(steps(1.0, seed=seed)) and not agrees(steps(1.0, turn=0.005, seed=seed)) and not agrees(())
    assert wrong_since(steps(-1.0, count=3, seed=seed)) is None
    assert wrong_since(steps(0.0, seed=seed)) is None  # the compass alone


def test_in_stretches_as_one_by_one_and_restored(dive, monkeypatch):
    vehicle, mission = dive
    wrong = spoiled(mission, times(2, -1.0), begin_s=FAULT_S).between(0.0, 205.0)
    together = nf.replay(vehicle, wrong)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    alone = nf.replay(vehicle, wrong)
    np.testing.assert_array_equal(together.covariance, alone.covariance)
    assert together.counts == alone.counts and together.counts["contradicted"] == 1
    events = events_of(vehicle, wrong)
    whole, half = (nf.Navigator(vehicle, mission.start) for _ in range(2))
    one_by_one(whole, events)
    one_by_one(half, [e for e in events if e.time_s <= 190.0])
    assert half.filter.channels["compass"].faults.turns is not None
    again = nf.Navigator.restore(vehicle, half.snapshot())
    one_by_one(again, [e for e in events if e.time_s > 190.0])
    same_runs.assert_same_bits(whole, again)


@pytest.mark.parametrize(
    ("scenario", "seed", "until_s"), [("compass-tails", 201, 500.0), ("compass-coarse", 202, 300.0)]
)
def test_one_that_is_refused_now_and_then_accuses_no_gyro(scenario, seed, until_s):
    """Its refused readings are far from each other whatever the gyros say, and there are hundreds of them."""
    staged = Campaign(scenario, gyro="mems", smooth=False, imu_rate_hz=50.0).staged
    vehicle, mission = staged.vehicle, staged.mission(seed)
    described = rivals(("vehicle",), vehicle, mission, sensors=(staged.learnt,))["vehicle"]
    track = nf.replay(described, mission.between(0.0, until_s), output_rate_hz=1.0)
    assert track.residuals["compass"].count("rejected") > 100
    assert track.counts["contradicted"] == 0

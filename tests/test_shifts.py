"""A gyro whose bias shifts by little is found by where the estimate of that bias goes, and learnt anew."""

import dataclasses
import functools
import math

import naive
import numpy as np
import pytest
from kernel_inputs import assert_close, run_both
from test_agreement import altered, feed, fly

import navfilter as nf
from navfilter.faults import settings as fault_settings
from navfilter.faults.imu import bias_drift
from navfilter.foundation.state_values import differences
from navfilter.kernels import bias_drift as kernels
from navfilter.navigation import runner
from navfilter.simulation.faults import Faults
from navfilter.simulation.scenarios import reckoning_vehicle, survey, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG_H = math.pi / 180.0 / 3600.0
END_S, DIVE_S, SHIFT_S = 490.0, 140.0, 200.0


@functools.cache
def long_dive():
    """Fixes for 140 s, then none."""
    vehicle = survey_vehicle()
    fixes = {"gps": Faults(available=((0.0, DIVE_S),))}
    return vehicle, simulate(vehicle, survey(END_S, surface_s=110.0), seed=8, duration_s=END_S, faults=fixes)


def shifted_by(mission, axis, deg_h):
    return altered(mission, "imu", lambda v: v + np.eye(6)[axis] * deg_h * DEG_H, SHIFT_S)


@pytest.mark.parametrize(("axis", "deg_h", "within_s"), [(2, 200.0, 110.0), (2, -100.0, 180.0), (0, -50.0, 80.0)])
def test_a_shift_is_found_and_learnt_anew(axis, deg_h, within_s):
    vehicle, mission = long_dive()
    track = nf.replay(vehicle, shifted_by(mission, axis, deg_h), output_rate_hz=1.0)
    errors = track.errors(mission.truth)
    sd = np.sqrt(track.covariance[:, 8, 8])
    late = track.time_s > SHIFT_S + within_s + 40.0
    assert track.counts["shifted"] >= 1
    assert np.nanmax(np.abs(errors.heading[late]) / sd[late]) < 3.5
    assert not nf.replay(vehicle, mission, output_rate_hz=1.0).counts["shifted"]
    name = f"gyro_{'xyz'[axis]}[0]"
    bias = track.states[:, list(track.state_names).index(name)] / DEG_H
    found = bias[-1] - bias[np.searchsorted(track.time_s, SHIFT_S)]
    assert abs(found - deg_h) < 0.25 * abs(deg_h)


def test_stretches_lives_and_snapshots_give_the_same(monkeypatch):
    vehicle, mission = long_dive()
    broken = shifted_by(mission, 0, -50.0).between(0.0, SHIFT_S + 70.0)
    whole, _ = fly(vehicle, broken)
    assert whole.counts["shifted"] == 1
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(track.velocity_n[-1], whole.state.velocity_n)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    np.testing.assert_array_equal(nf.replay(vehicle, broken).covariance[-1], track.covariance[-1])
    half, _ = fly(vehicle, broken, until_s=SHIFT_S + 10.0)
    again = nf.Navigator.restore(vehicle, half.snapshot())
    feed(again, vehicle, broken, after_s=SHIFT_S + 10.0)
    assert not differences(whole.filter.memory, again.filter.memory)


def test_dead_reckoning_is_not_looked_at():
    vehicle = reckoning_vehicle()
    mission = simulate(vehicle, survey(60.0), seed=1, duration_s=60.0)
    nav, _ = fly(vehicle, mission)
    monitor = nav.filter.memory.monitor
    assert monitor.look_s(nav.filter.inertial) == math.inf and np.isnan(monitor.bias_drift).all()


def looks(sd=2.0, ends=1.0):
    """Estimates that did not move, and the latest of them, whose sds are smaller."""
    table = bias_drift.fresh()
    table[:, bias_drift.TIME_S] = bias_drift.EVERY_S * np.arange(bias_drift.LOOKS)
    table[:, bias_drift.BIAS : bias_drift.VARIANCE] = 0.0
    table[:, bias_drift.VARIANCE : bias_drift.NIS], table[:, bias_drift.NIS] = sd**2, 1.0
    now = table[-1].copy()
    now[bias_drift.TIME_S] += bias_drift.EVERY_S
    now[bias_drift.VARIANCE : bias_drift.NIS] = ends**2
    return table, now


def test_an_estimate_may_move_by_what_it_has_learnt():
    table, now = looks()
    walk, begin = np.zeros(3), np.full(3, 1e-12)
    now[bias_drift.BIAS] = 0.9 * 6.0 * math.sqrt(3.0)
    now[bias_drift.BIAS + 1] = -1.1 * 6.0 * math.sqrt(3.0)
    (axis, row, size), *others = bias_drift.shifted(table, now, walk, begin)
    # three quarters of the variance are gone: so is as much of a shift
    assert not others and (axis, row) == (1, 0)
    assert size == pytest.approx(fault_settings.DRIFT_OPENED * now[bias_drift.BIAS + 1] / 0.75)
    # a walk, or a bias that was hardly known at the start, may move further
    assert not bias_drift.shifted(table, now, np.full(3, 0.1), begin)
    assert not bias_drift.shifted(table, now, walk, np.full(3, 100.0))
    assert not bias_drift.shifted(bias_drift.fresh(), now, walk, begin)
    # where sensors are four times as noisy as they are described, so may what is learnt from them
    table[:, bias_drift.NIS], now[bias_drift.NIS] = 16.0, 16.0
    assert not bias_drift.shifted(table, now, walk, begin)
    now[bias_drift.BIAS + 1] *= 4.0
    assert len(bias_drift.shifted(table, now, walk, begin)) == 1


@pytest.mark.parametrize("missing", [0, 5, 16])
def test_the_kernel_and_its_twin(missing):
    rng = np.random.default_rng(missing)
    table, now = (
        rng.uniform(0.5, 2.0, (bias_drift.LOOKS, bias_drift.COLUMNS)),
        rng.uniform(0.5, 2.0, bias_drift.COLUMNS),
    )
    table[:missing] = math.nan
    args = table, now, np.full(3, 0.01), np.full(3, 1e-3)
    assert kernels.largest_change(*args) == pytest.approx(naive.largest_change(*args), rel=1e-12)
    assert (kernels.largest_change(*args) > 0.0) == (missing < bias_drift.LOOKS)


@pytest.mark.parametrize("what", ["nothing", "far", "anew", "opened", "busy", "none"])
def test_what_is_kept_and_its_twin(what):
    """A look that goes on, one of a bias that has moved too far, those that are the first again, and without biases."""
    rng = np.random.default_rng(3)
    table, now = map(np.nan_to_num, looks())
    x, P = 1e-3 * rng.normal(size=4), np.eye(13)
    gyros = np.array([[9.0, 10.0, 12.0], [1e-4] * 3, [1e-3] * 3])
    x[0] += 20.0 * (what == "far")
    now[bias_drift.ANEW] += what == "anew"
    P[12, 12] += 9.0 * (what == "opened")
    gyros = gyros[:, :0] if what == "none" else gyros
    ours, twins = run_both(kernels.compare_estimates, table, now, gyros, x, P, what != "busy")
    assert_close(ours[:2], twins[:2])
    kept, told = ours[0], kernels.compare_estimates(table.copy(), now.copy(), gyros, x, P, what != "busy")
    assert told == (what == "far")
    assert np.isnan(kept[:-1]).all() == (what in ("anew", "opened", "busy"))
    np.testing.assert_array_equal(kept[-1], table[-1] if told else ours[1])


def test_of_many_good_estimates_none_has_shifted():
    # a Kalman filter that learns a constant from readings with noise of 1
    rng, found = np.random.default_rng(1), 0
    for _ in range(40):
        constant, estimate, variance, table = rng.normal(), 0.0, 1.0, bias_drift.fresh()
        for k in range(60):
            gain = variance / (variance + 4.0)
            estimate += gain * (constant + 2.0 * rng.normal() - estimate)
            variance *= 1.0 - gain
            now = np.concatenate(
                [[10.0 * k, 0.0, 0.0, 0.0], np.full(3, estimate), np.full(3, variance), [1.0, 0.0, 0.0]]
            )
            found += len(bias_drift.shifted(table, now, np.zeros(3), np.full(3, 1e-12)))
            table = np.vstack([table[1:], now])
    assert found == 0


def test_a_state_that_is_set_anew_begins_the_looks_anew():
    vehicle, mission = long_dive()
    nav = nf.Navigator(vehicle, dataclasses.replace(mission.start))
    feed(nav, vehicle, mission.between(0.0, 60.0))
    memory = nav.filter.memory
    assert np.isfinite(memory.monitor.bias_drift[-5:]).all()
    memory.counts["realigned"] += 1
    feed(nav, vehicle, mission, until_s=71.0, after_s=60.0)
    assert (
        np.isfinite(memory.monitor.bias_drift[-1]).all() and np.isnan(nav.filter.memory.monitor.bias_drift[:-2]).all()
    )


def ramp(heading, extra, since=4, sd=0.01, seed=1):
    """Log odds that looks along these headings show a ramp of -1.5e-3 rad/s."""
    time_s = bias_drift.EVERY_S * np.arange(len(heading))
    rng = np.random.default_rng(seed)
    apart = 3.0 + 1e-5 * time_s + sd * rng.normal(size=len(heading)) + extra(time_s)
    apart = (apart + np.pi) % (2.0 * np.pi) - np.pi
    covariance = sd**2 * np.eye(len(heading))
    return bias_drift.odds_of_ramp(time_s, heading, apart, covariance, time_s[since], (2e-5) ** 2, -1.5e-3)


HEADINGS = {
    "circles": np.linspace(0.0, 12.0, 17),
    "legs": 0.7 + np.pi * (np.arange(17) // 6 % 2),
    "half a turn": np.linspace(0.0, 3.0, 17),
    "straight": 0.7 + 0.03 * np.sin(np.arange(17)),
}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", HEADINGS)
def test_a_deviation_is_no_ramp(name, seed):
    heading = HEADINGS[name]

    def deviation(time_s):
        return 0.3 * np.sin(heading + seed) + 0.05 * np.cos(2.0 * heading)

    def shifted(time_s):
        return deviation(time_s) - 1.5e-3 * np.maximum(time_s - time_s[4], 0.0)

    assert ramp(heading, deviation, seed=seed) < fault_settings.JUMP_ODDS
    if name != "half a turn":  # there nobody can tell
        assert ramp(heading, shifted, seed=seed) > fault_settings.JUMP_ODDS


@pytest.mark.parametrize("tau_s", [30.0, 100.0, 300.0])
def test_a_slow_error_that_nobody_described_is_no_ramp(tau_s):
    # the description has a third of the error, and all of it white
    gain, found = math.exp(-bias_drift.EVERY_S / tau_s), 0
    for seed in range(60):
        rng, error = np.random.default_rng(seed), [0.0]
        for _ in range(16):
            error.append(gain * error[-1] + 0.03 * math.sqrt(1.0 - gain**2) * rng.normal())
        found += (
            ramp(HEADINGS["legs"], lambda time_s, error=error: np.array(error), seed=seed) > fault_settings.JUMP_ODDS
        )
    assert found <= 1  # of 60, where one of exp(JUMP_ODDS) = 148 may be

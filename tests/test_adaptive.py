"""Adaptive rivals: each rule against its equations written out, on noises of known variance, and in a replay."""

import math

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation.adaptive import CEILING, FLOOR, RULES, adaptive_monitor, as_white
from navfilter.evaluation.baselines import replay_rival, rival
from navfilter.simulation.scenarios import simulate_scenario

R0, P = 1.0, 0.3


def innovations(kind, n, rng):
    """Innovations of a filter whose prediction has the variance P; the true R at the end, None where none is white."""
    R = np.full(n, 4.0)
    white = rng.normal(size=n)
    if kind == "as described":
        R[:] = R0
    elif kind == "step":
        R[: n // 2] = R0
    elif kind == "bursts":
        R[:] = np.where(np.arange(n) % 100 < 10, 25.0, R0)
    elif kind == "heavy tails":
        white = rng.standard_t(3, size=n) / math.sqrt(3.0)
    error = np.sqrt(R) * white
    if kind == "coloured":
        phi = math.exp(-1.0 / 20.0)
        for k in range(1, n):
            error[k] = phi * error[k - 1] + 2.0 * math.sqrt(1.0 - phi**2) * white[k]
    return error + math.sqrt(P) * rng.normal(size=n), None if kind in ("bursts", "heavy tails", "coloured") else R[-1]


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("kind", ["as described", "white", "step", "bursts", "heavy tails", "coloured"])
def test_on_noises_of_known_variance(name, kind):
    """Within 20 % in the mean where R is a number, within the bounds always; five series, an axis each."""
    series, true = zip(*(innovations(kind, 800, np.random.default_rng(seed)) for seed in range(5)), strict=True)
    rule, true, found = RULES[name](np.full(5, R0)), true[0], []
    for k, values in enumerate(np.transpose(series)):
        rule.update(values, np.full(5, P))
        assert np.all((rule.variance() >= FLOOR * R0) & (rule.variance() <= CEILING * R0))
        if k >= 600:
            found.append(rule.variance())
    if true is not None and name != "imm":
        assert np.mean(found) == pytest.approx(true, rel=0.2)
    elif true is not None:  # one of its levels, or a mixture of two
        assert 0.9 * true < np.mean(found) < 9.0 * R0


@pytest.mark.parametrize("name", RULES)
def test_a_missing_component_changes_nothing_of_its_axis(name):
    rule, other = (RULES[name](np.array([1.0, 2.0])) for _ in range(2))
    rng = np.random.default_rng(1)
    for k in range(60):
        value = rng.normal(size=2)
        rule.update(np.where([True, k % 3 > 0], value, np.nan), np.array([0.1, 0.1]))
        other.update(value, np.array([0.1, 0.1]))
        assert np.isfinite(rule.variance()).all()
    assert rule.variance()[0] == other.variance()[0] and rule.variance()[1] != other.variance()[1]


def test_an_axis_that_is_silent_for_a_whole_window_keeps_what_is_described():
    rule = RULES["iae"](np.array([1.0, 2.0]))
    for _ in range(40):
        rule.update(np.array([3.0, np.nan]), np.array([0.1, 0.1]))
    np.testing.assert_allclose(rule.variance(), [8.9, 2.0])


def test_live_with_a_history_it_is_refused():
    """What a rule has gathered is not part of the memory that late readings go back to."""
    vehicle, mission = simulate_scenario("lawnmower", 3, 10.0)
    monitor = adaptive_monitor(vehicle, RULES["iae"])
    with pytest.raises(ValueError, match="history_s=0"):
        nf.Navigator(vehicle, mission.start, monitor=monitor)
    assert not nf.Navigator(vehicle, mission.start, history_s=0.0, monitor=monitor).fast_paths


def independent(name, values):
    """R of one axis after all innovations, by the equations of the papers, in plain numbers."""
    bound = lambda R: min(max(R, FLOOR * R0), CEILING * R0)  # noqa: E731
    if name == "iae":
        return bound(sum(v * v - P for v in values[-30:]) / 30)
    if name == "sage-husa":
        R = R0
        for k, v in enumerate(values, 1):
            d = 0.03 / (1.0 - 0.97 ** (k + 1))
            R = (1.0 - d) * bound(R) + d * (v * v - P)
        return bound(R)
    if name == "vb":
        alpha, beta = 1.0, R0
        for v in values:
            alpha, before = 0.97 * alpha + 0.5, 0.97 * beta
            beta = before
            for _ in range(5):
                R = bound(beta / alpha)
                K = P / (P + R)
                beta = before + 0.5 * ((v - K * v) ** 2 + (1.0 - K) * P)
        return bound(beta / alpha)
    odds, levels = [1 / 3] * 3, [R0 / 9, R0, 9 * R0]
    mixed = lambda: [sum((0.98 if i == j else 0.01) * odds[j] for j in range(3)) for i in range(3)]  # noqa: E731
    for v in values:
        likely = [m * math.exp(-0.5 * v * v / (P + R)) / math.sqrt(P + R) for m, R in zip(mixed(), levels, strict=True)]
        odds = [value / sum(likely) for value in likely]
    return bound(sum(m * R for m, R in zip(mixed(), levels, strict=True)))


@pytest.mark.parametrize("name", RULES)
def test_each_rule_is_its_equations(name):
    rule, values = RULES[name](np.array([R0])), innovations("step", 200, np.random.default_rng(3))[0]
    for value in values:
        rule.update(np.array([value]), np.array([P]))
    assert rule.variance()[0] == pytest.approx(independent(name, values.tolist()), rel=1e-9)


def test_white_noise_of_the_same_variance():
    walk = nf.RandomWalk(density=0.1)
    assert as_white(nf.White(sd=0.3) + nf.GaussMarkov(sd=0.4, tau_s=5.0), 0.1).sd == pytest.approx(0.5)
    assert as_white(nf.White(sd=0.3) + walk, 0.1).parts == (walk, nf.White(sd=0.3))


@pytest.mark.parametrize("name", RULES)
def test_a_rival_weighs_by_the_noise_that_it_finds(name):
    """Of a DVL with less noise than it is described with, within a minute: the velocity is surer then."""
    vehicle, mission = simulate_scenario("lawnmower", 3, 60.0)
    described = vehicle.with_error(dvl=nf.White(sd=0.1))
    rough = nf.replay(described, mission)
    track = replay_rival(name, rival(name, described, mission), mission)
    assert np.isfinite(track.covariance).all() and track.residuals["dvl"].count("used") > 200
    assert track.covariance[-1][3, 3] < 0.7 * rough.covariance[-1][3, 3]
    again = replay_rival(name, rival(name, described, mission), mission)
    np.testing.assert_array_equal(track.covariance, again.covariance)

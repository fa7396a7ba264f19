"""Adaptive rivals: each rule against its equations written out, on noises of known variance, and in a replay."""

import math

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation.baselines import (
    CEILING,
    FLOOR,
    RULES,
    ReadingRule,
    StudentT,
    adaptive_monitor,
    as_white,
    replay_rival,
    rival,
)
from navfilter.simulation.scenarios import simulate_scenario

R0, P = 1.0, 0.3


def take(rule, innovation, predicted):
    """Give a rule of either kind a reading: its own R where the rule weighs it, else that of the next one."""
    if isinstance(rule, ReadingRule):
        return rule.weigh(innovation, np.diag(predicted))
    rule.update(innovation, predicted)
    return rule.variance()


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
    """Within 20 % in the mean where R is a number, within the bounds always."""
    found = []
    for seed in range(2):
        rule, rng = RULES[name](np.array([R0])), np.random.default_rng(seed)
        values, true = innovations(kind, 800, rng)
        for k, value in enumerate(values):
            R = take(rule, np.array([value]), np.array([P]))[0]
            assert FLOOR * R0 <= R <= CEILING * R0 and FLOOR * R0 <= rule.variance()[0] <= CEILING * R0
            if k >= 600:
                found.append(R)
    if name == "student-t":  # no level is followed; beside 1.2 R0, what is unlikely counts less
        assert 0.8 * R0 < np.median(found) < (1.3 if kind == "as described" else 3.0) * R0
        assert np.max(found) > 1.5 * np.median(found)
    elif true is not None and name != "imm":
        assert np.mean(found) == pytest.approx(true, rel=0.2)
    elif true is not None:  # one of its levels, or a mixture of two
        assert 0.9 * true < np.mean(found) < 9.0 * R0


@pytest.mark.parametrize("name", RULES)
def test_a_missing_component_changes_nothing_of_its_axis(name):
    rule, other = (RULES[name](np.array([1.0, 2.0])) for _ in range(2))
    rng = np.random.default_rng(1)
    for k in range(60):
        value = rng.normal(size=2)
        found = take(rule, np.where([True, k % 3 > 0], value, np.nan), np.array([0.1, 0.1]))
        take(other, value, np.array([0.1, 0.1]))
        assert np.isfinite(found).all() and np.isfinite(rule.variance()).all()
    assert rule.variance()[0] == other.variance()[0]
    assert name == "student-t" or rule.variance()[1] != other.variance()[1]


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
    if name == "student-t":
        return R0
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
        take(rule, np.array([value]), np.array([P]))
    assert rule.variance()[0] == pytest.approx(independent(name, values.tolist()), rel=1e-9)


def dense(name, innovations, H, prior, described):
    """R of the last of several readings of three axes, by the papers' steps on the state itself (Joseph's form)."""
    n, alpha, beta = len(prior), np.ones(3), described.copy()
    bound = lambda R: np.clip(R, FLOOR * described, CEILING * described)  # noqa: E731
    for v in innovations:
        R = described.copy()
        alpha, before = 0.97 * alpha + 0.5, 0.97 * beta
        beta = before.copy()
        for _ in range(5):
            if name == "vb":
                R = bound(beta / alpha)
            K = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + np.diag(R))
            IKH = np.eye(n) - K @ H
            E = np.outer(v - H @ K @ v, v - H @ K @ v) + H @ (IKH @ prior @ IKH.T + K @ np.diag(R) @ K.T) @ H.T
            if name == "vb":
                beta = before + 0.5 * np.diag(E)
            else:
                w = (4.0 + 3.0) / (4.0 + np.trace(np.linalg.inv(np.diag(described)) @ E))
                R = bound(described / w)
    return R


@pytest.mark.parametrize("name", ["vb", "student-t"])
def test_a_reading_is_weighed_as_the_state_is_iterated(name):
    rng = np.random.default_rng(5)
    H, A, described = rng.normal(size=(3, 6)), rng.normal(size=(6, 6)), np.array([0.5, 1.0, 2.0])
    values, prior = rng.normal(size=(20, 3)) * [1.0, 2.0, 6.0], 0.1 * A @ A.T
    rule = RULES[name](described)
    for k, value in enumerate(values):
        found = rule.weigh(value, H @ prior @ H.T)
        np.testing.assert_allclose(found, dense(name, values[: k + 1], H, prior, described), rtol=1e-9)


def test_what_is_unlikely_counts_less():
    rule, predicted = StudentT(np.array([0.5, 1.0, 2.0])), 0.3 * np.eye(3)
    near, far, missing = (
        rule.weigh(np.array(v), predicted) for v in ([0.1, 0.1, 0.1], [0.1, 9.0, 0.1], [0.1, np.nan, 0.1])
    )
    np.testing.assert_allclose(far / near, (far / near)[0])  # one weight a reading
    assert far[1] > 5.0 > 1.0 > near[1] and np.isfinite(missing).all()


def test_a_reading_is_used_by_the_variance_that_its_rule_gives_it():
    """As the plain filter uses one that comes with that sd, and by nothing where the gate refuses it."""

    class Noted(StudentT):
        def weigh(self, innovation, predicted):
            found.append(super().weigh(innovation, predicted))
            return found[-1]

    found = []
    error = nf.White(sd=3.0)
    sensors = {"depth": nf.Depth(rate_hz=1), "gps": nf.Position(rate_hz=1, error=error)}
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors=sensors)
    start = nf.Start(latitude_deg=45.0, longitude_deg=-4.0, position_sd_m=2.0)
    monitors = adaptive_monitor(vehicle, Noted, ["gps"]), None
    runs = [nf.Navigator(vehicle, start, history_s=0.0, monitor=monitor) for monitor in monitors]
    fix = np.radians(45.0) + 11.0 / 6.37e6, np.radians(-4.0), 5.0
    for nav in runs:
        for k in range(1, 101):
            nav.step(0.01 * k, (0.0, 0.0, 1e-3), (0.1, 0.0, -9.806))
    for nav, sd in zip(runs, (None, lambda: np.sqrt(found[0])), strict=True):
        assert nav.correct("gps", 1.0, fix, None if sd is None else sd()).status == "used"
    assert found[0][0] > 1.2 * 9.0  # an innovation of three sd
    for one, other in ((runs[0].filter.P, runs[1].filter.P), (runs[0].filter.nav, runs[1].filter.nav)):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-15)
    before = runs[0].filter.nav.copy()
    assert runs[0].correct("gps", 1.0 + 1e-3, (fix[0] + 1e-3, *fix[1:])).status == "rejected"
    np.testing.assert_allclose(runs[0].filter.nav[:2], before[:2], rtol=0.0, atol=1e-9)
    assert len(found) == 1


@pytest.mark.parametrize("name", ["iae", "student-t"])
def test_without_a_gate_every_reading_is_used(name):
    vehicle, start = (
        nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"depth": nf.Depth(rate_hz=1)}),
        nf.Start(latitude_deg=45.0, longitude_deg=-4.0, position_sd_m=0.1),
    )
    said = {}
    for gated in (True, False):
        monitor = adaptive_monitor(vehicle, RULES[name], gated=gated)
        nav = nf.Navigator(vehicle, start, history_s=0.0, monitor=monitor)
        nav.step(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
        assert (nav.filter.bank.size > 0) == gated  # of what is used as described nothing is found
        said[gated] = nav.correct("depth", 0.01, 50.0).status
    assert said == {True: "rejected", False: "used"}


def test_white_noise_of_the_same_variance():
    walk = nf.RandomWalk(density=0.1)
    assert as_white(nf.White(sd=0.3) + nf.GaussMarkov(sd=0.4, tau_s=5.0), 0.1).sd == pytest.approx(0.5)
    assert as_white(nf.White(sd=0.3) + walk, 0.1).parts == (walk, nf.White(sd=0.3))


@pytest.fixture(scope="module")
def rough():
    """A DVL with less noise than it is described with, for a minute."""
    vehicle, mission = simulate_scenario("lawnmower", 3, 60.0)
    described = vehicle.with_error(dvl=nf.White(sd=0.1))
    return described, mission, nf.replay(described, mission)


@pytest.mark.parametrize("name", RULES)
def test_a_rival_weighs_by_the_noise_that_it_finds(name, rough):
    """The velocity is surer then."""
    described, mission, rough = rough
    track = replay_rival(name, rival(name, described, mission), mission)
    assert np.isfinite(track.covariance).all() and track.residuals["dvl"].count("used") > 200
    least = 0.7 if name != "student-t" else 1.0  # it makes readings that fit surer, by (nu + m) / nu at most
    assert track.covariance[-1][3, 3] < least * rough.covariance[-1][3, 3]
    again = replay_rival(name, rival(name, described, mission), mission)
    np.testing.assert_array_equal(track.covariance, again.covariance)

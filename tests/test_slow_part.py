"""The slow part: its prior, its states, its place in the likelihood, and its posterior against brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_channel import dense, lags, minus_loglik, walk_with_gaps, wide

import navfilter as nf
from navfilter.kernels.arma_likelihood import LANES, slow_part
from navfilter.learning.learned_model import nearest, slow_psd
from navfilter.learning.likelihood import Likelihood, maximise
from navfilter.learning.slow_posterior import log_share, slow_posterior
from navfilter.learning.slow_prior import SlowPrior, slow_prior
from navfilter.models.error_models import CORRELATION_CONSTANTS, GaussMarkov
from navfilter.models.navigation_drift import Drift
from navfilter.models.spectrum import Spectrum, log_spread
from navfilter.simulation.presets import mems_imu
from navfilter.simulation.scenarios import SCENARIOS, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate
from navfilter.timeseries.model import ArmaModel, simulate_arma

PERIOD_S = 0.5
DRIFT = Drift((0.01, 0.0), PERIOD_S)
PRIOR = SlowPrior(0.5, 40.0, 300.0)


# ---------------------------------------------------------------------- states


def chain_of(order, sd, tau_s):
    """Transition, noise and start of a slow part."""
    chain = np.zeros((3, order, order))
    slow_part(order, math.log(sd), math.log(tau_s), CORRELATION_CONSTANTS[order] * PERIOD_S, chain)
    return chain


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("tau_s", [0.3, 5.0, 60.0, 4e3, 1e6])
def test_the_slow_states_are_a_gauss_markov_process(order, tau_s):
    """The covariance function is that of the block of the filter, and the start is stationary."""
    Phi, Q, P0 = chain_of(order, 0.7, tau_s)
    block, moved = GaussMarkov(0.7, tau_s, order).block(PERIOD_S), np.eye(order)
    other = np.eye(order)
    for _ in range(40):
        assert (moved @ P0)[0, 0] == pytest.approx(block.C @ other @ block.P0 @ block.C, rel=1e-10, abs=1e-12)
        moved, other = Phi @ moved, block.Phi @ other
    # with very long times Q is nine decades below P0: what the difference leaves of it is rounding
    np.testing.assert_allclose(Q, P0 - Phi @ P0 @ Phi.T, rtol=1e-9, atol=4e-16 * P0.max())
    assert np.array_equal(Phi, np.triu(Phi)) and np.array_equal(Q, Q.T)


@pytest.mark.parametrize("order", [1, 2])
def test_noise_of_a_very_slow_part_is_no_rounding(order):
    """Against the integral of the driving noise by quadrature."""
    beta = CORRELATION_CONSTANTS[order] / 1e6
    at, weight = np.polynomial.legendre.leggauss(12)
    s, weight = 0.5 * PERIOD_S * (at + 1.0), 0.5 * PERIOD_S * weight
    way = np.exp(-beta * s) * (np.stack([beta * s, np.ones_like(s)]) if order == 2 else np.ones((1, s.size)))
    density = 4.0 * beta if order == 2 else 2.0 * beta
    Q = chain_of(order, 1.0, 1e6)[1]
    np.testing.assert_allclose(Q, density * (way * weight) @ way.T, rtol=1e-12)


def test_psd_is_the_transform_of_the_covariance():
    frequency = np.array([0.0, 0.003, 0.02])
    t = np.arange(0.0, 4000.0, 0.05)
    for order in (1, 2):
        beta = CORRELATION_CONSTANTS[order] / 30.0
        acf = 0.7**2 * np.exp(-beta * t) * (1.0 + beta * t if order == 2 else 1.0)
        expected = [4.0 * np.trapezoid(acf * np.cos(2.0 * np.pi * f * t), t) for f in frequency]
        found = slow_psd(np.array([order]), np.array([0.7]), np.array([30.0]), frequency)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-4)


# ---------------------------------------------------------------------- prior


def test_the_prior_comes_from_the_vehicle_file():
    prior = slow_prior(nf.GaussMarkov(sd=0.6, tau_s=30.0), 0.125, 500.0)
    assert prior.sd == pytest.approx(0.6) and prior.span_s == 500.0
    assert prior.tau_s == pytest.approx(60.0, rel=1e-3)  # twice as slow, but for sampling
    with_white = slow_prior(nf.GaussMarkov(sd=0.6, tau_s=30.0) + nf.White(sd=3.0) + nf.RandomWalk(1.0), 0.125, 500.0)
    assert with_white.sd == pytest.approx(0.6) and with_white.tau_s == pytest.approx(prior.tau_s)
    assert slow_prior(nf.White(sd=1.0), 0.125, 500.0) is None
    assert slow_prior(nf.White(sd=1.0) + nf.RandomWalk(density=1.0), 0.125, 500.0) is None
    # an oscillation has variance and hardly any power at zero: the slow part's time is at least the first node's
    swing = nf.Arma(ar=(-1.96, 0.98), ma=(), sd=0.01)
    assert slow_prior(swing, 0.125, 500.0).tau_s == pytest.approx(500.0 / 50.0)


def test_a_slow_error_that_is_not_described_is_unlikely_and_as_large_or_has_the_power_that_is():
    """As large as white noise, whose description says nothing of time; with the power at zero frequency of what is
    quicker than any slow error.
    """
    kind = nf.GaussMarkov(sd=0.01, tau_s=30.0)
    white = slow_prior(nf.White(sd=0.1), 0.25, 500.0, kind=kind)
    quick = slow_prior(nf.GaussMarkov(sd=0.1, tau_s=1.0), 0.25, 500.0, kind=kind)
    assert white.absent == quick.absent == 0.95
    assert (white.tau_s, quick.tau_s) == pytest.approx((60.0, 10.0), rel=1e-4)
    assert white.sd == pytest.approx(0.1)
    # the slow part of a description is twice as slow as the whole
    assert quick.sd**2 * quick.tau_s == pytest.approx(0.1**2 * 2.0, rel=0.01)


def test_fixes_whose_error_is_all_slow_are_believed_as_described():
    """Without a DVL a drift hides all of the error but its white noise; half of what was described was believed of it:
    NEES 1.9 over these missions (0.9 to 2.3), now 0.6. Of a vehicle with more noise in its unit 3.1, now 1.3.
    """
    true = GaussMarkov(sd=0.03, tau_s=70.0, order=2) + nf.White(sd=0.006)
    said = GaussMarkov(sd=0.03, tau_s=20.0) + nf.White(sd=0.008)
    tilt = GaussMarkov(sd=0.005, tau_s=20.0)
    sensors = {
        "ahrs": nf.Attitude(rate_hz=1.0, error=(tilt, tilt, GaussMarkov(sd=0.01, tau_s=30.0))),
        "gps": nf.Position(rate_hz=5.0, error=true),
    }
    vehicle, motion = nf.Vehicle(replace(mems_imu(), rate_hz=20.0), sensors), SCENARIOS["lawnmower"].motion(700.0)
    learns, nees = vehicle.with_error(gps=nf.LearnedArma(prior=said)), []
    for seed in range(8):
        mission = simulate(vehicle, motion, seed=seed, duration_s=700.0, faults={"gps": Faults(available="always")})
        track = nf.replay(learns, mission, output_rate_hz=1.0)
        errors = track.errors(mission.truth)
        nees.append(float(np.nanmean(track.nees(errors)["position"][track.time_s > 120.0])))
    # eight missions of eight correlation times, three axes: a mean known to 0.1
    assert 0.4 < np.mean(nees) < 1.3, nees


def test_the_prior_density_is_a_lognormal_one():
    """Differences in the logarithm: those of two normal densities, and of the two orders."""
    at = PRIOR.log_density(1, math.log(PRIOR.median * PRIOR.sd), math.log(PRIOR.tau_s))
    off = PRIOR.log_density(1, math.log(PRIOR.median * PRIOR.sd) + PRIOR.spread, math.log(PRIOR.tau_s))
    slower = PRIOR.log_density(1, math.log(PRIOR.median * PRIOR.sd), math.log(PRIOR.tau_s) - 2.0 * PRIOR.tau_spread)
    smooth = PRIOR.log_density(2, math.log(PRIOR.median * PRIOR.sd), math.log(PRIOR.tau_s))
    assert off - at == pytest.approx(-0.5) and slower - at == pytest.approx(-2.0)
    assert math.exp(smooth - at) == pytest.approx(PRIOR.second_order / (1.0 - PRIOR.second_order))


# ---------------------------------------------------------------------- likelihood


def covariance(node, n, period_s):
    t = np.asarray(lags(n), float) * period_s * CORRELATION_CONSTANTS[node.order] / node.tau_s
    return node.sd**2 * np.exp(-t) * (1.0 + t if node.order == 2 else 1.0)


@pytest.mark.parametrize("node", [GaussMarkov(0.8, 12.0), GaussMarkov(0.8, 12.0, 2), GaussMarkov(0.05, 600.0, 2)])
@pytest.mark.parametrize(("ar", "ma"), [([], []), ([-0.7], [0.2]), ([-1.2, 0.5], [])])
@pytest.mark.parametrize("drift", [Drift((), PERIOD_S), Drift((0.3, 0.05), PERIOD_S)])
def test_a_likelihood_with_a_slow_part_is_the_dense_gaussian(node, ar, ma, drift):
    random = np.random.default_rng(8)
    y, n, d = walk_with_gaps(random), 70, drift.order
    likelihood = Likelihood(y, drift, 0.04, PRIOR, clip=1e9)
    theta = np.r_[ar, ma, math.log(0.6) + likelihood.log_unit, math.log(node.sd) + likelihood.log_unit]
    V = ArmaModel(ar, ma, 0.6).autocovariance(n)[lags(n)] + 0.04 * np.eye(n) + covariance(node, n, PERIOD_S)
    if d:  # what enters at a tick reaches all from the next on, as level and as rate
        level = [wide((np.arange(n) > t) * 1.0) for t in range(n)]
        rate = [wide(np.maximum(np.arange(n) - t - 1, 0) * PERIOD_S) for t in range(n)]
        Q = drift.noise()
        for t in range(n):
            ways = np.stack([level[t], rate[t]], axis=1)
            V = V + ways @ Q @ ways.T
    X = np.stack([np.ones(n), np.arange(n) * PERIOD_S], axis=1)[:, :d]
    expected = dense(y, wide(V), wide(X))
    counts = int(np.isfinite(y).sum()) - d
    value = minus_loglik(likelihood, np.r_[theta, math.log(node.tau_s)], len(ar), node.order)
    assert value + counts * likelihood.log_unit == pytest.approx(expected, abs=1e-7)


def test_point_is_the_slope_of_what_is_minimised():
    y = noisy(800, 3)
    likelihood = Likelihood(y, DRIFT, 0.0, PRIOR)
    for slow in (1, 2):
        theta = np.r_[-0.5, 0.1, -0.3, -0.7, math.log(50.0)]
        point = likelihood.point(theta, 1, slow)
        for k in range(5):
            step = 1e-4 * np.eye(5)[k]
            ends = likelihood.penalised([theta + step, theta - step], 1, slow)
            assert point.gradient[k] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-3, abs=2e-3)


@pytest.mark.parametrize("count", [0, 3, LANES])
def test_others_beside_a_point_change_nothing(count):
    """To the last bit, also where they have no room beside its lanes."""
    likelihood = Likelihood(noisy(800, 3), DRIFT, 0.0, PRIOR)
    theta = np.r_[-0.5, 0.1, -0.3, -0.7, math.log(50.0)]
    others = [theta + 0.01 * i for i in range(count)]
    alone, (point, values) = likelihood.point(theta, 1, 1), likelihood.points(theta, 1, 1, others)
    assert values == [likelihood.penalised([other], 1, 1)[0] for other in others]
    assert point.value == alone.value == likelihood.penalised([theta], 1, 1)[0]
    assert np.array_equal(point.gradient, alone.gradient) and np.array_equal(point.info, alone.info)


def test_parts_of_a_likelihood_add_up():
    likelihood = Likelihood(noisy(500, 4), DRIFT, 0.0, PRIOR)
    theta = np.r_[-0.5, 0.0, -0.7, math.log(50.0)]
    (whole,), z = likelihood.standardised([theta], 1, 1)
    assert np.isfinite(z).sum() == likelihood.n

    def since(first):
        return float(likelihood.lines(theta[:2], 1, 1, theta[3:], theta[2:3] - likelihood.log_unit, first)[0])

    assert since(0) == pytest.approx(whole, rel=1e-12)
    assert since(1) == since(0)  # the first does not count: it fixes the diffuse level
    early = Likelihood(noisy(500, 4)[:200], DRIFT, 0.0, PRIOR)
    early_theta = theta + np.r_[0.0, 1.0, 1.0, 0.0] * (early.log_unit - likelihood.log_unit)
    before = minus_loglik(early, early_theta, 1, 1) + early.n * (likelihood.log_unit - early.log_unit)
    assert since(200) == pytest.approx(whole - before, rel=1e-9)
    assert since(500) == 0.0


# ---------------------------------------------------------------------- posterior


def noisy(n, seed, sd=0.4, tau_s=25.0):
    random = np.random.default_rng(seed)
    phi = math.exp(-PERIOD_S / tau_s)
    slow = simulate_arma([-phi], [], sd * math.sqrt(1.0 - phi * phi), n, random)
    walk = np.cumsum(DRIFT.density[0] * math.sqrt(PERIOD_S) * random.standard_normal(n))
    return slow + 0.2 * random.standard_normal(n) + walk


def brute_force(likelihood, fast, p):
    """Posterior on a fine grid of order, ln tau and ln sd: rows of order, tau, sd, weight."""
    prior, rows = likelihood.prior, []
    taus = np.linspace(*np.log(prior.taus_s[[0, -1]]), 36)
    sds = np.linspace(*np.log(prior.sd_limits), 90)
    for order in (1, 2):
        for log_tau in taus:
            for log_sd in sds:
                value = minus_loglik(likelihood, np.r_[fast, log_sd + likelihood.log_unit, log_tau], p, order)
                rows.append((order, log_tau, log_sd, -value + prior.log_density(order, log_sd, log_tau)))
    out = np.array(rows)
    out[:, 3] = np.exp(out[:, 3] - out[:, 3].max())
    out[:, 3] /= out[:, 3].sum()
    return out


@pytest.fixture(scope="module")
def fitted():
    likelihood = Likelihood(noisy(600, 5), DRIFT, 0.0, PRIOR)
    point = maximise(likelihood, [np.r_[0.0, math.log(0.3) + likelihood.log_unit, math.log(30.0)]], 0, 20, 1)
    return likelihood, point


def test_what_cannot_become_good_enough_is_not_improved(fitted):
    likelihood, found = fitted
    starts = [np.r_[0.0, math.log(size) + likelihood.log_unit, math.log(30.0)] for size in (0.3, 0.1)]
    begun = likelihood.penalised(likelihood.confine(starts, 0, 1), 0, 1)
    assert begun.min() > found.value + 1.0
    for enough, value in ((-math.inf, begun.min()), (found.value - 1e3, begun.min()), (found.value, found.value)):
        point = maximise(likelihood, starts, 0, 20, 1, enough)
        assert point.value == pytest.approx(value, abs=0.1), enough
        assert likelihood.penalised([point.theta], 0, 1)[0] == point.value


@pytest.fixture(scope="module")
def followed(fitted):
    likelihood, point = fitted
    return slow_posterior(likelihood, point)


def test_the_posterior_is_that_of_a_fine_grid(fitted, followed):
    """Masses, E[sd^2], E[sd^2 tau] within a tenth: seven places a line and eight lines in place of 6480 points."""
    likelihood, point = fitted
    order, log_tau, log_sd, weight = brute_force(likelihood, point.theta[:-2], 0).T
    kind, tau, mass, square = followed.moments.T
    # a slow error of this size shows: nothing is left for none
    assert mass.sum() == pytest.approx(1.0, abs=1e-6)
    assert mass[kind == 2].sum() == pytest.approx(weight[order == 2].sum(), abs=0.03)
    expected = float(weight @ np.exp(2.0 * log_sd))
    assert float(mass @ square) == pytest.approx(expected, rel=0.1)
    level = float(weight @ (np.exp(2.0 * log_sd) * np.exp(log_tau)))
    assert float((mass * square) @ tau) == pytest.approx(level, rel=0.15)
    for part in (0.25, 0.5, 0.75):  # cumulated mass in ln tau, between the nodes
        limit = np.log(PRIOR.taus_s[0]) + part * np.log(PRIOR.taus_s[-1] / PRIOR.taus_s[0])
        assert mass[np.log(tau) <= limit].sum() == pytest.approx(weight[log_tau <= limit].sum(), abs=0.08)


def alone(moments, period_s=0.125, sd=0.0):
    """Processes that stand for many beside white noise, of which there is none."""
    return nearest(np.asarray(moments, float), nf.ArmaModel((), (), sd), 0.0, period_s)


def test_parts_carry_the_mean_variance_and_the_mean_power(followed):
    parts, (_, tau, mass, square) = alone(followed.moments), followed.moments.T
    assert 1 <= len(parts) <= 2
    assert sum(part.sd**2 for part in parts) == pytest.approx(float(mass @ square), rel=1e-3)
    assert sum(part.sd**2 * part.tau_s for part in parts) == pytest.approx(float(mass @ (square * tau)), rel=1e-3)
    assert parts == tuple(sorted(parts, key=lambda part: part.tau_s))


@pytest.mark.parametrize(
    ("moments", "expected"),
    [
        ([[1, 20.0, 1.0, 0.04]], (GaussMarkov(0.2, 20.0),)),
        ([[2, 20.0, 1.0, 0.04]], (GaussMarkov(0.2, 20.0, 2),)),
        ([[1, 20.0, 0.5, 0.08], [1, 500.0, 0.5, 0.18]], (GaussMarkov(0.2, 20.0), GaussMarkov(0.3, 500.0))),
        ([[1, 20.0, 0.5, 0.08], [2, 500.0, 0.5, 0.18]], (GaussMarkov(0.2, 20.0), GaussMarkov(0.3, 500.0, 2))),
        ([[1, 20.0, 1.0, 0.04], [1, 900.0, 1e-7, 0.04]], (GaussMarkov(0.2, 20.0),)),
        ([[1, 20.0, 1.0, 0.0]], ()),
    ],
)
def test_moments_become_one_or_two_processes(moments, expected):
    parts = alone(moments)
    assert [part.order for part in parts] == [part.order for part in expected]
    for part, other in zip(parts, expected, strict=True):
        # one in ten million of 900 s still counts at zero frequency
        assert (part.sd, part.tau_s) == pytest.approx((other.sd, other.tau_s), rel=1e-5)


@pytest.mark.parametrize("smooth", [0.0, 0.3, 0.7, 0.95, 1.0])
def test_two_processes_have_the_mean_power_at_all_frequencies(smooth):
    """Of a posterior over times of 10 s to 20 min, of either order: those told by mean correlation times had 3 % of it
    at the upper end where all is smooth.
    """
    random = np.random.default_rng(4)
    tau = np.repeat(10.0 * 2.0 ** np.arange(8.0), 2)
    order = np.tile([1.0, 2.0], 8)
    frequency = np.geomspace(1e-5, 0.05, 30)
    for _ in range(20):
        weight = np.repeat(random.dirichlet(np.ones(8)), 2) * np.where(order == 2, smooth, 1.0 - smooth)
        moments = np.column_stack([order, tau, weight, random.uniform(0.5, 2.0, 16)])
        parts, variance = alone(moments, 10.0), weight * moments[:, 3]
        assert sum(part.sd**2 for part in parts) == pytest.approx(variance.sum())
        assert sum(part.sd**2 * part.tau_s for part in parts) == pytest.approx(variance @ tau)
        mean = variance @ slow_psd(order, np.ones(16), tau, frequency)
        found = sum(slow_psd([part.order], [part.sd], np.array([part.tau_s]), frequency)[0] for part in parts)
        # what two processes can: a factor of 1.6 of a sum of sixteen
        assert 0.6 < (found / mean).min() < 1.01 and 0.99 < (found / mean).max() < 1.8


def test_none_of_first_order_stands_for_smooth_ones():
    """What it scatters by from one reading to the next none of them does: innovations of a compass with a smooth error
    were half as large as said. Beside white noise that is larger it may.
    """
    tau = 10.0 * 2.0 ** np.arange(8.0)
    random, orders = np.random.default_rng(5), set()
    for _ in range(20):
        moments = np.column_stack([np.full(8, 2.0), tau, random.dirichlet(np.ones(8)), random.uniform(0.5, 2.0, 8)])
        assert {part.order for part in alone(moments, sd=1e-3)} == {2}
        orders |= {part.order for part in alone(moments, sd=1.0)}
    assert orders == {1, 2}


def test_a_prior_that_is_known_is_believed_as_it_stands():
    described = nf.GaussMarkov(sd=0.02, tau_s=30.0) + nf.White(sd=0.01)
    prior = slow_prior(described, 0.25, 500.0, within=(2.0, 3.0))
    # S(0) of the sampled process tells the time
    assert (prior.median * prior.sd, prior.tau_s) == pytest.approx((0.02, 30.0), rel=1e-4)
    assert (prior.spread, prior.tau_spread) == pytest.approx((math.log(2.0), math.log(3.0)))
    # of an error that is quicker than any slow one it says nothing
    quick = nf.GaussMarkov(sd=0.02, tau_s=3.0)
    assert slow_prior(quick, 0.25, 500.0, within=(2.0, 3.0)) == slow_prior(quick, 0.25, 500.0)


def test_a_known_prior_holds_what_a_drift_hides():
    """Straight dives beside a tactical unit: what lasts for minutes cannot be told from the tilt, and was believed."""
    true, said = (nf.GaussMarkov(sd=sd, tau_s=tau) + nf.White(sd=0.01) for sd, tau in ((0.015, 20.0), (0.02, 30.0)))
    vehicle, square = survey_vehicle().with_error(dvl=true), []
    at = {"gps": Faults(available="surface")}
    for seed in range(3):
        mission = simulate(vehicle, SCENARIOS["transit"].motion(3600.0), seed=seed, duration_s=3600.0, faults=at)
        row = []
        for within in (None, (2.0, 3.0)):
            learns = vehicle.with_error(dvl=nf.LearnedArma(prior=said, prior_within=within))
            track = nf.replay(learns, mission, output_rate_hz=1.0)
            errors = track.errors(mission.truth)
            under = track.time_s > 300.0
            row += [np.mean(errors.horizontal[under] ** 2), np.nanmean(track.nees(errors)["position"][under])]
        square.append(row)
    plain, _, known, nees = np.mean(square, axis=0)
    # 7.0 and 6.3 m: three missions, each of a few errors of the position that are independent
    assert known < plain < 9.0**2
    assert 0.3 < nees < 1.6


def spread(mass, values):
    log = np.log(values)
    return math.sqrt(float(mass @ log**2) - float(mass @ log) ** 2)


def test_on_average_a_slow_error_is_as_large_as_the_file_says_of_the_whole():
    """Of a lognormal the mean of sd^2 is `median^2 exp(2 spread^2)`."""
    assert PRIOR.median**2 * math.exp(2.0 * PRIOR.spread**2) == pytest.approx(1.0, rel=1e-12)


def test_without_evidence_the_posterior_is_the_prior(fitted, monkeypatch):
    likelihood, point = fitted
    monkeypatch.setattr(likelihood, "lines", lambda *asked: np.zeros(len(asked[-1])))
    kind, tau, mass, square = slow_posterior(likelihood, point).moments.T
    prior = np.array(
        [
            math.exp(PRIOR.log_density(int(order), math.log(PRIOR.median * PRIOR.sd), math.log(t)))
            for order, t in zip(kind, tau, strict=True)
        ]
    )
    there = 1.0 - PRIOR.absent
    assert mass.sum() == pytest.approx(there, abs=1e-3)
    np.testing.assert_allclose(np.cumsum(mass), np.cumsum(there * prior / prior.sum()), atol=0.02)
    # of a lognormal: median^2 exp(2 spread^2); the places end five standard deviations out
    mean = there * (PRIOR.median * PRIOR.sd) ** 2 * math.exp(2.0 * PRIOR.spread**2)
    assert float(mass @ square) == pytest.approx(mean, rel=0.1)


def test_the_odds_of_no_slow_part_are_prior_odds_times_a_ratio_of_likelihoods():
    """Against sums over a fine grid, on white noise: what is left of a slow part is less than what was believed."""
    prior = replace(PRIOR, absent=0.4)
    y = 0.2 * np.random.default_rng(7).standard_normal(600)
    likelihood = Likelihood(y, DRIFT, 0.0, prior)
    fast = np.array([math.log(0.2) + likelihood.log_unit])
    theta = np.r_[fast, math.log(0.05) + likelihood.log_unit, math.log(20.0)]
    found = slow_posterior(likelihood, likelihood.point(theta, 0, 1))
    # on the nodes of tau that `follow` has, and a fine grid of sd; a lognormal on equal steps is its own integral
    log_sd, log_tau = np.linspace(*np.log(prior.sd_limits), 400), np.log(prior.taus_s)
    value = np.array(
        [
            [-minus_loglik(likelihood, np.r_[fast, u + likelihood.log_unit, t], 0, order) for u in log_sd]
            for order in (1, 2)
            for t in log_tau
        ]
    )
    believed = np.array(
        [[math.exp(prior.log_density(order, u, t)) for u in log_sd] for order in (1, 2) for t in log_tau]
    )
    none = -minus_loglik(likelihood, np.r_[fast, -30.0, math.log(20.0)], 0, 1)
    ratio = float((believed / believed.sum() * np.exp(value - none)).sum())
    expected = (1.0 - prior.absent) * ratio / ((1.0 - prior.absent) * ratio + prior.absent)
    assert found.moments[:, 2].sum() == pytest.approx(expected, rel=0.1)
    assert 0.01 < expected < 0.5 * (1.0 - prior.absent)
    assert found.weight.sum() == pytest.approx(1.0)


def test_the_evidence_of_an_order_is_the_integral_over_its_slow_part(fitted):
    """Laplace's approximation at the maximum, against sums over a fine grid beside the same fast part: half a nat."""
    likelihood, point = fitted
    point = maximise(likelihood, [point.theta], 0, 20, 1)
    log_sd, log_tau = np.linspace(*np.log(PRIOR.sd_limits), 300), np.linspace(*np.log(PRIOR.taus_s[[0, -1]]), 60)
    rows = np.array([[*point.theta[:-2], u + likelihood.log_unit, t] for t in log_tau for u in log_sd])
    believed = np.array([PRIOR.log_density(1, u, t) for t in log_tau for u in log_sd])
    values = -likelihood.standardised(rows, 0, 1)[0]
    cell = (log_sd[1] - log_sd[0]) * (log_tau[1] - log_tau[0])
    # the prior is cut off at the ends of the correlation time: the nodes' sum times their distance is its mass
    mass = math.exp(PRIOR.log_mass) * math.log(2.0)
    both = np.exp(values + believed - values.max()).sum() * cell * (1.0 - PRIOR.absent) / mass
    assert -point.value + log_share(likelihood, point) == pytest.approx(values.max() + math.log(both), abs=0.5)
    none = maximise(likelihood, [point.theta[:-2]], 0, 20, 0)
    assert log_share(likelihood, none) == pytest.approx(math.log(PRIOR.absent))


# ---------------------------------------------------------------------- spectrum


def test_the_band_of_a_spectrum_holds_what_it_says():
    """Of lognormal weights: quantiles of a known distribution, at each frequency by itself."""
    z = np.linspace(-4.0, 4.0, 2001)
    weight = np.exp(-0.5 * z**2)
    weight /= weight.sum()
    density = np.exp(np.outer(z, [0.7, -0.2]))  # at the second frequency the order is the other way round
    spectrum = Spectrum.weighted(np.array([0.01, 1.0]), density[::-1], weight)
    np.testing.assert_allclose(np.log(spectrum.low), [-1.645 * 0.7, -1.645 * 0.2], atol=5e-3)
    np.testing.assert_allclose(np.log(spectrum.median), 0.0, atol=5e-3)
    np.testing.assert_allclose(np.log(spectrum.high), [1.645 * 0.7, 1.645 * 0.2], atol=5e-3)
    assert spectrum.sd_log_s0 == pytest.approx(0.7, rel=1e-3)


def test_a_spectrum_that_is_known_has_no_band():
    alone = Spectrum.weighted(np.array([0.01, 1.0]), np.array([[2.0, 3.0]]), np.ones(1))
    assert alone.low == alone.median == alone.high == (2.0, 3.0) and alone.sd_log_s0 == 0.0


def test_the_spread_of_a_spectrum_is_that_of_its_coefficients():
    """Against 4000 draws; first order is enough for coefficients this well known."""
    ar, ma = np.array([-1.2, 0.5]), np.array([0.3])
    root = 0.01 * np.random.default_rng(1).normal(size=(4, 4))
    turn = np.array([0.01, 0.5, 1.5, 3.0])
    logs = []
    for a1, a2, c1, log_sd in np.random.default_rng(2).normal(size=(4000, 4)) @ root.T:
        logs.append(
            np.log(ArmaModel(ar + np.array([a1, a2]), ma + c1, math.exp(log_sd)).spectrum(turn / (2.0 * np.pi), 1.0))
        )
    # 4000 draws know a standard deviation to 1.1 %
    np.testing.assert_allclose(log_spread(ar, ma, root @ root.T, turn), np.std(logs, axis=0), rtol=0.05)

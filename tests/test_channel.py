"""The channel likelihood: kernels against their twins and a dense Gaussian, and the fit."""

import math

import naive
import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from scipy.linalg import expm

from navfilter.kernels import arma_likelihood as kernels
from navfilter.kernels.arma_likelihood import LANES
from navfilter.learning.arma_fit import fit_channel
from navfilter.learning.likelihood import Likelihood
from navfilter.learning.slow_prior import drift_chain
from navfilter.models.navigation_drift import Drift
from navfilter.timeseries.model import ArmaModel, add_arma, simulate_arma

DEG = math.pi / 180.0
PERIOD_S = 0.125
TACTICAL = Drift((0.3 * DEG / 60.0, 0.0), PERIOD_S)
MEMS = Drift((3.0 * DEG / 60.0, 0.0), PERIOD_S)
NEVER = 1e9


def gauss_markov(sd, tau_s, period_s=PERIOD_S):
    phi = math.exp(-period_s / tau_s)
    return ArmaModel([-phi], [], sd * math.sqrt(1.0 - phi * phi))


def series(parts, drift, n, seed):
    """The sum of some errors and of a drift with a constant rate."""
    random = np.random.default_rng(seed)
    noise = sum(simulate_arma(part.ar, part.ma, part.sd, n, random) for part in parts)
    step = drift.density[0] * math.sqrt(drift.period_s) if drift.order else 0.0
    return noise + np.cumsum(step * random.standard_normal(n) + random.standard_normal() * 1e-5)


def log_s0(model):
    return 2.0 * math.log(model.sd * abs((1.0 + model.ma.sum()) / (1.0 + model.ar.sum())))


def packed(ar, ma, sd):
    m = max(len(ar), len(ma), 1)
    return np.r_[ar, np.zeros(m - len(ar)), ma, np.zeros(m - len(ma)), math.log(sd)]


def filtered(y, thetas, chains, sees, rules, first=0):
    """Minus the log-likelihood of some models."""
    values = np.empty(len(thetas))
    kernels.channel_filter(y, thetas, chains, sees, rules, first, *np.empty((2, 0, LANES)), values)
    return values


def run(y, theta, chain, sees, d, clip=NEVER, white=0.0, longest=8.0):
    """Minus the log-likelihood of one model."""
    return filtered(y, theta[None], chain[None], sees, np.array([d, longest, clip, white]))[0]


# ---------------------------------------------------------------------- the drift


@pytest.mark.parametrize("r", [1, 2, 3, 4])
def test_drift_discretisation_is_van_loans(r):
    density, dt = (0.3, 0.7, 0.02, 1.1)[:r], 0.37
    drift = Drift(density, dt)
    F = np.eye(r, k=1)
    block = expm(dt * np.block([[-F, np.diag(np.square(density))], [np.zeros((r, r)), F.T]]))
    Phi = block[r:, r:].T
    np.testing.assert_allclose(drift.transition(), Phi, rtol=1e-12)
    np.testing.assert_allclose(drift.noise(), Phi @ block[:r, r:], rtol=1e-10)
    np.testing.assert_allclose(drift.noise(), van_loan_discretization(F, np.diag(density), dt)[1], rtol=1e-10)


def test_drift_per_tick_moves_like_the_drift():
    drift = Drift((0.3, 0.7, 0.02), 0.37)
    scale = np.diag(0.37 ** np.arange(3))
    unit = Drift((0.3, 0.7, 0.02), 1.0).transition()
    np.testing.assert_allclose(scale @ drift.transition() @ np.linalg.inv(scale), unit, rtol=1e-14)
    np.testing.assert_allclose(scale @ drift.noise() @ scale, drift.per_tick()[:3], rtol=1e-14)


@pytest.mark.parametrize(
    ("density", "period_s", "match"),
    [
        ((1, 2, 3, 4, 5), 1.0, "at most 4"),
        ((-1.0,), 1.0, "not negative"),
        ((math.nan,), 1.0, "finite"),
        ((1.0,), 0.0, "period_s"),
    ],
)
def test_drift_refuses(density, period_s, match):
    with pytest.raises(ValueError, match=match):
        Drift(density, period_s)


# ---------------------------------------------------------------------- the kernels

# coefficients, integrators that start diffuse, states beside them
CASES = [
    ([-1.5, 0.6], [0.3], 2, 0),
    ([-0.9], [], 1, 0),
    ([-0.5, 0.2, 0.1, 0.05], [0.1, 0.2, 0.3], 3, 0),
    ([], [0.5, 0.2], 4, 0),
    ([], [], 2, 0),
    ([-0.99], [-0.9], 0, 1),
    ([-0.8], [0.3], 2, 1),
    ([-1.5, 0.6], [0.3], 2, 2),
    ([], [], 1, 3),
]
FAST = {1: ([-0.8], [0.3]), 2: ([-1.5, 0.6], [0.3]), 3: ([-0.9, 0.1], [0.2, 0.1, 0.05])}
FAST[4] = [-0.5, 0.2, 0.1, 0.05], [0.1, 0.2, 0.3]


def chain_of(d, beside, random):
    """Integrators and a cascade beside them, all their noises and starts correlated, and how the reading sees them."""
    r = d + beside
    U = np.zeros((r, r))
    U[:d, :d] = Drift((1.0,) * d, 1.0).transition() if d else 0.0
    U[d:, d:] = 0.9 * np.eye(beside) + 0.2 * np.eye(beside, k=1)
    covariances = [B @ B.T for B in 0.1 * random.normal(size=(2, r, r))]
    return np.stack([U, *covariances]), np.r_[np.eye(d)[0] if d else [], np.linspace(1.0, 0.3, beside)]


def moved(theta, chain, free, steps, d):
    """Parameter vectors and chains, each with one parameter moved: those of `free`, then the size of what is beside the
    integrators.
    """
    thetas, chains = np.tile(theta, (len(steps) + 1, 1)), np.tile(chain, (len(steps) + 1, 1, 1, 1))
    for i, step in enumerate(steps):
        if i < len(free):
            thetas[i + 1, free[i]] += step
        else:
            chains[i + 1, 1:, d:, d:] *= math.exp(2.0 * step)
    return thetas, chains


def scored(of, y, theta, chain, sees, rules, free, steps, d):
    k = len(steps)
    thetas, chains = moved(theta, chain, free, steps, d)
    E, V, values = *np.empty((2, len(y), LANES * (k // LANES + 1))), np.empty(k + 1)
    info, gradient = np.empty((k, k)), np.empty(k)
    of.channel_filter(y, thetas, chains, sees, rules, 0, E, V, values)
    of.channel_scores(E, V, steps, rules[2], info, gradient)
    return values[0], gradient, info


def walk_with_gaps(random, n=70):
    y = np.cumsum(random.normal(size=n))
    y[[0, 4, 5, 6, 20, 21, 40]] = np.nan
    return y


@pytest.mark.parametrize(("ar", "ma", "d", "beside"), CASES)
@pytest.mark.parametrize("clip", [NEVER, 0.8])
@pytest.mark.parametrize("first", [0, 33, 70])
def test_filter_is_its_twin(ar, ma, d, beside, clip, first):
    """Several models at once, one of them not stationary, against each by itself."""
    random = np.random.default_rng(3)
    y, theta, (chain, sees) = walk_with_gaps(random), packed(ar, ma, 0.7), chain_of(d, beside, random)
    y[45:56] = np.nan  # longer than the longest gap: a new segment
    y[60] += 30.0
    rules = np.array([d, 8.0, clip, 0.04])
    thetas, chains = np.tile(theta, (4, 1)), np.tile(chain, (4, 1, 1, 1))
    thetas[1, 0], thetas[2, 0], thetas[3, -1] = -1.01 if len(theta) == 3 else 3.0, 0.9 * theta[0], 0.3
    chains[2, 1:] *= 3.0
    E, V, values = *np.empty((2, 2, len(y), LANES)), np.empty((2, 4))
    for of, e, variances, value in zip((kernels, naive), E, V, values, strict=True):
        of.channel_filter(y, thetas, chains, sees, rules, first, e, variances, value)
    assert np.isinf(values[:, 1]).all() and np.isfinite(values[:, [0, 2, 3]]).all()
    able = [0, 2, 3]
    np.testing.assert_allclose(values[0, able], values[1, able], rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(E[0][:, able], E[1][:, able], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(V[0][:, able], V[1][:, able], rtol=1e-9)
    # d samples at the start of each of the two segments do not count
    assert np.isfinite(E[0][:, 0]).sum() == np.isfinite(y).sum() - 2 * d
    assert (first < len(y)) == (values[0, 0] != 0.0)


@pytest.mark.parametrize(("d", "slow", "m"), [*kernels.SHAPES, (1, 1, 1), (2, 0, 1), (2, 2, 3)])
def test_a_tick_that_is_written_out_is_its_twin(d, slow, m):
    """The shapes of a learner, and some of which each tick goes through loops; more models than lanes, clipped."""
    random = np.random.default_rng(8)
    y, theta = walk_with_gaps(random, 150), packed(*FAST[m], 0.7) if m else np.log([0.7])
    y[60:71] = np.nan
    y[90] += 30.0
    r, count = d + slow, LANES + 3
    chain = np.zeros((3, r, r))
    chain[:, :d, :d] = drift_chain(Drift((0.3, 0.1, 0.02)[:d], 1.0), 1.0)
    chains = np.tile(chain, (count, 1, 1, 1))
    if slow:
        for one, log_sd, log_tau in zip(
            chains, np.linspace(-0.7, 0.7, count), np.linspace(1.6, 3.9, count), strict=True
        ):
            kernels.slow_part(slow, log_sd, log_tau, 1.0, one)
    sees = np.eye(r)[0] + (np.arange(r) == d) * (slow > 0)
    thetas, rules = np.tile(theta, (count, 1)), np.array([d, 8.0, 1.5, 0.04])
    thetas[:, -1] += 0.01 * np.arange(count)
    E, V, values = *np.empty((2, 2, len(y), 2 * LANES)), np.empty((2, count))
    for of, e, variances, value in zip((kernels, naive), E, V, values, strict=True):
        of.channel_filter(y, thetas, chains, sees, rules, 3, e, variances, value)
    np.testing.assert_allclose(values[0], values[1], rtol=1e-11)
    np.testing.assert_allclose(E[0][:, :count], E[1][:, :count], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(V[0][:, :count], V[1][:, :count], rtol=1e-9)


@pytest.mark.parametrize("count", [1, LANES, LANES + 5])
def test_models_side_by_side_do_not_touch_each_other(count):
    """To the last bit: with which others a model goes through the series does not matter."""
    random = np.random.default_rng(6)
    y, (chain, sees) = walk_with_gaps(random, 400), chain_of(2, 1, random)
    thetas = np.tile(packed([-0.8, 0.1], [0.4], 0.7), (count, 1))
    thetas[:, -1] += 1e-3 * np.arange(count)
    thetas[count // 2, 0] = -1.2  # not stationary
    chains, rules = np.tile(chain, (count, 1, 1, 1)), np.array([2, 8.0, 2.0, 0.04])
    values = filtered(y, thetas, chains, sees, rules, 50)
    alone = [filtered(y, row[None], chain[None], sees, rules, 50)[0] for row in thetas]
    assert values.tolist() == alone and len(set(alone)) == count


@pytest.mark.parametrize(("ar", "ma", "d", "beside"), CASES)
def test_scores_are_their_twin(ar, ma, d, beside):
    random = np.random.default_rng(4)
    y, theta, (chain, sees) = walk_with_gaps(random), packed(ar, ma, 0.7), chain_of(d, beside, random)
    m = (len(theta) - 1) // 2
    free, rules = np.r_[np.arange(len(ar)), m + np.arange(len(ma)), 2 * m], np.array([d, 8.0, 1.5, 0.0])
    steps = np.full(len(free) + bool(beside), 1e-4)
    one, other = (scored(of, y, theta, chain, sees, rules, free, steps, d) for of in (kernels, naive))
    for a, b in zip(one[:3], other[:3], strict=True):
        # both take the same differences: what is left is rounding over the step, and with four integrators P spans ten
        # decades
        np.testing.assert_allclose(a, b, rtol=1e-6 if d < 4 else 1e-4, atol=1e-6 if d < 4 else 1e-4)


def test_scores_are_the_slope_of_the_filter():
    random = np.random.default_rng(5)
    y, theta, (chain, sees) = walk_with_gaps(random), packed([-0.8, 0.1], [0.4], 0.7), chain_of(2, 1, random)
    rules, free = np.array([2, 8.0, 1.5, 0.0]), np.array([0, 1, 2, 4])
    gradient = scored(kernels, y, theta, chain, sees, rules, free, np.full(5, 1e-6), 2)[1]
    for k, slope in enumerate(gradient):
        ends = []
        for sign in (1.0, -1.0):
            thetas, chains = moved(theta, chain, free, sign * 1e-5 * np.eye(5)[k], 2)
            ends.append(run(y, thetas[k + 1], chains[k + 1], sees, 2, clip=1.5))
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-3)


BELIEF = np.array([1.3, -0.2, math.log(0.3), -0.5, 1.0, 3.0, 2.0])


def parameters(p, q, slow, count, random):
    """Models of one order, not far from each other."""
    ar, ma = np.array([-0.8, 0.3, -0.1])[:p], np.array([0.4, 0.1])[:q]
    theta = np.r_[ar, ma, -0.3, [-0.7, 3.5] if slow else []]
    return theta + 0.01 * random.normal(size=(count, theta.size))


@pytest.mark.parametrize("slow", [0, 1, 2])
@pytest.mark.parametrize(("p", "q"), [(0, 0), (1, 0), (0, 2), (3, 2)])
def test_values_and_points_are_their_twins(p, q, slow):
    """More models than lanes; with another unit, and what is believed of the slow part."""
    random = np.random.default_rng(12)
    y, drift = walk_with_gaps(random, 150), drift_chain(Drift((0.3, 0.1), 1.0), 1.0)
    rows = parameters(p, q, slow, LANES + 5, random)
    k, r = rows.shape[1], 2 + slow
    sees, rules = np.eye(r)[0] + (np.arange(r) == 2), np.array([2, 8.0, 1.5, 0.04])
    fixed = p, slow, drift, sees, rules, BELIEF
    for first in (0, 60):
        E, V, values = *np.empty((2, 2, len(y), 2 * LANES)), np.empty((2, len(rows)))
        for of, e, S, value in zip((kernels, naive), E, V, values, strict=True):
            of.channel_values(y, rows, *fixed, first, e, S, value)
        np.testing.assert_allclose(values[0], values[1], rtol=1e-10)
        np.testing.assert_allclose(E[0][:, : len(rows)], E[1][:, : len(rows)], rtol=1e-8, atol=1e-8)
    E, V, values = *np.empty((2, 2, len(y), 2 * LANES)), np.empty((2, len(rows)))
    info, gradient, differences = np.empty((2, k, k)), np.empty((2, k)), np.array([1e-4, -1e-4, 2e-4])
    both = rows.copy(), rows.copy()
    for of, row, *out in zip((kernels, naive), both, E, V, values, info, gradient, strict=True):
        of.channel_point(y, row, *fixed, differences, *out)
    assert np.array_equal(*both)
    np.testing.assert_allclose(values[0], values[1], rtol=1e-10)
    np.testing.assert_allclose(info[0], info[1], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(gradient[0], gradient[1], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("slow", [1, 2])
@pytest.mark.parametrize("tau_s", [0.3, 5.0, 60.0, 4e3, 1e6])
def test_a_slow_part_is_its_twin(slow, tau_s):
    one, other = np.zeros((2, 3, 3, 3))
    for of, chain in ((kernels, one), (naive, other)):
        of.slow_part(slow, -0.4, math.log(tau_s), 0.7, chain)
    np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-300)


@pytest.mark.parametrize("size", [1e-3, 3.0, 30.0])
def test_damped_steps_are_their_twin(size):
    """Few steps are left where little is to be gained, and long ones are cut."""
    random = np.random.default_rng(13)
    for k in (1, 3, 11):
        root, sizes, dampings = random.normal(size=(k + 3, k)), max(k - 3, 0), np.array([1e-4, 1e-2, 0.3, 10.0])
        at = random.normal(size=k), size * random.uniform(1.0, 2.0, k), root.T @ root
        moved, gains = np.full((2, 4, k), np.nan), np.full((2, 4), np.nan)
        counts = [
            of.damped_steps(*at, dampings, sizes, 0.05, 1.5, *out)
            for of, *out in zip((kernels, naive), moved, gains, strict=True)
        ]
        assert counts[0] == counts[1] and (counts[0] > 0) == (size > 1.0)
        np.testing.assert_allclose(moved[0], moved[1], rtol=1e-9)
        np.testing.assert_allclose(gains[0], gains[1], rtol=1e-9)


def test_nothing_is_stepped_where_the_slope_is_unknown():
    moved, gains, nothing = np.empty((1, 2)), np.empty(1), np.full(2, np.nan)
    dampings = np.array([0.01])
    for gradient, info in ((nothing, np.eye(2)), (np.ones(2), np.full((2, 2), np.nan)), (np.ones(2), -np.eye(2))):
        assert kernels.damped_steps(np.zeros(2), gradient, info, dampings, 1, 0.05, 1.5, moved, gains) == 0


@pytest.mark.parametrize(
    ("a", "c"), [([-0.9], [0.0]), ([-1.5, 0.6], [0.3, 0.0]), ([-0.5, 0.2, 0.1, 0.05], [0.1, 0.2, 0.3, 0.0])]
)
def test_stationary_is_its_twin(a, c):
    P, twin = np.empty((len(a), len(a))), np.empty((len(a), len(a)))
    assert kernels.stationary(np.array(a), np.array(c), P) and naive.stationary(np.array(a), np.array(c), twin)
    np.testing.assert_allclose(P, twin, rtol=1e-10, atol=1e-12)


def test_nothing_is_stationary_outside_the_circle():
    assert not kernels.stationary(np.array([-1.01]), np.array([0.0]), np.empty((1, 1)))
    chain, sees = chain_of(1, 0, np.random.default_rng(0))
    assert run(np.zeros(20), packed([-1.01], [], 1.0), chain, sees, 1) == math.inf


def chain_covariance(chain, sees, d, n):
    """Covariance of what the reading sees of a chain at n ticks, the diffuse states left out; and what it sees of
    those.
    """
    U, Q, P0 = wide(chain)
    rows = [wide(sees)]
    for _ in range(n - 1):
        rows.append(rows[-1] @ U)
    V, rows = wide(np.zeros((n, n))), np.array(rows)
    for t in range(n - 1):  # noise that enters after tick t reaches all later ones
        later = np.vstack([wide(np.zeros((t + 1, len(sees)))), rows[: n - t - 1]])
        V += later @ Q @ later.T
    return V + rows[:, d:] @ P0[d:, d:] @ rows[:, d:].T, rows[:, :d]


def dense(y, V, X):
    """Minus the log of the marginal Gaussian density, the diffuse start's d columns X integrated out, less that of its
    first d samples.
    """
    n, known, d = len(y), np.isfinite(y), X.shape[1]
    V, y, X = V[np.ix_(known, known)], wide(y[known]), X[known]
    # Legendre polynomials in place of powers of time, for the condition of M; extended precision for that of V
    U = wide(np.polynomial.legendre.legvander(2.0 * np.flatnonzero(known) / n - 1.0, d - 1)) if d else wide(X)
    M = U.T @ naive.cholesky_solve(V, U)
    rest = y - U @ naive.cholesky_solve(M, U.T @ naive.cholesky_solve(V, y[:, None]))[:, 0] if d else y
    log = log_det(V) + log_det(M) - 2.0 * np.linalg.slogdet(U[:d].astype(float))[1]
    square = rest @ naive.cholesky_solve(V, rest[:, None])[:, 0]
    return float(0.5 * (log + square + (len(y) - d) * math.log(2.0 * math.pi)))


def minus_loglik(likelihood, theta, p, slow=0):
    return float(likelihood.standardised([theta], p, slow)[0][0])


def lags(n):
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))


def wide(x):
    return np.asarray(x, np.longdouble)


def log_det(S):
    """By elimination, in whatever precision S has."""
    S, total = S.copy(), wide(0.0)
    for k in range(len(S)):
        total += np.log(S[k, k])
        S[k + 1 :, k + 1 :] -= np.outer(S[k + 1 :, k], S[k, k + 1 :]) / S[k, k]
    return total


@pytest.mark.parametrize(("ar", "ma", "d", "beside"), CASES)
def test_likelihood_is_the_dense_marginal_gaussian(ar, ma, d, beside):
    random = np.random.default_rng(6)
    # a known start is that of the first known sample
    y, (chain, sees) = walk_with_gaps(random)[1:], chain_of(d, beside, random)
    fast = wide(ArmaModel(ar, ma, 0.7).autocovariance(len(y))[lags(len(y))] + 0.04 * np.eye(len(y)))
    for diffuse in (d, d - 1)[: 1 + (d > 1)]:  # the last integrator known to start with
        value = run(y, packed(ar, ma, 0.7), chain, sees, diffuse, white=0.04)
        V, X = chain_covariance(chain, sees, diffuse, len(y))
        assert value == pytest.approx(dense(y, V + fast, X), abs=1e-8)


def test_a_long_gap_starts_anew():
    random = np.random.default_rng(7)
    y, theta = np.cumsum(random.normal(size=120)), packed([-0.8], [0.3], 0.5)
    chain, sees = chain_of(2, 1, random)
    y[50:59] = np.nan
    whole = run(y, theta, chain, sees, 2)
    pieces = run(y[:50], theta, chain, sees, 2) + run(y[59:], theta, chain, sees, 2)
    assert whole == pytest.approx(pieces, rel=1e-12)
    short = y.copy()
    short[58] = 1.0
    assert run(short, theta, chain, sees, 2) != pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize("gaps", [False, True])
def test_without_drift_it_is_the_arima_likelihood(gaps):
    arima = pytest.importorskip("statsmodels.tsa.arima.model", reason="install statsmodels to run this test").ARIMA
    y = simulate_arma([-1.2, 0.4], [0.5], 0.8, 300, seed=8)
    if gaps:
        y[[20, 21, 100]] = np.nan
    reference = arima(y, order=(2, 0, 1), trend="n").loglike([1.2, -0.4, 0.5, 0.64])
    nothing = drift_chain(Drift((), 1.0), 1.0), np.ones(1)
    assert -run(y, packed([-1.2, 0.4], [0.5], 0.8), *nothing, 0) == pytest.approx(reference, abs=1e-6)


# ---------------------------------------------------------------------- the fit


def test_fit_recovers_a_model_within_its_errors():
    """Chi-square of the coefficients over 12 seeds: 3 x 12 numbers, bounds at 0.1 and 99.9 %."""
    truth = add_arma([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.4)])
    total = 0.0
    for seed in range(12):
        model = fit_channel(series([truth], TACTICAL, 3000, seed), TACTICAL, 1, 1).model
        error = np.r_[model.ar - truth.ar, model.ma - truth.ma]
        total += error @ np.linalg.solve(model.covariance, error)
    assert 7.5 < total < 51.2  # 24 degrees of freedom


def test_covariance_is_the_spread_over_runs():
    truth, drift = ArmaModel([-0.8], [0.3], 1.0), Drift((0.05, 0.0), 1.0)
    found, said, s0, s0_said = [], [], [], []
    for seed in range(80):
        model = fit_channel(series([truth], drift, 600, 100 + seed), drift, 1, 1, start=truth).model
        found.append(np.r_[model.ar, model.ma])
        said.append(np.sqrt(np.diag(model.covariance)))
        s0.append(log_s0(model))
        s0_said.append(model.sd_log_s0)
    # 80 runs know a standard deviation to 8 %: three of those, and as much again for 600 samples not being many
    np.testing.assert_allclose(np.std(found, axis=0), np.median(said, axis=0), rtol=0.3)
    # upwards, ln S(0) is less certain than downwards: what is said is the larger
    assert 0.85 * np.std(s0) < np.median(s0_said) < 1.6 * np.std(s0)


def test_white_noise_knows_its_level():
    fit = fit_channel(2.0 * np.random.default_rng(9).standard_normal(2000), Drift((), 1.0), 0, 0)
    assert fit.model.sd == pytest.approx(2.0, rel=0.06)
    assert fit.model.sd_log_s0 == pytest.approx(math.sqrt(2.0 / 2000), rel=0.05)
    assert fit.n == 2000


def test_known_white_noise_is_taken_out():
    y = series([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.5)], TACTICAL, 4000, 10)
    with_white = fit_channel(y, TACTICAL, 1, 0, white=0.25).model
    assert with_white.ar[0] == pytest.approx(
        -math.exp(-PERIOD_S / 2.0), abs=4.0 * math.sqrt(with_white.covariance[0, 0])
    )
    # what ignores the white noise finds a much quicker process
    assert fit_channel(y, TACTICAL, 1, 0).model.ar[0] > with_white.ar[0] + 0.05


def test_outliers_are_clipped():
    y = series([gauss_markov(1.0, 2.0)], TACTICAL, 4000, 11)
    clean = fit_channel(y, TACTICAL, 1, 0).model
    random = np.random.default_rng(12)
    bad = random.choice(4000, 20, replace=False)
    y[bad] += 8.0 * random.standard_normal(20)
    model = fit_channel(y, TACTICAL, 1, 0).model
    assert abs(log_s0(model) - log_s0(clean)) < 0.5
    assert model.sd < 1.5 * clean.sd


def test_fit_scales_exactly_and_ignores_level_and_rate():
    y = series([gauss_markov(1.0, 2.0)], TACTICAL, 1000, 13)
    start = gauss_markov(1.0, 1.0)
    one = fit_channel(y, TACTICAL, 1, 0, start=start).model
    big = fit_channel(
        1024.0 * y, Drift(tuple(1024.0 * d for d in TACTICAL.density), PERIOD_S), 1, 0, start=gauss_markov(1024.0, 1.0)
    ).model
    assert big.ar[0] == one.ar[0] and big.sd == pytest.approx(1024.0 * one.sd, rel=1e-12)
    moved = fit_channel(y + 7.0 + 0.01 * np.arange(1000), TACTICAL, 1, 0, start=start).model
    assert moved.ar[0] == pytest.approx(one.ar[0], abs=1e-6)


def test_a_hidden_low_frequency_is_uncertain():
    """A drift as strong as the slow part: the same series is known much less well at zero frequency."""
    truth, still = gauss_markov(0.6 * DEG, 10.0), Drift((0.0, 0.0), PERIOD_S)
    strong = Drift((10.0 * DEG / 60.0, 0.0), PERIOD_S)
    for seed in (14, 15, 16):
        alone, hidden = (
            fit_channel(series([truth], drift, 4000, seed), drift, 1, 0).model.sd_log_s0 for drift in (still, strong)
        )
        assert hidden > 1.3 * alone


@pytest.mark.parametrize(
    ("y", "options", "match"),
    [
        (np.full(100, np.nan), {}, "NaN"),
        (np.full(100, 2.5), {}, "constant"),
        (np.r_[np.arange(50.0), np.inf, np.arange(50.0)], {}, "infinite"),
        (np.arange(5.0), {}, "at least"),
        (np.zeros((10, 2)), {}, "shape"),
        (np.arange(100.0) ** 2, {"white": -1.0}, "white"),
        (np.arange(100.0) ** 2, {"start": ArmaModel([-0.5, 0.1], [], 1.0)}, "orders"),
    ],
)
def test_fit_refuses(y, options, match):
    with pytest.raises(ValueError, match=match):
        fit_channel(y, TACTICAL, 1, 0, **options)


def test_fit_refuses_orders():
    with pytest.raises(ValueError, match="orders"):
        fit_channel(np.arange(100.0) ** 2, TACTICAL, -1, 0)


def test_difference_steps_stay_stationary():
    """Three poles close together near the circle: steps of 1e-6 in a coefficient would leave it."""
    likelihood = Likelihood(np.random.default_rng(15).standard_normal(4000), Drift((), PERIOD_S), 0.0)
    ar = np.poly([0.99, 0.99, 0.99])[1:]
    point = likelihood.point(np.r_[ar, -0.9, 0.1, 0.0, 0.0], 3)
    assert math.isfinite(point.value) and np.all(np.isfinite(point.info))


def test_a_known_start_tells_more_of_a_short_series():
    """Two hundred seconds of a slow error, the rate of the drift known to 5 deg/h or not at all."""
    known, off = Drift(TACTICAL.density, PERIOD_S, (math.inf, 5.0 * DEG / 3600.0)), []
    truth = gauss_markov(0.6 * DEG, 30.0)
    for seed in range(12):
        y = series([truth], TACTICAL, 1600, 40 + seed)
        off.append(
            [log_s0(fit_channel(y, drift, 1, 0, start=truth).model) - log_s0(truth) for drift in (TACTICAL, known)]
        )
    unknown_rms, known_rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert known_rms < unknown_rms


@pytest.mark.parametrize("start", [(1.0, math.inf), (1.0,), (-1.0, 1.0), (math.nan, 1.0)])
def test_a_start_that_does_not_fit_is_refused(start):
    with pytest.raises(ValueError, match="start_sd"):
        Drift((1.0, 1.0), 1.0, start)


@pytest.mark.parametrize("slow", [0, 1, 2])
@pytest.mark.parametrize(("p", "q"), [(0, 0), (1, 1), (3, 2)])
@pytest.mark.parametrize("keep", [-1.0, 0.99])
def test_a_recursion_is_its_twin(p, q, slow, keep):
    """Two calls, the second of which goes on; a segment begins in each, and a step is too long at first."""
    random = np.random.default_rng(14)
    y, drift = walk_with_gaps(random, 300), drift_chain(Drift((0.3, 0.1), 1.0), 1.0)
    y[45:56] = y[200:209] = np.nan
    y[90] += 30.0
    theta, stands = parameters(p, q, slow, 2, random)
    k, r = theta.size, 2 + slow
    sees, rules = np.eye(r)[0] + (np.arange(r) == 2), np.array([2, 8.0, 3.0, 0.04])
    limits = np.array([0.05, 0.98, 0.9995, -14.0, 40.0, -3.0, 3.0, 1.0, 5.0])
    steps, known, centre = np.full(k, 1e-4), np.full(k, 0.1), np.full(k, 0.2)
    shape = kernels.state_shape(k, p, slow, drift, rules)
    found = []
    for of, state in ((kernels, np.zeros(shape)), (naive, [naive.One() for _ in range(k + 2)])):
        changing = theta.copy(), np.array([9, 0]), np.zeros((k, k)), np.zeros(kernels.TOLD)
        moved, past, info, told = changing
        for part in (y[:130], y[130:]):
            fixed = part, moved, stands, steps, p, slow, drift, sees, rules, BELIEF
            of.channel_recursion(*fixed, limits, known, centre, keep, 3.0, state, past, info, told)
        found.append((moved, info, told))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)
    assert np.array_equal(found[0][0], theta) == (keep < 0.0)

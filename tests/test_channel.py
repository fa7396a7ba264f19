"""The channel likelihood: kernels against their twins and a dense Gaussian, the fit, and the learner."""

import itertools
import math

import naive
import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from scipy.linalg import expm

from navfilter.arma.algebra import add_arma
from navfilter.arma.choice import Challenge
from navfilter.arma.model import ArmaModel, simulate_arma
from navfilter.filter.memory import from_arrays, to_arrays
from navfilter.kernels import channel as kernels
from navfilter.learning.drift import Drift
from navfilter.learning.effort import EFFORT
from navfilter.learning.fit import fit_channel
from navfilter.learning.learner import Learner, LearnerMemory
from navfilter.learning.likelihood import Likelihood

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


def run(y, theta, Q, d, clip=NEVER, white=0.0, longest=8.0, tolerance=0.0):
    e, lns = np.empty(len(y)), np.empty(len(y))
    value = kernels.channel_filter(y, theta, Q, np.array([d, longest, clip, white, tolerance]), e, lns)
    return value, e, lns


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

CASES = [
    ([-1.5, 0.6], [0.3], 2),
    ([-0.9], [], 1),
    ([-0.5, 0.2, 0.1, 0.05], [0.1, 0.2, 0.3], 3),
    ([], [0.5, 0.2], 4),
    ([], [], 2),
    ([-0.99], [-0.9], 0),
]


def noise_of_chain(r, random):
    B = 0.1 * random.normal(size=(r, r))
    return np.vstack([B @ B.T, np.full(r, np.inf)]) if r else np.zeros((2, 1))


def walk_with_gaps(random, n=70):
    y = np.cumsum(random.normal(size=n))
    y[[0, 4, 5, 6, 20, 21, 40]] = np.nan
    return y


@pytest.mark.parametrize(("ar", "ma", "r"), CASES)
@pytest.mark.parametrize("clip", [NEVER, 0.8])
def test_filter_is_its_twin(ar, ma, r, clip):
    random = np.random.default_rng(3)
    y, theta, Q = walk_with_gaps(random), packed(ar, ma, 0.7), noise_of_chain(r, random)
    y[45:56] = np.nan  # longer than the longest gap: a new segment
    y[60] += 30.0
    rules = np.array([r, 8.0, clip, 0.04, 0.0])
    out = [np.empty(len(y)) for _ in range(4)]
    value = kernels.channel_filter(y, theta, Q, rules, out[0], out[1])
    twin = naive.channel_filter(y, theta, Q, rules, out[2], out[3])
    assert value == pytest.approx(twin, rel=1e-11)
    np.testing.assert_allclose(out[0], out[2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(out[1], out[3], rtol=1e-9, atol=1e-9)
    # r samples at the start of each of the two segments do not count
    assert np.isfinite(out[0]).sum() == np.isfinite(y).sum() - 2 * r


@pytest.mark.parametrize(("ar", "ma", "r"), CASES)
def test_scores_are_their_twin(ar, ma, r):
    random = np.random.default_rng(4)
    y, theta, Q = walk_with_gaps(random), packed(ar, ma, 0.7), noise_of_chain(r, random)
    m = (len(theta) - 1) // 2
    free = np.r_[np.arange(len(ar)), m + np.arange(len(ma)), 2 * m]
    k, results = len(free), []
    for scores in (kernels.channel_scores, naive.channel_scores):
        E, LNS = np.empty((k + 1, len(y))), np.empty((k + 1, len(y)))
        info, gradient = np.empty((k, k)), np.empty(k)
        value = scores(y, theta, Q, np.array([r, 8.0, 1.5, 0.0, 0.0]), free, np.full(k, 1e-4), E, LNS, info, gradient)
        results.append((value, gradient, info))
    for one, other in zip(*results, strict=True):
        # both take the same differences: what is left is rounding over the step, and with four integrators P spans ten
        # decades
        np.testing.assert_allclose(one, other, rtol=1e-6 if r < 4 else 1e-4, atol=1e-6 if r < 4 else 1e-4)


@pytest.mark.parametrize(("ar", "ma", "r"), [([-1.5, 0.6], [0.3], 2), ([-0.99], [-0.9], 3), ([], [], 2)])
def test_an_interpolated_gain_changes_next_to_nothing(ar, ma, r):
    """Leaps with the tolerance against every tick: log-likelihood, innovations, gradient and information over 1500
    ticks.
    """
    random = np.random.default_rng(31)
    drift = Drift((1e-2, 1e-4, 1e-6)[:r], 1.0)
    y = series([ArmaModel(ar, ma, 0.7)], drift, 1500, 31)
    y[[300, 301, 500, 900]], y[1000:1020] = np.nan, np.nan
    y[random.choice(1500, 5)] += 9.0
    theta, Q, m = packed(ar, ma, 0.7), drift.per_tick(), max(len(ar), len(ma), 1)
    free, out = np.r_[np.arange(len(ar)), m + np.arange(len(ma)), 2 * m], []
    for scores, tolerance in ((kernels.channel_scores, EFFORT.gain_tolerance), (naive.channel_scores, 0.0)):
        k = len(free)
        E, LNS, info, gradient = np.empty((k + 1, 1500)), np.empty((k + 1, 1500)), np.empty((k, k)), np.empty(k)
        value = scores(
            y, theta, Q, np.array([r, 8.0, 4.0, 0.04, tolerance]), free, np.full(k, 1e-6), E, LNS, info, gradient
        )
        out.append((value, gradient, info, E[0], LNS[0]))
    scale = np.sqrt(np.diag(out[1][2]))
    # orders are decided by 3 in log-likelihood, of which this is a hundredth; a shift of 1e-2 standard deviations is
    # nothing
    assert out[0][0] == pytest.approx(out[1][0], abs=3e-2)
    np.testing.assert_allclose(out[0][1] / scale, out[1][1] / scale, atol=1e-2)
    # one per cent of information is half a per cent of a standard deviation
    np.testing.assert_allclose(out[0][2] / np.outer(scale, scale), out[1][2] / np.outer(scale, scale), atol=1e-2)
    np.testing.assert_allclose(out[0][3], out[1][3], atol=2e-3)
    np.testing.assert_allclose(out[0][4], out[1][4], atol=2e-3)
    assert not np.array_equal(out[0][3], out[1][3])  # it did leap


def test_scores_are_the_slope_of_the_filter():
    random = np.random.default_rng(5)
    y, theta, Q, rules = (
        walk_with_gaps(random),
        packed([-0.8, 0.1], [0.4], 0.7),
        noise_of_chain(2, random),
        np.array([2, 8.0, 1.5, 0.0, 0.0]),
    )
    free, E, LNS = np.array([0, 1, 2, 4]), np.empty((5, len(y))), np.empty((5, len(y)))
    gradient = np.empty(4)
    kernels.channel_scores(y, theta, Q, rules, free, np.full(4, 1e-6), E, LNS, np.empty((4, 4)), gradient)
    for k, slope in zip(free, gradient, strict=True):
        step = 1e-5 * (np.arange(5) == k)
        ends = [kernels.channel_filter(y, theta + sign * step, Q, rules, E[0], LNS[0]) for sign in (1.0, -1.0)]
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize(
    ("a", "c"), [([-0.9], [0.0]), ([-1.5, 0.6], [0.3, 0.0]), ([-0.5, 0.2, 0.1, 0.05], [0.1, 0.2, 0.3, 0.0])]
)
def test_stationary_is_its_twin(a, c):
    P, twin = np.empty((len(a), len(a))), np.empty((len(a), len(a)))
    assert kernels.stationary(np.array(a), np.array(c), P) and naive.stationary(np.array(a), np.array(c), twin)
    np.testing.assert_allclose(P, twin, rtol=1e-10, atol=1e-12)


def test_nothing_is_stationary_outside_the_circle():
    assert not kernels.stationary(np.array([-1.01]), np.array([0.0]), np.empty((1, 1)))
    assert run(np.zeros(20), packed([-1.01], [], 1.0), np.ones((2, 1)), 1)[0] == math.inf


def dense(y, ar, ma, sd, white, Q, d):
    """Minus the log of the marginal Gaussian density, the drift's start integrated out, less that of its first d
    samples.
    """
    n, known, r = len(y), np.isfinite(y), Q.shape[1]
    lag, start, Q = np.abs(np.subtract.outer(np.arange(n), np.arange(n))), Q[-1], Q[:-1]
    V = wide(ArmaModel(ar, ma, sd).autocovariance(n)[lag] + white * np.eye(n))
    rows = [wide([t**k / math.factorial(k) for k in range(r)]) for t in range(n)]
    for t in range(n - 1):  # noise that enters after tick t reaches all later ones
        later = np.array([np.zeros(r)] * (t + 1) + rows[: n - t - 1])
        V += later @ wide(Q) @ later.T
    V += np.array(rows)[:, d:] @ np.diag(wide(start[d:])) @ np.array(rows)[:, d:].T
    V, y, X = V[np.ix_(known, known)], wide(y[known]), np.array(rows)[known, :d]
    # Legendre polynomials in place of powers of time, for the condition of M; extended precision for that of V
    U = wide(np.polynomial.legendre.legvander(2.0 * np.flatnonzero(known) / n - 1.0, d - 1)) if d else wide(X)
    M = U.T @ naive.cholesky_solve(V, U)
    rest = y - U @ naive.cholesky_solve(M, U.T @ naive.cholesky_solve(V, y[:, None]))[:, 0] if d else y
    log = log_det(V) + log_det(M) - 2.0 * np.linalg.slogdet(U[:d].astype(float))[1]
    square = rest @ naive.cholesky_solve(V, rest[:, None])[:, 0]
    return float(0.5 * (log + square + (len(y) - d) * math.log(2.0 * math.pi)))


def wide(x):
    return np.asarray(x, np.longdouble)


def log_det(S):
    """By elimination, in whatever precision S has."""
    S, total = S.copy(), wide(0.0)
    for k in range(len(S)):
        total += np.log(S[k, k])
        S[k + 1 :, k + 1 :] -= np.outer(S[k + 1 :, k], S[k, k + 1 :]) / S[k, k]
    return total


@pytest.mark.parametrize(("ar", "ma", "r"), CASES)
def test_likelihood_is_the_dense_marginal_gaussian(ar, ma, r):
    random = np.random.default_rng(6)
    y, Q = walk_with_gaps(random), noise_of_chain(r, random)
    value = run(y, packed(ar, ma, 0.7), Q, r, white=0.04)[0]
    assert value == pytest.approx(dense(y, ar, ma, 0.7, 0.04, Q, r), abs=1e-8)
    if r > 1:  # the last state known to start with
        Q[-1, -1] = 0.3
        value = run(y[1:], packed(ar, ma, 0.7), Q, r - 1, white=0.04)[0]
        assert value == pytest.approx(dense(y[1:], ar, ma, 0.7, 0.04, Q, r - 1), abs=1e-8)


def test_a_long_gap_starts_anew():
    random = np.random.default_rng(7)
    y, Q, theta = (
        np.cumsum(random.normal(size=120)),
        np.vstack([0.01 * np.eye(2), np.zeros((1, 2))]),
        packed([-0.8], [0.3], 0.5),
    )
    y[50:59] = np.nan
    whole = run(y, theta, Q, 2)[0]
    assert whole == pytest.approx(run(y[:50], theta, Q, 2)[0] + run(y[59:], theta, Q, 2)[0], rel=1e-12)
    short = y.copy()
    short[58] = 1.0
    assert run(short, theta, Q, 2)[0] != pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize("gaps", [False, True])
def test_without_drift_it_is_the_arima_likelihood(gaps):
    arima = pytest.importorskip("statsmodels.tsa.arima.model", reason="install statsmodels to run this test").ARIMA
    y = simulate_arma([-1.2, 0.4], [0.5], 0.8, 300, seed=8)
    if gaps:
        y[[20, 21, 100]] = np.nan
    reference = arima(y, order=(2, 0, 1), trend="n").loglike([1.2, -0.4, 0.5, 0.64])
    assert -run(y, packed([-1.2, 0.4], [0.5], 0.8), np.zeros((2, 1)), 0)[0] == pytest.approx(reference, abs=1e-6)


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
    assert fit.is_white and fit.n == 2000 and fit.innovations.shape == (2000,)


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
    y = series([gauss_markov(0.6 * DEG, 30.0)], MEMS, 4000, 14)
    weak = Drift((0.0, 0.0), PERIOD_S)
    alone = fit_channel(series([gauss_markov(0.6 * DEG, 30.0)], weak, 4000, 14), Drift((), PERIOD_S), 1, 0).model
    assert fit_channel(y, MEMS, 1, 0).model.sd_log_s0 > 1.3 * alone.sd_log_s0


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
    likelihood = Likelihood(np.random.default_rng(15).standard_normal(4000), np.zeros((1, 0)), 0.0)
    ar = np.poly([0.99, 0.99, 0.99])[1:]
    point = likelihood.point(np.r_[ar, -0.9, 0.1, 0.0, 0.0], 3)
    assert math.isfinite(point.value) and np.all(np.isfinite(point.info))


# ---------------------------------------------------------------------- the learner

ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1))


def test_learner_finds_the_order_and_is_stable():
    truth = add_arma([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.4)])
    y = series([truth], TACTICAL, 3000, 16)
    learner = Learner(ORDERS, 2000, TACTICAL)
    flags = []
    for end in (150, 500, 1000, 1500, 2000, 2500, 3000):
        model = learner.hop(y[:end])
        assert model.is_stable and model.is_invertible
        flags.append(set(model.flags))
    assert "starting" in flags[0] and learner.order == (1, 1) and flags[-1] == set()
    assert model.effective_window == 1998.0
    assert abs(log_s0(model) - log_s0(truth)) < 3.0 * model.sd_log_s0


def test_learner_calls_too_little_starting():
    model = Learner(ORDERS, 400, TACTICAL).hop(np.arange(100.0))
    assert "starting" in model.flags and model.p == model.q == 0 and model.sd == pytest.approx(np.std(np.arange(100.0)))
    assert Learner(ORDERS, 400, TACTICAL).hop(np.zeros(0)).sd == 0.0


@pytest.mark.parametrize("bad", [np.full(1000, np.nan), np.full(1000, 3.0), np.full(1000, np.inf), np.zeros(3)])
def test_learner_has_an_outcome_for_everything(bad):
    fresh = Learner(ORDERS, 1000, TACTICAL)
    first = fresh.hop(bad)
    assert "starting" in first.flags and math.isfinite(first.sd)
    assert ("constant" in first.flags) == (bad[0] == 3.0)
    good = fresh.hop(series([gauss_markov(1.0, 2.0)], TACTICAL, 1000, 17))
    assert good.flags == frozenset()
    again = fresh.hop(bad)
    assert again.flags == {"stale"}
    np.testing.assert_array_equal(again.ar, good.ar)


def test_learner_says_coloured_then_stale():
    """Two lines that no candidate can whiten: coloured from the start; after a good window, the good model while it
    serves.
    """
    y = simulate_arma(np.poly(0.97 * np.exp(1j * np.array([1.0, -1.0, 2.0, -2.0]))).real[1:], [], 1.0, 2000, seed=18)
    assert "coloured" in Learner(((0, 0), (1, 0), (2, 0)), 2000, TACTICAL).hop(y).flags
    white = np.random.default_rng(19).standard_normal(2000)
    learner = Learner(((0, 0),), 2000, Drift((), 1.0))
    assert learner.hop(white).flags == frozenset()
    comb = white.copy()
    comb[7::8] += 1.0
    comb -= comb.mean()
    comb *= white.std() / comb.std()  # coloured, yet of the same power
    assert learner.hop(comb).flags == {"stale"}
    assert learner.hop(3.0 * comb).flags == {"coloured"}


def test_learner_falls_back_to_gauss_markov():
    """A candidate that can only cancel: white noise seen through (1, 1) alone."""
    learner = Learner(((1, 1),), 1500, Drift((), 1.0))
    model = learner.hop(np.random.default_rng(20).standard_normal(1500))
    assert "fallback" in model.flags and model.p <= 1 and model.q <= 1 and model.is_stable


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


def test_a_young_learner_says_that_it_has_seen_too_little_of_a_slow_error():
    learner = Learner(ORDERS, 4000, TACTICAL)
    y = series([gauss_markov(0.6 * DEG, 30.0)], TACTICAL, 4000, 60)
    assert "starting" in learner.hop(y[:400]).flags
    assert "starting" not in learner.hop(y).flags
    quick = series([gauss_markov(0.6 * DEG, 1.0)], TACTICAL, 400, 61)
    assert "starting" not in Learner(ORDERS, 4000, TACTICAL).hop(quick).flags


def test_learner_says_capped():
    walk = np.cumsum(np.random.default_rng(21).standard_normal(1000))
    model = Learner(((1, 0),), 1000, Drift((), 1.0)).hop(walk)
    assert "capped" in model.flags and model.poles[0].real <= 1.0 - 3.0 / 1000


def test_learner_keeps_its_order_unless_a_challenger_leads_twice():
    truth = gauss_markov(1.0, 2.0)
    later = add_arma([truth, ArmaModel([], [], 0.6)])
    y = np.r_[series([truth], TACTICAL, 1200, 22), series([later], TACTICAL, 2400, 23)]
    learner, orders = Learner(((0, 0), (1, 0), (1, 1)), 1000, TACTICAL), []
    for end in range(1000, 3601, 200):
        learner.hop(y[:end])
        orders.append(learner.order)
    assert orders[0] == (1, 0) and orders[-1] == (1, 1)
    assert sum(a != b for a, b in itertools.pairwise(orders)) == 1


def test_learner_continues_from_a_snapshot_to_the_last_bit():
    y = series([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.4)], TACTICAL, 3000, 24)
    one = Learner(ORDERS, 1000, TACTICAL)
    ends = range(400, 3001, 200)
    models = [one.hop(y[:end]) for end in ends]
    for cut in (1, 4, 9):
        first = Learner(ORDERS, 1000, TACTICAL)
        for end in list(ends)[:cut]:
            first.hop(y[:end])
        kept = first.memory
        other = Learner(ORDERS, 1000, TACTICAL)
        other.memory = from_arrays(to_arrays(kept), [LearnerMemory, Challenge, ArmaModel])
        assert [other.hop(y[:end]) for end in list(ends)[cut:]] == models[cut:]
        assert other.order == one.order


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (((), 1000), "orders"),
        ((((-1, 0),), 1000), "orders"),
        ((((1, 0),), 100), "window"),
        ((((1, 0),), 1000.5), "window"),
    ],
)
def test_learner_refuses(arguments, match):
    with pytest.raises(ValueError, match=match):
        Learner(*arguments, TACTICAL)
    with pytest.raises(ValueError, match="one-dimensional"):
        Learner(ORDERS, 1000, TACTICAL).hop(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="white"):
        Learner(ORDERS, 1000, TACTICAL, white=-1.0)


def test_gaps_and_outliers_are_survived():
    y = series([gauss_markov(1.0, 2.0)], TACTICAL, 2000, 25)
    random = np.random.default_rng(26)
    y[random.random(2000) < 0.2] = np.nan
    y[700:760] = np.nan
    y[900:960] = np.inf
    y[random.choice(2000, 10)] += 20.0
    model = Learner(ORDERS, 2000, TACTICAL).hop(y)
    assert abs(log_s0(model) - log_s0(gauss_markov(1.0, 2.0))) < 3.0 * model.sd_log_s0


@pytest.mark.slow
@pytest.mark.parametrize(("drift", "factor"), [(TACTICAL, 1.7), (MEMS, 2.5)])
def test_low_frequencies_are_honest(drift, factor):
    """S(0) of a slow and oscillating error over 24 windows: right within a factor, and as uncertain as it says."""
    swing = ArmaModel([-2.0 * 0.99 * math.cos(math.pi / 24.0), 0.99**2], [], 1.0)
    parts = [gauss_markov(0.35 * DEG, 60.0), ArmaModel(swing.ar, [], 0.35 * DEG / math.sqrt(swing.variance))]
    truth, off = log_s0(add_arma(parts)), []
    for seed in range(24):
        learner = Learner((*ORDERS, (2, 2), (3, 2)), 4000, drift)
        model = learner.hop(series(parts, drift, 4000, 300 + seed))
        off.append(((log_s0(model) - truth), model.sd_log_s0))
    error, said = np.array(off).T
    # the median of 24 is itself known to 1.25 standard deviations over sqrt(24); two of those
    assert abs(np.median(error)) < math.log(factor) + 2.5 * error.std() / math.sqrt(24.0)
    assert np.mean(error + said < 0.0) < 0.45  # what the filter uses is rarely below the truth

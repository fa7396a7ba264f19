"""What is handed out is a mixture of what was learnt and what was described, weighed by sums over a minute."""

import math

import naive
import numpy as np
import pytest
from scipy.stats import multivariate_normal

import navfilter as nf
from navfilter.kernels.sum_likelihood import sum_likelihood
from navfilter.learning import mixture
from navfilter.learning.axis_learner import Learner
from navfilter.learning.likelihood import Likelihood
from navfilter.learning.mixture import LEAST_SHARE, described_share
from navfilter.models.error_models import Sum, block_level
from navfilter.models.learned_arma import register_block
from navfilter.models.navigation_drift import Drift
from navfilter.simulation.simulate import draw_error

PERIOD_S = 0.5
DRIFT = Drift((1e-4, 1e-6), PERIOD_S)
SLOW, QUICK = nf.GaussMarkov(sd=0.1, tau_s=60.0) + nf.White(sd=0.05), nf.White(sd=0.05)


def random_model(random, n=4):
    F = np.diag(random.uniform(0.5, 0.99, n)) + np.triu(0.1 * random.standard_normal((n, n)), 1)
    half, start = random.standard_normal((2, n, n))
    return F, half @ half.T, random.standard_normal(n), start @ start.T, 0.3


@pytest.mark.parametrize("missing", [0.0, 0.3, 0.9])
def test_sums_as_tick_by_tick(missing):
    random = np.random.default_rng(3)
    for length in (1, 7, 32, 61):
        y = random.standard_normal(500)
        y[random.random(y.size) < missing] = math.nan
        model = random_model(random)
        ours, twin = sum_likelihood(y, length, 2, *model), naive.sum_likelihood(y, length, 2, *model)
        assert ours == pytest.approx(twin, rel=1e-9)


def test_it_is_the_density_of_the_sums():
    """Dense: the covariance of all readings, and sums of them."""
    random, n, length = np.random.default_rng(4), 60, 12
    F, Q, C, P, r = random_model(random)
    # states at tick t are F^t x0 and what has come in since
    powers = [np.linalg.matrix_power(F, t) for t in range(n + 1)]
    cov = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            come = sum(powers[i - k] @ Q @ powers[j - k].T for k in range(min(i, j) + 1))
            cov[i, j] = C @ (powers[i + 1] @ P @ powers[j + 1].T + come) @ C + r * (i == j)
    summed = np.kron(np.eye(n // length), np.ones(length))
    y = random.standard_normal(n)
    found, count, _ = sum_likelihood(y, length, 0, F, Q, C, P, r)
    dense = multivariate_normal(cov=summed @ cov @ summed.T).logpdf(summed @ y)
    assert count == 5 and found == pytest.approx(dense + 2.5 * math.log(2.0 * math.pi), rel=1e-9)


def share(true, described, seconds, seed=1, drift=DRIFT):
    y = draw_error(true, PERIOD_S, round(seconds / PERIOD_S), seed, "compass", 0)
    likelihood = Likelihood(y, drift, 0.0)
    return described_share(likelihood, described.block(PERIOD_S), true.block(PERIOD_S))


def test_beforehand_both_are_as_likely():
    """Of five minutes two sums are taken up by the start, three are left."""
    assert share(QUICK, SLOW, 299.0) is None and 0.0 < share(QUICK, SLOW, 301.0)[0] < 1.0


def test_sums_decide_what_single_readings_do_not():
    for seed in range(10):
        assert share(QUICK, SLOW, 1800.0, seed)[0] < 0.01
    assert np.mean([share(SLOW, QUICK, 1800.0, seed)[0] for seed in range(10)]) < 0.01


def test_how_much_of_sums_is_the_error_and_not_the_drift():
    assert share(SLOW, SLOW, 1800.0)[1] > 0.9
    assert share(SLOW, SLOW, 1800.0, drift=Drift((1.0, 0.1), PERIOD_S))[1] < 0.01


def handed_out(described, seconds, true=QUICK):
    y = draw_error(true, PERIOD_S, round(seconds / PERIOD_S), 2, "compass", 0)
    orders = [(0, 0), (1, 0), (1, 1)]
    beside, alone = (Learner(orders, 4000, DRIFT, described=one).hop(y) for one in (described, None))
    return beside, alone


def level(learnt):
    part = nf.LearnedArma(model=learnt.model, slow=Sum(learnt.slow) if learnt.slow else None)
    return block_level(part.block(PERIOD_S))


def test_spectra_are_mixed():
    described = SLOW + nf.GaussMarkov(sd=0.02, tau_s=5.0, order=2)
    beside, alone = handed_out(described, 200.0)
    power = sum(block_level(part.block(PERIOD_S)) for part in described.parts)
    # processes that stand for others keep their power at zero frequency, but for sampling
    assert level(beside) == pytest.approx(0.5 * level(alone) + 0.5 * power, rel=0.02)
    known = sum(part.sd**2 for part in beside.slow if isinstance(part, nf.GaussMarkov))
    assert known == pytest.approx(0.5 * (0.1**2 + 0.02**2), rel=1e-6)
    if alone.model.p == alone.model.q == 0:  # one white noise is enough
        assert beside.model.sd**2 == pytest.approx(0.5 * alone.model.sd**2 + 0.5 * max(alone.model.sd, 0.05) ** 2)
        assert not any(isinstance(part, nf.White) for part in beside.slow)


def test_white_noise_stands_beside_a_coloured_fast_part():
    beside, alone = handed_out(QUICK, 200.0, nf.GaussMarkov(sd=0.1, tau_s=2.0))
    assert alone.model.p == 1
    (white,) = beside.slow
    # readings scatter by more from one to the next than was described
    assert white == nf.White(sd=alone.model.sd * math.sqrt(0.5)) and alone.model.sd > 0.05


def test_no_description_takes_away_what_readings_scatter_by():
    for sd in (0.01, 0.05, 0.2):
        beside, alone = handed_out(nf.White(sd=sd), 200.0)
        left, had = (
            one.model.sd**2 + sum(part.sd**2 for part in one.slow if isinstance(part, nf.White))
            for one in (beside, alone)
        )
        assert left == pytest.approx(0.5 * had + 0.5 * max(sd**2, had))


def scatter(learnt):
    """Variance of a reading when all before it are known (Riccati's equation, iterated)."""
    block = nf.LearnedArma(model=learnt.model, slow=Sum(learnt.slow) if learnt.slow else None).block(PERIOD_S)
    P, variance = block.P0, 0.0
    for _ in range(3000):
        variance = float(block.C @ P @ block.C) + block.r
        gain = block.Phi @ P @ block.C / variance
        P = block.Phi @ P @ block.Phi.T + block.Q - variance * np.outer(gain, gain)
    return variance


SMOOTH = nf.GaussMarkov(sd=0.1, tau_s=10.0, order=2)


@pytest.mark.parametrize("pi", [0.1, 0.5, 0.9])
@pytest.mark.parametrize(
    ("true", "described"),
    [
        (QUICK, nf.White(sd=0.1)),
        (nf.GaussMarkov(sd=0.1, tau_s=2.0), nf.GaussMarkov(sd=0.1, tau_s=2.0) + nf.White(sd=0.2)),
        (SMOOTH, nf.GaussMarkov(sd=0.1, tau_s=30.0) + nf.White(sd=0.02)),
        (SLOW, nf.GaussMarkov(sd=0.3, tau_s=60.0) + nf.White(sd=0.2)),
    ],
)
def test_each_band_is_weighed_by_what_tells_of_it(true, described, pi, monkeypatch):
    """Once sums tell: power at zero frequency is that of the mixture, and readings scatter as was learnt, whatever is
    described and however probable it is. Before, the description stands as it is.
    """
    few, before = handed_out(described, 200.0, true)
    assert scatter(few) / scatter(before) > 1.5
    monkeypatch.setattr(mixture, "described_share", lambda *_: (pi, 1.0))
    beside, alone = handed_out(described, 1800.0, true)
    assert 0.9 < scatter(beside) / scatter(alone) < 1.1
    # a description never takes away from the fast part
    theirs = max(
        sum(block_level(part.block(PERIOD_S)) for part in described.terms), block_level(register_block(alone.model))
    )
    # smooth processes have 7 % less than rough ones of the same size and length
    assert level(beside) == pytest.approx((1.0 - pi) * level(alone) + pi * theirs, rel=0.1)


def test_walks_are_the_drifts():
    walk = nf.RandomWalk(density=1e-3)
    assert Learner([(0, 0)], 400, DRIFT, described=SLOW + walk).described == SLOW.parts
    assert Learner([(0, 0)], 400, DRIFT, described=walk).described == ()


def test_a_description_that_sums_exclude_goes():
    far = nf.GaussMarkov(sd=1.0, tau_s=60.0)
    beside, alone = handed_out(far, 1800.0)
    left = LEAST_SHARE * block_level(far.block(PERIOD_S))
    assert level(beside) == pytest.approx(level(alone) + left, rel=0.01)

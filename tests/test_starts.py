"""Where the channel likelihood's maximisation begins: what a spectrum says of orders that are larger."""

import math

import numpy as np
import pytest

from navfilter.arma.model import simulate_arma
from navfilter.learning.drift import Drift
from navfilter.learning.likelihood import Likelihood, maximise
from navfilter.learning.slow import SlowPrior
from navfilter.learning.starts import RESONANCES, SHAPED, _whittle, grown_starts, is_hopeless

DRIFT, PRIOR = Drift((3e-4, 0.0), 0.125), SlowPrior(0.3, 60.0, 500.0)


def swing(period, decay):
    radius = math.exp(-1.0 / (decay * period))
    return [-2.0 * radius * math.cos(2.0 * math.pi / period), radius**2]


def fitted(y, p, q, start):
    likelihood = Likelihood(y, DRIFT, 0.0, PRIOR)
    slow = [math.log(0.1) + likelihood.log_unit, math.log(60.0)]
    return likelihood, maximise(likelihood, [np.r_[start, likelihood.log_unit, slow]], p, 20, 1)


@pytest.mark.parametrize(("period", "decay"), [(9.0, 2.0), (40.0, 3.0)])
@pytest.mark.parametrize("gap", [0, 300])
def test_a_swing_that_was_left_out_is_found_and_told_in_advance(period, decay, gap):
    """Beside white noise: the start leads to the truth, and the gain that was expected is about the one that comes."""
    wave = simulate_arma(swing(period, decay), [], 1.0, 2000, seed=4)
    y = 0.7 * wave / wave.std() + np.random.default_rng(5).normal(size=2000)
    y[500 : 500 + gap] = np.nan
    likelihood, white = fitted(y, 0, 0, [])
    gain = max(float(_whittle(likelihood, white, shapes)[0].max()) for shapes in SHAPED)
    starts = grown_starts(likelihood, {(0, 0): white}, 2, 2)
    point = maximise(likelihood, starts, 2, 20, 1, 3)
    found = np.angle(np.roots(np.r_[1.0, point.theta[:2]])).max()
    assert 2.0 * math.pi / found == pytest.approx(period, rel=0.1)
    assert white.value - point.value == pytest.approx(gain, rel=0.4)
    assert not is_hopeless(likelihood, {(0, 0): white}, point.value + 6.0)


def test_nothing_is_expected_where_nothing_is_left():
    """Of white noise two hundred shapes tell a few units of log-likelihood at most, and an order is not tried for that;
    with what was left of a swing it would be.
    """
    y = np.random.default_rng(6).normal(size=2000)
    likelihood, white = fitted(y, 0, 0, [])
    assert max(float(_whittle(likelihood, white, shapes)[0].max()) for shapes in SHAPED) < 8.0
    assert is_hopeless(likelihood, {(0, 0): white}, white.value - 16.0)
    assert not is_hopeless(likelihood, {(0, 0): white}, white.value + 1.0)


@pytest.mark.parametrize("which", [3, 10, 16])
def test_the_gain_of_a_shape_is_that_of_its_likelihood(which):
    """Of innovations that have it: against the likelihood with these coefficients and that size."""
    ar, ma = (part[which] for part in RESONANCES)
    y = simulate_arma(ar, ma, 1.0, 4000, seed=7)
    likelihood, white = fitted(y, 0, 0, [])
    gains, sizes = _whittle(likelihood, white, SHAPED[1])
    moved = np.r_[ar, ma, white.theta[0] + sizes[which], white.theta[1:]]
    assert white.value - likelihood.penalised([moved], 2, 1)[0] == pytest.approx(gains[which], rel=0.2)

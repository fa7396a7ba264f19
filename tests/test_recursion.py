"""The recursion between looks: it is the batch likelihood where nothing is forgotten, follows what changes, and has a
look where it has left what the last one left possible.
"""

import math

import numpy as np
import pytest
from test_channel import TACTICAL, gauss_markov, minus_loglik, series
from test_learner import believing

from navfilter.learning.axis_learner import Learner
from navfilter.learning.likelihood import Likelihood, maximise
from navfilter.models.learned_arma import DEFAULT_ORDERS
from navfilter.timeseries.model import ArmaModel

N = 4000
PRIOR = believing(0.5, 20.0)
FAST, SLOW = ArmaModel([-0.5], [0.2], 0.2), gauss_markov(0.5, 20.0)
CASES = [(1, [-0.5, 0.2, math.log(0.2)]), (2, [-0.5, 0.2, math.log(0.2)]), (0, [-0.5, 0.2, math.log(0.2)])]


def with_gaps(seed, n=N):
    y = series([SLOW, FAST], TACTICAL, n, seed)
    y[500:520] = y[700] = np.nan
    return y


def of_series(y, slow, fast):
    """A likelihood, and a model in its unit."""
    likelihood = Likelihood(y, TACTICAL, 0.0, PRIOR)
    theta = np.array([*fast, *([math.log(0.5), math.log(20.0)] if slow else [])])
    theta[2 : 3 + bool(slow)] += likelihood.log_unit
    return likelihood, theta


@pytest.mark.parametrize(("slow", "fast"), CASES)
@pytest.mark.parametrize("cut", [300, 511, 1234])
def test_where_nothing_is_forgotten_it_is_the_batch_likelihood(slow, fast, cut):
    """Cut within a gap, too."""
    y = with_gaps(26)
    whole, theta = of_series(y, slow, fast)
    first, last = (Likelihood(part, TACTICAL, 0.0, PRIOR, scale=whole.scale) for part in (y[:cut], y[cut:]))
    at_once = whole.followed(theta, 1, slow)
    in_two = last.gone_on(first.followed(theta, 1, slow), 1, slow, -1.0)
    np.testing.assert_allclose(in_two.state, at_once.state, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(in_two.info, at_once.info, rtol=1e-3, atol=1e-3)
    values = [minus_loglik(likelihood, theta, 1, slow) for likelihood in (whole, first)]
    assert in_two.told[0] == pytest.approx(values[0] - values[1], rel=1e-9)
    known = whole.point(theta, 1, slow).info.copy()
    if slow:
        known[[-2, -1], [-2, -1]] -= PRIOR.spread**-2.0, PRIOR.tau_spread**-2.0
    np.testing.assert_allclose(at_once.info, known, rtol=1e-3, atol=1e-3)


def test_it_finds_what_a_look_would_have_found():
    """A window after a look it is nearer to what a look there finds than the one before: means of twelve."""
    off, apart = [], []
    for seed in range(12):
        y = series([SLOW, FAST], TACTICAL, 2 * N, 70 + seed)
        likelihood, theta = of_series(y[:N], 1, CASES[0][1])
        look = maximise(likelihood, [theta], 1, 20, 1)
        onward = Likelihood(y[N:], TACTICAL, 0.0, PRIOR, scale=likelihood.scale)
        moved = onward.gone_on(likelihood.followed(look.theta, 1, 1), 1, 1, math.exp(-2.0 / N))
        later, start = of_series(y[N:], 1, CASES[0][1])
        start = later.confine([start], 1, 1)[0]
        other = maximise(later, [start], 1, 20, 1).theta.copy()
        other[2:4] += likelihood.log_unit - later.log_unit
        one, two = moved._replace(fitted=other).distance, moved._replace(theta=look.theta, fitted=other).distance
        off.append(one)
        apart.append(two)
    assert np.mean(off) < 0.5 * np.mean(apart), (off, apart)


def test_it_is_followed_where_readings_change():
    """A quick part twice as large: the recursion is there within a window, and what stands tells readings worse."""
    likelihood, theta = of_series(series([SLOW, FAST], TACTICAL, N, 5), 1, CASES[0][1])
    one = likelihood.followed(maximise(likelihood, [theta], 1, 20, 1).theta, 1, 1)
    louder = series([SLOW, ArmaModel([-0.5], [0.2], 0.4)], TACTICAL, N, 6)
    more = Likelihood(louder, TACTICAL, 0.0, PRIOR, scale=likelihood.scale)
    moved = more.gone_on(one, 1, 1, math.exp(-2.0 / N), 100)
    assert math.log(1.5) < moved.theta[2] - one.theta[2] < math.log(2.5)
    assert moved.told[1] > 30.0 and moved.distance > 30.0
    assert moved.handed_out().told.tolist() == [0.0, 0.0]


def test_a_look_comes_where_readings_say_so(monkeypatch):
    """Nothing is looked for while an error stays as it was; where a slow error appears in white noise, a look finds it
    within a window.
    """
    looks, own = [], Learner._fitted
    monkeypatch.setattr(Learner, "_fitted", lambda self, y: looks.append(1) or own(self, y))
    white = ArmaModel([], [], 0.4)
    y = series([white], TACTICAL, 4 * N, 22)
    y[3 * N :] += series([gauss_markov(0.3, 60.0)], TACTICAL, N, 23)
    learner = Learner(DEFAULT_ORDERS, N, TACTICAL, prior=believing(0.6))
    found = [learner.hop(y[max(end - N, 0) : end], N // 2) for end in range(N, 4 * N + 1, N // 2)]
    assert found[0] is not None and found[1:5] == [None] * 4  # the last readings but for the slow error
    assert len(looks) >= 2
    slow = next(one for one in reversed(found) if one is not None).slow
    assert sum(part.sd**2 for part in slow if hasattr(part, "tau_s")) > 0.03


def test_what_was_left_out_since_begins_a_new_segment():
    """Ticks that were heard and are doubted later: what they have left in the filters does not go on."""
    y = with_gaps(31, 3 * N // 2)
    learner, other = (Learner([(1, 1)], N, TACTICAL, prior=PRIOR) for _ in range(2))
    for one in (learner, other):
        one.hop(y[:N])
    y[N:] += 50.0  # a step of the open loop
    y[N - 20 : N] = np.nan
    for one, readings in ((learner, y), (other, np.where(np.arange(y.size) < N, y, y - 50.0))):
        one.hop(readings[-N:], N // 2)
    told = [next(iter(one.memory.followed.values())).told[0] for one in (learner, other)]
    assert told[0] == pytest.approx(told[1], abs=1.0)

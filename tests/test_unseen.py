"""What a white description says of low frequencies stays believed where the readings cannot tell."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

import navfilter as nf
from navfilter.learning.axis_learner import Learner, hop_together
from navfilter.learning.white_prior import WhitePriorTest, white_description
from navfilter.models.error_models import RandomWalk, Sum, White
from navfilter.models.navigation_drift import Drift
from navfilter.timeseries.model import ArmaModel

PERIOD_S, SPAN_S = 0.1, 400.0
#: A velocity beside the tilt of a car: it hides whatever is slower than some seconds.
HIDING = Drift((0.015, 5e-4), PERIOD_S)
#: A heading beside a gyro of tactical grade [deg]: it hides hardly anything.
CLEAR = Drift((0.005, 1e-5), PERIOD_S)


def series(sd, drift, n=2000, seed=3):
    random = np.random.default_rng(seed)
    return sd * random.standard_normal(n) + np.cumsum(
        drift.density[0] * math.sqrt(PERIOD_S) * random.standard_normal(n)
    )


def model(sd):
    return ArmaModel(np.zeros(0), np.zeros(0), sd)


def test_power_that_the_drift_hides_stays_half_believed():
    """S(0) of what is added is what is missing, times a probability near the even odds it had before."""
    said = WhitePriorTest(0.1**2, SPAN_S)
    (part,) = said.unseen(model(0.008), series(0.008, HIDING), HIDING, 0.0)
    missing = 0.1**2 - 0.008**2
    share = 2.0 * part.sd**2 * part.tau_s / PERIOD_S / missing
    assert SPAN_S / 50.0 < part.tau_s < 2.56 * SPAN_S
    # sd 0.008 over 8 s beside a drift of 0.04 over 8 s: the likelihood tells little
    assert 0.3 < share < 0.95


def test_power_that_the_readings_exclude_is_not_added():
    """Beside a drift that hides nothing, white noise of a tenth of what was described: nothing quick is left, and what
    is left of slow errors is smaller than the heading's own sd, 0.04 deg after a minute and a half.
    """
    said = WhitePriorTest(1.5**2, SPAN_S)
    y = series(0.15, CLEAR)
    (part,) = said.unseen(model(0.15), y, CLEAR, 0.0)
    assert part.tau_s > 100.0 and part.sd < 0.04
    # told of the same power ten times over, the readings exclude more of it than they leave
    (other,) = WhitePriorTest(15.0**2, SPAN_S).unseen(model(0.15), y, CLEAR, 0.0)
    assert other.sd**2 * other.tau_s < 0.5 * 15.0**2 * PERIOD_S / 2.0


@pytest.mark.parametrize("sd", [0.08, 0.1, 0.5])
def test_as_much_as_described_needs_nothing_beside_it(sd):
    assert WhitePriorTest(0.1**2, SPAN_S).unseen(model(sd), series(sd, HIDING), HIDING, 0.0) == ()


def test_a_description_is_white_or_none():
    assert white_description(White(0.1), PERIOD_S, SPAN_S) == WhitePriorTest(0.1**2, SPAN_S)
    walk = Sum((White(0.1), RandomWalk(density=0.3)))
    assert white_description(walk, PERIOD_S, SPAN_S) == WhitePriorTest(0.1**2, SPAN_S)
    assert white_description(nf.GaussMarkov(0.1, 20.0) + White(0.1), PERIOD_S, SPAN_S) is None


def test_a_learner_hands_it_out():
    y = series(0.008, HIDING)
    described = WhitePriorTest(0.1**2, SPAN_S)
    orders = [(0, 0), (1, 0)]
    plain = Learner(orders, 4000, HIDING).hop(y)
    careful = Learner(orders, 4000, HIDING, described=described).hop(y)
    assert plain.slow == () and careful.model.sd == plain.model.sd
    assert careful.slow == described.unseen(careful.model, y, HIDING, 0.0) != ()


# ---------------------------------------------------------------- readings that are not white

#: It hides nothing.
BARE = Drift((1e-4, 1e-6), PERIOD_S)
#: A velocity whose slow errors are as slow as a DVL's.
KIND = nf.GaussMarkov(sd=0.01, tau_s=5.0) + White(sd=0.01)
ORDERS = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 2)]
SAID = white_description(White(0.01), PERIOD_S, SPAN_S, KIND)


def coloured(sd, tau_s, drift, n=4000, seed=5, white=0.005):
    """A Gauss-Markov process on white noise, beside a drift."""
    random, phi = np.random.default_rng(seed), math.exp(-PERIOD_S / tau_s)
    noise = sd * math.sqrt(1.0 - phi**2) * random.standard_normal(n)
    noise[0] = sd * random.standard_normal()
    return lfilter([1.0], [1.0, -phi], noise) + series(white, drift, n, seed + 100)


def power_of_slow(learnt):
    return sum(2.0 * part.sd**2 * part.tau_s for part in learnt.slow)


def hop(y, drift, described=SAID):
    return Learner(ORDERS, 4000, drift, described=described).hop(y)


def test_white_readings_have_no_slow_part():
    assert hop(series(0.01, CLEAR), CLEAR).slow == ()


def test_where_readings_are_coloured_a_slow_error_is_doubted_as_far_as_they_cannot_tell():
    """Errors of half a second: beside a drift that hides little the readings all but exclude a slow error, beside one
    that hides what is slower than some seconds they do not.
    """
    clear, hiding = (hop(coloured(0.01, 0.5, drift), drift) for drift in (CLEAR, HIDING))
    assert clear.model.p and hiding.model.p
    true = 2.0 * 0.01**2 * 0.5
    assert power_of_slow(clear) < power_of_slow(hiding)
    assert power_of_slow(hiding) > true
    assert hop(coloured(0.01, 0.5, HIDING), HIDING, white_description(White(0.01), PERIOD_S, SPAN_S)).slow == ()


def test_a_slow_error_that_shows_is_a_slow_part_with_its_own_uncertainty():
    """Of twenty seconds, beside a drift that hides nothing: no pole of the fast part stands for it."""
    y = coloured(0.02, 20.0, BARE)
    found = hop(y, BARE)
    assert np.abs(found.model.poles).max() < math.exp(-PERIOD_S / (1.1 * SAID.slowest_s))
    assert power_of_slow(found) > 0.5 * 2.0 * 0.02**2 * 20.0
    low, high = (np.array(getattr(found.spectrum, name))[0] for name in ("low", "high"))
    assert low < 4.0 * 0.02**2 * 20.0 < high


def test_all_axes_have_a_slow_error_or_none():
    """What one axis shows, the others are believed to have."""
    shows, hides = coloured(0.02, 20.0, BARE), coloured(0.01, 0.5, HIDING)
    learners = [Learner(ORDERS, 4000, drift, described=SAID) for drift in (BARE, HIDING)]
    one, other = hop_together(learners, [shows, hides])
    alone = hop(hides, HIDING)
    assert power_of_slow(one) > 0.5 * 2.0 * 0.02**2 * 20.0
    assert power_of_slow(other) > 1.5 * power_of_slow(alone)
    assert hop_together([None, *learners], [None, shows, None])[::2] == [None, None]


def test_the_doubt_has_the_size_that_was_described_and_the_time_of_its_kind():
    assert SAID.usual.sd == pytest.approx(0.01) and SAID.usual.absent == 0.5
    # the slow part of a data sheet is twice as slow as the whole
    assert SAID.usual.tau_s == pytest.approx(10.0, rel=1e-3)
    assert white_description(White(0.01), PERIOD_S, SPAN_S, White(1.0)).usual is None

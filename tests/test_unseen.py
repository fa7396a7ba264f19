"""What a white description says of low frequencies stays believed where the readings cannot tell."""

import math

import numpy as np
import pytest

import navfilter as nf
from navfilter.arma.model import ArmaModel
from navfilter.error_models import RandomWalk, Sum, White
from navfilter.learning.drift import Drift
from navfilter.learning.learner import Learner
from navfilter.learning.unseen import WhiteDescription, white_description

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
    said = WhiteDescription(0.1**2, SPAN_S)
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
    said = WhiteDescription(1.5**2, SPAN_S)
    y = series(0.15, CLEAR)
    (part,) = said.unseen(model(0.15), y, CLEAR, 0.0)
    assert part.tau_s > 100.0 and part.sd < 0.04
    # told of the same power ten times over, the readings exclude more of it than they leave
    (other,) = WhiteDescription(15.0**2, SPAN_S).unseen(model(0.15), y, CLEAR, 0.0)
    assert other.sd**2 * other.tau_s < 0.5 * 15.0**2 * PERIOD_S / 2.0


@pytest.mark.parametrize("sd", [0.08, 0.1, 0.5])
def test_as_much_as_described_needs_nothing_beside_it(sd):
    assert WhiteDescription(0.1**2, SPAN_S).unseen(model(sd), series(sd, HIDING), HIDING, 0.0) == ()


def test_a_description_is_white_or_none():
    assert white_description(White(0.1), PERIOD_S, SPAN_S) == WhiteDescription(0.1**2, SPAN_S)
    walk = Sum((White(0.1), RandomWalk(density=0.3)))
    assert white_description(walk, PERIOD_S, SPAN_S) == WhiteDescription(0.1**2, SPAN_S)
    assert white_description(nf.GaussMarkov(0.1, 20.0) + White(0.1), PERIOD_S, SPAN_S) is None


def test_a_learner_hands_it_out():
    y = series(0.008, HIDING)
    described = WhiteDescription(0.1**2, SPAN_S)
    orders = [(0, 0), (1, 0)]
    plain = Learner(orders, 4000, HIDING).hop(y)
    careful = Learner(orders, 4000, HIDING, described=described).hop(y)
    assert plain.slow == () and careful.model.sd == plain.model.sd
    assert careful.slow == described.unseen(careful.model, y, HIDING, 0.0) != ()

"""The learner of one channel from hop to hop: which orders it finds, what it hands out, and what it remembers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from test_channel import DEG, MEMS, PERIOD_S, TACTICAL, gauss_markov, series

from navfilter.faults.sensor_bias import RejectionRun
from navfilter.foundation.state_values import from_arrays, to_arrays
from navfilter.learning.axis_learner import Learner, LearnerMemory
from navfilter.learning.initial_values import Growth, white_point
from navfilter.learning.learned_model import slow_psd
from navfilter.learning.likelihood import Followed, Likelihood, maximise
from navfilter.learning.open_loop_series import without_spikes
from navfilter.learning.schedule import doubtful_ticks
from navfilter.learning.slow_posterior import Line
from navfilter.learning.slow_prior import SlowPrior
from navfilter.models.error_models import CORRELATION_CONSTANTS
from navfilter.models.navigation_drift import Drift
from navfilter.timeseries.model import ArmaModel, add_arma

ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1))


def believing(sd, tau_s=60.0, span_s=500.0, **options):
    return SlowPrior(sd, tau_s, span_s, **options)


def density(learnt, frequency_hz):
    """One-sided spectrum of what is handed out: fast and slow parts together."""
    fast = learnt.model.spectrum(frequency_hz, 1.0 / PERIOD_S)
    slow = [slow_psd([part.order], [part.sd], np.array([part.tau_s]), frequency_hz)[0] for part in learnt.slow]
    return fast + sum(slow)


def order_of(learnt):
    return learnt.model.p, learnt.model.q


def test_it_finds_the_order_and_is_stable():
    truth = add_arma([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.4)])
    y = series([truth], TACTICAL, 3000, 16)
    learner = Learner(ORDERS, 2000, TACTICAL)
    assert learner.hop(y[:50]) is None  # too little
    seen, learnt = 0, None
    for end in (150, 500, 1000, 1500, 2000, 2500, 3000):
        learnt = learner.hop(y[:end], end - seen) or learnt
        seen = end
        assert learnt.model.is_stable and learnt.model.is_invertible
        assert learnt.slow == ()  # without a prior there is none
    assert order_of(learnt) == (1, 1)
    assert learnt.model.effective_window == 2000.0
    error = np.r_[learnt.model.ar - truth.ar, learnt.model.ma - truth.ma]
    # chi-square with two degrees of freedom at 99.9 %
    assert error @ np.linalg.solve(learnt.model.covariance, error) < 13.8


@pytest.mark.parametrize("prior", [None, believing(1.0)])
@pytest.mark.parametrize("bad", [np.full(1000, np.nan), np.full(1000, 3.0), np.full(1000, np.inf), np.zeros(3), []])
def test_nothing_is_learnt_from_nothing(bad, prior):
    """Before and after a good window; what was known stays as it is."""
    learner = Learner(ORDERS, 1000, TACTICAL, prior=prior)
    assert learner.hop(bad) is None
    good = learner.hop(series([gauss_markov(1.0, 2.0)], TACTICAL, 1000, 17))
    kept = learner.memory
    assert good.model.is_stable
    assert learner.hop(bad, 0) is None
    assert learner.memory is kept


def test_without_a_prior_a_pole_stays_where_the_series_can_tell_it_from_a_walk():
    walk = np.cumsum(np.random.default_rng(21).standard_normal(1000))
    model = Learner(((1, 0),), 1000, Drift((), 1.0)).hop(walk).model
    assert 0.9 < model.poles[0].real <= 1.0 - 3.0 / 1000


def test_the_fast_part_leaves_slow_poles_to_the_slow_one():
    prior = believing(0.6)
    learnt = Learner(ORDERS, 4000, TACTICAL, prior=prior).hop(series([gauss_markov(0.6, 60.0)], TACTICAL, 4000, 3))
    poles = learnt.model.poles
    # of a pole z, the natural frequency is |ln z| over the period
    assert all(abs(np.log(pole)) >= PERIOD_S / prior.quickest_s * (1.0 - 1e-9) for pole in poles if pole)
    assert learnt.slow and sum(part.sd**2 for part in learnt.slow) > 0.1


def test_the_order_follows_a_change():
    truth = gauss_markov(1.0, 2.0)
    later = add_arma([truth, ArmaModel([], [], 0.6)])
    y = np.r_[series([truth], TACTICAL, 1200, 22), series([later], TACTICAL, 2400, 23)]
    learner = Learner(((0, 0), (1, 0), (1, 1)), 1000, TACTICAL)
    found = [learner.hop(y[:end], 1000 if end == 1000 else 200) for end in range(1000, 3601, 200)]
    orders = [order_of(one) for one in found if one is not None]
    assert orders[0] == (1, 0) and orders[-1] == (1, 1)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_a_lower_maximum_of_few_readings_is_left_later(seed):
    """Of a hump, a peak and no slow error little shows at first, and the slow part stands for the hump."""
    pair = 0.9 * np.exp(0.8j)
    ar, ma = np.poly([0.97, 0.5, pair, pair.conjugate()]).real[1:], np.poly([0.85, -0.3])[1:]
    order, prior = (4, 2), believing(0.6 * DEG, span_s=300.0)
    truth = ArmaModel(ar, ma, 0.63 * DEG / math.sqrt(ArmaModel(ar, ma, 1.0).variance))
    y = series([truth], TACTICAL, 2400, seed)
    learner = Learner([*ORDERS, (2, 2), (3, 2), order], 2400, TACTICAL, prior=prior)
    for end, fresh in ((240, 240), (480, 240), (960, 480), (2400, 1440)):
        learner.hop(y[:end], fresh)
    likelihood = Likelihood(y, TACTICAL, 0.0, prior)
    unit = np.r_[np.zeros(6), likelihood.log_unit, likelihood.log_unit, 0.0]
    starts = [np.r_[ar, ma, np.log([truth.sd, sd * DEG, 60.0])] + unit for sd in (0.02, 0.1)]
    found = likelihood.penalised([learner.memory.thetas[*order, 1] + unit], 4, 1)[0]
    assert found - maximise(likelihood, starts, 4, 15, 1).value < 3.0


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_a_slow_part_does_not_stand_for_a_quick_error(seed):
    """A slow part at its quickest tells readings of a quick error nearly as well as the pole does: what it may be
    beforehand, unlikely and of any size, counts against it.
    """
    truth, prior = gauss_markov(1.0, 6.0), believing(1.5, 20.0, absent=0.95)
    learner = Learner(ORDERS, 4000, TACTICAL, prior=prior)
    learner.hop(series([truth], TACTICAL, 4000, seed))
    *_, (kind, weight) = learner.memory.chosen.items()
    assert kind[:2] == (1, 0) and weight > 0.9
    tau_s = -PERIOD_S / math.log(-learner.memory.thetas[kind][0])
    assert tau_s == pytest.approx(6.0, rel=0.35)


@pytest.mark.parametrize(("ar", "missing"), [(-0.08, 0.0), (-0.5, 0.0), (-0.5, 0.3), (0.6, 0.1)])
def test_a_pole_more_gains_what_the_innovations_promise(ar, missing):
    random = np.random.default_rng(27)
    y = lfilter([1.0], [1.0, ar], random.standard_normal(4000))
    y[random.random(4000) < missing] = np.nan
    likelihood = Likelihood(y, Drift((), PERIOD_S), 0.0)
    white, growth = white_point(likelihood), Growth(likelihood)
    starts = growth.starts({(0, 0): white}, 1, 0)
    gained = white.value - maximise(likelihood, starts, 1, 20).value
    promised = 0.5 * likelihood.n * growth.promised(white)[1, 0][0]
    # what is promised is that of a series without gaps, with as many readings
    assert 0.8 * gained < promised + 1.0 < 1.5 * gained + 2.0


def test_what_promises_nothing_is_not_begun():
    likelihood = Likelihood(np.random.default_rng(28).standard_normal(4000), Drift((), PERIOD_S), 0.0)
    white, growth = white_point(likelihood), Growth(likelihood)
    assert growth.starts({(0, 0): white}, 2, 2, 4.0, white.value - 10.0) == []
    assert len(growth.starts({(0, 0): white}, 2, 2, 4.0)) == 4


@pytest.mark.parametrize("ar", [-0.05, -0.6, 0.9])
def test_an_order_is_weighed_by_the_integral_over_its_coefficients(ar):
    """A coefficient whose ln A(1) is uniform beforehand, against white noise, both of any size."""
    y = lfilter([1.0], [1.0, ar], np.random.default_rng(29).standard_normal(400))
    likelihood, learner = Likelihood(y, Drift((), PERIOD_S), 0.0), Learner(ORDERS, 400, Drift((), PERIOD_S))
    white = white_point(likelihood)
    coloured = maximise(likelihood, [np.r_[ar, white.theta]], 1, 20)
    sizes, coefficients = coloured.theta[-1] + np.linspace(-0.3, 0.3, 61), np.linspace(-0.995, 0.995, 399)
    alone = np.exp(white.value - likelihood.penalised((white.theta[-1] + sizes - sizes[30])[:, None], 0)).mean()
    both = np.exp(coloured.value - likelihood.penalised([[a, u] for a in coefficients for u in sizes], 1))
    density = np.maximum(1.0 + coefficients, likelihood.least_level) ** -1.0
    both = (both.reshape(399, 61).mean(axis=1) @ density) / density.sum()
    found = learner._score(likelihood, white, 400)[0] - learner._score(likelihood, coloured, 400)[0]
    expected = white.value - coloured.value + math.log(both / alone)
    assert found == pytest.approx(expected, abs=0.4)


def test_white_noise_and_colour_are_both_weighed_at_every_look(monkeypatch):
    """White noise was not fitted again where the two best orders were coloured, and came out by turns only."""
    seen, own = [], Learner._weighed
    monkeypatch.setattr(Learner, "_weighed", lambda self, scores: seen.append(scores) or own(self, scores))
    learner, y = Learner(ORDERS, 1000, TACTICAL), series([ArmaModel([-0.1], [], 1.0)], TACTICAL, 6000, 5)
    for end in range(1000, 6001, 1000):
        learner.hop(y[:end] * end, 1000)  # the error grows from look to look
    assert len(seen) == 6
    assert all({any(kind[:2]) for kind in scores} == {False, True} for scores in seen)


def test_readings_that_scatter_less_than_the_drift_tell_nothing():
    """Where the drift is the vehicle's own motion and no instrument's noise, the motion would be learnt as an error."""
    y = series([gauss_markov(1.0, 2.0)], TACTICAL, 2000, 34)
    halved = np.where(np.arange(y.size) % 2, np.nan, y)
    for density, told in ((TACTICAL.density[0], True), (50.0, False)):
        for readings in (y, halved):
            learner = Learner(ORDERS, 2000, Drift((density, *TACTICAL.density[1:]), PERIOD_S), prior=believing(1.0))
            assert (learner.hop(readings) is not None) == told


def test_a_look_tells_what_its_window_says():
    """The slow error has gone: after a window without it nothing is left."""
    part, n = gauss_markov(0.5, 20.0), 4000
    steady = series([part, ArmaModel([], [], 0.2)], TACTICAL, n, 26)
    silent = series([ArmaModel([], [], 0.2)], TACTICAL, n, 27)
    learner = Learner(((0, 0),), 2000, TACTICAL, prior=believing(0.5, span_s=250.0))
    variances = []
    for y in (steady, silent):
        for end in (2000, 3000, 4000):
            found = learner.hop(y[:end], 2000 if end == 2000 else 1000)
            variances += [] if found is None else [sum(p.sd**2 for p in found.slow)]
    # the first of the silent readings follow no step of the drift, but a jump of it
    assert all(0.1 < one < 0.6 for one in variances[:-1])  # truth 0.25; the window holds it six times
    assert len(variances) > 1 and variances[-1] < 0.1 * min(variances[:-1])


@pytest.mark.parametrize("prior", [None, believing(0.6, span_s=125.0)])
def test_it_goes_on_from_a_snapshot_to_the_last_bit(prior):
    y = series([gauss_markov(1.0, 2.0), ArmaModel([], [], 0.4)], TACTICAL, 2400, 24)
    one = Learner(ORDERS, 1000, TACTICAL, prior=prior)
    ends = list(range(400, 2401, 200))
    fresh = [400] + [200] * (len(ends) - 1)
    learnt = [one.hop(y[:end], new) for end, new in zip(ends, fresh, strict=True)]
    for cut in (1, 4, 9):
        first = Learner(ORDERS, 1000, TACTICAL, prior=prior)
        for end, new in list(zip(ends, fresh, strict=True))[:cut]:
            first.hop(y[:end], new)
        other = Learner(ORDERS, 1000, TACTICAL, prior=prior)
        other.memory = from_arrays(to_arrays(first.memory), [LearnerMemory, Line, Followed])
        assert [other.hop(y[:end], new) for end, new in list(zip(ends, fresh, strict=True))[cut:]] == learnt[cut:]
    assert len([one for one in learnt if one is not None]) > 1


def test_a_memory_of_other_orders_is_refused():
    one = Learner(ORDERS, 1000, TACTICAL, prior=believing(1.0))
    one.hop(series([gauss_markov(1.0, 2.0)], TACTICAL, 1000, 17))
    for other in (Learner(((3, 3),), 1000, TACTICAL, prior=believing(1.0)), Learner(ORDERS, 1000, TACTICAL)):
        with pytest.raises(ValueError, match="cannot go on"):
            other.memory = one.memory


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (((), 1000), "orders"),
        ((((-1, 0),), 1000), "orders"),
        ((((1, 0),), 99), "window"),
        ((((1, 0),), 1000.5), "window"),
    ],
)
def test_impossible_learners_are_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        Learner(*arguments, TACTICAL)
    with pytest.raises(ValueError, match="one-dimensional"):
        Learner(ORDERS, 1000, TACTICAL).hop(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="white"):
        Learner(ORDERS, 1000, TACTICAL, white=-1.0)


@pytest.mark.parametrize("prior", [None, believing(1.0, span_s=250.0)])
def test_gaps_and_outliers_are_survived(prior):
    truth = gauss_markov(1.0, 2.0)
    y = series([truth], TACTICAL, 2000, 25)
    random = np.random.default_rng(26)
    y[random.random(2000) < 0.2] = np.nan
    y[700:760] = np.nan
    y[900:960] = np.inf
    y[random.choice(2000, 10)] += 20.0
    learnt = Learner(ORDERS, 2000, TACTICAL, prior=prior).hop(without_spikes(y))
    frequency = np.array([0.03, 0.1, 0.5])
    ratio = density(learnt, frequency) / truth.spectrum(frequency, 1.0 / PERIOD_S)
    # 250 s hold some eight of the lowest: its level is known to a factor of 2, with what outliers add
    assert np.all((ratio > 0.4) & (ratio < 2.5))


@pytest.mark.slow
@pytest.mark.parametrize("drift", [TACTICAL, MEMS])
def test_low_frequencies_are_honest(drift):
    """A slow and an oscillating error over 16 windows: the truth is below the posterior's median about as often as
    above, and inside its band nearly as often as that says.
    """
    swing = ArmaModel([-2.0 * 0.99 * math.cos(math.pi / 24.0), 0.99**2], [], 1.0)
    parts = [gauss_markov(0.35 * DEG, 60.0), ArmaModel(swing.ar, [], 0.35 * DEG / math.sqrt(swing.variance))]
    below, inside = [], []
    for seed in range(16):
        learner = Learner((*ORDERS, (2, 2), (3, 2)), 4000, drift, prior=believing(0.5 * DEG, 120.0))
        spectrum = learner.hop(series(parts, drift, 4000, 300 + seed)).spectrum
        # two cycles in the window
        at = int(np.searchsorted(spectrum.frequency_hz, 2.0 / 500.0))
        truth = sum(part.spectrum(np.array(spectrum.frequency_hz), 1.0 / PERIOD_S)[at] for part in parts)
        below.append(truth < spectrum.median[at])
        inside.append(spectrum.low[at] <= truth <= spectrum.high[at])
    # 16 draws of one half, at 99.9 % each side; of 0.9 at least 10 with the same probability
    assert 2 <= sum(below) <= 14
    assert sum(inside) >= 10


def test_the_prior_is_what_is_left_where_the_readings_say_nothing():
    """Of white noise of 110 readings, the slow part keeps most of what was believed; of 4000, little: but it is
    there.
    """
    prior = believing(1.0, span_s=500.0)
    y = series([ArmaModel([], [], 1.0)], MEMS, 4000, 5)
    few, many = (Learner(((0, 0),), 4000, MEMS, prior=prior).hop(y[:n]).slow for n in (110, 4000))
    few_sd, many_sd = (math.sqrt(sum(part.sd**2 for part in parts)) for parts in (few, many))
    assert 0.2 < few_sd < 2.0
    assert 0.0 < many_sd < 0.3 * few_sd
    assert set(CORRELATION_CONSTANTS) >= {part.order for part in (*few, *many)}


def test_what_a_jumped_sensor_says_is_doubted_though_a_reading_was_let_in():
    """What a wrong description explains is let in, and ends the refusals, but not the run of readings that agree."""
    run = RejectionRun(True, True, (0.1,), (0.1,), (1e-4,), (1e-3,), began_s=95.0, last_s=99.0, count=5)
    for since_s, ticks in ((math.nan, 6), (92.0, 9)):
        faults = SimpleNamespace(refused=run, rejected_since_s=since_s)
        channel = SimpleNamespace(faults=faults, stuck=False, period_s=1.0, offset=False)
        assert doubtful_ticks(channel, 100.0) == ticks

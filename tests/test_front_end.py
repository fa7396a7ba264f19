"""The front end: repeats, resolution, differencing, and a periodic motion under the noise."""

import numpy as np
import pytest

from navfilter.timeseries.fit import fit_arma
from navfilter.timeseries.model import simulate_arma
from navfilter.timeseries.online.order_bank import ArmaBank, FrontEnd, find_resolution, repeat_share
from navfilter.timeseries.online.recursive import RecursiveArma
from navfilter.timeseries.periodic_motion import find_motion_band, subtract_motion

NOISE = simulate_arma([-0.8], [0.3], 1.0, 6000, seed=61)


def test_a_sensor_slower_than_its_logger_is_thinned():
    logged = np.repeat(NOISE, 4)
    front, alone = FrontEnd(RecursiveArma(1, 1, 2000)), RecursiveArma(1, 1, 2000)
    front.update_many(logged)
    alone.update_many(NOISE)
    assert front.dropped == 3 * NOISE.size
    assert "repeats" in front.model.flags
    assert np.array_equal(front.model.ar, alone.ar)
    blind = RecursiveArma(1, 1, 2000)
    blind.update_many(logged)
    assert abs(blind.ar[0] + 0.8) > 0.1


def test_a_sensor_that_gets_stuck_has_gaps():
    stuck = NOISE.copy()
    for at in range(20, 6000, 50):
        stuck[at : at + 6] = stuck[at - 1]
    front = FrontEnd(RecursiveArma(1, 1, 2000))
    front.update_many(stuck)
    assert front.estimator.n_seen == 6000
    assert front.dropped == 6 * 120
    assert front.model.ar[0] == pytest.approx(-0.8, abs=0.08)


def test_repeats_of_coarse_digits_are_kept():
    coarse = np.round(NOISE / 0.5) * 0.5
    front = FrontEnd(ArmaBank(2000))
    front.update_many(coarse)
    assert front.dropped == 0
    assert front.resolution == pytest.approx(0.5)
    assert "quantised" not in front.model.flags
    seen, expected = repeat_share(coarse, 0.5)
    assert seen == pytest.approx(expected, abs=0.05)


def test_digits_coarser_than_the_noise_are_flagged():
    front = FrontEnd(ArmaBank(2000, strict=False))
    front.update_many(np.round(NOISE / 6.0) * 6.0)
    assert "quantised" in front.model.flags


def test_resolution_of_odd_inputs():
    assert find_resolution([]) == 0.0
    assert find_resolution([1.0, 1.0, np.nan]) == 0.0
    twice = np.round(np.round(NOISE[:200] / 0.0915) * 0.0915, 2)
    assert find_resolution(twice) == pytest.approx(0.0915, rel=0.01)
    assert find_resolution(1e9 + np.array([0.0, 0.125, 0.5])) == pytest.approx(0.125)
    assert repeat_share([2.0, 2.0, 2.0], 0.0) == (1.0, 1.0)
    assert repeat_share([2.0], 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("difference", [0, 1, 2])
def test_differencing_equals_numpy(difference):
    series = np.cumsum(np.cumsum(NOISE[:3000]))
    front = FrontEnd(RecursiveArma(1, 1, 1000, mean=False), difference=difference)
    alone = RecursiveArma(1, 1, 1000, mean=False)
    front.update_many(series)
    alone.update_many(np.r_[np.full(difference, np.nan), np.diff(series, difference)])
    assert np.array_equal(front.model.ar, alone.ar)
    assert ("differenced" in front.model.flags) == (difference > 0)


def test_seasonal_difference_removes_a_comb():
    comb = np.tile(3.0 * np.random.default_rng(6).normal(size=10), 600)
    front = FrontEnd(RecursiveArma(1, 1, 2000, mean=False), season=10, repeats="keep")
    alone = RecursiveArma(1, 1, 2000, mean=False)
    front.update_many(NOISE + comb)
    lagged = (NOISE + comb)[10:] - (NOISE + comb)[:-10]
    alone.update_many(np.r_[np.full(10, np.nan), lagged])
    assert np.array_equal(front.model.ar, alone.ar)


def test_short_record_and_one_at_a_time():
    whole, single = FrontEnd(ArmaBank(600)), FrontEnd(ArmaBank(600))
    whole.update_many(NOISE[:1000])
    for x in NOISE[:1000]:
        single.update(x)
    assert whole.model == single.model
    held = FrontEnd(ArmaBank(600))
    held.update_many(NOISE[:50])
    assert held.estimator.candidates[0].n_seen == 0
    held.flush()
    assert held.estimator.candidates[0].n_seen == 50
    assert "starting" in held.model.flags


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"difference": 3}, "difference must be"),
        ({"season": -1}, "season must be"),
        ({"repeats": "maybe"}, "repeats must be"),
        ({"learn": 5}, "learn must be"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        FrontEnd(RecursiveArma(1, 1, 1000), **arguments)
    with pytest.raises(ValueError, match="one-dimensional"):
        FrontEnd(RecursiveArma(1, 1, 1000)).update_many(np.zeros((2, 2)))


def rocking(n, rate_hz, seed):
    """Waves of about 0.4 Hz: an oscillator driven by noise, ten times the sensor noise."""
    turn = 2.0 * np.pi * 0.4 / rate_hz
    radius = 0.999
    motion = simulate_arma([-2.0 * radius * np.cos(turn), radius**2], [], 1.0, n, seed=seed)
    return 10.0 * motion / motion.std()


def test_noise_under_a_rocking_boat_is_found_by_subtraction():
    n, rate = 40_000, 20.0
    noise = simulate_arma([-0.6], [0.2], 1.0, n, seed=62)
    series = noise + rocking(n, rate, 63)
    band = find_motion_band(series, rate)
    assert band is not None
    assert band[0] < 0.4 < band[1]
    truth, raw = fit_arma(noise, 1, 1), fit_arma(series, 1, 1)
    found = fit_arma(subtract_motion(series, rate, (0.05, 2.5)), 1, 1)
    # The raw fit is swallowed by the motion (pole at .99); after subtraction the pole is off by .06, what the
    # straight line under the motion is off by.
    assert raw.ar[0] < -0.95
    assert found.ar[0] == pytest.approx(truth.ar[0], abs=0.1)
    assert found.sd == pytest.approx(truth.sd, rel=0.03)


def test_nothing_is_subtracted_from_noise_alone():
    assert find_motion_band(NOISE, 10.0) is None
    assert np.array_equal(subtract_motion(NOISE, 10.0), NOISE)
    with pytest.raises(ValueError, match="band_hz must lie"):
        subtract_motion(NOISE, 10.0, (1.0, 6.0))
    with pytest.raises(ValueError, match="one finite series"):
        subtract_motion(np.full(1000, np.nan), 10.0)

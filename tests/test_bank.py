"""ArmaBank: the order it picks, the gate, what it hands out, and how it behaves when the noise changes."""

import copy

import numpy as np
import pytest

from navfilter.timeseries.diagnostics import whiteness
from navfilter.timeseries.model import ArmaModel, simulate_arma, split_bias
from navfilter.timeseries.online.order_bank import ArmaBank, moment_gm1
from navfilter.timeseries.roots import cancelling_pairs, cap_poles, has_unit_root

MODELS = {
    (0, 0): ([], []),
    (1, 0): ([-0.8], []),
    (0, 1): ([], [-0.6]),
    (1, 1): ([-0.8], [-0.4]),
    (2, 1): ([-1.6, 0.64], [0.4]),
}


@pytest.mark.parametrize("order", MODELS)
def test_the_true_order_is_picked(order):
    ar, ma = MODELS[order]
    bank = ArmaBank(2000)
    bank.update_many(3.0 + simulate_arma(ar, ma, 0.2, 4000, seed=31))
    assert bank.order == order
    assert bank.is_white
    assert not bank.model.flags
    assert bank.model.sd == pytest.approx(0.2, rel=0.1)
    assert min(bank.scores, key=bank.scores.get) == order


def test_white_noise_is_white_in_95_of_100():
    picks = []
    for seed in range(40):
        bank = ArmaBank(1000)
        bank.update_many(simulate_arma([], [], 1.0, 2000, seed=100 + seed))
        picks.append(bank.order)
    # 95 % is asked for; 36 of 40 fails once in 20 000 if it holds.
    assert picks.count((0, 0)) >= 36


def test_the_gate_knows_white_from_a_correlation_of_a_tenth():
    rejected = {0.0: 0, 0.1: 0}
    for rho in rejected:
        for seed in range(100):
            rejected[rho] += not whiteness(simulate_arma([-rho], [], 1.0, 4000, seed=seed)).is_white
    # 1 % +- 1 % of 400 white runs and 95 % of the others are asked for; here with 100 runs of each.
    assert rejected[0.0] <= 4
    assert rejected[0.1] >= 95


def test_one_sample_at_a_time_and_a_copy_are_the_same_to_the_last_bit():
    series = simulate_arma([-0.8], [0.3], 1.0, 1800, seed=32)
    orders = [(0, 0), (1, 0), (1, 1)]
    one, many = (ArmaBank(600, orders=orders) for _ in range(2))
    for x in series:
        one.update(x)
    many.update_many(series[:1000])
    later = copy.deepcopy(many)
    assert later.model == many.model
    many.update_many(series[1000:])
    later.update_many(series[1000:])
    assert one.model == many.model == later.model
    assert one.order == many.order == later.order


def test_a_candidate_in_the_bank_is_the_estimator_alone():
    from navfilter.timeseries.online.recursive import RecursiveArma

    series = simulate_arma([-0.8], [0.3], 1.0, 3000, seed=33)
    bank, alone = ArmaBank(1000, orders=[(1, 1)], clip=0.0), RecursiveArma(1, 1, 1000)
    bank.update_many(series)
    alone.update_many(series)
    # The bank allows fewer passes per hop; both stop within 0.01 standard deviations of the same optimum.
    np.testing.assert_allclose(bank.candidates[0].ar, alone.ar, atol=1e-3)


def test_a_random_walk_goes_to_the_bias():
    rng = np.random.default_rng(34)
    series = np.cumsum(0.05 * rng.normal(size=8000)) + rng.normal(size=8000)
    bank = ArmaBank(4000)
    bank.update_many(series)
    assert "unit root" in bank.model.flags
    # sd of the walk's step is known to about 10 % from 4000 samples.
    assert bank.walk_sd == pytest.approx(0.05, rel=0.4)
    assert bank.model.sd == pytest.approx(1.0, rel=0.06)
    assert bank.model.is_stable


def test_split_keeps_the_spectrum():
    whole = ArmaModel([-1.5, 0.5], [-1.26, 0.288], 2.0, 1e-6 * np.eye(4), effective_window=4000.0)
    walk_sd, rest = split_bias(whole)
    w = np.exp(-1j * np.linspace(0.05, 3.1, 50))

    def power(model):
        top, bottom = np.polyval(np.r_[1.0, model.ma][::-1], w), np.polyval(np.r_[1.0, model.ar][::-1], w)
        return model.sd**2 * np.abs(top / bottom) ** 2

    np.testing.assert_allclose(walk_sd**2 / np.abs(1 - w) ** 2 + power(rest), power(whole), rtol=1e-9)
    assert np.all(np.isfinite(rest.covariance))
    with pytest.raises(ValueError, match="no real positive pole"):
        split_bias(ArmaModel([0.5], [], 1.0))


def test_unit_root_by_pole_and_by_test():
    assert has_unit_root([-0.9995], [[1e-9]], 4000)
    assert has_unit_root([-0.997], [[1e-5]], 4000)
    assert not has_unit_root([-0.997], [[1e-8]], 4000)
    assert not has_unit_root([0.9999], [[1e-5]], 4000)
    assert np.max(np.abs(np.roots(np.r_[1.0, cap_poles([-1.999, 0.9995], 0.99)]))) == pytest.approx(0.99)


def test_superfluous_pairs_are_seen():
    tight, loose = 1e-6 * np.eye(2), 0.01 * np.eye(2)
    assert cancelling_pairs([-0.9], [-0.88], loose) == 1
    assert cancelling_pairs([-0.9], [-0.88], tight) == 0
    assert cancelling_pairs([-1.2, 0.7], [-1.2, 0.7], 1e-4 * np.eye(4)) == 2
    assert cancelling_pairs([-0.9], [], 1e-4 * np.eye(1)) == 0


def test_moments_give_a_gauss_markov_model():
    series = simulate_arma([-0.9], [], 2.0, 20_000, seed=35)
    model = moment_gm1(series)
    assert model.ar[0] == pytest.approx(-0.9, abs=0.02)
    assert model.sd == pytest.approx(2.0, rel=0.03)
    assert "fallback" in model.flags
    assert moment_gm1(simulate_arma([], [], 1.0, 4000, seed=36)).p == 0
    assert moment_gm1([np.nan, 1.0]).sd == 0.0


def test_colour_that_no_candidate_explains_falls_back():
    series = simulate_arma(np.r_[np.zeros(9), -0.9], [], 1.0, 5000, seed=37)
    strict, lenient = ArmaBank(2000), ArmaBank(2000, strict=False)
    strict.update_many(series)
    lenient.update_many(series)
    assert strict.order is None
    assert "fallback" in strict.model.flags
    assert "coloured" in lenient.model.flags
    assert lenient.order is not None


def test_the_last_good_model_stays_in_use_for_two_windows():
    good = simulate_arma([-0.8], [], 1.0, 4000, seed=38)
    strange = simulate_arma(np.r_[np.zeros(9), -0.9], [], 1.0, 8000, seed=39)
    bank = ArmaBank(2000)
    bank.update_many(good)
    model = bank.model
    bank.update_many(strange[:1500])
    assert "stale" in bank.model.flags
    assert np.array_equal(bank.model.ar, model.ar)
    bank.update_many(strange[1500:])
    assert "fallback" in bank.model.flags


def test_a_change_of_order_is_followed():
    bank = ArmaBank(2000)
    bank.update_many(simulate_arma([-0.8], [], 1.0, 5000, seed=40))
    assert bank.order == (1, 0)
    bank.update_many(simulate_arma([-1.6, 0.8], [], 1.0, 5000, seed=41))
    assert bank.order == (2, 0)


def test_before_and_without_data():
    bank = ArmaBank(1000)
    assert bank.order is None
    assert "starting" in bank.model.flags
    bank.update_many(np.full(3000, 7.5))
    assert "constant" in bank.model.flags
    assert bank.model.sd == 0.0
    with pytest.raises(ValueError, match="criterion"):
        ArmaBank(1000, criterion="aic")
    with pytest.raises(ValueError, match="orders is empty"):
        ArmaBank(1000, orders=[])
    with pytest.raises(ValueError, match="one-dimensional"):
        bank.update_many(np.zeros((3, 3)))

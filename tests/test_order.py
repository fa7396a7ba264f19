"""Order selection: one consistent table, a sensible choice, and threads that do not matter."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.timeseries.fit import cancels

CRITERIA = ("loglik", "aic", "aicc", "bic", "hq", "sd", "whiteness", "is_white")


@pytest.fixture(scope="module")
def table():
    return nf.select_order(nf.simulate_arma([-1.6, 0.64], [0.3], 1.0, 4000, seed=1), max_p=4, max_q=3)


def test_every_criterion_is_a_p_by_q_array(table):
    for name in CRITERIA:
        assert getattr(table, name).shape == (5, 4)
    np.testing.assert_array_equal(table.bic[2, 1], table.fits[2, 1].bic)
    assert table.fits[3, 2].p == 3 and table.fits[3, 2].q == 2


def test_nested_likelihoods_never_fall(table):
    # Warm starts make this exact up to the rounding of one more coefficient that is zero.
    assert np.diff(table.loglik, axis=0).min() > -1e-6
    assert np.diff(table.loglik, axis=1).min() > -1e-6


def test_the_order_is_found(table):
    assert table.best == (2, 1)
    assert table.fit is table.fits[2, 1]
    assert table.is_white[2, 1] and not table.is_white[1, 1]
    direct = nf.fit_arma(nf.simulate_arma([-1.6, 0.64], [0.3], 1.0, 4000, seed=1), *table.best)
    assert table.fit.loglik == pytest.approx(direct.loglik, abs=1e-3)


def test_threads_do_not_change_the_table():
    y = nf.simulate_arma([-0.9], [0.5], 1.0, 1000, seed=2)
    one, two = nf.select_order(y, 2, 2, threads=1), nf.select_order(y, 2, 2, threads=2)
    for name in CRITERIA:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    with pytest.raises(ValueError, match="threads"):
        nf.select_order(y, 1, 1, threads=0)


def test_white_noise_needs_no_coefficients():
    # At least 95 % by requirement; these 40 runs all give (0, 0), and 3 failures would have probability 1 % at 98 %.
    picks = [nf.select_order(np.random.default_rng(s).normal(size=1000), 3, 3).best for s in range(40)]
    assert sum(pick == (0, 0) for pick in picks) >= 38


def test_a_cancelling_pair_is_recognised():
    y = nf.simulate_arma([-0.9], [], 1.0, 4000, seed=3)
    assert cancels(nf.fit_arma(y, 2, 1))
    assert not cancels(nf.fit_arma(y, 1, 0))
    assert not cancels(nf.fit_arma(nf.simulate_arma([-0.8], [0.6], 1.0, 4000, seed=4), 1, 1))
    # A random walk under white noise: pole and zero 0.02 apart, yet ten standard deviations.
    assert not cancels(nf.fit_arma(nf.simulate_arma([-0.9999], [-0.98], 1.0, 14_400, seed=5), 1, 1))


def test_gaps_and_differences_are_allowed():
    y = np.cumsum(nf.simulate_arma([-0.7], [], 1.0, 1500, seed=6))
    y[700:710] = np.nan
    table = nf.select_order(y, 1, 1, d=1)
    assert table.best == (1, 0) and table.fit.d == 1 and "gaps" in table.fit.flags


@pytest.mark.parametrize(
    ("series", "message"), [(np.ones(500), "constant"), (np.arange(10.0), "at least"), (np.full(100, np.nan), "NaN")]
)
def test_bad_input_is_refused_clearly(series, message):
    with pytest.raises(ValueError, match=message):
        nf.select_order(series, 2, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ar", "ma"),
    [
        (np.poly([0.972, -0.177])[1:], []),
        ([-0.99], [-0.931]),
        (np.poly([0.97, 0.5, 0.9 * np.exp(0.8j), 0.9 * np.exp(-0.8j)]).real[1:], np.poly([0.85, -0.3])[1:]),
    ],
    ids=["AR2", "GM1 + white", "(4,2)"],
)
def test_the_choice_predicts_nearly_as_well_as_the_true_order(ar, ma):
    """Excess prediction variance of the choice, times W, at most 1.4 times the true number of coefficients."""
    W, costs = 4000, []
    for seed in range(40):
        fit = nf.select_order(nf.simulate_arma(ar, ma, 1.0, W, seed), 4, 4).fit
        a, c = np.convolve(np.r_[1.0, ar], np.r_[1.0, fit.ma]), np.convolve(np.r_[1.0, ma], np.r_[1.0, fit.ar])
        costs.append(W * (nf.ArmaModel(a[1:], c[1:], 1.0).variance - 1.0))
    assert np.mean(costs) <= 1.4 * (len(ar) + len(ma))

"""Bad input to the online estimators: never a NaN coefficient, never an unstable model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navfilter.timeseries.model import simulate_arma
from navfilter.timeseries.online.order_bank import ArmaBank
from navfilter.timeseries.online.recursive import RecursiveArma

BASE = simulate_arma([-0.9], [0.4], 1.0, 1500, seed=51)


def outlier(series, size=1e9, at=700):
    series = series.copy()
    series[at] = size
    return series


BAD = {
    "constant": np.full(1500, 3.25),
    "constant zero": np.zeros(1500),
    "empty": np.empty(0),
    "short": BASE[:40],
    "all NaN": np.full(1500, np.nan),
    "infinite": np.where(np.arange(1500) % 50 == 7, np.inf, BASE),
    "all infinite": np.full(1500, -np.inf),
    "integer counts": np.round(10 * BASE).astype(int),
    "huge offset": BASE + 1e9,
    "denormal scale": 1e-30 * BASE,
    "smaller still": 1e-300 * BASE,
    "large scale": 1e70 * BASE,
    "outlier": outlier(BASE),
    "outlier in the start": outlier(BASE, at=50),
    "outlier first": outlier(BASE, at=0),
    "outlier of the largest size": outlier(BASE, 1e308),
    "three levels": np.clip(np.round(BASE / 2.0), -1, 1),
    "two levels": np.sign(BASE),
    "one step": np.r_[np.zeros(700), np.ones(800)],
    "ramp": np.arange(1500.0),
    "exponential": 1.05 ** np.arange(1500.0),
    "pure sine": np.sin(0.3 * np.arange(1500.0)),
    "alternating": (-1.0) ** np.arange(1500),
    "silence then noise": np.r_[np.zeros(900), BASE[:600]],
    "noise then silence": np.r_[BASE[:600], np.full(900, BASE[599])],
    "every other missing": np.where(np.arange(1500) % 2, np.nan, BASE),
    "stuck values": np.repeat(BASE[:300], 5),
}


def check(estimator):
    model = estimator.model
    assert np.all(np.isfinite(model.ar))
    assert np.all(np.isfinite(model.ma))
    assert np.isfinite(model.sd)
    assert model.is_stable
    assert model.is_invertible
    assert model.covariance is None or np.all(np.isfinite(model.covariance))


@pytest.mark.parametrize("method", ["rml", "els"])
@pytest.mark.parametrize("mean", [True, False])
@pytest.mark.parametrize("name", BAD)
def test_bad_series_give_a_defined_stable_model(name, mean, method):
    arma = RecursiveArma(2, 2, 500, mean=mean, method=method)
    arma.update_many(BAD[name])
    assert np.all(np.isfinite(np.r_[arma.ar, arma.ma, arma.sd]))
    assert arma.is_stable
    assert np.all(np.isfinite(arma.covariance))
    check(arma)


@pytest.mark.parametrize("name", BAD)
def test_bad_series_through_the_bank(name):
    bank = ArmaBank(500)
    bank.update_many(BAD[name])
    check(bank)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_estimate_does_not_depend_on_the_unit(scale):
    plain, scaled = RecursiveArma(1, 1, 500), RecursiveArma(1, 1, 500)
    plain.update_many(BASE)
    scaled.update_many(scale * BASE)
    # Only the rounding of the product with the scale differs.
    np.testing.assert_allclose(scaled.ar, plain.ar, rtol=1e-6)
    np.testing.assert_allclose(scaled.ma, plain.ma, rtol=1e-6)
    assert scaled.sd == pytest.approx(scale * plain.sd, rel=1e-6)


def test_a_huge_offset_costs_only_its_rounding():
    plain, offset = RecursiveArma(1, 1, 500), RecursiveArma(1, 1, 500)
    plain.update_many(BASE)
    offset.update_many(BASE + 1e9)
    # 1e9 leaves 1e-7 of the digits of the series.
    np.testing.assert_allclose(offset.ar, plain.ar, atol=1e-5)
    assert offset.level == pytest.approx(1e9 + plain.level, abs=1e-3)


def test_silence_does_not_wind_up():
    series = np.r_[BASE, np.full(20_000, BASE[-1]), 5.0 * BASE]
    arma = RecursiveArma(1, 1, 500)
    arma.update_many(series[:21_500])
    assert np.all(np.isfinite(arma.covariance))
    arma.update_many(series[21_500:])
    assert arma.ar[0] == pytest.approx(-0.9, abs=0.1)
    assert arma.is_stable


values = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True, width=64),
    st.floats(-1.0, 1.0),
    st.sampled_from([0.0, 1.0, np.nan, np.inf, 1e300, -1e300, 1e-300]),
)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(values, st.integers(1, 120)), min_size=1, max_size=8),
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 2**16),
    st.sampled_from([0.0, 4.0]),
)
def test_any_mixture_of_noise_and_nonsense_is_survived(pieces, p, q, seed, clip):
    rng = np.random.default_rng(seed)
    series = np.concatenate([np.r_[np.full(count, value), rng.normal(size=count)] for value, count in pieces])
    arma = RecursiveArma(p, q, 200, clip=clip)
    arma.update_many(np.tile(series, 2))
    check(arma)
    assert np.all(np.isfinite(np.r_[arma.ar, arma.ma, arma.sd]))

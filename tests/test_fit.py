"""Batch fits against statsmodels, against the truth, with gaps and trends, and on bad input."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from statsmodels.tsa.arima.estimators.innovations import innovations_mle
from statsmodels.tsa.innovations.arma_innovations import arma_loglike
from statsmodels.tsa.statespace.sarimax import SARIMAX

import navfilter as nf
from navfilter.timeseries.likelihood import GapFree, WithGaps

SLOW, FAST = 0.97 * np.exp(0.5j), 0.8 * np.exp(1.7j)
TRUTH = {
    (1, 0): ([-0.9], []),
    (0, 1): ([], [-0.6]),
    (1, 1): ([-0.99], [-0.931]),
    (2, 0): ([-0.795, -0.172], []),
    (2, 1): ([-1.6, 0.64], [0.3]),
    (2, 2): ([0.9, 0.95], [1.5, 0.75]),
    (4, 2): (np.poly([0.97, 0.5, 0.9 * np.exp(0.8j), 0.9 * np.exp(-0.8j)]).real[1:], [-0.55, -0.255]),
    (4, 4): (np.poly([SLOW, SLOW.conjugate(), FAST, FAST.conjugate()]).real[1:], [0.5, -0.3, 0.2, 0.1]),
}
TEN = (
    np.poly(
        [
            r * np.exp(s * 1j * w)
            for r, w in zip((0.95, 0.9, 0.9, 0.9, 0.85), (0.3, 0.8, 1.3, 1.8, 2.4), strict=True)
            for s in (1, -1)
        ]
    ),
    np.poly(
        [
            r * np.exp(s * 1j * w)
            for r, w in zip((0.8, 0.7, 0.8, 0.6, 0.8), (0.55, 1.05, 1.55, 2.1, 2.8), strict=True)
            for s in (1, -1)
        ]
    ),
)
TRUTH[10, 10] = (TEN[0].real[1:], TEN[1].real[1:])


@pytest.mark.parametrize("order", TRUTH, ids=str)
def test_loglik_equals_statsmodels_at_the_estimate(order):
    ar, ma = TRUTH[order]
    y = nf.simulate_arma(ar, ma, 2.0, 1500, seed=3)
    fit = nf.fit_arma(y, *order, trend="none")
    assert fit.loglik == pytest.approx(arma_loglike(y, -fit.ar, fit.ma.copy(), fit.sd**2), abs=1e-3)
    assert fit.aic == pytest.approx(-2.0 * fit.loglik + 2.0 * (sum(order) + 1))
    assert nf.timeseries.is_stable(fit.ar) and nf.timeseries.is_stable(fit.ma)


@pytest.mark.parametrize("order", [order for order in TRUTH if order != (10, 10)], ids=str)
def test_never_a_lower_optimum_than_statsmodels(order):
    y = nf.simulate_arma(*TRUTH[order], 1.0, 1500, seed=1)
    fit = nf.fit_arma(y, *order, trend="none")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            other, _ = innovations_mle(y, order=(order[0], 0, order[1]), demean=False)
        except ValueError:  # its line search left the stationary region
            return
    theirs = arma_loglike(y, other.ar_params, other.ma_params, other.sigma2)
    assert fit.loglik >= theirs - 1e-3


def test_gaps_equal_the_state_space_likelihood():
    y = nf.simulate_arma([-1.6, 0.64], [0.3], 2.0, 800, seed=5)
    y[100:130] = np.nan
    y[::9] = np.nan
    fit = nf.fit_arma(y, 2, 1, trend="none")
    smooth = SARIMAX(y, order=(2, 0, 1)).loglike(np.r_[-fit.ar, fit.ma, fit.sd**2])
    assert fit.loglik == pytest.approx(smooth, abs=1e-3)
    assert "gaps" in fit.flags and fit.n == np.isfinite(y).sum()
    np.testing.assert_array_equal(np.isnan(fit.residuals), np.isnan(y))
    # Three standard deviations of the fit's own covariance.
    error = np.r_[fit.ar, fit.ma] - [-1.6, 0.64, 0.3]
    assert np.all(np.abs(error) < 3.0 * np.sqrt(np.diag(fit.covariance)))


@pytest.mark.parametrize("order", [(1, 0), (2, 1), (4, 4)], ids=str)
def test_both_forms_of_the_likelihood_agree(order):
    """Start estimated along (no gaps) and Kalman filter (gaps) are the same function."""
    ar, ma = TRUTH[order]
    y = nf.simulate_arma(ar, ma, 1.0, 300, seed=6)
    theta = 0.97 * np.r_[ar, ma]
    inputs = np.vstack([np.ones(300), np.linspace(-1.0, 1.0, 300)])
    a = GapFree(y, inputs, *order, diffuse=False).evaluate(theta)
    b = WithGaps(y, inputs, *order, diffuse=False).evaluate(theta)
    assert a.value == pytest.approx(b.value, abs=1e-8)
    np.testing.assert_allclose(a.beta, b.beta, rtol=1e-7)


@pytest.mark.parametrize("order", [(1, 1), (2, 1), (4, 2)], ids=str)
@pytest.mark.parametrize("diffuse", [False, True])
def test_the_gradient_is_exact(order, diffuse):
    ar, ma = TRUTH[order]
    objective = GapFree(nf.simulate_arma(ar, ma, 1.0, 500, seed=7), np.ones((1, 500)), *order, diffuse=diffuse)
    theta = 0.95 * np.r_[ar, ma]
    _, gradient = objective.linearise(objective.evaluate(theta))
    numeric = np.empty_like(theta)
    for j in range(theta.size):
        step = 1e-6 * np.eye(theta.size)[j]
        numeric[j] = (objective.evaluate(theta + step).value - objective.evaluate(theta - step).value) / 2e-6
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5 * np.abs(numeric).max())


def test_covariance_is_the_spread_of_the_estimates():
    fits = [nf.fit_arma(nf.simulate_arma([-0.8], [0.4], 1.0, 1000, s), 1, 1) for s in range(200)]
    spread = np.std([np.r_[f.ar, f.ma] for f in fits], axis=0)
    predicted = np.sqrt(np.mean([np.diag(f.covariance) for f in fits], axis=0))
    # The sd of 200 values is known to 5 %; 4 sd.
    np.testing.assert_allclose(spread, predicted, rtol=0.2)


def test_prediction_error_holds_a_unit_root_that_the_likelihood_avoids():
    y = nf.simulate_arma([-1.0], [-0.98], 1.0, 14_400, seed=1)
    fit = nf.fit_arma(y, 1, 1, "prediction-error")
    assert "unit root" in fit.flags and fit.method == "prediction-error"
    assert fit.ma[0] == pytest.approx(-0.98, abs=0.006)
    assert fit.sd == pytest.approx(1.0, abs=0.02)
    again = nf.fit_arma(y, 0, 1, d=1)
    assert again.ma[0] == pytest.approx(-0.98, abs=0.006)
    np.testing.assert_allclose(again.model.ar, [-1.0])
    assert again.residuals.size == y.size - 1
    assert again.model.covariance.shape == (2, 2)


def test_differenced_model_carries_the_covariance_of_its_factors():
    fit = nf.fit_arma(np.cumsum(nf.simulate_arma([-0.7], [0.3], 1.0, 2000, seed=2)), 1, 1, d=1)
    np.testing.assert_allclose(fit.model.ar, np.convolve([1.0, fit.ar[0]], [1.0, -1.0])[1:])
    v = fit.covariance[0, 0]
    np.testing.assert_allclose(fit.model.covariance[:2, :2], [[v, -v], [-v, v]])


def test_mean_trend_and_regressor_are_estimated_along():
    n = 3000
    noise = nf.simulate_arma([-0.9], [], 1.0, n, seed=8)
    temperature = np.sin(np.arange(n) / 100.0)
    time = np.arange(n) - (n - 1) / 2.0
    fit = nf.fit_arma(noise + 5.0 + 0.01 * time + 3.0 * temperature, 1, 0, trend="linear", regressors=temperature)
    alone = nf.fit_arma(noise, 1, 0, trend="linear", regressors=temperature)
    np.testing.assert_allclose(fit.trend - alone.trend, [5.0, 0.01, 3.0], atol=1e-5)
    np.testing.assert_allclose(fit.ar, alone.ar, atol=1e-7)


@pytest.mark.parametrize("factor", [1e-30, 1e-150, 1e12])
def test_the_unit_does_not_matter(factor):
    y = nf.simulate_arma([-0.9], [0.4], 1.0, 400, seed=9)
    a, b = nf.fit_arma(y, 1, 1), nf.fit_arma(factor * y, 1, 1)
    np.testing.assert_allclose(b.ar, a.ar, rtol=1e-6)
    assert b.sd == pytest.approx(factor * a.sd, rel=1e-6)
    assert b.loglik == pytest.approx(a.loglik - 400 * np.log(factor), rel=1e-9)


def test_a_huge_offset_costs_only_the_digits_it_takes():
    y = nf.simulate_arma([-0.9], [0.4], 1.0, 400, seed=9)
    # 1e9 leaves 1e-7 of a unit.
    np.testing.assert_allclose(nf.fit_arma(y + 1e9, 1, 1).ar, nf.fit_arma(y, 1, 1).ar, atol=1e-6)


@pytest.mark.parametrize(
    ("series", "options", "message"),
    [
        (np.ones(200), {}, "constant"),
        ([], {}, "at least 14 samples"),
        (np.arange(9.0), {}, "at least 14 samples"),
        (np.full(200, np.nan), {}, "all 200 samples are NaN"),
        (np.r_[np.zeros(100), np.inf, np.ones(99)], {}, "1 samples are infinite"),
        (np.zeros((10, 10)), {}, "one series"),
        (np.array(["a"] * 100), {}, "real numbers"),
        (np.random.default_rng(0).normal(size=50), {"method": "ols"}, "method must be"),
        (np.random.default_rng(0).normal(size=50), {"trend": "cubic"}, "trend must be"),
        (np.random.default_rng(0).normal(size=50), {"d": -1}, "d must be"),
        (np.random.default_rng(0).normal(size=50), {"regressors": np.ones(7)}, "regressors must have shape"),
        (np.random.default_rng(0).normal(size=50), {"regressors": np.zeros(50)}, "a regressor is zero"),
        (np.random.default_rng(0).normal(size=50) + 1e9, {"trend": "none"}, "the mean is"),
        (np.where(np.arange(80) % 2, np.nan, np.arange(80.0) % 7), {"d": 1}, "too dense"),
    ],
)
def test_bad_input_is_refused_clearly(series, options, message):
    with pytest.raises(ValueError, match=message):
        nf.fit_arma(series, 1, 1, **options)


def check(fit):
    """What every fit that is handed out must fulfil."""
    numbers = [*fit.ar, *fit.ma, fit.sd, fit.loglik, *fit.covariance.ravel()]
    assert np.all(np.isfinite(numbers))
    assert nf.timeseries.is_stable(fit.ar) and nf.timeseries.is_stable(fit.ma) and fit.sd >= 0.0


@pytest.mark.parametrize("order", [(1, 0), (1, 1), (2, 2), (3, 1)], ids=str)
@pytest.mark.parametrize("method", ["likelihood", "prediction-error"])
@pytest.mark.parametrize(
    "series",
    [
        np.random.default_rng(1).integers(-3, 4, 300),
        np.sign(np.round(np.random.default_rng(2).normal(size=300) * 0.7)),
        np.r_[np.random.default_rng(3).normal(size=150), 1e12, np.random.default_rng(4).normal(size=150)],
        np.arange(200.0),
        np.sin(np.arange(300) * 0.3),
        np.r_[np.zeros(299), 1.0],
        np.tile([1.0, -1.0], 100),
        np.exp(np.arange(200) / 4.0),
        np.random.default_rng(5).normal(size=300) * 1e-310,
        np.cumsum(np.cumsum(np.random.default_rng(6).normal(size=500))),
    ],
    ids=["counts", "three levels", "outlier", "ramp", "sine", "impulse", "alternating", "growth", "denormal", "I(2)"],
)
def test_hard_series_give_a_stable_model_or_a_clear_error(series, method, order):
    try:
        fit = nf.fit_arma(series, *order, method)
    except ValueError as error:
        assert "predictable without error" in str(error)
        return
    check(fit)


@settings(max_examples=60)
@given(
    series=arrays(np.float64, st.integers(0, 60), elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
    p=st.integers(0, 3),
    q=st.integers(0, 3),
)
def test_any_series_gives_a_stable_model_or_a_value_error(series, p, q):
    try:
        fit = nf.fit_arma(series, p, q)
    except ValueError:
        return
    check(fit)


@pytest.mark.parametrize("estimate", [nf.timeseries.yule_walker, nf.timeseries.burg], ids=["yule_walker", "burg"])
def test_ar_estimates_find_the_model(estimate):
    y = nf.simulate_arma([-1.2, 0.5], [], 3.0, 20_000, seed=10) + 100.0
    model = estimate(y, 2)
    # sd of both coefficients is sqrt((1 - 0.25)/20000) = 0.006; 4 sd.
    np.testing.assert_allclose(model.ar, [-1.2, 0.5], atol=0.025)
    assert model.sd == pytest.approx(3.0, rel=0.02)
    assert estimate(y, 0).sd == pytest.approx(np.std(y))
    with pytest.raises(ValueError, match="constant"):
        estimate(np.ones(50), 1)
    with pytest.raises(ValueError, match="NaN"):
        estimate(np.r_[y[:50], np.nan], 1)


def test_hannan_rissanen_is_a_usable_start_and_stable():
    model = nf.timeseries.hannan_rissanen(nf.simulate_arma([-0.8], [0.5], 2.0, 20_000, seed=11), 1, 1)
    np.testing.assert_allclose([model.ar[0], model.ma[0], model.sd], [-0.8, 0.5, 2.0], atol=0.05)
    walk = nf.timeseries.hannan_rissanen(np.cumsum(np.random.default_rng(1).normal(size=400)), 3, 3)
    assert walk.is_stable and walk.is_invertible

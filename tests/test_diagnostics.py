"""Correlation, whiteness and Allan deviation against statsmodels, theory and known series; Gauss-Markov fits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.tsa.stattools import acf as sm_acf
from statsmodels.tsa.stattools import ccf as sm_ccf
from statsmodels.tsa.stattools import pacf as sm_pacf

import navfilter as nf
from navfilter.timeseries.fit import gauss_markov_correlation

SERIES = nf.simulate_arma([-0.7], [0.4], 2.0, 1200, seed=1) + 50.0


def test_acf_and_pacf_equal_statsmodels():
    np.testing.assert_allclose(nf.acf(SERIES, 30), sm_acf(SERIES, nlags=30), atol=1e-12)
    np.testing.assert_allclose(nf.pacf(SERIES, 30), sm_pacf(SERIES, nlags=30, method="ldbiased"), atol=1e-10)
    assert nf.acf(SERIES, 0).tolist() == [1.0]


def test_cross_correlation_finds_the_delay_and_equals_statsmodels():
    late = np.roll(SERIES, 3) + 0.1 * np.random.default_rng(2).normal(size=SERIES.size)
    r = nf.timeseries.cross_correlation(SERIES, late, 10)
    assert np.argmax(r) - 10 == 3
    np.testing.assert_allclose(r[10:], sm_ccf(late, SERIES, adjusted=False)[:11], atol=1e-12)
    with pytest.raises(ValueError, match="same length"):
        nf.timeseries.cross_correlation(SERIES, late[:-1], 3)


def test_acf_takes_a_missing_sample_as_absent():
    gappy = SERIES.copy()
    gappy[::10] = np.nan
    # Dropping a tenth of the samples shrinks lag products by 0.9^2 and the power by 0.9.
    assert nf.acf(gappy, 1)[1] == pytest.approx(0.9 * nf.acf(SERIES, 1)[1], abs=0.03)


def test_ljung_box_equals_statsmodels():
    result = nf.whiteness(SERIES, fitted=2, lags=25)
    table = acorr_ljungbox(SERIES - SERIES.mean(), lags=[25], model_df=2)
    assert result.ljung_box == pytest.approx(float(table["lb_stat"].iloc[0]))
    assert result.ljung_box_p == pytest.approx(float(table["lb_pvalue"].iloc[0]), abs=1e-12)
    assert not result.is_white and (result.n, result.lags, result.fitted) == (1200, 25, 2)


def test_whiteness_false_alarms_and_power():
    random = np.random.default_rng(3)
    white = [nf.whiteness(random.standard_normal(4000)) for _ in range(400)]
    alarms = sum(not w.is_white for w in white)
    # Binomial(400, 1 %): 4 expected, 13 is beyond 4 sd; none at all would have probability 1.8 %.
    assert alarms <= 13
    coloured = [nf.whiteness(nf.simulate_arma([-0.1], [], 1.0, 4000, random)) for _ in range(100)]
    assert sum(not w.is_white for w in coloured) >= 95
    # The thesis's measure: 3.855 for white noise (a single one scatters by 0.7), and it passes phi = 0.3 ("WT > 1").
    assert np.mean([w.wt for w in white]) == pytest.approx(3.855, abs=0.2)
    strong = [nf.whiteness(nf.simulate_arma([-0.3], [], 1.0, 4000, random)) for _ in range(20)]
    assert all(w.wt > 1.0 and not w.is_white for w in strong)


def test_white_value_of_the_thesis_measure_is_the_integral():
    from scipy.integrate import quad
    from scipy.stats import norm

    fraction, _ = quad(lambda x: 2.0 * norm.cdf(-1.96 / np.sqrt(1.0 - x)), 0.0, 1.0)
    assert 0.05 / fraction == pytest.approx(nf.whiteness(SERIES).wt_white, abs=1e-3)


def test_fitted_coefficients_cost_degrees_of_freedom():
    random = np.random.default_rng(4)
    p_values = []
    for _ in range(150):
        fit = nf.fit_arma(nf.simulate_arma([-0.6], [0.3], 1.0, 1000, random), 1, 1)
        p_values.append(nf.whiteness(fit.residuals, fitted=2).ljung_box_p)
    # The mean of 150 uniform values scatters by 0.024; without the correction it would be 0.60.
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.075)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: nf.acf(np.ones(50), 3), "constant"),
        (lambda: nf.acf(SERIES, 1200), "lags must be"),
        (lambda: nf.acf(SERIES, -1), "lags must be"),
        (lambda: nf.whiteness(np.ones(50)), "constant"),
        (lambda: nf.whiteness([1.0, 2.0]), "at least 8"),
        (lambda: nf.whiteness(SERIES, fitted=10, lags=10), "fitted \\+ 1"),
        (lambda: nf.whiteness(SERIES, level=2.0), "level"),
        (lambda: nf.whiteness(np.full(99, np.nan)), "all 99 samples are NaN"),
        (lambda: nf.timeseries.allan_deviation(SERIES, -1.0), "rate_hz"),
        (lambda: nf.timeseries.allan_deviation(SERIES, 1.0, [700]), "averages must span"),
        (lambda: nf.timeseries.fit_gauss_markov(SERIES, 0, 1.0), "order"),
        (lambda: nf.timeseries.fit_gauss_markov(SERIES, 1, 1.0, "moments"), "method"),
    ],
)
def test_bad_input_is_refused_clearly(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@settings(max_examples=60)
@given(arrays(np.float64, st.integers(0, 80), elements=st.floats(-1e300, 1e300) | st.just(np.nan)), st.integers(0, 10))
def test_any_series_gives_numbers_or_a_value_error(series, lags):
    try:
        r, w = nf.acf(series, lags), nf.whiteness(series)
    except ValueError:
        return
    assert np.all(np.isfinite(r)) and np.all(np.abs(r) <= 1.0 + 1e-9)
    assert 0.0 <= w.ljung_box_p <= 1.0 and 0.0 <= w.periodogram_p <= 1.0 and w.wt > 0.0


def test_allan_deviation_of_white_noise_and_of_a_random_walk():
    random = np.random.default_rng(5)
    rate_hz = 50.0
    tau, white = nf.timeseries.allan_deviation(random.normal(size=200_000), rate_hz, [1, 10, 100])
    np.testing.assert_allclose(tau, [0.02, 0.2, 2.0])
    # White noise of sd s: s/sqrt(m); at m = 100 about 2000 independent averages, 1.6 % each.
    np.testing.assert_allclose(white, 1.0 / np.sqrt([1, 10, 100]), rtol=0.06)
    tau, walk = nf.timeseries.allan_deviation(np.cumsum(random.normal(size=200_000)), rate_hz)
    slope = np.polyfit(np.log(tau[5:30]), np.log(walk[5:30]), 1)[0]
    assert slope == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_sampled_gauss_markov_has_the_continuous_correlation(order):
    model = nf.timeseries.gauss_markov_arma(order, 2.0, beta=0.4, rate_hz=2.0)
    expected = 4.0 * gauss_markov_correlation(order, 0.4 * np.arange(40) / 2.0)
    # A fourfold pole keeps a quarter of the digits.
    np.testing.assert_allclose(model.autocovariance(39), expected, atol=1e-7)
    assert (model.p, model.q) == (order, order - 1)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("method", ["likelihood", "1/e"])
def test_gauss_markov_fit_finds_the_time_constant(order, method):
    truth = nf.timeseries.gauss_markov_arma(order, 2.0, beta=0.5, rate_hz=10.0)
    y = nf.simulate_arma(truth.ar, truth.ma, truth.sd, 40_000, seed=order)
    fit = nf.timeseries.fit_gauss_markov(y, order, 10.0, method)
    # 4000 s hold about 1000 correlation times: 5 % by likelihood, about three times that by the 1/e point.
    assert fit.beta == pytest.approx(0.5, rel=0.1 if method == "likelihood" else 0.25)
    assert fit.sd == pytest.approx(2.0, rel=0.1)
    assert fit.tau_s * fit.beta == pytest.approx(nf.timeseries.correlation_product(order))

"""The ARMA model as a value: spectra, autocovariance, simulation, forecast, and exact algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from statsmodels.tsa.arima_process import arma_acovf

import navfilter as nf

MODELS = {
    "white": nf.ArmaModel([], [], 1.5),
    "ar1": nf.ArmaModel([-0.9], [], 2.0),
    "ma2": nf.ArmaModel([], [-0.6, 0.3], 0.5),
    "arma21": nf.ArmaModel([-1.6, 0.64], [0.3], 2.0),
    "arma13": nf.ArmaModel([0.7], [0.5, -0.2, 0.1], 1.0),
}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
def test_autocovariance_equals_statsmodels_and_the_impulse_response(model):
    expected = arma_acovf(np.r_[1.0, model.ar], np.r_[1.0, model.ma], nobs=9, sigma2=model.sd**2)
    np.testing.assert_allclose(model.autocovariance(8), expected[:9], rtol=1e-9, atol=1e-12)
    psi = model.psi(4000)
    assert model.variance == pytest.approx(model.sd**2 * psi @ psi, rel=1e-10)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
def test_one_sided_spectrum_integrates_to_the_variance(model):
    rate_hz = 8.0
    freq = np.linspace(0.0, rate_hz / 2.0, 200_001)
    assert np.trapezoid(model.spectrum(freq, rate_hz), freq) == pytest.approx(model.variance, rel=1e-6)


def test_the_model_is_an_immutable_value():
    model = nf.ArmaModel([-0.5], [0.2], 1.0, np.eye(2), flags={"gaps"})
    assert model == nf.ArmaModel([-0.5], [0.2], 1.0, np.eye(2), flags=frozenset({"gaps"}))
    assert hash(model) == hash(nf.ArmaModel([-0.5], [0.2], 1.0, np.eye(2), flags={"gaps"}))
    assert model != nf.ArmaModel([-0.5], [0.2], 1.0)
    assert model != "ARMA"
    with pytest.raises(AttributeError):
        model.sd = 2.0
    with pytest.raises(ValueError, match="read-only"):
        model.ar[0] = 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([np.nan], [], 1.0), "ar must be finite"),
        (([], [[1.0, 2.0]], 1.0), "one-dimensional"),
        (([], [], -1.0), "sd must be"),
        (([-0.5], [], 1.0, np.eye(2)), "1 x 1"),
    ],
)
def test_bad_models_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        nf.ArmaModel(*arguments)


def test_sign_convention_is_that_of_lfilter():
    model = nf.ArmaModel([-0.8], [0.4], 1.0)
    np.testing.assert_allclose(model.psi(4), [1.0, 1.2, 0.96, 0.768])
    np.testing.assert_allclose(model.poles, [0.8])
    np.testing.assert_allclose(model.zeros, [-0.4])


def test_simulation_starts_in_the_stationary_distribution():
    # 4000 first samples: their variance has a relative sd of sqrt(2/4000) = 2.2 %; 4 sd.
    model = nf.ArmaModel([-0.99], [0.3], 1.0)
    random = np.random.default_rng(1)
    first = np.array([nf.simulate_arma(model.ar, model.ma, 1.0, 2, random) for _ in range(4000)])
    gamma = model.autocovariance(1)
    assert np.var(first[:, 0]) == pytest.approx(gamma[0], rel=0.09)
    assert np.mean(first[:, 0] * first[:, 1]) == pytest.approx(gamma[1], rel=0.09)


def test_simulation_repeats_with_its_seed_and_walks_from_zero():
    a = nf.simulate_arma([-1.0], [-0.9], 1.0, 50, seed=4)
    np.testing.assert_array_equal(a, nf.simulate_arma([-1.0], [-0.9], 1.0, 50, seed=4))
    e = np.random.default_rng(4).standard_normal(50)
    np.testing.assert_allclose(a, lfilter([1.0, -0.9], [1.0, -1.0], e))
    with pytest.raises(ValueError, match="negative"):
        nf.simulate_arma([], [], 1.0, -1, seed=0)


def test_forecast_of_an_ar1_decays_and_its_sd_grows():
    mean, sd = nf.timeseries.forecast_arma(nf.ArmaModel([-0.8], [], 2.0), [0.0, 3.0, 5.0], 3)
    np.testing.assert_allclose(mean, [4.0, 3.2, 2.56])
    np.testing.assert_allclose(sd, 2.0 * np.sqrt([1.0, 1.64, 2.0496]))
    with pytest.raises(ValueError, match="invertible"):
        nf.timeseries.forecast_arma(nf.ArmaModel([], [1.5], 1.0), [1.0], 1)
    with pytest.raises(ValueError, match="not finite"):
        nf.timeseries.forecast_arma(nf.ArmaModel([], [0.5], 1.0), [np.nan], 1)


def roots_within(radius):
    """Stable coefficient vectors from random real roots and pairs."""
    pair = st.tuples(st.floats(0.0, radius), st.floats(0.0, np.pi))
    return st.tuples(st.lists(st.floats(-radius, radius), max_size=2), st.lists(pair, max_size=2)).map(
        lambda parts: np.atleast_1d(
            np.poly([*parts[0], *(r * np.exp(s * 1j * w) for r, w in parts[1] for s in (1, -1))])
        ).real[1:]
    )


@settings(max_examples=60)
@given(ar=roots_within(0.95), ma=roots_within(0.95), m=st.integers(1, 6))
def test_resampled_model_has_the_decimated_autocovariance(ar, ma, m):
    model = nf.ArmaModel(ar, ma, 1.3)
    slow = nf.timeseries.resample_arma(model, m)
    wanted = model.autocovariance(8 * m)[::m]
    # Multiple poles raised to the m-th power and factored again lose digits.
    np.testing.assert_allclose(slow.autocovariance(8), wanted, atol=2e-6 * wanted[0])
    assert slow.q == (model.p * (m - 1) + model.q) // m
    assert slow.p == model.p


def test_resampling_crosses_unit_roots():
    # Random walk + white, every 10th sample: the walk's drive is sqrt(10) larger, the white noise the same.
    fast = nf.timeseries.bias_plus_white(nf.ArmaModel([-1.0], [-0.98], 1.0))
    slow = nf.timeseries.bias_plus_white(nf.timeseries.resample_arma(nf.ArmaModel([-1.0], [-0.98], 1.0), 10))
    assert slow.pole == pytest.approx(1.0)
    assert slow.drive_sd == pytest.approx(fast.drive_sd * np.sqrt(10.0), rel=1e-9)
    assert slow.white_sd == pytest.approx(fast.white_sd, rel=1e-9)
    with pytest.raises(ValueError, match="whole number"):
        nf.timeseries.resample_arma(nf.ArmaModel([-1.0], [], 1.0), 0)


@settings(max_examples=60)
@given(ma=roots_within(1.0), sd=st.floats(1e-3, 1e3))
def test_spectral_factor_recovers_an_invertible_moving_average(ma, sd):
    factor_and_compare(nf.ArmaModel([], ma, sd))


def test_spectral_factor_recovers_a_triple_zero_on_the_circle():
    """Found by random search."""
    factor_and_compare(nf.ArmaModel([], [-3.0, 3.0, -1.0], 1.0))


def factor_and_compare(model):
    """The factor of the model's autocovariance has that autocovariance, and no larger an innovation."""
    found, found_sd = nf.timeseries.spectral_factor(model.autocovariance(model.q))
    # Zeros on the circle are double zeros of the spectrum: half the digits.
    np.testing.assert_allclose(
        nf.ArmaModel([], found, found_sd).autocovariance(model.q),
        model.autocovariance(model.q),
        atol=1e-9 * model.sd**2 * 64,
    )
    # A double zero on the circle is a fourfold one of the spectrum: a quarter of the digits.
    assert found_sd <= model.sd * (1.0 + 1e-3)


def test_spectral_factor_refuses_what_is_no_autocovariance():
    with pytest.raises(ValueError, match="not an autocovariance"):
        nf.timeseries.spectral_factor([1.0, 0.9])
    with pytest.raises(ValueError, match="positive at lag 0"):
        nf.timeseries.spectral_factor([0.0])


def test_sum_of_models_has_the_sum_of_spectra():
    parts = [nf.ArmaModel([-0.9], [], 0.3), nf.ArmaModel([], [], 1.0), nf.ArmaModel([0.2, 0.8], [0.4], 0.5)]
    freq = np.linspace(0.0, 0.5, 50)
    total = nf.timeseries.add_arma(parts)
    assert (total.p, total.q) == (3, 3)
    np.testing.assert_allclose(total.spectrum(freq, 1.0), sum(m.spectrum(freq, 1.0) for m in parts), rtol=1e-9)
    assert nf.timeseries.add_arma([]).sd == 0.0


@settings(max_examples=80)
@given(pole=st.floats(0.05, 1.0), drive=st.floats(1e-3, 10.0), white=st.floats(1e-3, 10.0))
def test_bias_plus_white_and_back(pole, drive, white):
    reading = nf.timeseries.bias_plus_white(nf.timeseries.BiasPlusWhite(white, drive, pole).model)
    assert reading.pole == pytest.approx(pole, abs=1e-12)
    # A part 1e-4 times the other's sd is 1e-8 of its variance, so it keeps half the digits.
    assert reading.drive_sd == pytest.approx(drive, abs=1e-6 * max(drive, white))
    assert reading.white_sd == pytest.approx(white, abs=1e-6 * max(drive, white))


def test_lines_are_read_from_a_larger_model():
    line = nf.ArmaModel([1.9, 0.95], [0.97], 0.05)
    total = nf.timeseries.add_arma([nf.ArmaModel([-1.0], [], 0.02), nf.ArmaModel([], [], 1.0), line])
    reading = nf.timeseries.bias_plus_white(total)
    assert reading.drive_sd == pytest.approx(0.02, rel=1e-6)
    assert reading.white_sd == pytest.approx(1.0, rel=1e-6)
    assert reading.lines[0].freq == pytest.approx(0.464, abs=1e-3)
    assert reading.lines[0].sd == pytest.approx(np.sqrt(line.variance), rel=0.05)
    with pytest.raises(ValueError, match="moving average"):
        nf.timeseries.bias_plus_white(nf.ArmaModel([], [0.5], 1.0))
    with pytest.raises(ValueError, match="no split"):
        nf.timeseries.bias_plus_white(nf.ArmaModel([-0.5], [0.9], 1.0))


def test_log_s0_sd_is_the_spread_of_the_estimated_density_at_zero():
    fits = [nf.fit_arma(nf.simulate_arma([-0.9], [0.3], 1.0, 4000, s), 1, 1) for s in range(120)]
    logs = [2.0 * np.log(f.sd * (1.0 + f.ma.sum()) / (1.0 + f.ar.sum())) for f in fits]
    predicted = np.mean([f.model.sd_log_s0 for f in fits])
    # The sd of 120 values is known to 6.5 %; 3 sd.
    assert np.std(logs) == pytest.approx(predicted, rel=0.2)
    assert nf.timeseries.log_s0_sd([-1.0], [], [[1.0]], 100) == np.inf


@given(ma=roots_within(0.999))
@settings(max_examples=50)
def test_is_stable_agrees_with_the_roots(ma):
    assert nf.timeseries.is_stable(ma)
    if ma.size:
        largest = np.abs(np.roots(np.r_[1.0, ma])).max()
        assert (
            not nf.timeseries.is_stable(ma * (1.5 / max(largest, 1e-3)) ** np.arange(1, ma.size + 1)) or largest < 1e-3
        )

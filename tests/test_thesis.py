"""The numbers of J. Ah-Chong, "Static error modeling of sensors applicable to ocean systems" (FAU, 2003), checked.

`appendix_a.json` holds the coefficients of its Appendix A, digit by digit as printed, signs of MATLAB's armax.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.signal import lfilter

import navfilter as nf
from navfilter.timeseries.fit import gauss_markov_correlation

TABLES = {t["name"]: t for t in json.loads((Path(__file__).parent / "appendix_a.json").read_text())["tables"]}

# Largest pole, largest zero, and whether |A(1)| vanishes within the printed digits.
ROOTS = {
    "Lab1 hdg AIC": (1.0000, 1.020, True),
    "Lab1 hdg WT": (0.9991, 0.9931, True),
    "Lab1 dhdg": (1.029, 0.9885, False),
    "Outdoor hdg AIC": (1.0000, 1.056, True),
    "Outdoor hdg WT": (1.0000, 1.155, True),
    "Outdoor dhdg AIC": (0.9818, 0.9846, False),
    "Outdoor dhdg WT": (0.9804, 0.9815, False),
    "Lab2 hdg AIC": (0.9999, 0.9893, True),
    "Lab2 hdg WT": (1.0000, 0.9906, True),
    "Lab2 dhdg AIC": (0.9985, 0.9898, False),
    "Lab2 dhdg WT": (1.483, 0.9883, False),
    "GPS lat AIC": (1.566, 0.957, False),
    "GPS lat WT": (1.204, 0.982, False),
    "GPS lon AIC": (1.0038, 0.978, True),
    "GPS lon WT": (0.9429, None, False),
    "X acc AIC": (0.9997, 0.9984, True),
    "X acc WT": (1.0000, 0.9833, True),
    "Y acc AIC": (1.0000, 0.9865, True),
    "Y acc WT": (1.113, 0.9956, False),
    "Z acc AIC": (1.0000, 1.0011, True),
    "Z acc WT": (1.0000, 1.276, True),
    "Yaw AIC": (1.0002, 0.9987, True),
    "Yaw WT": (0.9855, None, False),
    "Roll AIC": (1.0003, 0.994, True),
    "Roll WT": (1.0000, 0.995, True),
    "Pitch AIC": (1.0003, 0.998, True),
    "Pitch WT": (1.008, 0.9955, False),
}


def model_of(name):
    table = TABLES[name]
    return nf.ArmaModel(table["a"], table["b"], table["residual_sd_printed"] or 1.0)


def repaired(name, **replaced):
    """The model with single coefficients replaced, e.g. a1=-1.461."""
    a, b = list(TABLES[name]["a"]), list(TABLES[name]["b"])
    for key, value in replaced.items():
        (a if key[0] == "a" else b)[int(key[1:]) - 1] = value
    return nf.ArmaModel(a, b, 1.0)


def with_exact_unit_root(name):
    """A and C with the pole that the printed digits put next to 1 exactly there."""
    model = model_of(name)
    poles = model.poles.copy()
    i = int(np.argmin(np.abs(poles - 1.0)))
    if abs(poles[i] - 1.0) < 0.005:
        poles[i] = 1.0
    return np.real(np.poly(poles)), np.r_[1.0, model.ma]


# ------------------------------------------------------------------------------------- Appendix A, as printed


def test_every_table_is_listed():
    assert set(TABLES) == set(ROOTS)


@pytest.mark.parametrize("name", ROOTS)
def test_poles_and_zeros_of_the_printed_digits(name):
    pole, zero, unit_root = ROOTS[name]
    model = model_of(name)
    # Half a unit of the last digit in the list above.
    assert abs(model.poles[0]) == pytest.approx(pole, abs=5e-4)
    if zero is not None:
        assert abs(model.zeros[0]) == pytest.approx(zero, abs=5.1e-4)
    if abs(abs(model.poles[0]) - 1.0) > 1e-6:
        assert model.is_stable == bool(abs(model.poles[0]) < 1.0)
    # Three printed digits each: p + 1 roundings of up to 0.0005 (the largest seen is 0.002).
    assert (abs(1.0 + model.ar.sum()) < 0.0025) == unit_root


def test_sixteen_of_the_undifferenced_tables_hold_a_unit_root():
    undifferenced = [n for n, t in TABLES.items() if t["order_pdq"][1] == 0]
    assert len(undifferenced) == 22
    assert sum(ROOTS[n][2] for n in undifferenced) == 16


def test_strictly_positive_real_condition_fails_for_23_of_25():
    """Extended least squares needs |C(e^jw) - 1| < 1 at all frequencies."""
    w = np.exp(-1j * np.linspace(0.0, np.pi, 4001))
    models = [model_of(n) for n in TABLES if TABLES[n]["b"]]
    holds = [n for n in TABLES if TABLES[n]["b"] and np.all(np.abs(np.polyval([*TABLES[n]["b"][::-1], 0.0], w)) < 1.0)]
    assert len(models) == 25
    assert sorted(holds) == ["GPS lon AIC", "Y acc AIC"]


@pytest.mark.parametrize(
    ("name", "replaced", "pole", "zero"),
    [
        ("Lab1 dhdg", {"a6": -0.19}, 0.893, None),
        ("Lab1 dhdg", {"a4": 0.446}, 0.854, None),
        ("Outdoor hdg WT", {"b7": -0.416}, None, 0.996),
        ("Lab2 dhdg WT", {"a1": -1.461}, 0.987, None),
        ("Z acc WT", {"b4": -0.3033}, None, 0.997),
        ("GPS lat AIC", {"a2": 0.977}, 1.0, None),
        ("GPS lat AIC", {"a1": -1.644}, 1.0, None),
    ],
)
def test_one_changed_sign_or_digit_repairs_a_misprint(name, replaced, pole, zero):
    model = repaired(name, **replaced)
    if pole is not None:
        assert abs(model.poles[0]) == pytest.approx(pole, abs=1e-3)
    if zero is not None:
        assert abs(model.zeros[0]) == pytest.approx(zero, abs=1e-3)


def test_compass_case_4_is_a_comb_of_ten_samples():
    poles = model_of("Lab2 hdg AIC").poles
    for degrees in (72.0, 108.0, 144.0, 180.0):
        near = poles[np.argmin(np.abs(poles - 0.993 * np.exp(1j * np.radians(degrees))))]
        assert abs(near) == pytest.approx(0.993, abs=0.003)
        assert np.degrees(np.angle(near)) % 360.0 == pytest.approx(degrees, abs=1.0)


@pytest.mark.parametrize(
    ("name", "ratio", "digits"),
    [("X acc AIC", 0.0179, 5e-4), ("Y acc AIC", 0.0135, 5e-4), ("Yaw AIC", 0.0173, 5e-4), ("Roll AIC", 0.0060, 5e-4)],
)
def test_inertial_tables_are_random_walk_bias_plus_white_noise(name, ratio, digits):
    """The zero next to the unit root gives the walk: sigma_w = (1 - theta) sigma_e."""
    zeros = model_of(name).zeros
    real = zeros[np.abs(zeros.imag) < 1e-9].real
    theta = real[np.argmin(np.abs(real - (1.0 - ratio)))]
    walk = nf.timeseries.bias_plus_white(nf.ArmaModel([-1.0], [-theta], 1.0))
    assert walk.pole == 1.0
    assert walk.drive_sd == pytest.approx(ratio, abs=digits)
    assert (walk.drive_sd / walk.white_sd) ** 2 == pytest.approx((1.0 - theta) ** 2 / theta, rel=1e-9)


# ----------------------------------------------------------------- consistency of (p, q, sigma, AIC), tables 4.4-4.12

CONSISTENCY = {
    "Lab1 hdg AIC": -0.072,
    "Lab1 hdg WT": -0.251,
    "Outdoor hdg AIC": -0.0049,
    "Outdoor hdg WT": 0.0016,
    "Lab2 hdg AIC": -0.389,
    "Lab2 hdg WT": -0.829,
    "GPS lat AIC": 0.0039,
    "GPS lat WT": 0.0124,
    "GPS lon AIC": 0.0093,
    "GPS lon WT": 0.0121,
    "X acc AIC": -0.0006,
    "X acc WT": 0.0081,
    "Y acc AIC": 0.042,
    "Y acc WT": 0.046,
    "Z acc AIC": -0.0044,
    "Z acc WT": -0.0015,
    "Yaw AIC": 0.0023,
    "Yaw WT": 0.0023,
    "Roll AIC": 0.0024,
    "Roll WT": 0.0033,
    "Pitch AIC": -0.0092,
    "Pitch WT": -0.0092,
}


@pytest.mark.parametrize("name", CONSISTENCY)
def test_printed_aic_against_printed_sigma(name):
    """Printed is AIC/N = ln s^2 + 2(p+q)/N, not eq. 3.13."""
    t = TABLES[name]
    p, _, q = t["order_pdq"]
    gap = t["aic_printed"] - 2.0 * (p + q) / t["samples_assumed"] - 2.0 * math.log(t["residual_sd_printed"])
    assert gap == pytest.approx(CONSISTENCY[name], abs=6e-4)


def test_sixteen_rows_are_consistent_and_six_are_not():
    assert sum(t["residual_sd_printed"] is not None for t in TABLES.values()) == len(CONSISTENCY) == 22
    assert sum(abs(gap) <= 0.0124 for gap in CONSISTENCY.values()) == 16


# ---------------------------------------------------------------------------------- refits of simulated tables

REFIT = ["X acc AIC", "Y acc AIC", "GPS lon WT", "Roll AIC", "Pitch AIC"]


@pytest.mark.parametrize("name", [*REFIT, pytest.param("Yaw AIC", marks=pytest.mark.slow)])
def test_refit_reaches_the_innovation_variance(name):
    """Prediction error with filter memory: 1.00 even where a start from zero costs 2-4 % (roll, pitch)."""
    A, C = with_exact_unit_root(name)
    e = np.random.default_rng(1).standard_normal(14_400)
    fit = nf.fit_arma(lfilter(C, A, e), A.size - 1, C.size - 1, "prediction-error")
    # n coefficients explain n/N = 0.001 of the variance; local optima of cancelling pairs cost as much.
    assert np.sum(fit.residuals**2) / np.sum(e**2) == pytest.approx(1.0, abs=0.003)
    printed = TABLES[name]
    k = 2.0 * (fit.p + fit.q) / 14_400
    aic = math.log((fit.sd * printed["residual_sd_printed"]) ** 2) + k
    if abs(CONSISTENCY[name]) <= 0.0124:
        # Two sd of ln s^2 at N = 14 400, beside the table's own inconsistency.
        assert aic == pytest.approx(printed["aic_printed"], abs=2.0 * math.sqrt(2.0 / 14_400) + 0.0124)


@pytest.mark.parametrize(("name", "sd"), [("Y acc AIC", 0.044), ("GPS lon WT", 0.014)])
def test_the_two_identifiable_tables_give_their_coefficients_back(name, sd):
    A, C = with_exact_unit_root(name)
    y = lfilter(C, A, np.random.default_rng(2).standard_normal(14_400))
    fit = nf.fit_arma(y, A.size - 1, C.size - 1, "prediction-error")
    np.testing.assert_allclose(np.r_[fit.ar, fit.ma], np.r_[A[1:], C[1:]], atol=4.0 * sd)


def test_starting_the_filter_from_zero_inflates_the_cost_at_the_true_parameters():
    """Zeros at 0.994 next to the circle: a residual filter started at zero takes 1/(1 - 0.994) samples to recover."""
    A, C = with_exact_unit_root("Roll AIC")
    y = lfilter(C, A, np.random.default_rng(3).standard_normal(20_000))[5600:]
    from_zero = lfilter(A, C, y)
    fit = nf.fit_arma(y, 3, 3, "prediction-error")
    assert np.mean(from_zero**2) > 1.01 * np.mean(from_zero[3000:] ** 2)
    assert np.mean(fit.residuals**2) == pytest.approx(1.0, abs=0.03)


# --------------------------------------------------------------------------------------------- section 2.4.3


@pytest.mark.parametrize(
    ("ar", "ma", "r1", "r1_sd", "partial2", "partial2_sd"),
    [
        ([-0.8], [], 0.796, 0.019, -0.003, 0.032),
        ([], [-0.6], -0.440, 0.024, -0.243, 0.032),
        ([-0.8], [-0.6], 0.254, 0.037, 0.145, 0.031),
    ],
    ids=["AR", "MA", "ARMA"],
)
def test_simulated_examples(ar, ma, r1, r1_sd, partial2, partial2_sd):
    runs = [nf.simulate_arma(ar, ma, 1.0 / 6.0, 1000, seed) for seed in range(100)]
    first = [nf.acf(y, 1)[1] for y in runs]
    second = [nf.pacf(y, 2)[2] for y in runs]
    # Means over 100 runs: a tenth of the scatter of one; 4 of those.
    assert np.mean(first) == pytest.approx(r1, abs=0.4 * r1_sd)
    assert np.mean(second) == pytest.approx(partial2, abs=0.4 * partial2_sd)
    assert np.std(first) == pytest.approx(r1_sd, rel=0.35)
    theory = nf.ArmaModel(ar, ma, 1.0).autocovariance(1)
    assert np.mean(first) == pytest.approx(theory[1] / theory[0], abs=0.4 * r1_sd)


# ---------------------------------------------------------------------------------------- corrected equations


def test_eq_2_33_autocorrelation_is_the_mean_of_a_product():
    x = np.random.default_rng(4).standard_normal(5000)
    x -= x.mean()
    assert nf.acf(x, 1)[1] == pytest.approx(np.sum(x[1:] * x[:-1]) / np.sum(x**2))


def test_eq_2_36_quantisation_noise():
    step = 0.5
    x = np.random.default_rng(5).normal(size=200_000) * 10.0
    assert np.std(np.round(x / step) * step - x) == pytest.approx(step * math.sqrt(1.0 / 12.0), rel=0.005)
    assert math.sqrt(1.0 / 12.0) == pytest.approx(0.28868, abs=1e-5)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_eq_2_41_and_2_42_order_n_gauss_markov_autocorrelation(order):
    """(d/dt + beta)^n with binomial coefficients; its state-space covariance equals 2.42 with Gamma(n+k) put back."""
    beta = 0.7
    F = np.eye(order, k=1)
    F[-1] = [-math.comb(order, k) * beta ** (order - k) for k in range(order)]
    noise = np.zeros((order, order))
    noise[-1, -1] = 1.0
    P = solve_continuous_lyapunov(F, -noise)
    for tau in (0.0, 0.3, 1.0, 4.0):
        expected = (expm(F * tau) @ P)[0, 0] / P[0, 0]
        assert gauss_markov_correlation(order, beta * tau) == pytest.approx(expected, abs=1e-6)
    printed_at_zero = math.gamma(order) / (math.factorial(2 * order - 2) * math.factorial(order - 1))
    assert printed_at_zero == pytest.approx([1.0, 0.5, 1.0 / 24.0, 1.0 / 720.0][order - 1])


def test_after_eq_2_42_products_of_beta_and_tau():
    products = [nf.timeseries.correlation_product(n) for n in (1, 2, 3, 4)]
    np.testing.assert_allclose(products, [1.0, 2.1462, 2.9046, 3.5126], atol=5e-5)


def test_eq_3_5_one_innovation_drives_both_parts():
    """The difference equation with the signs of 3.1 equals lfilter."""
    e = np.random.default_rng(6).standard_normal(50)
    u = np.zeros(50)
    for n in range(50):
        u[n] = 0.8 * (u[n - 1] if n else 0.0) + e[n] - 0.6 * (e[n - 1] if n else 0.0)
    np.testing.assert_allclose(u, lfilter([1.0, -0.6], [1.0, -0.8], e))
    np.testing.assert_allclose(lfilter([1.0, -0.8], [1.0, -0.6], u), e, atol=1e-12)


def test_eq_3_13_aic_is_minus_two_log_likelihood_plus_two_k():
    y = nf.simulate_arma([-0.8], [], 2.0, 5000, seed=7)
    fit = nf.fit_arma(y, 1, 0, trend="none")
    thesis = math.log(fit.sd**2) + 2.0 * 1 / 5000
    # The likelihood adds the constant 1 + ln 2 pi, and counts sigma; the determinant term is O(1/N).
    assert fit.aic / 5000 - (1.0 + math.log(2.0 * math.pi)) - 2.0 / 5000 == pytest.approx(thesis, abs=3e-4)


def test_eq_3_17_white_noise_scores_3_855():
    fraction, _ = quad(lambda x: math.erfc(1.96 / math.sqrt(2.0 * (1.0 - x))), 0.0, 1.0)
    assert fraction == pytest.approx(0.01297, abs=1e-5)
    assert 0.05 / fraction == pytest.approx(3.855, abs=1e-3)


def test_eq_4_2_standard_error_of_a_ratio():
    """sqrt(sx^2 + sy^2)/s is the sd of hypot-like sums over s; the printed root covers s as well."""
    random = np.random.default_rng(8)
    x, y = 0.3 * random.standard_normal(100_000), 0.4 * random.standard_normal(100_000)
    assert np.std((x + y) / 2.0) == pytest.approx(math.sqrt(0.3**2 + 0.4**2) / 2.0, rel=0.01)
    assert np.std((x + y) / 2.0) != pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2.0), rel=0.2)


def test_eq_4_3_printed_signs_are_unstable():
    beta = 1.0
    printed, correct = np.roots([1.0, 2.0 * beta, -(beta**2)]), np.roots([1.0, 2.0 * beta, beta**2])
    np.testing.assert_allclose(sorted(printed), [-2.414, 0.414], atol=1e-3)
    np.testing.assert_allclose(correct, [-1.0, -1.0], atol=1e-7)


def test_eq_4_8_to_4_11_discrete_poles():
    step = 0.05
    printed = np.roots([1.0 + 2.0 * step - step**2, -(2.0 + 2.0 * step), 1.0])
    backward = np.roots([1.0, -2.0 / (1.0 + step), 1.0 / (1.0 + step) ** 2])
    exact = nf.timeseries.gauss_markov_arma(2, 1.0, step, 1.0)
    assert np.abs(printed).max() == pytest.approx(1.021, abs=5e-4)
    assert np.abs(printed).min() == pytest.approx(0.892, abs=5e-4)
    np.testing.assert_allclose(np.abs(backward), 1.0 / 1.05, atol=1e-6)
    np.testing.assert_allclose(exact.ar, [-2.0 * math.exp(-step), math.exp(-2.0 * step)], atol=1e-12)


@pytest.mark.parametrize(("step", "c1"), [(1e-5, 2.0 - math.sqrt(3.0)), (0.2, 0.2667), (1.0, 0.239)])
def test_eq_4_10_sampled_second_order_process_is_arma_2_1(step, c1):
    assert nf.timeseries.gauss_markov_arma(2, 1.0, step, 1.0).ma[0] == pytest.approx(c1, abs=5e-4)


def test_second_order_state_space_is_exact():
    """Phi and P of the text below eq. 4.12's correction, against the matrix exponential."""
    b, D = 0.3, 0.7
    F = np.array([[0.0, 1.0], [-b * b, -2.0 * b]])
    Phi = math.exp(-b * D) * np.array([[1.0 + b * D, D], [-b * b * D, 1.0 - b * D]])
    np.testing.assert_allclose(expm(F * D), Phi, atol=1e-12)
    np.testing.assert_allclose(
        solve_continuous_lyapunov(F, -np.diag([0.0, 4.0 * b**3])), np.diag([1.0, b * b]), atol=1e-9
    )


def test_section_4_3_1_units():
    """A ten-thousandth of a minute of arc is 0.185 m on the ground, not 3 mm; 2.37 minutes would be 4.4 km."""
    metres_per_minute = 1852.0
    assert 1e-4 * metres_per_minute == pytest.approx(0.185, abs=1e-3)
    assert 1e-4 / 60.0 * metres_per_minute == pytest.approx(3.1e-3, abs=1e-4)
    assert 2.37 * metres_per_minute == pytest.approx(4.4e3, abs=50.0)

"""Error models: autocovariance against closed forms and statsmodels, stationarity of the blocks, sums, and refusals."""

import math

import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from scipy.optimize import brentq
from statsmodels.tsa.arima_process import ArmaProcess

import navfilter as nf
from navfilter.filter.state_layout import Layout
from navfilter.models.error_models import CORRELATION_CONSTANTS, per_axis
from navfilter.models.error_models import gauss_markov as discretised
from navfilter.simulation.simulate import draw_error


def autocovariance(block, lags):
    """C Phi^k P0 C' for k = 0 .. lags-1, with the white part at lag 0."""
    x, result = block.P0 @ block.C, []
    for k in range(lags):
        result.append(block.C @ x + (block.r if k == 0 else 0.0))
        x = block.Phi @ x
    return np.array(result)


def gauss_markov(order, beta, t):
    """Autocorrelation of an order-n Gauss-Markov process: thesis eq 2.42 with the factor Gamma(n + k) that the print
    lost.
    """
    n, b = order, beta * np.abs(t)
    terms = [
        math.gamma(n)
        * math.gamma(n + k)
        * (2.0 * b) ** (n - k - 1)
        / (math.factorial(2 * n - 2) * math.factorial(k) * math.gamma(n - k))
        for k in range(n)
    ]
    return np.exp(-b) * sum(terms)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("period_s", [0.01, 1.0, 40.0])
def test_gauss_markov_has_the_autocovariance_of_the_thesis(order, period_s):
    model = nf.GaussMarkov(sd=0.6, tau_s=30.0, order=order)
    lags = np.arange(60)
    expected = 0.36 * gauss_markov(order, model.beta, lags * period_s)
    # Van Loan's matrix exponential (orders 3, 4) and Phi^60 round at 1e-13.
    np.testing.assert_allclose(autocovariance(model.block(period_s), 60), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_gauss_markov_falls_to_one_over_e_at_tau(order):
    assert gauss_markov(order, nf.GaussMarkov(sd=1.0, tau_s=7.0, order=order).beta, 7.0) == pytest.approx(
        math.exp(-1.0), abs=1e-6
    )
    root = brentq(lambda c: gauss_markov(order, c, 1.0) - math.exp(-1.0), 0.1, 10.0, xtol=1e-12)
    assert CORRELATION_CONSTANTS[order] == pytest.approx(root, abs=1e-6)
    block = nf.GaussMarkov(sd=2.0, tau_s=7.0, order=order).block(7.0)
    assert autocovariance(block, 2)[1] == pytest.approx(4.0 * math.exp(-1.0), abs=1e-5)


SLOW = nf.GaussMarkov(sd=1.0, tau_s=30.0)
ARMAS = [
    ((), (), 0.3),
    ((-0.8,), (), 0.6),
    ((), (0.5, -0.2, 0.1), 1.0),
    ((-1.6, 0.7), (0.4, 0.1), 0.4),
    ((-0.5, 0.2, 0.1, -0.3), (0.9,), 2.0),
]


@pytest.mark.parametrize(("ar", "ma", "sd"), ARMAS)
def test_arma_has_the_autocovariance_of_statsmodels(ar, ma, sd):
    block = nf.Arma(ar=ar, ma=ma, sd=sd).block(0.25)
    assert block.size == max(len(ar), len(ma) + 1)
    expected = ArmaProcess([1.0, *ar], [1.0, *ma]).acovf(30) * sd**2
    # statsmodels solves for the first lags and recurses: both round at 1e-14 of the variance, times the conditioning of
    # a pole at 0.8
    np.testing.assert_allclose(autocovariance(block, 30), expected, rtol=0, atol=1e-11 * expected[0])


STATIONARY = [nf.GaussMarkov(sd=0.6, tau_s=30.0, order=n) for n in (1, 2, 3, 4)] + [
    nf.Arma(ar=ar, ma=ma, sd=sd) for ar, ma, sd in ARMAS
]
STATIONARY += [nf.Cycle(sd=0.6, period_s=12.0, tau_s=40.0)]
STATIONARY += [nf.GaussMarkov(sd=0.6, tau_s=30.0, order=2) + nf.White(sd=0.1) + nf.Arma(ar=(-0.9,), sd=0.2)]


@pytest.mark.parametrize("model", STATIONARY, ids=str)
@pytest.mark.parametrize("period_s", [0.01, 5.0])
def test_stationary_blocks_start_stationary(model, period_s):
    block = model.block(period_s)
    np.testing.assert_allclose(
        block.Phi @ block.P0 @ block.Phi.T + block.Q, block.P0, rtol=0, atol=1e-12 * np.abs(block.P0).max()
    )
    for M in (block.Q, block.P0):
        np.testing.assert_array_equal(M, M.T)
        assert np.linalg.eigvalsh(M).min() > -1e-14 * max(1e-300, np.abs(M).max())
        assert M.flags.c_contiguous and M.dtype == np.float64
    assert block.Phi.flags.c_contiguous and block.C.shape == (block.size,)


def test_a_cycle_swings_at_any_rate():
    model = nf.Cycle(sd=0.6, period_s=12.0, tau_s=40.0)
    for period_s in (0.5, 5.0):
        lags = period_s * np.arange(30)
        expected = 0.36 * np.exp(-lags / 40.0) * np.cos(2.0 * np.pi * lags / 12.0)
        np.testing.assert_allclose(autocovariance(model.block(period_s), 30), expected, rtol=0, atol=1e-14)


def test_white_and_random_walk():
    assert nf.White(sd=0.5).block(0.1).r == 0.25
    assert nf.White(density=0.01).block(0.01).r == pytest.approx(0.01**2 * 100.0)
    assert nf.White(sd=0.5).block(0.1).size == 0
    walk = nf.RandomWalk(density=0.2, start_sd=3.0).block(0.5)
    assert (walk.Phi[0, 0], walk.P0[0, 0], walk.C[0], walk.r) == (1.0, 9.0, 1.0, 0.0)
    assert walk.Q[0, 0] == pytest.approx(0.04 * 0.5)
    # the same walk at any rate: what 100 s gather does not depend on the period
    assert 200 * nf.RandomWalk(density=0.2).block(0.5).Q[0, 0] == pytest.approx(
        1000 * nf.RandomWalk(density=0.2).block(0.1).Q[0, 0]
    )
    assert nf.RandomWalk(density=0.2).block(1.0).P0[0, 0] == pytest.approx((0.2 * 60.0) ** 2)


def test_a_sum_is_the_sum():
    parts = nf.White(sd=0.1), nf.GaussMarkov(sd=0.6, tau_s=30.0, order=2), nf.Arma(ar=(-0.9,), sd=0.2), nf.White(sd=0.2)
    total = parts[0] + parts[1] + parts[2] + parts[3]
    assert total.parts == parts and (parts[0] + (parts[1] + parts[2])).parts == parts[:3]
    block = total.block(0.5)
    assert block.size == 3 and block.r == pytest.approx(0.05)
    np.testing.assert_allclose(
        autocovariance(block, 20), sum(autocovariance(part.block(0.5), 20) for part in parts), atol=1e-14
    )
    assert total == nf.White(sd=0.1) + parts[1] + parts[2] + nf.White(sd=0.2) and hash(total) is not None
    assert str(total).count(" + ") == 3
    with pytest.raises(TypeError):
        nf.White(sd=0.1) + 0.1


@pytest.mark.parametrize(
    "model", [nf.GaussMarkov(sd=0.6, tau_s=2.0, order=2) + nf.White(sd=0.3), nf.Arma(ar=(-1.2, 0.5), ma=(0.4,), sd=0.3)]
)
def test_simulated_errors_have_the_autocovariance(model):
    n, lags = 200_000, 6
    x = draw_error(model, 0.5, n, 0, "test")
    sample = np.array([x[: n - k] @ x[k:] / n for k in range(lags)])
    expected = autocovariance(model.block(0.5), lags)
    # Bartlett: variance of a sample autocovariance is at most 2 sum R^2 / n
    full = autocovariance(model.block(0.5), 400)
    sd = math.sqrt(2.0 * (full[0] ** 2 + 2.0 * np.sum(full[1:] ** 2)) / n)
    np.testing.assert_allclose(sample, expected, rtol=0, atol=4.0 * sd)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: nf.White(), "exactly one of sd and density"),
        (lambda: nf.White(sd=1.0, density=1.0), "exactly one of sd and density"),
        (lambda: nf.White(sd=-1.0), r"White\.sd must be a finite number >= 0, found -1\.0"),
        (lambda: nf.White(density=math.nan), r"White\.density"),
        (lambda: nf.RandomWalk(density=math.inf), r"RandomWalk\.density"),
        (lambda: nf.RandomWalk(density=1.0, start_sd=-1.0), r"RandomWalk\.start_sd"),
        (lambda: nf.GaussMarkov(sd=1.0, tau_s=0.0), r"GaussMarkov\.tau_s must be a finite number > 0"),
        (lambda: nf.Cycle(sd=1.0, period_s=0.0, tau_s=1.0), r"Cycle\.period_s must be a finite number > 0"),
        (lambda: nf.Cycle(sd=-1.0, period_s=1.0, tau_s=1.0), r"Cycle\.sd must be a finite number >= 0"),
        (lambda: nf.GaussMarkov(sd=1.0, tau_s=1.0, order=5), "order must be 1, 2, 3 or 4, found 5"),
        (lambda: nf.Arma(ar=(-1.0,), sd=1.0), "pole of radius 1.000000.*RandomWalk"),
        (lambda: nf.Arma(ar=(-2.0, 1.5), sd=1.0), "pole of radius 1.2"),
        (lambda: nf.Arma(ar=(math.nan,), sd=1.0), "ar must be finite"),
        (lambda: nf.Arma(ar=(), ma=(math.inf,), sd=1.0), "ma must be finite"),
        (lambda: nf.Arma(ar=(), sd=-0.1), r"Arma\.sd"),
        (
            lambda: per_axis((nf.White(sd=1.0),) * 2, 3, "dvl.error"),
            r"dvl\.error needs one error model, or a tuple of 3",
        ),
        (lambda: per_axis(0.1, 3, "dvl.error"), "found 0.1"),
        (lambda: nf.LearnedArma(prior=SLOW, prior_within=2.0), r"prior_within must be two factors.*found 2\.0"),
        (lambda: nf.LearnedArma(prior=SLOW, prior_within=(2.0, 1.0)), r"at least 1\.1.*found \(2\.0, 1\.0\)"),
        (lambda: nf.LearnedArma(prior=SLOW, prior_within=(2.0, math.nan)), "found .2.0, nan."),
        (lambda: nf.LearnedArma(prior_within=(2.0, 3.0)), "the prior has none, found None"),
        (lambda: nf.LearnedArma(prior=nf.White(sd=1.0), prior_within=(2.0, 3.0)), "the prior has none, found White"),
    ],
)
def test_wrong_models_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


# ---------------------------------------------------------------- layout: where the blocks stand
def test_layout_stacks_blocks_parameters_and_names():
    vehicle = nf.Vehicle(
        imu=nf.Imu(
            rate_hz=100.0,
            gyro=nf.RandomWalk(density=1e-6),
            accel=(nf.White(sd=0.1), nf.GaussMarkov(sd=0.1, tau_s=1.0, order=2), nf.White(sd=0.1)),
        ),
        sensors={
            "depth": nf.Depth(error=nf.White(sd=0.1)),
            "dvl": nf.BodyVelocity(
                rate_hz=4.0, error=nf.Arma(ar=(-0.8,), ma=(0.2, 0.1), sd=0.1), scale_sd=0.01, misalignment_sd_rad=0.02
            ),
        },
    )
    layout = Layout.of(vehicle)
    assert layout.head == 9 + 3 + 2 and layout.size == layout.head + 9 + 4
    assert len(layout.names) == layout.size - 9 == len(set(layout.names))
    assert layout.names[:5] == ("gyro_x[0]", "gyro_y[0]", "gyro_z[0]", "accel_y[0]", "accel_y[1]")
    assert layout.names[-4:] == ("dvl.scale", "dvl.misalignment_x", "dvl.misalignment_y", "dvl.misalignment_z")
    assert layout.groups["depth"].size == 0 and layout.groups["depth"].r[0] == pytest.approx(0.01)
    dvl = layout.groups["dvl"]
    assert dvl.slice == slice(14, 27) and dvl.errors == 9
    np.testing.assert_array_equal(dvl.C, np.kron(np.eye(3), [1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(dvl.Phi[9:, 9:], np.eye(4))
    np.testing.assert_array_equal(dvl.Q[9:], 0.0)
    P = layout.start_covariance(np.eye(9))
    np.testing.assert_allclose(np.diag(P)[-4:], [1e-4, 4e-4, 4e-4, 4e-4])
    assert np.array_equal(P, P.T) and np.linalg.eigvalsh(P).min() >= -1e-15


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("periods", [1e-3, 0.3, 1.0, 3.0, 10.0, 100.0, 1e9])
def test_gauss_markov_stays_stationary_at_any_period(order, periods):
    """Found by fuzzing: with 10 correlation times between two readings, Van Loan's Q lost all its digits, with 100 all
    was NaN.
    """
    block = nf.GaussMarkov(sd=2.0, tau_s=5.0, order=order).block(5.0 * periods)
    assert np.abs(np.linalg.eigvals(block.Phi)).max() < 1.0
    # Q of order 4 at a thousandth of tau is 1e-20 of P0: rounding of P0 may show as a negative eigenvalue of that size.
    assert np.linalg.eigvalsh(block.Q).min() > -1e-15 * np.trace(block.P0)
    np.testing.assert_allclose(block.Phi @ block.P0 @ block.Phi.T + block.Q, block.P0, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (nf.White(sd=0.2), (0.04, 0.0, 0.0)),
        (nf.White(density=0.2), (0.04 / 0.5, 0.0, 0.0)),
        (nf.RandomWalk(density=0.2, start_sd=0.3), (0.0, 0.04 * 0.5, 0.09)),
        (nf.Arma(ar=(-0.8,), sd=0.1), (0.01 / 0.2**2, 0.0, 0.0)),
        (nf.LearnedArma(prior=nf.White(sd=0.2)), (0.04, 0.0, 0.0)),
        # stated as the bias of an instrument: its beginning is a walk
        (nf.GaussMarkov(sd=2.0, tau_s=100.0), (0.0, 4.0 * -math.expm1(-0.01), 4.0)),
    ],
)
def test_what_each_model_adds_to_an_integral(model, expected):
    """White noise, walk and start of its bias, as variances per sample, at 2 Hz."""
    assert model.integrated(0.5) == pytest.approx(expected, rel=1e-12, abs=1e-15)
    twice = (model + model).integrated(0.5)
    assert twice == pytest.approx([2.0 * part for part in expected], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("step", [1e-9, 1e-3, 0.3, 0.999, 1.001, 1.9])
def test_the_second_order_is_van_loans(step):
    """Which has no digits of the smallest element where the step is short, and holds exp(step) where it is long."""
    Phi, Q, _ = discretised(2, 1.3, step)
    theirs = van_loan_discretization(np.array([[0.0, 1.0], [-1.0, -2.0]]), np.array([[0.0], [2.6]]), step)
    np.testing.assert_allclose(Phi, theirs[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(Q, theirs[1], rtol=0, atol=1e-13 * Q[1, 1])
    # the beginning of the series of the first element: 4 variance step^3 / 3
    assert Q[0, 0] == pytest.approx(4.0 * 1.69 * step**3 / 3.0, rel=2.0 * step)

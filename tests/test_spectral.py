"""Spectral factorisation where it is hard: multiple zeros on the unit circle."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.timeseries import model as polynomials


def autocovariance(c):
    return np.array([c[: c.size - k] @ c[k:] for k in range(c.size)])


def polynomial(zeros, lead=1.0):
    return lead * np.atleast_1d(np.poly(zeros)).real


def pair(w, radius=1.0):
    return [radius * np.exp(1j * w), radius * np.exp(-1j * w)]


ON_CIRCLE = {"1": [1.0], "-1": [-1.0], "slow pair": pair(0.1), "pair": pair(1.0), "fast pair": pair(3.0)}
INSIDE = {"alone": [], "slow": [0.95], "pair inside": [*pair(1.1, 0.9), -0.3]}


@pytest.mark.parametrize("inside", INSIDE)
@pytest.mark.parametrize("multiplicity", [1, 2, 3, 4])
@pytest.mark.parametrize("zeros", ON_CIRCLE)
def test_multiple_zeros_on_the_circle_are_reproduced(zeros, multiplicity, inside):
    gamma = autocovariance(polynomial([*ON_CIRCLE[zeros] * multiplicity, *INSIDE[inside]], 0.3))
    ma, sd = nf.timeseries.spectral_factor(gamma)
    # The factor's own coefficients lose digits with the multiplicity, what they stand for does not.
    np.testing.assert_allclose(autocovariance(sd * np.r_[1.0, ma]), gamma, atol=1e-9 * gamma[0])
    assert sd == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize(
    "zeros",
    [[1.0] * 3 + [-1.0] * 3, [1.0] * 4 + [-1.0] * 4, [1.0, 1.0, -1.0] + pair(0.5) * 2, pair(0.7) * 3 + pair(2.0) * 3],
)
def test_several_multiple_zeros_at_once(zeros):
    gamma = autocovariance(polynomial(zeros))
    ma, sd = nf.timeseries.spectral_factor(gamma)
    np.testing.assert_allclose(autocovariance(sd * np.r_[1.0, ma]), gamma, atol=1e-9 * gamma[0])


@pytest.mark.parametrize("multiplicity", [2, 3, 4])
def test_integer_coefficients_come_back(multiplicity):
    c = polynomial([1.0] * multiplicity)
    ma, sd = nf.timeseries.spectral_factor(autocovariance(c))
    np.testing.assert_allclose(ma, c[1:], atol=1e-12)
    assert sd == pytest.approx(1.0, rel=1e-12)


def test_where_newton_converges_its_result_is_handed_out():
    """Simple zeros away from the circle need nothing else: not a bit may change."""
    rng = np.random.default_rng(4)
    for _ in range(100):
        gamma = autocovariance(
            polynomial([*rng.uniform(-0.99, 0.99, 2), *pair(rng.uniform(0.0, np.pi), rng.uniform(0.1, 0.99))])
        )
        alone = polynomials._newton(gamma / gamma[0])
        ma, sd = nf.timeseries.spectral_factor(gamma)
        np.testing.assert_array_equal(ma, alone[1:] / alone[0])
        assert sd == alone[0] * np.sqrt(gamma[0])


@pytest.mark.parametrize("gamma", [[1.0, -0.5 - 1e-3], [2.0, 0.0, 1.1], [20.0, -15.0, 6.0, -1.001], [1.0, 0.9, 0.5]])
def test_a_spectrum_below_zero_is_refused(gamma):
    with pytest.raises(ValueError, match="not an autocovariance"):
        nf.timeseries.spectral_factor(gamma)

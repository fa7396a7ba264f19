"""What a navigator holds inside: tests that must look there do it here, so that they know no private name."""

from __future__ import annotations

from typing import Any

import numpy as np

from navfilter.navigator import Navigator

Array = np.ndarray


def arrays(nav: Navigator) -> dict[str, Array]:
    """All arrays that the next sample or reading is computed from; not copies."""
    return {
        "nominal": nav._nav,
        "errors": nav._x,
        "covariance": nav._P,
        "transition": nav._acc,
        "drive": nav._drv,
        "fed back": nav._undone,
    }


def nominal(nav: Navigator) -> Array:
    """The nominal state as the kernels have it."""
    return nav._nav


def errors(nav: Navigator) -> Array:
    """Estimates of the error states beyond the navigation state, shape (n - 9,)."""
    return nav._x


def covariance(nav: Navigator) -> Array:
    """Covariance of the whole error state, shape (n, n)."""
    return nav._P


def drive_models(nav: Navigator) -> Any:
    """Error models of the drive that are in force, by axis."""
    return nav._in_force.drive.models


def rest(nav: Navigator) -> Any:
    """What gathers and learns the samples at rest; None where no axis of the drive is learnt."""
    return nav._still


def beginning(nav: Navigator) -> Any:
    """What is kept to run the beginning again; None when it is done or nothing is learnt."""
    return nav._early


def tape(nav: Navigator) -> Any:
    """The tape that the navigator writes."""
    return nav._tape


def assert_same_bits(one: Navigator, two: Navigator) -> None:
    """Whatever comes next, both give the same."""
    assert two.time_s == one.time_s and two.counts == one.counts
    for (name, first), second in zip(arrays(one).items(), arrays(two).values(), strict=True):
        np.testing.assert_array_equal(second, first, err_msg=name)
    assert drive_models(two) == drive_models(one)


def assert_same_estimate(one: Navigator, two: Navigator, atol: float = 1e-9) -> None:
    """Nominal state, errors and covariance agree but for rounding."""
    np.testing.assert_allclose(nominal(two), nominal(one), rtol=0, atol=atol)
    np.testing.assert_allclose(errors(two), errors(one), rtol=0, atol=atol)
    np.testing.assert_allclose(covariance(two), covariance(one), rtol=atol, atol=atol)

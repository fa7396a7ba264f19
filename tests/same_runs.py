"""When two runs are the same: to the bit, whatever comes next, or but for rounding."""

from __future__ import annotations

import numpy as np
from state_differences import differences

from navfilter.navigation.navigator import Navigator


def assert_same_bits(one: Navigator, two: Navigator) -> None:
    """Whatever comes next, both give the same."""
    assert differences(one.filter.memory, two.filter.memory) == []
    assert differences(one.alternative.memory, two.alternative.memory) == []
    assert differences(one.alternative.subset.memory, two.alternative.subset.memory) == []
    np.testing.assert_array_equal(two.learning.memory.fed_back, one.learning.memory.fed_back)


def assert_same_estimate(one: Navigator, two: Navigator, atol: float = 1e-9) -> None:
    """Nominal state, errors and covariance agree but for rounding."""
    np.testing.assert_allclose(two.filter.nav, one.filter.nav, rtol=0, atol=atol)
    np.testing.assert_allclose(two.filter.x, one.filter.x, rtol=0, atol=atol)
    np.testing.assert_allclose(two.filter.P, one.filter.P, rtol=atol, atol=atol)

"""Clocks that are seconds to minutes apart are found, and where there is none nothing is."""

import numpy as np
import pytest

from navfilter.check.course import LEAST_S, far_finding, late_by
from navfilter.check.course import MOST_OFFSET_S as MOST_S

T = np.arange(0.0, 900.0, 0.1)
TURNED = np.cumsum(np.random.default_rng(5).normal(size=T.size)) * 0.01
NOISE = 0.001 * np.random.default_rng(6).normal(size=T.size)


@pytest.mark.parametrize("late_s", [18.0, -18.0, 37.3, 4.0, 100.0])
@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_a_clock_that_is_off_is_found_to_a_tenth(late_s, scale):
    assert late_by((T, TURNED), (T + late_s, scale * TURNED + NOISE), 2.0) == pytest.approx(late_s, abs=0.1)


@pytest.mark.parametrize("late_s", [0.0, 1.0, -LEAST_S, MOST_S + 20.0])
def test_none_is_found_where_there_is_none_or_one_beyond_all(late_s):
    assert late_by((T, TURNED), (T + late_s, TURNED + NOISE), 2.0) is None


def test_what_goes_the_other_way_or_something_else_is_no_clock():
    other = np.cumsum(np.random.default_rng(7).normal(size=T.size)) * 0.01
    swing = np.sin(0.4 * T)  # comes back after 15.7 s, and half of it later as its opposite
    for series in (other, np.zeros(T.size)):
        assert late_by((T, TURNED), (T, series), 2.0) is None
    assert late_by((T, swing), (T, swing + NOISE), 2.0) is None and late_by((T, swing), (T, -swing), 2.0) is None


@pytest.mark.parametrize("beside_s", [899.0, 3600.0])
def test_series_that_hardly_or_never_meet_say_nothing(beside_s):
    assert late_by((T, TURNED), (T + beside_s, TURNED), 2.0) is None


def test_clocks_that_people_mix_up_are_named():
    (gps,) = far_finding("gps", "it is {} against the others.", -18.1)
    assert gps.text == "it is 18.1 s early against the others." and "GPS time is 18 s ahead of UTC" in gps.cure
    assert "time.offset_s = 18.1" in gps.cure and gps.severity == "error"
    (any_clock,) = far_finding("gps", "it is {} against the others.", 25.0)
    assert "ahead of" not in any_clock.cure and "time.offset_s = -25.0" in any_clock.cure

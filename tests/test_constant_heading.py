"""A direction that is surely off by more than its description allows makes a track wrong, whatever it is off by."""

import mistakes_library as library
import numpy as np
import pytest


@pytest.mark.parametrize(
    ("name", "spoil", "code"),
    [
        ("compass", lambda value: value + np.radians(7.4), 1),
        ("compass", lambda value: value - np.radians(4.0), 1),
        ("dvl", library.turned(7.4), 1),
        ("compass", lambda value: value + np.radians(0.4), 0),
    ],
    ids=["compass", "other-side", "dvl", "little"],
)
def test_a_constant_error_of_the_heading(name, spoil, code):
    told = library.told(*library.values(name, spoil)(*library.sound()))
    assert told.code == code
    assert (code == 0) == told.verdict.headline.startswith("Nothing speaks against"), str(told.verdict)

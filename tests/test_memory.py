"""State as values: copied, compared, stored and brought back by one set of functions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
from state_differences import differences

import navfilter as nf
from navfilter.foundation.state_values import copied, from_arrays, misfit, to_arrays
from navfilter.models.error_models import ErrorModel


@dataclass
class Part:
    """What a part remembers."""

    SHARED: ClassVar = ("ring",)

    ring: np.ndarray
    cursor: int
    x: np.ndarray
    name: str | None = None
    by_name: dict[str, float] = field(default_factory=dict)
    model: ErrorModel | tuple[ErrorModel, ...] | None = None


def part() -> Part:
    model = (
        nf.White(sd=0.1) + nf.GaussMarkov(sd=2.0, tau_s=30.0),
        nf.LearnedArma(model=nf.ArmaModel([-0.5], [0.2], 0.3)),
    )
    return Part(
        np.arange(6.0).reshape(2, 3), 4, np.array([1.0, math.nan]), None, {"a": math.inf, "b": 0.1 + 0.2}, model
    )


def test_a_copy_shares_nothing_but_what_cannot_change_and_what_is_append_only():
    one = part()
    two = copied(one)
    assert differences(one, two) == []
    assert two.ring is one.ring and two.model is one.model and two.x is not one.x and two.by_name is not one.by_name
    two.x[0], two.by_name["a"], two.cursor = 9.0, 1.0, 5
    assert one.x[0] == 1.0 and one.by_name["a"] == math.inf and one.cursor == 4
    assert [text.split(":")[0] for text in differences(one, two)] == [".cursor", ".x", ".by_name['a']"]


def test_arrays_bring_back_every_bit():
    one = part()
    two = from_arrays(to_arrays(one), [Part, ErrorModel, nf.ArmaModel])
    assert differences(one, two) == [] and two.by_name["b"] == one.by_name["b"]
    np.testing.assert_array_equal(np.signbit(two.x), np.signbit(one.x))


def test_integers_stay_integers():
    back = from_arrays(to_arrays({"cursor": np.array([2**60], np.int64), 3: (1, 2.0, True, b"\x00\xff")}), [])
    assert back["cursor"].dtype == np.int64 and back["cursor"][0] == 2**60 and back[3] == (1, 2.0, True, b"\x00\xff")


def test_unknown_classes_are_refused():
    with pytest.raises(ValueError, match='"Part"'):
        from_arrays(to_arrays(part()), [ErrorModel])
    with pytest.raises(ValueError, match="complex cannot be stored"):
        to_arrays({"z": 1j})


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"x": np.zeros(3)}, "state.x must be an array of shape"),
        ({"x": np.zeros(2, np.int64)}, "state.x must be an array of shape"),
        ({"x": None}, "state.x must be an array of shape"),
        ({"ring": np.zeros((3, 2))}, "state.ring"),
        ({"cursor": "four"}, "state.cursor must be a number"),
        ({"cursor": 4.5}, "state.cursor must be a number"),
    ],
)
def test_a_value_of_another_form_is_named(change, where):
    like, wrong = part(), part()
    assert misfit(wrong, like) is None
    for name, value in change.items():
        setattr(wrong, name, value)
    assert where in (misfit(wrong, like) or "")

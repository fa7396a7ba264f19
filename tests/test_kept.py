"""Inputs of the beginning in few pieces: what comes out is what was put in, whatever went back or shares them."""

import gc

import numpy as np
import pytest

from navfilter.filter.events import Measurement
from navfilter.filter.imu_intake import joined
from navfilter.filter.input_buffer import PIECE, InputBuffer, Rows
from navfilter.foundation.state_values import from_arrays, to_arrays

NAMES = ("compass", "dvl", "gps")


def some(n, seed=0, samples=40):
    """Samples and readings, as a vehicle gives them."""
    rng, items = np.random.default_rng(seed), []
    for k in range(n):
        if rng.random() < 0.7:
            items.append(rng.normal(size=(int(rng.integers(1, samples)), 7)))
        else:
            i = int(rng.integers(3))
            sd = [None, 0.5, np.array([1.0, 2.0, 3.0])][int(rng.integers(3))]
            items.append(Measurement(NAMES[i], float(k), rng.normal(size=1 + i), sd, bool(k % 2), bool(k % 3)))
    return items


def kept_of(items):
    kept = InputBuffer(NAMES)
    for item in items:
        kept.append(item)
    return kept


def assert_same(found, items):
    expected = joined(items)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert type(one) is type(other)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
            continue
        assert (one.name, one.time_s, one.frozen, one.same) == (other.name, other.time_s, other.frozen, other.same)
        np.testing.assert_array_equal(one.value, other.value)
        assert one.sd is other.sd or np.array_equal(one.sd, other.sd)


@pytest.mark.parametrize("samples", [2, 40, 3 * PIECE])
def test_what_was_kept_comes_back(samples):
    items = some(60, samples=samples)
    assert_same(kept_of(items).inputs(), items)
    assert InputBuffer(NAMES).inputs() == []


def test_many_at_once_are_one_after_the_other():
    items = [item._replace(frozen=False) for item in some(400, samples=9) if isinstance(item, Measurement)]
    rows = np.random.default_rng(3).normal(size=(2 * PIECE, 7))
    before = np.sort(np.random.default_rng(4).integers(0, len(rows), len(items)))
    before[-1] = len(rows)
    kept, single = kept_of(some(20)), kept_of(some(20))
    for begin, end, item in zip([0, *before], before, items, strict=False):
        single.append(rows[begin:end])
        single.append(item)
    half = len(items) // 2
    for rest, first, some_of in (
        (rows[: before[half]], before[: half + 1], items[: half + 1]),
        (rows[before[half] :], before[half + 1 :] - before[half], items[half + 1 :]),
    ):
        names, times, values, sds, _, same = zip(*some_of, strict=True)
        which = np.array([NAMES.index(name) for name in names])
        read = {i: [value for value, k in zip(values, which, strict=True) if k == i] for i in set(which.tolist())}
        # what all have the same number of may come in one array
        read = {i: rows if i == 1 else np.array(rows) for i, rows in read.items()}
        kept.extend(rest, first, np.array(times), which, np.array(same), read, sds)
    assert kept.count == single.count and set(kept.sds) == set(single.sds)
    assert_same(kept.inputs(), single.inputs())


@pytest.mark.parametrize("first", [0.0, 0.4, 1.0])
def test_those_until_a_time_come_before_the_others(first):
    """Where a block of samples ends later than that it is not among them, nor is what came after it."""
    items = []
    for i in range(60):
        items += [np.full((3, 7), i + first), Measurement("compass", i + 0.5, np.ones(1), None)]
    items[7] = items[7]._replace(time_s=40.0)  # has come late
    kept = kept_of(items)
    for time_s in (-1.0, 0.2, 0.5, 3.4, 3.7, 20.0, 59.2, 70.0):
        early, late = [], []
        for item in items:
            when = item[-1, 0] if isinstance(item, np.ndarray) else item.time_s
            (late if late or when > time_s else early).append(item)
        before = kept.until(time_s)
        assert_same(kept.first(*before).inputs(), early)
        assert_same(kept.inputs(before), late)


@pytest.mark.parametrize("back", [0, 1, 150, 299])
def test_going_back_leaves_what_was_there_then_and_what_others_share(back):
    items, others = some(300, samples=200), some(50, seed=1)
    kept = kept_of(items[:back])
    count = kept.count
    for item in items[back:]:
        kept.append(item)
    so_far = kept.so_far()
    kept.cut(*count)
    assert kept.count == count
    for item in others:
        kept.append(item)
    assert_same(kept.inputs(), items[:back] + others)
    assert_same(so_far.inputs(), items)


@pytest.mark.parametrize("n", [0, 1, 100])
def test_they_are_stored_and_go_on(n):
    items = some(200, samples=100)
    kept = kept_of(items)
    stored = kept.first(*kept_of(items[:n]).count)
    again = from_arrays(to_arrays(stored), [InputBuffer, Rows]).again(NAMES)
    assert_same(again.inputs(), items[:n])
    for item in items[n:]:
        again.append(item)
    assert_same(again.inputs(), items)


def test_they_are_of_the_sensors_of_one_vehicle():
    with pytest.raises(ValueError, match="no sensor"):
        kept_of(some(50)).first(0, 1).again(NAMES[:2])


def test_there_is_little_to_look_through():
    """Python's collector goes through what lives in the middle of a call."""
    kept = InputBuffer(NAMES)
    before = len(gc.get_objects())
    for item in some(3000, samples=3):
        kept.append(item._replace(sd=None) if isinstance(item, Measurement) else item)
    gc.collect()
    assert len(gc.get_objects()) - before < 20

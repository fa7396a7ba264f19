"""Samples that a busy computer has stamped on receipt: put where they belong, and nothing else touched."""

import math

import faults_library as library
import numpy as np
import pytest
from feeding import DRIVE, events_of, one_by_one

import navfilter as nf
from navfilter.faults.clocks.burst_stamps import Bursts
from navfilter.simulation.scenarios import simulate_scenario

PERIOD_S, END_S = 0.01, 40.0


def rows(stamps):
    """Samples that can be told from each other."""
    return np.column_stack([stamps, np.arange(len(stamps)), *np.zeros((5, len(stamps)))])


def received(silence_s=0.5, apart_s=2e-4, count=200):
    """Stamps of samples at 100 Hz, all those of each silence in one go at its end; and as they should be."""
    true_s = PERIOD_S * np.arange(count)
    stamps = silence_s * np.ceil(true_s / silence_s)
    for k in range(1, count):
        stamps[k] = max(stamps[k], stamps[k - 1] + apart_s)
    return stamps, true_s


@pytest.mark.parametrize("size", [1, 3, 7, 200])
@pytest.mark.parametrize("apart_s", [0.0, 2e-4])
def test_they_are_a_period_apart(size, apart_s):
    stamps, true_s = received(apart_s=apart_s)
    bursts, samples = Bursts(PERIOD_S, 1.0), rows(stamps)
    parts = [bursts.take(samples[k : k + size].copy()) for k in range(0, len(samples), size)]
    given = np.concatenate([*parts, bursts.rest()])
    np.testing.assert_array_equal(given[:, 1], np.arange(len(samples)))  # none lost, none exchanged
    np.testing.assert_allclose(given[:, 0], true_s, atol=1e-9)
    assert bursts.memory.count == 50 * 3 + 49


def test_none_is_later_than_its_own_stamp():
    """More samples than fit into the silence: the unit is faster than is said."""
    stamps = np.r_[0.0, 0.1 + 1e-4 * np.arange(15)]
    given = Bursts(PERIOD_S, 1.0).take(rows(stamps))
    assert (given[:, 0] <= stamps + 1e-12).all() and (np.diff(given[:, 0]) > 0.0).all()
    np.testing.assert_allclose(given[:10, 0], PERIOD_S * np.arange(10), atol=1e-9)


@pytest.mark.parametrize(
    "stamps",
    [
        PERIOD_S * np.arange(50),
        np.r_[PERIOD_S * np.arange(20), 1.0 + PERIOD_S * np.arange(20)],  # samples are missing
        np.r_[PERIOD_S * np.arange(20), 0.19 + 1e-3 * np.arange(1, 20)],  # stamps that jitter, no silence
        np.r_[PERIOD_S * np.arange(20), 60.0 + 1e-3 * np.arange(20)],  # a leap of the clock
        np.r_[PERIOD_S * np.arange(20), 2.2, PERIOD_S * np.arange(20, 40)],  # a wild stamp
        np.r_[PERIOD_S * np.arange(20), np.nan, PERIOD_S * np.arange(21, 40)],
        np.r_[PERIOD_S * np.arange(20), np.inf, np.inf, -np.inf, PERIOD_S * np.arange(21, 40)],
    ],
    ids=["even", "missing", "jitter", "leap", "wild", "NaN", "infinite"],
)
@pytest.mark.parametrize("size", [1, 60])
def test_others_are_left_alone(stamps, size):
    bursts, samples = Bursts(PERIOD_S, 1.0), rows(stamps)
    parts = [bursts.take(samples[k : k + size].copy()) for k in range(0, len(samples), size)]
    np.testing.assert_array_equal(np.concatenate([*parts, bursts.rest()]), samples)
    assert bursts.memory.count == 0


def test_only_the_first_behind_a_silence_waits_and_for_one_sample():
    bursts = Bursts(PERIOD_S, 1.0)
    counts = [len(bursts.take(row[None, :])) for row in rows(np.r_[0.0, 0.01, 0.5, 0.51, 0.52])]
    assert counts == [1, 1, 0, 2, 1]


@pytest.fixture(scope="module")
def dive():
    """A survey whose computer stamps on receipt from 10 to 30 s, and with stamps as they should be."""
    vehicle, mission = simulate_scenario("lawnmower", 2, END_S)
    events = events_of(vehicle, mission)
    begin, end = 10.0, 30.0
    late = [
        e._replace(arrival_s=math.ceil(2.0 * e.true_s) / 2.0) if begin <= e.true_s < end and e.sensor == DRIVE else e
        for e in events
    ]
    wrong, last = [], -math.inf
    for e in sorted(late, key=lambda e: e.arrival_s):
        if e.sensor == DRIVE and begin <= e.true_s < end:
            last = max(e.arrival_s, last + 2e-4)
            e = e._replace(time_s=last)
        wrong.append(e)
    return vehicle, mission, events, wrong


def test_a_navigator_is_where_it_would_be(dive):
    vehicle, mission, events, wrong = dive
    best, nav = (nf.Navigator(vehicle, mission.start, threads=False) for _ in range(2))
    one_by_one(best, events)
    outcomes = one_by_one(nav, wrong)
    for one in (best, nav):
        one.finish()
    assert nav.health.drive["burst"] > 1900 and "burst" not in best.health.drive
    assert not {"ahead", "too-late", "rejected"} & {outcome.status for outcome in outcomes}
    error = nav.state.minus(best.state)
    # half a second of the unit at rates that are off by a tenth: its samples are in another order with readings
    assert np.hypot(*error[:2]) < 0.1 * best.state.sd[0] and nav.counts["gap"] == nav.counts["backward"] == 0


def test_what_waits_is_in_a_snapshot_and_goes_on_at_the_end(dive):
    vehicle, mission, _, wrong = dive
    whole, nav = (nf.Navigator(vehicle, mission.start, threads=False) for _ in range(2))
    one_by_one(whole, wrong)
    whole.finish()
    waits = False
    for k, event in enumerate(wrong):
        one_by_one(nav, [event])
        if len(nav.clock.memory.bursts.first) and event.true_s > 15.0:
            waits = True
            other = nf.Navigator.restore(vehicle, nav.snapshot())
            one_by_one(other, wrong[k + 1 :])
            other.finish()
            assert other.snapshot() == whole.snapshot()
            break
    assert waits
    short = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(short, wrong[: k + 1])
    before_s = short.time_s
    short.finish()
    assert short.time_s > before_s


def test_all_sensors_stamped_on_receipt_for_a_minute():
    """Then the readings are late by up to half a second, too: that is the way made in it."""
    vehicle, mission = simulate_scenario("lawnmower", 2, 200.0)
    events = events_of(vehicle, mission)
    scene = library.scene_of(vehicle, (100.0, 160.0), (170.0, 190.0))
    wrong = library.damaged("bursts stamped on receipt", events, scene, 1)
    best, nav = (nf.Navigator(vehicle, mission.start, threads=False) for _ in range(2))
    most_m = 0.0
    for one, what in zip(events, wrong, strict=True):
        one_by_one(best, [one])
        one_by_one(nav, [what])
        if abs(best.time_s - nav.time_s) < 1e-6:
            most_m = max(most_m, math.hypot(*nav.state.minus(best.state)[:2].tolist()))
    assert nav.health.drive["burst"] > 5500
    assert 0.0 < most_m < 1.5 * 0.5

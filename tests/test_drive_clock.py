"""The clock of the drive alone is set, or that of all, or the drive was silent: told apart by the order of arrival."""

import math
from functools import cache

import faults_run as watched
import numpy as np
import pytest
from feeding import DRIVE, events_of, one_by_one

import navfilter as nf
from navfilter.faults import settings as fault_settings
from navfilter.faults.clocks.imu_clock import ImuClockMonitor, ReceivedMeasurement
from navfilter.simulation.scenarios import simulate_scenario

SET_S, END_S = 12.0, 20.0


@cache
def scene(name, seconds):
    """Vehicle, mission, its events; and the run as it is, with which nobody goes on."""
    vehicle, mission = simulate_scenario(name, 2, seconds)
    events = events_of(vehicle, mission)
    return vehicle, mission, events, flown(vehicle, mission, events)[0]


@pytest.fixture(scope="module", params=["lawnmower", "reckoning"])
def dive(request):
    return scene(request.param, END_S if request.param == "lawnmower" else 5 * END_S)


def stamped(events, by_s, sensors=(DRIVE,), from_s=SET_S):
    """Events in the same order, those of some sensors with other stamps from an instant on."""
    return [
        e._replace(time_s=e.time_s + by_s) if (not sensors or e.sensor in sensors) and e.true_s >= from_s else e
        for e in events
    ]


def flown(vehicle, mission, events):
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    outcomes = one_by_one(nav, events)
    nav.finish()
    return nav, outcomes


@pytest.mark.parametrize("by_s", [2.0, -2.0, 45.0, -45.0, 7200.0, -7200.0])
def test_a_clock_that_was_set_alone_costs_nothing(dive, by_s):
    vehicle, mission, events, best = dive
    if abs(by_s) <= 10.0 * vehicle.drive.period_s:
        pytest.skip("no leap for so slow a drive")
    nav, outcomes = flown(vehicle, mission, stamped(events, by_s))
    error = nav.state.minus(best.state)
    # the time from the last sample before to the first one after is taken to be a period
    assert nav.time_s == pytest.approx(best.time_s, abs=1e-9) and np.abs(error).max() < 1e-6
    assert nav.health.drive_clock_offset_s == pytest.approx(-by_s) and nav.health.clock_offset_s == 0.0
    assert nav.counts["gap"] == nav.counts["backward"] == nav.counts["clock-set"] == 0
    # those that come between two samples
    assert sum(outcome.status == "waiting" for outcome in outcomes) <= len(vehicle.sensors)
    assert sum(watch.outcomes["used"] for watch in nav.sensor_monitors.values()) == sum(
        watch.outcomes["used"] for watch in best.sensor_monitors.values()
    )


@pytest.mark.parametrize("stamp_s", [0.0, 1000.0 * SET_S, SET_S + 5.0, SET_S - 5.0])
def test_a_single_wild_stamp_is_no_clock_that_was_set(dive, stamp_s):
    """All sensors are heard between it and the next sample: their votes are about one stamp."""
    vehicle, mission, events, best = dive
    at = next(i for i, e in enumerate(events) if e.sensor == DRIVE and e.time_s >= SET_S - 1e-9)
    assert {e.sensor for e in events[at + 1 : at + 3]} - {DRIVE}
    wild = [e._replace(time_s=stamp_s) if i == at else e for i, e in enumerate(events)]
    nav, _ = flown(vehicle, mission, wild)
    assert nav.time_s == best.time_s and nav.health.drive_clock_offset_s == nav.health.clock_offset_s == 0.0
    assert nav.counts["backward"] == 1 and nav.counts["clock-set"] == 0
    # a sample less of a drive of 4 Hz is a period without it
    error = nav.state.minus(best.state)
    assert math.hypot(error[0], error[1]) < 1.0


def test_one_that_is_put_right_is_as_before(dive):
    vehicle, mission, events, _ = dive
    nav, _ = flown(vehicle, mission, stamped(stamped(events, 22.0), -22.0, from_s=SET_S + 4.0))
    assert nav.health.drive_clock_offset_s == pytest.approx(0.0, abs=1e-9) and nav.counts["gap"] == 0


@pytest.mark.parametrize("by_s", [25.0, -25.0])
def test_a_clock_that_was_set_for_all_is_no_business_of_the_drive(dive, by_s):
    vehicle, mission, events, _ = dive
    nav, _ = flown(vehicle, mission, stamped(events, by_s, sensors=()))
    assert nav.health.drive_clock_offset_s == 0.0
    assert nav.counts["gap"] >= 1 and (nav.counts["clock-set"] == 1) == (by_s < 0.0)


def test_a_drive_that_was_silent_has_a_gap():
    vehicle, mission = simulate_scenario("lawnmower", 2, END_S)
    events = [e for e in events_of(vehicle, mission) if e.sensor != DRIVE or not SET_S < e.time_s < SET_S + 3.0]
    nav, _ = flown(vehicle, mission, events)
    assert nav.health.drive_clock_offset_s == 0.0 and nav.counts["gap"] == 1 and nav.time_s == END_S


@pytest.mark.parametrize("stamp_s", [math.inf, -math.inf, math.nan])
def test_a_stamp_that_is_no_number_sets_no_clock(stamp_s):
    """The drive is silent after it: the readings alone would say by how much."""
    vehicle, mission = simulate_scenario("lawnmower", 2, END_S)
    events = [e for e in events_of(vehicle, mission) if e.sensor != DRIVE or not SET_S < e.time_s < SET_S + 3.0]
    last = max((k for k, e in enumerate(events) if e.sensor == DRIVE and e.time_s <= SET_S))
    wrong = [*events[: last + 1], events[last]._replace(time_s=stamp_s), *events[last + 1 :]]
    nav, _ = flown(vehicle, mission, wrong)
    best, _ = flown(vehicle, mission, events)
    assert nav.health.drive_clock_offset_s == 0.0 and nav.time_s == END_S
    assert not nav.state.minus(best.state).any()


def test_a_pause_of_everything_is_what_it_was():
    vehicle, mission = simulate_scenario("lawnmower", 2, END_S)
    events = [e for e in events_of(vehicle, mission) if not SET_S < e.time_s < SET_S + 3.0]
    nav, _ = flown(vehicle, mission, events)
    plain = nf.Navigator(vehicle, mission.start, threads=False)
    plain.clock = ImuClockMonitor(vehicle.drive.period_s, live=False)
    one_by_one(plain, events)
    assert nav.health == plain.health and nav.health.drive_clock_offset_s == 0.0 and nav.counts["gap"] == 1
    np.testing.assert_array_equal(nav.state.covariance, plain.state.covariance)


def test_a_wild_stamp_is_none(dive):
    vehicle, mission, events, _ = dive
    at = next(k for k, e in enumerate(events) if e.sensor == DRIVE and e.true_s > SET_S)
    for by_s in (50.0, -50.0, math.nan):
        nav, _ = flown(vehicle, mission, [*events[:at], events[at]._replace(time_s=SET_S + by_s), *events[at + 1 :]])
        assert nav.health.drive_clock_offset_s == 0.0 and nav.counts["backward"] == 1
        assert nav.time_s == events[-1].time_s


def test_what_waits_is_in_a_snapshot(dive):
    vehicle, mission, events, _ = dive
    wrong = stamped(events, 22.0)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    whole, _ = flown(vehicle, mission, wrong)
    seen = 0
    for k, event in enumerate(wrong):
        one_by_one(nav, [event])
        if nav.clock.holds:
            seen += 1
            other = nf.Navigator.restore(vehicle, nav.snapshot())
            one_by_one(other, wrong[k + 1 :])
            other.finish()
            assert other.snapshot() == whole.snapshot()
        if seen == 3:
            break
    assert seen


def test_without_an_answer_samples_go_on_as_they_are():
    clock = ImuClockMonitor(0.01, live=True)
    row = lambda t: np.array([[t, *np.zeros(6)]])  # noqa: E731
    assert len(clock.check_samples(row(1.0))) == 1
    assert clock.check_reading(ReceivedMeasurement("compass", 1.0, 0.0, None)) is None
    passed = [clock.check_samples(row(3.0 + 0.01 * k)) for k in range(120)]
    assert not clock.holds and sum(len(part) for items in passed for part in items) == 120
    assert sum(not items for items in passed) == 101  # those of a second, and the first of them
    assert clock.memory.offset_s == 0.0


def late(events, by_s, from_s=SET_S, end_s=math.inf):
    """The drive's samples arrive later."""
    moved = [
        e._replace(arrival_s=e.arrival_s + by_s * (e.sensor == DRIVE and from_s <= e.true_s < end_s)) for e in events
    ]
    return sorted(moved, key=lambda e: e.arrival_s)


def test_readings_wait_for_a_drive_that_is_late(dive):
    """Those of the first second are taken beside the last sample; all others as if nothing were late."""
    vehicle, mission, events, best = dive
    nav, outcomes = flown(vehicle, mission, late(events, 3.0))
    assert not {"ahead", "too-late", "invalid"} & {outcome.status for outcome in outcomes}
    assert nav.health.drive["late"] > 100
    assert nav.time_s == best.time_s and nav.counts["gap"] == nav.counts["backward"] == 0
    used = {name: nav.health.sensors[name].outcomes["used"] for name in vehicle.sensors}
    assert used == {name: best.health.sensors[name].outcomes["used"] for name in vehicle.sensors}
    error = nav.state.minus(best.state)
    assert math.hypot(error[0], error[1]) < 0.5 * best.state.sd[0]
    assert "late" not in best.health.drive


def test_readings_that_leap_ahead_do_not_wait(dive):
    vehicle, mission, events, _ = dive
    wrong = [e._replace(time_s=e.time_s + 2.0) if e.sensor != DRIVE and e.true_s >= SET_S else e for e in events]
    nav, outcomes = flown(vehicle, mission, wrong)
    assert sum(outcome.status == "ahead" for outcome in outcomes) > 50 and "late" not in nav.health.drive


@pytest.mark.parametrize("by_s", [0.5, 1.0, 2.0, -0.5, -1.0, -2.0])
@pytest.mark.parametrize("sensor", ["compass", "dvl"])
def test_the_clock_of_one_sensor_that_is_set_is_put_right(sensor, by_s):
    """Nothing arrives before it was measured, and nothing in another order: else the state would be carried on to it,
    and believe an old heading; or go on against a velocity that is a second old.
    """
    vehicle, mission, events, best = scene("lawnmower", 100.0)
    wrong = stamped(events, by_s, (sensor,), 40.0)
    nav, outcomes = flown(vehicle, mission, wrong)
    assert nav.clock.memory.ahead[sensor].by_s == pytest.approx(by_s, abs=0.02)
    assert nav.health.drive["moved"] > 50
    assert abs(nav.time_s - best.time_s) < 0.02 and np.abs(nav.state.minus(best.state)[:3]).max() < 0.3
    # the stamps of those that were ahead come again
    assert sum(outcome.status == "duplicate" for outcome in outcomes) < 8 * abs(by_s) + 4
    # and one that is put right is what it was
    nav, _ = flown(vehicle, mission, stamped(wrong, -by_s, (sensor,), 70.0))
    assert nav.clock.memory.ahead[sensor].by_s == 0.0


def test_readings_that_take_longer_to_arrive_set_no_clock():
    """They are late, and right: they still come in order. One old one in between is none of these."""
    vehicle, mission = simulate_scenario("lawnmower", 2, 60.0)
    events = [
        e._replace(arrival_s=e.true_s + (e.sensor == "dvl" and e.true_s > 20.0) * (1.0 + (e.true_s > 40.0)))
        for e in events_of(vehicle, mission)
    ]
    again = [e._replace(arrival_s=e.true_s + 3.1) for e in events if e.sensor == "dvl" and round(4 * e.true_s) % 24 < 3]
    nav, _ = flown(vehicle, mission, sorted([*events, *again], key=lambda e: e.arrival_s))
    assert "moved" not in nav.health.drive and nav.health.sensors["dvl"].outcomes["late-replayed"] > 100


def test_blocks_of_the_drive_set_no_clock():
    """Samples that come in blocks of 0.8 s leave readings ahead of them, by more and more."""
    vehicle, mission = simulate_scenario("lawnmower", 2, 60.0)
    events = [
        e._replace(arrival_s=math.ceil(e.time_s / 0.8) * 0.8) if e.sensor == DRIVE else e
        for e in events_of(vehicle, mission)
    ]
    nav, _ = flown(vehicle, mission, sorted(events, key=lambda e: e.arrival_s))
    assert "moved" not in nav.health.drive and nav.health.drive["late"] > 100


def test_a_drive_that_is_late_sets_no_clock():
    """Fixes that take long to arrive come in time all the same, but no longer by as much as before."""
    vehicle, mission = simulate_scenario("lawnmower", 2, 60.0)
    late = {DRIVE: lambda time_s: 0.5 * (time_s > 20.0), "gps": lambda time_s: 0.7}
    events = [
        e._replace(arrival_s=e.true_s + late.get(e.sensor, lambda time_s: 0.0)(e.true_s))
        for e in events_of(vehicle, mission)
    ]
    nav, _ = flown(vehicle, mission, sorted(events, key=lambda e: e.arrival_s))
    assert "moved" not in nav.health.drive and nav.health.drive["late"] > 100


def test_of_a_drive_that_falls_silent_nothing_waits_for_ever():
    """To the same bits as where nothing waits at all."""
    vehicle, mission = simulate_scenario("lawnmower", 2, END_S)
    events = [e for e in events_of(vehicle, mission) if e.sensor != DRIVE or not SET_S < e.time_s < SET_S + 8.0]
    nav, _ = flown(vehicle, mission, events)
    plain = nf.Navigator(vehicle, mission.start, threads=False)
    plain.clock = ImuClockMonitor(vehicle.drive.period_s, live=False)
    one_by_one(plain, events)
    assert nav.health.drive["silent"] and not nav.clock.memory.early
    np.testing.assert_array_equal(nav.state.covariance, plain.state.covariance)


def test_what_waits_for_a_late_drive_is_in_a_snapshot_and_is_taken_at_the_end(dive):
    vehicle, mission, events, _ = dive
    wrong = late(events, 3.0)
    whole, _ = flown(vehicle, mission, wrong)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    at = next(k for k, e in enumerate(wrong) if e.arrival_s > SET_S + 10.0)
    one_by_one(nav, wrong[:at])
    assert nav.clock.memory.early
    other = nf.Navigator.restore(vehicle, nav.snapshot())
    nav.finish()
    assert not nav.clock.memory.early
    one_by_one(other, wrong[at:])
    other.finish()
    assert other.snapshot() == whole.snapshot()


def test_the_truth_of_a_long_dive_is_held():
    """As it was measured: without this, kilometres."""
    vehicle, mission = watched.simulated(5, 240.0)
    events = events_of(vehicle, mission)
    nav, _ = flown(vehicle, mission, stamped(events, 2.0, from_s=130.0))
    error = nav.state.minus(watched.truth_at(mission.truth, 240.0))
    assert math.hypot(*error[:2]) < 10.0
    assert math.hypot(*error[:2]) < nav.state.bounds.horizontal_m


@pytest.mark.parametrize("sensor", ["compass", "dvl"])
def test_the_first_readings_of_a_clock_that_was_set_wait_until_that_is_told(sensor):
    """Used at once, they carry the state on without samples, and the next ones are late."""
    vehicle, mission, events, best = scene("lawnmower", 100.0)
    nav, outcomes = flown(vehicle, mission, stamped(events, 1.0, (sensor,), 40.0))
    assert sum(outcome.status == "waiting" for outcome in outcomes) == fault_settings.SET - 1
    assert not nav.clock.memory.early and "late" not in nav.health.drive
    assert not nav.counts["jumped"] and not nav.counts["gap"]
    for name in vehicle.sensors:
        counts = nav.health.sensors[name].outcomes
        taken = counts["used"] + counts.get("late-replayed", 0)
        assert taken == best.health.sensors[name].outcomes["used"]
    # all of them in their place, but for a stamp that is told to a hundredth of a second
    assert np.abs(nav.state.minus(best.state)[:3]).max() < 0.05


@pytest.mark.parametrize("rate_hz", [4.0, 1.0])
def test_nothing_waits_for_a_drive_that_falls_silent_beside_a_single_sensor(rate_hz):
    clock = ImuClockMonitor(0.01, live=True, ahead_s=1.0)
    row = lambda t: np.array([[t, *np.zeros(6)]])  # noqa: E731
    held = []
    for k in range(1, 3 * round(rate_hz)):
        clock.check_samples(np.vstack([row(k / rate_hz - 0.01 * j) for j in range(round(100 / rate_hz) - 1, -1, -1)]))
        assert clock.check_reading(ReceivedMeasurement("dvl", k / rate_hz, 0.0, None)) is None
    for k in range(3 * round(rate_hz), 12 * round(rate_hz)):
        went = clock.check_reading(ReceivedMeasurement("dvl", k / rate_hz, 0.0, None))
        held.append(len(clock.memory.early))
        assert went is None or held[-1] or went[-1].time_s == k / rate_hz
    assert held[0] <= 1 and held[-1] == 0


def test_readings_that_wait_for_their_clock_go_on_where_all_are_ahead():
    """Then it is the drive's: nothing is kept, and nothing moved."""
    clock = ImuClockMonitor(0.01, live=True, ahead_s=5.0)
    clock.check_samples(np.array([[t, *np.zeros(6)] for t in np.arange(0.0, 2.0, 0.01)]))
    for name in ("compass", "dvl"):
        assert clock.check_reading(ReceivedMeasurement(name, 1.99, 0.0, None)) is None
    assert clock.check_reading(ReceivedMeasurement("dvl", 3.0, 0.0, None)) == []
    went = clock.check_reading(ReceivedMeasurement("compass", 3.1, 0.0, None))
    assert [(one.name, one.time_s) for one in went] == [("dvl", 3.0), ("compass", 3.1)]
    assert not clock.memory.early

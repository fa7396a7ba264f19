"""Late readings take their place in time; a snapshot goes on to the last bit."""

import json
from dataclasses import replace

import numpy as np
import pytest
import same_runs
from feeding import Event, delayed, events_of, one_by_one
from state_differences import differences

import navfilter as nf
from navfilter.kernels import fault_bank
from navfilter.learning.schedule import LearningSchedule
from navfilter.navigation.early_rerun import ShadowRun
from navfilter.simulation.scenarios import simulate_scenario


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 3, 120.0)
    learner = nf.LearnedArma(prior=vehicle.sensors["compass"].error, window=400, hop=50, orders=((1, 0), (1, 1)))
    vehicle = vehicle.with_error(compass=learner)
    return vehicle, mission, events_of(vehicle, mission)


def test_late_readings_equal_arrival_in_order(dive):
    """The compass and the fixes arrive up to 1.9 s late, across an adoption too: same state as in order, to
    rounding.
    """
    vehicle, mission, events = dive
    late = delayed(events, ("gps", "compass"), 1.9, seed=1)
    one, two = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(one, events)
    outcomes = [outcome.status for outcome in one_by_one(two, late)]
    assert outcomes.count("late-replayed") > 100 and "too-late" not in outcomes
    assert one.counts["adopted"] >= 1 and one.counts == two.counts
    same_runs.assert_same_estimate(one, two)


@pytest.mark.parametrize(("history_s", "share"), [(2.0, 0.3), (10.0, 0.1), (30.0, 0.04)])
def test_learning_is_the_same_whatever_comes_late(history_s, share, monkeypatch):
    """Compass and fixes late by up to the history's length, over the early adoptions and hops of 25 s: models and state
    as in order.

    1e-9 is rounding: samples come in other blocks.
    """
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (30.0, 60.0, 120.0))
    vehicle, mission = simulate_scenario("lawnmower", 3, 240.0)
    vehicle = vehicle.with_error(compass=nf.LearnedArma(prior=vehicle.sensors["compass"].error, window=400, hop=200))
    events = events_of(vehicle, mission)
    one, two = (nf.Navigator(vehicle, mission.start, history_s=history_s) for _ in range(2))
    one_by_one(one, events)
    late = delayed(events, ("gps", "compass"), history_s - 0.3, seed=7, share=share)
    outcomes = [outcome.status for outcome in one_by_one(two, late)]
    assert outcomes.count("late-replayed") > 60 and "too-late" not in outcomes
    assert one.counts["adopted"] >= 2
    assert one.filter.memory.models == two.filter.memory.models
    assert differences(two.filter.memory, one.filter.memory, 1e-9) == []


def test_a_twin_takes_no_place_while_a_late_reading_is_put_in_its_own(monkeypatch):
    """From when there is a twin on, all readings come in batches of 0.7 s, behind their samples: the first one behind
    the time at which it is awaited is late, and the twin has had the samples since.
    """
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (30.0, 60.0, 120.0))
    monkeypatch.setattr(LearningSchedule, "ANOTHER", -1.0)  # the beginning is done again for every model
    vehicle, mission = simulate_scenario("lawnmower", 3, 150.0)
    vehicle = vehicle.with_error(compass=nf.LearnedArma(prior=vehicle.sensors["compass"].error, window=400, hop=200))
    events, made_s = events_of(vehicle, mission), []

    def noted(twin, nav, *args, init=ShadowRun.__init__):
        made_s.append(nav.time_s)
        init(twin, nav, *args)

    monkeypatch.setattr(ShadowRun, "__init__", noted)
    navs = [nf.Navigator(vehicle, mission.start, threads=threads) for threads in (True, True, False)]
    one_by_one(navs[0], events)
    since_s = made_s[0]
    batches = [
        e if e.sensor == "drive" or e.time_s <= since_s else e._replace(arrival_s=0.7 * (e.time_s // 0.7 + 1.0))
        for e in events
    ]
    batches.sort(key=lambda e: e.arrival_s)
    for nav in navs[1:]:
        assert "too-late" not in [outcome.status for outcome in one_by_one(nav, batches)]
    assert made_s.count(since_s) > 1
    assert differences(navs[1].filter.memory, navs[2].filter.memory) == []


def test_beyond_the_history_a_reading_is_too_late(dive):
    vehicle, mission, events = dive
    nav = nf.Navigator(vehicle, mission.start, history_s=1.0)
    one_by_one(nav, [event for event in events if event.time_s <= 20.0])
    before = nav.filter.nav.copy()
    assert nav.correct("depth", 18.0, 0.0).status == "too-late"
    np.testing.assert_array_equal(nav.filter.nav, before)
    assert nav.correct("depth", 19.5, float(mission.streams["depth"].value[19, 0])).status == "late-replayed"
    assert nav.correct("depth", 19.5, 0.0).status == "duplicate"
    with pytest.raises(ValueError, match="tape"):
        nf.Navigator(vehicle, mission.start, nf.Tape(), history_s=1.0)


def test_what_is_as_described_is_so_after_a_restart(dive):
    """Its level is watched where something has been learnt of it, and there alone."""
    vehicle, mission, events = dive
    nav = nf.Navigator(vehicle, mission.start)
    for until_s, watched in ((20.0, False), (40.0, True)):
        one_by_one(nav, [event for event in events if nav.time_s < event.time_s <= until_s])
        nav = nf.Navigator.restore(vehicle, nav.snapshot())
        assert nav.learning.listeners["compass"].is_watched == watched


@pytest.mark.parametrize("at_s", [0.0, 33.3, 97.77])
def test_a_snapshot_goes_on_bit_for_bit(dive, at_s, tmp_path):
    vehicle, mission, events = dive
    first = [event for event in events if event.time_s <= at_s]
    rest = events[len(first) :]
    whole = nf.Navigator(vehicle, mission.start)
    one_by_one(whole, first)
    data = whole.snapshot(tmp_path / "state.nav")
    again = nf.Navigator.restore(vehicle, tmp_path / "state.nav")
    assert again.snapshot() == data
    late = Event("depth", at_s - 1.0, (0.5,), at_s - 1.0, at_s)
    assert [o.status for o in one_by_one(whole, [late, *rest])] == [o.status for o in one_by_one(again, [late, *rest])]
    same_runs.assert_same_bits(whole, again)
    assert again.state.health == whole.state.health
    assert list(tmp_path.iterdir()) == [tmp_path / "state.nav"]


def test_snapshots_that_cannot_be_trusted_are_refused(dive, tmp_path):
    vehicle, mission, events = dive
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, events[:2000])
    data = nav.snapshot()
    with pytest.raises(ValueError, match="another vehicle"):
        nf.Navigator.restore(vehicle.without("gps"), data)
    for broken in (data[:-1], data[:200], data[:40], data[:-9] + b"x" + data[-8:], data + b"x"):
        with pytest.raises(ValueError, match="damaged"):
            nf.Navigator.restore(vehicle, broken)
    with pytest.raises(ValueError, match="no snapshot"):
        nf.Navigator.restore(vehicle, b"hello")
    magic, header, payload = data.split(b"\n", 2)
    other = json.dumps(json.loads(header) | {"format": 99}).encode()
    with pytest.raises(ValueError, match="format 99"):
        nf.Navigator.restore(vehicle, b"\n".join([magic, other, payload]))
    with pytest.raises(OSError):
        nf.Navigator.restore(vehicle, tmp_path / "nothing")
    with pytest.raises(ValueError, match="tape"):
        nf.Navigator(vehicle, mission.start, nf.Tape()).snapshot()


def test_a_look_for_slow_faults_does_not_ask_what_no_memory_holds():
    """A compass that is heard less often than the history is long, with a standard deviation of its own each time:
    where the look falls between it and the next, the state that is gone back to knows what that was.
    """
    vehicle, mission = simulate_scenario("lawnmower", 3, 60.0)
    sensors = {"compass": replace(vehicle.sensors["compass"], rate_hz=1.0 / 2.9), "depth": vehicle.sensors["depth"]}
    vehicle = replace(vehicle, sensors=sensors)
    nav, again, looks = nf.Navigator(vehicle, mission.start), [], []
    for k in range(1, 5001):
        time_s = 0.01 * k
        nav.step(time_s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
        if k % 290 == 0:
            nav.correct("compass", time_s, 0.01 * (k % 7), sd=0.01 * (1 + k // 290 % 3))
        if k % 20 == 10:
            nav.correct("depth", time_s, 0.05)
            looks.append(nav.filter.memory.monitor.bank[fault_bank.LOOKED_S])
            if len(set(looks[-2:])) == 2:
                again.append(nf.Navigator.restore(vehicle, nav.snapshot()))
                assert differences(again[-1].memory, nav.memory) == []
    assert np.isfinite(looks[-1]) and len(again) >= 4

"""Learning on a thread of its own: the same bits at any speed of the machine, with late readings and snapshots between
the beginning of a hop and its answer.
"""

import gc
import os
import signal
import time
import weakref
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest
from feeding import DRIVE, events_of, fed
from state_differences import differences

import navfilter as nf
from navfilter.filter import filter as filter_module
from navfilter.learning.background import Task, Worker
from navfilter.learning.schedule import LearningSchedule
from navfilter.navigation import early_rerun
from navfilter.simulation.scenarios import stage

EARLY_S = (16.0, 25.0, 30.0)
#: Answers of the first hop are taken at 18 s, and the beginning is done again at 18.32 s.
PENDING_S, AGAIN_S = 17.0, 18.2


@pytest.fixture(autouse=True)
def few_hops(monkeypatch):
    monkeypatch.setattr(LearningSchedule, "EARLY_S", EARLY_S)


@pytest.fixture(scope="module")
def mission():
    staged = stage("compass-rolling", duration_s=33.0, imu_rate_hz=20.0)
    prior = nf.LearnedArma(prior=staged.vehicle.sensors["compass"].error, orders=((0, 0), (1, 0), (2, 0)), hop=30)
    vehicle = staged.vehicle.with_error(compass=prior)
    return vehicle, staged.mission(1), events_of(vehicle, staged.mission(1))


@pytest.fixture
def alone(mission, few_hops):
    """Without threads."""
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start, threads=False)
    return fed(nav, events), nav


def slow(self, work):
    if not self.threads:
        return None

    def later():
        time.sleep(0.05)
        work()

    self.pool = getattr(self, "pool", None) or ThreadPoolExecutor(1)
    return self.pool.submit(later)


def instantaneous(self, work):
    if not self.threads:
        return None
    work()
    done = Future()
    done.set_result(None)
    return done


@pytest.mark.parametrize("begin", [Worker.begin, slow, instantaneous])
def test_the_same_bits_at_any_speed(mission, alone, begin, monkeypatch):
    vehicle, recorded, events = mission
    arrived, taken = [], early_rerun.ShadowRun.arrived
    monkeypatch.setattr(early_rerun.ShadowRun, "arrived", lambda twin: arrived.append(twin) or taken(twin))
    monkeypatch.setattr(Worker, "begin", begin)
    nav = nf.Navigator(vehicle, recorded.start)
    rows = fed(nav, events)
    assert np.array_equal(rows, alone[0])
    assert differences(nav.memory.filter, alone[1].memory.filter) == []
    # hops, and the beginning done again by a twin, did take place
    assert nav.counts["adopted"] >= 1 and arrived
    learnt = nav.health.learning
    assert (learnt.late > 0) == (begin is slow) or begin is Worker.begin
    assert (learnt.waited_s > 0.0) == (learnt.late > 0)
    assert alone[1].health.learning.late == 0


def test_a_replay_is_the_same(mission, alone):
    vehicle, recorded, _ = mission
    track = nf.replay(vehicle, recorded)
    assert np.array_equal(track.covariance[-1], alone[1].state.covariance)
    assert track.latitude[-1] == alone[1].state.latitude


@pytest.mark.parametrize("until_s", [PENDING_S, AGAIN_S])
def test_a_snapshot_between_a_hop_and_its_answer(mission, alone, until_s):
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start)
    number = next(i for i, event in enumerate(events) if event.time_s > until_s)
    fed(nav, events[:number])
    listener = nav.learning.memory.listeners["compass"]
    assert (listener.hop is not None) == (until_s == PENDING_S)
    assert (nav.learning.again is not None) == (until_s == AGAIN_S)
    restored = nf.Navigator.restore(vehicle, nav.snapshot())
    rows = fed(restored, events[number:])
    assert np.array_equal(rows, alone[0][-len(rows) :])
    assert differences(restored.memory.filter, alone[1].memory.filter) == []


@pytest.mark.parametrize("at_s", [15.9, 16.5, 17.9, 18.25])
def test_late_readings_over_a_hop_find_their_place(mission, alone, at_s):
    """A reading 1.5 s late goes back over the beginning of a hop, its answer, or the beginning done again."""
    vehicle, recorded, events = mission
    number = next(i for i, e in enumerate(events) if e.time_s > at_s and e.sensor == "compass")
    behind = next(i for i, e in enumerate(events) if e.time_s > at_s + 1.5)
    late = [*events[:number], *events[number + 1 : behind], events[number], *events[behind:]]
    nav = nf.Navigator(vehicle, recorded.start)
    fed(nav, late)
    np.testing.assert_allclose(nav.filter.nav, alone[1].filter.nav, rtol=0.0, atol=1e-12)
    assert differences(nav.memory.filter, alone[1].memory.filter, tolerance=1e-9) == []


def test_a_model_by_hand_ends_it(mission):
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start)
    number = next(i for i, event in enumerate(events) if event.time_s > AGAIN_S)
    fed(nav, events[:number])
    assert nav.learning.again is not None
    nav.adopt("compass", nf.White(sd=0.01))
    assert nav.learning.again is None
    fed(nav, events[number : number + 200])
    assert isinstance(nav.filter.in_force.sensors["compass"].error, nf.White)


@pytest.mark.parametrize("at_s", [5.0, PENDING_S, AGAIN_S])
def test_learning_goes_on_after_a_model_by_hand(mission, at_s):
    """Before the first early look, while one is under way, and before the beginning is done again."""
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start)
    number = next(i for i, event in enumerate(events) if event.time_s > at_s)
    fed(nav, events[:number])
    nav.adopt("depth", nf.White(sd=0.1))
    before = nav.counts["adopted"]
    fed(nav, events[number:])
    assert nav.counts["adopted"] > before and nav.learning.beginning is None
    assert not isinstance(nav.filter.in_force.sensors["compass"].error, nf.White)


def test_what_is_left_of_a_run_is_freed_without_a_collector(mission, monkeypatch):
    vehicle, recorded, events = mission
    twins, begun = [], early_rerun._begun

    def seen(*args):
        twin = begun(*args)
        twins.extend(weakref.ref(part) for part in (twin, twin.history, twin.learning))
        return twin

    monkeypatch.setattr(early_rerun, "_begun", seen)
    gc.disable()
    try:
        nav = nf.Navigator(vehicle, recorded.start)
        fed(nav, events)
        nav.learning.worker.begin(lambda: None).result()
        assert len(twins) >= 3 and [part() for part in twins if part() is not None] == []
    finally:
        gc.enable()


def test_what_a_run_has_left_is_freed_though_sensors_have_not_spoken_since(mission):
    """What their prompts had in hand would else be freed in the middle of a reading."""
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start)
    number = next(i for i, event in enumerate(events) if event.time_s > AGAIN_S)
    fed(nav, events[:number])
    assert nav.learning.again is not None
    left = [weakref.ref(array) for array in (nav.filter.bench, nav.filter.memory.P, nav.filter.memory.nav)]
    nav.history.start_here()  # checkpoints hold copies
    fed(nav, [event for event in events[number : number + 40] if event.sensor in (DRIVE, "compass")])
    assert nav.learning.again is None and len(nav.vehicle.sensors) > 1
    nav.learning.worker.begin(lambda: None).result()
    assert [array() for array in left if array() is not None] == []


def test_a_task_that_fails_says_so_when_it_is_asked():
    for threads in (True, False):
        task = Task(Worker(threads), lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            task.answer()


def test_what_adoptions_take_is_worked_out_beforehand(mission, alone, monkeypatch):
    """On the thread, behind the look that has found the models; where the beginning is done again, too."""
    vehicle, recorded, events = mission
    vehicle = vehicle.with_error(dvl=nf.LearnedArma(orders=((0, 0), (1, 0))))
    monkeypatch.setattr(LearningSchedule, "ANOTHER", 1e9)
    found, work_out = [], filter_module.adoption

    def adoption(before, layout, sensor, error, afresh, known):
        found.append(any(one.before is before and one.error is error for one in known))
        return work_out(before, layout, sensor, error, afresh, known)

    monkeypatch.setattr(filter_module, "adoption", adoption)
    nav = nf.Navigator(vehicle, recorded.start)
    fed(nav, events)
    assert len(found) >= 2 and all(found)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks here")
@pytest.mark.parametrize("fork_s", [PENDING_S, AGAIN_S])
def test_a_fork_learns_by_itself(mission, alone, fork_s):
    """It has no thread that would work on what was begun before, and waited for ever."""
    vehicle, recorded, events = mission
    nav = nf.Navigator(vehicle, recorded.start)
    fed(nav, [event for event in events if event.time_s <= fork_s])
    rest = [event for event in events if event.time_s > fork_s]
    read, write = os.pipe()
    child = os.fork()
    if not child:
        signal.alarm(60)
        fed(nav, rest)
        os.write(write, nav.filter.nav.tobytes())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as answer:
        told = answer.read()
    assert os.waitpid(child, 0)[1] == 0
    assert told == alone[1].filter.nav.tobytes()
    fed(nav, rest)
    assert told == nav.filter.nav.tobytes()

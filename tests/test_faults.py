"""Every kind of fault once, in a short mission: nothing raises, no NaN, the covariance positive definite, every reading
answered.
"""

import math

import faults_library as library
import faults_run as watched
import numpy as np
import pytest
from feeding import events_of

from navfilter.simulation.scenarios import simulate_scenario

#: What the navigator does not notice, though it survives it: the day it does, the test says so.
UNNOTICED: dict[str, str] = {}
WINDOW, FIXES, DURATION_S = (15.0, 30.0), (15.0, 30.0), 40.0


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = watched.simulated(1, DURATION_S, fixes=((0.0, 1e9),))
    scene = library.scene_of(vehicle, WINDOW, FIXES)
    return vehicle, mission, scene, run(None, vehicle, mission, scene, 0.5)


def run(name, vehicle, mission, scene, check_s):
    """As long as it takes: how fast the machine is, and what is compiled first, is no business of a test."""
    return watched.run(name, vehicle, mission, scene, 1, check_s=check_s, longest_cpu_s=math.inf)


def sound(outcome):
    assert outcome.crashes == {}
    assert outcome.nan_s is None and outcome.not_definite_s is None and outcome.smallest > 0.0
    assert outcome.sent == outcome.answered


def test_without_a_fault_nothing_is_counted(dive):
    *_, mission, _, clean = dive
    sound(clean)
    assert {
        name
        for name, n in clean.counts.items()
        if n and not name.endswith((":used", ":rejected", " is good", " is waiting"))
    } == set()
    assert (
        max(watched.nees(clean, mission.truth, 10.0).values()) < 3.0
    )  # a mean over one minute of one run: its 3 to 9 components are few


@pytest.mark.parametrize("name", library.KINDS)
def test_every_kind_is_survived_and_counted(dive, name):
    vehicle, mission, scene, clean = dive
    outcome = run(name, vehicle, mission, scene, 0.5)
    sound(outcome)
    more = outcome.counts - clean.counts
    counted = library.KINDS[name].counted
    noticed = not counted or any(more[key] for key in counted)
    assert noticed == (name not in UNNOTICED), (
        f"none of {counted} in {dict(more)}" if not noticed else f"{name} is noticed now: {dict(more)}"
    )


def test_a_fault_leaves_everything_outside_its_window_alone(dive):
    """The library itself: what it changes lies in the window, and the events it was given are as they were."""
    vehicle, mission, scene, _ = dive
    events = [e for e in events_of(vehicle, mission) if 12.0 < e.true_s < 33.0]
    before = list(events)
    for name in library.KINDS:
        damaged = library.damaged(name, events, scene, 1)
        assert events == before, name
        assert damaged != events, name
        early = [e for e in damaged if e.true_s < WINDOW[0] and e.arrival_s < WINDOW[0]]
        assert early == [e for e in events if e.true_s < WINDOW[0]], name
        again = library.damaged(name, events, scene, 1)
        assert len(again) == len(damaged), name
        assert all(a == b or repr(a) == repr(b) for a, b in zip(again, damaged, strict=True)), (
            name
        )  # NaN is not equal to itself


def test_dead_reckoning_is_not_brought_down_either():
    """A vehicle without an inertial unit: the faults of compass and DVL are faults of its drive."""
    vehicle, mission = simulate_scenario("reckoning", 1, DURATION_S)
    scene = library.scene_of(vehicle, WINDOW, FIXES)
    for name in library.KINDS:
        outcome = run(name, vehicle, mission, scene, 1.0)
        assert outcome.crashes == {} and outcome.nan_s is None and outcome.not_definite_s is None, name
        assert np.isfinite([state.sd for _, state in outcome.states]).all(), name

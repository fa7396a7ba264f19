"""What is said of a sensor, and how soon: within 10 s."""

import math
from dataclasses import replace

import numpy as np
import pytest
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.models.health import CALM
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.track.track import spells

FAULT_S, END_S = 20.0, 40.0


@pytest.fixture(scope="module")
def mission():
    return simulate_scenario("lawnmower", 3, END_S)


def said(vehicle, mission, events, sensor):
    """Second by second, from the fault on."""
    nav, due, found = nf.Navigator(vehicle, mission.start, threads=False), FAULT_S, []
    for event in events:
        if event.time_s >= due:
            found.append(nav.state.health)
            due += 1.0
        one_by_one(nav, [event])
    return [(health.sensors[sensor].condition, health.trust.level) for health in found]


def after(found, condition):
    """So many seconds after the fault it was said."""
    return next((k for k, (one, _) in enumerate(found) if one == condition), math.inf)


@pytest.mark.parametrize(("sensor", "rate_hz"), [("dvl", 4.0), ("depth", 1.0), ("compass", 8.0)])
def test_one_that_is_not_heard_is_silent(mission, sensor, rate_hz):
    vehicle, mission = mission
    assert vehicle.sensors[sensor].rate_hz == rate_hz
    events = [e for e in events_of(vehicle, mission) if e.sensor != sensor or e.time_s < FAULT_S]
    found = said(vehicle, mission, events, sensor)
    assert 5 <= after(found, "silent") <= 9
    assert found[-1][1] == "degraded" and found[2] == ("good", "good")


@pytest.mark.parametrize("sensor", ["dvl", "depth", "compass"])
def test_one_that_does_not_change_is_stuck(mission, sensor):
    vehicle, mission = mission
    events = list(events_of(vehicle, mission))
    value = next(e.value for e in events if e.sensor == sensor and e.time_s >= FAULT_S)
    stuck = [e._replace(value=value) if e.sensor == sensor and e.time_s >= FAULT_S else e for e in events]
    assert 8 <= after(said(vehicle, mission, stuck, sensor), "stuck") <= 10


def test_one_of_which_a_component_fails_is_partial_and_used(mission):
    vehicle, mission = mission
    events = [
        e._replace(value=(e.value[0], e.value[1], math.nan)) if e.sensor == "dvl" and e.time_s >= FAULT_S else e
        for e in events_of(vehicle, mission)
    ]
    found = said(vehicle, mission, events, "dvl")
    assert 5 <= after(found, "partial") <= 7
    assert found[-1] == ("partial", "good") and "partial" in CALM


def test_one_that_never_had_more_components_is_good(mission):
    vehicle, mission = mission
    events = [
        e._replace(value=(e.value[0], e.value[1], math.nan)) if e.sensor == "dvl" else e
        for e in events_of(vehicle, mission)
    ]
    assert {condition for condition, _ in said(vehicle, mission, events, "dvl")} == {"good"}


def test_a_sensor_that_speaks_seldom_is_given_its_time():
    assert SensorMonitor.of(nf.Depth(rate_hz=8.0)).silent_s == 5.0
    assert SensorMonitor.of(nf.Depth(rate_hz=0.5)).silent_s == 16.0
    assert SensorMonitor.of(nf.Depth(rate_hz=0.01)).silent_s == nf.Depth().gate_timeout_s


@pytest.mark.parametrize(("outliers", "noisy"), [(1, False), (2, False), (6, True)])
def test_an_outlier_is_no_noise(mission, outliers, noisy):
    """Each is off by 5 m/s, half a second after the one before. One by itself made a DVL noisy for ten seconds."""
    vehicle, mission = mission
    dvl, wild = mission.streams["dvl"], FAULT_S + 0.5 * np.arange(outliers)
    value = dvl.value.copy()
    value[np.abs(dvl.time_s[:, None] - wild).min(axis=1) < 0.01, 0] += 5.0
    assert np.sum(value != dvl.value) == outliers
    mission = replace(mission, streams={**mission.streams, "dvl": replace(dvl, value=value)})
    found = said(vehicle, mission, events_of(vehicle, mission), "dvl")
    assert any(one == "noisy" for one, _ in found) == noisy
    if not noisy:
        assert set(found) == {("good", "good")}
    # a replay says the same; the first reading by itself made one in two missions begin with noise
    reasons = " ".join(spell.reason for spell in spells(nf.replay(vehicle, mission)))
    assert ("dvl is noisy" in reasons) == noisy

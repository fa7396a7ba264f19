"""Jumps of the inertial unit's biases: it is blamed for what it does and not for what sensors do, and the vehicle
outlives it.
"""

import math

import numpy as np
import pytest

import navfilter as nf
from navfilter.simulation.scenarios import lawnmower, simulate_scenario, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG, MILLI_G = math.pi / 180.0, 9.80665e-3


def heard(vehicle, mission, until_s):
    """A navigator fed until a time."""
    nav = nf.Navigator(vehicle, mission.start, history_s=0.0)
    feed(nav, mission, until_s)
    return nav


def feed(nav, mission, until_s, since_s=-1.0):
    events = [
        (t, name != "imu", name, row)
        for name, stream in mission.streams.items()
        if name == "imu" or name in nav.vehicle.sensors
        for t, row in zip(stream.time_s.tolist(), stream.value, strict=True)
        if since_s < t <= until_s
    ]
    for t, _, name, row in sorted(events, key=lambda e: e[:3]):
        if name == "imu":
            nav.step(t, row[:3].tolist(), row[3:].tolist())
        else:
            nav.correct(name, t, row)


@pytest.fixture(scope="module")
def dive():
    vehicle = survey_vehicle()
    vehicle = vehicle.with_error(compass=vehicle.sensors["compass"].error + nf.White(sd=0.1 * DEG))
    return vehicle, simulate(vehicle, lawnmower(240.0), seed=3, duration_s=240.0, faults={"gps": Faults()})


def shifted(mission, column, by, begin_s, end_s):
    stream = mission.streams["imu"]
    value = stream.value.copy()
    value[(stream.time_s >= begin_s) & (stream.time_s < end_s), column] += by
    return mission.with_stream("imu", nf.Stream(stream.time_s, value))


@pytest.mark.parametrize(
    ("column", "by"), [(3, 50 * MILLI_G), (4, -50 * MILLI_G), (2, 0.1), (0, -0.05)], ids=["ax", "ay", "gz", "gx"]
)
def test_a_bias_that_jumps_and_returns_is_outlived(dive, column, by):
    vehicle, mission = dive
    faulty = shifted(mission, column, by, 100.0, 130.0)
    tracks = nf.replay(vehicle, mission), nf.replay(vehicle, faulty)
    times = np.arange(1.0, 239.0)
    apart = [
        np.diff([np.interp(times, t.time_s, getattr(t, x)) for t in tracks], axis=0) for x in ("latitude", "longitude")
    ]
    # without a remedy: 50 mg for 30 s are 220 m, and a heading that is off by 6 deg/s turns all that follows
    assert 6.37e6 * np.hypot(*apart).max() < 8.0


@pytest.mark.parametrize("fault", ["step", "stuck", "noise", "scale"])
def test_sensors_are_not_the_drive(dive, fault):
    """What the compass or the DVL does is not taken for the inertial unit's."""
    vehicle, mission = dive
    name = "dvl" if fault == "scale" else "compass"
    stream = mission.streams[name]
    value = stream.value.copy()
    inside = (stream.time_s > 100.3) & (stream.time_s < 130.0)
    rng = np.random.default_rng(1)
    value[inside] = {
        "step": value[inside] + 25.0 * DEG,
        "stuck": np.broadcast_to(value[inside][0], value[inside].shape),
        "noise": value[inside] + 6.0 * DEG * rng.normal(size=value[inside].shape),
        "scale": -value[inside],
    }[fault]
    nav = heard(vehicle, mission.with_stream(name, nf.Stream(stream.time_s, value)), 150.0)
    assert nav.counts["contradicted"] == 0


@pytest.mark.parametrize("scenario", ["turns", "mems"])
def test_nothing_is_blamed_without_a_fault(scenario):
    vehicle, mission = simulate_scenario(scenario, 5, 600.0)
    nav = heard(vehicle, mission, 600.0)
    assert nav.counts["contradicted"] == 0 and set(nav.health.axes.values()) == {"good"}

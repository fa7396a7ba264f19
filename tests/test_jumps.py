"""Jumps of the inertial unit's biases, from innovations: the likelihood ratio is that of the dense problem, the drive
is blamed for what it does and not for what sensors do, and the vehicle outlives it.
"""

import dataclasses
import math

import naive
import numpy as np
import pytest

import navfilter as nf
from navfilter.filter.events import Correction
from navfilter.kernels import bias_glr
from navfilter.simulation.faults import Faults
from navfilter.simulation.scenarios import lawnmower, simulate_scenario, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG, MILLI_G = math.pi / 180.0, 9.80665e-3


def checked(vehicle):
    """The same vehicle, its inertial unit held against compass and DVL."""
    return nf.Vehicle(dataclasses.replace(vehicle.drive, cross_check=True), vehicle.sensors, vehicle.name)


def heard(vehicle, mission, until_s, look):
    """A navigator fed until a time, and what `look` makes of each correction's channel."""
    nav, seen = nf.Navigator(vehicle, mission.start, history_s=0.0), []
    told = nav.on_event

    def tell(event, value=None):
        if isinstance(event, Correction) and event.channel is not None:
            seen.append(look(nav, event.channel))
        told(event, value)

    nav.on_event = tell
    feed(nav, mission, until_s)
    return nav, seen


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
    vehicle = checked(vehicle.with_error(compass=vehicle.sensors["compass"].error + nf.White(sd=0.1 * DEG)))
    return vehicle, simulate(vehicle, lawnmower(240.0), seed=3, duration_s=240.0, faults={"gps": Faults()})


def test_the_kernels_and_their_twins(dive):
    vehicle, mission = dive
    ratios = []

    def look(nav, channel):
        n, offset = nav.filter.layout.size, nav.filter.monitor.glr._rows[channel.name]
        bank = np.random.default_rng(len(ratios)).normal(size=(16, n + 3))
        bank[:, -1] = 1.3
        args = channel.mem, channel.dims, channel.places, offset, len(ratios) % 3 != 0
        mine, twin = bank.copy(), bank.copy()
        ratios.append(bias_glr.update_jumps(mine, *args))
        np.testing.assert_allclose(naive.update_jumps(twin, *args), ratios[-1], rtol=1e-9)
        np.testing.assert_allclose(mine[:-2], twin[:-2], rtol=1e-9, atol=1e-9)
        Phi = channel.transition.copy()
        bias_glr.propagate_jumps(mine, Phi)
        naive.propagate_jumps(twin, Phi)
        np.testing.assert_allclose(mine[:-2], twin[:-2], rtol=1e-9, atol=1e-9)

    heard(vehicle, mission, 8.0, look)
    assert len(ratios) > 80 and max(ratios) > 1.0


def test_the_error_of_a_jump_is_what_two_filters_differ_by(dive):
    """A bias put into the samples makes the error f times its size, to the order of its square."""
    vehicle, mission = dive
    size, begin_s, until_s = 2e-5, 20.0, 21.4
    stream = mission.streams["imu"]
    value = stream.value.copy()
    value[stream.time_s > begin_s, 2] += size
    runs = []
    for m in (mission, mission.with_stream("imu", nf.Stream(stream.time_s, value))):
        nav = nf.Navigator(vehicle, m.start, history_s=0.0)
        feed(nav, m, begin_s)
        for bank in nav.filter.memory.monitor.bias_glr:
            nav.filter.monitor.glr._begin(bank, nav.filter.layout)
        nav.filter.monitor.glr._begin = lambda bank, layout: None
        feed(nav, m, until_s, begin_s)
        runs.append(nav)
    f = runs[1].filter.memory.monitor.bias_glr[0, 2, : runs[1].filter.layout.size]
    # the samples since the last correction are not in f yet: none, for a compass reads at the end
    apart = runs[0].state.minus(runs[1].state)
    # the covariance follows the velocity that the bias makes, which is not in f either: 2 % of it
    np.testing.assert_allclose(apart[8], size * f[8], rtol=0.03)
    np.testing.assert_allclose((runs[0].filter.x - runs[1].filter.x)[2], size * (f[11] - 1.0), rtol=0.05, atol=1e-9)


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
    # two seconds until it is found, then 10 to 20 s of dead reckoning at 1.5 m/s, twice
    assert 6.37e6 * np.hypot(*apart).max() < 4.0
    nav, _ = heard(vehicle, faulty, 103.0, lambda nav, channel: None)
    assert nav.counts["contradicted"] == 6 and nav.state.lane == "dead-reckoning"
    assert set(nav.health.axes.values()) == {"contradicted"}
    feed(nav, faulty, 230.0, 103.0)
    assert nav.state.lane == "inertial" and set(nav.health.axes.values()) == {"good"}


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
    nav, _ = heard(vehicle, mission.with_stream(name, nf.Stream(stream.time_s, value)), 150.0, lambda *_: None)
    assert nav.counts["contradicted"] == 0


@pytest.mark.parametrize("scenario", ["turns", "mems"])
def test_nothing_is_blamed_without_a_fault(scenario):
    vehicle, mission = simulate_scenario(scenario, 5, 600.0)
    nav, _ = heard(checked(vehicle), mission, 600.0, lambda *_: None)
    assert nav.counts["contradicted"] == 0 and set(nav.health.axes.values()) == {"good"}


def test_without_a_compass_nothing_is_left_out(dive):
    """There would be nothing to carry the heading."""
    vehicle, mission = dive
    nav, _ = heard(vehicle.without("compass"), shifted(mission, 3, 50 * MILLI_G, 60.0, 80.0), 90.0, lambda *_: None)
    assert nav.counts["contradicted"] == 0


def test_a_snapshot_taken_while_left_out_goes_on_to_the_last_bit(dive):
    vehicle, mission = dive
    faulty = shifted(mission, 3, 50 * MILLI_G, 60.0, 240.0)
    nav = nf.Navigator(vehicle, mission.start)
    feed(nav, faulty, 64.0)
    assert nav.state.lane == "dead-reckoning"
    again = nf.Navigator.restore(vehicle, nav.snapshot())
    for one in (nav, again):
        feed(one, faulty, 90.0, 64.0)
    np.testing.assert_array_equal(nav.filter.P, again.filter.P)
    np.testing.assert_array_equal(nav.filter.memory.monitor.bias_glr, again.filter.memory.monitor.bias_glr)

"""A drive that leaves a velocity sensor behind is left out; a sensor that was never right accuses nobody."""

import math

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.faults import velocity_evidence
from navfilter.faults.sensor_bias import add_rejection
from navfilter.navigation import runner
from navfilter.simulation.faults import Faults
from navfilter.simulation.scenarios import simulate_scenario, survey, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG, METRES = math.pi / 180.0, 6.37e6
FAULT_S = 120.0


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 3, 220.0)
    mission = mission.hide("gps", (60.0, 1e9))
    return vehicle, mission, nf.replay(vehicle, mission)


def spoiled(mission, change, name="imu", begin_s=FAULT_S):
    stream = mission.streams[name]
    value = stream.value.copy()
    late = stream.time_s >= begin_s
    value[late] = change(value[late])
    return mission.with_stream(name, nf.Stream(stream.time_s, value, stream.columns))


def accuses(dive, shape, seed, speed=lambda age_s: 1.5, count=12, sd=0.01, first_s=0.0, described=True):
    """Force by which refused velocities of this shape, in axes that point north, say that the unit has run away."""
    vehicle, mission, _ = dive
    filter, rng = nf.Navigator(vehicle, mission.start).filter, np.random.default_rng(seed)
    channel = filter.channels["dvl"]
    channel.near[:, 3:6], channel.R[:], channel.S[:3] = np.eye(3), 1e-4 * np.eye(3), 2e-4 * np.eye(3)
    channel.faults.rejected_since_s = 100.0 + first_s
    for age_s in first_s + 0.25 * np.arange(count):
        filter.memory.nav[3:6] = speed(age_s), 0.0, 0.0
        channel.res[:] = np.array(shape(age_s)) + sd * rng.normal(size=3)
        channel.faults.evidence = velocity_evidence.with_refused(filter, channel, 100.0 + age_s)
    return velocity_evidence.force(channel, described)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    ("shape", "sd", "speed"),
    [
        (lambda age: (0.3, -0.2, 0.0), 0.01, lambda age: 1.5),  # it tracks the water, or its scale has jumped
        (lambda age: (0.0, 0.0, 0.0), 0.1, lambda age: 1.5),  # ten times its noise
        (lambda age: (0.2 * age, 0.0, 0.0), 0.01, lambda age: 0.2 * age),  # another unit, on a vehicle that speeds up
        (lambda age: (-0.4 * age, 0.0, 0.0), 0.01, lambda age: 0.2 * age),  # another sign
    ],
)
def test_what_is_off_for_another_reason_is_no_force(dive, shape, sd, speed, seed):
    assert accuses(dive, shape, seed, speed, 24, sd) is None


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("late_s", [2.0, 5.0])
def test_one_that_is_late_on_a_vehicle_that_speeds_up_tells_no_force(dive, late_s, seed):
    """Of a sensor that nobody had tried for long, whose description is a rival; it is heard for ten seconds first."""

    def shape(age):
        return -0.2 * min(age, late_s), 0.0, 0.0

    assert accuses(dive, shape, seed, lambda age: 1.5 + 0.2 * age, 44, described=False) is None


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("slope", "first_s"), [(0.05, 0.0), (0.5, 0.0), (4.0, 0.0), (0.5, 7.0)])
def test_what_grows_from_nothing_is_a_force(dive, slope, first_s, seed):
    def shape(age):
        return 0.6 * slope * (age - first_s), -0.8 * slope * (age - first_s), 0.0

    assert accuses(dive, shape, seed, first_s=first_s) == pytest.approx(slope, rel=0.3)


@pytest.mark.parametrize(
    ("name", "change", "times"),
    [
        ("gyro x +400 deg/h", lambda v: v + np.eye(6)[0] * 400.0 * DEG / 3600.0, 1),
        ("accelerometer y +50 mg", lambda v: v + np.eye(6)[4] * 0.49, 1),
        ("gyros x and z exchanged", lambda v: v[:, [2, 1, 0, 3, 4, 5]], 4),  # no bias: left out again and again
    ],
)
def test_a_unit_that_leaves_the_dvl_behind_is_left_out(dive, name, change, times):
    vehicle, mission, clean = dive
    track = nf.replay(vehicle, spoiled(mission, change))
    assert 1 <= track.counts["contradicted"] / 6 <= times, name
    late = track.time_s >= FAULT_S
    apart = [
        METRES * (getattr(track, x)[late] - np.interp(track.time_s[late], clean.time_s, getattr(clean, x)))
        for x in ("latitude", "longitude")
    ]
    assert np.hypot(*apart).max() < 5.0
    assert track.summary(mission.truth)["nees_position"] < 3.0
    assert clean.counts["contradicted"] == 0
    if name.startswith("gyro x"):
        found = dict(zip(track.state_names, track.states[-1], strict=True))["gyro_x[0]"]
        assert found == pytest.approx(400.0 * DEG / 3600.0, rel=0.2)


def test_a_dvl_that_is_let_in_now_and_then_on_a_slow_ramp_has_not_jumped():
    """Exchanged accelerometers feel a level vehicle's bias and trim on the wrong axis: the ramp is slow at first."""
    fixes = {"gps": Faults(available=((0.0, 140.0),))}
    vehicle = survey_vehicle()
    mission = simulate(vehicle, survey(700.0, surface_s=110.0), seed=4, duration_s=360.0, faults=fixes)
    track = nf.replay(vehicle, spoiled(mission, lambda v: v[:, [0, 1, 2, 4, 3, 5]], begin_s=250.0))
    assert np.nanmax(track.errors(mission.truth).horizontal[track.time_s > 250.0]) < 15.0  # 780 m if the DVL is blamed
    assert track.counts["contradicted"] > 0 and track.counts["jumped"] == 0


@pytest.mark.parametrize(("disputed_s", "jumped"), [(-math.inf, False), (50.0, True)])
def test_only_one_that_was_right_for_long_is_refused_now_and_then_without_a_jump(dive, disputed_s, jumped):
    vehicle, mission, _ = dive
    nav = nf.Navigator(vehicle, mission.start)
    channel = nav.filter.channels["dvl"]
    kept, channel.verdict[:2], channel.res[:] = channel.faults, (1e4, 3.0), (0.5, 0.0, 0.0)
    kept.agreed_s, channel.memory.used_s, kept.disputed_s = 0.0, 99.75, disputed_s
    kept.refused_s, kept.rejected_since_s = 99.5, 100.0
    assert add_rejection(channel, nav.filter.P, 1.5, 100.0, nav.filter.drive_output, 0.01).jumped is jumped
    kept.refused_s = 90.0
    assert add_rejection(channel, nav.filter.P, 1.5, 100.0, nav.filter.drive_output, 0.01).jumped


@pytest.mark.parametrize(
    "change",
    [lambda v: 1e3 * v, lambda v: 1.94 * v, lambda v: v * [1.0, -1.0, 1.0], lambda v: np.roll(v, 20, axis=0)],
    ids=["mm/s", "knots", "mirrored", "5 s late"],
)
def test_a_sensor_that_was_never_right_accuses_nobody(dive, change):
    vehicle, mission, _ = dive
    track = nf.replay(vehicle, spoiled(mission, change, "dvl", 0.0))
    assert track.counts["contradicted"] == 0


def test_in_stretches_as_one_by_one(dive, monkeypatch):
    vehicle, mission, _ = dive
    wrong = spoiled(mission, lambda v: v + np.eye(6)[3] * 0.49).between(0.0, 150.0)
    together = nf.replay(vehicle, wrong)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    alone = nf.replay(vehicle, wrong)
    np.testing.assert_array_equal(together.covariance, alone.covariance)
    assert together.counts == alone.counts and together.counts["contradicted"] == 6


def test_restored_while_it_is_refused_it_goes_on_as_before(dive):
    vehicle, mission, _ = dive
    events = [e for e in events_of(vehicle, spoiled(mission, lambda v: v + np.eye(6)[3] * 0.49)) if e.time_s < 135.0]
    whole, half = (nf.Navigator(vehicle, mission.start) for _ in range(2))
    one_by_one(whole, events)
    one_by_one(half, [e for e in events if e.time_s <= FAULT_S + 1.3])
    assert half.filter.channels["dvl"].faults.evidence is not None
    again = nf.Navigator.restore(vehicle, half.snapshot())
    one_by_one(again, [e for e in events if e.time_s > FAULT_S + 1.3])
    same_runs.assert_same_bits(whole, again)
    assert whole.health.axes["accel_x"] in ("contradicted", "good") and whole.counts["contradicted"] == 6

"""The way of a velocity that is refused: in the bound until a fix tells, and followed where the state was wrong."""

import dataclasses
import functools
import math

import faults_library as library
import faults_run as watched
import numpy as np
import pytest
import same_runs
from feeding import DRIVE, events_of, once_a_second

import navfilter as nf
from navfilter.faults import alternative_path, innovation_gate
from navfilter.faults import settings as fault_settings
from navfilter.faults.alternative_path import AlternativePath, believable, followed, follows, since_fix, with_rejected
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG, RADIUS_M = math.pi / 180.0, 6.371e6
FAULT_S, END_S = 250.0, 420.0


@functools.cache
def dive(seed, mems):
    """Fixes for 140 s, then none."""
    vehicle = survey_vehicle(mems=mems)
    fixes = {"gps": Faults(available=((0.0, 140.0),))}
    return vehicle, simulate(vehicle, survey(700.0, surface_s=110.0), seed=seed, duration_s=END_S, faults=fixes)


@pytest.fixture
def refusing():
    """A navigator whose DVL says that it makes 0.4 m/s north and 0.3 m/s east more than the state."""
    vehicle, mission = dive(1, False)
    nav = nf.Navigator(vehicle, dataclasses.replace(mission.start, heading_deg=0.0, pitch_deg=0.0, roll_deg=0.0))
    channel = nav.filter.channels["dvl"]
    channel.near[:, 3:6], channel.note[3:6] = np.eye(3), (0.4, 0.3, 0.0)
    channel.faults.rejected_since_s = 10.0
    return nav.filter, channel


def test_the_residuals_are_integrated_from_the_second_refused_reading_on(refusing):
    filter, channel = refusing
    for time_s in (10.0, 10.5, 11.0, 30.0):
        channel.faults.way = with_rejected(filter, channel, time_s)
    # half a second twice, and one that speaks for a second after a long silence
    way = channel.faults.way
    assert (way.time_s, way.north, way.east) == pytest.approx((30.0, 0.8, 0.6))
    assert way.length == pytest.approx(1.0)
    assert since_fix(filter, channel) == way
    filter.channels["gps"].memory.used_s = 31.0
    assert since_fix(filter, channel) == AlternativePath()


def test_one_that_has_jumped_counts_as_far_as_its_constants_do_not_explain_it(refusing, monkeypatch):
    filter, channel = refusing
    channel.offset = True
    monkeypatch.setattr(channel, "jumped_by", lambda x: np.array([2.0, 0.0, 0.0]))
    for time_s in (10.0, 10.5, 11.0):
        channel.faults.way = with_rejected(filter, channel, time_s)
    assert channel.faults.way.north == pytest.approx(2.4) and channel.faults.way.length == pytest.approx(0.5)
    channel.faults.aside = True
    assert with_rejected(filter, channel, 11.5).length == pytest.approx(0.5)


def test_wheels_that_are_refused_beside_their_constants_hold_the_position():
    """Two accelerometers are exchanged: the wheels seem to have jumped, and are refused all the same for 20 s."""
    plain = survey_vehicle()
    sideways = nf.White(sd=0.05)
    wheels = nf.Odometer(rate_hz=10.0, error=(nf.White(sd=0.02), sideways, sideways))
    vehicle = dataclasses.replace(plain, sensors={**plain.sensors, "dvl": wheels})
    fixes = {"gps": Faults(available=((0.0, 140.0),))}
    mission = simulate(vehicle, survey(700.0, surface_s=110.0), seed=1, duration_s=310.0, faults=fixes)
    exchanged = mission.streams["imu"].value.copy()
    late = mission.streams["imu"].time_s >= FAULT_S
    exchanged[late, 3:5] = exchanged[late][:, [4, 3]]
    imu = mission.streams["imu"]
    broken = mission.with_stream("imu", nf.Stream(imu.time_s, exchanged, imu.columns))
    nav, most = nf.Navigator(vehicle, mission.start), 0.0
    for state in once_a_second(nav, vehicle, broken):
        off = math.hypot(*state.minus(watched.truth_at(mission.truth, state.time_s))[:2])
        assert off <= state.bounds.horizontal_m, state.time_s
        most = max(most, off)
    assert most > 10.0


def test_what_no_vehicle_can_do_does_not_count(refusing):
    filter, channel = refusing
    channel.note[3:6] = 1500.0, 0.0, 0.0
    channel.faults.way = AlternativePath(10.0, 0.8, 0.6, 1.0)
    assert with_rejected(filter, channel, 10.25) == AlternativePath(10.25, 0.8, 0.6, 1.0)
    # a vehicle of 4 m/s that is stated to make 5 may have turned back; one that says nothing may make twice as much
    assert believable(np.array([8.9, np.nan, 0.0]), 4.0, 5.0) and not believable(np.array([9.1, 0.0, 0.0]), 4.0, 5.0)
    assert believable(np.array([11.9, 0.0, 0.0]), 4.0, None) and not believable(np.array([12.1, 0.0, 0.0]), 4.0, None)


def test_where_the_state_was_wrong_the_position_follows(refusing):
    filter, channel = refusing
    filter.memory.P[8, 8] = 0.02**2
    channel.faults.way = AlternativePath(10.0, 30.0, 40.0, 60.0)
    before = filter.memory.nav[:3].copy()
    prior = filter.memory.P[:2, :2].copy()
    filter.act(followed(filter, channel), lambda _: None)
    variance = filter.memory.P[:2, :2] - prior
    moved = (filter.memory.nav[:3] - before) * [RADIUS_M, RADIUS_M * math.cos(before[0]), 1.0]
    np.testing.assert_allclose(moved, [30.0, 40.0, 0.0], rtol=5e-3)
    # a tenth of 50 m along it; across it 0.02 rad beside that
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    assert along @ variance @ along == pytest.approx(25.0) and across @ variance @ across == pytest.approx(26.0)
    # once; the bound goes on reckoning with it
    assert channel.faults.way == AlternativePath(10.0, 0.0, 0.0, 60.0)
    np.testing.assert_array_equal(follows(filter, channel), np.zeros((2, 2)))


def fly(seed, mems, fault):
    """Horizontal error, bound, errors of attitude and their sd by the second, and what was counted."""
    vehicle, mission = dive(seed, mems)
    events = fault(vehicle, [e for e in events_of(vehicle, mission) if e.true_s >= mission.start.time_s - 1e-9])
    nav = nf.Navigator(vehicle, mission.start)
    outcome = watched.watch(nav, events, library.scene_of(vehicle, (0.0, 1.0), (0.0, 1.0)), longest_cpu_s=120.0)
    rows = []
    for time_s, state in outcome.states:
        if FAULT_S <= time_s < END_S:
            error = state.minus(watched.truth_at(mission.truth, time_s))
            rows.append((math.hypot(error[0], error[1]), state.bounds.horizontal_m, *error[6:9], *state.sd[6:9]))
    return np.array(rows), nav


def values(change):
    def fault(vehicle, events):
        return [
            e._replace(value=tuple(np.asarray(change(np.array(e.value))).tolist()))
            if e.sensor == DRIVE and e.true_s >= FAULT_S
            else e
            for e in events
        ]

    return fault


def bursts(vehicle, events):
    scene = library.scene_of(vehicle, (FAULT_S, FAULT_S + 60.0), (540.0, 580.0))
    return library.damaged("bursts stamped on receipt", events, scene, 1)


@pytest.mark.parametrize(
    ("seed", "mems", "fault", "most_m"),
    [
        # before: 27 m and 5 to 7 standard deviations of attitude; 1,005 m; 1,086 m beyond the bound
        (3, True, values(lambda v: v * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]), 20.0),
        (3, True, values(lambda v: v[[0, 1, 2, 4, 3, 5]]), 20.0),
        (2, False, bursts, 20.0),
    ],
    ids=["gyro z mirrored", "accelerometers exchanged", "stamped in bursts"],
)
def test_a_drive_that_runs_away_does_not_take_the_position_along(seed, mems, fault, most_m):
    rows, nav = fly(seed, mems, fault)
    assert rows[:, 0].max() < most_m
    assert np.mean(rows[:, 0] <= rows[:, 1]) >= 0.999
    assert math.hypot(*nav.filter.memory.nav[3:6].tolist()) < 3.0
    # of attitude, at the end: chi-square with three degrees of freedom
    late = rows[-60:]
    assert np.median(np.sum((late[:, 2:5] / late[:, 5:8]) ** 2, axis=1)) < 7.8


def test_two_compasses_that_are_refused_are_right_beside_a_gyro_of_another_sign():
    """At once, or the unit is left out before they could turn the heading: either way it is never far off."""
    plain = survey_vehicle(mems=True)
    vehicle = nf.Vehicle(plain.drive, {**plain.sensors, "compass2": plain.sensors["compass"]})
    fixes = {"gps": Faults(available=((0.0, 140.0),))}
    mission = simulate(vehicle, survey(700.0, surface_s=110.0), seed=3, duration_s=330.0, faults=fixes)
    events = values(lambda v: v * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0])(vehicle, events_of(vehicle, mission))
    nav, off_deg = nf.Navigator(vehicle, mission.start), []
    for event in events:
        hand(nav, [event])
        if event.true_s > 150.0:
            state = nav.state
            off_deg.append(abs(math.degrees(state.minus(watched.truth_at(mission.truth, state.time_s))[8])))
    assert np.median(off_deg) < 1.0 and max(off_deg) < 6.0


def test_a_velocity_that_a_wider_gate_lets_in_opens_the_velocity_alone():
    """It is read through the attitude, too: where nothing else tells that, one that was stamped a second late turned
    the heading of a real dive by 50 deg, and the vehicle 100 m off.
    """
    vehicle, mission = dive(1, False)
    nav = nf.Navigator(vehicle, mission.start)
    hand(nav, [e for e in events_of(vehicle, mission) if e.true_s < 100.0])
    filter, channel = nav.filter, nav.filter.channels["dvl"]
    channel.faults.rejected_since_s, dof = 100.0, 3
    nis, time_s = 2.0 * channel.limits[dof], 100.0 + channel.sensor.gate_timeout_s
    added = innovation_gate.widening(filter.memory.P, channel, time_s, nis, dof, 0.0)
    widened = np.zeros_like(filter.memory.P)
    widened[added.places, added.places] = added.covariance
    assert np.trace(channel.H @ widened @ channel.H.T) > 0.0
    assert not widened[:3].any() and not widened[6:].any()


def test_velocity_and_fixes_together_are_not_outvoted_by_a_compass():
    vehicle, mission = dive(1, False)
    nav = nf.Navigator(vehicle, mission.start)
    channels = nav.filter.channels
    for channel in channels.values():
        channel.memory.last_s = 99.9
    for name, first, size in (("gps", 0, 90.0), ("dvl", 3, 8.0)):
        channels[name].faults.rejected_since_s = 89.0
        channels[name].near[:, first : first + 3], channels[name].note[3:6] = np.eye(3), (size, 0.0, 0.0)
    assert innovation_gate.state_contradicted(channels.values(), 100.0)
    assert np.sqrt(innovation_gate.reset_variance(channels.values(), 100.0)[[0, 3]]) == pytest.approx([100.0, 10.0])
    channels["compass"].faults.agreed_s = 50.0  # nor is it asked of the heading then
    assert np.sqrt(innovation_gate.reset_variance(channels.values(), 100.0)[6:]) == pytest.approx(
        fault_settings.OPEN_ATTITUDE
    )
    channels["gps"].faults.rejected_since_s = 92.0
    assert not innovation_gate.state_contradicted(channels.values(), 100.0)
    # a residual of another unit says nothing, however long it lasts
    channels["gps"].faults.rejected_since_s, channels["dvl"].note[3:6] = 89.0, (1500.0, 0.0, 0.0)
    assert not innovation_gate.state_contradicted(channels.values(), 100.0)
    assert np.sqrt(innovation_gate.reset_variance(channels.values(), 100.0)[3]) == pytest.approx(2.0)


def test_fixes_alone_contradict_a_state_that_goes_away_from_them():
    vehicle, mission = dive(1, False)
    channels = nf.Navigator(vehicle, mission.start).filter.channels
    gps = channels["gps"]
    for name in ("gps", "compass", "depth"):
        channels[name].memory.last_s = 99.9
    gps.faults.rejected_since_s, gps.note[3:6] = 89.0, (40.0, 0.0, 0.0)
    first = RejectionRun(True, False, (12.0, 0.0, 0.0), (40.0, 0.0, 0.0), (1.0,) * 3, (1.0,) * 3, 89.0, 99.0)
    gps.faults.refused = first
    assert innovation_gate.state_contradicted(channels.values(), 100.0)
    # what grows as the square of the time is twice its mean velocity
    assert np.sqrt(innovation_gate.reset_variance([gps], 100.0)[3]) == pytest.approx(2.0 + 80.0 / 11.0)
    # a tilt that has taken it so far was 2 d / (g t^2); what fixes say of the heading a compass knows better
    assert np.sqrt(innovation_gate.reset_variance([gps], 100.0)[6:]) == pytest.approx(
        [80.0 / (9.81 * 11.0**2)] * 2 + [1.0]
    )
    channels["compass"].faults.agreed_s = 50.0
    assert np.sqrt(innovation_gate.reset_variance(channels.values(), 100.0)[6:])[2] == 0.0
    assert not innovation_gate.state_contradicted(channels.values(), 98.0)
    # not where a velocity is heard, or drives; nor fixes that have jumped
    assert not innovation_gate.state_contradicted(channels.values(), 100.0, inertial=False)
    gps.faults.refused = dataclasses.replace(first, first=(38.0, 0.0, 0.0))
    assert not innovation_gate.state_contradicted(channels.values(), 100.0)
    gps.faults.refused, channels["dvl"].memory.last_s = first, 99.9
    assert not innovation_gate.state_contradicted(channels.values(), 100.0)


def test_the_track_has_the_bound_of_the_run():
    vehicle, mission = dive(1, False)
    stream = mission.streams["dvl"]
    value = stream.value.copy()
    value[(stream.time_s > 200.0) & (stream.time_s < 201.1), 0] += np.linspace(0.5, 1.5, 4)
    wrong = mission.with_stream("dvl", nf.Stream(stream.time_s, value, stream.columns))
    nav = nf.Navigator(vehicle, mission.start)
    hand(nav, [e for e in events_of(vehicle, wrong) if e.time_s <= 230.0])
    way = since_fix(nav.filter, nav.filter.channels["dvl"])
    assert way.length > 0.5 and nav.counts["jumped"] == 0
    frame = nf.replay(vehicle, wrong, output_rate_hz=None).to_frame()
    row = frame.iloc[np.argmin(np.abs(frame.time_s - nav.time_s))]
    assert row.protection_radius_m == pytest.approx(nav.state.bounds.horizontal_m, rel=1e-3)


def test_restored_while_it_is_refused_it_goes_on_as_before():
    vehicle, mission = dive(3, True)
    fault = values(lambda v: v[[0, 1, 2, 4, 3, 5]])
    events = [e for e in fault(vehicle, events_of(vehicle, mission)) if e.time_s < FAULT_S + 20.0]
    whole, half = (nf.Navigator(vehicle, mission.start) for _ in range(2))
    for nav, some in ((whole, events), (half, [e for e in events if e.time_s < FAULT_S + 3.0])):
        hand(nav, some)
    assert half.filter.channels["dvl"].faults.way is not None
    again = nf.Navigator.restore(vehicle, half.snapshot())
    hand(again, [e for e in events if e.time_s >= FAULT_S + 3.0])
    same_runs.assert_same_bits(whole, again)


def hand(nav, events):
    for event in events:
        if event.sensor == DRIVE:
            nav.step(event.time_s, event.value[:3], event.value[3:])
        else:
            nav.correct(event.sensor, event.time_s, event.value)


def test_a_stated_speed_is_the_most():
    assert alternative_path.most_speed(1.0, None) == 3.0 and alternative_path.most_speed(4.0, None) == 8.0
    assert alternative_path.most_speed(4.0, 5.0) == 5.0

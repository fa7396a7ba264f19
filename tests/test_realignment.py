"""A drive that says nothing, or was wrong: others stand in for it, and attitude and velocity are set anew."""

import math
from dataclasses import replace

import numpy as np
import pytest
import same_runs
from feeding import DRIVE, Event, delayed, events_of, in_blocks, one_by_one

import navfilter as nf
from navfilter.faults.imu import realignment
from navfilter.filter.imu_intake import ImuIntake
from navfilter.kernels import imu_checks as kernel
from navfilter.kernels import strapdown
from navfilter.models.state import NavState, matrix_from_euler, rotation_matrix
from navfilter.navigation import runner
from navfilter.simulation.presets import tactical_imu
from navfilter.simulation.scenarios import lawnmower, simulate_scenario, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG, METRES = math.pi / 180.0, 6.37e6
SILENT = (60.0, 80.0)


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 2, 110.0)
    return vehicle, mission.hide("gps", (40.0, 200.0))


def without_drive(mission, begin_s=SILENT[0], end_s=SILENT[1], sensors=()):
    """The mission without a while of the inertial unit, and of sensors."""
    for name in ("imu", *sensors):
        stream = mission.streams[name]
        keep = (stream.time_s < begin_s) | (stream.time_s >= end_s)
        mission = mission.with_stream(name, nf.Stream(stream.time_s[keep], stream.value[keep]))
    return mission


def test_the_drive_is_silent_and_the_vehicle_is_carried_on(dive):
    """DVL and compass carry it; the same dive without a fault is half a metre off."""
    vehicle, mission = dive
    clean, track = (nf.replay(vehicle, m) for m in (mission, without_drive(mission)))
    assert track.counts["silent"] == 6 and track.counts["realigned"] >= 1 and clean.counts["realigned"] == 0
    when = np.arange(62.0, 109.0)
    apart = [
        METRES * (np.interp(when, t.time_s, getattr(t, x)) - np.interp(when, clean.time_s, getattr(clean, x)))
        for x, t in (("latitude", track), ("longitude", track))
    ]
    # unheard for 4 s at 1.5 m/s, on a leg with a turn
    assert np.hypot(*apart).max() < 6.0
    summary = track.summary(mission.truth)
    assert summary["nees_position"] < 3.0


@pytest.mark.parametrize("sensors", [(), ("dvl", "compass", "depth")])
@pytest.mark.parametrize("smooth", [False, True])
def test_in_stretches_as_one_by_one(dive, sensors, smooth, monkeypatch):
    vehicle, mission = dive
    mission = without_drive(mission, sensors=sensors)
    together = nf.replay(vehicle, mission, smooth=smooth)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    alone = nf.replay(vehicle, mission, smooth=smooth)
    np.testing.assert_array_equal(together.covariance, alone.covariance)
    np.testing.assert_array_equal(together.latitude, alone.latitude)
    assert together.counts == alone.counts and together.counts["realigned"] >= 1
    summary = together.summary(mission.truth)
    assert summary["nees_position"] < 3.0


def test_live_late_and_restored_are_the_same(dive, tmp_path):
    """One by one, in blocks, with readings that come late, and from a snapshot in the middle of the silence."""
    vehicle, mission = dive
    events = events_of(vehicle, without_drive(mission))
    navs = [nf.Navigator(vehicle, mission.start) for _ in range(3)]
    one_by_one(navs[0], events)
    in_blocks(navs[1], events, np.random.default_rng(0))
    one_by_one(navs[2], [e for e in events if e.time_s <= 70.3])
    assert navs[2].health.lane == "dead-reckoning" and navs[2].health.axes["gyro_x"] == "silent"
    assert navs[2].time_s > 69.0 and navs[2].state.health.trust.level != "good"
    again = nf.Navigator.restore(vehicle, navs[2].snapshot())
    one_by_one(again, [e for e in events if e.time_s > 70.3])
    for other in (navs[1], again):
        same_runs.assert_same_bits(navs[0], other)
    late = nf.Navigator(vehicle, mission.start)
    outcomes = [o.status for o in one_by_one(late, delayed(events, ("depth",), 1.5, seed=1))]
    assert "late-replayed" in outcomes and "too-late" not in outcomes
    same_runs.assert_same_estimate(navs[0], late)


def test_samples_that_come_after_all_are_too_late(dive):
    """A unit whose samples were held up for longer than it takes to be silent: they are dropped, and the clock is not
    taken for one that was set back.
    """
    vehicle, mission = dive
    events = [
        e._replace(arrival_s=70.0) if e.sensor == DRIVE and 60.0 <= e.time_s < 70.0 else e
        for e in events_of(vehicle, mission)
        if e.time_s < 90.0
    ]
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, sorted(events, key=lambda e: e.arrival_s))
    assert nav.counts["clock-set"] == 0 and 900 <= nav.counts["backward"] <= 1000 and nav.counts["silent"] == 6
    assert nav.health.lane == "inertial" and nav.offset_s == 0.0


def test_a_drive_that_is_late_is_not_silent(dive):
    vehicle, mission = dive
    events = [
        e._replace(arrival_s=e.arrival_s + 3.0) if e.sensor == DRIVE and 60.0 <= e.time_s < 70.0 else e
        for e in events_of(vehicle, mission)
        if e.time_s < 69.9
    ]
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, sorted(events, key=lambda e: e.arrival_s))
    assert nav.counts["silent"] == 0


@pytest.mark.parametrize("stamps", [[3600.0] * 9, [9.0, 90.0, 900.0, 2.0, 7.0], [5.0, 5.0, 5.0, 5.0]])
def test_wild_stamps_make_no_drive_silent(stamps):
    intake = ImuIntake(tactical_imu(), 0.0, dict.fromkeys(("gap", "backward", "bad-sample", "clock-set"), 0))
    assert all(intake.missing(stamp, 0.0) is None for stamp in stamps)


def test_readings_that_agree_make_it_silent():
    intake = ImuIntake(tactical_imu(), 0.0, dict.fromkeys(("gap", "backward", "bad-sample", "clock-set"), 0))
    found = [intake.missing(stamp, 0.0) for stamp in np.arange(1.1, 4.6, 0.5)]
    assert all(one is None for one in found[:-1]) and intake.memory.ahead == len(found)
    steps, stamps = found[-1]
    assert len(stamps) == 410 and np.isnan(steps[:, 1:]).all() and steps[:, 0].sum() == pytest.approx(stamps[-1])


def test_readings_that_agree_on_a_leap_of_hours_carry_nothing():
    """Not even where the drive is known to be silent: for years there would be no memory."""
    intake = ImuIntake(tactical_imu(), 0.0, dict.fromkeys(("gap", "backward", "bad-sample", "clock-set"), 0))
    assert [intake.missing(stamp, 0.0) is None for stamp in np.arange(1.1, 4.6, 0.5)][-1] is False
    assert all(intake.missing(stamp, 4.1) is None for stamp in (5.6e10, 5.6e10, 5.6e10))
    assert intake.missing(4.6, 4.1) is None and len(intake.missing(5.1, 4.1)[1]) == 100


def test_samples_without_values_for_long_are_stood_in_for(dive):
    vehicle, mission = dive
    stream = mission.streams["imu"]
    value = stream.value.copy()
    value[(stream.time_s >= 60.0) & (stream.time_s < 70.0)] = np.nan
    track = nf.replay(vehicle, mission.with_stream("imu", nf.Stream(stream.time_s, value)))
    clean = nf.replay(vehicle, mission)
    assert track.counts["silent"] == 6 and track.counts["bad-sample"] == 1000
    ends = [(t.latitude[-1], t.longitude[-1]) for t in (track, clean)]
    assert METRES * np.abs(np.subtract(*ends)).max() < 1.5


def filter_at_rest(roll_deg, pitch_deg, sd_deg=0.2):
    """A filter that thinks that it is level, after the accelerometers have felt a tilt for some seconds."""
    vehicle = nf.Vehicle(imu=tactical_imu(), sensors={"dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01))})
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=0.0, tilt_sd_deg=sd_deg))
    C = matrix_from_euler(roll_deg * DEG, pitch_deg * DEG, 0.0)
    force = -C[2] * strapdown.gravity(nav.filter.nav[0], 0.0)
    rng = np.random.default_rng(1)
    for k in range(100):
        nav.step(0.01 * (k + 1), 1e-4 * rng.normal(size=3), force + 1e-2 * rng.normal(size=3))
    return nav, C


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(20.0, 0.0), (0.0, -35.0), (12.0, 30.0)])
def test_roll_and_pitch_are_set_by_the_level(roll_deg, pitch_deg):
    nav, C = filter_at_rest(roll_deg, pitch_deg)
    heading_before = nav.state.roll_pitch_heading[2]
    nav.filter.act(realignment.set_anew(nav.filter), nav.on_event)
    apart = NavState.unpack(0.0, nav.filter.nav).C_nb[2] @ C[2]
    assert math.degrees(math.acos(min(apart, 1.0))) < 0.6
    sd = np.degrees(np.sqrt(np.diag(nav.filter.P)[6:8]))
    # 0.3 m/s^2 of unknown acceleration
    np.testing.assert_allclose(sd, math.degrees(0.3 / 9.81), rtol=0.1)
    assert not nav.filter.P[6:8, 8:].any() and not nav.filter.P[6:8, :3].any()
    assert abs(nav.state.roll_pitch_heading[2] - heading_before) < 12.0 * DEG and nav.counts["realigned"] == 1


def test_a_velocity_that_the_level_contradicts_sets_the_tilt_anew():
    """The attitude is wrong by 15 deg with an sd of 0.2: gravity drives the velocity, the DVL is refused; within two
    seconds it is believed, and the tilt is right.
    """
    nav, C = filter_at_rest(0.0, 0.0)
    memory, turn = nav.filter.memory, rotation_matrix(np.array([0.26, 0.0, 0.0]))
    memory.nav[6:15] = (turn @ memory.nav[6:15].reshape(3, 3)).reshape(-1)
    force, statuses = np.array([0.0, 0.0, -strapdown.gravity(memory.nav[0], 0.0)]), []
    rng = np.random.default_rng(2)
    for k in range(100, 1000):
        nav.step(0.01 * (k + 1), 1e-4 * rng.normal(size=3), force + 1e-2 * rng.normal(size=3))
        if k % 25 == 0:
            statuses.append(nav.correct("dvl", 0.01 * (k + 1), 0.01 * rng.normal(size=3)).status)
    assert nav.counts["realigned"] >= 1 and statuses.index("rejected") < 2
    assert set(statuses[12:]) == {"used"}
    assert math.degrees(math.acos(min(nav.state.C_nb[2] @ C[2], 1.0))) < 0.3
    assert np.abs(nav.state.velocity_n).max() < 0.05


def test_a_level_that_is_none_sets_nothing():
    nav, _ = filter_at_rest(10.0, 0.0)
    watch = nav.filter.memory.monitor.imu
    watch[3:6, kernel.MEAN] *= 1.3  # more than gravity
    nav.filter.act(realignment.set_anew(nav.filter), nav.on_event)
    watch[3:6, kernel.MEAN] /= 1.3
    watch[4, kernel.HEEDED] = kernel.STUCK
    nav.filter.act(realignment.set_anew(nav.filter), nav.on_event)
    assert nav.counts["realigned"] == 0


def test_unheard_it_has_gone_no_further_than_it_can(dive):
    """Nothing heard for 20 s: the sd is what 3 m/s, or the stated most, can have done, and no more."""
    vehicle, mission = dive
    mission = without_drive(mission, sensors=("dvl", "compass", "depth"))
    for most, expected in ((None, 3.0), (2.0, 2.0)):
        imu = replace(tactical_imu(), max_speed_m_s=most)
        nav = nf.Navigator(nf.Vehicle(imu=imu, sensors=vehicle.sensors), mission.start)
        one_by_one(nav, [e for e in events_of(vehicle, mission) if e.time_s < 80.015])
        speed = float(np.linalg.norm(nav.state.velocity_n))
        reach = 0.5 * (max(expected, 2.0 * speed if most is None else 0.0) + speed)
        assert 0.7 * reach < nav.state.sd[3:5].max() < 1.05 * reach
        assert 5.0 * reach < nav.state.sd[:2].max() < 21.0 * reach
        # the first one may be of a clock that was set ahead: it waits for the next
        ended = [Event("depth", t, (0.5,), t, t) for t in (80.5, 80.75)]
        assert one_by_one(nav, ended)[-1].status in ("used", "rejected")


def test_a_level_by_accelerometers_whose_biases_are_open_replaces_no_tilt():
    flat = np.zeros(3)
    assert realignment.AccelerometerLevel(flat, 0.03**2, 1.0, 0.06).knows_better
    assert not realignment.AccelerometerLevel(flat, 0.15**2, 1.0, 0.06).knows_better  # 150 mg
    assert not realignment.AccelerometerLevel(flat, 0.03**2, 1.0, 0.04).knows_better  # known well enough
    assert realignment.AccelerometerLevel(flat, 0.15**2, 31.0, 0.04).knows_better


def test_a_bias_that_jumps_is_not_taken_for_a_tilt():
    vehicle, mission = simulate_scenario("lawnmower", 4, 360.0)
    stream = mission.streams["imu"]
    value = stream.value + np.where(stream.time_s > 170.0, 0.49, 0.0)[:, None] * np.eye(6)[3]
    wrong = mission.with_stream("imu", nf.Stream(stream.time_s, value, stream.columns)).between(0.0, 290.0)
    track = nf.replay(vehicle, wrong.hide("gps", (60.0, 1e9)), output_rate_hz=1.0)
    nees = track.nees(track.errors(mission.truth))["attitude"]
    assert track.counts["contradicted"] == 3
    assert np.nanmean(nees[track.time_s > 250.0]) < 2.0


def test_while_an_instrument_tells_the_tilt_accelerometers_do_not_replace_it():
    """An accelerometer along x that comes to be half of gravity off: roll and pitch were set to it, 27 deg off, and the
    AHRS that had them right was refused from then on.
    """
    plain = survey_vehicle()
    tilt = nf.GaussMarkov(sd=0.3 * DEG, tau_s=20.0)
    ahrs = nf.Attitude(rate_hz=2.0, error=(tilt, tilt, nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0)))
    sensors = {name: sensor for name, sensor in plain.sensors.items() if name != "compass"}
    vehicle = nf.Vehicle(plain.drive, {**sensors, "ahrs": ahrs})
    mission = simulate(vehicle, lawnmower(300.0), seed=4, duration_s=300.0)
    imu = mission.streams["imu"]
    off = np.clip(0.1 * (imu.time_s - 100.0), 0.0, 5.0)[:, None] * np.eye(6)[3]
    spoiled = mission.with_stream("imu", nf.Stream(imu.time_s, imu.value + off, imu.columns))
    track = nf.replay(vehicle, spoiled, output_rate_hz=1.0)
    tilts = np.degrees(np.abs(track.errors(mission.truth).attitude[:, :2]))
    assert np.nanmax(tilts) < 5.0

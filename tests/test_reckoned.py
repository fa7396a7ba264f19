"""Dead reckoning without an inertial unit, when what drives is wrong: fixes turn its compass, what is not read is held
and said, and the radius holds the truth.
"""

import math

import faults_run as watched
import numpy as np
import pytest
import same_runs
from feeding import DRIVE, events_of, one_by_one

import navfilter as nf
from navfilter.faults.heading_fault import TrackRotationFit, rather_drawn, seen_turned
from navfilter.models.fault_bias import has_offset
from navfilter.models.state import wrap
from navfilter.simulation.scenarios import lawnmower, reckoning_vehicle, survey
from navfilter.simulation.simulate import simulate

END_S, DEG = 260.0, math.pi / 180.0
ABOUT_DOWN = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def dive():
    """Fixes all the time."""
    vehicle = reckoning_vehicle()
    return vehicle, simulate(vehicle, survey(END_S, surface_s=40.0), seed=3, duration_s=END_S)


def attitude(events, change, begin_s=100.0, end_s=math.inf):
    """Other readings of the attitude for a time."""
    return [
        e._replace(value=(*change(np.array(e.value[:3]), e.true_s), *e.value[3:]))
        if e.sensor == DRIVE and begin_s <= e.true_s < end_s
        else e
        for e in events
    ]


def velocity(events, change, begin_s=100.0, end_s=math.inf):
    """The same of the velocity."""
    return [
        e._replace(value=(*e.value[:3], *change(np.array(e.value[3:]), e.true_s)))
        if e.sensor == DRIVE and begin_s <= e.true_s < end_s
        else e
        for e in events
    ]


def fly(dive, events):
    """By the second: time, error of position and heading, their sd, whether the bounds hold, conditions."""
    vehicle, mission = dive
    nav, rows = nf.Navigator(vehicle, mission.start, threads=False), []
    for event in events:
        one_by_one(nav, [event])
        if event.sensor == "depth":
            state = nav.state
            error = state.minus(watched.truth_at(mission.truth, state.time_s))
            far_m, heading = math.hypot(*error[:2].tolist()), abs(float(error[8]))
            sd = math.hypot(*state.sd[:2].tolist()), float(state.sd[8])
            held = far_m <= state.bounds.horizontal_m and heading <= state.bounds.heading_rad
            rows.append((state.time_s, far_m, heading, *sd, held, dict(nav.health.axes)))
    return rows, nav


@pytest.mark.parametrize("angle_deg", [180.0, 40.0, -90.0])
def test_fixes_turn_a_compass_that_drives(dive, angle_deg):
    """Before: 3 m/s off the fixes for good, with a heading that was sure to half a degree."""
    wrong = attitude(events_of(*dive), lambda rpy, t: rpy + angle_deg * DEG * ABOUT_DOWN, 0.0)
    rows, nav = fly(dive, wrong)
    found = next(k for k, row in enumerate(rows) if row[2] < 15.0 * DEG)
    assert rows[found][0] < 140.0
    # at the end the heading is as sure as the way made since tells, and right
    assert all(row[2] < 4.0 * row[4] and row[1] < 4.0 * row[3] for row in rows[-60:])
    assert rows[-1][1] < 8.0 and rows[-1][4] < 4.0 * DEG
    assert all(row[5] for row in rows[10:])
    assert has_offset(nav.filter.in_force.drive.compass.models) and nav.counts["jumped"] >= 1


def test_so_they_do_one_that_is_described_by_error_models_alone(dive):
    vehicle, mission = dive
    models = (nf.White(sd=0.003), nf.White(sd=0.003), nf.GaussMarkov(sd=0.01, tau_s=300.0) + nf.White(sd=0.002))
    plain = nf.Vehicle(
        nf.DeadReckoning(rate_hz=4.0, attitude=models, velocity=vehicle.drive.velocity_sensor), vehicle.sensors
    )
    wrong = attitude(events_of(*dive), lambda rpy, t: rpy + 180.0 * DEG * ABOUT_DOWN, 0.0)
    rows, nav = fly((plain, mission), wrong)
    assert [has_offset(model) for model in nav.filter.in_force.drive.models[:3]] == [False, False, True]
    assert all(row[2] < 4.0 * row[4] and row[1] < 8.0 for row in rows[-60:])


def test_a_current_across_the_way_turns_no_compass():
    """A log's way over ground is turned by the water, here by far more than is described; its speed hardly changes."""
    drive = nf.DeadReckoning(
        rate_hz=4.0,
        attitude=nf.Heading(rate_hz=4.0, error=nf.White(sd=0.005)),
        velocity=nf.WaterVelocity(rate_hz=4.0, error=nf.White(sd=0.01), current_sd_m_s=0.002, current_tau_s=3600.0),
    )
    vehicle = nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.GaussMarkov(sd=1.0, tau_s=60.0))})
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=0.0, longitude_deg=0.0, heading_deg=0.0), threads=False)
    for k in range(1, 4 * 300):
        t, small = 0.25 * k, 1e-4 * (k % 7)
        nav.step(t, (0.001 + small, 0.001, small), (1.5 + small, 0.01, 0.01))
        if k % 4 == 0:
            place = np.array([1.5 * t, 0.6 * t, 0.0]) / 6.378e6
            nav.correct("gps", t, (place[0] * 6.378 / 6.335, place[1], 0.0))
    assert not has_offset(nav.filter.in_force.drive.compass.models)


def test_one_that_is_right_again_is_turned_back(dive):
    wrong = attitude(events_of(*dive), lambda rpy, t: rpy + math.pi * ABOUT_DOWN, 0.0, 130.0)
    rows, nav = fly(dive, wrong)
    assert nav.counts["jumped"] == 2
    assert all(row[2] < 4.0 * row[4] for row in rows[-20:]) and rows[-1][1] < 8.0


def test_the_smoother_follows_a_turn_and_a_replay_is_the_same(dive):
    vehicle, mission = dive
    stream = mission.streams["attitude"]
    turned = nf.Stream(stream.time_s, stream.value + math.pi * ABOUT_DOWN, stream.columns)
    bad = mission.with_stream("attitude", turned)
    track = nf.replay(vehicle, bad, smooth=True)
    assert track.forward is not None
    live = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(live, events_of(vehicle, bad))
    live.finish()
    assert live.counts["jumped"] == track.forward.counts["jumped"] >= 1
    forward, nav = track.forward, live.filter.memory.nav
    assert (forward.latitude[-1], forward.longitude[-1]) == (nav[0], nav[1])
    late = track.time_s > 200.0
    errors = track.errors(mission.truth).horizontal[late]
    assert np.sqrt(np.mean(errors**2)) < 6.0
    sd = np.sqrt(track.covariance[late, 0, 0] + track.covariance[late, 1, 1])
    assert (errors < 4.0 * sd).all()


@pytest.mark.parametrize(("wrong", "odd_m"), [(0.0, 0.0), (0.0, 15.0), (0.16, 0.0)])
def test_fixes_after_a_dive_are_right_where_they_agree(dive, wrong, odd_m):
    """An error of 4 standard deviations passed the gate, and the slow error of the fixes took it: 10 m for minutes. One
    odd fix proves nothing.
    """
    vehicle, mission = dive
    reads, fixes = mission.streams["velocity"], mission.streams["gps"]
    forward = wrong * (reads.time_s > 80.0)[:, np.newaxis] * (1.0, 0.0, 0.0)
    first = (np.arange(len(fixes.time_s)) == np.searchsorted(fixes.time_s, 180.0, side="right"))[:, np.newaxis]
    odd = first * (odd_m / 6.4e6, 0.0, 0.0)
    bad = mission.with_stream("velocity", nf.Stream(reads.time_s, reads.value + forward, reads.columns))
    bad = bad.with_stream("gps", nf.Stream(fixes.time_s, fixes.value + odd, fixes.columns)).hide("gps", (60.0, 180.0))
    rows, nav = fly(dive, events_of(vehicle, bad))
    time_s, far_m, sd_m = np.array([(row[0], row[1], row[3]) for row in rows]).T
    late = time_s > 195.0
    # where the vehicle dives and climbs, a velocity that is wrong along the way is wrong downwards too: the depth gauge
    # and what is reckoned share the blame
    assert nav.counts["reset"] == bool(wrong) and nav.counts["jumped"] == 2 * bool(wrong)
    assert has_offset(nav.filter.in_force.drive.models[3:]) == bool(wrong)
    assert (far_m[late] < 3.0 * sd_m[late]).all() and sd_m[late].max() < 5.0
    assert far_m[np.searchsorted(time_s, 180.0)] > 8.0 or not wrong
    track = nf.replay(vehicle, bad)
    assert (track.latitude[-1], track.longitude[-1]) == tuple(nav.filter.memory.nav[:2])


@pytest.mark.parametrize("wrong", [0.1, 0.13])
def test_a_velocity_that_goes_on_to_err_at_rest_gets_a_constant(dive, wrong):
    """By a tenth of a metre per second: less than the fixes after the dive prove, and no share of a speed of zero. The
    fixes were taken to have gone astray: 14 and 20 m off at a standard deviation of 2.4 m.
    """
    vehicle, mission = dive
    reads = mission.streams["velocity"]
    forward = wrong * (reads.time_s > 80.0)[:, np.newaxis] * (1.0, 0.0, 0.0)
    bad = mission.with_stream("velocity", nf.Stream(reads.time_s, reads.value + forward, reads.columns))
    rows, nav = fly(dive, events_of(vehicle, bad.hide("gps", (60.0, 180.0))))
    assert nav.counts["jumped"] == 1 and nav.counts["astray"] == 0
    assert has_offset(nav.filter.in_force.drive.models[3:])
    _, far_m, _, sd_m = rows[-1][:4]
    assert far_m < 3.0 * sd_m < 15.0


def course(fix_velocity, way_velocity=(1.5, 0.0), seconds=100):
    """Fixes once a second that have made a straight way, and the way reckoned."""
    made = TrackRotationFit(0.0, 0.0, 0.0)
    for t in range(seconds):
        way = t * np.array(way_velocity)
        made = made.plus(float(t), way, t * np.array(fix_velocity) - way)
    return made


@pytest.mark.parametrize(
    ("fix_velocity", "angle_deg"),
    [
        ((-1.5, 0.0), 180.0),
        ((1.5 * math.cos(0.5), 1.5 * math.sin(0.5)), math.degrees(0.5)),
        ((2.0, 0.0), None),  # drawn off along the way
        ((-2.5, 0.0), None),
        ((1.5, 0.2), None),  # and slowly across it
    ],
)
def test_on_a_straight_way_what_keeps_its_speed_has_turned(dive, fix_velocity, angle_deg):
    vehicle, mission = dive
    fixes = nf.Navigator(vehicle, mission.start, threads=False).filter.channels["gps"]
    turn = seen_turned(course(fix_velocity), fixes, 1e-4, rather_drawn)
    if angle_deg is None:
        assert turn is None
    else:
        assert turn is not None and abs(wrap(turn[0] - angle_deg * DEG)) < 1e-6


@pytest.mark.parametrize(
    ("change", "said"),
    [(lambda rpy, t: rpy * math.nan, "silent"), (lambda rpy, t: np.array([0.01, 0.02, 0.3]), "stuck")],
    ids=["silent", "stuck"],
)
def test_an_attitude_that_is_not_read_is_said_and_costs_what_is_said(dive, change, said):
    """Before: the last one for good, the position sure to 2 m while it was 70 m off."""
    events = [e for e in events_of(*dive) if e.sensor != "gps" or e.true_s < 100.0]
    rows, _ = fly(dive, attitude(events, change, 100.0, 160.0))
    during = [row for row in rows if 110.0 < row[0] < 160.0]
    assert all(row[6]["attitude"] == said and row[6]["velocity"] == "good" for row in during)
    # what was believed for 8 s of a stuck one is not in the sd
    assert all(row[1] < 3.0 * row[3] and row[2] < 4.0 * row[4] for row in during[20:])
    assert during[-1][4] > 45.0 * DEG and f"attitude is {said}" in reasons_at(dive, events, change, 150.0)
    after = [row for row in rows if row[0] > 161.0]
    assert all(row[6]["attitude"] == "good" and row[4] < 2.0 * DEG and row[2] < 3.0 * DEG for row in after)


def reasons_at(dive, events, change, time_s):
    """Why the state is not to be trusted then."""
    vehicle, mission = dive
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(nav, [e for e in attitude(events, change) if e.true_s < time_s])
    assert nav.state.trust.level != "good"
    return nav.state.trust.reasons


def test_a_heading_that_stands_still_is_not_stuck_where_nobody_reads_the_tilt(dive):
    """A yacht under autopilot with a compass of whole degrees."""

    def read(rpy, t):
        return np.array([0.0, 0.0, round(rpy[2] / DEG) * DEG if not 100.0 <= t < 160.0 else 17.0 * DEG])

    rows, _ = fly(dive, attitude(events_of(*dive), read, 0.0))
    assert all(row[6]["attitude"] == "good" for row in rows)


def test_a_heading_that_had_a_digit_for_its_noise_is_stuck_while_it_stands_still(dive):
    """Roll and pitch go on: it was believed for as long as it lasted, 46 m off at a standard deviation of 1 m."""
    events = [e for e in events_of(*dive) if e.sensor != "gps" or e.true_s < 100.0]
    rows, _ = fly(dive, attitude(events, lambda rpy, t: np.array([*rpy[:2], 0.3]), 100.0, 160.0))
    during = [row for row in rows if 110.0 < row[0] < 160.0]
    assert all(row[6]["attitude"] == "stuck" and row[2] < 4.0 * row[4] for row in during)
    assert all(row[1] < 4.0 * row[3] for row in rows[10:])
    assert all(row[6]["attitude"] == "good" for row in rows if row[0] > 161.0)


def test_spikes_are_left_out(dive):
    events = [e for e in events_of(*dive) if e.sensor != "gps" or e.true_s < 100.0]
    rng = np.random.default_rng(1)
    hit = {e.true_s for e in events if e.sensor == DRIVE and 100.0 <= e.true_s < 160.0 and rng.random() < 0.1}
    wrong = attitude(events, lambda rpy, t: rpy + 1.5 * (t in hit) * ABOUT_DOWN)
    wrong = velocity(wrong, lambda v, t: v + 3.0 * (t in hit))
    best, _ = fly(dive, events)
    rows, _ = fly(dive, wrong)
    assert max(abs(row[1] - one[1]) for row, one in zip(rows, best, strict=True)) < 1.0
    assert any(row[6]["attitude"] == "erratic" for row in rows)


def test_a_velocity_that_jumps_has_a_constant_until_it_is_back(dive):
    """No vehicle gains 4 m/s from one sample to the next: what it is off by takes them, and may be another."""
    vehicle, mission = dive
    wrong = velocity(events_of(*dive), lambda v, t: v + 4.0 * np.eye(3)[0], 100.0, 110.0)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(nav, [e for e in wrong if e.true_s < 102.0 and e.sensor == DRIVE])
    assert nav.health.axes["velocity"] == "jumped" and nav.counts["jumped"] == 1
    assert np.linalg.norm(nav.state.velocity_n) < 2.0
    assert max(nav.state.sd[3:5]) == pytest.approx(4.0 / math.sqrt(3.0), rel=0.1)
    one_by_one(nav, [e for e in wrong if 102.0 <= e.true_s < 112.0 and e.sensor == DRIVE])
    assert nav.health.axes["velocity"] == "good" and max(nav.state.sd[3:5]) < 0.5


def test_fixes_tell_that_a_velocity_is_back(dive):
    """It has drifted meanwhile, and comes back by less than it had jumped: it may be off by the rest."""
    vehicle, mission = dive
    wrong = velocity(events_of(*dive), lambda v, t: v + (4.0 - 0.1 * (t - 100.0)) * np.eye(3)[0], 100.0, 110.0)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(nav, [e for e in wrong if e.true_s < 112.0 and e.sensor == DRIVE])
    assert nav.health.axes["velocity"] == "jumped" and max(nav.state.sd[3:5]) > 0.4
    one_by_one(nav, [e for e in wrong if 112.0 <= e.true_s < 180.0])
    assert nav.health.axes["velocity"] == "good" and max(nav.state.sd[3:5]) < 0.2
    assert not nav.filter.channels["gps"].faults.tells


def test_a_heading_that_jumps_back_leaves_no_more_than_it_differs_by(dive):
    vehicle, mission = dive
    wrong = attitude(events_of(*dive), lambda rpy, t: rpy + 2.0 * ABOUT_DOWN, 100.0, 110.0)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(nav, [e for e in wrong if e.true_s < 109.0 and e.sensor == DRIVE])
    assert nav.health.axes["attitude"] == "jumped"
    assert nav.state.sd[8] == pytest.approx(2.0 / math.sqrt(3.0), rel=0.1)
    off = nav.state.minus(watched.truth_at(mission.truth, nav.state.time_s))
    assert abs(off[8]) < 0.2
    one_by_one(nav, [e for e in wrong if 109.0 <= e.true_s < 112.0 and e.sensor == DRIVE])
    assert nav.health.axes["attitude"] == "good" and nav.state.sd[8] < 0.2


@pytest.mark.parametrize("what", [attitude, velocity])
def test_jumps_in_stretches_one_by_one_late_and_restored(dive, what):
    vehicle, mission = dive
    off = 2.0 * ABOUT_DOWN if what is attitude else 4.0 * np.eye(3)[0]
    events = what(events_of(*dive), lambda v, t: v + off, 100.0, 110.0)
    whole, half = (nf.Navigator(vehicle, mission.start, threads=False) for _ in range(2))
    one_by_one(whole, events)
    one_by_one(half, [e for e in events if e.true_s < 105.0])
    again = nf.Navigator.restore(vehicle, half.snapshot())
    one_by_one(again, [e for e in events if e.true_s >= 105.0])
    same_runs.assert_same_bits(whole, again)
    streams = dict(mission.streams)
    name = "attitude" if what is attitude else "velocity"
    stream = streams[name]
    hit = (stream.time_s >= 100.0) & (stream.time_s < 110.0)
    wrong = mission.with_stream(name, nf.Stream(stream.time_s, stream.value + np.outer(hit, off), stream.columns))
    whole.finish()
    track = nf.replay(vehicle, wrong, output_rate_hz=math.inf)
    assert track.counts["jumped"] == whole.counts["jumped"] == 2
    np.testing.assert_array_equal(track.covariance[-1], whole.covariance)


def test_a_single_compass_that_drives_bounds_no_heading(dive):
    _, nav = fly(dive, events_of(*dive)[:400])
    assert nav.state.bounds.heading_rad == math.pi and math.isfinite(nav.state.bounds.horizontal_m)


def test_what_refused_fixes_have_told_is_in_a_snapshot(dive):
    vehicle, mission = dive
    wrong = attitude(events_of(vehicle, mission), lambda rpy, t: rpy + math.pi * ABOUT_DOWN, 0.0)
    whole = nf.Navigator(vehicle, mission.start, threads=False)
    one_by_one(whole, wrong)
    whole.finish()
    nav, k = nf.Navigator(vehicle, mission.start, threads=False), 0
    while nav.filter.channels["gps"].faults.reckoned is None or nav.time_s < 45.0:
        one_by_one(nav, [wrong[k]])
        k += 1
    other = nf.Navigator.restore(vehicle, nav.snapshot())
    one_by_one(other, wrong[k:])
    other.finish()
    assert other.snapshot() == whole.snapshot()


def test_fixes_turn_a_compass_that_is_wrong_by_another_angle_on_each_way():
    """Before: the first angle was found; then fixes and way were never one turned by any angle any more, and half of
    the time more than 130 m apart.
    """
    vehicle, end_s = reckoning_vehicle().with_error(gps=nf.White(sd=0.2)), 600.0
    mission = simulate(vehicle, lawnmower(end_s), seed=2, duration_s=end_s)
    wrong = attitude(events_of(vehicle, mission), lambda rpy, t: rpy * (1.0, 1.0, -1.0), 120.0)
    rows, _ = fly((vehicle, mission), wrong)
    # on each way it takes as long as the fixes need to tell, and no longer
    far_m = np.array([row[1] for row in rows if row[0] > 120.0])
    assert np.median(far_m) < 2.0 and far_m.max() < 60.0


def test_a_log_that_errs_slowly_and_a_compass_that_jumps_far(dive):
    """No water flows so fast: before, whatever was across the way of a log was its current, and a speed that its own
    error explains spoke against a turn. 300 m off within three minutes, and sure to 17 m.
    """
    vehicle, _ = dive
    along = nf.GaussMarkov(sd=0.3, tau_s=100.0)
    axes = along, nf.White(sd=0.02), nf.White(sd=0.02)
    log = nf.WaterVelocity(rate_hz=4.0, error=axes, current_sd_m_s=0.04, current_tau_s=8000.0)
    drive = nf.DeadReckoning(rate_hz=4.0, attitude=vehicle.drive.attitude, velocity=log)
    slow = nf.Vehicle(drive, vehicle.sensors)
    mission = simulate(slow, survey(END_S, surface_s=40.0), seed=3, duration_s=END_S)
    wrong = attitude(events_of(slow, mission), lambda rpy, t: rpy + 80.0 * DEG * ABOUT_DOWN)
    rows, _ = fly((slow, mission), wrong)
    assert max(row[1] for row in rows) < 100.0
    assert all(row[2] < 4.0 * row[4] and row[1] < 4.0 * row[3] for row in rows[-30:])

"""Lanes: several filters side by side, and which of them is believed."""

import dataclasses
import json
import math

import numpy as np
import pytest
from state_differences import differences

import navfilter as nf
from navfilter.faults import settings as fault_settings
from navfilter.faults.lane_selection import FULL, LaneChoice
from navfilter.io import write_vehicle
from navfilter.io.json_lines import LineParser
from navfilter.models.mission import Stream
from navfilter.service.session import Options, Session
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG = math.pi / 180.0
FAULT_S, END_S = 65.0, 130.0


def vehicle_of(*units, lane=None):
    plain = survey_vehicle()
    described = plain.with_error(
        compass=plain.sensors["compass"].error + nf.White(sd=0.1 * DEG),
        gps=plain.sensors["gps"].error + nf.White(sd=0.5),
    )
    sensors = dict(described.sensors)
    if len(units) == 1:
        return nf.Vehicle(imu=described.drive, sensors=sensors, dead_reckoning_lane=lane)
    return nf.Vehicle(imus=dict.fromkeys(units, described.drive), sensors=sensors, dead_reckoning_lane=lane)


def mission_of(vehicle, seed):
    fixes = {"gps": Faults(available=((0.0, 50.0),))}
    return simulate(vehicle, survey(END_S, surface_s=20.0), seed=seed, duration_s=END_S, faults=fixes)


@pytest.fixture(scope="module")
def two():
    vehicle = vehicle_of("a", "b")
    return vehicle, mission_of(vehicle, 31)


@pytest.fixture(scope="module")
def one():
    vehicle = vehicle_of("imu", lane=True)
    return vehicle, mission_of(vehicle, 32)


def changed(mission, unit, change, begin_s=FAULT_S, end_s=FAULT_S + 30.0):
    stream = mission.streams[unit]
    on, value = (stream.time_s >= begin_s) & (stream.time_s < end_s), stream.value.copy()
    value[on] = change(value[on])
    return mission.with_stream(unit, Stream(stream.time_s, value, stream.columns))


def swapped(rows):
    return rows[:, [1, 0, 2, 3, 4, 5]]


def alone(vehicle, mission, unit):
    lane = nf.Vehicle(imu=vehicle.units[unit], sensors=dict(vehicle.sensors))
    return nf.replay(lane, mission.with_stream("imu", mission.streams[unit]), smooth=True)


def farthest(track, mission):
    dive = track.time_s > 50.0
    return track.errors(mission.truth).horizontal[dive].max()


def fed(nav, vehicle, mission, until_s=math.inf, after_s=-math.inf, clock=float):
    """Samples and readings between two times, in the order of theirs, one by one; yields after each. Units have a
    clock of their own.
    """
    units, events = list(vehicle.units), []
    for rank, name in enumerate([*units, *vehicle.sensors]):
        stream = mission.streams[name]
        events += [(t, rank, name, i) for i, t in enumerate(stream.time_s.tolist())]
    for time_s, rank, name, i in sorted(events):
        if time_s > until_s:
            return
        if time_s <= after_s:
            continue
        value = mission.streams[name].value[i]
        if rank < len(units):
            nav.step(clock(time_s), value[:3], value[3:6], name)
        else:
            nav.correct(name, time_s, value)
        yield time_s


# ---------------------------------------------------------------- the choice
def choice_with(gains, seconds=5.0):
    """A choice after readings that the lanes (two inertial ones, one without) foretold with these errors [sd]."""
    sensors = {"compass": nf.Heading(error=nf.White(sd=0.01)), "depth": nf.Depth(error=nf.White(sd=0.1))}
    choice = LaneChoice([True, True, False], sensors, 0.0)
    for second in range(round(seconds / fault_settings.LANE_STEP_S)):
        choice.decide_until((second + 0.5) * fault_settings.LANE_STEP_S)
        for lane, errors in enumerate(gains):
            for sensor, (error, wider) in enumerate(errors):
                sd = (0.01, 0.1)[sensor] * wider
                choice.compare(lane, sensor, second * fault_settings.LANE_STEP_S, [error * sd], [sd**2])
    choice.decide_until(seconds)
    return choice


def test_a_lane_that_foretells_badly_is_left_for_one_that_does_not():
    assert choice_with([[(20.0, 1.0)] * 2, [(0.0, 1.0)] * 2, [(0.0, 5.0)] * 2]).memory.lane == 1


def test_a_large_covariance_does_not_win_by_saying_little():
    sure, vague = [(1.0, 1.0)] * 2, [(0.0, 30.0)] * 2
    assert choice_with([sure, vague, vague]).memory.lane == 0
    assert choice_with([vague, sure, vague]).memory.lane == 1


def test_lanes_that_are_as_good_stay():
    assert choice_with([[(1.03, 1.0)] * 2, [(1.0, 1.0)] * 2, [(0.0, 3.0)] * 2], 60.0).memory.lane == 0


def test_one_sensor_does_not_put_the_lane_without_a_unit_in_force():
    # a compass that has jumped: both units contradict it, dead reckoning follows it
    jumped = [(20.0, 1.0), (0.0, 1.0)]
    assert choice_with([jumped, jumped, [(0.0, 5.0), (0.0, 3.0)]], 20.0).memory.lane == 0
    both = [(20.0, 1.0), (20.0, 1.0)]
    assert choice_with([both, both, [(0.0, 5.0), (0.0, 3.0)]], 20.0).memory.lane == 2


def test_an_outlier_that_nobody_foretold_counts_for_nobody():
    choice = choice_with([[(0.0, 1.0)] * 2] * 3)
    before = choice.memory.gathered.copy()
    for lane in range(3):
        choice.compare(lane, 0, 5.0, [1e6], [1e-4 * (lane + 1)])
    assert np.abs((choice.memory.gathered - before)[:, :, 0]).max() < 1e-9


def test_a_lane_that_says_nothing_is_short_of_all_that_was_foretold():
    sensors = {"depth": nf.Depth(error=nf.White(sd=0.1))}
    choice = LaneChoice([True, True], sensors, 0.0)
    for k in range(round(2.0 * fault_settings.LANE_MARGIN / FULL)):
        choice.compare(1, 0, k * fault_settings.LANE_STEP_S, [0.0], [0.01])
        choice.decide_until((k + 1.5) * fault_settings.LANE_STEP_S)
    assert choice.memory.lane == 1 and choice.due_restarts() == [0]


@pytest.mark.parametrize("seed", range(4))
def test_looking_at_the_parts_of_the_minute_only_where_it_matters_changes_nothing(seed):
    """Page's bound spares most looks; with a bound of infinity every step looks."""
    sensors = {"compass": nf.Heading(error=nf.White(sd=0.01)), "depth": nf.Depth(error=nf.White(sd=0.1))}
    found = []
    for bounded in (True, False):
        rng, choice, changes = np.random.default_rng(seed), LaneChoice([True, True, False], sensors, 0.0), []
        for k in range(600):
            if not bounded:
                choice.memory.ahead[:] = math.inf
            changes += choice.decide_until((k + 0.5) * fault_settings.LANE_STEP_S)
            bad = (k // 120) % 3
            for lane in range(3):
                for sensor, sd in enumerate((0.01, 0.1)):
                    error = rng.normal() * sd * (4.0 if lane == bad else 1.0)
                    choice.compare(
                        lane, sensor, k * fault_settings.LANE_STEP_S, [error], [(sd * (3.0 if lane == 2 else 1.0)) ** 2]
                    )
            for lane in choice.due_restarts() if k % 100 == 99 else []:
                choice.on_restart(lane)
        found.append(changes)
    assert found[0] == found[1] and len(found[0]) > 1


RATE_HZ, SD = 4.0, 0.01


def followed(off, seconds=20.0, own=None):
    """The choice after readings of a velocity that contradicts a unit by these amounts [m/s], shape (n, 3), while the
    lane without one follows it; when it took that lane, and why.
    """
    choice = LaneChoice([True, False], {"dvl": nf.BodyVelocity(rate_hz=RATE_HZ, error=nf.White(sd=SD))}, 0.0)
    changes = []
    for k in range(round(seconds * RATE_HZ)):
        time_s = k / RATE_HZ
        changes += choice.decide_until(time_s)
        choice.compare(0, 0, time_s, off(time_s).tolist(), [SD**2] * 3)
        choice.compare(1, 0, time_s, np.zeros(3) if own is None else own(time_s), [0.8**2] * 3)
    return changes


def test_a_unit_that_runs_away_from_a_velocity_is_left_before_it_is_far():
    """50 mg of an accelerometer: 3 m after 3.5 s."""
    (time_s, lane, reason), *more = followed(lambda time_s: np.array([-0.49 * time_s, 0.0, 0.0]))
    assert lane == 1 and time_s <= 4.0 and more == [] and reason.startswith("the lane before ran away from dvl, by 1.")


@pytest.mark.parametrize(
    "off",
    [
        lambda time_s: np.array([2.0, 1.0, 0.0]),
        lambda time_s: np.array([min(0.5 * time_s, 1.0), 0.0, 0.0]),
        lambda time_s: np.array([0.02 * time_s, 0.0, 0.0]),
        lambda time_s: np.random.default_rng(round(RATE_HZ * time_s)).normal(size=3),
        lambda time_s: 1500.0 + 10.0 * np.random.default_rng(round(RATE_HZ * time_s)).normal(size=3),
        lambda time_s: np.array([0.49 * (time_s % 2.0), 0.0, 0.0]),
    ],
    ids=["jumped", "late", "drifts", "noisy", "another unit of measurement", "comes back"],
)
def test_a_velocity_that_errs_is_no_unit_that_runs_away(off):
    assert followed(off, 8.0) == []


def test_a_velocity_in_another_unit_of_measurement_is_not_followed_ever():
    """However long it contradicts a unit: it did so from one reading to the next."""
    noise = np.random.default_rng(5)
    assert followed(lambda time_s: 1500.0 + 10.0 * noise.normal(size=3), 60.0) == []


@pytest.mark.parametrize(("own", "followed_too"), [(0.0, True), (1.0, True), (2.0, False), (8.0, False)])
def test_a_velocity_that_goes_on_to_contradict_a_unit_is_followed_where_dead_reckoning_foretells_it(own, followed_too):
    """A DVL in mm/s contradicts both; dead reckoning took what of it was not beyond belief for true, 682 m."""
    unit, lane = np.random.default_rng(5), np.random.default_rng(7)
    changes = followed(lambda time_s: 1.0 * unit.normal(size=3), 60.0, own=lambda time_s: own * lane.normal(size=3))
    assert [(lane, reason) for _, lane, reason in changes] == [
        (1, "dvl went on to contradict the lane before") for _ in range(followed_too)
    ]


def test_nothing_runs_away_from_what_contradicts_dead_reckoning_too():
    ramp = lambda time_s: np.array([-0.49 * time_s, 0.0, 0.0])  # noqa: E731
    assert followed(ramp, 8.0, own=lambda time_s: 8.0 * ramp(time_s) - 5.0) == []


# ---------------------------------------------------------------- vehicles
def test_a_vehicle_with_one_unit_has_no_lanes_unless_it_asks_for_them():
    assert survey_vehicle().lanes() == {}
    assert list(vehicle_of("imu", lane=True).lanes()) == ["imu", "dead-reckoning"]
    assert list(vehicle_of("a", "b").lanes()) == ["a", "b", "dead-reckoning"]
    assert list(vehicle_of("a", "b", lane=False).lanes()) == ["a", "b"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"imu": nf.Imu(rate_hz=10), "dead_reckoning_lane": True}, "no heading and no velocity"),
        ({"imus": {"gyro": nf.Imu(rate_hz=10)}}, "another meaning"),
        ({"imus": {"a": nf.Depth()}}, "must be an Imu"),
        ({}, "exactly one"),
    ],
)
def test_what_cannot_be_is_refused_in_words(arguments, says):
    with pytest.raises(ValueError, match=says):
        nf.Vehicle(**arguments)


def test_files_hold_the_units(tmp_path):
    vehicle = vehicle_of("a", "b", lane=True)
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == dataclasses.replace(
        vehicle, name="vehicle"
    )
    (tmp_path / "vehicle.toml").write_text(
        '[imus.a]\ntype = "imu"\nrate_hz = 100\n[drive]\ntype = "imu"\nrate_hz = 9\n'
    )
    with pytest.raises(ValueError, match="one of the two"):
        nf.read_vehicle(tmp_path)


def test_units_that_do_not_speak_are_said(two):
    vehicle, mission = two
    with pytest.raises(ValueError, match=r'"b" has no stream.*\[imus.b\]'):
        nf.replay(vehicle, mission.without_stream("b"))
    with pytest.raises(ValueError, match="use LaneNavigator"):
        nf.Navigator(vehicle, mission.start)
    with pytest.raises(ValueError, match="no inertial unit"):
        nf.LaneNavigator(vehicle, mission.start).step(0.0, (0, 0, 0), (0, 0, 0), "c")
    never = mission.with_stream("a", mission.streams["a"].keep(slice(0, 0)))
    track = nf.replay(vehicle, never)
    assert track.lanes[1][1] == "b" and track.lanes[1][0] < 3.0
    neither = never.with_stream("b", never.streams["a"])
    assert nf.replay(vehicle, neither).lanes[-1][1] == "dead-reckoning"


# ---------------------------------------------------------------- runs
def test_a_unit_whose_axes_are_swapped_is_left_and_leaves_no_trace(two):
    vehicle, mission = two
    track = nf.replay(vehicle, changed(mission, "a", swapped), smooth=True)
    (_, first), (switched_s, second) = track.lanes
    assert (first, second) == ("a", "b") and switched_s < FAULT_S + 10.0
    sound = alone(vehicle, mission, "b")
    # the lane in force is what the sound unit alone is, to the last bit
    after = track.forward.time_s > switched_s
    at = np.searchsorted(sound.forward.time_s, track.forward.time_s[after])
    assert np.array_equal(track.forward.latitude[after], sound.forward.latitude[at])
    assert np.array_equal(track.forward.covariance[after], sound.forward.covariance[at])
    assert farthest(track.forward, mission) < 1.5 * farthest(sound.forward, mission)
    # and the smoother goes along it alone
    assert np.array_equal(track.latitude, sound.latitude) and np.array_equal(track.covariance, sound.covariance)


def test_without_a_fault_nothing_is_switched(two):
    vehicle, mission = two
    track = nf.replay(vehicle, mission)
    assert [name for _, name in track.lanes] == ["a"]
    sound = alone(vehicle, mission, "a").forward
    assert np.array_equal(track.latitude, sound.latitude) and np.array_equal(track.covariance, sound.covariance)
    assert np.array_equal(track.residuals["dvl"].value, sound.residuals["dvl"].value)


def test_dead_reckoning_takes_over_from_a_single_unit_and_gives_back(one):
    vehicle, mission = one
    silent = mission.hide("imu", (FAULT_S, FAULT_S + 15.0))
    track = nf.replay(vehicle, silent, smooth=True)
    assert [name for _, name in track.lanes] == ["imu", "dead-reckoning", "imu"]
    (_, left_s, back_s), again_s = (time_s for time_s, _ in track.lanes), FAULT_S + 15.0
    assert left_s < FAULT_S + 3.0 and again_s < back_s < again_s + 30.0
    assert farthest(track.forward, mission) < 10.0
    error, sd = track.errors(mission.truth).position_n[:, :2], np.sqrt(track.covariance[:, [0, 1], [0, 1]])
    assert np.abs(error / sd).max() < 4.0 and np.all(np.diff(track.time_s) > 0.0)


def test_a_unit_that_has_come_back_is_used_again_from_where_dead_reckoning_is():
    """The lane without a unit foretells with more than it errs by: that was taken for what the unit missed, so that it
    was begun anew every half minute, and never used again.
    """
    vehicle = vehicle_of("imu", lane=True)
    mission = simulate(vehicle, survey(260.0, surface_s=20.0), seed=33, duration_s=260.0)
    mission = mission.hide("gps", (50.0, 400.0)).hide("imu", (65.0, 80.0))
    track = nf.replay(vehicle, mission, smooth=True)
    assert [name for _, name in track.lanes] == ["imu", "dead-reckoning", "imu"]
    assert track.forward.errors(mission.truth).horizontal.max() < 12.0
    jump = np.hypot(*np.diff(track.forward.local()[:, :2], axis=0).T)[track.forward.time_s[1:] > 82.0]
    assert jump.max() < 2.0


# ---------------------------------------------------------------- live
def test_readings_with_wild_stamps_are_not_where_time_goes_on(one):
    """Two of them with good ones between carried the lane without a unit on by an hour."""
    vehicle, mission = one
    nav = nf.LaneNavigator(vehicle, mission.start)
    assert sum(1 for _ in fed(nav, vehicle, mission, 30.0)) > 3000
    here_s = nav.time_s
    for time_s in (here_s + 0.02, here_s + 0.04, here_s + 0.06):
        nav.step(time_s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
        nav.correct("depth", time_s + 3600.0, 0.0)
        nav.correct("depth", time_s, 0.0)
    assert nav.time_s < here_s + 1.0


def test_a_clock_that_leaps_with_the_unit_is_not_where_time_goes_on(one):
    """Compass and depth of the same instant, no sample between them, made an hour of dead reckoning."""
    vehicle, mission = one
    nav = nf.LaneNavigator(vehicle, mission.start)
    assert sum(1 for _ in fed(nav, vehicle, mission, 30.0)) > 3000
    here_s = nav.time_s
    for k in range(1, 120):
        if k % 10 == 1:
            nav.correct("compass", here_s + 3600.0 + 0.01 * k, nav.state.heading)
            nav.correct("depth", here_s + 3600.0 + 0.01 * k, 0.0)
        nav.step(here_s + 3600.0 + 0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
    assert all(here_s + 0.9 < lane.time_s < here_s + 1.3 for lane in nav.lanes.values())


@pytest.mark.parametrize("by_s", [2.0, -2.0])
def test_a_clock_of_the_only_unit_that_was_set_costs_nothing(one, by_s):
    """All readings were late from then on, and nothing was to be trusted."""
    vehicle, mission = one
    best, nav = (nf.LaneNavigator(vehicle, mission.start) for _ in range(2))
    assert sum(1 for _ in fed(best, vehicle, mission, 60.0)) > 6000

    def clock(time_s):
        return time_s + by_s if time_s > 30.0 else time_s

    assert sum(1 for _ in fed(nav, vehicle, mission, 31.0, clock=clock)) > 3000
    nav = nf.LaneNavigator.restore(vehicle, nav.snapshot())  # which keeps what is known of the clock
    assert sum(1 for _ in fed(nav, vehicle, mission, 60.0, 31.0, clock)) > 2900
    assert nav.health.drive_clock_offset_s == pytest.approx(-by_s) and nav.health.trust.level == "good"
    assert nav.time_s == pytest.approx(best.time_s, abs=1e-9)
    assert np.abs(nav.state.minus(best.state)).max() < 1e-6


def test_live_is_the_replay_to_the_last_bit(one):
    vehicle, mission = one
    # before the DVL has been used for so long that the lane itself would leave its unit out for it
    mission = changed(mission, "imu", swapped, begin_s=35.0, end_s=70.0)
    track = nf.replay(vehicle, mission, output_rate_hz=None)
    nav = nf.LaneNavigator(vehicle, mission.start)
    states, lanes = {}, set()
    for _ in fed(nav, vehicle, mission):
        states[nav.pose.time_s] = nav.pose
        lanes.add(nav.health.lane)
    assert lanes == {"imu", "dead-reckoning"}
    switches = [time_s for time_s, _ in track.lanes]
    compared = 0
    for i, time_s in enumerate(track.time_s.tolist()):
        if time_s in states and time_s not in switches and time_s > 1.0:
            pose, compared = states[time_s], compared + 1
            assert (pose.latitude, pose.longitude, pose.height) == (
                *(track.latitude[i], track.longitude[i]),
                track.height[i],
            )
    assert compared > 500


def test_late_readings_and_restarts_change_nothing(two):
    vehicle, mission = two
    mission = changed(mission, "a", swapped).between(0.0, 75.0).with_start(mission.start)
    timely, late = (nf.LaneNavigator(vehicle, mission.start) for _ in range(2))
    for _ in fed(timely, vehicle, mission):
        pass
    held = []
    for time_s in fed(_Late(late, held), vehicle, mission):
        if held and time_s > held[0][1] + 0.3:
            assert late.correct(*held.pop(0)).status in ("late-replayed", "rejected")
        if 50.0 < time_s < 50.005:
            late_again = nf.LaneNavigator.restore(vehicle, late.snapshot())
            assert differences(late_again.memory.choice, late.memory.choice) == []
    for reading in held:
        late.correct(*reading)
    assert timely.state.lane == late.state.lane == "b"
    assert differences(timely.believed.memory.filter, late.believed.memory.filter) == []
    assert differences(timely.memory.choice, late.memory.choice) == []


class _Late:
    """Hands everything on, but the depths."""

    def __init__(self, nav, held):
        self.nav, self.held, self.step = nav, held, nav.step

    def correct(self, name, time_s, value):
        if name == "depth":
            self.held.append((name, time_s, value))
        else:
            self.nav.correct(name, time_s, value)


def test_a_snapshot_goes_on_to_the_last_bit(two):
    vehicle, mission = two
    nav = nf.LaneNavigator(vehicle, mission.start)
    for _ in fed(nav, vehicle, mission, 8.0):
        pass
    again = nf.LaneNavigator.restore(vehicle, nav.snapshot())
    for one in (nav, again):
        for _ in fed(one, vehicle, mission, 12.0, 8.0):
            pass
    assert nav.time_s == again.time_s == 12.0
    assert differences(nav.memory, again.memory) == []
    with pytest.raises(ValueError, match="another vehicle"):
        nf.LaneNavigator.restore(vehicle.without("depth"), nav.snapshot())


def test_lines_name_the_unit(two):
    vehicle, mission = two
    lines, out = [], []
    for name in (*vehicle.units, *vehicle.sensors):
        stream = mission.streams[name]
        for time_s, value in zip(stream.time_s.tolist(), stream.value.tolist(), strict=True):
            if time_s > 5.0:
                break
            fields = {"rate_b": value[:3], "force_b": value[3:]} if name in vehicle.units else {"value": value}
            lines.append((time_s, json.dumps({"sensor": name, "time_s": time_s, **fields}).encode()))
    start = {k: v for k, v in dataclasses.asdict(mission.start).items() if k not in ("date", "time_s")}
    session = Session(vehicle, Options(start=start), lambda line, state: out.append(json.loads(line)))
    parser = LineParser(vehicle)
    for _, line in sorted(lines, key=lambda item: item[0]):
        session.feed(parser.parse(line))
    states = [line for line in out if "latitude_deg" in line]
    assert states[-1]["lane"] == "a" and set(states[-1]["lanes"]) == {"a", "b", "dead-reckoning"}
    assert states[-1]["bad_lines"] == {}
    assert session.snapshot() is not None
    assert (
        parser.parse(b'{"sensor": "imu", "time_s": 1.0, "rate_b": [0,0,0], "force_b": [0,0,0]}').kind
        == "unknown-sensor"
    )

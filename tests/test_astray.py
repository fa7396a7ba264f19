"""Sensors that go wrong little by little or repeat themselves; fixes and DVL against one compass."""

import math

import faults_run as watched
import numpy as np
import pytest
from feeding import events_of, one_by_one
from state_differences import differences
from test_agreement import DEG, RADIUS_M, after, altered, dive, fly, turned

import navfilter as nf
from navfilter.evaluation.montecarlo.campaign import Campaign
from navfilter.faults.heading_fault import TrackRotationFit, led_astray, told_by_fixes
from navfilter.models.fault_bias import has_offset
from navfilter.simulation.scenarios import lawnmower, reckoning_vehicle, simulate_scenario, survey_vehicle
from navfilter.simulation.simulate import simulate


def short(duration_s):
    """The first seconds of the dive: 20 s at rest, then straight on at the surface with fixes."""
    vehicle, mission = dive()
    return vehicle, mission.between(0.0, duration_s)


def test_fixes_that_are_drawn_off_go_astray_and_are_not_followed():
    vehicle, mission = short(115.0)
    stream = mission.streams["gps"]
    away = np.maximum(stream.time_s - 45.0, 0.0)[:, None] * np.array([0.5 / RADIUS_M, 0.0, 0.0])
    drawn = mission.with_stream("gps", nf.Stream(stream.time_s, stream.value + away, stream.columns))
    nav, off = fly(vehicle, drawn)
    # 35 m off by now; four sd of the fixes' slow error, 12 m, are there after 24 s
    assert nav.counts["astray"] == 1 and nav.health.sensors["gps"].condition == "astray"
    assert nav.health.trust.level == "degraded"
    assert off[-1, 1] < 8.0 and off[-1, 1] < 3.5 * math.sqrt(2.0) * off[-1, 4]
    assert nav.counts["jumped"] == nav.counts["reset"] == 0


def test_a_height_that_a_depth_gauge_holds_is_not_that_of_fixes():
    """15 m of height, 5 sd of their slow error: they went astray by it, agreed with each other on the height while they
    were refused, and the state followed for 20 s, in which the depth gauge was refused.
    """
    vehicle, mission = short(115.0)
    stream = mission.streams["gps"]
    high = np.clip(stream.time_s - 40.0, 0.0, 30.0)[:, None] * np.array([0.0, 0.0, 0.5])
    nav, off = fly(vehicle, mission.with_stream("gps", nf.Stream(stream.time_s, stream.value + high, stream.columns)))
    clean, right = fly(vehicle, mission)
    assert off[:, 2].max() < 0.3 and right[:, 2].max() < 0.3
    np.testing.assert_allclose(off[:, 1], right[:, 1], atol=0.5)
    assert not any(nav.counts[what] for what in ("astray", "reset", "jumped", "opened"))
    assert nav.health.sensors["gps"].outcomes["used"] > 0.95 * clean.health.sensors["gps"].outcomes["used"]
    assert nav.health.sensors["depth"].outcomes.get("rejected", 0) == 0


@pytest.mark.parametrize("high_m", [0.0, 15.0])
def test_fixes_that_beat_what_was_reckoned_leave_the_height_to_the_depth_gauge(high_m):
    """A start that is 2 km off; the fixes' height is right, or is not."""
    vehicle, mission = short(60.0)
    raised = altered(mission, "gps", lambda p: p + np.array([0.0, 0.0, high_m]), 0.0)
    nav, off = fly(vehicle, raised, latitude_deg=mission.start.latitude_deg + math.degrees(2000.0 / RADIUS_M))
    assert nav.counts["reset"] == 1
    assert after(off, 15.0)[:, 1].max() < 12.0 and off[:, 2].max() < 0.5


def test_a_receiver_that_repeats_itself_while_the_vehicle_moves_is_not_believed():
    vehicle, mission = short(75.0)
    last = mission.streams["gps"].value[np.searchsorted(mission.streams["gps"].time_s, 50.0)]
    nav, off = fly(vehicle, altered(mission, "gps", lambda p: np.broadcast_to(last, p.shape), 50.0))
    clean, right = fly(vehicle, mission)
    # one or two repeated ones, within their own noise
    assert nav.health.sensors["gps"].outcomes["rejected"] >= 22
    assert abs(off[-1, 1] - right[right[:, 0] <= 50.0][-1, 1]) < 1.5
    # it would have come to 36 m
    assert abs(nav.errors["gps_north[0]"]) < 6.0
    assert clean.health.sensors["gps"].outcomes.get("rejected", 0) == 0


@pytest.mark.parametrize("offset_deg", [180.0, 25.0])
def test_fixes_and_dvl_together_outvote_a_compass_that_is_off_from_the_start(offset_deg):
    vehicle, mission = dive()
    broken = altered(mission, "compass", lambda v: turned(v) if offset_deg == 180.0 else v + offset_deg * DEG, 0.0)
    nav, off = fly(vehicle, broken)
    # first the compass turns the heading that the start told; then fixes and DVL turn it back
    assert nav.counts["reset"] == 2 and nav.counts["jumped"] == 1
    assert nav.health.sensors["compass"].condition == "jumped"
    late = after(off, 115.0)
    assert late[:, 3].max() < 8.0 and (late[:, 3] < 4.0 * late[:, 6] / DEG).all()
    assert (late[:, 1] < 4.0 * math.sqrt(2.0) * late[:, 4]).all()
    # by fixes alone the heading is told as their way says; the filter, linearised at headings that differ, claims more
    compass, state = nav.filter.channels["compass"], nav.filter.memory.nav
    variance, noise, *place = compass.faults.course
    assert math.sqrt(noise) == pytest.approx(3.0, rel=0.1) and math.sqrt(variance) / DEG < 4.1

    def told(north_m):
        return told_by_fixes(compass, state, place[0] + north_m / state[15], place[1])

    assert told(0.0) == variance
    assert told(1e3) == pytest.approx(2.0 * noise / 1e6, rel=0.01)
    watch = nav.sensor_monitors["gps"]
    bound, own = (
        3.2905 * math.sqrt(told_by_fixes(compass, state, *watch.place)),
        3.2905 * nav.state.sd[8],
    )
    unnoticed = nav.filter.unnoticed[1]
    assert nav.health.bounds.heading_rad == pytest.approx(bound + unnoticed) and bound > own
    compass.faults.course = ()
    assert nav.health.bounds.heading_rad == pytest.approx(own + unnoticed)


def test_a_way_that_is_turned_is_told_from_one_that_is_drawn_off():
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 80.0)
    heading = np.where(time_s < 40.0, 0.0, 1.5)
    way = np.cumsum(1.5 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    nav = np.zeros(17)
    nav[15] = nav[16] = RADIUS_M

    def fitted(fixes):
        course = TrackRotationFit(0.0, 0.0, 0.0)
        for t, place, fix in zip(time_s, way, fixes, strict=True):
            nav[0], nav[1] = place / RADIUS_M
            course = course.and_then(t, nav, fix - place)
        return course.fitted()

    noise = 0.5 * rng.normal(size=way.shape)
    c, s = math.cos(0.4), math.sin(0.4)
    angle, size, ratio, beside_turned, beside_drawn = fitted(way @ np.array([[c, s], [-s, c]]) + noise)
    assert angle == pytest.approx(0.4, abs=0.02) and ratio == pytest.approx(1.0, abs=0.02)
    assert beside_turned < 1.0 < 10.0 < beside_drawn
    assert size == pytest.approx(np.var(way, axis=0).sum())
    *_, beside_turned, beside_drawn = fitted(way + time_s[:, None] * np.array([0.4, 0.0]) + noise)
    assert beside_drawn < 1.0 < 10.0 < beside_turned


def test_the_bound_holds_where_a_compass_that_nobody_has_confirmed_may_have_led():
    vehicle, mission = short(30.0)
    nav, _ = fly(vehicle, mission)
    compass, place = nav.filter.channels["compass"], nav.filter.nav
    before_m = nav.state.bounds.horizontal_m
    compass.faults.alone = (0.5 * math.pi, float(place[0]) - 100.0 / RADIUS_M, float(place[1]))
    # turned by a right angle, 100 m ago: as far off as the diagonal
    assert led_astray(compass, place) == pytest.approx(100.0 * math.sqrt(2.0), rel=0.01)
    assert nav.state.bounds.horizontal_m > 141.0 > before_m
    compass.faults.alone = ()
    assert led_astray(compass, place) == 0.0 and nav.state.bounds.horizontal_m == before_m


@pytest.mark.parametrize("seed", [11, 12])
def test_fixes_are_not_blamed_for_long_for_a_dvl_and_a_compass_that_are_described_wrongly(seed, monkeypatch):
    vehicle, mission = simulate_scenario("miscalibrated", seed, 240.0)

    def rms():
        track = nf.replay(vehicle, mission)
        return track, math.sqrt(np.nanmean(track.errors(mission.truth).horizontal ** 2))

    judged, rms_m = rms()
    assert judged.counts["astray"] + judged.counts["jumped"] >= 1  # it is said
    monkeypatch.setattr("navfilter.filter.sensor_channel.believed", lambda sensor, group: np.full(sensor.axes, np.inf))
    believing, plain_m = rms()
    assert believing.counts["astray"] == 0 and rms_m < plain_m


def test_what_has_gone_astray_is_kept_in_a_snapshot():
    vehicle, mission = short(75.0)
    broken = altered(mission, "compass", turned, 0.0)
    nav, _ = fly(vehicle, broken, until_s=45.0)
    assert nav.filter.channels["compass"].faults.alone and nav.filter.channels["gps"].faults.refused.course.count > 3
    again = nf.Navigator.restore(vehicle, nav.snapshot())
    assert not differences(again.memory.filter, nav.memory.filter)
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    whole, _ = fly(vehicle, broken)
    np.testing.assert_array_equal(track.attitude[-1], whole.state.roll_pitch_heading)


@pytest.mark.parametrize(("drawn_m_s", "blamed"), [(0.5, "astray"), (0.05, "jumped")])
def test_what_pulls_fixes_slowly_is_dead_reckoning(drawn_m_s, blamed):
    """A DVL that reads 3 % too much, or fixes that are drawn off by a third of the speed: the same estimate of their
    slow error in the end.
    """
    vehicle, mission = simulate_scenario("reckoning", 1, 500.0)
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    channel, most_s = nav.filter.channels["gps"], 0.0
    for event in events_of(vehicle, mission):
        if event.sensor == "gps":
            continue
        one_by_one(nav, [event])
        if event.sensor == "depth":
            place = watched.truth_at(mission.truth, event.true_s)
            drawn = max(0.0, event.true_s - 60.0) * drawn_m_s / RADIUS_M
            nav.correct("gps", event.true_s, (place.latitude + drawn, place.longitude, place.height))
            most_s = max(most_s, float(channel.pulled[0]) * channel.period_s)
        if nav.counts["astray"] + nav.counts["jumped"]:
            break
    assert {name for name in ("astray", "jumped") if nav.counts[name]} == {blamed}
    assert (most_s < 40.0) == (blamed == "astray")
    velocity = nav.filter.in_force.drive.models[3:]
    assert has_offset(velocity) == (blamed == "jumped")


def test_a_unit_that_runs_away_from_its_dvl_is_not_a_dvl_that_jumps_again_and_again():
    """Seed 302 of `dvl-coloured`: the DVL is described as better than it is, and refused from an outlier on. The unit,
    whose tilt is off, goes away from it, and what it has been refused with was taken for its jump, 42 times: 80 km.
    """
    staged = Campaign("dvl-coloured", motion="lawnmower", gyro="tactical", imu_rate_hz=50.0).staged
    mission = staged.mission(302)
    track = nf.replay(staged.vehicle, mission, output_rate_hz=1.0)
    assert track.counts["jumped"] <= 3
    assert np.nanmax(track.errors(mission.truth).horizontal) < 100.0


def test_fixes_and_dvl_turn_a_heading_that_gyros_alone_have_led():
    """A gyro about the vertical that goes wrong for a while, and no compass: the fixes were refused for good, the
    heading sure to 6 deg, and the way of the vehicle another one.
    """
    plain = survey_vehicle()
    sensors = {name: sensor for name, sensor in plain.sensors.items() if name != "compass"}
    vehicle = nf.Vehicle(plain.drive, sensors).with_error(gps=nf.White(sd=0.2))
    mission = simulate(vehicle, lawnmower(300.0), seed=4, duration_s=300.0).hide("gps", (55.0, 120.0))
    imu = mission.streams["imu"]
    age_s = imu.time_s - 60.0
    wrong = imu.value + (0.005 * age_s * ((age_s > 0.0) & (age_s < 20.0)))[:, None] * np.eye(6)[2]
    spoiled = mission.with_stream("imu", nf.Stream(imu.time_s, wrong, imu.columns))
    smoothed = nf.replay(vehicle, spoiled, smooth=True, output_rate_hz=1.0)
    for track in (smoothed.forward, smoothed):
        errors, late = track.errors(mission.truth), track.time_s > 160.0
        nees = track.nees(errors)
        assert np.nanmax(errors.horizontal[late]) < 1.0
        assert max(float(np.nanmean(nees[what][late])) for what in ("position", "velocity", "heading")) < 4.0


@pytest.mark.parametrize("begin_s", [5.0, 60.0])
def test_fixes_of_a_place_that_no_vehicle_reaches_are_never_let_in(begin_s):
    """Latitude and longitude with the sign changed: the gate doubled every 20 s until it let them in, 12000 km off."""
    drive = reckoning_vehicle()
    gate = nf.Position(rate_hz=1.0, error=nf.White(sd=3.0), gate_timeout_s=0.5)  # what takes forty minutes else
    vehicle = nf.Vehicle(drive.drive, {**drive.sensors, "gps": gate})
    mission = simulate(vehicle, lawnmower(120.0), seed=2, duration_s=120.0)
    fixes = mission.streams["gps"]
    other = fixes.value * np.where(fixes.time_s > begin_s, -1.0, 1.0)[:, None] ** np.array([1, 1, 0])
    track = nf.replay(vehicle, mission.with_stream("gps", nf.Stream(fixes.time_s, other)), output_rate_hz=1.0)
    assert np.nanmax(track.errors(mission.truth).horizontal) < 20.0

"""Initial alignment, magnetics and sensors' own readings."""

import dataclasses
import datetime

import numpy as np
import pytest

import navfilter as nf
from navfilter.models.state import matrix_from_euler
from navfilter.simulation.scenarios import simulate_scenario


def imu_mission(roll, pitch, heading, *, compass=True, fixes=None, scale=1.0, sign=1.0):
    """Ten seconds at rest (or as the fixes say) with a true compass."""
    C = matrix_from_euler(roll, pitch, heading)
    t = np.arange(0.0, 10.0, 0.01)
    force = sign * scale * (C.T @ np.array([0.0, 0.0, -9.80665]))
    streams = {
        "imu": nf.Stream(t, np.tile(np.concatenate([np.zeros(3), force]), (len(t), 1))),
        "gps": nf.Stream(*((np.arange(10.0), np.tile([0.7, 0.2, 5.0], (10, 1))) if fixes is None else fixes)),
    }
    if compass:
        streams["compass"] = nf.Stream(t[::10], np.full((len(t[::10]), 1), heading))
    return nf.Mission("rest", streams)


def vehicle(**compass):
    sensors = {
        "gps": nf.Position(error=nf.White(sd=2.0)),
        "compass": nf.Heading(rate_hz=10, error=nf.White(sd=0.01), **compass),
    }
    return nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors=sensors)


def test_levels_and_takes_the_compass():
    roll, pitch, heading = np.radians([5.0, -3.0, 200.0])
    start = nf.align(vehicle(), imu_mission(roll, pitch, heading))
    # no noise in this mission: only the rounding of a mean of 500 equal numbers
    assert np.allclose([start.roll_deg, start.pitch_deg], [5.0, -3.0], atol=1e-9)
    assert (start.heading_deg - 200.0) % 360 == pytest.approx(0.0, abs=1e-9) or (
        start.heading_deg + 160.0
    ) == pytest.approx(0.0, abs=1e-9)
    assert start.tilt_sd_deg > 0.2 and start.heading_sd_deg >= 0.5
    assert start.position_sd_m == (20.0, 20.0, 20.0)  # the fix says it again


@pytest.mark.parametrize(("change", "words"), [({"sign": -1.0}, "points down"), ({"scale": 1 / 9.80665}, "Units in g")])
def test_says_what_is_wrong_with_the_force(change, words):
    with pytest.raises(ValueError, match=words):
        nf.align(vehicle(), imu_mission(0.0, 0.0, 0.0, **change))


def test_course_between_fixes_replaces_a_missing_compass():
    t = np.arange(30.0)
    fixes = (t, np.column_stack([0.7 + t * 1.0 / 6.37e6, 0.2 + t * 1.0 / (6.37e6 * np.cos(0.7)), np.full(30, 5.0)]))
    start = nf.align(vehicle().without("compass"), imu_mission(0.0, 0.0, 0.0, compass=False, fixes=fixes))
    assert start.heading_deg == pytest.approx(45.0, abs=0.5)  # the radii differ by 0.3 % north and east
    # 11 fixes are 15.6 m, the first that are more than five times the 2.8 m by which two of them err apart
    assert start.heading_sd_deg == pytest.approx(np.hypot(15.0, np.degrees(2.0 / 11.0)), rel=0.01)


def test_no_position_and_no_heading_are_said():
    mission = imu_mission(0.0, 0.0, 0.0, compass=False)
    with pytest.raises(ValueError, match="no heading"):
        nf.align(vehicle().without("compass"), mission)
    with pytest.raises(ValueError, match="no position sensor"):
        nf.align(vehicle().without("gps"), mission)


def test_alignment_of_a_simulated_mission_is_honest():
    v, mission = simulate_scenario("lawnmower", 3, 120.0)
    start = nf.align(v, dataclasses.replace(mission, start=None))
    row = np.searchsorted(mission.truth.time_s, start.time_s)
    truth = mission.truth.value[row]
    # 4 sigma of what the alignment itself claims
    error = np.degrees(
        np.arctan2(np.sin(np.radians(start.heading_deg) - truth[8]), np.cos(np.radians(start.heading_deg) - truth[8]))
    )
    assert abs(error) < 4 * start.heading_sd_deg
    assert abs(start.roll_deg - np.degrees(truth[6])) < 4 * start.tilt_sd_deg
    assert abs(start.pitch_deg - np.degrees(truth[7])) < 4 * start.tilt_sd_deg
    track = nf.replay(v, dataclasses.replace(mission, start=None))
    assert np.isfinite(track.covariance).all()


@pytest.mark.parametrize(("lat", "lon", "expected"), [(80.0, 0.0, -1.28), (0.0, 120.0, 0.16), (-80.0, 240.0, 69.36)])
def test_declination_gives_the_test_values_of_wmm2020(lat, lon, expected):
    # test values published with WMM2020 for 2020.0 at height 0, printed to 0.01 degree
    assert np.degrees(nf.declination(lat, lon, 0.0, datetime.date(2020, 1, 1))) == pytest.approx(expected, abs=0.006)


def test_declination_errors():
    with pytest.raises(ValueError, match="needs a date"):
        nf.declination(32.8, 35.0, 0.0, None)
    with pytest.raises(ValueError, match="no World Magnetic Model"):
        nf.declination(32.8, 35.0, 0.0, datetime.date(1980, 1, 1))
    assert nf.declination(32.8, 215.0, 0.0, datetime.date(2024, 6, 1)) == pytest.approx(
        nf.declination(32.8, -145.0, 0.0, datetime.date(2024, 6, 1))
    )


@pytest.mark.parametrize("planar", [False, True])
def test_iron_calibration_recovers_what_was_put_in(planar):
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(400, 3))
    if planar:
        angle = np.linspace(0, 2 * np.pi, 400)
        direction = np.column_stack([np.cos(angle), np.sin(angle), np.full(400, 1.2)])
        field = 50.0 * direction
    else:
        field = 50.0 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    iron = np.array([[1.1, 0.05, 0.0], [0.05, 0.95, 0.0], [0.0, 0.0, 1.0]])
    hard, soft = nf.calibrate_magnetometer(field @ iron.T + [5.0, -8.0, 0.0])
    clean = (field @ iron.T + [5.0, -8.0, 0.0] - hard) @ np.reshape(soft, (3, 3)).T
    radius = np.linalg.norm(clean[:, :2], axis=1) if planar else np.linalg.norm(clean, axis=1)
    assert radius.std() < 1e-6 * radius.mean()  # no noise was added


def test_iron_calibration_refuses_an_arc():
    angle = np.linspace(0, 0.2, 100)
    with pytest.raises(ValueError, match="short arc"):
        nf.calibrate_magnetometer(np.column_stack([np.cos(angle), np.sin(angle), np.ones(100)]))


def test_depth_from_pressure_follows_teos10():
    # example of the Gibbs SeaWater toolbox's own documentation: 1000 dbar at 4 degrees latitude is 992.0919 m
    depth = nf.Depth(pressure=True, latitude_deg=4.0).read(np.array([1000.0e4 + 101325.0]))
    assert depth[0] == pytest.approx(992.0919, abs=1e-3)


def test_readings_that_are_none():
    dvl, gps = nf.BodyVelocity(), nf.Position(max_hdop=4)
    assert dvl.read(np.zeros(3)) is None
    assert dvl.read(np.array([-32.768, -32.768, -32.768])) is None
    assert np.isnan(dvl.read(np.array([1.0, np.nan, 99.0]))).tolist() == [False, True, True]
    assert nf.BodyVelocity(zero_is_invalid=False).read(np.zeros(3)) is not None
    assert gps.read(np.array([0.7, 0.2, 5.0, 4.1])) is None
    assert gps.read(np.array([45.0, 0.2, 5.0])) is None  # degrees for radians
    assert gps.read(np.array([0.7, 0.2, 5.0, 1.0])).tolist() == [0.7, 0.2, 5.0]


def test_magnetometer_and_heading_give_the_same_track():
    """A level field vector that points where the compass says must have the same effect as the compass."""
    heading = np.radians(70.0)
    rest = imu_mission(0.0, 0.0, heading)
    C = matrix_from_euler(0.0, 0.0, heading)
    field = C.T @ np.array([30.0, 0.0, 40.0])
    stream = nf.Stream(rest.streams["compass"].time_s, np.tile(field, (len(rest.streams["compass"]), 1)))
    start = nf.Start(
        latitude_deg=40.1, longitude_deg=11.5, height_m=5.0, heading_deg=65.0, heading_sd_deg=10.0, tilt_sd_deg=0.01
    )
    one = nf.replay(vehicle(declination_rad=0.0), rest, start=start)
    two = nf.replay(vehicle(magnetometer=True, declination_rad=0.0), rest.with_stream("compass", stream), start=start)
    assert one.attitude[-1, 2] == pytest.approx(heading, abs=np.radians(0.5))  # 100 readings of 0.57 deg
    # the magnetometer also depends on tilt, known here to 0.01 deg; dip tan = 4/3
    assert np.abs(one.attitude[:, 2] - two.attitude[:, 2]).max() < np.radians(0.02)


# --- the first fix ------------------------------------------------------------------------------------------------


def rows_of(*places):
    """Fixes once a second [rad]."""
    return np.arange(float(len(places))), np.array([(*place, 5.0) for place in places])


HERE, THERE = (0.7, 0.2), (0.7, 0.25)


def test_a_receiver_without_a_fix_is_not_at_zero_zero():
    fixes = rows_of(*[(0.0, 0.0)] * 3, *[HERE] * 7)
    start = nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=fixes))
    assert (start.time_s, start.latitude_deg) == (3.0, pytest.approx(np.degrees(0.7)))
    with pytest.raises(ValueError, match=r"10 of 10 position readings say latitude 0.*Wait for a fix, or give a start"):
        nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=rows_of(*[(0.0, 0.0)] * 10)))


def test_a_vehicle_that_is_near_zero_zero_starts_there():
    near = [(1e-9 * k, -2e-9 * k) for k in range(10)]  # the first one says what a receiver without a fix does
    start = nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=rows_of(*near)))
    assert start.time_s == 1.0 and abs(start.latitude_deg) < 1e-6
    nav = nf.Navigator(vehicle(), start)
    nav.step(1.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.78))
    assert nav.correct("gps", 1.01, (1e-9, -2e-9, 5.0)).status == "used"
    assert nav.correct("gps", 1.02, (0.0, 0.0, 5.0)).status == "invalid"


def test_the_start_is_a_fix_that_others_agree_with():
    fixes = rows_of(THERE, *[HERE] * 9)
    assert nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=fixes)).time_s == 1.0
    # one alone is believed, and so is one that another cannot be told from
    assert nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=rows_of(THERE))).longitude_deg > 14.0
    jumping = rows_of(*[((0.7 + 0.01 * k), 0.2) for k in range(10)])
    with pytest.raises(ValueError, match="none of the 10 fixes agrees") as refused:
        nf.align(vehicle(), imu_mission(0.0, 0.0, 0.5, fixes=(np.arange(10.0), jumping[1])), window_s=20.0)
    assert "give a start" in str(refused.value)


def test_the_course_is_not_that_from_zero_zero():
    moving = [(0.7 + 3e-6 * k, 0.2) for k in range(10)]
    fixes = rows_of(HERE, (0.0, 0.0), *moving[2:])
    start = nf.align(vehicle().without("compass"), imu_mission(0.0, 0.0, 0.0, compass=False, fixes=fixes))
    assert start.heading_deg == pytest.approx(0.0, abs=1e-6)


def going(m_s, *, after_s=0.0, seconds=90.0, noise_m=0.0, every_s=1.0):
    """Fixes of a vehicle that goes north from some time on."""
    t = np.arange(0.0, seconds, every_s)
    noise = noise_m * np.random.default_rng(7).standard_normal((len(t), 2))
    north = m_s * np.maximum(t - after_s, 0.0) + noise[:, 0]
    return t, np.column_stack([0.7 + north / 6.37e6, 0.2 + noise[:, 1] / (6.37e6 * np.cos(0.7)), np.full(len(t), 5.0)])


def without_compass(fixes, error=None, **more):
    """A vehicle whose heading only its fixes tell, and its mission."""
    mission = imu_mission(0.0, 0.0, 0.0, compass=False, fixes=fixes)
    t = np.arange(0.0, fixes[0][-1], 0.1)
    imu = nf.Stream(t, np.tile(mission.streams["imu"].value[0], (len(t), 1)))
    gps = nf.Position(error=nf.White(sd=2.0) if error is None else error, **more)
    return nf.Vehicle(imu=nf.Imu(rate_hz=10), sensors={"gps": gps}), mission.with_stream("imu", imu)


def test_noise_of_fixes_is_no_course():
    """Found by aligning on them: of 5 m of noise the course was said to be known to 15 deg, NEES 39."""
    with pytest.raises(ValueError, match=r"do not move 10 m and 5 times what they err apart"):
        nf.align(*without_compass(going(0.0, noise_m=5.0), nf.White(sd=5.0)))
    start = nf.align(*without_compass(going(1.5, noise_m=5.0), nf.White(sd=5.0)))
    assert 15.0 < start.heading_sd_deg < 20.0 and abs(start.heading_deg) < 2.0 * start.heading_sd_deg


def test_a_leap_of_fixes_is_no_course():
    t, value = going(1.5)
    value[4, 1] += 200.0 / (6.37e6 * np.cos(0.7))
    start = nf.align(*without_compass((t, value)))
    assert abs(start.heading_deg) < 1.0


def test_a_vehicle_that_rests_starts_when_it_goes():
    start = nf.align(*without_compass(going(2.0, after_s=150.0, seconds=200.0)))
    # as far back as a way may begin from its end, the first second at which fixes are 15 m apart
    assert start.time_s == pytest.approx(150.0 + 8.0 - 60.0) and abs(start.heading_deg) < 1.0


def test_fixes_tell_the_velocity_where_no_sensor_does():
    start = nf.align(*without_compass(going(15.0)))
    assert np.allclose(start.velocity_n, (15.0, 0.0, 0.0), atol=1e-6)
    assert start.velocity_sd_m_s == pytest.approx(np.hypot(2.0 * np.sqrt(2.0) / 5.0, 1.0))
    seldom = nf.align(*without_compass(going(2.0, every_s=10.0), rate_hz=0.1))
    assert seldom.velocity_n == (0.0, 0.0, 0.0) and seldom.velocity_sd_m_s == 2.0


def test_the_place_is_that_of_the_vehicle_not_of_its_antenna():
    v, mission = vehicle(), imu_mission(0.0, 0.0, np.radians(90.0))
    arm = dataclasses.replace(v.sensors["gps"], lever_arm_b_m=(2.0, 0.0, -3.0))
    start = nf.align(nf.Vehicle(v.drive, {**v.sensors, "gps": arm}), mission)
    assert np.radians(start.longitude_deg) == pytest.approx(0.2 - 2.0 / (6.37e6 * np.cos(0.7)), abs=1e-12)
    assert start.height_m == pytest.approx(2.0) and start.latitude_deg == pytest.approx(np.degrees(0.7), abs=1e-9)


def test_nothing_is_counted_twice():
    """The fix and the level that a start is made of are seen again: two readings of one slow error are one."""
    slow = nf.GaussMarkov(sd=3.0, tau_s=1e5)
    accel = nf.White(density=1e-3) + nf.RandomWalk(density=1e-6, start_sd=0.15)
    sensors = {"gps": nf.Position(error=slow), "compass": nf.Heading(rate_hz=10, error=nf.White(sd=0.01))}
    sensors["dvl"] = nf.BodyVelocity(rate_hz=10, error=nf.White(sd=0.01))
    v = nf.Vehicle(imu=nf.Imu(rate_hz=100, accel=accel), sensors=sensors)
    mission = imu_mission(0.0, 0.0, 0.0)
    mission = mission.with_stream("dvl", nf.Stream(np.arange(0.0, 10.0, 0.1), np.zeros((100, 3))))
    last = nf.replay(v, mission).covariance[-1]
    # what is left out are 1 % and 10 % of the variance, see `align`
    assert np.sqrt(last[0, 0]) > 0.99 * 3.0 and np.sqrt(last[6, 6]) > 0.94 * 0.15 / 9.81


def test_an_ahrs_tells_the_heading():
    """Mounted with its nose to starboard; it needs no way, and its yaw may be missing for a while."""
    v, mission = vehicle(), imu_mission(0.1, -0.05, 1.0)
    own = matrix_from_euler(0.1, -0.05, 1.0) @ matrix_from_euler(0.0, 0.0, np.pi / 2.0)
    angles = [np.arctan2(own[2, 1], own[2, 2]), -np.arcsin(own[2, 0]), np.arctan2(own[1, 0], own[0, 0])]
    read = np.tile(angles, (50, 1))
    read[:10, 2] = np.nan
    yaw = nf.GaussMarkov(sd=0.01, tau_s=100.0)
    ahrs = nf.Attitude(rate_hz=5, mounting_rad=(0.0, 0.0, np.pi / 2.0), error=(yaw, yaw, yaw))
    v = nf.Vehicle(v.drive, {"gps": v.sensors["gps"], "ahrs": ahrs})
    mission = mission.without_stream("compass").with_stream("ahrs", nf.Stream(np.arange(50) / 5.0, read))
    start = nf.align(v, mission)
    assert start.time_s == 0.0 and np.radians(start.heading_deg) == pytest.approx(1.0, abs=1e-9)
    assert start.heading_sd_deg == pytest.approx(10.0 * np.hypot(np.degrees(0.01), 0.5))


def test_a_compass_that_begins_late_is_waited_for():
    """Unless the vehicle goes before: then the course is known first, as it is to a run that is fed live."""
    v, mission = without_compass(going(0.0))
    v = nf.Vehicle(v.drive, {**v.sensors, "compass": nf.Heading(rate_hz=1, error=nf.White(sd=0.01))})
    compass = nf.Stream(np.arange(40.0, 90.0), np.full((50, 1), 1.0))
    start = nf.align(v, mission.with_stream("compass", compass))
    assert start.time_s == 35.0 and np.radians(start.heading_deg) == pytest.approx(1.0)
    gone = without_compass(going(2.0, after_s=10.0))[1].with_stream("compass", compass)
    start = nf.align(v, gone)
    assert start.time_s < 20.0 and abs(start.heading_deg) < 1.0

"""Near a magnetic pole: the declination's own error, tilts that turn a magnetometer, and what is said of it."""

import datetime
import math
from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.check import check_mission
from navfilter.check.description import describe_vehicle
from navfilter.evaluation.assessment import assess
from navfilter.models.magnetic import north
from navfilter.simulation import presets
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

DEG = np.pi / 180.0
DAY = datetime.date(2026, 6, 1)
#: Horizontal field 5100 nT, 600 nT, and 23000 nT.
CAUTION, BLACKOUT, ORDINARY = (-61.4, 118.5), (-64.0, 137.0), (45.0, 10.0)
COMPASS = nf.Heading(rate_hz=4, magnetic=True, error=nf.GaussMarkov(sd=0.3 * DEG, tau_s=20.0) + nf.White(sd=0.2 * DEG))
MAGNETOMETER = nf.Heading(rate_hz=4, magnetometer=True, error=nf.White(sd=0.2 * DEG))
AHRS = nf.Attitude(rate_hz=4, magnetic=True, error=nf.GaussMarkov(sd=0.4 * DEG, tau_s=20.0))
DVL = nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01))


def start(place):
    return nf.Start(latitude_deg=place[0], longitude_deg=place[1], date=DAY)


def way(place, seconds=300.0):
    legs = (Straight(duration_s=50.0), Turn(90.0), Straight(duration_s=30.0), Turn(90.0))
    return Motion((ChangeSpeed(1.5), *legs * math.ceil(seconds / 80.0)), latitude_deg=place[0], longitude_deg=place[1])


def vehicle(**sensors):
    return nf.Vehicle(presets.mems_imu(), {"dvl": DVL, "depth": nf.Depth(), "gps": nf.Position(), **sensors})


def reckoning(compass=COMPASS):
    return nf.Vehicle(nf.DeadReckoning(rate_hz=4, attitude=compass, velocity=DVL), {"gps": nf.Position()})


def dive(described, place, seed, tilt_sd_deg=0.3, seconds=300.0):
    begin = StartErrors(heading_sd_deg=4.0, tilt_sd_deg=tilt_sd_deg)
    surface = {"gps": Faults(available="surface")}
    return simulate(described, way(place), seed=seed, duration_s=seconds, start=begin, faults=surface)


def heading(described, missions):
    """Mean NEES of the heading, and the share beyond three sigma [1]."""
    nees = []
    for mission in missions:
        track = nf.replay(described, mission, output_rate_hz=1.0)
        nees.append(track.nees(track.errors(mission.truth))["heading"][5:])
    return np.mean(nees), np.mean(np.concatenate(nees) > 9.0)


@pytest.mark.parametrize("place", [CAUTION, BLACKOUT, ORDINARY])
def test_the_declination_errs_by_what_the_report_of_the_model_says(place):
    """Which gives it as ``sqrt(0.26^2 + (5417 / H)^2)`` degrees, H in nT; 0.29 where the field is strongest, 41875."""
    there = north(*place, 0.0, DAY)
    assert there.sd / DEG == pytest.approx(math.sqrt(0.26**2 + (5417.0 / there.horizontal_nt) ** 2), rel=1e-12)
    assert abs(there.dip) > 80.0 * DEG or place == ORDINARY


def test_at_the_pole_itself_nothing_is_known_and_no_more_than_that():
    magnetic_pole = north(-63.85, 135.08, 0.0, DAY)
    assert magnetic_pole.horizontal_nt < 100.0 and magnetic_pole.sd <= math.pi / math.sqrt(3.0)


def test_only_the_models_declination_is_doubted_and_only_where_the_model_warns():
    for sensor in (COMPASS, MAGNETOMETER, AHRS):
        there = sensor.at(start(CAUTION))
        assert there.declination_sd_rad == north(*CAUTION, 0.0, DAY).sd
        assert there.at(start(BLACKOUT)) is there
        assert sensor.at(start(ORDINARY)) is sensor
        for known in ({"declination_rad": 0.1}, {"declination_sd_rad": 0.02}):
            stated = replace(sensor, **known)
            assert stated.at(start(CAUTION)) is stated
    assert nf.Heading().at(start(CAUTION)) == nf.Heading()
    assert vehicle(compass=COMPASS).at(start(ORDINARY)).sensors["compass"] is COMPASS


def test_bias_and_declination_are_one_state():
    described = replace(COMPASS, bias_sd_rad=0.03, declination_sd_rad=0.04)
    assert described.parameters()[0].sd == pytest.approx(0.05)
    yaw = reckoning(described).drive.models[2].block(0.25)
    assert float(yaw.C @ yaw.P0 @ yaw.C) == pytest.approx((0.3 * DEG) ** 2 + 0.05**2)


def test_the_declination_of_an_attitude_turns_about_what_is_down_in_the_instrument():
    on_its_side = replace(AHRS, mounting_rad=(90.0 * DEG, 0.0, 0.0), declination_sd_rad=0.04)
    assert [p.sd for p in on_its_side.parameters()] == pytest.approx([0.0, 0.04, 0.0], abs=1e-12)
    assert AHRS.parameters() == ()


@pytest.mark.parametrize("sd", [-0.1, math.inf, math.nan])
@pytest.mark.parametrize("kind", [nf.Heading, nf.Attitude])
def test_an_uncertainty_that_is_none_is_refused(kind, sd):
    with pytest.raises(ValueError, match=rf"{kind.__name__}\.declination_sd_rad must be a finite number >= 0"):
        kind(declination_sd_rad=sd)


def test_a_start_by_a_magnetometer_knows_what_its_tilt_makes_of_the_heading():
    there = north(*CAUTION, 0.0, DAY)
    field = np.array([[1.0, 0.0, math.tan(there.dip)]])
    _, variance, slope = MAGNETOMETER.headings(field, np.eye(3), start(CAUTION))
    assert variance == pytest.approx(MAGNETOMETER.mean_variance(0, 1) + there.sd**2)
    assert slope == pytest.approx(abs(math.tan(there.dip)))
    _, variance, slope = AHRS.headings(np.zeros((1, 3)), np.eye(3), start(CAUTION))
    assert variance == pytest.approx((0.4 * DEG) ** 2 + there.sd**2) and slope == 0.0


def test_a_vehicle_that_leans_beside_the_pole_is_aligned_within_what_the_start_says():
    """By the accelerometers, whose bias of 0.2 deg is 2.6 deg of heading there."""
    off = []
    for seed in range(1, 9):
        described = vehicle(compass=MAGNETOMETER)
        mission = dive(described, CAUTION, seed, seconds=20.0)
        begin = nf.align(described, mission)
        off.append(
            np.angle(np.exp(1j * (begin.heading_deg * DEG - mission.truth.value[0, 8]))) / DEG / begin.heading_sd_deg
        )
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.parametrize("place", [CAUTION, BLACKOUT, ORDINARY])
@pytest.mark.parametrize("described", [vehicle(compass=MAGNETOMETER), vehicle(ahrs=AHRS), reckoning()])
def test_the_heading_is_honest(described, place):
    nees, beyond = heading(described, [dive(described, place, seed) for seed in range(1, 7)])
    assert nees < 2.5 and beyond < 0.05


def test_a_tilt_that_is_hardly_known_tells_no_heading():
    """Fixes tell the tilt after five seconds; what a magnetometer said of both before was believed to 1.2 deg."""
    fixes = nf.Position(rate_hz=0.2, error=nf.White(sd=0.1))
    described = nf.Vehicle(presets.tactical_imu(), {"compass": MAGNETOMETER, "gps": fixes, "depth": nf.Depth()})
    begin = StartErrors(heading_sd_deg=4.0, tilt_sd_deg=0.8)
    missions = [simulate(described, way(CAUTION), seed=s, duration_s=150.0, start=begin) for s in range(1, 13)]
    nees, beyond = heading(described, missions)
    assert nees < 3.0 and beyond < 0.02


def test_what_is_simulated_of_a_compass_that_drives_counts_from_magnetic_north():
    exact = replace(COMPASS, error=nf.White(sd=1e-9))
    still = replace(reckoning(exact).drive, tilt=nf.White(sd=1e-9))
    mission = simulate(nf.Vehicle(still, {}), way(ORDINARY), seed=1, duration_s=60.0)
    yaw = np.interp(
        mission.truth.time_s, *(mission.streams["attitude"].time_s, mission.streams["attitude"].value[:, 2])
    )
    off = mission.truth.column("yaw_rad") - yaw
    assert off[:100] == pytest.approx(nf.declination(*ORDINARY, 0.0, DAY), abs=1e-6)


def said(mission, described=None):
    return [(f.severity, f.stream) for f in check_mission(mission, described) if f.code == "north"]


@pytest.mark.parametrize(("place", "words"), [(CAUTION, ["info"]), (BLACKOUT, ["warning"]), (ORDINARY, [])])
def test_a_check_and_the_verdict_say_so(place, words):
    for described, name in ((vehicle(compass=MAGNETOMETER), "compass"), (reckoning(), "attitude")):
        mission = dive(described, place, 1, seconds=60.0)
        assert said(mission, described) == [(word, name) for word in words]
        verdict = assess({"forward": nf.replay(described, mission)}, mission).verdict
        found = [f.severity for f in verdict.findings if f.code == "north"]
        assert found == words


def test_without_a_vehicle_a_field_is_looked_at_and_without_a_start_the_fixes_count():
    described = vehicle(compass=MAGNETOMETER)
    mission = replace(dive(described, BLACKOUT, 1, seconds=60.0), start=None, truth=None, date=None)
    field = mission.streams["compass"]
    mission = mission.with_stream("compass", nf.Stream(field.time_s, 1e-6 * field.value, MAGNETOMETER.stream_columns()))
    assert said(mission) == [("warning", "compass")]
    fixes = mission.streams["gps"]
    degrees = nf.Stream(fixes.time_s, fixes.value / DEG, fixes.columns)  # taken for radians
    assert said(mission.with_stream("gps", degrees)) == []


def test_a_declination_that_is_stated_as_exact_is_doubted():
    exact = replace(COMPASS, declination_rad=-1.3)
    mission = dive(vehicle(compass=exact), CAUTION, 1, seconds=30.0)
    assert said(mission, vehicle(compass=exact)) == [("warning", "compass")]
    assert said(mission, vehicle(compass=replace(exact, declination_sd_rad=0.02))) == [("info", "compass")]
    assert said(mission, vehicle(compass=nf.Heading())) == []


def test_the_description_says_where_north_is_from():
    words = describe_vehicle(vehicle(compass=COMPASS, ahrs=replace(AHRS, declination_rad=0.1, declination_sd_rad=0.01)))
    assert "magnetic, declination of the World Magnetic Model" in words
    assert "magnetic, declination 5.73 deg, sd 0.573 deg" in words
    assert "magnetic" not in describe_vehicle(vehicle(compass=nf.Heading()))

"""USBL: the position from a ship that moves, from any side and straight below, late, with her own errors."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import same_runs
from feeding import delayed, events_of, one_by_one
from honest_runs import assert_honest
from scipy.stats import chi2

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.kernels import measurement
from navfilter.models.state import NavState, matrix_from_euler
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import StartErrors, simulate

DEG = math.pi / 180.0
SEEDS = range(12)
MOTION = Motion(
    (Wait(5.0), ChangeSpeed(1.5, 10.0), Dive(30.0), Lawnmower(4, 60.0)), latitude_deg=26.0, heading_deg=40.0
)
ERROR = (nf.White(sd=0.3), nf.White(sd=0.3 * DEG), nf.White(sd=0.5 * DEG))
UNCERTAIN = {"misalignment_sd_rad": 0.01, "scale_sd": 0.005, "ship_sd_m": (1.0, 1.0, 1.0)}


def vehicle_with(**usbl):
    given = {
        "error": ERROR,
        "lever_arm_b_m": (0.3, 0.0, -0.2),
        "transceiver_m": (2.0, 3.0, 4.0),
        "transceiver_mounting_rad": (0.1, 0.05, 0.8),
    } | usbl
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20),
        sensors={
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.01)),
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.02), scale_sd=0.02),
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.05)),
            "usbl": nf.Usbl(rate_hz=0.5, **given),
        },
    )


def simulated(vehicle, seed, duration_s=250.0):
    return simulate(vehicle, MOTION, seed=seed, duration_s=duration_s, start=StartErrors((1.5, 1.5, 0.5)))


@cache
def runs(kind):
    vehicle = vehicle_with(**(UNCERTAIN if kind == "uncertain" else {}))
    return [(mission, nf.replay(vehicle, mission)) for mission in (simulated(vehicle, seed) for seed in SEEDS)]


@pytest.mark.parametrize("kind", ["known", "uncertain"])
def test_the_covariance_is_honest(kind):
    assert_honest(runs(kind), 120.0, 249.0)
    nis = np.concatenate([track.residuals["usbl"].nis for _, track in runs(kind)])
    assert 0.9 < float(np.mean(nis)) / 3.0 < 1.1  # 1500 readings: sd 0.021


def test_a_mounting_leaves_the_range_as_it_is():
    """Eight dives of a quarter of an hour beside a ship, mounting unsure by 2 deg: a first-order rotation lengthens the
    range by half the square of it, 6 cm in 100 m, always. Smoothed position NEES 9.6 on such missions, 1.0 now.
    """
    plain = survey_vehicle()
    usbl = nf.Usbl(rate_hz=0.2, misalignment_sd_rad=2.0 * DEG)
    vehicle = nf.Vehicle(plain.drive, {**plain.sensors, "usbl": usbl})
    dives, nees = survey(900.0, surface_s=40.0, depth_m=20.0), []
    for seed in range(701, 709):
        mission = simulate(vehicle, dives, seed=seed, duration_s=900.0)
        track = nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0)
        nees.append(np.nanmean(track.nees(track.errors(mission.truth))["position"]))
    # an hour of errors that last for minutes: the mean of eight scatters by 0.2
    assert 0.5 < np.mean(nees) < 1.6, nees


def test_a_start_that_is_hardly_known():
    """20 m off, 50 m from the ship: the direction is no small angle, and the filter knows."""
    vehicle, nis, squares = vehicle_with(), [], 0.0
    for seed in range(8):
        mission = simulate(vehicle, MOTION, seed=seed, duration_s=40.0, start=StartErrors((20.0, 20.0, 1.0)))
        track = nf.replay(vehicle, mission)
        nis += (track.residuals["usbl"].nis[:10] / 3.0).tolist()
        squares += 3.0 * track.nees(track.errors(mission.truth))["position"][-1]
    low, high = chi2.ppf([0.001, 0.999], 24)
    assert low < squares < high
    assert 0.6 < float(np.mean(nis)) < 1.4  # 80 readings of three: sd 0.09; taken as planes they gave 96


def test_it_bounds_the_position():
    """0.3 m of range, 0.3 degrees at 100 m: half a metre a reading; without it the scale of the DVL counts."""
    for mission, track in runs("known")[:3]:
        last = track.errors(mission.truth).horizontal[track.time_s > 60.0]
        assert float(np.max(last)) < 1.0 and track.residuals["usbl"].count("rejected") <= 1


def test_relative_positions_are_the_same_readings():
    polar, relative = vehicle_with(), vehicle_with(relative=True)
    tracks = [nf.replay(vehicle, simulated(vehicle, 2, 60.0)).to_frame() for vehicle in (polar, relative)]
    np.testing.assert_allclose(tracks[0], tracks[1], rtol=1e-9, atol=1e-9)


def test_readings_seconds_late_are_in_order():
    """Acoustics and the ship's radio take up to 4 s; the navigator knows that a USBL is late."""
    vehicle = vehicle_with(**UNCERTAIN)
    mission = simulated(vehicle, 5, 60.0)
    events = events_of(vehicle, mission)
    ordered, late = (nf.Navigator(vehicle, mission.start) for _ in range(2))
    one_by_one(ordered, events)
    outcomes = [outcome.status for outcome in one_by_one(late, delayed(events, ("usbl",), 4.0, seed=1))]
    assert outcomes.count("late-replayed") > 20
    same_runs.assert_same_estimate(ordered, late)


def seen(reading, north, east, down, **sensor):
    """Residual of a reading by a ship at 30 N, 10 W, of a vehicle north, east, down of her."""
    usbl = nf.Usbl(**sensor)
    ship = NavState(0.0, 30.0 * DEG, -10.0 * DEG, 5.0, np.zeros(3), matrix_from_euler(0.0, 0.0, 1.0))
    vehicle = ship.plus([north, east, down, *[0.0] * 6])
    z = usbl.read(np.array(reading))
    H, res = np.zeros((3, 9)), np.zeros(3)
    measurement.usbl(z, vehicle.pack(), np.zeros(3), np.zeros(0), usbl.constants(None), H, res)
    return res


SHIP = (30.0 * DEG, -10.0 * DEG, 5.0)


def test_signs_in_plain_situations():
    # the vehicle 100 m to starboard of a ship that heads east stands south of her
    np.testing.assert_allclose(
        seen([100.0, 0.5 * math.pi, 0.0, *SHIP, 0.0, 0.0, 0.5 * math.pi], -100.0, 0.0, 0.0), 0.0, atol=1e-4
    )
    # heard 0.01 rad too far to the right and 0.02 too deep, 1 m too far
    np.testing.assert_allclose(
        seen([101.0, 0.51, 0.02, *SHIP, 0.0, 0.0, -0.5], 100.0, 0.0, 0.0), [1.0, 0.01, 0.02], atol=2e-4
    )
    # without her attitude: from north and the horizontal; straight below there is no bearing, and it does no harm
    np.testing.assert_allclose(seen([50.0, 2.0, 0.5 * math.pi, *SHIP], 0.0, 0.0, 50.0), 0.0, atol=1e-4)
    np.testing.assert_allclose(seen([30.0, 0.0, 40.0, *SHIP], 30.0, 0.0, 40.0, relative=True), 0.0, atol=1e-4)
    # behind: no small angle, whatever the sine says
    assert seen([100.0, math.pi, 0.0, *SHIP], 100.0, 0.0, 0.0)[1] == math.pi
    # a transceiver 10 m ahead of the antenna, on a ship that heads north, turned to starboard
    mounted = {"transceiver_m": (10.0, 0.0, 0.0), "transceiver_mounting_rad": (0.0, 0.0, 0.5 * math.pi)}
    np.testing.assert_allclose(
        seen([90.0, -0.5 * math.pi, 0.0, *SHIP, 0.0, 0.0, 0.0], 100.0, 0.0, 0.0, **mounted), 0.0, atol=1e-4
    )


def test_what_is_no_reading():
    usbl = nf.Usbl()
    good = [100.0, 0.3, 0.1, *SHIP]
    for k, wrong in ((0, -1.0), (0, 1e6), (3, math.nan), (3, 2.0), (5, math.nan)):
        assert usbl.read(np.array([*good[:k], wrong, *good[k + 1 :]])) is None
    assert usbl.read(np.array([math.nan] * 3 + list(SHIP))) is None
    only_range = usbl.read(np.array([100.0, math.nan, math.nan, *SHIP]))
    assert only_range[0] == 100.0 and np.isnan(only_range[1:3]).all()
    vehicle = vehicle_with()
    mission = simulated(vehicle, 1, 20.0)
    value = mission.streams["usbl"].value.copy()
    value[:, 1:3] = np.nan
    track = nf.replay(vehicle, mission.with_stream("usbl", replace(mission.streams["usbl"], value=value)))
    assert np.all(track.residuals["usbl"].dof == 1.0)


def test_words_and_files(tmp_path):
    vehicle = vehicle_with(**UNCERTAIN)
    text = describe_vehicle(vehicle)
    assert 'Sensor "usbl": range and direction from a ship, 0.5 Hz' in text
    assert "error range" in text and "sd 0.3 m" in text and "error elevation white noise: sd 0.5 deg" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    wide = (nf.White(sd=0.3), nf.White(sd=0.5), nf.White(sd=0.01))
    odd = vehicle_with(error=wide, scale_sd=1.0, transceiver_mounting_rad=(0.0, 0.0, 30.0))
    assert {f.stream for f in check_vehicle(odd) if f.severity == "warning"} == {
        f"sensors.usbl.{field}" for field in ("error.across", "scale_sd", "transceiver_mounting_rad")
    }


def test_a_mission_file_with_the_ship_beside_it(tmp_path):
    (tmp_path / "u.csv").write_text(
        "t,r,b,e,lat,lon,hdg,sr,sb\n0,100,90,,26,-80,45,0.5,0.2\n1,101,91,-5,26,-80,46,1,1\n"
    )
    (tmp_path / "mission.toml").write_text(
        '[streams.usbl]\nfile = "u.csv"\ntime = {column = "t"}\n'
        'usbl = {columns = ["r", "b", {column = "e", scale = -1}], unit = ["m", "deg", "deg"]}\n'
        'ship = {columns = ["lat", "lon", {constant = 0.0}], unit = ["deg", "deg", "m"]}\n'
        'ship_attitude = {columns = [{constant = 0.0}, {constant = 0.0}, "hdg"], unit = "deg"}\n'
        'sd = {columns = ["sr", "sb", "sb"], unit = ["m", "deg", "deg"]}\n'
    )
    stream = nf.read_mission(tmp_path).streams["usbl"]
    np.testing.assert_allclose(
        stream.value[:, [0, 1, 2, 8]],
        np.column_stack([[100, 101], [90 * DEG, 91 * DEG], [np.nan, 5 * DEG], [45 * DEG, 46 * DEG]]),
    )
    np.testing.assert_allclose(stream.sd[0], [0.5, 0.2 * DEG, 0.2 * DEG])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"transceiver_m": (1.0, 2.0)}, "transceiver_m must be 3 finite"),
        ({"misalignment_sd_rad": -1.0}, "misalignment_sd_rad"),
        ({"scale_sd": math.nan}, "scale_sd"),
        ({"ship_sd_m": (1.0, -1.0, 1.0)}, "ship_sd_m must not be negative"),
        ({"ship_tau_s": 0.0}, "ship_tau_s"),
        ({"late_s": 1e4}, "late_s must lie between 0 and 60"),
    ],
)
def test_wrong_ones_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        nf.Usbl(**wrong)

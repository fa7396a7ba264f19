"""Ranges to beacons: known ones carry the position, described wrongly they are corrected, unknown ones are found."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from honest_runs import assert_honest
from scipy.stats import chi2

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.io.geodesy import ecef_from_geodetic
from navfilter.kernels import consistency
from navfilter.models.sensors.ranges import earth_fixed
from navfilter.simulation import presets
from navfilter.simulation.manoeuvres import ChangeSpeed, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import StartErrors, simulate

SEEDS = range(12)
MOTION = Motion((Wait(5.0), ChangeSpeed(1.5, 10.0), Lawnmower(4, 60.0)), latitude_deg=26.0, heading_deg=40.0)
#: About 100 m north, east and south-west of the start, 40 m deep.
BEACONS = ((26.0009, 0.0, -40.0), (26.0, 0.001, -40.0), (25.9994, -0.0007, -40.0))


def vehicle_with(**ranges):
    given = {"error": nf.White(sd=0.3), "beacons": BEACONS, "lever_arm_b_m": (0.3, 0.0, -0.2)} | ranges
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20),
        sensors={
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.01)),
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.02), scale_sd=0.02),
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.05)),
            "lbl": nf.Range(rate_hz=1.0, **given),
        },
    )


def simulated(vehicle, seed, start=None):
    return simulate(vehicle, MOTION, seed=seed, duration_s=250.0, start=start or StartErrors((5.0, 5.0, 1.0)))


@cache
def runs(kind):
    given = {
        "known": {},
        "uncertain": {"scale_sd": 0.01, "offset_sd_m": 0.5, "beacon_sd_m": (3.0, 3.0, 0.3)},
    }[kind]
    vehicle = vehicle_with(**given)
    missions = [simulated(vehicle, seed) for seed in SEEDS]
    return [(mission, nf.replay(vehicle, mission)) for mission in missions]


def test_known_beacons_carry_the_position():
    vehicle = vehicle_with()
    for mission, track in runs("known")[:3]:
        alone = nf.replay(vehicle.without("lbl"), mission).errors(mission.truth).horizontal[-1]
        last = track.errors(mission.truth).horizontal[track.time_s > 60.0]
        # 0.3 m a range, every second one of three beacons
        assert float(np.max(last)) < 1.0 < alone + 1.0 and track.residuals["lbl"].count("rejected") == 0


@pytest.mark.parametrize("kind", ["known", "uncertain"])
def test_the_covariance_is_honest(kind):
    assert_honest(runs(kind), 120.0, 249.0)
    nis = np.concatenate([track.residuals["lbl"].nis for _, track in runs(kind)])
    assert 0.9 < float(np.mean(nis)) < 1.1  # 3000 readings: sd 0.026


def test_scale_offsets_and_places_come_out():
    names = ("scale", "offset_0", "offset_2", "beacon_1_north", "beacon_2_east")
    z = []
    for mission, track in runs("uncertain"):
        notes = dict(note.removeprefix("lbl: ").split(" error ") for note in mission.notes if note.startswith("lbl"))
        for name in names:
            value, sd = track.state(f"lbl.{name}")
            z.append((value[-1] - float(notes[name])) / sd[-1])
    # a mean of 60 squares of standard normal numbers, not all independent: 0.5 to 1.7 in all but one case of a thousand
    assert 0.5 < float(np.mean(np.square(z))) < 1.7
    value, sd = runs("uncertain")[0][1].state("lbl.scale")
    assert sd[-1] < 0.9 * sd[0]


def test_a_start_that_is_hardly_known():
    """20 m of 100 m: a range is no plane, and the filter knows."""
    vehicle, nis, squares = vehicle_with(), [], 0.0
    for seed in range(8):
        mission = simulate(vehicle, MOTION, seed=seed, duration_s=60.0, start=StartErrors((20.0, 20.0, 1.0)))
        track = nf.replay(vehicle, mission)
        nis += track.residuals["lbl"].nis[:10].tolist()
        squares += 3.0 * track.nees(track.errors(mission.truth))["position"][-1]
    low, high = chi2.ppf([0.001, 0.999], 24)
    assert low < squares < high
    assert 0.5 < float(np.mean(nis)) < 1.5  # 80 readings: sd 0.16; taken as planes they gave 13


def test_what_bends_is_no_plane():
    """Against the moments of drawn distances: mean and variance beyond those of the plane."""
    rng = np.random.default_rng(3)
    P = np.array([[9.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    apart = np.array([30.0, 40.0, 0.0])
    drawn = np.linalg.norm(apart + rng.multivariate_normal(np.zeros(3), P, 200_000), axis=1)
    sight = apart / 50.0
    # what the plane leaves is uncorrelated with it: the mean square about the plane's mean is the sum of both
    R, known = np.zeros((1, 1)), np.full(9, -1.0)
    consistency.range_second_order(np.array([50.0, 0.0]), np.append(sight, np.zeros(6))[None], P, 0, known, R)
    left = float(np.mean((drawn - 50.0) ** 2)) - sight @ P @ sight
    assert left == pytest.approx(R[0, 0], abs=0.06)  # 200000 draws of a variance of 8: 0.025


def test_one_beacon_beside_a_unit_that_drifts():
    """Without a velocity the place is lost by a good part of the beacon's distance, and what a plane leaves out of its
    sphere is the same from reading to reading. Taken as noise of each, it had the place believed to metres: NEES of 90
    to 1550 in half of the missions.
    """
    drive = dataclasses.replace(presets.mems_imu(), rate_hz=50.0)
    sensors = {
        "ahrs": nf.Attitude(rate_hz=1.0),
        "depth": nf.Depth(),
        "lbl": nf.Range(rate_hz=2.0, beacons=((26.003, 0.002, -10.0),), error=nf.White(sd=0.3)),
    }
    vehicle, nees = nf.Vehicle(drive, sensors), []
    for seed in range(8):
        mission = simulated(vehicle, seed)
        track = nf.replay(vehicle, mission, output_rate_hz=1.0)
        nees.append(np.mean(track.nees(track.errors(mission.truth))["position"]))
    assert np.mean(nees) < 2.0 and max(nees) < 5.0


def test_one_beacon_and_an_own_way():
    """A single beacon bounds the position while the vehicle goes round it."""
    vehicle = vehicle_with(beacons=BEACONS[:1])
    mission = simulated(vehicle, 3)
    assert mission.streams["lbl"].columns == ("range_m",)
    track = nf.replay(vehicle, mission)
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2)[:, :2])
    assert np.hypot(*sd[-1]) < 0.4 * np.hypot(*sd[0])
    assert float(track.errors(mission.truth).horizontal[-1]) < 4.0 * float(np.hypot(*sd[-1]))


def test_unknown_beacons_are_found():
    """Nothing is known of them but their depth; the vehicle knows its own way by compass and DVL."""
    vehicle = vehicle_with(offset_sd_m=0.3, scale_sd=0.005)
    vehicle = dataclasses.replace(
        vehicle, sensors={**vehicle.sensors, "lbl": dataclasses.replace(vehicle.sensors["lbl"], beacons=BEACONS[:2])}
    )
    mission = simulated(vehicle, 4, StartErrors((0.1, 0.1, 0.1)))
    astray = tuple((10.0, 20.0, height) for *_, height in BEACONS[:2])
    lost = dataclasses.replace(vehicle.sensors["lbl"], beacons=astray)
    found = nf.locate_beacons(dataclasses.replace(vehicle, sensors={**vehicle.sensors, "lbl": lost}), mission, "lbl")
    away = np.linalg.norm(found.places() - vehicle.sensors["lbl"].places(), axis=1)
    assert np.all(away < 1.5) and max(found.beacon_sd_m) < 1.5 and found.beacon_sd_m[2] == 0.0
    assert np.all(away < 4.0 * math.hypot(*found.beacon_sd_m))


def test_what_cannot_be_located_is_said():
    vehicle = vehicle_with()
    mission = simulated(vehicle, 1)
    with pytest.raises(ValueError, match=r'"dvl" is no range sensor of this vehicle \(sensors: compass, dvl'):
        nf.locate_beacons(vehicle, mission, "dvl")
    more = vehicle_with(beacons=(*BEACONS, (26.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match='beacon 3 of "lbl" was heard 0 times in this mission; at least 10'):
        nf.locate_beacons(more, mission, "lbl")


def test_the_mower_with_known_beacons(recording):
    folder = recording("mower-plaza-5hz")
    vehicle, mission = nf.read_vehicle(folder), nf.read_mission(folder)
    track = nf.replay(vehicle, mission, smooth=True)
    rms = [float(np.sqrt(np.nanmean(t.errors(mission.truth).horizontal ** 2))) for t in (track.forward, track)]
    assert rms[0] <= 0.5 and rms[1] <= 0.35
    plain = nf.replay(vehicle.without("ranges"), mission).errors(mission.truth).horizontal
    assert float(np.nanmax(plain)) > 4.0


def test_the_mower_finds_its_beacons(recording):
    folder = recording("mower-plaza-5hz")
    vehicle, mission = nf.read_vehicle(folder), nf.read_mission(folder)
    known = vehicle.sensors["ranges"]
    lost = dataclasses.replace(known, beacons=tuple((0.0, 0.0, height) for *_, height in known.beacons))
    blind = dataclasses.replace(vehicle, sensors={**vehicle.sensors, "ranges": lost})
    found = nf.locate_beacons(blind, mission, "ranges")
    assert np.all(np.linalg.norm(found.places() - known.places(), axis=1) < 1.0)


def test_words_and_file(tmp_path):
    vehicle = vehicle_with(beacon_ids=(7, 3, 5), beacon_sd_m=(1.0, 1.0, 0.0))
    text = describe_vehicle(vehicle)
    assert 'Sensor "lbl": range to 3 beacons, 1 Hz' in text and "beacon_7_north 1 m" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    odd = vehicle_with(scale_sd=1.5, offset_sd_m=300.0, beacon_sd_m=(200.0, 200.0, 0.0))
    assert {f.stream for f in check_vehicle(odd) if f.severity == "warning"} == {
        f"sensors.lbl.{field}" for field in ("scale_sd", "offset_sd_m", "beacon_sd_m")
    }
    (tmp_path / "r.csv").write_text("t,r,b\n0,100,7\n1,50,9\n")
    (tmp_path / "mission.toml").write_text(
        '[streams.lbl]\nfile = "r.csv"\ntime = {column = "t"}\nrange = "r"\nbeacon = "b"\n'
    )
    stream = nf.read_mission(tmp_path).streams["lbl"]
    assert stream.columns == ("range_m", "beacon")
    lbl = vehicle.sensors["lbl"]
    assert lbl.read(stream.value[0]).tolist() == [100.0, 0.0] and lbl.read(stream.value[1]) is None


def test_what_is_no_reading():
    one, several = nf.Range(beacons=BEACONS[:1]), nf.Range(beacons=BEACONS, beacon_ids=(4, 5, 6))
    assert one.read(np.array([12.0])).tolist() == [12.0, 0.0] and several.read(np.array([12.0])) is None
    assert several.read(np.array([12.0, 6.0])).tolist() == [12.0, 2.0]
    for value in ([0.0, 4.0], [-1.0, 4.0], [3e4, 4.0], [math.nan, 4.0], [5.0, math.nan], [5.0, 4.5]):
        assert several.read(np.array(value)) is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"beacons": ()}, "must name at least one beacon"),
        ({"beacons": ((95.0, 0.0, 0.0),)}, r"beacons\[0\] must be latitude and longitude"),
        ({"beacons": ((1.0, 0.0),)}, r"beacons\[0\] must be 3 finite numbers"),
        ({"beacon_ids": (1, 2)}, "beacon_ids must be 3 different numbers"),
        ({"beacon_ids": (1, 1, 2)}, "beacon_ids must be 3 different numbers"),
        ({"beacon_sd_m": (-1.0, 0.0, 0.0)}, "beacon_sd_m must not be negative"),
        ({"scale_sd": -0.1}, r"Range\.scale_sd"),
        ({"offset_sd_m": math.inf}, r"Range\.offset_sd_m"),
    ],
)
def test_wrong_ranges_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        nf.Range(**({"beacons": BEACONS} | wrong))


def test_points_in_the_earths_axes():
    """Against the other implementation, which reads files."""
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-1.5, 1.5, 20), rng.uniform(-3, 3, 20), rng.uniform(-6000, 500, 20)])
    np.testing.assert_allclose(earth_fixed(*places.T), ecef_from_geodetic(places), atol=1e-4)  # e^2 of ten digits

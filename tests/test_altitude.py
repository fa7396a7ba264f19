"""Height above the bottom: known it holds the height, unknown it does no harm."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import StartErrors, simulate

SEEDS = range(12)
WAY = (Wait(5.0), ChangeSpeed(1.5, 10.0), Dive(10.0), Lawnmower(3, 50.0))
MOTION = Motion(WAY, latitude_deg=26.0, heading_deg=40.0)


def vehicle_with(**altitude):
    given = {"lever_arm_b_m": (0.5, 0.0, 0.1), "bottom_height_m": -30.0} | altitude
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20),
        sensors={
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.01)),
            "dvl": nf.DvlBeams(rate_hz=4.0, lever_arm_b_m=(0.5, 0.0, 0.1)),
            "altitude": nf.Altitude(rate_hz=4.0, **given),
        },
    )


@cache
def runs(bottom_sd_m):
    vehicle = vehicle_with(bottom_sd_m=bottom_sd_m, bottom_tau_s=30.0)
    start = StartErrors(position_sd_m=(1.0, 1.0, 2.0))
    missions = [simulate(vehicle, MOTION, seed=seed, duration_s=150.0, start=start) for seed in SEEDS]
    return [(mission, nf.replay(vehicle, mission)) for mission in missions]


@pytest.mark.parametrize("bottom_sd_m", [0.0, 1.0])
def test_the_covariance_is_honest(bottom_sd_m):
    for time_s in (60.0, 149.0):
        total = 0.0
        for mission, track in runs(bottom_sd_m):
            at = int(np.searchsorted(track.time_s, time_s))
            total += track.errors(mission.truth).position_n[at, 2] ** 2 / track.covariance[at, 2, 2]
        low, high = chi2.ppf([0.0005, 0.9995], len(SEEDS))  # four figures
        assert low < total < high, (bottom_sd_m, time_s, total)
    nis = np.concatenate([track.residuals["altitude"].nis for _, track in runs(bottom_sd_m)])
    assert 0.9 < float(np.mean(nis)) < 1.1  # 7200 readings: sd 0.017


def test_a_known_bottom_holds_the_height():
    sd = [np.sqrt([track.covariance[-1, 2, 2] for _, track in runs(bottom)]).mean() for bottom in (0.0, 1.0)]
    # readings of 0.1 m beside a DVL of 1 cm/s: centimetres; over a bottom that wanders by a metre, decimetres
    assert sd[0] < 0.05 < 0.1 < sd[1] < 1.0


def test_words_files_and_what_is_no_reading(tmp_path):
    vehicle = vehicle_with(bottom_sd_m=2.0)
    text = describe_vehicle(vehicle)
    assert 'Sensor "altitude": height above the bottom, 4 Hz' in text and "bottom" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    found = check_vehicle(vehicle_with(bottom_height_m=30.0))
    assert [f.stream for f in found if f.severity == "warning"] == ["sensors.altitude.bottom_height_m"]
    altitude = vehicle.sensors["altitude"]
    assert [altitude.read(np.array([v])) for v in (0.0, -1.0, 1e4, math.nan)] == [None] * 4
    assert altitude.read(np.array([12.0])).tolist() == [12.0]
    for wrong in ({"bottom_sd_m": -1.0}, {"bottom_tau_s": 0.0}, {"lever_arm_b_m": (1.0,)}):
        with pytest.raises(ValueError, match=r"Altitude\."):
            nf.Altitude(**wrong)

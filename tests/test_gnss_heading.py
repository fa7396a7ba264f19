"""A heading that only fixes and accelerations tell, with a MEMS unit and fixes lost for a minute in five."""

import importlib
from pathlib import Path

import numpy as np
import pytest

import navfilter as nf
from navfilter.simulation.manoeuvres import Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.presets import mems_imu
from navfilter.simulation.simulate import Faults, StartErrors, simulate

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.parametrize("scale_sd", [0.0, 0.01])
def test_a_car_knows_how_well_it_knows_its_heading(scale_sd, monkeypatch):
    """Truth and filter have one description, calibration states too; of slow ones the benchmark tells."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    scored = importlib.import_module("gnss_heading").scored
    runs = [scored("car", seed, 10.0, 5.0, scale_sd) for seed in range(400, 406)]
    # six runs of some ten independent headings each
    assert 0.5 < np.mean([run["nees"] for run in runs]) < 1.6
    assert 0.7 < np.mean([run["nees_position"] for run in runs]) < 1.4
    assert np.median([run["sd_deg"] for run in runs]) < 2.5


def test_a_vehicle_that_stands_learns_no_heading():
    """Its tilt is never quite right, and looks like an acceleration: fixes must not tell the heading by that."""
    gps = nf.Position(rate_hz=1.0, error=nf.White(sd=1.0))
    vehicle, start = nf.Vehicle(imu=mems_imu(20.0), sensors={"gps": gps}), StartErrors(heading_sd_deg=5.0)
    stands = Motion((Wait(600.0),), latitude_deg=45.0, longitude_deg=10.0, heading_deg=80.0)

    def known_deg(seed, lost):
        faults = {"gps": Faults(dropouts=lost)}
        mission = simulate(vehicle, stands, seed=seed, duration_s=600.0, start=start, faults=faults)
        return np.degrees(np.sqrt(nf.replay(vehicle, mission).covariance[-1, 8, 8]))

    alone, with_fixes = known_deg(1, ((2.0, 600.0),)), [known_deg(seed, ()) for seed in range(1, 4)]
    # by the tilts of the beginning, when the bias of a gyro is not known yet, some of it may be told
    assert 0.8 * alone < np.mean(with_fixes) < 1.01 * alone

"""A heading that only fixes and accelerations tell, with a MEMS unit and fixes lost for a minute in five."""

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.parametrize("scale_sd", [0.0, 0.01])
def test_a_car_knows_how_well_it_knows_its_heading(scale_sd, monkeypatch):
    """Truth and filter have one description, calibration states too; of slow vehicles the benchmark tells."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    scored = importlib.import_module("gnss_heading").scored
    runs = [scored("car", seed, 10.0, 5.0, scale_sd) for seed in range(400, 406)]
    # six runs of some ten independent headings each
    assert 0.5 < np.mean([run["nees"] for run in runs]) < 1.6
    assert 0.7 < np.mean([run["nees_position"] for run in runs]) < 1.4
    assert np.median([run["sd_deg"] for run in runs]) < 2.5

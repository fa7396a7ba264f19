"""What a replay does not need is not imported: half of the time of a short one was that. Nothing is under way."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

#: Take longer to import than the rest together, and belong to reports, figures and campaigns.
HEAVY = {"scipy.stats", "scipy.signal", "scipy.optimize", "scipy.interpolate", "matplotlib", "filterpy", "bokeh"}
RUN = """
import json, sys
import navfilter as nf
folder, learns = sys.argv[1:]
vehicle, mission = nf.read_vehicle(folder), nf.read_mission(folder + "/mission.npz")
if learns == "learns":
    vehicle = vehicle.with_error(compass=nf.LearnedArma())
navigator = nf.Navigator(vehicle, mission.start)
ready = set(sys.modules)
track = nf.replay(vehicle, mission, output_rate_hz=1.0)
adopted = bool(track.adopted())
print(json.dumps([sorted(ready), sorted(set(sys.modules) - ready), adopted]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from navfilter.io import write_vehicle
    from navfilter.simulation.scenarios import simulate_scenario

    folder = tmp_path_factory.mktemp("imports")
    vehicle, mission = simulate_scenario("lawnmower", seed=1, duration_s=120.0)
    write_vehicle(vehicle, folder / "vehicle.toml")
    mission.save(folder / "mission.npz")
    return folder


def modules(folder, learns):
    command = [sys.executable, "-c", RUN, str(folder), learns]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    ready, later, adopted = json.loads(done.stdout)
    return set(ready), set(later), adopted


def test_a_plain_replay_imports_nothing_heavy(folder):
    ready, later, _ = modules(folder, "plain")
    assert not HEAVY & (ready | later), HEAVY & (ready | later)


def test_a_vehicle_that_learns_imports_nothing_heavy_either(folder):
    """And nothing of scipy under way: half a second of imports in the middle of a dive is one without navigation."""
    ready, later, adopted = modules(folder, "learns")
    assert adopted and not HEAVY & (ready | later), HEAVY & (ready | later)
    assert not [name for name in later if name.startswith("scipy")]


def test_a_report_does_without_the_large_parts_of_scipy():
    code = "import json, sys, navfilter.report.report; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    found = set(json.loads(done.stdout))
    assert "matplotlib" in found and not {name for name in HEAVY if name.startswith("scipy")} & found

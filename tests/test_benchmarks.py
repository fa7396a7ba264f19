"""Every benchmark says what it does and against what; the quick ones run and write figures that can be read again."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
#: By script: what it is compared with, and its sub-commands.
SCRIPTS = {
    "alignment": ("no other software", ()),
    "arma": ("statsmodels", ("speed", "batch", "efficiency", "tracking", "order")),
    "arma_vs_gm1": ("Gauss-Markov", ()),
    "between_hops": ("resting model", ()),
    "bits": ("reference", ()),
    "calibrate_random": ("no other software", ("constants", "handling")),
    "campaign_scaling": ("no other software", ()),
    "cold_start": ("no other software", ()),
    "day": ("filterpy", ("live", "replay")),
    "dive_description": ("no other software", ()),
    "dive_wrong": ("every reading used", ()),
    "dives": ("adaptive filters", ()),
    "faults": ("without a fault", ("missions", "outcomes", "fault_free", "service")),
    "faults_random": ("without the fault", ()),
    "faults_sensitivity": ("no other software", ()),
    "fuzz": ("no other software", ()),
    "gaps": ("No other", ()),
    "gliders": ("plain dead reckoning", ()),
    "gnss_heading": ("no other software", ()),
    "gnss_ins": ("KF-GINS", ()),
    "demo_seeds": ("gm1-fitted", ()),
    "heading_toy": ("Sage-Husa", ()),
    "honest": ("Gauss-Markov", ()),
    "honest_constants": ("no other software", ()),
    "honest_errors": ("no other software", ()),
    "honest_kinds": ("no other software", ()),
    "honest_random": ("no other software", ()),
    "honest_wrong": ("no other software", ()),
    "identify_recordings": ("statsmodels", ()),
    "lanes": ("sound unit alone", ("two", "one", "clean")),
    "logs": ("library underneath", ("samples", "large")),
    "mistakes": ("No other software", ("mistakes", "files", "clean")),
    "noise_wrong": ("no other software", ()),
    "noise_sheet": ("No other software", ("simulated", "recordings")),
    "over_water": ("plain dead reckoning", ()),
    "recordings": ("plain dead reckoning", ("withheld", "car_clocks", "clocks", "wrong")),
    "replay_speed": ("python-ins", ()),
    "residual_source": ("oracle", ()),
    "soak": ("no other software", ()),
    "step_latency": ("filterpy", ()),
    "walk": ("no other software", ()),
    "where_time_goes": ("no other software", ()),
}


def ended(*arguments: str, timeout_s: float = 300.0) -> str:
    """Output of a script that must end well."""
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=BENCHMARKS, timeout=timeout_s
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_all_scripts_are_here():
    files = {path.stem for path in BENCHMARKS.glob("*.py") if '__name__ == "__main__"' in path.read_text("utf-8")}
    assert files == set(SCRIPTS)


#: Asks commands for help in one process: what takes time is importing numba, and that is done once.
ASK = """
import contextlib, io, json, runpy, sys
sys.path.insert(0, ".")
said = {}
for command in json.loads(sys.argv[1]):
    sys.argv = [*command.split(), "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            runpy.run_path(sys.argv[0], run_name="__main__")
        except SystemExit as end:
            said[command] = [end.code, out.getvalue()]
print(json.dumps(said))
"""


def test_every_script_says_what_it_does_and_against_what():
    commands = [f"{name}.py {part}".strip() for name, (_, parts) in SCRIPTS.items() for part in ("", *parts)]
    helped = json.loads(ended("-c", ASK, json.dumps(commands)))
    for name, (competitor, parts) in SCRIPTS.items():
        code, text = helped[f"{name}.py"]
        assert code == 0 and competitor in text and all(part in text for part in parts), name
        for command in [f"{name}.py {part}" for part in parts] or [f"{name}.py"]:
            code, text = helped[command]
            assert code == 0 and "--json PATH" in text and "--quick" in text, command


@pytest.mark.parametrize(
    "command, keys",
    [
        ("fuzz.py --inputs 300 --targets 'JSON lines' 'saved missions'", {"targets"}),
        (
            "honest.py --scenarios compass-white --gyros tactical --motions lawnmower --quick",
            {"table", "cpu_s", "campaigns"},
        ),
        (
            "replay_speed.py --minutes 1 --quick",
            {"table", "learning_adds", "states", "peak_mb", "strapdown_samples_per_s"},
        ),
    ],
)
def test_figures_are_kept_as_json(command, keys, tmp_path):
    ended(*shlex.split(command), "--json", str(tmp_path / "figures.json"))
    found = json.loads((tmp_path / "figures.json").read_text(), parse_constant=pytest.fail)
    assert set(found) == {"benchmark", "arguments", "machine", "python", "versions", "figures"}
    assert found["benchmark"] == command.split(".")[0] and "numba" in found["versions"]
    assert keys <= set(found["figures"])


def test_a_refused_reading_visits_few_files(tmp_path):
    """What it does not concern is not asked: with each file that a newcomer need not open the way is easier to read."""
    ended("walk.py", "--quick", "--json", str(tmp_path / "figures.json"))
    rows = {row["input"]: row for row in json.loads((tmp_path / "figures.json").read_text())["figures"]}
    refused = rows["reading that is refused"]
    assert refused["calls"] > 30 and refused["files"] <= 14 and refused["changes"] <= 40


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [f"{name}.py {part}".strip() for name, (_, parts) in SCRIPTS.items() for part in parts or ("",)]
)
def test_every_benchmark_runs(command):
    """Nothing of what it measures is judged here; what has no recordings beside it says so."""
    ended(*shlex.split(command), "--quick", timeout_s=3600.0)


def test_runs_that_do_not_learn_are_taken_from_an_earlier_program(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import honest

    from navfilter.evaluation.montecarlo.campaign import Campaign, Store

    campaign = Campaign("compass-white", duration_s=100.0, imu_rate_hz=20.0)
    before = Store(tmp_path / "before", campaign.settings | {"program": "earlier"})
    for model in ("arma", "oracle"):
        before.save(1, model, {"scores": np.ones(2)})
    honest.take(campaign, (1, 2), ("arma", "oracle", "vehicle"), tmp_path / "before", tmp_path / "now")
    now = Store(tmp_path / "now", campaign.settings)
    assert now.load(1, "oracle") is not None and now.load(1, "arma") is None and now.load(2, "oracle") is None
    # nothing there, nothing taken; something else there, a word
    honest.take(campaign, (1,), ("oracle",), tmp_path / "nowhere", tmp_path / "none")
    assert not (tmp_path / "none").exists()
    other = Campaign("compass-white", duration_s=110.0, imu_rate_hz=20.0)
    with pytest.raises(SystemExit, match="other settings"):
        honest.take(other, (1,), ("oracle",), tmp_path / "before", tmp_path / "other")


def test_the_page_of_faults_has_the_faults_of_the_benchmark():
    page = (BENCHMARKS.parent / "docs" / "pages" / "faults.md").read_text("utf-8")
    sys.path[:0] = [str(BENCHMARKS)]
    try:
        import faults_outcomes
    finally:
        del sys.path[0]
    rows = {line.split(" | ")[0].strip("| ") for line in page.splitlines() if line.startswith("| ")} - {"fault"}
    assert rows == {*faults_outcomes.SITUATIONS, *faults_outcomes.SHOWN}


def test_ratios_of_gaps_are_means_over_recordings(monkeypatch):
    """However many gaps a recording has: one is twice as good, one twice as bad."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import gaps

    import navfilter as nf

    rows = [{"kind": "car", "recording": "a", "file": (4.0, 2.0), "learnt": (1.0, 1.0)}] * 3
    rows += [{"kind": "car", "recording": "b", "file": (1.0, 2.0), "learnt": (4.0, 1.0)}]
    found = gaps.figures(rows, kind="car", how="as set")
    assert found["gaps"] == 4 and found["ratio"] == pytest.approx(1.0) and found["learnt_nees"] == 1.0
    assert found["low"] == pytest.approx(0.5) and found["high"] == pytest.approx(2.0)
    walk, slow, white = nf.RandomWalk(density=1e-3), nf.GaussMarkov(sd=0.3, tau_s=9.0), nf.White(sd=0.4)
    assert gaps.other(walk + slow + white, 1.0, 3.0) == walk + nf.GaussMarkov(sd=3.0 * 0.3, tau_s=9.0) + nf.White(
        sd=3.0 * 0.4
    )
    assert gaps.other(slow + white, 1.0, "white").sd == pytest.approx(0.5)
    assert gaps.other(slow + white, 1.0, "30 s").tau_s == 30.0

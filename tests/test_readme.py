"""The README works when copied."""

import json
import re
import runpy
from pathlib import Path

import numpy as np

import navfilter as nf
from navfilter.cli import main
from navfilter.io import read_vehicle

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
ROOT = Path(__file__).parent.parent


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def test_the_example_mission_works_when_copied(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    script = next(block for block in blocks("python") if block.startswith("# make_example.py"))
    Path("make_example.py").write_text(script)
    runpy.run_path("make_example.py")
    for block in blocks("toml"):
        name = re.match(r"# (\S+?):", block).group(1)
        Path(name).write_text(block)
    assert {path.name for path in Path("dive_042").iterdir()} >= {"mission.toml", "vehicle.toml", "imu.csv"}
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    commands = [line.split()[1:] for line in lines if line.startswith(("navfilter check", "navfilter replay"))]
    assert [command[0] for command in commands] == ["check", "replay"]
    for command in commands:
        assert main(command) == 0, capsys.readouterr()
    summary = json.loads(Path("result/summary.json").read_text())
    assert list(summary["runs"]) == ["forward", "smoothed"] and summary["distance_m"] > 500
    used = summary["runs"]["smoothed"]["used"]
    # A hundred readings of the DVL are the sentinel; nearly all others must be used, or the example teaches something wrong.
    assert used["dvl"] > 2100 and used["compass"] > 4500 and used["depth"] > 550
    # The example describes the vehicle as it was simulated, so every NIS must be near 1 (sd of the depth's mean: 0.06).
    assert all(0.8 < nis < 1.2 for nis in summary["runs"]["smoothed"]["nis"].values())
    dvl = nf.read_mission("dive_042").streams["dvl"].value
    assert np.isnan(dvl).all(axis=1).sum() == 100
    assert set(read_vehicle("dive_042").sensors) == {"compass", "dvl", "depth", "gps"}


def test_the_vehicle_in_code_is_valid():
    block = next(block for block in blocks("python") if block.startswith("vehicle = nf.Vehicle("))
    names = {"nf": nf}
    exec(block, names)
    assert list(names["other"].sensors) == ["compass", "dvl", "gps"] and names["other"].sensors["compass"].error.order == 2


def test_every_file_of_the_map_exists():
    section = README.split("## How it is built")[1]
    tree = re.search(r"^```\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL).group(1)
    for name in re.findall(r"\b(\w+\.py)\b", tree):
        assert any((ROOT / folder / name).exists() for folder in ("navfilter", "navfilter/io", "navfilter/arma", "tests")), name
    for name in re.findall(r"^\| `(\w+)` \|", README.split("## Benchmarks")[1].split("## ")[0], flags=re.MULTILINE):
        assert (ROOT / "benchmarks" / f"{name}.py").exists(), name


def test_names_of_the_face_exist():
    for name in set(re.findall(r"\bnf\.([A-Za-z_]\w*)", README)):
        assert hasattr(nf, name), name

"""``navfilter replay A B C``: each recording as if it were replayed alone, whatever becomes of the others."""

import csv
import json

import pytest

from navfilter.commands.cli import main
from navfilter.commands.recordings import labels
from navfilter.io import write_vehicle
from navfilter.simulation.scenarios import simulate_scenario


@pytest.fixture(scope="module")
def dives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dives")
    for seed in (1, 2):
        vehicle, mission = simulate_scenario("lawnmower", seed, 60.0)
        mission.save(folder / f"dive_{seed}.npz")
    write_vehicle(vehicle, folder / "vehicle.toml")
    (folder / "broken.npz").write_bytes((folder / "dive_1.npz").read_bytes()[:-500])
    return folder


def test_each_is_replayed_as_alone_and_a_broken_one_stops_none(dives, tmp_path, capsys):
    names = ["dive_1", "broken", "dive_2"]
    vehicle = ("--vehicle", str(dives / "vehicle.toml"))
    paths = [str(dives / f"{name}.npz") for name in names]
    code = main(["replay", *paths, *vehicle, "--out", str(tmp_path / "all"), "--workers", "2", "--no-report"])
    said = capsys.readouterr()
    alone = {}
    for name in ("dive_1", "dive_2"):
        out = tmp_path / name
        alone[name] = main(
            ["replay", str(dives / f"{name}.npz"), *vehicle, "--out", str(out), "--quiet", "--no-report"]
        )
        assert (out / "track.csv").read_bytes() == (tmp_path / "all" / name / "track.csv").read_bytes()
    assert code == 2 and "broken" in said.err and "3 of 3" in said.err
    rows = json.loads((tmp_path / "all" / "recordings.json").read_text())
    assert [row["recording"] for row in rows] == names
    assert [row["exit_code"] for row in rows] == [alone["dive_1"], 2, alone["dive_2"]]
    assert rows[1]["distance_m"] is None and "truncated" in rows[1]["verdict"]
    summary = json.loads((tmp_path / "dive_2" / "summary.json").read_text())
    assert rows[2]["position_rms_m"] == summary["runs"]["forward"]["position_rms_m"]
    with (tmp_path / "all" / "recordings.csv").open() as file:
        assert [row["recording"] for row in csv.DictReader(file)] == names
    assert all(name in said.out for name in names)


def test_recordings_are_told_apart():
    assert labels(["a/dive.npz", "b/dive.npz"]) == ["a-dive", "b-dive"]
    assert labels(["x/one", "x/two/mission.toml"]) == ["one", "two"]
    with pytest.raises(ValueError, match="twice"):
        labels(["a/dive.npz", "a/../a/dive.npz"])

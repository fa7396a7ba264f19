"""What the command line says is in its own words: no Python in a shell, and a number that fits its noun."""

import re
from pathlib import Path

import pytest

from navfilter.commands.cli import main
from navfilter.identification.noise_sheet import NotAtRest
from navfilter.io import VehicleError, write_vehicle
from navfilter.io.mission_toml import RunsError
from navfilter.io.tracks.own_columns import FormatError
from navfilter.models.mission import MissionError
from navfilter.simulation.scenarios import simulate_scenario


@pytest.fixture(scope="module")
def without_fixes(tmp_path_factory):
    """Arguments for a mission whose fixes are missing."""
    folder = tmp_path_factory.mktemp("dive")
    vehicle, mission = simulate_scenario("lawnmower", 1, 60.0)
    mission.without_stream("gps").save(folder / "mission.npz")
    write_vehicle(vehicle, folder / "vehicle.toml")
    return [str(folder / "mission.npz"), "--vehicle", str(folder / "vehicle.toml")]


@pytest.mark.parametrize("command", ["check", "replay", "compare"])
def test_a_missing_stream_is_cured_without_python(without_fixes, tmp_path, capsys, command):
    out = [] if command == "check" else ["--out", str(tmp_path / "out"), "--quiet"]
    assert main([command, *without_fixes, *out]) == (1 if command == "check" else 2)
    said = "".join(capsys.readouterr())
    assert "--without gps" in said and "[streams.gps]" in said and "[sensors.gps] out of the vehicle.toml" in said
    assert "vehicle.without" not in said
    if command == "replay":
        assert main([command, *without_fixes, *out, "--without", "gps", "--no-report"]) == 0


def test_a_stream_that_is_not_there_is_cured_without_python(without_fixes, tmp_path, capsys):
    assert main(["identify", f"{without_fixes[0]}:sonar", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "(streams: imu, compass, dvl, depth). Take one of these" in said and "vehicle." not in said


def test_what_stops_a_command_has_a_code(without_fixes, tmp_path, capsys):
    assert main(["check", str(tmp_path)]) == 2 and capsys.readouterr().err.endswith(" [mission]\n")
    (tmp_path / "vehicle.toml").write_text("x = 1\n", encoding="utf-8")
    assert main(["replay", without_fixes[0], "--vehicle", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.endswith(" [vehicle]\n")


def test_the_manual_names_the_code_of_each_exception():
    page = (Path(__file__).parent.parent / "docs" / "pages" / "mistakes.md").read_text(encoding="utf-8")
    kinds = (MissionError, RunsError, VehicleError, FormatError, NotAtRest)
    _, *told = re.findall(r"`([\w-]+)`", page.split("What stops a command has one")[1])
    assert told == [kind.code for kind in kinds]

"""What the command line says is in its own words: no Python in a shell, and a number that fits its noun."""

import pytest

from navfilter.commands.cli import main
from navfilter.io import write_vehicle
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

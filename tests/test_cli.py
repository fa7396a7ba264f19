"""The command line: what it writes, what it says, how it ends."""

import json
import pickle
import subprocess
import sys

import numba
import pytest
from numba.core.registry import cpu_target

from navfilter.commands import cli
from navfilter.commands.cli import main
from navfilter.commands.replay import NOT_JUDGED
from navfilter.io import read_mission, read_vehicle, write_vehicle
from navfilter.kernels.compiling import progress
from navfilter.kernels.compiling.decorators import checksum

HANGS_S = 600.0  # far beyond what a command takes here
COMMANDS = ("demo", "replay", "run", "compare", "learn", "montecarlo", "identify", "simulate", "check", "vehicle")
COMMANDS += ("warmup",)
OUTPUTS = {"report.html", "summary.json", "track.csv", "track.tum", "truth.tum", "track.geojson"}


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A folder with mission.npz and vehicle.toml of two and a half minutes."""
    folder = tmp_path_factory.mktemp("dive")
    assert main(["simulate", "reckoning", "--duration", "150", "--out", str(folder), "--quiet"]) == 0
    return folder


def replay(dive, out, *more):
    return main(["replay", str(dive / "mission.npz"), "--vehicle", str(dive), "--out", str(out), *more])


def one_line(capsys):
    """The only line on standard error; nothing on standard output."""
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and said.err.startswith("navfilter: ")
    return said.err


def test_help_names_every_command_and_shows_examples(capsys):
    assert main([]) == 0
    without = capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert said == without and all(f"\n    {name}" in said for name in COMMANDS) and "navfilter demo" in said


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    said = capsys.readouterr().out
    assert end.value.code == 0 and said.startswith(f"usage: navfilter {command}") and "--quiet" in said


def test_the_module_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "navfilter", "--version"], capture_output=True, text=True, timeout=HANGS_S
    )
    assert done.returncode == 0 and done.stdout.startswith("navfilter ") and done.stderr == ""


def test_help_loads_neither_figures_nor_tables():
    heavy = "('matplotlib', 'pandas', 'h5py', 'tqdm')"
    code = f"import sys, navfilter.commands.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANGS_S)
    assert done.stdout.strip() == "[]", done.stderr


def test_simulate_writes_what_replay_reads(dive):
    mission, vehicle = read_mission(dive / "mission.npz"), read_vehicle(dive)
    assert mission.truth is not None and mission.start is not None and set(vehicle.sensors) < set(mission.streams)


def test_simulate_into_one_file(tmp_path):
    assert (
        main(
            [
                "simulate",
                "transit",
                "--duration",
                "30",
                "--seed",
                "5",
                "--out",
                str(tmp_path / "deep" / "a.npz"),
                "--quiet",
            ]
        )
        == 0
    )
    assert {path.name for path in (tmp_path / "deep").iterdir()} == {"a.npz", "a.toml"}


def test_simulate_lists_the_scenarios(capsys):
    assert main(["simulate", "--list"]) == 0
    said = capsys.readouterr().out
    assert "lawnmower" in said and "demo" in said


def test_the_seed_decides(tmp_path):
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        main(
            [
                "simulate",
                "reckoning",
                "--duration",
                "20",
                "--seed",
                seed,
                "--out",
                str(tmp_path / f"{name}.npz"),
                "--quiet",
            ]
        )
    a, b, c = (read_mission(tmp_path / f"{name}.npz").streams["velocity"].value for name in "abc")
    assert (a == b).all() and (a != c).any()


def test_replay_writes_everything_and_says_where(dive, tmp_path, capsys):
    assert replay(dive, tmp_path / "out", "--smooth") == 0
    assert {path.name for path in (tmp_path / "out").glob("[!.]*")} == OUTPUTS
    said = capsys.readouterr().out
    assert "forward" in said and "smoothed" in said and str(tmp_path / "out") in said
    assert list(json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]) == ["forward", "smoothed"]


def test_replay_without_smoother_and_without_a_sensor(dive, tmp_path, capsys):
    assert replay(dive, tmp_path, "--without", "gps", "--output-rate", "1", "--quiet", "--no-report") == NOT_JUDGED
    assert capsys.readouterr().out == ""
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert list(summary["runs"]) == ["forward"] and list(summary["runs"]["forward"]["used"]) == ["depth"]
    # 150 s at one row a second, and the header.
    assert len((tmp_path / "track.csv").read_text().splitlines()) <= 153
    assert replay(dive, tmp_path, "--without", "gps", "--output-rate", "all", "--quiet", "--no-report") == NOT_JUDGED
    samples = read_mission(dive / "mission.npz").streams["velocity"]
    assert len((tmp_path / "track.csv").read_text().splitlines()) > len(samples)


def test_check_finds_nothing_in_a_sound_mission(dive, capsys):
    assert main(["check", str(dive / "mission.npz"), "--vehicle", str(dive)]) == 0
    assert "gps" in capsys.readouterr().out


def test_check_fails_where_a_stream_is_missing(dive, tmp_path, capsys):
    mission = read_mission(dive / "mission.npz").without_stream("depth")
    path = mission.save(tmp_path / "no-depth.npz")
    assert main(["check", str(path)]) == 0
    assert main(["check", str(path), "--vehicle", str(dive)]) == 1
    assert "depth" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["demo", "--seed", "-1"],
        ["demo", "--seed", "many"],
        ["demo", "--duration", "nan"],
        ["demo", "--no-such-option"],
        ["replay"],
        ["replay", "x", "--vehicle", "y", "--out", "z", "--output-rate", "0"],
    ],
)
def test_wrong_usage_is_one_line(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    assert "--help" in one_line(capsys)


def test_wrong_input_is_one_line(dive, tmp_path, capsys):
    garbage = tmp_path / "garbage.npz"
    garbage.write_bytes(b"PK\x03\x04 no archive")
    empty = tmp_path / "vehicle.toml"
    empty.write_text("")
    npz, vehicle, out = str(dive / "mission.npz"), str(dive), str(tmp_path / "out")
    wrong = {
        "nowhere": ["check", str(tmp_path / "nowhere")],
        "garbage.npz": ["check", str(garbage)],
        "vehicle.toml": ["replay", npz, "--vehicle", str(empty), "--out", out],
        "no sensor": ["replay", npz, "--vehicle", vehicle, "--out", out, "--without", "sonar"],
        str(empty): ["replay", npz, "--vehicle", vehicle, "--out", str(empty)],
        "There is no scenario": ["simulate", "moon", "--out", out],
        "--list": ["simulate"],
    }
    for expected, arguments in wrong.items():
        assert main(arguments) == 2, arguments
        assert expected in one_line(capsys)


def test_a_sensor_without_a_stream_is_one_line(dive, tmp_path, capsys):
    path = read_mission(dive / "mission.npz").without_stream("depth").save(tmp_path / "m.npz")
    assert main(["replay", str(path), "--vehicle", str(dive), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert '"depth" has no stream' in one_line(capsys)


def test_interrupted_and_out_of_memory(monkeypatch, capsys):
    def stop(error):
        def run(options):
            raise error

        monkeypatch.setitem(cli._COMMANDS, "warmup", (run, {}))
        return main(["warmup"])

    assert stop(KeyboardInterrupt()) == 130 and "interrupted" in one_line(capsys)
    assert stop(MemoryError()) == 2 and "MemoryError" in one_line(capsys)
    with pytest.raises(TypeError):  # a defect of the program must not look like a mistake of the user
        stop(TypeError("defect"))


def test_compilation_is_announced_once(dive, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 0)
    monkeypatch.setattr("navfilter.playback.warm_up.warm_up", lambda vehicle, smoother: None)
    monkeypatch.setattr(progress, "show_compilation", lambda: None)
    monkeypatch.setattr(progress, "expect", lambda most: None)
    monkeypatch.setattr(progress, "SHIPPED", [])
    processor = cpu_target.target_context.codegen().magic_tuple()
    for of in ("another", processor):
        assert main(["warmup"]) == 0 and "compiling" in capsys.readouterr().err
        for name in ("strapdown", "kalman", "measurement"):
            index = tmp_path / f"{name}.step-1.py{sys.version_info.major}{sys.version_info.minor}.nbi"
            kept = checksum(f"navfilter.kernels.{name}"), {("signature", of, "code"): "step.nbc"}
            index.write_bytes(pickle.dumps(numba.__version__) + pickle.dumps(kept))
    assert main(["warmup"]) == 0
    said = capsys.readouterr()
    assert said.err == "" and "ready" in said.out


def test_a_vehicle_survives_its_file(dive, tmp_path):
    vehicle = read_vehicle(dive)
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")) == vehicle


def test_nobody_listens(dive):
    code = (
        f"from navfilter.commands.cli import main; import sys; sys.exit(main(['check', {str(dive / 'mission.npz')!r}]))"
    )
    done = subprocess.run(
        f'{sys.executable} -c "{code}" | true', shell=True, capture_output=True, text=True, timeout=HANGS_S
    )
    assert "Traceback" not in done.stderr and "Broken pipe" not in done.stderr

"""The command line: ``navfilter demo | replay | identify | simulate | check | warmup``.

Each sub-command is a function that adds its arguments and one that runs. Everything heavy is imported where it is used, so that
``navfilter --help`` answers at once. Exit codes: 0 all is well, 1 `check` found an error in the mission, 2 wrong usage or input.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from navfilter.mission import Mission
    from navfilter.track import Track

__all__ = ["main"]

OK, FOUND, WRONG, INTERRUPTED = 0, 1, 2, 130

_ABOUT = "Navigation filter for underwater (and other) vehicles: replay a recorded mission, smooth it, and see how honest the result is."
_COMPILING = "compiling the kernels, once: about 30 s ..."
_FIRST_STEPS = """\
first steps:
  navfilter demo                                  a simulated mission of one hour, replayed and smoothed
  navfilter simulate lawnmower --out dive         make a mission to play with
  navfilter check dive/mission.npz                look for the usual mistakes in a recording
  navfilter replay dive/mission.npz --vehicle dive/vehicle.toml --smooth --out result

'navfilter COMMAND --help' explains one command.
"""


class _Parser(argparse.ArgumentParser):
    """Wrong usage is one line on standard error."""

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG, f"navfilter: {message} (see '{self.prog} --help')\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.run is None:
        parser.print_help()
        return OK
    try:
        return options.run(options)
    except KeyboardInterrupt:
        return _fail("interrupted.", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone; what Python still holds for it must not be flushed into the closed pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}.", WRONG)
    except (ValueError, LookupError, MemoryError) as error:
        return _fail(str(error.args[0]) if error.args else type(error).__name__, WRONG)


def _fail(text: str, code: int) -> int:
    print(f"navfilter: {text}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="navfilter", description=_ABOUT, epilog=_FIRST_STEPS, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and stop")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", parser_class=_Parser)
    for add in (_add_demo, _add_replay, _add_identify, _add_simulate, _add_check, _add_warmup):
        add(commands)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: that takes longer than parsing everything."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        from importlib.metadata import version

        print(f"navfilter {version('navfilter')}")
        parser.exit(OK)


def _command(commands: Any, name: str, run: Callable[[argparse.Namespace], int], about: str, epilog: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=about,
        description=about[0].upper() + about[1:] + ".",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be a number > 0, found '{text}'")
    return value


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number >= 0, found '{text}'")
    return int(text)


# --- demo -------------------------------------------------------------------------------------------------------------


def _add_demo(commands: Any) -> None:
    parser = _command(
        commands,
        "demo",
        _demo,
        "simulate a mission of one hour, replay and smooth it, and write a report",
        "the mission:\n"
        "  satellite fixes at the surface, dive to 20 m, lawnmower by inertial unit, compass, DVL and depth gauge,\n"
        "  with outliers and three losses of the DVL (60, 120 and 30 s), surfacing, fixes again.\n\n"
        "examples:\n"
        "  navfilter demo\n"
        "  navfilter demo --seed 7 --out demo-7        the same mission with other noise\n",
    )
    parser.add_argument("--out", default="navfilter-demo", metavar="DIR", help="folder to write to (default: %(default)s)")
    parser.add_argument("--seed", type=_seed, default=1, metavar="N", help="seed of everything random (default: %(default)s)")
    parser.add_argument("--duration", type=_positive, metavar="S", help="length of the mission in seconds (default: one hour)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _demo(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    say = _speaker(options.quiet)
    say("simulating the mission ...")
    from navfilter.scenarios import simulate_scenario

    vehicle, mission = simulate_scenario("demo", options.seed, options.duration)
    _save(vehicle, mission, folder / "mission.npz", folder / "vehicle.toml")
    return _replay_and_write(vehicle, mission, folder, options.quiet, smooth=True)


# --- replay -----------------------------------------------------------------------------------------------------------


def _add_replay(commands: Any) -> None:
    parser = _command(
        commands,
        "replay",
        _replay,
        "run a recorded mission through the filter (and the smoother)",
        "MISSION is a folder with a mission.toml, the .toml itself, or a .npz saved by navfilter; --vehicle describes what is on board.\n\n"
        "written to --out:\n"
        "  report.html     tables and figures, one file that works offline\n"
        "  summary.json    errors, consistency (NEES, NIS), counts of every run\n"
        "  track.csv       the track: degrees, metres, standard deviations, states\n"
        "  track.tum       the same for 'evo' (east, north, up), with truth.tum when there is a truth\n"
        "  track.geojson   for a map\n\n"
        "examples:\n"
        "  navfilter replay dive_042 --vehicle vehicle.toml --smooth --out result\n"
        "  navfilter replay dive_042 --vehicle vehicle.toml --without gps --out no-gps\n",
    )
    parser.add_argument("mission", metavar="MISSION")
    parser.add_argument("--vehicle", required=True, metavar="TOML", help="the vehicle.toml, or the folder that holds it")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write to; files of the same name are replaced")
    parser.add_argument("--smooth", action="store_true", help="smooth too (Rauch-Tung-Striebel); the files then hold the smoothed track")
    parser.add_argument("--without", action="append", default=[], metavar="SENSOR", help="leave a sensor out; may be repeated")
    parser.add_argument(
        "--output-rate", type=_positive, default=5.0, metavar="HZ", help="rows of the track per second at most (default: %(default)s)"
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _replay(options: argparse.Namespace) -> int:
    from navfilter.io import read_mission, read_vehicle

    vehicle = read_vehicle(options.vehicle).without(*options.without)
    mission = read_mission(options.mission)
    folder = _folder(options.out)
    return _replay_and_write(vehicle, mission, folder, options.quiet, smooth=options.smooth, output_rate_hz=options.output_rate)


def _replay_and_write(vehicle: Any, mission: Mission, folder: Path, quiet: bool, **how: Any) -> int:
    from navfilter.io.write import labelled, write_outputs
    from navfilter.replay import replay

    say, bars = _speaker(quiet), not quiet and sys.stderr.isatty()
    _compile_first(quiet)
    say(f"replaying {mission.name} ({mission.duration_s / 60:.1f} min) ...")
    tracks = labelled(replay(vehicle, mission, progress=bars, **how))
    write_outputs(tracks, mission, folder)
    _write_report(tracks, mission, folder / "report.html", bars)
    if not quiet:
        _print_result(tracks, mission, folder)
    return OK


def _write_report(tracks: dict[str, Track], mission: Mission, path: Path, bars: bool) -> None:
    from tqdm import tqdm

    from navfilter.report import write_report

    with tqdm(desc="figures", unit="", leave=False, disable=not bars, bar_format="{desc}: {n_fmt} [{elapsed}]") as bar:
        write_report(tracks, mission, path, bar.update)


def _print_result(tracks: dict[str, Track], mission: Mission, folder: Path) -> None:
    from navfilter.report import headline_table, sensor_table

    result = list(tracks.values())[-1]
    print(headline_table(tracks, mission))
    if mission.truth is None:
        print("(no truth in this mission: only NIS can be judged; 1 is honest)")
    print()
    print(sensor_table(result))
    print()
    print(f"{result.distance_m:.0f} m travelled, {result.cpu_s:.1f} s of processor time. Written to {folder}{os.sep}:")
    print("  report.html (open this one), summary.json, track.csv, track.tum, track.geojson")


# --- identify ---------------------------------------------------------------------------------------------------------


def _add_identify(commands: Any) -> None:
    from navfilter import identify_command

    identify_command.add_arguments(_command(commands, "identify", identify_command.run, identify_command.ABOUT, identify_command.EPILOG))


# --- simulate ---------------------------------------------------------------------------------------------------------


def _add_simulate(commands: Any) -> None:
    parser = _command(
        commands,
        "simulate",
        _simulate,
        "simulate a mission with its truth",
        "DIR gets mission.npz and vehicle.toml; a name that ends in .npz gets the mission, with the vehicle in a .toml beside it.\n\n"
        "examples:\n"
        "  navfilter simulate --list\n"
        "  navfilter simulate lawnmower --seed 3 --duration 900 --out dive\n",
    )
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="see --list")
    parser.add_argument("--list", action="store_true", help="list the scenarios and stop")
    parser.add_argument("--out", metavar="PATH", help="folder, or file that ends in .npz")
    parser.add_argument("--seed", type=_seed, default=1, metavar="N", help="seed of everything random (default: %(default)s)")
    parser.add_argument("--duration", type=_positive, metavar="S", help="length in seconds (default: that of the scenario)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _simulate(options: argparse.Namespace) -> int:
    from navfilter.scenarios import SCENARIOS, simulate_scenario

    if options.list:
        width = max(map(len, SCENARIOS))
        for name, scenario in SCENARIOS.items():
            print(f"{name:{width}}  {scenario.duration_s / 60:3.0f} min  {scenario.about}")
        return OK
    if options.scenario is None or options.out is None:
        raise ValueError("simulate needs a SCENARIO and --out (scenarios: navfilter simulate --list).")
    out = Path(options.out)
    vehicle, mission = simulate_scenario(options.scenario, options.seed, options.duration)
    if out.suffix == ".npz":
        _folder(out.parent)
        to = out, out.with_suffix(".toml")
    else:
        folder = _folder(out)
        to = folder / "mission.npz", folder / "vehicle.toml"
    _save(vehicle, mission, *to)
    say = _speaker(options.quiet)
    say(f"{mission.duration_s:.0f} s, streams {', '.join(mission.streams)}. Replay it with:")
    say(f"  navfilter replay {to[0]} --vehicle {to[1]} --smooth --out result")
    return OK


def _save(vehicle: Any, mission: Mission, mission_path: Path, vehicle_path: Path) -> None:
    from navfilter.io import write_vehicle

    mission.save(mission_path)
    write_vehicle(vehicle, vehicle_path)


# --- check ------------------------------------------------------------------------------------------------------------


def _add_check(commands: Any) -> None:
    parser = _command(
        commands,
        "check",
        _check,
        "look at a recording before it is replayed",
        "Reports rates, gaps, repeats and quantisation of every stream, and looks for the usual mistakes: gravity upside down, axes\n"
        "swapped, degrees for radians, gyro against heading, DVL against position. Exit code 1 when something would spoil a replay.\n\n"
        "examples:\n"
        "  navfilter check dive_042\n"
        "  navfilter check dive_042 --vehicle vehicle.toml      also: are all sensors there, with their mountings applied\n",
    )
    parser.add_argument("mission", metavar="MISSION")
    parser.add_argument("--vehicle", metavar="TOML", help="the vehicle.toml, or the folder that holds it")
    parser.add_argument("--quiet", action="store_true", help="print nothing: only the exit code counts")


def _check(options: argparse.Namespace) -> int:
    from navfilter.check import check_mission, report_text
    from navfilter.io import read_mission, read_vehicle

    mission = read_mission(options.mission)
    findings = check_mission(mission, None if options.vehicle is None else read_vehicle(options.vehicle))
    _speaker(options.quiet)(report_text(mission, findings))
    return FOUND if any(finding.severity == "error" for finding in findings) else OK


# --- warmup -----------------------------------------------------------------------------------------------------------


def _add_warmup(commands: Any) -> None:
    parser = _command(
        commands,
        "warmup",
        _warmup,
        "compile everything now, so that nothing compiles during a dive",
        "What is compiled is kept: the next process starts at once. Run it once after every installation or update.\n",
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _warmup(options: argparse.Namespace) -> int:
    import time

    if not options.quiet and not _compiled():
        print(_COMPILING, file=sys.stderr, flush=True)
    from navfilter.replay import warm_up

    began = time.perf_counter()
    warm_up()
    _speaker(options.quiet)(f"ready ({time.perf_counter() - began:.1f} s).")
    return OK


# --- shared -----------------------------------------------------------------------------------------------------------


def _speaker(quiet: bool) -> Callable[[str], None]:
    def say(text: str) -> None:
        if not quiet:
            print(text, flush=True)

    return say


def _folder(path: str | Path) -> Path:
    """Make the output folder before the work begins, so that a wrong path costs no time."""
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _compile_first(quiet: bool) -> None:
    """Compile before the run, so that the run's processor time is its own."""
    if _compiled():
        return
    if not quiet:
        print(_COMPILING, file=sys.stderr, flush=True)
    from navfilter.replay import warm_up

    warm_up()


def _compiled() -> bool:
    """Whether numba has kept every kernel file of the navigator since it was last changed."""
    from numba import config

    settings: Any = config
    sources = [Path(__file__).parent / "kernels" / f"{name}.py" for name in ("strapdown", "kalman", "measurement")]
    if settings.DISABLE_JIT:
        return True
    elsewhere = settings.CACHE_DIR
    folders = [Path(elsewhere)] if elsewhere else [sources[0].parent / "__pycache__", Path.home() / ".cache" / "numba"]
    kept = [index for folder in folders if folder.is_dir() for index in folder.rglob("*.nbi")]
    tag = f".py{sys.version_info.major}{sys.version_info.minor}."
    kept = [index for index in kept if tag in index.name]
    return all(any(i.name.startswith(f"{s.stem}.") and i.stat().st_mtime >= s.stat().st_mtime for i in kept) for s in sources)

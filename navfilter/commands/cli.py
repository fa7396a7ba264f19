"""The command line: ``navfilter demo | replay | run | compare | calibrate | learn | montecarlo | identify | simulate |
check | mission | vehicle | warmup``.

Each sub-command is a function that adds its arguments and one that runs. Everything heavy is imported where it is used,
so that ``navfilter --help`` answers at once. Exit codes: 0 all is well, 1 `check` or `vehicle --check` found something
wrong, or a replayed track is not to be trusted, 2 wrong usage or input, 130 interrupted, 141 whoever read the output
has gone; `run` has its own (see its help).
"""

import argparse
import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from navfilter.commands import (
    calibrate,
    compare,
    console,
    identify,
    learn,
    mission,
    mission_part,
    montecarlo,
    replay,
    run,
    vehicle,
)

OK, FOUND, WRONG, INTERRUPTED, UNHEARD = 0, 1, 2, 130, 141


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
        if options.compiled:
            from navfilter.service.kernel_cache import make_usable

            make_usable(console.complain)
        return options.run(options)
    except KeyboardInterrupt:
        return _fail("interrupted.", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone; what Python still holds for it must not be flushed into the closed pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNHEARD
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}.", WRONG)
    except (ValueError, LookupError, MemoryError) as error:
        text = str(error.args[0]) if error.args else type(error).__name__
        text += f" [{error.code}]" if hasattr(error, "code") else ""
        return _fail(text, getattr(error, "exit_code", WRONG))


def _fail(text: str, code: int) -> int:
    console.complain(f"navfilter: {text}")
    return code


def _parser() -> argparse.ArgumentParser:
    """Navigation filter for underwater (and other) vehicles: replay a recorded mission, smooth it, and see how honest
    the result is.

    first steps:
      navfilter demo                                  a simulated mission of one hour, replayed and smoothed
      navfilter simulate lawnmower --out dive         make a mission to play with
      navfilter mission --init dive.mcap --out dive   a mission.toml and a vehicle.toml for a log of yours
      navfilter check dive/mission.npz                look for the usual mistakes in a recording
      navfilter replay dive/mission.npz --vehicle dive/vehicle.toml --smooth --out result
      navfilter compare dive/mission.npz --vehicle dive/vehicle.toml --out compared
      navfilter calibrate dive/mission.npz --vehicle dive/vehicle.toml --out calibrated.toml
      navfilter learn dive_0* --vehicle vehicle.toml --out learnt.toml     how the sensors err, for the next dive
      navfilter identify still.csv --column gyro_x --rate-hz 100 --out gyro_x
      navfilter identify still.mcap --imu --out sheet  the noise sheet of an inertial unit

    'navfilter COMMAND --help' explains one command.

    exit codes: 0 all is well, 1 something is wrong with the mission, the vehicle or the track (check, vehicle --check,
    replay, demo), or nothing better was found (calibrate, learn), 2 wrong usage or input, 3 the track is not judged
    (replay), 130 interrupted.
    """
    about, _, below = (inspect.getdoc(_parser) or "").partition("\n\n")
    parser = _Parser(
        prog="navfilter", description=about, epilog=below, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and stop")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", parser_class=_Parser)
    for name, (does, kinds) in _COMMANDS.items():
        command = _command(commands, name, does, kinds)
        if name in ("demo", "replay"):
            replay.add_formats(command)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: that takes longer than parsing everything."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        from importlib.metadata import version

        print(f"navfilter {version('navfilter')}")
        parser.exit(OK)


def _command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], kinds: Mapping[str, Callable[[str], Any]]
) -> argparse.ArgumentParser:
    """A command whose help is the docstring of what runs it: its first line, and what stands below the arguments."""
    about, _, below = (inspect.getdoc(run) or "").partition("\n")
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=about[:1].lower() + about[1:].rstrip("."),
        description=about,
        epilog=below.lstrip("\n"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run, compiled=True)
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    console.add_arguments(parser, name, kinds)
    return parser


# --- simulate -------------------------------------------------------------------------------------------------------


def _simulate(options: argparse.Namespace) -> int:
    """Simulate a mission with its truth.

    DIR gets mission.npz and vehicle.toml; a name that ends in .npz gets the mission, with the vehicle in a .toml beside
    it. Where the sensors err otherwise than the vehicle believes, a second file, vehicle_true.toml, says how: it is the
    oracle of 'navfilter compare'.

    examples:
      navfilter simulate --list
      navfilter simulate lawnmower --seed 3 --duration 900 --out dive
    """
    from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario, true_vehicle

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
        to = out, out.with_suffix(".toml")
        console.new_files((*to, out.with_name(f"{out.stem}_true.toml")), options.force)
    else:
        folder = console.output_folder(out, options.force)
        to = folder / "mission.npz", folder / "vehicle.toml"
    replay.save(vehicle, mission, *to, true_vehicle(options.scenario, options.duration))
    say = console.speaker(options.quiet)
    say(f"{mission.duration_s:.0f} s, streams {', '.join(mission.streams)}. Replay it with:")
    say(f"  navfilter replay {to[0]} --vehicle {to[1]} --smooth --out result")
    return OK


# --- check ----------------------------------------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> int:
    """Look at a recording before it is replayed.

    Reports rates, gaps, repeats and quantisation of every stream, and looks for the usual mistakes: gravity upside
    down, axes swapped, degrees for radians, gyro against heading, DVL against position. Exit code 1 when something
    would spoil a replay.

    examples:
      navfilter check dive_042
      navfilter check dive.mcap                            a bare log: what is in it, and mapped as by
                                                           'navfilter mission --init'
      navfilter check dive_042 --vehicle vehicle.toml      also: are all sensors there, with their mountings applied
    """
    from navfilter.check import check_mission, report_text
    from navfilter.io import read_vehicle
    from navfilter.playback.instructions import instructed

    say = console.speaker(options.quiet)
    mission = _of_a_log(Path(options.mission), say, console.unpacked_bytes(options)) or console.read(options)
    vehicle = None
    if options.vehicle is not None:
        vehicle, mission = instructed(read_vehicle(options.vehicle), mission)
    findings = check_mission(mission, vehicle)
    say(report_text(mission, findings))
    return FOUND if any(finding.severity == "error" for finding in findings) else OK


def _of_a_log(path: Path, say: Callable[[str], None], limit: int) -> Any:
    """A bare log as the mission that ``navfilter mission --init`` would make of it; None for a mission."""
    from navfilter.io.logs import format_of

    is_mission = not path.exists() or (path / "mission.toml").exists() or path.suffix in (".toml", ".npz")
    if is_mission:
        return None
    from navfilter.io.logs.draft import draft, is_table, survey_of
    from navfilter.io.logs.survey import survey_text

    if format_of(path) is None and not is_table(path):
        return None
    found = survey_of(path, limit)
    say(survey_text(found))
    made = draft(found, path.parent)
    say("\nMapped as 'navfilter mission --init' would. Guessed:")
    for guess in made.guesses:
        say(f"  {guess}")
    say("")
    return made.mission


# --- warmup ---------------------------------------------------------------------------------------------------------


def _warmup(options: argparse.Namespace) -> int:
    """Compile everything now, so that nothing compiles during a dive.

    What is compiled is kept: the next process starts at once. Run it once after every installation or update.
    """
    import time

    from navfilter.kernels.compiling.progress import show_compilation
    from navfilter.service.kernel_cache import compile_kernels

    say = (lambda text: None) if options.quiet else console.complain
    if not options.quiet:
        show_compilation()
    console.announce_compilation(say)
    began = time.perf_counter()
    compile_kernels(say)
    console.speaker(options.quiet)(f"ready ({time.perf_counter() - began:.1f} s).")
    return OK


#: The commands by name: what runs, and ways of reading arguments that only it knows.
_COMMANDS: dict[str, tuple[Callable[[argparse.Namespace], int], dict[str, Callable[[str], Any]]]] = {
    "demo": (replay.demo, {}),
    "replay": (replay.replay, {"time": mission_part.time_of}),
    "run": (run.run, {"date": run.date}),
    "compare": (compare.run, {"names": compare.names}),
    "calibrate": (calibrate.run, {}),
    "learn": (learn.run, {"gap": learn.gap}),
    "montecarlo": (montecarlo.run, {}),
    "identify": (identify.run, identify.KINDS),
    "simulate": (_simulate, {}),
    "check": (_check, {}),
    "mission": (mission.run, {}),
    "vehicle": (vehicle.run, {}),
    "warmup": (_warmup, {}),
}

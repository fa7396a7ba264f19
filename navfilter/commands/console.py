"""What the sub-commands share: types of arguments, talking, the output folder, and compiling before the run."""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import select
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.foundation.quoting import printable

if TYPE_CHECKING:
    from navfilter.models.mission import Mission
    from navfilter.models.vehicle import Vehicle


def positive(text: str) -> float:
    """Argument type: a finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be a number > 0, found '{text}'")
    return value


def row_rate(text: str) -> float | None:
    """Argument type: rows per second, or ``all``: None, one per sample of the drive."""
    return None if text == "all" else positive(text)


def whole(text: str, least: int = 0) -> int:
    """Argument type: a whole number, from zero."""
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number >= {least}, found '{text}'")
    return int(text)


def count(text: str) -> int:
    """Argument type: a whole number, from one."""
    return whole(text, 1)


#: How an argument is read, by the name that `arguments.toml` has for it.
_KINDS: dict[str, Callable[[str], Any]] = {
    "positive": positive, "row_rate": row_rate, "whole": whole, "count": count, "number": float,
}  # fmt: skip
#: Groups of which one argument, or one at most, may be given: whether one has to be.
_ALTERNATIVES = {"exactly one": True, "at most one": False}


@functools.cache
def _arguments() -> dict[str, list[dict[str, Any]]]:
    """What stands in `arguments.toml`, by command."""
    return tomllib.loads(Path(__file__).with_name("arguments.toml").read_text("utf-8"))


def add_arguments(parser: argparse.ArgumentParser, command: str, kinds: Mapping[str, Callable[[str], Any]]) -> None:
    """Give a command the arguments that `arguments.toml` has for it; `kinds` are ways of reading that only it knows."""
    shared = {argument["names"][0]: argument for argument in _arguments()["shared"]}
    groups: dict[str, Any] = {"": parser}
    for argument in _arguments().get(command, []):
        keywords = dict(shared[argument["names"][0]] if len(argument) == 1 else argument)
        names, group = keywords.pop("names"), keywords.pop("group", "")
        if group not in groups and group in _ALTERNATIVES:
            groups[group] = parser.add_mutually_exclusive_group(required=_ALTERNATIVES[group])
        elif group not in groups:
            groups[group] = parser.add_argument_group(group)
        if "type" in keywords:
            keywords["type"] = {**_KINDS, **kinds}[keywords["type"]]
        if keywords.get("action") == "boolean_optional":
            keywords["action"] = argparse.BooleanOptionalAction
        groups[group].add_argument(*names, **keywords)


def speaker(quiet: bool) -> Callable[[str], None]:
    """`show`, or what says nothing when `quiet`."""
    return (lambda text: None) if quiet else show


def show(text: str) -> None:
    """Print a text; whatever stands in it out of somebody's files steers no terminal."""
    print(printable(text), flush=True)


def limits_of(options: argparse.Namespace) -> list[tuple[str, float, str]]:
    """The limits that were asked for. Raises ValueError for what is none."""
    from navfilter.calibration.lights import limit_of

    return [limit_of(text) for text in options.limit]


def unpacked_bytes(options: argparse.Namespace) -> int:
    """The limit in bytes."""
    return int(options.max_unpacked * (1 << 30))


def read(options: argparse.Namespace, mission: str = "") -> Mission:
    """The mission that was asked for, or one of several, within the limits that were asked for."""
    from navfilter.io import read_mission

    return read_mission(mission or options.mission, confine=options.confine, unpacked_bytes=unpacked_bytes(options))


#: Of a vehicle.toml that was written with what was found.
LAID_OUT_ANEW = " (laid out anew, in SI units: your file could not be edited)"


#: Stands in every folder that navfilter has made.
_OURS = ".navfilter"


def output_folder(path: str | Path, force: bool, plan: str = _OURS) -> Path:
    """Make the output folder; done before the work begins, so that a wrong path costs no time.

    Parameters
    ----------
    path : path-like
    force : bool
        Whatever is in it.
    plan : str
        Another file that tells a folder of ours.

    Raises
    ------
    ValueError
        When there are files in it, navfilter has not made it, and that is not forced.
    OSError
        When it cannot be made.
    """
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / _OURS
    if not force and not (mark.exists() or (folder / plan).exists()) and any(folder.iterdir()):
        raise ValueError(
            f"{folder} is not empty, and navfilter did not make it: files of yours could be replaced."
            " Give another folder, or --force."
        )
    mark.write_text("navfilter made this folder: it replaces files in it without asking.\n", encoding="utf-8")
    return folder


def new_files(paths: Iterable[Path], force: bool) -> None:
    """Make the folder of files that are to be written.

    Raises
    ------
    ValueError
        When one is there already, and that is not forced.
    """
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not force:
            raise ValueError(f"{path} is there already; choose another name, or --force to replace it.")


def complain(text: str) -> None:
    """A line to standard error; one that is closed, full or not drained keeps nobody waiting."""
    if sys.stderr is None:
        return
    with contextlib.suppress(OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            if not select.select([], [sys.stderr.fileno()], [], 1.0)[1]:
                return
        print(printable(text), file=sys.stderr, flush=True)


def figures_bar(quiet: bool) -> Any:
    """A bar that counts the figures of a page while they are drawn, on a terminal."""
    from tqdm import tqdm

    bars = not quiet and sys.stderr.isatty()
    return tqdm(desc="figures", unit="", leave=False, disable=not bars, bar_format="{desc}: {n_fmt} [{elapsed}]")


def announce_compilation(say: Callable[[str], None]) -> bool:
    """Whether the navigator's kernels have yet to be compiled; says so."""
    from navfilter.kernels.compiling.progress import FILTER, expect, is_compiled, kernel_count

    cold = not is_compiled(*FILTER)
    if cold:
        most = kernel_count()
        expect(most)
        say(f"compiling the kernels that are needed, once: at most {most} ...")
    return cold


def compile_first(quiet: bool, vehicle: Vehicle | None = None) -> None:
    """Compile before a run, so that the run's processor time is its own; given a vehicle, only what that one needs."""
    say = (lambda text: None) if quiet else complain
    if not quiet:
        from navfilter.kernels.compiling.progress import show_compilation

        show_compilation()
    if announce_compilation(say):
        from navfilter.service.kernel_cache import compile_kernels

        began = time.perf_counter()
        compile_kernels(say, vehicle)
        say(f"compiled in {time.perf_counter() - began:.0f} s; later runs load it.")

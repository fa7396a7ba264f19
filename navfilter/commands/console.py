"""What the sub-commands share: types of arguments, talking, the output folder, and compiling before the run."""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import re
import select
import sys
import time
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


#: How an argument is read, by the name that `options.txt` has for it.
_KINDS: dict[str, Callable[[str], Any]] = {
    "positive": positive, "row_rate": row_rate, "whole": whole, "count": count, "number": float,
}  # fmt: skip
#: What other words there say.
_WORDS: dict[str, dict[str, Any]] = {
    "+": {"nargs": "+"}, "?": {"nargs": "?"}, "required": {"required": True},
    "many": {"action": "append", "default": []}, "one": {}, "either": {},
}  # fmt: skip
_OPTION = re.compile(r"(?P<names>\S+(?:, \S+)*)(?: (?P<value>\S+))?(?:  \[(?P<how>[^\]]*)\])?(?:  (?P<help>.+))?")


@functools.cache
def _arguments() -> dict[str, list[str]]:
    """The lines of `options.txt`, by command."""
    found = re.split(r"^\[(\w+)\]\n", Path(__file__).with_name("options.txt").read_text("utf-8"), flags=re.MULTILINE)
    return {name: list(filter(None, text.splitlines())) for name, text in zip(found[1::2], found[2::2], strict=True)}


def add_arguments(parser: argparse.ArgumentParser, command: str, kinds: Mapping[str, Callable[[str], Any]]) -> None:
    """Give a command the arguments that `options.txt` has for it; `kinds` are ways of reading that only it knows."""
    shared = {line.split()[0]: line for line in _arguments()["shared"]}
    groups: dict[str, Any] = {"": parser}
    title = ""
    for line in _arguments()[command]:
        if line[0] != "-" and line.endswith(":"):
            title = line[:-1]
            groups[title] = parser.add_argument_group(title)
            continue
        option = _OPTION.fullmatch(shared.get(line, line))
        assert option is not None  # for the type checker: the file is ours
        words = (option["how"] or "").split()
        if {"one", "either"} & {*words} and "one of" not in groups:
            groups["one of"] = parser.add_mutually_exclusive_group(required="one" in words)
        names, settings = _settings(option, words, kinds)
        groups["one of" if {"one", "either"} & {*words} else title].add_argument(*names, **settings)


def _settings(
    option: re.Match[str], words: list[str], kinds: Mapping[str, Callable[[str], Any]]
) -> tuple[list[str], dict[str, Any]]:
    """Names of an argument, and what else `argparse` is told of it."""
    names, value = option["names"].split(", "), option["value"]
    settings: dict[str, Any] = {"help": option["help"]}
    if not names[0].startswith("-"):
        names, settings = [], {**settings, "dest": names[0].lower(), "metavar": names[0]}
    elif names[0].startswith("--[no-]"):
        names = [names[0].replace("[no-]", "")]
        settings |= {"action": argparse.BooleanOptionalAction, "default": True}
    elif names[0].startswith("--no-"):
        settings |= {"action": "store_false", "dest": names[0].removeprefix("--no-")}
    elif value is None:
        settings["action"] = "store_true"
    else:
        settings |= {"choices": value[1:-1].split(",")} if value.startswith("{") else {"metavar": value}
    for word in words:
        key, equals, text = word.partition("=")
        if equals:
            settings |= {"or": {"nargs": "?", "const": text}, "to": {"dest": text}}.get(key, {"default": text})
        elif word in _WORDS:
            settings |= _WORDS[word]
        else:
            settings["type"] = {**_KINDS, **kinds}[word]
    return names, settings


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

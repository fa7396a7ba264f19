"""What the sub-commands share: types of arguments, talking, the output folder, and compiling before the run."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from navfilter.vehicle import Vehicle

__all__ = ["announce_compilation", "compile_first", "output_folder", "positive", "seed", "speaker"]


def positive(text: str) -> float:
    """Argument type: a finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"must be a number > 0, found '{text}'")
    return value


def seed(text: str) -> int:
    """Argument type: a whole number from zero."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number >= 0, found '{text}'")
    return int(text)


def speaker(quiet: bool) -> Callable[[str], None]:
    """A print that says nothing when `quiet`."""

    def say(text: str) -> None:
        if not quiet:
            print(text, flush=True)

    return say


def output_folder(path: str | Path) -> Path:
    """Make the output folder; done before the work begins, so that a wrong path costs no time."""
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def announce_compilation(quiet: bool) -> bool:
    """Whether the navigator's kernels have yet to be compiled; says so, and shows what is compiled from now on."""
    cold = not _compiled()
    if not quiet:
        from navfilter.compilation import show_compilation

        show_compilation()
        if cold:
            print("compiling the kernels, once: about a minute ...", file=sys.stderr, flush=True)
    return cold


def compile_first(quiet: bool, vehicle: Vehicle | None = None) -> None:
    """Compile before a run, so that the run's processor time is its own; given a vehicle, only what that one needs."""
    if announce_compilation(quiet):
        from navfilter.playback import warm_up

        warm_up(vehicle)


def _compiled() -> bool:
    """Whether numba has kept every kernel file of the navigator since it was last changed."""
    from numba import config

    settings: Any = config
    sources = [Path(__file__).parents[1] / "kernels" / f"{name}.py" for name in ("strapdown", "kalman", "measurement")]
    if settings.DISABLE_JIT:
        return True
    elsewhere = settings.CACHE_DIR
    folders = [Path(elsewhere)] if elsewhere else [sources[0].parent / "__pycache__", Path.home() / ".cache" / "numba"]
    tag = f".py{sys.version_info.major}{sys.version_info.minor}."
    kept = [index for folder in folders if folder.is_dir() for index in folder.rglob("*.nbi") if tag in index.name]
    return all(any(i.name.startswith(f"{s.stem}.") and i.stat().st_mtime >= s.stat().st_mtime for i in kept) for s in sources)

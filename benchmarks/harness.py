"""What the benchmarks share: arguments, tables, JSON, timing side by side, the standard hour, the recordings.

A benchmark is a module with one or more functions that take the parsed arguments, print tables and return their
figures; `main` runs one of them. With ``--json PATH`` the figures are kept as::

    {"benchmark": ..., "arguments": {...}, "machine": {...}, "versions": {...}, "figures": ...}
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import math
import os
import platform
import re
import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import navfilter as nf
from navfilter.io import read_mission, read_vehicle
from navfilter.simulation.scenarios import simulate_scenario

Array = NDArray[np.float64]
Options = argparse.Namespace
Flag = tuple[str, dict[str, Any]]
Clock = Callable[[], float]
CPU: Clock = time.process_time
ROOT = Path(__file__).parent.parent
MAPPINGS = ROOT / "tests" / "recordings"
DEG = math.pi / 180.0
PACKAGES = ("navfilter", "numpy", "scipy", "numba", "filterpy", "python-ins", "statsmodels", "padasip", "river")


def flag(name: str, **settings: Any) -> Flag:
    """An argument of a benchmark, as ``ArgumentParser.add_argument`` takes it."""
    return name, settings


def quick(what: str) -> Flag:
    """The argument ``--quick``, and what it makes shorter."""
    return flag("--quick", action="store_true", help=what)


def main(about: str, commands: Mapping[Callable[[Options], Any], Sequence[Flag]]) -> Any:
    """Run a benchmark from the command line.

    Parameters
    ----------
    about : str
        The module's docstring: what is measured, and against what.
    commands : dict of callable to list of Flag
        Functions that print tables and return figures for JSON. Where there are several, each is a sub-command by its
        name, and its docstring is what ``--help`` says of it.
    """
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=about, formatter_class=plain)
    if len(commands) > 1:
        parts = parser.add_subparsers(dest="command", required=True)
    for run, flags in commands.items():
        own = parser
        if len(commands) > 1:
            text = (run.__doc__ or "").strip()
            first = text.splitlines()[0].replace("%", "%%")
            own = parts.add_parser(run.__name__, help=first, description=text, formatter_class=plain)
        for name, settings in flags:
            own.add_argument(name, **settings)
        own.add_argument("--json", type=Path, metavar="PATH", help="keep the figures in this file")
        own.set_defaults(run=run)
    options = parser.parse_args()
    figures = options.run(options)
    if options.json:
        write_json(options, figures)
    if getattr(options, "failed", False):
        sys.exit(1)
    return figures


def write_json(options: Options, figures: Any) -> None:
    """Write figures, and what they were measured with and on, to ``options.json``."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text().splitlines() if cpu.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    document = {
        "benchmark": Path(sys.argv[0]).stem,
        "arguments": {name: value for name, value in vars(options).items() if name not in ("run", "json")},
        "machine": {"system": platform.platform(), "processor": (names or [""])[0], "cores": os.cpu_count()},
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "figures": figures,
    }
    options.json.write_text(json.dumps(plain(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def version(name: str) -> str | None:
    """Version of a package, None where it is not installed."""
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(name)
    return None


def plain(value: Any) -> Any:
    """A value as JSON has it: arrays as lists, what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Table:
    """Rows that are printed as they come, under a heading of the same names as in the JSON file.

    Parameters
    ----------
    columns : str
        Key, alignment, width and format of every column: ``"kind<20 runs>4d end_m>8.2f"``.
    """

    def __init__(self, columns: str) -> None:
        found = re.findall(r"(\S+)([<>])(\d+)(\.?\d*[dfge]?)", columns)
        self.columns = {key: (f"{side}{max(int(width), len(key))}", form) for key, side, width, form in found}
        self.rows: list[dict[str, Any]] = []
        self._print({key: key for key in self.columns})

    def add(self, row: Mapping[str, Any]) -> None:
        """Print a row and keep it, with whatever else it holds."""
        self.rows.append(dict(row))
        self._print(row)

    def _print(self, row: Mapping[str, Any]) -> None:
        cells = ((row.get(key), place, form) for key, (place, form) in self.columns.items())
        texts = (
            format("-" if x is None else x if isinstance(x, str) else format(x, form), place)
            for x, place, form in cells
        )
        print("  ".join(texts).rstrip(), flush=True)


def in_turn(calls: Mapping[str, Callable[[], object]], turns: int, clock: Clock = CPU) -> dict[str, Array]:
    """Seconds of every call in every turn, A B A B: what slows the machine for a while slows all of them."""
    spent = {name: np.empty(turns) for name in calls}
    for turn in range(turns):
        for name, call in calls.items():
            began = clock()
            call()
            spent[name][turn] = clock() - began
    return spent


def ratio(over: Array, under: Array) -> float:
    """Median of the ratios turn by turn."""
    return float(np.median(over / under))


def peak_mb() -> float:
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def hour(minutes: float = 60.0) -> tuple[nf.Vehicle, nf.Mission]:
    """The standard hour, a lawnmower: inertial unit at 100 Hz, compass 8 Hz, DVL 4 Hz, depth and fixes 1 Hz.

    27 error states: Gauss-Markov errors of compass, DVL and fixes, scale and misalignment of the DVL, offset of depth.
    """
    base, mission = simulate_scenario("lawnmower", 1, 60.0 * minutes)
    slow = nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.01)
    sensors = {
        "compass": nf.Heading(rate_hz=8, error=nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG)),
        "dvl": replace(base.sensors["dvl"], rate_hz=4, error=slow, scale_sd=0.003, misalignment_sd_rad=0.005),
        "depth": replace(base.sensors["depth"], rate_hz=1, error=nf.White(sd=0.05), offset_sd_m=0.2),
        "gps": base.sensors["gps"],
    }
    return nf.Vehicle(base.drive, sensors, "survey, standard hour"), mission


def data_root() -> Path:
    """Folder of the recordings: environment variable NAVFILTER_DATA."""
    root = os.environ.get("NAVFILTER_DATA")
    if not root:
        raise SystemExit("NAVFILTER_DATA is not set: set it to the folder of the recordings.")
    return Path(root)


def recorded(name: str) -> tuple[nf.Mission, nf.Vehicle]:
    """Mission and vehicle of a recording, by the name of its folder in ``tests/recordings``."""
    return read_mission(MAPPINGS / name), read_vehicle(MAPPINGS / name)


def fixes_of(vehicle: nf.Vehicle) -> str:
    """Name of the vehicle's position sensor."""
    return next(name for name, sensor in vehicle.sensors.items() if isinstance(sensor, nf.Position))

"""What the first start costs: processor time and clock of commands with no compiled kernels, beside another checkout.

Every command runs with an empty folder for compiled kernels, then with what that run has left there; the difference is
compiling. `--against` names a folder with another commit of navfilter (``git worktree add FOLDER COMMIT``), which runs
in turn with this one, so that what slows the machine slows both. Processor time is that of all processes of a command.
There is no other software to compare with: what the same kernels would cost elsewhere nobody has measured.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import ROOT, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.io import write_vehicle
from navfilter.simulation.scenarios import simulate_scenario

#: Stands for a folder that is not there yet.
OUT = "out"
#: By name: arguments of the command line. The vehicle is that of `navfilter demo`, its compass learnt.
COMMANDS = {
    "replay": ("replay", "mission.npz", "--vehicle", "vehicle.toml", "--out", OUT, "--smooth", "--quiet"),
    "run": ("run", "--vehicle", "vehicle.toml"),
    "warmup": ("warmup", "--quiet"),
}
COLUMNS = "command<8 checkout<10 cold_processor_s>8.1f cold_wall_s>8.1f warm_processor_s>8.1f warm_wall_s>8.1f"


def spent(package: Path, kernels: Path, folder: Path, arguments: tuple[str, ...]) -> tuple[float, float]:
    """Processor time and clock [s] of one command of a checkout, its helpers included."""
    environment = {**os.environ, "PYTHONPATH": str(package), "NUMBA_CACHE_DIR": str(kernels)}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    shutil.rmtree(folder / OUT, ignore_errors=True)
    command = [sys.executable, "-m", "navfilter", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 1:  # 1: a track of three minutes need not be trusted
        raise SystemExit(done.stderr.decode())
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def cold_start(options: Options) -> dict[str, Any]:
    """Every command of every checkout, in turn."""
    checkouts = {"this": ROOT} | ({} if options.against is None else {"against": Path(options.against).resolve()})
    names = options.commands.split(",")
    found: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    table = Table(COLUMNS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        vehicle, mission = simulate_scenario("demo", 1, 180.0)
        mission.save(folder / "mission.npz")
        write_vehicle(vehicle.with_error(compass=nf.LearnedArma()), folder / "vehicle.toml")
        for turn in range(1 if options.quick else options.turns):
            for command in names[:1] if options.quick else names:
                for who, package in checkouts.items():
                    kernels = folder / f"{who}-{command}-{turn}"
                    twice = [spent(package, kernels, folder, COMMANDS[command]) for _ in range(2)]
                    row = (*twice[0], *twice[1])
                    found.setdefault((command, who), []).append(row)
                    keys = ("cold_processor_s", "cold_wall_s", "warm_processor_s", "warm_wall_s")
                    table.add({"command": command, "checkout": who} | dict(zip(keys, row, strict=True)))
    ratios = {}
    for command in {command for command, who in found if who == "against"}:
        ours, theirs = (np.array(found[command, who]) for who in ("this", "against"))
        ratios[command] = np.median(ours[:, :2] / theirs[:, :2], axis=0)
        print(f"{command}: {ratios[command][0]:.2f} of the processor time, {ratios[command][1]:.2f} by the clock")
    return {"rows": table.rows, "ratios": ratios}


if __name__ == "__main__":
    flags = [
        flag("--against", metavar="FOLDER", help="another checkout of navfilter"),
        flag("--turns", type=int, default=3),
        flag("--commands", default=",".join(COMMANDS), help="of them, by commas (default: %(default)s)"),
        quick("the first command once"),
    ]
    main(__doc__, {cold_start: flags})

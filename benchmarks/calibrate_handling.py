"""What `navfilter calibrate` makes of missions and files that are not as they should be, for `calibrate_random.py`."""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from harness import DEG, Options, Table

import navfilter as nf
from navfilter.commands.cli import main as command
from navfilter.io import write_vehicle
from navfilter.models.mission import Stream
from navfilter.simulation.manoeuvres import ChangeSpeed, FigureEight, Straight, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, simulate

#: What the velocity is really off by.
WRONG = Faults(scale=0.02, misalignment_rad=(0.0, 0.0, 3.0 * DEG), lever_arm_m=(0.5, 0.0, 0.0), time_offset_s=0.35)
LEGS = (FigureEight(rate_deg_s=8.0), ChangeSpeed(0.6, 4.0), Straight(20.0), ChangeSpeed(1.5, 4.0), Turn(130.0))
WAY = Motion((ChangeSpeed(1.5, 5.0), *LEGS, *LEGS), latitude_deg=50.0, longitude_deg=5.0)
AHEAD = Motion((ChangeSpeed(1.5, 5.0), Straight(200.0)), latitude_deg=50.0, longitude_deg=5.0)
STOPS = (ChangeSpeed(1.5, 6.0), Turn(170.0, rate_deg_s=10.0), ChangeSpeed(0.0, 6.0), Wait(10.0))
STANDSTILL = Motion((Wait(20.0), *STOPS * 4), latitude_deg=50.0, longitude_deg=5.0)


def reckoning() -> nf.Vehicle:
    """Dead reckoning that is sure of everything."""
    sensor = nf.BodyVelocity(error=nf.White(sd=0.02), lever_arm_b_m=(0.5, 0.0, 0.0))
    heading = nf.Heading(error=nf.White(sd=0.2 * DEG))
    drive = nf.DeadReckoning(rate_hz=3.7, attitude=heading, velocity=sensor, tilt=nf.White(sd=0.05 * DEG))
    return nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.3))})


def inertial() -> nf.Vehicle:
    """A unit, a DVL and a depth gauge."""
    unit = nf.Imu(rate_hz=20, gyro=nf.White(density=5e-5), accel=nf.White(density=1e-3))
    dvl, depth = nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01)), nf.Depth(error=nf.White(sd=0.05))
    return nf.Vehicle(imu=unit, sensors={"dvl": dvl, "depth": depth})


def dive(seed: int = 1, way: Motion = WAY) -> nf.Mission:
    return simulate(reckoning(), way, seed=seed, faults={"velocity": WRONG}, name=f"dive_{seed}")


def lost(mission: nf.Mission, name: str, share: float) -> nf.Mission:
    """With NaN for this share of the readings of a stream."""
    stream = mission.streams[name]
    value = stream.value.copy()
    value[np.random.default_rng(1).random(len(value)) < share] = math.nan
    return mission.with_stream(name, Stream(stream.time_s, value, stream.columns))


def as_fixes_wander() -> nf.Mission:
    """Its fixes wander by metres that nobody describes: what they bend is not to be kept."""
    wander = Faults(true_error=nf.GaussMarkov(sd=5.0, tau_s=20.0))
    return simulate(reckoning(), WAY, seed=3, faults={"gps": wander}, name="wander")


Made = Callable[[], Sequence[nf.Mission]]
#: What is done: its vehicle, its missions, the arguments beside these, and the exit codes that are right.
CASES: dict[str, tuple[Callable[[], nf.Vehicle], Made, list[str], tuple[int, ...]]] = {
    "one mission": (reckoning, lambda: [dive()], [], (0,)),
    "three missions": (reckoning, lambda: [dive(1), dive(2), dive(3)], [], (0,)),
    "the same mission twice": (reckoning, lambda: [dive(), dive()], [], (2,)),
    "truth as fixes": (
        lambda: reckoning().without("gps"),
        lambda: [dive().without_stream("gps")],
        ["--truth", "0.1"],
        (0,),
    ),
    "truth as fixes, and none": (reckoning, lambda: [replace(dive(), truth=None)], ["--truth"], (2,)),
    "no fixes, nothing corrects": (
        lambda: reckoning().without("gps"),
        lambda: [dive().without_stream("gps")],
        [],
        (2,),
    ),
    "standstill and turns, no fixes": (
        inertial,
        lambda: [
            simulate(
                inertial(), STANDSTILL, seed=8, faults={"dvl": Faults(lever_arm_m=(0.5, 0.0, 0.0), time_offset_s=0.35)}
            )
        ],
        ["--open", "clock,lever-arm"],
        (0,),
    ),
    "straight ahead, arms only": (reckoning, lambda: [dive(4, AHEAD)], ["--open", "lever-arm"], (1,)),
    "ten seconds": (reckoning, lambda: [dive().between(0.0, 10.0)], [], (2,)),
    "forty seconds": (reckoning, lambda: [dive().between(0.0, 40.0)], [], (0, 1)),
    "a third of the fixes NaN": (reckoning, lambda: [lost(dive(), "gps", 0.3)], [], (0,)),
    "all fixes NaN": (reckoning, lambda: [lost(dive(), "gps", 1.1)], [], (2,)),
    "a fifth of the velocities NaN": (reckoning, lambda: [lost(dive(), "velocity", 0.2)], [], (0,)),
    "all velocities NaN": (reckoning, lambda: [lost(dive(), "velocity", 1.1)], [], (1, 2)),
    "one mission without fixes": (reckoning, lambda: [dive(1), dive(2).without_stream("gps")], [], (2,)),
    "fixes that wander": (reckoning, lambda: [as_fixes_wander()], ["--open", "scale,mounting"], (1,)),
    "unknown kind": (reckoning, lambda: [dive()], ["--open", "clocks"], (2,)),
    "a kind that nothing has": (reckoning, lambda: [dive()], ["--open", "iron"], (2,)),
    "unknown constant of each": (reckoning, lambda: [dive()], ["--each", "clocks"], (2,)),
    "all constants of each": (reckoning, lambda: [dive()], ["--open", "clock", "--each", "clock"], (2,)),
    "--out in no folder": (reckoning, lambda: [dive()], ["--out", "{folder}/none/out.toml"], (0,)),
    "--json in no folder": (reckoning, lambda: [dive()], ["--json", "{folder}/none/out.json"], (0,)),
    "--out is there": (reckoning, lambda: [dive()], ["--out", "{folder}/vehicle.toml"], (2,)),
    "--out is there, --force": (reckoning, lambda: [dive()], ["--out", "{folder}/vehicle.toml", "--force"], (0,)),
}


def handled(count: int | None) -> Iterator[dict[str, Any]]:
    """What became of so many of `CASES`, all by default."""
    for name, (vehicle, missions, more, right) in islice(CASES.items(), count):
        with tempfile.TemporaryDirectory() as folder:
            write_vehicle(vehicle(), Path(folder) / "vehicle.toml")
            paths = []
            for k, mission in enumerate(missions()):
                paths.append(str(Path(folder) / f"mission_{k}.npz"))
                mission.save(paths[-1])
            out = [] if "--out" in more else ["--out", f"{folder}/out.toml"]
            arguments = ["calibrate", *paths, "--vehicle", f"{folder}/vehicle.toml", *out]
            said, wrong, began = io.StringIO(), io.StringIO(), time.perf_counter()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(wrong):
                code = command([*arguments, *(text.format(folder=folder) for text in more)])
            lines = [line for line in (said.getvalue() + wrong.getvalue()).splitlines() if line]
            verdict = next((line for line in lines if "ept: " in line), lines[-1] if lines else "")
            yield {
                "case": name,
                "exit": code,
                "right": "yes" if code in right else "NO",
                "seconds": time.perf_counter() - began,
                "words": verdict.replace(folder, ""),
                "all": lines,
            }


def handling(options: Options) -> list[dict[str, Any]]:
    """Missions and files that are not as they should be, by the command line."""
    table = Table("case<32 exit>4d right<5 seconds>7.1f words<150")
    for row in handled(6 if options.quick else None):
        table.add(row)
    return table.rows

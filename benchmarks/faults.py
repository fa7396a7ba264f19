"""Faults put into missions and around the filter, against the same run without a fault.

missions  every kind of fault in `tests/faults_library.py`, in a simulated mission and in real recordings
outcomes  how far each fault takes the state, what the filter says of it, and whether its bounds hold the truth
further   the same for what nothing was written for: two faults at once, clocks, mountings, a bottom that moves
signatures  every hypothesis of the bank of faults, in three sizes: whether its name is alive
fault_free  what is excluded where there is no fault, and what that costs
service   killed processes, full disks, cut logs, damaged snapshots, garbage on the line
"""

from __future__ import annotations

import dataclasses
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from harness import ROOT, Options, Table, fixes_of, flag, main, quick, recorded

sys.path.insert(0, str(ROOT / "tests"))
import faults_library as library
import faults_run as watched
from faults_free import fault_free
from faults_further import further
from faults_outcomes import VEHICLES, outcomes
from faults_service import service
from faults_signatures import signatures

import navfilter as nf
from navfilter.models.alignment import align

DURATION_S, WINDOW, FIXES, SILENT, JUDGED = 480.0, (150.0, 210.0), (300.0, 340.0), (240.0, 270.0), (400.0, 480.0)
WORST_NEES = 2.0
SLOWER = 10.0  # than the run without a fault: what arrives must not be able to stall the vehicle
FAR_M = 5.0  # from the truth of a recording, fixes back for a while; or three times the distance without a fault
RECORDINGS = ("snapir-auv-1hz/01", "auv-lake-sea-10hz/20220625_0_0")
SEEN = "kind<44 crashes>5d nan>3d not_definite>3d"
NAMES = ("position", "velocity", "attitude")
Judge = Callable[[watched.Outcome, nf.Mission], dict[str, float]]


class Run(NamedTuple):
    """A mission that faults are put into, and what it is without one."""

    vehicle: nf.Vehicle
    mission: nf.Mission
    scene: library.Scene
    seed: int
    clean: watched.Outcome


def missions(options: Options) -> dict[str, Any]:
    """Every kind of fault, for several seeds, in a simulated mission and in real recordings.

    The simulated mission is eight minutes of a lawnmower at 100 Hz with position fixes in the first two minutes and
    from 270 s on; faults of the position fixes act from 300 to 340 s, all others from 150 to 210 s (some for good: a
    clock that has jumped stays where it is). After each run it is known whether anything raised an exception, whether
    a NaN appeared in the state, whether the covariance (scaled to a unit diagonal, looked at once a second) stayed
    positive definite, what the readings' outcomes were, and how large the normalised error (NEES, per degree of
    freedom, mean of the seeds) is after recovery: from 400 s on, with fixes for two minutes. "_before" is the same
    from 240 to 270 s, before the first fix: whether the filter knows what the fault has cost it.

    Real recordings (environment variable NAVFILTER_DATA): fixes until a fifth of the time and again from three fifths
    on, faults in between (of the fixes: after their return); the distance to the truth in the last seventh, and
    before the fixes return, beside that of the run without a fault.
    """
    kinds = [name for name in library.KINDS if options.only in name]
    nf.warm_up()
    seeds = [1] if options.quick else list(range(1, options.seeds + 1))
    print(f"{len(kinds)} kinds x {len(seeds)} seeds; NEES of position, velocity, attitude after recovery | before")
    figures = {"simulated": simulated(kinds, seeds, options.one_by_one)}
    for name in RECORDINGS if os.environ.get("NAVFILTER_DATA") else ():
        print(f"\n{name}; RMS distance to the truth [m] after recovery, before the fixes return, without fault")
        figures[name] = replayed(name, kinds, seeds)
    for where, rows in figures.items():
        failed = [row for row in rows if row["failures"]]
        print(f"\n{where}: {len(rows) - len(failed)} of {len(rows)} kinds without a failure")
        for row in failed:
            for crash, n in row["crashed"].most_common(6):
                print(f"  {row['kind']}: {n} x {crash}")
    return figures


def row_of(kind: str | None, runs: Sequence[Run], judge: Judge, one_by_one: bool = False) -> dict[str, Any]:
    """What a kind of fault did, over all runs; None is no fault."""
    crashed, counted, figures = Counter(), Counter(), []
    row = {"kind": kind or "(none)", "nan": 0, "not_definite": 0, "answered": True, "smallest": math.inf, "slower": 0.0}
    for vehicle, mission, scene, seed, clean in runs:
        outcome = clean
        if kind is not None:
            outcome = watched.run(kind, vehicle, mission, scene, seed, one_by_one=one_by_one)
        crashed += outcome.crashes
        # more often than without the fault, without the readings that were used
        more = outcome.counts - clean.counts
        counted += Counter({k: n for k, n in more.items() if not k.endswith((":used", " is good", " is waiting"))})
        row["nan"] += outcome.nan_s is not None
        row["not_definite"] += outcome.not_definite_s is not None
        row["answered"] &= outcome.sent == outcome.answered
        row["smallest"] = min(row["smallest"], outcome.smallest)
        row["slower"] = max(row["slower"], outcome.cpu_s / clean.cpu_s)
        figures.append(judge(outcome, mission))
    row |= {key: float(np.mean([figure[key] for figure in figures])) for key in figures[0]}
    row |= {"crashes": crashed.total(), "crashed": crashed, "counted": counted}
    row["failures"] = list(failures(row, library.KINDS[kind].counted if kind else ()))
    said = ", ".join(f"{name} {n}" for name, n in counted.most_common(4))
    return row | {"verdict": ", ".join(row["failures"]) or "ok", "counts": said}


def failures(row: dict[str, Any], counted: Sequence[str]) -> Iterator[str]:
    """What the row does not show as it should."""
    if row["crashes"] or not row["answered"]:
        yield "crash"
    if row["nan"]:
        yield "NaN"
    if row["slower"] > SLOWER:
        yield f"{row['slower']:.0f} times slower"
    if row["not_definite"]:
        yield "not PD"
    if "position" in row and counted and not any(row["counted"][key] for key in counted):
        yield "not counted"
    if "position" in row and not max(row[key] for key in NAMES) < WORST_NEES:
        yield "NEES"
    if "after_m" in row and not row["after_m"] < max(3.0 * row["clean_after_m"], FAR_M):
        yield "far off"


def simulated(kinds: Sequence[str], seeds: Sequence[int], one_by_one: bool) -> list[dict[str, Any]]:
    """One row per kind, over all seeds; the first is the mission without a fault."""
    runs = []
    for seed in seeds:
        vehicle, mission = watched.simulated(seed, DURATION_S)
        scene = library.scene_of(vehicle, WINDOW, FIXES)
        clean = watched.run(None, vehicle, mission, scene, seed, one_by_one=one_by_one)
        runs.append(Run(vehicle, mission, scene, seed, clean))

    def judge(outcome: watched.Outcome, mission: nf.Mission) -> dict[str, float]:
        before = watched.nees(outcome, mission.truth, *SILENT)
        return watched.nees(outcome, mission.truth, *JUDGED) | {f"{key}_before": x for key, x in before.items()}

    nees = " ".join(f"{name}>8.3g" for name in [*NAMES, *(f"{name}_before" for name in NAMES)])
    table = Table(f"{SEEN} {nees} verdict<20 counts<6")
    for kind in (None, *kinds):
        table.add(row_of(kind, runs, judge, one_by_one))
    return table.rows


def replayed(name: str, kinds: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """One row per kind on a real recording."""
    mission, vehicle = recorded(name)
    if mission.start is None:
        mission = dataclasses.replace(mission, start=align(vehicle, mission))
    begin, span = mission.start.time_s, mission.end_s - mission.start.time_s

    def part(first: float, last: float, longest_s: float = math.inf) -> tuple[float, float]:
        return begin + first * span, min(begin + last * span, begin + first * span + longest_s)

    mission = mission.hide(fixes_of(vehicle), part(0.2, 0.6))
    scene = library.scene_of(vehicle, part(0.25, 0.4, 60.0), part(0.65, 0.75, 40.0))
    clean = watched.run(None, vehicle, mission, scene, 1)

    def judge(outcome: watched.Outcome, mission: nf.Mission) -> dict[str, float]:
        when = {"after_m": part(0.86, 1.0), "before_m": part(0.5, 0.6)}
        figures = {key: distance(outcome, mission, *times) for key, times in when.items()}
        return figures | {f"clean_{key}": distance(clean, mission, *times) for key, times in when.items()}

    metres = "after_m>8.2f clean_after_m>8.2f before_m>8.2f clean_before_m>8.2f"
    table = Table(f"{SEEN} {metres} verdict<20 counts<6")
    for kind in kinds:
        table.add(row_of(kind, [Run(vehicle, mission, scene, seed, clean) for seed in seeds], judge))
    return table.rows


def distance(outcome: watched.Outcome, mission: nf.Mission, begin_s: float, end_s: float) -> float:
    """RMS horizontal distance to the truth between two instants [m]."""
    truth = mission.truth.keep(np.isfinite(mission.truth.value[:, :2]).all(axis=1))
    squares = []
    for time_s, state in outcome.states:
        if begin_s <= time_s <= min(end_s, truth.time_s[-1]):
            latitude, longitude = (np.interp(time_s, truth.time_s, truth.value[:, k]) for k in (0, 1))
            squares.append((state.latitude - latitude) ** 2 + ((state.longitude - longitude) * math.cos(latitude)) ** 2)
    return 6.371e6 * math.sqrt(np.mean(squares)) if squares else math.nan


if __name__ == "__main__":
    seeds = flag("--seeds", type=int, default=5)
    flags = [
        seeds,
        flag("--only", default="", help="only kinds whose name contains this"),
        flag("--one-by-one", action="store_true", help="samples of the drive one at a time"),
        quick("one seed"),
    ]
    shown = flag("--shown", action="store_true", help="the faults of the manual's page, and its table")
    words = "inertial unit, its DVL read beam by beam, or dead reckoning without a unit (default: %(default)s)"
    vehicle = flag("--vehicle", choices=list(VEHICLES), default="tactical", help=words)
    told = [seeds, flags[1], shown, vehicle, quick("one seed")]
    commands = {missions: flags, outcomes: told, further: told, signatures: told}
    fifty = flag("--seeds", type=int, default=50)
    commands |= {fault_free: [fifty, flags[1], quick("three seeds")]}
    around = [
        seeds,
        flag("--only", default="", help="only kinds whose name contains this"),
        flag("--schedules", type=int, default=1000, help="how many (default: %(default)s)"),
        flag("--first", type=int, default=1, help="seed of the first schedule"),
        flag("--workers", type=int, default=1, help="processes for the schedules"),
        quick("one seed, ten schedules"),
    ]
    main(__doc__, commands | {service: around})

"""The fault campaign: every kind of fault in `tests/faults_library.py`, for several seeds, in a simulated mission and in real recordings.

The simulated mission is eight minutes of a lawnmower at 100 Hz with position fixes in the first two minutes and from 270 s on; faults of
the position fixes act from 300 to 340 s, all others from 150 to 210 s (some for good: a clock that has jumped stays where it is). After
each run it is known whether anything raised an exception, whether a NaN appeared in the state, whether the covariance (scaled to a unit
diagonal, looked at once a second) stayed positive definite, what the readings' outcomes were, and how large the normalised error (NEES,
per degree of freedom, mean of the seeds) is after recovery: from 400 s on, with fixes for two minutes. The last column but one is the same
from 240 to 270 s, before the first fix: whether the filter knows what the fault has cost it.

Real recordings (environment variable NAVFILTER_DATA): fixes until a fifth of the time and again from three fifths on, faults in between
(of the fixes: after their return); the distance to the truth in the last seventh, and before the fixes return, beside that of the run
without a fault.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tests"))
import faults_library as library  # noqa: E402
import faults_run as watched  # noqa: E402

import navfilter as nf  # noqa: E402
from navfilter.alignment import align  # noqa: E402
from navfilter.io import read_mission, read_vehicle  # noqa: E402
from navfilter.sensors import Position  # noqa: E402

DURATION_S, WINDOW, FIXES, SILENT, JUDGED = 480.0, (150.0, 210.0), (300.0, 340.0), (240.0, 270.0), (400.0, 480.0)
WORST_NEES = 2.0
SLOWER = 10.0  # than the run without a fault: what arrives must not be able to stall the vehicle
FAR_M = 5.0  # from the truth of a recording, when the fixes have been back for a while; or three times the distance without a fault
RECORDINGS = ("snapir-auv-1hz/01", "auv-lake-sea-10hz/20220625_0_0")


def added(outcome: watched.Outcome, clean: watched.Outcome) -> Counter:
    """What was counted more often than without the fault, without the readings that were used."""
    more = outcome.counts - clean.counts
    return Counter({name: n for name, n in more.items() if not name.endswith((":used", " is good", " is waiting"))})


def simulated_rows(kinds: Sequence[str], seeds: Sequence[int], one_by_one: bool) -> list[dict[str, Any]]:
    """One row per kind, over all seeds; the first is the mission without a fault."""
    missions = {seed: watched.simulated(seed, DURATION_S) for seed in seeds}
    scene = library.scene_of(missions[seeds[0]][0], WINDOW, FIXES)
    clean = {seed: watched.run(None, *missions[seed], scene, seed, one_by_one=one_by_one) for seed in seeds}
    rows = []
    for name in (None, *kinds):
        row: dict[str, Any] = {"kind": name or "(none)", "crashes": Counter(), "counted": Counter(), "smallest": math.inf}
        after, before, nan, definite, answered, slow = [], [], 0, 0, True, 0.0
        for seed, (vehicle, mission) in missions.items():
            outcome = clean[seed] if name is None else watched.run(name, vehicle, mission, scene, seed, one_by_one=one_by_one)
            row["crashes"] += outcome.crashes
            row["counted"] += added(outcome, clean[seed])
            row["smallest"] = min(row["smallest"], outcome.smallest)
            slow = max(slow, outcome.cpu_s / clean[seed].cpu_s)
            nan += outcome.nan_s is not None
            definite += outcome.not_definite_s is not None
            answered = answered and outcome.sent == outcome.answered
            after.append(watched.nees(outcome, mission.truth, *JUDGED))
            before.append(watched.nees(outcome, mission.truth, *SILENT))
        row |= {
            "slower": slow,
            "nan": nan,
            "not_definite": definite,
            "answered": answered,
            "nees": mean(after),
            "nees_before_fixes": mean(before),
        }
        row["failures"] = failures(row, library.KINDS[name].counted if name else ())
        rows.append(row)
        print(line(row), flush=True)
    return rows


def mean(parts: list[dict[str, float]]) -> dict[str, float]:
    """Mean over the seeds; a run without a state to judge makes it NaN."""
    return {key: float(np.mean([part[key] for part in parts])) for key in parts[0]}


def failures(row: dict[str, Any], counted: Sequence[str]) -> list[str]:
    """What the row does not show as it should."""
    found = []
    if row["crashes"] or not row["answered"]:
        found.append("crash")
    if row["nan"]:
        found.append("NaN")
    if row["slower"] > SLOWER:
        found.append(f"{row['slower']:.0f} times slower")
    if row["not_definite"]:
        found.append("not PD")
    if counted and not any(row["counted"][key] for key in counted):
        found.append("not counted")
    if "nees" in row and not max(row["nees"].values()) < WORST_NEES:
        found.append("NEES")
    if "after_m" in row and not row["after_m"] < max(3.0 * row["clean_after_m"], FAR_M):
        found.append("far off")
    return found


def line(row: dict[str, Any]) -> str:
    """A row for people."""
    counted = ", ".join(f"{key} {n}" for key, n in row["counted"].most_common(4))

    def cells(values: dict[str, float]) -> str:
        return " ".join(f"{v:8.2f}" if v < 1e4 else f"{v:8.1e}" for v in values.values())

    text = f"{row['kind'][:44]:44s} {sum(row['crashes'].values()):5d} {row['nan']:3d} {row['not_definite']:3d}  "
    if "nees" in row:
        text += f"{cells(row['nees'])} | {cells(row['nees_before_fixes'])}"
    else:
        text += f"{row['after_m']:8.2f} ({row['clean_after_m']:.2f}) | {row['before_m']:8.2f} ({row['clean_before_m']:.2f})"
    return f"{text}  {', '.join(row['failures']) or 'ok':20s} {counted}"


def recorded_rows(name: str, kinds: Sequence[str], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """One row per kind on a real recording."""
    folder = ROOT / "tests" / "recordings" / name
    vehicle, mission = read_vehicle(folder), read_mission(folder)
    if mission.start is None:
        mission = dataclasses.replace(mission, start=align(vehicle, mission))
    begin, span = mission.start.time_s, mission.end_s - mission.start.time_s

    def part(first: float, last: float, longest_s: float = math.inf) -> tuple[float, float]:
        return begin + first * span, min(begin + last * span, begin + first * span + longest_s)

    fixes = next(key for key, sensor in vehicle.sensors.items() if isinstance(sensor, Position))
    mission = mission.hide(fixes, part(0.2, 0.6))
    scene = library.scene_of(vehicle, part(0.25, 0.4, 60.0), part(0.65, 0.75, 40.0))
    judged, before = part(0.86, 1.0), part(0.5, 0.6)
    clean = watched.run(None, vehicle, mission, scene, 1)
    rows = []
    for kind in kinds:
        row: dict[str, Any] = {"kind": kind, "crashes": Counter(), "counted": Counter(), "smallest": math.inf}
        row |= {"nan": 0, "not_definite": 0, "slower": 0.0}
        answered, after, silent = True, [], []
        for seed in seeds:
            outcome = watched.run(kind, vehicle, mission, scene, seed)
            row["crashes"] += outcome.crashes
            row["counted"] += added(outcome, clean)
            row["smallest"] = min(row["smallest"], outcome.smallest)
            row["nan"] += outcome.nan_s is not None
            row["slower"] = max(row["slower"], outcome.cpu_s / clean.cpu_s)
            row["not_definite"] += outcome.not_definite_s is not None
            answered = answered and outcome.sent == outcome.answered
            after.append(distance(outcome, mission, *judged))
            silent.append(distance(outcome, mission, *before))
        row |= {"answered": answered, "after_m": float(np.mean(after)), "before_m": float(np.mean(silent))}
        row |= {"clean_after_m": distance(clean, mission, *judged), "clean_before_m": distance(clean, mission, *before)}
        row["failures"] = failures(row, ())
        rows.append(row)
        print(line(row), flush=True)
    return rows


def distance(outcome: watched.Outcome, mission: Any, begin_s: float, end_s: float) -> float:
    """RMS horizontal distance to the truth between two instants [m]."""
    known = np.isfinite(mission.truth.value[:, :2]).all(axis=1)
    truth = mission.truth.keep(known)
    squares = []
    for time_s, state in outcome.states:
        if begin_s <= time_s <= min(end_s, truth.time_s[-1]):
            latitude, longitude = (np.interp(time_s, truth.time_s, truth.value[:, k]) for k in (0, 1))
            squares.append((state.latitude - latitude) ** 2 + ((state.longitude - longitude) * math.cos(latitude)) ** 2)
    return 6.371e6 * math.sqrt(np.mean(squares)) if squares else math.nan


def main() -> None:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", default="", help="only kinds whose name contains this")
    parser.add_argument("--quick", action="store_true", help="one seed")
    parser.add_argument("--one-by-one", action="store_true", help="samples of the drive one at a time")
    arguments = parser.parse_args()
    kinds = [name for name in library.KINDS if arguments.only in name]
    nf.warm_up()
    seeds = [1] if arguments.quick else list(range(1, arguments.seeds + 1))
    print(f"{len(kinds)} kinds x {len(seeds)} seeds; NEES of position, velocity, attitude after recovery | before the first fix")
    print(f"{'kind':44s} {'crash':>5s} {'NaN':>3s} {'!PD':>3s}")
    figures = {"simulated": simulated_rows(kinds, seeds, arguments.one_by_one)}
    if os.environ.get("NAVFILTER_DATA"):
        for name in RECORDINGS:
            print(f"\n{name}; RMS distance to the truth [m] after recovery | before the fixes return (without fault)")
            figures[name] = recorded_rows(name, kinds, seeds)
    for where, rows in figures.items():
        failed = [row for row in rows if row["failures"]]
        print(f"\n{where}: {len(rows) - len(failed)} of {len(rows)} kinds without a failure")
        for row in failed:
            for crash, n in row["crashes"].most_common(6):
                print(f"  {row['kind']}: {n} x {crash}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()

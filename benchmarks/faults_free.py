"""Missions without a fault: what the filter excludes all the same, and what that costs."""

from __future__ import annotations

import contextlib
import math
import os
from collections import Counter
from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from faults_outcomes import BOAT, VEHICLES
from harness import MAPPINGS, Options, Table, recorded

import navfilter as nf
from navfilter.faults import policy
from navfilter.filter.actions import Action
from navfilter.models.alignment import align
from navfilter.simulation.scenarios import simulate_scenario, survey, survey_vehicle
from navfilter.simulation.simulate import simulate

DURATION_S = 240.0
SIMULATED = ("survey", "survey-mems", "reckoning", "lawnmower", "beams", "ahrs", "usbl", "wheels", "boat")
#: Each is an exclusion, or a state set anew or given up.
COUNTED = ("reset", "jumped", "astray", "opened", "contradicted", "shifted")
COLUMNS = f"mission<34 runs>4d {' '.join(f'{key}>7d' for key in COUNTED)} rms_m>8.2f plain_m>8.2f loss>7.1f"


@contextlib.contextmanager
def without_agreement() -> Iterator[None]:
    """Readings are judged one by one, by their gates alone."""

    def nothing(*_: object) -> Generator[Action, None, bool]:
        yield from ()
        return False

    with (
        mock.patch.object(policy, "_agreed", nothing),
        mock.patch("navfilter.filter.sensor_channel.believed", lambda sensor, group: np.full(sensor.axes, np.inf)),
        mock.patch("navfilter.faults.monitor.FaultMonitor.is_stale", lambda *_: False),
    ):
        yield


def mission_of(name: str, seed: int) -> tuple[nf.Vehicle, nf.Mission]:
    """A short mission: fixes at the surface, a dive, turns."""
    if name.startswith("survey"):
        vehicle = survey_vehicle(mems=name.endswith("mems"))
        return vehicle, simulate(vehicle, survey(DURATION_S, surface_s=40.0), seed=seed, duration_s=DURATION_S)
    if name not in VEHICLES or name == "reckoning":
        return simulate_scenario(name, seed, DURATION_S)
    motion = survey(DURATION_S, surface_s=40.0, depth_m=1.0 if name == BOAT else 20.0)
    return VEHICLES[name](), simulate(VEHICLES[name](), motion, seed=seed, duration_s=DURATION_S)


def judged(vehicle: nf.Vehicle, mission: nf.Mission) -> dict[str, float]:
    """What was excluded, and the mean square horizontal error with and without agreement [m^2]; NaN without truth."""
    counts: Counter = Counter()
    track = nf.replay(vehicle, mission)
    with without_agreement():
        plain = nf.replay(vehicle, mission)
    counts.update({key: track.counts[key] for key in COUNTED if key in track.counts})
    squares = [math.nan, math.nan]
    if mission.truth is not None:
        squares = [float(np.nanmean(t.errors(mission.truth).horizontal ** 2)) for t in (track, plain)]
    return {**{key: counts[key] for key in COUNTED}, "squares": squares[0], "plain_squares": squares[1]}


def row_of(name: str, figures: list[dict[str, float]]) -> dict[str, Any]:
    """All missions of a name."""
    rms_m, plain_m = (math.sqrt(np.mean([f[key] for f in figures])) for key in ("squares", "plain_squares"))
    sums = {key: sum(int(f[key]) for f in figures) for key in COUNTED}
    return {
        "mission": name,
        "runs": len(figures),
        **sums,
        "rms_m": rms_m,
        "plain_m": plain_m,
        "loss": 100.0 * (rms_m / plain_m - 1.0) if plain_m else 0.0,
    }


def fault_free(options: Options) -> list[dict[str, Any]]:
    """Missions without a fault, and recordings: what is excluded there, and the accuracy beside that without agreement.

    Simulated missions of four minutes (survey with a tactical and a micromechanical unit, dead reckoning, lawnmower,
    and the survey with the other vehicles of `outcomes`), 50 seeds; then, where NAVFILTER_DATA is set, every recording
    of `tests/recordings` that has a start or can be aligned. reset, jumped, astray, opened: how often a state was set
    anew, a sensor jumped or went astray, the state was given up. rms_m, plain_m: horizontal error with agreement, and
    with gates alone; loss: by how much the first is larger [%].
    """
    nf.warm_up()
    rows = Table(COLUMNS)
    seeds = range(1, 4) if options.quick else range(1, options.seeds + 1)
    for name in SIMULATED:
        if options.only in name:
            rows.add(row_of(name, [judged(*mission_of(name, seed)) for seed in seeds]))
    if not os.environ.get("NAVFILTER_DATA"):
        return rows.rows
    for path in sorted(p.parent for p in MAPPINGS.rglob("mission.toml")):
        name = str(path.relative_to(MAPPINGS))
        if options.only not in name:
            continue
        try:
            mission, vehicle = recorded(name)
            mission = mission if mission.start else replace(mission, start=align(vehicle, mission))
        except (ValueError, OSError) as problem:
            print(f"{name}: {problem}")
            continue
        rows.add(row_of(name, [judged(vehicle, mission)]))
    return rows.rows

"""Vehicles with lanes: one of two inertial units fails, or the only one beside dead reckoning; and nothing fails.

A survey with fixes until 140 s and from 600 s on; the fault begins at 400 s, for half a minute or for good. What is
compared: the greatest distance from the truth in the dive by the lane in force, by the sound unit alone (a filter that
never heard of the other), and by the unit that fails alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from harness import DEG, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.models.mission import Mission, Stream
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate
from navfilter.track.track import Track

#: What a reading becomes, by the name of the fault: its sensor; from seconds since the fault, readings, and those of
#: `LATE` readings before.
LATE = 20
SENSORS: dict[str, tuple[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]]] = {
    "jumped by 0.5 m/s": ("dvl", lambda t, v, before: np.add(v, (0.5, 0.0, 0.0))),
    "jumped by 2 m/s": ("dvl", lambda t, v, before: np.add(v, (2.0, 1.0, 0.0))),
    "scale +5 %": ("dvl", lambda t, v, before: 1.05 * v),
    "in knots": ("dvl", lambda t, v, before: 1.944 * v),
    "in mm/s": ("dvl", lambda t, v, before: 1000.0 * v),
    "noise of 0.1 m/s": ("dvl", lambda t, v, before: v + np.random.default_rng(1).normal(size=v.shape) * 0.1),
    "noise of 0.5 m/s": ("dvl", lambda t, v, before: v + np.random.default_rng(1).normal(size=v.shape) * 0.5),
    "stuck": ("dvl", lambda t, v, before: np.repeat(v[:1], len(v), axis=0)),
    "late by 5 s": ("dvl", lambda t, v, before: before),
    "drifts by 0.1 m/s^2": ("dvl", lambda t, v, before: v + np.outer(t, [0.1, 0.0, 0.0])),
    "compass +30 deg": ("compass", lambda t, v, before: v + 30.0 * DEG),
}
END_S, DIVE_S, FAULT_S, BACK_S, SHORT_S = 700.0, 140.0, 400.0, 600.0, 30.0
#: What the samples of a unit become, by the name of the fault.
KINDS: dict[str, Callable[[np.ndarray], np.ndarray] | None] = {
    "frozen": lambda rows: np.repeat(rows[:1], len(rows), axis=0),
    "gyros frozen": lambda rows: np.column_stack([np.repeat(rows[:1, :3], len(rows), axis=0), rows[:, 3:]]),
    "dead": lambda rows: 0.0 * rows,
    "silent": None,
    "gyros noisy, accelerometers too": lambda rows: (
        rows + np.random.default_rng(1).normal(size=rows.shape) * ([0.02] * 3 + [0.5] * 3)
    ),
    "gyros in deg/s": lambda rows: rows * ([1.0 / DEG] * 3 + [1.0] * 3),
    "accelerometers in g": lambda rows: rows * ([1.0] * 3 + [1.0 / 9.80665] * 3),
    "gyros x and y swapped": lambda rows: rows[:, [1, 0, 2, 3, 4, 5]],
    "accelerometers x and y swapped": lambda rows: rows[:, [0, 1, 2, 4, 3, 5]],
    "gyro x +0.01 rad/s": lambda rows: rows + np.eye(6)[0] * 0.01,
    "accelerometer x +50 mg": lambda rows: rows + np.eye(6)[3] * 0.49,
    "gyro z +100 deg/h": lambda rows: rows + np.eye(6)[2] * 100.0 * DEG / 3600.0,
}


def two(options: Options) -> dict[str, Any]:
    """One of two tactical units fails; the sound one is the second."""
    return failing(options, ("a", "b"))


def one(options: Options) -> dict[str, Any]:
    """The only unit fails, with a dead-reckoning lane beside it, which is what counts as sound."""
    return failing(options, ("imu",))


def clean(options: Options) -> dict[str, Any]:
    """Nothing fails: how often another lane is taken, and what that costs."""
    table = Table("units>5d seed>4d switches>8d worst_m>8.2f first_m>8.2f nees>8.2f first_nees>10.2f")
    for units in (("a", "b"), ("imu",)):
        for seed in seeds_of(options):
            vehicle, mission = mission_of(seed, units, options.mems)
            track, first = nf.replay(vehicle, mission), alone(vehicle, mission, units[0])
            table.add(
                {
                    "units": len(units),
                    "seed": seed,
                    "switches": len(track.lanes) - 1,
                    "worst_m": worst(track, mission),
                    "first_m": worst(first, mission),
                    "nees": nees(track, mission),
                    "first_nees": nees(first, mission),
                }
            )
    return {"rows": table.rows}


def velocity(options: Options) -> dict[str, Any]:
    """The DVL fails for a minute, or the compass, beside one sound unit: dead reckoning, which follows them, must not
    take over.
    """
    table = Table("fault<24 seed>4d taken<16 worst_m>8.2f unit_m>8.2f")
    for seed in seeds_of(options):
        vehicle, mission = mission_of(seed, ("imu",), options.mems)
        for kind, (name, change) in SENSORS.items():
            stream = mission.streams[name]
            on, value = (stream.time_s >= FAULT_S) & (stream.time_s < FAULT_S + 60.0), stream.value.copy()
            value[on] = change(stream.time_s[on] - FAULT_S, value[on], stream.value[np.flatnonzero(on) - LATE])
            damaged = mission.with_stream(name, Stream(stream.time_s, value, stream.columns))
            track = nf.replay(vehicle, damaged)
            taken = ", ".join(f"{time_s:.2f}" for time_s, lane in track.lanes if lane == "dead-reckoning")
            unit_m = worst(alone(vehicle, damaged, "imu"), mission)
            table.add({"fault": kind, "seed": seed, "taken": taken, "worst_m": worst(track, mission), "unit_m": unit_m})
    return {"rows": table.rows}


def cost(options: Options) -> dict[str, Any]:
    """Processor time of a replay with lanes over that of the first unit alone; the least of several, in turn."""
    table = Table("lanes>5d first_s>8.2f lanes_s>8.2f ratio>6.2f each>6.2f")
    for units in (("imu",), ("a", "b")):
        vehicle, mission = mission_of(2, units)
        runs: dict[str, list[float]] = {"first": [], "lanes": []}
        for _ in range(1 if options.quick else options.repeats):
            for name, run in (
                ("first", lambda: alone(vehicle, mission, units[0])),  # noqa: B023 - called at once
                ("lanes", lambda: nf.replay(vehicle, mission)),  # noqa: B023
            ):
                began = time.process_time()
                run()
                runs[name].append(time.process_time() - began)
        first_s, lanes_s, count = min(runs["first"]), min(runs["lanes"]), len(vehicle.lanes())
        ratio = lanes_s / first_s
        table.add({"lanes": count, "first_s": first_s, "lanes_s": lanes_s, "ratio": ratio, "each": ratio / count})
    return {"rows": table.rows}


def failing(options: Options, units: tuple[str, ...]) -> dict[str, Any]:
    """One row a fault, the worst of all seeds."""
    table = Table("fault<32 lasts_s>8.0f worst_m>8.2f sound_m>8.2f alone_m>10.1f after_s>8.2f nees>8.2f verdict<8")
    runs = [(*mission_of(seed, units, options.mems), seed) for seed in seeds_of(options)]
    sounds = [alone(vehicle, mission, list(vehicle.lanes())[1]) for vehicle, mission, _ in runs]
    for kind, change in KINDS.items():
        for lasts_s in (SHORT_S, math.inf):
            rows = []
            for (vehicle, mission, _), sound in zip(runs, sounds, strict=True):
                damaged = broken(mission, units[0], change, lasts_s)
                track = nf.replay(vehicle, damaged)
                left = [time_s - FAULT_S for time_s, name in track.lanes if name != units[0] and time_s >= FAULT_S]
                rows.append(
                    {
                        "worst_m": worst(track, mission),
                        "sound_m": worst(sound, mission),
                        "alone_m": worst(alone(vehicle, damaged, units[0]), mission),
                        "after_s": left[0] if left else math.nan,
                        "nees": nees(track, mission),
                    }
                )
            share = max(row["worst_m"] / row["sound_m"] for row in rows)
            worst_row = max(rows, key=lambda row: row["worst_m"] / row["sound_m"])
            good = share <= 1.5 if len(units) > 1 else worst_row["worst_m"] <= max(30.0, 3.0 * worst_row["sound_m"])
            table.add({"fault": kind, "lasts_s": lasts_s, **worst_row, "verdict": "ok" if good else "far off"})
    return {"rows": table.rows, "seeds": [seed for *_, seed in runs]}


def seeds_of(options: Options) -> list[int]:
    """As many as were asked for."""
    return [1] if options.quick else list(range(options.first_seed, options.first_seed + options.seeds))


def mission_of(seed: int, units: tuple[str, ...], mems: bool = False) -> tuple[nf.Vehicle, Mission]:
    """The survey, by a vehicle with these units and a dead-reckoning lane."""
    plain = survey_vehicle(mems=mems)
    described = plain.with_error(
        compass=plain.sensors["compass"].error + nf.White(sd=0.1 * DEG),
        gps=plain.sensors["gps"].error + nf.White(sd=0.5),
    )
    drives = {"imu": described.drive} if len(units) == 1 else {"imus": dict.fromkeys(units, described.drive)}
    vehicle = nf.Vehicle(**drives, sensors=dict(described.sensors), dead_reckoning_lane=True)
    fixes = {"gps": Faults(available=((0.0, DIVE_S), (BACK_S, 1e9)))}
    motion = survey(END_S, surface_s=110.0)
    return vehicle, simulate(vehicle, motion, seed=seed, duration_s=END_S, faults=fixes)


def broken(mission: Mission, unit: str, change: Callable[[np.ndarray], np.ndarray] | None, lasts_s: float) -> Mission:
    """The mission with a fault of one unit."""
    stream = mission.streams[unit]
    on = (stream.time_s >= FAULT_S) & (stream.time_s < FAULT_S + lasts_s)
    if change is None:
        return mission.with_stream(unit, stream.keep(~on))
    value = stream.value.copy()
    value[on] = change(value[on])
    return mission.with_stream(unit, Stream(stream.time_s, value, stream.columns))


def alone(vehicle: nf.Vehicle, mission: Mission, lane: str) -> Track:
    """One lane as the only one; that without a unit by a vehicle whose unit never spoke."""
    if lane not in vehicle.units:
        silent = mission.with_stream("imu", mission.streams["imu"].keep(slice(0, 1)))
        return nf.replay(vehicle, silent)
    single = nf.Vehicle(imu=vehicle.units[lane], sensors=dict(vehicle.sensors))
    return nf.replay(single, mission.with_stream("imu", mission.streams[lane]))


def worst(track: Track, mission: Mission) -> float:
    """Greatest distance from the truth in the dive [m]."""
    dive = (track.time_s > DIVE_S) & (track.time_s < BACK_S)
    return float(track.errors(mission.truth).horizontal[dive].max())


def nees(track: Track, mission: Mission) -> float:
    """Of the horizontal position in the dive, per component."""
    dive = np.flatnonzero((track.time_s > DIVE_S) & (track.time_s < BACK_S))
    error, P = track.errors(mission.truth).position_n[dive, :2], track.covariance[dive, :2, :2]
    return float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error).mean() / 2.0)


if __name__ == "__main__":
    flags = [
        flag("--seeds", type=int, default=3),
        flag("--first-seed", type=int, default=1),
        flag("--mems", action="store_true", help="micromechanical units"),
        quick("one seed"),
    ]
    repeats = [flag("--repeats", type=int, default=3), quick("one run of each")]
    main(__doc__, {two: flags, one: flags, clean: flags, velocity: flags, cost: repeats})

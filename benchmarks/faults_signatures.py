"""Every signature of the bank of faults, put into a dive: whether its name is alive, and whether what is said holds."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import faults_run as watched
import numpy as np
from faults_outcomes import BACK_S, END_S, FAULT_S, mission_of
from feeding import events_of, one_by_one
from harness import Array, Options, Table

import navfilter as nf
from navfilter.faults import fault_bank
from navfilter.kernels import fault_bank as kernel
from navfilter.models.mission import Mission, Stream
from navfilter.models.state import matrix_from_euler
from navfilter.navigation.navigator import Navigator

#: Sizes, in sd of what the bank expects; a hypothesis is alive with this probability; a ramp grows for so long [s].
SIZES, ALIVE, GROWS_S = (0.1, 0.3, 1.0), 1e-3, 100.0
#: Looked at so often [s]; scored from so long after fixes are back [s].
EVERY_S, SETTLED_S = 10.0, 120.0
KINDS = ("step", "ramp", "bottom", "bottom that moves ever faster", "step", "drift", "described", "scale")
PLACES = ("arm x", "arm y", "arm z", "clock", "mounting x", "mounting y", "mounting z")


class Signature(NamedTuple):
    """One of the table: of which sensor, the unit ("") or the start; its rows of the table."""

    name: str
    words: str
    rows: Array
    from_start: bool


def signatures_of(vehicle: nf.Vehicle, start: nf.Start) -> list[Signature]:
    """All that the bank of a vehicle has."""
    nav = Navigator(vehicle, start, threads=False)
    table, begun = fault_bank.parts(nav.filter.bank)[1], int(nav.filter.bank[kernel.SIGNATURES])
    names, found = list(nav.filter.channels), []
    for k, row in enumerate(table):
        if row[kernel.TOGETHER]:
            kind, channel, place = row[[kernel.KIND, kernel.CHANNEL, kernel.PLACE]].astype(int).tolist()
            name = names[channel] if channel >= 0 else "start" if k >= begun else "unit"
            axis = PLACES[place] if kind == kernel.DESCRIBED else f"{KINDS[kind]} {place}"
            found.append(Signature(name, axis, table[k : k + int(row[kernel.TOGETHER])], k >= begun))
    return found


def broken(signature: Signature, size: float, mission: Mission, nav: Navigator, seed: int) -> Mission:
    """The mission with it, of a size in sd, in a random direction where it has several components."""
    assert mission.start is not None and mission.truth is not None
    r, rows, truth = np.random.default_rng([seed, 7]), signature.rows, mission.truth
    way = r.normal(size=len(rows))
    sizes = size * np.sqrt(rows[:, kernel.VARIANCE]) * way / np.linalg.norm(way)
    kinds, places = rows[:, [kernel.KIND, kernel.PLACE]].astype(int).T
    if signature.name == "start":
        roll, pitch, heading = (math.degrees(s) for s in sizes)
        start = mission.start
        told = replace(start, roll_deg=start.roll_deg + roll, pitch_deg=start.pitch_deg + pitch)
        return mission.with_start(replace(told, heading_deg=start.heading_deg + heading))
    name = "imu" if signature.name == "unit" else signature.name
    stream = mission.streams[name]
    value, age_s = stream.value.copy(), stream.time_s - FAULT_S
    on, grown = (age_s >= 0.0).astype(float), np.clip(age_s / GROWS_S, 0.0, 1.0)
    times = stream.time_s[:1] if name == "imu" else np.minimum(stream.time_s, truth.time_s[-1])
    C = np.array([watched.truth_at(truth, t).C_nb for t in times.tolist()])
    for kind, place, s in zip(kinds, places, sizes, strict=True):
        by = grown if kind in fault_bank.GROWING else on
        if kind in (kernel.STEP, kernel.RAMP):
            value[:, place] += s * by
        elif kind == kernel.STATE and place < 9:  # a shock of one sample, which steps the velocity
            k = int(np.argmax(on))
            value[k, 3:6] += s * watched.truth_at(truth, FAULT_S).C_nb[place - 3] / np.diff(stream.time_s)[k]
        elif kind in (kernel.STATE, kernel.DRIFT):
            drive = nav.filter.layout.drive
            axis = next(i for i, at in enumerate(drive.biases) if place - drive.start in at)
            value[:, axis] += s * by
        elif kind == kernel.SCALE:
            value *= 1.0 + s * by[:, None]
        elif kind in (kernel.FLOW_STEP, kernel.FLOW_RAMP):
            value -= s * by[:, None] * C[:, place]
        elif place > 3:
            value = value @ matrix_from_euler(*(s * np.eye(3)[place - 4]))
        elif place == 3:
            return mission.with_stream(name, Stream(stream.time_s + s, value, stream.columns))
        else:
            rate = np.gradient(C, stream.time_s, axis=0)  # C_nb [w x] r
            value += s * np.einsum("kji,kj->ki", C, rate[:, :, place])
    return mission.with_stream(name, Stream(stream.time_s, value, stream.columns))


def alive(nav: Navigator) -> Counter[str]:
    """Probability that each sensor, the unit or the start errs by what the bank knows, beside none of it."""
    bank, names, odds = nav.filter.bank, list(nav.filter.channels), Counter[str]()
    begun = int(bank[kernel.SIGNATURES])
    table = fault_bank.parts(bank)[1]
    for window, k in fault_bank.hypotheses(bank):
        of, out = int(table[k, kernel.CHANNEL]), np.zeros(5)
        kernel.judged(bank, window, k, nav.time_s, out)
        name = names[of] if of >= 0 else "start" if k >= begun else "unit"
        odds[name] += math.exp(min(out[0], 50.0))
    total = 1.0 + sum(odds.values())
    return Counter({name: value / total for name, value in odds.items()})


def said(nav: Navigator) -> set[str]:
    """What is said to err: sensors, the unit, the start."""
    health = nav.health
    told = ("jumped", "noisy", "stuck", "rejected", "astray")
    found = {name for name, s in health.sensors.items() if s.condition in told}
    found |= {"unit"} if health.drive["shifted"] or any(c != "good" for c in health.axes.values()) else set()
    found |= {"start"} if health.drive["realigned"] or health.drive["reset"] else set()
    return found | ({"dvl"} if health.drive["arm-or-clock"] else set())


def run(signature: Signature, size: float, which: str, seed: int) -> dict[str, Any]:
    """The row of one."""
    vehicle, mission = mission_of(seed, which)
    assert mission.start is not None and mission.truth is not None
    wrong = broken(signature, size, mission, Navigator(vehicle, mission.start, threads=False), seed)
    assert wrong.start is not None
    nav, due, weight, named, rows = Navigator(vehicle, wrong.start, threads=False), 0.0, 0.0, set[str](), []
    events = [e for e in events_of(vehicle, wrong) if e.true_s >= wrong.start.time_s - 1e-9]
    for event in events:
        if event.true_s >= due:
            due = event.true_s + EVERY_S
            state, begun = nav.state, 0.0 if signature.from_start else FAULT_S
            if begun < state.time_s < END_S:
                named |= said(nav)
                weight = max(weight, alive(nav)[signature.name])
            off = state.minus(watched.truth_at(mission.truth, min(state.time_s, mission.truth.time_s[-1])))
            assert state.bounds is not None and state.covariance is not None
            parts = [(off[p], state.covariance[p, p]) for p in (slice(0, 3), slice(3, 6), slice(6, 9))]
            nees = max(float(e @ np.linalg.solve(P, e)) / 3.0 for e, P in parts)
            rows.append((state.time_s, math.hypot(*off[:2]), math.hypot(*off[:2]) <= state.bounds.horizontal_m, nees))
        one_by_one(nav, [event])
    table = np.array(rows, dtype=np.float64)
    dived, after = (table[:, 0] > FAULT_S) & (table[:, 0] < BACK_S), table[:, 0] > BACK_S + SETTLED_S
    right = signature.name in named or weight > ALIVE
    return {
        "of": signature.name,
        "signature": signature.words,
        "size": size,
        "seed": seed,
        "named": ", ".join(sorted(named)),
        "weight": weight,
        "right": right,
        "worst_m": float(table[dived, 1].max()),
        "held": 100.0 * float(table[dived, 2].mean()),
        "nees": float(table[after, 3].mean()),
    }


def signatures(options: Options) -> list[dict[str, Any]]:
    """Every signature of the bank of faults in three sizes: whether its name is alive, and whether what is said holds.

    The survey of `outcomes`; each signature from 250 s on (of descriptions: from the start), of 0.1, 0.3 and 1 times
    the sd that the bank expects. right: it was named, or had a probability of a thousandth at least; weight: the
    largest that it had. Then worst_m, held, nees as of `outcomes`.
    """
    table = Table("of<10 signature<32 size>5.1f seed>4d right>5d weight>8.2g worst_m>8.1f held>7.2f nees>8.1f named<40")
    nf.warm_up()
    for seed in [1] if options.quick else range(1, options.seeds + 1):
        vehicle, mission = mission_of(seed, options.vehicle)
        assert mission.start is not None
        for signature in signatures_of(vehicle, mission.start):
            for size in SIZES:
                if options.only in f"{signature.name} {signature.words}":
                    table.add(run(signature, size, options.vehicle, seed))
    right = [row["right"] for row in table.rows]
    print(f"right in {sum(right)} of {len(right)} ({100.0 * np.mean(right):.1f} %)")
    return table.rows

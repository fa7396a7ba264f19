"""Snapshots that are whole, and wrong in single values or shapes, for `fuzz.py`.

Damaged bytes of a snapshot meet the checksums of its archive, sealed again or not. So an input here is a list of edits
of what a snapshot holds: ``floats[7] = nan``, ``leaf[12] = "x"`` (the leaves of its description, in order; shapes are
among them). Indices are taken modulo the number there are, so that nearly every input reaches the checks of values.
"""

from __future__ import annotations

import io
import json
import re
import sys
from typing import Any

import numpy as np
from fuzz_targets import Refused, Target, refusing, seal
from harness import ROOT

sys.path.insert(0, str(ROOT / "tests"))
from feeding import DRIVE, events_of, one_by_one

import navfilter as nf
from navfilter.simulation.scenarios import simulate_scenario

EDIT = re.compile(rb"^(floats|integers|leaf)\[(-?\d{1,18})\] = (.{1,4000})$")
#: Mission time of the snapshots [s]: with models learnt, and inputs of the beginning kept.
UNTIL_S, WRONG_FROM_S, AFTER_S = 36.0, 33.0, 38.0


def runs() -> list[tuple[nf.Vehicle, bytes, list[Any]]]:
    """Vehicles, a snapshot of each while readings contradict it, and what comes after."""
    made = []
    for scenario in ("lawnmower", "reckoning"):
        vehicle, mission = simulate_scenario(scenario, 1, AFTER_S)
        compass = "compass" if "compass" in vehicle.sensors else None
        if compass is not None:
            vehicle = vehicle.with_error(compass=nf.LearnedArma(prior=vehicle.sensors[compass].error, window=400))
        events = events_of(vehicle, mission)
        fixes = [name for name, sensor in vehicle.sensors.items() if sensor.observes.corrects == "position"]
        # fixes that agree with each other against the state: the memory of refused readings is not empty
        events = [
            e._replace(value=(e.value[0] + 3e-5, *e.value[1:])) if e.sensor in fixes and e.time_s > WRONG_FROM_S else e
            for e in events
        ]
        # and depths that scatter by more than described: what is kept of that is not empty
        rng = np.random.default_rng(1)
        events = [e._replace(value=(e.value[0] + rng.normal(),)) if e.sensor == "depth" else e for e in events]
        nav = nf.Navigator(vehicle, mission.start, threads=False)
        one_by_one(nav, [e for e in events if e.time_s <= UNTIL_S])
        made.append((vehicle, nav.snapshot(), [e for e in events if e.time_s > UNTIL_S]))
    return made


def leaves(value: Any) -> list[tuple[Any, Any]]:
    """Every plain value inside a description, as what holds it and its key there."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    found = []
    for key, item in items:
        found += leaves(item) if isinstance(item, dict | list) and item else [(value, key)]
    return found


def edited(payload: bytes, edits: bytes) -> bytes:
    """The archive of a snapshot with edits made."""
    with np.load(io.BytesIO(payload)) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    meta = json.loads(arrays["meta"].tobytes())
    places = leaves(meta)
    done = 0
    for line in edits.split(b"\n"):
        found = EDIT.match(line)
        if not found:
            continue
        kind, at = found[1].decode(), int(found[2])
        try:
            value = json.loads(found[3].replace(b"nan", b"NaN").replace(b"inf", b"Infinity"))
            if kind == "leaf":
                owner, key = places[at % len(places)]
                owner[key] = value
            else:
                arrays[kind][at % len(arrays[kind])] = value
        except (ValueError, TypeError, OverflowError, RecursionError, ZeroDivisionError):
            continue
        done += 1
    if not done:
        raise Refused
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def edited_target() -> Target:
    """Snapshots with single values and shapes exchanged, sealed: refused, or a run that goes on."""
    kept = runs()

    def run(data: bytes) -> None:
        vehicle, whole, after = kept[data[0] % len(kept) if data else 0]
        payload = edited(whole.split(b"\n", 2)[2], data[1:])
        nav = refusing((ValueError,), lambda: nf.Navigator.restore(vehicle, seal(whole, payload)))
        for event in after[:60]:
            if event.sensor == DRIVE:
                nav.step(event.time_s, event.value[:3], event.value[3:])
            else:
                nav.correct(event.sensor, event.time_s, event.value)
        _ = nav.state, nav.errors
        nav.snapshot()

    examples = []
    for k, (_, whole, _) in enumerate(kept):
        with np.load(io.BytesIO(whole.split(b"\n", 2)[2])) as archive:
            arrays = {name: archive[name] for name in archive.files}
        places = leaves(json.loads(arrays["meta"].tobytes()))
        for n in range(60):
            at = (n * 7919) % len(places)
            owner, key = places[at]
            lines = [f"leaf[{at}] = {json.dumps(owner[key])}"]
            for name in ("floats", "integers"):
                at = (n * 7919) % max(len(arrays[name]), 1)
                lines += [f"{name}[{at}] = {json.dumps(arrays[name][at].item())}"] if len(arrays[name]) else []
            examples.append(bytes([k]) + "\n".join(lines).encode())
    return Target("snapshots, edited", examples, run, 0.002)

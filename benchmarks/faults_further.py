"""Faults that nothing in the filter was written for, in the survey of `faults_outcomes`.

Two at once, clocks of single sensors, instruments that are mounted otherwise from an instant on, fixes that come up
wrong, a bottom that moves (fish, or a plume), units and signs that change on the way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import faults_library as library
import numpy as np
from faults_outcomes import BACK_S, FAULT_S, MINUTE_S, Case, G, flowing, north, table_of, turned, values
from feeding import DRIVE, Events
from harness import DEG, Options

__all__ = ["FURTHER", "further"]

END_S = FAULT_S + MINUTE_S


def both(*cases: Case) -> Case:
    """One fault after the other."""

    def altered(events: Events, scene: library.Scene) -> Events:
        for case in cases:
            events = case.events(events, scene)
        return events

    return Case(events=altered, begin_s=min(case.begin_s for case in cases))


def clock(role: str, by_s: float) -> Case:
    """Another clock of one sensor."""

    def altered(events: Events, scene: library.Scene) -> Events:
        name = scene.name(role)
        if name == DRIVE:
            return events
        return [e._replace(time_s=e.time_s + by_s) if e.sensor == name and e.true_s >= FAULT_S else e for e in events]

    return Case(events=altered)


def lags(role: str, by_s: float) -> Case:
    """An instrument that shows what was, with the stamps of now."""

    def altered(events: Events, scene: library.Scene) -> Events:
        name, past, result = scene.name(role), [], []
        for e in events:
            if e.sensor == name and name != DRIVE:
                past.append(e)
                while len(past) > 1 and past[1].true_s <= e.true_s - by_s + 1e-9:
                    past.pop(0)
                e = e._replace(value=past[0].value) if e.true_s >= FAULT_S else e
            result.append(e)
        return result

    return Case(events=altered)


def silent(role: str, begin_s: float, end_s: float = math.inf) -> Case:
    """Nothing from one sensor."""

    def altered(events: Events, scene: library.Scene) -> Events:
        name = scene.name(role)
        return [e for e in events if name == DRIVE or e.sensor != name or not begin_s <= e.true_s < end_s]

    return Case(events=altered, begin_s=begin_s)


def gaps(begins_s: Iterable[float], seconds: float) -> Case:
    """A drive that is silent again and again."""
    begins = list(begins_s)

    def altered(events: Events, scene: library.Scene) -> Events:
        return [e for e in events if e.sensor != DRIVE or not any(t <= e.true_s < t + seconds for t in begins)]

    return Case(events=altered)


def held(role: str, begin_s: float, end_s: float = math.inf) -> Case:
    """A reading that stays what it was."""

    def altered(events: Events, scene: library.Scene) -> Events:
        first: list[Any] = []

        def same(value: Any, age_s: float) -> Any:
            first.append(value.copy())
            return first[0]

        return values(role, same, begin_s, end_s).events(events, scene)

    return Case(events=altered, begin_s=begin_s)


def mounted(role: str, axes: np.ndarray) -> Case:
    """Other axes of an instrument from now on."""
    return values(role, lambda v, age_s: axes @ v if len(v) == 3 else v)


def about(axis: int, angle_rad: float) -> np.ndarray:
    """Axes that are turned about one of them."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    i, j = [k for k in range(3) if k != axis]
    turn = np.eye(3)
    turn[[i, j], [i, j]], turn[i, j], turn[j, i] = c, s, -s
    return turn


EXCHANGED = np.eye(3)[[1, 0, 2]]
FURTHER: dict[str, Case] = {
    "no fault": Case(),
    "compass in rad for deg, a minute": values("heading", lambda v, age_s: v * DEG, end_s=END_S),
    "compass in rad for deg, for good": values("heading", lambda v, age_s: v * DEG),
    "compass with the sign changed for good": values("heading", lambda v, age_s: -v),
    "compass in steps of 5 deg": values("heading", lambda v, age_s: np.round(v / (5.0 * DEG)) * 5.0 * DEG),
    "DVL x and y exchanged for good": mounted("velocity", EXCHANGED),
    "DVL upside down for good": mounted("velocity", np.diag([1.0, -1.0, -1.0])),
    "DVL turned by 45 deg for good": mounted("velocity", about(2, 45.0 * DEG)),
    "DVL turned by 10 deg for good": mounted("velocity", about(2, 10.0 * DEG)),
    "unit turned by 90 deg about z for good": both(
        mounted("gyro", about(2, math.pi / 2)), mounted("accel", about(2, math.pi / 2))
    ),
    "DVL silent, compass 25 deg off, a minute": both(
        silent("velocity", FAULT_S, END_S), values("heading", turned(25.0 * DEG), end_s=END_S)
    ),
    "DVL and compass stuck, a minute": both(held("velocity", FAULT_S, END_S), held("heading", FAULT_S, END_S)),
    "DVL with the sign changed, compass turned by 180 deg": both(
        values("velocity", lambda v, age_s: -v), values("heading", turned(math.pi))
    ),
    "DVL +5 %, compass 4 deg off for good": both(
        values("velocity", lambda v, age_s: 1.05 * v), values("heading", turned(4.0 * DEG))
    ),
    "gyro z dead, compass silent, a minute": both(
        values("gyro", lambda v, age_s: v * [1.0, 1.0, 0.0], end_s=END_S), silent("heading", FAULT_S, END_S)
    ),
    "compass silent from 200 s on": silent("heading", 200.0),
    "depth stuck from the dive on": held("depth", 100.0),
    "depth drifts by 0.05 m/s": values("depth", lambda v, age_s: v + 0.05 * age_s),
    "fixes 500 m off on surfacing, 30 s": values("position", north(lambda age_s: 500.0), BACK_S, BACK_S + 30.0),
    "the first fix on surfacing 500 m off": values("position", north(lambda age_s: 500.0), BACK_S, BACK_S + 0.5),
    "fixes of the old place on surfacing, 20 s": held("position", BACK_S - 0.5, BACK_S + 20.0),
    "clock of the DVL +1 s for good": clock("velocity", 1.0),
    "clock of the DVL -1 s for good": clock("velocity", -1.0),
    "clock of the compass +1 s for good": clock("heading", 1.0),
    "clock of the compass -1 s for good": clock("heading", -1.0),
    "compass lags by 1 s": lags("heading", 1.0),
    "DVL lags by 1 s": lags("velocity", 1.0),
    "drive silent for 5 s every 20 s": gaps(np.arange(FAULT_S, END_S, 20.0), 5.0),
    "gyros saturate at 1 deg/s": values("gyro", lambda v, age_s: np.clip(v, -DEG, DEG)),
    "fish below at 1 m/s, 5 s": flowing("velocity", lambda age_s: 1.0 if age_s < 5.0 else 0.0),
    "fish below at 0.5 m/s, 20 s": flowing("velocity", lambda age_s: 0.5 if age_s < 20.0 else 0.0),
    "bottom that begins to move by 0.02 m/s^2": flowing(
        "velocity", lambda age_s: min(0.02 * age_s, 1.0) if age_s < 120.0 else 0.0
    ),
    "bottom that moves by 0.36 m/s for good": flowing("velocity", lambda age_s: 0.36),
    "bottom that gets to 0.36 m/s by 0.001 m/s^2": flowing("velocity", lambda age_s: min(0.001 * age_s, 0.36)),
    "compass that runs away by 0.05 deg/s": values("heading", lambda v, age_s: turned(0.05 * DEG * age_s)(v, age_s)),
    "compass that runs away by 0.5 deg/s to 20 deg": values(
        "heading", lambda v, age_s: turned(min(0.5 * age_s, 20.0) * DEG)(v, age_s)
    ),
    "gyro z saturates softly": values("gyro", lambda v, age_s: np.array([v[0], v[1], 0.03 * np.tanh(v[2] / 0.03)])),
    "accelerometer x drifts by 0.5 mg/s": values(
        "accel", lambda v, age_s: v + G * 1e-3 * min(0.5 * age_s, 50.0) * np.eye(3)[0]
    ),
    "gyro z drifts by 2 deg/h/s": values(
        "gyro", lambda v, age_s: v + DEG / 3600.0 * min(2.0 * age_s, 200.0) * np.eye(3)[2]
    ),
    "depth in feet for good": values("depth", lambda v, age_s: v / 0.3048),
}


def further(options: Options) -> list[dict[str, Any]]:
    """Faults that nothing was written for: two at once, clocks of single sensors, other mountings, a bottom that moves.

    Columns as of `outcomes`.
    """
    return table_of(FURTHER, options)

"""The readings of a mission as events in their order, and ways to hand them to a navigator as a driver would."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from navfilter.models.mission import Mission
from navfilter.models.state import NavState
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.navigator import Navigator
from navfilter.playback.replay import drive_samples

DRIVE = "drive"


class Event(NamedTuple):
    """One reading on its way. `value` is a tuple of floats, unless a fault made something else of it."""

    sensor: str
    time_s: Any
    value: Any
    true_s: float
    arrival_s: float


Events = list[Event]


def events_of(vehicle: Vehicle, mission: Mission) -> Events:
    """All readings of a mission by time; a sample of the drive goes before what was read at the same instant."""
    times, values = drive_samples(vehicle, mission)
    events = [Event(DRIVE, t, tuple(v), t, t) for t, v in zip(times.tolist(), values.tolist(), strict=True)]
    for name in (name for name, sensor in vehicle.sensors.items() if not sensor.from_drive):
        stream = mission.streams[name]
        events += [
            Event(name, t, tuple(v), t, t) for t, v in zip(stream.time_s.tolist(), stream.value.tolist(), strict=True)
        ]
    events.sort(key=lambda e: (round(e.true_s, 9), e.sensor != DRIVE))
    return events


def delayed(events: Events, sensors: Iterable[str], most_s: float, seed: int, share: float = 1.0) -> Events:
    """The events by arrival when (a share of) the readings of these sensors come up to so much too late."""
    rng, names = np.random.default_rng(seed), set(sensors)

    def arrival_s(event: Event) -> float:
        comes_late = event.sensor in names and (share >= 1.0 or rng.random() < share)
        return event.time_s + rng.uniform(0.0, most_s) if comes_late else event.time_s

    late = [e._replace(arrival_s=arrival_s(e)) for e in events]
    return sorted(late, key=lambda e: e.arrival_s)


def one_by_one(nav: Navigator, events: Iterable[Event]) -> list[Any]:
    """Every sample of the drive by itself; returns the outcomes of the readings."""
    outcomes = []
    for event in events:
        if event.sensor == DRIVE:
            nav.step(event.time_s, event.value[:3], event.value[3:])
        else:
            outcomes.append(nav.correct(event.sensor, event.time_s, event.value))
    return outcomes


def once_a_second(
    nav: Navigator, vehicle: Vehicle, mission: Mission, until_s: float = math.inf, after_s: float = -math.inf
) -> Iterator[NavState]:
    """The states of a run over a mission, or over a part of it, once a second."""
    due = 0.0
    for event in events_of(vehicle, mission):
        if not after_s < event.time_s <= until_s:
            continue
        one_by_one(nav, [event])
        if event.time_s >= due:
            due = event.time_s + 1.0
            yield nav.state


def in_blocks(nav: Navigator, events: Iterable[Event], rng: np.random.Generator, longest: int = 12) -> None:
    """Samples of the drive in blocks of random length, cut at every reading."""
    for is_drive, group in itertools.groupby(events, key=lambda e: e.sensor == DRIVE):
        if not is_drive:
            one_by_one(nav, group)
            continue
        block = np.array([(e.time_s, *e.value) for e in group])
        while len(block):
            part, block = np.split(block, [int(rng.integers(1, longest + 1))])
            nav.step(part[:, 0], part[:, 1:4], part[:, 4:])


def fed(nav: Navigator, events: Iterable[Event]) -> np.ndarray:
    """As `one_by_one`; returns the navigation state after each reading."""
    rows = []
    for event in events:
        if event.sensor == DRIVE:
            nav.step(event.time_s, event.value[:3], event.value[3:])
        else:
            nav.correct(event.sensor, event.time_s, event.value)
            rows.append(nav.filter.nav.copy())
    return np.array(rows)

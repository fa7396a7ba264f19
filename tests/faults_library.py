"""Faults as pure functions on what arrives: a list of events goes in, another one comes out.

An `Event` (see `feeding`) is one reading on its way to the navigator, with the time it was measured (`true_s`), the
stamp it carries (`time_s`) and when it is delivered (`arrival_s`); the list is in the order of delivery. A fault
changes stamps, values, order or presence inside a window of time and nothing else. `KINDS` are all kinds by name, and
`damaged` applies one. Runs of them: `faults_run`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from feeding import DRIVE, Event, Events

from navfilter.models.mission import Stream
from navfilter.models.sensors import (
    Attitude,
    BodyVelocity,
    Course,
    Depth,
    DvlBeams,
    Heading,
    Odometer,
    Position,
    Range,
    WaterVelocity,
)
from navfilter.models.vehicle import Vehicle

DEG = math.pi / 180.0


class Target(NamedTuple):
    """Where the readings of one kind of sensor stand: name of the event's sensor, and columns of its value."""

    sensor: str
    columns: tuple[int, ...]


@dataclass(frozen=True)
class Scene:
    """What the faults of a mission need to know.

    Attributes
    ----------
    targets : dict of str to Target
        By role: "heading", "velocity", "depth", "position", "gyro", "accel", "tilt".
    window : (float, float)
        When faults of most sensors act, s.
    fixes : (float, float)
        When faults of the position fixes act (there must be some), s.
    period_s : float
        Of the drive.
    along : ndarray, shape (n, 3)
        Directions of the components of the velocity in its instrument's axes: those, its beams, or forward.
    truth : Stream or None
        Where it is known: attitudes by which what happens in n is read in b.
    """

    targets: dict[str, Target]
    window: tuple[float, float]
    fixes: tuple[float, float]
    period_s: float
    along: np.ndarray = field(default_factory=lambda: np.eye(3))
    truth: Stream | None = None

    def when(self, role: str) -> tuple[float, float]:
        """The window in which faults of a role act."""
        return self.fixes if role == "position" else self.window

    def name(self, role: str) -> str:
        """The event's sensor of a role."""
        return self.targets[role].sensor if role in self.targets else role


def scene_of(vehicle: Vehicle, window: tuple[float, float], fixes: tuple[float, float]) -> Scene:
    """The scene of a vehicle: which of its sensors plays which role."""
    inertial = "imu" in vehicle.drive.streams
    targets = {"gyro": Target(DRIVE, (0, 1, 2)), "accel": Target(DRIVE, (3, 4, 5))}
    if not inertial:
        targets = {"tilt": Target(DRIVE, (0, 1)), "heading": Target(DRIVE, (2,)), "velocity": Target(DRIVE, (3, 4, 5))}
    roles = {Heading: "heading", BodyVelocity: "velocity", Depth: "depth", Position: "position"}
    for name, sensor in vehicle.sensors.items():
        if isinstance(sensor, Attitude):
            targets |= {"tilt": Target(name, (0, 1)), "heading": Target(name, (2,))}
        role = next((role for kind, role in roles.items() if isinstance(sensor, kind)), None)
        others = {WaterVelocity: "water", Range: "range", Course: "course"}
        also = [role for kind, role in others.items() if isinstance(sensor, kind)]
        also += ["field"] * (isinstance(sensor, Heading) and sensor.magnetometer)
        for part in filter(None, (role, *also)):
            targets[part] = Target(name, tuple(range(sensor.reads)))
    beams = [sensor.beams()[: sensor.reads] for sensor in vehicle.sensors.values() if isinstance(sensor, DvlBeams)]
    beams += [np.eye(3)[:1] for sensor in vehicle.sensors.values() if isinstance(sensor, Odometer)]
    return Scene(targets, window, fixes, vehicle.drive.period_s, *beams[:1])


# --- what faults are made of ----------------------------------------------------------------------------------------


def _inside(event: Event, window: tuple[float, float]) -> bool:
    return window[0] <= event.true_s < window[1]


def _delivered(events: Iterable[Event]) -> Events:
    return sorted(events, key=lambda e: e.arrival_s)


def changed(
    events: Events,
    scene: Scene,
    role: str,
    change: Callable[[np.ndarray], Any],
    *,
    share: float = 1.0,
    rng: Any = None,
    first_s: float = 1e9,
) -> Events:
    """Other values of one role inside its window: all of them, or a random share, for at most the first seconds."""
    if role not in scene.targets:
        return events
    name, columns = scene.targets[role]
    begin, end = scene.when(role)
    window, at, result = (begin, min(end, begin + first_s)), list(columns), []
    for event in events:
        if event.sensor == name and _inside(event, window) and (share >= 1.0 or rng.random() < share):
            value = np.array(event.value)
            value[at] = change(value[at])
            event = event._replace(value=tuple(value.tolist()))
        result.append(event)
    return result


def silent(events: Events, scene: Scene, role: str, seconds: float = 1e9) -> Events:
    """Nothing from one role (NaN where it is a part of the drive)."""
    if role not in scene.targets:
        return events
    if role != DRIVE and scene.targets[role].sensor == DRIVE and len(scene.targets[role].columns) < 6:
        return changed(events, scene, role, lambda v: v * math.nan, first_s=seconds)
    begin, end = scene.when(role)
    window = (begin, min(end, begin + seconds))
    return [e for e in events if not (e.sensor == scene.name(role) and _inside(e, window))]


def late(
    events: Events, sensors: Sequence[str], window: tuple[float, float], delay: Callable[[Event], float]
) -> Events:
    """Delivered later, with the stamps that they had."""
    return _delivered(
        e._replace(arrival_s=e.arrival_s + delay(e)) if e.sensor in sensors and _inside(e, window) else e
        for e in events
    )


def restamped(
    events: Events, sensors: Sequence[str], window: tuple[float, float], stamp: Callable[[Event], Any]
) -> Events:
    """Other stamps, delivered as before."""
    return [e._replace(time_s=stamp(e)) if e.sensor in sensors and _inside(e, window) else e for e in events]


def _names(events: Events) -> tuple[str, ...]:
    return tuple(dict.fromkeys(e.sensor for e in events))


def _corrections(events: Events) -> tuple[str, ...]:
    return tuple(name for name in _names(events) if not str(name).startswith(DRIVE))


Fault = Callable[[Events, Scene, np.random.Generator], Events]


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Attributes
    ----------
    apply : callable
        (events, scene, rng) to events.
    counted : tuple of str
        Any of these must have been counted more often than without the fault: "role:outcome", "drive:counter" or "role
        is condition" (of the health); empty where nothing needs to be.
    unseen : bool
        Nothing in the readings tells the fault from a motion or from honest noise, so that the state may be wrong while
        it lasts.
    """

    apply: Fault
    counted: tuple[str, ...] = ()
    unseen: bool = False


KINDS: dict[str, Kind] = {}


def kind(name: str, *counted: str, unseen: bool = False) -> Callable[[Fault], Fault]:
    """Enter a function in `KINDS`."""

    def enter(function: Fault) -> Fault:
        KINDS[name] = Kind(function, counted, unseen)
        return function

    return enter


def damaged(name: str, events: Events, scene: Scene, seed: int) -> Events:
    """The events with one kind of fault; every kind has its own random numbers."""
    return KINDS[name].apply(events, scene, np.random.default_rng([seed, zlib.crc32(name.encode())]))


def _each(name: str, roles: Sequence[str], make: Callable[[str], Fault], *counted: str) -> None:
    """The same fault for several roles, as kinds of their own; ``{}`` in `counted` is the role."""
    for role in roles:
        KINDS[f"{name} {role}"] = Kind(make(role), tuple(c.format(role) for c in counted))


ROLES = ("heading", "velocity", "depth", "position")

# --- missing ---------------------------------------------------------------------------------------------------------


@kind("drop a fifth")
def _drop(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return [e for e in events if not (_inside(e, scene.window) and rng.random() < 0.2)]


@kind("drop most of the drive", "drive:gap")
def _drop_drive(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return [e for e in events if not (e.sensor == DRIVE and _inside(e, scene.window) and rng.random() < 0.9)]


_each("silence", ROLES, lambda role: lambda events, scene, rng: silent(events, scene, role), "{} is silent")


def _silent_drive(seconds: float) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        begin = scene.window[0]
        return [e for e in events if not (e.sensor == DRIVE and begin <= e.true_s < begin + seconds)]

    return fault


KINDS["silence drive 0.5 s"] = Kind(_silent_drive(0.5), ("drive:gap",))
KINDS["silence drive 5 s"] = Kind(_silent_drive(5.0), ("drive:gap",))
KINDS["silence drive 30 s"] = Kind(_silent_drive(30.0), ("drive:gap",))


@kind("silence of all corrections", "velocity is silent")
def _only_drive(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    for role in ("heading", "velocity", "depth"):
        events = silent(events, scene, role)
    return events


@kind("process suspended for 20 s", "drive:gap")
def _suspended(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    begin = scene.window[0]
    return [e for e in events if not begin <= e.true_s < begin + 20.0]


# --- order ----------------------------------------------------------------------------------------------------------


@kind("repeat each", "velocity:duplicate", "drive:backward")
def _repeat(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return [copy for e in events for copy in ([e, e] if _inside(e, scene.window) else [e])]


@kind("repeat half a second later", "velocity:duplicate", "drive:backward")
def _repeat_later(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    again = [e._replace(arrival_s=e.arrival_s + 0.5) for e in events if _inside(e, scene.window) and rng.random() < 0.2]
    return _delivered([*events, *again])


@kind("reorder neighbours", "drive:backward", "drive:late", "drive:reordered")
def _swap(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    result = list(events)
    for i in range(len(result) - 1):
        if _inside(result[i], scene.window) and rng.random() < 0.2:
            result[i], result[i + 1] = result[i + 1], result[i]
    return result


@kind("reorder within 0.2 s", "velocity:late-replayed", "velocity:too-late")
def _shuffle(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return late(events, _corrections(events), scene.window, lambda e: float(rng.uniform(0.0, 0.2)))


@kind("reorder the drive within 0.1 s", "drive:backward", "drive:late", "drive:reordered")
def _shuffle_drive(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return late(events, (DRIVE,), scene.window, lambda e: float(rng.uniform(0.0, 0.1)))


def _delay(role: str, seconds: float) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        return late(events, (scene.name(role),), scene.when(role), lambda e: seconds)

    return fault


KINDS["delay velocity 0.1 s"] = Kind(_delay("velocity", 0.1), ("velocity:late-replayed", "velocity:too-late"))
KINDS["delay heading 0.5 s"] = Kind(_delay("heading", 0.5), ("heading:late-replayed", "heading:too-late"))
KINDS["delay position 1.5 s"] = Kind(_delay("position", 1.5), ("position:late-replayed", "position:too-late"))
KINDS["delay position 3 s"] = Kind(_delay("position", 3.0), ("position:too-late",))
KINDS["delay drive 0.3 s"] = Kind(_delay(DRIVE, 0.3))
KINDS["delay drive 3 s"] = Kind(_delay(DRIVE, 3.0), ("velocity:ahead", "velocity:held", "velocity:late-replayed"))


@kind("everything in bursts of 1 s")
def _burst(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    return late(events, _names(events), scene.window, lambda e: math.ceil(e.true_s) - e.true_s)


@kind("bursts stamped on receipt")
def _burst_received(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    """As a serial line does it after the computer was busy for half a second: the readings of that time in one go, 0.2
    ms apart.
    """
    begin, end = scene.window
    held = late(events, _names(events), scene.window, lambda e: math.ceil(2.0 * e.true_s) / 2.0 - e.true_s)
    result, last = [], -math.inf
    for e in held:
        if begin <= e.true_s < end:
            last = max(e.arrival_s, last + 2e-4)
            e = e._replace(time_s=last)
        result.append(e)
    return result


# --- stamps ---------------------------------------------------------------------------------------------------------


@kind("jitter of all stamps")
def _jitter(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    size = {name: 0.3 * scene.period_s if name == DRIVE else 0.02 for name in _names(events)}
    return restamped(events, _names(events), scene.window, lambda e: e.time_s + size[e.sensor] * rng.normal())


def _clock(names: Callable[[Events], Sequence[str]], jump_s: float, *, for_good: bool) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        window = (scene.window[0], math.inf if for_good else scene.window[1])
        return restamped(events, names(events), window, lambda e: e.time_s + jump_s)

    return fault


KINDS["clock jumps forward 0.5 s"] = Kind(_clock(_names, 0.5, for_good=True), ("drive:gap",))
KINDS["clock jumps forward 5 s"] = Kind(_clock(_names, 5.0, for_good=True), ("drive:gap",))
KINDS["clock jumps back 0.5 s"] = Kind(_clock(_names, -0.5, for_good=True), ("drive:backward",))
KINDS["clock jumps back 5 s"] = Kind(_clock(_names, -5.0, for_good=True), ("drive:backward",))
KINDS["clock leaps an hour ahead"] = Kind(_clock(_names, 3600.0, for_good=True), ("drive:gap", "drive:clock-set"))
KINDS["clock leaps an hour back"] = Kind(_clock(_names, -3600.0, for_good=True), ("drive:backward", "drive:clock-set"))
KINDS["clock leaps an hour ahead and returns"] = Kind(
    _clock(_names, 3600.0, for_good=False), ("drive:gap", "drive:backward", "drive:clock-set")
)
KINDS["corrections 2 s ahead of the drive"] = Kind(_clock(_corrections, 2.0, for_good=False), ("velocity:ahead",))
KINDS["corrections 0.2 s behind"] = Kind(
    _clock(_corrections, -0.2, for_good=False), ("velocity:too-late", "velocity:late-replayed")
)
KINDS["corrections an hour behind"] = Kind(
    _clock(_corrections, -3600.0, for_good=False), ("velocity:duplicate", "velocity:too-late")
)


def _single_stamps(
    names: Callable[[Events], Sequence[str]], stamp: Callable[[Event], Any], share: float = 0.02
) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        return restamped(events, names(events), scene.window, lambda e: stamp(e) if rng.random() < share else e.time_s)

    return fault


KINDS["single stamps an hour ahead"] = Kind(_single_stamps(_names, lambda e: e.time_s + 3600.0), ("drive:backward",))
KINDS["single stamps 5 s ahead"] = Kind(
    _single_stamps(_names, lambda e: e.time_s + 5.0, 0.002), ("drive:backward", "drive:gap")
)
KINDS["single stamps zero"] = Kind(_single_stamps(_names, lambda e: 0.0), ("drive:backward",))
KINDS["single stamps NaN"] = Kind(_single_stamps(_names, lambda e: math.nan), ("drive:backward", "velocity:invalid"))
KINDS["single stamps infinite"] = Kind(
    _single_stamps(_names, lambda e: math.inf), ("drive:backward", "velocity:invalid")
)
KINDS["stamps in milliseconds"] = Kind(_single_stamps(_names, lambda e: 1000.0 * e.time_s, 0.01), ("drive:backward",))
KINDS["drive stamped in steps of 0.1 s"] = Kind(
    _single_stamps(lambda events: (DRIVE,), lambda e: math.floor(10.0 * e.time_s + 1e-6) / 10.0, 1.0),
    ("drive:backward",),
)
KINDS["drive's stamps stand still for 5 s"] = Kind(
    lambda events, scene, rng: restamped(
        events, (DRIVE,), (scene.window[0], scene.window[0] + 5.0), lambda e: scene.window[0]
    ),
    ("drive:backward",),
)


# --- values ---------------------------------------------------------------------------------------------------------

BAD = {"NaN": math.nan, "infinite": math.inf, "minus infinite": -math.inf, "huge": 1e300}
for _word, _value in BAD.items():
    KINDS[f"corrections {_word}"] = Kind(
        lambda events, scene, rng, bad=_value: _all_roles(events, scene, lambda v: v * 0.0 + bad, rng, 0.3),
        ("velocity:invalid", "velocity:rejected"),
    )
    KINDS[f"drive {_word}"] = Kind(
        lambda events, scene, rng, bad=_value: _part_of_drive(events, scene, lambda v: v * 0.0 + bad, rng, 0.1),
        ("drive:bad-sample",),
    )


def _all_roles(events: Events, scene: Scene, change: Callable[[np.ndarray], Any], rng: Any, share: float) -> Events:
    for role in ROLES:
        events = changed(events, scene, role, change, share=share, rng=rng)
    return events


def _part_of_drive(events: Events, scene: Scene, change: Callable[[np.ndarray], Any], rng: Any, share: float) -> Events:
    """One half of the drive's values (gyros, or attitude), so that the other half tempts."""
    role = "gyro" if "gyro" in scene.targets else "tilt"
    return changed(events, scene, role, change, share=share, rng=rng)


@kind("drive NaN for 10 s", "drive:bad-sample")
def _drive_nan(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    for role in ("gyro", "accel", "tilt"):
        events = changed(events, scene, role, lambda v: v * math.nan, first_s=10.0)
    return events


SPIKE = {"heading": 90.0 * DEG, "velocity": 3.0, "depth": 50.0, "position": 3e-5}
_each(
    "spikes",
    ROLES,
    lambda role: (
        lambda events, scene, rng: changed(
            events, scene, role, lambda v: v + SPIKE[role] * rng.choice((-1.0, 1.0)), share=0.1, rng=rng
        )
    ),
    "{}:rejected",
    "{}:invalid",
)
KINDS["spikes gyro, impossible"] = Kind(
    lambda events, scene, rng: changed(events, scene, "gyro", lambda v: v + 300.0, share=0.01, rng=rng),
    ("drive:bad-sample",),
)
KINDS["spikes gyro, possible"] = Kind(
    lambda events, scene, rng: changed(
        events, scene, "gyro", lambda v: v + rng.choice((-2.0, 2.0)), share=0.002, rng=rng
    ),
    ("drive:spike",),
)
KINDS["spikes accel, possible"] = Kind(
    lambda events, scene, rng: changed(
        events, scene, "accel", lambda v: v + rng.choice((-50.0, 50.0)), share=0.002, rng=rng
    ),
    ("drive:spike",),
)


def _stuck(role: str, seconds: float = 1e9) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        held: list[Any] = []

        def hold(value: np.ndarray) -> Any:
            if not held:
                held.append(value.copy())
            return held[0]

        return changed(events, scene, role, hold, first_s=seconds)

    return fault


_each("stuck", ROLES, _stuck, "{} is stuck")
KINDS["stuck gyro and accel 5 s"] = Kind(
    lambda events, scene, rng: _stuck("accel", 5.0)(_stuck("gyro", 5.0)(events, scene, rng), scene, rng),
    ("drive:stuck",),
)
KINDS["one gyro dead for 20 s"] = Kind(
    lambda events, scene, rng: changed(events, scene, "gyro", lambda v: v * (1.0, 1.0, 0.0), first_s=20.0),
    ("drive:dead",),
)

for _sentinel in (-32.768, -9999.0, 65535.0, 9.96921e36):
    KINDS[f"sentinel {_sentinel:g}"] = Kind(
        lambda events, scene, rng, bad=_sentinel: _all_roles(events, scene, lambda v: v * 0.0 + bad, rng, 0.3),
        ("velocity:invalid", "velocity:rejected"),
    )
KINDS["bottom lock lost: zeros"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: v * 0.0),
    ("velocity:invalid", "drive:velocity-lost"),
)
KINDS["bottom lock lost: sentinels"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: v * 0.0 - 32.768),
    ("velocity:invalid", "drive:velocity-lost"),
)
KINDS["bottom lock lost: one component"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: np.array([math.nan, *v[1:]]))
)
KINDS["bottom lock comes and goes"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: v * 0.0, share=0.5, rng=rng),
    ("velocity:invalid", "drive:velocity-lost"),
)
KINDS["DVL tracks the water (current of 0.3 m/s)"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: v + scene.along @ (0.25, -0.17, 0.0)),
    ("velocity:rejected",),
    unseen=True,
)
KINDS["compass next to iron, 25 deg"] = Kind(
    lambda events, scene, rng: changed(events, scene, "heading", lambda v: v + 25.0 * DEG), ("heading:rejected",)
)
KINDS["compass next to iron, 4 deg"] = Kind(
    lambda events, scene, rng: changed(events, scene, "heading", lambda v: v + 4.0 * DEG),
    ("heading:rejected",),
    unseen=True,
)
KINDS["fixes 100 m off"] = Kind(
    lambda events, scene, rng: changed(events, scene, "position", lambda v: v + (100.0 / 6.37e6, 0.0, 0.0)[: len(v)]),
    ("position:rejected",),
)
KINDS["fixes at 0 N 0 E"] = Kind(
    lambda events, scene, rng: changed(events, scene, "position", lambda v: v * 0.0),
    ("position:rejected", "position:invalid"),
)
KINDS["depth jumps by 5 m"] = Kind(
    lambda events, scene, rng: changed(events, scene, "depth", lambda v: v + 5.0), ("depth:rejected",)
)

KINDS["heading in degrees"] = Kind(
    lambda events, scene, rng: changed(events, scene, "heading", lambda v: v / DEG % 360.0),
    ("heading:rejected", "heading:invalid"),
)
KINDS["fixes in degrees"] = Kind(
    lambda events, scene, rng: changed(events, scene, "position", lambda v: np.array([v[0] / DEG, v[1] / DEG, *v[2:]])),
    ("position:rejected", "position:invalid"),
)
KINDS["velocity in mm/s"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: 1e3 * v),
    ("velocity:rejected", "velocity:invalid"),
)
KINDS["velocity in knots"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: 1.944 * v), ("velocity:rejected",)
)
KINDS["velocity with the sign changed"] = Kind(
    lambda events, scene, rng: changed(events, scene, "velocity", lambda v: -v), ("velocity:rejected",)
)
KINDS["depth in Pa"] = Kind(
    lambda events, scene, rng: changed(events, scene, "depth", lambda v: 1e4 * v + 101325.0),
    ("depth:rejected", "depth:invalid"),
)
KINDS["gyro in deg/s for 10 s"] = Kind(
    lambda events, scene, rng: changed(events, scene, "gyro", lambda v: v / DEG, first_s=10.0),
    ("drive:wrong-unit",),
)
KINDS["accel in g for 10 s"] = Kind(
    lambda events, scene, rng: changed(events, scene, "accel", lambda v: v / 9.80665, first_s=10.0),
    ("drive:wrong-unit",),
)

NOISE = {"heading": 6.0 * DEG, "velocity": 0.1, "depth": 0.5, "position": 4.7e-6}
_each(
    "noise x10",
    ROLES,
    lambda role: lambda events, scene, rng: changed(events, scene, role, lambda v: v + _noise(role, v, rng)),
    "{}:rejected",
    "{} is noisy",
)
KINDS["noise x10 drive"] = Kind(
    lambda events, scene, rng: changed(
        changed(events, scene, "gyro", lambda v: v + 0.01 * rng.normal(size=3)),
        scene,
        "accel",
        lambda v: v + 0.1 * rng.normal(size=3),
    ),
    ("drive:noisy",),
)


def _noise(role: str, value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    size = np.full(len(value), NOISE[role])
    if role == "position" and len(size) > 2:
        size[2] = 30.0
    return size * rng.normal(size=len(value))


# --- things that are no readings ------------------------------------------------------------------------------------

RUBBISH = (
    None,
    "",
    "12.3$",
    b"\x00\xff",
    [],
    [[]],
    {},
    "NaN",
    [1.0, "x", 2.0],
    object(),
    1j,
    [[1.0, 2.0], [3.0]],
    True,
    [None, None, None],
)


def _rubbish_values(names: Callable[[Events], Sequence[str]], share: float) -> Fault:
    def fault(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
        where = names(events)
        return [
            e._replace(value=RUBBISH[rng.integers(len(RUBBISH))])
            if e.sensor in where and _inside(e, scene.window) and rng.random() < share
            else e
            for e in events
        ]

    return fault


KINDS["corrections that are no numbers"] = Kind(_rubbish_values(_corrections, 0.3), ("velocity:invalid",))
KINDS["samples that are no numbers"] = Kind(
    _rubbish_values(lambda events: (DRIVE,), 0.02), ("drive:bad-sample", "drive:backward")
)
KINDS["stamps that are no numbers"] = Kind(
    lambda events, scene, rng: restamped(
        events,
        _names(events),
        scene.window,
        lambda e: RUBBISH[rng.integers(len(RUBBISH))] if rng.random() < 0.02 else e.time_s,
    ),
    ("velocity:invalid", "drive:backward"),
)


@kind("too few and too many values", "velocity:invalid", "drive:bad-sample")
def _wrong_length(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    result = []
    for e in events:
        if _inside(e, scene.window) and rng.random() < 0.05:
            e = e._replace(value=e.value[: rng.integers(len(e.value))] if rng.random() < 0.7 else (*e.value, 1.0, 2.0))
        result.append(e)
    return result


@kind("readings of sensors that the vehicle does not have", "unknown:unknown-sensor")
def _unknown(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    names = ("sonar", "", "imu", "gyro", None, 3, ("dvl",), [])
    return [
        e._replace(sensor=names[rng.integers(len(names))])
        if e.sensor != DRIVE and _inside(e, scene.window) and rng.random() < 0.2
        else e
        for e in events
    ]


@kind("everything at once", "velocity:invalid", "drive:bad-sample", "drive:backward")
def _everything(events: Events, scene: Scene, rng: np.random.Generator) -> Events:
    some = (
        "corrections NaN",
        "drive infinite",
        "reorder neighbours",
        "repeat half a second later",
        "sentinel -32.768",
        "drop a fifth",
    )
    for name in (*some, "single stamps NaN", "spikes velocity", "jitter of all stamps"):
        events = KINDS[name].apply(events, scene, rng)
    return events

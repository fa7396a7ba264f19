"""Faults that are drawn at random, in vehicles that are drawn at random, against the same run without the fault.

Every case is a vehicle of `honest_random.py`, with a unit or by dead reckoning, and one fault, or two, of one of its
sensors or of the drive: constants, drifts, scales, signs, axes exchanged or turned, soft saturation, ramps that stay
where they have come to, a bottom that moves, ever faster or not, noise, spikes, values that are held, zero or missing,
silence, other clocks, lags, late and repeated readings; of a size, at a time and for so long as are drawn, or for good.
Scored are two minutes after the fault has ended (of one for good: begun) until the end of the mission, once
a second, live. A case is odd that raises an exception or says NaN, leaves the state lost (NEES above `LOST`, and ten
times that without the fault), never uses the sensor again although it is good again, or says nothing and is off. What
is adopted in the runs without the fault is counted, too.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from faults_outcomes import differs, said, watched
from faults_outcomes import library as faults
from feeding import DRIVE, Event, Events, events_of
from harness import DEG, Array, Options, Table, flag, main, quick
from honest_random import Case
from random_vehicles import Random, between, chance
from scipy.spatial.transform import Rotation

import navfilter as nf
from navfilter.models.health import CALM
from navfilter.models.mission import Mission, Stream
from navfilter.models.state import matrix_from_euler

#: Scored from so long after the fault on [s].
SETTLED_S = 120.0
#: Fixes are there while the last one is no older [s], or three of their periods; after so long they have told [s].
THERE_S, TOLD_S = 5.0, 30.0
#: A mean NEES of position, velocity or heading beyond this is lost, and beyond this off [1].
LOST, OFF = 100.0, 10.0
RADIUS_M, G = 6.371e6, 9.80665
PARTS = ("position", "velocity", "heading")
COUNTED = ("crash", "not PD", "stopped", "lost", "off", "dark", "unused", "unsaid", "smoothed")
#: What is put in force, or given up, where something is believed to err.
ADOPTED = ("jumped", "shifted", "realigned", "arm-or-clock", "astray", "contradicted", "reset", "opened")
Change = Callable[[Array, float], Array]


class Part(NamedTuple):
    """Of what arrives, what one fault is of: columns of the values of a sensor, and what it errs by in their units."""

    name: str
    sensor: str
    columns: tuple[int, ...]
    sd: Array
    along: Array | None = None  # of a velocity over ground: directions of its components in b


@dataclass(frozen=True)
class Drawn:
    """A fault."""

    part: Part
    kind: str
    size: float
    begin_s: float
    end_s: float
    seed: int
    truth: Stream

    @property
    def words(self) -> str:
        """What it is."""
        until = "for good" if math.isinf(self.end_s) else f"{self.end_s - self.begin_s:.0f} s"
        return f"{self.part.name}: {self.kind} {self.size:.3g}, {self.begin_s:.0f} s, {until}"

    def apply(self, events: Events) -> Events:
        """The events with it."""
        r = np.random.default_rng(self.seed)
        return KINDS[self.kind](events, self, r)

    def hits(self, event: Event) -> bool:
        """Whether it acts on an event."""
        return event.sensor == self.part.sensor and self.begin_s <= event.true_s < self.end_s


def parts(vehicle: nf.Vehicle) -> list[Part]:
    """What may fail: gyros, accelerometers, or attitude and velocity of the drive; each sensor with a stream."""
    found = []
    if "imu" in vehicle.drive.streams:
        found += [Part("gyro", DRIVE, (0, 1, 2), np.full(3, 2e-3)), Part("accel", DRIVE, (3, 4, 5), np.full(3, 0.02))]
    else:
        found += [Part("tilt", DRIVE, (0, 1), np.full(2, 0.5 * DEG)), Part("heading", DRIVE, (2,), np.full(1, DEG))]
        found += [Part("velocity", DRIVE, (3, 4, 5), np.full(3, 0.02), np.eye(3))]
    for name, sensor in vehicle.sensors.items():
        if sensor.from_drive:
            continue
        a = sensor.axes
        sd = np.array([math.sqrt(sensor.mean_variance(axis, 1)) for axis in range(a)])
        if isinstance(sensor, nf.Position):
            sd = sd / np.array([RADIUS_M, RADIUS_M, 1.0])[:a]
        if isinstance(sensor, nf.Heading) and sensor.magnetometer:
            sd = np.full(3, 30.0 * sd[0])  # of a field of some 30 microtesla
        width, along = min(len(sd), sensor.reads), None
        if isinstance(sensor, nf.BodyVelocity | nf.DvlBeams):
            instrument = sensor.beams() if isinstance(sensor, nf.DvlBeams) else np.eye(3)
            along = (instrument @ matrix_from_euler(*sensor.mounting_rad).T)[:width]
        found.append(Part(name, name, tuple(range(width)), sd[:width], along))
    return found


def altered(change: Callable[[Drawn, Random], Change]) -> Callable[[Events, Drawn, Random], Events]:
    """Other values; `change` says for a fault what becomes of a value of an age [s]."""

    def events_with(events: Events, fault: Drawn, r: Random) -> Events:
        at, new = list(fault.part.columns), change(fault, r)
        result = []
        for e in events:
            if fault.hits(e):
                value = np.array(e.value)
                value[at] = new(value[at], e.true_s - fault.begin_s)
                e = e._replace(value=tuple(value.tolist()))
            result.append(e)
        return result

    return events_with


def way(fault: Drawn, r: Random) -> Array:
    """A direction in which it is off, in the units of its part."""
    v = r.normal(size=len(fault.part.sd))
    return np.asarray(v / np.linalg.norm(v) * math.sqrt(len(v)) * fault.part.sd)


def constant(fault: Drawn, r: Random) -> Change:
    off = fault.size * way(fault, r)
    return lambda v, age_s: v + off


def drift(fault: Drawn, r: Random) -> Change:
    rate = fault.size * way(fault, r) / 60.0
    return lambda v, age_s: v + rate * age_s


def ramp(fault: Drawn, r: Random) -> Change:
    rate, until_s = fault.size * way(fault, r) / 60.0, between(r, 5.0, 100.0)
    return lambda v, age_s: v + rate * min(age_s, until_s)


def turned(fault: Drawn, r: Random) -> Change:
    axis = r.normal(size=3)
    C = np.asarray(Rotation.from_rotvec(fault.size * DEG * axis / np.linalg.norm(axis)).as_matrix())
    return lambda v, age_s: C @ v


def saturation(events: Events, fault: Drawn, r: Random) -> Events:
    """Softly, at a share of the largest value that it ever has."""
    columns = list(fault.part.columns)
    most = fault.size * max(abs(e.value[k]) for e in events if e.sensor == fault.part.sensor for k in columns)
    return altered(lambda *_: lambda v, age_s: most * np.tanh(v / most))(events, fault, r)


def bottom(accelerates: bool) -> Callable[[Events, Drawn, Random], Events]:
    """What a velocity is read against moves, in a direction of n; up to twice that speed if it accelerates."""

    def events_with(events: Events, fault: Drawn, r: Random) -> Events:
        assert fault.part.along is not None
        course, grows_s, result = float(r.uniform(0.0, 2.0 * math.pi)), between(r, 20.0, 600.0), []
        for e in events:
            if fault.hits(e):
                speed = fault.size * (min((e.true_s - fault.begin_s) / grows_s, 2.0) if accelerates else 1.0)
                flow = speed * np.array([math.cos(course), math.sin(course), 0.0])
                value = np.array(e.value)
                value[list(fault.part.columns)] -= (
                    fault.part.along @ watched.truth_at(fault.truth, e.true_s).C_nb.T @ flow
                )
                e = e._replace(value=tuple(value.tolist()))
            result.append(e)
        return result

    return events_with


def held(fault: Drawn, r: Random) -> Change:
    first: list[Array] = []

    def same(v: Array, age_s: float) -> Array:
        first[:] = first or [v.copy()]
        return first[0]

    return same


def noise(fault: Drawn, r: Random) -> Change:
    return lambda v, age_s: v + fault.size * fault.part.sd * r.normal(size=len(v))


def spikes(fault: Drawn, r: Random) -> Change:
    share = between(r, 0.005, 0.3)
    return lambda v, age_s: v + fault.size * way(fault, r) if r.random() < share else v


def dropouts(fault: Drawn, r: Random) -> Change:
    return lambda v, age_s: v * math.nan if r.random() < 0.5 else v


def one_missing(fault: Drawn, r: Random) -> Change:
    return lambda v, age_s: np.concatenate([[math.nan], v[1:]])


def clock(events: Events, fault: Drawn, r: Random) -> Events:
    return [e._replace(time_s=e.time_s + fault.size) if fault.hits(e) else e for e in events]


def lag(events: Events, fault: Drawn, r: Random) -> Events:
    """Shows what was, with the stamps of now."""
    past: list[Event] = []
    result = []
    for e in events:
        if e.sensor == fault.part.sensor:
            past.append(e)
            while len(past) > 1 and past[1].true_s <= e.true_s - fault.size + 1e-9:
                past.pop(0)
            e = e._replace(value=past[0].value) if fault.hits(e) else e
        result.append(e)
    return result


def late(events: Events, fault: Drawn, r: Random) -> Events:
    return sorted(
        (e._replace(arrival_s=e.arrival_s + r.uniform(0.0, fault.size)) if fault.hits(e) else e for e in events),
        key=lambda e: e.arrival_s,
    )


def repeated(events: Events, fault: Drawn, r: Random) -> Events:
    """Some come again, a little later, with the stamp of then."""
    again = []
    for e in events:
        if fault.hits(e) and r.random() < 0.3:
            new_s = e.true_s + r.uniform(0.01, fault.size)
            again.append(e._replace(time_s=new_s, arrival_s=new_s))
    return sorted([*events, *again], key=lambda e: e.arrival_s)


def silence(events: Events, fault: Drawn, r: Random) -> Events:
    return [e for e in events if not fault.hits(e)]


KINDS: dict[str, Callable[[Events, Drawn, Random], Events]] = {
    "constant": altered(constant),
    "drift a minute": altered(drift),
    "scale": altered(lambda fault, r: lambda v, age_s: v * (1.0 + fault.size)),
    "sign": altered(lambda fault, r: lambda v, age_s: -v),
    "exchanged": altered(lambda fault, r: lambda v, age_s: v[::-1]),
    "held": altered(held),
    "zeros": altered(lambda fault, r: lambda v, age_s: 0.0 * v),
    "missing": altered(lambda fault, r: lambda v, age_s: math.nan * v),
    "half missing": altered(dropouts),
    "one missing": altered(one_missing),
    "noise": altered(noise),
    "spikes": altered(spikes),
    "silence": silence,
    "clock": clock,
    "lag": lag,
    "late": late,
    "repeated": repeated,
    "ramp, then constant": altered(ramp),
    "turned": altered(turned),
    "saturation": saturation,
    "bottom": bottom(False),
    "bottom that accelerates": bottom(True),
}
#: Sizes, of all orders of magnitude alike; the others have none.
SIZES = {
    "constant": (3.0, 1000.0),
    "drift a minute": (3.0, 300.0),
    "scale": (0.02, 3.0),
    "noise": (3.0, 100.0),
    "spikes": (10.0, 1000.0),
    "clock": (0.1, 5.0),
    "lag": (0.2, 5.0),
    "late": (0.1, 5.0),
    "repeated": (0.02, 2.0),
    "ramp, then constant": (3.0, 300.0),
    "turned": (2.0, 90.0),
    "saturation": (0.1, 1.0),
    "bottom": (0.05, 1.0),
    "bottom that accelerates": (0.05, 1.0),
}


def drawn(r: Random, vehicle: nf.Vehicle, truth: Stream, duration_s: float) -> list[Drawn]:
    """One fault, or two."""
    found, of_three = [], ("exchanged", "one missing", "turned")
    for _ in range(2 if chance(r, 0.25) else 1):
        part = parts(vehicle)[int(r.integers(len(parts(vehicle))))]
        kinds = [k for k in KINDS if k not in of_three or len(part.columns) == 3]
        kinds = [k for k in kinds if not k.startswith("bottom") or part.along is not None]
        kind = str(r.choice(kinds))
        size = between(r, *SIZES[kind]) if kind in SIZES else 1.0
        size *= -1.0 if kind in ("scale", "clock") and chance(r, 0.5) else 1.0
        begin_s = float(r.uniform(0.15, 0.5)) * duration_s
        lasts_s = math.inf if chance(r, 0.2) else min(between(r, 3.0, 200.0), 0.25 * duration_s)
        found.append(Drawn(part, kind, size, begin_s, begin_s + lasts_s, int(r.integers(1 << 30)), truth))
    return found


class Run(NamedTuple):
    """What a run showed: what was watched, and once a second time, position error [m], heading error [rad], NEES
    of `PARTS`.
    """

    outcome: watched.Outcome
    rows: Array


def fly(vehicle: nf.Vehicle, mission: Mission, events: Events) -> Run:
    """Hand the events over, live."""
    assert mission.start is not None and mission.truth is not None
    scene = faults.scene_of(vehicle, (0.0, 1.0), (0.0, 1.0))
    outcome = watched.watch(nf.Navigator(vehicle, mission.start, threads=False), events, scene, longest_cpu_s=120.0)
    rows = []
    for time_s, state in outcome.states:
        if time_s <= mission.truth.time_s[-1]:
            error, P = state.minus(watched.truth_at(mission.truth, time_s)), state.covariance
            assert P is not None
            nees = []
            for part in (slice(0, 3), slice(3, 6), slice(8, 9)):
                e = error[part]
                nees.append(float(e @ np.linalg.pinv(P[part, part], hermitian=True) @ e) / len(e))
            rows.append((time_s, math.hypot(error[0], error[1]), abs(error[8]), *nees))
    return Run(outcome, np.array(rows))


def told_s(vehicle: nf.Vehicle, events: Events) -> Callable[[Array], Array]:
    """For how long fixes have been there, at times (n,) [s]; negative where they are not."""
    names = {n for n, s in vehicle.sensors.items() if s.observes.corrects == "position" and s.axes > 1}
    times = np.array([-math.inf, *(e.true_s for e in events if e.sensor in names), math.inf])
    periods = [1.0 / vehicle.sensors[n].rate_hz for n in names]
    gaps = np.diff(times) > max(THERE_S, 3.0 * min(periods, default=THERE_S))
    begins, ends = times[1:][gaps], times[:-1][gaps]

    def since(at_s: Array) -> Array:
        began = begins[np.searchsorted(begins, at_s, side="right") - 1]
        ended = ends[np.searchsorted(begins, at_s, side="right")]
        return np.where(at_s <= ended + THERE_S, at_s - began, -1.0)

    return since


def smoothed(vehicle: nf.Vehicle, mission: Mission, events: Events, from_s: float) -> float:
    """Largest mean NEES of the smoothed track of these events, by their stamps."""
    streams = dict(mission.streams)
    widths = 6 // len(vehicle.drive.streams)
    for name in {e.sensor for e in events}:
        own = sorted((e for e in events if e.sensor == name), key=lambda e: e.time_s)
        times, values = np.array([e.time_s for e in own]), np.array([e.value for e in own])
        if name == DRIVE:
            for k, stream in enumerate(vehicle.drive.streams):
                streams[stream] = Stream(times, values[:, widths * k : widths * (k + 1)])
        else:
            streams[name] = Stream(times, values, mission.streams[name].columns)
    for name in mission.streams:
        if name in vehicle.sensors and not any(e.sensor == name for e in events):
            streams[name] = mission.streams[name].keep(np.zeros(len(mission.streams[name]), bool))
    track = nf.replay(vehicle, replace(mission, streams=streams), smooth=True)
    nees, scored = track.nees(track.errors(mission.truth)), track.time_s > from_s
    return max(float(np.nanmean(nees[what][scored])) for what in PARTS)


def figures(number: int, options: Options) -> dict[str, Any]:
    """The row of a case."""
    case = Case.of(number, options.drive)
    mission = case.mission(10 * number)
    assert mission.start is not None and mission.truth is not None
    r = np.random.default_rng([number, 3])
    found = drawn(r, case.vehicle, mission.truth, case.duration_s)
    plain = [e for e in events_of(case.vehicle, mission) if e.true_s >= mission.start.time_s - 1e-9]
    events = plain
    for fault in found:
        events = fault.apply(events)
    clean, hit = fly(case.vehicle, mission, plain), fly(case.vehicle, mission, events)
    begin_s = min(fault.begin_s for fault in found)
    over_s = max(fault.begin_s if math.isinf(fault.end_s) else fault.end_s for fault in found)
    from_s = min(over_s + SETTLED_S, 0.9 * case.duration_s)
    row: dict[str, Any] = {"case": number, "fault": "; ".join(f.words for f in found), "vehicle": case.words}
    lit = told_s(case.vehicle, plain)
    scored = lambda rows: rows[(rows[:, 0] > from_s) & (lit(rows[:, 0]) >= TOLD_S)]  # noqa: E731
    dark = not len(scored(hit.rows)) or not len(scored(clean.rows))
    for name, run in (("", hit), ("clean_", clean)):
        after = run.rows[run.rows[:, 0] > from_s] if dark else scored(run.rows)
        square, nees = np.full(2, math.nan), np.full(len(PARTS), math.nan)  # a run that has ended says nothing
        if len(after):
            square, nees = np.mean(after[:, 1:3] ** 2, axis=0), after[:, 3:].mean(axis=0)
        row[f"{name}m"], row[f"{name}deg"] = math.sqrt(square[0]), math.sqrt(square[1]) / DEG
        row[f"{name}nees"] = float(nees.max())
        row |= {f"{name}nees_{part}": float(x) for part, x in zip(PARTS, nees, strict=True)}
    usual = {round(t): said(state) for t, state in clean.outcome.states}
    news = [t for t, s in hit.outcome.states if t >= begin_s and differs(said(s), usual.get(round(t), said(s)))]
    row["named_s"] = news[0] - begin_s if news else None
    last, before = hit.outcome.states[-1][1].health, clean.outcome.states[-1][1].health
    assert last is not None and before is not None
    row["hours"], row["adopted"] = case.duration_s / 3600.0, {n: before.drive[n] for n in ADOPTED if before.drive[n]}
    conditions = {n: s.condition for n, s in last.sensors.items()} | dict(last.axes)
    were = {n: s.condition for n, s in before.sensors.items()} | dict(before.axes)
    good = (*CALM, "silent")
    unused = [f"{n} {c}" for n, c in conditions.items() if c not in good and were.get(n, "good") in good]
    lasting = {fault.part.sensor for fault in found if math.isinf(fault.end_s)}
    row["unused"] = ", ".join(unused)
    row["level"] = "" if last.trust is None else last.trust.level
    row["bounds_m"] = math.nan if last.bounds is None else last.bounds.horizontal_m
    row["crashes"] = hit.outcome.crashes.total() + (hit.outcome.nan_s is not None)
    row["crashed"] = dict(hit.outcome.crashes)
    odd = ["crash"] * bool(row["crashes"]) + ["not PD"] * (hit.outcome.not_definite_s is not None)
    odd += ["stopped"] * hit.outcome.stopped
    lost = row["nees"] > max(LOST, 10.0 * row["clean_nees"])
    off = row["nees"] > max(OFF, 3.0 * row["clean_nees"])
    odd += ["dark"] * (off and dark) + ["lost"] * (lost and not dark) + ["off"] * (off and not lost and not dark)
    odd += ["unused"] * any(u.split()[0] not in lasting and DRIVE not in lasting for u in unused)
    odd += ["unsaid"] * (off and not news)
    if options.smoothed:
        row["sm_nees"] = smoothed(case.vehicle, mission, events, from_s)
        odd += ["smoothed"] * (row["sm_nees"] > max(LOST, 10.0 * row["nees"]))
    return row | {"lasting": bool(lasting), "odd": ", ".join(odd)}


def faults_random(options: Options) -> dict[str, Any]:
    """Draw, simulate, fly, print what is odd."""
    table = Table(
        "case<6 odd<14 m>9.2f clean_m>8.2f deg>7.2f clean_deg>7.2f nees>9.1f clean_nees>8.1f named_s>7.1f "
        "level<9 unused<20 fault<60 vehicle<60"
    )
    found = []
    nf.warm_up()
    for number in range(options.first, options.first + (4 if options.quick else options.cases)):
        row = figures(number, options)
        found.append(row)
        if row["odd"] or options.all:
            table.add(row)
    counts = {word: sum(word in row["odd"].split(", ") for row in found) for word in COUNTED}
    print(f"{len(found)} cases: " + ", ".join(f"{n} {word}" for word, n in counts.items()))
    adopted: Counter[str] = sum((Counter(row["adopted"]) for row in found), Counter())
    words = ", ".join(f"{n} {word}" for word, n in adopted.items()) or "nothing"
    print(f"without their faults, {sum(row['hours'] for row in found):.1f} h: {words} adopted")
    return {"rows": found, "counts": counts}


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=200, help="how many"),
        flag("--first", type=int, default=20_000, help="number of the first"),
        flag("--drive", choices=["imu", "dead-reckoning", "acoustic"], default="imu", help="what drives"),
        flag("--smoothed", action="store_true", help="the smoothed track, too"),
        flag("--all", action="store_true", help="print all, not only those that are odd"),
        quick("four of them"),
    ]
    main(__doc__, {faults_random: flags})

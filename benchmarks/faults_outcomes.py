"""What happens when ...: one row a fault, in a survey with fixes at both ends, as the manual's page shows it."""

from __future__ import annotations

import dataclasses
import functools
import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from harness import DEG, ROOT, Options, Table

sys.path.insert(0, str(ROOT / "tests"))
import faults_library as library
import faults_run as watched
from feeding import DRIVE, Event, Events, events_of

import navfilter as nf
from navfilter.models.lane_missions import of_one_unit
from navfilter.models.sensors import Sensor
from navfilter.models.start import Start
from navfilter.models.state import wrap
from navfilter.simulation.scenarios import COMPASS, reckoning_vehicle, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

END_S, DIVE_S, BACK_S, FAULT_S, MINUTE_S, JUDGED_S = 700.0, 140.0, 500.0, 250.0, 60.0, 620.0
RADIUS_M, G = 6.371e6, 9.80665
#: Of three beacons on the bottom, north and east of the start [m].
BEACONS = ((0.0, 0.0), (400.0, 0.0), (0.0, 400.0))
WORST_NEES = 2.0
#: No fault costs more than twice the way of a minute in which nothing at all is heard [m].
FAR_M = 180.0
#: What freezes is held from its first sample on, which comes within so much of the fault [s].
HOLDS_S = 0.005
#: A process that stands still says nothing for so long [s].
SAYS_NOTHING_S = {"process suspended for 20 s": 20.0}
COLUMNS = "fault<46 worst_m>8.1f sd_m>8.1f clean_m>8.1f held>7.2f named_s>7.1f after_m>8.1f nees>8.1f verdict<14"


class Case(NamedTuple):
    """A fault: what it does to the start and to the events, and when it begins."""

    start: Callable[[Start], Start] = lambda start: start
    events: Callable[[Events, library.Scene], Events] = lambda events, scene: events
    begin_s: float = FAULT_S


def values(role: str, change: Callable[..., Any], begin_s: float = FAULT_S, end_s: float = math.inf) -> Case:
    """Other readings for a time of what plays a role; `change` takes a value and its age since the begin [s]."""

    def altered(events: Events, scene: library.Scene) -> Events:
        if role not in scene.targets:
            return events
        sensor, columns = scene.targets[role]
        at, result = list(columns), []
        for e in events:
            if e.sensor == sensor and begin_s <= e.true_s < end_s:
                value = np.array(e.value)
                value[at] = change(value[at], e.true_s - begin_s)
                e = e._replace(value=tuple(value.tolist()))
            result.append(e)
        return result

    return Case(events=altered, begin_s=begin_s)


def frozen(role: str, seconds: float) -> Case:
    """The reading of what plays a role stays what it was."""
    held: list[Any] = []

    def last(value: Any, age_s: float) -> Any:
        if age_s < HOLDS_S:
            held[:] = [value.copy()]
        return held[0]

    return values(role, last, end_s=FAULT_S + seconds)


def restamped(by_s: float) -> Case:
    """Another clock of the drive alone."""

    def altered(events: Events, scene: library.Scene) -> Events:
        return [e._replace(time_s=e.time_s + by_s) if e.sensor == DRIVE and e.true_s >= FAULT_S else e for e in events]

    return Case(events=altered)


def zeros(seconds: float) -> Case:
    """A drive that gives nothing but zeros."""

    def altered(events: Events, scene: library.Scene) -> Events:
        return [
            e._replace(value=(0.0,) * 6) if e.sensor == DRIVE and FAULT_S <= e.true_s < FAULT_S + seconds else e
            for e in events
        ]

    return Case(events=altered)


def moved(**changes: Any) -> Case:
    """A start that was told wrongly."""

    def start(given: Start) -> Start:
        new = {name: change(getattr(given, name)) for name, change in changes.items()}
        return dataclasses.replace(given, **new)

    return Case(start=start, begin_s=0.0)


def north(metres: Callable[[float], float]) -> Callable[..., Any]:
    """Fixes moved north, by as much as their age says."""
    return lambda v, age_s: v + np.array([metres(age_s) / RADIUS_M, 0.0, 0.0])[: len(v)]


def turned(by_rad: float) -> Callable[..., Any]:
    """Another heading, or the field that it would be read from: turned about the vertical axis of the instrument."""
    c, s = math.cos(by_rad), math.sin(by_rad)
    about_z = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return lambda v, age_s: wrap(v + by_rad) if len(v) == 1 else about_z @ v


def flowing(role: str, flows: Callable[[float], float]) -> Case:
    """What a velocity is read against begins to move north, at a speed by its age [m/s]: the water, or the bottom."""

    def altered(events: Events, scene: library.Scene) -> Events:
        if role not in scene.targets or scene.truth is None:
            return events
        one, along = scene.targets[role], scene.along if role == "velocity" else np.eye(3)
        result = []
        for e in events:
            if e.sensor == one.sensor and e.true_s >= FAULT_S:
                value, north_b = np.array(e.value), watched.truth_at(scene.truth, e.true_s).C_nb[0]
                value[list(one.columns)] -= along @ (flows(e.true_s - FAULT_S) * north_b)
                e = e._replace(value=tuple(value.tolist()))
            result.append(e)
        return result

    return Case(events=altered)


SITUATIONS: dict[str, Case] = {
    "no fault": Case(),
    "start told 2 km off, 140 good fixes": moved(latitude_deg=lambda x: x + 2000.0 / RADIUS_M / DEG),
    "start heading told 180 deg off, sd 5 deg": moved(heading_deg=lambda x: x + 180.0, heading_sd_deg=lambda x: 5.0),
    "compass turned by 180 deg for good": values("heading", turned(math.pi)),
    "compass 25 deg off for a minute": values("heading", turned(25.0 * DEG), end_s=FAULT_S + MINUTE_S),
    "compass turned by 180 deg from the start": values("heading", turned(math.pi), 0.0),
    "compass 25 deg off from the start": values("heading", turned(25.0 * DEG), 0.0),
    "DVL scale +5 % for good": values("velocity", lambda v, age_s: 1.05 * v),
    "DVL in mm/s for a minute": values("velocity", lambda v, age_s: 1e3 * v, end_s=FAULT_S + MINUTE_S),
    "gyros frozen for 30 s": frozen("gyro", 30.0),
    "drive all zeros for 20 s": zeros(20.0),
    "clock of the drive alone +2 s for good": restamped(2.0),
    "clock of the drive alone -2 s for good": restamped(-2.0),
    "gyro x +100 deg/h for good": values("gyro", lambda v, age_s: v + 100.0 * DEG / 3600.0 * np.eye(3)[0]),
    "gyro z +100 deg/h for good": values("gyro", lambda v, age_s: v + 100.0 * DEG / 3600.0 * np.eye(3)[2]),
    "gyro z with the sign changed for good": values("gyro", lambda v, age_s: v * [1.0, 1.0, -1.0]),
    "gyro z doubled for good": values("gyro", lambda v, age_s: v * [1.0, 1.0, 2.0]),
    "accelerometer x +50 mg for good": values("accel", lambda v, age_s: v + 0.05 * G * np.eye(3)[0]),
    "gyros x and y exchanged for good": values("gyro", lambda v, age_s: v[[1, 0, 2]]),
    "accelerometers x and y exchanged for good": values("accel", lambda v, age_s: v[[1, 0, 2]]),
    "accelerometers x and z exchanged for good": values("accel", lambda v, age_s: v[[2, 1, 0]]),
    "depth +5 m for good": values("depth", lambda v, age_s: v + 5.0),
    "depth +5 m for a minute": values("depth", lambda v, age_s: v + 5.0, end_s=FAULT_S + MINUTE_S),
    "fixes jump by 100 m for 40 s": values("position", north(lambda age_s: 100.0), 80.0, 120.0),
    "fixes drawn off at 0.5 m/s, 50 m": values("position", north(lambda age_s: 0.5 * age_s), 40.0, DIVE_S),
    "fixes 100 m off for 40 s after the dive": values("position", north(lambda age_s: 100.0), 560.0, 600.0),
}
#: Of the three components of a magnetometer; the field is 26 uT horizontally, 36 uT downwards.
FIELD: dict[str, Case] = {
    "hard iron of a tenth of the field for good": values("field", lambda v, age_s: v + np.full(3, 2.5)),
    "hard iron of half the field for a minute": values(
        "field", lambda v, age_s: v + np.array([13.0, -13.0, 13.0]), end_s=FAULT_S + MINUTE_S
    ),
    "field x with the sign changed for good": values("field", lambda v, age_s: v * np.array([-1.0, 1.0, 1.0])),
    "field z with the sign changed for good": values("field", lambda v, age_s: v * [1.0, 1.0, -1.0]),
    "field x and y exchanged for good": values("field", lambda v, age_s: v[[1, 0, 2]]),
    "field y and z exchanged for good": values("field", lambda v, age_s: v[[0, 2, 1]]),
    "field doubled for good": values("field", lambda v, age_s: 2.0 * v),
    "field x stuck at zero for good": values("field", lambda v, age_s: v * [0.0, 1.0, 1.0]),
    "field all zeros for a minute": values("field", lambda v, age_s: 0.0 * v, end_s=FAULT_S + MINUTE_S),
    "field x and y exchanged from the start": values("field", lambda v, age_s: v[[1, 0, 2]], 0.0),
    "field turned by a current, 10 deg for a minute": values("field", turned(10.0 * DEG), end_s=FAULT_S + MINUTE_S),
}
#: Of whatever else speaks of the way: water track, ranges, course.
OTHERS: dict[str, Case] = {
    "ranges 50 m too long for a minute": values("range", lambda v, age_s: v + 50.0, end_s=FAULT_S + MINUTE_S),
    "ranges 2 % too long for good": values("range", lambda v, age_s: 1.02 * v),
    "ranges in feet for good": values("range", lambda v, age_s: v / 0.3048),
    "ranges stuck for a minute": frozen("range", MINUTE_S),
    "course turned by 180 deg for 40 s": values("course", lambda v, age_s: v + np.array([0.0, math.pi]), 60.0, 100.0),
    "course in degrees": values("course", lambda v, age_s: v * [1.0, 1.0 / DEG], 60.0, 100.0),
    "speed in knots": values("course", lambda v, age_s: v * [1.0 / 0.514444, 1.0], 60.0, DIVE_S),
    "log reads 0.3 m/s too much for good": values("water", lambda v, age_s: v + np.array([0.3, 0.0, 0.0])),
    "current changes by 0.3 m/s for good": flowing("water", lambda age_s: 0.3),
    "current changes by 0.3 m/s within a minute": flowing("water", lambda age_s: 0.3 * min(1.0, age_s / MINUTE_S)),
}


#: Of the library, what the manual's page shows beside them.
SHOWN = (
    "stuck gyro and accel 5 s",
    "one gyro dead for 20 s",
    "drive NaN for 10 s",
    "gyro in deg/s for 10 s",
    "accel in g for 10 s",
    "silence drive 30 s",
    "process suspended for 20 s",
    "clock jumps forward 5 s",
    "DVL tracks the water (current of 0.3 m/s)",
    "velocity with the sign changed",
    "noise x10 velocity",
    "noise x10 heading",
    "bottom lock lost: zeros",
    "compass next to iron, 4 deg",
    "stuck heading",
    "stuck position",
    "single stamps zero",
    "bursts stamped on receipt",
    "delay drive 3 s",
)


def beams(*, mems: bool = False) -> nf.Vehicle:
    """The survey's, its DVL read beam by beam."""
    plain = survey_vehicle(mems=mems)
    dvl = plain.sensors["dvl"]
    one = nf.DvlBeams(rate_hz=dvl.rate_hz, error=nf.White(sd=0.02), lever_arm_b_m=dvl.lever_arm_b_m)
    return dataclasses.replace(plain, sensors={**plain.sensors, "dvl": one})


def with_others(**sensors: Sensor | None) -> nf.Vehicle:
    """The survey's with other sensors; None leaves one out."""
    plain = survey_vehicle()
    chosen = {**plain.sensors, **sensors}
    return dataclasses.replace(plain, sensors={name: sensor for name, sensor in chosen.items() if sensor is not None})


def ahrs() -> nf.Vehicle:
    """Roll, pitch and heading of an instrument of its own in place of the compass."""
    tilt = nf.GaussMarkov(sd=0.3 * DEG, tau_s=30.0) + nf.White(sd=0.05 * DEG)
    errors = (tilt, tilt, COMPASS + nf.White(sd=0.1 * DEG))
    return with_others(compass=None, ahrs=nf.Attitude(rate_hz=8.0, error=errors))


def wheels() -> nf.Vehicle:
    """Wheels in place of the DVL: forward speed, none sideways or upwards."""
    sideways = nf.White(sd=0.05)
    return with_others(dvl=nf.Odometer(rate_hz=10.0, error=(nf.White(sd=0.02), sideways, sideways)))


def lanes(*units: str) -> nf.Vehicle:
    """The survey's with these inertial units and dead reckoning beside them."""
    plain = survey_vehicle()
    drives = {"imu": plain.drive} if units == ("imu",) else {"imus": dict.fromkeys(units, plain.drive)}
    return nf.Vehicle(**drives, sensors=dict(plain.sensors), dead_reckoning_lane=True)


def magnetometer(**iron: float) -> nf.Vehicle:
    """A magnetometer of three axes in place of the compass."""
    return with_others(compass=nf.Heading(rate_hz=8.0, error=COMPASS, magnetometer=True, **iron))


def ranges() -> nf.Vehicle:
    """Ranges to three beacons on the bottom beside the DVL."""
    beacons = tuple((26.05 + north / RADIUS_M / DEG, -80.1 + east / RADIUS_M / DEG, -40.0) for north, east in BEACONS)
    return with_others(ranges=nf.Range(rate_hz=0.5, beacons=beacons))


def water() -> nf.Vehicle:
    """A log through the water in place of the DVL, in a current that lasts for hours."""
    track = nf.WaterVelocity(rate_hz=4.0, lever_arm_b_m=(0.5, 0.0, 0.1), current_sd_m_s=0.1, current_tau_s=6.0 * 3600.0)
    return with_others(dvl=None, water=track)


#: Stays at the surface, and has fixes all along.
BOAT = "boat"
VEHICLES: dict[str, Callable[[], nf.Vehicle]] = {
    "tactical": survey_vehicle,
    "mems": lambda: survey_vehicle(mems=True),
    "beams": beams,
    "beams-mems": lambda: beams(mems=True),
    "ahrs": ahrs,
    "usbl": lambda: with_others(usbl=nf.Usbl(rate_hz=0.2)),
    "wheels": wheels,
    "magnetometer": magnetometer,
    "iron": lambda: magnetometer(hard_iron_sd=2.0, soft_iron_sd=0.02),
    "water": water,
    "ranges": ranges,
    "course": lambda: with_others(course=nf.Course(rate_hz=1.0)),
    BOAT: lambda: with_others(dvl=None),
    "reckoning": reckoning_vehicle,
    "lane": lambda: lanes("imu"),
    "lanes": lambda: lanes("a", "b"),
}


class Lanes:
    """A navigator with lanes, fed as one with a single drive is: that is the first of its units, which is the one that
    fails; samples of the others come like readings.
    """

    def __init__(self, vehicle: nf.Vehicle, start: Start) -> None:
        self.nav = nf.LaneNavigator(vehicle, start)
        self.first = next(iter(vehicle.units))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.nav, name)

    @property
    def filter(self) -> Any:
        return self.nav.believed.filter

    def step(self, time_s: Any, first: Any, second: Any) -> None:
        self.nav.step(time_s, first, second, self.first)

    def step_samples(self, samples: np.ndarray) -> None:
        self.nav.step_samples(np.column_stack([samples, np.zeros(len(samples))]))

    def correct(self, name: Any, time_s: float, value: Any) -> Any:
        if str(name).startswith(DRIVE):
            return self.nav.step(time_s, value[:3], value[3:], name.split()[-1])
        return self.nav.correct(name, time_s, value)


def arriving(vehicle: nf.Vehicle, mission: nf.Mission) -> Events:
    """The events of a mission; those of the first inertial unit are the drive's, of others "drive" and their name."""
    if not vehicle.lanes():
        return events_of(vehicle, mission)
    first, *others = vehicle.units
    alone, read = of_one_unit(vehicle, mission, first)
    events = events_of(alone, read)
    for unit in others:
        stream = mission.streams[unit]
        rows = zip(stream.time_s.tolist(), stream.value.tolist(), strict=True)
        events += [Event(f"{DRIVE} {unit}", t, tuple(v), t, t) for t, v in rows]
    return sorted(events, key=lambda e: (round(e.true_s, 9), not e.sensor.startswith(DRIVE)))


@functools.cache
def mission_of(seed: int, which: str) -> tuple[nf.Vehicle, nf.Mission]:
    """The survey: fixes until 140 s and from 500 s on; of a boat all along."""
    vehicle = VEHICLES[which]()
    errors = {"gps": vehicle.sensors["gps"].error + nf.White(sd=0.5)}
    if "compass" in vehicle.sensors:
        errors["compass"] = vehicle.sensors["compass"].error + nf.White(sd=0.1 * DEG)
    vehicle = vehicle.with_error(**errors)
    fixes = {} if which == BOAT else {"gps": Faults(available=((0.0, DIVE_S), (BACK_S, 1e9)))}
    motion = survey(END_S, surface_s=110.0, depth_m=1.0) if which == BOAT else survey(END_S, surface_s=110.0)
    return vehicle, simulate(vehicle, motion, seed=seed, duration_s=END_S, faults=fixes)


def cases(vehicle: nf.Vehicle) -> dict[str, Case]:
    """Those above, and every kind of the library for a minute (of fixes: after the dive)."""
    scene = library.scene_of(vehicle, (FAULT_S, FAULT_S + MINUTE_S), (540.0, 580.0))

    def kind(name: str) -> Case:
        begin_s = 540.0 if "position" in name or "fixes" in name else FAULT_S + SAYS_NOTHING_S.get(name, 0.0)
        return Case(events=lambda events, _: library.damaged(name, events, scene, 1), begin_s=begin_s)

    return SITUATIONS | FIELD | OTHERS | {name: kind(name) for name in library.KINDS}


def scene_of(vehicle: nf.Vehicle, mission: nf.Mission) -> library.Scene:
    """What the faults need to know of a mission; those of the library have their own windows."""
    return dataclasses.replace(library.scene_of(vehicle, (0.0, 1.0), (0.0, 1.0)), truth=mission.truth)


def befalls(name: str, case: Case, which: str) -> bool:
    """Whether a fault changes anything for a vehicle: one without an inertial unit has no gyro that fails."""
    vehicle, mission = mission_of(1, which)
    assert mission.start is not None
    events = arriving(vehicle, mission)
    changed = case.events(events, scene_of(vehicle, mission))
    return name == "no fault" or changed != events or case.start(mission.start) != mission.start


def outcomes(options: Options) -> list[dict[str, Any]]:
    """What every fault does: how far it takes the state until the fixes are back, beside what the filter says of it.

    A survey of 700 s with fixes until 140 s and from 500 s on; the faults act for a minute from 250 s on, or as their
    names say. worst_m: greatest horizontal error of the dive, and sd_m what the filter said its sd was then; clean_m:
    the greatest without the fault. held: share of all seconds in which the truth lay within the protection radius and
    the bound of the heading; those before the first reading of any sensor do not count, for a start that is told
    wrongly cannot be known to be wrong before anything contradicts it. named_s: when something was said of it (a
    condition, a counter, an outcome that the run without it does not have); of a process that is suspended from when it
    goes on. after_m, nees: greatest error, and worst
    NEES of position, velocity and attitude, from two minutes of fixes on. Figures are the worst of the seeds.
    """
    vehicle, _ = mission_of(1, options.vehicle)
    chosen = cases(vehicle)
    if options.shown:
        chosen = {name: case for name, case in chosen.items() if name in SITUATIONS or name in SHOWN}
    return table_of(chosen, options)


def table_of(chosen: dict[str, Case], options: Options) -> list[dict[str, Any]]:
    """A row for each of these faults that changes anything for the vehicle."""
    rows = Table(COLUMNS)
    seeds = [1] if options.quick else list(range(1, options.seeds + 1))
    nf.warm_up()
    for name, case in chosen.items():
        if options.only in name and befalls(name, case, options.vehicle):
            rows.add(row_of(name, case, seeds, options.vehicle))
    if options.shown:
        print("\n".join(markdown(rows.rows)))
    return rows.rows


def row_of(name: str, case: Case, seeds: list[int], which: str) -> dict[str, Any]:
    """The worst of the seeds."""
    runs = [run(case, seed, which) for seed in seeds]
    row: dict[str, Any] = {key: max(one[key] for one in runs) for key in runs[0] if key not in ("held", "named_s")}
    row["held"] = min(one["held"] for one in runs)
    named = [one["named_s"] for one in runs]
    row["named_s"] = None if None in named else max(named)
    failures = ["crash"] * bool(row["crashes"]) + ["NEES"] * (not row["nees"] < max(WORST_NEES, 2.0 * row["usual"]))
    failures += ["bounds"] * (row["held"] < 99.9) + ["far"] * (row["worst_m"] > FAR_M)
    return {"fault": name, **row, "verdict": ", ".join(failures) or "ok"}


@functools.cache
def clean(seed: int, which: str) -> tuple[dict[int, Any], float, float]:
    """By the second what a run without a fault says, its greatest error in the dive, and its worst NEES at the end."""
    outcome, off = fly(Case(), seed, which)
    said_s = {round(t): said(state) for t, state in outcome.states}
    nees = watched.nees(outcome, mission_of(seed, which)[1].truth, JUDGED_S)
    return said_s, float(off[dived(off), 1].max()), max(nees.values())


def run(case: Case, seed: int, which: str) -> dict[str, Any]:
    """The figures of one run."""
    outcome, off = fly(case, seed, which)
    usual, clean_m, clean_nees = clean(seed, which)
    after = off[off[:, 0] > JUDGED_S]
    dive = off[dived(off)]
    worst = dive[np.argmax(dive[:, 1])] if len(dive) else np.full(5, np.nan)
    news = (t for t, s in outcome.states if t >= case.begin_s and differs(said(s), usual.get(round(t), said(s))))
    answers = (t for answer, t in outcome.first_s.items() if answer.endswith("unknown-sensor"))
    begun = min(next(news, math.inf), *answers, math.inf)
    nees = watched.nees(outcome, mission_of(seed, which)[1].truth, JUDGED_S)
    return {
        "worst_m": float(worst[1]),
        "sd_m": float(worst[2]),
        "clean_m": clean_m,
        "held": 100.0 * float(np.mean(off[:, 3])),
        "named_s": max(0.0, begun - case.begin_s) if math.isfinite(begun) else None,
        "after_m": float(after[:, 1].max()) if len(after) else math.nan,
        "nees": max(nees.values()),
        "usual": clean_nees,
        "crashes": outcome.crashes.total() + (outcome.nan_s is not None) + (outcome.not_definite_s is not None),
    }


def dived(off: np.ndarray) -> np.ndarray:
    """The rows between the fixes."""
    return (off[:, 0] > DIVE_S + 10.0) & (off[:, 0] < BACK_S)


def fly(case: Case, seed: int, which: str) -> tuple[watched.Outcome, np.ndarray]:
    """The run, and once a second: time, horizontal error, its sd, whether the bounds hold."""
    vehicle, mission = mission_of(seed, which)
    assert mission.start is not None and mission.truth is not None
    start = case.start(mission.start)
    scene = scene_of(vehicle, mission)
    events = case.events([e for e in arriving(vehicle, mission) if e.true_s >= start.time_s - 1e-9], scene)
    nav = Lanes(vehicle, start) if vehicle.lanes() else nf.Navigator(vehicle, start)
    outcome = watched.watch(nav, events, scene, longest_cpu_s=120.0)
    rows = []
    for time_s, state in outcome.states:
        heard = state.health is not None and any(s.outcomes for s in state.health.sensors.values())
        if heard and time_s <= mission.truth.time_s[-1] and state.bounds is not None:
            error = state.minus(watched.truth_at(mission.truth, time_s))
            far, bounds = math.hypot(error[0], error[1]), state.bounds
            held = far <= bounds.horizontal_m and abs(error[8]) <= bounds.heading_rad
            rows.append((time_s, far, math.hypot(state.sd[0], state.sd[1]), float(held)))
    return outcome, np.array(rows)


def said(state: nf.NavState) -> dict[str, Any]:
    """What a state says of the run: conditions, counters, outcomes, a clock of the drive that was set."""
    health = state.health
    assert health is not None
    # a good reading is refused now and then
    unused = {
        f"{name}:{status}": n // 3 if status == "rejected" else n
        for name, sensor in health.sensors.items()
        for status, n in sensor.outcomes.items()
        if status != "used"
    }
    conditions = {name: sensor.condition for name, sensor in health.sensors.items()} | dict(health.axes)
    return {**conditions, **health.drive, **unused, "drive-clock": int(health.drive_clock_offset_s != 0.0)}


def differs(now: dict[str, Any], usual: dict[str, Any]) -> bool:
    """Whether something is said that is not said without the fault."""
    return any(
        value != usual.get(key, 0) and value not in ("good", "waiting") for key, value in now.items() if value != 0
    )


def markdown(rows: list[dict[str, Any]]) -> list[str]:
    """The table of the manual."""
    lines = [
        "| fault | greatest error in the dive [m] | sd said [m] | held [%] | named within [s] | after, NEES | |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        named = "-" if row["named_s"] is None else f"{row['named_s']:.0f}"
        figures = f"{row['worst_m']:.1f} | {row['sd_m']:.1f} | {row['held']:.1f} | {named} | {row['nees']:.1f}"
        lines.append(f"| {row['fault']} | {figures} | {row['verdict']} |")
    return lines

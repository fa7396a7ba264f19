"""Runs with faults: the missions, what hands the events to a navigator as a driver would, and what it looks at
meanwhile.
"""

from __future__ import annotations

import math
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from faults_library import DEG, Scene, damaged
from feeding import DRIVE, Event, Events, events_of, one_by_one

import navfilter as nf
from navfilter.models.mission import Mission, Stream
from navfilter.models.state import NavState, matrix_from_euler
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.navigator import Navigator
from navfilter.simulation.scenarios import lawnmower, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

#: A smallest eigenvalue (of the covariance scaled to a unit diagonal) at or below this is not positive definite. Models
#: without white noise make covariances that are singular for a moment after a reading; what an eigenvalue is rounded by
#: is n^2 eps = 2e-13.
DEFINITE = -1e-12
#: Of processor time is as much as a run of eight minutes may take [s]; without a fault it takes one or two.
LONGEST_CPU_S = 20.0

# --- missions --------------------------------------------------------------------------------------------------------


def simulated(
    seed: int, duration_s: float = 480.0, fixes: tuple[tuple[float, float], ...] = ((0.0, 120.0), (270.0, 1e9))
) -> tuple[Vehicle, Mission]:
    """A lawnmower by the survey vehicle, with position fixes in two stretches only: the faults of other sensors act in
    between.

    Compass and fixes have white noise beside their coloured error, so that no covariance has a reason to be singular.
    """
    plain = survey_vehicle()
    vehicle = plain.with_error(
        compass=plain.sensors["compass"].error + nf.White(sd=0.1 * DEG),
        gps=plain.sensors["gps"].error + nf.White(sd=0.5),
    )
    motion = lawnmower(duration_s)
    return vehicle, simulate(
        vehicle,
        motion,
        seed=seed,
        duration_s=duration_s,
        faults={"gps": Faults(available=fixes)},
        name=f"faults-{seed}",
    )


# --- the run, watched -----------------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """What a run with a fault showed.

    Attributes
    ----------
    crashes : Counter
        Exceptions by place and message.
    nan_s, not_definite_s : float or None
        Time of the first NaN in state or covariance, of the first covariance that is not positive definite.
    smallest : float
        Smallest eigenvalue of the covariance scaled to a unit diagonal, over the run.
    counts : Counter
        By "role:outcome", "drive:counter", and seconds of "role is condition" (see `navfilter.faults.sensor_monitor`).
    first_s : dict
        By "role:outcome", the true time of the first reading with it.
    sent, answered : int
        Readings handed in, and outcomes that came back for them.
    states : list of (float, NavState)
        Once a second: true time and state.
    cpu_s : float
        Processor time of the run.
    stopped : bool
        It took more processor time than it may, and was not fed to the end.
    """

    crashes: Counter = field(default_factory=Counter)
    nan_s: float | None = None
    not_definite_s: float | None = None
    smallest: float = math.inf
    counts: Counter = field(default_factory=Counter)
    first_s: dict[str, float] = field(default_factory=dict)
    sent: int = 0
    answered: int = 0
    states: list[tuple[float, NavState]] = field(default_factory=list)
    cpu_s: float = 0.0
    stopped: bool = False


def watch(
    nav: Navigator,
    events: Events,
    scene: Scene,
    *,
    check_s: float = 1.0,
    one_by_one: bool = False,
    longest_cpu_s: float = LONGEST_CPU_S,
) -> Outcome:
    """Hand all events to a navigator in the order of delivery, and look at it every `check_s` seconds.

    Samples of the drive that arrive without a correction in between go in as one block, as a driver would read them (or
    one by one: it is the same arithmetic). Exceptions are noted and the run goes on.
    """
    outcome = Outcome()
    roles = {target.sensor: role for role, target in scene.targets.items() if target.sensor != DRIVE}
    block: list[tuple[float, ...]] = []
    last: Event | None = None
    reading: Event | None = None
    due, began = -math.inf, time.process_time()
    for event in events:
        if event.sensor == DRIVE:
            if _regular(event) and not one_by_one:
                block.append((event.time_s, *event.value))
            else:
                _flush(nav, block, outcome)
                value = event.value if isinstance(event.value, tuple) else (event.value,)
                _guard(outcome, nav.step, event.time_s, value[:3], value[3:])
            last = event
        else:
            _flush(nav, block, outcome)
            _correct(nav, event, roles, outcome)
            reading = event
        if event.arrival_s >= due and last is not None:
            _flush(nav, block, outcome)
            due = event.arrival_s + check_s
            if time.process_time() - began > longest_cpu_s:
                outcome.stopped = True
                break
            _look(nav, last, reading, outcome)
            for name, sensor in nav.health.sensors.items():
                outcome.counts[f"{roles.get(name, name)} is {sensor.condition}"] += 1
    _flush(nav, block, outcome)
    if last is not None:
        _look(nav, last, reading, outcome)
    outcome.cpu_s = time.process_time() - began
    outcome.counts.update({f"drive:{name}": n for name, n in nav.counts.items()})
    return outcome


def _regular(event: Event) -> bool:
    value = event.value
    return (
        type(event.time_s) is float
        and isinstance(value, tuple)
        and len(value) == 6
        and all(type(v) is float for v in value)
    )


def _guard(outcome: Outcome, call: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except Exception as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "/navfilter/" in f.filename] or [
            traceback.extract_tb(error.__traceback__)[-1]
        ]
        place = f"{frames[-1].filename.rsplit('/', 1)[-1]}:{frames[-1].name}"
        outcome.crashes[f"{place}: {type(error).__name__}: {str(error)[:90]}"] += 1
        return None


def _flush(nav: Navigator, block: list[tuple[float, ...]], outcome: Outcome) -> None:
    if block:
        _guard(outcome, nav.step_samples, np.array(block))
        block.clear()


def _correct(nav: Navigator, event: Event, roles: dict[str, str], outcome: Outcome) -> None:
    outcome.sent += 1
    result = _guard(outcome, nav.correct, event.sensor, event.time_s, event.value)
    if result is None:
        return
    outcome.answered += 1
    role = roles.get(event.sensor, "unknown") if isinstance(event.sensor, str) else "unknown"
    outcome.counts[f"{role}:{result.status}"] += 1
    outcome.first_s.setdefault(f"{role}:{result.status}", event.true_s)


def _look(nav: Navigator, last: Event, reading: Event | None, outcome: Outcome) -> None:
    """Note NaN, a covariance that is not positive definite, and the state at the instant at which it truly holds: by
    the last sample of the drive, or, where that is silent, by the last reading.
    """
    state = _guard(outcome, lambda: nav.state)
    P = nav.filter.P
    finite = all(np.isfinite(array).all() for array in (P, nav.filter.nav, nav.filter.x))
    if state is None or not finite or not np.isfinite(state.covariance).all():
        outcome.nan_s = last.true_s if outcome.nan_s is None else outcome.nan_s
        return
    sd = np.sqrt(np.maximum(np.diag(P), 0.0))
    if (sd == 0.0).any():
        smallest = 0.0
    else:
        smallest = float(np.linalg.eigvalsh(P / np.outer(sd, sd)).min())
    outcome.smallest = min(outcome.smallest, smallest)
    if smallest <= DEFINITE and outcome.not_definite_s is None:
        outcome.not_definite_s = last.true_s
    # a clock that was set moves the stamps, not the instant: of two that differ the one counts that the state goes by
    there = [e for e in (last, reading) if e is not None and isinstance(e.time_s, float) and math.isfinite(e.time_s)]
    ahead, at = [state.time_s - nav.offset_s - e.time_s for e in there], 0
    if there:
        at = min(range(len(there)), key=lambda k: abs(ahead[k]))
    near = bool(there) and abs(ahead[at]) < 2.0
    outcome.states.append((there[at].true_s + ahead[at] if near else last.true_s, state))


def truth_at(truth: Stream, time_s: float) -> NavState:
    """The truth at an instant, between its rows."""
    k = int(np.clip(np.searchsorted(truth.time_s, time_s), 1, len(truth.time_s) - 1))
    rows = truth.value[k - 1 : k + 1].copy()
    rows[:, 6:9] = np.unwrap(rows[:, 6:9], axis=0)
    share = (time_s - truth.time_s[k - 1]) / (truth.time_s[k] - truth.time_s[k - 1])
    row = rows[0] + share * (rows[1] - rows[0])
    return NavState(time_s, float(row[0]), float(row[1]), float(row[2]), row[3:6], matrix_from_euler(*row[6:9]))


def nees(outcome: Outcome, truth: Stream, begin_s: float, end_s: float = math.inf) -> dict[str, float]:
    """Mean normalised squared error per degree of freedom of position, velocity and attitude between two instants."""
    parts: dict[str, list[float]] = {"position": [], "velocity": [], "attitude": []}
    for time_s, state in outcome.states:
        if not begin_s <= time_s <= min(end_s, truth.time_s[-1]):
            continue
        error, P = state.minus(truth_at(truth, time_s)), state.covariance
        for k, values in enumerate(parts.values()):
            e = error[3 * k : 3 * k + 3]
            values.append(float(e @ np.linalg.pinv(P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], hermitian=True) @ e) / 3.0)
    return {name: float(np.mean(values)) if values else math.nan for name, values in parts.items()}


def run(name: str | None, vehicle: Vehicle, mission: Mission, scene: Scene, seed: int, **options: Any) -> Outcome:
    """One mission with one kind of fault (None: without)."""
    events = events_of(vehicle, mission)
    start = mission.start
    events = [e for e in events if e.true_s >= start.time_s - 1e-9]
    if name is not None:
        events = damaged(name, events, scene, seed)
    return watch(nf.Navigator(vehicle, start), events, scene, **options)


def dived(
    vehicle: nf.Vehicle,
    mission: nf.Mission,
    sensor: str,
    change: Callable[[np.ndarray], np.ndarray],
    fault_s: float,
    dive_s: float = 100.0,
) -> tuple[nf.Navigator, float]:
    """The navigator at the end of a mission without fixes from `dive_s` on, in which one sensor reads otherwise from
    `fault_s` on; and how far off it is [m].
    """
    nav = nf.Navigator(vehicle, mission.start, threads=False)
    events = [e for e in events_of(vehicle, mission) if e.sensor != "gps" or e.time_s < dive_s]
    wrong = [
        e._replace(value=tuple(change(np.array(e.value)).tolist())) if e.sensor == sensor and e.time_s >= fault_s else e
        for e in events
    ]
    one_by_one(nav, wrong)
    error = nav.state.minus(truth_at(mission.truth, nav.time_s))
    return nav, math.hypot(*error[:2])

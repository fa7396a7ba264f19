"""How long one `step`, one `correct` and a start take in the vehicle's own loop, beside filterpy and python-ins.

The standard hour, the compass's error learnt under way (but with ``--plain``), is fed to a navigator reading by
reading, every call timed by itself: once as Python comes, once after `gc.collect(); gc.freeze()`, and by the wall clock
as well as by the thread's processor clock (on a machine that does other work too, the wall clock's highest percentiles
are the scheduler's).

filterpy: `KalmanFilter.predict` and `update` with matrices of the same size. python-ins: its feedback filter with one
inertial sample per turn of its loop, mean of 25 samples (see `baselines`). Ratios are those of the medians.

The calls that took longest are shown with what happened in them: a run more, with ``--pace`` times the speed of the
mission, as fast as the learning thread follows. What a call took by the wall clock and not by the processor's it stood
in the queue for a processor, or waited for another thread (for an answer of learning, or for Python's lock).

Starts are timed in a process of their own: from nothing (an empty NUMBA_CACHE_DIR) and again with what that one left,
from the first line of Python to the first state after ten samples and a reading of each sensor.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from baselines import filterpy_times, pyins_filter
from harness import DEG, Array, Options, Table, flag, hour, main, quick

import navfilter as nf
from navfilter.filter.filter import Filter
from navfilter.learning.background import Worker
from navfilter.learning.open_loop_series import OpenLoopSeries
from navfilter.navigation.early_rerun import ShadowRun
from navfilter.navigation.runner import History
from navfilter.playback.replay import drive_samples

SHARES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
#: Of our calls: percentile, and the aim in medians of filterpy's predict or update of the same size.
AIMS = (
    ("step", "p99.9", 3.0, "predict"),
    ("correct", "p50", 0.5, "update"),
    ("correct", "p99.9", 4.0, "update"),
)
#: No call is to take longer [us].
LONGEST_US = 2000.0
#: So many of the slowest calls are shown.
SLOWEST = 20
#: What may take long in a call.
WATCHED = {
    "checkpoint": (History, "_mark"),
    "rewinding": (History, "correct_late"),
    "adoption": (Filter, "adopt"),
    "look begun": (OpenLoopSeries, "begin_hop"),
    "answer taken": (OpenLoopSeries, "learnt"),
    "twin made": (ShadowRun, "__init__"),
    "twin awaited": (ShadowRun, "arrived"),
    "thread told": (Worker, "begin"),
}
START = """
import time
began = time.perf_counter()
import navfilter as nf
vehicle = nf.Vehicle(
    imu=nf.Imu(rate_hz=100, gyro=nf.White(density=1e-4) + nf.RandomWalk(density=1e-6, start_sd=1e-4)),
    sensors={"compass": nf.Heading(rate_hz=8, error=nf.GaussMarkov(sd=0.01, tau_s=30.0) + nf.White(sd=0.002)),
             "dvl": nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01)), "depth": nf.Depth(rate_hz=1)})
if {warm}:
    nf.warm_up()
nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0))
for k in range(1, 11):
    nav.step(0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
for name, value in (("compass", 0.0), ("dvl", (0.1, 0.0, 0.0)), ("depth", 0.0)):
    nav.correct(name, 0.1, value)
assert nav.state.time_s == 0.1
print(time.perf_counter() - began, time.process_time())
"""
Event = tuple[str, float, Any, Any]


def readings(vehicle: nf.Vehicle, mission: nf.Mission) -> list[Event]:
    """Everything in order of time, as plain tuples: what a driver would hand over. Of readings with the same time,
    samples come first, then sensors as the vehicle names them; so no reading is late that would not be on board.
    """
    times, values = drive_samples(vehicle, mission)
    rows = zip(times.tolist(), values.tolist(), strict=True)
    events: list[Event] = [("", t, tuple(v[:3]), tuple(v[3:])) for t, v in rows]
    for name in vehicle.sensors:
        stream = mission.streams[name]
        rows = zip(stream.time_s.tolist(), stream.value.tolist(), strict=True)
        events += [(name, t, tuple(v), None) for t, v in rows]
    # the sort keeps the order of what is alike
    events = sorted(events, key=lambda e: round(e[1], 9))
    gc.collect()  # no vehicle has a list of all that is to come: each collection would go through it while it is young
    return events


def timed(nav: nf.Navigator, events: list[Event], clock: Callable[[], int]) -> dict[str, Array]:
    """Seconds of every call, by what was called; those of readings for which the state went back are apart: of
    readings with the same time, those of the sensors named first come first, whatever the order of arrival.
    """
    n = sum(not name for name, *_ in events)
    steps, corrections, back = np.empty(n), np.empty(len(events) - n), np.zeros(len(events) - n, bool)
    i = j = 0
    for name, time_s, first, second in events:
        if name:
            began = clock()
            outcome = nav.correct(name, time_s, first)
            corrections[j] = clock() - began
            back[j] = outcome.status == "late-replayed"
            j += 1
        else:
            began = clock()
            nav.step(time_s, first, second)
            steps[i] = clock() - began
            i += 1
    spent = {"step": steps, "correct": corrections[~back], "correct, back": corrections[back]}
    return {call: 1e-9 * seconds for call, seconds in spent.items() if seconds.size}


class Causes:
    """While it is entered, notes what happens in this thread's calls, and for how long [us]."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self._mine, self._began = threading.get_ident(), 0
        self._originals = {name: vars(kind)[method] for name, (kind, method) in WATCHED.items()}

    def __enter__(self) -> Causes:
        for name, (kind, method) in WATCHED.items():
            setattr(kind, method, self._noting(name, self._originals[name]))
        gc.callbacks.append(self._collected)
        return self

    def __exit__(self, *_: object) -> None:
        gc.callbacks.remove(self._collected)
        for name, (kind, method) in WATCHED.items():
            setattr(kind, method, self._originals[name])

    def _noting(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*args: Any, **named: Any) -> Any:
            began = time.perf_counter_ns()
            result = work(*args, **named)
            self._note(name, began)
            return result

        return noted

    def _note(self, name: str, began: int) -> None:
        if threading.get_ident() == self._mine:
            self.notes.append(f"{name} {(time.perf_counter_ns() - began) // 1000}")

    def _collected(self, phase: str, found: dict[str, int]) -> None:
        if phase == "start":
            self._began = time.perf_counter_ns()
        else:
            self._note(f"collector ({found['generation']})", self._began)


def queued_ns() -> int:
    """How long this thread has stood in the queue for a processor; 0 where nobody says."""
    try:
        with open("/proc/thread-self/schedstat") as file:
            return int(file.read().split()[1])
    except OSError:
        return 0


def slowest(vehicle: nf.Vehicle, mission: nf.Mission, pace: float) -> tuple[list[dict[str, Any]], nf.Navigator]:
    """The slowest calls by the processor's clock, and why; the readings come `pace` times as fast as they did."""
    nav, events, rows = nf.Navigator(vehicle, mission.start), readings(vehicle, mission), []
    times = np.empty((len(events), 3))
    with Causes() as causes:
        why: dict[int, str] = {}
        first_s, first = events[0][1], time.perf_counter()
        for k, (name, time_s, one, other) in enumerate(events):
            early_s = first + (time_s - first_s) / pace - time.perf_counter()
            if early_s > 0.002:
                time.sleep(early_s)
            causes.notes.clear()
            before = queued_ns(), time.thread_time_ns(), time.perf_counter_ns()
            if name:
                nav.correct(name, time_s, one)
            else:
                nav.step(time_s, one, other)
            after = time.perf_counter_ns(), time.thread_time_ns(), queued_ns()
            times[k] = after[0] - before[2], after[1] - before[1], after[2] - before[0]
            if causes.notes:
                why[k] = ", ".join(causes.notes)
    for k in np.argsort(-times[:, 1])[:SLOWEST].tolist():
        wall, processor, queue = (1e-3 * times[k]).tolist()
        row = {"time_s": events[k][1], "call": events[k][0] or "step", "wall": wall, "processor": processor}
        rows.append(row | {"queue": queue, "causes": why.get(k, "")})
    return rows, nav


def percentiles(call: str, clock: str, seconds: Array) -> dict[str, Any]:
    """A row of the table: percentiles in microseconds, and how many calls took longer than 10 ms."""
    found = np.percentile(seconds, list(SHARES.values())) * 1e6
    row = {"call": call, "clock": clock, **dict(zip(SHARES, found.tolist(), strict=True))}
    return row | {"over_10_ms": int((seconds > 0.01).sum())}


def navfilter_rows(vehicle: nf.Vehicle, mission: nf.Mission, turns: int) -> list[dict[str, Any]]:
    """Our calls: by both clocks, as Python comes and with what is there frozen; then each call as it was in the best of
    so many runs, which all do the same: what other processes do to a call, and to the caches before it, is left out.
    """
    events = readings(vehicle, mission)
    timed(nf.Navigator(vehicle, mission.start), events[:10000], time.perf_counter_ns)
    rows = []
    for frozen in ("", ", gc.freeze()"):
        if frozen:
            gc.collect()
            gc.freeze()
        for clock, name in ((time.perf_counter_ns, "wall"), (time.thread_time_ns, "processor")):
            spent = timed(nf.Navigator(vehicle, mission.start), events, clock)
            rows += [percentiles(f"navfilter {call}{frozen}", name, seconds) for call, seconds in spent.items()]
    runs = [timed(nf.Navigator(vehicle, mission.start), events, time.thread_time_ns) for _ in range(turns)]
    for call in runs[0]:
        best = np.min([run[call] for run in runs], axis=0)
        rows.append(percentiles(f"navfilter {call}, best of {turns}", "processor", best))
    gc.unfreeze()
    return rows


def starts() -> list[dict[str, Any]]:
    """Seconds to the first state and of the processor, with an empty cache and with a full one."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name, warm, times in (("from nothing", True, 1), ("warm cache", True, 3), ("warm cache", False, 3)):
            command, runs = [sys.executable, "-c", START.replace("{warm}", str(warm))], []
            for _ in range(times):
                done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
                runs.append(tuple(map(float, done.stdout.split())))
            wall, processor = min(runs)
            rows.append({"start": name, "warm_up": warm, "wall_s": wall, "processor_s": processor})
    return rows


def step_latency(options: Options) -> dict[str, Any]:
    """Time every call."""
    minutes = 1.0 if options.quick else options.minutes
    base, mission = hour(minutes)
    prior = nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0)
    learnt = nf.LearnedArma(prior=prior) + nf.White(sd=0.1 * DEG)
    vehicle = base if options.plain else base.with_error(compass=learnt)
    nf.warm_up()
    states = 9 + len(nf.Navigator(vehicle, mission.start).errors)
    print(f"{minutes:g} min, {states} error states{'' if options.plain else ', compass learnt'}; microseconds per call")
    table = Table("call<32 clock<9 p50>9.1f p99>9.1f p99.9>9.1f max>9.1f over_10_ms>10d")
    turns = 2 if options.quick else options.turns
    for row in navfilter_rows(vehicle, mission, turns):
        table.add(row)
    kf = filterpy_times(states, 2000 if options.quick else 20000, 7)
    imu = mission.streams["imu"]
    samples = np.column_stack([imu.time_s, imu.value])[: 200 if options.quick else 2000]
    table.add(percentiles("filterpy predict", "wall", kf.predict))
    table.add(percentiles("filterpy update", "wall", kf.update))
    table.add(percentiles("python-ins step (15 states)", "wall", pyins_filter(samples, mission.start, 0.01)))
    us = {(row["call"], row["clock"]): row for row in table.rows}
    ours = us["navfilter step", "wall"]["p50"]
    ratios = {who: us[who, "wall"]["p50"] / ours for who in ("filterpy predict", "python-ins step (15 states)")}
    print("\n".join(f"median of {who}: {times:.1f} times ours" for who, times in ratios.items()))
    for call, share, aim, theirs in AIMS:
        unit = us[f"filterpy {theirs}", "wall"]["p50"]
        named = ("", "wall"), ("", "processor"), (f", best of {turns}", "processor")
        found = ", ".join(f"{us[f'navfilter {call}{how}', clock][share] / unit:.2f}" for how, clock in named)
        print(f"{call} {share} in medians of filterpy's {theirs}: {found} (wall, processor, best); aim {aim:g}")
    rows, nav = slowest(vehicle, mission, options.pace)
    print(f"the slowest calls at {options.pace:g} times the mission's speed [us]; aim: none beyond {LONGEST_US:g}")
    slow = Table("time_s>9.2f call<8 wall>9.0f processor>9.0f queue>9.0f causes<60")
    for row in rows:
        slow.add(row)
    late = nav.health.learning
    print(f"answers of learning that were late: {late.late}, waited for {1e3 * late.waited_s:.1f} ms")
    began = None
    if not (options.quick or options.no_start):
        began = Table("start<14 warm_up<8d wall_s>8.2f processor_s>8.2f")
        for row in starts():
            began.add(row)
    figures = {"minutes": minutes, "states": states, "us": table.rows, "ratios": ratios, "slowest": slow.rows}
    return figures | {"starts": began and began.rows}


if __name__ == "__main__":
    flags = [
        flag("--minutes", type=float, default=60.0),
        flag("--turns", type=int, default=5, help="runs of which each call's best is taken"),
        flag("--pace", type=float, default=10.0, help="speed of the run whose slowest calls are shown"),
        flag("--plain", action="store_true", help="nothing is learnt"),
        flag("--no-start", action="store_true", help="leave out the starts"),
        quick("one minute, without the starts"),
    ]
    main(__doc__, {step_latency: flags})

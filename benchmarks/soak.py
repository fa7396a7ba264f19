"""A day with a fault every ten minutes, lived in the vehicle's own loop: memory stays flat, and the state consistent.

The racetrack of `day.py` with learning on: compass, DVL, depth, and fixes for two minutes of every thirty, 0.7 s late.
Every ten minutes one of `FAULTS` acts, in an order drawn from the seed; one of them ends the navigator and goes on from
its snapshot. Every hour: resident memory, the size of a snapshot, the smallest eigenvalue of the scaled covariance, the
largest error and the share of seconds within the bounds, and the NEES at the end of the fixes.
There is no other software to compare with. The exit code is 1 where a bar is missed: anything not finite or not
definite, memory or snapshot that grow by more than `GROWTH` from the second hour on, or a NEES at the end of the fixes
beyond `HONEST`.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import day
import numpy as np
from harness import Array, Options, Table, flag, main, quick

import navfilter as nf

EVERY_S, AT_S = 600.0, 200.0
GROWTH, HONEST = 1.05, 6.0
#: Of a covariance scaled to a unit diagonal; see tests/faults_run.py.
DEFINITE = -1e-12
HOURLY = "hour>6.1f rss_mb>8.1f snapshot_kb>11.1f smallest>9.1e worst_m>8.1f within>7.3f nees>6.2f lost_s>6d faults>6d"
#: By name: how long each lasts [s].
FAULTS = {
    "compass turned by 60 degrees": 40.0,
    "compass stuck": 40.0,
    "DVL silent": 60.0,
    "DVL 20 % too fast": 30.0,
    "depth 5 m off": 30.0,
    "fixes 300 m off": 60.0,
    "a gyro stuck": 15.0,
    "an accelerometer saturated": 10.0,
    "NaN from the drive": 2.0,
    "spikes of the drive": 30.0,
    "drive silent": 3.0,
    "clock of the drive 3 s ahead": 60.0,
    "readings late by a second": 60.0,
    "rubbish for readings": 30.0,
    "restart from a snapshot": 0.0,
}


@dataclass
class Soaked:
    """What a run showed, by hour, and what became of it."""

    rows: list[dict[str, float]] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    nees: list[float] = field(default_factory=list)
    smallest: float = math.inf
    finite: bool = True

    @property
    def growth(self) -> tuple[float, float]:
        """Last over second hour: of resident memory, and of a snapshot."""
        first, last = self.rows[min(1, len(self.rows) - 1)], self.rows[-1]
        return last["rss_mb"] / first["rss_mb"], last["snapshot_kb"] / first["snapshot_kb"]

    @property
    def failures(self) -> list[str]:
        """The bars that were missed."""
        memory, snapshot = self.growth
        missed = [] if self.finite else ["not finite"]
        missed += [] if self.smallest > DEFINITE else [f"not definite ({self.smallest:.1e})"]
        missed += [] if memory < GROWTH else [f"memory grew to {memory:.2f}"]
        missed += [] if snapshot < GROWTH else [f"snapshots grew to {snapshot:.2f}"]
        honest = not self.nees or float(np.median(self.nees)) < HONEST
        return missed + ([] if honest else [f"NEES {np.median(self.nees):.1f} at the end of the fixes"])


class Weather:
    """Which fault acts when, and what it does to samples and readings."""

    def __init__(self, seed: int) -> None:
        self.rng, self.names = np.random.default_rng([seed, 7]), list(FAULTS)
        self.order: list[str] = []
        self.kept: dict[str, Any] = {}

    def at(self, number: int) -> str:
        """The fault of a stretch of ten minutes: each once before any comes again."""
        while len(self.order) <= number:
            self.order += self.rng.permutation(self.names).tolist()
        return self.order[number]

    def now(self, time_s: float) -> str:
        """What acts at a time; "" for nothing."""
        number, into = divmod(time_s, EVERY_S)
        name = self.at(int(number))
        return name if 0.0 <= into - AT_S < FAULTS[name] else ""

    def samples(self, name: str, stamps: Array, values: Array) -> tuple[Array, Array] | None:
        """Samples of the drive under a fault; None where there are none."""
        values = values.copy()
        if name == "drive silent":
            return None
        if name == "a gyro stuck":
            values[:, 2] = self.kept.setdefault(name, values[0, 2])
        elif name == "an accelerometer saturated":
            values[:, 3] = 160.0
        elif name == "NaN from the drive":
            values[:, int(self.rng.integers(6))] = np.nan
        elif name == "spikes of the drive" and self.rng.random() < 0.01:
            values[0, int(self.rng.integers(3))] += 1.0
        elif name == "clock of the drive 3 s ahead":
            stamps = stamps + 3.0
        return stamps, values

    def reading(self, name: str, sensor: str, time_s: float, value: Array) -> tuple[float, Any] | None:
        """A reading under a fault; None where there is none."""
        match name, sensor:
            case ("compass turned by 60 degrees", "compass"):
                value = value + 1.05
            case ("compass stuck", "compass"):
                value = self.kept.setdefault(name, value.copy())
            case ("DVL silent", "dvl"):
                return None
            case ("DVL 20 % too fast", "dvl"):
                value = 1.2 * value
            case ("depth 5 m off", "depth"):
                value = value + 5.0
            case ("fixes 300 m off", "gps"):
                value = value + np.array([3e-5, 4e-5, 0.0])
            case ("readings late by a second", _):
                time_s -= 1.0  # an old stamp: what it says is of another time
            case ("rubbish for readings", _):
                value = (math.nan, "x", [1.0] * 9, 1e300, None)[int(self.rng.integers(5))]
        return time_s, value


def soaked(hours: float, seed: int, rate_hz: int, show: bool = True) -> Soaked:
    """Live so many hours.

    Parameters
    ----------
    hours : float
    seed : int
    rate_hz : int
        Of the inertial unit.
    show : bool
        Print a row for every hour.
    """
    day.RATE_HZ = rate_hz
    believed, really = day.vehicle(True)
    laps, rng, weather = day.Laps(really, seed), np.random.default_rng(seed + 1), Weather(seed)
    nav = nf.Navigator(believed, day.start_at(laps.truth(0.0), rng))
    found, table = Soaked(), Table(HOURLY) if show else None
    seconds: list[tuple[float, bool, bool]] = []  # of this hour: error, within the bounds, lost
    restarted, before, imu = -1, "", np.empty((laps.n, 6))
    for time_s, what, value in _inputs(laps, imu, hours, rng):
        name = weather.now(time_s)
        if name != before:
            before = name
            weather.kept.clear()
            found.faults[name] += bool(name)
        number = int(time_s // EVERY_S)
        if weather.at(number) == "restart from a snapshot" and restarted < number and time_s % EVERY_S >= AT_S:
            restarted = number
            nav = nf.Navigator.restore(believed, nav.snapshot())
            found.faults["restart from a snapshot"] += 1
        if what == "imu":
            given = weather.samples(name, *value)
            if given is not None:
                nav.step(given[0], given[1][:, :3], given[1][:, 3:])
        elif what == "second":
            if abs(nav.time_s - time_s) < 1e-6:
                seconds.append(_second(nav, laps, found, time_s))
            if time_s % 3600.0 < 1e-6 or time_s >= hours * 3600.0 - 1.0:
                found.rows.append(_hour(nav, found, seconds, time_s))
                seconds = []
                if table is not None:
                    table.add(found.rows[-1])
        else:
            given = weather.reading(name, what, *value)
            if given is not None:
                nav.correct(what, *given)
    return found


def _inputs(laps: day.Laps, imu: Array, hours: float, rng: np.random.Generator) -> Iterator[tuple[float, str, Any]]:
    """Everything that arrives, in order: blocks of samples, readings, and the full seconds."""
    waiting: list[Any] = []
    for lap in range(math.ceil(hours * 3600.0 / laps.duration_s)):
        begin_s, done = lap * laps.duration_s, 0
        laps.fill(imu)
        whole = [(float(s), "second", 0.0, None) for s in range(1, round(laps.duration_s) + 1)]
        events = sorted([*waiting, *laps.events(begin_s), *whole], key=lambda e: e[0])
        waiting = [(a - laps.duration_s, n, t - laps.duration_s, v) for a, n, t, v in events if a > laps.duration_s]
        for arrival_s, name, time_s, value in events:
            until = min(int(arrival_s * day.RATE_HZ + 1e-6), laps.n)
            while done < until:
                end = min(until, done + int(rng.integers(1, 13)))
                stamps = begin_s + np.arange(done + 1, end + 1) / day.RATE_HZ
                yield float(stamps[-1]), "imu", (stamps, imu[done:end])
                done = end
            if arrival_s <= laps.duration_s and begin_s + arrival_s <= hours * 3600.0:
                yield begin_s + arrival_s, name, (begin_s + time_s, value)


def _second(nav: nf.Navigator, laps: day.Laps, found: Soaked, time_s: float) -> tuple[float, bool, bool]:
    state = nav.state
    error, P = state.minus(laps.truth(time_s)), state.covariance
    found.finite &= bool(np.isfinite(error).all() and np.isfinite(P).all())
    if time_s % 60.0 < 1e-6 and found.finite:
        sd = np.sqrt(np.diag(nav.filter.P))
        found.smallest = min(found.smallest, float(np.linalg.eigvalsh(nav.filter.P / np.outer(sd, sd)).min()))
    if abs(time_s % day.FIXES_EVERY_S - day.FIXES_FOR_S) < 1e-6:
        found.nees.append(float(error[:3] @ np.linalg.solve(P[:3, :3], error[:3])) / 3.0)
    off = math.hypot(error[0], error[1])
    return off, off <= state.bounds.horizontal_m, state.trust.level == "lost"


def _hour(nav: nf.Navigator, found: Soaked, seconds: list[tuple[float, bool, bool]], time_s: float) -> dict[str, float]:
    errors = np.array(seconds, dtype=float).reshape(-1, 3)
    return {
        "hour": time_s / 3600.0,
        "rss_mb": day.resident_mb(),
        "snapshot_kb": len(nav.snapshot()) / 1024.0,
        "smallest": found.smallest,
        "worst_m": float(errors[:, 0].max(initial=0.0)),
        "within": float(errors[:, 1].mean()) if len(errors) else math.nan,
        "nees": float(np.mean(found.nees[-2:])) if found.nees else math.nan,
        "lost_s": int(errors[:, 2].sum()),
        "faults": found.faults.total(),
    }


def soak(options: Options) -> dict[str, Any]:
    """Live a day with faults."""
    nf.warm_up()
    began = time.process_time()
    found = soaked(0.5 if options.quick else options.hours, options.seed, options.rate_hz)
    memory, snapshot = found.growth
    print(f"{found.faults.total()} faults; {time.process_time() - began:.0f} s of processor time")
    print(f"memory {memory:.3f}, snapshot {snapshot:.3f} of what they were in the second hour")
    print(", ".join(found.failures) or "all bars held")
    return {"rows": found.rows, "faults": found.faults, "nees": found.nees, "failures": found.failures}


if __name__ == "__main__":
    flags = [
        flag("--hours", type=float, default=24.0),
        flag("--seed", type=int, default=1),
        flag("--rate-hz", type=int, default=25, help="of the inertial unit (default: %(default)s)"),
        quick("half an hour"),
    ]
    sys.exit(1 if main(__doc__, {soak: flags})["failures"] else 0)

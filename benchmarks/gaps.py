"""Gaps as the judge: fixes are hidden in many windows and phases of every recording with a truth.

Each sensor that gives headings or velocities is described in seven ways: as set by hand, as white noise of the same
size, as a Gauss-Markov error of 30 s, and as set with standard deviations that are 3 and 5 times too small and too
large. Compared, gap by gap, is the vehicle as described with the same one that learns in the mission, and with
``--over-dives`` also with what `navfilter learn` makes of all other recordings of the vehicle (leave one out). No other
software is asked.

| kind | recordings | fixes given | judged |
|---|---|---|---|
| dive | AUV, own inertial unit, DVL | the start alone | all of it |
| dive-gaps | the same | 20 s in 120 | last 10 s of each gap |
| car | wheels, compass, inertial unit | 5 s in 60 | last 10 s |
| lake | dead reckoning by DVL and attitude | 15 s in 120 | last 10 s, against the fixes |
| comma | car, one minute | 4 s in 20 | last 5 s |
| mower | gyro, odometer | radio ranges for 20 s in 60 | last 10 s |
| yacht | compass and log, hours | 10 s in 600 after half an hour | last 10 s, against the fixes |

Printed by kind and description: gaps; rms of the horizontal error and NEES, as described and learnt; the ratio of both
rms, as the geometric mean over recordings, with the range that 90 % of bootstraps over recordings give, and over that
of the file as set. Halves of the recordings ("odd", "even") can be asked for: choose on one, report on the other.
"""

from __future__ import annotations

import math
import multiprocessing
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from itertools import groupby
from typing import Any, NamedTuple

import car_clocks
import dive_units
import numpy as np
import over_water
from harness import Array, Options, Table, data_root, flag, main, quick, recorded
from recordings import known_until

from navfilter.calibration.over_dives import LEAST_GAP_S, TOGETHER, OverDives, learn, models_of, pooled
from navfilter.evaluation.baselines import learnable, rival
from navfilter.models.error_models import ErrorModel, GaussMarkov, RandomWalk, Sum, White
from navfilter.models.learned_arma import larger
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay

#: Factor for all sizes, or another model of the same size.
HOWS: dict[str, float | str] = {
    "as set": 1.0,
    "white": "white",
    "30 s": "30 s",
    "sd / 3": 1.0 / 3.0,
    "sd x 3": 3.0,
    "sd / 5": 0.2,
    "sd x 5": 5.0,
}
#: What is described in seven ways, and learns: fixes, hidden most of the time, do not.
LEARNT = ("heading", "velocity")
#: Longer than any recording [s].
EVER_S = 1e9
#: Bootstraps of the ratios.
DRAWS, SEED = 2000, 1


class Kind(NamedTuple):
    """How fixes are given and errors judged: given [s] in every [s], phases, last seconds of a gap that count."""

    on_s: float
    every_s: float
    phases: int
    judged_s: float


KINDS = {
    "dive": Kind(0.0, math.inf, 1, math.inf),
    "dive-gaps": Kind(20.0, 120.0, 4, 10.0),
    "car": Kind(5.0, 60.0, 6, 10.0),
    "lake": Kind(15.0, 120.0, 4, 10.0),
    "comma": Kind(4.0, 20.0, 2, 5.0),
    "mower": Kind(20.0, 60.0, 4, 10.0),
    "yacht": Kind(10.0, 600.0, 1, 10.0),
}
#: Kinds whose recordings are of one vehicle, or of one sort, so that the others teach one.
TAUGHT = ("dive", "car", "yacht")


# --- recordings -----------------------------------------------------------------------------------------------------


@cache
def names_of(kind: str) -> tuple[str, ...]:
    """Recordings of a kind."""
    if kind.startswith("dive"):
        return tuple(dive_units.UNIT_S)
    if kind == "car":
        return tuple(car_clocks.TRIALS)
    if kind == "yacht":
        return tuple(sailed.name for sailed in over_water.recorded(""))
    return {"lake": ("20220625_0_0",), "comma": ("segment40",), "mower": ("plaza",)}[kind]


@cache
def case(kind: str, name: str) -> tuple[Mission, Vehicle, float]:
    """Mission with all its fixes and its truth, vehicle as set, and the time until which fixes are given [s]."""
    if kind.startswith("dive"):
        mission, vehicle = dive_units.dive(name)
        assert mission.start is not None and mission.start.time_s is not None
        return mission, vehicle, mission.start.time_s
    if kind == "car":
        mission, vehicle = car_clocks.clean(name)
        return mission, vehicle, known_until(mission)
    if kind == "yacht":
        (sailed,) = over_water.recorded(name)
        _, vehicle = over_water.described(sailed)
        mission = over_water.mission(sailed, EVER_S, known_s=EVER_S)
        return judged_by(mission, "gps"), vehicle, over_water.KNOWN_S
    folder = {"lake": f"auv-lake-sea-10hz/{name}", "comma": f"comma2k19/{name}", "mower": "mower-plaza-5hz"}[kind]
    mission, vehicle = recorded(folder)
    if kind == "lake":
        mission = judged_by(mission, fix_names(vehicle)[0])
    return mission, vehicle, mission.streams[fix_names(vehicle)[0]].time_s[0] + KINDS[kind].on_s


def judged_by(mission: Mission, sensor: str) -> Mission:
    """A mission whose truth are its fixes."""
    fixes = mission.streams[sensor]
    value = np.full((len(fixes), len(TRUTH_COLUMNS)), np.nan)
    value[:, :2] = fixes.value[:, :2]
    return replace(mission, truth=Stream(fixes.time_s, value, TRUTH_COLUMNS))


def fix_names(vehicle: Vehicle) -> list[str]:
    """Sensors that bound the position."""
    return [name for name, sensor in vehicle.sensors.items() if sensor.observes.corrects == "position"]


def gaps_of(kind: str, name: str, phase: int) -> list[tuple[float, float]]:
    """Intervals without fixes [s]."""
    mission, _, begin = case(kind, name)
    on_s, every_s, phases, _ = KINDS[kind]
    end = float(mission.truth.time_s[-1])
    if math.isinf(every_s):
        return [(begin + 1e-6, end + 1.0)]
    first = begin + phase * every_s / phases
    gaps = [(float(a + on_s), float(min(a + every_s, end))) for a in np.arange(first, end, every_s) if a + on_s < end]
    # what stands before the first fixes of this phase is a gap of its own
    return ([(begin + 1e-6, first)] if phase else []) + gaps


# --- descriptions ---------------------------------------------------------------------------------------------------


def told(vehicle: Vehicle) -> tuple[str, ...]:
    """What is described in seven ways: headings and velocities, those of the drive too."""
    drive = [] if vehicle.drive.inertial else ["attitude", "velocity"]
    sensors = {name: s for name, s in vehicle.sensors.items() if not s.from_drive}
    return (*drive, *(name for name, s in sensors.items() if s.observes.corrects in LEARNT))


def described(vehicle: Vehicle, how: str) -> Vehicle:
    """The vehicle with another description of its headings and velocities."""
    for name in told(vehicle):
        models, period_s = models_of(vehicle, name)
        new = tuple(other(model, period_s, HOWS[how]) for model in models)
        vehicle = vehicle.with_error(**{name: new[0] if len(set(new)) == 1 else new})
    return vehicle


def other(model: ErrorModel, period_s: float, how: float | str) -> ErrorModel:
    """One axis of it; walks, which are a bias, stay."""
    parts = model.parts if isinstance(model, Sum) else (model,)
    walks = [part for part in parts if isinstance(part, RandomWalk)]
    rest = [part for part in parts if not isinstance(part, RandomWalk)]
    if not rest:
        return model
    if isinstance(how, str):
        blocks = [part.block(period_s) for part in rest]
        sd = math.sqrt(sum(b.r + float(b.C @ b.P0 @ b.C) for b in blocks))
        rest = [White(sd=sd) if how == "white" else GaussMarkov(sd=sd, tau_s=30.0)]
    else:
        rest = [larger(part, how) for part in rest]
    parts = (*walks, *rest)
    return Sum(parts) if len(parts) > 1 else parts[0]


# --- runs -----------------------------------------------------------------------------------------------------------


def judged(kind: str, name: str, phase: int, vehicle: Vehicle) -> list[tuple[float, float]]:
    """Mean square of the horizontal error [m^2] and mean NEES in each gap."""
    mission, _, _ = case(kind, name)
    gaps = gaps_of(kind, name, phase)
    hidden = mission
    for fix in fix_names(vehicle):
        hidden = hidden.hide(fix, *gaps)
    track = replay(vehicle, hidden)
    errors = track.errors(mission.truth)
    square = np.sum(errors.position_n[:, :2] ** 2, axis=1)
    nees = horizontal_nees(errors.position_n[:, :2], track.covariance[:, :2, :2])
    found = []
    for begin, end in gaps:
        inside = (track.time_s > max(begin, end - KINDS[kind].judged_s)) & (track.time_s <= end) & np.isfinite(square)
        if inside.any() and (math.isinf(KINDS[kind].judged_s) or end - begin > KINDS[kind].judged_s + 2.0):
            found.append((float(np.mean(square[inside])), float(np.mean(nees[inside]))))
    return found


def horizontal_nees(error: Array, P: Array) -> Array:
    """Normalised squared errors north and east, per axis."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(P, error[:, :, None])[:, :, 0]) / 2.0)


def compared(job: tuple[str, str, str]) -> list[dict[str, Any]]:
    """All phases of a recording with one description: as described, and learning in the mission."""
    kind, name, how = job
    _, vehicle, _ = case(kind, name)
    file, rows = described(vehicle, how), []
    for phase in range(KINDS[kind].phases):
        mission = case(kind, name)[0]
        listening = [n for n in learnable(file, mission) if file.sensors[n].observes.corrects in LEARNT]
        learning = rival("arma", file, mission, sensors=listening)
        one = judged(kind, name, phase, file)
        two = one if learning == file else judged(kind, name, phase, learning)
        rows += [
            {"kind": kind, "recording": name, "how": how, "file": a, "learnt": b} for a, b in zip(one, two, strict=True)
        ]
    return rows


def lesson(job: tuple[str, str, str]) -> tuple[tuple[str, str, str], OverDives]:
    """What one recording says of a description, by its fixes after gaps; of a dive by the last one."""
    kind, name, how = job
    mission, vehicle, begin = case(kind, name)
    (fix,) = fix_names(vehicle)
    times = mission.streams[fix].time_s
    if kind == "dive":
        return job, learn(mission.hide(fix, (begin + 1e-6, float(times[-1]) - 0.5)), described(vehicle, how))
    # the phase in which most fixes come after a gap: a short trial may end in one
    phases = [mission.hide(fix, *gaps_of(kind, name, phase)) for phase in range(KINDS[kind].phases)]
    most = max(phases, key=lambda one: int(np.sum(np.diff(one.streams[fix].time_s) > LEAST_GAP_S)))
    return job, learn(most, described(vehicle, how))


def taught(job: tuple[str, str, str, list[dict[str, Array]]]) -> list[dict[str, Any]]:
    """All phases of a recording with what the others say, and with the file as set."""
    kind, name, how, said = job
    _, vehicle, _ = case(kind, name)
    start = described(vehicle, how)
    sensors = [n for n in said[0] if n != TOGETHER]
    _, new = pooled(start, sensors, said)
    rows = []
    for phase in range(KINDS[kind].phases):
        pairs = zip(*(judged(kind, name, phase, v) for v in (vehicle, start, new)), strict=True)
        rows += [{"kind": kind, "recording": name, "how": how, "set": s, "file": a, "learnt": b} for s, a, b in pairs]
    return rows


# --- figures --------------------------------------------------------------------------------------------------------


def ratios(rows: Sequence[Mapping[str, Any]], over: str) -> Array:
    """ln of the ratio of rms errors, learnt over another, of each recording."""
    by = defaultdict(list)
    for row in rows:
        by[row["kind"], row["recording"]].append((row["learnt"][0], row[over][0]))
    return np.array([0.5 * math.log(np.mean([a for a, _ in v]) / np.mean([b for _, b in v])) for v in by.values()])


def interval(logs: Array) -> tuple[float, float]:
    """5 and 95 % of the geometric mean, by bootstrap over recordings."""
    draws = np.random.default_rng(SEED).choice(logs, (DRAWS, len(logs))).mean(axis=1)
    low, high = np.exp(np.quantile(draws, [0.05, 0.95]))
    return float(low), float(high)


def figures(rows: Sequence[Mapping[str, Any]], **labels: str) -> dict[str, Any]:
    """One line of the table."""
    logs = ratios(rows, "file")
    low, high = interval(logs)
    found: dict[str, Any] = {**labels, "gaps": len(rows)}
    for key in ("file", "learnt"):
        found[f"{key}_m"] = math.sqrt(np.mean([row[key][0] for row in rows]))
        found[f"{key}_nees"] = float(np.mean([row[key][1] for row in rows]))
    found |= {"ratio": float(np.exp(logs.mean())), "low": low, "high": high}
    found["se"] = float(logs.std(ddof=1) / math.sqrt(len(logs))) if len(logs) > 1 else math.nan
    if "set" in rows[0]:
        of_set = ratios(rows, "set")
        found |= {"of_set": float(np.exp(of_set.mean()))}
        found["of_set_se"] = float(of_set.std(ddof=1) / math.sqrt(len(of_set))) if len(of_set) > 1 else math.nan
    return found


COLUMNS = (
    "kind<10 how<8 gaps>5d file_m>7.2f learnt_m>8.2f file_nees>9.2f learnt_nees>11.2f ratio>5.2f low>5.2f high>5.2f"
)


def printed(results: Iterator[list[dict[str, Any]]], jobs: Sequence[tuple[Any, ...]], more: str = "") -> Any:
    """A line for each kind and description, as they come, and one for all descriptions of a kind; the lines, and the
    number of gaps.
    """
    table, count = Table(COLUMNS + more), 0
    for kind, of_kind in groupby(jobs, key=lambda job: job[0]):
        rows: list[dict[str, Any]] = []
        hows = 0
        for how, of_how in groupby(of_kind, key=lambda job: job[2]):
            some = [row for _ in of_how for row in next(results)]
            table.add(figures(some, kind=kind, how=how))
            rows, hows = rows + some, hows + 1
        if hows > 1:
            table.add(together(rows, kind))
        count += len(rows)
    return table.rows, count


def together(rows: Sequence[Mapping[str, Any]], kind: str) -> dict[str, Any]:
    """All descriptions of a kind: the mean over them first, so that recordings are what is drawn."""
    found = figures(rows, kind=kind, how="all")
    names = {row["how"] for row in rows}
    each = np.mean([ratios([row for row in rows if row["how"] == how], "file") for how in names], axis=0)
    low, high = interval(each)
    found |= {"ratio": float(np.exp(each.mean())), "low": low, "high": high}
    return found


def gaps(options: Options) -> dict[str, Any]:
    """Run and print all of it."""
    data_root()
    kinds = [kind for kind in KINDS if options.only in kind]
    hows = list(HOWS)[: 2 if options.quick else None]
    if options.quick:
        kinds = [kind for kind in kinds if kind in ("dive", "car")]

    def names(kind: str) -> tuple[str, ...]:
        all_of = names_of(kind)
        some = all_of[options.half == "even" :: 2] if options.half and len(all_of) > 1 else all_of
        return some[: 2 if options.quick else None]

    jobs = [(kind, name, how) for kind in kinds for how in hows for name in names(kind)]
    with workers(options) as run:
        table, count = printed(iter(run(compared, jobs)), jobs)
        result: dict[str, Any] = {"gaps": count, "in_the_mission": table}
        print(f"{count} gaps in all, in {len(hows)} descriptions")
        if options.over_dives:
            jobs = [job for job in jobs if job[0] in TAUGHT and (job[0] == "dive" or job[2] == "as set")]
            jobs = [job for job in jobs if len(names(job[0])) > 1]
            print("\nover dives, each recording by what all others of its kind have taught:", flush=True)
            said = {job: found.dives[0].evidence for job, found in run(lesson, jobs)}
            left_out = [
                (kind, name, how, [said[kind, other, how] for other in names(kind) if other != name])
                for kind, name, how in jobs
            ]
            results = iter(run(taught, left_out))
            result["over_dives"], _ = printed(results, left_out, " of_set>6.2f of_set_se>9.3f")
    return result


@contextmanager
def workers(options: Options) -> Iterator[Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]]:
    """What works like `map`, on so many processes."""
    if options.workers < 2:
        yield map
        return
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        yield pool.map


if __name__ == "__main__":
    main(
        __doc__,
        {
            gaps: [
                flag("--only", default="", help="only kinds whose name contains this"),
                flag("--half", choices=("odd", "even"), help="of the recordings: every other one"),
                flag("--over-dives", action="store_true", help="also what other recordings of the vehicle teach"),
                flag("--workers", type=int, default=2, metavar="N", help="processes (default: %(default)s)"),
                quick("two dives and two trials, two descriptions"),
            ]
        },
    )

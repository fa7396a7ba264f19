"""Whether `navfilter calibrate` is to be believed, of vehicles that nobody has thought of: see `honest_random.py`.

`constants`: every case is one of its vehicles, whose true constants are drawn once from what its description believes;
where that is sure of everything, from what `calibrate` opens then, so that the description is wrong and sure. Missions
of it differ in all else. It is calibrated by the first of them and by several, and each row says: how many constants
there are and how many were told; the mean of (found - true)^2 / variance over those that were told (1 is honest), and
the largest; their rms error over that of the start; what was withheld, by the constants found over those described;
whether they are kept. Then a fresh mission of the same vehicle, whose fixes are hidden in its second third, is run with
the vehicle as it was, with the constants found, and with the true ones: rms position error and mean NEES. The sums say
of which kinds constants are worst. Its rivals are the start and the truth, for there is no other software in it.

`handling`: what becomes of missions and files that are not as they should be, by the command line.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from calibrate_handling import handling
from harness import Array, Options, Table, flag, main, quick
from honest_random import BEGIN_S, Case

import navfilter as nf
from navfilter.calibration.calibrate import Calibration, Found, Prediction
from navfilter.calibration.parts import KINDS, Constant, constants_of, described, kind_of, opened
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.toml_editing import write_calibrated

WHAT = ("position", "velocity", "heading")
#: Squared errors over their variance beyond this are counted [1]: three sd, one in 370.
FAR = 9.0


@dataclass(frozen=True)
class Drawn:
    """A vehicle as it is described, and as it is."""

    case: Case
    start: nf.Vehicle
    true: nf.Vehicle
    constants: dict[str, Constant]

    @classmethod
    def of(cls, number: int, drive: str, most_s: float) -> Drawn | None:
        """That of a number, always the same; None where it has no constants that could be opened."""
        case = Case.of(number, drive)
        case = replace(case, duration_s=min(case.duration_s, most_s))
        wide = case.vehicle
        if not constants_of(wide):
            wide = opened(wide, tuple(KINDS), [replace(case, duration_s=min(60.0, most_s)).mission(0)])
        r = np.random.default_rng([number, 3])
        constants = [one._replace(value=one.value + one.sd * float(r.normal())) for one in constants_of(wide)]
        true = described(wide, [one._replace(sd=0.0) for one in constants])
        return cls(case, case.vehicle, true, {one.name: one for one in constants}) if constants else None

    def missions(self, seeds: Sequence[int]) -> list[nf.Mission]:
        """Of the vehicle as it is."""
        return [replace(replace(self.case, vehicle=self.true).mission(seed), name=f"dive {seed}") for seed in seeds]


def fresh(vehicle: nf.Vehicle, mission: nf.Mission, duration_s: float) -> tuple[float, Array]:
    """Rms horizontal error [m] and mean NEES of a mission whose fixes are hidden in its second third."""
    names = [name for name, sensor in vehicle.sensors.items() if sensor.gives == "position"]
    for name in names:
        if name in mission.streams:
            mission = mission.hide(name, (duration_s / 3.0, 2.0 * duration_s / 3.0))
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    errors = track.errors(mission.truth)
    scored, nees = track.time_s > BEGIN_S, track.nees(errors)
    rms_m = math.sqrt(float(np.nanmean(np.sum(errors.position_n[scored, :2] ** 2, axis=1))))
    return rms_m, np.array([float(np.nanmean(nees[what][scored])) for what in WHAT])


def through_a_file(vehicle: nf.Vehicle, before: nf.Vehicle) -> nf.Vehicle:
    """As the command writes it and reads it back."""
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "vehicle.toml", Path(folder) / "out.toml"
        write_vehicle(before, source)
        write_calibrated(vehicle, before, out, source, "found")
        return read_vehicle(out)


def judged(drawn: Drawn, result: Calibration) -> dict[str, Any]:
    """What is known of a calibration when the truth is."""
    told = [one for one in result.found if one.told and one.believed]
    off = np.array([one.value - drawn.constants[one.name].value for one in told])
    was = np.array([one.before - drawn.constants[one.name].value for one in told])
    square = (off / np.array([one.sd for one in told])) ** 2 if told else np.array([math.nan])
    prior = np.array([one.before_sd for one in told])
    before, after = result.before, result.after
    return {
        "constants": len(result.found),
        "told": len(told),
        "unbelieved": sum(not one.believed for one in result.found),
        "square": float(square.mean()),
        "largest": float(square.max()),
        "error": math.sqrt(np.mean((off / prior) ** 2) / np.mean((was / prior) ** 2)) if told else math.nan,
        "withheld": math.nan if before is None or after is None else ratio(after, before),
        "kept": "kept" if result.kept else "no",
        "factor": result.factor,
        "settled": "yes" if result.settled else "no",
    }


def ratio(after: Prediction, before: Prediction) -> float:
    """Of the errors at withheld fixes; without any, of the likelihoods of a reading."""
    return math.exp(after.cost - before.cost) if math.isnan(after.rms_m) else after.rms_m / before.rms_m


def one_of(found: Found, drawn: Drawn, row: dict[str, Any]) -> dict[str, Any]:
    """A constant, for the sums and the JSON file."""
    true = drawn.constants[found.name].value
    own = found.name.rpartition(".")[2]
    return {
        "case": row["case"],
        "missions": row["missions"],
        "name": found.name,
        "kind": kind_of(own),
        "told": found.told and found.believed,
        "kept": row["kept"],
        "z": (found.value - true) / found.sd,
        "z_before": (found.before - true) / found.before_sd,
        "left": found.sd / found.before_sd,
        "scatter": found.scatter / found.sd,
    }


def constants(options: Options) -> dict[str, Any]:
    """Random vehicles: calibrate them, and run a fresh mission."""
    heads = "told>4d square>6.2f largest>6.1f error>5.2f withheld>5.3f kept<4 factor>5.1f settled<3"
    runs = "start_m>7.3f found_m>7.3f true_m>7.3f start_nees>7.2f found_nees>7.2f true_nees>7.2f"
    table = Table(f"case<6 missions>4d constants>4d {heads} {runs} seconds>6.1f vehicle<60")
    each: list[dict[str, Any]] = []
    counts = [1] if options.quick else [int(count) for count in options.missions.split(",")]
    for number in range(options.first, options.first + (3 if options.quick else options.cases)):
        drawn = Drawn.of(number, options.drive, 60.0 * options.minutes)
        if drawn is None:
            continue
        missions = drawn.missions(range(100 * number, 100 * number + max(counts)))
        (unseen,) = drawn.missions([100 * number + 99])
        both = {"start": drawn.start, "true": drawn.true}
        known = {name: fresh(vehicle, unseen, drawn.case.duration_s) for name, vehicle in both.items()}
        for count in counts:
            row: dict[str, Any] = {"case": str(number), "missions": count, "vehicle": drawn.case.words}
            began = time.perf_counter()
            try:
                result = nf.calibrate(drawn.start, missions[:count])
            except ValueError as reason:
                table.add(row | {"kept": "-", "vehicle": f"{reason} {drawn.case.words}"})
                continue
            row |= {"seconds": time.perf_counter() - began} | judged(drawn, result)
            # also where it is not kept: whether that was right
            wide = opened(drawn.start, () if constants_of(drawn.start) else tuple(KINDS), missions[:count])
            found = described(wide, result.constants)
            row["found_m"], found_nees = fresh(through_a_file(found, drawn.start), unseen, drawn.case.duration_s)
            row["start_m"], row["true_m"] = known["start"][0], known["true"][0]
            for name, nees in (("found", found_nees), ("start", known["start"][1]), ("true", known["true"][1])):
                row |= {f"{name}_nees": float(nees.max())} | {
                    f"{name}_{what}": float(v) for what, v in zip(WHAT, nees, strict=True)
                }
            table.add(row)
            each += [one_of(one, drawn, row) for one in result.found]
    return {"cases": table.rows, "constants": each} | sums(table.rows, each, counts)


def sums(rows: list[dict[str, Any]], each: list[dict[str, Any]], counts: Sequence[int]) -> dict[str, Any]:
    """What all cases say together, printed."""
    print()
    table = Table("missions>4d kind<12 told>5d of>5d mean>7.2f median>6.2f far>6.3f better>6.2f z>6.2f")
    kinds = ["all", *dict.fromkeys(one["kind"] for one in each)]
    for count in counts:
        for kind in kinds:
            these = [one for one in each if one["missions"] == count and kind in ("all", one["kind"])]
            z, was = (np.array([one[key] for one in these if one["told"]]) for key in ("z", "z_before"))
            left = np.array([one["left"] for one in these if one["told"]])
            if not len(z):
                continue
            about = {"mean": (z**2).mean(), "median": np.median(z**2), "far": (z**2 > FAR).mean(), "z": z.mean()}
            better = float((abs(z * left) < abs(was)).mean())
            table.add({"missions": count, "kind": kind, "told": len(z), "of": len(these), "better": better} | about)
    print()
    nees = "start_nees>7.2f found_nees>7.2f true_nees>7.2f"
    worth = Table(f"missions>4d what<10 runs>5d error>6.2f found_better>6.2f gain>6.3f {nees}")
    for count in counts:
        for what in ("kept", "no"):
            these = [row for row in rows if row["missions"] == count and row.get("kept") == what and row["told"]]
            if not these:
                continue
            gain = np.array([row["found_m"] / row["start_m"] for row in these])
            medians = {
                f"{name}_nees": np.median([row[f"{name}_nees"] for row in these]) for name in ("start", "found", "true")
            }
            error = float(np.median([row["error"] for row in these]))
            worth.add(
                {"missions": count, "what": what, "runs": len(these), "error": error}
                | {"found_better": (gain < 1.0).mean(), "gain": math.exp(np.log(gain).mean())}
                | medians
            )
    return {"kinds": table.rows, "worth": worth.rows}


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=60, help="how many"),
        flag("--first", type=int, default=10_000, help="number of the first"),
        flag("--drive", choices=["imu", "dead-reckoning"], default="imu", help="a unit, or a velocity and a heading"),
        flag("--missions", default="1,3", help="calibrated by so many of them, with commas"),
        flag("--minutes", type=float, default=10.0, help="a mission lasts at most so long"),
        quick("three of them, by one mission"),
    ]
    main(__doc__, {constants: flags, handling: [quick("the first six")]})

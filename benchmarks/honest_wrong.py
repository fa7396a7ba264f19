"""What a vehicle file leaves out: does the verdict say so, and does it name the key to add?

The vehicles of `honest_random.py`, one mistake each: a scale of 2 %, a mounting of 2 deg, a clock of 0.2 s, a lever arm
of 0.5 m, a bias or a deviation of 2 deg, an offset of the depth gauge of 1 m, white noise three times too large or too
small. The mission errs as the whole file says; it is replayed with it ("right"), and with one that knows nothing of it
("wrong"). A silent wrong answer is a mission whose NEES of position or heading is above 5 with the wrong file and below
2 with the right one, and of which the verdict says nothing. Counted: how often anything is said, how often with the key
that is missing, and how often other keys are named. There is no other software in it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from harness import DEG, Options, Table, flag, main, quick
from honest_random import Case

import navfilter as nf
from navfilter.evaluation.assessment import Verdict, judge
from navfilter.evaluation.diagnostics import evidence

#: Scored from then on [s]; wrong is what has more than the first of these [1], right what has less than the second.
BEGIN_S, ODD, EVEN = 120.0, 5.0, 2.0
#: Kinds of mistakes: the field that is left out, how large it is by the kind of sensor, and its key in a file.
SIZES: dict[str, tuple[str, Mapping[str, Any], str]] = {
    "scale": ("scale_sd", {"velocity": 0.02}, "scale_sd"),
    "mounting": ("misalignment_sd_rad", {"velocity": 2.0 * DEG}, "misalignment_sd_"),
    "clock": ("time_offset_sd_s", {"velocity": 0.2, "position": 0.2, "heading": 0.2}, "time_offset_sd_s"),
    "arm": ("lever_arm_sd_m", {"velocity": (0.5,) * 3, "position": (0.5,) * 3}, "lever_arm_sd_m"),
    "bias": ("bias_sd_rad", {"heading": 2.0 * DEG}, "bias_sd_"),
    "deviation": ("deviation_sd_rad", {"heading": (2.0 * DEG, DEG)}, "deviation_sd_"),
    "offset": ("offset_sd_m", {"depth": 1.0}, "offset_sd_m"),
}
NOISE = {"too small": 3.0, "too large": 1.0 / 3.0}
#: Keys that a cure may name.
KEYS = r"(?:scale|misalignment|time_offset|lever_arm|bias|deviation|offset|current)_sd_\w+|scale_sd|another sd"


@dataclass(frozen=True)
class Mistake:
    """A case, and what its file leaves out."""

    case: Case
    wrong: nf.Vehicle
    sensor: str
    kind: str
    key: str

    @classmethod
    def drawn(cls, number: int) -> Mistake:
        """That of a number, always the same."""
        case, r = Case.drawn(number), np.random.default_rng([number, 7])
        sensors = case.vehicle.sensors
        possible = [
            (name, kind)
            for name, sensor in sensors.items()
            for kind, (field, sizes, _) in SIZES.items()
            if sensor.gives in sizes and hasattr(sensor, field) and not getattr(sensor, "magnetometer", False)
        ]
        possible += [(name, f"noise {way}") for name in sensors if name in ("dvl", "gps", "compass") for way in NOISE]
        sensor, kind = possible[int(r.integers(len(possible)))]
        described = sensors[sensor]
        if kind in SIZES:
            field, sizes, key = SIZES[kind]
            size = sizes[described.gives]
            real = replace(described, **{field: size})
            believed = replace(described, **{field: 0.0 if np.isscalar(size) else (0.0,) * len(size)})
        else:
            key, real = "another sd", replace(described, error=_times(described.error, NOISE[kind[6:]]))
            believed = described
        vehicle = case.vehicle
        truth, wrong = (nf.Vehicle(vehicle.drive, {**sensors, sensor: one}) for one in (real, believed))
        return cls(replace(case, vehicle=truth), wrong, sensor, kind, key)


def _times(error: Any, factor: float) -> Any:
    """An error model that errs so many times as much."""
    if isinstance(error, tuple):
        return tuple(_times(part, factor) for part in error)
    if hasattr(error, "parts"):
        return type(error)(tuple(_times(part, factor) for part in error.parts))
    return replace(error, sd=factor * error.sd)


def run(vehicle: nf.Vehicle, mission: nf.Mission) -> tuple[nf.Track, float]:
    """Forward, and the larger NEES of position and heading."""
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    nees, scored = track.nees(track.errors(mission.truth)), track.time_s > BEGIN_S
    return track, max(float(np.nanmean(nees[what][scored])) for what in ("position", "heading"))


def said(verdict: Verdict, mistake: Mistake | None = None) -> dict[str, Any]:
    """Whether anything speaks against a track, whether the missing key is named, and what else is."""
    spoken = [f for f in verdict.findings if f.severity != "info"]
    own, other = False, []
    for finding in spoken:
        keys = set(re.findall(KEYS, finding.cure))
        right = mistake is not None and any(key.startswith(mistake.key) for key in keys)
        right = right and mistake.sensor in (finding.stream, *re.findall(r"\w+", finding.cure))
        own |= right
        if keys and not right:
            other.append(f"{finding.stream}: {', '.join(sorted(keys))}")
    return {"said": bool(spoken), "key": own, "other": other}


def honest_wrong(options: Options) -> dict[str, Any]:
    """Draw, simulate, replay with and without, print."""
    table = Table("case<6 sensor<8 mistake<16 right>7.1f wrong>8.1f said<5 key<5 other<40 vehicle<60")
    counts = dict.fromkeys(("right files", "false alarms", "wrong", "said", "key", "other"), 0)
    for number in range(options.first, options.first + (3 if options.quick else options.cases)):
        mistake = Mistake.drawn(number)
        mission = mistake.case.mission(10 * number)
        (right, fair), (wrong, off) = (run(v, mission) for v in (mistake.case.vehicle, mistake.wrong))
        alarm = said(judge(right, mission, evidence(right)))["said"]
        counts["right files"] += 1
        counts["false alarms"] += alarm
        row = {"case": str(number), "sensor": mistake.sensor, "mistake": mistake.kind, "right": fair, "wrong": off}
        row |= {"vehicle": f"{'false alarm; ' if alarm else ''}{mistake.case.words}"}
        if off > ODD and fair < EVEN:
            found = said(judge(wrong, mission, evidence(wrong)), mistake)
            counts["wrong"] += 1
            for what in ("said", "key", "other"):
                counts[what] += bool(found[what])
            row |= {"said": str(found["said"]), "key": str(found["key"]), "other": "; ".join(found["other"])}
        if "said" in row or alarm:
            table.add(row)
    print(", ".join(f"{what} {count}" for what, count in counts.items()))
    return {"rows": table.rows, "counts": counts}


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=200, help="how many"),
        flag("--first", type=int, default=50_000, help="number of the first"),
        quick("three of them"),
    ]
    main(__doc__, {honest_wrong: flags})

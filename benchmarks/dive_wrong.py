"""Real dives described wrongly: the filter beside the same one with every reading used.

The nine dives of `dive_cases`, raw, whose DVL is described off in time, place or mounting, and whose start is off in
attitude: as states of a filter that is unsure by as much, or not. rms of the horizontal position and of all three axes,
geometric means over the dives; worst: the largest ratio of a dive. over: dives in which it is more than a tenth worse.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import dive_cases as dives
import numpy as np
from harness import DEG, Array, Options, Table, flag, main, quick
from scipy.spatial.transform import Rotation

import navfilter as nf

Change = Callable[[nf.Mission], nf.Mission]


def late(stream: str, by_s: float) -> Change:
    """Stamps that are late."""
    return lambda m: m.with_stream(stream, replace(m.streams[stream], time_s=m.streams[stream].time_s + by_s))


def turned(axis: str, deg: float) -> Change:
    """A DVL that is turned in the vehicle."""
    R = Rotation.from_euler(axis, deg, degrees=True).as_matrix()
    return lambda m: m.with_stream("dvl", replace(m.streams["dvl"], value=m.streams["dvl"].value @ R))


def misaligned(*deg: float) -> Change:
    """A start that is told off, about north, east and down."""
    return lambda m: m.with_start(dives.turned(m.start, np.array(deg) * DEG))


def none(mission: nf.Mission) -> nf.Mission:
    """As it is."""
    return mission


#: What of the data is off, what of the description, and how unsure that is where it is a state.
WRONG: dict[str, tuple[Change, Array, dict[str, Any]]] = {
    "nothing": (none, np.zeros(3), {}),
    "unit's clock +0.05 s": (late("imu", 0.05), np.zeros(3), {}),
    "unit's clock -0.05 s": (late("imu", -0.05), np.zeros(3), {}),
    "clock +1 s": (late("dvl", 1.0), np.zeros(3), {"time_offset_sd_s": 1.0}),
    "clock -1 s": (late("dvl", -1.0), np.zeros(3), {"time_offset_sd_s": 1.0}),
    "lever arm 2 m forward": (none, np.array([2.0, 0.0, 0.0]), {"lever_arm_sd_m": (2.0, 2.0, 0.5)}),
    "lever arm 2 m to starboard": (none, np.array([0.0, 2.0, 0.0]), {"lever_arm_sd_m": (2.0, 2.0, 0.5)}),
    "mounting 5 deg, pitch": (turned("y", 5.0), np.zeros(3), {"misalignment_sd_rad": 5.0 * DEG}),
    "mounting 5 deg, yaw": (turned("z", -5.0), np.zeros(3), {"misalignment_sd_rad": 5.0 * DEG}),
    "start 0.5 deg, tilt": (misaligned(0.5, 0.5, 0.0), np.zeros(3), {}),
    "start 0.5 deg, heading": (misaligned(0.0, 0.0, 0.5), np.zeros(3), {}),
}


def wrong(options: Options) -> list[dict[str, Any]]:
    """Every wrong description, without and with constants as states."""
    table = Table("wrong<28 states>6 free_m>7.2f rms_m>6.2f free_3d>8.2f rms_3d>7.2f nees>6.2f worst>6.2f over>4d")
    for name, (change, moved, unsure) in WRONG.items():
        if options.only not in name:
            continue
        for constants in (False, True):
            pairs = np.array(
                [pair(dive, constants, change, moved, unsure) for dive in dives.DIVES[: 2 if options.quick else None]]
            )
            mean, ratio = np.exp(np.log(pairs).mean(axis=0)), pairs[:, 1] / pairs[:, 0]
            row = dict(zip(("free_m", "rms_m", "free_3d", "rms_3d", "nees"), mean.tolist(), strict=True))
            over = int((ratio > 1.1).sum())
            table.add({"wrong": name, "states": constants, **row, "worst": float(ratio.max()), "over": over})
    return table.rows


def pair(dive: int, constants: bool, change: Change, moved: Array, unsure: dict[str, Any]) -> list[float]:
    """Of one dive: rms without a gate and with, horizontal, then of three axes [m]; NEES with."""
    case = next(case for case in dives.cases("raw", dive, 0) if case.constants is constants)
    dvl = case.vehicle.sensors["dvl"]
    arm = tuple((np.array(dvl.lever_arm_b_m) + moved).tolist())
    dvl = replace(dvl, lever_arm_b_m=arm, **(unsure if constants else {}))
    vehicle = replace(case.vehicle, sensors={**case.vehicle.sensors, "dvl": dvl})
    case = replace(case, vehicle=vehicle, mission=change(case.mission))
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        free, own = (dives.figures_of(dives.track_of(name, case), case) for name in ("no gate", "described"))
    return [free["rms_m"], own["rms_m"], free["prmse_m"], own["prmse_m"], own["nees"]]


if __name__ == "__main__":
    main(__doc__, {wrong: [flag("--only", default="", help="only those whose name contains this"), quick("two dives")]})

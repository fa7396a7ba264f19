"""A sensor whose noise is described too small: what becomes of the mission?

The vehicles of `honest_random.py`; of one sensor after the other the white noise is so many times what the vehicle file
says. Scored against the truth, from a minute on, beside the same mission with the file that says what is true: there is
no other software in it. A sound filter notices by how much the sensor scatters, and weighs it accordingly: NEES near 1,
and the position of the right file. "Off" is a mission whose NEES of position, velocity or heading is above 15, or whose
position is four times as far off and half a metre more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from harness import Array, Options, Table, flag, main, quick
from honest_random import BEGIN_S, WHAT, Case

import navfilter as nf
from navfilter.simulation.simulate import Faults, simulate

#: Scored from then on [s]: a mission's start stands twice as long as in `honest_random.py`.
FROM_S = 2.0 * BEGIN_S
#: What is off: NEES [1]; position rms over that of the right file [1], and beyond it [m].
ODD, FARTHER, BEYOND_M = 15.0, 4.0, 0.5


def sensors(case: Case) -> Iterator[tuple[str, float]]:
    """Sensors of one error for all axes, and its standard deviation."""
    for name, sensor in case.vehicle.sensors.items():
        if isinstance(sensor.error, nf.ErrorModel):
            variance = sensor.mean_variance(0, 1)
            if 0.0 < variance < math.inf:
                yield name, math.sqrt(variance)


def score(vehicle: nf.Vehicle, mission: nf.Mission, name: str) -> Array:
    """NEES of `WHAT`, position rms [m], and the share of the readings that were used."""
    assert mission.truth is not None
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    errors, scored = track.errors(mission.truth), track.time_s > FROM_S
    nees = track.nees(errors)
    rms = float(np.sqrt(np.nanmean(np.sum(errors.position_n[scored] ** 2, axis=1))))
    used = float(np.mean(track.residuals[name].used)) if len(track.residuals[name].used) else math.nan
    return np.array([*(float(np.nanmean(nees[what][scored])) for what in WHAT), rms, used])


def noise_wrong(options: Options) -> dict[str, Any]:
    """Draw, simulate, replay, print what is off, then all by kind of sensor."""
    heads = [*WHAT, "position_m", "used"]
    table = Table("case<6 sensor<8 file<6 " + " ".join(f"{head}>{len(head) + 1}.1f" for head in heads))
    found: dict[str, list[Array]] = {}
    for number in range(options.first, options.first + (3 if options.quick else options.cases)):
        case = Case.of(number, "imu")
        for name, sd in sensors(case):
            small = case.vehicle.with_error(**{name: nf.White(sd=sd)})
            true = case.vehicle.with_error(**{name: nf.White(sd=options.times * sd)})
            mission = simulate(
                *(true, case.way),
                seed=10 * number,
                duration_s=case.duration_s,
                start=case.start,
                faults={"gps": Faults(available=case.fixes)},
            )
            right, wrong = score(true, mission, name), score(small, mission, name)
            found.setdefault(name, []).append(np.array([right, wrong]))
            if is_off(right, wrong):
                for file, values in (("right", right), ("wrong", wrong)):
                    row = dict(zip(heads, values.tolist(), strict=True))
                    table.add({"case": number, "sensor": name, "file": file} | row)
    by_kind = Table(
        "sensor<10 missions>8d off>5d " + " ".join(f"{head}>{len(head) + 1}.1f" for head in WHAT) + " ratio>6.2f"
    )
    for name, pairs in sorted(found.items()):
        both = np.array(pairs)
        ratio = float(np.exp(np.mean(np.log(both[:, 1, 4] / both[:, 0, 4]))))
        off = sum(is_off(right, wrong) for right, wrong in pairs)
        medians = dict(zip(WHAT, np.nanmedian(both[:, 1, :4], axis=0).tolist(), strict=True))
        by_kind.add({"sensor": name, "missions": len(pairs), "off": off, "ratio": ratio} | medians)
    return {"off": table.rows, "by_kind": by_kind.rows}


def is_off(right: Array, wrong: Array) -> bool:
    """Whether a mission is off with the wrong file."""
    return bool(np.nanmax(wrong[:4]) > ODD or wrong[4] > FARTHER * right[4] + BEYOND_M)


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=40, help="how many vehicles"),
        flag("--first", type=int, default=97_000, help="number of the first"),
        flag("--times", type=float, default=5.0, help="noise over what is described"),
        quick("three of them"),
    ]
    main(__doc__, {noise_wrong: flags})

"""The standard hour through the filter and the smoother, beside filterpy and python-ins (see `baselines`), in one run.

The competitors do the same work per step on a part of the hour, and their time is scaled to the whole. Learning on all
eight channels (compass, DVL, depth, fixes; orders up to (4, 4)) is measured against the plain filter of the same
vehicle, turn by turn. Processor seconds: medians over the turns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from baselines import filterpy_times, pyins_filter, pyins_strapdown
from harness import CPU, Options, Table, flag, hour, in_turn, main, peak_mb, quick, ratio

import navfilter as nf
from navfilter.kernels import strapdown


def replayed(vehicle: nf.Vehicle, mission: nf.Mission, turns: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Processor seconds of the hour in every way, and what learning adds."""
    learning = vehicle.with_error(**{name: nf.LearnedArma() for name in vehicle.sensors})
    nf.replay(vehicle, mission.between(0.0, 30.0), smooth=True)  # compile, or load what was compiled
    nf.replay(learning, mission.between(0.0, min(700.0, mission.duration_s)))
    imu, adopted = mission.streams["imu"], []
    steps = np.column_stack([np.diff(imu.time_s, prepend=imu.time_s[0]), imu.value])
    memory = vehicle.drive.memory(0)
    calls = {
        "forward": lambda: nf.replay(vehicle, mission),
        "learning": lambda: adopted.append(nf.replay(learning, mission).counts["adopted"]),
        "forward + smoother": lambda: nf.replay(vehicle, mission, smooth=True),
        "strapdown alone": lambda: strapdown.integrate(mission.start.state.pack(), memory, steps, np.empty((0, 17))),
    }
    calls["strapdown alone"]()
    spent = in_turn(calls, turns)
    added = {
        "channels": sum(sensor.axes for sensor in vehicle.sensors.values()),
        "adoptions": adopted[-1],
        "plain_s": float(np.median(spent["forward"])),
        "learning_s": float(np.median(spent["learning"])),
        "added_share": ratio(spent["learning"], spent["forward"]) - 1.0,
    }
    return {name: float(np.median(seconds)) for name, seconds in spent.items()}, added


def replay_speed(options: Options) -> dict[str, Any]:
    """Time the hour."""
    minutes, turns = (min(options.minutes, 10.0), 1) if options.quick else (options.minutes, 3)
    vehicle, mission = hour(minutes)
    before = peak_mb()
    ours, added = replayed(vehicle, mission, turns)
    peak = peak_mb()
    imu = mission.streams["imu"]
    n, samples = len(imu), np.column_stack([imu.time_s, imu.value])
    readings = sum(len(mission.streams[name]) for name in vehicle.sensors)
    states = 9 + len(nf.Navigator(vehicle, mission.start).errors)
    kf = filterpy_times(states, min(5000, n), max(1, round(n / readings)), CPU)
    filterpy = n * kf.predict.mean() + readings * kf.update.mean()
    part = 500 if options.quick else 6000
    theirs = {
        "forward": (filterpy, n * pyins_filter(samples[:part], mission.start, 0.1, CPU).mean()),
        "forward + smoother": (filterpy + readings * kf.smoother, None),
        "strapdown alone": (None, n * pyins_strapdown(samples[:60000], mission.start, CPU)),
    }
    print(f"{minutes:g} min, {n} inertial samples, {readings} readings, {states} error states; processor seconds")
    table = Table("work<18 navfilter_s>9.3f filterpy_s>9.1f ratio>9.1f python_ins_s>9.1f ratio_ins>9.1f")
    for work, (one, other) in theirs.items():
        s = ours[work]
        row = {"work": work, "navfilter_s": s, "filterpy_s": one, "python_ins_s": other}
        table.add(row | {"ratio": one and one / s, "ratio_ins": other and other / s})
    rate = n / ours["strapdown alone"]
    print(f"strapdown alone: {1e-6 * rate:.1f} million samples/s; peak memory {peak:.0f} MB, {before:.0f} before")
    print(
        f"{added['channels']} channels: plain {added['plain_s']:.2f} s, learning {added['learning_s']:.2f} s, "
        f"{100 * added['added_share']:+.0f} %, {added['adoptions']} adoptions"
    )
    memory = {"peak_mb": peak, "before_mb": before}
    sizes = {"minutes": minutes, "states": states, "samples": n, "readings": readings}
    return sizes | memory | {"table": table.rows, "strapdown_samples_per_s": rate, "learning": added}


if __name__ == "__main__":
    main(__doc__, {replay_speed: [flag("--minutes", type=float, default=60.0), quick("ten minutes at most, one turn")]})

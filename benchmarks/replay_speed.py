"""The standard hour through the filter and the smoother, beside filterpy and python-ins (see `baselines`), in one run.

The competitors do the same work per step on a part of the hour, and their time is scaled to the whole. Learning on all
eight channels (compass, DVL, depth, fixes; orders up to (4, 4)), and error models of more states, are measured against
the plain filter of the same vehicle. Processor seconds; everything is measured turn by turn: medians of the turns, and
medians of their ratios.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from baselines import filterpy_times, pyins_filter, pyins_strapdown
from harness import CPU, DEG, Array, Options, Table, flag, hour, in_turn, main, peak_mb, quick, ratio

import navfilter as nf
from navfilter.kernels import strapdown
from navfilter.learning.axis_learner import Learner

#: What is compared: ours, filterpy, python-ins.
WORK = {
    "forward": ("filterpy forward", "python-ins filter"),
    "forward + smoother": ("filterpy both", None),
    "strapdown alone": (None, "python-ins strapdown"),
}


def larger(vehicle: nf.Vehicle) -> nf.Vehicle:
    """The same with 40 error states: slow errors of compass and DVL as sums of four of other times, one of the depth.

    They say of the readings what is true of them, as near as may be: readings that a wrong description refuses are
    judged one by one, which is another cost.
    """

    def slow(sd: float, *tau_s: float) -> nf.ErrorModel:
        parts = [nf.GaussMarkov(sd=sd / len(tau_s) ** 0.5, tau_s=tau) for tau in tau_s]
        return sum(parts[1:], start=parts[0])

    return vehicle.with_error(
        compass=slow(0.6 * DEG, 15.0, 30.0, 60.0, 120.0) + nf.White(sd=0.1 * DEG),
        dvl=slow(0.01, 5.0, 10.0, 20.0, 40.0) + nf.White(sd=0.01),
        depth=nf.GaussMarkov(sd=0.05, tau_s=60.0) + nf.White(sd=0.05),
    )


def calibrated(vehicle: nf.Vehicle, *, arms: bool = True, clocks: bool = False) -> nf.Vehicle:
    """The same with constants as states: of the inertial unit, then bias, deviation and lever arms, then clocks."""
    unit = dict.fromkeys(
        ("gyro_scale_sd", "gyro_misalignment_sd_rad", "accel_scale_sd", "accel_misalignment_sd_rad"), 1e-3
    )
    sensors = dict(vehicle.sensors)
    for name in sensors if arms else ():
        if name == "compass":
            sensors[name] = replace(sensors[name], bias_sd_rad=0.01, deviation_sd_rad=(0.01, 0.01))  # type: ignore[call-arg]
        else:
            sensors[name] = replace(sensors[name], lever_arm_sd_m=(0.1, 0.1, 0.1))
    if clocks:
        sensors = {name: replace(sensor, time_offset_sd_s=0.05) for name, sensor in sensors.items()}
    return nf.Vehicle(replace(vehicle.drive, **unit), sensors, vehicle.name)  # type: ignore[arg-type]


def too_sure(vehicle: nf.Vehicle, *, slow: bool = False) -> nf.Vehicle:
    """The same with the DVL's white noise described five times too small, or a compass without its slow error: readings
    are heard one by one, or refused.
    """
    if slow:
        return vehicle.with_error(compass=nf.GaussMarkov(sd=0.2 * DEG, tau_s=300.0) + nf.White(sd=0.1 * DEG))
    return vehicle.with_error(dvl=nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.002))


def beside(vehicle: nf.Vehicle, mission: nf.Mission, turns: int) -> dict[str, Any]:
    """What more states and more rows cost, by the time of the plain filter in the same turn."""
    cases = {
        "plain, five rows a second": (vehicle, 5.0),
        "constants of the unit": (calibrated(vehicle, arms=False), 5.0),
        "and of its sensors": (calibrated(vehicle), 5.0),
        "and all clocks": (calibrated(vehicle, clocks=True), 5.0),
        "noise of a DVL too small": (too_sure(vehicle), 5.0),
        "a compass too smooth": (too_sure(vehicle, slow=True), 5.0),
        "a row per second": (vehicle, 1.0),
        "a row per sample": (vehicle, None),
    }
    calls = {
        name: lambda one=one, rate=rate: nf.replay(one, mission, output_rate_hz=rate)  # type: ignore[misc]
        for name, (one, rate) in cases.items()
    }
    for call in calls.values():
        call()
    spent = in_turn(calls, turns)
    table = Table("case<28 states>6d seconds>8.3f ratio>6.2f")
    for name, (one, _) in cases.items():
        states = 9 + len(nf.Navigator(one, mission.start).errors)
        of = "a row per second" if name == "a row per sample" else "plain, five rows a second"
        seconds, times = float(np.median(spent[name])), ratio(spent[name], spent[of])
        table.add({"case": name, "states": states, "seconds": seconds, "ratio": times})
    return {"table": table.rows}


def replays(vehicle: nf.Vehicle, learning: nf.Vehicle, mission: nf.Mission, turns: int) -> dict[str, Array]:
    """Processor seconds of the hour in every way and turn, the competitors' scaled to the hour."""
    imu = mission.streams["imu"]
    n, samples = len(imu), np.column_stack([imu.time_s, imu.value])
    readings = sum(len(mission.streams[name]) for name in vehicle.sensors)
    states = 9 + len(nf.Navigator(vehicle, mission.start).errors)
    steps, memory = samples.copy(), vehicle.drive.memory(0)
    steps[:, 0] = np.diff(samples[:, 0], prepend=samples[0, 0])
    # the transition of nine states comes with the steps of the state: no bias, no noise
    none, no_errors = np.zeros(0), (np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((6, 1)), np.eye(36, 9))
    part = 500 if turns == 1 else 2000
    scaled: dict[str, list[float]] = {name: [] for pair in WORK.values() for name in pair if name}

    def competitors() -> None:
        kf = filterpy_times(states, min(5000, n), max(1, round(n / readings)), CPU)
        forward = n * kf.predict.mean() + readings * kf.update.mean()
        scaled["filterpy forward"].append(forward)
        scaled["filterpy both"].append(forward + readings * kf.smoother)
        scaled["python-ins filter"].append(n * pyins_filter(samples[:part], mission.start, 0.1, CPU).mean())
        scaled["python-ins strapdown"].append(n * pyins_strapdown(samples[:60000], mission.start, CPU))

    calls = {
        "forward": lambda: nf.replay(vehicle, mission),
        "learning": lambda: nf.replay(learning, mission),
        "40 states": lambda: nf.replay(larger(vehicle), mission),
        "forward + smoother": lambda: nf.replay(vehicle, mission, smooth=True),
        "strapdown alone": lambda: strapdown.imu_steps(mission.start.state.pack(), none, memory, steps, *no_errors),
        "competitors": competitors,
    }
    calls["strapdown alone"]()  # compiles, or loads what was compiled
    spent = in_turn(calls, turns)
    return spent | {name: np.array(seconds) for name, seconds in scaled.items()}


def learning_alone(minutes: float, turns: int) -> dict[str, Any]:
    """What learning adds to the first hour and to the second one, and how much of it the learners take: by the least of
    the turns, for the second hour is the difference of two runs.
    """
    looks: dict[str, list[float]] = {"learning 1": [], "learning 2": []}
    own, now = Learner.hop, [0.0]

    def timed(*given: Any) -> Any:
        began = time.thread_time()
        learnt = own(*given)
        now[0] += time.thread_time() - began
        return learnt

    def run(name: str, vehicle: nf.Vehicle, mission: nf.Mission) -> None:
        now[0] = 0.0
        nf.replay(vehicle, mission)
        looks.setdefault(name, []).append(now[0])

    calls: dict[str, Callable[[], object]] = {}
    for number in (1, 2):
        vehicle, mission = hour(number * minutes)
        learning = vehicle.with_error(**{name: nf.LearnedArma() for name in vehicle.sensors})
        for name, one in (("plain", vehicle), ("learning", learning)):
            calls[f"{name} {number}"] = partial(run, f"{name} {number}", one, mission)
    nf.replay(vehicle, mission)
    Learner.hop = timed  # type: ignore[assignment, method-assign]
    least = {name: float(seconds.min()) for name, seconds in in_turn(calls, turns).items()}
    Learner.hop = own  # type: ignore[method-assign]
    least |= {f"looks {number}": min(looks[f"learning {number}"]) for number in (1, 2)}
    table = Table("hour>4d plain_s>9.2f learning_s>10.2f looks_s>9.2f adds>6.2f")
    for number in (1, 2):
        row = {f"{name}_s": least[f"{name} {number}"] for name in ("plain", "learning", "looks")}
        if number == 2:
            row = {f"{name}_s": least[f"{name} 2"] - least[f"{name} 1"] for name in ("plain", "learning", "looks")}
        table.add({"hour": number, **row, "adds": row["learning_s"] / row["plain_s"] - 1.0})
    first, second = (row["adds"] for row in table.rows)
    print(f"learning adds {100 * first:.0f} % to the first hour, {100 * second:.0f} % to the second")
    return {"table": table.rows, "learning_adds": first, "second_adds": second}


def replay_speed(options: Options) -> dict[str, Any]:
    """Time the hour."""
    minutes, turns = (min(options.minutes, 10.0), 1) if options.quick else (options.minutes, 3)
    vehicle, mission = hour(minutes)
    learning = vehicle.with_error(**{name: nf.LearnedArma() for name in vehicle.sensors})
    if options.beside:
        return beside(vehicle, mission, turns)
    if options.learning:
        return learning_alone(minutes, turns)
    before = peak_mb()
    nf.replay(vehicle, mission, smooth=True)
    figures = {
        "minutes": minutes,
        "samples": len(mission.streams["imu"]),
        "readings": sum(len(mission.streams[name]) for name in vehicle.sensors),
        "states": 9 + len(nf.Navigator(vehicle, mission.start).errors),
        "peak_mb": peak_mb(),
        "before_mb": before,
        "channels": sum(sensor.axes for sensor in vehicle.sensors.values()),
        "adoptions": nf.replay(learning, mission).counts["adopted"],
    }
    print(", ".join(f"{name} {value:.0f}" for name, value in figures.items()))
    spent = replays(vehicle, learning, mission, turns)
    table = Table("work<18 navfilter_s>9.3f filterpy_s>9.1f ratio>9.1f python_ins_s>9.1f ratio_ins>9.1f")
    for work, (filterpy, pyins) in WORK.items():
        row = {"work": work, "navfilter_s": float(np.median(spent[work]))}
        for name, seconds, times in ((filterpy, "filterpy_s", "ratio"), (pyins, "python_ins_s", "ratio_ins")):
            if name:
                row |= {seconds: float(np.median(spent[name])), times: ratio(spent[name], spent[work])}
        table.add(row)
    table.add({"work": "forward, learning", "navfilter_s": float(np.median(spent["learning"]))})
    table.add({"work": "forward, 40 states", "navfilter_s": float(np.median(spent["40 states"]))})
    added, more = ratio(spent["learning"], spent["forward"]) - 1.0, ratio(spent["40 states"], spent["forward"])
    rate = figures["samples"] / float(np.median(spent["strapdown alone"]))
    print(
        f"learning adds {100 * added:.0f} %; 40 states take {more:.2f} times as long; strapdown alone: "
        f"{1e-6 * rate:.1f} million samples/s"
    )
    return figures | {
        "table": table.rows,
        "learning_adds": added,
        "more_states": more,
        "strapdown_samples_per_s": rate,
    }


if __name__ == "__main__":
    flags = [
        flag("--minutes", type=float, default=60.0),
        flag("--learning", action="store_true", help="only what learning adds to the plain filter, in two hours"),
        flag("--beside", action="store_true", help="only what more states and more rows cost"),
        quick("ten minutes at most, one turn"),
    ]
    main(__doc__, {replay_speed: flags})

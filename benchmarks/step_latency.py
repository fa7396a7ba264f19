"""How long one `step`, one `correct` and a start take in the vehicle's own loop, beside filterpy and python-ins in the same run.

An hour (`--minutes`) of a lawnmower with an inertial unit at 100 Hz, compass 8 Hz, DVL 4 Hz, depth and fixes 1 Hz, 27 error states or
more, the compass's error learnt under way, is fed to a navigator reading by reading, every call timed by itself: once as Python comes,
once after `gc.collect(); gc.freeze()`, and by the wall clock as well as by the thread's processor clock (on a machine that does other
work too, the wall clock's highest percentiles are the scheduler's).

filterpy: `KalmanFilter.predict` and `update` with matrices of the same size (no mechanisation, no Jacobians: its best case).
python-ins: one turn of the loop of `filters.run_feedback_filter` with one inertial sample per turn, from one covariance propagation to
the next: strapdown, 15 states, a body velocity at 4 Hz. Neither is made for this; it is what they offer.

Starts are timed in a process of their own: from nothing (an empty NUMBA_CACHE_DIR) and again with what that one left, from the first line
of Python to the first state after ten samples and a reading of each sensor.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import navfilter as nf
from navfilter.playback import drive_samples
from navfilter.simulation.scenarios import simulate_scenario

DEG = np.pi / 180.0
SHARES = (50.0, 99.0, 99.9, 100.0)
TARGETS_US = {"step p50": 15.0, "step p99.9": 100.0, "correct p99": 300.0}
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


def vehicle_of(base: nf.Vehicle) -> nf.Vehicle:
    """The survey vehicle with 27 states or more; its compass's error is learnt where this version can."""
    compass: Any = nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0)
    if hasattr(nf, "LearnedArma"):
        compass = nf.LearnedArma(prior=compass)
    sensors = {
        "compass": nf.Heading(rate_hz=8, error=compass + nf.White(sd=0.1 * DEG)),
        "dvl": nf.BodyVelocity(
            rate_hz=4, error=nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.01), scale_sd=0.003, misalignment_sd_rad=0.005
        ),
        "depth": nf.Depth(rate_hz=1, error=nf.White(sd=0.05), offset_sd_m=0.2),
        "gps": base.sensors["gps"],
    }
    return nf.Vehicle(base.drive, sensors, "survey, learning")


def readings(vehicle: nf.Vehicle, mission: nf.Mission) -> list[tuple[str, float, Any, Any]]:
    """Everything in order of time, as plain tuples: what a driver would hand over."""
    times, values = drive_samples(vehicle, mission)
    events: list[tuple[str, float, Any, Any]] = [
        ("", t, tuple(v[:3]), tuple(v[3:])) for t, v in zip(times.tolist(), values.tolist(), strict=True)
    ]
    for name in vehicle.sensors:
        stream = mission.streams[name]
        events += [(name, t, tuple(v), None) for t, v in zip(stream.time_s.tolist(), stream.value.tolist(), strict=True)]
    events.sort(key=lambda e: (round(e[1], 9), e[0]))
    return events


def timed(nav: nf.Navigator, events: list[tuple[str, float, Any, Any]], clock: Callable[[], int]) -> dict[str, np.ndarray]:
    """Nanoseconds of every call, by what was called."""
    n = sum(not name for name, *_ in events)
    spent = {"step": np.empty(n, np.int64), "correct": np.empty(len(events) - n, np.int64)}
    steps, corrections, i, j = spent["step"], spent["correct"], 0, 0
    for name, time_s, first, second in events:
        if name:
            began = clock()
            nav.correct(name, time_s, first)
            corrections[j] = clock() - began
            j += 1
        else:
            began = clock()
            nav.step(time_s, first, second)
            steps[i] = clock() - began
            i += 1
    return spent


def filterpy_times(n: int, steps: int) -> dict[str, np.ndarray]:
    """filterpy at n states: nanoseconds of `predict`, and of `update` with one component at every seventh step."""
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(0)
    kf = KalmanFilter(dim_x=n, dim_z=1)
    kf.x, kf.F = np.zeros(n), np.eye(n) + 0.001 * rng.normal(size=(n, n))
    kf.Q, kf.H, kf.R = 1e-4 * np.eye(n), rng.normal(size=(1, n)), np.eye(1)
    predict, update, z = np.empty(steps, np.int64), [], np.zeros(1)
    for k in range(steps):
        began = time.perf_counter_ns()
        kf.predict()
        predict[k] = time.perf_counter_ns() - began
        if k % 7 == 0:
            began = time.perf_counter_ns()
            kf.update(z)
            update.append(time.perf_counter_ns() - began)
    return {"step": predict[10:], "correct": np.array(update[3:])}


def pyins_times(samples: np.ndarray, start: nf.Start) -> dict[str, np.ndarray]:
    """python-ins: nanoseconds from one covariance propagation of its feedback filter to the next, one inertial sample each."""
    import pandas as pd
    from pyins import filters, inertial_sensor, measurements, sim, strapdown, util

    imu = pd.DataFrame(samples[:, 1:], index=pd.Index(samples[:, 0], name="time"), columns=util.GYRO_COLS + util.ACCEL_COLS)
    pva = pd.Series(
        [start.latitude_deg, start.longitude_deg, start.height_m, *start.velocity_n, start.roll_deg, start.pitch_deg, start.heading_deg],
        index=util.TRAJECTORY_COLS,
        name=float(samples[0, 0]),
    )
    increments = strapdown.compute_increments_from_imu(imu, "rate")
    integrator = strapdown.Integrator(pva)
    integrator.integrate(increments)  # compiles, and gives the velocities to correct with
    velocity = sim.generate_body_velocity_measurements(integrator.trajectory.iloc[25::25], 0.01, 0)
    bias = inertial_sensor.EstimationModel(bias_sd=np.full(3, 1e-4), noise=1e-5, bias_walk=1e-7)
    stamps: list[int] = []
    original = filters._compute_error_propagation_matrices

    def noted(*arguments: Any) -> Any:
        stamps.append(time.perf_counter_ns())
        return original(*arguments)

    filters._compute_error_propagation_matrices = noted
    try:
        filters.run_feedback_filter(
            pva, 10.0, 0.5, 1.0, 5.0, increments, bias, bias, measurements=[measurements.BodyVelocity(velocity, 0.01)], time_step=0.01
        )
    finally:
        filters._compute_error_propagation_matrices = original
    return {"step": np.diff(np.array(stamps))[10:]}


def starts() -> dict[str, tuple[float, float]]:
    """Seconds to the first state, and processor seconds of the whole process, with an empty cache and with a full one."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name, warm in (("from nothing, with warm_up()", True), ("warm cache, with warm_up()", True), ("warm cache", False)):
            command = [sys.executable, "-c", START.replace("{warm}", str(warm))]
            runs = []
            for _ in range(1 if "nothing" in name else 3):
                done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
                wall, processor = map(float, done.stdout.split())
                runs.append((wall, processor))
            found[name] = min(runs)
    return found


def microseconds(spent: np.ndarray) -> dict[str, float]:
    """Percentiles of nanoseconds, in microseconds."""
    names = [f"p{share:g}" for share in SHARES[:-1]] + ["max"]
    return dict(zip(names, (np.percentile(spent, SHARES) / 1e3).tolist(), strict=True))


def navfilter_rows(vehicle: nf.Vehicle, mission: nf.Mission, minutes: float) -> dict[str, dict[str, float]]:
    """Percentiles of our calls: by both clocks, as Python comes and with what is there frozen."""
    rows = {}
    events = readings(vehicle, mission)
    timed(nf.Navigator(vehicle, mission.start), events[:10000], time.perf_counter_ns)
    for how in ("", ", gc.freeze()"):
        if how:
            gc.collect()
            gc.freeze()
        for clock, name in ((time.perf_counter_ns, "wall"), (time.thread_time_ns, "processor")):
            nav = nf.Navigator(vehicle, mission.start)
            for call, spent in timed(nav, events, clock).items():
                rows[f"{call}, {name}{how}"] = microseconds(spent) | {"over 10 ms": int((spent > 1e7).sum())}
    gc.unfreeze()
    return rows


def main() -> None:
    """Time everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--no-start", action="store_true", help="leave out the starts")
    arguments = parser.parse_args()
    base, mission = simulate_scenario("lawnmower", 1, 60.0 * arguments.minutes)
    vehicle = vehicle_of(base)
    nf.warm_up()
    rows = {f"navfilter {name}": row for name, row in navfilter_rows(vehicle, mission, arguments.minutes).items()}
    n = 9 + len(nf.Navigator(vehicle, mission.start).errors)
    rows |= {f"filterpy {name}, wall": microseconds(spent) for name, spent in filterpy_times(n, 20000).items()}
    imu = mission.streams["imu"]
    samples = np.column_stack([imu.time_s, imu.value])[:2000]
    rows |= {f"python-ins {name} (15 states), wall": microseconds(spent) for name, spent in pyins_times(samples, mission.start).items()}
    learning = "on" if hasattr(nf, "LearnedArma") else "not in this version"
    print(f"{arguments.minutes:g} min at {vehicle.drive.rate_hz:g} Hz, {n} error states, learning {learning}; microseconds per call")
    print(f"{'':44s}" + "".join(f"{name:>11s}" for name in ("p50", "p99", "p99.9", "max", "over 10 ms")))
    for name, row in rows.items():
        print(f"{name:44s}" + "".join(f"{value:11d}" if isinstance(value, int) else f"{value:11.1f}" for value in row.values()))
    ours = rows["navfilter step, wall"]["p50"]
    for who in ("filterpy step, wall", "python-ins step (15 states), wall"):
        print(f"median of {who}: {rows[who]['p50'] / ours:.1f} times ours")
    for name, target in TARGETS_US.items():
        call, share = name.split()
        for clock in ("wall", "processor"):
            value = rows[f"navfilter {call}, {clock}, gc.freeze()"][share]
            print(f"target {name} <= {target:g} us: {value:.1f} by the {clock} clock, {'met' if value <= target else 'NOT met'}")
    began = {} if arguments.no_start else starts()
    for name, (wall, processor) in began.items():
        print(f"start to first state, {name}: {wall:.2f} s ({processor:.2f} s of the processor)")
    if arguments.json:
        arguments.json.write_text(json.dumps({"minutes": arguments.minutes, "states": n, "us": rows, "start_s": began}, indent=1))


if __name__ == "__main__":
    main()

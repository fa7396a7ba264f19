"""One hour at 100 Hz through the filter and the smoother, beside filterpy and python-ins, in one run.

The mission: an inertial unit at 100 Hz, DVL 4 Hz, compass 8 Hz, depth 1 Hz, GPS 1 Hz at the surface; 29 error states. Competitors
get the same work per step on a part of the hour, and their time is scaled to the whole: filterpy's KalmanFilter predicts at 100 Hz
and updates at the
sensors' rates with matrices of the same size (no mechanisation, no Jacobians: its best case), its rts_smoother runs over the steps
kept;
python-ins integrates the same inertial samples (strapdown alone) and runs its feedback filter with the DVL and the depth as far as
it has them. Learning on all eight channels (compass, DVL, depth, GPS; orders up to (4, 4)) is measured against the plain filter of the
same vehicle, turn by turn.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import navfilter as nf
from navfilter.kernels import strapdown
from navfilter.simulation.scenarios import simulate_scenario


def vehicle_29(base: nf.Vehicle) -> nf.Vehicle:
    """The survey vehicle with 29 error states: Gauss-Markov or ARMA errors on every sensor, scale and misalignment of the DVL."""
    gps = base.sensors["gps"]
    sensors = {
        "compass": nf.Heading(rate_hz=8, error=nf.Arma(ar=(-1.7, 0.72), ma=(0.3,), sd=2e-4) + nf.White(sd=2e-3)),
        "dvl": nf.BodyVelocity(
            rate_hz=4, error=nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.01), scale_sd=0.003, misalignment_sd_rad=0.005
        ),
        "depth": nf.Depth(rate_hz=1, error=nf.White(sd=0.05), offset_sd_m=0.2),
        "gps": gps,
    }
    return nf.Vehicle(base.drive, sensors, "survey, 29 states")


def cpu(work: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def learning_seconds(vehicle: nf.Vehicle, mission: nf.Mission, turns: int) -> dict[str, float]:
    """Processor seconds of the plain filter and of one that learns every correcting sensor's error, least of some turns each."""
    learning = vehicle.with_error(**{name: nf.LearnedArma() for name in vehicle.sensors})
    nf.replay(learning, mission.between(0.0, 700.0))  # compile, or load what was compiled
    plain, learnt, adopted = math.inf, math.inf, 0
    for _ in range(turns):
        plain = min(plain, cpu(lambda: nf.replay(vehicle, mission)))
        began = time.process_time()
        adopted = nf.replay(learning, mission).counts["adopted"]
        learnt = min(learnt, time.process_time() - began)
    channels = sum(sensor.axes for sensor in vehicle.sensors.values())
    return {"channels": channels, "plain_s": plain, "learning_s": learnt, "added_share": learnt / plain - 1.0, "adoptions": adopted}


def filterpy_seconds(n: int, steps: int, corrections: float) -> tuple[float, float]:
    """Processor seconds per step (forward, smoother) of filterpy at n states, with a correction every so many steps."""
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(0)
    kf = KalmanFilter(dim_x=n, dim_z=1)
    kf.x, kf.F = np.zeros(n), np.eye(n) + 0.001 * rng.normal(size=(n, n))
    kf.Q, kf.H, kf.R = 1e-4 * np.eye(n), rng.normal(size=(1, n)), np.eye(1)
    means, covariances, due = np.empty((steps, n)), np.empty((steps, n, n)), 0.0
    began = time.process_time()
    for k in range(steps):
        kf.predict()
        due += corrections
        if due >= 1.0:
            kf.update(np.zeros(1))
            due -= 1.0
        means[k], covariances[k] = kf.x, kf.P
    forward = (time.process_time() - began) / steps
    kept = max(10, int(steps * corrections))
    smoother = cpu(lambda: kf.rts_smoother(means[:kept], covariances[:kept])) / kept
    return forward, smoother


def pyins_seconds(samples: np.ndarray, start: nf.Start) -> tuple[float, float]:
    """Processor seconds per sample of python-ins: strapdown alone, and its feedback filter with a body velocity at 4 Hz."""
    import pandas as pd
    from pyins import filters, inertial_sensor, measurements, sim, util
    from pyins import strapdown as pyins_strapdown

    imu = pd.DataFrame(samples[:, 1:], index=pd.Index(samples[:, 0], name="time"), columns=util.GYRO_COLS + util.ACCEL_COLS)
    pva = pd.Series(
        [start.latitude_deg, start.longitude_deg, start.height_m, *start.velocity_n, start.roll_deg, start.pitch_deg, start.heading_deg],
        index=util.TRAJECTORY_COLS,
        name=float(samples[0, 0]),
    )
    pyins_strapdown.Integrator(pva).integrate(pyins_strapdown.compute_increments_from_imu(imu.iloc[:100], "rate"))  # compile
    began = time.process_time()
    increments = pyins_strapdown.compute_increments_from_imu(imu, "rate")
    integrator = pyins_strapdown.Integrator(pva)
    integrator.integrate(increments)
    alone = (time.process_time() - began) / len(samples)
    part = increments.iloc[:6000]
    trajectory = integrator.trajectory.iloc[:6001]
    velocity = sim.generate_body_velocity_measurements(trajectory.iloc[25::25], 0.01, 0)
    bias = inertial_sensor.EstimationModel(bias_sd=np.full(3, 1e-4), noise=1e-5, bias_walk=1e-7)
    began = time.process_time()
    filters.run_feedback_filter(
        pva, 10.0, 0.5, 1.0, 5.0, part, bias, bias, measurements=[measurements.BodyVelocity(velocity, 0.01)], time_step=0.1
    )
    return alone, (time.process_time() - began) / len(part)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--quick", action="store_true", help="ten minutes instead of an hour")
    args = parser.parse_args()
    seconds = 600.0 if args.quick else 3600.0
    base, mission = simulate_scenario("lawnmower", 1, seconds)
    vehicle = vehicle_29(base)
    nf.replay(vehicle, mission.between(0.0, 30.0), smooth=True)  # compile, or load what was compiled
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    forward = min(cpu(lambda: nf.replay(vehicle, mission)) for _ in range(2))
    both = min(cpu(lambda: nf.replay(vehicle, mission, smooth=True)) for _ in range(2))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    learning = learning_seconds(base, mission, 1 if args.quick else 3)
    imu = mission.streams["imu"]
    samples = np.column_stack([imu.time_s, imu.value])
    readings = sum(len(mission.streams[name]) for name in vehicle.sensors)

    def batch() -> None:
        strapdown.integrate(mission.start.state.pack(), vehicle.drive.memory(0), steps, np.empty((0, 17)))

    steps = samples.copy()
    steps[:, 0] = np.diff(samples[:, 0], prepend=samples[0, 0])
    batch()
    alone = min(cpu(batch) for _ in range(3)) / len(samples)
    n = 9 + len(nf.Navigator(vehicle, mission.start).errors)
    fp_forward, fp_smoother = filterpy_seconds(n, 5000, readings / len(samples))
    py_alone, py_filter = pyins_seconds(samples[:60000], mission.start)
    scale = len(samples)
    rows = [
        ("forward filter", forward, fp_forward * scale, py_filter * scale),
        ("forward + smoother", both, fp_forward * scale + fp_smoother * readings, None),
        ("strapdown alone", alone * scale, None, py_alone * scale),
    ]
    print(f"{seconds / 3600:.2f} h, {len(samples)} inertial samples, {readings} readings, {n} error states; processor seconds")
    print(f"{'':22s}{'navfilter':>11s}{'filterpy':>11s}{'ratio':>8s}{'python-ins':>12s}{'ratio':>8s}")
    for name, ours, filterpy, pyins in rows:
        line = f"{name:22s}{ours:11.3f}"
        line += f"{filterpy:11.1f}{filterpy / ours:8.1f}" if filterpy else f"{'-':>11s}{'':8s}"
        line += f"{pyins:12.1f}{pyins / ours:8.1f}" if pyins else f"{'-':>12s}{'':8s}"
        print(line)
    print(
        f"strapdown alone: {1e-6 / alone:.1f} million samples/s; peak memory {peak:.0f} MB ({before:.0f} MB before the hour was replayed)"
    )
    print(
        f"learning on {learning['channels']} channels: plain {learning['plain_s']:.2f} s, learning {learning['learning_s']:.2f} s, "
        f"{100 * learning['added_share']:+.0f} %, {learning['adoptions']} adoptions"
    )
    if args.json:
        figures = {name: {"navfilter_s": a, "filterpy_s": b, "python_ins_s": c} for name, a, b, c in rows}
        extra = {"hours": seconds / 3600, "states": n, "strapdown_samples_per_s": 1 / alone, "peak_mb": peak, "before_mb": before}
        args.json.write_text(json.dumps(figures | extra | {"learning": learning}, indent=1))


if __name__ == "__main__":
    main()

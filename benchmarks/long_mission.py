"""A day-long mission through filter and smoother: peak memory, processor time, and that spooling changes nothing.

The mission: `--hours` (default 24) at 100 Hz inertial, DVL 4 Hz, depth and compass 1 Hz, a straight transit generated in place (one
array for the inertial samples, no truth), so that the memory measured is that of the mission's own samples and of navfilter. Ours
is compared
with what the plain way would need: one float64 state and covariance per inertial sample, as filterpy's rts_smoother takes them.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

import navfilter as nf


def transit(hours: float, seed: int = 1) -> tuple[nf.Vehicle, nf.Mission]:
    """A level transit due east at 1.5 m/s at 45 degrees north with honest noise; readings without truth."""
    rng = np.random.default_rng(seed)
    n = int(hours * 3600 * 100) + 1
    latitude, speed = np.radians(45.0), 1.5
    rate, prime = 7.292115e-5, 6378137.0 / np.sqrt(1 - 0.00669437999014 * 0.5)
    w_n, w_d = rate * np.cos(latitude), -rate * np.sin(latitude)
    turn = speed / prime
    # heading east: forward = east, right = south
    imu = np.empty((n, 6))
    means = (0.0, -(w_n + turn), w_d - turn * np.tan(latitude))
    force_n = -speed * ((w_d * 2) - turn * np.tan(latitude)) * -1.0
    for i in range(3):
        imu[:, i] = means[i] + rng.normal(scale=1e-3, size=n)
        imu[:, 3 + i] = rng.normal(scale=0.01, size=n)
    imu[:, 4] += -force_n
    imu[:, 5] -= 9.806
    vehicle = nf.Vehicle(
        imu=nf.Imu(
            rate_hz=100,
            gyro=nf.White(sd=1e-3) + nf.RandomWalk(density=1e-7, start_sd=1e-5),
            accel=nf.White(sd=0.01) + nf.RandomWalk(density=1e-6, start_sd=0.01),
        ),
        sensors={
            "dvl": nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01)),
            "compass": nf.Heading(rate_hz=1, error=nf.GaussMarkov(sd=0.01, tau_s=30.0) + nf.White(sd=0.005)),
            "depth": nf.Depth(rate_hz=1, error=nf.White(sd=0.05)),
        },
    )
    times = {"dvl": np.arange(0, hours * 3600, 0.25), "compass": np.arange(0, hours * 3600, 1.0), "depth": np.arange(0, hours * 3600, 1.0)}
    streams = {
        "imu": nf.Stream(np.arange(n) * 0.01, imu),
        "dvl": nf.Stream(times["dvl"], np.array([speed, 0, 0]) + rng.normal(scale=0.01, size=(len(times["dvl"]), 3))),
        "compass": nf.Stream(times["compass"], np.pi / 2 + rng.normal(scale=0.011, size=len(times["compass"]))),
        "depth": nf.Stream(times["depth"], rng.normal(scale=0.05, size=len(times["depth"]))),
    }
    start = nf.Start(
        latitude_deg=45.0, longitude_deg=-30.0, velocity_n=(0.0, speed, 0.0), heading_deg=90.0, heading_sd_deg=1.0, tilt_sd_deg=0.1
    )
    return vehicle, nf.Mission(f"{hours:g} h transit", streams, start=start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--quick", action="store_true", help="one hour")
    args = parser.parse_args()
    hours = 1.0 if args.quick else args.hours
    vehicle, mission = transit(hours)
    nf.replay(vehicle, mission.between(0.0, 20.0), smooth=True)
    loaded = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    began = time.process_time()
    track = nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0, progress=True)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    n = 9 + len(track.state_names)
    plain = len(mission.streams["imu"]) * (n + n * n) * 8 / 2**20
    definite = bool(np.all(np.linalg.eigvalsh(track.covariance[::60]) > 0))
    print(f"{hours:g} h, {len(mission.streams['imu'])} inertial samples, {n} error states")
    print(f"{'processor time forward, both':34s}{track.forward.cpu_s:10.1f}{seconds:10.1f} s")
    print(f"{'peak memory with the mission loaded':34s}{loaded:10.0f} MB")
    print(
        f"{'peak memory after the smoother':34s}{peak:10.0f} MB  (a state and covariance per sample: "
        f"{plain:.0f} MB, {plain / peak:.0f} times)"
    )
    print(f"smoothed covariances positive definite: {definite}")
    if args.json:
        figures = {"hours": hours, "states": n, "forward_s": track.forward.cpu_s, "both_s": seconds, "loaded_mb": loaded, "peak_mb": peak}
        args.json.write_text(json.dumps(figures | {"plain_mb": plain, "definite": definite}, indent=1))


if __name__ == "__main__":
    main()

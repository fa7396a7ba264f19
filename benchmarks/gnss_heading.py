"""Is a heading honest that only fixes and accelerations tell? An hour of GNSS and a MEMS unit, fixes lost now and then.

No compass. Fixes of 1 m (white) once a second, lost for 60 s every 5 min; the unit of `presets.mems_imu`. Truth and
filter have one and the same description, the start is drawn from what is said of it: what is left of NEES is the filter
itself. There is no other software in the run.

| motion | |
|---|---|
| car | 5 to 20 m/s, a turn every 10 to 60 s: each turns the velocity by far more than tilt and noise do |
| boat | 3 m/s, a turn every 1 to 3 min |
| slow | 1.5 m/s, as the boat: the heading is only known to some degrees, and all the time |

Printed: NEES of the heading (1 is honest) over all of the hour with its standard error, of slots of it, and of the
position; median of the sd of the heading after the first five minutes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from harness import DEG, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.models.mission import Mission
from navfilter.simulation.manoeuvres import ChangeSpeed, Manoeuvre, Straight, Turn, Wait
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.presets import mems_imu
from navfilter.simulation.simulate import Faults, StartErrors, simulate

#: Without fixes so long, so often [s].
LOST_S, EVERY_S = 60.0, 300.0
#: Slots that are scored on their own [s].
SLOTS = {
    "first_min": (0.0, 60.0),
    "to_5_min": (60.0, 300.0),
    "to_30_min": (300.0, 1800.0),
    "to_60_min": (1800.0, 3600.0),
}
SPEED_M_S = {"boat": 3.0, "slow": 1.5}
IMU_HZ = 20.0


def way(kind: str, duration_s: float, seed: int) -> Motion:
    """A drive or a cruise of at least this duration."""
    random = np.random.default_rng([seed, 77])
    legs: list[Manoeuvre] = [Wait(10.0)]
    speed, time_s = 0.0, 0.0
    while time_s < duration_s:
        if kind == "car":
            to, turn, rate = float(random.uniform(5.0, 20.0)), float(random.choice([-90.0, 90.0, 45.0, -45.0])), 12.0
            change_s, straight_s = abs(to - speed) + 2.0, float(random.uniform(10.0, 60.0))
        else:
            to, turn, rate = SPEED_M_S[kind], float(random.choice([-90.0, 90.0, 180.0, -180.0])), 6.0
            change_s, straight_s = 20.0 if speed == 0.0 else 1.0, float(random.uniform(60.0, 200.0))
        legs += [ChangeSpeed(to, change_s), Straight(straight_s), Turn(turn, rate)]
        speed, time_s = to, time_s + change_s + straight_s + abs(turn) / rate
    heading_deg = float(random.uniform(0.0, 360.0))
    return Motion(tuple(legs), latitude_deg=45.0, longitude_deg=10.0, heading_deg=heading_deg, wander=Wander())


def drive_of(
    kind: str, seed: int, minutes: float, heading_sd_deg: float, scale_sd: float
) -> tuple[nf.Vehicle, Mission]:
    """Vehicle and simulated mission."""
    imu = mems_imu(IMU_HZ)
    if scale_sd:
        half = 0.5 * scale_sd
        imu = replace(imu, gyro_scale_sd=scale_sd, gyro_misalignment_sd_rad=half, accel_scale_sd=half)
    gps = nf.Position(rate_hz=1.0, error=nf.White(sd=1.0), lever_arm_b_m=(0.0, 0.0, -0.5))
    vehicle, duration_s = nf.Vehicle(imu=imu, sensors={"gps": gps}), 60.0 * minutes
    lost = tuple((begin, begin + LOST_S) for begin in np.arange(EVERY_S, duration_s, EVERY_S).tolist())
    start = StartErrors(velocity_sd_m_s=0.1, tilt_sd_deg=0.5, heading_sd_deg=heading_sd_deg)
    faults = {"gps": Faults(dropouts=lost)}
    mission = simulate(
        vehicle, way(kind, duration_s, seed), seed=seed, duration_s=duration_s, faults=faults, start=start
    )
    return vehicle, mission


def scored(kind: str, seed: int, minutes: float, heading_sd_deg: float, scale_sd: float) -> dict[str, float]:
    """Mean NEES of one hour and of its slots, and the sd of its heading."""
    vehicle, mission = drive_of(kind, seed, minutes, heading_sd_deg, scale_sd)
    track = nf.replay(vehicle, mission)
    nees, t = track.nees(track.errors(mission.truth)), track.time_s
    found = {"nees": float(np.mean(nees["heading"])), "nees_position": float(np.mean(nees["position"]))}
    for name, (begin, end) in SLOTS.items():
        inside = (t >= begin) & (t < end)
        found[name] = float(np.mean(nees["heading"][inside])) if inside.any() else np.nan
    late = t > min(EVERY_S, 0.5 * t[-1])
    return found | {"sd_deg": float(np.median(np.sqrt(track.covariance[late, 8, 8])) / DEG)}


def gnss_heading(options: Options) -> list[dict[str, Any]]:
    """Simulate, replay, print."""
    seeds = range(options.seed, options.seed + (2 if options.quick else options.runs))
    minutes = 6.0 if options.quick else options.minutes
    columns = " ".join(f"{name}>10.2f" for name in SLOTS)
    table = Table(f"motion<8 sd_deg>7.2f nees>6.2f standard_error>6.2f {columns} nees_position>6.2f")
    for kind in ("car", *SPEED_M_S):
        if options.only not in kind:
            continue
        runs = [scored(kind, seed, minutes, options.heading_sd_deg, options.scale_sd) for seed in seeds]
        row = {key: float(np.mean([run[key] for run in runs])) for key in runs[0]}
        spread = float(np.std([run["nees"] for run in runs], ddof=1) / np.sqrt(len(runs)))
        table.add({"motion": kind} | row | {"standard_error": spread})
    return table.rows


if __name__ == "__main__":
    flags = [
        flag("--runs", type=int, default=20, help="seeds"),
        flag("--seed", type=int, default=300, help="the first of them"),
        flag("--minutes", type=float, default=60.0),
        flag("--heading-sd-deg", type=float, default=5.0, help="how well the heading is known at the start"),
        flag("--scale-sd", type=float, default=0.0, help="scale of the gyros as states; half of it elsewhere"),
        flag("--only", default="", help="only motions whose name contains this"),
        quick("two seeds of six minutes"),
    ]
    main(__doc__, {gnss_heading: flags})

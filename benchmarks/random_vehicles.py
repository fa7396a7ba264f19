"""Vehicles with an inertial unit, drawn for `honest_random.py`: sensors, rates, errors, constants and ways."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from harness import DEG

import navfilter as nf
from navfilter.simulation import presets
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Surface, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, survey, transit, turns_and_dives

Random = np.random.Generator


def steep(seconds: float) -> Motion:
    """Down and up by 35 degrees."""
    cycle = (Dive(40.0, 35.0), Straight(duration_s=10.0), Dive(8.0, 35.0), Turn(120.0))
    begin = (Wait(20.0), ChangeSpeed(1.5, 15.0), Straight(duration_s=45.0))
    return Motion((*begin, *cycle * max(1, int(seconds / 110.0)), Surface(), Straight(duration_s=45.0)))


def boat(seconds: float) -> Motion:
    """At the surface, in turns, now faster and now slower."""
    legs = (Turn(90.0), Straight(duration_s=50.0), Turn(-140.0), Straight(duration_s=40.0))
    cycle = (*legs, ChangeSpeed(2.0, 5.0), Straight(duration_s=20.0), ChangeSpeed(5.0, 10.0))
    begin = (Wait(10.0), ChangeSpeed(4.0, 15.0), Straight(duration_s=60.0))
    return Motion((*begin, *cycle * max(1, int(seconds / 200.0))))


MOTIONS = {
    "lawnmower": lawnmower,
    "transit": transit,
    "dives": turns_and_dives,
    "survey": survey,
    "steep": steep,
    "boat": boat,
}


def between(r: Random, least: float, most: float) -> float:
    """One of all orders of magnitude alike."""
    return float(np.exp(r.uniform(math.log(least), math.log(most))))


def chance(r: Random, share: float) -> bool:
    """True in this share of the draws."""
    return bool(r.random() < share)


def error(r: Random, sd: float) -> nf.ErrorModel:
    """Of about this standard deviation: white, slow, smooth, swinging, or of two times."""
    kind, tau_s = int(r.integers(0, 6)), between(r, 2.0, 300.0)
    if kind == 0:
        return nf.White(sd=sd)
    if kind == 1:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s) + nf.White(sd=sd * between(r, 0.1, 1.0))
    if kind == 2:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s, order=2) + nf.White(sd=sd * between(r, 0.05, 0.5))
    if kind == 3:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s)
    if kind == 4:
        radius, turn = r.uniform(0.7, 0.98), r.uniform(0.1, 2.5)
        swing = nf.Arma(ar=(-2.0 * radius * math.cos(turn), radius**2), sd=sd * (1.0 - radius))
        return swing + nf.White(sd=0.2 * sd)
    slow, quicker = nf.GaussMarkov(sd=0.7 * sd, tau_s=tau_s), nf.GaussMarkov(sd=0.7 * sd, tau_s=0.1 * tau_s)
    return slow + quicker + nf.White(sd=0.1 * sd)


def arm(r: Random) -> tuple[float, float, float]:
    """Up to four metres."""
    x, y, z = (r.uniform(-1.0, 1.0, 3) * between(r, 0.1, 4.0)).tolist()
    return x, y, z


def unknown(r: Random, share: float) -> dict[str, Any]:
    """Clock and lever arm as states, in this share of the draws."""
    clock = {"time_offset_sd_s": between(r, 0.02, 0.4)} if chance(r, share) else {}
    return clock | ({"lever_arm_sd_m": (between(r, 0.05, 0.5),) * 3} if chance(r, 0.7 * share) else {})


def unit(r: Random) -> nf.Imu:
    """Tactical or micromechanical, with or without its own constants as states."""
    drive = presets.mems_imu() if chance(r, 0.5) else presets.tactical_imu()
    drive = replace(drive, rate_hz=float(r.choice([20.0, 50.0, 100.0])))
    if chance(r, 0.2):
        drive = replace(drive, gyro_scale_sd=between(r, 1e-4, 5e-3), accel_scale_sd=between(r, 1e-4, 5e-3))
    if chance(r, 0.15):
        drive = replace(drive, gyro_misalignment_sd_rad=between(r, 1e-4, 5e-3))
        drive = replace(drive, accel_misalignment_sd_rad=between(r, 1e-4, 3e-3))
    return drive


def north(r: Random) -> dict[str, nf.Sensor]:
    """A compass, a magnetometer, an AHRS, or nothing that knows north."""
    kind, rate_hz = r.random(), float(r.choice([0.5, 1.0, 4.0, 8.0, 16.0]))
    if kind < 0.15:
        iron = {"hard_iron_sd": between(r, 0.2, 3.0), "soft_iron_sd": between(r, 0.002, 0.03)} if chance(r, 0.5) else {}
        white = nf.White(sd=between(r, 0.1, 1.0) * DEG)
        return {"compass": nf.Heading(rate_hz=rate_hz, magnetometer=True, error=white, **iron)}
    if kind < 0.55:
        own: dict[str, Any] = {"bias_sd_rad": between(r, 0.3, 4.0) * DEG} if chance(r, 0.3) else {}
        if chance(r, 0.3):
            own["deviation_sd_rad"] = (between(r, 0.3, 5.0) * DEG, between(r, 0.2, 2.0) * DEG)
        return {"compass": nf.Heading(rate_hz=rate_hz, error=error(r, between(r, 0.1, 2.5) * DEG), **own)}
    if kind < 0.75:
        tilt = nf.GaussMarkov(sd=0.3 * DEG, tau_s=20.0)
        off = between(r, 0.2, 2.0) * DEG if chance(r, 0.3) else 0.0
        yaw = error(r, between(r, 0.2, 2.0) * DEG)
        return {"ahrs": nf.Attitude(rate_hz=rate_hz, error=(tilt, tilt, yaw), misalignment_sd_rad=off)}
    return {}


def velocity(r: Random) -> dict[str, nf.Sensor]:
    """A DVL, the beams of one, a log, or nothing."""
    kind, rate_hz = r.random(), float(r.choice([0.5, 1.0, 2.0, 5.0, 8.0]))
    place = {"rate_hz": rate_hz, "error": error(r, between(r, 0.003, 0.05)), "lever_arm_b_m": arm(r)}
    more: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.03)} if chance(r, 0.4) else {}
    more |= unknown(r, 0.25)
    if kind < 0.5:
        angle = between(r, 0.2, 3.0) * DEG if chance(r, 0.4) else 0.0
        return {"dvl": nf.BodyVelocity(misalignment_sd_rad=angle, **place, **more)}
    if kind < 0.65:
        return {"dvl": nf.DvlBeams(**place, **more)}
    if kind < 0.8:
        flows = {"current_sd_m_s": between(r, 0.03, 0.5), "current_tau_s": between(r, 300.0, 20000.0)}
        return {"water": nf.WaterVelocity(**place, **flows)}
    return {}


def place(r: Random) -> dict[str, nf.Sensor]:
    """Fixes, and mostly a depth gauge; now and then USBL, course over ground, and rates at rest."""
    found: dict[str, nf.Sensor] = {}
    if chance(r, 0.7):
        offset = between(r, 0.05, 1.0) if chance(r, 0.3) else 0.0
        found["depth"] = nf.Depth(error=error(r, between(r, 0.02, 0.3)), lever_arm_b_m=arm(r), offset_sd_m=offset)
    rate_hz = float(r.choice([0.2, 1.0, 5.0]))
    fixes = {"rate_hz": rate_hz, "error": error(r, between(r, 0.02, 5.0)), "lever_arm_b_m": arm(r)}
    found["gps"] = nf.Position(**fixes, **unknown(r, 0.15))
    if chance(r, 0.25):
        angles = nf.White(sd=between(r, 0.002, 0.02))
        found["usbl"] = nf.Usbl(rate_hz=0.2, error=(nf.White(sd=between(r, 0.2, 3.0)), angles, angles))
    if chance(r, 0.15):
        found["course"] = nf.Course()
    if chance(r, 0.15):
        found["turning"] = nf.ZeroRate()
    return found

"""Vehicles that reckon by a velocity and a heading, drawn at random, for `honest_random.py`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from harness import DEG
from random_vehicles import MOTIONS, Random, arm, between, chance, error, place, unknown

import navfilter as nf
from navfilter.models.error_models import Cycle
from navfilter.simulation.motion import Motion

EARTH_RADIUS_M, TIDE_S = 6.371e6, 44714.0


def heading(r: Random, rate_hz: float) -> nf.Heading | tuple[nf.ErrorModel, ...]:
    """A compass with or without its constants as states, or the errors of three angles."""
    yaw = error(r, between(r, 0.05, 3.0) * DEG)
    if chance(r, 0.2):
        tilt = error(r, between(r, 0.05, 1.0) * DEG)
        return tilt, tilt, yaw
    own: dict[str, Any] = {"bias_sd_rad": between(r, 0.3, 4.0) * DEG} if chance(r, 0.3) else {}
    if chance(r, 0.3):
        own["deviation_sd_rad"] = (between(r, 0.3, 5.0) * DEG, between(r, 0.2, 2.0) * DEG)
    if chance(r, 0.3):
        own["time_offset_sd_s"] = between(r, 0.02, 0.5)
    return nf.Heading(rate_hz=rate_hz, error=yaw, **own)


def current(r: Random) -> dict[str, Any]:
    """Of first or second order, or a tide."""
    sd, tau_s, kind = between(r, 0.03, 0.5), between(r, 300.0, 20000.0), r.random()
    if kind < 0.5:
        return {"current_sd_m_s": sd, "current_tau_s": tau_s}
    if kind < 0.75:
        return {"current": nf.GaussMarkov(sd=sd, tau_s=tau_s, order=2)}
    return {"current": nf.GaussMarkov(sd=0.5 * sd, tau_s=tau_s) + Cycle(sd=sd, period_s=TIDE_S, tau_s=1e6)}


def velocity(r: Random, rate_hz: float) -> nf.BodyVelocity | nf.WaterVelocity:
    """A DVL, wheels, a log that makes leeway, or what is known of a glider's velocity."""
    kind, sd = r.random(), between(r, 0.003, 0.1)
    at: dict[str, Any] = {"rate_hz": rate_hz, "zero_is_invalid": False}
    constants: dict[str, Any] = {"lever_arm_b_m": arm(r)} | unknown(r, 0.35)
    if chance(r, 0.4):
        constants["scale_sd"] = (between(r, 0.001, 0.05),) * (3 if chance(r, 0.2) else 1)
        constants["scale_sd"] = constants["scale_sd"] if len(constants["scale_sd"]) == 3 else constants["scale_sd"][0]
    if chance(r, 0.3):
        constants["misalignment_sd_rad"] = between(r, 0.2, 4.0) * DEG
    if kind < 0.45:
        return nf.BodyVelocity(error=error(r, sd), **at, **constants)
    if kind < 0.6:
        slip = nf.White(sd=between(r, 0.002, 0.05))
        return nf.BodyVelocity(error=(error(r, sd), slip, slip), **at, **constants)
    if kind < 0.85:
        leeway = nf.GaussMarkov(sd=between(r, 0.01, 0.1), tau_s=between(r, 50.0, 1000.0)) + nf.White(sd=sd)
        axes = (error(r, sd), leeway, error(r, sd))
        return nf.WaterVelocity(error=axes, **at, **constants, **current(r))
    along = nf.GaussMarkov(sd=between(r, 0.1, 0.4), tau_s=between(r, 30.0, 300.0))
    across = nf.GaussMarkov(sd=between(r, 0.005, 0.05), tau_s=between(r, 30.0, 300.0))
    return nf.WaterVelocity(error=(along, across, across), **at, **current(r))


def beside(r: Random, way: Motion, drive: nf.DeadReckoning) -> dict[str, nf.Sensor]:
    """What corrects it: fixes, mostly depth; now and then USBL, course, ranges, another compass and bottom track."""
    found = {name: sensor for name, sensor in place(r).items() if name != "turning"}
    if chance(r, 0.2):
        ways = r.normal(0.0, 200.0, (3, 2)) / (EARTH_RADIUS_M * DEG)
        by_east = np.cos(way.latitude_deg * DEG)
        beacons = tuple((way.latitude_deg + north, way.longitude_deg + east / by_east, -40.0) for north, east in ways)
        white = nf.White(sd=between(r, 0.05, 2.0))
        found["ranges"] = nf.Range(rate_hz=0.5, beacons=beacons, error=white, **unknown(r, 0.2))
    if chance(r, 0.1):
        found["compass"] = nf.Heading(rate_hz=1.0, error=error(r, between(r, 0.2, 3.0) * DEG))
    if chance(r, 0.4) and isinstance(drive.velocity, nf.WaterVelocity):
        found["bottom"] = nf.BodyVelocity(rate_hz=1.0, error=error(r, between(r, 0.003, 0.05)), lever_arm_b_m=arm(r))
    return found


def reckoning(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """A vehicle, the name of its motion, its way and how long it takes [s]."""
    rate_hz = float(r.choice([0.5, 1.0, 2.0, 4.0, 8.0]))
    tilt = error(r, between(r, 0.05, 1.0) * DEG)
    drive = nf.DeadReckoning(rate_hz=rate_hz, attitude=heading(r, rate_hz), velocity=velocity(r, rate_hz), tilt=tilt)
    motion, duration_s = str(r.choice(list(MOTIONS))), float(r.choice([600.0, 900.0, 1500.0, 2400.0]))
    north_deg, east_deg = float(r.uniform(-65.0, 75.0)), float(r.uniform(-180.0, 180.0))
    way = replace(MOTIONS[motion](duration_s), latitude_deg=north_deg, longitude_deg=east_deg)
    return nf.Vehicle(drive, beside(r, way, drive)), motion, way, duration_s

"""Vehicles with an inertial unit that are placed by sound, or that roll on wheels, drawn for `honest_random.py`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from harness import DEG
from random_vehicles import MOTIONS, Random, arm, between, chance, error, north, unit, unknown, velocity

import navfilter as nf
from navfilter.simulation.motion import Motion

EARTH_RADIUS_M = 6.371e6


def ranges(r: Random, way: Motion) -> nf.Range:
    """To one to four beacons around the way, known or to be found, with or without scale, offsets and clock."""
    around = r.normal(0.0, between(r, 100.0, 1500.0), (int(r.integers(1, 5)), 2)) / (EARTH_RADIUS_M * DEG)
    shrinks = float(np.cos(way.latitude_deg * DEG))
    deep_m = between(r, 5.0, 200.0)
    beacons = tuple((way.latitude_deg + y, way.longitude_deg + x / shrinks, -deep_m) for y, x in around.tolist())
    own: dict[str, Any] = {"beacon_sd_m": (between(r, 0.1, 5.0),) * 3} if chance(r, 0.4) else {}
    own |= {"scale_sd": between(r, 0.001, 0.02)} if chance(r, 0.3) else {}
    own |= {"offset_sd_m": between(r, 0.05, 2.0)} if chance(r, 0.2) else {}
    rate_hz = float(r.choice([0.1, 0.5, 1.0, 2.0]))
    named = error(r, between(r, 0.03, 3.0))
    return nf.Range(rate_hz=rate_hz, beacons=beacons, lever_arm_b_m=arm(r), error=named, **own, **unknown(r, 0.15))


def usbl(r: Random) -> nf.Usbl:
    """Of any of its kinds, with or without what is not known of ship and mounting."""
    angle = nf.White(sd=between(r, 0.002, 0.03))
    own: dict[str, Any] = {"misalignment_sd_rad": between(r, 0.2, 3.0) * DEG} if chance(r, 0.3) else {}
    own |= {"scale_sd": between(r, 0.001, 0.02)} if chance(r, 0.3) else {}
    if chance(r, 0.4):
        own |= {"ship_sd_m": (between(r, 0.2, 5.0),) * 3, "ship_tau_s": between(r, 20.0, 600.0)}
    errors = (error(r, between(r, 0.1, 3.0)), angle, angle)
    turned = tuple(r.uniform(-1.0, 1.0, 3).tolist())
    place = {"transceiver_m": arm(r), "transceiver_mounting_rad": turned, "lever_arm_b_m": arm(r)}
    return nf.Usbl(
        rate_hz=float(r.choice([0.1, 0.3, 1.0])),
        relative=chance(r, 0.5),
        error=errors,
        **place,
        **own,
        **unknown(r, 0.15),
    )


def wheels(r: Random) -> nf.Odometer:
    """Held to its way, at the point that nothing moves sideways, or with a forward speed only."""
    errors = (error(r, between(r, 0.005, 0.1)), *(nf.White(sd=between(r, 0.02, 0.2)),) * 2)
    own: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.05)} if chance(r, 0.5) else {}
    own |= {"time_offset_sd_s": between(r, 0.02, 0.4)} if chance(r, 0.2) else {}
    if chance(r, 0.3):
        own |= {"constrained": False, "lever_arm_b_m": arm(r), "misalignment_sd_rad": between(r, 0.2, 3.0) * DEG}
    return nf.Odometer(rate_hz=float(r.choice([1.0, 5.0, 10.0])), error=errors, **own)


def altitude(r: Random) -> nf.Altitude:
    """Over a bottom that is flat, or not."""
    own: dict[str, Any] = {}
    if chance(r, 0.7):
        own = {"bottom_sd_m": between(r, 0.2, 10.0), "bottom_tau_s": between(r, 10.0, 600.0)}
    return nf.Altitude(rate_hz=2.0, error=error(r, between(r, 0.03, 0.5)), lever_arm_b_m=arm(r), **own)


def acoustic(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """A vehicle, the name of its motion, its way and how long it takes [s]."""
    drive, motion = unit(r), str(r.choice(list(MOTIONS)))
    duration_s = float(r.choice([300.0, 600.0, 900.0, 1500.0]))
    north_deg, east_deg = float(r.uniform(-65.0, 75.0)), float(r.uniform(-180.0, 180.0))
    way = replace(MOTIONS[motion](duration_s), latitude_deg=north_deg, longitude_deg=east_deg)
    sensors = north(r) | ({"wheels": wheels(r)} if chance(r, 0.3) else velocity(r))
    if chance(r, 0.7):
        sensors["depth"] = nf.Depth(error=error(r, between(r, 0.02, 0.3)), lever_arm_b_m=arm(r))
    if chance(r, 0.6):
        sensors["ranges"] = ranges(r, way)
    if chance(r, 0.4) or "ranges" not in sensors:
        sensors["usbl"] = usbl(r)
    if chance(r, 0.25):
        sensors["altitude"] = altitude(r)
    if chance(r, 0.2):
        sensors["course"] = nf.Course()
    if chance(r, 0.5):
        rate_hz = between(r, 0.005, 1.0)
        sensors["gps"] = nf.Position(rate_hz=rate_hz, error=error(r, between(r, 0.02, 5.0)), lever_arm_b_m=arm(r))
    return nf.Vehicle(drive, sensors), motion, way, duration_s

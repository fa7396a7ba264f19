"""Vehicles with more than one instrument for one thing, drawn for `honest_random.py`: two velocities, two that know
north, a receiver's velocity with clock and arm, sound from a ship that turns, and sound without a unit.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
from harness import DEG, Array
from random_acoustics import ranges, usbl, wheels
from random_reckoning import beside, current, heading
from random_reckoning import velocity as driving
from random_vehicles import MOTIONS, Random, arm, between, chance, error, north, place, unit, unknown, velocity

import navfilter as nf
from navfilter.simulation.motion import Motion


def under_way(r: Random) -> tuple[str, Motion, float]:
    """Name of a motion, a way somewhere on Earth, and how long it takes [s]."""
    motion, duration_s = str(r.choice(list(MOTIONS))), float(r.choice([300.0, 600.0, 900.0, 1500.0]))
    north_deg, east_deg = float(r.uniform(-65.0, 75.0)), float(r.uniform(-180.0, 180.0))
    way = replace(MOTIONS[motion](duration_s), latitude_deg=north_deg, longitude_deg=east_deg)
    return motion, way, min(duration_s, way.duration_s)


def _dvl(r: Random) -> nf.BodyVelocity:
    """Over ground, with or without constants as states."""
    own: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.03)} if chance(r, 0.4) else {}
    own |= {"misalignment_sd_rad": between(r, 0.2, 3.0) * DEG} if chance(r, 0.4) else {}
    rate_hz, named = float(r.choice([0.5, 1.0, 2.0, 5.0, 8.0])), error(r, between(r, 0.003, 0.05))
    return nf.BodyVelocity(rate_hz=rate_hz, error=named, lever_arm_b_m=arm(r), **own, **unknown(r, 0.25))


def _beams(r: Random) -> nf.DvlBeams:
    """Beam by beam, four or three, mostly with water track."""
    own: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.03)} if chance(r, 0.3) else {}
    own |= {"misalignment_sd_rad": between(r, 0.2, 3.0) * DEG} if chance(r, 0.3) else {}
    if chance(r, 0.6):
        own |= {"current_sd_m_s": between(r, 0.03, 0.5), "current_tau_s": between(r, 300.0, 20000.0)}
        own |= {"water_error": error(r, between(r, 0.005, 0.05))}
    own |= {"beam_azimuth_rad": (0.0, 120.0 * DEG, 240.0 * DEG)} if chance(r, 0.2) else {}
    rate_hz, named = float(r.choice([0.5, 1.0, 2.0, 5.0, 8.0])), error(r, between(r, 0.003, 0.05))
    return nf.DvlBeams(rate_hz=rate_hz, error=named, lever_arm_b_m=arm(r), **own, **unknown(r, 0.2))


def _log(r: Random) -> nf.WaterVelocity:
    """Through the water."""
    own: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.03)} if chance(r, 0.4) else {}
    own |= {"misalignment_sd_rad": between(r, 0.2, 3.0) * DEG} if chance(r, 0.3) else {}
    rate_hz, named = float(r.choice([0.5, 1.0, 2.0, 5.0, 8.0])), error(r, between(r, 0.003, 0.05))
    flows = current(r) | unknown(r, 0.2)
    return nf.WaterVelocity(rate_hz=rate_hz, error=named, lever_arm_b_m=arm(r), **own, **flows)


VELOCITIES = {"dvl": _dvl, "beams": _beams, "water": _log, "wheels": wheels}


def velocities(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """Two that read a velocity beside a unit."""
    motion, way, duration_s = under_way(r)
    names = r.choice(list(VELOCITIES), 2, replace=chance(r, 0.15)).tolist()
    names[1] = f"{names[1]}2" if names[1] == names[0] else names[1]
    pair = {name: VELOCITIES[name.rstrip("2")](r) for name in names}
    return nf.Vehicle(unit(r), north(r) | pair | place(r)), motion, way, duration_s


def _receiver(r: Random) -> nf.Course:
    """Speed and course of a satellite receiver, or its velocity, with clock and arm as states."""
    named = error(r, between(r, 0.01, 0.3))
    at: dict[str, Any] = {"rate_hz": float(r.choice([0.5, 1.0, 5.0])), "velocity": chance(r, 0.4)}
    return nf.Course(error=named, lever_arm_b_m=arm(r), **at, **unknown(r, 0.5))


def _ahrs(r: Random) -> nf.Attitude:
    """With its own drifts, about all three axes."""
    tilt, yaw = between(r, 0.02, 1.0) * DEG, between(r, 0.05, 3.0) * DEG
    own = {"misalignment_sd_rad": between(r, 0.1, 3.0) * DEG} if chance(r, 0.4) else {}
    own |= {"time_offset_sd_s": between(r, 0.02, 0.4)} if chance(r, 0.25) else {}
    mounting = tuple(r.uniform(-0.5, 0.5, 3).tolist()) if chance(r, 0.3) else (0.0, 0.0, 0.0)
    rate_hz = float(r.choice([0.5, 1.0, 4.0, 8.0, 16.0]))
    axes = (error(r, tilt), error(r, tilt), error(r, yaw))
    return nf.Attitude(rate_hz=rate_hz, error=axes, mounting_rad=mounting, **own)


def _compass(r: Random) -> nf.Heading:
    """A heading, or the field, with or without constants and clock."""
    own: dict[str, Any] = {"time_offset_sd_s": between(r, 0.02, 0.4)} if chance(r, 0.2) else {}
    rate_hz = float(r.choice([0.5, 1.0, 4.0, 8.0, 16.0]))
    if chance(r, 0.3):
        own |= {"hard_iron_sd": between(r, 0.2, 3.0), "soft_iron_sd": between(r, 0.002, 0.03)} if chance(r, 0.4) else {}
        return nf.Heading(rate_hz=rate_hz, magnetometer=True, error=error(r, between(r, 0.1, 1.5) * DEG), **own)
    own |= {"bias_sd_rad": between(r, 0.3, 4.0) * DEG} if chance(r, 0.4) else {}
    if chance(r, 0.4):
        own["deviation_sd_rad"] = (between(r, 0.3, 5.0) * DEG, between(r, 0.2, 2.0) * DEG)
    own |= {"magnetic": True} if chance(r, 0.3) else {}
    return nf.Heading(rate_hz=rate_hz, error=error(r, between(r, 0.05, 2.5) * DEG), **own)


def norths(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """Two that know north, or an AHRS alone, mostly beside a receiver that tells its velocity, and a unit."""
    motion, way, duration_s = under_way(r)
    sensors: dict[str, nf.Sensor] = {}
    kind = r.random()
    if kind < 0.75:
        sensors["compass"] = _compass(r)
    if kind < 0.35:
        sensors["compass2"] = _compass(r)
    if kind > 0.35:
        sensors["ahrs"] = _ahrs(r)
    if chance(r, 0.6):
        sensors["course"] = _receiver(r)
    if chance(r, 0.5):
        sensors |= velocity(r)
    others = {name: sensor for name, sensor in place(r).items() if name != "course" or "course" not in sensors}
    return nf.Vehicle(unit(r), sensors | others), motion, way, duration_s


class Ship(nf.Usbl):
    """One that is heard from a ship that turns round and round."""

    def aboard(self, t: Array) -> Array:
        """Roll, pitch and heading [rad] at times from the first on [s]."""
        return np.column_stack([0.1 * np.sin(0.6 * t), 0.05 * np.sin(0.5 * t), 0.07 * t + 0.5 * np.sin(0.15 * t)])


def _ship(r: Random) -> nf.Usbl:
    """Heard from her, with a heading that errs slowly."""
    as_others = usbl(r)
    across, below = (error(r, between(r, low, 0.06)) for low in (0.005, 0.002))
    angles = (as_others.models[0], across, below)
    given = {one.name: getattr(as_others, one.name) for one in fields(as_others)}
    return Ship(**{**given, "error": angles})


def _strangers(r: Random, way: Motion) -> nf.Range:
    """Ranges to beacons whose places are known to tens of metres."""
    return replace(ranges(r, way), beacon_sd_m=(between(r, 3.0, 60.0),) * 2 + (between(r, 0.3, 10.0),))


def sound(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """Placed from a ship that turns, or by beacons to be found, mostly through water that moves."""
    motion, way, duration_s = under_way(r)
    sensors = north(r) | ({"water": _log(r)} if chance(r, 0.6) else velocity(r))
    if chance(r, 0.7):
        sensors["depth"] = nf.Depth(error=error(r, between(r, 0.02, 0.3)), lever_arm_b_m=arm(r))
    if chance(r, 0.6):
        sensors["usbl"] = _ship(r)
    if chance(r, 0.5) or "usbl" not in sensors:
        sensors["ranges"] = _strangers(r, way)
    sensors["gps"] = nf.Position(rate_hz=1.0, error=error(r, between(r, 0.02, 5.0)), lever_arm_b_m=arm(r))
    return nf.Vehicle(unit(r), sensors), motion, way, duration_s


def reckoned_sound(r: Random) -> tuple[nf.Vehicle, str, Motion, float]:
    """Velocity and heading drive, sound places."""
    motion, way, duration_s = under_way(r)
    rate_hz = float(r.choice([0.5, 1.0, 2.0, 4.0, 8.0]))
    tilt = error(r, between(r, 0.05, 1.0) * DEG)
    drive = nf.DeadReckoning(rate_hz=rate_hz, attitude=heading(r, rate_hz), velocity=driving(r, rate_hz), tilt=tilt)
    sensors = beside(r, way, drive)
    kind = r.random()
    if kind < 0.65:
        sensors["ranges"] = _strangers(r, way) if chance(r, 0.4) else ranges(r, way)
    if kind > 0.45:
        sensors["usbl"] = _ship(r) if chance(r, 0.5) else usbl(r)
    return nf.Vehicle(drive, sensors), motion, way, duration_s


def lost(vehicle: nf.Vehicle, mission: nf.Mission, r: Random) -> nf.Mission:
    """The mission of a vehicle of which, mostly, one beam after the other or one of its velocities is lost for good."""
    streams, names = dict(mission.streams), [name for name in vehicle.sensors if name.rstrip("2") in VELOCITIES]
    end_s = float(mission.truth.time_s[-1]) if mission.truth else 0.0
    for name in names:
        stream, values = streams[name], streams[name].value.copy()
        if isinstance(vehicle.sensors[name], nf.DvlBeams) and chance(r, 0.6):
            for beam in r.permutation(4)[: int(r.integers(1, 4))].tolist():
                values[stream.time_s > r.uniform(0.2, 1.0) * end_s, beam::4] = math.nan
            streams[name] = nf.Stream(stream.time_s, values, stream.columns)
    if len(names) > 1 and chance(r, 0.4):
        name, kept = str(r.choice(names)), float(r.uniform(0.2, 0.8)) * end_s
        stream = streams[name]
        streams[name] = nf.Stream(
            stream.time_s[stream.time_s < kept], stream.value[stream.time_s < kept], stream.columns
        )
    return replace(mission, streams=streams)

"""Beacons of unknown place: found by trying directions, the filter itself saying which of them fits."""

import dataclasses
import math

import numpy as np

from navfilter.foundation.arrays import Ints
from navfilter.kernels import strapdown
from navfilter.models.mission import Mission
from navfilter.models.sensors.ranges import Range
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track

#: Directions that are tried around the vehicle.
DIRECTIONS = 24
#: First ranges whose median says how far away a beacon is.
FIRST = 5
#: Ranges without which a beacon is not looked for.
LEAST = 10
#: A NIS counts as no more than this when directions are compared: one outlier decides nothing.
MOST_NIS = 25.0
#: Rounds of the last smoothing, each around the places of the one before.
ROUNDS = 2
#: Together the beacons are as uncertain as so many times what they are each alone: the ranges count again, and what is
#: linearised far from the truth would turn the whole picture (ranges know no north).
WIDER = 4.0


def locate_beacons(vehicle: Vehicle, mission: Mission, name: str) -> Range:
    """Find the beacons of a range sensor from a mission, without knowing anything of their latitude and longitude.

    Parameters
    ----------
    vehicle : Vehicle
        With a `Range` of this name. Of its beacons only the heights (and ids) are taken; the vertical element of its
        `beacon_sd_m` stays.
    mission : Mission
        The vehicle must turn while it hears a beacon, and know its own way over that time better than the beacon: by
        dead reckoning, fixes, or both.
    name : str
        Of the sensor.

    Returns
    -------
    Range
        The sensor with the places found, and with the largest of their standard deviations in `beacon_sd_m` (smoothed).

    Raises
    ------
    ValueError
        For a sensor that is no `Range`, or a beacon that was heard less than ten times.

    Notes
    -----
    From the first ranges a beacon lies on a circle around the vehicle. The mission is replayed with the beacon at each
    of 24 places on it, as far uncertain as they are apart, and the likelihood of the ranges tells which of them is
    true. All beacons together are then smoothed twice, each time linearised around the places found before. On
    the same mission these places are no independent knowledge: to go on with it, give them a `beacon_sd_m` well above
    the one returned.
    """
    sensor = vehicle.sensors.get(name)
    if not hasattr(sensor, "beacons"):
        raise ValueError(f'"{name}" is no range sensor of this vehicle (sensors: {", ".join(vehicle.sensors)}).')
    ranges: Range = sensor  # type: ignore[assignment]
    heard = [_heard(mission, name, ranges, k) for k in range(len(ranges.beacons))]
    alone = replay(vehicle.without(name), mission)
    found = tuple(_one(vehicle, mission, name, k, alone, rows) for k, rows in enumerate(heard))
    spread = WIDER * max(sd for *_, sd in found)
    ranges = dataclasses.replace(
        ranges, beacons=tuple(place for place, _ in found), beacon_sd_m=(spread, spread, ranges.beacon_sd_m[2])
    )
    for _ in range(ROUNDS):
        ranges, sd = _moved(_with(vehicle, name, ranges), mission, name)
    return dataclasses.replace(ranges, beacon_sd_m=sd)


def _heard(mission: Mission, name: str, ranges: Range, number: int) -> Ints:
    """Rows of the stream that are ranges to this beacon."""
    readings = [ranges.read(row) for row in mission.stream(name).value]
    rows = np.flatnonzero([reading is not None and int(reading[1]) == number for reading in readings])
    if len(rows) < LEAST:
        raise ValueError(
            f'beacon {ranges.ids[number]} of "{name}" was heard {len(rows)} times in this mission; at least {LEAST} '
            "ranges are needed to find it. Leave it out, or give its place."
        )
    return rows


def _one(
    vehicle: Vehicle, mission: Mission, name: str, number: int, alone: Track, rows: Ints
) -> tuple[tuple[float, float, float], float]:
    """Place of one beacon, and the larger of its horizontal sd."""
    ranges: Range = vehicle.sensors[name]  # type: ignore[assignment]
    key, height_m = ranges.ids[number], ranges.beacons[number][2]
    stream, first = mission.stream(name), rows[:FIRST]
    at = int(np.argmin(np.abs(alone.time_s - stream.time_s[first[len(first) // 2]])))
    latitude, longitude, height = (float(part[at]) for part in (alone.latitude, alone.longitude, alone.height))
    distance = float(np.median(stream.value[first, 0]))
    level = math.sqrt(max(distance**2 - (height - height_m) ** 2, (0.05 * distance) ** 2))
    meridian, across = strapdown.radii(latitude)
    spread = math.pi / DIRECTIONS * level
    best: tuple[float, tuple[float, float, float]] = (-math.inf, (0.0, 0.0, 0.0))
    for angle in 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        north, east = level * math.cos(angle), level * math.sin(angle)
        place = (
            math.degrees(latitude + north / (meridian + height)),
            math.degrees(longitude + east / ((across + height) * math.cos(latitude))),
            height_m,
        )
        sd = (spread, spread, ranges.beacon_sd_m[2])
        only = dataclasses.replace(ranges, beacons=(place,), beacon_ids=(key,), beacon_sd_m=sd)
        best = max(best, (_likelihood(replay(_with(vehicle, name, only), mission, output_rate_hz=1.0), name), place))
    only = dataclasses.replace(only, beacons=(best[1],))
    moved, found = _moved(_with(vehicle, name, only), mission, name)
    return moved.beacons[0], max(found[:2])


def _with(vehicle: Vehicle, name: str, ranges: Range) -> Vehicle:
    """With these ranges, of which a plane leaves out little: they are gone through again around what they have told."""
    each = dataclasses.replace(ranges)
    object.__setattr__(each, "sight_s_per_m", 0.0)
    return dataclasses.replace(vehicle, sensors={**vehicle.sensors, name: each})


def _likelihood(track: Track, name: str) -> float:
    """Of the ranges of a run, up to a constant."""
    residuals = track.residuals[name]
    valid = np.isfinite(residuals.nis) & (residuals.dof > 0)
    nis = np.minimum(residuals.nis[valid], MOST_NIS)
    return float(-0.5 * np.sum(nis + 2.0 * np.log(residuals.sd[valid, 0])))


def _moved(vehicle: Vehicle, mission: Mission, name: str) -> tuple[Range, tuple[float, float, float]]:
    """The sensor with its beacons where the smoothed run has them, and the largest of their sd."""
    track, ranges = replay(vehicle, mission, smooth=True, output_rate_hz=1.0), vehicle.sensors[name]
    places, sds = [], np.zeros(3)
    for key, (latitude_deg, longitude_deg, height_m) in zip(ranges.ids, ranges.beacons, strict=True):  # type: ignore[attr-defined]
        states = [track.state(f"{name}.beacon_{key}_{axis}") for axis in ("north", "east", "down")]
        north, east, down = (float(value[-1]) for value, _ in states)
        sds = np.maximum(sds, [sd[-1] for _, sd in states])
        meridian, across = strapdown.radii(math.radians(latitude_deg))
        level = (across + height_m) * math.cos(math.radians(latitude_deg))
        latitude_deg += math.degrees(north / (meridian + height_m))
        places.append((latitude_deg, longitude_deg + math.degrees(east / level), height_m - down))
    moved = dataclasses.replace(ranges, beacons=tuple(places))  # type: ignore[call-arg]
    return moved, (float(sds[0]), float(sds[1]), float(sds[2]))  # type: ignore[return-value]

"""Initial alignment: a start from a mission's own first readings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.constants import STANDARD_GRAVITY
from navfilter.lane_missions import of_one_unit
from navfilter.mechanisation import Mechanisation
from navfilter.mission import Mission, Stream
from navfilter.start import Start
from navfilter.state import matrix_from_euler, wrap
from navfilter.vehicle import Vehicle

__all__ = ["align"]

Array = NDArray[np.float64]
#: Of a vehicle that does not say how fast it can be [m/s].
FASTEST_M_S = 100.0
#: Two fixes of one place are no farther apart than so many of their sd [1].
CONFIRMING_SD = 10.0
#: A height by a depth gauge, or by an antenna above water, is good to so much [m]: offset, waves, trim.
ABOUT_M = 1.0
#: Of the Earth, as far as it matters here [m].
EARTH_RADIUS = 6.37e6


def align(vehicle: Vehicle, mission: Mission, window_s: float = 5.0) -> Start:
    """Start a run from the first readings: level by the accelerometers, heading by the compass, velocity by the DVL,
    place by fixes.

    The place is that of the first fix that agrees with half of those in the window behind it: a receiver may begin with
    a place of its own.

    Levelling works while the vehicle moves steadily (the specific force is gravity); the standard deviations grow with
    what the inertial unit felt during the window. Without a compass the heading comes from the course between fixes, if
    the vehicle travelled far enough.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
        With a position stream for some `Position` sensor of the vehicle.
    window_s : float
        Readings of so many seconds are averaged.

    Returns
    -------
    Start

    Raises
    ------
    ValueError
        When there is no position, no source of heading, or the vehicle moves too hard to be levelled.
    """
    if vehicle.lanes():
        return _by_the_first_unit(vehicle, mission, window_s)
    place, place_sd, first_s = _first_fix(vehicle, mission, window_s)
    drive = mission.streams.get(vehicle.drive.streams[0])
    if drive is None or not len(drive):
        raise ValueError(f'the drive needs a stream "{vehicle.drive.streams[0]}" in this mission.')
    begin = max(first_s, drive.time_s[0])
    # attitude that is given needs no mean, and a heading may come once in minutes: the next one is taken
    end = begin + window_s if vehicle.drive.inertial else np.inf
    rows = (drive.time_s >= begin) & (drive.time_s <= end) & np.isfinite(drive.value).all(axis=1)
    if not rows.any():
        raise ValueError(
            f"no valid reading of the drive within {end - begin:g} s after {begin:.3f} s: nothing to align with."
        )
    if not vehicle.drive.inertial:
        roll, pitch, heading = drive.value[rows][0, :3]
        lat, lon = np.degrees(place[:2])
        heading += vehicle.drive.declination(
            Start(latitude_deg=float(lat), longitude_deg=float(lon), date=mission.date)
        )
        tilt_sd, heading_sd = np.radians(1.0), np.radians(5.0)
    else:
        roll, pitch, tilt_sd = _level(drive.value[rows, 3:6], vehicle.drive)
        heading, heading_sd = _heading(vehicle, mission, begin, window_s, roll, pitch)
    velocity, velocity_sd = _velocity(vehicle, mission, begin, window_s, np.array([roll, pitch, heading]))
    return Start(
        time_s=float(begin),
        latitude_deg=float(np.degrees(place[0])),
        longitude_deg=float(np.degrees(place[1])),
        height_m=float(place[2]),
        velocity_n=tuple(velocity.tolist()),
        roll_deg=float(np.degrees(roll)),
        pitch_deg=float(np.degrees(pitch)),
        heading_deg=float(np.degrees(heading)),
        position_sd_m=tuple(place_sd.tolist()),
        velocity_sd_m_s=velocity_sd,
        tilt_sd_deg=float(np.degrees(tilt_sd)),
        heading_sd_deg=float(np.degrees(heading_sd)),
        date=mission.date,
    )


def _by_the_first_unit(vehicle: Vehicle, mission: Mission, window_s: float) -> Start:
    """By the first of several inertial units that allows it."""
    reasons = []
    for name in vehicle.units:
        try:
            return align(*of_one_unit(vehicle, mission, name), window_s)
        except ValueError as error:
            reasons.append(f"{name}: {error}")
    raise ValueError(" ".join(dict.fromkeys(reasons)))


def _stream(vehicle: Vehicle, mission: Mission, what: str) -> tuple[Stream, Any] | None:
    """The first stream with readings that gives this by itself, and its sensor."""
    for name, sensor in vehicle.sensors.items():
        if sensor.gives == what and len(mission.streams.get(name, ())):
            return mission.streams[name], sensor
    return None


def _first_fix(vehicle: Vehicle, mission: Mission, window_s: float) -> tuple[Array, Array, float]:
    found = _stream(vehicle, mission, "position")
    if found is None:
        raise ValueError(
            "no start: the mission gives none ([start] in mission.toml), and the vehicle has no "
            "position sensor with readings to align with. "
            "Give replay(..., start=Start(latitude_deg=..., longitude_deg=..., heading_deg=...))."
        )
    stream, sensor = found
    read = [sensor.read(value) for value in stream.value]
    times = np.array([t for t, z in zip(stream.time_s, read, strict=True) if z is not None])
    fixes = np.array([z for z in read if z is not None])
    blocks = [m.block(1.0 / sensor.rate_hz) for m in sensor.models]
    sd = np.sqrt([b.r + b.C @ b.P0 @ b.C for b in blocks])
    speed = vehicle.drive.max_speed_m_s or FASTEST_M_S
    for k, t in enumerate(times.tolist()):
        others = (times > t) & (times <= t + window_s)
        others = others if others.any() else (times < t) & (times >= t - window_s)
        near_m = speed * np.abs(times[others] - t) + CONFIRMING_SD * float(sd[:2].max())
        if not _confirmed(fixes[k], fixes[others], near_m):
            continue
        z = fixes[k]
        z, sd = z.copy(), sd.copy()
        if getattr(sensor, "antenna_height_m", None) is not None:
            # what this height errs by, each fix says again: it is not to be counted twice
            z[2], sd[2] = z[2] + sensor.lever_arm_b_m[2], max(sd[2], ABOUT_M)
        elif not np.isfinite(z[2]):
            z[2], sd[2] = _height(vehicle, mission)
        return z, np.maximum(sd, 1e-3), t
    raise ValueError(f"no start: {_nowhere(stream, len(fixes), window_s)}")


def _confirmed(fix: Array, others: Array, within_m: Array) -> bool:
    """Whether half of the others at least can be of the same vehicle; one alone is believed.

    The others are those of the window behind it: what arrives later a run that is fed live has not heard yet.
    """
    north = (others[:, 0] - fix[0]) * EARTH_RADIUS
    east = wrap(others[:, 1] - fix[1]) * EARTH_RADIUS * np.cos(fix[0])
    return bool(2 * np.count_nonzero(np.hypot(north, east) <= within_m) >= len(others))


def _nowhere(stream: Stream, valid: int, window_s: float) -> str:
    """Why no fix can be begun with."""
    nothing = int((stream.value[:, :2] == 0.0).all(axis=1).sum())
    if valid:
        return (
            f"none of the {valid} fixes agrees with those of the {window_s:g} s behind it. "
            "Wait for fixes that agree, or give a start."
        )
    if nothing:
        return (
            f"{nothing} of {len(stream)} position readings say latitude 0, longitude 0, as a receiver does that has no "
            "fix yet, and none is valid. Wait for a fix, or give a start."
        )
    return "none of the position readings is valid (latitude and longitude in radians? HDOP below the gate?)."


def _height(vehicle: Vehicle, mission: Mission) -> tuple[float, float]:
    found = _stream(vehicle, mission, "depth")
    if found is None:
        return 0.0, 50.0
    stream, sensor = found
    z = sensor.read(stream.value[0])
    return (0.0, 50.0) if z is None else (float(sensor.surface_height_m - z[0]), ABOUT_M)


def _level(force: Array, drive: Mechanisation) -> tuple[float, float, float]:
    """Roll, pitch [rad] and their standard deviation from the mean specific force (Groves, 2013, eq 5.101)."""
    if getattr(drive, "increments", False):
        force = force / drive.period_s
    mean = force.mean(axis=0)
    excess = abs(float(np.linalg.norm(mean)) - STANDARD_GRAVITY)
    if excess > 1.5:
        raise ValueError(
            f"cannot level: the mean specific force is {np.linalg.norm(mean):.2f} m/s^2 instead of "
            f"9.8. Units in g? Sign? Or the vehicle moves too hard: "
            "give a start."
        )
    if mean[2] > 0:
        raise ValueError(
            f"cannot level: the specific force points down (z = {mean[2]:.2f} m/s^2; at rest it must be -9.8 in "
            "forward-right-down axes). "
            "Change the sign or the axis order in mission.toml."
        )
    roll = float(np.arctan2(-mean[1], -mean[2]))
    pitch = float(np.arctan2(mean[0], np.hypot(mean[1], mean[2])))
    # Slow manoeuvres lean the mean by their mean acceleration: a third of the scatter, not less than 0.05 m/s^2 of
    # accelerometer bias.
    lean = max(0.05, excess, float(force[:, :2].std(axis=0).max()) / 3.0)
    return roll, pitch, lean / STANDARD_GRAVITY


def _heading(
    vehicle: Vehicle, mission: Mission, begin: float, window_s: float, roll: float, pitch: float
) -> tuple[float, float]:
    found = _stream(vehicle, mission, "heading")
    if found is None:
        return _course(vehicle, mission, begin)
    stream, sensor = found
    rows = (stream.time_s >= begin) & (stream.time_s <= begin + window_s)
    readings = [r for r in (sensor.read(v) for v in stream.value[rows]) if r is not None]
    if not readings:
        return _course(vehicle, mission, begin)
    place = _first_fix(vehicle, mission, window_s)[0]
    at = Start(latitude_deg=float(np.degrees(place[0])), longitude_deg=float(np.degrees(place[1])), date=mission.date)
    level = np.array(readings)
    if sensor.magnetometer:
        level = level[:, :3] @ matrix_from_euler(roll, pitch, 0.0).T
        angles = -np.arctan2(level[:, 1], level[:, 0])
    else:
        angles = level[:, 0]
    mean = float(np.angle(np.mean(np.exp(1j * angles))))
    block = sensor.models[0].block(1.0 / sensor.rate_hz)
    variance = block.r / len(readings) + block.C @ block.P0 @ block.C + sensor.doubt_of(level)
    return float(wrap(mean + sensor.declination(at))), float(np.sqrt(variance + np.radians(0.5) ** 2))


def _course(vehicle: Vehicle, mission: Mission, begin: float, within_s: float = 60.0) -> tuple[float, float]:
    """Heading from the course between the first fixes, for vehicles that move where they point."""
    found = _stream(vehicle, mission, "position")
    assert found is not None
    stream, sensor = found
    rows = (stream.time_s >= begin) & (stream.time_s <= begin + within_s)
    rows[rows] = [sensor.read(value) is not None for value in stream.value[rows]]
    lat, lon = stream.value[rows, 0], stream.value[rows, 1]
    if len(lat) > 1:
        north, east = (lat - lat[0]) * EARTH_RADIUS, wrap(lon - lon[0]) * EARTH_RADIUS * np.cos(lat[0])
        far = np.flatnonzero(np.hypot(north, east) > 10.0)
        if len(far):
            return float(np.arctan2(east[far[0]], north[far[0]])), float(np.radians(15.0))
    raise ValueError(
        "no heading to start with: the vehicle has no compass with readings, and the first fixes do not move 10 m. "
        "Give a start."
    )


def _velocity(vehicle: Vehicle, mission: Mission, begin: float, window_s: float, rpy: Array) -> tuple[Array, float]:
    found = _stream(vehicle, mission, "velocity")
    if found is None and vehicle.drive.velocity_sensor is not None:
        found = mission.streams["velocity"], vehicle.drive.velocity_sensor
    if found is None:
        return np.zeros(3), 2.0
    stream, sensor = found
    near = np.flatnonzero((stream.time_s >= begin - 1.0) & (stream.time_s <= begin + window_s))
    for row in near:
        z = sensor.read(stream.value[row, :3])
        if z is not None and np.isfinite(z).all():
            v_b = matrix_from_euler(*sensor.mounting_rad) @ z
            return matrix_from_euler(*rpy) @ v_b, 0.5
    return np.zeros(3), 2.0

"""Initial alignment: a start from a mission's own first readings."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.models.lane_missions import of_one_unit
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.mission import Mission, Stream
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler, wrap
from navfilter.models.vehicle import Vehicle

#: Of a vehicle that does not say how fast it can be [m/s].
FASTEST_M_S = 100.0
#: Two fixes of one place are no farther apart than so many of their sd [1].
CONFIRMING_SD = 10.0
#: A height by a depth gauge, or by an antenna above water, is good to so much [m]: offset, waves, trim.
ABOUT_M = 1.0
#: Of the Earth, as far as it matters here [m].
EARTH_RADIUS = 6.37e6
#: The readings that tell the start are used again once the run has begun, and their slow errors are in those that
#: follow: the start counts as known so many times worse than they tell it [1], so that nothing is counted twice.
AGAIN = 10.0
#: A heading is not made worse than this for it [rad]: the cosine is then off by 1.5 %, which fixes of centimetres see.
LINEAR = np.radians(10.0)
#: What it is good to at best: turns during the window, tilt [rad].
ABOUT_RAD = np.radians(0.5)
#: A tilt counts as known so many times worse than the bias of accelerometers lets it be [1]: a tenth is counted twice.
TILT_AGAIN = 3.0
#: A way between two fixes is so long at least [m], and so many times the sd by which they err apart [1]: of a minute of
#: fixes at rest, one in 10 000 seems to go.
LEAST_WAY_M, LEAST_WAY_SD = 10.0, 5.0
#: It is made in so much time at most [s].
LONGEST_WAY_S = 60.0
#: By so much a heading differs from the course: current, wind, turns meanwhile [rad].
ABOUT_COURSE = np.radians(15.0)
#: By so much a velocity differs from its mean over a window; and so fast are most vehicles at the start [m/s].
ABOUT_MEAN, SLOW = 1.0, 2.0


def align(vehicle: Vehicle, mission: Mission, window_s: float = 5.0) -> Start:
    """Start a run from the first readings: level by the accelerometers, heading by the compass, velocity by the DVL,
    place by fixes.

    The place is that of the first fix that agrees with half of those in the window behind it: a receiver may begin with
    a place of its own. Its lever arm is taken off.

    Levelling works while the vehicle moves steadily (the specific force is gravity); the standard deviations grow with
    what the inertial unit felt during the window. Without a compass the heading comes from the course between fixes,
    and the run begins when the vehicle goes: the two have to be farther apart than what they err by. Where no sensor
    gives the velocity, the fixes of the window do.

    The readings that all this is made of are used again once the run has begun, and their slow errors are in those that
    follow. So the start is said to be known ten times worse than they tell it, its tilt three times worse than the bias
    of the accelerometers.

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
    needs("align: vehicle", vehicle, Vehicle, hint="It is align(vehicle, mission).")
    needs("align: mission", mission, Mission, hint="It is align(vehicle, mission).")
    if not (isinstance(window_s, int | float) and window_s > 0.0):
        raise ValueError(f"align: window_s must be > 0 seconds, found {window_s!r}.")
    if vehicle.lanes():
        return _by_the_first_unit(vehicle, mission, window_s)
    drive = mission.streams.get(vehicle.drive.streams[0])
    if drive is None or not len(drive):
        lacks = "has no" if drive is None else "has no reading in its"
        raise ValueError(f'this mission {lacks} stream "{vehicle.drive.streams[0]}", which the drive needs.')
    fixes = _fixes(vehicle, mission)
    first = _first_fix(fixes, vehicle, window_s)
    begin = max(fixes.time_s[first], drive.time_s[0])
    # a drive that is no inertial unit brings its own heading
    read, last = _headings(vehicle, mission, begin, window_s) if vehicle.drive.inertial else None, -1
    if vehicle.drive.inertial and read is None:
        first, last = _later(fixes, vehicle, mission, first, window_s)
        begin = max(fixes.time_s[first], drive.time_s[0])
        read = None if last >= 0 else _headings(vehicle, mission, begin, window_s)
    # attitude that is given needs no mean, and a heading may come once in minutes: the next one is taken
    end = begin + window_s if vehicle.drive.inertial else np.inf
    rows = (drive.time_s >= begin) & (drive.time_s <= end) & np.isfinite(drive.value).all(axis=1)
    if not rows.any():
        raise ValueError(
            f"no valid reading of the drive within {end - begin:g} s after {begin:.3f} s: nothing to align with."
        )
    lat, lon = np.degrees(fixes.value[first, :2]).tolist()
    here = Start(latitude_deg=lat, longitude_deg=lon, date=mission.date)
    if not vehicle.drive.inertial:
        roll, pitch, heading = drive.value[rows][0, :3]
        heading += vehicle.drive.declination(here)
        tilt_sd, heading_sd = np.radians(1.0), np.radians(5.0)
    else:
        roll, pitch, tilt_sd = _level(drive.value[rows, 3:6], vehicle.drive)
        if read is None:
            heading, heading_sd = _course(fixes, first, last)
        else:
            sensor, readings = read
            headings, variance, slope = sensor.headings(readings, matrix_from_euler(roll, pitch, 0.0), here)
            heading = float(np.angle(np.mean(np.exp(1j * headings))))
            heading_sd = math.hypot(_again(math.sqrt(variance)), slope * tilt_sd)
    velocity, velocity_sd = _velocity(vehicle, mission, fixes, begin, window_s, np.array([roll, pitch, heading]))
    place, place_sd = _place(vehicle, mission, fixes, first, begin, matrix_from_euler(roll, pitch, heading), heading_sd)
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


@dataclass(frozen=True)
class _Fixes:
    """Valid fixes of the first position sensor that has readings: latitude, longitude, height [rad, rad, m]."""

    sensor: Any
    stream: Stream
    time_s: Array
    value: Array

    @cached_property
    def sd(self) -> Array:
        """Of one fix, north, east, down [m]."""
        return np.sqrt([self.sensor.mean_variance(axis, 1) for axis in range(3)])

    @cached_property
    def _apart(self) -> tuple[float, Array]:
        """By how much two fixes differ where nothing moves, the larger of north and east [m], by multiples of a step in
        time [s], which comes first: a second, or a tick where these are longer.
        """
        ticks = max(1, round(self.sensor.rate_hz))
        step_s = ticks / self.sensor.rate_hz
        sd = np.zeros(2 + int(LONGEST_WAY_S / step_s))
        for model in self.sensor.models[:2]:
            b = model.block(1.0 / self.sensor.rate_hz)
            Phi, Q = np.eye(len(b.C)), np.zeros_like(b.Q)
            for _ in range(ticks):
                Phi, Q = b.Phi @ Phi, b.Phi @ Q @ b.Phi.T + b.Q
            left, grown = np.eye(len(b.C)), np.zeros_like(Q)
            for k in range(len(sd)):
                gone = left - np.eye(len(b.C))
                sd[k] = max(sd[k], math.sqrt(2.0 * b.r + b.C @ (gone @ b.P0 @ gone.T + grown) @ b.C))
                left, grown = Phi @ left, Phi @ grown @ Phi.T + Q
        return step_s, sd

    def apart_sd(self, first: Any, last: int) -> Array:
        """By how much two fixes, or several and one, differ where nothing moves [m]."""
        step_s, sd = self._apart
        steps = np.ceil((self.time_s[last] - self.time_s[first]) / step_s - 1e-6).astype(int)
        return np.asarray(sd[np.minimum(steps, len(sd) - 1)])

    def way(self, first: int) -> Array:
        """North and east of one fix [m], shape (n, 2)."""
        here = self.value[first]
        east = wrap(self.value[:, 1] - here[1]) * EARTH_RADIUS * math.cos(here[0])
        return np.column_stack([(self.value[:, 0] - here[0]) * EARTH_RADIUS, east])

    def near_m(self, seconds: Array, vehicle: Vehicle) -> Array:
        """Two fixes so long apart are no farther apart than this [m]."""
        fastest = vehicle.drive.max_speed_m_s or FASTEST_M_S
        return fastest * np.abs(seconds) + CONFIRMING_SD * float(self.sd[:2].max())


def _fixes(vehicle: Vehicle, mission: Mission) -> _Fixes:
    found = _stream(vehicle, mission, "position")
    if found is None:
        raise ValueError(
            "no start: the mission gives none ([start] in mission.toml), and the vehicle has no "
            "position sensor with readings to align with. "
            "Give replay(..., start=Start(latitude_deg=..., longitude_deg=..., heading_deg=...))."
        )
    stream, sensor = found
    read = [(t, sensor.read(value)) for t, value in zip(stream.time_s.tolist(), stream.value, strict=True)]
    valid = [(t, z) for t, z in read if z is not None]
    return _Fixes(sensor, stream, np.array([t for t, _ in valid]), np.array([z for _, z in valid]).reshape(-1, 3))


def _first_fix(fixes: _Fixes, vehicle: Vehicle, window_s: float) -> int:
    """The first that can be believed."""
    times = fixes.time_s
    for k, t in enumerate(times.tolist()):
        others = (times > t) & (times <= t + window_s)
        others = others if others.any() else (times < t) & (times >= t - window_s)
        if _confirmed(fixes.way(k)[others], fixes.near_m(times[others] - t, vehicle)):
            return k
    raise ValueError(f"no start: {_nowhere(fixes, window_s)}")


def _place(
    vehicle: Vehicle, mission: Mission, fixes: _Fixes, first: int, begin: float, C: Array, heading_sd: float
) -> tuple[Array, Array]:
    """Place of the vehicle at a fix, and its sd north, east, down [m]."""
    place, sd, up = fixes.value[first].copy(), fixes.sd.copy(), getattr(fixes.sensor, "antenna_height_m", None)
    arm = C @ np.asarray(fixes.sensor.lever_arm_b_m, dtype=float)
    place[:2] -= arm[:2] / (EARTH_RADIUS * np.array([1.0, math.cos(place[0])]))
    if np.any(fixes.time_s >= begin):
        sd *= AGAIN
    sd[:2] = np.hypot(sd[:2], heading_sd * math.hypot(arm[0], arm[1]))
    if not np.isfinite(place[2]):
        place[2], sd[2] = _height(vehicle, mission)
    else:
        place[2] += arm[2]
        if up is not None:
            sd[2] = max(sd[2], ABOUT_M)
    return place, np.maximum(sd, 1e-3)


def _confirmed(others: Array, within_m: Array) -> bool:
    """Whether half of the others at least, north and east of a fix, can be of the same vehicle; one alone is believed.

    The others are those of the window behind it: what arrives later a run that is fed live has not heard yet.
    """
    return bool(2 * np.count_nonzero(np.hypot(*others.T) <= within_m) >= len(others))


def _nowhere(fixes: _Fixes, window_s: float) -> str:
    """Why no fix can be begun with."""
    stream, valid = fixes.stream, len(fixes.time_s)
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
            f"cannot level: the mean specific force is {np.linalg.norm(mean):.2f} m/s^2 instead of 9.8. Units in g? "
            "Sign? Or the vehicle moves too hard: give a start."
        )
    if mean[2] > 0:
        raise ValueError(
            f"cannot level: the specific force points down (z = {mean[2]:.2f} m/s^2; at rest it must be -9.8 in "
            "forward-right-down axes). Change the sign or the axis order in mission.toml."
        )
    roll = float(np.arctan2(-mean[1], -mean[2]))
    pitch = float(np.arctan2(mean[0], np.hypot(mean[1], mean[2])))
    # Slow manoeuvres lean the mean by their mean acceleration: a third of the scatter, not less than 0.05 m/s^2.
    lean = max(0.05, excess, float(force[:, :2].std(axis=0).max()) / 3.0)
    blocks = [model.block(drive.period_s) for model in drive.models[3:5]]
    bias = max(math.sqrt(b.state_variance) for b in blocks)
    return roll, pitch, math.hypot(lean, TILT_AGAIN * bias) / STANDARD_GRAVITY


def _whole(
    vehicle: Vehicle, mission: Mission, begin: float, end: float = math.inf
) -> Iterator[tuple[Any, Iterator[tuple[float, Array]]]]:
    """Sensors that give a heading, or an attitude, and their valid readings of this time."""
    for found in (_stream(vehicle, mission, "heading"), _stream(vehicle, mission, "attitude")):
        if found is not None:
            stream, sensor = found
            rows = np.flatnonzero((stream.time_s >= begin) & (stream.time_s <= end))
            read = ((float(stream.time_s[row]), sensor.read(stream.value[row])) for row in rows)
            yield sensor, ((t, z) for t, z in read if z is not None and np.isfinite(z[: sensor.reads]).all())


def _headings(vehicle: Vehicle, mission: Mission, begin: float, window_s: float) -> tuple[Any, Array] | None:
    """Valid readings of a heading in the window, and their sensor."""
    for sensor, whole in _whole(vehicle, mission, begin, begin + window_s):
        readings = [reading for _, reading in whole]
        if readings:
            _check_radians(sensor, np.array(readings))
            return sensor, np.array(readings)
    return None


def _check_radians(sensor: Any, readings: Array) -> None:
    """Refuse a heading or an attitude to start with that is more than two turns: it would be any."""
    if sensor.unit == "rad" and sensor.words != "magnetometer":
        largest = float(np.abs(readings[:, : sensor.reads]).max())
        if largest > 4.0 * math.pi:
            raise ValueError(
                f"the {sensor.words} begins with {largest:g} rad: is it in degrees? np.radians turns them into what "
                "streams hold."
            )


def _again(sd: float) -> float:
    """The sd of a heading that its readings tell to this one [rad]."""
    sd = math.hypot(sd, ABOUT_RAD)
    return max(sd, min(AGAIN * sd, LINEAR))


def _later(fixes: _Fixes, vehicle: Vehicle, mission: Mission, first: int, window_s: float) -> tuple[int, int]:
    """The fix to begin with where the first has no heading: one of those from it on in whose window there is one, and
    -1; or, where the vehicle has gone before that is over, the two between which it has.
    """
    times = fixes.time_s
    heading_s = min(
        (t for _, whole in _whole(vehicle, mission, times[first]) for t, _ in islice(whole, 1)), default=math.inf
    )
    with_heading = int(np.searchsorted(times, heading_s - window_s))
    known_s = times[with_heading] + window_s if with_heading < len(times) else math.inf
    gone = _way(fixes, vehicle, first, known_s)
    if gone is not None:
        return gone
    if with_heading < len(times):
        return max(with_heading, first), -1
    raise ValueError(
        f"no heading to start with: the vehicle has no compass with readings, and within {LONGEST_WAY_S:g} s its fixes "
        f"do not move {LEAST_WAY_M:g} m and {LEAST_WAY_SD:g} times what they err apart. Give a start."
    )


def _way(fixes: _Fixes, vehicle: Vehicle, first: int, until_s: float) -> tuple[int, int] | None:
    """The first two fixes, of those from `first` on, between which the vehicle has gone; neither leaps from its
    neighbour between them.
    """
    times, way = fixes.time_s, fixes.way(first)
    calm = np.hypot(*np.diff(way, axis=0).T) <= fixes.near_m(np.diff(times), vehicle)
    for last in range(first + 1, int(np.searchsorted(times, until_s))):
        of = np.arange(max(first, int(np.searchsorted(times, times[last] - LONGEST_WAY_S))), last)
        of = of[calm[of]] if calm[last - 1] else of[:0]
        least = np.maximum(LEAST_WAY_M, LEAST_WAY_SD * fixes.apart_sd(of, last))
        gone = np.hypot(*(way[of] - way[last]).T) > least
        if gone.any():
            return int(of[gone][0]), last
    return None


def _course(fixes: _Fixes, first: int, last: int) -> tuple[float, float]:
    """Heading by the course between two fixes, for vehicles that move where they point."""
    north, east = fixes.way(first)[last].tolist()
    off = float(fixes.apart_sd(first, last)) / math.hypot(north, east)
    return math.atan2(east, north), math.hypot(ABOUT_COURSE, off)


def _velocity(
    vehicle: Vehicle, mission: Mission, fixes: _Fixes, begin: float, window_s: float, rpy: Array
) -> tuple[Array, float]:
    found = _stream(vehicle, mission, "velocity")
    if found is None and vehicle.drive.velocity_sensor is not None:
        found = mission.streams["velocity"], vehicle.drive.velocity_sensor
    if found is None:
        return _mean_velocity(fixes, begin, window_s)
    stream, sensor = found
    near = np.flatnonzero((stream.time_s >= begin - 1.0) & (stream.time_s <= begin + window_s))
    for row in near:
        z = sensor.read(stream.value[row, :3])
        if z is not None and np.isfinite(z).all():
            v_b = matrix_from_euler(*sensor.mounting_rad) @ z
            return matrix_from_euler(*rpy) @ v_b, 0.5
    return _mean_velocity(fixes, begin, window_s)


def _mean_velocity(fixes: _Fixes, begin: float, window_s: float) -> tuple[Array, float]:
    """By the fixes of the window; where there is one alone, that of a vehicle at rest or slow."""
    within = np.flatnonzero((fixes.time_s >= begin) & (fixes.time_s <= begin + window_s))
    seconds = float(fixes.time_s[within[-1]] - fixes.time_s[within[0]]) if len(within) else 0.0
    if seconds < min(1.0, window_s):
        return np.zeros(3), SLOW
    velocity = fixes.way(int(within[0]))[within[-1]] / seconds
    sd = math.hypot(float(fixes.apart_sd(int(within[0]), int(within[-1]))) / seconds, ABOUT_MEAN)
    return np.append(velocity, 0.0), sd

"""Dead reckoning without a filter, and positions in metres: what the recordings are compared with.

Velocity turned by the heading (of the attitude sensor, or summed up from the gyro) and summed up itself.
"""

from __future__ import annotations

import numpy as np
from harness import Array
from numpy.typing import NDArray

from navfilter.io.geodesy import matrix_from_euler
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle

EARTH_RADIUS_M = 6.371e6


def plane(stream: Stream) -> tuple[Array, NDArray[np.complex128]]:
    """Times and positions, north + i east [m] from the first one, of a stream or of the truth."""
    known = np.isfinite(stream.column("latitude_rad")) & np.isfinite(stream.column("longitude_rad"))
    latitude, longitude = stream.column("latitude_rad")[known], stream.column("longitude_rad")[known]
    north = latitude - latitude[0]
    return stream.time_s[known], EARTH_RADIUS_M * (north + 1j * np.cos(latitude[0]) * (longitude - longitude[0]))


def velocity_of(mission: Mission, vehicle: Vehicle) -> tuple[Stream, Array, complex]:
    """The stream of velocities, the same in body axes with the last valid one held, and its lever arm."""
    name = next(name for name, stream in mission.streams.items() if stream.columns[0] == "v_x_m_s")
    stream = mission.streams[name]
    sensor = vehicle.sensors.get(name) or getattr(vehicle.drive, "velocity_sensor")  # noqa: B009
    v = stream.value @ matrix_from_euler(*(np.array([a]) for a in sensor.mounting_rad))[0].T
    valid = np.flatnonzero(np.isfinite(v).all(axis=1))
    held = valid[np.maximum(np.searchsorted(valid, np.arange(len(v)), side="right") - 1, 0)]
    return stream, v[held], complex(*sensor.lever_arm_b_m[:2])


def plain_path(mission: Mission, vehicle: Vehicle) -> tuple[Array, NDArray[np.complex128]]:
    """Dead-reckoned path of the reference point (north + i east, from zero); by gyro its first heading is zero."""
    stream, v, lever = velocity_of(mission, vehicle)
    t = stream.time_s
    if "attitude" in mission.streams:
        attitude = mission.streams["attitude"]
        good = np.isfinite(attitude.value).all(axis=1)
        angles = np.unwrap(attitude.value[good], axis=0)
        roll, pitch, yaw = (np.interp(t, attitude.time_s[good], angles[:, k]) for k in range(3))
        v = np.einsum("nij,nj->ni", matrix_from_euler(roll, pitch, 0.0 * yaw), v)
    else:
        imu = mission.streams["imu"]
        speed = np.interp(imu.time_s, t, np.hypot(v[:, 0], v[:, 1]))
        still = speed < 0.02
        rate = imu.value[:, 2] - (imu.value[still, 2].mean() if np.mean(still) > 0.05 else 0.0)
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.time_s))])
        yaw = np.interp(t, imu.time_s, turned)
    moving = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * yaw)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (moving[1:] + moving[:-1]) * np.diff(t))])
    return t, path - lever * (np.exp(1j * yaw) - np.exp(1j * yaw[0]))


def plain_end_error(mission: Mission, vehicle: Vehicle, truth: Stream, until_s: float) -> float:
    """End error [m] of plain dead reckoning that knows the truth until a time.

    By attitude it starts from the last known position; by gyro its start and first heading are fitted to all that is
    known.
    """
    t, path = plain_path(mission, vehicle)
    times, place = plane(truth)
    inside = (times >= t[0]) & (times <= t[-1])
    times, place = times[inside], place[inside]
    own = np.interp(times, t, path.real) + 1j * np.interp(times, t, path.imag)
    known = times <= until_s
    if "attitude" in mission.streams:
        last = np.flatnonzero(known)[-1]
        return float(abs((own[-1] - own[last]) - (place[-1] - place[last])))
    own, place = own - own[0], place - place[0]
    turn = np.vdot(own[known], place[known])
    return float(abs(own[-1] * turn / abs(turn) - place[-1]))

"""Ramps: a velocity sensor that the drive leaves behind.

A tilt, or a bias that has jumped, shows in no sample. It shows as a ramp: residuals of a velocity over ground that grow
from nothing, along a line. A velocity sensor that fails does so at once. But one that is late, or in another unit, is
left behind on a ramp, too, whenever the vehicle changes its speed. It was so from the beginning: so only a sensor that
has been used for long, on a way, and was not refused for long before, may accuse the drive. One that was refused, or
has been thought to have jumped, may do so by a longer ramp, on which it goes on reading the same: no delay, no unit and
no scale makes it differ from the state by more and more without reading anything else. And where the state has become
faster than such a vehicle can be, while a sensor that was right says that it is not, it is the drive that ran away.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings
from navfilter.faults.alternative_path import believable, most_speed
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import imu_checks as kernel

__all__ = ["accused", "add_to_line", "ramp_of"]

Array = NDArray[np.float64]


def accused(filter: FilterState, channel: Channel, time_s: float) -> float | None:
    """Slope of the ramp by which a refused velocity accuses the drive [m/s^2]; None where it does not.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Whose reading has just been refused; its memory takes note.
    time_s : float
        Of the reading [s].
    """
    kept, since_s = channel.faults, channel.faults.rejected_since_s
    nav = filter.memory.nav
    residual = ground_velocity.residual(channel, nav, channel.note[3 : 3 + channel.axes]) if channel.ground else None
    if filter.inertial and filter.monitor.glr.fails_again(channel, filter.memory):
        return 0.0
    if residual is None or not filter.inertial:
        slope = None
    elif time_s == since_s or float(np.linalg.norm(filter.memory.monitor.imu[:3, kernel.MEAN])) > settings.TURNING:
        kept.ramp, slope = (), None
    elif believable(residual, math.hypot(*nav[3:6].tolist()), filter.vehicle.drive.max_speed_m_s):
        kept.ramp = add_to_line(kept.ramp, time_s - since_s, residual, read(filter, channel))
        slope = ramp_of(kept.ramp, ground_velocity.residual_variances(channel, nav)) if kept.ramp else None
        # a velocity through water may change with the water, slowly, too
        slope = slope if float(np.linalg.norm(residual)) > channel.sensor.flows_m_s else None
    else:
        slope = None
    if slope is not None and not (
        may_accuse(filter, channel) or reads_the_same(kept.ramp, read(filter, channel), slope)
    ):
        slope = None
    if slope is None and ran_away(filter, channel, time_s):
        return 0.0
    if slope is None and time_s - since_s >= settings.REFUSED_S and not may_accuse(filter, channel):
        kept.disputed_s = time_s
    return slope


def may_accuse(filter: FilterState, channel: Channel) -> bool:
    """Whether a sensor that is refused has confirmed the state well enough before to speak against the drive."""
    return _was_right(filter, channel) and channel.faults.undisputed


def _was_right(filter: FilterState, channel: Channel) -> bool:
    """Whether a velocity that is refused was used for long before, on a way."""
    if not filter.inertial or not channel.ground:
        return False
    kept, way = channel.faults, filter.start.way_to(*filter.memory.nav[:2].tolist())
    return channel.memory.used_s - kept.agreed_s >= settings.USED_S and math.hypot(*way) >= settings.WAY_M


def ran_away(filter: FilterState, channel: Channel, time_s: float) -> bool:
    """Whether the state has become faster than the vehicle can be, while a velocity that was right is refused."""
    kept, stated = channel.faults, filter.vehicle.drive.max_speed_m_s
    if not time_s - kept.rejected_since_s >= settings.RUNAWAY_S or not _was_right(filter, channel):
        return False
    fixes = (c.memory.used_s for c in filter.channels.values() if c.sensor.observes.corrects == "position")
    if max(fixes, default=-math.inf) > kept.rejected_since_s:
        return False
    claimed = math.hypot(*read(filter, channel).tolist())
    most = float(most_speed(max(claimed, kept.refused_speed), stated))
    return claimed <= most < math.hypot(*filter.memory.nav[3:6].tolist())


def read(filter: FilterState, channel: Channel) -> Array:
    """The velocity that a refused reading says, in b, shape (3,) [m/s]."""
    nav, values = filter.memory.nav, channel.note[3 : 3 + channel.axes]
    if channel.ground == ground_velocity.AXES:
        off = np.linalg.pinv(channel.near[:, 3:6]) @ np.nan_to_num(values)
        return np.asarray(nav[6:15].reshape(3, 3).T @ (nav[3:6] + off))
    off_b = np.nan_to_num(ground_velocity.residual(channel, nav, values))
    return np.asarray(nav[6:15].reshape(3, 3).T @ nav[3:6] + off_b)


def add_to_line(ramp: tuple[float, ...], age_s: float, residual: Array, reading: Array) -> tuple[float, ...]:
    """The sums of a straight line through residuals with another one: the first age, their number, sums of ages and
    squared ages, and axis by axis of residuals, of their products with the ages, and of their squares; last the first
    reading as a velocity. Empty before the first whole one.
    """
    if not np.isfinite(residual).all():
        return ramp
    new = np.concatenate([[0.0, 1.0, age_s, age_s**2], residual, age_s * residual, residual**2])
    sums = (np.array(ramp[:-3]) + new).tolist() if ramp else [age_s, *new[1:].tolist()]
    return (*sums, *(ramp[-3:] or reading.tolist()))


def reads_the_same(ramp: tuple[float, ...], reading: Array, slope: float) -> bool:
    """Whether a sensor has gone on reading the same on a long ramp.

    Parameters
    ----------
    ramp : tuple of float
    reading : ndarray, shape (3,)
        The last one as a velocity [m/s].
    slope : float
        Of the ramp [m/s^2].
    """
    lasted_s = 2.0 * (ramp[2] / ramp[1] - ramp[0])  # of evenly spaced readings
    changed = float(np.linalg.norm(reading - np.array(ramp[-3:])))
    return (
        lasted_s >= settings.LONG_S
        and slope * lasted_s >= settings.ACCELERATION_GROWN
        and changed < settings.ACCELERATION_SAME * slope * lasted_s
    )


def ramp_of(ramp: tuple[float, ...], white: Array) -> float | None:
    """Slope of a ramp that began at nothing [m/s^2], from the sums of `add_to_line`; None where there is none.

    Parameters
    ----------
    ramp : tuple of float
    white : ndarray, shape (axes,)
        Variance of a residual by the sensor's noise alone.

    Examples
    --------
    >>> ramp = ()
    >>> for k in range(9):
    ...     ramp = add_to_line(ramp, 0.25 * k, np.array([0.05 * k, 0.001 * (-1) ** k]), np.array([1.5, 0.0, 0.0]))
    >>> round(ramp_of(ramp, np.full(2, 1e-4)), 2)
    0.2
    """
    first_s, n, t, tt = ramp[:4]
    r, rt, rr = np.array(ramp[4:-3]).reshape(3, -1)
    spread = tt - t * t / n
    last_s = 2.0 * t / n - first_s  # of evenly spaced readings
    if n < settings.READINGS or last_s - first_s < settings.RAMP_S:
        return None
    slope = (rt - t * r / n) / spread
    left = np.maximum(rr - r * r / n - slope * (rt - t * r / n), 0.0) / (n - 2.0)
    sds = math.sqrt(float(np.sum(slope**2 * spread / np.maximum(left, white))))
    began = r / n - slope * t / n
    grown = float(np.linalg.norm(began)) < settings.BEGAN * float(np.linalg.norm(began + slope * last_s))
    return float(np.linalg.norm(slope)) if sds > settings.SLOPE_SDS and grown else None

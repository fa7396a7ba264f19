"""The way that refused readings of a velocity make beside the state's.

While a velocity over ground is refused, either it or the state is wrong; which of them, often shows late. If it was the
state, the position has left the truth by what the residuals come to, integrated over that time: that is the dead
reckoning of the refused sensor, kept beside the filter's own. It belongs into the protection radius until a fix tells
(solution separation: Blanch et al., 2015; Groves, 2013, ch. 17), and where the state is given up for the velocity, the
position follows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings
from navfilter.filter.actions import Action, Inflate, MovePosition
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AlternativePath:
    """What the refused readings of a velocity come to.

    Attributes
    ----------
    time_s : float
        Of the last one [s].
    north, east : float
        How much further the vehicle is than the state, if they were right [m].
    length : float
        The residuals' sizes, integrated since the last fix: whatever has been decided since [m].
    """

    time_s: float = -math.inf
    north: float = 0.0
    east: float = 0.0
    length: float = 0.0


def most_speed(speed: Array | float, stated: float | None) -> Array | float:
    """What a vehicle can do at most [m/s], as stated, or as far as its present speed says."""
    return stated or np.maximum(settings.MOST_SPEED, np.multiply(settings.FASTER, speed))


def out_of_reach(filter: FilterState, channel: Channel, time_s: float) -> bool:
    """Whether a refused fix is of a place to which no such vehicle has come since its start, although fixes have been
    used: another coordinate system, a sign, another unit. However long it lasts, it is not let in.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        As its refused reading left it.
    time_s : float
        Of the reading [s].
    """
    if channel.memory.used_s == -math.inf:
        return False
    north, east = filter.start.way_to(*filter.memory.nav[:2].tolist())
    off = [0.0 if math.isnan(residual) else residual for residual in channel.res[:2].tolist()]
    most = float(most_speed(channel.faults.refused_speed, filter.vehicle.drive.max_speed_m_s))
    return math.hypot(north + off[0], east + off[1]) > settings.REACH_M + most * (time_s - filter.start.time_s)


def believable(residual: Array, speed: Array | float, stated: float | None) -> NDArray[np.bool_]:
    """Whether refused readings can be of a vehicle.

    Parameters
    ----------
    residual : ndarray, shape (..., axes)
        NaN where unknown [m/s].
    speed : float or ndarray, shape (...)
        Of the state [m/s].
    stated : float or None
        The vehicle's greatest [m/s].

    Examples
    --------
    >>> believable(np.array([[0.4, 0.0, 0.0], [1500.0, 0.0, 0.0]]), 1.5, None)
    array([ True, False])
    """
    size = np.hypot.reduce(np.nan_to_num(residual), axis=-1)  # does not overflow
    return np.asarray(size <= most_speed(speed, stated) + speed)


def since_fix(filter: FilterState, channel: Channel) -> AlternativePath:
    """That of a velocity, now: nothing, once a fix has been used since."""
    way = channel.faults.way
    fixes = (c.memory.used_s for c in filter.channels.values() if c.sensor.observes.corrects == "position")
    return AlternativePath() if way is None or max(fixes, default=-math.inf) > way.time_s else way


def full_residual(filter: FilterState, channel: Channel) -> Array:
    """Of the last reading, shape (axes,), as if its sensor had not been found to have jumped [m/s]."""
    return np.asarray(channel.note[3 : 3 + channel.axes] + channel.jumped_by(filter.memory.x))


def with_rejected(filter: FilterState, channel: Channel, time_s: float) -> AlternativePath:
    """That of a velocity with another refused reading.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        As its refused reading left it.
    time_s : float
        Of the reading [s].
    """
    way, speed = since_fix(filter, channel), math.hypot(*filter.memory.nav[3:6].tolist())
    residual = ground_velocity.components(channel, full_residual(filter, channel))
    # one that is refused alone is an outlier
    dt = min(time_s - max(way.time_s, channel.faults.rejected_since_s), settings.SPEAKS_S)
    if dt > 0.0 and believable(residual, speed, filter.vehicle.drive.max_speed_m_s):
        seen = np.isfinite(residual)
        A = ground_velocity.as_velocity(channel, seen)
        further = A @ residual[seen] * dt
        size = 0.0
        if channel.faults.aside is None:
            # once it has been found to be off, nobody need reckon with its being right, but as far as it still differs
            left = (
                ground_velocity.components(channel, channel.note[3 : 3 + channel.axes]) if channel.offset else residual
            )
            size = float(np.linalg.norm(left[seen] if len(left) == ground_velocity.AXES else A @ left[seen]))
        return AlternativePath(
            time_s, way.north + float(further[0]), way.east + float(further[1]), way.length + dt * size
        )
    return replace(way, time_s=time_s)


def followed(filter: FilterState, channel: Channel) -> Iterator[Action]:
    """The state was wrong: let the position follow a velocity that has been refused.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Of that velocity; its memory takes note.
    """
    yield MovePosition(*moved(filter, channel))
    yield Inflate(slice(2), slice(2), follows(filter, channel))


def moved(filter: FilterState, channel: Channel) -> tuple[float, float]:
    """How much further north and east a velocity that has been refused would have led the vehicle [m]."""
    way = since_fix(filter, channel)
    return way.north, way.east


def follows(filter: FilterState, channel: Channel) -> Array:
    """Variance of the position once it has followed that velocity, shape (2, 2) [m^2]; the memory takes note."""
    way = since_fix(filter, channel)
    turned = np.array([-way.east, way.north]) * math.sqrt(min(filter.memory.P[8, 8], 1.0))
    if channel.faults.way is not None:
        channel.faults.way = replace(way, north=0.0, east=0.0)
    return settings.PATH_SHARE**2 * (way.north**2 + way.east**2) * np.eye(2) + np.outer(turned, turned)

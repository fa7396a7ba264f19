"""A velocity sensor that has jumped by about the whole velocity.

A jump that is small beside the speed is a constant or a scale, and both are estimated (`navfilter.models.fault_bias`).
One of the size of the speed (another sign, another unit, axes that are turned) would make a scale of nothing, or a
constant of twice the speed: at one speed nothing tells the two apart, and as soon as that changes the wrong one leads
the state off. But whatever has become of the sensor, while it reads the same, the velocity is the same. So it gets a
constant, and what it reads otherwise than right after its jump is not used: the inertial unit knows better. It is back
when that agrees with the state as if it had not jumped, while the vehicle moves: at rest, another sign or unit agrees,
too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VelocityFault:
    """A velocity that has jumped by about itself.

    Attributes
    ----------
    speed : float
        Of the vehicle then [m/s].
    read, jump : tuple of float
        What it read then, NaN where that says nothing of the velocity, and by how much it was off [m/s].
    """

    speed: float
    read: tuple[float, ...]
    jump: tuple[float, ...]

    @property
    def density(self) -> float:
        """Of the random walk of its constants [m/s/sqrt(s)]."""
        return settings.VELOCITY_SLOPE * settings.VELOCITY_SAME * _size(self.read) / math.sqrt(settings.WANDERS_S)


def jumped(filter: FilterState, channel: Channel, jump: Array) -> VelocityFault | None:
    """What is to be remembered of a velocity that has just jumped by about itself, where an inertial unit can do
    without it; None where it is not so.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
    jump : ndarray, shape (axes,)
        By how much it is off [m/s].
    """
    speed, by = math.hypot(*filter.memory.nav[3:6].tolist()), np.nan_to_num(jump)
    carried = filter.inertial and not filter.memory.monitor.has_excluded
    if not channel.ground or not carried or _size(by) <= settings.VELOCITY_SHARE * speed:
        return None
    says = _size(channel.reading) > settings.SAYS * _size(by)
    read = channel.reading if says else np.full(channel.axes, math.nan)
    return VelocityFault(speed, tuple(read.tolist()), tuple(by.tolist()))


def unchanged(kept: VelocityFault, z: Array) -> bool:
    """Whether a reading is what it was right after the jump."""
    off = np.abs(z - np.array(kept.read))
    return bool(np.isfinite(off).any() and np.nanmax(off) <= settings.VELOCITY_SAME * _size(kept.read))


def widened_variances(kept: VelocityFault, z: Array, plain: Array) -> Array:
    """White variances of a reading, and beside them what its change may hide."""
    return np.asarray(plain + (settings.VELOCITY_SLOPE * np.nan_to_num(z - np.array(kept.read))) ** 2)


def shows_itself(kept: VelocityFault, speed: float, off: Array) -> bool:
    """Whether a reading that is `off` the state by so much (axes,) proves that its sensor is back."""
    return speed > settings.VELOCITY_SHARE * kept.speed and _size(off) < _size(off - np.array(kept.jump))


def _size(vector: Array | tuple[float, ...]) -> float:
    return float(np.linalg.norm(np.nan_to_num(vector)))

"""What a sensor says of the velocity over ground, whatever its components are: three axes, or the beams of a DVL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.sensor_channel import Channel

Array = NDArray[np.float64]
#: Components of a velocity, and beams that tell it at the least.
AXES = 3


def components(channel: Channel, values: Array) -> Array:
    """Those of values by axis (axes,) that are of the velocity over ground; all of a sensor that has none."""
    return values[: channel.ground or len(values)]


def as_velocity(channel: Channel, seen: NDArray[np.bool_]) -> Array:
    """The matrix (3, k) that makes a velocity in n of the components over ground that are seen."""
    return np.asarray(np.linalg.pinv(components(channel, channel.near)[seen, 3:6]))

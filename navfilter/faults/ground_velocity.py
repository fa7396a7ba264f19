"""What a sensor says of the velocity over ground, whatever its components are: three axes, or the beams of a DVL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.sensor_channel import Channel

__all__ = ["AXES", "as_velocity", "components", "residual", "residual_variances"]

Array = NDArray[np.float64]
#: Components of a velocity, and beams that tell it at the least.
AXES = 3


def components(channel: Channel, values: Array) -> Array:
    """Those of values by axis (axes,) that are of the velocity over ground; all of a sensor that has none."""
    return values[: channel.ground or len(values)]


def as_velocity(channel: Channel, seen: NDArray[np.bool_]) -> Array:
    """The matrix (3, k) that makes a velocity in n of the components over ground that are seen."""
    return np.asarray(np.linalg.pinv(components(channel, channel.near)[seen, 3:6]))


def residual(channel: Channel, nav: Array, values: Array) -> Array:
    """Residuals over ground as a velocity: of three axes as they are, of beams in b; shape (3,) [m/s].

    Parameters
    ----------
    channel : Channel
        Of a sensor with a velocity over ground (`Sensor.ground`).
    nav : ndarray, shape (17,)
        Nominal state.
    values : ndarray, shape (axes,)
        NaN where missing; of beams three are wanted.
    """
    known = components(channel, values)
    if channel.ground == AXES:
        return known
    seen = np.isfinite(known)
    if seen.sum() < AXES:
        return np.full(AXES, np.nan)
    return np.asarray(nav[6:15].reshape(3, 3).T @ (as_velocity(channel, seen) @ known[seen]))


def residual_variances(channel: Channel, nav: Array) -> Array:
    """White variance of `residual`, shape (3,) [m^2/s^2]."""
    white = components(channel, np.diag(channel.R))
    if channel.ground == AXES:
        return white
    seen = np.isfinite(components(channel, channel.note[3 : 3 + channel.axes]))
    A = nav[6:15].reshape(3, 3).T @ as_velocity(channel, seen)
    return np.asarray(A**2 @ white[seen])

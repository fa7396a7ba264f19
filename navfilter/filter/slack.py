"""By how much two readings of a sensor may differ although nothing is wrong: its coloured error, and dead reckoning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.offsets import offset_states
from navfilter.kernels import listen

if TYPE_CHECKING:
    from navfilter.filter.channel import Channel
    from navfilter.sensors import Sensor

__all__ = ["reckoned", "wander"]

Array = NDArray[np.float64]
GRAVITY = 9.81  # of a tilt, as an acceleration [m/s^2]; to a percent


def wander(channel: Channel, dt: float, with_offset: bool = True) -> Array:
    """Variance by which the sensor's coloured error may have changed in a time, per axis."""
    e = channel.group.errors
    C, P0, off = channel.C, channel.group.P0[:e, :e], channel.group.Phi[:e, :e] - np.eye(e)
    if not with_offset:
        C = C.copy()
        C[:, offset_states(channel.sensor.models, channel.period_s)] = 0.0
    tick = C @ (off @ P0 @ off.T + channel.group.Q[:e, :e]) @ C.T
    ticks = min(dt / channel.period_s, 1e9)
    return np.asarray(np.minimum(np.diag(tick) * ticks, 2.0 * np.diag(C @ P0 @ C.T)))


def reckoned(sensor: Sensor, P: Array, speed: float, dt: float, drive_output: Array, period_s: float) -> float:
    """Variance by which dead reckoning may err in a time, in the units of a sensor."""
    C, white = drive_output[:, :-1], drive_output[:, -1]
    m = 9 + C.shape[1]
    bias = np.einsum("ij,jk,ik->i", C, P[9:m, 9:m], C)
    if sensor.north is not None:
        return float(bias[:3].max() * dt**2 + white[:3].max() * period_s * dt)
    if sensor.open_loop == listen.VELOCITY:
        tilt = GRAVITY**2 * max(P[6, 6], P[7, 7])
        return float((bias[3:].max() + tilt) * dt**2 + white[3:].max() * period_s * dt)
    return float((np.diag(P)[3:6].max() + speed**2 * P[8, 8]) * dt**2)

"""By how much two readings of a sensor may differ although nothing is wrong: its coloured error, and dead reckoning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.sensor_channel import Channel
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.observable import Observable

__all__ = ["reckoned", "wander"]

Array = NDArray[np.float64]
GRAVITY = 9.81  # of a tilt, as an acceleration [m/s^2]; to a percent


def wander(channel: Channel, dt: float, with_offset: bool = True) -> Array:
    """Variance by which the sensor's coloured error may have changed in a time, per axis."""
    e = channel.group.errors
    C, P0, off = channel.C, channel.group.P0[:e, :e], channel.group.Phi[:e, :e] - np.eye(e)
    if not with_offset:
        C = C.copy()
        C[:, channel.offsets] = 0.0
    tick = C @ (off @ P0 @ off.T + channel.group.Q[:e, :e]) @ C.T
    ticks = min(dt / channel.period_s, 1e9)
    return np.asarray(np.minimum(np.diag(tick) * ticks, 2.0 * np.diag(C @ P0 @ C.T)))


def reckoned(sensor: Sensor, P: Array, speed: float, dt: float, drive_output: Array, period_s: float) -> float:
    """Variance by which dead reckoning may err in a time, in the units of a sensor; `kernels.noise_scale` has it,
    too."""
    if sensor.observes.north is not None:
        return float(_lasting(P, drive_output)[:3].max() * dt**2 + drive_output[:3, -1].max() * period_s * dt)
    if sensor.observes is Observable.VELOCITY_BODY:
        tilt = GRAVITY**2 * max(P[6, 6], P[7, 7])
        return float((_lasting(P, drive_output)[3:].max() + tilt) * dt**2) + _walked(dt, drive_output, period_s)
    return float((np.diag(P)[3:6].max() + speed**2 * P[8, 8]) * dt**2)


def _walked(dt: float, drive_output: Array, period_s: float) -> float:
    """Variance by which the noise of accelerometers does [m^2/s^2]."""
    return float(drive_output[3:, -1].max() * period_s * dt)


def _lasting(P: Array, drive_output: Array) -> Array:
    """Variances of the errors of a drive's axes that last."""
    C = drive_output[:, :-1]
    m = 9 + C.shape[1]
    return np.asarray(np.einsum("ij,jk,ik->i", C, P[9:m, 9:m], C))

"""What follows when readings are rejected for long: the gate widens, or, when all sensors contradict the state, it is given up."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.layout import Group
from navfilter.learning.listener import Channel

__all__ = ["at_fault", "open_wide", "widen"]

Array = NDArray[np.float64]

#: What may be wrong with a state that all sensors contradict: velocity [m/s], roll, pitch and heading [rad].
OPEN_SPEED, OPEN_ATTITUDE = 2.0, np.array([0.1, 0.1, 1.0])


def at_fault(channels: Collection[Channel], channel: Channel, time_s: float, frozen: bool) -> bool:
    """Whether the state is wrong: two sensors or more have been rejected for half their time-outs, and none was used since.

    Parameters
    ----------
    channels : collection of Channel
        Of the run.
    channel : Channel
        Whose reading has been rejected at `time_s`; it notes since when.
    time_s : float
    frozen : bool
        Such a reading says nothing about the state.
    """
    if math.isnan(channel.rejected_since_s):
        channel.rejected_since_s = time_s
    if frozen:
        return False
    against = 0
    for other in channels:
        heard = time_s - other.last_s < max(5.0, 3.0 * other.period_s)
        if heard and time_s - other.rejected_since_s > 0.5 * other.sensor.gate_timeout_s:
            against += 1
        elif heard and math.isnan(other.rejected_since_s) and other.sensor.confirms_state:
            return False
    return against > 1


def open_wide(P: Array, channels: Collection[Channel], drive: Group) -> None:
    """Give up what is known of attitude, velocity, position and the drive's errors, so that the sensors can say it again.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; changed.
    channels : collection of Channel
        Of the run.
    drive : Group
        States of the drive's errors.
    """
    largest = np.zeros(9)
    for channel in channels:
        if not math.isnan(channel.rejected_since_s):
            seen = np.abs(channel.near[:, :3]).max(axis=0) > 0.5
            residual = np.nanmax(np.abs(channel.note[3 : 3 + channel.sensor.axes]), initial=0.0)
            largest[:3] = np.maximum(largest[:3], np.where(seen, residual, 0.0))
            channel.rejected_since_s = math.nan
    spread = np.concatenate([largest[:3] + 10.0, np.full(3, OPEN_SPEED), OPEN_ATTITUDE])
    P[range(9), range(9)] += spread**2
    P[drive.slice, drive.slice] += drive.P0


def widen(P: Array, x: Array, channel: Channel, time_s: float, nis: float, dof: int) -> bool:
    """After a long series of rejections the gate doubles, and again; True when that lets the reading in: the caller then updates with it.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; widened where the sensor sees it.
    x : ndarray, shape (n - 9,)
        Error states.
    channel : Channel
        Its residual and its R are made ready for the update.
    time_s, nis : float
        Time and normalised innovation squared of the reading.
    dof : int
        Components used in it.
    """
    limit = channel.limits[dof]
    if math.isnan(channel.rejected_since_s):
        channel.rejected_since_s = time_s
    periods = math.floor((time_s - channel.rejected_since_s) / channel.sensor.gate_timeout_s)
    if periods < 1 or nis > limit * 2.0 ** min(periods, 500):
        return False
    # A sensor that is rejected for so long shows that the state is less certain than thought: widen P where the sensor sees it. Only there:
    # along P H' a fix that is far off would throw the velocity after the position.
    a, H = channel.sensor.axes, channel.H
    seen = channel.PH @ H.T
    grow = nis / limit * max(1.0, float(np.trace(channel.S[:a]) / max(np.trace(seen), 1e-300)))
    spread = np.diag(P)[:9, None] * H[:, :9].T
    inverse = np.linalg.pinv(H[:, :9] @ spread, hermitian=True)
    P[:9, :9] += grow * spread @ inverse @ seen @ inverse @ spread.T
    P[:] = 0.5 * (P + P.T)
    first = channel.group.start - 9
    channel.res += channel.C @ x[first : first + channel.group.errors]  # `update` takes it off again
    channel.res[~channel.H.any(axis=1)] = np.nan
    channel.R *= max(1.0, nis / limit)  # let in, but not believed more than the gate would have
    channel.rejected_since_s = math.nan
    return True

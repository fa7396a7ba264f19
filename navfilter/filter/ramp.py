"""Ramps: a velocity sensor that the drive leaves behind.

A tilt, or a bias that has jumped, shows in no sample. It shows as a ramp: residuals of a velocity over ground that grow
from nothing, along a line. A velocity sensor that fails does so at once. But one that is late, or in another unit, is
left behind on a ramp, too, whenever the vehicle changes its speed. It was so from the beginning: so only a sensor that
has been used for long, on a way, and was not refused for long before, may accuse the drive.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.kernels import drive_watch as kernel
from navfilter.state import NavState

if TYPE_CHECKING:
    from navfilter.filter.channel import Channel
    from navfilter.filter.filter import Filter

__all__ = ["accused", "ramp_of", "with_refused"]

Array = NDArray[np.float64]
#: A ramp is told by so many refused readings at the earliest, over so long a time [s], by a slope of so many standard
#: deviations (of Student's t with six degrees of freedom 2e-4 are beyond), and if it began at less than this share of
#: what it has come to [1]: what fails at once is no ramp.
READINGS, RAMP_S, SLOPE_SDS, BEGAN = 8, 1.5, 8.0, 0.5
#: A sensor that accuses the drive was used for so long before [s], and led the vehicle so far from its start [m]: one
#: that is described wrongly is refused when the vehicle first moves off.
USED_S, WAY_M = 60.0, 50.0
#: While the vehicle turns faster, nothing is accused [rad/s]: what is described wrongly shows then, and not after.
TURNING = 0.05
#: One that is refused for so long [s] without that is disputed.
DISPUTED_S = 1.0


def accused(filter: Filter, channel: Channel, time_s: float) -> float | None:
    """Slope of the ramp by which a refused velocity accuses the drive [m/s^2]; None where it does not.

    Parameters
    ----------
    filter : Filter
    channel : Channel
        Whose reading has just been refused; its memory takes note.
    time_s : float
        Of the reading [s].
    """
    kept, since_s = channel.memory, channel.memory.rejected_since_s
    if filter.inertial and filter.jumps.fails_again(channel, filter.memory):
        return 0.0
    if not may_accuse(filter, channel, time_s):
        if time_s - since_s >= DISPUTED_S:
            kept.disputed_s = time_s
        return None
    if time_s == since_s or float(np.linalg.norm(filter.memory.watch[:3, kernel.MEAN])) > TURNING:
        kept.ramp = ()
        return None
    kept.ramp = with_refused(kept.ramp, time_s - since_s, channel.note[3 : 3 + channel.axes])
    return ramp_of(kept.ramp, np.diag(channel.R)[: channel.axes]) if kept.ramp else None


def may_accuse(filter: Filter, channel: Channel, time_s: float) -> bool:
    """Whether a sensor that is refused has confirmed the state well enough before to speak against the drive."""
    # a velocity through water may change with the water, slowly, too
    if not filter.inertial or channel.sensor.gives != "velocity":
        return False
    kept, nav = channel.memory, NavState.unpack(time_s, filter.memory.nav)
    way_m = math.hypot(*nav.minus(filter.start.state)[:2].tolist())
    return kept.used_s - kept.agreed_s >= USED_S and way_m >= WAY_M and kept.undisputed


def with_refused(ramp: tuple[float, ...], age_s: float, residual: Array) -> tuple[float, ...]:
    """The sums of a straight line through residuals with another one: the first age, their number, sums of ages and
    squared ages, and axis by axis of residuals, of their products with the ages, and of their squares; empty before the
    first whole one.
    """
    if not np.isfinite(residual).all():
        return ramp
    new = np.concatenate([[0.0, 1.0, age_s, age_s**2], residual, age_s * residual, residual**2])
    return tuple((np.array(ramp) + new).tolist()) if ramp else (age_s, *new[1:].tolist())


def ramp_of(ramp: tuple[float, ...], white: Array) -> float | None:
    """Slope of a ramp that began at nothing [m/s^2], from the sums of `with_refused`; None where there is none.

    Parameters
    ----------
    ramp : tuple of float
    white : ndarray, shape (axes,)
        Variance of a residual by the sensor's noise alone.

    Examples
    --------
    >>> ramp = ()
    >>> for k in range(9):
    ...     ramp = with_refused(ramp, 0.25 * k, np.array([0.05 * k, 0.001 * (-1) ** k]))
    >>> round(ramp_of(ramp, np.full(2, 1e-4)), 2)
    0.2
    """
    first_s, n, t, tt = ramp[:4]
    r, rt, rr = np.array(ramp[4:]).reshape(3, -1)
    spread = tt - t * t / n
    last_s = 2.0 * t / n - first_s  # of evenly spaced readings
    if n < READINGS or last_s - first_s < RAMP_S:
        return None
    slope = (rt - t * r / n) / spread
    left = np.maximum(rr - r * r / n - slope * (rt - t * r / n), 0.0) / (n - 2.0)
    sds = math.sqrt(float(np.sum(slope**2 * spread / np.maximum(left, white))))
    began = r / n - slope * t / n
    grown = float(np.linalg.norm(began)) < BEGAN * float(np.linalg.norm(began + slope * last_s))
    return float(np.linalg.norm(slope)) if sds > SLOPE_SDS and grown else None

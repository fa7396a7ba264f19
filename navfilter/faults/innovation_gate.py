"""What follows when readings are rejected for long: the gate widens, or, when all sensors contradict the state, the
state is given up.

Nothing here changes anything: each function returns what the filter has to add.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.sensor_channel import Channel
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]

#: What tells a place, or a height.
PLACE = ("position", "depth")


def state_contradicted(channels: Collection[Channel], time_s: float, inertial: bool = True) -> bool:
    """Whether the state is wrong: two sensors or more have been rejected for half their time-outs, and none was used
    since. Of a velocity and fixes `MOTION_S` is enough, and only another one of these could speak for the state: a
    compass knows nothing of where the vehicle is. So it is of fixes alone, where there is no velocity and the state
    goes further and further away from them.

    Parameters
    ----------
    channels : collection of Channel
        Of the filter, with the time since which each has been rejected.
    time_s : float
        Now [s].
    inertial : bool
        Whether an inertial unit drives; any other drive brings a velocity.
    """
    against, for_it = [], []
    motion: set[str] = set()
    present: set[str] = set() if inertial else {"velocity"}
    alone = False
    for other in channels:
        memory, sensor = other.faults, other.sensor
        heard = time_s - other.memory.last_s < max(settings.RECENT_S, settings.HEARD_PERIODS * other.period_s)
        refused_s = time_s - memory.rejected_since_s
        if heard and refused_s > min(settings.MOTION_S, 0.5 * sensor.gate_timeout_s):
            motion |= (
                {sensor.observes.corrects}
                if _off(other) > settings.MOTION.get(sensor.observes.corrects, math.inf)
                else set()
            )
            alone |= _goes_away(other)
        present |= {sensor.observes.corrects} if heard else set()
        if heard and memory.aside is None and refused_s > 0.5 * sensor.gate_timeout_s:
            against.append(sensor.observes.corrects)
        elif heard and math.isnan(memory.rejected_since_s) and sensor.confirms_state:
            for_it.append(sensor.observes.corrects)
    against_motion = motion == settings.MOTION.keys() or (alone and "velocity" not in present)
    gone = against_motion and not settings.MOTION.keys() & set(for_it)
    return gone or (len(against) > 1 and not for_it) or _place_contradicted(channels, time_s)


def _place_contradicted(channels: Collection[Channel], time_s: float) -> bool:
    """Whether all that tells a place or a height, two sensors or more, has been refused for half its time-out: compass
    and velocity, which may agree, know nothing of that.
    """
    refused = []
    for channel in channels:
        memory, sensor = channel.faults, channel.sensor
        heard = time_s - channel.memory.last_s < max(settings.RECENT_S, settings.HEARD_PERIODS * channel.period_s)
        if heard and sensor.observes.corrects in PLACE:
            refused.append(time_s - memory.rejected_since_s > 0.5 * sensor.gate_timeout_s and _off(channel) > 0.0)
    return len(refused) > 1 and all(refused)


def reset_variance(channels: Collection[Channel], time_s: float) -> Array:
    """Variance to add to position, velocity and attitude, shape (9,), so that the sensors establish them again; none to
    the attitude where it is only a place that they contradict, and a compass and a velocity go on to agree. Of fixes
    that it goes away from, without a velocity, to the tilt no more than leads so far, and none to the heading where a
    compass goes on to agree.

    Parameters
    ----------
    channels : collection of Channel
        Of the filter; the residuals of those that are rejected say how wrong position and velocity may be.
    time_s : float
        Now [s].
    """
    largest, opened = np.zeros(6), np.zeros(3)
    agree = {channel.sensor.observes.corrects for channel in channels if channel.faults.agrees}
    for channel in channels:
        since_s = channel.faults.rejected_since_s
        if not math.isnan(since_s):
            seen = np.abs(channel.near[:, :6]).max(axis=0) > 0.5
            largest = np.maximum(largest, np.where(seen, _off(channel), 0.0))
            attitude = settings.OPEN_ATTITUDE
            if _goes_away(channel):
                # what grows as the square of the time
                span_s = max(time_s - since_s, channel.period_s)
                largest[3:] = np.maximum(largest[3:], 2.0 * _off(channel) / span_s)
                # a tilt that has not done more has not been larger
                tilt = 2.0 * _off(channel) / (ROUND_GRAVITY * span_s**2)
                attitude = np.minimum([tilt, tilt, 0.0 if "heading" in agree else math.inf], settings.OPEN_ATTITUDE)
            opened = np.maximum(opened, attitude)
    if {"heading", "velocity"} <= agree:
        opened[:] = 0.0
    spread = np.concatenate([largest + settings.OPEN_MOTION, opened])
    return np.asarray(spread**2)


def _goes_away(channel: Channel) -> bool:
    """Whether the state goes further and further away from fixes that are refused."""
    refused = channel.faults.refused
    if channel.dive_s == math.inf or refused is None:
        return False
    return _off(channel) > settings.GROWN * float(np.nanmax(np.abs(refused.first), initial=0.0))


def _off(channel: Channel) -> float:
    """Largest residual of the last reading; 0 where that says nothing of the state."""
    largest = float(np.nanmax(np.abs(channel.note[3 : 3 + channel.axes]), initial=0.0))
    return largest if largest <= settings.MOST_OFF.get(channel.sensor.observes.corrects, math.inf) else 0.0


class Widening(NamedTuple):
    """What a widened gate adds.

    Attributes
    ----------
    places : slice
        Of the states that it is for.
    covariance : ndarray, shape (k, k)
        For these.
    white_factor : float
        By which the reading's white noise is larger: let in, but not believed more than the gate would have.
    """

    places: slice
    covariance: Array
    white_factor: float


def widening(P: Array, channel: Channel, time_s: float, nis: float, dof: int, unseen: float) -> Widening | None:
    """After a long series of rejections the gate doubles, and again; a velocity that has not confirmed the state yet is
    not kept waiting, for start and description may as well be wrong, and a state that nothing holds runs away. What
    that adds when it lets the reading in, else None.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    channel : Channel
        As the rejected update left it.
    time_s, nis : float
        Time and normalised innovation squared of the reading.
    dof : int
        Components used in it.
    unseen : float
        Force that the inertial unit may feel wrongly, `navfilter.Imu.gap_force_sd` [m/s^2]; 0 without one.

    Notes
    -----
    A sensor that is rejected for so long shows that the state is less certain than thought: P is widened where the
    sensor sees it. Only there: along P H' a fix that is far off would throw the velocity after the position, and a
    velocity that is stamped wrongly would turn a heading that nothing else tells. One that reads the drive's own rates
    sees the errors of that: the Earth's rate is so slow that a reading out of place would make it believe in any
    attitude.
    """
    limit = channel.limits[dof]
    patience_s = channel.sensor.gate_timeout_s * (1.0 if math.isnan(channel.faults.astray_m) else settings.PATIENT)
    periods = math.floor((time_s - channel.faults.rejected_since_s) / patience_s)
    widens = periods >= 1 and (_is_led_away(channel, time_s) or nis <= limit * 2.0 ** min(periods, 500))
    if not widens and not _runs_away(channel, time_s, unseen):
        return None
    a, H = channel.axes, channel.H
    seen = channel.PH @ H.T
    grow = nis / limit * max(1.0, float(np.trace(channel.S[:a]) / max(np.trace(seen), 1e-300)))
    places = slice(3, 6) if channel.sensor.observes.corrects == "velocity" else slice(9)
    places = slice(9, int(channel.dims[2])) if channel.sensor.observes is Observable.RATE else places
    spread = np.diag(P)[places, None] * H[:, places].T
    inverse = np.linalg.pinv(H[:, places] @ spread, hermitian=True)
    return Widening(places, grow * spread @ inverse @ seen @ inverse @ spread.T, max(1.0, nis / limit))


def _runs_away(channel: Channel, time_s: float, unseen: float) -> bool:
    """Whether a velocity is refused that has not confirmed the state, and is off by no more than a state may run away
    in the time that nothing has held it.
    """
    kept, used_s = channel.faults, channel.memory.used_s
    if not channel.moves or kept.confirmed(used_s):
        return False
    # after one that was let in so nothing waits
    if kept.agreed_s != used_s and time_s - kept.rejected_since_s < settings.REFUSED_S:
        return False
    alone_s = time_s - max(used_s, kept.rejected_since_s - channel.period_s)
    largest = float(np.nanmax(np.abs(channel.note[3 : 3 + channel.axes]), initial=0.0))
    return largest <= settings.AWAY_SD * unseen * alone_s


def _is_led_away(channel: Channel, time_s: float) -> bool:
    """Whether it is a gauge that a height has left little by little, no faster than a mounting leads it away: that goes
    on as fast as a gate opens.
    """
    kept = channel.faults
    if channel.sensor.observes is not Observable.HEIGHT or (kept.refused and kept.refused.from_the_first()):
        return False
    way_m = kept.refused_speed * (time_s - kept.rejected_since_s + channel.period_s)
    return abs(float(channel.note[3])) <= settings.AWAY_SD * settings.ANGLE_SD * way_m


def whole_residual(channel: Channel, x: Array) -> Array:
    """Residual of a rejected reading as the update wants it, which takes the coloured error off again; NaN on axes that
    see no state.

    Parameters
    ----------
    channel : Channel
    x : ndarray, shape (n - 9,)
        Error states.
    """
    first = channel.group.start - 9
    residual = channel.res + channel.C @ x[first : first + channel.group.errors]
    residual[~channel.H.any(axis=1)] = np.nan
    return np.asarray(residual)

"""Whether the slow error that a filter estimates for a sensor is still one that its error model allows.

Fixes that are drawn off slowly, or that a wrong heading leaves behind, pass every gate: each of them is only a little
off from what the ones before made of the state and of their own slow error. What they do together is in the estimate
of that error: a process of 3 m that has come to 12 m is none. Such a sensor is **astray**: its slow error is begun
afresh, what it may have done to the position is added to the covariance, and its readings are refused until one agrees
with the state as it should, or is off by no more than dead reckoning may err: of a vehicle whose velocity sensor or
compass is described wrongly it is the fixes that are right. Where they have been pulled as slowly as that, it is the
velocity that is opened, and the fixes stay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings
from navfilter.faults.protection_level import IN_PLANE
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.filter.actions import Action, Inflate
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import MOST_SDS, Channel
from navfilter.kernels.fault_bank import GONE
from navfilter.models.fault_bias import currents, offset_states
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]


def reckoned_wrongly(channel: Channel, speed: float) -> float:
    """By how much a velocity may be wrong, where fixes whose slow error is no longer believed have been pulled so
    slowly that it is rather dead reckoning that errs [m/s]; 0 where it is the fixes.

    Parameters
    ----------
    channel : Channel
        Of the fixes.
    speed : float
        Of the vehicle [m/s].
    """
    seconds = float(channel.pulled[0]) * channel.period_s
    grown = (MOST_SDS - 1.0) * math.sqrt(max(channel.slow))
    return MOST_SDS / (MOST_SDS - 1.0) * grown / seconds if 0.0 < grown <= _may_err(speed, seconds) else 0.0


def reckoned_since(channel: Channel, refused: RejectionRun, speed: float) -> float:
    """By how much a velocity may have been wrong in a dive, where the fixes after it prove that the position was, by no
    more than dead reckoning may err [m/s]; else 0.

    Parameters
    ----------
    channel : Channel
    refused : RejectionRun
        The readings together.
    speed : float
        Of the vehicle [m/s].
    """
    off, seconds = math.hypot(*np.nan_to_num(refused.offset)[:2]), refused.began_s - channel.memory.used_s
    fixes = channel.sensor.observes is Observable.FIX
    return off / seconds if fixes and off <= _may_err(speed, seconds) < math.inf else 0.0


def _may_err(speed: float, seconds: float) -> float:
    return settings.BIAS_SHARE * max(speed, settings.USUAL_SPEED) * seconds


def beside(channel: Channel, x: Array) -> float:
    """How far the fixes of a channel may be right beside the state [m]: by the coloured error that they are thought to
    have, and its scatter.
    """
    return math.hypot(*channel.coloured_error(x)[:2].tolist()) + IN_PLANE * math.sqrt(max(channel.slow))


def pulled(channel: Channel, x: Array) -> Array:
    """By how much the position may have been pulled off while the slow error was estimated, shape (3,) [m].

    Each correction shares its innovation out between position and error in the ratio of their gains; that of the last
    one stands for all, up to `MOST_PULLED`: an error that takes next to nothing of it, or less, was no such share.
    """
    states = slice(channel.group.start, channel.group.start + channel.group.errors)
    own = np.einsum("ij,ij->i", channel.C, channel.PH[:, states])
    position = np.abs(np.diag(channel.PH[:, :3]))
    ratio = position / np.maximum(np.maximum(own, position / settings.MOST_PULLED), 1e-300)
    return np.asarray(np.abs(channel.coloured_error(x)) * ratio)


def has_led(filter: FilterState, channel: Channel) -> Iterator[Action]:
    """The velocity has followed a sensor that has been given constants, and errs by what that errs by. Each of these is
    to be disproved: it is fixes that speak for them.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Of that sensor; its memory takes note.
    """
    memory, models, start = filter.memory, channel.sensor.models, channel.group.start
    channel.faults.odds = GONE
    A, variance = ground_velocity.as_velocity(channel, np.ones(channel.ground, bool)), memory.P.diagonal().copy()
    led = [(state, np.eye(3)[component]) for state, component in currents(models, channel.period_s)]
    for axis in range(channel.ground):
        led += [(state, -A[:, axis]) for state in offset_states(models, channel.period_s, axis)[:1].tolist()]
    for state, by in led:
        place = start + state
        yield Inflate(slice(3, 6), slice(3, 6), variance[place] * np.outer(by, by))
        yield Inflate(slice(3, 6), place, variance[place] * by)
        yield Inflate(place, slice(3, 6), variance[place] * by)

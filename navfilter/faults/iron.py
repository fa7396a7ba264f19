"""A compass that is off by no constant and by no deviation: iron that has come near it is not what is wrong.

One that has jumped gets a constant and a deviation with the heading (`navfilter.models.fault_bias`), both open to
anything: that is what iron does. The slope of the deviation is left out of its equation, so it tells the heading by the
changes that it shows. Iron that takes half of these away, or adds as much, leaves no compass. One that is stuck near a
value, or counts in another unit, follows no turn at all: a slope of -1 fits that, and it would tell that the vehicle
does not turn, while the biases of the gyros take what it does.
"""

from __future__ import annotations

import math

import numpy as np

from navfilter.faults.sensor_bias import SPAN_S
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.models.fault_bias import with_offsets

__all__ = ["used"]

#: A deviation that changes with the heading by more than this, at so many of its standard deviations [1].
SLOPE, SURE = 0.5, 3.0


def used(filter: FilterState, channel: Channel, time_s: float) -> None:
    """After a reading of this time has been used: take the constants of a compass that does not follow the vehicle's
    turns away. Nothing that it reads is used then until it agrees without them.
    """
    kept = channel.faults
    if not channel.offset or channel.sensor.observes.north is None or time_s - kept.jumped_s < SPAN_S:
        return
    slope, sd = _slope(filter, channel)
    if abs(slope) - SURE * sd > SLOPE:
        filter.monitor.changes.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))
        # what it has read since it jumped was no heading
        kept.refused, kept.rejected_since_s, kept.disputed_s = None, kept.jumped_s, time_s


def _slope(filter: FilterState, compass: Channel) -> tuple[float, float]:
    """By how much what it is off by changes with the heading, and the standard deviation of that [1]; zeros where it
    has no deviation.
    """
    memory, (state, of_rad) = filter.memory, compass.deviations
    at = compass.group.start + state
    g = -np.sin(math.atan2(memory.nav[9], memory.nav[6]) - of_rad)
    return float(g @ memory.x[at - 9]), math.sqrt(max(float(g @ memory.P[np.ix_(at, at)] @ g), 0.0))

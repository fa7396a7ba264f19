"""Readings that show no error to be learnt."""

from __future__ import annotations

from navfilter.filter.sensor_channel import Channel
from navfilter.kernels.batch import STUCK_S

__all__ = ["doubtful_ticks"]

#: So many refused readings on end, all off by the same at once, are no outliers any more.
JUMPED = 3


def doubtful_ticks(channel: Channel, time_s: float) -> int:
    """How many ticks of a sensor, up to its reading of a time [s], show no error to be learnt: those of one that is
    stuck or has jumped. What a gate refuses for another reason is learnt from: it shows an error larger than believed.
    """
    memory, refused = channel.faults, channel.faults.refused
    if channel.stuck:
        return round(STUCK_S / channel.period_s) + 1
    if refused is not None and refused.jumped and refused.count >= JUMPED:
        return round((time_s - memory.rejected_since_s) / channel.period_s) + 1
    return int(channel.offset)

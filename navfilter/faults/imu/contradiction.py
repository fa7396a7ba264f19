"""An inertial unit that sensors contradict is left out for a while, and then used again with its biases open: a new
bias is learnt within seconds. If it is no bias, it is left out again, for longer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, Inflate
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import imu_checks as kernel
from navfilter.kernels import strapdown

Array = NDArray[np.float64]


def accuse(filter: FilterState, slope: float) -> Iterator[Action]:
    """Leave the unit out for a while because of a ramp (`navfilter.faults.velocity_evidence`): it is its tilt, or a
    bias.

    Parameters
    ----------
    filter : FilterState
    slope : float
        Of the ramp [m/s^2]; 0: it has failed again.
    """
    memory = filter.memory
    tilt = slope / strapdown.gravity(memory.nav[0], memory.nav[2])
    yield Inflate(range(6, 8), range(6, 8), tilt**2)
    if _carried(filter):
        yield from _leave_out(filter, np.repeat([tilt / settings.OUT_S, slope], 3))


def _carried(filter: FilterState) -> bool:
    """Whether compass and DVL carry the vehicle without it."""
    recent = [c for c in filter.channels.values() if filter.memory.time_s - c.memory.last_s < settings.CARRIED_HEARD_S]
    return any(c.moves and c.faults.aside is None for c in recent) and any(
        c.sensor.observes.north is not None for c in recent
    )


def fails_again(channel: Channel, memory: FilterMemory) -> bool:
    """Whether a unit that has been left out of late does not agree with what carried the vehicle without it."""
    since_s = memory.time_s - channel.faults.rejected_since_s
    late = memory.time_s - memory.monitor.imu[[0, 3], kernel.UNTIL_S].max() < settings.OUT_LONGEST_S
    carries = channel.faults.aside is None and (channel.moves or channel.sensor.observes.north is not None)
    return late and since_s > settings.REFUSED_S and carries


def _leave_out(filter: FilterState, sizes: Array) -> Iterator[Action]:
    """Gyros and accelerometers are left out for a while; the longer, the sooner they have failed again."""
    now_s = filter.memory.time_s
    for begin in (0, 3):
        axes, first = filter.memory.monitor.imu[begin : begin + 3], filter.memory.monitor.imu[begin]
        again = now_s - first[kernel.UNTIL_S] < max(first[kernel.OUT_S], settings.OUT_S)
        first[kernel.OUT_S] = min(2.0 * first[kernel.OUT_S], settings.OUT_LONGEST_S) if again else settings.OUT_S
        first[kernel.UNTIL_S] = now_s + first[kernel.OUT_S]
        left = axes[:, kernel.CODE] <= kernel.NOISY
        axes[left, kernel.CODE], axes[left, kernel.BEGAN_S] = kernel.CONTRADICTED, 0.0
        axes[:, kernel.JUMP] = np.maximum(axes[:, kernel.JUMP], settings.JUMP_OPENED * np.abs(sizes[begin : begin + 3]))
    yield from filter.monitor.imu_monitor.heed(filter)


def take_back(axes: Array, first: int, filter: FilterState) -> Iterator[Action]:
    """Three axes, rows of the watch from `first` on, are used again: their biases may be what contradicted."""
    back = (axes[:, kernel.CODE] == kernel.CONTRADICTED) & (axes[:, kernel.HELD] == 0.0)
    g, w = filter.layout.drive, filter.memory.monitor.imu
    for axis in first + np.flatnonzero(back):
        states = g.biases[axis]
        if states.size:
            place = g.start + states[0]
            yield Inflate(place, place, w[axis, kernel.JUMP] ** 2)
            w[axis, kernel.JUMP] = 0.0
    axes[back, kernel.CODE] = kernel.GOOD

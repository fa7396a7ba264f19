"""Jumps of the inertial unit's biases, told from the innovations of all sensors, and what follows for the filter.

What no sample shows by itself (an accelerometer that is off by 50 mg, a gyro with another sign) contradicts compass and
DVL. `BiasJumpGlr` holds one hypothesis for each axis of the drive and of each sensor, that its error has jumped, and
forms their likelihood ratios by the kernel `navfilter.kernels.bias_glr.update_jumps`. Where one of the drive explains
the innovations, and no sensor's does as well, the inertial unit is left out for a while, and then used again with its
biases open: a new bias is learnt within seconds. If it is no bias, it is left out again, for longer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, Inflate
from navfilter.filter.events import Correction, Event, Propagated, StateTransformed
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.kernels import imu_checks as kernel
from navfilter.kernels import strapdown
from navfilter.kernels.bias_glr import AXES, propagate_jumps, update_jumps
from navfilter.models.mechanisation import Mechanisation

Array = NDArray[np.float64]


class BiasJumpGlr:
    """Knows which row of a bank is which; all that it remembers stands in `FilterMemory.jumps` and ``watch``.

    Parameters
    ----------
    drive : Mechanisation
        An `Imu` with ``cross_check`` is watched.
    """

    def __init__(self, drive: Mechanisation) -> None:
        self.active = bool(getattr(drive, "cross_check", False))
        self._rows: dict[str, int] = {}

    def fresh(self, layout: Layout, channels: dict[str, Channel], time_s: float) -> Array:
        """What it remembers before the first reading, for these states."""
        if not self.active:
            return np.zeros((0, 0, 0))
        rows = AXES
        for name, channel in channels.items():
            self._rows[name], rows = rows, rows + channel.axes
        banks = np.zeros((settings.WINDOWS, rows + 2, layout.size + 3))
        for bank in banks:
            for name in channels:
                bank[self._rows[name], -1] = 1.0
            self._begin(bank, layout)
        return banks

    def _begin(self, bank: Array, layout: Layout) -> None:
        """A new window: the jumps happen now."""
        bank[:-1, :-1], bank[-1, -1] = 0.0, 0.0
        for axis in range(AXES):
            states = layout.drive.biases[axis]
            if states.size:
                bank[axis, layout.drive.start + states[0]] = 1.0

    def on_event(self, filter: FilterState, event: Event, value: Array | None = None) -> Iterator[Action]:
        """Take what the filter has done, and leave the inertial unit out where it is contradicted.

        Parameters
        ----------
        filter : FilterState
        event : Event
        value : ndarray, optional
            Of the reading: one that repeats the one before to the bit says nothing, for its sensor may be stuck.
        """
        memory = filter.memory
        if isinstance(event, Correction):
            if event.channel is None:
                return
            channel, banks = event.channel, memory.monitor.bias_glr
            slot = int(memory.time_s / settings.SPACING_S)
            if memory.monitor.is_busy:
                # what stands in place of an axis is no white noise: what it does to innovations is no jump
                for bank in banks:
                    self._begin(bank, filter.layout)
            elif slot != banks[0, -2, -1]:
                self._begin(banks[slot % settings.WINDOWS], filter.layout)
            banks[0, -2, -1], largest = slot, 0.0
            offset, says = self._rows[channel.name], True
            if value is not None:
                says = float(value.sum()) != banks[0, -1, offset]
                banks[0, -1, offset] = value.sum()
            for bank in banks:
                largest = max(largest, update_jumps(bank, channel.mem, channel.dims, channel.places, offset, says))
            if largest > settings.GLR_LIMIT:
                yield from self._judge(filter)
            if self.fails_again(channel, memory):
                yield from self._leave_out(filter, np.zeros(AXES))
        elif isinstance(event, Propagated):
            for bank in memory.monitor.bias_glr:
                propagate_jumps(bank, event.transition)
        elif isinstance(event, StateTransformed):
            memory.monitor.bias_glr = self.fresh(filter.layout, filter.channels, memory.time_s)

    def _judge(self, filter: FilterState) -> Iterator[Action]:
        """Leave the unit out if a jump of one of its axes explains the innovations, and no jump of a sensor does."""
        memory, n = filter.memory, filter.layout.size
        rows = memory.monitor.bias_glr[:, :-2]
        c = np.maximum(rows[:, :, n + 1], 1e-300)
        likely, sizes = rows[:, :, n] ** 2 / c, rows[:, :, n] / c
        # a few readings of a new window are explained by anything
        slot = int(memory.monitor.bias_glr[0, -2, -1])
        old = [(slot - back) % settings.WINDOWS for back in range(settings.YOUNG, settings.WINDOWS)]
        window = max(old, key=lambda k: likely[k, :AXES].max())
        axis = int(np.argmax(likely[window, :AXES]))
        best = likely[window, axis]
        if (
            best < likely[:, AXES:].max(initial=0.0) + settings.GLR_MARGIN
            or best < settings.GLR_SHARE * memory.monitor.bias_glr[window, -1, -1]
        ):
            return
        if best < settings.GLR_LIMIT or not self._carried(filter):
            return
        errors = sizes[window, :3, None] * rows[window, :3, 6:9]
        # the velocity is opened by what stands in place of forces; what the gyros may have done to the attitude:
        blamed = likely[window, :3] > best - settings.GLR_MARGIN
        yield Inflate(slice(6, 9), slice(6, 9), errors[blamed].T @ errors[blamed])
        yield from self._leave_out(filter, sizes[window, :AXES])

    def accused(self, filter: FilterState, slope: float) -> Iterator[Action]:
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
        if self._carried(filter):
            yield from self._leave_out(filter, np.repeat([tilt / settings.OUT_S, slope], 3))

    @staticmethod
    def _carried(filter: FilterState) -> bool:
        """Whether compass and DVL carry the vehicle without it."""
        recent = [c for c in filter.channels.values() if filter.memory.time_s - c.memory.last_s < settings.GLR_HEARD_S]
        return any(c.moves and c.faults.aside is None for c in recent) and any(
            c.sensor.observes.north is not None for c in recent
        )

    @staticmethod
    def fails_again(channel: Channel, memory: FilterMemory) -> bool:
        """Whether a unit that has been left out of late does not agree with what carried the vehicle without it."""
        since_s = memory.time_s - channel.faults.rejected_since_s
        late = memory.time_s - memory.monitor.imu[[0, 3], kernel.UNTIL_S].max() < settings.GLR_LONGEST_S
        carries = channel.faults.aside is None and (channel.moves or channel.sensor.observes.north is not None)
        return late and since_s > settings.REFUSED_S and carries

    def _leave_out(self, filter: FilterState, sizes: Array) -> Iterator[Action]:
        """Gyros and accelerometers are left out for a while; the longer, the sooner they have failed again."""
        now_s = filter.memory.time_s
        for begin in (0, 3):
            axes, first = filter.memory.monitor.imu[begin : begin + 3], filter.memory.monitor.imu[begin]
            again = now_s - first[kernel.UNTIL_S] < max(first[kernel.OUT_S], settings.OUT_S)
            first[kernel.OUT_S] = min(2.0 * first[kernel.OUT_S], settings.GLR_LONGEST_S) if again else settings.OUT_S
            first[kernel.UNTIL_S] = now_s + first[kernel.OUT_S]
            left = axes[:, kernel.CODE] <= kernel.NOISY
            axes[left, kernel.CODE], axes[left, kernel.BEGAN_S] = kernel.CONTRADICTED, 0.0
            axes[:, kernel.JUMP] = np.maximum(
                axes[:, kernel.JUMP], settings.GLR_OPENED * np.abs(sizes[begin : begin + 3])
            )
        yield from filter.monitor.imu_monitor.heed(filter)

    def take_back(self, axes: Array, first: int, filter: FilterState) -> Iterator[Action]:
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

"""The monitor of the navigator: judges every reading and every sample, and remembers what it has found."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.faults import (
    dead_reckoning_compass,
    fault_bank,
    noise_scale,
    policy,
    sensor_bias,
    settings,
    velocity_fault,
)
from navfilter.faults.imu import realignment
from navfilter.faults.imu.monitor import COUNTED, ImuMonitor
from navfilter.faults.memory import MonitorMemory, SensorFaults
from navfilter.filter.actions import Action, Announce
from navfilter.filter.events import UnitDoubted
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.foundation.state_values import copied
from navfilter.kernels import batch, imu_checks, strapdown
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.vehicle import Vehicle

Array = NDArray[np.float64]


class FaultMonitor:
    """Judges readings by `navfilter.faults.policy`, and samples by `navfilter.faults.imu`.

    Parameters
    ----------
    vehicle : Vehicle

    Attributes
    ----------
    imu_monitor : ImuMonitor
        Of the samples of the inertial unit.
    changes : list of Change
        Error models of sensors that have jumped or gone astray, to be adopted before the next input.
    is_tilted : bool
        Attitude and velocity are to be set anew before the next input, see `realignment.tilted`.
    """

    counted = COUNTED

    def __init__(self, vehicle: Vehicle) -> None:
        self.imu_monitor = ImuMonitor(vehicle.drive)
        self.sample_limits = self.imu_monitor.limits
        self.changes: list[Change] = []
        self.is_tilted = self.has_pending = False

    #: Whether a kernel may take readings in batches without asking for each.
    in_batches = True

    def initial_memory(self, filter: FilterState, memory: FilterMemory) -> MonitorMemory:
        """Its memory before the first input."""
        imu = self.imu_monitor.initial_memory()
        self.imu_monitor.refer(imu, memory.nav, memory.P)  # what is unknown weighs by it
        channels = {name: SensorFaults() for name in filter.channels}
        return MonitorMemory(imu, channels, self.initial_bank(filter.layout, filter.channels, memory.time_s))

    def room(self, layout: Layout, channels: Mapping[str, Channel]) -> tuple[int, int]:
        """Numbers that its bank of faults remembers, and how many more it works with."""
        return fault_bank.room(layout, channels) if self.imu_monitor.active else (0, 0)

    def initial_bank(
        self, layout: Layout, channels: Mapping[str, Channel], time_s: float, before: Array | None = None
    ) -> Array:
        """Its bank of faults before the first input."""
        return fault_bank.begun(layout, channels, time_s, before) if self.imu_monitor.active else np.zeros(0)

    def restore(self, memory: MonitorMemory, channels: Mapping[str, Channel], room: Array) -> None:
        """Let every channel have what is remembered of its sensor, and the kernels the bank of faults."""
        self._settle(memory, room)
        for name, channel in channels.items():
            channel.faults = memory.channels[name]

    @staticmethod
    def _settle(memory: MonitorMemory, room: Array) -> None:
        """Let kernels work with the bank."""
        room[: memory.bank.size] = memory.bank
        memory.bank = room[: memory.bank.size]

    def transform(self, filter: FilterState, memory: MonitorMemory, M: Array, room: Array) -> None:
        """The error states are M times what they were."""
        if room.size or memory.bank.size:
            time_s = filter.memory.time_s
            memory.bank = fault_bank.transformed(memory.bank, M, filter.layout, filter.channels, time_s)
            self._settle(memory, room)

    def begin_again(self, filter: FilterState, memory: MonitorMemory) -> None:
        """What innovations have told of slow faults is of another state."""
        if memory.bank.size:
            memory.bank[:] = fault_bank.begun(filter.layout, filter.channels, filter.memory.time_s, memory.bank)

    def problem(self, memory: MonitorMemory, fresh: MonitorMemory, channels: Mapping[str, Channel]) -> str | None:
        """What is wrong with a memory that came from outside, in words; None when nothing is."""
        for name, channel in channels.items():
            scatter = memory.channels[name].scatter
            if scatter is not None and not scatter.is_of(channel.axes):
                return f"what is kept of the noise of {name} is not laid out as this vehicle's"
        return memory.problem() or fault_bank.problem(memory.bank, fresh.bank)

    def transferred(
        self, filter: FilterState, memory: FilterMemory, layout: Layout, given: FilterMemory
    ) -> MonitorMemory:
        """Its memory where a filter begins anew from the state of another one, with these states."""
        own = filter.memory.monitor
        channels = {name: given.monitor.channels.get(name, known) for name, known in own.channels.items()}
        bank = self.initial_bank(layout, filter.channels, memory.time_s, given.monitor.bank)
        result = MonitorMemory(own.imu.copy(), copied(channels), bank)
        self.imu_monitor.refer(result.imu, memory.nav, memory.P)
        return result

    # ---------------------------------------------------------------- measurements
    def gate(self, channel: Channel, z: Array, sd: ArrayLike | None, time_s: float) -> tuple[Array, Array]:
        """Limits of the gate for a reading, and its white variances where they are not those of the error model."""
        own, kept = np.zeros(0) if sd is None else np.resize(np.square(np.ravel(sd)), channel.axes), channel.faults
        if kept.aside is not None or kept.scatter is not None:
            own = own if own.size else channel.group.r
            own = own if kept.aside is None else velocity_fault.widened_variances(kept.aside, z, own)
            own = own if kept.scatter is None else noise_scale.variances(kept.scatter, own)
        return sensor_bias.limits(channel, z, time_s), own

    def is_stale(self, filter: FilterState, channel: Channel, time_s: float) -> bool:
        """Of a fix that has the value of the one before: whether the vehicle has moved on since, by more than its noise
        and the velocity's could hide. Then the receiver is stuck, or it is no new fix.
        """
        kept, nav, P = channel.faults, filter.memory.nav, filter.memory.P
        if channel.sensor.observes.corrects != "position" or channel.axes < 2:
            return False
        if kept.again_s != channel.memory.last_s:
            kept.same_s = channel.memory.last_s
        kept.again_s = time_s
        slow = math.hypot(nav[3], nav[4]) - settings.STILL_SDS * math.sqrt(max(P[3, 3], P[4, 4]))
        moved = settings.STILL_SDS * math.sqrt(max(channel.white[0, 0], channel.white[1, 1]))
        return bool(slow * (time_s - kept.same_s) > moved)

    def after_gate(self, filter: FilterState, channel: Channel, time_s: float, frozen: bool) -> Actions:
        """After a reading has been gated: whether it is let in after all, and its NIS by the description."""
        (nis, dof, used), let_in = channel.verdict.tolist(), False
        described, worthless = noise_scale.note_reading(filter, channel, time_s, frozen)
        if used:
            policy.used(filter, channel, time_s)
        elif dof and math.isfinite(nis):
            let_in = yield from policy.rejected(filter, channel, time_s, nis, int(dof), worthless)
            since_s = channel.faults.rejected_since_s
            # what the unit itself feels is no evidence against it
            if filter.inertial and not channel.sensor.from_drive and time_s - since_s >= settings.REFUSED_S:
                yield Announce(UnitDoubted(since_s - channel.period_s, channel.sensor.observes.corrects))
        self.has_pending = bool(self.changes or self.is_tilted)
        return let_in, described

    def pending(self, filter: FilterState) -> Actions:
        """What refused readings have made necessary, before the next input; whether slow faults were looked for."""
        if self.has_pending:
            self.has_pending = False
            yield from policy.pending(filter)
        return (yield from fault_bank.look(filter))  # behind what was decided without knowing of it

    # ---------------------------------------------------------------- the inertial unit
    def sample_sd(self, drive: Mechanisation, white: Array) -> Array:
        """By how much samples are to differ from one to the next, shape (6,)."""
        return self.imu_monitor.expected(drive, white)

    def set_imu_noise(self, memory: MonitorMemory, C: Array, r: Array, output: Array) -> bool:
        """Write the error models of the axes as they are believed now to `output`; whether any force is felt."""
        return self.imu_monitor.set_imu_noise(memory.imu, C, r, output)

    def rate_variance(self, memory: MonitorMemory, r: Array) -> Array:
        """Variance of the angular rate as it is used for lever arms, shape (3,)."""
        return self.imu_monitor.rate_variance(memory.imu, r)

    def check_samples(self, samples: Array, memory: MonitorMemory, sd: Array) -> int:
        """How many samples may be taken before something has to be heeded; bad axes are replaced in them."""
        return self.imu_monitor.check_samples(samples, memory.imu, sd)

    def last_values(self, memory: MonitorMemory) -> Array | None:
        """Of the last sample of an inertial unit as it came, shape (6,), whatever stood in for it; else None."""
        return memory.imu[: imu_checks.UNIT, imu_checks.RAW] if self.imu_monitor.active else None

    def replace_missing(self, filter: FilterState, samples: Array, said_s: float) -> Iterator[Action]:
        """Write values for samples that are missing."""
        yield from self.imu_monitor.replace_missing(samples, filter.memory, said_s)

    def has_findings(self, memory: FilterMemory) -> bool:
        """Whether something has been found in the samples."""
        return self.imu_monitor.news(memory.monitor.imu) or strapdown.has_jumped(memory.drv)

    def act_on_imu(self, filter: FilterState) -> Actions:
        """Act on what has been found in the samples."""
        memory = filter.memory
        w = memory.monitor.imu
        if not filter.inertial:
            yield from dead_reckoning_compass.heed_jump(filter)
        elif not batch.gravity_is_due(w, memory.nav, memory.P, filter.period_s):
            before = memory.monitor.has_excluded
            yield from self.imu_monitor.heed(filter)
            if before or memory.monitor.has_excluded:
                yield from realignment.after_fault(filter)

    def excluded_axes(self, memory: MonitorMemory) -> list[str]:
        """Names of the axes that something else stands in for."""
        return self.imu_monitor.excluded_axes(memory.imu)

    def propagation(self, memory: MonitorMemory) -> str:
        """What carries the state: "inertial", or "dead-reckoning" while an axis is left out or there is none."""
        return "inertial" if self.imu_monitor.active and not memory.has_excluded else "dead-reckoning"

    def conditions(self, memory: MonitorMemory) -> dict[str, str]:
        """Condition of every axis in words; none where nothing is watched."""
        return self.imu_monitor.conditions(memory.imu)

    def on_silence(self, filter: FilterState, missing: bool) -> Iterator[Action]:
        """Before samples or a reading: note when nothing is heard any more, and what follows when it ends."""
        if missing or filter.memory.monitor.silent:
            yield from realignment.attend(filter, missing)

"""The condition of a run, from what its filter and its watches remember: health, bounds and trust."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from navfilter.filter import integrity
from navfilter.filter.channel import Channel
from navfilter.filter.filter import Filter
from navfilter.filter.health import Health, SensorHealth, Watch
from navfilter.sensors import Sensor

__all__ = ["health_of", "whole_offset"]

Array = NDArray[np.float64]


def health_of(filter: Filter, watches: Mapping[str, Watch]) -> Health:
    """What the sensors are worth at present, how far the truth may be, and whether the state is to be trusted.

    Parameters
    ----------
    filter : Filter
    watches : dict of str to Watch
        By sensor.
    """
    memory, state, channels = filter.memory, filter.state, filter.channels
    now_s, P = memory.time_s, state.covariance
    assert P is not None
    sensors = {name: watch.health(now_s, channels[name].offset) for name, watch in watches.items()}
    axes = filter.watch.conditions(memory.watch)
    witnesses = [w for name, watch in watches.items() for w in _witness(channels[name], watch, sensors[name])]
    drive = filter.vehicle.drive
    rate = drive.body_rate(
        memory.drv, drive.outputs(filter.drive_output[:, :-1], memory.drv)[:3] @ memory.x[: filter.layout.drive.size]
    )
    speed, turn = math.sqrt(float(state.velocity_n @ state.velocity_n)), float(np.abs(rate).max())
    # fixes are not there under water: what that costs is in the bounds
    calm = {
        name: ("good", "waiting", "silent") if channel.sensor.corrects == "position" else ("good", "waiting")
        for name, channel in channels.items()
    }
    doubts = [f"{name} is {s.condition}" for name, s in sensors.items() if s.condition not in calm[name]]
    doubts += [f"{name} is {condition}" for name, condition in axes.items() if condition != "good"]
    return Health(
        sensors,
        dict(memory.counts),
        memory.intake.offset_s,
        axes,
        integrity.bounds(P, _fixed(filter, watches), witnesses),
        integrity.trust(P, speed, turn, (drive.max_speed_m_s, drive.max_turn_rad_s), doubts),
    )


def _fixed(filter: Filter, watches: Mapping[str, Watch]) -> integrity.Fixed:
    """Since the last fix that was used, or the start."""
    memory, start = filter.memory, filter.start.state
    time_s, latitude, longitude = start.time_s, start.latitude, start.longitude
    for name, channel in filter.channels.items():
        watch = watches[name]
        if channel.sensor.corrects == "position" and watch.used_s > time_s:
            time_s, latitude, longitude = watch.used_s, watch.latitude, watch.longitude
    north = (float(memory.nav[0]) - latitude) * memory.nav[15]
    east = (float(memory.nav[1]) - longitude) * memory.nav[16] * math.cos(latitude)
    return integrity.Fixed(memory.time_s - time_s, math.hypot(north, east), filter.inertial)


def _witness(channel: Channel, watch: Watch, health: SensorHealth) -> Iterator[integrity.Witness]:
    """What a sensor may be off by, if it sees anything that the bounds are about and has not been found out."""
    sensor, a = channel.sensor, channel.axes
    if channel.offset or sensor.corrects not in ("position", "velocity", "heading"):
        return
    residual, variance = channel.note[3 : 3 + a], channel.note[3 + a :]
    kept = channel.memory
    confirmed = kept.used_s - kept.agreed_s >= integrity.CONFIRMED_S
    again = kept.last_s - kept.rejected_since_s > 0.5 * channel.period_s
    if again or (not confirmed and not math.isnan(kept.rejected_since_s)):
        yield integrity.Witness(sensor.corrects, whole_offset(sensor, residual))
    elif math.isfinite(watch.used_s):
        e, C = channel.group.errors, channel.C
        largest = float(np.nanmax(variance + np.diag(C @ channel.group.P0[:e, :e] @ C.T), initial=0.0))
        yield integrity.Witness(sensor.corrects, math.sqrt(float(channel.limits[a]) * largest))


def whole_offset(sensor: Sensor, residual: Array) -> float:
    """Size of a residual of refused readings: of fixes the horizontal one."""
    known = np.nan_to_num(np.abs(residual))
    return math.hypot(*known[:2]) if sensor.corrects == "position" and known.size > 1 else float(known.max())

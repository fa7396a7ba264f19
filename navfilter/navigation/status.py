"""The condition of a run, from what its filter and its watches remember: health, bounds and trust."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from navfilter.faults import fault_bank, protection_level, settings
from navfilter.faults.alternative_path import since_fix
from navfilter.faults.bias_plausibility import beside
from navfilter.faults.clocks.imu_clock import ImuClockMonitor
from navfilter.faults.heading_fault import led_astray, told_by_fixes
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.filter import Filter
from navfilter.filter.sensor_channel import MOST_SDS, Channel
from navfilter.foundation.arrays import Array
from navfilter.foundation.display import Shown
from navfilter.models.during import same_sensor
from navfilter.models.health import CALM, Bounds, Health, LearningHealth, SensorHealth
from navfilter.models.learned_arma import learning_part
from navfilter.models.start import Start
from navfilter.models.state import NavState


class NavigatorStatus(Shown):
    """What navigators share: how they show themselves, and what a copy of one is."""

    @property
    def _in_force(self) -> Filter:
        now: Any = self
        return getattr(now, "believed", now).filter

    @property
    def counts(self) -> dict[str, int]:
        """Irregularities so far, see `Health.drive`; of several lanes those of the one in force."""
        return self._in_force.counts

    @property
    def errors(self) -> dict[str, float]:
        """Estimates of all error states and parameters by name; of several lanes those of the one in force."""
        return self._in_force.errors

    @property
    def covariance(self) -> Array:
        """Of position [m], velocity [m/s] and attitude [rad] in n, now, shape (9, 9): that of `state`, by itself."""
        return self._in_force.present[:81].reshape(9, 9)

    def __reduce__(self) -> tuple[Any, ...]:
        # for copy and pickle: what a navigator holds of threads, kernels and views of memory can be made only anew
        now: Any = self
        return now.restore, (now.vehicle, now.snapshot())

    def _shown(self) -> tuple[str, dict[str, object]]:
        now: Any = self
        title, rows = now.state._shown()
        filter = self._in_force
        learns = {name: s.models for name, s in filter.in_force.sensors.items() if any(map(learning_part, s.models))}
        rows |= {f"error of {name}": ", ".join(dict.fromkeys(map(str, models))) for name, models in learns.items()}
        return f"{type(self).__name__} of {now.vehicle.name}, {title.removeprefix('NavState ')}", rows


def state_of(
    filter: Filter, watches: Mapping[str, SensorMonitor], clock: ImuClockMonitor, learning: LearningHealth
) -> NavState:
    """The state with its covariance and health, now; a copy."""
    state = filter.state
    return replace(state, health=health_of(filter, watches, clock, learning, state))


def health_of(
    filter: Filter,
    watches: Mapping[str, SensorMonitor],
    clock: ImuClockMonitor,
    learning: LearningHealth,
    state: NavState,
) -> Health:
    """What the sensors are worth at present, how far the truth may be, and whether the state is to be trusted.

    Parameters
    ----------
    filter : Filter
    watches : dict of str to Watch
        By sensor.
    clock : ImuClockMonitor
    learning : LearningHealth
    state : NavState
        That of the filter, now.
    """
    memory, channels, P = filter.memory, filter.channels, state.covariance
    assert P is not None
    now_s = memory.time_s
    sensors = {
        name: watch.health(now_s, channels[name].faults.condition(channels[name].offset))
        for name, watch in watches.items()
    }
    drive = filter.in_force.drive
    axes = filter.monitor.conditions(memory.monitor) or drive.conditions(memory.drv)
    off: dict[str, float] = {}
    held = filter.inertial and drive.feels
    slow, fix = 0.0, _last_fix(filter.start, channels, watches)
    for name, watch in watches.items():
        sees, known = channels[name].sensor.observes.corrects, _off(channels[name], watch, now_s)
        off[sees] = max(off.get(sees, 0.0), known)
        slow = max(slow, *channels[name].slow) if sees == "heading" and known > 0.0 else slow
        slow = max(slow, told_by_fixes(channels[name], memory.nav, *fix[1:]))
        # fixes that are used follow the way at first
        off["position"] = max(off.get("position", 0.0), led_astray(channels[name], memory.nav))
        if not held and sees == "position" and channels[name].group.errors:
            # what drives is held by nothing: it may be that, and not the fixes, which errs slowly
            off["position"] = max(off["position"], beside(channels[name], memory.x))
    age_s, moved_m = memory.time_s - fix[0], _distance(memory.nav, *fix[1:])
    beside_m = max((since_fix(filter, channel).length for channel in channels.values()), default=0.0)
    compared = filter.inertial or any(channel.sensor.observes.corrects == "heading" for channel in channels.values())
    radius_m, heading_rad = protection_level.bounds(
        P, age_s, moved_m, off, held, slow, beside_m, compared, *filter.unnoticed
    )
    _, errors = drive.outputs(filter.drive_output, memory.drv, memory.x[: filter.layout.drive.size])
    rate = drive.body_rate(memory.drv, errors[:3])
    speed, turn = math.hypot(*memory.nav[3:6].tolist()), max(map(abs, np.atleast_1d(rate).tolist()))
    # fixes are not there under water: what that costs is in the bounds
    fixes = {name for name, channel in channels.items() if channel.sensor.observes.corrects == "position"}
    doubts = [
        f"{name} is {s.condition}"
        for name, s in sensors.items()
        if s.condition not in CALM and not (s.condition == "silent" and (name in fixes or _stood_in(name, sensors)))
    ]
    doubts += [f"{name} is {condition}" for name, condition in axes.items() if condition != "good"]
    doubts += fault_bank.suspected(filter)
    return Health(
        sensors,
        dict(memory.counts) | clock.counts,
        memory.intake.offset_s,
        axes,
        Bounds(float(radius_m), float(heading_rad)),
        protection_level.trust(P, speed, turn, (drive.max_speed_m_s, drive.max_turn_rad_s), doubts),
        filter.monitor.propagation(memory.monitor),
        clock.memory.offset_s,
        learning,
    )


def _stood_in(name: str, sensors: Mapping[str, SensorHealth]) -> bool:
    """Whether the silence of this name is none of the instrument: it is heard under another one, or says so there."""
    names = same_sensor(name, sensors)
    return not names or any(sensors[each].condition not in ("silent", "waiting") for each in names)


def _last_fix(
    start: Start, channels: Mapping[str, Channel], watches: Mapping[str, SensorMonitor]
) -> tuple[float, float, float]:
    """Time [s], latitude and longitude [rad] of the last fix that was used, or of the start."""
    last = start.time_s, math.radians(start.latitude_deg), math.radians(start.longitude_deg)
    for name, watch in watches.items():
        if channels[name].sensor.observes.corrects == "position" and watch.used_s > last[0]:
            last = watch.used_s, *watch.place
    return last


def _distance(nav: Array, latitude: float, longitude: float) -> float:
    """Of a state from a place [m]."""
    north = (float(nav[0]) - latitude) * float(nav[15])
    east = (float(nav[1]) - longitude) * float(nav[16]) * math.cos(latitude)
    return math.hypot(north, east)


def _off(channel: Channel, watch: SensorMonitor, now_s: float) -> float:
    """What a sensor may be off by; 0 for one that has not been heard, or has been found to be off."""
    sensor, kept, a = channel.sensor, channel.faults, channel.axes
    if channel.offset or not sensor.observes.corrects:
        return 0.0
    note = channel.note.tolist()
    # one that is refused alone is an outlier, unless the sensor has confirmed nothing yet
    confirmed = kept.confirmed(channel.memory.used_s)
    again = channel.memory.last_s - kept.rejected_since_s > 0.5 * channel.period_s
    alone = kept.alone[0] if kept.alone else 0.0
    if again or (not confirmed and not math.isnan(kept.rejected_since_s)):
        return max(
            alone,
            float(protection_level.whole_offset(sensor.observes.corrects, channel.note[3 : 3 + a], max(channel.slow))),
        )
    if kept.astray:
        # it may have been off by what was still believed of its error
        return MOST_SDS * math.sqrt(2.0 * max(channel.slow))
    if alone:
        return alone
    if not math.isfinite(watch.used_s):
        return 0.0
    largest = max((v + s for v, s in zip(note[3 + a :], channel.slow, strict=True) if v + s > 0.0), default=0.0)
    unseen = math.sqrt(float(channel.limits[a]) * largest)
    return max(unseen, kept.beat[0]) if kept.beat and now_s - kept.beat[1] < settings.FOLLOWED_S else unseen

"""A reading that its gate has refused: what of the filter's memory changes because of it, and those before it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import (
    alternative_path,
    dead_reckoning_compass,
    depth_fault,
    heading_fault,
    innovation_gate,
    iron,
    sensor_bias,
    velocity_fault,
)
from navfilter.faults.bias_plausibility import (
    beyond_belief,
    estimate,
    excused,
    pulled,
    reckoned_since,
    reckoned_wrongly,
)
from navfilter.faults.heading_fault import Course, against_the_compass, told_here, turned, turned_by_fixes
from navfilter.faults.imu import acceleration, bias_drift, gyro_scale, realignment
from navfilter.faults.protection_level import FOLLOWED_S, IN_LINE
from navfilter.faults.refusals import LEAST, Refusals
from navfilter.filter.events import Event
from navfilter.filter.model_change import Change
from navfilter.filter.python_update import update
from navfilter.filter.sensor_channel import Channel
from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.models.fault_bias import with_offsets
from navfilter.models.sensors.observable import Observable

if TYPE_CHECKING:
    from navfilter.filter.filter import Filter

__all__ = ["let_in", "take_up", "used"]

Array = NDArray[np.float64]
#: Below this speed a velocity that is off says nothing of its scale [m/s].
SLOW = 0.1
#: A sensor that seems to jump twice in this time has not [s]: no fault that jumps comes in another size so soon.
AGAIN_S = 120.0


def let_in(filter: Filter, channel: Channel, time_s: float, nis: float, dof: int, frozen: bool) -> bool:
    """After a rejection: whether the reading is let in after all, because refused readings agree against the state, or
    have been refused for so long that the gate widens; where all sensors contradict the state, it is given up.

    Parameters
    ----------
    filter : Filter
        Its memory is changed.
    channel : Channel
        As the rejected update left it.
    time_s, nis : float
        Time and normalised innovation squared of the reading.
    dof : int
        Components used in it.
    frozen : bool
        The value has not changed for suspiciously long: it proves nothing.
    """
    memory, kept, P = filter.memory, channel.memory, filter.memory.P
    if math.isnan(kept.rejected_since_s):
        kept.rejected_since_s, kept.refused_speed = time_s, math.hypot(*memory.nav[3:6].tolist())
    if frozen or (kept.scatter is not None and kept.scatter.worthless):
        kept.refused = None
        return False
    if alternative_path.out_of_reach(filter, channel, time_s):
        return False
    if channel.sensor.ground:
        kept.way = alternative_path.with_refused(filter, channel, time_s)
    if channel.sensor.observes.north is not None:
        gyro_scale.refused(filter, channel, time_s, innovation_gate.whole_heading(channel, memory.x))
    if channel.moves:
        filter.accused = acceleration.accused(filter, channel, time_s)
        if filter.accused is not None:
            if channel.offset:
                kept.aside = None
                filter.jumped.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))
            return False
    if channel.moves and not channel.aside:
        filter.tilted = realignment.tilted(filter, channel, time_s)
        if filter.tilted:
            return False
    if channel.sensor.observes is Observable.FIX:
        change = dead_reckoning_compass.contradicted(filter, channel, time_s)
        if change is not None:
            filter.jumped += [Change(channel.name, channel.sensor.models, afresh=True), change]
            return False
    if beyond_belief(channel, memory.x):
        _gone_astray(filter, channel)
        return False
    kept.astray_m += math.hypot(*memory.nav[3:6].tolist()) * channel.period_s
    if excused(channel):
        P[range(3), range(3)] += np.nan_to_num(channel.res[:3]) ** 2
        _update(filter, channel, time_s)
        return True
    if sensor_bias.judges(channel) and _agreed(filter, channel, time_s):
        return True
    if innovation_gate.state_contradicted(filter.channels.values(), time_s, filter.inertial):
        P[range(9), range(9)] += innovation_gate.reset_variance(filter.channels.values(), time_s)
        drive = filter.layout.drive
        P[drive.slice, drive.slice] += drive.P0
        for other in filter.channels.values():
            if not math.isnan(other.memory.rejected_since_s):
                _follows(other, time_s)
            other.memory.rejected_since_s, other.memory.agreed_s, other.memory.refused = math.nan, math.nan, None
        memory.counts["opened"] += 1
        return False
    if channel.offset:
        if not channel.aside and time_s - kept.rejected_since_s >= channel.sensor.gate_timeout_s:
            _jumped(filter, channel, time_s)
        return False
    added = None if sensor_bias.disproved(channel, time_s) else innovation_gate.widening(P, channel, time_s, nis, dof)
    if added is None:
        return False
    if depth_fault.undecided(filter, channel, time_s):
        depth_fault.open_both(filter, channel, time_s)
        return False
    channel.R *= added.white_factor
    P[added.places, added.places] += added.covariance
    _follows(channel, time_s)
    P[:2, :2] += alternative_path.followed(filter, channel)
    _update(filter, channel, time_s)
    return True


def _agreed(filter: Filter, channel: Channel, time_s: float) -> bool:
    """What refused readings say together: True when the state was opened to them, and this one let in. A sensor that
    has jumped gets constants by its next reading (`Filter.jumped`).
    """
    memory, kept = filter.memory, channel.memory
    speed = math.sqrt(float(memory.nav[3:6].dot(memory.nav[3:6])))
    drive = filter.drive_output, filter.vehicle.drive.period_s
    course, back = (None, 0) if kept.refused is None else (kept.refused.course, kept.refused.back)
    kept.refused = refused = sensor_bias.heard(channel, memory.P, speed, time_s, *drive)
    kept.refused_s = time_s
    if channel.sensor.observes is Observable.FIX:
        kept.refused = refused = replace(refused, course=_made(course, channel, time_s, memory.nav))
        if _heading_outvoted(filter, channel, refused, time_s):
            return False
    if channel.offset:
        back = back + 1 if _is_back(filter, channel) else 0
        kept.refused = refused = replace(refused, back=back)
        if channel.aside and back < LEAST:
            return False
    carried = depth_fault.are_told(filter, channel, time_s)
    wrong = sensor_bias.decided(channel, carried)
    if wrong == "sensor" or refused.back >= LEAST:
        _jumped(filter, channel, time_s)
        return False
    if wrong != "state" or channel.offset:
        return False
    moved_m = float(np.linalg.norm(filter.start.way_to(*memory.nav[:2].tolist())))
    for other in filter.channels.values():
        if sensor_bias.alike(other, channel):
            other.memory.agreed_s = math.nan
    memory.counts["reset"] += 1
    told = math.sqrt(float(memory.P[8, 8]))
    held = any(
        other.sensor.observes.corrects == "depth"
        and other is not channel
        and time_s - other.memory.used_s < sensor_bias.SPAN_S
        for other in filter.channels.values()
    )
    memory.P[:9, :9] += sensor_bias.opened_state(channel, refused, moved_m, held, carried)
    if sensor_bias.is_gauge(channel) and not carried:
        unit = filter.layout.drive
        own = np.concatenate(unit.biases[3:])
        memory.P[unit.start + own, unit.start + own] += unit.P0[own, own]
    north = channel.sensor.observes.north
    if north is not None:
        angle, variance = refused.offset[north], refused.variance[north] + channel.slow[north]
        most = abs(angle) + IN_LINE * told
        kept.alone = (most, float(memory.nav[0]), float(memory.nav[1]))
        filter.jumped.append(Change(channel.name, channel.sensor.models, offsets=True, turn=(angle, variance)))
        return False
    memory.P[:2, :2] += alternative_path.followed(filter, channel)
    _follows(channel, time_s)
    velocity = dead_reckoning_compass.opened_velocity(filter, reckoned_since(channel, refused, speed), speed)
    filter.jumped += [] if velocity is None else [velocity]
    memory.counts["jumped"] += velocity is not None
    _update(filter, channel, time_s)
    return True


def _is_back(filter: Filter, channel: Channel) -> bool:
    """Whether a reading beside the constants of its sensor agrees with the state without them."""
    memory, kept = filter.memory, channel.memory.aside
    constant = channel.jumped_by(memory.x)
    if kept is not None and not velocity_fault.shows_itself(
        kept, math.hypot(*memory.nav[3:6].tolist()), channel.res + constant
    ):
        return False
    return sensor_bias.is_back(channel, constant, memory.P)


def _made(course: Course | None, fixes: Channel, time_s: float, nav: Array) -> Course | None:
    """The way made good, with one more refused fix."""
    if not np.isfinite(fixes.res[:2]).all():
        return course
    return (course or Course(float(nav[0]), float(nav[1]), time_s)).and_then(time_s, nav, fixes.res)


def _heading_outvoted(filter: Filter, fixes: Channel, refused: Refusals, time_s: float) -> bool:
    """Whether fixes and velocity together contradict the compass: then the position is opened to the next fix, and
    before that the heading is turned (`take_up`), and the fixes' slow error, which has followed it, begins afresh.
    """
    memory = filter.memory
    change = None if refused.course is None else against_the_compass(filter, fixes, refused.course, time_s)
    if change is None or change.turn is None:
        return False
    memory.P[range(3), range(3)] += np.nan_to_num(fixes.res[:3]) ** 2
    if change.sensor != fixes.name:
        filter.channels[change.sensor].memory.course = told_here(fixes, memory.nav, change.turn[1])
        filter.jumped.append(Change(fixes.name, fixes.sensor.models, afresh=True))
    filter.jumped.append(change)
    memory.counts["reset"] += 1
    memory.counts["jumped"] += 1
    return True


def _gone_astray(filter: Filter, channel: Channel) -> None:
    """Begin the slow error of a sensor afresh, and carry as variance what it may have done to the position. Where dead
    reckoning errs rather, its velocity gets a constant.
    """
    memory, kept = filter.memory, channel.memory
    speed = math.hypot(*memory.nav[3:6].tolist())
    velocity = dead_reckoning_compass.opened_velocity(filter, reckoned_wrongly(channel, speed), speed)
    off = pulled(channel, memory.x) if velocity is None else np.abs(estimate(channel, memory.x))
    memory.P[range(3), range(3)] += off**2
    kept.refused, kept.astray_m = None, 0.0 if velocity is None else math.nan
    filter.jumped.append(Change(channel.name, channel.sensor.models, afresh=True))
    filter.jumped += [] if velocity is None else [velocity]
    memory.counts["astray" if velocity is None else "jumped"] += 1


def take_up(filter: Filter, tell: Callable[[Event], None]) -> None:
    """Do what refused readings have made necessary, before the next input."""
    bias_drift.look(filter)
    if filter.accused is not None:
        slope, filter.accused = filter.accused, None
        filter.jumps.accused(filter, slope)
        _turned_to_the_compass(filter)
        realignment.set_anew(filter, tell)
    if filter.tilted:
        filter.tilted = False
        realignment.set_anew(filter, tell)
    while filter.jumped:
        change = filter.jumped.pop(0)
        if change.sensor not in filter.channels:
            dead_reckoning_compass.take_up(filter, change, tell)
            continue
        channel = filter.channels[change.sensor]
        channel.memory.refused = None
        if change.afresh or change.error is not channel.sensor.models:
            filter.adopt(change, tell)
        if change.turn is not None and channel.sensor.observes.north is None:
            turned_by_fixes(filter, *change.turn, tell)
        elif change.turn is not None:
            turned(filter, channel, *change.turn)


def _turned_to_the_compass(filter: Filter) -> None:
    """The drive is wrong: where a compass has been refused, too, the heading is what it says."""
    now_s = filter.memory.time_s
    for channel in filter.channels.values():
        kept = channel.memory
        lasts = now_s - kept.rejected_since_s >= realignment.REFUSED_S and now_s - kept.last_s < realignment.HEARD_S
        north = channel.sensor.observes.north
        if lasts and north is not None and not channel.offset:
            off = innovation_gate.whole_heading(channel, filter.memory.x)
            if abs(off) < math.tau:  # else it is no angle
                variance = float(channel.white[north, north]) + channel.slow[north]
                turned(filter, channel, math.remainder(off, math.tau), variance)
                return  # what another one read was held against the heading before


def _jumped(filter: Filter, channel: Channel, time_s: float) -> None:
    """Give a sensor constants of the size of its jump; open those that it has, or take them where it is back. Of a
    velocity that has jumped by about itself only what reads the same is used from now on.
    """
    memory, kept = filter.memory, channel.memory
    refused = kept.refused
    assert refused is not None
    may_be = depth_fault.undecided if channel.offset else depth_fault.may_be_right
    if sensor_bias.is_gauge(channel) and refused.back < LEAST and may_be(filter, channel, time_s):
        depth_fault.open_both(filter, channel, time_s)
        return
    kept.either = False
    size = float(np.nanmax(np.abs(refused.offset), initial=0.0))
    models, places = channel.sensor.models, sensor_bias.offset_places(channel)
    kept.aside = None if refused.back >= LEAST else velocity_fault.jumped(filter, channel, np.array(refused.offset))
    if kept.aside is not None:
        memory.P[places, places] += size**2
        opened = with_offsets(models, size, density=kept.aside.density, only=channel.sensor.jumps)
        filter.jumped.append(Change(channel.name, opened, offsets=True))
    elif refused.back >= LEAST or not len(places):
        back, speed = len(places) > 0, math.hypot(*memory.nav[3:6].tolist())
        moving = channel.sensor.observes is Observable.VELOCITY_BODY and speed > SLOW
        only, deviates = channel.sensor.jumps, channel.sensor.observes.north is not None
        opened = with_offsets(models, 0.0 if back else size, speed if moving else 0.0, only=only, deviates=deviates)
        filter.jumped.append(Change(channel.name, opened, offsets=True))
    elif channel.moves and filter.inertial and time_s - kept.jumped_s < AGAIN_S:
        _runs_away(filter, channel, time_s)
    else:
        memory.P[places, places] += size**2
        kept.refused = None
    kept.rejected_since_s = kept.disputed_s = kept.jumped_s = time_s
    kept.course = kept.course if refused.back < LEAST else ()
    if kept.way is not None and refused.back >= LEAST:
        kept.way = replace(kept.way, north=0.0, east=0.0)
    memory.counts["jumped"] += 1


def used(filter: Filter, channel: Channel, time_s: float) -> None:
    """Note that a reading of this time has been used, and take constants of its sensor away where it turns out to have
    none.
    """
    heading_fault.used(filter, channel, time_s)
    if not channel.offset:
        return
    iron.used(filter, channel, time_s)
    kept, memory = channel.memory, filter.memory
    settled = (
        time_s - kept.jumped_s >= sensor_bias.SPAN_S and not channel.aside and channel.name not in _waiting(filter)
    )
    if settled and sensor_bias.is_none(channel, memory.x, memory.P):
        kept.either = False
        filter.jumped.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))


def _waiting(filter: Filter) -> list[str]:
    return [change.sensor for change in filter.jumped]


def _runs_away(filter: Filter, channel: Channel, time_s: float) -> None:
    """A velocity seems to jump again: the unit runs away from it. Its constants are taken away, and velocity, way since
    then, tilt and the unit's own errors are opened as far as it is off.
    """
    memory, kept = filter.memory, channel.memory
    span_s, N = max(time_s - kept.jumped_s, channel.period_s), np.nan_to_num(channel.near[:, 3:6])
    off = np.nan_to_num(channel.res[: channel.axes] + channel.jumped_by(memory.x))
    V = N.T @ (off[:, None] ** 2 * N)
    memory.P[3:6, 3:6] += V
    memory.P[:3, :3] += V * span_s**2
    memory.P[range(6, 8), range(6, 8)] += float(off @ off) / (span_s * STANDARD_GRAVITY) ** 2
    drive = filter.layout.drive
    memory.P[drive.slice, drive.slice] += drive.P0
    filter.jumped.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))
    kept.refused = kept.aside = None


def _follows(channel: Channel, time_s: float) -> None:
    """Remember that the state is set to fixes against what was believed before: they may be what was wrong."""
    if channel.sensor.observes is Observable.FIX:
        before_m, before_s = channel.memory.beat or (0.0, -math.inf)
        off_m = math.hypot(*np.nan_to_num(channel.res[:2]).tolist())
        channel.memory.beat = max(off_m, before_m if time_s - before_s < FOLLOWED_S else 0.0), float(time_s)


def _update(filter: Filter, channel: Channel, time_s: float) -> None:
    """Correct by the reading that was refused, now that the covariance lets it in."""
    memory, P = filter.memory, filter.memory.P
    P[:] = 0.5 * (P + P.T)
    channel.res[:] = innovation_gate.whole_residual(channel, memory.x)
    no_limits = np.full(channel.axes + 1, np.inf)
    update(memory, channel, channel.C, channel.R, no_limits, filter.drive_output)
    channel.memory.use(time_s)
    memory.counts["widened"] += 1

"""What follows from a reading that its gate has refused, or let in: the rules, and the order in which they are asked.

Each rule yields what the filter is to do (`navfilter.filter.actions`), and goes on when that has been done.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import (
    alternative_path,
    dead_reckoning_compass,
    depth_fault,
    fault_bank,
    ground_velocity,
    heading_fault,
    innovation_gate,
    sensor_bias,
    settings,
    velocity_fault,
)
from navfilter.faults.bias_plausibility import has_led, pulled, reckoned_since, reckoned_wrongly
from navfilter.faults.heading_fault import TrackRotationFit, against_the_compass, told_here, turned, turned_by_fixes
from navfilter.faults.imu import realignment
from navfilter.faults.protection_level import IN_LINE
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.filter.actions import Action, Adopt, Announce, Count, Inflate, Readmit
from navfilter.filter.events import UnitDoubted
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels.fault_bank import BELIEVED, GONE
from navfilter.models.fault_bias import descriptions, with_offsets
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]


def rejected(filter: FilterState, channel: Channel, time_s: float, nis: float, dof: int, worthless: bool) -> Actions:
    """After a rejection: whether the reading is let in after all.

    The rules of `REJECTED` are asked in their order; the first that answers decides.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        As the rejected update left it.
    time_s, nis : float
        Time and normalised innovation squared of the reading.
    dof : int
        Components used in it.
    worthless : bool
        The value has not changed for suspiciously long, or its sensor says nothing: it proves nothing.

    Returns
    -------
    bool
    """
    kept = channel.faults
    if math.isnan(kept.rejected_since_s):
        kept.rejected_since_s, kept.refused_speed = time_s, math.hypot(*filter.memory.nav[3:6].tolist())
    reading = Rejected(time_s, nis, dof, worthless)
    for rule in REJECTED:
        answer = yield from rule(filter, channel, reading)
        if answer is not None:
            return answer
    return False


class Rejected(NamedTuple):
    """A reading that its gate has refused; see `rejected`."""

    time_s: float
    nis: float
    dof: int
    worthless: bool


def _frozen_or_worthless(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A value that does not change, or a sensor that says nothing: no reading is evidence."""
    yield from ()
    if not reading.worthless:
        return None
    channel.faults.refused = None
    return False


def _fix_out_of_reach(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A fix of a place to which no such vehicle has come."""
    yield from ()
    fixes = channel.sensor.observes is Observable.FIX
    return False if fixes and alternative_path.out_of_reach(filter, channel, reading.time_s) else None


def _note_alternative_path(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A velocity that is refused: the way that it would have made is kept. Decides nothing."""
    yield from ()
    if channel.ground:
        channel.faults.way = alternative_path.with_rejected(filter, channel, reading.time_s)


def _unit_blamed(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A velocity that the bank of faults blames the unit for: the filter without that takes over."""
    if not (filter.inertial and channel.moves and channel.ground):
        return None
    kept, refused_s = channel.faults, reading.time_s - channel.faults.rejected_since_s
    residual = ground_velocity.components(channel, channel.note[3 : 3 + channel.axes])
    off = float(np.linalg.norm(np.nan_to_num(residual)))
    # a velocity through water may change with the water, slowly, too
    if not (refused_s >= settings.VELOCITY_SPAN_S and off > channel.sensor.flows_m_s):
        return None
    doubted = fault_bank.blames_unit(filter, channel)
    if doubted is None:
        return None
    if channel.offset:
        kept.aside, kept.odds = None, 0.0
        filter.monitor.changes.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))
    yield Announce(UnitDoubted(kept.rejected_since_s - channel.period_s, doubted, told=True))
    return False


def _tilt(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A velocity that never confirmed the state, refused because its tilt is wrong: it is set anew."""
    yield from ()
    if not channel.moves or channel.faults.confirmed(channel.memory.used_s):
        return None
    filter.monitor.is_tilted = realignment.tilted(filter, channel, reading.time_s)
    return False if filter.monitor.is_tilted else None


def _dead_reckoning_compass(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """Fixes against dead reckoning without a unit: its compass is turned."""
    if channel.sensor.observes is not Observable.FIX:
        return None
    change = yield from dead_reckoning_compass.replace_compass(filter, channel, reading.time_s)
    if change is None:
        return None
    filter.monitor.changes += [Change(channel.name, channel.sensor.models, afresh=True), change]
    return False


def _implausible_bias(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A coloured error that its model does not allow: it begins afresh."""
    if channel.is_bounded and channel.beyond_belief(filter.memory.x):
        yield from _gone_astray(filter, channel)
        return False
    channel.faults.astray_m += math.hypot(*filter.memory.nav[3:6].tolist()) * channel.period_s
    return None


def _within_dead_reckoning(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """Fixes that are off by no more than dead reckoning may err since they went astray."""
    off_m = math.hypot(*np.nan_to_num(channel.res).tolist())
    if not off_m <= settings.BIAS_SHARE * channel.faults.astray_m:  # NaN where they are not
        return None
    yield Inflate(range(3), range(3), np.nan_to_num(channel.res[:3]) ** 2)
    yield from _readmit(filter, channel, reading.time_s)
    return True


def _sensor_or_state_bias(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """Refused readings that agree: the state is opened to them, or the sensor gets a constant."""
    if channel.sensor.observes in sensor_bias.JUDGED and (yield from _agreed(filter, channel, reading.time_s)):
        return True
    return None


def _state_contradicted(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """All sensors contradict the state: it is given up."""
    channels, time_s = filter.channels.values(), reading.time_s
    if not innovation_gate.state_contradicted(channels, time_s, filter.inertial):
        return None
    yield Inflate(range(9), range(9), innovation_gate.reset_variance(channels, time_s))
    drive = filter.layout.drive
    yield Inflate(drive.slice, drive.slice, drive.P0)
    for other in channels:
        kept = other.faults
        if other.offset:  # what a sensor was thought to be off by was told by the state
            places = sensor_bias.offset_places(other)
            yield Inflate(places, places, other.group.P0[other.offsets, other.offsets])
        own = np.array([state for state, _ in descriptions(other.sensor.models, other.period_s)], dtype=np.int64)
        yield Inflate(other.group.start + own, other.group.start + own, other.group.P0[own, own])
        if not math.isnan(kept.rejected_since_s):
            _follows(other, time_s)
        kept.rejected_since_s, kept.agreed_s, kept.refused = math.nan, math.nan, None
    yield Count("opened")
    return False


def _reopen_known_fault(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A sensor that has a constant already: after its time-out it is opened again."""
    if not channel.offset or channel.sensor.observes not in sensor_bias.JUDGED:
        return None
    overdue = reading.time_s - channel.faults.rejected_since_s >= channel.sensor.gate_timeout_s
    if channel.faults.aside is None and overdue:
        yield from _jumped(filter, channel, reading.time_s)
    return False


def _widened_gate(filter: FilterState, channel: Channel, reading: Rejected) -> Actions:
    """A gate that has refused for its time-out doubles, and again; where it may be depth or height, both are opened."""
    P, time_s = filter.memory.P, reading.time_s
    unseen = filter.vehicle.drive.gap_force_sd if filter.inertial else 0.0  # type: ignore[attr-defined]
    added = innovation_gate.widening(P, channel, time_s, reading.nis, reading.dof, unseen)
    if added is None or sensor_bias.disproved(channel, time_s):
        return False
    if channel.sensor.observes is Observable.HEIGHT:
        yield from depth_fault.open_mounting(filter, channel)
    if depth_fault.undecided(filter, channel, time_s):
        yield from depth_fault.open_both(filter, channel, time_s)
        return False
    refused = channel.faults.refused
    if refused is not None and (refused.odd or refused.count == 1) and _held(filter, channel, time_s):
        # they contradict each other: the state need not be what is wrong
        channel.R += reading.nis * channel.S[: channel.axes]
        yield from _readmit(filter, channel, time_s)
        return True
    channel.R *= added.white_factor
    yield Inflate(added.places, added.places, added.covariance)
    if channel.moves:
        channel.faults.agreed_s = math.nan  # it is the state that was wrong: what it agrees with next is another
    _follows(channel, time_s)
    yield from alternative_path.followed(filter, channel)
    yield from _readmit(filter, channel, time_s)
    return True


def _held(filter: FilterState, fixes: Channel, time_s: float) -> bool:
    """Whether it is fixes that are refused, and a velocity holds the state meanwhile."""
    velocities = (c.memory.used_s for c in filter.channels.values() if c.sensor.observes.corrects == "velocity")
    held = time_s - max(velocities, default=-math.inf) < settings.RECENT_S
    return held and fixes.sensor.observes is Observable.FIX


def _agreed(filter: FilterState, channel: Channel, time_s: float) -> Actions:
    """What refused readings say together: True when the state was opened to them, and this one let in. A sensor that
    has jumped gets constants by its next reading (`Filter.jumped`).
    """
    memory, kept = filter.memory, channel.faults
    speed = math.sqrt(float(memory.nav[3:6].dot(memory.nav[3:6])))
    drive = filter.drive_output, filter.period_s
    course, back = (None, 0) if kept.refused is None else (kept.refused.course, kept.refused.back)
    kept.refused = refused = sensor_bias.add_rejection(channel, memory.P, speed, time_s, *drive)
    kept.refused_s = time_s
    if channel.sensor.observes is Observable.FIX:
        kept.refused = refused = replace(refused, course=_made(course, channel, time_s, memory.nav))
        if (yield from _heading_outvoted(filter, channel, refused, time_s)):
            return False
    if channel.offset:
        back = back + 1 if _is_back(filter, channel) else 0
        kept.refused = refused = replace(refused, back=back)
        if channel.faults.aside is not None and back < settings.RUN_LEAST:
            return False
    carried = channel.sensor.observes is not Observable.HEIGHT or depth_fault.are_told(filter, channel, time_s)
    wrong = sensor_bias.decided(channel, carried)
    if wrong == "sensor" or refused.back >= settings.RUN_LEAST:
        yield from _jumped(filter, channel, time_s)
        return False
    if wrong != "state" or channel.offset:
        return False
    moved_m = float(np.linalg.norm(filter.start.way_to(*memory.nav[:2].tolist())))
    for other in filter.channels.values():
        if sensor_bias.alike(other, channel):
            other.faults.agreed_s = math.nan
    yield Count("reset")
    told = math.sqrt(float(memory.P[8, 8]))
    held = any(
        other.sensor.observes.corrects == "depth"
        and other is not channel
        and time_s - other.memory.used_s < settings.SPAN_S
        for other in filter.channels.values()
    )
    yield Inflate(slice(9), slice(9), sensor_bias.opened_state(channel, refused, moved_m, held, carried))
    if sensor_bias.is_gauge(channel) and not carried:
        unit = filter.layout.drive
        own = np.concatenate(unit.biases[3:])
        yield Inflate(unit.start + own, unit.start + own, unit.P0[own, own])
    north = channel.sensor.observes.north
    if north is not None:
        angle, variance = refused.offset[north], refused.variance[north] + channel.slow[north]
        most = abs(angle) + IN_LINE * told
        kept.alone = (most, float(memory.nav[0]), float(memory.nav[1]))
        filter.monitor.changes.append(Change(channel.name, channel.sensor.models, offsets=True, turn=(angle, variance)))
        return False
    yield from alternative_path.followed(filter, channel)
    _follows(channel, time_s)
    velocity = dead_reckoning_compass.opened_velocity(filter, reckoned_since(channel, refused, speed), speed)
    filter.monitor.changes += [] if velocity is None else [velocity]
    yield Count("jumped", velocity is not None)
    yield from _readmit(filter, channel, time_s)
    return True


def _is_back(filter: FilterState, channel: Channel) -> bool:
    """Whether a reading beside the constants of its sensor agrees with the state without them."""
    memory, kept = filter.memory, channel.faults.aside
    constant = channel.jumped_by(memory.x)
    if kept is not None and not velocity_fault.shows_itself(
        kept, math.hypot(*memory.nav[3:6].tolist()), channel.res + constant
    ):
        return False
    return sensor_bias.is_back(channel, constant, memory.P)


def _made(course: TrackRotationFit | None, fixes: Channel, time_s: float, nav: Array) -> TrackRotationFit | None:
    """The way made good, with one more refused fix."""
    if not np.isfinite(fixes.res[:2]).all():
        return course
    return (course or TrackRotationFit(float(nav[0]), float(nav[1]), time_s)).and_then(time_s, nav, fixes.res)


def _heading_outvoted(filter: FilterState, fixes: Channel, refused: RejectionRun, time_s: float) -> Actions:
    """Whether fixes and velocity together contradict the compass: then the position is opened to the next fix, and
    before that the heading is turned (`take_up`), and the fixes' slow error, which has followed it, begins afresh.
    """
    memory = filter.memory
    change = None if refused.course is None else against_the_compass(filter, fixes, refused.course, time_s)
    if change is None or change.turn is None:
        return False
    yield Inflate(range(3), range(3), np.nan_to_num(fixes.res[:3]) ** 2)
    if change.sensor != fixes.name:
        filter.channels[change.sensor].faults.course = told_here(fixes, memory.nav, change.turn[1])
        filter.monitor.changes.append(Change(fixes.name, fixes.sensor.models, afresh=True))
    filter.monitor.changes.append(change)
    yield Count("reset")
    yield Count("jumped")
    return True


def _gone_astray(filter: FilterState, channel: Channel) -> Iterator[Action]:
    """Begin the slow error of a sensor afresh, and carry as variance what it may have done to the position. Where dead
    reckoning errs rather, its velocity gets a constant.
    """
    memory, kept = filter.memory, channel.faults
    speed = math.hypot(*memory.nav[3:6].tolist())
    velocity = dead_reckoning_compass.opened_velocity(filter, reckoned_wrongly(channel, speed), speed)
    off = pulled(channel, memory.x) if velocity is None else np.abs(channel.coloured_error(memory.x))
    yield Inflate(range(3), range(3), off**2)
    kept.refused, kept.astray_m = None, 0.0 if velocity is None else math.nan
    filter.monitor.changes.append(Change(channel.name, channel.sensor.models, afresh=True))
    filter.monitor.changes += [] if velocity is None else [velocity]
    yield Count("astray" if velocity is None else "jumped")


def pending(filter: FilterState) -> Iterator[Action]:
    """Do what refused readings have made necessary, before the next input."""
    if filter.monitor.is_tilted:
        filter.monitor.is_tilted = False
        yield from realignment.set_anew(filter)
    while filter.monitor.changes:
        change = filter.monitor.changes.pop(0)
        if change.sensor not in filter.channels:
            yield from dead_reckoning_compass.take_up(filter, change)
            continue
        channel = filter.channels[change.sensor]
        channel.faults.refused = None
        had = channel.offset
        if change.afresh or change.error is not channel.sensor.models:
            yield Adopt(change)
        if channel.ground and channel.offset and not had and math.isnan(channel.faults.rejected_since_s):
            yield from has_led(filter, channel)
        if change.turn is not None and channel.sensor.observes.north is None:
            yield from turned_by_fixes(filter, *change.turn)
        elif change.turn is not None:
            yield from turned(filter, channel, *change.turn)


def _jumped(filter: FilterState, channel: Channel, time_s: float) -> Iterator[Action]:
    """Give a sensor constants of the size of its jump; open those that it has, or take them where it is back. Of a
    velocity that has jumped by about itself only what reads the same is used from now on.
    """
    memory, kept = filter.memory, channel.faults
    refused = kept.refused
    assert refused is not None
    may_be = depth_fault.undecided if channel.offset else depth_fault.may_be_right
    if sensor_bias.is_gauge(channel) and refused.back < settings.RUN_LEAST and may_be(filter, channel, time_s):
        yield from depth_fault.open_both(filter, channel, time_s)
        return
    kept.either, kept.odds = False, 0.0
    size = float(np.nanmax(np.abs(refused.offset), initial=0.0))
    models, places = channel.sensor.models, sensor_bias.offset_places(channel)
    kept.aside = (
        None if refused.back >= settings.RUN_LEAST else velocity_fault.jumped(filter, channel, np.array(refused.offset))
    )
    if kept.aside is not None:
        yield Inflate(places, places, size**2)
        opened = with_offsets(models, size, density=kept.aside.density, only=channel.sensor.jumps)
        filter.monitor.changes.append(Change(channel.name, opened, offsets=True))
    elif refused.back >= settings.RUN_LEAST or not len(places):
        back, speed = len(places) > 0, math.hypot(*memory.nav[3:6].tolist())
        moving = channel.sensor.observes is Observable.VELOCITY_BODY and speed > settings.SLOW
        only, deviates = channel.sensor.jumps, channel.sensor.observes.north is not None
        opened = with_offsets(models, 0.0 if back else size, speed if moving else 0.0, only=only, deviates=deviates)
        filter.monitor.changes.append(Change(channel.name, opened, offsets=True))
    else:
        yield Inflate(places, places, size**2)
        kept.refused = None
    filter.monitor.begin_again(filter, memory.monitor)  # what innovations have told of others this explains, too
    kept.rejected_since_s = kept.disputed_s = kept.jumped_s = time_s
    kept.course = kept.course if refused.back < settings.RUN_LEAST else ()
    if kept.way is not None and refused.back >= settings.RUN_LEAST:
        kept.way = replace(kept.way, north=0.0, east=0.0)
    yield Count("jumped")


def used(filter: FilterState, channel: Channel, time_s: float) -> None:
    """Note that a reading of this time has been used, and take constants of its sensor away where it turns out to have
    none.
    """
    heading_fault.note_heading_used(filter, channel, time_s)
    if channel.faults.tells:
        filter.monitor.changes += dead_reckoning_compass.come_back(filter)
    if not channel.offset:
        return
    heading_fault.drop_contradicted_offset(filter, channel, time_s)
    kept, memory = channel.faults, filter.memory
    settled = (
        time_s - kept.jumped_s >= settings.SPAN_S
        and channel.faults.aside is None
        and channel.name not in _waiting(filter)
    )
    if settled and sensor_bias.is_none(channel, memory.x, memory.P, time_s):
        kept.either, kept.odds = False, 0.0
        filter.monitor.changes.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))


def errs(filter: FilterState, channel: Channel, size: float, since_s: float) -> Iterator[Action]:
    """It was a velocity that erred, and not the unit: what it is off by now has grown from nothing.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Of that velocity; its memory takes note.
    size, since_s : float
        By how much [m/s], and since when [s].
    """
    kept, memory = channel.faults, filter.memory
    density = size / max(memory.time_s - since_s, channel.period_s)
    speed = max(math.hypot(*memory.nav[3:6].tolist()), settings.SLOW)
    kept.refused, kept.aside, kept.jumped_s = None, None, memory.time_s
    kept.rejected_since_s, kept.odds = math.nan, BELIEVED + GONE
    kept.gone = np.zeros((0, 4))
    models = with_offsets(channel.sensor.models, size, speed, density=density)
    yield Adopt(Change(channel.name, models, offsets=True))
    yield Count("jumped")


def _waiting(filter: FilterState) -> list[str]:
    return [change.sensor for change in filter.monitor.changes]


def _follows(channel: Channel, time_s: float) -> None:
    """Remember that the state is set to fixes against what was believed before: they may be what was wrong."""
    if channel.sensor.observes is Observable.FIX:
        before_m, before_s = channel.faults.beat or (0.0, -math.inf)
        off_m = math.hypot(*np.nan_to_num(channel.res[:2]).tolist())
        channel.faults.beat = max(off_m, before_m if time_s - before_s < settings.FOLLOWED_S else 0.0), float(time_s)


def _readmit(filter: FilterState, channel: Channel, time_s: float) -> Iterator[Action]:
    """Correct by the reading that was refused, now that the covariance lets it in."""
    fault_bank.note_jump(filter, channel, time_s)
    yield Readmit(channel, innovation_gate.whole_residual(channel, filter.memory.x))
    channel.use(time_s)
    yield Count("widened")


#: What is asked of a reading that its gate has refused, in this order.
REJECTED = (
    _frozen_or_worthless,
    _fix_out_of_reach,
    _note_alternative_path,
    _unit_blamed,
    _tilt,
    _dead_reckoning_compass,
    _implausible_bias,
    _within_dead_reckoning,
    _sensor_or_state_bias,
    _state_contradicted,
    _reopen_known_fault,
    _widened_gate,
)

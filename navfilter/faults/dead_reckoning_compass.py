"""Fixes against dead reckoning without an inertial unit: what drives has a compass, and no other sensor holds it.

A compass that is turned by 180 degrees takes such a vehicle the other way, and fixes that are refused, believed and
refused again are all that says so. Their way is held against the one that the drive's own readings have made, whatever
the fixes have corrected meanwhile: where the one is the other, turned (`navfilter.faults.heading_fault`), the compass
gets a constant of that angle, and the position is opened to the next fix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.faults.heading_fault import TrackRotationFit, direction, of_one_way, rather_drawn, seen_turned
from navfilter.faults.sensor_bias import rather_none
from navfilter.filter.actions import Action, Adopt, Count, Fold, Inflate, MoveError, Transform
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import strapdown
from navfilter.kernels.fault_bank import GONE
from navfilter.models.error_models import ErrorModel
from navfilter.models.fault_bias import has_offset, offset_states, with_offsets
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.velocity import FLOWS_M_S

Array = NDArray[np.float64]
#: Of the drive's three angles.
YAW = 2


@dataclass(frozen=True)
class DeadReckoningComparison:
    """Refused fixes, and the way that the drive has made between them.

    Attributes
    ----------
    course : TrackRotationFit
    latitude, longitude : float
        Of the first fix [rad].
    north, east : float
        Way made until then [m].
    last_s : float
        Time of the last one [s].
    """

    course: TrackRotationFit
    latitude: float
    longitude: float
    north: float
    east: float
    last_s: float


def replace_compass(filter: FilterState, fixes: Channel, time_s: float) -> Actions:
    """What is to be done about the drive's compass when fixes have refused a reading: another error model of it, with
    a turn; None while nothing is to be done.

    Parameters
    ----------
    filter : FilterState
        Its memory of these fixes goes on.
    fixes : Channel
        As the refused reading left it.
    time_s : float
        Of the reading [s].
    """
    memory, kept = filter.memory, fixes.faults
    if filter.inertial or not np.isfinite(fixes.res[:2]).all():
        return None
    nav, since_s = memory.nav, memory.time_s - memory.sample_s
    way = memory.drv[strapdown.WAY : strapdown.WAY + 2] + since_s * nav[3:5]
    latitude = float(nav[0] + fixes.res[0] / nav[15])
    longitude = float(nav[1] + fixes.res[1] / (nav[16] * math.cos(nav[0])))
    before = kept.reckoned
    if before is None or time_s - before.last_s > settings.APART_S:
        before = _from_here(latitude, longitude, way, time_s)
    made = way - (before.north, before.east)
    fixed = np.array([(latitude - before.latitude) * nav[15], 0.0])
    fixed[1] = (longitude - before.longitude) * nav[16] * math.cos(before.latitude)
    course = before.course.plus(time_s, made, fixed - made)
    kept.reckoned = DeadReckoningComparison(course, *_begin(before), time_s)
    # what draws a way through water off is its current, as far as water flows
    water = bool(filter.in_force.drive.wandering()) and course.drawn_m_s() < FLOWS_M_S
    drawn = (lambda angle, speed: True) if water else rather_drawn
    wanders, constant = float(memory.drv[strapdown.SPREAD + YAW]) ** 2, float(memory.P[8, 8])
    flows, across = _flows(memory), max(0.0, direction(filter) - constant)
    share = _faster(memory) + wanders + flows
    turn = seen_turned(course, fixes, wanders, drawn, share, constant + across)
    if turn is None:
        if not of_one_way(course, fixes, drawn, share):
            kept.reckoned = _from_here(latitude, longitude, way, time_s)
        return None
    turn, kept.reckoned = (turn[0], turn[1] + flows + across), None
    yield Inflate(range(3), range(3), np.nan_to_num(fixes.res[:3]) ** 2)
    yield Count("reset")
    yield Count("jumped")
    return Change("attitude", _with_constants(filter, 0, math.sqrt(turn[1])), offsets=True, turn=turn)


def _from_here(latitude: float, longitude: float, way: Array, time_s: float) -> DeadReckoningComparison:
    """Nothing but a first fix, at this place [rad] and after this way [m]."""
    return DeadReckoningComparison(
        TrackRotationFit(0.0, 0.0, time_s), latitude, longitude, float(way[0]), float(way[1]), time_s
    )


def _flows(memory: FilterMemory) -> float:
    """Square of the current, as a share of that of the speed: beside a wrong heading it has been estimated wrongly."""
    place, v = int(memory.drv[strapdown.CURRENT]), memory.nav[3:5]
    current = memory.x[place : place + 2] if place >= 0 else np.zeros(2)
    return float(current @ current) / max(float(v @ v), settings.SLOW**2)


def _faster(memory: FilterMemory) -> float:
    """Variance of the speed, as a share of its square."""
    v = memory.nav[3:5]
    return float(v @ memory.P[3:5, 3:5] @ v) / max(float(v @ v), settings.SLOW**2) ** 2


def _begin(before: DeadReckoningComparison) -> tuple[float, float, float, float]:
    return before.latitude, before.longitude, before.north, before.east


def _attitude(filter: FilterState) -> tuple[ErrorModel, ...]:
    return filter.in_force.drive.models[:3]


def opened_velocity(filter: FilterState, size: float, speed: float) -> Change | None:
    """Another error model of the velocity that dead reckoning goes by, with a constant of this sd beside it [m/s]; None
    where there is none to be opened, or it has one.

    Parameters
    ----------
    filter : FilterState
    size, speed : float
        0: nothing is to be opened [m/s]; speed of the vehicle [m/s].
    """
    if not size:
        return None
    if not filter.inertial:
        models = filter.in_force.drive.models[3:]
        return None if has_offset(models) else Change("velocity", with_offsets(models, size), offsets=True)
    now_s = filter.memory.time_s
    for channel in filter.channels.values():
        used = now_s - channel.memory.used_s < settings.RECENT_S and channel.sensor.observes.corrects == "velocity"
        if used and channel.ground and not channel.sensor.flows_m_s and not channel.offset:
            return Change(channel.name, with_offsets(channel.sensor.models, size, speed), offsets=True)
    return None


def heed_jump(filter: FilterState) -> Iterator[Action]:
    """What dead reckoning goes by has jumped as no vehicle moves, and stays there."""
    memory = filter.memory
    angle, *change = memory.drv[strapdown.JUMPED : strapdown.JUMPED + 4].tolist()
    memory.drv[strapdown.JUMPED : strapdown.JUMPED + 4] = 0.0
    yield Fold()
    if angle:
        yield from _jumped(filter, 0, np.array([0.0, 0.0, angle]), strapdown.SCATTER_RAD)
    if any(change):
        yield from _jumped(filter, 1, np.array(change), strapdown.SCATTER_M_S)


def _jumped(filter: FilterState, which: int, by: Array, scatter: float) -> Iterator[Action]:
    """Give the heading, or the velocity, constants. They take the jump, which may come to anything between none and
    twice as much. Where sensors contradicted it, or nothing had been heard of it for long, it has come back rather; one
    that had jumped already is off by no more than what is left.

    Parameters
    ----------
    filter : FilterState
    which : int
        0: attitude, 1: velocity.
    by : ndarray, shape (3,)
        The jump [rad], [m/s].
    scatter : float
        What is no larger is none.
    """
    memory, own = filter.memory, slice(3 * which, 3 * which + 3)
    name, had = ("attitude", "velocity")[which], has_offset(filter.in_force.drive.models[own])
    disputed = any(not math.isnan(channel.faults.rejected_since_s) for channel in filter.channels.values())
    yield Count("jumped")
    left = by.copy()
    if had:
        axes, places = _constants(filter, own)
        left[axes] += memory.x[places]
        yield Adopt(Change(name, _with_constants(filter, which, 0.0), offsets=True))
    size = float(np.abs(left).max())
    away = size > scatter if had else not disputed and memory.time_s - filter.start.time_s >= settings.CONFIRMED_S
    _note_away(filter, which, away)
    if away:
        yield Adopt(Change(name, _with_constants(filter, which, size / math.sqrt(3.0)), offsets=True))
        # it has been held since the first of the samples that say so
        speed = size if which else size * math.hypot(*memory.nav[3:5].tolist())
        yield Inflate(range(2), range(2), (speed * strapdown.MOST_ODD * filter.period_s) ** 2 / 3.0)
    if away and not had:
        axes, places = _constants(filter, own)
        for place, jump in zip(places, by[axes].tolist(), strict=True):
            yield MoveError(place, jump)


def _note_away(filter: FilterState, which: int, away: bool) -> None:
    """Note whether attitude or velocity have jumped, and not back: then fixes are asked."""
    drv = filter.memory.drv
    drv[strapdown.AWAY + which] = float(away)
    for channel in filter.channels.values():
        told = channel.sensor.observes is Observable.FIX
        channel.faults.tells = told and bool(drv[strapdown.AWAY : strapdown.AWAY + 2].any())


def come_back(filter: FilterState) -> list[Change]:
    """Error models without the constants of what has jumped, where a fix that has just been used tells that there are
    none (as `navfilter.faults.sensor_bias.is_none`).
    """
    memory, drive, found = filter.memory, filter.layout.drive, []
    for which, name in enumerate(("attitude", "velocity")):
        if memory.drv[strapdown.AWAY + which]:
            places = np.array(_constants(filter, slice(3 * which, 3 * which + 3))[1])
            sds, P = np.sqrt(np.diag(drive.P0)[places]), memory.P[np.ix_(9 + places, 9 + places)]
            gained = rather_none(memory.x[places], P, sds)[0]
            if (gained > 0.0).all() and gained.max() > GONE:
                _note_away(filter, which, False)
                found.append(Change(name, _with_constants(filter, which, 0.0), offsets=True))
    return found


def _constants(filter: FilterState, own: slice) -> tuple[list[int], list[int]]:
    """Axes of attitude or velocity that have a constant, and where these stand among the error states."""
    models, period_s = filter.in_force.drive.models, filter.period_s
    first = sum(model.block(period_s).size for model in models[: own.start])
    found = [(axis, offset_states(models[own], period_s, axis)) for axis in range(3)]
    return [axis for axis, at in found if len(at)], [first + int(at[0]) for _, at in found if len(at)]


def _with_constants(filter: FilterState, which: int, size: float) -> ErrorModel | tuple[ErrorModel, ...]:
    """Error models of the heading with attitude (0), or of the velocity (1), with constants of this sd, or without."""
    drive = filter.in_force.drive
    if which:
        return with_offsets(drive.models[3:], size)
    if drive.compass is not None:
        return with_offsets(drive.compass.models, size)[0]
    return *drive.models[:YAW], *with_offsets(drive.models[YAW : YAW + 1], size)


def take_up(filter: FilterState, change: Change) -> Iterator[Action]:
    """Put another error model of what drives in force. A turn: what its compass reads is turned by an angle of this
    variance, beside its constant.

    Parameters
    ----------
    filter : FilterState
        Nothing waits to be folded in.
    change : Change
        By `replace_compass` or `opened_velocity`.
    """
    if change.turn is None:
        yield Adopt(change)
        return
    angle, variance = change.turn
    had = has_offset(_attitude(filter)[YAW])
    if not had:
        yield Adopt(change)
    memory, size = filter.memory, filter.layout.size
    place = _constants(filter, slice(0, 3))[1][-1]
    yield MoveError(place, -angle)
    N = np.zeros((size, size))
    N[9 + place, 9 + place] = variance if had else 0.0
    yield Transform(memory.nav[3:6].copy(), memory.nav[6:15].reshape(3, 3).copy(), np.eye(size), N)

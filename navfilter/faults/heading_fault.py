"""Fixes and a velocity sensor together against one compass.

Fixes that are refused on end have made a way, and so has dead reckoning between them. Where the one is the other,
turned by an angle, the heading was wrong by that angle: no receiver errs so, and a velocity sensor has no say in the
direction of north. Where it is the other with a constant velocity added, the fixes are being drawn off, or there is a
current that nobody measures. On a straight way the two look the same. Then it is a matter of who else has confirmed
the heading: a compass that is the only one to have said it is outvoted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, Transform, TurnHeading
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.models.fault_bias import SCALE, with_offsets
from navfilter.models.sensors.observable import Observable
from navfilter.models.state import rotation_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackRotationFit:
    """Refused fixes and the places reckoned meanwhile.

    Attributes
    ----------
    latitude, longitude : float
        Of the first place reckoned [rad].
    began_s : float
        Time of the first fix [s].
    count : int
        Fixes.
    sums : tuple of float
        Of place reckoned (north, east), residual of the fix (north, east) and time since the first, then of all
        products of two of them [m, s].
    """

    latitude: float
    longitude: float
    began_s: float
    count: int = 0
    sums: tuple[float, ...] = (0.0,) * 30

    def and_then(self, time_s: float, nav: Array, residual: Array) -> TrackRotationFit:
        """With one more fix: its time, nominal state (17,), residual in n [m]."""
        north = (nav[0] - self.latitude) * nav[15]
        east = (nav[1] - self.longitude) * nav[16] * math.cos(self.latitude)
        return self.plus(time_s, (north, east), residual)

    def plus(self, time_s: float, place: Array | tuple[float, float], residual: Array) -> TrackRotationFit:
        """With one more fix: its time, the place reckoned, north and east of the first [m], residual in n [m]."""
        row = [*map(float, (*place, *residual[:2], time_s - self.began_s))]
        new = zip(self.sums, (*row, *(one * other for one in row for other in row)), strict=True)
        sums = tuple(before + added for before, added in new)
        return TrackRotationFit(self.latitude, self.longitude, self.began_s, self.count + 1, sums)

    def drawn_m_s(self) -> float:
        """Speed at which the fixes go away from the way reckoned, by the straight line through that [m/s]."""
        sums = np.array(self.sums) / self.count
        S = sums[5:].reshape(5, 5) - np.outer(sums[:5], sums[:5])
        return math.hypot(S[4, 2], S[4, 3]) / max(float(S[4, 4]), 1e-300)

    def fitted(self) -> tuple[float, float, float, float, float]:
        """Angle by which the way of the fixes is turned against the one reckoned [rad], mean square of the latter about
        its middle [m^2], ratio of their sizes, mean square distances of the fixes from the way turned by that angle,
        and from the way that is drawn off by a constant velocity [m^2].
        """
        sums = np.array(self.sums) / self.count
        S = sums[5:].reshape(5, 5) - np.outer(sums[:5], sums[:5])
        size, along, across, off = S[0, 0] + S[1, 1], S[0, 2] + S[1, 3], S[0, 3] - S[1, 2], S[2, 2] + S[3, 3]
        fixes = size + 2.0 * along + off
        common = math.hypot(size + along, across)
        drawn = off - (S[4, 2] ** 2 + S[4, 3] ** 2) / max(S[4, 4], 1e-300)
        ratio = math.sqrt(max(fixes, 0.0) / max(size, 1e-300))
        return math.atan2(across, size + along), size, ratio, fixes + size - 2.0 * common, drawn


def against_the_compass(filter: FilterState, fixes: Channel, course: TrackRotationFit, time_s: float) -> Change | None:
    """What is to be done about the compass, where refused fixes and a velocity sensor contradict it; else None.

    Parameters
    ----------
    filter : FilterState
        Is only read.
    fixes : Channel
        The channel that refuses them.
    course : TrackRotationFit
    time_s : float
        Now [s].
    """
    channels = filter.channels.values()
    recent = [c for c in channels if time_s - c.memory.used_s < settings.RECENT_S]
    compasses = [c for c in recent if c.sensor.observes.corrects == "heading"]
    moving = any(_reckons(c) for c in recent)
    if course.count < 3 or not moving or len(compasses) > 1:
        return None
    if not compasses:  # the gyros alone have led the heading: what it may be off by is part of the angle
        heading, going = float(filter.memory.P[8, 8]), direction(filter)
        turn = seen_turned(course, fixes, max(0.0, going - heading), rather_drawn, heading=heading)
        return turn and Change(fixes.name, fixes.sensor.models, afresh=True, turn=turn)
    compass = compasses[0]
    if compass.sensor.observes.north is None:
        return None
    told = math.radians(filter.start.heading_sd_deg)
    believed = lambda angle, speed: not compass.faults.alone and abs(angle) > settings.SURE * told  # noqa: E731
    turn = seen_turned(course, fixes, direction(filter), believed)
    if turn is None:
        return None
    models = compass.sensor.models
    if not compass.offset:
        models = with_offsets(models, abs(turn[0]), only=compass.sensor.observes.north, deviates=True)
    return Change(compass.name, models, offsets=True, turn=turn)


def seen_turned(
    course: TrackRotationFit,
    fixes: Channel,
    direction: float,
    believed: Callable[[float, float], bool],
    share: float = 0.0,
    heading: float = 0.0,
) -> tuple[float, float] | None:
    """By what angle fixes have made the way reckoned, turned, and its variance [rad, rad^2]; None where they have not,
    or as well may be drawn off by a constant velocity.

    Parameters
    ----------
    course : TrackRotationFit
    fixes : Channel
        The channel that refuses them.
    direction : float
        Variance of the direction of the way reckoned, which is left beside the angle [rad^2].
    believed : callable
        Whether a heading that is off by this angle [rad], and a speed by so many standard deviations, are believed
        rather than fixes that are drawn off.
    share : float
        Variance of what the way reckoned errs by beside a turn of the whole, as a share of its square [1].
    heading : float
        Variance of a constant of the compass, which is part of the angle [rad^2].
    """
    if course.count < 3:
        return None
    angle, size, ratio, beside_turned, beside_drawn = course.fitted()
    noise = _noise(fixes)
    # what wanders over the time of the fixes tilts a straight way by its difference between the ends: sqrt(2) of its sd
    # over sqrt(12) of the root mean square distance from the middle
    variance = noise / (6.0 * max(size, 1e-300))
    sd, faster = math.sqrt(variance + direction), math.sqrt(variance + share)
    chance = math.sqrt(variance + direction + heading)
    if (
        sd > settings.KNOWN_RAD
        or abs(angle) < settings.SURE * chance
        or abs(ratio - 1.0) > settings.SURE * faster + SCALE
    ):
        return None
    speed, noise = max(0.0, abs(ratio - 1.0) - SCALE) / faster, noise + share * size
    if beside_turned > settings.FITS**2 * noise or (
        believed(angle, speed) and beside_drawn < settings.MISSES**2 * noise
    ):
        return None
    return angle, variance + direction


def rather_drawn(angle: float, speed: float) -> bool:
    """Whether fixes are rather drawn off than a heading is turned by an angle, and a speed off by so many sd."""
    return abs(angle) < settings.DRAWN_RAD or speed > settings.SAME_SPEED


def of_one_way(
    course: TrackRotationFit, fixes: Channel, believed: Callable[[float, float], bool], share: float
) -> bool:
    """Whether fixes may have made the way reckoned, turned by one angle, or drawn off at one velocity where that is
    rather believed: else what is wrong has become another meanwhile, as that of a compass which follows no turn does.
    `believed` and `share` as in `seen_turned`.
    """
    if course.count < 3:
        return True
    angle, size, _, turned, drawn = course.fitted()
    noise = _noise(fixes) + share * size
    return turned < settings.FITS**2 * noise or (believed(angle, 0.0) and drawn < settings.MISSES**2 * noise)


def _reckons(channel: Channel) -> bool:
    """Whether a sensor tells the way made, if the heading is known."""
    kind = channel.sensor.observes
    return kind.corrects == "velocity" and (channel.ground > 0 or kind is Observable.VELOCITY_BODY)


def direction(filter: FilterState) -> float:
    """Variance of the direction that the vehicle is believed to go in [rad^2]: that of its heading, and of the velocity
    across its way where the heading is right, as in a current that is hardly known.
    """
    P, nav = filter.memory.P, filter.memory.nav
    speed = max(math.hypot(nav[3], nav[4]), 1e-3)
    across = np.zeros(9)
    across[[3, 4]] = -nav[4] / speed, nav[3] / speed
    seen = P[:9, :9] @ across
    beside = max(0.0, float(across @ seen) - float(seen[8]) ** 2 / float(P[8, 8]))
    return float(P[8, 8]) + beside / speed**2


def _noise(fixes: Channel) -> float:
    """Variance of a fix in one direction [m^2]."""
    return float(np.max(np.diag(fixes.white)[:2] + np.array(fixes.slow)[:2]))


def told_here(fixes: Channel, nav: Array, variance: float) -> tuple[float, ...]:
    """What is to be remembered of a heading that fixes have told to this variance [rad^2], see `SensorFaults.course`.
    The last of them has just been refused at the nominal state nav (17,).
    """
    north, east = np.nan_to_num(fixes.res[:2]).tolist()
    latitude, longitude = nav[:2].tolist()
    place = latitude + north / float(nav[15]), longitude + east / (float(nav[16]) * math.cos(latitude))
    return (variance, _noise(fixes), *place)


def note_heading_used(filter: FilterState, channel: Channel, time_s: float) -> None:
    """Note that a reading of this time has been used."""
    kept, partly_since_s = channel.faults, channel.faults.partly_since_s
    channel.use(time_s)
    if channel.partly_for_s < math.inf and channel.verdict[1] < np.isfinite(channel.note[3 : 3 + channel.axes]).sum():
        kept.partly_since_s = time_s if math.isnan(partly_since_s) else partly_since_s
    if channel.faults.alone and _confirmed(filter, channel):
        channel.faults.alone = ()


def _confirmed(filter: FilterState, compass: Channel) -> bool:
    """Whether fixes have confirmed a compass to which the heading was set against what was believed before: they are
    used, twice as far from there as they need to contradict it. Without a velocity over ground in b they say nothing of
    the heading.
    """
    now_s, far_m = filter.memory.time_s, led_astray(compass, filter.memory.nav)
    recent = [c for c in filter.channels.values() if now_s - c.memory.used_s < settings.RECENT_S]
    if filter.inertial and not any(_reckons(c) for c in recent):
        return False
    for fixes in filter.channels.values():
        kept = fixes.faults
        calm = kept.refused is None and not kept.astray and now_s - fixes.memory.used_s < settings.RECENT_S
        if fixes.sensor.observes.corrects == "position" and fixes.axes > 1 and calm:  # a range or a depth is no place
            sd = math.sqrt(fixes.white[0, 0] + fixes.slow[0])
            if far_m > 2.0 * settings.SURE * math.sqrt(2.0) * sd:
                return True
    return False


def led_astray(compass: Channel, nav: Array) -> float:
    """How far a compass to which the heading was set against what was believed before, and that nothing has confirmed
    since, may have led the vehicle from its way [m].

    Parameters
    ----------
    compass : Channel
    nav : ndarray, shape (17,)
        Nominal state.
    """
    if not compass.faults.alone:
        return 0.0
    angle, latitude, longitude = compass.faults.alone
    north = (nav[0] - latitude) * nav[15]
    east = (nav[1] - longitude) * nav[16] * math.cos(latitude)
    return math.hypot(north, east) * 2.0 * math.sin(0.5 * min(angle, math.pi))


def told_by_fixes(compass: Channel, nav: Array, latitude: float, longitude: float) -> float:
    """Variance to which fixes alone can tell the heading since they have contradicted a compass [rad^2]; 0 where they
    have not.

    What wanders between two fixes turns the way from one to the other by the square root of two of its sd over their
    distance. A velocity in b beside a heading that is known to some degrees only seems to tell more than that: it is
    linearised at headings that differ (Huang et al., Int. J. Robotics Res. 29, 2010, of the same in mapping).

    Parameters
    ----------
    compass : Channel
    nav : ndarray, shape (17,)
        Nominal state.
    latitude, longitude : float
        Where a fix was used last [rad].
    """
    if len(compass.faults.course) != 4 or not compass.offset:
        return 0.0
    variance, noise, *there = compass.faults.course
    north, east = (latitude - there[0]) * float(nav[15]), (longitude - there[1]) * float(nav[16]) * math.cos(latitude)
    return 1.0 / (1.0 / variance + (north**2 + east**2) / (2.0 * noise))


def turned(filter: FilterState, compass: Channel, angle: float, variance: float) -> Iterator[Action]:
    """Turn the heading by an angle of this variance, as by a reading of the compass; its memory takes note.

    Parameters
    ----------
    filter : FilterState
        Nothing waits to be folded in.
    compass : Channel
    angle, variance : float
        [rad], [rad^2]
    """
    yield TurnHeading(compass, angle, variance)
    kept = compass.faults
    kept.agreed_s, kept.refused, kept.rejected_since_s = math.nan, None, math.nan
    if compass.offset:
        kept.alone = ()  # it no longer says which way north is


def turned_by_fixes(filter: FilterState, angle: float, variance: float) -> Iterator[Action]:
    """Turn the heading, and the velocity with it, by an angle of this variance that fixes alone have told, where no
    compass does.
    """
    nav, n = filter.memory.nav, len(filter.memory.P)
    R, M, along = rotation_matrix(np.array([0.0, 0.0, angle])), np.eye(n), np.zeros(n)
    velocity = R @ nav[3:6]
    M[3:6, 3:6] = M[6:9, 6:9] = R
    along[[3, 4, 8]] = -velocity[1], velocity[0], 1.0
    yield Transform(velocity, R @ nav[6:15].reshape(3, 3), M, variance * np.outer(along, along))


# A compass that has jumped gets a constant and a deviation with the heading (`navfilter.models.fault_bias`), both open
# to anything: that is what iron does. The slope of the deviation is left out of its equation, so it tells the heading
# by the changes that it shows. Iron that takes half of these away, or adds as much, leaves no compass. One that is
# stuck near a value, or counts in another unit, follows no turn at all: a slope of -1 fits that, and it would tell that
# the vehicle does not turn, while the biases of the gyros take what it does.


def drop_contradicted_offset(filter: FilterState, channel: Channel, time_s: float) -> None:
    """After a reading of this time has been used: take the constants of a compass that does not follow the vehicle's
    turns away. Nothing that it reads is used then until it agrees without them.
    """
    kept = channel.faults
    if not channel.offset or channel.sensor.observes.north is None or time_s - kept.jumped_s < settings.SPAN_S:
        return
    slope, sd = _slope(filter, channel)
    if abs(slope) - settings.IRON_SURE * sd > settings.IRON_SLOPE:
        filter.monitor.changes.append(Change(channel.name, with_offsets(channel.sensor.models), offsets=True))
        # what it has read since it jumped was no heading; of one that went off slowly nobody knows when that was
        kept.rejected_since_s = kept.jumped_s if math.isfinite(kept.jumped_s) else time_s
        kept.refused, kept.disputed_s, kept.odds = None, time_s, 0.0


def _slope(filter: FilterState, compass: Channel) -> tuple[float, float]:
    """By how much what it is off by changes with the heading, and the standard deviation of that [1]; zeros where it
    has no deviation.
    """
    memory, (state, of_rad) = filter.memory, compass.deviations
    at = compass.group.start + state
    g = -np.sin(math.atan2(memory.nav[9], memory.nav[6]) - of_rad)
    return float(g @ memory.x[at - 9]), math.sqrt(max(float(g @ memory.P[np.ix_(at, at)] @ g), 0.0))

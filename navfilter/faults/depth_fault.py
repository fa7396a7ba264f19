"""A depth gauge that has left the state slowly: it has drifted, or what carries the height has.

One that leaves from one reading to the next has jumped, for no vehicle can (`navfilter.faults.sensor_bias`). A
difference that grows has no such owner: a gauge drifts, and a velocity whose mounting is off by a degree leads the
height off by as much in the same time. While a velocity goes on to say how the height changes, nobody can tell the two
apart. To set the state to the gauge, with the sd that one more of its readings leaves, is to claim that it was the
velocity. So both are opened, by all that lies between them: the height, and a constant of the gauge. What follows tells
them apart, fixes with a height above all; until then the sd is what is known, and the estimate lies between the two,
which is never wrong by more than either of them could be.

Nor has one that leaves at once always jumped: from a drift that velocity and height have followed a gauge comes back
so. Fixes tell the two apart, where they are precise enough at once, else while both are open.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navfilter.faults import settings
from navfilter.faults.sensor_bias import offset_places, was_right
from navfilter.filter.actions import Action, Count, Inflate
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.models.fault_bias import descriptions, offset_states, with_description, with_offsets
from navfilter.models.sensors.observable import Observable

#: Of the height among the navigation states.
DOWN = 2
#: Of a velocity, among the components of `navfilter.models.fault_bias.FaultDescription`: about its x and y axis.
MOUNTING = (4, 5)


def are_told(filter: FilterState, gauge: Channel, time_s: float) -> bool:
    """Whether more than accelerometers says how the height changes at this time [s]: a velocity, or fixes or another
    gauge that go on to be used.
    """
    used = (c.memory.used_s for c in filter.channels.values() if c.ground and c.faults.aside is None)
    carried = not filter.inertial or time_s - max(used, default=-np.inf) < settings.RECENT_S
    return carried or bool(_others(filter, gauge, time_s))


def _others(filter: FilterState, gauge: Channel, time_s: float) -> list[Channel]:
    """Fixes and other gauges that go on to tell the height; it is the last component of each."""
    return [
        other
        for other in filter.channels.values()
        if other is not gauge
        and other.sensor.observes in (Observable.FIX, Observable.HEIGHT)
        and np.isfinite(other.note[2 + other.axes])
        and time_s - other.memory.used_s < settings.SPAN_S
    ]


def may_be_right(filter: FilterState, gauge: Channel, time_s: float) -> bool:
    """Whether a gauge that has left the state at once may have come back to the truth, from where it had led the state
    astray: all that tell the height beside it fit where it is now, too.
    """
    others = _others(filter, gauge, time_s)
    wrong = float(gauge.res[0] / gauge.near[0, DOWN])
    squares = [
        (other.note[2 + other.axes] - other.near[-1, DOWN] * wrong) ** 2 / other.note[2 + 2 * other.axes]
        for other in others
    ]
    known = filter.memory.P[DOWN + 3, DOWN + 3] < settings.CARRIED_M_S**2
    return bool(others) and known and max(squares) <= float(gauge.limits[1])


def undecided(filter: FilterState, channel: Channel, time_s: float) -> bool:
    """Whether a sensor that is refused is a depth gauge that was right for long, and something else tells the height.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        As its refused reading left it.
    time_s : float
        Of the reading [s].
    """
    if channel.sensor.observes is not Observable.HEIGHT:
        return False
    if not filter.memory.P[DOWN + 3, DOWN + 3] < settings.CARRIED_M_S**2:
        return False
    if channel.faults.either:
        return True
    states = offset_states(channel.sensor.models, channel.period_s)
    if len(states):
        whole = float(channel.res[0] + channel.jumped_by(filter.memory.x)[0])
        if not whole**2 > settings.GROWN**2 * float(channel.group.P0[states, states].max()):
            return False
    return channel.faults.confirmed(channel.memory.used_s) and are_told(filter, channel, time_s)


def open_mounting(filter: FilterState, gauge: Channel) -> Iterator[Action]:
    """Make states of roll and pitch of the velocities that may lead the height away from a gauge, and open the velocity
    by what they have told of it. From one that was right for long, on a way, no mounting does: that would have shown.
    """
    if not filter.inertial or was_right(filter, gauge):
        return
    for channel in filter.channels.values():
        models, parameters = channel.sensor.models, channel.sensor.all_parameters()
        known = any(component in MOUNTING for _, component in descriptions(models, channel.period_s))
        known |= any(one.name in ("misalignment_x", "misalignment_y") and one.sd > 0.0 for one in parameters)
        if channel.moves and channel.ground and not known:
            opened = with_description(models, dict.fromkeys(MOUNTING, settings.ANGLE_SD))
            filter.monitor.changes.append(Change(channel.name, opened, offsets=True))
            nav = filter.memory.nav
            turned = settings.ANGLE_SD * np.cross(nav[6:15].reshape(3, 3)[:, :2].T, nav[3:6])
            yield Inflate(slice(3, 6), slice(3, 6), turned.T @ turned)
            yield Count("arm-or-clock")


def open_both(filter: FilterState, channel: Channel, time_s: float) -> Iterator[Action]:
    """Open the height, and give the gauge a constant, or open the one that it has, by all that lies between them.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Of the gauge, as its refused reading left it; its memory takes note.
    time_s : float
        Of the reading [s].
    """
    memory, kept = filter.memory, channel.faults
    P, places = memory.P, offset_places(channel)
    new = float(channel.res[0])
    whole = new + float(channel.jumped_by(memory.x)[0])
    # at least by what has come since they were opened last; beyond that only as far as they are not open any more
    yield Inflate(DOWN, DOWN, max(new**2, whole**2 - P[DOWN, DOWN]))
    if len(places):
        yield Inflate(places, places, np.maximum(new**2, whole**2 - P[places, places]))
        # what innovations seem to tell of other faults, this may have done
        filter.monitor.begin_again(filter, memory.monitor)
    else:
        models = with_offsets(channel.sensor.models, abs(new), only=channel.sensor.jumps)
        filter.monitor.changes.append(Change(channel.name, models, offsets=True))
    kept.either, kept.refused = True, None
    kept.rejected_since_s = kept.disputed_s = kept.jumped_s = time_s
    yield Count("jumped")

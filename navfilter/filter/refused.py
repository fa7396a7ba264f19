"""A reading that its gate has refused: what of the filter's memory changes because of it, and those before it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.filter import agreement, gating
from navfilter.filter.adoption import Change
from navfilter.filter.channel import Channel
from navfilter.filter.offsets import with_offsets
from navfilter.filter.refusals import LEAST
from navfilter.kernels import kalman, listen
from navfilter.state import NavState

if TYPE_CHECKING:
    from navfilter.filter.filter import Filter

__all__ = ["let_in"]

Array = NDArray[np.float64]
#: Below this speed a velocity that is off says nothing of its scale [m/s].
SLOW = 0.1


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
        kept.rejected_since_s = time_s
    if frozen:
        kept.refused = None
        return False
    if channel.sensor.open_loop != listen.NOTHING and _agreed(filter, channel, time_s):
        return True
    if gating.state_contradicted(filter.channels.values(), time_s):
        P[range(9), range(9)] += gating.reset_variance(filter.channels.values())
        drive = filter.layout.drive
        P[drive.slice, drive.slice] += drive.P0
        for other in filter.channels.values():
            other.memory.rejected_since_s, other.memory.agreed_s, other.memory.refused = math.nan, math.nan, None
        memory.counts["opened"] += 1
        return False
    if channel.offset:
        if time_s - kept.rejected_since_s >= channel.sensor.gate_timeout_s:
            _jumped(filter, channel, time_s)
        return False
    added = gating.widening(P, channel, time_s, nis, dof)
    if added is None:
        return False
    channel.R *= added.white_factor
    _update(filter, channel, time_s, added.covariance)
    return True


def _agreed(filter: Filter, channel: Channel, time_s: float) -> bool:
    """What refused readings say together: True when the state was opened to them, and this one let in. A sensor that
    has jumped gets constants by its next reading (`Filter.jumped`).
    """
    memory, kept = filter.memory, channel.memory
    speed = math.sqrt(float(memory.nav[3:6] @ memory.nav[3:6]))
    drive = filter.drive_output, filter.vehicle.drive.period_s
    kept.refused = refused = agreement.heard(channel, memory.P, speed, time_s, *drive)
    if channel.offset:
        back = refused.back + 1 if agreement.is_back(channel, memory.x, memory.P) else 0
        kept.refused = refused = replace(refused, back=back)
    wrong = agreement.decided(channel)
    if wrong == "sensor" or refused.back >= LEAST:
        _jumped(filter, channel, time_s)
        return False
    if wrong != "state" or channel.offset:
        return False
    moved_m = float(np.linalg.norm(NavState.unpack(time_s, memory.nav).minus(filter.start.state)[:2]))
    for other in filter.channels.values():
        if other.sensor.open_loop == channel.sensor.open_loop and other.axes == channel.axes:
            other.memory.agreed_s = math.nan
    _update(filter, channel, time_s, agreement.opened_state(channel, refused, memory.nav, moved_m))
    memory.counts["reset"] += 1
    return True


def _jumped(filter: Filter, channel: Channel, time_s: float) -> None:
    """Give a sensor constants of the size of its jump; open those that it has, or take them where it is back."""
    memory, kept = filter.memory, channel.memory
    refused = kept.refused
    assert refused is not None
    size = float(np.nanmax(np.abs(refused.offset), initial=0.0))
    models, places = channel.sensor.models, agreement.offset_places(channel)
    if refused.back >= LEAST or not len(places):
        back, speed = len(places) > 0, math.hypot(*memory.nav[3:6].tolist())
        moving = channel.sensor.open_loop == listen.VELOCITY and speed > SLOW
        opened = with_offsets(models, 0.0 if back else size, speed if moving else 0.0)
        filter.jumped.append(Change(channel.name, opened, offsets=True))
    else:
        memory.P[places, places] += size**2
        kept.refused = None
    kept.rejected_since_s = time_s
    memory.counts["jumped"] += 1


def _update(filter: Filter, channel: Channel, time_s: float, covariance: Array) -> None:
    """Correct by the reading that was refused, with more covariance of the navigation states."""
    memory, P = filter.memory, filter.memory.P
    P[:9, :9] += covariance
    P[:] = 0.5 * (P + P.T)
    channel.res[:] = gating.whole_residual(channel, memory.x)
    no_limits = np.full(channel.axes + 1, np.inf)
    kalman.update(P, memory.nav, memory.x, channel.C, channel.R, channel.mem, channel.dims, no_limits)
    channel.memory.use(time_s)
    memory.counts["widened"] += 1

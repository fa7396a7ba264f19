"""A velocity sensor that has jumped by about the whole velocity: set aside, watched, and taken back.

A jump that is small beside the speed is a constant or a scale, and both are estimated (`navfilter.filter.offsets`).
One of the size of the speed (another sign, another unit, axes that are turned) would make a scale of nothing, or a
constant of twice the speed: on a straight way nothing tells the two apart, and in the next turn the one that is wrong
leads the state off. So nothing that such a sensor says is used while the inertial unit knows better. It is back when
its readings agree with the state while the vehicle moves: at rest, another sign or unit agrees, too. When the velocity
has become so uncertain that even such a sensor bounds it, it gets a constant.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from navfilter.filter.refusals import LEAST, Refusals

if TYPE_CHECKING:
    from navfilter.filter.channel import Channel
    from navfilter.filter.filter import Filter

__all__ = ["better_than_nothing", "heard", "is_back", "worthless"]

#: A jump of more than this share of the speed is one of the velocity itself [1]: no scale, no mounting and no current
#: in a channel of the sensor does so.
SHARE = 0.5
#: Readings off by less than this share of the jump may be those of a sensor that is back [1].
BACK = 0.5
#: It proves itself at a speed of more than this share of the jump [m/s per m/s]: another sign jumps by twice the speed.
MOVING = 0.125
#: Beyond this share of the jump, as a standard deviation of the velocity, its readings bound that [1].
UNCERTAIN = 0.2
#: What it is off by may change by as much as it is, within about so long [s]: the vehicle may stop, or turn round.
WANDERS_S = 60.0


def size(refused: Refusals) -> float:
    """Of a jump [m/s]."""
    return float(np.linalg.norm(np.nan_to_num(refused.offset)))


def worthless(filter: Filter, channel: Channel, refused: Refusals) -> bool:
    """Whether a velocity sensor that has jumped is to be set aside: by about the velocity itself, and an inertial unit
    carries the state without it.
    """
    speed = math.hypot(*filter.memory.nav[3:6].tolist())
    carried = filter.inertial and not filter.watch.lost(filter.memory.watch)
    return channel.sensor.gives == "velocity" and carried and size(refused) > SHARE * speed


def heard(channel: Channel, refused: Refusals, nis: float, dof: int) -> Refusals:
    """With one more reading: how many of the last ones on end agree with the state."""
    off = float(np.linalg.norm(np.nan_to_num(channel.res)))
    agrees = off < BACK * size(refused) and nis <= channel.limits[dof]
    return replace(refused, back=refused.back + 1 if agrees else 0)


def is_back(filter: Filter, refused: Refusals) -> tuple[bool, bool]:
    """Whether its readings are used again, and whether that proves it: not at rest."""
    moving = math.hypot(*filter.memory.nav[3:6].tolist()) > MOVING * size(refused)
    return refused.back >= LEAST, moving


def better_than_nothing(filter: Filter, refused: Refusals) -> bool:
    """Whether the velocity is so uncertain that even a sensor which has jumped bounds it."""
    return math.sqrt(float(np.diag(filter.memory.P)[3:5].max())) > UNCERTAIN * size(refused)

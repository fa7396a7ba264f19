"""Clocks of single sensors that were set on the way, told by the order of arrival.

Where the readings of one sensor have come in time and are all ahead of the drive from one reading on, while others come
in time, its clock was set: nothing arrives before it was measured. Where its stamps go back, and are as far behind as
that from then on, its clock was set back: what is longer on its way still comes in the order in which it was measured.
Its stamps are moved back, or ahead, by as much; a sensor that is late by its own stamps is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from navfilter.faults import settings

#: By how much is not told to more digits than this [1]; a reading that is carried on to makes the others late.
DIGITS = 2


@dataclass
class Ahead:
    """By how much the readings of a sensor are ahead of the drive.

    Attributes
    ----------
    usual_s : float
        The last one that came in time [s].
    stamp_s : float
        Of the last reading, as it came [s].
    held_s, seen_s : float
        Stamps of the drive since when they have come in time by that, and when the last one did [s].
    since_s : float
        Stamp of the drive before the first of those since then that did not [s].
    sum_s : float
        Of those that are ahead by the same [s].
    count : int
        Their number.
    by_s : float
        What the stamps of a clock that was set are moved back by [s], negative: ahead; 0: it was not.
    waits : bool
        Its first readings ahead wait until it is told whether it was.
    """

    usual_s: float = 0.0
    stamp_s: float = -math.inf
    held_s: float = -math.inf
    seen_s: float = -math.inf
    since_s: float = math.inf
    sum_s: float = 0.0
    count: int = 0
    by_s: float = 0.0
    waits: bool = False


def set_by(clocks: dict[str, Ahead], name: str, stamp_s: float, last_s: float, late_s: float) -> float:
    """By how much the clock of a sensor was set, a reading of which arrives [s]; 0: it was not.

    Parameters
    ----------
    clocks : dict of str to Ahead
        By sensor; takes note.
    name : str
    stamp_s, last_s : float
        Stamp of the reading, and of the drive's last sample [s].
    late_s : float
        Readings that are ahead by no more come in time [s].
    """
    told, ahead_s = clocks.get(name), stamp_s - last_s
    went_back = told is not None and _went_back(told, ahead_s, stamp_s, late_s)
    if ahead_s <= late_s and not went_back:
        in_time(clocks, name, stamp_s, last_s, late_s)
        return 0.0
    if told is None:  # it has never come in time: its offset may be known
        return 0.0
    told.stamp_s = stamp_s
    if not told.count and abs(ahead_s - told.usual_s) <= late_s:  # no clock is set little by little
        told.usual_s = ahead_s
        return 0.0
    told.since_s = min(told.since_s, last_s)
    mean_s = told.sum_s / told.count if told.count else math.inf
    if abs(ahead_s - mean_s) > 0.5 * late_s:  # samples in blocks make it ahead by more and more
        told.sum_s, told.count = 0.0, 0
    told.sum_s, told.count = told.sum_s + ahead_s, told.count + 1
    by_s = told.sum_s / told.count - told.usual_s
    if told.count == settings.SET and abs(by_s) > late_s and _others_are_as_before(clocks, told):
        told.by_s = round(by_s, DIGITS)
    return told.by_s


def in_time(clocks: dict[str, Ahead], name: str, stamp_s: float, last_s: float, late_s: float) -> None:
    """Note that a reading of a sensor comes in time, see `set_by`."""
    told, ahead_s = clocks.get(name), stamp_s - last_s
    if told is None:
        clocks[name] = Ahead(ahead_s, stamp_s, last_s, last_s)
        return
    if abs(ahead_s - told.usual_s) > 0.5 * late_s:
        told.held_s = last_s
    told.usual_s, told.stamp_s, told.seen_s = ahead_s, stamp_s, last_s
    if told.count:
        told.since_s, told.sum_s, told.count, told.by_s, told.waits = math.inf, 0.0, 0, 0.0, False


def _went_back(told: Ahead, ahead_s: float, stamp_s: float, late_s: float) -> bool:
    """Whether the stamps of a sensor go back, or have gone back and are as far behind as then."""
    if told.usual_s - ahead_s <= late_s:
        return False
    if not told.count:
        return stamp_s <= told.stamp_s
    return told.sum_s < 0.0 and abs(ahead_s - told.sum_s / told.count) <= 0.5 * late_s


def _others_are_as_before(clocks: dict[str, Ahead], one: Ahead) -> bool:
    """Whether another sensor has come in time since one has not, by what it did before: else it is the drive that is
    late, and hides behind what the readings of that sensor take to arrive.
    """
    return any(other.held_s < one.seen_s and other.seen_s > one.since_s for other in clocks.values())

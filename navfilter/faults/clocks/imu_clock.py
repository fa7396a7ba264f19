"""The drive's clock against those of all others: what has jumped, its stamps or time itself.

A leap of the drive's stamps alone says nothing: samples may be missing, the computer may have been suspended or set, or
the inertial unit's own clock may have been. What tells them apart is the order of arrival. Readings that came during
the leap mean that the drive was silent. Where none came, samples and readings wait until two readings tell which time
they belong to: the time after the leap, and it was one for everybody, which is the business of
`navfilter.filter.imu_intake`; or the time before, and the clock of the drive alone was set. Then its stamps are moved
so that they go on, and nothing is lost.

A drive may also be late: its samples come a second or more behind the readings of their time. Readings that follow each
other then wait for the samples before them, until the drive is so far behind that it is silent. Readings whose stamps
leap ahead do not wait: it is their clock that is wrong, and it is told by how much
(`navfilter.faults.clocks.sensor_clock`). Until then the first readings of such a clock wait, where nothing else has
come of the time that they leap over: the state would be carried on to them without samples, and all others be late.

Samples of a burst that were stamped when they were received are taken apart first:
`navfilter.faults.clocks.burst_stamps`.

This works on the order of arrival, so it is for runs that are fed live. A recording is in the order of its stamps.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.faults.clocks import sensor_clock
from navfilter.faults.clocks.burst_stamps import Bursts, BurstsMemory
from navfilter.faults.clocks.sensor_clock import Ahead
from navfilter.filter.imu_intake import ImuIntake
from navfilter.foundation.state_values import misfit

Array = NDArray[np.float64]


class ReceivedMeasurement(NamedTuple):
    """A reading as it arrived, by its own stamp."""

    name: str
    time_s: float
    value: Any
    sd: Any


@dataclass
class DriveClockMemory:
    """What is remembered.

    Attributes
    ----------
    last_s : float
        Stamp of the last sample that went on, moved [s].
    heard_s : float
        Stamp of the last reading [s].
    offset_s : float
        What is added to the stamps of the drive alone [s].
    held : ndarray, shape (k, 7)
        Samples that wait, by their stamps, moved as before.
    readings : list of ReceivedMeasurement
        Readings that wait behind them.
    behind : list of int
        Behind how many of them each.
    alone, together : int
        Readings that were of the time before the leap, and of the time after it.
    early : list of ReceivedMeasurement
        Readings that wait for a drive that is late, or until it is told whose clock was set, in the order of their
        stamps.
    follows_s : float
        Stamp that the next reading is to follow [s].
    late : int
        Readings that came so far ahead of it, so far.
    ahead : dict of str to Ahead
        By how much the readings of each sensor are ahead of the drive.
    moved : int
        Readings whose stamps were moved, so far.
    bursts : BurstsMemory
    """

    last_s: float = math.nan
    heard_s: float = -math.inf
    offset_s: float = 0.0
    held: Array = field(default_factory=lambda: np.empty((0, 7)))
    readings: list[ReceivedMeasurement] = field(default_factory=list)
    behind: list[int] = field(default_factory=list)
    alone: int = 0
    together: int = 0
    early: list[ReceivedMeasurement] = field(default_factory=list)
    follows_s: float = -math.inf
    late: int = 0
    ahead: dict[str, Ahead] = field(default_factory=dict)
    moved: int = 0
    bursts: BurstsMemory = field(default_factory=BurstsMemory)


class ImuClockMonitor:
    """Samples and readings in the order of their arrival, held back while the drive's clock is in doubt.

    Parameters
    ----------
    period_s : float
        Of the drive.
    live : bool
        Whether things arrive at all; otherwise nothing is held back.
    ahead_s : float
        Readings may be taken so far ahead of the drive [s].
    """

    #: A leap by more than this is looked into [s]; and so many periods.
    LEAP_S, LEAP_PERIODS = 1.0, 10.0
    #: Without an answer samples go on after so much of their own time, as they are [s].
    PATIENCE_S = 1.0
    #: So many readings must say the same: one may have been on its way, or have a wild stamp.
    VOTES = 2
    #: Of so many samples that follow each other: a single stamp may be wild, and several readings come between two.
    SAMPLES = 2
    #: A drive is late where readings come so far ahead of it [s], and so many periods: less are blocks.
    LATE_S, LATE_PERIODS = 0.2, 5.0
    #: Readings follow each other when one comes so soon after the one before [s]: a sensor at 1 Hz is on board.
    FOLLOWS_S = 1.5
    #: A stamp further from the drive's than this says nothing of what follows [s].
    WILD_S = 10.0

    def __init__(self, period_s: float, live: bool, ahead_s: float = math.inf) -> None:
        self._period_s, self._leap_s = period_s, max(self.LEAP_S, self.LEAP_PERIODS * period_s)
        self._live, self._ahead_s = live, ahead_s
        self._late_s = max(self.LATE_S, self.LATE_PERIODS * period_s)
        self._prompt_s = min(self._late_s, ahead_s) if live else -math.inf
        self._bursts = Bursts(period_s, self._leap_s)
        self.memory = DriveClockMemory(bursts=self._bursts.memory)

    @property
    def holds(self) -> bool:
        """Whether samples wait."""
        return len(self.memory.held) > 0

    @property
    def counts(self) -> dict[str, int]:
        """Readings ahead of a late drive, samples of bursts, readings of clocks that were set; without zeros."""
        memory = self.memory
        counts = {"late": memory.late, "burst": memory.bursts.count, "moved": memory.moved}
        return {name: count for name, count in counts.items() if count}

    def check_samples(self, samples: Array) -> list[Array | ReceivedMeasurement]:
        """What goes on now, when these samples have arrived; their first column is changed in place."""
        if not (self._live and len(samples)):
            return [samples]
        samples = self._bursts.take(samples)
        if not len(samples):
            return []
        items = self._taken(samples)
        return list(self._met(items)) if self.memory.early else items

    def _met(self, items: Iterable[Array | ReceivedMeasurement]) -> Iterator[Array | ReceivedMeasurement]:
        """The same, and between them the readings that have waited for these samples."""
        early = self.memory.early
        for item in items:
            while isinstance(item, np.ndarray) and early and item[-1, 0] > early[0].time_s:
                here = int(np.argmax(item[:, 0] > early[0].time_s))
                if here:
                    yield item[:here]
                yield early.pop(0)
                item = item[here:]
            yield item

    def _taken(self, samples: Array) -> list[Array | ReceivedMeasurement]:
        memory = self.memory
        if len(samples) == 1 and not self.holds:
            stamp_s = samples.item(0) + memory.offset_s
            if 0.0 < stamp_s - memory.last_s <= self._leap_s:
                samples[0, 0] = memory.last_s = stamp_s
                return [samples]
        known = np.isfinite(samples[:, 0])
        if not known.all():  # no word of a clock; the intake refuses them
            return [samples[~known], *(self._taken(samples[known]) if known.any() else [])]
        samples[:, 0] += memory.offset_s
        if not self.holds:
            leap = self._leap(samples[:, 0])
            if leap == len(samples):
                memory.last_s = samples.item(-1, 0)
                return [samples]
            before, samples = samples[:leap], samples[leap:]
            memory.last_s = before[-1, 0] if leap else memory.last_s
            memory.held = samples.copy()
            return [before, *self._settled()] if leap else self._settled()
        memory.held = np.vstack([memory.held, samples])
        return self._settled()

    def _leap(self, stamps: Array) -> int:
        """The first sample behind a leap that needs an answer; their number where there is none."""
        memory = self.memory
        steps = np.diff(stamps, prepend=memory.last_s)
        for i in np.flatnonzero(np.abs(steps) > self._leap_s).tolist():
            ahead = steps[i] > 0.0
            # readings from within the leap: the drive was silent, the others were not
            if not (ahead and memory.heard_s > stamps[i] - 0.5 * steps[i]) and math.isfinite(memory.heard_s):
                return int(i)
        return len(stamps)

    def _settled(self) -> list[Array | ReceivedMeasurement]:
        """What the samples that wait say themselves: a wild stamp, or the end of patience."""
        memory, stamps = self.memory, self.memory.held[:, 0]
        back = stamps - memory.last_s
        steps = np.diff(stamps)
        wild = ((back > 0.0) & (back <= self._leap_s)).any() or not ((steps > 0.0) & (steps <= self._leap_s)).all()
        if wild or stamps[-1] - stamps[0] > self.PATIENCE_S:
            return self._released()
        return self._told()

    def check_reading(self, reading: ReceivedMeasurement) -> list[Array | ReceivedMeasurement] | None:
        """What goes on now, when this reading has arrived: nothing where it waits; None for the reading itself."""
        told = self.memory.ahead.get(reading.name)
        known_s = max(self.memory.heard_s, self.memory.last_s)
        leaps = told is not None and not told.count and reading.time_s - known_s > self._late_s
        by_s = self._set_by(reading)
        if told is not None and not by_s and self._waits(told, leaps):
            insort(self.memory.early, reading, key=lambda one: one.time_s)
            self.memory.heard_s = reading.time_s
            return []
        before = self._told_now(reading, by_s)
        reading = reading._replace(time_s=reading.time_s - by_s)
        self.memory.moved += (1 + len(before)) * (by_s != 0.0)
        heard = self._heard(reading)
        if not (by_s or before):
            return heard
        return [*before, *([reading] if heard is None else heard)]

    def _set_by(self, reading: ReceivedMeasurement) -> float:
        """By how much the clock of its sensor was set [s]; 0: it was not."""
        memory = self.memory
        if not self._live or not abs(reading.time_s - memory.last_s) < self.WILD_S:
            return 0.0
        return sensor_clock.set_by(memory.ahead, reading.name, reading.time_s, memory.last_s, self._late_s)

    def _waits(self, told: Ahead, leaps: bool) -> bool:
        """Whether a reading that is ahead of the drive waits until it is told whether the clock of its sensor was set:
        the first one, which leaps over a time of which nothing else has come, and those that are ahead by the same.
        """
        if self.holds or not 0 < told.count < settings.SET or not (leaps or (told.waits and told.count > 1)):
            return False
        told.waits = True
        return True

    def _told_now(self, reading: ReceivedMeasurement, by_s: float) -> list[ReceivedMeasurement]:
        """The readings that have waited until now: those of a clock that was set, by the time that they belong to, or,
        where others are ahead of the drive, too, as they are.
        """
        memory = self.memory
        ahead = reading.time_s - memory.last_s > self._late_s
        names = [name for name, one in memory.ahead.items() if one.waits and (name == reading.name or not by_s)]
        if not (ahead and names):
            return []
        for name in names:
            memory.ahead[name].waits = False
        waited = [one for one in memory.early if one.name in names]
        memory.early = [one for one in memory.early if one.name not in names]
        return [one._replace(time_s=one.time_s - by_s) for one in waited]

    def _heard(self, reading: ReceivedMeasurement) -> list[Array | ReceivedMeasurement] | None:
        memory = self.memory
        memory.heard_s = reading.time_s if math.isfinite(reading.time_s) else memory.heard_s
        if not self.holds:
            return self._waited(reading)
        memory.readings.append(reading)
        memory.behind.append(len(memory.held))
        half = 0.5 * (float(memory.held[0, 0]) - memory.last_s)
        stamp = reading.time_s
        # one from before the leap may have been on its way
        memory.alone += memory.last_s < stamp < memory.last_s + abs(half)
        memory.together += stamp >= memory.last_s + half if half > 0.0 else stamp < memory.last_s + half
        return list(self._met(self._told()))

    def passes(self, name: str, stamp_s: float) -> bool:
        """Whether a reading of this sensor and stamp goes on at once, and neither clock nor order are in doubt: then
        that is noted. Else `hear` says what follows.
        """
        memory = self.memory
        last_s, told = memory.last_s, memory.ahead.get(name)
        ahead_s = stamp_s - last_s
        if len(memory.held) or not -self.WILD_S < ahead_s <= self._prompt_s:
            return False
        if told is None or told.count or abs(ahead_s - told.usual_s) > 0.5 * self._late_s:
            sensor_clock.in_time(memory.ahead, name, stamp_s, last_s, self._late_s)
        else:  # the same, of a clock that goes on as before
            told.usual_s, told.stamp_s, told.seen_s = ahead_s, stamp_s, last_s
        memory.heard_s = memory.follows_s = stamp_s
        return True

    def _waited(self, reading: ReceivedMeasurement) -> list[Array | ReceivedMeasurement] | None:
        """What goes on now, when this reading has arrived and no samples wait: see `hear`."""
        memory = self.memory
        ahead_s = reading.time_s - memory.last_s
        if not self._live or not abs(ahead_s) < self.WILD_S:
            return None
        follows = abs(reading.time_s - memory.follows_s) <= self.FOLLOWS_S
        memory.late += follows and ahead_s > self._late_s
        if ahead_s <= self._ahead_s:
            memory.follows_s = reading.time_s
        if ahead_s <= self._ahead_s or not follows:
            return None
        memory.follows_s = max(memory.follows_s, reading.time_s)
        if memory.follows_s - memory.last_s < ImuIntake.SILENT_S:
            insort(memory.early, reading, key=lambda one: one.time_s)
            return []
        # the drive is silent
        released, memory.early = memory.early, []
        return [*released, reading] if released else None

    def _told(self) -> list[Array | ReceivedMeasurement]:
        """What readings have told of the samples that wait; nothing of a single one, whose stamp may be wild."""
        memory = self.memory
        if len(memory.held) < self.SAMPLES or max(memory.alone, memory.together) < self.VOTES:
            return []
        if memory.alone >= self.VOTES:
            moved = memory.last_s + self._period_s - float(memory.held[0, 0])
            memory.held[:, 0] += moved
            memory.offset_s += moved
        return self._released()

    def _released(self) -> list[Array | ReceivedMeasurement]:
        """All that waits, in the order of its arrival."""
        memory, at = self.memory, 0
        result: list[Array | ReceivedMeasurement] = []
        for reading, behind in zip(memory.readings, memory.behind, strict=True):
            if behind > at:
                result.append(memory.held[at:behind])
                at = behind
            result.append(reading)
        if at < len(memory.held):
            result.append(memory.held[at:])
        memory.last_s = float(memory.held[-1, 0])
        memory.held, memory.readings, memory.behind = np.empty((0, 7)), [], []
        memory.alone, memory.together = 0, 0
        return result

    def restore(self, memory: DriveClockMemory) -> None:
        """Be where another was.

        Raises
        ------
        ValueError
            For what is no memory of a clock.
        """
        told = [misfit(one, Ahead(), f"ahead of the drive: {name!r}") for name, one in memory.ahead.items()]
        if problem := next(filter(None, told), ""):
            raise ValueError(problem)
        rows = memory.held.shape[1:] if isinstance(memory.held, np.ndarray) else None
        times = (memory.last_s, memory.heard_s, memory.offset_s, memory.follows_s)
        numbers = (*times, float(memory.late), float(memory.moved))
        if rows != (7,) or not all(isinstance(x, float) for x in numbers) or not math.isfinite(memory.offset_s):
            raise ValueError("what is kept of the drive's clock has another form")
        if not all(isinstance(reading, ReceivedMeasurement) for reading in [*memory.readings, *memory.early]):
            raise ValueError("what waits for the drive's clock are no readings")
        places = [0, *memory.behind, len(memory.held)]
        if len(memory.behind) != len(memory.readings) or any(np.diff(places) < 0):
            raise ValueError("what waits for the drive's clock waits nowhere")
        self._bursts.go_on(memory.bursts)
        self.memory = memory

    def flush(self) -> Iterable[Array | ReceivedMeasurement]:
        """What still waits when no more comes, as it is."""
        first = self._bursts.rest()
        items: list[Array | ReceivedMeasurement] = self._taken(first) if len(first) else []
        items += self._released() if self.holds else []
        items = list(self._met(items))
        items += self.memory.early
        self.memory.early = []
        return items

"""Samples of the drive as they arrive: stamps become steps, defects are repaired or dropped, and counted."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike, Mask
from navfilter.kernels import strapdown
from navfilter.models.mechanisation import Mechanisation


def samples_of(time_s: ArrayLike, first: ArrayLike, second: ArrayLike) -> Array:
    """One sample or a block of them as rows of time and six values.

    Raises
    ------
    TypeError, ValueError
        For what has not three values at each time: a table the other way round would be read across its rows.
    """
    times = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    values = [np.asarray(v, dtype=np.float64) for v in (first, second)]
    if any(v.ndim > 1 and v.shape != (times.size, 3) for v in values):
        raise ValueError(f"expected three values at each of {times.size} times")
    return np.column_stack([times, *(v.reshape(times.size, 3) for v in values)])


def joined(items: Sequence[Any]) -> list[Any]:
    """Inputs with samples that follow each other in one block."""
    result: list[Any] = []
    run: list[Array] = []
    for item in [*items, None]:
        if isinstance(item, np.ndarray):
            run.append(item)
            continue
        if run:
            result.append(np.concatenate(run) if len(run) > 1 else run[0].copy())
            run = []
        if item is not None:
            result.append(item)
    return result


@dataclass
class ImuIntakeMemory:
    """What is remembered of the drive's clock.

    Attributes
    ----------
    before_s : float
        Stamp of the last sample taken [s].
    doubtful_s : float
        A stamp far ahead, dropped until the next one confirms it [s].
    back_s : float
        Last stamp of a clock that may have been set back [s].
    back_count : int
        Such stamps in a row.
    offset_s : float
        What is added to all stamps [s].
    bad : int
        Impossible samples in a row.
    heard_s : float
        Stamp of the last sample there was, while others stand in for those that do not come; else NaN [s].
    ahead_s, recent_s : float
        Times of the first and the latest reading that came ahead of a drive that says nothing; NaN while it speaks [s].
    ahead : int
        How many such readings have come.
    """

    before_s: float
    doubtful_s: float = -math.inf
    back_s: float = math.nan
    back_count: int = 0
    offset_s: float = 0.0
    bad: int = 0
    heard_s: float = math.nan
    ahead_s: float = math.nan
    recent_s: float = math.nan
    ahead: int = 0


class ImuIntake:
    """What is known of the drive's clock.

    Stamps must rise. One that does not is dropped, and so is a stamp more than `DOUBT_S` ahead, unless the very next
    one confirms it. A confirmed leap of more than `LONGEST_S`, and of as many periods as that has seconds, or stamps
    that follow each other for a quarter of a second but lie before the last good one, mean that the clock has been set:
    from then on all stamps are moved by `offset_s`, so that time goes on, and back when it is put right.

    Where samples of an inertial unit are missing for longer than `DOUBT_S`, or impossible for longer than `BAD_S`,
    others stand in for them: rows without values, one a period. Samples that come after all are then too late.

    Parameters
    ----------
    drive : Mechanisation
    start_s : float
    counts : dict of str to int
        Counters "gap", "backward", "bad-sample", "clock-set".
    """

    #: A stamp so far ahead must be confirmed by the next one [s].
    DOUBT_S = 1.0
    #: A leap of the stamps by more than this is one of the clock [s].
    LONGEST_S = 600.0
    #: Bad samples in a row that are replaced by the last good one; what comes after is missing.
    REPEATED = 3
    #: Bad samples for so long are the unit's, not the line's [s].
    BAD_S = 0.25
    #: A drive is silent once readings have come so far ahead of it [s]: a driver that is busy takes less.
    SILENT_S = 4.0
    #: So many of them, over so long a time, each at most so long after the one before [s]: wild stamps do not agree.
    AGREE, SPAN_S, APART_S = 4, 0.5, 2.0

    def __init__(self, drive: Mechanisation, start_s: float, counts: dict[str, int]) -> None:
        self.counts, self._period_s, self._limits = counts, drive.period_s, drive.limits()
        self.limits = np.ascontiguousarray(self._limits, dtype=np.float64)
        self._gap_s = strapdown.GAP_PERIODS * self._period_s
        self._doubt_s = max(self.DOUBT_S, 10.0 * self._period_s)
        self._stands_in = drive.inertial
        self._most_bad = round(self.BAD_S * drive.rate_hz) if drive.inertial else self.REPEATED
        self._longest_s = self.LONGEST_S * max(1.0, self._period_s)  # what speaks seldom may be silent for long
        self._confirm = max(5, round(0.25 * drive.rate_hz))
        # the first sample may come at the start itself
        self.memory = ImuIntakeMemory(math.nextafter(start_s, -math.inf))

    @property
    def offset_s(self) -> float:
        """What is added to all stamps since the clock was set [s]."""
        return self.memory.offset_s

    @property
    def spans(self) -> tuple[float, float]:
        """Silence that is a gap, and silence after which a stamp is in doubt [s]."""
        return self._gap_s, self._doubt_s

    @property
    def in_doubt(self) -> bool:
        """Whether the last samples came with stamps that lie back: until that is settled, nobody can say what is
        late.
        """
        return self.memory.back_count > 1

    def check(self, samples: Array, last: Callable[[], Array]) -> list[tuple[Array, Array]]:
        """Steps in place of stamps (first column), and the stamps: one block, or several, each of samples or of rows
        without values that stand in for some. `last` says the values before these.
        """
        memory = self.memory
        if memory.offset_s:
            samples[:, 0] += memory.offset_s
        stamps = samples[:, 0].copy()
        gaps = strapdown.stamps_to_steps(samples, memory.before_s, self._limits, self._gap_s, self._doubt_s)
        if gaps < 0:
            return self._mend(samples, last)
        self.taken(gaps)
        return [(samples, stamps)]

    def taken(self, gaps: int) -> None:
        """Note that samples were all right, but for so many gaps between them."""
        memory = self.memory
        if gaps:
            self.counts["gap"] += gaps
        memory.doubtful_s, memory.back_count, memory.bad = -math.inf, 0, 0
        if memory.ahead:
            self._speaks()

    def _speaks(self) -> None:
        """The drive is not silent."""
        memory = self.memory
        memory.heard_s = memory.ahead_s = memory.recent_s = math.nan
        memory.ahead = 0

    def missing(self, time_s: float, state_s: float) -> tuple[Array, Array] | None:
        """What stands in for a drive that is silent: steps and stamps, up to a reading that came ahead of it; None
        while it may still speak.

        Parameters
        ----------
        time_s, state_s : float
            Of the reading and of the state [s].
        """
        memory = self.memory
        if not self._stands_in or not math.isfinite(time_s):
            return None
        near = abs(time_s - memory.recent_s) <= self.APART_S
        memory.ahead, memory.recent_s = memory.ahead + 1, time_s
        # of two that do not agree the earlier is the likelier
        memory.ahead_s = min(memory.ahead_s, time_s) if memory.ahead > 1 else time_s
        if math.isnan(memory.heard_s):
            silent_s, agree = time_s - memory.before_s, memory.ahead >= self.AGREE
            if not (agree and time_s - memory.ahead_s >= self.SPAN_S and self.SILENT_S <= silent_s <= self._longest_s):
                return None
        before_s = max(state_s, memory.before_s)
        # two that agree on a leap of the clock do not say that so much time has passed
        if not near or time_s - before_s > self._longest_s:
            return None
        stamps = self._stamps(before_s, time_s)
        if not len(stamps):
            return None
        if math.isnan(memory.heard_s):
            memory.heard_s = memory.before_s
            self.counts["gap"] += 1
        rows = np.full((len(stamps), 7), np.nan)
        rows[:, 0] = np.diff(stamps, prepend=memory.before_s)
        return rows, stamps

    def _stamps(self, before_s: float, end_s: float) -> Array:
        """Stamps of samples that are missing between two instants."""
        count = int((end_s - before_s) / self._period_s + 1e-6)
        return before_s + self._period_s * np.arange(1.0, count + 1.0)

    def _filled(self, samples: Array) -> Array:
        """With rows where samples have been missing for long; the first column holds stamps."""
        steps = np.diff(samples[:, 0], prepend=self.memory.before_s)
        if not self._stands_in or not (steps > self._doubt_s).any():
            return samples
        parts: list[Array] = []
        for row, step in zip(samples, steps.tolist(), strict=True):
            if step > self._doubt_s:
                stamps = self._stamps(row[0] - step, row[0] - 0.5 * self._period_s)
                parts.append(np.column_stack([stamps, np.full((len(stamps), 6), np.nan)]))
            parts.append(row[None, :])
        return np.ascontiguousarray(np.concatenate(parts))

    def _mend(self, samples: Array, last: Callable[[], Array]) -> list[tuple[Array, Array]]:
        """Drop samples whose stamps cannot be, repair values that cannot be; returns steps and stamps."""
        possible: Mask = np.all(np.abs(samples[:, 1 : 1 + len(self._limits)]) <= self._limits, axis=1)
        keep, absent = np.zeros((2, len(samples)), bool)
        before, shift = self.memory.before_s, 0.0
        for i, stamp in enumerate(samples[:, 0].tolist()):
            stamp += shift
            if self.memory.heard_s < stamp <= before:
                moved = math.nan  # another stood in for it
            elif not (math.isfinite(stamp) and stamp > before):
                moved = self._set_back(stamp, before)
            elif stamp - before > self._doubt_s:
                moved = self._leap(stamp, before)
            else:
                moved = 0.0
                self.memory.doubtful_s = -math.inf
            if math.isnan(moved):
                self.counts["backward"] += 1
                continue
            shift, self.memory.offset_s, stamp = shift + moved, self.memory.offset_s + moved, stamp + moved
            self.memory.back_count = 0
            self.memory.bad = 0 if possible[i] else self.memory.bad + 1
            if not possible[i]:
                self.counts["bad-sample"] += 1
            self._speaks()
            if self.REPEATED < self.memory.bad <= self._most_bad:
                continue
            samples[i, 0] = stamp
            keep[i], before = True, stamp
            absent[i] = self.memory.bad > self._most_bad
        samples[absent, 1 : 1 + len(self._limits)] = np.nan
        samples, bad = np.ascontiguousarray(samples[keep]), ~possible[keep] & ~absent[keep]
        self._repair(samples[:, 1 : 1 + len(self._limits)], bad, last)
        steps = np.diff(samples[:, 0], prepend=self.memory.before_s)
        self.counts["gap"] += int(np.count_nonzero(steps > self._gap_s))
        samples = self._filled(samples)
        stamps = samples[:, 0].copy()
        samples[:, 0] = np.diff(stamps, prepend=self.memory.before_s)
        ends = np.flatnonzero(np.diff(np.isnan(samples[:, 1]))) + 1
        return list(zip(np.split(samples, ends), np.split(stamps, ends), strict=True))

    def _leap(self, stamp: float, before: float) -> float:
        """What to add to a stamp far ahead: NaN while it is in doubt, 0 for a gap, else by how much the clock has been
        set.
        """
        confirmed = 0.0 < stamp - self.memory.doubtful_s <= self._doubt_s
        self.memory.doubtful_s = stamp
        if not confirmed:
            return math.nan
        self.memory.doubtful_s = -math.inf
        righted = self.memory.offset_s > 0.0 and abs(stamp - before - self.memory.offset_s) < max(
            1.0, 0.01 * self.memory.offset_s
        )
        if stamp - before <= self._longest_s and not righted:
            return 0.0
        self.counts["clock-set"] += 1
        return -self.memory.offset_s if righted else before + 2.0 * self._period_s - stamp

    def _set_back(self, stamp: float, before: float) -> float:
        """What to add to a stamp that does not rise: NaN until a quarter of a second of them in order shows that the
        clock was set back.
        """
        follows = 0.0 < stamp - self.memory.back_s <= self._doubt_s
        self.memory.back_count = self.memory.back_count + 1 if follows else 1
        self.memory.back_s = stamp
        if not math.isfinite(stamp) or self.memory.back_count < self._confirm or before - stamp < 2.0 * self._period_s:
            return math.nan
        self.counts["clock-set"] += 1
        # what was dropped until here took its time: it counts as a gap
        return before + self.memory.back_count * self._period_s - stamp

    def _repair(self, values: Array, bad: Mask, last: Callable[[], Array]) -> None:
        """Replace samples with impossible values by the last good one; before the first sample by those of a vehicle
        that keeps still.
        """
        if not bad.any():
            return
        good = np.maximum.accumulate(np.where(bad, -1, np.arange(len(values))))
        values[bad] = np.where(good[bad, None] >= 0, values[good[bad]], last())

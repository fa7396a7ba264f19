"""Samples of the drive as they arrive: stamps become steps, defects are repaired or dropped, and counted."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from navfilter.kernels import strapdown
from navfilter.mechanisation import Mechanisation

__all__ = ["Intake"]

Array = NDArray[np.float64]


class Intake:
    """What is known of the drive's clock.

    Stamps must rise. One that does not is dropped, and so is a single stamp far ahead (`LONGEST_S`), until the next one confirms it. When
    the stamps of a whole second follow each other but lie before the last good one, the clock has been set back: from then on all stamps
    are moved by `offset_s`, so that time goes on; when the clock is put right again the offset goes.

    Parameters
    ----------
    drive : Mechanisation
    start_s : float
    counts : dict of str to int
        Counters "gap", "backward", "bad-sample", "clock-set".
    """

    #: A step of the drive longer than this must be confirmed by a second sample, and counts as this long [s].
    LONGEST_S = 600.0

    def __init__(self, drive: Mechanisation, start_s: float, counts: dict[str, int]) -> None:
        self.counts, self._period_s, self._limits = counts, drive.period_s, drive.limits()
        self._gap_s = strapdown.GAP_PERIODS * self._period_s
        self._confirm = max(3, round(drive.rate_hz))
        self._previous = strapdown.PREVIOUS if "imu" in drive.streams else strapdown.PREVIOUS_RPY
        self.before_s = math.nextafter(start_s, -math.inf)  # the first sample may come at the start itself
        self._doubtful_s = -math.inf  # a stamp far ahead, dropped until the next one confirms it
        self._back_s, self._back_count = math.nan, 0  # stamps of a clock that may have been set back
        self.offset_s = 0.0

    @property
    def clock(self) -> tuple[float, ...]:
        """What it remembers."""
        return self.before_s, self._doubtful_s, self._back_s, float(self._back_count), self.offset_s

    @clock.setter
    def clock(self, values: tuple[float, ...]) -> None:
        self.before_s, self._doubtful_s, self._back_s, count, self.offset_s = values
        self._back_count = int(count)

    def take(self, samples: Array, drv: Array, at_rest: Callable[[], Array], whole: bool) -> tuple[Array, Array]:
        """Steps in place of stamps (first column), and the stamps: all of them, or only the last one if the block is taken `whole`."""
        if self.offset_s:
            samples[:, 0] += self.offset_s
        stamps = samples[-1:, 0].copy() if whole else samples[:, 0].copy()
        gaps = strapdown.stamps_to_steps(samples, self.before_s, self._limits, self._gap_s, self.LONGEST_S)
        if gaps < 0:
            return self._mend(samples, drv, at_rest)
        if gaps:
            self.counts["gap"] += gaps
            if self.offset_s and self._put_right(samples, stamps, whole):
                return self.take(samples, drv, at_rest, whole)
        return samples, stamps

    def _put_right(self, samples: Array, stamps: Array, whole: bool) -> bool:
        """Whether the clock has been put right again after it was set back: the first step is the offset, give or take a second."""
        if abs(samples[0, 0] - self.offset_s) > 1.0:
            return False
        samples[:, 0] = np.cumsum(samples[:, 0]) + self.before_s - self.offset_s
        self.counts["gap"] -= 1
        self.counts["clock-set"] += 1
        self.offset_s = 0.0
        return True

    def _mend(self, samples: Array, drv: Array, at_rest: Callable[[], Array]) -> tuple[Array, Array]:
        """Drop samples that do not come after the last one, repair what is not possible; returns steps and stamps."""
        keep, before, shift = np.zeros(len(samples), bool), self.before_s, 0.0
        for i, stamp in enumerate(samples[:, 0].tolist()):
            stamp += shift
            if not (math.isfinite(stamp) and stamp > before):
                moved = self._set_back(stamp, before)
                if not moved:
                    continue
                shift += moved
                stamp += moved
            if stamp - before > self.LONGEST_S and not 0.0 < stamp - self._doubtful_s <= self.LONGEST_S:
                self._doubtful_s = stamp
                continue
            samples[i, 0] = stamp
            keep[i], before = True, stamp
        self.counts["backward"] += int(np.count_nonzero(~keep))
        samples = np.ascontiguousarray(samples[keep])
        self._repair(samples[:, 1 : 1 + len(self._limits)], drv, at_rest)
        stamps = samples[:, 0].copy()
        steps = np.diff(stamps, prepend=self.before_s)
        self.counts["gap"] += int(np.count_nonzero(steps > self._gap_s))
        samples[:, 0] = np.minimum(steps, self.LONGEST_S)
        return samples, stamps

    def _set_back(self, stamp: float, before: float) -> float:
        """How far to move the stamps from here on: not 0 once a second of them in good order shows that the clock was set back."""
        follows = 0.0 < stamp - self._back_s <= max(1.0, 3.0 * self._period_s)
        self._back_count = self._back_count + 1 if follows else 1
        self._back_s = stamp
        if not math.isfinite(stamp) or self._back_count < self._confirm or before - stamp < 1.0:
            return 0.0
        moved = before + self._period_s - stamp
        self.offset_s += moved
        self._back_s, self._back_count = math.nan, 0
        self.counts["clock-set"] += 1
        return moved

    def _repair(self, values: Array, drv: Array, at_rest: Callable[[], Array]) -> None:
        """Replace samples with impossible values by the last good one; before the first sample by those of a vehicle that keeps still."""
        bad = ~(np.abs(values) <= self._limits).all(axis=1)
        if not bad.any():
            return
        self.counts["bad-sample"] += int(bad.sum())
        good = np.maximum.accumulate(np.where(bad, -1, np.arange(len(values))))
        last = drv[self._previous : self._previous + len(self._limits)] if drv[strapdown.STARTED] else at_rest()
        values[bad] = np.where(good[bad, None] >= 0, values[good[bad]], last)

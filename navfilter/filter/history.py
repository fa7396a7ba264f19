"""The last seconds of a run: what arrived, and the state now and then, so that a late reading takes its place in time."""

from __future__ import annotations

from bisect import bisect_left
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.filter import Engine, Memory, Outcome
from navfilter.filter.intake import joined

__all__ = ["History", "Reading"]

Array = NDArray[np.float64]


class Reading(NamedTuple):
    """A reading as it arrived; `frozen` when its value had not changed for suspiciously long."""

    name: str
    time_s: float
    value: Array
    sd: Any
    frozen: bool


class History:
    """Everything that went into an engine during the last `length_s` seconds, with checkpoints.

    A late reading takes the engine back to the checkpoint before it, and all that came after is fed again, the reading in its place: the
    result is what arrival in order would have given, at the cost of feeding at most `length_s` again.

    Parameters
    ----------
    engine : Engine
    length_s : float
    """

    #: Seconds between checkpoints: a late reading feeds at most so much more than its lateness.
    SPACING_S = 0.1

    def __init__(self, engine: Engine, length_s: float) -> None:
        self.engine, self.length_s = engine, length_s
        self._marks: list[tuple[float, int, Memory]] = []  # time, number of the next input, what the engine remembered
        self._log: list[Array | Reading] = []
        self._shifts: list[float] = []  # by how much the stamps of each input were moved when it came
        self._first = 0  # number of the first input in the log
        self.replayed_s = 0.0

    def feed(self, item: Array | Reading) -> Outcome | None:
        """Give samples (rows of time and six values) or a reading to the engine, and keep them."""
        self._mark()
        shift = self.engine.intake.offset_s
        if isinstance(item, np.ndarray):
            self._log.append(item.copy())
            self._shifts.append(shift)
            self.engine.advance(item)
            return None
        outcome = self.engine.take(self.engine.channel(item.name), *item[1:])
        self._log.append(item)  # behind: the engine may have begun this history anew
        self._shifts.append(shift)
        return outcome

    def begin(self) -> None:
        """Forget everything: the engine starts anew."""
        self._marks, self._log, self._shifts, self._first = [], [], [], 0

    def _mark(self) -> None:
        now = self.engine.time_s
        if self._marks and now - self._marks[-1][0] < self.SPACING_S:
            return
        self._marks.append((now, self._first + len(self._log), self.engine.memory()))
        old = 0
        while old + 1 < len(self._marks) and self._marks[old + 1][0] <= now - self.length_s:
            old += 1
        if old:
            del self._marks[:old]
            number = self._marks[0][1]
            del self._log[: number - self._first], self._shifts[: number - self._first]
            self._first = number

    def late(self, reading: Reading) -> Outcome | None:
        """Put a late reading in its place; None when the place lies before the history."""
        # strictly before it, for readings of one time have an order; only the very first checkpoint stands before all readings of its time
        at = bisect_left(self._marks, reading.time_s, key=lambda mark: mark[0]) - 1
        if at < 0 and self._marks and self._marks[0][:2] == (reading.time_s, 0):
            at = 0
        if at < 0:
            return None
        if any(isinstance(i, Reading) and i.name == reading.name and i.time_s == reading.time_s for i in self._log):
            return Outcome("duplicate")
        _, number, memory = self._marks[at]
        again, shifts = self._log[number - self._first :], self._shifts[number - self._first :]
        self.replayed_s += self.engine.time_s - memory.clock[0]
        del self._log[number - self._first :], self._shifts[number - self._first :], self._marks[at:]
        self.engine.recall(memory)
        result: Outcome | None = None
        for item in _in_place(again, shifts, reading, list(self.engine.vehicle.sensors)):
            outcome = self.feed(item)
            if item is reading:
                result = outcome
        return result

    def kept(self) -> tuple[Memory, list[Array | Reading]]:
        """The oldest checkpoint and everything fed since: all that is needed to come to the present state again."""
        if not self._marks:
            return self.engine.memory(), []
        return self._marks[0][2], list(self._log)


def _in_place(items: list[Array | Reading], shifts: list[float], reading: Reading, order: list[str]) -> list[Array | Reading]:
    """The inputs with a reading put where its time says, among those of the same time in the vehicle's order, as a replay has it."""
    before: list[Array | Reading] = []
    after: list[Array | Reading] = []
    for item, offset_s in zip(items, shifts, strict=True):
        if isinstance(item, Reading):
            first = (item.time_s, order.index(item.name)) < (reading.time_s, order.index(reading.name))
            (before if first else after).append(item)
            continue
        late = item[:, 0] + offset_s > reading.time_s + 1e-9
        split = int(np.argmax(late)) if late.any() else len(item)
        for part, whither in ((item[:split], before), (item[split:], after)):
            if len(part):
                whither.append(part)
    return [*joined(before), reading, *joined(after)]

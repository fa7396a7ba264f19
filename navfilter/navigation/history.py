"""The last seconds of a run: what arrived, and the state now and then, so that a late reading takes its place in
time.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from navfilter.filter.events import Measurement, Outcome
from navfilter.filter.imu_intake import joined
from navfilter.foundation.arrays import Array
from navfilter.foundation.state_values import copied


class Restorable(Protocol):
    """What has a history: it is fed in order, and can go back."""

    memory: Any

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""

    @property
    def offset_s(self) -> float:
        """By how much stamps are moved since the clock was set [s]."""

    def process(self, item: Array | Measurement) -> Outcome | None:
        """Take samples (rows of time and six values) or a reading, in order."""


class History:
    """Everything that went into a run during the last `length_s` seconds, with checkpoints.

    A late reading takes the run back to the checkpoint before it, and all that came after is fed again, the reading in
    its place: the result is what arrival in order would have given, at the cost of feeding at most `length_s` again.

    Parameters
    ----------
    run : Restorable
    length_s : float
    sensors : sequence of str
        In the order in which readings of one time are taken.
    """

    #: Seconds between checkpoints: a late reading feeds at most so much more than its lateness. Those before a reading,
    #: and those before samples, which are many and have no time to spare, where readings are rare.
    SPACING_S, RARE_S = 0.4, 1.0

    def __init__(self, run: Restorable, length_s: float, sensors: Sequence[str]) -> None:
        self.run, self.length_s, self.sensors = run, length_s, list(sensors)
        self.start_here()

    def start_here(self) -> None:
        """Forget everything: the run starts anew."""
        self._marks: list[tuple[float, int, Any]] = []  # time, number of the next input, memory of the run
        #: What arrived, and by how much its stamps were moved then.
        self.inputs: list[tuple[Array | Measurement, float]] = []
        self._first = 0  # number of the first of these
        self.marked_s = -math.inf
        self._forgotten: Any = None

    @property
    def due_s(self) -> float:
        """From when on `ready` has something to do before a reading [s]."""
        return self.marked_s + (self.SPACING_S if self._forgotten is None else 0.5 * self.SPACING_S)

    def change_places(self, other: "History") -> None:
        """Have the past of another run over the same inputs, and that this one's."""
        for name in ("_marks", "inputs", "_first", "marked_s"):
            own = getattr(self, name)
            setattr(self, name, getattr(other, name))
            setattr(other, name, own)

    def process(self, item: Array | Measurement) -> Outcome | None:
        """Give samples (rows of time and six values) or a reading to the run, and keep them."""
        run = self.run
        now, shift = run.time_s, run.offset_s
        kept, spacing_s = (item.copy(), self.RARE_S) if isinstance(item, np.ndarray) else (item, self.SPACING_S)
        self.ready(now, spacing_s)
        outcome = run.process(item)
        self.inputs.append((kept, shift))  # behind: the run may have begun this history anew
        return outcome

    def ready(self, now: float, spacing_s: float = SPACING_S) -> None:
        """Before an input: keep a checkpoint where one is due."""
        if now - self.marked_s >= spacing_s:
            self._mark(now)
        else:
            self._forgotten = None

    def _mark(self, now: float) -> None:
        """Keep a checkpoint of the present, and forget what lies too far back."""
        self.marked_s = now
        self._marks.append((now, self._first + len(self.inputs), copied(self.run.memory)))
        old = 0
        while old + 1 < len(self._marks) and self._marks[old + 1][0] <= now - self.length_s:
            old += 1
        if old:
            number = self._marks[old][1]
            # kept until a later input: to free all of it takes half as long as the copy
            self._forgotten = self._marks[:old], self.inputs[: number - self._first]
            del self._marks[:old], self.inputs[: number - self._first]
            self._first = number

    def correct_late(self, reading: Measurement) -> Outcome | None:
        """Put a late reading in its place; None when the place lies before the history."""
        # strictly before it, for readings of one time have an order; only the very first checkpoint stands before all
        # readings of its time
        at = bisect_left(self._marks, reading.time_s, key=lambda mark: mark[0]) - 1
        if at < 0 and self._marks and self._marks[0][:2] == (reading.time_s, 0):
            at = 0
        if at < 0:
            return None
        readings = (item for item, _ in self.inputs if isinstance(item, Measurement))
        if any(item.name == reading.name and item.time_s == reading.time_s for item in readings):
            return Outcome("duplicate")
        _, number, memory = self._marks[at]
        again = self.inputs[number - self._first :]
        del self.inputs[number - self._first :], self._marks[at:]
        self.marked_s = self._marks[-1][0] if self._marks else -math.inf
        self.run.memory = memory
        result: Outcome | None = None
        for item in _in_place(again, reading, self.sensors):
            outcome = self.process(item)
            if item is reading:
                result = outcome
        return result

    def content(self) -> tuple[Any, list[Array | Measurement]]:
        """The oldest checkpoint and everything fed since: all that is needed to come to the present state again."""
        if not self._marks:
            return self.run.memory, []
        return self._marks[0][2], [item for item, _ in self.inputs]


def _in_place(
    inputs: list[tuple[Array | Measurement, float]], reading: Measurement, order: list[str]
) -> list[Array | Measurement]:
    """The inputs with a reading put where its time says, among those of the same time in the vehicle's order, as a
    replay has it.
    """
    before: list[Array | Measurement] = []
    after: list[Array | Measurement] = []
    latest_s = reading.time_s + 1e-9
    for item, offset_s in inputs:
        if isinstance(item, Measurement):
            first = (item.time_s, order.index(item.name)) < (reading.time_s, order.index(reading.name))
            (before if first else after).append(item)
            continue
        if len(item) == 1:  # as nearly all that come live, one by one: an array's own ways take ten times as long
            (after if item.item(0) + offset_s > latest_s else before).append(item)
            continue
        late = item[:, 0] + offset_s > latest_s
        split = int(np.argmax(late)) if late.any() else len(item)
        for part, whither in ((item[:split], before), (item[split:], after)):
            if len(part):
                whither.append(part)
    return [*joined(before), reading, *joined(after)]

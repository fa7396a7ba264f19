"""The inputs of the beginning, kept for as long as that may be done again.

They are many, so they stand in few, large pieces: who copies them, stores them, lets go of them, or looks through all
that lives, as Python's collector does, is soon done. All of that happens between two samples of a vehicle.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navfilter.filter.events import Measurement
from navfilter.foundation.arrays import Array, Ints, Mask

#: Rows of a piece.
PIECE = 2048
#: Columns of what is kept of a reading: its time, the number of its sensor, whether it was frozen, and the same; how
#: many samples came before it, and how many values there are of it and those before.
TIME_S, SENSOR, FROZEN, AS_BEFORE, BEFORE, VALUES, COLUMNS = range(7)


@dataclass
class Rows:
    """Rows of numbers that become more.

    Attributes
    ----------
    width, count : int
    pieces : list of ndarray, shapes (PIECE, width)
        The last ones have room for more.
    """

    width: int
    count: int = 0
    pieces: list[Array] = field(default_factory=list)

    def append(self, rows: Array) -> None:
        """Add some."""
        if len(rows) == 1:
            self.put(rows[0])
            return
        taken = 0
        while taken < len(rows):
            piece, at = self.room()
            some = rows[taken : taken + PIECE - at]
            piece[at : at + len(some)] = some
            taken += len(some)
            self.count += len(some)

    def put(self, row: Array | tuple[float, ...] | float) -> None:
        """Add one."""
        at = self.count % PIECE
        if not at:
            self.room()
        self.pieces[-1][at] = row
        self.count += 1

    def room(self) -> tuple[Array, int]:
        """Where the next row stands."""
        i, at = divmod(self.count, PIECE)
        if i == len(self.pieces):
            self.pieces.append(np.empty((PIECE, self.width)))
        return self.pieces[i], at

    def cut(self, count: int) -> None:
        """Go back to so many. Others may share the pieces: what they hold is not written over."""
        if count < self.count:
            i = count // PIECE
            self.pieces[i:] = [self.pieces[i].copy()]
            self.count = count

    def so_far(self) -> "Rows":
        """The same to be read only, whatever comes. Nothing is copied: what they hold is not written over."""
        pieces = list(self.pieces)
        if pieces:
            pieces[-1] = pieces[-1][: self.count - PIECE * (len(pieces) - 1)]
        return Rows(self.width, self.count, pieces)

    def whole(self, count: int) -> Array:
        """The first of them, shape (count, width); a copy."""
        return np.concatenate([np.empty((0, self.width)), *self.pieces])[:count].copy()


@dataclass(frozen=True)
class InputBuffer:
    """Samples and readings in the order in which they were taken.

    Attributes
    ----------
    names : tuple of str
        Of all sensors.
    samples, readings, values : Rows
        Time and six values; `COLUMNS` columns; one value.
    sds : dict
        What came with readings as their own standard deviation, by number.
    """

    names: tuple[str, ...]
    samples: Rows = field(default_factory=lambda: Rows(7))
    readings: Rows = field(default_factory=lambda: Rows(COLUMNS))
    values: Rows = field(default_factory=lambda: Rows(1))
    sds: dict[int, Any] = field(default_factory=dict)

    @property
    def count(self) -> tuple[int, int]:
        """Samples and readings."""
        return self.samples.count, self.readings.count

    def append(self, item: Array | Measurement) -> None:
        """Add an input."""
        if isinstance(item, np.ndarray):
            self.samples.append(item)
            return
        if item.sd is not None:
            self.sds[self.readings.count] = item.sd
        name, time_s, value, _, frozen, same = item
        for number in value.ravel().tolist():
            self.values.put(number)
        self.readings.put((time_s, self.names.index(name), frozen, same, self.samples.count, self.values.count))

    def has_room(self, values: int) -> bool:
        """Whether a reading of so many values fits into the last pieces."""
        rows, numbers = self.readings.count % PIECE, self.values.count % PIECE
        return rows > 0 and 0 < numbers <= PIECE - values

    def extend(
        self,
        samples: Array,
        before: Ints,
        time_s: Array,
        sensor: Ints,
        same: Mask,
        values: Mapping[int, Array | Sequence[Array]],
        sds: Sequence[Any],
    ) -> None:
        """Add samples, and readings between them, none of them frozen.

        Parameters
        ----------
        samples : ndarray, shape (m, 7)
        before : ndarray of int, shape (n,)
            Behind how many of these samples each reading came.
        time_s, sensor, same : ndarray, shapes (n,)
            When, of which sensor (by its place among `names`), and whether as before.
        values : dict of int to ndarray, or to sequence of ndarray
            By sensor, one row a reading.
        sds : sequence
            None for a reading without its own; empty where none has one.
        """
        owner, read = [], []
        for number, rows in values.items():
            flat = rows if isinstance(rows, np.ndarray) else np.concatenate([value.ravel() for value in rows])
            read.append(flat.ravel())
            owner.append(np.repeat(np.flatnonzero(sensor == number), [value.size for value in rows]))
        owners = np.concatenate(owner)
        numbers = np.concatenate(read)[np.argsort(owners, kind="stable")]
        ends = self.values.count + np.cumsum(np.bincount(owners, minlength=len(time_s)))
        self.sds.update({self.readings.count + k: sd for k, sd in enumerate(sds) if sd is not None})
        frozen = np.zeros(len(time_s))
        self.readings.append(np.column_stack([time_s, sensor, frozen, same, self.samples.count + before, ends]))
        self.values.append(numbers[:, None])
        self.samples.append(samples)

    def cut(self, samples: int, readings: int) -> None:
        """Go back to so many."""
        if readings < self.readings.count:
            self.readings.cut(readings)
            i, at = divmod(readings - 1, PIECE)
            self.values.cut(int(self.readings.pieces[i][at, VALUES]) if readings else 0)
            for number in [number for number in self.sds if number >= readings]:
                del self.sds[number]
        self.samples.cut(samples)

    def so_far(self) -> "InputBuffer":
        """The same to be read only, whatever comes."""
        return InputBuffer(
            self.names, self.samples.so_far(), self.readings.so_far(), self.values.so_far(), dict(self.sds)
        )

    def first(self, samples: int, readings: int) -> "InputBuffer":
        """The first of them, as they are stored: each kind in one piece."""
        heads = self.readings.whole(readings)
        values = self.values.whole(int(heads[-1, VALUES]) if readings else 0)
        given, heard, read = (Rows(t.shape[1], len(t), [t]) for t in (self.samples.whole(samples), heads, values))
        return InputBuffer(self.names, given, heard, read, {n: sd for n, sd in self.sds.items() if n < readings})

    def again(self, names: tuple[str, ...]) -> "InputBuffer":
        """The same from what was stored, for a vehicle with these sensors.

        Raises
        ------
        ValueError
            For anything that is not as `first` makes it.
        """
        new, own = InputBuffer(names), (self.samples, self.readings, self.values)
        for rows, like in zip(own, (new.samples, new.readings, new.values), strict=True):
            good = len(rows.pieces) == 1 and rows.pieces[0].shape == (rows.count, like.width)
            if not (good and rows.pieces[0].dtype == np.float64):
                raise ValueError("what is kept of the beginning has another form")
            like.append(rows.pieces[0])
        heads = self.readings.pieces[0]
        ends = heads[:, [BEFORE, VALUES]]
        follow = np.diff(ends, axis=0, prepend=0.0) >= 0.0
        good = follow & (ends <= [new.samples.count, new.values.count]) & (ends == np.floor(ends))
        known = self.names == names and np.isin(heads[:, SENSOR], range(len(names))).all()
        numbers = all(type(number) is int and 0 <= number < len(heads) for number in self.sds)
        if not (good.all() and known and numbers):
            raise ValueError("readings kept of the beginning do not follow each other, or are of no sensor")
        new.sds.update(self.sds)
        return new

    def until(self, time_s: float) -> tuple[int, int]:
        """How many samples and readings there are before the first input that is later; samples between two readings
        are one input.
        """
        samples, heads = self.samples.whole(self.samples.count), self.readings.whole(self.readings.count)
        ends = np.append(heads[:, BEFORE], len(samples)).astype(np.int64)
        begins = np.append(0, ends[:-1])
        latest = np.where(ends > begins, np.append(-math.inf, samples[:, 0])[ends], -math.inf)
        later = np.maximum(latest, np.append(heads[:, TIME_S], -math.inf)) > time_s
        if not later.any():
            return self.count
        k = int(np.argmax(later))
        return int(begins[k] if latest[k] > time_s else ends[k]), k

    def inputs(self, after: tuple[int, int] = (0, 0)) -> list[Array | Measurement]:
        """All of them after so many samples and readings; samples that follow each other are one block."""
        samples, heads = self.samples.whole(self.samples.count), self.readings.whole(self.readings.count)
        values = self.values.whole(self.values.count)[:, 0]
        result: list[Array | Measurement] = []
        begin, done = after
        first = int(heads[done - 1, VALUES]) if done else 0
        for k, (time_s, sensor, frozen, same, *ends) in enumerate(heads[done:].tolist(), done):
            before, last = map(int, ends)
            if before > begin:
                result.append(samples[begin:before])
            value = values[first:last].copy()
            result.append(
                Measurement(self.names[int(sensor)], time_s, value, self.sds.get(k), bool(frozen), bool(same))
            )
            begin, first = before, last
        return [*result, samples[begin:]] if begin < len(samples) else result

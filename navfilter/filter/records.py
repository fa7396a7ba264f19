"""What a run leaves behind: records for the smoother, rows for the track, residuals per sensor.

A store of vectors that stays in memory while it is small, and goes to a temporary file when it is not, so that a
day-long mission needs no more memory than an hour.
"""

import bisect
import contextlib
import copy
import functools
import itertools
import math
import mmap
import sys
import tempfile
import weakref
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation.arrays import Array, Ints, Mask
from navfilter.foundation.display import Shown, Value, often, span

#: Bytes of memory that are asked for at a time: sixteen huge pages, which a system clears ten times as quickly as as
#: much memory in small ones.
BLOCK, PAGE = 32 << 20, 2 << 20
#: So many bytes are kept for the next run, at most: an hour at 100 Hz with its rows needs 142 MB. Memory that is new to
#: a virtual machine takes 1 to 2 s per GB there, as long as all else that is done with it.
KEPT = 256 << 20
_idle: list[mmap.mmap] = []


def _block(size: int) -> Array:
    """A piece of memory for so many elements at least, which is used again when nobody looks at it any more."""
    needed = -(-8 * size // PAGE) * PAGE
    block = None
    for idle in sorted(_idle, key=len):
        if 4 * needed <= 4 * len(idle) <= 5 * needed:  # none that is much too large: who needs that would miss it
            with contextlib.suppress(ValueError):  # another thread has taken it
                _idle.remove(idle)
                block = idle
                break
    if block is None:
        private = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
        block = mmap.mmap(-1, needed, **private)
        if hasattr(mmap, "MADV_HUGEPAGE"):
            with contextlib.suppress(OSError):  # a kernel without them
                block.madvise(mmap.MADV_HUGEPAGE)
    array = np.frombuffer(block)
    weakref.finalize(array, _left, block).atexit = False
    return array


def _left(block: mmap.mmap) -> None:
    if len(block) + sum(map(len, _idle)) <= KEPT:
        if hasattr(mmap, "MADV_FREE"):  # the system may take it as soon as it is short of memory
            block.madvise(mmap.MADV_FREE)
        _idle.append(block)


class RecordStore:
    """Append-only store of float64 vectors, in memory up to `memory_bytes`; beyond that all but the latest go to a
    temporary file. What it gives out are views, to be used before the next one is asked for.

    Parameters
    ----------
    memory_bytes : int
    chunk : int
        So many elements are to stand in one piece.

    Raises
    ------
    OSError
        When the temporary file cannot be written (disk full).
    """

    CHUNK = 1 << 18  # 2 MiB of float64

    def __init__(self, memory_bytes: int, chunk: int = 0) -> None:
        self._chunk_size = max(self.CHUNK, chunk)
        self._keep = max(2, memory_bytes // (8 * self._chunk_size))
        self._block = np.empty(0)  # room for the next chunks
        self._chunks: list[Array | None] = []
        self._firsts: list[int] = []  # number of the first vector of each chunk
        self._sizes = array("i")  # a flat array: a day has millions of vectors
        self._end = 0
        self._file: Any = None
        self._written: list[tuple[int, int]] = []  # of each chunk in the file: where, and how many elements
        self._loaded: tuple[int, Array] = -1, np.empty(0)

    def __len__(self) -> int:
        return len(self._sizes)

    def new(self, size: int) -> Array:
        """A writable view of `size` elements, appended."""
        self._make_room(size)
        self._sizes.append(size)
        self._end += size
        return self[-1]

    def tail(self, size: int, last: bool = False) -> tuple[Array, bool]:
        """Where the next vectors may be written, this size of them at least (`took` says which are); with the last one
        before them where that is wanted, has this size, and stands there.
        """
        self._make_room(size)
        held = last and len(self) > self._firsts[-1] and self._sizes[-1] == size
        chunk = self._chunks[-1]
        assert chunk is not None
        return chunk[self._end - (size if held else 0) :], held

    def took(self, sizes: Ints) -> None:
        """Vectors of these sizes have been written one behind the other at the beginning of what is free."""
        self._sizes.frombytes(sizes.astype(np.intc).tobytes())
        self._end += int(sizes.sum())

    def extend(self, flat: Array, sizes: Ints) -> None:
        """Append vectors of these sizes that stand one behind the other in `flat`."""
        ends = np.cumsum(sizes)
        done = 0
        while done < len(sizes):
            begin = int(ends[done] - sizes[done])
            if not self._room(int(sizes[done])):
                self.new(int(sizes[done]))[:] = flat[begin : int(ends[done])]
                done += 1
                continue
            chunk = self._chunks[-1]
            assert chunk is not None
            last = int(np.searchsorted(ends, begin + len(chunk) - self._end, side="right"))
            size = int(ends[last - 1]) - begin
            chunk[self._end : self._end + size] = flat[begin : begin + size]
            self.took(sizes[done:last])
            done = last

    def drop(self) -> None:
        """Forget the last vector."""
        size = self._sizes.pop()
        if self._firsts[-1] <= len(self):
            self._end -= size
        else:  # it stood in a chunk before, and the last one is empty
            self._firsts = [min(first, len(self)) for first in self._firsts]

    def _room(self, size: int) -> bool:
        """Whether one more vector goes into the last chunk."""
        return bool(self._chunks) and self._end + size <= len(self._chunks[-1])  # type: ignore[arg-type]

    def _make_room(self, size: int) -> None:
        if not self._room(size):
            self._chunks.append(self._buffer(max(self._chunk_size, size)))
            self._firsts.append(len(self))
            self._end = 0

    def _buffer(self, size: int) -> Array:
        """For the next chunk. Once there is a file, that of the last but one, which goes there."""
        if self._file is None and len(self._chunks) >= self._keep:
            self.to_file()
        elif self._file is not None and len(self._chunks) > 1 and self._chunks[-2] is not None:
            chunk = self._stored(len(self._chunks) - 2)
            return chunk if len(chunk) == size else np.empty(size)
        if self._file is not None:
            return np.empty(size)
        if len(self._block) < size:
            self._block = _block(size if self._chunk_size > self.CHUNK else max(size, BLOCK // 8))
        chunk, self._block = self._block[:size], self._block[size:]
        return chunk

    @property
    def in_file(self) -> bool:
        """Whether all but the latest go to a file."""
        return self._file is not None

    def to_file(self) -> None:
        """From now on all but the latest go to a file, as if they were more than are to be in memory."""
        self._file = tempfile.TemporaryFile(prefix="navfilter-")  # noqa: SIM115  (lives as long as the spool)
        weakref.finalize(self, self._file.close)
        for number in range(len(self._chunks) - 1):
            self._stored(number)
        self._chunks[-1:] = [chunk.copy() for chunk in self._chunks[-1:] if chunk is not None]
        self._block = np.empty(0)
        _idle.clear()  # a long run needs its memory for other things

    def _stored(self, number: int) -> Array:
        """Where a chunk stood that goes to the file; all before it are there."""
        chunk, self._chunks[number] = self._chunks[number], None
        assert chunk is not None
        at = sum(self._written[-1]) if self._written else 0
        self._file.seek(8 * at)
        self._file.write(chunk)
        self._written.append((at, len(chunk)))
        return chunk

    def __getitem__(self, index: int) -> Array:
        index = index if index >= 0 else len(self) + index
        number, size = bisect.bisect_right(self._firsts, index) - 1, self._sizes[index]
        last = index == len(self) - 1 and number == len(self._chunks) - 1
        begin = self._end - size if last else sum(self._sizes[self._firsts[number] : index])
        return self._chunk(number)[begin : begin + size]

    def run(self, first: int, last: int) -> tuple[Array, Ints]:
        """Vectors before the one of number `last`, back to number `first` or as far as they stand in one piece: the
        array in which they stand, and where each of them begins.
        """
        if first >= last:
            return np.empty(0), np.empty(0, np.int64)
        number = bisect.bisect_right(self._firsts, last - 1) - 1
        begin = self._firsts[number]
        sizes = np.array(self._sizes[begin:last], np.int64)
        return self._chunk(number), (np.cumsum(sizes) - sizes)[max(first - begin, 0) :]

    def pieces(self, count: int) -> Iterator[tuple[Array, Ints]]:
        """The first so many vectors, as `extend` takes them."""
        for number, (first, end) in enumerate(itertools.pairwise([*self._firsts, len(self)])):
            sizes = np.array(self._sizes[first : min(end, count)], np.int64)
            if len(sizes):
                yield self._chunk(number)[: sizes.sum()], sizes

    def _chunk(self, number: int) -> Array:
        chunk = self._chunks[number]
        if chunk is not None:
            return chunk
        if self._loaded[0] != number:
            at, size = self._written[number]
            self._loaded = number, self._loaded[1] if len(self._loaded[1]) == size else np.empty(size)
            self._file.seek(8 * at)
            self._file.readinto(self._loaded[1])
        return self._loaded[1]


#: What can become of a reading, in the order of the codes in `Residuals.outcome`.
OUTCOMES = ("used", "rejected", "invalid", "duplicate", "too-late", "ahead", "unknown-sensor")

#: In place of the axes: the record is a change of the layout.
CHANGE = -1


@functools.cache
def triangle(n: int) -> tuple[Ints, Ints]:
    """Rows and columns of the lower triangle of a matrix of n rows, row by row, as a row of the tape has them."""
    return np.tril_indices(n)


@dataclass(frozen=True, eq=False, repr=False)
class Residuals(Value):
    """Residuals of one sensor, one row per reading.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    value : ndarray, shape (n, a)
        Measured minus predicted; NaN where missing.
    sd : ndarray, shape (n, a)
        Predicted standard deviation of the residual; NaN also where a component was left out alone.
    nis : ndarray, shape (n,)
        Normalised innovation squared.
    dof : ndarray, shape (n,)
        Components used.
    outcome : ndarray of uint8, shape (n,)
        Index into `OUTCOMES`.
    """

    time_s: Array
    value: Array
    sd: Array
    nis: Array
    dof: Array
    outcome: NDArray[np.uint8]

    def count(self, outcome: str) -> int:
        """How many readings met that outcome."""
        if outcome not in OUTCOMES:
            raise ValueError(f'no outcome is called "{outcome}"; there are {", ".join(OUTCOMES)}.')
        return int(np.count_nonzero(self.outcome == OUTCOMES.index(outcome)))

    @property
    def used(self) -> Mask:
        """Mask of the readings that corrected the state."""
        return self.outcome == 0

    @property
    def in_words(self) -> str:
        """What became of the readings."""
        met = [name for name in OUTCOMES if name in ("used", "rejected") or self.count(name)]
        return ", ".join(f"{self.count(name)} {name}" for name in met)

    def _shown(self) -> tuple[str, dict[str, object]]:
        axes = f"{self.value.shape[1]} axes, " if self.value.shape[1] > 1 else ""
        return f"Residuals{span(self.time_s)}, {often(self.time_s, 'readings')}: {axes}{self.in_words}", {}


@dataclass
class _Column:
    """Growing residual table of one sensor: time, NIS, components used, outcome, residuals, variances."""

    axes: int
    rows: Array = field(init=False)
    used: int = 0

    def __post_init__(self) -> None:
        self.rows = np.empty((1024, 4 + 2 * self.axes))

    def append(self, time_s: float, code: int, note: Array | None) -> None:
        self._make_room(self.used + 1)
        row = self.rows[self.used]
        if note is None:
            row[:] = np.nan
            row[2] = 0.0
        else:
            row[1:] = note
        row[0], row[3] = time_s, code
        self.used += 1

    def extend(self, times: Array, notes: Array) -> None:
        """Append readings that were used."""
        needed = self.used + len(times)
        self._make_room(needed)
        rows = self.rows[self.used : needed]
        rows[:, 1:] = notes
        rows[:, 0], rows[:, 3] = times, 0.0
        self.used = needed

    def _make_room(self, needed: int) -> None:
        if needed > len(self.rows):
            spare = np.empty((needed + len(self.rows) // 4 - len(self.rows), self.rows.shape[1]))
            self.rows = np.concatenate([self.rows, spare])

    def after(self, before: "_Column") -> "_Column":
        """This column, its first rows those of the one before."""
        joined = _Column(self.axes)
        joined.rows = np.concatenate([before.rows[: before.used], self.rows[before.used : self.used]])
        joined.used = len(joined.rows)
        return joined

    def residuals(self) -> Residuals:
        r, a = self.rows[: self.used], self.axes
        return Residuals(
            r[:, 0].copy(),
            r[:, 4 : 4 + a].copy(),
            np.sqrt(r[:, 4 + a :]),
            r[:, 1].copy(),
            r[:, 2].copy(),
            r[:, 3].astype(np.uint8),
        )


class Tape(Shown):
    """Everything a run writes down.

    Parameters
    ----------
    output_rate_hz : float or None
        At most so many track rows per second of mission, each at a reading or a fold; infinite: at all of them. None:
        at every sample of the drive, too, unless it is to be smoothed.
    smoothable : bool
        Keep the records that `navfilter.filter.rts_smoother.smooth_rows` needs; without them only the track and the
        residuals remain.
    memory_bytes : int
        In memory at most, of records and of rows each: an hour at 100 Hz has 95 MB of records. What becomes longer goes
        to a temporary file, and its rows with its records.

    Attributes
    ----------
    each_sample : bool
        There is a row at every sample of the drive.
    lent : bool
        Another run has begun from the state that it leads to.
    """

    def __init__(
        self, output_rate_hz: float | None = None, smoothable: bool = True, memory_bytes: int = 128 << 20
    ) -> None:
        if output_rate_hz is not None and not (isinstance(output_rate_hz, int | float) and output_rate_hz > 0.0):
            raise ValueError(f"output_rate_hz must be > 0, or None for every sample, found {output_rate_hz!r}.")
        self.interval_s = 0.0 if output_rate_hz is None else 1.0 / output_rate_hz - 1e-9
        self.smoothable, self._memory_bytes, self._expected = smoothable, memory_bytes, 0
        self.each_sample = output_rate_hz is None and not smoothable
        self.begin(None)

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"rows": len(self.row_times), "records": len(self.records) or None}
        rows["mission time"] = f"{self.row_times[0]:.1f} to {self.row_times[-1]:.1f} s" if self.row_times else None
        rows["kept for"] = "track and smoother" if self.smoothable else "track"
        return "Tape", rows | {name: column.residuals().in_words for name, column in self.columns.items()}

    def expect(self, rows: int) -> None:
        """So many rows are to come at most. Those of a run that is not smoothed are those of the track: they stay where
        they are written, in one piece.
        """
        self._expected = 0 if self.smoothable else rows

    def begin(self, layout: Any) -> None:
        """Start anew with a layout of the states; what was written before is forgotten."""
        self.given: Tape | None = None
        self.ended_s, self.lent = math.inf, False
        self._fresh(layout)

    def begin_again(self, layout: Any, time_s: float) -> None:
        """The run goes back to its start: what it has given out until this time [s] is kept beside what it now writes.

        There the tape before is `given`, and that of an earlier time its `given`; their records are forgotten, for the
        smoother works on what is written last, unless another run goes on from them (`lent`).
        """
        before = copy.copy(self)
        before.ended_s = time_s
        if not self.lent:
            before.records, before._heads = RecordStore(0), array("h")
        self.given, self.lent = before, False
        self._fresh(layout)

    @property
    def times_begun(self) -> int:
        """How often the run has begun again so far."""
        return 0 if self.given is None else self.given.times_begun + 1

    def as_of(self, times_begun: int) -> "Tape":
        """The tape as it was when the run had begun again so often, with its records where another was `lent` them."""
        return self if self.given is None or self.times_begun <= times_begun else self.given.as_of(times_begun)

    def _fresh(self, layout: Any) -> None:
        self.records = RecordStore(self._memory_bytes)
        self._heads = array("h")  # a, m, b, start, deviation of each record
        row = self._row_size(layout.size) if self._expected else 0
        self.rows = RecordStore(sys.maxsize if row else self._memory_bytes, row * self._expected)
        self.row_times = array("d")
        self.row_records = array("q")  # the record after which the row holds
        self.row_layouts = array("q")  # the layout of each row
        self.row_unnoticed = array("d")  # see `navfilter.kernels.fault_bank`: two of each row
        self.columns: dict[str, _Column] = {}
        self.models: dict[str, list[tuple[float, Any]]] = {}
        self.layouts: list[Any] = [layout]
        self.axes: list[tuple[float, str, str]] = []  # changes of the drive's axes: time, axis, condition

    def record(self, record: Array, axes: int, dims: Ints) -> None:
        """Write one record: compound transition, block tick, and what the correction was (see
        ``kalman.smooth_record``).
        """
        if self.smoothable:
            self.records.new(record.size)[:] = record
            self._heads.extend((axes, *dims[[2, 3, 4, 7]].tolist()))

    def change(self, M: Array) -> None:
        """Write down that the error state became M times what it was: another layout of the states from here on."""
        if self.smoothable:
            self.records.new(M.size)[:] = M.reshape(-1)
            self._heads.extend((CHANGE, *M.shape, 0, 0))

    @property
    def heads(self) -> NDArray[np.int16]:
        """Of each record: axes, size of the head, size and start of the ticked block, place of a deviation; or
        `CHANGE`, rows and columns of the matrix, 0, 0. A view: while it is held, no record can be written.
        """
        return np.frombuffer(self._heads, np.int16).reshape(-1, 5)

    def row(
        self,
        time_s: float,
        nav: Array,
        x: Array,
        P: Array,
        present: Array | None = None,
        unnoticed: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Note the state at this time; the last note of a time stands, and times closer than the output interval are
        skipped.

        The whole covariance, as its lower triangle, is kept only where the smoother needs it; elsewhere `present`,
        where samples have not been folded into P yet (`Estimate.present`). `unnoticed`: what faults that nobody has
        noticed may have done to position [m] and heading [rad].
        """
        n = len(P)
        size = self._row_size(n)
        if self.row_times and time_s == self.row_times[-1]:
            out = self.rows[-1]
            if out.size != size:
                self.rows.drop()
                out = self.rows.new(size)
            self.row_records[-1], self.row_layouts[-1] = len(self.records), len(self.layouts) - 1
            self.row_unnoticed[-2:] = array("d", unnoticed)
        else:
            if self.row_times and time_s - self.row_times[-1] < self.interval_s:
                return
            out = self.rows.new(size)
            self.row_times.append(time_s)
            self.row_records.append(len(self.records))
            self.row_layouts.append(len(self.layouts) - 1)
            self.row_unnoticed.extend(unnoticed)
        out[:17] = nav
        out[17 : 17 + x.size] = x
        if self.smoothable:
            out[8 + n :] = P[triangle(n)]
        elif present is not None:
            out[17 + x.size :] = present
        else:
            out[17 + x.size : 98 + x.size] = P[:9, :9].reshape(-1)
            out[98 + x.size :] = P.diagonal()[9:]

    def output(self, longest: int, info: Array) -> tuple[Array, Array, int]:
        """Where the kernel `run_batch` writes rows, and records of which one of the `longest` finds room at least; and
        how many of the rows stand there: the last one, if it may be written again. Of that `info` says when it holds.
        """
        size, records = self._row_size(self.layouts[-1].size), np.empty(0)
        if self.records.in_file and not self.rows.in_file:
            self.rows.to_file()  # it is a long run, which needs its memory for other things
        flat, held = self.rows.tail(size, last=True)
        if held:
            info[0] = self.row_times[-1], self.row_records[-1] - len(self.records), *self.row_unnoticed[-2:]
        if self.smoothable:
            records, _ = self.records.tail(longest)
        self._held = int(held)
        return flat[: len(flat) // size * size].reshape(-1, size), records, self._held

    def _row_size(self, n: int) -> int:
        return 8 + n + (n * (n + 1) // 2 if self.smoothable else 72 + n)

    def extend(self, given: tuple[Array, Array, Array, Ints], count: int, records: int) -> None:
        """As many calls of `record` and `row`, in this order of time, by what `run_batch` has written.

        Parameters
        ----------
        given : tuple of ndarray
            Rows, and records, where `output` has said; when each row holds and after how many of the records; sizes and
            heads of the records.
        count, records : int
            How many there are of rows and records.
        """
        rows, info, _, heads = given
        before, again = len(self.records), 0
        if records:
            self.records.took(heads[:records, 0])
            self._heads.frombytes(heads[:records, 1:].astype(np.int16).tobytes())
        if count and self.row_times and info[0, 0] == self.row_times[-1]:
            self.row_records[-1], self.row_layouts[-1], again = before + int(info[0, 1]), len(self.layouts) - 1, 1
            self.row_unnoticed[-2:] = array("d", info[0, 2:])
        if again > self._held:  # it stands in another chunk
            flat = rows[:count].flatten()
            self.rows.drop()
            self.rows.extend(flat, np.full(count, rows.shape[1]))
        else:
            self.rows.took(np.full(count - again, rows.shape[1]))
        self.row_times.frombytes(info[again:count, 0].tobytes())
        self.row_unnoticed.frombytes(info[again:count, 2:].tobytes())
        self.row_records.frombytes((before + info[again:count, 1].astype(np.int64)).tobytes())
        self.row_layouts.extend([len(self.layouts) - 1] * (count - again))

    def column(self, name: str, axes: int) -> _Column:
        """The residual table of a sensor."""
        return self.columns.setdefault(name, _Column(axes))

    def residuals(self) -> dict[str, Residuals]:
        """Residuals of every sensor that was heard of, of the last time that the run began."""
        return {name: column.residuals() for name, column in self.columns.items()}

    def append(self, other: "Tape", records: int | None = None, rows: int | None = None) -> None:
        """Everything that another tape holds for the smoother, or the first of its records and rows."""
        before, layouts = len(self.records), len(self.layouts)
        records = len(other.records) if records is None else records
        rows = len(other.row_times) if rows is None else rows
        for mine, its, count in ((self.records, other.records, records), (self.rows, other.rows, rows)):
            for flat, sizes in its.pieces(count):
                mine.extend(flat, sizes)
        self._heads.extend(other._heads[: 5 * records])
        self.row_times.extend(other.row_times[:rows])
        self.row_unnoticed.extend(other.row_unnoticed[: 2 * rows])
        self.row_records.extend(array("q", [before + number for number in other.row_records[:rows]]))
        self.row_layouts.extend(array("q", [layouts + number for number in other.row_layouts[:rows]]))
        self.layouts += other.layouts
        self.columns |= other.columns

    # ---------------------------------------------------------------- as first given out
    def first_notes(self, name: str, first: int) -> Array:
        """What was noted of the readings of a sensor, from a number on: rows of time, NIS, components used, outcome,
        residuals and their variances.
        """
        column = self.columns[name]
        if self.given is None:
            return column.rows[first : column.used]
        then = self.given.columns[name].used
        after = column.rows[max(first, then) : column.used]
        return np.concatenate([self.given.first_notes(name, first), after]) if first < then else after

    def first_rows(self) -> "list[tuple[Tape, range]]":
        """Where the rows stand that were the first ones of their times, in order: a tape, and its rows."""
        if self.given is None:
            return [(self, range(len(self.row_times)))]
        before = self.given
        # a row of the moment itself was given out before, or it was not
        after = bisect.bisect_right if before.row_times[-1] == before.ended_s else bisect.bisect_left
        begin = after(self.row_times, before.ended_s)
        return [*before.first_rows(), (self, range(begin, len(self.row_times)))]

    def first_residuals(self) -> dict[str, Residuals]:
        """Residuals of every sensor, those before the run began again as they were then.

        A reading leaves one row whenever it is fed, so that as many rows are repeated as there were.
        """
        return {name: column.residuals() for name, column in self._first_columns().items()}

    def _first_columns(self) -> dict[str, _Column]:
        if self.given is None:
            return self.columns
        before = self.given._first_columns()
        return {name: column.after(before[name]) if name in before else column for name, column in self.columns.items()}

    def first_axes(self) -> list[tuple[float, str, str]]:
        """Changes of the conditions of the drive's axes, as they were first noticed."""
        if self.given is None:
            return self.axes
        now_s = self.given.ended_s
        before = [change for change in self.given.first_axes() if change[0] <= now_s]
        return [*before, *(change for change in self.axes if change[0] > now_s)]

    def first_models(self) -> dict[str, list[tuple[float, Any]]]:
        """Error models by sensor, and from when they were in force before anything was run again."""
        if self.given is None:
            return self.models
        result, now_s = dict(self.given.first_models()), self.given.ended_s
        for name, history in self.models.items():
            before = result.get(name, [])
            there = [model for time_s, model in history if time_s <= now_s][-1:]
            adopted = [(now_s, model) for model in there if not before or model != before[-1][1]]
            result[name] = [*before, *adopted, *((t, model) for t, model in history if t > now_s)]
        return result

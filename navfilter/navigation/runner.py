"""Many samples and readings in stretches: one call of a kernel takes them until something is Python's.

What the parts of a navigator see of it: the runner, and the early re-run.

The last seconds of a run: what arrived, and the state now and then, so that a late reading takes its place in
time.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from navfilter.faults import noise_scale, sensor_bias
from navfilter.faults.clocks.imu_clock import ImuClockMonitor
from navfilter.faults.noise_scale import NoiseScale
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.events import Event, Measurement, Outcome
from navfilter.filter.filter import Filter
from navfilter.filter.imu_intake import joined
from navfilter.filter.input_buffer import AS_BEFORE, BEFORE, FROZEN, SENSOR, TIME_S, VALUES, InputBuffer
from navfilter.filter.records import Tape
from navfilter.filter.sensor_channel import Channel, usable
from navfilter.foundation.arrays import Array, ArrayLike, Ints, Mask
from navfilter.foundation.mapped_arrays import give_back
from navfilter.foundation.state_values import copied
from navfilter.kernels import batch as kernels
from navfilter.kernels import open_loop_residual, strapdown
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.alternative import Alternative
from navfilter.navigation.memory import NavigatorMemory
from navfilter.navigation.recorded_inputs import MeasurementSequence
from navfilter.navigation.waiting import MeasurementQueue


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


class Run(Protocol):
    """A run over a vehicle's inputs: a `Navigator`.

    Attributes
    ----------
    filter : Filter
    learning : LearningSchedule
    history : History or None
        None: nothing may come late.
    clock : ImuClockMonitor
    sensor_monitors : dict of str to SensorMonitor
    queue : MeasurementQueue
    early_rerun
        What runs the first minutes again (`navfilter.navigation.early_rerun`).
    fast_paths
        By sensor, what takes its ordinary readings live.
    alternative : Alternative
        The second filter beside it while its unit is in doubt.
    change_count : int
        Counts all that changes otherwise than by ordinary inputs.
    memory : NavigatorMemory
        All that changes in order; setting one goes back (or on) to it.
    """

    vehicle: Vehicle
    start: Start
    filter: Filter
    learning: LearningSchedule
    history: History | None
    clock: ImuClockMonitor
    sensor_monitors: dict[str, SensorMonitor]
    queue: MeasurementQueue
    early_rerun: Any
    alternative: Alternative
    change_count: int
    memory: NavigatorMemory

    @property
    def fast_paths(self) -> Mapping[str, Any]:
        """By sensor."""

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""

    @property
    def offset_s(self) -> float:
        """By how much stamps are moved since the clock was set [s]."""

    def step_samples(self, samples: Array) -> None:
        """Take samples of the drive: rows of time and six values."""

    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Take a measurement that has arrived."""

    def correct_now(self, reading: Measurement) -> Outcome:
        """Take a measurement now."""

    def repeat_input(self, item: Array | Measurement) -> None:
        """Take an input as another run has."""

    def process(self, item: Array | Measurement) -> Outcome | None:
        """Give samples or a measurement, in order, to filter and learning."""

    def finish(self) -> None:
        """Take the measurements that still wait: no more samples come."""

    def on_event(self, event: Event) -> None:
        """Show learning what the filter does."""


Output = tuple[Array, Array, Array, Ints, Array]
Hearing = tuple[Array, Array, Ints, Array]
#: So many readings and samples are laid out at a time: 4 MB.
READINGS, SAMPLES = 4096, 1 << 16
#: Progress is told after so many readings.
SHOWN = 512
#: After these the kernel is called again, once Python has done what is due.
GOES_ON = kernels.FULL, kernels.DONE, kernels.HEED, kernels.LEARN, kernels.LOOK
#: So many rows and records are written before the tape hears of them.
ROWS = 4096
#: Where each sample has a row, so many are taken at a time: what they leave, 4 kB each, is to stay in the second cache.
TRACED = 16


class BatchRunner:
    """Takes a navigator through many inputs, as `Navigator.step_samples` and `Navigator.correct` would, to the last
    bit.

    Parameters
    ----------
    nav : Run
        Without a history, and without threads.
    times, values : ndarray, shapes (n,) and (n, 6)
        Samples of the drive.
    readings : MeasurementSequence
    done : int
        Samples before the start: they are not taken.
    before : ndarray of int, optional
        Samples that come before each reading; default: by their times.
    """

    def __init__(
        self,
        nav: Run,
        times: Array,
        values: Array,
        readings: MeasurementSequence,
        done: int = 0,
        before: Ints | None = None,
    ) -> None:
        self.nav, self._times, self._values, self._readings = nav, times, values, readings
        self._lead_s = np.array([nav.filter.channels[name].lead_s for name in readings.names])
        self._waits = before is None and bool(self._lead_s.any())
        if before is None:
            nav.clock = ImuClockMonitor(nav.filter.period_s, live=False)  # a recording is in the order of its stamps
        if self._waits:
            self._readings = readings = readings.later(self._lead_s[readings.sensor])
        self._ends = self._samples_before() if before is None else before.astype(np.int64)
        self._channels = list(nav.filter.channels.values())
        self._watches = self._watched()
        most = max([1, *(channel.axes for channel in self._channels)])
        self._notes = np.empty((READINGS, 3 + 2 * most))
        self._same = self._repeated()
        monitor = nav.filter.monitor
        driven = bool(nav.filter.plan[-1, kernels.STEPS]) and monitor.in_batches
        # beams have more directions than an ear of the kernel holds
        heard = all(
            listener.series_kernel.size == open_loop_residual.EAR for listener in nav.learning.listeners.values()
        )
        self._steady = driven and heard and nav.learning.rest is None
        noted = max([1 + most, *(len(listener.memory.ring) for listener in nav.learning.listeners.values())])
        self._opened = np.empty((READINGS, 1 + noted))
        self.at, self.done, self._kept, self._until = 0, done, done, len(self._ends)
        self._begin = self._end = 0
        self._info, self._heads = np.empty((ROWS, 4)), np.empty((ROWS, 6), np.int64)

    def _watched(self) -> list[SensorMonitor]:
        return [self.nav.sensor_monitors[name] for name in self._readings.names]

    def _repeated(self) -> Mask:
        """Whether the value of a reading is, bit for bit, that of the one of its sensor before."""
        readings = self._readings
        same = np.zeros(len(readings.time_s), bool)
        for i, values in enumerate(readings.values):
            mine = np.flatnonzero(readings.sensor == i)
            bits = np.ascontiguousarray(values).view(np.int64)[readings.row[mine]]
            same[mine[1:]] = (bits[1:] == bits[:-1]).all(axis=1)
        return same

    def run(self, progress: Callable[[int], object] | None = None) -> None:
        """Take all readings, then the samples behind the last; `progress` is told how many readings, now and then."""
        self.run_until(len(self._ends), len(self._times), progress)
        self._finish()

    def run_until(self, readings: int, samples: int, progress: Callable[[int], object] | None = None) -> None:
        """As `run`, up to a number of readings, and then of samples; those may be taken that come before the next."""
        shown, self._until = self.at, readings
        while self.at < self._until:
            if progress is not None and self.at - shown >= SHOWN:
                progress(self.at - shown)
                shown = self.at
            why = self._advance() if self.possible else kernels.NEXT
            if self.at == self._until:
                break
            self._one(why)
            if self._waits and self.nav.offset_s:
                self._hand_over()
        self._keep_samples(self.done)
        for begin in range(self.done, samples, 100_000):
            self._feed(self._block(begin, min(begin + 100_000, samples)))
        self.done = self._kept = max(self.done, samples)

    @property
    def possible(self) -> bool:
        """Whether the kernel can take anything: nobody has to be asked between samples or after each reading."""
        nav = self.nav
        asked = nav.filter.memory.intake.offset_s or nav.learning.is_waiting or nav.alternative.is_alive
        return self._steady and not asked

    def _feed(self, samples: Array) -> None:
        self.nav.step_samples(samples)

    def _finish(self) -> None:
        self.nav.finish()

    # ---------------------------------------------------------------- one reading, by Python
    def _one(self, why: int) -> None:
        """The next reading, from where the kernel left it."""
        at = self.at
        end = int(self._ends[at])
        self._keep_samples(self.done)
        if end > self.done:
            self._feed(self._block(self.done, end))
        self.done = self._kept = max(self.done, end)
        if why == kernels.JUDGED:
            self.nav.learning.buffer_input(self._reading(at, self._watches[self._readings.sensor[at]].stuck))
            self._conclude(int(self._readings.sensor[at]), float(self._readings.time_s[at]))
        else:
            self._correct(at)
        self.at = at + 1

    def _correct(self, at: int) -> None:
        given = self._readings
        if self._waits and self._lead_s[given.sensor[at]]:
            self.nav.correct_now(self._reading(at))
        else:
            self.nav.correct(given.names[given.sensor[at]], float(given.stamp_s[at]), given.value(at), given.sd(at))

    def _samples_before(self) -> Ints:
        before = np.searchsorted(self._times, self._readings.time_s + 1e-9, side="right").astype(np.int64)
        give_back(self._times)
        return before

    def _hand_over(self) -> None:
        """The clock has been set: stamps mean another time from now on, but not those of readings that wait already."""
        given, at = self._readings, self.at
        lead_s = self._lead_s[given.sensor]
        arrived = (lead_s > 0.0) & (given.time_s - lead_s <= given.time_s[at - 1])
        self._until -= at + int(np.count_nonzero(arrived[at : self._until]))
        for k in at + np.flatnonzero(arrived[at:]):
            self.nav.queue.put(self._reading(int(k)))
        self._readings = given.later(-lead_s, at + np.flatnonzero(~arrived[at:]))
        self._ends = self._samples_before()
        self.at, self._waits, self._steady = 0, False, False

    def _reading(self, at: int, frozen: bool = False) -> Measurement:
        """One that the kernel has taken, as the run would have had it."""
        given = self._readings
        value = np.array(given.value(at), dtype=np.float64).reshape(-1)
        name, same = given.names[given.sensor[at]], bool(self._same[at])
        return Measurement(name, float(given.time_s[at]), value, given.sd(at), frozen, same)

    def _keep_samples(self, end: int) -> None:
        """Let learning keep those that the kernel has taken."""
        if end > self._kept and self.nav.learning.beginning is not None:
            self.nav.learning.buffer_input(self._block(self._kept, end))
        self._kept = max(self._kept, end)

    def _conclude(self, sensor: int, time_s: float) -> None:
        """What follows from a verdict by which the reading was not used."""
        nav, watch, name = self.nav, self._watches[sensor], self._readings.names[sensor]
        correction = nav.filter.concluded(nav.filter.channels[name], time_s, watch.stuck, nav.on_event)
        nav.on_event(correction)
        nav.filter.handle_pending(nav.on_event)
        of = correction.outcome
        watch.on_outcome(of.status, time_s, of.nis, of.dof, nav.filter.nav)

    def _block(self, begin: int, end: int) -> Array:
        block = np.empty((end - begin, 7))
        block[:, 0], block[:, 1:] = self._times[begin:end], self._values[begin:end]
        give_back(self._times, self._values)
        return block

    # ---------------------------------------------------------------- many, by the kernel
    def _lay_out(self) -> None:
        """The next readings and samples, as the kernel takes them."""
        given, at = self._readings, self.at
        last = int(np.searchsorted(self._ends, self.done + SAMPLES, side="right"))
        end = min(max(last, at + 1), at + READINGS, self._until)
        self._begin, self._end, self._first, self._stepped = at, end, self.done, 0
        self._samples = self._block(self.done, max(self.done, int(self._ends[end - 1])))
        self._stamps = self._samples[:, 0].copy()  # those of the samples become steps
        which, same = given.sensor[at:end], self._same[at:end]
        self._good, own = np.zeros(end - at, bool), any(sds is not None for sds in given.sds)
        read: list[tuple[Ints, Array]] = []
        self._variances = np.full((end - at if own else 1, self._notes.shape[1] // 2), np.nan)
        for i, channel in enumerate(self._channels):
            if not channel.spot[kernels.EQUATION]:
                continue
            mine, sds = np.flatnonzero(which == i), given.sds[i]
            z, good = channel.sensor.read_all(given.rows(i, at + mine))
            if channel.sensor.observes.corrects == "position":
                dived = np.diff(given.time_s[mine + at], prepend=channel.memory.used_s) > channel.dive_s
                good = good & ~same[mine] & ~dived  # what a fix is worth then is Python's to judge
            self._good[mine] = good
            read.append((mine, z))
            for k in mine[good].tolist() if own else ():
                sd = None if sds is None else sds[given.row[at + k]]
                if sd is not None:
                    self._good[k] = usable(sd, channel.sensor)
                    if self._good[k]:
                        self._variances[k, : channel.axes] = np.resize(np.square(np.ravel(sd)), channel.axes)

        self._z = np.full((end - at, max((z.shape[1] for _, z in read), default=1)), np.nan)
        for mine, z in read:
            self._z[mine, : z.shape[1]] = z

    def _advance(self) -> int:
        """As far as the kernel comes; why it ended."""
        why = kernels.FULL
        while why in GOES_ON and self.at < self._until and self.possible:
            if not self._begin <= self.at < self._end:
                self._lay_out()
            why = self._call()
            if why == kernels.HEED:
                self._heed()
            elif why == kernels.LEARN:
                for change in self.nav.learning.learn(self._readings.names[self._readings.sensor[self.at - 1]]):
                    self.nav.filter.adopt(change, self.nav.on_event)
            if why in (kernels.LEARN, kernels.LOOK):
                self.nav.filter.handle_pending(self.nav.on_event)
        return kernels.NEXT if why in GOES_ON else why

    def _hearing(self) -> Hearing:
        """What is listened with; the first is empty where nobody does."""
        learning = self.nav.learning
        ears = np.zeros((len(self._channels), open_loop_residual.EAR))
        for i, channel in enumerate(self._channels):
            ears[i] = learning.ear(channel.name)
        return learning.feedback, ears, np.array([channel.places for channel in self._channels]), self._opened

    def _heed(self) -> None:
        """Act on what the kernel has come upon in the samples."""
        filter, told = self.nav.filter, self.nav.on_event
        filter.correct_stationary(told)
        if filter.monitor.has_findings(filter.memory):
            filter.act_on_imu(told)

    def _call(self) -> int:
        filter, given = self.nav.filter, self._readings
        part = slice(self._begin, self._end)
        memory, intake, tape = filter.memory, filter.memory.intake, filter.tape
        for channel in self._channels:
            channel.gate[:] = channel.limits
        now = np.array([memory.time_s, memory.sample_s, intake.before_s, _last(tape), *filter.unnoticed])
        cursor = np.zeros(kernels.CURSOR, np.int64)
        cursor[: kernels.GAPS] = self.at - self._begin, self.done - self._first, memory.unfolded
        cursor[kernels.STEPPED] = self._stepped
        heard = np.array([(c.period_s, _until_s(c), c.count, c.lead_s) for c in self._channels], dtype=np.float64)
        watched, scattered = np.array([watch.figures for watch in self._watches]), self._scattered()
        out, hearing, recent = self._output(cursor), self._hearing(), self._recent(memory.recent)
        cursor[kernels.NEWEST] = kernels.MORE_RECENT if len(recent) else 0
        first = cursor[kernels.READING], cursor[kernels.SAMPLE]
        why = int(
            kernels.run_batch(
                now,
                cursor,
                self._settings(),
                filter.bench,
                filter.plan,
                heard,
                watched,
                scattered,
                (memory.nav, memory.x, memory.P, memory.acc),
                (
                    *(memory.drv, filter.Phid, filter.Qd, filter.drive_output, recent),
                    *(memory.monitor.imu, filter.drive_sd, filter.monitor.sample_limits),
                ),
                self._samples,
                self._stamps,
                filter.intake.limits,
                hearing,
                (
                    *(given.time_s[part], given.sensor[part], self._ends[part] - self._first, self._good),
                    *(self._same[part], self._z, self._variances, self._notes),
                ),
                out,
            )
        )
        if len(recent):
            newest = int(cursor[kernels.NEWEST])
            memory.recent = recent[newest : newest + len(memory.recent)].copy()
        for channel, row in zip(self._channels, scattered[0], strict=False):
            if channel.faults.scatters:
                channel.faults.scatter = NoiseScale.of(row[: noise_scale.size(channel.axes)].copy())
        self._written(now, cursor, heard, watched, first, why, out)
        self._overheard(hearing[1], int(first[0]))
        return why

    def _scattered(self) -> tuple[Array, Array]:
        """What is remembered and known of those that scatter by more than they should; no rows where none does."""
        if not any(channel.faults.scatters for channel in self._channels):
            return np.zeros((0, 1)), np.zeros((0, 1))
        most = max(channel.axes for channel in self._channels)
        kept, facts = np.zeros((2, len(self._channels), max(noise_scale.size(most), noise_scale.facts_size(most))))
        for i, channel in enumerate(self._channels):
            if channel.faults.scatters:
                own, known = noise_scale.noted(channel), noise_scale.facts(self.nav.filter, channel)
                kept[i, : own.size], facts[i, : known.size] = own, known
        return kept, facts

    @staticmethod
    def _recent(recent: Array) -> Array:
        """The drive's last samples, with room before them for new ones."""
        return np.concatenate([np.zeros((kernels.MORE_RECENT, 7)), recent]) if len(recent) else recent

    def _settings(self) -> Array:
        """Limits and periods, see `navfilter.kernels.batch`."""
        filter, learning, tape = self.nav.filter, self.nav.learning, self.nav.filter.tape
        gap_s, doubt_s = filter.intake.spans
        interval_s = math.inf if tape is None else tape.interval_s
        steps, gravity = filter.memory.drv[strapdown.INCREMENTS], filter.vehicle.drive.gravity
        spans = filter.period_s, filter.ahead_s, filter.fold_every, gap_s, doubt_s, learning.early_s, interval_s
        due = filter.stationary_after, filter.memory.monitor.look_s
        return np.array([*spans, steps, learning.learning_s, gravity, *due])

    def _output(self, cursor: Ints) -> Output:
        """Where rows go, the last one perhaps again; when they hold; records, what each is; a trace of samples."""
        filter, tape = self.nav.filter, self.nav.filter.tape
        rows, records = np.empty((2, 80 + 2 * filter.layout.size)), np.empty(0)  # without a tape one row is written
        if tape is not None:
            rows, records, cursor[kernels.ROWS] = tape.output(int(filter.plan[-1, kernels.RECORD]), self._info)
        each, m = tape is not None and tape.each_sample, filter.memory.acc.shape[1]
        trace = np.empty((TRACED if each else 0, 8 + m + 2 * m * m + strapdown.WIDE))
        return rows[:ROWS], self._info, records, self._heads, trace

    def _written(
        self, now: Array, cursor: Ints, heard: Array, watched: Array, first: tuple[int, int], why: int, out: Output
    ) -> None:
        """Put what the kernel left into the memory of the run, and on its tape."""
        filter, given = self.nav.filter, self._readings
        memory, intake, tape = filter.memory, filter.memory.intake, filter.tape
        memory.time_s, memory.sample_s, intake.before_s = now[:3].tolist()
        memory.unfolded = int(cursor[kernels.UNFOLDED])
        used, first_at = slice(first[0], int(cursor[kernels.READING])), self._begin + first[0]
        self.at, self.done = self._begin + used.stop, self._first + int(cursor[kernels.SAMPLE])
        if cursor[kernels.SAMPLE] > first[1]:
            filter.intake.taken(int(cursor[kernels.GAPS]))
        self._stepped = int(cursor[kernels.STEPPED])
        judged = int(given.sensor[self.at]) if why == kernels.JUDGED else -1
        which, times = given.sensor[first_at : self.at], given.time_s[first_at : self.at]
        for i, (channel, watch) in enumerate(zip(self._channels, self._watches, strict=True)):
            channel.count = int(heard[i, kernels.TICKS])
            mine = np.flatnonzero(which == i)
            if len(mine) or i == judged:
                watch.caught_up(watched[i], given.value(self.at if i == judged else first_at + mine[-1]).tobytes())
            for k in mine[[0, -1]] if len(mine) else ():
                channel.use(float(times[k]))
            if tape is not None and len(mine):
                notes = self._notes.take(used.start + mine, axis=0)[:, : 3 + 2 * channel.axes]
                tape.columns[channel.name].extend(times[mine] - channel.lead_s, notes)
        if tape is not None:
            tape.extend(out[:4], *cursor[[kernels.ROWS, kernels.RECORDS]].tolist())
        kept, part = self.nav.learning.beginning, slice(first_at, self.at)
        if kept is not None and len(times):  # none is frozen: the kernel leaves those to Python
            ends, place = np.maximum(self._ends[part], self._kept), np.array([kept.names.index(n) for n in given.names])
            samples = self._block(self._kept, int(ends[-1]))
            own = [given.sd(at) for at in range(first_at, self.at)] if any(s is not None for s in given.sds) else []
            values = {int(place[i]): given.rows(i, first_at + np.flatnonzero(which == i)) for i in set(which.tolist())}
            kept.extend(samples, ends - self._kept, times, place[which], self._same[part], values, own)
        self._kept = self.done if kept is None else int(ends[-1]) if len(times) else self._kept

    def _overheard(self, ears: Array, first: int) -> None:
        """What was heard of the readings that were used, from `first` on."""
        which = self._readings.sensor[self._begin : self.at]
        for i, channel in enumerate(self._channels):
            listener = self.nav.learning.listeners.get(channel.name)
            mine = np.flatnonzero(which[first:] == i) + first if listener is not None else ()
            if listener is not None and len(mine):
                heard = self._opened[mine, : 1 + len(listener.memory.ring)]
                listener.caught_up(ears[i], heard[:, 0], heard[:, 1:])


class Rerun(BatchRunner):
    """Takes a navigator once more through inputs that it has had: the sensors' health is not counted again.

    Parameters
    ----------
    nav : Run
    inputs : InputBuffer
    """

    def __init__(self, nav: Run, inputs: InputBuffer) -> None:
        samples, heads = inputs.samples.whole(inputs.samples.count), inputs.readings.whole(inputs.readings.count)
        flat, names = inputs.values.whole(inputs.values.count)[:, 0], tuple(nav.filter.channels)
        self._frozen, self._as_before = heads[:, FROZEN] != 0.0, heads[:, AS_BEFORE] != 0.0
        sensor = np.array([names.index(name) for name in inputs.names], np.int64)[heads[:, SENSOR].astype(np.int64)]
        ends = heads[:, VALUES].astype(np.int64)
        begins, row = np.append(0, ends)[:-1], np.empty(len(heads), np.int64)
        values: list[Array | list[Array]] = []
        sds: list[list[Any] | None] = []
        for i in range(len(names)):
            mine = np.flatnonzero(sensor == i)
            row[mine] = np.arange(mine.size)
            sizes = ends[mine] - begins[mine]
            if mine.size and (sizes == sizes[0]).all():
                values.append(flat[begins[mine, None] + np.arange(sizes[0])])
            else:
                values.append([flat[begins[k] : ends[k]] for k in mine])
            own = [inputs.sds.get(k) for k in mine.tolist()] if inputs.sds else []
            sds.append(own if any(sd is not None for sd in own) else None)
        times, before = heads[:, TIME_S].copy(), heads[:, BEFORE].astype(np.int64)
        given = MeasurementSequence(times, times, sensor, row, names, tuple(values), tuple(sds))
        super().__init__(nav, samples[:, 0].copy(), samples[:, 1:].copy(), given, 0, before)

    def _watched(self) -> list[SensorMonitor]:
        return [SensorMonitor(math.inf, math.inf) for _ in self._readings.names]

    def _repeated(self) -> Mask:
        return self._as_before

    def _lay_out(self) -> None:
        super()._lay_out()
        self._good[self._frozen[self._begin : self._end]] = False  # learning wants to hear of that

    def _feed(self, samples: Array) -> None:
        self.nav.process(samples)

    def _correct(self, at: int) -> None:
        self.nav.process(self._reading(at))

    def _reading(self, at: int, frozen: bool = False) -> Measurement:
        return super()._reading(at, bool(self._frozen[at]))

    def _finish(self) -> None:
        pass


def _until_s(channel: Channel) -> float:
    """Until when its readings are the kernel's [s]: none is where its errors are of another kind now, or go over."""
    known = channel.spot[kernels.EQUATION] and channel.predecessor is None
    return sensor_bias.as_usual_until_s(channel) if known else -math.inf


def _last(tape: Tape | None) -> float:
    """When the last row was written; NaN for none."""
    return tape.row_times[-1] if tape is not None and tape.row_times else math.nan

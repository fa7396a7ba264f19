"""An ordinary reading or sample live: one call of a kernel takes it, as in a replay one takes many."""

import ctypes
import math

import numpy as np

from navfilter.filter.events import Measurement, Outcome
from navfilter.filter.filter import Filter
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.input_buffer import PIECE, InputBuffer
from navfilter.foundation.arrays import AnyArray, Array, ArrayLike
from navfilter.kernels import batch, open_loop_residual, strapdown
from navfilter.learning.schedule import UNHEARD
from navfilter.navigation.runner import Run

_FLOAT, _made = np.dtype(np.float64), tuple.__new__  # a named tuple's own way takes twice as long
_NO_ROWS = np.zeros((1, 1))
_HELD = _FLOAT, np.dtype(np.int64)
_NOT_KEPT = 0, -1, 0  # by the kernel


class PointerTable:
    """Arrays that a kernel is handed by where they stand.

    Parameters
    ----------
    count : int

    Attributes
    ----------
    table : ndarray of int, shape (count, 3)
        See `navfilter.kernels.batch.correct_reading`.
    """

    def __init__(self, count: int) -> None:
        self.table = np.empty((count, 3), np.int64)
        self._rows: list[tuple[int, int, int]] = [(0, 0, 0)] * count
        self._arrays: list[AnyArray | None] = [None] * count  # they live as long as they are in the table

    def take(self, arrays: tuple[AnyArray, ...], first: int = 0) -> None:
        """Take these in hand, from the first place on, instead of those that are there."""
        known = self._arrays
        others = [(k, array) for k, array in enumerate(arrays, first) if array is not known[k]]
        for k, array in others:
            known[k] = array
            if array.dtype not in _HELD:
                raise TypeError(f"kernels read numbers of float64 or int64, found {array.dtype}")
            # an array's own ways to say this take five times as long; of one that is not row by row nothing is said
            at = ctypes.addressof(ctypes.c_char.from_buffer(array.data)) if array.size else 0
            self._rows[k] = at, len(array) if array.ndim > 1 else 1, array.shape[-1]
        if others:
            self.table[:] = self._rows


class ImuFastPath:
    """Takes samples that come one by one, to the last bit as `History.feed` does, where nothing is to be decided but by
    the kernel: they follow each other, and neither a fold nor a checkpoint is due.

    Parameters
    ----------
    nav : Run
        With a history, and a drive of whose samples nothing is felt or learnt.
    """

    _memory: FilterMemory
    _kept: InputBuffer | None

    def __init__(self, nav: Run) -> None:
        assert nav.history is not None
        self._nav, self._history, self._as_of, self._most = nav, nav.history, -1, nav.filter.fold_every - 1
        self._hand = PointerTable(batch.HELD_FOR_SAMPLES)
        self._spans = np.array([*nav.filter.intake.spans, nav.filter.period_s])

    def take(self, samples: Array) -> bool:
        """Whether these are an ordinary sample (1, 7), and have been taken; else nothing has been done."""
        nav, history = self._nav, self._history
        # the first behind some that were missing ends that
        if len(samples) != 1 or nav.filter.memory.monitor.silent or nav.alternative.is_alive:
            self._as_of = -1
            return False
        if fresh := nav.change_count != self._as_of:
            self._is_ready()
        memory, kept = self._memory, self._kept
        intake = memory.intake
        shift, given = intake.offset_s, samples.copy()
        if memory.unfolded >= self._most or memory.time_s - history.marked_s >= history.RARE_S:
            why = batch.REFUSED
        else:
            at = -1 if kept is None else kept.samples.count % PIECE
            if not at and kept is not None:
                self._hand.take(kept.samples.room()[:1], batch.PIECE)
            why = batch.propagate_sample(self._hand.table, samples, intake.before_s, shift, at)
        if why == batch.REFUSED:
            self._as_of = -1  # what is done then, `changes` does not tell of
            return False
        time_s = given.item(0) + shift
        memory.time_s = memory.sample_s = intake.before_s = time_s
        memory.unfolded += 1
        if memory.recent.size:
            memory.recent = np.concatenate([samples, memory.recent[:-1]])
        if kept is not None:
            kept.samples.count += 1
        if fresh:
            nav.filter.intake.taken(0)
        history.inputs.append((given, shift))
        if nav.early_rerun.twin is not None:
            nav.early_rerun.advance_shadow(given)
        if why == batch.HEED:
            self._as_of = -1
            nav.filter.act_on_imu(nav.on_event)
        return True

    def _is_ready(self) -> None:
        """Take in hand what the kernel needs."""
        nav = self._nav
        filter, memory, kept = nav.filter, nav.filter.memory, nav.learning.beginning
        piece = _NO_ROWS if kept is None or not kept.samples.pieces else kept.samples.pieces[-1]
        arrays = (
            *(memory.nav, memory.x, memory.drv, self._spans, filter.intake.limits, filter.drive_sd),
            *(
                filter.monitor.sample_limits,
                memory.monitor.imu,
                memory.P,
                memory.acc,
                filter.Phid,
                filter.Qd,
                filter.drive_output,
            ),
            *(piece, filter.plan),
        )
        self._hand.take(arrays)
        self._memory, self._kept, self._as_of = memory, kept, nav.change_count


class MeasurementFastPath:
    """Takes the readings of one sensor, to the last bit as `Navigator.correct` does, where nothing is to be decided but
    by the kernel: they are in time, no clock is in doubt, and nothing was wrong with those before.

    Parameters
    ----------
    nav : Run
        With a history.
    name : str
    """

    _filter: Filter
    _memory: FilterMemory
    _kept: InputBuffer | None

    def __init__(self, nav: Run, name: str) -> None:
        assert nav.history is not None
        sensor = nav.vehicle.sensors[name]
        self._nav, self._name, self._history = nav, name, nav.history
        self._offset_s, self._read, self._reads = sensor.time_offset_s, sensor.read, sensor.reads
        most, size = sensor.plain
        self._facts, self._plain = np.zeros(batch.FACTS_SIZE), np.zeros(size)
        self._facts[batch.LARGEST], self._facts[batch.TILTED] = most, nav.vehicle.drive.gravity
        self._plain_size, self._as_of = sensor.reads if most > 0.0 else -1, -1
        self._waiting = nav.learning.worker.waiting
        self._hand = PointerTable(batch.HAND)

    def take(self, stamp_s: float, value: ArrayLike, busy: bool = False) -> Outcome | None:
        """What became of a reading; None where it is no ordinary one: then nothing has been done.

        Parameters
        ----------
        stamp_s, value
            As for `Navigator.correct`, without a standard deviation of its own.
        busy : bool
            Enough has been done before it already: a checkpoint can wait for the next one.
        """
        try:
            z, stamp_s = np.array(value, _FLOAT, ndmin=1), float(stamp_s)
        except (TypeError, ValueError):
            return None
        nav = self._nav
        if nav.change_count != self._as_of:
            if not self.is_ready():
                return None
            busy = True
        memory, watch, kept, size, raw = self._memory, self._watch, self._kept, len(z), z.tobytes()
        shift = memory.intake.offset_s
        time_s = stamp_s + (shift - self._offset_s)
        early_s = time_s - memory.time_s
        if raw == watch.value or not (early_s >= -batch.SAME_S and time_s - memory.sample_s <= self._ahead_s):
            return None
        if size < self._reads or z.ndim > 1 or not nav.clock.passes(self._name, stamp_s):
            return None
        looks = False
        if time_s >= self._due_s:
            looks_s = memory.monitor.look_s
            looks = time_s >= looks_s
            if self._is_early(time_s, looks_s, busy or looks):
                return self.take(stamp_s, value, True)  # from what is in hand now
            busy = True
        why, hand, place, full = batch.REFUSED, self._hand.table, _NOT_KEPT, False
        if kept is not None:
            place = kept.samples.count, kept.readings.count, kept.values.count
        if size == self._plain_size:
            read = self._plain
            why, nis, dof = batch.correct_reading(hand, memory.recent, z, read, True, time_s, memory.time_s, *place)
        if why == batch.REFUSED:
            asked = self._read(z)
            if asked is None:
                return None
            read = asked
            if kept is not None and not kept.has_room(size):
                place, full = _NOT_KEPT, True
            why, nis, dof = batch.correct_reading(hand, memory.recent, z, read, False, time_s, memory.time_s, *place)
            if why == batch.REFUSED:
                return None
        # ---- from here on it is taken
        memory.unfolded, watch.value = 0, raw
        if early_s > batch.SAME_S and memory.drv.item(strapdown.STARTED):
            memory.time_s = time_s
        given = _made(Measurement, (self._name, time_s, z, None, False, False))
        if full and kept is not None:
            kept.append(given)
            nav.change_count += 1  # the pieces in hand are others now
        elif kept is not None:
            kept.readings.count += 1
            kept.values.count += size
        if why == batch.JUDGED:
            outcome = self._judged(given, read)
            looks = looks or self._filter.monitor.has_pending
        else:
            outcome = _made(Outcome, ("used", nis, dof, False))
            if busy:
                self._channel.stuck = self._channel.stale = False
            if self._learning is not None:
                self._learning.odds[:] = self._ear[open_loop_residual.ODDS : open_loop_residual.MOUNT]
                if why == batch.LEARN:
                    self._learn()
                    busy = True
        if looks:
            self._filter.handle_pending(nav.on_event)
        self._history.inputs.append((given, shift))
        if nav.early_rerun.twin is not None:
            nav.early_rerun.advance_shadow(given)
        if self._waiting and not busy:
            nav.learning.worker.turn()
        return outcome

    def _judged(self, given: Measurement, read: Array) -> Outcome:
        """What becomes of a reading that a gate has refused; read: what the kernel has taken."""
        channel, nav = self._channel, self._nav
        channel.reading, channel.count = read.copy(), int(self._facts[batch.TICKED])
        correction = self._filter.concluded(channel, given.time_s, False, nav.on_event)
        nav.change_count += 1
        if nav.learning.listeners:  # nobody else: where the drive is cross-checked no reading comes here
            nav.on_event(correction)
        outcome = correction.outcome
        self._watch.on_outcome(outcome.status, given.time_s, outcome.nis, outcome.dof, self._memory.nav)
        return outcome

    def _learn(self) -> None:
        """Do what is due in learning behind a reading."""
        nav = self._nav
        nav.change_count += 1
        for change in nav.learning.learn(self._name):
            nav.filter.adopt(change, nav.on_event)

    def _is_early(self, time_s: float, looks_s: float, busy: bool) -> bool:
        """Do what comes before a reading of this time, and see when more of it is due, biases be looked at by the
        reading of `looks_s`; whether what is in hand has changed by that.
        """
        nav, history, learning = self._nav, self._history, self._nav.learning
        early_s = math.inf if self._kept is None else learning.early_s
        if early_s <= time_s:
            nav.early_rerun.before(time_s)
            same = nav.filter.memory is self._memory and learning.beginning is self._kept and not learning.is_waiting
            if not (same and learning.learning_s == self._facts[batch.LEARNT_S]):
                nav.change_count += 1
                return True
            early_s = learning.early_s
        elif not busy:  # one after the other
            history.ready(self._memory.time_s)
        self._due_s = min(looks_s, early_s, history.due_s)
        return False

    def exchange(self, other: "MeasurementFastPath") -> None:
        """Have in hand what that of another run has, and that this one's."""
        self._hand, other._hand = other._hand, self._hand

    def is_ready(self) -> bool:
        """Take in hand what a kernel needs, where its next reading may be an ordinary one."""
        nav = self._nav
        filter, learning = nav.filter, nav.learning
        channel, memory = filter.channels[self._name], filter.memory
        known, kept = channel.spot.item(batch.EQUATION), learning.beginning
        if (
            not (known and channel.faults.ordinary(channel.offset))
            or (channel.others and channel.predecessor is not None)
            or nav.queue.readings
            or memory.monitor.silent
            or nav.alternative.is_alive
        ):
            return False
        heard = learning.for_kernel(self._name) if learning.listeners else UNHEARD
        if heard is None:
            return False
        heads = values = _NO_ROWS
        if kept is not None:
            if not kept.values.pieces:
                return False
            heads, values = kept.readings.pieces[-1], kept.values.pieces[-1]
            self._facts[batch.KEPT_AS] = kept.names.index(self._name)
        self._filter, self._memory, self._channel, self._kept = filter, memory, channel, kept
        self._watch, self._ahead_s, self._due_s = nav.sensor_monitors[self._name], filter.ahead_s, -math.inf
        feedback, ear, ring, cursor, self._learning, learning_s = heard
        self._ear = ear
        facts = self._facts
        facts[batch.CHANNEL], facts[batch.TICK_S] = list(filter.channels).index(self._name), channel.period_s
        facts[batch.DIVE_S], facts[batch.LEARNT_S] = channel.dive_s, learning_s
        channel.gate[:] = channel.limits
        arrays = (
            *(filter.bench, memory.nav, memory.x, memory.drv, facts, feedback, ear, self._watch.figures),
            *(memory.P, memory.acc, filter.Phid, filter.Qd, filter.drive_output, ring, heads, values),
            *(filter.plan, channel.places, cursor),
        )
        self._hand.take(arrays)
        self._as_of = (
            -1 if channel.stuck or channel.stale else nav.change_count
        )  # after a reading that is not it is neither
        return True


def prompt_sample(nav: Run) -> ImuFastPath | None:
    """That of a navigator, where samples may be ordinary ones."""
    filter = nav.filter
    plain = nav.history is not None and nav.learning.rest is None and not filter.stationary_after
    return ImuFastPath(nav) if plain else None


def prompts(nav: Run) -> dict[str, MeasurementFastPath]:
    """Those of a navigator, by sensor: of readings that need not wait, where they may come late and no jump of the
    drive is looked for.
    """
    if nav.history is None:
        return {}
    return {name: MeasurementFastPath(nav, name) for name, sensor in nav.vehicle.sensors.items() if not sensor.lead_s}

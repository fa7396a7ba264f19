"""What is listened to of one sensor: its open-loop residuals, from which its error models are learnt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.foundation.display import Value
from navfilter.kernels import open_loop_residual
from navfilter.learning.axis_learner import NOTHING_KNOWN, LearnerMemory, learner_of, memories, recall
from navfilter.learning.background import Task, Worker
from navfilter.learning.learned_model import with_learnt
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import known_walk, known_white, learning_part
from navfilter.models.navigation_drift import FOUND_S, Drift
from navfilter.models.sensors import Sensor
from navfilter.models.vehicle import Vehicle
from navfilter.models.window_limits import LEAST, LONGEST_GAP

#: Another level is one that differs by more than this factor, as a variance [1] (chosen: with 1.5 it changes twice as
#: often).
ANOTHER = 2.0
#: The answer of a hop is taken so much later [s]: what learning may take on a slow machine, and little against the
#: half minute that is the least a hop learns from.
TAKEN_AFTER_S = 2.0
#: So many stretches that are left out are remembered: a window of an hour with one every four minutes.
LEFT_OUT = 16
NEVER = int(np.iinfo(np.int64).max)


@dataclass(frozen=True, eq=False, repr=False)
class ChannelSeries(Value):
    """Readings of one axis minus what an open loop would have predicted.

    Attributes
    ----------
    value : ndarray, shape (n,)
        One element per tick of the sensor [unit of the sensor]; NaN where there was no reading.
    drift : Drift
        Known noise of the slow navigation error in it.
    period_s : float
    white : float
        Known white variance in it.
    """

    value: Array
    drift: Drift
    period_s: float
    white: float

    def _shown(self) -> tuple[str, dict[str, object]]:
        known = int(np.count_nonzero(np.isfinite(self.value)))
        return f"ChannelSeries, {known} of {len(self.value)} ticks of {self.period_s:.4g} s", {}


@dataclass(frozen=True, eq=False)
class Hop:
    """What a hop learns from, fixed when it begins.

    Attributes
    ----------
    heard : ndarray, shape (axes or axes + 1, n)
        The newest ticks that it learns from, as the ring has them, oldest first; its last row where a drift needs it.
    left_out : ndarray of int, shape (LEFT_OUT, 2)
        As of the listener, from the first of these ticks.
    fresh : int
        Ticks that came since the hop before.
    taken : int
        Its answer is taken when so many ticks have been noted.
    """

    heard: Array
    left_out: Ints
    fresh: int
    taken: int

    def is_same(self, other: Hop) -> bool:
        """Whether another hop has the same answer."""
        return (
            (self.fresh, self.taken) == (other.fresh, other.taken)
            and np.array_equal(self.left_out, other.left_out)
            and np.array_equal(self.heard, other.heard, equal_nan=True)
        )


@dataclass
class OpenLoopMemory:
    """What a listener remembers.

    Attributes
    ----------
    ring : ndarray, shape (axes + 1, capacity)
        Open-loop residuals, one element per tick [unit of the sensor], and the force that was found while the vehicle
        pitched or rolled [m/s^2]; the tick with number k stands at ``k % capacity``.
    cursor : ndarray of int, shape (1,)
        Ticks noted so far.
    left_out : ndarray of int, shape (LEFT_OUT, 2)
        Stretches of ticks, first and end, that nothing is learnt from: the newest last.
    due : int
        The next hop comes when so many have been noted.
    heard : int
        Ticks that have been learnt from.
    level : float
        How many times as large as learnt the error is in the models in force, as a variance.
    odds : ndarray, shape (LEVELS,)
        How probable the levels of `navfilter.kernels.open_loop_residual` are.
    models : tuple of ErrorModel
        Of each axis, as learnt last.
    learners : tuple of LearnerMemory or None
        What the learner of each axis knows; None where nothing is learnt.
    hop : Hop or None
        The hop whose answer has not been taken yet.
    ended : bool
        What was learnt has been given up, and nothing is learnt any more.
    """

    SHARED: ClassVar = ("ring",)

    ring: Array
    cursor: Ints
    left_out: Ints
    due: int
    heard: int
    level: float
    odds: Array
    models: tuple[ErrorModel, ...]
    learners: tuple[LearnerMemory | None, ...]
    hop: Hop | None
    ended: bool


class OpenLoopSeries:
    """Notes the open-loop residuals of one sensor, and learns its error models from them.

    The series is the reading minus the prediction of an open loop (the filter's own, with everything fed back taken off
    again), so that it holds the sensor's error whole, beside a navigation error that wanders by the known noise of the
    inertial unit. What the filter believes of the sensor does not enter: no feedback can bias it.

    Parameters
    ----------
    name : str
    sensor : Sensor
    vehicle : Vehicle
    white : ndarray, shape (axes,)
        Known white variance beside the models: that of the lever arm.
    behind_s : float
        Readings may come so late [s]. A model is learnt from readings older than that, and the filter may go back by as
        much.
    worker : Worker
        Works on the hops.
    capacity : int, optional
        Ticks to keep; default: the window of the learnt models, and what going back needs.
    expect : callable, optional
        Returns, as a weak reference does, what is told where a hop is worked on which models will be adopted.

    Raises
    ------
    ValueError
        For a sensor whose error cannot be told from the vehicle's motion.
    """

    def __init__(
        self,
        name: str,
        sensor: Sensor,
        vehicle: Vehicle,
        white: Array,
        behind_s: float,
        worker: Worker,
        capacity: int | None = None,
        expect: Callable[[], Callable[[str, tuple[ErrorModel, ...]], None] | None] | None = None,
    ) -> None:
        self._expect = expect
        self.kind = sensor.open_loop
        if self.kind == open_loop_residual.NOTHING:
            raise ValueError(
                f'"{name}": a {type(sensor).__name__} has no readings to learn its error from. Give it a fixed error '
                "model."
            )
        self.name, self.period_s, self.behind_s = name, 1.0 / sensor.rate_hz, behind_s
        self.worker = worker
        # the hop that was begun last, what the learners knew then, and the work on it
        self._begun: tuple[Hop, tuple[LearnerMemory | None, ...], Task] | None = None
        self._before: object = None  # the same of the one before: the thread frees it, as it takes long
        models = sensor.models
        learned = [learning_part(model) for model in models]
        window = max((part.window for part in learned if part is not None), default=0)
        self.axes, parameters = sensor.axes, sensor.all_parameters()
        # of how many constants estimates and slopes are noted: all of the sensor, where one is not known
        self.constants = len(parameters) if any(p.sd for p in parameters) else 0
        clock = next((i for i, p in enumerate(parameters) if p.name == "time_offset"), -1)
        rows = sensor.axes + 1 + self.constants * (sensor.axes + 1)
        asked = open_loop_residual.BESIDE_CONSTANTS if self.constants else 0.0
        facts = sensor.still_m_s, sensor.lead_s, clock, rows, asked
        self.mount = np.concatenate([facts, np.ascontiguousarray(sensor.instrument_axes()).ravel()])
        self.drifts = tuple(sensor.drift(vehicle.drive, axis, known_walk(model)) for axis, model in enumerate(models))
        self._turns = any(math.isfinite(drift.most_turned) for drift in self.drifts)
        self.white = tuple(float(white[i]) + known_white(model, self.period_s) for i, model in enumerate(models))
        self.learners = tuple(
            None if part is None else learner_of(part, sensor, drift, r)
            for part, drift, r in zip(learned, self.drifts, self.white, strict=True)
        )
        # more missing ticks than are predicted through
        self._anew = max(LONGEST_GAP + 1, math.ceil(FOUND_S / self.period_s))
        self.window = window
        self.described = models
        self.hop = min((part.hop or part.window // 2 for part in learned if part is not None), default=0)
        # what is left out as too new, and what going back writes over
        capacity = capacity or window + round(2.0 * behind_s * sensor.rate_hz) + 64
        self._ear = np.concatenate([np.zeros(open_loop_residual.MOUNT), self.mount])
        self._ear[[open_loop_residual.KIND, open_loop_residual.CAPACITY]] = self.kind, capacity
        self._memory = OpenLoopMemory(
            ring=np.full((rows, capacity), np.nan),
            cursor=np.zeros(1, np.int64),
            left_out=np.zeros((LEFT_OUT, 2), np.int64),
            due=LEAST if window else NEVER,
            heard=0,
            level=1.0,
            odds=_as_modelled(),
            models=models,
            learners=memories(self.learners),
            hop=None,
            ended=False,
        )

    @property
    def learns(self) -> bool:
        """Whether anything is learnt from what it hears."""
        return self.window > 0 and not self._memory.ended

    @property
    def is_watched(self) -> bool:
        """Whether the level of its error is: where something has been learnt of it, and is learnt."""
        return self.learns and any(one is not two for one, two in zip(self._memory.models, self.described, strict=True))

    @property
    def memory(self) -> OpenLoopMemory:
        """All that changes; setting one goes back (or on) to it."""
        return self._memory

    @memory.setter
    def memory(self, memory: OpenLoopMemory) -> None:
        recall(self.learners, self._memory.learners, memory.learners)
        if memory.models is not self.described and memory.models == self.described:  # a snapshot has its own
            memory.models = self.described
        self._memory = memory

    def _noted(self, last: int, without: int = 0) -> tuple[Array, Ints]:
        """The last ticks of all axes, and what is needed beside them, oldest first, without the newest; and what of
        them is left out. Both are copies.
        """
        ring = self._memory.ring
        written, capacity = int(self._memory.cursor[0]), ring.shape[1]
        first = written - min(written, last, capacity)
        at, count = first % capacity, max(written - without - first, 0)
        rows = self.axes + 1 if self._turns else self.axes
        heard, room = np.empty((rows, count)), min(capacity - at, count)
        heard[:, :room], heard[:, room:] = ring[:rows, at : at + room], ring[:rows, : count - room]
        if self.constants and count:
            told = ring[self.axes + 1 :, np.arange(first, first + count) % capacity]
            estimates, slopes = told[: self.constants], told[self.constants :].reshape(self.axes, self.constants, count)
            # as if the constants had been known as they were at the last of these ticks
            heard[: self.axes] += np.einsum("akt,kt->at", slopes, estimates - estimates[:, -1:])
        return heard, self._memory.left_out - first

    def _told(self, axis: int, heard: Array, left_out: Ints) -> Array:
        """What one axis is learnt from: the last of these ticks, without those that are left out."""
        series, turned = heard[axis].copy(), heard[-1]
        for begin, end in left_out.tolist():
            if end > 0:
                series[max(begin, 0) : end] = np.nan
        for tick in self.drifts[axis].begins_anew(turned):
            series[max(tick + 1 - self._anew, 0) : tick + 1] = np.nan
        return series

    def leave_out(self, ticks: int) -> None:
        """Learn nothing from the last so many ticks."""
        rows, end = self._memory.left_out, int(self._memory.cursor[0])
        begin = max(0, end - ticks)
        if rows[-1, 1] >= begin and end:
            rows[-1] = min(rows[-1, 0], begin), end
        else:
            rows[:-1] = rows[1:]
            rows[-1] = begin, end

    def begin_anew(self, seconds: float) -> None:
        """Learn nothing from the last seconds, in which the open loop has been led astray: its drift begins anew."""
        self.leave_out(max(math.ceil(seconds / self.period_s), self._anew))

    def all_series(self) -> tuple[ChannelSeries, ...]:
        """All that was heard, axis by axis, oldest first; isolated spikes are missing."""
        noted = self._noted(self._memory.ring.shape[1])
        return tuple(
            ChannelSeries(without_spikes(self._told(axis, *noted)), drift, self.period_s, white)
            for axis, (drift, white) in enumerate(zip(self.drifts, self.white, strict=True))
        )

    @property
    def is_due(self) -> bool:
        """Whether the next hop has come."""
        return self._memory.hop is None and bool(self._memory.cursor[0] >= self._memory.due)

    @property
    def is_answered(self) -> bool:
        """Whether the answer of a hop is to be taken."""
        hop = self._memory.hop
        return hop is not None and bool(self._memory.cursor[0] >= hop.taken)

    @property
    def series_kernel(self) -> Array:
        """What a kernel needs to listen over many readings, see `navfilter.kernels.open_loop_residual`."""
        memory, ear = self._memory, self._ear.copy()
        due = memory.due if memory.hop is None else memory.hop.taken
        ear[open_loop_residual.NOTED], ear[open_loop_residual.DUE] = memory.cursor.item(), due
        ear[open_loop_residual.ANOTHER], ear[open_loop_residual.LEVEL] = self.is_watched * ANOTHER, memory.level
        ear[open_loop_residual.ODDS : open_loop_residual.MOUNT] = memory.odds
        return ear

    def caught_up(self, ear: Array, ticks: Array, values: Array) -> None:
        """Take over what a kernel has heard: ticks of each reading, and what it has noted of them (n, axes + 1)."""
        memory, capacity = self._memory, self._memory.ring.shape[1]
        ends = np.minimum(np.maximum(ticks.astype(np.int64), 1), capacity + 1).cumsum()
        new = values
        if ends[-1] > len(values):  # some ticks had no reading
            new = np.full((int(ends[-1]), values.shape[1]), np.nan)
            new[ends - 1] = values
        memory.cursor[0] += len(new)
        kept = new[-capacity:].T
        begin = int(memory.cursor[0] - kept.shape[1]) % capacity
        room = capacity - begin
        memory.ring[:, begin : begin + kept.shape[1]] = kept[:, :room]
        memory.ring[:, : max(kept.shape[1] - room, 0)] = kept[:, room:]
        memory.odds[:] = ear[open_loop_residual.ODDS : open_loop_residual.MOUNT]

    def settle(self, age_s: float) -> None:
        """The beginning will be done again: nothing is learnt again from what was heard before now; the last tick was
        `age_s` ago.
        """
        ticks = int(self._memory.cursor[0])
        if ticks:  # readings of others may be on their way
            ticks += max(0, math.ceil(age_s / self.period_s - 1e-6) - 1)
        self._memory.due = self._next(ticks) if self.learns else NEVER

    def give_up(self) -> None:
        """Back to the error models as described: nothing is learnt any more."""
        self._memory.models = self.described
        self.leave()

    def doubt(self) -> None:
        """Back to the error models as described: the error has become another one, and is learnt anew from now on."""
        memory, end = self._memory, int(self._memory.cursor[0])
        self.leave_out(end)
        memory.models, memory.hop, memory.due = self.described, None, end + self.hop
        memory.learners = tuple(None if learner is None else NOTHING_KNOWN for learner in self.learners)
        self.forget_level()

    def begin_again(self) -> None:
        """Listen from the start again."""
        self._memory.cursor[0] = 0
        self._memory.left_out[:] = 0
        self.forget_level()

    def _next(self, ticks: int) -> int:
        """Ticks that make the next hop due: twice as many at first, a hop more then."""
        rows = self._memory.left_out
        begin = int(rows[rows[:, 0] == 0, 1].max(initial=0))  # what was heard before does not count
        return ticks + min(self.hop, ticks - begin) if ticks - begin >= LEAST else begin + LEAST

    def notice(self, nis: float, dof: int) -> None:
        """Take note of how a reading fared in the filter."""
        if dof and math.isfinite(nis):
            ear = self.series_kernel
            open_loop_residual.judge_level(ear, float(nis), float(dof))
            self._memory.odds[:] = ear[open_loop_residual.ODDS : open_loop_residual.MOUNT]

    def is_another_level(self) -> bool:
        """Whether the error is larger or smaller than at the level in force, by another factor; takes the new one."""
        memory, factor = self._memory, ANOTHER
        mean = float(memory.odds @ open_loop_residual.LEVELS)
        if not self.is_watched or memory.level / factor <= mean <= memory.level * factor:
            return False
        memory.level = mean
        return True

    def forget_level(self) -> None:
        """Models in force are as they were learnt."""
        self._memory.level, self._memory.odds[:] = 1.0, _as_modelled()

    def begin_hop(self, age_s: float = 0.0, taken: int | None = None) -> None:
        """Begin to learn from what was noted so far; the last tick was `age_s` ago. The answer is taken `TAKEN_AFTER_S`
        later, or at tick `taken`.
        """
        memory = self._memory
        written = int(memory.cursor[0])
        newest = min(round(max(0.0, self.behind_s - age_s) / self.period_s), written)  # one may never have been heard
        memory.due = self._next(written)
        fresh, memory.heard = written - newest - memory.heard, written - newest
        after = math.ceil(TAKEN_AFTER_S / self.period_s)
        noted = self._noted(self.window + newest, newest)
        memory.hop = Hop(*noted, fresh, written + after if taken is None else taken)
        self.worker.later(self._tell)

    def _tell(self) -> None:
        """Tell the thread of the hop, in a turn of its own."""
        if self._memory.hop is not None:
            self._task(self._memory.hop)

    def take_early(self) -> None:
        """Nothing is done at early ages any more: the answer of their hop is taken by the number of ticks."""
        memory, after = self._memory, math.ceil(TAKEN_AFTER_S / self.period_s)
        if memory.hop is not None and memory.hop.taken == NEVER:
            memory.hop = replace(memory.hop, taken=int(memory.cursor[0]) + after)

    def leave(self) -> None:
        """Nothing is learnt any more."""
        self._memory.hop, self._memory.due, self._memory.ended = None, NEVER, True

    def _task(self, hop: Hop) -> Task:
        """The work on a hop. A late reading that goes back over its beginning asks for the same once more."""
        knew = self._memory.learners
        if self._begun is not None and self._begun[0] is hop and self._begun[1] is knew:
            return self._begun[2]
        if self._begun is None or not (
            (self._begun[0] is hop or self._begun[0].is_same(hop))
            and all(one is two for one, two in zip(self._begun[1], knew, strict=True))
        ):
            self._before, work = self._begun, partial(self._answered, knew, hop, self._memory.models)
            self._begun = hop, knew, Task(self.worker, work)
        return self._begun[2]

    def learnt(self) -> tuple[ErrorModel, ...] | None:
        """Take the answer of the hop: the error models to adopt, or None when there is nothing new."""
        memory = self._memory
        if memory.hop is None:  # what it was learnt from does not count any longer
            return None
        models, memory.learners = self._task(memory.hop).answer()
        memory.hop = None
        if models is memory.models:
            return None
        memory.models = models
        return models

    @property
    def levels(self) -> tuple[float, ...]:
        """S(0) of what is learnt, per axis; 1 where nothing is."""
        parts = [learning_part(model) for model in self._memory.models]
        return tuple(1.0 if part is None else max(part.s0(self.period_s), 1e-300) for part in parts)

    def _answered(
        self, knew: Sequence[LearnerMemory | None], hop: Hop, models: tuple[ErrorModel, ...]
    ) -> tuple[tuple[ErrorModel, ...], tuple[LearnerMemory | None, ...]]:
        """Error models that the learners of all axes have found (the very same where nothing is new), and what the
        learners know then; they themselves do not change. What is not of the hop may be another one meanwhile: this is
        worked on beside the run.
        """
        self._before, own = None, [copy(learner) for learner in self.learners]
        recall(own, memories(own), knew)
        found = []
        for axis, (learner, model) in enumerate(zip(own, models, strict=True)):
            learnt = None
            if learner is not None:
                before = max(hop.heard.shape[1] - learner.window, 0)
                told = self._told(axis, hop.heard[:, before:], hop.left_out - before)
                learnt = learner.hop(without_spikes(told), hop.fresh)
            found.append(with_learnt(model, learnt))
            part = learning_part(found[-1])
            if learnt is not None and part is not None:  # remembered for the adoption
                found[-1].block(self.period_s)
                part.s0(self.period_s)
        new = models if tuple(found) == models else tuple(found)
        expect = self._expect and self._expect()
        if expect and new is not models:
            expect(self.name, new)
        return new, memories(own)


def _as_modelled() -> Array:
    """Probabilities of the levels where the error is as large as its model."""
    return np.eye(len(open_loop_residual.LEVELS))[0]


#: A sample so many robust deviations from its neighbours is a spike.
SPIKE = 8.0


def without_spikes(series: Array) -> Array:
    """A copy with NaN where a sample stands out from the median of the five around it by more than `SPIKE` robust
    deviations.

    The filter's gate cannot do this: it judges by what is believed of the sensor, which is what is to be learnt.
    """
    result = np.array(series, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(result))
    if known.size < 5:
        return result
    # the drift may run away by metres per tick: most of it is a low polynomial, and what that leaves is smooth
    y = result[known]
    place = (known - known[0]) * (2.0 / (known[-1] - known[0])) - 1.0
    basis = np.polynomial.chebyshev.chebvander(place, 5)
    y -= basis @ np.linalg.lstsq(basis.T @ basis, basis.T @ y, rcond=None)[0]
    padded = np.concatenate([y[[2, 1]], y, y[[-2, -3]]])
    size = np.abs(y - _middle(*(padded[i : i + y.size] for i in range(5))))
    # where most samples equal their median (quantised readings), the mean of the others says how much is ordinary
    median, most = np.interp([0.5 * (y.size - 1), 0.99 * (y.size - 1)], np.arange(y.size), np.sort(size))
    scale = max(1.4826 * float(median), float(np.mean(np.minimum(size, most))))
    result[known[size > SPIKE * scale]] = np.nan
    return result


def _middle(a: Array, b: Array, c: Array, d: Array, e: Array) -> Array:
    """Median of each five."""
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))

"""When what is heard is learnt from: this listens to the filter's events and answers with error models to adopt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple
from weakref import WeakMethod

import numpy as np

from navfilter.filter.events import (
    Correction,
    Event,
    Measurement,
    Outcome,
    Propagated,
    SamplesReplaced,
    SamplesUsed,
    StateTransformed,
)
from navfilter.filter.input_buffer import InputBuffer
from navfilter.filter.model_change import Change, adoption
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.foundation.arrays import Array, Ints
from navfilter.kernels import open_loop_residual
from navfilter.kernels.batch import STUCK_S
from navfilter.learning.background import Worker
from navfilter.learning.open_loop_series import NEVER, TAKEN_AFTER_S, ChannelSeries, OpenLoopMemory, OpenLoopSeries
from navfilter.learning.static_recorder import RestMemory, RestRecorder, estimates
from navfilter.models.error_models import ErrorModel
from navfilter.models.fault_bias import has_description
from navfilter.models.learned_arma import as_described, changed, is_learnt, learning_part

_ASKED = np.where(np.arange(open_loop_residual.EAR) == open_loop_residual.MOUNT + open_loop_residual.ASKED, 1.0, 0.0)
_NO_RING, _NO_CURSOR = np.zeros((1, 1)), np.zeros(1, np.int64)
_DEAF, _NOTHING = np.zeros(open_loop_residual.EAR), np.zeros(0)


class Heard(NamedTuple):
    """With what a kernel listens to a sensor: what it goes on from, its ear, and where it writes; what is remembered of
    a sensor that learns, and from when on each reading is looked at [s].
    """

    feedback: Array
    ear: Array
    ring: Array
    cursor: Ints
    learner: OpenLoopMemory | None
    learning_s: float


#: Where nobody listens.
UNHEARD = Heard(_NOTHING, _DEAF, _NO_RING, _NO_CURSOR, None, math.inf)


@dataclass(frozen=True)
class RerunRequest:
    """How the beginning is done again.

    Attributes
    ----------
    models : tuple of (str, error models)
        In force from the start.
    adopted : int
        How many have been adopted by then.
    """

    models: tuple[tuple[str, Any], ...]
    adopted: int


@dataclass
class LearningMemory:
    """Everything that changes while a filter is listened to.

    Attributes
    ----------
    fed_back : ndarray, shape (2m + 3,)
        Sum of what the corrections fed back, as an open loop would have carried it, see
        `navfilter.kernels.open_loop_residual`.
    listeners : dict of str to ListenerMemory
    rest : RestMemory or None
    beginning : InputBuffer or None
        Inputs since the start, kept until the first models are adopted; None when that is over.
    kept : (int, int)
        How many samples and readings of them there were.
    stage : int
        How many of the early hops are over.
    hopping : bool
        Whether the next one has begun.
    again : RerunRequest or None
        The beginning will be done again so.
    quiet_s : float
        Nothing is learnt before this time [s]: it is the beginning, done again.
    waiting : tuple of Change
        Models that are adopted one a reading: each costs about a millisecond.
    levels : dict of str to tuple of float
        S(0) of the learnt parts of each sensor's axes with which the beginning was done last.
    refused : bool
        Whether what was learnt last predicts fixes, or its readings, worse than what is in force.
    opened_s : float
        Until when biases of gyros may be known less than a drift begins with, since the state was set anew [s]; -inf:
        they are known.
    """

    SHARED: ClassVar = ("beginning",)

    fed_back: Array
    listeners: dict[str, OpenLoopMemory]
    rest: RestMemory | None
    beginning: InputBuffer | None
    kept: tuple[int, int]
    stage: int
    hopping: bool
    again: RerunRequest | None
    quiet_s: float
    waiting: tuple[Change, ...]
    levels: dict[str, tuple[float, ...]]
    refused: bool
    opened_s: float

    def revive(self, names: tuple[str, ...]) -> None:
        """Make the inputs of the beginning, as they were stored, one's own, for a vehicle with these sensors.

        Raises
        ------
        ValueError
            When they are not as many as were kept, or they or what is being learnt from have another form.
        """
        if self.beginning is not None:
            self.beginning = self.beginning.again(names)
        if (self.beginning.count if self.beginning else (0, 0)) != self.kept:
            raise ValueError("memory.learning.beginning has not as many inputs as were kept")
        for name, listener in self.listeners.items():
            hop, axes = listener.hop, len(listener.models)
            if hop is None:
                continue
            fits = isinstance(hop.heard, np.ndarray) and hop.heard.ndim == 2 and axes <= len(hop.heard) <= axes + 1
            left = isinstance(hop.left_out, np.ndarray) and hop.left_out.shape == listener.left_out.shape
            if not (fits and left and hop.heard.dtype == np.float64 and hop.left_out.dtype.kind == "i"):
                raise ValueError(f"what the hop of {name!r} learns from has another form")


class LearningSchedule:
    """Listens to a filter, and says which error models it should adopt.

    It reads the filter and never writes to it, but for what it has worked out beforehand of the next adoptions.

    Parameters
    ----------
    filter : FilterState
    behind_s : float
        Readings may come so late [s]: nothing newer is learnt from, and going back by as much is possible.
    worker : Worker, optional
        Works on what is learnt, see `navfilter.learning.background`; default: without threads.

    Notes
    -----
    Models come at once for all sensors at the ages `EARLY_S`, later as each listener counts its ticks. What a model
    took for certain cannot be taken back from the covariance: where the power at zero frequency of a new model is
    another one by more than `ANOTHER`, the beginning is done again as if the new models had been known; `beginning`
    holds its inputs until the last of these ages. Elsewhere the filter goes on with the new models. The beginning is
    done again `AGAIN_AFTER` of the age later: until then another filter may have come that far. Models of the inertial
    unit at rest are adopted when they are found, and the beginning is not done again for them: they stand for the noise
    of samples, and what the filter took for certain by it in the first minute at rest is little.
    """

    #: Models are adopted at these ages [s]: as soon as readings say more than the prior, and whenever there are four
    #: times as many.
    EARLY_S = (30.0, 120.0, 500.0)
    #: ln S(0) that has changed by less is the same: the sd of the heading goes with its fourth root.
    ANOTHER = math.log(2.0)

    #: The beginning is done again so much later, of the age [1]: a machine must be 50 times as fast as the mission.
    AGAIN_AFTER = 0.02
    #: Where readings are less likely by so much, the models are wrong [nat]: twenty to one.
    WORSE = 3.0

    def __init__(self, filter: FilterState, behind_s: float, worker: Worker | None = None) -> None:
        self.filter, self.behind_s, self.worker = filter, behind_s, worker or Worker(threads=False)
        self.listeners: dict[str, OpenLoopSeries] = {}
        vehicle, start_s = filter.vehicle, filter.time_s
        self._start_s, self._stage, self._hopping = start_s, 0, False
        self._gravity = vehicle.drive.gravity
        self._quiet_s = -math.inf
        self._waiting: tuple[Change, ...] = ()
        self.again: RerunRequest | None = None
        self._refused, self._opened_s = False, -math.inf
        self._fed_back = np.zeros(2 * filter.layout.head + 3)
        learns = vehicle.drive.inertial and any(learning_part(model) is not None for model in vehicle.drive.models)
        self.rest = RestRecorder(vehicle.drive, behind_s) if learns else None
        for name, sensor in vehicle.sensors.items():
            if any(learning_part(model) is not None for model in sensor.models):
                self.record_residuals(name)
        self.beginning = InputBuffer(tuple(vehicle.sensors)) if self.listeners else None
        #: Fixes that nothing is learnt of.
        self.fixes: set[str] = set()
        if self.listeners:
            position = open_loop_residual.POSITION
            self.fixes = {name for name, sensor in vehicle.sensors.items() if sensor.open_loop == position}
            self.fixes -= set(self.listeners)
            self.worker.start()
        self._levels = self._present_levels()

    # ---------------------------------------------------------------- what changes
    @property
    def memory(self) -> LearningMemory:
        """All that changes; setting one goes back (or on) to it."""
        listeners = {name: listener.memory for name, listener in self.listeners.items()}
        rest = None if self.rest is None else self.rest.memory
        kept = (0, 0) if self.beginning is None else self.beginning.count
        return LearningMemory(
            *(self._fed_back, listeners, rest, self.beginning, kept, self._stage, self._hopping, self.again),
            *(self._quiet_s, self._waiting, self._levels, self._refused, self._opened_s),
        )

    @memory.setter
    def memory(self, memory: LearningMemory) -> None:
        self._fed_back, self.beginning = memory.fed_back, memory.beginning
        self._stage, self._hopping, self.again = memory.stage, memory.hopping, memory.again
        self._quiet_s, self._waiting, self._levels = memory.quiet_s, memory.waiting, memory.levels
        self._refused, self._opened_s = memory.refused, memory.opened_s
        for name, listener in self.listeners.items():
            listener.memory = memory.listeners[name]
        if self.rest is not None and memory.rest is not None:
            self.rest.memory = memory.rest
        if self.beginning is not None:
            self.beginning.cut(*memory.kept)

    # ---------------------------------------------------------------- listening
    def record_residuals(self, name: str, capacity: int | None = None) -> None:
        """Note the open-loop residuals of a sensor; those with a `LearnedArma` are listened to without being asked.

        Parameters
        ----------
        name : str
        capacity : int, optional
            Ticks to keep; default: the window of its `LearnedArma`.

        Raises
        ------
        ValueError
            For an unknown sensor, or one without readings of its own.
        """
        channels = self.filter.channels
        if name not in channels:
            raise ValueError(f'"{name}" is no sensor of this vehicle (sensors: {", ".join(channels)}).')
        about = channels[name].sensor, self.filter.vehicle, np.diag(channels[name].lever)
        expect = WeakMethod(self._expect) if self.worker.threads else None
        self.listeners[name] = OpenLoopSeries(name, *about, self.behind_s, self.worker, capacity, expect)

    def series(self, name: str) -> tuple[ChannelSeries, ...]:
        """Open-loop residuals of a sensor that is listened to, one series per axis.

        Raises
        ------
        ValueError
            Where nothing has been listened to.
        """
        if name not in self.listeners:
            raise ValueError(
                f'nothing is noted of "{name}": call listen("{name}") first, or give the sensor a LearnedArma.'
            )
        return self.listeners[name].all_series()

    def room(self) -> int:
        """Samples until it wants to see them; for a filter with a unit that is learnt at rest."""
        assert self.rest is not None
        return self.rest.room

    def on_event(self, event: Event) -> Sequence[Change]:
        """Listen to an event of the filter; returns the error models to adopt."""
        if isinstance(event, SamplesUsed):
            return self._passed(event.samples)
        if isinstance(event, StateTransformed):
            self._relaid(event.M)  # without listeners, too: its size is part of a snapshot
        if not self.listeners:
            return ()
        if isinstance(event, Correction):
            return () if event.channel is None else self._corrected(event, event.channel)
        if isinstance(event, Propagated):
            open_loop_residual.carry_feedback(self._fed_back, event.transition)
        elif isinstance(event, SamplesReplaced):
            for listener in self.listeners.values():
                listener.begin_anew(event.seconds)
        elif isinstance(event, StateTransformed):
            for name, listener in self.listeners.items():
                if listener.is_watched and not any(map(is_learnt, self.filter.channels[name].sensor.models)):
                    listener.doubt()
            if event.anew:
                self._state_reset(open_loop_residual.HEADING)
                self._opened_s = self.filter.memory.time_s + self.EARLY_S[-1]
        return ()

    def _corrected(self, event: Correction, channel: Channel) -> Sequence[Change]:
        (outcome, time_s, _), listener, memory = event, self.listeners.get(channel.name), self.filter.memory
        if listener is None:
            kind, ring, cursor = open_loop_residual.NOTHING, _NO_RING, _NO_CURSOR
            mount = self.ear(channel.name)[open_loop_residual.MOUNT :]
        else:
            own = listener.memory
            kind, ring, cursor, mount = listener.kind, own.ring, own.cursor, listener.mount
        open_loop_residual.record_residual(
            *(self._fed_back, channel.mem, channel.dims, channel.places, memory.nav, channel.C, memory.x),
            *(kind, mount, ring, cursor, channel.count, self.filter.drive_output, self._gravity),
        )
        if outcome.widened and channel.faults.agreed_s == time_s:
            self._state_reset(channel.sensor.open_loop)
        doubtful = 0 if listener is None else doubtful_ticks(channel, time_s)
        if listener is not None and doubtful:
            listener.leave_out(doubtful)
        if self._opened_s > -math.inf:
            found = time_s >= self._opened_s  # what is not found by then is known no better
            opened = [name for name, one in self.listeners.items() if self._knows_less_than(one) and not found]
            self._opened_s = self._opened_s if opened else -math.inf
            if listener is not None and channel.name in opened:
                listener.begin_anew(0.0)
        if self._waiting:
            first, *rest = self._waiting
            self._waiting = tuple(rest)
            return (first,)
        return () if listener is None else self.on_reading(listener, outcome, time_s, doubtful)

    def on_reading(
        self, listener: OpenLoopSeries, outcome: Outcome, time_s: float, doubtful: int = 0
    ) -> Sequence[Change]:
        """What follows when a reading has been listened to; its last ticks may be `doubtful`."""
        if time_s < self.learning_s:
            return ()
        if listener.is_watched and not doubtful:
            listener.notice(outcome.nis, outcome.dof)
        return self._due(listener, outcome.accepted)

    def ear(self, name: str) -> Array:
        """With which a kernel listens to a sensor, see `navfilter.kernels.open_loop_residual`."""
        if name in self.listeners:
            return self.listeners[name].series_kernel
        return _ASKED if name in self.fixes else _DEAF

    def for_kernel(self, name: str) -> Heard | None:
        """With what a kernel listens to a sensor; None where its next reading is not for a kernel."""
        if self.is_waiting:
            return None
        if name not in self.listeners:
            return Heard(self._fed_back, self.ear(name), _NO_RING, _NO_CURSOR, None, self.learning_s)
        listener, own = self.listeners[name], self.listeners[name].memory
        learnt = own if listener.learns else None
        return Heard(self._fed_back, listener.series_kernel, own.ring, own.cursor, learnt, self.learning_s)

    def _due(self, listener: OpenLoopSeries, accepted: bool) -> Sequence[Change]:
        models = listener.learnt() if listener.is_answered else None
        if listener.is_due and accepted:
            listener.begin_hop()
        if models is None and not self._refused and listener.is_another_level():
            models = self.filter.channels[listener.name].sensor.models
        if models is None or self._refused:
            return ()
        return (Change(listener.name, changed(models, level=listener.memory.level)),)

    @property
    def learning_s(self) -> float:
        """From then on each reading is looked at for what is due [s]; infinite at the early ages."""
        early = self._stage < len(self.EARLY_S) or self.again is not None
        return math.inf if early else self._quiet_s

    @property
    def is_waiting(self) -> bool:
        """Whether the next reading brings a model to adopt, or shows whether drifts may go on."""
        return bool(self._waiting) or self._opened_s > -math.inf

    @property
    def feedback(self) -> Array:
        """What a kernel that listens goes on from, see `LearningMemory`; empty where nobody listens."""
        return self._fed_back if self.listeners else _NOTHING

    def learn(self, name: str) -> Sequence[Change]:
        """Something is due after a reading of this sensor, of many that a kernel has taken; as `heard`."""
        return self._due(self.listeners[name], True)

    def _state_reset(self, kind: int) -> None:
        """The state has been reset to what sensors of a kind say: an open loop knows nothing of that step, nor of what
        the integrals of it do, and its drift begins anew.
        """
        chain = (open_loop_residual.HEADING, open_loop_residual.VELOCITY, open_loop_residual.POSITION)
        for listener in self.listeners.values():
            if listener.kind in chain[chain.index(kind) :]:
                listener.begin_anew(0.0)

    def _knows_less_than(self, listener: OpenLoopSeries) -> bool:
        """Whether the filter knows a bias of the gyros less than a drift begins with. Where the unit is used again,
        after something has stood in for it, its biases are open for minutes: their drift was learnt as the sensor's.
        """
        drive, variances = self.filter.layout.drive, self.filter.memory.P.diagonal()
        most = min((drift.start_sd[-1] for drift in listener.drifts if drift.start_sd), default=math.inf)
        return any(variances[drive.start + states[0]] > most**2 for states in drive.biases[:3] if len(states))

    def _relaid(self, M: Array) -> None:
        """What was fed back, of the head's states that M makes of those before."""
        told, after = self._fed_back, self.filter.layout.head
        before, self._fed_back = (len(told) - 3) // 2, np.zeros(2 * after + 3)
        self._fed_back[:after] = M[:after, :before] @ told[:before]
        self._fed_back[after : after + 9], self._fed_back[-3:] = told[before : before + 9], told[-3:]

    # ---------------------------------------------------------------- at rest
    def _passed(self, samples: Array) -> Sequence[Change]:
        rest = self.rest
        assert rest is not None
        rest.note(samples)
        if rest.room or not rest.close(*estimates(self.filter)):
            return ()
        return [Change(name, models) for name, models in rest.learn().items()]

    # ---------------------------------------------------------------- the beginning
    def buffer_input(self, item: Array | Measurement) -> None:
        """Keep an input of the beginning: samples, or a reading."""
        if self.beginning is not None:
            self.beginning.append(item)

    @property
    def early_s(self) -> float:
        """When models are to be looked for or adopted, or the beginning done again, next [s]; infinite when that is
        over.
        """
        if self.beginning is None:
            return math.inf
        age_s = self.EARLY_S[self._stage]
        hop_s = self._start_s + age_s + TAKEN_AFTER_S * self._hopping  # it begins, or its models are to be taken
        return hop_s if self.again is None else hop_s + self.AGAIN_AFTER * age_s

    def early(self) -> None:
        """At such a time: have models looked for, or have them adopted. Where another power makes it worth it, `again`
        says instead how the beginning is to be done again, at the next such time.
        """
        ages = {name: self.early_s - self.filter.channels[name].memory.ticked_s for name in self.listeners}
        hops = [name for name, listener in self.listeners.items() if listener.learns]
        if not self._hopping:
            self._hopping = True
            for name in hops:
                self.listeners[name].begin_hop(ages[name], NEVER)
            return
        found = {name: models for name in hops if (models := self.listeners[name].learnt()) is not None}
        levels = self._present_levels()
        if self._refused or any(
            abs(math.log(new / old)) > self.ANOTHER
            for name in self._levels
            for new, old in zip(levels[name], self._levels[name], strict=True)
        ):
            for name, listener in self.listeners.items():
                listener.settle(ages[name])
            learnt = {name: listener.memory.models for name, listener in self.listeners.items()}
            in_force = self.filter.described_models(learnt)
            self.again = RerunRequest(tuple(in_force.items()), self.filter.counts["adopted"] + len(learnt))
            return
        self._go_on()
        self._waiting = tuple(Change(name, models) for name, models in found.items())

    def _expect(self, name: str, models: tuple[ErrorModel, ...]) -> None:
        """Have worked out, on the learning thread, what it takes to adopt these behind those that are expected already:
        the filter finds it where it comes like this.
        """
        filter, known = self.filter, self.filter.prepared
        if not (known and known[0].before is filter.in_force):
            known = []
        at = (known[-1].after, known[-1].layout) if known else (filter.in_force, filter.layout)
        found = adoption(*at, name, models)
        filter.channels[name].prepare(found.after, found.layout)
        filter.prepared = [*known, found]

    @property
    def compares(self) -> bool:
        """Whether the beginning is not done again before it is known that this is better."""
        asks = self.fixes or any(listener.constants for listener in self.listeners.values())
        return self.again is not None and bool(asks)

    def is_worse(self, than: Array) -> bool:
        """Whether a run whose beginning has been done again is worse than it was, by what was fed back then: models
        that were learnt must predict neither fixes worse, of which nothing is learnt, and which show what the rest
        makes of the position, nor readings of sensors with constants as states: those models were learnt beside
        constants as the run before estimates them.
        """
        return not (self._fed_back[-2:] > than[-2:] - self.WORSE).all()  # ln of how likely they were

    def refuse(self) -> None:
        """The beginning stays as it is."""
        self._quiet_s, self._refused = self.early_s, True
        self._go_on()

    def _go_on(self) -> None:
        """This early hop is over."""
        self._stage, self._hopping, self.again = self._stage + 1, False, None
        if self._stage == len(self.EARLY_S):
            self.beginning = None
            for name, listener in self.listeners.items() if self._refused else ():
                listener.give_up()
                in_force = self.filter.channels[name].sensor.models  # what was taken before stays
                if (plain := as_described(in_force)) != in_force:
                    self._waiting += (Change(name, plain),)

    def adopted_by_hand(self, name: str = "") -> None:
        """The user has put a model of a sensor in force, or the state is another's: the beginning is not done again.
        Learning goes on hop by hop, from the first early age on; not of that sensor, where its model does not learn.
        """
        if name in self.listeners and not any(map(learning_part, self.filter.in_force.sensors[name].models)):
            self.listeners[name].leave()
        learning = [listener for listener in self.listeners.values() if listener.learns]
        if name in self.listeners:
            self.listeners[name].forget_level()
        if self.again is not None:  # what was found for that is as good without it
            self._waiting = tuple(Change(listener.name, listener.memory.models) for listener in learning)
        self._waiting = tuple(change for change in self._waiting if change.sensor != name)
        self.beginning, self.again, self._stage, self._hopping = None, None, len(self.EARLY_S), False
        self._quiet_s = max(self._quiet_s, self._start_s + self.EARLY_S[0])
        for listener in learning:
            listener.take_early()

    def _present_levels(self) -> dict[str, tuple[float, ...]]:
        """S(0) of what is learnt, per axis; 1 where nothing is."""
        return {name: listener.levels for name, listener in self.listeners.items()}

    def begin_again(self, until_s: float) -> InputBuffer:
        """The filter stands at the start again: listen from there, and learn nothing before `until_s`; returns the
        inputs of the beginning, which are kept anew if it may be done once more.
        """
        for listener in self.listeners.values():
            listener.begin_again()
        self._fed_back, self._refused = np.zeros(2 * self.filter.layout.head + 3), False
        if self.rest is not None:
            self.rest.begin_again()
        names = tuple(self.filter.channels)
        inputs, self.beginning = self.beginning or InputBuffer(names), InputBuffer(names)
        self._quiet_s, self._waiting = until_s, ()
        if self.again is not None:
            self._levels = self._present_levels()
        self._go_on()
        return inputs


#: So many refused readings on end, all off by the same at once, are no outliers any more.
JUMPED = 3


def doubtful_ticks(channel: Channel, time_s: float) -> int:
    """How many ticks of a sensor, up to its reading of a time [s], show no error to be learnt: those of one that is
    stuck or has jumped. What a gate refuses for another reason is learnt from: it shows an error larger than believed.
    """
    memory, refused = channel.faults, channel.faults.refused
    if channel.stuck:
        return round(STUCK_S / channel.period_s) + 1
    if refused is not None and refused.jumped and refused.count >= JUMPED:
        # a reading that a wrong description let in has ended the refusals, not the run
        since_s = float(np.fmin(memory.rejected_since_s, refused.began_s))
        return round((time_s - since_s) / channel.period_s) + 1
    return int(channel.offset or has_description(channel.sensor.models))

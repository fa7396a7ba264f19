"""What is learnt while the filter runs: listening to the sensors, adopting models, and doing the beginning again with the first ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.error_models import ErrorModel
from navfilter.filter.adoption import state_change
from navfilter.filter.filter import Engine, Memory, Outcome
from navfilter.filter.intake import joined
from navfilter.filter.layout import Layout
from navfilter.filter.tape import Tape
from navfilter.kernels import listen, strapdown
from navfilter.learning.learned import block_level, learned_part, learning_part
from navfilter.learning.listener import Channel, ChannelSeries, Listener
from navfilter.start import Start
from navfilter.vehicle import Vehicle

__all__ = ["Learning"]

Array = NDArray[np.float64]
#: At one adoption the variance in the direction of what a sensor sees grows by this factor at most.
MOST_GIVEN_BACK = 4.0
_NO_RING, _NO_CURSOR, _NO_MOUNT = np.zeros((1, 1)), np.zeros(1, np.int64), np.zeros(9)


class Learning(Engine):
    """An engine that learns its sensors' error models as it goes; see `navfilter.navigator.Navigator`."""

    #: Nothing is learnt from readings before this age: the start's tilt has to settle [s].
    SETTLE_S = 60.0
    #: The first models are adopted at this age, or when the longest window is full [s].
    FIRST_S = 520.0

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        super().__init__(vehicle, start, tape)
        self._listening = False
        self._listen_from_s = self._time_s + self.SETTLE_S
        self._early: list[Array | tuple[Any, ...]] | None = None
        self._revise_s = math.inf
        learning = []
        for name, sensor in vehicle.sensors.items():
            if any(learning_part(model) is not None for model in sensor.models):
                self.listen(name)
                learning.append(self._channels[name].listener)
        if learning:
            longest = max(listener.window * listener.period_s for listener in learning if listener is not None)
            self._early, self._revise_s = [], self._time_s + min(self.FIRST_S, self.SETTLE_S + longest)

    def _begin(self, vehicle: Vehicle) -> None:
        """Stand at the start; what has been heard and learnt stays."""
        listeners = {name: channel.listener for name, channel in self._channels.items()}
        super()._begin(vehicle)
        for name, listener in listeners.items():
            self._channels[name].listener = listener
        self._undone = np.zeros(2 * self._head)

    # ---------------------------------------------------------------- what comes in
    def advance(self, samples: Array) -> None:
        """Carry the state over a block of samples: rows of time and six values; the array is used as work space."""
        if self._early is not None and len(samples):
            self._early.append(samples.copy())
        super().advance(samples)

    def _close_second(self) -> None:
        if self._listening:
            listen.carry(self._undone, self._acc[: self._head])
        super()._close_second()

    def take(self, channel: Channel, time_s: float, value: ArrayLike, sd: ArrayLike | None, frozen: bool = False) -> Outcome:
        """Correct the state with a reading that comes in order; `frozen` readings never widen the gate."""
        if self._early is not None:
            if time_s >= self._revise_s:
                self._revise()
                channel = self._channels[channel.name]
            else:
                self._early.append((channel.name, time_s, value, sd, frozen))
        return super().take(channel, time_s, value, sd, frozen)

    def _apply(self, channel: Channel, time_s: float, z: Array, sd: ArrayLike | None, frozen: bool = False) -> Outcome:
        outcome = super()._apply(channel, time_s, z, sd, frozen)
        if self._listening:
            self._hear(channel, time_s)
            listener = channel.listener
            if listener is not None and listener.cursor[0] >= listener.due and self._early is None and outcome.accepted:
                self._learn(channel)
        return outcome

    # ---------------------------------------------------------------- learning
    def listen(self, name: str, capacity: int | None = None) -> None:
        """Note the open-loop residuals of a sensor, see `heard`; sensors with a `LearnedArma` are listened to without being asked.

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
        if name not in self._channels:
            raise ValueError(f'"{name}" is no sensor of this vehicle (sensors: {", ".join(self._channels)}).')
        channel = self._channels[name]
        channel.listener = Listener(name, channel.sensor, self.vehicle, np.diag(channel.lever), capacity)
        self._listening = True

    def heard(self, name: str) -> tuple[ChannelSeries, ...]:
        """Open-loop residuals of a sensor that is listened to, one series per axis."""
        listener = self._channels[name].listener if name in self._channels else None
        if listener is None:
            raise ValueError(f'nothing is noted of "{name}": call listen("{name}") first, or give the sensor a LearnedArma.')
        return listener.all_series()

    def _hear(self, channel: Channel, time_s: float) -> None:
        listener, kind = channel.listener, listen.NOTHING
        ring, cursor, mount = _NO_RING, _NO_CURSOR, _NO_MOUNT
        if listener is not None and time_s >= self._listen_from_s:
            kind, ring, cursor, mount = listener.kind, listener.ring, listener.cursor, listener.mount
        Phi = channel.mem[: self._head**2].reshape(self._head, self._head)
        listen.carry(self._undone, Phi)
        gravity = self.vehicle.drive.gravity
        listen.listen(
            *(self._undone, channel.mem, channel.dims, channel.places, self._nav, channel.C, self._x),
            *(kind, mount, ring, cursor, channel.count, self._Cr, gravity),
        )

    def _learn(self, channel: Channel) -> None:
        assert channel.listener is not None
        models = channel.listener.learn(0.0)
        if models is not None:
            self._give_back(channel, models)
            self.adopt(channel.name, models)

    def _give_back(self, channel: Channel, models: tuple[ErrorModel, ...]) -> None:
        """Where a new model has more power at zero frequency, the old one took too much for certain: make P in the direction of what the
        sensor sees that much larger (information about a constant goes with 1 / S(0)), with everything that hangs on it in proportion.
        """
        for axis, (old, new) in enumerate(zip(channel.sensor.models, models, strict=True)):
            before, after = learned_part(old), learned_part(new)
            if before is None or after is None:
                continue
            ratio = block_level(after.block(channel.period_s)) / max(block_level(before.block(channel.period_s)), 1e-300)
            row = channel.H[axis].copy()
            row[channel.group.start : channel.group.start + channel.group.errors] = 0.0
            along = self._P @ row
            variance = float(row @ along)
            if ratio > 1.0 and variance > 0.0:
                self._P += (min(ratio, MOST_GIVEN_BACK) - 1.0) / variance * np.outer(along, along)

    def _revise(self) -> None:
        """Adopt the first models, and run what there was so far again with them.

        Until here the priors were in force. What they took for certain cannot be taken back from the covariance, so the beginning is done
        again as if the models had been known.
        """
        early, self._early = self._early, None
        found: dict[str, Any] = {}
        for name, channel in self._channels.items():
            if channel.listener is not None and channel.listener.learns:
                models = channel.listener.learn(self._revise_s - channel.ticked_s)
                if models is not None:
                    found[name] = models
        if not found or early is None:
            return
        for channel in self._channels.values():
            if channel.listener is not None:
                channel.listener.rewind()
        self._begin(self._in_force.with_error(**found))
        self.counts["adopted"] = len(found)
        self._again(early)

    def _again(self, items: list[Array | tuple[Any, ...]]) -> None:
        """Feed inputs that were fed before."""
        for item in joined(items):
            if isinstance(item, np.ndarray):
                self.advance(item)
            else:
                self.take(self._channels[item[0]], *item[1:])

    def adopt(self, name: str, error: ErrorModel | tuple[ErrorModel, ...]) -> None:
        """Put other error models of one sensor in force, now.

        The states follow without a jump: see `navfilter.filter.adoption.transfer`. What was adopted goes on the tape.

        Parameters
        ----------
        name : str
            A correcting sensor, or ``gyro`` / ``accel``.
        error : ErrorModel or tuple of ErrorModel
            One for all axes, or one per axis.

        Raises
        ------
        ValueError
            For an unknown sensor, or something that is no error model.
        """
        new = self._in_force.with_error(**{name: error})
        self._early = None
        if self._unfolded:
            self._close_second()
        M, N = state_change(self.layout, self._in_force, Layout.of(new), new)
        if self._tape is not None:
            self._tape.change(M)
        P, x = M @ self._P @ M.T + N, M[9:, 9:] @ self._x
        head, undone = self._head, self._undone
        self._arrange(new)
        self._P, self._x = np.ascontiguousarray(0.5 * (P + P.T)), np.ascontiguousarray(x)
        self._xd = self._x[: self.layout.drive.size]
        fresh = new.drive.memory(self.layout.drive.errors, self.start)
        self._drv[[strapdown.DEVIATION, strapdown.SCALE]] = fresh[[strapdown.DEVIATION, strapdown.SCALE]]
        self._undone = np.zeros(2 * self._head)
        self._undone[: self._head] = M[: self._head, :head] @ undone[:head]
        self._undone[self._head : self._head + 9] = undone[head : head + 9]
        self.counts["adopted"] += 1
        if self._tape is not None:
            self._tape.layouts.append(self.layout)
            self._tape.models.setdefault(name, []).append((self._time_s, error))
            self._tape.row(self._time_s, self._nav, self._x, self._P)

    # ---------------------------------------------------------------- what it remembers
    def memory(self) -> Memory:
        """Everything that changes, copied; the readings that learners keep are not copied but counted."""
        kept = super().memory()
        marks = {
            name: (clock, listener.mark() if (listener := self._channels[name].listener) is not None else None)
            for name, (clock, _) in kept.channels.items()
        }
        early = None if self._early is None else len(self._early)
        return kept._replace(arrays=(*kept.arrays, self._undone.copy()), channels=marks, early=early)

    def recall(self, memory: Memory) -> None:
        """Go back to what `memory` holds."""
        super().recall(memory)
        self._undone = memory.arrays[5].copy()
        for name, (_, mark) in memory.channels.items():
            listener = self._channels[name].listener
            if listener is not None and mark is not None:
                listener.recall(mark)
        if self._early is not None and memory.early is not None:
            del self._early[memory.early :]

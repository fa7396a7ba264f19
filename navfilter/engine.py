"""The filter's arithmetic: samples and readings in the order of their times. `navfilter.navigator` is what users see of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.adoption import state_change
from navfilter.channels import GRAVITY, Channel, ChannelSeries, Listener, usable
from navfilter.error_models import ErrorModel
from navfilter.intake import Intake
from navfilter.kernels import kalman, listen, strapdown
from navfilter.layout import Layout
from navfilter.learned import learned_part
from navfilter.sensors import Depth, ZeroVelocity
from navfilter.start import Start
from navfilter.state import NavState
from navfilter.tape import OUTCOMES, Tape
from navfilter.vehicle import Vehicle

__all__ = ["Engine", "Memory", "Outcome"]

Array = NDArray[np.float64]
CODES = {name: code for code, name in enumerate(OUTCOMES)}


class Outcome(NamedTuple):
    """What became of a reading.

    Attributes
    ----------
    status : str
        "used", "rejected" (by the gate), "invalid", "duplicate", "too-late", "ahead" (no drive sample for too long) or "unknown-sensor".
    nis : float
        Normalised innovation squared; NaN when it was not formed.
    dof : int
        Components used in it.
    widened : bool
        The gate had been widened after a long series of rejections.
    """

    status: str
    nis: float = math.nan
    dof: int = 0
    widened: bool = False

    @property
    def accepted(self) -> bool:
        """Whether the reading corrected the state."""
        return self.status == "used"


#: What may be wrong with a state that all sensors contradict: velocity [m/s], roll, pitch and heading [rad].
OPEN_SPEED, OPEN_ATTITUDE = 2.0, np.array([0.1, 0.1, 1.0])
_NO_RING, _NO_CURSOR, _NO_MOUNT = np.zeros((1, 1)), np.zeros(1, np.int64), np.zeros(9)


class Memory(NamedTuple):
    """What a run remembers at one moment."""

    clock: tuple[float, float, int]
    intake: tuple[float, ...]
    arrays: tuple[Array, ...]
    in_force: Vehicle
    channels: dict[str, tuple[Any, Any]]
    counts: dict[str, int]
    early: int | None


def joined(items: Sequence[Any]) -> list[Any]:
    """Inputs with samples that follow each other in one block."""
    result: list[Any] = []
    run: list[Array] = []
    for item in [*items, None]:
        if isinstance(item, np.ndarray):
            run.append(item)
            continue
        if run:
            result.append(np.concatenate(run) if len(run) > 1 else run[0].copy())
            run = []
        if item is not None:
            result.append(item)
    return result


class Engine:
    """Error-state extended Kalman filter in closed loop, fed in order; see `navfilter.navigator.Navigator`."""

    #: Corrections may come so long after the last sample of the drive, at least [s].
    AHEAD_S = 1.0
    #: Nothing is learnt from readings before this age: the start's tilt has to settle [s].
    SETTLE_S = 60.0
    #: The first models are adopted at this age, or when the longest window is full [s].
    FIRST_S = 520.0

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        if not isinstance(vehicle, Vehicle):
            raise ValueError(f"Navigator needs a Vehicle, found {type(vehicle).__name__}.")
        self.vehicle, self.start, self._tape = vehicle, start, tape
        self._rate = np.zeros(3)
        self._steps, self._hold = vehicle.drive.steps, vehicle.drive.hold
        self._period_s = vehicle.drive.period_s
        self._ahead_s = max(self.AHEAD_S, 3.0 * self._period_s)
        self._fold_every = max(1, round(vehicle.drive.rate_hz))
        self._inertial = "imu" in vehicle.drive.streams
        self._listening = False
        self._channels: dict[str, Channel] = {}
        self._begin(vehicle)
        self._listen_from_s = self._time_s + self.SETTLE_S
        self._early: list[Array | tuple[Any, ...]] | None = None
        self._revise_s = math.inf
        learning = []
        for name, sensor in vehicle.sensors.items():
            if any(learned_part(model) is not None for model in sensor.models):
                self.listen(name)
                learning.append(self._channels[name].listener)
        if learning:
            longest = max(listener.window * listener.period_s for listener in learning if listener is not None)
            self._early, self._revise_s = [], self._time_s + min(self.FIRST_S, self.SETTLE_S + longest)

    def _begin(self, vehicle: Vehicle) -> None:
        """Stand at the start, with the error models of `vehicle` in force."""
        state = self.start.state
        self._time_s = self._sample_s = state.time_s
        self._nav, self._unfolded = state.pack(), 0
        self.counts = dict.fromkeys(("gap", "backward", "bad-sample", "clock-set", "widened", "opened", "adopted"), 0)
        self.intake = Intake(vehicle.drive, state.time_s, self.counts)
        listeners = {name: channel.listener for name, channel in self._channels.items()}
        self._channels = {}
        self._arrange(vehicle)
        for name, listener in listeners.items():
            self._channels[name].listener = listener
        assert state.covariance is not None
        self._P = self.layout.start_covariance(state.covariance)
        self._x = np.zeros(self.layout.size - 9)
        self._xd = self._x[: self.layout.drive.size]
        self._drv = vehicle.drive.memory(self.layout.drive.errors, self.start)
        self._undone = np.zeros(2 * self._head)
        if self._tape is not None:
            self._tape.begin(self.layout)
            for name, sensor in vehicle.sensors.items():
                self._tape.column(name, sensor.axes)
                self._tape.models[name] = [(self._time_s, sensor.error)]
            self._tape.row(self._time_s, self._nav, self._x, self._P)

    def _arrange(self, vehicle: Vehicle) -> None:
        """Lay out the states of the models in force, and the working memory that depends on it."""
        self._in_force = vehicle
        self.layout = layout = Layout.of(vehicle)
        g, m = layout.drive, layout.head
        self._head = m
        self._Phid, self._Qd = g.Phi, g.Q
        self._Cr = np.zeros((6, g.size + 1))
        self._Cr[:, : g.errors], self._Cr[:, -1] = g.C, g.r
        self._acc = np.vstack([np.eye(m), np.zeros((3 * m, m))])
        self._work = np.zeros((m, layout.size))
        self._dims = np.array([0, layout.size, m, 0, 0, 0, 0])
        old, variance = self._channels, self._rate_variance()
        self._channels = {}
        for name, sensor in vehicle.sensors.items():
            self._channels[name] = channel = Channel(name, sensor, layout.groups[name], self.start, layout, variance)
            if name in old:
                channel.clock, channel.listener = old[name].clock, old[name].listener
        self._rest = [c for c in self._channels.values() if isinstance(c.sensor, ZeroVelocity) and self._inertial]

    # ---------------------------------------------------------------- propagation
    def advance(self, samples: Array) -> None:
        """Carry the state over a block of samples: rows of time and six values; the array is used as work space."""
        if not len(samples):
            return
        if self._early is not None:
            self._early.append(samples.copy())
        whole = len(samples) <= self._fold_every - self._unfolded and not self._rest
        samples, stamps = self.intake.take(samples, self._drv, self._at_rest, whole)
        begin, total = 0, len(samples)
        while begin < total:
            end = total if whole else min(total, begin + self._room())
            self._steps(self._nav, self._xd, self._drv, samples[begin:end], self._Phid, self._Qd, self._Cr, self._acc)
            self._unfolded += end - begin
            self._time_s = self._sample_s = self.intake.before_s = float(stamps[-1 if whole else end - 1])
            if self._unfolded >= self._fold_every:
                self._close_second()
            for channel in self._rest:
                self._detect_rest(channel)
            begin = end

    def _room(self) -> int:
        """Samples until something is due: the fold, or the detection of rest."""
        room = self._fold_every - self._unfolded
        if not self._rest:
            return room
        for channel in self._rest:
            window = max(2, round(self.vehicle.drive.rate_hz * channel.period_s))
            room = min(room, max(1, window - int(self._drv[strapdown.COUNT])))
        return max(1, room)

    def _at_rest(self) -> Array:
        """What the drive would read if the vehicle kept still as it started."""
        if not self._inertial:
            return self.state.roll_pitch_heading - np.array([0.0, 0.0, self._drv[strapdown.DECLINATION]])
        level = np.concatenate([np.zeros(3), -self.state.C_nb[2] * strapdown.gravity(self._nav[0], self._nav[2])])
        return level * self._period_s if self._drv[strapdown.INCREMENTS] else level

    def _close_second(self) -> None:
        if self._tape is not None:
            self._tape.record(self._acc[: self._head].reshape(-1), 0, self._dims)
        if self._listening:
            listen.carry(self._undone, self._acc[: self._head])
        kalman.fold(self._P, self._acc, self._nav, self._work)
        self._unfolded = 0
        if self._tape is not None:
            self._tape.row(self._time_s, self._nav, self._x, self._P)

    def _detect_rest(self, channel: Channel) -> None:
        """Zero-velocity update when the last period of the inertial unit was quiet."""
        drv, sensor = self._drv, channel.sensor
        n = drv[strapdown.COUNT]
        if n < max(2, round(self.vehicle.drive.rate_hz * channel.period_s)):
            return
        mean = drv[strapdown.SUMS : strapdown.SUMS + 6] / n
        scatter = np.sqrt(np.maximum(drv[strapdown.SQUARES : strapdown.SQUARES + 6] / n - mean**2, 0.0))
        if drv[strapdown.INCREMENTS]:
            mean, scatter = mean / self._period_s, scatter / self._period_s
        drv[strapdown.COUNT : strapdown.SQUARES + 6] = 0.0
        assert isinstance(sensor, ZeroVelocity)
        quiet = scatter[:3].max() < sensor.gyro_sd_max and scatter[3:].max() < sensor.force_sd_max
        if quiet and np.abs(mean[:3]).max() < sensor.gyro_mean_max:
            self._apply(channel, self._time_s, np.zeros(3), None)

    # ---------------------------------------------------------------- correction
    def channel(self, name: str) -> Channel:
        """Working memory of a sensor."""
        return self._channels[name]

    def take(self, channel: Channel, time_s: float, value: ArrayLike, sd: ArrayLike | None, frozen: bool = False) -> Outcome:
        """Correct the state with a reading that comes in order; `frozen` readings never widen the gate."""
        if self._early is not None:
            if time_s >= self._revise_s:
                self._revise()
                channel = self._channels[channel.name]
            else:
                self._early.append((channel.name, time_s, value, sd, frozen))
        z = np.array(value, dtype=np.float64)  # a copy: kernels want it contiguous and writable
        if z.ndim != 1:
            z = z.reshape(-1)
        early = time_s - self._time_s
        if not math.isfinite(time_s) or len(z) < channel.sensor.reads or not (sd is None or usable(sd, channel.sensor.axes)):
            return self._note(channel, time_s, "invalid")
        if time_s <= channel.last_s:
            return self._note(channel, time_s, "duplicate")
        if early < -1.001 * self._period_s:
            return self._note(channel, time_s, "too-late")
        if time_s - self._sample_s > self._ahead_s:
            return self._note(channel, time_s, "ahead")
        reading = channel.sensor.read(z)
        if reading is None:
            return self._note(channel, time_s, "invalid")
        if early > 1e-7 and self._drv[strapdown.STARTED]:
            self._hold(self._nav, self._xd, self._drv, early, self._Phid, self._Qd, self._Cr, self._acc)
            self._time_s = time_s
        return self._apply(channel, time_s, reading, sd, frozen)

    def _note(self, channel: Channel, time_s: float, status: str, nis: float = math.nan, dof: int = 0, widened: bool = False) -> Outcome:
        if self._tape is not None:
            self._tape.columns[channel.name].append(time_s, CODES[status], channel.note if dof > 0 else None)
        return Outcome(status, nis, dof, widened)

    def _apply(self, channel: Channel, time_s: float, z: Array, sd: ArrayLike | None, frozen: bool = False) -> Outcome:
        tape, nav, P, x = self._tape, self._nav, self._P, self._x
        kalman.predict(P, nav, x, self._acc, channel.model, channel.mem, channel.dims, channel.ticks(time_s))
        self._unfolded = 0
        channel.last_s = time_s
        if channel.turns:
            self._body_rate()
        channel.kernel(z, nav, self._rate, x[channel.parameters], channel.constants, channel.near, channel.res)
        channel.R[:] = channel.white if sd is None else channel.lever + np.eye(channel.sensor.axes) * np.square(np.ravel(sd))
        kalman.update(P, nav, x, channel.C, channel.R, channel.mem, channel.dims, channel.limits)
        nis, dof, used = channel.verdict.tolist()
        widened = False
        if used:
            channel.rejected_since_s = math.nan
        elif dof and math.isfinite(nis) and self._at_fault(channel, time_s, frozen):
            self._open()
        elif dof and math.isfinite(nis) and not frozen:
            widened = self._widen(channel, time_s, nis, int(dof))
        if self._listening:
            self._hear(channel, time_s)
        if used or widened:
            if tape is not None:
                tape.record(channel.record, channel.sensor.axes, channel.dims)
                tape.row(self._time_s, nav, x, P)
            if channel.listener is not None and channel.listener.cursor[0] >= channel.listener.due and self._early is None:
                self._learn(channel)
            return self._note(channel, time_s, "used", nis, int(dof), widened)
        if tape is not None:
            tape.record(channel.moved, 0, channel.dims)
        if dof == 0 or not math.isfinite(nis):
            return self._note(channel, time_s, "invalid")
        return self._note(channel, time_s, "rejected", nis, int(dof))

    def _at_fault(self, channel: Channel, time_s: float, frozen: bool) -> bool:
        """Whether the state is wrong: two sensors or more have been rejected for half their time-outs, and none was used since."""
        if math.isnan(channel.rejected_since_s):
            channel.rejected_since_s = time_s
        if frozen:
            return False
        against = 0
        for other in self._channels.values():
            heard = time_s - other.last_s < max(5.0, 3.0 * other.period_s)
            if heard and time_s - other.rejected_since_s > 0.5 * other.sensor.gate_timeout_s:
                against += 1
            elif heard and math.isnan(other.rejected_since_s) and not isinstance(other.sensor, Depth):
                return False
        return against > 1

    def _open(self) -> None:
        """Give up what is known of attitude, velocity, position and the drive's errors, so that the sensors can say it again."""
        largest = np.zeros(9)
        for channel in self._channels.values():
            if not math.isnan(channel.rejected_since_s):
                seen = np.abs(channel.near[:, :3]).max(axis=0) > 0.5
                residual = np.nanmax(np.abs(channel.note[3 : 3 + channel.sensor.axes]), initial=0.0)
                largest[:3] = np.maximum(largest[:3], np.where(seen, residual, 0.0))
                channel.rejected_since_s = math.nan
        spread = np.concatenate([largest[:3] + 10.0, np.full(3, OPEN_SPEED), OPEN_ATTITUDE])
        self._P[range(9), range(9)] += spread**2
        drive = self.layout.drive
        self._P[drive.slice, drive.slice] += drive.P0
        self.counts["opened"] += 1

    def _widen(self, channel: Channel, time_s: float, nis: float, dof: int) -> bool:
        """After a long series of rejections the gate doubles, and again; True when that lets the reading in."""
        limit = channel.limits[dof]
        if math.isnan(channel.rejected_since_s):
            channel.rejected_since_s = time_s
        periods = math.floor((time_s - channel.rejected_since_s) / channel.sensor.gate_timeout_s)
        if periods < 1 or nis > limit * 2.0 ** min(periods, 500):
            return False
        # A sensor that is rejected for so long shows that the state is less certain than thought: widen P where the sensor sees it. Only
        # there:
        # along P H' a fix that is far off would throw the velocity after the position.
        a, H = channel.sensor.axes, channel.H
        seen = channel.PH @ H.T
        grow = nis / limit * max(1.0, float(np.trace(channel.S[:a]) / max(np.trace(seen), 1e-300)))
        spread = np.diag(self._P)[:9, None] * H[:, :9].T
        inverse = np.linalg.pinv(H[:, :9] @ spread, hermitian=True)
        self._P[:9, :9] += grow * spread @ inverse @ seen @ inverse @ spread.T
        self._P[:] = 0.5 * (self._P + self._P.T)
        first = channel.group.start - 9
        channel.res += channel.C @ self._x[first : first + channel.group.errors]  # `update` takes it off again
        channel.res[~channel.H.any(axis=1)] = np.nan
        channel.R *= max(1.0, nis / limit)  # let in, but not believed more than the gate would have
        kalman.update(self._P, self._nav, self._x, channel.C, channel.R, channel.mem, channel.dims, np.full(a + 1, np.inf))
        channel.rejected_since_s = math.nan
        self.counts["widened"] += 1
        return True

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
        gravity = GRAVITY if self._inertial else 0.0
        listen.listen(
            *(self._undone, channel.mem, channel.dims, channel.places, self._nav, channel.C, self._x),
            *(kind, mount, ring, cursor, channel.count, self._Cr, gravity),
        )

    def _learn(self, channel: Channel) -> None:
        assert channel.listener is not None
        models = channel.listener.learn(0.0)
        if models is not None:
            self.adopt(channel.name, models)

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

        The states follow without a jump: see `navfilter.learned.transfer`. What was adopted goes on the tape.

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

    def _rate_variance(self) -> Array:
        """White variance of the three gyros as rates [rad^2/s^2]; none without an inertial unit."""
        if not self._inertial:
            return np.zeros(3)
        return self.layout.drive.r[:3]

    def _body_rate(self) -> None:
        """Angular rate in b [rad/s] for lever arms; the Earth's own rate (1e-4 rad/s) is left in."""
        if not self._inertial:
            return
        rate = self._drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 3] - self._Cr[:3, :-1] @ self._xd
        self._rate[:] = rate / self._period_s if self._drv[strapdown.INCREMENTS] else rate

    # ---------------------------------------------------------------- what is known, and what it remembers
    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""
        return self._time_s

    @property
    def state(self) -> NavState:
        """The state with its covariance, now; a copy."""
        m = self._head
        P, Phi, Q = self._P[:m, :m], self._acc[:9], self._acc[m : m + 9, :9]
        covariance = Phi @ P @ Phi.T + Q
        return NavState.unpack(self._time_s, self._nav, 0.5 * (covariance + covariance.T))

    @property
    def errors(self) -> dict[str, float]:
        """Estimates of all error states and parameters by name."""
        return dict(zip(self.layout.names, self._x.tolist(), strict=True))

    def memory(self) -> Memory:
        """Everything that changes, copied; the readings that learners keep are not copied but counted."""
        return Memory(
            (self._time_s, self._sample_s, self._unfolded),
            self.intake.clock,
            tuple(a.copy() for a in (self._nav, self._x, self._P, self._acc, self._drv, self._undone)),
            self._in_force,
            {name: (c.clock, c.listener.mark() if c.listener is not None else None) for name, c in self._channels.items()},
            dict(self.counts),
            None if self._early is None else len(self._early),
        )

    def recall(self, memory: Memory) -> None:
        """Go back to what `memory` holds."""
        if memory.in_force is not self._in_force:
            self._arrange(memory.in_force)
        self._time_s, self._sample_s, self._unfolded = memory.clock
        self.intake.clock = memory.intake
        self._nav, self._x, self._P, self._acc, self._drv, self._undone = (a.copy() for a in memory.arrays)
        self._xd = self._x[: self.layout.drive.size]
        for name, (clock, mark) in memory.channels.items():
            self._channels[name].clock = clock
            listener = self._channels[name].listener
            if listener is not None and mark is not None:
                listener.recall(mark)
        self.counts.clear()
        self.counts |= memory.counts
        if self._early is not None and memory.early is not None:
            del self._early[memory.early :]

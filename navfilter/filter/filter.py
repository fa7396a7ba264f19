"""The filter's arithmetic: samples and readings in the order of their times. `navfilter.navigator` is what users see of it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.filter import gating
from navfilter.filter.intake import Intake
from navfilter.filter.layout import Layout
from navfilter.filter.tape import OUTCOMES, Tape
from navfilter.kernels import kalman, strapdown
from navfilter.learning.listener import Channel, usable
from navfilter.start import Start
from navfilter.state import NavState
from navfilter.vehicle import Vehicle

__all__ = ["Engine", "Memory", "Outcome"]

Array = NDArray[np.float64]
#: Beyond this variance of the heading [rad^2] a body velocity is taken with its second-order term.
UNSURE_HEADING = 0.01
CODES = {name: code for code, name in enumerate(OUTCOMES)}


class Outcome(NamedTuple):
    """What became of a reading.

    Attributes
    ----------
    status : str
        "used", "rejected" (by the gate), "invalid", "duplicate", "late-replayed" (used, in its place in time), "too-late", "ahead"
        (no drive sample for too long) or "unknown-sensor".
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
        return self.status in ("used", "late-replayed")


class Memory(NamedTuple):
    """What a run remembers at one moment: clocks and a mark of its listener for every channel, a mark of what was gathered at rest."""

    clock: tuple[float, float, int]
    intake: tuple[float, ...]
    arrays: tuple[Array, ...]
    in_force: Vehicle
    channels: dict[str, tuple[Any, Any]]
    counts: dict[str, int]
    early: int | None = None
    still: Any = None


class Engine:
    """Error-state extended Kalman filter in closed loop, fed in order; see `navfilter.navigator.Navigator`."""

    #: Corrections may come so long after the last sample of the drive, at least [s].
    AHEAD_S = 1.0
    #: Whether `_passed` is called.
    _watching = False

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        if not isinstance(vehicle, Vehicle):
            raise ValueError(f"Navigator needs a Vehicle, found {type(vehicle).__name__}.")
        self.vehicle, self.start, self._tape = vehicle, start, tape
        self._rate = np.zeros(3)
        self._steps, self._hold = vehicle.drive.steps, vehicle.drive.hold
        self._period_s = vehicle.drive.period_s
        self._ahead_s = max(self.AHEAD_S, 3.0 * self._period_s)
        self._fold_every = max(1, round(vehicle.drive.rate_hz))
        self._inertial = vehicle.drive.inertial
        self._channels: dict[str, Channel] = {}
        self._begin(vehicle)

    def _begin(self, vehicle: Vehicle) -> None:
        """Stand at the start, with the error models of `vehicle` in force."""
        state = self.start.state
        self._time_s = self._sample_s = state.time_s
        self._nav, self._unfolded = state.pack(), 0
        self.counts = dict.fromkeys(("gap", "backward", "bad-sample", "clock-set", "widened", "opened", "adopted"), 0)
        self.intake = Intake(vehicle.drive, state.time_s, self.counts)
        self._channels = {}
        self._arrange(vehicle)
        assert state.covariance is not None
        self._P = self.layout.start_covariance(state.covariance)
        self._x = np.zeros(self.layout.size - 9)
        self._xd = self._x[: self.layout.drive.size]
        self._drv = vehicle.drive.memory(self.layout.drive.errors, self.start)
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
        self._rest = [c for c in self._channels.values() if c.sensor.from_drive and self._inertial]

    # ---------------------------------------------------------------- propagation
    def advance(self, samples: Array) -> None:
        """Carry the state over a block of samples: rows of time and six values; the array is used as work space."""
        if not len(samples):
            return
        whole = len(samples) <= self._fold_every - self._unfolded and not (self._rest or self._watching)
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
            if self._watching:
                self._passed(samples[begin:end])
            begin = end

    def _passed(self, samples: Array) -> None:
        """For those who want to see samples that the state has been carried over: no more at once than `_room`."""

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
        kalman.fold(self._P, self._acc, self._nav, self._work)
        self._unfolded = 0
        if self._tape is not None:
            self._tape.row(self._time_s, self._nav, self._x, self._P)

    def _detect_rest(self, channel: Channel) -> None:
        """Correct with what the last period of the inertial unit says, such as a zero velocity when it was quiet."""
        drv = self._drv
        n = drv[strapdown.COUNT]
        if n < max(2, round(self.vehicle.drive.rate_hz * channel.period_s)):
            return
        mean = drv[strapdown.SUMS : strapdown.SUMS + 6] / n
        scatter = np.sqrt(np.maximum(drv[strapdown.SQUARES : strapdown.SQUARES + 6] / n - mean**2, 0.0))
        if drv[strapdown.INCREMENTS]:
            mean, scatter = mean / self._period_s, scatter / self._period_s
        drv[strapdown.COUNT : strapdown.SQUARES + 6] = 0.0
        reading = channel.sensor.felt(mean, scatter)
        if reading is not None:
            self._apply(channel, self._time_s, reading, None)

    # ---------------------------------------------------------------- correction
    def channel(self, name: str) -> Channel:
        """Working memory of a sensor."""
        return self._channels[name]

    def take(self, channel: Channel, time_s: float, value: ArrayLike, sd: ArrayLike | None, frozen: bool = False) -> Outcome:
        """Correct the state with a reading that comes in order; `frozen` readings never widen the gate."""
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
        if channel.sensor.sees_velocity and P[8, 8] > UNSURE_HEADING:
            # second-order term of a velocity seen from a heading that is hardly known (Gelb, 1974, sec. 6.1)
            channel.R[range(3), range(3)] += 0.5 * (nav[3] ** 2 + nav[4] ** 2) * P[8, 8] ** 2
        kalman.update(P, nav, x, channel.C, channel.R, channel.mem, channel.dims, channel.limits)
        nis, dof, used = channel.verdict.tolist()
        widened = False
        if used:
            channel.rejected_since_s = math.nan
        elif dof and math.isfinite(nis) and gating.at_fault(self._channels.values(), channel, time_s, frozen):
            gating.open_wide(P, self._channels.values(), self.layout.drive)
            self.counts["opened"] += 1
        elif dof and math.isfinite(nis) and not frozen:
            widened = gating.widen(P, x, channel, time_s, nis, int(dof))
            if widened:
                kalman.update(P, nav, x, channel.C, channel.R, channel.mem, channel.dims, np.full(channel.sensor.axes + 1, np.inf))
                self.counts["widened"] += 1
        if used or widened:
            if tape is not None:
                tape.record(channel.record, channel.sensor.axes, channel.dims)
                tape.row(self._time_s, nav, x, P)
            return self._note(channel, time_s, "used", nis, int(dof), widened)
        if tape is not None:
            tape.record(channel.moved, 0, channel.dims)
        if dof == 0 or not math.isfinite(nis):
            return self._note(channel, time_s, "invalid")
        return self._note(channel, time_s, "rejected", nis, int(dof))

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
        """Everything that changes, copied."""
        return Memory(
            (self._time_s, self._sample_s, self._unfolded),
            self.intake.clock,
            tuple(a.copy() for a in (self._nav, self._x, self._P, self._acc, self._drv)),
            self._in_force,
            {name: (channel.clock, None) for name, channel in self._channels.items()},
            dict(self.counts),
        )

    def recall(self, memory: Memory) -> None:
        """Go back to what `memory` holds."""
        if memory.in_force is not self._in_force:
            self._arrange(memory.in_force)
        self._time_s, self._sample_s, self._unfolded = memory.clock
        self.intake.clock = memory.intake
        self._nav, self._x, self._P, self._acc, self._drv = (a.copy() for a in memory.arrays[:5])
        self._xd = self._x[: self.layout.drive.size]
        for name, (clock, _) in memory.channels.items():
            self._channels[name].clock = clock
        self.counts.clear()
        self.counts |= memory.counts

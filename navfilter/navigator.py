"""The navigator: the only thing that runs and changes. `step` carries the state, `correct` takes a reading of any named sensor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from navfilter.kernels import kalman, strapdown
from navfilter.layout import Group, Layout
from navfilter.sensors import Sensor, ZeroVelocity
from navfilter.state import NavState
from navfilter.tape import OUTCOMES, Tape
from navfilter.vehicle import Start, Vehicle

__all__ = ["Navigator", "Outcome"]

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


class _Channel:
    """Working memory of one correcting sensor."""

    def __init__(self, name: str, sensor: Sensor, group: Group, start: Start, size: int) -> None:
        a = sensor.axes
        self.name, self.sensor, self.group = name, sensor, group
        self.kernel, self.constants = sensor.kernel, sensor.constants(start)
        self.period_s = 1.0 / sensor.rate_hz
        self.gates = np.concatenate([[np.inf], chi2.ppf(sensor.gate_probability, np.arange(1, a + 1))])
        self.near = np.zeros((a, 9 + group.size - group.errors))
        self.H, self.PH = np.zeros((a, size)), np.zeros((a, size))
        self.K, self.S = np.zeros((size, a)), np.zeros((2 * a, a))
        self.res, self.R = np.zeros(a), group.r.copy()
        self.powers = np.zeros((4, group.size, group.size))
        self.ticks = np.zeros((group.size, size))
        first = group.start - 9
        self.errors = slice(first, first + group.errors)
        self.parameters = slice(first + group.errors, first + group.size)
        self.last_s = self.ticked_s = -math.inf
        self.rejected_since_s = math.nan

    def measure(self, z: Array, nav: Array, rate: Array, x: Array) -> None:
        """Fill the residual and its Jacobian over the whole error state."""
        self.kernel(z, nav, rate, x[self.parameters], self.constants, self.near, self.res)
        g = self.group
        self.H[:] = 0.0
        self.H[:, :9] = self.near[:, :9]
        if g.size:
            self.H[:, g.start : g.start + g.errors] = g.C
            self.H[:, g.start + g.errors : g.start + g.size] = self.near[:, 9:]
            if g.errors:
                self.res -= g.C @ x[self.errors]


class Navigator:
    """Error-state extended Kalman filter over a vehicle's sensors, in closed loop.

    Parameters
    ----------
    vehicle : Vehicle
    start : Start
        Where it is and how well that is known.
    tape : Tape, optional
        Write down what smoother and track need. Without one, memory stays flat.

    Notes
    -----
    `step` compounds the transition of the drive's samples and folds it into the covariance at every correction and at least once a second:
    the same covariance as folding every sample, without the cost. `state` gives it at any sample.

    A correction between two samples holds the last sample until its time; the next sample then covers what is left.

    Examples
    --------
    >>> import navfilter as nf
    >>> vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"depth": nf.Depth(rate_hz=1)})
    >>> nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0))
    >>> nav.step(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
    >>> nav.correct("depth", 0.01, 0.02).status
    'used'
    """

    #: Corrections may come so long after the last sample of the drive, at least [s].
    AHEAD_S = 1.0

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        if not isinstance(vehicle, Vehicle):
            raise ValueError(f"Navigator needs a Vehicle, found {type(vehicle).__name__}.")
        self.vehicle, self.start, self.layout, self._tape = vehicle, start, Layout.of(vehicle), tape
        layout, state = self.layout, start.state
        self._time_s = self._sample_s = state.time_s
        self._nav = state.pack()
        assert state.covariance is not None
        self._P = layout.start_covariance(state.covariance)
        self._x = np.zeros(layout.size - 9)
        g, m = layout.drive, layout.head
        self._head, self._xd = m, self._x[: g.size]
        self._drv = vehicle.drive.memory(g.errors)
        self._Phid, self._Qd = g.Phi, g.Q
        self._Cr = np.zeros((6, g.size + 1))
        self._Cr[:, : g.errors], self._Cr[:, -1] = g.C, g.r
        self._acc = np.vstack([np.eye(m), np.zeros((3 * m, m))])
        self._work = np.zeros((max(m, 9), layout.size))
        self._turn, self._out, self._rate = np.zeros(3), np.zeros(2), np.zeros(3)
        self._steps, self._hold = vehicle.drive.steps, vehicle.drive.hold
        self._period_s = vehicle.drive.period_s
        self._ahead_s = max(self.AHEAD_S, 3.0 * self._period_s)
        self._fold_every = max(1, round(vehicle.drive.rate_hz))
        self._unfolded = 0
        self._inertial = "imu" in vehicle.drive.streams
        self._channels = {
            name: _Channel(name, s, layout.groups[name], start, layout.size) for name, s in vehicle.sensors.items()
        }
        self._rest = [c for c in self._channels.values() if isinstance(c.sensor, ZeroVelocity) and self._inertial]
        self.counts: dict[str, int] = {"gap": 0, "backward": 0, "bad-sample": 0, "widened": 0}
        if tape is not None:
            for name, sensor in vehicle.sensors.items():
                tape.column(name, sensor.axes)
                tape.models[name] = [(self._time_s, sensor.error)]
            tape.row(self._time_s, self._nav, self._x, self._P)

    # ---------------------------------------------------------------- propagation
    def step(self, time_s: ArrayLike, first: ArrayLike, second: ArrayLike) -> None:
        """Carry the state over one sample of the drive, or a block of them.

        Parameters
        ----------
        time_s : float or array_like, shape (n,)
            Time of the sample(s) [s].
        first, second : array_like, shape (3,) or (n, 3)
            For an `Imu` angular rate [rad/s] and specific force [m/s^2] in b (or increments); for `DeadReckoning` roll, pitch, yaw [rad] and
            velocity in instrument axes [m/s].

        Notes
        -----
        Samples that do not come after the last one are dropped; a sample with a NaN repeats the one before (an invalid DVL velocity is held, with
        growing uncertainty). Both are counted in `counts`, like gaps of more than three periods.
        """
        times = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        samples = np.empty((times.size, 7))
        samples[:, 1:4] = first
        samples[:, 4:7] = second
        samples[:, 0] = times
        self.step_samples(samples)

    def step_samples(self, samples: Array) -> None:
        """As `step`, for rows of time and the six values; the array is used as work space."""
        clean = self._clean(samples)
        begin = 0
        while begin < len(clean):
            end = min(len(clean), begin + self._room())
            self._steps(self._nav, self._xd, self._drv, clean[begin:end], self._Phid, self._Qd, self._Cr, self._acc)
            self._unfolded += end - begin
            self._time_s = self._sample_s = float(self._stamps[end - 1])
            if self._unfolded >= self._fold_every:
                self._close_second()
            for channel in self._rest:
                self._detect_rest(channel)
            begin = end

    def _room(self) -> int:
        """Samples until something is due: the fold, or the detection of rest."""
        room = self._fold_every - self._unfolded
        for channel in self._rest:
            window = max(2, round(self.vehicle.drive.rate_hz * channel.period_s))
            room = min(room, max(1, window - int(self._drv[strapdown.COUNT])))
        return max(1, room)

    def _clean(self, samples: Array) -> Array:
        """Turn stamps into steps; drop what does not come after the last sample, repair what is not finite."""
        stamps = samples[:, 0].copy()
        ok = np.isfinite(stamps)
        latest = np.maximum.accumulate(np.where(ok, stamps, -np.inf))
        previous = np.concatenate([[-np.inf], latest[:-1]])
        ok &= (stamps > previous) & (stamps > self._sample_s + (0.0 if self._drv[strapdown.STARTED] else -1e-9))
        if not ok.all():
            self.counts["backward"] += int(np.count_nonzero(~ok))
            samples, stamps = np.ascontiguousarray(samples[ok]), stamps[ok]
        if not len(stamps):
            return samples
        values = samples[:, 1:7] if self._inertial else samples[:, 1:4]
        if not np.isfinite(values).all():
            self._repair(values)
        if not self._inertial and np.isnan(samples[:, 4:7]).any():
            samples[np.isnan(samples[:, 4:7]).any(axis=1), 4:7] = np.nan
        samples[1:, 0] = stamps[1:] - stamps[:-1]
        samples[0, 0] = stamps[0] - self._sample_s
        self.counts["gap"] += int(np.count_nonzero(samples[:, 0] > strapdown.GAP_PERIODS * self._period_s))
        self._stamps = stamps
        return samples

    def _repair(self, values: Array) -> None:
        """Replace samples that are not finite by the last good one."""
        bad = ~np.isfinite(values).all(axis=1)
        self.counts["bad-sample"] += int(bad.sum())
        good = np.maximum.accumulate(np.where(bad, -1, np.arange(len(bad))))
        if self._inertial:
            last = self._drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 6]
            if not self._drv[strapdown.STARTED]:
                last = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.8])
        else:
            last = self._drv[strapdown.PREVIOUS_RPY : strapdown.PREVIOUS_RPY + 3]
        values[bad] = np.where(good[bad, None] >= 0, values[good[bad]], last)

    def _close_second(self) -> None:
        if self._tape is not None:
            self._tape.record(self._acc[: self._head], None, 0)
        self._fold()
        if self._tape is not None:
            self._tape.row(self._time_s, self._nav, self._x, self._P)

    def _fold(self) -> None:
        kalman.fold(self._P, self._acc, self._nav, self._work)
        self._unfolded = 0

    def _detect_rest(self, channel: _Channel) -> None:
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
    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Correct the state with a reading of a named sensor.

        Parameters
        ----------
        name : str
            Key of the sensor in the vehicle.
        time_s : float
            Time of validity [s]; at most about one period of the drive before the present, at most a second after it.
        value : float or array_like
            The reading in SI units and radians; NaN is a missing component.
        sd : float or array_like, optional
            White standard deviation of this one reading, in place of the error model's.

        Returns
        -------
        Outcome
            Never an exception: whatever arrives has a defined outcome.
        """
        channel = self._channels.get(name)
        if channel is None:
            return Outcome("unknown-sensor")
        z = np.atleast_1d(np.asarray(value, dtype=np.float64)).ravel()
        early = time_s - self._time_s
        if not math.isfinite(time_s) or len(z) < channel.sensor.reads:
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
        return self._apply(channel, time_s, reading, sd)

    def _note(self, channel: _Channel, time_s: float, status: str, nis: float = math.nan, dof: int = 0, widened: bool = False) -> Outcome:
        if self._tape is not None:
            formed = status in ("used", "rejected")
            variances = np.diag(channel.S) if formed else None
            self._tape.column(channel.name, channel.sensor.axes).append(
                time_s, CODES[status], nis, dof, self._residual if formed else None, variances
            )
        return Outcome(status, nis, dof, widened)

    def _apply(self, channel: _Channel, time_s: float, z: Array, sd: ArrayLike | None) -> Outcome:
        tape, group = self._tape, channel.group
        transition = self._acc[: self._head].copy() if tape is not None else None
        self._fold()
        tick = self._tick(channel, time_s)
        channel.last_s = time_s
        channel.R[:] = group.r if sd is None else np.square(np.asarray(sd, dtype=float))
        self._body_rate()
        channel.measure(z, self._nav, self._rate, self._x)
        self._residual = channel.res.copy()
        kalman.innovation(self._P, channel.H, channel.res, channel.R, channel.S, channel.PH, self._out)
        nis, dof = float(self._out[0]), int(self._out[1])
        if dof == 0 or not math.isfinite(nis):
            if tape is not None:
                tape.record(transition, tick, group.start)
            return self._note(channel, time_s, "invalid")
        widened = self._gate(channel, time_s, nis, dof)
        if widened is None:
            if tape is not None:
                tape.record(transition, tick, group.start)
            return self._note(channel, time_s, "rejected", nis, dof)
        kalman.correct(self._P, self._nav, self._x, channel.res, channel.S, channel.PH, channel.K, self._turn)
        if tape is not None:
            a = channel.sensor.axes
            tape.record(transition, tick, group.start, (channel.H, channel.K, channel.S[a:], channel.res, self._turn), a)
            tape.row(self._time_s, self._nav, self._x, self._P)
        return self._note(channel, time_s, "used", nis, dof, widened)

    def _tick(self, channel: _Channel, time_s: float) -> Array | None:
        """Advance the sensor's own block by the ticks since it was last heard."""
        group = channel.group
        if group.errors == 0:
            return None
        elapsed, channel.ticked_s = time_s - channel.ticked_s, time_s
        count = 0 if math.isinf(elapsed) else max(1, round(elapsed / channel.period_s))
        if count == 0:
            return None
        kalman.power(group.Phi, group.Q, count, channel.powers)
        kalman.tick(self._P, self._x, group.start, channel.powers[0], channel.powers[1], channel.ticks)
        return channel.powers[0]

    def _gate(self, channel: _Channel, time_s: float, nis: float, dof: int) -> bool | None:
        """False or True: accept (True through a widened gate); None: reject."""
        limit = channel.gates[dof]
        if nis <= limit:
            channel.rejected_since_s = math.nan
            return False
        if math.isnan(channel.rejected_since_s):
            channel.rejected_since_s = time_s
        periods = math.floor((time_s - channel.rejected_since_s) / channel.sensor.gate_timeout_s)
        if periods < 1 or nis > limit * 2.0 ** min(periods, 500):
            return None
        # A sensor that is rejected for so long shows that the state is less certain than thought: widen P along its reading.
        a = channel.sensor.axes
        seen = channel.PH @ channel.H.T + 1e-300 * np.eye(a)
        grow = nis / limit * max(1.0, float(np.trace(channel.S[:a]) / np.trace(seen)))
        self._P += grow * channel.PH.T @ np.linalg.pinv(seen, hermitian=True) @ channel.PH
        self._P[:] = 0.5 * (self._P + self._P.T)
        kalman.innovation(self._P, channel.H, channel.res, channel.R, channel.S, channel.PH, self._out)
        channel.rejected_since_s = math.nan
        self.counts["widened"] += 1
        return True

    def _body_rate(self) -> None:
        """Angular rate against the Earth in b [rad/s] for lever arms; the Earth's own rate (1e-4 rad/s) is left in."""
        if not self._inertial:
            return
        rate = self._drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 3] - self._Cr[:3, :-1] @ self._xd
        self._rate[:] = rate / self._period_s if self._drv[strapdown.INCREMENTS] else rate

    # ---------------------------------------------------------------- what is known
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

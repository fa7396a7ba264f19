"""The filter: the sole owner of the nominal state, its covariance and the error states.
`navfilter.navigation.navigator` is what users see of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.faults import noise_scale, policy, sensor_bias
from navfilter.faults.imu import bias_drift, monitor, realignment
from navfilter.faults.imu.bias_glr import JumpWatch
from navfilter.filter.estimate import Estimate
from navfilter.filter.events import Correction, Listening, Outcome, Passed, Propagated, Relaid
from navfilter.filter.filter_memory import COUNTED, Errors, FilterMemory
from navfilter.filter.imu_intake import Intake
from navfilter.filter.model_change import Adoption, Change, adoption
from navfilter.filter.python_update import asked, shared
from navfilter.filter.records import OUTCOMES, Tape
from navfilter.filter.sensor_channel import Channel, usable
from navfilter.filter.state_layout import Layout
from navfilter.foundation.arguments import needs
from navfilter.kernels import batch, kalman, strapdown
from navfilter.models.error_models import per_axis
from navfilter.models.fault_bias import described, with_the_same_offsets
from navfilter.models.learned_arma import learning_part
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle

__all__ = ["Filter"]

Array = NDArray[np.float64]
CODES = {name: code for code, name in enumerate(OUTCOMES)}


class Filter(Estimate):
    """Error-state extended Kalman filter in closed loop, fed in the order of time.

    `advance` carries the state over samples of the drive, `correct` takes a reading, `adopt` puts another error model
    in force, `recall` goes back to an earlier `memory`. What it does, it tells as events (`navfilter.filter.events`).

    Parameters
    ----------
    vehicle : Vehicle
        As its operator describes it.
    start : Start
    tape : Tape, optional
        To write down what smoother and track need.

    Attributes
    ----------
    in_force : Vehicle
        With the error models that are in force now.
    memory : FilterMemory
        Everything that changes; copy it to keep it (`navfilter.foundation.state_values.copied`).
    layout : Layout
        Of its states.
    channels : dict of str to Channel
    drive_output, drive_sd : ndarray, shapes (6, states of the drive + 1) and (6,)
        Rows of C of the drive's error models, and the white variance of a sample; see `DriveWatch.expected`.
    feels_after : int
        Samples of the drive after which it is felt whether the vehicle rests; 0: never.
    jumped : list of Change
        Error models of sensors that have jumped or gone astray, to be adopted before the next input.
    foreseen : list of Adoption
        What may be adopted next, worked out beforehand.
    accused : float or None
        A velocity sensor has been left behind by the drive, see `ramp.accused`.
    tilted : bool
        Attitude and velocity are to be set anew before the next input, see `realignment.tilted`.

    Raises
    ------
    ValueError
        For no vehicle.
    """

    #: Corrections may come so long after the last sample of the drive, at least [s].
    AHEAD_S = 1.0

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        needs("Navigator: vehicle", vehicle, Vehicle, hint="It is Navigator(vehicle, start).")
        needs("Navigator: start", start, Start, hint="Where it begins: nf.Start(...), or nf.align(vehicle, mission).")
        needs("Navigator: tape", tape, Tape, type(None))
        self.vehicle = vehicle = vehicle.at(start)
        self.start, self.tape, drive = start, tape, vehicle.drive
        self.steps, self.hold, self.period_s = drive.steps, drive.hold, drive.period_s
        self.fold_every, self.ahead_s = max(1, round(drive.rate_hz)), max(self.AHEAD_S, 3.0 * self.period_s)
        self.inertial, self.watch, self.jumps = drive.inertial, monitor.DriveWatch(drive), JumpWatch(drive)
        self.channels = {name: Channel(name, sensor, start) for name, sensor in vehicle.sensors.items()}
        self.remembered = max((drive.remembered(c.past_s) for c in self.channels.values() if c.past_s), default=0)
        self.jumped: list[Change] = []
        self.accused: float | None = None
        self.tilted, self.gyros = False, np.zeros((3, 0))
        self._like: tuple[Vehicle, Layout] | None = None
        self.foreseen: list[Adoption] = []
        self._rest = [self.channels[name] for name, s in vehicle.sensors.items() if s.from_drive and self.inertial]
        shortest_s = min((channel.period_s for channel in self._rest), default=0.0)
        self.feels_after = max(2, round(drive.rate_hz * shortest_s)) if self._rest else 0
        for channel in self._rest:
            channel.samples = self.feels_after
        self.begin()

    def begin(self, models: dict[str, Errors] | None = None) -> None:
        """Stand at the start, with other error models than the described ones in force if `models` are given."""
        state, ended_s = self.start.state, self.time_s if models is not None else 0.0
        assert state.covariance is not None
        counts = dict.fromkeys(COUNTED, 0)
        self.intake = Intake(self.vehicle.drive, state.time_s, counts)
        for channel in self.channels.values():
            channel.forget()
        adopted = tuple((models or {}).items())
        self._arrange(adopted)
        memory = FilterMemory(
            time_s=state.time_s,
            sample_s=state.time_s,
            unfolded=0,
            nav=state.pack(),
            x=self.layout.start_states(),
            P=self.layout.start_covariance(state.covariance),
            acc=self._identity(),
            drv=self.in_force.drive.memory(self.layout.drive.errors, self.start),
            recent=np.zeros((self.remembered, 7)),
            watch=self.watch.fresh(),
            jumps=self.jumps.fresh(self.layout, self.channels, state.time_s),
            intake=self.intake.memory,
            channels={name: channel.memory for name, channel in self.channels.items()},
            models=adopted,
            counts=counts,
        )
        self.watch.refer(memory.watch, memory.nav, memory.P)  # what is unknown weighs by it
        self.recall(memory)
        if self.tape is not None:
            if models is None:
                self.tape.begin(self.layout)
            else:
                self.tape.begin_again(self.layout, ended_s)
            for name, sensor in self.in_force.sensors.items():
                self.tape.column(name, sensor.axes)
                self.tape.models[name] = [(state.time_s, sensor.error)]
            self._note_drive_models()
            self._row()

    def _note_drive_models(self) -> None:
        """Write down the drive's error models where they are learnt."""
        drive = self.in_force.drive
        if self.tape is not None and self.inertial and any(learning_part(model) is not None for model in drive.models):
            self.tape.models |= {name: [(self.time_s, getattr(drive, name))] for name in ("gyro", "accel")}

    def _arrange(self, models: tuple[tuple[str, Errors], ...], found: Adoption | None = None) -> None:
        """Lay out the states with these models in force, and the working memory that depends on it."""
        in_force = found.after if found else self.vehicle.with_error(**dict(models))
        self.layout = layout = found.layout if found else Layout.of(in_force, self._like)
        g, m = layout.drive, layout.head
        if self.inertial and (self._like is None or self._like[1].drive is not g):
            self.gyros = bias_drift.gyros(g, self.period_s)
        self.in_force, self._like, self._laid_out = in_force, (in_force, layout), models
        self.Phid, self.Qd, self.drive_sd = g.Phi, g.Q, self.watch.expected(in_force.drive, g.r)
        self.drive_output, self._work = np.zeros((6, g.size + 1)), np.zeros((m, layout.size))
        self._dims = np.array([0, layout.size, m, 0, 0, 0, 0, 0])
        variance = self.vehicle.drive.rate_variance(g.Q, g.C, g.r)
        for name, channel in self.channels.items():
            channel.arrange(in_force.sensors[name], layout.groups[name], layout, variance)
        self.bench, self.plan, self.drive_spot = shared(list(self.channels.values()), self.vehicle.drive, self._dims)

    def weigh(self) -> None:
        """Believe the drive's axes as far as the watch over them says."""
        g, w = self.layout.drive, self.memory.watch
        self.watch.weigh(w, g.C, g.r, self.drive_output)
        if self.inertial:
            variance = self.watch.rate_variance(w, g.r)
            for channel in self.channels.values():
                channel.turns_by(variance)

    def _identity(self) -> Array:
        return np.eye(4 * self.layout.head, self.layout.head)

    # ---------------------------------------------------------------- what changes
    def recall(self, memory: FilterMemory) -> None:
        """Go back (or on) to a memory, which is then this filter's own."""
        if memory.models is not self._laid_out:
            self._arrange(memory.models)
        self.memory = memory
        self.weigh()
        self._xd = memory.x[: self.layout.drive.size]
        self.intake.memory, self.intake.counts = memory.intake, memory.counts
        for name, channel in self.channels.items():
            channel.memory = memory.channels[name]

    # ---------------------------------------------------------------- propagation
    def advance(self, samples: Array, tell: Listening, room: Callable[[], int] | None = None) -> None:
        """Carry the state over a block of samples: rows of time and six values; the array is used as work space.

        Parameters
        ----------
        samples : ndarray, shape (k, 7)
        tell : callable
            Is told each event as it comes, and may give the filter other error models then.
        room : callable, optional
            Says after how many samples somebody wants to see them at the latest: they are then told as `Passed`.
        """
        if len(samples):
            still = lambda: self.vehicle.drive.at_rest(self.state, self.memory.drv)  # noqa: E731
            for part, stamps in self.intake.take(samples, self.memory.drv, still):
                self._carry(part, stamps, tell, room)

    def carry_on(self, name: str, time_s: float, tell: Listening) -> None:
        """Carry the state to a reading that comes ahead of the drive, where that is silent; `tell` as in `advance`."""
        until_s = time_s - self.channels[name].lead_s
        if until_s - self.memory.sample_s > self.ahead_s:
            missing = self.intake.missing(until_s, self.memory.time_s)
            if missing is not None:
                self._carry(*missing, tell, None)
        realignment.attend(self, False, tell)

    def _carry(self, samples: Array, stamps: Array, tell: Listening, room: Callable[[], int] | None) -> None:
        """Carry the state over samples, or over rows that stand in for those that are missing."""
        memory, begin, total = self.memory, 0, len(samples)
        each = self.tape is not None and self.tape.each_sample
        whole = total <= self.fold_every - memory.unfolded and not (self._rest or room or each)
        missing = self.inertial and total > 0 and math.isnan(samples.item(1))
        if total:
            realignment.attend(self, missing, tell)
        while begin < total:
            end = total if whole else min(total, begin + (1 if each else self._room(room)))
            if missing:
                said_s = min(stamps.item(-1), memory.sample_s + self.ahead_s + self.period_s)  # taken until then
                self.watch.stand_in(samples[begin:end], memory, said_s, self.tape)
                self.weigh()
            elif self.inertial:
                end = begin + self.watch.look(samples[begin:end], memory.watch, self.drive_sd)
            block = samples if end - begin == total else samples[begin:end]
            self.steps(memory.nav, self._xd, memory.drv, block, self.Phid, self.Qd, self.drive_output, memory.acc)
            if memory.recent.size:
                memory.recent = np.concatenate([block[::-1], memory.recent])[: len(memory.recent)]
            memory.unfolded += end - begin
            memory.time_s = memory.sample_s = memory.intake.before_s = stamps.item(end - 1)
            if memory.unfolded >= self.fold_every:
                tell(self._fold())
            elif each:
                self._row()
            self.feel(tell)
            if room is not None:
                tell(Passed(np.full(block.shape, np.nan) if missing else block))
            if self.watch.news(memory.watch):
                self.heed(tell)
            begin = end

    def heed(self, tell: Listening) -> None:
        """Act on what the watch over the drive has found."""
        w = self.memory.watch
        if not batch.heeded(w, self.memory.nav, self.memory.P, self.period_s):
            before = self.watch.lost(w)
            self.watch.heed(self, lambda: tell(self._fold()))
            if before or self.watch.lost(w):
                realignment.after_fault(self, tell)

    def feel(self, tell: Listening) -> None:
        """Take the readings that the drive's last samples make, once in the shortest period of all such sensors."""
        felt = self.vehicle.drive.felt(self.memory.drv, self.feels_after * self.period_s) if self._rest else None
        if felt is None or self.watch.lost(self.memory.watch):
            return
        for channel in self._rest:
            reading = channel.sensor.felt(*felt, self.memory.nav[3:6], self.memory.P[3:6, 3:6])
            if reading is not None:
                tell(self._update(channel, self.memory.time_s, reading, None, False))

    def _room(self, asked: Callable[[], int] | None) -> int:
        """Samples until something is due: the fold, the detection of rest, or what was asked for."""
        room = self.fold_every - self.memory.unfolded
        room = max(1, min(room, self.feels_after - int(self.memory.drv[strapdown.COUNT]))) if self._rest else room
        return room if asked is None else min(room, asked())

    def _fold(self) -> Propagated:
        """Fold the compound transition into P."""
        memory = self.memory
        if self.inertial:
            kalman.discount_heading(memory.P, memory.acc, memory.nav, memory.drv[strapdown.OWN], self._work.reshape(-1))
        transition = memory.acc[: self.layout.head].copy()
        if self.tape is not None:
            self.tape.record(transition.reshape(-1), 0, self._dims)
        kalman.fold(memory.P, memory.acc, memory.nav, self._work)
        memory.unfolded = 0
        self._row()
        return Propagated(transition)

    def _row(self) -> None:
        memory = self.memory
        if self.tape is not None:
            self.tape.row(memory.time_s, memory.nav, memory.x, memory.P, self.present if memory.unfolded else None)

    # ---------------------------------------------------------------- correction
    def correct(
        self,
        name: str,
        time_s: float,
        value: ArrayLike,
        sd: ArrayLike | None = None,
        frozen: bool = False,
        same: bool = False,
    ) -> Correction:
        """Correct the state with a reading that comes in order.

        Parameters
        ----------
        name : str
            Of a sensor of the vehicle.
        time_s : float
            To be taken then (stamp plus `Sensor.lead_s`), at most a period of the drive before the present [s].
        value : array_like
            SI units and radians; NaN is a missing component.
        sd : array_like, optional
            White standard deviation of this one reading.
        frozen : bool
            The value has not changed for suspiciously long: it never widens the gate.
        same : bool
            It is that of the reading before.
        """
        channel, memory = self.channels[name], self.memory
        z = np.array(value, dtype=np.float64).reshape(-1)  # a copy: kernels want it contiguous and writable
        early = time_s - memory.time_s
        if not math.isfinite(time_s) or len(z) < channel.sensor.reads or not (sd is None or usable(sd, channel.sensor)):
            return self._refused(channel, time_s, "invalid")
        if time_s <= channel.memory.last_s:
            return self._refused(channel, time_s, "duplicate")
        if early < -1.001 * self.period_s:
            return self._refused(channel, time_s, "too-late")
        if time_s - channel.lead_s - memory.sample_s > self.ahead_s:
            return self._refused(channel, time_s, "ahead")
        reading = channel.sensor.read(z)
        if reading is None:
            return self._refused(channel, time_s, "invalid")
        # one that could have waited is taken as it is at the end of a run: what comes then is not to be guessed
        holds = early <= 1.001 * self.period_s or not channel.lead_s
        if early > 1e-7 and memory.drv[strapdown.STARTED] and holds:
            self.hold(memory.nav, self._xd, memory.drv, early, self.Phid, self.Qd, self.drive_output, memory.acc)
            memory.time_s = time_s
        channel.stale = same and channel.moved_on(time_s, memory.nav, memory.P)
        return self._update(channel, time_s, reading, sd, frozen or channel.stale)

    def _refused(self, channel: Channel, time_s: float, status: str) -> Correction:
        if self.tape is not None:
            self.tape.columns[channel.name].append(time_s - channel.lead_s, CODES[status], None)
        return Correction(Outcome(status), time_s, None)

    def _update(self, channel: Channel, time_s: float, z: Array, sd: ArrayLike | None, frozen: bool) -> Correction:
        memory = self.memory
        own = channel.variances(z, sd)
        channel.gate[:] = sensor_bias.limits(channel, z, time_s)
        if channel.spot[batch.EQUATION]:
            batch.correction(
                *(self.bench, channel.spot, memory.P, memory.nav, memory.x, memory.acc, memory.drv, self.drive_output),
                *(memory.recent, z, own, channel.ticks(time_s), channel.lead_s + memory.time_s - time_s),
            )
        else:
            asked(channel, memory, self.vehicle.drive, self.drive_output, (z, own), time_s)
        memory.unfolded = 0
        channel.memory.last_s = time_s
        return self.concluded(channel, time_s, frozen)

    def concluded(self, channel: Channel, time_s: float, frozen: bool) -> Correction:
        """What follows from the verdict on a reading, which stands in its channel."""
        channel.stuck, channel.stale = frozen, False
        (nis, dof, used), widened = channel.verdict.tolist(), False
        described = noise_scale.heard(self, channel, time_s, frozen)
        if used:
            policy.used(self, channel, time_s)
        elif dof and math.isfinite(nis):
            widened = policy.let_in(self, channel, time_s, nis, int(dof), frozen)
        nis, channel.verdict[0] = described, channel.verdict[0] if widened else described
        if used or widened:
            status = "used"
            if self.tape is not None:
                self.tape.record(channel.record, channel.axes, channel.dims)
                self._row()
        else:
            status = "rejected" if dof and math.isfinite(nis) else "invalid"
            if self.tape is not None:
                self.tape.record(channel.moved, 0, channel.dims)
        if self.tape is not None:
            note = None if status == "invalid" else channel.note
            self.tape.columns[channel.name].append(time_s - channel.lead_s, CODES[status], note)
        outcome = Outcome(status) if status == "invalid" else Outcome(status, nis, int(dof), widened)
        return Correction(outcome, time_s, channel)

    # ---------------------------------------------------------------- other error models
    take_up = policy.take_up

    def described_models(self, others: Mapping[str, Errors]) -> dict[str, Errors]:
        """Error models put in force since the start, or others, without the constants of sensors that have jumped."""
        return described(self.memory.models, {name: channel.axes for name, channel in self.channels.items()}, others)

    def adopt(self, change: Change, tell: Listening) -> None:
        """Put another error model of one sensor in force, now; the states follow without a jump
        (`navfilter.filter.model_change.transfer`).

        Parameters
        ----------
        change : Change
        tell : callable
            Is told the fold that comes before, and the new layout.

        Raises
        ------
        ValueError
            For an unknown sensor, or something that is no error model.
        """
        memory, channel, error = self.memory, self.channels.get(change.sensor), change.error
        if channel is not None and channel.offset and not change.offsets:
            error = with_the_same_offsets(per_axis(error, channel.axes, change.sensor), channel.sensor.models)
        # refuses what cannot be adopted before anything has changed
        found = adoption(self.in_force, self.layout, change.sensor, error, change.afresh, self.foreseen)
        models = tuple((dict(memory.models) | {change.sensor: error}).items())
        if memory.unfolded:
            tell(self._fold())
        self._arrange(models, found)
        self._change(found.M, found.N)
        memory.x = np.ascontiguousarray(found.M[9:, 9:] @ memory.x)
        memory.acc, memory.models, self._xd = self._identity(), models, memory.x[: self.layout.drive.size]
        self.weigh()
        drive, places = found.after.drive, strapdown.PLACES
        if drive is not found.before.drive:
            memory.drv[places] = drive.memory(self.layout.drive.errors, self.start)[places]
        memory.counts["adopted"] += 1
        if self.tape is not None:
            self.tape.layouts.append(self.layout)
            self.tape.models.setdefault(change.sensor, []).append((memory.time_s, error))
            self._row()
        tell(Relaid(found.M))

    def _change(self, M: Array, N: Array) -> None:
        """Let the error state become ``M x + w``, ``w ~ N(0, N)``."""
        if self.tape is not None:
            self.tape.change(M)
        P = M @ self.memory.P @ M.T + N
        self.memory.P = np.ascontiguousarray(0.5 * (P + P.T))

    def put(self, velocity_n: Array, C_nb: Array, M: Array, N: Array, tell: Listening) -> None:
        """Put another velocity (3,) and attitude (3, 3) in place: of the error state ``M x + w``, ``w ~ N(0, N)``,
        is left.
        """
        if self.memory.unfolded:
            tell(self._fold())
        self.memory.nav[3:6], self.memory.nav[6:15] = velocity_n, C_nb.reshape(-1)
        self._change(M, N)
        self._row()
        tell(Relaid(M, anew=True))

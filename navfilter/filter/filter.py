"""The filter: the sole owner of the nominal state, its covariance and the error states.

Users see `navfilter.navigation.navigator` of it.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from navfilter.filter import actions
from navfilter.filter.actions import Action
from navfilter.filter.events import (
    Correction,
    Listening,
    Measurement,
    Outcome,
    Propagated,
    SamplesUsed,
    StateTransformed,
)
from navfilter.filter.filter_memory import COUNTED, FilterMemory
from navfilter.filter.imu_intake import ImuIntake
from navfilter.filter.model_change import Adoption, Change, adoption, handover
from navfilter.filter.monitor import Actions, Monitor
from navfilter.filter.records import OUTCOMES, Tape
from navfilter.filter.sensor_channel import Channel, usable
from navfilter.filter.state_layout import Layout
from navfilter.foundation.arrays import Array, ArrayLike, Ints
from navfilter.kernels import batch, consistency, fault_bank, kalman, measurement, strapdown
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.models.during import instrument
from navfilter.models.error_models import Errors, per_axis
from navfilter.models.fault_bias import described, has_description, offset_states, with_the_same_offsets
from navfilter.models.learned_arma import learning_part
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.start import Start
from navfilter.models.state import NavState
from navfilter.models.vehicle import Vehicle

CODES = {name: code for code, name in enumerate(OUTCOMES)}


class Beside(NamedTuple):
    """What another explanation of the readings adds to what a filter tells of its state, which itself is left as it is.

    Attributes
    ----------
    share : float
        Its probability.
    moment : ndarray, shape (9, 9)
        Its covariance of position, velocity and attitude, and the square of what it is off from this state.
    radius_m, heading_rad : float
        How far it may be from this one.
    """

    share: float
    moment: Array
    radius_m: float
    heading_rad: float


class Filter:
    """Error-state extended Kalman filter in closed loop, fed in the order of time.

    `propagate` carries the state over samples of the drive, `correct` takes a reading, `adopt` puts another error model
    in force, `apply` does what a monitor asks for, `restore` goes back to an earlier `memory`. What it does, it tells
    as events (`navfilter.filter.events`).

    Parameters
    ----------
    vehicle : Vehicle
        As its operator describes it.
    start : Start
    monitor : Monitor
        Judges readings and samples.
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
        Rows of C of the drive's error models, and the white variance of a sample; see `Monitor.sample_sd`.
    stationary_after : int
        Samples of the drive after which it is felt whether the vehicle rests; 0: never.
    prepared : list of Adoption
        What may be adopted next, worked out beforehand.
    beside : Beside or None
        What another explanation of the readings adds to what is told of the state; see `show_beside`.

    Raises
    ------
    ValueError
        For no vehicle.
    """

    #: Corrections may come so long after the last sample of the drive, at least [s].
    AHEAD_S = 1.0

    def __init__(self, vehicle: Vehicle, start: Start, monitor: Monitor, tape: Tape | None = None) -> None:
        self.vehicle = vehicle = vehicle.at(start)
        self.start, self.monitor, self.tape, drive = start, monitor, tape, vehicle.drive
        self.steps, self.hold, self.period_s = drive.steps, drive.hold, drive.period_s
        self.fold_every, self.ahead_s = max(1, round(drive.rate_hz)), max(self.AHEAD_S, 3.0 * self.period_s)
        self.inertial = drive.inertial
        self.channels = {name: Channel(name, sensor, start) for name, sensor in vehicle.sensors.items()}
        for name, channel in self.channels.items():
            mine = (other for key, other in self.channels.items() if instrument(key) == instrument(name))
            channel.others = tuple(other for other in mine if other is not channel)
        self.remembered = max((drive.remembered(c.past_s) for c in self.channels.values() if c.past_s), default=0)
        self._layout_before: tuple[Vehicle, Layout] | None = None
        self.prepared: list[Adoption] = []
        self.beside: Beside | None = None
        self._rest = [self.channels[name] for name, s in vehicle.sensors.items() if s.from_drive and self.inertial]
        shortest_s = min((channel.period_s for channel in self._rest), default=0.0)
        self.stationary_after = max(2, round(drive.rate_hz * shortest_s)) if self._rest else 0
        for channel in self._rest:
            channel.samples = self.stationary_after
        self.begin()

    def begin(self, models: dict[str, Errors] | None = None) -> None:
        """Stand at the start, with other error models than the described ones in force if `models` are given."""
        state, ended_s = self.start.state, self.time_s if models is not None else 0.0
        assert state.covariance is not None
        counts = dict.fromkeys((*COUNTED, *self.monitor.counted), 0)
        self.intake = ImuIntake(self.vehicle.drive, state.time_s, counts)
        for channel in self.channels.values():
            channel.reset_memory()
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
            intake=self.intake.memory,
            channels={name: channel.noted for name, channel in self.channels.items()},
            models=adopted,
            counts=counts,
        )
        memory.monitor = self.monitor.initial_memory(self, memory)
        self.restore(memory)
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
        self.layout = layout = found.layout if found else Layout.of(in_force, self._layout_before)
        g, m = layout.drive, layout.head
        self.in_force, self._layout_before, self._laid_out = in_force, (in_force, layout), models
        self.Phid, self.Qd, self.drive_sd = g.Phi, g.Q, self.monitor.sample_sd(in_force.drive, g.r)
        self.drive_output, self._work = np.zeros((6, g.size + 1)), np.zeros((m, layout.size))
        self._dims = np.array([0, layout.size, m, 0, 0, 0, 0, 0])
        variance = self.vehicle.drive.rate_variance(g.Q, g.C, g.r)
        for name, channel in self.channels.items():
            channel.arrange(in_force.sensors[name], layout.groups[name], layout, variance)
        self.bench, self.plan, self.bank = shared(
            list(self.channels.values()), self.vehicle.drive, self._dims, *self.monitor.room(layout, self.channels)
        )

    def set_imu_noise(self) -> None:
        """Believe the drive's axes as far as the monitor says."""
        g, remembered = self.layout.drive, self.memory.monitor
        felt = self.monitor.set_imu_noise(remembered, g.C, g.r, self.drive_output)
        if self.inertial:
            self.memory.drv[strapdown.INERTIAL] = strapdown.FELT if felt else strapdown.UNFELT
            variance = self.monitor.rate_variance(remembered, g.r)
            for channel in self.channels.values():
                channel.set_rate_variance(variance)

    def _identity(self) -> Array:
        return np.eye(4 * self.layout.head, self.layout.head)

    # ---------------------------------------------------------------- what changes
    def restore(self, memory: FilterMemory) -> None:
        """Go back (or on) to a memory, which is then this filter's own."""
        if memory.models is not self._laid_out:
            self._arrange(memory.models)
        self.memory = memory
        self.set_imu_noise()
        self._xd = memory.x[: self.layout.drive.size]
        self.intake.memory, self.intake.counts = memory.intake, memory.counts
        for name, channel in self.channels.items():
            channel.noted[:] = memory.channels[name]
            memory.channels[name] = channel.noted
        self.monitor.restore(memory.monitor, self.channels, self.bank)

    def become(self, memory: FilterMemory, tell: Listening) -> None:
        """Go on from what another filter over the same inputs remembers, of which nothing waits to be folded in: of
        what this one has believed nothing is left.
        """
        if self.memory.unfolded:
            tell(self._fold())
        before, models, own = self.layout, dict(self.memory.models), self.monitor.conditions(self.memory.monitor)
        memory.counts = self.memory.counts
        self.restore(memory)
        M, tape = np.zeros((self.layout.size, before.size)), self.tape
        for axis, condition in self.monitor.conditions(memory.monitor).items():
            if own[axis] != condition:
                self.apply(actions.AxisCondition(memory.time_s, axis, condition), tell)
                if condition in memory.counts:
                    memory.counts[condition] += 1
        if tape is not None:
            tape.change(M)
            tape.layouts.append(self.layout)
            for name, error in memory.models:
                if models.get(name) is not error:
                    tape.models.setdefault(name, []).append((memory.time_s, error))
            self._row()
        tell(StateTransformed(M, anew=True))

    def show_beside(self, beside: Beside | None) -> None:
        """Say from now on what another explanation adds."""
        self.beside = beside
        self._row()

    # ---------------------------------------------------------------- propagation
    def propagate(self, samples: Array, tell: Listening, room: Callable[[], int] | None = None) -> None:
        """Carry the state over a block of samples: rows of time and six values; the array is used as work space.

        Parameters
        ----------
        samples : ndarray, shape (k, 7)
        tell : callable
            Is told each event as it comes, and may give the filter other error models then.
        room : callable, optional
            Says after how many samples somebody wants to see them at the latest: they are then told as `SamplesUsed`.
        """
        if len(samples):
            for part, stamps in self.intake.check(samples, self._last_values):
                self._propagate(part, stamps, tell, room)

    def _last_values(self) -> Array:
        """Of the last sample as it came; before the first those of a vehicle that keeps still."""
        drv, drive = self.memory.drv, self.vehicle.drive
        if not drv[strapdown.STARTED]:
            return drive.at_rest(self.state, drv)
        heard = self.monitor.last_values(self.memory.monitor)
        return drv[strapdown.PREVIOUS_RPY :][: len(self.intake.limits)] if heard is None else heard

    def propagate_to(self, name: str, time_s: float, tell: Listening) -> None:
        """Carry the state to a reading that comes ahead of the drive, where that is silent; `tell` as in
        `propagate`."""
        until_s = time_s - self.channels[name].lead_s
        if until_s - self.memory.sample_s > self.ahead_s:
            missing = self.intake.missing(until_s, self.memory.time_s)
            if missing is not None:
                self._propagate(*missing, tell, None)
        self.act(self.monitor.on_silence(self, False), tell)

    def _propagate(self, samples: Array, stamps: Array, tell: Listening, room: Callable[[], int] | None) -> None:
        """Carry the state over samples, or over rows that stand in for those that are missing."""
        memory, begin, total = self.memory, 0, len(samples)
        each = self.tape is not None and self.tape.each_sample
        whole = total <= self.fold_every - memory.unfolded and not (self._rest or room or each)
        missing = self.inertial and total > 0 and math.isnan(samples.item(1))
        if total:
            self.act(self.monitor.on_silence(self, missing), tell)
        while begin < total:
            end = total if whole else min(total, begin + (1 if each else self._room(room)))
            if missing:
                said_s = min(stamps.item(-1), memory.sample_s + self.ahead_s + self.period_s)  # taken until then
                self.act(self.monitor.replace_missing(self, samples[begin:end], said_s), tell)
                self.set_imu_noise()
            elif self.inertial:
                end = begin + self.monitor.check_samples(samples[begin:end], memory.monitor, self.drive_sd)
            else:
                end = begin + strapdown.until_odd(memory.drv, samples[begin:end])
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
            self.correct_stationary(tell)
            if room is not None:
                tell(SamplesUsed(np.full(block.shape, np.nan) if missing else block))
            if self.monitor.has_findings(memory):
                self.act_on_imu(tell)
            begin = end

    def act_on_imu(self, tell: Listening) -> None:
        """Act on what the monitor has found in the samples."""
        self.act(self.monitor.act_on_imu(self), tell)

    def correct_stationary(self, tell: Listening) -> None:
        """Take the readings that the drive's last samples make, once in the shortest period of all such sensors."""
        felt = self.vehicle.drive.felt(self.memory.drv, self.stationary_after * self.period_s) if self._rest else None
        if felt is None or self.memory.monitor.has_excluded:
            return
        for channel in self._rest:
            reading = channel.sensor.felt(*felt, self.memory.nav[3:6], self.memory.P[3:6, 3:6])
            if reading is not None:
                tell(self._update(channel, self.memory.time_s, reading, None, False, tell))

    def _room(self, asked: Callable[[], int] | None) -> int:
        """Samples until something is due: the fold, the detection of rest, or what was asked for."""
        room = self.fold_every - self.memory.unfolded
        room = max(1, min(room, self.stationary_after - int(self.memory.drv[strapdown.COUNT]))) if self._rest else room
        return room if asked is None else min(room, asked())

    def _fold(self) -> Propagated:
        """Fold the compound transition into P."""
        memory = self.memory
        if memory.drv[strapdown.INERTIAL] == strapdown.FELT:
            consistency.attitude_second_order(
                memory.P, memory.acc, memory.nav, memory.drv[strapdown.OWN], self._work.reshape(-1)
            )
        transition = memory.acc[: self.layout.head].copy()
        if self.tape is not None:
            self.tape.record(transition.reshape(-1), 0, self._dims)
        kalman.fold(memory.P, memory.acc, memory.nav, self._work)
        if self.bank.size:
            fault_bank.carry(self.bank, transition, 0)
        memory.unfolded = 0
        self._row()
        return Propagated(transition)

    def _row(self) -> None:
        memory = self.memory
        if self.tape is not None:
            present = self.present if memory.unfolded or self.beside is not None else None
            self.tape.row(memory.time_s, memory.nav, memory.x, memory.P, present, self.unnoticed)

    # ---------------------------------------------------------------- correction
    def correct(self, measured: Measurement, tell: Listening) -> Correction:
        """Correct the state with a measurement that comes in order.

        Parameters
        ----------
        measured : Measurement
            Of a sensor of the vehicle. Its time is when it is taken (stamp plus `Sensor.lead_s`), at most a period of
            the drive before the present.
        tell : callable
            As in `propagate`.
        """
        name, time_s, value, sd, frozen, same = measured
        channel, memory = self.channels[name], self.memory
        z = np.array(value, dtype=np.float64).reshape(-1)  # a copy: kernels want it contiguous and writable
        early = time_s - memory.time_s
        if not math.isfinite(time_s) or len(z) < channel.reads or not (sd is None or usable(sd, channel.sensor)):
            return self._unused(channel, time_s, "invalid")
        if time_s <= channel.memory.last_s:
            return self._unused(channel, time_s, "duplicate")
        if early < -1.001 * self.period_s:
            return self._unused(channel, time_s, "too-late")
        if time_s - channel.lead_s - memory.sample_s > self.ahead_s:
            return self._unused(channel, time_s, "ahead")
        reading = channel.sensor.read(z)
        if reading is None:
            return self._unused(channel, time_s, "invalid")
        if channel.others:
            self._take_over(channel, tell)
        # one that could have waited is taken as it is at the end of a run: what comes then is not to be guessed
        holds = early <= 1.001 * self.period_s or not channel.lead_s
        if early > 1e-7 and memory.drv[strapdown.STARTED] and holds:
            self.hold(memory.nav, self._xd, memory.drv, early, self.Phid, self.Qd, self.drive_output, memory.acc)
            memory.time_s = time_s
        channel.stale = same and self.monitor.is_stale(self, channel, time_s)
        return self._update(channel, time_s, reading, sd, frozen or channel.stale, tell)

    def _take_over(self, channel: Channel, tell: Listening) -> None:
        """Let an instrument that is described otherwise from now on go on where it was."""
        before = channel.predecessor
        if before is None:
            return
        if self.memory.unfolded:
            tell(self._fold())
        M, N = handover(self.layout, self.in_force, before.name, channel.name)
        self.memory.x[:] = M[9:, 9:] @ self.memory.x
        self._transform(M, N)
        self.monitor.transform(self, self.memory.monitor, M, self.bank)
        channel.memory.ticked_s, channel.memory.used_s = before.memory.ticked_s, before.memory.used_s
        self._row()
        tell(StateTransformed(M))

    def _unused(self, channel: Channel, time_s: float, status: str) -> Correction:
        if self.tape is not None:
            self.tape.columns[channel.name].append(time_s - channel.lead_s, CODES[status], None)
        return Correction(Outcome(status), time_s, None)

    def _update(
        self, channel: Channel, time_s: float, z: Array, sd: ArrayLike | None, frozen: bool, tell: Listening
    ) -> Correction:
        """Predict, gate and correct."""
        memory, channel.reading = self.memory, z
        channel.gate[:], own = self.monitor.gate(channel, z, sd, time_s)
        channel.memory.last_s = time_s
        batch.correction(
            *(self.bench, channel.spot, memory.P, memory.nav, memory.x, memory.acc, memory.drv, self.drive_output),
            *(memory.recent, z, own, channel.ticks(time_s), channel.lead_s + memory.time_s - time_s),
        )
        memory.unfolded = 0
        return self.concluded(channel, time_s, frozen, tell)

    def concluded(self, channel: Channel, time_s: float, frozen: bool, tell: Listening) -> Correction:
        """What follows from the verdict on a reading, which stands in its channel."""
        channel.stuck, channel.stale = frozen, False
        nis, dof, _ = channel.verdict.tolist()
        widened, described = self.act(self.monitor.after_gate(self, channel, time_s, frozen), tell)
        nis, channel.verdict[0], used = described, channel.verdict[0] if widened else described, channel.verdict[2]
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

    # ---------------------------------------------------------------- what a monitor asks for
    def act(self, wanted: Actions | Iterator[Action], tell: Listening) -> Any:
        """Do actions as they are yielded: each before the next one is asked for. Returns what the generator returns."""
        try:
            while True:
                self.apply(next(wanted), tell)
        except StopIteration as end:
            return end.value

    def apply(self, action: Action, tell: Listening) -> None:
        """Change the state, its covariance or what belongs to them: nobody else does."""
        memory = self.memory
        match action:
            case actions.Inflate(rows, columns, covariance):
                memory.P[rows, columns] += covariance
            case actions.Count(name, times):
                memory.counts[name] += times
            case actions.Adopt(change):
                self.adopt(change, tell)
            case actions.Transform(velocity_n, C_nb, M, N):
                self._set_velocity_attitude(velocity_n, C_nb, M, N, tell)
            case actions.TurnHeading(compass, angle, variance):
                self._turn_heading(compass, angle, variance)
                self.monitor.begin_again(self, memory.monitor)
            case actions.MovePosition(north_m, east_m):
                memory.nav[0] += north_m / memory.nav[15]
                memory.nav[1] += east_m / (memory.nav[16] * math.cos(memory.nav[0]))
            case actions.Correct(error, covariance):
                kalman.feed_back(memory.nav, memory.x, error)
                memory.P += covariance
                memory.P[:] = 0.5 * (memory.P + memory.P.T)
                self._row()
                tell(StateTransformed(np.eye(len(memory.P)), anew=bool(error.any())))
            case actions.MoveError(place, by):
                memory.x[place] += by
            case actions.Readmit(channel, residual):
                memory.P[:] = 0.5 * (memory.P + memory.P.T)
                channel.res[:] = residual
                self._readmit(channel, channel.C, channel.R)
            case actions.Fold():
                if memory.unfolded:
                    tell(self._fold())
            case actions.Reweigh():
                self.set_imu_noise()
            case actions.RestartRest():
                memory.drv[strapdown.COUNT : strapdown.SQUARES + 6] = 0.0
            case actions.AxisCondition(time_s, axis, condition):
                if self.tape is not None:
                    self.tape.axes.append((time_s, axis, condition))
            case actions.Announce(event):
                tell(event)

    def handle_pending(self, tell: Listening) -> None:
        """Do what refused readings have made necessary, before the next input."""
        if self.act(self.monitor.pending(self), tell):
            self._row()

    # ---------------------------------------------------------------- other error models
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
        if channel is not None and (channel.offset or has_description(channel.sensor.models)) and not change.offsets:
            error = with_the_same_offsets(per_axis(error, channel.axes, change.sensor), channel.sensor.models)
        # refuses what cannot be adopted before anything has changed
        found = adoption(self.in_force, self.layout, change.sensor, error, change.afresh, self.prepared)
        models = tuple((dict(memory.models) | {change.sensor: error}).items())
        if memory.unfolded:
            tell(self._fold())
        self._arrange(models, found)
        self._transform(found.M, found.N)
        self.monitor.transform(self, memory.monitor, found.M, self.bank)
        memory.x = np.ascontiguousarray(found.M[9:, 9:] @ memory.x)
        memory.acc, memory.models, self._xd = self._identity(), models, memory.x[: self.layout.drive.size]
        memory.channels = {name: channel.noted for name, channel in self.channels.items()}
        self.set_imu_noise()
        drive, places = found.after.drive, strapdown.PLACES
        if drive is not found.before.drive:
            memory.drv[places] = drive.memory(self.layout.drive.errors, self.start)[places]
        memory.counts["adopted"] += 1
        if self.tape is not None:
            self.tape.layouts.append(self.layout)
            self.tape.models.setdefault(change.sensor, []).append((memory.time_s, error))
            self._row()
        tell(StateTransformed(found.M))

    def _transform(self, M: Array, N: Array) -> None:
        """Let the error state become ``M x + w``, ``w ~ N(0, N)``."""
        if self.tape is not None:
            self.tape.change(M)
        P = M @ self.memory.P @ M.T + N
        self.memory.P = np.ascontiguousarray(0.5 * (P + P.T))

    def _set_velocity_attitude(self, velocity_n: Array, C_nb: Array, M: Array, N: Array, tell: Listening) -> None:
        """Put another velocity (3,) and attitude (3, 3) in place: of the error state ``M x + w``, ``w ~ N(0, N)``,
        is left.
        """
        if self.memory.unfolded:
            tell(self._fold())
        self.memory.nav[3:6], self.memory.nav[6:15] = velocity_n, C_nb.reshape(-1)
        self._transform(M, N)
        self.monitor.begin_again(self, self.memory.monitor)
        self._row()
        tell(StateTransformed(M, anew=True))

    def _readmit(self, channel: Channel, C: Array, R: Array) -> None:
        """Correct by the residual and Jacobian that stand in a channel, with these errors, without a gate."""
        memory = self.memory
        state = memory.P, memory.nav, memory.x, memory.drv
        batch.readmission(self.bench, channel.spot, *state, self.drive_output, C, R)

    def _turn_heading(self, compass: Channel, angle: float, variance: float) -> None:
        """Turn the heading by an angle of this variance, as by a reading of the compass.

        Attitude and velocity are turned with all that is known of them; then both are opened by the angle together, and
        take the reading. A constant of the compass, if it has one, takes the rest. Nothing waits to be folded in.
        """
        memory, tape, a, north = self.memory, self.tape, compass.axes, compass.sensor.observes.north
        P, nav, x = memory.P, memory.nav, memory.x
        R, M = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]), np.eye(len(P))
        nav[3:5], nav[6:12] = R @ nav[3:5], (R @ nav[6:12].reshape(2, 3)).ravel()
        for at in (3, 6):
            M[at : at + 2, at : at + 2] = R
        P[:] = M @ P @ M.T
        if tape is not None:
            tape.change(M)
        places = compass.group.start + offset_states(compass.sensor.models, compass.period_s, north)
        P[places, places] = np.maximum(np.diag(P)[places], angle**2)
        # a velocity that is known in b goes with the heading
        along = np.zeros(len(P))
        along[[3, 4, 8]] = -nav[4], nav[3], 1.0
        P += angle**2 * np.outer(along, along)
        P[:] = 0.5 * (P + P.T)
        compass.transition[:] = memory.acc[: len(compass.transition)]
        kalman.predict(P, nav, x, memory.acc, compass.model, compass.mem, compass.dims, 0)
        reading = np.full(a + 1, math.nan)  # only its slopes are asked for
        if (
            compass.kernel is measurement.magnetometer
        ):  # they are those of the field that it feels: level, of unknown dip
            field = math.cos(compass.constants[0]), math.sin(compass.constants[0]), 0.0
            reading = np.append(nav[6:15].reshape(3, 3).T @ field, math.nan)
        compass.kernel(reading, nav, compass.rate, x[compass.parameters], compass.constants, compass.near, compass.res)
        compass.res[:], compass.res[north], compass.H[:, 9 : compass.dims[2]] = math.nan, 0.0, 0.0
        self._readmit(compass, np.zeros_like(compass.C), variance * np.eye(a))
        memory.unfolded = 0
        if tape is not None:
            tape.record(compass.record, a, compass.dims)
            self._row()

    # ---------------------------------------------------------------- what is known
    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""
        return self.memory.time_s

    @property
    def nav(self) -> Array:
        """Nominal state, see `NavState.pack`; shape (17,)."""
        return self.memory.nav

    @property
    def x(self) -> Array:
        """Estimated error states behind the nine of navigation, shape (n - 9,)."""
        return self.memory.x

    @property
    def P(self) -> Array:
        """Covariance of all error states as of the last fold, shape (n, n)."""
        return self.memory.P

    @property
    def counts(self) -> dict[str, int]:
        """Irregularities so far."""
        return self.memory.counts

    @property
    def state(self) -> NavState:
        """The state with its covariance, now; a copy."""
        return NavState.unpack(self.memory.time_s, self.memory.nav, self.present[:81].reshape(9, 9))

    @property
    def present(self) -> Array:
        """Covariance of navigation (81 elements), then the variances of all other states, now; shape (72 + n,)."""
        memory, n = self.memory, self.layout.size
        out = np.empty(72 + n)
        inertial, work = memory.drv[strapdown.INERTIAL] == strapdown.FELT, np.empty(9 * (n + self.layout.head + 9))
        kalman.present(memory.P, memory.acc, memory.nav, inertial, memory.drv[strapdown.OWN], work, out)
        if self.beside is not None:
            out[:81] += self.beside.share * (self.beside.moment.reshape(-1) - out[:81])
        return out

    @property
    def unnoticed(self) -> tuple[float, float]:
        """What faults that nobody has noticed may have done to position [m] and heading [rad]."""
        found = (0.0, 0.0) if self.beside is None else self.beside[2:]
        if not self.bank.size:
            return found
        return max(found[0], float(self.bank[fault_bank.RADIUS_M])), max(
            found[1], float(self.bank[fault_bank.HEADING_RAD])
        )

    @property
    def errors(self) -> dict[str, float]:
        """Estimates of all error states and parameters by name."""
        return dict(zip(self.layout.names, self.memory.x.tolist(), strict=True))


#: Steps of the drives, as the kernel takes them.
TRACED = {strapdown.imu_steps: strapdown.imu_traced, strapdown.dead_reckoning_steps: strapdown.dead_reckoning_traced}


def shared(
    channels: Sequence[Channel], drive: Mechanisation, folds: Ints, remembered: int = 0, more: int = 0
) -> tuple[Array, Ints, Array]:
    """Let all channels work in one array.

    Parameters
    ----------
    channels : sequence of Channel
        As they have been laid out.
    drive : Mechanisation
    folds : ndarray of int, shape (7,)
        Dimensions of a fold between readings, see ``kalman.memory_offsets``.
    remembered, more : int
        Numbers that the bank of faults remembers, and works with.

    Returns
    -------
    bench : ndarray
    plan : ndarray of int, shape (channels + 1, PLAN)
        What stands where, see `navfilter.kernels.batch`.
    bank : ndarray, shape (remembered + more,)
        Part of it for the bank of faults.
    """
    n, m = folds[1:3].tolist()
    *begins, end = accumulate((channel.size for channel in channels), initial=0)
    at = end + m * m + max(m * n, 9 * (n + m + 9))
    bench = np.zeros(at + remembered + more)
    last = np.zeros(batch.PLAN, np.int64)
    last[: len(folds)], last[batch.MEM] = folds, end
    last[batch.RECORD] = max([m * m, *(channel.record_size for channel in channels)])
    rows = [channel.settle(bench, begin) for channel, begin in zip(channels, begins, strict=True)]
    last[batch.STEPS] = address(TRACED[drive.steps], addresses.STEPS)
    last[batch.HOLD] = address(drive.hold, addresses.HOLD)
    last[batch.CORRECTION] = address(batch.correction, addresses.CORRECTION)
    for row in rows:
        if row[batch.SIGHT]:
            row[batch.MOTION] = address(drive.moved, addresses.MOTION)
    plan = np.array([*rows, last])
    plan[:, batch.BANK] = at if remembered else 0
    plan[:-1, batch.INDEX] = [channel.first_of(channels) for channel in channels]
    for channel, row in zip(channels, plan, strict=False):
        channel.spot = row
    return bench, plan, bench[at:]

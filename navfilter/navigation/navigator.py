"""The navigator: the only thing that runs and changes. `step` carries the state, `correct` takes a reading of any named
sensor.
"""

import dataclasses
import math
from os import PathLike

import numpy as np

from navfilter.faults.clocks.imu_clock import ImuClockMonitor, ReceivedMeasurement
from navfilter.faults.memory import MonitorMemory
from navfilter.faults.monitor import FaultMonitor
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.events import Event, Measurement, Outcome, UnitDoubted
from navfilter.filter.filter import Filter
from navfilter.filter.imu_intake import samples_of
from navfilter.filter.model_change import Change
from navfilter.filter.records import Tape
from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.state_values import misfit
from navfilter.learning.background import Worker
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.error_models import Errors
from navfilter.models.health import Health
from navfilter.models.start import Start
from navfilter.models.state import NavState, Pose
from navfilter.models.vehicle import Vehicle
from navfilter.navigation import snapshot as snapshots
from navfilter.navigation.alternative import Alternative
from navfilter.navigation.early_rerun import EarlyRerun
from navfilter.navigation.live_runner import prompt_sample, prompts
from navfilter.navigation.memory import NavigatorMemory, check_watches
from navfilter.navigation.runner import History
from navfilter.navigation.status import NavigatorStatus, health_of, state_of
from navfilter.navigation.waiting import MeasurementQueue

__all__ = ["Outcome"]


class Navigator(NavigatorStatus):
    """Error-state extended Kalman filter over a vehicle's sensors, in closed loop.

    Parameters
    ----------
    vehicle : Vehicle
    start : Start
        Where it is and how well that is known.
    tape : Tape, optional
        Write down what smoother and track need. Without one, memory stays flat.
    history_s : float, optional
        Readings may come so late [s]: the state goes back and takes them in their place. Default 2 without a tape, or
        what a sensor of the vehicle needs (`Usbl.late_s`); with one nothing may be late, because what is on the tape
        stays there. Models are learnt from readings older than that, and at least 2 s old.
    threads : bool
        Learn on a thread of its own, so that no call waits for it. Without, and with a tape, what was learnt is worked
        out when it is taken; the results are the same to the last bit.

    Raises
    ------
    ValueError
        For something that is no vehicle, or a history beside a tape.

    monitor : FaultMonitor, optional
        Judges readings and samples in place of the usual one; made for this run.
    alternative : bool
        Go on beside it without the inertial unit while that is in doubt, see `navfilter.navigation.alternative`.

    Notes
    -----
    `step` compounds the transition of the drive's samples and folds it into the covariance at every correction and at
    least once a second: the same covariance as folding every sample, without the cost. `state` gives it at any sample.

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

    #: Default length of the history [s].
    HISTORY_S = 2.0

    def __init__(
        self,
        vehicle: Vehicle,
        start: Start,
        tape: Tape | None = None,
        history_s: float | None = None,
        *,
        threads: bool = True,
        monitor: FaultMonitor | None = None,
        alternative: bool = True,
    ) -> None:
        needs("Navigator: vehicle", vehicle, Vehicle, hint="It is Navigator(vehicle, start).")
        needs("Navigator: start", start, Start, hint="Where it begins: nf.Start(...), or nf.align(vehicle, mission).")
        needs("Navigator: tape", tape, Tape, type(None))
        if vehicle.lanes():
            raise ValueError("this vehicle has lanes: use LaneNavigator, or one of vehicle.lanes().")
        self.vehicle, self.start = vehicle, start
        self.filter = Filter(vehicle, start, FaultMonitor(vehicle) if monitor is None else monitor, tape)
        usual_s = max([self.HISTORY_S, *(sensor.late_s for sensor in vehicle.sensors.values())])
        length_s = (usual_s if tape is None else 0.0) if history_s is None else float(history_s)
        if not (math.isfinite(length_s) and length_s >= 0.0):
            raise ValueError(f"history_s must be a finite number >= 0, found {history_s!r}.")
        if length_s and tape is not None:
            raise ValueError("a run with a tape cannot go back: leave history_s out, and feed it in the order of time.")
        if length_s and not self.filter.monitor.in_batches:
            raise ValueError("this monitor is asked reading by reading, and cannot go back: give history_s=0.")
        # a replay has no history, and learns what the same run learns on board with the default one
        self.learning = LearningSchedule(self.filter, max(length_s, usual_s), Worker(threads and tape is None))
        self.alternative = Alternative(self.filter, vehicle, alternative)
        self.early_rerun = EarlyRerun(self, self.learning.worker)
        self._room = None if self.learning.rest is None else self.learning.room
        names = list(vehicle.sensors)
        self.history = History(self, length_s, names) if length_s else None
        self.sensor_monitors = {name: SensorMonitor.of(sensor) for name, sensor in vehicle.sensors.items()}
        # a recording is in the order of its stamps: there is nothing to be seen of how it arrived
        self.clock = ImuClockMonitor(vehicle.drive.period_s, tape is None, self.filter.ahead_s)
        self.queue, self._row, self.change_count = (
            MeasurementQueue(),
            np.empty((1, 7)),
            0,
        )  # of anything but by ordinary inputs
        self.later_sensors = {name: names[i + 1 :] for i, name in enumerate(names)}
        self.fast_paths, self._imu_fast_path = prompts(self), prompt_sample(self)

    # ---------------------------------------------------------------- what comes in
    def step(self, time_s: ArrayLike, first: ArrayLike, second: ArrayLike) -> None:
        """Carry the state over one sample of the drive, or a block of them.

        Parameters
        ----------
        time_s : float or array_like, shape (n,)
            Time of the sample(s) [s].
        first, second : array_like, shape (3,) or (n, 3)
            For an `Imu` angular rate [rad/s] and specific force [m/s^2] in b (or increments); for `DeadReckoning` roll,
            pitch, yaw [rad] and velocity in instrument axes [m/s].

        Notes
        -----
        Samples that do not come after the last one are dropped, and so is a single stamp far ahead (`ImuIntake`); one
        with a NaN or an impossible value repeats the one before. All are counted in `counts`, like long gaps.
        """
        try:
            if isinstance(time_s, float) and len(first) == 3 == len(second):
                samples = self._row
                samples[0] = time_s, *first, *second
            else:
                samples = samples_of(time_s, first, second)
        except (TypeError, ValueError):
            self.filter.counts["bad-sample"] += 1
            return
        self.step_samples(samples)

    def step_samples(self, samples: Array) -> None:
        """As `step`, for rows of time and the six values; the array is used as work space."""
        for item in self.clock.check_samples(samples):
            if self.queue.readings or isinstance(item, ReceivedMeasurement):
                self._process_item(item)
            else:
                self._propagate(item)

    def _process_item(self, item: Array | ReceivedMeasurement) -> Outcome | None:
        if isinstance(item, ReceivedMeasurement):
            return self._queue_or_correct(item)
        self._propagate_to_queue(item)
        return None

    def _propagate_to_queue(self, samples: Array) -> None:
        while self.queue.readings and len(samples) and samples[-1, 0] + self.offset_s > self.queue.next_s + 1e-9:
            here = int(np.argmax(samples[:, 0] + self.offset_s > self.queue.next_s + 1e-9))
            self._propagate(samples[:here])
            self._correct_due(self.queue.next_s)
            samples = samples[here:]
        self._propagate(samples)

    def _propagate(self, samples: Array) -> None:
        if len(samples) and not (self._imu_fast_path and self._imu_fast_path.take(samples)):
            self._note_input(samples)
            (self if self.history is None else self.history).process(samples)

    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Correct the state with a reading of a named sensor.

        Parameters
        ----------
        name : str
            Key of the sensor in the vehicle.
        time_s : float
            Its stamp [s], from which the sensor's `time_offset_s` is taken off: at most `history_s` (without a history
            about one period of the drive) before the present, at most a second after it.
        value : float or array_like
            The reading in SI units and radians; NaN is a missing component.
        sd : float or array_like, optional
            White standard deviation of this one reading, in place of the error model's.

        Returns
        -------
        Outcome
            Never an exception: whatever arrives has a defined outcome.
        """
        known = isinstance(name, str)
        if known and sd is None and (prompt := self.fast_paths.get(name)) and (outcome := prompt.take(time_s, value)):
            return outcome
        if not (known and name in self.sensor_monitors):
            return Outcome("unknown-sensor")
        try:
            z, time_s = np.array(value, dtype=np.float64).reshape(-1), float(time_s)
        except (TypeError, ValueError):
            z, time_s = np.full(1, np.nan), math.nan
        if (held := self.clock.check_reading(arrived := ReceivedMeasurement(name, time_s, z, sd))) is not None:
            return [Outcome("waiting"), *(self._process_item(item) for item in held)][-1] or Outcome("waiting")
        return self._queue_or_correct(arrived)

    def _queue_or_correct(self, arrived: ReceivedMeasurement) -> Outcome:
        self.change_count += 1
        name, time_s, z, sd = arrived
        time_s += self.offset_s - self.vehicle.sensors[name].time_offset_s
        reading = Measurement(name, time_s + self.filter.channels[name].lead_s, z, sd)
        self._correct_due(time_s)
        if reading.time_s > time_s and time_s < self.start.time_s - 1e-9:
            return Outcome("too-late")
        if reading.time_s > max(time_s, self.time_s):
            self.queue.put(reading)
            return Outcome("waiting")
        return self.correct_now(reading)

    def finish(self) -> None:
        """Take the readings that still wait (`Outcome`): no more samples come."""
        for item in self.clock.flush():
            self._process_item(item)
        self._correct_due()

    def _correct_due(self, time_s: float = math.inf) -> None:
        for reading in self.queue.take_due(time_s) if self.queue.readings else ():
            self.correct_now(reading)

    def correct_now(self, reading: Measurement) -> Outcome:
        """Take a reading now, even one that would wait; users call `correct`."""
        watch = self.sensor_monitors[reading.name]
        reading = Measurement(*reading[:4], *watch.on_arrival(reading.time_s, reading.value))
        outcome = self.correct_in_order(reading)
        self._note_input(reading)
        watch.on_outcome(outcome.status, reading.time_s, outcome.nis, outcome.dof, self.filter.memory.nav)
        return outcome

    def _note_input(self, item: Array | Measurement) -> None:
        """Before samples are taken and after a reading has been: a twin has it, too, and what waits has its turn."""
        if self.early_rerun.twin is not None:
            self.early_rerun.advance_shadow(item)
        if self.learning.worker.waiting and isinstance(item, Measurement):
            self.learning.worker.turn()

    def repeat_input(self, item: Array | Measurement) -> None:
        """Take an input as another run has: samples, or a reading in its place."""
        if isinstance(item, np.ndarray):
            self._propagate(item)
        else:
            self.correct_in_order(item)

    def correct_in_order(self, reading: Measurement) -> Outcome:
        """Take a reading where its time says."""
        history, filter, outcome = self.history, self.filter, None
        if history is None:
            return self.process(reading) or Outcome("too-late")
        # of readings with the same time, those of the sensors named first come first, as in a replay
        behind = [filter.channels[name].memory.last_s for name in self.later_sensors[reading.name]]
        if not (reading.time_s < filter.memory.time_s - 1e-7 or reading.time_s in behind):
            outcome = history.process(reading)
        elif not filter.intake.in_doubt:
            with self.early_rerun.while_going_back():
                outcome = history.correct_late(reading)
            if outcome is not None and outcome.status == "used":
                outcome = outcome._replace(status="late-replayed")
        return outcome or Outcome("too-late")

    def process(self, item: Array | Measurement) -> Outcome | None:
        """Give samples or a reading, in order, to filter and learning; users call `step` and `correct`."""
        if isinstance(item, np.ndarray):
            self.learning.buffer_input(item)
            self.alternative.expect(item)
            self.filter.propagate(item, self.on_event, self._room)
            self.alternative.propagate()
            self.change_count += bool(self.filter.memory.monitor.silent)
            return None
        if self.learning.beginning is not None:
            ahead_s = item.time_s - self.filter.channels[item.name].lead_s - self.filter.memory.sample_s
            if not ahead_s > self.filter.ahead_s:
                self.early_rerun.before(item.time_s)
            self.learning.buffer_input(item)
        beside = self.alternative if self.alternative.is_alive else None
        self.filter.propagate_to(item.name, item.time_s, self.on_event)
        self.on_event(correction := self.filter.correct(item, self.on_event))
        self.filter.handle_pending(self.on_event)
        if beside is not None:
            beside.correct(item, correction, self.on_event)
            self.change_count += 1
        return correction.outcome

    def on_event(self, event: Event) -> None:
        """Show learning what the filter does, and give it the error models that learning answers with."""
        self.change_count += 1
        if isinstance(event, UnitDoubted):
            self.alternative.begin(event)
        for change in self.learning.on_event(event):
            self.filter.adopt(change, self.on_event)
            self.alternative.adopt(change)

    # ---------------------------------------------------------------- error models
    def adopt(self, name: str, error: Errors) -> None:
        """Put other error models of one sensor in force, now; the states follow without a jump, and it goes on the
        tape.

        Readings from before this moment are too late from now on, and the beginning is not done again for learnt
        models. Learning goes on, but for that sensor where the model put in force is none that learns.

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
        self.filter.adopt(Change(name, error), self.on_event)
        self.alternative.adopt(Change(name, error))
        self.learning.adopted_by_hand(name)
        if self.history is not None:
            self.history.start_here()

    def record_residuals(self, name: str, capacity: int | None = None) -> None:
        """Note the open-loop residuals of a sensor, see `navfilter.learning.schedule.LearningSchedule.on_event`."""
        self.change_count += 1
        self.learning.record_residuals(name, capacity)

    def residuals(self, name: str) -> tuple[ChannelSeries, ...]:
        """Open-loop residuals of a sensor that is listened to, one series per axis."""
        return self.learning.series(name)

    # ---------------------------------------------------------------- what is known
    @property
    def memory(self) -> NavigatorMemory:
        """Everything that changes in order; setting one goes back (or on) to it. See
        `navfilter.foundation.state_values`.
        """
        beside = self.alternative
        return NavigatorMemory(self.filter.memory, self.learning.memory, beside.memory, beside.subset.memory)

    @memory.setter
    def memory(self, memory: NavigatorMemory) -> None:
        self.change_count += 1
        self.filter.restore(memory.filter)
        self.learning.memory = memory.learning
        self.alternative.restore(memory.alternative, memory.subset)

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""
        return self.filter.memory.time_s

    @property
    def offset_s(self) -> float:
        """By how much the stamps of samples and readings are moved since the clock was set [s]."""
        return self.filter.memory.intake.offset_s

    @property
    def pose(self) -> Pose:
        """Where it is, how it moves and points, now, in plain numbers: for every sample."""
        return Pose.unpack(self.filter.memory.time_s, self.filter.memory.nav)

    @property
    def state(self) -> NavState:
        """The state with its covariance and the health of the sensors, now; a copy."""
        return state_of(self.filter, self.sensor_monitors, self.clock, self.learning.worker.health)

    @property
    def health(self) -> Health:
        """What the sensors are worth at present."""
        return health_of(self.filter, self.sensor_monitors, self.clock, self.learning.worker.health, self.filter.state)

    # ---------------------------------------------------------------- keep and bring back
    def snapshot(self, path: str | PathLike[str] | None = None) -> bytes:
        """Everything that is needed to go on, to the last bit: as bytes, and in a file if `path` is given.

        Parameters
        ----------
        path : path-like, optional
            Written to a temporary file beside it, synced to the disk and renamed: whatever happens there is one whole
            snapshot.

        Raises
        ------
        ValueError
            For a run with a tape: its records are not kept.
        OSError
            When the file cannot be written.
        """
        if self.filter.tape is not None:
            raise ValueError("a run with a tape keeps no snapshot: make the navigator without one.")
        memory, inputs = (self.memory, []) if self.history is None else self.history.content()
        length_s = 0.0 if self.history is None else self.history.length_s
        saved = (
            self.start,
            length_s,
            memory.whole(),
            inputs,
            self.sensor_monitors,
            self.clock.memory,
            self.queue.readings,
        )
        return snapshots.write(snapshots.SnapshotContent(*saved), self.vehicle, self.time_s, path)

    @classmethod
    def restore(cls, vehicle: Vehicle, source: bytes | str | PathLike[str], *, alternative: bool = True) -> "Navigator":
        """Go on from a snapshot.

        Parameters
        ----------
        vehicle : Vehicle
            The same as that of the snapshot.
        source : bytes or path-like
        alternative : bool
            As of the class.

        Raises
        ------
        ValueError
            When it is damaged, of another version, or of another vehicle.
        OSError
            When the file cannot be read.
        """
        saved = snapshots.read(vehicle, source, (NavigatorMemory, MonitorMemory))
        try:
            return cls._resumed(vehicle, saved, alternative)
        except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise snapshots.unreadable(error) from error

    @classmethod
    def _resumed(cls, vehicle: Vehicle, saved: snapshots.SnapshotContent, alternative: bool) -> "Navigator":
        nav = cls(vehicle, saved.start, history_s=saved.history_s, alternative=alternative)
        check_watches(saved.watches, nav.sensor_monitors)
        nav.sensor_monitors = saved.watches
        nav.resume(saved.memory)
        for item in saved.inputs:
            nav._repeat_input(item)
        for reading in saved.waiting:
            if not nav.filter.channels[reading.name].lead_s:
                raise ValueError(f"a reading of {reading.name} waits")
            nav.queue.put(reading)
        nav.clock.restore(saved.clock)
        return nav

    def resume(self, memory: NavigatorMemory) -> None:
        """Go on from a memory that came from outside; raises ValueError for one that is not of this vehicle."""
        for name, listener in memory.learning.listeners.items():
            if name not in self.learning.listeners:
                self.record_residuals(name, listener.ring.shape[1])
        self.filter.begin(dict(memory.filter.models))
        self.learning.begin_again(-math.inf)
        own, beside, subset = self.filter, memory.alternative, memory.subset
        self.alternative.restore(None, None)
        problem = (
            misfit(dataclasses.replace(memory, alternative=None, subset=None), self.memory, "memory")
            or memory.filter.problem(own.memory)
            or own.monitor.problem(memory.filter.monitor, own.memory.monitor, own.channels)
            or (None if beside is None else self.alternative.problem(beside))
            or (None if subset is None else self.alternative.subset.problem(subset))
        )
        if problem:
            raise ValueError(problem)
        memory.learning.revive(tuple(self.filter.channels))
        self.memory = memory

    def _repeat_input(self, item: Array | Measurement) -> None:
        """An input of a snapshot, again."""
        if isinstance(item, np.ndarray) and (item.ndim != 2 or item.shape[1] != 7):
            raise ValueError(f"inputs must be rows of seven numbers, found shape {item.shape}")
        if self.history is None:
            raise ValueError("it has inputs without a history")
        for take in (self._note_input, self.history.process)[:: 1 if isinstance(item, np.ndarray) else -1]:
            take(item)

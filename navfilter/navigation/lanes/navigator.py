"""Several filters side by side, one for each inertial unit and one without any, and which of them is believed.

Each lane is a `Navigator` of its own over the samples of one unit and the readings of all sensors; none sees another.
`navfilter.faults.lane_selection` compares how well they foretell the readings. A lane that has been wrong begins anew
from the one that is believed (`navfilter.navigation.lanes.state_transfer`), at a time that is fixed in advance.
"""

import dataclasses
import math
from collections.abc import Iterator
from os import PathLike
from typing import Any

import numpy as np

from navfilter.faults.clocks.imu_clock import ImuClockMonitor, ReceivedMeasurement
from navfilter.faults.lane_selection import LaneChoice
from navfilter.faults.memory import MonitorMemory
from navfilter.filter.events import Measurement, Outcome
from navfilter.filter.imu_intake import samples_of
from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.state_values import misfit
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.health import Health, LaneHealth, Trust
from navfilter.models.lane_clock import UPRIGHT, coasting_times, edge_after, level_times
from navfilter.models.start import Start
from navfilter.models.state import NavState, Pose
from navfilter.models.vehicle import DEAD_RECKONING, LEVEL, Vehicle
from navfilter.navigation import snapshot as snapshots
from navfilter.navigation.history import History
from navfilter.navigation.lanes.state_transfer import Transplant, transplant
from navfilter.navigation.memory import LaneMemory, LanesMemory
from navfilter.navigation.navigator import Navigator
from navfilter.navigation.status import NavigatorStatus, health_of

#: Readings come at most so long after the last sample of the drive; so much is no leap of the clock either [s].
AHEAD_S = 1.0


def choice_of(vehicle: Vehicle, start_s: float) -> LaneChoice:
    """The choice among the lanes of a vehicle; readings that wait, and those of a drive, have no part in it."""
    sensors = {name: sensor for name, sensor in vehicle.sensors.items() if not sensor.lead_s}
    force_sd = max(unit.gap_force_sd for unit in vehicle.units.values())
    return LaneChoice([name != DEAD_RECKONING for name in vehicle.lanes()], sensors, start_s, force_sd)


def begin_anew(nav: Navigator, source: Navigator) -> Transplant:
    """Begin a lane anew from the state of another; what it knows of its own unit's samples stays."""
    new = transplant(source.filter, nav.filter)
    nav.filter.restore(new.memory)
    rest = nav.learning.memory.rest
    fresh = LearningSchedule(nav.filter, nav.learning.behind_s)
    fresh.adopted_by_hand()
    nav.learning.memory = dataclasses.replace(fresh.memory, rest=rest)
    return new


class LaneNavigator(NavigatorStatus):
    """A navigator for a vehicle with lanes: what `Navigator` is for one with a single drive, with the same methods.

    Parameters
    ----------
    vehicle : Vehicle
        With several inertial units, or a dead-reckoning lane.
    start : Start
    history_s : float, optional
        As of `Navigator`; at most what that takes by itself.

    Attributes
    ----------
    lanes : dict of str to Navigator
    lane_choice : LaneChoice

    Raises
    ------
    ValueError
        For a vehicle without lanes, and for a longer history.

    Notes
    -----
    Give samples and readings in the order of their times, as they come: samples of all units up to a time before those
    behind it. Models are learnt in the call that comes when they are due.

    Examples
    --------
    >>> import navfilter as nf
    >>> units = {"a": nf.Imu(rate_hz=100), "b": nf.Imu(rate_hz=100)}
    >>> vehicle = nf.Vehicle(imus=units, sensors={"depth": nf.Depth(rate_hz=1)})
    >>> nav = nf.LaneNavigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0))
    >>> for unit in units:
    ...     nav.step(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806), unit)
    >>> nav.correct("depth", 0.01, 0.02).status, nav.state.lane
    ('used', 'a')
    """

    def __init__(self, vehicle: Vehicle, start: Start, history_s: float | None = None) -> None:
        needs("LaneNavigator: vehicle", vehicle, Vehicle, hint="It is LaneNavigator(vehicle, start).")
        described = vehicle.lanes()
        if not described:
            raise ValueError("this vehicle has no lanes: use Navigator, or give it several inertial units (imus=).")
        self.vehicle, self.start = vehicle, start
        usual_s = max([Navigator.HISTORY_S, *(sensor.late_s for sensor in vehicle.sensors.values())])
        length_s = usual_s if history_s is None else float(history_s)
        if not 0.0 <= length_s <= usual_s:
            raise ValueError(f"history_s of a vehicle with lanes must be 0 to {usual_s:g}, found {history_s!r}.")
        self.lanes = {
            name: Navigator(lane, start, history_s=0.0, threads=False, alternative=False)
            for name, lane in described.items()
        }
        for run in self.lanes.values():
            # a unit whose clock goes wrong is left for another
            run.clock = ImuClockMonitor(run.vehicle.drive.period_s, live=False)
        self.lane_choice = choice_of(vehicle, start.time_s)
        # where there is no other unit, its clock is held against that of the readings; a late one is not waited for
        period_s = next(iter(vehicle.units.values())).period_s
        self.clock = ImuClockMonitor(period_s, live=len(vehicle.units) == 1)
        self._names, self._runs = tuple(self.lanes), tuple(self.lanes.values())
        self._units = {name: i for i, name in enumerate(vehicle.units)}
        self._dead_reckoning = self.lanes.get(DEAD_RECKONING)
        self._sensors = {name: i for i, name in enumerate(self.lane_choice.names)}
        self._ticks = self._levels = 1
        self._ahead_s = -math.inf
        names = list(vehicle.sensors)
        self._later_sensors = {name: names[i + 1 :] for i, name in enumerate(names)}
        self.history = History(self, length_s, names) if length_s else None

    # ---------------------------------------------------------------- what comes in
    def step(self, time_s: ArrayLike, first: ArrayLike, second: ArrayLike, unit: str | None = None) -> None:
        """Carry the lane of a unit over one of its samples, or a block of them, see `Navigator.step`.

        Parameters
        ----------
        time_s, first, second : array_like
            As of `Navigator.step`.
        unit : str, optional
            Which inertial unit; may be left out where there is one.

        Raises
        ------
        ValueError
            For a unit that the vehicle does not have.
        """
        name = next(iter(self._units)) if unit is None and len(self._units) == 1 else unit
        if name not in self._units:
            raise ValueError(f'"{unit}" is no inertial unit of this vehicle (units: {", ".join(self._units)}).')
        try:
            samples = samples_of(time_s, first, second)
        except (TypeError, ValueError):
            self.lanes[name].counts["bad-sample"] += 1
            return
        self.step_samples(np.column_stack([samples, np.full(len(samples), float(self._units[name]))]))

    def step_samples(self, samples: Array) -> None:
        """As `step`, for rows of time, the six values and the number of the unit, in the order of `Vehicle.units`."""
        if not len(samples):
            return
        if len(self._units) > 1:
            self._queue_samples(samples)
            return
        for item in self.clock.check_samples(samples[:, :7].copy()):
            self._process_item(item)

    def _process_item(self, item: Array | ReceivedMeasurement) -> Outcome | None:
        if isinstance(item, ReceivedMeasurement):
            return self._correct_in_order(item)
        self._queue_samples(np.column_stack([item, np.zeros(len(item))]))
        return None

    def _queue_samples(self, samples: Array) -> None:
        if len(samples):
            (self if self.history is None else self.history).process(samples)

    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Correct all lanes with a reading of a named sensor, see `Navigator.correct`.

        Returns
        -------
        Outcome
            In the lane that is in force.
        """
        if not isinstance(name, str) or name not in self.vehicle.sensors:
            return Outcome("unknown-sensor")
        try:
            z, stamp_s = np.array(value, dtype=np.float64).reshape(-1), float(time_s)
        except (TypeError, ValueError):
            z, stamp_s = np.full(1, np.nan), math.nan
        if (held := self.clock.check_reading(arrived := ReceivedMeasurement(name, stamp_s, z, sd))) is not None:
            return [Outcome("waiting"), *(self._process_item(item) for item in held)][-1] or Outcome("waiting")
        return self._correct_in_order(arrived)

    def _correct_in_order(self, arrived: ReceivedMeasurement) -> Outcome:
        name, stamp_s, z, sd = arrived
        taken_s = stamp_s + self.offset_s - self.vehicle.sensors[name].time_offset_s
        # the stamp goes along: every lane has a clock of its own
        reading = Measurement(name, taken_s, z, (stamp_s, sd), False)
        if self.history is None:
            return self._correct_lanes(reading)
        channels = self.believed.filter.channels
        overtaken = any(channels[other].memory.last_s == taken_s for other in self._later_sensors[name])
        if not (taken_s < self.time_s - 1e-7 or overtaken):
            outcome = self.history.process(reading)
            assert outcome is not None
            return outcome
        doubt = any(run.filter.intake.in_doubt for run in self._runs)
        late = None if doubt or taken_s < self.start.time_s - 1e-9 else self.history.correct_late(reading)
        if late is None:
            return Outcome("too-late")
        return late._replace(status="late-replayed") if late.status == "used" else late

    def finish(self) -> None:
        """Take the readings that still wait: no more samples come."""
        for item in self.clock.flush():
            self._process_item(item)
        for run in self._runs:
            run.finish()

    # ---------------------------------------------------------------- in order
    def process(self, item: Array | Measurement) -> Outcome | None:
        """Give samples or a reading, in order, to the lanes; users call `step` and `correct`."""
        if not isinstance(item, np.ndarray):
            return self._correct_lanes(item)
        if self._ahead_s > -math.inf and (item[:, 0] + self.offset_s > self.time_s + AHEAD_S).any():
            self._ahead_s = -math.inf  # the units do speak: what has leapt is the clock of all
        while len(item):
            beyond = item[:, 0] + self.offset_s > self._edge_s
            n = int(np.argmax(beyond)) if beyond.any() else len(item)
            if not n and not self._decide_until(float(item[0, 0]) + self.offset_s):
                n = 1  # a stamp from nowhere: the lane itself has to say what it is worth
            self._propagate(item[:n])
            item = item[n:]
        return None

    def _propagate(self, samples: Array) -> None:
        if not len(samples):
            return
        for name, number in self._units.items():
            mine = samples[samples[:, 7] == number, :7]
            if len(mine):
                self.lanes[name].step_samples(mine)
        now_s = max(self.lanes[name].time_s for name in self._units)
        self._propagate_dead_reckoning(now_s)
        self._decide_until(now_s)

    def _decide_until(self, time_s: float) -> bool:
        """Compare the lanes as often as is due before a time, and begin those anew that are doubted; whether it is a
        time that can be.
        """
        if not time_s <= self.time_s + AHEAD_S:
            return False
        while (edge_s := self._edge_s) < time_s:
            self.lane_choice.decide_until(edge_s, behind=True)
            for lane in self.lane_choice.due_restarts():
                begin_anew(self._runs[lane], self.believed)
                self.lane_choice.on_restart(lane)
        self.lane_choice.decide_until(time_s)
        return True

    def _propagate_dead_reckoning(self, until_s: float) -> None:
        """Carry the lane without a unit on."""
        run = self._dead_reckoning
        if run is None:
            return
        for level_s in [*level_times(self.start, self._levels, until_s), math.nan]:
            here_s = until_s if math.isnan(level_s) else float(level_s)
            times = coasting_times(self.start, run.vehicle.drive.rate_hz, self._ticks, here_s)
            if len(times):
                samples = np.zeros((len(times), 7))
                samples[:, 0], self._ticks = times, self._ticks + len(times)
                run.step_samples(samples)
            if here_s == level_s:
                run.correct(LEVEL, here_s, UPRIGHT)
                self._levels += 1

    def _correct_lanes(self, reading: Measurement) -> Outcome:
        stamp_s, sd = reading.sd
        offset_s = self.offset_s
        if self._decide_until(reading.time_s):
            self._ahead_s = -math.inf
            self._propagate_dead_reckoning(reading.time_s)
        elif self._agreed(reading.time_s):
            self._propagate_dead_reckoning(reading.time_s)
        believed, result = self.believed, None
        sensor = self._sensors.get(reading.name)
        for i, run in enumerate(self._runs):
            shift = offset_s if run is self._dead_reckoning else 0.0
            outcome = run.correct(reading.name, stamp_s + shift, reading.value, sd)
            if sensor is not None and outcome.dof:
                note = run.filter.channels[reading.name].note
                axes = (len(note) - 3) // 2
                foretold = note[3 : 3 + axes].tolist(), note[3 + axes :].tolist()
                lost = run.filter.memory.monitor.has_excluded
                self.lane_choice.compare(i, sensor, reading.time_s, *foretold, lost)
            if run is believed:
                result = outcome
        assert result is not None
        return result

    def _agreed(self, time_s: float) -> bool:
        """Whether readings go on to come long after everything else: then time goes on, though no unit speaks."""
        since_s = time_s - self._ahead_s
        if not 0.0 <= since_s <= AHEAD_S:
            self._ahead_s = time_s
        return self._dead_reckoning is not None and 0.5 * AHEAD_S <= since_s <= AHEAD_S

    # ---------------------------------------------------------------- what is known
    @property
    def believed(self) -> Navigator:
        """The lane in force."""
        return self._runs[self.lane_choice.memory.lane]

    @property
    def memory(self) -> LanesMemory:
        """Everything that changes in order; setting one goes back (or on) to it."""
        lanes = {
            name: LaneMemory(run.memory, run.sensor_monitors, run.queue.readings) for name, run in self.lanes.items()
        }
        return LanesMemory(lanes, self.lane_choice.memory, self._ticks, self._levels, self._ahead_s)

    @memory.setter
    def memory(self, memory: LanesMemory) -> None:
        for name, run in self.lanes.items():
            lane = memory.lanes[name]
            run.sensor_monitors, run.queue.readings, run.memory = lane.watches, lane.waiting, lane.run
        self.lane_choice.memory = memory.choice
        self._ticks, self._levels, self._ahead_s = memory.ticks, memory.levels, memory.ahead_s

    @property
    def _edge_s(self) -> float:
        """When lanes may begin anew next [s]."""
        return edge_after(self.lane_choice.compared_s)

    @property
    def time_s(self) -> float:
        """Mission time of the lane that has come farthest [s]."""
        return max(run.time_s for run in self._runs)

    @property
    def offset_s(self) -> float:
        """By how much the stamps of readings are moved since the clock was set [s]: the least of all units, for one may
        have a clock of its own.
        """
        return min((self.lanes[name].offset_s for name in self._units), key=abs)

    @property
    def pose(self) -> Pose:
        """Where it is, how it moves and points, now, in plain numbers."""
        return self.believed.pose

    @property
    def state(self) -> NavState:
        """The state of the lane in force with its covariance and the health of the sensors; a copy."""
        state = self.believed.filter.state
        return dataclasses.replace(state, health=self._health_of(state))

    @property
    def health(self) -> Health:
        """What sensors and lanes are worth at present."""
        return self._health_of(self.believed.filter.state)

    def _health_of(self, state: NavState) -> Health:
        run, name = self.believed, self._names[self.lane_choice.memory.lane]
        watches = {key: watch for key, watch in run.sensor_monitors.items() if key != LEVEL}
        health = health_of(run.filter, watches, self.clock, run.learning.worker.health, state)
        lanes = dict(self._lane_health())
        trust = health.trust
        doubts = [
            f"the lane of {key} is {lane.condition}" for key, lane in lanes.items() if lane.condition == "doubted"
        ]
        doubts += ["no inertial unit is in force"] if run is self._dead_reckoning else []
        if trust is not None and doubts:
            trust = Trust("lost" if trust.level == "lost" else "degraded", (*trust.reasons, *doubts))
        return dataclasses.replace(health, lane=name, lane_reason=self.lane_choice.reason, lanes=lanes, trust=trust)

    def _lane_health(self) -> Iterator[tuple[str, LaneHealth]]:
        memory = self.lane_choice.memory
        gain, nis = (values.tolist() for values in self.lane_choice.means())
        for i, (name, run) in enumerate(self.lanes.items()):
            condition = "in-force" if i == memory.lane else "doubted" if memory.doubted[i] else "ready"
            if name in self._units and self.time_s - run.time_s > AHEAD_S:
                condition = "silent"
            yield (
                name,
                LaneHealth(condition, gain[i], run.filter.monitor.conditions(run.filter.memory.monitor), nis[i]),
            )

    # ---------------------------------------------------------------- keep and bring back
    def snapshot(self, path: str | PathLike[str] | None = None) -> bytes:
        """Everything that is needed to go on, to the last bit, see `Navigator.snapshot`."""
        memory, inputs = (self.memory, []) if self.history is None else self.history.content()
        for lane in memory.lanes.values():
            lane.run = lane.run.whole()
        length_s = 0.0 if self.history is None else self.history.length_s
        saved = snapshots.SnapshotContent(self.start, length_s, memory, inputs, {}, self.clock.memory, [])
        return snapshots.write(saved, self.vehicle, self.time_s, path)

    @classmethod
    def restore(cls, vehicle: Vehicle, source: bytes | str | PathLike[str]) -> "LaneNavigator":
        """Go on from a snapshot, see `Navigator.restore`."""
        saved = snapshots.read(vehicle, source, (LanesMemory, MonitorMemory))
        try:
            return cls._resumed(vehicle, saved)
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise snapshots.unreadable(error) from error

    @classmethod
    def _resumed(cls, vehicle: Vehicle, saved: Any) -> "LaneNavigator":
        nav = cls(vehicle, saved.start, history_s=saved.history_s)
        memory: LanesMemory = saved.memory
        for name, run in nav.lanes.items():
            run.resume(memory.lanes[name].run)
        problem = misfit(memory, nav.memory, "memory")
        if problem or not 0 <= memory.choice.lane < len(nav.lanes):
            raise ValueError(problem or "memory.choice.lane is none")
        nav.memory = memory
        nav.clock.restore(saved.clock)
        for item in saved.inputs:
            if isinstance(item, np.ndarray) and (item.ndim != 2 or item.shape[1] != 8):
                raise ValueError(f"inputs must be rows of eight numbers, found shape {item.shape}")
            if nav.history is None:
                raise ValueError("it has inputs without a history")
            nav.history.process(item)
        return nav

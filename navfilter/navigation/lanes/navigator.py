"""Several filters side by side, one for each inertial unit and one without any, and which of them is believed.

Each lane is a `Navigator` of its own over the samples of one unit and the readings of all sensors; none sees another.
`navfilter.faults.lane_selection` compares how well they foretell the readings. A lane that has been wrong begins anew
from the one that is believed (`navfilter.navigation.lanes.state_transfer`), at a time that is fixed in advance.

Replay of a vehicle with lanes: each lane goes through the mission in stretches, and they are compared in between.

The tracks of a vehicle with lanes: forward that of the lane in force, smoothed along what the last one came from.
"""

import bisect
import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from navfilter.faults.clocks.imu_clock import ImuClockMonitor, ReceivedMeasurement
from navfilter.faults.imu.monitor import USED
from navfilter.faults.lane_selection import HISTORY, LaneChoice
from navfilter.faults.memory import MonitorMemory
from navfilter.filter.events import Measurement, Outcome
from navfilter.filter.imu_intake import samples_of
from navfilter.filter.records import Residuals, Tape
from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.state_values import misfit
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.health import Health, LaneHealth, LaneHistory, Trust
from navfilter.models.lane_clock import UPRIGHT, coasting_times, edge_after, level_times
from navfilter.models.lane_missions import lane_mission
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.state import NavState, Pose
from navfilter.models.vehicle import DEAD_RECKONING, LEVEL, Vehicle
from navfilter.navigation import snapshot as snapshots
from navfilter.navigation.lanes.state_transfer import Transplant, transplant
from navfilter.navigation.memory import LaneMemory, LanesMemory
from navfilter.navigation.navigator import Navigator
from navfilter.navigation.recorded_inputs import drive_samples, readings_of
from navfilter.navigation.runner import BatchRunner, History
from navfilter.navigation.status import NavigatorStatus, health_of
from navfilter.navigation.track_assembly import assembled, bar, bounds_along, gathered, smoothed_track
from navfilter.track.track import Track

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
            # with what the lane without a unit is told at that time: one that begins anew may begin from it
            self._propagate_dead_reckoning(math.nextafter(edge_s, math.inf))
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


#: A tape, and the time [s] behind which and up to which it counts.
Stretch = tuple[Tape, float, float]


def replayed_lanes(
    vehicle: Vehicle, mission: Mission, start: Start, output_rate_hz: float | None, *, smooth: bool, progress: bool
) -> Track:
    """Replay a mission by all lanes of a vehicle, see `navfilter.replay`.

    Returns
    -------
    Track
        Forward: at each time the lane that was in force then. Smoothed: the lane that was in force last, before it
        began anew the one that it began from, and so on to the start: one run, in which a lane that went wrong has no
        part.
    """
    began = time.process_time()
    run = LaneReplay(vehicle, mission, start, output_rate_hz, smooth)
    with bar(run.readings, "filter", progress) as told:
        run.run(told)
    track = _forward(run, mission, began)
    if not smooth:
        return track
    nav = run.believed.nav
    nav.filter.tape = smoothable(run.believed.pieces[-1])
    smoothed = smoothed_track(track, nav, began, progress)
    return dataclasses.replace(
        smoothed,
        vehicle=vehicle,
        error_models=track.error_models,
        counts=track.counts,
        epoch_utc_s=mission.epoch_utc_s,
        lanes=track.lanes,
        lane_history=track.lane_history,
    )


def _forward(run: "LaneReplay", mission: Mission, began: float) -> Track:
    """The track as it was given out: of the lane in force."""
    lanes = {lane.name: lane for lane in run.lanes}
    ends = [*(time_s for time_s, _ in run.changes[1:]), math.inf]
    stretches = [
        (piece_at(lanes[name].pieces, begin_s).tape, begin_s, end_s)
        for (begin_s, name), end_s in zip(run.changes, ends, strict=True)
    ]
    parts = [part for stretch in stretches for part in _rows(stretch)]
    rows = gathered(parts)
    track = assembled("forward", run.believed.nav, rows, mission.name, time.process_time() - began)
    sensors = run.vehicle.sensors
    models: dict[str, list[tuple[float, Any]]] = {}
    for tape, begin_s, end_s in stretches:
        for key, history in tape.first_models().items():
            there = [model for time_s, model in history if time_s <= begin_s][-1:] or [history[0][1]]
            before = models.setdefault(key, [])
            before += [(max(begin_s, run.start.time_s), m) for m in there if not before or before[-1][1] != m]
            before += [(time_s, model) for time_s, model in history if max(begin_s, history[0][0]) < time_s <= end_s]
    track = dataclasses.replace(
        track,
        vehicle=run.vehicle,
        residuals={name: _residuals(name, stretches) for name in track.residuals if name in sensors},
        error_models={name: found for name, found in models.items() if name in sensors or name in ("gyro", "accel")},
        epoch_utc_s=mission.epoch_utc_s,
        lanes=tuple((max(time_s, run.start.time_s), name) for time_s, name in run.changes),
        lane_history=run.history,
    )
    bounds = bounds_along(track, rows.unnoticed)
    for (begin_s, name), end_s in zip(run.changes, ends, strict=True):
        if name == DEAD_RECKONING:  # nothing holds it against its velocity
            bounds[(track.time_s > begin_s) & (track.time_s <= end_s), 0] = math.inf
    return dataclasses.replace(track, bounds=bounds)


def _rows(stretch: Stretch) -> list[tuple[Tape, range]]:
    """Where the rows stand that were first given out in a stretch."""
    whole, begin_s, end_s = stretch
    parts = []
    for tape, rows in whole.first_rows():
        times = tape.row_times[rows.start : rows.stop]
        first, last = bisect.bisect_right(times, begin_s), bisect.bisect_right(times, end_s)
        if first < last:
            parts.append((tape, range(rows.start + first, rows.start + last)))
    return parts


def _residuals(name: str, stretches: list[Stretch]) -> Residuals:
    """Residuals of a sensor, each of the lane that was in force."""
    found = []
    for tape, begin_s, end_s in stretches:
        whole = tape.first_residuals()[name]
        mine = (whole.time_s > begin_s) & (whole.time_s <= end_s)
        found.append([getattr(whole, key.name)[mine] for key in dataclasses.fields(Residuals)])
    return Residuals(*(np.concatenate(values) for values in zip(*found, strict=True)))


@dataclass
class Piece:
    """What a lane has written down since it began, or began anew.

    Attributes
    ----------
    tape : Tape
    begin_s : float
        Mission time [s].
    before : Piece or None
        Of the lane that it has begun anew from,
    records, rows, times_begun : int
        what stood on that tape then, and how often that lane had begun again itself,
    transition, M : ndarray
        and how the states came from there, see `navfilter.navigation.lanes.state_transfer.Transplant`.
    """

    tape: Tape
    begin_s: float
    before: "Piece | None" = None
    records: int = 0
    rows: int = 0
    times_begun: int = 0
    transition: Array = field(default_factory=lambda: np.zeros((0, 0)))
    M: Array = field(default_factory=lambda: np.zeros((0, 0)))


class LaneReplay:
    """A run of all lanes over a mission.

    Parameters
    ----------
    vehicle : Vehicle
        With lanes.
    mission : Mission
    start : Start
    output_rate_hz, smooth
        As of `navfilter.replay`.

    Attributes
    ----------
    changes : list of (float, str)
        From when [s] which lane was in force.

    Raises
    ------
    ValueError
        When a stream is missing, or no inertial unit speaks and there is no lane without one.
    """

    def __init__(
        self, vehicle: Vehicle, mission: Mission, start: Start, output_rate_hz: float | None, smooth: bool
    ) -> None:
        self.vehicle, self.start, self._end_s = vehicle, start, mission.end_s
        self._rate_hz, self._smooth = output_rate_hz, smooth
        described = vehicle.lanes()
        missions = {name: lane_mission(vehicle, mission, name, start) for name in described}
        if not any(len(missions[name].streams["imu"]) for name in described):
            raise ValueError(f"none of the inertial units ({', '.join(vehicle.units)}) has a single sample.")
        self.choice: LaneChoice = choice_of(vehicle, start.time_s)
        self.lanes = [
            _Lane(name, lane, missions[name], start, Tape(output_rate_hz, smoothable=smooth))
            for name, lane in described.items()
        ]
        self.changes = [(-math.inf, self.lanes[0].name)]
        self._reasons: list[str] = []
        self._compared: list[tuple[float, Array, Array]] = []
        self.choice.told = self._keep

    @property
    def readings(self) -> int:
        """How many readings all lanes take, for a progress bar."""
        return sum(lane.readings for lane in self.lanes)

    @property
    def believed(self) -> "_Lane":
        """The lane in force."""
        return self.lanes[self.choice.memory.lane]

    def run(self, progress: Callable[[int], object] | None = None) -> None:
        """Go through the mission."""
        now_s = self.start.time_s
        while now_s < self._end_s:
            now_s = edge_after(now_s)
            for lane in self.lanes:
                lane.run_until(now_s, progress)
            self._compare(now_s)
            if now_s < self._end_s:
                for number in self.choice.due_restarts():
                    self.lanes[number].begin_anew(self.believed, Tape(self._rate_hz, smoothable=self._smooth))
                    self.choice.on_restart(number)
        for lane in self.lanes:
            lane.nav.finish()

    def _compare(self, until_s: float) -> None:
        """Take what the lanes foretold since this was last called, in the order of time."""
        heard = [
            (time_s, number, sensor, foretold)
            for number, lane in enumerate(self.lanes)
            for sensor, name in enumerate(self.choice.names)
            for time_s, foretold in lane.foretold(name)
        ]
        heard.sort(key=lambda item: item[:3])
        changes = []
        for time_s, number, sensor, foretold in heard:
            changes += self.choice.decide_until(time_s)
            self.choice.compare(number, sensor, time_s, *foretold)
        if until_s < self._end_s:
            changes += self.choice.decide_until(until_s, behind=True)
        self.changes += [(time_s, self.lanes[number].name) for time_s, number, _ in changes]
        self._reasons += [reason for *_, reason in changes]

    def _keep(self) -> None:
        if self.choice.memory.step % HISTORY == 0:
            self._compared.append((self.choice.compared_s, *self.choice.means()))

    @property
    def history(self) -> LaneHistory:
        """How the lanes did so far."""
        times, gain, nis = zip(*self._compared, strict=True) if self._compared else ((), (), ())
        names = tuple(lane.name for lane in self.lanes)
        gains, squares = (np.array(each).reshape(-1, len(names)) for each in (gain, nis))
        return LaneHistory(names, np.array(times), gains, squares, tuple(self._reasons))


class _Lane:
    """One lane on its way through a mission."""

    def __init__(self, name: str, vehicle: Vehicle, mission: Mission, start: Start, tape: Tape) -> None:
        self.name = name
        self.nav = Navigator(vehicle, start, tape, alternative=False)
        silent = not len(mission.streams["imu"])
        self._times, values = (np.empty(0), np.empty((0, 6))) if silent else drive_samples(vehicle, mission)
        self._readings = readings_of(vehicle, mission, start.time_s)
        done = int(np.searchsorted(self._times, start.time_s - 1e-9))
        self._passage = BatchRunner(self.nav, self._times, values, self._readings, done)
        self._told: dict[str, int] = {}
        self._out = self._left_out()
        self.pieces = [Piece(tape, start.time_s)]

    @property
    def readings(self) -> int:
        """How many it takes."""
        return len(self._readings.time_s)

    def run_until(self, time_s: float, progress: Callable[[int], object] | None) -> None:
        """Everything up to a time."""
        readings = int(np.searchsorted(self._readings.time_s, time_s, side="right"))
        samples = int(np.searchsorted(self._times, time_s, side="right"))
        before = self._passage.at
        self._passage.run_until(readings, samples)
        if progress is not None:
            progress(self._passage.at - before)

    def _left_out(self) -> set[str]:
        """Axes of its unit that something else stands in for, now."""
        filter = self.nav.filter
        return set(filter.monitor.excluded_axes(filter.memory.monitor))

    def _carried(self) -> tuple[list[float], list[bool]]:
        """From when on [s] something stood in for an axis of its unit, and from when on nothing."""
        out, times, carried = set(self._out), [-math.inf], [bool(self._out)]
        for time_s, axis, condition in self.pieces[-1].tape.first_axes():
            (out.discard if condition in USED else out.add)(axis)
            times.append(time_s)
            carried.append(bool(out))
        return times, carried

    def foretold(self, name: str) -> Iterator[tuple[float, tuple[list[float], list[float], bool]]]:
        """Readings of a sensor since this was last asked: time; residuals, their variances, and whether something stood
        in for axes of the unit.
        """
        first, (times, carried) = self._told.get(name, 0), self._carried()
        rows = self.pieces[-1].tape.first_notes(name, first)
        self._told[name] = first + len(rows)
        axes = (rows.shape[1] - 4) // 2
        for row in rows[rows[:, 2] > 0.0].tolist():
            yield row[0], (row[4 : 4 + axes], row[4 + axes :], carried[bisect.bisect_right(times, row[0]) - 1])

    def begin_anew(self, source: "_Lane", tape: Tape) -> None:
        """From the state of another lane, on another tape."""
        filter, written = self.nav.filter, source.pieces[-1]
        given = written.tape
        given.lent, stood = True, (len(given.records), len(given.row_times), given.times_begun)
        now_s = source.nav.time_s
        filter.tape = None
        new = begin_anew(self.nav, source.nav)
        tape.begin(filter.layout)
        for name, sensor in filter.in_force.sensors.items():
            tape.column(name, sensor.axes)
            tape.models[name] = [(now_s, sensor.error)]
        filter.tape, self._told, self._out = tape, {}, self._left_out()
        self.pieces.append(Piece(tape, now_s, written, *stood, new.transition, new.M))


def piece_at(pieces: list[Piece], time_s: float) -> Piece:
    """The one that was being written at a time [s]."""
    return next((piece for piece in reversed(pieces) if piece.begin_s <= time_s), pieces[0])


def smoothable(piece: Piece) -> Tape:
    """The tape of a lane, and before it those of the lanes that it has begun anew from: one run from the start."""
    chain = [piece]
    while chain[0].before is not None:
        chain.insert(0, chain[0].before)
    whole = Tape(smoothable=True)
    whole.layouts.clear()
    for one, then in zip(chain, [*chain[1:], None], strict=True):
        if then is None:
            whole.append(one.tape)
        else:
            whole.append(one.tape.as_of(then.times_begun), then.records, then.rows)
        if then is not None:
            m = len(then.transition)
            whole.record(then.transition.reshape(-1), 0, np.array([0, then.M.shape[1], m, 0, 0, 0, 0, 0]))
            whole.change(then.M)
    return whole

"""Replay of a vehicle with lanes: each lane goes through the mission in stretches, and they are compared in between.

The tracks of a vehicle with lanes: forward that of the lane in force, smoothed along what the last one came from.
"""

import bisect
import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navfilter.faults.imu.monitor import USED
from navfilter.faults.lane_selection import HISTORY, LaneChoice
from navfilter.filter.records import Residuals, Tape
from navfilter.foundation.arrays import Array
from navfilter.models.health import LaneHistory
from navfilter.models.lane_clock import edge_after
from navfilter.models.lane_missions import lane_mission
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.vehicle import DEAD_RECKONING, Vehicle
from navfilter.navigation.lanes.navigator import begin_anew, choice_of
from navfilter.navigation.navigator import Navigator
from navfilter.navigation.recorded_inputs import drive_samples, readings_of
from navfilter.navigation.runner import BatchRunner
from navfilter.navigation.track_assembly import assembled, bar, bounds_along, gathered, smoothed_track
from navfilter.track.track import Track

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
    shown = bar(run.readings, "filter", progress)
    run.run(None if shown is None else shown.update)
    if shown is not None:
        shown.close()
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

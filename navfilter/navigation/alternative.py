"""A second filter beside a run while its inertial unit is in doubt: one of the two uses it, the other does without.

A sensor that goes on to contradict the state may be wrong, or the state may be, for the unit that carries it is. The
same filter without the accelerometers (the velocity is a random walk, no tilt turns gravity into it), and if the
attitude is contradicted without the gyros, too, follows the sensors whatever the unit says. Both are given the same
inputs, and how likely each made the readings of the last minute decides which of them is the run
(`navfilter.faults.lane_selection`). The run that does without tries the unit again in the same way: the filter beside
it then uses it, from the present state, its biases opened by what the vehicle may do unseen. Where only accelerometers
are left out, and the attitude is contradicted, it is the gyros that the filter beside it does without meanwhile.

The second filter is there only while something is in doubt: nothing is taken by kernels in stretches meanwhile.
"""

import math
from dataclasses import dataclass

import numpy as np

from navfilter.faults import policy, settings
from navfilter.faults.alternative_path import followed, full_residual
from navfilter.faults.lane_selection import LaneChoice, LaneChoiceMemory
from navfilter.faults.monitor import FaultMonitor
from navfilter.faults.sensor_bias import was_right
from navfilter.filter.actions import Fold, Inflate
from navfilter.filter.events import Correction, Event, Listening, Measurement, UnitDoubted
from navfilter.filter.filter import Filter
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Change
from navfilter.foundation.arrays import Array
from navfilter.foundation.state_values import copied, misfit
from navfilter.kernels import imu_checks
from navfilter.models.lane_clock import ANEW_S
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.lanes.state_transfer import transplant
from navfilter.navigation.subset_filter import SubsetFilter, SubsetMemory

#: The filter that uses the unit, the one without its accelerometers, and the one without any of it, as `LaneChoice`
#: numbers them.
WITH_UNIT, NO_FORCES, NO_UNIT = range(3)
#: Less the run and the one beside it this is the one that is not there.
ALL = WITH_UNIT + NO_FORCES + NO_UNIT
#: What sensors of attitude and of angular rates correct: it is the gyros that they contradict.
TURNS = ("heading", "")


@dataclass
class AlternativeMemory:
    """Everything that changes in the second filter.

    Attributes
    ----------
    filter : FilterMemory
        Of the one that is not the run.
    choice : LaneChoiceMemory
        Its `lane` is what the run is, or is to be by the next reading.
    lane, beside : int
        What the run is, and what the second filter is.
    refused_s : float
        When a sensor has contradicted the run last [s].
    confirmed : ndarray, shape (sensors,)
        1: the sensor was right for long before.
    settles : bool
        The second filter has begun to use the unit, and still finds its biases.
    probation_s : float
        So long the unit has to show itself [s]: twice as long after each time that it has failed again.
    patience_s : float
        A trial that fails is given up after so long [s]: twice as long each time.
    """

    filter: FilterMemory
    choice: LaneChoiceMemory
    lane: int
    beside: int
    refused_s: float
    confirmed: Array
    settles: bool
    probation_s: float
    patience_s: float


class Alternative:
    """The second filter.

    Parameters
    ----------
    main : Filter
        That of the run.
    vehicle : Vehicle
    wanted : bool
        Without, there is never one.

    Attributes
    ----------
    is_alive : bool
        Whether anything goes on beside the run at present.
    subset : SubsetFilter
        What the run would be without a sensor for which the unit was left out.
    """

    def __init__(self, main: Filter, vehicle: Vehicle, wanted: bool = True) -> None:
        self._main, self._vehicle, self._made, self._paired = main, vehicle, False, False
        self.wanted, self.subset, self.is_alive = wanted, SubsetFilter(main, vehicle), False
        self._filter: Filter
        self._choice: LaneChoice
        self._lane, self._refused_s, self._settles, self._patience_s = WITH_UNIT, math.nan, False, ANEW_S
        self._beside = NO_UNIT
        self._rows: Array | None = None
        told = [sensor.observes for sensor in vehicle.sensors.values()]
        self._carries = wanted and vehicle.drive.inertial
        self._carries = self._carries and any(observes.corrects in ("velocity", "position") for observes in told)
        # without a compass nothing but gyros keeps the heading: what is lost then does not come back
        self._needs_gyros = all(observes.north is None for observes in told)

    @property
    def memory(self) -> AlternativeMemory | None:
        """Everything that changes in the second filter; None without one."""
        if not self._paired:
            return None
        own, choice = self._filter.memory, self._choice
        now = self._lane, self._beside, self._refused_s, choice.alone, self._settles
        return AlternativeMemory(own, choice.memory, *now, choice.probation_s, self._patience_s)

    def restore(self, memory: AlternativeMemory | None, subset: SubsetMemory | None) -> None:
        """Go back (or on) to these."""
        self._paired, self.subset.memory = memory is not None, subset
        self._note()
        if memory is not None:
            self._filter.restore(memory.filter)
            self._choice.memory, self._choice.alone = memory.choice, memory.confirmed
            self._choice.probation_s, self._patience_s = memory.probation_s, memory.patience_s
            self._lane, self._beside = memory.lane, memory.beside
            self._refused_s, self._settles = memory.refused_s, memory.settles

    def _note(self) -> None:
        self.is_alive = self._paired or self.subset.memory is not None

    def _prepare(self) -> None:
        """Nothing is left of an earlier life."""
        if not self._made:
            self._made, self._filter = True, Filter(self._vehicle, self._main.start, FaultMonitor(self._vehicle))
        force_sd = self._vehicle.drive.gap_force_sd  # type: ignore[attr-defined]
        self._choice = LaneChoice([True, False, False], dict(self._vehicle.sensors), self._main.time_s, force_sd)
        self._numbers = {name: i for i, name in enumerate(self._choice.names)}
        self._lane, self._refused_s, self._settles = WITH_UNIT, self._main.time_s, False
        self._beside, self._patience_s = NO_UNIT, ANEW_S

    def problem(self, memory: AlternativeMemory) -> str | None:
        """What is wrong with a memory that came from outside, in words; None when nothing is: then it is this one's."""
        self._prepare()
        self._filter.begin(dict(memory.filter.models))
        self._paired, own = True, self._filter
        found = misfit(memory, self.memory, "memory.alternative") or memory.filter.problem(own.memory)
        found = found or own.monitor.problem(memory.filter.monitor, own.memory.monitor, own.channels)
        both = {memory.lane, memory.beside}
        if not found and not (len(both) == 2 and memory.choice.lane in both <= {WITH_UNIT, NO_FORCES, NO_UNIT}):
            found = "memory.alternative.lane is none"
        if not found and not (abs(memory.choice.step) < 2**53 and math.isfinite(memory.refused_s)):
            found = "memory.alternative has a time that is none"
        return found

    def begin(self, doubt: UnitDoubted) -> None:
        """A sensor has contradicted the run: go on without what it doubts of the unit beside it, if anything could.

        Parameters
        ----------
        doubt : UnitDoubted
            If that is `told`, the run does without the unit by the next reading.
        """
        if not self._carries:
            return
        lane = self._lane if self._paired else WITH_UNIT
        if lane == NO_FORCES:
            if self._beside != NO_UNIT and self._doubts_gyros(doubt, "depth"):
                self._leave_out(NO_UNIT, doubt.since_s)
            if self._beside == NO_UNIT:
                self._refused_s = self._main.time_s
            return
        if lane == NO_UNIT or self._main.memory.monitor.has_excluded:
            return
        if not self._paired:
            self._prepare()
            velocities = [self._main.channels[name] for name in self._choice.names]
            right = [bool(one.ground) and was_right(self._main, one) for one in velocities]
            self._choice.alone = np.array(right, dtype=np.float64)
            self._leave_out(NO_UNIT if self._doubts_gyros(doubt) else NO_FORCES, doubt.since_s)
            self._paired, suspects = True, self._suspects()
            if suspects and self.subset.memory is None:
                self.subset.begin(copied(self._main.memory), suspects)
            self._note()
        elif self._beside == NO_FORCES and self._doubts_gyros(doubt):
            self._leave_out(NO_UNIT, doubt.since_s)
        self._refused_s = self._main.time_s
        if doubt.told:
            self._choice.memory.lane, self._choice.memory.doubted[WITH_UNIT] = self._beside, 1.0

    def _doubts_gyros(self, doubt: UnitDoubted, *others: str) -> bool:
        """Whether gyros are to be left out, too."""
        return doubt.corrects in (*TURNS, *others) and not self._needs_gyros

    def _leave_out(self, lane: int, since_s: float) -> None:
        """Let the second filter begin anew from the run, without what may have been wrong since a time [s]."""
        own, main = self._filter, self._main
        refused = [c.name for c in main.channels.values() if not math.isnan(c.faults.rejected_since_s)]
        ways = {name: main.channels[name].faults.way for name in refused}
        known_s = since_s if all(way is None for way in ways.values()) else main.time_s
        self._take_state()
        for name, way in ways.items():
            # if it was the unit, what was refused is right: the way of a velocity was made, a place is where it is
            channel, off = own.channels[name], full_residual(main, main.channels[name])
            off[np.abs(off) > settings.MOST_OFF.get(channel.sensor.observes.corrects, math.inf)] = math.nan
            if way is not None:
                channel.faults.way = way
                own.act(followed(own, channel), _ignore)
                channel.faults.way = None
                velocity = float(np.nansum(off**2))
                own.apply(Inflate(range(2, 6), range(2, 6), np.array([way.length**2, *[velocity] * 3])), _ignore)
            elif channel.sensor.observes.corrects in ("position", "depth"):
                seen = np.nan_to_num(main.channels[name].near[:, :3])
                own.apply(Inflate(range(3), range(3), np.nan_to_num(off) ** 2 @ seen**2), _ignore)
        self._beside, self._settles = lane, False
        self._exclude(slice(3, 6), known_s)
        if lane == NO_UNIT:
            self._exclude(slice(3), since_s)
        self._choice.on_restart(lane)
        self._choice.leave(ALL - lane - self._lane)

    def _exclude(self, axes: slice, since_s: float) -> None:
        """Let the second filter use axes of the unit no more, which may have been wrong since a time [s]."""
        own = self._filter
        found = own.memory.monitor.imu[: imu_checks.UNIT][axes]
        found[:, imu_checks.CODE], found[:, imu_checks.BEGAN_S] = imu_checks.CONTRADICTED, own.time_s - since_s
        own.act(own.monitor.imu_monitor.heed(own), _ignore)  # type: ignore[attr-defined]

    def _take_state(self) -> None:
        """Stand where the run stands, with the errors of the unit as at the start and no reading refused."""
        self._filter.begin(dict(self._main.memory.models))
        given = copied(self._main.memory)
        memory = transplant(self._main, self._filter).memory
        memory.sample_s, memory.drv, memory.recent, memory.intake = (
            *(given.sample_s, given.drv, given.recent, given.intake),
        )
        memory.monitor.imu[:] = given.monitor.imu
        for kept in memory.monitor.channels.values():
            kept.rejected_since_s, kept.refused, kept.way = math.nan, None, None
        self._filter.restore(memory)

    def adopt(self, change: Change) -> None:
        """The run has put another error model in force, perhaps in the middle of a block of samples."""
        self.subset.adopt(change)
        if not self._paired:
            return
        rows, now_s = self._rows, self._main.memory.time_s
        if rows is not None:
            taken = int(np.count_nonzero(rows[:, 0] + self._main.memory.intake.offset_s <= now_s))
            self._filter.propagate(rows[:taken], _ignore)
            self._rows = rows[taken:]
        self._filter.adopt(change, _ignore)

    def expect(self, samples: Array) -> None:
        """The run is about to take samples; the array is left as it is."""
        self._rows = samples.copy() if self._paired else None
        self.subset.expect(samples)

    def propagate(self) -> None:
        """Take what was expected, as the run has."""
        rows, self._rows = self._rows, None
        if rows is not None:
            self._filter.propagate(rows, _ignore)
        self.subset.propagate()

    def correct(self, reading: Measurement, correction: Correction, tell: Listening) -> None:
        """Take a reading that the run has just taken, and see which of the two is to go on.

        Parameters
        ----------
        reading : Measurement
        correction : Correction
            What became of it in the run.
        tell : callable
            Is told what happens to the run's state.
        """
        if self.subset.memory is not None:
            self._hear_subset(reading, correction, tell)
        if self._paired:
            self._compare(reading, correction, tell)
        self._note()

    def _hear_subset(self, reading: Measurement, correction: Correction, tell: Listening) -> None:
        """See whether the run erred when it left out the unit for a sensor, or the sensor did."""
        right = self.subset.correct(reading, correction)
        if right is not None:
            kept = self.subset.end()
            if right:
                self._paired, main = False, self._main
                off = float(np.linalg.norm(main.nav[3:6] - kept.filter.nav[3:6]))
                main.become(kept.filter, tell)
                for name in kept.without:
                    main.act(policy.errs(main, main.channels[name], off, kept.began_s), tell)

    def _compare(self, reading: Measurement, correction: Correction, tell: Listening) -> None:
        """See which of the two filters is to go on."""
        own = self._filter
        own.propagate_to(reading.name, reading.time_s, _ignore)
        answer = own.correct(reading, self._heard)
        own.handle_pending(_ignore)
        number, lane, beside = self._numbers.get(reading.name), self._lane, self._beside
        self._choice.decide_until(self._main.time_s)
        for filter, which, said in ((self._main, lane, correction), (own, beside, answer)):
            # a value that comes again, to the bit, says nothing new, and is easily foretold
            if number is not None and said.outcome.dof and not (reading.same or reading.frozen):
                note = filter.channels[reading.name].note
                axes = (len(note) - 3) // 2
                foretold = note[3 : 3 + axes].tolist(), note[3 + axes :].tolist()
                lost = which == WITH_UNIT and filter.memory.monitor.has_excluded
                self._choice.compare(which, number, reading.time_s, *foretold, lost)
        if self._choice.memory.lane != lane:
            self._change_places(tell)
        elif beside == WITH_UNIT and self._is_given_up():
            self._patience_s *= settings.LONGER
            self._try_unit()
        elif self._settles and self._tried_s() >= settings.SETTLES_S:
            self._stand_where_the_run_is()
        if self._beside != WITH_UNIT and self._main.time_s - self._refused_s > settings.WINDOW_S:
            if self._lane == WITH_UNIT:
                self._paired = False
                if self._choice.memory.begun[WITH_UNIT] == -math.inf and self.subset.memory is not None:
                    self.subset.end()  # the run is what it was
            else:
                self._try_unit()

    def _heard(self, event: Event) -> None:
        """The second filter without the accelerometers is contradicted, too: its gyros are left out as well."""
        if isinstance(event, UnitDoubted) and self._beside == NO_FORCES and self._doubts_gyros(event, "depth"):
            self._exclude(slice(3), event.since_s)
            self._choice.on_restart(NO_UNIT, NO_FORCES)
            self._choice.leave(NO_FORCES)
            self._beside = NO_UNIT

    def _is_given_up(self) -> bool:
        """Whether a trial of the unit has failed, or has not shown itself in time."""
        longest_s = self._choice.probation_s + ANEW_S
        failed = WITH_UNIT in self._choice.due_restarts()
        return self._tried_s() >= (min(self._patience_s, longest_s) if failed else longest_s)

    def _tried_s(self) -> float:
        """How long ago the second filter began to use the unit [s]."""
        tried = self._choice.memory
        return (tried.step - float(tried.begun[WITH_UNIT])) * settings.LANE_STEP_S

    def _stand_where_the_run_is(self) -> None:
        """Take the position of the run: while biases were found the second filter has been led off."""
        main, own = self._main.memory, self._filter
        own.apply(Fold(), _ignore)
        given = copied(own.memory)
        for part in (slice(0, 3), slice(15, 17)):  # latitude, longitude, height; radii of curvature there
            given.nav[part] = main.nav[part]
        given.P[:3] = given.P[:, :3] = 0.0
        given.P[:3, :3] = self._main.present[:81].reshape(9, 9)[:3, :3]
        own.restore(given)
        self._settles = False
        self._choice.on_restart(WITH_UNIT)  # it is judged from now on

    def _change_places(self, tell: Listening) -> None:
        """Let the run go on as the second filter, and that as the run."""
        self._filter.apply(Fold(), _ignore)
        was, self._lane, self._beside = self._lane, self._beside, self._lane
        self._settles, self._refused_s = False, self._main.time_s
        if was == WITH_UNIT and self._choice.memory.begun[WITH_UNIT] > -math.inf:
            self._choice.probation_s *= settings.LONGER
        given, before = copied(self._filter.memory), copied(self._main.memory)
        self._main.become(given, tell)
        if self._lane == WITH_UNIT:
            self._filter.restore(before)
            return
        self._patience_s = ANEW_S
        self._try_unit()

    def _suspects(self) -> list[str]:
        """The velocities that contradict the run, if nothing else does: then it may be they that err."""
        refused = [c for c in self._main.channels.values() if not math.isnan(c.faults.rejected_since_s)]
        told = [c.sensor.observes.corrects for c in refused]
        return [c.name for c in refused if c.ground] if all(t in ("velocity", "position") for t in told) else []

    def _try_unit(self) -> None:
        """Let the second filter begin anew from the run, with the unit, whose biases may be what was wrong."""
        own, drive = self._filter, self._vehicle.drive
        self._take_state()
        monitor: FaultMonitor = own.monitor  # type: ignore[assignment]
        axes = own.memory.monitor.imu[: imu_checks.UNIT]
        out = axes[:, imu_checks.CODE] == imu_checks.CONTRADICTED
        axes[out, imu_checks.CODE] = imu_checks.GOOD
        own.act(monitor.imu_monitor.heed(own), _ignore)
        unknown = out * np.repeat([drive.gap_rate_sd, drive.gap_force_sd], 3)  # type: ignore[attr-defined]
        for places, sd in zip(own.layout.drive.biases, unknown.tolist(), strict=True):
            first = own.layout.drive.start + places[:1]
            own.apply(Inflate(first, first, sd**2), _ignore)
        self._choice.on_restart(WITH_UNIT)
        self._choice.leave(ALL - WITH_UNIT - self._lane)
        self._beside, self._settles = WITH_UNIT, True


def _ignore(event: Event) -> None:
    """Nobody listens to the second filter."""

"""A filter beside a run that does without the sensors which have contradicted the inertial unit.

Where a velocity contradicts what the unit feels, and nothing else speaks for one of them, a force that is felt wrongly
and a velocity that errs explain the same readings. The run goes on without the accelerometers
(`navfilter.navigation.alternative`). What it would be if the velocity erred is carried beside it, by the unit and all
other sensors, until their readings tell the two apart: the covariance that is told has the distance between them, by
the odds (Magill, 1965; Bar-Shalom, Li and Kirubarajan, 2001, sec. 1.4.16), and the protection radius reaches as far as
the other one does (solution separation: Blanch et al., 2015).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navfilter.faults import settings
from navfilter.faults.alternative_path import most_speed
from navfilter.faults.monitor import FaultMonitor
from navfilter.faults.protection_level import IN_LINE, IN_PLANE
from navfilter.filter.actions import Fold, Inflate
from navfilter.filter.events import Correction, Event, Measurement
from navfilter.filter.filter import Beside, Filter
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Change
from navfilter.foundation.arrays import Array
from navfilter.foundation.state_values import misfit
from navfilter.kernels.fault_bank import BELIEVED, DOUBLED
from navfilter.models.vehicle import Vehicle


@dataclass
class SubsetMemory:
    """Everything that changes in it.

    Attributes
    ----------
    filter : FilterMemory
    without : tuple of str
        The sensors that it does without.
    against_run, against : float
        How much likelier of late what has been read is to have come from errors twice as large as the run foretold, and
        as this filter did [nat]. So the sharper of the two gains nothing by that: the run does without all
        accelerometers because of one.
    is_open : bool
        The run has used them since: until then it does what this one does.
    most_m_s : float
        No faster than this either of the two is believed to be [m/s].
    began_s, fixed_s : float
        When it began, and time of the first fix since it began [s]; infinite before that.
    """

    filter: FilterMemory
    without: tuple[str, ...]
    against_run: float
    against: float
    is_open: bool
    most_m_s: float
    began_s: float
    fixed_s: float


class SubsetFilter:
    """The filter.

    Parameters
    ----------
    main : Filter
        That of the run.
    vehicle : Vehicle

    Attributes
    ----------
    memory : SubsetMemory or None
        None: there is none at present.
    """

    def __init__(self, main: Filter, vehicle: Vehicle) -> None:
        self._main, self._vehicle = main, vehicle
        self._own: Filter | None = None
        self._memory: SubsetMemory | None = None
        self._rows: Array | None = None

    @property
    def filter(self) -> Filter:
        """What carries it; made when it is needed first."""
        if self._own is None:
            self._own = Filter(self._vehicle, self._main.start, FaultMonitor(self._vehicle))
        return self._own

    @property
    def memory(self) -> SubsetMemory | None:
        """Everything that changes; setting it goes back (or on) to it."""
        if self._memory is not None:
            self._memory.filter = self.filter.memory
        return self._memory

    @memory.setter
    def memory(self, memory: SubsetMemory | None) -> None:
        self._memory = memory
        if memory is not None:
            self.filter.restore(memory.filter)
        self.show()

    def problem(self, memory: SubsetMemory) -> str | None:
        """What is wrong with a memory that came from outside, in words; None when nothing is: then it is this one's."""
        own = self.filter
        own.begin(dict(memory.filter.models))
        self._memory = SubsetMemory(own.memory, (), 0.0, 0.0, False, 0.0, 0.0, math.inf)
        found = misfit(dataclasses.replace(memory, without=()), self._memory, "memory.subset")
        found = found or memory.filter.problem(own.memory)
        found = found or own.monitor.problem(memory.filter.monitor, own.memory.monitor, own.channels)
        if not found and not (memory.without and set(memory.without) <= own.channels.keys()):
            found = "memory.subset.without names no sensors of this vehicle"
        if not found and not (
            math.isfinite(memory.against_run + memory.against + memory.began_s)
            and memory.most_m_s > 0.0
            and memory.fixed_s > -math.inf
        ):
            found = "memory.subset has a number that is none"
        return found

    def begin(self, given: FilterMemory, without: Sequence[str]) -> None:
        """Go on from what the run remembered when it was given up, without these sensors.

        Parameters
        ----------
        given : FilterMemory
            Is this filter's own from now on.
        without : sequence of str
            What their readings did to the velocity before they were refused is not known any more, up to their gate.
        """
        self.filter.restore(given)
        suspects = [self._main.channels[name] for name in without]
        speed, stated = min(c.faults.refused_speed for c in suspects), self._vehicle.drive.max_speed_m_s
        self._memory = SubsetMemory(
            given, tuple(without), 0.0, 0.0, False, float(most_speed(speed, stated)), given.time_s, math.inf
        )
        passed = max(float(c.limits[1]) * (float(c.group.r.max()) + max(c.slow)) for c in suspects)
        self.filter.apply(Inflate(range(3, 6), range(3, 6), passed), _ignore)
        self.filter.monitor.begin_again(self.filter, given.monitor)  # their innovations told of faults, too
        self.show()

    def expect(self, samples: Array) -> None:
        """The run is about to take samples; the array is left as it is."""
        self._rows = None if self._memory is None else samples.copy()

    def propagate(self) -> None:
        """Take what was expected, as the run has."""
        rows, self._rows = self._rows, None
        if rows is not None:
            self.filter.propagate(rows, _ignore)
            self.show()

    def adopt(self, change: Change) -> None:
        """The run has put another error model in force, perhaps in the middle of a block of samples."""
        if self._memory is None or change.sensor in self._memory.without:
            return
        rows, run = self._rows, self._main.memory
        if rows is not None:
            taken = int(np.count_nonzero(rows[:, 0] + run.intake.offset_s <= run.time_s))
            self.filter.propagate(rows[:taken], _ignore)
            self._rows = rows[taken:]
        self.filter.adopt(change, _ignore)

    def correct(self, reading: Measurement, correction: Correction) -> bool | None:
        """Take a reading that the run has just taken.

        Parameters
        ----------
        reading : Measurement
        correction : Correction
            What became of it in the run.

        Returns
        -------
        bool or None
            Whether this one is right, and not the run; None while that is not known.
        """
        memory, own = self._required, self.filter
        own.propagate_to(reading.name, reading.time_s, _ignore)
        if reading.name in memory.without:
            memory.is_open |= correction.outcome.status == "used"
        else:
            answer = own.correct(reading, _ignore)
            own.handle_pending(_ignore)
            heard = correction.outcome.dof and answer.outcome.dof and not (reading.same or reading.frozen)
            if heard and memory.is_open:
                here, there = (filter.channels[reading.name] for filter in (own, self._main))
                memory.against_run = _against(memory.against_run, there.note)
                memory.against = _against(memory.against, here.note)
                if here.sensor.observes.corrects == "position":
                    memory.fixed_s = min(memory.fixed_s, reading.time_s)
        self.show()
        if self._memory is None or not memory.is_open:
            return None
        odds, told = self._odds(memory), own.time_s - memory.fixed_s > settings.WINDOW_S
        return True if odds > BELIEVED else False if told or odds < -BELIEVED else None

    def _odds(self, memory: SubsetMemory) -> float:
        """By how much likelier than the run it is now: by what has been read, and by how fast each of the two is, as
        far as it knows, for a vehicle is believed to go no faster than it may [nat].
        """
        usual = 0.5 * memory.most_m_s**2 / BELIEVED
        own, run = (
            0.5 * float(f.nav[3:6] @ f.nav[3:6]) / (usual + float(f.P[[3, 4], [3, 4]].mean()))
            for f in (self.filter, self._main)
        )
        return memory.against_run - memory.against + run - own

    def end(self) -> SubsetMemory:
        """There is none any more; what it remembered."""
        self.filter.apply(Fold(), _ignore)
        memory, self._memory = self._required, None
        memory.filter = self.filter.memory
        self.show()
        return memory

    def show(self) -> None:
        """Let the run say how far from it the truth may be; one that is nowhere any more says nothing."""
        found = self._separation(self._memory) if self._memory is not None and self._memory.is_open else None
        if found is not None and not np.isfinite(found.moment).all():
            found = self._memory = None
        self._main.show_beside(found)

    def _separation(self, memory: SubsetMemory) -> Beside:
        other = self.filter.state
        assert other.covariance is not None
        share = 1.0 / (1.0 + math.exp(min(max(-self._odds(memory), -BELIEVED), BELIEVED)))
        off, P = other.minus(self._main.state), other.covariance
        moment = np.outer(off, off) + P
        if share < settings.RISK:
            return Beside(share, moment, 0.0, 0.0)
        north, east, heading = np.sqrt(P.diagonal()[[0, 1, 8]]).tolist()
        radius_m = math.hypot(*off[:2].tolist()) + IN_PLANE * math.hypot(north, east)
        return Beside(share, moment, radius_m, abs(float(off[8])) + IN_LINE * heading)

    @property
    def _required(self) -> SubsetMemory:
        assert self._memory is not None
        return self._memory


def _against(before: float, note: Array) -> float:
    """What speaks against a filter with another reading, of which `note` has residual and variance behind its head: no
    more than its latest readings say together (Page, 1954), and each no more than half of what decides.
    """
    residual, variance = np.split(note[3:], 2)
    square = residual**2 / variance
    said = 0.5 * (square * (1.0 - 1.0 / DOUBLED) - math.log(DOUBLED))[np.isfinite(square)]
    return max(0.0, before + float(np.minimum(said, 0.5 * BELIEVED).sum()))


def _ignore(event: Event) -> None:
    """Nobody listens to it."""

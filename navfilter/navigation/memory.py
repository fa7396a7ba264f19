"""Everything of a navigator that changes in order, and the classes that it consists of."""

import dataclasses
from dataclasses import dataclass

from navfilter.faults.lane_selection import LaneChoiceMemory
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.events import Measurement
from navfilter.filter.filter_memory import FilterMemory
from navfilter.foundation.state_values import misfit
from navfilter.learning.schedule import LearningMemory
from navfilter.navigation.alternative import AlternativeMemory
from navfilter.navigation.subset_filter import SubsetMemory


@dataclass
class NavigatorMemory:
    """Everything that changes in order: what late readings and snapshots go back to."""

    filter: FilterMemory
    learning: LearningMemory
    alternative: AlternativeMemory | None = None
    subset: SubsetMemory | None = None

    def whole(self) -> "NavigatorMemory":
        """The same with as many inputs of the beginning as belong to it, for they are shared and go on."""
        beginning = self.learning.beginning
        kept = None if beginning is None else beginning.first(*self.learning.kept)
        return dataclasses.replace(self, learning=dataclasses.replace(self.learning, beginning=kept))


@dataclass
class LaneMemory:
    """What changes in one lane.

    Attributes
    ----------
    run : NavigatorMemory
    watches : dict of str to Watch
    waiting : list of Measurement
    """

    run: NavigatorMemory
    watches: dict[str, SensorMonitor]
    waiting: list[Measurement]


@dataclass
class LanesMemory:
    """Everything that changes in order.

    Attributes
    ----------
    lanes : dict of str to LaneMemory
    choice : LaneChoiceMemory
    ticks, levels : int
        Samples and readings of the lane without an inertial unit so far.
    ahead_s : float
        Since when readings come long after everything else [s].
    """

    lanes: dict[str, LaneMemory]
    choice: LaneChoiceMemory
    ticks: int
    levels: int
    ahead_s: float


def check_watches(saved: dict[str, SensorMonitor], own: dict[str, SensorMonitor]) -> None:
    """Raise ValueError for watches from outside that hold anything but what these do, or are of others."""
    if set(saved) != set(own):
        raise ValueError(f"watches must be kept of {', '.join(own)}, found {', '.join(saved)}")
    for name, watch in saved.items():
        problem = misfit(watch, own[name], f"watches[{name!r}]")
        if not problem and not all(type(n) is int for n in dict(watch.others).values()):
            problem = f"watches[{name!r}].others must be counts, found {watch.others!r}"
        if problem:
            raise ValueError(problem)

"""What the parts of a navigator see of it: the runner, and the early re-run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import ArrayLike

from navfilter.faults.clocks.imu_clock import ImuClockMonitor
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.events import Event, Measurement, Outcome
from navfilter.filter.filter import Filter
from navfilter.foundation.arrays import Array
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.alternative import Alternative
from navfilter.navigation.history import History
from navfilter.navigation.memory import NavigatorMemory
from navfilter.navigation.waiting import MeasurementQueue


class Run(Protocol):
    """A run over a vehicle's inputs: a `Navigator`.

    Attributes
    ----------
    filter : Filter
    learning : LearningSchedule
    history : History or None
        None: nothing may come late.
    clock : ImuClockMonitor
    sensor_monitors : dict of str to SensorMonitor
    queue : MeasurementQueue
    early_rerun
        What runs the first minutes again (`navfilter.navigation.early_rerun`).
    fast_paths
        By sensor, what takes its ordinary readings live.
    alternative : Alternative
        The second filter beside it while its unit is in doubt.
    change_count : int
        Counts all that changes otherwise than by ordinary inputs.
    memory : NavigatorMemory
        All that changes in order; setting one goes back (or on) to it.
    """

    vehicle: Vehicle
    start: Start
    filter: Filter
    learning: LearningSchedule
    history: History | None
    clock: ImuClockMonitor
    sensor_monitors: dict[str, SensorMonitor]
    queue: MeasurementQueue
    early_rerun: Any
    alternative: Alternative
    change_count: int
    memory: NavigatorMemory

    @property
    def fast_paths(self) -> Mapping[str, Any]:
        """By sensor."""

    @property
    def time_s(self) -> float:
        """Mission time of the state [s]."""

    @property
    def offset_s(self) -> float:
        """By how much stamps are moved since the clock was set [s]."""

    def step_samples(self, samples: Array) -> None:
        """Take samples of the drive: rows of time and six values."""

    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Take a measurement that has arrived."""

    def correct_now(self, reading: Measurement) -> Outcome:
        """Take a measurement now."""

    def repeat_input(self, item: Array | Measurement) -> None:
        """Take an input as another run has."""

    def process(self, item: Array | Measurement) -> Outcome | None:
        """Give samples or a measurement, in order, to filter and learning."""

    def finish(self) -> None:
        """Take the measurements that still wait: no more samples come."""

    def on_event(self, event: Event) -> None:
        """Show learning what the filter does."""

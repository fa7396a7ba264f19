"""Everything of a navigator that changes in order, and the classes that it consists of."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from navfilter.faults.alternative_path import AlternativePath
from navfilter.faults.clocks.burst_stamps import BurstsMemory
from navfilter.faults.clocks.imu_clock import DriveClockMemory, ReceivedMeasurement
from navfilter.faults.clocks.sensor_clock import Ahead
from navfilter.faults.dead_reckoning_compass import DeadReckoningComparison
from navfilter.faults.heading_fault import TrackRotationFit
from navfilter.faults.imu.gyro_scale import GyroScaleTest
from navfilter.faults.lane_selection import LaneChoiceMemory
from navfilter.faults.memory import MonitorMemory, SensorFaults
from navfilter.faults.noise_scale import NoiseScale
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.faults.velocity_evidence import VelocityEvidence
from navfilter.faults.velocity_fault import VelocityFault
from navfilter.filter.events import Measurement
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.imu_intake import ImuIntakeMemory
from navfilter.filter.model_change import Change
from navfilter.foundation.state_values import misfit
from navfilter.learning.input_buffer import InputBuffer, Rows
from navfilter.learning.learner_memory import LearnerMemory
from navfilter.learning.learning_memory import LearningMemory, RerunRequest
from navfilter.learning.series_memory import Hop, OpenLoopMemory
from navfilter.learning.slow_posterior import Line
from navfilter.learning.static_recorder import RestMemory
from navfilter.models.spectrum import Spectrum

__all__ = ["MEMORY", "LaneMemory", "LanesMemory", "NavigatorMemory", "check_watches"]


@dataclass
class NavigatorMemory:
    """Everything that changes in order: what late readings and snapshots go back to."""

    filter: FilterMemory
    learning: LearningMemory

    def whole(self) -> NavigatorMemory:
        """The same with as many inputs of the beginning as belong to it, for they are shared and go on."""
        beginning = self.learning.beginning
        kept = None if beginning is None else beginning.first(*self.learning.kept)
        return NavigatorMemory(self.filter, dataclasses.replace(self.learning, beginning=kept))


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


#: Classes that a snapshot is made of, beside error models.
MEMORY = (
    *(
        NavigatorMemory,
        FilterMemory,
        MonitorMemory,
        SensorFaults,
        RejectionRun,
        AlternativePath,
        TrackRotationFit,
        DeadReckoningComparison,
        VelocityEvidence,
        VelocityFault,
        NoiseScale,
        GyroScaleTest,
    ),
    *(ImuIntakeMemory, DriveClockMemory, BurstsMemory, ReceivedMeasurement, Ahead),
    *(
        LearningMemory,
        InputBuffer,
        Rows,
        RerunRequest,
        Change,
        OpenLoopMemory,
        Hop,
        RestMemory,
        LearnerMemory,
        Line,
        Spectrum,
    ),
)


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

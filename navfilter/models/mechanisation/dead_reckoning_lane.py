"""What drives where nothing is felt: the vehicle goes on as it did, and its sensors say how it did not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.error_models import ErrorModel, White
from navfilter.models.mechanisation.imu import Imu
from navfilter.models.sensors.traits import Doubt


@dataclass(frozen=True, kw_only=True)
class DeadReckoningLane(Imu):
    """An inertial unit that reads nothing: the dead-reckoning lane of a vehicle.

    All its axes are left out from the start, as the watch over the drive leaves out one that is dead
    (`navfilter.faults.imu.monitor`): attitude and velocity are held, with the noise of what the vehicle may do unseen
    (`gap_rate_sd`, `gap_force_sd`). Heading then comes from the compass, velocity from the DVL, each with the error
    model that its sensor has. Its samples are zeros on a clock of their own.
    """

    rate_hz: float = 10.0
    gyro: ErrorModel | tuple[ErrorModel, ...] = White(density=0.0)
    accel: ErrorModel | tuple[ErrorModel, ...] = White(density=0.0)

    feels: ClassVar[bool] = False

    def limits(self) -> Array:
        """Every sample is at the end of a range that has no length."""
        return np.zeros(6)

    @property
    def words(self) -> str:
        """What drives."""
        return "dead reckoning by compass and velocity"

    def doubts(self) -> Iterator[Doubt]:
        """Nobody describes it."""
        yield from ()

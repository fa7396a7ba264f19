"""Wheels: how fast they roll, and that they roll neither sideways nor off the ground."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.error_models import Errors, White
from navfilter.models.sensors.traits import Columns, Doubt, Example
from navfilter.models.sensors.velocity import BodyVelocity
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

SPEED = Columns("wheel_speed", ("wheel_speed_m_s",), ("speed",))


@dataclass(frozen=True, kw_only=True)
class Odometer(BodyVelocity):
    """Forward speed [m/s] of wheels or tracks, with non-holonomic constraints: no speed sideways, none upwards.

    Parameters
    ----------
    constrained : bool
        The vehicle cannot move sideways or off the ground: both speeds are read as zero beside every forward one.

    Notes
    -----
    As `BodyVelocity`, with zeros for the second and third axis. Their errors say how much the vehicle slips sideways
    and sways on its springs. The lever arm leads to the axle that does not steer: only there nothing moves sideways in
    a turn. A component that contradicts the others (a wheel that spins, a side slip) is left out alone, for five
    seconds: after that the reading is refused whole, and speaks against the inertial unit as a DVL does.
    """

    error: Errors = (White(sd=0.05), White(sd=0.1), White(sd=0.1))
    zero_is_invalid: bool = False
    max_speed_m_s: float = 100.0
    constrained: bool = True

    reads: ClassVar[int] = 1
    single_gates: ClassVar[bool] = True
    single_s: ClassVar[float] = 5.0  # wheels spin, and slip in a turn, for no longer
    hidden: ClassVar[bool] = True  # they drive what their scale is told by
    gives: ClassVar[str] = ""
    jumps: ClassVar[int | None] = 0  # what holds it to its way does not
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((SPEED,),)
    template: ClassVar[Example | None] = Example(
        "odometer",
        "Wheels or tracks: forward speed, and no speed sideways or upwards. The lever arm leads to the axle that does "
        "not steer.",
        10,
        (
            'error = {x = {model = "white", sd = 0.05}, y = {model = "white", sd = 0.1}, '
            'z = {model = "white", sd = 0.1}}',
        ),
        (-1.0, 0.0, 0.4),
        live=False,
    )

    @property
    def ground(self) -> int:
        """With constraints it tells all of the velocity."""
        return 3 if self.constrained else 0

    def read(self, value: Array) -> Array | None:
        """The speed, and zeros (NaN without constraints)."""
        if not abs(value[0]) <= self.max_speed_m_s or (self.zero_is_invalid and value[0] == 0.0):
            return None
        other = 0.0 if self.constrained else math.nan
        return np.array([value[0], other, other])

    @property
    def words(self) -> str:
        """What it measures."""
        return "forward speed of wheels" + (", and none sideways or upwards" if self.constrained else "")

    def doubts(self) -> Iterator[Doubt]:
        """Also of constraints that are taken as exact."""
        yield from super().doubts()
        for axis, model in zip("yz", self.models[1:], strict=True):
            block = model.block(1.0 / self.rate_hz)
            if self.constrained and block.variance < 0.005**2:
                text = "less than 5 mm/s: every vehicle slips and sways more than that."
                yield Doubt(f"error.{axis}", text, "Usual: 0.05 to 0.2 m/s.")

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """The forward component; slip sideways there is none but what the motion has."""
        value, _ = super().simulated(here, truth)
        return value[:, :1], SPEED.names

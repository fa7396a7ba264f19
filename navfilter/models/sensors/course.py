"""Velocity over ground by a satellite receiver: speed and course, or north, east, down."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import measurement
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector
from navfilter.models.sensors.traits import Columns, Doubt, Example, Plausible
from navfilter.models.sensors.velocity import USUAL
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

COURSE = Columns("course", ("ground_speed_m_s", "course_rad"), ("speed", "angle"), circular=("course_rad",))
VELOCITY_N = Columns("velocity_n", ("v_north_m_s", "v_east_m_s", "v_down_m_s"), ("speed",) * 3)


@dataclass(frozen=True, kw_only=True)
class Course(Sensor):
    """Speed and course over ground [m/s], [rad] of a satellite receiver, or its velocity north, east, down [m/s].

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the antenna, in b [m].
    velocity : bool
        The reading is a velocity north, east, down (NaN down: none) instead of speed and course.
    max_speed_m_s : float
        A speed above it is no reading.

    Notes
    -----
    Speed and course are taken as one velocity, so that a course that means nothing at low speed does no harm. Errors
    are those of the velocity north, east and down [m/s]. The course is where the vehicle goes, not where it points:
    in a current, or a wind, the two differ.
    """

    error: Errors = White(sd=0.1)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    velocity: bool = False
    max_speed_m_s: float = 100.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.05, tau_s=5.0) + White(sd=0.05)
    unit: ClassVar[str] = "m_s"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 2
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.ground_velocity)
    observes: ClassVar[Observable] = Observable.VELOCITY_NED
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((COURSE,), (VELOCITY_N,))
    plausible: ClassVar[Plausible | None] = USUAL._replace(most_sd=3.0)
    template: ClassVar[Example | None] = Example(
        "course",
        "Speed and course over ground of a satellite receiver.",
        1,
        ('error = {model = "white", sd = 0.1}',),
        (-0.4, 0.0, -0.2),
        live=False,
    )

    def constants(self, start: Start) -> Array:
        """The lever arm."""
        return np.asarray(self.lever_arm_b_m, dtype=float)

    def read(self, value: Array) -> Array | None:
        """Velocity north, east, down; None for a speed that cannot be, or a course without one."""
        if self.velocity:
            z = np.array([*value[:2], value[2] if len(value) > 2 else math.nan])
            return z if np.hypot(z[0], z[1]) <= self.max_speed_m_s else None
        speed, course = value[0], value[1]
        if speed == 0.0:
            course = 0.0  # receivers give none then
        if not (0.0 <= speed <= self.max_speed_m_s and math.isfinite(course)):
            return None
        return np.array([speed * math.cos(course), speed * math.sin(course), math.nan])

    @property
    def needs_rate(self) -> bool:
        """With a lever arm."""
        return any(self.lever_arm_b_m)

    def lever_arm_covariance(self, rate_variance: Array) -> Array:
        """In the axes of the body, whose heading nobody knows here: as large in all directions as in the worst."""
        by_rate = np.cross(np.eye(3), np.asarray(self.lever_arm_b_m, dtype=float)).T
        return np.asarray(np.eye(3) * np.linalg.eigvalsh(by_rate @ np.diag(rate_variance) @ by_rate.T)[-1])

    @property
    def words(self) -> str:
        """What it measures."""
        return "velocity over ground, north, east, down" if self.velocity else "speed and course over ground"

    def stream_columns(self) -> tuple[str, ...]:
        """Speed and course, or a velocity."""
        return VELOCITY_N.names if self.velocity else COURSE.names

    def doubts(self) -> Iterator[Doubt]:
        """Of errors that are too small: receivers smooth."""
        block = self.models[0].block(1.0 / self.rate_hz)
        if block.r > 0.0 and not block.size and block.r < 0.01**2:
            text = f"white noise of {100.0 * math.sqrt(block.r):.2g} cm/s: few receivers measure velocity so well."
            yield Doubt("error", text, "Many smooth it over seconds: a gauss-markov part, or a larger sd.")

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Of the antenna; course from 0 to 360 degrees."""
        swing = np.cross(here.rate_eb_b, np.asarray(self.lever_arm_b_m, dtype=np.float64))
        v = here.velocity_n + np.einsum("nij,nj->ni", here.C_nb, swing) + truth.error
        if self.velocity:
            return v, VELOCITY_N.names
        course = np.mod(np.arctan2(v[:, 1], v[:, 0]), 2.0 * np.pi)
        return np.column_stack([np.hypot(v[:, 0], v[:, 1]), course]), COURSE.names

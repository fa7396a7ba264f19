"""Attitude by an instrument that computes it itself (AHRS)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import measurement
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.heading import USUAL, Heading, with_declination_sd
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector, checked_vector
from navfilter.models.sensors.traits import Columns, Doubt, Example, Plausible, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

ATTITUDE = Columns("attitude", ("roll_rad", "pitch_rad", "yaw_rad"), ("angle",) * 3, circular=("roll_rad", "yaw_rad"))


@dataclass(frozen=True, kw_only=True)
class Attitude(Sensor):
    """Roll, pitch and yaw [rad] of an AHRS or a gyrocompass, as readings that correct.

    Parameters
    ----------
    mounting_rad : (3,) float
        Roll, pitch, yaw of the instrument's axes in b [rad]: ``v_b = C(mounting) v_instrument``.
    misalignment_sd_rad : float
        Standard deviation of an unknown constant error of that mounting about each axis [rad]: offsets of roll, pitch
        and yaw; 0 leaves the states out.
    magnetic : bool
        The yaw counts from magnetic north.
    declination_rad : float, optional
        East positive [rad]. Default: World Magnetic Model at the start's place and date.
    declination_sd_rad : float, optional
        Standard deviation of the declination [rad]: it is part of the misalignment. Default as of a `Heading`.

    Notes
    -----
    Errors are those of roll, pitch and yaw. What an AHRS errs by is slow, because it filters itself: a Gauss-Markov
    model, not white noise. Near a pitch of 90 degrees there is no reading. A NaN is a missing angle: of an instrument
    without a compass the yaw.
    """

    error: Errors = (White(sd=0.005), White(sd=0.005), White(sd=0.02))
    mounting_rad: Vector = (0.0, 0.0, 0.0)
    misalignment_sd_rad: float = 0.0
    magnetic: bool = False
    declination_rad: float | None = None
    declination_sd_rad: float | None = None

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.01, tau_s=30.0) + White(sd=0.002)
    unit: ClassVar[str] = "rad"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("roll", "pitch", "yaw")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.attitude)
    confirms_state: ClassVar[bool] = False
    gives: ClassVar[str] = "attitude"
    observes: ClassVar[Observable] = Observable.ATTITUDE
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((ATTITUDE,),)
    plausible: ClassVar[Plausible | None] = USUAL
    template: ClassVar[Example | None] = Example(
        "ahrs",
        "Attitude of an AHRS or gyrocompass beside the inertial unit; its errors are slow, because it filters itself.",
        5,
        (
            'error = {roll = {model = "gauss-markov", sd_deg = 0.5, tau_s = 30}, pitch = {model = "gauss-markov", '
            'sd_deg = 0.5, tau_s = 30}, yaw = {model = "gauss-markov", sd_deg = 1.0, tau_s = 60}}',
        ),
        live=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector("Attitude.mounting_rad", self.mounting_rad)
        check_numbers(self, "misalignment_sd_rad", "declination_sd_rad")

    def at(self, start: Start) -> Attitude:
        """With what its declination errs by at this place."""
        return with_declination_sd(self, self.magnetic, start)

    def parameters(self) -> tuple[Parameter, ...]:
        """Three misalignments, or none."""
        angles = self._misalignment()
        return angles if any(angle.sd for angle in angles) else ()

    def _misalignment(self) -> tuple[Parameter, ...]:
        """About the instrument's axes; the declination is a turn about what is down in them."""
        down = np.abs(matrix_from_euler(*self.mounting_rad)[2]) * (self.declination_sd_rad or 0.0)
        sds = np.hypot(self.misalignment_sd_rad, down).tolist()
        return tuple(Parameter(f"misalignment_{axis}", sd, "rad") for axis, sd in zip("xyz", sds, strict=True))

    def constants(self, start: Start) -> Array:
        """Declination, then the mounting matrix row by row."""
        compass = Heading(magnetic=self.magnetic, declination_rad=self.declination_rad)
        return np.concatenate([[compass.declination(start)], matrix_from_euler(*self.mounting_rad).ravel()])

    def headings(self, readings: Array, level: Array, start: Start) -> tuple[Array, float, float]:
        """True headings by readings (n, 3), the variance of their mean [rad], [rad^2], and no slope: they know what is
        level.
        """
        forward = matrix_from_euler(*self.mounting_rad)[0]  # along which the vehicle's own goes in the instrument
        ahead = np.array([matrix_from_euler(*angles) @ forward for angles in readings[:, :3].tolist()])
        turned = self.misalignment_sd_rad**2 + (self.at(start).declination_sd_rad or 0.0) ** 2
        variance = turned + self.mean_variance(2, len(readings))
        return np.arctan2(ahead[:, 1], ahead[:, 0]) + self.constants(start)[0], variance, 0.0

    def doubts(self) -> Iterator[Doubt]:
        """Of mounting, misalignment and declination."""
        if max(map(abs, self.mounting_rad)) > 2.0 * math.pi:
            yield angle_doubt("mounting_rad", max(self.mounting_rad, key=abs))
        if self.misalignment_sd_rad > math.radians(20.0):
            yield angle_doubt("misalignment_sd_rad", self.misalignment_sd_rad)
        if self.declination_rad is not None and abs(self.declination_rad) > math.pi:
            yield angle_doubt("declination_rad", self.declination_rad)

    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """The rotation vector of the misalignment."""
        return {"misalignment": self._misalignment()}

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Angles of the instrument's axes, which are turned against what is believed."""
        from scipy.spatial.transform import Rotation  # only a simulation needs it

        declination = truth.declination(self.declination_rad) if self.magnetic else 0.0
        mounting = Rotation.from_euler("ZYX", self.mounting_rad[::-1])
        axes = Rotation.from_matrix(here.C_nb) * mounting * Rotation.from_rotvec(truth.drawn["misalignment"]).inv()
        angles = axes.as_euler("ZYX")[:, ::-1] + truth.error
        angles[:, 2] -= declination
        angles[:, [0, 2]] = np.pi - np.mod(np.pi - angles[:, [0, 2]], 2.0 * np.pi)
        return angles, ATTITUDE.names

    @classmethod
    def examples(cls) -> tuple[Attitude, ...]:
        """One with misalignment."""
        return (cls(misalignment_sd_rad=0.01),)

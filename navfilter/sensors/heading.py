"""Heading by a compass or a magnetometer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel, GaussMarkov, White
from navfilter.kernels import listen, measurement
from navfilter.learning.drift import Drift
from navfilter.sensors.sensor import Errors, Sensor, Vector, checked_vector
from navfilter.start import Start

if TYPE_CHECKING:
    from navfilter.mechanisation import Mechanisation

__all__ = ["Heading"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Heading(Sensor):
    """Compass: its heading output [rad], or a three-axis magnetometer levelled with the filter's own attitude.

    Parameters
    ----------
    magnetometer : bool
        The reading is a field vector in b (any unit) instead of a heading.
    magnetic : bool
        A heading reading counts from magnetic north; a magnetometer always does.
    declination_rad : float, optional
        East positive [rad]. Default: World Magnetic Model at the start's place and date.
    bias_sd_rad, deviation_sd_rad, temperature_sd_rad_per_k : float, (2,) float, float
        Standard deviations of constant states: bias, one- and two-cycle deviation (each a sine and a cosine of the heading), and the drift
        with temperature (thesis eq 4.1). All zero: no such states.
    reference_temperature_c : float
        Temperature at which the temperature term vanishes [deg C].
    hard_iron, soft_iron : (3,) and (9,) float
        Calibration of the magnetometer: ``field = soft_iron @ (reading - hard_iron)``, `soft_iron` row by row.

    Notes
    -----
    A reading may carry a temperature [deg C] as its last element.
    """

    error: Errors = White(sd=0.02)
    magnetometer: bool = False
    magnetic: bool = False
    declination_rad: float | None = None
    bias_sd_rad: float = 0.0
    deviation_sd_rad: tuple[float, float] = (0.0, 0.0)
    temperature_sd_rad_per_k: float = 0.0
    reference_temperature_c: float = 20.0
    hard_iron: Vector = (0.0, 0.0, 0.0)
    soft_iron: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.015, tau_s=30.0) + White(sd=0.005)
    unit: ClassVar[str] = "rad"
    open_loop: ClassVar[int] = listen.HEADING

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector("Heading.hard_iron", self.hard_iron)
        checked_vector("Heading.soft_iron", self.soft_iron, 9)
        checked_vector("Heading.deviation_sd_rad", self.deviation_sd_rad, 2)

    @property
    def kernel(self) -> Callable[..., None]:  # type: ignore[override]
        """The measurement kernel."""
        return measurement.magnetometer if self.magnetometer else measurement.heading

    @property
    def reads(self) -> int:  # type: ignore[override]
        """Number of elements of a reading without the temperature."""
        return 3 if self.magnetometer else 1

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """Bias, deviation and temperature states, or none."""
        one, two = self.deviation_sd_rad
        if not any((self.bias_sd_rad, one, two, self.temperature_sd_rad_per_k)):
            return ()
        return (
            ("bias", self.bias_sd_rad),
            ("one_cycle_sin", one),
            ("one_cycle_cos", one),
            ("two_cycle_sin", two),
            ("two_cycle_cos", two),
            ("temperature", self.temperature_sd_rad_per_k),
        )

    def declination(self, start: Start) -> float:
        """Magnetic declination in force [rad]; 0 for a compass that reads true heading."""
        if not (self.magnetic or self.magnetometer):
            return 0.0
        if self.declination_rad is not None:
            return self.declination_rad
        from navfilter.magnetic import declination

        return declination(start.latitude_deg, start.longitude_deg, start.height_m, start.date)

    def constants(self, start: Start) -> Array:
        """Declination and reference temperature."""
        return np.array([self.declination(start), self.reference_temperature_c])

    def read(self, value: Array) -> Array | None:
        """Apply the iron calibration; append NaN where there is no temperature."""
        n = self.reads
        if not all(map(math.isfinite, value[:n].tolist())):
            return None
        z = np.array([*value[: n + 1].tolist(), math.nan][: n + 1])
        if self.magnetometer:
            z[:3] = np.reshape(self.soft_iron, (3, 3)) @ (z[:3] - np.asarray(self.hard_iron))
            return z if z[:3].any() else None
        return z

    def drift(self, drive: Mechanisation, axis: int, walk: float) -> Drift:
        """As a heading."""
        return drive.heading_drift(walk, 1.0 / self.rate_hz)

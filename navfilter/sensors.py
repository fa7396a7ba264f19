"""Sensors that correct: a frozen value each, saying what it reads (equation, Jacobian) and how it errs.

A reading is a vector of float64 in SI units and radians; NaN is a missing component. Every reading is
``h(state, parameters) + coloured error + white error``; the kernels of `navfilter.kernels.measurement` hold h and its Jacobian.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.error_models import ErrorModel, GaussMarkov, White, per_axis
from navfilter.kernels import measurement
from navfilter.learning.learned import learning_part, resolve_prior
from navfilter.start import Start
from navfilter.state import matrix_from_euler

__all__ = ["BodyVelocity", "Depth", "Heading", "Position", "Sensor", "WaterVelocity", "ZeroVelocity"]

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Errors = ErrorModel | tuple[ErrorModel, ...]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """What all correcting sensors share.

    Parameters
    ----------
    rate_hz : float
        Nominal rate [Hz]; coloured errors tick at it.
    error : ErrorModel or tuple of ErrorModel
        How the sensor errs: one model for all axes, or one per axis.
    gate_probability : float
        A reading is rejected when its normalised innovation squared (NIS) exceeds this quantile of chi-square.
    gate_timeout_s : float
        After rejecting every reading for so long the gate doubles (and again), so that a good sensor is never locked out.
    """

    rate_hz: float = 1.0
    error: Errors = White(sd=1.0)
    gate_probability: float = 0.9999
    gate_timeout_s: float = 20.0

    prior: ClassVar[ErrorModel] = White(sd=1.0)
    unit: ClassVar[str] = "m"
    axes: ClassVar[int] = 1
    reads: ClassVar[int] = 1
    axis_names: ClassVar[tuple[str, ...]] = ("",)
    kernel: ClassVar[Callable[..., None]]

    def __post_init__(self) -> None:
        name = type(self).__name__
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ValueError(f"{name}.rate_hz must be a finite number > 0, found {self.rate_hz!r}.")
        if not 0.5 <= self.gate_probability < 1.0:
            raise ValueError(f"{name}.gate_probability must lie in [0.5, 1), found {self.gate_probability!r}. Typical: 0.999.")
        if not self.gate_timeout_s > 0:
            raise ValueError(f"{name}.gate_timeout_s must be > 0, found {self.gate_timeout_s!r}.")
        _ = self.models

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """The error model of each axis; a `LearnedArma` that brings no prior gets that of the sensor's kind."""
        return resolve_prior(per_axis(self.error, self.axes, f"{type(self).__name__}.error"), self.prior)

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """States beside the error model: name and standard deviation at the start; constant, but for those of `wandering`."""
        return ()

    def wandering(self) -> dict[str, ErrorModel]:
        """Those of the parameters that are not constant: how they wander, by name (a model of one state)."""
        return {}

    def constants(self, start: Start) -> Array:
        """What the kernel needs to know beside the state, shape depends on the sensor."""
        return np.zeros(1)

    def read(self, value: Array) -> Array | None:
        """Turn what arrives into what the kernel takes; None when it is not a reading (lost lock, out of range)."""
        return value if np.isfinite(value).any() else None


def _vector(owner: str, value: ArrayLike, size: int = 3) -> tuple[float, ...]:
    v = np.asarray(value, dtype=float).ravel()
    if v.shape != (size,) or not np.isfinite(v).all():
        raise ValueError(f"{owner} must be {size} finite numbers, found {value!r}.")
    return tuple(float(c) for c in v)


@dataclass(frozen=True, kw_only=True)
class BodyVelocity(Sensor):
    """Velocity over ground in instrument axes [m/s]: a DVL in bottom track, or wheels (constant zeros for the axes that cannot slip).

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point (the inertial unit) to the instrument, in b [m].
    mounting_rad : (3,) float
        Roll, pitch, yaw of the instrument's axes in b [rad]: ``v_b = C(mounting) v_instrument``.
    scale_sd : float
        Standard deviation of an unknown constant scale error; 0 leaves the scale and misalignment states out unless
        `misalignment_sd_rad` is set.
    misalignment_sd_rad : float
        Standard deviation of the unknown constant mounting error about each axis [rad].
    zero_is_invalid : bool
        Exactly zero on all axes is what instruments print when they have lost the bottom; set False for wheels.
    max_speed_m_s : float
        A component above it is a sentinel or an error, not a reading.

    Notes
    -----
    ``reading = (1 + s)(y + m x y) + error`` with ``y`` the velocity of the instrument in its own axes, lever arm included. Scale and
    misalignment can only be told from the vehicle's motion by position fixes.
    """

    error: Errors = White(sd=0.01)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    mounting_rad: Vector = (0.0, 0.0, 0.0)
    scale_sd: float = 0.0
    misalignment_sd_rad: float = 0.0
    zero_is_invalid: bool = True
    max_speed_m_s: float = 20.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.01, tau_s=5.0) + White(sd=0.01)
    unit: ClassVar[str] = "m_s"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.body_velocity)

    def __post_init__(self) -> None:
        super().__post_init__()
        _vector("BodyVelocity.lever_arm_b_m", self.lever_arm_b_m)
        _vector("BodyVelocity.mounting_rad", self.mounting_rad)

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """Scale and three misalignments, or none."""
        if self.scale_sd == 0 and self.misalignment_sd_rad == 0:
            return ()
        angle = self.misalignment_sd_rad
        return (("scale", self.scale_sd), ("misalignment_x", angle), ("misalignment_y", angle), ("misalignment_z", angle))

    def constants(self, start: Start) -> Array:
        """Lever arm, then the mounting matrix row by row."""
        return np.concatenate([np.asarray(self.lever_arm_b_m, dtype=float), matrix_from_euler(*self.mounting_rad).ravel()])

    def read(self, value: Array) -> Array | None:
        """Mask components that cannot be velocities; None when none is left."""
        top, moving, valid, clean = self.max_speed_m_s, False, False, True
        components = value[:3].tolist()
        for c in components:
            if -top <= c <= top:
                valid, moving = True, moving or c != 0.0
            else:
                clean = False
        if not valid or (self.zero_is_invalid and not moving):
            return None
        return value[:3] if clean else np.array([c if -top <= c <= top else math.nan for c in components])


@dataclass(frozen=True, kw_only=True)
class WaterVelocity(BodyVelocity):
    """Velocity through the water in instrument axes [m/s]: a DVL in water track, or an electromagnetic log.

    The horizontal current is two states, north and east, so that what is known of it carries the position while there is nothing else.

    Parameters
    ----------
    current_sd_m_s : float
        Standard deviation of each component of the current [m/s].
    current_tau_s : float
        Its correlation time [s]: in dt << tau the current changes by ``sd * sqrt(2 dt / tau)``.

    Notes
    -----
    As `BodyVelocity`, with ``y`` the velocity relative to the water: ``C_nb' (v_n - c_n)``. The current wanders as a first-order
    Gauss-Markov process on the clock of this sensor; water that rises or sinks is taken for error. What this sensor itself errs by at low
    frequencies cannot be told from the current, so that its error is not learnt.
    """

    error: Errors = White(sd=0.02)
    current_sd_m_s: float = 0.3
    current_tau_s: float = 3600.0

    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.water_velocity)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("current_sd_m_s", "current_tau_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(
                    f"WaterVelocity.{name} must be a finite number > 0, found {getattr(self, name)!r}. Usual: 0.3 m/s, 3600 s."
                )
        if any(learning_part(model) is not None for model in self.models):
            raise ValueError(
                "WaterVelocity.error cannot be learnt under way: the current hides in it. Give it a fixed error model, or a LearnedArma "
                "with frozen=True."
            )

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """Current north and east, then scale and misalignment where they are uncertain."""
        return (("current_north", self.current_sd_m_s), ("current_east", self.current_sd_m_s), *super().parameters())

    def wandering(self) -> dict[str, ErrorModel]:
        """The current."""
        current = GaussMarkov(sd=self.current_sd_m_s, tau_s=self.current_tau_s)
        return {"current_north": current, "current_east": current}


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

    def __post_init__(self) -> None:
        super().__post_init__()
        _vector("Heading.hard_iron", self.hard_iron)
        _vector("Heading.soft_iron", self.soft_iron, 9)
        _vector("Heading.deviation_sd_rad", self.deviation_sd_rad, 2)

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


@dataclass(frozen=True, kw_only=True)
class Depth(Sensor):
    """Depth below the surface [m, positive down], or the absolute pressure [Pa] it is computed from.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the sensor, in b [m].
    pressure : bool
        Readings are absolute pressures [Pa], turned into depth by TEOS-10 (IOC, SCOR, IAPSO, 2010).
    atmospheric_pressure_pa : float
        Taken off the pressure [Pa].
    latitude_deg : float, optional
        For the pressure conversion; default 45 degrees (the depth changes by 0.5 % from equator to pole).
    surface_height_m : float
        Height of the water surface in the height system of the mission [m].
    offset_sd_m : float
        Standard deviation of an unknown constant offset [m]; 0 leaves the state out.
    """

    error: Errors = White(sd=0.1)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    pressure: bool = False
    atmospheric_pressure_pa: float = 101325.0
    latitude_deg: float = 45.0
    surface_height_m: float = 0.0
    offset_sd_m: float = 0.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.05, tau_s=10.0) + White(sd=0.05)
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.depth)

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """The offset, or none."""
        return (("offset", self.offset_sd_m),) if self.offset_sd_m else ()

    def constants(self, start: Start) -> Array:
        """Lever arm and height of the surface."""
        return np.array([*self.lever_arm_b_m, self.surface_height_m], dtype=float)

    def read(self, value: Array) -> Array | None:
        """Pressure to depth where that is what arrives."""
        if not math.isfinite(value[0]):
            return None
        if not self.pressure:
            return value[:1]
        from gsw import z_from_p

        return np.array([-float(z_from_p((value[0] - self.atmospheric_pressure_pa) * 1e-4, self.latitude_deg))])


@dataclass(frozen=True, kw_only=True)
class Position(Sensor):
    """Position fix (GPS, USBL): latitude, longitude [rad], height [m], optionally the HDOP as fourth element.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the antenna, in b [m].
    max_hdop : float
        Fixes with a greater HDOP are not readings (thesis, 4.3.1: 4).

    Notes
    -----
    Errors are in metres north, east, down. A NaN height is a 2-D fix.
    """

    error: Errors = White(sd=3.0)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    max_hdop: float = 4.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=3.0, tau_s=60.0) + White(sd=1.0)
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.position)

    def constants(self, start: Start) -> Array:
        """The lever arm."""
        return np.asarray(self.lever_arm_b_m, dtype=float)

    def read(self, value: Array) -> Array | None:
        """None for a fix without latitude or longitude, off the globe, or of poor geometry."""
        if len(value) > 3 and value[3] > self.max_hdop:
            return None
        ok = abs(value[0]) <= math.pi / 2 and abs(value[1]) <= 2 * math.pi
        return np.ascontiguousarray(value[:3]) if ok else None


@dataclass(frozen=True, kw_only=True)
class ZeroVelocity(Sensor):
    """Zero-velocity update: the navigator itself detects rest from the inertial unit; there is no stream of readings.

    Parameters
    ----------
    gyro_sd_max, force_sd_max : float
        Rest is when, over one period of this sensor, every gyro axis scatters less than this [rad/s] and every accelerometer axis
        less [m/s^2].
    gyro_mean_max : float
        ... and every mean rate is below this [rad/s] (estimated bias and Earth rate are within it).

    Notes
    -----
    For vehicles that really stand still (on deck, on the bottom, on wheels). An AUV gliding in calm water looks the same to its
    inertial unit: do not use it there.
    """

    error: Errors = White(sd=0.02)
    gyro_sd_max: float = 0.005
    force_sd_max: float = 0.05
    gyro_mean_max: float = 0.02

    unit: ClassVar[str] = "m_s"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.velocity)

"""Heading by a compass or a magnetometer.

Attitude by an instrument that computes it itself (AHRS).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, Mask
from navfilter.kernels import consistency, measurement, open_loop_residual
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.navigation_drift import Drift, DriftSource
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import LARGEST, Sensor, Vector, checked_vector
from navfilter.models.sensors.traits import EXAMPLES, Columns, Doubt, Example, Plausible, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

HEADING = Columns("heading", ("heading_rad",), ("angle",), circular=("heading_rad",))
FIELD = Columns("field", ("field_x_T", "field_y_T", "field_z_T"), ("magnetic field",) * 3)
#: Elements of the soft iron that are states, in their order.
SOFT_IRON = ("xx", "zz", "xy", "xz", "yz")
#: A vehicle keeps its heading for so long and longer [s]; three times more makes no difference to what is found of
#: deviation, but beside a heading that is hardly known the compass says less.
LEG_S = 3.0
#: What iron leaves out counts as the same for so long [s]: a vehicle that goes straight on for half an hour
#: has the noise of all its readings as one, and would tell iron from heading by what the equation is off.
STRAIGHT_S = 300.0
TEMPERATURE = Columns("temperature", ("temperature_C",), ("temperature",))
#: Generous: beyond the worst and the best of instruments on the market.
USUAL = Plausible(1e-5, math.radians(30.0), "deg", most_rate_hz=200.0)


def with_declination_sd(sensor: Any, magnetic: bool, start: Start) -> Any:
    """The same heading or attitude with what the model's declination errs by at this place, where that is much."""
    if not magnetic or sensor.declination_rad is not None or sensor.declination_sd_rad is not None:
        return sensor
    from navfilter.models.magnetic import CAUTION_NT, north

    there = north(start.latitude_deg, start.longitude_deg, start.height_m, start.date)
    return replace(sensor, declination_sd_rad=there.sd) if there.horizontal_nt < CAUTION_NT else sensor


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
    declination_sd_rad : float, optional
        Standard deviation of the declination [rad]: it is part of the bias. Default: that of the model where the model
        gives the declination and the horizontal field is below 6000 nT, its own caution zone; else nothing.
    bias_sd_rad, deviation_sd_rad, temperature_sd_rad_per_k : float, (2,) float, float
        Standard deviations of constant states: bias, one- and two-cycle deviation (each a sine and a cosine of the
        heading), and the drift with temperature (thesis eq 4.1). All zero: no such states.
    reference_temperature_c : float
        Temperature at which the temperature term vanishes [deg C].
    hard_iron, soft_iron : (3,) and (9,) float
        Calibration of the magnetometer: ``field = soft_iron @ (reading - hard_iron)``, `soft_iron` row by row.
    hard_iron_sd, soft_iron_sd : float
        Standard deviations of constant states of a magnetometer: what is left of the hard iron, in units of the
        calibrated reading, in each axis; and each of the five elements of what is left of the soft iron. Zero: no
        such states.

    Notes
    -----
    A reading may carry a temperature [deg C] as its last element.

    With iron states the field is ``(I + A) (calibrated reading) - h``, A symmetric with yy = -xx: an ellipsoid becomes
    a sphere, whose size no azimuth shows (Gebre-Egziabher et al., 2006, "Calibration of strapdown magnetometers in
    magnetic field domain"). Only the azimuth of the levelled field is compared, so that turns show what lies in their
    plane. What turns A by itself is the bias.
    """

    error: Errors = White(sd=0.02)
    magnetometer: bool = False
    magnetic: bool = False
    declination_rad: float | None = None
    declination_sd_rad: float | None = None
    bias_sd_rad: float = 0.0
    deviation_sd_rad: tuple[float, float] = (0.0, 0.0)
    temperature_sd_rad_per_k: float = 0.0
    reference_temperature_c: float = 20.0
    hard_iron: Vector = (0.0, 0.0, 0.0)
    soft_iron: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    hard_iron_sd: float = 0.0
    soft_iron_sd: float = 0.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.015, tau_s=30.0) + White(sd=0.005)
    unit: ClassVar[str] = "rad"
    open_loop: ClassVar[int] = open_loop_residual.HEADING
    gives: ClassVar[str] = "heading"
    observes: ClassVar[Observable] = Observable.HEADING
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((HEADING,), (FIELD,))
    beside: ClassVar[tuple[Columns, ...]] = (TEMPERATURE,)
    plausible: ClassVar[Plausible | None] = USUAL
    template: ClassVar[Example | None] = EXAMPLES["compass"]

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector("Heading.hard_iron", self.hard_iron)
        checked_vector("Heading.soft_iron", self.soft_iron, 9)
        checked_vector("Heading.deviation_sd_rad", self.deviation_sd_rad, 2)
        check_numbers(self, "declination_sd_rad", "hard_iron_sd", "soft_iron_sd")
        for name in ("hard_iron_sd", "soft_iron_sd"):
            if getattr(self, name) and not self.magnetometer:
                raise ValueError(
                    f"Heading.{name} is for a magnetometer: of a heading output iron is deviation (deviation_sd_deg)."
                )

    @property
    def kernel(self) -> Callable[..., None]:  # type: ignore[override]
        """The measurement kernel."""
        return measurement.magnetometer if self.magnetometer else measurement.heading

    @property
    def bend(self) -> Callable[..., None] | None:  # type: ignore[override]
        """What its equation leaves out: of iron, which is a tenth of the field and more, and of deviation."""
        if self.magnetometer:
            of_iron = self.hard_iron_sd or self.soft_iron_sd
            return consistency.iron_second_order if of_iron else consistency.tilt_second_order
        return consistency.deviation_second_order if any(self.deviation_sd_rad) else None

    @property
    def deviation(self) -> int | None:  # type: ignore[override]
        """Its sine and cosine stand behind the bias."""
        return 1 if any(self.deviation_sd_rad) else None

    @property
    def reads(self) -> int:  # type: ignore[override]
        """Number of elements of a reading without the temperature."""
        return 3 if self.magnetometer else 1

    def parameters(self) -> tuple[Parameter, ...]:
        """Bias, deviation and temperature states, or none; hard iron, soft iron."""
        constants, (hard, soft) = self._constants(), self._iron()
        return (
            *(constants if any(p.sd for p in constants) else ()),
            *(hard if self.hard_iron_sd else ()),
            *(soft if self.soft_iron_sd else ()),
        )

    def _iron(self) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
        """Hard and soft iron that the calibration has left."""
        hard = tuple(Parameter(f"hard_iron_{axis}", self.hard_iron_sd, "field") for axis in "xyz")
        return hard, tuple(Parameter(f"soft_iron_{axes}", self.soft_iron_sd, "1") for axes in SOFT_IRON)

    def _constants(self) -> tuple[Parameter, ...]:
        one, two = self.deviation_sd_rad
        return (
            Parameter("bias", self.constant_sd_rad, "rad"),
            Parameter("one_cycle_sin", one, "rad"),
            Parameter("one_cycle_cos", one, "rad"),
            Parameter("two_cycle_sin", two, "rad"),
            Parameter("two_cycle_cos", two, "rad"),
            Parameter("temperature", self.temperature_sd_rad_per_k, "rad_per_k"),
        )

    @property
    def constant_sd_rad(self) -> float:
        """Of bias and declination together, which no reading tells from each other [rad]."""
        return math.hypot(self.bias_sd_rad, self.declination_sd_rad or 0.0)

    def at(self, start: Start) -> "Heading":
        """With what its declination errs by at this place."""
        return with_declination_sd(self, self.magnetic or self.magnetometer, start)

    def declination(self, start: Start) -> float:
        """Magnetic declination in force [rad]; 0 for a compass that reads true heading."""
        if not (self.magnetic or self.magnetometer):
            return 0.0
        if self.declination_rad is not None:
            return self.declination_rad
        from navfilter.models.magnetic import declination

        return declination(start.latitude_deg, start.longitude_deg, start.height_m, start.date)

    def constants(self, start: Start) -> Array:
        """Declination and reference temperature, where among the states hard and soft iron begin (-1 for none), and how
        many readings share what the equation leaves out of deviation and of iron.
        """
        names, iron = [p.name for p in self.parameters()], ("hard_iron_x", f"soft_iron_{SOFT_IRON[0]}")
        begins = [names.index(first) if self.magnetometer and first in names else -1 for first in iron]
        shared = [max(1.0, seconds * self.rate_hz) for seconds in (LEG_S, STRAIGHT_S)]
        return np.array([self.declination(start), self.reference_temperature_c, *begins, *shared])

    def read(self, value: Array) -> Array | None:
        """Apply the iron calibration; append NaN where there is no temperature."""
        n, given = self.reads, value.tolist()
        for v in given[:n]:
            if not abs(v) <= LARGEST:
                return None
        z = np.array([*given, math.nan][: n + 1])
        if self.magnetometer:
            z[:3] = np.reshape(self.soft_iron, (3, 3)) @ (z[:3] - np.asarray(self.hard_iron))
            return z if z[:3].any() else None
        return z

    @property
    def plain(self) -> tuple[float, int]:
        """A heading, and no temperature."""
        otherwise = self.magnetometer or type(self).read is not Heading.read
        return (0.0, 0) if otherwise else (LARGEST, self.reads + 1)

    def read_all(self, values: Array | Sequence[Array]) -> tuple[Array, Mask]:
        """Headings at once; fields one by one."""
        otherwise = self.magnetometer or type(self).read is not Heading.read
        if otherwise or not isinstance(values, np.ndarray) or values.shape[1] < self.reads:
            return super().read_all(values)
        z = np.full((len(values), 2), math.nan)
        z[:, : values.shape[1]] = values[:, :2]
        return z, np.abs(z[:, 0]) <= LARGEST

    def headings(self, readings: Array, level: Array, start: Start) -> tuple[Array, float, float]:
        """True headings by readings (n, ...) of a vehicle that is level by this rotation (3, 3) out of b, the variance
        of their mean [rad], [rad^2], and by how much a tilt turns them [rad/rad].
        """
        variance, dip = sum(p.sd**2 for p in self.at(start)._constants()[:5]), 0.0
        if self.magnetometer:
            field = readings[:, :3] @ level.T
            angles = -np.arctan2(field[:, 1], field[:, 0])
            across = float(np.mean(np.hypot(field[:, 0], field[:, 1])))
            dip = abs(float(np.mean(field[:, 2]))) / across
            variance += (self.hard_iron_sd / across) ** 2 + self.soft_iron_sd**2 * (1.0 + dip**2)
        else:
            angles = readings[:, 0]
        return angles + self.declination(start), variance + self.mean_variance(0, len(readings)), dip

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """As a heading."""
        return drive.heading_drift(walk, 1.0 / self.rate_hz)

    @property
    def words(self) -> str:
        """What it measures."""
        return "magnetometer" if self.magnetometer else "heading"

    def stream_columns(self) -> tuple[str, ...]:
        """Heading or field."""
        return FIELD.names if self.magnetometer else HEADING.names

    def doubts(self) -> Iterator[Doubt]:
        """Of bias, deviation, declination and iron."""
        for name, value in (("bias_sd_rad", self.bias_sd_rad), ("deviation_sd_rad", max(self.deviation_sd_rad))):
            if value > math.radians(60.0):
                yield angle_doubt(name, value)
        if self.declination_rad is not None and abs(self.declination_rad) > math.pi:
            yield angle_doubt("declination_rad", self.declination_rad)
        if self.soft_iron_sd > 0.5:
            text = f"a soft iron of {100.0 * self.soft_iron_sd:.3g} % is unusual."
            yield Doubt("soft_iron_sd", text, "It is a pure number: 5 % is 0.05.")
        iron = zip(("hard", "soft"), (self.hard_iron_sd, self.soft_iron_sd), self.deviation_sd_rad, strict=True)
        for cycles, (kind, sd, deviation) in enumerate(iron, 1):
            if sd and deviation:
                cycle = "one cycle" if cycles == 1 else "two cycles"
                text = f"in level turns {kind} iron is a deviation of {cycle}: two states for one thing."
                yield Doubt("deviation_sd_rad", text, f"Leave out {kind}_iron_sd, or set that deviation to 0.")

    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """Deviation (bias, sine and cosine of the heading and of its double), drift with temperature, iron."""
        *deviation, temperature = self._constants()
        hard, soft = self._iron()
        return {"deviation": tuple(deviation), "temperature": (temperature,), "hard_iron": hard, "soft_iron": soft}

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Heading, or the magnetic field in body axes; the temperature too if the compass has a temperature term."""
        of_field = self.magnetic or self.magnetometer
        declination = truth.declination(self.declination_rad) if of_field else 0.0
        from_north = here.attitude[:, 2] - declination
        temperature = truth.water_temperature_c(here)
        warmth = temperature - self.reference_temperature_c
        error = truth.error[:, 0] + truth.deviation(from_north) + truth.drawn["temperature"][0] * warmth
        if self.magnetometer:
            value = self._simulated_field(here, declination, error, truth)
            columns: tuple[str, ...] = ("field_x", "field_y", "field_z")
        else:
            value, columns = (np.pi - np.mod(np.pi - (from_north + error), 2.0 * np.pi))[:, None], ("heading_rad",)
        if self.temperature_sd_rad_per_k or truth.drawn["temperature"][0]:
            return np.column_stack([value, temperature]), (*columns, "temperature_c")
        return value, columns

    def _simulated_field(self, here: Kinematics, declination: float, error: Array, truth: Truth) -> Array:
        """Field in body axes that shows this error: a compass that reads too high sees north too far to the left."""
        azimuth, field_n = declination - error, truth.field_n()
        level = math.hypot(field_n[0], field_n[1])
        down = np.full_like(azimuth, field_n[2])
        field = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), down], axis=-1)
        xx, zz, xy, xz, yz = truth.drawn["soft_iron"]
        left = np.linalg.inv([[1.0 + xx, xy, xz], [xy, 1.0 - xx, yz], [xz, yz, 1.0 + zz]])
        reading = (np.einsum("nij,ni->nj", here.C_nb, field) + truth.drawn["hard_iron"]) @ left.T
        return reading @ np.linalg.inv(np.reshape(self.soft_iron, (3, 3))).T + np.asarray(self.hard_iron)

    @classmethod
    def examples(cls) -> tuple[Sensor, ...]:
        """Compasses without and with deviation, and a magnetometer."""
        error = White(sd=0.01) + GaussMarkov(sd=0.01, tau_s=10.0)
        return (
            cls(error=error),
            cls(error=error, deviation_sd_rad=(0.02, 0.01)),
            cls(magnetometer=True, error=error, hard_iron_sd=1e-6, soft_iron_sd=0.01),
        )


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
    template: ClassVar[Example | None] = EXAMPLES["ahrs"]

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector("Attitude.mounting_rad", self.mounting_rad)
        check_numbers(self, "misalignment_sd_rad", "declination_sd_rad")

    def at(self, start: Start) -> "Attitude":
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
    def examples(cls) -> "tuple[Attitude, ...]":
        """One with misalignment."""
        return (cls(misalignment_sd_rad=0.01),)

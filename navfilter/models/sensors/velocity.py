"""Velocity over ground, velocity through the water, and the zero velocity of a vehicle at rest.

Wheels: how fast they roll, and that they roll neither sideways nor off the ground.

Velocity over ground by a satellite receiver: speed and course, or north, east, down.

The rate of a vehicle that does not turn.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, Mask
from navfilter.kernels import measurement, open_loop_residual, strapdown
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.learned_arma import learning_part
from navfilter.models.navigation_drift import Drift, DriftSource
from navfilter.models.parameters import Parameter, hidden_states
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector, checked_sds, checked_vector
from navfilter.models.sensors.traits import EXAMPLES, Columns, Doubt, Example, Plausible, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

VELOCITY = Columns("velocity", ("v_x_m_s", "v_y_m_s", "v_z_m_s"), ("speed",) * 3)
#: Generous: beyond the worst and the best of instruments on the market.
USUAL = Plausible(1e-4, 0.5, "cm_per_s", most_rate_hz=100.0)
#: A current changes by no more than this within minutes, on the way through a shear layer or an eddy [m/s]; what comes
#: to be off by more has another cause.
FLOWS_M_S = 1.0
#: Wheels that turn slower than this stand: what is left is the noise of what counts them [m/s].
STILL_M_S = 0.05
#: So many standard deviations a mounting may be turned by while nobody knows it [1]. Noise of the gyros moves an
#: instrument across its arm only, and one that reads mm/s would be exact along it: of such a DVL 2 m off a
#: micromechanical unit the mounting was 34, 25 and 10 standard deviations off; by 1 13, 18 and 8, by this 4, 8 and 3.
ASTRAY = 3.0


@dataclass(frozen=True, kw_only=True)
class BodyVelocity(Sensor):
    """Velocity over ground in instrument axes [m/s]: a DVL in bottom track, or wheels (constant zeros for the axes that
    cannot slip).

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point (the inertial unit) to the instrument, in b [m].
    mounting_rad : (3,) float
        Roll, pitch, yaw of the instrument's axes in b [rad]: ``v_b = C(mounting) v_instrument``.
    scale_sd : float or (3,) float
        Standard deviation of an unknown constant scale error: one number, one scale for all axes; three numbers, one
        for each. 0 leaves the scale and misalignment states out unless `misalignment_sd_rad` is set.
    misalignment_sd_rad : float or (3,) float
        Standard deviation of the unknown constant mounting error, about all axes or about each [rad].
    zero_is_invalid : bool
        Exactly zero on all axes is what instruments print when they have lost the bottom; set False for wheels.
    max_speed_m_s : float
        A component above it is a sentinel or an error, not a reading.

    Notes
    -----
    ``reading = (1 + s) R(m) y + error`` with ``y`` the velocity of the instrument in its own axes, lever arm
    included, and ``1 + s`` a number or a diagonal matrix. Scale and misalignment can only be told from the vehicle's
    motion by position fixes.
    """

    error: Errors = White(sd=0.01)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    mounting_rad: Vector = (0.0, 0.0, 0.0)
    scale_sd: float | Vector = 0.0
    misalignment_sd_rad: float | Vector = 0.0
    zero_is_invalid: bool = True
    max_speed_m_s: float = 20.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.01, tau_s=5.0) + White(sd=0.01)
    unit: ClassVar[str] = "m_s"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.body_velocity)
    open_loop: ClassVar[int] = open_loop_residual.VELOCITY
    gives: ClassVar[str] = "velocity"
    observes: ClassVar[Observable] = Observable.VELOCITY_BODY
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((VELOCITY,),)
    plausible: ClassVar[Plausible | None] = USUAL
    template: ClassVar[Example | None] = EXAMPLES["dvl"]

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector("BodyVelocity.mounting_rad", self.mounting_rad)
        for name in ("scale_sd", "misalignment_sd_rad"):
            checked_sds(f"{type(self).__name__}.{name}", getattr(self, name))

    def parameters(self) -> tuple[Parameter, ...]:
        """Scale (or one an axis) and three misalignments, or none."""
        return self.calibration()

    @property
    def still_m_s(self) -> float:
        """Wheels that stand do not err, and neither do axes that cannot slip."""
        return 0.0 if self.zero_is_invalid else STILL_M_S

    def held(self) -> tuple[int, int]:
        """Scale and misalignment."""
        last = len(self.parameters())
        return last - len(self.calibration()), last

    def calibration(self) -> tuple[Parameter, ...]:
        """Those of the instrument itself, where they are uncertain."""
        scales, angles = self._scales_and_angles()
        return scales + angles if any(p.sd for p in scales + angles) else ()

    def _scales_and_angles(self) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
        scales = checked_sds("scale_sd", self.scale_sd)
        angles = checked_sds("misalignment_sd_rad", self.misalignment_sd_rad)
        each = [f"scale_{axis}" for axis in "xyz"] if len(scales) == 3 else ["scale"]
        return (
            tuple(Parameter(name, sd, "1") for name, sd in zip(each, scales, strict=True)),
            tuple(Parameter(f"misalignment_{'xyz'[i]}", angles[i % len(angles)], "rad") for i in range(3)),
        )

    def constants(self, start: Start) -> Array:
        """Lever arm, then the mounting matrix row by row."""
        return np.concatenate(
            [np.asarray(self.lever_arm_b_m, dtype=float), matrix_from_euler(*self.mounting_rad).ravel()]
        )

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

    @property
    def plain(self) -> tuple[float, int]:
        """All three components."""
        return (0.0, 0) if type(self).read is not BodyVelocity.read or self.reads != 3 else (self.max_speed_m_s, 3)

    def read_all(self, values: Array | Sequence[Array]) -> tuple[Array, Mask]:
        """The same of many."""
        otherwise = type(self).read is not BodyVelocity.read
        if otherwise or not isinstance(values, np.ndarray) or values.shape[1] < self.reads:
            return super().read_all(values)
        z = np.array(values[:, :3], dtype=np.float64)
        valid = np.abs(z) <= self.max_speed_m_s
        z[~valid] = math.nan
        told = valid & (z != 0.0) if self.zero_is_invalid else valid
        return z, np.asarray(told.any(axis=1), dtype=bool)

    @property
    def needs_rate(self) -> bool:
        """With a lever arm."""
        return any(self.lever_arm_b_m)

    def lever_arm_covariance(self, rate_variance: Array) -> Array:
        """Strongly correlated (a rate moves the arm across itself), which counts where the instrument is quiet; of what
        is not known of the arm the mean, and as much along it as a mounting that is not known turns there.
        """
        axes, arm = self.instrument_axes(), np.asarray(self.lever_arm_b_m, dtype=float)
        by_rate, square = np.cross(np.eye(3), arm).T, np.square(self.lever_arm_sd_m)
        unknown = rate_variance @ np.array([np.cross(axis, np.eye(3)) ** 2 @ square for axis in np.eye(3)])
        moved = by_rate @ np.diag(rate_variance) @ by_rate.T + np.diag(unknown)
        angles = ASTRAY * np.resize(self.misalignment_sd_rad, 3)
        turns = [
            np.cross(np.eye(3), a * axis) for a, axis in zip(angles, BodyVelocity.instrument_axes(self), strict=True)
        ]
        return axes @ (moved + sum(turn @ moved @ turn.T for turn in turns)) @ axes.T

    def instrument_axes(self) -> Array:
        """Those of the mounting."""
        return matrix_from_euler(*self.mounting_rad).T

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """As a velocity: the third axis is taken as the vertical one."""
        return drive.velocity_drift(walk, 1.0 / self.rate_hz, vertical=axis == 2)

    def doubts(self) -> Iterator[Doubt]:
        """Of mounting, misalignment and scale."""
        if max(map(abs, self.mounting_rad)) > 2.0 * math.pi:
            yield angle_doubt("mounting_rad", max(self.mounting_rad, key=abs))
        most = max(checked_sds("misalignment_sd_rad", self.misalignment_sd_rad))
        if most > math.radians(20.0):
            yield angle_doubt("misalignment_sd_rad", most)
        most = max(checked_sds("scale_sd", self.scale_sd))
        if most > 0.2:
            cure = "It is a pure number: 1 % is 0.01."
            yield Doubt("scale_sd", f"a scale error of {100.0 * most:.4g} % is unusual.", cure)

    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """Scale, and the rotation vector of the misalignment."""
        scales, angles = self._scales_and_angles()
        return {"scale": scales, "misalignment": angles}

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Velocity of the instrument in its own axes, over ground or through water that moves."""
        from scipy.spatial.transform import Rotation  # only a simulation needs it

        lever = np.asarray(self.lever_arm_b_m, dtype=np.float64)
        v_b = np.einsum("nij,ni->nj", here.C_nb, here.velocity_n - truth.current_n) + np.cross(here.rate_eb_b, lever)
        mounting = Rotation.from_euler("ZYX", self.mounting_rad[::-1])
        v = truth.turned_and_scaled(mounting.inv().apply(v_b))
        return v + truth.error, self.stream_columns()


@dataclass(frozen=True, kw_only=True)
class WaterVelocity(BodyVelocity):
    """Velocity through the water in instrument axes [m/s]: a DVL in water track, or an electromagnetic log.

    The horizontal current is two states, north and east, so that what is known of it carries the position while there
    is nothing else.

    Parameters
    ----------
    current_sd_m_s : float
        Standard deviation of each component of the current [m/s].
    current_tau_s : float
        Its correlation time [s]: in dt << tau the current changes by ``sd * sqrt(2 dt / tau)``.
    current : ErrorModel, optional
        How each component wanders [m/s], instead: of second order, or with a tide, ``GaussMarkov(sd=0.1, tau_s=86400) +
        Cycle(sd=0.15, period_s=44714, tau_s=1e6)``.

    Notes
    -----
    As `BodyVelocity`, with ``y`` the velocity relative to the water: ``C_nb' (v_n - c_n)``. Without `current` it
    wanders as a first-order Gauss-Markov process on the clock of this sensor; water that rises or sinks is taken for
    error. What this sensor itself errs by at low frequencies cannot be told from the current, so that its error is not
    learnt.
    """

    error: Errors = White(sd=0.02)
    current_sd_m_s: float = 0.3
    current_tau_s: float = 3600.0
    current: ErrorModel | None = None

    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.water_velocity)
    open_loop: ClassVar[int] = open_loop_residual.NOTHING
    observes: ClassVar[Observable] = Observable.VELOCITY_WATER
    gives: ClassVar[str] = ""
    flows_m_s: ClassVar[float] = FLOWS_M_S
    template: ClassVar[Example | None] = EXAMPLES["water"]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "current_sd_m_s", "current_tau_s", zero_ok=False, usual="0.3 m/s, 3600 s")
        if self.current is not None:
            self._check_current()
        if any(learning_part(model) is not None for model in self.models):
            raise ValueError(
                "WaterVelocity.error cannot be learnt under way: the current hides in it. Give it a fixed error model, "
                "or a LearnedArma with frozen=True."
            )

    def _check_current(self) -> None:
        """Refuse what cannot be a state."""
        block = self.current.block(1.0 / self.rate_hz) if isinstance(self.current, ErrorModel) else None
        if block is None or not block.size or block.r or not block.C[0]:
            raise ValueError(
                f"WaterVelocity.current must be one error model without white noise, found {self.current!r}. Example: "
                "GaussMarkov(sd=0.2, tau_s=10800). White noise of the velocity belongs to error."
            )

    def parameters(self) -> tuple[Parameter, ...]:
        """Current north and east, what else their models consist of, then scale and misalignment where they are
        uncertain.
        """
        blocks = {name: model.block(1.0 / self.rate_hz) for name, model in self.wandering().items()}
        sds = ((name, math.sqrt(block.state_variance)) for name, block in blocks.items())
        current = (Parameter(name, sd, "m_s") for name, sd in sds)
        hidden = (p for name, block in blocks.items() for p in hidden_states(name, block, "m_s"))
        return (*current, *hidden, *super().parameters())

    def constants(self, start: Start) -> Array:
        """Also how many states are of the current."""
        return np.concatenate([super().constants(start), [self.held()[0]]])

    def wandering(self) -> dict[str, ErrorModel]:
        """The current."""
        current = self.current or GaussMarkov(sd=self.current_sd_m_s, tau_s=self.current_tau_s)
        return {"current_north": current, "current_east": current}

    @property
    def words(self) -> str:
        """What it measures."""
        return "velocity through the water"

    def doubts(self) -> Iterator[Doubt]:
        """Also of the current."""
        yield from super().doubts()
        if self.current_sd_m_s > 3.0:
            text = f"a current of {self.current_sd_m_s:.4g} m/s is faster than all but the strongest tidal streams."
            yield Doubt("current_sd_m_s", text, "It is in m/s; for cm/s write current_sd_cm_per_s.")
        if self.current_tau_s < 60.0:
            text = f"a current that is another one after {self.current_tau_s:.3g} s carries no position."
            cure = "It is in seconds; currents last for hours. Eddies and waves belong to error."
            yield Doubt("current_tau_s", text, cure)


@dataclass(frozen=True, kw_only=True)
class ZeroVelocity(Sensor):
    """Zero-velocity update: the navigator itself detects rest from the inertial unit; there is no stream of readings.

    Parameters
    ----------
    gyro_sd_max, force_sd_max : float
        Rest is when, over one period of this sensor, every gyro axis scatters less than this [rad/s] and every
        accelerometer axis less [m/s^2].
    gyro_mean_max : float
        ... and every mean rate is below this [rad/s] (estimated bias and Earth rate are within it).
    speed_max : float, optional
        ... and the filter itself believes in a speed below this [m/s]. For vehicles whose running engine shakes them as
        much at rest as under way, with a sensor that tells their speed.

    Raises
    ------
    ValueError
        For a limit that nothing is below.

    Notes
    -----
    For vehicles that really stand still (on deck, on the bottom, on wheels). An AUV gliding in calm water looks the
    same to its inertial unit: do not use it there. The mean rate at rest tells the bias of the gyros: `ZeroRate`.
    """

    error: Errors = White(sd=0.02)
    gyro_sd_max: float = 0.005
    force_sd_max: float = 0.05
    gyro_mean_max: float = 0.02
    speed_max: float | None = None

    unit: ClassVar[str] = "m_s"
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.velocity)
    from_drive: ClassVar[bool] = True
    observes: ClassVar[Observable] = Observable.VELOCITY_NED
    plausible: ClassVar[Plausible | None] = USUAL
    template: ClassVar[Example | None] = EXAMPLES["still"]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("gyro_sd_max", "force_sd_max", "gyro_mean_max", "speed_max"):
            limit = getattr(self, name)
            if limit is not None and not limit > 0:
                text = f"{type(self).__name__}.{name} must be > 0, found {limit!r}: nothing is below it."
                raise ValueError(text)

    def quiet(self, mean: Array, scatter: Array, velocity: Array, P: Array) -> bool:
        """Whether a period was one of rest, see `felt`."""
        still = scatter[:3].max() < self.gyro_sd_max and scatter[3:].max() < self.force_sd_max
        slow = self.speed_max is None or math.hypot(*velocity.tolist()) < self.speed_max
        return bool(still and slow and np.abs(mean[:3]).max() < self.gyro_mean_max)

    @property
    def words(self) -> str:
        """What it measures."""
        return "zero velocity, whenever the inertial unit says that the vehicle rests; needs no stream"

    def felt(self, mean: Array, scatter: Array, velocity: Array, P: Array) -> Array | None:
        """Zeros when the period was quiet."""
        return np.zeros(3) if self.quiet(mean, scatter, velocity, P) else None


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
    template: ClassVar[Example | None] = EXAMPLES["course"]

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
    template: ClassVar[Example | None] = EXAMPLES["odometer"]

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


#: A vehicle does not rest for the filter that is faster by so many standard deviations [1] than what hardly turns it
#: [m/s], or whose velocity is not known to so much [m/s].
SURE, RESTING_M_S, KNOWN_M_S = 5.0, 0.01, 0.05


@dataclass(frozen=True, kw_only=True)
class ZeroRate(ZeroVelocity):
    """Zero angular rate update: while the vehicle rests, what the gyros read is their error and the Earth's rate
    (Groves, 2013, sec. 15.3.3). As `ZeroVelocity` there is no stream of readings, and rest is detected in the same way.

    Parameters
    ----------
    error : ErrorModel
        How much the vehicle turns in the mean of a period although it rests, about each axis [rad/s]; the noise of the
        gyros is added by the filter itself.
    gate_timeout_s : float
        As of every sensor [s], but 300: that it turns slowly is likelier than a bias that is far from what is known.
    speed_max : float, optional
        As of `ZeroVelocity`. Default: a speed that is 0 as far as the filter knows, which knows it to 0.05 m/s; for the
        unit of a vehicle that goes straight on feels no more than that of one at rest.

    Notes
    -----
    It tells the bias of the gyros and, where that is smaller than the Earth's rate of 15 deg/h, the heading. A vehicle
    that is moored swings slowly, and is not at rest. The noise of a reading is the mean of what has turned the attitude
    in the same period; that both are one is not used, which makes the covariance of the heading a little too large.
    """

    error: Errors = White(sd=1e-5)
    gate_timeout_s: float = 300.0

    unit: ClassVar[str] = "rad_s"
    axis_names: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.earth_rate)
    confirms_state: ClassVar[bool] = False
    observes: ClassVar[Observable] = Observable.RATE
    plausible: ClassVar[Plausible | None] = Plausible(1e-8, 1e-2, "deg_per_h")
    template: ClassVar[Example | None] = EXAMPLES["turning"]

    @property
    def words(self) -> str:
        """What it measures."""
        return "zero angular rate, whenever the inertial unit says that the vehicle rests; needs no stream"

    def constants(self, start: Start) -> Array:
        """The Earth's rate [rad/s]."""
        return np.array([strapdown.EARTH_RATE])

    def quiet(self, mean: Array, scatter: Array, velocity: Array, P: Array) -> bool:
        """Whether a period was one of rest: also for the filter."""
        sd = math.sqrt(float(np.trace(P)))
        rests = sd < KNOWN_M_S and math.hypot(*velocity.tolist()) < SURE * sd + RESTING_M_S
        return (rests or self.speed_max is not None) and super().quiet(mean, scatter, velocity, P)

    def felt(self, mean: Array, scatter: Array, velocity: Array, P: Array) -> Array | None:
        """The mean rate when the period was quiet."""
        return mean[:3].copy() if self.quiet(mean, scatter, velocity, P) else None

    def lever_arm_covariance(self, rate_variance: Array) -> Array:
        """The gyros' own noise, of as many samples as a period has."""
        return np.diag(rate_variance)

    def doubts(self) -> Iterator[Doubt]:
        """Rest that is not told from a slow turn."""
        if self.gyro_mean_max > 0.1:
            text = f"a vehicle that turns by {self.gyro_mean_max:.3g} rad/s is taken to be at rest."
            yield Doubt("gyro_mean_max", text, "Usual: 0.02 rad/s; it must be above the bias of the gyros.")

"""What every drive says of itself: the rest of the program asks it and keeps no list of kinds.

An inertial unit as what drives.

Attitude and body velocity as what drives.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.foundation.frozen import FrozenDescription
from navfilter.kernels import delayed_state, strapdown
from navfilter.models.error_models import (
    ErrorModel,
    Errors,
    GaussMarkov,
    RandomWalk,
    Sum,
    White,
    check_numbers,
    per_axis,
    sum_of,
)
from navfilter.models.learned_arma import learned_part, learning_part
from navfilter.models.mission import Stream
from navfilter.models.navigation_drift import FOUND_S, Drift
from navfilter.models.parameters import Calibrated, Parameter, check_calibrated, constant_parameters, with_calibrated
from navfilter.models.sensors import BodyVelocity, Heading, Sensor, WaterVelocity
from navfilter.models.sensors.heading import ATTITUDE, TEMPERATURE
from navfilter.models.sensors.heading import USUAL as HEADING_USUAL
from navfilter.models.sensors.sensor import Vector, checked_sds
from navfilter.models.sensors.traits import Columns, Doubt, Plausible, angle_doubt
from navfilter.models.sensors.velocity import USUAL as VELOCITY_USUAL
from navfilter.models.sensors.velocity import VELOCITY
from navfilter.models.start import Start
from navfilter.models.state import NavState


class DriveNoise(NamedTuple):
    """What the errors of a drive gather in an integral, axis by axis, see `ErrorModel.integrated`.

    Attributes
    ----------
    white, walk : tuple of float
        Root PSDs of the white noise [unit/sqrt(Hz)] and of the walk of the bias [unit/s/sqrt(Hz)].
    start : tuple of float
        Standard deviation of the bias at the start [unit].
    """

    white: tuple[float, ...]
    walk: tuple[float, ...]
    start: tuple[float, ...]

    @classmethod
    def of(cls, models: Sequence[ErrorModel], period_s: float) -> "DriveNoise":
        """That of these axes."""
        each = [model.integrated(period_s) for model in models]
        return cls(
            tuple(math.sqrt(e.white * period_s) for e in each),
            tuple(math.sqrt(max(e.walk, 0.0) / period_s) for e in each),
            tuple(math.sqrt(e.start) for e in each),
        )


class Triple(NamedTuple):
    """Errors of some channels of a drive as its description gives them.

    Attributes
    ----------
    place : str
        In the description: a field, or a field of a field.
    given : ErrorModel or tuple of ErrorModel
    axes : slice
        Which of the six channels.
    plausible : Plausible
        What such channels usually err by.
    """

    place: str
    given: Errors
    axes: slice
    plausible: Plausible


@dataclass(frozen=True, kw_only=True)
class Mechanisation(FrozenDescription):
    """What both drives share: six channels whose errors enter the propagation.

    Parameters
    ----------
    rate_hz : float
    calibrated : tuple of (str, float, float)
        What a calibration found of its constant states: name, value and remaining standard deviation.
    max_speed_m_s, max_turn_rad_s : float, optional
        What the vehicle can do at most [m/s], [rad/s]: beyond it a state is a fault, see `NavState.trust`.

    Attributes
    ----------
    streams : tuple of str
        Of the mission, in the order of the six values of a sample.
    axis_names, units : tuple of str
        Of the six channels.
    inertial : bool
        The channels are three rates and three forces: what the vehicle does between two samples is felt, rest can be
        told.
    feels : bool
        Its samples say something; those of `DeadReckoningLane` do not.
    gravity : float
        What a tilt turns into acceleration [m/s^2]; 0 where the velocity is no integral.
    triples : (2,) str
        What the first three channels are called, and the last three.
    contents, beside : tuple
        What its streams in a file may consist of, see `navfilter.models.sensors.Sensor`.
    """

    rate_hz: float
    calibrated: Calibrated = ()
    max_speed_m_s: float | None = None
    max_turn_rad_s: float | None = None

    streams: ClassVar[tuple[str, ...]] = ()
    inertial: ClassVar[bool] = False
    feels: ClassVar[bool] = True
    gravity: ClassVar[float] = 0.0
    triples: ClassVar[tuple[str, str]]
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ()
    beside: ClassVar[tuple[Columns, ...]] = ()
    axis_names: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()
    steps: ClassVar[Callable[..., None]]
    hold: ClassVar[Callable[..., None]]
    moved: ClassVar[Callable[..., None]]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "rate_hz", zero_ok=False)
        for key in ("max_speed_m_s", "max_turn_rad_s"):
            if getattr(self, key) is not None and not getattr(self, key) > 0.0:
                raise ValueError(f"{type(self).__name__}.{key} must be > 0, found {getattr(self, key)!r}.")
        own = [p.name for p in constant_parameters(self.parameters(), self.wandering())] if self.calibrated else []
        # what belongs to one of its two sensors stands there
        own = [name for name in own if not name.startswith(("velocity.", "attitude.", "yaw."))]
        check_calibrated(type(self).__name__, self.calibrated, own)
        _ = self.models

    @property
    def period_s(self) -> float:
        """Nominal sampling period [s]."""
        return 1.0 / self.rate_hz

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Error models of the six channels."""
        raise NotImplementedError

    @cached_property
    def noise(self) -> DriveNoise:
        """What the errors of the six channels gather in an integral."""
        return DriveNoise.of(self.models, self.period_s)

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """Known noise of the heading error in an open-loop residual: integrators from the inside out.

        Parameters
        ----------
        walk : float
            Root PSD of the sensor's own random walk, which nobody can tell from that of the heading [rad/s/sqrt(Hz)].
        period_s : float
            Of the sensor.
        """
        raise NotImplementedError

    def velocity_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """As `heading_drift`, for one component of the velocity error; `walk` in m/s/s/sqrt(Hz)."""
        raise NotImplementedError

    def position_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """As `heading_drift`, for one component of the position error; `walk` in m/s/sqrt(Hz)."""
        raise NotImplementedError

    @property
    def compass(self) -> Heading | None:
        """The sensor that gives the heading of its attitude, if one is described."""
        return None

    @property
    def velocity_sensor(self) -> BodyVelocity | None:
        """The sensor that gives its velocity, if it has one."""
        return None

    @property
    def late_s(self) -> tuple[float, float]:
        """How late the stamps of its two streams are, as described [s]."""
        return 0.0, 0.0

    def at(self, start: Start) -> "Mechanisation":
        """As it is at this place, see `navfilter.models.sensors.Sensor.at`."""
        return self

    def declination(self, start: Start) -> float:
        """From its heading to the true one [rad]."""
        return 0.0 if self.compass is None else self.compass.declination(start)

    def parameters(self) -> tuple[Parameter, ...]:
        """Constant states of the drive beside its error models."""
        return ()

    def all_parameters(self) -> tuple[Parameter, ...]:
        """The same with what a calibration found of them."""
        return with_calibrated(self.parameters(), self.calibrated)

    def wandering(self) -> dict[str, ErrorModel]:
        """Those of the parameters that are not constant, see `navfilter.models.sensors.Sensor.wandering`."""
        return {}

    def limits(self) -> Array:
        """Largest magnitude of the values of a sample that must be there; beyond it the sample is a defect."""
        raise NotImplementedError

    def conditions(self, drv: Array) -> dict[str, str]:
        """Condition in words of its parts, by the kernels' memory, where no watch looks at its axes."""
        return {}

    def memory(self, first_parameter: int, start: Start | None = None) -> Array:
        """The kernels' ``drv`` at the start; `first_parameter` counts the drive's states before its parameters."""
        drv = np.zeros(strapdown.DRIVE_SIZE)
        drv[strapdown.PERIOD_S], drv[strapdown.INERTIAL] = self.period_s, float(self.inertial)
        return drv

    def draws(self, triple: str) -> dict[str, tuple[Parameter, ...]]:
        """Calibration errors that are drawn for a simulated mission of one of its `triples`, see `Sensor.draws`."""
        return {}

    # ---------------------------------------------------------------- what sensors with a doubtful clock ask
    def outputs(self, rows: Array, drv: Array, xd: Array) -> tuple[Array, Array]:
        """Rows by which its states `xd` make the errors of its six values now, shape (6, k): those of its error models,
        the first of `rows` (6, k + 1), and what its constants do to its last sample; and these errors, shape (6,).
        """
        found, errors = np.empty((6, len(xd))), np.empty(6)
        delayed_state.drive_outputs(drv, rows, xd, found, errors)
        return found, errors

    def remembered(self, past_s: float) -> int:
        """How many of the last samples tell how the vehicle has moved for `past_s` seconds; at least two."""
        return max(2, math.ceil((past_s + delayed_state.MORE_S) / self.period_s) + 1)

    def motion(self, recent: Array, nav: Array, drv: Array, errors: Array) -> tuple[Array, float]:
        """How the vehicle has moved of late.

        Parameters
        ----------
        recent : ndarray, shape (k, 7)
            The last samples, the newest first: seconds since the one before (0: none), six values.
        nav, drv : ndarray
            State and memory of the drive's kernels.
        errors : ndarray, shape (6,)
            Those of the six values now, as estimated.

        Returns
        -------
        motion : ndarray, shape (j, 7)
            Intervals, the newest first: seconds, angular rate [rad/s] and specific force [m/s^2] in b.
        gravity : float
            [m/s^2]; 0 where the forces are accelerations.
        """
        rows, gravity = np.empty((len(recent) + 1, 7)), np.empty(1)
        self.moved(recent, nav, drv, errors, rows, gravity)
        return rows, float(gravity[0])

    def at_rest(self, state: NavState, drv: Array) -> Array:
        """What it would read if the vehicle kept still in this state; shape (6,), or (3,) for an attitude alone."""
        raise NotImplementedError

    def felt(self, drv: Array, span_s: float) -> tuple[Array, Array] | None:
        """Mean and scatter of the samples since this was last asked; None before there are as many as that span has."""
        n = drv[strapdown.COUNT]
        if n < max(2, round(self.rate_hz * span_s)):
            return None
        mean = drv[strapdown.SUMS : strapdown.SUMS + 6] / n
        scatter = np.sqrt(np.maximum(drv[strapdown.SQUARES : strapdown.SQUARES + 6] / n - mean**2, 0.0))
        per = self.period_s if drv[strapdown.INCREMENTS] else 1.0
        drv[strapdown.COUNT : strapdown.SQUARES + 6] = 0.0
        return mean / per, scatter / per

    def body_rate(self, drv: Array, errors: Array) -> Array | float:
        """Angular rate in b [rad/s] for lever arms, the Earth's own (1e-4 rad/s) left in; 0 where it is not known.

        Parameters
        ----------
        drv : ndarray
            Memory of the drive's kernels.
        errors : ndarray, shape (3,)
            Those of its first three values now.
        """
        return 0.0

    def rate_variance(self, Q: Array, C: Array, white: Array) -> Array:
        """White variance of its angular rate, shape (3,) [rad^2/s^2].

        Parameters
        ----------
        Q, C, white : ndarray
            What its error states gather in a sample, the rows (6, k) by which they make its errors, and the white
            variances of its six values.
        """
        return np.zeros(3)

    # ---------------------------------------------------------------- what files and checks ask
    def samples(self, streams: Mapping[str, Stream]) -> tuple[Array, Array]:
        """Samples from its streams: times (n,) and six values (n, 6).

        Raises
        ------
        ValueError
            Where a stream holds too little.
        """
        raise NotImplementedError

    @property
    def words(self) -> str:
        """What drives, and at what rate."""
        raise NotImplementedError

    def stream_columns(self) -> dict[str, tuple[str, ...]]:
        """Names of the columns of each of its streams."""
        raise NotImplementedError

    def described(self) -> tuple[Triple, ...]:
        """The errors as they are given."""
        raise NotImplementedError

    def doubts(self) -> Iterator[Doubt]:
        """Fields whose values were probably not meant so, beside the errors."""
        raise NotImplementedError


RATE = Columns("rate", ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"), ("angular rate",) * 3)
FORCE = Columns("force", ("force_x_m_s2", "force_y_m_s2", "force_z_m_s2"), ("acceleration",) * 3)
ROTATION = Columns("rotation", ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad"), ("angle",) * 3)
VELOCITY_GAIN = Columns(
    "velocity_gain", ("velocity_gain_x_m_s", "velocity_gain_y_m_s", "velocity_gain_z_m_s"), ("speed",) * 3
)
#: Generous: beyond the worst and the best of instruments on the market.
GYRO_USUAL = Plausible(1e-8, 0.09, "deg_per_h", 6e-3, "deg_per_sqrt_h")  # 5 deg/s; 20 deg/sqrt(h)
ACCEL_USUAL = Plausible(1e-7, 0.5, "mg", 0.05, "mg_per_sqrt_hz")  # 50 mg; 5 mg/sqrt(Hz)
GYRO_PRIOR: Sum = White(density=1e-4) + RandomWalk(density=1e-6)
#: Which axis reads how much of which other one; the accelerometers' axes are the body's, as far as three can be.
CROSSED = {"gyro": ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)), "accel": ((1, 0), (2, 0), (2, 1))}
ACCEL_PRIOR: Sum = White(density=1e-3) + RandomWalk(density=1e-5)


@dataclass(frozen=True, kw_only=True)
class Imu(Mechanisation):
    """Strapdown inertial navigation on WGS-84, driven by three gyros and three accelerometers.

    Parameters
    ----------
    rate_hz : float
        Sampling rate [Hz].
    gyro, accel : ErrorModel or tuple of three
        Errors of the angular rate [rad/s] and of the specific force [m/s^2]. A `LearnedArma` is learnt while the
        vehicle stands still (`navfilter.learning.static_recorder.RestRecorder`), beside a bias: a `RandomWalk`, that of
        the default where none is given.
    gyro_scale_sd, accel_scale_sd : float or (3,) float
        Standard deviation of an unknown scale error of each axis; 0: no such states.
    gyro_scale_tau_s, accel_scale_tau_s : float, optional
        Correlation time of these scale errors, first-order Gauss-Markov processes [s]; default: they are constant.
    gyro_misalignment_sd_rad, accel_misalignment_sd_rad : float
        Standard deviation of each unknown small angle between axes [rad]; 0: no such states. Six of the gyros; three of
        the accelerometers, whose first axis, and the plane of the first two, are the body's.
    increments : bool
        Samples are angle and velocity increments [rad], [m/s] instead of rates.
    gap_rate_sd, gap_force_sd : float
        What the vehicle may do unseen while samples are missing for more than three periods: rate [rad/s] and force
        [m/s^2].
    max_rate, max_force : float
        A sample beyond them is a defect of the recording, not a motion [rad/s], [m/s^2].

    Notes
    -----
    Mission stream "imu": rate_b (3), then force_b (3); at rest and level the specific force is (0, 0, -9.8).
    ``true = reading - M reading - error``, with the scales on the diagonal of M (Groves, 2013, eqs 4.15-4.18, solved
    for what is true).
    """

    gyro: ErrorModel | tuple[ErrorModel, ...] = GYRO_PRIOR
    accel: ErrorModel | tuple[ErrorModel, ...] = ACCEL_PRIOR
    gyro_scale_sd: float | Vector = 0.0
    gyro_misalignment_sd_rad: float = 0.0
    accel_scale_sd: float | Vector = 0.0
    gyro_scale_tau_s: float | None = None
    accel_scale_tau_s: float | None = None
    accel_misalignment_sd_rad: float = 0.0
    increments: bool = False
    gap_rate_sd: float = 0.2
    gap_force_sd: float = 0.3
    max_rate: float = 50.0
    max_force: float = 1000.0

    streams: ClassVar[tuple[str, ...]] = ("imu",)
    triples: ClassVar[tuple[str, str]] = ("gyro", "accel")
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((RATE, FORCE), (ROTATION, VELOCITY_GAIN))
    beside: ClassVar[tuple[Columns, ...]] = (TEMPERATURE,)
    inertial: ClassVar[bool] = True
    gravity: ClassVar[float] = ROUND_GRAVITY
    axis_names: ClassVar[tuple[str, ...]] = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    units: ClassVar[tuple[str, ...]] = ("rad_s",) * 3 + ("m_s2",) * 3
    steps: ClassVar[Callable[..., None]] = staticmethod(strapdown.imu_steps)
    hold: ClassVar[Callable[..., None]] = staticmethod(strapdown.imu_hold)
    moved: ClassVar[Callable[..., None]] = staticmethod(delayed_state.inertial_motion)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.triples:
            checked_sds(f"Imu.{name}_scale_sd", getattr(self, f"{name}_scale_sd"))
            check_numbers(self, f"{name}_scale_tau_s", zero_ok=False)
            check_numbers(self, f"{name}_misalignment_sd_rad")

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Gyro x, y, z, accelerometer x, y, z."""
        gyro, accel = per_axis(self.gyro, 3, "Imu.gyro"), per_axis(self.accel, 3, "Imu.accel")
        return _with_bias(gyro, GYRO_PRIOR) + _with_bias(accel, ACCEL_PRIOR)

    def _elements(self) -> Iterator[tuple[int, int, Parameter]]:
        """The elements of M that are states: channel, axis, and what is known of them."""
        for first, name in zip((0, 3), self.triples, strict=True):
            scales, angles = self.draws(name).values()
            if any(p.sd for p in scales):
                for i, p in enumerate(scales):
                    yield first + i, i, p
            if any(p.sd for p in angles):
                for (i, j), p in zip(CROSSED[name], angles, strict=True):
                    yield first + i, j, p

    def parameters(self) -> tuple[Parameter, ...]:
        """Scale and misalignment of gyros and accelerometers."""
        return tuple(parameter for _, _, parameter in self._elements())

    def wandering(self) -> dict[str, ErrorModel]:
        """Scales that have a correlation time."""
        found: dict[str, ErrorModel] = {}
        for name in self.triples:
            tau_s, scales = getattr(self, f"{name}_scale_tau_s"), self.draws(name)["scales"]
            if tau_s is not None and any(p.sd for p in scales):
                found |= {p.name: GaussMarkov(sd=p.sd, tau_s=tau_s) for p in scales}
        return found

    def draws(self, triple: str) -> dict[str, tuple[Parameter, ...]]:
        """Scale of each axis, and angles between the axes."""
        scales = checked_sds("scale_sd", getattr(self, f"{triple}_scale_sd"))
        angle = getattr(self, f"{triple}_misalignment_sd_rad")
        return {
            "scales": tuple(Parameter(f"{triple}.scale_{'xyz'[i]}", scales[i % len(scales)], "1") for i in range(3)),
            "axes": tuple(
                Parameter(f"{triple}.misalignment_{'xyz'[i]}{'xyz'[j]}", angle, "rad") for i, j in CROSSED[triple]
            ),
        }

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """Angle random walk, then the walk of the gyro's bias."""
        # the gyro's bias is no one's guess: how large it can be is part of the gyro's model
        white, walks, start = (part[:3] for part in self.noise)
        bias = max(math.hypot(sd, w * 60.0) for sd, w in zip(start, walks, strict=True))
        return Drift((math.hypot(max(white), walk), max(walks)), period_s, (math.inf, bias) if bias > 0.0 else ())

    def velocity_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """Velocity random walk, then the tilt, which wanders with the gyros (Groves, 2013, sec. 14.2)."""
        density = math.hypot(max(self.noise.white[3:]), walk), self._force_walk(vertical)
        return Drift(density, period_s, most_turned=_most_turned(density) if vertical else math.inf)

    def position_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """The integral of the velocity's."""
        density = walk, max(self.noise.white[3:]), self._force_walk(vertical)
        return Drift(density, period_s, most_turned=_most_turned(density[1:]) if vertical else math.inf)

    def _force_walk(self, vertical: bool) -> float:
        """How the error of a force wanders [m/s^2/s/sqrt(Hz)]: by the bias of the accelerometer, or by the tilt."""
        return max(max(self.noise.walk[3:]), 1e-7) if vertical else self.gravity * max(self.noise.white[:3])

    def limits(self) -> Array:
        """Rates and forces, or what they gather in one period."""
        return np.repeat([self.max_rate, self.max_force], 3) * (self.period_s if self.increments else 1.0)

    def memory(self, first_parameter: int, start: Start | None = None) -> Array:
        """The kernels' ``drv`` at the start."""
        drv = super().memory(first_parameter, start)
        drv[strapdown.INCREMENTS] = float(self.increments)
        drv[strapdown.GAP_RATE_SD] = self.gap_rate_sd
        drv[strapdown.GAP_FORCE_SD] = self.gap_force_sd
        codes = [3 * channel + axis for channel, axis, _ in self._elements()]
        drv[strapdown.CALIBRATED], drv[strapdown.ELEMENTS : strapdown.ELEMENTS + len(codes)] = len(codes), codes
        return drv

    def at_rest(self, state: NavState, drv: Array) -> Array:
        """No rate, and the force that carries it."""
        force = -state.C_nb[2] * strapdown.gravity(state.latitude, state.height)
        return np.concatenate([np.zeros(3), force]) * (self.period_s if self.increments else 1.0)

    def body_rate(self, drv: Array, errors: Array) -> Array | float:
        """That of the last sample."""
        rate: Array = drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 3] / (self.period_s if self.increments else 1.0)
        return rate - errors

    def rate_variance(self, Q: Array, C: Array, white: Array) -> Array:
        """That of the gyros, until the watch over them says otherwise."""
        return white[:3]

    def samples(self, streams: Mapping[str, Stream]) -> tuple[Array, Array]:
        """The stream as it is."""
        return streams["imu"].time_s, streams["imu"].value[:, :6]

    @property
    def words(self) -> str:
        """What drives."""
        what = "angle and velocity increments" if self.increments else "rates and forces"
        return f"inertial unit at {self.rate_hz:g} Hz, {what}"

    def stream_columns(self) -> dict[str, tuple[str, ...]]:
        """Rates and forces, or increments."""
        return {"imu": tuple(name for columns in self.contents[self.increments] for name in columns.names)}

    def described(self) -> tuple[Triple, ...]:
        """Gyros and accelerometers."""
        return Triple("gyro", self.gyro, slice(0, 3), GYRO_USUAL), Triple("accel", self.accel, slice(3, 6), ACCEL_USUAL)

    def doubts(self) -> Iterator[Doubt]:
        """Of the rate."""
        if not 10.0 <= self.rate_hz < 1000.0:
            cure = "It is in Hz: the samples per second of the stream."
            cure += " Below 10 Hz turns are lost; average what is faster than 1 kHz."
            yield Doubt("rate_hz", f"an inertial unit at {self.rate_hz:g} Hz is unusual.", cure)
        for name in self.triples:
            scale, angle = (max(p.sd for p in constants) for constants in self.draws(name).values())
            if scale > 0.1:
                text = f"a scale error of {100.0 * scale:.4g} % is unusual."
                yield Doubt(f"{name}_scale_sd", text, "It is a pure number: 1 % is 0.01.")
            if angle > math.radians(5.0):
                yield angle_doubt(f"{name}_misalignment_sd_rad", angle)


def _with_bias(models: Sequence[ErrorModel], default: Sum) -> tuple[ErrorModel, ...]:
    """Models of inertial axes with the bias of a prior beside their learnt part, where it stays whatever is learnt.

    A learnt part without a prior gets what `default` has and nothing beside it stands for.
    """
    resolved = []
    for model in models:
        learned = learned_part(model)
        if learned is not None and learned.model is None:
            beside = [part for part in model.terms if part is not learned]
            if learned.prior is None:
                given = [part for part in default.parts if not any(isinstance(part, type(other)) for other in beside)]
            else:
                given = list(learned.prior.terms)
            walks = [part for part in given if isinstance(part, RandomWalk)]
            rest = [part for part in given if not isinstance(part, RandomWalk)] or [White(sd=0.0)]
            model = sum_of([*beside, *walks, replace(learned, prior=sum_of(rest))])
        resolved.append(model)
    return tuple(resolved)


def _most_turned(density: tuple[float, float]) -> float:
    """Force that stands out of a drift of velocity with these densities within the time it takes to be found."""
    return math.hypot(density[0] / math.sqrt(FOUND_S), density[1] * math.sqrt(FOUND_S))


#: Where the kernels look for states that a drive may have, and the first of each.
FIRST_PARAMETERS = {
    strapdown.DEVIATION: "yaw.one_cycle_sin",
    strapdown.SCALE: "velocity.scale",
    strapdown.ARM: "velocity.lever_arm_x",
    strapdown.CURRENT: "velocity.current_north",
    strapdown.VELOCITY_CLOCK: "velocity.time_offset",
    strapdown.ATTITUDE_CLOCK: "attitude.time_offset",
}
#: An attitude or a velocity that has not been read for longer is silent [s], and for so many periods: bottom lock comes
#: and goes.
SILENT_S, SILENT_PERIODS = 2.0, 3.0
#: Generous: beyond the worst and the best of instruments on the market.
TILT_USUAL = Plausible(1e-7, math.radians(15.0), "deg", most_rate_hz=1000.0)


@dataclass(frozen=True, kw_only=True)
class DeadReckoning(Mechanisation):
    """Dead reckoning by attitude and body velocity, without an inertial unit: their errors enter the propagation.

    Parameters
    ----------
    rate_hz : float
        Rate of the velocity readings [Hz].
    attitude : Heading, ErrorModel or tuple of three
        A `Heading` gives the error of the yaw (with bias and deviation states) and `tilt` that of roll and pitch; an
        error model, or a tuple
        for roll, pitch and yaw, gives them directly [rad].
    velocity : BodyVelocity, WaterVelocity, ErrorModel or tuple of three
        A `BodyVelocity` brings its lever arm, mounting, scale and misalignment states, a `WaterVelocity` (a log) those
        of the current too: two states that fixes tell and that carry the position until the next; an error model stands
        for a plain velocity over ground [m/s]. Leeway is an error of the second axis, such as a `GaussMarkov`.
    tilt : ErrorModel
        Error of roll and pitch when `attitude` is a `Heading` [rad].
    hold_density : float
        How fast the true body velocity may wander while readings are missing [m/s/sqrt(s)].

    Notes
    -----
    Mission streams "attitude" (roll, pitch, yaw [rad]) and "velocity" (instrument axes [m/s]; NaN: lost).
    """

    attitude: Heading | ErrorModel | tuple[ErrorModel, ...] = White(sd=0.01)
    velocity: BodyVelocity | WaterVelocity | ErrorModel | tuple[ErrorModel, ...] = White(sd=0.02)
    tilt: ErrorModel = White(sd=0.005)
    hold_density: float = 0.05

    streams: ClassVar[tuple[str, ...]] = ("attitude", "velocity")
    triples: ClassVar[tuple[str, str]] = ("attitude", "velocity")
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((ATTITUDE,), (VELOCITY,))
    axis_names: ClassVar[tuple[str, ...]] = ("roll", "pitch", "yaw", "velocity_x", "velocity_y", "velocity_z")
    units: ClassVar[tuple[str, ...]] = ("rad",) * 3 + ("m_s",) * 3
    steps: ClassVar[Callable[..., None]] = staticmethod(strapdown.dead_reckoning_steps)
    hold: ClassVar[Callable[..., None]] = staticmethod(strapdown.dead_reckoning_hold)
    moved: ClassVar[Callable[..., None]] = staticmethod(delayed_state.dead_reckoning_motion)

    def __post_init__(self) -> None:
        FrozenDescription.__post_init__(self)  # what follows asks for its parts, before their models are asked for
        if self.compass is not None and self.compass.gives != "heading":
            raise ValueError(
                f"DeadReckoning.attitude must be a Heading or error models, found a {type(self.attitude).__name__}."
            )
        if self.compass is not None and self.compass.magnetometer:
            raise ValueError(
                "DeadReckoning.attitude must give a heading, found a magnetometer: dead reckoning has no attitude of "
                "its own to level it with. Use the compass's heading output."
            )
        if self.compass is not None and {"bias", "temperature"} & {name for name, *_ in self.compass.calibrated}:
            raise ValueError(
                "DeadReckoning.attitude: bias and temperature drift of its compass cannot be calibrated here; of its "
                "constants only the deviation can. A bias turns the track as a mounting of the velocity does."
            )
        sensor = self.velocity_sensor
        if sensor.gives != "velocity" and not ("current_north" in sensor.wandering() and sensor.axes == 3):
            raise ValueError(
                "DeadReckoning.velocity must be a BodyVelocity, a WaterVelocity or error models, found a "
                f"{type(self.velocity).__name__}."
            )
        super().__post_init__()

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Roll, pitch, yaw, velocity x, y, z."""
        if self.compass is not None:
            yaw = self.compass.models[0]
            if self.compass.constant_sd_rad:
                yaw = yaw + RandomWalk(density=0.0, start_sd=self.compass.constant_sd_rad)
            attitude: tuple[ErrorModel, ...] = (self.tilt, self.tilt, yaw)
        else:
            attitude = per_axis(self.attitude, 3, "DeadReckoning.attitude")  # type: ignore[arg-type]
        return attitude + self.velocity_sensor.models

    @property
    def compass(self) -> Heading | None:
        """The `Heading`, where `attitude` is one."""
        return self.attitude if isinstance(self.attitude, Sensor) else None

    @property
    def velocity_sensor(self) -> BodyVelocity:
        """The velocity as a sensor (a plain one where only an error model was given)."""
        if isinstance(self.velocity, Sensor):
            return self.velocity
        return BodyVelocity(rate_hz=self.rate_hz, error=self.velocity, zero_is_invalid=False)

    @property
    def late_s(self) -> tuple[float, float]:
        """How late the stamps of attitude and velocity are, as described [s]."""
        return (self.compass.time_offset_s if self.compass else 0.0), self.velocity_sensor.time_offset_s

    def at(self, start: Start) -> "DeadReckoning":
        """With what the declination of its compass errs by at this place."""
        if self.compass is None or (there := self.compass.at(start)) is self.compass:
            return self
        return replace(self, attitude=there)

    def _deviation(self) -> tuple[Parameter, ...]:
        if self.compass is None or not any(self.compass.deviation_sd_rad):
            return ()
        names = ("one_cycle_sin", "one_cycle_cos", "two_cycle_sin", "two_cycle_cos")
        found = {p.name: p for p in self.compass.all_parameters()}
        return tuple(found[name]._replace(name=f"yaw.{name}") for name in names)

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """There is no heading but that of the drive's own compass: only the sensor's walk is known."""
        return Drift((max(walk, 1e-9), 1e-12), period_s)

    def velocity_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """As that of a position: the velocity of the drive is what is compared."""
        return self.position_drift(walk, period_s, vertical=vertical)

    def position_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """The noise of the velocity, then a slow change of it."""
        return Drift((math.hypot(max(self.noise.white[3:6]), walk), 1e-3), period_s)

    def limits(self) -> Array:
        """Angles, which may have been unwrapped over many turns; a velocity may be missing."""
        return np.full(3, 1e6)

    def parameters(self) -> tuple[Parameter, ...]:
        """Deviation of the heading, scale and misalignment of the velocity; its lever arm, and the clocks of both."""
        velocity = (p._replace(name=f"velocity.{p.name}") for p in self.velocity_sensor.all_parameters())
        return (*self._deviation(), *velocity, *self._attitude_clock())

    def wandering(self) -> dict[str, ErrorModel]:
        """The current, where the velocity is that through the water."""
        return {f"velocity.{name}": model for name, model in self.velocity_sensor.wandering().items()}

    def _spread(self) -> Array:
        """Standard deviations of what the six readings err by, a constant bias of the heading left out."""
        yaw = self.compass.models[0] if self.compass else self.models[2]
        models = (*self.models[:2], yaw, *self.models[3:])
        blocks = [model.block(self.period_s) for model in models]
        return np.sqrt([block.variance for block in blocks])

    def _attitude_clock(self) -> tuple[Parameter, ...]:
        sd = self.compass.time_offset_sd_s if self.compass else 0.0
        return (Parameter("attitude.time_offset", sd, "s"),) if sd else ()

    def memory(self, first_parameter: int, start: Start | None = None) -> Array:
        """The kernels' ``drv`` at the start."""
        drv = super().memory(first_parameter, start)
        drv[strapdown.HOLD_DENSITY] = self.hold_density
        drv[strapdown.GOOD_S] = -1.0
        drv[strapdown.TURN_USUAL], drv[strapdown.SPEED_USUAL] = strapdown.TURN_BEGUN**2, strapdown.SPEED_BEGUN**2
        names = [p.name for p in self.parameters()]
        for place, name in FIRST_PARAMETERS.items():
            drv[place] = first_parameter + names.index(name) if name in names else -1
        if "velocity.scale_x" in names:
            drv[strapdown.SCALE], drv[strapdown.SCALE_STEP] = first_parameter + names.index("velocity.scale_x"), 1.0
        sensor = self.velocity_sensor
        drv[strapdown.LEVER : strapdown.LEVER + 12] = sensor.constants(start)[:12]  # type: ignore[arg-type]  # the same for any start
        if start is not None:
            drv[strapdown.DECLINATION] = self.declination(start)
        drv[strapdown.SPREAD : strapdown.SPREAD + 6] = self._spread()
        drv[strapdown.MAX_SPEED] = sensor.max_speed_m_s
        drv[strapdown.ZERO_IS_VALID] = float(not sensor.zero_is_invalid)
        return drv

    def conditions(self, drv: Array) -> dict[str, str]:
        """Of attitude and velocity: "good", "silent", "stuck", "erratic" or "jumped"."""
        most_s = max(SILENT_S, SILENT_PERIODS * self.period_s)
        stuck_s = max(strapdown.STUCK_S, strapdown.STUCK_PERIODS * self.period_s)
        places = (
            (strapdown.SAME_ATTITUDE_S, strapdown.BLIND_S, strapdown.ODD_HEADING, strapdown.AWAY),
            (strapdown.SAME_VELOCITY_S, strapdown.LOST_S, strapdown.ODD_VELOCITY, strapdown.AWAY + 1),
        )
        result = {}
        for name, place in zip(self.streams, places, strict=True):
            same_s, lost_s, odd, away = drv[list(place)]
            found = {"stuck": same_s > stuck_s, "silent": lost_s > most_s, "erratic": odd > 0.0, "jumped": away > 0.0}
            found["good"] = True
            result[name] = next(word for word, holds in found.items() if holds)
        return result

    def body_rate(self, drv: Array, errors: Array) -> Array | float:
        """That of the turn from the last attitude to this one; slow errors of both are the same."""
        rate: Array = drv[strapdown.RATE : strapdown.RATE + 3]
        return rate

    def rate_variance(self, Q: Array, C: Array, white: Array) -> Array:
        """Of the difference of two attitudes: their white noise, and what their slow errors wander by."""
        k = C.shape[1]  # behind them stand constants
        wander: Array = np.einsum("ij,jk,ik->i", C[:3], Q[:k, :k], C[:3])
        return (2.0 * white[:3] + wander) / self.period_s**2

    def at_rest(self, state: NavState, drv: Array) -> Array:
        """Its attitude, by the compass as it is."""
        return state.roll_pitch_heading - np.array([0.0, 0.0, drv[strapdown.DECLINATION]])

    def samples(self, streams: Mapping[str, Stream]) -> tuple[Array, Array]:
        """Attitude, interpolated to the times of the velocity, and velocity."""
        attitude, velocity = (
            streams[name].later(-late_s) for name, late_s in zip(self.streams, self.late_s, strict=True)
        )
        good = np.isfinite(attitude.value[:, :3]).all(axis=1)
        if good.sum() < 2:
            raise ValueError('stream "attitude" has fewer than two valid readings.')
        t, angles = attitude.time_s[good], np.unwrap(attitude.value[good, :3], axis=0)
        inside = (velocity.time_s >= t[0] - self.period_s) & (velocity.time_s <= t[-1] + self.period_s)
        times = velocity.time_s[inside]
        return times, np.column_stack(
            [*(np.interp(times, t, angles[:, i]) for i in range(3)), velocity.value[inside, :3]]
        )

    @property
    def words(self) -> str:
        """What drives."""
        return f"dead reckoning by attitude and body velocity at {self.rate_hz:g} Hz"

    def stream_columns(self) -> dict[str, tuple[str, ...]]:
        """Attitude and velocity."""
        return {"attitude": ATTITUDE.names, "velocity": VELOCITY.names}

    def described(self) -> tuple[Triple, ...]:
        """Heading and tilt, or attitude; velocity."""
        if self.compass is not None:
            attitude: tuple[Triple, ...] = (
                Triple("attitude.error", self.compass.error, slice(2, 3), HEADING_USUAL),
                Triple("tilt", self.tilt, slice(0, 1), TILT_USUAL),
            )
        else:
            attitude = (Triple("attitude", self.attitude, slice(0, 3), HEADING_USUAL),)  # type: ignore[arg-type]
        place = "velocity.error" if isinstance(self.velocity, Sensor) else "velocity"
        return (*attitude, Triple(place, self.velocity_sensor.error, slice(3, 6), VELOCITY_USUAL))

    def doubts(self) -> Iterator[Doubt]:
        """Of the rate, and of the sensors it is made of."""
        if not 0.1 <= self.rate_hz <= 100.0:
            cure = "It is in Hz: the velocity readings per second."
            yield Doubt("rate_hz", f"dead reckoning at {self.rate_hz:g} Hz is unusual.", cure)
        if self.compass is not None:
            yield from (doubt._replace(field=f"attitude.{doubt.field}") for doubt in self.compass.doubts())
            if self.compass.temperature_sd_rad_per_k:
                text = "dead reckoning estimates no drift with temperature."
                yield Doubt("attitude.temperature_sd_rad_per_k", text, "Leave it out.")
        yield from (doubt._replace(field=f"velocity.{doubt.field}") for doubt in self.velocity_sensor.doubts())
        for part in self.described():
            models = part.given if isinstance(part.given, tuple) else (part.given,)
            if any(learning_part(model) is not None for model in models):
                text = "the errors of what drives are never learnt: nothing measures them by themselves."
                cure = "Give it a fixed model, such as the prior; only its prior is in force now."
                yield Doubt(part.place, text, cure)


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

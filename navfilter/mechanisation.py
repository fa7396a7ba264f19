"""What drives the state between corrections: an inertial unit, or attitude and body velocity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel, RandomWalk, Sum, White, per_axis
from navfilter.kernels import strapdown
from navfilter.learning.drift import Drift
from navfilter.learning.learned import learned_part
from navfilter.sensors import BodyVelocity, Heading, WaterVelocity
from navfilter.start import Start

__all__ = ["DeadReckoning", "DriveNoise", "Imu", "Mechanisation"]

Array = NDArray[np.float64]
GYRO_PRIOR: Sum = White(density=1e-4) + RandomWalk(density=1e-6)
ACCEL_PRIOR: Sum = White(density=1e-3) + RandomWalk(density=1e-5)


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
    def of(cls, models: Sequence[ErrorModel], period_s: float) -> DriveNoise:
        """That of these axes."""
        each = [model.integrated(period_s) for model in models]
        return cls(
            tuple(math.sqrt(e.white * period_s) for e in each),
            tuple(math.sqrt(max(e.walk, 0.0) / period_s) for e in each),
            tuple(math.sqrt(e.start) for e in each),
        )


@dataclass(frozen=True, kw_only=True)
class Mechanisation:
    """What both drives share: six channels whose errors enter the propagation.

    Attributes
    ----------
    streams : tuple of str
        Of the mission, in the order of the six values of a sample.
    axis_names, units : tuple of str
        Of the six channels.
    inertial : bool
        The channels are three rates and three forces: what the vehicle does between two samples is felt, rest can be told.
    gravity : float
        What a tilt turns into acceleration [m/s^2]; 0 where the velocity is no integral.
    """

    rate_hz: float

    streams: ClassVar[tuple[str, ...]] = ()
    inertial: ClassVar[bool] = False
    gravity: ClassVar[float] = 0.0
    axis_names: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()
    steps: ClassVar[Callable[..., None]]
    hold: ClassVar[Callable[..., None]]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ValueError(f"{type(self).__name__}.rate_hz must be a finite number > 0, found {self.rate_hz!r}.")
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

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """Constant states of the drive: name and standard deviation at the start."""
        return ()

    def limits(self) -> Array:
        """Largest magnitude of the values of a sample that must be there; beyond it the sample is a defect."""
        raise NotImplementedError

    def memory(self, first_parameter: int, start: Start | None = None) -> Array:
        """The kernels' ``drv`` at the start; `first_parameter` counts the drive's states before its parameters."""
        drv = np.zeros(strapdown.DRIVE_SIZE)
        drv[strapdown.PERIOD_S] = self.period_s
        return drv


@dataclass(frozen=True, kw_only=True)
class Imu(Mechanisation):
    """Strapdown inertial navigation on WGS-84, driven by three gyros and three accelerometers.

    Parameters
    ----------
    rate_hz : float
        Sampling rate [Hz].
    gyro, accel : ErrorModel or tuple of three
        Errors of the angular rate [rad/s] and of the specific force [m/s^2]. A `LearnedArma` is learnt while the vehicle stands still
        (`navfilter.learning.rest.Stillness`), beside a bias: a `RandomWalk`, that of the default where none is given.
    increments : bool
        Samples are angle and velocity increments [rad], [m/s] instead of rates.
    gap_rate_sd, gap_force_sd : float
        What the vehicle may do unseen while samples are missing for more than three periods: rate [rad/s] and force [m/s^2].
    max_rate, max_force : float
        A sample beyond them is a defect of the recording, not a motion [rad/s], [m/s^2].

    Notes
    -----
    Mission stream "imu": rate_b (3), then force_b (3); at rest and level the specific force is (0, 0, -9.8).
    """

    gyro: ErrorModel | tuple[ErrorModel, ...] = GYRO_PRIOR
    accel: ErrorModel | tuple[ErrorModel, ...] = ACCEL_PRIOR
    increments: bool = False
    gap_rate_sd: float = 0.2
    gap_force_sd: float = 0.3
    max_rate: float = 50.0
    max_force: float = 1000.0

    streams: ClassVar[tuple[str, ...]] = ("imu",)
    inertial: ClassVar[bool] = True
    gravity: ClassVar[float] = 9.81
    axis_names: ClassVar[tuple[str, ...]] = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    units: ClassVar[tuple[str, ...]] = ("rad_s",) * 3 + ("m_s2",) * 3
    steps: ClassVar[Callable[..., None]] = staticmethod(strapdown.imu_steps)
    hold: ClassVar[Callable[..., None]] = staticmethod(strapdown.imu_hold)

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Gyro x, y, z, accelerometer x, y, z."""
        gyro, accel = per_axis(self.gyro, 3, "Imu.gyro"), per_axis(self.accel, 3, "Imu.accel")
        return _with_bias(gyro, GYRO_PRIOR) + _with_bias(accel, ACCEL_PRIOR)

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """Angle random walk, then the walk of the gyro's bias."""
        # the gyro's bias is no one's guess: how large it can be is part of the gyro's model
        white, walks, start = (part[:3] for part in self.noise)
        bias = max(math.hypot(sd, w * 60.0) for sd, w in zip(start, walks, strict=True))
        return Drift((math.hypot(max(white), walk), max(walks)), period_s, (math.inf, bias) if bias > 0.0 else ())

    def velocity_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """Velocity random walk, then what turns the force: the tilt, which wanders with the gyros (Groves, 2013, sec. 14.2)."""
        return Drift((math.hypot(max(self.noise.white[3:]), walk), self._force_walk(vertical)), period_s)

    def position_drift(self, walk: float, period_s: float, *, vertical: bool = False) -> Drift:
        """The integral of the velocity's."""
        return Drift((walk, max(self.noise.white[3:]), self._force_walk(vertical)), period_s)

    def _force_walk(self, vertical: bool) -> float:
        """How the error of the force along an axis wanders [m/s^2/s/sqrt(Hz)]: by the bias of the accelerometer, or by the tilt."""
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
        return drv


def _with_bias(models: Sequence[ErrorModel], default: Sum) -> tuple[ErrorModel, ...]:
    """Models of inertial axes with the bias of a prior beside their learnt part, where it stays whatever is learnt.

    A learnt part without a prior gets what `default` has and nothing beside it stands for.
    """
    resolved = []
    for model in models:
        learned = learned_part(model)
        if learned is not None and learned.model is None:
            beside = [part for part in (model.parts if isinstance(model, Sum) else (model,)) if part is not learned]
            if learned.prior is None:
                given = [part for part in default.parts if not any(isinstance(part, type(other)) for other in beside)]
            else:
                given = list(learned.prior.parts) if isinstance(learned.prior, Sum) else [learned.prior]
            walks = [part for part in given if isinstance(part, RandomWalk)]
            rest = [part for part in given if not isinstance(part, RandomWalk)] or [White(sd=0.0)]
            prior = rest[0] if len(rest) == 1 else Sum(tuple(rest))
            model = Sum((*beside, *walks, replace(learned, prior=prior))) if beside or walks else replace(learned, prior=prior)
        resolved.append(model)
    return tuple(resolved)


@dataclass(frozen=True, kw_only=True)
class DeadReckoning(Mechanisation):
    """Dead reckoning by attitude and body velocity, without an inertial unit: their errors enter the propagation.

    Parameters
    ----------
    rate_hz : float
        Rate of the velocity readings [Hz].
    attitude : Heading, ErrorModel or tuple of three
        A `Heading` gives the error of the yaw (with bias and deviation states) and `tilt` that of roll and pitch; an error model, or a
        tuple
        for roll, pitch and yaw, gives them directly [rad].
    velocity : BodyVelocity, ErrorModel or tuple of three
        A `BodyVelocity` brings its lever arm, mounting, scale and misalignment states; an error model stands for a plain one [m/s].
    tilt : ErrorModel
        Error of roll and pitch when `attitude` is a `Heading` [rad].
    hold_density : float
        How fast the true body velocity may wander while readings are missing [m/s/sqrt(s)].

    Notes
    -----
    Mission streams "attitude" (roll, pitch, yaw [rad]) and "velocity" (instrument axes [m/s]; NaN: lost).
    """

    attitude: Heading | ErrorModel | tuple[ErrorModel, ...] = White(sd=0.01)
    velocity: BodyVelocity | ErrorModel | tuple[ErrorModel, ...] = White(sd=0.02)
    tilt: ErrorModel = White(sd=0.005)
    hold_density: float = 0.05

    streams: ClassVar[tuple[str, ...]] = ("attitude", "velocity")
    axis_names: ClassVar[tuple[str, ...]] = ("roll", "pitch", "yaw", "velocity_x", "velocity_y", "velocity_z")
    units: ClassVar[tuple[str, ...]] = ("rad",) * 3 + ("m_s",) * 3
    steps: ClassVar[Callable[..., None]] = staticmethod(strapdown.dead_reckoning_steps)
    hold: ClassVar[Callable[..., None]] = staticmethod(strapdown.dead_reckoning_hold)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.attitude, Heading) and self.attitude.magnetometer:
            raise ValueError(
                "DeadReckoning.attitude must give a heading, found a magnetometer: dead reckoning has no attitude of its own to level it "
                "with. Use the compass's heading output."
            )
        if isinstance(self.velocity, WaterVelocity):
            raise ValueError(
                "DeadReckoning.velocity must be over ground, found a WaterVelocity: dead reckoning has no states for the current. Use a "
                "BodyVelocity whose error says how fast the water may move, such as GaussMarkov(sd=0.3, tau_s=3600)."
            )

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """Roll, pitch, yaw, velocity x, y, z."""
        if isinstance(self.attitude, Heading):
            yaw = self.attitude.models[0]
            if self.attitude.bias_sd_rad:
                yaw = yaw + RandomWalk(density=0.0, start_sd=self.attitude.bias_sd_rad)
            attitude: tuple[ErrorModel, ...] = (self.tilt, self.tilt, yaw)
        else:
            attitude = per_axis(self.attitude, 3, "DeadReckoning.attitude")
        return attitude + self.velocity_sensor.models

    @property
    def velocity_sensor(self) -> BodyVelocity:
        """The velocity as a sensor (a plain one where only an error model was given)."""
        if isinstance(self.velocity, BodyVelocity):
            return self.velocity
        return BodyVelocity(rate_hz=self.rate_hz, error=self.velocity, zero_is_invalid=False)

    def _deviation(self) -> tuple[tuple[str, float], ...]:
        if not isinstance(self.attitude, Heading) or not any(self.attitude.deviation_sd_rad):
            return ()
        names = ("one_cycle_sin", "one_cycle_cos", "two_cycle_sin", "two_cycle_cos")
        one, two = self.attitude.deviation_sd_rad
        return tuple((f"yaw.{name}", sd) for name, sd in zip(names, (one, one, two, two), strict=True))

    def heading_drift(self, walk: float, period_s: float) -> Drift:
        """There is no heading but that of the drive's own compass: what is known wanders with the sensor's walk alone."""
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

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """Deviation of the heading, scale and misalignment of the velocity."""
        velocity = tuple((f"velocity.{name}", sd) for name, sd in self.velocity_sensor.parameters())
        return self._deviation() + velocity

    def memory(self, first_parameter: int, start: Start | None = None) -> Array:
        """The kernels' ``drv`` at the start."""
        drv = super().memory(first_parameter, start)
        deviation, total = len(self._deviation()), len(self.parameters())
        drv[strapdown.HOLD_DENSITY] = self.hold_density
        drv[strapdown.DEVIATION] = first_parameter if deviation else -1
        drv[strapdown.SCALE] = first_parameter + deviation if total > deviation else -1
        sensor: Any = self.velocity_sensor
        drv[strapdown.LEVER : strapdown.LEVER + 12] = sensor.constants(None)
        if isinstance(self.attitude, Heading) and start is not None:
            drv[strapdown.DECLINATION] = self.attitude.declination(start)
        drv[strapdown.MAX_SPEED] = sensor.max_speed_m_s
        drv[strapdown.ZERO_IS_VALID] = float(not sensor.zero_is_invalid)
        return drv

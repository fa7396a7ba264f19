"""An inertial unit as what drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.kernels import delayed_state, strapdown
from navfilter.models.error_models import (
    ErrorModel,
    GaussMarkov,
    RandomWalk,
    Sum,
    White,
    check_numbers,
    per_axis,
    sum_of,
)
from navfilter.models.learned_arma import learned_part
from navfilter.models.mechanisation.mechanisation import Mechanisation, Triple
from navfilter.models.mission import Stream
from navfilter.models.navigation_drift import FOUND_S, Drift
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.heading import TEMPERATURE
from navfilter.models.sensors.sensor import Vector, checked_sds
from navfilter.models.sensors.traits import Columns, Doubt, Plausible, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import NavState

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

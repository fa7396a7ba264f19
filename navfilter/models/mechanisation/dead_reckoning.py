"""Attitude and body velocity as what drives."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.frozen import FrozenDescription
from navfilter.kernels import delayed_state, strapdown
from navfilter.models.error_models import ErrorModel, RandomWalk, White, per_axis
from navfilter.models.learned_arma import learning_part
from navfilter.models.mechanisation.mechanisation import Imu, Mechanisation, Triple
from navfilter.models.mission import Stream
from navfilter.models.navigation_drift import Drift
from navfilter.models.parameters import Parameter
from navfilter.models.sensors import BodyVelocity, Heading, Sensor, WaterVelocity
from navfilter.models.sensors.heading import ATTITUDE
from navfilter.models.sensors.heading import USUAL as HEADING_USUAL
from navfilter.models.sensors.traits import Columns, Doubt, Plausible
from navfilter.models.sensors.velocity import USUAL as VELOCITY_USUAL
from navfilter.models.sensors.velocity import VELOCITY
from navfilter.models.start import Start
from navfilter.models.state import NavState

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
        """Of attitude and velocity: "good", "silent", "stuck" or "erratic"."""
        most_s = max(SILENT_S, SILENT_PERIODS * self.period_s)
        stuck_s = max(strapdown.STUCK_S, strapdown.STUCK_PERIODS * self.period_s)
        places = (
            (strapdown.SAME_ATTITUDE_S, strapdown.BLIND_S, strapdown.ODD_HEADING),
            (strapdown.SAME_VELOCITY_S, strapdown.LOST_S, strapdown.ODD_VELOCITY),
        )
        result = {}
        for name, place in zip(self.streams, places, strict=True):
            same_s, lost_s, odd = drv[list(place)]
            found = {"stuck": same_s > stuck_s, "silent": lost_s > most_s, "erratic": odd > 0.0, "good": True}
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

"""What every drive says of itself: the rest of the program asks it and keeps no list of kinds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.frozen import FrozenDescription
from navfilter.kernels import delayed_state, strapdown
from navfilter.models.error_models import ErrorModel, Errors, check_numbers
from navfilter.models.mission import Stream
from navfilter.models.navigation_drift import Drift
from navfilter.models.parameters import Calibrated, Parameter, check_calibrated, constant_parameters, with_calibrated
from navfilter.models.sensors import BodyVelocity, Heading
from navfilter.models.sensors.traits import Columns, Doubt, Plausible
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
    def of(cls, models: Sequence[ErrorModel], period_s: float) -> DriveNoise:
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

    def at(self, start: Start) -> Mechanisation:
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

"""What every kind of sensor says of itself: the rest of the program asks it and keeps no list of kinds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.error_models import ErrorModel, White, per_axis
from navfilter.kernels import listen
from navfilter.learning.drift import Drift
from navfilter.learning.learned import resolve_prior
from navfilter.start import Start

if TYPE_CHECKING:
    from navfilter.mechanisation import Mechanisation

__all__ = ["Errors", "Sensor", "Vector", "checked_vector"]

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

    Attributes
    ----------
    prior : ErrorModel
        Of a `LearnedArma` that brings none.
    unit, axes, axis_names
        Of the error: unit, number and names of its axes.
    reads : int
        Number of elements of a reading that must be there.
    kernel : callable
        Residual and Jacobian, with the arguments of `navfilter.kernels.measurement`.
    from_drive : bool
        Made from the drive's own samples: there is no stream, and there are no readings.
    sees_velocity : bool
        Reads the velocity in the body's axes, through the heading: taken with its second-order term while the heading is hardly known.
    confirms_state : bool
        Readings that fit say that the state is right, whatever the others read.
    open_loop : int
        How the feedback is taken off again for learning, see `navfilter.kernels.listen`; NOTHING: its error cannot be learnt under way.
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
    from_drive: ClassVar[bool] = False
    sees_velocity: ClassVar[bool] = False
    confirms_state: ClassVar[bool] = True
    open_loop: ClassVar[int] = listen.NOTHING

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

    # ---------------------------------------------------------------- what the filter asks
    def felt(self, mean: Array, scatter: Array) -> Array | None:
        """The reading that the drive's own samples of one period make, for kinds that are `from_drive`; None for none.

        Parameters
        ----------
        mean, scatter : ndarray, shape (6,)
            Mean and standard deviation of rates [rad/s] and forces [m/s^2].
        """
        return None

    @property
    def needs_rate(self) -> bool:
        """Whether the kernel needs the angular rate of the body."""
        return False

    def lever_arm_covariance(self, rate_variance: Array) -> Array:
        """What white noise of the gyros adds to a reading, shape (axes, axes).

        Parameters
        ----------
        rate_variance : ndarray, shape (3,)
            Of the three gyros, as rates [rad^2/s^2].
        """
        return np.zeros((self.axes, self.axes))

    # ---------------------------------------------------------------- what learning asks
    def instrument_axes(self) -> Array:
        """Rotation from the body's axes to the instrument's, shape (3, 3)."""
        return np.eye(3)

    def drift(self, drive: Mechanisation, axis: int, walk: float) -> Drift:
        """How the slow navigation error looks in the open-loop residual of one axis; default: as a horizontal position.

        Parameters
        ----------
        drive : Mechanisation
            Whose errors make it.
        axis : int
        walk : float
            Root PSD of the sensor's own known random walk, which stays beside whatever is learnt [unit/s/sqrt(Hz)].
        """
        return drive.position_drift(walk, 1.0 / self.rate_hz)


def checked_vector(owner: str, value: ArrayLike, size: int = 3) -> tuple[float, ...]:
    """The value as a tuple of `size` finite floats; the error names its `owner`."""
    v = np.asarray(value, dtype=float).ravel()
    if v.shape != (size,) or not np.isfinite(v).all():
        raise ValueError(f"{owner} must be {size} finite numbers, found {value!r}.")
    return tuple(float(c) for c in v)

"""The rate of a vehicle that does not turn."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import measurement, strapdown
from navfilter.models.error_models import Errors, White
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.traits import Doubt, Example, Plausible
from navfilter.models.sensors.velocity import ZeroVelocity
from navfilter.models.start import Start

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
    template: ClassVar[Example | None] = Example(
        "turning",
        "For vehicles that really stand still: what the gyros read then is their error and the Earth's rate. It needs "
        "no stream.",
        1,
        ('error = {model = "white", sd = 1e-5}',),
        live=False,
    )

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

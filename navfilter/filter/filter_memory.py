"""What a filter remembers: one value that holds everything that changes while it runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.filter.imu_intake import ImuIntakeMemory
from navfilter.foundation.arrays import Array
from navfilter.kernels import strapdown
from navfilter.models.error_models import Errors

#: What is counted, beside what the monitor counts.
COUNTED = (
    *("gap", "backward", "bad-sample", "clock-set", "widened", "reset", "jumped", "astray", "opened"),
    *("realigned", "shifted", "adopted", "arm-or-clock"),
)
#: No sd, error or element of a transition is as large, in whatever unit of SI (a lost position: 1e7 m): beyond it
#: rounding alone makes covariances that are none.
LARGEST = 1e12
#: Rounding leaves no eigenvalue of the correlations below this.
INDEFINITE = -1e-6
#: Nor an attitude further from a rotation than this [1].
SKEWED = 1e-3
#: Radii of curvature of the Earth, the height added, differ from its semi-major axis by less [m].
OFF_M = 5e5


@dataclass
class FilterMemory:
    """Everything that changes while a filter runs.

    Attributes
    ----------
    time_s, sample_s : float
        Mission time of the state and of the last sample of the drive [s].
    unfolded : int
        Samples whose transition is not in P yet.
    nav : ndarray, shape (17,)
        Nominal state, see `NavState.pack`.
    x : ndarray, shape (n - 9,)
        Estimated error states behind the nine of navigation.
    P : ndarray, shape (n, n)
        Covariance of all error states, as of the last fold.
    acc : ndarray, shape (4m, m)
        Compound transition and noise of the samples since then.
    drv : ndarray
        Memory of the drive's kernels.
    recent : ndarray, shape (k, 7)
        The last samples of the drive, the newest first: seconds since the one before (0: no sample yet), six values.
        None are kept where the clock of no sensor is in doubt.
    intake : ImuIntakeMemory
    channels : dict of str to ndarray
        See `Channel.noted`.
    models : tuple of (str, error)
        Error models put in force since the start, by sensor.
    counts : dict of str to int
    monitor
        What the monitor remembers, such as `navfilter.faults.memory.MonitorMemory`.
    """

    time_s: float
    sample_s: float
    unfolded: int
    nav: Array
    x: Array
    P: Array
    acc: Array
    drv: Array
    recent: Array
    intake: ImuIntakeMemory
    channels: dict[str, Array]
    models: tuple[tuple[str, Errors], ...]
    counts: dict[str, int]
    monitor: Any = None

    def problem(self, fresh: "FilterMemory") -> str | None:
        """What is wrong with the values of one that came from outside, in words; None when nothing is.

        Parameters
        ----------
        fresh : FilterMemory
            Of the same layout, at the start. Whether the forms agree is the business of
            `navfilter.foundation.state_values.misfit`.
        """
        P = self.P
        if not (np.isfinite(P).all() and np.allclose(P, P.T, rtol=1e-6, atol=0.0) and np.all(np.diag(P) >= 0.0)):
            return "the covariance is not finite, symmetric and positive on its diagonal"
        sd = np.sqrt(np.diag(P))
        sd[sd == 0.0] = 1.0  # a state that is known for certain
        if np.linalg.eigvalsh(P / np.outer(sd, sd)).min() < INDEFINITE:
            return "the covariance is not positive semidefinite"
        if not (np.isfinite(self.nav).all() and np.isfinite(self.x).all() and np.isfinite(self.acc).all()):
            return "the state is not finite"
        if max(np.abs(values).max(initial=0.0) for values in (sd, self.nav, self.x, self.acc)) > LARGEST:
            return f"the state or its covariance is larger than anything that moves ({LARGEST:g})"
        C, radii = self.nav[6:15].reshape(3, 3), self.nav[15:17]
        on_earth = (np.abs(radii - strapdown.EARTH_RADIUS) < OFF_M).all()
        if not (np.abs(C @ C.T - np.eye(3)) < SKEWED).all() or not on_earth:
            return "the attitude is no rotation, or the place not on the Earth"
        if not (self.recent[:, 0] >= 0.0).all():
            return "the last samples do not follow each other"
        # kernels use these as places of states
        places = [*strapdown.PLACES, strapdown.INCREMENTS, strapdown.PERIOD_S]
        if not np.array_equal(self.drv[places], fresh.drv[places]):
            return "the drive's memory is not laid out as this vehicle's"
        return None

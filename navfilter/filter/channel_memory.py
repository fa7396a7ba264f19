"""What is remembered of one correcting sensor from reading to reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from navfilter.faults.alternative_path import RefusedWay
from navfilter.faults.dead_reckoning_compass import Reckoned
from navfilter.faults.imu.gyro_scale import Turns
from navfilter.faults.noise_scale import Scatter
from navfilter.faults.refusals import Refusals
from navfilter.faults.velocity_fault import Aside
from navfilter.kernels import batch

__all__ = ["ChannelMemory"]

Array = NDArray[np.float64]
#: A sensor that has been refused for so long, and then used again, was wrong itself [s].
DISPUTED_S = 3.0
#: For so long after that it may be wrong again [s]: it has to follow turns and changes of speed meanwhile.
UNDISPUTED_S = 600.0


def _time(which: int, meaning: str) -> property:
    """A time that kernels note, too."""
    at = which - batch.NOTED

    def noted(self: ChannelMemory, time_s: float) -> None:
        self.last[at] = time_s

    return property(lambda self: self.last.item(at), noted, doc=meaning)


@dataclass
class ChannelMemory:
    """What is remembered of a sensor.

    Attributes
    ----------
    rejected_since_s : float
        Since when its readings have been rejected without one that was used [s]; NaN when they have not.
    refused_speed : float
        Of the vehicle when that began [m/s].
    agreed_s : float
        Since when it has agreed with the state: NaN before, and after the state was reset to it [s].
    refused : Refusals or None
        What the readings that have been refused since say together.
    ramp : tuple of float
        Sums of the straight line through the residuals of a velocity that have been refused since (`ramp`).
    way : RefusedWay or None
        Of a velocity that has been refused since the last fix: the way that it would have made beside the state's.
    refused_s : float
        When its last reading was refused [s].
    disputed_s, jumped_s : float
        When it was last refused for long although the drive was right, and when it was taken to have jumped [s].
    astray_m : float
        Its slow error came to be beyond belief, and no reading has agreed with the state since: the way made in the
        periods of those that were heard; NaN where it is not so [m].
    aside : Aside or None
        Of a velocity that has jumped by about itself.
    alone : tuple of float
        Of a compass to which the heading was set against what was believed before, until something else confirms that:
        by how much at most [rad], latitude and longitude then [rad].
    beat : tuple of float
        Of fixes that the state was set to against what was believed before: by how much [m], and when last [s].
    course : tuple of float
        Of a compass that fixes have contradicted: variance to which they have told the heading [rad^2], that of one of
        them [m^2], latitude and longitude then [rad]; until the compass is back.
    scatter : Scatter or None
        Of one of which several readings have been refused of late: how they scatter.
    reckoned : Reckoned or None
        Of fixes that are refused beside dead reckoning without an inertial unit: their way, and its.
    turns : Turns or None
        Of a compass that was refused: what it said of the gyros.
    partly_since_s : float
        Since when components of each reading are left out alone (`Sensor.single_s`); NaN where they are not [s].
    same_s, again_s : float
        Since when its value has been the same, and when it came again last [s].
    either : bool
        Of a depth gauge with a constant: that may as well be the state's (`heights`).
    last : ndarray
        Jacobian, verdict and residual of the last reading (``kalman.places`` 7 to 9); then when it was read, when its
        clock ticked last, and when a reading was used [s]; then see ``stretch.NORTH_WHITE``, ``LET_GO``.
    """

    rejected_since_s: float = math.nan
    refused_speed: float = 0.0
    agreed_s: float = math.nan
    refused: Refusals | None = None
    ramp: tuple[float, ...] = ()
    way: RefusedWay | None = None
    refused_s: float = -math.inf
    disputed_s: float = -math.inf
    jumped_s: float = -math.inf
    astray_m: float = math.nan
    aside: Aside | None = None
    alone: tuple[float, ...] = ()
    beat: tuple[float, ...] = ()
    course: tuple[float, ...] = ()
    scatter: Scatter | None = None
    reckoned: Reckoned | None = None
    turns: Turns | None = None
    partly_since_s: float = math.nan
    same_s: float = math.nan
    again_s: float = math.nan
    either: bool = False
    last: Array = field(default_factory=lambda: np.array([-math.inf, -math.inf, -math.inf, 0.0, 0.0]))

    last_s = _time(batch.LAST_S, "Time of the last reading [s].")
    ticked_s = _time(batch.TICKED_S, "Of the last tick of its clock [s].")
    used_s = _time(batch.TAKEN_S, "Of the last reading that was used; minus infinity before the first [s].")

    @property
    def agrees(self) -> bool:
        """Whether it is used, and was before: then another that is used says nothing new."""
        return math.isnan(self.rejected_since_s) and not math.isnan(self.agreed_s)

    @property
    def undisputed(self) -> bool:
        """Whether it was right for long, until it was refused last."""
        return not self.rejected_since_s - self.disputed_s <= UNDISPUTED_S

    @property
    def refused_from_s(self) -> float:
        """From when on the readings that have been refused may speak [s]: when it was used last, or since they are."""
        return self.used_s if math.isfinite(self.used_s) else self.rejected_since_s

    @property
    def astray(self) -> bool:
        """Whether its slow error came to be beyond belief, and no reading has agreed with the state since."""
        return not math.isnan(self.astray_m)

    def use(self, time_s: float) -> None:
        """Note that a reading of this time has been used."""
        if time_s - self.rejected_since_s >= DISPUTED_S:
            self.disputed_s = time_s
        self.rejected_since_s, self.used_s, self.refused, self.astray_m = math.nan, time_s, None, math.nan
        self.partly_since_s = math.nan
        if math.isnan(self.agreed_s):
            self.agreed_s = time_s

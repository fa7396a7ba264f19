"""What the monitor remembers: of each sensor, of the inertial unit, and of silence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.faults.alternative_path import AlternativePath
from navfilter.faults.dead_reckoning_compass import DeadReckoningComparison
from navfilter.faults.imu.monitor import CONDITIONS
from navfilter.faults.noise_scale import NoiseScale
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.faults.velocity_fault import VelocityFault
from navfilter.kernels import fault_bank, imu_checks
from navfilter.kernels.batch import LOOK_EVERY_S

Array = NDArray[np.float64]


@dataclass
class SensorFaults:
    """What is remembered of the faults of one sensor.

    Attributes
    ----------
    rejected_since_s : float
        Since when its readings have been rejected without one that was used [s]; NaN when they have not.
    refused_speed : float
        Of the vehicle when that began [m/s].
    agreed_s : float
        Since when it has agreed with the state: NaN before, and after the state was reset to it [s].
    refused : RejectionRun or None
        What the readings that have been refused since say together.
    way : AlternativePath or None
        Of a velocity that has been refused since the last fix: the way that it would have made beside the state's.
    refused_s : float
        When its last reading was refused [s].
    disputed_s, jumped_s : float
        When it was last refused for long although the drive was right, and when it was taken to have jumped [s].
    astray_m : float
        Its slow error came to be beyond belief, and no reading has agreed with the state since: the way made in the
        periods of those that were heard; NaN where it is not so [m].
    aside : VelocityFault or None
        Of a velocity that has jumped by about itself, see `navfilter.faults.velocity_fault`.
    alone : tuple of float
        Of a compass to which the heading was set against what was believed before, until something else confirms that:
        by how much at most [rad], latitude and longitude then [rad].
    beat : tuple of float
        Of fixes that the state was set to against what was believed before: by how much [m], and when last [s].
    course : tuple of float
        Of a compass that fixes have contradicted: variance to which they have told the heading [rad^2], that of one of
        them [m^2], latitude and longitude then [rad]; until the compass is back.
    scatter : NoiseScale or None
        Of one of which several readings have been refused of late: how they scatter.
    reckoned : DeadReckoningComparison or None
        Of fixes that are refused beside dead reckoning without an inertial unit: their way, and its.
    partly_since_s : float
        Since when components of each reading are left out alone (`Sensor.single_s`); NaN where they are not [s].
    same_s, again_s : float
        Since when its value has been the same, and when it came again last [s].
    either : bool
        Of a depth gauge with a constant: that may as well be the state's (`heights`).
    odds : float
        Of one to which the bank has given constants: by how much more than usual readings have to speak against these
        before they are taken away; by so much they were likelier than any other explanation, and a little more [nat].
    tells : bool
        Of fixes: what drives has jumped, and they may tell that it is back.
    gone : ndarray, shape (k, 4)
        Of each constant of one that wanders: how much likelier it has become of late that there is none [nat], its mean
        and variance after the last reading that was used, as shares of those at first, and when that was [s]. It is not
        written to.
    """

    rejected_since_s: float = math.nan
    refused_speed: float = 0.0
    agreed_s: float = math.nan
    refused: RejectionRun | None = None
    way: AlternativePath | None = None
    refused_s: float = -math.inf
    disputed_s: float = -math.inf
    jumped_s: float = -math.inf
    astray_m: float = math.nan
    aside: VelocityFault | None = None
    alone: tuple[float, ...] = ()
    beat: tuple[float, ...] = ()
    course: tuple[float, ...] = ()
    scatter: NoiseScale | None = None
    reckoned: DeadReckoningComparison | None = None
    partly_since_s: float = math.nan
    same_s: float = math.nan
    again_s: float = math.nan
    either: bool = False
    odds: float = 0.0
    tells: bool = False
    gone: Array = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def agrees(self) -> bool:
        """Whether it is used, and was before: then another that is used says nothing new."""
        return math.isnan(self.rejected_since_s) and not math.isnan(self.agreed_s)

    def confirmed(self, used_s: float) -> bool:
        """Whether it had agreed with the state for long when it was used last, at this time [s]."""
        return used_s - self.agreed_s >= settings.CONFIRMED_S

    @property
    def undisputed(self) -> bool:
        """Whether it was right for long, until it was refused last."""
        return not self.rejected_since_s - self.disputed_s <= settings.UNDISPUTED_S

    @property
    def astray(self) -> bool:
        """Whether its slow error came to be beyond belief, and no reading has agreed with the state since."""
        return not math.isnan(self.astray_m)

    @property
    def scatters(self) -> bool:
        """Whether it seems to scatter by more than its error model says: each of its readings is heard."""
        return self.scatter is not None and self.scatter.watched

    def contested(self, offset: bool) -> bool:
        """Whether more is doubted of it than its last readings and its noise; offset: it has a state of a fault."""
        since = bool(self.alone) or self.partly_since_s > -math.inf or self.astray or self.tells
        return since or offset or (self.scatter is not None and self.scatter.worthless)

    def ordinary(self, offset: bool) -> bool:
        """Whether its next reading is the kernel's to judge, live."""
        return not math.isnan(self.agreed_s) and math.isnan(self.rejected_since_s) and not self.doubted(offset)

    def doubted(self, offset: bool) -> bool:
        """Whether more is looked for in its next reading than its gate tells."""
        return self.contested(offset) or self.scatters or self.refused is not None

    def condition(self, offset: bool) -> str:
        """What has been found of its errors; empty for nothing."""
        return "astray" if self.astray else "jumped" if offset else ""

    def use(self, time_s: float) -> None:
        """Note that a reading of this time has been used."""
        if time_s - self.rejected_since_s >= settings.SENSOR_DISPUTED_S:
            self.disputed_s = time_s
        self.rejected_since_s, self.refused, self.astray_m = math.nan, None, math.nan
        self.partly_since_s = math.nan
        if math.isnan(self.agreed_s):
            self.agreed_s = time_s


@dataclass
class MonitorMemory:
    """Everything that changes in a monitor.

    Attributes
    ----------
    imu : ndarray, shape (7, 18) or (0, 18)
        What is known of the axes of the inertial unit, see `navfilter.kernels.imu_checks`.
    channels : dict of str to SensorFaults
    bank : ndarray
        What innovations say of slow faults, see `navfilter.kernels.fault_bank`; none without an inertial unit.
    silent : tuple of float
        Where nothing is heard, be it of the drive or of a sensor: since when [s], and the variances of the position
        then, north, east and down [m^2]. Else empty.
    """

    imu: Array
    channels: dict[str, SensorFaults]
    bank: Array
    silent: tuple[float, ...] = ()

    @property
    def has_excluded(self) -> bool:
        """Whether something else stands in place of what an axis of the inertial unit says."""
        return any(code > imu_checks.NOISY for code in self.imu[: imu_checks.UNIT, imu_checks.HEEDED].tolist())

    @property
    def is_busy(self) -> bool:
        """Whether an axis of the inertial unit is left out, or soon will be."""
        return len(self.imu) > 0 and (self.imu.item(imu_checks.UNIT, imu_checks.OFF_S) > 0.0 or self.has_excluded)

    @property
    def look_s(self) -> float:
        """Time of the reading by which slow faults are looked for next [s]."""
        if not self.bank.size:
            return math.inf
        last_s = self.bank.item(fault_bank.LOOKED_S)
        return last_s if last_s == -math.inf else (math.floor(last_s / LOOK_EVERY_S) + 1.0) * LOOK_EVERY_S

    def problem(self) -> str | None:
        """What is wrong with the values of one that came from outside, in words; None when nothing is."""
        codes = self.imu[:6, [imu_checks.CODE, imu_checks.HEEDED]]
        if not np.isin(codes, range(len(CONDITIONS))).all():
            return "the drive's axes are in conditions that do not exist"
        alone = [channel.alone for channel in self.channels.values() if channel.alone]
        if any(len(told) != 3 or not all(type(v) is float for v in told) for told in alone):
            return "what a heading told alone is not an angle and a place"
        beat = [channel.beat for channel in self.channels.values() if channel.beat]
        if any(len(told) != 2 or not all(type(v) is float for v in told) for told in beat):
            return "what fixes have beaten is not a distance and a time"
        if self.silent and (len(self.silent) != 4 or not all(type(v) is float for v in self.silent)):
            return "what was known before nothing was heard is not a time and three variances"
        return None

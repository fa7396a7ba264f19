"""The start of a run: where the vehicle is, and how well that is known."""

import datetime
import math
from dataclasses import dataclass, field

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.frozen import FrozenDescription
from navfilter.kernels import strapdown
from navfilter.models.state import NavState, matrix_from_euler


def _known(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True, kw_only=True)
class Start(FrozenDescription):
    """Where a run starts and how well that is known.

    Parameters
    ----------
    time_s : float
        Mission time [s].
    latitude_deg, longitude_deg, height_m : float
        WGS-84; height above the ellipsoid [m].
    velocity_n : (3,) float
        North, east, down [m/s].
    roll_deg, pitch_deg, heading_deg : float
        Attitude; heading is true, clockwise from north.
    position_sd_m, velocity_sd_m_s : float or (3,) float
        Standard deviations, north, east, down.
    tilt_sd_deg, heading_sd_deg : float
        Standard deviations of roll and pitch, and of the heading.
    date : datetime.date, optional
        For the magnetic declination.
    """

    time_s: float = 0.0
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0
    velocity_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    heading_deg: float = 0.0
    position_sd_m: float | tuple[float, float, float] = 10.0
    velocity_sd_m_s: float | tuple[float, float, float] = 0.5
    tilt_sd_deg: float = 1.0
    heading_sd_deg: float = 5.0
    date: datetime.date | None = field(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("time_s", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"Start.{name} must be finite, found {getattr(self, name)!r}.")
        if abs(self.latitude_deg) > 89.9:
            raise ValueError(
                f"Start.latitude_deg must lie within 89.9 degrees of the equator, found {self.latitude_deg!r}."
            )
        if abs(self.longitude_deg) > 360.0:
            raise ValueError(f"Start.longitude_deg must lie within 360 degrees, found {self.longitude_deg!r}.")
        velocity = self.velocity_n
        if not (isinstance(velocity, tuple) and len(velocity) == 3 and all(map(_known, velocity))):
            raise ValueError(f"Start.velocity_n must be three finite numbers (north, east, down), found {velocity!r}.")
        for name in ("position_sd_m", "velocity_sd_m_s", "tilt_sd_deg", "heading_sd_deg"):
            sd = getattr(self, name)
            each, most = (sd, 3) if isinstance(sd, tuple) else ((sd,), 1)
            if len(each) != most or not all(_known(one) and one >= 0.0 for one in each):
                several = "" if name.endswith("deg") else ", or three of them (north, east, down)"
                raise ValueError(f"Start.{name} must be a finite number >= 0{several}, found {sd!r}.")
        if self.date is not None:
            object.__setattr__(self, "date", utc.day(self.date, "Start.date"))

    @property
    def state(self) -> NavState:
        """The nominal state with its covariance, shape (9, 9)."""
        C = matrix_from_euler(*np.radians([self.roll_deg, self.pitch_deg, self.heading_deg]))
        sd = [np.broadcast_to(np.asarray(s, dtype=float), 3) for s in (self.position_sd_m, self.velocity_sd_m_s)]
        tilt, heading = math.radians(self.tilt_sd_deg), math.radians(self.heading_sd_deg)
        P = np.diag(np.concatenate([*sd, [tilt, tilt, heading]]) ** 2)
        place = (math.radians(self.latitude_deg), math.radians(self.longitude_deg), float(self.height_m))
        return NavState(float(self.time_s), *place, np.asarray(self.velocity_n, dtype=float), C, P)

    def way_to(self, latitude: float, longitude: float) -> tuple[float, float]:
        """How far a place [rad] is from here, north and east [m]: as `NavState.minus` says, in plain numbers."""
        own = math.radians(self.latitude_deg)
        (meridian, prime), turn = strapdown.radii(own), longitude - math.radians(self.longitude_deg)
        east = ((turn + math.pi) % math.tau - math.pi) * (prime + self.height_m) * math.cos(own)
        return (latitude - own) * (meridian + self.height_m), east

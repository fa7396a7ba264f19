"""The vehicle: what drives it, its named sensors; and the start of a run."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel
from navfilter.mechanisation import Imu, Mechanisation
from navfilter.sensors import Sensor
from navfilter.state import NavState, matrix_from_euler

__all__ = ["Start", "Vehicle"]

Array = NDArray[np.float64]
RESERVED = ("imu", "gyro", "accel", "attitude", "velocity", "truth")


@dataclass(frozen=True, init=False)
class Vehicle:
    """The frozen description of a vehicle.

    Parameters
    ----------
    drive : Imu or DeadReckoning
        What carries the state between corrections; ``imu=`` is short for it.
    sensors : dict of str to Sensor
        The correcting sensors by name. The name is that of the mission's stream, the state block, the residuals and the output columns.
    name : str
        For reports.

    Examples
    --------
    >>> from navfilter import Depth, GaussMarkov, Heading, Imu, Vehicle
    >>> vehicle = Vehicle(imu=Imu(rate_hz=100), sensors={"compass": Heading(rate_hz=8), "depth": Depth(rate_hz=1)})
    >>> vehicle.with_error(compass=GaussMarkov(sd=0.01, tau_s=30)).sensors["compass"].error
    GaussMarkov(sd=0.01, tau_s=30, order=1)
    >>> list(vehicle.without("depth").sensors)
    ['compass']
    """

    drive: Mechanisation
    sensors: Mapping[str, Sensor]
    name: str = "vehicle"

    def __init__(
        self,
        drive: Mechanisation | None = None,
        sensors: Mapping[str, Sensor] | None = None,
        name: str = "vehicle",
        *,
        imu: Imu | None = None,
    ) -> None:
        if (drive is None) == (imu is None):
            raise ValueError("Vehicle needs exactly one of drive= and imu= (imu=Imu(...) is short for drive=Imu(...)).")
        chosen = imu if drive is None else drive
        if not isinstance(chosen, Mechanisation):
            raise ValueError(f"Vehicle.drive must be an Imu or a DeadReckoning, found {chosen!r}.")
        for key, sensor in (sensors or {}).items():
            if not isinstance(sensor, Sensor):
                raise ValueError(f'Vehicle.sensors["{key}"] must be a sensor such as Heading or Depth, found {sensor!r}.')
            if key in RESERVED:
                raise ValueError(f'"{key}" is reserved for the drive; give the sensor another name.')
        object.__setattr__(self, "drive", chosen)
        object.__setattr__(self, "sensors", MappingProxyType(dict(sensors or {})))
        object.__setattr__(self, "name", name)

    def __reduce__(self) -> tuple[type[Vehicle], tuple[Mechanisation, dict[str, Sensor], str]]:
        return Vehicle, (self.drive, dict(self.sensors), self.name)

    def with_error(self, **models: ErrorModel | tuple[ErrorModel, ...]) -> Vehicle:
        """The same vehicle with other error models, by sensor name (``gyro``, ``accel``, ``attitude``, ``velocity`` for the drive)."""
        drive, sensors = self.drive, dict(self.sensors)
        for key, model in models.items():
            if key in sensors:
                sensors[key] = dataclasses.replace(sensors[key], error=model)
            elif hasattr(drive, key) and key in RESERVED:
                part = getattr(drive, key)
                new = dataclasses.replace(part, error=model) if isinstance(part, Sensor) else model
                drive = dataclasses.replace(drive, **{key: new})  # type: ignore[arg-type]
            else:
                raise ValueError(f'"{key}" is no sensor of this vehicle (sensors: {", ".join(sensors)}; drive: {type(drive).__name__}).')
        return Vehicle(drive, sensors, self.name)

    def without(self, *names: str) -> Vehicle:
        """The same vehicle without some of its sensors."""
        for key in names:
            if key not in self.sensors:
                raise ValueError(f'"{key}" is no sensor of this vehicle (sensors: {", ".join(self.sensors)}).')
        return Vehicle(self.drive, {k: s for k, s in self.sensors.items() if k not in names}, self.name)


@dataclass(frozen=True, kw_only=True)
class Start:
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
        for name in ("time_s", "latitude_deg", "longitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"Start.{name} must be finite, found {getattr(self, name)!r}.")
        if abs(self.latitude_deg) > 89.9:
            raise ValueError(f"Start.latitude_deg must lie within 89.9 degrees of the equator, found {self.latitude_deg!r}.")
        for name in ("position_sd_m", "velocity_sd_m_s", "tilt_sd_deg", "heading_sd_deg"):
            if not np.all(np.isfinite(getattr(self, name))) or np.any(np.asarray(getattr(self, name)) < 0):
                raise ValueError(f"Start.{name} must be >= 0, found {getattr(self, name)!r}.")

    @property
    def state(self) -> NavState:
        """The nominal state with its covariance, shape (9, 9)."""
        C = matrix_from_euler(*np.radians([self.roll_deg, self.pitch_deg, self.heading_deg]))
        sd = [np.broadcast_to(np.asarray(s, dtype=float), 3) for s in (self.position_sd_m, self.velocity_sd_m_s)]
        tilt, heading = math.radians(self.tilt_sd_deg), math.radians(self.heading_sd_deg)
        P = np.diag(np.concatenate([*sd, [tilt, tilt, heading]]) ** 2)
        place = (math.radians(self.latitude_deg), math.radians(self.longitude_deg), float(self.height_m))
        return NavState(float(self.time_s), *place, np.asarray(self.velocity_n, dtype=float), C, P)

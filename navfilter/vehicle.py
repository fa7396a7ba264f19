"""The vehicle: what drives it, and its named sensors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel
from navfilter.mechanisation import Imu, Mechanisation
from navfilter.notebook import card
from navfilter.sensors import Sensor

__all__ = ["Vehicle"]

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
        The correcting sensors by name. The name is that of the mission's stream, the state block, the residuals and the
        output columns.
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
                raise ValueError(
                    f'Vehicle.sensors["{key}"] must be a sensor such as Heading or Depth, found {sensor!r}.'
                )
            if key in RESERVED:
                raise ValueError(f'"{key}" is reserved for the drive; give the sensor another name.')
        object.__setattr__(self, "drive", chosen)
        object.__setattr__(self, "sensors", MappingProxyType(dict(sensors or {})))
        object.__setattr__(self, "name", name)

    def __reduce__(self) -> tuple[type[Vehicle], tuple[Mechanisation, dict[str, Sensor], str]]:
        return Vehicle, (self.drive, dict(self.sensors), self.name)

    def _repr_html_(self) -> str:
        parts = {"drive": self.drive, **self.sensors}
        return card(f"Vehicle {self.name}", {name: _in_short(part) for name, part in parts.items()})

    def with_error(self, **models: ErrorModel | tuple[ErrorModel, ...]) -> Vehicle:
        """The same vehicle with other error models, by sensor name (``gyro``, ``accel``, ``attitude``, ``velocity`` for
        the drive).
        """
        drive, sensors = self.drive, dict(self.sensors)
        for key, model in models.items():
            if key in sensors:
                sensors[key] = dataclasses.replace(sensors[key], error=model)
            elif hasattr(drive, key) and key in RESERVED:
                part = getattr(drive, key)
                new = dataclasses.replace(part, error=model) if isinstance(part, Sensor) else model
                drive = dataclasses.replace(drive, **{key: new})  # type: ignore[arg-type]
            else:
                raise ValueError(
                    f'"{key}" is no sensor of this vehicle (sensors: {", ".join(sensors)}; drive: '
                    f"{type(drive).__name__})."
                )
        return Vehicle(drive, sensors, self.name)

    def without(self, *names: str) -> Vehicle:
        """The same vehicle without some of its sensors."""
        for key in names:
            if key not in self.sensors:
                raise ValueError(f'"{key}" is no sensor of this vehicle (sensors: {", ".join(self.sensors)}).')
        return Vehicle(self.drive, {k: s for k, s in self.sensors.items() if k not in names}, self.name)


def _in_short(value: object) -> str:
    """A description with those of its fields that are not at their defaults."""
    if not dataclasses.is_dataclass(value):
        return f"{value:g}" if isinstance(value, float) else str(value)
    fields = [field for field in dataclasses.fields(value) if getattr(value, field.name) != field.default]
    given = ", ".join(f"{field.name}={_in_short(getattr(value, field.name))}" for field in fields)
    return f"{type(value).__name__}({given})"

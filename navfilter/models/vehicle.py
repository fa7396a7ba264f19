"""The vehicle: what drives it, and its named sensors."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from navfilter.foundation.display import card
from navfilter.foundation.frozen import typed
from navfilter.foundation.quoting import one_line
from navfilter.models.error_models import ErrorModel, GaussMarkov, White
from navfilter.models.mechanisation import DeadReckoningLane, Imu, Mechanisation
from navfilter.models.sensors import Attitude, Sensor
from navfilter.models.start import Start

RESERVED = ("imu", "gyro", "accel", "attitude", "velocity", "truth")
#: Name of the lane without an inertial unit, and of the sensor that only this lane has.
DEAD_RECKONING, LEVEL = "dead-reckoning", "level"
#: A vehicle that nobody feels is level within so much [rad], and comes back to it in so long [s]: dives of 20 deg last
#: a minute.
LEVEL_SD, LEVEL_TAU_S = 0.2, 60.0
#: That it is level is said once in so long [s]: often enough for its correlation.
LEVEL_PERIOD_S = 10.0


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
    imus : dict of str to Imu
        Several inertial units by name, in place of `drive`: each has a lane of its own, see `lanes`. The name is that
        of the mission's stream.
    dead_reckoning_lane : bool, optional
        A lane without an inertial unit beside the others. Default: where there are several units, and sensors for
        it (a heading and a velocity). Beside a single unit it is there only when it is asked for, because it costs as
        much as another filter, and most of what a single unit does wrong is found from its own samples.

    Examples
    --------
    >>> from navfilter import Depth, GaussMarkov, Heading, Imu, Vehicle
    >>> vehicle = Vehicle(imu=Imu(rate_hz=100), sensors={"compass": Heading(rate_hz=8), "depth": Depth(rate_hz=1)})
    >>> vehicle.with_error(compass=GaussMarkov(sd=0.01, tau_s=30)).sensors["compass"].error
    GaussMarkov(sd=0.01, tau_s=30)
    >>> list(vehicle.without("depth").sensors)
    ['compass']
    """

    drive: Mechanisation
    sensors: Mapping[str, Sensor]
    name: str = "vehicle"
    imus: Mapping[str, Imu] = field(default_factory=dict)
    dead_reckoning_lane: bool | None = None

    def __init__(
        self,
        drive: Mechanisation | None = None,
        sensors: Mapping[str, Sensor] | None = None,
        name: str = "vehicle",
        *,
        imu: Imu | None = None,
        imus: Mapping[str, Imu] | None = None,
        dead_reckoning_lane: bool | None = None,
    ) -> None:
        if imus and drive == next(iter(imus.values())):
            drive = None  # as `dataclasses.replace` gives it again
        if [drive is None, imu is None, not imus].count(False) != 1:
            raise ValueError(
                "Vehicle needs exactly one of drive=, imu= and imus= (imu=Imu(...) is short for drive=Imu(...))."
            )
        _check_tables(sensors, imus, name)
        units = _checked_units(imus or {}, sensors or {})
        chosen = next(iter(units.values())) if units else imu if drive is None else drive
        if not isinstance(chosen, Mechanisation):
            found = f"the class {chosen.__name__}" if isinstance(chosen, type) else repr(chosen)
            raise ValueError(f"Vehicle.drive must be an Imu or a DeadReckoning, found {found}.")
        for key, sensor in (sensors or {}).items():
            if not isinstance(sensor, Sensor):
                raise ValueError(
                    f'Vehicle.sensors["{key}"] must be a sensor such as Heading or Depth, found {sensor!r}.'
                )
            if key in RESERVED:
                raise ValueError(f'"{key}" is reserved for the drive; give the sensor another name.')
        object.__setattr__(self, "drive", chosen)
        object.__setattr__(self, "sensors", MappingProxyType(dict(sensors or {})))
        object.__setattr__(self, "name", one_line(name))
        object.__setattr__(self, "imus", MappingProxyType(units))
        object.__setattr__(self, "dead_reckoning_lane", dead_reckoning_lane)
        if dead_reckoning_lane:
            _ = self.lanes()

    def __repr__(self) -> str:
        """As it is typed in, a line for each sensor."""

        def table(name: str, parts: Mapping[str, Any]) -> list[str]:
            return [f"    {name}={{", *(f"        {key!r}: {typed(part)}," for key, part in parts.items()), "    },"]

        drive = f"    {'imu' if self.drive.inertial else 'drive'}={typed(self.drive)},"
        lane = self.dead_reckoning_lane
        return "\n".join(
            [
                "Vehicle(",
                *(table("imus", self.imus) if self.imus else [drive]),
                *(table("sensors", self.sensors) if self.sensors else []),
                *([f"    name={self.name!r},"] if self.name != "vehicle" else []),
                *([f"    dead_reckoning_lane={lane},"] if lane is not None else []),
                ")",
            ]
        )

    def __hash__(self) -> int:
        parts = frozenset(self.sensors.items()), frozenset(self.imus.items())
        return hash((self.drive, *parts, self.name, self.dead_reckoning_lane))

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (self.drive, dict(self.sensors), self.name, dict(self.imus), self.dead_reckoning_lane)

    @property
    def units(self) -> dict[str, Imu]:
        """Its inertial units by the names of their streams."""
        if self.imus:
            return dict(self.imus)
        return {"imu": self.drive} if self.drive.inertial else {}  # type: ignore[dict-item]

    @property
    def driving(self) -> dict[str, Mechanisation]:
        """What carries the state, by the names of the streams that it reads."""
        return dict(self.imus) or dict.fromkeys(self.drive.streams, self.drive)

    def lanes(self) -> "dict[str, Vehicle]":
        """What is run side by side: a vehicle with a single drive for each inertial unit, and one without any; empty
        for a vehicle with one drive and no lane beside it.

        Raises
        ------
        ValueError
            When a dead-reckoning lane is asked for that has nothing to go by.
        """
        if not (self.imus or self.dead_reckoning_lane):
            return {}
        lanes = {name: Vehicle(unit, self.sensors, self.name) for name, unit in self.units.items()}
        if not self.dead_reckoning_lane and (self.dead_reckoning_lane is False or len(lanes) < 2):
            return lanes
        seen = {sensor.observes.corrects for sensor in self.sensors.values()}
        lacks = [what for what in ("heading", "velocity") if what not in seen]
        lacks += [] if lanes else ["inertial unit beside it (a DeadReckoning is one already)"]
        if LEVEL in self.sensors:
            lacks.append(f'free name "{LEVEL}": a sensor of the vehicle has it')
        if not lacks:
            lanes[DEAD_RECKONING] = self._reckoning()
        elif self.dead_reckoning_lane:
            raise ValueError(
                f"the dead-reckoning lane has no {' and no '.join(lacks)}. Add what it lacks, or leave "
                "dead_reckoning_lane out."
            )
        return lanes

    def _reckoning(self) -> "Vehicle":
        """The lane without an inertial unit: as if the one there were dead."""
        unit = next(iter(self.units.values()))
        drive = DeadReckoningLane(
            gap_rate_sd=unit.gap_rate_sd,
            gap_force_sd=unit.gap_force_sd,
            max_speed_m_s=unit.max_speed_m_s,
            max_turn_rad_s=unit.max_turn_rad_s,
        )
        tilt = GaussMarkov(sd=LEVEL_SD, tau_s=LEVEL_TAU_S)
        level = Attitude(rate_hz=1.0 / LEVEL_PERIOD_S, error=(tilt, tilt, White(sd=1.0)))
        return Vehicle(drive, {**self.sensors, LEVEL: level}, self.name)

    def _repr_html_(self) -> str:
        drives: Mapping[str, Mechanisation] = self.imus or {"drive": self.drive}
        parts = {**drives, **self.sensors}
        return card(f"Vehicle {self.name}", {name: typed(part) for name, part in parts.items()})

    def with_error(self, **models: ErrorModel | tuple[ErrorModel, ...]) -> "Vehicle":
        """The same vehicle with other error models, by sensor name (``gyro``, ``accel``, ``attitude``, ``velocity`` for
        the drive; of several units, for each, or with the name of one: ``a.gyro``).
        """
        drives: dict[str, Any] = dict(self.imus) or {"": self.drive}
        sensors = dict(self.sensors)
        for place, model in models.items():
            unit, _, key = place.rpartition(".")
            if place in sensors:
                sensors[place] = dataclasses.replace(sensors[place], error=model)
            elif hasattr(self.drive, key) and key in RESERVED and (not unit or unit in self.imus):
                for name, drive in drives.items() if not unit else [(unit, drives[unit])]:
                    part = getattr(drive, key)
                    new = dataclasses.replace(part, error=model) if isinstance(part, Sensor) else model
                    drives[name] = dataclasses.replace(drive, **{key: new})
            else:
                raise ValueError(
                    f'"{place}" is no sensor of this vehicle (sensors: {", ".join(sensors)}; drive: '
                    f"{type(self.drive).__name__})."
                )
        return self._with(drives, sensors)

    def with_lane(self, name: str, lane: "Vehicle") -> "Vehicle":
        """The same vehicle with what another one of its lanes (`lanes`) is: its inertial unit, and the sensors."""
        sensors = {key: lane.sensors[key] for key in self.sensors}
        return self._with({**self.imus, name: lane.drive} if self.imus else {"": lane.drive}, sensors)

    def _with(self, drives: Mapping[str, Any], sensors: dict[str, Sensor]) -> "Vehicle":
        """The same with other drives (by name where there are several units) and sensors."""
        imus = drives if self.imus else {}
        return _again(next(iter(drives.values())), sensors, self.name, imus, self.dead_reckoning_lane)

    def at(self, start: Start) -> "Vehicle":
        """The same vehicle as it is at this place: with what a compass errs by near a magnetic pole. It is what a run
        and a simulation go by; itself where nothing is different.
        """
        drive, sensors = self.drive.at(start), {name: sensor.at(start) for name, sensor in self.sensors.items()}
        if drive is self.drive and all(sensor is self.sensors[name] for name, sensor in sensors.items()):
            return self
        return self._with(self.imus or {"": drive}, sensors)

    def without(self, *names: str) -> "Vehicle":
        """The same vehicle without some of its sensors."""
        for key in names:
            if not isinstance(key, str):
                raise ValueError(f'without takes names, such as without("compass", "depth"), found {key!r}.')
            if key not in self.sensors:
                raise ValueError(f'"{key}" is no sensor of this vehicle (sensors: {", ".join(self.sensors)}).')
        return self._with(self.imus or {"": self.drive}, {k: s for k, s in self.sensors.items() if k not in names})


def _again(
    drive: Mechanisation, sensors: dict[str, Sensor], name: str, imus: Mapping[str, Imu], lane: bool | None
) -> Vehicle:
    """A vehicle from its parts; with several units the drive is one of them."""
    return Vehicle(None if imus else drive, sensors, name, imus=imus, dead_reckoning_lane=lane)


def _check_tables(sensors: object, imus: object, name: object) -> None:
    """What has to be a name, or has to have names."""
    for what, table in (("sensors", sensors), ("imus", imus)):
        if not isinstance(table, Mapping | None):
            raise ValueError(
                f'Vehicle.{what} must be a dict by name, such as {{"depth": Depth()}}, found a {type(table).__name__}.'
            )
        for key in table or ():
            if not (isinstance(key, str) and key):
                raise ValueError(f"Vehicle.{what} goes by names, found {key!r} for one.")
    if not isinstance(name, str):
        raise ValueError(f"Vehicle.name must be text, found {name!r}.")


def _checked_units(imus: Mapping[str, Imu], sensors: Mapping[str, Sensor]) -> dict[str, Imu]:
    """Inertial units by names that nothing else has."""
    for key, unit in imus.items():
        if not getattr(unit, "inertial", False):
            raise ValueError(f'Vehicle.imus["{key}"] must be an Imu, found {unit!r}.')
        if key in sensors or key == DEAD_RECKONING or (key in RESERVED and key != "imu"):
            raise ValueError(f'"{key}" has another meaning in this vehicle; give the inertial unit another name.')
    return dict(imus)

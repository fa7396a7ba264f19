"""Which constants of a vehicle a calibration may estimate, and the same vehicle with other values of them."""

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from navfilter.models.mission import Mission
from navfilter.models.parameters import Parameter, constant_parameters
from navfilter.models.sensors import Sensor
from navfilter.models.state import euler_from_matrix, matrix_from_euler, rotation_matrix
from navfilter.models.vehicle import Vehicle

#: What a constant is unsure by where the vehicle says nothing: keys of a sensor's class and their values, by kind.
KINDS: dict[str, dict[str, Any]] = {
    "clock": {"time_offset_sd_s": 0.3},
    "lever-arm": {"lever_arm_sd_m": (0.3, 0.3, 0.3)},
    "scale": {"scale_sd": 0.02},
    "mounting": {"misalignment_sd_rad": math.radians(3.0)},
    "deviation": {"bias_sd_rad": math.radians(5.0), "deviation_sd_rad": (math.radians(5.0), math.radians(2.0))},
    "iron": {"hard_iron_sd": 0.1, "soft_iron_sd": 0.03},  # the first as a share of the field
    "offset": {"offset_sd_m": 0.5},
}
#: Which constants such a key makes.
_MADE_BY: dict[str, str | tuple[str, ...]] = {
    "time_offset_sd_s": "time_offset",
    "lever_arm_sd_m": ("lever_arm_x", "lever_arm_y", "lever_arm_z"),
    "scale_sd": "scale",
    "misalignment_sd_rad": "misalignment_",
    "bias_sd_rad": "bias",
    "deviation_sd_rad": ("one_cycle_", "two_cycle_"),
    "hard_iron_sd": "hard_iron_",
    "soft_iron_sd": "soft_iron_",
    "offset_sd_m": "offset",
}
#: A depth's clock and lever arm show in no horizontal motion: they are opened for what corrects these only.
_MOVING = ("position", "velocity", "heading")


class Constant(NamedTuple):
    """A constant that a vehicle is unsure of.

    Attributes
    ----------
    name : str
        Of the state, see `navfilter.filter.state_layout.Layout.names`.
    part : tuple of str
        Where it stands in a vehicle.toml: ("drive",), ("drive", "velocity"), ("sensors", "dvl").
    own : str
        Its name within that part.
    unit : str
    value, sd : float
        As described: of clocks and lever arms the whole of it, of a misalignment what comes on top of the mounting.
    folded : bool
        The value goes into a key of the part, so that its state begins at zero.
    """

    name: str
    part: tuple[str, ...]
    own: str
    unit: str
    value: float
    sd: float
    folded: bool


def constants_of(vehicle: Vehicle, each: Collection[str] = ()) -> tuple[Constant, ...]:
    """All constants that a vehicle is unsure of, in the order of its states.

    Parameters
    ----------
    vehicle : Vehicle
    each : collection of str
        Kinds, or names, of those that are left out.
    """
    drive = vehicle.drive
    of_drive = constant_parameters(drive.all_parameters(), drive.wandering())
    found = [_constant(p, *_in_drive(vehicle, p.name)) for p in of_drive if p.sd]
    for name, sensor in vehicle.sensors.items():
        for p in constant_parameters(sensor.all_parameters(), sensor.wandering()):
            if p.sd:
                place = ("sensors", name), sensor, p.name
                found.append(_constant(p._replace(name=f"{name}.{p.name}"), *place))
    return tuple(one for one in found if one.name not in each and kind_of(one.own) not in each)


def kind_of(own: str) -> str:
    """The kind of a constant, of `KINDS`; its own name for one of none.

    Parameters
    ----------
    own : str
        Its name within its part.
    """
    return next((kind for kind, keys in KINDS.items() for key in keys if own.startswith(_MADE_BY[key])), own)


def _in_drive(vehicle: Vehicle, name: str) -> tuple[tuple[str, ...], Any, str]:
    """Part, its description, and the name within it, of a state of the drive."""
    drive = vehicle.drive
    first, _, own = name.partition(".")
    if first == "velocity":
        return ("drive", "velocity"), drive.velocity_sensor, own
    if first in ("yaw", "attitude"):
        return ("drive", "attitude"), drive.compass, own
    return ("drive",), drive, name


def _constant(p: Parameter, part: tuple[str, ...], described: Any, own: str) -> Constant:
    if own == "time_offset":
        return Constant(p.name, part, own, p.unit, float(described.time_offset_s), p.sd, True)
    if own.startswith("lever_arm_"):
        return Constant(p.name, part, own, p.unit, float(described.lever_arm_b_m["xyz".index(own[-1])]), p.sd, True)
    folded = own.startswith("misalignment_") and hasattr(described, "mounting_rad")
    return Constant(p.name, part, own, p.unit, p.mean, p.sd, folded)


def described(vehicle: Vehicle, constants: Sequence[Constant]) -> Vehicle:
    """The vehicle with other values and standard deviations of its constants.

    Parameters
    ----------
    vehicle : Vehicle
        As those constants were taken from it.
    constants : sequence of Constant
        With the values and sds to describe.

    Notes
    -----
    Clocks and lever arms go into their keys, a misalignment into the mounting (``reading = (1 + s) R(m) C' v_b``: the
    mounting becomes ``C R(m)'``), all else into `calibrated`.
    """
    drive, sensors = vehicle.drive, dict(vehicle.sensors)
    for part in dict.fromkeys(one.part for one in constants):
        of_part = [one for one in constants if one.part == part]
        if part[0] == "sensors":
            sensors[part[1]] = _with(sensors[part[1]], of_part)
        elif len(part) == 2:
            drive = dataclasses.replace(drive, **{part[1]: _with(getattr(drive, part[1]), of_part)})
        else:
            drive = _with(drive, of_part)
    return Vehicle(drive, sensors, vehicle.name)


def _with(item: Any, constants: Sequence[Constant]) -> Any:
    """A sensor or drive with these values."""
    by_own = {one.own: one for one in constants}
    changed: dict[str, Any] = {}
    if "time_offset" in by_own:
        changed |= {"time_offset_s": by_own["time_offset"].value, "time_offset_sd_s": by_own["time_offset"].sd}
    arms = [by_own.get(f"lever_arm_{axis}") for axis in "xyz"]
    if any(arms):
        arm, sd = list(item.lever_arm_b_m), list(item.lever_arm_sd_m)
        for axis, one in enumerate(arms):
            if one is not None:
                arm[axis], sd[axis] = one.value, one.sd
        changed |= {"lever_arm_b_m": tuple(arm), "lever_arm_sd_m": tuple(sd)}
    turns = [by_own.get(f"misalignment_{axis}") for axis in "xyz"]
    if any(one is not None and one.folded for one in turns):
        turned = np.array([0.0 if one is None else one.value for one in turns])
        mounting = matrix_from_euler(*item.mounting_rad) @ rotation_matrix(turned[None, :])[0].T
        changed["mounting_rad"] = tuple(float(angle) for angle in euler_from_matrix(mounting[None])[0])
    calibrated = {name: (value, sd) for name, value, sd in item.calibrated}
    for one in constants:
        if one.own.startswith("misalignment_") or not one.folded:
            calibrated[one.own] = (0.0 if one.folded else one.value, one.sd)
    return dataclasses.replace(item, **changed, calibrated=tuple((n, v, sd) for n, (v, sd) in calibrated.items()))


def opened(vehicle: Vehicle, kinds: Sequence[str], missions: Sequence[Mission]) -> Vehicle:
    """The vehicle with constants of these kinds in doubt wherever it says nothing of them.

    Parameters
    ----------
    vehicle : Vehicle
    kinds : sequence of str
        Of `KINDS`.
    missions : sequence of Mission
        To be calibrated by: they tell how large a magnetometer's readings are.

    Notes
    -----
    Of a magnetometer the iron itself is opened instead of the deviation that it makes, and which looks the same.
    The drive's inertial unit is the reference of all clocks and lever arms; of a dead-reckoning drive the attitude is
    that of the clocks, and the antenna of the fixes that of the lever arms, which only differ from the velocity's.
    """
    keys: dict[str, Any] = {key: value for kind in kinds for key, value in KINDS[kind].items()}
    drive, inertial = vehicle.drive, vehicle.drive.inertial
    sensors = {}
    for name, sensor in vehicle.sensors.items():
        wanted = keys if inertial else {key: value for key, value in keys.items() if key != "lever_arm_sd_m"}
        if getattr(sensor, "magnetometer", False):
            wanted = _of_iron(wanted, _field(sensor, name, missions))
        sensors[name] = sensor if sensor.from_drive else _opened(sensor, wanted)
    if drive.velocity_sensor is not None:
        drive = dataclasses.replace(drive, velocity=_opened(drive.velocity_sensor, keys))  # type: ignore[call-arg]
    if drive.compass is not None:
        wanted = {key: value for key, value in keys.items() if key == "deviation_sd_rad"}
        drive = dataclasses.replace(drive, attitude=_opened(drive.compass, wanted))  # type: ignore[call-arg]
    return Vehicle(drive, sensors, vehicle.name)


def _of_iron(keys: Mapping[str, Any], field: float) -> dict[str, Any]:
    """Keys for a magnetometer whose calibrated readings have this size; 0: it reads nothing."""
    wanted = {key: value for key, value in keys.items() if key not in ("hard_iron_sd", "soft_iron_sd")}
    if "hard_iron_sd" in keys and field:
        wanted.pop("deviation_sd_rad", None)
        wanted |= {"hard_iron_sd": keys["hard_iron_sd"] * field, "soft_iron_sd": keys["soft_iron_sd"]}
    return wanted


def _field(sensor: Sensor, name: str, missions: Sequence[Mission]) -> float:
    """Median size of a magnetometer's calibrated readings."""
    streams = [mission.streams[name].value for mission in missions if name in mission.streams]
    fields = [values[good, :3] for values, good in map(sensor.read_all, streams)]
    return float(np.median(np.linalg.norm(np.concatenate(fields), axis=1))) if any(map(len, fields)) else 0.0


def _opened(sensor: Sensor, keys: Mapping[str, Any]) -> Any:
    return dataclasses.replace(sensor, **dict(_doubtful(sensor, keys)))


def _doubtful(sensor: Sensor, keys: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Those of the keys that the sensor has and that stand at zero."""
    for key, value in keys.items():
        place = key in ("time_offset_sd_s", "lever_arm_sd_m")
        if (
            not hasattr(sensor, key)
            or np.any(getattr(sensor, key))
            or (place and sensor.observes.corrects not in _MOVING)
        ):
            continue
        if key == "lever_arm_sd_m" and not sensor.has_lever_arm:
            continue
        if key in ("hard_iron_sd", "soft_iron_sd") and not getattr(sensor, "magnetometer", False):
            continue
        yield key, value


def closed(vehicle: Vehicle, before: Vehicle, untold: Sequence[Constant]) -> Vehicle:
    """The vehicle sure again of what it was sure of before, where missions told nothing of it.

    Parameters
    ----------
    vehicle : Vehicle
        As `opened` made it.
    before : Vehicle
    untold : sequence of Constant
    """
    told = {one.name for one in constants_of(vehicle)} - {one.name for one in untold}
    drive, sensors = vehicle.drive, dict(vehicle.sensors)
    for name, sensor in sensors.items():
        sensors[name] = _closed(sensor, before.sensors[name], told, f"{name}.")
    if drive.velocity_sensor is not None and before.drive.velocity_sensor is not None:
        velocity = _closed(drive.velocity_sensor, before.drive.velocity_sensor, told, "velocity.")
        drive = dataclasses.replace(drive, velocity=velocity)  # type: ignore[call-arg]
    if drive.compass is not None and before.drive.compass is not None:
        attitude = _closed(drive.compass, before.drive.compass, told, "yaw.")
        drive = dataclasses.replace(drive, attitude=attitude)  # type: ignore[call-arg]
    return Vehicle(drive, sensors, vehicle.name)


def _closed(sensor: Any, before: Any, told: set[str], prefix: str) -> Any:
    changed: dict[str, Any] = {}
    for key, made in _MADE_BY.items():
        if not hasattr(sensor, key) or np.any(getattr(before, key)) or not np.any(getattr(sensor, key)):
            continue
        if key == "lever_arm_sd_m":
            arm = zip("xyz", sensor.lever_arm_sd_m, strict=True)
            changed[key] = tuple(sd if f"{prefix}lever_arm_{axis}" in told else 0.0 for axis, sd in arm)
        elif not any(name.removeprefix(prefix).startswith(made) for name in told if name.startswith(prefix)):
            changed[key] = getattr(before, key)
    return dataclasses.replace(sensor, **changed) if changed else sensor

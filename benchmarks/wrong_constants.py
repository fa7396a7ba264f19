"""Errors of constants put into the descriptions of real recordings, for `recordings.py wrong`.

The velocity sensor of a recording is described half a metre, 0.3 s, 3 deg and 2 % off what its mapping says, one at a
time and all together, and unsure by as much. What its constants really are nobody knows; so they are compared with what
the filter finds with all positions and the description as mapped.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import replace

from harness import MAPPINGS

from navfilter.calibration.parts import constants_of, described
from navfilter.evaluation.correlations import Constant, constants
from navfilter.models.vehicle import Vehicle
from navfilter.track.track import Track

#: How wrong, and how unsure: by the name of the constant within its sensor [m], [s], [rad], [1].
WRONG = {"lever_arm_x": 0.5, "time_offset": 0.3, "misalignment_z": math.radians(3.0), "scale": 0.02}
#: The others are as unsure as those of their kind.
UNSURE = {
    **WRONG,
    "lever_arm_y": 0.5,
    "misalignment_x": math.radians(3.0),
    "misalignment_y": math.radians(3.0),
}
#: A constant that keeps more of its sd has not been told, as the verdict says it.
TOLD = 0.8
FOLDERS = ("snapir-auv-1hz", "wid-car-rtk", "comma2k19")


def names(only: str, quick: bool) -> Iterator[str]:
    """Recordings that have a velocity sensor, fixes, and a reference of positions."""
    for folder in FOLDERS:
        found = sorted(path.parent.name for path in (MAPPINGS / folder).glob("*/mission.toml"))
        for name in found[: 1 if quick else None]:
            if only in f"{folder}/{name}":
                yield f"{folder}/{name}"


def unsure(vehicle: Vehicle, wrong: Collection[str]) -> Vehicle:
    """The vehicle unsure of all constants of its velocity, some of which are described wrong.

    Parameters
    ----------
    vehicle : Vehicle
    wrong : collection of str
        Of the names in `WRONG`.
    """
    keys = {
        "time_offset_sd_s": UNSURE["time_offset"],
        "lever_arm_sd_m": (UNSURE["lever_arm_x"], UNSURE["lever_arm_y"], 0.0),
        "scale_sd": UNSURE["scale"],
        "misalignment_sd_rad": UNSURE["misalignment_z"],
    }
    drive, sensors = vehicle.drive, dict(vehicle.sensors)
    if drive.velocity_sensor is not None:
        drive = replace(drive, velocity=replace(drive.velocity_sensor, **keys))  # type: ignore[call-arg]
    else:
        sensors["odometer"] = replace(sensors["odometer"], **keys)
    doubtful = Vehicle(drive, sensors, vehicle.name)
    off = [
        one._replace(value=one.value + (WRONG[one.own] if one.own in wrong else 0.0), sd=UNSURE[one.own])
        for one in constants_of(doubtful)
        if one.own in UNSURE and one.part in (("drive", "velocity"), ("sensors", "odometer"))
    ]
    return described(doubtful, off)


def found(track: Track) -> dict[str, Constant]:
    """Those constants at the end of a run: by name within the sensor."""
    return {
        one.name.split(".")[1]: one
        for one in constants(track)
        if one.name.split(".")[0] in ("velocity", "odometer") and one.name.split(".")[1] in WRONG
    }


def described_value(vehicle: Vehicle, own: str) -> float:
    """Of a constant that `unsure` has described: where its state begins, in all."""
    sensor = vehicle.drive.velocity_sensor or vehicle.sensors["odometer"]
    if own == "time_offset":
        return sensor.time_offset_s
    if own.startswith("lever_arm_"):
        return float(sensor.lever_arm_b_m["xyz".index(own[-1])])  # type: ignore[attr-defined]
    # a misalignment goes into the mounting: to first order its yaw, with the other sign
    return -float(sensor.mounting_rad[2]) if own.startswith("misalignment_") else 0.0  # type: ignore[attr-defined]

"""A vehicle.toml with calibrated constants put in; comments, units and all else stay."""

import math
import os
import re
from typing import Any

import numpy as np

from navfilter.foundation.quoting import toml_key
from navfilter.io.toml_editing import with_keys, write_edited
from navfilter.models.vehicle import Vehicle

#: Fields that a calibration sets.
_FIELDS = (
    "time_offset_s", "time_offset_sd_s", "lever_arm_b_m", "lever_arm_sd_m", "mounting_rad", "scale_sd",
    "misalignment_sd_rad", "bias_sd_rad", "deviation_sd_rad", "hard_iron_sd", "soft_iron_sd", "offset_sd_m",
)  # fmt: skip
#: Digits that are written: far finer than any sd.
_DIGITS = 7


def write_calibrated(
    vehicle: Vehicle,
    before: Vehicle,
    path: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
    remark: str = "",
) -> bool:
    """Write a vehicle whose constants were calibrated, as an edited copy of the file that it was read from.

    Parameters
    ----------
    vehicle, before : Vehicle
        With the constants found, and as it was read.
    path : path-like
    source : path-like, optional
        The vehicle.toml, or the folder that holds it. Default: all is written anew.
    remark : str
        One line, written as a comment above each table's changes.

    Returns
    -------
    bool
        Whether it is a copy with all comments; the file is laid out in an unusual way otherwise, and all was written
        anew in SI units.
    """

    def edit(text: str) -> str:
        for part, new, old in _parts(vehicle, before):
            text = with_keys(text, part, _keys(new, old), remark)
        return text

    return write_edited(vehicle, path, source, edit, _alike)


def _parts(vehicle: Vehicle, before: Vehicle) -> list[tuple[tuple[str, ...], Any, Any]]:
    """Every table that may have changed: its place, what it describes now and before."""
    drive, old = vehicle.drive, before.drive
    parts: list[tuple[tuple[str, ...], Any, Any]]
    parts = [(("imus", name), unit, before.imus[name]) for name, unit in vehicle.imus.items()]
    parts = parts or [(("drive",), drive, old)]
    for name, new, was in (
        ("attitude", drive.compass, old.compass),
        ("velocity", drive.velocity_sensor, old.velocity_sensor),
    ):
        if new is not None and new != was:
            parts.append((("drive", name), new, was))
    parts += [(("sensors", name), sensor, before.sensors[name]) for name, sensor in vehicle.sensors.items()]
    return parts


def _keys(new: Any, old: Any) -> dict[str, tuple[str, str]]:
    """Fields that have changed, as the keys and values of a file, angles in degrees."""
    keys: dict[str, tuple[str, str]] = {}
    for field in _FIELDS:
        value = getattr(new, field, None)
        if value is not None and value != getattr(old, field, None):
            angle = re.search(r"_rad(?=_|$)", field) is not None
            keys[field] = re.sub(r"_rad(?=_|$)", "_deg", field), _text(value, angle)
    calibrated = new.calibrated
    if calibrated != old.calibrated:
        units = {p.name: p.unit for p in new.parameters()}
        each = []
        for name, value, sd in calibrated:
            angle = units.get(name) == "rad"
            key = f"{name}{'_deg' if angle else ''}"
            each.append(f"{toml_key(key)} = {_text((value, sd), angle)}")
        keys["calibrated"] = "calibrated", f"{{{', '.join(each)}}}"
    return keys


def _text(value: float | tuple[float, ...], angle: bool) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_text(part, angle) for part in value)}]"
    number = float(f"{math.degrees(value) if angle else value:.{_DIGITS}g}")
    return repr(number)


def _alike(vehicle: Vehicle, back: Vehicle) -> bool:
    """Whether a vehicle that was read back is this one, but for rounding."""
    if list(back.sensors) != list(vehicle.sensors) or list(back.driving) != list(vehicle.driving):
        return False
    pairs: list[tuple[Any, Any]] = [(back.driving[name], drive) for name, drive in vehicle.driving.items()]
    pairs += [(back.drive.compass, vehicle.drive.compass), (back.drive.velocity_sensor, vehicle.drive.velocity_sensor)]
    pairs += [(back.sensors[name], sensor) for name, sensor in vehicle.sensors.items()]
    return all(one is other is None or _near(one, other) for one, other in pairs)


def _near(one: Any, other: Any) -> bool:
    """Whether two descriptions of a sensor or drive agree in all that a calibration sets."""
    if type(one) is not type(other):
        return False
    numbers = [np.hstack([np.ravel(getattr(item, field, 0.0)) for field in _FIELDS]) for item in (one, other)]
    found = [[(p.name, p.mean, p.sd) for p in item.all_parameters()] for item in (one, other)]
    if [name for name, *_ in found[0]] != [name for name, *_ in found[1]]:
        return False
    numbers = [np.hstack([n, *([mean, sd] for _, mean, sd in f)]) for n, f in zip(numbers, found, strict=True)]
    return bool(np.allclose(numbers[0], numbers[1], rtol=1e-5, atol=1e-9))

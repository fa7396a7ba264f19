"""A vehicle.toml with calibrated constants put in; comments, units and all else stay."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.quoting import one_line, toml_key
from navfilter.io.learned_toml import closing
from navfilter.io.vehicle_keys import spellings
from navfilter.io.vehicle_toml import VehicleError, read_vehicle, vehicle_file, write_vehicle
from navfilter.models.vehicle import Vehicle

#: Fields that a calibration sets.
_FIELDS = (
    "time_offset_s", "time_offset_sd_s", "lever_arm_b_m", "lever_arm_sd_m", "mounting_rad", "scale_sd",
    "misalignment_sd_rad", "bias_sd_rad", "deviation_sd_rad", "hard_iron_sd", "soft_iron_sd", "offset_sd_m",
)  # fmt: skip
#: Digits that are written: far finer than any sd.
_DIGITS = 7


class Unclear(Exception):
    """The text is laid out in a way that is not followed here."""


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
    path = Path(path)
    if source is not None:
        file = vehicle_file(source)
        text = file.read_text(encoding="utf-8")
        try:
            for part, new, old in _parts(vehicle, before):
                text = edited(text, part, _keys(new, old), remark)
            path.write_text(text, encoding="utf-8")
            if _alike(read_vehicle(path), vehicle):
                return True
        except (Unclear, VehicleError, ValueError):
            pass
    write_vehicle(vehicle, path)
    return False


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


def _keys(new: Any, old: Any) -> dict[str, str]:
    """Fields that have changed, as the keys and values of a file, angles in degrees."""
    keys: dict[str, str] = {}
    for field in _FIELDS:
        value = getattr(new, field, None)
        if value is not None and value != getattr(old, field, None):
            angle = re.search(r"_rad(?=_|$)", field) is not None
            keys[field] = f"{re.sub(r'_rad(?=_|$)', '_deg', field)} = {_text(value, angle)}"
    calibrated = new.calibrated
    if calibrated != old.calibrated:
        units = {p.name: p.unit for p in new.parameters()}
        each = []
        for name, value, sd in calibrated:
            angle = units.get(name) == "rad"
            key = f"{name}{'_deg' if angle else ''}"
            each.append(f"{toml_key(key)} = {_text((value, sd), angle)}")
        keys["calibrated"] = f"calibrated = {{{', '.join(each)}}}"
    return keys


def _text(value: float | tuple[float, ...], angle: bool) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_text(part, angle) for part in value)}]"
    number = float(f"{math.degrees(value) if angle else value:.{_DIGITS}g}")
    return repr(number)


def edited(text: str, part: tuple[str, ...], keys: Mapping[str, str], remark: str) -> str:
    """The text of a vehicle.toml with keys of one table set.

    Parameters
    ----------
    text : str
    part : tuple of str
        The table: ("sensors", "dvl"), ("drive",).
    keys : dict of str to str
        Lines to be there, by the field that they set; however it was spelled before.
    remark : str
        A comment above them.

    Raises
    ------
    Unclear
        When the table is laid out in a way that is not followed here.
    """
    if not keys:
        return text
    name = part[-1]
    spelled = rf"(?:{re.escape(name)}|\"{re.escape(name)}\")"
    table = rf"\s*\.\s*{spelled}" if len(part) == 2 else ""
    header = re.search(rf"^[ \t]*\[\s*{part[0]}{table}\s*\][^\n]*\n", text, flags=re.MULTILINE)
    if header is not None:
        following = re.search(r"^[ \t]*\[", text[header.end() :], flags=re.MULTILINE)
        end = header.end() + following.start() if following else len(text)
        return _in_section(text, header.end(), end, keys, remark)
    if len(part) != 2:
        raise Unclear
    return _inline(text, part[0], spelled, keys)


def _in_section(text: str, begin: int, end: int, keys: Mapping[str, str], remark: str) -> str:
    body = text[begin:end]
    for field in keys:
        for spelling in spellings(field):
            found = re.search(rf"^[ \t]*{re.escape(spelling)}[ \t]*=[ \t]*", body, flags=re.MULTILINE)
            if found is not None:
                last = closing(body, found.end())
                rest = body[last:].split("\n", 1)
                # what the line says behind the value stays above it
                comment = rest[0].strip()
                kept = f"{comment}\n" if comment.startswith("#") else ""
                body = body[: found.start()] + kept + (rest[1] if len(rest) > 1 else "")
    lines = [f"# {one_line(remark)}"] * bool(remark) + list(keys.values())
    body = body if body.endswith("\n") else f"{body}\n"
    # what stands behind the last key of a section is a comment on the next one
    at = _last_key(body)
    return text[:begin] + body[:at] + "".join(f"{line}\n" for line in lines) + body[at:] + text[end:]


def _last_key(body: str) -> int:
    """Where the line behind the last key of a section begins."""
    end = 0
    for found in re.finditer(r"^[ \t]*[\w\"][^=\n]*=[ \t]*", body, flags=re.MULTILINE):
        if found.start() < end:
            continue
        end = closing(body, found.end())
        line = body.find("\n", end)
        end = len(body) if line < 0 else line + 1
    return end


def _inline(text: str, owner: str, spelled: str, keys: Mapping[str, str]) -> str:
    """The table stands in braces in the section of its owner."""
    header = re.search(rf"^[ \t]*\[\s*{owner}\s*\][^\n]*\n", text, flags=re.MULTILINE)
    if header is None:
        raise Unclear
    found = re.compile(rf"^[ \t]*{spelled}[ \t]*=[ \t]*(?=\{{)", flags=re.MULTILINE).search(text, header.end())
    if found is None:
        raise Unclear
    last = closing(text, found.end()) - 1
    inner = text[found.end() : last]
    for field in keys:
        for spelling in spellings(field):
            old = re.search(rf",\s*\b{re.escape(spelling)}\s*=\s*", inner)
            if old is not None:
                inner = inner[: old.start()] + inner[closing(inner, old.end()) :]
    return text[: found.end()] + inner.rstrip() + "".join(f", {key}" for key in keys.values()) + text[last:]


def _alike(back: Vehicle, vehicle: Vehicle) -> bool:
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

"""A user's vehicle.toml with some values changed: comments, units, order and all else stay (tomlkit).

vehicle_learned.toml: the user's own vehicle.toml with what was learnt put in; comments and units stay.

A vehicle.toml with what several dives have taught put in, and the tables ``[learnt]`` that the next ones add to.

Comments, units and all else stay. The tables are::

    [learnt]
    dives = [["dive_041", "5e2a91c0"], ..]      # what has been counted: name, and a number that tells its readings

    [learnt.sensors.dvl]
    described = [[{model = "white", sd = 0.01}], ..]   # before the first dive, by axis
    quick = [3.1, 1.4]                          # so many times as large, known within this factor
    slow = [1.2, 1.9]
    evidence = [[..], ..]                       # ln of the likelihood of all candidates

A vehicle.toml with calibrated constants put in; comments, units and all else stay.
"""

import math
import os
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import InlineTable, Table

from navfilter.foundation.quoting import one_line, toml_key, toml_text
from navfilter.io.vehicle_toml import (
    described_text,
    error_text,
    learnt_keys,
    read_vehicle,
    spellings,
    vehicle_file,
    write_vehicle,
)
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import learned_part
from navfilter.models.vehicle import Vehicle

#: Fields that a calibration sets.
_FIELDS = (
    "time_offset_s", "time_offset_sd_s", "lever_arm_b_m", "lever_arm_sd_m", "mounting_rad", "scale_sd",
    "misalignment_sd_rad", "bias_sd_rad", "deviation_sd_rad", "hard_iron_sd", "soft_iron_sd", "offset_sd_m",
)  # fmt: skip
#: Digits that are written: far finer than any sd.
_FIGURES = 7


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
    number = float(f"{math.degrees(value) if angle else value:.{_FIGURES}g}")
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


#: Evidence is written to so many digits behind the point [nat].
_DIGITS = 6
_TABLES = re.compile(r"(?:^#[^\n]*navfilter learn[^\n]*\n)?^\[\s*learnt\b.*?(?=^\[(?!\s*learnt\b)|\Z)", re.M | re.S)


def write_over_dives(
    vehicle: Vehicle,
    table: Mapping[str, Any],
    path: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
) -> bool:
    """Write a vehicle with the errors that several dives have taught, as an edited copy of the file that it came from.

    Parameters
    ----------
    vehicle : Vehicle
    table : dict
        "dives" (pairs of text), "sensors" (by name "described", "quick", "slow" and "evidence") and "together"
        (evidence, or None).
    path : path-like
    source : path-like, optional
        The vehicle.toml, or the folder that holds it. Default: all is written anew, in SI units.

    Returns
    -------
    bool
        Whether it is a copy with all comments; the file is laid out in an unusual way otherwise, and all was written
        anew.
    """
    count = len(table["dives"])
    remark = f"learnt over {count} dive{'s' * (count > 1)} by navfilter learn; before: [learnt] below"

    def edit(text: str) -> str:
        text = re.sub(r"^# learnt over [^\n]* by navfilter learn[^\n]*\n", "", _TABLES.sub("", text), flags=re.M)
        for name in table["sensors"]:
            for part, key, value in _places(vehicle, name):
                text = with_keys(text, part, {key: (key, value)}, remark)
        return f"{text.rstrip()}\n\n{_learnt_text(table)}"

    copied = write_edited(vehicle, path, source, edit)
    if not copied:
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(f"\n{_learnt_text(table)}")
    return copied


def _places(vehicle: Vehicle, name: str) -> list[tuple[tuple[str, ...], str, str]]:
    """Where the errors of a sensor stand: tables, key, and value as text."""
    if name in vehicle.sensors:
        sensor = vehicle.sensors[name]
        return [(("sensors", name), "error", error_text(sensor.error, sensor.axis_names))]
    found = []
    for unit, drive in vehicle.imus.items() or [("", vehicle.drive)]:
        table: tuple[str, ...] = ("imus", unit) if unit else ("drive",)
        part: Any = getattr(drive, name)
        if hasattr(part, "models"):
            found.append(((*table, name), "error", error_text(part.error, part.axis_names)))
        else:
            axes = ("roll", "pitch", "yaw") if name == "attitude" else ("x", "y", "z")
            found.append((table, name, error_text(part, axes)))
    return found


def _learnt_text(table: Mapping[str, Any]) -> str:
    """The tables as text."""
    dives = ", ".join(f"[{toml_text(name)}, {toml_text(digest)}]" for name, digest in table["dives"])
    lines = ["# Kept by navfilter learn, for the next dives to be added.", "[learnt]", f"dives = [{dives}]"]
    if table["together"] is not None:
        lines += [f"together = {_grid_text(table['together'])}"]
    for name, one in table["sensors"].items():
        lines += ["", f"[learnt.sensors.{toml_key(name)}]", f"described = {described_text(one['described'])}"]
        lines += [f"{key} = [{', '.join(repr(float(x)) for x in one[key])}]" for key in ("quick", "slow")]
        lines += [f"evidence = {_grid_text(one['evidence'])}"]
    return "\n".join(lines) + "\n"


def _grid_text(grid: Any) -> str:
    rows = np.round(np.asarray(grid, dtype=np.float64), _DIGITS).tolist()
    return "[\n" + "".join(f"  [{', '.join(map(repr, row))}],\n" for row in rows) + "]"


def write_learned(
    vehicle: Vehicle,
    path: str | os.PathLike[str],
    source: str | os.PathLike[str] | None = None,
    remarks: Mapping[str, str] | None = None,
) -> Path:
    """Write a vehicle that has learnt, as an edited copy of the file that it was read from.

    Parameters
    ----------
    vehicle : Vehicle
        See `navfilter.io.write.learned_vehicle`.
    path : path-like
    source : path-like, optional
        The vehicle.toml, or the folder that holds it. Only tables of ``model = "learned-arma"`` are changed, they get
        ``adopted`` and ``slow``; sensors that this run went without stay. Default: all is written anew, in SI units.
    remarks : dict of str to str, optional
        One line by sensor ("compass") or part of the drive ("gyro"), written above what has changed, as a comment.

    Returns
    -------
    Path

    Notes
    -----
    The copy is read back. Where it is not the vehicle, because the file is laid out in an unusual way, everything is
    written anew.
    """
    edit = partial(_edited, vehicle=vehicle, remarks=remarks or {})
    write_edited(vehicle, path, source, edit)
    return Path(path)


def _edited(text: str, vehicle: Vehicle, remarks: Mapping[str, str]) -> str:
    for name, sensor in vehicle.sensors.items():
        if any(learned_part(model) is not None for model in sensor.models):
            models = sensor.error if isinstance(sensor.error, tuple) else (sensor.error,)
            change = partial(_adopted, models=models, axes=sensor.axis_names)
            text = with_value(text, ("sensors", name), "error", change, remarks.get(name, ""))
    for name, drive in vehicle.imus.items() or [("", vehicle.drive)]:
        for part in dict.fromkeys(axis.rpartition("_")[0] for axis in drive.axis_names):
            axes = [k for k, axis in enumerate(drive.axis_names) if axis.rpartition("_")[0] == part]
            models = tuple(drive.models[k] for k in axes)
            learnt = [learned for model in models if (learned := learned_part(model)) is not None]
            if part and any(learned.model is not None for learned in learnt):
                models = models[:1] if len(set(models)) == 1 else models
                change = partial(_adopted, models=models, axes=("x", "y", "z"))
                text = with_value(text, ("imus", name) if name else ("drive",), part, change, remarks.get(part, ""))
    return text


def _adopted(value: Any, models: tuple[ErrorModel, ...], axes: tuple[str, ...]) -> Any:
    """The value of an error with what its learnt parts have adopted: of one axis, of all alike, or of each."""
    by_axis = isinstance(value, dict) and "model" not in value
    if not by_axis and len(models) == 1:
        return _with_adopted(value, models[0])
    every = models * len(axes) if len(models) == 1 else models
    each = {
        a: _with_adopted(value[a] if by_axis else tomlkit.value(value.as_string()), m)
        for a, m in zip(axes, every, strict=True)
    }
    return value if by_axis else tomlkit.value("{" + ", ".join(f"{a} = {v.as_string()}" for a, v in each.items()) + "}")


def _with_adopted(value: Any, model: ErrorModel) -> Any:
    """The value of one axis with what its learnt part has adopted."""
    part = learned_part(model)
    if part is None:
        return value
    tables: list[Any] = [value] if isinstance(value, dict) else value
    table = next(table for table in tables if table["model"] == "learned-arma")
    for key in ("adopted", "slow", "frozen"):
        table.pop(key, None)
    for key, text in learnt_keys(part).items():
        table.append(key, tomlkit.value(text))
    return value


#: What a file raises that has no such place, or that is laid out in a way that the library does not follow.
UNCLEAR = (LookupError, ValueError, TypeError, AttributeError)


def write_edited(
    vehicle: Vehicle,
    path: str | os.PathLike[str],
    source: str | os.PathLike[str] | None,
    edit: Callable[[str], str],
    same: Callable[[Vehicle, Vehicle], bool] | None = None,
) -> bool:
    """Write a vehicle as an edited copy of the file that it was read from.

    Parameters
    ----------
    vehicle : Vehicle
    path : path-like
    source : path-like or None
        The vehicle.toml, or the folder that holds it; None: all is written anew.
    edit : callable
        Takes its text, returns the copy's; raises one of `UNCLEAR` where it cannot.
    same : callable, optional
        Whether this vehicle is the one that was read back; default: as a value.

    Returns
    -------
    bool
        Whether it is a copy. Else the file is laid out in an unusual way, and all was written anew, in SI units.
    """
    if source is not None:
        try:
            text = edit(vehicle_file(source).read_text(encoding="utf-8"))
            Path(path).write_text(text, encoding="utf-8")
            if (same or _same)(vehicle, read_vehicle(path)):
                return True
        except UNCLEAR:
            pass
    write_vehicle(vehicle, path)
    return False


def _same(vehicle: Vehicle, back: Vehicle) -> bool:
    """Whether all that a vehicle has was read back; a file may hold further sensors."""
    return back.driving == vehicle.driving and all(back.sensors.get(name) == s for name, s in vehicle.sensors.items())


def with_keys(text: str, part: tuple[str, ...], keys: Mapping[str, tuple[str, str]], remark: str = "") -> str:
    """The text of a vehicle.toml with keys of one table set.

    Parameters
    ----------
    text : str
    part : tuple of str
        The table: ("sensors", "dvl"), ("drive",).
    keys : dict of str to (str, str)
        Key and value, as TOML, by the field that they set; however it was spelled before.
    remark : str
        A comment above them.

    Raises
    ------
    LookupError, ValueError, TypeError, AttributeError
        See `UNCLEAR`.
    """
    if not keys:
        return text
    document, table = _opened(text, part)
    new = []
    for field, (key, value) in keys.items():
        item = tomlkit.item(tomlkit.value(value))
        for old in [spelling for spelling in spellings(field) if spelling in table]:
            item.trivia.comment_ws, item.trivia.comment = table[old].trivia.comment_ws, table[old].trivia.comment
            del table[old]
        item.trivia.trail = "\n"
        new.append((key, item))
    if isinstance(table, InlineTable):
        for key, item in new:
            table.append(key, item)
    else:
        _above(new[0][1], remark)
        # what stands behind the last key of a section is a comment on the next one
        body = table.value.body
        last = max((k for k, (key, item) in enumerate(body) if key and not isinstance(item, Table)), default=-1)
        if last >= 0 and not body[last][1].trivia.trail.endswith("\n"):
            body[last][1].trivia.trail += "\n"
        body[last + 1 : last + 1] = [(tomlkit.key(key), item) for key, item in new]
    return tomlkit.dumps(document)


def with_value(text: str, part: tuple[str, ...], key: str, change: Callable[[Any], Any], remark: str = "") -> str:
    """The text of a vehicle.toml with one value changed: `change` takes it, changes it, and returns it or another."""
    document, table = _opened(text, part)
    table[key] = change(table[key])
    _above(table[key], remark)
    return tomlkit.dumps(document)


def _opened(text: str, part: tuple[str, ...]) -> tuple[Any, Any]:
    document: Any = tomlkit.parse(text)
    table = document
    for name in part:
        table = table[name]
    return document, table


def _above(item: Any, remark: str) -> None:
    """Put a comment above a key."""
    if remark:
        item.trivia.indent = f"# {one_line(remark)}\n{item.trivia.indent}"

"""vehicle_learned.toml: the user's own vehicle.toml with what was learnt put in; comments and units stay."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

from navfilter.foundation.quoting import one_line
from navfilter.io.vehicle_toml import VehicleError, learnt_keys, read_vehicle, vehicle_file, write_vehicle
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import learned_part
from navfilter.models.vehicle import Vehicle

_LEARNED = re.compile(r"""\{[^{}]*\bmodel\s*=\s*["']learned-arma["']""")


class _Unclear(Exception):
    """The text is laid out in a way that is not followed here."""


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
    The copy is read back. Where it is not the vehicle, because the file is laid out in an unusual way (one table per
    axis, a multi-line string), everything is written anew.
    """
    path = Path(path)
    if source is not None:
        file = vehicle_file(source)
        try:
            path.write_text(_edited(file.read_text(encoding="utf-8"), vehicle, remarks or {}), encoding="utf-8")
            if _same(read_vehicle(path), vehicle):
                return path
        except (_Unclear, VehicleError):
            pass
    return write_vehicle(vehicle, path)


def _same(back: Vehicle, vehicle: Vehicle) -> bool:
    return back.driving == vehicle.driving and all(back.sensors.get(name) == s for name, s in vehicle.sensors.items())


def _edited(text: str, vehicle: Vehicle, remarks: Mapping[str, str]) -> str:
    for name, sensor in vehicle.sensors.items():
        if any(learned_part(model) is not None for model in sensor.models):
            models = sensor.error if isinstance(sensor.error, tuple) else (sensor.error,)
            table = rf"sensors\s*\.\s*(?:{re.escape(name)}|\"{re.escape(name)}\")"
            text = _with_models(text, (table, "error"), models, sensor.axis_names, remarks.get(name))
    for name, drive in vehicle.imus.items() or [("", vehicle.drive)]:
        table = rf"imus\s*\.\s*(?:{re.escape(name)}|\"{re.escape(name)}\")" if name else "drive"
        for part in dict.fromkeys(axis.rpartition("_")[0] for axis in drive.axis_names):
            axes = [k for k, axis in enumerate(drive.axis_names) if axis.rpartition("_")[0] == part]
            models = tuple(drive.models[k] for k in axes)
            learnt = [learned for model in models if (learned := learned_part(model)) is not None]
            if part and any(learned.model is not None for learned in learnt):
                models = models[:1] if len(set(models)) == 1 else models
                text = _with_models(text, (table, part), models, ("x", "y", "z"), remarks.get(part))
    return text


def _with_models(
    text: str, place: tuple[str, str], models: tuple[ErrorModel, ...], axes: tuple[str, ...], remark: str | None
) -> str:
    """The text with the value of one key changed: a table and a key, the models of the key's axes."""
    table, key = place
    header = re.search(rf"^[ \t]*\[\s*{table}\s*\][^\n]*\n", text, flags=re.MULTILINE)
    if header is None:
        raise _Unclear
    following = re.search(r"^[ \t]*\[", text[header.end() :], flags=re.MULTILINE)
    end = header.end() + following.start() if following else len(text)
    found = re.compile(rf"^[ \t]*{key}[ \t]*=[ \t]*", flags=re.MULTILINE).search(text, header.end(), end)
    if found is None:
        raise _Unclear
    first, last = found.end(), closing(text, found.end())
    value = text[first:last]
    if len(models) == 1:
        new = _with_adopted(value, models[0])
    elif value.startswith("{") and not _LEARNED.match(value):
        raise _Unclear
    else:
        each = (f"{axis} = {_with_adopted(value, model)}" for axis, model in zip(axes, models, strict=True))
        new = "{" + ", ".join(each) + "}"
    comment = f"# {one_line(remark)}\n" if remark else ""
    return text[: found.start()] + comment + text[found.start() : first] + new + text[last:]


def _with_adopted(value: str, model: ErrorModel) -> str:
    """The value of one axis with what its learnt part has adopted."""
    part, table = learned_part(model), _LEARNED.search(value)
    if part is None or table is None:
        raise _Unclear
    last = closing(value, table.start()) - 1
    inner = value[table.start() : last]
    for key in ("adopted", "slow", "frozen"):
        inner = _without(inner, key)
    added = "".join(f", {key} = {text}" for key, text in learnt_keys(part).items())
    return value[: table.start()] + inner.rstrip() + added + value[last:]


def _without(table: str, key: str) -> str:
    """The text of an inline table without one of its keys."""
    found = re.search(rf",?\s*\b{key}\s*=\s*", table)
    if found is None:
        return table
    last = closing(table, found.end())
    return table[: found.start()] + table[last:]


def closing(text: str, start: int) -> int:
    """End of the value that starts here: behind the bracket that closes it, or at the comma, comment or line's end."""
    depth, i = 0, start
    while i < len(text):
        c = text[i]
        if c in "\"'":
            i = text.index(c, i + 1)
        elif c == "#" and depth:
            i = text.index("\n", i)
        elif c in "[{":
            depth += 1
        elif c in "]}":
            depth -= 1
            if depth == 0:
                return i + 1
            if depth < 0:
                return i
        elif not depth and c in ",#\n":
            return i
        i += 1
    return len(text)

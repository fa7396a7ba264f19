"""vehicle_learned.toml: the user's own vehicle.toml with what was learnt put in; comments and units stay."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import tomlkit

from navfilter.io.toml_editing import with_value, write_edited
from navfilter.io.vehicle_toml import learnt_keys
from navfilter.models.error_models import ErrorModel
from navfilter.models.learned_arma import learned_part
from navfilter.models.vehicle import Vehicle


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

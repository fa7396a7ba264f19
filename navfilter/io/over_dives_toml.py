"""A vehicle.toml with what several dives have taught put in, and the tables ``[learnt]`` that the next ones add to.

Comments, units and all else stay. The tables are::

    [learnt]
    dives = [["dive_041", "5e2a91c0"], ..]      # what has been counted: name, and a number that tells its readings

    [learnt.sensors.dvl]
    described = [[{model = "white", sd = 0.01}], ..]   # before the first dive, by axis
    quick = [3.1, 1.4]                          # so many times as large, known within this factor
    slow = [1.2, 1.9]
    evidence = [[..], ..]                       # ln of the likelihood of all candidates
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.quoting import toml_key, toml_text
from navfilter.io.toml_editing import with_keys, write_edited
from navfilter.io.vehicle_toml import described_text, error_text
from navfilter.models.vehicle import Vehicle

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

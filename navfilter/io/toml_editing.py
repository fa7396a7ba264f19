"""A user's vehicle.toml with some values changed: comments, units, order and all else stay (tomlkit)."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import InlineTable, Table

from navfilter.foundation.quoting import one_line
from navfilter.io.vehicle_keys import spellings
from navfilter.io.vehicle_toml import read_vehicle, vehicle_file, write_vehicle
from navfilter.models.vehicle import Vehicle

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

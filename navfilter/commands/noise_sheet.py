"""``navfilter identify --imu``: its own arguments and what it does."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.commands.console import complain, show, unpacked_bytes

if TYPE_CHECKING:
    from navfilter.io.inertial import ImuRecord
    from navfilter.io.table import TableOptions

OK, FOUND = 0, 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a noise sheet."""
    unit = parser.add_argument_group("an inertial unit")
    unit.add_argument("--imu", action="store_true", help="a noise sheet of all axes, from a record at rest")
    for name, example in (("gyro", "deg/s"), ("accel", "g")):
        about = "its columns of a table (default: found by their names)"
        unit.add_argument(f"--{name}", type=_three, default=(), metavar="X,Y,Z", help=about)
        about = f'their unit; of raw counts with its factor, "0.05 {example}"'
        unit.add_argument(f"--{name}-unit", type=_quantity, default="", metavar="U", help=about)


def _three(text: str) -> tuple[str, ...]:
    parts = tuple(part.strip() for part in text.split(","))
    if len(parts) != 3 or not all(parts):
        raise argparse.ArgumentTypeError(f"must be three columns X,Y,Z, found '{text}'")
    return parts


def _quantity(text: str) -> str:
    from navfilter.io.inertial import size_of

    try:
        size_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def run(options: argparse.Namespace, folder: Path | None, say: Callable[[str], Any]) -> int:
    """Read, find the noise, write, print."""
    from navfilter.identification.noise_sheet import NotAtRest, noise_sheet
    from navfilter.identification.noise_sheet_text import sheet_dict, sheet_text

    say("reading")
    record = _record(options)
    try:
        sheet = noise_sheet(record, say)
    except NotAtRest as error:
        say("")
        complain(f"navfilter: {error}")
        return FOUND
    if folder is not None:
        from navfilter.identification.noise_sheet_page import write_sheet

        say("drawing")
        write_sheet(sheet, record, folder)
    say("")
    if options.json:
        show(json.dumps(sheet_dict(sheet), indent=1))
    elif not options.quiet:
        show(sheet_text(sheet))
        if folder is not None:
            files = "identify.html (open this one), identify.json, drive.toml, figures (.svg)"
            show(f"Written to {folder}{os.sep}: {files}")
    if sheet.moving:
        complain(f"navfilter: {sheet.verdict}")
        return FOUND
    return OK


def _record(options: argparse.Namespace) -> ImuRecord:
    from navfilter.io.inertial import ImuColumns, read_imu

    units, time = (options.gyro_unit, options.accel_unit), (options.time_column or "", options.time_unit)
    columns = ImuColumns(options.gyro, options.accel, *units, *time, options.rate_hz)
    return read_imu(options.file, columns, layout(options), unpacked_bytes(options)).part(options.from_s, options.to_s)


def layout(options: argparse.Namespace) -> TableOptions:
    """How the file that was given is laid out."""
    from navfilter.io.table import TableOptions

    keys = ("table", "transpose", "skip_lines", "skip_rows", "topic")
    return TableOptions(**{key: getattr(options, key) for key in keys})

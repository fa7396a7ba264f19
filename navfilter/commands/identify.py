"""``navfilter identify``: its arguments and what it does. Everything heavy is imported where it is used."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.commands import console

if TYPE_CHECKING:
    from navfilter.io.inertial import ImuRecord
    from navfilter.io.table import TableOptions

#: Records longer than this get a progress in tenths.
LONG = 100_000
OK, FOUND = 0, 1


def known_to(module: str, name: str) -> Callable[[str], str]:
    """An argument type: text that a function takes, which is imported when there is one."""

    def checked(text: str) -> str:
        try:
            getattr(importlib.import_module(module), name)(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
        return text

    return checked


def order(text: str) -> tuple[int, int]:
    """The order of an ARMA model, as P,Q."""
    parts = [part.strip() for part in text.strip("() ").split(",")]
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"must be P,Q such as 2,1, found '{text}'")
    return console.whole(parts[0]), console.whole(parts[1])


def run(options: argparse.Namespace) -> int:
    """Identify a sensor's error model, or the noise of an inertial unit, from a recording at rest.

    FILE is a table (.csv, .txt, .dat, also .gz, .xz, .bz2), .npz, .npy or .mat, or one stream of a mission:
      dive_042:depth, dive_042:imu.rate_x

    written to --out:
      identify.html   everything on one page that works offline
      identify.json   order criteria, coefficients with covariance, poles, zeros, whiteness, Allan deviation, reading
      *.svg           the figures
      drive.toml      with --imu: the [drive] table for a vehicle.toml

    --imu takes all axes of an inertial unit at once, from a mission, a log (ROS bag, PX4, ArduPilot) or a table, uses
    what of the record is at rest, and makes a noise sheet: angle and velocity random walk, bias instability, rate
    random walk, quantisation, lines, Allan deviations, in the units of data sheets and with uncertainties, and the
    [drive] table of a vehicle.toml. Exit code 1 when the record is not at rest.

    examples:
      navfilter identify still.csv --column gyro_x --rate-hz 100 --unit deg/s --out gyro_x
      navfilter identify gps.dat.gz --column 3 --time-column 1 --decimate 10 --out north
      navfilter identify still.csv --column heading --rate-hz 8 --online --window 4000 --out tracks
      navfilter identify still.mcap --imu --out sheet
      navfilter identify still.csv --imu --rate-hz 200 --gyro wx,wy,wz --gyro-unit deg/s --out sheet
    """
    if not 0 <= options.difference <= 2:
        raise ValueError(f"--difference must be 0, 1 or 2, found {options.difference}.")
    if not options.reject >= 0.0:
        raise ValueError(f"--reject must be a number >= 0, found {options.reject}.")
    if options.online and (options.imu or options.json):
        raise ValueError("--online writes its own files: leave --imu and --json out.")
    if options.out is None and not (options.imu or options.json):
        raise ValueError("--out DIR is needed: the folder to write to.")
    folder = None if options.out is None else console.output_folder(options.out, options.force)
    with _busy(options.quiet or options.json) as say:
        if options.imu:
            return run_sheet(options, folder, say)
        series = _read(options)
        if options.online and folder is not None:
            return _online(options, series, folder, say)
        return _batch(options, series, folder, say)


def _read(options: argparse.Namespace) -> Any:
    from navfilter.io.inertial import read_series
    from navfilter.io.units import unit

    series = read_series(
        options.file,
        options.column,
        rate_hz=options.rate_hz,
        time_column=options.time_column,
        time_unit=options.time_unit,
        options=layout(options),
        unpacked_bytes=console.unpacked_bytes(options),
    )
    if series.source != options.file and unit(options.unit).factor != 1.0:
        raise ValueError(f"{options.file} is a stream of a mission, in SI: leave --unit {options.unit} out.")
    return series


def _conditions(options: argparse.Namespace) -> dict[str, Any]:
    chosen = {name: getattr(options, name) for name in ("from_s", "to_s", "decimate", "seasonal_lag", "reject")}
    return chosen | ({} if options.max_samples is None else {"max_samples": options.max_samples})


def _batch(options: argparse.Namespace, series: Any, folder: Path | None, say: Any) -> int:
    from navfilter.identification.identify import identify
    from navfilter.identification.report import as_dict, summary_text, write_identification

    how = {name: getattr(options, name) for name in ("max_p", "max_q", "order", "difference", "detrend", "unit")}
    found = identify(series, say=say, **how, **_conditions(options))
    if folder is not None:
        say("drawing")
        write_identification(found, folder, options.unit)
    say("")
    if options.json:
        console.show(json.dumps(as_dict(found, options.unit), indent=1))
    elif not options.quiet:
        console.show(f"{series.name} of {series.source}")
        console.show(summary_text(found, options.unit))
        if folder is not None:
            console.show(f"Written to {folder}{os.sep}: identify.html (open this one), identify.json, figures (.svg)")
    return 0


def _online(options: argparse.Namespace, series: Any, folder: Path, say: Any) -> int:
    from navfilter.identification.online import track_online, tracks_text, write_tracks

    done = 0

    def progress(samples: int) -> None:
        nonlocal done
        before, done = done, done + samples
        tenth = series.value.size / options.decimate / 10.0
        if series.value.size > LONG and int(done / tenth) > int(before / tenth):
            say(f"running the online estimator, {10 * int(done / tenth)} %")

    say("running the online estimator")
    how = {"order": options.order, "difference": options.difference, "progress": progress}
    tracks = track_online(series, options.window, **how, **_conditions(options))
    say("drawing")
    write_tracks(tracks, folder, options.unit)
    say("")
    if not options.quiet:
        console.show(f"{series.name} of {series.source}, windows of {options.window} samples")
        console.show(tracks_text(tracks, options.unit))
        for note in tracks.data.notes:
            console.show(f"note: {note}")
        written = "identify.html (open this one), identify.json, tracks.csv, tracks.svg"
        console.show(f"Written to {folder}{os.sep}: {written}")
    return 0


@contextmanager
def _busy(quiet: bool) -> Iterator[Any]:
    """Say what is going on and for how long, on a terminal; one line per step elsewhere."""
    if quiet:
        yield lambda text: None
        return
    if not sys.stderr.isatty():
        yield lambda text: console.complain(f"{text} ...") if text else None
        return
    from tqdm import tqdm

    done = threading.Event()
    with tqdm(bar_format="{desc} ... {elapsed}", leave=False) as bar:

        def tick() -> None:
            while not done.wait(0.25):
                bar.refresh()

        def say(text: str) -> None:
            bar.set_description_str(text)
            if not text:
                bar.clear()
                done.set()

        clock = threading.Thread(target=tick, daemon=True)
        clock.start()
        try:
            yield say
        finally:
            done.set()
            clock.join()


# --- the noise sheet of an inertial unit ------------------------------------------------------------------------------


def three(text: str) -> tuple[str, ...]:
    """Three columns, as X,Y,Z."""
    parts = tuple(part.strip() for part in text.split(","))
    if len(parts) != 3 or not all(parts):
        raise argparse.ArgumentTypeError(f"must be three columns X,Y,Z, found '{text}'")
    return parts


#: Ways of reading its arguments.
KINDS: dict[str, Callable[[str], Any]] = {
    "unit": known_to("navfilter.io.units", "unit"), "size": known_to("navfilter.io.inertial", "size_of"),
    "three": three, "order": order,
}  # fmt: skip


def run_sheet(options: argparse.Namespace, folder: Path | None, say: Callable[[str], Any]) -> int:
    """Read, find the noise, write, print."""
    from navfilter.identification.noise_sheet import NotAtRest, noise_sheet
    from navfilter.identification.noise_sheet_text import sheet_dict, sheet_text

    say("reading")
    record = _record(options)
    try:
        sheet = noise_sheet(record, say)
    except NotAtRest as error:
        say("")
        console.complain(f"navfilter: {error}")
        return FOUND
    if folder is not None:
        from navfilter.identification.report import write_sheet

        say("drawing")
        write_sheet(sheet, record, folder)
    say("")
    if options.json:
        console.show(json.dumps(sheet_dict(sheet), indent=1))
    elif not options.quiet:
        console.show(sheet_text(sheet))
        if folder is not None:
            files = "identify.html (open this one), identify.json, drive.toml, figures (.svg)"
            console.show(f"Written to {folder}{os.sep}: {files}")
    if sheet.moving:
        console.complain(f"navfilter: {sheet.verdict}")
        return FOUND
    return OK


def _record(options: argparse.Namespace) -> ImuRecord:
    from navfilter.io.inertial import ImuColumns, read_imu

    units, time = (options.gyro_unit, options.accel_unit), (options.time_column or "", options.time_unit)
    columns = ImuColumns(options.gyro or (), options.accel or (), *units, *time, options.rate_hz)
    return read_imu(options.file, columns, layout(options), console.unpacked_bytes(options)).part(
        options.from_s, options.to_s
    )


def layout(options: argparse.Namespace) -> TableOptions:
    """How the file that was given is laid out."""
    from navfilter.io.table import TableOptions

    keys = ("table", "transpose", "skip_lines", "skip_rows", "topic")
    return TableOptions(**{key: getattr(options, key) for key in keys})

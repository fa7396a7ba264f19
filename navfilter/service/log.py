"""The folder of a log: a mission for `navfilter replay`, and all that `navfilter run` needs to give its output again.

``mission.toml`` and ``vehicle.toml`` are written first; ``readings.jsonl`` then grows line by line (see
`navfilter.io.json_lines`).
"""

import contextlib
import datetime
import errno
import fcntl
import itertools
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from navfilter.foundation.quoting import toml_key, toml_text
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.json_lines import Item, LineParser, Note, log_lines
from navfilter.models.mission import MissionError
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.snapshot import fingerprint
from navfilter.service.protocol import event_line
from navfilter.service.session import Options

LOG_FILE = "readings.jsonl"


def prepare_log(
    folder: Path, vehicle: Vehicle, options: Options, *, resume: str | None, tell: Callable[[str], None]
) -> BinaryIO:
    """Make the folder of a log, or take one that was broken off; it is ours until the file is closed.

    Parameters
    ----------
    folder : Path
    vehicle : Vehicle
    options : Options
    resume : {"strict", "best"}, optional
        Whether a log may be there already, and whether it may be that of another vehicle (see
        `navfilter.service.loop`); the half line that a crash left at its end is then cut off.
    tell : callable
        Takes a sentence about what does not fit.

    Returns
    -------
    file
        The log, unbuffered, at its end.

    Raises
    ------
    ValueError
        When there is a log and `resume` is None, when another process is writing to it, or when it is that of another
        vehicle and `resume` is "strict".
    OSError
        When the folder cannot be written, or where the log is to be there is something else: a link, a pipe, a folder.
    """
    file = _locked(folder)
    try:
        begun = os.fstat(file.fileno()).st_size > 0
        if begun and resume is None:
            raise ValueError(f"{folder} holds a log already. Give another folder, or --resume to continue that run.")
        other = _difference(folder, vehicle) if begun else ""
        if other and resume == "strict":
            raise ValueError(
                f"{folder}: {other}. Give the vehicle of that run, or --resume=best to feed its log to this one."
            )
        if other:
            tell(f"{other}: the whole log is fed to the vehicle that was given now")
        if other or not begun:
            _describe(folder, vehicle, options)
        _cut_half_line(file)
    except BaseException:
        file.close()
        raise
    return file


def remade_log(old: BinaryIO, folder: Path, vehicle: Vehicle, options: Options) -> BinaryIO:
    """Write a log anew that was deleted while `old` is still open: everything that it holds, and its descriptions.

    Raises
    ------
    OSError
        When that is impossible; `old` then stays as it is.
    """
    file, at = _locked(folder), 0
    try:
        _describe(folder, vehicle, options)
        while block := os.pread(old.fileno(), 1 << 20, at):
            at += len(block)
            view = memoryview(block)
            while view:
                view = view[file.write(view) or 0 :]
    except BaseException:
        file.close()
        raise
    old.close()
    return file


def _locked(folder: Path) -> BinaryIO:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOG_FILE
    if path.is_symlink():  # it would be written to wherever it leads
        raise _no_file(path)
    # not blocking: nobody may ever come to the other end of a pipe
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    file = os.fdopen(handle, "a+b", buffering=0)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise _no_file(path)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise ValueError(
            f"{folder}: another process is writing this log. Stop it first, or log to another folder."
        ) from None
    except BaseException:
        file.close()
        raise
    return file


def _no_file(path: Path) -> OSError:
    words = "is no file of its own (but a link, a pipe, ...). Move it away, or log to another folder"
    return OSError(errno.EINVAL, words, str(path))


def _describe(folder: Path, vehicle: Vehicle, options: Options) -> None:
    """Write vehicle.toml and mission.toml, and sync them with their folder; what stood there is put aside."""
    with tempfile.TemporaryDirectory(prefix=".navfilter-", dir=folder) as beside:
        write_vehicle(vehicle, Path(beside) / "vehicle.toml")
        (Path(beside) / "mission.toml").write_text(_mission_toml(folder, vehicle, options.date), encoding="utf-8")
        for new in Path(beside).iterdir():
            old = folder / new.name
            if not (is_own_file(old) and old.read_bytes() == new.read_bytes()):
                _put_aside(old)
                new.replace(old)
    for name in ("vehicle.toml", "mission.toml", "."):
        handle = os.open(folder / name, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _difference(folder: Path, vehicle: Vehicle) -> str:
    """Why a log is not that of a vehicle; empty where it is."""
    unreadable = "the vehicle.toml of this log cannot be read"
    if not is_own_file(folder / "vehicle.toml"):
        return unreadable
    try:
        logged = read_vehicle(folder)
    except ValueError:
        return unreadable
    if fingerprint(logged) == fingerprint(vehicle):
        return ""
    drives = [(vehicle.drive, vehicle.imus, vehicle.dead_reckoning_lane) for vehicle in (logged, vehicle)]
    drive = ["the drive"] * (drives[0] != drives[1])
    every = {**logged.sensors, **vehicle.sensors}
    names = [name for name in every if logged.sensors.get(name) != vehicle.sensors.get(name)]
    return f"this log is of another vehicle ({', '.join(drive + names) or 'its name'} differs)"


def is_own_file(path: Path) -> bool:
    """Whether this is a file and no link to one."""
    return path.is_file() and not path.is_symlink()


def _put_aside(path: Path) -> None:
    """Keep whatever stands there under another name."""
    names = (path.with_name(f"{path.stem}.before{number or ''}{path.suffix}") for number in itertools.count())
    with contextlib.suppress(OSError):
        path.rename(next(name for name in names if not os.path.lexists(name)))


def _cut_half_line(file: BinaryIO) -> None:
    end = file.seek(0, os.SEEK_END)
    while end:
        begin = max(0, end - 65536)
        feed = os.pread(file.fileno(), end - begin, begin).rfind(b"\n")
        if feed >= 0:
            end = begin + feed + 1
            break
        end = begin
    file.truncate(end)


def _mission_toml(folder: Path, vehicle: Vehicle, date: datetime.date | None) -> str:
    lines = [
        "# Written by navfilter run. The readings stand in the order of their arrival;"
        " navfilter run --replay-log feeds them again.",
        f"name = {toml_text(folder.resolve().name)}",
        *([] if date is None else [f"date = {date.isoformat()}"]),
        "",
        "[log]",
        f'file = "{LOG_FILE}"',
        "",
        "[log.columns]",
    ]
    return (
        "\n".join(lines + [f"{toml_key(name)} = {json.dumps(columns)}" for name, columns in _columns(vehicle).items()])
        + "\n"
    )


def _columns(vehicle: Vehicle) -> dict[str, tuple[str, ...]]:
    """Names of the columns of every stream that the vehicle listens to."""
    corrections = {name: sensor.stream_columns() for name, sensor in vehicle.sensors.items() if not sensor.from_drive}
    units = {name: unit.stream_columns()["imu"] for name, unit in vehicle.imus.items()}
    return (units or vehicle.drive.stream_columns()) | corrections


def run_note(options: Options, **more: Any) -> bytes:
    """The note with which each run begins its part of the log."""
    return event_line("run", **options.to_json(), **more)


def log_items(path: Path, vehicle: Vehicle, offset: int = 0) -> Iterator[Item]:
    """The lines of a log, to be fed again; damaged ones are left out."""
    parser = LineParser(vehicle, notes=True)
    for line in log_lines(path, offset):
        item = parser.parse(line)
        if item is not None and item.raw.rstrip(b"\n") == line.strip():
            yield item


def logged_options(path: Path) -> Options:
    """How the run that wrote a log was asked for.

    Raises
    ------
    MissionError
        When the log does not begin as logs do.
    """
    if not path.is_file():
        raise MissionError(f"{path}: no such file. A log of navfilter run is a folder with a {LOG_FILE}.")
    first = LineParser(notes=True).parse(next(log_lines(path), b""))
    if not isinstance(first, Note) or first.event != "run":
        raise MissionError(f"{path} does not begin like a log of navfilter run.")
    return Options.from_json(first.fields)

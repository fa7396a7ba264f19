"""ArduPilot logs, read with pymavlink: DataFlash (.bin) and telemetry (.tlog).

DataFlash: a topic is a message (``ATT``), with ``[0]``, ``[1]`` where the log says that it has instances (``IMU[0]``).
Its units are those that the log itself states (UNIT, MULT). Telemetry: a topic is a MAVLink message and who sent it
(``ATTITUDE[1.1]``: system and component); ``ATTITUDE`` is enough where only one sends it. Its units are MAVLink's.

``log_time`` is UTC where the log knows it (DataFlash with GPS; telemetry: when the message was received), else the time
since the autopilot started.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pymavlink import DFReader, mavutil

from navfilter.io.logs.choosing import Wanted
from navfilter.io.logs.progress import bar
from navfilter.mission import MissionError

__all__ = ["records"]

#: Number of its descriptor, by POSIX and in Windows' runtime.
_STANDARD_ERROR = 2
#: Units as these logs write them -> as a mission.toml does.
_UNITS = {
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "m/s/s": "m/s^2",
    "µs": "us",
    "mGauss": "mgauss",
    "Gauss": "gauss",
    "mG": "mg",
    "degC": "degC",
}
#: Messages whose position change is the reading of a velocity log, with their fields: interval, its unit [s], changes.
_DELTAS: dict[str, tuple[str, float, tuple[str, str, str]]] = {
    "VISO": ("dt", 1.0, ("PosDX", "PosDY", "PosDZ")),
    "VISION_POSITION_DELTA": ("time_delta_usec", 1e-6, ("position_delta[0]", "position_delta[1]", "position_delta[2]")),
}


#: Messages that describe the log itself.
_DESCRIPTIONS = ("FMT", "FMTU", "UNIT", "MULT")


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    telemetry = path.suffix.lower() == ".tlog"
    messages = _telemetry(path, tally) if telemetry else _dataflash(path, wanted, tally)
    for topic, message in messages:
        if not wanted(topic):
            continue
        if topic not in wanted.units:
            stated = (
                message.fieldunits_by_name
                if telemetry
                else dict(zip(_fields(message), message.fmt.units or (), strict=False))
            )
            wanted.units[topic] = {
                field: _UNITS.get(unit, unit) for field, unit in stated.items() if unit not in ("", "instance")
            }
        name = message.get_type()
        yield topic, message._timestamp, _with_velocity(name, message) if name in _DELTAS else message


def _dataflash(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, Any]]:
    try:
        with _native_messages(tally):
            log = _quietly(lambda: DFReader.DFReader_binary(str(path)), Counter())
    except Exception as error:  # struct's, mmap's and its own plain Exception on broken files
        raise _unreadable(path, error) from None
    # Others are skipped without being decoded; a clock without GPS needs none of them.
    names = [name for name in log.name_to_id if name not in _DESCRIPTIONS and wanted.family(name)]
    total = sum(log.counts[log.name_to_id[name]] for name in names)
    for message in bar(
        iter(lambda: _quietly(lambda: log.recv_match(type=names), tally), None), path, total, "messages"
    ):
        kind = message.fmt
        instance = kind.instance_field
        yield kind.name if instance is None else f"{kind.name}[{getattr(message, instance)}]", message
    log.close()


def _telemetry(path: Path, tally: Counter[str]) -> Iterator[tuple[str, Any]]:
    try:
        log = mavutil.mavlogfile(str(path), notimestamps=False)
    except OSError as error:
        raise _unreadable(path, error) from None
    while True:
        try:
            message = log.recv_msg()
        except Exception as error:  # what a damaged stream makes the decoder raise differs by dialect
            tally[f"place where the log is damaged, nothing read behind it ({error})"] += 1
            break
        if message is None:
            break
        if message.get_type() == "BAD_DATA":
            tally["messages with a wrong checksum or of an unknown kind left out"] += 1
            continue
        yield f"{message.get_type()}[{message.get_srcSystem()}.{message.get_srcComponent()}]", message
    log.close()


def _quietly(call: Callable[[], Any], tally: Counter[str]) -> Any:
    """Call the library, which prints what is wrong with a log: counted instead."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        found = call()
    if said.tell():
        tally["places with damaged messages left out"] += said.getvalue().count("\n")
    return found


@contextlib.contextmanager
def _native_messages(tally: Counter[str]) -> Iterator[None]:
    """What the compiled part of the library writes straight to the standard error stream: counted instead of shown."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as said:
        shown = os.dup(_STANDARD_ERROR)
        os.dup2(said.fileno(), _STANDARD_ERROR)
        try:
            yield
        finally:
            os.dup2(shown, _STANDARD_ERROR)
            os.close(shown)
        said.seek(0)
        tally["bytes between messages skipped"] += sum(b"bad header" in line for line in said)


def _fields(message: Any) -> list[str]:
    fields: list[str] = message.get_fieldnames()
    return fields


def _with_velocity(name: str, message: Any) -> dict[str, Any]:
    interval, unit_s, changes = _DELTAS[name]
    record: dict[str, Any] = {}
    for field in _fields(message):
        value = getattr(message, field)
        record |= {f"{field}[{k}]": one for k, one in enumerate(value)} if isinstance(value, list) else {field: value}
    seconds = unit_s * record[interval]
    for axis, change in zip("xyz", changes, strict=True):
        record[f"velocity_{axis}"] = record[change] / seconds if seconds > 0 else None
    return record


def _unreadable(path: Path, error: Exception) -> MissionError:
    reason = re.sub(r"\s+", " ", str(error) or type(error).__name__).rstrip(".")
    return MissionError(f"{path} cannot be read as an ArduPilot log: {reason}.")

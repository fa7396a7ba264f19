"""ArduPilot logs: DataFlash (.bin, see `dataflash`) and telemetry (.tlog), read with pymavlink.

DataFlash: a topic is a message (``ATT``), with ``[0]``, ``[1]`` where the log says that it has instances (``IMU[0]``).
Its units are those that the log itself states (UNIT, MULT). Telemetry: a topic is a MAVLink message and who sent it
(``ATTITUDE[1.1]``: system and component); ``ATTITUDE`` is enough where only one sends it. Its units are MAVLink's.

``log_time`` is UTC where the log knows it (DataFlash with GPS; telemetry: when the message was received), else the time
since the autopilot started.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import mavutil

from navfilter.foundation.arrays import Array
from navfilter.io.logs import dataflash
from navfilter.io.logs.topic_names import Wanted, without_instance
from navfilter.models.mission import MissionError

#: Units as these logs write them -> as a mission.toml does.
_UNITS = dict.fromkeys(("degheading", "deglatitude", "deglongitude"), "deg")
_UNITS |= {"m/s/s": "m/s^2", "µs": "us", "mGauss": "mgauss", "Gauss": "gauss", "mG": "mg", "degC": "degC"}
#: Messages whose position change is the reading of a velocity log, with their fields: interval, its unit [s], changes.
_DELTAS: dict[str, tuple[str, float, tuple[str, str, str]]] = {
    "VISO": ("dt", 1.0, ("PosDX", "PosDY", "PosDZ")),
    "VISION_POSITION_DELTA": ("time_delta_usec", 1e-6, ("position_delta[0]", "position_delta[1]", "position_delta[2]")),
}


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float | Array, Any]]:
    """See `navfilter.io.logs`."""
    source = _telemetry if path.suffix.lower() == ".tlog" else dataflash.records
    translated = set()
    for topic, time_s, record in source(path, wanted, tally):
        if topic not in translated:
            translated.add(topic)
            stated = wanted.units.get(topic, {})
            wanted.units[topic] = {
                field: _UNITS.get(unit, unit) for field, unit in stated.items() if unit not in ("", "instance")
            }
        name = without_instance(topic)
        yield topic, time_s, _with_velocity(name, record) if name in _DELTAS else record


def _telemetry(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
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
        topic = f"{message.get_type()}[{message.get_srcSystem()}.{message.get_srcComponent()}]"
        if wanted(topic):
            wanted.units.setdefault(topic, dict(message.fieldunits_by_name))
            yield topic, message._timestamp, message
    log.close()


def _with_velocity(name: str, message: Any) -> dict[str, Any]:
    """A message, or many as columns, with the velocity that its changes of position are."""
    interval, unit_s, changes = _DELTAS[name]
    record = dict(message) if isinstance(message, Mapping) else _elements(message)
    try:
        seconds = unit_s * np.asarray(record[interval], dtype=float)
        seconds = np.where(seconds > 0.0, seconds, np.nan)
        velocity = {f"velocity_{axis}": record[change] / seconds for axis, change in zip("xyz", changes, strict=True)}
    except (KeyError, TypeError, ValueError):  # a damaged log gives the message other fields
        return record
    return record | {axis: part if part.ndim else float(part) for axis, part in velocity.items()}


def _elements(message: Any) -> dict[str, Any]:
    record: dict[str, Any] = {}
    for field in message.get_fieldnames():
        value = getattr(message, field)
        record |= {f"{field}[{k}]": one for k, one in enumerate(value)} if isinstance(value, list) else {field: value}
    return record


def _unreadable(path: Path, error: Exception) -> MissionError:
    reason = re.sub(r"\s+", " ", str(error) or type(error).__name__).rstrip(".")
    return MissionError(f"{path} cannot be read as an ArduPilot log: {reason}.")

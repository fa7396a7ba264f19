"""Nortek Signature and DVL files (.ad2cp): bottom track, and the sensors of every record.

A record is a header (0xA5, its size, identifier, family, size and checksum of the data, its own checksum), then data.
Source: Nortek, "Signature Integrator's Guide", N3015-007, 2022, chapter 6 (data format 3).

``bottom_track``: ``velocity[0]`` ... [m/s], ``distance[0]`` ... [m], ``fom[0]`` ..., ``frame`` (0 east-north-up, 1
instrument XYZ, 2 beams); where the figure of merit marks a beam as bad (65535), or the velocity itself is -32.768, it
is NaN. ``sensors``: heading, pitch, roll, pressure (above that of the air), temperature, speed of sound. ``log_time``
is the instrument's clock, which need not be UTC.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.lines import byte_bar
from navfilter.io.logs.sentence_times import seconds_since_1970
from navfilter.io.logs.topic_names import INSTRUMENT, Wanted

_SYNC = 0xA5
_BURST, _AVERAGE, _BOTTOM_TRACK = 0x15, 0x16, 0x17
#: Behind which bits of the configuration what follows, per beam: format, name, factor.
_PER_BEAM = ((5, "i", "velocity", 0.0), (8, "i", "distance", 1e-3), (9, "H", "fom", 1.0))
_UNITS = dict.fromkeys(("heading", "pitch", "roll"), "deg")
_UNITS |= {"pressure": "dbar", "temperature": "degC", "velocity": "m/s", "distance": "m"}
_BAD_MM_S = -32768
_BAD_FOM = 65535


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    wanted.clock = INSTRUMENT
    for kind, data in _records(path, tally):
        if kind not in (_BURST, _AVERAGE, _BOTTOM_TRACK) or len(data) < 78:
            continue
        time_s = _time_s(data)
        if time_s is None:
            tally["records without a time left out"] += 1
            continue
        topics = {"sensors": _sensors(data)}
        if kind == _BOTTOM_TRACK:
            topics["bottom_track"] = _bottom_track(data)
        for topic, record in topics.items():
            if wanted(topic):
                units = {field: _UNITS.get(field.split("[")[0], "") for field in record}
                wanted.units.setdefault(topic, {field: unit for field, unit in units.items() if unit})
                yield topic, time_s, record


def _records(path: Path, tally: Counter[str]) -> Iterator[tuple[int, bytes]]:
    """Identifier and data of the records whose checksums are right."""
    with path.open("rb") as file, byte_bar(path, path.stat().st_size) as bar:
        while first := file.read(2):
            at = file.tell() - len(first)
            rest = file.read(first[1] - 2) if len(first) == 2 and first[0] == _SYNC and first[1] in (10, 12) else b""
            header = first + rest
            if len(header) < 10 or len(header) != first[1] or _checksum(header[:-2]) != _word(header[-2:]):
                tally["bytes between records skipped"] += 1
                file.seek(at + 1)
                continue
            size = int.from_bytes(header[4:-4], "little")
            data = file.read(size)
            bar.update(len(header) + len(data))
            if len(data) < size:
                tally["record cut short at the end of the file"] += 1
            elif _checksum(data) != _word(header[-4:-2]):
                tally["records with a wrong checksum left out"] += 1
            else:
                yield header[2], data


def _word(two: bytes) -> int:
    return int.from_bytes(two, "little")


def _checksum(data: bytes) -> int:
    """Sum of the words, beginning with 0xB58C; an odd last byte counts as the upper half of a word."""
    total = 0xB58C + sum(struct.unpack_from(f"<{len(data) // 2}H", data))
    return (total + (data[-1] << 8 if len(data) % 2 else 0)) & 0xFFFF


def _time_s(data: bytes) -> float | None:
    year, month, day, hour, minute, second, steps = struct.unpack_from("<6BH", data, 8)
    whole_s = seconds_since_1970(1900 + year, month + 1, day, hour, minute, second)
    return None if whole_s is None else whole_s + 1e-4 * steps


def _sensors(data: bytes) -> dict[str, float | None]:
    speed, temperature, pressure, heading, pitch, roll = struct.unpack_from("<HhIHhh", data, 16)
    record: dict[str, float | None] = {"heading": 0.01 * heading, "pitch": 0.01 * pitch, "roll": 0.01 * roll}
    return record | {"pressure": 1e-3 * pressure, "temperature": 0.01 * temperature, "speed_of_sound": 0.1 * speed}


def _bottom_track(data: bytes) -> dict[str, float | None]:
    configuration, beams = _word(data[2:4]), _word(data[30:32])
    count = beams >> 12
    at = data[1]
    metres_per_step = 10.0 ** struct.unpack_from("<b", data, 60)[0]
    record: dict[str, float | None] = {}
    for bit, letter, name, factor in _PER_BEAM:
        width = struct.calcsize(letter) * count
        if not configuration >> bit & 1 or len(data) < at + width:
            continue
        for k, value in enumerate(struct.unpack_from(f"<{count}{letter}", data, at)):
            scaled = (factor or metres_per_step) * value
            record[f"{name}[{k}]"] = None if name == "velocity" and round(1e3 * scaled) == _BAD_MM_S else scaled
        at += width
    for k in range(count):
        if record.get(f"fom[{k}]") == _BAD_FOM:
            record |= {f"{name}[{k}]": None for name in ("velocity", "distance", "fom")}
    return {**record, "frame": beams >> 10 & 3}

"""Teledyne RDI PD0: bottom track, water track, attitude, and the navigation block that VMDAS adds.

An ensemble is a header (identifier 0x7F7F, number of bytes, offsets of its blocks), the blocks, and a checksum (sum of
all bytes). Source: Teledyne RD Instruments, "Workhorse Commands and Output Data Format", P/N 957-6156-00, 2014, chapter
8; "VmDas User's Guide", P/N 95A-6015-00, appendix (navigation block).

Velocities are the instrument's: those of the bottom, or the water, relative to it, in m/s, in the frame that the field
``frame`` gives (0 beam, 1 instrument, 2 ship, 3 earth); what the instrument marks as bad (-32768) is NaN. Over ground
and in forward, right, down the ship frame reads ``axes = "-y,-x,z"``. ``log_time`` is the instrument's clock, taken as
UTC.
"""

from __future__ import annotations

import datetime
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.progress import byte_bar
from navfilter.io.logs.topic_names import Wanted

__all__ = ["records"]

_IDENTIFIER = b"\x7f\x7f"
_CHUNK = 1 << 20
_FIXED, _VARIABLE, _BOTTOM, _NAVIGATION = 0x0000, 0x0080, 0x0600, 0x2000
_BAD = -32768
_EPOCH = datetime.datetime(1970, 1, 1)
#: Of a binary angle of 32 bit [deg].
_BINARY_ANGLE = 180.0 / 2**31
_UNITS = {"velocity": "m/s", "range": "m", "heading": "deg", "pitch": "deg", "roll": "deg", "pressure": "Pa"} | {
    "temperature": "degC",
    "transducer_depth": "m",
    "latitude": "deg",
    "longitude": "deg",
}


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    for ensemble in _ensembles(path, tally):
        blocks = _blocks(ensemble)
        leader = blocks.get(_VARIABLE, b"")
        time_s = _time_s(leader) if len(leader) >= 28 else None
        if time_s is None:
            tally["ensembles without a time left out"] += 1
            continue
        frame = (blocks.get(_FIXED, bytes(26))[25] >> 3) & 3
        topics: dict[str, dict[str, float | None]] = {"sensors": _sensors(leader)}
        if len(blocks.get(_BOTTOM, b"")) >= 58:
            topics["bottom_track"] = _bottom_track(blocks[_BOTTOM], frame)
            topics["water_track"] = {**_velocities(blocks[_BOTTOM], 50), "frame": frame}
        if len(blocks.get(_NAVIGATION, b"")) >= 34:
            topics["navigation"] = _navigation(blocks[_NAVIGATION])
        for topic, record in topics.items():
            if wanted(topic):
                wanted.units.setdefault(topic, {field: _UNITS.get(field.split("[")[0], "") for field in record})
                yield topic, time_s, record


def _ensembles(path: Path, tally: Counter[str]) -> Iterator[bytes]:
    """The ensembles whose checksums are right."""
    data = b""
    with path.open("rb") as file, byte_bar(path, path.stat().st_size) as bar:
        while piece := file.read(_CHUNK):
            bar.update(len(piece))
            data = yield from _complete(data + piece, tally)
    yield from _complete(data, tally, at_end=True)


def _complete(data: bytes, tally: Counter[str], at_end: bool = False) -> Any:
    """Yields the whole ensembles of a piece of the file, returns what is left of it."""
    at = 0
    while True:
        found = data.find(_IDENTIFIER, at)
        tally["bytes between ensembles skipped"] += (len(data) - 1 if found < 0 else found) - at
        if found < 0:
            return data[-1:]
        at = found
        size = int.from_bytes(data[at + 2 : at + 4], "little")
        if len(data) < at + max(size, 2) + 2:
            if not at_end:
                return data[at:]
            # It may be two bytes of noise, with whole ensembles behind them.
            tally["ensemble cut short at the end of the file"] = 1
            at += 1
            continue
        ensemble = data[at : at + size]
        if size >= 6 and sum(ensemble) & 0xFFFF == int.from_bytes(data[at + size : at + size + 2], "little"):
            yield ensemble
            at += size + 2
        else:
            tally["ensembles with a wrong checksum left out"] += 1
            at += 1


def _blocks(ensemble: bytes) -> dict[int, bytes]:
    """Identifier -> block, from its identifier to the next one."""
    count = ensemble[5]
    begins = [*struct.unpack_from(f"<{count}H", ensemble, 6), len(ensemble)] if len(ensemble) >= 6 + 2 * count else []
    pieces = [ensemble[a:b] for a, b in zip(begins, sorted(begins)[1:], strict=False)]
    return {int.from_bytes(piece[:2], "little"): piece for piece in pieces if len(piece) >= 2}


def _time_s(leader: bytes) -> float | None:
    """The instrument's clock [s since 1970]; with the century where the leader has one."""
    if len(leader) >= 65 and leader[57] in (19, 20):
        year, month, day, hour, minute, second, hundredths = (100 * leader[57] + leader[58], *leader[59:65])
    elif len(leader) >= 11:
        year, month, day, hour, minute, second, hundredths = leader[4:11]
        year += 1900 if year >= 80 else 2000
    else:
        return None
    try:
        moment = datetime.datetime(year, month, day, hour, minute, second)
    except ValueError:
        return None
    return (moment - _EPOCH).total_seconds() + 0.01 * hundredths


def _sensors(leader: bytes) -> dict[str, float | None]:
    number, speed, depth, heading, pitch, roll, _, temperature = struct.unpack_from("<H10xHHHhhHh", leader, 2)
    record: dict[str, float | None] = {
        "ensemble": number + 65536 * leader[11],
        "heading": 0.01 * heading,
        "pitch": 0.01 * pitch,
        "roll": 0.01 * roll,
    }
    record |= {"temperature": 0.01 * temperature, "speed_of_sound": speed, "transducer_depth": 0.1 * depth}
    if len(leader) >= 52:
        record["pressure"] = 10.0 * int.from_bytes(leader[48:52], "little", signed=True)
    return record


def _velocities(block: bytes, at: int) -> dict[str, float | None]:
    raw = struct.unpack_from("<4h", block, at)
    return {f"velocity[{k}]": None if value == _BAD else 1e-3 * value for k, value in enumerate(raw)}


def _bottom_track(block: bytes, frame: int) -> dict[str, float | None]:
    ranges = [
        low + 65536 * (block[77 + k] if len(block) >= 81 else 0)
        for k, low in enumerate(struct.unpack_from("<4H", block, 16))
    ]
    record = _velocities(block, 24)
    record |= {f"range[{k}]": 0.01 * value if value else None for k, value in enumerate(ranges)}
    record |= {f"percent_good[{k}]": value for k, value in enumerate(block[40:44])}
    return {**record, "frame": frame}


def _navigation(block: bytes) -> dict[str, float | None]:
    day, month, year, first_s, offset_ms, lat_1, lon_1, last_s, lat_2, lon_2 = struct.unpack_from(
        "<BBHIiiiIii", block, 2
    )
    midnight = (datetime.datetime(year, month, day) - _EPOCH).total_seconds() if year and month and day else 0.0
    record: dict[str, float | None] = {
        "latitude": _BINARY_ANGLE * lat_2,
        "longitude": _BINARY_ANGLE * lon_2,
        "utc": midnight + 1e-4 * last_s,
    }
    record |= {"first_latitude": _BINARY_ANGLE * lat_1, "first_longitude": _BINARY_ANGLE * lon_1}
    return record | {"first_utc": midnight + 1e-4 * first_s, "clock_offset_s": 1e-3 * offset_ms}

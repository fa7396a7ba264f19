"""NMEA 0183, read with pynmeagps: any logger's prefix, checksums counted, each talker a topic, the date carried.

A topic is talker and sentence (``GPGGA``; ``GGA`` is enough where only one talker says it). ``log_time`` is UTC: of the
sentence where it has a time, with the date of the last RMC or ZDA; else that of the last sentence that had one. Where a
sentence comes several times between two times they are spread evenly; where the logger put a time before each line, its
differences are used, and where no sentence has a time, it alone.
"""

from __future__ import annotations

import datetime
import re
from collections import Counter
from collections.abc import Iterator
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError

from navfilter.io.logs.lines import lines
from navfilter.io.logs.sentence_times import Carrier
from navfilter.io.logs.topic_names import Wanted
from navfilter.io.trust import Allowance

__all__ = ["records", "short_name"]

SENTENCE = re.compile(rb"[$!]((P[A-Z]{3}[A-Z0-9]*|[A-Z]{2}[A-Z0-9]{3}),[^*$!]*)(?:\*([0-9A-Fa-f]{2}))?")
#: Where a sentence has its time of day (hhmmss.s), counted from its name.
_TIMES = {b"GGA": 1, b"RMC": 1, b"ZDA": 1, b"GNS": 1, b"GLL": 5, b"GST": 1, b"GRS": 1, b"PASHR": 1}
#: Dates and times that loggers put before a line.
_STAMPS = (
    (re.compile(rb"(\d{4})-(\d\d)-(\d\d)[ T_](\d\d):(\d\d):(\d\d(?:[.,]\d+)?)"), "date"),
    (re.compile(rb"^\D{0,2}(\d{9,10}\.\d+)"), "epoch"),
    (re.compile(rb"(?:^|\D)(\d\d):(\d\d):(\d\d[.,]\d+)"), "day"),
)
#: Fields of sentences that the library does not know, by their makers' manuals (names as there).
_BOTTOM_TRACK = ("time", "dt1", "dt2", "vx", "vy", "vz", "fom", "d1", "d2", "d3", "d4")
_DELTAS = ("time_us", "dt_us", "roll", "pitch", "yaw", "x", "y", "z", "confidence")
_OWN_NAMES = {
    "PNORBT4": ("dt1", "dt2", "speed", "direction", "fom", "distance"),
    "PNORBT7": _BOTTOM_TRACK,
    "PNORBT9": (*_BOTTOM_TRACK, "battery", "speed_of_sound", "pressure", "temperature", "status"),
    "DVPDL": _DELTAS,
    "DVPDX": (*_DELTAS, "mode", "sensor_pitch", "sensor_roll", "standoff"),
}


def short_name(topic: str) -> str:
    """The sentence without its talker: ``GGA`` of ``GPGGA``."""
    return topic if topic.startswith(("P", "DVPD")) else topic[2:]


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    date, has_times = _first_date(path, wanted.allowance)
    carrier = Carrier(date, tally)
    for line in lines(path, tally, wanted.allowance):
        found = SENTENCE.search(line)
        if found is None:
            tally["lines without a sentence"] += bool(line.strip())
            continue
        if not _is_sound(found, tally):
            continue
        name = found[2]
        fields = found[1].split(b",")
        topic = name.decode("ascii")
        time_of_day, date = _time_of_day(fields), _date(fields)
        received = _received(line[: found.start()])
        if time_of_day is not None:
            time_s = carrier.heard(time_of_day, date, received)
            yield from carrier.settled()
            if wanted(topic) and (record := _record(topic, found, tally)) is not None:
                yield topic, time_s, record
        elif wanted(topic) and (record := _record(topic, found, tally)) is not None:
            if received is not None and not has_times:
                yield topic, received, record
                continue
            carrier.wait(topic, record, received)
            yield from carrier.settled()
    yield from carrier.rest()


def _is_sound(found: re.Match[bytes], tally: Counter[str]) -> bool:
    if found[3] is None:
        tally["sentences without a checksum left out"] += 1
        return False
    if reduce(xor, found[1]) != int(found[3], 16):
        tally["sentences with a wrong checksum left out"] += 1
        return False
    return True


def _record(topic: str, found: re.Match[bytes], tally: Counter[str]) -> dict[str, Any] | None:
    if topic.startswith(("PNORBT", "DVPD")):
        return _own_record(topic, found[1].decode("ascii", "replace").split(",")[1:])
    try:
        message = NMEAReader.parse(found[0] + b"\r\n", msgmode=0, validate=0)
    except (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError, ValueError, KeyError, IndexError):
        message = None
    if message is None:  # of a sentence that it does not know
        tally[f"{topic} cannot be read"] += 1
        return None
    if short_name(topic) == "XDR":
        return _transducers(vars(message))
    # Times and dates are no columns: `log_time` holds both.
    own = {key: value for key, value in vars(message).items() if isinstance(value, str | int | float)}
    return {key: None if value == "" else value for key, value in own.items() if not key.startswith("_")}


def _own_record(topic: str, cells: list[str]) -> dict[str, Any]:
    """Numbers by their makers' names; those of a tagged sentence (``VX=0.12``) by its tags; deltas also as speeds."""
    names = _OWN_NAMES.get(topic, ())
    record: dict[str, Any] = {}
    for k, cell in enumerate(cells):
        tag, _, value = cell.rpartition("=")
        record[tag.lower() or (names[k] if k < len(names) else f"field_{k + 1:02d}")] = _number(value)
    if topic.startswith("DVPD") and record.get("dt_us"):
        for axis in "xyz":
            record[f"velocity_{axis}"] = (record.get(axis) or 0.0) / (1e-6 * record["dt_us"])
    return record


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _transducers(fields: dict[str, Any]) -> dict[str, Any]:
    """Of a sentence of several transducers: name of each -> its reading."""
    record: dict[str, Any] = {}
    for key, value in fields.items():
        if key.startswith("data_"):
            number = key.removeprefix("data_")
            name = fields.get(f"tdrid_{number}") or f"{fields.get(f'tdrtype_{number}')}{number}"
            record[str(name).replace(".", "_")] = None if value == "" else value
    return record


# --- times ----------------------------------------------------------------------------------------------------------


def _time_of_day(fields: list[bytes]) -> float | None:
    place = _TIMES.get(fields[0] if fields[0].startswith(b"P") else fields[0][2:])
    if place is None:
        if fields[0] in (b"PNORBT6", b"PNORBT7", b"PNORBT8", b"PNORBT9") and len(fields) > 1:
            return _number(fields[1].rpartition(b"=")[2].decode("ascii", "replace"))
        return None
    if len(fields) <= place:
        return None
    text = fields[place]
    if len(text) < 6 or not text[:6].isdigit():
        return None
    try:
        seconds = float(text[4:])
    except ValueError:
        return None
    return 3600.0 * int(text[:2]) + 60.0 * int(text[2:4]) + seconds


def _date(fields: list[bytes]) -> datetime.date | None:
    kind = fields[0][2:]
    try:
        if kind == b"RMC" and len(fields) > 9 and len(fields[9]) == 6:
            day, month, year = int(fields[9][:2]), int(fields[9][2:4]), int(fields[9][4:])
            return datetime.date(year + (2000 if year < 80 else 1900), month, day)
        if kind == b"ZDA" and len(fields) > 4 and fields[4]:
            return datetime.date(int(fields[4]), int(fields[3]), int(fields[2]))
    except ValueError:
        return None
    return None


def _first_date(path: Path, allowance: Allowance) -> tuple[datetime.date | None, bool]:
    """The date that the first RMC or ZDA gives, for the sentences before it; whether any sentence has a time."""
    has_times = False
    for line in lines(path, Counter(), Allowance(allowance.left)):
        found = SENTENCE.search(line)
        if found is None or not _is_sound(found, Counter()):
            continue
        fields = found[1].split(b",")
        has_times = has_times or _time_of_day(fields) is not None
        if date := _date(fields):
            return date, has_times
    return None, has_times


def _received(prefix: bytes) -> float | None:
    """Seconds on the clock of the logger, by what it put before the sentence; None where that is no time."""
    for pattern, kind in _STAMPS if prefix else ():
        if found := pattern.search(prefix):
            if kind == "epoch":
                return float(found[1])
            clock = found.groups()[-3:]
            seconds = 3600.0 * int(clock[0]) + 60.0 * int(clock[1]) + float(clock[2].replace(b",", b"."))
            if kind == "date":
                year, month, day = (int(part) for part in found.groups()[:3])
                try:
                    return seconds + 86400.0 * (datetime.date(year, month, day).toordinal() - 719163)
                except ValueError:
                    return None
            return seconds
    return None

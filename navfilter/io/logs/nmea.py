"""NMEA 0183, read with pynmeagps: any logger's prefix, checksums counted, each talker a topic, the date carried.

A topic is talker and sentence (``GPGGA``; ``GGA`` is enough where only one talker says it). ``log_time`` is UTC: of the
sentence where it has a time, with the date of the last RMC or ZDA; else that of the last sentence that had one. What a
receiver says of the time before it has a fix counts only where the fix goes on with it. Where a sentence comes several
times between two times they are spread evenly; where the logger put a time before each line, its differences are used,
and where no sentence has a time to be believed, it alone.
"""

import datetime
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any, NamedTuple

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError

from navfilter.io.logs.lines import lines
from navfilter.io.logs.logger_stamps import LoggerClock
from navfilter.io.logs.sentence_times import Carrier, number_of, time_of_day
from navfilter.io.logs.topic_names import INSTRUMENT, OF_DAY, Wanted
from navfilter.io.trust import Allowance

SENTENCE = re.compile(rb"[$!]((P[A-Z]{3}[A-Z0-9]*|[A-Z]{2}[A-Z0-9]{3}),[^*$!]*)(?:\*([0-9A-Fa-f]{2}))?")
#: Where a sentence has its time of day (hhmmss.s), counted from its name.
_TIMES = {b"GGA": 1, b"RMC": 1, b"ZDA": 1, b"GNS": 1, b"GLL": 5, b"GST": 1, b"GRS": 1, b"PASHR": 1}
#: A receiver's clock before its first fix is right where that fix comes within this after it [s].
_GOES_ON_S = 60.0
#: Modes of GNS, a letter for each system, of what was measured: not none, reckoned, typed in or simulated.
_MEASURED = frozenset("ADFPR")
#: Kinds of values that become columns.
_PLAIN = (str, int, float)
#: Sentences that are looked at for checksums.
_LOOKED_AT = 200
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
    clock = _look_ahead(path, wanted.allowance)
    carrier, logger = Carrier(clock.date, tally), LoggerClock(tally)
    # a receiver that never had a fix is worth less than the clock of the logger
    fixed, by_logger = not clock.cold, clock.fixes == 0 and clock.cold
    for line in lines(path, tally, wanted.allowance):
        received, told = None, 0
        for found in SENTENCE.finditer(line):
            told += 1
            received = logger(line[: found.start()]) if told == 1 else received
            if not _is_sound(found, tally, clock.signed):
                continue
            fields = found[1].split(b",")
            topic = _topic(fields)
            time_of_day, date = _time_of_day(fields), _date(fields)
            fixed = fixed or _has_fix(fields) is True
            if received is not None and (by_logger or not clock.has_times):
                if wanted(topic) and (record := _record(topic, found, tally)) is not None:
                    yield topic, received, record
            elif not fixed:
                tally["sentences before the receiver's first fix left out: it did not know the time"] += wanted(topic)
            elif time_of_day is not None:
                time_s = carrier.heard(
                    time_of_day, date if clock.fixes == 0 or _has_fix(fields) is not False else None, received
                )
                yield from carrier.settled()
                if wanted(topic) and (record := _record(topic, found, tally)) is not None:
                    yield topic, time_s, record
            elif wanted(topic) and (record := _record(topic, found, tally)) is not None:
                carrier.wait(topic, record, received)
                yield from carrier.settled()
        tally["lines without a sentence"] += not told and bool(line.strip())
    yield from carrier.rest()
    if not carrier.dated if carrier.has_begun else logger.of_day:
        wanted.clock = OF_DAY
    if logger.zone and (by_logger or not clock.has_times):
        wanted.clock = INSTRUMENT
        tally[f"zone of the logger's stamps, {logger.zone}, that is no number: what is read need not be UTC"] += 1


def _is_sound(found: re.Match[bytes], tally: Counter[str], signed: bool) -> bool:
    if found[3] is None:
        words = "left out" if signed else "taken as they are: none of the file has one"
        tally[f"sentences without a checksum {words}"] += 1
        return not signed
    if reduce(xor, found[1]) != int(found[3], 16):
        tally["sentences with a wrong checksum left out"] += 1
        return False
    return True


def _topic(fields: list[bytes]) -> str:
    """Talker and sentence; Trimble's own sentences have their names in the second field."""
    second = fields[1] if fields[0] == b"PTNL" and len(fields) > 1 else b""
    return (fields[0] + second).decode("ascii", "replace")


def _record(topic: str, found: re.Match[bytes], tally: Counter[str]) -> dict[str, Any] | None:
    if topic.startswith(("PNORBT", "DVPD")):
        return _own_record(topic, found[1].decode("ascii", "replace").split(",")[1:])
    if short_name(topic) == "XDR":
        return _transducers(found[1].decode("ascii", "replace").split(",")[1:])
    try:
        message = NMEAReader.parse(found[0] + (b"\r\n" if found[3] else b"*00\r\n"), msgmode=0, validate=0)
    except (NMEAMessageError, NMEAParseError, NMEAStreamError, NMEATypeError, ValueError, KeyError, IndexError):
        message = None
    if message is None:  # of a sentence that it does not know
        tally[f"{topic} cannot be read"] += 1
        return None
    # Times and dates are no columns: `log_time` holds both.
    record = {
        key: None if value == "" else value
        for key, value in vars(message).items()
        if key[0] != "_" and isinstance(value, _PLAIN)
    }
    if short_name(topic) == "HDG":
        record |= _corrected(topic, record, tally)
    if short_name(topic) == "GNS" and not _MEASURED & set(str(record.get("posMode"))):
        record |= {"lat": None, "lon": None}
    if topic == "PTNLGGK":
        record["height"] = number_of(str(record.get("height")).removeprefix("EHT"))
    return record


def _corrected(topic: str, record: dict[str, Any], tally: Counter[str]) -> dict[str, Any]:
    """Headings of a compass (``headingM``) with its deviation, and with the variation too."""
    deviation, variation = (
        None if record[key] is None else float(record[key]) * (-1.0 if record[f"{key}EW"] == "W" else 1.0)
        for key in ("deviation", "variation")
    )
    if record["headingM"] is None:
        return {"heading_magnetic": None, "heading_true": None}
    magnetic = (float(record["headingM"]) + (deviation or 0.0)) % 360.0
    tally[f"{topic} have a deviation: it is not in headingM, heading_magnetic has it"] += bool(deviation)
    return {"heading_magnetic": magnetic, "heading_true": None if variation is None else (magnetic + variation) % 360.0}


def _own_record(topic: str, cells: list[str]) -> dict[str, Any]:
    """Numbers by their makers' names; those of a tagged sentence (``VX=0.12``) by its tags; deltas also as speeds."""
    names = _OWN_NAMES.get(topic, ())
    record: dict[str, Any] = {}
    for k, cell in enumerate(cells):
        tag, _, value = cell.rpartition("=")
        record[tag.lower() or (names[k] if k < len(names) else f"field_{k + 1:02d}")] = number_of(value)
    if topic.startswith("DVPD") and record.get("dt_us"):
        for axis in "xyz":
            record[f"velocity_{axis}"] = (record.get(axis) or 0.0) / (1e-6 * record["dt_us"])
    return record


def _transducers(cells: list[str]) -> dict[str, Any]:
    """Of a sentence of several transducers: name of each -> its reading. Each has four fields: its kind, a number or
    nothing, a unit, a name; what stands between them is none.
    """
    record: dict[str, Any] = {}
    k = 0
    while k + 3 < len(cells):
        kind, value, unit, name = cells[k : k + 4]
        if len(kind) == 1 and len(unit) <= 1 and (not value or number_of(value) is not None) and len(name) != 1:
            record[(name or f"{kind}{1 + k // 4:02d}").replace(".", "_")] = number_of(value)
            k += 4
        else:
            k += 1
    return record


# --- times ----------------------------------------------------------------------------------------------------------


def _time_of_day(fields: list[bytes]) -> float | None:
    place = _TIMES.get(fields[0] if fields[0].startswith(b"P") else fields[0][2:])
    if place is None:
        if fields[0] == b"PTNL" and len(fields) > 2 and fields[1] in (b"GGK", b"VGK", b"VHD"):
            return time_of_day(fields[2])
        if fields[0] in (b"PNORBT6", b"PNORBT7", b"PNORBT8", b"PNORBT9") and len(fields) > 1:
            return number_of(fields[1].rpartition(b"=")[2].decode("ascii", "replace"))
        return None
    return time_of_day(fields[place]) if len(fields) > place else None


def _has_fix(fields: list[bytes]) -> bool | None:
    """Whether the receiver says that it has a fix; None where the sentence does not say."""
    kind = fields[0][2:]
    if kind in (b"RMC", b"GLL"):
        place = 2 if kind == b"RMC" else 6
        return fields[place] == b"A" if len(fields) > place else None
    if kind == b"GGA" and len(fields) > 6:
        return fields[6] not in (b"", b"0")
    if kind == b"GNS" and len(fields) > 6:
        return bool(_MEASURED & set(fields[6].decode("ascii", "replace")))
    if fields[0] == b"PTNL" and len(fields) > 8 and fields[1] == b"GGK":
        return fields[8] not in (b"", b"0")
    return None


def _date(fields: list[bytes]) -> datetime.date | None:
    kind = fields[0][2:]
    try:
        if kind == b"RMC" and len(fields) > 9 and len(fields[9]) == 6:
            day, month, year = int(fields[9][:2]), int(fields[9][2:4]), int(fields[9][4:])
            return datetime.date(year + (2000 if year < 80 else 1900), month, day)
        if kind == b"ZDA" and len(fields) > 4 and fields[4]:
            return datetime.date(int(fields[4]), int(fields[3]), int(fields[2]))
        if fields[0] == b"PTNL" and len(fields) > 3 and fields[1] == b"GGK" and len(fields[3]) == 6:
            return datetime.date(2000 + int(fields[3][4:]), int(fields[3][:2]), int(fields[3][2:4]))
    except ValueError:
        return None
    return None


class _Ahead(NamedTuple):
    """What is known of a file's times before it is read.

    Attributes
    ----------
    date : datetime.date or None
        Of the first RMC or ZDA that is to be believed, for the sentences before it.
    has_times : bool
        Whether any sentence has a time.
    fixes : int
        How many sentences up to that date say that there is a fix; 0: none does in the whole file.
    cold : bool
        Whether sentences before the first fix have a time that does not go on with it.
    signed : bool
        Whether sentences have checksums.
    """

    date: datetime.date | None
    has_times: bool
    fixes: int
    cold: bool
    signed: bool


def _look_ahead(path: Path, allowance: Allowance) -> _Ahead:
    """The first date to be believed; what a receiver says without a fix is so only where nothing better comes."""
    has_times, fixes, without = False, 0, False
    doubtful: datetime.date | None = None
    last_s: float | None = None
    heard_s, midnights = -1.0, 0
    cold = False
    signed = _has_checksums(path, allowance)
    for line in lines(path, Counter(), Allowance(allowance.left)):
        for found in SENTENCE.finditer(line):
            if not _is_sound(found, Counter(), signed):
                continue
            fields = found[1].split(b",")
            time_of_day, date, fix = _time_of_day(fields), _date(fields), _has_fix(fields)
            has_times = has_times or time_of_day is not None
            without = without or fix is False
            if fix and not fixes and last_s is not None and time_of_day is not None:
                cold = not 0.0 <= (time_of_day - last_s) % 86400.0 <= _GOES_ON_S
            fixes += fix is True
            if time_of_day is not None and (fix or fixes or not without):
                midnights += heard_s > time_of_day + 0.5 * 86400.0
                heard_s = time_of_day
            if date is not None and (fix or (fix is None and (fixes or not without))):
                first = date - datetime.timedelta(days=min(midnights, date.toordinal() - 1))
                return _Ahead(first, has_times, fixes, cold, signed)
            if fix is False and not fixes and time_of_day is not None:
                last_s = time_of_day
                doubtful = doubtful or date
    return _Ahead(None if fixes else doubtful, has_times, fixes, cold or (not fixes and without), signed)


def _has_checksums(path: Path, allowance: Allowance) -> bool:
    """Whether any of the first sentences has a checksum."""
    told = (found for line in lines(path, Counter(), Allowance(allowance.left)) for found in SENTENCE.finditer(line))
    return any(found[3] is not None for found in itertools.islice(told, _LOOKED_AT))

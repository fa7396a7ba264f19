"""ArduPilot logs: DataFlash (.bin) and telemetry (.tlog), read with pymavlink.

DataFlash: a topic is a message (``ATT``), with ``[0]``, ``[1]`` where the log says that it has instances (``IMU[0]``).
Its units are those that the log itself states (UNIT, MULT). Telemetry: a topic is a MAVLink message and who sent it
(``ATTITUDE[1.1]``: system and component); ``ATTITUDE`` is enough where only one sends it. Its units are MAVLink's.

``log_time`` is UTC where the log knows it (DataFlash with GPS; telemetry: when the message was received), else the time
since the autopilot started.

ArduPilot's DataFlash logs (.bin), gone through twice block by block: once for the formats, units and the time that
they state, once for the messages. So a log of any length costs the memory of a block.

A message is two bytes of signature, its type and its body. FMT messages describe the types, FMTU, UNIT and MULT their
units; what all of these mean, pymavlink knows.
"""

import contextlib
import io
import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink import mavutil
from pymavlink.DFReader import DFFormat, null_term

from navfilter.foundation.arrays import Array
from navfilter.io.logs.lines import byte_bar
from navfilter.io.logs.topic_names import Wanted, without_instance
from navfilter.models.mission import MissionError

Places = dict[int, list[int]]

_BLOCK = 4 << 20
_SIGNATURE = b"\xa3\x95"
_FMT, _FMT_LENGTH = 0x80, 89
#: Logs end in up to so many bytes that are none: they are written in pages.
_PAGE = 528
#: Format character -> type of NumPy, and what a value is divided by; 0: it is text.
_TYPES: dict[str, tuple[str, float]] = {
    **dict.fromkeys("bM", ("i1", 1.0)), "B": ("u1", 1.0), "h": ("i2", 1.0), "H": ("u2", 1.0), "i": ("i4", 1.0),
    "I": ("u4", 1.0), "q": ("i8", 1.0), "Q": ("u8", 1.0), "g": ("f2", 1.0), "f": ("f4", 1.0), "d": ("f8", 1.0),
    "c": ("i2", 100.0), "C": ("u2", 100.0), "e": ("i4", 100.0), "E": ("u4", 100.0), "L": ("i4", 1e7),
    "n": ("S4", 0.0), "N": ("S16", 0.0), "Z": ("S64", 0.0),
}  # fmt: skip
#: An array of 32 numbers.
_MANY = "a"
#: Of GPS time and of 1970 [s], and the leap seconds that the logs are dated with (as pymavlink does).
_GPS_EPOCH_S, _WEEK_S, _LEAP_S = 315964800.0, 604800.0, 18.0
#: A receiver tells UTC from this status on (a fix in three dimensions): before it counts weeks from anywhere. No log
#: with these stamps is older than the second, a week of January 2015.
_FIX, _FIRST_WEEK = 3, 1825


#: The format of formats, which none describes.
_OF_FORMATS = _FMT, b"FMT", _FMT_LENGTH, "BBnNZ", "Type,Length,Name,Format,Columns"


@dataclass
class _Log:
    """What the first passage has found: of each type its format and length, and how many messages there are; the first
    stamp, and UTC at which the stamps read zero [s].
    """

    formats: dict[int, Any] = field(default_factory=lambda: {_FMT: DFFormat(*_OF_FORMATS)})
    lengths: list[int] = field(default_factory=lambda: [_FMT_LENGTH if kind == _FMT else 0 for kind in range(256)])
    counts: Counter[int] = field(default_factory=Counter)
    begin_s: float | None = None
    epoch_s: float | None = None


def dataflash_records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float | Array, Any]]:
    """See `navfilter.io.logs`.

    Raises
    ------
    MissionError
        When there is no message in the file, or none has a time (logs of before 2015).
    """
    log = _described(path, tally)
    named = {kind: form for kind, form in log.formats.items() if log.counts[kind]}
    for form in named.values():
        if form.instance_field is None:
            wanted(form.name)
    chosen = {kind for kind, form in named.items() if wanted.family(form.name)}
    for block, places in _blocks(path, list(log.lengths), Counter()):
        for kind, starts in places.items():
            if kind in chosen and len(bodies := _bodies(block, starts, log.formats[kind].len)):
                yield from _topics(log, log.formats[kind], bodies, wanted)


# --- the bytes ------------------------------------------------------------------------------------------------------


def _blocks(path: Path, lengths: list[int], tally: Counter[str]) -> Iterator[tuple[bytes, Places]]:
    """Blocks of whole messages, and where in each the messages of each type begin. A block's own formats count from its
    beginning on: whoever reads them writes `lengths` on the way.
    """
    rest, left = b"", path.stat().st_size
    with path.open("rb") as file, byte_bar(path, left) as bar:
        while data := file.read(_BLOCK):
            left -= len(data)
            block = rest + data
            places, end = _scan(block, lengths, left, tally)
            yield block, places
            rest = block[end:]
            bar.update(len(data))


def _scan(block: bytes, lengths: list[int], left: int, tally: Counter[str]) -> tuple[Places, int]:
    places: Places = {}
    at, size = 0, len(block)
    while at + 3 <= size:
        kind = block[at + 2]
        length = lengths[kind]
        if not length or block[at] != 0xA3 or block[at + 1] != 0x95:
            following = block.find(_SIGNATURE, at + 1)
            # the last byte may be the first of a signature that goes on in the next block
            following = size - 1 if following < 0 else following
            tally["bytes between messages skipped"] += following - at if left + size - at >= _PAGE else 0
            at = following
            continue
        if at + length > size:
            break
        if kind in places:
            places[kind].append(at)
        else:
            places[kind] = [at]
        if kind == _FMT and block[at + 3] != _FMT and block[at + 4] >= 3:
            lengths[block[at + 3]] = block[at + 4]
        at += length
    return places, at


def _bodies(block: bytes, starts: list[int], length: int) -> npt.NDArray[np.uint8]:
    """Bodies of messages of one type, (n, length - 3)."""
    begin = np.array(starts)
    # where a damaged log states the length anew, what came before it may not fit
    rows = begin[begin + length <= len(block), np.newaxis] + np.arange(3, length)
    return np.frombuffer(block, dtype=np.uint8)[rows]


# --- formats, units, time -------------------------------------------------------------------------------------------


def _described(path: Path, tally: Counter[str]) -> _Log:
    log, units = _Log(), {"UNIT": [], "MULT": [], "FMTU": []}  # type: tuple[_Log, dict[str, list[tuple[Any, ...]]]]
    for block, places in _blocks(path, log.lengths, tally):
        for start in places.get(_FMT, ()):
            _format(log, block[start + 3 : start + _FMT_LENGTH], tally)
        for kind, starts in places.items():
            log.counts[kind] += len(starts)
            form = log.formats.get(kind)
            if form is None:
                tally["messages of no known format left out"] += len(starts)
            elif form.name in units:
                bodies = _bodies(block, starts, form.len)
                units[form.name] += [struct.unpack(form.msg_struct, body.tobytes()) for body in bodies]
            elif log.begin_s is None or (log.epoch_s is None and form.name == "GPS"):
                _time(log, form, _bodies(block, starts, form.len))
    if not sum(log.counts.values()):
        raise MissionError(f"{path} cannot be read as an ArduPilot log: it holds no messages.")
    if log.begin_s is None:
        raise MissionError(f"{path}: no message of this log has TimeUS; logs of before 2015 are not read.")
    log.counts = Counter({kind: count for kind, count in log.counts.items() if kind in log.formats})
    with contextlib.suppress(IndexError, AttributeError, TypeError, ValueError, OverflowError):
        _state_units(log, units)  # whatever is damaged states none
    return log


def _format(log: _Log, body: bytes, tally: Counter[str]) -> None:
    kind, length, name, characters, columns = struct.unpack("<BB4s16s64s", body)
    if kind == _FMT:
        return
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it does not know
            form = DFFormat(
                kind, null_term(name), length, null_term(characters), null_term(columns), log.formats.get(kind)
            )
        fits = struct.calcsize(form.msg_struct) == length - 3 and len(form.columns) == len(form.format)
    except Exception:  # its own, for characters that it does not know
        fits = False
    if fits:
        log.formats[kind] = form
    else:
        log.formats.pop(kind, None)
        tally["contradictory formats left out"] += 1


def _state_units(log: _Log, found: dict[str, list[tuple[Any, ...]]]) -> None:
    """Give the formats their units: by the time of the message, the letter of a unit, its name or its multiplier."""
    names = {chr(unit[1]): null_term(unit[2]) for unit in found["UNIT"]}
    multipliers = {chr(unit[1]): float(f"{unit[2]:.7g}") for unit in found["MULT"]}
    for stated in found["FMTU"]:
        if (form := log.formats.get(int(stated[1]))) is not None:
            form.set_unit_ids(null_term(stated[2]), names)
            form.set_mult_ids(null_term(stated[3]), multipliers)


def _time(log: _Log, form: Any, bodies: npt.NDArray[np.uint8]) -> None:
    """The first stamp of the log, and UTC where its receiver knows it."""
    if "TimeUS" not in form.columns or not len(bodies):
        return
    columns = _columns(form, bodies)
    seconds = 1e-6 * columns["TimeUS"]
    log.begin_s = float(seconds[0]) if log.begin_s is None else log.begin_s
    if form.name == "GPS" and {"GWk", "GMS"} <= columns.keys():
        known = columns["GWk"] >= _FIRST_WEEK
        if "Status" in columns:
            known &= columns["Status"] >= _FIX
        if known.any():
            gps_s = _GPS_EPOCH_S + _WEEK_S * columns["GWk"][known] + 1e-3 * columns["GMS"][known] - _LEAP_S
            log.epoch_s = float(np.median(gps_s - seconds[known]))


# --- messages -------------------------------------------------------------------------------------------------------


def _columns(form: Any, bodies: npt.NDArray[np.uint8]) -> dict[str, npt.NDArray[Any]]:
    """Columns of messages of one type, texts as bytes."""
    columns: dict[str, npt.NDArray[Any]] = {}
    at = 0
    for name, character in zip(form.columns, form.format, strict=True):
        if character == _MANY:
            numbers = bodies[:, at : at + 64].copy().view("<i2")
            columns |= {f"{name}[{k}]": numbers[:, k] for k in range(numbers.shape[1])}
            at += 64
            continue
        kind, divisor = _TYPES[character]
        size = np.dtype(kind).itemsize
        column = bodies[:, at : at + size].copy().view(kind if divisor == 0.0 else f"<{kind}")[:, 0]
        with np.errstate(invalid="ignore"):  # a damaged number may be one that signals
            columns[name] = column / divisor if divisor > 1.0 else column.astype(float) if "f" in kind else column
        at += size
    return columns


def _topics(log: _Log, form: Any, bodies: npt.NDArray[np.uint8], wanted: Wanted) -> Iterator[tuple[str, Any, Any]]:
    """The messages of one type by topic: one for each instance where there are such."""
    columns = _columns(form, bodies)
    if form.instance_field is None:
        instances = {form.name: slice(None)}
    else:
        which = columns[form.instance_field]
        instances = {f"{form.name}[{_text(one)}]": which == one for one in np.unique(which)}
    for topic, rows in instances.items():
        if not wanted(topic):
            continue
        if topic not in wanted.units:
            wanted.units[topic] = dict(zip(form.columns, form.units or (), strict=False))
        own = {name: column[rows] for name, column in columns.items()}
        count = len(next(iter(own.values()))) if own else 0
        since = 1e-6 * own["TimeUS"] if "TimeUS" in own else np.full(count, log.begin_s)
        time_s = since + (log.epoch_s or 0.0)
        if any(column.dtype.kind == "S" for column in own.values()):
            for k, at_s in enumerate(time_s.tolist()):
                yield topic, at_s, {name: _text(column[k]) for name, column in own.items()}
        else:
            yield topic, time_s, own


def _text(value: Any) -> Any:
    """A text up to its first zero; a number as it is."""
    if not isinstance(value, bytes):
        return value.item()
    raw = value.split(b"\0", 1)[0]
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


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
    source = _telemetry if path.suffix.lower() == ".tlog" else dataflash_records
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
    for name in message.get_fieldnames():
        value = getattr(message, name)
        record |= {f"{name}[{k}]": one for k, one in enumerate(value)} if isinstance(value, list) else {name: value}
    return record


def _unreadable(path: Path, error: Exception) -> MissionError:
    reason = re.sub(r"\s+", " ", str(error) or type(error).__name__).rstrip(".")
    return MissionError(f"{path} cannot be read as an ArduPilot log: {reason}.")

"""Teledyne RDI PD0: bottom track, water track, attitude, and the navigation block that VMDAS adds.

An ensemble is a header (identifier 0x7F7F, number of bytes, offsets of its blocks), the blocks, and a checksum (sum of
all bytes). Source: Teledyne RD Instruments, "Workhorse Commands and Output Data Format", P/N 957-6156-00, 2014, chapter
8; "VmDas User's Guide", P/N 95A-6015-00, appendix (navigation block).

Velocities are the instrument's: those of the bottom, or the water, relative to it, in m/s, in the frame that the field
``frame`` gives (0 beam, 1 instrument, 2 ship, 3 earth); what the instrument marks as bad (-32768) is NaN. Over ground
and in forward, right, down the ship frame reads ``axes = "-y,-x,z"``; of the earth frame ``forward``, ``right`` and
``down`` are that already. In the beam frame each velocity is that along a beam, positive towards the bottom; beams 1 to
4 look to port, starboard, forward and aft where beam 3 looks forward, ``beam_tilt`` [deg] from the vertical.

``log_time`` is UTC where a receiver's sentences (``gga``, ``vtg``, ``hdt``) or navigation blocks in the file tell it,
else the instrument's clock, which need not be.
"""

import math
import statistics
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from navfilter.io.logs.lines import byte_bar
from navfilter.io.logs.sentence_times import number_of, seconds_since_1970, time_of_day
from navfilter.io.logs.slocum import degrees_of
from navfilter.io.logs.topic_names import INSTRUMENT, Wanted

_IDENTIFIER = b"\x7f\x7f"
_CHUNK = 1 << 20
_FIXED, _VARIABLE, _BOTTOM, _NAVIGATION = 0x0000, 0x0080, 0x0600, 0x2000
_BAD = -32768
_DAY_S = 86400.0
_EARTH = 3
#: Angle of the beams by the system configuration [deg]; 0: the leader has it elsewhere.
_ANGLES = (15, 20, 30, 0)
#: Bit of the sensors that are there.
_PRESSURE_SENSOR = 0x20
#: Of a binary angle of 32 bit [deg].
_BINARY_ANGLE = 180.0 / 2**31
_UNITS = {
    **dict.fromkeys(("velocity", "forward", "right", "down", "speed"), "m/s"),
    **dict.fromkeys(("range", "transducer_depth", "altitude", "geoid"), "m"),
    **dict.fromkeys(("heading", "pitch", "roll", "latitude", "longitude", "beam_tilt", "course"), "deg"),
    **{"pressure": "Pa", "temperature": "degC"},
}
_GENERAL = 0x2022
_ASCII = (0x2100, 0x2101, 0x2102, 0x2103)
#: A knot [m/s].
_KN = 1852.0 / 3600.0


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    ahead_s = _clock_ahead_s(path)
    if ahead_s is None:
        wanted.clock = INSTRUMENT
        ahead_s = 0.0
    elif abs(ahead_s) > 1.0:
        tally[f"clock {_amount(ahead_s)} UTC by the receiver in the file: log_time is put right"] = 1
    for ensemble in _ensembles(path, tally):
        every = list(_blocks(ensemble))
        blocks = dict(every)
        leader, fixed = blocks.get(_VARIABLE, b""), blocks.get(_FIXED, b"").ljust(59, b"\0")
        clock_s = _time_s(leader) if len(leader) >= 28 else None
        if clock_s is None:
            tally["ensembles without a time left out"] += 1
            continue
        time_s = clock_s - ahead_s
        frame = (fixed[25] >> 3) & 3
        found: list[tuple[str, float, dict[str, float | None]]] = [("sensors", time_s, _sensors(leader, fixed))]
        if len(blocks.get(_BOTTOM, b"")) >= 58:
            found.append(("bottom_track", time_s, _bottom_track(blocks[_BOTTOM], fixed, leader)))
            found.append(("water_track", time_s, {**_velocities(blocks[_BOTTOM], 50), "frame": frame}))
        if len(blocks.get(_NAVIGATION, b"")) >= 34:
            if (navigation := _navigation(blocks[_NAVIGATION])) is None:
                tally["navigation blocks with an impossible date left out"] += 1
            else:
                found.append(("navigation", time_s, navigation))
        for sentence in sentences(iter(every)):
            own_s = time_s - (sentence.before_s or 0.0)
            if sentence.time_of_day_s is not None:
                own_s = sentence.time_of_day_s + _DAY_S * round((time_s - sentence.time_of_day_s) / _DAY_S)
            found.append((sentence.kind, own_s, sentence.fields))
        for topic, own_s, record in found:
            if wanted(topic):
                wanted.units.setdefault(topic, {field: _UNITS.get(field.split("[")[0], "") for field in record})
                yield topic, own_s, record


def _clock_ahead_s(path: Path) -> float | None:
    """By how much the clock of the instrument is ahead of the UTC that receivers give in the file [s]; None where none
    does.
    """
    ahead: list[float] = []
    for ensemble in _ensembles(path, Counter()):
        every = list(_blocks(ensemble))
        blocks = dict(every)
        leader = blocks.get(_VARIABLE, b"")
        if (clock_s := _time_s(leader) if len(leader) >= 28 else None) is None:
            continue
        for sentence in sentences(iter(every)):
            if sentence.time_of_day_s is not None and sentence.fields.get("quality"):
                late_s = clock_s - (sentence.before_s or 0.0) - sentence.time_of_day_s
                ahead.append((late_s + 0.5 * _DAY_S) % _DAY_S - 0.5 * _DAY_S)
        if len(navigation := blocks.get(_NAVIGATION, b"")) >= 34 and (record := _navigation(navigation)) is not None:
            ahead += [clock_s - record["utc"]] if record["utc"] and record["utc"] > _DAY_S else []
    return statistics.median(ahead) if ahead else None


def _amount(ahead_s: float) -> str:
    size = abs(ahead_s)
    hours, rest = divmod(size, 3600.0)
    return f"{f'{hours:.0f} h ' if hours else ''}{rest:.4g} s {'ahead of' if ahead_s > 0.0 else 'behind'}"


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
        tally["bytes between ensembles skipped"] += max(len(data) - 1 if found < 0 else found, at) - at
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


def _blocks(ensemble: bytes) -> Iterator[tuple[int, bytes]]:
    """Identifier and content of the blocks, each from its identifier to the next one."""
    count = ensemble[5]
    begins = [*struct.unpack_from(f"<{count}H", ensemble, 6), len(ensemble)] if len(ensemble) >= 6 + 2 * count else []
    for a, b in zip(begins, sorted(begins)[1:], strict=False):
        if b - a >= 2:
            yield int.from_bytes(ensemble[a : a + 2], "little"), ensemble[a:b]


def _time_s(leader: bytes) -> float | None:
    """The instrument's clock [s since 1970]; with the century where the leader has one."""
    if len(leader) >= 65 and leader[57] in (19, 20):
        year, month, day, hour, minute, second, hundredths = (100 * leader[57] + leader[58], *leader[59:65])
    elif len(leader) >= 11:
        year, month, day, hour, minute, second, hundredths = leader[4:11]
        year += 1900 if year >= 80 else 2000
    else:
        return None
    whole_s = seconds_since_1970(year, month, day, hour, minute, second)
    return None if whole_s is None else whole_s + 0.01 * hundredths


def _sensors(leader: bytes, fixed: bytes) -> dict[str, float | None]:
    number, speed, depth, heading, pitch, roll, _, temperature = struct.unpack_from("<H10xHHHhhHh", leader, 2)
    record: dict[str, float | None] = {
        "ensemble": number + 65536 * leader[11],
        "heading": 0.01 * heading,
        "pitch": 0.01 * pitch,
        "roll": 0.01 * roll,
    }
    record |= {"temperature": 0.01 * temperature, "speed_of_sound": speed, "transducer_depth": 0.1 * depth}
    if len(leader) >= 52:
        pressure = 10.0 * int.from_bytes(leader[48:52], "little", signed=True)
        record["pressure"] = pressure if pressure or fixed[31] & _PRESSURE_SENSOR else None
    alignment, bias = struct.unpack_from("<hh", fixed, 26)
    return record | {"heading_alignment": 0.01 * alignment, "heading_bias": 0.01 * bias}


def _velocities(block: bytes, at: int) -> dict[str, float | None]:
    raw = struct.unpack_from("<4h", block, at)
    return {f"velocity[{k}]": None if value == _BAD else 1e-3 * value for k, value in enumerate(raw)}


def _bottom_track(block: bytes, fixed: bytes, leader: bytes) -> dict[str, float | None]:
    ranges = [
        low + 65536 * (block[77 + k] if len(block) >= 81 else 0)
        for k, low in enumerate(struct.unpack_from("<4H", block, 16))
    ]
    record = _velocities(block, 24)
    frame = (fixed[25] >> 3) & 3
    if frame == _EARTH:
        record |= _in_the_body(record, leader)
    record |= {f"range[{k}]": 0.01 * value if value else None for k, value in enumerate(ranges)}
    record |= {f"percent_good[{k}]": value for k, value in enumerate(block[40:44])}
    return {**record, "frame": frame, "beam_tilt": _ANGLES[fixed[5] & 3] or fixed[58]}


def _in_the_body(record: dict[str, float | None], leader: bytes) -> dict[str, float | None]:
    """Velocity over ground forward, right, down, turned back as the instrument turned it: by the heading, pitch and
    roll of the same ensemble (Teledyne RD Instruments, "ADCP Coordinate Transformation", P/N 951-6079-00, 2010).
    """
    east, north, up = (record[f"velocity[{k}]"] for k in range(3))
    if east is None or north is None or up is None:
        return {"forward": None, "right": None, "down": None}
    h, p, r = (math.radians(0.01 * angle) for angle in struct.unpack_from("<Hhh", leader, 18))
    p = math.atan(math.tan(p) * math.cos(r))
    ch, sh, cp, sp, cr, sr = (f(angle) for angle in (h, p, r) for f in (math.cos, math.sin))
    starboard = (ch * cr + sh * sp * sr) * east + (-sh * cr + ch * sp * sr) * north - cp * sr * up
    forward = sh * cp * east + ch * cp * north + sp * up
    mast = (ch * sr - sh * sp * cr) * east + (-sh * sr - ch * sp * cr) * north + cp * cr * up
    return {"forward": -forward, "right": -starboard, "down": mast}


def _navigation(block: bytes) -> dict[str, float | None] | None:
    """Where the ship was; None of a block whose date is none."""
    day, month, year, first_s, offset_ms, lat_1, lon_1, last_s, lat_2, lon_2 = struct.unpack_from(
        "<BBHIiiiIii", block, 2
    )
    midnight = seconds_since_1970(year, month, day) if year and month and day else 0.0
    if midnight is None:
        return None
    record: dict[str, float | None] = {
        "latitude": _BINARY_ANGLE * lat_2,
        "longitude": _BINARY_ANGLE * lon_2,
        "utc": midnight + 1e-4 * last_s,
    }
    record |= {"first_latitude": _BINARY_ANGLE * lat_1, "first_longitude": _BINARY_ANGLE * lon_1}
    return record | {"first_utc": midnight + 1e-4 * first_s, "clock_offset_s": 1e-3 * offset_ms}


# --- sentences inside ------------------------------------------------------------------------------------------------


class Sentence(NamedTuple):
    """A sentence.

    Attributes
    ----------
    kind : str
        "gga", "vtg" or "hdt".
    before_s : float or None
        How long before the ensemble's own time it arrived [s]; None where the block does not say.
    time_of_day_s : float or None
        UTC that it gives.
    fields : dict of str to (float or None)
    """

    kind: str
    before_s: float | None
    time_of_day_s: float | None
    fields: dict[str, float | None]


def sentences(blocks: Iterator[tuple[int, bytes]]) -> Iterator[Sentence]:
    """The sentences of an ensemble: of the general blocks, else of the ASCII ones that say the same.

    Parameters
    ----------
    blocks : iterable of (int, bytes)
        Identifier and content of every block of the ensemble.
    """
    general, plain = list[Sentence](), list[Sentence]()
    for identifier, block in blocks:
        if identifier == _GENERAL and len(block) >= 14:
            kind, _, before_s = struct.unpack_from("<HHd", block, 2)
            body = block[14:]
            found = _binary(kind, before_s, body) if kind >= 100 else _text(before_s, body)
            general += [found] if found is not None else []
        elif identifier in _ASCII:
            found = _text(None, block[4:])
            plain += [found] if found is not None else []
    kinds = {sentence.kind for sentence in general}
    yield from (*general, *(sentence for sentence in plain if sentence.kind not in kinds))


def _binary(kind: int, before_s: float, body: bytes) -> Sentence | None:
    """A sentence in WinRiver's own form: its name, then its fields as numbers."""
    if kind == 104 and len(body) >= 55:
        time_of_day_s = time_of_day(body[7:17].split(b"\0")[0])
        latitude, north, longitude, east, quality, satellites, hdop, altitude, _, geoid = struct.unpack_from(
            "<dcdcBBffcf", body, 17
        )
        fields = _fix(_signed(latitude, north, b"S"), _signed(longitude, east, b"W"), quality)
        fields |= {"satellites": satellites, "hdop": hdop, "altitude": altitude, "geoid": geoid}
        return Sentence("gga", before_s, time_of_day_s, fields)
    if kind == 105 and len(body) >= 17:
        course, true, _, _, speed, _ = struct.unpack_from("<fcfcfc", body, 7)
        fields = {"course": course if true == b"T" else None, "speed": _KN * speed}
        return Sentence("vtg", before_s, None, fields)
    if kind == 107 and len(body) >= 15:
        return Sentence("hdt", before_s, None, {"heading": struct.unpack_from("<d", body, 7)[0]})
    return None


def _text(before_s: float | None, body: bytes) -> Sentence | None:
    """A sentence as the receiver sent it."""
    begin = body.find(b"$")
    cells = body[begin + 1 :].split(b"*")[0].split(b",") if begin >= 0 else []
    name = cells[0][2:] if cells else b""
    if name == b"GGA" and len(cells) > 9:
        latitude, longitude = (degrees_of(number_of(cells[k])) for k in (2, 4))
        fields = _fix(
            _signed(latitude, cells[3], b"S"), _signed(longitude, cells[5], b"W"), int(number_of(cells[6]) or 0)
        )
        fields |= {"satellites": number_of(cells[7]), "hdop": number_of(cells[8]), "altitude": number_of(cells[9])}
        return Sentence("gga", before_s, time_of_day(cells[1]), fields)
    if name == b"VTG" and len(cells) > 5 and cells[1]:
        speed = number_of(cells[5])
        return Sentence("vtg", before_s, None, {"course": number_of(cells[1]), "speed": speed and _KN * speed})
    if name == b"HDT" and len(cells) > 1 and cells[1]:
        return Sentence("hdt", before_s, None, {"heading": number_of(cells[1])})
    return None


def _fix(latitude: float, longitude: float, quality: int) -> dict[str, float | None]:
    place = (latitude, longitude) if quality else (None, None)
    return {"latitude": place[0], "longitude": place[1], "quality": quality}


def _signed(size: float, letter: bytes, negative: bytes) -> float:
    return -size if letter == negative else size

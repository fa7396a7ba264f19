"""The sentences of a satellite receiver and a gyrocompass that WinRiver and VmDas store in PD0 ensembles.

Source: Teledyne RD Instruments, "WinRiver II User's Guide", P/N 957-6231-00, 2016, appendix (general NMEA structure,
identifier 0x2022, and the ASCII blocks 0x2100 to 0x2103).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from navfilter.io.logs.sentence_times import number_of, time_of_day
from navfilter.io.logs.slocum import degrees_of

_GENERAL = 0x2022
_ASCII = (0x2100, 0x2101, 0x2102, 0x2103)
#: A knot [m/s].
_KN = 1852.0 / 3600.0


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

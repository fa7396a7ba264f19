"""Logs of the sailing program Expedition: sparse rows of a number for a column and its value.

The first line names the columns, the second numbers them; a row is ``number,value,number,value, ...`` with the values
that were there. The one topic is ``boat``, its fields have the names of the first line. ``log_time`` is UTC: the file
counts days since 1899-12-30.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.lines import lines
from navfilter.io.logs.topic_names import Wanted
from navfilter.models.mission import MissionError

TOPIC = "boat"
#: Days from 1899-12-30 to 1970-01-01.
_DAYS, _DAY_S = 25569.0, 86400.0
_UNITS = {"HDG": "deg", "BSP": "kn", "SOG": "kn", "COG": "deg", "Lat": "deg", "Lon": "deg", "Heel": "deg", "Depth": "m"}


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    rows = lines(path, tally, wanted.allowance)
    heads = [next(rows, b"").decode("utf-8", "replace").split(",") for _ in range(2)]
    if len(heads[0]) < 2 or len(heads[0]) != len(heads[1]):
        raise MissionError(f"{path}: the lines with the names and the numbers of an Expedition log disagree.")
    names = dict(zip(heads[1][1:], heads[0][1:], strict=True))
    if not wanted(TOPIC):
        return
    wanted.units[TOPIC] = _UNITS
    for line in rows:
        if line.startswith(b"!") or not line.strip():
            continue
        cells = line.decode("ascii", "replace").rstrip(",").split(",")
        try:
            values = zip(cells[::2], map(float, cells[1::2]), strict=True)
            record: dict[str, Any] = dict.fromkeys(names.values()) | {names[number]: value for number, value in values}
            time_s = _DAY_S * (record["Utc"] - _DAYS)
        except (ValueError, KeyError, TypeError):
            tally["rows cut short or with text among the numbers left out"] += 1
            continue
        yield TOPIC, time_s, record

"""Slocum gliders: the text tables that dinkum binary data become (``dbd2asc``): wide, and NaN where nothing was
sampled.

The one topic is ``glider``, its fields are the glider's sensors by their own names and, latitude and longitude apart,
in their own units: those come as degrees and minutes in one number (ddmm.mmmm) and are read as degrees. ``log_time`` is
``m_present_time`` (of science files ``sci_m_present_time``), UTC. Several files, by a pattern with ``*``, follow one
another. Each begins with the fix that was known before it: that is left out until there is another.
"""

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.lines import lines
from navfilter.io.logs.topic_names import Wanted
from navfilter.models.mission import MissionError

TOPIC = "glider"
_CLOCKS = ("m_present_time", "sci_m_present_time")
#: Units as the glider writes them -> as a mission.toml does.
_UNITS = {name: name for name in ("rad", "m", "m/s", "bar", "degC")} | {"lat": "deg", "lon": "deg", "timestamp": "s"}
#: Beyond is the glider's mark for "never": 69696969.
_LARGEST_ANGLE = 18000.0


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    rows = lines(path, tally, wanted.allowance)
    names, units = _head(path, rows)
    clock = next((name for name in _CLOCKS if name in names), None)
    if clock is None:
        raise MissionError(f"{path}: a glider's table needs a column {' or '.join(_CLOCKS)}; it has none.")
    if not wanted(TOPIC):
        return
    stated = {name: _UNITS.get(unit, "") for name, unit in zip(names, units, strict=True)}
    wanted.units[TOPIC] = {name: unit for name, unit in stated.items() if unit}
    angles = [name for name, unit in zip(names, units, strict=True) if unit in ("lat", "lon")]
    fix = [names.index(name) for name in ("m_gps_lat", "m_gps_lon") if name in names]
    before: list[bytes] | None = None
    for line in rows:
        cells = line.split()
        if len(cells) != len(names):
            tally["rows cut short or with too many cells left out"] += bool(cells)
            continue
        if fix and cells[fix[0]].lower() != b"nan":
            place = [cells[k] for k in fix]
            before = before or place
            if place == before:
                tally["fixes left out that a segment repeats from the one before"] += 1
                cells = [b"nan" if k in fix else cell for k, cell in enumerate(cells)]
            else:
                fix = []
        try:
            record = dict(zip(names, map(float, cells), strict=True))
        except ValueError:
            tally["rows with text among the numbers left out"] += 1
            continue
        for name in angles:
            record[name] = degrees_of(record[name])
        yield TOPIC, record[clock], record


def _head(path: Path, rows: Iterator[bytes]) -> tuple[list[str], list[str]]:
    """Names and units: the first two of the label lines behind the tags."""
    tags: dict[bytes, bytes] = {}
    for line in rows:
        key, _, value = line.partition(b":")
        tags[key.strip()] = value.strip()
        if len(tags) >= int(tags.get(b"num_ascii_tags", b"14")):
            break
    labels = [
        next(rows, b"").decode("ascii", "replace").split() for _ in range(int(tags.get(b"num_label_lines", b"3")))
    ]
    if len(labels) < 2 or not labels[0] or len(labels[0]) != len(labels[1]):
        raise MissionError(
            f"{path}: the lines with the names and the units of a glider's table are missing or disagree."
        )
    return labels[0], labels[1]


def degrees_of(value: float | None) -> float:
    """Degrees of a number that is written ddmm.mmmm; NaN where there is none."""
    if value is None or not abs(value) <= _LARGEST_ANGLE:
        return math.nan
    degrees, minutes = divmod(abs(value), 100.0)
    return math.copysign(degrees + minutes / 60.0, value)

"""Reports of Water Linked DVLs as their TCP port sends them: one JSON object a line (json_v2 and json_v3), any prefix.

The topic is the report's ``type`` (``velocity``, ``velocity_water``, ``position_local``). ``log_time`` is the time at
which the report was valid [s since 1970, by the instrument's clock]; of old reports without one, the sum of the times
between them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.choosing import Wanted
from navfilter.io.logs.lines import lines

__all__ = ["records"]


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    elapsed_s = 0.0
    for line in lines(path, tally):
        begin = line.find(b"{")
        if begin < 0:
            tally["lines without a report"] += bool(line.strip())
            continue
        try:
            report = json.loads(line[begin:])
            topic = str(report["type"])
        except (ValueError, KeyError, TypeError):
            tally["reports cut short or without a type left out"] += 1
            continue
        elapsed_s += 1e-3 * float(report.get("time") or 0.0)
        if wanted(topic):
            yield topic, _time_s(report, elapsed_s), report


def _time_s(report: dict[str, Any], elapsed_s: float) -> float:
    if "time_of_validity" in report:
        return 1e-6 * float(report["time_of_validity"])
    return float(report["ts"]) if "ts" in report else elapsed_s

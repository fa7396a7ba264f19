"""Reports of Water Linked DVLs as their TCP port sends them: one JSON object a line (json_v2 and json_v3), any prefix.

The topic is the report's ``type`` (``velocity``, ``velocity_water``, ``position_local``). ``log_time`` is the time at
which the report was valid [s since 1970, by the instrument's clock]; of old reports without one, the sum of the times
between them.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from navfilter.io.logs.lines import lines
from navfilter.io.logs.topic_names import Wanted


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    elapsed_s = 0.0
    for line in lines(path, tally, wanted.allowance):
        if b"{" not in line:
            tally["lines without a report"] += bool(line.strip())
            continue
        report = report_in(line)
        if report is None:
            tally["reports cut short or without a type left out"] += 1
            continue
        since_s = 1e-3 * number(report.get("time"))
        elapsed_s += since_s if math.isfinite(since_s) else 0.0
        if wanted(report["type"]):
            time_s = valid_s(report)
            yield report["type"], elapsed_s if math.isnan(time_s) else time_s, report


def report_in(line: bytes) -> dict[str, Any] | None:
    """The report in a line, behind any prefix; None where it is cut short, none at all, or without a type."""
    try:
        report = json.loads(line[line.index(b"{") :])
    except (ValueError, RecursionError):
        return None
    return report if isinstance(report, dict) and isinstance(report.get("type"), str) else None


def valid_s(report: Mapping[str, Any]) -> float:
    """When a report was valid [s since 1970, by the instrument's clock]; NaN where it does not say."""
    return 1e-6 * number(report["time_of_validity"]) if "time_of_validity" in report else number(report.get("ts"))


def number(value: Any) -> float:
    """A finite number of a report; NaN for anything else."""
    try:
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else math.nan
    except OverflowError:
        return math.nan

"""MOOS logs (.alog): a line is time, name of the variable, who published it, value; each variable is a topic.

A value of pairs (``X=12.5,Y=3``) becomes one field per pair; any other is the field ``value``. Times count from the
start of the log.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from navfilter.io.logs.lines import lines
from navfilter.io.logs.topic_names import Wanted


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    for line in lines(path, tally, wanted.allowance):
        if line.startswith(b"%") or not line.strip():
            continue
        parts = line.split(None, 3)
        try:
            time_s, name = float(parts[0]), parts[1].decode("utf-8")
        except (ValueError, IndexError):
            tally["lines without time and name left out"] += 1
            continue
        if wanted(name):
            text = parts[3].decode("utf-8", "replace") if len(parts) > 3 else ""
            source = parts[2].decode("utf-8", "replace") if len(parts) > 2 else ""
            yield name, time_s, {"source": source, **_fields(text)}


def _fields(text: str) -> dict[str, float | str | None]:
    pairs = [pair.partition("=") for pair in text.split(",")]
    if all(equals and key.strip() for key, equals, _ in pairs):
        return {key.strip(): _cell(value) for key, _, value in pairs}
    return {"value": _cell(text)}


def _cell(text: str) -> float | str | None:
    try:
        return float(text)
    except ValueError:
        return text.strip() or None

"""What the topics of known kinds give: which readings, in which fields, units and axes (known_topics.toml)."""

from __future__ import annotations

import functools
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navfilter.io.logs.survey import Survey, Topic

__all__ = ["READINGS", "Use", "uses_of"]

#: What a topic may read -> how that is said.
READINGS = {
    "imu": "turn rates and specific forces",
    "attitude": "roll, pitch and heading",
    "velocity": "velocity over ground in the body's axes",
    "odometry": "velocity by wheels, camera or another filter",
    "water": "velocity through the water in the body's axes",
    "speed": "speed over ground, from fixes",
    "heading": "heading",
    "magnetic": "heading from magnetic north",
    "course": "course over ground, from fixes",
    "field": "the magnetic field",
    "depth": "depth",
    "pressure": "pressure of the water",
    "position": "fixes",
}


@dataclass(frozen=True)
class Use:
    """How a topic becomes a stream.

    Parameters
    ----------
    format : str
        Module of the format.
    pattern : str
        Regular expression for the type of the topic's messages, or for its name where the format has no types.
    reading : str
        Key of `READINGS`.
    lines : tuple of str
        Groups of the mission.toml.
    fields : tuple of str
        Fields that must be there, with a value.
    where : str
        Condition on the rows; empty: all.
    guess : str
        What is not known for certain; empty: nothing.
    """

    format: str
    pattern: str
    reading: str
    lines: tuple[str, ...]
    fields: tuple[str, ...] = ()
    where: str = ""
    guess: str = ""

    def fits(self, topic: Topic) -> bool:
        """Whether a topic is of this kind, with values in its fields."""
        named = re.search(self.pattern, topic.kind or topic.name) is not None
        return named and all(topic.has(field) and _some(topic, field) for field in self.fields)


@functools.cache
def _known() -> tuple[Use, ...]:
    rows: list[dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["use"]
    return tuple(Use(**{**row, "lines": tuple(row["lines"]), "fields": tuple(row["fields"])}) for row in rows)


def uses_of(found: Survey) -> list[tuple[Topic, Use]]:
    """The topics of a log that are of a known kind, each with all that it can give; the preferred first."""
    rows = [use for use in _known() if use.format == found.format.module]
    return [(topic, use) for use in rows for topic in sorted(found.topics, key=lambda t: -t.count) if use.fits(topic)]


def _some(topic: Topic, field: str) -> bool:
    column = topic.columns[field]
    return column.dtype.kind not in "fc" or bool((column == column).any())

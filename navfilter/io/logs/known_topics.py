"""What the topics of known kinds give: which readings, in which fields, units and axes (known_topics.toml)."""

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.arrays import AnyArray
from navfilter.io.logs.survey import Survey, Topic
from navfilter.io.table import Table, Where

#: Senders share a topic where they speak at once in no more than this share of cases [1].
AT_ONCE = 0.1
_TOLD: dict[str, Any] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: What a topic may read -> how that is said.
READINGS: dict[str, str] = _TOLD["readings"]


@dataclass(frozen=True)
class Use:
    """How a topic becomes a stream.

    Parameters
    ----------
    format : str
        Module of the format.
    pattern : str
        Regular expression for the type of the topic's messages, or for its name where the format has no types; that of
        a topic of several senders is as of the first.
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
    when : str
        Condition under which all this holds; it is not one on the rows.
    """

    format: str
    pattern: str
    reading: str
    lines: tuple[str, ...]
    fields: tuple[str, ...] = ()
    where: str = ""
    guess: str = ""
    when: str = ""

    def fits(self, topic: Topic) -> bool:
        """Whether a topic is of this kind, with values in its fields."""
        named = re.search(self.pattern, topic.kind or topic.name.replace("*", "..")) is not None
        if not (named and all(map(topic.has, self.fields))):
            return False
        rows = np.ones(next(iter(topic.columns.values())).size, dtype=bool)
        if self.when:
            condition = Where(**tomllib.loads(f"when = {self.when}")["when"])
            rows = condition.rows(Table(topic.name, topic.columns))
        return bool(rows.any()) and all(_some(topic.columns[field][rows]) for field in self.fields)


_KNOWN = [Use(**{**row, "lines": tuple(row["lines"]), "fields": tuple(row["fields"])}) for row in _TOLD["use"]]


def uses_of(found: Survey) -> list[tuple[Topic, Use]]:
    """The topics of a log that are of a known kind, each with all that it can give; the preferred first."""
    if found.uses:
        return list(found.uses)
    rows = [use for use in _KNOWN if use.format == found.format.module]
    topics = sorted([*found.topics, *_together(found)], key=lambda topic: -topic.count)
    return [(topic, use) for use in rows for topic in topics if use.fits(topic)]


def _together(found: Survey) -> Iterator[Topic]:
    """Topics that several senders share one after the other, as when a receiver begins to use a second system."""
    short: Callable[[str], str] | None = getattr(found.format.load(), "short_name", None)
    if short is None:
        return
    for name in sorted({short(topic.name) for topic in found.topics}):
        senders = [topic for topic in found.topics if short(topic.name) == name]
        times = np.sort(np.concatenate([topic.time_s for topic in senders]))
        step_s = float(np.median(np.diff(times))) if times.size > 2 else 0.0
        # two receivers that speak at the same time are two
        alone = step_s > 0.0 and float(np.mean(np.diff(times) < 0.5 * step_s)) < AT_ONCE
        if len(senders) > 1 and alone:
            columns = {field: np.concatenate([t.columns[field] for t in senders]) for field in _shared(senders)}
            yield Topic(f"*{name}", senders[0].kind, times.size, times, columns, senders[0].units)


def _shared(senders: list[Topic]) -> list[str]:
    return [field for field in senders[0].columns if all(topic.has(field) for topic in senders)]


def _some(column: AnyArray) -> bool:
    return column.dtype.kind not in "fc" or bool((column == column).any())

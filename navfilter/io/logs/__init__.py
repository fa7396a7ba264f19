"""Logs: files in which several instruments are recorded together, each under its topic, as tables for a mission.toml.

One short module per format, with one function ``records(path, wanted, tally)`` that yields ``(topic, time_s, record)``
in the order of the file. All else (columns, dotted names, short names of topics, notes, the survey) is done here, once.
"""

from __future__ import annotations

import fnmatch
import importlib
import importlib.util
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from navfilter.io.logs.gathering import TopicColumns
from navfilter.io.logs.lines import first_bytes
from navfilter.io.table import Table, listing
from navfilter.mission import MissionError

__all__ = ["FORMATS", "Format", "Shelf", "format_of", "records_of"]


@dataclass(frozen=True)
class Format:
    """A format of logs, and how it is known and read.

    Parameters
    ----------
    title : str
        For messages.
    module : str
        Module of this folder.
    suffixes : tuple of str
        Endings of its files, in lower case.
    package, extra : str
        What it is read with, and the extra of navfilter that brings it; empty: nothing beside navfilter.
    pattern : bytes
        Regular expression that the beginning of such a file contains, for files of any other ending.
    """

    title: str
    module: str
    suffixes: tuple[str, ...]
    package: str = ""
    extra: str = ""
    pattern: bytes = b""

    def load(self) -> ModuleType:
        """The module that reads it. Raises MissionError where what it needs is not installed."""
        if self.package and importlib.util.find_spec(self.package) is None:
            raise MissionError(
                f'{self.title} is read with {self.package}, which is not installed: pip install "navfilter[{self.extra}]"'
            )
        return importlib.import_module(f"navfilter.io.logs.{self.module}")


FORMATS: tuple[Format, ...] = (
    Format("a ROS bag", "ros", (".bag", ".db3", ".mcap"), "rosbags", "ros"),
    Format("a Water Linked log", "waterlinked", (), pattern=rb'"format": ?"json_v'),
    Format("a MOOS log", "moos", (".alog",)),
    Format(
        "NMEA 0183", "nmea", (".nmea",), "pynmeagps", "nmea", rb"[$!][A-Z]{2}[A-Z0-9]{3,6},[^*\r\n]*\*[0-9A-Fa-f]{2}"
    ),
)


def format_of(path: Path) -> Format | None:
    """The format of a log; None for what is no log (or a table that `read_table` reads)."""
    if path.is_dir():
        return FORMATS[0] if (path / "metadata.yaml").exists() else None
    for known in FORMATS:
        if any(ending.lower() in known.suffixes for ending in path.suffixes[-2:]):
            return known
    head = first_bytes(path)
    return next((known for known in FORMATS if known.pattern and re.search(known.pattern, head)), None)


def records_of(path: Path, wanted: Callable[[str], bool], tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """All records of the topics wanted: topic, time [s] by the log's own clock, and the record.

    Parameters
    ----------
    path : Path
    wanted : callable
        Told the full name of a topic, whether its records are wanted.
    tally : Counter
        Gets what was dropped: reason -> how often.

    Raises
    ------
    MissionError
        If the file is no log, cannot be read, or its reader is not installed.
    """
    known = format_of(path)
    if known is None:
        endings = ", ".join(f"{one.title} ({', '.join(one.suffixes) or 'any ending'})" for one in FORMATS)
        raise MissionError(
            f"{path} is no log that navfilter knows (known: {endings}); leave topic out for a table."
        )
    yield from known.load().records(path, wanted, tally)


class Shelf:
    """The logs of one mission: each is gone through once, for all topics and columns that are wanted of it.

    Parameters
    ----------
    wanted : mapping of Path to (mapping of str to (collection of str or None)), optional
        Log -> topic -> columns (None: all). A topic asked for that is not in it is read by itself.
    """

    def __init__(self, wanted: Mapping[Path, Mapping[str, Collection[str] | None]] | None = None) -> None:
        self._wanted = dict(wanted or {})
        self._tables: dict[tuple[Path, str], Table] = {}

    def table(self, path: Path, topic: str) -> Table:
        """The table of one topic.

        Raises
        ------
        MissionError
            If the log has no such topic; the message lists those it has.
        """
        if (path, topic) not in self._tables:
            topics = self._wanted.get(path, {})
            wanted = topics if topic in topics else {topic: None}
            for name, table in _read(path, wanted).items():
                self._tables[path, name] = table
        return self._tables[path, topic]


def _read(path: Path, wanted: Mapping[str, Collection[str] | None]) -> dict[str, Table]:
    known = format_of(path)
    short = getattr(known.load(), "short_name", _without_instance) if known else _without_instance
    gathered = {name: TopicColumns(columns) for name, columns in wanted.items()}
    answers: dict[str, Counter[str]] = {name: Counter() for name in wanted}
    #: Full name of a topic -> the topics asked for that it answers to.
    asked_as: dict[str, list[str]] = {}
    tally: Counter[str] = Counter()

    def is_wanted(topic: str) -> bool:
        if topic not in asked_as:
            names = [name for name in wanted if topic == name or ("*" in name and fnmatch.fnmatchcase(topic, name))]
            names = names or [name for name in wanted if name == short(topic)]
            asked_as[topic] = names
        return bool(asked_as[topic])

    for topic, time_s, record in records_of(path, is_wanted, tally):
        for name in asked_as[topic]:
            answers[name][topic] += 1
            gathered[name].put(time_s, record)
    for name, topics in answers.items():
        if len(topics) > 1 and "*" not in name:
            several = " and ".join(f"{topic} ({count} records)" for topic, count in topics.items())
            raise MissionError(f'{path}: topic "{name}" is {several}: name one of them, or "*{name}" for all.')
        if not topics:
            there = ", ".join(asked_as) or "none"
            raise MissionError(f'{path}: there is no topic "{name}" with any record (topics: {there}).')
    for name, columns in gathered.items():
        if absent := columns.absent():
            there = listing(["log_time", *columns.fields])
            raise MissionError(f'{path}: topic "{name}" has no field "{absent[0]}" (fields: {there}).')
        tally[f"cells of {name} are no numbers"] += columns.unreadable
    notes = tuple(f"{path.name}: {count} {reason}" for reason, count in tally.items() if count)
    tables = {}
    for k, (name, columns) in enumerate(gathered.items()):
        tables[name] = Table(f"{path} {name}", columns.columns(), notes if k == 0 else ())
    return tables


def _without_instance(topic: str) -> str:
    """``"IMU"`` for ``"IMU[0]"``: enough where there is only one."""
    return topic.split("[", 1)[0]

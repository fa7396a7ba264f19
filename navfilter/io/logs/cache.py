"""The tables of a mission's logs: each log is gone through once, for all that is wanted of it."""

import itertools
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from navfilter.foundation.display import counted
from navfilter.io.logs.formats import log_format
from navfilter.io.logs.record_columns import LOG_TIME, TopicColumns
from navfilter.io.logs.topic_names import Wanted, without_instance
from navfilter.io.table import Table, listing
from navfilter.io.trust import Allowance
from navfilter.models.mission import MissionError


class Shelf:
    """The logs of one mission.

    Parameters
    ----------
    wanted : mapping of Path to (mapping of str to (collection of str or None)), optional
        Log, or a pattern of several that follow one another -> topic -> columns (None: all). A topic asked for that
        is not in it is read by itself.
    allowance : Allowance, optional
        What the mission's files may unpack to.
    """

    def __init__(
        self,
        wanted: Mapping[Path, Mapping[str, Collection[str] | None]] | None = None,
        allowance: Allowance | None = None,
    ) -> None:
        self._wanted, self._allowance = dict(wanted or {}), allowance or Allowance()
        self._tables: dict[tuple[Path, str], Table] = {}

    def table(self, path: Path, topic: str) -> Table:
        """The table of one topic.

        Raises
        ------
        MissionError
            If the file is no log, cannot be read, its reader is not installed, or it has no such topic; the message
            lists those it has.
        """
        if (path, topic) not in self._tables:
            topics = self._wanted.get(path, {})
            wanted = topics if topic in topics else {topic: None}
            for name, table in _read(path, wanted, self._allowance).items():
                self._tables[path, name] = table
        return self._tables[path, topic]


def _read(path: Path, columns: Mapping[str, Collection[str] | None], allowance: Allowance) -> dict[str, Table]:
    paths = files_of(path)
    module = log_format(paths[0]).load()
    wanted = Wanted(columns, getattr(module, "short_name", without_instance), allowance)
    gathered = {name: TopicColumns(fields) for name, fields in columns.items()}
    answers: dict[str, Counter[str]] = {name: Counter() for name in columns}
    tally: Counter[str] = Counter()
    for topic, time_s, record in itertools.chain.from_iterable(module.records(one, wanted, tally) for one in paths):
        for name in wanted.asked_as(topic):
            answers[name][topic] += np.size(time_s)
            gathered[name].put(time_s, record)
    for name, topics in answers.items():
        _check_one(path, name, topics, wanted, tally)
    for name, topic_columns in gathered.items():
        if absent := topic_columns.absent():
            there = listing("fields", [LOG_TIME, *topic_columns.fields])
            raise MissionError(f'{path}: topic "{name}" has no field "{absent[0]}" ({there}).')
        tally[f"cells of {name} without a number"] += topic_columns.unreadable
    notes = tuple(f"{path.name}: {counted(count, reason)}" for reason, count in tally.items() if count)
    notes += tuple(f"{path.name}: {words}" for words in _namesakes(answers, wanted))
    # What was dropped was dropped once, from the log: the first of its tables says so.
    tables = {}
    for name, part in gathered.items():
        units = wanted.units.get(next(iter(answers[name])), {})
        tables[name] = Table(f"{path} {name}", part.columns(), notes, units, clock=wanted.clock)
        notes = ()
    return tables


def _namesakes(answers: Mapping[str, Counter[str]], wanted: Wanted) -> Iterator[str]:
    """Topics that nobody asked for and that say the same as one that was."""
    taken = {topic for topics in answers.values() for topic in topics}
    for topic in sorted(taken):
        if others := [
            other for other in wanted.seen if other not in taken and wanted.short(other) == wanted.short(topic)
        ]:
            both = f"*{wanted.short(topic)}"
            yield f'{topic} is read, and {", ".join(others)} beside it is not; topic = "{both}" reads all of them'


def files_of(path: Path) -> list[Path]:
    """The files of a pattern such as ``segment_*.dat``, in the order of their names; one file as it is."""
    if "*" not in path.name:
        if not path.exists():
            raise MissionError(f"{path}: no such file. Check the path and the environment variables in it.")
        return [path]
    if not (found := sorted(path.parent.glob(path.name))):
        raise MissionError(f"{path}: no file fits this pattern.")
    return found


def _check_one(path: Path, name: str, topics: Counter[str], wanted: Wanted, tally: Counter[str]) -> None:
    if len(topics) > 1 and "*" not in name:
        several = " and ".join(f"{topic} ({counted(count, 'records')})" for topic, count in topics.items())
        raise MissionError(f'{path}: topic "{name}" is {several}: name one of them, or "*{name}*" for all.')
    if not topics:
        there = ", ".join(wanted.seen) or "none"
        why = "; ".join(counted(count, reason) for reason, count in tally.items() if count)
        left_out = f" Left out while reading: {why}." if why else ""
        if any(name in wanted.asked_as(topic) for topic in wanted.seen):
            raise MissionError(f'{path}: none of the records of topic "{name}" can be used.{left_out}')
        raise MissionError(f'{path}: there is no topic "{name}" with any record (topics: {there}).{left_out}')

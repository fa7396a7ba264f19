"""What a log holds: its topics with their rates, spans, gaps and first values.

The tables of a mission's logs: each log is gone through once, for all that is wanted of it.

Records of a log become columns: one flat array of numbers for each topic, so that hours cost megabytes.
"""

import itertools
import math
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.arrays import AnyArray, Array
from navfilter.foundation.display import counted
from navfilter.foundation.quoting import one_line
from navfilter.io.logs.formats import Format, log_format
from navfilter.io.logs.topic_names import INSTRUMENT, Wanted, without_instance
from navfilter.io.table import Table, listing
from navfilter.io.trust import UNPACKED_BYTES, Allowance
from navfilter.models.mission import MissionError

#: Longer sequences (images, point clouds, spectra) are no columns.
_LONGEST_SEQUENCE = 36
#: What the log itself says about when a record was made or written [s].
LOG_TIME = "log_time"


class TopicColumns:
    """The columns of one topic.

    Parameters
    ----------
    wanted : collection of str, optional
        Dotted names of the fields to keep, such as ``"twist.twist.linear.x"`` or ``"covariance[0]"``. None: all numbers
        and texts of the first record.

    Notes
    -----
    A field that has ``sec`` and ``nanosec`` is one time in seconds. What a record lacks is NaN.
    """

    def __init__(self, wanted: Collection[str] | None = None) -> None:
        self._wanted = None if wanted is None else [name for name in wanted if name != LOG_TIME]
        self._times = array("d")
        self._numbers = array("d")
        self._texts: dict[str, list[str]] = {}
        self._names: list[str] = []
        self._fetches: list[Callable[[Any], Any]] | None = None
        self._doubtful: list[str] = []
        self.fields: tuple[str, ...] = ()
        self.unreadable = 0

    def __len__(self) -> int:
        return len(self._times)

    def put(self, time_s: float | Array, record: Any) -> None:
        """Append one record, or many: their times and a mapping of arrays."""
        if isinstance(time_s, np.ndarray):
            self._put_block(time_s, record)
            return
        if self._fetches is None:
            self._begin(record)
        try:
            row = array("d", [fetch(record) for fetch in self._fetches])  # type: ignore[union-attr]
        except (TypeError, AttributeError, KeyError, IndexError):
            row = array("d", [self._number(record, name) for name in self._names])
        self._times.append(time_s)
        self._numbers.extend(row)
        for name, cells in self._texts.items():
            found = _field(record, name)
            cells.append(found if isinstance(found, str) else "" if found is None else str(found))

    def _put_block(self, time_s: Array, record: Mapping[str, AnyArray]) -> None:
        if not self.fields:
            self.fields = tuple(record)
            self._names = list(self.fields) if self._wanted is None else self._wanted
            self._doubtful = [name for name in self._names if name not in record]
        lacking = np.full(time_s.size, np.nan)
        rows = np.column_stack([lacking, *(record.get(name, lacking) for name in self._names)])[:, 1:]
        self._times.frombytes(np.ascontiguousarray(time_s, dtype=np.float64).tobytes())
        self._numbers.frombytes(np.ascontiguousarray(rows, dtype=np.float64).tobytes())

    def absent(self) -> list[str]:
        """The wanted fields that no record has."""
        columns = self.columns() if self._doubtful else {}
        return [name for name in self._doubtful if name in columns and np.isnan(columns[name]).all()]

    def columns(self) -> dict[str, AnyArray]:
        """Name -> array of one element per record; ``log_time`` is the first."""
        values = np.frombuffer(self._numbers, dtype=np.float64).reshape(len(self._times), -1) if self._names else None
        columns: dict[str, AnyArray] = {LOG_TIME: np.array(self._times)}
        for k, name in enumerate(self._names):
            columns[name] = values[:, k].copy()  # type: ignore[index]
        for name in [name.removesuffix(".nanosec") for name in self._names if name.endswith(".nanosec")]:
            columns[name] = columns[f"{name}.sec"] + 1e-9 * columns[f"{name}.nanosec"]
        for name, cells in self._texts.items():
            columns[name] = np.array(cells, dtype=object)
        return columns

    def _begin(self, record: Any) -> None:
        self.fields = tuple(leaves(record))
        wanted = list(self.fields) if self._wanted is None else self._wanted
        for name in wanted:
            found = _field(record, name)
            if found is None and name not in self.fields:
                self._doubtful.append(name)
            if isinstance(found, str):
                self._texts[name] = []
            elif hasattr(found, "nanosec"):
                self._names += [f"{name}.sec", f"{name}.nanosec"]
            else:
                self._names.append(name)
        self._names = list(dict.fromkeys(self._names))
        self._fetches = [_fetch(record, name) for name in self._names]

    def _number(self, record: Any, name: str) -> float:
        found = _field(record, name)
        if found is None or found == "":
            return math.nan
        try:
            return float(found)
        except (TypeError, ValueError):
            self.unreadable += 1
            return math.nan


def leaves(record: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of the numbers and texts of a record, in its order; a time of two parts is one name."""
    if isinstance(record, Mapping):
        parts = [(str(key), value) for key, value in record.items()]
    else:
        names = getattr(record, "__dataclass_fields__", None) or getattr(record, "_fieldnames", None) or vars(record)
        parts = [(name, getattr(record, name)) for name in names if not name.startswith("_")]
    for key, value in parts:
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, bool | int | float | str | np.number) or value is None or hasattr(value, "nanosec"):
            yield name
        elif isinstance(value, list | tuple | np.ndarray):
            yield from _elements(name, value)
        elif isinstance(value, Mapping) or hasattr(value, "__dataclass_fields__"):
            yield from leaves(value, name)


def _elements(name: str, value: Any) -> Iterator[str]:
    if len(value) > _LONGEST_SEQUENCE:
        return
    for k, element in enumerate(value):
        if isinstance(element, bool | int | float | str | np.number):
            yield f"{name}[{k}]"
        elif isinstance(element, Mapping) or hasattr(element, "__dataclass_fields__"):
            yield from leaves(element, f"{name}[{k}]")
        elif isinstance(element, list | tuple | np.ndarray):
            yield from _elements(f"{name}[{k}]", element)


def _fetch(record: Any, name: str) -> Callable[[Any], Any]:
    """A quick way to a field that the record has; raises where another one lacks it."""
    if isinstance(record, Mapping):
        return itemgetter(name) if name in record else partial(_field, name=name)
    base, _, place = name.removesuffix("]").partition("[")
    if not place:
        return attrgetter(name)
    if not place.isdecimal():
        return partial(_field, name=name)
    whole, at = attrgetter(base), int(place)
    return lambda found: whole(found)[at]


def _field(record: Any, name: str) -> Any:
    """A field by its dotted name; None where there is none."""
    if isinstance(record, Mapping) and name in record:
        return record[name]
    found = record
    for part in name.split("."):
        key, *places = part.replace("]", "").split("[")
        found = found.get(key) if isinstance(found, Mapping) else getattr(found, key, None)
        for place in places:
            try:
                found = found[int(place)]  # type: ignore[index]
            except (TypeError, IndexError, ValueError):
                return None
        if found is None:
            return None
    return found


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


#: Records of each topic that are kept for a look at their values.
_KEPT = 3000
#: A step longer than this many usual ones is a gap.
_GAP = 10.0
#: Later than 2001: these are seconds since 1970, not since some start.
_UTC_S = 1e9


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic of a log.

    Parameters
    ----------
    name, kind : str
        Full name; type of its messages where the format has such.
    count : int
        Records.
    time_s : ndarray, shape (count,)
        `log_time` of every record.
    columns : dict of str to ndarray
        Fields of the first records.
    units : dict of str to str
        Where the log states them.
    """

    name: str
    kind: str
    count: int
    time_s: Array
    columns: dict[str, AnyArray]
    units: dict[str, str]

    @property
    def rate_hz(self) -> float:
        """Mean rate, gaps left out; 0 for fewer than two records."""
        step = np.diff(np.sort(self.time_s))
        whole = step[step <= self.longest_usual_s]
        total = float(whole.sum())
        return whole.size / total if total > 0 else 0.0

    @property
    def longest_usual_s(self) -> float:
        """A step longer than this is a gap [s]; bursts do not make it shorter than the mean step allows."""
        step = np.diff(np.sort(self.time_s))
        return _GAP * max(float(np.median(step)), float(step.mean())) if step.size else 0.0

    @property
    def gaps(self) -> Array:
        """Lengths of the gaps [s]."""
        step = np.diff(np.sort(self.time_s))
        return step[step > self.longest_usual_s]

    def has(self, *fields: str) -> bool:
        """Whether all these fields are there."""
        return all(field in self.columns for field in fields)


@dataclass(frozen=True, eq=False)
class Survey:
    """A log.

    Parameters
    ----------
    path : Path
    format : Format
    topics : tuple of Topic
        In the order of their first records.
    notes : tuple of str
        What was dropped, and why.
    unpacked_bytes : int
        What the log may unpack to when it is read again.
    clock : str
        What the times count by where that is not UTC, see `navfilter.io.logs.topic_names`.
    layout, time : tuple of str, str
        Of a table: keys that say how it is laid out, and the value of ``time``.
    uses : tuple of (Topic, Use)
        Of a table: what it can give.
    doubt : str
        What is not known of the times.
    """

    path: Path
    format: Format
    topics: tuple[Topic, ...]
    notes: tuple[str, ...]
    unpacked_bytes: int = UNPACKED_BYTES
    clock: str = ""
    layout: tuple[str, ...] = ()
    time: str = ""
    uses: tuple[tuple[Topic, Any], ...] = ()
    doubt: str = ""

    @property
    def begin_s(self) -> float:
        """First `log_time` of any topic [s]."""
        return min(float(topic.time_s.min()) for topic in self.topics)

    @property
    def end_s(self) -> float:
        """Last `log_time` of any topic [s]."""
        return max(float(topic.time_s.max()) for topic in self.topics)

    @property
    def is_utc(self) -> bool:
        """Whether times count from 1970."""
        return self.begin_s > _UTC_S


def survey(path: Path, unpacked_bytes: int = UNPACKED_BYTES) -> Survey:
    """Go through a log and say what is in it.

    Parameters
    ----------
    path : Path
        A log, or a pattern with ``*`` of several that follow one another.
    unpacked_bytes : int
        What it may unpack to.

    Raises
    ------
    MissionError
        If it is no log, cannot be read or is empty.
    """
    paths = files_of(path)
    known = log_format(paths[0])
    module = known.load()
    wanted, tally = Wanted(allowance=Allowance(unpacked_bytes)), Counter[str]()
    times: dict[str, array[float]] = {}
    kept: dict[str, TopicColumns] = {}
    for topic, time_s, record in itertools.chain.from_iterable(module.records(one, wanted, tally) for one in paths):
        if topic not in times:
            times[topic], kept[topic] = array("d"), TopicColumns()
        if isinstance(time_s, np.ndarray):
            times[topic].frombytes(time_s.tobytes())
        else:
            times[topic].append(time_s)
        if len(kept[topic]) < _KEPT:
            kept[topic].put(time_s, record)
    if not times:
        raise MissionError(f"{path} holds no records.")
    kinds = module.kinds(paths[0]) if hasattr(module, "kinds") else {}
    topics = []
    for name, stamps in times.items():
        time = np.array(stamps)
        topics.append(
            Topic(name, kinds.get(name, ""), time.size, time, kept[name].columns(), wanted.units.get(name, {}))
        )
    notes = tuple(counted(count, reason) for reason, count in tally.items() if count)
    return Survey(path, known, tuple(topics), notes, unpacked_bytes, wanted.clock)


def survey_text(found: Survey, most: int = 80) -> str:
    """The topics as a table of text, one line each, and what was dropped."""
    length = found.end_s - found.begin_s
    lines = [
        f"{one_line(found.path.name)}: {found.format.title}, {len(found.topics)} topics, {length:.1f} s{_when(found)}.",
        "",
    ]
    width = max(5, *(len(_title(topic)) for topic in found.topics[:most]))
    lines.append(f"{'topic':{width}}  {'records':>8} {'Hz':>7} {'from s':>8} {'to s':>8}  gaps           first values")
    for topic in found.topics[:most]:
        begin, end = topic.time_s.min() - found.begin_s, topic.time_s.max() - found.begin_s
        gaps = f"{topic.gaps.size}, up to {topic.gaps.max():.3g} s" if topic.gaps.size else "-"
        rate = f"{topic.rate_hz:.4g}" if topic.count > 1 else "-"
        head = f"{_title(topic):{width}}  {topic.count:8d} {rate:>7} {begin:8.1f} {end:8.1f}  {gaps:13}"
        lines.append(f"{head}  {_first_values(topic)}")
    if len(found.topics) > most:
        lines.append(f"and {len(found.topics) - most} more topics")
    if found.notes:
        lines += ["", "Left out while reading:", *(f"  {note}" for note in found.notes)]
    return "\n".join(lines)


def _title(topic: Topic) -> str:
    return one_line(f"{topic.name} ({topic.kind})" if topic.kind else topic.name)


def _when(found: Survey) -> str:
    if not found.is_utc:
        return " (times count from the start of the recorder)"
    clock = "by the instrument's clock" if found.clock == INSTRUMENT else "UTC"
    return f" from {np.datetime64(int(found.begin_s), 's')} {clock}"


def _first_values(topic: Topic, most: int = 4) -> str:
    shown = []
    for name, column in topic.columns.items():
        if name == LOG_TIME or name.endswith((".sec", ".nanosec")) or "covar" in name:
            continue
        first = next((cell for cell in column if not (isinstance(cell, float) and np.isnan(cell)) and cell != ""), None)
        if first is not None:
            value = first if isinstance(first, str) else f"{first:.10g}" if "stamp" in name else f"{first:.6g}"
            shown.append(f"{name} = {value}{' ' + topic.units[name] if name in topic.units else ''}")
    return one_line(", ".join(shown[:most])) + (", ..." if len(shown) > most else "")

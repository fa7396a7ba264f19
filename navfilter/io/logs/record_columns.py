"""Records of a log become columns: one flat array of numbers for each topic, so that hours cost megabytes."""

import math
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from navfilter.foundation.arrays import AnyArray, Array

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

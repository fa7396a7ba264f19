"""Readings as line-delimited JSON: what one line may say, and the log folder that `navfilter run` writes.

One reading per line, in SI units and radians::

    {"sensor": "imu", "time_s": 12.34, "rate_b": [0.0, 0.0, 0.01], "force_b": [0.1, 0.0, -9.8]}
    {"sensor": "compass", "time_s": 12.34, "value": 1.57}
    {"sensor": "gps", "time_s": 12.0, "value": [0.785, -0.07, null], "sd": [2.0, 2.0, 5.0]}
    {"sensor": "start", "latitude_deg": 45.0, "longitude_deg": -4.0, "heading_deg": 90.0}

A vehicle with several inertial units has a line for each by its name in place of "imu".
``null`` is a missing component. Whatever else arrives is a `BadLine` of one of the `BAD_KINDS`, never an exception. A
log holds the readings in the order of their arrival, byte for byte as they came, and between them notes, which have an
``"event"`` (see `Note`).
"""

import datetime
import json
import math
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.display import counted
from navfilter.io.mission_schema import StartSpec
from navfilter.io.trust import Place
from navfilter.io.validation import validate
from navfilter.models.mission import MissionError, Stream
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle

#: A line longer than this is no reading [bytes].
LONGEST_LINE = 65536
#: What can be wrong with a line.
BAD_KINDS = (
    "too-long", "not-utf8", "not-json", "not-an-object", "unknown-sensor", "wrong-fields",
    "wrong-type", "wrong-size", "not-finite", "wrong-time", "wrong-start",
)  # fmt: skip
#: Later than this no clock counts in seconds: milliseconds since 1970 are beyond it [s].
LATEST_S = 1e11
#: A reading has at most so many components.
MOST_COMPONENTS = 16

_IMU_FIELDS = frozenset({"sensor", "time_s", "rate_b", "force_b"})
_VALUE_FIELDS = frozenset({"sensor", "time_s", "value"})


class Reading(NamedTuple):
    """One reading: `value` in SI units and radians, NaN where a component is missing; an "imu" has rate_b, then
    force_b.
    """

    sensor: str
    time_s: float
    value: list[float]
    sd: list[float] | None
    raw: bytes


class StartLine(NamedTuple):
    """A start that arrived among the readings: keyword arguments of `Start`; without ``time_s`` it is the first reading
    of the drive.
    """

    fields: dict[str, Any]
    raw: bytes


class BadLine(NamedTuple):
    """A line that is no reading, or several `lines`: one of the `BAD_KINDS`, and in words; `raw` is its note for the
    log.
    """

    kind: str
    text: str
    raw: bytes
    lines: int = 1

    @classmethod
    def several(cls, kind: str, lines: int) -> "BadLine":
        """So many lines of a kind that are not quoted any more."""
        return cls(kind, "", _dump({"event": "bad", "kind": kind, "lines": lines}), lines)


class Note(NamedTuple):
    """A line of the log that is no reading: "run" (how it was started), "start", "bad", "lost", "stop"."""

    event: str
    fields: dict[str, Any]
    raw: bytes


Item = Reading | StartLine | BadLine | Note


class _Wrong(ValueError):
    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


class LineParser:
    """Turns lines into readings, and whatever is none into a `BadLine`.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Its sensors are the known ones, and their readings must be long enough. Without it every name is a sensor.
    notes : bool
        Understand the notes of a log too; from the outside they are bad lines.
    """

    #: So many bad lines of a kind are quoted, the rest only counted: a log must not drown in them.
    QUOTED = 20

    def __init__(self, vehicle: Vehicle | None = None, *, notes: bool = False) -> None:
        self._decode = json.JSONDecoder(parse_constant=_constant).decode
        self._notes = notes
        self._reads: dict[str, int] | None = None
        self._units = {"imu"} if vehicle is None else set(vehicle.units)
        if vehicle is not None:
            drive = dict.fromkeys(vehicle.driving, 3)
            self._reads = drive | {name: sensor.reads for name, sensor in vehicle.sensors.items()}
        self._quoted: dict[str, int] = {}

    def parse(self, line: bytes) -> Item | None:
        """One line without its line feed; None for an empty one."""
        line = line.strip()
        if not line:
            return None
        try:
            if len(line) > LONGEST_LINE:
                raise _Wrong("too-long", f"{len(line)} bytes, at most {LONGEST_LINE} are read")
            return self._item(line)
        except _Wrong as wrong:
            return self._bad(wrong.kind, wrong.text, line)

    def too_long(self, begin: bytes) -> BadLine:
        """A line that was cut off because it did not end."""
        return self._bad("too-long", f"no line feed within {LONGEST_LINE} bytes", begin)

    def _bad(self, kind: str, text: str, line: bytes) -> BadLine:
        seen = self._quoted[kind] = self._quoted.get(kind, 0) + 1
        quoted = {} if seen > self.QUOTED else {"text": text[:160], "line": line[:120].decode("utf-8", "replace")}
        return BadLine(kind, quoted.get("text", ""), _dump({"event": "bad", "kind": kind, **quoted}))

    def _item(self, line: bytes) -> Item:
        try:
            fields = self._decode(line.decode("utf-8"))
        except UnicodeDecodeError as error:
            raise _Wrong("not-utf8", f"byte {error.start} is no UTF-8") from None
        except (ValueError, RecursionError) as error:
            if isinstance(error, _Wrong):
                raise
            of_json = isinstance(error, json.JSONDecodeError)
            reason = str(error).splitlines()[0] if of_json else "too deep, or a number too long"
            raise _Wrong("not-json", reason) from None
        if type(fields) is not dict:
            raise _Wrong("not-an-object", f"a line is an object {{...}}, found {type(fields).__name__}")
        if self._notes and type(fields.get("event")) is str:
            return _note(fields, line + b"\n")
        sensor = fields.get("sensor")
        if type(sensor) is not str:
            raise _Wrong("wrong-fields", 'the key "sensor" is missing or no text')
        if sensor == "start":
            return StartLine(_start_fields(fields), line + b"\n")
        if self._reads is not None and sensor not in self._reads:
            raise _Wrong("unknown-sensor", f'"{sensor[:40]}" is no sensor of this vehicle ({", ".join(self._reads)})')
        return self._reading(sensor, fields, line + b"\n")

    def _reading(self, sensor: str, fields: dict[str, Any], raw: bytes) -> Reading:
        sd = None
        if sensor in self._units or (self._reads is None and "rate_b" in fields):
            if fields.keys() != _IMU_FIELDS:
                raise _wrong_fields(fields, _IMU_FIELDS)
            value = _vector("rate_b", fields["rate_b"], 3) + _vector("force_b", fields["force_b"], 3)
        else:
            if fields.keys() != _VALUE_FIELDS and fields.keys() != _VALUE_FIELDS | {"sd"}:
                raise _wrong_fields(fields, _VALUE_FIELDS | {"sd"})
            value = _vector("value", fields["value"])
            sd = None if fields.get("sd") is None else _vector("sd", fields["sd"])
            wanted = 1 if self._reads is None else self._reads[sensor]
            if len(value) < wanted:
                raise _Wrong("wrong-size", f'"value" of {sensor} has {len(value)} components, it takes {wanted}')
        time_s = _number("time_s", fields["time_s"])
        if not -LATEST_S < time_s < LATEST_S:
            raise _Wrong("wrong-time", f'"time_s" must be seconds, found {time_s!r}')
        return Reading(sensor, time_s, value, sd, raw)


def _constant(name: str) -> float:
    raise _Wrong("not-finite", f"{name} is no number; write null for a missing component")


def _number(key: str, value: Any) -> float:
    if type(value) is float:
        if math.isfinite(value):
            return value
        raise _Wrong("not-finite", f'"{key}" is not finite')
    if type(value) is int:
        try:
            return float(value)
        except OverflowError:
            raise _Wrong("not-finite", f'"{key}" is beyond all numbers') from None
    raise _Wrong("wrong-type", f'"{key}" must be a number, found {type(value).__name__}')


def _vector(key: str, value: Any, size: int = 0) -> list[float]:
    """Numbers, or one number; null becomes NaN."""
    parts = value if type(value) is list else [value]
    if (size and len(parts) != size) or not 1 <= len(parts) <= MOST_COMPONENTS:
        raise _Wrong("wrong-size", f'"{key}" has {len(parts)} components, it takes {size or f"1 to {MOST_COMPONENTS}"}')
    return [math.nan if v is None else _number(key, v) for v in parts]


def _wrong_fields(fields: dict[str, Any], known: frozenset[str]) -> _Wrong:
    missing = sorted(known - fields.keys() - {"sd"})
    unknown = sorted(fields.keys() - known)
    words = [f"missing: {', '.join(missing)}"] * bool(missing) + [f"unknown: {', '.join(unknown)[:80]}"] * bool(unknown)
    return _Wrong("wrong-fields", "; ".join(words))


def _note(fields: dict[str, Any], raw: bytes) -> Item:
    if fields["event"] == "bad" and fields.get("kind") in BAD_KINDS:
        lines = fields.get("lines", 1)
        lines = lines if type(lines) is int and 0 < lines < 1 << 53 else 1
        return BadLine(fields["kind"], str(fields.get("text", "")), raw, lines)
    return Note(fields["event"], fields, raw)


def _dump(fields: Mapping[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode() + b"\n"


# --- the start ------------------------------------------------------------------------------------------------------


def start_from(data: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of `Start` from a table with its fields; ``time_s`` and ``date`` may be left out.

    Raises
    ------
    ValueError
        Naming the fields that are missing, unknown or impossible.
    """
    data = dict(data)
    date = data.pop("date", None)
    if "from" in data:
        raise ValueError('start: "from" has no meaning here; give the fields of the start.')
    if isinstance(date, str):
        date = datetime.date.fromisoformat(date)
    elif date is not None and not isinstance(date, datetime.date):
        raise ValueError(f"start: date must look like 2026-05-04, found {date!r}.")
    spec = validate(StartSpec, data, Path("start"), MissionError)
    given = spec.model_dump(exclude={"source"}, exclude_none=True)
    missing = [key for key in ("latitude_deg", "longitude_deg") if key not in given]
    if missing:
        raise ValueError(f"start lacks {' and '.join(missing)}.")
    if not abs(given.get("time_s", 0.0)) < LATEST_S:
        raise ValueError(f"start: time_s must be seconds, found {given['time_s']!r}.")
    Start(**given)  # its own checks
    return given if date is None else {**given, "date": date}


def _start_fields(fields: dict[str, Any]) -> dict[str, Any]:
    try:
        return start_from({key: value for key, value in fields.items() if key != "sensor"})
    except (ValueError, OverflowError, TypeError) as error:
        raise _Wrong("wrong-start", str(error)) from None


# --- the log folder -------------------------------------------------------------------------------------------------


class _Column:
    """Readings of one sensor, gathered row by row."""

    def __init__(self, width: int) -> None:
        self.time_s, self.value, self.width = array("d"), array("d"), width
        self._sd, self._sd_rows, self._sd_sizes = array("d"), array("q"), array("q")

    def add(self, time_s: float, value: list[float], sd: list[float] | None) -> None:
        if len(value) > self.width:
            self._widen(len(value))
        if sd is not None:
            self._sd.extend(sd)
            self._sd_rows.append(len(self.time_s))
            self._sd_sizes.append(len(sd))
        self.time_s.append(time_s)
        self.value.extend(value)
        self.value.extend([math.nan] * (self.width - len(value)))

    def _widen(self, width: int) -> None:
        rows = np.full((len(self.time_s), width), np.nan)
        rows[:, : self.width] = np.frombuffer(self.value).reshape(-1, self.width) if len(rows) else 0.0
        self.value, self.width = array("d", rows.tobytes()), width

    def sd(self) -> Array | None:
        """Standard deviations of the readings, (n, m), as `Stream` has them; what no navigator takes is negative."""
        if not self._sd_rows:
            return None
        rows, sizes, flat = np.array(self._sd_rows), np.array(self._sd_sizes), np.array(self._sd)
        # one for all axes or one for each; how many axes there are, the log does not say
        width = int(np.bincount(sizes[sizes > 1], minlength=2).argmax()) or 1
        result = np.full((len(self.time_s), width), np.nan)
        result[rows] = -1.0
        first = np.cumsum(sizes) - sizes
        for size in {1, width}:
            own = sizes == size
            given = flat[first[own, np.newaxis] + np.arange(size)]
            result[rows[own]] = np.where(np.isnan(given).any(axis=1, keepdims=True), -1.0, given)
        return result


def streams_of(
    readings: Iterator[Reading] | list[Reading], columns: Mapping[str, tuple[str, ...]] | None = None
) -> tuple[dict[str, Stream], list[str]]:
    """Readings in the order of their arrival as streams in the order of their times.

    Parameters
    ----------
    readings : iterable of Reading
    columns : mapping of str to tuple of str, optional
        Names of the columns by sensor; a sensor named here has a stream even when it was never heard.

    Returns
    -------
    streams : dict of str to Stream
    notes : list of str
        What had to be sorted.
    """
    columns = columns or {}
    gathered = {name: _Column(len(names)) for name, names in columns.items()}
    for reading in readings:
        if reading.sensor not in gathered:
            gathered[reading.sensor] = _Column(len(reading.value))
        gathered[reading.sensor].add(reading.time_s, reading.value, reading.sd)
    streams, notes = {}, []
    for name, column in gathered.items():
        time_s, value = np.array(column.time_s), np.array(column.value).reshape(-1, column.width)
        sd = column.sd()
        late = int(np.count_nonzero(np.diff(time_s) < 0.0))
        if late:
            notes.append(f"{name}: {counted(late, 'readings')} arrived out of order; sorted by time")
            order = np.argsort(time_s, kind="stable")
            time_s, value, sd = time_s[order], value[order], None if sd is None else sd[order]
        names = columns.get(name, ())
        names = (*names, *(f"column_{k}" for k in range(len(names), column.width)))
        streams[name] = Stream(time_s, value, names, sd)
    return streams, notes


def log_lines(path: Path, offset: int = 0) -> Iterator[bytes]:
    """The whole lines of a log from a byte offset; what stands after the last line feed was being written when the
    power went.
    """
    with path.open("rb") as file:
        file.seek(offset)
        while line := file.readline(4 * LONGEST_LINE):
            if line.endswith(b"\n"):
                yield line


def read_log(place: Place, columns: Mapping[str, tuple[str, ...]]) -> tuple[dict[str, Stream], Start | None, list[str]]:
    """Read the log of ``navfilter run`` as streams.

    Parameters
    ----------
    place : Place
        The file of lines.
    columns : mapping of str to tuple of str
        Names of the columns by sensor.

    Returns
    -------
    streams : dict of str to Stream
    start : Start or None
        The first start in the log.
    notes : list of str
        Bad and lost lines, and what had to be sorted.

    Raises
    ------
    MissionError
        When there is no such file.
    """
    if not place.path.is_file():
        raise MissionError(f"{place.shown}: no such file.")
    parser, counts = LineParser(notes=True), {"bad": 0, "lost": 0, "damaged": 0}
    starts: list[Any] = []

    def readings() -> Iterator[Reading]:
        for line in log_lines(place.path):
            item = parser.parse(line)
            if isinstance(item, Reading):
                yield item
            elif isinstance(item, BadLine):
                counts["bad" if b'"event"' in line[:9] else "damaged"] += item.lines
            elif isinstance(item, Note) and item.event == "start" and not starts:
                starts.append(item.fields.get("start"))
            elif isinstance(item, Note) and item.event == "lost":
                counts["lost"] += 1

    streams, notes = streams_of(readings(), columns)
    words = {
        "bad": "lines were no readings when they arrived",
        "lost": "times readings could not be written (disk full?)",
        "damaged": "lines of the log are damaged",
    }
    notes += [f"{Path(place.shown).name}: {counts[key]} {words[key]}" for key in words if counts[key]]
    start = None
    if starts:
        try:
            start = Start(**{"time_s": 0.0, **start_from(starts[0])})
        except (ValueError, TypeError) as error:
            reason = f": {error}" if place.quoted else "."
            raise MissionError(f"{place.shown}: the start in this log cannot be read{reason}") from None
    return streams, start, notes

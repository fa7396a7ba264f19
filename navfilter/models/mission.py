"""Mission and Stream: recorded readings, one time-stamped stream per sensor name."""

import dataclasses
import datetime
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from navfilter.foundation import arguments as given
from navfilter.foundation import utc
from navfilter.foundation.arguments import needs, numbers, rows_of, short
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.atomic_files import replacing_binary
from navfilter.foundation.display import Value, often, span
from navfilter.foundation.mapped_arrays import give_back
from navfilter.foundation.quoting import one_line
from navfilter.models.during import During

ArrayLike = ArrayLike

TRUTH_COLUMNS = (
    "latitude_rad", "longitude_rad", "height_m",
    "v_north_m_s", "v_east_m_s", "v_down_m_s",
    "roll_rad", "pitch_rad", "yaw_rad",
)  # fmt: skip
NPZ_FORMAT = 1
#: So many rows are looked at at a time.
PIECE = 1 << 16


class MissionError(ValueError):
    """A mission cannot be read: which file, what is wrong with it and what to do, in one line."""

    #: In one word that stays when sentences change, see `mistakes.md`.
    code = "mission"


@dataclass(frozen=True, eq=False, repr=False)
class Stream(Value):
    """Readings of one sensor.

    Parameters
    ----------
    time_s : array_like, shape (n,)
        Seconds on the mission clock, finite and non-decreasing.
    value : array_like, shape (n, k) or (n,)
        SI units and radians; NaN marks a missing component. A one-dimensional array becomes one column.
    columns : tuple of str
        Name of each column, with its unit, e.g. ``("heading_rad",)``.
    sd : array_like, shape (n, m) or (n,), optional
        White standard deviation of each single reading, in place of that of the sensor's error model: one for all axes
        of the sensor, or one for each, in the unit of its error. A row with a NaN says that none was given. A negative
        one makes the reading invalid, as it does in `navfilter.Navigator.correct`.

    Raises
    ------
    ValueError
        If shapes disagree, a time is not finite or goes backwards, or a value is infinite.

    Examples
    --------
    >>> depth = Stream([0.0, 1.0], [5.0, 5.1], ("depth_m",))
    >>> len(depth), depth.value.shape
    (2, (2, 1))
    """

    time_s: Array
    value: Array
    columns: tuple[str, ...] = ()
    sd: Array | None = None

    if TYPE_CHECKING:  # what is handed over becomes what the fields are

        def __init__(
            self, time_s: ArrayLike, value: ArrayLike, columns: Sequence[str] = (), sd: ArrayLike | None = None
        ) -> None: ...

    def __post_init__(self) -> None:
        time_s = np.ascontiguousarray(utc.seconds(self.time_s, "time_s"))
        value = numbers(self.value, "value")
        if time_s.ndim != 1:
            raise ValueError(f"time_s must be one-dimensional, found shape {time_s.shape}.")
        if not np.ndim(self.time_s):
            raise ValueError(f"time_s must be a sequence, found {short(self.time_s)}. Of one reading it is [time_s].")
        if value.ndim == 1 and value.shape == time_s.shape:
            value = value[:, np.newaxis]
        if value.ndim != 2 or value.shape[0] != time_s.size:
            raise ValueError(f"value must have one row per time ({time_s.size}), found shape {value.shape}.")
        named = self.columns if len(self.columns) else getattr(self.value, "columns", ())  # of a table of pandas
        columns = (named,) if isinstance(named, str) else tuple(name for name in named if isinstance(name, str))
        columns = columns or tuple(f"column_{k}" for k in range(value.shape[1]))
        if len(columns) != value.shape[1]:
            raise ValueError(f"{len(columns)} column names {columns} for {value.shape[1]} columns of values.")
        if not _sound(time_s, value):
            raise ValueError(_complaint(time_s, value))
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "value", np.ascontiguousarray(value))
        object.__setattr__(self, "columns", columns)
        if self.sd is not None:
            sd = np.ascontiguousarray(numbers(self.sd, "sd"))
            sd = sd[:, np.newaxis] if sd.ndim == 1 else sd
            if sd.ndim != 2 or len(sd) != time_s.size or not sd.shape[1]:
                raise ValueError(f"sd must have one row per time ({time_s.size}), found shape {sd.shape}.")
            object.__setattr__(self, "sd", sd)

    def __len__(self) -> int:
        return self.time_s.size

    @property
    def in_words(self) -> str:
        """How many readings, how often, of what."""
        own = ", each with its sd" if self.sd is not None else ""
        return f"{often(self.time_s, 'readings')}: {', '.join(self.columns)}{own}"

    def _shown(self) -> tuple[str, dict[str, object]]:
        return f"Stream{span(self.time_s)}, {self.in_words}", {}

    def keep(self, rows: Any) -> "Stream":
        """Same columns, only the given rows (a mask, a slice or increasing indices)."""
        rows = rows_of(rows)
        return Stream(self.time_s[rows], self.value[rows], self.columns, None if self.sd is None else self.sd[rows])

    def later(self, by_s: float) -> "Stream":
        """The same readings on a clock that stands `by_s` ahead [s]."""
        return dataclasses.replace(self, time_s=self.time_s + by_s)

    def column(self, name: str) -> Array:
        """Values of one column, shape (n,). Raises ValueError for an unknown name."""
        if name not in self.columns:
            raise ValueError(f'no column "{name}" in this stream (columns: {", ".join(self.columns)}).')
        return self.value[:, self.columns.index(name)]


def _sound(time_s: Array, value: Array) -> bool:
    """Whether times rise and are finite, and no value is infinite; a piece at a time, for a week is large."""
    sound = True
    for begin in range(0, time_s.size, PIECE):
        times = time_s[max(0, begin - 1) : begin + PIECE]
        sound &= bool(np.isfinite(times).all() and (np.diff(times) >= 0.0).all())
        sound &= not np.isinf(value[begin : begin + PIECE]).any()
        give_back(time_s, value)
    return sound


def _complaint(time_s: Array, value: Array) -> str:
    """What is wrong with times or values."""
    if not np.isfinite(time_s).all():
        return f"{np.count_nonzero(~np.isfinite(time_s))} times are not finite; drop those rows."
    if np.any(np.diff(time_s) < 0.0):
        row = int(np.argmax(np.diff(time_s) < 0.0)) + 1
        back = f"time goes back from {time_s[row - 1]:.6g} to {time_s[row]:.6g} s at row {row}; "
        return back + 'sort the rows first (np.argsort(time_s, kind="stable")).'
    return f"{np.count_nonzero(np.isinf(value))} values are infinite; use NaN for a missing value."


@dataclass(frozen=True, eq=False, repr=False)
class Mission(Value):
    """Everything recorded on one mission, ready to be replayed.

    Parameters
    ----------
    name : str
    streams : dict of str to Stream
        Keys are the sensor names of the vehicle; what drives is called ``"imu"``, or ``"attitude"`` and ``"velocity"``.
    truth : Stream or None
        Reference trajectory with the columns `TRUTH_COLUMNS`, NaN where unknown.
    start : navfilter.Start or None
        Where and how the mission begins, if the recording says so.
    date : datetime.date or None
        Day of the mission (for the magnetic declination).
    notes : tuple of str
        What the reader had to do: rows dropped, sorted, marked invalid, each with its count.
    windows : tuple of (float, float)
        Stretches of the mission clock that are worth evaluating; empty means all of it.
    epoch_utc_s : float or None
        UTC of mission time zero [s since 1970]: what gives tracks and their files dates. None: nobody knows.
    during : tuple of During
        Instructions for parts of it, see `navfilter.playback.instructions.instructed`.
    """

    name: str
    streams: dict[str, Stream] = field(default_factory=dict)
    truth: Stream | None = None
    # A Start lives in the vehicle layer, above this module; typing it here would turn the import arrow round.
    start: Any = None
    date: datetime.date | None = None
    notes: tuple[str, ...] = ()
    windows: tuple[tuple[float, float], ...] = ()
    epoch_utc_s: float | None = None
    during: tuple[During, ...] = ()

    def __post_init__(self) -> None:
        needs("Mission.name", self.name, str)
        needs("Mission.streams", self.streams, Mapping, hint='By name: {"depth": Stream(time_s, depth_m)}.')
        needs("Mission.truth", self.truth, Stream, type(None))
        if self.start is not None and not hasattr(self.start, "heading_sd_deg"):
            raise ValueError(f"Mission.start must be a navfilter.Start, found {short(self.start)}.")
        if self.truth is not None and self.truth.columns != TRUTH_COLUMNS:
            raise ValueError(f"truth must have the columns {TRUTH_COLUMNS}, found {self.truth.columns}.")
        for name, stream in self.streams.items():
            needs("the name of a stream", name, str)
            needs(f'stream "{name}"', stream, Stream, hint="nf.Stream(time_s, value, columns) is one.")
        put = object.__setattr__
        put(self, "name", one_line(self.name))  # often that of a file or folder, whatever its maker called it
        put(self, "streams", dict(self.streams))
        put(self, "notes", (self.notes,) if isinstance(self.notes, str) else tuple(self.notes))
        put(self, "windows", given.intervals(self.windows, "Mission.windows"))
        if self.date is not None:
            put(self, "date", utc.day(self.date, "Mission.date"))
        if self.epoch_utc_s is not None:
            put(self, "epoch_utc_s", utc.epoch(self.epoch_utc_s))

    @property
    def begin_s(self) -> float:
        """Time of the first reading of any stream [s]; NaN when there is none."""
        return min((s.time_s[0] for s in self.streams.values() if len(s)), default=float("nan"))

    @property
    def end_s(self) -> float:
        """Time of the last reading of any stream [s]; NaN when there is none."""
        return max((s.time_s[-1] for s in self.streams.values() if len(s)), default=float("nan"))

    @property
    def begin_utc(self) -> str | None:
        """Date of the first reading, ISO 8601; None where there is none, or UTC is unknown."""
        return None if np.isnan(self.begin_s) else utc.date_text(self.begin_s, self.epoch_utc_s)

    @property
    def duration_s(self) -> float:
        """From the first reading of any stream to the last [s]; 0 when there is none."""
        return 0.0 if np.isnan(self.begin_s) else float(self.end_s - self.begin_s)

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"date": self.date}
        if self.duration_s:
            rows["begins"] = self.begin_utc
            rows["mission time"] = f"{self.begin_s:.1f} to {self.end_s:.1f} s"
        for name, stream in self.streams.items():
            rows[name] = stream.in_words
        rows["truth"] = None if self.truth is None else f"{len(self.truth)} rows"
        rows["notes"] = "; ".join(self.notes) or None
        return f"Mission {self.name}", rows

    def stream(self, name: str) -> Stream:
        """One stream by its name. Raises ValueError naming the streams there are."""
        if name not in self.streams:
            raise ValueError(
                f'"{name}" has no stream in mission "{self.name}" (streams: {", ".join(self.streams) or "none"}). '
                f"Take one of these, or add [streams.{name}] to the mission.toml."
            )
        return self.streams[name]

    def between(self, t0_s: float, t1_s: float) -> "Mission":
        """The part of the mission with t0_s <= time <= t1_s; a start outside it is dropped."""
        ((t0_s, t1_s),) = given.intervals([(t0_s, t1_s)], "between")
        if not t0_s < t1_s:
            raise ValueError(f"between needs t0_s < t1_s, found {t0_s} and {t1_s}.")

        def cut(stream: Stream) -> Stream:
            first = np.searchsorted(stream.time_s, t0_s, side="left")
            last = np.searchsorted(stream.time_s, t1_s, side="right")
            return stream.keep(slice(first, last))

        start = self.start
        if start is not None and not t0_s <= start.time_s <= t1_s:
            start = None
        return dataclasses.replace(
            self,
            streams={name: cut(stream) for name, stream in self.streams.items()},
            truth=None if self.truth is None else cut(self.truth),
            start=start,
        )

    def hide(self, name: str, *intervals: tuple[float, float]) -> "Mission":
        """Without the readings of one stream inside the closed intervals (t0_s, t1_s)."""
        stream = self.stream(name)
        hidden = given.within(stream.time_s, given.intervals(intervals, "hide"))
        return self.with_stream(name, stream.keep(~hidden))

    def with_stream(self, name: str, stream: Stream) -> "Mission":
        """A copy in which one stream is added or replaced."""
        return dataclasses.replace(self, streams={**self.streams, name: stream})

    def without_stream(self, name: str) -> "Mission":
        """A copy without one stream."""
        self.stream(name)
        return dataclasses.replace(self, streams={k: v for k, v in self.streams.items() if k != name})

    def with_start(self, start: Any) -> "Mission":
        """A copy that begins as the given `navfilter.Start` says."""
        return dataclasses.replace(self, start=start)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the mission as one .npz file that `read_mission` reads back unchanged.

        Parameters
        ----------
        path : path-like
            Must end in ``.npz``. The file is written beside it first and then moved, so a reader never sees half of it.

        Returns
        -------
        Path
            The file written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise ValueError(f'a mission is saved as .npz, found "{path.name}".')
        meta: dict[str, Any] = {
            "format": NPZ_FORMAT,
            "name": self.name,
            "columns": {name: stream.columns for name, stream in self.streams.items()},
            "truth": self.truth is not None,
            "start": None if self.start is None else dataclasses.asdict(self.start),
            "date": None if self.date is None else self.date.isoformat(),
            "notes": self.notes,
            "windows": self.windows,
            "epoch_utc_s": self.epoch_utc_s,
            "during": [dataclasses.asdict(one) for one in self.during],
        }
        arrays: dict[str, Any] = {"navfilter_mission": np.array(json.dumps(meta, default=_plain))}
        for number, stream in enumerate(self.streams.values()):
            arrays[f"time_{number}"], arrays[f"value_{number}"] = stream.time_s, stream.value
            if stream.sd is not None:
                arrays[f"sd_{number}"] = stream.sd
        if self.truth is not None:
            arrays["time_truth"], arrays["value_truth"] = self.truth.time_s, self.truth.value
        with replacing_binary(path) as file:
            np.savez_compressed(file, **arrays)
        return path


def _plain(value: Any) -> Any:
    """What json cannot write by itself: NumPy numbers, arrays, mappings and dates."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, datetime.date):
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} cannot be written to a mission file")

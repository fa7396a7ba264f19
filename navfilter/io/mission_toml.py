"""mission.toml -> Mission: the mapping of somebody else's files onto streams.

When and where a mission begins: UTC of its stamps and its start, by its mission.toml, its stamps or its truth.
"""

import datetime
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arguments import within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.display import counted
from navfilter.io import geodesy
from navfilter.io.columns import QUATERNION, Counts, Times, clock_times, group_names, group_values
from navfilter.io.json_lines import read_log
from navfilter.io.logs import Shelf
from navfilter.io.logs.topic_names import INSTRUMENT
from navfilter.io.mission_schema import (
    SD,
    Clock,
    MissionSpec,
    Origin,
    Source,
    StartSpec,
    StreamSpec,
    TruthStream,
    driving,
    each_of,
    groups,
    mission_spec,
)
from navfilter.io.stamps import runs_of, shown, strays
from navfilter.io.stream_joining import block_mean, block_sd, mean, resampled
from navfilter.io.text_tables import Table, TableOptions, read_table
from navfilter.io.trust import UNPACKED_BYTES, Allowance, Place, expand
from navfilter.io.validation import read_toml, validate
from navfilter.models.during import During
from navfilter.models.mission import TRUTH_COLUMNS, Mission, MissionError, Stream
from navfilter.models.start import Start
from navfilter.models.state import euler_from_matrix, wrap


def start_of(spec: StartSpec, truth: Stream | None, date: datetime.date | None, path: Path) -> Start:
    """Build the `Start` that a mission.toml describes.

    Parameters
    ----------
    spec : StartSpec
    truth : Stream or None
        Used where the start comes from the truth: its first row with a position at or after ``time_s``.
    date : datetime.date or None
        Day of the mission, handed on to the start.
    path : Path
        The .toml, for messages.

    Returns
    -------
    Start
    """
    given = {k: v for k, v in spec.model_dump(exclude={"source"}).items() if v is not None}
    if spec.source == "truth" and truth is not None:
        given = {**_from_truth(truth, given.get("time_s"), path), **given}
    missing = [key for key in ("time_s", "latitude_deg", "longitude_deg") if key not in given]
    if missing:
        raise MissionError(f'{path}: start lacks {", ".join(missing)}; add them or write from = "truth".')
    try:
        return Start(**given, date=date)
    except ValueError as error:
        raise MissionError(f"{path}: {error}") from None


def _from_truth(truth: Stream, time_s: float | None, path: Path) -> dict[str, Any]:
    usable = np.isfinite(truth.value[:, :2]).all(axis=1)
    if time_s is not None:
        usable &= truth.time_s >= time_s - 1e-9
    rows = np.flatnonzero(usable)
    if not rows.size:
        raise MissionError(f"{path}: the truth has no position at or after the start; give the start in numbers.")
    row = rows[0]
    value = truth.value[row]
    found: dict[str, Any] = {
        "time_s": float(truth.time_s[row]),
        "latitude_deg": float(np.degrees(value[0])),
        "longitude_deg": float(np.degrees(value[1])),
    }
    if np.isfinite(value[2]):
        found["height_m"] = float(value[2])
    if np.isfinite(value[3:6]).all():
        found["velocity_n"] = tuple(float(v) for v in value[3:6])
    for name, angle in zip(("roll_deg", "pitch_deg", "heading_deg"), value[6:9], strict=True):
        if np.isfinite(angle):
            found[name] = float(np.degrees(angle))
    return found


#: 2071: stamps that read later count from 1900 or 1904.
_LATE_S = 3.2e9
_UNIX = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def epoch_of(
    spec: MissionSpec, streams: Iterable[Stream | None], instruments: Iterable[str] = ()
) -> tuple[float | None, list[str]]:
    """UTC at which the stamps of a mission read zero.

    Parameters
    ----------
    spec : MissionSpec
    streams : iterable of Stream
        With their stamps as the files have them.
    instruments : iterable of str
        Files whose times are of an instrument's own clock, where no other file gives a time.

    Returns
    -------
    epoch_utc_s : float or None
        Seconds since 1970; 0 where the stamps count from there. None: nobody knows.
    notes : list of str
        What is in doubt.
    """
    if isinstance(spec.epoch, datetime.datetime):
        return (spec.epoch - _UNIX).total_seconds(), []
    firsts = [float(stream.time_s[0]) for stream in streams if stream is not None and len(stream)]
    if spec.epoch == "unknown" or not firsts or not all(map(utc.counts_from_1970, firsts)):
        return None, []
    day = datetime.datetime.fromtimestamp(min(firsts), datetime.UTC).date()
    cure = 'UTC is unknown; give epoch = 1970-01-01T00:00:00Z, the clock\'s own, or "unknown"'
    if instruments := sorted(set(instruments)):
        return None, [f"the times are of the clock of an instrument ({', '.join(instruments)}), not of UTC: {cure}"]
    if min(firsts) > _LATE_S:
        return None, [f"the stamps read as seconds since 1970 begin on {day}: they count from elsewhere, and {cure}"]
    if spec.date is not None and abs((day - spec.date).days) > 1:
        doubt = f"the stamps read as seconds since 1970 begin on {day}, date says {spec.date}"
        return None, [f"{doubt}: {cure}"]
    return 0.0, []


def day_of(epoch_utc_s: float | None, streams: Iterable[Stream | None]) -> datetime.date | None:
    """Day on which stamps begin, by UTC; None where that is not known.

    Parameters
    ----------
    epoch_utc_s : float or None
        See `epoch_of`.
    streams : iterable of Stream
        With their stamps as the files have them.
    """
    firsts = [float(stream.time_s[0]) for stream in streams if stream is not None and len(stream)]
    if epoch_utc_s is None or not firsts or not utc.counts_from_1970(first_s := min(firsts) + epoch_utc_s):
        return None
    return datetime.datetime.fromtimestamp(first_s, datetime.UTC).date()


#: More than a month at 100 Hz.
_MOST_ROWS = 3e8
#: What a note says of a stream, behind its name, that the mission.toml says was not measured.
STANDS_IN = "stands in for what was not measured"
DAY_S = 86400.0
#: A message names so many runs.
MOST_RUNS = 4


class RunsError(MissionError):
    """The clock of a file begins anew: it holds several runs, and nobody said which is meant. That is wrong with the
    mission, and not with how the command was used.
    """

    code, exit_code = "runs", 1


def read_mission_toml(path: Path, *, confine: bool = False, unpacked_bytes: int = UNPACKED_BYTES) -> Mission:
    """Read a mission.toml and the files that it names.

    Parameters
    ----------
    path : Path
    confine : bool
        Refuse files outside the folder of the .toml, and variables of the environment.
    unpacked_bytes : int
        What its compressed files may unpack to, together.

    Raises
    ------
    MissionError
        In one line where one thing is wrong; several mistakes in the .toml are listed together.
    """
    spec = validate(mission_spec(), read_toml(path, MissionError), path, MissionError)
    reader = _Reader(path.parent, spec, confine, Allowance(unpacked_bytes))
    streams: dict[str, Stream] = {}
    logged_start = None
    if spec.log is not None:
        streams, logged_start, reader.notes = read_log(reader.place(spec.log.file), spec.log.columns)
    reader.align_days(spec)
    for name, stream_spec in spec.streams.items():
        streams[name] = reader.stream(name, stream_spec)
    truth = None if spec.truth is None else reader.truth(spec.truth)
    epoch_utc_s, doubts = epoch_of(spec, (*streams.values(), truth), reader.instruments())
    reader.notes += doubts
    date = spec.date or day_of(epoch_utc_s, (*streams.values(), truth))
    zero = _zero(spec.zero_s, streams, truth)
    if zero:
        streams = {name: stream.later(-zero) for name, stream in streams.items()}
        truth = None if truth is None else truth.later(-zero)
        if logged_start is not None:
            logged_start = replace(logged_start, time_s=logged_start.time_s - zero)
    for name, stream_spec in spec.streams.items():
        streams[name] = _windowed(streams[name], stream_spec)
    if truth is not None and spec.truth is not None:
        truth = _windowed(truth, spec.truth)
    return Mission(
        name=spec.name or path.resolve().parent.name,
        streams=streams,
        truth=truth,
        start=logged_start if spec.start is None else start_of(spec.start, truth, date, path),
        date=date,
        notes=tuple(reader.notes),
        windows=spec.windows,
        epoch_utc_s=None if epoch_utc_s is None else epoch_utc_s + zero,
        during=tuple(During(**one.model_dump()) for one in spec.during),
    )


def _zero(zero: float | str, streams: dict[str, Stream], truth: Stream | None) -> float:
    if not isinstance(zero, str):
        return float(zero)
    firsts = [s.time_s[0] for s in (*streams.values(), truth) if s is not None and len(s)]
    return float(min(firsts, default=0.0))


def _windowed(stream: Stream, spec: StreamSpec) -> Stream:
    keep = ~within(stream.time_s, spec.hide)
    if spec.windows:
        keep &= within(stream.time_s, spec.windows)
    return stream if keep.all() else stream.keep(keep)


class _Reader:
    """Reads sources relative to one folder, each file once, and collects notes."""

    def __init__(self, folder: Path, spec: MissionSpec, confine: bool, allowance: Allowance) -> None:
        self.folder, self._confine, self._allowance, self._date = folder, confine, allowance, spec.date
        self.notes: list[str] = []
        self._shelf = Shelf(_wanted_of_logs(spec, folder), allowance)
        self._tables: dict[tuple[Place, TableOptions], Table] = {}
        self._times: dict[int, Times] = {}

    def instruments(self) -> list[str]:
        """Files whose times are of an instrument's own clock; none where others give a time too."""
        by_instrument = [Path(t.path.split(" ")[0]).name for t in self._tables.values() if t.clock == INSTRUMENT]
        return by_instrument if len(by_instrument) == len(self._tables) else []

    def place(self, file: str) -> Place:
        """A file that the .toml names."""
        return Place.of_mission(file, self.folder, self._confine, self._allowance)

    def table(self, file: str, options: TableOptions) -> Table:
        place = self.place(file)
        if (place, options) not in self._tables:
            self._tables[place, options] = read_table(place, options, self._shelf)
            self.notes += self._tables[place, options].notes
        return self._tables[place, options]

    def stream(self, name: str, spec: StreamSpec) -> Stream:
        """One sensor's stream."""
        time_s, parts, columns = self._merged(name, spec)
        if spec.stands_in:
            self.notes.append(f"{name} {STANDS_IN}")
        sd = parts.pop(SD, None)
        given = list(parts)
        if "ecef" in given:
            parts["ecef"], columns["ecef"] = geodesy.geodetic_from_ecef(parts["ecef"]), groups()["position"].names
        if "local" in given:
            parts["local"], columns["local"] = _from_local(parts["local"], spec), groups()["position"].names
        if "quaternion" in given:
            parts["quaternion"], columns["quaternion"] = (
                _euler(parts["quaternion"], spec, None),
                groups()["attitude"].names,
            )
        return _assembled(time_s, parts, columns, sd)

    def truth(self, spec: TruthStream) -> Stream:
        """The reference trajectory with all of `TRUTH_COLUMNS`."""
        time_s, parts, _ = self._merged("truth", spec)
        value = np.full((time_s.size, len(TRUTH_COLUMNS)), np.nan)
        if "position" in parts:
            value[:, :3] = parts["position"]
        elif "ecef" in parts:
            value[:, :3] = geodesy.geodetic_from_ecef(parts["ecef"])
        elif "local" in parts:
            value[:, :3] = _from_local(parts["local"], spec)
        axes = geodesy.ned_axes(value[:, 0], value[:, 1])
        if "velocity_n" in parts:
            value[:, 3:6] = parts["velocity_n"]
        elif "velocity_ecef" in parts:
            value[:, 3:6] = np.einsum("nij,nj->ni", axes, parts["velocity_ecef"])
        if "attitude" in parts:
            value[:, 6:9] = parts["attitude"]
        elif "quaternion" in parts:
            value[:, 6:9] = _euler(parts["quaternion"], spec, axes)
        value[:, [1, 6, 8]] = wrap(value[:, [1, 6, 8]])
        if spec.lever_arm_b_m is not None:
            value = _without_lever_arm(time_s, value, np.array(spec.lever_arm_b_m))
        return Stream(time_s, value, TRUTH_COLUMNS)

    def _merged(self, name: str, spec: StreamSpec) -> tuple[Array, dict[str, Array], dict[str, tuple[str, ...]]]:
        """Time and groups of all sources on the clock of the first."""
        sources = [self._source(name, source) for source in spec.sources]
        time_s = sources[0][0]
        parts: dict[str, Array] = {}
        columns: dict[str, tuple[str, ...]] = {}
        for group in spec.groups():
            given = []
            for source, (own_time, own) in zip(spec.sources, sources, strict=True):
                if group in own:
                    columns.setdefault(group, group_names(group, source.groups()[group]))
                    circular = _on_circle(columns[group])
                    if own_time is not time_s:
                        rotation = group == QUATERNION
                        own[group] = resampled(time_s, own_time, own[group], circular, source.max_gap_s, rotation)
                    given.append(own[group])
            parts[group] = given[0] if len(given) == 1 else mean(given, circular, group == QUATERNION)
        if spec.resample_hz is not None:
            # Between slow readings of a turning vehicle, interpolated ones are nearer the truth than held ones.
            rows = (time_s[-1] - time_s[0]) * spec.resample_hz
            if rows > _MOST_ROWS:
                raise MissionError(
                    f"{name}: resample_hz would make {rows:.3g} rows; are the times in seconds, or is one of them far "
                    "off?"
                )
            even = np.arange(time_s[0], time_s[-1], 1.0 / spec.resample_hz)
            for group, part in parts.items():
                circular = _on_circle(columns[group])
                parts[group] = resampled(even, time_s, part, circular, None, group == QUATERNION)
            time_s = even
        if spec.average > 1:
            circles = {group: _on_circle(columns[group]) for group in parts}
            sd = {SD: block_sd(parts[SD], spec.average)} if SD in parts else {}
            parts = {
                group: block_mean(part, spec.average, circles[group], group == QUATERNION)
                for group, part in parts.items()
            } | sd
            time_s = block_mean(time_s[:, np.newaxis], spec.average, np.zeros(1, dtype=bool))[:, 0]
        if spec.every > 1:
            time_s, parts = time_s[:: spec.every], {group: part[:: spec.every] for group, part in parts.items()}
        return time_s, parts, columns

    def align_days(self, spec: MissionSpec) -> None:
        """Let times of day without a date begin on the day of the others that went on over midnight."""
        truth = [] if spec.truth is None else [spec.truth]
        sources = [source for stream in (*spec.streams.values(), *truth) for source in stream.sources]
        for source in sources:
            if source.time.unit == "iso8601" or source.topic:
                table = self.table(source.file, _layout(source))
                times = clock_times(source.time, table, self._clock_table, _rows(table, source), self._date)
                if times.of_day and np.isfinite(times.time_s).any():
                    self._times[id(source)] = times
        spans = {key: (np.nanmin(t.time_s), np.nanmax(t.time_s)) for key, t in self._times.items()}
        for key, (begin, end) in spans.items():
            apart = all(end < first or begin > last for other, (first, last) in spans.items() if other != key)
            goes_on = any(first < begin + DAY_S <= last for other, (first, last) in spans.items() if other != key)
            if apart and goes_on:
                self._times[key] = self._times[key]._replace(time_s=self._times[key].time_s + DAY_S)

    def _source(self, name: str, source: Source) -> tuple[Array, dict[str, Array]]:
        """Sorted times and groups of one source; every row dropped or mended on the way is noted."""
        table = self.table(source.file, _layout(source))
        groups = source.groups()
        counts = Counts()
        rows = _rows(table, source)
        times = self._times.pop(id(source), None)
        times = times or clock_times(source.time, table, self._clock_table, rows, self._date)
        time_s = times.time_s
        parts = {key: group_values(table, key, group, rows, counts) for key, group in groups.items()}
        where = f"{name} ({Path(table.path).name})"
        self.notes += [f"{where}: {note}" for note in times.notes]
        self._note(where, int(np.count_nonzero(~np.isfinite(time_s))), "rows without a readable time dropped")
        example = f", such as {counts.example}" if counts.example else ""
        self._note(where, counts.unreadable, f"cells without a number taken as missing{example}")
        self._note(where, counts.sentinel, "rows marked invalid by their value")
        self._note(where, counts.infinite, "infinite values taken as missing")
        self._note(where, counts.beyond, "angles far beyond a circle, always the same, taken as missing")
        self._note(where, counts.no_rotation, "quaternions of another length than the others taken as missing")
        if SD in parts:
            unknown = parts[SD] <= 0.0
            parts[SD][unknown] = np.nan
            what = "readings with an sd of 0 or less: it is unknown, that of vehicle.toml holds"
            self._note(where, int(np.count_nonzero(unknown.any(axis=1))), what)
        time_s = self._one_run(where, source, self._supported(where, time_s))
        keep = np.isfinite(time_s)
        if source.only_changes:
            keep &= self._changed(table, source, parts)
        if not keep.any():
            found = "; ".join(times.notes) or f"{rows} rows were there"
            raise MissionError(f"{where}: no row is left ({found}); check the time column, its unit and the sentinels.")
        time_s, parts = time_s[keep], {key: part[keep] for key, part in parts.items()}
        return self._ordered(where, time_s, parts)

    def _supported(self, where: str, time_s: Array) -> Array:
        """The stamps but for those that no neighbour supports."""
        stray = strays(time_s)
        if stray.any():
            row = int(np.argmax(stray))
            what = f"stamps that no neighbour supports left out, such as {shown(time_s[row])} in row {row + 1}"
            self._note(where, int(stray.sum()), what)
        return np.where(stray, np.nan, time_s) if stray.any() else time_s

    def _one_run(self, where: str, source: Source, time_s: Array) -> Array:
        """The stamps of the run asked for; the only one needs no asking."""
        runs = runs_of(time_s)
        count = len(runs.rows)
        if source.run is None and count < 2:
            return time_s
        if source.run is None or source.run > max(count, 1):
            which = ", ".join(
                f"rows {first + 1} to {last + 1} from {shown(begin)} to {shown(end)}"
                for (first, last), (begin, end) in zip(runs.rows[:MOST_RUNS], runs.spans_s, strict=False)
            )
            more = f" and {count - MOST_RUNS} more" if count > MOST_RUNS else ""
            if source.run is None:
                cure = "Its clock was set, it was started again, or its parts stand in another order (sort them). Take"
                cure += f" one of them: run = 1 to {count} beside file"
            else:
                cure = f"There is no run = {source.run}"
            raise RunsError(f"{where}: {count} runs behind one another: {which}{more}. {cure}.")
        first, last = runs.rows[source.run - 1]
        own = np.full(time_s.size, np.nan)
        own[first : last + 1] = time_s[first : last + 1]
        self._note(where, int(np.isfinite(time_s).sum() - np.isfinite(own).sum()), "rows of other runs left out")
        return own

    def _clock_table(self, clock: Clock) -> Table:
        assert clock.file is not None  # only called with one, for the type checker
        return self.table(clock.file, TableOptions(table=clock.table, transpose=clock.transpose))

    def _changed(self, table: Table, source: Source, parts: dict[str, Array]) -> Mask:
        """Rows in which a value differs from the row before; nobody knows how old the first row is, so it is none."""
        if source.only_changes is True:
            watched = np.column_stack([part for group, part in parts.items() if group != SD])
        else:
            watched = np.column_stack([table.numbers(reference)[0] for reference in source.only_changes or ()])
        before, after = watched[:-1], watched[1:]
        differs = ((before != after) & ~(np.isnan(before) & np.isnan(after))).any(axis=1)
        return np.concatenate([[False], differs])

    def _ordered(self, where: str, time_s: Array, parts: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
        step = np.diff(time_s)
        backward = step < 0.0
        if backward.any():
            what = f"steps back in time, by up to {-step.min():.3g} s; rows sorted by time"
            self._note(where, int(backward.sum()), what)
            order = np.argsort(time_s, kind="stable")
            time_s, parts = time_s[order], {key: part[order] for key, part in parts.items()}
        repeated = np.concatenate([[False], np.diff(time_s) == 0.0])
        if repeated.any() and driving() & set(parts):
            self._note(where, int(repeated.sum()), "rows with the time of the row before dropped")
            time_s, parts = time_s[~repeated], {key: part[~repeated] for key, part in parts.items()}
        else:
            self._note(where, int(repeated.sum()), "rows with the time of the row before")
        return time_s, parts

    def _note(self, where: str, count: int, what: str) -> None:
        if count:
            self.notes.append(f"{where}: {counted(count, what)}")


def _wanted_of_logs(spec: MissionSpec, folder: Path) -> dict[Path, dict[str, set[str]]]:
    """What all streams together want of each log: it may be large, and is gone through once."""
    wanted: dict[Path, dict[str, set[str]]] = {}
    for stream in (*spec.streams.values(), *([spec.truth] if spec.truth else [])):
        for source in stream.sources:
            if source.topic:
                columns = wanted.setdefault(expand(source.file, folder), {}).setdefault(source.topic, set())
                columns |= {str(reference) for reference in source.references()}
    return wanted


def _layout(source: Source) -> TableOptions:
    return TableOptions(**{key: getattr(source, key) for key in TableOptions.model_fields})


def _rows(table: Table, source: Source) -> int:
    """Rows of a source: those of the first column it names, or of its times where all else is constant."""
    for group in source.groups().values():
        for part in group.columns:
            for reference in each_of(part.column if part.column is not None else part.mean):
                return int(table.raw(reference).shape[0])
    if source.time.column is None or source.time.file is not None:
        raise MissionError(f"{table.path}: all columns are constant; name at least one column of the file.")
    return int(table.joined(source.time.column).shape[0])


def _on_circle(names: tuple[str, ...]) -> Mask:
    """Which columns are angles on a circle: interpolated unwrapped, handed out wrapped."""
    return np.isin(names, [name for columns in groups().values() for name in columns.circular])


def _assembled(time_s: Array, parts: dict[str, Array], columns: dict[str, tuple[str, ...]], sd: Array | None) -> Stream:
    names = tuple(name for group in parts for name in columns[group])
    value = np.column_stack(list(parts.values()))
    circular = _on_circle(names)
    value[:, circular] = wrap(value[:, circular])
    return Stream(time_s, value, names, sd)


def _from_local(ned: Array, spec: StreamSpec) -> Array:
    origins: list[Origin | None] = [s.groups()["local"].origin for s in spec.sources if "local" in s.groups()]
    origin = next(o for o in origins if o is not None)
    return geodesy.geodetic_from_local(
        ned, np.radians(origin.latitude_deg), np.radians(origin.longitude_deg), origin.height_m
    )


def _euler(quaternion: Array, spec: StreamSpec, axes: Array | None) -> Array:
    """Roll, pitch, yaw of a quaternion that rotates the body into its reference."""
    group = next(s.groups()["quaternion"] for s in spec.sources if "quaternion" in s.groups())
    wxyz = quaternion if group.order == "wxyz" else quaternion[:, [3, 0, 1, 2]]
    C = geodesy.matrix_from_quaternion(wxyz)
    if group.body == "flu":
        C = C * np.array([1.0, -1.0, -1.0])
    if group.reference == "enu":
        C = C[:, [1, 0, 2]] * np.array([[1.0], [1.0], [-1.0]])
    elif group.reference == "ecef":
        if axes is None:
            raise MissionError(
                'a quaternion with reference = "ecef" needs a position in the same stream (see [truth]).'
            )
        C = axes @ C
    return euler_from_matrix(C)


def _without_lever_arm(time_s: Array, value: Array, lever_b_m: Array) -> Array:
    """The truth moved from its own point to the vehicle's, which lies -lever_b_m away from it."""
    arm_n = geodesy.matrix_from_euler(value[:, 6], value[:, 7], value[:, 8]) @ lever_b_m
    if np.isnan(arm_n).all():
        raise MissionError("the lever arm of the truth needs the attitude of the truth; add it or drop lever_arm_b_m.")
    value = value.copy()
    axes = geodesy.ned_axes(value[:, 0], value[:, 1])
    ecef = geodesy.ecef_from_geodetic(value[:, :3]) - np.einsum("nji,nj->ni", axes, arm_n)
    value[:, :3] = geodesy.geodetic_from_ecef(ecef)
    if time_s.size > 1:
        value[:, 3:6] -= np.gradient(arm_n, time_s, axis=0)
    return value

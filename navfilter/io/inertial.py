"""The six axes of an inertial unit from whatever holds them: a mission, a log, or any table.

One column of a recording as an evenly sampled series: from any table that `read_table` opens, or a mission's
stream.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.display import counted
from navfilter.io import read_mission
from navfilter.io.axis_columns import SIZES, bare_name, found_axes
from navfilter.io.columns import series_times
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import Table, delimiter_of, fields_of, first_lines, read_table
from navfilter.io.trust import UNPACKED_BYTES, Allowance, Place
from navfilter.io.units import Unit, parse_quantity, unit
from navfilter.models.mission import MissionError, Stream

#: Steps of a clock that stamps bursts: the median lies below this share of the mean, and either fewer than this share
#: of the steps are multiples of it, as they are where samples are missing, or it lies so far below.
BURSTY, MULTIPLES, FAR_BELOW = 0.7, 0.8, 0.3
#: A rate that is given agrees with the stamps within this share: clocks are off by less.
OTHER_RATE = 0.1
#: Where samples are missing, so many steps are single ones all the same [1] (chosen).
SINGLE = 0.05
#: A step of so many mean ones is a gap also between bursts.
LONG_STEP = 60.0


@dataclass(frozen=True, eq=False)
class Series:
    """Samples at a constant rate, NaN where one is missing.

    Parameters
    ----------
    name : str
        Column, or ``stream.column`` of a mission.
    value : ndarray, shape (n,)
        In the unit of the file (missions: SI and radians).
    rate_hz : float
        Samples per second.
    source : str
        File or mission.
    begin_s : float
        Time of the first sample on the file's clock.
    notes : tuple of str
        What was mended while reading.
    """

    name: str
    value: Array
    rate_hz: float
    source: str = ""
    begin_s: float = 0.0
    notes: tuple[str, ...] = ()


def read_series(
    source: str | os.PathLike[str],
    column: str | None = None,
    *,
    rate_hz: float | None = None,
    time_column: str | None = None,
    time_unit: str = "s",
    options: TableOptions | None = None,
    unpacked_bytes: int = UNPACKED_BYTES,
) -> Series:
    """Read one series.

    Parameters
    ----------
    source : path-like
        A text table (.csv, .txt, .dat, also .gz, .xz, .bz2), .npz, .npy or .mat; or a mission with its stream,
        ``"dive_042:depth"`` or ``"dive_042:imu.rate_x"`` (the beginning of a column's name is enough).
    column : str, optional
        Name of the column, or its position counted from 0; ``"counts[0]"`` is column 0 of the array ``counts``. Not
        needed where there is only one. A header further down in a text file is found by this name.
    rate_hz : float, optional
        Sampling rate. Not needed with a time column or a mission.
    time_column : str, optional
        Column with the time: gives the rate, and tells where samples are missing.
    time_unit : str
        Its unit, where the file does not say it.
    options : TableOptions, optional
        Layout of the file.
    unpacked_bytes : int
        What it may unpack to.

    Returns
    -------
    Series

    Raises
    ------
    MissionError
        A ValueError of one line: what is wrong, and the columns there are.
    """
    text = os.fspath(source)
    path, _, stream = text.rpartition(":")
    if path and not Path(text).exists() and Path(path).exists():
        return _from_mission(path, stream, column, rate_hz, unpacked_bytes)
    if Path(text).is_dir() or Path(text).suffix == ".toml":
        streams = ", ".join(read_mission(text, unpacked_bytes=unpacked_bytes).streams)
        raise MissionError(f"{text} is a mission: say which stream, such as {text}:STREAM.COLUMN (streams: {streams}).")
    options, column, notes = _layout(Path(text), column, options or TableOptions())
    table = read_table(Place(Path(text), text, True, Allowance(unpacked_bytes)), options)
    name = _column(table, column, time_column)
    value, wrong = table.numbers(name)
    name = f"{options.table}[{name}]" if options.table else f"{options.topic} {name}" if options.topic else name
    notes += table.notes
    if wrong:
        notes.append(counted(wrong, f"cells of {name} without a number taken as missing"))
    if time_column is None:
        if rate_hz is None:
            raise MissionError(f"{text}: give the sampling rate with --rate-hz, or the time with --time-column.")
        return Series(name, value, float(rate_hz), text, 0.0, tuple(notes))
    time = series_times(table, table.name_of(time_column), time_unit)
    if time.shape != value.shape:
        raise MissionError(f'{text}: "{time_column}" has {time.size} values and "{name}" has {value.size}.')
    return on_a_grid(name, time, value, rate_hz, text, notes)


def _layout(path: Path, column: str | None, options: TableOptions) -> tuple[TableOptions, str | None, list[str]]:
    """Complete the layout from the column asked for: its array, or the line that holds its name."""
    if column is None or options.topic or options.table or options.skip_lines or options.header is not None:
        return options, column, []
    if path.suffix.lower() in _CONTAINERS:
        part = re.fullmatch(r"(.+)\[(\d+)\]", column)
        return (options.model_copy(update={"table": part[1]}), part[2], []) if part else (options, column, [])
    if column.isdecimal() or not path.is_file():
        return options, column, []
    for number, line in enumerate(first_lines(path)):
        if column in [name.strip() for name in fields_of(line.strip(), delimiter_of(line))]:
            notes = [f"the header was found on line {number + 1}"] if number else []
            return options.model_copy(update={"skip_lines": number}), column, notes
    return options, column, []


_CONTAINERS = (".npy", ".npz", ".mat")


def _column(table: Table, column: str | None, time_column: str | None) -> str:
    if column is not None:
        return table.name_of(column)
    others = [name for name in table.columns if time_column is None or name != table.name_of(time_column)]
    if len(others) != 1:
        raise MissionError(f"{table.path}: say which column with --column (columns: {', '.join(others)}).")
    return others[0]


def _from_mission(path: str, reference: str, column: str | None, rate_hz: float | None, unpacked_bytes: int) -> Series:
    mission = read_mission(path, unpacked_bytes=unpacked_bytes)
    name, _, wanted = reference.partition(".")
    stream = mission.stream(name)
    wanted = column or wanted
    found = [c for c in stream.columns if c == wanted] or [c for c in stream.columns if c.startswith(wanted)]
    if len(found) != 1:
        what = f'"{wanted}" names {len(found)} columns' if wanted else "it has several columns"
        raise MissionError(f"{path}: stream {name}: {what}; choose one of {', '.join(stream.columns)}.")
    return on_a_grid(f"{name}.{found[0]}", stream.time_s, stream.column(found[0]), rate_hz, path, [])


def on_a_grid(
    name: str, time_s: Array, value: Array, rate_hz: float | None, source: str = "", notes: list[str] | None = None
) -> Series:
    """Lay time-stamped samples on an even grid.

    Samples follow one another; only a step of more than one and a half periods is a gap, filled with as many NaN as
    fit. So a clock that jitters, or runs at 99.3 Hz instead of 100, costs nothing. Where samples were stamped when a
    buffer was emptied, only their number counts between longer gaps.

    Parameters
    ----------
    name : str
    time_s, value : ndarray, shape (n,)
        Rows without a finite time are dropped, and rows that repeat a time.
    rate_hz : float, optional
        Default: one over the median step.
    source : str
    notes : list of str, optional
        Notes so far.
    """
    notes = list(notes or [])
    known = np.isfinite(time_s)
    time, x = np.asarray(time_s, dtype=np.float64)[known], np.asarray(value, dtype=np.float64)[known]
    if time.size < 3:
        raise MissionError(f"{source}: {name} has {time.size} samples with a time, too few.")
    fresh = np.r_[True, np.diff(time) > 0.0]
    if np.any(np.diff(time) < 0.0):
        raise MissionError(
            f"{source}: the time of {name} goes back {counted(int(np.sum(np.diff(time) < 0)), 'times')}. Sort the rows."
        )
    if not fresh.all():
        notes.append(counted(int((~fresh).sum()), "rows with the time of the row before dropped"))
        time, x = time[fresh], x[fresh]
    step = np.diff(time)
    if (even := _even_step(step)) is not None:
        notes.append(f"the stamps come in bursts; samples are taken to be evenly spaced, {1.0 / even:.6g} Hz")
        step = np.where(step > LONG_STEP * even, step, even)
        rate_hz = 1.0 / even
    if rate_hz and not _agrees(step, rate_hz):
        usual = float(np.median(step))
        raise MissionError(
            f"{source}: the times of {name} are {usual:.4g} s apart ({1.0 / usual:.6g} Hz), not {1.0 / rate_hz:.4g} s"
            f" ({rate_hz:g} Hz). Leave the rate out, or check the unit of the times."
        )
    period = 1.0 / rate_hz if rate_hz else _single_step(step) or float(np.median(step))
    places = np.maximum(np.round(step / period - 0.001), 1.0)
    if places.sum() > 10 * time.size:
        raise MissionError(
            f"{source}: {name} would be {100 * (1 - time.size / places.sum()):.0f} % gaps at {1 / period:.6g} Hz."
            " Check the rate and the unit of the time column, or choose a part with --from-s and --to-s."
        )
    index = np.r_[0, np.cumsum(places).astype(np.int64)]
    grid = np.full(int(index[-1]) + 1, np.nan)
    grid[index] = x
    if grid.size > time.size:
        gaps = counted(int(np.sum(places > 1)), "gaps")
        notes.append(f"{counted(grid.size - time.size, 'samples')} missing in {gaps}")
    return Series(name, grid, 1.0 / period, source, float(time[0]), tuple(notes))


def _agrees(step: Array, rate_hz: float) -> bool:
    """Whether steps are of a rate, or of one of which samples are missing."""
    usual = _single_step(step) or float(np.median(step))
    return abs(usual * rate_hz - 1.0) < OTHER_RATE


def _even_step(step: Array) -> float | None:
    """Mean step of samples that were stamped in bursts; None where the stamps are those of the samples."""
    usual = step[step <= LONG_STEP * float(step.mean())]
    median, mean = float(np.median(usual)), float(usual.mean())
    bursts = median < BURSTY * mean and (_single_step(usual) is None or median < FAR_BELOW * mean)
    return mean if bursts else None


def _single_step(step: Array) -> float | None:
    """The step of which all others are multiples, as where samples are missing; None where they are not."""
    for shortest in np.quantile(step, (0.5, SINGLE)).tolist():
        single = float(np.median(step[step < 1.5 * shortest]))
        if np.mean(np.abs(step / single - np.round(step / single)) < 0.2) >= MULTIPLES:
            return single
    return None


_DIMENSIONS = {"gyro": "angular rate", "accel": "acceleration"}
_SIZE_TOLERANCE = 0.25
#: Samples that repeat others count from such a share on and from such a number; those that far apart are alike by
#: chance; a mark lies so many robust standard deviations away (all chosen).
_FEW, _SEVERAL, _APART, _FAR = 0.001, 5, 10, 20.0


@dataclass(frozen=True)
class ImuColumns:
    """Where the axes stand in a table, as far as it has to be said.

    Parameters
    ----------
    gyro, accel : tuple of str
        Names or positions of the columns x, y, z; empty: found by their names.
    gyro_unit, accel_unit : str
        Such as ``"deg/s"``, or with a factor for raw counts, ``"0.05 deg/s"``; empty: told by the file, or by gravity.
    time_column, time_unit : str
    rate_hz : float, optional
    """

    gyro: tuple[str, ...] = ()
    accel: tuple[str, ...] = ()
    gyro_unit: str = ""
    accel_unit: str = ""
    time_column: str = ""
    time_unit: str = "s"
    rate_hz: float | None = None


@dataclass(frozen=True, eq=False)
class ImuRecord:
    """Samples of an inertial unit at a constant rate, NaN where one is missing.

    Parameters
    ----------
    source : str
    rate_hz, begin_s : float
        Rate, and time of the first sample on the file's clock.
    names : tuple of str
        Axes that are there: ``gyro_x`` ... ``accel_z``.
    value : ndarray, shape (n, k)
        rad/s and m/s^2.
    notes : tuple of str
        What was found out, mended or left out while reading.
    """

    source: str
    rate_hz: float
    begin_s: float
    names: tuple[str, ...]
    value: Array
    notes: tuple[str, ...]

    def part(self, from_s: float | None, to_s: float | None) -> "ImuRecord":
        """The samples between two times of the file's clock.

        Raises
        ------
        MissionError
            Where there are none.
        """
        time = self.begin_s + np.arange(len(self.value)) / self.rate_hz
        low, high = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s
        half = 0.5 / self.rate_hz
        inside = np.flatnonzero((time >= low - half) & (time <= high + half))
        if inside.size == 0:
            raise MissionError(
                f"{self.source} has no samples from {low:g} to {high:g} s:"
                f" it lasts from {time[0]:.6g} to {time[-1]:.6g} s."
            )
        return replace(self, begin_s=float(time[inside[0]]), value=self.value[inside])


def read_imu(
    source: str | os.PathLike[str],
    columns: ImuColumns | None = None,
    options: TableOptions | None = None,
    unpacked_bytes: int = UNPACKED_BYTES,
) -> ImuRecord:
    """Read the axes of an inertial unit.

    Parameters
    ----------
    source : path-like
        A mission (its stream ``imu``, or ``"dive_042:other"``), a log with a topic of a known kind, or a table.
    columns : ImuColumns, optional
    options : TableOptions, optional
        Layout of a table; of a log the topic.
    unpacked_bytes : int
        What it may unpack to.

    Raises
    ------
    MissionError
        Where the axes or their units cannot be told; says what to give.
    """
    columns, options = columns or ImuColumns(), options or TableOptions()
    text = os.fspath(source)
    path, _, stream = text.rpartition(":")
    if path and not Path(text).exists() and Path(path).exists():
        return _of_mission(path, stream, unpacked_bytes)
    if _is_mission(Path(text)):
        return _of_mission(text, "imu", unpacked_bytes)
    if (
        not (columns.gyro or columns.accel)
        and (found := _of_log(Path(text), options.topic, unpacked_bytes)) is not None
    ):
        return found
    table = read_table(Place(Path(text), text, True, Allowance(unpacked_bytes)), options)
    return _of_table(table, columns)


# --- missions and logs ----------------------------------------------------------------------------------------------


def _is_mission(path: Path) -> bool:
    if path.suffix == ".toml" or (path / "mission.toml").exists():
        return True
    if path.suffix != ".npz" or not path.is_file():
        return False
    try:
        with np.load(path) as arrays:
            return "navfilter_mission" in arrays.files
    except (OSError, ValueError, EOFError):
        return False


def _of_mission(path: str, stream: str, unpacked_bytes: int) -> ImuRecord:
    mission = read_mission(path, unpacked_bytes=unpacked_bytes)
    return _of_stream(path, mission.stream(stream), mission.notes)


def _of_stream(source: str, stream: Stream, notes: Sequence[str]) -> ImuRecord:
    axes: dict[str, Array] = {}
    step = float(np.median(np.diff(stream.time_s))) if stream.time_s.size > 2 else np.nan
    for group, stems in (
        ("gyro", (("rate", 1.0), ("rotation", step))),
        ("accel", (("force", 1.0), ("velocity_gain", step))),
    ):
        for stem, divisor in stems:
            for name, values in zip(stream.columns, stream.value.T, strict=True):
                if match := re.match(rf"{stem}_([xyz])_", name):
                    axes[f"{group}_{match[1]}"] = values / divisor
    if not axes:
        raise MissionError(f"{source}: this stream is no inertial unit (columns: {', '.join(stream.columns)}).")
    return _on_a_grid(source, stream.time_s, axes, None, list(notes))


def _of_log(path: Path, topic: str, unpacked_bytes: int) -> ImuRecord | None:
    """The first inertial unit of a log; None where it is none, or where its columns have to be found like those of any
    table.
    """
    from navfilter.io.logs import format_of
    from navfilter.io.logs.draft import read_inertial
    from navfilter.io.logs.guessed_columns import uses_of
    from navfilter.io.logs.survey import survey

    if not (path.is_dir() or "*" in path.name or (path.is_file() and format_of(path))):
        return None
    found = survey(path, unpacked_bytes)
    units = [(t, use) for t, use in uses_of(found) if use.reading == "imu" and (not topic or topic in (t.name, t.kind))]
    if not units:
        if topic:
            return None
        names = ", ".join(t.name for t in found.topics)
        raise MissionError(
            f"{path}: no topic is known to be an inertial unit; say which with --topic (topics: {names})."
        )
    unit_topic, use = units[0]
    mission = read_inertial(found, unit_topic, use)
    others = [t.name for t, _ in units[1:] if t.name != unit_topic.name]
    notes = [
        f"{unit_topic.name} is taken",
        *([f"other inertial units: {', '.join(others)} (--topic)"] if others else []),
    ]
    return _of_stream(str(path), mission.streams["imu"], [*notes, *mission.notes])


# --- tables ---------------------------------------------------------------------------------------------------------


def _of_table(table: Table, columns: ImuColumns) -> ImuRecord:
    notes = list(table.notes)
    axes: dict[str, Array] = {}
    for group in ("gyro", "accel"):
        names = getattr(columns, group) or found_axes(table, group)
        if not names:
            continue
        if len(names) != 3:
            raise MissionError(
                f"{table.path}: --{group} takes three columns x,y,z, found {len(names)}: {','.join(names)}."
            )
        references = [table.name_of(name) for name in names]
        values = [table.numbers(name)[0] for name in references]
        factor = _factor(table, group, getattr(columns, f"{group}_unit"), references, values, notes)
        notes.append(f"{group}: {', '.join(references)}")
        axes |= {f"{group}_{axis}": factor * value for axis, value in zip("xyz", values, strict=True)}
    if not axes:
        raise MissionError(
            f"{table.path}: no columns look like gyros or accelerometers: say which with --gyro X,Y,Z and --accel X,Y,Z"
            f" (columns: {', '.join(table.columns)}); an array of several columns is named with --table."
        )
    clock = columns.time_column or ("log_time" if columns.rate_hz is None and "log_time" in table.columns else "")
    if clock:
        time = series_times(table, table.name_of(clock), columns.time_unit)
    elif columns.rate_hz is not None:
        time = np.arange(next(iter(axes.values())).size) / columns.rate_hz
    else:
        names = ", ".join(table.columns)
        raise MissionError(
            f"{table.path}: give the sampling rate with --rate-hz, or the time with --time-column ({names})."
        )
    return _on_a_grid(table.path, time, axes, columns.rate_hz, notes)


def _factor(
    table: Table, group: str, given: str, names: Sequence[str], values: Sequence[Array], notes: list[str]
) -> float:
    """From the file's unit to SI: as given, as the file says, as the names say, or by the size of gravity."""
    told = given or table.units.get(names[0], "") or bare_name(names[0])[1]
    if told:
        size, found = size_of(told)
        if found.dimension != _DIMENSIONS[group]:
            raise MissionError(f'{table.path}: "{told}" is no unit of an {_DIMENSIONS[group]} (--{group}-unit).')
        return size * found.factor
    if group == "accel":
        length = float(np.sqrt(sum(float(np.nanmedian(value)) ** 2 for value in values)))
        for name, gravity in SIZES:
            if abs(length / gravity - 1.0) < _SIZE_TOLERANCE:
                notes.append(f"accel is taken to be in {name}, because gravity reads {length:.4g}")
                return unit(name).factor
    example = "deg/s, or 0.05 deg/s for counts of that size" if group == "gyro" else "g, or 0.001 g for such counts"
    raise MissionError(f"{table.path}: say in which unit {', '.join(names)} are: --{group}-unit U ({example}).")


def size_of(text: str) -> tuple[float, Unit]:
    """A unit, or one with a factor: ``"deg/s"``, ``"0.05 deg/s"``.

    Raises
    ------
    ValueError
        For another text.
    """
    return parse_quantity(text) if re.match(r"[-+.\d]", text) else (1.0, unit(text))


def _on_a_grid(
    source: str, time_s: Array, axes: dict[str, Array], rate_hz: float | None, notes: list[str]
) -> ImuRecord:
    """All axes on one even grid."""
    for name, value in axes.items():
        if value.shape != time_s.shape:
            raise MissionError(f"{source}: {name} has {value.size} values, and there are {time_s.size} times.")
    value = np.column_stack(list(axes.values()))
    for what, bad in (("repeat the one before on all axes: held", _held(value)), _marked(value)):
        if bad.any():
            notes.append(f"{counted(int(bad.sum()), 'samples')} {what}, taken as missing")
            value[bad] = np.nan
    rows = on_a_grid("the inertial unit", time_s, np.arange(time_s.size, dtype=np.float64), rate_hz, source, notes)
    row = np.where(np.isnan(rows.value), 0.0, rows.value).astype(np.int64)
    value = np.where(np.isnan(rows.value)[:, np.newaxis], np.nan, value[row])
    value[~np.isfinite(value)] = np.nan
    return ImuRecord(source, rows.rate_hz, rows.begin_s, tuple(axes), np.ascontiguousarray(value), rows.notes)


def _held(value: Array) -> Mask:
    """Samples that are those before on all axes, where others farther apart are not alike: coarse ones are as often."""
    same = np.r_[False, (np.diff(value, axis=0) == 0.0).all(axis=1)]
    apart = (value[_APART:] == value[:-_APART]).all(axis=1)
    often = value.shape[1] > 1 and same.sum() >= _SEVERAL and same.mean() > _FEW
    is_held = often and (not apart.size or apart.mean() < 0.1 * same.mean())
    return same if is_held else np.zeros_like(same)


def _marked(value: Array) -> tuple[str, Mask]:
    """Samples that read the same on all axes again and again, where no others do, or far from the others."""
    known = np.isfinite(value).all(axis=1)
    none = np.zeros(len(value), dtype=bool)
    if value.shape[1] < 2 or not known.any():
        return "", none
    levels, counts = np.unique(value[known, 0], return_counts=True)
    first = value[known & (value[:, 0] == levels[np.argmax(counts)])]
    rows, often = np.unique(first, axis=0, return_counts=True)
    mark = rows[np.argmax(often)]
    bad = (value == mark).all(axis=1)
    others = value[known & ~bad]
    if bad.sum() < _SEVERAL or bad.mean() < _FEW or len(others) < _SEVERAL:
        return "", none
    middle = np.median(others, axis=0)
    spread = 1.4826 * np.median(np.abs(others - middle), axis=0)
    far = (np.abs(mark - middle) > _FAR * spread).any() and (spread > 0.0).any()
    fine = np.unique(others[:, 0]).size > 0.5 * len(others)
    return f"are {', '.join(f'{x:.6g}' for x in mark)}: a mark for none", bad if far or fine else none

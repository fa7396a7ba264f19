"""One column of a recording as an evenly sampled series: from any table that `read_table` opens, or a mission's
stream.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.display import counted
from navfilter.io import read_mission
from navfilter.io.columns import series_times
from navfilter.io.table import TableOptions
from navfilter.io.tables import Table, read_table
from navfilter.io.text_tables import delimiter_of, fields_of, marked_encoding
from navfilter.io.trust import BROKEN, OPENERS, UNPACKED_BYTES, Allowance, Place
from navfilter.models.mission import MissionError

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
#: Characters in which a header is looked for: a line need not end.
_BEGINNING = 1 << 20


def first_lines(path: Path, most: int = 40) -> list[str]:
    """The first lines of a text file, plain or compressed; none of a broken one, whose reader says what is wrong."""
    try:
        with OPENERS.get(path.suffix.lower(), open)(path, "rb") as file:
            data = file.read(_BEGINNING)
        return data.decode(marked_encoding(data) or "utf-8", errors="replace").splitlines(keepends=True)[:most]
    except BROKEN:
        return []


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

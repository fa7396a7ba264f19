"""From raw columns to SI: sentinels, units, scale, axes, mounting, clocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from navfilter.io.contents import SD, SERIES, groups
from navfilter.io.geodesy import matrix_from_euler
from navfilter.io.mission_schema import Clock, Component, Group, Reference
from navfilter.io.tables import Table
from navfilter.io.units import UNITS, parse_quantity, unit
from navfilter.models.mission import MissionError

Array = npt.NDArray[np.float64]
AXES = "xyz"
#: In SI; what is beyond is no measurement, and its square could not be held.
LARGEST = 1e100
#: Thirty million years [s]: later no clock stands, and mean times and their differences stay numbers.
LATEST_S = 1e15


@dataclasses.dataclass
class Counts:
    """What a source had to be relieved of; becomes the mission's notes."""

    unreadable: int = 0
    sentinel: int = 0
    infinite: int = 0


def group_values(table: Table, name: str, group: Group, rows: int, counts: Counts) -> Array:
    """Values of one group in SI, shape (rows, k), NaN where invalid; k as in `groups` (a missing height is NaN)."""
    values = np.empty((rows, len(group.columns)))
    measured = np.zeros(len(group.columns), dtype=bool)
    invalid = np.zeros(values.shape, dtype=bool)
    for k, part in enumerate(group.columns):
        if part.constant is not None:
            values[:, k] = part.constant
            continue
        measured[k] = True
        raw = _raw(table, part, rows, counts)
        invalid[:, k] = _is_sentinel(raw, group)
        values[:, k] = _si(raw, part, group, k, _stated_unit(table, name, part, k))
    counts.sentinel += int(np.count_nonzero(invalid.any(axis=1)))
    infinite = np.abs(values) > LARGEST
    counts.infinite += int(np.count_nonzero(infinite))
    values[invalid | infinite] = np.nan
    if group.valid_range is not None:
        low, high = group.valid_range
        outside = (values < low) | (values > high)
        counts.sentinel += int(np.count_nonzero(outside.any(axis=1)))
        values[outside] = np.nan
    known = groups()
    if group.invalid_together and not (name in known and known[name].independent):
        values[np.isnan(values[:, measured]).any(axis=1)] = np.nan
    return _oriented(values, name, group)


def _raw(table: Table, part: Component, rows: int, counts: Counts) -> Array:
    references: tuple[Reference, ...] = part.mean if part.mean is not None else (part.column,)  # type: ignore[assignment]
    total = np.zeros(rows)
    for reference in references:
        column, unreadable = table.numbers(reference)
        if column.size != rows:
            raise MissionError(f'{table.path}: column "{reference}" has {column.size} rows, its times have {rows}.')
        counts.unreadable += unreadable
        total += column
    return total / len(references)


def _is_sentinel(raw: Array, group: Group) -> npt.NDArray[np.bool_]:
    found = np.zeros(raw.shape, dtype=bool)
    for sentinel in group.invalid:
        # A sentinel printed with fewer digits than it was written with must still be recognised.
        found |= np.isclose(raw, sentinel, rtol=1e-9, atol=1e-12)
    if group.invalid_above is not None:
        found |= np.abs(raw) > group.invalid_above
    return found


def _stated_unit(table: Table, name: str, part: Component, k: int) -> str:
    """The unit that the file itself states for a column; empty where it states none, or none that is known here."""
    stated = table.units.get(str(part.column), "")
    if stated not in UNITS:
        return ""
    known = groups()
    if part.radius_m:
        wanted = "angular rate"
    else:
        wanted = known[name].dimensions[k] if name in known else UNITS[stated].dimension
    if UNITS[stated].dimension not in (wanted, "number"):
        found = f'column "{part.column}" is in {stated} by the file itself'
        raise MissionError(f"{table.path}: {found}, {name} needs {wanted}.")
    return stated


def _si(raw: Array, part: Component, group: Group, k: int, stated: str) -> Array:
    known = unit(part.unit or (group.unit if isinstance(group.unit, str) else group.unit[k]) or stated)
    offset = group.offset if part.offset is None else part.offset
    after = 0.0
    if isinstance(offset, str):
        number, offset_unit = parse_quantity(offset)
        offset, after = 0.0, offset_unit.factor * number
    if group.absolute if part.absolute is None else part.absolute:
        raw = np.abs(raw)
    scale = group.scale if part.scale is None else part.scale
    radius = part.radius_m or group.radius_m or 1.0
    return known.factor * (scale * raw + offset - known.zero) * radius + after


def _oriented(values: Array, name: str, group: Group) -> Array:
    if group.axes is not None:
        if values.shape[1] != 3:
            raise MissionError(f"{name}: axes = ... needs three columns, found {values.shape[1]}.")
        words = [word.strip() for word in group.axes.split(",")]
        signs = np.array([-1.0 if word.startswith("-") else 1.0 for word in words])
        values = values[:, [AXES.index(word[-1]) for word in words]] * signs
    if group.mounting_deg is not None:
        if values.shape[1] != 3:
            raise MissionError(f"{name}: mounting_deg needs three columns, found {values.shape[1]}.")
        roll, pitch, yaw = np.radians(np.array(group.mounting_deg)[:, np.newaxis])
        values = values @ matrix_from_euler(roll, pitch, yaw)[0].T
    width = values.shape[1] if name in (SERIES, SD) else len(groups()[name].names)
    if values.shape[1] < width:
        values = np.column_stack([values, np.full((values.shape[0], width - values.shape[1]), np.nan)])
    return values


def group_names(name: str, group: Group) -> tuple[str, ...]:
    """Names of the columns of a group in SI."""
    if name == SD:
        return (SD,) * len(group.columns)
    if name != SERIES:
        return groups()[name].names
    if group.names:
        return group.names
    return tuple(str(c.column) if c.column is not None else f"column_{k}" for k, c in enumerate(group.columns))


def clock_times(clock: Clock, table: Table, other: Callable[[Clock], Table], rows: int) -> Array:
    """Times of a source on the mission clock [s], NaN where a stamp cannot be read."""
    time_s = _clock_times(clock, table, other, rows)
    return np.where(np.abs(time_s) < LATEST_S, time_s, np.nan)


def _clock_times(clock: Clock, table: Table, other: Callable[[Clock], Table], rows: int) -> Array:
    if clock.rate_hz is not None:
        return clock.start_s + np.arange(rows) / clock.rate_hz + clock.offset_s
    source = table if clock.file is None else other(clock)
    assert clock.column is not None  # guaranteed by Clock, for the type checker only
    if clock.unit == "iso8601":
        raw = _iso_seconds(source.raw(clock.column))
    else:
        raw, _ = source.numbers(clock.column)
    if raw.size != rows:
        raise MissionError(f'{source.path}: {raw.size} times for {rows} rows in "{table.path}".')
    raw = np.where(np.isfinite(raw), raw, np.nan)
    if clock.rollover is not None:
        raw = raw + clock.rollover * _turns(raw, clock.rollover)
    factor = 1.0 if clock.unit == "iso8601" else unit(_time_unit(clock, source)).factor
    # Subtract before scaling: counters in microseconds since 1970 would lose digits.
    known = np.flatnonzero(np.isfinite(raw))
    if clock.from_first and known.size:
        raw = raw - raw[known[0]]
    time_s = raw * (factor * clock.scale)
    if clock.ends_only and known.size > 1:
        first, last = known[0], known[-1]
        step = (time_s[last] - time_s[first]) / (last - first)
        time_s = time_s[first] + step * (np.arange(rows) - first)
    return time_s + clock.offset_s


def _time_unit(clock: Clock, source: Table) -> str:
    """The unit of the times: as the mapping says, else as the file itself states it, else seconds."""
    stated = source.units.get(str(clock.column), "")
    known = stated in UNITS and UNITS[stated].dimension == "time"
    return stated if known and "unit" not in clock.model_fields_set else clock.unit


def _turns(raw: Array, rollover: float) -> Array:
    known = np.isfinite(raw)
    turns = np.zeros(raw.size)
    turns[known] = np.cumsum(np.diff(raw[known], prepend=raw[known][:1]) < -0.5 * rollover)
    return turns


def _iso_seconds(raw: npt.NDArray[np.generic]) -> Array:
    import pandas as pd

    stamps = pd.to_datetime(pd.Series(raw).astype(str), errors="coerce", utc=True, format="mixed")
    seconds = (stamps - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    return seconds.to_numpy(dtype=np.float64, na_value=np.nan)

"""From raw columns to SI: sentinels, units, scale, axes, mounting, clocks.

Dates and times of day as text -> seconds: one order of day and month for a whole file, and never today's date.
"""

import dataclasses
import datetime
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from navfilter.foundation.arrays import Array
from navfilter.io.geodesy import matrix_from_euler
from navfilter.io.mission_schema import SD, SERIES, Clock, Component, Group, Reference, groups
from navfilter.io.stamps import continued, full_after
from navfilter.io.stream_joining import circular_mean
from navfilter.io.table import BLANK, Table
from navfilter.io.units import UNITS, Unit, angles, parse_quantity, unit
from navfilter.models.mission import MissionError

Text = npt.NDArray[np.str_]

#: Orders of day, month and year.
ORDERS = ("dmy", "mdy", "ymd")
_DAY_S, _HALF_DAY_S = 86400.0, 43200.0
#: A clock of twelve hours that begins anew goes on within this [s].
_GOES_ON_S = 3600.0
_YEAR_FIRST = re.compile(r"\s*\d{4}[-/.]?\d")
_DATE = (
    r"(?:(?P<a>\d{1,4})(?P<sep>[-/. ])(?P<b>\d{1,2}|[A-Za-z]{3,9})(?P=sep)(?P<c>\d{1,4})|(?P<digits>\d{5,8})(?:\.0)?)"
)
_TAIL = r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[-+]\d{2}(?::?\d{2})?)?"
_TIME = r"(?:(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,]\d*)?))?|(?P<hms>\d{1,6}(?:\.\d*)?))"
_STAMP = rf"\s*(?:{_DATE}(?:[T, ]+{_TIME}{_TAIL})?)\s*"
_OF_DAY = rf"\s*(?P<h>\d{{1,2}}):(?P<m>\d{{2}}):(?P<s>\d{{2}}(?:[.,]\d*)?){_TAIL}\s*"
#: More dates than a log has, if it has nothing but dates.
_DAYS_OF_A_LOG = 31
_NOTHING = ("", "nan", "nat", "none")
_DIGITS = re.compile(r"\d+(?:\.\d*)?")
#: Date and time of day in one number.
_IN_ONE = r"^(\d{8})(\d{6}(?:\.\d*)?)$"
_NO_HOUR = re.compile(r"\s*\d{1,3}:\d{2}(?:[.,]\d+)?\s*")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


class Dated(NamedTuple):
    """Times of a column of texts.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Seconds since 1970, NaN where a cell cannot be read; without any date since midnight of the first row's day.
    of_day : bool
        Whether the texts have no date.
    note : str
        What is in doubt; empty: nothing.
    """

    time_s: Array
    of_day: bool
    note: str = ""


def date_seconds(cells: npt.NDArray[np.generic], order: str | None, date: datetime.date | None) -> Dated:
    """Read a column of dates, of times of day, or of both.

    Parameters
    ----------
    cells : ndarray, shape (n,)
    order : str or None
        One of `ORDERS`; None: the one that fits all rows.
    date : datetime.date or None
        Day of the mission. A time of day counts from its midnight; dates that have two readings begin there.

    Raises
    ------
    ValueError
        Where the order cannot be told, dates contradict each other, or a time has no hour; says what was found and
        what to do.
    """
    import pandas as pd

    texts = pd.Series(cells).astype(str).str.strip()
    if _DIGITS.fullmatch(next((text for text in texts if text.lower() not in _NOTHING), "")):
        texts = _without_digits_alone(texts)
    known = texts[~texts.str.lower().isin(_NOTHING)]
    if known.empty:
        return Dated(np.full(len(texts), np.nan), False)
    if order is None and _YEAR_FIRST.match(known.iloc[0]) and not known.iloc[0].isdecimal():
        stamps = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
        time_s = ((stamps - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)).to_numpy(float, na_value=np.nan)
        if np.isfinite(time_s).sum() == len(known):
            return Dated(time_s, False)
    parts = known.str.extract(f"^{_STAMP}$")
    dated = (parts["a"].notna() | parts["digits"].notna()).to_numpy()
    if dated.any():
        days, chosen = _days(parts[dated], order, date, known[dated])
        found = pd.Series(days, index=known.index[dated]).reindex(texts.index).to_numpy(float) * _DAY_S
        of_day = _of_day(parts).reindex(texts.index).to_numpy(float)
        twelve = _is_twelve(parts, of_day)
        time_s = _halves(found, of_day) if twelve else found + of_day
        words = "a clock of 12 hours without AM or PM, taken to begin as it reads" if twelve else ""
        return Dated(time_s - _zone(parts).reindex(texts.index).to_numpy(float), False, words or chosen)
    if (short := known.map(lambda text: _NO_HOUR.fullmatch(text) is not None)).mean() > 0.5:
        row, text = int(short.to_numpy().argmax()), known[short].iloc[0]
        raise ValueError(
            f'row {row + 1} of the times reads "{text}": minutes and seconds without hour and date, as spreadsheets '
            "show them. Export the column with its date, such as 2026-05-01 12:59:50.5."
        )
    parts = known.str.extract(f"^{_OF_DAY}$").assign(hms=np.nan)
    if parts["h"].isna().all():
        raise ValueError(
            f'"{known.iloc[0]}" is no date and no time of day that is known here. Write it as 2026-05-01T12:59:50.5Z, '
            "or with the zone as a number: 2026-05-01 14:59:50.5 +02:00."
        )
    of_day = _of_day(parts).reindex(texts.index).to_numpy(float)
    twelve = _is_twelve(parts, of_day)
    base = of_day % _HALF_DAY_S if twelve else of_day
    time_s = continued(base, _HALF_DAY_S if twelve else _DAY_S)
    if twelve:
        time_s += np.round((of_day - base)[np.isfinite(base)][0] / _HALF_DAY_S) * _HALF_DAY_S
    midnight = 0.0 if date is None else _DAY_S * (date.toordinal() - datetime.date(1970, 1, 1).toordinal())
    words = "a clock of 12 hours without AM or PM, taken to begin as it reads" if twelve else ""
    return Dated(time_s + midnight - _zone(parts).reindex(texts.index).to_numpy(float), True, words)


def _without_digits_alone(texts: Any) -> Any:
    """Date and time of day in one number, and times of day in one, with signs between."""
    import pandas as pd

    texts = texts.str.replace(_IN_ONE, r"\1 \2", regex=True)
    numbers = pd.to_numeric(texts, errors="coerce").to_numpy(float)
    if not is_clock_face(numbers) and not (_are_faces(numbers) and np.unique(numbers).size > _DAYS_OF_A_LOG):
        return texts
    face = texts.str.extract(r"^(\d+)(\.\d*)?$")
    digits = face[0].str.zfill(6)
    return (digits.str[:2] + ":" + digits.str[2:4] + ":" + digits.str[4:] + face[1].fillna("")).fillna("")


def is_clock_face(numbers: Array) -> bool:
    """Whether numbers are hours, minutes and seconds in one (hhmmss.s): they pass over what is no second, 60 to 99."""
    numbers = numbers[np.isfinite(numbers)]
    step = np.diff(numbers)
    if step.size < 2 or not _are_faces(numbers):
        return False
    over = np.floor(numbers[1:] / 100.0) - np.floor(numbers[:-1] / 100.0) == 1.0
    usual = float(np.median(step))
    passed = np.r_[step[over] - 40.0, step[step < 0.0] + 235960.0]  # a minute, and midnight
    return 0.0 < usual < 10.0 and bool((np.abs(passed - usual) < 3.0 * usual).any())


def _are_faces(numbers: Array) -> bool:
    """Whether all could be hours, minutes and seconds in one."""
    numbers = numbers[np.isfinite(numbers)]
    seconds, minutes = numbers % 100.0, np.floor(numbers / 100.0) % 100.0
    return bool(((numbers >= 0.0) & (numbers < 240000.0) & (seconds < 60.0) & (minutes < 60.0)).all())


def _days(parts: Any, order: str | None, date: datetime.date | None, texts: Any) -> tuple[Array, str]:
    """Days since 1970 of the rows, and a note."""
    import pandas as pd

    named = parts["b"].str.lower().str[:3].isin(_MONTHS)
    b = parts["b"].where(~named, parts["b"].str.lower().str[:3].map({m: str(k + 1) for k, m in enumerate(_MONTHS)}))
    digits = parts["digits"].str.zfill(6)
    eight = digits.str.len() == 8
    first = parts["a"].fillna(digits.str[:2].where(~eight, digits.str[:4]))
    second = b.fillna(digits.str[2:4].where(~eight, digits.str[4:6]))
    third = parts["c"].fillna(digits.str[4:6].where(~eight, digits.str[6:8]))
    numbers = np.column_stack([pd.to_numeric(one, errors="coerce").to_numpy(float) for one in (first, second, third)])
    lengths = first.str.len().to_numpy(float), third.str.len().to_numpy(float)
    if order is not None:
        return _day_numbers(numbers, order), ""
    if (lengths[0] == 4).all():
        return _day_numbers(numbers, "ymd"), ""
    if named.any():
        return _day_numbers(numbers, "dmy"), ""
    fitting = {one: _day_numbers(numbers, one) for one in (ORDERS[:2] if (lengths[1] == 4).all() else ORDERS)}
    fitting = {one: days for one, days in fitting.items() if np.isfinite(days).all()}
    if not fitting:
        raise ValueError(
            f'dates such as "{texts.iloc[0]}" and "{texts.iloc[-1]}" have no one order of day and month. Say it in '
            f"time: order = one of {', '.join(ORDERS)}; rows that it does not fit count as unreadable."
        )
    if len(fitting) > 1 and (parts["sep"] == ".").all():
        return fitting["dmy"], ""
    if len(fitting) > 1 and date is not None:
        day = date.toordinal() - datetime.date(1970, 1, 1).toordinal()
        fitting = {one: days for one, days in fitting.items() if abs(days[0] - day) <= 1.0} or fitting
    if len(fitting) > 1:
        raise ValueError(
            f'"{texts.iloc[0]}" has several readings. Say in time which: order = one of '
            f"{', '.join(fitting)} (d day, m month, y year)."
        )
    return next(iter(fitting.values())), ""


def _day_numbers(numbers: Array, order: str) -> Array:
    """Days since 1970 of numbers in this order; NaN where there is no such day."""
    day, month, year = (numbers[:, order.index(letter)] for letter in "dmy")
    year = np.where(year < 70.0, year + 2000.0, np.where(year < 100.0, year + 1900.0, year))
    good = (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & (year >= 1900) & (year < 2200)
    months = (np.where(good, year, 1970.0) - 1970.0) * 12.0 + np.where(good, month, 1.0) - 1.0
    begin = months.astype("int64").astype("datetime64[M]")
    days = begin.astype("datetime64[D]").astype("int64") + np.where(good, day, 1.0) - 1.0
    length = ((begin + 1).astype("datetime64[D]") - begin.astype("datetime64[D]")).astype("int64")
    return np.where(good & (day <= length), days, np.nan)


def _of_day(parts: Any) -> Any:
    """Seconds since midnight of the rows; 0 where there is a date alone."""
    import pandas as pd

    digits = parts["hms"].astype("string")
    whole = digits.str.split(".").str[0].str.zfill(6)
    rest = digits.str.extract(r"(\.\d*)$")[0].fillna("")
    h, m, s = (
        pd.to_numeric(parts[key].str.replace(",", ".") if key == "s" else parts[key], errors="coerce")
        .astype("float64")
        .fillna(pd.to_numeric(compact, errors="coerce").astype("float64"))
        .fillna(0.0)
        for key, compact in (("h", whole.str[:2]), ("m", whole.str[2:4]), ("s", whole.str[4:6] + rest))
    )
    half = parts["half"].str.lower().str[:1]
    h = h.where(half.isna(), h % 12.0 + 12.0 * (half == "p"))
    good = (h <= 24.0) & (m < 60.0) & (s < 61.0) & parts.notna().any(axis=1)
    return (3600.0 * h + 60.0 * m + s).where(good)


def _zone(parts: Any) -> Any:
    """Seconds by which the clock of the rows is ahead of UTC."""
    import pandas as pd

    found = parts["zone"].str.extract(r"([-+])(\d{2}):?(\d{2})?")
    size = 3600.0 * pd.to_numeric(found[1]).fillna(0.0) + 60.0 * pd.to_numeric(found[2]).fillna(0.0)
    return size.where(found[0] != "-", -size)


def _is_twelve(parts: Any, of_day: Array) -> bool:
    """Whether the clock has twelve hours: none is 0 or beyond 12, and it goes on where it seems to go back by 12."""
    import pandas as pd

    if parts["half"].notna().any() or parts["h"].isna().any():
        return False
    hours = pd.to_numeric(parts["h"])
    step = np.diff(of_day[np.isfinite(of_day)])
    goes_on = (step >= -_HALF_DAY_S) & (step <= _GOES_ON_S - _HALF_DAY_S)
    return bool(hours.between(1, 12).all() and goes_on.any())


def _halves(midnight: Array, of_day: Array) -> Array:
    """Stamps of a clock of twelve hours with dates: the half days in which it goes on and agrees with the dates."""
    base = of_day % _HALF_DAY_S
    time_s = continued(base, _HALF_DAY_S)
    known = np.isfinite(time_s) & np.isfinite(midnight)
    time_s = time_s + midnight[known][0]
    begins = _HALF_DAY_S * np.round((of_day - base)[known][0] / _HALF_DAY_S)
    for half in (begins, _HALF_DAY_S - begins):
        if (np.floor((time_s[known] + half) / _DAY_S) * _DAY_S == midnight[known]).all():
            return time_s + half
    raise ValueError("a clock of 12 hours without AM or PM does not go on with its dates. Export it with 24 hours.")


AXES = "xyz"
#: In SI; what is beyond is no measurement, and its square could not be held.
LARGEST = 1e100
QUATERNION = "quaternion"
#: A whole circle and what rounding makes of it [rad]; so many numbers beyond it are marks, of more an angle goes on.
CIRCLE_RAD, MOST_MARKS = 2.0 * np.pi * (361.0 / 360.0), 3
#: A quaternion longer or shorter than most of its column by this share is no rotation but a mark for none [1] (chosen).
OTHER_NORM = 0.1
#: Who counts days from elsewhere, from where, and how many days that is before 1970.
_DAYS = (
    ("the modified Julian date does", "1858-11-17", 40587.0),
    ("spreadsheets", "1899-12-30", 25569.0),
    ("MATLAB's datenum does", "year 0", 719529.0),
    ("the Julian date does", "4713 BC", 2440587.5),
)
#: Days of 1970-01-01 as `datetime.date.toordinal` counts, and of 2001 and 2100 since then.
_DAY_1970, _DAY_2001, _DAY_2100 = 719163, 11323.0, 47482.0
#: Thirty million years [s]: later no clock stands, and mean times and their differences stay numbers.
LATEST_S = 1e15
#: Stamps that are looked at for their unit.
_LOOKED_AT = 20_000


@dataclasses.dataclass
class Counts:
    """What a source had to be relieved of; becomes the mission's notes."""

    unreadable: int = 0
    example: str = ""
    sentinel: int = 0
    infinite: int = 0
    no_rotation: int = 0
    beyond: int = 0


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
        stated = _stated_unit(table, name, part, k)
        references = (part.column,) if part.mean is None else part.mean
        raws = [_raw(table, one, group, k, part, rows, counts) for one in references]
        if name == "position" and k < 2 and isinstance(part.column, str):
            _refuse_lost_letter(table, part.column, raws[0], "SW"[k])
        invalid[:, k] = np.logical_or.reduce([_is_sentinel(raw, group) for raw in raws])
        if name in groups() and groups()[name].names[k] in groups()[name].circular:
            beyond = np.logical_or.reduce([_beyond_circle(_si(raw, part, group, k, stated)) for raw in raws])
            counts.beyond += int(np.count_nonzero(beyond))
            invalid[:, k] |= beyond
        if len(raws) > 1 and _unit_of(part, group, k, stated).dimension == "angle":
            values[:, k] = circular_mean(np.stack([_si(raw, part, group, k, stated) for raw in raws]))
        else:
            values[:, k] = _si(sum(raws, np.zeros(rows)) / len(raws), part, group, k, stated)
    counts.sentinel += int(np.count_nonzero(invalid.any(axis=1)))
    infinite = np.abs(values) > LARGEST
    counts.infinite += int(np.count_nonzero(infinite))
    values[invalid | infinite] = np.nan
    if group.valid_range is not None:
        low, high = group.valid_range
        outside = (values < low) | (values > high)
        counts.sentinel += int(np.count_nonzero(outside.any(axis=1)))
        values[outside] = np.nan
    if name == QUATERNION:
        norm = np.linalg.norm(values, axis=1)
        usual = float(np.median(norm[np.isfinite(norm)])) if np.isfinite(norm).any() else np.nan
        bad = np.abs(norm - usual) > OTHER_NORM * usual
        counts.no_rotation += int(np.count_nonzero(bad))
        values[bad] = np.nan
    known = groups()
    if group.invalid_together and not (name in known and known[name].independent):
        values[np.isnan(values[:, measured]).any(axis=1)] = np.nan
    return _oriented(values, name, group)


def _beyond_circle(angle: Array) -> npt.NDArray[np.bool_]:
    """Angles beyond a whole circle that are marks for no reading: of few numbers, where most lie within the circle."""
    beyond: npt.NDArray[np.bool_] = np.abs(angle) > CIRCLE_RAD
    if not beyond.any() or 2 * np.count_nonzero(beyond) > beyond.size or np.unique(angle[beyond]).size > MOST_MARKS:
        return np.zeros_like(beyond)
    return beyond


def _refuse_lost_letter(table: Table, column: str, values: Array, letter: str) -> None:
    """Raise MissionError where the column behind says south or west of numbers that are positive."""
    behind = list(table.columns)[list(table.columns).index(column) + 1 :][:1]
    for name in (one for one in behind if table.columns[one].dtype.kind in "OUT"):
        there = np.array([str(cell).strip().upper() == letter for cell in table.columns[name].tolist()])
        if there.size == values.size and (values[there] > 0.0).any():
            shown = (column, name) if table.quoted else ("..", "..")
            raise MissionError(
                f'{table.path}: "{shown[0]}" is positive where "{shown[1]}" behind it reads {letter}: the half of the '
                f'Earth is lost. Write {{column = ["{shown[0]}", "{shown[1]}"]}} in its place.'
            )


def _raw(
    table: Table,
    reference: Reference | tuple[Reference, ...] | None,
    group: Group,
    k: int,
    part: Component,
    rows: int,
    counts: Counts,
) -> Array:
    """One column as numbers, in its own unit but for those of `angles`."""
    assert reference is not None  # a component has one of column, constant and mean
    given = part.unit or (group.unit if isinstance(group.unit, str) else group.unit[k])
    if isinstance(reference, tuple) or (given and _is_angle_text(table.raw(reference), given)):
        cells = table.joined(reference)
        column = angles(cells, given)
        known = ~np.isin([str(cell).strip().lower() for cell in cells.tolist()], BLANK)
        unreadable = int(np.count_nonzero(known & np.isnan(column)))
        if unreadable and not counts.example:
            counts.example = f'"{cells[known & np.isnan(column)][0]}"' if table.quoted else ""
    else:
        column, unreadable = table.numbers(reference)
        if unreadable and not counts.example:
            counts.example = table.first_strange(reference)
    if column.size != rows:
        raise MissionError(f'{table.path}: column "{reference}" has {column.size} rows, its times have {rows}.')
    counts.unreadable += unreadable
    return column


def _is_angle_text(raw: npt.NDArray[np.generic], name: str) -> bool:
    """Whether a column of angles needs more than its numbers: letters, or degrees and minutes in one."""
    return unit(name).dimension == "angle" and (raw.dtype.kind in "OUT" or unit(name) is UNITS["ddmm"])


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


def _unit_of(part: Component, group: Group, k: int, stated: str) -> Unit:
    return unit(part.unit or (group.unit if isinstance(group.unit, str) else group.unit[k]) or stated)


def _si(raw: Array, part: Component, group: Group, k: int, stated: str) -> Array:
    known = _unit_of(part, group, k, stated)
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


class Times(NamedTuple):
    """Times of the rows of a source.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        On the mission clock, NaN where a stamp cannot be read.
    of_day : bool
        They count from a midnight that the file does not name.
    notes : tuple of str
        What is in doubt, and how it was taken.
    """

    time_s: Array
    of_day: bool = False
    notes: tuple[str, ...] = ()


def clock_times(
    clock: Clock, table: Table, other: Callable[[Clock], Table], rows: int, date: datetime.date | None = None
) -> Times:
    """Times of a source on the mission clock.

    Parameters
    ----------
    clock : Clock
    table : Table
        Of the source.
    other : callable
        Gives the table of a clock that stands in a file of its own.
    rows : int
        Of the source.
    date : datetime.date, optional
        Day of the mission.

    Raises
    ------
    MissionError
        Where there are not as many times as rows, or dates cannot be told.
    """
    with np.errstate(over="ignore"):  # a file may have any numbers for times
        times = _clock_times(clock, table, other, rows, date)
    return times._replace(time_s=np.where(np.abs(times.time_s) < LATEST_S, times.time_s, np.nan))


def _clock_times(
    clock: Clock, table: Table, other: Callable[[Clock], Table], rows: int, date: datetime.date | None
) -> Times:
    if clock.rate_hz is not None:
        return Times(clock.start_s + np.arange(rows) / clock.rate_hz + clock.offset_s)
    source = table if clock.file is None else other(clock)
    assert clock.column is not None  # guaranteed by Clock, for the type checker only
    of_day, notes = source.clock == "of day", list[str]()
    if clock.unit == "iso8601":
        try:
            raw, of_day, note = date_seconds(source.joined(clock.column), clock.order, date)
        except ValueError as error:
            raise MissionError(f"{source.path}: {error if source.quoted else 'its dates cannot be told.'}") from None
        notes += [note] if note else []
    else:
        assert not isinstance(clock.column, tuple)  # guaranteed by Clock too
        raw, unreadable = source.numbers(clock.column)
        notes += [f"stamps that are no numbers: {source.first_strange(clock.column)}"] if unreadable else []
    if raw.size != rows:
        raise MissionError(f'{source.path}: {raw.size} times for {rows} rows in "{table.path}".')
    raw = np.where(np.isfinite(raw), raw, np.nan)
    period = clock.rollover
    if period is None and clock.unit != "iso8601" and (period := full_after(raw)) is not None:
        notes.append(f"stamps begin anew after {period:.10g}, as a counter or a time of day does: continued")
    if period is not None:
        raw = continued(raw, period)
    known = np.flatnonzero(np.isfinite(raw))
    stated = _time_unit(clock, source)
    if stated == "s" and clock.scale == 1.0 and known.size and (better := unit_of_times(raw)) not in ("s", ""):
        raise MissionError(
            f"{source.path}: its times, from {_shown(raw[known[0]], source)} on, are no seconds. By their size and "
            f'their steps they are in another unit: time = {{unit = "{better}"}}.'
        )
    if stated == "day" and known.size and clock.scale == 1.0:
        raw, note = since_1970(raw)
        notes += [note] if note else []
    factor = 1.0 if clock.unit == "iso8601" else unit(stated).factor
    # Subtract before scaling: counters in microseconds since 1970 would lose digits.
    if clock.from_first and known.size:
        raw = raw - raw[known[0]]
    time_s = raw * (factor * clock.scale)
    if clock.ends_only and known.size > 1:
        first, last = known[0], known[-1]
        step = (time_s[last] - time_s[first]) / (last - first)
        time_s = time_s[first] + step * (np.arange(rows) - first)
    if of_day and date is not None and clock.unit != "iso8601":
        time_s = time_s + 86400.0 * (date.toordinal() - _DAY_1970)
    return Times(time_s + clock.offset_s, of_day, tuple(notes))


def _time_unit(clock: Clock, source: Table) -> str:
    """The unit of the times: as the mapping says, else as the file itself states it, else seconds."""
    stated = source.units.get(str(clock.column), "")
    known = stated in UNITS and UNITS[stated].dimension == "time"
    return stated if known and "unit" not in clock.model_fields_set else clock.unit


def series_times(table: Table, reference: str, stated: str) -> Array:
    """Times of a column [s]: numbers in the unit that the file states, else in `stated`; dates and hhmmss as written.

    Raises
    ------
    MissionError
        Where numbers are in another unit by their size, and where dates cannot be told.
    """
    raw, _ = table.numbers(reference)
    name = table.units.get(reference, stated)
    known = np.isfinite(raw)
    better = unit_of_times(raw) if name == "s" and known.any() else ""
    if better == "iso8601" or not known.any():
        try:
            return date_seconds(table.raw(reference), None, None).time_s
        except ValueError as error:
            raise MissionError(f"{table.path}: {error}") from None
    if better not in ("s", ""):
        first = f"{raw[known][0]:.15g}"
        raise MissionError(
            f"{table.path}: its times, from {first} on, are no seconds. By their size they are: --time-unit {better}."
        )
    return raw * unit(name).factor


def _shown(stamp: float, source: Table) -> str:
    return f"{stamp:.15g}" if source.quoted else "the first"


def unit_of_times(stamps: Array) -> str:
    """The unit of stamps that count from a known day, or are hours, minutes and seconds in one; else empty."""
    stamps = stamps[:_LOOKED_AT]
    size = float(np.nanmedian(np.abs(stamps)))
    for name, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 1e9 * factor <= size < 4.1e9 * factor:
            return name
    if is_clock_face(stamps):
        return "iso8601"
    steps = np.diff(stamps[np.isfinite(stamps)])
    # a second is 1e-5 days; nothing here has 5000 readings per second
    few = steps.size > 0 and 0.0 < float(np.median(steps)) < 2e-4
    return "day" if few and since_1970(stamps)[1] else ""


def since_1970(days: Array) -> tuple[Array, str]:
    """Days since 1970 of such as spreadsheets and MATLAB count, where they lie in this century by that; with a note."""
    middle = float(np.nanmedian(days))
    for who, day, zero in _DAYS:
        # days that count from 1970 are fewer: 2071 is beyond every log
        if max(_DAY_2001 + zero, _DAY_2001 * 3.0) < middle < _DAY_2100 + zero:
            return days - zero, f"days as {who} count them, from {day} on"
    return days, ""

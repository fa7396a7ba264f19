"""Dates and times of day as text -> seconds: one order of day and month for a whole file, and never today's date."""

import datetime
import re
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from navfilter.foundation.arrays import Array
from navfilter.io.stamps import continued

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


def seconds(cells: npt.NDArray[np.generic], order: str | None, date: datetime.date | None) -> Dated:
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

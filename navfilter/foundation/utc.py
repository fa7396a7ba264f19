"""UTC beside the mission clock: dates of mission times, and when stamps count from 1970.

Seconds are those of POSIX: every day has 86400 of them, a leap second repeats one.
"""

import contextlib
import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array

_NS = 1_000_000_000
#: Stamps from September 2001 to the end of 2099 count from 1970 [s]; no other clock of a vehicle stands there but
#: that of GPS, and a mission says when it is that one.
_FROM_S, _TO_S = 1e9, 4102444800.0
#: What 64 bits of nanoseconds hold [s].
_MOST_S = 9.2e9
#: Half of the last digit that is written [ns].
_HALF = {"s": _NS // 2, "ms": 500_000, "us": 500}


def day(value: object, owner: str) -> datetime.date:
    """A date as users have it: of datetime (an aware one in UTC), NumPy or pandas, or ISO 8601.

    Raises
    ------
    ValueError
        For anything else; it names the `owner`.

    Examples
    --------
    >>> day("2026-05-04", "date"), day(np.datetime64("2026-05-04T12:00:00", "ns"), "date")
    (datetime.date(2026, 5, 4), datetime.date(2026, 5, 4))
    """
    if isinstance(value, np.datetime64) and not np.isnat(value):
        value = value.astype("datetime64[D]").item()
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            value = datetime.date.fromisoformat(value)
    if isinstance(value, datetime.datetime):
        value = (value if value.tzinfo is None else value.astimezone(datetime.UTC)).date()
    if not isinstance(value, datetime.date):
        raise ValueError(f"{owner} must be a day such as datetime.date(2026, 5, 4), found {value!r}.")
    return value


def epoch(value: object) -> float:
    """UTC of mission time zero, as seconds since 1970, or as a date (one without a zone is UTC).

    Raises
    ------
    ValueError
        For anything else.

    Examples
    --------
    >>> epoch(np.datetime64("2026-05-28T20:26:40")), epoch(datetime.datetime(2026, 5, 28, 20, 26, 40))
    (1780000000.0, 1780000000.0)
    """
    if isinstance(value, datetime.datetime):
        return (value if value.tzinfo else value.replace(tzinfo=datetime.UTC)).timestamp()
    if isinstance(value, np.datetime64):
        value = (value - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    if not isinstance(value, int | float | np.integer | np.floating) or not np.isfinite(value):
        raise ValueError(f"epoch_utc_s must be seconds since 1970, a datetime or None, found {value!r}.")
    return float(value)


def seconds(values: ArrayLike, owner: str) -> NDArray[np.float64]:
    """Times as float64; the error names the `owner`.

    Raises
    ------
    ValueError
        For dates and durations, whose unit float64 does not have, and for what is no number.

    Examples
    --------
    >>> seconds(np.array(["2026-05-04"], dtype="datetime64[ns]"), "time_s")
    Traceback (most recent call last):
    ...
    ValueError: time_s must be seconds, found datetime64[ns]: (t - t[0]) / np.timedelta64(1, "s") are some. ...
    """
    given = np.asarray(values)
    dated = given.dtype.kind in "mM" or (given.size and isinstance(given.flat[0], datetime.date | datetime.timedelta))
    if dated:
        found = f"{given.dtype}" if given.dtype.kind in "mM" else f"a {type(given.flat[0]).__name__}"
        raise ValueError(
            f'{owner} must be seconds, found {found}: (t - t[0]) / np.timedelta64(1, "s") are some. The date of their '
            "zero goes into Mission(epoch_utc_s=...)."
        )
    _check_digits(given, owner)
    return numbers(values, owner)


def _check_digits(given: NDArray[Any], owner: str) -> None:
    """Refuse times of float32 that have lost what is between two rows: since 1970 it has a digit of two minutes."""
    if given.dtype not in (np.float32, np.float16) or given.size < 2:
        return
    digit_s, steps_s = float(np.spacing(np.abs(given).max())), np.diff(np.asarray(given, dtype=np.float64).ravel())
    apart_s = float(np.median(steps_s[steps_s > 0.0])) if (steps_s > 0.0).any() else 0.0
    if digit_s > 0.1 * apart_s:
        raise ValueError(
            f"{owner} is of {given.dtype}, whose last digit is {digit_s:.2g} s at its end: too coarse for rows "
            f"{apart_s:.2g} s apart. Read the times as float64, or count them from the first one."
        )


def counts_from_1970(first_s: float) -> bool:
    """Whether a stamp can only be one in seconds since 1970-01-01 UTC.

    Examples
    --------
    >>> counts_from_1970(1.78e9), counts_from_1970(86400.0), counts_from_1970(1.78e12)
    (True, False, False)
    """
    return _FROM_S <= first_s < _TO_S


def axis_from(begin_s: float) -> tuple[float, str]:
    """What an axis of times is drawn from, and what its label says of it: a clock that counts from 1970 would fill it
    with digits that are all the same.

    Examples
    --------
    >>> axis_from(12.5), axis_from(1.78e9 + 0.5)
    ((0.0, ''), (1780000000.0, ' - 1780000000 s'))
    """
    if not counts_from_1970(begin_s):
        return 0.0, ""
    return float(np.floor(begin_s)), f" - {np.floor(begin_s):.0f} s"


def nanoseconds(time_s: Array, epoch_utc_s: float | None) -> NDArray[np.int64]:
    """Whole nanoseconds since 1970 of mission times; without an epoch the mission times themselves.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Mission times [s].
    epoch_utc_s : float or None
        UTC of mission time zero, in seconds since 1970.

    Raises
    ------
    ValueError
        For times that no date has (more than 290 years from 1970).
    """
    epoch = 0.0 if epoch_utc_s is None else epoch_utc_s
    time_s = np.asarray(time_s, dtype=np.float64)
    if time_s.size and not np.abs(time_s + epoch).max() < _MOST_S:
        raise ValueError(
            f"mission times up to {np.abs(time_s).max():.6g} s are no seconds; check unit and epoch of the times."
        )
    whole = np.floor(epoch)
    # apart: the sum of both in float64 would be rounded to 0.2 microseconds
    return np.int64(whole) * _NS + np.rint((epoch - whole) * 1e9).astype(np.int64) + np.rint(time_s * 1e9).astype(int)


def dates(time_s: Array, epoch_utc_s: float) -> NDArray[np.datetime64]:
    """Mission times as dates: datetime64[ns], shape (n,), UTC."""
    return nanoseconds(time_s, epoch_utc_s).view("datetime64[ns]")


def text(time_s: Array, epoch_utc_s: float, unit: str = "us") -> NDArray[np.str_]:
    """Mission times as ISO 8601, to the microsecond (or "ms", "s").

    Examples
    --------
    >>> text(np.array([0.25]), 1.78e9, "ms").tolist()
    ['2026-05-28T20:26:40.250Z']
    >>> text(np.array([0.0]), 1.78e9 + 0.1, "ms").tolist()
    ['2026-05-28T20:26:40.100Z']
    """
    # a conversion cuts off: 0.1 s of a large float is a little less
    rounded = nanoseconds(time_s, epoch_utc_s) + _HALF[unit]
    return np.datetime_as_string(rounded.view("datetime64[ns]").astype(f"datetime64[{unit}]"), timezone="UTC")


def date_text(time_s: float, epoch_utc_s: float | None) -> str | None:
    """One mission time as ISO 8601, to the millisecond; None without an epoch."""
    return None if epoch_utc_s is None else str(text(np.array([time_s]), epoch_utc_s, "ms")[0])

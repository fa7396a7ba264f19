"""UTC beside the mission clock: dates of mission times, and when stamps count from 1970.

Seconds are those of POSIX: every day has 86400 of them, a leap second repeats one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["axis_from", "counts_from_1970", "date_text", "dates", "nanoseconds", "text"]

Array = NDArray[np.float64]
_NS = 1_000_000_000
#: Stamps from September 2001 to the end of 2099 count from 1970 [s]; no other clock of a vehicle stands there but
#: that of GPS, and a mission says when it is that one.
_FROM_S, _TO_S = 1e9, 4102444800.0
#: What 64 bits of nanoseconds hold [s].
_MOST_S = 9.2e9
#: Half of the last digit that is written [ns].
_HALF = {"s": _NS // 2, "ms": 500_000, "us": 500}


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

"""Times that a logger puts before each line, by its own clock."""

import datetime
import functools
import re
from collections import Counter

_DAY_S = 86400.0
#: Seconds since 1970 of 2001 and 2100: a number in between is a time, in s, ms, us or ns.
_EPOCHS = (1e9, 4.1e9)
_TIME = rb"(?P<h>\d\d):?(?P<m>\d\d):?(?P<s>\d\d(?:[.,]\d+)?)(?![\d:])"
_ZONE = rb"\s*(?P<half>[AaPp]\.?[Mm]\b)?\s*(?P<zone>[-+]\d\d(?::?\d\d)?(?![\d:])|[A-Z]{1,3}[DES]T\b|Z|UTC|GMT)?"
_WITH_DOTS = rb"(?P<day2>\d\d)[.](?P<month2>\d\d)[.](?P<year2>\d{4})"
_YEAR_FIRST = rb"(?P<year>\d{4})[-/.]?(?P<month>\d\d)[-/.]?(?P<day>\d\d)"
_DATE = re.compile(rb"(?<!\d)(?:" + _YEAR_FIRST + rb"|" + _WITH_DOTS + rb")[ T_,;\t]*" + _TIME + _ZONE)
_EPOCH = re.compile(rb"(?:^|[^\d.])(\d{9,10}(?:\.\d+)?|\d{13}|\d{16}|\d{19})(?![\d.])")
_OF_DAY = re.compile(rb"(?:^|[^\d:])" + _TIME.replace(b":?", b":") + _ZONE)
#: Numbers before a time of day that may be a date of another order.
_OTHER_DATE = re.compile(rb"\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3})[-/. ]\d{2,4}")
#: A clock of twelve hours that begins anew goes on within this [s].
_GOES_ON_S = 3600.0
_UNREAD_DATE = (
    "stamps of the logger with a date that is not year, month, day: only their time of day counts; the day is that of "
    "the mission (date)"
)


class LoggerClock:
    """Reads the stamps of one log; a time of day goes on over midnight, and over noon where the clock has twelve hours.

    Parameters
    ----------
    tally : Counter
        Gets what is in doubt.

    Attributes
    ----------
    of_day : bool
        Whether a stamp had no date that can be read.
    zone : str
        A zone by its name, which is not known here; empty: none.
    """

    def __init__(self, tally: Counter[str]) -> None:
        self.of_day, self.zone = False, ""
        self._tally = tally
        self._midnight = 0.0
        self._last: float | None = None
        self._twelve = True

    def __call__(self, prefix: bytes) -> float | None:
        """Seconds since 1970, or since midnight of the first day, by what stands before a line; None where that is no
        time.
        """
        if len(prefix) < 8:
            return None
        if found := _DATE.search(prefix):
            return self._dated(found)
        if found := _EPOCH.search(prefix):
            digits = found[1].split(b".")[0]
            seconds = float(found[1]) / 10.0 ** max(len(digits) - 10, 0)
            if _EPOCHS[0] <= seconds < _EPOCHS[1]:
                return seconds
        if found := _OF_DAY.search(prefix):
            self._tally[_UNREAD_DATE] += _OTHER_DATE.search(prefix[: found.start("h")]) is not None
            return self._of_day(found)
        return None

    def _dated(self, found: re.Match[bytes]) -> float | None:
        days = _days(
            *(found.group("year", "month", "day") if found["year"] else found.group("year2", "month2", "day2"))
        )
        return None if days is None else _DAY_S * days + self._seconds(found)

    def _of_day(self, found: re.Match[bytes]) -> float:
        self._twelve = self._twelve and 1 <= int(found["h"]) <= 12 and not found["half"]
        time_s = self._midnight + self._seconds(found)
        if self._last is None:
            self._last = time_s
        if self._twelve and -0.5 * _DAY_S <= time_s - self._last <= _GOES_ON_S - 0.5 * _DAY_S:
            self._midnight += 0.5 * _DAY_S
            time_s += 0.5 * _DAY_S
            self._tally["clock of 12 hours without AM or PM before the lines, taken to begin as it reads"] = 1
        elif time_s < self._last - 0.5 * _DAY_S:
            self._midnight += _DAY_S
            time_s += _DAY_S
        elif time_s > self._last + 0.5 * _DAY_S and self._midnight >= _DAY_S:
            time_s -= _DAY_S  # late: of before midnight
        self.of_day, self._last = True, max(time_s, self._last)
        return time_s

    def _seconds(self, found: re.Match[bytes]) -> float:
        """Of the day, in UTC where the zone is known."""
        hours, minutes, seconds, half, zone = found.group("h", "m", "s", "half", "zone")
        hour = int(hours)
        if half:
            hour = hour % 12 + (12 if half[:1].lower() == b"p" else 0)
        if zone and zone[-1:] == b"T" and zone != b"GMT":
            self.zone = zone.decode()
        return 3600.0 * hour + 60.0 * int(minutes) + float(seconds.replace(b",", b".")) - _zone(zone)


@functools.lru_cache(maxsize=16)
def _days(year: bytes, month: bytes, day: bytes) -> int | None:
    """Days since 1970; None where there is no such day."""
    try:
        return datetime.date(int(year), int(month), int(day)).toordinal() - 719163
    except ValueError:
        return None


def _zone(text: bytes | None) -> float:
    """Seconds by which a clock of this zone is ahead of UTC."""
    if not text or text[:1] not in b"+-":
        return 0.0
    digits = text[1:].replace(b":", b"").ljust(4, b"0")
    size = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:4])
    return -size if text[:1] == b"-" else size

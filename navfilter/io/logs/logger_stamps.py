"""Times that a logger puts before each line, by its own clock."""

from __future__ import annotations

import datetime
import re

__all__ = ["LoggerClock"]

_DAY_S = 86400.0
#: Seconds since 1970 of 2001 and 2100: a number in between is a time, in s, ms, us or ns.
_EPOCHS = (1e9, 4.1e9)
_DATE = re.compile(
    rb"(\d{4})[-/](\d\d)[-/](\d\d)[ T_](\d\d):(\d\d):(\d\d(?:[.,]\d+)?)\s*(Z|UTC|GMT|[-+]\d\d(?::?\d\d)?(?![\d:]))?"
)
_EPOCH = re.compile(rb"(?:^|[^\d.])(\d{9,10}(?:\.\d+)?|\d{13}|\d{16}|\d{19})(?![\d.])")
_OF_DAY = re.compile(
    rb"(?:^|[^\d:])(\d\d):(\d\d):(\d\d(?:[.,]\d+)?)(?![\d:])\s*([AaPp])?\.?(?:[Mm]\b)?\s*([-+]\d\d:?\d\d)?"
)


class LoggerClock:
    """Reads the stamps of one log; a time of day goes on over midnight.

    Attributes
    ----------
    of_day : bool
        Whether a stamp had no date.
    """

    def __init__(self) -> None:
        self.of_day = False
        self._midnight = 0.0
        self._last: float | None = None

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
        return self._of_day(found) if (found := _OF_DAY.search(prefix)) else None

    @staticmethod
    def _dated(found: re.Match[bytes]) -> float | None:
        try:
            day = datetime.date(int(found[1]), int(found[2]), int(found[3]))
        except ValueError:
            return None
        return _DAY_S * (day.toordinal() - 719163) + _seconds(*found.groups()[3:6]) - _zone(found[7])

    def _of_day(self, found: re.Match[bytes]) -> float:
        hour = int(found[1])
        if found[4]:  # a clock of twelve hours
            hour = hour % 12 + (12 if found[4].lower() == b"p" else 0)
        time_s = self._midnight + _seconds(b"%d" % hour, found[2], found[3]) - _zone(found[5])
        if self._last is not None and time_s < self._last - 0.5 * _DAY_S:
            self._midnight += _DAY_S
            time_s += _DAY_S
        self.of_day, self._last = True, time_s
        return time_s


def _seconds(hour: bytes, minute: bytes, second: bytes) -> float:
    return 3600.0 * int(hour) + 60.0 * int(minute) + float(second.replace(b",", b"."))


def _zone(text: bytes | None) -> float:
    """Seconds by which a clock of this zone is ahead of UTC."""
    if not text or text[:1] not in b"+-":
        return 0.0
    digits = text[1:].replace(b":", b"").ljust(4, b"0")
    size = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:4])
    return -size if text[:1] == b"-" else size

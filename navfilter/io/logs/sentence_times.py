"""Times for sentences that have none: carried on from those that have, with the date."""

import datetime
import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

_DAY_S = 86400.0
#: 1970-01-01 as `datetime.date.toordinal` counts.
_EPOCH = 719163
#: Stamps beyond this have a date [s].
_SINCE_1970_S = 1e9
#: More than this cannot come between two times of a living receiver; bounds the memory.
_MOST_WAITING = 5000
#: Times farther apart than this are a gap, not a cycle [s].
_LONGEST_CYCLE_S = 30.0
_BEFORE = "sentences before the first time left out"
_NEVER = (
    "sentences without any time left out (none of the file has one, and no stamp before a line is known: write it as "
    "2026-05-01T12:59:50.5Z, or in seconds since 1970)"
)


class Carrier:
    """Carries time of day and date from sentence to sentence.

    Parameters
    ----------
    date : datetime.date or None
        Of the beginning; None: nothing in the file gives one, and times count from midnight of the first day.
    tally : Counter
        Gets the sentences that had to be dropped for want of a time.

    Attributes
    ----------
    dated : bool
        Whether a date is known.
    """

    def __init__(self, date: datetime.date | None, tally: Counter[str]) -> None:
        self._tally = tally
        self._midnight = 0.0 if date is None else _DAY_S * (date.toordinal() - _EPOCH)
        self.dated = date is not None
        self._now: float | None = None
        self._received: float | None = None
        self._cycle_s = 1.0
        self._waiting: list[tuple[str, Any, float | None]] = []
        self._ready: list[tuple[str, float, Any]] = []

    def heard(self, time_of_day: float, date: datetime.date | None, received: float | None) -> float:
        """A sentence with a time came; those that waited for it become `settled`. Returns its time [s]."""
        if time_of_day > 1e8:
            # Some instruments count seconds since 1970 by themselves.
            time_s = time_of_day
        else:
            if date is not None:
                self._midnight = _DAY_S * (date.toordinal() - _EPOCH)
            elif not self.dated and received is not None and received >= _SINCE_1970_S:
                self._tally["file without a date (no RMC, no ZDA): it is that of the logger's stamps"] += 1
                self._midnight, self.dated = _DAY_S * round((received - time_of_day) / _DAY_S), True
            time_s = self._midnight + time_of_day
            if date is None and self._now is not None and time_s < self._now - 0.5 * _DAY_S:
                self._midnight += _DAY_S
                time_s += _DAY_S
        if self._now is None or time_s != self._now:
            self._settle(time_s)
            self._now, self._received = time_s, received
        return time_s

    @property
    def has_begun(self) -> bool:
        """Whether a time was heard."""
        return self._now is not None

    def wait(self, topic: str, record: Any, received: float | None) -> None:
        """A sentence without a time came."""
        if self._now is None:
            self._tally[_BEFORE] += 1
            return
        self._waiting.append((topic, record, received))
        if len(self._waiting) >= _MOST_WAITING:
            self._settle(None)

    def settled(self) -> Iterator[tuple[str, float, Any]]:
        """The sentences whose times are known by now."""
        ready, self._ready = self._ready, []
        return iter(ready)

    def rest(self) -> Iterator[tuple[str, float, Any]]:
        """Those after the last time."""
        self._settle(None)
        if self._now is None and self._tally[_BEFORE]:
            self._tally[_NEVER] += self._tally.pop(_BEFORE)
        if not self.dated and self._now is not None:
            self._tally["file without a date (no RMC, no ZDA): times count from midnight of its first day"] += 1
        return self.settled()

    def _settle(self, next_s: float | None) -> None:
        """Give those that wait their times, between the last time and the next."""
        if self._now is None:
            return
        if next_s is not None and 0.0 < next_s - self._now < _LONGEST_CYCLE_S:
            self._cycle_s = next_s - self._now
        count = Counter(topic for topic, _, _ in self._waiting)
        seen: Counter[str] = Counter()
        for topic, record, received in self._waiting:
            if received is not None and self._received is not None:
                time_s = self._now + received - self._received
            else:
                time_s = self._now + self._cycle_s * seen[topic] / count[topic]
            seen[topic] += 1
            self._ready.append((topic, time_s, record))
        self._waiting = []


def seconds_since_1970(*fields: int) -> float | None:
    """Of a date and time of day, in UTC: year, month, day, hour, minute, second; None where that is no date."""
    try:
        return datetime.datetime(*fields, tzinfo=datetime.UTC).timestamp()  # type: ignore[misc,arg-type]
    except ValueError:
        return None


def number_of(text: str | bytes) -> float | None:
    """A number as a sentence has it; None where it is none."""
    try:
        return float(text)
    except ValueError:
        return None


def time_of_day(text: bytes) -> float | None:
    """Seconds since midnight of hhmmss.s; None where it is no time."""
    digits = text.split(b".")[0]
    seconds = number_of(text[4:])
    if len(digits) != 6 or not digits.isdigit() or seconds is None or not math.isfinite(seconds):
        return None
    return 3600.0 * int(text[:2]) + 60.0 * int(text[2:4]) + seconds

"""UTC of a mission's stamps: as its mission.toml says, or as the stamps themselves do."""

from __future__ import annotations

import datetime
from collections.abc import Iterable

from navfilter.foundation import utc
from navfilter.io.mission_schema import MissionSpec
from navfilter.models.mission import Stream

__all__ = ["day_of", "epoch_of"]

#: 2071: stamps that read later count from 1900 or 1904.
_LATE_S = 3.2e9
_UNIX = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def epoch_of(
    spec: MissionSpec, streams: Iterable[Stream | None], instruments: Iterable[str] = ()
) -> tuple[float | None, list[str]]:
    """UTC at which the stamps of a mission read zero.

    Parameters
    ----------
    spec : MissionSpec
    streams : iterable of Stream
        With their stamps as the files have them.
    instruments : iterable of str
        Files whose times are of an instrument's own clock, where no other file gives a time.

    Returns
    -------
    epoch_utc_s : float or None
        Seconds since 1970; 0 where the stamps count from there. None: nobody knows.
    notes : list of str
        What is in doubt.
    """
    if isinstance(spec.epoch, datetime.datetime):
        return (spec.epoch - _UNIX).total_seconds(), []
    firsts = [float(stream.time_s[0]) for stream in streams if stream is not None and len(stream)]
    if spec.epoch == "unknown" or not firsts or not all(map(utc.counts_from_1970, firsts)):
        return None, []
    day = datetime.datetime.fromtimestamp(min(firsts), datetime.UTC).date()
    cure = 'UTC is unknown; give epoch = 1970-01-01T00:00:00Z, the clock\'s own, or "unknown"'
    if instruments := sorted(set(instruments)):
        return None, [f"the times are of the clock of an instrument ({', '.join(instruments)}), not of UTC: {cure}"]
    if min(firsts) > _LATE_S:
        return None, [f"the stamps read as seconds since 1970 begin on {day}: they count from elsewhere, and {cure}"]
    if spec.date is not None and abs((day - spec.date).days) > 1:
        doubt = f"the stamps read as seconds since 1970 begin on {day}, date says {spec.date}"
        return None, [f"{doubt}: {cure}"]
    return 0.0, []


def day_of(epoch_utc_s: float | None, streams: Iterable[Stream | None]) -> datetime.date | None:
    """Day on which stamps begin, by UTC; None where that is not known.

    Parameters
    ----------
    epoch_utc_s : float or None
        See `epoch_of`.
    streams : iterable of Stream
        With their stamps as the files have them.
    """
    firsts = [float(stream.time_s[0]) for stream in streams if stream is not None and len(stream)]
    if epoch_utc_s is None or not firsts or not utc.counts_from_1970(first_s := min(firsts) + epoch_utc_s):
        return None
    return datetime.datetime.fromtimestamp(first_s, datetime.UTC).date()

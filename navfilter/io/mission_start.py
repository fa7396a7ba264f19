"""When and where a mission begins: UTC of its stamps and its start, by its mission.toml, its stamps or its truth."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation import utc
from navfilter.io.mission_schema import MissionSpec, StartSpec
from navfilter.models.mission import MissionError, Stream
from navfilter.models.start import Start


def start_of(spec: StartSpec, truth: Stream | None, date: datetime.date | None, path: Path) -> Start:
    """Build the `Start` that a mission.toml describes.

    Parameters
    ----------
    spec : StartSpec
    truth : Stream or None
        Used where the start comes from the truth: its first row with a position at or after ``time_s``.
    date : datetime.date or None
        Day of the mission, handed on to the start.
    path : Path
        The .toml, for messages.

    Returns
    -------
    Start
    """
    given = {k: v for k, v in spec.model_dump(exclude={"source"}).items() if v is not None}
    if spec.source == "truth" and truth is not None:
        given = {**_from_truth(truth, given.get("time_s"), path), **given}
    missing = [key for key in ("time_s", "latitude_deg", "longitude_deg") if key not in given]
    if missing:
        raise MissionError(f'{path}: start lacks {", ".join(missing)}; add them or write from = "truth".')
    try:
        return Start(**given, date=date)
    except ValueError as error:
        raise MissionError(f"{path}: {error}") from None


def _from_truth(truth: Stream, time_s: float | None, path: Path) -> dict[str, Any]:
    usable = np.isfinite(truth.value[:, :2]).all(axis=1)
    if time_s is not None:
        usable &= truth.time_s >= time_s - 1e-9
    rows = np.flatnonzero(usable)
    if not rows.size:
        raise MissionError(f"{path}: the truth has no position at or after the start; give the start in numbers.")
    row = rows[0]
    value = truth.value[row]
    found: dict[str, Any] = {
        "time_s": float(truth.time_s[row]),
        "latitude_deg": float(np.degrees(value[0])),
        "longitude_deg": float(np.degrees(value[1])),
    }
    if np.isfinite(value[2]):
        found["height_m"] = float(value[2])
    if np.isfinite(value[3:6]).all():
        found["velocity_n"] = tuple(float(v) for v in value[3:6])
    for name, angle in zip(("roll_deg", "pitch_deg", "heading_deg"), value[6:9], strict=True):
        if np.isfinite(angle):
            found[name] = float(np.degrees(angle))
    return found


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

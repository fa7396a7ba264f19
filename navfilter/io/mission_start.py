"""The start of a mission as its mission.toml gives it, or as the truth has it."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.io.mission_schema import StartSpec
from navfilter.models.mission import MissionError, Stream


def start_of(spec: StartSpec | None, truth: Stream | None, date: datetime.date | None, path: Path) -> Any:
    """Build the `Start` that a mission.toml describes.

    Parameters
    ----------
    spec : StartSpec or None
        None: the mission has no start of its own.
    truth : Stream or None
        Used where the start comes from the truth: its first row with a position at or after ``time_s``.
    date : datetime.date or None
        Day of the mission, handed on to the start.
    path : Path
        The .toml, for messages.

    Returns
    -------
    Start or None
    """
    if spec is None:
        return None
    from navfilter.models.start import Start

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

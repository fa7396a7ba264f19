"""Surveyed places against a track: where it was at their times, or how near it came to them."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation.chi_square import chi_square_limit
from navfilter.foundation.quoting import one_line
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import read_table
from navfilter.io.trust import Place
from navfilter.models.mission import MissionError
from navfilter.track.track import Track


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed place.

    Attributes
    ----------
    name : str
    latitude, longitude : float
        [rad].
    height : float
        Above the ellipsoid [m]; NaN: not known.
    time_s : float
        When the vehicle was there [s]; NaN: where it came nearest.
    """

    name: str
    latitude: float
    longitude: float
    height: float = math.nan
    time_s: float = math.nan


@dataclass(frozen=True)
class Control:
    """The track at a surveyed place, minus that place.

    Attributes
    ----------
    name : str
    time_s : float
        Of the comparison [s].
    nearest : bool
        At the nearest approach: only what is across the way counts.
    north_m, east_m, up_m : float
        [m]; `up_m` is NaN where the place has no height.
    sd_m : float
        Predicted standard deviation of the horizontal distance, along it [m]; the place itself counts as known.
    inside : bool or None
        Whether it lies where 95 % of honest ones do; None, and NaN for all lengths, where no track is at its time.
    """

    name: str
    time_s: float
    nearest: bool
    north_m: float
    east_m: float
    up_m: float
    sd_m: float
    inside: bool | None

    @property
    def distance_m(self) -> float:
        """Horizontal [m]."""
        return math.hypot(self.north_m, self.east_m)

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        return {**asdict(self), "distance_m": self.distance_m}

    def __str__(self) -> str:
        if self.inside is None:
            return f"control point {self.name}: there is no track at its {self.time_s:.1f} s"
        where = "inside" if self.inside else "outside"
        how = "nearest" if self.nearest else "passed"
        return (
            f"control point {self.name}, {how} at {self.time_s:.1f} s: {self.distance_m:.2f} m off "
            f"({self.north_m:+.2f} north, {self.east_m:+.2f} east), predicted sd {self.sd_m:.2f} m, "
            f"{where} the 95 % range"
        )


def read_control_points(path: Path) -> tuple[ControlPoint, ...]:
    """Places of a table with the columns name, latitude_deg, longitude_deg, and perhaps height_m and time_s.

    Raises
    ------
    MissionError
        Where a column is missing, or a place cannot be one.
    """
    table = read_table(Place.of(path), TableOptions())
    missing = [name for name in ("name", "latitude_deg", "longitude_deg") if name not in table.columns]
    if missing:
        raise MissionError(
            f"{path}: no column {' and '.join(missing)}. Control points have the columns name, latitude_deg, "
            "longitude_deg, and perhaps height_m and time_s (of the mission clock; empty: the nearest approach)."
        )
    unknown = np.full(len(table.raw("name")), np.nan)
    latitude, longitude, height, time_s = (
        table.numbers(name)[0] if name in table.columns else unknown
        for name in ("latitude_deg", "longitude_deg", "height_m", "time_s")
    )
    wrong = ~((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0))
    if wrong.any():
        row = int(wrong.argmax())
        raise MissionError(f"{path}: row {row + 1} is no place: latitude_deg and longitude_deg are decimal degrees.")
    rows = zip(table.raw("name").tolist(), np.radians(latitude), np.radians(longitude), height, time_s, strict=True)
    return tuple(ControlPoint(one_line(str(name)), *map(float, numbers)) for name, *numbers in rows)


def control_residuals(track: Track, points: Sequence[ControlPoint]) -> tuple[Control, ...]:
    """The track against surveyed places.

    Parameters
    ----------
    track : Track
    points : sequence of ControlPoint
    """
    return tuple(_control(track, point) for point in points)


def _control(track: Track, point: ControlPoint) -> Control:
    nearest = math.isnan(point.time_s)
    time_s = _nearest_s(track, point) if nearest else point.time_s
    if not track.time_s[0] <= time_s <= track.time_s[-1]:
        return Control(point.name, time_s, nearest, math.nan, math.nan, math.nan, math.nan, None)
    there = track.at(time_s)
    offset = there.local(point.latitude, point.longitude)[0, :2]
    covariance = there.covariance[0, :2, :2]
    distance = math.hypot(*offset)
    along = offset / distance if distance > 0.0 else np.array([1.0, 0.0])
    sd = math.sqrt(max(float(along @ covariance @ along), 0.0))
    # across the way there is one degree of freedom
    square = (distance / sd) ** 2 if nearest and sd > 0.0 else float(offset @ np.linalg.pinv(covariance) @ offset)
    inside = square <= chi_square_limit(0.95, 1.0 if nearest else 2.0)
    up = float(there.height[0]) - point.height
    return Control(point.name, time_s, nearest, float(offset[0]), float(offset[1]), up, sd, bool(inside))


def _nearest_s(track: Track, point: ControlPoint) -> float:
    """When the way between the rows comes nearest."""
    offsets = track.local(point.latitude, point.longitude)[:, :2]
    step = np.diff(offsets, axis=0)
    square = (step**2).sum(axis=1)
    share = np.divide(-(offsets[:-1] * step).sum(axis=1), square, out=np.zeros_like(square), where=square > 0.0)
    share = np.clip(share, 0.0, 1.0)
    k = int(np.argmin(np.hypot(*(offsets[:-1] + share[:, np.newaxis] * step).T)))
    return float(track.time_s[k] + share[k] * (track.time_s[k + 1] - track.time_s[k]))

"""Fixes that are kept from the filter, so that its track can be scored against them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.error_models import ErrorModel
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.sensors import Sensor
from navfilter.models.state import matrix_from_euler
from navfilter.models.vehicle import Vehicle
from navfilter.track.track import Track

__all__ = ["Score", "Withheld", "score", "withhold"]


@dataclass(frozen=True, eq=False)
class Withheld:
    """Readings of one sensor that the filter does not get.

    Attributes
    ----------
    sensor : str
    readings : Stream
    """

    sensor: str
    readings: Stream


@dataclass(frozen=True)
class Score:
    """Errors of a track at the fixes withheld, horizontal.

    Attributes
    ----------
    sensor : str
    count : int
        Fixes that were scored.
    begin_s, end_s : float
        Of the first and the last one [s].
    rms_m, most_m, end_m : float
    distance_m : float
        Travelled from the first to the last one [m].
    sd_m : float
        Predicted rms, the errors of the fixes included [m].
    inside : float
        Share of the fixes inside the 95 % ellipse.
    """

    sensor: str
    count: int
    begin_s: float
    end_s: float
    rms_m: float
    most_m: float
    end_m: float
    distance_m: float
    sd_m: float
    inside: float

    def __str__(self) -> str:
        share = (
            f" ({100 * self.end_m / self.distance_m:.2f} % of {self.distance_m:.0f} m)" if self.distance_m > 0 else ""
        )
        return (
            f"{self.count} fixes of {self.sensor} withheld ({self.begin_s:.0f} to {self.end_s:.0f} s): "
            f"rms {self.rms_m:.2f} m (predicted {self.sd_m:.2f} m), {self.most_m:.2f} m at most, "
            f"{self.end_m:.2f} m at the last{share}; {100 * self.inside:.0f} % inside the 95 % ellipse"
        )

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        return dataclasses.asdict(self)


def withhold(
    mission: Mission, vehicle: Vehicle, sensor: str, intervals: Sequence[tuple[float, float]]
) -> tuple[Mission, Withheld]:
    """Take the readings of one sensor out of a mission.

    Parameters
    ----------
    mission : Mission
    vehicle : Vehicle
    sensor : str
        One that corrects.
    intervals : sequence of (float, float)
        Closed, on the mission clock [s].

    Raises
    ------
    ValueError
        When the vehicle has no such sensor, the mission no such stream, or no reading lies inside the intervals.
    """
    if sensor not in vehicle.sensors or vehicle.sensors[sensor].from_drive:
        have = ", ".join(name for name, s in vehicle.sensors.items() if not s.from_drive) or "none"
        raise ValueError(
            f'"{sensor}" cannot be withheld: it is no correcting sensor of this vehicle (these are: {have}).'
        )
    stream = mission.stream(sensor)
    inside = np.zeros(len(stream), bool)
    for begin_s, end_s in intervals:
        inside |= (stream.time_s >= begin_s) & (stream.time_s <= end_s)
    if not inside.any():
        span = f"they lie from {stream.time_s[0]:.1f} to {stream.time_s[-1]:.1f} s" if len(stream) else "there are none"
        said = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in intervals)
        raise ValueError(f'no reading of "{sensor}" lies inside {said}; {span}. Give other times.')
    return mission.hide(sensor, *intervals), Withheld(sensor, stream.keep(inside))


def score(track: Track, withheld: Withheld) -> Score | None:
    """Errors of a track at the fixes withheld.

    Returns
    -------
    Score or None
        None where the sensor gives no position, or none of its fixes lies inside the track.

    Notes
    -----
    The track is taken to the times of the fixes, and its reference point to the antenna by the lever arm. What is
    predicted is the covariance of the track plus the variance of the sensor's whole error model.
    """
    sensor = track.vehicle.sensors[withheld.sensor]
    fixes = withheld.readings.keep(_fixes(sensor, withheld.readings, track))
    if sensor.gives != "position" or not len(fixes):
        return None
    truth = np.full((len(fixes), len(TRUTH_COLUMNS)), np.nan)
    truth[:, :2] = fixes.value[:, :2]
    there = track.at(fixes.time_s)
    lever = matrix_from_euler(*there.attitude.T) @ np.asarray(getattr(sensor, "lever_arm_b_m", (0.0, 0.0, 0.0)))
    error = there.errors(Stream(fixes.time_s, truth, TRUTH_COLUMNS)).position_n[:, :2] + lever[:, :2]
    S = there.covariance[:, :2, :2] + np.diag([_variance(model, 1.0 / sensor.rate_hz) for model in sensor.models[:2]])
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(S, error[:, :, None])[:, :, 0])
    distance = np.hypot(error[:, 0], error[:, 1])
    travelled = np.interp(fixes.time_s[[0, -1]], track.time_s, track.travelled())
    return Score(
        sensor=withheld.sensor,
        count=len(fixes),
        begin_s=float(fixes.time_s[0]),
        end_s=float(fixes.time_s[-1]),
        rms_m=float(np.sqrt(np.mean(distance**2))),
        most_m=float(distance.max()),
        end_m=float(distance[-1]),
        distance_m=float(travelled[1] - travelled[0]),
        sd_m=float(np.sqrt(np.mean(S[:, 0, 0] + S[:, 1, 1]))),
        inside=float(np.mean(squared <= chi_square_limit(0.95, 2))),
    )


def _fixes(sensor: Sensor, readings: Stream, track: Track) -> NDArray[np.bool_]:
    """Which rows are fixes and lie inside the track."""
    good = np.array([sensor.read(value) is not None for value in readings.value], dtype=bool)
    good &= (readings.time_s >= track.time_s[0]) & (readings.time_s <= track.time_s[-1])
    return good & np.isfinite(readings.value[:, :2]).all(axis=1)


def _variance(model: ErrorModel, period_s: float) -> float:
    """Variance of all of an error at the start."""
    block = model.block(period_s)
    return float(block.r + block.C @ block.P0 @ block.C)

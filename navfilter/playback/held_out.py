"""Fixes that are kept from the filter, so that its track can be scored against them."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erfc, gammaincc

from navfilter.filter.records import OUTCOMES
from navfilter.foundation.arguments import within
from navfilter.foundation.arrays import Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.sensors import Sensor
from navfilter.models.state import matrix_from_euler
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track

#: So many of the fixes withheld are looked at, evenly in time [1]: the fewer, the longer the drift between them, and
#: the less the errors of the fixes count beside it.
LOOKS = 12
#: Fewer are judged as surfacings [1].
LEAST_LOOKS = 4


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


@dataclass(frozen=True)
class Drift:
    """What fixes withheld say of the drift between them.

    Attributes
    ----------
    sensor : str
    count : int
        Fixes that were looked at.
    apart_s : float
        Time from one to the next [s].
    nis : float
        Mean NIS per component, 1 is honest.
    lasting : float
        The mean innovation north or east, whichever is larger, in units of its sd: beyond 3 or so the drift goes on in
        one direction for longer than vehicle.toml lets it.
    chance : float
        Probability of these two where vehicle.toml is right.
    """

    sensor: str
    count: int
    apart_s: float
    nis: float
    lasting: float
    chance: float


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
    inside = within(stream.time_s, intervals)
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
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models[:2]]
    S = there.covariance[:, :2, :2] + np.diag([block.variance for block in blocks])
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


def drift(vehicle: Vehicle, mission: Mission, withheld: Withheld) -> Drift | None:
    """Test by the fixes withheld what a vehicle believes of its drift.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
        As it was replayed, without them.
    withheld : Withheld

    Returns
    -------
    Drift or None
        None where the sensor gives no position, or too few of its fixes lie inside the run.

    Notes
    -----
    Errors of one track at many fixes are nearly the same error, and their mean square says little. The likelihood of
    the fixes is the product of that of each innovation in a run that gets them one after another, and these are white
    (Schweppe, 1965). A few fixes far apart are taken, so that an innovation is drift rather than the error of a fix.
    Their sum tells an error that lasts for longer than it should sooner than their squares do.
    """
    sensor = vehicle.sensors[withheld.sensor]
    readings = withheld.readings
    if sensor.gives != "position" or not len(readings):
        return None
    own = mission.streams[withheld.sensor]
    good = np.array([sensor.read(value) is not None for value in readings.value]) & np.isfinite(readings.value[:, 1])
    good &= readings.time_s >= (mission.begin_s if mission.start is None else mission.start.time_s)
    times = readings.time_s[good]
    if times.size < LEAST_LOOKS:
        return None
    apart_s = float(times[-1] - times[0]) / LOOKS
    rows = [int(np.argmin(np.abs(times - t))) for t in times[0] + apart_s * np.arange(1, LOOKS + 1)]
    looks = readings.keep(np.flatnonzero(good)[sorted(set(rows))])
    level = looks.value.copy()
    level[:, 2] = np.nan  # a height says nothing of the drift, nor does that of an antenna
    if getattr(sensor, "antenna_height_m", None) is not None:
        plain = dataclasses.replace(sensor, antenna_height_m=None)  # type: ignore[call-arg]
        vehicle = dataclasses.replace(vehicle, sensors={**vehicle.sensors, withheld.sensor: plain})
    both = _together(own, dataclasses.replace(looks, value=level))
    r = replay(vehicle, mission.with_stream(withheld.sensor, both), output_rate_hz=0.1).residuals[withheld.sensor]
    seen = np.isin(np.round(r.time_s + sensor.time_offset_s, 6), np.round(looks.time_s, 6))
    seen &= r.used | (r.outcome == OUTCOMES.index("rejected"))
    dof, count = float(r.dof[seen].sum()), int(np.count_nonzero(seen))
    if count < LEAST_LOOKS or not dof:
        return None
    nis = float(r.nis[seen].sum())
    lasting = float(np.abs(np.nansum(r.value[seen, :2] / r.sd[seen, :2], axis=0)).max() / np.sqrt(count))
    # two tests, and two axes of the one
    chance = 2.0 * min(float(gammaincc(0.5 * dof, 0.5 * nis)), 2.0 * float(erfc(lasting / np.sqrt(2.0))))
    return Drift(withheld.sensor, count, apart_s, nis / dof, lasting, min(1.0, chance))


def _together(one: Stream, other: Stream) -> Stream:
    """Readings of one sensor in the order of their times."""
    time_s = np.concatenate([one.time_s, other.time_s])
    order = np.argsort(time_s, kind="stable")
    sd = None if one.sd is None or other.sd is None else np.concatenate([one.sd, other.sd])[order]
    return Stream(time_s[order], np.concatenate([one.value, other.value])[order], one.columns, sd)


def _fixes(sensor: Sensor, readings: Stream, track: Track) -> Mask:
    """Which rows are fixes and lie inside the track."""
    good = np.array([sensor.read(value) is not None for value in readings.value], dtype=bool)
    good &= (readings.time_s >= track.time_s[0]) & (readings.time_s <= track.time_s[-1])
    return good & np.isfinite(readings.value[:, :2]).all(axis=1)

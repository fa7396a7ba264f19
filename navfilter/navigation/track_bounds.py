"""The bounds of `navfilter.faults.protection_level` along a track, from its covariance and its measurements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from navfilter.faults import settings
from navfilter.faults.alternative_path import believable
from navfilter.faults.protection_level import bounds, whole_offset
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.arrays import Array, Ints, Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.fault_bias import has_offset, wanders
from navfilter.models.sensors import Sensor
from navfilter.track.track import Track


def bounds_along(track: Track, unnoticed: Array) -> Array:
    """Protection radius [m] and bound of the heading [rad] at each row of a forward track, shape (n, 2).

    Parameters
    ----------
    track : Track
        As the filter gave it out; a smoothed one knows more than these bounds are about.
    unnoticed : ndarray, shape (n, 2)
        What faults that nobody has noticed may have done to position [m] and heading [rad].
    """
    off: dict[str, Array] = {}
    fixes = []
    slow = np.zeros(len(track))
    for name in track.residuals:
        sensor, known = track.vehicle.sensors[name], _off(track, name)
        sees = sensor.observes.corrects
        off[sees] = np.maximum(off.get(sees, 0.0), known)
        slow = np.maximum(slow, np.where(known > 0.0, max(_slow(sensor)), 0.0)) if sees == "heading" else slow
        fixes += [track.residuals[name]] if sees == "position" else []
    away, inertial = _since_fix(track, fixes), track.vehicle.drive.inertial
    refused = [_refused_way(track, name, track.time_s - away[0]) for name in track.residuals]
    beside_m = np.max(refused, axis=0, initial=0.0)
    compared = inertial or any(track.vehicle.sensors[name].observes.corrects == "heading" for name in track.residuals)
    return np.column_stack(bounds(track.covariance, *away, off, inertial, slow, beside_m, compared, *unnoticed.T))


def _off(track: Track, name: str) -> Array:
    """What a sensor may be off by at each row; 0 where it has not been heard, or has been found to be off."""
    r, sensor = track.residuals[name], track.vehicle.sensors[name]
    used = r.outcome == OUTCOMES.index("used")
    judged = used | (r.outcome == OUTCOMES.index("rejected"))
    if not judged.any() or not sensor.observes.corrects:
        return np.zeros(len(track))
    time_s, refused, sd = r.time_s[judged], ~used[judged], r.sd[judged]
    # one that is refused alone is an outlier, unless the sensor has confirmed nothing yet
    first_s = r.time_s[used][0] if used.any() else np.inf
    again = refused & (np.r_[False, refused[:-1]] | (time_s < first_s + settings.CONFIRMED_S))
    slow = _slow(sensor)
    limit = float(chi_square_limit(sensor.gate_probability, sensor.axes))
    unseen = np.sqrt(limit * _largest(np.where(np.isnan(sd), 0.0, sd**2 + slow)))
    last = _so_far(time_s, track.time_s) - 1
    off = np.where(again, whole_offset(sensor.observes.corrects, r.value[judged], max(slow)), unseen)[last]
    if sensor.observes.corrects == "position" and sensor.axes == 3:
        for k in _beat(r.value[judged], sd, refused, limit):
            after = (track.time_s >= time_s[k]) & (track.time_s < time_s[k] + settings.FOLLOWED_S)
            off[after] = np.maximum(off[after], np.hypot(*np.nan_to_num(r.value[judged][k, :2])))
    off[last < 0] = 0.0
    for begin_s, end_s in _with_offsets(track, name):
        off[(track.time_s >= begin_s) & (track.time_s < end_s)] = 0.0
    return np.asarray(off)


def _beat(value: Array, sd: Array, refused: Mask, limit: float) -> Ints:
    """Which fixes the state was set to against what was believed before: used after one that was refused, and beyond
    what the gate would have passed of that one.
    """
    size = _largest(np.nan_to_num(np.abs(value)))
    let_in = ~refused[1:] & refused[:-1] & (size[1:] > np.sqrt(limit) * _largest(np.nan_to_num(sd[:-1])))
    return np.flatnonzero(let_in) + 1


def _largest(rows: Array) -> Array:
    """The largest of each row: of a few columns at a time, for row by row takes numpy fifteen times as long."""
    return np.asarray(np.ascontiguousarray(rows.T).max(axis=0))


def _with_offsets(track: Track, name: str, so: Callable[[Any], bool] = has_offset) -> list[tuple[float, float]]:
    """When a sensor that had jumped had constants for it, or such that wander [s]."""
    history = track.error_models.get(name, [])
    pairs = zip(history, [*history[1:], (np.inf, None)], strict=True)
    return [(begin_s, end_s) for (begin_s, models), (end_s, _) in pairs if so(models)]


def _refused_way(track: Track, name: str, fix_s: Array) -> Array:
    """What the refused readings of a velocity come to at each row, since the last fix [m]; 0 of other sensors."""
    r, sensor = track.residuals[name], track.vehicle.sensors[name]
    judged = r.outcome <= OUTCOMES.index("rejected")
    if not sensor.ground or not judged.any():
        return np.zeros(len(track))
    time_s, value, refused = r.time_s[judged], sensor.over_ground(r.value[judged]), ~r.used[judged]
    row = np.minimum(np.searchsorted(track.time_s, time_s), len(track) - 1)
    speed = np.linalg.norm(track.velocity_n[row], axis=1)
    again = refused & np.r_[False, refused[:-1]] & believable(value, speed, track.vehicle.drive.max_speed_m_s)
    # of what is left aside nothing is reckoned with
    for begin_s, end_s in _with_offsets(track, name, wanders):
        again &= (time_s < begin_s) | (time_s >= end_s)
    if not again.any():
        return np.zeros(len(track))
    lasted = np.minimum(np.diff(time_s, prepend=time_s[0]), settings.SPEAKS_S)
    length = np.cumsum(np.where(again, np.linalg.norm(np.nan_to_num(value), axis=1) * lasted, 0.0))
    length = np.concatenate([[0.0], length])
    now, then = np.searchsorted(time_s, track.time_s, side="right"), np.searchsorted(time_s, fix_s, side="right")
    return np.asarray(length[now] - length[then])


def _slow(sensor: Sensor) -> list[float]:
    """Variance by axis of what the error states of a sensor begin with."""
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models]
    return [float(block.C @ block.P0 @ block.C) for block in blocks]


def _since_fix(track: Track, fixes: list[Residuals]) -> tuple[Array, Array]:
    """Age of the last fix that was used [s], and distance from there [m], at each row; the start counts as one."""
    times = np.unique(np.concatenate([track.time_s[:1], *(r.time_s[r.used] for r in fixes)]))
    last = np.maximum(_so_far(times, track.time_s) - 1, 0)
    north, east = track.local()[:, :2].T
    then = [np.interp(times, track.time_s, place)[last] for place in (north, east)]
    return track.time_s - times[last], np.hypot(north - then[0], east - then[1])


def _so_far(times: Array, now_s: Array) -> Ints:
    """How many of some times have come by each of many others; both in order."""
    first = np.searchsorted(now_s, times)
    return np.bincount(first, minlength=len(now_s) + 1)[: len(now_s)].cumsum()

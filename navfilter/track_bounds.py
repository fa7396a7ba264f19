"""The bounds of `navfilter.filter.integrity` along a track, from its covariance and what became of the readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.chi_square import chi_square_limit
from navfilter.filter.integrity import CONFIRMED_S, bounds, whole_offset
from navfilter.filter.offsets import has_offset
from navfilter.filter.tape import OUTCOMES, Residuals

if TYPE_CHECKING:
    from navfilter.sensors import Sensor
    from navfilter.track import Track

__all__ = ["bounds_along"]

Array = NDArray[np.float64]


def bounds_along(track: Track) -> Array:
    """Protection radius [m] and bound of the heading [rad] at each row of a forward track, shape (n, 2).

    Parameters
    ----------
    track : Track
        As the filter gave it out; a smoothed one knows more than these bounds are about.
    """
    off: dict[str, Array] = {}
    fixes = []
    slow = np.zeros(len(track))
    for name in track.residuals:
        sensor, known = track.vehicle.sensors[name], _off(track, name)
        sees = sensor.corrects
        off[sees] = np.maximum(off.get(sees, 0.0), known)
        slow = np.maximum(slow, np.where(known > 0.0, max(_slow(sensor)), 0.0)) if sees == "heading" else slow
        fixes += [track.residuals[name]] if sees == "position" else []
    away = _since_fix(track, fixes)
    return np.column_stack(bounds(track.covariance, *away, off, track.vehicle.drive.inertial, slow))


def _off(track: Track, name: str) -> Array:
    """What a sensor may be off by at each row; 0 where it has not been heard, or has been found to be off."""
    r, sensor = track.residuals[name], track.vehicle.sensors[name]
    used = r.outcome == OUTCOMES.index("used")
    judged = used | (r.outcome == OUTCOMES.index("rejected"))
    if not judged.any() or not sensor.corrects:
        return np.zeros(len(track))
    time_s, refused, sd = r.time_s[judged], ~used[judged], r.sd[judged]
    # one that is refused alone is an outlier, unless the sensor has confirmed nothing yet
    first_s = r.time_s[used][0] if used.any() else np.inf
    again = refused & (np.r_[False, refused[:-1]] | (time_s < first_s + CONFIRMED_S))
    slow = _slow(sensor)
    limit = float(chi_square_limit(sensor.gate_probability, sensor.axes))
    unseen = np.sqrt(limit * np.where(np.isnan(sd), 0.0, sd**2 + slow).max(axis=1))
    last = np.searchsorted(time_s, track.time_s, side="right") - 1
    off = np.where(again, whole_offset(sensor.corrects, r.value[judged], max(slow)), unseen)[last]
    off[last < 0] = 0.0
    history = track.error_models.get(name, [])
    for (begin_s, models), (end_s, _) in zip(history, [*history[1:], (np.inf, None)], strict=True):
        if has_offset(models):
            off[(track.time_s >= begin_s) & (track.time_s < end_s)] = 0.0
    return np.asarray(off)


def _slow(sensor: Sensor) -> list[float]:
    """Variance by axis of what the error states of a sensor begin with."""
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models]
    return [float(block.C @ block.P0 @ block.C) for block in blocks]


def _since_fix(track: Track, fixes: list[Residuals]) -> tuple[Array, Array]:
    """Age of the last fix that was used [s], and distance from there [m], at each row; the start counts as one."""
    times = np.unique(np.concatenate([track.time_s[:1], *(r.time_s[r.used] for r in fixes)]))
    last = times[np.maximum(np.searchsorted(times, track.time_s, side="right") - 1, 0)]
    place = track.local()[:, :2]
    then = np.column_stack([np.interp(last, track.time_s, place[:, k]) for k in range(2)])
    return track.time_s - last, np.hypot(*(place - then).T)

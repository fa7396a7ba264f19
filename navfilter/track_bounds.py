"""The bounds of `navfilter.filter.integrity` along a track, from its covariance and what became of the readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from navfilter.filter.condition import whole_offset
from navfilter.filter.integrity import CONFIRMED_S, Bounds, Fixed, Witness, bounds
from navfilter.filter.offsets import offset_states
from navfilter.filter.tape import OUTCOMES
from navfilter.sensors import Sensor

if TYPE_CHECKING:
    from navfilter.filter.tape import Residuals
    from navfilter.track import Track

__all__ = ["bounds_along"]

Array = NDArray[np.float64]
_SEEN = ("position", "velocity", "heading")


def bounds_along(track: Track) -> tuple[Bounds, ...]:
    """Protection radius and bound of the heading at each row of a forward track.

    Parameters
    ----------
    track : Track
        As the filter gave it out; a smoothed one knows more than these bounds are about.

    Returns
    -------
    tuple of Bounds
    """
    sensors = {name: s for name, s in track.vehicle.sensors.items() if s.corrects in _SEEN and name in track.residuals}
    off = {name: _off(track, name, sensor) for name, sensor in sensors.items()}
    age_s, moved_m = _since_fix(track, [name for name, sensor in sensors.items() if sensor.corrects == "position"])
    held = track.vehicle.drive.inertial
    return tuple(
        bounds(
            track.covariance[i],
            Fixed(float(age_s[i]), float(moved_m[i]), held),
            [Witness(sensors[name].corrects, float(values[i])) for name, values in off.items()],
        )
        for i in range(len(track))
    )


def _off(track: Track, name: str, sensor: Sensor) -> Array:
    """What a sensor may be off by at each row; 0 where it has not been heard, or has been found to be off."""
    r = track.residuals[name]
    judged = np.isin(r.outcome, [OUTCOMES.index("used"), OUTCOMES.index("rejected")])
    if not judged.any():
        return np.zeros(len(track))
    refused = (r.outcome == OUTCOMES.index("rejected"))[judged]
    # one that is refused alone is an outlier, unless the sensor has confirmed nothing yet
    again = refused & (np.r_[False, refused[:-1]] | (r.time_s[judged] - _first_used(r) < CONFIRMED_S))
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models]
    slow = np.array([float(block.C @ block.P0 @ block.C) for block in blocks])
    limit = chi2.ppf(sensor.gate_probability, sensor.axes)
    unseen = np.sqrt(limit * np.nanmax(np.where(np.isnan(r.sd[judged]), 0.0, r.sd[judged] ** 2 + slow), axis=1))
    contradicts = np.array([whole_offset(sensor, value) for value in r.value[judged]])
    last = np.searchsorted(r.time_s[judged], track.time_s, side="right") - 1
    off = np.where(last >= 0, np.where(again, contradicts, unseen)[last], 0.0)
    for time_s, models in track.error_models.get(name, ()):
        per_axis = models if isinstance(models, tuple) else (models,)
        after = track.time_s >= time_s
        off[after] = (
            0.0
            if offset_states(per_axis, 1.0).size
            else np.where(last >= 0, np.where(again, contradicts, unseen)[last], 0.0)[after]
        )
    return off


def _first_used(r: Residuals) -> float:
    return float(r.time_s[r.used][0]) if r.used.any() else np.inf


def _since_fix(track: Track, fixes: list[str]) -> tuple[Array, Array]:
    """Age of the last fix that was used [s], and distance from there [m], at each row; the start counts as one."""
    first = np.array([track.time_s[0]]) if len(track) else np.zeros(0)
    times = np.unique(np.concatenate([first, *(track.residuals[n].time_s[track.residuals[n].used] for n in fixes)]))
    last = times[np.maximum(np.searchsorted(times, track.time_s, side="right") - 1, 0)]
    place = track.local()[:, :2]
    then = np.column_stack([np.interp(last, track.time_s, place[:, k]) for k in range(2)])
    return track.time_s - last, np.hypot(*(place - then).T)

"""Along a track: for how long, and why, it is not to be trusted as it should be."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.arrays import Array, Mask
from navfilter.kernels.batch import NIS_MEMORY, NIS_MOST
from navfilter.models.during import same_sensor
from navfilter.models.fault_bias import has_offset
from navfilter.models.health import LOST_HEADING, LOST_VELOCITY, MARGIN, NOISY, silent_after_s
from navfilter.models.mission import Stream
from navfilter.models.sensors import Sensor
from navfilter.track.track import Track

#: Spells of one reason that are no farther apart than this are one [s].
TOGETHER_S = 2.0


@dataclass(frozen=True)
class DegradedInterval:
    """A time in which something speaks against the state.

    Attributes
    ----------
    begin_s, end_s : float
    level : str
        "degraded" or "lost", as `navfilter.models.health.Trust` has them.
    reason : str
    """

    begin_s: float
    end_s: float
    level: str
    reason: str

    def __str__(self) -> str:
        return f"{self.begin_s:.0f} to {self.end_s:.0f} s: {self.level}, {self.reason}"


def spells(track: Track) -> tuple[DegradedInterval, ...]:
    """What speaks against a run at which times, by what became of its readings; the earliest first.

    Parameters
    ----------
    track : Track
        A smoothed one is judged by its forward run.
    """
    run = track.forward or track
    found = [spell for level, reason, rows in _reasons(run) for spell in _runs(run, level, reason, rows)]
    ends = [*run.axes, (float(run.time_s[-1]), "", "")]
    for k, (begin_s, axis, condition) in enumerate(run.axes):
        if condition != "good":
            end_s = next(t for t, name, _ in ends[k + 1 :] if name in (axis, ""))
            found.append(DegradedInterval(begin_s, max(end_s, begin_s), "degraded", f"{axis} is {condition}"))
    return tuple(sorted(found, key=lambda spell: (spell.begin_s, spell.end_s)))


def integrity_figures(track: Track, truth: Stream | None) -> dict[str, Any] | None:
    """Bounds and trust of a forward run in figures, for ``summary.json``; None where there are no bounds.

    Parameters
    ----------
    track : Track
    truth : Stream, optional
        For the share of the time in which it lay within both bounds.
    """
    if track.bounds is None or not len(track):
        return None
    radius, heading = track.bounds[:, 0], np.degrees(track.bounds[:, 1])
    finite = radius[np.isfinite(radius)]
    inside = None
    if truth is not None and len(truth):
        errors = track.errors(truth)
        beyond = (errors.horizontal > radius) | (np.abs(errors.attitude[:, 2]) > track.bounds[:, 1])
        known = np.isfinite(errors.horizontal)
        inside = float(1.0 - beyond[known].mean()) if known.any() else None
    found = spells(track)
    lost = _length(track, [s for s in found if s.level == "lost"])
    return {
        "protection_radius_max_m": float(finite.max()) if finite.size else None,
        "protection_radius_end_m": float(radius[-1]),
        "without_bound": float(np.mean(~np.isfinite(radius))),
        "heading_bound_max_deg": float(heading.max()),
        "truth_inside": inside,
        "degraded_s": _length(track, list(found)) - lost,
        "lost_s": lost,
        "spells": [vars(spell) for spell in found],
    }


def _length(track: Track, found: list[DegradedInterval]) -> float:
    """Time of a run in which there is any of these spells [s]."""
    within = np.zeros(len(track), bool)
    for spell in found:
        within |= (track.time_s >= spell.begin_s) & (track.time_s < spell.end_s)
    return float(np.diff(track.time_s, append=track.time_s[-1])[within].sum())


def _runs(run: Track, level: str, reason: str, rows: Mask) -> Iterator[DegradedInterval]:
    """The stretches of a mask over the rows of a track."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(int)))
    last: DegradedInterval | None = None
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        spell = DegradedInterval(float(run.time_s[begin]), float(run.time_s[min(end, len(run) - 1)]), level, reason)
        if last is not None and spell.begin_s - last.end_s <= TOGETHER_S:
            spell = DegradedInterval(last.begin_s, spell.end_s, level, reason)
        elif last is not None:
            yield last
        last = spell
    if last is not None:
        yield last


def _reasons(run: Track) -> Iterator[tuple[str, str, Mask]]:
    """What may be wrong, and at which rows it is."""
    P, most = run.covariance, run.vehicle.drive.max_speed_m_s
    velocity_sd = np.sqrt(P[:, range(3, 6), range(3, 6)].max(axis=1))
    yield "lost", f"the velocity is known to no better than {LOST_VELOCITY:g} m/s", ~(velocity_sd <= LOST_VELOCITY)
    heading = f"the heading is known to no better than {math.degrees(LOST_HEADING):.0f} deg"
    yield "lost", heading, ~(np.sqrt(P[:, 8, 8]) <= LOST_HEADING)
    if most is not None:
        speed = np.linalg.norm(run.velocity_n, axis=1)
        yield "lost", f"faster than the vehicle can be ({most:g} m/s)", speed > MARGIN * most
    for name, sensor in run.vehicle.sensors.items():
        if name in run.residuals and len(run.residuals[name].time_s):
            conditions = _conditions(run, name, sensor)
            # fixes are not there under water: what that costs is in the bounds
            calm = "silent" if sensor.observes.corrects == "position" else ""
            yield from (("degraded", f"{name} is {what}", rows) for what, rows in conditions if what != calm)


def _heard_s(r: Residuals) -> Array:
    """When a sensor was heard [s]."""
    heard = ~np.isin(r.outcome, [OUTCOMES.index("ahead"), OUTCOMES.index("invalid")])
    return np.maximum.accumulate(r.time_s[heard])


def _conditions(run: Track, name: str, sensor: Sensor) -> Iterator[tuple[str, Mask]]:
    """The conditions of a sensor, each with the rows at which it is in it, as
    `navfilter.faults.sensor_monitor.SensorMonitor` has them.

    That its value does not change shows as its readings being rejected.
    """
    r, now = run.residuals[name], run.time_s
    names = same_sensor(name, run.residuals)
    others = [run.residuals[each] for each in names if each != name]
    times_heard = np.sort(np.concatenate([_heard_s(each) for each in (r, *others)]))
    first = r.time_s[0]

    def age(times: Array) -> Array:
        last = np.searchsorted(times, now, side="right") - 1
        return np.where(last >= 0, now - times[last], np.inf) if times.size else np.full(len(now), np.inf)

    limit_s = silent_after_s(sensor.gate_timeout_s, sensor.rate_hz)
    waiting, silent = now < first, age(_heard_s(r)) > limit_s
    old = age(np.maximum.accumulate(r.time_s[r.used])) > sensor.gate_timeout_s
    if names:
        yield "silent", (age(times_heard) > limit_s) & ~waiting
    left = ~silent & ~waiting
    yield "rejected", left & old
    left &= ~old
    jumped = np.zeros(len(now), bool)
    history = run.error_models.get(name, [])
    for (begin_s, models), (end_s, _) in zip(history, [*history[1:], (np.inf, None)], strict=True):
        if has_offset(models):
            jumped |= (now >= begin_s) & (now < end_s)
    yield "jumped", left & jumped
    judged = (r.dof > 0) & np.isfinite(r.nis)
    if judged.any():
        share = np.minimum(r.nis[judged] / r.dof[judged], NIS_MOST)
        mean = np.empty_like(share)
        so_far = 1.0
        for k, value in enumerate(share.tolist()):
            so_far += (value - so_far) / NIS_MEMORY
            mean[k] = so_far
        last = np.searchsorted(r.time_s[judged], now, side="right") - 1
        yield "noisy", left & ~jumped & (last >= 0) & (mean[last] > NOISY)

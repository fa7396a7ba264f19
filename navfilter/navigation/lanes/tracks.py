"""The tracks of a vehicle with lanes: forward that of the lane in force, smoothed along what the last one came from."""

from __future__ import annotations

import bisect
import dataclasses
import math
import time
from typing import Any

import numpy as np

from navfilter.filter.records import Residuals, Tape
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.vehicle import DEAD_RECKONING, Vehicle
from navfilter.navigation.lanes.replay import LaneReplay, piece_at, smoothable
from navfilter.navigation.track_assembly import assembled, bar, gathered, smoothed_track
from navfilter.navigation.track_bounds import bounds_along
from navfilter.track.track import Track

#: A tape, and the time [s] behind which and up to which it counts.
Stretch = tuple[Tape, float, float]


def replayed_lanes(
    vehicle: Vehicle, mission: Mission, start: Start, output_rate_hz: float | None, *, smooth: bool, progress: bool
) -> Track:
    """Replay a mission by all lanes of a vehicle, see `navfilter.replay`.

    Returns
    -------
    Track
        Forward: at each time the lane that was in force then. Smoothed: the lane that was in force last, before it
        began anew the one that it began from, and so on to the start: one run, in which a lane that went wrong has no
        part.
    """
    began = time.process_time()
    run = LaneReplay(vehicle, mission, start, output_rate_hz, smooth)
    shown = bar(run.readings, "filter", progress)
    run.run(None if shown is None else shown.update)
    if shown is not None:
        shown.close()
    track = _forward(run, mission, began)
    if not smooth:
        return track
    nav = run.believed.nav
    nav.filter.tape = smoothable(run.believed.pieces[-1])
    smoothed = smoothed_track(track, nav, began, progress)
    return dataclasses.replace(
        smoothed,
        vehicle=vehicle,
        error_models=track.error_models,
        counts=track.counts,
        epoch_utc_s=mission.epoch_utc_s,
        lanes=track.lanes,
        lane_history=track.lane_history,
    )


def _forward(run: LaneReplay, mission: Mission, began: float) -> Track:
    """The track as it was given out: of the lane in force."""
    lanes = {lane.name: lane for lane in run.lanes}
    ends = [*(time_s for time_s, _ in run.changes[1:]), math.inf]
    stretches = [
        (piece_at(lanes[name].pieces, begin_s).tape, begin_s, end_s)
        for (begin_s, name), end_s in zip(run.changes, ends, strict=True)
    ]
    parts = [part for stretch in stretches for part in _rows(stretch)]
    rows = gathered(parts)
    track = assembled("forward", run.believed.nav, rows, mission.name, time.process_time() - began)
    sensors = run.vehicle.sensors
    models: dict[str, list[tuple[float, Any]]] = {}
    for tape, begin_s, end_s in stretches:
        for key, history in tape.first_models().items():
            there = [model for time_s, model in history if time_s <= begin_s][-1:] or [history[0][1]]
            before = models.setdefault(key, [])
            before += [(max(begin_s, run.start.time_s), m) for m in there if not before or before[-1][1] != m]
            before += [(time_s, model) for time_s, model in history if max(begin_s, history[0][0]) < time_s <= end_s]
    track = dataclasses.replace(
        track,
        vehicle=run.vehicle,
        residuals={name: _residuals(name, stretches) for name in track.residuals if name in sensors},
        error_models={name: found for name, found in models.items() if name in sensors or name in ("gyro", "accel")},
        epoch_utc_s=mission.epoch_utc_s,
        lanes=tuple((max(time_s, run.start.time_s), name) for time_s, name in run.changes),
        lane_history=run.history,
    )
    bounds = bounds_along(track, rows.unnoticed)
    for (begin_s, name), end_s in zip(run.changes, ends, strict=True):
        if name == DEAD_RECKONING:  # nothing holds it against its velocity
            bounds[(track.time_s > begin_s) & (track.time_s <= end_s), 0] = math.inf
    return dataclasses.replace(track, bounds=bounds)


def _rows(stretch: Stretch) -> list[tuple[Tape, range]]:
    """Where the rows stand that were first given out in a stretch."""
    whole, begin_s, end_s = stretch
    parts = []
    for tape, rows in whole.first_rows():
        times = tape.row_times[rows.start : rows.stop]
        first, last = bisect.bisect_right(times, begin_s), bisect.bisect_right(times, end_s)
        if first < last:
            parts.append((tape, range(rows.start + first, rows.start + last)))
    return parts


def _residuals(name: str, stretches: list[Stretch]) -> Residuals:
    """Residuals of a sensor, each of the lane that was in force."""
    found = []
    for tape, begin_s, end_s in stretches:
        whole = tape.first_residuals()[name]
        mine = (whole.time_s > begin_s) & (whole.time_s <= end_s)
        found.append([getattr(whole, key.name)[mine] for key in dataclasses.fields(Residuals)])
    return Residuals(*(np.concatenate(values) for values in zip(*found, strict=True)))

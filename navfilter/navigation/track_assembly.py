"""From what a run has written down to its tracks: as first given out, run again, and smoothed."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from navfilter.filter.records import Tape
from navfilter.filter.rts_smoother import smooth_rows
from navfilter.foundation.arrays import Array, Ints
from navfilter.models.parameters import constant_parameters
from navfilter.models.state import euler_from_matrix, rotation_matrix
from navfilter.navigation.navigator import Navigator
from navfilter.navigation.track_bounds import bounds_along
from navfilter.track.track import Track

#: So many rows are corrected at a time: what is needed for that on the way is to be small beside a track.
PIECE = 8192
#: Rows and columns of the covariance of navigation.
NAVIGATION = np.indices((9, 9))


class _Rows:
    """Arrays of a track while its rows are gathered: states that do not exist at a time are NaN."""

    def __init__(self, parts: Sequence[tuple[Tape, range]]) -> None:
        n = sum(len(rows) for _, rows in parts)
        units: dict[str, str] = {}
        for tape, _ in parts:
            for layout in tape.layouts:
                units |= dict(zip(layout.names, layout.units, strict=True))
        order = {name: i for i, name in enumerate(units)}
        groups = [*parts[-1][0].layouts[-1].groups]
        self.names = tuple(sorted(units, key=lambda name: (_group(name, groups), order[name])))
        self.units = tuple(units[name] for name in self.names)
        self.at = {name: i for i, name in enumerate(self.names)}
        self.time_s = np.concatenate([np.array(tape.row_times)[rows.start : rows.stop] for tape, rows in parts])
        self.packed, self.P = np.empty((n, 17)), np.empty((n, 9, 9))
        unnoticed = [np.array(tape.row_unnoticed).reshape(-1, 2)[rows.start : rows.stop] for tape, rows in parts]
        self.unnoticed = np.concatenate(unnoticed)
        self.x, self.variance = np.empty((n, len(units))), np.empty((n, len(units)))
        if any(len(tape.layouts) > 1 for tape, _ in parts) or len(parts) > 1:
            self.x[:], self.variance[:] = np.nan, np.nan

    def places(self, tape: Tape) -> list[Ints]:
        """Columns of the states of each layout of a tape."""
        return [np.array([self.at[name] for name in layout.names], dtype=int) for layout in tape.layouts]

    def stay(self, places: Ints, state: Array, P: Array, variance: Array) -> bool:
        """Leave all rows where they stand, as views, if they are of one layout whose states are in this order."""
        alike = len(state) == len(self.time_s) and np.array_equal(places, np.arange(len(self.names)))
        if alike:
            self.packed, self.P, self.x, self.variance = state[:, :17], P, state[:, 17:], variance.copy()
        return alike

    def put(
        self, begin: int, places: Ints, state: Array, P: Array, variance: Array, correction: Array | float = 0.0
    ) -> None:
        """Some rows from that number on: nominal and error states (q, 17 + k), covariances (q, 9, 9), variances (q, k),
        and what is to be added to the k error states.
        """
        here = slice(begin, begin + len(state))
        self.packed[here], self.P[here] = state[:, :17], P
        self.x[here, places], self.variance[here, places] = state[:, 17:] + correction, variance


def _group(name: str, groups: list[str]) -> int:
    """Place of a state's sensor in the vehicle; -1 for the drive's."""
    return next((i for i, group in enumerate(groups) if name.startswith((f"{group}_", f"{group}[", f"{group}."))), -1)


def forward_track(nav: Navigator, name: str, cpu_s: float) -> Track:
    """The track as first given out, with what was made of it later where something was run again."""
    tape = _tape(nav)
    rows = gathered(tape.first_rows())
    first = assembled("forward", nav, rows, name, cpu_s)
    if tape.given is None:
        return dataclasses.replace(first, bounds=bounds_along(first, rows.unnoticed))
    revised = assembled("revised", nav, gathered([(tape, range(len(tape.row_times)))]), name, cpu_s)
    residuals, models = tape.first_residuals(), tape.first_models()
    first = dataclasses.replace(first, residuals=residuals, error_models=models, revised=revised)
    return dataclasses.replace(first, bounds=bounds_along(first, rows.unnoticed))


def gathered(parts: Sequence[tuple[Tape, range]]) -> _Rows:
    """Rows of several tapes, one behind the other."""
    rows, done = _Rows(parts), 0
    for tape, those in parts:
        places, layouts, last = rows.places(tape), np.array(tape.row_layouts), those.stop
        while last > those.start:
            number = layouts[last - 1]
            same = int(np.searchsorted(layouts, number))
            flat, begins = tape.rows.run(max(those.start, same), last)
            k = len(places[number])
            n, upto = k + 9, 17 + k
            # vectors of one size stand one behind the other
            size = upto + (n * (n + 1) // 2 if tape.smoothable else 81 + k)
            noted = flat[begins[0] :][: len(begins) * size].reshape(-1, size)
            last -= len(begins)
            if tape.smoothable:
                i, j = np.maximum(*NAVIGATION), np.minimum(*NAVIGATION)
                diagonal = np.arange(9, n)
                covariance = noted[:, upto + i * (i + 1) // 2 + j]
                variance = noted[:, upto + diagonal * (diagonal + 3) // 2]
            else:
                covariance, variance = noted[:, upto : upto + 81].reshape(-1, 9, 9), noted[:, upto + 81 :]
                if rows.stay(places[number], noted[:, :upto], covariance, variance):
                    break
            rows.put(done + last - those.start, places[number], noted[:, :upto], covariance, variance)
        done += len(those)
    return rows


def assembled(label: str, nav: Navigator, rows: _Rows, name: str, cpu_s: float, forward: Track | None = None) -> Track:
    """A track of rows; the rest is that of the run, or of the forward track."""
    tape, packed = _tape(nav), rows.packed
    return Track(
        label=label,
        vehicle=nav.vehicle,
        mission_name=name,
        time_s=rows.time_s,
        latitude=packed[:, 0],
        longitude=packed[:, 1],
        height=packed[:, 2],
        velocity_n=packed[:, 3:6],
        attitude=euler_from_matrix(packed[:, 6:15].reshape(-1, 3, 3)),
        covariance=rows.P,
        states=rows.x,
        states_sd=np.sqrt(np.maximum(rows.variance, 0.0, out=rows.variance), out=rows.variance),
        state_names=rows.names,
        state_units=rows.units,
        # the smoother's are those of the run that it smooths
        residuals=tape.residuals() if forward is None else (forward.revised or forward).residuals,
        error_models=tape.models,
        counts=dict(nav.counts),
        axes=tuple(tape.first_axes()),
        cpu_s=cpu_s,
        forward=forward,
    )


def smoothed_track(forward: Track, nav: Navigator, began: float, progress: bool) -> Track:
    """The smoother's track; the run began at this processor time [s]."""
    tape = _tape(nav)
    rows = _Rows([(tape, range(len(tape.row_times)))])
    places, correction, inertial = rows.places(tape), np.empty((len(tape.row_times), 9)), nav.vehicle.drive.inertial
    steps = np.empty((len(correction), 2, 6 if inertial else 3))

    def store(begin: int, state: Array, mean: Array, covariance: Array, step: Array) -> None:
        here = slice(begin, begin + len(state))
        correction[here], steps[here] = mean[:, :9], step
        columns, variance = places[tape.row_layouts[begin]], np.diagonal(covariance, axis1=1, axis2=2)[:, 9:]
        rows.put(begin, columns, state, covariance[:, :9, :9], variance, mean[:, 9:])

    shown = bar(len(tape.records), "smoother", progress)
    smooth_rows(tape, store, None if shown is None else shown.update, inertial)
    if shown is not None:
        shown.close()
    for begin in range(0, len(correction), PIECE):
        packed, moved = rows.packed[begin : begin + PIECE], correction[begin : begin + PIECE]
        packed[:, 6:15] = (rotation_matrix(moved[:, 6:]) @ packed[:, 6:15].reshape(-1, 3, 3)).reshape(-1, 9)
        packed[:, 0] += moved[:, 0] / packed[:, 15]
        packed[:, 1] += moved[:, 1] / (packed[:, 16] * np.cos(packed[:, 0]))
        packed[:, 2] -= moved[:, 2]
        packed[:, 3:6] += moved[:, 3:6]
    drive = nav.vehicle.drive
    own = drive.parameters() if drive.inertial else ()
    constants = {parameter.name for parameter in constant_parameters(own, drive.wandering())}
    for name, sensor in nav.vehicle.sensors.items():
        held = sensor.parameters()[slice(*sensor.held())] if sensor.hidden else ()
        constants |= {f"{name}.{parameter.name}" for parameter in held}
    for i, name in enumerate(rows.names):
        if ".lever_arm_" in name or name in constants:
            # what has not told of it makes it walk there, see `consistency.consider`: of a constant the end says all
            rows.x[:, i], rows.variance[:, i] = rows.x[-1, i], rows.variance[-1, i]
    track = assembled("smoothed", nav, rows, forward.mission_name, time.process_time() - began, forward)
    return dataclasses.replace(track, drive_steps=steps)


def _tape(nav: Navigator) -> Tape:
    tape = nav.filter.tape
    assert tape is not None
    return tape


def bar(total: int, what: str, progress: bool) -> Any:
    """A progress bar on standard error; None where none is wanted."""
    if not progress:
        return None
    from tqdm import tqdm

    return tqdm(total=total, desc=what, unit="", leave=False, mininterval=0.2)

"""From what a run has written down to its tracks: as first given out, run again, and smoothed.

The bounds of `navfilter.faults.protection_level` along a track, from its covariance and its measurements.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from navfilter.faults import settings
from navfilter.faults.alternative_path import believable
from navfilter.faults.protection_level import bounds, whole_offset
from navfilter.filter.records import OUTCOMES, Residuals, Tape
from navfilter.filter.rts_smoother import smooth_rows
from navfilter.foundation.arrays import Array, Ints, Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.fault_bias import wanders
from navfilter.models.parameters import constant_parameters
from navfilter.models.sensors import Sensor
from navfilter.models.state import euler_from_matrix, rotation_matrix
from navfilter.navigation.navigator import Navigator
from navfilter.track.track import Track, with_offsets


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
    for begin_s, end_s in with_offsets(track, name):
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
    for begin_s, end_s in with_offsets(track, name, wanders):
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

    with bar(len(tape.records), "smoother", progress) as told:
        smooth_rows(tape, store, told, inertial)
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


@contextmanager
def bar(total: int, what: str, progress: bool) -> Iterator[Callable[[int], object] | None]:
    """A progress bar on standard error, as what it is told by; None where none is wanted."""
    if not progress:
        yield None
        return
    from tqdm import tqdm

    with tqdm(total=total, desc=what, unit="", leave=False, mininterval=0.2) as shown:
        yield shown.update

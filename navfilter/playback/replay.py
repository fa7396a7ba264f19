"""Replay: a loop over a mission through the vehicle's own `step` and `correct`.

Fixes that are kept from the filter, so that its track can be scored against them.

A mission run from its end to its beginning, independently of the run forward.
"""

import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.special import erfc, gammaincc

from navfilter.faults.monitor import FaultMonitor
from navfilter.filter.records import OUTCOMES, Tape
from navfilter.foundation.arguments import needs, within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.learning.batch import change, learning_sensors, refitted
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.alignment import align
from navfilter.models.lane_missions import last_unit, of_one_unit
from navfilter.models.learned_arma import learning_part
from navfilter.models.magnetic import declination
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.sensors import Sensor
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler, wrap
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.lanes.navigator import replayed_lanes
from navfilter.navigation.navigator import Navigator
from navfilter.navigation.recorded_inputs import MeasurementSequence, drive_samples, readings_of
from navfilter.navigation.runner import BatchRunner
from navfilter.navigation.track_assembly import bar, forward_track, smoothed_track
from navfilter.playback.instructions import instructed
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


__all__ = ["drive_samples"]

_Path = str | os.PathLike[str]
#: Models have settled when they change by less than so many of their own standard deviations.
SETTLED = 0.2
_ORDER = "It is replay(vehicle, mission)."


def replay(
    vehicle: Vehicle | _Path,
    mission: Mission | _Path,
    *,
    start: Start | None = None,
    smooth: bool = False,
    output_rate_hz: float | None = 5.0,
    progress: bool = False,
    iterate: int = 0,
) -> Track:
    """Run a recorded mission through the filter, and optionally the smoother.

    Parameters
    ----------
    vehicle : Vehicle or path-like
        Or the vehicle.toml, or the folder that holds it.
    mission : Mission or path-like
        With a stream for the drive ("imu", or "attitude" and "velocity") and one per sensor of the vehicle; or what
        `navfilter.read_mission` reads: a folder, a .toml or a .npz.
    start : Start, optional
        Default: the mission's own start, else an alignment on its first readings.
    smooth : bool
        Return the smoothed track (its `forward` is the filter's).
    output_rate_hz : float or None
        At most so many rows per second in the track, each at a reading or at a fold of the covariance (one a second);
        infinite: at all of them. None: at every sample of the drive, too, what `Navigator.state` gives there; smoothed,
        as infinite.
    progress : bool
        Show a progress bar on standard error.
    iterate : int
        Identify on the whole mission first, see `identified`, in at most so many rounds. The models then are in force
        from the start, and frozen. 0: the models are learnt under way, from what came before, as on the vehicle.

    Returns
    -------
    Track

    Raises
    ------
    ValueError
        When a stream is missing, empty, or the mission holds nothing after the start, for `iterate` where no sensor
        learns, and for a path that cannot be read.
    """
    vehicle, mission = instructed(*_read(vehicle, mission))
    needs("replay: start", start, Start, type(None))
    if iterate:
        start = _start(vehicle, mission, start)
        vehicle = identified(vehicle, mission, iterate, start)
    start = _start(vehicle, mission, start)
    if vehicle.lanes():
        return replayed_lanes(vehicle, mission, start, output_rate_hz, smooth=smooth, progress=progress)
    return _replayed(vehicle, mission, start, Tape(output_rate_hz, smoothable=smooth), progress, ())[0]


def replay_monitored(
    vehicle: Vehicle,
    mission: Mission,
    monitor: FaultMonitor,
    *,
    start: Start | None = None,
    smooth: bool = False,
    output_rate_hz: float | None = 5.0,
    progress: bool = False,
) -> Track:
    """A replay with another monitor than the usual one, such as `navfilter.evaluation.baselines.adaptive_monitor`.

    Parameters
    ----------
    vehicle : Vehicle
        Without lanes.
    mission : Mission
    monitor : FaultMonitor
        Made for this run.
    start, smooth, output_rate_hz, progress
        As in `replay`.
    """
    if vehicle.lanes():
        raise ValueError("replay_monitored: this vehicle has lanes: give one of vehicle.lanes().")
    tape = Tape(output_rate_hz, smoothable=smooth)
    return _replayed(vehicle, mission, _start(vehicle, mission, start), tape, progress, (), monitor)[0]


def replay_heard(
    vehicle: Vehicle,
    mission: Mission,
    sensors: Sequence[str],
    *,
    start: Start | None = None,
    smooth: bool = False,
    output_rate_hz: float | None = 5.0,
) -> tuple[Track, dict[str, tuple[ChannelSeries, ...]]]:
    """A replay and, from the same run, the open-loop residuals of some of its sensors.

    Parameters
    ----------
    vehicle : Vehicle
        That does not learn: what it listened to would be in the way.
    mission : Mission
    sensors : sequence of str
    start, smooth, output_rate_hz
        As in `replay`.

    Returns
    -------
    track : Track
    series : dict of str to tuple of ChannelSeries
        As `residual_series` gives them.

    Raises
    ------
    ValueError
        As `replay`, and for a vehicle that learns.
    """
    if learns(vehicle):
        raise ValueError("this vehicle learns: replay it, and take the residuals by residual_series.")
    start = _start(vehicle, mission, start)
    if vehicle.lanes():
        track = replayed_lanes(vehicle, mission, start, output_rate_hz, smooth=smooth, progress=False)
        return track, residual_series(vehicle, mission, sensors, start) if sensors else {}
    track, nav = _replayed(vehicle, mission, start, Tape(output_rate_hz, smoothable=smooth), False, sensors)
    return track, {name: nav.residuals(name) for name in sensors}


def _replayed(
    vehicle: Vehicle,
    mission: Mission,
    start: Start,
    tape: Tape,
    progress: bool,
    heard: Sequence[str],
    monitor: FaultMonitor | None = None,
) -> tuple[Track, Navigator]:
    drive = drive_samples(vehicle, mission)
    began = time.process_time()
    readings = readings_of(vehicle, mission, start.time_s)
    span_s = max(drive[0][-1], readings.time_s.max(initial=start.time_s)) - start.time_s
    tape.expect(2 + int(min(len(drive[0]) + len(readings.time_s), span_s / (tape.interval_s or 1e-300))))
    nav = Navigator(vehicle, start, tape, monitor=monitor)
    _listen(nav, mission, heard)
    _run(nav, *drive, readings, progress)
    del readings  # of a day 45 MB, beside what the smoother needs
    track = forward_track(nav, mission.name, time.process_time() - began)
    _check_covariance(track)
    revised = None if track.revised is None else replace(track.revised, epoch_utc_s=mission.epoch_utc_s)
    track = replace(track, epoch_utc_s=mission.epoch_utc_s, revised=revised)
    if tape.smoothable:
        tape.columns.clear()  # they stand in the track now: of a day 70 MB
        track = replace(smoothed_track(track, nav, began, progress), epoch_utc_s=mission.epoch_utc_s)
    tape.begin(nav.filter.layout)  # its memory is there for the next run
    return track, nav


def _check_covariance(track: Track) -> None:
    """Raise where the variances of the track are those of no state."""
    variances = np.diagonal(track.covariance, axis1=1, axis2=2)
    wrong = np.flatnonzero(~(np.all(variances >= 0.0, axis=1) & np.isfinite(track.covariance).all(axis=(1, 2))))
    if wrong.size:
        raise ValueError(
            f"replay: from {track.time_s[wrong[0]]:.3f} s on the covariance is that of no state any more. Look at what"
            " was read there; where a sensor's error is described by a slow part alone, give it white noise, too."
        )


def _read(vehicle: Vehicle | _Path, mission: Mission | _Path) -> tuple[Vehicle, Mission]:
    needs("replay: vehicle", vehicle, Vehicle, os.PathLike, str, hint=_ORDER)
    needs("replay: mission", mission, Mission, os.PathLike, str, hint=_ORDER)
    if not isinstance(vehicle, Vehicle):
        from navfilter.io import read_vehicle

        vehicle = read_vehicle(vehicle)
    if not isinstance(mission, Mission):
        from navfilter.io import read_mission

        mission = read_mission(mission)
    return vehicle, mission


def identified(
    vehicle: Vehicle,
    mission: Mission,
    rounds: int = 5,
    start: Start | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Vehicle:
    """Error models identified on a whole mission: replay, fit every `LearnedArma` to all that was heard, replay with
    the fits, fit again.

    Ends when the models have settled: the spectrum of every axis changes by less than `SETTLED` of its own standard
    deviation.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
    rounds : int
        At most.
    start : Start, optional
        As in `replay`.
    report : callable, optional
        Called after each round with its number and the change since the round before
        (`navfilter.learning.batch.change`; infinite in the first).

    Returns
    -------
    Vehicle
        With the models in force and frozen; an axis whose series says too little goes on learning.

    Raises
    ------
    ValueError
        Where no sensor learns, and for less than one round.

    Notes
    -----
    What is fitted is the open-loop residual of `residual_series` beside the known noise of its drift, not the residual
    from the smoothed track. A smoother gives the slow part of a sensor's error to the state, more of it at every pass,
    so that models fitted to its residuals lose the low frequencies, and what is believed of them is what makes a filter
    overconfident. The open-loop residual holds the error whole whatever is believed of it, so that this settles after
    the second round, but for what gates and linearisation depend on.
    """
    names = learning_sensors(vehicle)
    if not names:
        raise ValueError(
            'no sensor of this vehicle learns its error: give one a LearnedArma (model = "learned-arma"), or do not '
            "iterate."
        )
    if int(rounds) != rounds or rounds < 1:
        raise ValueError(f"rounds must be a whole number of at least 1, found {rounds!r}.")
    start = _start(vehicle, mission, start)
    single, mission = _of_the_last_unit(vehicle, mission, start)
    now, apart = single, math.inf
    for number in range(1, int(rounds) + 1):
        before, now = now, refitted(single, residual_series(now, mission, names, start))
        apart = change(before, now)
        if report is not None:
            report(number, apart)
        if apart < SETTLED:
            break
    return vehicle.with_error(**{name: now.sensors[name].error for name in names})


def _of_the_last_unit(vehicle: Vehicle, mission: Mission, start: Start) -> tuple[Vehicle, Mission]:
    """A vehicle with lanes as if it had the unit alone that a replay has in force last; any other one as it is."""
    if not vehicle.lanes():
        return vehicle, mission
    lanes = replayed_lanes(vehicle, mission, start, 1.0, smooth=False, progress=False).lanes
    return of_one_unit(vehicle, mission, last_unit(vehicle, lanes))


def _start(vehicle: Vehicle, mission: Mission, start: Start | None) -> Start:
    if start is not None:
        return start
    if mission.start is not None:
        return mission.start
    return align(vehicle, mission)


def _run(nav: Navigator, times: Array, values: Array, events: MeasurementSequence, progress: bool) -> None:
    done = int(np.searchsorted(times, nav.start.time_s - 1e-9))
    if done >= len(times):
        raise ValueError(
            f"the drive's stream ends at {times[-1]:.3f} s, before the start at {nav.start.time_s:.3f} s. Check the "
            "clocks."
        )
    with bar(len(events.time_s), "filter", progress) as told:
        BatchRunner(nav, times, values, events, done).run(told)


def residual_series(
    vehicle: Vehicle, mission: Mission, sensors: Sequence[str] | None = None, start: Start | None = None
) -> dict[str, tuple[ChannelSeries, ...]]:
    """Open-loop residuals of the correcting sensors over a whole mission: what their error models are fitted to.

    Parameters
    ----------
    vehicle : Vehicle
        With lanes: as if it had that inertial unit only which a replay has in force last.
    mission : Mission
    sensors : sequence of str, optional
        Default: all that have readings of their own.
    start : Start, optional
        As in `replay`.

    Returns
    -------
    dict of str to tuple of ChannelSeries
        One series per axis: readings minus the prediction of an open loop, with the known noise of what else is in
        them.
    """
    start = _start(vehicle, mission, start)
    vehicle, mission = _of_the_last_unit(vehicle, mission, start)
    names = [name for name, sensor in vehicle.sensors.items() if sensor.open_loop] if sensors is None else list(sensors)
    nav = at_the_end(vehicle, mission, start, names)
    return {name: nav.residuals(name) for name in names}


def at_the_end(vehicle: Vehicle, mission: Mission, start: Start | None = None, heard: Sequence[str] = ()) -> Navigator:
    """The navigator at the end of a mission: its constant states are then what a smoother gives for all of it.

    Parameters
    ----------
    vehicle : Vehicle
        Without lanes, see `navfilter.models.lane_missions.of_one_unit`.
    mission : Mission
    start : Start, optional
        As in `replay`.
    heard : sequence of str
        Sensors whose open-loop residuals it keeps.
    """
    drive = drive_samples(vehicle, mission)
    start = _start(vehicle, mission, start)
    # nothing is late: the same filter, without the history that lets late readings in
    nav = Navigator(vehicle, start, history_s=0.0, threads=False)
    _listen(nav, mission, heard)
    _run(nav, *drive, readings_of(vehicle, mission, start.time_s), False)
    return nav


def _listen(nav: Navigator, mission: Mission, names: Sequence[str]) -> None:
    """To these sensors over a whole mission."""
    for name in names:
        span = mission.duration_s + 2.0 * nav.filter.AHEAD_S
        nav.record_residuals(name, max(1, int(span * nav.vehicle.sensors[name].rate_hz * 1.2) + 16))


def learns(vehicle: Vehicle) -> bool:
    """Whether the error of the drive or of any sensor is learnt."""
    models = (*vehicle.drive.models, *(model for sensor in vehicle.sensors.values() for model in sensor.models))
    return any(learning_part(model) is not None for model in models)


#: What becomes of the columns of a stream: a factor, or a function.
_Change = float | Callable[[Array], Array]
_MINUS = -1.0


def _turned(angle: Array) -> Array:
    """Of a direction in the plane [rad]."""
    return np.asarray(np.pi - angle)


#: Columns that change their sign or direction; all others stay. The mirror stands in a meridian plane: east is west.
#: The body's own x axis is taken the other way round, so that a vehicle that runs backwards in time moves forwards.
_COLUMNS: dict[str, _Change] = {
    **dict.fromkeys(("rate_x_rad_s", "rotation_x_rad", "force_x_m_s2", "velocity_gain_x_m_s", "field_x_T"), _MINUS),
    **dict.fromkeys(("v_y_m_s", "v_z_m_s", "v_north_m_s", "v_down_m_s", "longitude_rad", "pitch_rad"), _MINUS),
    **{f"{track}_{i}_m_s": _MINUS for track in ("beam", "water") for i in range(1, 5)},
    **dict.fromkeys(("heading_rad", "yaw_rad", "course_rad"), _turned),
}
#: Constants that a calibration found, by the end of their names: those that change their sign.
_CONSTANTS: tuple[str, ...] = ("lever_arm_x", "time_offset", "bias", "temperature", "one_cycle_sin", "two_cycle_cos")
_CONSTANTS += ("current_north", "hard_iron_x", "soft_iron_xy", "soft_iron_xz", "_east")
_CONSTANTS += tuple(f"misalignment_{axes}" for axes in ("y", "z", "xy", "xz", "yx", "zx"))
#: Sensors whose geometry has no mirror here.
_WITHOUT = ("Usbl",)


@dataclass(frozen=True, eq=False)
class Apart:
    """A forward run and one backward, independent of it.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Where both are [s].
    north_m, east_m, down_m : ndarray, shape (n,)
        Forward minus backward [m].
    heading_rad : ndarray, shape (n,)
    sd : ndarray, shape (n, 4)
        Of these four, as both runs predict [m], [rad].
    smoothed_sd : ndarray, shape (n, 4), or None
        Of the smoothed track.
    nis : float
        Mean square of the horizontal distance in units of what is predicted, per component: 1 is honest.
    chance : float
        Bound of the probability of one so large.
    own_start : bool
        Whether the run backward found a start of its own; if not it began where the other ends.
    """

    time_s: Array
    north_m: Array
    east_m: Array
    down_m: Array
    heading_rad: Array
    sd: Array
    smoothed_sd: Array | None
    nis: float
    chance: float
    own_start: bool

    @property
    def horizontal_m(self) -> Array:
        """Horizontal distance [m], shape (n,)."""
        return np.hypot(self.north_m, self.east_m)

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        worst = int(np.argmax(self.horizontal_m))
        figures = {
            "rms_m": math.sqrt(np.mean(self.horizontal_m**2)),
            "predicted_m": math.sqrt(np.mean(self.sd[:, 0] ** 2 + self.sd[:, 1] ** 2)),
            "most_m": float(self.horizontal_m[worst]),
            "most_s": float(self.time_s[worst]),
            "heading_rms_deg": math.degrees(math.sqrt(np.mean(self.heading_rad**2))),
        }
        return {**figures, "nis": self.nis, "chance": self.chance, "own_start": self.own_start}

    def __str__(self) -> str:
        f = self.to_dict()
        own = "" if self.own_start else "; it began where the forward one ends, and says little there"
        return (
            f"forward and backward run, independent of each other, differ by {f['rms_m']:.2f} m rms (predicted "
            f"{f['predicted_m']:.2f} m), {f['most_m']:.2f} m at most (at {f['most_s']:.0f} s), heading "
            f"{f['heading_rms_deg']:.2f} deg rms{own}"
        )


def backward(vehicle: Vehicle, mission: Mission, forward: Track, *, output_rate_hz: float | None = 5.0) -> Track:
    """Run a mission from its end to its beginning.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
    forward : Track
        Of the run the other way: only its end is used, where the mission's own readings tell no start there.
    output_rate_hz : float or None
        As for `navfilter.replay`.

    Returns
    -------
    Track
        Its times rise; states and residuals are left out. "backward", or "backward from the forward end".

    Raises
    ------
    ValueError
        For a sensor whose mirror image is not known, and as `navfilter.replay`.

    Notes
    -----
    In a mirror of east and west a vehicle whose time runs backwards obeys the same laws: both turn the Earth's rotation
    round, so that Coriolis forces and the Earth's rate stay what they are. The filter therefore runs as it is, on the
    mirror image of the mission and of the vehicle; Gaussian errors have the same statistics in both directions.
    """
    run = forward.forward or forward
    if vehicle.lanes():
        vehicle, mission = of_one_unit(vehicle, mission, last_unit(vehicle, run.lanes))
    there, seen = mirrored(vehicle, mission, _first(run, mission))
    label, start = "backward", None
    try:
        start = align(there, seen)
    except ValueError:
        label, start = "backward from the forward end", _from_the_end(run, seen)
    return replace(_back(replay(there, seen, start=start, output_rate_hz=output_rate_hz)), label=label, vehicle=vehicle)


def mirrored(vehicle: Vehicle, mission: Mission, start: Start) -> tuple[Vehicle, Mission]:
    """Vehicle and mission in a mirror of east and west, with time running backwards.

    Parameters
    ----------
    vehicle : Vehicle
        Without lanes.
    mission : Mission
    start : Start
        For the declination.

    Raises
    ------
    ValueError
        For a sensor whose mirror image is not known.
    """
    vehicle = vehicle.at(start)
    sensors = {name: _mirrored(name, sensor, start) for name, sensor in vehicle.sensors.items()}
    drive = _mirrored("what drives", vehicle.drive, start)
    columns: dict[str, tuple[str, ...]] = dict(vehicle.drive.stream_columns())
    columns |= {name: s.stream_columns() for name, s in vehicle.sensors.items() if not s.from_drive}
    streams = {name: _reversed(mission.streams[name], columns[name]) for name in columns if name in mission.streams}
    if vehicle.drive.inertial and len(streams.get("imu", ())) > 1:
        # a sample is of the time since the one before
        imu = streams["imu"]
        streams["imu"] = replace(imu.keep(slice(0, len(imu) - 1)), time_s=imu.time_s[1:])
    image = Mission(mission.name, streams, date=mission.date)
    return Vehicle(drive, sensors, vehicle.name), image


def apart(forward: Track, back: Track) -> Apart | None:
    """How far two independent runs are from each other, and how far they should be.

    Parameters
    ----------
    forward : Track
        Or a smoothed one with its forward run.
    back : Track
        Of `backward`.

    Returns
    -------
    Apart or None
        None where they have no time in common.

    Notes
    -----
    The two have no reading in common, so that P_forward + P_backward is what they differ by. One mean square along a
    track is of few independent differences, or of one. Whatever their correlation, the mean of exponential variables is
    below any one of them in the convex order, and exceeds x means with a probability of exp(1 - x) at most.
    """
    run = forward.forward or forward
    inside = (run.time_s >= back.time_s[0]) & (run.time_s <= back.time_s[-1])
    if len(back) < 2 or np.count_nonzero(inside) < 2:
        return None
    run = run.keep(inside)
    other = back.at(run.time_s)
    origin = float(run.latitude[0]), float(run.longitude[0])
    off = run.local(*origin) - other.local(*origin)
    P, rows = run.covariance + other.covariance, [0, 1, 2, 8]
    smoothed = None if forward.forward is None else forward.at(run.time_s).covariance
    inverse = np.linalg.pinv(P[:, :2, :2])
    nis = 0.5 * float(np.mean(np.einsum("ni,nij,nj->n", off[:, :2], inverse, off[:, :2])))
    north, east, down = off.T
    return Apart(
        run.time_s,
        north,
        east,
        down,
        heading_rad=wrap(run.attitude[:, 2] - other.attitude[:, 2]),
        sd=_sd(P, rows),
        smoothed_sd=None if smoothed is None else _sd(smoothed, rows),
        nis=nis,
        chance=min(1.0, math.exp(1.0 - nis)),
        own_start=back.label == "backward",
    )


def _sd(P: Array, rows: list[int]) -> Array:
    return np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2)[:, rows], 0.0))


# --- the mirror -----------------------------------------------------------------------------------------------------


def _mirrored(name: str, part: Any, start: Start) -> Any:
    """A sensor, or what drives."""
    if not type(part).__module__.startswith("navfilter.") or type(part).__name__ in _WITHOUT:
        raise ValueError(
            f"{name}: the mirror image of a {type(part).__name__} is not known, so that it cannot run backwards. "
            f"Leave it out: --without {name}."
        )
    new: dict[str, Any] = {}
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, Sensor | Mechanisation):
            new[field.name] = _mirrored(field.name, value, start)
        elif field.name in _FIELDS and value is not None:
            new[field.name] = _FIELDS[field.name](value)
    if getattr(part, "magnetic", False) or getattr(part, "magnetometer", False):
        given = part.declination_rad
        here = (start.latitude_deg, start.longitude_deg, start.height_m, start.date)
        new["declination_rad"] = -(declination(*here) if given is None else given)
    return replace(part, **new)


def _constants(calibrated: tuple[tuple[str, float, float], ...]) -> tuple[tuple[str, float, float], ...]:
    return tuple((name, -value if name.endswith(_CONSTANTS) else value, sd) for name, value, sd in calibrated)


def _iron(elements: tuple[float, ...]) -> tuple[float, ...]:
    mirror = np.diag([-1.0, 1.0, 1.0])
    return tuple((mirror @ np.reshape(elements, (3, 3)) @ mirror).ravel().tolist())


#: Fields of sensors that a mirror changes: vectors and turns in the body, places, clocks.
_FIELDS: dict[str, Callable[[Any], Any]] = {
    "lever_arm_b_m": lambda v: (-v[0], v[1], v[2]),
    "hard_iron": lambda v: (-v[0], v[1], v[2]),
    "mounting_rad": lambda v: (v[0], -v[1], -v[2]),
    "soft_iron": _iron,
    "beam_azimuth_rad": lambda v: tuple(math.pi - azimuth for azimuth in v),
    "beacons": lambda v: tuple((latitude, -longitude, height) for latitude, longitude, height in v),
    "time_offset_s": lambda v: -v,
    "calibrated": _constants,
}


def _reversed(stream: Stream, columns: tuple[str, ...]) -> Stream:
    """The last reading first."""
    value = stream.value[::-1].copy()
    for k, name in enumerate(columns[: value.shape[1]]):
        change = _COLUMNS.get(name, 1.0)
        value[:, k] = change(value[:, k]) if callable(change) else change * value[:, k]
    return Stream(-stream.time_s[::-1], value, stream.columns, None if stream.sd is None else stream.sd[::-1])


def _back(track: Track) -> Track:
    """A track of the mirror image as one of the mission."""
    roll, pitch, heading = track.attitude[::-1].T
    turn = np.array([1.0, -1.0, 1.0] + [-1.0, 1.0, -1.0] * 2)
    return replace(
        track,
        time_s=-track.time_s[::-1],
        latitude=track.latitude[::-1],
        longitude=-track.longitude[::-1],
        height=track.height[::-1],
        velocity_n=track.velocity_n[::-1] * [-1.0, 1.0, -1.0],
        attitude=np.column_stack([roll, -pitch, wrap(np.pi - heading)]),
        covariance=track.covariance[::-1] * turn[:, None] * turn,
        states=np.empty((len(track), 0)),
        states_sd=np.empty((len(track), 0)),
        state_names=(),
        state_units=(),
        residuals={},
        error_models={},
        revised=None,
        bounds=None,
        axes=(),
        lanes=(),
        lane_history=None,
    )


def _first(run: Track, mission: Mission) -> Start:
    """Where the run forward begins."""
    latitude, longitude = (float(np.degrees(column[0])) for column in (run.latitude, run.longitude))
    return Start(
        latitude_deg=latitude, longitude_deg=longitude, height_m=float(run.height[0]), date=_date(run, mission)
    )


def _date(run: Track, mission: Mission) -> Any:
    return mission.date if mission.date is not None or mission.start is None else mission.start.date


def _from_the_end(run: Track, seen: Mission) -> Start:
    """A start of the mirror image where the forward run ends, with the uncertainty that it has there."""
    sd, tilts = np.sqrt(np.diagonal(run.covariance[-1])), run.attitude_sd()[-1]
    north, east, down = run.velocity_n[-1].tolist()
    return Start(
        time_s=max(-float(run.time_s[-1]), seen.begin_s),
        latitude_deg=float(np.degrees(run.latitude[-1])),
        longitude_deg=-float(np.degrees(run.longitude[-1])),
        height_m=float(run.height[-1]),
        velocity_n=(-north, east, -down),
        roll_deg=float(np.degrees(run.attitude[-1, 0])),
        pitch_deg=-float(np.degrees(run.attitude[-1, 1])),
        heading_deg=float(np.degrees(np.pi - run.attitude[-1, 2])),
        position_sd_m=tuple(sd[:3].tolist()),
        velocity_sd_m_s=tuple(sd[3:6].tolist()),
        tilt_sd_deg=float(np.degrees(tilts[:2].max())),
        heading_sd_deg=float(np.degrees(tilts[2])),
        date=seen.date,
    )

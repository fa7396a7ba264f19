"""Replay: a loop over a mission through the vehicle's own `step` and `correct`.

Fixes that are kept from the filter, so that its track can be scored against them.
"""

import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.sensors import Sensor
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.lanes.replay import replayed_lanes
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
    shown = bar(len(events.time_s), "filter", progress)
    BatchRunner(nav, times, values, events, done).run(None if shown is None else shown.update)
    if shown is not None:
        shown.close()


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
    drive = drive_samples(vehicle, mission)
    # nothing is late: the same filter, without the history that lets late readings in
    nav = Navigator(vehicle, start, history_s=0.0, threads=False)
    names = [name for name, sensor in vehicle.sensors.items() if sensor.open_loop] if sensors is None else list(sensors)
    _listen(nav, mission, names)
    _run(nav, *drive, readings_of(vehicle, mission, start.time_s), False)
    return {name: nav.residuals(name) for name in names}


def at_the_end(vehicle: Vehicle, mission: Mission, start: Start | None = None) -> Navigator:
    """The navigator at the end of a mission: its constant states are then what a smoother gives for all of it.

    Parameters
    ----------
    vehicle : Vehicle
        Without lanes, see `navfilter.models.lane_missions.of_one_unit`.
    mission : Mission
    start : Start, optional
        As in `replay`.
    """
    drive = drive_samples(vehicle, mission)
    start = _start(vehicle, mission, start)
    nav = Navigator(vehicle, start, history_s=0.0, threads=False)
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

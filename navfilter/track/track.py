"""The result of a run: state, covariance, residuals, adopted models; its errors and consistency against a truth.

Along a track: for how long, and why, it is not to be trusted as it should be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation import utc
from navfilter.foundation.arguments import intervals, needs, rows_of, within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.display import Value, often, span
from navfilter.kernels.batch import NIS_MEMORY, NIS_MOST
from navfilter.models.during import same_sensor
from navfilter.models.error_models import block_level
from navfilter.models.fault_bias import has_offset
from navfilter.models.health import LOST_HEADING, LOST_VELOCITY, MARGIN, NOISY, LaneHistory, silent_after_s
from navfilter.models.learned_arma import LearnedArma, learned_part
from navfilter.models.mission import Stream
from navfilter.models.sensors import Sensor
from navfilter.models.state import matrix_from_euler, rotation_vector, wrap
from navfilter.models.truth import radii
from navfilter.models.vehicle import Vehicle
from navfilter.timeseries.model import ArmaModel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

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


def with_offsets(track: Track, name: str, so: Callable[[Any], bool] = has_offset) -> list[tuple[float, float]]:
    """When a sensor that had jumped had constants for it, or such that wander [s]."""
    history = track.error_models.get(name, [])
    pairs = zip(history, [*history[1:], (np.inf, None)], strict=True)
    return [(begin_s, end_s) for (begin_s, models), (end_s, _) in pairs if so(models)]


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
    for begin_s, end_s in with_offsets(run, name):
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


_TRUTH = "That of a mission is mission.truth."
#: Fields with one row per time.
_BY_ROW = ("time_s", "latitude", "longitude", "height", "velocity_n", "attitude", "covariance", "states", "states_sd")
#: Figures that `Track.summary` gives where there is a truth.
_POSITION = ("position_rms_m", "position_max_m", "position_end_m", "position_end_pct")
ERRORS = (*_POSITION, "heading_rms_deg", "velocity_rms_m_s")


@dataclass(frozen=True, eq=False, repr=False)
class TrackErrors(Value):
    """Estimated minus true along a track; NaN where there is no truth.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    position_n, velocity_n : ndarray, shape (n, 3)
        North, east, down [m], [m/s].
    attitude : ndarray, shape (n, 3)
        Rotation vector in n [rad].
    heading : ndarray, shape (n,)
        Heading error [rad].
    """

    time_s: Array
    position_n: Array
    velocity_n: Array
    attitude: Array
    heading: Array

    @property
    def horizontal(self) -> Array:
        """Horizontal distance to the truth [m], shape (n,)."""
        return np.hypot(self.position_n[:, 0], self.position_n[:, 1])

    def _shown(self) -> tuple[str, dict[str, object]]:
        known = int(np.count_nonzero(np.isfinite(self.horizontal)))
        rows: dict[str, object] = {"truth": f"at {known} of {len(self.time_s)} rows"}
        rows["position"] = _in_words(self.horizontal, "m, horizontal")
        rows["velocity"] = _in_words(np.linalg.norm(self.velocity_n, axis=1), "m/s")
        rows["heading"] = _in_words(np.degrees(self.heading), "deg")
        return f"TrackErrors{span(self.time_s)}, {often(self.time_s, 'rows')}", rows


@dataclass(frozen=True, eq=False, repr=False)
class Track(Value):
    """What a run found out.

    Attributes
    ----------
    label : str
        "forward": each state as the vehicle had it at its time, whatever was run again later. "revised": what the
        run made of its past when it went back. "smoothed".
    vehicle : Vehicle
    mission_name : str
    time_s : ndarray, shape (n,)
    latitude, longitude : ndarray, shape (n,)
        [rad].
    height : ndarray, shape (n,)
        [m].
    velocity_n : ndarray, shape (n, 3)
    attitude : ndarray, shape (n, 3)
        Roll, pitch, heading [rad].
    covariance : ndarray, shape (n, 9, 9)
        Of position [m] in n, velocity [m/s] in n, attitude [rad] in n.
    states, states_sd : ndarray, shape (n, k)
        Estimates and standard deviations of sensor errors and parameters.
    state_names, state_units : tuple of str
    residuals : dict of str to Residuals
    error_models : dict of str to list of (time_s, error model)
        What was in force from when.
    counts : dict of str to int
        Irregularities of the drive: gaps, backward stamps, repaired samples; gates widened.
    cpu_s : float
        Processor time of the run [s].
    forward : Track, optional
        Of a smoothed track: the forward one.
    revised : Track, optional
        Of a forward track: with hindsight, where the beginning was run again with models that were learnt from it.
    epoch_utc_s : float or None
        UTC of mission time zero [s since 1970]; None where the mission does not know it.
    bounds : ndarray, shape (n, 2), or None
        Of a forward track: protection radius [m] and bound of the heading [rad], see
        `navfilter.faults.protection_level`.
    drive_steps : ndarray, shape (n, 2, k), or None
        Of a smoothed track: residuals of what drives. The step that it would have had to say too much at each row for
        all later readings to fit best, and the standard deviation of that: honest ones are normal. Of an inertial unit
        a step of the velocity along the axes of the body [m/s] and of the attitude about them [rad]; of dead reckoning
        one of the position along them [m]. NaN where no reading tells it.
    axes : tuple of (time_s, axis, condition)
        When the condition of an axis of the inertial unit changed, as `Health.axes` names it.
    lanes : tuple of (float, str)
        Of a vehicle with lanes: from when [s] which was in force.
    lane_history : LaneHistory or None
        How well each lane foretold the readings, and why one was left for another, see
        `navfilter.models.health.LaneHistory`.
    """

    label: str
    vehicle: Vehicle
    mission_name: str
    time_s: Array
    latitude: Array
    longitude: Array
    height: Array
    velocity_n: Array
    attitude: Array
    covariance: Array
    states: Array
    states_sd: Array
    state_names: tuple[str, ...]
    residuals: dict[str, Residuals]
    error_models: dict[str, list[tuple[float, Any]]]
    counts: dict[str, int] = field(default_factory=dict)
    cpu_s: float = field(default=0.0, compare=False)
    forward: Track | None = None
    state_units: tuple[str, ...] = ()
    revised: Track | None = None
    epoch_utc_s: float | None = None
    bounds: Array | None = None
    drive_steps: Array | None = None
    axes: tuple[tuple[float, str, str], ...] = ()
    lanes: tuple[tuple[float, str], ...] = ()
    lane_history: LaneHistory | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def distance_m(self) -> float:
        """Horizontal distance travelled [m], from the estimated velocity."""
        speed = np.hypot(self.velocity_n[:, 0], self.velocity_n[:, 1])
        return float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(self.time_s)))

    def travelled(self) -> Array:
        """Horizontal distance travelled up to each row [m], shape (n,)."""
        speed = np.hypot(self.velocity_n[:, 0], self.velocity_n[:, 1])
        return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(self.time_s))])

    @property
    def time_utc(self) -> NDArray[np.datetime64] | None:
        """Its times as dates, datetime64[ns], shape (n,), UTC; None where the mission does not know UTC."""
        return None if self.epoch_utc_s is None else utc.dates(self.time_s, self.epoch_utc_s)

    def keep(self, rows: Any) -> Track:
        """Only the given rows (a mask, a slice or indices); residuals and models stay whole."""
        rows = rows_of(rows)
        kept: dict[str, Any] = {name: getattr(self, name)[rows] for name in _BY_ROW}
        for name in ("bounds", "drive_steps"):
            of = getattr(self, name)
            kept[name] = None if of is None else of[rows]
        return replace(self, forward=None, **kept)

    def at(self, time_s: ArrayLike) -> Track:
        """The track at other times inside it [s], shape (m,): linear between its rows, angles through the shorter
        way.

        Raises
        ------
        ValueError
            For times outside it, and for less than two rows.
        """
        times = np.atleast_1d(utc.seconds(time_s, "at: time_s"))
        if len(self) < 2:
            raise ValueError(f"between rows needs two of them, this track has {len(self)}.")
        outside = ~((times >= self.time_s[0] - 1e-6) & (times <= self.time_s[-1] + 1e-6))
        if outside.any():
            raise ValueError(
                f"{np.count_nonzero(outside)} of {len(times)} times lie outside this track, the first is "
                f"{times[outside][0]:g} s: it goes from {self.time_s[0]:g} to {self.time_s[-1]:g} s."
            )
        after = np.clip(np.searchsorted(self.time_s, times), 1, len(self) - 1)
        step = self.time_s[after] - self.time_s[after - 1]
        share = np.clip((times - self.time_s[after - 1]) / step, 0.0, 1.0)

        def between(rows: Array) -> Array:
            part = share.reshape(-1, *(1,) * (rows.ndim - 1))
            return rows[after - 1] + part * (rows[after] - rows[after - 1])

        names = ("height", "velocity_n", "covariance", "states", "states_sd")
        moved: dict[str, Any] = {name: between(getattr(self, name)) for name in names}
        for name in ("latitude", "longitude", "attitude"):
            moved[name] = between(np.unwrap(getattr(self, name), axis=0))
        return replace(self, time_s=times, forward=None, revised=None, bounds=None, drive_steps=None, **moved)

    def local(self, latitude: float | None = None, longitude: float | None = None) -> Array:
        """Position north, east, down [m], shape (n, 3), from a reference point [rad] (default: the first position)."""
        if abs(latitude or 0.0) > math.pi / 2 or abs(longitude or 0.0) > 2.0 * math.pi:
            raise ValueError(f"local takes radians, found {latitude}, {longitude}: np.radians turns degrees into them.")
        lat0 = self.latitude[:1] if latitude is None else latitude
        lon0 = self.longitude[:1] if longitude is None else longitude
        return _metres(self.latitude, self.longitude, self.height, lat0, lon0, 0.0)

    def state(self, name: str) -> tuple[Array, Array]:
        """Estimate and standard deviation of one error state or parameter over time."""
        if name not in self.state_names:
            raise ValueError(f'no state "{name}" on this track (states: {", ".join(self.state_names)}).')
        i = self.state_names.index(name)
        return self.states[:, i], self.states_sd[:, i]

    def adopted(self) -> dict[str, list[dict[str, Any]]]:
        """Every learnt model by sensor axis ("compass", "dvl x"), as plain values in the order of their times.

        Returns
        -------
        dict of str to list of dict
            "time_s" from when it was in force; of the fast part "order" (p, q), "ar", "ma", "sd" (of the innovations)
            and "pole_radius" (the largest; 0 without poles); beside it "slow" (processes) and "white" (standard
            deviation of white noise); "level"; of the whole "s0" (spectral density at zero frequency per sample) and
            "sd_log_s0"; "flags", "frozen". SI units and radians. Axes that have none are left out.
        """
        found: dict[str, list[dict[str, Any]]] = {}
        for name, history in self.error_models.items():
            last: dict[str, LearnedArma] = {}
            for time_s, error in history:
                models = error if isinstance(error, tuple) else (error,)
                axes = (
                    getattr(self.vehicle.sensors.get(name), "axis_names", ("x", "y", "z")) if len(models) > 1 else ("",)
                )
                for axis, model in zip(axes, models, strict=True):
                    title, part = f"{name} {axis}".strip(), learned_part(model)
                    # what is no other than before is the adoption of another axis
                    if part is not None and part.model is not None and last.get(title) != part:
                        found.setdefault(title, []).append(_plain(time_s, part, part.model, self._period_s(name)))
                        last[title] = part
        return found

    def _period_s(self, name: str) -> float:
        """Sampling period of a sensor, or of the drive's own [s]."""
        sensor = self.vehicle.sensors.get(name)
        return self.vehicle.drive.period_s if sensor is None else 1.0 / sensor.rate_hz

    def to_frame(self) -> pd.DataFrame:
        """Table with one row per time, in degrees and metres; every column names its unit. ``time_utc`` is there where
        the mission knows UTC.
        """
        import pandas as pd

        sd = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        rpy, rpy_sd = np.degrees(self.attitude), np.degrees(self.attitude_sd())
        columns: dict[str, Array | pd.DatetimeIndex] = {"time_s": self.time_s}
        if self.time_utc is not None:
            columns["time_utc"] = pd.DatetimeIndex(self.time_utc, tz="UTC")
        columns |= {
            "latitude_deg": np.degrees(self.latitude),
            "longitude_deg": np.degrees(self.longitude),
            "height_m": self.height,
            "depth_m": -self.height,
        }
        axes = ("north", "east", "down")
        columns |= {f"velocity_{a}_m_s": self.velocity_n[:, i] for i, a in enumerate(axes)}
        columns |= {"roll_deg": rpy[:, 0], "pitch_deg": rpy[:, 1], "heading_deg": rpy[:, 2] % 360.0}
        columns |= {f"position_{a}_sd_m": sd[:, i] for i, a in enumerate(axes)}
        columns["position_north_east_cov_m2"] = self.covariance[:, 0, 1]
        columns |= {f"velocity_{a}_sd_m_s": sd[:, 3 + i] for i, a in enumerate(axes)}
        columns |= {f"{a}_sd_deg": rpy_sd[:, i] for i, a in enumerate(("roll", "pitch", "heading"))}
        if self.bounds is not None:
            columns |= {"protection_radius_m": self.bounds[:, 0], "heading_bound_deg": np.degrees(self.bounds[:, 1])}
        for i, name in enumerate(self.state_names):
            unit = self.state_units[i] if self.state_units else "1"
            factor = 180.0 / math.pi if unit.startswith("rad") else 1.0
            unit = unit.replace("rad", "deg")
            columns[f"{name}_{unit}"] = factor * self.states[:, i]
            columns[f"{name}_sd_{unit}"] = factor * self.states_sd[:, i]
        return pd.DataFrame(columns)

    def plot(self) -> Figure:
        """A figure of the track: seen from above, its depth and heading, and how well the position is known.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it; ``track.plot().savefig("track.png")`` keeps it.

        Raises
        ------
        ValueError
            For a track without rows.
        """
        from navfilter.track.plot import track_figure

        if not len(self):
            raise ValueError("this track has no rows: there is nothing to plot.")
        sd = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        heading, heading_sd = np.degrees(np.unwrap(self.attitude[:, 2])), np.degrees(self.attitude_sd()[:, 2])
        curves = {
            "depth [m]": (-self.height, sd[:, 2]),
            "heading [deg]": (heading, heading_sd),
            "sd of position [m]": (np.hypot(sd[:, 0], sd[:, 1]), None),
        }
        title = f"{self.mission_name}, {self.label}"
        return track_figure(title, self.local(), self.time_s if self.time_utc is None else self.time_utc, curves)

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"mission": self.mission_name, "vehicle": self.vehicle.name, "rows": len(self)}
        if len(self):
            sd = np.sqrt(np.trace(self.covariance[-1, :2, :2]))
            rows |= {
                "begins": utc.date_text(self.time_s[0], self.epoch_utc_s),
                "mission time": f"{self.time_s[0]:.1f} to {self.time_s[-1]:.1f} s",
                "travelled": f"{self.distance_m:.0f} m",
                "ends at": f"{math.degrees(self.latitude[-1]):.6f}, {math.degrees(self.longitude[-1]):.6f} deg",
                "sd of position at the end": f"{sd:.2f} m",
            }
        for name, residuals in self.residuals.items():
            rows[name] = residuals.in_words
        rows["irregular"] = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count) or None
        rows["learnt"] = ", ".join(self.adopted()) or None
        return f"Track, {self.label}", rows

    def horizontal_sd(self) -> Array:
        """Predicted rms of the horizontal position error [m], shape (n,)."""
        return np.sqrt(np.maximum(self.covariance[:, 0, 0] + self.covariance[:, 1, 1], 0.0))

    def attitude_sd(self) -> Array:
        """Standard deviations of roll, pitch and heading [rad], shape (n, 3), from the covariance of the rotation
        vector in n.
        """
        _, pitch, heading = self.attitude.T
        c, s, t, z, o = np.cos(heading), np.sin(heading), np.tan(pitch), np.zeros(len(self)), np.ones(len(self))
        cp = np.cos(pitch)
        J = np.stack([np.stack([c / cp, s / cp, z], -1), np.stack([-s, c, z], -1), np.stack([c * t, s * t, o], -1)], -2)
        P = J @ self.covariance[:, 6:9, 6:9] @ np.swapaxes(J, 1, 2)
        return np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))

    def errors(self, truth: Stream) -> TrackErrors:
        """Errors of the track, at its own times; the truth is interpolated (NaN outside it and across gaps in it longer
        than 5 s).
        """
        needs("errors: truth", truth, Stream, hint=_TRUTH)
        if len(truth.columns) != 9:
            raise ValueError(f"errors: truth must have nine columns, found {', '.join(truth.columns)}. {_TRUTH}")
        t = _interpolate(truth, self.time_s)
        lat, lon, h = t[:, 0], t[:, 1], t[:, 2]
        north_east_down = _metres(self.latitude, self.longitude, self.height, lat, lon, h)
        C, C_true = matrix_from_euler(*self.attitude.T), matrix_from_euler(*t[:, 6:9].T)
        attitude = np.full((len(self), 3), np.nan)
        known = np.isfinite(t[:, 6:9]).all(axis=1)
        attitude[known] = rotation_vector(C[known] @ np.swapaxes(C_true[known], 1, 2))
        return TrackErrors(
            self.time_s, north_east_down, self.velocity_n - t[:, 3:6], attitude, wrap(self.attitude[:, 2] - t[:, 8])
        )

    def nees(self, errors: TrackErrors) -> dict[str, Array]:
        """Normalised estimation error squared per degree of freedom over time: position, velocity, attitude, heading
        (NaN without truth).

        Components without truth (a depth, a roll) are left out.
        """
        needs("nees: errors", errors, TrackErrors, hint="Those of a track are track.errors(mission.truth).")
        P = self.covariance
        result = {
            "position": _nees(errors.position_n, P[:, :3, :3]),
            "velocity": _nees(errors.velocity_n, P[:, 3:6, 3:6]),
            "attitude": _nees(errors.attitude, P[:, 6:9, 6:9]),
        }
        with np.errstate(divide="ignore", invalid="ignore"):
            result["heading"] = errors.heading**2 / self.attitude_sd()[:, 2] ** 2
        return result

    def summary(self, truth: Stream | None = None, windows: tuple[tuple[float, float], ...] = ()) -> dict[str, Any]:
        """Figures of the run as they stand in ``summary.json``; None where there is no truth.

        Parameters
        ----------
        truth : Stream, optional
        windows : tuple of (float, float)
            Times [s] to be scored; default all.
        """
        needs("summary: truth", truth, Stream, type(None), hint=_TRUTH)
        windows = intervals(windows, "summary: windows")
        result: dict[str, Any] = dict.fromkeys((*ERRORS, "nees_position", "nees_heading"))
        if truth is not None and len(truth):
            errors = self.errors(truth)
            scored = within(self.time_s, windows) if windows else np.ones(len(self), bool)
            horizontal = errors.horizontal[scored]
            valid = horizontal[np.isfinite(horizontal)]
            nees = self.nees(errors)
            if valid.size:
                result["position_rms_m"] = float(np.sqrt(np.mean(valid**2)))
                result["position_max_m"], result["position_end_m"] = float(valid.max()), float(valid[-1])
                result["position_end_pct"] = float(100.0 * valid[-1] / self.distance_m) if self.distance_m > 0 else None
            result["heading_rms_deg"] = _rms(np.degrees(errors.heading[scored]))
            result["velocity_rms_m_s"] = _rms(np.linalg.norm(errors.velocity_n[scored], axis=1))
            result |= {f"nees_{of}": _mean(nees[of][scored]) for of in ("position", "heading")}
        r = self.residuals
        result["nis"] = {name: _mean(v.nis[v.used] / np.maximum(v.dof[v.used], 1)) for name, v in r.items()}
        for outcome in ("used", "rejected", "invalid"):
            result[outcome] = {name: v.count(outcome) for name, v in r.items()}
        result["models"] = {
            name: [[round(t, 3), str(m)] for t, m in models] for name, models in self.error_models.items()
        }
        result["adopted"] = self.adopted()
        result["cpu_s"] = self.cpu_s
        return result


def _plain(time_s: float, part: LearnedArma, model: ArmaModel, period_s: float) -> dict[str, Any]:
    return {
        "time_s": round(time_s, 3),
        "order": [model.p, model.q],
        "ar": model.ar.tolist(),
        "ma": model.ma.tolist(),
        "sd": model.sd,
        "s0": block_level(part.block(period_s)),
        "sd_log_s0": model.sd_log_s0,
        "slow": [{"sd": p.sd, "tau_s": p.tau_s, "order": p.order} for p in part.slow_parts],
        "white": math.sqrt(sum(beside.block(period_s).r for beside in part.beside)),
        "level": part.level,
        "pole_radius": float(np.abs(model.poles).max(initial=0.0)),
        "flags": sorted(model.flags),
        "frozen": part.frozen,
    }


def _mean(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def _rms(values: Array) -> float | None:
    mean = _mean(values**2)
    return None if mean is None else math.sqrt(mean)


def _nees(error: Array, P: Array) -> Array:
    """Per degree of freedom, over the components whose truth is known (the same ones at all times)."""
    known = np.isfinite(error).any(axis=0)
    if not known.any():
        return np.full(len(error), np.nan)
    e, S = error[:, known], P[:, known][:, :, known]
    rows = np.isfinite(e).all(axis=1)
    result = np.full(len(e), np.nan)
    if rows.any():
        solved = np.einsum("nij,nj->ni", np.linalg.pinv(S[rows], hermitian=True), e[rows])
        result[rows] = np.einsum("ni,ni->n", e[rows], solved) / e.shape[1]
    return result


def _metres(lat: Array, lon: Array, h: Array, lat0: Any, lon0: Any, h0: Any) -> Array:
    """North, east, down [m] of points from reference points nearby."""
    mid = 0.5 * (lat + lat0)
    meridian, prime = radii(mid)
    height = 0.5 * (h + h0)
    height = np.where(np.isfinite(height), height, 0.0)
    return np.stack(
        [(lat - lat0) * (meridian + height), wrap(lon - lon0) * (prime + height) * np.cos(mid), h0 - h + 0.0 * lat],
        axis=-1,
    )


def _interpolate(truth: Stream, time_s: Array, longest_gap_s: float = 5.0) -> Array:
    """Truth columns at other times; angles through the shorter way, NaN outside and across long gaps."""
    result = np.full((len(time_s), truth.value.shape[1]), np.nan)
    for c in range(truth.value.shape[1]):
        column = truth.value[:, c]
        good = np.isfinite(column)
        if good.sum() < 2:
            continue
        t, v = truth.time_s[good], column[good]
        if c in (1, 6, 7, 8):
            v = np.unwrap(v)
        after = np.clip(np.searchsorted(t, time_s, side="left"), 1, len(t) - 1)
        inside = (time_s >= t[0] - 1e-6) & (time_s <= t[-1] + 1e-6)
        near = (t[after] - t[after - 1] <= longest_gap_s) | (
            np.minimum(np.abs(time_s - t[after]), np.abs(time_s - t[after - 1])) < 1e-6
        )
        result[:, c] = np.where(inside & near, np.interp(time_s, t, v), np.nan)
    return result


def _in_words(errors: Array, unit: str) -> str | None:
    """Root mean square and largest of those that are known."""
    known = np.abs(errors[np.isfinite(errors)])
    if not len(known):
        return None
    return f"{math.sqrt(float(np.mean(known**2))):.3g} rms, {known.max():.3g} at most [{unit}]"


#: Runs by label.
Tracks = Mapping[str, Track]

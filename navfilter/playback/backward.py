"""A mission run from its end to its beginning, independently of the run forward."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.alignment import align
from navfilter.models.lane_missions import last_unit, of_one_unit
from navfilter.models.magnetic import declination
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors import Sensor
from navfilter.models.start import Start
from navfilter.models.state import wrap
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track

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

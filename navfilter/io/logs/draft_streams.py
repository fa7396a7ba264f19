"""Which topics of a log become which streams: what drives, what corrects, and what stands in for what is lacking."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from navfilter.io.logs.draft_vehicle import LIKE
from navfilter.io.logs.known_topics import READINGS, Use, uses_of
from navfilter.io.logs.survey import Survey, Topic
from navfilter.models.mission import MissionError

__all__ = ["Drafted", "chosen_streams", "inertial", "still"]

#: A slower inertial unit cannot carry the state between its samples [Hz].
_SLOWEST_IMU_HZ = 20.0
_CORRECTING = (
    ("compass", ("heading", "magnetic", "field")),
    ("dvl", ("velocity",)),
    ("odometry", ("odometry",)),
    ("depth", ("depth", "pressure")),
    ("gps", ("position",)),
)
_ATTITUDES = ("attitude", "heading", "magnetic", "course")
_VELOCITIES = ("velocity", "odometry", "water", "speed")
#: What fixes say of heading and speed means nothing below this speed [kn].
_FROM_FIXES, _SLOWEST_KN = ("course", "speed"), 1.0
#: Fixes that repeat the one before more often than this are held, not new.
_HELD = 0.5
_FLU = ', axes = "x,-y,-z"'
#: Without any of these an inertial unit drifts away within a minute.
_AIDS = ("velocity", "odometry", "position")


@dataclass(frozen=True)
class Drafted:
    """A stream of the mission.toml to be.

    Parameters
    ----------
    name : str
    reading : str
        Key of `READINGS`, or ``"none"`` for a stand-in.
    topic : Topic
    lines : tuple of str
        Groups of columns.
    where, guess : str
        Condition on the rows; what is not known for certain. Empty: none.
    """

    name: str
    reading: str
    topic: Topic
    lines: tuple[str, ...]
    where: str = ""
    guess: str = ""


def chosen_streams(found: Survey, like: str = "") -> tuple[list[Drafted], list[Drafted], str]:
    """What drives, what corrects, and the type of the drive (``"imu"`` or ``"dead-reckoning"``).

    Parameters
    ----------
    found : Survey
    like : str
        Key of `LIKE`; empty: whatever the log allows.

    Raises
    ------
    MissionError
        If nothing in the log can drive.
    """
    uses = [(topic, use) for topic, use in uses_of(found) if use.reading not in _FROM_FIXES or _is_under_way(topic)]
    driving, drive = _driving(found, uses, like)
    return driving, _correcting(uses, drive), drive


def _driving(found: Survey, uses: list[tuple[Topic, Use]], like: str) -> tuple[list[Drafted], str]:
    imu = [(topic, use) for topic, use in uses if use.reading == "imu" and topic.rate_hz >= _SLOWEST_IMU_HZ]
    attitude = _first(uses, _ATTITUDES)
    aided = _first(uses, _AIDS) is not None or attitude is None
    if imu and aided and (not like or LIKE[like].drive == "imu"):
        return [inertial(*imu[0])], "imu"
    fixes = _first(uses, ("position",))
    if attitude is None and fixes is not None:
        north = _north(*fixes)
        return [north, still(north)], "dead-reckoning"
    if attitude is None:
        known = ", ".join(f"{topic.name} ({READINGS[use.reading]})" for topic, use in uses) or "none of a known kind"
        raise MissionError(
            f"{found.path}: nothing in this log can drive; it takes turn rates with forces at {_SLOWEST_IMU_HZ:g} Hz or"
            f" more, a heading, or fixes. Known topics: {known}. Map it by hand (docs/pages/logs.md)."
        )
    level = _as_attitude(_stream("attitude", *attitude))
    velocity = _first(uses, _VELOCITIES)
    return [level, still(level) if velocity is None else _stream("velocity", *velocity)], "dead-reckoning"


def inertial(topic: Topic, use: Use) -> Drafted:
    """The stream of an inertial unit."""
    return _upright(_stream("imu", topic, use))


def _upright(imu: Drafted) -> Drafted:
    """Axes forward, left, up only where gravity agrees: not every ROS driver keeps to them."""
    up = imu.topic.columns.get("linear_acceleration.z")
    if up is None or _FLU not in imu.lines[0] or np.nanmean(up) > 0.0:
        return imu
    words = "axes: forward, right, down, because gravity points that way (ROS asks for forward, left, up)"
    return replace(imu, lines=tuple(line.replace(_FLU, "") for line in imu.lines), guess=words)


def _is_under_way(topic: Topic) -> bool:
    return topic.has("spd") and float(np.nanmedian(topic.columns["spd"].astype(float))) >= _SLOWEST_KN


def _north(topic: Topic, use: Use) -> Drafted:
    """Level and heading north at the times of the fixes, for a log that has nothing else."""
    line = (
        'attitude = {columns = [{column = "log_time", scale = 0.0}, {constant = 0.0}, {constant = 0.0}], unit = "rad"}'
    )
    return Drafted(
        "attitude", "none", topic, (line,), use.where, "there is no heading in this log: level, heading north"
    )


def still(attitude: Drafted) -> Drafted:
    """A velocity of zero at the times of all records with the attitude, also of those that lack it, for a log without
    any.
    """
    line = (
        'velocity = {columns = [{column = "log_time", scale = 0.0}, {constant = 0.0}, {constant = 0.0}], unit = "m/s"}'
    )
    words = (
        "there is no velocity in this log: the vehicle is taken to stand still, give or take the error in vehicle.toml"
    )
    return Drafted("velocity", "none", attitude.topic, (line,), "", words)


def _correcting(uses: list[tuple[Topic, Use]], drive: str) -> list[Drafted]:
    wanted = [(name, readings) for name, readings in _CORRECTING if drive == "imu" or name in ("depth", "gps")]
    chosen = [(name, _first(uses, readings)) for name, readings in wanted]
    return [_fresh(_stream(name, *use)) for name, use in chosen if use is not None]


def _fresh(stream: Drafted) -> Drafted:
    """Fixes that are mostly held ones: only the new."""
    column = next((stream.topic.columns[name] for name in ("lat", "Lat", "latitude") if stream.topic.has(name)), None)
    if stream.reading != "position" or column is None or column.size < 20 or np.ptp(column) == 0.0:
        return stream
    held = float(np.mean(np.diff(column) == 0.0))
    if held < _HELD:
        return stream
    words = f"{100 * held:.0f} % of the fixes repeat the one before: only a change is taken for a new one"
    guess = "; ".join(filter(None, [stream.guess, words]))
    return replace(stream, lines=(*stream.lines, "only_changes = true"), guess=guess)


def _first(uses: list[tuple[Topic, Use]], readings: tuple[str, ...]) -> tuple[Topic, Use] | None:
    return next((pair for reading in readings for pair in uses if pair[1].reading == reading), None)


def _stream(name: str, topic: Topic, use: Use) -> Drafted:
    return Drafted(name, use.reading, topic, use.lines, use.where, use.guess)


def _as_attitude(stream: Drafted) -> Drafted:
    """A heading alone as roll, pitch and heading, level."""
    line = stream.lines[0]
    if not line.startswith("heading"):
        return stream
    column = line.split('column = "', 1)[1].split('"', 1)[0]
    lines = (f'attitude = {{columns = [{{constant = 0.0}}, {{constant = 0.0}}, "{column}"], unit = "deg"}}',)
    words = "; ".join(filter(None, [stream.guess, "level: there is no roll and pitch in this log"]))
    return replace(stream, lines=lines, guess=words)

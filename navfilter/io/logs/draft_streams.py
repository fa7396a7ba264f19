"""Which topics of a log become which streams: what drives, what corrects, and what stands in for what is lacking."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, replace

import numpy as np

from navfilter.io.logs.draft_vehicle import LIKE
from navfilter.io.logs.known_topics import READINGS, Use, uses_of
from navfilter.io.logs.survey import Survey, Topic
from navfilter.models.mission import MissionError

#: A slower inertial unit hardly carries the state between its samples [Hz]; one slower than the second is none.
_SLOWEST_IMU_HZ, _NO_IMU_HZ = 20.0, 5.0
_CORRECTING = (
    ("compass", ("heading", "magnetic", "field", "heading-of-log", "magnetic-of-log")),
    ("dvl", ("velocity", "beams")),
    ("odometry", ("odometry",)),
    ("depth", ("depth", "pressure", "gauge-pressure")),
    ("gps", ("position",)),
    ("course", ("ground-velocity",)),
)
_ATTITUDES = ("attitude|magnetic-attitude", "heading", "magnetic", "heading-of-log", "magnetic-of-log", "course")
_VELOCITIES = ("velocity", "odometry", "water", "speed")
#: What fixes say of heading and speed means nothing below this speed [kn].
_FROM_FIXES, _SLOWEST_KN = ("course", "speed"), 1.0
#: Fixes that repeat the one before more often than this are held, not new.
_HELD = 0.5
_FLU = ', axes = "x,-y,-z"'
#: Without any of these an inertial unit drifts away within a minute.
_AIDS = ("velocity", "beams", "odometry", "position")
#: Formats in which each fix has its own time: one that is the same in the same place is new.
_OWN_TIMES = ("nmea",)


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
    stands_in : bool
        Whether what it gives was not measured.
    """

    name: str
    reading: str
    topic: Topic
    lines: tuple[str, ...]
    where: str = ""
    guess: str = ""
    stands_in: bool = False


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
    told = found.uses or ()  # those of a table are judged by its guesses
    uses = [
        (topic, use) for topic, use in uses_of(found) if told or use.reading not in _FROM_FIXES or _is_under_way(topic)
    ]
    driving, drive = _driving(found, uses, like)
    if any(stream.reading in _FROM_FIXES for stream in driving):
        uses = [(topic, use) for topic, use in uses if use.reading != "ground-velocity"]  # it is in what drives
    return driving, _correcting(found, uses, drive), drive


def _driving(found: Survey, uses: list[tuple[Topic, Use]], like: str) -> tuple[list[Drafted], str]:
    attitude = _first(uses, _ATTITUDES)
    slowest = _NO_IMU_HZ if attitude is None else _SLOWEST_IMU_HZ
    imu = [(topic, use) for topic, use in uses if use.reading == "imu" and topic.rate_hz >= slowest]
    aided = _first(uses, _AIDS) is not None or attitude is None
    if imu and aided and (not like or LIKE[like].drive == "imu"):
        unit = inertial(*imu[0])
        if imu[0][0].rate_hz < _SLOWEST_IMU_HZ:
            words = f"an inertial unit of {imu[0][0].rate_hz:.3g} Hz, slow for one: nothing else in this log can drive"
            unit = replace(unit, guess="; ".join(filter(None, [unit.guess, words])))
        return [unit], "imu"
    fixes = _first(uses, ("position",))
    if attitude is None and fixes is not None:
        north = _north(*fixes)
        return [north, still(north)], "dead-reckoning"
    if attitude is None:
        known = ", ".join(f"{topic.name} ({READINGS[use.reading]})" for topic, use in uses) or "none of a known kind"
        raise MissionError(
            f"{found.path}: nothing in this log can drive; it takes turn rates with forces at {_NO_IMU_HZ:g} Hz or"
            f" more, a heading, or fixes. Known topics: {known}. Map it by hand (docs/pages/logs.md)."
        )
    level = _as_attitude(_stream("attitude", *attitude))
    level = replace(level, stands_in=attitude[1].reading == "course")
    velocity = _first(uses, _VELOCITIES)
    if velocity is None:
        return [level, still(level, _first(uses, ("beams",)) is not None)], "dead-reckoning"
    return [level, replace(_stream("velocity", *velocity), stands_in=velocity[1].reading == "speed")], "dead-reckoning"


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


def _zeros(group: str) -> str:
    """A group of zeros at the times of all records."""
    return f"{group} = {{columns = [{{constant = 0.0}}, {{constant = 0.0}}, {{constant = 0.0}}]}}"


def _north(topic: Topic, use: Use) -> Drafted:
    """Level and heading north at the times of the fixes, for a log that has nothing else."""
    line = _zeros("attitude")
    words = "there is no heading in this log: level, heading north"
    return Drafted("attitude", "none", topic, (line,), use.where, words, stands_in=True)


def still(attitude: Drafted, beams: bool = False) -> Drafted:
    """A velocity of zero at the times of all records with the attitude, also of those that lack it, for a log without
    any, or with one that has to correct because it is given along its beams.
    """
    line = _zeros("velocity")
    words = (
        "there is no velocity in this log: the vehicle is taken to stand still, give or take the error in vehicle.toml"
    )
    if beams:
        words = "nobody knows the velocity between the readings of the beams, which correct it: zero, give or take"
    return Drafted("velocity", "none", attitude.topic, (line,), "", words, stands_in=not beams)


def _correcting(found: Survey, uses: list[tuple[Topic, Use]], drive: str) -> list[Drafted]:
    beside = {"depth": None, "gps": None, "course": None, "dvl": ("beams",)}
    wanted = [
        (name, readings if drive == "imu" else beside[name] or readings)
        for name, readings in _CORRECTING
        if drive == "imu" or name in beside
    ]
    if drive != "imu" and _first(uses, _VELOCITIES) is not None:
        wanted = [(name, readings) for name, readings in wanted if name != "dvl"]
    chosen = [(name, _first(uses, readings)) for name, readings in wanted]
    streams = [_stream(name, *use) for name, use in chosen if use is not None]
    return streams if found.format.module in _OWN_TIMES else [_fresh(stream) for stream in streams]


def _fresh(stream: Drafted) -> Drafted:
    """Fixes that are mostly held ones: only the new."""
    column = next((stream.topic.columns[name] for name in ("lat", "Lat", "latitude") if stream.topic.has(name)), None)
    if stream.reading != "position" or column is None or column.size < 20 or (column == column[0]).all():
        return stream
    held = float(np.mean(column[1:] == column[:-1]))
    if held < _HELD:
        return stream
    words = f"{100 * held:.0f} % of the fixes repeat the one before: only a change is taken for a new one"
    guess = "; ".join(filter(None, [stream.guess, words]))
    return replace(stream, lines=(*stream.lines, "only_changes = true"), guess=guess)


def _first(uses: list[tuple[Topic, Use]], readings: tuple[str, ...]) -> tuple[Topic, Use] | None:
    return next((pair for reading in readings for pair in uses if pair[1].reading in reading.split("|")), None)


def _stream(name: str, topic: Topic, use: Use) -> Drafted:
    return Drafted(name, use.reading, topic, use.lines, use.where, use.guess)


def _as_attitude(stream: Drafted) -> Drafted:
    """A heading alone as roll, pitch and heading, level."""
    heading = tomllib.loads(stream.lines[0]).get("heading")
    if heading is None:
        return stream
    column = f"{{constant = 0.0}}, {{constant = 0.0}}, {json.dumps(heading['column'])}"
    invalid = f", invalid = {json.dumps(heading['invalid'])}" if "invalid" in heading else ""
    lines = (f'attitude = {{columns = [{column}], unit = "{heading["unit"]}"{invalid}}}',)
    words = "; ".join(filter(None, [stream.guess, "level: there is no roll and pitch in this log"]))
    return replace(stream, lines=lines, guess=words)

"""A mission.toml and a vehicle.toml for a log, ready to be replayed; what had to be guessed is marked."""

from __future__ import annotations

import datetime
import json
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from navfilter.alignment import align
from navfilter.io.logs.draft_vehicle import LIKE, vehicle_text
from navfilter.io.logs.known import READINGS, Use, uses_of
from navfilter.io.logs.survey import Survey, Topic
from navfilter.io.mission_toml import read_mission_toml
from navfilter.io.vehicle_toml import read_vehicle
from navfilter.mission import Mission, MissionError, Stream
from navfilter.sensors import Heading, Position
from navfilter.start import Start
from navfilter.vehicle import Vehicle

__all__ = ["Draft", "draft"]

GUESS = "# GUESSED: "
#: A slower inertial unit cannot carry the state between its samples [Hz].
_SLOWEST_IMU_HZ = 20.0
#: Instruments' own stamps are used where they keep step with the recorder's to this [s].
_STEADY_S = 1.0
_CORRECTING = (
    ("compass", ("heading", "magnetic", "field")),
    ("dvl", ("velocity",)),
    ("odometry", ("odometry",)),
    ("depth", ("depth", "pressure")),
    ("gps", ("position",)),
)
_ATTITUDES = ("attitude", "heading", "magnetic", "course")
_VELOCITIES = ("velocity", "odometry", "water", "speed")
#: Without any of these an inertial unit drifts away within a minute.
_AIDS = ("velocity", "odometry", "position")


@dataclass(frozen=True)
class Draft:
    """Two files as text, and what they make of the log.

    Parameters
    ----------
    mission_toml, vehicle_toml : str
    mission : Mission
        As the mission.toml reads it.
    guesses : tuple of str
        What is marked in the files.
    """

    mission_toml: str
    vehicle_toml: str
    mission: Mission
    guesses: tuple[str, ...]


@dataclass(frozen=True)
class _Stream:
    name: str
    reading: str
    topic: Topic
    lines: tuple[str, ...]
    where: str = ""
    guess: str = ""


def draft(found: Survey, folder: Path, like: str = "") -> Draft:
    """Write both files for a log.

    Parameters
    ----------
    found : Survey
    folder : Path
        Where the files will stand; the log is named relative to it where it lies beside or below it.
    like : str
        Key of `LIKE`: whose sensors' errors are taken; empty: those that fit what drives.

    Raises
    ------
    MissionError
        If nothing in the log can drive.
    """
    uses = uses_of(found)
    driving, drive = _driving(found, uses, like)
    streams, dropped = _readable(found, driving, _correcting(uses, drive))
    clock = _clock(streams)
    begin = "".join(f"{line}\n" for line in dropped)
    mission = _read(_mission_text(found, streams, clock, str(found.path.resolve()), begin))
    readings = {stream.name: stream.reading for stream in streams}
    vehicle_toml = vehicle_text(mission, readings, drive, like or ("bluerov2" if drive == "imu" else "yacht"))
    begin += _start(_vehicle(vehicle_toml), mission)
    mission_toml = _mission_text(found, streams, clock, _named(found.path, folder), begin)
    texts = (mission_toml + vehicle_toml).splitlines()
    guesses = tuple(dict.fromkeys(line.removeprefix(GUESS) for line in texts if line.startswith(GUESS)))
    return Draft(mission_toml, vehicle_toml, mission, guesses)


def _readable(found: Survey, driving: list[_Stream], others: list[_Stream]) -> tuple[list[_Stream], list[str]]:
    """The streams that can be read, and a comment for each that cannot (say, because no reading is valid)."""
    file, clock = str(found.path.resolve()), _clock([*driving, *others])
    try:
        _read(_mission_text(found, [*driving, *others], clock, file, ""))
        return [*driving, *others], []
    except MissionError:
        pass
    kept, dropped = [], []
    for stream in [*driving, *others]:
        try:
            _read(_mission_text(found, [stream], clock, file, ""))
            kept.append(stream)
        except MissionError as error:
            if stream.name == "velocity":
                kept.append(_still(kept[0]))
            elif stream in driving:
                raise MissionError(f"{found.path}: {stream.name}, which is to drive: {_one_line(error)}") from None
            dropped.append(f"# {stream.name} from {stream.topic.name} is left out: {_one_line(error)}")
    return kept, dropped


def _read(text: str) -> Mission:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mission.toml"
        path.write_text(text, encoding="utf-8")
        return read_mission_toml(path)


def _vehicle(text: str) -> Vehicle:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_text(text, encoding="utf-8")
        return read_vehicle(path)


# --- what drives, what corrects ---------------------------------------------------------------------------------------


def _driving(found: Survey, uses: list[tuple[Topic, Use]], like: str) -> tuple[list[_Stream], str]:
    imu = [(topic, use) for topic, use in uses if use.reading == "imu" and topic.rate_hz >= _SLOWEST_IMU_HZ]
    attitude = _first(uses, _ATTITUDES)
    aided = _first(uses, _AIDS) is not None or attitude is None
    if imu and aided and (not like or LIKE[like].drive == "imu"):
        return [_stream("imu", *imu[0])], "imu"
    if attitude is None:
        known = ", ".join(f"{topic.name} ({READINGS[use.reading]})" for topic, use in uses) or "none of a known kind"
        raise MissionError(
            f"{found.path}: nothing in this log can drive; it takes turn rates with forces at {_SLOWEST_IMU_HZ:g} Hz or more, or a"
            f" heading. Known topics: {known}. Map it by hand (docs/logs.md)."
        )
    level = _as_attitude(_stream("attitude", *attitude))
    velocity = _first(uses, _VELOCITIES)
    return [level, _still(level) if velocity is None else _stream("velocity", *velocity)], "dead-reckoning"


def _still(attitude: _Stream) -> _Stream:
    """A velocity of zero at the times of the attitude, for a log without any."""
    line = (
        'velocity = {columns = [{column = "log_time", scale = 0.0}, {constant = 0.0}, {constant = 0.0}], unit = "m/s"}'
    )
    words = (
        "there is no velocity in this log: the vehicle is taken to stand still, give or take the error in vehicle.toml"
    )
    return _Stream("velocity", "none", attitude.topic, (line,), attitude.where, words)


def _correcting(uses: list[tuple[Topic, Use]], drive: str) -> list[_Stream]:
    wanted = [(name, readings) for name, readings in _CORRECTING if drive == "imu" or name in ("depth", "gps")]
    chosen = [(name, _first(uses, readings)) for name, readings in wanted]
    return [_stream(name, *use) for name, use in chosen if use is not None]


def _first(uses: list[tuple[Topic, Use]], readings: tuple[str, ...]) -> tuple[Topic, Use] | None:
    return next((pair for reading in readings for pair in uses if pair[1].reading == reading), None)


def _stream(name: str, topic: Topic, use: Use) -> _Stream:
    return _Stream(name, use.reading, topic, use.lines, use.where, use.guess)


def _as_attitude(stream: _Stream) -> _Stream:
    """A heading alone as roll, pitch and heading, level."""
    line = stream.lines[0]
    if not line.startswith("heading"):
        return stream
    column = line.split('column = "', 1)[1].split('"', 1)[0]
    lines = (f'attitude = {{columns = [{{constant = 0.0}}, {{constant = 0.0}}, "{column}"], unit = "deg"}}',)
    words = "; ".join(filter(None, [stream.guess, "level: there is no roll and pitch in this log"]))
    return replace(stream, lines=lines, guess=words)


# --- the mission.toml -------------------------------------------------------------------------------------------------


def _clock(streams: list[_Stream]) -> str:
    """The column with the times: instruments' own stamps where all keep step with the recorder, else the recorder's."""
    lags = []
    for stream in streams:
        column = stream.topic.columns.get("header.stamp")
        if column is None:
            return "log_time"
        lag = stream.topic.time_s[: column.size] - column
        lags += [float(np.median(lag)), float(lag.min())]
    return "header.stamp" if lags and max(lags) - min(lags) < _STEADY_S else "log_time"


def _named(path: Path, folder: Path) -> str:
    """The log as the mission.toml names it."""
    path, folder = path.resolve(), folder.resolve()
    near = path.is_relative_to(folder) or path.is_relative_to(folder.parent)
    return os.path.relpath(path, folder).replace(os.sep, "/") if near else str(path)


def _mission_text(found: Survey, streams: list[_Stream], clock: str, file: str, begin: str) -> str:
    lines = [
        f"# From {found.path.name} ({found.format.title}). Lines that begin with GUESSED are to be looked at; the rest is",
        "# what the log says. 'navfilter check' with this folder looks for the usual mistakes.",
        "",
        f"name = {json.dumps(found.path.name.split('.')[0])}",
    ]
    if found.is_utc:
        lines.append(f"date = {datetime.datetime.fromtimestamp(found.begin_s, datetime.UTC).date()}")
    lines += ['zero_s = "first"', "", begin.rstrip("\n")] if begin else ['zero_s = "first"', ""]
    if begin:
        lines.append("")
    for stream in streams:
        said = READINGS.get(stream.reading, "no reading at all")
        lines.append(f"# {stream.topic.name}: {said}; {stream.topic.count} records, {stream.topic.rate_hz:.3g} Hz.")
        lines += [f"{GUESS}{stream.guess}"] if stream.guess else []
        lines += [f"[streams.{stream.name}]", f"file = {json.dumps(file)}", f"topic = {json.dumps(stream.topic.name)}"]
        lines += [f'time = {{column = "{clock}"}}', *stream.lines]
        lines += [f"where = {stream.where}"] if stream.where else []
        lines.append("")
    others = sorted({topic.name for topic in found.topics} - {stream.topic.name for stream in streams})
    if others:
        lines.append(f"# Not used: {', '.join(others[:30])}{' and others' if len(others) > 30 else ''}.")
    return "\n".join(lines).rstrip() + "\n"


def _start(vehicle: Vehicle, mission: Mission) -> str:
    """A [start] where the mission's own readings give none; empty where they do."""
    reasons: list[str] = []
    for assumed in ((), ("position",), ("position", "heading")):
        try:
            start = align(*_assuming(vehicle, mission, assumed))
        except ValueError as error:
            reasons.append(_one_line(error).removeprefix("no start: ").split(". ")[0].split(" (")[0].rstrip("."))
            continue
        return _start_text(start, assumed, reasons) if assumed else ""
    return _start_text(
        Start(time_s=_first_s(vehicle, mission), latitude_deg=0.0, longitude_deg=0.0, tilt_sd_deg=5.0),
        ("position", "heading", "level"),
        reasons,
    )


def _assuming(vehicle: Vehicle, mission: Mission, what: tuple[str, ...]) -> tuple[Vehicle, Mission]:
    """Vehicle and mission with one reading of each sensor that is lacking for an alignment: at 0, 0, heading north."""
    at = np.array([_first_s(vehicle, mission)])
    sensors, streams = dict(vehicle.sensors), dict(mission.streams)
    if "position" in what and "gps" not in streams:
        sensors["assumed_position"] = Position()
        streams["assumed_position"] = Stream(at, np.zeros((1, 3)), ("latitude_rad", "longitude_rad", "height_m"))
    if "heading" in what:
        sensors = {name: sensor for name, sensor in sensors.items() if not isinstance(sensor, Heading)}
        sensors["assumed_heading"] = Heading()
        streams["assumed_heading"] = Stream(at, np.zeros((1, 1)), ("heading_rad",))
    return replace(vehicle, sensors=sensors), replace(mission, streams=streams)


def _first_s(vehicle: Vehicle, mission: Mission) -> float:
    drive = mission.streams[vehicle.drive.streams[0]]
    usable = np.isfinite(drive.value).all(axis=1)
    return float(drive.time_s[np.argmax(usable)])


def _start_text(start: Start, assumed: tuple[str, ...], reasons: list[str]) -> str:
    unknown = {"position": "at 0, 0", "heading": "heading north", "level": "level and at rest"}
    lines = [
        f"{GUESS}the beginning, {', '.join(unknown[key] for key in assumed)}: {reasons[0]}",
        "[start]",
        f"time_s = {start.time_s:.3f}",
        f"latitude_deg = {start.latitude_deg:.7f}",
        f"longitude_deg = {start.longitude_deg:.7f}",
        f"velocity_n = [{', '.join(f'{speed:.3f}' for speed in start.velocity_n)}]",
        f"roll_deg = {start.roll_deg:.2f}",
        f"pitch_deg = {start.pitch_deg:.2f}",
        f"heading_deg = {start.heading_deg:.1f}",
        f"tilt_sd_deg = {max(start.tilt_sd_deg, 1.0):.2f}",
        f"heading_sd_deg = {30.0 if 'heading' in assumed else 5.0}",
        "velocity_sd_m_s = 0.5",
    ]
    return "\n".join(lines) + "\n"


def _one_line(error: ValueError) -> str:
    return str(error).replace("\n", " ")

"""A mission.toml and a vehicle.toml for a log, ready to be replayed; what had to be guessed is marked.

Which topics of a log become which streams: what drives, what corrects, and what stands in for what is lacking.
"""

import datetime
import json
import os
import tempfile
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.quoting import one_line, toml_text
from navfilter.io.logs.draft_vehicle import LIKE, usual_kind, vehicle_text
from navfilter.io.logs.formats import format_of
from navfilter.io.logs.guessed_columns import TABLE, survey_table
from navfilter.io.logs.known_topics import READINGS, Use, uses_of
from navfilter.io.logs.survey import Survey, Topic, survey
from navfilter.io.logs.topic_names import INSTRUMENT
from navfilter.io.mission_toml import read_mission_toml
from navfilter.io.trust import UNPACKED_BYTES
from navfilter.io.vehicle_toml import read_vehicle
from navfilter.models.alignment import align
from navfilter.models.mission import Mission, MissionError, Stream
from navfilter.models.sensors import Heading, Position
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle

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


GUESS = "# GUESSED: "
#: An assumed place beside latitude and longitude zero, by less than a hair [rad].
NOWHERE_RAD = 1e-12
#: Instruments' own stamps are used where they keep step with the recorder's to this [s].
_STEADY_S = 1.0


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


def draft(found: Survey, folder: Path, like: str = "") -> Draft:
    """Write both files for a log.

    Parameters
    ----------
    found : Survey
    folder : Path
        Where the files will stand; the log is named relative to it where it lies beside or below it.
    like : str
        Key of `LIKE`: whose sensors' errors are taken; empty: those usual for the format.

    Raises
    ------
    MissionError
        If nothing in the log can drive.
    """
    driving, correcting, drive = chosen_streams(found, like)
    streams, dropped, mission = _readable(found, driving, correcting)
    begin = "".join(f"{line}\n" for line in dropped)
    readings = {stream.name: stream.reading for stream in streams}
    topics = {stream.name: stream.topic for stream in streams}
    vehicle_toml = vehicle_text(mission, readings, drive, like or usual_kind(found.format.module, drive), topics)
    begin += _start(_vehicle(vehicle_toml), mission)
    mission_toml = _mission_text(found, streams, _named(found.path, folder), begin)
    texts = (mission_toml + vehicle_toml).splitlines()
    guesses = tuple(dict.fromkeys(line.removeprefix(GUESS) for line in texts if line.startswith(GUESS)))
    return Draft(mission_toml, vehicle_toml, mission, guesses)


def survey_of(path: Path, unpacked_bytes: int = UNPACKED_BYTES) -> Survey:
    """A log's survey, or that of a table, whose columns are guessed.

    Raises
    ------
    MissionError
        Where it is neither.
    """
    if path.is_file() and format_of(path) is None and is_table(path):
        return survey_table(path, unpacked_bytes)
    return survey(path, unpacked_bytes)


def is_table(path: Path) -> bool:
    """Whether a file is called as tables of text are, plain or compressed."""
    return any(ending.lower() in TABLE.suffixes for ending in path.suffixes[-2:])


def read_inertial(found: Survey, topic: Topic, use: Use) -> Mission:
    """The inertial unit of a log alone, as stream ``imu`` of a mission."""
    return _read(found, _mission_text(found, [inertial(topic, use)], str(found.path.resolve()), ""))


def _readable(found: Survey, driving: list[Drafted], others: list[Drafted]) -> tuple[list[Drafted], list[str], Mission]:
    """The streams that can be read, a comment for each that cannot (no reading is valid, say), and the mission."""
    file, streams = str(found.path.resolve()), [*driving, *others]
    try:
        return streams, [], _read(found, _mission_text(found, streams, file, ""))
    except MissionError:
        pass
    kept, dropped = [], []
    for stream in streams:
        try:
            _read(found, _mission_text(found, [stream], file, ""))
            kept.append(stream)
        except MissionError as error:
            if stream.name == "velocity":
                kept.append(still(kept[0]))
            elif stream in driving:
                raise MissionError(f"{found.path}: {stream.name}, which is to drive: {_words(error)}") from None
            dropped.append(f"# {stream.name} from {one_line(stream.topic.name)} is left out: {_words(error)}")
    return kept, dropped, _read(found, _mission_text(found, kept, file, ""))


def _read(found: Survey, text: str) -> Mission:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mission.toml"
        path.write_text(text, encoding="utf-8")
        return read_mission_toml(path, unpacked_bytes=found.unpacked_bytes)


def _vehicle(text: str) -> Vehicle:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_text(text, encoding="utf-8")
        return read_vehicle(path)


# --- the mission.toml -----------------------------------------------------------------------------------------------


def _clock(streams: list[Drafted]) -> str:
    """The column with the times: instruments' own stamps where all keep step with the recorder, else the recorder's."""
    lags = []
    for stream in streams:
        column = stream.topic.columns.get("header.stamp")
        if column is None:
            return "log_time"
        lag = stream.topic.time_s[: column.size] - column
        lags += [float(np.median(lag)), float(lag.min())]
    return "header.stamp" if lags and max(lags) - min(lags) < _STEADY_S else "log_time"


def _epoch_utc_s(found: Survey) -> float | None:
    """UTC at which the log's times read zero [s since 1970], by themselves or by a receiver in it; None: unknown."""
    if found.is_utc:
        return 0.0
    for topic in found.topics:
        if topic.has("time_utc_usec"):
            told = topic.columns["time_utc_usec"]
            known = told > 1e15
            if topic.has("fix_type"):
                known &= topic.columns["fix_type"] >= 3
            if known.any():
                return float(np.median(1e-6 * told[known] - topic.time_s[: told.size][known]))
    return None


def _named(path: Path, folder: Path) -> str:
    """The log as the mission.toml names it."""
    path, folder = path.resolve(), folder.resolve()
    near = path.is_relative_to(folder) or path.is_relative_to(folder.parent)
    return os.path.relpath(path, folder).replace(os.sep, "/") if near else str(path)


def _mission_text(found: Survey, streams: list[Drafted], file: str, begin: str) -> str:
    clock = f'{{column = "{_clock(streams)}"}}'
    lines = [
        f"# From {one_line(found.path.name)} ({found.format.title}). Lines that begin with GUESSED are to be looked",
        "# at; the rest is what the file says. 'navfilter check' with this folder looks for the usual mistakes.",
        "",
        f"name = {toml_text(found.path.name.split('.')[0])}",
    ]
    if (epoch_s := _epoch_utc_s(found)) is not None:
        lines.append(f"date = {datetime.datetime.fromtimestamp(epoch_s + found.begin_s, datetime.UTC).date()}")
    if found.clock == INSTRUMENT:
        lines += [
            f"{GUESS}the times are of the instrument's clock, which need not be UTC; where it is, leave epoch out"
        ]
        lines.append('epoch = "unknown"')
    if epoch_s:
        lines.append(f"epoch = {utc.date_text(0.0, epoch_s)}  # by the satellite receiver in the log")
    lines += [f"{GUESS}{found.doubt}"] if found.doubt else []
    lines += ['zero_s = "first"', "", begin.rstrip("\n")] if begin else ['zero_s = "first"', ""]
    if begin:
        lines.append("")
    for stream in streams:
        said = READINGS.get(stream.reading, "no reading at all")
        named = one_line(stream.topic.name or found.path.name)
        lines.append(f"# {named}: {said}; {stream.topic.count} records, {stream.topic.rate_hz:.3g} Hz.")
        lines += [f"{GUESS}{stream.guess}"] if stream.guess else []
        lines += [f"[streams.{stream.name}]", f"file = {toml_text(file)}"]
        lines += found.layout if found.time else [f"topic = {toml_text(stream.topic.name)}"]
        lines += [f"time = {found.time or clock}", *stream.lines]
        lines += ["stands_in = true"] if stream.stands_in else []
        lines += [f"where = {stream.where}"] if stream.where else []
        lines.append("")
    others = sorted({topic.name for topic in found.topics} - {stream.topic.name for stream in streams})
    if others:
        lines.append(f"# Not used: {', '.join(map(one_line, others[:30]))}{' and others' if len(others) > 30 else ''}.")
    return "\n".join(lines).rstrip() + "\n"


def _start(vehicle: Vehicle, mission: Mission) -> str:
    """A [start] where the mission's own readings give none; empty where they do."""
    reasons: list[str] = []
    for assumed in ((), ("heading",), ("position",), ("position", "heading")):
        try:
            start = align(*_assuming(vehicle, mission, assumed))
        except ValueError as error:
            reasons.append(_words(error).removeprefix("no start: ").split(". ")[0].split(" (")[0].rstrip("."))
            continue
        return _start_text(start, assumed, reasons) if assumed else ""
    fix = first_fix(mission)
    time_s, latitude, longitude = fix or (_first_s(vehicle, mission), 0.0, 0.0)
    start = Start(time_s=time_s, latitude_deg=latitude, longitude_deg=longitude, tilt_sd_deg=5.0)
    return _start_text(start, ("heading", "level") if fix else ("position", "heading", "level"), reasons)


def first_fix(mission: Mission) -> tuple[float, float, float] | None:
    """Time, latitude and longitude [deg] of the first fix of the stream ``gps``; None where there is none."""
    gps = mission.streams.get("gps")
    good = (
        np.array([])
        if gps is None
        else np.flatnonzero(np.isfinite(gps.value[:, :2]).all(axis=1) & gps.value[:, 0].astype(bool))
    )
    if gps is None or not good.size:
        return None
    latitude, longitude = np.degrees(gps.value[good[0], :2])
    return float(gps.time_s[good[0]]), float(latitude), float(longitude)


def _assuming(vehicle: Vehicle, mission: Mission, what: tuple[str, ...]) -> tuple[Vehicle, Mission]:
    """Vehicle and mission with one reading of each sensor that is lacking for an alignment: at 0, 0, heading north."""
    at = np.array([_first_s(vehicle, mission)])
    sensors, streams = dict(vehicle.sensors), dict(mission.streams)
    if "position" in what and "gps" not in streams:
        sensors["assumed_position"] = Position()
        # exactly there is where a receiver says it is that has no fix
        place = np.array([[NOWHERE_RAD, NOWHERE_RAD, 0.0]])
        streams["assumed_position"] = Stream(at, place, ("latitude_rad", "longitude_rad", "height_m"))
    if "heading" in what:
        sensors = {name: sensor for name, sensor in sensors.items() if sensor.gives != "heading"}
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
    if "position" in assumed:
        lines.append("position_sd_m = 0.1                  # north and east count from here")
    return "\n".join(lines) + "\n"


def _words(error: ValueError) -> str:
    return one_line(" ".join(str(error).splitlines()))

"""A mission.toml and a vehicle.toml for a log, ready to be replayed; what had to be guessed is marked.

Which topics of a log become which streams: what drives, what corrects, and what stands in for what is lacking.

A vehicle.toml for the streams of a log: which sensors there are, and how such sensors usually err.
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
from navfilter.io.logs.formats import format_of
from navfilter.io.logs.guessed_columns import READINGS, TABLE, Use, survey_table, uses_of
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

GUESS = "# GUESSED: "


@dataclass(frozen=True)
class Like:
    """How the sensors of a kind of vehicle err.

    Parameters
    ----------
    about : str
        In words.
    drive : str
        ``"imu"`` or ``"dead-reckoning"``.
    gyro_density, accel_density : float
        White noise of an inertial unit at rest [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    gyro_bias, accel_bias, heading, tilt, velocity, water, depth, position : str
        Error models, as a vehicle.toml has them.
    """

    about: str
    drive: str
    gyro_density: float
    gyro_bias: str
    accel_density: float
    accel_bias: str
    heading: str
    tilt: str
    velocity: str
    water: str
    depth: str
    position: str


def _kinds() -> dict[str, Like]:
    """The kinds by name, each with the inertial unit that is usual for it."""
    told = tomllib.loads(Path(__file__).with_name("usual_errors.toml").read_text(encoding="utf-8"))
    return {name: Like(**told["units"][kind.pop("unit")], **kind) for name, kind in told["kinds"].items()}


LIKE = _kinds()
#: Wheels slip, cameras lose their scale.
_ODOMETRY = '[{model = "gauss-markov", sd = 0.2, tau_s = 2}, {model = "white", sd = 0.1}]'
#: Velocity of a receiver, whose antenna moves with the vessel.
_RECEIVER = '[{model = "gauss-markov", sd = 0.1, tau_s = 5}, {model = "white", sd = 0.1}]'
#: Of the angle between a beam and the vertical, at least.
_SINE = 0.25
#: A vessel has its antenna above the sea; heights of fixes and of dead reckoning say less.
_AFLOAT = [
    f"{GUESS}a vessel afloat, its antenna so far above the sea [m]; of others leave it out",
    "antenna_height_m = 2.0",
]
#: How far off a speed is that nobody measured.
_UNKNOWN_SPEED = '{model = "gauss-markov", sd = 0.5, tau_s = 120}'


def usual_kind(module: str, drive: str) -> str:
    """Key of `LIKE` for a format of logs and the type of the drive."""
    usual = {
        "ardupilot": "bluerov2",
        "waterlinked": "bluerov2",
        "slocum": "glider",
        "nmea": "yacht",
        "expedition": "yacht",
    }
    return usual.get(module, "bluerov2" if drive == "imu" else "yacht")


def vehicle_text(mission: Mission, readings: dict[str, str], drive: str, like: str, topics: dict[str, Topic]) -> str:
    """The vehicle.toml for a drafted mission.

    Parameters
    ----------
    mission : Mission
    readings : dict of str to str
        Stream -> what it reads (see `navfilter.io.logs.guessed_columns.READINGS`).
    drive : str
        ``"imu"`` or ``"dead-reckoning"``.
    like : str
        Key of `LIKE`.
    topics : dict of str to Topic
        Stream -> what it is read from.
    """
    kind = LIKE[like]
    # without a depth gauge nothing but the sea keeps dead reckoning at its surface
    afloat = drive != "imu" and "depth" not in readings
    lines = [
        "# What is on board, and how it errs. Rates are those of the log; 'navfilter vehicle --check' says it in",
        "# words, and 'navfilter vehicle --init' lists every key that there is.",
        f"{GUESS}the errors, as of {kind.about}; 'navfilter identify' finds them from the log",
        f"{GUESS}lever arms and mountings, all zero: set lever_arm_b_m and mounting_deg of each sensor",
        f'name = "like {like}"',
        "",
    ]
    lines += _drive(mission, readings, drive, kind)
    for name in ("compass", "dvl", "odometry", "depth", "gps", "course"):
        if name in readings:
            own = _sensor(name, readings[name], kind, mission, topics[name], afloat)
            lines += [f"[sensors.{name}]", *own, ""]
    return "\n".join(lines).rstrip() + "\n"


def _drive(mission: Mission, readings: dict[str, str], drive: str, kind: Like) -> list[str]:
    lines: list[str] = []
    if drive == "imu":
        lines += [
            "[drive]",
            'type = "imu"',
            _rate(mission.streams["imu"]),
            *_inertial(mission.streams["imu"], kind),
            "",
        ]
    else:
        lines += ["[drive]", 'type = "dead-reckoning"', _rate(mission.streams["velocity"]), f"tilt = {kind.tilt}"]
        lines += [
            "",
            "[drive.attitude]",
            'type = "heading"',
            f"error = {kind.heading}",
            *_declined(mission, readings["attitude"]),
            "",
        ]
        unknown = _UNKNOWN_SPEED
        if "dvl" in readings:
            typical = float(np.nanmax(np.abs(mission.streams["dvl"].value), initial=0.1)) / _SINE
            unknown = f'{{model = "gauss-markov", sd = {max(typical, 0.5):.2g}, tau_s = 20}}'
        speeds = {"none": unknown, "water": kind.water, "odometry": _ODOMETRY}
        error = speeds.get(readings["velocity"], kind.velocity)
        lines += ["[drive.velocity]", 'type = "body-velocity"', f"error = {error}", "zero_is_invalid = false", ""]
    return lines


def _inertial(stream: Stream, kind: Like) -> list[str]:
    """The errors of gyros and accelerometers; the scatter from sample to sample is also the vehicle's shaking."""
    step_s = float(np.median(np.diff(stream.time_s)))
    change = np.abs(np.diff(stream.value, axis=0))
    # Median of |x[k+1] - x[k]| of white noise of sd s: 0.6745 * sqrt(2) * s.
    density = np.nanmedian(change, axis=0) / (0.6745 * np.sqrt(2.0)) * np.sqrt(step_s)
    gyro, accel = float(density[:3].max()), float(density[3:6].max())
    words = f"{GUESS}gyro.white and accel.white: not below the scatter from sample to sample in this log"
    return [
        words,
        f'gyro = [{{model = "white", density = {max(gyro, kind.gyro_density):.2g}}}, {kind.gyro_bias}]',
        f'accel = [{{model = "white", density = {max(accel, kind.accel_density):.2g}}}, {kind.accel_bias}]',
    ]


def _sensor(name: str, reading: str, kind: Like, mission: Mission, topic: Topic, afloat: bool) -> list[str]:
    rate = _rate(mission.streams[name])
    if name == "compass":
        iron = f"{GUESS}the magnetometer needs no calibration; else set hard_iron and soft_iron"
        field = [iron, "magnetometer = true"] if reading == "field" else []
        return ['type = "heading"', rate, f"error = {kind.heading}", *field, *_declined(mission, reading)]
    if name == "odometry":
        return ['type = "body-velocity"', rate, f"error = {_ODOMETRY}", "zero_is_invalid = false"]
    if name == "dvl" and reading == "beams":
        return ['type = "dvl-beams"', rate, f"error = {kind.velocity}", *_geometry(topic)]
    if name == "dvl":
        return ['type = "body-velocity"', rate, f"error = {kind.velocity}"]
    if name == "course":
        return ['type = "course"', rate, f"error = {_RECEIVER}"]
    if name == "depth":
        by_pressure = reading in ("pressure", "gauge-pressure")
        pressure = ["pressure = true                       # absolute, from the surface's 101325 Pa"] * by_pressure
        return ['type = "depth"', rate, f"error = {kind.depth}", *pressure]
    return ['type = "position"', rate, f"error = {kind.position}", *(_AFLOAT if afloat else [])]


def _geometry(topic: Topic) -> list[str]:
    """Where the beams of a Teledyne instrument look: 1 to port, 2 to starboard, 3 forward, 4 aft."""
    tilt = float(np.nanmedian(topic.columns["beam_tilt"]))
    return ["beam_azimuth_deg = [270.0, 90.0, 0.0, 180.0]", f"beam_tilt_deg = {tilt:g}", "zero_is_invalid = false"]


def _declined(mission: Mission, reading: str) -> list[str]:
    """Which north a heading counts from."""
    if reading.startswith("magnetic") or reading == "field":
        known = mission.date is not None and 2010 <= mission.date.year < 2030 and "gps" in mission.streams
        magnetic = [] if reading == "field" else ["magnetic = true"]
        if known:
            return magnetic
        return [
            *magnetic,
            f"{GUESS}no declination: it needs a date (2010 to 2029) and a place",
            "declination_deg = 0.0",
        ]
    return []


def _rate(stream: Stream) -> str:
    """The rate between gaps, to three digits."""
    step = np.diff(stream.time_s)
    step = step[(step > 0) & (step <= 10.0 * max(float(np.median(step)), float(step.mean())))] if step.size else step
    rate = step.size / float(step.sum()) if step.size else 1.0
    return f"rate_hz = {float(f'{rate:.3g}'):g}"


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

"""A vehicle.toml for the streams of a log: which sensors there are, and how such sensors usually err."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navfilter.io.logs.survey import Topic
from navfilter.models.mission import Mission, Stream

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
        Stream -> what it reads (see `navfilter.io.logs.known_topics.READINGS`).
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
            *_north(mission, readings["attitude"]),
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
        return ['type = "heading"', rate, f"error = {kind.heading}", *field, *_north(mission, reading)]
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


def _north(mission: Mission, reading: str) -> list[str]:
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

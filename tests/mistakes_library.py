"""Mistakes of mappings and vehicle files as functions: a sound vehicle and mission go in, spoiled ones come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navfilter.check import check_mission
from navfilter.check.finding import Finding
from navfilter.check.plausibility import check_vehicle
from navfilter.evaluation.assessment import Verdict, assess
from navfilter.io.write import labelled
from navfilter.models.error_models import GaussMarkov, White
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.simulation.scenarios import simulate_scenario

Spoiled = tuple[Vehicle, Mission]
Mistake = Callable[[Vehicle, Mission], Spoiled]
DEG, G = np.pi / 180.0, 9.80665


def sound() -> Spoiled:
    """The dive of the manual's page "Replay your mission", where the truth is not known."""
    vehicle, mission = simulate_scenario("lawnmower", seed=42, duration_s=600)
    velocity = mission.streams["dvl"].value.copy()
    velocity[1200:1300] = np.nan
    return vehicle, replace(mission.with_stream("dvl", replace(mission.streams["dvl"], value=velocity)), truth=None)


def values(name: str, change: Callable[[Any], Any]) -> Mistake:
    """A mistake that changes the readings of a stream."""

    def spoil(vehicle: Vehicle, mission: Mission) -> Spoiled:
        stream = mission.streams[name]
        value = np.ascontiguousarray(change(stream.value.copy()))
        return vehicle, mission.with_stream(name, replace(stream, value=value))

    return spoil


def clock(name: str, scale: float = 1.0, offset_s: float = 0.0) -> Mistake:
    """A mistake that changes the times of a stream."""

    def spoil(vehicle: Vehicle, mission: Mission) -> Spoiled:
        stream = mission.streams[name]
        return vehicle, mission.with_stream(name, replace(stream, time_s=scale * stream.time_s + offset_s))

    return spoil


def described(**errors: Any) -> Mistake:
    """A mistake in the vehicle.toml: an error model."""
    return lambda vehicle, mission: (vehicle.with_error(**errors), mission)


def columns(*factors: float) -> Callable[[Any], Any]:
    """Each column by a factor."""
    return lambda value: value * np.array(factors)


def turned(deg: float) -> Callable[[Any], Any]:
    """A velocity turned about z."""
    c, s = np.cos(deg * DEG), np.sin(deg * DEG)
    return lambda value: value @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


def _held(vehicle: Vehicle, mission: Mission) -> Spoiled:
    """Fixes that a logger repeats ten times a second, on through the dive."""
    gps = mission.streams["gps"]
    time = np.arange(gps.time_s[0], mission.streams["dvl"].time_s[-1], 0.1)
    index = np.searchsorted(gps.time_s, time, side="right") - 1
    return vehicle, mission.with_stream("gps", Stream(time, gps.value[index], gps.columns))


def _nowhere(vehicle: Vehicle, mission: Mission) -> Spoiled:
    """Latitude and longitude 0 while the receiver has no fix: in the first 20 s and all through the dive."""
    gps = mission.streams["gps"]
    time = np.arange(gps.time_s[0], gps.time_s[-1], 1.0)
    value = np.zeros((time.size, 3))
    at = np.searchsorted(time, gps.time_s[20:-1])
    value[np.minimum(at, time.size - 1)] = gps.value[20:-1]
    return vehicle, mission.with_stream("gps", Stream(time, value, gps.columns))


def _feet(value: Any) -> Any:
    return value / 0.3048


def _minutes(value: Any) -> Any:
    """ddmm.mmmm of an NMEA sentence taken for degrees."""
    deg = np.abs(value[:, :2]) / DEG
    value[:, :2] = np.sign(value[:, :2]) * (np.floor(deg) * 100.0 + 60.0 * (deg - np.floor(deg))) * DEG
    return value


def _of_the_earth(vehicle: Vehicle, mission: Mission) -> Spoiled:
    """East, north, up, as an instrument with a compass of its own gives them."""
    compass, dvl = mission.streams["compass"], mission.streams["dvl"]
    heading = np.interp(dvl.time_s, compass.time_s, np.unwrap(compass.value[:, 0]))
    turned = (dvl.value[:, 0] + 1j * dvl.value[:, 1]) * np.exp(1j * heading)
    value = np.column_stack([turned.imag, turned.real, -dvl.value[:, 2]])
    return vehicle, mission.with_stream("dvl", replace(dvl, value=value))


def _sentinel(value: Any) -> Any:
    """-32768 mm/s, where the bottom is lost, taken for a velocity."""
    value[np.isnan(value).any(axis=1)] = -32.768
    return value


#: What was done wrong -> how it spoils the mission.
MISTAKES: dict[str, Mistake] = {
    "IMU: milliseconds read as seconds": clock("imu", scale=1e3),
    "IMU: clock one hour off": clock("imu", offset_s=3600.0),
    "IMU: GPS time, 18 s ahead of the others' UTC": clock("imu", offset_s=18.0),
    "IMU: deg/s read as rad/s": values("imu", columns(1 / DEG, 1 / DEG, 1 / DEG, 1, 1, 1)),
    "IMU: g read as m/s^2": values("imu", columns(1, 1, 1, 1 / G, 1 / G, 1 / G)),
    "IMU: forward-left-up read as forward-right-down": values("imu", columns(1, -1, -1, 1, -1, -1)),
    "IMU: sign of the yaw rate": values("imu", columns(1, 1, -1, 1, 1, 1)),
    "DVL: mm/s read as m/s": values("dvl", columns(1e3, 1e3, 1e3)),
    "DVL: mirrored (y to the left)": values("dvl", columns(1, -1, 1)),
    "DVL: mounted at 45 deg, not said": values("dvl", turned(45.0)),
    "DVL: forward and starboard exchanged": values("dvl", lambda v: v[:, [1, 0, 2]]),
    "DVL: east, north, up instead of forward, right, down": _of_the_earth,
    "DVL: velocity of the bottom, not over it": values("dvl", columns(-1, -1, -1)),
    "DVL: -32768 is no velocity, not said": values("dvl", _sentinel),
    "DVL: 2 s late": clock("dvl", offset_s=2.0),
    "DVL: 600 s stretched over 601.5 s": clock("dvl", scale=1.0025),
    "compass: deg read as rad": values("compass", lambda v: v / DEG),
    "compass: counts the other way round": values("compass", lambda v: -v),
    "compass: 90 deg off": values("compass", lambda v: v + 0.5 * np.pi),
    "compass: 7.4 deg off": values("compass", lambda v: v + 7.4 * DEG),
    "depth: counts upwards": values("depth", lambda v: -v),
    "depth: feet read as metres": values("depth", _feet),
    "depth: hPa read as m": values("depth", lambda v: 1013.25 + 100.0 * v),
    "GPS: latitude and longitude exchanged": values("gps", lambda v: v[:, [1, 0, 2]]),
    "GPS: degrees and minutes read as degrees": values("gps", _minutes),
    "GPS: 0, 0 while there is no fix": _nowhere,
    "GPS: held readings": _held,
    "GPS: west positive": values("gps", columns(1, -1, 1)),
    "GPS: GPS time, 18 s ahead of the others' UTC": clock("gps", offset_s=18.0),
    "GPS: heights above the ellipsoid, depths below the sea": values("gps", lambda v: v - np.array([0, 0, 27])),
    "vehicle: compass 0.6 rad instead of 0.6 deg": described(compass=GaussMarkov(sd=0.6, tau_s=30.0)),
    "vehicle: DVL 0.01 mm/s": described(dvl=White(sd=1e-5)),
    "vehicle: gyro in deg/h read as rad/s": described(gyro=White(density=0.3)),
}


@dataclass(frozen=True)
class Told:
    """What the program says of a mistake.

    Parameters
    ----------
    check : tuple of Finding
        Errors and warnings of ``navfilter check`` with the vehicle, and of ``navfilter vehicle --check``.
    verdict : Verdict or str
        Of a replay; what it was refused with, where it was.
    """

    check: tuple[Finding, ...]
    verdict: Verdict | str

    @property
    def noticed_by_check(self) -> bool:
        """Whether `check` says anything."""
        return bool(self.check)

    @property
    def noticed_by_verdict(self) -> bool:
        """Whether the replay is refused, not trusted, or to be used with care."""
        return isinstance(self.verdict, str) or any(f.severity != "info" for f in self.verdict.findings)

    @property
    def code(self) -> int:
        """Exit code of ``navfilter replay``."""
        if isinstance(self.verdict, str):
            return 2
        return 0 if self.verdict.trusted else 1 if self.verdict.wrong else 3


def told(vehicle: Vehicle, mission: Mission) -> Told:
    """Check and replay."""

    found = [f for f in (*check_vehicle(vehicle), *check_mission(mission, vehicle)) if f.severity != "info"]
    ordered = tuple(sorted(found, key=lambda f: f.severity != "error"))
    try:
        track = replay(vehicle, mission)
    except ValueError as error:
        return Told(ordered, str(error).splitlines()[0])
    return Told(ordered, assess(labelled(track), mission).verdict)

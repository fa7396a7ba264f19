"""The dives of an AUV with its inertial unit, as papers on adaptive filters use them, for `dives.py`.

Protocols (a run begins at the truth; no fix comes after that):

- raw: nothing is added; the start is the truth's, with sd 0.3 m, 0.1 m/s, 0.1 deg. Data sheet: DVL white 0.02 m/s; gyro
  0.01 deg/s a sample, bias 7 deg/h; accelerometer 0.02 m/s^2 a sample, bias 0.5 mg. "outage": 60 s without DVL from 180
  s on.
- low-cost: gyro bias Gauss-Markov 10 deg/h, 300 s, white 0.05 deg/s a sample; accelerometer 1 mg and white 1 mg a
  sample; start tilt 0.1 deg, heading 1 deg. Compass at 1 Hz: Gauss-Markov 0.5 deg, 60 s, 1 deg times the cosine of the
  heading, white 0.05 deg; described as white 1 deg.
- published: as ANUKF (Levy and Klein, arXiv 2503.05490) says: start velocity 0.25, 0.25, 0.05 m/s and attitude 0.01 deg
  off, 0.03 m/s^2 and 7.3e-6 rad/s a sample, constant biases 0.3 m/s^2 and 7.3e-5 rad/s, no depth, 240 s; with the true
  stamps. "printed": the same with those of the files: all begin at 0 s, rows 1.0025 s apart, the truth's point taken
  for the unit's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from harness import DEG, MAPPINGS, Array, data_root
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import navfilter as nf
from navfilter.evaluation.baselines import RULES, adaptive_monitor, rival
from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.io import read_mission, read_vehicle
from navfilter.models.mission import Stream
from navfilter.playback.replay import replay_monitored

FOLDER = MAPPINGS / "snapir-auv-100hz"
DIVES = tuple(sorted(int(path.name) for path in FOLDER.iterdir()))
OUTAGE_S = (180.0, 240.0)
PUBLISHED_S = 240.0
#: A step of the truth's position that differs by more from the way of its velocity is a jump [m]: noise is below.
JUMP_M = 0.12
MILLI_G = 1e-3 * STANDARD_GRAVITY
PROTOCOLS = ("raw", "outage", "low-cost", "published", "printed")
#: Filters of every protocol; the last ones where there is a compass.
FILTERS = ("no gate", "described", "learnt", *RULES)
COMPASS = ("compass learnt", "told")


@dataclass(frozen=True)
class Case:
    """A dive by a protocol, with constants as states or without."""

    protocol: str
    dive: int
    draw: int
    constants: bool
    mission: nf.Mission
    vehicle: nf.Vehicle


# --- missions -------------------------------------------------------------------------------------------------------


@cache
def recorded(dive: int) -> nf.Mission:
    """A dive on its true time base, from a truth row on."""
    return read_mission(FOLDER / f"{dive:02d}")


def begun(dive: int) -> nf.Mission:
    """The same with a start that is known as papers have it."""
    mission = recorded(dive)
    return mission.with_start(replace(mission.start, position_sd_m=0.3))


@cache
def published_truth(dive: int) -> Array:
    """Time [s], position, velocity and attitude of the truth as printed, of its own point."""
    rows = np.loadtxt(data_root() / f"snapir-auv-1hz/GT_trajectory{dive}.csv", delimiter=",", skiprows=1)
    return rows[:, [0, 2, 1, 3, 4, 5, 6, 7, 8, 9]]


@cache
def jumps(dive: int) -> Array:
    """By how much the truth's position has jumped since its first row [m north, east], row by row.

    It goes by its own velocity, to some centimetres a second; where a turn or a dive begins it jumps by 0.1 to 0.5 m.
    """
    rows = published_truth(dive)
    seconds = np.arange(len(rows), dtype=float)  # rows are 1.000 s apart
    way = CubicSpline(seconds, rows[:, 4:6]).antiderivative()(seconds)
    rest = np.diff(metres(rows[:, 1:3], rows[0, 1:3]) - way, axis=0)
    rest -= median_filter(rest, size=(21, 1), mode="nearest")
    rest[np.hypot(*rest.T) <= JUMP_M] = 0.0
    return np.concatenate([np.zeros((1, 2)), np.cumsum(rest, axis=0)])


def metres(place: Array, origin: Array) -> Array:
    """Places (n, 2), latitude and longitude [rad], as north and east of one of them [m]."""
    track = nf.Start(latitude_deg=math.degrees(origin[0]), longitude_deg=math.degrees(origin[1])).state
    nav = track.pack()
    return np.asarray((place - origin) * [nav[15], nav[16] * math.cos(origin[0])])


def as_printed(dive: int) -> nf.Mission:
    """The same dive as its files have it."""
    mission, rows = recorded(dive), published_truth(dive)
    unit, dvl, depth = (mission.streams[name] for name in ("imu", "dvl", "depth"))
    streams = {
        "imu": replace(unit, time_s=unit.time_s - unit.time_s[0]),
        "dvl": replace(dvl, time_s=rows[: len(dvl), 0]),
        "depth": replace(depth, time_s=rows[: len(depth), 0]),
    }
    assert mission.truth is not None
    truth = replace(mission.truth, time_s=rows[:, 0], value=rows[:, 1:])
    return replace(mission, streams=streams, truth=truth, start=started(mission.start, rows[1]))


def started(start: nf.Start, row: Array) -> nf.Start:
    """A start at a row of time, position, velocity and attitude."""
    latitude, longitude, roll, pitch, heading = np.degrees(row[[1, 2, 7, 8, 9]]).tolist()
    place = {"latitude_deg": latitude, "longitude_deg": longitude, "height_m": float(row[3])}
    attitude = {"roll_deg": roll, "pitch_deg": pitch, "heading_deg": heading}
    return replace(start, time_s=float(row[0]), velocity_n=tuple(row[4:7].tolist()), **place, **attitude)


def turned(start: nf.Start, by_rad: Array) -> nf.Start:
    """A start whose attitude is off by a rotation vector in north, east, down [rad]."""
    told = Rotation.from_euler("ZYX", [start.heading_deg, start.pitch_deg, start.roll_deg], degrees=True)
    heading, pitch, roll = (Rotation.from_rotvec(by_rad) * told).as_euler("ZYX", degrees=True).tolist()
    return replace(start, roll_deg=roll, pitch_deg=pitch, heading_deg=heading)


def gauss_markov(rng: np.random.Generator, n: int, sd: float, tau_s: float, period_s: float) -> Array:
    """A series of a first-order Gauss-Markov process."""
    phi = math.exp(-period_s / tau_s)
    noise = sd * rng.standard_normal(n) * np.where(np.arange(n) > 0, math.sqrt(1.0 - phi**2), 1.0)
    return np.asarray(lfilter([1.0], [1.0, -phi], noise))


def with_noise(mission: nf.Mission, rate: Array, force: Array) -> nf.Mission:
    """A mission whose unit errs by so much more, (n, 3) or (3,) [rad/s], [m/s^2]."""
    unit = mission.streams["imu"]
    more = np.broadcast_to(np.concatenate(np.broadcast_arrays(rate, force), axis=-1), unit.value.shape)
    return mission.with_stream("imu", replace(unit, value=unit.value + more))


def low_cost(dive: int, draw: int) -> nf.Mission:
    """See the protocols."""
    rng, mission = np.random.default_rng([dive, draw]), begun(dive)
    n = len(mission.streams["imu"])
    slow = np.column_stack([gauss_markov(rng, n, 10.0 * DEG / 3600.0, 300.0, 0.01) for _ in range(3)])
    rate = slow + 0.05 * DEG * rng.standard_normal((n, 3))
    force = MILLI_G * (rng.standard_normal(3) + rng.standard_normal((n, 3)))
    assert mission.truth is not None
    yaw = mission.truth.value[:, 8]
    error = gauss_markov(rng, len(yaw), 0.5 * DEG, 60.0, 1.0) + 0.05 * DEG * rng.standard_normal(len(yaw))
    compass = Stream(mission.truth.time_s, (yaw + error + 1.0 * DEG * np.cos(yaw))[:, None], ("heading_rad",))
    start = turned(mission.start, np.array([0.1, 0.1, 1.0]) * DEG * rng.standard_normal(3))
    mission = with_noise(mission.with_stream("compass", compass), rate, force)
    return mission.with_start(replace(start, heading_sd_deg=1.0))


def published(dive: int, draw: int, printed: bool) -> nf.Mission:
    """See the protocols."""
    rng, mission = np.random.default_rng([dive, draw, 1]), as_printed(dive) if printed else recorded(dive)
    n = len(mission.streams["imu"])
    rate = 7.3e-6 * rng.standard_normal((n, 3)) + 7.3e-5 * rng.standard_normal(3)
    force = 0.03 * rng.standard_normal((n, 3)) + 0.3 * rng.standard_normal(3)
    start = turned(mission.start, 0.01 * DEG * rng.standard_normal(3))
    off = np.array([0.25, 0.25, 0.05]) * rng.standard_normal(3)
    start = replace(start, velocity_n=tuple((start.velocity_n + off).tolist()), velocity_sd_m_s=(0.25, 0.25, 0.05))
    start = replace(start, position_sd_m=0.01, tilt_sd_deg=0.01, heading_sd_deg=0.01)
    mission = with_noise(mission, rate, force).without_stream("depth").with_start(start)
    return mission.between(start.time_s - 1.0, start.time_s + PUBLISHED_S)


# --- vehicles -------------------------------------------------------------------------------------------------------


def vehicle_of(protocol: str, constants: bool) -> nf.Vehicle:
    """As a data sheet describes it."""
    mapped = read_vehicle(FOLDER / f"{DIVES[0]:02d}")
    per_sample, bias, walk = 0.01 * DEG, 0.002 * DEG, 3e-6 * DEG
    force, force_bias, force_walk = 0.02, 0.005, 1e-5
    if protocol == "low-cost":
        per_sample, bias, walk = 0.05 * DEG, 10.0 * DEG / 3600.0, 10.0 * DEG / 3600.0 * math.sqrt(2.0 / 300.0)
        force, force_bias = math.hypot(0.02, MILLI_G), MILLI_G
    if protocol in ("published", "printed"):
        bias, walk = 7.3e-5, 1e-7
        force, force_bias, force_walk = math.hypot(0.02, 0.03), 0.3, 1e-4
    unit = nf.Imu(
        rate_hz=100,
        gyro=nf.White(sd=per_sample) + nf.RandomWalk(density=walk, start_sd=bias),
        accel=nf.White(sd=force) + nf.RandomWalk(density=force_walk, start_sd=force_bias),
    )
    dvl = replace(mapped.sensors["dvl"], error=nf.White(sd=0.02))
    compass = nf.Heading(rate_hz=1.0, error=nf.White(sd=1.0 * DEG))
    if protocol == "printed":
        dvl = replace(dvl, lever_arm_b_m=(0.0, 0.0, 0.0))
    if constants:
        clock_s, arm_m = (1.0, (2.0, 0.5, 0.5)) if protocol == "printed" else (0.1, (0.2, 0.1, 0.2))
        dvl = replace(dvl, time_offset_sd_s=clock_s, lever_arm_sd_m=arm_m)
        dvl = replace(dvl, scale_sd=0.01, misalignment_sd_rad=1.0 * DEG)
        compass = replace(compass, bias_sd_rad=0.5 * DEG, deviation_sd_rad=(1.0 * DEG, 0.0))
    sensors = {"dvl": dvl, "depth": mapped.sensors["depth"], "compass": compass}
    has = {"low-cost": ("dvl", "depth", "compass"), "published": ("dvl",), "printed": ("dvl",)}
    return nf.Vehicle(unit, {name: sensors[name] for name in has.get(protocol, ("dvl", "depth"))}, "AUV, data sheet")


def cases(protocol: str, dive: int, draw: int) -> Iterator[Case]:
    """A dive by a protocol, without and with constants as states."""
    if protocol == "low-cost":
        mission = low_cost(dive, draw)
    elif protocol in ("published", "printed"):
        mission = published(dive, draw, protocol == "printed")
    else:
        mission = begun(dive)
        begin = mission.start.time_s
        mission = mission.hide("dvl", (begin + OUTAGE_S[0], begin + OUTAGE_S[1])) if protocol == "outage" else mission
    for constants in (False, True):
        yield Case(protocol, dive, draw, constants, mission, vehicle_of(protocol, constants))


# --- filters and figures --------------------------------------------------------------------------------------------


def filters(protocol: str) -> tuple[str, ...]:
    """Names of those that are run."""
    return (*FILTERS, *COMPASS) if protocol == "low-cost" else FILTERS


def track_of(name: str, case: Case) -> nf.Track:
    """The track that a filter makes of a case.

    no gate: navfilter as described, every reading used; so are those of the rivals, as in their papers. learnt: DVL and
    compass, from the description on, the compass with the usual prior; compass learnt: that alone. told: the true error
    of the compass but for its deviation.
    """
    vehicle, mission = case.vehicle, case.mission
    noisy = [sensor for sensor in vehicle.sensors if sensor != "depth"]
    if name in RULES or name == "no gate":
        described = vehicle if name == "no gate" else rival(name, vehicle, mission, sensors=noisy)
        rule, adapt = (Fixed, None) if name == "no gate" else (RULES[name], noisy)
        return replay_monitored(described, mission, adaptive_monitor(described, rule, adapt, gated=False))
    told = nf.GaussMarkov(sd=0.5 * DEG, tau_s=60.0) + nf.White(sd=0.05 * DEG)
    learnt = {"dvl": nf.LearnedArma(prior=vehicle.sensors["dvl"].models[0]), "compass": nf.LearnedArma()}
    made: dict[str, Callable[[], nf.Vehicle]] = {
        "described": lambda: vehicle,
        "learnt": lambda: vehicle.with_error(**{sensor: learnt[sensor] for sensor in noisy}),
        "compass learnt": lambda: vehicle.with_error(compass=learnt["compass"]),
        "told": lambda: vehicle.with_error(compass=told),
    }
    return nf.replay(made[name](), mission)


class Fixed:
    """The rule of a filter that does not adapt."""

    def __init__(self, described: Array) -> None:
        self.described = described

    def variance(self) -> Array:
        """As described."""
        return self.described

    def update(self, innovation: Array, predicted: Array) -> None:
        """Nothing follows from a reading."""


def figures_of(track: nf.Track, case: Case) -> dict[str, float]:
    """Errors at the rows of the truth after the start.

    Horizontal rms and end [m], end in percent of the way; prmse, vrmse: rms of the norm of three axes [m], [m/s]; NEES
    of the horizontal position against the truth as printed and mended (without its jumps), of the heading; rms of the
    heading [deg]; share of the DVL's readings that was used.
    """
    truth = case.mission.truth
    assert truth is not None
    row = np.flatnonzero((truth.time_s > track.time_s[0] + 1e-6) & (truth.time_s <= track.time_s[-1]))
    there = track.at(truth.time_s[row])
    errors = there.errors(truth)
    off, P = errors.position_n[:, :2], there.covariance[:, :2, :2]
    jumped = jumps(case.dive)[np.round(np.interp(truth.time_s[row], truth.time_s, np.arange(len(truth)))).astype(int)]
    first = jumps(case.dive)[row[0] - 1]
    mended, used = off + jumped - first, track.residuals["dvl"].used
    end_m, way_m = float(np.hypot(*off[-1])), float(np.sum(np.hypot(*np.diff(metres(*_places(truth, row)), axis=0).T)))
    return {
        "rms_m": root_mean_square(off),
        "end_m": end_m,
        "end_pct": 100.0 * end_m / way_m,
        "rms_mended_m": root_mean_square(mended),
        "vrmse_m_s": root_mean_square(errors.velocity_n),
        "prmse_m": root_mean_square(errors.position_n),
        "nees": nees(off, P),
        "nees_mended": nees(mended, P),
        "heading_deg": math.degrees(root_mean_square(errors.heading[:, None])),
        "nees_heading": float(np.mean(there.nees(errors)["heading"])),
        "used": float(np.mean(used)),
        "way_m": way_m,
    }


def _places(truth: Stream, row: Array) -> tuple[Array, Array]:
    return truth.value[row, :2], truth.value[row[0], :2]


def root_mean_square(error: Array) -> float:
    """Of the norms of errors (n, k)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def nees(error: Array, P: Array) -> float:
    """Mean normalised error squared of errors (n, 2), per axis."""
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)) / 2.0)

"""An hour of GNSS/INS through navfilter, and through KF-GINS, a C++ program of the same job.

Both read the same text: increments of an inertial unit at 100 Hz, fixes at 1 Hz. Both have the same 21 error states
and the same noise: position, velocity, attitude, biases and scales of gyros and accelerometers as first-order
Gauss-Markov processes. Times are processor seconds, measured turn by turn: medians, and medians of the ratios.

To get the other program (GPL-3; nothing of it is here): clone https://github.com/i2Nav-WHU/KF-GINS, build it as its
README says (cmake -DCMAKE_BUILD_TYPE=Release), and give it by --program. Its loop alone is timed by a second build,
--loop: its main, changed to read both files before the loop and to write nothing in it, with a line "Loop 1.234 s" at
the end, the processor time of the loop (std::clock before and after). Without --program only navfilter is timed.
"""

from __future__ import annotations

import dataclasses
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import DEG, Array, Options, Table, flag, main, quick, ratio

import navfilter as nf
from navfilter.io import write_vehicle
from navfilter.kernels import strapdown
from navfilter.models.mission import TRUTH_COLUMNS
from navfilter.simulation.manoeuvres import ChangeSpeed, FigureEight, Lawnmower, Straight, Wait
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.simulate import StartErrors, simulate

#: In its units: a milligal [m/s^2], degrees per hour [rad/s], per root hour [rad/sqrt(s)], parts per million.
MILLIGAL, DEG_PER_H, PER_ROOT_H, PPM = 1e-5, DEG / 3600.0, 1.0 / 60.0, 1e-6
HOUR_S = 3600.0
#: A tactical unit: white noise, biases, scales, and how long these last.
ANGLE_WALK, VELOCITY_WALK = 0.1 * DEG * PER_ROOT_H, 0.1 * PER_ROOT_H
GYRO_BIAS, ACCEL_BIAS, SCALE = 5.0 * DEG_PER_H, 100.0 * MILLIGAL, 500.0 * PPM
LASTING_S = 4.0 * HOUR_S
FIX_SD_M = (0.1, 0.1, 0.2)
ANTENNA_B_M = (0.5, -0.3, -1.2)
#: Of the two files that both read.
IMU_FILE, FIX_FILE = "imu.txt", "gnss.txt"
CONFIGURATION, LOOP_CONFIGURATION = "kf-gins.yaml", "kf-gins-loop.yaml"
NAVIGATION, DEVIATIONS = "KF_GINS_Navresult.nav", "KF_GINS_STD.txt"
MISSION = """\
name = "gnss-ins"
date = {date}
{start}
[streams.imu]
file = "imu.txt"
delimiter = "whitespace"
header = false
time = {{column = 0}}
rotation = [1, 2, 3]
velocity_gain = [4, 5, 6]

[streams.gnss]
file = "gnss.txt"
delimiter = "whitespace"
header = false
time = {{column = 0}}
position = {{columns = [1, 2, 3], unit = ["deg", "deg", "m"]}}
"""
#: The whole of navfilter: from the text to the track as text, at so many rows per second (None: one a sample).
WHOLE = """\
import sys
import navfilter as nf
from navfilter.io.tracks.formats import FORMATS, write_track
folder, rate = sys.argv[1:]
track = nf.replay(folder, folder, output_rate_hz=eval(rate))
write_track(track, __import__("pathlib").Path(folder) / "track.csv", None)
"""


class Answer(NamedTuple):
    """What a program found: times, position [rad, rad, m], velocity north, east, down, roll, pitch, heading [rad], and
    standard deviations of the nine errors [m, m/s, rad].
    """

    time_s: Array
    place: Array
    velocity_n: Array
    attitude: Array
    sd: Array


def vehicle() -> nf.Vehicle:
    """With 21 error states."""
    imu = nf.Imu(
        rate_hz=100.0,
        gyro=nf.White(density=ANGLE_WALK) + nf.GaussMarkov(sd=GYRO_BIAS, tau_s=LASTING_S),
        accel=nf.White(density=VELOCITY_WALK) + nf.GaussMarkov(sd=ACCEL_BIAS, tau_s=LASTING_S),
        gyro_scale_sd=SCALE,
        accel_scale_sd=SCALE,
        gyro_scale_tau_s=LASTING_S,
        accel_scale_tau_s=LASTING_S,
        increments=True,
    )
    error = tuple(nf.White(sd=sd) for sd in FIX_SD_M)
    return nf.Vehicle(imu, {"gnss": nf.Position(rate_hz=1.0, error=error, lever_arm_b_m=ANTENNA_B_M)}, "gnss-ins")


def simulated(minutes: float, seed: int) -> nf.Mission:
    """A boat that changes its speed and turns, which shows biases and scales."""
    cycle = (Lawnmower(4, 80.0), ChangeSpeed(2.0, 10.0), Straight(30.0), ChangeSpeed(5.0, 10.0), FigureEight())
    times = 1 + int(minutes / 5.0)  # a cycle takes more than five minutes
    motion = Motion(
        (Wait(20.0), ChangeSpeed(5.0, 10.0), *cycle * times),
        latitude_deg=52.0,
        longitude_deg=4.0,
        surface_height_m=45.0,
        heading_deg=40.0,
        wander=Wander(),
    )
    known = StartErrors((0.2, 0.2, 0.2), 0.02, 0.1, 0.5)
    mission = simulate(vehicle(), motion, seed=seed, duration_s=60.0 * minutes, start=known, name="gnss-ins")
    streams = dict(mission.streams)
    fixes, first_s = streams["gnss"], streams["imu"].time_s[0]
    later = fixes.time_s > first_s  # the other program begins with the first sample
    streams["gnss"] = dataclasses.replace(fixes, time_s=fixes.time_s[later], value=fixes.value[later])
    return dataclasses.replace(mission, streams=streams)


def write_text(mission: nf.Mission, folder: Path) -> None:
    """The mission as both programs read it, with what each has to be told of it."""
    imu, fixes = mission.streams["imu"], mission.streams["gnss"]
    np.savetxt(folder / IMU_FILE, np.column_stack([imu.time_s, imu.value[:, :6]]), fmt=["%.9f"] + 6 * ["%.15e"])
    sds = np.tile(FIX_SD_M, (len(fixes), 1))
    places = np.column_stack([np.degrees(fixes.value[:, :2]), fixes.value[:, 2]])
    rows = np.column_stack([fixes.time_s, places, sds])
    np.savetxt(folder / FIX_FILE, rows, fmt=["%.6f", "%.12f", "%.12f", "%.6f"] + 3 * ["%.4f"])
    for name, out in ((CONFIGURATION, folder), (LOOP_CONFIGURATION, folder / "loop")):
        out.mkdir(exist_ok=True)
        (folder / name).write_text(configuration(mission, folder, out), encoding="utf-8")
    (folder / "mission.toml").write_text(
        MISSION.format(date=mission.date, start=_start(mission.start)), encoding="utf-8"
    )
    write_vehicle(vehicle(), folder / "vehicle.toml")


def _start(start: nf.Start | None) -> str:
    """The table of a mission.toml."""
    assert start is not None
    fields = dataclasses.asdict(start)
    values = {name: list(v) if isinstance(v, tuple) else v for name, v in fields.items() if name != "date"}
    return "\n".join(["[start]", *(f"{name} = {value}" for name, value in values.items()), ""])


def configuration(mission: nf.Mission, folder: Path, out: Path) -> str:
    """Its settings, in its units; it reads from one folder and writes to the other."""
    start, imu = mission.start, mission.streams["imu"]
    assert start is not None

    def three(value: Any) -> str:
        return f"[{', '.join(f'{v:.12g}' for v in np.broadcast_to(np.asarray(value, dtype=float), 3))}]"

    tilt = start.tilt_sd_deg
    settings = {
        "imupath": folder / IMU_FILE,
        "gnsspath": folder / FIX_FILE,
        "outputpath": out,
        "imudatalen": 7,
        "imudatarate": 100,
        "starttime": f"{imu.time_s[0]:.9f}",
        "endtime": -1,
        "initpos": three([start.latitude_deg, start.longitude_deg, start.height_m]),
        "initvel": three(start.velocity_n),
        "initatt": three([start.roll_deg, start.pitch_deg, start.heading_deg % 360.0]),
        **{name: three(0.0) for name in ("initgyrbias", "initaccbias", "initgyrscale", "initaccscale")},
        "initposstd": three(start.position_sd_m),
        "initvelstd": three(start.velocity_sd_m_s),
        "initattstd": three([tilt, tilt, start.heading_sd_deg]),
        "antlever": three(ANTENNA_B_M),
    }
    noise = {
        "arw": three(ANGLE_WALK / DEG / PER_ROOT_H),
        "vrw": three(VELOCITY_WALK / PER_ROOT_H),
        "gbstd": three(GYRO_BIAS / DEG_PER_H),
        "abstd": three(ACCEL_BIAS / MILLIGAL),
        "gsstd": three(SCALE / PPM),
        "asstd": three(SCALE / PPM),
        "corrtime": LASTING_S / HOUR_S,
    }
    lines = [f"{name}: {value}" for name, value in settings.items()]
    return "\n".join([*lines, "imunoise:", *(f"  {name}: {value}" for name, value in noise.items()), ""])


def read_answer(folder: Path) -> Answer:
    """What the other program wrote."""
    rows, sds = np.loadtxt(folder / NAVIGATION), np.loadtxt(folder / DEVIATIONS)
    units = np.repeat([1.0, DEG], [6, 3])
    place = rows[:, 2:5] * (DEG, DEG, 1.0)
    return Answer(rows[:, 1], place, rows[:, 5:8], rows[:, 8:11] * DEG, sds[:, 1:10] * units)


def answer_of(track: nf.Track) -> Answer:
    """The same of a track."""
    place = np.column_stack([track.latitude, track.longitude, track.height])
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    return Answer(track.time_s, place, track.velocity_n, track.attitude, sd)


def errors(answer: Answer, truth: Answer, after_s: float = 60.0) -> dict[str, float]:
    """Rms errors where both have a row, `after_s` from the start on, and the mean square of position errors over their
    sd.
    """
    mine, its = common(answer.time_s, truth.time_s, after_s)
    off = apart(answer, mine, truth, its)
    nees = np.mean((off[:, :3] / answer.sd[mine, :3]) ** 2)
    return {
        "rows": len(answer.time_s),
        "horizontal_m": _rms(np.hypot(off[:, 0], off[:, 1])),
        "down_m": _rms(off[:, 2]),
        "velocity_m_s": _rms(np.linalg.norm(off[:, 3:6], axis=1)),
        "tilt_deg": _rms(np.hypot(off[:, 6], off[:, 7])) / DEG,
        "heading_deg": _rms(off[:, 8]) / DEG,
        "nees": float(nees),
    }


def common(times: Array, others: Array, after_s: float) -> tuple[Any, Any]:
    """Rows of two that have one time, to a tenth of a millisecond."""
    ticks = [np.round(1e4 * np.asarray(t)).astype(np.int64) for t in (times, others)]
    _, mine, its = np.intersect1d(*ticks, return_indices=True)
    late = times[mine] >= times[0] + after_s
    return mine[late], its[late]


def apart(answer: Answer, mine: Any, other: Answer, its: Any) -> Array:
    """Differences of position, velocity and roll, pitch, heading [m, m/s, rad], shape (n, 9)."""
    place, there = answer.place[mine], other.place[its]
    meridian, prime = np.array([strapdown.radii(latitude) for latitude in there[:, 0]]).T
    d = place - there
    metres = np.column_stack(
        [
            d[:, 0] * (meridian + there[:, 2]),
            d[:, 1] * (prime + there[:, 2]) * np.cos(there[:, 0]),
            -d[:, 2],
        ]
    )
    turned = (answer.attitude[mine] - other.attitude[its] + np.pi) % (2.0 * np.pi) - np.pi
    return np.column_stack([metres, answer.velocity_n[mine] - other.velocity_n[its], turned])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def children_s() -> float:
    """Processor seconds of all processes that this one has started, and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def whole_s(*command: str | Path) -> tuple[float, str]:
    """Processor seconds of a program, and what it said."""
    began = children_s()
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{command[0]} ended with {done.returncode}: {done.stderr[-500:] or done.stdout[-500:]}")
    return children_s() - began, done.stdout


def loop_s(program: str, configured: Path) -> float:
    """Processor seconds of the other program's loop alone, as its second build says."""
    said = re.search(r"^Loop ([0-9.eE+-]+) s", whole_s(program, configured)[1], flags=re.MULTILINE)
    if not said:
        raise SystemExit(f'{program} prints no line "Loop 1.234 s": see --help.')
    return float(said.group(1))


def within(mission: nf.Mission, rate_hz: float | None) -> float:
    """Processor seconds of a replay."""
    began = time.process_time()
    nf.replay(vehicle(), mission, output_rate_hz=rate_hz)
    return time.process_time() - began


def timed(options: Options, mission: nf.Mission, folder: Path) -> dict[str, list[float]]:
    """Processor seconds of everything in every turn."""
    configured = folder / CONFIGURATION
    calls: dict[str, Callable[[], float]] = {
        "forward 1": lambda: within(mission, 1.0),
        "forward all": lambda: within(mission, None),
        "whole 1": lambda: whole_s(sys.executable, "-c", WHOLE, folder, "1.0")[0],
        "whole all": lambda: whole_s(sys.executable, "-c", WHOLE, folder, "None")[0],
    }
    if options.program:
        calls["its whole"] = lambda: whole_s(options.program, configured)[0]
    if options.loop:
        calls["its loop"] = lambda: loop_s(options.loop, folder / LOOP_CONFIGURATION)
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(2 if options.quick else 4):
        for name, call in calls.items():
            seconds = call()
            if turn:  # the first turn compiles, or loads what was compiled
                spent[name].append(seconds)
    return spent


#: What is compared: ours, and its.
COMPARED = {
    "loop, a row per second": ("forward 1", "its loop"),
    "loop, a row and covariance per sample": ("forward all", "its loop"),
    "text to text, a row per second": ("whole 1", "its whole"),
    "text to text, a row per sample": ("whole all", "its whole"),
}


def gnss_ins(options: Options) -> dict[str, Any]:
    """Simulate the hour, write it, run both on it."""
    minutes = min(options.minutes, 5.0) if options.quick else options.minutes
    mission = simulated(minutes, options.seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(options.keep or place)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(mission, folder)
        figures: dict[str, Any] = {
            "minutes": minutes,
            "samples": len(mission.streams["imu"]),
            "fixes": len(mission.streams["gnss"]),
            "states": 9 + len(nf.Navigator(vehicle(), mission.start).errors),
        }
        print(", ".join(f"{name} {value:g}" for name, value in figures.items()))
        spent = timed(options, mission, folder)
        figures |= accuracy(options, mission, folder)
    speed = Table("what<40 navfilter_s>9.3f program_s>9.3f ratio>7.1f")
    for what, (mine, its) in COMPARED.items():
        row: dict[str, Any] = {"what": what, "navfilter_s": float(np.median(spent[mine]))}
        if its in spent:
            there = np.array(spent[its])
            row |= {"program_s": float(np.median(there)), "ratio": ratio(there, np.array(spent[mine]))}
        speed.add(row)
    return figures | {"table": speed.rows, "spent": spent}


def accuracy(options: Options, mission: nf.Mission, folder: Path) -> dict[str, Any]:
    """Errors against the truth of both, and how far they are apart."""
    truth = truth_of(mission)
    track = answer_of(nf.replay(vehicle(), mission, output_rate_hz=None))
    table = Table(
        "program<10 rows>7d horizontal_m>9.4f down_m>9.4f velocity_m_s>9.4f tilt_deg>9.4f heading_deg>9.4f nees>6.2f"
    )
    table.add({"program": "navfilter", **errors(track, truth)})
    if not options.program:
        return {"accuracy": table.rows}
    other = read_answer(folder)
    table.add({"program": "KF-GINS", **errors(other, truth)})
    mine, its = common(track.time_s, other.time_s, 60.0)
    off, sds = apart(track, mine, other, its), track.sd[mine] / other.sd[its]
    between = {
        "position_m": _rms(np.linalg.norm(off[:, :3], axis=1)),
        "velocity_m_s": _rms(np.linalg.norm(off[:, 3:6], axis=1)),
        "attitude_deg": _rms(np.linalg.norm(off[:, 6:], axis=1)) / DEG,
        "sd_ratio": [float(v) for v in np.median(sds, axis=0)],
    }
    print(
        f"apart: {between['position_m']:.4f} m, {between['velocity_m_s']:.5f} m/s, {between['attitude_deg']:.5f} deg; "
        f"sd of navfilter over its own {min(between['sd_ratio']):.3f} to {max(between['sd_ratio']):.3f}"
    )
    return {"accuracy": table.rows, "apart": between}


def truth_of(mission: nf.Mission) -> Answer:
    """The truth of a simulated mission."""
    truth = mission.truth
    assert truth is not None
    value = dict(zip(truth.columns, truth.value.T, strict=True))
    place, velocity, attitude = (
        np.column_stack([value[name] for name in names])
        for names in (TRUTH_COLUMNS[:3], TRUTH_COLUMNS[3:6], TRUTH_COLUMNS[6:9])
    )
    return Answer(truth.time_s, place, velocity, attitude, np.ones((len(truth), 9)))


if __name__ == "__main__":
    flags = [
        flag("--program", metavar="PATH", help="the other program, as its README builds it"),
        flag("--loop", metavar="PATH", help="its second build, which times its loop"),
        flag("--minutes", type=float, default=60.0),
        flag("--seed", type=int, default=1),
        flag("--keep", metavar="FOLDER", help="leave the text of both here"),
        quick("five minutes at most, one turn"),
    ]
    main(__doc__, {gnss_ins: flags})

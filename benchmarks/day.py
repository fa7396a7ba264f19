"""A day at 100 Hz, lived in the vehicle's own loop (against the truth) or replayed (against filterpy's way to smooth).

The vehicle goes round a racetrack of 128 s at constant depth (it closes on itself to 0.2 mm), for `--hours`. Compass at
8 Hz, DVL at 4 Hz, depth at 1 Hz, and fixes for two minutes of every thirty. The errors of all sensors are honest and go
on from lap to lap: biases wander all day.
"""

from __future__ import annotations

import gc
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from harness import DEG, Array, Options, Table, flag, main, peak_mb, quick
from scipy.signal import lfilter

import navfilter as nf
from navfilter.foundation.mapped_arrays import give_back
from navfilter.models.state import NavState
from navfilter.simulation.manoeuvres import Straight, Turn
from navfilter.simulation.motion import Motion

RATE_HZ = 100
LAP = (Straight(duration_s=30.0), Turn(180.0), Straight(duration_s=30.0), Turn(180.0))
FIXES_EVERY_S, FIXES_FOR_S, FIX_LATE_S = 1800.0, 120.0, 0.7
NEES = "nees_position>8.2f nees_velocity>8.2f nees_attitude>8.2f"
HOURLY = f"hour>6.1f rss_mb>8.2f smallest>8.1e {NEES} position_m>8.2f position_sd_m>8.2f"
COLUMNS = tuple(column.split(">")[0] for column in HOURLY.split())
#: When it arrives, from whom, when it was read, what.
Event = tuple[float, str, float, Array]


class Noise:
    """Errors of one axis that go on from call to call: a sum of white noise and first-order processes."""

    def __init__(self, model: nf.ErrorModel, period_s: float, rng: np.random.Generator) -> None:
        block = model.block(period_s)
        assert np.allclose(block.Phi, np.diag(np.diag(block.Phi))) and np.allclose(block.Q, np.diag(np.diag(block.Q)))
        self.rng, self.white, self.gain = rng, math.sqrt(block.r), block.C
        self.decay, self.drive = np.diag(block.Phi), np.sqrt(np.diag(block.Q))
        self.state = np.sqrt(np.diag(block.P0)) * rng.normal(size=len(block.C))

    def draw(self, n: int) -> np.ndarray:
        """The next n errors."""
        total = self.white * self.rng.normal(size=n)
        for k, decay in enumerate(self.decay):
            steps = np.concatenate([self.state[k : k + 1], self.drive[k] * self.rng.normal(size=n)])
            path = lfilter([1.0], [1.0, -decay], steps)
            total += self.gain[k] * path[:-1]
            self.state[k] = path[-1]
        return total


def vehicle(learning: bool) -> tuple[nf.Vehicle, nf.Vehicle]:
    """What the navigator believes, and what the sensors do (the same, but for the compass that is learnt)."""
    gyro = nf.White(density=3e-5) + nf.RandomWalk(density=1e-7, start_sd=2e-5)
    accel = nf.White(density=1e-3) + nf.RandomWalk(density=1e-6, start_sd=5e-3)
    compass: Any = nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0)
    really = nf.Vehicle(
        imu=nf.Imu(rate_hz=RATE_HZ, gyro=gyro, accel=accel),
        sensors={
            "compass": nf.Heading(rate_hz=8, error=compass + nf.White(sd=0.1 * DEG)),
            "dvl": nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01)),
            "depth": nf.Depth(rate_hz=1, error=nf.White(sd=0.05)),
            "gps": nf.Position(rate_hz=1, error=nf.GaussMarkov(sd=3.0, tau_s=60.0) + nf.White(sd=0.5)),
        },
        name="soak",
    )
    if not learning:
        return really, really
    prior = nf.GaussMarkov(sd=1.0 * DEG, tau_s=10.0)
    return really.with_error(compass=nf.LearnedArma(prior=prior) + nf.White(sd=0.1 * DEG)), really


class Laps:
    """Readings of one lap after the other, in the same arrays."""

    def __init__(self, really: nf.Vehicle, seed: int) -> None:
        self.motion = Motion(LAP, latitude_deg=45.0, longitude_deg=-4.0, depth_m=20.0, heading_deg=40.0, speed_m_s=1.5)
        self.duration_s = self.motion.duration_s
        self.rng = np.random.default_rng(seed)
        self.n = round(self.duration_s * RATE_HZ)
        _, gyro, accel = self.motion.inertial(RATE_HZ)
        self.ideal = np.hstack([gyro[1 : self.n + 1], accel[1 : self.n + 1]])
        self.imu_noise = [Noise(model, 1.0 / RATE_HZ, self.rng) for model in really.drive.models]
        self.noise, self.ticks, self.here = {}, {}, {}
        for name, sensor in really.sensors.items():
            self.noise[name] = [Noise(model, 1.0 / sensor.rate_hz, self.rng) for model in sensor.models]
            self.ticks[name] = np.arange(1, round(self.duration_s * sensor.rate_hz) + 1) / sensor.rate_hz
            self.here[name] = self.motion.at(self.ticks[name])
        self.minutes = self.motion.at(np.arange(0.0, self.duration_s, 1.0))

    def fill(self, imu: Array) -> None:
        """Inertial samples of the next lap, shape (n, 6)."""
        for axis, noise in enumerate(self.imu_noise):
            imu[:, axis] = self.ideal[:, axis] + noise.draw(self.n)

    def corrections(self, begin_s: float) -> Iterator[tuple[str, Array, Array]]:
        """Name, times from the lap's begin, and values of every correcting sensor in the next lap."""
        for name, ticks in self.ticks.items():
            value = self._readings(name, np.column_stack([noise.draw(len(ticks)) for noise in self.noise[name]]))
            seen = (begin_s + ticks) % FIXES_EVERY_S < FIXES_FOR_S if name == "gps" else np.ones(len(ticks), dtype=bool)
            yield name, ticks[seen], value[seen]

    def events(self, begin_s: float) -> list[Event]:
        """The corrections of the next lap in order of arrival, times from the lap's begin."""
        found = []
        for name, ticks, value in self.corrections(begin_s):
            late_s = FIX_LATE_S if name == "gps" else 0.0
            found += [(t + late_s, name, t, value[k]) for k, t in enumerate(ticks.tolist())]
        return found

    def _readings(self, name: str, error: np.ndarray) -> np.ndarray:
        here = self.here[name]
        if name == "compass":
            return here.attitude[:, 2:] + error
        if name == "dvl":
            return np.einsum("nji,nj->ni", here.C_nb, here.velocity_n) + error
        if name == "depth":
            return -here.height[:, None] + error
        # metres by the mean radii at 45 degrees: the error's scale is known to 0.1 %
        north, east = error[:, 0] / 6.3674e6, error[:, 1] / (6.371e6 * np.cos(here.latitude))
        return np.column_stack([here.latitude + north, here.longitude + east, here.height - error[:, 2]])

    def truth(self, time_s: float) -> NavState:
        """The truth at whole seconds."""
        k = round(time_s % self.motion.duration_s) % len(self.minutes.time_s)
        here = self.minutes
        place = (float(here.latitude[k]), float(here.longitude[k]), float(here.height[k]))
        return NavState(time_s, *place, here.velocity_n[k], here.C_nb[k])


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def look(nav: nf.Navigator, laps: Laps) -> tuple[float, ...]:
    """Memory, definiteness and consistency, now: the `COLUMNS`."""
    sd = np.sqrt(np.diag(nav.filter.P))
    smallest = float(np.linalg.eigvalsh(nav.filter.P / np.outer(sd, sd)).min())
    state = nav.state
    error, P = state.minus(laps.truth(state.time_s)), state.covariance
    blocks = [slice(k, k + 3) for k in (0, 3, 6)]
    nees = [float(error[at] @ np.linalg.solve(P[at, at], error[at])) / 3.0 for at in blocks]
    position = (math.hypot(error[0], error[1]), math.sqrt(P[0, 0] + P[1, 1]))
    return (state.time_s / 3600.0, resident_mb(), smallest, *nees, *position)


def start_at(truth: NavState, rng: np.random.Generator) -> nf.Start:
    """A start that is off by what it says."""
    roll, pitch, heading = np.degrees(truth.roll_pitch_heading) + rng.normal(size=3) * (0.1, 0.1, 1.0)
    north, east, down = truth.velocity_n + 0.02 * rng.normal(size=3)
    moved = truth.plus(np.concatenate([rng.normal(size=3) * (1.0, 1.0, 0.2), np.zeros(6)]))
    return nf.Start(
        latitude_deg=math.degrees(moved.latitude),
        longitude_deg=math.degrees(moved.longitude),
        height_m=moved.height,
        velocity_n=(float(north), float(east), float(down)),
        roll_deg=float(roll),
        pitch_deg=float(pitch),
        heading_deg=float(heading),
        position_sd_m=(1.0, 1.0, 0.2),
        velocity_sd_m_s=0.02,
        tilt_sd_deg=0.1,
        heading_sd_deg=1.0,
    )


# --- in the vehicle's own loop --------------------------------------------------------------------------------------


class Watched:
    """A navigator in its loop, looked at once a minute; the rows are there before: what grows is the navigator's."""

    def __init__(self, believed: nf.Vehicle, laps: Laps, hours: float, rng: np.random.Generator) -> None:
        self.laps, self.nav = laps, nf.Navigator(believed, start_at(laps.truth(0.0), rng))
        self.rows, self.seen = np.zeros((math.ceil(60 * hours) + 10, len(COLUMNS))), 0
        self.table = Table(HOURLY)

    def step(self, stamps: Array, samples: Array) -> None:
        """A block of inertial samples, and a look when a minute is full."""
        self.nav.step(stamps, samples[:, :3], samples[:, 3:])
        if int(stamps[-1] / 60.0 + 1e-9) > self.seen and abs(self.nav.time_s - round(self.nav.time_s)) < 1e-6:
            self.rows[self.seen] = look(self.nav, self.laps)
            self.seen += 1
            if self.seen % 60 == 0:
                self.hour(self.rows[self.seen - 60 : self.seen])

    def hour(self, rows: Array) -> None:
        """Print what an hour showed."""
        mean = dict(zip(COLUMNS, rows.mean(axis=0).tolist(), strict=True))
        last = {"hour": rows[-1, 0], "rss_mb": rows[-1, 1], "smallest": rows[:, 2].min()}
        self.table.add(mean | last)


def loop(hours: float, seed: int, learning: bool) -> Watched:
    """The day, block by block and reading by reading."""
    believed, really = vehicle(learning)
    laps, rng = Laps(really, seed), np.random.default_rng(seed + 1)
    watched, imu, waiting = Watched(believed, laps, hours, rng), np.empty((laps.n, 6)), []
    for number in range(math.ceil(hours * 3600.0 / laps.duration_s)):
        begin_s, done = number * laps.duration_s, 0
        laps.fill(imu)
        events = sorted([*waiting, *laps.events(begin_s)], key=lambda e: e[0])
        waiting = [
            (a - laps.duration_s, name, t - laps.duration_s, v) for a, name, t, v in events if a > laps.duration_s
        ]
        blocks = iter(rng.integers(1, 13, size=laps.n).tolist())
        for arrival_s, name, time_s, value in [*events, (laps.duration_s, None, 0.0, None)]:
            if arrival_s > laps.duration_s:
                continue
            until = min(int(arrival_s * RATE_HZ + 1e-6), laps.n) if name else laps.n
            while done < until:
                end = min(until, done + next(blocks))
                watched.step(begin_s + np.arange(done + 1, end + 1) / RATE_HZ, imu[done:end])
                done = end
            if name:
                watched.nav.correct(name, begin_s + time_s, value)
    return watched


def live(options: Options) -> dict[str, Any]:
    """The vehicle's own loop, against the truth: memory flat, the covariance positive definite, the errors honest.

    No tape. Samples arrive in blocks of 1 to 12, fixes 0.7 s late; the compass's error is learnt under way. Every
    minute: resident memory, the smallest eigenvalue of the covariance scaled to a unit diagonal, and the normalised
    error (NEES, per degree of freedom) of position, velocity and attitude. One lap of readings is held at a time, in
    arrays that are used again, so that what memory grows by is the navigator's.
    """
    hours = 0.2 if options.quick else options.hours
    nf.warm_up()
    gc.collect()
    began = time.process_time()
    watched = loop(hours, options.seed, not options.no_learning)
    rows, nav = watched.rows[: watched.seen], watched.nav
    later = rows[rows[:, 0] >= min(1.0, hours / 2)]
    after = dict(zip(COLUMNS, later.T, strict=True))
    memory = after["rss_mb"]
    figures = {
        "hours": hours,
        "cpu_s": time.process_time() - began,
        "rss_after_first_hour_mb": memory[0],
        "growth_mb": memory.max() - memory[0],
        "trend_mb_per_h": np.polyfit(after["hour"], memory, 1)[0],
        "smallest_eigenvalue": rows[:, 2].min(),
        **{name: values.mean() for name, values in after.items() if name.startswith("nees_")},
        "position_rms_m": np.sqrt(np.mean(after["position_m"] ** 2)),
        "position_sd_m": np.sqrt(np.mean(after["position_sd_m"] ** 2)),
        "counts": dict(nav.counts),
        "outcomes": {name: sensor.outcomes for name, sensor in nav.health.sensors.items()},
    }
    for name, value in figures.items():
        print(f"{name:24s} {value:.4g}" if isinstance(value, float) else f"{name:24s} {value}")
    print(f"covariance {'positive' if figures['smallest_eigenvalue'] > 0.0 else 'NOT positive'} definite throughout")
    if hours > 1.0:
        print(f"memory {'flat' if figures['growth_mb'] < 1.0 else 'NOT flat'} (less than 1 MB after the first hour)")
    return figures | {"columns": COLUMNS, "minutes": rows}


# --- afterwards -----------------------------------------------------------------------------------------------------


def on_disk(*shape: int) -> Array:
    """An array in a temporary file."""
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, np.float64, "w+", shape=shape)


def mission(laps: Laps, hours: float, rng: np.random.Generator) -> nf.Mission:
    """The day as a recording: its inertial samples lie in a file, no truth."""
    number = math.ceil(hours * 3600.0 / laps.duration_s)
    parts: dict[str, list[tuple[Array, Array]]] = {}
    imu, times = on_disk(number * laps.n, 6), on_disk(number * laps.n)
    for k in range(number):
        here = slice(k * laps.n, (k + 1) * laps.n)
        laps.fill(imu[here])
        times[here] = np.arange(here.start + 1, here.stop + 1) / RATE_HZ
        give_back(imu, times)
        for name, ticks, value in laps.corrections(k * laps.duration_s):
            parts.setdefault(name, []).append((k * laps.duration_s + ticks, value))
    streams = {"imu": nf.Stream(times, imu)}
    for name, pieces in parts.items():
        streams[name] = nf.Stream(np.concatenate([t for t, _ in pieces]), np.concatenate([v for _, v in pieces]))
    return nf.Mission(f"{hours:g} h", streams, start=start_at(laps.truth(0.0), rng))


def replay(options: Options) -> dict[str, Any]:
    """Filter and smoother over the recorded day: peak memory and processor time.

    Compared with what the plain way would need: a float64 state and covariance per inertial sample, as filterpy's
    rts_smoother takes them. The inertial samples lie in a file, as those of a mission that was read do; there is no
    truth. The first hours of it by themselves show whether the time of a reading grows with the mission.
    """
    hours = 0.2 if options.quick else options.hours
    _, really = vehicle(False)
    day = mission(Laps(really, options.seed), hours, np.random.default_rng(options.seed + 1))
    nf.replay(really, day.between(0.0, 20.0), smooth=True)
    loaded = peak_mb()
    table = Table("hours>6.1f readings>9d forward_us>11.1f both_us>9.1f peak_mb>8.0f")
    for until in sorted({*(part for part in options.parts if part < hours), hours}):
        began, track = time.process_time(), None  # that before is not to count
        track = nf.replay(really, day.between(0.0, 3600.0 * until), smooth=True, output_rate_hz=options.output_rate)
        seconds, peak = time.process_time() - began, peak_mb()
        assert track.forward is not None
        readings = sum(len(one.time_s) for one in track.residuals.values())
        per = {"forward_us": 1e6 * track.forward.cpu_s / readings, "both_us": 1e6 * seconds / readings}
        table.add({"hours": until, "readings": readings, **per, "peak_mb": peak})
    samples, states = len(day.streams["imu"]), 9 + len(track.state_names)
    plain = samples * (states + states**2) * 8 / 2**20
    figures = {
        "hours": hours,
        "samples": samples,
        "states": states,
        "forward_s": track.forward.cpu_s,
        "both_s": seconds,
        "loaded_mb": loaded,
        "peak_mb": peak,
        "plain_mb": plain,
        "plain_over_peak": plain / peak,
        "definite": bool(np.all(np.linalg.eigvalsh(track.covariance[::60]) > 0.0)),
        "parts": table.rows,
    }
    for name, value in figures.items():
        print(f"{name:24s} {value:.4g}" if isinstance(value, float) else f"{name:24s} {value}")
    return figures


if __name__ == "__main__":
    common = [flag("--hours", type=float, default=24.0), flag("--seed", type=int, default=1), quick("twelve minutes")]
    known = flag("--no-learning", action="store_true", help="the compass's error is known from the start")
    parts = flag("--parts", type=float, nargs="*", default=[1.0, 6.0], help="first hours, by themselves, too")
    rows = flag("--output-rate", type=float, default=1.0, help="rows of the tracks per second")
    main(__doc__, {live: [*common, known], replay: [*common, parts, rows]})

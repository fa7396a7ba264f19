"""A day in the vehicle's own loop: memory stays flat, the covariance positive definite, the position consistent with the truth.

The vehicle goes round a racetrack of 128 s at constant depth (it closes on itself to 0.2 mm), for `--hours` (default 24) at 100 Hz, without
a tape. Samples arrive in blocks of 1 to 12; compass at 8 Hz (its error is learnt under way), DVL at 4 Hz, depth at 1 Hz, and fixes for two
minutes of every thirty, each 0.7 s late. The errors of all sensors are honest and go on from lap to lap: biases wander all day. One lap of
readings is held at a time, in arrays that are used again, so that what memory grows by is the navigator's.

Every minute: resident memory, the smallest eigenvalue of the covariance scaled to a unit diagonal, and the normalised error (NEES, per
degree of freedom) of position, velocity and attitude.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

import navfilter as nf
from navfilter.simulation.manoeuvres import Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.state import NavState

DEG = math.pi / 180.0
RATE_HZ = 100
LAP = (Straight(duration_s=30.0), Turn(180.0), Straight(duration_s=30.0), Turn(180.0))
FIXES_EVERY_S, FIXES_FOR_S, FIX_LATE_S = 1800.0, 120.0, 0.7


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
        self.rng = np.random.default_rng(seed)
        self.n = round(self.motion.duration_s * RATE_HZ)
        _, gyro, accel = self.motion.inertial(RATE_HZ)
        self.ideal = np.hstack([gyro[1 : self.n + 1], accel[1 : self.n + 1]])
        self.imu = np.empty((self.n, 6))
        self.imu_noise = [Noise(model, 1.0 / RATE_HZ, self.rng) for model in really.drive.models]
        self.noise = {name: [Noise(m, 1.0 / s.rate_hz, self.rng) for m in s.models] for name, s in really.sensors.items()}
        self.rates = {name: int(s.rate_hz) for name, s in really.sensors.items()}
        self.ticks = {name: np.arange(1, round(self.motion.duration_s * rate) + 1) / rate for name, rate in self.rates.items()}
        self.here = {name: self.motion.at(ticks) for name, ticks in self.ticks.items()}
        self.minutes = self.motion.at(np.arange(0.0, self.motion.duration_s, 1.0))

    def lap(self, begin_s: float) -> list[tuple[float, int, str, float, np.ndarray]]:
        """Fill `imu`, and return the corrections: (arrival, samples before it, name, stamp, value), times from the lap's begin."""
        for axis, noise in enumerate(self.imu_noise):
            self.imu[:, axis] = self.ideal[:, axis] + noise.draw(self.n)
        events = []
        for name, ticks in self.ticks.items():
            error = np.column_stack([noise.draw(len(ticks)) for noise in self.noise[name]])
            value = self._readings(name, error)
            for k, t in enumerate(ticks.tolist()):
                if name == "gps":
                    if (begin_s + t) % FIXES_EVERY_S >= FIXES_FOR_S:
                        continue
                    arrival = t + FIX_LATE_S
                else:
                    arrival = t
                events.append((arrival, min(int(arrival * RATE_HZ + 1e-6), self.n), name, t, value[k]))
        events.sort(key=lambda e: e[0])
        return events

    def _readings(self, name: str, error: np.ndarray) -> np.ndarray:
        here = self.here[name]
        if name == "compass":
            return here.attitude[:, 2:] + error
        if name == "dvl":
            return np.einsum("nji,nj->ni", here.C_nb, here.velocity_n) + error
        if name == "depth":
            return -here.height[:, None] + error
        radius = 6.371e6
        north = error[:, 0] / 6.3674e6  # metres by the mean meridian radius at 45 degrees: the error's scale is known to 0.1 %
        return np.column_stack(
            [here.latitude + north, here.longitude + error[:, 1] / (radius * np.cos(here.latitude)), here.height - error[:, 2]]
        )

    def truth(self, time_s: float) -> NavState:
        """The truth at whole seconds."""
        k = round(time_s % self.motion.duration_s) % len(self.minutes.time_s)
        here = self.minutes
        return NavState(time_s, float(here.latitude[k]), float(here.longitude[k]), float(here.height[k]), here.velocity_n[k], here.C_nb[k])


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


COLUMNS = ("hour", "rss_mb", "smallest", "nees_position", "nees_velocity", "nees_attitude", "position_m", "position_sd_m")


def look(nav: nf.Navigator, laps: Laps) -> tuple[float, ...]:
    """Memory, definiteness and consistency, now: the `COLUMNS`."""
    sd = np.sqrt(np.diag(nav.filter.P))
    state = nav.state
    error, P = state.minus(laps.truth(state.time_s)), state.covariance
    smallest = float(np.linalg.eigvalsh(nav.filter.P / np.outer(sd, sd)).min())
    nees = [float(error[k : k + 3] @ np.linalg.solve(P[k : k + 3, k : k + 3], error[k : k + 3])) / 3.0 for k in (0, 3, 6)]
    return (state.time_s / 3600.0, resident_mb(), smallest, *nees, math.hypot(error[0], error[1]), math.sqrt(P[0, 0] + P[1, 1]))


def soak(hours: float, seed: int, learning: bool) -> tuple[np.ndarray, nf.Navigator]:
    """The run; one row of `COLUMNS` per minute, in an array that is there before: what grows is the navigator's."""
    believed, really = vehicle(learning)
    laps = Laps(really, seed)
    rng = np.random.default_rng(seed + 1)
    begin = laps.truth(0.0)
    nav = nf.Navigator(believed, start_at(begin, rng))
    rows, seen = np.zeros((math.ceil(60 * hours) + 10, len(COLUMNS))), 0
    lap_s, period_s = laps.motion.duration_s, 1.0 / RATE_HZ
    waiting: list[Any] = []
    for number in range(math.ceil(hours * 3600.0 / lap_s)):
        begin_s, done = number * lap_s, 0
        events = [*waiting, *laps.lap(begin_s)]
        events.sort(key=lambda e: e[0])
        waiting = []
        blocks = iter(rng.integers(1, 13, size=laps.n).tolist())
        for event in [*events, None]:
            if event is not None and event[0] > lap_s:
                waiting.append((event[0] - lap_s, int((event[0] - lap_s) * RATE_HZ + 1e-6), event[2], event[3] - lap_s, event[4]))
                continue
            until = laps.n if event is None else event[1]
            while done < until:
                end = min(until, done + next(blocks))
                stamps = begin_s + np.arange(done + 1, end + 1) * period_s
                nav.step(stamps, laps.imu[done:end, :3], laps.imu[done:end, 3:])
                if int(stamps[-1] / 60.0 + 1e-9) > seen and abs(nav.time_s - round(nav.time_s)) < 1e-6:
                    rows[seen] = look(nav, laps)
                    seen += 1
                    if seen % 60 == 0:
                        print(hour_line(rows[seen - 60 : seen], nav), flush=True)
                done = end
            if event is not None:
                nav.correct(event[2], begin_s + event[3], event[4])
    return rows[:seen], nav


def start_at(truth: NavState, rng: np.random.Generator) -> nf.Start:
    """A start that is off by what it says."""
    roll, pitch, heading = np.degrees(truth.roll_pitch_heading) + rng.normal(size=3) * (0.1, 0.1, 1.0)
    north, east, down = truth.velocity_n + 0.02 * rng.normal(size=3)
    moved = truth.plus(np.concatenate([rng.normal(size=3) * (1.0, 1.0, 0.2), np.zeros(6)]))
    return nf.Start(
        latitude_deg=math.degrees(moved.latitude), longitude_deg=math.degrees(moved.longitude), height_m=moved.height,
        velocity_n=(float(north), float(east), float(down)), roll_deg=float(roll), pitch_deg=float(pitch), heading_deg=float(heading),
        position_sd_m=(1.0, 1.0, 0.2), velocity_sd_m_s=0.02, tilt_sd_deg=0.1, heading_sd_deg=1.0,
    )  # fmt: skip


def hour_line(rows: np.ndarray, nav: nf.Navigator) -> str:
    """One line per hour for people."""
    mean = dict(zip(COLUMNS, rows.mean(axis=0).tolist(), strict=True))
    return (
        f"{rows[-1, 0]:5.1f} h  {rows[-1, 1]:8.2f} MB  {rows[:, 2].min():9.1e}  "
        f"NEES {mean['nees_position']:5.2f} {mean['nees_velocity']:5.2f} {mean['nees_attitude']:5.2f}  "
        f"{mean['position_m']:6.2f} m of {mean['position_sd_m']:6.2f}  {nav.counts}"
    )


def main() -> None:
    """Run the day and judge it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-learning", action="store_true", help="the compass's error is known from the start")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    nf.warm_up()
    gc.collect()
    began = time.process_time()
    learning = hasattr(nf, "LearnedArma") and not arguments.no_learning
    rows, nav = soak(arguments.hours, arguments.seed, learning)
    seconds = time.process_time() - began
    hour, memory = rows[:, 0], rows[:, 1]
    later = hour >= min(1.0, arguments.hours / 2)
    after = dict(zip(COLUMNS, rows[later].T, strict=True))
    growth = float(memory[later].max() - memory[later][0])
    figures = {
        "hours": arguments.hours,
        "samples": round(arguments.hours * 3600 * RATE_HZ),
        "cpu_s": seconds,
        "learning": learning,
        "rss_after_first_hour_mb": float(memory[later][0]),
        "growth_mb": growth,
        "trend_mb_per_h": float(np.polyfit(hour[later], memory[later], 1)[0]),
        "smallest_eigenvalue": float(rows[:, 2].min()),
        **{name: float(values.mean()) for name, values in after.items() if name.startswith("nees_")},
        "position_rms_m": float(np.sqrt(np.mean(after["position_m"] ** 2))),
        "position_sd_m": float(np.sqrt(np.mean(after["position_sd_m"] ** 2))),
        "counts": dict(nav.counts),
        "outcomes": {name: sensor.outcomes for name, sensor in nav.health.sensors.items()},
    }
    for name, value in figures.items():
        print(f"{name:26s} {value:.4g}" if isinstance(value, float) else f"{name:26s} {value}")
    print(f"memory {'flat' if growth < 1.0 else 'NOT flat'} (less than 1 MB after the first hour), covariance "
          f"{'positive definite throughout' if figures['smallest_eigenvalue'] > 0.0 else 'NOT positive definite'}")  # fmt: skip
    if arguments.json:
        arguments.json.write_text(json.dumps({"figures": figures, "columns": COLUMNS, "minutes": rows.tolist()}, indent=1))


if __name__ == "__main__":
    main()

"""Errors that no vehicle file describes: are learnt models honest, and better than the file?

A survey vehicle of the campaigns; one sensor errs in a way that is drawn at random: white noise, and one to three of
Gauss-Markov processes of first and second order (5 s to 20 min), flicker, a random walk, jumps now and then, a drift
that settles, a swing; then it may be read in coarse steps, or have tails. The vehicle file says what it says of that
sensor in every campaign. Scored are the forward track as first given out, from two minutes on, and the smoothed one:
NEES of heading (compass) or position (DVL, fixes), with the model that learns and with the file, and the ratio
of the two root mean squares. There is no other software in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from harness import DEG, Array, Options, Table, flag, main, quick
from random_vehicles import Random, between, chance
from scipy.signal import lfilter

import navfilter as nf
from navfilter.evaluation.baselines import rivals
from navfilter.simulation.scenarios import GYROS, MOTIONS, stage

BEGIN_S = 120.0
#: What is odd [1]: a NEES above the first, or a root mean square over that of the file above the second.
ODD, FARTHER = 4.0, 1.3
#: By sensor: scale of its errors [rad], [m/s], [m], what is scored, and the campaign whose vehicle it is.
SENSORS = {
    "compass": (0.5 * DEG, "heading", "compass-gm1"),
    "dvl": (0.01, "position", "dvl-slow"),
    "gps": (1.5, "position", "gps-slow"),
}
EARTH_M = 6.37e6

Noise = Callable[[Random], Array]


def coloured(noise: Array, *poles: complex) -> Array:
    """White noise through poles, of standard deviation 1."""
    found = np.asarray(lfilter([1.0], np.poly(poles).real, noise))
    return found / found.std()


def flicker(r: Random, n: int) -> Array:
    """Of a power like 1/f down to the length of the series, and of standard deviation 1."""
    spectrum = np.fft.rfft(r.standard_normal(2 * n))
    spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1))
    found = np.fft.irfft(spectrum)[:n]
    return np.asarray(found / found.std())


def slow(r: Random, n: int, steps: float, order: int) -> Array:
    """Gauss-Markov of an order, its time constant in readings."""
    pole, run_in = math.exp(-1.0 / steps), int(5.0 * steps)
    found = lfilter([1.0], np.poly([pole] * order).real, r.standard_normal(n + run_in))
    return np.asarray(found[run_in:] / found.std())


def part(r: Random, n: int, rate_hz: float) -> tuple[str, Noise]:
    """A kind of error drawn: words, and what makes a series of about standard deviation 1 for an axis."""
    kind = str(r.choice(["gm1", "gm2", "flicker", "walk", "jumps", "drift", "swing"]))
    if kind == "flicker":
        return kind, lambda own: flicker(own, n)
    if kind == "walk":
        return kind, lambda own: np.cumsum(own.standard_normal(n)) / math.sqrt(n)
    if kind == "jumps":
        mean = between(r, 60.0, 600.0) * rate_hz

        def levels(own: Random) -> Array:
            at = np.cumsum(own.random(n) < 1.0 / mean)
            return np.asarray(own.standard_normal(int(at[-1]) + 1)[at])

        return f"jumps {mean / rate_hz:.0f} s", levels
    if kind == "drift":
        steps, sign = between(r, 100.0, 2000.0) * rate_hz, float(r.choice([-1.0, 1.0]))
        series = sign * (2.0 * np.exp(-np.arange(n) / steps) - 1.0)
        return f"drift {steps / rate_hz:.0f} s", lambda own: series
    if kind == "swing":
        period_s, radius = between(r, 2.5, 25.0), 1.0 - between(r, 1e-3, 0.1)
        pole = radius * np.exp(2j * np.pi / (period_s * rate_hz))
        return f"swing {period_s:.0f} s", lambda own: coloured(own.standard_normal(n), pole, pole.conjugate())
    tau_s, order = between(r, 5.0, 1200.0), int(kind[-1])
    return f"{kind} {tau_s:.0f} s", lambda own: slow(own, n, tau_s * rate_hz, order)


@dataclass(frozen=True)
class Case:
    """One mission."""

    vehicle: nf.Vehicle
    mission: nf.Mission
    words: str

    @classmethod
    def drawn(cls, number: int, sensor: str) -> Case:
        """That of a number, always the same."""
        r = np.random.default_rng([number, 5])
        scale, _, base = SENSORS[sensor]
        motion, gyro = str(r.choice(MOTIONS)), str(r.choice(GYROS))
        minutes = float(r.choice([10.0, 20.0, 30.0, 45.0]))
        staged = stage(f"{base}/{motion}/{gyro}", duration_s=60.0 * minutes, imu_rate_hz=50.0)
        silent = replace(staged.faults[sensor], true_error=nf.White(sd=1e-9 * scale))
        mission = replace(staged, faults={**staged.faults, sensor: silent}).mission(number)
        stream, rate_hz = mission.streams[sensor], staged.vehicle.sensors[sensor].rate_hz
        at = np.round((stream.time_s - stream.time_s[0]) * rate_hz).astype(int)
        n, axes = int(at[-1]) + 1, stream.value.shape[1]
        white = scale * between(r, 0.05, 1.0)
        errors, words = white * r.standard_normal((n, axes)), [f"white {white / scale:.2f}"]
        for _ in range(int(r.integers(1, 4))):
            told, noise = part(r, n, rate_hz)
            size = scale * between(r, 0.1, 1.5)
            errors += size * np.column_stack([noise(r) for _ in range(axes)])
            words.append(f"{told} {size / scale:.2f}")
        if chance(r, 0.2):
            errors += np.where(r.random((n, axes)) < 0.05, 4.0 * white, 0.0) * r.standard_normal((n, axes))
            words.append("tails")
        unit = np.ones(axes)
        if sensor == "gps":
            unit[:2] = 1.0 / EARTH_M, 1.0 / (EARTH_M * math.cos(math.radians(mission.start.latitude_deg)))
        value = stream.value + errors[at] * unit
        if chance(r, 0.2):
            step = scale * between(r, 0.3, 2.0)
            value = np.round(value / (step * unit)) * (step * unit)
            words.append(f"in steps of {step / scale:.2f}")
        streams = {**mission.streams, sensor: replace(stream, value=value)}
        told = f"{motion}, {gyro}, {minutes:.0f} min: {', '.join(words)}"
        return cls(staged.vehicle, replace(mission, streams=streams), told)


def score(vehicle: nf.Vehicle, mission: nf.Mission, what: str) -> list[float]:
    """NEES and rms, forward and smoothed."""
    smoothed = nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0)
    assert smoothed.forward is not None
    found = []
    for track in (smoothed.forward, smoothed):
        errors, late = track.errors(mission.truth), track.time_s > BEGIN_S
        off = {"heading": errors.heading, "position": errors.horizontal}
        found += [float(np.nanmean(track.nees(errors)[what][late])), float(np.sqrt(np.nanmean(off[what][late] ** 2)))]
    return found


def honest_errors(options: Options) -> dict[str, Any]:
    """Draw, simulate, replay, print what is odd."""
    heads = ("NEES", "file", "rms/file", "sm_NEES", "sm_file", "sm_rms/file")
    table = Table("case<7 " + " ".join(f"{h}>{len(h) + 2}.2f" for h in heads) + " errors<100")
    sensor, found = options.sensor, []
    for number in range(options.first, options.first + (3 if options.quick else options.cases)):
        case, what = Case.drawn(number, sensor), SENSORS[sensor][1]
        vehicle = case.vehicle
        if options.bias:
            compass = replace(vehicle.sensors["compass"], bias_sd_rad=math.radians(options.bias))
            vehicle = nf.Vehicle(vehicle.drive, {**vehicle.sensors, "compass": compass})
        learns = rivals(("arma",), vehicle, case.mission, sensors=[sensor])["arma"]
        own, file = score(learns, case.mission, what), score(vehicle, case.mission, what)
        row = [own[0], file[0], own[1] / file[1], own[2], file[2], own[3] / file[3]]
        found.append(row)
        odd = own[0] > ODD or own[2] > ODD or row[2] > FARTHER or row[5] > FARTHER
        if odd or options.all:
            table.add({"case": str(number), "errors": case.words} | dict(zip(heads, row, strict=True)))
    for name, of in (("mean", np.nanmean), ("median", np.nanmedian)):
        values = of(np.array(found), axis=0).tolist()
        table.add({"case": name, "errors": f"{len(found)} missions"} | dict(zip(heads, values, strict=True)))
    return {"odd": table.rows, "found": found}


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=60, help="how many"),
        flag("--first", type=int, default=170_000, help="number of the first"),
        flag("--sensor", choices=list(SENSORS), default="compass", help="which one errs"),
        flag("--bias", type=float, default=0.0, metavar="DEG", help="have the vehicle file expect one of the compass"),
        flag("--all", action="store_true", help="show all, not only what is odd"),
        quick("three of them"),
    ]
    main(__doc__, {honest_errors: flags})

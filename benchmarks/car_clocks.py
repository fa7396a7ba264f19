"""The car's wheel clocks, gyro offset and lever arm from its own sensors, for `recordings.py car_clocks`.

The mapping files of wid-car-rtk have the published clocks of the wheels, with the rest as a state, and the offset of
gyro z from before the first motion. Here these numbers come from the car's own sensors, all of the recording:

- clock of a wheel: the accelerometer along the car against the derivative of the wheel's speed. The delay maximises
  the sum over frequencies of ``W cos(phase + 2 pi f delay)`` with ``W = coherence / (1 - coherence)``, the
  maximum-likelihood weight (Knapp and Carter, 1976, "The generalized correlation method for estimation of time
  delay"). Below 1 Hz only: above, the body of the car pitches on its springs and the accelerometer feels that;
- gyro z: mean while both wheels stand (half a second on either side left out), less the Earth's rotation;
- lever arm from the accelerometers: ``a_x = v' + y w'`` and ``a_y = v w + x w'`` between 0.05 and 1 Hz, all trials
  together, (x, y) being where the box is, forward and left of the point that does not slip.

The radii of the wheels are those published with the recordings.
"""

from __future__ import annotations

import re
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from harness import MAPPINGS, Array, recorded
from scipy.signal import butter, csd, filtfilt, welch

from navfilter.io import read_mission, read_vehicle
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle

TRIALS = ("00", "02", "08", "10")
#: Errors for a smoother of two passes: section, key and value in vehicle.toml. See `finer`.
FINER = (
    ("sensors.odometer.error", "x", '[{model = "white", sd = 0.02}, {model = "gauss-markov", sd = 0.01, tau_s = 1.0}]'),
    ("sensors.odometer.error", "y", '{model = "gauss-markov", sd = 0.03, tau_s = 0.3}'),
    ("sensors.odometer.error", "z", '{model = "gauss-markov", sd = 0.05, tau_s = 0.3}'),
    ("sensors.compass", "error", '[{model = "white", sd_deg = 0.7}, {model = "gauss-markov", sd_deg = 3, tau_s = 20}]'),
    ("sensors.rtk", "error", '{model = "white", sd = 0.01}'),
)
RATE_HZ = 100.0
STILL_M_S, MARGIN_S = 0.02, 0.5
EARTH_RAD_S = 7.292115e-5


# --- the recording --------------------------------------------------------------------------------------------------


def read_text(mission: str, vehicle: str) -> tuple[Mission, Vehicle]:
    """Mission and vehicle of two texts in the place of mission.toml and vehicle.toml."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "mission.toml").write_text(mission)
        (Path(folder) / "vehicle.toml").write_text(vehicle)
        return read_mission(folder), read_vehicle(folder)


def variant(trial: str, clocks: tuple[float, ...], gyro_deg_s: float, **vehicle: str) -> tuple[Mission, Vehicle]:
    """A trial with other wheel clocks, another offset of gyro z, and other values in vehicle.toml (key: text)."""
    folder = MAPPINGS / "wid-car-rtk" / trial
    offsets = iter(clocks)
    text = re.sub(
        r"offset_s = [-\d.]+", lambda found: f"offset_s = {next(offsets):.6f}", (folder / "mission.toml").read_text()
    )
    text = re.sub(r'("Gyro_Z", offset = )[-\d.]+', rf"\g<1>{gyro_deg_s:.6f}", text)
    described = (folder / "vehicle.toml").read_text()
    for key, value in vehicle.items():
        described = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", described)
    return read_text(text, described)


@cache
def raw(trial: str) -> tuple[Array, Array, tuple[tuple[Array, Array], ...]]:
    """Rate and force in the box's axes (forward, left, up), 100 Hz; time and speed of each wheel, on its clock."""
    folder = MAPPINGS / "wid-car-rtk" / trial
    text = re.sub(r"offset_s = [-\d.]+", "offset_s = 0.0", (folder / "mission.toml").read_text())
    text = re.sub(r'("Gyro_Z", offset = )[-\d.]+', r"\g<1>0.0", text)
    head, rest = text.split("[streams.odometer]\n")
    odometer, tail = rest.split("[streams.compass]", 1)
    wheels = odometer.split("[[streams.odometer.sources]]\n")[1:]
    streams = "".join(f"[streams.wheel{k}]\n{block}\n" for k, block in enumerate(wheels))
    mission, _ = read_text(head + streams + "[streams.compass]" + tail, (folder / "vehicle.toml").read_text())
    imu = mission.streams["imu"].value * [1.0, -1.0, -1.0, 1.0, -1.0, -1.0]
    pairs = tuple(
        (mission.streams[f"wheel{k}"].time_s, mission.streams[f"wheel{k}"].value[:, 0]) for k in range(len(wheels))
    )
    return imu[:, :3], imu[:, 3:], pairs


def on_box(trial: str, clocks: tuple[float, ...]) -> list[Array]:
    """Speed of each wheel on the box's clock, 100 Hz."""
    rate, _, wheels = raw(trial)
    t = np.arange(len(rate)) / RATE_HZ
    return [np.interp(t - clock, *wheel) for clock, wheel in zip(clocks, wheels, strict=True)]


# --- estimates from the vehicle's own sensors -----------------------------------------------------------------------


def delay(late: Array, early: Array, below_hz: float = 1.0, segment_s: float = 10.0) -> tuple[float, float]:
    """Delay of one series against another at 100 Hz [s], and its standard deviation by Carter's formula (1987)."""
    n = int(segment_s * RATE_HZ)
    options = {"fs": RATE_HZ, "nperseg": n, "noverlap": 3 * n // 4, "detrend": "linear"}
    f, cross = csd(early, late, **options)
    coherence = np.abs(cross) ** 2 / (welch(early, **options)[1] * welch(late, **options)[1])
    used = (f > 0.0) & (f < below_hz)
    f, phase = f[used], np.angle(cross[used])
    weight = coherence[used] / (1.0 - coherence[used])
    delays = np.arange(-0.8, 0.8, 0.001)
    best = delays[np.argmax([weight @ np.cos(phase + 2.0 * np.pi * f * d) for d in delays])]
    information = 2.0 * (late.size / RATE_HZ) * (f[1] - f[0]) * np.sum((2.0 * np.pi * f) ** 2 * weight)
    return float(best), float(information**-0.5)


def steered(trial: str) -> float:
    """How far before the second wheel the first one steers [m].

    In a turn it goes ``sqrt(v^2 + (w L)^2)``, about ``v + (w L)^2 / 2 v``. By both wheels, each on its own clock, and
    gyro z: least squares of their difference, at more than 1 m/s and over a second, beside a factor of the speed and
    one of the turn (the track).
    """
    second = np.ones(int(RATE_HZ)) / RATE_HZ
    steers, v, w = (np.convolve(x, second, "same") for x in (*on_box(trial, clocks(trial)[0]), raw(trial)[0][:, 2]))
    moving = v > 1.0
    given = np.column_stack([v, w, 0.5 * w**2 / np.maximum(v, 1.0)])[moving]
    return float(np.sqrt(np.linalg.lstsq(given, (steers - v)[moving], rcond=None)[0][2]))


def finer(trial: str) -> tuple[Mission, Vehicle]:
    """A trial for a smoother of two passes: the wheel that does not steer alone, and errors as small as they are.

    Their sizes are, to one digit, those that make 5 s of RTK per minute likeliest of all trials after two passes.
    The file of the vehicle is for a filter that may have to believe a wrong heading for a minute. What it gets wrong
    by that, which is of the second order, its errors have to cover.
    """
    folder, source = MAPPINGS / "wid-car-rtk" / trial, "[[streams.odometer.sources]]\n"
    head, _, unsteered = (folder / "mission.toml").read_text().split(source)
    vehicle = (folder / "vehicle.toml").read_text()
    for section, key, value in FINER:
        before, after = vehicle.split(f"[{section}]\n")
        vehicle = f"{before}[{section}]\n" + re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", after, count=1)
    return read_text(head + source + unsteered, vehicle)


def clocks(trial: str) -> tuple[tuple[float, ...], float]:
    """Offset of each wheel's clock [s], and the standard deviation of the first."""
    _, force, wheels = raw(trial)
    found = [delay(force[:, 0], np.gradient(v, 1.0 / RATE_HZ)) for v in on_box(trial, (0.0,) * len(wheels))]
    return tuple(value for value, _ in found), found[0][1]


def gyro_offset(trial: str) -> float:
    """What is to be added to gyro z [deg/s]: minus its mean at rest, plus the Earth's rotation about the vertical."""
    rate, _, _ = raw(trial)
    moving = np.max(on_box(trial, clocks(trial)[0]), axis=0) > STILL_M_S
    reach = int(2 * MARGIN_S * RATE_HZ) + 1
    still = np.convolve(moving, np.ones(reach), "same") < 0.5
    latitude = read_mission(MAPPINGS / "wid-car-rtk" / trial).streams["rtk"].value[0, 0]
    return float(np.degrees(EARTH_RAD_S * np.sin(latitude) - rate[still, 2].mean()))


@cache
def lever_arm() -> tuple[float, float]:
    """Where the box is, forward and left of the point that does not slip [m], from the accelerometers of all trials."""
    b, a = butter(2, [0.05, 1.0], "bandpass", fs=RATE_HZ)
    along, across = [], []
    for trial in TRIALS:
        rate, force, _ = raw(trial)
        v = np.mean(on_box(trial, clocks(trial)[0]), axis=0)
        w = filtfilt(*butter(3, 3.0, fs=RATE_HZ), rate[:, 2])
        inside = slice(int(3 * RATE_HZ), -int(3 * RATE_HZ))
        band = [
            filtfilt(b, a, x)[inside]
            for x in (np.gradient(v) * RATE_HZ, v * w, np.gradient(w) * RATE_HZ, w**2, *force[:, :2].T)
        ]
        # centripetal force of the lever arm itself, w^2, is fitted too and not used: it goes with roll and pitch
        along.append(np.column_stack([band[0], band[2], band[3], band[4]]))
        across.append(np.column_stack([band[1], band[2], band[5]]))
    left = np.vstack(along)
    forward = np.vstack(across)
    return (
        float(np.linalg.lstsq(forward[:, :2], forward[:, 2], rcond=None)[0][1]),
        float(np.linalg.lstsq(left[:, :3], left[:, 3], rcond=None)[0][1]),
    )


def clean(trial: str) -> tuple[Mission, Vehicle]:
    """A trial with nothing in its mapping that was fitted to RTK (but the published radii of the wheels)."""
    x, y = lever_arm()
    # vehicle.toml wants the point that does not slip, seen from the box: forward, right, down
    return variant(trial, clocks(trial)[0], gyro_offset(trial), lever_arm_b_m=f"[{-x:.3f}, {-y:.3f}, 0.5]")


# --- what is compared -----------------------------------------------------------------------------------------------


def mappings(trial: str) -> dict[str, tuple[Mission, Vehicle]]:
    """The mappings that are compared."""
    return {"as mapped (published lags)": recorded(f"wid-car-rtk/{trial}"), "own sensors": clean(trial)}

"""White noise, Gauss-Markov and learned ARMA on real recordings: who is nearer, and who is honest.

Every model gets the same mapping, the same readings and the same other sensors; only the error models of the
correcting sensors differ. "gm1" (1/e point), "white" and "gm1-fitted" (by likelihood) are fitted beforehand to the
readings of the whole mission, as the filter would have them, positions withheld, and so is "arma-fitted", with the
model of the vehicle file as prior: beside "gm1-fitted" it tells what the noise deserves, on the same information.
"vehicle" is what the vehicle file says, set by hand; "arma" learns under way and begins with that: the difference
between those two is what learning has done. "arma-hurried" has windows of a third of the mission. None sees what is
withheld, and nothing is scored before positions are withheld.

| kind | mission | scored against |
|---|---|---|
| wid-car-rtk | inertial unit drives, wheels and compass correct; RTK for 25 m | RTK; heading: smoothed with all RTK |
| snapir | as below; positions for the first 100 s | post-processed position and attitude |
| auv-lake | attitude and DVL drive, GPS corrects in every second minute | the GPS fixes of the minutes between |

What rests on what:

- The car is taken with `car_clocks.clean`: clocks, gyro offset and lever arm from its own accelerometers and wheels.
  Its mapping in tests/recordings has clocks that were fitted to all of the RTK. The heading that it is judged by has
  an sd of 0.2 to 0.4 deg itself.
- Of snapir there is no inertial recording. Its gyros and accelerometers are made here from the post-processed
  attitude and velocity (splines, 20 Hz) with the noise of a tactical unit; DVL and depth are real; the compass is the
  recorded heading with an error of a known kind, slow and oscillating or compass-like, at 8 Hz. The DVL's clock is
  that of the mapping, published with the recordings and found against the same attitude and velocity.
- The other lake missions have no sensor beside those that drive, and nothing to learn from: they are not in the table.

Printed: rms of position and heading; NEES of both; NIS, mean over the sensors; rms of the one-step prediction error
of each aiding sensor; on how many of its axes the innovations pass as white, and the largest autocorrelation; when
models were adopted. In brackets the ratio to gm1-fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import car_clocks
import numpy as np
from harness import MAPPINGS, Array, Options, Table, data_root, fixes_of, flag, main, quick, recorded
from heading_toy import RATE_HZ, noises
from recordings import known_until
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

import navfilter as nf
from navfilter.evaluation.baselines import learnable, rivals
from navfilter.evaluation.comparison import compare
from navfilter.learning.batch import refitted
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay, residual_series
from navfilter.simulation.motion import frame_rates, gravity
from navfilter.simulation.presets import tactical_imu
from navfilter.simulation.simulate import draw_error
from navfilter.track.track import Track

MODELS = ("white", "gm1", "gm1-fitted", "vehicle", "arma")
#: Rows of the table that `navfilter.evaluation.baselines` does not know.
HURRIED, FITTED = "arma-hurried", "arma-fitted"
BASELINE = "gm1-fitted"
#: Correcting sensors that are real and not withheld: only their error models differ.
AIDING = ("compass", "odometer", "dvl", "gps")
SNAPIR = ("01", "02", "03", "05", "06", "07", "08", "10", "12")
IMU_HZ = 20.0


@dataclass(frozen=True)
class Case:
    """One mission as it is replayed, without what is withheld; `truth` is what it is judged by, from `begin_s` on."""

    kind: str
    name: str
    mission: Mission
    vehicle: Vehicle
    truth: Stream
    begin_s: float
    windows: tuple[tuple[float, float], ...] = ()


# --- the car --------------------------------------------------------------------------------------------------------


def car(trial: str) -> Case:
    """A trial of the car with RTK for the first 25 m, judged by RTK, its heading by the smoother that has all of it."""
    mission, vehicle = car_clocks.clean(trial)
    until = known_until(mission)
    best = replay(vehicle, mission, smooth=True)
    truth = mission.truth
    value = truth.value.copy()
    # nothing but RTK knows the height, and it is withheld
    value[:, 2] = np.nan
    for axis in range(3):
        angle = np.interp(truth.time_s, best.time_s, np.unwrap(best.attitude[:, axis]), left=np.nan, right=np.nan)
        value[:, 6 + axis] = np.angle(np.exp(1j * angle))
    judged = Stream(truth.time_s, value, truth.columns)
    return Case("wid-car-rtk", trial, mission.hide("rtk", (until + 1e-6, math.inf)), vehicle, judged, until)


# --- snapir ---------------------------------------------------------------------------------------------------------


def inertial(truth: Stream, seed: int) -> tuple[Stream, Callable[[Array], Array]]:
    """Inertial readings for a recorded attitude and velocity, with tactical noise; and the heading at any time."""
    t = truth.time_s
    path, velocity = CubicSpline(t, truth.value[:, :3]), CubicSpline(t, truth.value[:, 3:6])
    # Rotation("ZYX") with yaw, pitch, roll is body to north-east-down
    attitude = RotationSpline(t, Rotation.from_euler("ZYX", truth.value[:, [8, 7, 6]]))
    at = np.arange(t[0], t[-1], 1.0 / IMU_HZ)
    where, v = path(at), velocity(at)
    earth, over = frame_rates(where[:, 0], where[:, 2], v)
    down = np.column_stack([np.zeros((at.size, 2)), gravity(where[:, 0], where[:, 2])])
    to_body = attitude(at).inv()
    force = to_body.apply(velocity(at, 1) + np.cross(2.0 * earth + over, v) - down)
    rate = attitude(at, 1) + to_body.apply(earth + over)
    value = np.column_stack([rate, force])
    for axis, model in enumerate(tactical_imu(IMU_HZ).models):
        value[:, axis] += draw_error(model, 1.0 / IMU_HZ, at.size, seed, "imu", axis)
    columns = tuple(f"{what}_{axis}" for what in ("rate", "force") for axis in "xyz")
    return Stream(at, value, columns), lambda times: attitude(times).as_euler("ZYX")[:, 0]


def snapir(run: str, error: nf.ArmaModel) -> Case:
    """A run of the AUV, inertial readings made from its attitude and velocity, and a compass with a known error."""
    folder = MAPPINGS / "snapir-auv-1hz" / run
    mission, mapped = recorded(f"snapir-auv-1hz/{run}")
    truth = mission.truth
    imu, heading = inertial(truth, int(run))
    ticks = np.arange(truth.time_s[0], truth.time_s[-1], 1.0 / RATE_HZ)
    yaw = heading(ticks) + nf.simulate_arma(error.ar, error.ma, error.sd, ticks.size, 1000 + int(run))
    streams = {name: mission.streams[name] for name in ("depth", "usbl")}
    streams |= {
        "imu": imu,
        "compass": Stream(ticks, np.angle(np.exp(1j * yaw)), ("heading_rad",)),
        "dvl": as_recorded(folder),
    }
    velocity = mapped.drive.velocity_sensor
    vehicle = Vehicle(
        imu=tactical_imu(IMU_HZ),
        sensors={
            "compass": nf.Heading(rate_hz=RATE_HZ, error=nf.GaussMarkov(sd=math.radians(0.6), tau_s=30.0)),
            "dvl": replace(velocity, rate_hz=0.9975),
            **mapped.sensors,
        },
        name=mapped.name,
    )
    until = float(truth.time_s[0]) + 100.0
    hidden = replace(mission, streams=streams).hide("usbl", (until + 1e-6, math.inf))
    return Case("snapir", run, hidden.with_start(started(truth)), vehicle, truth, until)


def started(truth: Stream) -> nf.Start:
    """The start as recorded: some runs begin in a turn of 15 deg/s and a dive, where nothing can be aligned."""
    latitude, longitude, height, *rest = truth.value[0]
    return nf.Start(
        time_s=float(truth.time_s[0]),
        latitude_deg=math.degrees(latitude),
        longitude_deg=math.degrees(longitude),
        height_m=float(height),
        velocity_n=(float(rest[0]), float(rest[1]), float(rest[2])),
        roll_deg=math.degrees(rest[3]),
        pitch_deg=math.degrees(rest[4]),
        heading_deg=math.degrees(rest[5]),
        position_sd_m=0.5,
        velocity_sd_m_s=0.1,
        tilt_sd_deg=0.2,
        heading_sd_deg=1.0,
    )


def as_recorded(folder: Path) -> Stream:
    """The DVL's readings at 1 Hz, without the interpolation that dead reckoning wants."""
    text = (folder / "mission.toml").read_text().replace("resample_hz = 5.0\n", "")
    mission, _ = car_clocks.read_text(text, (folder / "vehicle.toml").read_text())
    return mission.streams["velocity"]


# --- the lake -------------------------------------------------------------------------------------------------------


def lake(name: str = "20220625_0_0") -> Case:
    """The torpedo AUV with GPS in every second minute, judged in the minutes between."""
    mission, vehicle = recorded(f"auv-lake-sea-10hz/{name}")
    gps = fixes_of(vehicle)
    fixes = mission.streams[gps]
    starts = np.arange(fixes.time_s[0] + 60.0, fixes.time_s[-1] - 60.0, 120.0)
    gaps = tuple((float(a), float(a + 60.0)) for a in starts)
    return Case("auv-lake", name, mission.hide(gps, *gaps), vehicle, mission.truth, gaps[0][0], gaps)


def cases(only: str, error: nf.ArmaModel) -> Iterator[Case]:
    """The missions whose kind and name contain a text."""
    makers: dict[str, Callable[[], Case]] = {f"wid-car-rtk {trial}": partial(car, trial) for trial in car_clocks.TRIALS}
    makers |= {f"snapir {run}": partial(snapir, run, error) for run in SNAPIR}
    makers["auv-lake 20220625_0_0"] = lake
    for name, make in makers.items():
        if only in name:
            yield make()


# --- figures --------------------------------------------------------------------------------------------------------


def adopted(track: Track) -> str:
    """What a run learnt, by axis: order of the last model, since when there was one, and how many there were."""
    # the first models are in force from the start, when the beginning has been run again with them
    learnt = {axis: (found[-1]["order"], found[0]["time_s"], len(found)) for axis, found in track.adopted().items()}
    said = [f"{axis} ({p},{q}) from {time_s:.0f} s, {n} times" for axis, ((p, q), time_s, n) in learnt.items()]
    return "; ".join(said) or "nothing adopted"


def orders(vehicle: Vehicle, sensors: list[str]) -> str:
    """Error models of a vehicle's sensors."""
    return "; ".join(f"{name} {' / '.join(str(m) for m in vehicle.sensors[name].models)}" for name in sensors)


def fitted_arma(case: Case, sensors: list[str]) -> Vehicle:
    """The vehicle with what `replay --iterate` makes of the whole mission's readings in one round, kept."""
    models = {name: tuple(LearnedArma(prior=p) for p in case.vehicle.sensors[name].models) for name in sensors}
    learns = case.vehicle.with_error(**{name: axes if len(axes) > 1 else axes[0] for name, axes in models.items()})
    return refitted(learns, residual_series(learns, case.mission, sensors))


def hurried(case: Case, sensors: list[str]) -> Vehicle:
    """The vehicle with `LearnedArma` whose windows are a third of the mission: it forgets sooner."""
    models: dict[str, tuple[nf.ErrorModel, ...]] = {}
    for name in sensors:
        sensor = case.vehicle.sensors[name]
        window = min(max(int(case.mission.duration_s / 3.0 * sensor.rate_hz), 200), 4000)
        models[name] = tuple(LearnedArma(prior=prior, window=window) for prior in sensor.models)
    return case.vehicle.with_error(**{name: axes if len(axes) > 1 else axes[0] for name, axes in models.items()})


def prediction(sensor: Mapping[str, Any]) -> float:
    """Rms of a sensor's one-step prediction error over its axes."""
    return math.sqrt(sum(axis["prediction_rms"] ** 2 for axis in sensor["axes"].values()))


def figures(case: Case) -> dict[str, dict[str, Any]]:
    """Figures of every model on one mission."""
    sensors = [name for name in learnable(case.vehicle, case.mission) if name in AIDING]
    vehicles = rivals(MODELS, case.vehicle, case.mission, sensors=sensors)
    vehicles = {**vehicles, HURRIED: hurried(case, sensors), FITTED: fitted_arma(case, sensors)}
    tracks = {name: replay(vehicle, case.mission) for name, vehicle in vehicles.items()}
    comparison = compare(tracks, case.truth, begin_s=case.begin_s, windows=case.windows)
    # a sensor that is withheld in the scored windows is judged by its readings between them
    listened = compare(tracks, case.truth, begin_s=case.begin_s).runs
    said = {name: adopted(tracks[name]) for name in ("arma", HURRIED)} | {FITTED: orders(vehicles[FITTED], sensors)}
    result = {}
    for name, run in comparison.runs.items():
        aiding = {key: sensor for key, sensor in listened[name]["sensors"].items() if sensor["axes"] and key in sensors}
        axes = [axis for sensor in aiding.values() for axis in sensor["axes"].values() if axis["is_white"] is not None]
        result[name] = {
            "position_rms_m": run["position_rms_m"],
            "heading_rms_deg": run["heading_rms_deg"],
            "nees_position": run["nees"].get("position", {}).get("mean"),
            "nees_heading": run["nees"].get("heading", {}).get("mean"),
            "nis": float(np.mean([s["nis"] for s in aiding.values()])) if aiding else None,
            "prediction": {k: [s["unit"], prediction(s)] for k, s in aiding.items()},
            "white_axes": sum(bool(axis["is_white"]) for axis in axes),
            "axes": len(axes),
            "largest_acf": max((abs(axis["largest_acf"]) for axis in axes), default=None),
            "adopted": said.get(name),
        }
    return result


def pooled(runs: list[dict[str, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Figures of several missions together: root mean square of the rms, mean of NEES and NIS, sums of axes."""

    def over(values: Iterable[float | None], power: int) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.mean(np.power(known, power)) ** (1.0 / power)) if known else None

    total = {}
    for model in runs[0]:
        of = [run[model] for run in runs]
        total[model] = {
            **{key: over((run[key] for run in of), 2) for key in ("position_rms_m", "heading_rms_deg")},
            **{key: over((run[key] for run in of), 1) for key in ("nees_position", "nees_heading", "nis")},
            "prediction": {
                name: [unit, over((run["prediction"].get(name, (unit, None))[1] for run in of), 2)]
                for name, (unit, _) in of[0]["prediction"].items()
            },
            **{key: sum(run[key] for run in of) for key in ("white_axes", "axes")},
            "largest_acf": max((run["largest_acf"] for run in of if run["largest_acf"] is not None), default=None),
        }
    return total


# --- what is printed ------------------------------------------------------------------------------------------------

NUMBERS = ("position_rms_m", "heading_rms_deg", "nees_position", "nees_heading", "nis", "largest_acf")


def show(name: str, runs: Mapping[str, Mapping[str, Any]]) -> None:
    """One mission, or all of a kind together, for people; in brackets the ratio to the `BASELINE`."""
    base = runs[BASELINE]
    print(f"\n{name}")
    table = Table("model<12 " + " ".join(f"{key}>14" for key in NUMBERS) + " white>6 prediction<40 adopted<8")
    for model, run in runs.items():
        row = {key: cell(run[key], base[key] if key.endswith(("_m", "_deg")) else None) for key in NUMBERS}
        predicted = [f"{k} {cell(v, base['prediction'][k][1])} {unit}" for k, (unit, v) in run["prediction"].items()]
        row |= {"white": f"{run['white_axes']}/{run['axes']}", "prediction": ", ".join(predicted)}
        table.add({"model": model, "adopted": run.get("adopted")} | row)


def cell(value: float | None, base: float | None = None) -> str | None:
    """A number, with its ratio to another one in brackets."""
    if value is None:
        return None
    return f"{value:.3g}" + (f" ({value / base:.2f})" if base else "")


def arma_vs_gm1(options: Options) -> dict[str, Any]:
    """Replay everything and print the tables."""
    data_root()
    found: dict[str, dict[str, dict[str, dict[str, Any]]]] = {}
    for case in cases(options.only, noises()[options.compass]):
        if options.quick and case.kind in found:
            continue
        runs = found.setdefault(case.kind, {})[case.name] = figures(case)
        show(f"{case.kind} {case.name}", runs)
    totals = {kind: pooled(list(missions.values())) for kind, missions in found.items()}
    for kind, total in totals.items():
        show(f"{kind}, {len(found[kind])} together", total)
    return {"missions": found, "totals": totals}


if __name__ == "__main__":
    compass = flag(
        "--compass", choices=[*noises()], default="slow + oscillating (4,2)", help="error of snapir's compass"
    )
    only = flag("--only", default="", help="only missions whose kind and name contain this")
    main(__doc__, {arma_vs_gm1: [only, compass, quick("one mission of each kind")]})

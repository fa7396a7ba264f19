"""From which series should a sensor's error model be learnt under way? The real filter, on the campaigns' scenarios.

A survey vehicle (50 Hz inertial unit, lawnmower: it turns a third of the time, dives, loses its DVL, has outliers) is
simulated for half an hour. From the first half of the mission a series is made in each of these ways, the compass's
model is fitted to it (the true orders given to all, the coefficients not), and the whole mission is replayed with
that model fixed; the second half is scored.

| series | |
|---|---|
| closed loop | reading minus the heading that the filter predicts for it |
| detrended | reading minus open-loop prediction, a straight line taken off, fitted without drift |
| smoothed, 1 pass | reading minus the smoothed heading, the operator's model in force |
| smoothed, 3 passes | the same after two rounds of fitting and smoothing again |
| joint | reading minus open-loop prediction, fitted beside drift states of known noise: what navfilter does |
| oracle | (the true model) |

All are maxima of a likelihood without a slow part: what is compared is the series, not what a prior adds.

Printed: power at zero frequency identified over true, median and 10-90 % of the seeds; rms of the
heading error; NEES of the heading (1 is honest).

The second table is for the other sensors, by the joint way only: S(0), and the largest factor, over all frequencies
that the series holds ten times or more, between identified and true spectrum.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from harness import Array, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.learning.arma_fit import fit_channel
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.error_models import ErrorModel, block_level
from navfilter.models.mission import Mission, Stream
from navfilter.models.navigation_drift import Drift
from navfilter.models.state import wrap
from navfilter.playback.replay import residual_series
from navfilter.simulation.scenarios import Staged, stage
from navfilter.simulation.simulate import Faults
from navfilter.timeseries.model import ArmaModel

DURATION_S, LEARN_S = 1800.0, 900.0
#: True orders of the compass's error, by scenario.
COMPASS = {"compass-gm1": (1, 0), "compass-gm2": (2, 1), "compass-swell": (4, 2), "compass-rolling": (4, 2)}
SOURCES = ("closed loop", "detrended", "smoothed, 1 pass", "smoothed, 3 passes", "joint", "oracle")
#: True orders by axis of the other sensors.
OTHERS = {"dvl-coloured": ((3, 3), (3, 3), (1, 1)), "gps-thesis": ((2, 0),) * 3, "depth-coloured": ((1, 1),)}
DEPTH_ERROR = nf.GaussMarkov(sd=0.05, tau_s=20.0) + nf.White(sd=0.02)
#: Frequencies that the series holds less often than this are not judged.
CYCLES = 10.0


# --- missions -------------------------------------------------------------------------------------------------------


def staged(scenario: str, gyro: str) -> Staged:
    """A scenario on the lawnmower; "depth-coloured" is not one of the campaigns'."""
    settings = {"motion": "lawnmower", "gyro": gyro, "duration_s": DURATION_S, "imu_rate_hz": 50.0}
    if scenario != "depth-coloured":
        return stage(scenario, **settings)  # type: ignore[arg-type]
    plain = stage("compass-white", **settings)  # type: ignore[arg-type]
    faults = plain.faults | {
        "compass": replace(plain.faults["compass"], true_error=None),
        "depth": Faults(true_error=DEPTH_ERROR),
    }
    return replace(plain, name=f"depth-coloured/lawnmower/{gyro}", faults=faults, truth={"depth": DEPTH_ERROR})


def until(mission: Mission, end_s: float) -> Mission:
    """The mission up to a time."""
    cut = {}
    for name, stream in mission.streams.items():
        rows = stream.time_s <= end_s
        cut[name] = Stream(stream.time_s[rows], stream.value[rows], stream.columns)
    return replace(mission, streams=cut)


# --- series of the compass ------------------------------------------------------------------------------------------


def on_grid(time_s: Array, value: Array, period_s: float) -> Array:
    """Samples at multiples of the period, NaN where there is none."""
    tick = np.round(time_s / period_s).astype(int)
    series = np.full(tick[-1] - tick[0] + 1, np.nan)
    series[tick - tick[0]] = value
    return series


def used_readings(track: nf.Track, mission: Mission) -> tuple[Array, Array]:
    """Times and values of the compass readings that the filter accepted."""
    residuals, stream = track.residuals["compass"], mission.streams["compass"]
    time_s = residuals.time_s[residuals.used]
    return time_s, stream.value[np.searchsorted(stream.time_s, time_s - 1e-6), 0]


def closed_loop(vehicle: nf.Vehicle, mission: Mission) -> Array:
    """Reading minus predicted heading: the innovation, and the compass error that was predicted with it."""
    track = nf.replay(vehicle, mission, output_rate_hz=None)
    residuals = track.residuals["compass"]
    block = vehicle.sensors["compass"].models[0].block(1.0 / vehicle.sensors["compass"].rate_hz)
    rows = np.searchsorted(track.time_s, residuals.time_s + 1e-6) - 1
    state = track.states[rows, track.state_names.index("compass[0]")]
    predicted = np.concatenate([[0.0], block.Phi[0, 0] * state[:-1]])
    value = residuals.value[:, 0] + block.C[0] * predicted
    return on_grid(residuals.time_s[residuals.used], value[residuals.used], 1.0 / vehicle.sensors["compass"].rate_hz)


def smoothed(vehicle: nf.Vehicle, mission: Mission) -> Array:
    """Reading minus smoothed heading."""
    track = nf.replay(vehicle, mission, smooth=True, output_rate_hz=None)
    time_s, reading = used_readings(track, mission)
    rows = np.searchsorted(track.time_s, time_s + 1e-6) - 1
    return on_grid(time_s, wrap(reading - track.attitude[rows, 2]), 1.0 / vehicle.sensors["compass"].rate_hz)


def detrended(channel: ChannelSeries) -> Array:
    """Open-loop series minus its straight line."""
    at, known = np.arange(float(channel.value.size)), np.isfinite(channel.value)
    line = np.polynomial.Polynomial.fit(at[known], channel.value[known], 1)
    return np.asarray(channel.value - line(at))


def plain_fit(series: Array, order: tuple[int, int], period_s: float) -> ArmaModel:
    """The model of a series taken for the error itself."""
    return fit_channel(series - np.nanmean(series), Drift((), period_s), *order).model


def in_force(vehicle: nf.Vehicle, model: ArmaModel) -> nf.Vehicle:
    """The vehicle with this model of its compass, fixed."""
    return vehicle.with_error(compass=nf.Arma(ar=tuple(model.ar), ma=tuple(model.ma), sd=model.sd))


def compass_models(vehicle: nf.Vehicle, mission: Mission, order: tuple[int, int]) -> dict[str, ArmaModel]:
    """What each way of making a series learns from a mission."""
    channel = residual_series(vehicle, mission, ["compass"])["compass"][0]
    models = {
        "closed loop": plain_fit(closed_loop(vehicle, mission), order, channel.period_s),
        "detrended": plain_fit(detrended(channel), order, channel.period_s),
        "joint": fit_channel(channel.value, channel.drift, *order, white=channel.white).model,
    }
    now = vehicle
    for number in (1, 2, 3):
        model = plain_fit(smoothed(now, mission), order, channel.period_s)
        now = in_force(vehicle, model)
        if number != 2:
            models[f"smoothed, {number} pass{'es' * (number > 1)}"] = model
    return models


# --- scores ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Of one source in one mission: S(0) identified over true, mean squared heading error [rad^2], its NEES."""

    s0: float
    squared: float
    nees: float


def compass_run(job: tuple[str, str, int]) -> dict[str, Score]:
    """All sources on one mission."""
    scenario, gyro, seed = job
    ready = staged(scenario, gyro)
    mission, vehicle = ready.mission(seed), ready.vehicle
    assert ready.truth is not None
    truth: ErrorModel = ready.truth["compass"]  # type: ignore[assignment]
    level = block_level(truth.block(1.0 / vehicle.sensors["compass"].rate_hz))
    models = compass_models(vehicle, until(mission, LEARN_S), COMPASS[scenario])
    vehicles = {name: in_force(vehicle, model) for name, model in models.items()} | {
        "oracle": vehicle.with_error(compass=truth)
    }
    scores = {}
    for name in SOURCES:
        track = nf.replay(vehicles[name], mission, output_rate_hz=1.0)
        errors = track.errors(mission.truth)
        rows = (track.time_s >= LEARN_S) & np.isfinite(errors.heading)
        nees = float(np.mean(track.nees(errors)["heading"][rows]))
        s0 = 0.5 * models[name].spectrum(0.0, 1.0) / level if name in models else 1.0
        scores[name] = Score(s0, float(np.mean(errors.heading[rows] ** 2)), nees)
    return scores


def spectrum(model: ErrorModel, period_s: float, freq_hz: Array) -> Array:
    """Spectral density per sample of an error model [unit^2], so that white noise has its variance."""
    block = model.block(period_s)
    eye, root = np.eye(block.size), np.exp(2j * math.pi * freq_hz * period_s)
    response = [np.linalg.solve((z * eye - block.Phi).T, block.C) if block.size else np.zeros(0) for z in root]
    return np.array([(r @ block.Q @ r.conj()).real + block.r for r in response])


def axes_run(job: tuple[str, str, int]) -> list[tuple[float, float]]:
    """S(0) ratio and largest factor between the spectra, by axis of the sensor under study."""
    scenario, gyro, seed = job
    ready = staged(scenario, gyro)
    assert ready.truth is not None
    ((sensor, truth),) = ready.truth.items()
    figures = []
    for axis, channel in enumerate(residual_series(ready.vehicle, ready.mission(seed), [sensor])[sensor]):
        model = fit_channel(channel.value, channel.drift, *OTHERS[scenario][axis], white=channel.white).model
        true = truth if isinstance(truth, ErrorModel) else truth[axis]
        known = np.flatnonzero(np.isfinite(channel.value))
        lowest = CYCLES / ((known[-1] - known[0]) * channel.period_s)
        freq = np.geomspace(lowest, 0.5 / channel.period_s, 300)
        found = nf.Arma(ar=tuple(model.ar), ma=tuple(model.ma), sd=model.sd)
        factor = np.abs(np.log(spectrum(found, channel.period_s, freq) / spectrum(true, channel.period_s, freq)))
        figures.append(
            (0.5 * model.spectrum(0.0, 1.0) / block_level(true.block(channel.period_s)), math.exp(float(factor.max())))
        )
    return figures


# --- tables ---------------------------------------------------------------------------------------------------------


BOTH, SPREAD = "scenario<16 gyro<8 runs>4d", "s0_median>9.3g s0_10>8.3g s0_90>8.3g"
Rows = list[dict[str, Any]]


def spread(ratios: Sequence[float]) -> dict[str, float]:
    """Median and 10-90 % of S(0) identified over true."""
    return dict(zip(("s0_median", "s0_10", "s0_90"), np.quantile(ratios, [0.5, 0.1, 0.9]).tolist(), strict=True))


def compass_rows(results: list[dict[str, Score]]) -> Rows:
    """All sources over the same seeds."""
    rms = {name: math.degrees(math.sqrt(np.mean([r[name].squared for r in results]))) for name in SOURCES}
    rows = []
    for name in SOURCES:
        nees = np.array([r[name].nees for r in results])
        error = float(nees.std(ddof=1) / math.sqrt(nees.size)) if nees.size > 1 else None
        row = {"source": name, "heading_rms_deg": rms[name], "over_oracle": rms[name] / rms["oracle"]}
        rows.append(row | {"nees": float(nees.mean()), "nees_sem": error} | spread([r[name].s0 for r in results]))
    return rows


def axis_rows(results: list[list[tuple[float, float]]]) -> Rows:
    """All axes of a sensor."""
    rows = []
    for axis, (s0, factor) in enumerate(np.array(results).transpose(1, 2, 0)):
        median, most = np.quantile(factor, [0.5, 0.9]).tolist()
        rows.append({"axis": axis, "factor_median": median, "factor_90": most} | spread(s0))
    return rows


OF_COMPASS = f"{BOTH} source<18 {SPREAD} heading_rms_deg>8.4f over_oracle>7.3f nees>7.2f nees_sem>5.2f"
OF_AXES = f"{BOTH} axis>4d {SPREAD} factor_median>8.3g factor_90>8.3g"
STUDIES: dict[str, tuple[Iterable[str], Callable[..., object], Callable[..., Rows], str]] = {
    "compass": (COMPASS, compass_run, compass_rows, OF_COMPASS),
    "others": (OTHERS, axes_run, axis_rows, OF_AXES),
}


def residual_source(options: Options) -> dict[str, Rows]:
    """Simulate, learn from every source, replay, print."""
    gyros = ("tactical", "mems") if options.gyro == "both" else (options.gyro,)
    seeds = range(options.seed, options.seed + (1 if options.quick else options.runs))
    tables = {}
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        for kind, (scenarios, run, make, columns) in STUDIES.items():
            table = Table(columns)
            for scenario, gyro in product(filter(lambda name: options.only in name, scenarios), gyros):
                results = list(pool.map(run, [(scenario, gyro, seed) for seed in seeds]))
                for row in make(results):
                    table.add({"scenario": scenario, "gyro": gyro, "runs": len(results)} | row)
            tables[kind] = table.rows
    return tables


if __name__ == "__main__":
    flags = [
        flag("--runs", type=int, default=12, help="seeds per scenario"),
        flag("--seed", type=int, default=0, help="the first seed"),
        flag("--only", default="", help="only scenarios whose name contains this"),
        flag("--gyro", choices=["tactical", "mems", "both"], default="both"),
        flag("--workers", type=int, default=os.cpu_count() or 1),
        quick("one seed per scenario"),
    ]
    main(__doc__, {residual_source: flags})

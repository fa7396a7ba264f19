"""How honest learnt models are by kind of sensor, rate and vehicle, where the campaigns have one vehicle only.

Each sensor that errs in a coloured way is described within a factor of two, and learns (`learnt`). The same missions
are replayed by the vehicle that is told the truth (`oracle`) and by the description as it stands (`vehicle`), forward
as first given out and smoothed. Printed, slot by slot: NEES of position and heading, mean over the missions, of the
learnt model the largest, too, and root mean squares of horizontal position and heading over those of the oracle. 1 is
honest; errors are so slow that the mean of six missions of the truth itself is between 0.4 and 2. With `--within 2 3`
the learnt model is told how far its description is believed, and with `--wrong` that is as wrong as wanted. Its rivals
are the two other vehicles; there is no other software in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from faults_outcomes import ahrs, beams, magnetometer, ranges, water, wheels, with_others
from harness import Options, Table, flag, main, quick
from honest_constants import ARM, DEVIATION, SCALE, unsure
from honest_constants import MOTIONS as DIVES

import navfilter as nf
from navfilter.simulation.scenarios import reckoning_vehicle, survey_vehicle, transit
from navfilter.simulation.simulate import Faults, simulate

DEG = math.pi / 180.0
SLOTS = ((60.0, 120.0), (120.0, 520.0), (520.0, 1200.0), (1200.0, 2700.0), (2700.0, 5400.0))
MOTIONS = {**DIVES, "transit": transit}
Model = nf.ErrorModel | tuple[nf.ErrorModel, ...]
SIDEWAYS = nf.White(sd=0.05)
#: What sensors do, and what is said of them.
ERRORS: dict[str, tuple[Model, Model]] = {
    "compass": (
        nf.GaussMarkov(sd=0.4 * DEG, tau_s=60.0) + nf.White(sd=0.15 * DEG),
        nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG),
    ),
    "dvl": (
        nf.GaussMarkov(sd=0.015, tau_s=20.0) + nf.White(sd=0.01),
        nf.GaussMarkov(sd=0.02, tau_s=30.0) + nf.White(sd=0.01),
    ),
    "gps": (
        nf.GaussMarkov(sd=2.0, tau_s=100.0) + nf.White(sd=0.7),
        nf.GaussMarkov(sd=3.0, tau_s=60.0) + nf.White(sd=0.5),
    ),
    "depth": (
        nf.GaussMarkov(sd=0.1, tau_s=100.0) + nf.White(sd=0.05),
        nf.GaussMarkov(sd=0.1, tau_s=60.0) + nf.White(sd=0.05),
    ),
    "wheels": (
        (nf.GaussMarkov(sd=0.03, tau_s=20.0) + nf.White(sd=0.02), SIDEWAYS, SIDEWAYS),
        (nf.GaussMarkov(sd=0.03, tau_s=30.0) + nf.White(sd=0.02), SIDEWAYS, SIDEWAYS),
    ),
}
ALL = ("compass", "dvl", "gps", "depth")


def without(vehicle: nf.Vehicle, *names: str) -> nf.Vehicle:
    """The vehicle without some sensors."""
    return nf.Vehicle(vehicle.drive, {name: one for name, one in vehicle.sensors.items() if name not in names})


#: By name: the vehicle beside a tactical unit, which of its sensors learn, whether it has fixes all along.
CASES: Mapping[str, tuple[Callable[[], nf.Vehicle], tuple[str, ...], bool]] = {
    "compass": (survey_vehicle, ("compass",), False),
    "compass at 1 Hz": (lambda: unsure(survey_vehicle(), "compass", rate_hz=1.0), ("compass",), False),
    "compass at 25 Hz": (lambda: unsure(survey_vehicle(), "compass", rate_hz=25.0), ("compass",), False),
    "compass, deviation": (lambda: unsure(survey_vehicle(), "compass", **DEVIATION), ("compass",), False),
    "magnetometer": (magnetometer, ("compass",), False),
    "dvl": (survey_vehicle, ("dvl",), False),
    "dvl at 1 Hz": (lambda: unsure(survey_vehicle(), "dvl", rate_hz=1.0), ("dvl",), False),
    "dvl, scale and arm": (lambda: unsure(survey_vehicle(), "dvl", **SCALE, **ARM), ("dvl",), False),
    "dvl, no compass": (lambda: without(survey_vehicle(), "compass"), ("dvl",), False),
    "beams": (beams, ("dvl",), False),
    "wheels": (wheels, ("dvl",), False),
    "all": (survey_vehicle, ALL, False),
    "all, fixes": (survey_vehicle, ALL, True),
    "boat": (lambda: without(survey_vehicle(), "dvl"), ("compass", "gps"), True),
    "boat, no compass": (lambda: without(survey_vehicle(), "dvl", "compass"), ("gps",), True),
    "ahrs": (ahrs, ("dvl", "depth"), False),
    "usbl": (lambda: with_others(usbl=nf.Usbl(rate_hz=0.2)), ("compass", "dvl"), False),
    "ranges": (ranges, ("compass", "dvl"), False),
    "water": (water, ("compass",), False),
    "reckoning": (reckoning_vehicle, ("gps", "depth"), True),
}


def described(case: str, mems: bool) -> tuple[nf.Vehicle, dict[str, tuple[Model, Model]], bool]:
    """The vehicle with honest sensors, those that err, and whether it has fixes all along."""
    make, learning, fixes = CASES[case]
    vehicle = make()
    if mems and vehicle.drive.inertial:
        vehicle = nf.Vehicle(survey_vehicle(mems=True).drive, dict(vehicle.sensors))
    belief = {"compass": ERRORS["compass"][1], "gps": ERRORS["gps"][1]}
    vehicle = vehicle.with_error(**{name: model for name, model in belief.items() if name in vehicle.sensors})
    errors = {name: ERRORS["wheels" if case == "wheels" else name] for name in learning}
    return vehicle, errors, fixes


def learnt(prior: Model, within: list[float] | None) -> Any:
    """Learns, axis by axis, what is not said to be white."""
    if isinstance(prior, tuple):
        return tuple(one if isinstance(one, nf.White) else learnt(one, within) for one in prior)
    return nf.LearnedArma(prior=prior, prior_within=within)


def worse(model: Model, sd: float, tau: float) -> Model:
    """The description with the sizes and times of its slow errors multiplied."""
    if isinstance(model, tuple):
        return tuple(worse(one, sd, tau) for one in model)  # type: ignore[misc]
    if isinstance(model, nf.GaussMarkov):
        return nf.GaussMarkov(sd=sd * model.sd, tau_s=tau * model.tau_s, order=model.order)
    parts = getattr(model, "parts", ())
    return sum((worse(part, sd, tau) for part in parts[1:]), worse(parts[0], sd, tau)) if parts else model  # type: ignore


def runs(case: str, options: Options, mems: bool, seed: int, seconds: float) -> dict[str, np.ndarray]:
    """One mission by each vehicle: (2 tracks, slots, 4) of position and heading, NEES first."""
    vehicle, errors, fixes = described(case, mems)
    errors = {name: (truth, worse(prior, *options.wrong)) for name, (truth, prior) in errors.items()}
    vehicles = {
        "oracle": vehicle.with_error(**{name: truth for name, (truth, _) in errors.items()}),
        "learnt": vehicle.with_error(**{name: learnt(prior, options.within) for name, (_, prior) in errors.items()}),
        "vehicle": vehicle.with_error(**{name: prior for name, (_, prior) in errors.items()}),
    }
    at = {"gps": Faults(available="always" if fixes else "surface")}
    mission = simulate(vehicles["oracle"], MOTIONS[options.motion](seconds), seed=seed, duration_s=seconds, faults=at)
    found = {}
    for name, one in vehicles.items():
        smoothed = nf.replay(one, mission, smooth=True, output_rate_hz=1.0)
        assert smoothed.forward is not None
        found[name] = np.array([figures(track, mission) for track in (smoothed.forward, smoothed)])
    return found


def figures(track: nf.Track, mission: nf.Mission) -> list[list[float]]:
    """Of each slot: NEES of position and heading, mean square errors [m^2], [rad^2]."""
    errors, rows = track.errors(mission.truth), []
    nees = track.nees(errors)
    for begin, end in SLOTS:
        within = (track.time_s >= begin) & (track.time_s < end)
        values = nees["position"], nees["heading"], errors.horizontal**2, errors.heading**2
        rows.append([float(np.nanmean(value[within])) if within.any() else math.nan for value in values])
    return rows


def honest_kinds(options: Options) -> list[dict[str, Any]]:
    """Simulate, replay, print."""
    seeds = range(options.seed, options.seed + (1 if options.quick else options.runs))
    seconds = 200.0 if options.quick else 60.0 * options.minutes
    columns = "oracle>7.2f learnt>7.2f largest>8.2f vehicle>8.2f"
    table = Table(f"learns<20 unit<9 track<9 slot<9 what<9 {columns} rms/oracle>10.2f rms_vehicle>11.2f")
    for case in CASES:
        if options.only not in case:
            continue
        for unit in ("tactical",) if case == "reckoning" else options.units:
            drawn = [runs(case, options, unit == "mems", seed, seconds) for seed in seeds]
            of = {name: np.array([one[name] for one in drawn]) for name in drawn[0]}
            rms = {name: np.sqrt(values.mean(0)) for name, values in of.items()}
            for t, s, k in np.ndindex(2, len(SLOTS), 2):
                if math.isnan(of["oracle"][0, t, s, k]):
                    continue
                row = {name: values[:, t, s, k].mean() for name, values in of.items()}
                row |= {"learns": case, "unit": unit, "largest": of["learnt"][:, t, s, k].max()}
                row |= {"track": ("forward", "smoothed")[t], "what": ("position", "heading")[k]}
                row["rms/oracle"] = rms["learnt"][t, s, 2 + k] / rms["oracle"][t, s, 2 + k]
                row["rms_vehicle"] = rms["vehicle"][t, s, 2 + k] / rms["oracle"][t, s, 2 + k]
                table.add(row | {"slot": f"{SLOTS[s][0]:g}-{SLOTS[s][1]:g}"})
    return table.rows


if __name__ == "__main__":
    flags = [
        flag("--runs", type=int, default=6, help="missions of each"),
        flag("--seed", type=int, default=941, help="the first of their seeds"),
        flag("--minutes", type=float, default=20.0),
        flag("--motion", choices=list(MOTIONS), default="lawnmower"),
        flag("--within", nargs=2, type=float, metavar="FACTOR", help="believe the description so far: sd, time"),
        flag(
            "--wrong",
            nargs=2,
            type=float,
            metavar="FACTOR",
            default=[1.0, 1.0],
            help="described so much larger, longer",
        ),
        flag("--units", nargs="+", choices=["tactical", "mems"], default=["tactical", "mems"]),
        flag("--only", default="", help="only what contains this"),
        quick("one mission of 200 s each"),
    ]
    main(__doc__, {honest_kinds: flags})

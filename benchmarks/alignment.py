"""How honest a run is that begins by an alignment on its own first readings, and how accurate.

Each mission begins at rest or under way, with fixes all along. It is replayed from an alignment (`aligned`), and from a
start that is given (`given`), drawn about the truth with its own standard deviations: the rival, for there is
no other software in it. Printed, from 20 s behind the start: NEES of position and heading, forward and smoothed, mean
and for the position the largest of the missions, and root mean squares. 1 is honest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from harness import Options, Table, flag, main, quick

import navfilter as nf
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import survey_vehicle
from navfilter.simulation.simulate import Faults, StartErrors, simulate

SCORED_AFTER_S = 20.0


def there_and_back(speed_m_s: float) -> Motion:
    """Five seconds at rest, then legs of a minute and right angles."""
    begin = (Wait(5.0), ChangeSpeed(speed_m_s, max(10.0, speed_m_s)), Straight(duration_s=60.0))
    return Motion(begin + (Turn(90.0), Straight(duration_s=60.0)) * 6, latitude_deg=30.0)


def with_fixes(error: nf.ErrorModel, *without: str) -> Callable[[bool], nf.Vehicle]:
    """A survey vehicle with such fixes, without some of its sensors."""

    def make(mems: bool) -> nf.Vehicle:
        vehicle = survey_vehicle(mems=mems).without(*without)
        fixes = replace(vehicle.sensors["gps"], error=error)
        return nf.Vehicle(vehicle.drive, {**vehicle.sensors, "gps": fixes}, vehicle.name)

    return make


SLOW = nf.GaussMarkov(sd=3.0, tau_s=60.0)
#: By name: the vehicle, its speed [m/s], when the recording begins [s].
CASES: Mapping[str, tuple[Callable[[bool], nf.Vehicle], float, float]] = {
    "compass, DVL, at rest": (with_fixes(SLOW), 1.5, 0.0),
    "compass, DVL, under way": (with_fixes(SLOW), 1.5, 40.0),
    "DVL, at rest": (with_fixes(SLOW, "compass"), 1.5, 0.0),
    "DVL, fixes of 5 m, at rest": (with_fixes(nf.White(sd=5.0), "compass"), 1.5, 0.0),
    "DVL, fixes of 5 m, under way": (with_fixes(nf.White(sd=5.0), "compass"), 1.5, 40.0),
    "fixes of 1 m, 15 m/s": (with_fixes(nf.White(sd=1.0), "compass", "dvl", "depth"), 15.0, 40.0),
    "fixes of 5 m, at rest": (with_fixes(nf.White(sd=5.0), "compass", "dvl", "depth"), 15.0, 0.0),
    "fixes of 2 cm, at rest": (with_fixes(nf.White(sd=0.02), "compass", "dvl", "depth"), 5.0, 0.0),
}


def figures(vehicle: nf.Vehicle, mission: nf.Mission, start: nf.Start) -> list[float]:
    """NEES of position and heading, mean square errors [m^2], [rad^2]; forward, then smoothed."""
    smoothed, found = nf.replay(vehicle, mission, start=start, smooth=True, output_rate_hz=1.0), []
    assert smoothed.forward is not None
    for track in (smoothed.forward, smoothed):
        errors = track.errors(mission.truth)
        nees, scored = track.nees(errors), track.time_s > start.time_s + SCORED_AFTER_S
        values = nees["position"], nees["heading"], errors.horizontal**2, errors.heading**2
        found += [float(np.nanmean(value[scored])) for value in values]
    return found


def alignment(options: Options) -> list[dict[str, Any]]:
    """Simulate, align, replay, print."""
    seeds = range(options.seed, options.seed + (2 if options.quick else options.runs))
    columns = "position>9.2f largest>8.1f heading>8.2f position_m>11.2f heading_deg>12.2f"
    table = Table(f"vehicle<29 unit<9 start<8 track<9 {columns}")
    for name, (make, speed, begin_s) in CASES.items():
        for unit in options.units:
            vehicle = make(unit == "mems")
            found: dict[str, list[list[float]]] = {"aligned": [], "given": []}
            for seed in seeds:
                faults = {"gps": Faults(available="always")}
                how: dict[str, Any] = {"seed": seed, "duration_s": 400.0, "faults": faults, "start": StartErrors()}
                mission = simulate(vehicle, there_and_back(speed), **how)
                given = mission.start
                later = mission.between(begin_s, mission.end_s)
                found["aligned"].append(figures(vehicle, later, nf.align(vehicle, replace(later, start=None))))
                found["given"].append(figures(vehicle, mission, given))
            for start, values in found.items():
                mean, most = np.mean(values, axis=0), np.max(values, axis=0)
                for k, track in enumerate(("forward", "smoothed")):
                    position, heading, square_m, square = mean[4 * k : 4 * k + 4].tolist()
                    row = {"vehicle": name, "unit": unit, "start": start, "track": track, "position": position}
                    row |= {"largest": float(most[4 * k]), "heading": heading, "position_m": math.sqrt(square_m)}
                    table.add(row | {"heading_deg": math.degrees(math.sqrt(square))})
    return table.rows


if __name__ == "__main__":
    flags = [
        flag("--runs", type=int, default=12, help="missions of each"),
        flag("--seed", type=int, default=4001, help="the first of their seeds"),
        flag("--units", nargs="+", choices=["tactical", "mems"], default=["tactical", "mems"]),
        quick("two missions of each"),
    ]
    main(__doc__, {alignment: flags})

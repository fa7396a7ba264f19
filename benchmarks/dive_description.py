"""How a DVL errs, as the ends of other dives tell: no other software, no truth of the dive that is judged.

White noise is what the innovations scatter by on straight ways (0.004 to 0.006 m/s); gyros are as a data sheet has
them, 0.003 deg/s a sample. The slow error is what nothing under way tells apart from a tilt or a current. So each of 36
descriptions replays the other eight dives, and a fix at the end of each says how likely it is; the posterior means of
ln sd and ln tau, all descriptions being equally likely beforehand, are handed out. Lever arm: the mean of the states of
all nine (`lever_arm_sd_m`), which need no truth either.

The truth's position jumps where turns begin (`dive_cases.jumps`), its velocity does not: fix and NEES are without these
jumps, or as printed (``--printed``). Environment variable NAVFILTER_DATA.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import dive_cases as dives
import numpy as np
from harness import Array, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.io import read_vehicle

SD_M_S = (0.005, 0.0075, 0.01, 0.015, 0.02, 0.03)
TAU_S = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
WHITE_M_S = 0.005
Description = tuple[float, float]


def run(options: Options) -> dict[str, Any]:
    """The description of each dive by the others, of all by all, and whether it is honest there."""
    grid = list(itertools.product(SD_M_S, TAU_S))[:: 12 if options.quick else 1]
    chosen = dives.DIVES[: 3 if options.quick else None]
    nees = "nees" if options.printed else "nees_mended"
    with ProcessPoolExecutor(options.processes) as pool:
        ends = dict(
            zip(
                chosen,
                pool.map(ends_of, chosen, itertools.repeat(grid), itertools.repeat(options.printed)),
                strict=True,
            )
        )
        others = [posterior_mean(grid, sum(ends[one] for one in chosen if one != dive)) for dive in chosen]
        together = posterior_mean(grid, sum(ends.values()))
        found = {}
        for label, handed in (("by the others", others), ("by all", [together] * len(chosen))):
            print(f"described {label}")
            table = Table("dive>4d sd_m_s>7.4f tau_s>6.1f nees>6.2f nees_mended>11.2f rms_m>6.2f")
            for row in pool.map(judged, chosen, handed):
                table.add(row)
            honest = sum(0.5 <= row[nees] <= 2.0 for row in table.rows)
            print(f"NEES 0.5 to 2 in {honest} of {len(chosen)} dives\n")
            found[label] = {"dives": table.rows, "honest": honest}
    return found


def ends_of(dive: int, grid: Sequence[Description], printed: bool) -> Array:
    """Log-likelihood of a fix at the end of a dive by all descriptions."""
    mission, found = dives.recorded(dive), []
    for sd, tau_s in grid:
        off, P = end_of(nf.replay(described(sd, tau_s), mission), mission)
        jumped = dives.jumps(dive)[-1] - dives.jumps(dive)[1]
        found.append(log_likelihood(off if printed else off + jumped, P))
    return np.array(found)


def judged(dive: int, handed: Description) -> dict[str, Any]:
    """A dive with the description that is handed out."""
    mission, vehicle = dives.recorded(dive), described(*handed)
    case = dives.Case("raw", dive, 0, False, mission, vehicle)
    return {
        "dive": dive,
        "sd_m_s": handed[0],
        "tau_s": handed[1],
        **dives.figures_of(nf.replay(vehicle, mission), case),
    }


def posterior_mean(grid: Sequence[Description], likelihoods: Any) -> Description:
    """Of the logarithms, all descriptions being equally likely beforehand."""
    weights = np.exp(likelihoods - np.max(likelihoods))
    sd, tau_s = np.exp(np.average(np.log(grid), axis=0, weights=weights))
    return float(sd), float(tau_s)


def described(sd: float, tau_s: float) -> nf.Vehicle:
    """The vehicle of the recordings with another slow error of the DVL [m/s], [s]."""
    vehicle = read_vehicle(dives.FOLDER / f"{dives.DIVES[0]:02d}")
    error = nf.GaussMarkov(sd=sd, tau_s=tau_s) + nf.White(sd=WHITE_M_S)
    return replace(vehicle, sensors={**vehicle.sensors, "dvl": replace(vehicle.sensors["dvl"], error=error)})


def end_of(track: nf.Track, mission: nf.Mission) -> tuple[Array, Array]:
    """Error north and east at the last row of the truth within the track [m], and its covariance."""
    truth = mission.truth
    assert truth is not None
    there = track.at(truth.time_s[truth.time_s <= track.time_s[-1]][-1:])
    return there.errors(truth).position_n[0, :2], there.covariance[0, :2, :2]


def log_likelihood(off: Array, P: Array) -> float:
    """Of a fix, but for a constant."""
    return float(-0.5 * (off @ np.linalg.solve(P, off) + np.log(np.linalg.det(P))))


if __name__ == "__main__":
    main(
        __doc__,
        {
            run: [
                flag("--printed", action="store_true", help="fixes and NEES against the truth as printed"),
                flag("--processes", type=int, default=2, help="at a time (default 2)"),
                quick("three dives, three descriptions"),
            ]
        },
    )

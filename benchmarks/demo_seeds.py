"""The hour of `navfilter demo` with many seeds: what learning the compass is worth, over the vehicle file's model and
Gauss-Markov noise that is fitted to the whole hour.

Printed a seed: rms of heading [deg] and position [m] and NEES of heading, of the file, of ``gm1-fitted``, of the learnt
compass and of the filter that is told the truth; then medians over the seeds, and of the ratios learnt / other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import Options, Table, flag, main, quick

import navfilter as nf
from navfilter.simulation.scenarios import simulate_scenario, true_vehicle

MODELS = ("file", "gm1-fitted", "learnt", "told")


def figures(seed: int) -> list[list[float]]:
    """Heading rms [deg], position rms [m] and NEES of heading of each model."""
    vehicle, mission = simulate_scenario("demo", seed)
    truth = true_vehicle("demo")
    assert truth is not None and mission.truth is not None
    vehicles = (
        vehicle,
        nf.rival("gm1-fitted", vehicle, mission, sensors=["compass"]),
        nf.rival("arma", vehicle, mission, sensors=["compass"]),
        vehicle.with_error(compass=truth.sensors["compass"].error),
    )
    rows = []
    for own in vehicles:
        track = nf.replay(own, mission, output_rate_hz=1.0)
        errors = track.errors(mission.truth)
        square = np.sum(errors.position_n[:, :2] ** 2, axis=1)
        nees = np.mean(errors.heading**2 / track.covariance[:, 8, 8])
        rows.append([float(np.degrees(np.sqrt(np.mean(errors.heading**2)))), float(np.sqrt(np.mean(square))), nees])
    return rows


def run(options: Options) -> dict[str, Any]:
    """See above."""
    table = Table("seed>6 model<10 heading_deg>11.3f position_m>10.2f nees>6.2f")
    found = []
    for seed in range(options.seed, options.seed + (2 if options.quick else options.seeds)):
        found.append(figures(seed))
        for name, row in zip(MODELS, found[-1], strict=True):
            table.add(
                {"seed": seed, "model": name} | dict(zip(("heading_deg", "position_m", "nees"), row, strict=True))
            )
    every, medians = np.array(found), Table("learnt_over<12 heading>8.3f position>8.3f")
    for k, name in enumerate(MODELS):
        if name != "learnt":
            heading, position = np.median(every[:, 2, :2] / every[:, k, :2], axis=0)
            medians.add({"learnt_over": name, "heading": float(heading), "position": float(position)})
    return {"rows": table.rows, "medians": medians.rows}


if __name__ == "__main__":
    main(
        __doc__ or "",
        {
            run: (
                flag("--seeds", type=int, default=20, metavar="N", help="default 20"),
                flag("--seed", type=int, default=1, metavar="S", help="the first"),
                quick("two seeds"),
            )
        },
    )

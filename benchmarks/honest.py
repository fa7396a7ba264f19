"""How honest and how accurate a model learnt under way is, slot by slot of the mission, in every scenario.

Each seed is one simulated mission. It is replayed with the model that learns (`arma`), against the truth (`oracle`, the
vehicle that is told the sensor's true error model), Gauss-Markov fitted to the whole mission beforehand
(`gm1-fitted`) and the vehicle file as it stands (`vehicle`). Slots are 60 to 120, 120 to 520, 520 to 1200 and 1200 to
1800 s, cut where the mission ends; the time after a change of the error is a slot of its own. The forward track is
scored as first given out. "met" counts the bars of `honest_bars.py` that hold, "missed"
names the others.

With --keep finished runs stay in a folder, and the same command continues there. With --references the runs of all
models but the learnt one are taken from what an earlier program has kept: what is changed in the learner leaves them as
they are, and they are half of the work. The last table is processor time.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from harness import Options, Table, flag, main, quick
from honest_bars import JUDGED, Bar, bars

import navfilter as nf
from navfilter.evaluation.montecarlo.campaign import Campaign, SlotRow, Store, run_campaign, slot_rows
from navfilter.evaluation.montecarlo.workers import process_pool
from navfilter.simulation.scenarios import GYROS, MOTIONS, STUDIES

RIVALS = ("oracle", "gm1-fitted", "vehicle")
#: Columns of the table: quantity and reference.
FIGURES = {
    "heading": ("heading_rms_deg", ""),
    "h/oracle": ("heading_rms_deg", "oracle"),
    "h/gm1": ("heading_rms_deg", "gm1-fitted"),
    "h/vehicle": ("heading_rms_deg", "vehicle"),
    "NEES_h": ("anees_heading", ""),
    "NEES_h/o": ("anees_heading", "oracle"),
    "h>3sd_%": ("beyond_heading", ""),
    "position": ("position_rms_m", ""),
    "p/oracle": ("position_rms_m", "oracle"),
    "p/gm1": ("position_rms_m", "gm1-fitted"),
    "p/vehicle": ("position_rms_m", "vehicle"),
    "down": ("down_rms_m", ""),
    "d/oracle": ("down_rms_m", "oracle"),
    "d/gm1": ("down_rms_m", "gm1-fitted"),
    "d/vehicle": ("down_rms_m", "vehicle"),
    "NEES_p": ("anees_position", ""),
    "NEES_p/o": ("anees_position", "oracle"),
    "p>3sd_%": ("beyond_position", ""),
}
NAMES = {key: name for name, key in FIGURES.items()}


def honest(options: Options) -> dict[str, Any]:
    """Every scenario, motion and gyro asked for."""
    nf.warm_up()
    seeds = range(options.first_seed, options.first_seed + (1 if options.quick else options.seeds))
    where = " ".join(f"{name}>5.2f" for name in FIGURES)
    table, found = Table(f"scenario<36 slot<11 track<8 {where} met>6 missed<6"), {}
    with contextlib.ExitStack() as stack:
        kept = Path(options.keep or stack.enter_context(tempfile.TemporaryDirectory(prefix="honest-")))
        pool = stack.enter_context(process_pool(options.workers)) if options.workers > 1 else None
        for campaign in campaigns(options):
            rivals = [m for m in options.rivals if m != "oracle" or campaign.staged.oracle is not None]
            models = (JUDGED, *rivals)
            folder = kept / campaign.name.replace("/", "-")
            if options.references:
                take(campaign, seeds, models, Path(options.references) / folder.name, folder)
            results = run_campaign(campaign, seeds, models, folder, pool)
            rows = slot_rows(results)
            judged = bars(campaign, rows)
            for row in lines(campaign, rows, judged):
                table.add(row)
            found[campaign.name] = {
                "settings": campaign.settings,
                "slots": [asdict(row) for row in rows],
                "bars": [asdict(bar) | {"met": bar.met} for bar in judged],
                "cpu_s": dict(zip(results.models, results.cpu_s.tolist(), strict=True)),
            }
    return {"table": table.rows, "cpu_s": costs(found), "campaigns": found}


def campaigns(options: Options) -> Iterator[Campaign]:
    for scenario in options.scenarios or STUDIES:
        for gyro in options.gyros:
            for motion in options.motions:
                yield Campaign(
                    scenario,
                    motion=motion,
                    gyro=gyro,
                    duration_s=300.0 if options.quick else options.duration,
                    smooth=options.smooth,
                    imu_rate_hz=options.imu_rate,
                )


def take(campaign: Campaign, seeds: Sequence[int], models: Sequence[str], source: Path, folder: Path) -> None:
    """Copy the runs that do not learn from the folder of the same campaign by another program."""
    plan = source / "campaign.json"
    if not plan.exists():
        return
    settings = json.loads(plan.read_text())
    if settings | {"program": ""} != campaign.settings | {"program": ""}:
        raise SystemExit(f"{source} holds a campaign with other settings: no references for {campaign.name}.")
    there, here = Store(source, settings), Store(folder, campaign.settings)
    for seed in seeds:
        for model in (model for model in models if model != JUDGED):
            record = there.load(seed, model)
            if record is not None:
                here.save(seed, model, record)


def lines(campaign: Campaign, rows: Sequence[SlotRow], judged: Sequence[Bar]) -> Iterator[dict[str, Any]]:
    """The judged model's figures, a line per track and slot; the last is all slots together."""
    own = [row for row in rows if row.model == JUDGED]
    for track, begin, end in dict.fromkeys((row.track, row.begin_s, row.end_s) for row in own):
        here = [row for row in own if (row.track, row.begin_s, row.end_s) == (track, begin, end)]
        there = [bar for bar in judged if (bar.track, bar.begin_s, bar.end_s) == (track, begin, end)]
        line: dict[str, Any] = {"scenario": campaign.name, "slot": f"{begin:g}-{end:g}", "track": track}
        for row in here:
            factor = 100.0 if row.quantity.startswith("beyond") else 1.0
            line[NAMES[row.quantity, row.reference]] = factor * row.value
        missed = [NAMES[bar.quantity, bar.reference] for bar in there if not bar.met]
        yield line | {"met": f"{len(there) - len(missed)}/{len(there)}", "missed": " ".join(missed)}


def costs(found: dict[str, Any]) -> dict[str, float]:
    """Median processor time of a run [s] by model, over all missions."""
    print("\nprocessor time of one run, median over all missions")
    table, result = Table("model<12 cpu_s>7.2f"), {}
    for model in dict.fromkeys(name for one in found.values() for name in one["cpu_s"]):
        spent = np.concatenate([one["cpu_s"].get(model, []) for one in found.values()])
        result[model] = float(np.median(spent))
        table.add({"model": model, "cpu_s": result[model]})
    return result


if __name__ == "__main__":
    flags = [
        flag("--scenarios", nargs="+", choices=STUDIES, metavar="NAME", help="default: all"),
        flag("--seeds", type=int, default=50, metavar="N", help="missions of each (default: %(default)s)"),
        flag("--first-seed", type=int, default=1, metavar="S", help="default: %(default)s"),
        flag("--gyros", nargs="+", choices=GYROS, default=GYROS, help="default: both"),
        flag("--motions", nargs="+", choices=MOTIONS, default=MOTIONS, help="default: both"),
        flag("--rivals", nargs="*", choices=RIVALS, default=RIVALS, help="default: all"),
        flag("--smooth", action="store_true", help="score the smoothed track too"),
        flag("--duration", type=float, metavar="S", help="of a mission (default: that of the scenario)"),
        flag("--imu-rate", type=float, default=50.0, metavar="HZ", help="default: %(default)s"),
        flag("--workers", type=int, default=1, metavar="K", help="processes (default: %(default)s)"),
        flag("--keep", metavar="DIR", help="keep finished runs there, and go on from them"),
        flag("--references", metavar="DIR", help="take the runs of all other models from what was kept there"),
        quick("one mission of five minutes of each scenario"),
    ]
    main(__doc__ or "", {honest: flags})

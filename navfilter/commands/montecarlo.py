"""``navfilter montecarlo``: its arguments and what it does. Everything heavy is imported where it is used."""

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from navfilter.commands import console


def run(options: argparse.Namespace) -> int:
    """Repeat a simulated scenario with many seeds and compare error models over all runs.

    one mission is simulated per seed and replayed with every model, so that models meet the same missions:
      white        white noise, fitted to the mission          arma       learns from scratch, under way
      gm1          Gauss-Markov through the 1/e point          oracle     the simulator's own model
      gm1-fitted   Gauss-Markov by likelihood, whole mission   vehicle    as the vehicle's description says

    written to --out:
      table.txt, results.csv, results.json   figures with 95 % intervals, and ratios with paired intervals; the same by
                                             slots of the mission (slots.csv)
      runs.npz                               every run
      envelope-*.png, nees.png, end-error.png
      runs/                                  finished runs: the same command continues a campaign that was stopped

    examples:
      navfilter montecarlo --list
      navfilter montecarlo --scenario compass-rolling --runs 50
      navfilter montecarlo compass-slow-10min --seeds 50 --rivals arma,oracle,vehicle --no-smooth --no-figures
      navfilter montecarlo --scenario compass-gm2 --motion transit --gyro mems --runs 50 --models gm1-fitted,arma,oracle
      navfilter montecarlo --scenario dvl-coloured --runs 1000 --dask tcp://10.0.0.1:8786
    """
    from navfilter.simulation.scenarios import STUDIES

    if options.list:
        width = max(map(len, STUDIES))
        for name, study in STUDIES.items():
            console.show(f"{name:{width}}  {study.duration_s / 60:3.0f} min  {study.about}")
        return 0
    scenario = options.scenario or options.named
    if scenario is None or (options.named or scenario) != scenario:
        raise ValueError("montecarlo needs one scenario (scenarios: navfilter montecarlo --list).")
    from navfilter.evaluation.montecarlo.campaign import Campaign

    campaign = Campaign(
        scenario,
        motion=options.motion,
        gyro=options.gyro,
        duration_s=options.duration,
        score_from_s=options.score_start,
        smooth=options.smooth,
        imu_rate_hz=options.imu_rate,
    )
    models = _models(options, campaign)
    where = options.out or Path("navfilter-montecarlo") / campaign.name.replace("/", "-")
    folder = console.output_folder(where, options.force, plan="campaign.json")
    console.compile_first(options.quiet)
    return _run(options, campaign, models, folder)


def _models(options: argparse.Namespace, campaign: Any) -> tuple[str, ...]:
    """The models asked for; the default ones without the oracle where there is no fixed truth."""
    from navfilter.evaluation.baselines import MODELS

    names = tuple(dict.fromkeys(name.strip() for name in options.models.split(",") if name.strip()))
    unknown = [name for name in names if name not in MODELS]
    if unknown or not names:
        raise ValueError(f'--models: there is no "{(*unknown, options.models)[0]}". Models: {", ".join(MODELS)}.')
    if "oracle" in names and campaign.staged.truth is None:
        if names == ("oracle",):
            raise ValueError(
                f'"oracle" needs one true model for the whole mission, but in {campaign.scenario} the noise changes.'
            )
        console.speaker(options.quiet)("(no oracle: the noise of this scenario changes, no fixed model is the truth)")
        names = tuple(name for name in names if name != "oracle")
    return names


def _run(options: argparse.Namespace, campaign: Any, models: tuple[str, ...], folder: Path) -> int:
    from navfilter.evaluation.montecarlo.campaign import Store, run_campaign
    from navfilter.evaluation.montecarlo.workers import cluster, process_pool
    from navfilter.playback.warm_up import available_cores

    say = console.speaker(options.quiet)
    Store(folder, campaign.settings)  # refuses a folder of another campaign before any worker is started
    seeds = range(options.seed, options.seed + options.runs)
    where = options.dask or f"{options.workers or available_cores()} processes"
    say(f"{campaign.name}: {options.runs} missions of {campaign.duration_s:g} s, {len(models)} models, on {where} ...")
    workers = cluster(options.dask) if options.dask else process_pool(options.workers)
    with workers as executor, _bar(options.runs * len(models), options.quiet) as progress:
        try:
            results = run_campaign(campaign, seeds, models, folder, executor, progress)
        except KeyboardInterrupt:
            kept = len(list((folder / "runs").rglob("*.npz")))
            console.complain(f"\nstopped; {kept} runs are kept in {folder}, the same command continues.")
            raise
    from navfilter.evaluation.montecarlo.campaign import table, write_tables

    names = write_tables(results, folder)
    if options.figures:
        from navfilter.evaluation.montecarlo.figures import write_figures

        names += write_figures(results, folder)
    say(f"\n{table(results)}\n\nWritten to {folder}{os.sep}: {', '.join(names)}")
    return 0


@contextmanager
def _bar(total: int, quiet: bool) -> Iterator[Any]:
    from tqdm import tqdm

    # Away from a terminal a line a minute is enough to see that it is alive.
    often = 0.2 if sys.stderr.isatty() else 60.0
    with tqdm(total=total, desc="runs", unit="", disable=quiet, mininterval=often, maxinterval=max(often, 10.0)) as bar:
        yield bar.update

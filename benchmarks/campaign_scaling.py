"""How campaigns scale: missions per second on one process, on several, and on a Dask cluster of this machine.

There is no other software to compare with: the rival is the same campaign on one process. Efficiency is its time over
the time of k processes times k; more processes than cores cannot have more than cores over k. Every way runs the same
seeds, and must give the same bits. Workers have been started, and have run a mission each, before the clock starts.
Beside it stands the efficiency by processor time, what a replay costs alone over what it costs beside others: that of
a machine which has other work to do.
"""

from __future__ import annotations

import os
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from harness import Options, Table, flag, main, quick

import navfilter as nf
from navfilter.evaluation.montecarlo.campaign import Campaign, run_campaign, run_seed
from navfilter.evaluation.montecarlo.workers import cluster, process_pool
from navfilter.playback.warm_up import available_cores

MODELS = ("white", "gm1")


@contextmanager
def simulated_cluster(workers: int) -> Iterator[Executor]:
    """A scheduler and single-threaded workers in processes of this machine, reached by its address."""
    from distributed import LocalCluster

    own = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    with own, cluster(own.scheduler_address) as executor:
        yield executor


def timed(campaign: Campaign, seeds: range, workers: int, executor: Executor) -> tuple[float, float, bytes]:
    """Seconds of a campaign, those of the processor in its replays, and its records, on workers that have run a mission
    already.
    """
    for future in [executor.submit(run_seed, campaign, 1000 + k, MODELS[:1]) for k in range(2 * workers)]:
        future.result()
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        run_campaign(campaign, seeds, MODELS, folder, executor)
        spent = time.perf_counter() - began
        kept = {str(path.relative_to(folder)): load(path) for path in sorted((Path(folder) / "runs").rglob("*.npz"))}
    return spent, sum(cpu_s for cpu_s, _ in kept.values()), pickle.dumps({k: bits for k, (_, bits) in kept.items()})


def load(path: Path) -> tuple[float, dict[str, bytes]]:
    """Processor seconds of a run; its bits, but for those and for the checksum, which covers them."""
    with np.load(path) as arrays:
        bits = {name: arrays[name].tobytes() for name in arrays.files if name not in ("cpu_s", "checksum")}
        return float(np.sum(arrays["cpu_s"])), bits


def campaign_scaling(options: Options) -> dict[str, Any]:
    """One process, several, a cluster."""
    campaign = Campaign("compass-gm2", duration_s=60.0 if options.quick else options.seconds, imu_rate_hz=20.0)
    seeds = range(1, 1 + (2 if options.quick else options.missions))
    nf.warm_up()
    record = run_seed(campaign, 1, MODELS)
    sent = len(pickle.dumps((run_seed, campaign, 1, MODELS)))
    print(f"a mission: {sent} bytes are sent, {len(pickle.dumps(record)) / 1e3:.1f} kB come back")
    ways: list[tuple[str, int, Callable[[int], Any]]] = [("processes", k, process_pool) for k in options.workers]
    if not options.quick and options.cluster:
        ways.append(("dask", options.cluster, simulated_cluster))
    table, first = Table("where<10 workers>7d missions_per_s>8.2f efficiency>8.2f by_cpu>8.2f start_s>8.1f"), None
    for where, workers, opened in ways:
        began = time.perf_counter()
        with opened(workers) as executor:
            executor.submit(os.getpid).result()
            start_s = time.perf_counter() - began
            seconds, cpu_s, kept = timed(campaign, seeds, workers, executor)
        first = first or (seconds * workers, cpu_s, kept)
        if kept != first[2]:
            raise SystemExit(f"{where} with {workers} workers gave other bits")
        rate, efficiency = len(seeds) / seconds, first[0] / (seconds * workers)
        figures = {"missions_per_s": rate, "efficiency": efficiency, "by_cpu": first[1] / cpu_s, "start_s": start_s}
        table.add({"where": where, "workers": workers, **figures})
    print(f"{available_cores()} cores; the results are the same, bit for bit")
    return {"rows": table.rows, "sent_bytes": sent, "returned_bytes": len(pickle.dumps(record))}


if __name__ == "__main__":
    flags = [
        flag("--missions", type=int, default=16),
        flag("--seconds", type=float, default=600.0, help="length of a mission (default: %(default)s)"),
        flag("--workers", type=int, nargs="+", default=[1, 2], help="numbers of processes (default: 1 2)"),
        flag("--cluster", type=int, default=4, help="processes of a Dask cluster; 0: none (default: %(default)s)"),
        quick("two missions of a minute, without the cluster"),
    ]
    main(__doc__, {campaign_scaling: flags})

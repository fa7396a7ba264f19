"""Order selection: time of the full surface, and what the choice costs in prediction against plain AIC, BIC and HQ.

python benchmarks/arma_order.py [--runs 60] [--quick] [--json PATH]

The cost is the exact excess one-step prediction variance times the record length W = 4000, so that the true order
fitted by maximum likelihood costs about its number of coefficients. Grid 0..4 x 0..4. "ARMA11 weak" mirrors the
GPS-like AR2: the two are nearly indistinguishable, and whatever favours one costs on the other.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

import navfilter as nf

W = 4000
MODELS = {
    "white": ([], []),
    "GPS-like AR2": (np.poly([0.972, -0.177])[1:], []),
    "GM1 .99 + white": ([-0.99], [-0.931]),
    "compass-like 4,2": (
        np.poly([0.97, 0.5, 0.9 * np.exp(0.8j), 0.9 * np.exp(-0.8j)]).real[1:],
        np.poly([0.85, -0.3])[1:],
    ),
    "ARMA11 weak": ([-0.972], [-0.178]),
}


def excess(ar: np.ndarray, ma: np.ndarray, fit: nf.ArmaFit) -> float:
    """Prediction variance of the fitted model on the true process over the least possible, minus one, times W."""
    a, c = np.convolve(np.r_[1.0, ar], np.r_[1.0, fit.ma]), np.convolve(np.r_[1.0, ma], np.r_[1.0, fit.ar])
    return W * (nf.ArmaModel(a[1:], c[1:], 1.0).variance - 1.0)


def choose(name: str, runs: int) -> dict[str, object]:
    """Mean cost and rate of the true order for each way of choosing."""
    ar, ma = (np.asarray(x, dtype=float) for x in MODELS[name])
    cost: dict[str, list[float]] = {}
    right: dict[str, list[bool]] = {}
    for seed in range(runs):
        y = nf.simulate_arma(ar, ma, 1.0, W, seed=seed)
        table = nf.select_order(y, 4, 4)
        picks = {"navfilter": table.best}
        for rule in ("aic", "bic", "hq"):
            where = np.unravel_index(np.argmin(getattr(table, rule)), table.aic.shape)
            picks[rule] = (int(where[0]), int(where[1]))
        picks["true order"] = (ar.size, ma.size)
        for rule, order in picks.items():
            cost.setdefault(rule, []).append(excess(ar, ma, table.fits[order]))
            right.setdefault(rule, []).append(order == (ar.size, ma.size))
    return {
        "model": name,
        "n_true": ar.size + ma.size,
        "runs": runs,
        "cost": {rule: float(np.mean(values)) for rule, values in cost.items()},
        "right": {rule: float(np.mean(values)) for rule, values in right.items()},
    }


def surface_time(n: int, threads: int) -> float:
    """Seconds for the 11 x 11 surface with all criteria."""
    y = nf.simulate_arma([-1.6, 0.64], [0.3], 1.0, n, seed=1)
    start = time.perf_counter()
    nf.select_order(y, 10, 10, threads=threads)
    return time.perf_counter() - start


def main() -> None:
    """Run both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--quick", action="store_true", help="8 runs per model")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    runs = 8 if options.quick else options.runs
    nf.select_order(nf.simulate_arma([-0.5], [], 1.0, 300, seed=0), 2, 2)
    times = {threads: min(surface_time(14_400, threads) for _ in range(3)) for threads in (1, 2)}
    print(f"11 x 11 surface, N = 14 400, all criteria: {times[1]:.2f} s on one thread, {times[2]:.2f} s on two")
    rows = []
    print(f"{'model':17} {'n':>2} | mean excess x W (rate of the true order)")
    for name in MODELS:
        row = choose(name, runs)
        rows.append(row)
        parts = [f"{rule} {row['cost'][rule]:6.2f} ({row['right'][rule]:.2f})" for rule in row["cost"]]
        print(f"{name:17} {row['n_true']:2d} | " + "  ".join(parts), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"surface_s": times, "choice": rows}, indent=1))


if __name__ == "__main__":
    main()

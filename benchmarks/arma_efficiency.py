"""Online ARMA estimates against exact maximum likelihood on the same windows, in units of the Cramer-Rao bound.

Each series has two windows of samples and is judged on the last one. The figure is the mean over series of
``W/n (V/sd^2 - 1)``, V being the one-step prediction variance of the estimated coefficients under the true model,
computed from the coefficients themselves: 1 is the bound.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from scipy.signal import lfilter

import navfilter as nf

# Poles and zeros of the ten models of the study that set the targets.
GM2 = np.exp(-0.05)
SHARP, BROAD = 0.98 * np.exp(0.6j), 0.9 * np.exp(1.5j)
MODELS: dict[str, tuple[list[complex], list[complex]]] = {
    "AR1 .8": ([0.8], []),
    "MA1 -.6": ([], [0.6]),
    "ARMA11 .8, -.6": ([0.8], [0.6]),
    "ARMA11 .8, +.6": ([0.8], [-0.6]),
    "GPS-like AR2": ([0.972, -0.177], []),
    "GM1 .99 + white": ([0.99], [0.931]),
    "GM2 beta dt .05": ([GM2, GM2], [-0.26795]),
    "compass-like 4,2": ([0.97, 0.5, 0.9 * np.exp(0.8j), 0.9 * np.exp(-0.8j)], [0.85, -0.3]),
    "band-pass 4,2": (
        [SHARP, SHARP.conjugate(), BROAD, BROAD.conjugate()],
        [0.6, -0.5],
    ),
    "non-SPR": ([], []),
}


def coefficients(name: str) -> tuple[np.ndarray, np.ndarray]:
    """AR and MA coefficients of a model of the list."""
    if name == "non-SPR":
        return np.array([0.9, 0.95]), np.array([1.5, 0.75])
    poles, zeros = MODELS[name]
    return np.atleast_1d(np.poly(poles)).real[1:], np.atleast_1d(np.poly(zeros)).real[1:]


def excess(ar: np.ndarray, ma: np.ndarray, true_ar: np.ndarray, true_ma: np.ndarray) -> float:
    """V/sd^2 - 1 of estimated coefficients: power of the response of (A^ C)/(C^ A) beyond its first term."""
    numerator = np.convolve(np.r_[1.0, ar], np.r_[1.0, true_ma])
    denominator = np.convolve(np.r_[1.0, ma], np.r_[1.0, true_ar])
    impulse = np.zeros(40_000)
    impulse[0] = 1.0
    response = lfilter(numerator, denominator, impulse)
    return float(response @ response) - 1.0


def run(window: int, count: int, mean: bool, els: bool) -> list[dict[str, float | str]]:
    """One row per model."""
    rows = []
    for at, name in enumerate(MODELS):
        ar, ma = coefficients(name)
        p, q = ar.size, ma.size
        scores: dict[str, list[float]] = {"online": [], "exact": [], "els": []}
        spent = {"online": 0.0, "exact": 0.0}
        failed = 0
        for seed in range(count):
            series = nf.simulate_arma(ar, ma, 1.0, 2 * window, seed=100_000 * (at + 1) + seed)
            start = time.perf_counter()
            online = nf.RecursiveArma(p, q, window, mean=mean)
            online.update_many(series)
            spent["online"] += time.perf_counter() - start
            start = time.perf_counter()
            exact = nf.fit_arma(series[window:], p, q, trend="constant" if mean else "none")
            spent["exact"] += time.perf_counter() - start
            failed += not (online.is_stable and np.all(np.isfinite(online.ar)) and np.all(np.isfinite(online.ma)))
            scores["online"].append(excess(online.ar, online.ma, ar, ma))
            scores["exact"].append(excess(exact.ar, exact.ma, ar, ma))
            if els:
                plain = nf.RecursiveArma(p, q, window, mean=mean, method="els")
                plain.update_many(series)
                scores["els"].append(excess(plain.ar, plain.ma, ar, ma))
        scale = window / (p + q)
        row: dict[str, float | str] = {"model": name, "failed": failed}
        for key in ("online", "exact", *(["els"] if els else [])):
            row[key] = scale * float(np.mean(scores[key]))
            row[key + "_sem"] = scale * float(np.std(scores[key])) / count**0.5
            row[key + "_worst"] = scale * float(np.max(scores[key]))
        row["ratio"] = float(row["online"]) / float(row["exact"])
        row["online_s"], row["exact_s"] = spent["online"] / count, spent["exact"] / count
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, nargs="*", default=[1000, 4000, 10_000])
    parser.add_argument("--series", type=int, nargs="*", default=[120, 120, 24], help="series per window length")
    parser.add_argument("--mean", action="store_true", help="carry a constant in both estimators")
    parser.add_argument("--no-els", action="store_true", help="leave out extended least squares")
    parser.add_argument("--quick", action="store_true", help="W = 1000 only, 10 series")
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    windows, series = ([1000], [10]) if options.quick else (options.windows, options.series)
    tables = {}
    for window, count in zip(windows, series, strict=True):
        rows = tables[str(window)] = run(window, count, options.mean, not options.no_els)
        print(f"\nW = {window}, {count} series: excess prediction variance / Cramer-Rao bound (worst in brackets)")
        print(f"{'model':18s} {'online':>20s} {'exact likelihood':>20s} {'ratio':>6s} {'ELS':>8s} {'failed':>7s}")
        for row in rows:
            els = f"{row['els']:8.2f}" if "els" in row else "       -"
            print(
                f"{row['model']:18s} {row['online']:8.2f} +-{row['online_sem']:4.2f} ({row['online_worst']:4.1f})"
                f" {row['exact']:8.2f} +-{row['exact_sem']:4.2f} ({row['exact_worst']:4.1f})"
                f" {row['ratio']:6.2f} {els} {row['failed']:7d}"
            )
        for key in ("online", "exact", "online_s", "exact_s"):
            print(f"mean {key}: {np.mean([float(row[key]) for row in rows]):.3f}")
    if options.json:
        with open(options.json, "w") as file:
            json.dump(tables, file, indent=1)


if __name__ == "__main__":
    main()

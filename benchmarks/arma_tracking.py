"""How an online ARMA estimate follows coefficients that change: a step, and a slow drift.

Averages over series. After a step the share of the change that is still missing is given at quarters of a window; in a
drift, the lag in windows. Beside RecursiveArma: extended least squares with the same forgetting, and a fit of the exact
likelihood repeated on every hop's window (what the online estimate stands for, at its price).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import navfilter as nf

WINDOW, HOP = 2000, 500
BEFORE, AFTER = ([-1.6, 0.8], [-0.5]), ([-1.0, 0.5], [0.3])


def varying(ar: np.ndarray, ma: np.ndarray, seed: int) -> np.ndarray:
    """Series of the difference equation with coefficients per sample, shapes (n, 2) and (n, 1)."""
    n = ar.shape[0]
    e = np.random.default_rng(seed).normal(size=n)
    y = np.zeros(n)
    for t in range(2, n):
        y[t] = e[t] - ar[t] @ y[t - 2 : t][::-1] + ma[t, 0] * e[t - 1]
    return y


def paths(n: int, drift: bool) -> np.ndarray:
    """True coefficients [a1, a2, c1] at every sample: constant for three windows, then step or drift."""
    first, last = np.r_[BEFORE[0], BEFORE[1]], np.r_[AFTER[0], AFTER[1]]
    start = 3 * WINDOW
    if drift:
        share = np.clip((np.arange(n) - start) / (n - start), 0.0, 1.0)
    else:
        share = (np.arange(n) >= start).astype(float)
    return first + share[:, None] * (last - first)


def follow(series: np.ndarray, every: int) -> dict[str, np.ndarray]:
    """Coefficients [a1, a2, c1] of the estimators at multiples of `every`."""
    online = nf.RecursiveArma(2, 1, WINDOW, hop=HOP, mean=False)
    els = nf.RecursiveArma(2, 1, WINDOW, hop=HOP, mean=False, method="els")
    tracks: dict[str, list[np.ndarray]] = {"online": [], "els": [], "refit": []}
    for end in range(every, series.size + 1, every):
        block = series[end - every : end]
        online.update_many(block)
        els.update_many(block)
        tracks["online"].append(np.r_[online.ar, online.ma])
        tracks["els"].append(np.r_[els.ar, els.ma])
        if end % HOP == 0 and end >= WINDOW:
            fit = nf.fit_arma(series[end - WINDOW : end], 2, 1, trend="none")
            last = np.r_[fit.ar, fit.ma]
        else:
            last = tracks["refit"][-1] if tracks["refit"] else np.full(3, np.nan)
        tracks["refit"].append(last)
    return {name: np.array(track) for name, track in tracks.items()}


def study(drift: bool, count: int, every: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Times, true coefficients there, and mean tracks over `count` series."""
    n = 3 * WINDOW + (12 if drift else 4) * WINDOW
    truth = paths(n, drift)
    total: dict[str, np.ndarray] = {}
    for seed in range(count):
        for name, track in follow(varying(truth[:, :2], truth[:, 2:], seed), every).items():
            total[name] = total.get(name, 0.0) + track / count
    ends = np.arange(every, n + 1, every)
    return ends, truth[ends - 1], total


def missing_share(ends: np.ndarray, tracks: np.ndarray) -> dict[str, float]:
    """Largest share of the step, over the coefficients, not yet followed at quarters of a window after it."""
    first, last = np.r_[BEFORE[0], BEFORE[1]], np.r_[AFTER[0], AFTER[1]]
    shares = {}
    for quarters in (1, 2, 3, 4, 5, 6, 8):
        at = int(np.searchsorted(ends, 3 * WINDOW + quarters * WINDOW // 4))
        shares[f"{quarters / 4:.2f}"] = float(np.max(np.abs((tracks[at] - last) / (first - last))))
    return shares


def drift_lag(ends: np.ndarray, truth: np.ndarray, tracks: np.ndarray) -> float:
    """Mean lag behind the drift in windows, from one and a half windows after its start."""
    inside = ends > 4.5 * WINDOW
    slope = (np.r_[AFTER[0], AFTER[1]] - np.r_[BEFORE[0], BEFORE[1]]) / (12.0 * WINDOW)
    return float(np.mean((truth[inside] - tracks[inside]) / slope) / WINDOW)


def draw(path: Path, results: dict[str, tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]) -> None:
    """Tracks of a1 and c1 against time in windows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(10, 5.5), sharex="col", constrained_layout=True)
    styles = {
        "online": ("RecursiveArma", "#0072b2", 1.6),
        "refit": ("exact likelihood, refitted every hop", "#333333", 1.0),
        "els": ("extended least squares", "#d55e00", 1.0),
    }
    for column, (title, (ends, truth, tracks)) in enumerate(results.items()):
        for row, (index, label) in enumerate(((0, "$a_1$"), (2, "$c_1$"))):
            axis = axes[row, column]
            time = ends / WINDOW
            axis.plot(time, truth[:, index], color="#999999", linewidth=3.0, label="true")
            for name, (text, colour, width) in styles.items():
                axis.plot(time, tracks[name][:, index], color=colour, linewidth=width, label=text)
            axis.set_ylabel(label)
            axis.grid(alpha=0.3)
            axis.set_xlim(2.0, time[-1])
            low, high = truth[:, index].min(), truth[:, index].max()
            axis.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))
            if row == 0:
                axis.set_title(title)
    for axis in axes[1]:
        axis.set_xlabel("time (windows)")
    axes[0, 0].legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--series", type=int, default=24)
    parser.add_argument("--figure", metavar="PNG", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    count, every = (4 if options.quick else options.series), 100
    step = study(False, count, every)
    drift = study(True, count, every)
    names = ("online", "refit", "els")
    shares = {name: missing_share(step[0], step[2][name]) for name in names}
    lags = {name: drift_lag(drift[0], drift[1], drift[2][name]) for name in names}
    print(f"window {WINDOW}, hop {HOP}, mean of {count} series, ARMA(2,1) {BEFORE} -> {AFTER}")
    print("share of a step still missing (worst coefficient), windows after it")
    print("  " + " " * 8 + "".join(f"{key:>8s}" for key in shares["online"]))
    for name in names:
        print(f"  {name:8s}" + "".join(f"{value:8.2f}" for value in shares[name].values()))
    print("lag behind a drift of 12 windows, in windows")
    for name in names:
        print(f"  {name:8s}{lags[name]:8.2f}")
    if options.figure:
        draw(options.figure, {"step": step, "drift": drift})
    if options.json:
        Path(options.json).write_text(json.dumps({"step": shares, "drift_lag": lags}, indent=1))


if __name__ == "__main__":
    main()

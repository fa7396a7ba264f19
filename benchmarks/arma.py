"""The ARMA estimators, alone: what they cost and how well they estimate.

speed       one online update against the same step in C, and against padasip, river and statsmodels
batch       exact likelihood fits against statsmodels' innovations_mle: time and log-likelihood on the same series
efficiency  online estimates against exact likelihood on the same windows, in units of the Cramer-Rao bound
tracking    a step and a drift of the coefficients, against extended least squares and refitting every window
order       the chosen order against plain AIC, BIC and HQ, and what the choice costs in prediction
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import arma_speed
import numpy as np
from arma_models import CHOSEN, EFFICIENCY, FITTED, coefficients, excess
from harness import Array, Options, Table, flag, in_turn, main, quick

import navfilter as nf

# --- batch -----------------------------------------------------------------------------------------------------------


def batch(options: Options) -> list[dict[str, Any]]:
    """Batch fits against statsmodels' innovations_mle: processor seconds and log-likelihood on the same series.

    statsmodels needs minutes for (10, 10); it is given one run per series, navfilter the median of five.
    """
    nf.fit_arma(nf.simulate_arma([-0.5], [0.2], 1.0, 500, seed=0), 2, 1, trend="none")
    columns = "order<8 n>7d navfilter_s>9.4f statsmodels_s>9.2f ratio>7.0f loglik_gain>9.5f failure<8"
    table = Table(columns)
    for n in (10_000,) if options.quick else (10_000, 100_000):
        for name in FITTED:
            table.add(fitted(name, n, with_statsmodels=not (options.quick and name == "(10,10)")))
    return table.rows


def fitted(name: str, n: int, with_statsmodels: bool) -> dict[str, Any]:
    """Both fits of one series, both estimates judged by statsmodels' likelihood."""
    from statsmodels.tsa.arima.estimators.innovations import innovations_mle
    from statsmodels.tsa.innovations.arma_innovations import arma_loglike

    ar, ma = FITTED[name]
    y = nf.simulate_arma(ar, ma, 1.0, n, seed=1)
    y -= y.mean()
    spent = in_turn({"navfilter": lambda: nf.fit_arma(y, ar.size, ma.size, trend="none")}, 5)
    fit = nf.fit_arma(y, ar.size, ma.size, trend="none")
    row = {"order": name, "n": n, "navfilter_s": float(np.median(spent["navfilter"]))}
    row["loglik"] = float(arma_loglike(y, -fit.ar, fit.ma.copy(), fit.sd**2))
    if not with_statsmodels:
        return row
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            other, _ = innovations_mle(y, order=(ar.size, 0, ma.size), demean=False)
        row["loglik_gain"] = row["loglik"] - float(arma_loglike(y, other.ar_params, other.ma_params, other.sigma2))
    except ValueError as error:  # its line search can leave the stationary region
        row["failure"] = str(error).split(".")[0]
    row["statsmodels_s"] = time.process_time() - began
    return row | {"ratio": row["statsmodels_s"] / row["navfilter_s"]}


# --- efficiency -----------------------------------------------------------------------------------------------------


def efficiency(options: Options) -> dict[str, Any]:
    """Online ARMA estimates against exact maximum likelihood on the same windows, in units of the Cramer-Rao bound.

    Each series has two windows of samples and is judged on the last one. The figure is the mean over series of
    ``W/n (V/sd^2 - 1)``, V being the one-step prediction variance of the estimated coefficients under the true model,
    computed from the coefficients themselves: 1 is the bound. "els" is extended least squares.
    """
    windows, series = ([1000], [10]) if options.quick else (options.windows, options.series)
    kinds = ("online", "exact") if options.no_els else ("online", "exact", "els")
    columns = "model<18 failed>6d ratio>6.2f"
    for kind in kinds:
        columns += f" {kind}>7.2f {kind}_sem>7.2f {kind}_worst>7.1f {kind}_s>7.3f"
    tables = {}
    for window, count in zip(windows, series, strict=True):
        print(f"\nW = {window}, {count} series: excess prediction variance / Cramer-Rao bound, and seconds per series")
        table = Table(columns)
        for at, name in enumerate(EFFICIENCY):
            table.add(
                {"model": name} | scored(name, window, range(100_000 * (at + 1), 100_000 * (at + 1) + count), options)
            )
        print(
            "mean: online {online:.3f}, exact {exact:.3f}; {online_s:.3f} and {exact_s:.3f} s".format(
                **means(table.rows)
            )
        )
        tables[str(window)] = table.rows
    return tables


def means(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Means over the models."""
    return {key: float(np.mean([row[key] for row in rows])) for key in ("online", "exact", "online_s", "exact_s")}


def scored(name: str, window: int, seeds: range, options: Options) -> dict[str, Any]:
    """Mean excess over the bound of every estimator on one model."""
    ar, ma = coefficients(*EFFICIENCY[name])
    (p, q), scale, mean = (ar.size, ma.size), window / (ar.size + ma.size), options.mean
    scores: dict[str, list[float]] = {}
    spent: dict[str, list[float]] = {}
    failed = 0
    for seed in seeds:
        y = nf.simulate_arma(ar, ma, 1.0, 2 * window, seed=seed)
        makers = {
            "online": lambda y=y: online(y, p, q, window, mean=mean),
            "exact": lambda y=y: nf.fit_arma(y[window:], p, q, trend="constant" if mean else "none"),
            "els": lambda y=y: online(y, p, q, window, mean=mean, method="els"),
        }
        for kind, make in makers.items():
            if kind == "els" and options.no_els:
                continue
            began = time.perf_counter()
            found = make()
            spent.setdefault(kind, []).append(time.perf_counter() - began)
            scores.setdefault(kind, []).append(scale * excess(found.ar, found.ma, ar, ma))
            if kind == "online":
                failed += not (found.is_stable and np.isfinite(np.r_[found.ar, found.ma]).all())
    row: dict[str, Any] = {"failed": failed, "ratio": float(np.mean(scores["online"]) / np.mean(scores["exact"]))}
    for kind, values in scores.items():
        row |= {kind: float(np.mean(values)), f"{kind}_sem": float(np.std(values)) / len(values) ** 0.5}
        row |= {f"{kind}_worst": max(values), f"{kind}_s": float(np.mean(spent[kind]))}
    return row


def online(y: Array, p: int, q: int, window: int, **settings: Any) -> nf.RecursiveArma:
    """The recursive estimator after a series."""
    arma = nf.RecursiveArma(p, q, window, **settings)
    arma.update_many(y)
    return arma


# --- order ----------------------------------------------------------------------------------------------------------

LENGTH = 4000


def order(options: Options) -> dict[str, Any]:
    """Order selection: time of the full surface, and what the choice costs in prediction against plain AIC, BIC and HQ.

    The cost is the exact excess one-step prediction variance times the record length 4000, so that the true order
    fitted by maximum likelihood costs about its number of coefficients; in "right" the rate of the true order. Grid
    0..4 x 0..4. "ARMA11 weak" mirrors the GPS-like AR2: the two are nearly indistinguishable, and whatever favours one
    costs on the other.
    """
    runs = 8 if options.quick else options.runs
    nf.select_order(nf.simulate_arma([-0.5], [], 1.0, 300, seed=0), 2, 2)
    y = nf.simulate_arma([-1.6, 0.64], [0.3], 1.0, 14_400, seed=1)
    surface = {f"{k} threads": lambda k=k: nf.select_order(y, 10, 10, threads=k) for k in (1, 2)}
    turns = in_turn(surface, 1 if options.quick else 3, time.perf_counter)
    spent = {name: float(times.min()) for name, times in turns.items()}
    print("11 x 11 surface, N = 14 400: " + ", ".join(f"{s:.2f} s on {name}" for name, s in spent.items()))
    rules = ("navfilter", "aic", "bic", "hq", "true_order")
    table = Table("model<16 n_true>6d " + " ".join(f"{rule}_cost>6.2f {rule}_right>6.2f" for rule in rules))
    for name in CHOSEN:
        table.add(choose(name, runs))
    return {"surface_s": spent, "choice": table.rows}


def choose(name: str, runs: int) -> dict[str, Any]:
    """Mean cost and rate of the true order for each way of choosing."""
    ar, ma = coefficients(*CHOSEN[name])
    found: dict[str, list[float]] = {}
    for seed in range(runs):
        table = nf.select_order(nf.simulate_arma(ar, ma, 1.0, LENGTH, seed=seed), 4, 4)
        picks = {"navfilter": table.best, "true_order": (ar.size, ma.size)}
        for rule in ("aic", "bic", "hq"):
            at = np.unravel_index(np.argmin(getattr(table, rule)), table.aic.shape)
            picks[rule] = (int(at[0]), int(at[1]))
        for rule, pick in picks.items():
            fit = table.fits[pick]
            found.setdefault(f"{rule}_cost", []).append(LENGTH * excess(fit.ar, fit.ma, ar, ma))
            found.setdefault(f"{rule}_right", []).append(pick == (ar.size, ma.size))
    return {"model": name, "n_true": ar.size + ma.size} | {key: float(np.mean(values)) for key, values in found.items()}


# --- tracking -------------------------------------------------------------------------------------------------------

WINDOW, HOP, EVERY, DRIFT = 2000, 500, 100, 12
#: a1, a2, c1 before and after.
BEFORE, AFTER = np.array([-1.6, 0.8, -0.5]), np.array([-1.0, 0.5, 0.3])
QUARTERS = (1, 2, 3, 4, 5, 6, 8)
FOLLOWERS = {
    "online": "RecursiveArma",
    "refit": "exact likelihood, refitted every hop",
    "els": "extended least squares",
}


def tracking(options: Options) -> dict[str, Any]:
    """How an online ARMA estimate follows coefficients that change: a step, and a slow drift. Means over series.

    After a step the share of the change that is still missing (worst coefficient) is given at quarters of a window; in
    a drift, the lag in windows. Beside RecursiveArma: extended least squares with the same forgetting, and a fit of the
    exact likelihood repeated on every hop's window (what the online estimate stands for, at its price).
    """
    count = 4 if options.quick else options.series
    studies = {"step": study(False, count), "drift": study(True, count)}
    ends, _, stepped = studies["step"]
    drifting, truth, drifted = studies["drift"]
    at = [int(np.searchsorted(ends, 3 * WINDOW + k * WINDOW // 4)) for k in QUARTERS]
    inside, slope = drifting > 4.5 * WINDOW, (AFTER - BEFORE) / (DRIFT * WINDOW)
    print(f"window {WINDOW}, hop {HOP}, {count} series; share of a step missing so many windows later; lag of a drift")
    keys = [f"{k / 4:.2f}" for k in QUARTERS]
    table = Table("estimator<10 " + " ".join(f"{key}>6.2f" for key in [*keys, "drift_lag"]))
    for name in FOLLOWERS:
        missing = np.max(np.abs((stepped[name][at] - AFTER) / (BEFORE - AFTER)), axis=1)
        lag = float(np.mean((truth[inside] - drifted[name][inside]) / slope) / WINDOW)
        table.add({"estimator": name, **dict(zip(keys, missing.tolist(), strict=True)), "drift_lag": lag})
    if options.figure:
        draw(options.figure, studies)
    return {"missing_after_step": table.rows}


def study(drift: bool, count: int) -> tuple[Array, Array, dict[str, Array]]:
    """Times, true coefficients there, and mean tracks over series whose coefficients are constant for three windows."""
    n = (3 + (DRIFT if drift else 4)) * WINDOW
    since = np.arange(n) - 3 * WINDOW
    share = np.clip(since / (n - 3 * WINDOW), 0.0, 1.0) if drift else (since >= 0).astype(float)
    truth = BEFORE + share[:, None] * (AFTER - BEFORE)
    tracks = [follow(varying(truth, seed)) for seed in range(count)]
    ends = np.arange(EVERY, n + 1, EVERY)
    return ends, truth[ends - 1], {name: np.mean([track[name] for track in tracks], axis=0) for name in FOLLOWERS}


def varying(theta: Array, seed: int) -> Array:
    """Series of the difference equation with coefficients [a1, a2, c1] per sample, shape (n, 3)."""
    e = np.random.default_rng(seed).normal(size=len(theta))
    y = np.zeros(len(theta))
    for t in range(2, len(theta)):
        y[t] = e[t] - theta[t, :2] @ y[t - 2 : t][::-1] + theta[t, 2] * e[t - 1]
    return y


def follow(y: Array) -> dict[str, Array]:
    """Coefficients [a1, a2, c1] of the estimators at every `EVERY` samples."""
    settings = {"hop": HOP, "mean": False}
    online = {
        "online": nf.RecursiveArma(2, 1, WINDOW, **settings),
        "els": nf.RecursiveArma(2, 1, WINDOW, method="els", **settings),
    }
    tracks: dict[str, list[Array]] = {name: [] for name in FOLLOWERS}
    refit = np.full(3, np.nan)
    for end in range(EVERY, y.size + 1, EVERY):
        for name, arma in online.items():
            arma.update_many(y[end - EVERY : end])
            tracks[name].append(np.r_[arma.ar, arma.ma])
        if end % HOP == 0 and end >= WINDOW:
            fit = nf.fit_arma(y[end - WINDOW : end], 2, 1, trend="none")
            refit = np.r_[fit.ar, fit.ma]
        tracks["refit"].append(refit)
    return {name: np.array(track) for name, track in tracks.items()}


def draw(path: Path, studies: dict[str, tuple[Array, Array, dict[str, Array]]]) -> None:
    """Tracks of a1 and c1 against time in windows."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col")
    for column, (title, (ends, truth, tracks)) in enumerate(studies.items()):
        axes[0, column].set_title(title)
        axes[1, column].set_xlabel("time (windows)")
        for row, (index, label) in enumerate(((0, "$a_1$"), (2, "$c_1$"))):
            axis = axes[row, column]
            axis.plot(ends / WINDOW, truth[:, index], color="#999999", linewidth=3.0, label="true")
            for (name, text), colour in zip(FOLLOWERS.items(), ("#0072b2", "#333333", "#d55e00"), strict=True):
                axis.plot(ends / WINDOW, tracks[name][:, index], color=colour, linewidth=1.2, label=text)
            low, high = truth[:, index].min(), truth[:, index].max()
            room = 0.15 * (high - low)
            axis.set(ylabel=label, xlim=(2.0, ends[-1] / WINDOW), ylim=(low - room, high + room))
            axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main(
        __doc__,
        {
            arma_speed.speed: [flag("--repeats", type=int, default=150), quick("10 repeats")],
            batch: [quick("N = 10 000 only, without (10,10) for statsmodels")],
            efficiency: [
                flag("--windows", type=int, nargs="*", default=[1000, 4000, 10_000]),
                flag("--series", type=int, nargs="*", default=[120, 120, 24], help="series per window length"),
                flag("--mean", action="store_true", help="carry a constant in both estimators"),
                flag("--no-els", action="store_true", help="leave out extended least squares"),
                quick("W = 1000 only, 10 series"),
            ],
            tracking: [
                flag("--series", type=int, default=24),
                flag("--figure", type=Path, metavar="PNG"),
                quick("4 series"),
            ],
            order: [flag("--runs", type=int, default=60, help="per model"), quick("8 runs per model")],
        },
    )

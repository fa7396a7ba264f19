"""Batch fit against statsmodels' innovations_mle: time ratio and log-likelihood on the same series.

python benchmarks/arma_batch_speed.py [--quick] [--json PATH]

CPU time, so that a busy machine does not distort the ratio. statsmodels needs minutes for (10, 10); it is given one run
per series, navfilter the median of five.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
from statsmodels.tsa.arima.estimators.innovations import innovations_mle
from statsmodels.tsa.innovations.arma_innovations import arma_loglike

import navfilter as nf


def ring(radii: list[float], angles: list[float]) -> np.ndarray:
    """Coefficients of conjugate pairs."""
    roots = [r * np.exp(s * 1j * w) for r, w in zip(radii, angles, strict=True) for s in (1, -1)]
    return np.poly(roots).real[1:]


MODELS = {
    "(2,1)": (np.array([-1.6, 0.64]), np.array([0.3])),
    "(4,4)": (ring([0.97, 0.8], [0.5, 1.7]), np.array([0.5, -0.3, 0.2, 0.1])),
    "(10,10)": (
        ring([0.95, 0.9, 0.9, 0.9, 0.85], [0.3, 0.8, 1.3, 1.8, 2.4]),
        ring([0.8, 0.7, 0.8, 0.6, 0.8], [0.55, 1.05, 1.55, 2.1, 2.8]),
    ),
}


def compare(name: str, n: int, with_competitor: bool) -> dict[str, float | str | None]:
    """Time both on one series and evaluate both estimates with statsmodels' likelihood."""
    ar, ma = MODELS[name]
    y = nf.simulate_arma(ar, ma, 1.0, n, seed=1)
    y -= y.mean()
    times = []
    for _ in range(5):
        start = time.process_time()
        fit = nf.fit_arma(y, ar.size, ma.size, trend="none")
        times.append(time.process_time() - start)
    ours = arma_loglike(y, -fit.ar, fit.ma.copy(), fit.sd**2)
    row = {"order": name, "n": n, "navfilter_s": float(np.median(times)), "loglik": float(ours)}
    row |= {"statsmodels_s": None, "ratio": None, "loglik_gain": None}
    if with_competitor:
        start = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                other, _ = innovations_mle(y, order=(ar.size, 0, ma.size), demean=False)
        except ValueError as error:  # its line search can leave the stationary region
            row |= {"statsmodels_s": time.process_time() - start, "failure": str(error).split(".")[0]}
        else:
            row["statsmodels_s"] = time.process_time() - start
            theirs = arma_loglike(y, other.ar_params, other.ma_params, other.sigma2)
            row["loglik_gain"] = float(ours - theirs)
        row["ratio"] = row["statsmodels_s"] / row["navfilter_s"]
    return row


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="N = 10 000 only, without (10,10) for statsmodels")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    nf.fit_arma(nf.simulate_arma([-0.5], [0.2], 1.0, 500, seed=0), 2, 1, trend="none")
    rows = []
    print(f"{'order':8} {'N':>7} {'navfilter':>11} {'statsmodels':>12} {'ratio':>7} {'loglik - theirs':>16}")
    for n in (10_000,) if options.quick else (10_000, 100_000):
        for name in MODELS:
            row = compare(name, n, not (options.quick and name == "(10,10)"))
            rows.append(row)
            theirs = "-" if row["statsmodels_s"] is None else f"{row['statsmodels_s']:.2f} s"
            ratio = "-" if row["ratio"] is None else f"{row['ratio']:.0f}"
            gain = row.get("failure") or ("-" if row["loglik_gain"] is None else f"{row['loglik_gain']:+.5f}")
            print(f"{name:8} {n:7d} {row['navfilter_s'] * 1e3:8.1f} ms {theirs:>12} {ratio:>7} {gain:>16}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

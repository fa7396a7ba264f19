"""Cost of the online ARMA update: against the same step in C, and against Python packages that people would use.

The C function (`arma_step.c`, beside this file) is compiled here with ``cc -O3 -march=native`` and works on the same
state table. The Python peers fit fewer things: padasip's recursive least squares, statsmodels' RecursiveLS and river's
SNARIMAX know no prediction-error gradient and no stability guard.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import navfilter as nf
from navfilter.kernels import arma as kernel

ORDERS = [(1, 1), (3, 3), (6, 6), (10, 10)]
POLES = [0.8, *(0.9 * np.exp(1j * np.array([0.5, 1.0, 1.5, 2.0, 2.5])))]


def series(p: int, n: int) -> np.ndarray:
    """An AR series of order p, so that the coefficients of the run keep moving as they do in use."""
    poles = np.array(POLES[1 : 1 + p // 2])
    poles = np.r_[poles, poles.conj(), [0.8] * (p % 2)]
    return nf.simulate_arma(np.poly(poles).real[1:], [0.3], 1.0, n, seed=p)


def compile_twin(folder: Path) -> ctypes.CDLL:
    """The C twin, compiled for this machine."""
    target = folder / "arma_step.so"
    source = Path(__file__).with_name("arma_step.c")
    subprocess.run(["cc", "-O3", "-march=native", "-shared", "-fPIC", str(source), "-o", str(target), "-lm"], check=True)
    library = ctypes.CDLL(str(target))
    pointer = ctypes.POINTER(ctypes.c_double)
    library.run.argtypes = [pointer, ctypes.c_int64, pointer, pointer, ctypes.c_int64]
    return library


def running_state(p: int, q: int, xs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State of an estimator that has been running, with room for xs before window work is due."""
    arma = nf.RecursiveArma(p, q, 4000, mean=False)
    arma.update_many(xs[:6000])
    state = arma.snapshot()["state"]
    state[kernel.HEAD, kernel.POS], state[kernel.HEAD, kernel.DUE] = 0.0, xs.size + 1.0
    return state, np.zeros((1, xs.size))


def best(call: Callable[[], None], prepare: Callable[[], None], repeats: int) -> float:
    """Shortest of several runs, in seconds: what the machine can do when nobody disturbs it."""
    times = []
    for _ in range(repeats):
        prepare()
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def against_c(library: ctypes.CDLL, repeats: int) -> list[dict[str, float]]:
    """Nanoseconds per sample of kernel and C twin, in alternation."""
    rows = []
    none = np.empty((6000, 0))
    for p, q in ORDERS:
        xs = series(p, 6000)
        state, buf = running_state(p, q, xs)
        ours, theirs = state.copy(), state.copy()
        pointer = ctypes.POINTER(ctypes.c_double)
        arguments = [a.ctypes.data_as(pointer) for a in (theirs, buf, xs)]

        def numba_run(ours=ours, buf=buf, xs=xs) -> None:
            kernel.rml_run(ours, buf, xs, none, 0)

        def c_run(arguments=arguments, width=state.shape[1], count=xs.size) -> None:
            library.run(arguments[0], width, arguments[1], arguments[2], count)

        spent = {"numba": np.inf, "c": np.inf}
        for _ in range(repeats):
            spent["numba"] = min(spent["numba"], best(numba_run, lambda o=ours, s=state: np.copyto(o, s), 1))
            spent["c"] = min(spent["c"], best(c_run, lambda o=theirs, s=state: np.copyto(o, s), 1))
        difference = float(np.max(np.abs(ours[kernel.THETA] - theirs[kernel.THETA])))
        rows.append(
            {
                "p": p,
                "q": q,
                "numba_ns": 1e9 * spent["numba"] / xs.size,
                "c_ns": 1e9 * spent["c"] / xs.size,
                "ratio": spent["numba"] / spent["c"],
                "theta_difference": difference,
            }
        )
    return rows


def one_at_a_time(repeats: int) -> list[dict[str, float]]:
    """Microseconds of update(x) from Python without window work, and of the window work spread over the samples."""
    rows = []
    for p, q in ORDERS:
        xs = series(p, 30_000)
        arma = nf.RecursiveArma(p, q, 8000, hop=8000, mean=False)
        arma.update_many(xs[:17_000])
        values = [float(x) for x in xs[17_000:18_000]]
        kept = arma.snapshot()

        def single(arma=arma, values=values) -> None:
            update = arma.update
            for x in values:
                update(x)

        update_s = best(single, lambda a=arma, k=kept: a.restore(k), repeats) / len(values)
        whole = nf.RecursiveArma(p, q, 4000, mean=False)
        whole.update_many(xs[:10_000])
        start_state = whole.snapshot()
        total = best(lambda w=whole, x=xs[10_000:]: w.update_many(x), lambda w=whole, k=start_state: w.restore(k), max(repeats // 3, 2))
        rows.append({"p": p, "q": q, "update_us": 1e6 * update_s, "with_polish_us": 1e6 * total / 20_000})
    return rows


def peers(repeats: int) -> list[dict[str, float | str]]:
    """Samples per second of Python packages and of the kernel at a comparable order."""
    import padasip
    from river.time_series import SNARIMAX
    from statsmodels.regression.recursive_ls import RecursiveLS

    rows: list[dict[str, float | str]] = []
    for p, q in [(3, 0), (2, 1), (10, 10)]:
        xs = series(max(p, 2), 6000)
        state, buf = running_state(p, q, xs)
        ours = state.copy()
        kernel_s = best(
            lambda o=ours, b=buf, x=xs: kernel.rml_run(o, b, x, np.empty((x.size, 0)), 0),
            lambda o=ours, s=state: np.copyto(o, s),
            repeats,
        )
        arma = nf.RecursiveArma(p, q, 4000, mean=False)
        arma.update_many(xs)
        kept = arma.snapshot()
        public_s = best(lambda a=arma, x=xs: a.update_many(x), lambda a=arma, k=kept: a.restore(k), max(repeats // 3, 2))
        # As many coefficients as the kernel has: lags of the series stand in for those of the innovation.
        lags = np.column_stack([np.roll(xs, k + 1) for k in range(p + q)])[p + q :]

        def rls(lags=lags, xs=xs, n=p + q) -> None:
            estimator = padasip.filters.FilterRLS(n=n, mu=0.999)
            for row, x in zip(lags[:2000], xs[n:], strict=False):
                estimator.adapt(x, row)

        def snarimax(xs=xs, p=p, q=q) -> None:
            model = SNARIMAX(p=p, d=0, q=q)
            for x in xs[:1000]:
                model.learn_one(float(x))

        def recursive_ls(lags=lags, xs=xs, n=p + q) -> None:
            RecursiveLS(xs[n:], lags).fit()

        for name, call, count in (
            ("padasip FilterRLS, p+q lags", rls, 2000),
            ("river SNARIMAX", snarimax, 1000),
            ("statsmodels RecursiveLS, p+q lags", recursive_ls, lags.shape[0]),
        ):
            peer = best(call, lambda: None, 2) / count
            rows.append(
                {
                    "order": f"({p},{q})",
                    "peer": name,
                    "peer_per_s": 1.0 / peer,
                    "kernel_per_s": xs.size / kernel_s,
                    "ratio": peer * xs.size / kernel_s,
                    "ratio_with_polish": peer * xs.size / public_s,
                }
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=150)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    repeats = 10 if options.quick else options.repeats
    with tempfile.TemporaryDirectory() as folder:
        c_rows = against_c(compile_twin(Path(folder)), repeats)
    print("one step of the kernel against the same step in C (cc -O3 -march=native), best of", repeats)
    for row in c_rows:
        print(
            f"  ({row['p']:2d},{row['q']:2d})  numba {row['numba_ns']:7.0f} ns   C {row['c_ns']:7.0f} ns"
            f"   ratio {row['ratio']:.2f}   largest difference of theta {row['theta_difference']:.1e}"
        )
    single = one_at_a_time(max(repeats // 4, 3))
    print("from Python")
    for row in single:
        print(
            f"  ({row['p']:2d},{row['q']:2d})  update(x) {row['update_us']:5.2f} us"
            f"   update_many with a polish every 1000 of 4000 samples {row['with_polish_us']:5.2f} us/sample"
        )
    others = peers(max(repeats // 4, 3))
    print("against Python packages (samples per second)")
    for row in others:
        print(
            f"  {row['order']:8s} {row['peer']:34s} {row['peer_per_s']:9.0f}   kernel {row['kernel_per_s']:9.0f}"
            f"   ratio {row['ratio']:6.0f}   with polish {row['ratio_with_polish']:6.0f}"
        )
    if options.json:
        Path(options.json).write_text(json.dumps({"c": c_rows, "python": single, "peers": others}, indent=1))


if __name__ == "__main__":
    main()

"""Cost of the online ARMA update, `arma.py speed`."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from harness import Array, Options, Table, in_turn, ratio

import navfilter as nf
from navfilter.kernels import recursive_arma as kernel

ORDERS = [(1, 1), (3, 3), (6, 6), (10, 10)]


def speed(options: Options) -> dict[str, Any]:
    """One online update against the same step in C, and against Python packages that people would use.

    The C function (`arma_step.c`, beside this file) is compiled here with ``cc -O3 -march=native`` and works on the
    same state table, turn by turn. The Python peers fit fewer things: padasip's recursive least squares, statsmodels'
    RecursiveLS and river's SNARIMAX know no prediction-error gradient and no stability guard. Those not installed are
    left out.
    """
    repeats = 10 if options.quick else options.repeats
    print("one step of the kernel against the same step in C, ns; medians of", repeats, "turns")
    c = Table("p>3d q>3d numba_ns>8.0f c_ns>8.0f ratio>6.2f theta_difference>9.1e")
    with tempfile.TemporaryDirectory() as folder:
        library = compile_twin(Path(folder))
        for p, q in ORDERS:
            c.add({"p": p, "q": q} | against_c(library, p, q, repeats))
    print("from Python: update(x), and update_many with a polish every 1000 of 4000 samples, us per sample")
    python = Table("p>3d q>3d update_us>8.2f with_polish_us>8.2f")
    for p, q in ORDERS:
        python.add({"p": p, "q": q} | from_python(p, q, max(repeats // 4, 3)))
    print("against Python packages, samples per second")
    others = Table("p>3d q>3d peer<34 peer_per_s>9.0f kernel_per_s>9.0f ratio>7.0f ratio_with_polish>7.0f")
    for p, q in [(3, 0), (2, 1), (10, 10)]:
        for row in against_python(p, q, max(repeats // 4, 3)):
            others.add({"p": p, "q": q} | row)
    return {"c": c.rows, "python": python.rows, "peers": others.rows}


def series(p: int, n: int) -> Array:
    """An AR series of order p, so that the coefficients of the run keep moving as they do in use."""
    poles = 0.9 * np.exp(1j * np.array([0.5, 1.0, 1.5, 2.0, 2.5]))[: p // 2]
    return nf.simulate_arma(np.poly([*poles, *poles.conj(), *[0.8] * (p % 2)]).real[1:], [0.3], 1.0, n, seed=p)


def compile_twin(folder: Path) -> ctypes.CDLL:
    """The C twin, compiled for this machine."""
    source, target = Path(__file__).with_name("arma_step.c"), folder / "arma_step.so"
    subprocess.run(
        ["cc", "-O3", "-march=native", "-shared", "-fPIC", str(source), "-o", str(target), "-lm"], check=True
    )
    library = ctypes.CDLL(str(target))
    pointer = ctypes.POINTER(ctypes.c_double)
    library.run.argtypes = [pointer, ctypes.c_int64, pointer, pointer, ctypes.c_int64]
    return library


def running(p: int, q: int, xs: Array, window: int = 4000) -> nf.RecursiveArma:
    """An estimator that has been running."""
    arma = nf.RecursiveArma(p, q, window, hop=window if window > 4000 else None, mean=False)
    arma.update_many(xs)
    return arma


def state_table(p: int, q: int, xs: Array) -> Array:
    """State table of a running estimator with room for xs before window work is due."""
    state = running(p, q, xs).window_fit.state
    state[kernel.HEAD, kernel.POS], state[kernel.HEAD, kernel.DUE] = 0.0, xs.size + 1.0
    return state


def best(call: Callable[[Any], object], prepare: Callable[[], Any], repeats: int) -> float:
    """Shortest of several runs, each with what was prepared for it, in seconds: what the machine can do when nobody
    disturbs it.
    """
    spent = []
    for _ in range(repeats):
        made = prepare()
        spent.append(float(in_turn({"": lambda made=made: call(made)}, 1, time.perf_counter)[""][0]))
    return min(spent)


def against_c(library: ctypes.CDLL, p: int, q: int, repeats: int) -> dict[str, float]:
    """Nanoseconds per sample of kernel and C twin, in alternation."""
    xs = series(p, 6000)
    state, buffer = state_table(p, q, xs), np.zeros((1, xs.size))
    ours, theirs = state.copy(), state.copy()
    pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in (theirs, buffer, xs)]
    calls = {
        "numba": lambda: kernel.rml_run(ours, buffer, xs, 0),
        "c": lambda: library.run(pointers[0], state.shape[1], pointers[1], pointers[2], xs.size),
    }
    turns = []
    for _ in range(repeats + 1):  # the first compiles, or loads what was compiled
        np.copyto(ours, state)
        np.copyto(theirs, state)
        turns.append(in_turn(calls, 1, time.perf_counter))
    numba, c = (np.concatenate([turn[name] for turn in turns[1:]]) for name in calls)
    return {
        "numba_ns": 1e9 * float(np.median(numba)) / xs.size,
        "c_ns": 1e9 * float(np.median(c)) / xs.size,
        "ratio": ratio(numba, c),
        "theta_difference": float(np.max(np.abs(ours[kernel.THETA] - theirs[kernel.THETA]))),
    }


def from_python(p: int, q: int, repeats: int) -> dict[str, float]:
    """Microseconds of update(x) from Python without window work, and of the window work spread over the samples."""
    xs = series(p, 30_000)
    alone, whole = running(p, q, xs[:17_000], window=8000), running(p, q, xs[:10_000])
    values = xs[17_000:18_000].tolist()
    update_s = best(lambda arma: [arma.update(x) for x in values], lambda: deepcopy(alone), repeats) / len(values)
    total_s = best(lambda arma: arma.update_many(xs[10_000:]), lambda: deepcopy(whole), max(repeats // 3, 2))
    return {"update_us": 1e6 * update_s, "with_polish_us": 1e6 * total_s / 20_000}


def against_python(p: int, q: int, repeats: int) -> list[dict[str, Any]]:
    """Samples per second of Python packages, and of the kernel, at a comparable order."""
    xs = series(max(p, 2), 6000)
    state, buffer = state_table(p, q, xs), np.zeros((1, xs.size))
    kernel_s = best(lambda ours: kernel.rml_run(ours, buffer, xs, 0), state.copy, repeats) / xs.size
    begun = running(p, q, xs)
    public_s = best(lambda arma: arma.update_many(xs), lambda: deepcopy(begun), max(repeats // 3, 2)) / xs.size
    rows = []
    for name, (call, count) in peers(xs, p, q).items():
        try:
            peer_s = best(lambda call: call(), lambda call=call: call, 2) / count
        except ModuleNotFoundError as error:
            print(f"{name} is left out: {error.name} is not installed (pip install -e '.[bench]')")
            continue
        row = {"peer": name, "peer_per_s": 1.0 / peer_s, "kernel_per_s": 1.0 / kernel_s}
        rows.append(row | {"ratio": peer_s / kernel_s, "ratio_with_polish": peer_s / public_s})
    return rows


def peers(xs: Array, p: int, q: int) -> dict[str, tuple[Callable[[], object], int]]:
    """What Python packages do with a series, and with how many of its samples."""
    # As many coefficients as the kernel has: lags of the series stand in for those of the innovation.
    n = p + q
    lags = np.column_stack([np.roll(xs, k + 1) for k in range(n)])[n:]

    def padasip_rls() -> None:
        import padasip

        estimator = padasip.filters.FilterRLS(n=n, mu=0.999)
        for row, x in zip(lags[:2000], xs[n:], strict=False):
            estimator.adapt(x, row)

    def snarimax() -> None:
        from river.time_series import SNARIMAX

        model = SNARIMAX(p=p, d=0, q=q)
        for x in xs[:1000].tolist():
            model.learn_one(x)

    def recursive_ls() -> None:
        from statsmodels.regression.recursive_ls import RecursiveLS

        RecursiveLS(xs[n:], lags).fit()

    return {
        "padasip FilterRLS, p+q lags": (padasip_rls, 2000),
        "river SNARIMAX": (snarimax, 1000),
        "statsmodels RecursiveLS, p+q lags": (recursive_ls, len(lags)),
    }

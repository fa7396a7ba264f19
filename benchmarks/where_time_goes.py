"""Where the time of a replay goes: kernel by kernel, what is left to Python, and the floor by arithmetic.

The standard hour, or a part of it, forward and smoothed, as it is and with a compass that is learnt. There is
no other software to compare with: the rival is the floor, the products and sums that the equations cost at least, at
the rate at which this machine multiplies matrices of 256 rows. Kernels called by other kernels are in their callers.
"""

from __future__ import annotations

import importlib
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
from harness import CPU, DEG, Options, Table, flag, hour, main, quick

import navfilter as nf

#: Those of `measurement` and `strapdown` choose the way that a replay takes, and stay as they are.
FILES = ("kalman", "batch", "open_loop_residual", "arma_likelihood", "arma_fit")


def timed_kernels() -> dict[str, list[float]]:
    """Calls and seconds of every public kernel from now on, by name; those that a class holds by itself, or that are
    reached by their address, left out.
    """
    spent: dict[str, list[float]] = defaultdict(lambda: [0, 0.0])

    def wrapped(name: str, kernel: Callable[..., Any]) -> Callable[..., Any]:
        row = spent[name]

        def run(*arguments: Any) -> Any:
            began = time.thread_time()
            result = kernel(*arguments)
            row[0] += 1
            row[1] += time.thread_time() - began
            return result

        return run

    for file in FILES:
        module = importlib.import_module(f"navfilter.kernels.{file}")
        for name, kernel in list(vars(module).items()):
            if hasattr(kernel, "py_func") and not name.startswith("_") and name != "correction":
                setattr(module, name, wrapped(f"{file}.{name}", kernel))
    return spent


def flop_rate() -> float:
    """Products and sums per second of a matrix product in this process."""
    A = np.random.default_rng(1).normal(size=(256, 256))
    best = min(_seconds(A) for _ in range(20))
    return float(2 * 256**3 / best)


def _seconds(A: np.ndarray) -> float:
    began = time.perf_counter()
    A @ A
    return time.perf_counter() - began


def floor(states: int, axes: dict[int, int], samples: int, rows: int) -> dict[str, float]:
    """Products and sums of the parts, at least: by the number of readings with so many axes.

    A sample multiplies the compound transition and its noise (15 columns each) by 9 rows with some 7 elements beyond
    the identity; a reading folds (two products of 15 rows) and corrects (Joseph's form, Bierman 1977); the smoother
    takes the same back, and two products of all states for a row.
    """
    n, m = states, 15
    fold = 2 * m * m * n + 2 * m**3
    forward = sum(count * (fold + 2 * a * n + 4 * a * n * n + 2 * a * a * n) for a, count in axes.items())
    smoother = sum(count * (fold + 2 * a * n * n + 4 * a * n * n) for a, count in axes.items()) + rows * 4 * n**3
    return {"samples": float(samples * 9 * 7 * 2 * 2 * m), "readings": float(forward), "smoother": float(smoother)}


def where_time_goes(options: Options) -> dict[str, Any]:
    """Kernels by their share, then the floor."""
    base, mission = hour(1.0 if options.quick else options.minutes)
    learnt = base.with_error(compass=nf.LearnedArma(prior=nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0)))
    for vehicle in (base, learnt):
        nf.replay(vehicle, mission.between(0.0, 50.0), smooth=True)
    nf.warm_up()
    spent, figures = timed_kernels(), {}
    for name, vehicle in (("as it is", base), ("compass learnt", learnt)):
        for row in spent.values():
            row[:] = [0, 0.0]
        began = CPU()
        track = nf.replay(vehicle, mission, smooth=True)
        total = CPU() - began
        print(f"\n{name}: {total:.2f} s")
        table = Table("part<28 calls>9d seconds>9.3f share>6.2f")
        for part, (calls, seconds) in sorted(spent.items(), key=lambda item: -item[1][1]):
            if seconds > 0.002 * total:
                table.add({"part": part, "calls": int(calls), "seconds": seconds, "share": seconds / total})
        left = total - sum(seconds for _, seconds in spent.values())
        table.add({"part": "Python, and what is left", "calls": None, "seconds": left, "share": left / total})
        figures[name] = {"total_s": total, "parts": table.rows}
    sensors = [(sensor.axes, len(mission.streams[key])) for key, sensor in base.sensors.items()]
    axes: dict[int, int] = defaultdict(int)
    for count_of, count in sensors:
        axes[count_of] += count
    states = 9 + len(track.forward.state_names)
    least = floor(states, axes, len(mission.streams["imu"]), len(track.time_s))
    rate = flop_rate()
    print(f"\nfloor at {rate / 1e9:.1f} billion products and sums a second, {states} states")
    below = Table("part<10 giga>7.3f seconds>8.3f")
    for part, flops in least.items():
        below.add({"part": part, "giga": flops / 1e9, "seconds": flops / rate})
    return figures | {"floor": below.rows, "rate": rate}


if __name__ == "__main__":
    main(__doc__, {where_time_goes: [flag("--minutes", type=float, default=60.0), quick("one minute")]})

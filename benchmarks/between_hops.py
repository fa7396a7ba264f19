"""What one recursive prediction-error step per sample would gain between two fits of the joint likelihood.

The learner fits drift, slow part and ARMA error to a window at each hop; between hops the model rests. A recursive
estimator would move it with every sample: the step of the recursive prediction-error method on the innovations form,
the gradient taken through the gain of the Kalman filter (Ljung 1979), with the information of the window behind it
and forgetting 1 - 2/window, as `RecursiveArma` has it.

Each series is followed by both from the same fits. Scored is the density of the samples of a hop given those before:
a step is made after the samples that it is scored on. "fitted" is the hindsight that no estimator can have: the
model that is fitted with the hop's own samples. The filter's states are those of the model in force all along, so
that the recursion has no transient of its own.

Printed: gain over the resting model in thousandths of a nat per sample, mean over the series and the standard error
of that mean; a model whose innovation sd is wrong by 10 % loses about 10 of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from harness import DEG, Array, Options, Table, flag, main, quick
from heading_toy import GYROS, RATE_HZ, noises, scaled

import navfilter as nf
from navfilter.learning.initial_values import grown_point, with_slow_parts
from navfilter.learning.likelihood import Likelihood, Point, maximise
from navfilter.learning.slow_prior import slow_prior
from navfilter.models.navigation_drift import Drift

WINDOW, HOP, HOPS = 4000, 2000, 4
#: Samples between two steps of the recursion: an eighth of a second's worth would cost eight times as much and moves
#: the coefficients by less than a hundredth of their sd between two steps.
EVERY = 25
PRIOR = nf.GaussMarkov(0.5 * DEG, 60.0)


@dataclass(frozen=True)
class Case:
    """A compass error that stays or changes."""

    name: str
    first: nf.ArmaModel
    last: nf.ArmaModel
    order: tuple[int, int]


def cases() -> Iterator[Case]:
    """Errors that stay, and errors that change steadily from one model into another over the series."""
    known = noises()
    for name, order in (("GM1, 30 s", (1, 0)), ("slow + oscillating (4,2)", (2, 1)), ("compass-like (4,2)", (4, 2))):
        yield Case(name, known[name], known[name], order)

    def swing(period_s: float, sd_deg: float) -> nf.ArmaModel:
        pole = 0.99 * np.exp(2j * math.pi / (period_s * RATE_HZ))
        return scaled([pole, pole.conjugate()], [0.3], sd_deg)

    yield Case("swing, 6 to 4 s in an hour", swing(6.0, 0.35), swing(4.0, 0.35), (2, 1))
    yield Case("swing, sd doubles in an hour", swing(6.0, 0.35), swing(6.0, 0.7), (2, 1))


def series(case: Case, seed: int) -> Array:
    """Compass minus gyro heading [rad]; coefficients and innovation sd change in a straight line over an hour."""
    random, gyro, n = np.random.default_rng(seed), GYROS["tactical"], WINDOW + HOPS * HOP
    share = np.arange(n) / (3600.0 * RATE_HZ)
    a, b = case.first, case.last
    ar = a.ar + share[:, None] * (b.ar - a.ar)
    ma = a.ma + share[:, None] * (b.ma - a.ma)
    sd = a.sd * (b.sd / a.sd) ** share
    y = np.zeros(n)
    warm = nf.simulate_arma(a.ar, a.ma, a.sd, n, random)
    y[: ar.shape[1]] = warm[: ar.shape[1]]
    e = sd * random.standard_normal(n)
    for t in range(ar.shape[1], n):
        y[t] = e[t] - ar[t] @ y[t - 1 - np.arange(ar.shape[1])] + ma[t] @ e[t - 1 - np.arange(ma.shape[1])]
    dt = gyro.period_s
    bias = gyro.start_sd[1] * random.standard_normal() + np.cumsum(gyro.density[1] * math.sqrt(dt) * e / sd)
    return y + np.cumsum(bias * dt + gyro.density[0] * math.sqrt(dt) * random.standard_normal(n))


def fitted(likelihood: Likelihood, order: tuple[int, int], before: Array | None) -> Point:
    """The joint fit of a window; from the last one where there is one, in the unit of the series."""
    p, q = order
    if before is None:
        return maximise(likelihood, with_slow_parts(likelihood, [grown_point(likelihood, p, q, 8).theta], p), p, 20, 1)
    return maximise(likelihood, [moved(before, likelihood.log_unit)], p, 8, 1)


def moved(theta: Array, by: float) -> Array:
    """A parameter vector in another unit of the series: both standard deviations move."""
    out = theta.copy()
    out[-3:-1] += by
    return out


def follow(y: Array, case: Case) -> tuple[float, float]:
    """Gain of the recursion and of hindsight over the resting model, nats per sample."""
    gyro = GYROS["tactical"]
    drift = Drift(gyro.density, gyro.period_s, (math.inf, gyro.start_sd[1]))
    prior = slow_prior(PRIOR, drift.period_s, WINDOW * drift.period_s)
    p, before = case.order[0], None
    gains = np.empty((HOPS, 2))
    for hop in range(HOPS):
        end = WINDOW + hop * HOP
        now = Likelihood(y[end - WINDOW : end], drift, 0.0, prior)
        later = Likelihood(y[end + HOP - WINDOW : end + HOP], drift, 0.0, prior)
        scored = Likelihood(y[end - WINDOW : end + HOP], drift, 0.0, prior)
        point = fitted(now, case.order, before)
        before = moved(point.theta, -now.log_unit)
        hindsight = moved(fitted(later, case.order, before).theta, -later.log_unit)
        start = moved(before, scored.log_unit)
        resting = part(scored, start, p, WINDOW, HOP)
        gains[hop] = (
            resting - recursive(scored, start, point.info, p),
            resting - part(scored, moved(hindsight, scored.log_unit), p, WINDOW, HOP),
        )
    return float(gains[:, 0].mean() / HOP), float(gains[:, 1].mean() / HOP)


def part(likelihood: Likelihood, theta: Array, p: int, first: int, count: int) -> float:
    """Minus the log-density of `count` samples from `first` on, given those before."""
    log_sd = theta[-2:-1] - likelihood.log_unit
    to_end = [
        float(likelihood.lines(theta[:-2], p, 1, theta[-1:], log_sd, begin)[0])
        for begin in (first, first + count)
        if begin < likelihood.y.size
    ]
    return to_end[0] - sum(to_end[1:])


def innovations(likelihood: Likelihood, theta: Array, p: int) -> Array:
    """In standard deviations."""
    return likelihood.standardised([theta], p, 1)[1][:, 0].copy()


def recursive(likelihood: Likelihood, theta: Array, info: Array, p: int) -> float:
    """Minus the log-density of the samples of the hop, the model stepping after every few of them."""
    fast, keep = theta.size - 2, (1.0 - 2.0 / WINDOW) ** EVERY
    steps = np.where(np.arange(fast) < fast - 1, 1e-6, 1e-4)
    # with forgetting 1 - 2/window the information behind an estimate is that of half a window
    info, total = 0.5 * info, 0.0
    for first in range(WINDOW, WINDOW + HOP, EVERY):
        block = slice(first, first + EVERY)
        here = part(likelihood, theta, p, first, EVERY)
        total += here
        z = innovations(likelihood, theta, p)[block]
        gradient, psi = np.zeros(theta.size), np.zeros((theta.size, EVERY))
        for i, step in enumerate(steps):
            gradient[i] = (part(likelihood, theta + step * np.eye(theta.size)[i], p, first, EVERY) - here) / step
            psi[i] = (innovations(likelihood, theta + step * np.eye(theta.size)[i], p)[block] - z) / step
        if not np.all(np.isfinite(gradient)):
            continue
        psi = np.nan_to_num(psi)
        info = keep * info + psi @ psi.T
        info[fast - 1, fast - 1] += EVERY
        move = np.linalg.solve(info[:fast, :fast] + 0.1 * np.eye(fast), gradient[:fast])
        theta = likelihood.confine([np.concatenate([theta[:fast] - move, theta[fast:]])], p, 1)[0]
    return total


def between_hops(options: Options) -> list[dict[str, Any]]:
    """Gains by case."""
    seeds = range(101, 104 if options.quick else 101 + options.seeds)
    table = Table("error<28 series>6d recursion>9.2f recursion_se>12.2f hindsight>9.2f hindsight_se>12.2f")
    for case in cases():
        gains = 1e3 * np.array([follow(series(case, seed), case) for seed in seeds])
        mean, error = gains.mean(axis=0), gains.std(axis=0, ddof=1) / math.sqrt(len(gains))
        row = {"error": case.name, "series": len(gains), "recursion": mean[0], "recursion_se": error[0]}
        table.add(row | {"hindsight": mean[1], "hindsight_se": error[1]})
    return table.rows


if __name__ == "__main__":
    main(__doc__, {between_hops: [flag("--seeds", type=int, default=10, help="series of each"), quick("three series")]})

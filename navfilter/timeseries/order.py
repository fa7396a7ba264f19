"""Choose the order of an ARMA model: one warm-started sweep over (p, q) with every criterion, and a choice."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.display import Value
from navfilter.timeseries.diagnostics import Whiteness, whiteness
from navfilter.timeseries.fit import ArmaFit, Problem, fitted
from navfilter.timeseries.likelihood import Objective, Point, minimise
from navfilter.timeseries.order_criterion import Choice


@dataclass(frozen=True, eq=False, repr=False)
class OrderTable(Value):
    """Criteria of every order, rows p = 0 ... max_p, columns q = 0 ... max_q.

    Attributes
    ----------
    loglik, aic, aicc, bic, hq : ndarray, shape (max_p+1, max_q+1)
        Exact log-likelihood (never falling along p or q) and criteria; smaller is better.
    sd : ndarray
        Innovation standard deviation.
    whiteness : ndarray
        The thesis's all-lag WT of the residuals; white noise scores 3.855.
    is_white : ndarray of bool
        Calibrated verdict on the residuals (Ljung-Box and cumulative periodogram, 1 %).
    best : tuple of int
        The chosen (p, q).
    fit : ArmaFit
        The fit at the chosen order.
    fits : dict
        All fits, by (p, q).
    """

    loglik: Array
    aic: Array
    aicc: Array
    bic: Array
    hq: Array
    sd: Array
    whiteness: Array
    is_white: Mask
    best: tuple[int, int]
    fit: ArmaFit
    fits: dict[tuple[int, int], ArmaFit]

    def _shown(self) -> tuple[str, dict[str, object]]:
        most = tuple(size - 1 for size in self.bic.shape)
        rows: dict[str, object] = {"tried": f"{len(self.fits)} orders up to {most}"}
        rows["white residuals"] = f"{int(self.is_white.sum())} of them"
        near = sorted(self.fits, key=lambda order: self.fits[order].bic)[:3]
        rows["least bic"] = ", ".join(f"{order} {self.fits[order].bic:.6g}" for order in near)
        return f"OrderTable, best {self.best}", rows | {name: self.fit._shown()[1][name] for name in ("ar", "ma", "sd")}


def select_order(
    series: ArrayLike,
    max_p: int = 5,
    max_q: int = 5,
    *,
    d: int = 0,
    trend: str = "constant",
    regressors: ArrayLike | None = None,
    threads: int = 2,
) -> OrderTable:
    """Fit every order up to (max_p, max_q) by exact likelihood and choose one.

    Each order starts from its two smaller neighbours padded with a zero, so that the likelihood of nested models never
    falls.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; NaN is a missing one.
    max_p, max_q : int
        Largest orders.
    d, trend, regressors
        As in `fit_arma`.
    threads : int
        Orders of equal p + q are fitted side by side (the kernels release the interpreter lock).

    Returns
    -------
    OrderTable
    """
    if threads < 1:
        raise ValueError(f"threads must be at least 1, found {threads}.")
    problem = Problem(series, max_p, max_q, "likelihood", d, trend, regressors)
    cells: dict[tuple[int, int], tuple[Objective, Point, bool]] = {}
    with ThreadPoolExecutor(threads) as pool:
        for total in range(max_p + max_q + 1):
            line = [(p, total - p) for p in range(max_p + 1) if 0 <= total - p <= max_q]
            line.sort(key=lambda order: -min(order))
            for order, cell in zip(line, pool.map(lambda order: _fit_cell(problem, cells, *order), line), strict=True):
                cells[order] = cell
        fits = dict(
            zip(cells, pool.map(lambda cell: fitted(problem, cell[1], cell[0], cell[2]), cells.values()), strict=True)
        )
        tests = dict(zip(fits, pool.map(_whiteness, fits.values()), strict=True))

    def table(value: dict[tuple[int, int], float]) -> Array:
        return np.array([[value[p, q] for q in range(max_q + 1)] for p in range(max_p + 1)])

    columns = {name: table({k: getattr(f, name) for k, f in fits.items()}) for name in _COLUMNS}
    is_white = table({k: float(t.is_white) for k, t in tests.items()}) > 0.5
    best = choose(fits, tests)
    return OrderTable(
        **columns,
        whiteness=table({k: t.wt for k, t in tests.items()}),
        is_white=is_white,
        best=best,
        fit=fits[best],
        fits=fits,
    )


def _whiteness(fit: ArmaFit) -> Whiteness:
    return whiteness(fit.residuals, fit.p + fit.q)


_COLUMNS = ("loglik", "aic", "aicc", "bic", "hq", "sd")


def _fit_cell(
    problem: Problem, cells: dict[tuple[int, int], tuple[Objective, Point, bool]], p: int, q: int
) -> tuple[Objective, Point, bool]:
    """Best point at (p, q): from padded neighbours and, where neither gains, from a fresh start."""
    objective = problem.objective(p, q)
    starts = []
    if p:
        smaller = cells[p - 1, q][1].theta
        starts.append(np.r_[smaller[: p - 1], 0.0, smaller[p - 1 :]])
    if q:
        starts.append(np.r_[cells[p, q - 1][1].theta, 0.0])
    if not starts:
        starts.append(np.zeros(0))
    if p + q <= 4:
        starts.extend(problem.starts(p, q))
    # A short race, then the leader alone: over-fitted orders have long flat valleys that are not worth following.
    leader, done = min((minimise(objective, s, limit=3, tolerance=1e-3) for s in starts), key=lambda run: run[0].value)
    if not done:
        leader, done = minimise(objective, leader.theta, limit=10, tolerance=1e-3)
    return objective, leader, done


#: A lead below 2 is "not worth more than a bare mention" (Kass and Raftery, 1995). The gate is tried on many orders, so
#: it is stricter here than for one series. Beyond a quarter of the circle's radius the first-order spread says nothing
#: about cancellation.
TABLE_CHOICE = Choice(lead=2.0, level=1e-3, farthest=0.25, nearest=False)


def choose(fits: dict[tuple[int, int], ArmaFit], tests: dict[tuple[int, int], Whiteness]) -> tuple[int, int]:
    """The chosen order among fitted ones.

    The smallest BIC among orders whose residuals pass the whiteness gate and none of whose pole-zero pairs cancels
    within two standard deviations. Of orders with as many coefficients and nearly the same BIC, the one with fewest
    moving-average coefficients: it forgets its start fastest and has no zeros to keep inside the circle.
    """
    candidates = {k: f for k, f in fits.items() if not cancels(f)} or fits
    white = {
        k: f
        for k, f in candidates.items()
        if min(tests[k].ljung_box_p, tests[k].periodogram_p) >= 0.5 * TABLE_CHOICE.level
    }
    candidates = white or candidates
    lead = min(candidates, key=lambda k: candidates[k].bic)
    close = [
        k for k, f in candidates.items() if sum(k) == sum(lead) and f.bic < candidates[lead].bic + TABLE_CHOICE.lead
    ]
    return min(close, key=lambda k: k[1])


def cancels(fit: ArmaFit) -> bool:
    """Whether some zero lies within two standard deviations of a pole, so that the pair is noise."""
    return TABLE_CHOICE.cancels(fit.ar, fit.ma, fit.covariance)

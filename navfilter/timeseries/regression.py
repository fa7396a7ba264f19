"""A series checked, standardised and ready to be fitted at several orders."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array
from navfilter.kernels import arma_fit as kernels
from navfilter.timeseries.initial_values import default_long_order, hannan_rissanen_start, long_residuals, tidy_series
from navfilter.timeseries.likelihood import GapFree, Objective, WithGaps
from navfilter.timeseries.roots import pull_inside

_DEGREE = {"none": -1, "constant": 0, "linear": 1}
# A long series is first fitted on this many samples, which costs little and leaves few steps for the whole.
PART = 10_000


class Problem:
    """A checked and standardised series, ready to be fitted at several orders.

    Parameters are those of `fit_arma`; `p` and `q` are the largest orders that will be asked for.
    """

    def __init__(
        self, series: ArrayLike, p: int, q: int, method: str, d: int, trend: str, regressors: ArrayLike | None
    ) -> None:
        for name, order in (("p", p), ("q", q), ("d", d)):
            if not isinstance(order, int | float | np.integer) or order != int(order) or order < 0:
                raise ValueError(f"{name} must be a whole number, at least 0, found {order!r}.")
        if method not in ("likelihood", "prediction-error"):
            raise ValueError(f'method must be "likelihood" or "prediction-error", found "{method}".')
        if trend not in _DEGREE:
            raise ValueError(f"trend must be one of {list(_DEGREE)}, found {trend!r}.")
        least = d + 3 * (p + q) + 8
        x = tidy_series(series, least, f"fit_arma with orders ({p}, {q})", gaps=True)
        self.method, self.d = method, d
        inputs = _inputs(x.size, _DEGREE[trend], d, regressors)
        x, self.scale = _standardised(np.diff(x, d) if d else x)
        self.shift = float(np.mean(x[np.isfinite(x)]))
        if _DEGREE[trend] >= 0 and d == 0:
            x -= self.shift
        elif abs(self.shift) > 1e6:
            raise ValueError(
                f'the mean is {self.shift:.1e} times the sd: fit it along with trend="constant", or use d=1.'
            )
        else:
            self.shift = 0.0
        self.y, self.known = x, np.isfinite(x)
        self.count = int(self.known.sum())
        self.gaps = self.count < x.size
        if self.count < least - d:
            raise ValueError(f"only {self.count} samples are left after {d} differences across the gaps. Lower d.")
        self.inputs = inputs
        sizes = np.sqrt(np.mean(inputs**2, axis=1)) if inputs.size else np.ones(len(inputs))
        if np.any(sizes == 0.0):
            raise ValueError("a regressor is zero, or vanishes when differenced. Leave it out.")
        self.regressors = np.ascontiguousarray(inputs / sizes[:, None])
        self.sizes = sizes
        self._long: dict[int, Array] = {}

    def objective(self, p: int, q: int, most: int | None = None) -> Objective:
        """The function to minimise at orders (p, q), of the first samples only when there are twice `most`."""
        n = self.y.size
        # A start that barely moves (a sensor switched on later) says nothing about the rest.
        if most is not None and not self.gaps and n >= 2 * most and np.std(self.y[:most]) > 0.1:
            n = most
        kind = WithGaps if self.gaps else GapFree
        inputs = np.ascontiguousarray(self.regressors[:, :n])
        return kind(self.y[:n], inputs, p, q, self.method == "prediction-error")

    def _filled(self) -> Array:
        x = self.y
        if self.gaps:
            where = np.arange(x.size)
            x = np.interp(where, where[self.known], x[self.known])
        if len(self.regressors):
            gram, right = np.empty((len(self.regressors) + 1,) * 2), np.empty_like(x)
            kernels.inner_products(np.vstack([self.regressors, x]), gram)
            beta = np.linalg.lstsq(gram[:-1, :-1], gram[:-1, -1], rcond=1e-12)[0]
            kernels.without_inputs(np.ascontiguousarray(x), self.regressors, beta, right)
            x = right
        return np.ascontiguousarray(x)

    def starts(self, p: int, q: int) -> list[Array]:
        """Start vectors for orders (p, q), the most promising first."""
        x = self._filled()[:PART]
        short = default_long_order(x.size, p, q)
        if short not in self._long:
            self._long[short] = long_residuals(x, short)
        first = hannan_rissanen_start(x, p, q, self._long[short])
        if not (p and q):
            return [first]
        second = np.r_[pull_inside(hannan_rissanen_start(x, p, 0, self._long[short])), np.zeros(q)]
        if -first[:p].sum() < 0.97:
            return [first, second]
        # Near a unit root the regression on levels is blind to everything else: try its difference too.
        change = np.diff(x)
        rest = hannan_rissanen_start(change, p - 1, q, long_residuals(change, short))
        return [first, second, np.r_[np.convolve(np.r_[1.0, rest[: p - 1]], [1.0, -0.999])[1:], rest[p - 1 :]]]


def _inputs(n: int, degree: int, d: int, regressors: ArrayLike | None) -> Array:
    """Trend columns and regressors as rows, differenced like the series; what differencing cancels is left out."""
    middle = np.arange(n, dtype=np.float64) - 0.5 * (n - 1)
    rows = [middle**power for power in range(degree + 1) if power >= d]
    if regressors is not None:
        extra = numbers(regressors, "regressors")
        extra = extra[:, None] if extra.ndim == 1 else extra
        if extra.ndim != 2 or extra.shape[0] != n:
            raise ValueError(f"regressors must have shape ({n},) or ({n}, k) like the series, found {extra.shape}.")
        if not np.all(np.isfinite(extra)):
            raise ValueError("regressors must be finite: interpolate their gaps first.")
        rows.extend(extra.T)
    table = np.array(rows).reshape(len(rows), n)
    return np.diff(table, d, axis=1) if d else table


def _standardised(x: Array) -> tuple[Array, float]:
    """Series over its sd, and that sd, safe for huge offsets and tiny scales."""
    known = x[np.isfinite(x)]
    if not known.size:
        raise ValueError("no difference of two known samples is left: the gaps are too dense.")
    spread = float(known.max() - known.min())
    if spread == 0.0:
        raise ValueError("the series is constant, it has no error to model.")
    if not np.isfinite(spread):
        raise ValueError("the range of the series overflows. Change its unit.")
    level = x / spread
    sd = float(np.std((x[np.isfinite(x)] - known[0]) / spread))
    return np.ascontiguousarray(level / sd), spread * sd

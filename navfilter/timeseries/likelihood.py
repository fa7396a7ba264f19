"""What the batch fit minimises: the exact Gaussian likelihood, or the sum of squared prediction errors.

With ``z+ = M z + g e``, ``y = z[0] + e`` and start ``z0 ~ N(0, sd^2 P0)`` the residuals are linear in z0:
``e = e0 - G z0``, where e0 starts from zero and the columns of G are delayed impulse responses of 1/C. Hence, exactly,
``-2 ln L = N ln(S/N) + ln det(I + P0 G'G) + const`` with ``S = min over z0 of |e0 - G z0|^2 + z0' P0^-1 z0``
(G. M. Ljung and G. E. P. Box, Biometrika 66, 1979). Nothing here is truncated and the zeros may lie near the circle.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import arma_fit as kernels
from navfilter.timeseries.roots import is_stable
from navfilter.timeseries.stationary import observer

# A zero of C on the circle itself would never forget its start; this radius keeps memory finite in floating point.
ZERO_RADIUS = 1.0 - 1e-7
POLE_RADIUS = 1.0 - 1e-10


def _none() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Point:
    """The objective at one parameter vector: half of -2 ln L without constants, and what the derivative needs."""

    theta: Array
    value: float
    power: float = math.nan
    beta: Array = field(default_factory=_none)
    state: Array = field(default_factory=_none)
    V: Array = field(default_factory=_none)
    gram: Array = field(default_factory=_none)
    P0: Array = field(default_factory=_none)
    w: Array = field(default_factory=_none)


def inside(theta: Array, p: int) -> bool:
    """Whether poles and zeros lie inside their radii, and all numbers are finite."""
    return bool(np.all(np.isfinite(theta)) and is_stable(theta[:p], POLE_RADIUS) and is_stable(theta[p:], ZERO_RADIUS))


def split(theta: Array, p: int, q: int) -> tuple[Array, Array]:
    """Coefficient vectors padded to the common state length."""
    r = max(p, q, 1)
    a, c = np.zeros(r), np.zeros(r)
    a[:p], c[:q] = theta[:p], theta[p:]
    return a, c


def _least_squares(A: Array, b: Array) -> Array:
    if not A.shape[1]:
        return np.zeros(0)
    return np.asarray(np.linalg.lstsq(A, b, rcond=1e-12)[0], dtype=np.float64)


class GapFree:
    """Objective for a series without missing samples.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Series.
    regressors : ndarray, shape (k, n)
        Known inputs whose coefficients are fitted along, linearly.
    p, q : int
        Orders.
    diffuse : bool
        True leaves the start free: plain sum of squared prediction errors, with filter memory. False is the likelihood.
    """

    def __init__(self, y: Array, regressors: Array, p: int, q: int, diffuse: bool) -> None:
        self.y, self.regressors, self.p, self.q, self.diffuse = y, regressors, p, q, diffuse
        self.r = max(p, q, 1)
        self.count = y.size
        self.rounds = max(math.ceil(math.log2(y.size)), 1)

    def _pure(self, beta: Array) -> Array:
        """The series without its fitted inputs."""
        out = np.empty_like(self.y)
        kernels.without_inputs(self.y, self.regressors, beta, out)
        return out

    def _filter(self, x: Array, a: Array, c: Array, z: Array | None = None) -> Array:
        e = np.empty_like(x)
        kernels.arma_filter(x, a, c, np.zeros(self.r) if z is None else z, e)
        return e

    def evaluate(self, theta: Array) -> Point:
        """Value at `theta`: infinite outside the stable, invertible region."""
        if not inside(theta, self.p):
            return Point(theta, math.inf)
        a, c = split(theta, self.p, self.q)
        r, n = self.r, self.count
        w = np.empty(n)
        w = w[: min(kernels.impulse_response(c, w) + r, n)]
        Gram = np.empty((r, r))
        kernels.shift_gram(w, w, 0, Gram)
        P0, V, logdet = self._start(a, c, Gram)
        if not math.isfinite(logdet):
            return Point(theta, math.inf)
        k = len(self.regressors)
        columns, B, gram = np.empty((k + 1, n)), np.empty((k + 1, r)), np.empty((k + 1, k + 1))
        for x, column, row in zip((*self.regressors, self.y), columns, B, strict=True):
            kernels.arma_filter(x, a, c, np.zeros(r), column)
            kernels.lag_products(w, column[: w.size], row)
        kernels.inner_products(columns, gram)
        gram -= B @ V @ B.T
        beta = _least_squares(gram[:k, :k], gram[:k, k])
        power = float(gram[k, k] - beta @ gram[:k, k])
        if not (power > 0.0 and math.isfinite(power)):
            return Point(theta, math.inf)
        value = 0.5 * (n * math.log(power / n) + logdet)
        return Point(theta, value, power, beta, V @ (B[k] - beta @ B[:k]), V, Gram, P0, w)

    def _start(self, a: Array, c: Array, Gram: Array) -> tuple[Array, Array, float]:
        """Stationary covariance P0 of the start, its posterior covariance V, and ln det(I + P0 Gram)."""
        P0 = np.zeros_like(Gram)
        if self.diffuse:
            return P0, np.asarray(np.linalg.inv(Gram), dtype=np.float64), 0.0
        M, g = observer(a, c)
        kernels.lyapunov(M, np.outer(g, g), 60, P0)
        if not np.all(np.isfinite(P0)):
            return P0, np.zeros_like(P0), math.inf
        growth = np.eye(self.r) + Gram @ P0
        sign, logdet = np.linalg.slogdet(growth)
        if sign <= 0.0 or not math.isfinite(logdet):
            return P0, P0, math.inf
        V = np.asarray(np.linalg.solve(growth.T, P0), dtype=np.float64)
        return P0, 0.5 * (V + V.T), float(logdet)

    def residuals(self, point: Point) -> Array:
        """Residuals from the best start, without the fitted regressors."""
        a, c = split(point.theta, self.p, self.q)
        return self._filter(self._pure(point.beta), a, c, point.state.copy())

    def linearise(self, point: Point) -> tuple[Array, Array]:
        """Gauss-Newton Hessian and exact gradient of the value."""
        p, q, r = self.p, self.q, self.r
        a, c = split(point.theta, p, q)
        e = self.residuals(point)
        zero, w = np.zeros(r), point.w
        x = self._filter(self._pure(point.beta), zero, c)
        v = self._filter(-e, zero, c)
        n = p + q
        H, XW, g = np.empty((n, n)), np.empty((n, r)), np.empty(n)
        for s, part, width in ((x, slice(0, p), p), (v, slice(p, n), q)):
            with_start, with_e, own = np.empty((width, r)), np.empty(width + 1), np.empty((width + 1, width + 1))
            kernels.shift_gram(s[: w.size], w, 1, with_start)
            kernels.lag_products(s, e, with_e)
            kernels.shift_gram(s, s, 0, own)
            XW[part], g[part], H[part, part] = with_start, with_e[1:], own[1:, 1:]
        cross = np.empty((p + 1, q + 1))
        kernels.shift_gram(x, v, 0, cross)
        H[:p, p:], H[p:, :p] = cross[1:, 1:], cross[1:, 1:].T
        power = point.power / self.count
        H = (H - XW @ point.V @ XW.T) / power
        g = g / power
        if not self.diffuse:
            start_e = np.empty(r)
            kernels.lag_products(w, e[: w.size], start_e)
            g += self._start_gradient(point, a, c, start_e / math.sqrt(power))
        return H, g

    def _start_gradient(self, point: Point, a: Array, c: Array, start_e: Array) -> Array:
        """Derivative through P0 and G'G, by one adjoint Lyapunov equation each."""
        M, g = observer(a, c)
        P0, Gram, V = point.P0, point.gram, point.V
        W = np.linalg.solve(np.eye(self.r) + Gram @ P0, Gram)
        Q = 0.25 * (W + W.T) - 0.5 * np.outer(start_e, start_e)
        adjoint = np.empty_like(Q)
        kernels.lyapunov(np.ascontiguousarray(M.T), Q, 60, adjoint)
        drive = 2.0 * adjoint @ g
        by_a = -2.0 * adjoint @ (M @ P0[:, 0]) - drive
        Mc = np.eye(self.r, k=1)
        Mc[:, 0] -= c
        spread = np.empty_like(Q)
        kernels.lyapunov(Mc, V, self.rounds, spread)
        by_c = drive - Gram @ (Mc @ spread[:, 0])
        return np.r_[by_a[: self.p], by_c[: self.q]]


class WithGaps:
    """Objective for a series with missing samples (NaN): Kalman innovations, derivatives by finite differences."""

    def __init__(self, y: Array, regressors: Array, p: int, q: int, diffuse: bool) -> None:
        self.p, self.q, self.diffuse = p, q, diffuse
        self.table = np.ascontiguousarray(np.vstack([y, regressors]).T)
        self.known = np.isfinite(y)
        self.count = int(self.known.sum())

    def _whiten(self, theta: Array) -> tuple[Array, float]:
        a, c = split(theta, self.p, self.q)
        M, g = observer(a, c)
        P0 = np.zeros_like(M)
        kernels.lyapunov(M, np.outer(g, g), 60, P0)
        W = np.empty_like(self.table)
        logdet = kernels.kalman_whiten(self.table, a, c, P0, W)
        return W, 0.0 if self.diffuse else logdet

    def evaluate(self, theta: Array) -> Point:
        """Value at `theta`: infinite outside the stable, invertible region."""
        if not inside(theta, self.p):
            return Point(theta, math.inf)
        W, logdet = self._whiten(theta)
        known = W[self.known]
        beta = _least_squares(known[:, 1:], known[:, 0])
        power = float(np.sum((known[:, 0] - known[:, 1:] @ beta) ** 2))
        if not (power > 0.0 and math.isfinite(power)):
            return Point(theta, math.inf)
        value = 0.5 * (self.count * math.log(power / self.count) + logdet)
        return Point(theta, value, power, beta)

    def residuals(self, point: Point) -> Array:
        """Standardised one-step prediction errors, NaN where the sample is missing."""
        W, _ = self._whiten(point.theta)
        return np.asarray(W[:, 0] - W[:, 1:] @ point.beta)

    def _scaled(self, theta: Array, beta: Array) -> Array:
        W, logdet = self._whiten(theta)
        W = W[self.known]
        return np.asarray((W[:, 0] - W[:, 1:] @ beta) * math.exp(0.5 * logdet / self.count))

    def linearise(self, point: Point) -> tuple[Array, Array]:
        """Gauss-Newton Hessian and gradient: the likelihood is a sum of squares of scaled innovations."""
        rows = []
        for j in range(point.theta.size):
            # A relative step at the cube root of machine precision balances truncation and rounding.
            h = 6e-6 * max(1.0, abs(point.theta[j]))
            up, down = point.theta.copy(), point.theta.copy()
            up[j] += h
            down[j] -= h
            if not inside(up, self.p):
                up[j] = point.theta[j]
            if not inside(down, self.p):
                down[j] = point.theta[j]
            step = max(up[j] - down[j], 1e-300)
            rows.append((self._scaled(up, point.beta) - self._scaled(down, point.beta)) / step)
        J, r = np.array(rows), self._scaled(point.theta, point.beta)
        power = float(r @ r) / self.count
        return J @ J.T / power, J @ r / power


#: What the minimiser can evaluate and linearise.
Objective = GapFree | WithGaps


def minimise(objective: Objective, start: Array, limit: int = 60, tolerance: float = 1e-6) -> tuple[Point, bool]:
    """Levenberg-Marquardt from `start`; returns the best point and whether the predicted gain fell below tolerance."""
    point = objective.evaluate(start)
    if not math.isfinite(point.value) or not start.size:
        return point, math.isfinite(point.value)
    damping = 1e-6
    for _ in range(limit):
        H, g = objective.linearise(point)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-150))
        H, g = H / np.outer(scale, scale), g / scale
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(g))):
            return point, False
        for _ in range(25):
            step = -np.linalg.lstsq(H + damping * np.eye(g.size), g, rcond=1e-15)[0]
            gain = -float(g @ step) - 0.5 * float(step @ H @ step)
            if gain < tolerance:
                return point, True
            trial = objective.evaluate(point.theta + step / scale)
            if trial.value < point.value - 1e-4 * gain:
                break
            damping = max(10.0 * damping, 1e-4)
        else:
            return point, False
        damping = damping * 0.1 if point.value - trial.value > 0.5 * gain else damping
        damping = max(damping, 1e-9)
        point = trial
    return point, False

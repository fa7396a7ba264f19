"""The window behind an online ARMA estimate: its start, its polish at each hop, and the samples it keeps."""

from __future__ import annotations

import math

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import recursive_arma as kernel
from navfilter.kernels import recursive_arma_window as window_kernel
from navfilter.timeseries.initial_values import hannan_rissanen_start, long_residuals

# Passes that polish a window: two usually suffice from a running estimate, a cold start may need many.
PASSES, COLD_PASSES = 15, 30


class WindowFit:
    """Samples of the last window and one hop, and the prediction-error fit of the window.

    Works on the state array of the estimator that owns it (`navfilter.kernels.recursive_arma`), which the sample kernel
    shares.

    Attributes
    ----------
    state, samples : ndarray
        Arrays ``s`` and ``buf`` of the kernels.
    carry : ndarray
        Filter memory before the oldest sample.
    residuals : ndarray
        Residuals of the last fit, working units, zero where a sample is missing.
    used : int
        Number of residuals that counted in the last fit.
    doubtful : int
        Hops in a row at which the fit did not settle or left colour.
    passes : int
        Most passes of a polish; 1 only filters the window and leaves the coefficients to the recursion.
    may_search : bool
        Whether other starts are tried when the fit is doubtful.
    """

    def __init__(self, p: int, q: int, m: int, window: int, hop: int) -> None:
        self.p, self.q, self.m, self.n = p, q, m, p + q + m
        self.window, self.hop = window, hop
        length = window + hop
        width = max(kernel.WIDTH, self.n)
        self.state = np.zeros((kernel.COV + self.n + m, width))
        self.samples = np.zeros((1 + m, length))
        self.carry = np.zeros((3 + m, width))
        self.residuals: Array = np.empty(0)
        self.used = 0
        self.doubtful = 0
        self.passes = PASSES
        self.may_search = True
        self._work = np.zeros((5 + m, max(p, q) + length))
        self._normal = np.zeros((self.n + 1, self.n + 1))

    @property
    def _pos(self) -> int:
        return int(self.state[kernel.HEAD, kernel.POS])

    def due(self, recursive_only: bool, clip: float, mean: bool) -> None:
        """What is to be done after the sample at which the kernel asked for window work."""
        head = self.state[kernel.HEAD]
        if head[kernel.RUNNING] == 0.0:
            self._start(recursive_only, clip, mean)
        elif not recursive_only:
            self._polish(mean)
        if self._pos >= self.samples.shape[1]:
            self._slide(filtered=head[kernel.RUNNING] == 1.0 and not recursive_only)
        head[kernel.DUE] = min(self.samples.shape[1], self._pos + self.hop, 2 * self._pos)

    def _slide(self, filtered: bool) -> None:
        """Drop the oldest hop; the filter memory at the new beginning comes from the last pass."""
        if filtered:
            window_kernel.memory_after(self.hop, self.p, self.q, self._work, self.carry)
        self.samples[:, : self.window] = self.samples[:, self.hop :]
        self.state[kernel.HEAD, kernel.POS] = self.window

    def _start(self, recursive_only: bool, clip: float, mean: bool) -> None:
        """Set origin and unit from the samples collected, and make the first estimate."""
        head = self.state[kernel.HEAD]
        x = self.samples[0, : self._pos]
        seen = x[np.isfinite(x)]
        if seen.size < max(self._pos // 2, 10) or not np.ptp(seen) > 0.0:
            return
        shift = float(np.median(seen)) if mean else 0.0
        top = float(np.max(np.abs(seen - shift)))
        # A power of two, so that scaling is exact; relative to the largest value, so that tiny units do not underflow.
        spread = top * max(float(np.sqrt(np.mean(((seen - shift) / top) ** 2))), 1e-6)
        unit = 2.0 ** -round(math.log2(spread))
        x -= shift
        x *= unit
        head[kernel.ORIGIN] += shift / head[kernel.UNIT]
        head[kernel.UNIT] *= unit
        head[kernel.RUNNING] = 1.0
        head[kernel.LAM] = 1.0 - 2.0 / self._pos
        self._cold_start(recursive_only, mean)
        for _ in range(3):
            if clip == 0.0 or not self._drop_outliers(clip):
                break
            self._cold_start(recursive_only, mean)

    def _drop_outliers(self, clip: float) -> bool:
        """Mark samples of the first block beyond the clipping limit as missing; sets the robust spread."""
        spread = max(1.4826 * float(np.median(np.abs(self.residuals))), 1e-9)
        self.state[kernel.HEAD, kernel.SPREAD] = spread
        far = np.flatnonzero(np.abs(self.residuals) > clip * spread)
        if far.size == 0 or far.size > self.residuals.size // 5:
            return False
        self.samples[0, self._pos - self.residuals.size + far] = np.nan
        return True

    def _cold_start(self, recursive_only: bool, mean: bool) -> None:
        starts = [np.zeros(self.n), *self._rough_starts(mean)]
        if recursive_only:
            self._fit(starts[-1], passes=1)
        else:
            self._best_of(starts)

    def _rough_starts(self, mean: bool) -> list[Array]:
        """Hannan-Rissanen starts with a short and a long autoregression."""
        k = self.p + self.q
        x = self.samples[0, : self._pos]
        level = float(np.nanmean(x)) if mean else 0.0
        x = np.where(np.isfinite(x), x - level, 0.0)
        starts: list[Array] = []
        for order in (max(12, 2 * k), max(40, 4 * k)) if k and np.any(x) else ():
            theta = np.zeros(self.n)
            theta[:k] = hannan_rissanen_start(x, self.p, self.q, long_residuals(x, min(order, self._pos // 5)))
            if mean:
                theta[k] = level * (1.0 + theta[: self.p].sum())
            starts.append(theta)
        return starts

    def _fit(self, theta: Array, passes: int) -> tuple[float, bool]:
        """Polish `theta` in place and make it the running estimate; returns the mean square and whether it settled."""
        head, pos = self.state[kernel.HEAD], self._pos
        # A young record leaves out the start of its filters; later they carry memory from before the window.
        lo = max(pos - self.window, min(pos // 8, self.hop))
        limits = np.array([head[kernel.RADIUS_A], head[kernel.RADIUS_C], passes])
        used, settled = window_kernel.polish(
            theta, self.p, self.samples, (lo, pos), self.carry, self._work, self._normal, limits
        )
        r = max(self.p, self.q)
        self.used = used
        self.residuals = self._work[4, r + lo : r + pos]
        self._adopt(theta)
        return float(self._normal[self.n, self.n]) / max(used, 1), bool(settled)

    def _adopt(self, theta: Array) -> None:
        """Make a polished theta the running estimate, with the filter memory and the P that belong to it."""
        s, n, k = self.state, self.n, self.p + self.q
        memory = np.zeros_like(self.carry)
        window_kernel.memory_after(self._pos, self.p, self.q, self._work, memory)
        s[kernel.THETA, :n] = theta
        s[kernel.PHI, :k] = memory[0, :k]
        s[kernel.PSI, :k] = memory[1, :k]
        s[kernel.MORE, : memory.shape[1]] = memory[2]
        s[kernel.COV + n : kernel.COV + n + self.m, : memory.shape[1]] = memory[3:]
        if self.used:
            s[kernel.HEAD, kernel.VAR] = self._normal[n, n] / self.used
        limit = s[kernel.HEAD, kernel.CLIP] * s[kernel.HEAD, kernel.SPREAD]
        if limit > 0.0:
            # Limited innovations say that something was not noise, not how large the noise is.
            whole = self.residuals[(np.abs(self.residuals) < 0.99 * limit) & (self.residuals != 0.0)]
            s[kernel.HEAD, kernel.VAR] = float(np.mean(whole**2)) if whole.size else s[kernel.HEAD, kernel.VAR]
        inverse = np.zeros((n, n))
        known = window_kernel.window_covariance(self._normal, n, inverse)
        # A silent window says nothing about the coefficients: what was known of them stays.
        if known and np.all(np.diag(inverse) < 1e12):
            s[kernel.COV : kernel.COV + n, :n] = inverse

    def _best_of(self, starts: list[Array]) -> None:
        costs = [self._fit(theta, COLD_PASSES)[0] for theta in starts]
        best = int(np.argmin(costs))
        if best != len(starts) - 1:
            self._fit(starts[best], COLD_PASSES)

    def _polish(self, mean: bool) -> None:
        """Polish from the running estimate; when the result is doubtful, try other starts as well, ever more rarely."""
        theta = self.state[kernel.THETA, : self.n].copy()
        _, settled = self._fit(theta, self.passes)
        if not self.may_search or (settled and not _coloured(self.residuals)):
            self.doubtful = 0
            return
        self.doubtful += 1
        if self.doubtful & (self.doubtful - 1) == 0:
            self._best_of([*self._rough_starts(mean), theta])


def _coloured(residuals: Array, lags: int = 20) -> bool:
    """Quick portmanteau at about 4 sigma: reason enough to look for a better optimum."""
    n = residuals.size
    power = float(residuals @ residuals)
    if n < 3 * lags or not power > 0.0:
        return False
    r = np.array([residuals[k:] @ residuals[:-k] for k in range(1, lags + 1)]) / power
    return bool(n * float(r @ r) > lags + 4.0 * math.sqrt(2.0 * lags))

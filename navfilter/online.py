"""Online ARMA identification: feed samples one at a time, read coefficients as good as a fit of the last window."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from navfilter.arma import ArmaModel, is_stable, log_s0_sd
from navfilter.kernels import arma as kernel

__all__ = ["RecursiveArma"]

Array = NDArray[np.float64]

# Passes that polish a window: two usually suffice from a running estimate, a cold start may need many.
PASSES, COLD_PASSES = 15, 60


class RecursiveArma:
    """Coefficients of an ARMA(p, q) model, followed sample by sample over a sliding window.

    Between hops each sample makes one step of the recursive prediction-error method (regressor filtered by 1/C,
    residual after the step; Soderstrom 1973, Ljung 1977), with forgetting 1 - 2/window. At each hop the estimate is
    polished by guarded Gauss-Newton passes over exactly the last `window` samples, the filters being started from
    memory that predates the window: it then equals the prediction-error fit of that window, whatever happened before.
    Poles and zeros are kept inside the unit circle by a Schur-Cohn test at every step.

    Parameters
    ----------
    p, q : int
        Orders of ``A(q) y = C(q) e``, in the sign of ``scipy.signal.lfilter([1, *ma], [1, *ar], e)``.
    window : int
        Number of samples behind an estimate; at least ``max(30, 30 (p + q))``.
    hop : int, optional
        Samples between two polishes, default a quarter of the window.
    mean : bool
        Carry a constant beside the coefficients (default), or take the series as having none.
    exog : int
        Number of external regressors (for example temperature) passed with every sample.
    method : {"rml", "els"}
        "els" is extended least squares (pseudo-linear regression, as in Ah-Chong 2003): no 1/C filter and no polish.
        It is there for comparison. It converges only if 1/C - 1/2 is strictly positive real, ``|C(e^jw) - 1| < 1`` at
        all frequencies: true for one zero, false for most measured sensor models, and then no amount of data helps.
    clip : float
        Limit innovations to `clip` robust standard deviations (0 = never, 4 is usual for impulsive noise); the
        limited value is what is remembered.

    Raises
    ------
    ValueError
        For orders, window, hop or method outside these bounds.

    Notes
    -----
    NaN and infinite samples advance time: the value is replaced by its expectation, and the max(p, q) samples after
    it are not learnt from. The first max(200, 30 (p + q)) samples (or the window, if shorter) are only collected;
    until then the coefficients are zero and `model` carries the flag "starting".

    Examples
    --------
    >>> import numpy as np, navfilter as nf
    >>> arma = nf.RecursiveArma(p=1, q=1, window=4000)
    >>> arma.update_many(nf.simulate_arma([-0.8], [0.3], 1.0, 5000, seed=1))
    >>> bool(abs(arma.ar[0] + 0.8) < 0.05), arma.is_stable
    (True, True)
    """

    def __init__(
        self,
        p: int,
        q: int,
        window: int,
        *,
        hop: int | None = None,
        mean: bool = True,
        exog: int = 0,
        method: str = "rml",
        clip: float = 0.0,
    ) -> None:
        self.p, self.q = _order(p, "p"), _order(q, "q")
        self.n_exog = _order(exog, "exog")
        least = max(30, 30 * (self.p + self.q))
        self.window = int(window)
        if self.window != window or self.window < least:
            raise ValueError(
                f"window must be an integer of at least {least} samples for orders ({self.p}, {self.q}), found {window}. "
                "Use a longer window or lower orders."
            )
        self.hop = max(1, self.window // 4) if hop is None else int(hop)
        if not 1 <= self.hop <= self.window:
            raise ValueError(f"hop must lie between 1 and the window ({self.window}), found {hop}.")
        if method not in ("rml", "els"):
            raise ValueError(f'method must be "rml" or "els", found {method!r}.')
        if not (clip >= 0.0 and math.isfinite(clip)):
            raise ValueError(f"clip must be finite and not negative, found {clip}.")
        self.method = method
        self.mean = bool(mean)
        self.clip = float(clip)
        self._m = int(self.mean) + self.n_exog
        self._n = self.p + self.q + self._m
        r = max(self.p, self.q)
        # One hop more than the window, and room for the memory: the passes burn in on the samples before the window.
        length = self.window + self.hop
        width = max(kernel.WIDTH, self._n)
        self._s = np.zeros((kernel.COV + self._n + self._m, width))
        self._buf = np.zeros((1 + self._m, length))
        self._carry = np.zeros((3 + self._m, width))
        self._work = np.zeros((5 + self._m, r + length))
        self._normal = np.zeros((self._n + 1, self._n + 1))
        self._used = 0
        self._residuals = np.empty(0)
        self._doubtful = 0
        self._white: bool | None = None
        self._unit_free_exog = np.zeros(self.n_exog)
        self._exog_set = False
        self._write_header()

    def _write_header(self) -> None:
        head = self._s[kernel.HEAD]
        head[[kernel.AR, kernel.MA, kernel.EXOG]] = self.p, self.q, self._m
        head[kernel.ELS] = float(self.method == "els")
        head[kernel.LAM_END] = 1.0 - 2.0 / self.window
        head[kernel.LAM_RATE] = 0.995
        head[kernel.RADIUS_A] = 1.0 - 0.05 / self.window
        head[kernel.RADIUS_C] = max(0.9995, 1.0 - 1.0 / self.window)
        head[kernel.CAP] = float(max(self._n, 1))
        head[kernel.CLIP] = self.clip
        head[kernel.UNIT] = 1.0
        head[kernel.CENTRE] = float(self.mean)
        head[kernel.LAST] = np.nan
        head[kernel.DUE] = min(self.window, max(200, 30 * (self.p + self.q)))
        if self.mean:
            self._s[kernel.PHI, self.p + self.q] = 1.0

    # ------------------------------------------------------------------ samples in

    def update(self, x: float, exog: ArrayLike | None = None) -> None:
        """Take one sample (NaN if it is missing) and, if the estimator has any, its external regressors."""
        if self.n_exog:
            self._s[kernel.PHI, self.p + self.q + int(self.mean) : self._n] = self._check_exog(exog, 1)[0]
        if kernel.rml_step(self._s, self._buf, float(x)):
            self._at_hop()

    def update_many(self, series: ArrayLike, exog: ArrayLike | None = None) -> None:
        """Take samples in order: the same arithmetic as `update` on each, to the last bit.

        Parameters
        ----------
        series : array_like, shape (N,)
            Samples, NaN where missing.
        exog : array_like, shape (N, exog), optional
            External regressors of each sample.
        """
        xs = np.ascontiguousarray(series, dtype=np.float64)
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one estimator per channel.")
        us = self._check_exog(exog, xs.size)
        done = 0
        while done < xs.size:
            done = kernel.rml_run(self._s, self._buf, xs, us, done)
            if self._s[kernel.HEAD, kernel.POS] >= self._s[kernel.HEAD, kernel.DUE]:
                self._at_hop()

    def _check_exog(self, exog: ArrayLike | None, count: int) -> Array:
        if self.n_exog == 0 and exog is None:
            return np.empty((count, 0))
        us = np.array(exog, dtype=np.float64, ndmin=1).reshape(count, -1) if exog is not None else np.empty((count, 0))
        if us.shape[1] != self.n_exog or not np.all(np.isfinite(us)):
            raise ValueError(
                f"exog must be finite with {self.n_exog} value(s) per sample, found shape {np.shape(exog)}. "
                "Fill gaps of the regressors before the estimator."
            )
        if count and not self._exog_set:
            # Taken relative to the first values when a constant absorbs the difference: it keeps the two apart.
            self._unit_free_exog = us[0].copy() if self.mean else np.zeros(self.n_exog)
            self._exog_set = True
        return np.ascontiguousarray(us - self._unit_free_exog)

    # ------------------------------------------------------------------ window work

    def _at_hop(self) -> None:
        head = self._s[kernel.HEAD]
        if head[kernel.RUNNING] == 0.0:
            self._start()
        elif self.method == "rml":
            self._polish()
        self._white = None
        length = self._buf.shape[1]
        if head[kernel.POS] >= length:
            if head[kernel.RUNNING] == 0.0 or self.method == "els":
                self._work[:] = 0.0
            kernel.slide(self._s, self._buf, self._carry, self._work, self.hop)
        pos = int(head[kernel.POS])
        head[kernel.DUE] = min(length, pos + self.hop, 2 * pos)

    def _first_counted(self) -> int:
        """Index in the buffer where the window begins; a young record leaves out the start of its filters."""
        pos = int(self._s[kernel.HEAD, kernel.POS])
        return max(pos - self.window, min(pos // 8, self.hop))

    def _start(self) -> None:
        """Set origin and unit from the samples collected, and the first estimate by several starts."""
        head = self._s[kernel.HEAD]
        pos = int(head[kernel.POS])
        x = self._buf[0, :pos]
        seen = x[np.isfinite(x)]
        if seen.size < max(pos // 2, 10) or not np.ptp(seen) > 0.0:
            return
        shift = float(np.median(seen)) if self.mean else 0.0
        spread = float(np.std(seen - shift)) if self.mean else float(np.sqrt(np.mean((seen / np.ptp(seen)) ** 2)) * np.ptp(seen))
        if not (spread > 0.0 and math.isfinite(spread)):
            spread = float(np.ptp(seen))
        unit = 2.0 ** -round(math.log2(spread))
        head[kernel.ORIGIN] += shift / head[kernel.UNIT]
        head[kernel.UNIT] *= unit
        x -= shift
        x *= unit
        head[kernel.RUNNING] = 1.0
        head[kernel.LAM] = 1.0 - 2.0 / pos
        self._cold_start()
        if self.clip > 0.0:
            for _ in range(3):
                if not self._drop_outliers():
                    break
                self._cold_start()

    def _drop_outliers(self) -> bool:
        """Mark samples of the first block beyond the clipping limit as missing; sets the robust spread."""
        residuals = self._residuals
        spread = 1.4826 * float(np.median(np.abs(residuals)))
        self._s[kernel.HEAD, kernel.SPREAD] = max(spread, 1e-9)
        far = np.flatnonzero(np.abs(residuals) > self.clip * spread)
        if far.size == 0 or far.size > residuals.size // 5:
            return False
        pos = int(self._s[kernel.HEAD, kernel.POS])
        self._buf[0, pos - residuals.size + far] = np.nan
        return True

    def _cold_start(self) -> None:
        starts = [np.zeros(self._n), *self._rough_starts()]
        if self.method == "els":
            self._run(starts[-1], passes=1)
        else:
            self._best_of(starts)

    def _rough_starts(self) -> list[Array]:
        """Hannan-Rissanen starts with a short and a long autoregression."""
        pos = int(self._s[kernel.HEAD, kernel.POS])
        x = self._buf[0, :pos]
        mean = float(np.nanmean(x)) if self.mean else 0.0
        x = np.where(np.isfinite(x), x - mean, 0.0)
        starts = []
        if self.p + self.q == 0:
            return starts
        for order in (max(12, 2 * (self.p + self.q)), max(40, 4 * (self.p + self.q))):
            theta = np.zeros(self._n)
            if kernel.rough_start(self._s, x, min(order, pos // 5), theta):
                if self.mean:
                    theta[self.p + self.q] = mean * (1.0 + theta[: self.p].sum())
                starts.append(theta)
        return starts

    def _run(self, theta: Array, passes: int) -> tuple[float, bool]:
        """Polish `theta` in place and make it the running estimate; returns the mean square and whether it settled."""
        lo = self._first_counted()
        used, settled = kernel.polish(
            self._s, theta, self._buf, lo, self._carry, self._work, self._normal, passes
        )
        kernel.adopt(self._s, theta, self._carry, self._work, self._normal, used)
        r, pos = max(self.p, self.q), int(self._s[kernel.HEAD, kernel.POS])
        self._used = used
        self._residuals = self._work[4, r + lo : r + pos]
        return float(self._normal[self._n, self._n]) / max(used, 1), bool(settled)

    def _best_of(self, starts: list[Array]) -> None:
        costs = [self._run(theta, COLD_PASSES)[0] for theta in starts]
        best = int(np.argmin(costs))
        if best != len(starts) - 1:
            self._run(starts[best], COLD_PASSES)

    def _polish(self) -> None:
        """Polish from the running estimate; when the result is doubtful, try other starts as well, ever more rarely."""
        theta = self._s[kernel.THETA, : self._n].copy()
        _, settled = self._run(theta, PASSES)
        if settled and not _coloured(self._residuals):
            self._doubtful = 0
            return
        self._doubtful += 1
        if self._doubtful & (self._doubtful - 1) == 0:
            self._best_of([*self._rough_starts(), theta])

    # ------------------------------------------------------------------ estimate out

    @property
    def is_running(self) -> bool:
        """Whether the first samples were enough (and varied enough) to start."""
        return bool(self._s[kernel.HEAD, kernel.RUNNING])

    @property
    def n_seen(self) -> int:
        """Samples offered so far, missing ones included."""
        return int(self._s[kernel.HEAD, kernel.SEEN])

    @property
    def ar(self) -> Array:
        """Autoregressive coefficients, shape (p,)."""
        return self._s[kernel.THETA, : self.p].copy()

    @property
    def ma(self) -> Array:
        """Moving-average coefficients, shape (q,)."""
        return self._s[kernel.THETA, self.p : self.p + self.q].copy()

    @property
    def sd(self) -> float:
        """Standard deviation of the innovation, in the unit of the series."""
        head = self._s[kernel.HEAD]
        if not self.is_running:
            x = self._buf[0, : int(head[kernel.POS])]
            x = x[np.isfinite(x)]
            top = float(np.max(np.abs(x))) if x.size else 0.0
            return float(np.std(x / top)) * top if top > 0.0 else 0.0
        return math.sqrt(max(head[kernel.VAR], 0.0) / _clipped_variance(self.clip)) / float(head[kernel.UNIT])

    @property
    def covariance(self) -> Array:
        """Covariance of ``[ar, ma]``, shape (p+q, p+q)."""
        k = self.p + self.q
        block = self._s[kernel.COV : kernel.COV + k, :k]
        return block * max(float(self._s[kernel.HEAD, kernel.VAR]), 0.0)

    @property
    def level(self) -> float:
        """Mean of the series that the carried constant stands for (0 without one), in the unit of the series."""
        head = self._s[kernel.HEAD]
        if not self.mean:
            return 0.0
        k = self.p + self.q
        constant = self._s[kernel.THETA, k] / (1.0 + self._s[kernel.THETA, : self.p].sum())
        return float(head[kernel.ORIGIN] + constant / head[kernel.UNIT])

    @property
    def exog_gain(self) -> Array:
        """Coefficients of the external regressors in ``A y = C e + B u``, shape (exog,)."""
        first = self.p + self.q + int(self.mean)
        return self._s[kernel.THETA, first : self._n] / self._s[kernel.HEAD, kernel.UNIT]

    @property
    def effective_window(self) -> float:
        """Number of residuals behind the last polish."""
        return float(self._used)

    @property
    def is_stable(self) -> bool:
        """All poles and all zeros strictly inside the unit circle."""
        return is_stable(self.ar) and is_stable(self.ma)

    @property
    def residuals(self) -> Array:
        """Residuals of the last window under the polished coefficients, in the unit of the series."""
        return self._residuals / self._s[kernel.HEAD, kernel.UNIT]

    @property
    def is_white(self) -> bool:
        """Whether the residuals of the last window pass the whiteness gate at 1 %; False before the start."""
        if self._white is None:
            from navfilter.gate import is_white

            self._white = is_white(self._residuals, self.p + self.q) if self._residuals.size else False
        return self._white

    @property
    def model(self) -> ArmaModel:
        """The estimate as an immutable model; flags: "starting", "constant", "unit root", "coloured", "gaps"."""
        if not self.is_running:
            flags = {"starting"} | ({"constant"} if self.n_seen and self.sd == 0.0 else set())
            return ArmaModel([], [], self.sd, effective_window=0.0, flags=frozenset(flags))
        head = self._s[kernel.HEAD]
        ar, ma, covariance = self.ar, self.ma, self.covariance
        flags = set()
        if not is_stable(ar, 1.0 - 3.0 / self.window):
            flags.add("unit root")
        if not self.is_white:
            flags.add("coloured")
        if head[kernel.MISSED] > 0.1 * head[kernel.SEEN]:
            flags.add("gaps")
        spread = log_s0_sd(ar, ma, covariance, max(self._used, 1))
        return ArmaModel(ar, ma, self.sd, covariance, spread, float(self._used), frozenset(flags))

    def spectrum(self, freq_hz: ArrayLike, rate_hz: float) -> Array:
        """One-sided power spectral density of the model at `freq_hz` (unit^2/Hz), samples coming at `rate_hz`."""
        return self.model.spectrum(freq_hz, rate_hz)

    def predict(self, steps: int) -> Array:
        """Expected next `steps` samples, shape (steps,), regressors held at their last values."""
        if steps < 0:
            raise ValueError(f"steps must not be negative, found {steps}.")
        head, k = self._s[kernel.HEAD], self.p + self.q
        theta = self._s[kernel.THETA]
        lags_y, lags_e = -self._s[kernel.PHI, : self.p], self._s[kernel.PHI, self.p : k].copy()
        constant = float(self._s[kernel.PHI, k : self._n] @ theta[k : self._n])
        forecast = np.empty(steps)
        for i in range(steps):
            forecast[i] = constant - theta[: self.p] @ lags_y + theta[self.p : k] @ lags_e
            lags_y = np.concatenate([forecast[i : i + 1], lags_y[:-1]]) if self.p else lags_y
            lags_e = np.concatenate([[0.0], lags_e[:-1]]) if self.q else lags_e
        return head[kernel.ORIGIN] + forecast / head[kernel.UNIT]

    # ------------------------------------------------------------------ keep and bring back

    def snapshot(self) -> dict[str, Array]:
        """All that the estimator knows, as a plain dict of arrays (fit for ``numpy.savez``)."""
        return {
            "state": self._s.copy(),
            "samples": self._buf.copy(),
            "carry": self._carry.copy(),
            "residuals": self._residuals.copy(),
            "exog_origin": self._unit_free_exog.copy(),
            "counters": np.array([self._used, self._doubtful, self._exog_set], dtype=np.float64),
        }

    def restore(self, snapshot: dict[str, Array]) -> None:
        """Continue from a `snapshot` of an estimator built with the same arguments, to the last bit."""
        for name, own in (("state", self._s), ("samples", self._buf), ("carry", self._carry)):
            if name not in snapshot or np.shape(snapshot[name]) != own.shape:
                raise ValueError(
                    f"snapshot does not fit: {name} has shape {np.shape(snapshot.get(name))}, expected {own.shape}. "
                    "Build the estimator with the same orders, window, hop and regressors."
                )
        self._s[:] = snapshot["state"]
        self._buf[:] = snapshot["samples"]
        self._carry[:] = snapshot["carry"]
        self._residuals = np.array(snapshot["residuals"], dtype=np.float64)
        self._unit_free_exog = np.array(snapshot["exog_origin"], dtype=np.float64)
        used, doubtful, exog_set = snapshot["counters"]
        self._used, self._doubtful, self._exog_set = int(used), int(doubtful), bool(exog_set)
        self._white = None


def _order(value: int, name: str) -> int:
    if int(value) != value or not 0 <= value <= 30:
        raise ValueError(f"{name} must be an integer from 0 to 30, found {value}.")
    return int(value)


def _coloured(residuals: Array, lags: int = 20) -> bool:
    """Quick portmanteau at about 4 sigma: reason enough to look for a better optimum."""
    n = residuals.size
    power = float(residuals @ residuals)
    if n < 3 * lags or not power > 0.0:
        return False
    r = np.array([residuals[k:] @ residuals[:-k] for k in range(1, lags + 1)]) / power
    return bool(n * float(r @ r) > lags + 4.0 * math.sqrt(2.0 * lags))


def _clipped_variance(limit: float) -> float:
    """Variance of a standard normal clipped at +-limit; 1 without clipping."""
    if limit <= 0.0:
        return 1.0
    density = math.exp(-0.5 * limit * limit) / math.sqrt(2.0 * math.pi)
    tail = 1.0 - float(ndtr(limit))
    return 1.0 - 2.0 * tail - 2.0 * limit * density + 2.0 * limit * limit * tail

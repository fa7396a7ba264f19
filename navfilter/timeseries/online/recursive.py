"""Online ARMA identification: feed samples one at a time, read coefficients as good as a fit of the last window."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array
from navfilter.foundation.display import Shown, few
from navfilter.kernels import recursive_arma as kernel
from navfilter.timeseries.diagnostics import whiteness
from navfilter.timeseries.model import ArmaModel, log_s0_sd
from navfilter.timeseries.online.window import WindowFit
from navfilter.timeseries.roots import has_unit_root, is_stable


class RecursiveArma(Shown):
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
                f"window must be an integer of at least {least} for orders ({self.p}, {self.q}), found {window}. "
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
        self.window_fit = WindowFit(self.p, self.q, self._m, self.window, self.hop)
        self.share_memory(self.window_fit.state, self.window_fit.samples)
        self._white: bool | None = None
        self._exog_origin = np.zeros(self.n_exog)
        self._exog_set = False
        self._write_header()

    def share_memory(self, state: Array, samples: Array) -> None:
        """Work in these arrays (a bank lays its members side by side)."""
        self.window_fit.state = self._s = state
        self.window_fit.samples = self._buf = samples

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

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"samples": f"{self.n_seen}, window {self.window}"}
        rows |= {"ar": few(self.ar) or None, "ma": few(self.ma) or None, "sd": f"{self.sd:.4g}"}
        return f"RecursiveArma({self.p}, {self.q})" + ("" if self.is_running else ", not begun yet"), rows

    # ------------------------------------------------------------------ samples in

    def update(self, x: float, exog: ArrayLike | None = None) -> None:
        """Take one sample (NaN if it is missing) and, if the estimator has any, its external regressors."""
        if self.n_exog:
            self._s[kernel.PHI, self.p + self.q + int(self.mean) : self._n] = self._check_exog(exog, 1)[0]
        if kernel.rml_step(self._s, self._buf, float(x)):
            self.polish_window()

    def update_many(self, series: ArrayLike, exog: ArrayLike | None = None) -> None:
        """Take samples in order: the same arithmetic as `update` on each, to the last bit.

        Parameters
        ----------
        series : array_like, shape (N,)
            Samples, NaN where missing.
        exog : array_like, shape (N, exog), optional
            External regressors of each sample.
        """
        xs = np.array(numbers(series, "series"), order="C")
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one estimator per channel.")
        us = self._check_exog(exog, xs.size)
        done = 0
        while done < xs.size:
            done = kernel.rml_run(self._s, self._buf, xs, us, done)
            if self._s[kernel.HEAD, kernel.POS] >= self._s[kernel.HEAD, kernel.DUE]:
                self.polish_window()

    def polish_window(self) -> None:
        """At a hop: fit the window again, as far as is due."""
        self.window_fit.due(self.method == "els", self.clip, self.mean)
        self._white = None

    def _check_exog(self, exog: ArrayLike | None, count: int) -> Array:
        if self.n_exog == 0 and exog is None:
            return np.empty((count, 0))
        us = np.array(exog, dtype=np.float64, ndmin=1).reshape(count, -1) if exog is not None else np.empty((count, 0))
        if us.shape[1] != self.n_exog or not np.all(np.isfinite(us)):
            raise ValueError(
                f"exog must be finite with {self.n_exog} value(s) per sample, found shape {us.shape}. "
                "Fill gaps of the regressors before the estimator."
            )
        if count and not self._exog_set:
            # Taken relative to the first values when a constant absorbs the difference: it keeps the two apart.
            self._exog_origin = us[0].copy() if self.mean else np.zeros(self.n_exog)
            self._exog_set = True
        return np.ascontiguousarray(us - self._exog_origin)

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
        return math.sqrt(max(head[kernel.VAR], 0.0) / _truncated_variance(0.99 * self.clip)) / float(head[kernel.UNIT])

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
        return float(self.window_fit.used)

    @property
    def is_stable(self) -> bool:
        """All poles and all zeros strictly inside the unit circle."""
        return is_stable(self.ar) and is_stable(self.ma)

    @property
    def residuals(self) -> Array:
        """Residuals of the last window under the polished coefficients, in the unit of the series."""
        return self.window_fit.residuals / self._s[kernel.HEAD, kernel.UNIT]

    @property
    def is_white(self) -> bool:
        """Whether the residuals of the last window pass the whiteness gate at 1 %; False before the start."""
        if self._white is None:
            enough = self.window_fit.residuals.size > 60 and float(np.std(self.window_fit.residuals)) > 1e-12
            self._white = enough and whiteness(self.window_fit.residuals, fitted=self.p + self.q).is_white
        return self._white

    @property
    def model(self) -> ArmaModel:
        """The estimate as an immutable model; flags: "starting", "constant", "unit root", "coloured", "gaps"."""
        if not self.is_running:
            flags = {"starting"} | ({"constant"} if self.n_seen and self.sd == 0.0 else set())
            return ArmaModel(np.zeros(0), np.zeros(0), self.sd, effective_window=0.0, flags=frozenset(flags))
        head = self._s[kernel.HEAD]
        ar, ma, covariance = self.ar, self.ma, self.covariance
        flags = set()
        if has_unit_root(ar, covariance, max(self.window_fit.used, 1), self.mean):
            flags.add("unit root")
        if not self.is_white:
            flags.add("coloured")
        if head[kernel.MISSED] > 0.1 * head[kernel.SEEN]:
            flags.add("gaps")
        spread = log_s0_sd(ar, ma, covariance, max(self.window_fit.used, 1))
        return ArmaModel(ar, ma, self.sd, covariance, spread, float(self.window_fit.used), frozenset(flags))

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
            "carry": self.window_fit.carry.copy(),
            "residuals": self.window_fit.residuals.copy(),
            "exog_origin": self._exog_origin.copy(),
            "counters": np.array([self.window_fit.used, self.window_fit.doubtful, self._exog_set], dtype=np.float64),
        }

    def restore(self, snapshot: dict[str, Array]) -> None:
        """Continue from a `snapshot` of an estimator built with the same arguments, to the last bit."""
        for name, own in (("state", self._s), ("samples", self._buf), ("carry", self.window_fit.carry)):
            given = snapshot.get(name, np.empty(0))
            if given.shape != own.shape:
                raise ValueError(
                    f"snapshot does not fit: {name} has shape {given.shape}, expected {own.shape}. "
                    "Build the estimator with the same orders, window, hop and regressors."
                )
        self._s[:] = snapshot["state"]
        self._buf[:] = snapshot["samples"]
        self.window_fit.carry[:] = snapshot["carry"]
        self.window_fit.residuals = np.array(snapshot["residuals"], dtype=np.float64)
        self._exog_origin = np.array(snapshot["exog_origin"], dtype=np.float64)
        used, doubtful, exog_set = snapshot["counters"]
        self.window_fit.used, self.window_fit.doubtful, self._exog_set = int(used), int(doubtful), bool(exog_set)
        self._white = None


def _order(value: int, name: str) -> int:
    if int(value) != value or not 0 <= value <= 30:
        raise ValueError(f"{name} must be an integer from 0 to 30, found {value!r}.")
    return int(value)


def _truncated_variance(limit: float) -> float:
    """Variance of a standard normal known to lie within +-limit; 1 without a limit."""
    if limit <= 0.0:
        return 1.0
    density = math.exp(-0.5 * limit * limit) / math.sqrt(2.0 * math.pi)
    return 1.0 - 2.0 * limit * density / math.erf(limit / math.sqrt(2.0))

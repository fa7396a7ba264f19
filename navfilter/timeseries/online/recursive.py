"""Online ARMA identification: feed samples one at a time, read coefficients as good as a fit of the last window.

The window behind an online ARMA estimate: its start, its polish at each hop, and the samples it keeps.
"""

import math

import numpy as np

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.display import Shown, few
from navfilter.kernels import recursive_arma as kernel
from navfilter.kernels import recursive_arma_window as window_kernel
from navfilter.timeseries.diagnostics import whiteness
from navfilter.timeseries.initial_values import hannan_rissanen_start, long_residuals
from navfilter.timeseries.model import ArmaModel, log_s0_sd
from navfilter.timeseries.roots import has_unit_root, is_stable

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
        method: str = "rml",
        clip: float = 0.0,
    ) -> None:
        self.p, self.q = _order(p, "p"), _order(q, "q")
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
        self._m = int(self.mean)
        self._n = self.p + self.q + self._m
        self.window_fit = WindowFit(self.p, self.q, self._m, self.window, self.hop)
        self.share_memory(self.window_fit.state, self.window_fit.samples)
        self._white: bool | None = None
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

    def update(self, x: float) -> None:
        """Take one sample (NaN if it is missing)."""
        if kernel.rml_step(self._s, self._buf, float(x)):
            self.polish_window()

    def update_many(self, series: ArrayLike) -> None:
        """Take samples in order: the same arithmetic as `update` on each, to the last bit.

        Parameters
        ----------
        series : array_like, shape (N,)
            Samples, NaN where missing.
        """
        xs = np.array(numbers(series, "series"), order="C")
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one estimator per channel.")
        done = 0
        while done < xs.size:
            done = kernel.rml_run(self._s, self._buf, xs, done)
            if self._s[kernel.HEAD, kernel.POS] >= self._s[kernel.HEAD, kernel.DUE]:
                self.polish_window()

    def polish_window(self) -> None:
        """At a hop: fit the window again, as far as is due."""
        self.window_fit.due(self.method == "els", self.clip, self.mean)
        self._white = None

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

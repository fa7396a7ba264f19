"""A bank of online ARMA estimators of different orders, and the choice of the model that it hands out.

What stands between a raw sensor stream and an estimator: repeats, resolution, differencing.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from navfilter.foundation.arguments import needs, numbers
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.display import Shown, few
from navfilter.kernels import recursive_arma as kernel
from navfilter.timeseries.model import ArmaModel, log_s0_sd, split_bias
from navfilter.timeseries.online.recursive import RecursiveArma
from navfilter.timeseries.order_criterion import Challenge, Choice
from navfilter.timeseries.roots import cap_poles, has_unit_root, resolved_radius

BANK_ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1), (2, 2), (3, 2), (4, 2))
#: A candidate this far behind by the criterion is followed by its recursion alone until the order in use no longer
#: serves, the others are polished by so many passes at most.
HOPELESS, POLISHES = 30.0, 8


class ArmaBank(Shown):
    """Candidate orders side by side on the same samples; hands out one immutable, stable model.

    At each hop every candidate is polished on the same window, compared by an information criterion over the same
    residuals, and must pass the gate: poles and zeros inside the circle, no pole-zero pair closer than two of its
    standard deviations, residuals white (Ljung-Box and cumulative periodogram, 1 % together). The order changes only
    when a challenger leads by 6 at two hops running, or when the order in use fails the gate.

    A pole that cannot be told from 1 belongs to a random-walk bias: it is split off (`walk_sd`), and `model` is what
    remains. If nothing passes the gate, the last good model stays in use for two windows, then a first-order
    Gauss-Markov model from the moments of the window.

    Parameters
    ----------
    window : int
        Samples behind an estimate.
    orders : sequence of (p, q), optional
        Candidates; default (0,0) to (4,2). Include the reductions of each, so that a superfluous pair has somewhere
        to go.
    hop : int, optional
        Samples between two choices, default a quarter of the window.
    mean : bool
        Carry a constant beside the coefficients.
    clip : float
        Limit innovations to this many robust standard deviations (0 = never).
    criterion : {"bic", "hq"}
        Schwarz, or Hannan and Quinn (keeps weaker terms).
    strict : bool
        False hands out the best candidate even when its residuals are coloured (flag "coloured") in place of the
        Gauss-Markov fall-back.

    Raises
    ------
    ValueError
        For an empty list, an unknown criterion, and what `RecursiveArma` refuses.

    Examples
    --------
    >>> import navfilter as nf
    >>> bank = nf.timeseries.ArmaBank(window=2000)
    >>> bank.update_many(nf.simulate_arma([-0.9], [-0.4], 1.0, 4000, seed=3))
    >>> bank.order, bank.model.is_stable, sorted(bank.model.flags)
    ((1, 1), True, [])
    """

    def __init__(
        self,
        window: int,
        *,
        orders: Sequence[tuple[int, int]] = BANK_ORDERS,
        hop: int | None = None,
        mean: bool = True,
        clip: float = 4.0,
        criterion: str = "bic",
        strict: bool = True,
    ) -> None:
        if criterion not in ("bic", "hq"):
            raise ValueError(f'criterion must be "bic" or "hq", found {criterion!r}.')
        if not orders:
            raise ValueError("orders is empty. Give at least one (p, q).")
        if not all(isinstance(pq, Sequence) and len(pq) == 2 for pq in orders):
            raise ValueError(f"orders must be pairs (p, q), as [(1, 0), (2, 1)], found {orders!r}.")
        self.orders = tuple(sorted({(int(p), int(q)) for p, q in orders}, key=lambda pq: (sum(pq), pq)))
        self.window, self.choice, self.strict, self.mean = int(window), Choice(criterion), bool(strict), bool(mean)
        self.candidates = tuple(RecursiveArma(p, q, window, hop=hop, mean=mean, clip=clip) for p, q in self.orders)
        self._side_by_side()
        self._chosen: int | None = None
        self._challenge = Challenge()
        self._stale = 0
        self._walk_sd = 0.0
        self._model = ArmaModel(np.zeros(0), np.zeros(0), 0.0, effective_window=0.0, flags=frozenset({"starting"}))

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"samples": f"{self.candidates[0].n_seen}, window {self.window}"}
        rows |= {"order": self.order, "walk_sd": f"{self.walk_sd:.4g}" if self.walk_sd else None}
        rows |= {"ar": few(self.model.ar) or None, "ma": few(self.model.ma) or None, "sd": f"{self.model.sd:.4g}"}
        rows["flags"] = ", ".join(sorted(self.model.flags)) or None
        return f"ArmaBank of {len(self.orders)} orders", rows

    def _side_by_side(self) -> None:
        """Lay the candidates' states and samples into two arrays, so that one kernel call serves all."""
        states = [candidate.window_fit.state for candidate in self.candidates]
        rows, width = max(s.shape[0] for s in states), max(s.shape[1] for s in states)
        self._states = np.zeros((len(states), rows, width))
        self._bufs = np.zeros((len(states), *self.candidates[0].window_fit.samples.shape))
        first = max(float(s[kernel.HEAD, kernel.DUE]) for s in states)
        for i, candidate in enumerate(self.candidates):
            self._states[i, : states[i].shape[0], : states[i].shape[1]] = states[i]
            self._states[i, kernel.HEAD, kernel.DUE] = first
            candidate.share_memory(self._states[i], self._bufs[i])

    def __setstate__(self, state: dict[str, Any]) -> None:
        # the candidates work in rows of two arrays: what copies and pickles make of these views stands apart from
        # them, and the kernel would go on with a window that is never emptied
        vars(self).update(state)
        for i, candidate in enumerate(self.candidates):
            candidate.share_memory(self._states[i], self._bufs[i])

    def update(self, x: float) -> None:
        """Take one sample (NaN if it is missing)."""
        if kernel.bank_step(self._states, self._bufs, float(x)):
            self._at_hop()

    def update_many(self, series: ArrayLike) -> None:
        """Take samples in order, shape (N,): the same arithmetic as `update` on each."""
        xs = np.array(numbers(series, "series"), order="C")
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one bank per channel.")
        done = 0
        while done < xs.size:
            done = kernel.bank_run(self._states, self._bufs, xs, done)
            head = self._states[0, kernel.HEAD]
            if head[kernel.POS] >= head[kernel.DUE]:
                self._at_hop()

    # ------------------------------------------------------------------ what it hands out

    @property
    def model(self) -> ArmaModel:
        """The model in use. Flags: "starting", "unit root", "coloured", "stale", "fallback", "gaps", "constant"."""
        return self._model

    @property
    def walk_sd(self) -> float:
        """Step per sample of the random-walk bias that took over a pole near 1, in the unit of the series; else 0."""
        return self._walk_sd

    @property
    def order(self) -> tuple[int, int] | None:
        """Order (p, q) in use, before a bias is split off; None for a fall-back or before the start."""
        return None if self._chosen is None else self.orders[self._chosen]

    @property
    def is_white(self) -> bool:
        """Whether the residuals of the order in use pass the whiteness gate."""
        return self._chosen is not None and self.candidates[self._chosen].is_white

    @property
    def scores(self) -> dict[tuple[int, int], float]:
        """Criterion of each candidate over the last window (smaller is better)."""
        return {order: self._score(c) for order, c in zip(self.orders, self.candidates, strict=True)}

    # ------------------------------------------------------------------ the choice

    def _at_hop(self) -> None:
        for candidate in self.candidates:
            candidate.polish_window()
        if not self.candidates[0].is_running:
            self._model = replace(self.candidates[0].model, flags=self.candidates[0].model.flags | {"starting"})
            return
        scores = np.array([self._score(candidate) for candidate in self.candidates])
        self._ration(scores)
        ranking = [int(i) for i in np.argsort(scores, kind="stable")]
        good = next((i for i in ranking if self._passes(i)), None)
        if good is None:
            self._fall_back(ranking[0])
            return
        self._stale = 0
        self._choose(good, scores)

    def _ration(self, scores: Array) -> None:
        """Spend the work of the next hop on the candidates that may win it; on all while the record is young."""
        young = self.candidates[0].n_seen < self.window or self._chosen is None or self._stale > 0
        for candidate, score in zip(self.candidates, scores, strict=True):
            near = young or not score > scores.min() + HOPELESS
            candidate.window_fit.passes = POLISHES if near else 1
            candidate.window_fit.may_search = near

    def _score(self, candidate: RecursiveArma) -> float:
        """Criterion from the mean square residual of the window, which the candidates share."""
        residuals, used = candidate.window_fit.residuals, candidate.window_fit.used
        if used < 2 or not np.any(residuals):
            return math.inf
        n = float(residuals.size)
        return self.choice.score(n * math.log(float(residuals @ residuals) / used), candidate.p + candidate.q, n)

    def _passes(self, i: int) -> bool:
        candidate = self.candidates[i]
        if not candidate.is_stable or not np.all(np.isfinite(candidate.covariance)):
            return False
        return candidate.is_white and not self.choice.cancels(candidate.ar, candidate.ma, candidate.covariance)

    def _choose(self, good: int, scores: Array) -> None:
        """Adopt the best that passed, with hysteresis once the window is full."""
        now = self._chosen
        full = self.candidates[0].n_seen >= self.window
        if now is not None and now != good and full and self._passes(now):
            self._challenge = self._challenge.by(self.orders[good])
            if scores[now] - scores[good] <= self.choice.lead or self._challenge.leads < self.choice.hops:
                good = now
        if good != now:
            self._challenge = Challenge()
        self._chosen = good
        self._hand_out(self.candidates[good].model)

    def _hand_out(self, model: ArmaModel) -> None:
        self._walk_sd = 0.0
        self._model = model
        if model.covariance is None:
            return
        window = max(model.effective_window or 0.0, 1.0)
        if not has_unit_root(model.ar, model.covariance, window, self.mean):
            self._model = replace(model, flags=model.flags - {"unit root"})
            return
        flags = model.flags | {"unit root"}
        try:
            self._walk_sd, rest = split_bias(model)
            self._model = replace(rest, flags=flags)
        except ValueError:
            ar = cap_poles(model.ar, resolved_radius(window))
            spread = log_s0_sd(ar, model.ma, model.covariance, window)
            self._model = replace(model, ar=ar, sd_log_s0=spread, flags=flags)

    def _fall_back(self, best: int) -> None:
        """Nothing passed: the best candidate if not strict, else the last good model, else Gauss-Markov."""
        candidate = self.candidates[best]
        if not self.strict:
            self._chosen = best
            self._hand_out(replace(candidate.model, flags=candidate.model.flags | {"coloured"}))
            return
        self._stale += 1
        if self._chosen is not None and self._stale * candidate.hop <= 2 * self.window:
            self._model = replace(self._model, flags=self._model.flags | {"stale"})
            return
        self._chosen = None
        head = candidate.window_fit.state[kernel.HEAD]
        series = candidate.window_fit.samples[0, : int(head[kernel.POS])] / head[kernel.UNIT]
        self._walk_sd = 0.0
        self._model = moment_gm1(series[-self.window :], self.mean)


def moment_gm1(series: ArrayLike, mean: bool = True) -> ArmaModel:
    """First-order Gauss-Markov model from variance and lag-one correlation, the pole capped at ``1 - 3/N``.

    NaN samples are left out; a correlation within two standard deviations of zero gives white noise. Flag "fallback".
    """
    x = numbers(series, "series")
    known = np.isfinite(x)
    n = int(known.sum())
    flags = frozenset({"fallback"})
    if n < 2:
        return ArmaModel(np.zeros(0), np.zeros(0), 0.0, effective_window=float(n), flags=flags)
    x = np.where(known, x - (float(x[known].mean()) if mean else 0.0), 0.0)
    top = float(np.max(np.abs(x)))
    if not top > 0.0:
        return ArmaModel(np.zeros(0), np.zeros(0), 0.0, effective_window=float(n), flags=flags)
    x = x / top
    variance = float(x @ x) / n
    pairs = max(int(np.sum(known[1:] & known[:-1])), 1)
    rho = float(x[1:] @ x[:-1]) / pairs / variance
    if abs(rho) < 2.0 / math.sqrt(n):
        return ArmaModel(np.zeros(0), np.zeros(0), top * math.sqrt(variance), np.zeros((0, 0)), None, float(n), flags)
    limit = resolved_radius(max(n, 4))
    rho = min(max(rho, -limit), limit)
    covariance = np.array([[(1.0 - rho * rho) / n]])
    sd = top * math.sqrt(variance * (1.0 - rho * rho))
    return ArmaModel(
        np.array([-rho]), np.zeros(0), sd, covariance, log_s0_sd([-rho], [], covariance, n), float(n), flags
    )


class FrontEnd(Shown):
    """Conditions the samples of one sensor channel and feeds them to an online estimator.

    The first `learn` samples are looked at before any is passed on: the step of the digits is found, and how often a
    value repeats. If values repeat far more often than the digits explain, the sensor is slower than the logger, and
    repeats are dropped (time does not advance); if they repeat now and then, it gets stuck, and repeats count as
    missing. Mean and clipping of innovations are the estimator's (`mean`, `clip`): they are carried beside the
    coefficients, because subtracting them first shortens slow correlations.

    Parameters
    ----------
    estimator : RecursiveArma or ArmaBank
        Fed with the conditioned samples.
    difference : {0, 1, 2}
        Times to difference (ARIMA): 1 turns random walk + white noise into MA(1).
    season : int
        Lag of a further, seasonal difference (0 = none).
    repeats : {"auto", "drop", "missing", "keep"}
        What to do with a value equal to the one before.
    learn : int
        Samples looked at first.

    Examples
    --------
    >>> import numpy as np, navfilter as nf
    >>> walk = np.cumsum(0.02 * np.random.default_rng(0).normal(size=8000))
    >>> level = walk + np.random.default_rng(1).normal(size=8000)
    >>> front = FrontEnd(nf.RecursiveArma(0, 1, 4000, mean=False), difference=1)
    >>> front.update_many(level)
    >>> bool(-1.0 < front.model.ma[0] < -0.95)
    True
    """

    def __init__(
        self,
        estimator: RecursiveArma | ArmaBank,
        *,
        difference: int = 0,
        season: int = 0,
        repeats: str = "auto",
        learn: int = 200,
    ) -> None:
        needs("FrontEnd: estimator", estimator, RecursiveArma, ArmaBank)
        if difference not in (0, 1, 2):
            raise ValueError(f"difference must be 0, 1 or 2, found {difference}. More would only add noise.")
        if int(season) != season or season < 0:
            raise ValueError(f"season must be a lag in samples, 0 for none, found {season}.")
        if repeats not in ("auto", "drop", "missing", "keep"):
            raise ValueError(f'repeats must be "auto", "drop", "missing" or "keep", found {repeats!r}.')
        if learn < 20:
            raise ValueError(f"learn must be at least 20 samples, found {learn}.")
        self.estimator = estimator
        self.difference, self.season, self.repeats, self.learn = int(difference), int(season), repeats, int(learn)
        self.resolution = 0.0
        self.dropped = 0
        self._held: list[float] = []
        self._handling = "keep" if repeats == "auto" else repeats
        self._learnt = False
        self._last = math.nan
        self._lags = [math.nan] * self.difference
        self._season_lags = [math.nan] * self.season

    def _shown(self) -> tuple[str, dict[str, object]]:
        looking = f", looking at the first {self.learn} samples" * (not self._learnt)
        title, rows = self.estimator._shown()
        repeats = f"{self._handling}, {self.dropped} so far"
        rows = {"resolution": f"{self.resolution:.4g}", "repeats": repeats, "difference": self.difference, **rows}
        return f"FrontEnd of {title}{looking}", rows

    def update(self, x: float) -> None:
        """Take one raw sample (NaN if it is missing)."""
        if self._learnt:
            self._pass_on(float(x))
            return
        self._held.append(float(x))
        if len(self._held) >= self.learn:
            self.flush()

    def update_many(self, series: ArrayLike) -> None:
        """Take raw samples in order, shape (N,)."""
        xs = numbers(series, "series")
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one front end per channel.")
        for x in xs:
            self.update(x)

    def flush(self) -> None:
        """Look at what is held now, and pass it on: for a record shorter than `learn`."""
        first = np.array(self._held)
        self.resolution = find_resolution(first)
        if self.repeats == "auto":
            seen, expected = repeat_share(first, self.resolution)
            if seen > 3.0 * expected + 0.05:
                self._handling = "drop" if seen > 0.3 else "missing"
        self._learnt = True
        held, self._held = self._held, []
        for x in held:
            self._pass_on(x)

    def _pass_on(self, x: float) -> None:
        if x == self._last and self._handling != "keep":
            self.dropped += 1
            if self._handling == "drop":
                return
            x = math.nan
        else:
            self._last = x
        for i in range(self.difference):
            x, self._lags[i] = x - self._lags[i], x
        if self.season:
            x, oldest = x - self._season_lags[0], x
            self._season_lags = [*self._season_lags[1:], oldest]
        self.estimator.update(x)

    @property
    def model(self) -> ArmaModel:
        """The estimator's model with flags "quantised", "repeats" (dropped or missing) and "differenced" added."""
        model = self.estimator.model
        flags = set(model.flags)
        if self._learnt and self.resolution > model.sd:
            flags.add("quantised")
        if self.dropped:
            flags.add("repeats")
        if self.difference or self.season:
            flags.add("differenced")
        return replace(model, flags=frozenset(flags))


def find_resolution(series: ArrayLike) -> float:
    """Step of the digits of a series: the number whose multiples all its gaps are; 0 if there is none.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=300)
    >>> round(find_resolution(np.round(x / 0.25) * 0.25), 6), find_resolution(x)
    (0.25, 0.0)
    """
    x = numbers(series, "series")
    values = np.unique(x[np.isfinite(x)])
    if values.size < 2:
        return 0.0
    gaps = np.diff(values)
    # Gaps that are rounding of the numbers themselves are none.
    gaps = gaps[gaps > 1e-12 * np.max(np.abs(values))]
    if gaps.size == 0:
        return 0.0
    # Digits may have been rounded twice (a pressure step printed in centimetres): gaps are multiples up to a quarter.
    step = float(gaps.min())
    step = float(np.mean(gaps[gaps < 1.5 * step]))
    multiples = gaps / step
    if np.max(multiples) > 1e6 or np.any(np.abs(multiples - np.round(multiples)) > 0.25):
        return 0.0
    return float(gaps.sum() / np.sum(np.round(multiples)))


def repeat_share(series: ArrayLike, resolution: float) -> tuple[float, float]:
    """Share of samples equal to the one before, and the share that rounding to `resolution` explains."""
    x = numbers(series, "series")
    steps = np.diff(x[np.isfinite(x)])
    if steps.size == 0:
        return 0.0, 0.0
    spread = math.sqrt(0.5 * math.pi) * float(np.mean(np.abs(steps)))
    if spread == 0.0:
        return 1.0, 1.0
    seen = float(np.mean(steps == 0.0))
    wide = resolution / spread
    if wide == 0.0:
        return seen, 0.0
    # Expectation of 1 - |step|/resolution where positive, the step being normal: two values share a cell.
    gap = math.sqrt(2.0 / math.pi) * (1.0 - math.exp(-0.5 * wide * wide)) / wide
    return seen, math.erf(wide / math.sqrt(2.0)) - gap

"""The learner of one channel: candidate orders on a sliding window, and the one model that it hands out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.arma.bank import cancelling_pairs
from navfilter.arma.model import ArmaModel
from navfilter.learning.channel import ChannelFit, Drift, channel_fit, theta_of
from navfilter.learning.likelihood import Likelihood, maximise
from navfilter.learning.starts import cold_starts, grown_starts

__all__ = ["Learner"]

Array = NDArray[np.float64]
Order = tuple[int, int]

# Fewer known samples than this, or than so many per parameter, say nothing that a filter should believe.
LEAST, PER_PARAMETER = 200, 20
# Hysteresis, as in `ArmaBank`: a challenger must lead by this much, at this many hops in a row.
LEAD, HOPS = 6.0, 2
# A candidate within this much of the best by BIC is not ruled out (Kass and Raftery 1995: evidence up to "strong"); if it
# finds far more power at zero frequency (by two standard deviations, and at least twofold), that power is not denied.
OPEN, TWOFOLD = 10.0, math.log(2.0)
# Scoring passes of a first estimate, of the order in use, and of a challenger.
COLD, OWN, OTHER = 20, 3, 2
# Orders that exceed a good one by more parameters than this wait for their turn.
BEYOND = 2


class Learner:
    """Follows the ARMA error of one channel from hop to hop; each hop hands out one immutable, stable model.

    The order is chosen by BIC over the same window, with hysteresis: it changes when a challenger leads by 6 at two
    hops running, or when the order in use fails the gate (innovations white, no pole-zero pair closer than two standard
    deviations). The first windows fit all orders; later hops polish the order in use and two challengers, the nearest
    and one in turn.

    Flags of the model: "starting" (too few samples: white noise of about the right size), "coloured" (nothing passed the
    gate: the best by BIC), "stale" (nothing passed, and the last good model still explains the window as well),
    "fallback" (nothing usable but first-order Gauss-Markov, by likelihood), "capped" (a pole as near to 1 as the window
    can tell), "constant" (the series does not change).

    Parameters
    ----------
    orders : sequence of (p, q)
        Candidates. Include the reductions of each, so that a superfluous pair has somewhere to go.
    window : int
        Most samples behind an estimate.
    drift : Drift
        The slow error beside the ARMA error, and the period.
    white : float
        Variance of known white noise in the series.

    Raises
    ------
    ValueError
        For no orders, negative orders, a window below 200 samples, a bad variance.

    Examples
    --------
    >>> import navfilter as nf
    >>> learner = Learner([(0, 0), (1, 0), (1, 1)], 2000, Drift((1e-3, 0.0), 0.125))
    >>> model = learner.hop(nf.simulate_arma([-0.9], [], 1.0, 2000, seed=3))
    >>> learner.order, model.ar.round(1), sorted(model.flags)
    ((1, 0), array([-0.9]), [])
    """

    def __init__(self, orders: Sequence[Order], window: int, drift: Drift, *, white: float = 0.0) -> None:
        self.orders: tuple[Order, ...] = tuple(sorted({(int(p), int(q)) for p, q in orders}, key=lambda pq: (sum(pq), pq)))
        if not self.orders or min(min(order) for order in self.orders) < 0:
            raise ValueError(f"orders must be at least one (p, q) of numbers not below 0, found {orders!r}.")
        if int(window) != window or window < LEAST:
            raise ValueError(f"window must be a whole number of samples, at least {LEAST}, found {window}.")
        if not (math.isfinite(white) and white >= 0.0):
            raise ValueError(f"white must be a variance (finite, not negative), found {white}.")
        self.window, self.drift, self.white = int(window), drift, float(white)
        self._thetas: dict[Order, Array] = {}
        self._gaps: dict[Order, float] = {}
        self._chosen: Order | None = None
        self._challenger: Order | None = None
        self._leads, self._turn, self._young = 0, 0, True
        self._good: ArmaModel | None = None

    @property
    def order(self) -> Order | None:
        """Order (p, q) in use; None before the start."""
        return self._chosen

    def hop(self, series: ArrayLike) -> ArmaModel:
        """Learn from the last `window` samples (fewer at first), shape (N,), oldest first; NaN is a missing tick.

        Returns
        -------
        ArmaModel
        """
        y = np.array(series, dtype=np.float64, order="C")
        if y.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {y.shape}. Use one learner per channel.")
        y = np.where(np.isfinite(y), y, np.nan)[-self.window :]
        n = int(np.isfinite(y).sum())
        able = [order for order in self.orders if n - self.drift.order >= max(LEAST, PER_PARAMETER * (sum(order) + 1))]
        try:
            likelihood = Likelihood(y, self.drift.noise_per_tick(), self.white)
        except ValueError:
            return self._without(y, n, "starting" if n < LEAST else "constant")
        if not able:
            return self._without(y, n, "starting")
        fits = self._fit(likelihood, able)
        model = self._choose(likelihood, fits)
        self._young = n < 0.9 * self.window
        return model

    def _without(self, y: Array, n: int, flag: str) -> ArmaModel:
        """What is handed out when there is nothing to learn from: the last good model, else white noise."""
        if self._good is not None:
            return replace(self._good, flags=self._good.flags | {"stale"})
        known = y[np.isfinite(y)]
        # Differences: the drift does not count, and the white noise of equal power is on the cautious side.
        sd = float(np.std(known)) if known.size > 1 else 0.0
        return ArmaModel(np.zeros(0), np.zeros(0), sd, effective_window=float(n), flags=frozenset({"starting", flag}))

    # ------------------------------------------------------------------ fits

    def _fit(self, likelihood: Likelihood, able: list[Order]) -> dict[Order, ChannelFit]:
        fits: dict[Order, ChannelFit] = {}
        for order in self._ration(able):
            known = self._thetas.get(order)
            if known is None and self._superfluous(order, fits):
                continue
            starts, passes = self._starts(order, likelihood, fits)
            fit = channel_fit(likelihood, maximise(likelihood, starts, order[0], passes))
            if math.isfinite(fit.loglik):
                fits[order] = fit
                self._thetas[order] = np.r_[fit.model.ar, fit.model.ma, math.log(max(fit.model.sd, 1e-300))]
        return fits

    def _starts(self, order: Order, likelihood: Likelihood, fits: dict[Order, ChannelFit]) -> tuple[list[Array], int]:
        """Where to begin, and how many passes to spend."""
        known = self._thetas.get(order)
        if known is not None:
            return [_rescaled(known, likelihood)], OWN if order == self._chosen else OTHER
        below = {k: theta_of(fit.model, likelihood) for k, fit in fits.items() if k != order and sum(k)}
        return (grown_starts(likelihood, below, *order) if below else cold_starts(likelihood, *order)), COLD

    def _superfluous(self, order: Order, fits: dict[Order, ChannelFit]) -> bool:
        """Whether to put off an order that was never fitted: much larger than the best so far, which passes the gate."""
        if not self._young or not fits:
            return False
        best = min(fits, key=lambda k: fits[k].bic)
        return sum(order) > sum(best) + BEYOND and _passes(fits[best])

    def _ration(self, able: list[Order]) -> list[Order]:
        """The orders to fit at this hop: all while young, then the one in use, its nearest challenger and one in turn."""
        if self._young or self._chosen is None or self._chosen not in able:
            return able
        others = [order for order in able if order != self._chosen]
        nearest = sorted(others, key=lambda order: (self._gaps.get(order, math.inf), sum(order)))[:1]
        if self._challenger is not None and self._challenger in others:
            nearest = [self._challenger]
        rest = [order for order in others if order not in nearest]
        turn = [rest[self._turn % len(rest)]] if rest else []
        self._turn += 1
        picked = {self._chosen, *nearest, *turn}
        return [order for order in able if order in picked]

    # ------------------------------------------------------------------ choice

    def _choose(self, likelihood: Likelihood, fits: dict[Order, ChannelFit]) -> ArmaModel:
        if not fits:
            return self._without(likelihood.y / likelihood.unit, likelihood.n, "constant")
        ranking = sorted(fits, key=lambda order: fits[order].bic)
        good = _preferred(fits, ranking)
        if good is None:
            return self._unsure(likelihood, fits, ranking)
        now = self._chosen
        if now is not None and now in fits and now != good and not self._young and _passes(fits[now]):
            self._leads = self._leads + 1 if self._challenger == good else 1
            self._challenger = good
            if not (fits[now].bic - fits[good].bic > LEAD or _denied(fits[now], fits[good])) or self._leads < HOPS:
                good = now
        if good != now:
            self._challenger, self._leads = None, 0
        self._settle(good, fits)
        self._good = fits[good].model
        return fits[good].model

    def _settle(self, order: Order, fits: dict[Order, ChannelFit]) -> None:
        self._chosen = order
        for other, fit in fits.items():
            self._gaps[other] = fit.bic - fits[order].bic

    def _unsure(self, likelihood: Likelihood, fits: dict[Order, ChannelFit], ranking: list[Order]) -> ArmaModel:
        """Nothing passed: the last good model while it explains the window as well, else the best, else Gauss-Markov."""
        tidy = [order for order in ranking if not _cancels(fits[order])]
        best = tidy[0] if tidy else None
        if self._good is not None and best is not None:
            theta = theta_of(self._good, likelihood)
            value = likelihood.value(likelihood.confine(theta, self._good.p), self._good.p)
            n = fits[best].n
            bic = 2.0 * (value - n * math.log(likelihood.unit)) + theta.size * math.log(max(n, 2))
            if bic <= fits[best].bic + LEAD:
                return replace(self._good, flags=self._good.flags | {"stale", "coloured"})
        if best is not None:
            self._settle(best, fits)
            return replace(fits[best].model, flags=fits[best].model.flags | {"coloured"})
        simple = []
        for p, q in ((1, 0), (1, 1)):
            simple.append(channel_fit(likelihood, maximise(likelihood, cold_starts(likelihood, p, q), p, COLD)))
        model = min(simple, key=lambda fit: fit.bic).model
        return replace(model, flags=model.flags | {"fallback", "coloured"})

    # ------------------------------------------------------------------ keep and bring back

    def snapshot(self) -> dict[str, Array]:
        """All that the learner knows, as a plain dict of float64 arrays."""
        index = {order: float(i) for i, order in enumerate(self.orders)}
        at = [-1.0 if order is None else index.get(order, -1.0) for order in (self._chosen, self._challenger)]
        kept = {"choice": np.array([*at, self._leads, self._turn, float(self._young)], dtype=np.float64)}
        kept["gaps"] = np.array([self._gaps.get(order, math.nan) for order in self.orders])
        for order, theta in self._thetas.items():
            kept[f"theta/{int(index[order])}"] = theta.copy()
        if self._good is not None:
            model = self._good
            kept["good"] = np.r_[model.p, model.q, model.ar, model.ma, model.sd]
            kept["good_covariance"] = np.zeros((0, 0)) if model.covariance is None else model.covariance.copy()
            kept["good_extra"] = np.array([model.sd_log_s0, model.effective_window, float("capped" in model.flags)], dtype=np.float64)
        return kept

    def restore(self, snapshot: dict[str, Array]) -> None:
        """Continue from a `snapshot` of a learner built with the same arguments, to the last bit."""
        chosen, challenger, leads, turn, young = (float(v) for v in snapshot["choice"])
        self._chosen = None if chosen < 0 else self.orders[int(chosen)]
        self._challenger = None if challenger < 0 else self.orders[int(challenger)]
        self._leads, self._turn, self._young = int(leads), int(turn), bool(young)
        gaps = zip(self.orders, snapshot["gaps"], strict=True)
        self._gaps = {order: float(gap) for order, gap in gaps if not math.isnan(gap)}
        names = [(order, f"theta/{i}") for i, order in enumerate(self.orders)]
        self._thetas = {order: np.array(snapshot[name]) for order, name in names if name in snapshot}
        self._good = None
        if "good" in snapshot:
            p, q = int(snapshot["good"][0]), int(snapshot["good"][1])
            ar, ma, sd = np.split(np.asarray(snapshot["good"][2:]), [p, p + q])
            spread, length, capped = (float(v) for v in snapshot["good_extra"])
            flags = frozenset({"capped"}) if capped else frozenset()
            self._good = ArmaModel(ar, ma, float(sd[0]), snapshot["good_covariance"], spread, length, flags)


def _rescaled(theta: Array, likelihood: Likelihood) -> Array:
    """A kept estimate in the units of this window."""
    return np.r_[theta[:-1], theta[-1] + math.log(likelihood.unit)]


def _cancels(fit: ChannelFit) -> bool:
    model = fit.model
    if model.covariance is None or not np.all(np.isfinite(model.covariance)):
        return True
    return cancelling_pairs(model.ar, model.ma, model.covariance) > 0


def _passes(fit: ChannelFit) -> bool:
    return fit.is_white and not _cancels(fit)


def _preferred(fits: dict[Order, ChannelFit], ranking: list[Order]) -> Order | None:
    """The best by BIC that passes the gate, unless one about as good finds far more power at low frequencies."""
    passing = [order for order in ranking if _passes(fits[order])]
    if not passing:
        return None
    best = passing[0]
    for order in passing[1:]:
        if fits[order].bic <= fits[passing[0]].bic + OPEN and _denied(fits[best], fits[order]):
            best = order
    return best


def _denied(fit: ChannelFit, other: ChannelFit) -> bool:
    """Whether `fit` denies, by two of its standard deviations, the low-frequency power that `other` finds."""
    if not other.bic <= fit.bic + OPEN:
        return False
    excess = 2.0 * math.log(max(_gain(other.model), 1e-300) / max(_gain(fit.model), 1e-300))
    return excess > max(2.0 * (fit.model.sd_log_s0 or 0.0), TWOFOLD)


def _gain(model: ArmaModel) -> float:
    """Square root of S(0)."""
    return model.sd * abs(1.0 + float(model.ma.sum())) / max(abs(1.0 + float(model.ar.sum())), 1e-300)

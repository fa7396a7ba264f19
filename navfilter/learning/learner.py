"""The learner of one channel: candidate orders on a sliding window, and the one model that it hands out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.arma.choice import Challenge
from navfilter.arma.model import ArmaModel
from navfilter.arma.roots import time_constant
from navfilter.learning.drift import Drift
from navfilter.learning.effort import EFFORT
from navfilter.learning.fit import CHANNEL_CHOICE, theta_of
from navfilter.learning.likelihood import Likelihood
from navfilter.learning.limits import CYCLES, LEAST, PER_PARAMETER
from navfilter.learning.low_frequency import slow_pole
from navfilter.learning.orders import Candidate, finds_more_low_frequency_power, fit_candidate, preferred
from navfilter.learning.starts import cold_starts, grown_starts, slow_part_start

__all__ = ["Learner", "LearnerMemory", "memories", "recall"]

Array = NDArray[np.float64]
Order = tuple[int, int]

#: A window counts as full when this part of it is known.
FULL = 0.9


@dataclass(frozen=True)
class LearnerMemory:
    """What a learner knows between hops; nothing in it is changed.

    Attributes
    ----------
    thetas : dict of (p, q) to ndarray, shape (p + q + 1,)
        Estimates ``[ar, ma, ln sd]`` of every order that has been fitted, in the unit of the series.
    gaps : dict of (p, q) to float
        BIC above that of the order in use.
    chosen : (p, q) or None
        The order in use.
    challenge : Challenge
    turn, coloured : int
        Turns of the other orders, and hops in a row without an order that passed.
    young : bool
        Whether the window was not full at the last hop.
    good : ArmaModel or None
        The last model that passed.
    """

    thetas: dict[Order, Array]
    gaps: dict[Order, float]
    chosen: Order | None
    challenge: Challenge
    turn: int
    coloured: int
    young: bool
    good: ArmaModel | None


class Learner:
    """Follows the ARMA error of one channel from hop to hop; each hop hands out one immutable, stable model.

    The order is chosen by BIC over the same window, with hysteresis: it changes when a challenger leads by 6 at two
    hops running, or when the order in use fails the gate (innovations white, no pole-zero pair closer than two standard
    deviations). The first windows fit all orders; later hops polish the order in use and two challengers, the nearest
    and one in turn.

    Flags of the model: "starting" (too few samples: white noise of about the right size; or samples over less than ten
    times the slowest time constant found, while the window fills: such a fit takes slow errors for drift), "coloured"
    (nothing passed the gate: the best by BIC), "stale" (nothing passed, and the last good model still explains the
    window as well), "fallback" (nothing usable but first-order Gauss-Markov, by likelihood), "capped" (a pole as near
    to 1 as the window can tell), "constant" (the series does not change).

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
        self.orders = tuple(sorted({(int(p), int(q)) for p, q in orders}, key=lambda pq: (sum(pq), pq)))
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
        self._challenge = Challenge()
        self._turn, self._coloured, self._young = 0, 0, True
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
            Stable and invertible, in the unit of the series, with flags.
        """
        y = np.array(series, dtype=np.float64, order="C")
        if y.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {y.shape}. Use one learner per channel.")
        y = np.where(np.isfinite(y), y, np.nan)[-self.window :]
        n = int(np.isfinite(y).sum())
        able = [order for order in self.orders if n - self.drift.order >= max(LEAST, PER_PARAMETER * (sum(order) + 1))]
        if not able:
            return self._without(y, "starting")
        try:
            likelihood = Likelihood(y, self.drift.per_tick(), self.white)
        except ValueError:
            return self._without(y, "constant")
        fits = self._fit(likelihood, self._ration(able))
        best = preferred(fits.values())
        if best is None and self._coloured & (self._coloured + 1) == 0:
            # Ever more rarely, see whether any other order does.
            fits |= self._fit(likelihood, [order for order in able if order not in fits])
            best = preferred(fits.values())
        self._coloured = self._coloured + 1 if best is None else 0
        young = n < FULL * self.window
        model = self._without(y, "constant") if not fits else self._choose(likelihood, fits, best)
        self._young = young
        if young and "stale" not in model.flags and max(map(time_constant, model.poles), default=0.0) > n / CYCLES:
            model = _flagged(model, "starting")
            self._good = None if self._good is None else _flagged(self._good, "starting")
        return model

    def _without(self, y: Array, flag: str) -> ArmaModel:
        """What is handed out when there is nothing to learn from: the last good model, else white noise."""
        if self._good is not None:
            return replace(self._good, flags=self._good.flags | {"stale"})
        known = y[np.isfinite(y)]
        # The drift counts as noise here, which is on the cautious side.
        sd = float(np.std(known)) if known.size > 1 else 0.0
        flags = frozenset({"starting", flag})
        return ArmaModel(np.zeros(0), np.zeros(0), sd, effective_window=float(known.size), flags=flags)

    # ------------------------------------------------------------------ fits

    def _ration(self, able: list[Order]) -> list[Order]:
        """The orders to fit at this hop: all while young, then the one in use, its nearest challenger and one in
        turn.
        """
        if self._young or self._chosen is None or self._chosen not in able:
            return able
        others = [order for order in able if order != self._chosen]
        nearest = sorted(others, key=lambda order: (self._gaps.get(order, math.inf), sum(order)))[:1]
        challenger = self._challenge.order
        if challenger is not None and challenger in others:
            nearest = [challenger]
        own = sum(self._chosen)
        near = [
            order
            for order in others
            if order not in nearest and self._near(order) and sum(order) <= own + EFFORT.hopeless_size
        ]
        out = [order for order in others if order not in nearest and order not in near]
        rest = out if out and (not near or self._turn % EFFORT.rare_turn == EFFORT.rare_turn - 1) else near
        turn = [rest[(self._turn // EFFORT.rare_turn if rest is out else self._turn) % len(rest)]] if rest else []
        self._turn += 1
        # where nothing slow was found, look for it: by a pole and a zero more
        wider = (self._chosen[0] + 1, self._chosen[1] + 1)
        slow = [wider] if wider in others and wider not in (*nearest, *turn) and not self._has_slow_pole() else []
        return [self._chosen, *nearest, *turn, *slow]

    def _near(self, order: Order) -> bool:
        """Whether an order was near enough when fitted last."""
        return self._gaps.get(order, 0.0) < EFFORT.hopeless_bic

    def _has_slow_pole(self) -> bool:
        """Whether the last good model has a real pole in the right half of the circle."""
        return self._good is None or slow_pole(self._good) is not None

    def _fit(self, likelihood: Likelihood, orders: list[Order]) -> dict[Order, Candidate]:
        fits: dict[Order, Candidate] = {}
        for order in orders:
            known = self._thetas.get(order)
            if known is not None:
                passes = EFFORT.own_passes if order == self._chosen else EFFORT.other_passes
                found = fit_candidate(likelihood, order, [_rescaled(known, likelihood)], passes)
                if order == orders[-1]:
                    found = self._second_chance(likelihood, found, fits)
            elif self._superfluous(order, fits):
                continue
            else:
                below = {k: c.point.theta for k, c in fits.items() if sum(k)}
                some = likelihood.recent
                starts = grown_starts(some, below, *order) if below else cold_starts(some, *order)
                found = fit_candidate(
                    likelihood, order, starts, EFFORT.first_passes if self._young else EFFORT.late_passes
                )
            if found is not None:
                fits[order] = found
                self._thetas[order] = found.theta
        return fits

    def _second_chance(
        self, likelihood: Likelihood, found: Candidate | None, fits: dict[Order, Candidate]
    ) -> Candidate | None:
        """A larger order that gains nothing over the one in use may sit in a local optimum: start it from there as
        well.
        """
        own = fits.get(self._chosen) if self._chosen is not None else None
        if (
            found is None
            or own is None
            or self._young
            or found.order == own.order
            or found.fit.loglik > own.fit.loglik + 1.0
        ):
            return found
        starts = slow_part_start(likelihood, own.point.theta, own.order[0], *found.order)
        again = fit_candidate(likelihood, found.order, starts, EFFORT.own_passes) if starts else None
        return again if again is not None and again.point.value < found.point.value else found

    def _superfluous(self, order: Order, fits: dict[Order, Candidate]) -> bool:
        """Whether to put off an order that was never fitted: much larger than the best so far, which passes the
        gate.
        """
        if not self._young or not fits:
            return False
        best = min(fits.values(), key=lambda c: c.fit.bic)
        return sum(order) > sum(best.order) + EFFORT.patience and best.passes

    # ------------------------------------------------------------------ choice

    def _choose(self, likelihood: Likelihood, fits: dict[Order, Candidate], best: Candidate | None) -> ArmaModel:
        if best is None:
            return self._unsure(likelihood, fits)
        now = fits.get(self._chosen) if self._chosen is not None else None
        # one window in a hundred fails the gate by chance: that alone, without a lead by BIC, is no reason for a larger
        # order
        larger = now is not None and sum(best.order) > sum(now.order)
        held = now is not None and larger and now.fit.bic <= best.fit.bic + CHANNEL_CHOICE.lead
        stays = now is not None and (now.passes or (held and not now.cancels))
        if now is not None and now is not best and not self._young and stays:
            self._challenge = self._challenge.by(best.order)
            better = now.fit.bic - best.fit.bic > CHANNEL_CHOICE.lead or finds_more_low_frequency_power(best, now)
            if not better or self._challenge.leads < CHANNEL_CHOICE.hops:
                best = now
        if best is not now:
            self._challenge = Challenge()
        self._settle(best, fits)
        self._good = best.model(likelihood)
        return self._good

    def _settle(self, best: Candidate, fits: dict[Order, Candidate]) -> None:
        self._chosen = best.order
        for order, candidate in fits.items():
            self._gaps[order] = candidate.fit.bic - best.fit.bic

    def _unsure(self, likelihood: Likelihood, fits: dict[Order, Candidate]) -> ArmaModel:
        """Nothing passed: the last good model while it explains the window as well, else the best, else
        Gauss-Markov.
        """
        tidy = [candidate for candidate in fits.values() if not candidate.cancels]
        if tidy:
            best = min(tidy, key=lambda candidate: candidate.fit.bic)
            if (
                self._good is not None
                and _bic(self._good, likelihood, best.fit.n) <= best.fit.bic + CHANNEL_CHOICE.lead
            ):
                return replace(self._good, flags=self._good.flags | {"stale"})
            self._settle(best, fits)
            return _flagged(best.model(likelihood), "coloured")
        simple = [
            fit_candidate(likelihood, order, cold_starts(likelihood, *order), EFFORT.first_passes)
            for order in ((1, 0), (1, 1))
        ]
        found = [candidate for candidate in simple if candidate is not None]
        if not found:
            return self._without(likelihood.y / likelihood.unit, "fallback")
        return _flagged(min(found, key=lambda candidate: candidate.fit.bic).model(likelihood), "fallback")

    # ------------------------------------------------------------------ what changes

    @property
    def memory(self) -> LearnerMemory:
        """All that the learner knows; setting one goes on from it, to the last bit."""
        return LearnerMemory(
            thetas=dict(self._thetas),
            gaps=dict(self._gaps),
            chosen=self._chosen,
            challenge=self._challenge,
            turn=self._turn,
            coloured=self._coloured,
            young=self._young,
            good=self._good,
        )

    @memory.setter
    def memory(self, memory: LearnerMemory) -> None:
        for order, theta in memory.thetas.items():
            if order not in self.orders or theta.shape != (sum(order) + 1,):
                raise ValueError(
                    f"a learner of orders {self.orders} cannot go on from {theta.size} coefficients of order {order}."
                )
        self._thetas, self._gaps = dict(memory.thetas), dict(memory.gaps)
        self._chosen, self._challenge, self._good = memory.chosen, memory.challenge, memory.good
        self._turn, self._coloured, self._young = memory.turn, memory.coloured, memory.young


def memories(learners: Sequence[Learner | None]) -> tuple[LearnerMemory | None, ...]:
    """What the learners of a sensor's axes know; None where nothing is learnt."""
    return tuple(None if learner is None else learner.memory for learner in learners)


def recall(
    learners: Sequence[Learner | None], now: Sequence[LearnerMemory | None], then: Sequence[LearnerMemory | None]
) -> None:
    """Let learners that know `now` know `then`; those for which the two are one value stay as they are."""
    for learner, present, other in zip(learners, now, then, strict=True):
        if learner is not None and other is not None and other is not present:
            learner.memory = other


def _rescaled(theta: Array, likelihood: Likelihood) -> Array:
    """A kept estimate in the units of this window."""
    return np.r_[theta[:-1], theta[-1] + math.log(likelihood.unit)]


def _bic(model: ArmaModel, likelihood: Likelihood, n: int) -> float:
    """BIC of a model as it is, on this window."""
    theta = likelihood.confine(theta_of(model, likelihood), model.p)
    value = likelihood.value(theta, model.p) - n * math.log(likelihood.unit)
    return CHANNEL_CHOICE.score(2.0 * value, theta.size, n)


def _flagged(model: ArmaModel, flag: str) -> ArmaModel:
    return replace(model, flags=model.flags | {flag})

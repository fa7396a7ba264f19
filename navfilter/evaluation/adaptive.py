"""Adaptive rivals: filters of the literature that estimate the noise R of a sensor from its innovations.

They are baselines to compare with, and no part of the filter: the same mechanisation, calibration states and gate, but
each error is white noise, whose variance a rule sets anew after every reading that was used. A rule of one's own has
the two methods of `Rule`, and goes to `adaptive_monitor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.faults.monitor import FaultMonitor
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.models.error_models import ErrorModel, RandomWalk, Sum, White
from navfilter.models.vehicle import Vehicle

__all__ = ["RULES", "Imm", "InnovationAdaptive", "Rule", "SageHusa", "VariationalBayes", "adaptive_monitor", "as_white"]

Array = NDArray[np.float64]
#: R stays within these multiples of the R that is described [1].
FLOOR, CEILING = 0.1, 100.0


class Rule(Protocol):
    """What the white variance of a sensor's axes is, given their innovations so far."""

    def variance(self) -> Array:
        """For the next reading, shape (axes,)."""

    def update(self, innovation: Array, predicted: Array) -> None:
        """Take a reading that was used.

        Parameters
        ----------
        innovation : ndarray, shape (axes,)
            NaN where a component is missing.
        predicted : ndarray, shape (axes,)
            Diagonal of ``H P H'`` before the correction.
        """


class InnovationAdaptive:
    """``R = mean(innovation^2 - H P H')`` over a window (Mehra, 1970; Mohamed and Schwarz, 1999).

    Parameters
    ----------
    described : ndarray, shape (axes,)
    readings : int
        Of the window; until it is full the described R holds.
    """

    def __init__(self, described: Array, readings: int = 30) -> None:
        self._described, self._readings = described, readings
        self._window: list[Array] = []

    def variance(self) -> Array:
        """See `Rule`."""
        if len(self._window) < self._readings:
            return self._described
        window = np.array(self._window)
        known = np.isfinite(window).sum(axis=0)
        mean = np.nansum(window, axis=0) / np.maximum(known, 1)
        return _bounded(np.where(known > 0, mean, self._described), self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        self._window = [*self._window[1 - self._readings :], innovation**2 - predicted]


class SageHusa:
    """``R <- (1 - d) R + d (innovation^2 - H P H')``, ``d = (1 - b) / (1 - b^k)`` (Sage and Husa, 1969).

    Parameters
    ----------
    described : ndarray, shape (axes,)
    b : float
        Forgetting [1].
    """

    def __init__(self, described: Array, b: float = 0.97) -> None:
        self._described, self._b, self._k = described, b, 0
        self._R = described.copy()

    def variance(self) -> Array:
        """See `Rule`."""
        return _bounded(self._R, self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        self._k += 1
        # the described R counts as one reading, or the first innovation alone would set it
        d = (1.0 - self._b) / (1.0 - self._b ** (self._k + 1))
        new = (1.0 - d) * self.variance() + d * (innovation**2 - predicted)
        self._R = np.where(np.isfinite(new), new, self._R)


class VariationalBayes:
    """Inverse gamma density of R, forgotten by rho (Sarkka and Nummenmaa, 2009), with so many iterations a reading.

    The estimate of the state is that of the R before; its own iterations would need the reading to be taken anew.

    Parameters
    ----------
    described : ndarray, shape (axes,)
    rho : float
        Forgetting [1].
    iterations : int
    """

    def __init__(self, described: Array, rho: float = 0.97, iterations: int = 5) -> None:
        self._described, self._rho, self._iterations = described, rho, iterations
        self._alpha = np.full(described.shape, 1.0)
        self._beta = described.copy()

    def variance(self) -> Array:
        """See `Rule`."""
        return _bounded(self._beta / self._alpha, self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        alpha, prior = self._rho * self._alpha + 0.5, self._rho * self._beta
        beta = prior.copy()
        for _ in range(self._iterations):
            R = _bounded(np.where(beta > 0.0, beta, self._beta) / alpha, self._described)
            left = R / (predicted + R)  # of the innovation, and of H P H', once the reading has been taken
            beta = prior + 0.5 * ((left * innovation) ** 2 + left * predicted)
        known = np.isfinite(beta)
        self._alpha, self._beta = np.where(known, alpha, self._alpha), np.where(known, beta, self._beta)


class Imm:
    """Three levels of R in a Markov chain (Blom and Bar-Shalom, 1988), merged into one R by their probabilities.

    The states are not: one filter runs with the merged R (first-order generalised pseudo-Bayes).

    Parameters
    ----------
    described : ndarray, shape (axes,)
    levels : tuple of float
        Multiples of the described R [1].
    stay : float
        Probability of staying at a level from reading to reading [1].
    """

    def __init__(self, described: Array, levels: tuple[float, ...] = (1 / 9, 1.0, 9.0), stay: float = 0.98) -> None:
        self._levels, self._described = np.array(levels)[:, None] * described, described
        n = len(levels)
        self._chain = np.full((n, n), (1.0 - stay) / (n - 1)) + (stay - (1.0 - stay) / (n - 1)) * np.eye(n)
        self._odds = np.full((n, len(described)), 1.0 / n)

    def variance(self) -> Array:
        """See `Rule`."""
        return _bounded(np.sum(self._chain @ self._odds * self._levels, axis=0), self._described)

    def update(self, innovation: Array, predicted: Array) -> None:
        """See `Rule`."""
        S = predicted + self._levels
        weights = self._chain @ self._odds * np.exp(-0.5 * innovation**2 / S) / np.sqrt(S)
        total = weights.sum(axis=0)
        known = np.isfinite(total) & (total > 0.0)
        self._odds = np.where(known, weights / np.where(known, total, 1.0), self._odds)


#: Adaptive rivals by name.
RULES: dict[str, Callable[[Array], Rule]] = {
    "iae": InnovationAdaptive,
    "sage-husa": SageHusa,
    "vb": VariationalBayes,
    "imm": Imm,
}


def adaptive_monitor(
    vehicle: Vehicle, rule: Callable[[Array], Rule], sensors: Collection[str] | None = None
) -> FaultMonitor:
    """The monitor of a run whose sensors weigh their readings by a rule.

    Parameters
    ----------
    vehicle : Vehicle
        With white errors, see `as_white`.
    rule : callable
        Makes the rule of a sensor from the white variances of its axes as described, shape (axes,).
    sensors : collection of str, optional
        Which ones adapt; default all.
    """
    return _AdaptiveMonitor(vehicle, rule, tuple(vehicle.sensors if sensors is None else sensors))


class _AdaptiveMonitor(FaultMonitor):
    in_batches = False

    def __init__(self, vehicle: Vehicle, rule: Callable[[Array], Rule], sensors: Collection[str]) -> None:
        super().__init__(vehicle)
        self._rule, self._sensors, self._rules = rule, sensors, dict[str, Rule]()

    def gate(self, channel: Channel, z: Array, sd: ArrayLike | None, time_s: float) -> tuple[Array, Array]:
        limits, own = super().gate(channel, z, sd, time_s)
        if channel.name not in self._sensors:
            return limits, own
        if channel.name not in self._rules:
            self._rules[channel.name] = self._rule(np.array(channel.group.r))
        return limits, self._rules[channel.name].variance()

    def after_gate(self, filter: FilterState, channel: Channel, time_s: float, frozen: bool) -> Actions:
        a, R = channel.axes, channel.R.diagonal().copy()
        used, innovation, S = channel.verdict[2], channel.note[3 : 3 + a].copy(), channel.note[3 + a :][:a].copy()
        result: Any = yield from super().after_gate(filter, channel, time_s, frozen)
        if used and channel.name in self._rules:
            self._rules[channel.name].update(np.where(np.isfinite(S), innovation, np.nan), S - R)
        return result


def as_white(model: ErrorModel, period_s: float) -> ErrorModel:
    """White noise of the same variance; a random walk, which is the bias of a sensor, stays.

    Parameters
    ----------
    model : ErrorModel
        Of one axis.
    period_s : float
        Of its sensor [s].
    """
    parts = model.parts if isinstance(model, Sum) else (model,)
    walks = [part for part in parts if isinstance(part, RandomWalk)]
    blocks = [part.block(period_s) for part in parts if not isinstance(part, RandomWalk)]
    variance = sum(block.r + float(block.C @ block.P0 @ block.C) for block in blocks)
    if variance <= 0.0:
        return model
    white = White(sd=math.sqrt(variance))
    return Sum((*walks, white)) if walks else white


def _bounded(R: Array, described: Array) -> Array:
    return np.asarray(np.clip(R, FLOOR * described, CEILING * described))

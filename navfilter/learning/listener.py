"""Working memory of one correcting sensor, and what is listened to of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from navfilter.arma.model import ArmaModel
from navfilter.error_models import ErrorModel
from navfilter.filter.layout import Group, Layout
from navfilter.kernels import kalman, listen
from navfilter.learning.drift import Drift
from navfilter.learning.learned import (
    known_walk,
    known_white,
    learned_part,
    learning_part,
    slow_pole,
    with_learned,
    with_zero_frequency,
    zero_frequency,
)
from navfilter.sensors import Sensor
from navfilter.start import Start
from navfilter.vehicle import Vehicle

__all__ = ["Channel", "ChannelSeries", "Listener"]

Array = NDArray[np.float64]
#: A model whose S(0) is uncertain by more than this many powers of e is not adopted: the drift hides its low frequencies.
UNOBSERVABLE = 3.0
#: A sample so many robust deviations from its neighbours is a spike.
SPIKE = 8.0
#: S(0) is averaged over so many hops: two windows.
HOPS_REMEMBERED = 4
#: The newest readings are left out of what is learnt from, so that those that come late by as much change nothing [s].
GUARD_S = 2.0
#: A first try at learning needs so many ticks.
FEWEST = 200
NEVER = int(np.iinfo(np.int64).max)


class Channel:
    """Working memory of one correcting sensor: one array shared with the kernels, seen through views (``kalman.places``)."""

    def __init__(self, name: str, sensor: Sensor, group: Group, start: Start, layout: Layout, rate_variance: Array) -> None:
        a, n, m, par = sensor.axes, layout.size, layout.head, group.size - group.errors
        b = group.size if group.ticks else 0
        self.name, self.sensor, self.group = name, sensor, group
        self.kernel, self.constants = sensor.kernel, sensor.constants(start)
        self.period_s = 1.0 / sensor.rate_hz
        self.limits = np.array(_limits(sensor.gate_probability, a))
        self.dims = np.array([a, n, m, b, group.start, group.errors, par])
        at = kalman.places(self.dims)
        self.places = np.array(at)
        self.mem = mem = np.zeros(at[-1])
        self.res, self.near = mem[at[3] : at[3] + a], mem[at[7] : at[8]].reshape(a, 9 + par)
        self.H, self.PH, self.S = mem[at[0] : at[1]].reshape(a, n), mem[at[6] : at[7]].reshape(a, n), mem[at[5] : at[6]].reshape(2 * a, a)
        self.verdict, self.note = mem[at[8] : at[8] + 3], mem[at[8] : at[9]]
        self.record, self.moved = mem[: at[5]], mem[: at[0]]
        self.model, self.C, self.R = np.array([group.Phi[:b, :b], group.Q[:b, :b]]), group.C, np.diag(group.r)
        self.lever = sensor.lever_arm_covariance(rate_variance)
        self.white = self.R + self.lever
        first = group.start - 9
        self.parameters = slice(first + group.errors, first + group.size)
        self.turns = sensor.needs_rate
        self.last_s = self.ticked_s = -math.inf
        self.rejected_since_s = math.nan
        self.count = 0
        self.listener: Listener | None = None

    def ticks(self, time_s: float) -> int:
        """Periods of the sensor since it was last heard; 0 at the first reading."""
        elapsed, self.ticked_s = time_s - self.ticked_s, time_s
        self.count = 0 if math.isinf(elapsed) else max(1, round(elapsed / self.period_s))
        return self.count

    @property
    def clock(self) -> tuple[float, float, float]:
        """What it remembers beside its states: last reading, last tick, since when readings are rejected."""
        return self.last_s, self.ticked_s, self.rejected_since_s

    @clock.setter
    def clock(self, values: tuple[float, float, float]) -> None:
        self.last_s, self.ticked_s, self.rejected_since_s = values


@cache
def _limits(probability: float, axes: int) -> tuple[float, ...]:
    """Chi-square limits of the gate for 0 (never), 1, ... axes."""
    return (math.inf, *chi2.ppf(probability, np.arange(1, axes + 1)).tolist())


def usable(sd: ArrayLike, axes: int) -> bool:
    """Whether standard deviations given with a reading can be used; the variance of one beyond 1e100 would not be finite."""
    values = np.asarray(sd, dtype=np.float64)
    return values.size in (1, axes) and bool(np.all((values >= 0.0) & (values < 1e100)))


# ---------------------------------------------------------------- what is learnt from


@dataclass(frozen=True)
class ChannelSeries:
    """Readings of one axis minus what an open loop would have predicted.

    Attributes
    ----------
    value : ndarray, shape (n,)
        One element per tick of the sensor [unit of the sensor]; NaN where there was no reading.
    drift : Drift
        Known noise of the slow navigation error in it.
    period_s : float
    white : float
        Known white variance in it.
    """

    value: Array
    drift: Drift
    period_s: float
    white: float


class Listener:
    """Notes the open-loop residuals of one sensor, and learns its error models from them.

    The series is the reading minus the prediction of an open loop (the filter's own, with everything fed back taken off again), so that
    it holds the sensor's error whole, beside a navigation error that wanders by the known noise of the inertial unit. What the filter
    believes of the sensor does not enter: no feedback can bias it.

    Parameters
    ----------
    sensor : Sensor
    layout : Layout
    vehicle : Vehicle
    white : ndarray, shape (axes,)
        Known white variance beside the models: that of the lever arm.
    capacity : int, optional
        Ticks to keep; default: the window of the learnt models.
    """

    def __init__(self, name: str, sensor: Sensor, vehicle: Vehicle, white: Array, capacity: int | None = None) -> None:
        from navfilter.learning.learner import Learner

        self.kind = sensor.open_loop
        if self.kind == listen.NOTHING:
            raise ValueError(f'"{name}": a {type(sensor).__name__} has no readings to learn its error from. Give it a fixed error model.')
        self.name, self.period_s, self.models = name, 1.0 / sensor.rate_hz, sensor.models
        learned = [learning_part(model) for model in self.models]
        window = max((part.window for part in learned if part is not None), default=0)
        self.ring = np.full((sensor.axes, capacity or window + round(4 * sensor.rate_hz) + 64), np.nan)
        self.cursor = np.zeros(1, np.int64)
        self.mount = np.ascontiguousarray(sensor.instrument_axes()).ravel()
        self.drifts = tuple(sensor.drift(vehicle.drive, axis, known_walk(model)) for axis, model in enumerate(self.models))
        self.white = tuple(float(white[i]) + known_white(model, self.period_s) for i, model in enumerate(self.models))
        self.learners = tuple(
            None if part is None else Learner(part.orders, part.window, drift, white=r)
            for part, drift, r in zip(learned, self.drifts, self.white, strict=True)
        )
        self.window = window
        self.hop = min((part.hop or part.window // 2 for part in learned if part is not None), default=0)
        self.due = 0 if window else NEVER
        self._before_hop: tuple[int, tuple[Any, ...]] = (-1, ())
        self.levels: tuple[tuple[float, ...], ...] = ((),) * sensor.axes

    def series(self, axis: int, last: int | None = None, without: int = 0) -> Array:
        """The last ticks of one axis, oldest first, without the newest; isolated spikes are missing."""
        written, capacity = int(self.cursor[0]), self.ring.shape[1]
        n = min(written, capacity if last is None else last, capacity)
        return without_spikes(np.take(self.ring[axis], np.arange(written - n, written - without) % capacity))

    def all_series(self) -> tuple[ChannelSeries, ...]:
        """What was heard, axis by axis."""
        return tuple(
            ChannelSeries(self.series(axis), drift, self.period_s, white)
            for axis, (drift, white) in enumerate(zip(self.drifts, self.white, strict=True))
        )

    @property
    def learns(self) -> bool:
        """Whether there is something to learn, and enough was heard for a first try."""
        return self.window > 0 and int(self.cursor[0]) >= FEWEST

    def rewind(self) -> None:
        """Hear everything again from the start, without learning from it again."""
        self.due = int(self.cursor[0]) + self.hop if self.window else NEVER
        self.cursor[0] = 0
        self._before_hop = (-1, ())

    def mark(self) -> tuple[Any, ...]:
        """Where it stands, to `recall` within the few seconds that the ring keeps beyond its window."""
        return int(self.cursor[0]), self.due, self.models, self.levels

    def recall(self, mark: tuple[Any, ...]) -> None:
        """Go back to a `mark`: not further than one hop."""
        self.cursor[0], self.due, self.models, self.levels = mark
        hop, kept = self._before_hop
        if self.cursor[0] < hop:
            for learner, values in zip(self.learners, kept, strict=True):
                if learner is not None:
                    learner.restore(values)
            self._before_hop = (-1, ())

    def kept(self, mark: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """A `mark`, and what the learners knew then."""
        hop, kept = self._before_hop
        if mark[0] >= hop:
            kept = tuple(None if learner is None else learner.snapshot() for learner in self.learners)
        return mark, kept

    def revive(self, ring: Array, learners: Sequence[dict[str, Array]]) -> None:
        """Take over readings and learners of another run."""
        self.ring[:] = ring
        for learner, kept in zip(self.learners, learners, strict=True):
            if learner is not None:
                learner.restore(kept)

    def learn(self, behind_s: float) -> tuple[ErrorModel, ...] | None:
        """At a hop: the error models to adopt, or None when there is nothing new; the last reading is `behind_s` behind the present."""
        written = int(self.cursor[0])
        newest = min(max(0, round((GUARD_S - behind_s) / self.period_s)), written)
        kept = tuple(None if learner is None else learner.snapshot() for learner in self.learners)
        self._before_hop = (written, kept)
        self.due = written + self.hop
        new, levels = [], list(self.levels)
        for axis, (model, learner) in enumerate(zip(self.models, self.learners, strict=True)):
            part = learned_part(model)
            if part is not None and learner is not None:
                found = learner.hop(self.series(axis, part.window + newest, newest))
                known = "starting" not in found.flags and (found.sd_log_s0 or 0.0) <= UNOBSERVABLE
                if known and found.is_stable and found.is_invertible:
                    levels[axis] = (*levels[axis], zero_frequency(found))[-HOPS_REMEMBERED:]
                    found = steadied(found, levels[axis])
                    model = with_learned(model, replace(part, model=found))
            new.append(model)
        self.levels = tuple(levels)
        if tuple(new) == self.models:
            return None
        self.models = tuple(new)
        return self.models


def without_spikes(series: Array) -> Array:
    """A copy with NaN where a sample stands out from the median of the five around it by more than `SPIKE` robust deviations.

    The filter's gate cannot do this: it judges by what is believed of the sensor, which is what is to be learnt.
    """
    result = np.array(series, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(result))
    if known.size < 5:
        return result
    # the drift may run away by metres per tick: most of it is a low polynomial
    place = known / max(float(known[-1]), 1.0) * 2.0 - 1.0
    y = result[known]
    y = y - np.polynomial.chebyshev.chebval(place, np.polynomial.chebyshev.chebfit(place, y, 5))
    padded = np.concatenate([y[[2, 1]], y, y[[-2, -3]]])
    off = y - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    size = np.abs(off)
    # where most samples equal their median (quantised readings), the mean of the others says how much is ordinary
    scale = max(float(np.median(size)) * 1.4826, float(np.mean(np.minimum(size, np.quantile(size, 0.99)))))
    result[known[size > SPIKE * scale]] = np.nan
    return result


def steadied(model: ArmaModel, levels: Sequence[float]) -> ArmaModel:
    """The model with S(0) at the mean of what the last windows found, and sd ln S(0) accordingly smaller.

    One window holds few correlation times of a slow error: its S(0) swings by a factor, and the low ones claim to be sure. Windows
    overlap by half, so n of them are worth (n + 1) / 2.
    """
    if slow_pole(model) is None or not levels[-1] > 0.0:
        return model
    factor = float(np.mean(levels)) / levels[-1]
    ar, variance = with_zero_frequency(model, factor)
    spread = None if model.sd_log_s0 is None else model.sd_log_s0 / math.sqrt((len(levels) + 1) / 2.0)
    return replace(model, ar=ar, sd=math.sqrt(variance), sd_log_s0=spread)

"""What is learnt of an inertial unit while it stands still: there its readings are its error, but for constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.error_models import ErrorModel, RandomWalk, Sum
from navfilter.learning.learned import known_walk, known_white, learned_part, learning_part, with_learned, zero_frequency
from navfilter.learning.listener import HOPS_REMEMBERED, steadied
from navfilter.mechanisation import Imu, Mechanisation
from navfilter.sensors import ZeroVelocity

if TYPE_CHECKING:
    from navfilter.learning.drift import Drift

__all__ = ["Stillness", "hand_over"]

Array = NDArray[np.float64]

#: A quiet axis scatters less than so many of its believed standard deviations, and its mean stays within as many.
QUIET = 3.0
#: What is surely no rest: speed [m/s], mean rate [rad/s], each beyond three standard deviations of what is known of it.
SLOWEST, STEADIEST = 0.05, 0.02
#: A velocity that is known no better than this [m/s] says nothing.
UNKNOWN = 0.2
#: So many blocks at rest in a row count, but for the first and the last.
RUN = 3
#: More missing ticks than this end a segment; so many and one more separate two of them (see `navfilter.kernels.channel`).
LONGEST_GAP = 8
#: Without a hop of its own a unit is looked at first when half a window is full, then whenever there is half as much again, and at least
#: once in so many windows.
LAZIEST = 10
#: Poles nearer to 1 than these parts of the series are the bias (with what the learner's own limit is short of 3), and may be the bias.
SAME, CYCLES = 3.03, 10.0
PARTS = {"gyro": slice(0, 3), "accel": slice(3, 6)}


class Stillness:
    """Gathers the samples of an inertial unit at rest, and learns the error models of its axes from them.

    At rest a gyro reads the Earth's rate and its error, an accelerometer gravity and its error. Earth's rate and gravity are constant in
    the axes of a vehicle that does not move, and disappear in the diffuse start of the bias. Nothing of the filter's state enters the
    series, so no feedback can bias what is learnt. The filter's velocity only serves to refuse samples.

    Rest is judged by blocks of about one second: the velocity is known and not surely above `SLOWEST`, every axis scatters less than
    `QUIET` believed standard deviations, its mean stays, and no mean rate (less the estimated gyro error) is surely above `STEADIEST`. A
    block counts between two others that are at rest too. The velocity has to be known, by a DVL, fixes or `ZeroVelocity`, because an AUV
    that glides through calm water cannot be told from one at rest by a micromechanical unit (simulated: its slow turns, taken for noise,
    raise S(0) by factors of 40 to 2000). What remains possible: a vehicle that sways at its mooring by less than these limits. That makes
    the model larger than the unit's own error, not smaller.

    Parameters
    ----------
    drive : Imu
        As its operator describes it.

    Notes
    -----
    Segments of rest follow each other in one series with gaps between them; a gap begins the bias and the error anew.
    """

    def __init__(self, drive: Mechanisation) -> None:
        from navfilter.learning.drift import Drift
        from navfilter.learning.learner import Learner

        assert isinstance(drive, Imu)
        self.period_s, self.models = drive.period_s, drive.models
        self._unit = 1.0 / drive.period_s if drive.increments else 1.0
        self.length = max(2, round(drive.rate_hz))
        self.limits = _limits(drive)
        parts = [learning_part(model) for model in self.models]
        self.window = max(part.window for part in parts if part is not None)
        given = [part.hop for part in parts if part is not None and part.hop is not None]
        # a late reading may take the run back over one hop, not two
        self.hop = max(4 * self.length, min(given, default=self.window // 4))
        self._longest_hop = self.hop if given else max(self.hop, LAZIEST * self.window)
        self._drifts = tuple(Drift((max(known_walk(model), 1e-12),), self.period_s) for model in self.models)
        self._white = tuple(known_white(model, self.period_s) for model in self.models)
        self._described = self.models
        self.learners = tuple(
            None if part is None else Learner(part.orders, part.window, drift, white=white)
            for part, drift, white in zip(parts, self._drifts, self._white, strict=True)
        )
        self.ring = np.full((6, self.window + 8 * self.length + 64), np.nan)
        self.block, self.pending = np.zeros((self.length, 7)), np.zeros((self.length, 7))
        self.filled = self.run = self.cursor = self._newest = 0
        self._open, self.level = False, np.zeros(6)  # a segment, and its mean
        self.due = self.hop if given else max(self.hop, self.window // 2)
        self._before_hop: tuple[int, tuple[Any, ...]] = (-1, ())
        self.levels: tuple[tuple[float, ...], ...] = ((),) * 6

    @property
    def room(self) -> int:
        """Samples until the block is full."""
        return self.length - self.filled

    def note(self, samples: Array) -> None:
        """Take up to `room` samples: rows of the seconds since the sample before, and the six values."""
        self.block[self.filled : self.filled + len(samples)] = samples
        self.filled += len(samples)

    def close(self, speed: Array, rate: Array) -> bool:
        """Judge a full block; True when there is enough new for a hop.

        Parameters
        ----------
        speed, rate : ndarray, shape (2, 3)
            Velocity [m/s] and error of the gyros [rad/s] as estimated, each above its standard deviation.
        """
        self.filled = 0
        if not self._quiet(speed, rate):
            self.run, self._open = 0, False
            return False
        mean = self.block[:, 1:].mean(axis=0) * self._unit
        if not self.run or np.any(np.abs(mean - self.level) > self.limits):
            self.run, self._open, self.level = 0, False, mean
        self.run += 1
        if self.run >= RUN:
            self._keep(self.pending)
        self.pending, self.block = self.block, self.pending
        return self.cursor >= self.due

    def _quiet(self, speed: Array, rate: Array) -> bool:
        if np.any(speed[1] > UNKNOWN) or np.any(np.abs(speed[0]) > SLOWEST + 3.0 * speed[1]):
            return False
        if np.max(self.block[:, 0]) > (LONGEST_GAP + 0.5) * self.period_s:
            return False
        values = self.block[:, 1:] * self._unit
        if np.any(values.std(axis=0) > self.limits):
            return False
        return bool(np.all(np.abs(values[:, :3].mean(axis=0) - rate[0]) < STEADIEST + 3.0 * rate[1]))

    def _keep(self, block: Array) -> None:
        """Append a block to the series, on a grid of whole periods."""
        count = np.arange(len(block))
        ticks = np.rint(np.cumsum(block[:, 0]) / self.period_s).astype(np.int64)
        # stamps may come in bursts: later samples give way, so that none is lost
        places = np.maximum.accumulate(ticks - count) + count
        if not self._open and self.cursor:
            self._write(np.full((LONGEST_GAP + 1, 6), np.nan))
        self._open = True
        first = max(1, int(places[0]))
        values = np.full((int(places[-1] - places[0]) + first, 6), np.nan)
        values[places - places[0] + first - 1] = block[:, 1:] * self._unit
        self._write(values)
        self._newest = len(values)

    def _write(self, values: Array) -> None:
        capacity = self.ring.shape[1]
        values = values[-capacity:]
        self.ring[:, np.arange(self.cursor, self.cursor + len(values)) % capacity] = values.T
        self.cursor += len(values)

    def series(self, axis: int, window: int, without: int = 0) -> Array:
        """The last ticks at rest of one axis [rad/s or m/s^2], oldest first, without the newest; NaN between segments."""
        n = min(self.cursor, window + without, self.ring.shape[1])
        return np.ascontiguousarray(self.ring[axis, np.arange(self.cursor - n, self.cursor - without) % self.ring.shape[1]])

    def learn(self) -> dict[str, tuple[ErrorModel, ...]]:
        """At a hop: the error models to adopt by name, ``gyro`` and ``accel``; only those that are new."""
        kept = tuple(None if learner is None else learner.snapshot() for learner in self.learners)
        self._before_hop = (self.cursor, kept)
        self.due = self.cursor + min(max(self.hop, self.cursor // 2), self._longest_hop)
        new, levels = list(self.models), list(self.levels)
        for axis, learner in enumerate(self.learners):
            part = learning_part(self.models[axis])
            if part is None or learner is None:
                continue
            # the newest block may still change by a reading that comes late
            y = self.series(axis, part.window, self._newest)
            found = learner.hop(y)
            if "starting" in found.flags or not (found.is_stable and found.is_invertible):
                continue
            drift, white, model = self._drifts[axis], self._white[axis], self._described[axis]
            found = plainer(found, y, drift, white)
            if known_walk(model):
                found, model = hand_over(found, model, y, drift, white)
                found = plainer(found, y, replace(drift, density=(known_walk(model),)), white)
            levels[axis] = (*levels[axis], zero_frequency(found))[-HOPS_REMEMBERED:]
            new[axis] = with_learned(model, replace(part, model=steadied(found, levels[axis])))
        before, self.models, self.levels = self.models, tuple(new), tuple(levels)
        return {name: self.models[axes] for name, axes in PARTS.items() if self.models[axes] != before[axes]}

    # ---------------------------------------------------------------- keep and bring back
    def rewind(self) -> None:
        """Gather everything again from the start, without learning from it again."""
        self.due = self.cursor + self.hop
        self.filled = self.run = self.cursor = self._newest = 0
        self._open = False
        self._before_hop = (-1, ())

    def mark(self) -> tuple[Any, ...]:
        """Where it stands, to `recall` within the few seconds that the ring keeps beyond its window."""
        numbers = (self.cursor, self.filled, self.run, self.due, self._newest, int(self._open))
        return numbers, self.models, self.levels, self.level.copy(), self.block.copy(), self.pending.copy()

    def recall(self, mark: tuple[Any, ...]) -> None:
        """Go back to a `mark`: not further than one hop."""
        numbers, self.models, self.levels, level, block, pending = mark
        self.cursor, self.filled, self.run, self.due, self._newest, segment = numbers
        self._open = bool(segment)
        self.level, self.block, self.pending = level.copy(), block.copy(), pending.copy()
        hop, kept = self._before_hop
        if self.due <= hop:
            for learner, values in zip(self.learners, kept, strict=True):
                if learner is not None:
                    learner.restore(values)
            self._before_hop = (-1, ())

    def kept(self, mark: tuple[Any, ...]) -> tuple[Any, ...]:
        """What the learners knew at a `mark`."""
        hop, kept = self._before_hop
        if mark[0][3] <= hop:
            return kept
        return tuple(None if learner is None else learner.snapshot() for learner in self.learners)

    def revive(self, ring: Array, learners: Sequence[dict[str, Array]]) -> None:
        """Take over samples and learners of another run."""
        self.ring[:] = ring
        for learner, kept in zip(self.learners, learners, strict=True):
            if learner is not None:
                learner.restore(kept)


def _limits(drive: Imu) -> Array:
    """Largest standard deviations of the six axes in a block at rest; where nothing is said of an axis, those of `ZeroVelocity`."""
    rest, limits = ZeroVelocity(), np.empty(6)
    given = [*_each(drive.gyro), *_each(drive.accel)]
    for axis, (model, said) in enumerate(zip(drive.models, given, strict=True)):
        parts = model.parts if isinstance(model, Sum) else (model,)
        blocks = [part.block(drive.period_s) for part in parts if not isinstance(part, RandomWalk)]
        limits[axis] = QUIET * np.sqrt(sum(float(b.r + b.C @ b.P0 @ b.C) for b in blocks))
        learned = learned_part(said)
        if learned is not None and said == learned and learned.prior is None and learned.model is None:
            limits[axis] = max(limits[axis], rest.gyro_sd_max if axis < 3 else rest.force_sd_max)
    return limits


def _each(errors: ErrorModel | tuple[ErrorModel, ...]) -> tuple[ErrorModel, ...]:
    return (errors,) * 3 if isinstance(errors, ErrorModel) else tuple(errors)


def plainer(found: ArmaModel, series: Array, drift: Drift, white: float) -> ArmaModel:
    """White noise in place of a learnt model that is no better by BIC.

    States of an inertial axis cost at every sample. A learner takes a larger order where white noise fails a test of whiteness, which
    one window in a hundred does by chance.

    Parameters
    ----------
    found : ArmaModel
    series : ndarray, shape (n,)
        What it was learnt from.
    drift : Drift
        The known random walk.
    white : float
        Known white variance.

    Returns
    -------
    ArmaModel
    """
    from navfilter.learning.fit import fit_channel

    if found.p + found.q == 0:
        return found
    own = fit_channel(series, drift, found.p, found.q, white=white, start=found, passes=0)
    plain = fit_channel(series, drift, 0, 0, white=white)
    return plain.model if plain.bic <= own.bic else found


def hand_over(found: ArmaModel, model: ErrorModel, series: Array, drift: Drift, white: float) -> tuple[ArmaModel, ErrorModel]:
    """Give poles that the window cannot tell from a bias to the random walk beside the learnt part.

    A pole nearer to 1 than three parts of the window and the bias of the same axis are one state: two would be adopted for what is one.
    One that forgets more slowly than in a tenth of the window may be: then the likelihood decides, and BIC, which has less to pay for a
    walk. The white noise that drives the pole's part of the process (partial fractions of the spectrum) is added to that of the random
    walk, and what is left is fitted with one pole and one zero less.

    Parameters
    ----------
    found : ArmaModel
        What was learnt.
    model : ErrorModel
        Of the axis, with at least one `RandomWalk`.
    series : ndarray, shape (n,)
        What it was learnt from.
    drift : Drift
        The known random walk.
    white : float
        Known white variance.

    Returns
    -------
    ArmaModel, ErrorModel
        Without such poles, and the model with the random walk that has taken them over.
    """
    from navfilter.learning.drift import Drift
    from navfilter.learning.fit import fit_channel

    known, period_s = drift.density[0], drift.period_s
    n = int(np.isfinite(series).sum())
    while (slow := _slow_pole(found, n)) is not None:
        wider = float(np.hypot(known, np.sqrt(max(_driving_variance(found, slow), 0.0) / period_s)))
        less = fit_channel(series, Drift((wider,), period_s), found.p - 1, max(found.q - 1, 0), white=white)
        if slow < 1.0 - SAME / n:
            own = fit_channel(series, Drift((known,), period_s), found.p, found.q, white=white, start=found, passes=0)
            if less.bic + np.log(n) > own.bic:
                break
        known, found = wider, less.model
    if known == drift.density[0]:
        return found, model
    parts = model.parts if isinstance(model, Sum) else (model,)
    first = next(part for part in parts if isinstance(part, RandomWalk))
    start = float(np.sqrt(first.block(period_s).P0[0, 0]))
    others = known_walk(model) ** 2 - first.density**2
    walk = RandomWalk(density=float(np.sqrt(max(known**2 - others, first.density**2))), start_sd=start)
    return found, Sum(tuple(walk if part is first else part for part in parts))


def _slow_pole(model: ArmaModel, n: int) -> float | None:
    """The slowest real pole, if n samples may not tell it from a bias."""
    poles = model.poles
    near = poles[(np.abs(poles) > 1.0 - CYCLES / n) & (np.abs(np.angle(poles)) < SAME / n)]
    return float(np.max(np.abs(near))) if near.size else None


def _driving_variance(model: ArmaModel, pole: float) -> float:
    """Variance of the white noise that drives the part of a process with this real pole."""
    others = np.delete(model.poles, np.argmin(np.abs(model.poles - pole)))
    rest = np.atleast_1d(np.poly(others)).real

    def at(c: Array, z: float) -> float:
        return float(np.sum(c * z ** np.arange(len(c))))

    ma = np.r_[1.0, model.ma]
    return model.sd**2 * at(ma, pole) * at(ma, 1.0 / pole) / (at(rest, pole) * at(rest, 1.0 / pole))

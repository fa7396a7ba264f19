"""What is learnt of an inertial unit while it stands still: there its readings are its error, but for constants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.filter.monitor import FilterState
from navfilter.foundation.arrays import Array
from navfilter.learning.arma_fit import fit_channel
from navfilter.learning.axis_learner import Learner, LearnerMemory, memories, recall
from navfilter.learning.learned_model import learnt_from, with_learnt
from navfilter.learning.slow_prior import believed, described_blocks
from navfilter.models.error_models import ErrorModel, RandomWalk, per_axis, sum_of
from navfilter.models.learned_arma import known_walk, known_white, learned_part, learning_part
from navfilter.models.mechanisation import Imu, Mechanisation
from navfilter.models.navigation_drift import Drift
from navfilter.models.sensors import ZeroVelocity
from navfilter.models.window_limits import LONGEST_GAP
from navfilter.timeseries.model import ArmaModel

#: A quiet axis scatters less than so many of its believed standard deviations, and its mean stays within as many.
QUIET = 3.0
#: What is surely no rest: speed [m/s], mean rate [rad/s], each beyond three standard deviations of what is known of it.
SLOWEST, STEADIEST = 0.05, 0.02
#: A velocity that is known no better than this [m/s] says nothing.
UNKNOWN = 0.2
#: So many blocks at rest in a row count, but for the first and the last.
RUN = 3
#: Without a hop of its own a unit is looked at first when half a window is full, then whenever there is half as much
#: again, and at least once in so many windows.
LAZIEST = 10
#: A process that a series holds fewer times than this, by its time constant, may be its bias.
CYCLES = 10.0
#: Poles nearer to 1 than these parts of the series are the bias, with what the learner's own limit is short of 3.
#: Beyond `CYCLES` parts they may be.
SAME = 3.03
PARTS = {"gyro": slice(0, 3), "accel": slice(3, 6)}


@dataclass
class RestMemory:
    """What is remembered of the samples at rest.

    Attributes
    ----------
    ring : ndarray, shape (6, capacity)
        Samples at rest [rad/s, m/s^2]; the tick with number k stands at ``k % capacity``, NaN between segments.
    cursor, due, newest : int
        Ticks kept so far, how many make the next hop due, and how many came with the newest block.
    block, pending : ndarray, shape (length, 7)
        The block that is being filled, and the one before it: seconds since the sample before, six values as they
        arrived.
    filled, run : int
        Samples in the block, and blocks at rest in a row.
    is_open : bool
        Whether the segment goes on.
    level : ndarray, shape (6,)
        Mean of the segment's first block [rad/s, m/s^2].
    heard : int
        Ticks that have been learnt from.
    models, learners
        As in `navfilter.learning.open_loop_series.OpenLoopMemory`, for the six axes.
    """

    SHARED: ClassVar = ("ring",)

    ring: Array
    cursor: int
    due: int
    newest: int
    block: Array
    pending: Array
    filled: int
    run: int
    is_open: bool
    level: Array
    heard: int
    models: tuple[ErrorModel, ...]
    learners: tuple[LearnerMemory | None, ...]


class RestRecorder:
    """Gathers the samples of an inertial unit at rest, and learns the error models of its axes from them.

    At rest a gyro reads the Earth's rate and its error, an accelerometer gravity and its error. Earth's rate and
    gravity are constant in the axes of a vehicle that does not move, and disappear in the diffuse start of the bias.
    Nothing of the filter's state enters the series, so no feedback can bias what is learnt. The filter's velocity only
    serves to refuse samples.

    Rest is judged by blocks of about one second: the velocity is known and not surely above `SLOWEST`, every axis
    scatters less than `QUIET` believed standard deviations, its mean stays, and no mean rate is surely above
    `STEADIEST` both as read and less the estimated error of the gyro. A block counts between two others that are at
    rest too. The velocity has to be known, by a DVL, fixes or `ZeroVelocity`, because an AUV that glides through calm
    water cannot be told from one at rest by a micromechanical unit (simulated: its slow turns, taken for noise, raise
    S(0) by factors of 40 to 2000). What remains possible: a vehicle that sways at its mooring by less than these
    limits. That makes the model larger than the unit's own error, not smaller.

    Parameters
    ----------
    drive : Imu
        As its operator describes it.
    behind_s : float
        The filter may go back by so much [s].

    Notes
    -----
    Segments of rest follow each other in one series with gaps between them; a gap begins the bias and the error anew.
    """

    def __init__(self, drive: Mechanisation, behind_s: float) -> None:
        assert isinstance(drive, Imu)
        self.period_s = drive.period_s
        self._unit = 1.0 / drive.period_s if drive.increments else 1.0
        self.length = max(2, round(drive.rate_hz))
        self.limits = _limits(drive)
        parts = [learning_part(model) for model in drive.models]
        self.window = max(part.window for part in parts if part is not None)
        given = [part.hop for part in parts if part is not None and part.hop is not None]
        self.hop = max(4 * self.length, min(given, default=self.window // 4))
        self._longest_hop = self.hop if given else max(self.hop, LAZIEST * self.window)
        self._drifts = tuple(Drift((max(known_walk(model), 1e-12),), self.period_s) for model in drive.models)
        self._white = tuple(known_white(model, self.period_s) for model in drive.models)
        self._described = drive.models
        self.learners = tuple(
            None
            if part is None
            else Learner(part.orders, part.window, drift, white=white, prior=believed(part, self.period_s))
            for part, drift, white in zip(parts, self._drifts, self._white, strict=True)
        )
        # beyond the window: what going back writes over, and a few blocks
        capacity = self.window + (4 + math.ceil(2.0 * behind_s)) * self.length + 64
        self._memory = RestMemory(
            ring=np.full((6, capacity), np.nan),
            cursor=0,
            due=self.hop if given else max(self.hop, self.window // 2),
            newest=0,
            block=np.zeros((self.length, 7)),
            pending=np.zeros((self.length, 7)),
            filled=0,
            run=0,
            is_open=False,
            level=np.zeros(6),
            heard=0,
            models=drive.models,
            learners=memories(self.learners),
        )

    @property
    def memory(self) -> RestMemory:
        """All that changes; setting one goes back (or on) to it."""
        return self._memory

    @memory.setter
    def memory(self, memory: RestMemory) -> None:
        if not 0 <= memory.filled <= self.length:
            raise ValueError(f"a block at rest holds 0 to {self.length} samples, found {memory.filled}.")
        recall(self.learners, self._memory.learners, memory.learners)
        self._memory = memory

    def begin_again(self) -> None:
        """Gather everything again from the start; what has been learnt from is not due again."""
        memory = self._memory
        memory.filled = memory.run = memory.cursor = memory.newest = 0
        memory.is_open = False

    @property
    def room(self) -> int:
        """Samples until the block is full."""
        return self.length - self._memory.filled

    def note(self, samples: Array) -> None:
        """Take up to `room` samples: rows of the seconds since the sample before, and the six values."""
        memory = self._memory
        memory.block[memory.filled : memory.filled + len(samples)] = samples
        memory.filled += len(samples)

    def close(self, speed: Array, rate: Array) -> bool:
        """Judge a full block; True when there is enough new for a hop.

        Parameters
        ----------
        speed, rate : ndarray, shape (2, 3)
            Velocity [m/s] and error of the gyros [rad/s] as estimated, each above its standard deviation.
        """
        memory = self._memory
        memory.filled = 0
        if not self._quiet(speed, rate):
            memory.run, memory.is_open = 0, False
            return False
        mean = memory.block[:, 1:].mean(axis=0) * self._unit
        if not memory.run or np.any(np.abs(mean - memory.level) > self.limits):
            memory.run, memory.is_open, memory.level = 0, False, mean
        memory.run += 1
        if memory.run >= RUN:
            self._keep(memory.pending)
        memory.pending, memory.block = memory.block, memory.pending
        return memory.cursor >= memory.due

    def _quiet(self, speed: Array, rate: Array) -> bool:
        memory = self._memory
        if np.any(speed[1] > UNKNOWN) or np.any(np.abs(speed[0]) > SLOWEST + 3.0 * speed[1]):
            return False
        if np.max(memory.block[:, 0]) > (LONGEST_GAP + 0.5) * self.period_s:
            return False
        values = memory.block[:, 1:] * self._unit
        if not np.all(values.std(axis=0) <= self.limits):  # nor where samples are missing
            return False
        # where nothing tells the heading, what is estimated of a gyro may be anything: it excuses, and accuses nobody
        mean = values[:, :3].mean(axis=0)
        return bool(np.all(np.minimum(np.abs(mean), np.abs(mean - rate[0])) < STEADIEST + 3.0 * rate[1]))

    def _keep(self, block: Array) -> None:
        """Append a block to the series, on a grid of whole periods."""
        memory = self._memory
        count = np.arange(len(block))
        ticks = np.rint(np.cumsum(block[:, 0]) / self.period_s).astype(np.int64)
        # stamps may come in bursts: later samples give way, so that none is lost
        places = np.maximum.accumulate(ticks - count) + count
        if not memory.is_open and memory.cursor:
            self._write(np.full((LONGEST_GAP + 1, 6), np.nan))
        memory.is_open = True
        first = max(1, int(places[0]))
        values = np.full((int(places[-1] - places[0]) + first, 6), np.nan)
        values[places - places[0] + first - 1] = block[:, 1:] * self._unit
        self._write(values)
        memory.newest = len(values)

    def _write(self, values: Array) -> None:
        memory = self._memory
        capacity = memory.ring.shape[1]
        values = values[-capacity:]
        memory.ring[:, np.arange(memory.cursor, memory.cursor + len(values)) % capacity] = values.T
        memory.cursor += len(values)

    def series(self, axis: int, window: int, without: int = 0) -> Array:
        """The last ticks at rest of one axis [rad/s or m/s^2], oldest first, without the newest; NaN between
        segments.
        """
        memory = self._memory
        n = min(memory.cursor, window + without, memory.ring.shape[1])
        return np.ascontiguousarray(
            memory.ring[axis, np.arange(memory.cursor - n, memory.cursor - without) % memory.ring.shape[1]]
        )

    def learn(self) -> dict[str, tuple[ErrorModel, ...]]:
        """At a hop: the error models to adopt by name, ``gyro`` and ``accel``; only those that are new."""
        memory = self._memory
        memory.due = memory.cursor + min(max(self.hop, memory.cursor // 2), self._longest_hop)
        # the newest block may still change by a reading that comes late
        fresh, memory.heard = memory.cursor - memory.newest - memory.heard, memory.cursor - memory.newest
        new = list(memory.models)
        for axis, learner in enumerate(self.learners):
            part = learning_part(memory.models[axis])
            if part is None or learner is None:
                continue
            y = self.series(axis, part.window, memory.newest)
            if (fit := learner.look(y, fresh)) is None:
                continue
            # states of an inertial axis cost at every sample: of two hypotheses the likelier one alone
            likelier = max(fit[1], key=lambda one: one.weight)._replace(weight=1.0)
            found, _ = learnt_from(fit[0], [likelier])
            drift, white, model = self._drifts[axis], self._white[axis], self._described[axis]
            fast = found.model
            if not found.slow and known_walk(model):
                fast, model = hand_over(fast, model, y, drift, white)
            new[axis] = with_learnt(model, found._replace(model=fast))
        before, memory.models = memory.models, tuple(new)
        memory.learners = memories(self.learners)
        return {name: memory.models[axes] for name, axes in PARTS.items() if memory.models[axes] != before[axes]}


def estimates(filter: FilterState) -> tuple[Array, Array]:
    """Velocity and error of the gyros, each above its standard deviation, shape (2, 3), as of the last time the
    covariance moved.
    """
    C, P, m = filter.drive_output[:3, :-1], filter.P, filter.layout.head
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", C, P[9:m, 9:m], C), 0.0))
    speed = np.sqrt(np.maximum(P[range(3, 6), range(3, 6)], 0.0))
    return np.array([filter.nav[3:6], speed]), np.array([C @ filter.x[: m - 9], spread])


def _limits(drive: Imu) -> Array:
    """Largest standard deviations of the six axes in a block at rest; where nothing is said of an axis, those of
    `ZeroVelocity`.
    """
    rest, limits = ZeroVelocity(), np.empty(6)
    given = *per_axis(drive.gyro, 3, "gyro"), *per_axis(drive.accel, 3, "accel")
    for axis, (model, said) in enumerate(zip(drive.models, given, strict=True)):
        limits[axis] = QUIET * np.sqrt(sum(block.variance for block in described_blocks(model, drive.period_s)))
        learned = learned_part(said)
        if learned is not None and said == learned and learned.prior is None and learned.model is None:
            limits[axis] = max(limits[axis], rest.gyro_sd_max if axis < 3 else rest.force_sd_max)
    return limits


def hand_over(
    found: ArmaModel, model: ErrorModel, series: Array, drift: Drift, white: float
) -> tuple[ArmaModel, ErrorModel]:
    """Give poles that the window cannot tell from a bias to the random walk beside the learnt part.

    A pole nearer to 1 than three parts of the window and the bias of the same axis are one state: two would be adopted
    for what is one. One that forgets more slowly than in a tenth of the window may be: then the likelihood decides, and
    BIC, which has less to pay for a walk. The white noise that drives the pole's part of the process (partial fractions
    of the spectrum) is added to that of the random walk, and what is left is fitted with one pole and one zero less.

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
    first = next(part for part in model.terms if isinstance(part, RandomWalk))
    start = float(np.sqrt(first.block(period_s).P0[0, 0]))
    others = known_walk(model) ** 2 - first.density**2
    walk = RandomWalk(density=float(np.sqrt(max(known**2 - others, first.density**2))), start_sd=start)
    return found, sum_of([walk if part is first else part for part in model.terms])


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

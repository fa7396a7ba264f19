"""Which of several lanes is believed: they are compared by how well they foretell the readings of the same sensors.

A lane says what a reading should be, and how surely: a normal density. Its gain from one component of a reading is the
logarithm of that density over the one that an outlier has, whatever its size: ``log(1 + k p / flat)``. This is the
logarithmic score of a density that is `OUTLIERS` flat, less a constant that all lanes share. So a lane cannot win by
saying little (with a large covariance), nor lose by one outlier that nobody foretold; one that says nothing at all
(silent, or no number) gains nothing. Sums over the last minute, or over any later part of it, are compared: their
difference is the logarithm of the ratio of likelihoods (Gneiting and Raftery, 2007; Page, 1954).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.models.mechanisation import Imu
from navfilter.models.sensors import Sensor

Array = NDArray[np.float64]
STEPS = round(settings.WINDOW_S / settings.LANE_STEP_S)
RATIO = (1.0 - settings.OUTLIERS) / settings.OUTLIERS * settings.SPAN / math.sqrt(2.0 * math.pi)
#: What a component gains at most that has been foretold as surely as its sensor errs.
FULL = math.log1p(RATIO)
#: A lane that has begun anew is not taken before so many seconds [s]: what was wrong shows within the window.
PROBATION_S = settings.WINDOW_S
#: One in so many comparisons is kept for a report: one a second.
HISTORY = round(1.0 / settings.LANE_STEP_S)
#: A NIS counts at most so much [1]: its exponential is zero long before.
LARGE = 1400.0
#: Columns of what is gathered: gain, what was to be gained more, components judged, their NIS.
GAIN, SHORT, JUDGED, NIS = 0, 1, 2, 3
#: Of a velocity and a lane: since when and until when it contradicts it [s], the largest change from reading to reading
#: [m/s]; then by how much at first, and at last [m/s].
SINCE, UNTIL, LARGEST, FIRST = 0, 1, 2, 3


@dataclass
class LaneChoiceMemory:
    """All that changes.

    Attributes
    ----------
    lane : int
        In force.
    step : int
        Number of the last comparison: they come at multiples of `STEP_S` of mission time.
    gathered : ndarray, shape (lanes, sensors, 4)
        Since then: gain, what was to be gained more, components judged, the sum of their NIS.
    ring : ndarray, shape (steps, lanes, sensors, 4)
        The same of the last minute.
    begun : ndarray, shape (lanes,)
        Step at which each lane has begun anew; minus infinity: with the run.
    doubted : ndarray, shape (lanes,)
        1: something has been wrong with it, and it is to begin anew.
    carried : ndarray, shape (lanes,)
        1: at the last reading that it foretold, its unit was silent, or axes of it were left out.
    ahead : ndarray, shape (lanes,)
        No later part of the last minute has given a lane more than this before the one in force [nat] (Page, 1954):
        only beyond `MARGIN` the parts are looked at.
    away : ndarray, shape (lanes, velocities, 3 + 2 axes)
        Since when and until when a velocity contradicts a lane [s] (NaN: it does not), its largest change from reading
        to reading, by how much at first, and at last [m/s].
    why : ndarray, shape (3, sensors)
        When the lane in force was taken: how much more it had gained than the one before [nat], by how much that one
        had run away [m/s], and how long it had been contradicted [nat].
    """

    lane: int
    step: int
    gathered: Array
    ring: Array
    begun: Array
    doubted: Array
    carried: Array
    ahead: Array
    away: Array
    why: Array


class LaneChoice:
    """Chooses a lane.

    Parameters
    ----------
    inertial : sequence of bool
        Which lanes have an inertial unit.
    sensors : dict of str to Sensor
        Of all lanes.
    start_s : float
        Mission time [s].
    force_sd : float
        What the vehicle may do unseen, `navfilter.Imu.gap_force_sd` [m/s^2].

    Attributes
    ----------
    alone : ndarray, shape (sensors,)
        1: this velocity may tell by itself that a unit is wrong; elsewhere two sensors do.
    probation_s : float
        A lane that has begun anew is not taken before so many seconds.
    told : callable, optional
        Called after each comparison.
    """

    def __init__(
        self,
        inertial: Sequence[bool],
        sensors: dict[str, Sensor],
        start_s: float,
        force_sd: float = Imu.gap_force_sd,
    ) -> None:
        self._inertial, self._force_sd = np.array(inertial), force_sd
        self.told: Callable[[], None] | None = None
        self.names = [name for name, sensor in sensors.items() if not sensor.from_drive]
        self.alone, self.probation_s = np.ones(len(self.names)), PROBATION_S
        self._velocity = [i for i, name in enumerate(self.names) if sensors[name].observes.corrects == "velocity"]
        self._sd = [_sds(sensors[name]) for name in self.names]
        shape = len(inertial), len(self.names), 4
        self._axes = max((len(self._sd[i]) for i in self._velocity), default=0)
        away = len(inertial), len(self._velocity), FIRST + 2 * self._axes
        self.memory = LaneChoiceMemory(
            lane=0,
            step=math.floor(start_s / settings.LANE_STEP_S),
            gathered=np.zeros(shape),
            ring=np.zeros((STEPS, *shape)),
            begun=np.full(len(inertial), -math.inf),
            doubted=np.zeros(len(inertial)),
            carried=np.zeros(len(inertial)),
            ahead=np.zeros(len(inertial)),
            away=np.full(away, math.nan),
            why=np.zeros((3, len(self.names))),
        )

    @property
    def compared_s(self) -> float:
        """Time of the last comparison [s]: what was read until then took part in it."""
        return self.memory.step * settings.LANE_STEP_S

    @property
    def reason(self) -> str:
        """Why the lane in force was taken; empty for the first one."""
        gain, moved, against = self.memory.why
        if moved.any():
            sensor = int(np.argmax(moved))
            return f"the lane before ran away from {self.names[sensor]}, by {moved[sensor]:.1f} m/s"
        if against.any():
            return f"{self.names[int(np.argmax(against))]} went on to contradict the lane before"
        if gain.sum() <= settings.LANE_MARGIN:
            return "something stood in for the unit of the lane before" if self.memory.why.any() else ""
        told = [f"{self.names[i]} by {gain[i]:.0f} nat" for i in np.argsort(-gain).tolist() if gain[i] >= 1.0]
        return f"it foretold better: {', '.join(told)}" if told else ""

    def compare(
        self,
        lane: int,
        sensor: int,
        time_s: float,
        residual: Sequence[float],
        variance: Sequence[float],
        carried: bool = False,
    ) -> None:
        """What a lane foretold of a reading: measured minus foretold, and variance of that, by component; `carried`:
        something else stands in for axes of its unit.
        """
        self.memory.carried[lane] = carried
        gained = short = judged = nis = most = 0.0
        for e, v, sd in zip(residual, variance, self._sd[sensor], strict=True):
            if v > 0.0 and math.isfinite(v) and not math.isnan(e):
                level, square = RATIO * sd / math.sqrt(v), min(e * e / v, LARGE)
                gain = math.log1p(level * math.exp(-0.5 * square))
                gained, judged, nis, most = gained + gain, judged + 1.0, nis + square, max(most, square)
                short += math.log1p(level * math.exp(-0.5)) - gain
        self.memory.gathered[lane, sensor] += (gained, short, judged, nis)
        if sensor in self._velocity:
            self._contradict(self.memory.away[lane, self._velocity.index(sensor)], time_s, residual, most)

    def _contradict(self, away: Array, time_s: float, residual: Sequence[float], nis: float) -> None:
        """Note how far a velocity contradicts a lane."""
        if nis <= settings.CONTRADICTS:
            away[SINCE] = math.nan
            return
        off = np.zeros(self._axes)
        off[: len(residual)] = np.nan_to_num(residual)
        if math.isnan(away[SINCE]):
            away[SINCE], away[LARGEST] = time_s, 0.0
            away[FIRST : FIRST + self._axes] = away[FIRST + self._axes :] = off
        step = float(np.linalg.norm(off - away[FIRST + self._axes :]))
        away[UNTIL], away[LARGEST], away[FIRST + self._axes :] = time_s, max(away[LARGEST], step), off

    def decide_until(self, until_s: float, *, behind: bool = False) -> list[tuple[float, int, str]]:
        """Compare the lanes as often as is due before a time, or up to it (`behind`): from when [s] which is chosen,
        and why.
        """
        last = math.floor(until_s / settings.LANE_STEP_S)
        last -= not behind and last * settings.LANE_STEP_S == until_s
        changes = []
        while self.memory.step < last:
            if self._decide():
                changes.append((self.compared_s, self.memory.lane, self.reason))
            if self.told is not None:
                self.told()
            # a silence: what is forgotten need not be forgotten step by step
            self.memory.step = max(self.memory.step, last - STEPS)
        return changes

    def _decide(self) -> bool:
        """Compare the lanes; whether another one is in force from then on."""
        memory = self.memory
        memory.step += 1
        memory.ring[memory.step % STEPS] = memory.gathered
        memory.gathered[:] = 0.0
        now, newest = memory.lane, memory.ring[memory.step % STEPS, :, :, GAIN].sum(axis=1)
        missed = self._missed()
        short = missed.sum(axis=1)
        gained = memory.ring[..., GAIN].sum(axis=(0, 2))
        memory.doubted[self._inertial & (short - short[now] > settings.LANE_MARGIN) & (gained < gained[now])] = 1.0
        memory.ahead = np.maximum(memory.ahead + newest - newest[now], 0.0)
        # what has been contradicted already one sensor is enough for
        suspect = (memory.begun > -math.inf) | ~self._inertial
        most = settings.LANE_MARGIN if suspect[now] else settings.ALONE
        calm = np.isnan(memory.away[now, :, SINCE]).all() and not (missed[now] - missed > most).any()
        calm &= memory.carried[now] == 0.0
        if calm and self._inertial[now] and not (memory.ahead > settings.LANE_MARGIN).any():
            return False
        newest_first = (memory.step - np.arange(STEPS)) % STEPS
        gains = np.cumsum(memory.ring[newest_first, :, :, GAIN], axis=0)
        more = gains.sum(axis=2)
        more -= more[:, now : now + 1]
        memory.ahead = np.maximum(more.max(axis=0), 0.0)
        proven = memory.step - memory.begun >= self.probation_s / settings.LANE_STEP_S
        sound = (memory.doubted == 0.0) & proven
        # a unit that is stood in for follows the sensors as the lane without one does, and is taken as that is
        felt = self._inertial & (memory.carried == 0.0)
        better = (more > settings.LANE_MARGIN).any(axis=0)
        if memory.carried[now]:  # what is lost without a unit, no reading need tell: one that feels is worth more
            better |= more[-1] > 0.0
        ready = felt & sound & better if self._inertial[now] else felt & proven & self._may_return(gains, now)
        best = now if not ready.any() else int(np.argmax(np.where(ready, more.max(axis=0), -math.inf)))
        span, beside = int(np.argmax(more[:, best])), np.zeros((2, len(self.names)))
        for lane in np.flatnonzero(~felt & (sound | ~self._inertial)).tolist():
            each = gains[:, lane] - gains[:, best]
            both = (each.sum(axis=1) > settings.LANE_MARGIN) & ((each > settings.SECOND).sum(axis=1) > 1)
            single = np.array([self._run_away(best, lane), self._carried_off(missed, best, lane)]) * self.alone
            if suspect[best]:
                others = self._contradicts(missed, best, lane)
                others[self._velocity] = 0.0  # that of a velocity may be its own, which such a lane follows
                single[1] = np.maximum(single[1], others)
            if both.any() or single.any():
                best, beside = lane, single * (not both.any())
                span = int(np.argmax(both)) if both.any() else STEPS - 1
        if best == now:
            return False
        memory.why[:] = gains[span, best] - gains[span, now], *beside
        memory.doubted[now] = float(self._inertial[now])
        memory.lane = best
        memory.ahead[:] = math.inf
        return True

    def _may_return(self, gains: Array, now: int) -> NDArray[np.bool_]:
        """Which lanes may take the place of one without a unit: they have foretold more than it in the last minute, and
        of no sensor less, of late either.
        """
        each = gains - gains[:, now : now + 1]
        return np.asarray((each >= -settings.SECOND).all(axis=(0, 2)) & (each[-1].sum(axis=1) > 0.0))

    def _run_away(self, lane: int, other: int) -> Array:
        """By how much a lane has moved off from each sensor [m/s], where it is more than the vehicle may, and the other
        one follows; else zero.
        """
        found, follows = np.zeros(len(self.names)), np.isnan(self.memory.away[other, :, SINCE])
        moved, first = self._moved(lane)
        for i, mine in enumerate(self.memory.away[lane]):
            lasted_s = mine[UNTIL] - mine[SINCE]
            if lasted_s >= settings.AWAY_S and self.compared_s - mine[UNTIL] < settings.COUNTS_S and follows[i]:
                may = settings.AWAY_SD * self._force_sd * math.sqrt(lasted_s)
                if moved[i] > max(may, first[i], settings.LEADS * mine[LARGEST]):
                    found[self._velocity[i]] = moved[i]
        return found

    def _moved(self, lane: int) -> tuple[Array, Array]:
        """How far a lane has moved off from each velocity that contradicts it, and by how much it was off at first."""
        away = self.memory.away[lane, :, FIRST:]
        first, last = away[:, : self._axes], away[:, self._axes :]
        return np.linalg.norm(last - first, axis=1), np.linalg.norm(first, axis=1)

    def _carried_off(self, missed: Array, lane: int, other: int) -> Array:
        """How much each velocity contradicts a lane, and not another one [nat], where it does for longer than one that
        errs itself would, and has not jumped; else zero.
        """
        more, found = self._contradicts(missed, lane, other)[self._velocity], np.zeros(len(self.names))
        moved, first = self._moved(lane)
        found[self._velocity] = np.where((more > settings.ALONE) & ~(first > moved), more, 0.0)
        return found

    def _contradicts(self, missed: Array, lane: int, other: int) -> Array:
        """How much each sensor goes on to contradict a lane, and not another one, which follows it [nat]; else zero."""
        most, more = self.memory.ring[..., JUDGED].sum(axis=0).max(axis=0), missed[lane] - missed[other]
        follows = missed[other] < settings.FOLLOWS * missed[lane]
        lasts = more > np.maximum(settings.LANE_MARGIN, settings.LANE_SHARE * FULL * most)
        return np.where(follows & lasts, more, 0.0)

    def _missed(self) -> Array:
        """By lane and sensor, what was to be gained more in the last minute. A lane that is more modest than it need be
        has missed nothing: what it is below that is not held against the others.
        """
        whole = self.memory.ring.sum(axis=0)
        judged = whole[:, :, JUDGED]
        return np.asarray(np.maximum(whole[:, :, SHORT], 0.0) + FULL * (judged.max(axis=0) - judged))

    def means(self) -> tuple[Array, Array]:
        """Of the last minute, by lane: mean gain of a component that any lane foretold, and mean NIS of its own."""
        whole = self.memory.ring.sum(axis=(0, 2))
        most = whole[:, JUDGED].max()
        own = np.where(whole[:, JUDGED] > 0.0, whole[:, JUDGED], math.nan)
        return whole[:, GAIN] / (most if most else math.nan), whole[:, NIS] / own

    def due_restarts(self) -> list[int]:
        """Lanes that are doubted, and not in force."""
        return [lane for lane in np.flatnonzero(self.memory.doubted).tolist() if lane != self.memory.lane]

    def on_restart(self, lane: int, of: int | None = None) -> None:
        """A lane has been begun anew from the one in force, or from another one: it has the same past."""
        memory = self.memory
        of = memory.lane if of is None else of
        memory.ring[:, lane], memory.gathered[lane] = memory.ring[:, of], memory.gathered[of]
        memory.begun[lane], memory.doubted[lane] = memory.step, 0.0
        memory.away[lane], memory.ahead[lane] = math.nan, math.inf

    def leave(self, lane: int) -> None:
        """A lane is not there any more: nothing that it has foretold counts, and it is not taken."""
        memory = self.memory
        memory.ring[:, lane] = memory.gathered[lane] = memory.ahead[lane] = 0.0
        memory.begun[lane], memory.away[lane] = math.inf, math.nan


def _sds(sensor: Sensor) -> list[float]:
    """Standard deviation of each component by the sensor's description."""
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models]
    return [math.sqrt(block.r + float(block.C @ block.P0 @ block.C)) for block in blocks]

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
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.sensors import Sensor

__all__ = ["STEP_S", "Choice", "ChoiceMemory"]

Array = NDArray[np.float64]
#: Lanes are compared so often [s]: short beside what a wrong unit does to a position.
STEP_S = 0.25
#: Over so long a time [s].
WINDOW_S = 60.0
STEPS = round(WINDOW_S / STEP_S)
#: A component is an outlier in so many of one [1], anywhere within so many standard deviations of its sensor [1].
OUTLIERS, SPAN = 0.01, 100.0
RATIO = (1.0 - OUTLIERS) / OUTLIERS * SPAN / math.sqrt(2.0 * math.pi)
#: What a component gains at most that has been foretold as surely as its sensor errs.
FULL = math.log1p(RATIO)
#: Another lane is taken when it has gained so much more [nat]: two sound units of one kind differ by less than 10 in a
#: minute, a frozen one loses 100 in a second.
MARGIN = 50.0
#: The lane without an inertial unit follows whatever sensor errs, while units contradict it. So two sensors must speak
#: for it, each by so much [nat]: odds of 20,000.
SECOND = 10.0
#: Or a velocity goes on to contradict a unit: more has not been foretold than this [nat], and this share of all [1].
#: One that is off by a constant is found to be within seconds; a unit that is off is pulled back again and again.
ALONE, SHARE = 900.0, 0.3
#: A lane that has begun anew is not taken before so many seconds [s]: what was wrong shows within the window.
PROBATION_S = WINDOW_S
#: Columns of what is gathered: gain, what was to be gained more, components judged.
GAIN, SHORT, JUDGED = 0, 1, 2


@dataclass
class ChoiceMemory:
    """All that changes.

    Attributes
    ----------
    lane : int
        In force.
    step : int
        Number of the last comparison: they come at multiples of `STEP_S` of mission time.
    gathered : ndarray, shape (lanes, sensors, 3)
        Since then: gain, what was to be gained more, components judged.
    ring : ndarray, shape (steps, lanes, sensors, 3)
        The same of the last minute.
    begun : ndarray, shape (lanes,)
        Step at which each lane has begun anew; minus infinity: with the run.
    doubted : ndarray, shape (lanes,)
        1: something has been wrong with it, and it is to begin anew.
    """

    lane: int
    step: int
    gathered: Array
    ring: Array
    begun: Array
    doubted: Array


class Choice:
    """Chooses a lane.

    Parameters
    ----------
    inertial : sequence of bool
        Which lanes have an inertial unit.
    sensors : dict of str to Sensor
        Of all lanes.
    start_s : float
        Mission time [s].
    """

    def __init__(self, inertial: Sequence[bool], sensors: dict[str, Sensor], start_s: float) -> None:
        self._inertial = np.array(inertial)
        self.names = [name for name, sensor in sensors.items() if not sensor.from_drive]
        self._velocity = [i for i, name in enumerate(self.names) if sensors[name].corrects == "velocity"]
        self._sd = [_sds(sensors[name]) for name in self.names]
        shape = len(inertial), len(self.names), 3
        self.memory = ChoiceMemory(
            lane=0,
            step=math.floor(start_s / STEP_S),
            gathered=np.zeros(shape),
            ring=np.zeros((STEPS, *shape)),
            begun=np.full(len(inertial), -math.inf),
            doubted=np.zeros(len(inertial)),
        )

    @property
    def compared_s(self) -> float:
        """Time of the last comparison [s]: what was read until then took part in it."""
        return self.memory.step * STEP_S

    def hear(self, lane: int, sensor: int, residual: Sequence[float], variance: Sequence[float]) -> None:
        """What a lane foretold of a reading: measured minus foretold, and variance of that, by component."""
        into = self.memory.gathered[lane, sensor]
        for e, v, sd in zip(residual, variance, self._sd[sensor], strict=True):
            if v > 0.0 and math.isfinite(v) and not math.isnan(e):
                level = RATIO * sd / math.sqrt(v)
                gain = math.log1p(level * math.exp(-0.5 * min(e * e / v, 1400.0)))
                into[GAIN] += gain
                into[SHORT] += math.log1p(level * math.exp(-0.5)) - gain
                into[JUDGED] += 1.0

    def decide_until(self, until_s: float, *, behind: bool = False) -> list[tuple[float, int]]:
        """Compare the lanes as often as is due before a time, or up to it (`behind`): from when [s] which is chosen."""
        last = math.floor(until_s / STEP_S)
        last -= not behind and last * STEP_S == until_s
        changes = []
        while self.memory.step < last:
            if self._decide():
                changes.append((self.compared_s, self.memory.lane))
            # a silence: what is forgotten need not be forgotten step by step
            self.memory.step = max(self.memory.step, last - STEPS)
        return changes

    def _decide(self) -> bool:
        """Compare the lanes; whether another one is in force from then on."""
        memory = self.memory
        memory.step += 1
        memory.ring[memory.step % STEPS] = memory.gathered
        memory.gathered[:] = 0.0
        now = memory.lane
        _, short = self.sums()
        memory.doubted[self._inertial & (short - short[now] > MARGIN)] = 1.0
        newest_first = (memory.step - np.arange(STEPS)) % STEPS
        gains = np.cumsum(memory.ring[newest_first, :, :, GAIN], axis=0)
        more = gains.sum(axis=2)
        more -= more[:, now : now + 1]
        ready = self._inertial & (memory.doubted == 0.0) & (memory.step - memory.begun >= PROBATION_S / STEP_S)
        ready &= (more > MARGIN).any(axis=0)
        best = now if not ready.any() else int(np.argmax(np.where(ready, more.max(axis=0), -math.inf)))
        for lane in np.flatnonzero(~self._inertial).tolist():
            each = gains[:, lane] - gains[:, best]
            whole = each.sum(axis=1)
            if ((whole > MARGIN) & ((each > SECOND).sum(axis=1) > 1)).any() or self._carried_off(best, lane):
                best = lane
        if best == now:
            return False
        memory.doubted[now] = float(self._inertial[now])
        memory.lane = best
        return True

    def _carried_off(self, lane: int, other: int) -> bool:
        """Whether a velocity contradicts a lane, and not another one, for longer than one that errs itself would."""
        whole = self.memory.ring[:, :, self._velocity].sum(axis=0)
        most = whole[:, :, JUDGED].max(axis=0)
        short = whole[:, :, SHORT] + FULL * (most - whole[:, :, JUDGED])
        more = short[lane] - short[other]
        return bool(((more > ALONE) & (more > SHARE * FULL * most)).any())

    def sums(self) -> tuple[Array, Array]:
        """Of the last minute: gain by lane and sensor, and by lane what was to be gained more."""
        whole = self.memory.ring.sum(axis=0)
        missed = whole[:, :, JUDGED].max(axis=0) - whole[:, :, JUDGED]
        return whole[:, :, GAIN], (whole[:, :, SHORT] + FULL * missed).sum(axis=1)

    def to_begin_anew(self) -> list[int]:
        """Lanes that are doubted, and not in force."""
        return [lane for lane in np.flatnonzero(self.memory.doubted).tolist() if lane != self.memory.lane]

    def begun_anew(self, lane: int) -> None:
        """A lane has been begun anew from the one in force: it has the same past."""
        memory = self.memory
        memory.ring[:, lane], memory.gathered[lane] = memory.ring[:, memory.lane], memory.gathered[memory.lane]
        memory.begun[lane], memory.doubted[lane] = memory.step, 0.0


def _sds(sensor: Sensor) -> list[float]:
    """Standard deviation of each component by the sensor's description."""
    blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models]
    return [math.sqrt(block.r + float(block.C @ block.P0 @ block.C)) for block in blocks]

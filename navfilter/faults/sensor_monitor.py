"""How the sensors fare: what became of their readings, how old the last good one is, and what looks wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.faults.protection_level import Bounds, Trust
from navfilter.foundation.display import Value
from navfilter.kernels.batch import (
    FIGURES,
    HEARD_S,
    LATITUDE,
    LONGITUDE,
    MOST,
    NIS,
    NIS_MEMORY,
    NIS_MOST,
    SAME,
    SINCE_S,
    USED,
    USED_S,
    WHOLE_S,
)

if TYPE_CHECKING:
    from navfilter.models.sensors import Sensor

__all__ = ["CALM", "Health", "LaneHealth", "LearningHealth", "SensorHealth", "Watch"]

Array = NDArray[np.float64]
#: Conditions of sensors that are used.
CALM = ("good", "waiting", "partial")


@dataclass(frozen=True)
class SensorHealth:
    """Condition of one sensor.

    Attributes
    ----------
    condition : str
        "good", "waiting" (nothing heard yet), "silent" (not heard for 5 s and 8 periods, or for its gate time-out),
        "rejected" (heard, but not used for its gate time-out), "stuck" (the same value for too long), "jumped" (off by
        a constant from one reading to the next, and used for changes only until it is back), "astray" (slowly led off
        further than its error model allows, and refused until it is back), "noisy" (residuals far larger than
        predicted) or "partial" (used, but with fewer components than before).
    age_s : float
        Since the last reading that was used [s]; infinite before the first.
    outcomes : dict of str to int
        What became of its readings so far.
    nis : float
        Running mean of NIS per component, 1 when sensor and model agree; NaN before the first.
    """

    condition: str
    age_s: float
    outcomes: dict[str, int]
    nis: float

    @property
    def in_words(self) -> str:
        """Condition, and what became of its readings."""
        age = f", last used {self.age_s:.1f} s ago" if math.isfinite(self.age_s) else ""
        met = ", ".join(f"{count} {name}" for name, count in self.outcomes.items() if count)
        return f"{self.condition}{age}{met and f'; {met}'}" + ("" if math.isnan(self.nis) else f"; NIS {self.nis:.2f}")


@dataclass(frozen=True)
class LearningHealth:
    """Whether learning keeps pace.

    Attributes
    ----------
    late : int
        Answers that were not there at the reading at which they are taken: the call waited for them.
    waited_s : float
        For how long, in all [s].
    """

    late: int = 0
    waited_s: float = 0.0


@dataclass(frozen=True)
class LaneHealth:
    """Condition of one lane of a vehicle with several.

    Attributes
    ----------
    condition : str
        "in-force", "ready", "doubted" (it has foretold readings badly, and will begin anew) or "silent" (its unit does
        not speak).
    gain : float
        How well it has foretold the readings of the last minute: mean by component, 8.3 at most
        (`navfilter.faults.lane_selection`); NaN before the first.
    axes : dict of str to str
        Condition of each axis of its inertial unit.
    nis : float
        Mean of the same components' squared residuals over their predicted variances; 1 is honest. One that says
        little has a small one, so it is not what lanes are compared by.
    """

    condition: str
    gain: float
    axes: dict[str, str] = field(default_factory=dict)
    nis: float = math.nan


@dataclass(frozen=True, eq=False, repr=False)
class Health(Value):
    """Condition of the whole.

    Attributes
    ----------
    sensors : dict of str to SensorHealth
    drive : dict of str to int
        Irregularities so far: of the drive's samples gaps, backward stamps, repaired samples, clock set back or right;
        then gates widened, resets of the state to sensors that agree against it, jumps of sensors, states given up,
        attitudes set anew by the level, biases of gyros that shifted, models adopted; and, where the drive has been
        late by 0.2 s and 5 periods, how many readings came so far ahead of it.
    clock_offset_s : float
        By how much stamps are moved because the clock was set back [s].
    drive_clock_offset_s : float
        By how much the stamps of the drive alone are moved, because its clock was set and those of the others were not
        [s].
    axes : dict of str to str
        Condition of each axis of an inertial unit: "good", "noisy", "stuck", "dead" (stuck at zero), "saturated",
        "erratic" (nothing but noise), "wrong-unit", "gravity" (feels it where it is not), "swapped" (the same, of the
        right size), "free-fall", "contradicted" (by compass and DVL) or "silent" (no samples, or none that can be).
    lane : str
        What carries the state between corrections: "inertial", or "dead-reckoning" without an inertial unit, and while
        an axis of it is left out. Of a vehicle with lanes the name of the one in force: that of its inertial unit, or
        "dead-reckoning".
    lane_reason : str
        Of a vehicle with lanes: why the one in force was taken; empty for the first one.
    lanes : dict of str to LaneHealth
        Of a vehicle with lanes, by name.
    bounds : Bounds or None
        How far the truth may be from the state under any single fault that has not been found.
    trust : Trust or None
        Whether the state is to be trusted.
    learning : LearningHealth
        Depends on the speed of the machine, as nothing else does; not compared.
    """

    sensors: dict[str, SensorHealth]
    drive: dict[str, int]
    clock_offset_s: float = 0.0
    axes: dict[str, str] = field(default_factory=dict)
    bounds: Bounds | None = None
    trust: Trust | None = None
    lane: str = ""
    drive_clock_offset_s: float = 0.0
    learning: LearningHealth = field(default=LearningHealth(), compare=False)
    lanes: dict[str, LaneHealth] = field(default_factory=dict)
    lane_reason: str = ""

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"because": None if self.trust is None else "; ".join(self.trust.reasons) or None}
        rows["carried by"] = ": ".join(part for part in (self.lane, self.lane_reason) if part) or None
        if self.bounds is not None:
            rows["within"] = f"{self.bounds.horizontal_m:.3g} m, {math.degrees(self.bounds.heading_rad):.3g} deg"
        rows["axes"] = ", ".join(f"{name} {now}" for name, now in self.axes.items() if now != "good") or None
        rows |= {name: sensor.in_words for name, sensor in self.sensors.items()}
        for name, lane in self.lanes.items():
            rows[f"lane {name}"] = lane.condition + ("" if math.isnan(lane.gain) else f", gain {lane.gain:.3g}")
        rows["irregular"] = ", ".join(f"{count} {name}" for name, count in self.drive.items() if count) or None
        return "Health" if self.trust is None else f"Health: {self.trust.level}", rows

    @property
    def degraded(self) -> tuple[str, ...]:
        """Names of the sensors, and of the drive's axes, that do not help at present."""
        sensors = [name for name, s in self.sensors.items() if s.condition not in CALM]
        return (*sensors, *(name for name, condition in self.axes.items() if condition != "good"))


def _unheard() -> Array:
    """Figures before the first reading."""
    figures = np.full(FIGURES, math.nan)
    figures[[SAME, MOST, USED]], figures[[HEARD_S, USED_S, WHOLE_S]] = 0.0, -math.inf
    return figures


@dataclass
class Watch:
    """Keeps the figures of one sensor.

    Parameters
    ----------
    timeout_s : float
        One of which nothing has been used for longer is lost [s].
    silent_s : float
        One that has not been heard for longer is silent [s].

    Attributes
    ----------
    others : dict of str to int
        What became of readings that were not simply used.
    value : bytes
        Of the last reading.
    figures : ndarray, shape (FIGURES,)
        What kernels count, too: see `navfilter.kernels.batch`.
    """

    timeout_s: float
    silent_s: float
    others: dict[str, int] = field(default_factory=dict)
    value: bytes = b""
    figures: Array = field(default_factory=_unheard)

    #: The same value for so long, and at least so many times in a row, is stuck: a live sensor has noise. Said within
    #: 10 s, as everything is.
    STUCK_S = 8.0
    STUCK_READINGS = 10
    #: Silence for so long, and for so many periods, is no reading that got lost [s].
    SILENT_S, SILENT_PERIODS = 5.0, 8.0
    #: Beyond this running mean of NIS the sensor is noisier than its model.
    NOISY = 3.0

    @classmethod
    def of(cls, sensor: Sensor) -> Watch:
        """That of a sensor."""
        return cls(sensor.gate_timeout_s, cls.silent_after_s(sensor))

    @classmethod
    def silent_after_s(cls, sensor: Sensor) -> float:
        """A sensor that has not been heard for longer is silent [s]."""
        return min(sensor.gate_timeout_s, max(cls.SILENT_S, cls.SILENT_PERIODS / sensor.rate_hz))

    @property
    def outcomes(self) -> dict[str, int]:
        """What became of its readings so far; a copy."""
        used = int(self.figures[USED])
        return {"used": used, **self.others} if used else dict(self.others)

    @property
    def used_s(self) -> float:
        """Time of the last reading that was used [s]."""
        return self.figures.item(USED_S)

    @property
    def place(self) -> tuple[float, float]:
        """Latitude and longitude then [rad]."""
        return self.figures.item(LATITUDE), self.figures.item(LONGITUDE)

    def sees(self, time_s: float, value: Array) -> tuple[bool, bool]:
        """Note what arrives; whether it looks stuck, and whether it is the same as before."""
        raw, figures = value.tobytes(), self.figures
        if raw == self.value:
            figures[SAME] += 1.0
        else:
            self.value, figures[SAME], figures[SINCE_S] = raw, 1.0, time_s
        return self.stuck, figures.item(SAME) > 1.0

    @property
    def stuck(self) -> bool:
        """Whether the value has not changed for suspiciously long."""
        same, since_s, heard_s = self.figures[: HEARD_S + 1].tolist()
        return bool(same >= self.STUCK_READINGS and heard_s - since_s >= self.STUCK_S)

    def note(self, status: str, time_s: float, nis: float, dof: int, nav: Array | None = None) -> None:
        """Note what became of it, and where; nav: (17,) nominal state."""
        figures = self.figures
        if status == "used":
            figures[USED] += 1.0
        else:
            self.others[status] = self.others.get(status, 0) + 1
        # a wild stamp is not the time at which it was heard
        if status not in ("ahead", "invalid"):
            _later(figures, HEARD_S, time_s)
        if status in ("used", "late-replayed"):
            _later(figures, USED_S, time_s)
            if dof >= figures[MOST]:
                figures[MOST] = dof
                _later(figures, WHOLE_S, time_s)
            if nav is not None:
                figures[LATITUDE], figures[LONGITUDE] = nav[0], nav[1]
        if dof and math.isfinite(nis):
            share, before = min(nis / dof, NIS_MOST), 1.0 if math.isnan(figures[NIS]) else figures.item(NIS)
            figures[NIS] = before + (share - before) / NIS_MEMORY

    def caught_up(self, figures: Array, value: bytes) -> None:
        """Take over what `navfilter.kernels.batch` has counted on from its figures; `value` arrived last."""
        self.figures[:], self.value = figures, value

    def health(self, now_s: float, found: str = "") -> SensorHealth:
        """The figures at a time, of a sensor of which the filter has `found` something: see `Channel.condition`."""
        outcomes = self.outcomes
        heard_s, used_s, nis, _, whole_s = self.figures[HEARD_S : WHOLE_S + 1].tolist()
        age_s = now_s - used_s
        if not outcomes:
            condition = "waiting"
        elif now_s - heard_s > self.silent_s:
            condition = "silent"
        elif self.stuck:
            condition = "stuck"
        elif age_s > self.timeout_s and found != "astray":
            condition = "rejected"
        elif found:
            condition = found
        elif nis > self.NOISY:
            condition = "noisy"
        elif now_s - whole_s > self.silent_s:
            condition = "partial"
        else:
            condition = "good"
        nis = math.nan if math.isnan(nis) else nis  # this one: values that hold the same NaN are equal
        return SensorHealth(condition, max(age_s, 0.0), outcomes, nis)


def _later(figures: Array, which: int, time_s: float) -> None:
    """Let a time be this one, if it is later."""
    if time_s > figures[which]:
        figures[which] = time_s

"""What a run reports of itself: the condition of sensors, drive, lanes and learning, bounds of its error, and trust."""

import math
from dataclasses import dataclass, field

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.display import Value, span

#: Conditions of sensors that are used.
CALM = ("good", "waiting", "partial")


#: Silence for so long, and for so many periods, is no reading that got lost [s].
SILENT_S, SILENT_PERIODS = 5.0, 8.0
#: Beyond this running mean of NIS a sensor is noisier than its model.
NOISY = 3.0
#: A state that exceeds what the vehicle can do by this factor is none [1]: noise and waves are less.
MARGIN = 1.2
#: Beyond this sd of the velocity [m/s] or of the heading [rad] there is no dead reckoning.
LOST_VELOCITY, LOST_HEADING = 1.0, math.radians(30.0)


def silent_after_s(gate_timeout_s: float, rate_hz: float) -> float:
    """A sensor that has not been heard for longer is silent [s].

    Parameters
    ----------
    gate_timeout_s, rate_hz : float
        Of the sensor.
    """
    return min(gate_timeout_s, max(SILENT_S, SILENT_PERIODS / rate_hz))


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
        attitudes set anew by the level, biases of gyros that shifted, models adopted, velocities let in as by a wrong
        lever arm or clock; and, where the drive has been
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
    bounds: "Bounds | None" = None
    trust: "Trust | None" = None
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


@dataclass(frozen=True)
class Bounds:
    """Protection radius of the position and bound of the heading.

    Attributes
    ----------
    horizontal_m, heading_rad : float
        The truth lies within them 99.9 % of the time, under any single fault of a sensor that has not been found.
    """

    horizontal_m: float
    heading_rad: float


@dataclass(frozen=True)
class Trust:
    """Whether the state is to be trusted.

    Attributes
    ----------
    level : str
        "good", "degraded" (something does not help, the bounds say what that costs) or "lost" (the state is that of no
        vehicle, or nothing bounds it any more).
    reasons : tuple of str
        In words.
    """

    level: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class LaneHistory(Value):
    """How the lanes of a vehicle did along a run.

    Attributes
    ----------
    names : tuple of str
        Of the lanes.
    time_s : ndarray, shape (n,)
        When they were compared [s]; one in `HISTORY` of all comparisons.
    gain, nis : ndarray, shape (n, lanes)
        Of the minute before, means by component: how well a lane foretold the readings (8.3 at most, for a sensor that
        is foretold as surely as it errs), and the square of residual over predicted sd (1 is honest).
    reasons : tuple of str
        Why each of the lanes after the first was taken, as `Track.lanes` has them.
    """

    names: tuple[str, ...]
    time_s: Array
    gain: Array
    nis: Array
    reasons: tuple[str, ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {}
        for name, gain in zip(self.names, self.gain.T, strict=True):
            known = gain[np.isfinite(gain)]
            rows[name] = f"mean gain {known.mean():.3g}" if len(known) else "never compared"
        rows["left"] = "; ".join(self.reasons) or None
        return f"LaneHistory{span(self.time_s)}, {len(self.time_s)} comparisons", rows

"""How the sensors fare: what became of their readings, how old the last good one is, and what looks wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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
from navfilter.models.health import NOISY, SensorHealth, silent_after_s
from navfilter.models.sensors import Sensor

Array = NDArray[np.float64]


def _unheard() -> Array:
    """Figures before the first reading."""
    figures = np.full(FIGURES, math.nan)
    figures[[SAME, MOST, USED]], figures[[HEARD_S, USED_S, WHOLE_S]] = 0.0, -math.inf
    return figures


@dataclass
class SensorMonitor:
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

    @classmethod
    def of(cls, sensor: Sensor) -> SensorMonitor:
        """That of a sensor."""
        return cls(sensor.gate_timeout_s, silent_after_s(sensor.gate_timeout_s, sensor.rate_hz))

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

    def on_arrival(self, time_s: float, value: Array) -> tuple[bool, bool]:
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

    def on_outcome(self, status: str, time_s: float, nis: float, dof: int, nav: Array | None = None) -> None:
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
        elif nis > NOISY:
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

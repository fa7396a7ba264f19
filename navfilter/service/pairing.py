"""Dead reckoning live: which attitude belongs to a velocity, as far as is known when it must be decided.

A velocity waits until an attitude of its own time or later has arrived, and then gets the attitude interpolated to its
time: the same numbers as the replay of a recording. It waits `PATIENCE_S` at the most, by the stamps of whatever else
arrives; then the newest attitude holds if it is at most one period of the drive older, else the velocity is dropped.
What arrives behind a waiting velocity waits with it, so that the order of arrival stays.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np

from navfilter.io.json_lines import Reading


class Pairing:
    """Pairs the two streams of `DeadReckoning`.

    Parameters
    ----------
    period_s : float
        Nominal period of the drive [s].
    late_s : (2,) float
        How late the stamps of attitude and velocity are [s]; it is taken off.
    """

    #: A velocity waits so long for its attitude [s].
    PATIENCE_S = 1.0
    #: Attitudes that are kept, for velocities that come late.
    KEPT = 500
    #: An attitude that is so much older than the newest one means that the clock was set back [s].
    SET_BACK_S = 10.0
    #: More than this never waits.
    LONGEST_QUEUE = 1000

    def __init__(self, period_s: float, late_s: tuple[float, float] = (0.0, 0.0)) -> None:
        self._period_s, self._late_s = period_s, dict(zip(("attitude", "velocity"), late_s, strict=True))
        self._time_s: list[float] = []
        self._angles: list[list[float]] = []
        self._last: list[float] = []
        self._turns = [0.0, 0.0, 0.0]
        self._waiting: deque[Reading] = deque()
        self.counts = {"attitude-invalid": 0, "attitude-backward": 0, "attitude-clock-set-back": 0, "unpaired": 0}

    def take(self, reading: Reading) -> Iterator[tuple[Reading, list[float] | None]]:
        """What a new reading lets go, in order: a velocity with its attitude, or any other reading with None."""
        latest = reading.time_s if math.isfinite(reading.time_s) else -math.inf
        reading = reading._replace(time_s=reading.time_s - self._late_s.get(reading.sensor, 0.0))
        if reading.sensor == "attitude":
            self._attitude(reading)
        elif reading.sensor == "velocity" or self._waiting:
            self._waiting.append(reading)
        else:
            yield reading, None
            return
        yield from self._released(latest)

    def end(self) -> Iterator[tuple[Reading, list[float] | None]]:
        """Everything that still waits: there will be no other attitude."""
        yield from self._released(math.inf)

    def _released(self, latest_s: float) -> Iterator[tuple[Reading, list[float] | None]]:
        while self._waiting:
            first = self._waiting[0]
            if first.sensor != "velocity":
                yield self._waiting.popleft(), None
                continue
            covered = bool(self._time_s) and self._time_s[-1] >= first.time_s
            patience_s = self.PATIENCE_S + self._late_s["attitude"]  # `latest_s` is a stamp, the other a time
            if not covered and latest_s - first.time_s <= patience_s and len(self._waiting) < self.LONGEST_QUEUE:
                return
            attitude = self._at(self._waiting.popleft().time_s)
            if attitude is None:
                self.counts["unpaired"] += 1
            else:
                yield first, attitude

    def _attitude(self, reading: Reading) -> None:
        angles = reading.value[:3]
        if not all(map(math.isfinite, angles)):
            self.counts["attitude-invalid"] += 1
            return
        if self._time_s and reading.time_s <= self._time_s[-1]:
            if self._time_s[-1] - reading.time_s < self.SET_BACK_S:
                self.counts["attitude-backward"] += 1
                return
            self.counts["attitude-clock-set-back"] += 1
            self._time_s, self._angles = [], []
        # the arithmetic of numpy.unwrap, so that the replay of a recording gives the same bits
        for k, angle in enumerate(angles if self._last else ()):
            step = angle - self._last[k]
            if abs(step) >= math.pi:
                wrapped = (step + math.pi) % (2.0 * math.pi) - math.pi
                self._turns[k] += (math.pi if wrapped == -math.pi and step > 0.0 else wrapped) - step
        self._last = list(angles)
        self._time_s.append(reading.time_s)
        self._angles.append([angle + turn for angle, turn in zip(angles, self._turns, strict=True)])
        if len(self._time_s) > self.KEPT:
            del self._time_s[: self.KEPT // 2], self._angles[: self.KEPT // 2]

    def _at(self, time_s: float) -> list[float] | None:
        """Attitude at a time; None where none is near enough."""
        t = self._time_s
        if not t or time_s < t[0] - self._period_s or time_s > t[-1] + self._period_s:
            return None
        k = bisect_left(t, time_s)
        if k == 0 or k == len(t):
            return self._angles[min(k, len(t) - 1)]
        before, after = self._angles[k - 1], self._angles[k]
        return [float(np.interp(time_s, t[k - 1 : k + 1], (before[i], after[i]))) for i in range(3)]

    # ---------------------------------------------------------------- snapshot
    def snapshot(self) -> dict[str, Any]:
        """Everything, as JSON can hold it."""
        return {
            "time_s": self._time_s,
            "angles": self._angles,
            "last": self._last,
            "turns": self._turns,
            "waiting": [[r.sensor, r.time_s, r.value, r.sd] for r in self._waiting],
            "counts": self.counts,
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """The inverse of `snapshot`."""
        self._time_s, self._angles = list(saved["time_s"]), list(saved["angles"])
        self._last, self._turns, self.counts = list(saved["last"]), list(saved["turns"]), dict(saved["counts"])
        # JSON has no NaN: null stands for a missing component, as in a line
        self._waiting = deque(
            Reading(name, t, _missing(value), _missing(sd), b"") for name, t, value, sd in saved["waiting"]
        )


def _missing(values: list[float | None] | None) -> Any:
    return None if values is None else [math.nan if v is None else v for v in values]

"""The time axis of a report: mission time in the unit that suits its length, and UTC where the mission knows it."""

import datetime

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arrays import Array
from navfilter.models.mission import Mission
from navfilter.track.track import Tracks


class Clock:
    """Time axis of a mission.

    Parameters
    ----------
    begin_s, end_s : float
        Mission time [s].
    utc_s : float, optional
        UTC at mission time zero, in seconds since 1970.

    Attributes
    ----------
    unit : str
    factor : float
        From seconds to the unit.
    zero_s : float
        Mission time [s] at which the axis begins to count, see `navfilter.foundation.utc.axis_from`.
    """

    def __init__(self, begin_s: float, end_s: float, utc_s: float | None = None) -> None:
        length = end_s - begin_s
        self.begin_s, self.end_s = begin_s, end_s
        self.unit, self.factor = (
            ("h", 1 / 3600) if length > 3 * 3600 else ("min", 1 / 60) if length > 600 else ("s", 1.0)
        )
        self.zero_s, self._from = utc.axis_from(begin_s)
        # a clock that counts from 1970, as loggers' do, is UTC itself
        self.utc_s = 0.0 if utc_s is None and utc.counts_from_1970(begin_s) else utc_s

    def __call__(self, time_s: Array) -> Array:
        return (np.asarray(time_s) - self.zero_s) * self.factor

    @property
    def range(self) -> tuple[float, float]:
        """Begin and end of the axis, with a margin, in its unit."""
        margin = 0.01 * max(self.end_s - self.begin_s, 1e-3)
        low, high = self(np.array([self.begin_s - margin, self.end_s + margin]))
        return float(low), float(high)

    @property
    def label(self) -> str:
        """Name of the axis."""
        return f"mission time{self._from} [{self.unit}]"

    def utc(self, shown: float) -> datetime.datetime | None:
        """UTC at a time in the unit of the axis; None where the mission does not know it."""
        if self.utc_s is None:
            return None
        seconds = self.utc_s + self.zero_s + shown / self.factor
        return datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=seconds)

    def tick(self, shown: float, _: float | None = None) -> str:
        """Label of one tick: the time, and UTC below it."""
        when = self.utc(shown)
        below = "" if when is None else f"\n{when:%H:%M:%S}" if when.second else f"\n{when:%H:%M}"
        return f"{round(shown, 9):g}{below}"


def clock_of(tracks: Tracks, mission: Mission | None = None) -> Clock:
    """The time axis that all tracks share; with UTC where the mission knows it."""
    begin_s, end_s = min(t.time_s[0] for t in tracks.values()), max(t.time_s[-1] for t in tracks.values())
    return Clock(float(begin_s), float(end_s), None if mission is None else mission.epoch_utc_s)

"""Readings of sensors whose clock is in doubt: they wait until it is known how the vehicle moved at their time."""

import math
from bisect import insort

from navfilter.filter.events import Measurement


class MeasurementQueue:
    """A short queue, in the order of the times at which its readings are taken.

    A time offset is found from how the vehicle moved when the reading was taken. When the stamp may be early, that lies
    in the future; so such a reading is taken `Sensor.lead_s` after its stamp, and the state is carried back
    (`navfilter.kernels.delayed_state`). Live and in a replay it is the same.

    Attributes
    ----------
    readings : list of Measurement
    """

    def __init__(self) -> None:
        self.readings: list[Measurement] = []

    def put(self, reading: Measurement) -> None:
        """Let a reading wait; its time is the one at which it is to be taken."""
        insort(self.readings, reading, key=lambda one: one.time_s)

    @property
    def next_s(self) -> float:
        """When the first is to be taken [s]; infinite where none waits."""
        return self.readings[0].time_s if self.readings else math.inf

    def take_due(self, time_s: float) -> list[Measurement]:
        """Those to be taken by this time, which wait no more."""
        ready = [reading for reading in self.readings if reading.time_s <= time_s]
        del self.readings[: len(ready)]
        return ready

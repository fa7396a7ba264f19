"""What a filter remembers of one correcting sensor from reading to reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from navfilter.kernels import batch

__all__ = ["ChannelMemory"]

Array = NDArray[np.float64]


def _time(which: int, meaning: str) -> property:
    """A time that kernels note, too."""
    at = which - batch.NOTED

    def noted(self: ChannelMemory, time_s: float) -> None:
        self.last[at] = time_s

    return property(lambda self: self.last.item(at), noted, doc=meaning)


@dataclass
class ChannelMemory:
    """What is remembered of a sensor.

    Attributes
    ----------
    last : ndarray
        Jacobian, verdict and residual of the last reading (``kalman.memory_offsets`` 7 to 9); then when it was read,
        when its clock ticked last, and when a reading was used [s]; then see ``batch.NORTH_WHITE``, ``LET_GO``.
    """

    last: Array = field(default_factory=lambda: np.array([-math.inf, -math.inf, -math.inf, 0.0, 0.0]))

    last_s = _time(batch.LAST_S, "Time of the last reading [s].")
    ticked_s = _time(batch.TICKED_S, "Of the last tick of its clock [s].")
    used_s = _time(batch.TAKEN_S, "Of the last reading that was used; minus infinity before the first [s].")

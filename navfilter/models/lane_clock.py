"""When lanes may begin anew, and what the lane without an inertial unit is fed with."""

import math

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.start import Start
from navfilter.models.vehicle import LEVEL_PERIOD_S

#: Lanes that are doubted begin anew at multiples of so many seconds of mission time: a replay runs them so far apart.
ANEW_S = 30.0
#: What a vehicle that is level reads; nobody knows the yaw.
UPRIGHT = np.array([0.0, 0.0, math.nan])


def edge_after(time_s: float) -> float:
    """The next time at which lanes may begin anew [s]."""
    return (math.floor(time_s / ANEW_S) + 1) * ANEW_S


def coasting_times(start: Start, rate_hz: float, first: int, until_s: float) -> Array:
    """Times of the samples of the lane without a unit, from a number on, up to a time [s]."""
    last = max(first, math.floor((until_s - start.time_s) * rate_hz) + 2)
    times: Array = start.time_s + np.arange(first, last) / rate_hz
    return times[times <= until_s + 1e-9]


def level_times(start: Start, first: int, until_s: float) -> Array:
    """When that lane is told that the vehicle is level, from a number on, before a time [s]."""
    last = max(first, math.floor((until_s - start.time_s) / LEVEL_PERIOD_S) + 2)
    times: Array = start.time_s + LEVEL_PERIOD_S * np.arange(first, last, dtype=np.float64)
    return times[times < until_s]

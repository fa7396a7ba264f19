"""The clock of the dives' DVL by the first 100 s of all nine, for `recordings.py dives`.

Plain dead reckoning on the same readings, no filter: by how much the DVL is later than published, and one factor (scale
and mounting) for all dives, such that the paths of their beginnings fit the positions best.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
from clock_states import SNAPIR
from dead_reckoning import plain_path, plane
from harness import Array, recorded
from numpy.typing import NDArray

Path = NDArray[np.complex128]

GIVEN_S = 100.0
#: Delays that are tried [s].
DELAYS_S = np.arange(0.0, 0.81, 0.04)
#: Positions whose mean is an end of a way.
END = 5


@cache
def beginnings(delay_s: float) -> dict[str, tuple[Path, Path]]:
    """Of each dive, the given positions and the path of a DVL so much later than published: north + i east [m] from
    their means.
    """
    return dict(_beginnings(delay_s))


def _beginnings(delay_s: float) -> Iterator[tuple[str, tuple[Path, Path]]]:
    for trial in SNAPIR:
        mission, vehicle = _recorded(trial)
        stream = mission.streams["velocity"]
        moved = replace(stream, time_s=stream.time_s - delay_s)
        t, path = plain_path(replace(mission, streams={**mission.streams, "velocity": moved}), vehicle)
        times, place = plane(mission.streams["usbl"])
        # from where there is a velocity whatever the delay
        known = (times >= stream.time_s[0]) & (times <= times[0] + GIVEN_S)
        own = np.interp(times[known], t, path.real) + 1j * np.interp(times[known], t, path.imag)
        yield trial, (place[known] - place[known].mean(), own - own.mean())


_recorded = cache(lambda trial: recorded(f"snapir-auv-1hz/{trial}"))


def factor(delay_s: float, without: str = "") -> tuple[complex, float]:
    """Scale and mounting as one factor common to all dives but one, and the mean square [m^2] of what it leaves."""
    pairs = [pair for trial, pair in beginnings(delay_s).items() if trial != without]
    place, own = (np.concatenate(side) for side in zip(*pairs, strict=True))
    c = complex(np.vdot(own, place) / np.vdot(own, own))
    return c, float(np.mean(np.abs(place - c * own) ** 2))


def best(without: str = "") -> float:
    """The delay [s] that fits the beginnings of all dives but one best: the vertex of a parabola."""
    left = [factor(float(delay_s), without)[1] for delay_s in DELAYS_S]
    k = min(max(int(np.argmin(left)), 1), len(left) - 2)
    a, b, c = left[k - 1 : k + 2]
    return float(DELAYS_S[k] + 0.5 * (DELAYS_S[1] - DELAYS_S[0]) * (a - c) / (a - 2.0 * b + c))


def missed(trial: str, delay_s: float) -> float:
    """By how much the way of a dive from the first to the last of the given positions is off [m], with the factor that
    the other dives have.
    """
    place, own = beginnings(delay_s)[trial]
    off = place - factor(delay_s, trial)[0] * own
    return float(abs(off[-END:].mean() - off[:END].mean()))


def jackknife(values: Array) -> float:
    """Standard deviation of an estimate, from what it is without each of its parts."""
    n = len(values)
    return float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))

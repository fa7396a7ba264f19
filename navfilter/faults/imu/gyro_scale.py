"""Turns: how far a gyro says that the vehicle has turned, held against a compass.

A gyro whose sign or scale is wrong shows in none of its samples, and does nothing while the vehicle goes straight on.
In a turn it leads the heading away by tens of degrees within seconds. Then a compass that has been right so far is
refused, and a velocity over ground too: the vehicle does not go where its nose seems to point. Step by step, what
the gyro says is what the compass says, times a factor: no compass does that, whatever iron is around it, and one that
is noisy, stuck or has jumped does not either. So the axis about which the vehicle turns is left out until it turns with
the heading again; that is then the compass's, and all else goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.faults.innovation_gate import whole_heading
from navfilter.filter.actions import Action, Inflate
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import imu_checks as kernel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GyroScaleTest:
    """What a compass said of the gyros when it was refused, or since one was left out.

    Attributes
    ----------
    time_s, heading : float
        Of the last look [s], [rad].
    turned : float
        How far the gyros had turned about the vertical [rad].
    steps : tuple of tuple of float
        Of each: time at its end [s], change of the heading by the compass and by the gyros [rad], variance of their
        difference [rad^2].
    followed : float
        How far the vehicle had turned, fast, when the compass was last refused for long [rad].
    """

    time_s: float = -math.inf
    heading: float = 0.0
    turned: float = 0.0
    steps: tuple[tuple[float, float, float, float], ...] = ()
    followed: float = 0.0


def refused(filter: FilterState, channel: Channel, time_s: float) -> Iterator[Action]:
    """Take a reading that has just been refused; where a compass contradicts a gyro, that is left out.

    Parameters
    ----------
    filter : FilterState
        Its memory is changed.
    channel : Channel
        As the rejected update left it.
    time_s : float
        Of the reading [s].
    """
    memory, kept, w = filter.memory, channel.faults, filter.memory.monitor.imu
    before = kept.turns or GyroScaleTest()
    if (
        time_s - before.time_s < settings.GYRO_STEP_S
        or not filter.monitor.imu_monitor.active
        or (w[:3, kernel.HEEDED] > kernel.NOISY).any()
    ):
        return
    residual, north = whole_heading(channel, memory.x), channel.sensor.observes.north
    if math.isnan(residual):  # an attitude without a heading
        return

    def noise(seconds: float) -> float:
        return float(2.0 * channel.R[north, north] + channel.wander(seconds)[north])

    now = _stepped(before, time_s, _heading(memory.nav) + residual, w, noise)
    kept.turns = now
    axis = int(np.argmax(np.abs(memory.nav[12:15] * w[:3, kernel.MEAN])))
    turned = float(np.sum(np.abs([step[2] for step in now.steps])))
    fast = float(w[kernel.UNIT, kernel.FAST])
    may_be = (
        time_s - kept.rejected_since_s >= settings.LASTS_S
        and (fast - now.followed - turned >= settings.FOLLOWED or _undisputed(channel))
        and _velocity_refused(filter, time_s)
    )
    since_s = wrong_since(now.steps) if may_be else None
    if since_s is None:
        if time_s - kept.rejected_since_s >= settings.GYRO_DISPUTED_S:
            kept.turns = replace(now, followed=fast)
        return
    yield from _leave_out(filter, axis, residual, time_s - since_s)
    kept.turns = replace(now, steps=())


def check_readmission(filter: FilterState) -> None:
    """Whether a gyro that is left out turns with the heading again; then it may be used."""
    memory, w = filter.memory, filter.memory.monitor.imu
    held, noise = np.flatnonzero(w[:3, kernel.HELD]), 2.0 * float(memory.P[8, 8])
    for channel in filter.channels.values():
        kept = channel.faults
        if not len(held) or kept.turns is None or memory.time_s - kept.turns.time_s < settings.GYRO_STEP_S:
            continue
        kept.turns = _stepped(kept.turns, memory.time_s, _heading(memory.nav), w, lambda _: noise)
        if memory.time_s - channel.memory.used_s < settings.LATELY_S and agrees(kept.turns.steps):
            w[held, kernel.HELD], kept.turns = 0.0, replace(kept.turns, steps=())


def wrong_since(steps: tuple[tuple[float, ...], ...]) -> float | None:
    """Since when a gyro turns by a multiple of what a compass does [s]; None where it does not.

    Parameters
    ----------
    steps : tuple of tuple of float
        See `GyroScaleTest`.

    Examples
    --------
    >>> noise = [0.004, -0.002, 0.001, -0.005, 0.003, 0.0]
    >>> wrong_since(tuple((1.0 * k, 0.1 + e, 0.1, 2e-5) for k, e in enumerate(noise)))
    >>> wrong_since(tuple((1.0 * k, 0.1 + e, -0.1, 2e-5) for k, e in enumerate(noise)))
    0.0
    """
    best, since_s = settings.GYRO_LIMIT, None
    for first in range(len(steps)):
        time_s, c, g, v = np.array(steps[first:]).T
        v = v + (settings.GYRO_SHARE * np.maximum(np.abs(c), np.abs(g))) ** 2
        factor = float(np.sum(c * g / v) / max(float(np.sum(c * c / v)), 1e-300))
        against = float(np.minimum((c - g) ** 2 / v, settings.MOST).sum())
        left = float(np.minimum((g - factor * c) ** 2 / (v * max(1.0, factor**2)), settings.MOST).sum())
        if against - left > best and left < settings.LEFT * against and not _is_one(factor):
            best, since_s = against - left, float(time_s[0])
    return since_s


def _is_one(factor: float) -> bool:
    return settings.NEARLY[0] < factor < settings.NEARLY[1] or abs(factor) < settings.NONE


def agrees(steps: tuple[tuple[float, ...], ...]) -> bool:
    """Whether a gyro turns as a compass does, and by enough to say so."""
    if not steps:
        return False
    _, c, g, v = np.array(steps).T
    information = float(np.sum(c * c / v))
    factor = float(np.sum(c * g / v)) / max(information, 1e-300)
    return information > settings.KNOWN**-2 and abs(factor - 1.0) < settings.CLOSE and wrong_since(steps) is None


def _heading(nav: Array) -> float:
    return math.atan2(nav[9], nav[6])


def _stepped(
    before: GyroScaleTest, time_s: float, heading: float, w: Array, noise: Callable[[float], float]
) -> GyroScaleTest:
    """With one more look; `noise`: variance of the change of the heading in a time, but for the gyros'."""
    turned, off = float(w[kernel.UNIT, kernel.TURNED]), math.remainder(heading - before.heading, 2.0 * math.pi)
    steps = tuple(step for step in before.steps if time_s - step[0] < settings.OLDEST_S)
    if time_s - before.time_s <= settings.GYRO_LONGEST_S:
        steps = (*steps, (time_s, off, turned - before.turned, noise(time_s - before.time_s)))[-settings.STEPS :]
    return replace(before, time_s=time_s, heading=heading, turned=turned, steps=steps)


def _undisputed(compass: Channel) -> bool:
    return compass.faults.undisputed and compass.memory.used_s - compass.faults.agreed_s >= settings.USED_S


def _velocity_refused(filter: FilterState, time_s: float) -> bool:
    """Whether a velocity contradicts the state, too."""
    moving = [c.faults for c in filter.channels.values() if c.moves and c.faults.aside is None]
    return any(m.refused_s > time_s - settings.LATELY_S or not math.isnan(m.rejected_since_s) for m in moving)


def _leave_out(filter: FilterState, axis: int, residual: float, seconds: float) -> Iterator[Action]:
    """An axis is left out; heading, velocity and position are opened by what it has done."""
    memory, w, g = filter.memory, filter.memory.monitor.imu, filter.layout.drive
    way = math.hypot(*memory.nav[3:5].tolist()) * abs(residual)
    yield Inflate(8, 8, residual**2)
    yield Inflate(range(3, 5), range(3, 5), way**2)
    yield Inflate(range(2), range(2), (way * seconds) ** 2)
    w[axis, kernel.CODE], w[axis, kernel.BEGAN_S], w[axis, kernel.HELD] = kernel.CONTRADICTED, 0.0, 1.0
    w[axis, kernel.JUMP] = math.sqrt(float(g.C[axis] @ g.P0[: g.errors, : g.errors] @ g.C[axis]))
    yield from filter.monitor.imu_monitor.heed(filter)

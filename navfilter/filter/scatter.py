"""A sensor that has become noisier than described: its readings are refused again and again, to both sides.

What the gate still lets in is then no better than what it refuses, and is believed far too much. The variance of what
is added to the noise is taken from all readings of a while, refused ones and used ones, and followed from reading to
reading until it has vanished.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.filter.channel import Channel
from navfilter.kernels import listen

__all__ = ["follow", "variances"]

Array = NDArray[np.float64]
#: So many refused readings are looked at together; a share of all readings of so much or more is no matter of single
#: outliers, which the gate is for [1].
LOOKED_AT, SHARE = 12, 0.3
#: They lie to both sides if their mean is within so many of their standard deviations [1]: of twelve of an even
#: scatter, it is beyond it once in a thousand times; of a sensor that has jumped it is far beyond.
CENTRED = 1.0
#: The variance is followed over about so many readings, each of which counts for so many standard deviations at most.
MEMORY, MOST_SDS = 20.0, 4.0


def variances(channel: Channel, sd: ArrayLike | None) -> Array:
    """White variances of a reading that has standard deviations of its own, or whose sensor is noisier than described;
    empty: those of the error model.
    """
    own = np.zeros(0) if sd is None else np.resize(np.square(np.ravel(sd)), channel.axes)
    if channel.memory.noise:
        own = (own if own.size else channel.group.r) + np.array(channel.memory.noise)
    return np.asarray(own)


def follow(channel: Channel, time_s: float, used: bool) -> None:
    """Take note of a reading, whose verdict stands in its channel.

    Parameters
    ----------
    channel : Channel
    time_s : float
    used : bool
        Or refused; one whose value is stuck shows no noise, and counts as used.
    """
    memory, a = channel.memory, channel.axes
    if (used and not memory.noise) or not channel.verdict[1]:
        return
    residual, variance = np.array(channel.note[3 : 3 + a]), np.array(channel.note[3 + a :])
    if memory.noise:
        noise, known = np.array(memory.noise), np.isfinite(residual) & np.isfinite(variance)
        square = np.minimum(residual**2, MOST_SDS**2 * variance)
        noise = np.where(known, noise + (square - variance) / MEMORY, noise)
        memory.noise = tuple(np.maximum(noise, 0.0).tolist()) if np.any(noise > np.diag(channel.white)) else ()
    else:
        memory.refusals = (*memory.refusals, (time_s, *residual.tolist()))[-LOOKED_AT:]
        memory.noise = _found(channel, np.array(memory.refusals), variance)
        memory.refusals = () if memory.noise else memory.refusals


def _found(channel: Channel, refused: Array, variance: Array) -> tuple[float, ...]:
    """Variance to be added to each axis; none where they are few, or agree."""
    readings = round((refused[-1, 0] - refused[0, 0]) / channel.period_s) + 1
    if len(refused) < LOOKED_AT or len(refused) < SHARE * readings:
        return ()
    residuals = refused[:, 1:]
    if channel.sensor.open_loop == listen.HEADING:
        # half a turn to the left is half a turn to the right
        residuals = residuals[-1] + (residuals - residuals[-1] + np.pi) % (2.0 * np.pi) - np.pi
    square = np.nansum(residuals**2, axis=0) / readings
    noise = np.where(np.isfinite(variance), np.maximum(square - variance, 0.0), 0.0)
    worst = int(np.argmax(np.nan_to_num(square / variance)))
    mean, sd = np.nanmean(residuals[:, worst]), np.nanstd(residuals[:, worst])
    larger = noise[worst] > channel.white[worst, worst]
    return tuple(noise.tolist()) if larger and abs(mean) <= CENTRED * sd else ()

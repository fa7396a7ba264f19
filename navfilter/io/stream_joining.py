"""Joining the sources of a stream: interpolation onto one clock, means of several, means of consecutive rows."""

import numpy as np

from navfilter.foundation.arrays import Array, Mask
from navfilter.models.state import wrap

#: A mean of angles that cancel each other to less than this has no direction [1].
_CANCELLED = 1e-6


def resampled(
    time_s: Array, own_time: Array, part: Array, circular: Mask, max_gap_s: float | None, quaternion: bool = False
) -> Array:
    """A group of another source at the times of the first; NaN outside its range and within gaps."""
    result = np.full((time_s.size, part.shape[1]), np.nan)
    part = _continuous(part) if quaternion else part
    for k in range(part.shape[1]):
        known = np.isfinite(part[:, k])
        if np.count_nonzero(known) < 2:
            continue
        known_time = own_time[known]
        values = np.unwrap(part[known, k]) if circular[k] else part[known, k]
        result[:, k] = np.interp(time_s, known_time, values, left=np.nan, right=np.nan)
        step = np.diff(known_time)
        longest = max_gap_s or 10.0 * float(np.median(step))
        gap = np.searchsorted(known_time, time_s, side="left") - 1
        inside = (gap >= 0) & (gap < step.size)
        result[inside, k] = np.where(step[gap[inside]] > longest, np.nan, result[inside, k])
    return result


def mean(given: list[Array], circular: Mask, quaternion: bool = False) -> Array:
    """Mean of what is known, component by component."""
    stack = np.stack(given)
    if quaternion:
        return _mean_rotation(stack)
    known = np.isfinite(stack).sum(axis=0)
    result = np.where(known > 0, np.nansum(stack, axis=0) / np.maximum(known, 1), np.nan)
    if circular.any():
        result[:, circular] = circular_mean(stack[:, :, circular], known_only=True)
    return result


def circular_mean(angles: Array, axis: int = 0, known_only: bool = False) -> Array:
    """Mean direction of angles along an axis, within half a turn of the first; NaN where they cancel each other.

    Parameters
    ----------
    angles : ndarray
        [rad].
    axis : int
    known_only : bool
        Leave missing ones out; else one that is missing makes the mean missing.

    Examples
    --------
    >>> np.degrees(circular_mean(np.radians([358.0, 2.0]))).round(9)
    np.float64(360.0)
    """
    there = np.isfinite(angles)
    weight = there if known_only else np.ones_like(there)
    sine, cosine = (np.sum(np.where(weight, f(angles), 0.0), axis=axis) for f in (np.sin, np.cos))
    count = np.maximum(np.sum(weight, axis=axis), 1)
    first = np.take_along_axis(angles, np.expand_dims(np.argmax(there, axis=axis), axis), axis).squeeze(axis)
    direction = np.where(np.hypot(sine, cosine) > _CANCELLED * count, np.arctan2(sine, cosine), np.nan)
    return np.asarray(first + wrap(direction - first))


def _continuous(quaternion: Array) -> Array:
    """The same rotations with the signs of neighbours alike: q and -q are one rotation, what lies between is none."""
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    result = quaternion.copy()
    if known.size > 1:
        apart = np.sum(quaternion[known[1:]] * quaternion[known[:-1]], axis=1) < 0.0
        result[known[1:]] *= np.where(np.cumsum(apart) % 2, -1.0, 1.0)[:, np.newaxis]
    return result


def _mean_rotation(stack: Array) -> Array:
    """Mean along the first axis of quaternions (k, n, 4) that lie close together, with the sign of the first known."""
    there: Mask = np.asarray(np.isfinite(stack).all(axis=2))
    first = stack[np.argmax(there, axis=0), np.arange(stack.shape[1])]
    alike = np.where(np.sum(stack * first, axis=2) < 0.0, -1.0, 1.0)[:, :, np.newaxis] * stack
    total = np.sum(np.where(there[:, :, np.newaxis], alike, 0.0), axis=0)
    count = np.sum(there, axis=0)[:, np.newaxis]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def block_mean(part: Array, length: int, circular: Mask, quaternion: bool = False) -> Array:
    """Means of consecutive rows; a block with a missing value is missing, a short last block is dropped."""
    blocks = part.shape[0] // length
    whole: Array = part[: blocks * length].reshape(blocks, length, part.shape[1])
    if quaternion:
        complete: Mask = np.asarray(np.isfinite(whole).all(axis=(1, 2)))
        return np.where(complete[:, np.newaxis], _mean_rotation(np.swapaxes(whole, 0, 1)), np.nan)
    blocks_mean: Array = whole.mean(axis=1)
    if circular.any():
        blocks_mean[:, circular] = circular_mean(whole[:, :, circular], axis=1)
    return blocks_mean


def block_sd(sd: Array, length: int) -> Array:
    """Standard deviations of the means of consecutive rows with white errors."""
    mean_square = block_mean(np.square(sd), length, np.zeros(sd.shape[1], dtype=bool))
    result: Array = np.sqrt(mean_square / length)
    return result

"""Joining the sources of a stream: interpolation onto one clock, means of several, means of consecutive rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from navfilter.io.geodesy import wrapped

Array = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


def resampled(time_s: Array, own_time: Array, part: Array, circular: Bool, max_gap_s: float | None) -> Array:
    """A group of another source at the times of the first; NaN outside its range and within gaps."""
    result = np.full((time_s.size, part.shape[1]), np.nan)
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


def mean(given: list[Array]) -> Array:
    """Mean of what is known, component by component."""
    stack = np.stack(given)
    known = np.isfinite(stack).sum(axis=0)
    return np.where(known > 0, np.nansum(stack, axis=0) / np.maximum(known, 1), np.nan)


def block_mean(part: Array, length: int, circular: Bool) -> Array:
    """Means of consecutive rows; a block with a missing value is missing, a short last block is dropped."""
    blocks = part.shape[0] // length
    whole: Array = part[: blocks * length].reshape(blocks, length, part.shape[1])
    if circular.any():
        whole = whole.copy()
        whole[:, :, circular] = whole[:, :1, circular] + wrapped(whole[:, :, circular] - whole[:, :1, circular])
    blocks_mean: Array = whole.mean(axis=1)
    return blocks_mean


def block_sd(sd: Array, length: int) -> Array:
    """Standard deviations of the means of consecutive rows with white errors."""
    mean_square = block_mean(np.square(sd), length, np.zeros(sd.shape[1], dtype=bool))
    result: Array = np.sqrt(mean_square / length)
    return result

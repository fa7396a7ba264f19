"""The working memory of kernels: one array for all channels, and a table of what stands where in it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import batch, strapdown
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.models.mechanisation import Mechanisation

__all__ = ["shared"]

Array = NDArray[np.float64]
#: Steps of the drives, as the kernel takes them.
TRACED = {
    strapdown.imu_steps: strapdown.imu_traced,
    strapdown.dead_reckoning_steps: strapdown.dead_reckoning_traced,
}


def shared(
    channels: Sequence[Channel], drive: Mechanisation, folds: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Let all channels work in one array.

    Parameters
    ----------
    channels : sequence of Channel
        As they have been laid out.
    drive : Mechanisation
    folds : ndarray of int, shape (7,)
        Dimensions of a fold between readings, see ``kalman.places``.

    Returns
    -------
    bench : ndarray
    plan : ndarray of int, shape (channels + 1, PLAN)
        What stands where, see `navfilter.kernels.batch`.
    last : ndarray of int, shape (PLAN,)
        Its last row.
    """
    n, m = folds[1:3].tolist()
    *begins, end = accumulate((channel.size for channel in channels), initial=0)
    bench = np.zeros(end + m * m + max(m * n, 9 * (n + m + 9)))
    last = np.zeros(batch.PLAN, np.int64)
    last[: len(folds)], last[batch.MEM] = folds, end
    last[batch.RECORD] = max([m * m, *(channel.record_size for channel in channels)])
    rows = [channel.settle(bench, begin) for channel, begin in zip(channels, begins, strict=True)]
    last[batch.STEPS] = address(TRACED[drive.steps], addresses.STEPS)
    last[batch.HOLD] = address(drive.hold, addresses.HOLD)
    last[batch.CORRECTION] = address(batch.correction, addresses.CORRECTION)
    for row in rows:
        if row[batch.SIGHT]:
            row[batch.MOTION] = address(drive.moved, addresses.MOTION)
    return bench, np.array([*rows, last]), last

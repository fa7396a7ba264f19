"""Fixed-interval smoothing over the tape of a run."""

from collections.abc import Callable

import numpy as np

from navfilter.filter.records import CHANGE, Tape
from navfilter.foundation.arrays import Array
from navfilter.kernels import kalman

#: So many rows are given at a time: their covariances are to stay in the second cache.
ROWS = 64


def smooth_rows(
    tape: Tape,
    store: Callable[[int, Array, Array, Array, Array], None],
    progress: Callable[[int], object] | None = None,
    inertial: bool = True,
) -> None:
    """Rauch-Tung-Striebel solution at every row of the tape, latest first.

    Computed in the modified Bryson-Frazier form (Bierman, 1973), which inverts only innovation covariances. Feedback
    needs no bookkeeping: the smoothed error is expressed against the forward trajectory itself, and each attitude reset
    is part of its record.

    Parameters
    ----------
    tape : Tape
        Of a run that wrote records (``smoothable=True``).
    store : callable(first, values, means, covariances, steps)
        Called for some successive rows of one layout, of which the first is given by its number: the forward state
        (q, 17 + (n - 9) values for n error states), the smoothed corrections (q, n) to add to it, the covariances
        (q, n, n) of what is left, and the residuals of the drive (q, 2, k), see `navfilter.kernels.kalman.drive_step`.
    progress : callable(n), optional
        Called now and then with the number of records done.
    inertial : bool
        Whether the drive carries velocity and attitude, or the position alone.

    Raises
    ------
    ValueError
        When the tape holds no records.
    """
    if not tape.smoothable:
        raise ValueError(
            "this tape was written with smoothable=False: it has no records to smooth. Replay with smooth=True."
        )
    size = tape.layouts[-1].size
    L, lam = np.zeros((size, size)), np.zeros(size)
    holds, layouts, heads = np.array(tape.row_records), np.array(tape.row_layouts), tape.heads
    changes = np.flatnonzero(heads[:, 0] == CHANGE)
    index, row = len(tape.records), len(holds)
    while row:
        # the rows and records down to the last change of the layout, as far as they stand in one piece
        change = int(np.searchsorted(changes, index)) - 1
        first = int(changes[change]) + 1 if change >= 0 else 0
        if index == first and holds[row - 1] < index:
            M = tape.records[index - 1].reshape(heads[index - 1, 1:3])
            L, lam, index = np.ascontiguousarray(M.T @ L @ M), np.ascontiguousarray(M.T @ lam), index - 1
            continue
        records, begins = tape.records.run(first, index)
        first = index - len(begins)
        kinds = heads[first:index].astype(np.int64)
        same = max(int(np.searchsorted(holds, first)), int(np.searchsorted(layouts, layouts[row - 1])))
        rows, firsts = tape.rows.run(max(min(same, row), row - ROWS), row)
        begin, n = row - len(firsts), len(lam)
        until = max(first, int(holds[begin - 1]) if begin else 0)
        means, covariances = np.empty((row - begin, n)), np.empty((row - begin, n, n))
        steps = np.empty((row - begin, 2, 6 if inertial else 3))
        most = 3 * max(n, int(kinds[:, 0].max(initial=0)))
        kalman.smooth_run(
            *(L, lam, records, begins, kinds, rows, firsts, holds[begin:row] - first),
            *(index - first, until - first, means, covariances, 3 if inertial else 0, steps),
            *(np.empty((most, n)), np.empty((2 * n, n))),
        )
        if begin < row:
            store(begin, rows[firsts[:, None] + np.arange(8 + n)], means, covariances, steps)
        if progress is not None:
            progress(index - until)
        index, row = until, begin

"""Fixed-interval smoothing over the tape of a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.tape import CHANGE, Tape
from navfilter.kernels import kalman

__all__ = ["smooth_rows"]

Array = NDArray[np.float64]


def smooth_rows(
    tape: Tape, store: Callable[[int, Array, Array, Array], None], progress: Callable[[int], None] | None = None
) -> None:
    """Rauch-Tung-Striebel solution at every row of the tape, latest first.

    Computed in the modified Bryson-Frazier form (Bierman, 1973), which inverts only innovation covariances. Feedback
    needs no bookkeeping: the smoothed error is expressed against the forward trajectory itself, and each attitude reset
    is part of its record.

    Parameters
    ----------
    tape : Tape
        Of a run that wrote records (``smoothable=True``).
    store : callable(index, row, mean, covariance)
        Called per row with the forward row (17 + (n - 9) + n^2 values for n error states), the smoothed correction to
        add to its state and the covariance of what is left. The arrays are work space: copy what is to stay.
    progress : callable(n), optional
        Called now and then with the number of records done.

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
    most = 3 * max((column.axes for column in tape.columns.values()), default=0)
    T, mean, covariance = np.zeros((max(size, most), size)), np.zeros(size), np.zeros((size, size))
    row = len(tape.row_times) - 1
    for index in range(len(tape.records), -1, -1):
        while row >= 0 and tape.row_records[row] == index:
            values = tape.rows[row]
            P = values[17 + size - 9 :].reshape(size, size)
            kalman.smooth_row(P, L, lam, mean, covariance, T)
            store(row, values, mean, covariance)
            row -= 1
        if index:
            a, m, b, start = tape.head(index - 1)
            if a == CHANGE:
                M = tape.records[index - 1].reshape(m, b)
                L, lam, size = np.ascontiguousarray(M.T @ L @ M), M.T @ lam, b
                T, mean, covariance = np.zeros((max(size, most), size)), np.zeros(size), np.zeros((size, size))
                continue
            kalman.smooth_record(L, lam, tape.records[index - 1], a, m, b, start, T)
            if progress is not None and index % 1000 == 0:
                progress(1000)

"""Small mathematics on time series that the checks share."""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from navfilter.foundation.arrays import Array, Ints
from navfilter.models.mission import Stream

Number = TypeVar("Number", np.float64, np.complex128)


def vector(stream: Stream, first: str) -> Array:
    """Three columns of a stream, (n, 3), from the one named `first` on."""
    start = stream.columns.index(first)
    return stream.value[:, start : start + 3]


#: Times and values.
Series = tuple[Array, Array]
#: More windows than these say nothing new and take long.
MOST_WINDOWS = 20_000


def window_edges(begin_s: float, end_s: float, step_s: float) -> Array:
    """Starts of windows between two times, `step_s` apart or, on a long mission, as far as `MOST_WINDOWS` need."""
    return np.arange(begin_s, end_s, max(step_s, (end_s - begin_s) / MOST_WINDOWS))


def integral(time_s: Array, value: NDArray[Number]) -> NDArray[Number]:
    """Running trapezoidal integral along the first axis; a missing value counts as the last known one."""
    filled = np.array(value)
    flat = filled.reshape(len(filled), -1)
    for k in range(flat.shape[1]):
        known = np.isfinite(flat[:, k])
        flat[:, k] = np.interp(time_s, time_s[known], flat[known, k]) if known.any() else 0.0
    return cumulative_trapezoid(filled, time_s, axis=0, initial=0)


def correlation(a: Array, b: Array) -> tuple[float, float]:
    """Correlation of two series and the slope of b on a, both without their means."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both] - a[both].mean(), b[both] - b[both].mean()
    aa, bb, ab = float(a @ a), float(b @ b), float(a @ b)
    if aa <= 0.0 or bb <= 0.0:
        return 0.0, 0.0
    return ab / math.sqrt(aa * bb), ab / aa


def jackknife(estimate: Callable[[Ints], Array], rows: int) -> tuple[Array, Array]:
    """An estimate from all rows, and its standard deviations by leaving out each tenth in turn (Tukey, 1958).

    Rows that follow each other may depend on each other; tenths hardly do.
    """
    every = np.arange(rows)
    left_out = np.array([estimate(np.setdiff1d(every, part)) for part in np.array_split(every, 10)])
    spread = np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)
    return estimate(every), np.sqrt(0.9 * spread)


def factors(columns: Array, goal: Array) -> tuple[Array, Array]:
    """Factors of some columns that give a series by least squares, and their standard deviations (`jackknife`)."""

    def of(rows: Ints) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], goal[rows], rcond=None)[0], dtype=np.float64)

    return jackknife(of, goal.size)


def heading_of(stream: Stream) -> Array | None:
    """Heading [rad] of a stream that has one, else None; a magnetometer is taken as level."""
    for column in ("heading_rad", "yaw_rad"):
        if column in stream.columns:
            return stream.column(column)
    if "field_x_T" in stream.columns:
        return np.arctan2(-stream.column("field_y_T"), stream.column("field_x_T"))
    return None


def unwrapped(time_s: Array, angle: Array) -> tuple[Array, Array]:
    """Times and continuous values of an angle, where it is known."""
    known = np.isfinite(angle)
    return time_s[known], np.unwrap(angle[known])


def middle(values: Array) -> float:
    """The median that is one of the values: of two at the antimeridian the mean is on the other side of the Earth."""
    return float(np.nanquantile(values, 0.5, method="nearest"))

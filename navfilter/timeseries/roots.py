"""Roots of ``1 + c1 q^-1 + ... + cn q^-n``: where they lie, how surely, which cancel, and how they are pulled inside.

Coefficients are given without the leading 1, as everywhere; a root is one of ``z^n + c1 z^(n-1) + ... + cn``.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.foundation.arrays import Array, Complex
from navfilter.kernels import arma_fit as kernels

#: Imaginary parts below this are rounding: the root is real.
REAL = 1e-9
#: A derivative below this makes a root a multiple one, whose standard deviation is not told.
MULTIPLE = 1e-12
#: A pole nearer to 1 than this many parts of the window cannot be told from 1: its memory is a third of the window.
TOLD = 3.0
#: One nearer than this many may be a unit root: then the t test decides.
DOUBTFUL = 20.0
#: One per cent points of the t statistic of a unit root, with and without an estimated mean (Fuller 1976, table 8.5.2):
#: a slow pole taken for a bias does little harm, a bias taken for a slow pole gets a correlation time far too short.
WITH_MEAN, WITHOUT_MEAN = -3.43, -2.58


# ---------------------------------------------------------------- where they lie


def is_stable(coefficients: ArrayLike, radius: float = 1.0) -> bool:
    """Whether all roots of ``1 + c1 q^-1 + ... + cn q^-n`` lie strictly inside `radius` (Schur-Cohn step-down).

    Parameters
    ----------
    coefficients : array_like, shape (n,)
        ``c1 ... cn``, without the leading 1. Empty is stable, one that is not finite is not.
    radius : float
        Radius of the circle, default the unit circle.

    Examples
    --------
    >>> is_stable([-0.9]), is_stable([-1.0]), is_stable([-0.9], radius=0.8)
    (True, False, False)
    """
    # a copy: the kernel is compiled for writable arrays only
    return bool(kernels.largest_reflection(np.array(coefficients, dtype=np.float64).ravel(), radius) < 1.0)


def roots_of(coefficients: Array) -> Complex:
    """Roots, largest first, shape (n,)."""
    roots = np.roots(np.r_[1.0, coefficients]).astype(np.complex128)
    return roots[np.argsort(-np.abs(roots), kind="stable")]


def slowest_real(roots: NDArray[np.inexact], above: float = -math.inf) -> int | None:
    """Which root is real and the largest beyond `above`; None when there is none."""
    real = np.flatnonzero((np.abs(roots.imag) < REAL) & (roots.real > above))
    return int(real[np.argmax(roots[real].real)]) if real.size else None


def time_constant(root: complex) -> float:
    """Samples in which the response of a root falls to 1/e; infinite on the unit circle and outside."""
    size = abs(root)
    return -1.0 / math.log(size) if 0.0 < size < 1.0 else (0.0 if size == 0.0 else math.inf)


def resolved_radius(n: float) -> float:
    """Largest pole that `n` samples can tell from 1: ``1 - 3/n``."""
    return 1.0 - TOLD / n


def has_unit_root(ar: ArrayLike, covariance: ArrayLike, window: float, mean: bool = True) -> bool:
    """Whether the slowest real pole cannot be told from 1 with `window` samples.

    True for a pole above ``1 - 3/window``, and for a pole above ``1 - 20/window`` (a correlation time longer than a
    twentieth of the window) when the Dickey-Fuller t test on A(1) does not reject the unit root at 1 %. A bias state
    describes such a pole better: a stationary model fitted to it has its correlation time too short.

    Parameters
    ----------
    ar : array_like, shape (p,)
        Autoregressive coefficients.
    covariance : array_like, shape (p, p) or larger
        Their covariance (leading block).
    window : float
        Number of samples behind them.
    mean : bool
        Whether a mean was estimated along.

    Examples
    --------
    >>> has_unit_root([-0.999], [[1e-6]], 4000), has_unit_root([-0.95], [[2.5e-5]], 4000)
    (True, False)
    """
    a = np.asarray(ar, dtype=np.float64)
    poles = np.roots(np.r_[1.0, a])
    slowest = slowest_real(poles)
    if slowest is None or poles[slowest].real < 1.0 - DOUBTFUL / window:
        return False
    if poles[slowest].real > resolved_radius(window):
        return True
    at_one = 1.0 + float(a.sum())
    spread = math.sqrt(max(float(np.asarray(covariance, dtype=np.float64)[: a.size, : a.size].sum()), 0.0))
    return -at_one > (WITH_MEAN if mean else WITHOUT_MEAN) * spread


# ---------------------------------------------------------------- how surely


def _gradient(coefficients: Array, root: complex, multiple: float = 0.0) -> Complex | None:
    """Derivative of a root in the coefficients, ``-z^(n-j) / (derivative at z)``; None where that is no larger than
    `multiple`.
    """
    slope = np.polyval(np.polyder(np.r_[1.0, coefficients]), root)
    if abs(slope) <= multiple:
        return None
    powers = complex(root) ** np.arange(coefficients.size - 1, -1, -1)
    return np.asarray(-powers / slope, dtype=np.complex128)


def _sd(gradient: Complex, covariance: ArrayLike) -> float:
    return math.sqrt(max(float(np.real(gradient @ np.asarray(covariance) @ gradient.conj())), 0.0))


def root_sd(coefficients: ArrayLike, covariance: ArrayLike, root: complex) -> float:
    """Standard deviation of a root, first order in the covariance of the coefficients; infinite at a multiple root.

    Examples
    --------
    >>> round(root_sd([-0.9], [[1e-4]], 0.9), 6)
    0.01
    """
    gradient = _gradient(np.asarray(coefficients, dtype=np.float64), root, MULTIPLE)
    return math.inf if gradient is None else _sd(gradient, covariance)


def cancelling_pairs(
    ar: ArrayLike,
    ma: ArrayLike,
    covariance: ArrayLike,
    *,
    deviations: float = 2.0,
    farthest: float = math.inf,
    nearest: bool = True,
) -> int:
    """Number of pole-zero pairs closer than `deviations` of the standard deviation of their distance.

    Parameters
    ----------
    ar, ma : array_like, shapes (p,) and (q,)
        Coefficients.
    covariance : array_like, shape (p+q, p+q)
        Of ``[ar, ma]``.
    deviations : float
        Standard deviations within which a pair counts.
    farthest : float
        No pair further apart counts, however unsure its distance. A multiple root, whose distance has no first-order
        spread at all, cancels with what lies within this, if it is finite.
    nearest : bool
        A pole is compared with its nearest zero that is still free; False compares every pole with every zero.

    Examples
    --------
    >>> cancelling_pairs([-0.50], [-0.52], [[0.01, 0.0], [0.0, 0.01]])
    1
    >>> cancelling_pairs([-0.99], [-0.93], [[1e-5, 0.0], [0.0, 1e-5]])
    0
    """
    a, c = np.asarray(ar, dtype=np.float64), np.asarray(ma, dtype=np.float64)
    poles, zeros = np.roots(np.r_[1.0, a]), np.roots(np.r_[1.0, c])
    by_poles, by_zeros = [_gradient(a, z) for z in poles], [_gradient(c, z) for z in zeros]

    def cancels(i: int, j: int) -> bool:
        by_pole, by_zero = by_poles[i], by_zeros[j]
        spread = math.inf
        if by_pole is not None and by_zero is not None:
            spread = _sd(np.r_[by_pole, -by_zero], covariance)
        limit = min(deviations * spread, farthest)
        return math.isfinite(limit) and abs(poles[i] - zeros[j]) < limit

    count, free = 0, list(range(zeros.size))
    for i, pole in enumerate(poles):
        if not nearest:
            count += sum(cancels(i, j) for j in free)
        elif free and cancels(i, j := min(free, key=lambda k: abs(pole - zeros[k]))):
            count += 1
            free.remove(j)
    return count


# ---------------------------------------------------------------- pulled inside


def _with_radii(roots: NDArray[np.inexact], radii: Array) -> Array:
    """Coefficients of the roots moved along their rays to these radii."""
    size = np.abs(roots)
    moved = roots * np.where(size > 0.0, radii / np.maximum(size, 1e-300), 1.0)
    return np.atleast_1d(np.poly(moved)).real[1:]


def cap_poles(ar: ArrayLike, radius: float) -> Array:
    """Coefficients with every pole beyond `radius` pulled back to it."""
    poles = np.roots(np.r_[1.0, np.asarray(ar, dtype=np.float64)])
    return _with_radii(poles, np.minimum(np.abs(poles), radius))


def pull_inside(coefficients: Array, radius: float = 0.995) -> Array:
    """Coefficients with roots outside the unit circle reflected into it, and none beyond `radius`; unchanged if none
    is.
    """
    if not np.all(np.isfinite(coefficients)):
        return np.zeros_like(coefficients)
    if is_stable(coefficients, radius):
        return np.asarray(coefficients)
    roots = np.roots(np.r_[1.0, coefficients])
    size = np.abs(roots)
    reflected = np.where(size > 1.0, 1.0 / np.maximum(size, 1e-300), size)
    return _with_radii(roots, np.minimum(reflected, radius))

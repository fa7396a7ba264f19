"""A change of error models while the filter runs: how the states follow it without a jump."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel, RandomWalk, Sum
from navfilter.filter.layout import Layout
from navfilter.learning.learned import LearnedArma, register_labels
from navfilter.vehicle import Vehicle

__all__ = ["Change", "inflated", "state_change", "transfer"]

Array = NDArray[np.float64]
#: At one adoption the variance in the direction of what a sensor sees grows by this factor at most.
MOST_INFLATED = 4.0


class Change(NamedTuple):
    """Another error model of one sensor, to be put in force.

    Attributes
    ----------
    sensor : str
        A correcting sensor, or ``gyro`` / ``accel`` (``attitude`` / ``velocity``) of the drive.
    error : ErrorModel or tuple of ErrorModel
        One for all axes, or one per axis.
    power_ratios : tuple of float
        S(0) of the new model over that of the one in force, per axis; empty where P is to stay as it is. See
        `inflated`.
    """

    sensor: str
    error: ErrorModel | tuple[ErrorModel, ...]
    power_ratios: tuple[float, ...] = ()


def state_change(before: Layout, old: Vehicle, after: Layout, new: Vehicle) -> tuple[Array, Array]:
    """How all error states follow when the error models of a vehicle change.

    Parameters
    ----------
    before, after : Layout
        Of the two vehicles.
    old, new : Vehicle
        With the same sensors and parameters.

    Returns
    -------
    M : ndarray, shape (n_after, n_before)
    N : ndarray, shape (n_after, n_after)
        ``e_after = M e_before + w``, ``w ~ N(0, N)``.
    """
    M, N = np.zeros((after.size, before.size)), np.zeros((after.size, after.size))
    M[range(9), range(9)] = 1.0
    groups = [(before.drive, after.drive, old.drive.models, new.drive.models, new.drive.period_s)]
    for name, sensor in new.sensors.items():
        groups.append(
            (before.groups[name], after.groups[name], old.sensors[name].models, sensor.models, 1.0 / sensor.rate_hz)
        )
    for was, now, models_before, models, period_s in groups:
        row, column = now.start, was.start
        for model_before, model in zip(models_before, models, strict=True):
            part, noise = transfer(model_before, model, period_s)
            r, c = part.shape
            M[row : row + r, column : column + c], N[row : row + r, row : row + r] = part, noise
            row, column = row + r, column + c
        for i in range(now.size - now.errors):
            M[row + i, column + i] = 1.0
    return M, N


def transfer(old: ErrorModel, new: ErrorModel, period_s: float) -> tuple[Array, Array]:
    """How the states of one axis follow a change of its error model: ``x_new = M x_old + w``, ``w ~ N(0, N)``.

    Parts that are equal in both keep their states. A learnt part keeps the values and innovations that both registers
    hold; what only the new one holds is drawn from its stationary distribution given those (Gaussian conditioning).
    When the old part is no register (a prior), its present error is what both have in common.

    Returns
    -------
    M : ndarray, shape (b_new, b_old)
    N : ndarray, shape (b_new, b_new)
    """
    olds = old.parts if isinstance(old, Sum) else (old,)
    news = new.parts if isinstance(new, Sum) else (new,)
    sizes_old, sizes_new = [p.block(period_s).size for p in olds], [p.block(period_s).size for p in news]
    M, N = np.zeros((sum(sizes_new), sum(sizes_old))), np.zeros((sum(sizes_new), sum(sizes_new)))
    taken: set[int] = set()
    row = 0
    for part, size in zip(news, sizes_new, strict=True):
        rows = slice(row, row + size)
        row += size
        match = next((i for i, p in enumerate(olds) if i not in taken and _same_kind(p, part)), None)
        if match is None:
            N[rows, rows] = part.block(period_s).P0
            continue
        taken.add(match)
        first = sum(sizes_old[:match])
        M[rows, first : first + sizes_old[match]], N[rows, rows] = _transfer_part(olds[match], part, period_s)
    return M, N


def _same_kind(old: ErrorModel, new: ErrorModel) -> bool:
    walks = isinstance(old, RandomWalk) and isinstance(
        new, RandomWalk
    )  # the bias that there is wanders otherwise from now on
    return old == new or walks or isinstance(new, LearnedArma) or isinstance(old, LearnedArma)


def _transfer_part(old: ErrorModel, new: ErrorModel, period_s: float) -> tuple[Array, Array]:
    before, after = old.block(period_s), new.block(period_s)
    if old == new:
        return np.eye(after.size), np.zeros((after.size, after.size))
    left, white = np.zeros((0, before.size)), np.zeros(0)
    keep: list[int] = []
    if (
        isinstance(old, LearnedArma)
        and isinstance(new, LearnedArma)
        and old.model is not None
        and new.model is not None
    ):
        have = register_labels(old.model)
        both = [(have.index(label), i) for i, label in enumerate(register_labels(new.model)) if label in have]
        keep, left = [i for _, i in both], np.eye(before.size)[[i for i, _ in both]]
        white = np.zeros(len(keep))
    elif before.size and after.size:
        # both have a present error; what of the old one was white is not in its states
        keep, left, white = [0], before.C[None, :], np.array([before.r])
        if not np.array_equal(after.C, np.eye(after.size)[0]):
            keep, left, white = [], np.zeros((0, before.size)), np.zeros(0)
    if not keep:
        return np.zeros((after.size, before.size)), after.P0
    G = after.P0[:, keep] @ np.linalg.pinv(after.P0[np.ix_(keep, keep)], hermitian=True)
    N = after.P0 - G @ after.P0[keep] + G @ np.diag(white) @ G.T
    values, vectors = np.linalg.eigh(0.5 * (N + N.T))
    N = (vectors * np.maximum(values, 0.0)) @ vectors.T
    if len(keep) == after.size:
        G, N = np.eye(after.size)[:, np.argsort(np.argsort(keep))], np.diag(white[np.argsort(keep)])
    return G @ left, 0.5 * (N + N.T)


def inflated(P: Array, row: Array, ratio: float) -> Array:
    """What to add to P where a sensor sees the state, when the model in force took too much for certain.

    Information about a constant goes with 1 / S(0), so that P in the direction of what the sensor sees grows by the
    ratio of the powers at zero frequency, with everything that hangs on it in proportion.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance.
    row : ndarray, shape (n,)
        What the sensor sees, without its own error.
    ratio : float
        S(0) of the new model over that of the old one; at most `MOST_INFLATED` of it counts.

    Returns
    -------
    ndarray, shape (n, n)
    """
    along = P @ row
    variance = float(row @ along)
    if not (ratio > 1.0 and variance > 0.0):
        return np.zeros_like(P)
    return (min(ratio, MOST_INFLATED) - 1.0) / variance * np.outer(along, along)

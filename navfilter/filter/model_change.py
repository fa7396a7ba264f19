"""A change of error models while the filter runs: how the states follow it without a jump."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from navfilter.filter.state_layout import Group, Layout
from navfilter.foundation.arrays import Array
from navfilter.models.during import shared
from navfilter.models.error_models import ErrorModel, Errors, RandomWalk, Sum, joined_block
from navfilter.models.fault_bias import FaultDescription
from navfilter.models.learned_arma import LearnedArma, register_block, register_labels
from navfilter.models.vehicle import Vehicle
from navfilter.timeseries.model import ArmaModel

#: A variance that many times as large is beyond three standard deviations [1] (derived).
BEYOND = 9.0


class Change(NamedTuple):
    """Another error model of one sensor, to be put in force.

    Attributes
    ----------
    sensor : str
        A correcting sensor, or ``gyro`` / ``accel`` (``attitude`` / ``velocity``) of the drive.
    error : ErrorModel or tuple of ErrorModel
        One for all axes, or one per axis.
    offsets : bool
        It is about the constants of a sensor that has jumped (`navfilter.models.fault_bias`); other changes keep them.
    afresh : bool
        The error is begun anew: what is known of it now is forgotten.
    turn : (float, float) or None
        By what the heading is to be turned, and the variance of that: against the sensor, see
        `navfilter.faults.heading_fault` [rad, rad^2].
    """

    sensor: str
    error: Errors
    offsets: bool = False
    afresh: bool = False
    turn: tuple[float, float] | None = None


class Adoption(NamedTuple):
    """What it takes to put another error model in force, apart from what the filter knows then.

    Attributes
    ----------
    before, after : Vehicle
        With the models in force.
    error : ErrorModel or tuple of ErrorModel
        The new one.
    layout : Layout
        Of the states afterwards.
    M, N : ndarray
        See `state_change`.
    """

    before: Vehicle
    after: Vehicle
    error: Errors
    layout: Layout
    M: Array
    N: Array


def adoption(
    before: Vehicle, layout: Layout, sensor: str, error: Errors, afresh: bool = False, known: Sequence[Adoption] = ()
) -> Adoption:
    """What a change of one model takes where a vehicle is laid out like this: what is `known` of it, or worked out.

    Raises
    ------
    ValueError
        For an unknown sensor, or something that is no error model.
    """
    for one in known:
        if one.error is error and one.before is before and not afresh:
            return one
    after = before.with_error(**{sensor: error})
    new = Layout.of(after, (before, layout))
    return Adoption(before, after, error, new, *state_change(layout, before, new, after, sensor if afresh else ""))


def state_change(before: Layout, old: Vehicle, after: Layout, new: Vehicle, afresh: str = "") -> tuple[Array, Array]:
    """How all error states follow when the error models of a vehicle change.

    Parameters
    ----------
    before, after : Layout
        Of the two vehicles.
    old, new : Vehicle
        With the same sensors and parameters.
    afresh : str
        The sensor whose errors begin anew.

    Returns
    -------
    M : ndarray, shape (n_after, n_before)
    N : ndarray, shape (n_after, n_after)
        ``e_after = M e_before + w``, ``w ~ N(0, N)``.
    """
    M, N = np.zeros((after.size, before.size)), np.zeros((after.size, after.size))
    M[range(9), range(9)] = 1.0
    groups: list[tuple[Group, Group, Any, Any, float]]
    groups = [(before.drive, after.drive, old.drive, new.drive, new.drive.period_s)]
    for name, sensor in new.sensors.items():
        groups.append((before.groups[name], after.groups[name], old.sensors[name], sensor, 1.0 / sensor.rate_hz))
    for was, now, part_before, part_now, period_s in groups:
        row, column = now.start, was.start
        if part_before is part_now:
            M[range(row, row + now.size), range(column, column + now.size)] = 1.0
            continue
        _transfer_axes(M, N, row, column, part_before, part_now, period_s)
        for i in range(now.size - now.errors):
            M[row + now.errors + i, column + was.errors + i] = 1.0
    if afresh:
        group = after.groups[afresh]
        errors = slice(group.start, group.start + group.errors)
        M[errors], N[errors, errors] = 0.0, group.P0[: group.errors, : group.errors]
    return M, N


def handover(layout: Layout, vehicle: Vehicle, giver: str, taker: str) -> tuple[Array, Array]:
    """How all error states follow where an instrument goes on under another name, by which it is described otherwise.

    Its errors go on as at a change of models, and so do the parameters of which both descriptions say the same.

    Returns
    -------
    M, N : ndarray, shape (n, n)
        See `state_change`.
    """
    M, N = np.eye(layout.size), np.zeros((layout.size, layout.size))
    was, now, old, new = layout.groups[giver], layout.groups[taker], vehicle.sensors[giver], vehicle.sensors[taker]
    M[now.start : now.start + now.errors] = 0.0
    _transfer_axes(M, N, now.start, was.start, old, new, 1.0 / new.rate_hz)
    for name in shared(old, new):
        row = now.start + now.names.index(f"{taker}.{name}")
        M[row] = 0.0
        M[row, was.start + was.names.index(f"{giver}.{name}")] = 1.0
    return M, N


def _transfer_axes(M: Array, N: Array, row: int, column: int, old: Any, new: Any, period_s: float) -> None:
    """Put `transfer` of all axes of a sensor into the matrices of a change, from a row and a column on."""
    for before, after in zip(old.models, new.models, strict=True):
        part, noise = transfer(before, after, period_s)
        r, c = part.shape
        M[row : row + r, column : column + c], N[row : row + r, row : row + r] = part, noise
        row, column = row + r, column + c


def transfer(old: ErrorModel, new: ErrorModel, period_s: float) -> tuple[Array, Array]:
    """How the states of one axis follow a change of its error model: ``x_new = M x_old + w``, ``w ~ N(0, N)``.

    Parts that are equal in both keep their states. A learnt part keeps the values and innovations that both registers
    hold; what only the new one holds is drawn from its stationary distribution given those (Gaussian conditioning). Its
    slow parts stay, or share the sum of the old ones. When the old part is no learnt model (a prior), its present error
    is what both have in common.

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
        left = [i for i in range(len(olds)) if i not in taken]
        match = next((i for i in left if olds[i] == part), next((i for i in left if _same_kind(olds[i], part)), None))
        if match is None:
            N[rows, rows] = part.block(period_s).P0
            continue
        taken.add(match)
        first = sum(sizes_old[:match])
        M[rows, first : first + sizes_old[match]], N[rows, rows] = _transfer_part(olds[match], part, period_s)
    return M, N


def _same_kind(old: ErrorModel, new: ErrorModel) -> bool:
    # the same bias wanders otherwise from now on
    walks = isinstance(old, RandomWalk) and type(old) is type(new) and not isinstance(new, FaultDescription)
    return old == new or walks or isinstance(new, LearnedArma) or isinstance(old, LearnedArma)


def _transfer_part(old: ErrorModel, new: ErrorModel, period_s: float) -> tuple[Array, Array]:
    before, after = old.block(period_s), new.block(period_s)
    if old == new:
        return np.eye(after.size), np.zeros((after.size, after.size))
    white = before.r  # what of the old one was white is not in its states
    if (
        isinstance(old, LearnedArma)
        and isinstance(new, LearnedArma)
        and old.model is not None
        and new.model is not None
    ):
        if _holds(old, new, period_s):
            fast = _registers(old.model, new.model)
            slow = _slow_parts(old.slow_parts, new.slow_parts, period_s)
            quick, lasting = new.levels(period_s)
            return _beside(fast[0], slow[0]), _beside(quick * fast[1], lasting * slow[1])
        white = 0.0
    if not (before.size and after.size):
        return np.zeros((after.size, before.size)), after.P0
    # both have a present error
    seen = after.P0 @ after.C
    G = seen / float(after.C @ seen)
    N = after.P0 - np.outer(G, seen) + white * np.outer(G, G)
    return np.outer(G, before.C), _positive(N)


def _holds(old: LearnedArma, new: LearnedArma, period_s: float) -> bool:
    """Whether the fast and the slow part of a learnt model can be what those of the old one were: else what was slow
    may stand in the register now, or the other way round, and the present error is all that both have in common.
    """
    fast, slow = np.zeros(2), np.zeros(2)
    for i, part in enumerate((old, new)):
        assert part.model is not None
        fast[i], slow[i] = part.levels(period_s)
        fast[i] *= register_block(part.model).state_variance
        slow[i] *= sum(one.block(period_s).state_variance for one in part.slow_parts)
    return bool(fast[0] <= BEYOND * (fast[1] + new.block(period_s).r) and slow[0] <= BEYOND * slow[1])


def _registers(old: ArmaModel, new: ArmaModel) -> tuple[Array, Array]:
    """Values and innovations that both registers hold stay; what only the new one holds follows from them."""
    have, size = register_labels(old), register_block(old).size
    after = register_block(new)
    both = [(have.index(label), i) for i, label in enumerate(register_labels(new)) if label in have]
    keep, left = [i for _, i in both], np.eye(size)[[i for i, _ in both]]
    if not keep:
        return np.zeros((after.size, size)), after.P0
    if len(keep) == after.size:
        return np.eye(after.size)[:, np.argsort(np.argsort(keep))] @ left, np.zeros((after.size, after.size))
    G = after.P0[:, keep] @ np.linalg.pinv(after.P0[np.ix_(keep, keep)], hermitian=True)
    return G @ left, _positive(after.P0 - G @ after.P0[keep])


def _slow_parts(olds: Sequence[ErrorModel], news: Sequence[ErrorModel], period_s: float) -> tuple[Array, Array]:
    """Slow parts of the same orders stay; else their sum does, which the new ones share by their variances."""
    before, after = joined_block([p.block(period_s) for p in olds]), joined_block([p.block(period_s) for p in news])
    if [p.block(period_s).size for p in olds] == [p.block(period_s).size for p in news]:
        return np.eye(after.size), np.zeros((after.size, after.size))
    if not (before.size and after.size):
        return np.zeros((after.size, before.size)), after.P0
    seen = after.P0 @ after.C
    G = seen / float(after.C @ seen)
    return np.outer(G, before.C), _positive(after.P0 - np.outer(G, seen))


def _beside(one: Array, other: Array) -> Array:
    """A block matrix of two, either of which may be empty."""
    out = np.zeros((one.shape[0] + other.shape[0], one.shape[1] + other.shape[1]))
    out[: one.shape[0], : one.shape[1]] = one
    out[one.shape[0] :, one.shape[1] :] = other
    return out


def _positive(N: Array) -> Array:
    """The nearest covariance to what rounding has left of one."""
    values, vectors = np.linalg.eigh(0.5 * (N + N.T))
    N = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return 0.5 * (N + N.T)

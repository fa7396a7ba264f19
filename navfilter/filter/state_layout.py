"""Where each block of the error state stands: the only place that adds offsets.

``[ position 3 | velocity 3 | attitude 3 | drive's blocks | drive's parameters | per sensor: blocks of its axes,
parameters ]``
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.models.error_models import Block, block_diagonal
from navfilter.models.parameters import Parameter, checked


def output_first(block: Any) -> tuple[Array, Array, Array]:
    """Phi, Q and P0 of the same process with its output ``C @ x`` in the place of the first state."""
    M = np.eye(block.size)
    M[0] = block.C
    back = np.linalg.inv(M)
    return M @ block.Phi @ back, M @ block.Q @ M.T, M @ block.P0 @ M.T


@dataclass(frozen=True)
class Group:
    """The states of one sensor (or of the drive) side by side.

    Attributes
    ----------
    start, size : int
        Place in the error state.
    errors : int
        How many of them belong to error models; the rest are parameters.
    Phi, Q, P0 : ndarray, shape (size, size)
    C : ndarray, shape (axes, errors)
    r : ndarray, shape (axes,)
        White variance of one sample.
    names, units : tuple of str
        Of each state.
    x0 : ndarray, shape (size,)
        Means at the start: zero, but for parameters that a calibration has found.
    ticking : int
        How many of its states change by themselves, the first of all; those behind them are constants.
    """

    start: int
    size: int
    errors: int
    Phi: Array
    Q: Array
    P0: Array
    C: Array
    r: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    x0: Array
    ticking: int

    @property
    def slice(self) -> slice:
        """Rows of the error state."""
        return slice(self.start, self.start + self.size)

    @cached_property
    def biases(self) -> tuple[Ints, ...]:
        """Of the drive: which states are the bias of each axis."""
        constant = np.diag(self.Phi)[: self.errors] == 1.0
        return tuple(np.flatnonzero(constant & (row != 0.0)) for row in self.C)

    @classmethod
    def build(
        cls,
        start: int,
        blocks: Sequence,
        parameters: Iterable[Parameter],
        axis_names: Sequence[str],
        axis_units: Sequence[str],
        prefix: str = "",
        wandering: Mapping[str, Any] | None = None,
    ) -> "Group":
        """Stack the blocks of the axes and the parameters; those that are not constant have a block in `wandering`.

        A parameter is the output of its block. Of the further states of the block, which are parameters too, see
        `hidden_states`, each stands for itself.
        """
        parameters, wandering = checked(tuple(parameters), prefix or "the drive"), wandering or {}
        k = len(parameters)
        errors = sum(b.size for b in blocks)

        def stack(key: str, tail: Array) -> Array:
            parts = [getattr(b, key) for b in blocks if b.size] + ([tail] if k else [])
            return block_diagonal(parts)

        C = np.zeros((len(blocks), errors))
        names: list[str] = []
        units: list[str] = []
        for i, (b, axis) in enumerate(zip(blocks, axis_names, strict=True)):
            label = "_".join(part for part in (prefix, axis) if part)
            C[i, len(names) : len(names) + b.size] = b.C
            names += [f"{label}[{j}]" for j in range(b.size)]
            units += [axis_units[i]] * b.size
        dot = f"{prefix}." if prefix else ""
        names += [f"{dot}{p.name}" for p in parameters]
        units += [p.unit for p in parameters]
        keep, noise = np.eye(k), np.zeros((k, k))
        variances = np.diag([p.sd**2 for p in parameters]) if k else np.zeros((0, 0))
        place = {p.name: i for i, p in enumerate(parameters)}
        for name, block in wandering.items():
            rows = np.ix_(*2 * ([place[name], *(place[f"{name}[{j}]"] for j in range(1, block.size))],))
            keep[rows], noise[rows], variances[rows] = output_first(block)
        r, Phi, Q = np.array([b.r for b in blocks]), stack("Phi", keep), stack("Q", noise)
        changes = Q.any(axis=1) | (Phi != np.eye(errors + k)).any(axis=1)
        return cls(
            *(start, errors + k, errors, Phi, Q, stack("P0", variances), C, r, tuple(names), tuple(units)),
            x0=np.concatenate([np.zeros(errors), [p.mean for p in parameters]]),
            ticking=int(np.flatnonzero(changes)[-1]) + 1 if changes.any() else 0,
        )


def _group(start: int, part: Any, blocks: Sequence[Block], period_s: float, name: str) -> Group:
    """The states of a sensor, or of the drive."""
    wandering = {key: model.block(period_s) for key, model in part.wandering().items()}
    return Group.build(start, blocks, part.all_parameters(), part.axis_names, part.units, name, wandering)


@dataclass(frozen=True)
class Layout:
    """Groups of the whole vehicle by name; `drive` first.

    Attributes
    ----------
    size : int
        Number of error states.
    head : int
        Navigation states and the drive's: those that move with every sample of the drive.
    """

    drive: Group
    groups: dict[str, Group]

    @property
    def size(self) -> int:
        """Number of error states."""
        return self.head + sum(g.size for g in self.groups.values())

    @property
    def head(self) -> int:
        """Nine navigation states and those of the drive."""
        return 9 + self.drive.size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all states behind the nine of navigation."""
        return self.drive.names + tuple(name for g in self.groups.values() for name in g.names)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the same states."""
        return self.drive.units + tuple(unit for g in self.groups.values() for unit in g.units)

    def current_of(self, name: str) -> int:
        """Where the current of this sensor begins, or that of the first which has one; 0: none has."""
        for key in (name, *self.groups):
            if f"{key}.current_north" in self.groups[key].names:
                return self.groups[key].start + self.groups[key].names.index(f"{key}.current_north")
        return 0

    @classmethod
    def of(cls, vehicle: Any, like: "tuple[Any, Layout] | None" = None) -> "Layout":
        """Lay out a vehicle's states.

        Parameters
        ----------
        vehicle : Vehicle
        like : (Vehicle, Layout), optional
            A vehicle and how it is laid out: of a drive and sensors that are the very same only the place is another.
        """
        drive = vehicle.drive
        if like is not None and like[0].drive is drive:
            group = like[1].drive
        else:
            group = _group(9, drive, [m.block(drive.period_s) for m in drive.models], drive.period_s, "")
        start, groups = 9 + group.size, {}
        for name, sensor in vehicle.sensors.items():
            if like is not None and like[0].sensors[name] is sensor:
                groups[name] = replace(like[1].groups[name], start=start)
            else:
                period_s = 1.0 / sensor.rate_hz
                blocks = [m.in_force(period_s) for m in sensor.models]
                groups[name] = _group(start, sensor, blocks, period_s, name)
            start += groups[name].size
        return cls(group, groups)

    def start_states(self) -> Array:
        """Means at the start of all states behind the nine of navigation."""
        return np.concatenate([g.x0 for g in (self.drive, *self.groups.values())])

    def start_covariance(self, navigation: Array) -> Array:
        """Covariance at the start from that of the nine navigation errors."""
        P = np.zeros((self.size, self.size))
        P[:9, :9] = navigation
        for g in (self.drive, *self.groups.values()):
            P[g.slice, g.slice] = g.P0
        return P

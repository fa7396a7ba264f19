"""The state of one filter as the beginning of another, which has the same sensors and another drive."""

from typing import NamedTuple

import numpy as np

from navfilter.filter.filter import Filter
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.state_layout import Layout
from navfilter.foundation.arrays import Array
from navfilter.foundation.state_values import copied
from navfilter.kernels import kalman


class Transplant(NamedTuple):
    """What a filter begins anew with.

    Attributes
    ----------
    memory : FilterMemory
    layout : Layout
        Of its states.
    transition : ndarray, shape (m, m)
        Of the samples that the other filter had not folded into its covariance yet.
    M : ndarray, shape (n, n_source)
        The error states are M times those of the other filter, and what is believed of the drive beforehand.
    """

    memory: FilterMemory
    layout: Layout
    transition: Array
    M: Array


def transplant(source: Filter, target: Filter) -> Transplant:
    """What `target` would begin with, now, from the state of `source`; neither is changed.

    Position, velocity, attitude, the errors of the sensors and the models in force are those of `source`, with their
    covariance. The drive of `target` is believed as at the start: what it had learnt of itself may be what was wrong.

    Parameters
    ----------
    source, target : Filter
        With the same sensors; those that only `target` has begin as at the start.
    """
    given, own = copied(source.memory), target.memory
    m = source.layout.head
    transition, P = given.acc[:m].copy(), given.P
    kalman.fold(P, given.acc, given.nav, np.zeros((m, source.layout.size)))
    models = {name: error for name, error in given.models if name in source.channels}
    drives = {name: error for name, error in own.models if name not in target.channels}
    in_force = target.vehicle.with_error(**drives, **{k: e for k, e in models.items() if k in target.channels})
    layout = Layout.of(in_force)
    M, N = np.zeros((layout.size, source.layout.size)), np.zeros((layout.size, layout.size))
    M[range(9), range(9)] = 1.0
    x = layout.start_states()
    for name, group in (("", layout.drive), *layout.groups.items()):
        before = source.layout.groups.get(name)
        if before is None:
            N[group.slice, group.slice] = group.P0
        else:
            M[group.slice, before.slice] = np.eye(group.size)
            x[group.start - 9 : group.start - 9 + group.size] = given.x[
                before.start - 9 : before.start - 9 + group.size
            ]
    P = M @ P @ M.T + N
    channels = {name: given.channels.get(name, own.channels[name]) for name in own.channels}
    memory = FilterMemory(
        time_s=given.time_s,
        sample_s=given.time_s,
        unfolded=0,
        nav=given.nav,
        x=x,
        P=np.ascontiguousarray(0.5 * (P + P.T)),
        acc=np.vstack([np.eye(layout.head), np.zeros((3 * layout.head, layout.head))]),
        drv=in_force.drive.memory(layout.drive.errors, target.start),
        recent=np.zeros_like(own.recent),
        intake=copied(own.intake),
        channels=copied(channels),
        models=tuple((drives | {k: e for k, e in models.items() if k in target.channels}).items()),
        counts=dict(own.counts),
    )
    memory.intake.before_s = given.time_s
    memory.monitor = target.monitor.transferred(target, memory, layout, given)
    return Transplant(memory, layout, transition, M)

"""What an error model makes of a channel, wherever its states stand. On board the learning thread works it out."""

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from navfilter.filter.state_layout import Group
from navfilter.foundation.arrays import Array, Ints
from navfilter.kernels import delayed_state
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.models.fault_bias import currents, descriptions, deviations, has_offset, offset_states, proportions
from navfilter.models.sensors import Observable, Sensor
from navfilter.models.start import Start

Places = Ints
#: An estimate of a slow error beyond so many of its standard deviations is none [1]: once in 2e4 times that it changes,
#: and less often, for an estimate varies less than what it estimates.
MOST_SDS = 4.0
#: The same of a height: that of a receiver leaves its description sooner than its place does.
MOST_SDS_UP = 6.0


class ChannelModel(NamedTuple):
    """A channel as its error model describes it.

    Attributes
    ----------
    sensor : Sensor
        With that error model.
    Phi, variance : ndarray
        Of its states, and the white variance of the gyros' rates, shape (3,), for which it is so.
    offset : bool
        It has jumped.
    kernels : tuple of int
        Addresses of its kernel and what goes with it, the drive's motion left out.
    offsets : ndarray of int
        Which of its error states are constants of a jump.
    deviations : (ndarray, ndarray)
        See `navfilter.models.fault_bias`.
    limits : ndarray
        Of the gate, and the largest squares of the slow error that are still believed.
    slow : list of float
        Variance by axis of what its error states begin with.
    step, most : ndarray, shape (axes,)
        See `changes`.
    content : ndarray
        What kernels are told of it, see `navfilter.kernels.batch`.
    ends : tuple of int
        Where each part of that ends; first 0.
    """

    sensor: Sensor
    Phi: Array
    variance: Array
    offset: bool
    kernels: tuple[int, int, int, int]
    offsets: Places
    deviations: tuple[Places, Array]
    limits: Array
    slow: list[float]
    step: Array
    most: Array
    content: Array
    ends: tuple[int, ...]

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        group: Group,
        variance: Array,
        equation: tuple[Callable[..., None], Array | None],
        constants: Array,
        gates: Array,
    ) -> "ChannelModel":
        """Work it out.

        Parameters
        ----------
        sensor, group, variance
            As for `is_of`.
        equation : (callable, ndarray or None)
            Its kernel; what that needs where its place or clock are states (`delayed_facts`).
        constants, gates : ndarray
            Of the kernel; limits of the gate.
        """
        (kernel, sight), b, period_s = equation, group.ticking, 1.0 / sensor.rate_hz
        seen = 0 if sight is None else address(delayed_state.delayed_reading, addresses.SIGHT)
        bent = 0 if sensor.bend is None else address(sensor.bend, addresses.BEND)
        offset, kernels = has_offset(sensor.models), (address(kernel, addresses.EQUATION), seen, 0, bent)
        limits = np.concatenate([gates, believed(sensor, group)])
        C, (described, _) = group.C.copy(), np.array(descriptions(sensor.models, period_s), int).reshape(-1, 2).T
        C[:, described] = 0.0  # what these add is known of no reading but by its motion
        slow = C @ group.P0[: group.errors, : group.errors] @ C.T
        lever, R = sensor.lever_arm_covariance(variance), np.diag(group.r)
        model = np.array([group.Phi[:b, :b], group.Q[:b, :b]])
        facts = np.zeros(0) if sight is None else sight
        deviating, of_rad = deviations(sensor.models, period_s)
        axes = sensor.ground or sensor.axes  # over ground
        scaled = [(*one, axes) for one in proportions(sensor.models, period_s)]
        flowing = [(*one, axes) for one in currents(sensor.models, period_s)]
        moved = [(*one, axes) for one in descriptions(sensor.models, period_s)]
        each = *scaled, *zip(deviating, of_rad, strict=True), *flowing, *moved
        faults = np.concatenate([[len(scaled), len(of_rad), len(flowing), len(moved)], *each])
        parts = constants, np.zeros(6), model, group.C, R + lever, lever, R, limits, facts, faults
        return cls(
            *(sensor, group.Phi, variance, offset, kernels),
            offset_states(sensor.models, period_s),
            (deviating, of_rad),
            limits,
            slow.diagonal().tolist(),
            *changes(group, C),
            np.concatenate([part.ravel() for part in parts]),
            (0, *accumulate(part.size for part in parts)),
        )

    def is_of(self, sensor: Sensor, group: Group, variance: Array) -> bool:
        """Whether it is that of this sensor, these states, and this white variance of the gyros' rates."""
        return self.sensor is sensor and self.Phi is group.Phi and bool((self.variance == variance).all())


def changes(group: Group, C: Array) -> tuple[Array, Array]:
    """Variance by which a coloured error changes in a period, and by which it may differ at two times, by axis.

    Parameters
    ----------
    group : Group
        Its states.
    C : ndarray, shape (axes, errors)
        Its rows of them.
    """
    e = group.errors
    P0, off = group.P0[:e, :e], group.Phi[:e, :e] - np.eye(e)
    return np.diag(C @ (off @ P0 @ off.T + group.Q[:e, :e]) @ C.T), 2.0 * np.diag(C @ P0 @ C.T)


def believed(sensor: Sensor, group: Group) -> Array:
    """The largest square of the coloured error of each axis that is still believed; infinite for all but fixes, and
    where the error model sets no limit, shape (axes,).
    """
    e, none = group.errors, np.full(sensor.axes, np.inf)
    if sensor.observes is not Observable.FIX or not e:
        return none
    Phi, P0 = group.Phi[:e, :e], group.P0[:e, :e]
    if not np.allclose(Phi @ P0 @ Phi.T + group.Q[:e, :e], P0, rtol=1e-6, atol=1e-12):
        return none  # it wanders for ever
    variance = np.diag(group.C @ P0 @ group.C.T)
    most = np.where(np.arange(sensor.axes) < 2, MOST_SDS, MOST_SDS_UP)
    return np.where(variance > 0.0, most**2 * variance, np.inf)


def delayed_facts(sensor: Sensor, start: Start) -> Array | None:
    """What `navfilter.kernels.delayed_state.delayed_reading` needs to know of a sensor whose lever arm or clock are
    states (`Sensor.place_and_clock`); None where they are not.
    """
    if not sensor.place_and_clock():
        return None
    clock, arm = sensor.time_offset_sd_s > 0.0, any(sensor.lever_arm_sd_m)
    constants = np.asarray(sensor.constants(start))
    by_arm = np.zeros((constants.size, 3))
    for i, e in enumerate(np.eye(3) if arm else ()):
        moved = tuple(float(a + b) for a, b in zip(sensor.lever_arm_b_m, e, strict=True))  # type: ignore[attr-defined]
        by_arm[:, i] = np.asarray(replace(sensor, lever_arm_b_m=moved).constants(start)) - constants  # type: ignore[call-arg]
    known = arm, clock, sensor.needs_rate or arm, max(1.0, delayed_state.LEFT_S * sensor.rate_hz)
    return np.concatenate([np.array(known, dtype=np.float64), by_arm.ravel()])

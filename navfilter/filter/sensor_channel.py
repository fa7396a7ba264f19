"""Working memory of one correcting sensor: one array shared with the kernels.

What an error model makes of a channel, wherever its states stand. On board the learning thread works it out.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from navfilter.filter.state_layout import Group, Layout
from navfilter.foundation.arrays import Array, ArrayLike, Ints
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.kernels import batch, consistency, delayed_state, kalman
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.models.fault_bias import (
    currents,
    descriptions,
    deviations,
    has_description,
    has_offset,
    offset_states,
    proportions,
)
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.observable import Observable
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle

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


#: More than this share of a reading's components must agree, or it is rejected whole.
MAJORITY = 0.5
#: The past is kept for a time offset of up to so many standard deviations.
CLOCK_SDS = 4.0
#: A vehicle has dived if no fix was used for so long [s], and for so many of their periods [1].
DIVE_S, DIVE_PERIODS = 60.0, 20.0


class Times(ctypes.Structure):
    """Times of a sensor, read and written where kernels keep them (`navfilter.kernels.batch.LAST_S` and on).

    Attributes
    ----------
    last_s, ticked_s, used_s : float
        Of the last reading, of the last tick of its clock, and of the last reading that was used; minus infinity before
        the first [s].
    """

    last_s: float
    ticked_s: float
    used_s: float
    _fields_ = tuple((name, ctypes.c_double) for name in ("last_s", "ticked_s", "used_s"))


class Channel:
    """A correcting sensor while the filter runs; `arrange` lays it out, `noted` is all that changes between readings.

    Parameters
    ----------
    name : str
    sensor : Sensor
    start : Start

    Attributes
    ----------
    noted : ndarray
        Jacobian, verdict and residual of the last reading (``kalman.memory_offsets`` 7 to 9); then its `Times`; then
        see ``batch.LET_GO``.
    memory : Times
        Those in `noted`.
    """

    def __init__(self, name: str, sensor: Sensor, start: Start) -> None:
        self.name, self._start = name, start
        self.kernel, self.constants = sensor.kernel, sensor.constants(start)
        self.period_s = 1.0 / sensor.rate_hz
        fixes = sensor.observes is Observable.FIX  # none for longer than this: it has dived [s]
        self.dive_s = max(DIVE_S, DIVE_PERIODS * self.period_s) if fixes else math.inf
        self._gates = np.array(_limits(sensor.gate_probability, sensor.axes, sensor.single_gates))
        self._delayed, self.lead_s = delayed_facts(sensor, start), sensor.lead_s
        self.past_s = (
            self.lead_s + CLOCK_SDS * sensor.time_offset_sd_s + consistency.WINDOW_S * any(sensor.lever_arm_sd_m)
        )
        self.moves, self.turns = sensor.observes.in_body_axes, sensor.needs_rate or any(sensor.lever_arm_sd_m)
        self.ground, self.reads = sensor.ground, sensor.reads
        self.reading = np.full(sensor.axes, np.nan)  # the last one that Python was asked for
        self.held = sensor.held()
        self.others: tuple[Channel, ...] = ()  # of the same instrument, for times in which it is described otherwise
        self.partly_for_s = sensor.single_s if sensor.single_gates else math.inf
        self.samples = 1  # of the drive, of which a reading is the mean
        self.facts: Array | None = None  # what the monitor works out for these states
        self._described: ChannelModel | None = None
        self._foreseen: ChannelModel | None = None
        self.reset_memory()

    def reset_memory(self) -> None:
        """Remember nothing, as at the start."""
        self.noted = np.zeros(batch.NOTED)
        self.noted[: batch.LET_GO] = -math.inf
        self.faults: Any = None  # what the monitor remembers of the sensor
        self.count, self.stuck, self.stale = 0, False, False

    def arrange(self, sensor: Sensor, group: Group, layout: Layout, rate_variance: Array) -> None:
        """Lay out its working memory for other states; what is remembered stays. It has to `settle` then.

        Parameters
        ----------
        sensor : Sensor
            With the error model in force.
        group : Group
            Its states in `layout`.
        layout : Layout
        rate_variance : ndarray, shape (3,)
            White variance of the gyros as rates [rad^2/s^2].
        """
        a, parameters, variance = sensor.axes, group.size - group.errors, rate_variance / self.samples
        n, m, b = layout.size, layout.head, group.ticking
        self.sensor, self.group, self.axes, self._turned = sensor, group, a, variance
        # of the very same sensor and states only the place is another
        known = (one for one in (self._described, self._foreseen) if one and one.is_of(sensor, group, variance))
        self._described = own = next(known, None) or self._describe(sensor, group, variance)
        self.offset, self.limits, self.slow, self.facts = own.offset, own.limits, own.slow, None
        self.step, self.most = own.step, own.most
        self.is_bounded = min(own.limits[a + 1 :].tolist()) < math.inf  # what its coloured error may be
        self.deviations, self.offsets = own.deviations, own.offsets
        turned = -layout.current_of(self.name)
        if sensor.deviation is not None:
            turned = group.start + group.errors + sensor.deviation
        self.dims = np.array([a, n, m, b, group.start, group.errors, parameters, turned])
        at = kalman.memory_offsets(self.dims)
        self.places, self.record_size, self.size = np.array(at), at[5], at[-1] + own.content.size

    def prepare(self, vehicle: Vehicle, layout: Layout) -> None:
        """It may have to `arrange` itself for these next: what it takes is worked out beforehand."""
        drive, g = vehicle.drive, layout.drive
        variance = drive.rate_variance(g.Q, g.C, g.r) / self.samples
        self._foreseen = self._describe(vehicle.sensors[self.name], layout.groups[self.name], variance)

    def _describe(self, sensor: Sensor, group: Group, variance: Array) -> ChannelModel:
        return ChannelModel.of(sensor, group, variance, (self.kernel, self._delayed), self.constants, self._gates)

    def settle(self, bench: Array, begin: int) -> Ints:
        """Work from now on in a part of an array that all channels share.

        Parameters
        ----------
        bench : ndarray
            Zero in its part, `size` numbers.
        begin : int
            Of its part.

        Returns
        -------
        ndarray of int
            Its row of the plan, see `navfilter.kernels.batch`.
        """
        (a, n, m, b, first, errors, parameters, _), own = self.dims.tolist(), self._described
        assert own is not None
        at: list[int] = self.places.tolist()
        ends = [begin + at[-1] + end for end in own.ends]
        bench[ends[0] : ends[-1]] = own.content
        self.mem = mem = bench[begin : ends[0]]
        self.res, self.near = mem[at[3] : at[3] + a], mem[at[7] : at[8]].reshape(a, 9 + parameters)
        self.H, self.K = mem[at[0] : at[1]].reshape(a, n), mem[at[1] : at[2]].reshape(n, a)
        self.PH, self.S = mem[at[6] : at[7] - a].reshape(a, n), mem[at[5] : at[6]].reshape(2 * a, a)
        self.verdict, self.note = mem[at[8] : at[8] + 3], mem[at[8] : at[9] - batch.NOTED]
        self.pulled = mem[at[9] - 1 : at[9]]  # ticks since a reading that was used, with a coloured error within one sd
        self.record, self.moved = mem[: at[5]], mem[: at[0]]
        self.transition = mem[: m * m].reshape(m, m)
        self.change = mem[
            at[4] + 1 : at[5]
        ]  # of velocity and tilts: `consistency.turn_velocity`, `consistency.turn_tilts`
        self.rate, self.model = bench[ends[1] : ends[1] + 3], bench[ends[2] : ends[3]].reshape(2, b, b)
        self.C, self.white = bench[ends[3] : ends[4]].reshape(a, errors), bench[ends[4] : ends[5]].reshape(a, a)
        self.lever, self.R = bench[ends[5] : ends[6]].reshape(a, a), bench[ends[6] : ends[7]].reshape(a, a)
        self.gate = bench[ends[7] : ends[8]]
        self.parameters = slice(first - 9 + errors, first - 9 + errors + parameters)
        before, self.noted = self.noted, mem[at[7] - a : at[9]]
        if before.size == self.noted.size:
            self.noted[:] = before
        else:
            self.noted[-batch.NOTED : -1] = before[-batch.NOTED : -1]
        self.memory = Times.from_buffer(self.noted[-batch.NOTED :].data)
        starts = begin, ends[0], self.constants.size, *ends[1:9]
        described = has_description(self.sensor.models)
        is_so, partly = (
            (self.moves, self.turns or self.ground > 0, (self.sensor.observes is Observable.RATE)),
            self.partly_for_s < math.inf,
        )
        north = -1 if self.sensor.observes.north is None else self.sensor.observes.north
        faults = ends[9] if self.offset or described else 0
        more = at[8], at[5], partly, *self.held, north, self.sensor.hidden, False, faults, 0, 0
        self.spot = np.array([*self.dims.tolist(), *own.kernels, *is_so, *starts, *more], dtype=np.int64)
        return self.spot

    def set_rate_variance(self, rate_variance: Array) -> None:
        """How well the angular rate is known that its lever arm turns with; shape (3,) [rad^2/s^2]."""
        variance = rate_variance / self.samples
        if not np.array_equal(variance, self._turned):
            self._turned = variance
            self.lever[:] = self.sensor.lever_arm_covariance(variance)
            self.white[:] = np.diag(self.group.r) + self.lever

    def first_of(self, channels: "Sequence[Channel]") -> int:
        """Place of the first channel of the same instrument."""
        return next(i for i, channel in enumerate(channels) if channel is self or channel in self.others)

    @property
    def predecessor(self) -> "Channel | None":
        """The channel by which the same instrument was heard last, where that is another one."""
        latest = max(self.others, key=lambda other: other.memory.last_s, default=self)
        return latest if latest.memory.last_s > self.memory.last_s else None

    def has_dived(self, time_s: float) -> bool:
        """Whether no fix has been used for so long that the vehicle has dived."""
        return self.dive_s < time_s - self.memory.used_s < math.inf

    def use(self, time_s: float) -> None:
        """Note that its last reading, of this time, has been used, whole or in part."""
        self.memory.used_s = time_s
        self.faults.use(time_s)

    def coloured_error(self, x: Array) -> Array:
        """The coloured error that its readings are thought to have, shape (axes,); x: (n - 9,) error states."""
        first = self.group.start - 9
        return np.asarray(self.C @ x[first : first + self.group.errors])

    def wander(self, seconds: float) -> Array:
        """Variance by which its coloured error may have changed in a time, shape (axes,)."""
        # what a jump adds goes with the speed
        step, most = changes(self.group, self.C) if self.offset else (self.step, self.most)
        return np.asarray(np.minimum(step * min(seconds / self.period_s, 1e9), most))

    def beyond_belief(self, x: Array) -> bool:
        """Whether the estimate of its coloured error is no longer believed: then no reading is used."""
        limits, errors = self.limits[self.axes + 1 :].tolist(), self.coloured_error(x).tolist()
        return any(error * error > limit for error, limit in zip(errors, limits, strict=True))

    def jumped_by(self, x: Array) -> Array:
        """By how much it is off if it has jumped, as estimated, shape (axes,); x: (n - 9,) error states."""
        states = self.offsets
        return np.asarray(self.C[:, states] @ x[self.group.start - 9 + states])

    def wrap(self, residual: Array) -> None:
        """Bring the difference of two headings within half a turn, in place."""
        north = self.sensor.observes.north
        if north is not None:
            residual[north] = (residual[north] + np.pi) % (2.0 * np.pi) - np.pi

    def ticks(self, time_s: float) -> int:
        """Periods of the sensor since it was last heard; 0 at the first reading."""
        memory = self.memory
        elapsed, memory.ticked_s = time_s - memory.ticked_s, time_s
        self.count = 0 if math.isinf(elapsed) else max(1, round(elapsed / self.period_s))
        return self.count


@cache
def _limits(probability: float, axes: int, single: bool) -> tuple[float, ...]:
    """Chi-square limits of the gate for 1, 2, ... axes; first the share that must remain, see ``kalman.update``."""
    return (MAJORITY if single else math.inf, *chi_square_limit(probability, np.arange(1, axes + 1)).tolist())


def usable(sd: ArrayLike, sensor: Sensor) -> bool:
    """Whether standard deviations given with a reading can be used; the variance of one beyond 1e100 would not be
    finite.
    """
    try:
        values = np.asarray(sd, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    sizes = 1, sensor.axes, sensor.axes // sensor.tracks
    return values.size in sizes and bool(np.all((values >= 0.0) & (values < 1e100)))

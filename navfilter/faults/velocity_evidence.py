"""What refused velocities say together: explanations, compared by their marginal likelihoods (MacKay, 1992).

A velocity may be off because its sensor is off by a constant, in its own axes, in n (what it reads against moves) or in
proportion; because it is described wrongly: its lever arm, or its clock, of which nothing shows but when the vehicle
turns or changes its speed; or because the unit runs away from it: a tilt, or a bias that has jumped, shows in no
sample, but as a force, by which residuals grow from nothing. Each explanation is a linear regression of the residuals
with a Gaussian prior; the scale of the noise is fitted to each, and to none. Sums over the readings are all that is
kept: of those that are refused on end, by which constants and forces are judged, for they have a beginning; and of all
since constants were given last, by which the description is, for it has none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import strapdown
from navfilter.models.fault_bias import descriptions

Array = NDArray[np.float64]
#: Columns after the constants of the axes: motion of what is read against, ramp of the unit, scale, lever arm, clock,
#: and share of how turns have changed the velocity since the run of refusals began.
CURRENT, RAMP, SCALED, ARM, CLOCK, TURNED = (slice(a, b) for a, b in ((0, 2), (2, 4), (4, 5), (5, 8), (8, 9), (9, 10)))
RUN, ALL = 0, 1
#: Parameters that are components of a description, in their order.
DESCRIPTION = (*(f"lever_arm_{axis}" for axis in "xyz"), "time_offset", *(f"misalignment_{axis}" for axis in "xyz"))


@dataclass(frozen=True, eq=False)
class VelocityEvidence:
    """Sums over refused velocities.

    Attributes
    ----------
    sums : ndarray, shape (2, p + 1, p + 1)
        Of products of the p regressors and the residual, each in standard deviations of the white noise: of the
        readings refused on end, and of all. It is not written to.
    counts : tuple of int
        Components in each.
    past : float
        What constants explain of the runs before, each with its own, less what such a jump is unlikely [nat].
    since_s, time_s : float
        Since when readings have been refused on end, and of the last of them [s].
    variance : float
        Of the innovation when the first of these was refused [m^2/s^2].
    row : ndarray, shape (axes, p)
        Regressors of the last one.
    turned_n : ndarray, shape (2,)
        What turns have added to the velocity north and east since then [m/s].
    """

    sums: Array
    counts: tuple[int, int]
    past: float
    since_s: float
    time_s: float
    variance: float
    row: Array
    turned_n: Array


def with_refused(filter: FilterState, channel: Channel, time_s: float) -> VelocityEvidence:
    """The sums with the reading that has just been refused.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Whose reading has just been refused.
    time_s : float
        Of the reading [s].
    """
    memory = channel.faults
    before, since_s = memory.evidence, memory.rejected_since_s
    if before is not None and memory.confirmed(channel.memory.used_s) and not memory.confirmed(before.time_s):
        before = None  # the state may have been wrong, which has settled since
    # one that was let in by what explains it ends no run
    on_end = before is not None and time_s - before.time_s <= 1.5 * channel.period_s
    since_s = before.since_s if before is not None and on_end else since_s
    row, turns_n = _regressors(filter, channel, time_s - since_s + channel.period_s)
    if before is None or before.row.shape != row.shape:
        before = VelocityEvidence(
            np.zeros((2, row.shape[1] + 1, row.shape[1] + 1)), (0, 0), 0.0, since_s, -math.inf, math.nan, row, turns_n
        )
    turned_n = turns_n * channel.period_s
    if on_end:
        turned_n = before.turned_n + turns_n * (time_s - before.time_s)
        # how the velocity over ground has changed since the last one is what a clock makes of it
        moved = row[:, _place(channel, SCALED)] - before.row[:, _place(channel, SCALED)]
        row[:, _place(channel, CLOCK)] = -moved / (time_s - before.time_s)
    row[:, _place(channel, TURNED)] = row[:, _places(channel, CURRENT)] @ turned_n
    residual = ground_velocity.components(channel, channel.res[: channel.axes])
    seen = np.isfinite(residual)
    sd = np.sqrt(np.maximum(ground_velocity.components(channel, np.diag(channel.R)), 1e-300))
    whole = (np.column_stack([row, residual]) / sd[:, None])[seen]
    added, count = whole.T @ whole, int(seen.sum())
    sums, counts, past = before.sums, before.counts, before.past
    if before.since_s != since_s:
        past += max(0.0, _constants(channel, before) - settings.JUMP_ODDS)
        sums, counts = np.array([np.zeros_like(added), sums[ALL]]), (0, counts[ALL])
    variance = before.variance if counts[RUN] else float(channel.S[: channel.axes].max())
    counts = counts[RUN] + count, counts[ALL] + count
    return VelocityEvidence(sums + added, counts, past, since_s, time_s, variance, row, turned_n)


def has_not_jumped(channel: Channel) -> bool:
    """Whether something else explains the refused velocities rather than constants of the sensor: that it is described
    wrongly, or that the unit runs away from it, by more than what the gate lets by before they begin.
    """
    kept = channel.faults.evidence
    if kept is None:
        return False
    constants = kept.past + _constants(channel, kept) - settings.JUMP_ODDS
    described = not channel.offset and _description(channel, kept).gain > constants
    began = _regression(kept.sums[RUN], kept.counts[RUN], _places(channel, CURRENT), _began(channel, kept))
    jumped = max(began.gain, _jump(channel, kept)) + settings.JUMP_ODDS
    return described or max(one.gain for one in _of_unit(channel, kept)) > jumped


def described_wrongly(channel: Channel) -> Array | None:
    """Covariance of lever arm and clock, shape (4, 4), as a wrong description explains the refused velocities and lets
    the last of them in; None where it does not explain them, or not this one.
    """
    kept, a = channel.faults.evidence, channel.axes
    assert kept is not None
    wrong = _description(channel, kept)
    early = kept.time_s - kept.since_s < settings.VELOCITY_SPAN_S
    if early or not wrong.gain > kept.past + max(settings.JUMP_ODDS, _constants(channel, kept)):
        return None
    if (wrong.mean**2 > channel.limits[1] * np.square(list(of_description(range(4)).values()))).any():
        return None  # no vehicle is so large: the scale of the noise is that of rubbish
    E, off = np.outer(wrong.mean, wrong.mean) + wrong.covariance, np.zeros((a, 4))
    off[: len(kept.row)] = kept.row[:, _places(channel, ARM, CLOCK)]
    seen = np.isfinite(channel.res[:a])
    S = (channel.PH @ channel.H.T + channel.R + off @ E @ off.T)[np.ix_(seen, seen)]
    nis = float(channel.res[:a][seen] @ np.linalg.solve(S, channel.res[:a][seen]))
    return E if nis <= channel.limits[int(seen.sum())] else None


def description_places(channel: Channel) -> dict[int, int]:
    """Where components of how a velocity sensor is described (`navfilter.models.fault_bias.FaultDescription`) stand in
    the error state, as far as they do.
    """
    sensor, start = channel.sensor, channel.group.start
    found = {component: start + at for at, component in descriptions(sensor.models, channel.period_s)}
    of = {one.name: start + channel.group.errors + i for i, one in enumerate(sensor.all_parameters()) if one.sd > 0.0}
    return found | {component: of[name] for component, name in enumerate(DESCRIPTION) if name in of}


def of_description(components: Iterable[int]) -> dict[int, float]:
    """Standard deviations that these have beforehand [m], [s]."""
    return {c: settings.ARM_M if c < 3 else settings.LATE_S for c in components}


def force_felt_wrongly(filter: FilterState, channel: Channel, time_s: float) -> float | None:
    """Size of a force that the unit feels wrongly, which explains refused velocities, and nothing else does [m/s^2].

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Whose reading has just been refused; its memory takes note.
    time_s : float
        Of the reading [s].
    """
    kept, right = channel.faults, filter.inertial and bool(channel.ground) and was_right(filter, channel)
    # one that nobody had tried for long may be late: while the vehicle speeds up, that grows as well
    least_s = settings.VELOCITY_SPAN_S if right else settings.LONG_S
    told = filter.inertial and bool(channel.ground) and time_s - kept.rejected_since_s >= least_s
    size = force(channel, right and kept.undisputed) if told else None
    # a velocity through water may change with the water, slowly, too
    if size is not None and float(np.linalg.norm(np.nan_to_num(_residual(channel)))) > channel.sensor.flows_m_s:
        kept.evidence = None
        return size
    if time_s - kept.rejected_since_s >= settings.REFUSED_S and not (right and kept.undisputed):
        kept.disputed_s = time_s
    return None


def force(channel: Channel, described: bool) -> float | None:
    """Size of the constant force by which the unit has run away from the velocities refused on end [m/s^2]; None where
    something else explains them as well.

    It began at nothing: a reading before the first that was refused, it had come to what the gate lets by, but for what
    it grows by from one to the next. A description that is wrong would have shown itself before, in a sensor that was
    right for long: it counts as `described` rightly. What is in proportion to what turns make of the velocity is no
    force either: a gyro of another scale turns it otherwise, and a sensor that reads another unit from the start.
    """
    kept = channel.faults.evidence
    if kept is None:
        return None
    ramp, turned = _of_unit(channel, kept)
    others = _jump(channel, kept), turned.gain, 0.0 if described else _description(channel, kept).gain
    began, size = (float(np.linalg.norm(part)) for part in np.split(ramp.mean, 2))
    nothing = began <= float(_began(channel, kept)[0]) + size * channel.period_s
    return size if nothing and ramp.gain > max(0.0, *others) + settings.JUMP_ODDS else None


def was_right(filter: FilterState, channel: Channel) -> bool:
    """Whether a sensor that is refused was used for long before, on a way: what is described wrongly shows when the
    vehicle first moves off.
    """
    kept, way = channel.faults, filter.start.way_to(*filter.memory.nav[:2].tolist())
    return channel.memory.used_s - kept.agreed_s >= settings.USED_S and math.hypot(*way) >= settings.WAY_M


def _residual(channel: Channel) -> Array:
    """Of the last reading over ground [m/s]; NaN where missing."""
    return ground_velocity.components(channel, channel.note[3 : 3 + channel.axes])


def _regressors(filter: FilterState, channel: Channel, age_s: float) -> tuple[Array, Array]:
    """What each explanation makes of the reading per unit of its parameters; those of clock and turns are left at 0.
    And how the turn changes the velocity north and east now [m/s^2].
    """
    memory, near = filter.memory, ground_velocity.components(channel, channel.near)[:, 3:6]
    drv, C = memory.drv, memory.nav[6:15].reshape(3, 3)
    per = drv[strapdown.PERIOD_S] if drv[strapdown.INCREMENTS] else 1.0
    rate = drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 3] / per
    x, y, z = rate.tolist()
    turning = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    arm = near @ C @ turning
    flow, speed, turn = near[:, :2], near @ memory.nav[3:6], float(C[2] @ rate)
    row = np.column_stack([np.eye(len(near)), flow, age_s * flow, speed, arm, np.zeros((len(near), 2))])
    return row, turn * np.array([-memory.nav[4], memory.nav[3]])


def _place(channel: Channel, columns: slice) -> int:
    return (channel.ground or channel.axes) + columns.start


def _places(channel: Channel, *columns: slice) -> list[int]:
    first = channel.ground or channel.axes
    return [first + i for one in columns for i in range(one.start, one.stop)]


class Explanation(NamedTuple):
    """A regression of refused velocities.

    Attributes
    ----------
    gain : float
        By how much it makes them likelier than noise alone does [nat].
    mean, covariance : ndarray
        Of its parameters.
    """

    gain: float
    mean: Array
    covariance: Array


def _constants(channel: Channel, kept: VelocityEvidence) -> float:
    """Gain of the constant, of sensor or force, that explains the readings refused on end best [nat]."""
    sds = np.repeat([settings.OFF_M_S, settings.RAMP_M_S2], 2)
    ramp = _regression(kept.sums[RUN], kept.counts[RUN], _places(channel, CURRENT, RAMP), sds)
    return max(ramp.gain, _jump(channel, kept))


def _of_unit(channel: Channel, kept: VelocityEvidence) -> tuple[Explanation, Explanation]:
    """A force that it feels wrongly, and a gyro of another scale; both begin within what the gate lets by."""
    sds = np.append(_began(channel, kept), [settings.RAMP_M_S2] * 2)
    own = kept.sums[RUN], kept.counts[RUN]
    ramp = _regression(*own, _places(channel, CURRENT, RAMP), sds)
    return ramp, _regression(*own, _places(channel, CURRENT, TURNED), np.append(sds[:2], 1.0))


def _began(channel: Channel, kept: VelocityEvidence) -> Array:
    """What the gate lets by before the first reading that it refuses, north and east [m/s]."""
    return np.full(2, math.sqrt(float(channel.limits[1]) * kept.variance))


def _jump(channel: Channel, kept: VelocityEvidence) -> float:
    """The same of a sensor that has jumped; one of another unit, or sign, is off by about the velocity itself."""
    axes, n, prior = channel.ground or channel.axes, kept.counts[RUN], settings.OFF_M_S
    return max(
        _regression(kept.sums[RUN], n, list(range(axes)), np.full(axes, prior)).gain,
        _regression(kept.sums[RUN], n, _places(channel, CURRENT), np.full(2, prior)).gain,
        _regression(kept.sums[RUN], n, _places(channel, SCALED), np.ones(1)).gain,
    )


def _description(channel: Channel, kept: VelocityEvidence) -> Explanation:
    """A wrong lever arm and clock, by all refused readings; the gain of one of them alone where that is more."""
    sds = np.array(list(of_description(range(4)).values()))
    of = kept.sums[ALL], kept.counts[ALL]
    arm, clock = _regression(*of, _places(channel, ARM), sds[:3]), _regression(*of, _places(channel, CLOCK), sds[3:])
    both = _regression(*of, _places(channel, ARM, CLOCK), sds)
    return both._replace(gain=max(arm.gain, clock.gain, both.gain))


def _regression(sums: Array, count: int, places: list[int], sds: Array) -> Explanation:
    """Bayesian linear regression; the scale of the noise is the likeliest one, of that of its description at least.

    Parameters
    ----------
    sums : ndarray, shape (p + 1, p + 1)
    count : int
    places : list of int
        Of its parameters.
    sds : ndarray
        Standard deviations that these have beforehand.
    """
    A, b, c = sums[np.ix_(places, places)], sums[places, -1], float(sums[-1, -1])
    if not count:
        return Explanation(0.0, np.zeros(len(places)), np.diag(sds**2))
    alone = noise = max(1.0, c / count)
    for _ in range(settings.ROUNDS):
        V = np.linalg.inv(A / noise + np.diag(1.0 / sds**2))
        m = V @ b / noise
        noise = max(1.0, float(c - 2.0 * m @ b + m @ A @ m) / count)
    V = np.linalg.inv(A / noise + np.diag(1.0 / sds**2))
    m = V @ b / noise
    occam = np.linalg.slogdet(V)[1] - 2.0 * float(np.log(sds).sum())
    gain = 0.5 * ((float(b @ m) - c) / noise + c / alone - count * math.log(noise / alone) + occam)
    return Explanation(gain, m, np.asarray(V, dtype=np.float64))

"""A bank of faults: what may go wrong slowly, as hypotheses with a prior, and what follows from the likeliest.

No gate sees a fault that grows slowly: the filter follows it, and every reading fits. But all innovations together tell
it, as a mean that only this fault explains (`navfilter.kernels.fault_bank`). A fault is a signature, such as a constant
of a compass, a bottom that moves ever faster, a step of a gyro's bias, and an onset. A start or a description that is
wrong has none. A fault is put in force when it is twenty thousand times likelier than none, since every onset that is
as likely, and with it all that explain the innovations of the same window, or from the start on, nearly as well. State
and covariance are then conditioned on what the innovations have told of their sizes since the onset (Friedland, 1969),
and the sensor gets states for what it is off by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, Adopt, Correct, Count
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.kernels import fault_bank as kernel
from navfilter.kernels.fault_bank import (
    DESCRIBED,
    DRIFT,
    FLOW_RAMP,
    FLOW_STEP,
    RAMP,
    SCALE,
    STATE,
    STEP,
    TABLE,
    WINDOWS,
)
from navfilter.models.error_models import ErrorModel, block_level
from navfilter.models.fault_bias import SCALE as SCALE_SD
from navfilter.models.fault_bias import (
    currents,
    descriptions,
    offset_states,
    proportions,
    with_description,
    with_offsets,
)
from navfilter.models.learned_arma import UNLEARNT, changed, is_learnt, learning_part
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Signatures that grow with the time.
GROWING = (RAMP, FLOW_RAMP, DRIFT)
#: Log odds of what cannot be. [nat]
NEVER = -1e6


def signatures(layout: Layout, channels: Sequence[Channel]) -> tuple[Array, Array]:
    """What may go wrong, a row each as `navfilter.kernels.fault_bank` has them, shape (c, TABLE); and what may be wrong
    from the start, shape (f, TABLE): the attitude, and how a velocity sensor is described. Of a description that is
    states it is these that are wrong.
    """
    rows: list[tuple[float, ...]] = []
    rate = math.log(settings.FAULTS_PER_S)

    def add(channel: int, sd: float, *kinds: tuple[int, int], read: int = 0) -> None:
        for k, (kind, place) in enumerate(kinds):
            rows.append((kind, channel, place, sd**2, rate, float(len(kinds)) if not k else 0.0, read))

    for i, channel in enumerate(channels):
        if channel.first_of(channels) < i:  # an instrument errs under all of its names
            continue
        north = channel.sensor.observes.north
        if channel.ground:
            for kind in (FLOW_STEP, FLOW_RAMP):
                add(i, settings.FLOW_SD, (kind, 0), (kind, 1), read=channel.ground)
            add(i, SCALE_SD, (SCALE, 0), read=channel.ground)
        if channel.sensor.observes is not Observable.FIX:
            for axis in range(channel.ground or channel.axes) if north is None else (north,):
                sd = settings.BIAS_SDS * math.sqrt(channel.sensor.mean_variance(axis, 1))
                sd = sd if north is None else settings.ANGLE_SD
                for kind in (STEP, RAMP) if sd > 0.0 else ():
                    add(i, sd, (kind, axis))
    drive = layout.drive
    for axis, states in enumerate(drive.biases):
        for state in states[:1]:
            sd, place = settings.BIAS_SDS * math.sqrt(drive.P0[state, state]), drive.start + int(state)
            add(-1, sd, (STATE, place))
            if axis >= 3:  # what a gyro's does so slowly is a step to the compass
                add(-1, sd, (DRIFT, place))
    if len(drive.biases) > 3 and any(channel.ground for channel in channels):
        add(-1, settings.FLOW_SD, (STATE, 3), (STATE, 4), (STATE, 5))
    faults, rate = len(rows), math.log(settings.DESCRIBED_WRONGLY)
    if rows:
        add(-1, settings.ANGLE_SD, (STATE, 6), (STATE, 7), (STATE, 8))
    for i, channel in enumerate(channels):
        if channel.ground and rows and channel.first_of(channels) == i:
            known = _description_places(channel)
            for sd, of in (
                (settings.ARM_M, (0, 1, 2)),
                (settings.LATE_S, (3,)),
                (settings.ANGLE_SD, (4, 5)),
                (settings.ANGLE_SD, (6,)),
            ):
                add(i, sd, *((STATE, known[j]) if j in known else (DESCRIBED, j) for j in of), read=channel.ground)
    table = np.array(rows).reshape(-1, TABLE)
    return table[:faults], table[faults:]


#: Parameters that are components of a description, in their order.
DESCRIPTION = (*(f"lever_arm_{axis}" for axis in "xyz"), "time_offset", *(f"misalignment_{axis}" for axis in "xyz"))


def _description_places(channel: Channel) -> dict[int, int]:
    """Where components of how a velocity sensor is described (`navfilter.models.fault_bias.FaultDescription`) stand in
    the error state, as far as they do.
    """
    sensor, start = channel.sensor, channel.group.start
    found = {component: start + at for at, component in descriptions(sensor.models, channel.period_s)}
    of = {one.name: start + channel.group.errors + i for i, one in enumerate(sensor.all_parameters()) if one.sd > 0.0}
    return found | {component: of[name] for component, name in enumerate(DESCRIPTION) if name in of}


def room(layout: Layout, channels: Mapping[str, Channel]) -> tuple[int, int]:
    """Numbers that a bank remembers, and how many more it works with; none where hardly anything may go wrong."""
    c, f = map(len, signatures(layout, list(channels.values())))
    if c < 2:  # so many columns a wide register takes
        return 0, 0
    columns = WINDOWS * c + f
    # of a transition as many rows as there are states at most
    most = max([layout.size, *(3 * channel.axes + 1 for channel in channels.values())])
    remembered = kernel.ONSETS + WINDOWS + 1 + (c + f) * TABLE + columns * (layout.size + 2 + columns)
    remembered += len(channels) * kernel.HEARD
    return remembered, most * columns


def begun(layout: Layout, channels: Mapping[str, Channel], time_s: float, before: Array | None = None) -> Array:
    """A bank whose windows all begin now. What innovations have told the one before of error models is not lost, and
    nothing that begins now is from the start.
    """
    faults, from_start = signatures(layout, list(channels.values()))
    bank = np.zeros(room(layout, channels)[0])
    if not bank.size:
        return bank
    head = len(faults), layout.size, len(channels), 0.0, -math.inf, -math.inf, 0.0, 0.0, time_s, len(from_start)
    bank[: kernel.ONSETS] = *head, _rate_sd(layout)
    heard = parts(bank)[6]
    if before is not None and before.size and before[kernel.CHANNELS] == len(heard):
        heard[:] = parts(before)[6]
    else:
        heard[:, [kernel.SQUARE, kernel.TOLD]] = kernel.DOUBLED, kernel.DOUBTED
    parts(bank)[1][:] = np.concatenate([faults, from_start])
    for w in range(WINDOWS + (before is None)):
        kernel.begin_window(bank, w, time_s)
    parts(bank)[5][WINDOWS * len(faults) :] = 0.0 if before is None else NEVER
    return bank


def _rate_sd(layout: Layout) -> float:
    """Of the white noise of an angular rate, of the noisiest gyro [rad/s]."""
    return math.sqrt(layout.drive.r[:3].max())


def parts(bank: Array) -> tuple[Array, ...]:
    """Onsets (w,), table (c, TABLE), D (n, columns), s (columns,), J (columns, columns), what is on top of the odds
    (columns,), and what is known of the channels (channels, HEARD), as views.
    """
    c, n, channels, f = bank[[kernel.SIGNATURES, kernel.STATES, kernel.CHANNELS, kernel.BEGUN]].astype(int).tolist()
    N = WINDOWS * c + f
    shapes = (WINDOWS + 1,), (c + f, TABLE), (n, N), (N,), (N, N), (N,), (channels, kernel.HEARD)
    ends = [*accumulate(map(math.prod, shapes), initial=kernel.ONSETS)]
    return tuple(bank[a:b].reshape(shape) for a, b, shape in zip(ends[:-1], ends[1:], shapes, strict=True))


def whole(J: Array) -> Array:
    """The information whose upper triangle the recursion leaves out."""
    lower = np.tril(J)
    return lower + np.tril(lower, -1).T


def transformed(bank: Array, M: Array, layout: Layout, channels: Mapping[str, Channel], time_s: float) -> Array:
    """The bank of a filter whose error states have become M times what they were; shape (n_after, n_before).

    Where other faults may happen now, because the unit has another number of biases, all windows begin anew.
    """
    table = np.concatenate(signatures(layout, list(channels.values())))
    if not bank.size or len(table) != len(parts(bank)[1]):
        return begun(layout, channels, time_s, bank)
    head, (onsets, before, D, s, J, more, heard) = bank[: kernel.ONSETS].copy(), parts(bank)
    head[[kernel.STATES, kernel.RATE_SD]] = layout.size, _rate_sd(layout)
    # a description that has become states is told by these from now on
    new = np.flatnonzero((before[:, kernel.KIND] == DESCRIBED) & (table[:, kernel.KIND] == STATE))
    D, more, at = M @ D, more.copy(), columns(bank, np.full(len(new), WINDOWS), new)
    D[table[new, kernel.PLACE].astype(int), at], more[at] = 1.0, NEVER
    return np.concatenate([part.ravel() for part in (head, onsets, table, D, s, J, more, heard)])


def problem(bank: Array, fresh: Array) -> str | None:
    """What is wrong with a bank that came from outside, in words; None when nothing is. fresh: one of the same layout,
    of the same size.
    """
    if not bank.size:
        return None
    head = [kernel.SIGNATURES, kernel.STATES, kernel.CHANNELS, kernel.BEGUN, kernel.RATE_SD]
    if not np.array_equal(bank[head], fresh[head]) or not np.array_equal(parts(bank)[1], parts(fresh)[1]):
        return "the bank of faults is not laid out as this vehicle's"  # kernels use what stands there as places
    may_be_infinite = [kernel.LOOKED_S, kernel.ODDS]  # before the first look
    if not np.isfinite(np.delete(bank, may_be_infinite)).all() or not (bank[may_be_infinite] < math.inf).all():
        return "what innovations have told of slow faults is not finite"
    return None


def look(filter: FilterState) -> Actions:
    """Look for slow faults, if it is time, after a reading has been taken; whether it was."""
    monitor, bank = filter.memory.monitor, filter.bank
    latest_s = max((channel.memory.last_s for channel in filter.channels.values()), default=-math.inf)
    due = latest_s > -math.inf and latest_s >= monitor.look_s
    if due:
        kernel.look(bank, latest_s)
    yield from judge(filter)
    return due


def judge(filter: FilterState) -> Iterator[Action]:
    """Put the likeliest faults in force, where one is believed."""
    memory = filter.memory
    bank = memory.monitor.bank
    if not len(bank) or not bank[kernel.ODDS] > kernel.BELIEVED:
        return
    bank[kernel.ODDS] = -math.inf
    if memory.monitor.is_busy:  # what stands in place of an axis is not what the filter thinks it is
        bank[:] = begun(filter.layout, filter.channels, memory.time_s, bank)
        return
    onsets, table, _, s, J = parts(bank)[:5]
    J[:] = whole(J)
    found = np.array([(_judged(bank, w, k, memory.time_s)[0], w, k) for w, k in hypotheses(bank)])
    odds, windows, begins = found.T[0], *found.T[1:].astype(int)
    # what is as likely in the likeliest window, or was wrong from the start, and that since every onset that is as
    # likely: it began at one of them, which is what is known of its size beforehand
    likely = odds > odds.max() - kernel.BELIEVED
    best = windows[np.argmax(np.where(windows < WINDOWS, odds, -math.inf))]
    there = begins[likely & np.isin(windows, (best, WINDOWS))]
    likely &= np.isin(begins, there) & np.isin(windows, np.unique(onsets, return_index=True)[1])
    # a size is there with a share of what the likeliest has: its variance beforehand is so much smaller
    shares: dict[tuple[int, int], float] = {}
    for w, k, o in zip(windows[likely], begins[likely], odds[likely], strict=True):
        for each in _whole(table, k):
            shares[w, each] = max(math.exp(o - odds.max()), shares.get((w, each), 0.0))
    of, chosen = np.array(sorted(shares)).T
    share = np.array([shares[one] for one in sorted(shares)])
    other = max(_others(filter), key=lambda one: one.odds, default=None)
    if other is not None and odds.max() < other.odds + kernel.BELIEVED:
        # who knows only the error that there was takes another one for a fault; what it was taken for has led astray
        parts(bank)[5][:] -= other.odds
        yield Correct(np.zeros(len(other.astray)), other.astray)
        yield Adopt(Change(other.channel.name, other.models))
        return
    rows, at = table[chosen], columns(bank, of, chosen)
    now = np.where(_grows(rows), np.maximum(memory.time_s - onsets[of], 1.0), 1.0)
    before = np.bincount(chosen)[chosen] * now**2 / (rows[:, kernel.VARIANCE] * share)
    M = np.linalg.inv(J[np.ix_(at, at)] + np.diag(before)).astype(np.float64)
    m = M @ s[at]
    own: dict[int, list[tuple[int, float]]] = {}
    for i, channel in enumerate(filter.channels.values()):
        mine = (rows[:, kernel.CHANNEL] == i) & (rows[:, kernel.KIND] != STATE)
        if mine.any():
            by_it = table[begins, kernel.CHANNEL] == i
            more_than_others = max(odds[by_it].max() - max(odds[~by_it].max(), 0.0), 0.0)
            yield from _opened(filter, channel.predecessor or channel, rows, mine, now, m, M, more_than_others)
            for k in np.flatnonzero(mine & (rows[:, kernel.KIND] != DESCRIBED)).tolist():
                own[k] = _state(channel.predecessor or channel, *rows[k, [kernel.KIND, kernel.PLACE]].astype(int))
    bank = memory.monitor.bank
    D, s, J, more = parts(bank)[2:6]
    done = D[:, at]
    for k, states in own.items():
        for state, unit in states:
            done[state, k] += unit * now[k]
    yield Correct(done @ m, done @ M @ done.T)
    unit = rows[:, kernel.CHANNEL] == -1
    yield Count("shifted", bool((unit & (of < WINDOWS)).any()))
    yield Count("realigned", bool((unit & (of == WINDOWS)).any()))
    # of the others is left what these do not explain
    by = M @ J[at]
    D -= done @ by
    s -= J[:, at] @ m
    J -= J[:, at] @ by
    for w, column in zip(of, at, strict=True):
        if w == WINDOWS:  # what was wrong from the start is known now
            kernel.forget(bank, column)
            more[column] = NEVER
        elif onsets[w] < memory.time_s:
            kernel.begin_window(bank, w, memory.time_s)


def _size(table: Array, signature: int) -> int:
    return int(table[signature, kernel.TOGETHER])


def _whole(table: Array, signature: int) -> list[int]:
    """All signatures of the fault that begins with this one: an instrument that errs in one axis may err in all."""
    kind, of = table[signature, [kernel.KIND, kernel.CHANNEL]]
    if kind in (STEP, RAMP):
        return np.flatnonzero((table[:, kernel.KIND] == kind) & (table[:, kernel.CHANNEL] == of)).tolist()
    return [*range(signature, signature + _size(table, signature))]


def columns(bank: Array, windows: Ints, signatures: Ints) -> Ints:
    """Where signatures in these windows stand."""
    c = int(bank[kernel.SIGNATURES])
    return np.where(windows < WINDOWS, windows * c, (WINDOWS - 1) * c) + signatures


def hypotheses(bank: Array) -> list[tuple[int, int]]:
    """Window and first signature of each fault, and of what may be wrong from the start."""
    table, c = parts(bank)[1], int(bank[kernel.SIGNATURES])
    begins = [k for k in range(len(table)) if table[k, kernel.TOGETHER] > 0.0]
    return [(w, k) for w in range(WINDOWS + 1) for k in begins if (k >= c) == (w == WINDOWS)]


def note_jump(filter: FilterState, channel: Channel, time_s: float) -> None:
    """Note that the position is set to a fix that was refused: faults that lead it so far away have become likelier,
    and their sizes are told by it.

    Without a fault fixes or position have jumped since the last one that was used, which is as rare as a fault, if that
    is likelier than that they have not. To a fault that does not explain the fix it says nothing: that may have jumped
    beside it.
    """
    bank = filter.memory.monitor.bank
    if not bank.size or channel.sensor.observes is not Observable.FIX:
        return
    onsets, table, D, s, J, more, heard = parts(bank)
    J[:] = whole(J)
    a, known = channel.axes, np.isfinite(channel.note[3 + channel.axes :])
    y, S, G = channel.note[3 : 3 + a][known], channel.S[:a][np.ix_(known, known)], channel.H[known] @ D
    rare = math.log(settings.FAULTS_PER_S * max(time_s - channel.memory.used_s, channel.period_s))
    own, told = heard[[*filter.channels].index(channel.name)], np.zeros_like(G)
    for w, first in hypotheses(bank):
        of = np.arange(first, first + _size(table, first))
        at = columns(bank, np.full(len(of), w), of)
        age_s = max(time_s - onsets[w], 1.0) if _grows(table[of]).any() else 1.0
        larger = own[kernel.BEFORE + w] or kernel.larger(own)

        def likely(left: Array, spread: Array, S: Array = larger * S) -> float:
            return float(-0.5 * (left @ np.linalg.solve(S + spread, left) + np.linalg.slogdet(S + spread)[1]))

        plain, jumped = likely(y, np.zeros_like(S)), likely(y, settings.JUMP_M**2 * np.eye(len(y))) + rare
        M = np.linalg.inv(J[np.ix_(at, at)] + np.diag(age_s**2 / table[of, kernel.VARIANCE]))
        by = G[:, at]
        if likely(y - by @ M @ s[at], by @ M @ by.T) > jumped:
            told[:, at] = by / math.sqrt(larger)
            s[at] += by.T @ np.linalg.solve(larger * S, y)
            more[at[0]] += min(plain - jumped, 0.0)
    J += told.T @ np.linalg.solve(S, told)


def _grows(table: Array) -> NDArray[np.bool_]:
    return np.isin(table[:, kernel.KIND], GROWING)


def blames_unit(filter: FilterState, channel: Channel) -> Literal["velocity", "heading"] | None:
    """Whether it is the unit that makes a sensor contradict the state, rather than a constant of that, or how it is
    described: an error of the sensor that grows looks the same. Then what contradicts what is in doubt of the unit:
    its accelerometers, or its gyros, too.
    """
    bank = filter.bank
    if not bank.size:
        return None
    table, time_s, drive = parts(bank)[1], filter.memory.time_s, filter.layout.drive
    own = channel.first_of([*filter.channels.values()])
    gyros, accelerometers = (drive.start + np.concatenate(axes) for axes in (drive.biases[:3], drive.biases[3:]))
    turns = forces = NEVER
    other = 0.0
    for w, k in hypotheses(bank):
        kind, of, place = table[k, [kernel.KIND, kernel.CHANNEL, kernel.PLACE]].astype(int)
        if of == own and kind not in GROWING:
            other = max(other, _judged(bank, w, k, time_s)[0])
        elif of < 0 and w < WINDOWS and place in gyros:
            turns = max(turns, _judged(bank, w, k, time_s)[0])
        elif of < 0 and w < WINDOWS and place in accelerometers:
            forces = max(forces, _judged(bank, w, k, time_s)[0])
    if max(turns, forces) <= other + kernel.GONE:
        return None
    return "heading" if turns > forces - kernel.BELIEVED else "velocity"


def suspected(filter: FilterState) -> list[str]:
    """What is likelier than not to have gone wrong, in words, with its odds."""
    bank = filter.bank
    if not bank.size or not bank[kernel.ODDS] > 0.0:
        return []
    table, time_s = parts(bank)[1], float(bank[kernel.LOOKED_S])
    names: list[str] = [*filter.channels]
    found: dict[str, float] = {}
    for w, k in hypotheses(bank):
        of = int(table[k, kernel.CHANNEL])
        name = "the inertial unit" if of < 0 else names[of]
        may = "may err slowly"
        if w == WINDOWS:
            name, may = ("the attitude of the start" if of < 0 else name), "may be described wrongly"
        found[f"{name} {may}"] = max(_judged(bank, w, k, time_s)[0], found.get(f"{name} {may}", 0.0))
    return [f"{what} (odds {math.exp(min(o, 20.0)):.2g} to 1)" for what, o in found.items() if o > 0.0]


def _judged(bank: Array, window: int, signature: int, time_s: float) -> Array:
    """See `navfilter.kernels.fault_bank.judged`."""
    out = np.zeros(5)
    kernel.judged(bank, window, signature, time_s, out)
    return out


class _Other(NamedTuple):
    """An error that has become another one than was learnt: its log odds [nat], the sensor, its models as described,
    and the covariance of where it has led the state to.
    """

    odds: float
    channel: Channel
    models: tuple[ErrorModel, ...]
    astray: Array


def _others(filter: FilterState) -> Iterator[_Other]:
    """Of each sensor of which something has been learnt, since the onset of each window: a process of the described
    size and correlation time, straight from one onset to the next.
    """
    now_s = filter.memory.time_s
    onsets, table, D, s, J, more, _ = parts(filter.memory.monitor.bank)
    onsets, table = onsets[:WINDOWS], table[: int(filter.bank[kernel.SIGNATURES])]
    for i, channel in enumerate(filter.channels.values()):
        before = channel.sensor.models
        models = changed(before, **UNLEARNT) if any(map(is_learnt, before)) else ()
        own = [table[:, kernel.CHANNEL] == i, table[:, kernel.KIND]]
        steps, ramps = (
            np.flatnonzero(own[0] & np.isin(own[1], kinds)) for kinds in ((STEP, FLOW_STEP), (RAMP, FLOW_RAMP))
        )
        blocks = [part.block(channel.period_s) for part in map(learning_part, models) if part is not None]
        block = max(blocks, key=lambda one: one.state_variance, default=None)
        if block is None or not (steps.size and block.state_variance > 0.0):
            continue
        tau_s = 0.5 * (block_level(block) - block.r) * channel.period_s / block.state_variance
        for begin_s in onsets:
            windows = np.argsort(onsets, kind="stable")[np.count_nonzero(onsets < begin_s) :]
            at = np.append(windows[0] * len(table) + steps, windows[:, None] * len(table) + ramps)
            nodes_s = np.append(onsets[windows], now_s)
            levels = block.state_variance * np.exp(-np.abs(nodes_s[:, None] - nodes_s) / tau_s)
            slopes = np.diff(np.eye(len(nodes_s)), axis=0) / np.maximum(np.diff(nodes_s), 1.0)[:, None]
            sizes = np.vstack([np.eye(len(nodes_s))[:1], np.diff(slopes, axis=0, prepend=0.0)])
            prior = np.kron(sizes @ levels @ sizes.T, np.eye(steps.size))
            told = np.eye(len(at)) + J[np.ix_(at, at)] @ prior
            gain = 0.5 * (s[at] @ prior @ np.linalg.solve(told, s[at]) - np.linalg.slogdet(told)[1])
            rate = math.log(settings.FAULTS_PER_S * max(now_s - begin_s, 1.0))
            yield _Other(float(gain + rate + more[at[0]]), channel, models, D[:, at] @ prior @ D[:, at].T)


def _opened(
    filter: FilterState, channel: Channel, rows: Array, mine: Array, now: Array, m: Array, M: Array, odds: float
) -> Iterator[Action]:
    """Give a sensor states for what it is off by, and for how it is described wrongly.

    rows (k, TABLE): signatures of all that is put in force; mine (k,): which are the sensor's; now (k,): what a unit of
    each has come to; m (k,), M (k, k): of their sizes; odds: by how much the sensor is likelier wrong than others.
    """
    kinds, models = rows[:, kernel.KIND], channel.sensor.models
    described = np.flatnonzero(mine & (kinds == DESCRIBED))
    if len(described):
        wrong = {int(rows[k, kernel.PLACE]): math.sqrt(M[k, k]) for k in described}
        models = with_description(models, wrong)
        yield Adopt(Change(channel.name, models, offsets=True))
        yield Count("arm-or-clock")
    mine = mine & (kinds != DESCRIBED)
    faults = [(int(kind), int(place)) for kind, place in np.unique(rows[mine][:, [kernel.KIND, kernel.PLACE]], axis=0)]
    if faults and not all(_state(channel, *fault) for fault in faults):
        speed = max(math.hypot(*filter.memory.nav[3:6].tolist()), settings.SLOW)
        # of each of its states what all onsets together come to
        sums = np.array([now * mine * (kinds == kind) * (rows[:, kernel.PLACE] == place) for kind, place in faults])
        sums[[kind == SCALE for kind, _ in faults]] *= speed
        known, grows = np.einsum("ki,ij,kj->k", sums, M, sums), np.isin([kind for kind, _ in faults], GROWING)
        density = math.sqrt(float(((sums @ m) ** 2 + known)[grows].sum()) / now[mine].max())
        channel.faults.odds, size = odds + kernel.GONE, math.sqrt(known.max())
        north = channel.sensor.observes.north
        if north is not None:
            models = with_offsets(models, size, density=density, only=north, deviates=True)
        else:
            models = with_offsets(models, size, speed if channel.moves else 0.0, density=density)
        yield Adopt(Change(channel.name, models, offsets=True))
    yield Count("jumped", bool(faults))


def _state(channel: Channel, kind: int, place: int) -> list[tuple[int, float]]:
    """Which state is the size of a fault of a sensor, and what it is per unit; none where it has none such."""
    models, period_s = channel.sensor.models, channel.period_s
    if kind in (FLOW_STEP, FLOW_RAMP):
        found = [(state, 1.0) for state, component in currents(models, period_s) if component == place]
    elif kind == SCALE:
        found = proportions(models, period_s)
    else:
        found = [(state, 1.0) for state in offset_states(models, period_s, place).tolist()[:1]]
    return [(channel.group.start + state, unit) for state, unit in found]

"""A bank of faults: what may go wrong slowly, as hypotheses with a prior, and what follows from the likeliest.

No gate sees a fault that grows slowly: the filter follows it, and every reading fits. But all innovations together tell
it, as a mean that only this fault explains (`navfilter.kernels.fault_bank`). A fault is a signature, such as a constant
of a compass, a bottom that moves ever faster, a step of a gyro's bias, and an onset. It is put in force when it is
twenty thousand times likelier than none, and with it all that explain the innovations of the same window nearly as
well. State and covariance are then conditioned on what the innovations have told of their sizes since
the onset (Friedland, 1969), and the sensor gets states for what it is off by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.filter.actions import Action, Adopt, Correct, Count
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import Actions, FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Layout
from navfilter.kernels import fault_bank as kernel
from navfilter.kernels.fault_bank import DRIFT, FLOW_RAMP, FLOW_STEP, RAMP, STATE, STEP, TABLE, WINDOWS
from navfilter.models.error_models import ErrorModel, block_level
from navfilter.models.fault_bias import currents, offset_states, with_offsets
from navfilter.models.learned_arma import UNLEARNT, changed, is_learnt, learning_part
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]


def signatures(layout: Layout, channels: Sequence[Channel]) -> Array:
    """What may go wrong, a row each as `navfilter.kernels.fault_bank` has them; shape (c, TABLE)."""
    rows: list[tuple[float, ...]] = []

    def add(channel: int, sd: float, *kinds: tuple[int, int], read: int = 0) -> None:
        for k, (kind, place) in enumerate(kinds):
            rate = math.log(settings.FAULTS_PER_S)
            rows.append((kind, channel, place, sd**2, rate, float(len(kinds)) if not k else 0.0, read))

    for i, channel in enumerate(channels):
        if channel.first_of(channels) < i:  # an instrument errs under all of its names
            continue
        north = channel.sensor.observes.north
        if channel.ground:
            for kind in (FLOW_STEP, FLOW_RAMP):
                add(i, settings.FLOW_SD, (kind, 0), (kind, 1), read=channel.ground)
        if north is not None:
            add(i, settings.ANGLE_SD, (STEP, north))
            add(i, settings.ANGLE_SD, (RAMP, north))
    drive = layout.drive
    for axis, states in enumerate(drive.biases):
        for state in states[:1]:
            sd, place = settings.BIAS_SDS * math.sqrt(drive.P0[state, state]), drive.start + int(state)
            add(-1, sd, (STATE, place))
            if axis >= 3:  # what a gyro's does so slowly is a step to the compass
                add(-1, sd, (DRIFT, place))
    return np.array(rows).reshape(-1, TABLE)


def room(layout: Layout, channels: Mapping[str, Channel], count: int | None = None) -> tuple[int, int]:
    """Numbers that a bank remembers, and how many more it works with, for so many signatures, or its own; none where
    hardly anything may go wrong.
    """
    c = len(signatures(layout, list(channels.values()))) if count is None else count
    if c < 2:  # so many columns a wide register takes
        return 0, 0
    # of a transition as many rows as there are states at most
    most = max([layout.size, *(3 * channel.axes + 1 for channel in channels.values())])
    remembered = kernel.ONSETS + WINDOWS + c * TABLE + WINDOWS * c * (layout.size + 2 + WINDOWS * c)
    remembered += len(channels) * kernel.HEARD
    return remembered, most * WINDOWS * c


def begun(layout: Layout, channels: Mapping[str, Channel], time_s: float, before: Array | None = None) -> Array:
    """A bank whose windows all begin now; what innovations have told the one before of error models is not lost."""
    table = signatures(layout, list(channels.values()))
    bank = np.zeros(room(layout, channels, len(table))[0])
    if not bank.size:
        return bank
    bank[: kernel.ONSETS] = len(table), layout.size, len(channels), 0.0, -math.inf, -math.inf, 0.0, 0.0, time_s
    heard = parts(bank)[6]
    if before is not None and before.size and before[kernel.CHANNELS] == len(heard):
        heard[:] = parts(before)[6]
    else:
        heard[:, [kernel.SQUARE, kernel.TOLD]] = kernel.DOUBLED, kernel.DOUBTED
    parts(bank)[1][:] = table
    for w in range(WINDOWS):
        kernel.begin_window(bank, w, time_s)
    return bank


def parts(bank: Array) -> tuple[Array, ...]:
    """Onsets (w,), table (c, TABLE), D (n, w c), s (w c,), J (w c, w c), what is on top of the odds (w c,), and what is
    known of the channels (channels, HEARD), as views.
    """
    c, n, channels = bank[[kernel.SIGNATURES, kernel.STATES, kernel.CHANNELS]].astype(int).tolist()
    sizes = WINDOWS, c * TABLE, n * WINDOWS * c, WINDOWS * c, (WINDOWS * c) ** 2, WINDOWS * c, channels * kernel.HEARD
    ends = [*accumulate(sizes, initial=kernel.ONSETS)]
    N = WINDOWS * c
    shapes = (WINDOWS,), (c, TABLE), (n, N), (N,), (N, N), (N,), (channels, kernel.HEARD)
    return tuple(bank[a:b].reshape(shape) for a, b, shape in zip(ends[:-1], ends[1:], shapes, strict=True))


def transformed(bank: Array, M: Array, layout: Layout, channels: Mapping[str, Channel], time_s: float) -> Array:
    """The bank of a filter whose error states have become M times what they were; shape (n_after, n_before).

    Where other faults may happen now, because the unit has another number of biases, all windows begin anew.
    """
    table = signatures(layout, list(channels.values()))
    if not bank.size or len(table) != bank[kernel.SIGNATURES]:
        return begun(layout, channels, time_s, bank)
    head, (onsets, _, D, *told) = bank[: kernel.ONSETS].copy(), parts(bank)
    head[kernel.STATES] = layout.size
    return np.concatenate([part.ravel() for part in (head, onsets, table, M @ D, *told)])


def problem(bank: Array, fresh: Array) -> str | None:
    """What is wrong with a bank that came from outside, in words; None when nothing is. fresh: one of the same layout,
    of the same size.
    """
    if not bank.size:
        return None
    head = [kernel.SIGNATURES, kernel.STATES, kernel.CHANNELS]
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
    begins = np.flatnonzero(table[:, kernel.TOGETHER] > 0.0)
    odds = np.array([[_judged(bank, w, int(k), memory.time_s)[0] for k in begins] for w in range(WINDOWS)])
    window = int(np.argmax(odds.max(axis=1)))
    likely = begins[odds[window] > odds[window].max() - kernel.BELIEVED]
    chosen = np.concatenate([np.arange(k, k + int(table[k, kernel.TOGETHER])) for k in likely])
    other = max(_others(filter), key=lambda one: one.odds, default=None)
    if other is not None and odds.max() < other.odds + kernel.BELIEVED:
        # who knows only the error that there was takes another one for a fault; what it was taken for has led astray
        parts(bank)[5][:] -= other.odds
        yield Correct(np.zeros(len(other.astray)), other.astray)
        yield Adopt(Change(other.channel.name, other.models))
        return
    grows, age_s = _grows(table[chosen]), max(memory.time_s - onsets[window], 1.0)
    now = np.where(grows, age_s, 1.0)
    at = window * len(table) + chosen
    M = np.linalg.inv(J[np.ix_(at, at)] + np.diag(now**2 / table[chosen, kernel.VARIANCE]))
    m = M @ s[at]
    own = {}
    for i in np.unique(table[chosen, kernel.CHANNEL].astype(int)):
        if i < 0:
            continue
        first, mine = list(filter.channels.values())[i], np.flatnonzero(table[chosen, kernel.CHANNEL] == i)
        channel = first.predecessor or first
        for k in mine:
            own[k] = channel, int(table[chosen[k], kernel.KIND]), int(table[chosen[k], kernel.PLACE])
        if not all(_state(*own[k]) for k in mine):
            known, off = now[mine] * np.sqrt(np.diag(M))[mine], now[mine] * np.sqrt(m**2 + np.diag(M))[mine]
            wanders = float(np.linalg.norm(off[grows[mine]])) / math.sqrt(age_s)
            of = table[begins, kernel.CHANNEL] == i
            channel.faults.odds = max(odds[window, of].max() - max(odds[window, ~of].max(), 0.0), 0.0) + kernel.GONE
            yield Adopt(Change(channel.name, _opened(filter, channel, float(known.max()), wanders), offsets=True))
        yield Count("jumped")
    bank = memory.monitor.bank
    D, s, J = parts(bank)[2:5]
    done = D[:, at]
    for k, (channel, kind, place) in own.items():
        done[_state(channel, kind, place), k] += now[k]
    yield Correct(done @ m, done @ M @ done.T)
    if -1 in table[chosen, kernel.CHANNEL]:
        yield Count("shifted")
    # of the others is left what these do not explain
    by = M @ J[at]
    D -= done @ by
    s -= J[:, at] @ m
    J -= J[:, at] @ by
    kernel.begin_window(bank, window, memory.time_s)


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
    a, known = channel.axes, np.isfinite(channel.note[3 + channel.axes :])
    y, S, G = channel.note[3 : 3 + a][known], channel.S[:a][np.ix_(known, known)], channel.H[known] @ D
    rare = math.log(settings.FAULTS_PER_S * max(time_s - channel.memory.used_s, channel.period_s))
    own, told = heard[[*filter.channels].index(channel.name)], np.zeros_like(G)
    for w, onset_s in enumerate(onsets):
        V = table[:, kernel.VARIANCE] / np.where(_grows(table), max(time_s - onset_s, 1.0), 1.0) ** 2
        larger = own[kernel.BEFORE + w] or kernel.larger(own)

        def likely(left: Array, spread: Array, S: Array = larger * S) -> float:
            return float(-0.5 * (left @ np.linalg.solve(S + spread, left) + np.linalg.slogdet(S + spread)[1]))

        plain, jumped = likely(y, np.zeros_like(S)), likely(y, settings.JUMP_M**2 * np.eye(len(y))) + rare
        for k in np.flatnonzero(table[:, kernel.TOGETHER] > 0.0):
            of = np.arange(k, k + int(table[k, kernel.TOGETHER]))
            at = w * len(table) + of
            M = np.linalg.inv(J[np.ix_(at, at)] + np.diag(1.0 / V[of]))
            by = G[:, at]
            if likely(y - by @ M @ s[at], by @ M @ by.T) > jumped:
                told[:, at] = by / math.sqrt(larger)
                s[at] += by.T @ np.linalg.solve(larger * S, y)
                more[at[0]] += min(plain - jumped, 0.0)
    J += told.T @ np.linalg.solve(S, told)


def _grows(table: Array) -> NDArray[np.bool_]:
    return np.isin(table[:, kernel.KIND], (RAMP, FLOW_RAMP, DRIFT))


def suspected(filter: FilterState) -> list[str]:
    """What is likelier than not to have gone wrong, in words, with its odds."""
    bank = filter.bank
    if not bank.size or not bank[kernel.ODDS] > 0.0:
        return []
    table, time_s = parts(filter.memory.monitor.bank)[1], float(bank[kernel.LOOKED_S])
    names: list[str] = [*filter.channels]
    found: dict[str, float] = {}
    for k in np.flatnonzero(table[:, kernel.TOGETHER] > 0.0):
        odds = max(_judged(bank, w, int(k), time_s)[0] for w in range(WINDOWS))
        of = int(table[k, kernel.CHANNEL])
        name = "the inertial unit" if of < 0 else names[of]
        found[name] = max(odds, found.get(name, 0.0))
    return [f"{name} may err slowly (odds {math.exp(min(o, 20.0)):.2g} to 1)" for name, o in found.items() if o > 0.0]


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


def _opened(filter: FilterState, channel: Channel, size: float, wanders: float) -> tuple[ErrorModel, ...]:
    """Error models of a sensor with states for what it is off by."""
    north, models = channel.sensor.observes.north, channel.sensor.models
    if north is not None:
        return with_offsets(models, size, density=wanders, only=north, deviates=True)
    speed = math.hypot(*filter.memory.nav[3:6].tolist())
    return with_offsets(models, size, max(speed, settings.SLOW), density=wanders)


def _state(channel: Channel, kind: int, place: int) -> list[int]:
    """Which state is the size of a fault of a sensor; none where it has none such."""
    models, period_s = channel.sensor.models, channel.period_s
    if kind in (FLOW_STEP, FLOW_RAMP):
        found = [state for state, component in currents(models, period_s) if component == place]
    else:
        found = offset_states(models, period_s, place).tolist()[:1]
    return [channel.group.start + state for state in found]

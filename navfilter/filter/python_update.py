"""Readings of kinds and drives that `navfilter.kernels.batch` does not know, and what it needs of those it knows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.kernels import batch, delayed_state, kalman, measurement, strapdown
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.kernels.compiling.registers import LANES
from navfilter.models.sensors.observable import Observable

if TYPE_CHECKING:
    from navfilter.filter.filter_memory import FilterMemory
    from navfilter.filter.sensor_channel import Channel
    from navfilter.models.mechanisation import Mechanisation

__all__ = ["asked", "shared", "update"]

Array = NDArray[np.float64]
#: Limits of a gate that lets nothing in; so many components has no reading.
SHUT = np.r_[np.inf, np.full(64, -1.0)]
#: Steps of the drives that are known, as the kernel takes them.
TRACED = {
    strapdown.imu_steps: strapdown.imu_traced,
    strapdown.dead_reckoning_steps: strapdown.dead_reckoning_traced,
}


def shared(
    channels: Sequence[Channel], drive: Mechanisation, folds: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Let all channels work in one array.

    Parameters
    ----------
    channels : sequence of Channel
        As they have been laid out.
    drive : Mechanisation
    folds : ndarray of int, shape (7,)
        Dimensions of a fold between readings, see ``kalman.places``.

    Returns
    -------
    bench : ndarray
    plan : ndarray of int, shape (channels + 1, PLAN)
        What stands where, see `navfilter.kernels.batch`.
    last : ndarray of int, shape (PLAN,)
        Its last row.
    """
    n, m = folds[1:3].tolist()
    *begins, end = accumulate((channel.size for channel in channels), initial=0)
    bench = np.zeros(end + m * m + max(m * n, 9 * (n + m + 9)))
    last = np.zeros(batch.PLAN, np.int64)
    last[: len(folds)], last[batch.MEM] = folds, end
    last[batch.RECORD] = max([m * m, *(channel.record_size for channel in channels)])
    rows = [channel.settle(bench, begin) for channel, begin in zip(channels, begins, strict=True)]
    if drive.steps in TRACED:
        last[batch.STEPS] = address(TRACED[drive.steps], addresses.STEPS)
        last[batch.HOLD] = address(drive.hold, addresses.HOLD)
        last[batch.CORRECTION] = address(batch.correction, addresses.CORRECTION)
        for row in rows:
            if row[batch.SIGHT]:
                row[batch.MOTION] = address(drive.moved, addresses.MOTION)
    else:
        for row in rows:
            row[batch.EQUATION] = 0
    return bench, np.array([*rows, last]), last


def asked(
    channel: Channel,
    memory: FilterMemory,
    drive: Mechanisation,
    drive_output: Array,
    reading: tuple[Array, Array],
    time_s: float,
) -> None:
    """`navfilter.kernels.batch.correction`, sensor and drive being asked for what they know.

    Parameters
    ----------
    channel : Channel
    memory : FilterMemory
        Is corrected.
    drive : Mechanisation
    drive_output : ndarray, shape (6, k + 1)
        Output rows of its errors, and its white variances.
    reading : (ndarray, ndarray)
        As the sensor's kernel takes it, and its own white variances; none: those of the error model.
    time_s : float
        When it is taken [s].
    """
    (z, own), nav, P, x = reading, memory.nav, memory.P, memory.x
    if drive.inertial:
        kalman.discount_heading(P, memory.acc, nav, memory.drv[strapdown.OWN], np.empty(2 * int(channel.dims[2])))
    channel.transition[:] = memory.acc[: len(channel.transition)]
    kalman.predict(P, nav, x, memory.acc, channel.model, channel.mem, channel.dims, channel.ticks(time_s))
    outputs, errors = drive.outputs(drive_output, memory.drv, x[: drive_output.shape[1] - 1])
    z = channel.without_errors(z, outputs, errors) if (channel.sensor.observes is Observable.RATE) else z
    if channel.turns:
        channel.rate[:] = drive.body_rate(memory.drv, errors[:3])
    channel.R[:] = channel.white
    if own.size:
        channel.R[:] = channel.lever + np.diag(own)
    if channel.moves and P[8, 8] > batch.UNSURE_HEADING:
        # second-order term of a velocity seen from a heading that is hardly known (Gelb, 1974, sec. 6.1)
        channel.R[range(channel.axes), range(channel.axes)] += 0.5 * (nav[3] ** 2 + nav[4] ** 2) * P[8, 8] ** 2
    before = channel.near.copy()
    if channel.sight is None:
        channel.kernel(z, nav, channel.rate, x[channel.parameters], channel.constants, channel.near, channel.res)
    else:
        par, since_s = x[channel.parameters], channel.lead_s + memory.time_s - time_s
        clock = float(P[channel.group.slice.stop - 1, channel.group.slice.stop - 1])
        moved = drive.motion(memory.recent, nav, memory.drv, errors)
        pushes = np.empty((3, 3))
        delayed_state.pushed(P, nav, memory.drv, drive_output, pushes, np.empty(3 * drive_output.shape[1] + 6))
        known = outputs, (memory.drv, drive_output), (clock, pushes)
        channel.sight.look(z, nav, channel.rate, par, moved, since_s, *known, channel.into)
    _hold(channel, P, before)
    first = int(channel.dims[4] + channel.dims[5])
    if channel.moves:
        measurement.hold_unread(P, channel.near, channel.res, first)
    if channel.offset:
        channel.in_proportion(z, nav, x)
        channel.unwrap(x)
    if channel.sensor.bend is not None:
        channel.sensor.bend(z, channel.near, P, first, channel.constants, channel.R)
    # a reading that was refused has not pulled at anything, nor has it let go
    let_go = channel.verdict[2] and channel.is_calm(x)
    channel.pulled[0] = channel.ticks(time_s) + (0.0 if let_go else channel.pulled[0])
    gate = SHUT[: channel.axes + 1] if channel.beyond_belief(x) else channel.gate
    update(memory, channel, channel.C, channel.R, gate, drive_output)


def update(memory: FilterMemory, channel: Channel, C: Array, R: Array, gate: Array, drive_output: Array) -> None:
    """`kalman.update`, and what follows from a reading that was used, as in `stretch.correction`: what turns with the
    heading, and what is only considered.
    """
    P, nav = memory.P, memory.nav
    before, own = tuple(nav[3:6]), memory.drv[strapdown.OWN : strapdown.OWN + 1]
    turns = bool(own[0]) and kalman.turns_along(P, nav[3], nav[4])
    if (north := channel.sensor.observes.north) is not None:
        channel.mem[channel.places[9] - batch.NOTED + batch.NORTH_WHITE] = R[north, north]
    moves = channel.moves and np.isfinite(channel.res).sum() >= 3
    kept = keep(memory, channel, drive_output)
    kalman.update(P, nav, memory.x, C, R, channel.mem, channel.dims, gate)
    channel.change[:] = 0.0
    if channel.verdict[2]:
        own[0] = max(own[0], moves * (2.0 if channel.dims[7] < 0 else 1.0))
        if moves or turns:
            kalman.turn_velocity(P, nav, before, channel.change)
            if channel.dims[7] < 0:
                kalman.turn_current(P, channel.K, channel.res, -channel.dims[7])
        elif memory.drv[strapdown.INERTIAL] and not own[0]:
            kalman.turn_tilts(P, channel.K, channel.res, channel.change[3:])
        withhold(memory, channel, drive_output, kept)


def keep(memory: FilterMemory, channel: Channel, drive_output: Array) -> list[tuple[int, Array]]:
    """Constants that a reading may tell too much of, before it corrects: where those of a lever arm begin, of the
    sensor, and of the unit, and what `past.keep_constants` notes of them; nothing where there are none.
    """
    first, sight, (begin, end) = channel.parameters.start + 9, channel.sight, channel.held
    elements, head = int(memory.drv[strapdown.CALIBRATED]), 8 + drive_output.shape[1]
    arm = (first + channel.near.shape[1] - 12 - sight.clock, 3) if sight is not None and sight.arm else (first, 0)
    own = (first + begin, end - begin) if channel.sensor.hidden else (first, 0)
    kept = []
    for at, count in (arm, own, (head - elements, elements)):
        kept.append((at, np.empty((1 + count, -(-count // LANES) * LANES))))
        delayed_state.keep_constants(memory.P, memory.x, *kept[-1])
    return kept


def withhold(memory: FilterMemory, channel: Channel, drive_output: Array, kept: list[tuple[int, Array]]) -> None:
    """Take back what a reading that was used has told of constants by the error of the state; kept: see `keep`."""
    P, x, drv = memory.P, memory.x, memory.drv
    (arm, known), *others = kept
    if len(known) > 1:
        by_arm = arm - channel.parameters.start - 9
        delayed_state.withhold(P, x, channel.near, known, by_arm, arm, drv, drive_output, np.empty(3))
    for at, known in others:
        delayed_state.withhold_hidden(P, x, channel.H, channel.K, known, at, np.empty(len(known) - 1))


def _hold(channel: Channel, P: Array, before: Array) -> None:
    """Let the slopes that are velocities follow no closer than those are known; before: of the reading before."""
    (begin, end), near = channel.held, channel.near
    if end > begin:
        held = before[:, 9 + begin : 9 + end].copy()
        measurement.hold_slopes(P, near, held, begin, 9 + channel.parameters.start, channel.lever.max())
    if channel.sight is not None and channel.sight.clock:
        measurement.hold_clock(P, near, before[:, -1].copy(), near.shape[1] - 1)

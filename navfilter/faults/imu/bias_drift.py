"""Shifts of a gyro's bias that no gate sees.

A gyro that is off by another 100 deg/h from now on turns the heading so slowly that each reading of the compass fits:
its slow error takes the difference. But all of these small differences have one sign, and the estimate of the bias adds
them up. By how much it may move is known: it is a martingale, and what it moves by in a time has the variance that the
bias has lost in that time, and what its random walk adds. One that has moved by more has **shifted**: its error model
allows no such change, and the filter, which was sure of it, follows much too slowly. So it is opened by the shift, and
the heading, the way and the slow errors by what that has done to them meanwhile. All are found again within a minute.

That variance is what the descriptions of the sensors make it. Where their NIS is above 1, it is as much larger. A
compass next to iron that nobody has described errs by the heading, and a vehicle that circles, or turns now and then,
makes a bias of that. So the axis about the vertical has only shifted if the compass runs away from the gyros along a
ramp that no deviation, no slow error and no bias that was there before explains (`ramp_beyond_deviation`). Other axes
have only shifted where no sensor was refused for long in the ten minutes before: one that is described wrongly tilts
the vehicle, too.

Accelerometers are not looked at: theirs shows in a velocity at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.faults.settings import UNDISPUTED_S
from navfilter.filter.actions import Action, Adopt, Count, Inflate
from navfilter.filter.filter_memory import FilterMemory
from navfilter.filter.model_change import Change
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.filter.state_layout import Group
from navfilter.kernels import batch
from navfilter.kernels import bias_drift as kernel
from navfilter.kernels.bias_drift import (
    ANEW,
    APART,
    BIAS,
    COLUMNS,
    HEADING,
    LATITUDE,
    LIMIT,
    LONGITUDE,
    NIS,
    TIME_S,
    VARIANCE,
    largest_change,
)
from navfilter.models.fault_bias import with_offsets

Array = NDArray[np.float64]
#: The estimates are looked at so often [s], and held against those of so many looks before [1].
EVERY_S, LOOKS = batch.LOOK_EVERY_S, 16


def fresh() -> Array:
    """What is remembered before the first look, shape (LOOKS, COLUMNS), the latest last."""
    return np.full((LOOKS, COLUMNS), math.nan)


def looking(filter: FilterState) -> tuple[Array, Array, Array]:
    """The looks so far, what is known of the gyros, and the next look, see `navfilter.kernels.bias_drift`."""
    memory, now = filter.memory, np.zeros(COLUMNS)
    now[ANEW] = memory.counts["realigned"] + memory.counts["opened"]
    return memory.monitor.bias_drift, filter.monitor.gyros(filter), now


def gyros(drive: Group, period_s: float) -> Array:
    """What is known of the gyros of an inertial unit, see `navfilter.kernels.bias_drift`."""
    known = drive.gyro_biases.copy()
    known[kernel.WALK] /= period_s
    known[kernel.LEAST] *= settings.FLOOR**2
    return known


def check_biases(filter: FilterState) -> Iterator[Action]:
    """Hold the biases against what they were, if it is time; after a reading has been taken."""
    memory = filter.memory
    latest_s = max((channel.memory.last_s for channel in filter.channels.values()), default=-math.inf)
    if latest_s == -math.inf or latest_s < memory.monitor.look_s(filter.inertial):
        return
    looks, gyros, now = looking(filter)
    state = memory.nav, memory.x, memory.P
    if not batch.check_gyro_biases(
        filter.bench, filter.plan, *state, memory.monitor.imu, memory.time_s, looks, gyros, now
    ):
        return
    g = filter.layout.drive
    places, walk = gyros[kernel.PLACE].astype(int), gyros[kernel.WALK]
    compass, kept = _compass(filter), looks
    upright, calm = np.abs(memory.nav[12:15]) > settings.UPRIGHT, _undisputed(filter, now[TIME_S])
    found = [
        f
        for f in shifted(kept, now, walk, g.P0[places - g.start, places - g.start])
        if (_ramps(compass, np.vstack([kept, now]), *f) if upright[f[0]] else calm)
    ]
    for axis, row, size in found:
        place, moved = int(places[axis]), now[BIAS + axis] - kept[row, BIAS + axis]
        yield from _open(memory, place, axis, size, kept[row:])
        if compass is not None and upright[axis] and not compass.offset:
            yield from _suspect_compass(filter, compass, place, axis, size, moved, kept[row:])
        yield Count("shifted")
    if found:
        kept, now[VARIANCE:NIS] = fresh(), np.diag(memory.P)[places]
    memory.monitor.bias_drift = np.concatenate([kept[1:], now[np.newaxis]])


def _undisputed(filter: FilterState, time_s: float) -> bool:
    """Whether no sensor has been refused for long of late: what is described wrongly tilts the vehicle, too."""
    return all(time_s - c.faults.disputed_s > UNDISPUTED_S for c in filter.channels.values())


def _compass(filter: FilterState) -> Channel | None:
    """One that has been heard just now."""
    heard = [c for c in filter.channels.values() if filter.memory.time_s - c.memory.last_s < batch.COMPASS_S]
    return next((c for c in heard if c.sensor.observes.north is not None), None)


def _ramps(compass: Channel | None, looks: Array, axis: int, row: int, size: float) -> bool:
    """Whether a compass says so, too, if there is one."""
    if compass is None:
        return True
    heard, e = np.flatnonzero(np.isfinite(looks[:, APART])), compass.group.errors
    north = compass.sensor.observes.north
    tick, P0, C = compass.group.Phi[:e, :e], compass.group.P0[:e, :e], compass.C[north]
    look = np.linalg.matrix_power(tick, round(EVERY_S / compass.period_s))
    later = np.array([C @ np.linalg.matrix_power(look, k) @ P0 @ C for k in range(len(looks))])
    noise = later[np.abs(np.subtract.outer(heard, heard))] + float(compass.white[north, north]) * np.eye(len(heard))
    time_s, heading, apart = looks[heard][:, [TIME_S, HEADING, APART]].T
    since_s, before = float(looks[row, TIME_S]), float(looks[row, VARIANCE + axis])
    shift = size / settings.DRIFT_OPENED
    return odds_of_ramp(time_s, heading, apart, noise, since_s, before, -shift) > settings.JUMP_ODDS


def odds_of_ramp(
    time_s: Array, heading: Array, apart: Array, noise: Array, since_s: float, bias: float, slope: float
) -> float:
    """Log odds that a compass has run away from gyros along a ramp since a look, against that it has not.

    Both hypotheses allow any deviation, and an error that is described wrongly: a Gauss-Markov process of unknown size
    and time constant comes on top of the description. The marginal likelihood of each is the mean over those; that the
    description is right counts as one of eight sizes.

    Parameters
    ----------
    time_s, heading, apart : ndarray, shape (k,)
        Of the looks [s]; by the compass; that less how far the gyros have turned [rad].
    noise : ndarray, shape (k, k)
        Covariance of the compass by its description [rad^2].
    since_s : float
        Time of the look.
    bias : float
        Variance of what the gyros' bias was before [rad^2/s^2].
    slope : float
        Of the ramp, as the estimate of the bias suggests; as uncertain as it is large [rad/s].

    Returns
    -------
    float
        [nat]
    """
    apart, age = np.unwrap(apart), time_s - time_s[-1]
    known = noise + settings.UNKNOWN**2 + bias * np.outer(age, age)
    for k, sd in enumerate(settings.DEVIATION, 1):
        known = known + sd**2 * np.cos(k * (heading[:, None] - heading))
    lags = np.abs(np.subtract.outer(age, age))
    S = np.array([known + sd**2 * np.exp(-lags / tau_s) for sd in (0.0, *settings.LEVELS) for tau_s in settings.TAUS_S])
    ramp = slope * np.maximum(time_s - since_s, 0.0)
    off = apart - apart[-1]

    def evidence(S: Array, off: Array) -> float:
        nis = np.einsum("i,kij,j->k", off, np.linalg.inv(S), off)
        return float(np.logaddexp.reduce(-0.5 * (nis + np.linalg.slogdet(S)[1])))

    return evidence(S + np.outer(ramp, ramp), off - ramp) - evidence(S, off)


def shifted(looks: Array, now: Array, walk: Array, begin: Array) -> list[tuple[int, int, float]]:
    """Biases that have moved by more than they may: axis, the look since which, and by how much to open them.

    Parameters
    ----------
    looks : ndarray, shape (k, COLUMNS)
        NaN where there is none.
    now : ndarray, shape (COLUMNS,)
    walk : ndarray, shape (3,)
        What their random walks add to the variances in a second.
    begin : ndarray, shape (3,)
        Their variances at the start.
    """
    least = settings.FLOOR**2 * begin
    if largest_change(looks, now, walk, least) <= LIMIT:
        return []
    moved, added = now[BIAS:VARIANCE] - looks[:, BIAS:VARIANCE], walk * (now[TIME_S] - looks[:, [TIME_S]])
    lost = np.maximum(looks[:, VARIANCE:NIS] + added - now[VARIANCE:NIS], 0.0)
    # of the readings from each look on
    nis = np.cumsum(np.append(looks[:, NIS], now[NIS])[::-1])[:0:-1] / np.arange(len(looks) + 1, 1, -1)
    larger = np.maximum(nis, 1.0)[:, np.newaxis]
    beyond = np.nan_to_num(moved**2 / np.maximum(lost * larger + least, 1e-300))
    found = []
    for axis in np.flatnonzero(beyond.max(axis=0) > LIMIT).tolist():
        row = int(np.argmax(beyond[:, axis]))
        followed = lost[row, axis] / (looks[row, VARIANCE + axis] + added[row, axis])
        found.append(
            (axis, row, settings.DRIFT_OPENED * float(moved[row, axis]) / max(float(followed), settings.DRIFT_LEAST))
        )
    return found


def _suspect_compass(
    filter: FilterState, compass: Channel, place: int, axis: int, size: float, moved: float, looks: Array
) -> Iterator[Action]:
    """Give a compass the constant that explains a shift of a gyro's bias as well: then the gyro has not shifted, and
    the heading has followed the compass. It wanders on as it has.

    Both explanations are carried as states. What tells them apart is that a vehicle whose heading turns is accelerated
    across its way.
    """
    north, error = compass.sensor.observes.north, compass.sensor.models
    turned, since_s = _turned(filter.memory, axis, size, looks)
    off = float(turned[8])
    yield Adopt(
        Change(
            compass.name,
            with_offsets(error, settings.FLOOR * abs(off), density=abs(off) / math.sqrt(since_s), only=north),
            offsets=True,
        )
    )
    done = np.zeros(len(filter.memory.P))
    done[:9], done[place], done[compass.group.start + compass.offsets] = -turned, -moved, off
    yield Inflate(slice(None), slice(None), np.outer(done, done))


def _turned(memory: FilterMemory, axis: int, size: float, looks: Array) -> tuple[Array, float]:
    """What a bias that is off by so much since the first of some looks has done to position, velocity and attitude,
    shape (9,), and how long ago that is [s]: the heading has turned ever further, and with it the velocity and the way
    made.
    """
    nav = memory.nav
    since_s = np.append(looks[:, TIME_S], memory.time_s) - looks[0, TIME_S]
    heading = -nav[6:15].reshape(3, 3)[2, axis] * size * since_s
    done = np.zeros(9)
    north = np.diff(np.append(looks[:, LATITUDE], nav[0])) * nav[15]
    east = np.diff(np.append(looks[:, LONGITUDE], nav[1])) * nav[16] * math.cos(nav[0])
    between = 0.5 * (heading[1:] + heading[:-1])
    done[:2] = -float(between @ east), float(between @ north)
    done[3:5] = heading[-1] * np.array([-nav[4], nav[3]])
    done[8] = heading[-1]
    return done, float(since_s[-1])


def _open(memory: FilterMemory, place: int, axis: int, size: float, looks: Array) -> Iterator[Action]:
    """Open a bias by a shift of this size since the first of these looks, and what that has done to the state: the
    heading has turned ever further from then on, and with it the velocity and the way made; what a slow error has taken
    of it goes with the heading, too. What it tilts is resisted.
    """
    P = memory.P
    turned, since_s = _turned(memory, axis, size, looks)
    rate = -memory.nav[6:15].reshape(3, 3)[:, axis] * size
    done = P[8] * (turned[8] / P[8, 8])
    done[:6], done[place] = turned[:6], 0.0
    yield Inflate(slice(None), slice(None), np.outer(done, done))
    yield Inflate(place, place, size**2)
    yield Inflate(range(6, 8), range(6, 8), (rate[:2] * min(since_s, settings.TILT_S)) ** 2)

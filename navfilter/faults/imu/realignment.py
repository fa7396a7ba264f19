"""Attitude and velocity set anew under way, by what the instruments say: a coarse alignment (Groves, 2013, sec. 5.6).

After a time without the drive, or one in which it was worth nothing, roll and pitch may be wrong by more than a linear
filter bears, and more than its covariance says: the vehicle has manoeuvred unseen. Gravity, turned by such a tilt, then
drives the velocity away from a DVL that is right. What knows better is at hand: the mean force of the accelerometers
shows where down is, but for what the vehicle accelerates; the DVL shows the velocity. They replace roll, pitch and
velocity, with the variance of their own errors, and nothing is left of what the old ones had in common with other
states. The heading stays: compass readings correct it as large as its error may be.

Where nothing was heard for long, neither drive nor sensors, no vehicle has gone further than it can.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings
from navfilter.faults.alternative_path import believable, follows, full_residual, most_speed, moved
from navfilter.filter.actions import Action, Announce, Count, MovePosition, RestartRest, Reweigh, Transform
from navfilter.filter.events import SamplesReplaced
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import imu_checks as kernel
from navfilter.kernels import strapdown
from navfilter.models.state import rotation_matrix, turn_to_down

Array = NDArray[np.float64]


class AccelerometerLevel(NamedTuple):
    """Where down is.

    Attributes
    ----------
    turn : ndarray, shape (3,)
        Rotation vector in n from the attitude as it is to the one that the accelerometers show [rad].
    variance : float
        Of its two horizontal components [rad^2].
    doubt : float
        NIS of the state's tilt against it.
    sd : float
        Larger one of the two that the state has for its tilt [rad].
    """

    turn: Array
    variance: float
    doubt: float
    sd: float

    @property
    def knows_better(self) -> bool:
        """Whether the state's tilt is not known, but here it is; or it is contradicted."""
        return self.sd > max(settings.SURE_SD, math.sqrt(self.variance)) or self.doubt > settings.TILT_LIMIT


def after_fault(filter: FilterState) -> Iterator[Action]:
    """While axes of the drive are left out, and when they are used again: set attitude and velocity anew where the
    tilt is not known, or not what the accelerometers say; and say that they were.

    Parameters
    ----------
    filter : FilterState
    """
    level = _level(filter)
    if level is not None and level.knows_better:
        yield from set_anew(filter)
    yield Announce(SamplesReplaced(filter.monitor.imu_monitor.replaced_s(filter.memory.monitor.imu)))


def tilted(filter: FilterState, channel: Channel, time_s: float) -> bool:
    """Whether a velocity that has been refused for `REFUSED_S` shows that the attitude is wrong: the accelerometers
    contradict it, or it is not known.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        Whose reading has just been refused.
    time_s : float
    """
    if not channel.moves or not filter.inertial or not time_s - channel.faults.rejected_since_s >= settings.REFUSED_S:
        return False
    level = _level(filter)
    return level is not None and level.knows_better


def set_anew(filter: FilterState) -> Iterator[Action]:
    """Roll, pitch and velocity by accelerometers and DVL; by one of them where there is no other."""
    level, memory, state = _level(filter), filter.memory, filter.state
    velocity, refused = state.velocity_n.copy(), _refused_velocity(filter)
    if level is None and refused is None:
        return
    n, C = filter.layout.size, state.C_nb
    M, N = np.eye(n), np.zeros((n, n))
    if level is not None:
        C = rotation_matrix(level.turn) @ C
        M[6, 6] = M[7, 7] = 0.0
        N[6, 6] = N[7, 7] = level.variance
        # what turned it about two axes may have turned it about the third
        N[8, 8] = 0.5 * float(level.turn @ level.turn)
    if refused is not None:
        off, channel = refused
        velocity = velocity + off
        M[range(3, 6), range(3, 6)] = 0.0
        attitude = N[6, 6] + N[8, 8] + memory.P[8, 8]
        N[range(3, 6), range(3, 6)] = settings.VELOCITY_SD**2 + float(velocity @ velocity) * min(attitude, 1.0)
        if channel.faults.way is None:  # whose way nobody has kept
            N[:3, :3] = np.outer(off, off) * (memory.time_s - channel.faults.refused_from_s) ** 2
        else:
            yield MovePosition(*moved(filter, channel))
            N[:2, :2] = follows(filter, channel)
        for channel in filter.channels.values():
            if channel.moves and channel.faults.aside is None:
                channel.faults.rejected_since_s, channel.faults.refused = math.nan, None
    yield RestartRest()  # a mean over what was replaced shows no rest
    yield Count("realigned")
    yield Transform(velocity, C, M, N)
    filter.monitor.imu_monitor.refer(memory.monitor.imu, memory.nav, memory.P)
    yield Reweigh()  # from the same memory it comes out the same, whenever it is recalled


def attend(filter: FilterState, missing: bool) -> Iterator[Action]:
    """Note when nothing is heard any more, and take account of it before what is heard next, be it a reading: however
    the time between is cut into pieces.

    Parameters
    ----------
    filter : FilterState
        Its memory is changed.
    missing : bool
        Whether samples are missing from here on.
    """
    memory = filter.memory
    if missing and not memory.monitor.silent:
        memory.monitor.silent = (memory.time_s, *np.diag(memory.P)[:3].tolist())
    elif memory.monitor.silent and not missing:
        yield from _bound(filter)


def _bound(filter: FilterState) -> Iterator[Action]:
    """After a time in which nothing was heard, before the next reading or sample: no more variance of velocity and
    position than the vehicle's speed gives them. The velocity that it had may have been that of any direction since.

    Parameters
    ----------
    filter : FilterState
        Its memory says since when, and the variance of the position before.
    """
    (begun_s, *position), filter.memory.monitor.silent = filter.memory.monitor.silent, ()
    seconds = filter.memory.time_s - begun_s
    memory, state = filter.memory, filter.state
    assert state.covariance is not None
    speed = float(np.linalg.norm(state.velocity_n))
    most = float(most_speed(speed, filter.vehicle.drive.max_speed_m_s))
    velocity = (0.5 * (most + speed)) ** 2
    most_variance = np.concatenate([np.array(position) + velocity * seconds**2, np.full(3, velocity)])
    shrink = np.sqrt(np.minimum(1.0, most_variance / np.diag(state.covariance)[:6]))
    if (shrink < 1.0).any():
        M = np.eye(len(memory.P))
        M[range(6), range(6)] = shrink
        yield Transform(state.velocity_n, state.C_nb, M, np.zeros_like(M))
    yield Announce(SamplesReplaced(seconds))


def _tells_tilt(channel: Channel, now_s: float) -> bool:
    """Whether a sensor that reads roll and pitch agrees with the state, and has been used lately."""
    memory, instrument = channel.faults, channel.sensor.observes.north is not None and channel.axes > 1
    return (
        instrument and memory.agrees and now_s - channel.memory.used_s < max(settings.SPEAKS_S, 2.0 * channel.period_s)
    )


def _level(filter: FilterState) -> AccelerometerLevel | None:
    """What the accelerometers show; None where they are not used, or feel more than gravity, and while an instrument
    that tells the tilt itself is used.
    """
    memory, watch = filter.memory, filter.memory.monitor.imu
    if any(_tells_tilt(channel, memory.time_s) for channel in filter.channels.values()):
        return None
    if (
        not filter.monitor.imu_monitor.active
        or (watch[3:6, kernel.HEEDED] > kernel.NOISY).any()
        or not watch[3, kernel.SEEN]
    ):
        return None
    g, state = filter.layout.drive, filter.state
    C = g.C[3:6]
    k = C.shape[1]
    force = watch[3:6, kernel.MEAN] - C @ memory.x[:k]
    gravity, size = strapdown.gravity(memory.nav[0], memory.nav[2]), float(np.linalg.norm(force))
    if not abs(size - gravity) < settings.EXCESS:
        return None
    turn = turn_to_down(state.C_nb @ (-force / size))
    drive = filter.vehicle.drive
    shaken = watch[3:6, kernel.NOISE].max() / 6.0 * drive.period_s / kernel.MEAN_S
    bias = np.einsum("ij,jk,ik->i", C, memory.P[9 : 9 + k, 9 : 9 + k], C).max()
    variance = float(drive.gap_force_sd**2 + shaken + bias) / gravity**2  # type: ignore[attr-defined]
    assert state.covariance is not None
    tilt = state.covariance[6:8, 6:8]
    doubt = float(turn[:2] @ np.linalg.solve(tilt + variance * np.eye(2), turn[:2]))
    return AccelerometerLevel(turn, variance, doubt, math.sqrt(float(np.linalg.eigvalsh(tilt)[-1])))


def _refused_velocity(filter: FilterState) -> tuple[Array, Channel] | None:
    """By how much the velocity in n is off, as a sensor says whose readings are refused."""
    for channel in filter.channels.values():
        memory, now_s = channel.faults, filter.memory.time_s
        refused = channel.moves and channel.faults.aside is None and not math.isnan(memory.rejected_since_s)
        if refused and now_s - channel.memory.last_s < settings.SPEAKS_S:
            residual = ground_velocity.components(channel, full_residual(filter, channel))
            seen = np.isfinite(residual)
            N = ground_velocity.components(channel, channel.near)[seen, 3:6]
            speed, most = math.hypot(*filter.memory.nav[3:6].tolist()), filter.vehicle.drive.max_speed_m_s
            whole = len(N) >= 2 and np.isfinite(N).all()  # none over ground where only the water track is left
            if whole and believable(residual, speed, most) and np.linalg.matrix_rank(N) >= 2:
                return np.linalg.pinv(N) @ residual[seen], channel
    return None

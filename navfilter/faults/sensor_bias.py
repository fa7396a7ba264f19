"""Agreement: what several refused readings say together that one of them must not.

A single reading beyond its gate proves nothing. Several on end, refused by one constant offset that dead reckoning
confirms between them, prove that either the state or the sensor is off by it. Which of them is decided by what came
before: a sensor that had agreed with the state for long and left it from one reading to the next has jumped, for no
vehicle can; a state that nobody had confirmed was told wrongly, or has gone astray while nobody looked.

Nothing here changes anything: each function returns what the filter has to add.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import ground_velocity, settings, velocity_fault
from navfilter.faults.heading_fault import TrackRotationFit
from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel, changes
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.kernels.fault_bank import BELIEVED, GONE
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]
GRAVITY = 9.81  # of a tilt, as an acceleration [m/s^2]; to a percent

#: What an offset can be told of, by refused readings that agree: these read the state itself.
JUDGED = (Observable.FIX, Observable.HEIGHT, Observable.HEADING, Observable.ATTITUDE, Observable.VELOCITY_BODY)
PLACE = (Observable.FIX, Observable.HEIGHT)
#: Times that differ by less are the same [s].
SAME_S = 1e-6
#: What the NIS of a fix after a dive may be, of 1, 2, 3 components [1]: of one in a hundred it is more. What dead
#: reckoning errs by beyond that the slow error of the fixes would take, up to their gate; those that agree are right.
SURFACED = chi_square_limit(0.99, np.arange(1, 4))


@dataclass(frozen=True)
class RejectionRun:
    """The readings of one sensor that have been refused on end, seen as one offset.

    Attributes
    ----------
    confirmed : bool
        The sensor had confirmed the state for long, until right before.
    jumped : bool
        It had, and was far beyond its gate at once.
    first, offset, variance : tuple of float
        Residual of the first of them; by how much they are off, and the variance of that, per axis; NaN where missing.
    seen : tuple of float
        Variance of the state that the last of them saw, per axis.
    began_s, last_s : float
        Times of the first and the last reading that agree [s].
    count : int
        How many agree.
    misfit : float
        Sum of their normalised innovations squared about the offset.
    dof : int
        Components in that sum.
    odd : bool
        The last reading did not agree.
    course : TrackRotationFit or None
        Of fixes: the way that they have made, beside the one reckoned meanwhile.
    back : int
        Of a sensor that has jumped: so many of the last ones on end agree with the state as if it had not.
    """

    confirmed: bool
    jumped: bool
    first: tuple[float, ...]
    offset: tuple[float, ...]
    variance: tuple[float, ...]
    seen: tuple[float, ...]
    began_s: float
    last_s: float
    count: int = 1
    misfit: float = 0.0
    dof: int = 0
    odd: bool = False
    back: int = 0
    course: TrackRotationFit | None = None

    @property
    def scatters(self) -> bool:
        """Whether they differ by more than the sensor's noise and dead reckoning explain."""
        return self.dof > 0 and self.misfit > _limit(self.dof)

    def agree(self, span_s: float) -> bool:
        """Whether there are enough of them, over a long enough time, and their scatter is that of the sensor."""
        return self.count >= settings.RUN_LEAST and self.last_s - self.began_s >= span_s and not self.scatters

    def from_the_first(self) -> bool:
        """Whether the sensor jumped by the whole offset at once: the first refused reading showed it already."""
        off = np.array(self.first) - np.array(self.offset)
        size = np.abs(np.array(self.offset))
        return self.jumped and bool(np.nanmax(np.abs(off), initial=0.0) <= 0.5 * np.nanmax(size, initial=0.0))


@lru_cache(maxsize=64)  # of a sensor that is refused for good it grows with each reading
def _limit(dof: int) -> float:
    return float(chi_square_limit(1.0 - settings.TURNED_DOWN, dof))


# ---------------------------------------------------------------- hearing refused readings
def is_gauge(channel: Channel) -> bool:
    """Whether it tells the height, and nothing else."""
    return channel.sensor.observes is Observable.HEIGHT


def alike(one: Channel, other: Channel) -> bool:
    """Whether two sensors confirm the same of the state."""
    if one.sensor.observes.north is not None:
        return other.sensor.observes.north is not None
    return one.sensor.observes is other.sensor.observes and one.axes == other.axes


def add_rejection(
    channel: Channel, P: Array, speed: float, time_s: float, drive_output: Array, period_s: float
) -> RejectionRun:
    """The refusals of a channel with the reading that its kernel has just refused.

    Parameters
    ----------
    channel : Channel
    P : ndarray, shape (n, n)
        Covariance now.
    speed : float
        Of the vehicle [m/s].
    time_s : float
        Of the reading [s].
    drive_output, period_s : ndarray, float
        Rows of C of the drive's error models with the white variance of a sample, and its period [s].

    Notes
    -----
    The offset is followed by a scalar Kalman filter per axis. What the sensor's coloured error and dead reckoning may
    have changed since the reading before is its process noise, the white error its measurement noise: the sum of the
    normalised innovations is then the chi-square test of the residuals about their weighted mean.
    """
    memory, a = channel.faults, channel.axes
    residual = np.array(channel.res[:a])
    white = np.array([max(variance, 1e-300) for variance in channel.R.diagonal().tolist()])
    seen = np.einsum("ij,jk,ik->i", channel.near[:, :9], P[:9, :9], channel.near[:, :9])
    before = memory.refused
    if before is None:
        near = time_s - channel.memory.used_s <= max(settings.COUNTS_S, 3.0 * channel.period_s)
        confirmed = near and memory.confirmed(channel.memory.used_s)
        # an error that grows reaches the gate just so, now and then; one that jumps is beyond it at once
        now_and_then = time_s - memory.refused_s <= settings.COUNTS_S and memory.undisputed
        at_once = not now_and_then and channel.verdict[0] > settings.AT_ONCE * channel.limits[int(channel.verdict[1])]
        first = tuple(residual.tolist())
        new = RejectionRun(confirmed, bool(confirmed and at_once), first, first, (), (), time_s, time_s)
        return _begun(new, residual, white, seen, time_s)
    dt = max(time_s - before.last_s, 0.0)
    # what other sensors have corrected meanwhile is what the variance has lost
    corrected = np.maximum(np.array(before.seen) - seen, 0.0)
    slack = corrected + channel.wander(dt) + reckoned(channel.sensor, P, speed, dt, drive_output, period_s)
    offset, variance = np.array(before.offset), np.array(before.variance) + slack
    nu, S = residual - offset, variance + white
    channel.wrap(nu)
    squares = nu**2 / S
    dof = int(np.count_nonzero(np.isfinite(squares)))
    nis = float(np.nansum(squares))
    if not before.scatters and dof and nis <= channel.limits[dof]:
        return replace(_joined(before, nu, variance, S, nis, time_s), seen=tuple(seen.tolist()))
    # one that does not agree is passed over; after two on end it is the later one that counts
    return _begun(before, residual, white, seen, time_s) if before.odd else replace(before, odd=True)


def _joined(before: RejectionRun, nu: Array, variance: Array, S: Array, nis: float, time_s: float) -> RejectionRun:
    gain = np.where(np.isfinite(nu), variance / S, 0.0)
    return replace(
        before,
        offset=tuple((np.array(before.offset) + gain * np.nan_to_num(nu)).tolist()),
        variance=tuple(((1.0 - gain) * variance).tolist()),
        last_s=time_s,
        count=before.count + 1,
        misfit=before.misfit + nis,
        dof=before.dof + int(np.count_nonzero(gain)),
        odd=False,
    )


def _begun(run: RejectionRun, residual: Array, white: Array, seen: Array, time_s: float) -> RejectionRun:
    """A run of refusals that agree with its latest one only."""
    offset, variance, state = (tuple(values.tolist()) for values in (residual, white, seen))
    return RejectionRun(run.confirmed, run.jumped, run.first, offset, variance, state, time_s, time_s)


def limits(channel: Channel, z: Array, time_s: float) -> Array:
    """The gate's limits for the next reading: closer while it is looked at whether the sensor has jumped, while it is
    astray, and after a dive; shut to one that is stale, or of a sensor that has been set aside or says nothing; whole
    where single components have been left out for long.
    """
    dived = channel.has_dived(time_s)
    if not (channel.stale or channel.faults.doubted(channel.offset) or dived):
        return channel.limits
    refused, closer = channel.faults.refused, channel.limits.copy()
    if time_s - channel.faults.partly_since_s >= channel.partly_for_s:
        closer[0] = np.inf
    held = refused is not None and refused.jumped and refused.count > 1 and not refused.scatters
    held = held and channel.sensor.observes is not Observable.FIX
    if held or channel.faults.astray:
        closer[1 : 1 + channel.axes] *= settings.HELD
    if dived:
        closer[1:4] = np.minimum(closer[1:4], SURFACED)
    if disproved(channel, time_s) and refused is not None and not refused.agree(settings.SPAN_S):
        closer[1 : 1 + channel.axes] = -1.0
    kept, scatter = channel.faults.aside, channel.faults.scatter
    worthless = scatter is not None and scatter.worthless
    if worthless or channel.stale or (kept is not None and not velocity_fault.unchanged(kept, z)):
        closer[0], closer[1 : 1 + channel.axes] = np.inf, -1.0
    return closer


def as_usual_until_s(channel: Channel) -> float:
    """Until when a reading that its gate lets in is as any other, although some may have been refused before it [s]."""
    memory, refused = channel.faults, channel.faults.refused
    if channel.faults.contested(channel.offset):
        return -math.inf
    if refused is None:
        return math.inf
    fixes = channel.sensor.observes is Observable.FIX
    left = refused.jumped or not memory.undisputed
    if refused.jumped and not fixes:
        return -math.inf
    since_s = (
        memory.rejected_since_s + settings.SPAN_S if left and channel.sensor.observes.north is not None else math.inf
    )
    return min(since_s, channel.memory.used_s + channel.dive_s) - SAME_S


def disproved(channel: Channel, time_s: float) -> bool:
    """Whether a compass has proved wrong by more than a constant and a deviation: what it reads has been refused for
    long, and it had left the state at once, or was wrong before. Then the state has not: a gyro does not turn so. What
    reads the mirror of the heading, or one axis less, is right twice in a circle, and wrong again by the next turn.
    """
    memory = channel.faults
    if channel.sensor.observes.north is None or channel.offset or memory.refused is None:
        return False
    left = memory.refused.jumped or not memory.undisputed
    return left and time_s - memory.rejected_since_s > settings.SPAN_S


def decided(channel: Channel, carried: bool = True) -> Literal["state", "sensor"] | None:
    """What is wrong, when the refused readings of a channel agree: the state where it was not confirmed, the sensor
    where it had confirmed the state and left it at once; and the state where it is a height that nothing but
    accelerometers carries, which goes further and further away from its gauge. None: they do not agree, or nobody can
    say.

    Parameters
    ----------
    channel : Channel
        As its refused reading left it.
    carried : bool
        Whether more than accelerometers tells the height.
    """
    memory, kind = channel.faults, channel.sensor.observes
    refused = memory.refused
    if (
        refused is not None
        and not carried
        and is_gauge(channel)
        and refused.last_s - memory.rejected_since_s >= settings.SPAN_S
    ):
        off = float(np.abs(channel.res[0]))
        if off > settings.GROWN * abs(refused.first[0]) and off < settings.REACH_M:
            return "state"
    if refused is None or not refused.agree(
        settings.VELOCITY_SPAN_S if kind is Observable.VELOCITY_BODY else settings.SPAN_S
    ):
        return None
    fixes = kind is Observable.FIX
    if refused.from_the_first():
        # a fix that is off by a constant says nothing more; a compass that came to agree on one late was off by more
        return None if fixes or disproved(channel, refused.began_s) else "sensor"
    if kind in PLACE and math.hypot(*np.nan_to_num(refused.offset)) > settings.REACH_M:
        return None
    unconfirmed = not memory.confirmed(channel.memory.used_s)
    # after a dive fixes beat what was reckoned meanwhile
    return "state" if unconfirmed or (fixes and not refused.confirmed) else None


def was_right(filter: FilterState, channel: Channel) -> bool:
    """Whether a sensor that is refused was used for long before, on a way: what is described wrongly shows when the
    vehicle first moves off.
    """
    kept, way = channel.faults, filter.start.way_to(*filter.memory.nav[:2].tolist())
    return channel.memory.used_s - kept.agreed_s >= settings.USED_S and math.hypot(*way) >= settings.WAY_M


# ---------------------------------------------------------------- the state was wrong
def opened_state(channel: Channel, refused: RejectionRun, moved_m: float, held: bool, carried: bool) -> Array:
    """Variance to add to the navigation states, shape (9, 9), when a sensor's readings together beat them.

    The component that the sensor sees may be wrong by the offset that they agree on, and nothing else is: so the
    correlations stay what they are, and become small beside the new variance. What the wrong component has done since
    the start follows it.

    Parameters
    ----------
    channel : Channel
        As its refused reading left it.
    refused : RejectionRun
    moved_m : float
        Distance from the start [m].
    held : bool
        Whether another sensor tells the height, and agrees.
    carried : bool
        Whether more than accelerometers tells the height. Else one that has gone away from its gauge went with a
        vertical velocity that was off by as much as it has grown in that time.
    """
    V = np.zeros((9, 9))
    offset, seen = np.nan_to_num(refused.offset), np.isfinite(channel.res[: channel.axes])
    size = np.where(seen, offset**2 + np.array(refused.variance), 0.0)
    fits = np.array(refused.variance) + np.array(refused.seen)
    kind = channel.sensor.observes
    north = channel.sensor.observes.north
    if north is not None:
        # heading and velocity are turned (`course.turned`); the way made good may be turned by as much
        V[range(2), range(2)] = (2.0 * math.sin(0.5 * min(abs(float(offset[north])), math.pi)) * moved_m) ** 2
        # a tilt that fits is not opened
        beyond = offset**2 > channel.limits[1] * fits
        tilt = np.where(beyond & (np.arange(channel.axes) != north), size, 0.0)
        V[6:8, 6:8] = channel.near[:, 6:8].T @ (tilt[:, None] * channel.near[:, 6:8])
        return V
    first = 0 if kind in PLACE else 3
    if kind is Observable.FIX:
        # a height that fits is not opened, nor one that another sensor holds while it is the place that does not fit
        beyond = offset**2 > channel.limits[1:4] * (fits + channel.slow)
        size[2] = size[2] if beyond[2] and not (held and beyond[:2].any()) else 0.0
    N = channel.near[:, first : first + 3]
    V[first : first + 3, first : first + 3] = N.T @ (size[:, None] * N)
    if is_gauge(channel) and not carried:
        span_s = refused.last_s - channel.faults.rejected_since_s
        # as the time, or as its square: the velocity is one or two times the mean one
        off, mean = offset @ N, offset @ N / span_s
        V[:3, 3:6], V[3:6, :3] = 1.5 * np.outer(off, mean), 1.5 * np.outer(mean, off)
        V[3:6, 3:6] = (1.5**2 + 0.5**2) * np.outer(mean, mean)
    if kind is Observable.VELOCITY_BODY and channel.ground != ground_velocity.AXES:
        known = ground_velocity.components(channel, seen).astype(bool)
        A = ground_velocity.as_velocity(channel, known)
        off, variance = (ground_velocity.components(channel, np.array(v))[known] for v in (offset, refused.variance))
        V[3:6, 3:6] = np.outer(A @ off, A @ off) + A @ (variance[:, None] * A.T)
    if kind is Observable.VELOCITY_BODY:
        V[:3, :3] = V[3:6, 3:6] * (refused.last_s - refused.began_s) ** 2
    return V


# ---------------------------------------------------------------- the sensor was wrong
def offset_places(channel: Channel) -> NDArray[np.int64]:
    """Where the constants of a sensor that has jumped stand in the error state; empty where it has none."""
    return np.asarray(channel.group.start + channel.offsets)


def rather_none(x: Array, P: Array, sds: Array) -> tuple[Array, Array, Array]:
    """Of each of some constants, if it were the only one: how much more density it has at zero than beforehand [nat],
    its mean and its variance, as shares of those beforehand.

    Parameters
    ----------
    x, P, sds : ndarray, shape (k,), (k, k), (k,)
        Their estimates and covariance, and their standard deviations beforehand.
    """
    shares, axes = np.linalg.eigh(P / np.outer(sds, sds))
    information = axes / np.maximum(shares, np.finfo(float).eps) @ axes.T  # as shares of those at first
    told, alone = information @ (x / sds), np.diag(information)
    return 0.5 * (np.log(alone) - told**2 / alone), told / alone, 1.0 / alone


def is_none(channel: Channel, x: Array, P: Array, time_s: float) -> bool:
    """Whether a sensor that has jumped rather has no constants: each of them, if it were the only one, has more density
    at zero than when it was put in force (Savage and Dickey's ratio of the two hypotheses: Dickey, 1971), by more than
    the odds at which that was done; and one of them by what makes a fault none: of a constant that may as well be the
    state's, as a gauge's of the height, hardly more is known than before, which says nothing.

    Parameters
    ----------
    channel : Channel
        Its memory takes note.
    x : ndarray, shape (n - 9,)
        Error states.
    P : ndarray, shape (n, n)
        Covariance.
    time_s : float
        Of its reading that has just been used [s].
    """
    places, sds = offset_places(channel), np.sqrt(np.diag(channel.group.P0)[channel.offsets])
    gained, mean, variance = rather_none(x[places - 9], P[np.ix_(places, places)], sds)
    wanders = np.diag(channel.group.Q)[channel.offsets] / sds**2 / channel.period_s
    odds = channel.faults.odds
    # where nothing else was as likely: not that it has never been there, but that it has ended
    if wanders.any() and odds > BELIEVED:
        of_late = _gained_of_late(channel, mean, variance, wanders, time_s)
        gained, odds = np.where(wanders > 0.0, of_late - GONE, gained), 0.0
    return bool((gained > odds).all() and gained.max() > GONE)


def _gained_of_late(channel: Channel, mean: Array, variance: Array, wanders: Array, time_s: float) -> Array:
    """Of constants that wander, the same from when on it is most that they have been none: what every reading has
    added to the density at zero, summed (Page, 1954).

    Parameters
    ----------
    channel : Channel
        Its memory takes note.
    mean, variance : ndarray, shape (k,)
        Of each, if it were the only one.
    wanders : ndarray, shape (k,)
        Variance by which each changes in a second.
    time_s : float
        Of the reading [s].
    """
    kept, gained = channel.faults, np.zeros(len(mean))
    if len(kept.gone) == len(mean):
        before, was, spread, then_s = kept.gone.T
        spread = spread + wanders * (time_s - then_s)
        gained = np.maximum(before, 0.0) + 0.5 * (np.log(spread / variance) + was**2 / spread - mean**2 / variance)
    kept.gone = np.column_stack([gained, mean, variance, np.full(len(mean), time_s)])
    return gained


def is_back(channel: Channel, constant: Array, P: Array) -> bool:
    """Whether a reading that is refused beside the constants of its sensor agrees with the state without them.

    Parameters
    ----------
    channel : Channel
        As its refused reading left it.
    constant : ndarray, shape (axes,)
        By how much it is off by those.
    P : ndarray, shape (n, n)
        Covariance.
    """
    near, plain = channel.near[:, :9], channel.res + constant
    channel.wrap(plain)
    seen = np.einsum("ij,jk,ik->i", near, P[:9, :9], near)
    if channel.faults.either and not float(constant @ constant) > channel.limits[1] * float(seen.sum()):
        return False  # the state is not known well enough to tell whether it is the gauge that was off
    meanwhile = (settings.AGAIN * constant) ** 2
    squares = plain**2 / (seen + np.diag(channel.R) + _usual_wander(channel) + meanwhile)
    dof = int(np.count_nonzero(np.isfinite(squares)))
    return dof > 0 and float(np.nansum(squares)) <= float(channel.limits[dof])


def _usual_wander(channel: Channel) -> Array:
    """Variance by which its coloured error may ever change but for the constants of a jump, shape (axes,)."""
    C = channel.C.copy()
    C[:, channel.offsets] = 0.0
    step, most = changes(channel.group, C)
    return np.asarray(np.minimum(step * 1e9, most))


# ---------------------------------------------------------------- dead reckoning meanwhile
def reckoned(sensor: Sensor, P: Array, speed: float, dt: float, drive_output: Array, period_s: float) -> float:
    """Variance by which dead reckoning may err in a time, in the units of a sensor; `kernels.noise_scale` has it,
    too."""
    if sensor.observes.north is not None:
        return float(_lasting(P, drive_output)[:3].max() * dt**2 + drive_output[:3, -1].max() * period_s * dt)
    if sensor.observes is Observable.VELOCITY_BODY:
        tilt = GRAVITY**2 * max(P[6, 6], P[7, 7])
        return float((_lasting(P, drive_output)[3:].max() + tilt) * dt**2) + _walked(dt, drive_output, period_s)
    return float((np.diag(P)[3:6].max() + speed**2 * P[8, 8]) * dt**2)


def _walked(dt: float, drive_output: Array, period_s: float) -> float:
    """Variance by which the noise of accelerometers does [m^2/s^2]."""
    return float(drive_output[3:, -1].max() * period_s * dt)


def _lasting(P: Array, drive_output: Array) -> Array:
    """Variances of the errors of a drive's axes that last."""
    C = drive_output[:, :-1]
    m = 9 + C.shape[1]
    return np.asarray(np.einsum("ij,jk,ik->i", C, P[9:m, 9:m], C))

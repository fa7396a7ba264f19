"""The clock of a velocity against an inertial unit: both carried along by the gyros, in a frame that does not turn."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from navfilter.check.clock_offsets import LEAST_S, RATE, ClockFit
from navfilter.check.course_fit import without_gaps
from navfilter.check.series import factors, integral, vector, window_edges
from navfilter.models.mission import Array, Stream

#: An inertial unit is averaged to this [Hz]: no vehicle turns so far within that that the order of turns counts.
RATE_HZ = 25.0
#: Velocities are averaged over windows of these lengths [s], not below two readings; that with the surest rate counts:
#: the longer, the less the noise of the velocity, the more what the unit errs by.
WINDOWS_S = (2.0, 4.0, 8.0)
#: Readings closer than this are averaged first [s].
DENSE_S = 0.4
#: Fewer windows, or more left unexplained, say nothing [1].
LEAST_WINDOWS, LOOSE = 60, 0.75
#: Differences for slopes, of a delay [s] and of a rate [1].
BY_S, BY_RATE = 0.1, 2e-4


class _Unit(NamedTuple):
    """What the gyros and accelerometers say: times, attitude against the beginning as quaternions, rates, the integral
    of the specific force in that frame, and what a bias of each axis adds to that, gyros and accelerometers, (6, n, 3).
    """

    time_s: Array
    turned: Array
    rate: Array
    gained: Array
    biased: Array


def felt_clock(imu: Stream, time_s: Array, velocity: Array, arm_m: Array) -> ClockFit | None:
    """How a velocity's stamps lie against those of an inertial unit; None where they have too little in common.

    Parameters
    ----------
    imu : Stream
    time_s : ndarray, shape (n,)
        Of the velocity [s].
    velocity : ndarray, shape (n, 3)
        In the axes of the unit [m/s].
    arm_m : ndarray, shape (3,)
        Where it is measured, from the unit [m].

    Notes
    -----
    With C the attitude by the gyros, C v - int C f dt is a straight line in time but for what tilts, biases and the
    Earth's rotation bend: its second differences over windows are small and steady, if v has the clock of the unit.
    Delay and rate are what makes them least, beside scale and mounting of the velocity and biases (Gauss-Newton).
    """
    unit = _carried(imu)
    inside = (time_s > unit.time_s[0] + LEAST_S) & (time_s < unit.time_s[-1] - LEAST_S)
    time_s, velocity = time_s[inside], velocity[inside]
    if time_s.size < LEAST_WINDOWS:
        return None
    step_s = float(np.median(np.diff(time_s)))
    many = max(1, int(DENSE_S / max(step_s, 1e-9)))
    if many > 1:
        whole = len(time_s) // many * many
        time_s = time_s[:whole].reshape(-1, many).mean(axis=1)
        velocity = velocity[:whole].reshape(-1, many, 3).mean(axis=1)
    begin, sure = None, []
    for length_s in WINDOWS_S:
        if length_s >= 1.9 * many * step_s:
            begin, fit = _fit(unit, time_s, velocity, arm_m, length_s, begin)
            sure += [fit] if fit is not None else []
    return min(sure, key=lambda fit: fit.rate_sd) if sure else None


def _carried(imu: Stream) -> _Unit:
    step = max(1, round(1.0 / (RATE_HZ * float(np.median(np.diff(imu.time_s))))))
    rows = slice(None, len(imu) // step * step)
    blocks = [imu.time_s[rows], vector(imu, "rate_x_rad_s")[rows], vector(imu, "force_x_m_s2")[rows]]
    time_s, rate, force = (np.nan_to_num(part).reshape(-1, step, *part.shape[1:]).mean(axis=1) for part in blocks)
    turns = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s)[:, np.newaxis]).as_quat()
    turned = _products(np.vstack([[0.0, 0.0, 0.0, 1.0], turns]))
    attitude = Rotation.from_quat(turned)
    felt, axes = attitude.apply(force), attitude.as_matrix()
    swept = [integral(time_s, axes[:, :, i]) for i in range(3)]
    biased = np.array([*(integral(time_s, np.cross(part, felt)) for part in swept), *swept])
    return _Unit(time_s, turned, rate, integral(time_s, felt), biased)


def _products(turns: Array) -> Array:
    """Of rotations, each with all before it: in as many rounds as the logarithm of their number has."""
    done, by = turns.copy(), 1
    while by < len(done):
        done[by:] = (Rotation.from_quat(done[:-by]) * Rotation.from_quat(done[by:])).as_quat()
        by *= 2
    return done


def _fit(
    unit: _Unit, time_s: Array, velocity: Array, arm_m: Array, length_s: float, begin: tuple[float, float] | None
) -> tuple[tuple[float, float] | None, ClockFit | None]:
    """Where it begins, and the fit with windows of one length."""
    edges = window_edges(time_s[0], time_s[-1] - 3.0 * length_s, 0.5 * length_s)
    edges = without_gaps(edges, time_s, window_s=3.0 * length_s, gap_s=1.5 * length_s)
    if edges.size < LEAST_WINDOWS:
        return begin, None
    middle = 0.5 * float(time_s[0] + time_s[-1])
    signs = np.cumprod(np.where(np.sum(unit.turned[1:] * unit.turned[:-1], axis=1) < 0.0, -1.0, 1.0))
    quaternions = unit.turned * np.concatenate([[1.0], signs])[:, np.newaxis]

    def bent(series: Array) -> Array:
        """Second differences of means over windows, (k, 3)."""
        way = integral(time_s, series)
        at = [np.column_stack([np.interp(edges + k * length_s, time_s, column) for column in way.T]) for k in range(4)]
        return np.asarray((at[3] - 3.0 * at[2] + 3.0 * at[1] - at[0]) / length_s)

    def at_true(late_s: float, rate: float) -> tuple[Rotation, Array, Array]:
        """Attitude, velocity of the unit itself, and what it gained, when the readings were taken."""
        true_s = time_s - late_s - rate * (time_s - middle)

        def there(series: Array) -> Array:
            return np.column_stack([np.interp(true_s, unit.time_s, column) for column in series.T])

        return Rotation.from_quat(there(quaternions)), velocity - np.cross(there(unit.rate), arm_m), there(unit.gained)

    def left(late_s: float, rate: float) -> Array:
        attitude, v, gained = at_true(late_s, rate)
        return bent(attitude.apply(v) - gained)

    def nuisances(late_s: float, rate: float) -> Array:
        """A scale and a turn of the velocity, what the Earth's rotation bends, and biases, as columns."""
        attitude, v, _ = at_true(late_s, rate)
        true_s = time_s - late_s - rate * (time_s - middle)
        parts = [bent(attitude.apply(v)), bent(attitude.apply(np.cross([0.0, 0.0, 1.0], v)))]
        parts += [np.tile(axis, (edges.size, 1)) for axis in np.eye(3)]
        for series in unit.biased:
            parts.append(bent(np.column_stack([np.interp(true_s, unit.time_s, column) for column in series.T])))
        return np.column_stack([part.ravel() for part in parts])

    grid = [(float(s), float(r)) for s in np.linspace(-LEAST_S, LEAST_S, 11) for r in np.linspace(-RATE, RATE, 9)]
    begin = begin or min(grid, key=lambda one: _power(left(*one)))
    late_s, rate = begin
    spread = np.full(2, np.inf)
    for _ in range(3):
        here, beside = left(late_s, rate), nuisances(late_s, rate)
        slopes = [(left(late_s + BY_S, rate) - left(late_s - BY_S, rate)) / (2.0 * BY_S)]
        slopes += [(left(late_s, rate + BY_RATE) - left(late_s, rate - BY_RATE)) / (2.0 * BY_RATE)]
        columns = np.column_stack([*(part.ravel() for part in slopes), beside])
        best, sds = factors(columns, -here.ravel())
        late_s, rate, spread = late_s + float(best[0]), rate + float(best[1]), sds[:2]
        if abs(late_s) > LEAST_S or abs(rate) > 2.0 * RATE:
            return begin, None
    power = _power(nuisances(late_s, rate)[:, 0])

    def unexplained(late_s: float, rate: float) -> float:
        here, beside = left(late_s, rate).ravel(), nuisances(late_s, rate)
        return _power(here - beside @ np.linalg.lstsq(beside, here, rcond=None)[0]) / power

    delays = late_s + np.linspace(-0.5, 0.5, 9) * abs(rate) * (time_s[-1] - time_s[0])
    without = min(unexplained(float(s), 0.0) for s in delays)
    fit = ClockFit(late_s, float(spread[0]), rate, float(spread[1]), unexplained(late_s, rate), without)
    return begin, fit if fit.left < LOOSE else None


def _power(series: Array) -> float:
    return float(np.sum(series**2))

"""What several streams say of one motion: speeds and headings on two clocks, and accelerometers against a velocity.

The clock of a velocity against an inertial unit: both carried along by the gyros, in a frame that does not turn.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from navfilter.check.course import (
    DRIFT_S,
    LEAST_S,
    RATE,
    SURE,
    ClockFit,
    fitted_clock,
    mounting_of,
    noisy_stretch_finding,
    stretched_finding,
    through_water,
)
from navfilter.check.course_fit import (
    Complex,
    Series,
    factors,
    heading_of,
    integral,
    jackknife,
    unwrapped,
    vector,
    window_edges,
    without_gaps,
)
from navfilter.check.finding import Finding
from navfilter.models.mission import Array, Mission, Stream
from navfilter.models.vehicle import Vehicle

#: An inertial unit is averaged to this [Hz]: no vehicle turns so far within that that the order of turns counts.
RATE_HZ = 25.0
#: Velocities are averaged over windows of these lengths [s], not below two readings; that with the surest rate counts:
#: the longer, the less the noise of the velocity, the more what the unit errs by.
WINDOWS_S = (2.0, 4.0, 8.0)
#: Readings closer than this are averaged first [s].
DENSE_S = 0.4
#: Fewer windows, or more left unexplained, say nothing [1].
LEAST_WINDOWS, LOOSE_FELT = 60, 0.75
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
            begin, fit = _felt_fit(unit, time_s, velocity, arm_m, length_s, begin)
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


def _felt_fit(
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
    return begin, fit if fit.left < LOOSE_FELT else None


def _power(series: Array) -> float:
    return float(np.sum(series**2))


#: Clocks are compared over windows of this length, speeds over longer ones [s].
TURN_S, WAY_S = 2.0, 4.0
#: A delay of less is none [s].
LATE_S = 0.3
#: A clock that runs at another rate leaves so little unexplained once that is known [1].
CLEAN = 0.01
#: What leaves more unexplained tells no delay either [1].
LOOSE = 0.05
#: Accelerations are compared over windows of this length [s], and say something from this correlation on.
WINDOW_S, ALIKE = 1.0, 0.45
#: Mirrored axes fit by so much better than any that are turned [1].
MIRRORED = 1.5
#: So far off are axes that are turned [rad].
TURNED = math.radians(25.0)
#: A clock is right that surely, by so many sds, runs by less than this too fast or too slow [1].
RIGHT_SDS, RIGHT = 3.0, 1e-3
#: Of gravity [m/s^2].
GRAVITY = 9.81
#: Quarter turns about the down axis -> how the axes have to be read.
_QUARTERS = {1: "-y,x,z", 2: "-x,-y,z", 3: "y,-x,z"}


def clock_finding(
    name: str, what: str, reference: Series, other: Series, window_s: float, late_s: float | None = None
) -> Iterator[Finding]:
    """That a stream is late, or its clock runs at another rate, against another one that it follows.

    Parameters
    ----------
    name : str
        Of the stream.
    what : str
        What is compared, as two parts of a sentence around ``{}``.
    reference, other : (ndarray, ndarray)
        Times [s] and values of the same thing.
    window_s : float
    late_s : float, optional
        By how much it is late where that is known better [s].
    """
    fit = fitted_clock(reference, other, window_s)
    if fit is None:
        if late_s is not None and abs(late_s) > LATE_S:
            yield late_finding(name, what, late_s)
        return
    step_s, span_s = float(np.median(np.diff(other[0]))), float(other[0][-1] - other[0][0])
    explains = fit.left < CLEAN and fit.left < 0.5 * fit.left_without
    if explains and abs(fit.rate) > SURE * fit.rate_sd and abs(fit.rate) * span_s > DRIFT_S:
        yield stretched_finding(name, what, fit, step_s, span_s)
    elif late_s is not None:
        if abs(late_s) > LATE_S:
            yield late_finding(name, what, late_s)
    elif fit.left < LOOSE and abs(fit.late_s) > max(LATE_S, SURE * fit.late_sd):
        yield late_finding(name, what, fit.late_s)


def late_finding(name: str, what: str, late_s: float) -> Finding:
    """That a stream is so late [s], with a prior that is wide enough for the filter to find it."""
    text = what.format(f"{abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'}") + "."
    sd = max(0.3, math.ceil(10.0 * abs(late_s)) / 10.0)
    cure = f"Set time.offset_s = {-late_s:.2f} on top of what it is now; or let the filter find it: "
    return Finding("warning", "delay", name, text, f"{cure}time_offset_sd_s = {sd:g} in vehicle.toml.")


def pair_findings(mission: Mission, vehicle: Vehicle | None = None) -> Iterator[Finding]:
    """Clocks of streams that show the same turns, without a gyro, or the same speed."""
    inertial = any("force_x_m_s2" in stream.columns for stream in mission.streams.values())
    turns: dict[str, Series] = {}
    ways: dict[str, Series] = {}
    for name, stream in mission.streams.items():
        angle = heading_of(stream)
        if angle is not None and not inertial and "field_x_T" not in stream.columns:
            turns[name] = unwrapped(stream.time_s, angle)
        if (speed := _speed(stream)) is not None:
            known = np.isfinite(speed)
            ways[name] = stream.time_s[known], integral(stream.time_s[known], speed[known])
    for kind, window_s, of in (("heading", TURN_S, turns), ("speed", WAY_S, ways)):
        for (first, a), (second, b) in itertools.combinations(of.items(), 2):
            if min(a[0].size, b[0].size) >= 20 and through_water(vehicle, first) == through_water(vehicle, second):
                yield from clock_finding(second, f"its {kind} is {{}} against that of {first}", a, b, window_s)


def _speed(stream: Stream) -> Array | None:
    for columns in (("v_x_m_s", "v_y_m_s"), ("v_north_m_s", "v_east_m_s"), ("wheel_speed_m_s",), ("ground_speed_m_s",)):
        if all(column in stream.columns for column in columns):
            return np.sqrt(sum((stream.column(column) ** 2 for column in columns), np.zeros(len(stream))))
    return None


def felt_clocks(mission: Mission, vehicle: Vehicle | None) -> dict[str, tuple[str, ClockFit]]:
    """By velocity the inertial unit that it is held against, and how its stamps lie: speeding up, slowing down and
    turning are felt on another clock.
    """
    found: dict[str, tuple[str, ClockFit]] = {}
    units = [(n, s) for n, s in mission.streams.items() if "force_x_m_s2" in s.columns]
    for name, stream in mission.streams.items():
        for unit, imu in units if "v_x_m_s" in stream.columns else ():
            mounting, arm_m = mounting_of(name, vehicle)
            v = vector(stream, "v_x_m_s") @ mounting.T
            known = np.asarray(np.isfinite(v).all(axis=1))
            known[1:] &= np.diff(stream.time_s) > 0.0
            fit = felt_clock(imu, stream.time_s[known], v[known], np.array([arm_m.real, arm_m.imag, 0.0]))
            if fit is not None and (name not in found or fit.rate_sd < found[name][1].rate_sd):
                found[name] = unit, fit
    return found


def speeding_up_findings(mission: Mission, clocks: dict[str, tuple[str, ClockFit]]) -> Iterator[Finding]:
    """Velocities whose stamps are stretched, see `felt_clocks`."""
    for name, (unit, fit) in clocks.items():
        what = f"the velocity is {{}} against the accelerations of {unit}"
        yield from noisy_stretch_finding(name, what, fit, mission.streams[name].time_s)


def is_right(fit: ClockFit) -> bool:
    """Whether a clock is surely not stretched by as much as matters."""
    return abs(fit.rate) + RIGHT_SDS * fit.rate_sd < RIGHT


class _Turned(NamedTuple):
    """force = factor * acceleration, both horizontal and complex (forward + i right), and how well that fits."""

    alike: float
    angle: float
    sd: float


def axes_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Accelerometers whose horizontal axes are not those of a velocity: speeding up, slowing down and turning tell."""
    velocities = [(n, s) for n, s in mission.streams.items() if "v_x_m_s" in s.columns]
    for name, imu in mission.streams.items():
        if "force_x_m_s2" not in imu.columns:
            continue
        for other, stream in velocities:
            motion = _motion(imu, stream, *mounting_of(other, vehicle))
            if motion is None:
                continue
            length_s = max(WINDOW_S, 2.0 * float(np.median(np.diff(motion.time_s))))
            edges = motion.edges(length_s, length_s)
            if edges.size < 60:
                continue
            moved = _changes(edges, length_s, motion.time_s, motion.moved())
            as_read, *others = (_changes(edges, length_s, imu.time_s, felt) for felt in motion.felt())
            straight, mirrored = (
                _fit(moved, as_read),
                max((_fit(moved, other) for other in others), key=lambda f: f.alike),
            )
            if max(straight.alike, mirrored.alike) < ALIKE:
                continue
            if mirrored.alike > MIRRORED * straight.alike:
                text = f"its horizontal axes are mirrored: it speeds up and turns otherwise than {other} says."
                cure = "Gyro z is positive clockwise, force y to the right: check the signs of axes for both."
                yield Finding("error", "axes", name, text, cure)
            elif abs(straight.angle) > max(TURNED, SURE * straight.sd):
                quarter = round(-straight.angle / (0.5 * math.pi)) % 4
                text = f"its forces are turned by {math.degrees(-straight.angle):+.0f} deg about the down axis"
                cure = f'Set axes = "{_QUARTERS[quarter]}" on top of what it is now' if quarter else "Set mounting_deg"
                cure += f", for rates and forces of [streams.{name}]; or {other} is turned by the opposite."
                yield Finding("error", "axes", name, f"{text} against how {other} speeds up and turns.", cure)


class _Motion(NamedTuple):
    """Horizontal accelerations as complex numbers x + iy, and their changes from window to window: biases are slow.

    Attributes
    ----------
    imu : Stream
    time_s, body : ndarray
        Of the velocity.
    arm_m : complex
        Where it is measured.
    """

    imu: Stream
    time_s: Array
    body: Complex
    arm_m: complex

    def edges(self, length_s: float, step_s: float) -> Array:
        """Starts of pairs of windows across no gap."""
        begin, end = max(self.time_s[0], self.imu.time_s[0]), min(self.time_s[-1], self.imu.time_s[-1])
        edges = window_edges(begin, end - 2.0 * length_s, step_s)
        return without_gaps(edges, self.time_s, window_s=2.0 * length_s, gap_s=3.0 * length_s)

    def moved(self) -> Complex:
        """What grows by the acceleration, by the velocity and the gyro: at the times of the velocity."""
        turn = np.interp(self.time_s, self.imu.time_s, self._turn())
        rate = np.gradient(turn, self.time_s)
        body: Complex = self.body - 1j * rate * self.arm_m
        return body + integral(self.time_s, 1j * rate * body)

    def felt(self) -> tuple[Complex, ...]:
        """By the accelerometers as read; with y of the whole unit the other way round; with that of forces alone."""
        at, rates = self.imu.time_s, vector(self.imu, "rate_x_rad_s")
        forces = vector(self.imu, "force_x_m_s2") @ [1.0, 1j, 0.0]
        heading = np.exp(1j * self._turn())
        # in a turn a vehicle banks, and gravity is felt sideways: roll + i pitch by the gyros, whose drift is slow
        tilts = [
            integral(at, (p + 1j * q) * heading) / heading
            for p, q in ((rates[:, 0], rates[:, 1] * y) for y in (1.0, -1.0))
        ]
        pulls = [1j * GRAVITY * tilt for tilt in tilts]
        read, mirrored, forced = forces + pulls[0], forces.conjugate() + pulls[1], forces.conjugate() + pulls[0]
        return tuple(integral(at, force) for force in (read, mirrored, forced))

    def _turn(self) -> Array:
        return integral(self.imu.time_s, vector(self.imu, "rate_x_rad_s")[:, 2])


def _changes(edges: Array, length_s: float, at: Array, series: Complex) -> Complex:
    """From one window to the next, of the acceleration by which a series grows."""
    first, second, third = (np.interp(edges + k * length_s, at, series) for k in range(3))
    return third - 2.0 * second + first


def _motion(imu: Stream, stream: Stream, mounting: Array, arm_m: complex) -> _Motion | None:
    """What a velocity and an inertial unit say of the same motion; None where it is little."""
    v = vector(stream, "v_x_m_s") @ mounting.T
    known = np.asarray(np.isfinite(v[:, :2]).all(axis=1))
    known[1:] &= np.diff(stream.time_s) > 0.0
    times, v = stream.time_s[known], v[known]
    return _Motion(imu, times, np.asarray(v[:, :2] @ [1.0, 1j]), arm_m) if times.size >= 100 else None


def _fit(moved: Complex, force: Complex) -> _Turned:
    power = float(np.vdot(moved, moved).real * np.vdot(force, force).real)
    if power <= 0.0 or moved.size < 40:
        return _Turned(0.0, 0.0, math.inf)
    factor = complex(np.vdot(moved, force))
    angle, sd = jackknife(lambda rows: np.array([np.angle(np.vdot(moved[rows], force[rows]) / factor)]), moved.size)
    del angle
    return _Turned(abs(factor) / math.sqrt(power), math.atan2(factor.imag, factor.real), float(sd[0]))

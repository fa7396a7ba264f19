"""What several streams say of one motion: speeds and headings on two clocks, and accelerometers against a velocity."""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navfilter.check.clock_offsets import DRIFT_S, ClockFit, fitted_clock, noisy_stretch_finding, stretched_finding
from navfilter.check.course import SURE, mounting_of, through_water
from navfilter.check.course_fit import Complex, without_gaps
from navfilter.check.felt_velocity import felt_clock
from navfilter.check.finding import Finding
from navfilter.check.series import Series, heading_of, integral, jackknife, unwrapped, vector, window_edges
from navfilter.models.mission import Array, Mission, Stream
from navfilter.models.vehicle import Vehicle

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

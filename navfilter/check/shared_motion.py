"""What several streams say of one motion: speeds and headings on two clocks, and accelerometers against a velocity."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navfilter.check.clock_offsets import fitted_clock
from navfilter.check.course import SURE, mounting_of
from navfilter.check.finding import Finding
from navfilter.check.series import Series, heading_of, integral, jackknife, unwrapped, vector, window_edges
from navfilter.models.mission import Array, Mission, Stream

if TYPE_CHECKING:
    from navfilter.models.vehicle import Vehicle

__all__ = ["axes_findings", "clock_finding", "pair_findings"]

#: Clocks are compared over windows of this length, speeds over longer ones [s].
TURN_S, WAY_S = 2.0, 4.0
#: A delay of less is none [s], and a drift of less over a mission [s].
LATE_S, DRIFT_S = 0.3, 0.3
#: A clock that runs at another rate leaves so little unexplained once that is known [1].
CLEAN = 0.01
#: What leaves more unexplained tells no delay either [1].
LOOSE = 0.05
#: Steps are those of a rate in whole numbers, or a whole number of seconds, within this share.
ROUND = 2e-4
#: Accelerations are compared over windows of this length [s], and say something from this correlation on.
WINDOW_S, ALIKE = 1.0, 0.45
#: Mirrored axes fit by so much better than any that are turned [1].
MIRRORED = 1.5
#: So far off are axes that are turned [rad].
TURNED = math.radians(25.0)
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
    span = float(other[0][-1] - other[0][0])
    explains = fit.left < CLEAN and fit.left < 0.5 * fit.left_without
    if explains and abs(fit.rate) > SURE * fit.rate_sd and abs(fit.rate) * span > DRIFT_S:
        step = float(np.median(np.diff(other[0])))
        own, scale = step / (1.0 + fit.rate), 1.0 / (1.0 + fit.rate)
        ends = (fit.late_s + side * fit.rate * span for side in (-0.5, 0.5))
        text = what.format("late by {:+.2f} s at the beginning and by {:+.2f} s at the end,".format(*ends))
        cure = "Its stamps are stretched, or rows are missing: set time.scale = "
        if _is_round(own) and not _is_round(step):
            own = round(own) if own >= 1.0 - ROUND else 1.0 / round(1.0 / own)
            cure += f"{own / step:.5f} (rows are then {own:.4g} s apart, and were printed as {step:.6g})"
        else:
            cure += f"{scale:.5f}"
        yield Finding("error", name, f"{text}.", f"{cure} in time of [streams.{name}].")
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
    return Finding("warning", name, text, f"{cure}time_offset_sd_s = {sd:g} in vehicle.toml.", "clock")


def _is_round(step_s: float) -> bool:
    """Whether a step is one that people set: so many in a second, or so many seconds."""
    times = 1.0 / step_s if step_s < 1.0 else step_s
    return abs(times / max(round(times), 1) - 1.0) < ROUND


def pair_findings(mission: Mission) -> Iterator[Finding]:
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
            if min(a[0].size, b[0].size) >= 20:
                yield from clock_finding(second, f"its {kind} is {{}} against that of {first}", a, b, window_s)


def _speed(stream: Stream) -> Array | None:
    for columns in (("v_x_m_s", "v_y_m_s"), ("v_north_m_s", "v_east_m_s"), ("wheel_speed_m_s",), ("ground_speed_m_s",)):
        if all(column in stream.columns for column in columns):
            return np.sqrt(sum((stream.column(column) ** 2 for column in columns), np.zeros(len(stream))))
    return None


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
            motion = _accelerations(imu, stream, mounting_of(other, vehicle)[0])
            if motion is None:
                continue
            moved, as_read, *others = motion
            straight, mirrored = (
                _fit(moved, as_read),
                max((_fit(moved, other) for other in others), key=lambda f: f.alike),
            )
            if max(straight.alike, mirrored.alike) < ALIKE:
                continue
            if mirrored.alike > MIRRORED * straight.alike:
                text = f"its horizontal axes are mirrored: it speeds up and turns otherwise than {other} says."
                cure = "Gyro z is positive clockwise, force y to the right: check the signs of axes for both."
                yield Finding("error", name, text, cure)
            elif abs(straight.angle) > max(TURNED, SURE * straight.sd):
                quarter = round(-straight.angle / (0.5 * math.pi)) % 4
                text = f"its forces are turned by {math.degrees(-straight.angle):+.0f} deg about the down axis"
                cure = f'Set axes = "{_QUARTERS[quarter]}" on top of what it is now' if quarter else "Set mounting_deg"
                cure += f", for rates and forces of [streams.{name}]; or {other} is turned by the opposite."
                yield Finding("error", name, f"{text} against how {other} speeds up and turns.", cure)


def _accelerations(imu: Stream, stream: Stream, mounting: Array) -> tuple[Array, ...] | None:
    """Changes of horizontal acceleration from window to window, as complex numbers x + iy: by a velocity and a gyro; by
    the accelerometers as read; with y of the whole unit the other way round; with that of the forces alone.
    """
    v = vector(stream, "v_x_m_s") @ mounting.T
    known = np.asarray(np.isfinite(v[:, :2]).all(axis=1))
    known[1:] &= np.diff(stream.time_s) > 0.0
    times, v = stream.time_s[known], v[known]
    if times.size < 100:
        return None
    length_s = max(WINDOW_S, 2.0 * float(np.median(np.diff(times))))
    begin, end = max(times[0], imu.time_s[0]), min(times[-1], imu.time_s[-1]) - length_s
    edges = window_edges(begin, end, length_s)
    gaps = np.diff(times)
    longest = np.maximum.reduceat(np.r_[gaps, 0.0], np.minimum(np.searchsorted(times, edges), gaps.size))
    if edges.size < 60:
        return None
    turn = np.interp(times, imu.time_s, integral(imu.time_s, vector(imu, "rate_x_rad_s")[:, 2]))
    rate = np.gradient(turn, times)
    swung = integral(times, np.column_stack([-rate * v[:, 1], rate * v[:, 0]]))
    rates, forces = vector(imu, "rate_x_rad_s"), vector(imu, "force_x_m_s2") @ [1.0, 1j, 0.0]
    heading = np.exp(1j * integral(imu.time_s, rates[:, 2]))
    # in a turn a vehicle banks, and gravity is felt sideways: roll + i pitch by the gyros, whose drift is slow
    tilts = [
        _integral(imu.time_s, (p + 1j * q) * heading) / heading
        for p, q in ((rates[:, 0], rates[:, 1] * y) for y in (1.0, -1.0))
    ]
    pulls = [1j * GRAVITY * tilt for tilt in tilts]
    felt = [forces + pulls[0], forces.conjugate() + pulls[1], forces.conjugate() + pulls[0]]

    def within(at: Array, series: Array) -> Array:
        return np.asarray(np.interp(edges + length_s, at, series) - np.interp(edges, at, series))

    # biases change slowly: only what changes from window to window counts
    moved = within(times, (v[:, :2] + swung) @ [1.0, 1j])
    steady = (longest[1:] < 3.0 * length_s) & (longest[:-1] < 3.0 * length_s)
    return tuple(np.diff(one)[steady] for one in (moved, *(within(imu.time_s, _integral(imu.time_s, f)) for f in felt)))


def _integral(times: Array, series: Array) -> Array:
    return integral(times, series.real) + 1j * integral(times, series.imag)


def _fit(moved: Array, force: Array) -> _Turned:
    power = float(np.vdot(moved, moved).real * np.vdot(force, force).real)
    if power <= 0.0 or moved.size < 40:
        return _Turned(0.0, 0.0, math.inf)
    factor = complex(np.vdot(moved, force))
    angle, sd = jackknife(lambda rows: np.array([np.angle(np.vdot(moved[rows], force[rows]) / factor)]), moved.size)
    del angle
    return _Turned(abs(factor) / math.sqrt(power), math.atan2(factor.imag, factor.real), float(sd[0]))

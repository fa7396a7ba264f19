"""Compare a body velocity with the position: which way it must be turned, scaled and shifted to follow the course."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navfilter.check.finding import Finding
from navfilter.check.series import heading_of, integral, unwrapped, vector, window_edges
from navfilter.mission import Array, Mission, Stream
from navfilter.state import matrix_from_euler

if TYPE_CHECKING:
    from navfilter.vehicle import Vehicle

EARTH_RADIUS_M = 6.371e6
#: Delays up to this are looked for [s].
MOST_DELAY_S = 3.0


def course_findings(name: str, stream: Stream, mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Findings about a velocity stream whose axes, sign, scale or clock do not fit the positions."""
    mounting, lever = _mounting(name, vehicle)
    v = vector(stream, "v_x_m_s") @ mounting.T
    speed = np.hypot(v[:, 0], v[:, 1])
    if not np.isfinite(speed).any() or np.nanmax(speed) == 0.0:
        return
    fast = float(np.nanquantile(speed, 0.99))
    if fast > 50.0:
        text = f"speeds up to {fast:.3g} m/s."
        yield Finding("error", name, text, "Centimetres or millimetres per second, or a sentinel: set unit or invalid_above.")
        return
    position = _positions_m(mission)
    headings = [(n, s) for n, s in mission.streams.items() if heading_of(s) is not None and n != name]
    compared = False
    if position is not None and headings:
        # A compass that is measured as an angle is better than a magnetometer that is not levelled.
        other, best = min(headings, key=lambda item: "field_x_T" in item[1].columns)
        angle = heading_of(best)
        assert angle is not None  # chosen for having one
        heading = unwrapped(best.time_s, angle)
        # The instrument's own path differs from the vehicle's while it turns.
        arm = lever * np.exp(1j * np.interp(position[0], *heading))
        fit = _course_fit(stream.time_s, v, heading, (position[0], position[1] + arm))
        if fit is not None:
            compared = True
            yield from _course_findings(name, other, fit, "field_x_T" in best.columns)
    if not compared:
        yield from _main_direction(name, v, speed)


def _mounting(name: str, vehicle: Vehicle | None) -> tuple[Array, complex]:
    """Mounting matrix and horizontal lever arm of the sensor behind a stream; none without a vehicle."""
    sensor: Any = None
    if vehicle is not None:
        sensor = vehicle.sensors.get(name) or getattr(vehicle.drive, name, None)
    arm = getattr(sensor, "lever_arm_b_m", (0.0, 0.0, 0.0))
    return matrix_from_euler(*getattr(sensor, "mounting_rad", (0.0, 0.0, 0.0))), complex(arm[0], arm[1])


def _positions_m(mission: Mission) -> tuple[Array, Array] | None:
    """Times and complex positions (north + i east) of the truth, or else of the first position sensor."""
    candidates = [s for s in (mission.truth, *mission.streams.values()) if s is not None and "latitude_rad" in s.columns]
    for stream in candidates:
        latitude, longitude = stream.column("latitude_rad"), stream.column("longitude_rad")
        known = np.isfinite(latitude) & np.isfinite(longitude)
        if np.count_nonzero(known) > 10:
            latitude, longitude = latitude[known], longitude[known]
            east = np.unwrap(longitude) - longitude[0]
            plane = (latitude - latitude[0]) + 1j * east * math.cos(latitude[0])
            return stream.time_s[known], plane * EARTH_RADIUS_M
    return None


@dataclass(frozen=True)
class _CourseFit:
    """displacement = ratio * dead-reckoned displacement, with the signs and the delay that fit best."""

    heading_sign: int
    side_sign: int
    ratio: complex
    late_s: float
    residual: float
    plain_residual: float
    speed_m_s: float
    shortest_s: float


def _course_fit(
    time_s: Array, v: Array, heading: tuple[Array, Array], position: tuple[Array, Array], window_s: float = 10.0
) -> _CourseFit | None:
    most = MOST_DELAY_S
    # Held and interpolated readings are half a step off by themselves.
    shortest = max(0.25, 0.5 * float(np.median(np.diff(time_s))))
    begin = max(time_s[0], heading[0][0], position[0][0]) + most
    end = min(time_s[-1], heading[0][-1], position[0][-1]) - most
    if end - begin < 5.0 * window_s:
        return None
    edges = window_edges(begin, end - window_s, window_s / 4.0)
    # A window across a gap of the position has no displacement of its own.
    gap = np.searchsorted(position[0], edges)
    sparse = position[0][np.minimum(gap, position[0].size - 1)] - position[0][np.maximum(gap - 1, 0)] > window_s / 2
    edges = edges[~sparse]
    if edges.size < 10:
        return None

    def moved(times: Array, path: Array) -> Array:
        ahead = np.interp(edges + window_s, times, path.real) + 1j * np.interp(edges + window_s, times, path.imag)
        return ahead - np.interp(edges, times, path.real) - 1j * np.interp(edges, times, path.imag)

    wanted = moved(*position)
    power = float(np.sum(np.abs(wanted) ** 2))
    if power < edges.size * 1.0:
        return None
    body = v[:, 0] + 1j * v[:, 1]

    def fit(heading_sign: int, side_sign: int, late: float) -> tuple[float, complex]:
        at = time_s - late
        own = body if side_sign > 0 else body.conjugate()
        turned = own * np.exp(1j * heading_sign * np.interp(at, *heading))
        way = moved(at, integral(at, turned.view(float).reshape(-1, 2)) @ np.array([1.0, 1j]))
        ratio = complex(np.vdot(way, wanted) / max(float(np.vdot(way, way).real), 1e-12))
        return float(np.sum(np.abs(wanted - ratio * way) ** 2)) / power, ratio

    signs: tuple[int, int] = min(((h, s) for h in (1, -1) for s in (1, -1)), key=lambda hs: fit(hs[0], hs[1], 0.0)[0])
    # Slow sideways drift fits either sign: another one than expected must explain far more to be believed.
    if fit(signs[0], signs[1], 0.0)[0] > 0.3 * fit(1, 1, 0.0)[0]:
        signs = (1, 1)
    late = min(np.linspace(-most, most, 61), key=lambda shift: fit(signs[0], signs[1], float(shift))[0])
    residual, ratio = fit(signs[0], signs[1], float(late))
    speed = math.sqrt(power / edges.size) / window_s
    plain, _ = fit(signs[0], signs[1], 0.0)
    return _CourseFit(signs[0], signs[1], ratio, float(late), residual, plain, speed, shortest)


def _course_findings(name: str, heading: str, fit: _CourseFit, rough: bool) -> Iterator[Finding]:
    if fit.residual > 0.25:
        text = f"velocity turned by {heading} does not follow the position (unexplained {100 * fit.residual:.0f} %)."
        yield Finding("warning", name, text, "Check the axes of the velocity, the heading and the clocks.")
        return
    scale, angle = abs(fit.ratio), math.degrees(math.atan2(fit.ratio.imag, fit.ratio.real))
    text = f"velocity turned by {heading} follows the position: scale {scale:.3f}, turned by {angle:+.1f} deg"
    yield Finding("info", name, f"{text}, unexplained {100 * math.sqrt(fit.residual):.1f} %.")
    if fit.heading_sign < 0:
        cure = 'A heading counted from east counter-clockwise needs scale = -1 and offset = "90 deg".'
        yield Finding("error", heading, "the heading turns the wrong way against the course over ground.", cure)
    if fit.side_sign < 0:
        cure = "Check the sign of the sideways axis: x forward, y right, z down."
        yield Finding("error", name, "the velocity is mirrored: it fits with its y axis reversed.", cure)
    if abs(angle) > (15.0 if rough else 4.0):
        text = f"the velocity must be turned by {angle:+.1f} deg to follow the course over ground."
        cure = f"Either the instrument is mounted so (mounting_deg yaw {angle:+.0f}) or the heading is off by that much."
        yield Finding("error" if abs(angle) > 20.0 else "warning", name, text, cure)
    if not 0.93 < scale < 1.07:
        text = f"the position moves {scale:.3g} times as far as the velocity says."
        known = {0.5144: "kn", 0.3048: "ft/s", 0.01: "cm/s", 0.001: "mm/s", 1 / 3.6: "km/h"}
        guess = [f'Perhaps unit = "{u}".' for value, u in known.items() if abs(scale / value - 1.0) < 0.05]
        grave = not 0.8 < scale < 1.25
        yield Finding("error" if grave else "warning", name, text, guess[0] if guess else "Check unit and scale.")
    # A delay is believed when it explains clearly more than none does, and more than the longest one tried.
    if fit.shortest_s < abs(fit.late_s) < MOST_DELAY_S - 0.01 and fit.residual < 0.6 * fit.plain_residual:
        word = "late" if fit.late_s > 0 else "early"
        text = f"the velocity is about {abs(fit.late_s):.1f} s {word} against the position."
        speed = fit.speed_m_s
        cure = f"Set time.offset_s = {-fit.late_s:+.1f} on top of what it is now; "
        cure += f"or it is a lever arm of {-speed * fit.late_s:+.1f} m along x, which looks much the same."
        yield Finding("warning", name, text, cure)


def _main_direction(name: str, v: Array, speed: Array) -> Iterator[Finding]:
    """Without positions: a vehicle mostly moves along its own length."""
    known = np.isfinite(speed)
    doubled = (v[known, 0] + 1j * v[known, 1]) ** 2
    total = float(np.sum(np.abs(doubled)))
    axis = complex(np.sum(doubled)) / total if total > 0.0 else 0j
    angle = 0.5 * math.degrees(math.atan2(axis.imag, axis.real))
    if abs(axis) > 0.6 and abs(angle) > 20.0:
        side = "right" if angle > 0 else "left"
        text = f"the vehicle mostly moves {abs(angle):.0f} deg {side} of the instrument's x axis."
        cure = f"If it moves along its own length, the instrument is mounted turned: mounting_deg yaw {-angle:+.0f} or so."
        yield Finding("warning", name, text, cure)

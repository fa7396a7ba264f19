"""Exact motion of a simulated vehicle: position, velocity, attitude, and what an ideal inertial unit feels.

Speed, turn rate, pitch and roll are piecewise polynomials of time (see `navfilter.simulation.manoeuvres`), so velocity,
acceleration, attitude and body rates are analytic. Only the position on the ellipsoid is integrated numerically, by
Gauss-Legendre quadrature between knots no further apart than 0.2 s, and read between the knots through the quintic that
has the analytic first and second derivatives there: it agrees with the velocity to about 1e-9 m.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import PPoly

from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.models.truth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS_M, Kinematics, radii, wrapped
from navfilter.simulation.manoeuvres import BLEND, Manoeuvre, Piece, descent

_KNOT_STEP_S = 0.2
_CHUNK = 50_000  # samples evaluated at once: bounds the memory of a day at 100 Hz
_SPEED, _HEADING, _PITCH, _ROLL = range(4)
EARTH_RATE_RAD_S = 7.292115e-5
GRAVITY_EQUATOR_M_S2 = 9.7803253359
GRAVITY_POLE_M_S2 = 9.8321849378


@dataclass(frozen=True)
class Wander:
    """Small steady motion that an autopilot leaves: sums of three sinusoids, in proportion to the speed.

    Parameters
    ----------
    heading_deg, pitch_deg, roll_deg : float
        Root mean square at the motion's highest speed, deg. At rest nothing moves.
    period_s : float
        Middle period of the three, s; the others are a golden ratio away.
    """

    heading_deg: float = 0.5
    pitch_deg: float = 0.3
    roll_deg: float = 0.8
    period_s: float = 9.0

    def __post_init__(self) -> None:
        if not self.period_s > 0.0:
            raise ValueError(f"period_s must be positive, found {self.period_s}.")

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Deviations of heading, pitch and roll at full speed, rad, and their time derivatives; each (n, 3)."""
        golden = 0.5 * (1.0 + math.sqrt(5.0))
        omega = 2.0 * math.pi / (self.period_s * np.array([1.0, golden, 1.0 / golden]))
        # three sinusoids of equal amplitude a have the rms a * sqrt(3 / 2)
        amplitude = np.radians([self.heading_deg, self.pitch_deg, self.roll_deg]) * math.sqrt(2.0 / 3.0)
        value = np.zeros((time_s.size, 3))
        rate = np.zeros((time_s.size, 3))
        for axis in range(3):
            for k in range(3):
                phase = omega[k] * time_s * (1.0 + 0.07 * axis) + 2.1 * axis + 1.3 * k
                value[:, axis] += amplitude[axis] * np.sin(phase)
                rate[:, axis] += amplitude[axis] * omega[k] * (1.0 + 0.07 * axis) * np.cos(phase)
        return value, rate


@dataclass(frozen=True)
class Motion:
    """A vehicle's motion over rotating WGS-84, built from manoeuvres.

    The vehicle moves along its own forward axis. The motion starts at time 0, level, at rest unless `speed_m_s` is
    given, and ends with its last manoeuvre.

    Parameters
    ----------
    manoeuvres : sequence of Manoeuvre
        In order, see `navfilter.simulation.manoeuvres`.
    latitude_deg, longitude_deg : float
        Where it starts, deg.
    surface_height_m : float
        Height of the water's surface above the ellipsoid, m.
    depth_m : float
        Depth at which it starts, m.
    heading_deg : float
        Heading at which it starts, deg.
    speed_m_s : float
        Speed at which it starts, m/s.
    wander : Wander, optional
        Small steady motion on top.

    Examples
    --------
    >>> from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
    >>> motion = Motion((ChangeSpeed(1.5), Straight(duration_s=60), Turn(90)), latitude_deg=26.0)
    >>> here = motion.at([0.0, 40.0, motion.duration_s])
    >>> (here.velocity_n.round(3) + 0.0).tolist()
    [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0]]
    >>> motion.inertial(100.0)[1].shape
    (8901, 3)
    """

    manoeuvres: tuple[Manoeuvre, ...]
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    surface_height_m: float = 0.0
    depth_m: float = 0.0
    heading_deg: float = 0.0
    speed_m_s: float = 0.0
    wander: Wander | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "manoeuvres", tuple(self.manoeuvres))
        if not self.manoeuvres:
            raise ValueError("A motion needs at least one manoeuvre, found none.")
        if not abs(self.latitude_deg) < 89.0:
            raise ValueError(
                f"latitude_deg must lie between -89 and 89 (no motion over the poles): {self.latitude_deg}."
            )

    @property
    def duration_s(self) -> float:
        """Time from the first manoeuvre to the end of the last, s."""
        return float(self._course.x[-1])

    def at(self, time_s: ArrayLike) -> Kinematics:
        """Position, velocity, attitude, rates and specific force at any times.

        Parameters
        ----------
        time_s : array_like, shape (n,)
            Times within 0 .. `duration_s`.

        Returns
        -------
        Kinematics

        Raises
        ------
        ValueError
            If a time lies outside the motion.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        if t.size and not (t.min() >= -1e-9 and t.max() <= self.duration_s + 1e-9):
            raise ValueError(f"The motion lasts from 0 to {self.duration_s:.3f} s; asked for {t.min()} .. {t.max()} s.")
        speed, angles, angle_rates, acceleration = self._channels(t)
        velocity_n, acceleration_n, C_nb = _along_forward_axis(speed, angles, angle_rates, acceleration)
        latitude, longitude, height = np.moveaxis(self._path(t) + self._origin, -1, 0)
        earth_n, transport_n = frame_rates(latitude, height, velocity_n)
        rate_nb_b = _body_rates(angles, angle_rates)
        force_n = acceleration_n + np.cross(2.0 * earth_n + transport_n, velocity_n)
        force_n[:, 2] -= gravity(latitude, height)
        rate_eb_b = rate_nb_b + _to_body(C_nb, transport_n)
        attitude = np.stack([angles[:, 2], angles[:, 1], wrapped(angles[:, 0])], axis=-1)
        rate_b = rate_eb_b + _to_body(C_nb, earth_n)
        force_b = _to_body(C_nb, force_n)
        return Kinematics(t, latitude, longitude, height, velocity_n, attitude, C_nb, rate_b, rate_eb_b, force_b)

    def inertial(
        self, rate_hz: float, *, increments: bool = False, duration_s: float | None = None
    ) -> tuple[Array, Array, Array]:
        """Samples of an ideal inertial unit at the body's origin.

        Parameters
        ----------
        rate_hz : float
            Sample rate, Hz.
        increments : bool
            False: instantaneous rate and specific force at each time, beginning at 0. True: their integrals in body
            axes over the sample period that ends at each time, beginning at one period.
        duration_s : float, optional
            Last time; the whole motion when left out.

        Returns
        -------
        time_s : ndarray, shape (n,)
        gyro : ndarray, shape (n, 3)
            rad/s, or rad for increments.
        accel : ndarray, shape (n, 3)
            m/s^2, or m/s for increments.
        """
        duration = self.duration_s if duration_s is None else duration_s
        time_s = np.arange(int(increments), math.floor(duration * rate_hz + 1e-6) + 1) / rate_hz
        gyro, accel = np.empty((time_s.size, 3)), np.empty((time_s.size, 3))
        nodes, weights = np.polynomial.legendre.leggauss(3)
        half = 0.5 / rate_hz
        for begin in range(0, time_s.size, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            if increments:
                here = self.at((time_s[rows, None] - half + half * nodes).ravel())
                gyro[rows] = half * np.einsum("k,nkj->nj", weights, here.rate_b.reshape(-1, 3, 3))
                accel[rows] = half * np.einsum("k,nkj->nj", weights, here.force_b.reshape(-1, 3, 3))
            else:
                here = self.at(time_s[rows])
                gyro[rows], accel[rows] = here.rate_b, here.force_b
        return time_s, gyro, accel

    @cached_property
    def _origin(self) -> Array:
        height = self.surface_height_m - self.depth_m
        return np.array([math.radians(self.latitude_deg), math.radians(self.longitude_deg), height])

    @cached_property
    def _course(self) -> PPoly:
        """Speed, heading, pitch and roll without the wander, as one piecewise polynomial of degree 8."""
        before = Piece(1.0, self.speed_m_s)
        pieces = [before]
        depth = self.depth_m
        for manoeuvre in self.manoeuvres:
            for piece in manoeuvre.pieces(before.speed_m_s, depth):
                depth += descent(before, piece)
                before = piece
                pieces.append(piece)
        return _join(pieces, math.radians(self.heading_deg))

    @cached_property
    def _course_rates(self) -> PPoly:
        return self._course.derivative()

    def _channels(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Speed (n,), heading-pitch-roll (n, 3), their rates (n, 3), and the derivative of the speed (n,)."""
        value, rate = self._course(t), self._course_rates(t)
        speed, acceleration = value[:, _SPEED], rate[:, _SPEED]
        angles, angle_rates = value[:, _HEADING:], rate[:, _HEADING:]
        if self.wander is not None:
            fastest = max(abs(self._course(self._course.x)[:, _SPEED]).max(), 1e-9)
            deviation, deviation_rate = self.wander.at(t)
            share, share_rate = speed[:, None] / fastest, acceleration[:, None] / fastest
            angles = angles + share * deviation
            angle_rates = angle_rates + share * deviation_rate + share_rate * deviation
        return speed, angles, angle_rates, acceleration

    @cached_property
    def _path(self) -> PPoly:
        """Latitude, longitude, height relative to the origin, as quintics between the knots."""
        breaks = self._course.x
        knots = np.concatenate(
            [np.linspace(a, b, max(1, math.ceil((b - a) / _KNOT_STEP_S)), endpoint=False) for a, b in pairwise(breaks)]
            + [breaks[-1:]]
        )
        return integrate_path(knots, self._motion_n, self._origin)

    def _motion_n(self, t: Array) -> tuple[Array, Array]:
        return _along_forward_axis(*self._channels(t))[:2]


def rotation(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Body-to-navigation rotation matrices (n, 3, 3) of yaw, then pitch, then roll."""
    sr, cr, sp, cp, sy, cy = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _join(pieces: list[Piece], heading: float) -> PPoly:
    durations = np.array([piece.duration_s for piece in pieces[1:]])
    ends = np.array([[p.speed_m_s, p.turn_rate, p.pitch, p.roll] for p in pieces])
    start, change = ends[:-1], np.diff(ends, axis=0)
    powers = durations[:, None] ** -np.arange(8, -1, -1.0)
    blend = np.concatenate([[0.0], BLEND]) * powers
    c = blend[:, :, None] * change[:, None, :]
    c[:, 8, :] += start
    # the heading is the integral of the turn rate
    integral = np.polyint(np.array(BLEND)) * powers * durations[:, None]
    c[:, :, _HEADING] = integral * change[:, None, 1]
    c[:, 7, _HEADING] += start[:, 1]
    turned = durations * (start[:, 1] + 0.5 * change[:, 1])
    c[:, 8, _HEADING] = heading + np.concatenate([[0.0], np.cumsum(turned)[:-1]])
    times = np.concatenate([[0.0], np.cumsum(durations)])
    return PPoly(np.ascontiguousarray(np.moveaxis(c, 1, 0)), times)


def _along_forward_axis(
    speed: Array, angles: Array, angle_rates: Array, acceleration: Array
) -> tuple[Array, Array, Array]:
    """Velocity and its derivative in north-east-down axes (n, 3), and C_nb, for motion along the forward axis."""
    heading, pitch, roll = angles.T
    C_nb = rotation(roll, pitch, heading)
    forward = C_nb[:, :, 0]
    sp, cp, sh, ch = np.sin(pitch), np.cos(pitch), np.sin(heading), np.cos(heading)
    by_pitch = np.stack([-sp * ch, -sp * sh, -cp], axis=-1)
    by_heading = np.stack([-cp * sh, cp * ch, np.zeros_like(cp)], axis=-1)
    forward_rate = by_pitch * angle_rates[:, 1:2] + by_heading * angle_rates[:, 0:1]
    velocity_n = speed[:, None] * forward
    return velocity_n, acceleration[:, None] * forward + speed[:, None] * forward_rate, C_nb


def _body_rates(angles: Array, angle_rates: Array) -> Array:
    """Rate of the body relative to north-east-down, in body axes, from the rates of heading, pitch and roll."""
    _, pitch, roll = angles.T
    heading_rate, pitch_rate, roll_rate = angle_rates.T
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    x = roll_rate - sp * heading_rate
    y = cr * pitch_rate + sr * cp * heading_rate
    z = -sr * pitch_rate + cr * cp * heading_rate
    return np.stack([x, y, z], axis=-1)


def _to_body(C_nb: Array, vector_n: Array) -> Array:
    return np.einsum("nij,ni->nj", C_nb, vector_n)


# --- the Earth, as the simulator has it ------------------------------------------------------------------------------


def gravity(latitude: Array, height: Array) -> Array:
    """Gravity by Somigliana's formula with its linear decrease over height, m/s^2."""
    k = math.sqrt(1.0 - ECCENTRICITY_SQUARED) * GRAVITY_POLE_M_S2 / GRAVITY_EQUATOR_M_S2 - 1.0
    s2 = np.sin(latitude) ** 2
    surface = GRAVITY_EQUATOR_M_S2 * (1.0 + k * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    return surface * (1.0 - 2.0 * height / SEMI_MAJOR_AXIS_M)


def frame_rates(latitude: Array, height: Array, velocity_n: Array) -> tuple[Array, Array]:
    """Rate of the Earth, and of north-east-down over the Earth, in north-east-down axes (n, 3), rad/s."""
    meridian, across = radii(latitude)
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    earth = EARTH_RATE_RAD_S * np.stack([cos_lat, np.zeros_like(cos_lat), -sin_lat], axis=-1)
    eastward = velocity_n[:, 1] / (across + height)
    northward = velocity_n[:, 0] / (meridian + height)
    return earth, np.stack([eastward, -northward, -eastward * sin_lat / cos_lat], axis=-1)


def _path_rates(path: Array, velocity_n: Array, acceleration_n: Array) -> tuple[Array, Array]:
    """First and second time derivatives of latitude, longitude, height (n, 3)."""
    latitude, height = path[:, 0], path[:, 2]
    meridian, across = radii(latitude)
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    north, east, up = velocity_n[:, 0], velocity_n[:, 1], -velocity_n[:, 2]
    along, around = meridian + height, (across + height) * cos_lat
    lat_rate, lon_rate = north / along, east / around
    e2 = ECCENTRICITY_SQUARED
    meridian_slope = 3.0 * meridian * e2 * sin_lat * cos_lat / (1.0 - e2 * sin_lat**2)
    along_rate = meridian_slope * lat_rate + up
    around_rate = up * cos_lat - along * sin_lat * lat_rate
    second = [
        (acceleration_n[:, 0] - lat_rate * along_rate) / along,
        (acceleration_n[:, 1] - lon_rate * around_rate) / around,
        -acceleration_n[:, 2],
    ]
    return np.stack([lat_rate, lon_rate, up], axis=-1), np.stack(second, axis=-1)


def integrate_path(knots: Array, motion_n: Callable[[Array], tuple[Array, Array]], origin: Array) -> PPoly:
    """Integrate the position: Picard iteration of a Gauss-Legendre rule, from a standing vehicle.

    Each round shrinks the error by about the distance travelled over the Earth's radius, so four leave rounding only.
    """
    nodes, weights = np.polynomial.legendre.leggauss(5)
    step = np.diff(knots)
    times = (knots[:-1, None] + 0.5 * step[:, None] * (1.0 + nodes)).ravel()
    velocity_n, acceleration_n = motion_n(times)
    path = np.zeros((knots.size, 3))
    at_nodes = np.zeros((times.size, 3))
    for _ in range(4):
        rates, _unused = _path_rates(origin + at_nodes, velocity_n, acceleration_n)
        gains = 0.5 * step[:, None] * np.einsum("k,mkj->mj", weights, rates.reshape(-1, nodes.size, 3))
        path[1:] = np.cumsum(gains, axis=0)
        quintic = _quintics(knots, path, *_path_rates(origin + path, *motion_n(knots)))
        at_nodes = quintic(times)
    return quintic


def _quintics(knots: Array, value: Array, first: Array, second: Array) -> PPoly:
    """The piecewise quintic with these values and derivatives (m, k) at the knots (m,)."""
    h = np.diff(knots)[:, None]
    gap = value[1:] - value[:-1] - h * first[:-1] - 0.5 * h**2 * second[:-1]
    bend = first[1:] - first[:-1] - h * second[:-1]
    turn = second[1:] - second[:-1]
    c5 = (12.0 * gap - 6.0 * h * bend + h**2 * turn) / (2.0 * h**5)
    c4 = (-15.0 * gap + 7.0 * h * bend - h**2 * turn) / h**4
    c3 = (20.0 * gap - 8.0 * h * bend + h**2 * turn) / (2.0 * h**3)
    return PPoly(np.stack([c5, c4, c3, 0.5 * second[:-1], first[:-1], value[:-1]]), knots)

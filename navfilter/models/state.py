"""The nominal state of the vehicle, with `plus` and `minus`, and the rotation algebra that they need."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.display import Value, few
from navfilter.kernels import strapdown
from navfilter.models.health import Bounds, Health, Trust


def wrap(angle: ArrayLike) -> Array:
    """Wrap angles to half a turn, [-pi, pi).

    Examples
    --------
    >>> float(wrap(3 * np.pi / 2)) == -np.pi / 2
    True
    """
    return (np.asarray(angle, dtype=float) + np.pi) % (2 * np.pi) - np.pi


def matrix_from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Body-to-nav matrices C_nb from roll, pitch, yaw [rad], shape (..., 3, 3) (Groves, 2013, eq 2.24, transposed)."""
    r, p, y = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (roll, pitch, yaw)))
    cr, sr, cp, sp, cy, sy = np.cos(r), np.sin(r), np.cos(p), np.sin(p), np.cos(y), np.sin(y)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_from_matrix(C_nb: ArrayLike) -> Array:
    """Roll, pitch, yaw [rad], shape (..., 3), of body-to-nav matrices, shape (..., 3, 3)."""
    C = np.asarray(C_nb, dtype=float)
    roll = np.arctan2(C[..., 2, 1], C[..., 2, 2])
    pitch = -np.arcsin(np.clip(C[..., 2, 0], -1.0, 1.0))
    return np.stack([roll, pitch, np.arctan2(C[..., 1, 0], C[..., 0, 0])], axis=-1)


def turn_to_down(direction: Array) -> Array:
    """Rotation vector in n that turns a direction in n, shape (3,), to straight down [rad]."""
    across = math.hypot(direction[0], direction[1])
    angle = math.atan2(across, direction[2])
    return np.array([direction[1], -direction[0], 0.0]) * (angle / across if across > 0.0 else 1.0)


def rotation_matrix(vector: ArrayLike) -> Array:
    """``exp([v x])`` of rotation vectors [rad], shape (..., 3) to (..., 3, 3) (Rodrigues)."""
    v = np.asarray(vector, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = np.zeros_like(x)
    cross = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (cross @ cross)


def rotation_vector(matrix: ArrayLike) -> Array:
    """Rotation vector [rad] of rotation matrices: the inverse of `rotation_matrix` for angles below pi."""
    C = np.asarray(matrix, dtype=float)
    axis = 0.5 * np.stack([C[..., 2, 1] - C[..., 1, 2], C[..., 0, 2] - C[..., 2, 0], C[..., 1, 0] - C[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(C, axis1=-2, axis2=-1) - 1.0))
    small = sine < 1e-12
    scale = np.where(small, 1.0, angle / np.where(small, 1.0, sine))
    return axis * np.asarray(scale)[..., None]


class Pose(NamedTuple):
    """Where the vehicle is, how it moves and points: plain numbers, in a hundredth of the time that a `NavState` takes.

    Attributes
    ----------
    time_s : float
        Mission time [s].
    latitude, longitude : float
        WGS-84 [rad].
    height : float
        Above the ellipsoid [m].
    velocity_n : (3,) float
        Velocity over ground, north-east-down [m/s].
    C_nb : (9,) float
        Body to nav, row by row.

    Examples
    --------
    >>> pose = NavState(0.0, 0.8, -0.1, 5.0, np.array([1.0, 0.0, 0.0]), np.eye(3)).pose
    >>> pose.height, pose.velocity_n, pose.heading
    (5.0, (1.0, 0.0, 0.0), 0.0)
    """

    time_s: float
    latitude: float
    longitude: float
    height: float
    velocity_n: tuple[float, float, float]
    C_nb: tuple[float, ...]

    @classmethod
    def unpack(cls, time_s: float, nav: Array) -> "Pose":
        """From the vector of the kernels, see `NavState.pack`."""
        v = nav.tolist()
        return cls(time_s, v[0], v[1], v[2], (v[3], v[4], v[5]), tuple(v[6:15]))

    @property
    def heading(self) -> float:
        """True heading, clockwise from north [rad], in [-pi, pi)."""
        return math.atan2(self.C_nb[3], self.C_nb[0])


def _fixed(values: Array, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


@dataclass(frozen=True, eq=False, repr=False)
class NavState(Value):
    """Where the vehicle is, how it moves and points, and how well that is known.

    Attributes
    ----------
    time_s : float
        Mission time [s].
    latitude, longitude : float
        WGS-84 [rad].
    height : float
        Above the ellipsoid [m].
    velocity_n : ndarray, shape (3,)
        Velocity over ground, north-east-down [m/s].
    C_nb : ndarray, shape (3, 3)
        Body to nav: ``v_n = C_nb @ v_b``.
    covariance : ndarray, shape (9, 9), optional
        Of the error (position [m] in n, velocity [m/s] in n, attitude rotation vector in n [rad]).
    health : Health, optional
        Of a navigator's state: what the sensors were worth.
    """

    time_s: float
    latitude: float
    longitude: float
    height: float
    velocity_n: Array
    C_nb: Array
    covariance: Array | None = None
    health: Health | None = None

    def _shown(self) -> tuple[str, dict[str, object]]:
        at = f"{math.degrees(self.latitude):.7f}, {math.degrees(self.longitude):.7f} deg, height {self.height:.2f} m"
        rows: dict[str, object] = {"at": at, "velocity": f"{_fixed(self.velocity_n, 3)} m/s north, east, down"}
        rows["attitude"] = f"{_fixed(np.degrees(self.roll_pitch_heading), 2)} deg roll, pitch, heading"
        if self.covariance is not None:
            sd = self.sd
            rows["sd"] = f"{few(sd[:3])} m; {few(sd[3:6])} m/s; {few(np.degrees(sd[6:]))} deg"
        if self.health is not None:
            told, more = self.health._shown()
            rows |= {"trust": told.removeprefix("Health: "), **more}
        return f"NavState at {self.time_s:.3f} s", rows

    def __post_init__(self) -> None:
        for name in ("velocity_n", "C_nb"):
            if type(getattr(self, name)) is not np.ndarray:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))

    @property
    def lane(self) -> str:
        """What carries a navigator's state: "inertial" or "dead-reckoning", see `Health.lane`; empty without health."""
        return "" if self.health is None else self.health.lane

    @property
    def trust(self) -> Trust | None:
        """Of a navigator's state: "good", "degraded" or "lost", with the reasons."""
        return None if self.health is None else self.health.trust

    @property
    def bounds(self) -> Bounds | None:
        """Of a navigator's state: radius of the position [m] and bound of the heading [rad] that hold the truth under
        any single fault that has not been found.
        """
        return None if self.health is None else self.health.bounds

    @property
    def roll_pitch_heading(self) -> Array:
        """Roll, pitch, heading [rad]."""
        return euler_from_matrix(self.C_nb)

    @property
    def heading(self) -> float:
        """True heading, clockwise from north [rad], in [-pi, pi)."""
        return math.atan2(self.C_nb[1, 0], self.C_nb[0, 0])

    @property
    def pose(self) -> Pose:
        """The same in plain numbers, without the covariance."""
        return Pose.unpack(self.time_s, self.pack())

    @property
    def sd(self) -> Array:
        """Standard deviations of the nine errors (metres, m/s, rad); NaN without a covariance."""
        return np.full(9, np.nan) if self.covariance is None else np.sqrt(np.diag(self.covariance))

    def plus(self, error: ArrayLike) -> "NavState":
        """Move the state by a small vector (position [m] in n, velocity [m/s], rotation vector in n [rad]).

        A correction by an estimated error is ``state.plus(-error)``. The covariance is carried along unchanged.
        """
        e = np.asarray(error, dtype=float)
        if e.shape != (9,):
            raise ValueError(f"plus takes nine numbers (position, velocity, rotation vector), found shape {e.shape}.")
        meridian, prime = strapdown.radii(self.latitude)
        return NavState(
            self.time_s,
            self.latitude + e[0] / (meridian + self.height),
            self.longitude + e[1] / ((prime + self.height) * math.cos(self.latitude)),
            self.height - e[2],
            self.velocity_n + e[3:6],
            rotation_matrix(e[6:9]) @ self.C_nb,
            self.covariance,
        )

    def minus(self, other: "NavState") -> Array:
        """The vector, shape (9,), that takes `other` to this state: ``other.plus(self.minus(other))`` is this state to
        first order.
        """
        meridian, prime = strapdown.radii(other.latitude)
        north = (self.latitude - other.latitude) * (meridian + other.height)
        east = wrap(self.longitude - other.longitude) * (prime + other.height) * math.cos(other.latitude)
        position, turned = [north, east, other.height - self.height], rotation_vector(self.C_nb @ other.C_nb.T)
        return np.concatenate([position, self.velocity_n - other.velocity_n, turned])

    def pack(self) -> Array:
        """The state as the kernels hold it, shape (17,)."""
        meridian, prime = strapdown.radii(self.latitude)
        place = [self.latitude, self.longitude, self.height]
        return np.concatenate(
            [place, self.velocity_n, np.ravel(self.C_nb), [meridian + self.height, prime + self.height]]
        )

    @classmethod
    def unpack(cls, time_s: float, nav: Array, covariance: Array | None = None) -> "NavState":
        """The inverse of `pack`; copies."""
        latitude, longitude, height = nav[:3].tolist()
        C_nb = nav[6:15].reshape(3, 3).copy()
        return cls(time_s, latitude, longitude, height, nav[3:6].copy(), C_nb, covariance)

"""Coordinates of files -> latitude, longitude, height, NED velocity and roll, pitch, yaw."""

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.track.track import Track

# WGS-84 defining constants (NIMA TR8350.2, 2000).
SEMI_MAJOR_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
_E2 = FLATTENING * (2.0 - FLATTENING)
Origin = tuple[float, float, float]

#: North, east, down -> east, north, up.
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def geodetic_from_ecef(ecef_m: Array) -> Array:
    """Latitude [rad], longitude [rad], height [m] of points (n, 3) in earth-fixed coordinates.

    Fixed-point iteration on the latitude; it contracts by the squared eccentricity, so that eight rounds reach rounding
    error (Groves, 2013, sec. 2.4.3).
    """
    x, y, z = np.moveaxis(np.asarray(ecef_m, dtype=np.float64), -1, 0)
    distance = np.hypot(x, y)
    latitude = np.arctan2(z, distance * (1.0 - _E2))
    for _ in range(8):
        sine = np.sin(latitude)
        normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * sine**2)
        latitude = np.arctan2(z + _E2 * normal * sine, distance)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * sine**2)
    # This form of the height is exact at the poles too, where distance / cos(latitude) is 0/0.
    height = distance * cosine + (z + _E2 * normal * sine) * sine - normal
    return np.stack([latitude, np.arctan2(y, x), height], axis=-1)


def ecef_from_geodetic(position: Array) -> Array:
    """Inverse of `geodetic_from_ecef`; (n, 3) -> (n, 3)."""
    latitude, longitude, height = np.moveaxis(np.asarray(position, dtype=np.float64), -1, 0)
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
    horizontal = (normal + height) * np.cos(latitude)
    z = (normal * (1.0 - _E2) + height) * np.sin(latitude)
    return np.stack([horizontal * np.cos(longitude), horizontal * np.sin(longitude), z], axis=-1)


def ned_axes(latitude: Array, longitude: Array) -> Array:
    """Matrices C_ne (n, 3, 3): an earth-fixed vector times C_ne gives north, east, down."""
    sl, cl = np.sin(latitude), np.cos(latitude)
    so, co = np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sl)
    rows = [[-sl * co, -sl * so, cl], [-so, co, zero], [-cl * co, -cl * so, -sl]]
    return np.moveaxis(np.array(rows), -1, 0)


def geodetic_from_local(ned_m: Array, latitude_rad: float, longitude_rad: float, height_m: float) -> Array:
    """Latitude, longitude, height of points (n, 3) given as north, east, down of a tangent plane at the origin."""
    origin = np.array([[latitude_rad, longitude_rad, height_m]])
    axes = ned_axes(origin[:, 0], origin[:, 1])[0]
    return geodetic_from_ecef(ecef_from_geodetic(origin) + np.asarray(ned_m) @ axes)


def matrix_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """C_nb (n, 3, 3) from roll, pitch, yaw, rotating about z, then y, then x."""
    sr, cr, sp, cp, sy, cy = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def matrix_from_quaternion(wxyz: Array) -> Array:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4); the norm does not matter, zero and NaN give NaN."""
    norm = np.linalg.norm(wxyz, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = np.moveaxis(np.where(norm > 0.0, wxyz / norm, np.nan), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


# --- a tangent plane -------------------------------------------------------------------------------------------------


def origin_of(track: Track) -> Origin:
    """Latitude, longitude [rad] and height [m] of its first row."""
    return float(track.latitude[0]), float(track.longitude[0]), float(track.height[0])


def local_enu(place: Array, origin: Origin) -> Array:
    """East, north, up [m], shape (n, 3), of latitude, longitude [rad], height [m], shape (n, 3), in the tangent plane
    at the origin.
    """
    first = np.array([origin])
    axes = ned_axes(first[:, 0], first[:, 1])[0]
    return (ecef_from_geodetic(place) - ecef_from_geodetic(first)) @ axes.T @ ENU.T


def plane_from_n(place: Array, origin: Origin) -> Array:
    """Matrices (n, 3, 3) that take north, east, down at each place to the plane's axes."""
    plane = ENU @ ned_axes(np.array([origin[0]]), np.array([origin[1]]))[0]
    return plane @ np.swapaxes(ned_axes(place[:, 0], place[:, 1]), 1, 2)

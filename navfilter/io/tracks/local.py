"""A track in the plane that is tangent to the ellipsoid at its first position: east, north, up."""

from __future__ import annotations

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.io.geodesy import ecef_from_geodetic, matrix_from_euler, ned_axes
from navfilter.track.track import Track

Origin = tuple[float, float, float]

#: North, east, down -> east, north, up.
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


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


def plane_from_body(place: Array, attitude: Array, origin: Origin) -> Array:
    """Matrices (n, 3, 3) that take the body (forward, right, down) to the plane's axes."""
    return plane_from_n(place, origin) @ matrix_from_euler(*attitude.T)

"""The Earth of the simulator: gravity, radii, frame rates, and the exact position that belongs to a velocity.

Constants and formulas are written here a second time on purpose: the simulator must not inherit a mistake from the
mechanisation that it is used to test.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import PPoly

from navfilter.foundation.arrays import Array
from navfilter.models.truth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS_M, radii

EARTH_RATE_RAD_S = 7.292115e-5
GRAVITY_EQUATOR_M_S2 = 9.7803253359
GRAVITY_POLE_M_S2 = 9.8321849378


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

"""What a simulation knows of a vehicle and its sensors: the exact motion, and how each sensor really errs.

Written from the definitions, exactly (rotation matrices, radii of the ellipsoid, the magnetic field as a vector), and
sharing nothing with the measurement models of the filter, which are tested against it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from navfilter.foundation.arrays import Array

#: Readings (n, axes) of a simulated sensor, and the names of their columns.
SimulatedReading = tuple[Array, tuple[str, ...]]
SEMI_MAJOR_AXIS_M = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999014e-3


@dataclass(frozen=True)
class Kinematics:
    """Where a vehicle is, how it moves and what it feels at n moments.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Time from the beginning of the motion, s.
    latitude, longitude, height : ndarray, shape (n,)
        WGS-84 position of the body's origin, rad, rad, m.
    velocity_n : ndarray, shape (n, 3)
        Velocity relative to the Earth, north-east-down, m/s.
    attitude : ndarray, shape (n, 3)
        Roll, pitch, yaw, rad; yaw within (-pi, pi].
    C_nb : ndarray, shape (n, 3, 3)
        Rotation that takes body vectors to north-east-down.
    rate_b : ndarray, shape (n, 3)
        Rate of rotation relative to inertial space in body axes, rad/s: what an ideal gyro reads.
    rate_eb_b : ndarray, shape (n, 3)
        Rate of rotation relative to the Earth in body axes, rad/s.
    force_b : ndarray, shape (n, 3)
        Specific force in body axes, m/s^2: what an ideal accelerometer reads, (0, 0, -g) at rest and level.
    """

    time_s: Array
    latitude: Array
    longitude: Array
    height: Array
    velocity_n: Array
    attitude: Array
    C_nb: Array
    rate_b: Array
    rate_eb_b: Array
    force_b: Array

    def displaced(self, by_n: Array) -> tuple[Array, Array, Array]:
        """Latitude, longitude, height of points some metres north, east and down of the vehicle, each (n,).

        The curvature is taken at the middle of the way: exact to less than a micrometre for a hundred metres.
        """
        meridian, _ = radii(self.latitude)
        half = self.latitude + 0.5 * by_n[:, 0] / (meridian + self.height)
        meridian, across = radii(half)
        height = self.height - 0.5 * by_n[:, 2]
        latitude = self.latitude + by_n[:, 0] / (meridian + height)
        longitude = self.longitude + by_n[:, 1] / ((across + height) * np.cos(half))
        return latitude, longitude, self.height - by_n[:, 2]


def wrapped(angle: Array) -> Array:
    """The same angle within (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


WATER_SURFACE_C, WATER_GRADIENT_C_M = 25.0, -0.1  # temperature of the simulated water


@dataclass(frozen=True)
class Truth:
    """How one sensor really is: errors already drawn, tick by tick, and constant calibration errors.

    Attributes
    ----------
    error : ndarray, shape (n, axes)
        In the unit of the sensor's error model.
    drawn : dict of str to ndarray
        Calibration errors by name, see `Sensor.draws`. Of drives also "scale", "misalignment" (rotation vector of the
        measured vector, rad) and "deviation" (bias, sine and cosine of the heading, sine and cosine of twice the
        heading, rad).
    field_n : callable
        Gives the magnetic field north-east-down, any unit, shape (3,).
    surface_height_m : float
    hdop : ndarray, shape (n,), or None
    wandering : dict of str to ndarray, shape (n,)
        The parameters that are not constant, see `Sensor.wandering`.
    """

    error: Array
    drawn: Mapping[str, Array]
    field_n: Callable[[], Array]
    surface_height_m: float
    hdop: Array | None = None
    wandering: Mapping[str, Array] = field(default_factory=dict)

    @property
    def current_n(self) -> Array:
        """Velocity of the water, north-east-down, m/s, (n, 3); zero for sensors that do not see it."""
        still = np.zeros(len(self.error))
        return np.stack(
            [self.wandering.get("current_north", still), self.wandering.get("current_east", still), still], axis=-1
        )

    def declination(self, given: float | None) -> float:
        """Of a compass that is told a declination, or has that of the field [rad]."""
        if given is not None:
            return given
        north, east, _ = self.field_n()
        return math.atan2(east, north)

    def turned_and_scaled(self, vector: Array) -> Array:
        """Vectors (n, 3) as a sensor with this misalignment and scale (or scales) measures them, without noise."""
        from scipy.spatial.transform import Rotation  # only a simulation needs it

        return (1.0 + self.drawn["scale"]) * Rotation.from_rotvec(self.drawn["misalignment"]).apply(vector)

    def deviation(self, angle: Array) -> Array:
        """Compass error that follows the heading, rad, (n,)."""
        waves = [np.ones_like(angle), np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)]
        return np.stack(waves, axis=-1) @ self.drawn["deviation"]

    def water_temperature_c(self, here: Kinematics) -> Array:
        """Temperature of the water around the vehicle, deg C, (n,)."""
        return WATER_SURFACE_C + WATER_GRADIENT_C_M * (self.surface_height_m - here.height)


def attitude(here: Kinematics, truth: Truth, declination: float) -> SimulatedReading:
    """Roll, pitch and yaw, rad, with the deviation of the compass in the yaw, which counts from magnetic north."""
    yaw = here.attitude[:, 2] - declination
    value = here.attitude + truth.error
    value[:, 2] = wrapped(yaw + truth.error[:, 2] + truth.deviation(yaw))
    return value, ("roll_rad", "pitch_rad", "yaw_rad")


def radii(latitude: Array) -> tuple[Array, Array]:
    """Radii of curvature of the ellipsoid along the meridian and across it, m."""
    root = 1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    across = SEMI_MAJOR_AXIS_M / np.sqrt(root)
    return across * (1.0 - ECCENTRICITY_SQUARED) / root, across

"""What sensors of known errors read along a motion: the truth side of every measurement equation.

Written from the definitions, exactly (rotation matrices, radii of the ellipsoid, the magnetic field as a vector), and
sharing nothing with the measurement models of the filter, which are tested against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navfilter.sensors import BodyVelocity, Depth, Heading, Position, Sensor
from navfilter.simulation.earth import radii
from navfilter.simulation.motion import Kinematics, wrap

Array = NDArray[np.float64]

WATER_SURFACE_C, WATER_GRADIENT_C_M = 25.0, -0.1  # temperature of the simulated water


@dataclass(frozen=True)
class Truth:
    """How one sensor really is: errors already drawn, tick by tick, and constant calibration errors.

    Attributes
    ----------
    error : ndarray, shape (n, axes)
        In the unit of the sensor's error model.
    scale : float
    misalignment_rad : ndarray, shape (3,)
        Rotation vector of the measured vector.
    deviation_rad : ndarray, shape (5,)
        Bias, sine and cosine of the heading, sine and cosine of twice the heading.
    temperature_rad_per_k, offset_m : float
    field_n : ndarray, shape (3,)
        Magnetic field north-east-down, any unit.
    surface_height_m : float
    hdop : ndarray, shape (n,), or None
    current_n : ndarray, shape (n, 3)
        Velocity of the water, m/s; zero for sensors that do not see it.
    """

    error: Array
    scale: float
    misalignment_rad: Array
    deviation_rad: Array
    temperature_rad_per_k: float
    offset_m: float
    field_n: Array
    surface_height_m: float
    hdop: Array | None
    current_n: Array


Reading = tuple[Array, tuple[str, ...]]


def turned_and_scaled(vector: Array, truth: Truth) -> Array:
    """Vectors (n, 3) as a sensor with this misalignment and scale measures them, without noise."""
    return (1.0 + truth.scale) * Rotation.from_rotvec(truth.misalignment_rad).apply(vector)


def body_velocity(sensor: BodyVelocity, here: Kinematics, truth: Truth) -> Reading:
    """Velocity of the instrument in its own axes, m/s, over ground or through water that moves."""
    lever = np.asarray(sensor.lever_arm_b_m, dtype=np.float64)
    v_b = np.einsum("nij,ni->nj", here.C_nb, here.velocity_n - truth.current_n) + np.cross(here.rate_eb_b, lever)
    mounting = Rotation.from_euler("ZYX", sensor.mounting_rad[::-1])
    v = turned_and_scaled(mounting.inv().apply(v_b), truth)
    return v + truth.error, ("velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s")


def heading(sensor: Heading, here: Kinematics, truth: Truth) -> Reading:
    """Heading, rad, or the magnetic field in body axes; the temperature too if the compass has a temperature term."""
    declination = math.atan2(truth.field_n[1], truth.field_n[0])
    is_magnetic = sensor.magnetic or sensor.magnetometer
    if is_magnetic and sensor.declination_rad is not None:
        declination = sensor.declination_rad
    from_north = here.attitude[:, 2] - (declination if is_magnetic else 0.0)
    depth = truth.surface_height_m - here.height
    temperature = WATER_SURFACE_C + WATER_GRADIENT_C_M * depth
    warmth = temperature - sensor.reference_temperature_c
    error = truth.error[:, 0] + _cycles(from_north) @ truth.deviation_rad + truth.temperature_rad_per_k * warmth
    if sensor.magnetometer:
        value = _field(sensor, here, declination, error, truth.field_n)
        columns: tuple[str, ...] = ("field_x", "field_y", "field_z")
    else:
        value, columns = wrap(from_north + error)[:, None], ("heading_rad",)
    if sensor.temperature_sd_rad_per_k or truth.temperature_rad_per_k:
        return np.column_stack([value, temperature]), (*columns, "temperature_c")
    return value, columns


def _cycles(angle: Array) -> Array:
    """One, sine and cosine of the angle, sine and cosine of its double, (n, 5)."""
    waves = [np.ones_like(angle), np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)]
    return np.stack(waves, axis=-1)


def _field(sensor: Heading, here: Kinematics, declination: float, error: Array, field_n: Array) -> Array:
    """Field in body axes that shows a compass this error: a compass reading too high sees north too far to the left."""
    azimuth = declination - error
    level = math.hypot(field_n[0], field_n[1])
    down = np.full_like(azimuth, field_n[2])
    field = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), down], axis=-1)
    field_b = np.einsum("nij,ni->nj", here.C_nb, field)
    iron = np.linalg.inv(np.reshape(sensor.soft_iron, (3, 3)))
    return field_b @ iron.T + np.asarray(sensor.hard_iron)


def depth(sensor: Depth, here: Kinematics, truth: Truth) -> Reading:
    """Depth of the instrument below the surface, m, or the absolute pressure there, Pa."""
    lever_down = here.C_nb[:, 2, :] @ np.asarray(sensor.lever_arm_b_m, dtype=np.float64)
    below = truth.surface_height_m - here.height + lever_down + truth.offset_m + truth.error[:, 0]
    if not sensor.pressure:
        return below[:, None], ("depth_m",)
    from gsw import p_from_z

    pressure = sensor.atmospheric_pressure_pa + 1e4 * p_from_z(-below, np.degrees(here.latitude))
    return pressure[:, None], ("pressure_pa",)


def position(sensor: Position, here: Kinematics, truth: Truth) -> Reading:
    """Latitude, longitude, height of the antenna, rad and m, and the HDOP if there is one."""
    lever_n = here.C_nb @ np.asarray(sensor.lever_arm_b_m, dtype=np.float64)
    latitude, longitude, height = displaced(here, lever_n + truth.error)
    value = np.stack([latitude, longitude, height], axis=-1)
    columns: tuple[str, ...] = ("latitude_rad", "longitude_rad", "height_m")
    if truth.hdop is None:
        return value, columns
    return np.column_stack([value, truth.hdop]), (*columns, "hdop")


def displaced(here: Kinematics, by_n: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude, height of points some metres north, east and down of the vehicle.

    The curvature is taken at the middle of the way: exact to less than a micrometre for a hundred metres.
    """
    meridian, _ = radii(here.latitude)
    half = here.latitude + 0.5 * by_n[:, 0] / (meridian + here.height)
    meridian, across = radii(half)
    height = here.height - 0.5 * by_n[:, 2]
    latitude = here.latitude + by_n[:, 0] / (meridian + height)
    longitude = here.longitude + by_n[:, 1] / ((across + height) * np.cos(half))
    return latitude, longitude, here.height - by_n[:, 2]


def attitude(here: Kinematics, truth: Truth) -> Reading:
    """Roll, pitch and yaw, rad, with the deviation of the compass in the yaw."""
    yaw = here.attitude[:, 2]
    value = here.attitude + truth.error
    value[:, 2] += _cycles(yaw) @ truth.deviation_rad
    value[:, 2] = wrap(value[:, 2])
    return value, ("roll_rad", "pitch_rad", "yaw_rad")


READERS: dict[type[Sensor], Callable[..., Reading]] = {
    BodyVelocity: body_velocity,
    Heading: heading,
    Depth: depth,
    Position: position,
}

"""How the sensors of a simulated vehicle really are; what they read is said by their kinds (`Sensor.simulated`).

Written from the definitions, exactly (rotation matrices, radii of the ellipsoid, the magnetic field as a vector), and
sharing nothing with the measurement models of the filter, which are tested against it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navfilter.models.sensors.sensor import Reading
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

    def turned_and_scaled(self, vector: Array) -> Array:
        """Vectors (n, 3) as a sensor with this misalignment and scale (or scales) measures them, without noise."""
        return (1.0 + self.drawn["scale"]) * Rotation.from_rotvec(self.drawn["misalignment"]).apply(vector)

    def deviation(self, angle: Array) -> Array:
        """Compass error that follows the heading, rad, (n,)."""
        waves = [np.ones_like(angle), np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)]
        return np.stack(waves, axis=-1) @ self.drawn["deviation"]

    def water_temperature_c(self, here: Kinematics) -> Array:
        """Temperature of the water around the vehicle, deg C, (n,)."""
        return WATER_SURFACE_C + WATER_GRADIENT_C_M * (self.surface_height_m - here.height)


def attitude(here: Kinematics, truth: Truth, declination: float) -> Reading:
    """Roll, pitch and yaw, rad, with the deviation of the compass in the yaw, which counts from magnetic north."""
    yaw = here.attitude[:, 2] - declination
    value = here.attitude + truth.error
    value[:, 2] = wrap(yaw + truth.error[:, 2] + truth.deviation(yaw))
    return value, ("roll_rad", "pitch_rad", "yaw_rad")

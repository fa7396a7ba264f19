"""Position fixes, and depth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from navfilter.error_models import ErrorModel, GaussMarkov, White
from navfilter.kernels import listen, measurement
from navfilter.learning.drift import Drift
from navfilter.sensors.sensor import Errors, Sensor, Vector
from navfilter.start import Start

if TYPE_CHECKING:
    from navfilter.mechanisation import Mechanisation

__all__ = ["Depth", "Position"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Depth(Sensor):
    """Depth below the surface [m, positive down], or the absolute pressure [Pa] it is computed from.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the sensor, in b [m].
    pressure : bool
        Readings are absolute pressures [Pa], turned into depth by TEOS-10 (IOC, SCOR, IAPSO, 2010).
    atmospheric_pressure_pa : float
        Taken off the pressure [Pa].
    latitude_deg : float, optional
        For the pressure conversion; default 45 degrees (the depth changes by 0.5 % from equator to pole).
    surface_height_m : float
        Height of the water surface in the height system of the mission [m].
    offset_sd_m : float
        Standard deviation of an unknown constant offset [m]; 0 leaves the state out.
    """

    error: Errors = White(sd=0.1)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    pressure: bool = False
    atmospheric_pressure_pa: float = 101325.0
    latitude_deg: float = 45.0
    surface_height_m: float = 0.0
    offset_sd_m: float = 0.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.05, tau_s=10.0) + White(sd=0.05)
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.depth)
    confirms_state: ClassVar[bool] = False
    open_loop: ClassVar[int] = listen.POSITION

    def parameters(self) -> tuple[tuple[str, float], ...]:
        """The offset, or none."""
        return (("offset", self.offset_sd_m),) if self.offset_sd_m else ()

    def constants(self, start: Start) -> Array:
        """Lever arm and height of the surface."""
        return np.array([*self.lever_arm_b_m, self.surface_height_m], dtype=float)

    def read(self, value: Array) -> Array | None:
        """Pressure to depth where that is what arrives."""
        if not math.isfinite(value[0]):
            return None
        if not self.pressure:
            return value[:1]
        from gsw import z_from_p

        return np.array([-float(z_from_p((value[0] - self.atmospheric_pressure_pa) * 1e-4, self.latitude_deg))])

    def drift(self, drive: Mechanisation, axis: int, walk: float) -> Drift:
        """As a vertical position."""
        return drive.position_drift(walk, 1.0 / self.rate_hz, vertical=True)


@dataclass(frozen=True, kw_only=True)
class Position(Sensor):
    """Position fix (GPS, USBL): latitude, longitude [rad], height [m], optionally the HDOP as fourth element.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the antenna, in b [m].
    max_hdop : float
        Fixes with a greater HDOP are not readings (thesis, 4.3.1: 4).

    Notes
    -----
    Errors are in metres north, east, down. A NaN height is a 2-D fix.
    """

    error: Errors = White(sd=3.0)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    max_hdop: float = 4.0

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=3.0, tau_s=60.0) + White(sd=1.0)
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.position)
    open_loop: ClassVar[int] = listen.POSITION

    def constants(self, start: Start) -> Array:
        """The lever arm."""
        return np.asarray(self.lever_arm_b_m, dtype=float)

    def read(self, value: Array) -> Array | None:
        """None for a fix without latitude or longitude, off the globe, or of poor geometry."""
        if len(value) > 3 and value[3] > self.max_hdop:
            return None
        ok = abs(value[0]) <= math.pi / 2 and abs(value[1]) <= 2 * math.pi
        return np.ascontiguousarray(value[:3]) if ok else None

    def drift(self, drive: Mechanisation, axis: int, walk: float) -> Drift:
        """As a position, down being the third axis."""
        return drive.position_drift(walk, 1.0 / self.rate_hz, vertical=axis == 2)

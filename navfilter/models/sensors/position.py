"""Position fixes, and depth.

Height above the bottom: of a DVL, or an altimeter.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, Mask
from navfilter.kernels import measurement, open_loop_residual
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.navigation_drift import Drift, DriftSource
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import LARGEST, Sensor, Vector
from navfilter.models.sensors.traits import EXAMPLES, Columns, Doubt, Example, Plausible
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

ALTITUDE = Columns("altitude", ("altitude_m",), ("length",))


@dataclass(frozen=True, kw_only=True)
class Altitude(Sensor):
    """Height above the bottom [m], straight down: of a DVL beside its velocities, or of an altimeter.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the instrument, in b [m].
    bottom_height_m : float
        Height of the bottom in the height system of the mission [m]; 100 m of water: -100.
    bottom_sd_m : float
        How much the bottom rises and falls around it, as a standard deviation [m]: a state that wanders; 0: it is flat
        and there.
    bottom_tau_s : float
        In what time another bottom comes by [s].
    max_altitude_m : float
        A reading above it is no reading.

    Notes
    -----
    ``reading = height of the instrument - height of the bottom + error``. Over a bottom that nobody knows it says
    little, and does no harm: let `bottom_sd_m` say how little is known.
    """

    error: Errors = White(sd=0.1)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    bottom_height_m: float = -100.0
    bottom_sd_m: float = 0.0
    bottom_tau_s: float = 60.0
    max_altitude_m: float = 500.0

    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.altitude)
    confirms_state: ClassVar[bool] = False
    observes: ClassVar[Observable] = Observable.ALTITUDE
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((ALTITUDE,),)
    plausible: ClassVar[Plausible | None] = Plausible(1e-3, 20.0, "cm", most_rate_hz=100.0)
    template: ClassVar[Example | None] = EXAMPLES["altitude"]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, "bottom_sd_m", usual="1 m")
        check_numbers(self, "bottom_tau_s", zero_ok=False, usual="60 s")

    def parameters(self) -> tuple[Parameter, ...]:
        """How much higher the bottom is, or none."""
        return (Parameter("bottom", self.bottom_sd_m, "m"),) if self.bottom_sd_m else ()

    def wandering(self) -> dict[str, ErrorModel]:
        """The bottom."""
        return {"bottom": GaussMarkov(sd=self.bottom_sd_m, tau_s=self.bottom_tau_s)} if self.bottom_sd_m else {}

    def constants(self, start: Start) -> Array:
        """Lever arm and height of the bottom."""
        return np.array([*self.lever_arm_b_m, self.bottom_height_m])

    def read(self, value: Array) -> Array | None:
        """None for zero, which is no echo."""
        return value[:1] if 0.0 < value[0] <= self.max_altitude_m else None

    @property
    def words(self) -> str:
        """What it measures."""
        return "height above the bottom"

    def doubts(self) -> Iterator[Doubt]:
        """Of a bottom above the water."""
        if self.bottom_height_m > 0.0:
            text = f"the bottom is described {self.bottom_height_m:.4g} m above the mission's zero height."
            yield Doubt("bottom_height_m", text, "Heights are positive up: 100 m of water is -100.")

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Of the instrument, above a bottom that rises and falls as described."""
        lever_down = here.C_nb[:, 2, :] @ np.asarray(self.lever_arm_b_m, dtype=np.float64)
        bottom = self.bottom_height_m + truth.wandering.get("bottom", np.zeros(len(here.time_s)))
        return (here.height - lever_down - bottom + truth.error[:, 0])[:, None], ALTITUDE.names

    @classmethod
    def examples(cls) -> "tuple[Altitude, ...]":
        """Over a bottom that wanders."""
        return (cls(bottom_sd_m=1.0),)


DEPTH = Columns("depth", ("depth_m",), ("length",))
PRESSURE = Columns("pressure", ("pressure_Pa",), ("pressure",))
POSITION = Columns(
    "position",
    ("latitude_rad", "longitude_rad", "height_m"),
    ("angle", "angle", "length"),
    circular=("longitude_rad",),
    least=2,
)
#: No vehicle that navigates by these sensors is higher, or deeper [m].
HIGHEST_M = 1e5
HDOP = Columns("hdop", ("hdop",), ("number",))


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
    open_loop: ClassVar[int] = open_loop_residual.POSITION
    gives: ClassVar[str] = "depth"
    observes: ClassVar[Observable] = Observable.HEIGHT
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((DEPTH,), (PRESSURE,))
    plausible: ClassVar[Plausible | None] = Plausible(1e-4, 10.0, "cm", most_rate_hz=200.0)
    template: ClassVar[Example | None] = EXAMPLES["depth"]

    def parameters(self) -> tuple[Parameter, ...]:
        """The offset, or none."""
        return (Parameter("offset", self.offset_sd_m, "m"),) if self.offset_sd_m else ()

    def constants(self, start: Start) -> Array:
        """Lever arm and height of the surface."""
        return np.array([*self.lever_arm_b_m, self.surface_height_m], dtype=float)

    def read(self, value: Array) -> Array | None:
        """Pressure to depth where that is what arrives."""
        if not abs(value[0]) <= LARGEST:
            return None
        if not self.pressure:
            return value[:1]
        from gsw import z_from_p

        return np.array([-float(z_from_p((value[0] - self.atmospheric_pressure_pa) * 1e-4, self.latitude_deg))])

    @property
    def plain(self) -> tuple[float, int]:
        """A depth."""
        return (0.0, 0) if self.pressure or type(self).read is not Depth.read else (LARGEST, 1)

    def read_all(self, values: Array | Sequence[Array]) -> tuple[Array, Mask]:
        """Depths at once; pressures one by one."""
        if self.pressure or type(self).read is not Depth.read or not isinstance(values, np.ndarray):
            return super().read_all(values)
        return np.ascontiguousarray(values[:, :1]), np.abs(values[:, 0]) <= LARGEST

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """As a vertical position."""
        return drive.position_drift(walk, 1.0 / self.rate_hz, vertical=True)

    @property
    def words(self) -> str:
        """What it measures."""
        return "depth from absolute pressure" if self.pressure else "depth"

    def stream_columns(self) -> tuple[str, ...]:
        """Depth or pressure."""
        return PRESSURE.names if self.pressure else DEPTH.names

    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """The offset."""
        return {"offset": (Parameter("offset", self.offset_sd_m, "m"),)}

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Depth of the instrument below the surface, or the absolute pressure there."""
        lever_down = here.C_nb[:, 2, :] @ np.asarray(self.lever_arm_b_m, dtype=np.float64)
        below = truth.surface_height_m - here.height + lever_down + truth.drawn["offset"][0] + truth.error[:, 0]
        if not self.pressure:
            return below[:, None], ("depth_m",)
        from gsw import p_from_z

        pressure = self.atmospheric_pressure_pa + 1e4 * p_from_z(-below, np.degrees(here.latitude))
        return pressure[:, None], ("pressure_pa",)

    @classmethod
    def examples(cls) -> tuple[Sensor, ...]:
        """A depth, and a pressure to be converted."""
        return cls(), cls(pressure=True)


@dataclass(frozen=True, kw_only=True)
class Position(Sensor):
    """Position fix (GPS, USBL): latitude, longitude [rad], height [m], optionally the HDOP as fourth element.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point to the antenna, in b [m].
    max_hdop : float
        Fixes with a greater HDOP are not readings (thesis, 4.3.1: 4).
    antenna_height_m : float, optional
        Where the antenna is whenever there is a fix, in the height system of the mission [m]: above the water, where
        the surface is 0. It takes the place of the height of each fix; the error down is then that of this height.

    Notes
    -----
    Errors are in metres north, east, down. A NaN height is a 2-D fix.

    No fix is had under water. With `antenna_height_m` each one says so, and each surfacing tells a depth gauge its
    `offset_sd_m`. Trim, waves and the tide keep the antenna off that height for longer than from fix to fix: give the
    error down the time in which they change.

    A receiver without a fix yet says latitude 0, longitude 0: exactly that is no reading. A vehicle near there loses
    nothing, for fixes that are both exactly 0 do not happen to it.
    """

    error: Errors = White(sd=3.0)
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    max_hdop: float = 4.0
    antenna_height_m: float | None = None

    prior: ClassVar[ErrorModel] = GaussMarkov(sd=3.0, tau_s=60.0) + White(sd=1.0)
    axes: ClassVar[int] = 3
    reads: ClassVar[int] = 3
    axis_names: ClassVar[tuple[str, ...]] = ("north", "east", "down")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.position)
    open_loop: ClassVar[int] = open_loop_residual.POSITION
    gives: ClassVar[str] = "position"
    observes: ClassVar[Observable] = Observable.FIX
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((POSITION,),)
    beside: ClassVar[tuple[Columns, ...]] = (HDOP,)
    plausible: ClassVar[Plausible | None] = Plausible(
        3e-3, 1000.0, "", most_rate_hz=50.0, hint="Errors of fixes are in metres, not in degrees or radians."
    )
    template: ClassVar[Example | None] = EXAMPLES["gps"]

    @property
    def words(self) -> str:
        """What it measures, and what takes the place of its height."""
        height = self.antenna_height_m
        return "position" if height is None else f"position, the antenna at a height of {height:g} m"

    def constants(self, start: Start) -> Array:
        """The lever arm."""
        return np.asarray(self.lever_arm_b_m, dtype=float)

    def read(self, value: Array) -> Array | None:
        """None for a fix without latitude or longitude, off the globe or far above it, at 0, 0, or of poor geometry."""
        if (len(value) > 3 and value[3] > self.max_hdop) or value[0] == 0.0 == value[1]:
            return None
        if not (abs(value[0]) <= math.pi / 2 and abs(value[1]) <= 2 * math.pi) or abs(value[2]) > HIGHEST_M:
            return None
        if self.antenna_height_m is None:
            return np.ascontiguousarray(value[:3])
        return np.array([value[0], value[1], self.antenna_height_m])

    def read_all(self, values: Array | Sequence[Array]) -> tuple[Array, Mask]:
        """The same of many."""
        otherwise = type(self).read is not Position.read
        if otherwise or not isinstance(values, np.ndarray) or values.shape[1] < self.reads:
            return super().read_all(values)
        north, east, up = values.T[:3]
        poor = ((north == 0.0) & (east == 0.0)) | (np.abs(up) > HIGHEST_M)
        if values.shape[1] > 3:
            poor |= values[:, 3] > self.max_hdop
        z = np.array(values[:, :3], dtype=np.float64)
        if self.antenna_height_m is not None:
            z[:, 2] = self.antenna_height_m
        good = ~poor & (np.abs(north) <= math.pi / 2) & (np.abs(east) <= 2 * math.pi)
        z[~good] = math.nan
        return z, good

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """As a position, down being the third axis."""
        return drive.position_drift(walk, 1.0 / self.rate_hz, vertical=axis == 2)

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """Latitude, longitude, height of the antenna, and the HDOP if there is one."""
        lever_n = here.C_nb @ np.asarray(self.lever_arm_b_m, dtype=np.float64)
        value = np.stack(here.displaced(lever_n + truth.error), axis=-1)
        if truth.hdop is None:
            return value, POSITION.names
        return np.column_stack([value, truth.hdop]), (*POSITION.names, *HDOP.names)

"""Ranges to beacons: long baseline, a single beacon, radios.

Ultra-short baseline: where a ship hears the vehicle.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.kernels import consistency, measurement, strapdown
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector, checked_vector
from navfilter.models.sensors.traits import EXAMPLES, Columns, Doubt, Example, Plausible, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

EARTH = (strapdown.EARTH_RADIUS, strapdown.EARTH_E2)
RANGE = Columns("range", ("range_m",), ("length",))
BEACON = Columns("beacon", ("beacon",), ("number",))
#: What a plane leaves out of a sphere is the same until the line of sight has turned: readings of so long count as one,
#: for each metre of distance [s/m]; at 1.5 m/s it turns by 0.3 rad. One beacon beside a unit that drifts by hundreds of
#: metres had a position NEES of 13000 by 0; by 0.1 and 0.3 it had 1.9 and 1.4, and where ranges carry the place errors
#: were larger by 0.6 and 1 %.
SIGHT_S_PER_M = 0.2
_AXES = ("north", "east", "down")


def earth_fixed(latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> Array:
    """Points in the Earth's axes [m], shape (..., 3), from latitude, longitude [rad] and height [m] (Groves, 2013, eq
    2.112).
    """
    phi, lam, h = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (latitude, longitude, height)))
    radius, e2 = EARTH
    across = radius / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    level = (across + h) * np.cos(phi)
    up = (across * (1.0 - e2) + h) * np.sin(phi)
    return np.stack([level * np.cos(lam), level * np.sin(lam), up], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Range(Sensor):
    """Slant ranges [m] to one or several beacons: long-baseline acoustics, one-way travel times, radios.

    Parameters
    ----------
    beacons : tuple of (latitude, longitude, height)
        Where each beacon is described to be [deg, deg, m above the ellipsoid].
    beacon_ids : tuple of int
        What the readings call them; default 0, 1, 2, ...
    lever_arm_b_m : (3,) float
        From the reference point to the transducer, in b [m].
    beacon_sd_m : (3,) float
        Standard deviation of each beacon's place north, east, down [m]: three states a beacon. All zero: they are
        where they are described.
    scale_sd : float
        Standard deviation of an unknown constant scale error: that of the speed of sound with which travel times were
        turned into ranges; 0 leaves the state out.
    offset_sd_m : float
        Standard deviation of an unknown constant offset of each beacon (its turn-around time, a clock) [m]; 0 leaves
        the states out.
    max_range_m : float
        A reading above it is no reading.

    Notes
    -----
    ``reading = (1 + scale) distance + offset + error``. A reading is the range, and the id of its beacon where there
    are several. A beacon that is hardly known is found by `navfilter.locate_beacons` first, because the filter takes
    ranges as linear around where it believes beacon and vehicle to be.
    """

    error: Errors = White(sd=1.0)
    beacons: tuple[Vector, ...] = ()
    beacon_ids: tuple[int, ...] = ()
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    beacon_sd_m: Vector = (0.0, 0.0, 0.0)
    scale_sd: float = 0.0
    offset_sd_m: float = 0.0
    max_range_m: float = 20000.0

    sight_s_per_m: ClassVar[float] = SIGHT_S_PER_M
    prior: ClassVar[ErrorModel] = GaussMarkov(sd=0.5, tau_s=10.0) + White(sd=0.5)
    reads: ClassVar[int] = 1
    axis_names: ClassVar[tuple[str, ...]] = ("",)
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.slant_range)
    observes: ClassVar[Observable] = Observable.RANGE
    bend: ClassVar[Callable[..., None] | None] = staticmethod(consistency.range_second_order)
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((RANGE,),)
    beside: ClassVar[tuple[Columns, ...]] = (BEACON,)
    plausible: ClassVar[Plausible | None] = Plausible(1e-3, 200.0, "cm", most_rate_hz=100.0)
    template: ClassVar[Example | None] = EXAMPLES["ranges"]

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(checked_vector("Range.beacon_sd_m", self.beacon_sd_m)) < 0.0:
            raise ValueError(f"Range.beacon_sd_m must not be negative, found {self.beacon_sd_m!r}.")
        check_numbers(self, "scale_sd", "offset_sd_m")
        if not self.beacons:
            raise ValueError(
                "Range.beacons must name at least one beacon, found none. Example: beacons=((26.0, -80.0, -50.0),), "
                "latitude and longitude [deg], height [m]."
            )
        for k, beacon in enumerate(self.beacons):
            latitude, longitude, _ = checked_vector(f"Range.beacons[{k}]", beacon)
            if abs(latitude) > 90.0 or abs(longitude) > 360.0:
                raise ValueError(
                    f"Range.beacons[{k}] must be latitude and longitude [deg] and height [m], found {beacon!r}."
                )
        if self.beacon_ids and (
            len(self.beacon_ids) != len(self.beacons) or len(set(self.beacon_ids)) != len(self.beacon_ids)
        ):
            raise ValueError(
                f"Range.beacon_ids must be {len(self.beacons)} different numbers, one a beacon, found "
                f"{self.beacon_ids!r}."
            )

    @property
    def ids(self) -> tuple[int, ...]:
        """What readings call the beacons."""
        return self.beacon_ids or tuple(range(len(self.beacons)))

    def parameters(self) -> tuple[Parameter, ...]:
        """Scale, an offset of each beacon, and its place, where they are uncertain."""
        found = [Parameter("scale", self.scale_sd, "1")] if self.scale_sd else []
        if self.offset_sd_m:
            found += [Parameter(f"offset_{key}", self.offset_sd_m, "m") for key in self.ids]
        if any(self.beacon_sd_m):
            sds = list(zip(_AXES, self.beacon_sd_m, strict=True))
            found += [Parameter(f"beacon_{key}_{axis}", sd, "m") for key in self.ids for axis, sd in sds]
        return tuple(found)

    def constants(self, start: Start) -> Array:
        """The Earth, the lever arm, where the parameters stand, the beacons in the Earth's axes, and how many readings
        of one share what a plane leaves out.
        """
        shared = self.sight_s_per_m * self.rate_hz / len(self.beacons)
        return np.concatenate([EARTH, self.lever_arm_b_m, self.beginnings(), self.places().ravel(), [shared]])

    def beginnings(self) -> tuple[int, int, int]:
        """Where scale, offsets and places of the beacons begin among the parameters; -1 for none."""
        scale, offsets = int(bool(self.scale_sd)), len(self.beacons) if self.offset_sd_m else 0
        return 0 if scale else -1, scale if offsets else -1, scale + offsets if any(self.beacon_sd_m) else -1

    def places(self) -> Array:
        """The beacons in the Earth's axes [m], shape (k, 3)."""
        latitude, longitude, height = np.array(self.beacons, dtype=np.float64).T
        return earth_fixed(np.radians(latitude), np.radians(longitude), height)

    def read(self, value: Array) -> Array | None:
        """The range and the place of its beacon in the list; None for a beacon that is not in it."""
        if not 0.0 < value[0] <= self.max_range_m:
            return None
        if len(value) < 2:
            return np.array([value[0], 0.0]) if len(self.beacons) == 1 else None
        return np.array([value[0], float(self.ids.index(value[1]))]) if value[1] in self.ids else None

    @property
    def words(self) -> str:
        """What it measures."""
        return f"range to {len(self.beacons)} beacon{'s' if len(self.beacons) > 1 else ''}"

    def stream_columns(self) -> tuple[str, ...]:
        """The range, and its beacon where there are several."""
        return (*RANGE.names, *BEACON.names) if len(self.beacons) > 1 else RANGE.names

    def doubts(self) -> Iterator[Doubt]:
        """Of scale and offset, and of beacons that are hardly known."""
        if self.scale_sd > 0.1:
            text = f"a scale error of {100.0 * self.scale_sd:.4g} % is unusual."
            yield Doubt("scale_sd", text, "It is a pure number: 1 % is 0.01. The speed of sound is known to 3 %.")
        if self.offset_sd_m > 100.0:
            yield Doubt("offset_sd_m", f"an offset of {self.offset_sd_m:.4g} m is unusual.", "It is in metres.")
        if max(self.beacon_sd_m) > 30.0:
            text = f"beacons that are known to {max(self.beacon_sd_m):.4g} m only: the filter takes ranges as linear."
            cure = "Find them first (navfilter.locate_beacons); it says how well they are known then."
            yield Doubt("beacon_sd_m", text, cure)

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """The chord from the transducer to the beacons, one after the other."""
        lever_n = here.C_nb @ np.asarray(self.lever_arm_b_m, dtype=np.float64)
        transducer = earth_fixed(*here.displaced(lever_n))
        number = np.arange(len(here.time_s)) % len(self.beacons)
        beacons = np.array([self._really(k, truth) for k in range(len(self.beacons))])
        distance = np.linalg.norm(beacons[number] - transducer, axis=1)
        offsets = np.array([truth.drawn.get(f"offset_{key}", np.zeros(1))[0] for key in self.ids])
        scale = truth.drawn["scale"][0] if "scale" in truth.drawn else 0.0
        value = (1.0 + scale) * distance + offsets[number] + truth.error[:, 0]
        if len(self.beacons) == 1:
            return value[:, None], RANGE.names
        return np.column_stack([value, np.array(self.ids)[number]]), (*RANGE.names, *BEACON.names)

    def _really(self, number: int, truth: Truth) -> Array:
        """Where a beacon really is, in the Earth's axes [m]."""
        latitude, longitude = (math.radians(angle) for angle in self.beacons[number][:2])
        height = self.beacons[number][2]
        north, east, down = (truth.drawn.get(f"beacon_{self.ids[number]}_{axis}", np.zeros(1))[0] for axis in _AXES)
        meridian, across = strapdown.radii(latitude)
        east_rad = east / ((across + height) * math.cos(latitude))
        return earth_fixed(latitude + north / (meridian + height), longitude + east_rad, height - down)

    @classmethod
    def examples(cls) -> "tuple[Range, ...]":
        """Two beacons with everything uncertain."""
        beacons = ((30.001, 0.0, -20.0), (30.0, 0.001, -20.0))
        return (cls(beacons=beacons, beacon_sd_m=(1.0, 1.0, 1.0), scale_sd=0.01, offset_sd_m=0.5),)


POLAR = Columns(
    "usbl",
    ("usbl_range_m", "usbl_bearing_rad", "usbl_elevation_rad"),
    ("length", "angle", "angle"),
    circular=("usbl_bearing_rad",),
    independent=True,
)
RELATIVE = Columns("usbl_relative", ("usbl_forward_m", "usbl_right_m", "usbl_down_m"), ("length",) * 3)
SHIP = Columns(
    "ship",
    ("ship_latitude_rad", "ship_longitude_rad", "ship_height_m"),
    ("angle", "angle", "length"),
    circular=("ship_longitude_rad",),
)
SHIP_ATTITUDE = Columns(
    "ship_attitude",
    ("ship_roll_rad", "ship_pitch_rad", "ship_heading_rad"),
    ("angle",) * 3,
    circular=("ship_heading_rad",),
)
#: A navigator keeps no more of the past than this [s].
LATEST_S = 60.0
_WANDERING = ("ship_north", "ship_east", "ship_down")


@dataclass(frozen=True, kw_only=True)
class Usbl(Sensor):
    """Where a ship with an ultra-short baseline hears the vehicle: range and direction, or a relative position.

    Each reading brings the ship's own position and attitude.

    Parameters
    ----------
    lever_arm_b_m : (3,) float
        From the reference point of the vehicle to its transponder, in b [m].
    relative : bool
        The reading is a relative position forward, right, down [m] instead of range, bearing, elevation.
    transceiver_m : (3,) float
        From the point whose position the ship gives to the transceiver, forward, right, down in the ship [m].
    transceiver_mounting_rad : (3,) float
        Roll, pitch, yaw of the transceiver in the ship [rad].
    misalignment_sd_rad : float
        Standard deviation of an unknown constant error of that mounting about each axis [rad]; 0 leaves the states out.
    scale_sd : float
        Standard deviation of an unknown constant scale error of the range (speed of sound); 0 leaves the state out.
    ship_sd_m : (3,) float
        Standard deviation of the ship's own position north, east, down [m], three states that wander; all zero: none.
    ship_tau_s : float
        Correlation time of that error [s].
    max_range_m : float
        A reading above it is no reading.
    late_s : float
        Readings may come so late [s].

    Notes
    -----
    A reading has three elements, range [m], bearing (from forward to the right) and elevation (from the horizontal
    downwards) [rad], or the relative position; then the ship's latitude, longitude [rad] and height [m]; then her roll,
    pitch and heading [rad]. Without these, or where the heading is NaN, bearings count from true north and the
    horizontal, and relative positions are north, east, down. The errors are those of the range [m] and of the
    direction, across the line of sight and along the elevation [rad]. The time of a reading is when the vehicle was
    heard; when it comes late, the navigator goes back and takes it in its place.
    """

    error: Errors = (White(sd=1.0), White(sd=0.01), White(sd=0.01))
    lever_arm_b_m: Vector = (0.0, 0.0, 0.0)
    relative: bool = False
    transceiver_m: Vector = (0.0, 0.0, 0.0)
    transceiver_mounting_rad: Vector = (0.0, 0.0, 0.0)
    misalignment_sd_rad: float = 0.0
    scale_sd: float = 0.0
    ship_sd_m: Vector = (0.0, 0.0, 0.0)
    ship_tau_s: float = 60.0
    max_range_m: float = 20000.0
    late_s: float = 5.0  # type: ignore[misc]

    unit: ClassVar[str] = "rad"
    axes: ClassVar[int] = 3
    axis_units: ClassVar[tuple[str, ...]] = ("m", "rad", "rad")
    reads: ClassVar[int] = 6
    axis_names: ClassVar[tuple[str, ...]] = ("range", "across", "elevation")
    kernel: ClassVar[Callable[..., None]] = staticmethod(measurement.usbl)
    observes: ClassVar[Observable] = Observable.RANGE
    bend: ClassVar[Callable[..., None] | None] = staticmethod(consistency.usbl_second_order)
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ((POLAR, SHIP), (RELATIVE, SHIP))
    beside: ClassVar[tuple[Columns, ...]] = (SHIP_ATTITUDE,)
    template: ClassVar[Example | None] = EXAMPLES["usbl"]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("transceiver_m", "transceiver_mounting_rad", "ship_sd_m"):
            checked_vector(f"Usbl.{name}", getattr(self, name))
        check_numbers(self, "misalignment_sd_rad", "scale_sd")
        check_numbers(self, "ship_tau_s", zero_ok=False, usual="60 s")
        if min(self.ship_sd_m) < 0.0:
            raise ValueError(f"Usbl.ship_sd_m must not be negative, found {self.ship_sd_m!r}. Usual: (1, 1, 2) m.")
        if not 0.0 <= self.late_s <= LATEST_S:
            raise ValueError(
                f"Usbl.late_s must lie between 0 and {LATEST_S:g}, found {self.late_s!r}: so much of the past is kept."
            )

    def parameters(self) -> tuple[Parameter, ...]:
        """Scale, misalignment and error of the ship's place, where they are uncertain."""
        found = [Parameter("scale", self.scale_sd, "1")] if self.scale_sd else []
        if self.misalignment_sd_rad:
            found += [Parameter(f"misalignment_{axis}", self.misalignment_sd_rad, "rad") for axis in "xyz"]
        if any(self.ship_sd_m):
            found += [Parameter(name, sd, "m") for name, sd in zip(_WANDERING, self.ship_sd_m, strict=True)]
        return tuple(found)

    def wandering(self) -> dict[str, ErrorModel]:
        """The error of the ship's place."""
        if not any(self.ship_sd_m):
            return {}
        return {
            name: GaussMarkov(sd=sd, tau_s=self.ship_tau_s) for name, sd in zip(_WANDERING, self.ship_sd_m, strict=True)
        }

    def constants(self, start: Start) -> Array:
        """The Earth, the lever arm, where the parameters stand, and how many readings share what a plane leaves out."""
        scale, turned = int(bool(self.scale_sd)), 3 * bool(self.misalignment_sd_rad)
        at = (0 if scale else -1, scale if turned else -1, scale + turned if any(self.ship_sd_m) else -1)
        return np.array([*EARTH, *self.lever_arm_b_m, *at, SIGHT_S_PER_M * self.rate_hz])

    def read(self, value: Array) -> Array | None:
        """Range, bearing and elevation; the transceiver in the Earth's axes, and the rotation from these into its own.

        None without the ship's position, or without anything measured.
        """
        seen, ship, angles = value[:3].copy(), value[3:6], np.zeros(3)
        if not np.isfinite(ship).all() or abs(ship[0]) > 0.5 * math.pi:
            return None
        if self.relative:
            forward, right, down = seen.tolist()
            level = math.hypot(forward, right)
            seen = np.array([math.hypot(level, down), math.atan2(right, forward), math.atan2(down, level)])
        if np.isfinite(seen[0]) and not 0.0 < seen[0] <= self.max_range_m:
            return None
        if not np.isfinite(seen).any():
            return None
        aboard = len(value) > 8 and bool(np.isfinite(value[8]))
        if aboard:
            angles = np.nan_to_num(value[6:9])
        n_to_ship = matrix_from_euler(*angles).T
        earth_to_n = _axes(ship[0], ship[1])
        mounting = matrix_from_euler(*self.transceiver_mounting_rad) if aboard else np.eye(3)
        arm_e = earth_to_n.T @ (n_to_ship.T @ np.asarray(self.transceiver_m, dtype=float)) if aboard else 0.0
        rotation = mounting.T @ n_to_ship @ earth_to_n
        return np.concatenate([seen, earth_fixed(*ship) + arm_e, rotation.ravel()])

    @property
    def words(self) -> str:
        """What it measures."""
        return "position relative to a ship" if self.relative else "range and direction from a ship"

    def stream_columns(self) -> tuple[str, ...]:
        """What is measured, and the ship's position."""
        return (*(RELATIVE.names if self.relative else POLAR.names), *SHIP.names)

    def doubts(self) -> Iterator[Doubt]:
        """Of errors in other units, mounting and scale."""
        usual = (1e-3, 100.0), (1e-4, 0.2), (1e-4, 0.2)
        for model, axis, (least, most) in zip(self.models, self.axis_names, usual, strict=True):
            block = model.block(1.0 / self.rate_hz)
            sd = math.sqrt(block.variance)
            if not least <= sd <= most:
                unit, cure = ("m", "It is in metres.") if axis == "range" else ("rad", "In degrees write sd_deg.")
                yield Doubt(f"error.{axis}", f"an error of {sd:.3g} {unit} is unusual.", cure)
        if max(map(abs, self.transceiver_mounting_rad)) > 2.0 * math.pi:
            yield angle_doubt("transceiver_mounting_rad", max(self.transceiver_mounting_rad, key=abs))
        if self.misalignment_sd_rad > math.radians(20.0):
            yield angle_doubt("misalignment_sd_rad", self.misalignment_sd_rad)
        if self.scale_sd > 0.1:
            text = f"a scale error of {100.0 * self.scale_sd:.4g} % is unusual."
            yield Doubt("scale_sd", text, "It is a pure number: 1 % is 0.01. The speed of sound is known to 3 %.")

    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """Scale, and the rotation vector of the misalignment."""
        return {
            "scale": (Parameter("scale", self.scale_sd, "1"),),
            "misalignment": tuple(Parameter(f"misalignment_{axis}", self.misalignment_sd_rad, "rad") for axis in "xyz"),
        }

    def aboard(self, t: Array) -> Array:
        """Roll, pitch and heading of a simulated ship [rad], at times from the first on [s], shape (n, 3)."""
        return np.column_stack([0.05 * np.sin(0.6 * t), 0.03 * np.sin(0.5 * t), 0.5 + 0.3 * np.sin(0.02 * t)])

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """From a ship that follows at a knot and yaws, 50 m off the vehicle's first place."""
        from scipy.spatial.transform import Rotation  # only a simulation needs it

        t = here.time_s - here.time_s[0]
        latitude, longitude = here.latitude[0] + (50.0 + 0.3 * t) / 6.37e6, here.longitude[0] - 0.4 * t / 6.37e6
        attitude = self.aboard(t)
        height = truth.surface_height_m + 0.3 * np.sin(0.5 * t)
        turn = matrix_from_euler(*attitude.T)
        axes = _axes(latitude, longitude)
        ship = earth_fixed(latitude, longitude, height)
        transceiver = ship + np.einsum("nji,nj->ni", axes, turn @ np.asarray(self.transceiver_m, dtype=float))
        transponder = earth_fixed(*here.displaced(here.C_nb @ np.asarray(self.lever_arm_b_m, dtype=float)))
        seen = np.einsum("nji,njk,nk->ni", turn, axes, transponder - transceiver)
        seen = Rotation.from_euler("ZYX", self.transceiver_mounting_rad[::-1]).inv().apply(seen)
        seen = Rotation.from_rotvec(truth.drawn["misalignment"]).apply(seen)
        measured = _displaced(seen, 1.0 + truth.drawn["scale"][0], truth.error)
        if not self.relative:
            r, level = np.linalg.norm(measured, axis=1), np.hypot(measured[:, 0], measured[:, 1])
            bearing, elevation = np.arctan2(measured[:, 1], measured[:, 0]), np.arctan2(measured[:, 2], level)
            measured = np.column_stack([r, bearing, elevation])
        astray = np.column_stack([truth.wandering.get(name, np.zeros_like(t)) for name in _WANDERING])
        place = [latitude + astray[:, 0] / 6.37e6, longitude + astray[:, 1] / (6.37e6 * np.cos(latitude))]
        value = np.column_stack([measured, *place, height - astray[:, 2], attitude])
        return value, (*self.stream_columns(), *SHIP_ATTITUDE.names)

    @classmethod
    def examples(cls) -> "tuple[Usbl, ...]":
        """With everything uncertain."""
        return (cls(misalignment_sd_rad=0.01, scale_sd=0.01, ship_sd_m=(1.0, 1.0, 1.0)),)


def _axes(latitude: Array | float, longitude: Array | float) -> Array:
    """Rows north, east and down in the Earth's axes, shape (..., 3, 3)."""
    s, c, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    rows = [[-s * co, -s * so, c], [-so, co, np.zeros_like(s)], [-c * co, -c * so, -s]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _displaced(seen: Array, scale: float, error: Array) -> Array:
    """Relative positions (n, 3) as they are measured: another length, and turned across and along the elevation."""
    from scipy.spatial.transform import Rotation

    r = np.linalg.norm(seen, axis=1)
    sight = seen / r[:, None]
    level = np.hypot(sight[:, 0], sight[:, 1])
    across = np.column_stack([-sight[:, 1] / level, sight[:, 0] / level, np.zeros_like(r)])
    below = np.cross(sight, across)
    # a turn about `below` moves the sight along `across`, one about `across` moves it against `below`
    turn = Rotation.from_rotvec(error[:, 1:2] * below - error[:, 2:3] * across)
    return np.asarray((scale * r + error[:, 0])[:, None] * turn.apply(sight))

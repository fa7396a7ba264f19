"""Ultra-short baseline: where a ship hears the vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.kernels import consistency, measurement
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.ranges import EARTH, SIGHT_S_PER_M, earth_fixed
from navfilter.models.sensors.sensor import Sensor, Vector, checked_vector
from navfilter.models.sensors.traits import Columns, Doubt, Example, angle_doubt
from navfilter.models.start import Start
from navfilter.models.state import matrix_from_euler
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

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
    template: ClassVar[Example | None] = Example(
        "usbl",
        "USBL: range and direction in which a ship hears the vehicle, with her own position and attitude. Errors "
        "of the range [m], then across the line of sight and along the elevation [rad].",
        0.2,
        (
            'error = {range = {model = "white", sd = 1.0}, across = {model = "white", sd_deg = 0.5}, '
            'elevation = {model = "white", sd_deg = 0.5}}',
        ),
        (0.0, 0.0, -0.3),
        live=False,
    )

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
    def examples(cls) -> tuple[Usbl, ...]:
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

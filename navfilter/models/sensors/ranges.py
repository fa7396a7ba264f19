"""Ranges to beacons: long baseline, a single beacon, radios."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from navfilter.foundation.arrays import Array
from navfilter.kernels import consistency, measurement, strapdown
from navfilter.models.error_models import ErrorModel, Errors, GaussMarkov, White, check_numbers
from navfilter.models.parameters import Parameter
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.sensor import Sensor, Vector, checked_vector
from navfilter.models.sensors.traits import Columns, Doubt, Example, Plausible
from navfilter.models.start import Start
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
    template: ClassVar[Example | None] = Example(
        "ranges",
        "Ranges to beacons (long baseline, a single beacon): latitude, longitude [deg] and height [m] of each.",
        1,
        ("beacons = [[26.0, -80.0, -50.0]]", 'error = {model = "white", sd = 1.0}'),
        (0.0, 0.0, -0.3),
        live=False,
    )

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
    def examples(cls) -> tuple[Range, ...]:
        """Two beacons with everything uncertain."""
        beacons = ((30.001, 0.0, -20.0), (30.0, 0.001, -20.0))
        return (cls(beacons=beacons, beacon_sd_m=(1.0, 1.0, 1.0), scale_sd=0.01, offset_sd_m=0.5),)

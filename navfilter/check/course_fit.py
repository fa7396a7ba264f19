"""Which way a body velocity must be turned, scaled and shifted to follow the positions, and how sure that is.

Small mathematics on time series that the checks share.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second
from numpy.typing import NDArray

from navfilter.foundation.arrays import Array, Complex, Ints, Mask
from navfilter.models.mission import Mission, Stream

Number = TypeVar("Number", np.float64, np.complex128)


def vector(stream: Stream, first: str) -> Array:
    """Three columns of a stream, (n, 3), from the one named `first` on."""
    start = stream.columns.index(first)
    return stream.value[:, start : start + 3]


#: Times and values.
Series = tuple[Array, Array]
#: More windows than these say nothing new and take long.
MOST_WINDOWS = 20_000


def window_edges(begin_s: float, end_s: float, step_s: float) -> Array:
    """Starts of windows between two times, `step_s` apart or, on a long mission, as far as `MOST_WINDOWS` need."""
    return np.arange(begin_s, end_s, max(step_s, (end_s - begin_s) / MOST_WINDOWS))


def integral(time_s: Array, value: NDArray[Number]) -> NDArray[Number]:
    """Running trapezoidal integral along the first axis; a missing value counts as the last known one."""
    filled = np.array(value)
    flat = filled.reshape(len(filled), -1)
    for k in range(flat.shape[1]):
        known = np.isfinite(flat[:, k])
        flat[:, k] = np.interp(time_s, time_s[known], flat[known, k]) if known.any() else 0.0
    return scipy.integrate.cumulative_trapezoid(filled, time_s, axis=0, initial=0)


def increments(edges: Array, window_s: float, series: Series, late_s: float = 0.0) -> Array:
    """What a series changes by in windows that begin at these edges, and as much later."""
    return np.interp(edges + window_s + late_s, *series) - np.interp(edges + late_s, *series)


def correlation(a: Array, b: Array) -> tuple[float, float]:
    """Correlation of two series and the slope of b on a, both without their means."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both] - a[both].mean(), b[both] - b[both].mean()
    aa, bb, ab = float(a @ a), float(b @ b), float(a @ b)
    if aa <= 0.0 or bb <= 0.0:
        return 0.0, 0.0
    return ab / math.sqrt(aa * bb), ab / aa


def jackknife(estimate: Callable[[Ints], Array], rows: int) -> tuple[Array, Array]:
    """An estimate from all rows, and its standard deviations by leaving out each tenth in turn (Tukey, 1958).

    Rows that follow each other may depend on each other; tenths hardly do.
    """
    every = np.arange(rows)
    left_out = np.array([estimate(np.setdiff1d(every, part)) for part in np.array_split(every, 10)])
    spread = np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)
    return estimate(every), np.sqrt(0.9 * spread)


def factors(columns: Array, goal: Array) -> tuple[Array, Array]:
    """Factors of some columns that give a series by least squares, and their standard deviations (`jackknife`)."""

    def of(rows: Ints) -> Array:
        return np.asarray(np.linalg.lstsq(columns[rows], goal[rows], rcond=None)[0], dtype=np.float64)

    return jackknife(of, goal.size)


def heading_of(stream: Stream) -> Array | None:
    """Heading [rad] of a stream that has one, else None; a magnetometer is taken as level."""
    for column in ("heading_rad", "yaw_rad"):
        if column in stream.columns:
            return stream.column(column)
    if "field_x_T" in stream.columns:
        return np.arctan2(-stream.column("field_y_T"), stream.column("field_x_T"))
    return None


def unwrapped(time_s: Array, angle: Array) -> tuple[Array, Array]:
    """Times and continuous values of an angle, where it is known."""
    known = np.isfinite(angle)
    return time_s[known], np.unwrap(angle[known])


def middle(values: Array) -> float:
    """The median that is one of the values: of two at the antimeridian the mean is on the other side of the Earth."""
    return float(np.nanquantile(values, 0.5, method="nearest"))


EARTH_RADIUS_M = 6.371e6
#: Latitudes beyond are ice; more longitudes than latitudes lie beyond [rad].
POLAR = math.radians(75.0)
#: Delays up to this are looked for [s].
MOST_DELAY_S = 3.0
#: Displacements are compared over windows of this length [s].
WINDOW_S = 10.0
#: What a velocity that is not of the body leaves unexplained at most [1].
UNTURNED = 0.1
#: By how much the error of satellite fixes wanders within minutes [m].
FIX_WANDER_M = 3.0


class Places(NamedTuple):
    """Positions as complex displacements, north + i east [m], as they are and with latitude and longitude exchanged."""

    name: str
    time_s: Array
    plane: Complex
    exchanged: Complex
    polar: bool


def places_of(mission: Mission) -> Places | None:
    """Positions of the truth, or else of the first position sensor."""
    streams = {"truth": mission.truth, **mission.streams}
    for name, stream in streams.items():
        if stream is None or "latitude_rad" not in stream.columns:
            continue
        latitude, longitude = stream.column("latitude_rad"), stream.column("longitude_rad")
        known = np.isfinite(latitude) & np.isfinite(longitude)
        if np.count_nonzero(known) > 10:
            latitude, longitude = latitude[known], longitude[known]
            polar = abs(float(np.median(latitude))) > POLAR
            planes = _plane(latitude, longitude), _plane(longitude, latitude)
            return Places(name, stream.time_s[known], *planes, polar)
    return None


def _plane(latitude: Array, longitude: Array) -> Complex:
    east = (np.unwrap(longitude) - longitude[0]) * math.cos(latitude[0])
    plane: Complex = EARTH_RADIUS_M * ((latitude - latitude[0]) + 1j * east)
    return plane


@dataclass(frozen=True)
class Paths:
    """What is compared: velocity, heading and position, and the starts of windows in which all three are there."""

    time_s: Array
    body: Complex
    heading: tuple[Array, Array]
    places: Places
    edges: Array

    def moved(self, times: Array, path: Complex) -> Complex:
        """Displacement along a path within each window."""
        return displacement(self.edges, WINDOW_S, times, path)

    def way(self, body: Complex, late_s: float = 0.0, heading_sign: int = 1, rate: float = 0.0) -> Complex:
        """Displacement by dead reckoning within each window, of a velocity so late in the middle, so much too fast."""
        middle = 0.5 * float(self.edges[0] + self.edges[-1])
        at = self.time_s - late_s - rate * (self.time_s - middle)
        turned = body * np.exp(1j * heading_sign * np.interp(at, *self.heading))
        return self.moved(at, integral(at, turned))


@dataclass(frozen=True)
class CourseFit:
    """displacement = ratio * dead-reckoned displacement, with the signs and the delay that fit best.

    `sd` is the standard deviation of the ratio's size (relative) and direction [rad]; `side` and `side_sd` are the
    factor of the sideways velocity alone; `exchanged`: latitude and longitude the other way round fit much better (1),
    and better than any change of signs (2).
    """

    heading_sign: int
    side_sign: int
    ratio: complex
    sd: tuple[float, float]
    side: float
    side_sd: float
    late_s: float
    residual: float
    plain_residual: float
    speed_m_s: float
    shortest_s: float
    exchanged: int


def paths_of(time_s: Array, v: Array, heading: tuple[Array, Array], places: Places) -> Paths | None:
    """Velocity in the body (n, 3), heading and positions where there are enough of all; None where not."""
    known = np.isfinite(v[:, :2]).all(axis=1)
    time_s, v = time_s[known], v[known]
    if time_s.size < 10:
        return None
    begin = max(time_s[0], heading[0][0], places.time_s[0]) + MOST_DELAY_S
    end = min(time_s[-1], heading[0][-1], places.time_s[-1]) - MOST_DELAY_S
    if end - begin < 5.0 * WINDOW_S:
        return None
    edges = window_edges(begin, end - WINDOW_S, WINDOW_S / 4.0)
    edges = without_gaps(edges, places.time_s, time_s)
    if edges.size < 10:
        return None
    return Paths(time_s, v[:, 0] + 1j * v[:, 1], heading, places, edges)


def without_gaps(edges: Array, *clocks: Array, window_s: float = WINDOW_S, gap_s: float = WINDOW_S / 2.0) -> Array:
    """Starts of the windows across no gap so long: such a window has no displacement of its own."""
    for times in clocks:
        before = np.concatenate([[0], np.cumsum(np.diff(times) > gap_s)])
        first = np.searchsorted(times, edges, side="right") - 1
        last = np.searchsorted(times, edges + window_s)
        edges = edges[before[np.minimum(last, times.size - 1)] == before[np.maximum(first, 0)]]
    return edges


def displacement(edges: Array, window_s: float, times: Array, path: Complex) -> Complex:
    """Along a path, within each window."""
    ahead, here = (
        np.interp(at, times, path.real) + 1j * np.interp(at, times, path.imag) for at in (edges + window_s, edges)
    )
    return np.asarray(ahead - here)


def share(way: Complex, wanted: Complex) -> tuple[float, complex]:
    """What of the displacements stays unexplained (a share of their power), and the ratio that explains the rest."""
    ratio = complex(np.vdot(way, wanted) / max(float(np.vdot(way, way).real), 1e-12))
    return float(np.sum(np.abs(wanted - ratio * way) ** 2) / np.sum(np.abs(wanted) ** 2)), ratio


def course_fit(paths: Paths) -> CourseFit | None:
    """How the velocity must be changed to follow the positions; None where the vehicle hardly moves."""
    wanted = paths.moved(paths.places.time_s, paths.places.plane)
    power = float(np.sum(np.abs(wanted) ** 2))
    if power < paths.edges.size * 1.0:
        return None

    def body(side_sign: int) -> Complex:
        return paths.body if side_sign > 0 else paths.body.conjugate()

    def fit(heading_sign: int, side_sign: int, late_s: float = 0.0) -> float:
        return share(paths.way(body(side_sign), late_s, heading_sign), wanted)[0]

    plain = fit(1, 1)
    signs: tuple[int, int] = min(((h, s) for h in (1, -1) for s in (1, -1)), key=lambda hs: fit(*hs))
    other = share(paths.way(paths.body), paths.moved(paths.places.time_s, paths.places.exchanged))[0]
    exchanged = 0 if other > 0.3 * plain else 1 if other > 0.5 * fit(*signs) else 2
    if paths.places.polar and other < plain:
        exchanged = 2
    # Slow sideways drift fits either sign: another one than expected must explain far more to be believed.
    if fit(*signs) > 0.3 * plain:
        signs = (1, 1)
    late = float(min(np.linspace(-MOST_DELAY_S, MOST_DELAY_S, 61), key=lambda shift: fit(*signs, float(shift))))
    way = paths.way(body(signs[1]), late, signs[0])
    # Outliers among the fixes: five times the median is beyond any noise.
    left = np.abs(wanted - share(way, wanted)[1] * way)
    kept = left <= 5.0 * float(np.median(left))
    residual, ratio = share(way[kept], wanted[kept])
    if not ratio:
        return None  # the velocity, or all positions but outliers, stand still
    _, spread = jackknife(lambda rows: _relative(way[kept][rows], wanted[kept][rows], ratio), int(kept.sum()))
    wander = _wander(paths)
    sd = (math.hypot(spread[0], wander), math.hypot(spread[1], wander))
    side, side_sd = _sideways(paths, wanted, kept, ratio, late)
    # Held and interpolated readings are half a step off by themselves.
    shortest = max(0.25, 0.5 * max(float(np.median(np.diff(t))) for t in (paths.time_s, paths.places.time_s)))
    speed = math.sqrt(power / paths.edges.size) / WINDOW_S
    plain = share(paths.way(body(signs[1]), 0.0, signs[0])[kept], wanted[kept])[0]
    return CourseFit(*signs, ratio, sd, side, side_sd, late, residual, plain, speed, shortest, exchanged)


def axes_of_the_earth(paths: Paths) -> str:
    """Which of the Earth's axes those of a velocity are, that follows the positions without being turned; or none."""
    wanted, found = paths.moved(paths.places.time_s, paths.places.plane), []
    for name, velocity in (("north, east", paths.body), ("east, north", 1j * paths.body.conjugate())):
        way = integral(paths.time_s, velocity)
        left, ratio = share(paths.moved(paths.time_s, way), wanted)
        found.append((left, name if ratio.real > abs(ratio.imag) else ""))
    left, name = min(found)
    return name if left < UNTURNED else ""


def _relative(way: Complex, wanted: Complex, ratio: complex) -> Array:
    own = share(way, wanted)[1] / ratio
    return np.array([own.real, own.imag])


def _sideways(paths: Paths, wanted: Complex, kept: Mask, ratio: complex, late_s: float) -> tuple[float, float]:
    """Factor of the sideways velocity that fits the positions best beside the forward one, with its sd.

    In turns a delay and a lever arm move the positions sideways as well, a mounting always: they are fitted beside it.
    """
    turned = wanted[kept] * (abs(ratio) / ratio)
    axes = (paths.body.real.astype(complex), paths.body.imag.astype(complex))
    parts = [paths.way(part, late_s)[kept] for part in (axes[0], 1j * axes[1])]
    at = paths.time_s - late_s
    arm = paths.moved(at, np.exp(1j * np.interp(at, *paths.heading)))[kept]
    delayed = (paths.way(paths.body, late_s + 0.5) - paths.way(paths.body, late_s - 0.5))[kept]
    parts += [1j * parts[0], arm, 1j * arm, delayed]
    # north and east of a window stand side by side, so that a tenth is a stretch of the mission
    columns = np.column_stack([part.view(float) for part in parts])
    best, sd = factors(columns, turned.view(float))
    return float(best[1]), float(sd[1])


def _wander(paths: Paths) -> float:
    """By what share of the way the slow error of fixes moves, as no windows show by their scatter; 0 of a truth."""
    if paths.places.name == "truth":
        return 0.0
    legs = np.split(paths.edges, np.flatnonzero(np.diff(paths.edges) > WINDOW_S) + 1)
    times, plane = paths.places.time_s, paths.places.plane
    ends = [np.searchsorted(times, (leg[0], leg[-1] + WINDOW_S)) for leg in legs]
    extents = [np.abs(plane[a:b] - plane[a]).max() for a, b in ends if b > a]
    return math.sqrt(2.0) * FIX_WANDER_M / max(float(np.linalg.norm(extents)), 1e-9)

"""Compare a body velocity with the position: which way it must be turned, scaled and shifted to follow the course.

Where a magnetic heading is hardly one: near a magnetic pole, whose field is vertical.

Clocks that are far off, so that a stream follows none of the others: one keeps GPS time and another one UTC, or was
set by hand.
"""

import datetime
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from navfilter.check.course_fit import (
    MOST_DELAY_S,
    WINDOW_S,
    CourseFit,
    Paths,
    Series,
    axes_of_the_earth,
    correlation,
    course_fit,
    displacement,
    factors,
    heading_of,
    increments,
    integral,
    paths_of,
    places_of,
    share,
    unwrapped,
    vector,
    window_edges,
    without_gaps,
)
from navfilter.check.finding import Finding, Severity
from navfilter.foundation.arrays import Array, Complex, Mask
from navfilter.models.error_models import stated_variance
from navfilter.models.magnetic import BLACKOUT_NT, CAUTION_NT, North, believable, declination, north
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors.observable import Observable
from navfilter.models.state import matrix_from_euler, wrap
from navfilter.models.vehicle import Vehicle

#: Delays are looked for up to this, or a quarter of the time that both are there [s], in steps of so much [s].
MOST_OFFSET_S, OFFSET_STEP_S = 120.0, 0.5
#: Less is found where sensors are compared closely [s].
LEAST_S = 2.5
#: What a delay leaves unexplained at most [1], and of what is left without one [1].
LEFT, OF_THAT = 0.19, 0.3
#: What follows, or goes the other way, with less than this unexplained, at a delay up to that, needs no other [1], [s].
CLOSE, CLOSELY_S = 0.1, 1.0
#: So many windows are compared at least.
OFFSET_WINDOWS = 20
#: Rates of clocks up to this are looked for [1]: 400 rows over 400 s are off by a four hundredth.
RATE = 0.01
#: A drift of less over a mission is none [s].
DRIFT_S = 0.3
#: Steps are those of a rate in whole numbers, or a whole number of seconds, within this share.
ROUND = 2e-4
#: A rate told by noisy comparisons is believed beyond so many standard deviations, and where it leaves so much less.
SURER, EXPLAINS = 5.0, 0.97
#: By how much clocks differ that people mix up [s].
KNOWN = {18.0: "GPS time is 18 s ahead of UTC", 37.0: "TAI is 37 s ahead of UTC", 19.0: "TAI is 19 s ahead of GPS time"}


def late_by(reference: Series, other: Series, window_s: float) -> float | None:
    """By how much a series is late against another one that it follows, by their increments over windows; None where it
    follows closely as it is, or with no delay.

    Parameters
    ----------
    reference, other : (ndarray, ndarray)
        Times [s] and values of what should be the same but for a constant factor.
    window_s : float
    """
    begin, end = (pick(reference[0][i], other[0][i]) for pick, i in ((max, 0), (min, -1)))

    def unexplained(late_s: float) -> float:
        """One that goes the other way is no clock's."""
        edges = window_edges(begin + max(-late_s, 0.0), end - window_s - max(late_s, 0.0), window_s / 4.0)
        if edges.size < OFFSET_WINDOWS:
            return 1.0
        agreement, _ = correlation(increments(edges, window_s, reference), increments(edges, window_s, other, late_s))
        return 1.0 - (agreement if abs(late_s) <= LEAST_S else max(agreement, 0.0)) ** 2

    return _best(unexplained, min(MOST_OFFSET_S, 0.25 * (end - begin)))


def late_path_by(paths: Paths, left: float) -> float | None:
    """By how much a velocity and its heading are late against the positions; None as for `late_by`.

    Parameters
    ----------
    paths : Paths
    left : float
        What is unexplained of the positions' way without a large delay, whatever the signs [1].
    """
    first = max(paths.time_s[0], paths.heading[0][0])
    last = min(paths.time_s[-1], paths.heading[0][-1]) - WINDOW_S
    wanted = paths.moved(paths.places.time_s, paths.places.plane)

    def unexplained(late_s: float) -> float:
        there = (paths.edges + late_s >= first) & (paths.edges + late_s <= last)
        if np.count_nonzero(there) < max(OFFSET_WINDOWS, 0.5 * there.size) or not wanted[there].any():
            return 1.0
        if abs(late_s) <= LEAST_S:
            return left
        return share(paths.way(paths.body, late_s)[there], wanted[there])[0]

    return _best(unexplained, min(MOST_OFFSET_S, 0.25 * float(paths.edges[-1] - paths.edges[0])))


class ClockFit(NamedTuple):
    """How the stamps of a series lie against those of another one that shows the same.

    Attributes
    ----------
    late_s, late_sd : float
        By how much it is late in the middle, and the sd of that [s].
    rate, rate_sd : float
        By what share its seconds are too many: 0.0025 where 400 s were stretched over 401 s.
    left, left_without : float
        What is unexplained of the increments, so and with a delay alone [1].
    """

    late_s: float
    late_sd: float
    rate: float
    rate_sd: float
    left: float
    left_without: float


def fitted_clock(reference: Series, other: Series, window_s: float) -> ClockFit | None:
    """Delay and rate of a series' clock against that of another; None where they have too little in common.

    Parameters
    ----------
    reference, other : (ndarray, ndarray)
        Times [s] and values of what should be the same but for a constant factor.
    window_s : float
        Increments are compared over windows of this length.
    """
    begin, end = (pick(reference[0][i], other[0][i]) for pick, i in ((max, 0), (min, -1)))
    edges = window_edges(begin + LEAST_S, end - LEAST_S - window_s, window_s / 4.0)
    edges = without_gaps(edges, reference[0], other[0], window_s=window_s, gap_s=max(window_s, LEAST_S))
    if edges.size < 10 * OFFSET_WINDOWS:
        return None
    middle = 0.5 * float(edges[0] + edges[-1])

    def changes(series: Series, late_s: float, rate: float) -> Array:
        ahead, here = (np.interp(at + late_s + rate * (at - middle), *series) for at in (edges + window_s, edges))
        return np.asarray(ahead - here)

    wanted = changes(reference, 0.0, 0.0)

    def alike(late_s: float, rate: float) -> float:
        return correlation(wanted, changes(other, late_s, rate))[0]

    # a clock that runs at another rate blurs any one delay: first the best of a few rates
    grid = [(s, r) for s in np.linspace(-LEAST_S, LEAST_S, 41) for r in np.linspace(-RATE, RATE, 9)]
    late_s, rate = max(grid, key=lambda one: alike(*one))
    by_s = 0.5 * float(np.median(np.diff(other[0])))
    sd = np.array([math.inf, math.inf])
    for _ in range(4):
        here = changes(other, late_s, rate)
        if correlation(wanted, here)[0] < 1.0 - LEFT:
            return None
        change = (changes(other, late_s + by_s, rate) - changes(other, late_s - by_s, rate)) / (2.0 * by_s)
        columns = np.column_stack([np.ones(wanted.size), here, change, change * (edges - middle)])
        best, spread = factors(columns, wanted)
        if abs(best[1]) < 1e-9:
            return None
        late_s, rate = late_s + float(best[2] / best[1]), rate + float(best[3] / best[1])
        sd = np.abs(spread[2:] / best[1])
        if abs(late_s) > LEAST_S or abs(rate) > 2.0 * RATE:
            return None
    delays = late_s + np.linspace(-0.5, 0.5, 21) * abs(rate) * (edges[-1] - edges[0])
    without = 1.0 - max(alike(float(s), 0.0) for s in delays) ** 2
    return ClockFit(float(late_s), float(sd[0]), float(rate), float(sd[1]), 1.0 - alike(late_s, rate) ** 2, without)


def stretched_finding(name: str, what: str, fit: ClockFit, step_s: float, span_s: float) -> Finding:
    """That a stream's stamps, so far apart and over so long [s], are stretched, and how to scale them."""
    own, scale = step_s / (1.0 + fit.rate), 1.0 / (1.0 + fit.rate)
    ends = (fit.late_s + side * fit.rate * span_s for side in (-0.5, 0.5))
    text = what.format("late by {:+.2f} s at the beginning and by {:+.2f} s at the end,".format(*ends))
    cure = "Its stamps are stretched, or rows are missing: set time.scale = "
    within = max(ROUND, min(SURER * fit.rate_sd, 0.3 * abs(fit.rate)))
    if _is_round(own, within) and not _is_round(step_s):
        own = round(own) if own >= 1.0 - within else 1.0 / round(1.0 / own)
        cure += f"{own / step_s:.5f} (rows are then {own:.4g} s apart, and were printed as {step_s:.6g})"
    else:
        cure += f"{scale:.5f} (or {1.0 / scale:.5f} for the other, where several streams say this of it)"
    return Finding("error", "clock", name, f"{text}.", f"{cure} in time of [streams.{name}].")


def noisy_stretch_finding(name: str, what: str, fit: ClockFit | None, time_s: Array) -> Iterator[Finding]:
    """The same of stamps [s] that are compared by what errs much, where it is sure."""
    span_s = float(time_s[-1] - time_s[0])
    if fit is None or abs(fit.rate) < max(SURER * fit.rate_sd, 2.0 * DRIFT_S / span_s):
        return
    if fit.left < EXPLAINS * fit.left_without:
        yield stretched_finding(name, what, fit, float(np.median(np.diff(time_s))), span_s)


def _is_round(step_s: float, within: float = ROUND) -> bool:
    """Whether a step is one that people set: so many in a second, or so many seconds."""
    times = 1.0 / step_s if step_s < 1.0 else step_s
    return abs(times / max(round(times), 1) - 1.0) < within


def _best(unexplained: Callable[[float], float], most_s: float) -> float | None:
    """The delay that explains most, if it is a large one and does so by far better than a small one."""
    if most_s <= LEAST_S:
        return None
    late_s = np.arange(-most_s, most_s + 0.5 * OFFSET_STEP_S, OFFSET_STEP_S)
    left: Array = np.array([unexplained(float(s)) for s in late_s])
    near = np.abs(late_s) <= LEAST_S
    best = int(np.argmin(left))
    if near[best] or np.min(left[np.abs(late_s) <= CLOSELY_S]) < CLOSE:
        return None
    finer = {float(s): unexplained(float(s)) for s in late_s[best] + np.linspace(-OFFSET_STEP_S, OFFSET_STEP_S, 21)}
    found = min(finer, key=lambda s: finer[s])
    return found if finer[found] <= min(LEFT, OF_THAT * float(np.min(left[near]))) else None


def far_finding(name: str, what: str, late_s: float) -> Iterator[Finding]:
    """That a stream is so late against another, and what that may be.

    Parameters
    ----------
    name : str
        Of the stream.
    what : str
        What is late, and against what: two parts of a sentence around ``{}``.
    late_s : float
        Negative: early [s].
    """
    text = what.format(f"{abs(late_s):.1f} s {'late' if late_s > 0.0 else 'early'}")
    known = next((words for s, words in KNOWN.items() if abs(abs(late_s) - s) < OFFSET_STEP_S), "")
    cure = f"One of the two has another clock{f': {known}' if known else ''}. Set time.offset_s = {-late_s:.1f} in"
    cure = f"{cure} [streams.{name}] on top of what it is now, or the opposite there."
    yield Finding("error", "clock", name, text, cure)


#: A kilometre on the Earth [deg].
KM_DEG = 0.009


def north_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """That a compass hardly points where the mission is: below the horizontal fields from which on the World Magnetic
    Model itself warns of compasses, and declares them useless.

    Parameters
    ----------
    mission : Mission
        Its first place counts, that of its start, of its fixes or of its truth.
    vehicle : Vehicle, optional
        Says which headings are magnetic; without one those of a field are.
    """
    compasses, place = _compasses(mission, vehicle), place_of(mission)
    dated = mission.date is not None or getattr(mission.start, "date", None) is not None
    for name, sensor in compasses.items():
        if sensor is not None and sensor.declination_rad is None and not (dated and place is not None):
            lacks = " and ".join(["a date"] * (not dated) + ["a place"] * (place is None))
            text = f"its heading counts from magnetic north, and the declination there needs {lacks}."
            cure = "Set date in the mission.toml" if not dated else "Give a [start]"
            yield Finding("error", "north", name, text, f"{cure}, or declination_deg in the vehicle.toml.")
    if not compasses or place is None:
        return
    latitude, longitude = place
    date = believable(mission.date or datetime.date(1970, 1, 1))
    there = north(latitude, longitude, 0.0, date)
    if there.horizontal_nt >= CAUTION_NT:
        return
    up, right = -math.copysign(KM_DEG, latitude), KM_DEG / max(math.cos(math.radians(latitude)), KM_DEG)
    beside = north(latitude + up, longitude, 0.0, date), north(latitude, longitude + right, 0.0, date)
    by_km = math.hypot(*(float(wrap(other.declination - there.declination)) for other in beside))
    for name, sensor in compasses.items():
        yield _finding(name, sensor, there, by_km)


def place_of(mission: Mission) -> tuple[float, float] | None:
    """Latitude and longitude where the mission begins, or of a fix in its middle [deg]."""
    if mission.start is not None:
        return mission.start.latitude_deg, mission.start.longitude_deg
    for stream in (*mission.streams.values(), mission.truth):
        if stream is not None and "latitude_rad" in stream.columns:
            place = np.degrees([stream.column("latitude_rad"), stream.column("longitude_rad")])
            known = place[:, np.isfinite(place).all(axis=0) & place.any(axis=0) & (np.abs(place[0]) <= 90.0)]
            if known.size:
                latitude, longitude = known[:, known.shape[1] // 2].tolist()
                return latitude, longitude
    return None


def _compasses(mission: Mission, vehicle: Vehicle | None) -> dict[str, Any]:
    """What counts from magnetic north, by name; without a vehicle the fields."""
    if vehicle is None:
        return {name: None for name, stream in mission.streams.items() if "field_x_T" in stream.columns}
    found: dict[str, Any] = {**vehicle.sensors} | ({"attitude": vehicle.drive.compass} if vehicle.drive.compass else {})
    return {
        name: sensor
        for name, sensor in found.items()
        if getattr(sensor, "magnetic", False) or getattr(sensor, "magnetometer", False)
    }


def _finding(name: str, sensor: Any, there: North, by_km: float) -> Finding:
    """What it is about; a warning where a compass is of no use, or where the covariance cannot know it."""
    lost, sd_deg = there.horizontal_nt < BLACKOUT_NT, math.degrees(there.sd)
    text = (
        f"the horizontal magnetic field is {there.horizontal_nt:.0f} nT here (dip {math.degrees(there.dip):.1f} deg): "
        f"{'no compass is to be believed' if lost else 'compasses hardly point'}. The declination of a model errs by "
        f"{sd_deg:.2g} deg (sd), and it changes by {math.degrees(by_km):.2g} deg in a kilometre"
    )
    if sensor is None or getattr(sensor, "magnetometer", False):
        text += f", and a tilt of 0.1 deg turns the heading by {0.1 * abs(math.tan(there.dip)):.1f} deg"
    if sensor is not None and sensor.declination_rad is not None and not sensor.declination_sd_rad:
        cure = f"vehicle.toml has a declination as if it were exact: set declination_sd_deg = {sd_deg:.2g} beside it."
        return Finding("warning", "north", name, f"{text}.", cure)
    grave: Severity = "warning" if lost else "info"
    cure = "Take the heading from a gyrocompass or two antennas, or leave it to fixes and velocity." if lost else ""
    return Finding(grave, "north", name, f"{text}.", cure)


#: Standard deviations from which on a difference is no chance: of ten blocks three in a thousand (Student's t).
SURE = 4.0
#: What turns a velocity by more is no current, and spoils any replay [deg].
GRAVE_DEG = 20.0
#: Beyond so many a direction is wrong, where it is beyond what vehicle.toml says as well.
WRONG = 5.0
#: Angles apart by less are the same for these data [deg].
LITTLE_DEG = 3.0
#: A velocity that leaves more of the positions' way unexplained does not follow them [1].
LOOSE = 0.25
#: Displacements are compared over windows of these lengths [s], the first of which says where to begin; over so many
#: at most.
WINDOWS_S, MOST_WINDOWS = (10.0, 5.0, 20.0), 2000
#: Fewer windows say nothing [1].
LEAST_WINDOWS = 40
#: Delays up to this are looked for [s], in steps of so much [s], at both ends of a mission, so long each [s].
MOST_S, STEP_S, END_S = 60.0, 0.5, 600.0
#: A rate counts where windows of two lengths say so by so many sds, and none says the opposite [1].
SURE_TWICE = 3.0
#: Differences for slopes, of a delay [s] and of a rate [1].
BY_S, BY_RATE = 0.3, 3e-4
#: What errs by more times the median is an outlier [1].
OUTLIER = 5.0


def course_findings(
    name: str,
    stream: Stream,
    mission: Mission,
    vehicle: Vehicle | None,
    gyro_agrees: bool = False,
    clock: tuple[bool, bool] = (False, False),
) -> Iterator[Finding]:
    """Findings about a velocity stream whose axes, sign, scale or clock do not fit the positions; `clock`: it is known
    to be stretched, it is known not to be.
    """
    mounting, lever = mounting_of(name, vehicle)
    v = vector(stream, "v_x_m_s") @ mounting.T
    speed = np.hypot(v[:, 0], v[:, 1])
    if not np.isfinite(speed).any() or np.nanmax(speed) == 0.0:
        return
    fast = float(np.nanquantile(speed, 0.99))
    if fast > 50.0:
        text = f"speeds up to {fast:.3g} m/s."
        cure = "Centimetres or millimetres per second, or a sentinel: set unit or invalid_above."
        yield Finding("error", "unit", name, text, cure)
        return
    places = places_of(mission)
    headings = [(n, s) for n, s in mission.streams.items() if heading_of(s) is not None and n != name]
    compared = False
    if places is not None and headings:
        # A compass that is measured as an angle is better than a magnetometer that is not levelled.
        other, best = min(headings, key=lambda item: "field_x_T" in item[1].columns)
        angle = heading_of(best)
        assert angle is not None  # chosen for having one
        compass: Any = None if vehicle is None else vehicle.sensors.get(other, vehicle.drive.compass)
        magnetic, field = bool(getattr(compass, "magnetic", False)), "field_x_T" in best.columns
        north = _declination(mission)
        if magnetic and not field:
            given = getattr(compass, "declination_rad", None)
            angle = angle + (math.radians(north or 0.0) if given is None else given)
        heading = unwrapped(best.time_s, angle)
        # The instrument's own path differs from the vehicle's while it turns.
        arm = lever * np.exp(1j * np.interp(places.time_s, *heading))
        places = places._replace(plane=places.plane + arm, exchanged=places.exchanged + arm)
        paths = paths_of(stream.time_s, v, heading, places)
        fit = None if paths is None else course_fit(paths)
        if paths is not None and fit is not None and abs(fit.late_s) > MOST_DELAY_S - 0.01:
            late_s = late_path_by(paths, fit.residual)
            if late_s is not None:
                yield from far_finding(name, f"the velocity is {{}} against the positions of {places.name}.", late_s)
                return
        earth = axes_of_the_earth(paths) if paths is not None and fit is not None and fit.residual > LOOSE else ""
        if earth:
            text = (
                f"its axes are {earth}: it follows the positions of {places.name} without being turned by the heading."
            )
            cure = "The filter needs the velocity in the axes of the instrument or the vehicle: have it recorded so"
            yield Finding("error", "axes", name, text, f"{cure} (of a DVL: instrument or ship coordinates, not earth).")
            return
        if paths is not None and fit is not None:
            compared = True
            if not clock[0] and not through_water(vehicle, name):
                yield from _stretch_findings(name, other, paths, clock[1])
            stated = _stated_deg(vehicle, name, other, fit.speed_m_s)
            known_north = None if magnetic or field else north
            water = through_water(vehicle, name)
            streams = _Streams(name, other, places.name, field, gyro_agrees, known_north, stated, water)
            yield from _course_findings(streams, fit)
    if not compared:
        yield from _main_direction(name, v, speed)


def _stretch_findings(name: str, heading: str, paths: Paths, sure: bool) -> Iterator[Finding]:
    """Stamps of the velocity that are stretched against both others, or those of the positions."""
    found = path_clock(paths, sure)
    if found is None:
        return
    if not found.whole:
        what = f"the velocity is {{}} against the positions of {paths.places.name}"
        yield from noisy_stretch_finding(name, what, found.fit, paths.time_s)
    elif paths.places.name != "truth":
        fit = found.fit._replace(late_s=-found.fit.late_s, rate=1.0 / (1.0 + found.fit.rate) - 1.0)
        what = f"its positions are {{}} against the way by {name} and {heading}"
        yield from noisy_stretch_finding(paths.places.name, what, fit, paths.places.time_s)


def _declination(mission: Mission) -> float | None:
    """Where magnetic north is [deg]; None without a date or a place."""
    place = place_of(mission)
    if mission.date is None or place is None:
        return None
    return math.degrees(declination(*place, 0.0, believable(mission.date)))


def part_of(vehicle: Vehicle, stream: str) -> Any:
    """The sensor, or the part of what drives, behind a stream."""
    drive = {"velocity": vehicle.drive.velocity_sensor, "attitude": vehicle.drive.compass}
    return vehicle.sensors.get(stream) or drive.get(stream)


def through_water(vehicle: Vehicle | None, stream: str) -> bool:
    """Whether a stream is a velocity through the water, with a current between it and the ground."""
    return vehicle is not None and getattr(part_of(vehicle, stream), "observes", None) is Observable.VELOCITY_WATER


def stated_direction(part: Any, speed_m_s: float) -> float:
    """How well a heading or a horizontal velocity is believed to know a direction at a speed (sd) [rad]."""
    if part is None:
        return math.inf
    models = part.models[-1:] if part.units[-1] == "rad" else part.models[:2]
    sd = math.sqrt(max(map(stated_variance, models)))
    return sd if part.units[-1] == "rad" else sd / max(speed_m_s, 1e-9)


def _stated_deg(vehicle: Vehicle | None, velocity: str, heading: str, speed_m_s: float) -> float:
    """What a vehicle says of both together [deg]; nothing without one."""
    if vehicle is None:
        return math.inf
    return math.degrees(math.hypot(*(stated_direction(part_of(vehicle, n), speed_m_s) for n in (velocity, heading))))


def mounting_of(name: str, vehicle: Vehicle | None) -> tuple[Array, complex]:
    """Mounting matrix and horizontal lever arm of the sensor behind a stream; none without a vehicle."""
    sensor: Any = None
    if vehicle is not None:
        sensor = vehicle.sensors.get(name) or getattr(vehicle.drive, name, None)
    arm = getattr(sensor, "lever_arm_b_m", (0.0, 0.0, 0.0))
    return matrix_from_euler(*getattr(sensor, "mounting_rad", (0.0, 0.0, 0.0))), complex(arm[0], arm[1])


class _Streams(NamedTuple):
    """Whose findings they are; the heading of a magnetometer that is not levelled is rough."""

    velocity: str
    heading: str
    position: str
    rough: bool
    gyro_agrees: bool
    declination_deg: float | None
    stated_deg: float
    water: bool


def _course_findings(streams: _Streams, fit: CourseFit) -> Iterator[Finding]:
    name, heading = streams.velocity, streams.heading
    mirrored = fit.heading_sign < 0
    if fit.exchanged == 2 or (fit.exchanged and streams.gyro_agrees):
        where = "[truth]" if streams.position == "truth" else f"[streams.{streams.position}]"
        text = "the course over ground fits the velocity only with latitude and longitude exchanged."
        cure = f"Exchange the first two columns of position in {where}."
        yield Finding("error", "exchanged", streams.position, text, cure)
        return
    if fit.residual > LOOSE:
        text = f"velocity turned by {heading} does not follow the position (unexplained {100 * fit.residual:.0f} %)."
        yield Finding("warning", "course", name, text, "Check the axes of the velocity, the heading and the clocks.")
        return
    scale, angle = abs(fit.ratio), math.degrees(math.atan2(fit.ratio.imag, fit.ratio.real))
    sure = SURE * fit.sd[0], math.degrees(SURE * fit.sd[1])
    text = f"velocity turned by {heading} follows the position: scale {scale:.3f}, turned by {angle:+.1f} deg"
    yield Finding("info", "course", name, f"{text}, unexplained {100 * math.sqrt(fit.residual):.1f} %.")
    if mirrored:
        cure = 'A heading counted from east counter-clockwise needs scale = -1 and offset = "90 deg"'
        cure += "; or latitude and longitude are exchanged." if fit.exchanged else "."
        yield Finding("error", "sign", heading, "the heading turns the wrong way against the course over ground.", cure)
    if fit.side_sign < 0 or (not mirrored and fit.side < -0.3 and fit.side + SURE * fit.side_sd < 0.0):
        yield mirrored_finding(name, "it fits the positions with its y axis reversed")
    if not mirrored and abs(angle) > max(GRAVE_DEG if streams.water else 15.0 if streams.rough else 4.0, sure[1]):
        text = f"the velocity must be turned by {angle:+.1f} deg to follow the course over ground."
        cure = f"Either the instrument is mounted so (mounting_deg yaw {angle:+.0f}) or the heading is off by that much"
        cure += " (a magnetic one by the declination: magnetic = true in vehicle.toml)."
        north = streams.declination_deg
        if north is not None and abs(north) > LITTLE_DEG and abs(angle - north) < max(LITTLE_DEG, sure[1]):
            text = f"{text[:-1]}: the declination is {north:+.1f} deg there."
            cure = f"Is {heading} a magnetic compass? Then magnetic = true in vehicle.toml. {cure}"
        wrong = min(GRAVE_DEG, max(WRONG / SURE * sure[1], streams.stated_deg))
        yield Finding("error" if abs(angle) > wrong else "warning", "mounting", name, text, cure)
    if abs(scale - 1.0) > max(0.25 if streams.water else 0.07, sure[0] * scale):
        yield _scale_finding(name, scale)
    # A delay is believed when it explains clearly more than none does, and more than the longest one tried.
    if fit.shortest_s < abs(fit.late_s) < MOST_DELAY_S - 0.01 and fit.residual < 0.6 * fit.plain_residual:
        yield _delay_finding(name, fit)


def mirrored_finding(name: str, why: str) -> Finding:
    """That a velocity has its y axis to the left, and what to change."""
    cure = f'x is forward, y right, z down: set axes = "x,-y,z" in velocity of [streams.{name}]'
    cure += ', or "x,-y,-z" where z is up too.'
    return Finding("error", "axes", name, f"the velocity is mirrored: {why}.", cure)


def _scale_finding(name: str, scale: float) -> Finding:
    text = f"the position moves {scale:.3g} times as far as the velocity says."
    known = {0.5144: "kn", 0.3048: "ft/s", 0.01: "cm/s", 0.001: "mm/s", 1 / 3.6: "km/h"}
    guess = [f'Perhaps unit = "{u}".' for value, u in known.items() if abs(scale / value - 1.0) < 0.05]
    grave = not 0.8 < scale < 1.25
    cure = guess[0] if guess else "Check unit and scale."
    return Finding("error" if grave else "warning", "scale", name, text, cure)


def _delay_finding(name: str, fit: CourseFit) -> Finding:
    word = "late" if fit.late_s > 0 else "early"
    text = f"the velocity is about {abs(fit.late_s):.1f} s {word} against the position."
    cure = f"Set time.offset_s = {-fit.late_s:+.1f} on top of what it is now; "
    cure += f"or it is a lever arm of {-fit.speed_m_s * fit.late_s:+.1f} m along x, which looks much the same. "
    sd = max(0.3, math.ceil(10.0 * abs(fit.late_s)) / 10.0)
    cure += f"Or let the filter find it: time_offset_sd_s = {sd:g} in vehicle.toml."
    return Finding("warning", "delay", name, text, cure)


def _main_direction(name: str, v: Array, speed: Array) -> Iterator[Finding]:
    """Without positions: a vehicle mostly moves along its own length."""
    known = np.isfinite(speed)
    doubled = (v[known, 0] + 1j * v[known, 1]) ** 2
    total = float(np.sum(np.abs(doubled)))
    axis = complex(np.sum(doubled)) / total if total > 0.0 else 0j
    angle = 0.5 * math.degrees(math.atan2(axis.imag, axis.real))
    if abs(axis) > 0.6 and abs(angle) > 20.0:
        side = "right" if angle > 0 else "left"
        text = f"the vehicle mostly moves {abs(angle):.0f} deg {side} of the instrument's x axis."
        cure = (
            f"If it moves along its own length, the instrument is mounted turned: mounting_deg yaw {-angle:+.0f} or so."
        )
        yield Finding("warning", "habit", name, text, cure)


# --- stretched stamps, told by the way -------------------------------------------------------------------------------


class PathClock(NamedTuple):
    """How a velocity's stamps lie against positions.

    Attributes
    ----------
    fit : ClockFit
        Of the velocity against the positions.
    whole : bool
        The heading lies as the velocity does: the positions have another clock than both. Else the velocity has
        another clock than both others.
    """

    fit: ClockFit
    whole: bool


def path_clock(paths: Paths, sure: bool = False) -> PathClock | None:
    """How a velocity's stamps lie against those of positions, which it leads to by the heading.

    Parameters
    ----------
    paths : Paths
    sure : bool
        The velocity's own clock is right.

    Returns
    -------
    PathClock or None
        None where the rate is none, or windows of several lengths do not say the same, of the same clock.

    Notes
    -----
    Displacement = scale and turn of that by dead reckoning, and of what a lever arm swings, which in turns looks like a
    delay (Gauss-Newton, in delay and rate, without outliers).
    """
    begin: dict[bool, tuple[float, float] | None] = {True: None, False: None}
    found: list[PathClock] = []
    for length_s in WINDOWS_S:
        both = []
        for whole in (True,) if sure else (True, False):
            begin[whole], fit = _fit(_Windows.of(paths, length_s), paths, whole, begin[whole])
            both += [PathClock(fit, whole)] if fit is not None else []
        found += [min(both, key=lambda one: one.fit.left)] if both else []
    if len(found) < 2 or len({one.whole for one in found}) > 1:
        return None
    best = min(found, key=lambda one: one.fit.rate_sd)
    apart = [abs(fit.rate - best.fit.rate) / math.hypot(fit.rate_sd, best.fit.rate_sd) for fit, _ in found]
    alike = all(fit.rate * best.fit.rate > 0.0 for fit, _ in found)
    many = sum(abs(fit.rate) > SURE_TWICE * fit.rate_sd for fit, _ in found) > 1
    return best if alike and many and max(apart) < SURER else None


class _Windows(NamedTuple):
    """Starts of the windows, their length, and the displacement of the positions in each."""

    edges: Array
    length_s: float
    wanted: Complex

    @classmethod
    def of(cls, paths: Paths, length_s: float) -> "_Windows":
        """Across no gap."""
        times = paths.places.time_s
        begin = max(paths.time_s[0], paths.heading[0][0], times[0]) + LEAST_S
        end = min(paths.time_s[-1], paths.heading[0][-1], times[-1]) - LEAST_S
        edges = window_edges(begin, end - length_s, max(length_s / 3.0, (end - begin) / MOST_WINDOWS))
        gap_s = max(0.5 * length_s, 3.0 * float(np.median(np.diff(times))))
        edges = without_gaps(edges, times, paths.time_s, window_s=length_s, gap_s=gap_s)
        return cls(edges, length_s, displacement(edges, length_s, times, paths.places.plane))

    def part(self, begin_s: float, end_s: float) -> "_Windows":
        """Those of a time."""
        inside = (self.edges >= begin_s) & (self.edges + self.length_s <= end_s)
        return _Windows(self.edges[inside], self.length_s, self.wanted[inside])


def _fit(
    windows: _Windows, paths: Paths, whole: bool, known: tuple[float, float] | None
) -> tuple[tuple[float, float] | None, ClockFit | None]:
    """Where it begins, unless that is known, and the fit with windows of one length."""
    if windows.edges.size < LEAST_WINDOWS:
        return known, None
    begin, end = float(windows.edges[0]), float(windows.edges[-1] + windows.length_s)
    middle, span_s = 0.5 * (begin + end), end - begin

    def ways(of: _Windows, late_s: float, rate: float) -> tuple[Complex, Complex]:
        """Displacements by dead reckoning and of a metre of lever arm."""
        near = slice(*np.searchsorted(paths.time_s, (of.edges[0] - 2.0 * MOST_S, of.edges[-1] + 2.0 * MOST_S)))
        stamps = paths.time_s[near]
        at = stamps - late_s - rate * (stamps - middle)
        turn = np.exp(1j * np.interp(stamps if whole else at, *paths.heading))
        path = integral(stamps if whole else at, paths.body[near] * turn)
        return displacement(of.edges, of.length_s, at, path), displacement(of.edges, of.length_s, at, turn)

    def left(of: _Windows, late_s: float, rate: float) -> tuple[complex, Complex]:
        """Scale and turn, and what is left of the displacements."""
        columns = np.column_stack(ways(of, late_s, rate))
        best = np.linalg.lstsq(columns, of.wanted, rcond=None)[0]
        return complex(best[0]), np.asarray(of.wanted - columns @ best)

    late_s, rate = known = known or _begin(windows, left, begin, end)
    spread = np.full(2, np.inf)
    for _ in range(3):
        ratio, off = left(windows, late_s, rate)
        kept = _kept(off)
        way, arm = ways(windows, late_s, rate)
        slopes = [
            (ways(windows, late_s + s, rate + r)[0] - ways(windows, late_s - s, rate - r)[0]) / (2.0 * (s + r))
            for s, r in ((BY_S, 0.0), (0.0, BY_RATE))
        ]
        parts = (ratio * slopes[0], ratio * slopes[1], ratio * way, 1j * ratio * way, arm, 1j * arm)
        columns = np.column_stack([np.ascontiguousarray(part[kept]).view(float) for part in parts])
        best, sds = factors(columns, np.ascontiguousarray(windows.wanted[kept]).view(float))
        late_s, rate, spread = late_s + float(best[0]), rate + float(best[1]), sds[:2]
        if abs(late_s) > MOST_S or abs(rate) > 2.0 * RATE:
            return known, None
    kept = _kept(left(windows, late_s, rate)[1])
    power = float(np.sum(np.abs(windows.wanted[kept]) ** 2))

    def unexplained(late_s: float, rate: float) -> float:
        return float(np.sum(np.abs(left(windows, late_s, rate)[1][kept]) ** 2)) / power

    without = min(unexplained(late_s + share * abs(rate) * span_s, 0.0) for share in np.linspace(-0.5, 0.5, 9))
    return known, ClockFit(late_s, float(spread[0]), rate, float(spread[1]), unexplained(late_s, rate), without)


def _kept(off: Complex) -> Mask:
    size = np.abs(off)
    return np.asarray(size <= OUTLIER * float(np.median(size)))


def _begin(
    windows: _Windows, left: Callable[[_Windows, float, float], tuple[complex, Complex]], begin: float, end: float
) -> tuple[float, float]:
    """Delay in the middle and rate, by the delays that fit the first and the last minutes."""
    length_s = min(0.5 * (end - begin), END_S)
    ends = [windows.part(begin, begin + length_s), windows.part(end - length_s, end)]
    if min(part.edges.size for part in ends) < 8:
        return 0.0, 0.0
    most_s = min(LEAST_S + 0.5 * RATE * (end - begin), MOST_S)
    delays = np.arange(-most_s, most_s + 0.5 * STEP_S, STEP_S)
    at = []
    for part in ends:
        off = [float(np.median(np.abs(left(part, float(s), 0.0)[1]))) for s in delays]
        at.append(float(delays[int(np.argmin(off))]))
    return 0.5 * (at[0] + at[1]), (at[1] - at[0]) / max(end - begin - length_s, 1.0)

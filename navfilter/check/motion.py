"""Compare sensors with each other and with the Earth: signs, axes, units, mounting and time offsets.

Compare depth, fixes and velocity: a depth that counts up, heights of another system, a velocity whose z axis points
up or whose y axis points left.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navfilter.check import shared_motion
from navfilter.check.course import SURE, course_findings, far_finding, late_by, mirrored_finding, mounting_of, place_of
from navfilter.check.course_fit import (
    EARTH_RADIUS_M,
    MOST_WINDOWS,
    POLAR,
    WINDOW_S,
    correlation,
    factors,
    heading_of,
    increments,
    integral,
    middle,
    unwrapped,
    vector,
    window_edges,
    without_gaps,
)
from navfilter.check.finding import Finding
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.foundation.display import counted
from navfilter.models.error_models import stated_variance
from navfilter.models.mission import Array, Mission, Stream
from navfilter.models.state import wrap
from navfilter.models.vehicle import Vehicle

#: Correlation below which two sensors have too little in common to be judged.
LITTLE = 0.5
#: Delays up to this are looked for [s].
MOST_DELAY_S = 2.5
#: Correlation from which on a heading follows a gyro, whatever is wrong beside.
FOLLOWS = 0.95


def motion_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Findings that need more than one column: gravity, handedness, heading, course, field, depth."""
    for name, stream in _compared(mission, vehicle).streams.items():
        if "force_x_m_s2" in stream.columns:
            yield from _gyro_range(name, stream)
        yield from _angles(name, stream)
        yield from _field(name, stream, mission)
        yield from _positions(name, stream)
        yield from _pressure(name, stream)
        yield from depth_sign_findings(name, stream)
    yield from compared_findings(mission, vehicle)


def compared_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Findings by comparison: of sensors with each other, and with the Earth's gravity."""
    mission = _compared(mission, vehicle)
    units = {name: s for name, s in mission.streams.items() if "force_x_m_s2" in s.columns}
    for name, imu in units.items():
        yield from _gravity(name, imu)
        yield from _handedness(name, imu)
    agrees = False
    for name, stream in mission.streams.items():
        for unit, imu in units.items():
            gyro = "the gyro" if len(units) == 1 else f"the gyro of {unit}"
            found = list(_gyro_against_heading(name, stream, imu, gyro))
            agrees |= any("follows the gyro" in finding.text for finding in found)
            yield from found
    yield from shared_motion.pair_findings(mission, vehicle)
    yield from shared_motion.axes_findings(mission, vehicle)
    clocks = shared_motion.felt_clocks(mission, vehicle)
    stretched = list(shared_motion.speeding_up_findings(mission, clocks))
    yield from stretched
    if vehicle is not None:
        yield from surfacing_findings(mission, vehicle)
        yield from height_findings(mission, vehicle)
    for name, stream in mission.streams.items():
        if "v_x_m_s" in stream.columns:
            known = name in {finding.stream for finding in stretched}
            sure = name in clocks and shared_motion.is_right(clocks[name][1])
            yield from course_findings(name, stream, mission, vehicle, agrees, (known, sure))
            yield from vertical_findings(name, mission, vehicle)
            if vehicle is not None:
                yield from sideways_findings(name, mission, vehicle)


def _compared(mission: Mission, vehicle: Vehicle | None) -> Mission:
    """The streams that hold enough, on the clock that the vehicle's own description gives them."""
    late = {} if vehicle is None else _described_late_s(vehicle)
    streams = {name: s.later(-late.get(name, 0.0)) for name, s in mission.streams.items() if _has_enough(s)}
    return replace(mission, streams=streams)


def _described_late_s(vehicle: Vehicle) -> dict[str, float]:
    """How late the stamps of each stream are by the vehicle's own description [s]."""
    drive = dict(zip(vehicle.drive.streams, vehicle.drive.late_s, strict=False))
    return drive | {name: sensor.time_offset_s for name, sensor in vehicle.sensors.items()}


def _has_enough(stream: Stream) -> bool:
    """At least ten readings of every column (a height may be missing), over some time."""
    needed = [k for k, name in enumerate(stream.columns) if name not in ("height_m", "hdop", "temperature_C")]
    known = np.isfinite(stream.value[:, needed]).all(axis=1)
    return bool(np.count_nonzero(known) >= 10 and stream.time_s[known][-1] > stream.time_s[known][0])


# --- inertial unit --------------------------------------------------------------------------------------------------


def _gravity(name: str, imu: Stream) -> Iterator[Finding]:
    mean = np.nanmean(vector(imu, "force_x_m_s2"), axis=0)
    size = float(np.linalg.norm(mean))
    if not 0.9 * ROUND_GRAVITY < size < 1.1 * ROUND_GRAVITY:
        known = {
            1.0: 'the unit is "g"',
            1000.0: 'the unit is "mg"',
            ROUND_GRAVITY**2: "the values are m/s^2 already, not g",
        }
        guess = [words for value, words in known.items() if 0.9 * value < size < 1.1 * value]
        cure = f"Perhaps {guess[0]}." if guess else "Raw specific force is needed, with gravity in it; check the unit."
        yield Finding("error", "unit", name, f"the mean specific force is {size:.3g} m/s^2, gravity is 9.8.", cure)
        return
    largest = int(np.argmax(np.abs(mean)))
    if largest != 2 or abs(mean[2]) < 0.7 * size:
        text = f"gravity lies mostly along the {'xyz'[largest]} axis ({mean[largest]:+.2f} m/s^2), not along z."
        cure = "Put the axes in the order forward, right, down (axes, mounting_deg)."
        yield Finding("error", "axes", name, text, cure)
    elif mean[2] > 0.0:
        text = f"the specific force along z is {mean[2]:+.2f} m/s^2 at rest; with z down it is -9.8."
        yield Finding("error", "sign", name, text, 'Is z up? Then axes = "x,-y,-z" for rates and forces both.')


def _gyro_range(name: str, imu: Stream) -> Iterator[Finding]:
    rate = np.abs(vector(imu, "rate_x_rad_s"))
    high = float(np.nanquantile(rate, 0.99))
    if high > 6.0:
        text = f"one rate in a hundred is above {math.degrees(high):.0f} deg/s."
        yield Finding("warning", "unit", name, text, 'Are these degrees per second? Then unit = "deg/s".')


def _handedness(name: str, imu: Stream) -> Iterator[Finding]:
    """A turning body sees gravity turn the other way: d(force)/dt = -rate x force, in windows of a second."""
    time_s, force, rate = imu.time_s, vector(imu, "force_x_m_s2"), vector(imu, "rate_x_rad_s")
    edges = np.arange(time_s[0], min(time_s[-1], time_s[0] + MOST_WINDOWS), 1.0)
    if edges.size < 30:
        return
    half = 0.1
    smooth = integral(time_s, force)
    change = [np.interp(edges + half, time_s, axis) - np.interp(edges - half, time_s, axis) for axis in smooth.T]
    at = np.column_stack(change) / (2.0 * half)
    turn = integral(time_s, -np.cross(rate, force))
    expected = np.column_stack([np.diff(np.interp(edges, time_s, turn[:, k])) for k in range(3)])
    seen = np.diff(at, axis=0)
    wrong = []
    for axis, gyro in ((0, "y"), (1, "x")):
        agreement, slope = correlation(expected[1:-1, axis], seen[1:-1, axis])
        if agreement < -LITTLE:
            wrong.append(f"gyro {gyro} against accelerometer {'xyz'[axis]} (correlation {agreement:.2f})")
        elif agreement > LITTLE and not 1 / 5 < slope < 5:
            text = f"gyro {gyro} is {1 / slope:.3g} times what the turning of gravity says."
            cure = f"Degrees for radians would be {180 / math.pi:.1f}; check the unit."
            yield Finding("error", "unit", name, text, cure)
    if wrong:
        cure = "Gyro and accelerometer must have the same right-handed axes: check the signs of both."
        yield Finding("error", "axes", name, f"gravity turns the wrong way: {'; '.join(wrong)}.", cure)


# --- angles and heading ---------------------------------------------------------------------------------------------


def _angles(name: str, stream: Stream) -> Iterator[Finding]:
    cure = 'Are these degrees? Then unit = "deg".'
    if "pitch_rad" in stream.columns:
        largest = float(np.nanmax(np.abs(stream.column("pitch_rad")), initial=0.0))
        if largest > 0.5 * math.pi + 1e-6:
            yield Finding("error", "unit", name, f"a pitch of {largest:.3g} rad is beyond 90 deg.", cure)
            return
    for column in ("heading_rad", "yaw_rad"):
        if column in stream.columns:
            angle = stream.column(column)
            step = np.abs(wrap(np.diff(angle)))
            period = float(np.median(np.diff(stream.time_s))) if len(stream) > 1 else 1.0
            # Degrees read as radians and wrapped look random: the median step of random angles is a quarter turn.
            if np.nanmedian(step) > 0.5 and period <= 1.5:
                text = (
                    f"the heading jumps by {math.degrees(float(np.nanmedian(step))):.0f} deg from reading to reading."
                )
                yield Finding("error", "unit", name, text, cure)


@dataclass(frozen=True)
class _Match:
    """How well one series follows another: correlation, slope and by how many seconds it is late."""

    correlation: float
    slope: float
    late_s: float


def _match(reference: tuple[Array, Array], other: tuple[Array, Array], window_s: float, most_s: float) -> _Match | None:
    """Compare increments over windows, trying delays of `other` up to `most_s`."""
    begin, end = max(reference[0][0], other[0][0]) + most_s, min(reference[0][-1], other[0][-1]) - most_s
    if end - begin < 10.0 * window_s:
        return None
    edges = window_edges(begin, end, window_s / 4.0)

    wanted = increments(edges, window_s, reference)
    best, at = (0.0, 0.0), 0.0
    for delay in np.linspace(-most_s, most_s, 81):
        found = correlation(wanted, increments(edges, window_s, other, float(delay)))
        if abs(found[0]) > abs(best[0]):
            best, at = found, float(delay)
    return _Match(best[0], best[1], at)


def _gyro_against_heading(name: str, stream: Stream, imu: Stream, gyro: str) -> Iterator[Finding]:
    angle = heading_of(stream)
    if angle is None or len(stream) < 20:
        return
    heading = unwrapped(stream.time_s, angle)
    if heading[0].size < 20:
        return
    turned = imu.time_s, integral(imu.time_s, vector(imu, "rate_x_rad_s")[:, 2])
    match = _match(turned, heading, window_s=2.0, most_s=MOST_DELAY_S)
    if match is None or match.correlation < FOLLOWS:
        late_s = late_by(turned, heading, window_s=2.0)
        if late_s is not None:
            yield from far_finding(name, f"the heading is {{}} against {gyro}.", late_s)
            return
    if match is None or abs(match.correlation) < LITTLE:
        yield Finding("info", "heading", name, f"turns too little to compare the heading with {gyro}.")
        return
    if match.correlation < 0.0:
        text = f"the heading turns against {gyro} (correlation {match.correlation:.2f})."
        cure = "Heading counts clockwise from north, gyro z is positive clockwise (down): one has the wrong sign."
        yield Finding("error", "sign", name, text, cure)
        return
    text = f"the heading follows {gyro}: correlation {match.correlation:.2f}, slope {match.slope:.3f}"
    late = f"{abs(match.late_s):.2f} s {'late' if match.late_s >= 0 else 'early'}"
    yield Finding("info", "heading", name, f"{text}, {late}.")
    # A loose match says nothing about a scale of 0.7, but a factor of 57 shows in any.
    if not (0.7 < match.slope < 1.4 if match.correlation > 0.9 else 0.2 < match.slope < 5.0):
        cure = "A slope of 57.3 or 0.017 is degrees for radians; another one a wrong scale, or an uncalibrated compass."
        yield Finding("error", "unit", name, f"the heading turns {match.slope:.3g} times as far as {gyro}.", cure)
    elif match.correlation > 0.9:
        what = f"the heading is {{}} against {gyro}"
        late_s = match.late_s if abs(match.late_s) < MOST_DELAY_S else 0.0
        yield from shared_motion.clock_finding(name, what, turned, heading, shared_motion.TURN_S, late_s)


# --- the rest -------------------------------------------------------------------------------------------------------


def _field(name: str, stream: Stream, mission: Mission) -> Iterator[Finding]:
    if "field_x_T" not in stream.columns:
        return
    field = vector(stream, "field_x_T")
    size = np.linalg.norm(field, axis=1)
    mean, scatter = float(np.nanmean(size)), float(np.nanstd(size))
    if not 15e-6 < mean < 80e-6:
        text = f"the magnetic field is {mean * 1e6:.3g} uT; the Earth's is 22 to 67."
        cure = "Check the unit; the heading does not need it, the calibration does."
        yield Finding("warning", "unit", name, text, cure)
    if mean > 0.0 and scatter > 0.04 * mean:
        text = f"the strength of the field varies by {100 * scatter / mean:.0f} %: iron on board."
        cure = "Calibrate (hard_iron, soft_iron), or give the compass deviation states."
        yield Finding("warning", "iron", name, text, cure)
    if (place := place_of(mission)) is not None:
        latitude, down = place[0], float(np.nanmean(field[:, 2]))
        if abs(latitude) > 15.0 and down * latitude < 0.0 and abs(down) > 0.2 * mean:
            text = "the field points up in the northern half of the Earth (or down in the southern)."
            yield Finding("error", "sign", name, text, "Its z axis is not down: check the axes.")


def _positions(name: str, stream: Stream) -> Iterator[Finding]:
    if "latitude_rad" not in stream.columns:
        return
    latitude, longitude = stream.column("latitude_rad"), stream.column("longitude_rad")
    if float(np.nanmax(np.abs(latitude), initial=0.0)) > 0.5 * math.pi:
        cure = 'Degrees for radians (unit = "deg"), or swapped columns.'
        yield Finding("error", "unit", name, "latitudes beyond 90 deg.", cure)
        return
    if abs(float(np.nanmedian(latitude))) > POLAR and abs(middle(longitude)) < POLAR:
        usual_deg = math.degrees(float(np.nanmedian(latitude)))
        text = f"latitudes around {usual_deg:.0f} deg: are latitude and longitude exchanged?"
        cure = f"If so, exchange the first two columns of position in [streams.{name}]."
        yield Finding("warning", "exchanged", name, text, cure)
    north = np.diff(latitude) * EARTH_RADIUS_M
    east = wrap(np.diff(longitude)) * np.cos(latitude[1:]) * EARTH_RADIUS_M
    step = np.diff(stream.time_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.hypot(north, east) / np.where(step > 0.0, step, np.nan)
    jumps = int(np.count_nonzero((speed > 60.0) & (np.hypot(north, east) > 20.0)))
    if jumps:
        text = f"{counted(jumps, 'jumps')} faster than 60 m/s between fixes."
        cure = "The gate will refuse outliers; make sure that the run starts on a good fix."
        yield Finding("warning", "leaps", name, text, cure)


def _pressure(name: str, stream: Stream) -> Iterator[Finding]:
    if "pressure_Pa" in stream.columns:
        lowest = float(np.nanmin(stream.column("pressure_Pa")))
        if lowest < 5e4:
            text = f"an absolute pressure of {lowest:.4g} Pa is below any at sea level."
            cure = 'Check the unit ("hPa", "dbar", "bar"); gauge pressure needs offset = 101325.'
            yield Finding("error", "unit", name, text, cure)


#: A depth gauge may be off by so much at the surface, and waves go as high [m].
_SURFACE_M = 2.0
#: An antenna that nobody has described is so near the water where it has a fix [m].
_MAST_M = 0.5
#: The sea is nowhere so far from the ellipsoid [m].
_GEOID_M = 120.0
#: An offset stands out beyond so many standard deviations of what is described [1].
_STANDS_OUT = 2.5
#: So far from any fix in time the vehicle is said to be without [s], and so much deeper it must be then [m].
_WITHOUT_S, _DEEPER_M = 30.0, 1.0
#: Correlation from which on a depth follows a velocity; and the ratio of two units, at least, as a logarithm [1].
_FOLLOWS, _OTHER_UNIT = 0.9, 0.4
#: Depth changes of less than this in a window say nothing [m].
_LITTLE_M = 0.1


def depth_sign_findings(name: str, stream: Stream) -> Iterator[Finding]:
    """A depth that is negative wherever the vehicle is under water."""
    if "depth_m" not in stream.columns:
        return
    depth = stream.column("depth_m")
    highest, lowest = float(np.nanmax(depth, initial=-math.inf)), float(np.nanmin(depth, initial=math.inf))
    if lowest < -_SURFACE_M and -lowest > 3.0 * max(highest, 0.0):
        text = f"the depth goes from {lowest:.3g} to {highest:.3g} m; it counts positive down."
        cure = f"Are these heights? Then set scale = -1 in depth of [streams.{name}]."
        yield Finding("error", "sign", name, text, cure)


def surfacing_findings(mission: Mission, vehicle: Vehicle) -> Iterator[Finding]:
    """Depth gauges that do not read what they should where fixes say that the vehicle is at the surface."""
    heard: list[tuple[str, Any]] = [(n, s) for n, s in vehicle.sensors.items() if n in mission.streams]
    for name, sensor in heard:
        if not hasattr(sensor, "surface_height_m"):
            continue
        readings, good = sensor.read_all(mission.streams[name].value)
        if np.count_nonzero(good) < 10:
            continue
        time_s, depth_m = mission.streams[name].time_s[good], readings[good, 0]
        for fixes, receiver in heard:
            if not hasattr(receiver, "antenna_height_m"):
                continue
            at_s = mission.streams[fixes].time_s[receiver.read_all(mission.streams[fixes].value)[1]]
            up_m = receiver.antenna_height_m
            above_m = 0.0 if up_m is None else up_m - sensor.surface_height_m
            off_m = _off_at_the_surface(time_s, depth_m, at_s)
            if off_m is None:
                continue
            expected_m = sensor.lever_arm_b_m[2] - receiver.lever_arm_b_m[2] - above_m
            off_m -= expected_m
            described = [*sensor.models, *(receiver.models[2:] if up_m is not None else ())]
            known_m = math.sqrt(sum(map(stated_variance, described)) + sensor.offset_sd_m**2)
            if abs(off_m) < max(_STANDS_OUT * known_m, _MAST_M if up_m is None else 0.0):
                continue
            text = f"where {fixes} has fixes it reads {off_m + expected_m:.2f} m,"
            text += f" and {expected_m:.2f} m is expected there."
            cure = f"A gauge that is off: set offset_sd_m = {math.ceil(10.0 * abs(off_m)) / 10.0:g}"
            cure += f" in [sensors.{name}]"
            if up_m is None:
                cure += f", and antenna_height_m in [sensors.{fixes}]: each surfacing then tells the offset"
            yield Finding("warning", "datum", name, text, f"{cure}.")


def height_findings(mission: Mission, vehicle: Vehicle) -> Iterator[Finding]:
    """Fixes whose heights are not in the system of the depths: each of the two is right, and one of them is refused."""
    heard: list[tuple[str, Any]] = [(n, s) for n, s in vehicle.sensors.items() if n in mission.streams]
    gauges = [(n, s) for n, s in heard if hasattr(s, "surface_height_m")]
    receivers = [(n, s) for n, s in heard if getattr(s, "antenna_height_m", 0.0) is None]
    for (fixes, receiver), (name, gauge) in itertools.product(receivers, gauges):
        depth, good = gauge.read_all(mission.streams[name].value)
        fix, usable = receiver.read_all(mission.streams[fixes].value)
        time_s, at_s = mission.streams[name].time_s[good], mission.streams[fixes].time_s
        usable = usable & np.isfinite(fix[:, 2])
        if time_s.size < 10 or not np.any(usable := usable & (at_s >= time_s[0]) & (at_s <= time_s[-1])):
            continue
        arms_m = gauge.lever_arm_b_m[2] - receiver.lever_arm_b_m[2]
        below_m = np.interp(at_s[usable], time_s, depth[good, 0])
        off_m = float(np.median(fix[usable, 2] + below_m)) - gauge.surface_height_m - arms_m
        known_m = math.sqrt(sum(map(stated_variance, (receiver.models[2], *gauge.models))) + gauge.offset_sd_m**2)
        if np.count_nonzero(usable) < 10 or not max(_STANDS_OUT * known_m, _SURFACE_M) < abs(off_m) < _GEOID_M:
            continue
        text = f"its heights are {abs(off_m):.1f} m {'above' if off_m > 0.0 else 'below'} where {name} has the antenna."
        cure = "Heights above the ellipsoid, and depths below the sea? Then the sea is at"
        cure += f" surface_height_m = {gauge.surface_height_m + off_m:.1f} in [sensors.{name}]. Or have no height read:"
        cure += f" antenna_height_m in [sensors.{fixes}]"
        yield Finding("warning", "datum", fixes, text, f"{cure}, how far above the sea it is.")


def _off_at_the_surface(time_s: Array, depth_m: Array, at_s: Array) -> float | None:
    """Depth read where there are fixes; None unless they come at the surface only: the vehicle is deeper elsewhere."""
    at_s = at_s[(at_s >= time_s[0]) & (at_s <= time_s[-1])]
    if at_s.size < 3:
        return None
    shallow = np.interp(at_s, time_s, depth_m)
    after = np.clip(np.searchsorted(at_s, time_s), 1, at_s.size - 1)
    far = np.minimum(np.abs(time_s - at_s[after - 1]), np.abs(time_s - at_s[after])) > _WITHOUT_S
    middle = float(np.median(shallow))
    if np.count_nonzero(far) < 10 or float(np.median(depth_m[far])) < float(np.max(shallow)) + _DEEPER_M:
        return None
    return middle if float(np.percentile(np.abs(shallow - middle), 90.0)) < _DEEPER_M else None


def vertical_findings(name: str, mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Findings about the z axis of a velocity, against the depth."""
    depth = next(((n, s) for n, s in mission.streams.items() if "depth_m" in s.columns), None)
    if depth is None or any(True for _ in depth_sign_findings(*depth)):
        return
    stream = mission.streams[name]
    v = vector(stream, "v_x_m_s") @ mounting_of(name, vehicle)[0].T
    known = np.isfinite(v).all(axis=1)
    time_s, v = stream.time_s[known], v[known]
    sines = _tilt(time_s, v, mission)
    below = np.isfinite(depth[1].column("depth_m"))
    if sines is None or np.count_nonzero(below) < 10 or time_s.size < 10:
        return
    depth_time_s, depth_m = depth[1].time_s[below], depth[1].column("depth_m")[below]
    begin, end = max(time_s[0], depth_time_s[0]), min(time_s[-1], depth_time_s[-1]) - WINDOW_S
    edges = without_gaps(window_edges(begin, end, WINDOW_S / 4.0), time_s, depth_time_s)
    if edges.size < 40:
        return
    roll, pitch = sines
    level = np.sqrt(1.0 - pitch**2)
    sunk = integral(time_s, np.column_stack([-pitch * v[:, 0], level * (v[:, 2] + roll * v[:, 1])]))
    late_s = late_by((time_s, sunk.sum(axis=1)), (depth_time_s, depth_m), WINDOW_S)
    if late_s is not None:
        yield from far_finding(depth[0], f"the depth is {{}} against what {name} and the tilt say of it.", late_s)
        return
    X = np.column_stack([increments(edges, WINDOW_S, (time_s, sunk[:, k])) for k in range(2)])
    y = increments(edges, WINDOW_S, (depth_time_s, depth_m))
    if float(np.std(y)) < _LITTLE_M:
        return
    best, sd = factors(X, y)
    if best[0] < -0.5 and best[0] + SURE * sd[0] < 0.0:
        text = "the depth grows where the vehicle moves up with its bow up, and falls where it dives."
        cure = f"It counts positive down: set scale = -1 in depth of [streams.{depth[0]}]."
        yield Finding("error", "sign", depth[0], text, cure)
    elif best[1] < -0.5 and best[1] + SURE * sd[1] < 0.0:
        cure = f'z is down: set axes = "x,-y,-z" in velocity of [streams.{name}] for forward, left, up.'
        text = f"the velocity says up where {depth[0]} says down: its z axis points up."
        yield Finding("error", "sign", name, text, cure)
    else:
        way = increments(edges, WINDOW_S, (time_s, integral(time_s, v)[:, 0]))
        # as a velocity that is mounted too steep says, the depth changes with the way
        sunk, deeper = (series - way * (series @ way) / max(way @ way, 1e-9) for series in (X.sum(axis=1), y))
        yield from _scale_findings(depth[0], name, sunk, deeper)


def _scale_findings(depth: str, velocity: str, sunk: Array, deeper: Array) -> Iterator[Finding]:
    """A depth in another unit, or a pressure: it changes by more or less than the vehicle sinks."""
    (scale,), (sd,) = factors(sunk[:, None], deeper)
    follows = correlation(sunk, deeper)[0] > _FOLLOWS and scale > 0.0
    if follows and abs(math.log(scale)) > max(_OTHER_UNIT, SURE * sd / scale):
        text = f"the depth changes {scale:.3g} times as far as {velocity} and the tilt say."
        known = {
            3.281: '"ft"',
            0.3048: "metres read as feet",
            100.0: '"cm", or hPa: a pressure',
            1000.0: '"mm"',
            9.81: "kPa: a pressure",
        }
        guess = [f" Perhaps {unit}." for value, unit in known.items() if abs(scale / value - 1.0) < 0.05]
        cure = f"Check the unit of depth in [streams.{depth}].{''.join(guess)} Or is it that of [streams.{velocity}]?"
        yield Finding("error", "unit", depth, text, cure)


def _tilt(time_s: Array, v: Array, mission: Mission) -> tuple[Array, Array] | None:
    """Sines of roll and pitch at some times: of an attitude, else from the specific force without the acceleration."""
    for stream in mission.streams.values():
        if "pitch_rad" in stream.columns:
            roll, pitch = (
                np.sin(np.interp(time_s, stream.time_s, stream.column(f"{a}_rad"))) for a in ("roll", "pitch")
            )
            return roll, pitch
    imu = next((s for s in mission.streams.values() if "force_x_m_s2" in s.columns), None)
    if imu is None or time_s.size < 10:
        return None
    felt, turned = (integral(imu.time_s, vector(imu, column)) for column in ("force_x_m_s2", "rate_x_rad_s"))
    half = max(0.5, float(np.median(np.diff(time_s))))

    def mean(series: Array, k: int, times: Array) -> Array:
        ahead, behind = (np.interp(time_s + side * half, times, series[:, k]) for side in (1, -1))
        return (ahead - behind) / (2.0 * half)

    speed_up = [mean(np.column_stack([v[:, k]]), 0, time_s) for k in range(2)]
    forward = mean(felt, 0, imu.time_s) - speed_up[0]
    side = mean(felt, 1, imu.time_s) - speed_up[1] - mean(turned, 2, imu.time_s) * v[:, 0]
    return np.clip(-side / ROUND_GRAVITY, -0.9, 0.9), np.clip(forward / ROUND_GRAVITY, -0.9, 0.9)


def sideways_findings(name: str, mission: Mission, vehicle: Vehicle) -> Iterator[Finding]:
    """A velocity that swings to the wrong side where the vehicle turns: its lever arm says to which."""
    imu = next((s for s in mission.streams.values() if "force_x_m_s2" in s.columns), None)
    mounting, lever = mounting_of(name, vehicle)
    if imu is None or abs(lever.real) < 0.1:
        return
    stream = mission.streams[name]
    v = vector(stream, "v_x_m_s") @ mounting.T
    known = np.isfinite(v).all(axis=1)
    time_s, side = stream.time_s[known], v[known, 1]
    if time_s.size < 200:
        return
    turned = integral(imu.time_s, vector(imu, "rate_x_rad_s"))
    half = 0.5 * float(np.median(np.diff(time_s)))
    ends = [[np.interp(time_s + to * half, imu.time_s, turned[:, k]) for k in (0, 2)] for to in (-1, 1)]
    rates = (np.array(ends[1]) - np.array(ends[0])) / (2.0 * half)
    # Slip comes and goes slowly, the swing of the lever arm with the turning itself.
    X, y = np.diff(rates.T, axis=0), np.diff(side)
    steady = np.diff(time_s) < 4.0 * half
    X, y = X[steady], y[steady]
    best, sd = factors(X, y)
    arm, arm_sd = float(best[1]) / lever.real, float(sd[1]) / abs(lever.real)
    if arm_sd < 0.2 and abs(arm + 1.0) < 0.3 + SURE * arm_sd and arm + SURE * arm_sd < 0.0:
        why = (
            f"in turns it swings as if it stood {lever.real * arm:+.2f} m along x, not {lever.real:+.2f} m "
            "(vehicle.toml)"
        )
        yield mirrored_finding(name, why)

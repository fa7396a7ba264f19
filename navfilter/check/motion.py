"""Compare sensors with each other and with the Earth: signs, axes, units, mounting and time offsets."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from navfilter.check import shared_motion, vertical
from navfilter.check.clock_offsets import far_finding, late_by
from navfilter.check.course import course_findings
from navfilter.check.course_fit import EARTH_RADIUS_M, POLAR
from navfilter.check.finding import Finding
from navfilter.check.magnetic_north import place_of
from navfilter.check.series import (
    MOST_WINDOWS,
    correlation,
    heading_of,
    integral,
    middle,
    unwrapped,
    vector,
    window_edges,
)
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.foundation.display import counted
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
        yield from vertical.depth_sign_findings(name, stream)
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
        yield from vertical.surfacing_findings(mission, vehicle)
        yield from vertical.height_findings(mission, vehicle)
    for name, stream in mission.streams.items():
        if "v_x_m_s" in stream.columns:
            known = name in {finding.stream for finding in stretched}
            sure = name in clocks and shared_motion.is_right(clocks[name][1])
            yield from course_findings(name, stream, mission, vehicle, agrees, (known, sure))
            yield from vertical.vertical_findings(name, mission, vehicle)
            if vehicle is not None:
                yield from vertical.sideways_findings(name, mission, vehicle)


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

    def increments(series: tuple[Array, Array], delay: float) -> Array:
        return np.interp(edges + window_s + delay, *series) - np.interp(edges + delay, *series)

    wanted = increments(reference, 0.0)
    best, at = (0.0, 0.0), 0.0
    for delay in np.linspace(-most_s, most_s, 81):
        found = correlation(wanted, increments(other, float(delay)))
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

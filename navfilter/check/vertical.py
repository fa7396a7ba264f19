"""Compare depth, fixes and velocity: a depth that counts up, heights of another system, a velocity whose z axis points
up or whose y axis points left.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from navfilter.check.clock_offsets import far_finding, late_by
from navfilter.check.course import SURE, mirrored_finding, mounting_of
from navfilter.check.course_fit import WINDOW_S, without_gaps
from navfilter.check.finding import Finding
from navfilter.check.series import correlation, factors, integral, vector, window_edges
from navfilter.foundation.constants import ROUND_GRAVITY
from navfilter.models.error_models import stated_variance
from navfilter.models.mission import Array, Mission, Stream
from navfilter.models.vehicle import Vehicle

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
    X = np.column_stack([_increments(edges, time_s, sunk[:, k]) for k in range(2)])
    y = _increments(edges, depth_time_s, depth_m)
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
        way = _increments(edges, time_s, integral(time_s, v)[:, 0])
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


def _increments(edges: Array, time_s: Array, series: Array) -> Array:
    increments: Array = np.interp(edges + WINDOW_S, time_s, series) - np.interp(edges, time_s, series)
    return increments


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

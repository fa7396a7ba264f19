"""Residuals that follow the motion: a clock, a lever arm or a deviation that nobody has described.

What became of the constants that a vehicle.toml is unsure of: clocks, lever arms, scales, biases.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from navfilter.calibration.lights import Light, check_limits, lit
from navfilter.calibration.parts import constants_of
from navfilter.check.course import part_of
from navfilter.check.finding import Finding, Severity
from navfilter.check.units_text import amount
from navfilter.foundation.arrays import Array
from navfilter.kernels.strapdown import gravity
from navfilter.models.during import instrument, shared
from navfilter.models.mission import Mission
from navfilter.models.parameters import Parameter, constant_parameters
from navfilter.models.sensors import Sensor
from navfilter.models.state import matrix_from_euler
from navfilter.track.track import Track


class Constant(NamedTuple):
    """A constant state at the end of a run.

    Attributes
    ----------
    owner : str
        Sensor; empty for the drive.
    name : str
        Of the state.
    unit : str
    given, given_sd : float
        As described: the value, mostly zero, and its standard deviation.
    value, sd : float
        As found.
    """

    owner: str
    name: str
    unit: str
    given: float
    given_sd: float
    value: float
    sd: float


def constants(track: Track) -> tuple[Constant, ...]:
    """The constants of a run, those that are unsure in its vehicle; of a smoothed track, those of all its time.

    Parameters
    ----------
    track : Track
    """
    vehicle = track.vehicle
    drive = vehicle.drive
    constant = constant_parameters(drive.all_parameters(), drive.wandering())
    given: list[tuple[str, str, str, Parameter]] = [("", p.name, p.name, p) for p in constant]
    heard_s = {name: r.time_s.max(initial=-math.inf) for name, r in track.residuals.items()}
    for name, sensor in vehicle.sensors.items():
        others = {o: shared(sensor, s) for o, s in vehicle.sensors.items() if instrument(o) == instrument(name)}
        for p in constant_parameters(sensor.all_parameters(), sensor.wandering()):
            # of an instrument that was described otherwise for a time it stands where that was heard last
            same = [other for other, names in others.items() if p.name in names]
            if same[0] == name:
                last = max(same, key=lambda other: heard_s.get(other, -math.inf))
                given.append((name, f"{name}.{p.name}", f"{last}.{p.name}", p))
    at = {name: i for i, name in enumerate(track.state_names)}
    return tuple(
        Constant(owner, name, p.unit, p.mean, p.sd, *(float(x[-1, at[own]]) for x in (track.states, track.states_sd)))
        for owner, name, own, p in given
        if p.sd and own in at and math.isfinite(track.states_sd[-1, at[own]])
    )


def constant_lights(track: Track, limits: Sequence[tuple[str, float, str]] = ()) -> tuple[Light, ...]:
    """How far a run has told each constant; of a smoothed one those are the constants of all its time.

    Parameters
    ----------
    track : Track
    limits : sequence of (str, float, str)
        Of the sds that may be left, see `navfilter.calibration.lights.limit_of`.

    Raises
    ------
    ValueError
        For a limit that fits no constant of the run, or has another dimension.
    """
    found = {one.name: one for one in constants(track)}
    there = [one for one in constants_of(track.vehicle) if one.name in found]
    check_limits(limits, there)
    # the state of a clock or a lever arm is what comes on top of its key
    pairs = [(one, found[one.name]) for one in there]
    return tuple(lit(one, one.value + state.value - state.given, state.sd, limits) for one, state in pairs)


def constant_doubts(run: Track, far: float, untold: float) -> Iterator[Finding]:
    """Constants that are not what the description says, and those that the mission does not tell.

    Parameters
    ----------
    run : Track
    far : float
        Farther from the description than so many of its standard deviations is too far.
    untold : float
        A mission that leaves more of that standard deviation than this share has not told the constant.
    """
    found = constants(run)
    # of twenty, chance takes one so far in one mission of four: what it does with so many is a remark
    by_chance = float(-ndtri(ndtr(-far) / max(len(found), 1)))
    for one in found:
        if abs(one.value - one.given) > far * one.given_sd:
            off = f"{amount(one.value, one.unit)} (sd {amount(one.sd, one.unit)})"
            far_off = f"{abs(one.value - one.given) / one.given_sd:.1f} sd from what vehicle.toml says"
            name = one.name.removeprefix(f"{one.owner}.")
            grade: Severity = "warning" if abs(one.value - one.given) > by_chance * one.given_sd else "info"
            yield Finding(grade, "constant", one.owner, f"{name} is {off}, {far_off}.", _cure(one, run.vehicle))
    names = [f"{one.name} (sd {amount(one.sd, one.unit)})" for one in found if one.sd > untold * one.given_sd]
    if names:
        text = f"this mission hardly tells {', '.join(names)}: known no better than vehicle.toml says."
        yield Finding("info", "untold", "", text, "")


def _cure(one: Constant, vehicle: Any) -> str:
    """The key that says better what the constant is."""
    owner, _, what = one.name.rpartition(".")
    part = "drive" if not one.owner else "sensors"
    table = f"[{part}.{owner}]" if owner else f"[{part}]"
    sensor = part_of(vehicle, owner)
    if sensor is not None and what == "time_offset":
        return (
            f"Set time_offset_s = {sensor.time_offset_s + one.value:.3g} in {table} of vehicle.toml, or widen its sd."
        )
    if sensor is not None and what.startswith("lever_arm_"):
        axis = "xyz".index(what[-1])
        metres = sensor.lever_arm_b_m[axis] + one.value
        return f"Set the {what[-1]} of lever_arm_b_m to {metres:.3g} m in {table} of vehicle.toml, or widen its sd."
    if sensor is None:
        table, what = "[drive]", one.name
    return f"In {table} of vehicle.toml, widen the sd of {what}; or correct the description by what was found."


#: A mission without any cause says a false word once in so many.
FALSE_ALARMS = 1e-4
#: A correlation below this explains less than two hundredths of the residuals' variance: so much does noise of a poor
#: inertial unit, which is in residuals and motion alike.
LEAST = 0.15
#: The same for the heading by which a compass deviates: no noise of the unit is in that, and what a deviation leaves is
#: gone soon after each turn. Without one it is below 0.015 (24 missions); 0.7 and 0.3 deg make 0.05 to 0.16.
LEAST_BY_HEADING = 0.03
#: A run begins with what is not known yet [s].
BEGINNING_S = 60.0
#: Fewer readings say nothing.
READINGS = 50
#: Motion is a mean over this time: what vibrates faster is none [s].
SMOOTH_S = 1.0
#: Motion is looked at so much later than a reading [s]: noise of the drive before it is in its residual too.
AFTER_S = 0.55
#: A compass is held against the turn so much before its readings, too: one whose clock is ahead shows a heading that is
#: older than its stamp. Noise of the gyros is in both, so that less than this says nothing: without a fault it is below
#: 0.08 with a micromechanical unit, and a second makes 0.4 to 0.6 in the half where the clock is off. No acceleration
#: is looked at there: accelerometers of such a unit make 0.28 of nothing.
LEAST_BEFORE = 0.25
#: Heading and pitch of the drive's own turns are held to those of the track over this time [s].
LEVEL_S = 60.0
#: A compass whose deviation keeps more than this share of its sd has residuals that follow the turns for it.
UNTOLD = 0.5
#: Share of a series over which its autocorrelation is summed.
LAGS = 0.1


class Correlation(NamedTuple):
    """Residuals of one axis against one quantity of the motion.

    Attributes
    ----------
    sensor, axis, motion, cause : str
        Whose residuals, along what, with what they were compared, and what would make them follow.
    key : str
        What to add to vehicle.toml.
    least : float
        A coefficient below this says nothing.
    r : float
        Correlation coefficient.
    effective : float
        Independent pairs that are worth as much as the readings.
    chance : float
        That independent series correlate so much.
    whole : bool
        All along; else in a part of the run.
    """

    sensor: str
    axis: str
    motion: str
    cause: str
    key: str
    least: float
    r: float
    effective: float
    chance: float
    whole: bool = True


@dataclass(frozen=True)
class _Motion:
    """How the vehicle moved at the times of some readings: by its drive and its track.

    Forces and rates come from the drive's own samples, not from the track: a correction moves the track, and would
    correlate with its own residual.
    """

    time_s: Array
    turn_rate: Array
    acceleration: Array
    heading: Array

    @property
    def gained(self) -> Array:
        """What the accelerations have added to the velocity north and east, shape (n, 2)."""
        along = np.column_stack([np.cos(self.heading), np.sin(self.heading)]) * self.acceleration[:, None]
        steps = 0.5 * (along[1:] + along[:-1]) * np.diff(self.time_s)[:, None]
        return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def correlation(x: Array, y: Array) -> tuple[float, float]:
    """Correlation coefficient of two series, and its effective number of pairs.

    Parameters
    ----------
    x, y : ndarray, shape (n,)

    Returns
    -------
    r, effective : float
        For independent series ``r * sqrt(effective)`` is standard normal: the variance of r is the sum over all lags of
        the product of both autocorrelations, over n (Bartlett, 1946); that of x is taken of what y does not explain.

    Examples
    --------
    >>> x, y = np.random.default_rng(1).normal(size=(2, 4000))
    >>> r, effective = correlation(x + 0.2 * y, y)
    >>> round(r, 1), 3000 < effective <= 4000
    (0.2, True)
    """
    n = len(x)
    x, y = x - x.mean(), y - y.mean()
    power = math.sqrt(float(x @ x) * float(y @ y))
    if power == 0.0:
        return 0.0, 0.0
    lags, r = max(1, int(LAGS * n)), float(x @ y) / power
    # what y explains is no noise of x
    a, b = (_autocorrelation(v, lags) for v in (_without(x, y), y))
    spread = 1.0 + 2.0 * float(np.sum((1.0 - np.arange(1, lags + 1) / n) * a * b))
    return r, n / max(spread, 1.0)


def _autocorrelation(x: Array, lags: int) -> Array:
    """Lags 1 ... `lags`."""
    size = 1 << (2 * len(x) - 1).bit_length()
    power = np.abs(np.fft.rfft(x, size)) ** 2
    products = np.fft.irfft(power, size)[: lags + 1]
    return np.asarray(products[1:] / products[0])


def correlations(run: Track, mission: Mission) -> tuple[Correlation, ...]:
    """All that is compared: whitened residuals of each sensor with what would betray a constant nobody has described.

    Parameters
    ----------
    run : Track
        Forward.
    mission : Mission
        As it was replayed.

    Notes
    -----
    A state follows an error of its sensor, so that residuals hold only what it has not followed yet. The motion goes
    through the same filter: a reading's share ``k = 1 - R / S`` is taken into the state.
    """
    found: list[Correlation] = []
    deviates = {one.owner for one in constants(run) if "_cycle_" in one.name and one.sd > UNTOLD * one.given_sd}
    for name, sensor in run.vehicle.sensors.items():
        r = run.residuals.get(name)
        if r is None or sensor.from_drive or r.count("used") < READINGS:
            continue
        known = r.used & np.isfinite(r.value).all(axis=1) & np.isfinite(r.sd).all(axis=1)
        known &= r.time_s > run.time_s[0] + BEGINNING_S
        if known.sum() < READINGS:
            continue
        whitened = r.value[known] / r.sd[known]
        motion = _moved(run, mission, r.time_s[known] - sensor.time_offset_s)
        before = _moved(run, mission, r.time_s[known] - sensor.time_offset_s, -AFTER_S)
        follows = _followed(sensor, r.sd[known])
        if sensor.observes.in_body_axes and sensor.axes == 3:
            whitened = whitened @ sensor.instrument_axes()
        for pair in _pairs(name, run.vehicle, motion, before, name in deviates):
            value = np.concatenate([whitened[:, column] for column in pair.columns])
            against = np.concatenate([_unfollowed(part, follows) for part in pair.motions])
            for other in pair.beside:
                known_by = _unfollowed(other, follows)
                value, against = _without(value, known_by), _without(against, known_by)
            for when, part in _parts(len(value), pair.halves):
                if np.std(against[part]) == 0.0:
                    continue
                coefficient, effective = correlation(value[part], against[part])
                chance = 2.0 * float(ndtr(-abs(coefficient) * math.sqrt(effective)))
                words = pair.axis, pair.words + when, pair.cause, pair.key, pair.least
                found.append(Correlation(name, *words, coefficient, effective, chance, not when))
    return tuple(found)


def _parts(n: int, halves: bool) -> Iterator[tuple[str, slice]]:
    """The whole of so many readings, and its halves, in words."""
    yield "", slice(0, n)
    if halves and n >= 2 * READINGS:
        yield ", in the first half", slice(0, n // 2)
        yield ", in the second half", slice(n // 2, n)


def correlation_doubts(run: Track, mission: Mission) -> Iterator[Finding]:
    """Residuals that follow the motion more than chance and more than nothing, with the key that is missing.

    The threshold is `FALSE_ALARMS` for all that is compared together (Bonferroni).
    """
    compared = correlations(run, mission)
    said: set[tuple[str, str]] = set()
    for one in sorted(compared, key=lambda one: (not one.whole, -abs(one.r))):
        if one.chance * len(compared) > FALSE_ALARMS or abs(one.r) < one.least or (one.sensor, one.cause) in said:
            continue
        said.add((one.sensor, one.cause))
        along = f" {one.axis}" if one.axis else ""
        text = f"its residuals{along} follow the {one.motion} (correlation {one.r:+.2f}): {one.cause}."
        set_then = "" if one.whole else " Was it set on the way? Then its stamps want another offset from there on."
        cure = f"{one.key}; 'navfilter calibrate' then finds it.{set_then}"
        yield Finding("warning", "correlation", one.sensor, text, cure)


def _without(x: Array, y: Array) -> Array:
    """What y does not explain of x."""
    y = y - y.mean()
    power = float(y @ y)
    return x if power == 0.0 else x - float(x @ y) / power * y


def _moved(run: Track, mission: Mission, time_s: Array, after_s: float = AFTER_S) -> _Motion:
    roll, pitch = (np.interp(time_s, run.time_s, run.attitude[:, k]) for k in range(2))
    heading = np.interp(time_s, run.time_s, np.unwrap(run.attitude[:, 2]))
    drive = run.vehicle.drive
    t, values = drive.samples(mission.streams)
    values = np.where(np.isfinite(values), values, 0.0)
    if drive.inertial:
        per = drive.period_s if getattr(drive, "increments", False) else 1.0
        rates, forces = (
            _mean_about(time_s + after_s, t, values[:, part] / per, SMOOTH_S) for part in (slice(0, 3), slice(3, 6))
        )
        down = matrix_from_euler(roll, pitch, 0.0 * roll)[:, 2, :]
        turn = np.einsum("ni,ni->n", down, rates)
        rising = rates[:, 1] * np.cos(roll) - rates[:, 2] * np.sin(roll)
        pitch, heading = _between(time_s, rising, pitch), _between(time_s, turn, heading)
        ahead = forces[:, 0] - np.sin(pitch) * gravity(float(run.latitude[0]), float(run.height[0]))
    else:
        yaw = np.unwrap(values[:, 2])
        turn = _slope_about(time_s + after_s, t, yaw)
        axes = run.vehicle.drive.velocity_sensor.instrument_axes()  # type: ignore[union-attr]
        ahead = _slope_about(time_s + after_s, t, (values[:, 3:6] @ axes)[:, 0])
    return _Motion(time_s, turn, ahead, heading)


def _between(time_s: Array, turn: Array, heading: Array) -> Array:
    """The turns of the drive, on the level of the track's heading: what corrects the heading now is not in it. The same
    of a pitch.
    """
    own = np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * np.diff(time_s))])
    off = _mean_about(time_s, time_s, (heading - own)[:, None], LEVEL_S)
    return np.asarray(own + off[:, 0])


def _mean_about(time_s: Array, t: Array, values: Array, span_s: float) -> Array:
    """Means of the columns over a span around some times."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    first = np.searchsorted(t, time_s - 0.5 * span_s)
    last = np.maximum(np.searchsorted(t, time_s + 0.5 * span_s), first + 1)
    last = np.minimum(last, len(t))
    first = np.minimum(first, last - 1)
    return np.asarray((total[last] - total[first]) / (last - first)[:, None])


def _slope_about(time_s: Array, t: Array, values: Array) -> Array:
    """Slope across `SMOOTH_S` about some times."""
    ends = [np.interp(time_s + side * SMOOTH_S, t, values) for side in (-0.5, 0.5)]
    return np.asarray((ends[1] - ends[0]) / SMOOTH_S)


class _Pair(NamedTuple):
    """What is compared: columns of the residuals, one after the other, with as many motions; in words. What other
    motions beside these explain is taken off both. One that may change on the way is compared in the halves, too.
    """

    axis: str
    columns: tuple[int, ...]
    words: str
    motions: tuple[Array, ...]
    cause: str
    key: str
    least: float = LEAST
    beside: tuple[Array, ...] = ()
    halves: bool = False


def _followed(sensor: Sensor, sd: Array) -> float:
    """How much of a residual the state follows at each reading: one minus white variance over predicted variance."""
    white = float(np.mean([model.block(1.0 / sensor.rate_hz).r for model in sensor.models]))
    return float(np.clip(1.0 - white / np.median(sd**2), 0.02, 1.0))


def _unfollowed(signal: Array, gain: float) -> Array:
    """What is left of a signal in the readings once the state follows it: residuals of a filter with this gain."""
    steps = np.diff(signal, prepend=signal[0]).tolist()
    return np.array(list(accumulate(steps, lambda left, step: step + (1.0 - gain) * left)))


def _pairs(name: str, vehicle: Any, motion: _Motion, before: _Motion, deviates: bool) -> Iterator[_Pair]:
    """What is compared of one sensor: only what the vehicle does not describe already, and no clock of a compass whose
    deviation is hardly told.
    """
    sensor = vehicle.sensors[name]
    table = f"[sensors.{name}] of vehicle.toml"
    late, clock = not sensor.time_offset_sd_s, f"Add time_offset_sd_s = 0.3 to {table}"
    arm = f"Add lever_arm_sd_m = [0.5, 0.5, 0.5] to {table}"
    fixed = sensor.has_lever_arm and not any(sensor.lever_arm_sd_m)
    c, s = np.cos(motion.heading), np.sin(motion.heading)
    if sensor.gives == "heading":
        if late and not deviates:
            off = "its clock is off", clock
            yield _Pair("", (0,), "turn rate", (motion.turn_rate,), *off, halves=True)
            yield _Pair("", (0,), "turn rate just before", (before.turn_rate,), *off, LEAST_BEFORE, halves=True)
        if not any(sensor.deviation_sd_rad):
            cause = "it deviates with the heading, or a gyro turns by too much or too little"
            key = f"Add bias_sd_deg = 5.0 and deviation_sd_deg = [5.0, 2.0] to {table}"
            rest = cause, key, LEAST_BY_HEADING, (motion.turn_rate,) if late else ()
            for wave in (s, c, 2.0 * s * c, c**2 - s**2):
                yield _Pair("", (0,), "heading", (wave,), *rest)
    elif sensor.observes.in_body_axes and sensor.axes == 3:
        if late:
            yield _Pair("forward", (0,), "acceleration", (motion.acceleration,), "its clock is off", clock, halves=True)
        if fixed:
            for axis, column in (("forward", 0), ("sideways", 1)):
                yield _Pair(axis, (column,), "turn rate", (motion.turn_rate,), "its lever arm is off", arm)
    elif sensor.gives == "position" and fixed and late:
        cause, key = "its lever arm or its clock is off", f"{arm}, or time_offset_sd_s = 0.3"
        velocity = [other for other, kind in vehicle.sensors.items() if kind.observes.in_body_axes]
        if velocity or not vehicle.drive.inertial:
            cause = "its lever arm or its clock is off, or that of the velocity"
            key += f"; or the same to {f'[sensors.{velocity[0]}]' if velocity else '[drive.velocity]'}"
        for axis, waves in (("along the vehicle", (c, s)), ("across it", (-s, c))):
            yield _Pair(axis, (0, 1), "heading", waves, cause, key)
    drive = vehicle.drive
    if sensor.gives == "position" and not drive.inertial and not drive.velocity_sensor.time_offset_sd_s:
        cause, key = "the clock of the drive's velocity is off", "Add time_offset_sd_s = 0.3 to [drive.velocity]"
        yield _Pair("", (0, 1), "acceleration", (motion.gained[:, 0], motion.gained[:, 1]), cause, key)

"""What became of the constants that a vehicle.toml is unsure of: clocks, lever arms, scales, biases."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from scipy.special import ndtr, ndtri

from navfilter.calibration.lights import Light, check_limits, lit
from navfilter.calibration.parts import constants_of
from navfilter.check.course import part_of
from navfilter.check.finding import Finding, Severity
from navfilter.check.units_text import amount
from navfilter.models.during import instrument, shared
from navfilter.models.parameters import Parameter, constant_parameters
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

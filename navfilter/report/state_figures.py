"""Figures of the states behind the nine of navigation: biases, coloured errors, calibration parameters; and of what
drives, which has no innovations.
"""

import textwrap
from dataclasses import dataclass

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.models.error_models import ErrorModel
from navfilter.models.sensors.traits import shown_unit
from navfilter.models.vehicle import Vehicle
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Level, Line, Panel, Part, Stack, short
from navfilter.track.track import Track, Tracks

#: Of residuals of the drive, under their figure.
STEPS = (
    "{name}: residuals of what drives (smoothed run): the step that it would have had to say too much at each time for "
    "all later readings to fit best, in standard deviations of that step. Of honest ones 95 % lie within 2; a hill is "
    "an error that lasted. The largest: {largest}."
)


@dataclass(frozen=True)
class ShownState:
    """One state worth a panel.

    Attributes
    ----------
    owner : str
        Sensor, or "gyro", "accel", "drive".
    name : str
        As in `Track.state_names`.
    label, unit : str
        For the axis.
    factor : float
        From SI to the unit.
    """

    owner: str
    name: str
    label: str
    unit: str
    factor: float


def shown_states(vehicle: Vehicle) -> tuple[ShownState, ...]:
    """The states that mean something by themselves: the first of every part of an error model, and all parameters."""
    found: list[ShownState] = []
    drive = vehicle.drive
    for axis, model, unit in zip(drive.axis_names, drive.models, drive.units, strict=True):
        owner = axis.rsplit("_", 1)[0] if drive.inertial else "drive"
        found += _parts(owner, axis, model, drive.period_s, unit)
    found += [ShownState("drive", p.name, p.name, *shown_unit(p.unit)) for p in drive.all_parameters()]
    for key, sensor in vehicle.sensors.items():
        for axis, model, unit in zip(sensor.axis_names, sensor.models, sensor.units, strict=True):
            label = "_".join(part for part in (key, axis) if part)
            found += _parts(key, label, model, 1.0 / sensor.rate_hz, unit)
        found += [ShownState(key, f"{key}.{p.name}", p.name, *shown_unit(p.unit)) for p in sensor.all_parameters()]
    return tuple(found)


def _parts(owner: str, axis: str, model: ErrorModel, period_s: float, unit: str) -> list[ShownState]:
    """The first state of each part of one axis's model."""
    sizes = [part.block(period_s).size for part in model.terms]
    found, offset = [], 0
    for part, size in zip(model.terms, sizes, strict=True):
        if size:
            kind = f" ({type(part).__name__})" if sum(map(bool, sizes)) > 1 else ""
            found.append(ShownState(owner, f"{axis}[{offset}]", f"{axis}{kind}", *shown_unit(unit)))
        offset += size
    return found


def states_figure(tracks: Tracks, states: tuple[ShownState, ...]) -> Stack:
    """Estimates over time with their 1-sigma bands, one panel per state.

    Parameters
    ----------
    tracks : dict of str to Track
    states : tuple of ShownState
        Of one owner, see `shown_states`; a run that has no such state is left out of its panel.
    """
    panels = []
    for state in states:
        parts: list[Part] = []
        for number, (label, track) in enumerate(tracks.items()):
            if state.name not in track.state_names:
                continue
            hue, dash = colour(number)
            value, sd = (state.factor * part for part in track.state(state.name))
            parts.append(Band(track.time_s, value - sd, value + sd, f"{label} ±1σ", hue))
            parts.append(Line(track.time_s, value, label, hue, dash))
        lines = textwrap.wrap(short(state.label, 48).replace("_", " ").replace(".", " "), 16)
        panels.append(Panel("\n".join([*lines, f"[{state.unit}]"]), tuple(parts), lines_at=(0.0,)))
    return Stack(tuple(panels), 1.2)


def drive_residuals(track: Track) -> dict[str, list[tuple[str, Array, Array, str]]]:
    """Residuals of what drives, by its parts as `shown_states` calls them: axis, step and its sd, unit; nothing of a
    track that is not smoothed.
    """
    if track.drive_steps is None:
        return {}
    parts = (("accel", "m/s", 1.0), ("gyro", "deg", 180.0 / np.pi))
    found: dict[str, list[tuple[str, Array, Array, str]]] = {}
    for column in range(track.drive_steps.shape[2]):
        owner, unit, factor = parts[column // 3] if track.vehicle.drive.inertial else ("drive", "m", 1.0)
        step, sd = factor * track.drive_steps[:, :, column].T
        found.setdefault(owner, []).append(("xyz"[column % 3], step, sd, unit))
    return {owner: axes for owner, axes in found.items() if any(np.isfinite(step).any() for _, step, _, _ in axes)}


def steps_figure(track: Track, owner: str) -> tuple[Stack, str]:
    """Residuals of a part of what drives, in standard deviations, and their caption."""
    panels, largest = [], []
    for axis, step, sd, unit in drive_residuals(track)[owner]:
        value, (hue, dash) = step / sd, colour(0)
        level = Level(-2.0, 2.0, "95 %")
        line = Line(track.time_s, value, "residual", hue, dash)
        panels.append(Panel(f"{owner} {axis}\n[sd]", (line,), None, "symmetric", level=level))
        if np.isfinite(value).any():
            at = int(np.nanargmax(np.abs(value)))
            largest.append(
                (abs(value[at]), f"{axis} {value[at]:.1f} at {track.time_s[at]:.0f} s, {step[at]:.2g} {unit}")
            )
    return Stack(tuple(panels), 1.2), STEPS.format(name=owner, largest=max(largest)[1])

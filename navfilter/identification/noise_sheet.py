"""The noise sheet of an inertial unit: what a data sheet says, from a record at rest, with uncertainties."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.foundation.display import Shown
from navfilter.identification.allan_curve import AllanCurve, allan_curve
from navfilter.identification.conditioning import quantisation_step
from navfilter.identification.cosine_spectrum import Bands, bands_of
from navfilter.identification.noise_choice import drive_terms, sheet_terms, upper_limit, usable
from navfilter.identification.noise_terms import NoiseFit
from navfilter.identification.spectral_lines import Line, reach, spectral_lines
from navfilter.identification.static_detection import bridged_rest, moving_together, stillness, without_defects
from navfilter.io.inertial import ImuRecord
from navfilter.models.mechanisation.imu import ACCEL_USUAL, GYRO_USUAL

Say = Callable[[str], Any]

#: A gyro whose mean differs by more from one stretch to another turns [rad/s]: no bias changes by half a degree a
#: second.
MOST_TURN = 0.01
#: Lines that are kept, the strongest.
MOST_LINES = 12
#: Records shorter than this say little of what is slow [s].
SHORT_S = 1800.0


class NotAtRest(ValueError):
    """No part of a record is at rest for long enough."""


@dataclass(frozen=True, eq=False)
class AxisSheet:
    """One axis, in rad/s or m/s^2.

    Attributes
    ----------
    name : str
        ``gyro_x`` ... ``accel_z``.
    level : float
        Mean of the longest stretch: of a gyro its bias and its share of the Earth's rate.
    sheet, drive : NoiseFit
        White noise, flicker and walk (IEEE 952); and what a filter has states for: white noise, Gauss-Markov, walk.
    limits : dict of str to float
        Largest sizes, at 95 %, of the terms of the sheet that do not show (``"flicker"``, ``"walk"``), and of the walk
        beside the terms of the drive (``"drive"``); NaN where the record sets none.
    quantisation, quantisation_sd : float
        Of the angle or the velocity [unit s]; NaN where there is no such rise towards high frequencies.
    step : float
        Rounding of the samples; 0 if none is seen.
    lines : tuple of Line
    allan : AllanCurve
    bands : Bands
        All, also those above what was fitted.
    notes : tuple of str
    """

    name: str
    level: float
    sheet: NoiseFit
    drive: NoiseFit
    limits: dict[str, float]
    quantisation: float
    quantisation_sd: float
    step: float
    lines: tuple[Line, ...]
    allan: AllanCurve
    bands: Bands
    notes: tuple[str, ...]

    @property
    def is_gyro(self) -> bool:
        """A gyro, or an accelerometer."""
        return self.name.startswith("gyro")


@dataclass(frozen=True, eq=False, repr=False)
class NoiseSheet(Shown):
    """What was found of an inertial unit.

    Attributes
    ----------
    source : str
    rate_hz, duration_s : float
        Of the record.
    stretches_s : tuple of (begin, end)
        Parts at rest that were used, in seconds from the beginning of the record.
    share : float
        Their share of the record.
    axes : tuple of AxisSheet
    moving : tuple of str
        Signs that the unit was not at rest after all.
    remarks : tuple of str
    """

    source: str
    rate_hz: float
    duration_s: float
    stretches_s: tuple[tuple[float, float], ...]
    share: float
    axes: tuple[AxisSheet, ...]
    moving: tuple[str, ...]
    remarks: tuple[str, ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {"record": f"{self.duration_s:.0f} s, {self.rate_hz:.4g} Hz", "verdict": self.verdict}
        rows |= {"axes": ", ".join(axis.name for axis in self.axes), "remarks": " ".join(self.remarks) or None}
        return f"NoiseSheet of {self.source}", rows

    @property
    def verdict(self) -> str:
        """Whether the record is at rest, in one sentence."""
        if self.moving:
            return "NOT AT REST: " + "; ".join(self.moving) + ". The figures are those of unit and motion together."
        parts = ", ".join(f"{begin:.0f} to {end:.0f} s" for begin, end in self.stretches_s[:6])
        parts += f" and {len(self.stretches_s) - 6} more" if len(self.stretches_s) > 6 else ""
        if self.share > 0.999:
            return f"at rest throughout ({self.duration_s:.0f} s)."
        return f"at rest for {100 * self.share:.1f} % of {self.duration_s:.0f} s, and only that is used: {parts}."


def noise_sheet(record: ImuRecord, say: Say | None = None) -> NoiseSheet:
    """Find the noise of an inertial unit from a record that is at rest, at least in parts.

    Parameters
    ----------
    record : ImuRecord
    say : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    NoiseSheet

    Raises
    ------
    NotAtRest
        Where no part of the record is at rest for half a minute.
    ValueError
        Where an axis is constant.
    """
    say = say or (lambda text: None)
    say("looking for rest")
    samples, notes = without_defects(record.value)
    turn = np.array([MOST_TURN if name.startswith("gyro") else math.inf for name in record.names])
    found = stillness(samples, record.rate_hz, turn)
    if not found.stretches:
        raise NotAtRest(
            f"{record.source}: not at rest: no stretch of half a minute in {len(samples) / record.rate_hz:.0f} s in"
            " which all axes are as quiet as in the quietest quarter of the record. A noise sheet takes a record of the"
            " unit lying still, of an hour or more if it is to show the bias instability."
        )
    longest = max(found.stretches, key=lambda stretch: stretch[1] - stretch[0])
    whole = {
        name: [bridged_rest(samples[a:b, k], found.disturbed[a:b]) for a, b in found.stretches]
        for k, name in enumerate(record.names)
    }
    steps = {name: quantisation_step(record.value[longest[0] : longest[1], k]) for k, name in enumerate(record.names)}
    axes = []
    for name, stretches in whole.items():
        say(f"fitting {name}")
        axes.append(_axis(name, stretches, record.rate_hz, steps[name]))
    moving = _moving(whole, axes, found.stretches.index(longest), record.rate_hz)
    seconds = tuple((a / record.rate_hz, b / record.rate_hz) for a, b in found.stretches)
    remarks = (*record.notes, *notes, *_remarks(axes, seconds))
    return NoiseSheet(
        record.source, record.rate_hz, len(samples) / record.rate_hz, seconds, found.share, tuple(axes), moving, remarks
    )


# --- one axis -------------------------------------------------------------------------------------------------------


def _axis(name: str, stretches: Sequence[Array], rate_hz: float, step: float) -> AxisSheet:
    longest = max(stretches, key=len)
    if np.ptp(longest) == 0.0:
        raise ValueError(f"{name} is constant ({longest[0]:g}): it has no noise to tell. Is it the right column?")
    lines = spectral_lines(stretches, rate_hz)
    bands = bands_of(stretches, rate_hz, [reach(line, longest.size / rate_hz) for line in lines])
    kept = usable(bands)
    sheet, drive = sheet_terms(kept), drive_terms(kept)
    limits = {kind: upper_limit(kept, sheet, kind) for kind in ("flicker", "walk") if sheet.term(kind) is None}
    if drive.term("walk") is None:
        limits["drive"] = upper_limit(kept, drive, "walk")
    angle, angle_sd = quantisation(sheet, 1.0 / rate_hz)
    notes = []
    if sheet.highest_hz < 0.45 * rate_hz:
        notes.append(f"fitted up to {sheet.highest_hz:.3g} Hz, above which the unit's own filter bends the spectrum")
    if sheet.dispersion > 1.0:
        notes.append(
            f"the terms do not explain all of the spectrum (its scatter is {math.sqrt(sheet.dispersion):.1f} times that"
            " of chance); the uncertainties are widened by as much"
        )
    if step > 0.0 and step**2 / 12.0 > 0.25 * float(np.mean(np.diff(longest) ** 2)) / 2.0:
        notes.append(f"the samples are rounded to {step:.3g}, which makes much of their noise")
    if len(lines) > MOST_LINES:
        notes.append(f"{len(lines)} lines, of which the {MOST_LINES} strongest are listed")
    allan = allan_curve(stretches, rate_hz, sheet)
    level = float(longest.mean())
    return AxisSheet(
        name, level, sheet, drive, limits, angle, angle_sd, step, lines[:MOST_LINES], allan, bands,
        tuple(notes),
    )  # fmt: skip


def quantisation(fit: NoiseFit, period_s: float) -> tuple[float, float]:
    """Q of IEEE 952 and its sd from the rise to the Nyquist frequency, which is 4 Q^2 / T; NaN where there is none."""
    if fit.rise < 3.0 * fit.rise_sd or fit.highest_hz < 0.45 / period_s:
        return math.nan, math.nan
    size = math.sqrt(0.25 * fit.rise * period_s)
    return size, 0.5 * size * fit.rise_sd / fit.rise


# --- the unit -------------------------------------------------------------------------------------------------------


def _moving(whole: dict[str, list[Array]], axes: Sequence[AxisSheet], longest: int, rate_hz: float) -> tuple[str, ...]:
    """Signs of motion: axes that move together, noise that no such unit has."""
    found = []
    gyro, accel = ([parts[longest] for name, parts in whole.items() if name.startswith(g)] for g in ("gyro", "accel"))
    if together := moving_together(gyro, accel, rate_hz):
        found.append(
            f"{together[0]} move together" + (f" (and {len(together) - 1} more pairs)" if together[1:] else "")
        )
    for axis in axes:
        most = (GYRO_USUAL if axis.is_gyro else ACCEL_USUAL).most_density
        if axis.sheet.terms[0].size > most:
            found.append(
                f"the noise of {axis.name} is {axis.sheet.terms[0].size / most:.1f} times what the worst units have"
            )
    return tuple(found)


def _remarks(axes: Sequence[AxisSheet], stretches_s: Sequence[tuple[float, float]]) -> list[str]:
    remarks = [f"{axis.name}: {note}" for axis in axes for note in axis.notes]
    longest = max(end - begin for begin, end in stretches_s)
    if longest < SHORT_S:
        remarks.append(
            f"the longest stretch at rest is {longest / 60:.3g} min: what is slower than a third of it does not show;"
            " an hour or more shows bias instability and walk"
        )
    force = [axis.level for axis in axes if not axis.is_gyro]
    if len(force) == 3:
        length = math.sqrt(sum(level**2 for level in force))
        apart = length - STANDARD_GRAVITY
        remarks.append(
            f"the force at rest is {length:.4f} m/s^2, {1e3 * apart / STANDARD_GRAVITY:+.1f} mg from standard gravity"
            + (": beyond the biases of most units, so a scale or a unit is wrong" if abs(apart) > 1.0 else "")
        )
    return remarks

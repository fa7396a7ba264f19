"""A noise sheet in the units of data sheets: rows, text, numbers for other programs, and the ``[drive]`` table."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from navfilter.foundation.constants import MILLI_G, ROOT_HOUR, STANDARD_GRAVITY
from navfilter.foundation.quoting import json_value, one_line
from navfilter.identification.noise_sheet import AllanCurve, AxisSheet, NoiseSheet
from navfilter.rendering.page import table_text

_DEG = 180.0 / math.pi
_HOUR = 3600.0
_MICRO_G = 1e-3 * MILLI_G
#: Averaging times of the table [s].
TAUS = (0.1, 1.0, 10.0, 100.0, 1000.0, 10_000.0)
#: Local gravity differs from the standard one by up to so much between equator and poles [mg].
GRAVITY_MG = 2.7


class Row(NamedTuple):
    """One quantity of the sheet: how it is called, its unit, and what it is in SI times this."""

    key: str
    name: str
    unit: str
    factor: float


GYRO = (
    Row("white", "angle random walk", "deg/sqrt(h)", _DEG * ROOT_HOUR),
    Row("flicker", "bias instability (flicker B)", "deg/h", _DEG * _HOUR),
    Row("floor", "lowest Allan deviation", "deg/h", _DEG * _HOUR),
    Row("walk", "rate random walk", "deg/h/sqrt(h)", _DEG * _HOUR * ROOT_HOUR),
    Row("quantisation", "angle quantisation", "arcsec", _DEG * _HOUR),
    Row("step", "rounded to", "deg/s", _DEG),
    Row("level", "mean, with the Earth's rate", "deg/h", _DEG * _HOUR),
)
ACCEL = (
    Row("white", "velocity random walk", "m/s/sqrt(h)", ROOT_HOUR),
    Row("density", "the same", "ug/sqrt(Hz)", 1.0 / _MICRO_G),
    Row("flicker", "bias instability (flicker B)", "ug", 1.0 / _MICRO_G),
    Row("floor", "lowest Allan deviation", "ug", 1.0 / _MICRO_G),
    Row("walk", "acceleration random walk", "ug/sqrt(h)", ROOT_HOUR / _MICRO_G),
    Row("quantisation", "velocity quantisation", "mm/s", 1e3),
    Row("step", "rounded to", "ug", 1.0 / _MICRO_G),
    Row("level", "mean", "m/s^2", 1.0),
)


def rows(axes: Sequence[AxisSheet]) -> list[list[str]]:
    """The sheet of three gyros or three accelerometers: name with unit, and one cell for each axis."""
    found = []
    for row in GYRO if axes[0].is_gyro else ACCEL:
        cells = [_cell(axis, row) for axis in axes]
        if any(cell != "-" for cell in cells):
            found.append([f"{row.name} [{row.unit}]", *cells])
    for number in range(max(len(axis.lines) for axis in axes)):
        factor, unit = (_DEG * _HOUR, "deg/h") if axes[0].is_gyro else (1.0 / _MICRO_G, "ug")
        cells = [_line(axis, number, factor) for axis in axes]
        found.append([f"lines [{unit}]" if number == 0 else "", *cells])
    return found


def _cell(axis: AxisSheet, row: Row) -> str:
    fit, f = axis.sheet, row.factor
    if row.key in ("white", "density"):
        return plus_minus(fit.terms[0].size * f, fit.terms[0].sd * f)
    if row.key in ("flicker", "walk"):
        if term := fit.term(row.key):
            return plus_minus(term.size * f, term.sd * f)
        return "-" if math.isnan(axis.limits[row.key]) else f"< {_digits(axis.limits[row.key] * f, 2)}"
    if row.key == "floor":
        k = axis.allan.lowest
        least, low, high = (value[k] * f for value in (axis.allan.deviation, axis.allan.low, axis.allan.high))
        digits = _decimals(0.5 * (high - low))
        rising = "" if axis.allan.has_floor else " or later"
        bars = f"(-{least - low:.{digits}f} +{high - least:.{digits}f})"
        return f"{least:.{digits}f} {bars} at {_digits(axis.allan.tau_s[k], 3)} s{rising}"
    if row.key == "quantisation":
        return "-" if math.isnan(axis.quantisation) else plus_minus(axis.quantisation * f, axis.quantisation_sd * f)
    if row.key == "step":
        return f"{axis.step * f:.4g}" if axis.step else "-"
    return f"{axis.level * f:.5g}"


def _line(axis: AxisSheet, number: int, factor: float) -> str:
    if number >= len(axis.lines):
        return ""
    line = axis.lines[number]
    return f"{line.frequency_hz:.4g} Hz: {plus_minus(line.amplitude * factor, line.sd * factor)}"


def plus_minus(value: float, sd: float) -> str:
    """A value and its standard deviation, both to the second digit of the latter.

    Examples
    --------
    >>> plus_minus(2.42467, 0.00271), plus_minus(1234.0, 56.0)
    ('2.4247 +- 0.0027', '1234 +- 56')
    """
    digits = _decimals(sd)
    return f"{value:.{digits}f} +- {sd:.{digits}f}"


def _decimals(sd: float) -> int:
    return max(1 - math.floor(math.log10(sd)), 0) if sd > 0.0 and math.isfinite(sd) else 3


def allan_rows(axes: Sequence[AxisSheet]) -> list[list[str]]:
    """Allan deviation at whole decades with error bars of one standard deviation, one column for each axis."""
    factor, unit = (_DEG * _HOUR, "deg/h") if axes[0].is_gyro else (1.0 / _MICRO_G, "ug")
    found = []
    for tau in TAUS:
        cells = [_allan_cell(axis.allan, tau, factor) for axis in axes]
        if any(cells):
            found.append([f"Allan deviation at {tau:g} s [{unit}]", *cells])
    return found


def _allan_cell(curve: AllanCurve, tau_s: float, factor: float) -> str:
    if not curve.tau_s[0] <= tau_s * 1.0001 or tau_s > curve.tau_s[-1]:
        return ""
    k = int(np.argmin(np.abs(np.log(curve.tau_s / tau_s))))
    # to the exact time along the slope of the curve
    step = float(np.exp(np.interp(math.log(tau_s), np.log(curve.tau_s), np.log(curve.deviation)))) / curve.deviation[k]
    value, low, high = (part[k] * step * factor for part in (curve.deviation, curve.low, curve.high))
    digits = _decimals(0.5 * (high - low))
    return f"{value:.{digits}f} (-{value - low:.{digits}f} +{high - value:.{digits}f})"


def sheet_text(sheet: NoiseSheet) -> str:
    """The whole sheet for a terminal."""
    lines = [f"{sheet.source}: inertial unit, {sheet.rate_hz:.6g} Hz", sheet.verdict, ""]
    for axes in groups(sheet):
        header = ["", *(axis.name.replace("_", " ") for axis in axes)]
        lines += [table_text(header, [*rows(axes), *allan_rows(axes)]), ""]
    lines += [f"note: {remark}" for remark in sheet.remarks]
    return "\n".join([*lines, "", "For vehicle.toml:", "", drive_toml(sheet)])


def groups(sheet: NoiseSheet) -> list[list[AxisSheet]]:
    """The gyros and the accelerometers, as far as they are there."""
    both = [[axis for axis in sheet.axes if axis.is_gyro == gyro] for gyro in (True, False)]
    return [axes for axes in both if axes]


# --- vehicle.toml ---------------------------------------------------------------------------------------------------


def drive_toml(sheet: NoiseSheet) -> str:
    """The ``[drive]`` table of a vehicle.toml with these errors, axis by axis.

    Parameters
    ----------
    sheet : NoiseSheet

    Returns
    -------
    str
        Noise as it was found. How far the biases may lie off at the start is that of this one record.
    """
    lines = [
        one_line(f"# From {sheet.source.rsplit('/', 1)[-1]}: {sheet.verdict}"),
        "[drive]",
        'type = "imu"',
        f"rate_hz = {float(f'{sheet.rate_hz:.4g}'):g}",
    ]
    for axes in groups(sheet):
        name = "gyro" if axes[0].is_gyro else "accel"
        start = _gyro_start(axes) if name == "gyro" else _accel_start(axes)
        lines += ["", f"[drive.{name}]", f"# start_sd: {start[1]}"]
        for axis in axes:
            lines += [f"{axis.name[-1]} = [", *(f"  {model}," for model in _models(axis, start[0])), "]"]
    if len(sheet.axes) == 3:
        missing = "accel" if sheet.axes[0].is_gyro else "gyro"
        lines.insert(4, f"# The record has no {missing}: its default holds.")
    return "\n".join(lines) + "\n"


def _gyro_start(axes: Sequence[AxisSheet]) -> tuple[str, str]:
    largest = max(abs(axis.level) for axis in axes) * _DEG * _HOUR
    return f"start_sd_deg_per_h = {_digits(largest, 2)}", "the largest mean of the record, the Earth's rate in it"


def _accel_start(axes: Sequence[AxisSheet]) -> tuple[str, str]:
    length = math.sqrt(sum(axis.level**2 for axis in axes))
    apart = abs(length - STANDARD_GRAVITY) / MILLI_G if len(axes) == 3 else 0.0
    words = "by how much the force at rest differs from gravity, and how far gravity is known"
    return f"start_sd_mg = {_digits(math.hypot(apart, GRAVITY_MG), 2)}", words


def _models(axis: AxisSheet, start: str) -> list[str]:
    gyro, fit = axis.is_gyro, axis.drive
    white = fit.terms[0].size
    key, factor = ("density_deg_per_sqrt_h", _DEG * ROOT_HOUR) if gyro else ("density_ug_per_sqrt_hz", 1.0 / _MICRO_G)
    models = [f'{{model = "white", {key} = {_digits(white * factor)}}}']
    if markov := fit.term("gauss-markov"):
        key, factor = ("sd_deg_per_h", _DEG * _HOUR) if gyro else ("sd_ug", 1.0 / _MICRO_G)
        models.append(
            f'{{model = "gauss-markov", {key} = {_digits(markov.size * factor)}, tau_s = {_digits(markov.tau_s)}}}'
        )
    walk = fit.term("walk")
    size = walk.size if walk else axis.limits.get("drive", 0.0)
    key, factor = ("density_deg_per_h_per_sqrt_h", _DEG * _HOUR * ROOT_HOUR) if gyro else ("density", 1.0)
    models.append(f'{{model = "random-walk", {key} = {_digits(0.0 if math.isnan(size) else size * factor)}, {start}}}')
    return models


def _digits(value: float, digits: int = 4) -> str:
    return f"{float(f'{value:.{digits}g}'):g}"


# --- JSON -----------------------------------------------------------------------------------------------------------


def sheet_dict(sheet: NoiseSheet) -> dict[str, Any]:
    """Everything as plain numbers, lists and text, in SI and in the units of the sheet; None where no number is."""
    return {
        key: json_value(value)
        for key, value in {
            "source": sheet.source,
            "rate_hz": sheet.rate_hz,
            "duration_s": sheet.duration_s,
            "at_rest": not sheet.moving,
            "verdict": sheet.verdict,
            "moving": list(sheet.moving),
            "stretches_s": [list(stretch) for stretch in sheet.stretches_s],
            "share": sheet.share,
            "axes": {axis.name: _axis_dict(axis) for axis in sheet.axes},
            "drive_toml": drive_toml(sheet),
            "remarks": list(sheet.remarks),
        }.items()
    }


def _axis_dict(axis: AxisSheet) -> dict[str, Any]:
    k = axis.allan.lowest
    table = {row.key: row for row in (GYRO if axis.is_gyro else ACCEL)}
    found: dict[str, Any] = {"unit": "rad/s" if axis.is_gyro else "m/s^2", "level": axis.level, "sheet": {}}
    for key in ("white", "flicker", "walk", "quantisation"):
        value, sd, limit = _figure(axis, key)
        f = table[key].factor
        found["sheet"][key] = {
            "name": table[key].name, "value": value, "sd": sd, "below": limit,
            "value_in_unit": value * f, "sd_in_unit": sd * f, "below_in_unit": limit * f, "unit": table[key].unit,
        }  # fmt: skip
    found["lowest_allan"] = {
        "tau_s": axis.allan.tau_s[k], "deviation": axis.allan.deviation[k], "low": axis.allan.low[k],
        "high": axis.allan.high[k], "rises_again": axis.allan.has_floor,
    }  # fmt: skip
    found |= {
        "nyquist_ratio": axis.sheet.ratio, "fitted_to_hz": axis.sheet.highest_hz,
        "dispersion": axis.sheet.dispersion, "step": axis.step,
        "drive": [dataclasses.asdict(term) for term in axis.drive.terms],
        "lines": [dataclasses.asdict(line) for line in axis.lines],
        "allan": dataclasses.asdict(axis.allan), "notes": list(axis.notes),
    }  # fmt: skip
    return found


def _figure(axis: AxisSheet, key: str) -> tuple[float, float, float]:
    """Value, standard deviation and upper limit in SI; NaN where there is none."""
    if key == "quantisation":
        return axis.quantisation, axis.quantisation_sd, math.nan
    term = axis.sheet.term(key)
    return (term.size, term.sd, math.nan) if term else (math.nan, math.nan, axis.limits.get(key, math.nan))

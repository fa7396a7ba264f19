"""A calibration in words: the table that is printed, and what to make of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from navfilter.calibration.calibrate import TOO_MUCH, Calibration, Found
from navfilter.calibration.lights import check_limits, lit
from navfilter.calibration.parts import Constant
from navfilter.calibration.validation import Prediction
from navfilter.check.units_text import amount

#: Units in which constants are shown: name and size in SI.
_SHOWN = {"rad": ("deg", math.pi / 180.0), "1": ("%", 1e-2)}
_WIDTH = 30


def calibration_text(result: Calibration, limits: Sequence[tuple[str, float, str]] = ()) -> str:
    """The table of a calibration, what it is worth, and remarks.

    Parameters
    ----------
    result : Calibration
    limits : sequence of (str, float, str)
        Of the sds that may be left, see `navfilter.calibration.lights.limit_of`.

    Raises
    ------
    ValueError
        For a limit that fits no constant, or has another dimension.
    """
    described = [
        Constant(f.name, f.part, f.name.rpartition(".")[2], f.unit, f.before, f.before_sd, False) for f in result.found
    ]
    check_limits(limits, described)
    lights = [lit(one, f.value, f.sd, limits).colour for one, f in zip(described, result.found, strict=True)]
    lines = [f"{'constant':{_WIDTH}} {'described':>20}  {'found':>20}  {'light':>7}"]
    lines += [_row(one, light) for one, light in zip(result.found, lights, strict=True)]
    lines += ["", *_worth(result)]
    return "\n".join([*lines, *_remarks(result)])


def _row(one: Found, light: str) -> str:
    unit, size = _SHOWN.get(one.unit, (one.unit.replace("_per_", "/").replace("_", "/"), 1.0))
    digits = max(3, 2 - math.floor(math.log10(one.before_sd / size)))  # a field may be in tesla
    both = (one.before, one.before_sd), (one.value, one.sd)
    before, found = (f"{v / size:.{digits}f} +- {sd / size:.{digits}f}" for v, sd in both)
    label = f"{one.name} [{unit}]"
    if not one.told:
        return f"{label:{_WIDTH}} {before:>20}  {'not told':>20}  {light:>7}"
    away = abs(one.value - one.before) / one.before_sd
    if not one.believed:
        return f"{label:{_WIDTH}} {before:>20}  {'not believed':>20}  {light:>7}  {away:.1f} sd off"
    return f"{label:{_WIDTH}} {before:>20}  {found:>20}  {light:>7}" + (f"  {away:.1f} sd off" if away > 2.5 else "")


def _worth(result: Calibration) -> Iterator[str]:
    if result.before is not None and result.after is not None:
        for name, one in (("described", result.before), ("found", result.after)):
            yield f"withheld, by the constants as {name}: {_predicted(one)}"
        if not math.isnan(result.after.rms_m) and not math.isnan(result.after.cost):
            gain = result.before.cost * result.before.count - result.after.cost * result.after.count
            yield f"ln of the likelihood of these fixes, each by those before it: {gain:+.1f} by the constants found"
    yield f"{'Kept' if result.kept else 'Not kept'}: {result.why}."


def _predicted(one: Prediction) -> str:
    if math.isnan(one.rms_m):
        return f"cost {one.cost:.4f} a reading, of {one.count} (minus the mean log-likelihood)"
    return (
        f"rms {amount(one.rms_m, 'm')} at {one.count} fixes, predicted {amount(one.sd_m, 'm')}; "
        f"{100.0 * one.inside:.0f} % inside the 95 % ellipse"
    )


def _remarks(result: Calibration) -> Iterator[str]:
    untold = [one.name for one in result.found if not one.told]
    if untold:
        yield f"Not told, more than 80 % of its sd is left: {', '.join(untold)}. These stay as described."
    doubtful = [one for one in result.found if not one.believed]
    if doubtful:
        each = ", ".join(f"{one.name} ({amount(one.value, one.unit)})" for one in doubtful)
        yield (
            f"Not believed: {each}. It is far from what is described, and without it what was withheld is predicted "
            "better: something that vehicle.toml has no state for looks like it. It stays as described, and sure."
        )
    if result.factor > TOO_MUCH:
        yield (
            f"The parts of the missions scatter {math.sqrt(result.factor):.1f} times as much as their likelihood says: "
            "they count less by that. An error model of vehicle.toml is too small, or a constant changes."
        )
    wide = [one.name for one in result.found if one.told and one.believed and one.scatter >= one.sd * 0.999]
    if wide:
        yield (
            f"The parts of the missions scatter more than their likelihood says in {', '.join(wide)}: the sd is that "
            "of the scatter. Is an error model too small, or does a constant change?"
        )
    if not result.settled:
        yield (
            f"The constants had not settled after {result.rounds} steps: their sds hold what the last ones moved them "
            "by. Start from a better description."
        )
    if result.kept and result.after is not None and result.after.inside < 0.8:
        yield "The withheld fixes lie outside the ellipse too often: an error model is too small."
    wheels = [one for one in result.found if one.told and one.believed and one.name.endswith(".scale") and result.kept]
    if wheels:
        factors = ", ".join(f"{one.name} {1.0 / (1.0 + one.value):.5f}" for one in wheels)
        yield f"Of a velocity that comes from wheels, the true radius is the described one times: {factors}."

"""What columns are by their names: units behind a name, and the axes of gyros and accelerometers."""

import re
from collections.abc import Sequence

import numpy as np

from navfilter.io.table import Table

#: Names of columns, without their units, in lower case; the last character is the axis.
_NAMES = {
    "gyro": r"(?:.*[._ ])?(?:gyros?|gyroscope|gyr|omega|angular_?velocity|angular_?rate|ang_?vel|rate|w|g)[._ \[]?",
    "accel": r"(?:.*[._ ])?(?:acc|accels?|accelerometer|acceleration|linear_?acceleration|(?:specific_?)?force|f|a)"
    r"[._ \[]?",
}
_AXES = (("x", "y", "z"), ("0", "1", "2"), ("1", "2", "3"))
#: Endings of names that are units.
_ENDINGS = {
    "rad_s": "rad/s", "rad/s": "rad/s", "rads": "rad/s", "deg_s": "deg/s", "deg/s": "deg/s", "dps": "deg/s",
    "deg_h": "deg/h", "m_s2": "m/s^2", "m/s2": "m/s^2", "m/s^2": "m/s^2", "ms2": "m/s^2", "g": "g", "mg": "mg",
}  # fmt: skip
#: What the size of a resting accelerometer says of its unit.
SIZES = (("m/s^2", 9.80665), ("g", 1.0), ("mg", 1000.0))
#: No vehicle turns faster [rad/s]: larger numbers are degrees.
_FAST_RAD_S = 4.0


def bare_name(name: str) -> tuple[str, str]:
    """A column's name in lower case without its unit, and that unit."""
    text = name.strip().lower()
    if match := re.fullmatch(r"(.+?)\s*[\[(]\s*([^\])0-9][^\])]*)[\])]", text):
        return match[1].strip(), match[2].strip()
    for ending, meant in _ENDINGS.items():
        if text.endswith(f"_{ending}"):
            return text.removesuffix(f"_{ending}"), meant
    return text, ""


def found_axes(table: Table, group: str) -> tuple[str, ...]:
    """The columns of the axes x, y, z of ``"gyro"`` or ``"accel"``, by their names; empty where there are none."""
    bare = {name: bare_name(name)[0] for name in table.columns}
    for axes in _AXES:
        for pattern in (rf"{_NAMES[group]}({{}})\]?", rf"({{}})_?{_NAMES[group]}"):
            found = [[n for n, text in bare.items() if re.fullmatch(pattern.format(axis), text)] for axis in axes]
            if all(found):
                return tuple(names[0] for names in found)
    return ()


def size_of_axes(table: Table, group: str, names: Sequence[str]) -> str:
    """The unit of axes: as their names say, of accelerometers by gravity, of gyros by how fast they turn."""
    told = table.units.get(names[0], "") or bare_name(names[0])[1]
    if told:
        return told
    values = [table.numbers(name)[0] for name in names]
    if group == "accel":
        length = float(np.sqrt(sum(float(np.nanmedian(value)) ** 2 for value in values)))
        return min(SIZES, key=lambda one: abs(np.log(max(length, 1e-9) / one[1])))[0]
    return "deg/s" if max(float(np.nanquantile(np.abs(value), 0.99)) for value in values) > _FAST_RAD_S else "rad/s"

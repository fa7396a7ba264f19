"""Units of somebody else's files and what they are in SI: the only table of its kind."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation.constants import STANDARD_GRAVITY


@dataclass(frozen=True)
class Unit:
    """A unit: value in SI = factor * (value - zero)."""

    dimension: str
    factor: float = 1.0
    zero: float = 0.0


_DEG = math.pi / 180.0

UNITS: dict[str, Unit] = {
    "": Unit("number"),
    "1": Unit("number"),
    "s": Unit("time"),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "ns": Unit("time", 1e-9),
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "day": Unit("time", 86400.0),
    "rad": Unit("angle"),
    "mrad": Unit("angle", 1e-3),
    "deg": Unit("angle", _DEG),
    "cdeg": Unit("angle", 1e-2 * _DEG),
    "gon": Unit("angle", 0.9 * _DEG),
    "degE7": Unit("angle", 1e-7 * _DEG),
    "ddmm": Unit("angle", _DEG),
    "arcmin": Unit("angle", _DEG / 60.0),
    "arcsec": Unit("angle", _DEG / 3600.0),
    "rev": Unit("angle", 2.0 * math.pi),
    "rad/s": Unit("angular rate"),
    "mrad/s": Unit("angular rate", 1e-3),
    "deg/s": Unit("angular rate", _DEG),
    "mdeg/s": Unit("angular rate", 1e-3 * _DEG),
    "deg/h": Unit("angular rate", _DEG / 3600.0),
    "rpm": Unit("angular rate", 2.0 * math.pi / 60.0),
    "m": Unit("length"),
    "mm": Unit("length", 1e-3),
    "cm": Unit("length", 1e-2),
    "km": Unit("length", 1e3),
    "ft": Unit("length", 0.3048),
    "nmi": Unit("length", 1852.0),
    "m/s": Unit("speed"),
    "mm/s": Unit("speed", 1e-3),
    "cm/s": Unit("speed", 1e-2),
    "km/h": Unit("speed", 1.0 / 3.6),
    "kn": Unit("speed", 1852.0 / 3600.0),
    "ft/s": Unit("speed", 0.3048),
    "m/s^2": Unit("acceleration"),
    "g": Unit("acceleration", STANDARD_GRAVITY),
    "mg": Unit("acceleration", 1e-3 * STANDARD_GRAVITY),
    "ug": Unit("acceleration", 1e-6 * STANDARD_GRAVITY),
    "T": Unit("magnetic field"),
    "uT": Unit("magnetic field", 1e-6),
    "nT": Unit("magnetic field", 1e-9),
    "gauss": Unit("magnetic field", 1e-4),
    "mgauss": Unit("magnetic field", 1e-7),
    "Pa": Unit("pressure"),
    "hPa": Unit("pressure", 1e2),
    "kPa": Unit("pressure", 1e3),
    "mbar": Unit("pressure", 1e2),
    "bar": Unit("pressure", 1e5),
    "dbar": Unit("pressure", 1e4),
    "psi": Unit("pressure", 6894.757293168),
    "degC": Unit("temperature"),
    "cdegC": Unit("temperature", 1e-2),
    "K": Unit("temperature", 1.0, 273.15),
    "degF": Unit("temperature", 5.0 / 9.0, 32.0),
}

#: Other ways in which files and data sheets write them.
ALIASES = {
    "count": "1",
    "counts": "1",
    "LSB": "1",
    "sec": "s",
    "ddmm.mmmm": "ddmm",
    "dddmm.mmmm": "ddmm",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "grad": "gon",
    "rad/sec": "rad/s",
    "dps": "deg/s",
    "deg/sec": "deg/s",
    "mdps": "mdeg/s",
    "dph": "deg/h",
    "deg/hr": "deg/h",
    "kt": "kn",
    "kts": "kn",
    "knot": "kn",
    "knots": "kn",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
    "m/s²": "m/s^2",
    "m/s**2": "m/s^2",
    "G": "gauss",
    "Gauss": "gauss",
    "mG": "mgauss",
    "µs": "us",
    "µT": "uT",
    "°": "deg",
    "°/s": "deg/s",
    "°/h": "deg/h",
    "C": "degC",
    "°C": "degC",
}


def unit(name: str) -> Unit:
    """Look up a unit by its name.

    Raises
    ------
    ValueError
        For an unknown unit; the message lists the known ones and their other names.

    Examples
    --------
    >>> round(unit("deg/s").factor, 6)
    0.017453
    """
    key = ALIASES.get(name.strip(), name.strip())
    if key not in UNITS:
        known, also = ", ".join(k for k in UNITS if k), ", ".join(ALIASES)
        raise ValueError(f'unknown unit "{name}" (known: {known}; also: {also})')
    return UNITS[key]


def angles(cells: Any, name: str) -> NDArray[np.float64]:
    """Numbers of a column of angles in its unit, those of ``ddmm`` (degrees and minutes in one number) in degrees.

    A letter for the half of the Earth gives the sign (``4530.2012N``, ``S 33 51.5``); minutes and seconds may follow
    degrees. What is none of this, has 60 minutes or more, or a minus before N or E, is NaN.

    Parameters
    ----------
    cells : array_like, shape (n,)
        Numbers or texts.
    name : str
        The unit.

    Examples
    --------
    >>> angles(np.array(["4530.0N", "01335.4W"], dtype=object), "ddmm").round(6).tolist()
    [45.5, -13.59]
    >>> angles(np.array(["12 30 36 S", "-12.51"], dtype=object), "deg").tolist()
    [-12.51, -12.51]
    """
    import pandas as pd

    cells = np.asarray(cells)
    if cells.dtype.kind in "OUT":
        parts = pd.Series(cells).astype(str).str.strip().str.extract(_ANGLE)
        numbers = parts[["degrees", "minutes", "seconds"]].apply(pd.to_numeric, errors="coerce").to_numpy(float)
        letter = parts["before"].fillna(parts["after"]).str.upper()
        rest = np.nan_to_num(numbers[:, 1]) / 60.0 + np.nan_to_num(numbers[:, 2]) / 3600.0
        minus, letters = parts["sign"] == "-", letter.isin(["S", "W"])
        bad = (np.nan_to_num(numbers[:, 1:]) >= 60.0).any(axis=1) | (parts["before"].notna() & parts["after"].notna())
        bad |= (minus & letter.isin(["N", "E"])).to_numpy()  # the one says north, the other south
        south = (letters | minus).to_numpy()
        size = np.where(bad, np.nan, numbers[:, 0])
    else:
        numbers_only = cells.astype(np.float64)
        size, south, rest = np.abs(numbers_only), np.signbit(numbers_only), 0.0
    if unit(name) is UNITS["ddmm"]:
        whole = np.floor(size / 100.0)
        minutes = size - 100.0 * whole
        size = np.where(minutes < 60.0, whole + minutes / 60.0, np.nan)
    return np.asarray(np.where(south, -1.0, 1.0) * (size + rest))


#: An angle as text: a letter, degrees, perhaps minutes and seconds, a letter.
_ANGLE = (
    r"^(?P<before>[NSEWnsew])?\s*(?P<sign>[-+])?(?P<degrees>\d+(?:\.\d*)?)[°d]?"
    r"(?:[\s:]*(?P<minutes>\d+(?:\.\d*)?)['′m]?(?:[\s:]*(?P<seconds>\d+(?:\.\d*)?)(?:[\"″s]|'')?)?)?\s*(?P<after>[NSEWnsew])?$"
)


def parse_quantity(text: str) -> tuple[float, Unit]:
    """Split ``"90 deg"`` into its number and its unit.

    Examples
    --------
    >>> parse_quantity("90 deg")[0]
    90.0
    """
    number, _, name = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        raise ValueError(f'"{text}" is not a number with a unit such as "90 deg"') from None
    return value, unit(name)


#: Endings of keys in a vehicle.toml -> factor to SI: ``sd_deg``, ``density_ug_per_sqrt_hz``, ``sd_cm``.
SUFFIXES: dict[str, float] = {
    "deg": _DEG,
    "deg_per_s": _DEG,
    "deg_per_h": _DEG / 3600.0,
    "deg_per_sqrt_h": _DEG / 60.0,
    "deg_per_s_per_sqrt_hz": _DEG,
    "deg_per_h_per_sqrt_h": _DEG / 3600.0 / 60.0,
    "mg": 1e-3 * STANDARD_GRAVITY,
    "ug": 1e-6 * STANDARD_GRAVITY,
    "mg_per_sqrt_hz": 1e-3 * STANDARD_GRAVITY,
    "ug_per_sqrt_hz": 1e-6 * STANDARD_GRAVITY,
    "m_per_s_per_sqrt_h": 1.0 / 60.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "cm_per_s": 1e-2,
    "mm_per_s": 1e-3,
}

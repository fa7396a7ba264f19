"""Units of somebody else's files and what they are in SI: the only table of its kind."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.foundation.constants import STANDARD_GRAVITY


@dataclass(frozen=True)
class Unit:
    """A unit: value in SI = factor * (value - zero)."""

    dimension: str
    factor: float = 1.0
    zero: float = 0.0


_DEG = math.pi / 180.0

#: Value in SI of one of each, by what they are units of.
_SIZES: dict[str, dict[str, float]] = {
    "number": {"": 1.0, "1": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0},
    "angle": {
        "rad": 1.0, "mrad": 1e-3, "deg": _DEG, "cdeg": 1e-2 * _DEG, "gon": 0.9 * _DEG, "degE7": 1e-7 * _DEG,
        "ddmm": _DEG, "arcmin": _DEG / 60.0, "arcsec": _DEG / 3600.0, "rev": 2.0 * math.pi,
    },
    "angular rate": {
        "rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "mdeg/s": 1e-3 * _DEG, "deg/h": _DEG / 3600.0,
        "rpm": 2.0 * math.pi / 60.0,
    },
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "nmi": 1852.0},
    "speed": {
        "m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6, "kn": 1852.0 / 3600.0, "ft/s": 0.3048,
    },
    "acceleration": {
        "m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "ug": 1e-6 * STANDARD_GRAVITY,
    },
    "magnetic field": {"T": 1.0, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "mgauss": 1e-7},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "mbar": 1e2, "bar": 1e5, "dbar": 1e4, "psi": 6894.757293168,
    },
    "temperature": {"degC": 1.0, "cdegC": 1e-2},
}  # fmt: skip
UNITS = {name: Unit(of, factor) for of, sizes in _SIZES.items() for name, factor in sizes.items()}
UNITS |= {"K": Unit("temperature", 1.0, 273.15), "degF": Unit("temperature", 5.0 / 9.0, 32.0)}

#: Other ways in which files and data sheets write them.
_SPELLINGS = (
    ("1", "count counts LSB"), ("s", "sec"), ("ddmm", "ddmm.mmmm dddmm.mmmm"), ("rad", "radian radians"),
    ("deg", "degree degrees"), ("gon", "grad"), ("rad/s", "rad/sec"), ("deg/s", "dps deg/sec"), ("mdeg/s", "mdps"),
    ("deg/h", "dph deg/hr"), ("kn", "kt kts knot knots"), ("m/s^2", "m/s2 m/s/s m/s² m/s**2"), ("gauss", "G Gauss"),
    ("mgauss", "mG"), ("us", "µs"), ("uT", "µT"), ("deg", "°"), ("deg/s", "°/s"), ("deg/h", "°/h"), ("degC", "C °C"),
)  # fmt: skip
ALIASES = {spelling: name for name, spellings in _SPELLINGS for spelling in spellings.split()}


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


def angles(cells: Any, name: str) -> Array:
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

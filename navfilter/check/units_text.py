"""Numbers in the units people think in: degrees, degrees per hour, milli-g, centimetres."""

import math

from navfilter.foundation.constants import MILLI_G, ROOT_HOUR

_DEG = math.pi / 180.0
#: SI unit of a channel -> the units to write it in, the largest first: name, size in SI.
_SCALES: dict[str, tuple[tuple[str, float], ...]] = {
    "rad": (("deg", _DEG),),
    "rad_s": (("deg/s", _DEG), ("deg/h", _DEG / 3600.0)),
    "m_s2": (("m/s^2", 1.0), ("mg", MILLI_G), ("ug", 1e-3 * MILLI_G)),
    "m_s": (("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)),
    "m": (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)),
    "1": (("%", 1e-2),),
    "rad_per_k": (("deg/K", _DEG),),
}


def amount(value: float, unit: str) -> str:
    """A quantity in the largest unit in which it is at least 0.1.

    Parameters
    ----------
    value : float
        In SI.
    unit : str
        As in `Layout.units`; one that is not known is written as it is.

    Examples
    --------
    >>> amount(0.0105, "rad"), amount(2.4e-5, "rad_s"), amount(0.012, "m_s")
    ('0.602 deg', '4.95 deg/h', '1.2 cm/s')
    """
    name, size = _scale(value, unit)
    return f"{value / size:.3g} {name}"


def with_sd(value: float, sd: float, unit: str) -> str:
    """A quantity and its standard deviation in one unit, both to the second figure of the sd.

    Examples
    --------
    >>> with_sd(0.1852, 0.0127, "m"), with_sd(-0.02, 0.3, "m"), with_sd(0.0, 0.2, "s")
    ('18.5 ± 1.3 cm', '-0.02 ± 0.30 m', '0.00 ± 0.20 s')
    """
    name, size = _scale(sd, unit)
    digits = max(0, 1 - math.floor(math.log10(sd / size))) if 0.0 < sd < math.inf else 3
    return f"{value / size:.{digits}f} ± {sd / size:.{digits}f} {name}"


def _scale(value: float, unit: str) -> tuple[str, float]:
    scales = _SCALES.get(unit, ((unit.replace("_per_", "/").replace("_", "/"), 1.0),))
    fitting = ((name, size) for name, size in scales if abs(value) >= 0.1 * size)
    return next(fitting, scales[-1] if value else scales[0])


def root_density(value: float, unit: str) -> str:
    """A root power spectral density [unit/sqrt(Hz)]: that of a gyro as angle random walk, the rest per root Hertz.

    Examples
    --------
    >>> root_density(8.727e-5, "rad_s"), root_density(9.8e-4, "m_s2")
    ('0.3 deg/sqrt(h)', '99.9 ug/sqrt(Hz)')
    """
    if unit == "rad_s":
        return f"{value / _DEG * ROOT_HOUR:.3g} deg/sqrt(h)"
    number, name = amount(value, unit).split(" ")
    return f"{number} {name}/sqrt(Hz)"


def walk(density: float, unit: str) -> str:
    """How far a random walk of this density [unit/s/sqrt(Hz)] gets in an hour."""
    return f"{amount(ROOT_HOUR * density, unit)} in an hour"


def duration(seconds: float) -> str:
    """A stretch of time.

    Examples
    --------
    >>> duration(0.25), duration(90.0), duration(7200.0), duration(1e6)
    ('0.25 s', '90 s', '2 h', '11.6 days')
    """
    for name, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"

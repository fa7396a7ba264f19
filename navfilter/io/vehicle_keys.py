"""The keys of a vehicle.toml: what a number of that name may be, and its spelling in another unit."""

import re
import types
import typing
from collections.abc import Iterable
from typing import Annotated, Any, Union

from pydantic import Field

from navfilter.io.units import SUFFIXES

#: Bounds in SI by the name of the key, first match counts. The outer ones are far beyond anything real: they keep
#: squares, inverses and exponentials of what a file says within the range of floating-point numbers.
_BOUNDS: tuple[tuple[str, dict[str, Any]], ...] = (
    (r"rate_hz$", {"ge": 1e-6, "le": 1e6}),
    (r"tau_s$", {"ge": 1e-6, "le": 1e12}),
    (r"timeout_s$", {"gt": 0, "le": 1e12}),
    (r"^gate_probability$", {"ge": 0.5, "lt": 1}),
    (r"^order$", {"ge": 1, "le": 4}),
    (r"^orders$", {"ge": 0, "le": 10}),
    (r"^(window|hop)$", {"ge": 1, "le": 1_000_000}),
    # A model with a unit root knows nothing of its spectrum at zero frequency.
    (r"^sd_log_s0$", {"ge": 0, "allow_inf_nan": True}),
    (r"^latitude_deg$", {"ge": -90, "le": 90}),
    (r"^max_|_max$", {"gt": 0, "le": 1e12}),
    (r"(^|_)(sd|density|pressure)(_|$)", {"ge": 0, "le": 1e12}),
    (r"", {"ge": -1e12, "le": 1e12}),
)
#: More coefficients than this no sensor has, and roots of longer polynomials are not to be had.
_MOST_COEFFICIENTS = 40
#: Names of the suffixes, the longest first: "deg_per_s" is no "s" behind "deg_per".
_LONGEST_FIRST = sorted(SUFFIXES, key=len, reverse=True)


def checked(hint: Any, name: str) -> Any:
    """The type of a field as a file must hold it: numbers are numbers (no text, no booleans), within the bounds of
    their name.

    Parameters
    ----------
    hint : type
        Of the field of the class.
    name : str
        Of the field.

    Returns
    -------
    type
        For pydantic.
    """
    if hint in (int, float):
        bounds = next(bounds for pattern, bounds in _BOUNDS if re.search(pattern, name))
        return Annotated[hint, Field(strict=True, **bounds)]
    if hint is bool:
        return Annotated[bool, Field(strict=True)]
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        of_any_length = Ellipsis in parts
        whole: Any = tuple[tuple(part if part is Ellipsis else checked(part, name) for part in parts)]  # type: ignore[misc]
        return Annotated[whole, Field(max_length=_MOST_COEFFICIENTS)] if of_any_length else whole
    if typing.get_origin(hint) in (Union, types.UnionType):
        return Union[tuple(checked(part, name) for part in parts)]  # noqa: UP007
    return hint


def plain_key(key: str, fields: Iterable[str]) -> tuple[str, float | None]:
    """The field that a key of a file means, and the factor that takes its value to SI (None: it is there already).

    Examples
    --------
    >>> plain_key("mounting_deg", {"mounting_rad"})[0]
    'mounting_rad'
    >>> plain_key("sd_cm", {"sd"}), plain_key("lever_arm_b_cm", {"lever_arm_b_m"})
    (('sd', 0.01), ('lever_arm_b_m', 0.01))
    >>> plain_key("current_sd_cm_per_s", {"current_sd_m_s"})
    ('current_sd_m_s', 0.01)
    """
    if key in fields:
        return key, None
    radians = re.sub(r"_deg(?=_|$)", "_rad", key)
    if radians in fields:
        return radians, SUFFIXES["deg"]
    for length in ("cm", "mm"):
        for ending, metres in ((length, "m"), (f"{length}_per_s", "m_s")):
            name = re.sub(rf"_{ending}$", f"_{metres}", key)
            if name != key and name in fields:
                return name, SUFFIXES[length]
    for suffix in _LONGEST_FIRST:
        name = key.removesuffix(f"_{suffix}")
        if name != key and name in fields:
            return name, SUFFIXES[suffix]
    return key, None


def constants(table: dict[str, tuple[float, float]]) -> tuple[tuple[str, float, float], ...]:
    """Calibrated constants of a file, ``{name = [value, sd]}``, as names, values and sds in SI.

    Examples
    --------
    >>> constants({"scale": (0.01, 0.001), "misalignment_z_deg": (180.0, 0.0)})
    (('scale', 0.01, 0.001), ('misalignment_z', 3.141592653589793, 0.0))
    """
    found = []
    for key, (value, sd) in table.items():
        suffix = next((s for s in _LONGEST_FIRST if key.endswith(f"_{s}")), None)
        factor = 1.0 if suffix is None else SUFFIXES[suffix]
        found.append((key if suffix is None else key.removesuffix(f"_{suffix}"), factor * value, factor * sd))
    return tuple(found)


def spellings(field: str) -> list[str]:
    """Every key by which a file may give a field, itself first."""
    other = [re.sub(r"_rad(?=_|$)", "_deg", field), *(re.sub("_m$", f"_{length}", field) for length in ("cm", "mm"))]
    other += [re.sub("_m_s$", f"_{length}_per_s", field) for length in ("cm", "mm")]
    return list(dict.fromkeys([field, *other, *(f"{field}_{suffix}" for suffix in SUFFIXES)]))


def times(value: Any, factor: float) -> Any:
    """A number, or every number of a list, times a factor; anything else stays what it is."""
    if isinstance(value, list):
        return [times(part, factor) for part in value]
    return value * factor if isinstance(value, int | float) and not isinstance(value, bool) else value

"""How far a run has told each constant, as a light: green, orange or red.

A constant is told where little of the doubt that vehicle.toml describes is left: green up to a limit, orange up to
twice that, red beyond. The limit is stated (`--limit`), or `LEFT` of the sd that is described.
"""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from navfilter.calibration.parts import Constant, kind_of
from navfilter.io.units import UNITS

#: Share of the described sd that may be left of a constant that is told, where no limit is stated. Twice as much is
#: what `navfilter calibrate` calls not told.
LEFT = 0.4
LIGHTS = ("green", "orange", "red")
#: SI units of constants -> the dimension of a unit that a limit may have.
_DIMENSIONS = {"rad": "angle", "s": "time", "m": "length", "1": "number", "T": "magnetic field"}
_DIMENSIONS |= {"m_s": "speed", "rad_s": "angular rate", "m_s2": "acceleration"}


class Light(NamedTuple):
    """A constant, how it was described, what a run found, and how far that is told.

    Attributes
    ----------
    name, unit : str
        Of its state.
    given, given_sd, value, sd : float
        As described and as found; of clocks and lever arms the whole of it.
    limit : float
        Up to this sd it is green.
    """

    name: str
    unit: str
    given: float
    given_sd: float
    value: float
    sd: float
    limit: float

    @property
    def colour(self) -> str:
        """One of `LIGHTS`."""
        return LIGHTS[(self.sd > self.limit) + (self.sd > 2.0 * self.limit)]

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        return {**{key: value for key, value in self._asdict().items() if key != "name"}, "light": self.colour}


def limit_of(text: str) -> tuple[str, float, str]:
    """What ``--limit`` says: a name, the sd in SI, and its dimension.

    Parameters
    ----------
    text : str
        ``NAME=NUMBER UNIT``: the name of a constant ("dvl.scale"), its ending ("misalignment_z", "misalignment"), or a
        kind of `navfilter calibrate` ("mounting").

    Raises
    ------
    ValueError
        When it is no such text.

    Examples
    --------
    >>> limit_of("dvl.scale=0.1%"), limit_of("clock = 20 ms")
    (('dvl.scale', 0.001, 'number'), ('clock', 0.02, 'time'))
    """
    found = re.fullmatch(r"\s*([\w.-]+)\s*=\s*([-+.\deE]+)\s*(\S*)\s*", text)
    if found is not None:
        name, number, unit = found.groups()
        factor, dimension = (0.01, "number") if unit == "%" else _unit(unit)
        if dimension and float(number) > 0.0:
            return name, float(number) * factor, dimension
    raise ValueError(
        f"--limit: '{text}' is not NAME=NUMBER UNIT. Examples: --limit mounting=0.2deg --limit dvl.scale=0.1%."
    )


def _unit(name: str) -> tuple[float, str]:
    unit = UNITS.get(name)
    return (1.0, "") if unit is None else (unit.factor, unit.dimension)


def lit(one: Constant, value: float, sd: float, limits: Sequence[tuple[str, float, str]] = ()) -> Light:
    """The light of a constant.

    Parameters
    ----------
    one : Constant
        As described.
    value, sd : float
        As found.
    limits : sequence of (str, float, str)
        As `limit_of` gives them; of several that fit the last holds.
    """
    limit = next((stated for name, stated, _ in reversed(limits) if _fits(name, one)), LEFT * one.sd)
    return Light(one.name, one.unit, one.value, one.sd, value, sd, limit)


def _fits(name: str, one: Constant) -> bool:
    return name in (one.name, one.own, kind_of(one.own)) or one.own.startswith(f"{name}_")


def check_limits(limits: Sequence[tuple[str, float, str]], there: Sequence[Constant]) -> None:
    """Raise ValueError for a limit that fits no constant, or one of another dimension."""
    for name, _, dimension in limits:
        fitting = [one for one in there if _fits(name, one)]
        for one in fitting:
            if _DIMENSIONS.get(one.unit, "") != dimension:
                raise ValueError(f"--limit {name}: {one.name} is no {dimension} (its unit is {one.unit}).")
        if not fitting:
            names = ", ".join(one.name for one in there) or "none: give one an sd in vehicle.toml"
            raise ValueError(f"--limit {name}: no constant is called so (constants: {names}).")

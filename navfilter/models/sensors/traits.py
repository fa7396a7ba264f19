"""The words in which a kind of sensor or drive states what files, checks and figures need to know of it."""

import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from navfilter.foundation.constants import STANDARD_GRAVITY

#: SI unit -> what people read it in, and the factor to it.
_SHOWN = {
    "rad": ("deg", 180.0 / math.pi),
    "rad_s": ("deg/h", 180.0 / math.pi * 3600.0),
    "rad_per_k": ("deg/K", 180.0 / math.pi),
    "m_s": ("m/s", 1.0),
    "m_s2": ("mg", 1e3 / STANDARD_GRAVITY),
    "1": ("%", 100.0),
}


def shown_unit(unit: str) -> tuple[str, float]:
    """What people read a quantity in, and its factor from SI.

    Parameters
    ----------
    unit : str
        As in the names of states and columns; one that is not known is shown as it is.

    Examples
    --------
    >>> shown_unit("m_s"), shown_unit("s")
    (('m/s', 1.0), ('s', 1.0))
    """
    return _SHOWN.get(unit, (unit, 1.0))


def kinds_below(base: type) -> Iterator[type]:
    """Every class below `base`, also those of a user's own, each before those below it."""
    cls: type
    for cls in base.__subclasses__():
        yield cls
        yield from kinds_below(cls)


def kind_name(kind: type) -> str:
    """A class by its name in files: ``body-velocity``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", kind.__name__).lower()


class Columns(NamedTuple):
    """Columns of a file that belong together.

    Attributes
    ----------
    group : str
        Their key in a mission.toml.
    names : tuple of str
        Of the columns, with their SI units.
    dimensions : tuple of str
        What each of them measures, as in `navfilter.io.units`: "length", "speed", "angle", "pressure", ...
    circular : tuple of str
        Those of the names that are angles on a whole circle: interpolated through the shorter way.
    least : int
        So many of them, from the first, must be given; 0: all.
    independent : bool
        Each is a reading of its own: an invalid one leaves the others valid.
    """

    group: str
    names: tuple[str, ...]
    dimensions: tuple[str, ...]
    circular: tuple[str, ...] = ()
    least: int = 0
    independent: bool = False


class Plausible(NamedTuple):
    """What is usual for one kind of channel, in SI: beyond it a number was probably meant in another unit.

    Attributes
    ----------
    least_sd, most_sd : float
        Of all errors together, of one part.
    suffix : str
        The unit in which a number that is too large was probably meant, as the suffix of a key.
    most_density : float
        Largest root PSD; infinite: judged by the sd of a reading.
    density_suffix : str
    most_rate_hz : float
    hint : str
        A cure for all, instead of one by the suffix.
    """

    least_sd: float
    most_sd: float
    suffix: str = ""
    most_density: float = math.inf
    density_suffix: str = ""
    most_rate_hz: float = 1000.0
    hint: str = ""


class Doubt(NamedTuple):
    """A field whose value was probably not meant so."""

    field: str
    text: str
    cure: str


def angle_doubt(field: str, value: float) -> Doubt:
    """That of an angle which is no angle in radians."""
    degrees = field.replace("_rad", "_deg")
    cure = f"If {value:.4g} deg is meant, write {degrees}, in degrees."
    return Doubt(field, f"{value:.4g} rad are {math.degrees(value):.4g} deg.", cure)


class Example(NamedTuple):
    """How a kind stands in a vehicle.toml to start from.

    Attributes
    ----------
    name : str
        Of the sensor.
    words : str
    rate_hz : float
    lines : sequence of str
        What is set, as lines of the file, or words about it.
    lever_arm : sequence of float
        Its `lever_arm_b_m`; none where it has no such field.
    live : bool
        False: the whole table is there to be uncommented.
    """

    name: str
    words: str
    rate_hz: float
    lines: Sequence[str]
    lever_arm: Sequence[float] | None = None
    live: bool = True


#: Those of the kinds that are there, by their names.
EXAMPLES = {
    name: Example(name, **given)
    for name, given in tomllib.loads(Path(__file__).with_name("examples.toml").read_text(encoding="utf-8")).items()
}

"""Instructions for a part of a mission: a sensor off, its noise larger, other keys of its description."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from navfilter.models.sensors import Sensor

_ALIAS = re.compile(r".+@\d+")


def alias(name: str, number: int) -> str:
    """What a sensor is called for a time in which it is described otherwise."""
    return f"{name}@{number}"


def is_alias(name: str) -> bool:
    """Whether a sensor stands for another one for a time."""
    return _ALIAS.fullmatch(name) is not None


def same_sensor(name: str, names: Iterable[str]) -> list[str]:
    """Of these names those that one instrument has, one after the other, where this is its own; none for an alias.

    The instrument is silent where none of them is heard, and only its own name says so.
    """
    return [] if is_alias(name) else [each for each in names if instrument(each) == name]


def instrument(name: str) -> str:
    """The own name of a sensor, whatever it is called for a time."""
    return name.rpartition("@")[0] if is_alias(name) else name


def shared(one: Sensor, other: Sensor) -> list[str]:
    """Names of the parameters that two descriptions of an instrument have in common: they say the same of them."""
    theirs = set(other.all_parameters())
    mine = (p for p in one.all_parameters() if p in theirs)
    return [p.name for p in mine if one.nominal(p.name) == other.nominal(p.name)]


@dataclass(frozen=True)
class During:
    """One instruction.

    Attributes
    ----------
    sensor : str
        Its stream.
    from_s, to_s : float
        From when to when, on the mission clock [s]; infinite: to the beginning or the end.
    off : bool
        Its readings are left out.
    noise : float
        The sds of its error model are so many times as large [1].
    keys : dict
        Keys of its table in the vehicle.toml, as they stand in a file, with other values.
    why : str
        For notes and report.
    """

    sensor: str
    from_s: float = -math.inf
    to_s: float = math.inf
    off: bool = False
    noise: float = 1.0
    keys: Mapping[str, Any] = field(default_factory=dict)
    why: str = ""

    def __str__(self) -> str:
        begin = "the beginning" if math.isinf(self.from_s) else f"{self.from_s:g}"
        end = "the end" if math.isinf(self.to_s) else f"{self.to_s:g} s"
        what = ["off"] * self.off + [f"noise x {self.noise:g}"] * (self.noise != 1.0)
        what += [f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in self.keys.items()]
        return f"{self.sensor} from {begin} to {end}: {', '.join(what)}{f' ({self.why})' if self.why else ''}"

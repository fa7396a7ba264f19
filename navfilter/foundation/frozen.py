"""Descriptions as values: taken as users type them, with lists, arrays and numbers of NumPy or pandas, and shown as
they are typed in.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from navfilter.foundation.arguments import short
from navfilter.foundation.display import same


class FrozenDescription:
    """A description: a frozen dataclass of numbers, text, other descriptions and tuples of them.

    Its ``__post_init__`` makes of each field what the others rely on, so a subclass with one of its own calls it first:
    sequences become tuples, what NumPy holds becomes plain numbers. Then descriptions compare, hash and print alike,
    whoever has made them of what.

    Raises
    ------
    ValueError
        For a field of numbers that holds something else.
    """

    def __init_subclass__(cls) -> None:
        # before `dataclass` looks whether there is one: users' own kinds have it, too
        if "__repr__" not in vars(cls):
            cls.__repr__ = typed  # type: ignore[method-assign]

    def __post_init__(self) -> None:
        kinds: Any = type(self)
        for name, kind, optional in _kinds(kinds):
            value = getattr(self, name)
            if type(value) not in _PLAIN:
                value = _settled(value)
                object.__setattr__(self, name, value)
            if kind and type(value) is not kind and not (optional and value is None):
                object.__setattr__(self, name, _number(f"{type(self).__name__}.{name}", value, kind))


#: What stays as it is.
_PLAIN = (float, int, bool, str, type(None))
#: Fields of one number, by what is stated of them.
_NUMBERS: dict[str, type] = {"float": float, "int": int, "bool": bool}


@functools.cache
def _kinds(cls: Any) -> tuple[tuple[str, type | None, bool], ...]:
    """The fields of a class, which kind of number stands there (None where it may be something else), and whether that
    may be left out.
    """
    found = []
    for f in dataclasses.fields(cls):
        stated = f.type if isinstance(f.type, str) else getattr(f.type, "__name__", str(f.type))
        found.append((f.name, _NUMBERS.get(stated.removesuffix(" | None")), stated.endswith("None")))
    return tuple(found)


def _settled(value: Any) -> Any:
    """Sequences as tuples, numbers of NumPy and arrays of one as plain numbers; all else as it is."""
    if hasattr(value, "to_numpy"):
        value = value.to_numpy()
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in "mM":  # dates are no numbers
        value = value.tolist()
    return tuple(map(_settled, value)) if isinstance(value, list) or type(value) is tuple else value


def _number(owner: str, value: Any, kind: type) -> Any:
    """One number of a kind."""
    if kind is float and type(value) is int:
        return value
    if kind is int and isinstance(value, float) and value.is_integer():
        return int(value)
    if kind is bool and isinstance(value, int | float) and value in (0, 1):
        return bool(value)
    words = {float: "a number", int: "a whole number", bool: "True or False"}[kind]
    raise ValueError(f"{owner} must be {words}, found {short(value)}.")


def typed(value: Any) -> str:
    """A value as it is typed in, without what is at its default or takes no part in comparisons: what is made of it
    again is equal.

    Examples
    --------
    >>> from navfilter import Heading, White
    >>> Heading(rate_hz=8, error=White(sd=np.float64(0.01)), gate_timeout_s=np.inf)
    Heading(rate_hz=8, error=White(sd=0.01), gate_timeout_s=float("inf"))
    """
    if isinstance(value, np.ndarray | np.generic):
        return typed(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    if isinstance(value, tuple) and type(value) is tuple:
        return f"({', '.join(map(typed, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, list):
        return f"[{', '.join(map(typed, value))}]"
    if isinstance(value, frozenset):  # the order of its members is another one in each process
        return f"frozenset({{{', '.join(sorted(map(typed, value)))}}})" if value else "frozenset()"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{typed(key)}: {typed(part)}' for key, part in value.items())}}}"
    if isinstance(value, FrozenDescription) and type(value).__repr__ is typed and dataclasses.is_dataclass(value):
        fields = [f for f in dataclasses.fields(value) if f.init and f.compare and not _default(value, f)]
        return f"{type(value).__name__}({', '.join(f'{f.name}={typed(getattr(value, f.name))}' for f in fields)})"
    return repr(value)


def _default(value: object, field: dataclasses.Field[Any]) -> bool:
    made = field.default_factory
    return same(getattr(value, field.name), field.default if made is dataclasses.MISSING else made())

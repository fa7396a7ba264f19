"""State as values: what a part remembers is one dataclass of arrays and plain numbers, copied and stored by the
functions here.

Conventions. A class that is not frozen holds what changes; its arrays, lists and dicts are copied with it. What cannot
change is shared between copies: numbers, strings, tuples, frozen dataclasses. Fields that a class names in `SHARED` are
append-only storage that a cursor beside them bounds (a ring of samples, the inputs of the first minutes): copies share
them, and going back moves the cursor only.
"""

import dataclasses
import datetime
import functools
import json
import math
import types
from collections.abc import Callable, Iterable
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation.arrays import Array, Ints

T = TypeVar("T")

#: What fields are stated to hold whose own `copy` is a whole one.
_FLAT = (Array, Ints, dict[str, int], dict[str, tuple[float, ...]])


class _Copiers(dict[type, Callable[[Any], Any] | None]):
    """How values of a class are copied; None for classes whose values cannot change and are shared."""

    def __missing__(self, kind: type) -> Callable[[Any], Any] | None:
        own = self[kind] = _state_copier(kind) if _is_state(kind) else None
        return own


def _is_state(kind: type) -> bool:
    """Whether it is a dataclass that can change."""
    return dataclasses.is_dataclass(kind) and not kind.__dataclass_params__.frozen  # type: ignore[attr-defined]


def _state_copier(kind: type) -> Callable[[Any], Any]:
    shared = getattr(kind, "SHARED", ())
    own = {name: stated for name, stated in _stated(kind).items() if name not in shared and not _rests(stated)}
    flat = tuple(name for name, stated in own.items() if stated in _FLAT)
    nested = tuple(name for name in own if name not in flat)

    def copy(value: Any) -> Any:
        # ten times a second on board: all fields at once, then those that are not shared
        new: Any = object.__new__(kind)
        new.__dict__ = fields = dict(value.__dict__)
        for name in flat:
            fields[name] = fields[name].copy()
        for name in nested:
            item = fields[name]
            copier = _COPIERS[type(item)]
            if copier is not None:
                fields[name] = copier(item)
        return new

    return copy


@functools.cache
def _stated(kind: Any) -> dict[str, Any]:
    """What the fields of a dataclass are stated to hold."""
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in dataclasses.fields(kind)}


def _choices(stated: Any) -> tuple[Any, ...]:
    return get_args(stated) if isinstance(stated, types.UnionType) else (stated,)


def _rests(stated: Any) -> bool:
    """Whether a field, by what is stated of it, holds what cannot change: numbers, tuples, frozen values."""
    known: list[Any] = [one for one in _choices(stated) if one not in _PLAIN]
    return get_origin(stated) is tuple or all(_has_fields(one) and not _is_state(one) for one in known)


def _copied_dict(value: dict[Any, Any]) -> dict[Any, Any]:
    new = dict(value)
    for key, item in new.items():
        own = _COPIERS[type(item)]
        if own is not None:
            new[key] = own(item)
    return new


_COPIERS = _Copiers()
_COPIERS[np.ndarray] = np.ndarray.copy
_COPIERS[dict] = _copied_dict
_COPIERS[list] = lambda value: [copied(item) for item in value]


def copied(value: T) -> T:
    """A copy that shares nothing that changes with the original.

    Examples
    --------
    >>> before = {"x": np.zeros(2), "models": ("a", "b")}
    >>> after = copied(before)
    >>> after["x"][0] = 1.0
    >>> float(before["x"][0]), after["models"] is before["models"]
    (0.0, True)
    """
    own = _COPIERS[type(value)]
    return value if own is None else own(value)


def misfit(value: Any, like: Any, where: str = "state") -> str | None:
    """Where a value that came from outside has not the form of one made here, in words; None when it fits.

    The form is the class and the shape of arrays: kernels read memory by it. Lists may have any length; None fits
    everything that is None or a frozen value.
    """
    if isinstance(like, np.ndarray):
        if isinstance(value, np.ndarray) and value.shape == like.shape and value.dtype == like.dtype:
            return None
        found = f"shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        return f"{where} must be an array of shape {like.shape}, found {found}"
    if _is_state(type(like)):
        if type(value) is not type(like):
            return f"{where} must be a {type(like).__name__}, found {type(value).__name__}"
        kind: Any = type(like)
        for name, stated in _stated(kind).items():
            own, place = getattr(value, name), f"{where}.{name}"
            problem = misfit(own, getattr(like, name), place) or _misnamed(own, stated, place)
            if problem:
                return problem
        return None
    if isinstance(like, dict) and any(isinstance(v, np.ndarray) or _is_state(type(v)) for v in like.values()):
        if not isinstance(value, dict) or value.keys() != like.keys():
            return f"{where} must have the entries {', '.join(map(str, like))}"
        return next((m for key in like if (m := misfit(value[key], like[key], f"{where}[{key!r}]"))), None)
    number = isinstance(like, int | float) and not isinstance(like, bool)
    if number and (isinstance(value, bool) or not isinstance(value, int if isinstance(like, int) else int | float)):
        return f"{where} must be a number, found {value!r}"
    return None


def _misnamed(value: Any, stated: Any, where: str) -> str | None:
    """Where a field that is stated to hold values of certain classes, or None, holds something else; and so on in the
    fields of such a value. What is stated in other words may be anything.
    """
    classes = _choices(stated)
    if not all(known in _PLAIN or dataclasses.is_dataclass(known) for known in classes):
        return None
    if not any(type(value) in _PLAIN.get(known, (known,)) for known in classes):
        names = ("None" if known is type(None) else known.__name__ for known in classes)
        return f"{where} must be {' or '.join(names)}, found {type(value).__name__}"
    if not dataclasses.is_dataclass(value) or _is_state(type(value)):
        return None
    kind: Any = type(value)
    own = ((name, one, getattr(value, name)) for name, one in _stated(kind).items())
    return next((m for name, one, v in own if (m := _misnamed(v, one, f"{where}.{name}"))), None)


#: What a value stated to be one of these may be.
_PLAIN: dict[Any, tuple[type, ...]] = {kind: (kind,) for kind in (int, bool, str, type(None))} | {float: (float, int)}


# ---------------------------------------------------------------- to arrays and back


def to_arrays(value: Any) -> dict[str, NDArray[Any]]:
    """A state as three arrays: "meta" (JSON as bytes), "floats" and "integers", which hold the elements of all its
    arrays.
    """
    elements: dict[str, list[NDArray[Any]]] = {"floats": [], "integers": []}
    sizes = {"floats": 0, "integers": 0}

    def plain(v: Any) -> Any:
        if v is None or isinstance(v, bool | int | float | str):
            return v
        if isinstance(v, np.ndarray):
            key = "integers" if v.dtype.kind in "iub" else "floats"
            elements[key].append(v.ravel())
            at, sizes[key] = sizes[key], sizes[key] + v.size
            return {"": key, "at": at, "shape": list(v.shape)}
        if isinstance(v, np.integer | np.floating):
            return v.item()
        if isinstance(v, bytes):
            return {"": "bytes", "hex": v.hex()}
        if isinstance(v, datetime.date):
            return {"": "date", "day": v.isoformat()}
        if isinstance(v, frozenset):
            return {"": "set", "items": sorted(v)}
        if isinstance(v, dict):
            return {"": "dict", "items": [[plain(key), plain(item)] for key, item in v.items()]}
        if _has_fields(type(v)):
            names = getattr(v, "_fields", None) or [f.name for f in dataclasses.fields(v)]
            return {"": type(v).__name__, "fields": {name: plain(getattr(v, name)) for name in names}}
        if isinstance(v, tuple):
            return {"": "tuple", "items": [plain(item) for item in v]}
        if isinstance(v, list):
            return [plain(item) for item in v]
        raise ValueError(
            f"a {type(v).__name__} cannot be stored with the state: use a dataclass of numbers, arrays and texts."
        )

    meta = json.dumps(plain(value)).encode()
    return {
        "meta": np.frombuffer(meta, dtype=np.uint8),
        "floats": np.concatenate([np.zeros(0), *elements["floats"]]),
        "integers": np.concatenate([np.zeros(0, np.int64), *elements["integers"]]),
    }


def _classes_held(kind: type) -> list[type]:
    """Classes with fields that fields of a class are said to hold, be it in tuples, lists or dictionaries."""
    hints = list(get_type_hints(kind).values()) if _has_fields(kind) else []
    found = []
    while hints:
        hint = hints.pop()
        hints += get_args(hint)
        found += [hint] * (isinstance(hint, type) and _has_fields(hint))
    return found


def _has_fields(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) or hasattr(kind, "_fields")


def from_arrays(arrays: dict[str, NDArray[Any]], kinds: Iterable[type]) -> Any:
    """The inverse of `to_arrays`.

    Parameters
    ----------
    arrays : dict
        As `to_arrays` made it.
    kinds : iterable of class
        Classes that may be made from it, with all their subclasses that have been imported, and with the classes that
        their fields are said to hold.

    Raises
    ------
    ValueError
        For a class that is not known, or a value that its class refuses.
    """
    known: dict[str, type] = {}
    queue = list(kinds)
    while queue:
        kind = queue.pop()
        if known.get(kind.__name__) is not kind:
            known[kind.__name__] = kind
            queue += [*kind.__subclasses__(), *_classes_held(kind)]

    # each element stands for one place of the state: what refers to them again and again would be larger than the file
    left = {kind: arrays[kind].size for kind in ("floats", "integers")}

    def value(v: Any) -> Any:
        if isinstance(v, list):
            return [value(item) for item in v]
        if not isinstance(v, dict):
            return v
        kind = v[""]
        if kind in ("floats", "integers"):
            shape = tuple(int(n) for n in v["shape"])
            left[kind] -= math.prod(shape)
            if min(shape, default=0) < 0 or left[kind] < 0:
                raise ValueError(f"it has more {kind} than it holds")
            part = arrays[kind][v["at"] : v["at"] + math.prod(shape)]
            return np.array(part, dtype=np.float64 if kind == "floats" else np.int64).reshape(shape)
        if kind == "bytes":
            return bytes.fromhex(v["hex"])
        if kind == "date":
            return datetime.date.fromisoformat(v["day"])
        if kind == "set":
            return frozenset(v["items"])
        if kind == "dict":
            return {value(key): value(item) for key, item in v["items"]}
        if kind == "tuple":
            return tuple(value(item) for item in v["items"])
        if kind not in known:
            raise ValueError(
                f'it holds a "{kind}", and no class of that name is known. Import the module that defines it first'
            )
        return known[kind](**{name: value(item) for name, item in v["fields"].items()})

    return value(json.loads(arrays["meta"].tobytes()))

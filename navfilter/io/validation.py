"""Strict models for .toml files, and their errors in words: every mistake at once, with place, value and cure."""

import difflib
import math
import tomllib
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from navfilter.foundation.quoting import toml_key, toml_literal


class Strict(BaseModel):
    """A table in which every key must be known."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)

    #: Whether the table holds one value for each axis (see `SHAPES`).
    per_axis: ClassVar[bool] = False

    @classmethod
    def spellings(cls, field: str) -> list[str]:
        """The keys by which a file may give a field, itself first."""
        return [field]


Model = TypeVar("Model", bound=Strict)
Item = TypeVar("Item")


def at_least_one(said: str) -> Callable[[tuple[Item, ...]], tuple[Item, ...]]:
    """A check of a list that may not be empty, and what it says. pydantic's own, ``min_length``, speaks beside every
    mistake inside the one that there is.
    """

    def check(value: tuple[Item, ...]) -> tuple[Item, ...]:
        if not value:
            raise ValueError(said)
        return value

    return check


#: Tags with which a model tells alternatives of different shape apart; they are no part of a place in the file.
SHAPES = ("<one>", "<sensor>", "<sum>", "<axes>")
#: What pydantic finds wrong -> what to write instead.
_CURES = {
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "finite_number": "must be a finite number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text in quotes",
    "dict_type": "must be a table, such as [section] or {key = value}",
    "model_type": "must be a table, such as [section] or {key = value}",
    "model_attributes_type": "must be a table, such as [section] or {key = value}",
    "list_type": "must be a list, such as [1.0, 2.0]",
    "tuple_type": "must be a list, such as [1.0, 2.0]",
    "date_type": "must be a date, such as 2026-06-01",
    "date_from_datetime_inexact": "must be a date without a time, such as 2026-06-01",
    "date_from_datetime_parsing": "must be a date, such as 2026-06-01",
    "date_parsing": "must be a date, such as 2026-06-01",
}
_BOUNDS = {"greater_than": ">", "greater_than_equal": ">=", "less_than": "<", "less_than_equal": "<="}
_TOML_INTEGER = 2**63


#: No description of a vehicle or a mission is larger [bytes]; a device that never ends is.
_LARGEST = 16 << 20


def bounded_text(path: Path) -> str:
    """Text of a file that somebody wrote by hand.

    Raises
    ------
    OSError
        When it cannot be read.
    ValueError
        When it is too large to be one, or no UTF-8.
    """
    with path.open("rb") as file:
        data = file.read(_LARGEST + 1)
    if len(data) > _LARGEST:
        raise ValueError(f"{path} is larger than {_LARGEST >> 20} MiB: that is no description. Give the right file.")
    return data.decode("utf-8-sig")


def read_toml(path: Path, error: type[ValueError]) -> dict[str, Any]:
    """Parse a .toml file; whatever is wrong with it becomes one line of type `error`."""
    try:
        text = bounded_text(path)
    except FileNotFoundError:
        raise error(f"{path}: no such file.") from None
    except UnicodeDecodeError as reason:
        raise error(f"{path} cannot be read: {reason}.") from None
    except OSError as reason:
        raise error(f"{path} cannot be read: {reason.strerror or reason}.") from None
    except ValueError as reason:
        raise error(str(reason)) from None
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise error(f"{path} is not valid TOML: tables or lists are nested too deeply.") from None
    except ValueError as reason:  # of tomllib, or of a number with thousands of digits
        raise error(f"{path} is not valid TOML: {reason}.") from None
    large = next(_beyond_64_bit(data, ""), None)
    if large is not None:
        raise error(f"{path}: {large}: whole numbers of TOML have 64 bit; write a number this large as 1e20.")
    return data


def _beyond_64_bit(value: Any, place: str) -> Iterator[str]:
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _beyond_64_bit(part, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for k, part in enumerate(value):
            yield from _beyond_64_bit(part, f"{place}[{k}]")
    elif isinstance(value, int) and not -_TOML_INTEGER <= value < _TOML_INTEGER:
        yield place


def inside(mistakes: Iterable[tuple[str, str]]) -> PydanticCustomError:
    """An error for a validator to raise: several mistakes, each with its place below the table that is validated.

    Parameters
    ----------
    mistakes : iterable of (str, str)
        Place, such as ``".error[0]"`` (empty: the table itself), and what is wrong there.
    """
    return PydanticCustomError("inside", "mistakes inside", {"mistakes": list(mistakes)})


def listed(path: Path, mistakes: list[str], error: type[ValueError]) -> ValueError:
    """One error of all mistakes: one line when there is one, else one line each."""
    mistakes = list(dict.fromkeys(mistakes))
    if len(mistakes) == 1:
        return error(f"{path}: {mistakes[0]}")
    return error(f"{path}: {len(mistakes)} mistakes:\n" + "\n".join(f"  {line}" for line in mistakes))


def validate(model: type[Model], data: dict[str, Any], path: Path, error: type[ValueError]) -> Model:
    """Check `data` against `model`.

    Raises
    ------
    ValueError
        Of type `error`, listing every mistake: one line when there is one, else one line each.
    """
    try:
        return model.model_validate(data)
    except ValidationError as found:
        details = found.errors(include_url=False)
    except RecursionError:
        raise error(f"{path}: tables or lists are nested too deeply.") from None
    # What a value may be of several kinds is refused once for each of them: one line, with all that it could have been.
    merged: dict[tuple[str, str], list[str]] = {}
    for detail in details:
        for place, message, shown in _sentences(model, data, detail):
            merged.setdefault((place, shown), []).append(message)
    # Of "a number or a list of numbers", a list with a mistake inside is only that.
    lists = {place.rsplit("[", 1)[0] for place, _ in merged if place.endswith("]")}
    merged = {key: texts for key, texts in merged.items() if key[0] not in lists or texts != [_CURES["float_type"]]}
    lines = [f"{place}: {', or '.join(dict.fromkeys(messages))}{shown}." for (place, shown), messages in merged.items()]
    raise listed(path, lines, error)


def _sentences(model: type[BaseModel], data: Any, detail: Any) -> list[tuple[str, str, str]]:
    """Place, what is wrong and what was found there."""
    kind, loc, context = detail["type"], detail["loc"], detail.get("ctx", {})
    if kind == "missing" and isinstance(loc[-1], int):
        # An element of a list of fixed length: what is wrong is the list.
        loc, size = loc[:-1], _size_at(model, loc[:-1])
        place, value = _place(model, data, loc, "short")
        return [(place, f"needs {size} values", _found(value))]
    place, value = _place(model, data, loc, kind)
    if kind == "inside":
        return [
            (f"{place}{below}" if place != "the file" else below.lstrip(".") or place, text, "")
            for below, text in context["mistakes"]
        ]
    if kind == "extra_forbidden":
        return [(place, _unknown_key(str(loc[-1]), _models_at(model, loc[:-1])), "")]
    if kind == "missing":
        return [(place, "this key is missing; add it", "")]
    if kind == "union_tag_not_found":
        return [(place, f"the key {context['discriminator']} is missing; it says which kind of table this is", "")]
    if kind == "union_tag_invalid":
        tag, known = str(context["tag"]), [word.strip(" '") for word in context["expected_tags"].split(",")]
        return [
            (place, f'there is no kind "{_shortened(tag)}"; {_did_you_mean(tag, known)}known: {", ".join(known)}', "")
        ]
    if kind in _BOUNDS:
        limit = next(iter(context.values()))
        if value in (math.inf, -math.inf):
            return [(place, _CURES["finite_number"], _found(value))]
        si = ", in SI units" if limit and value is not _ABSENT and value != detail.get("input") else ""
        return [(place, f"must be {_BOUNDS[kind]} {limit:g}{si}", _found(value))]
    if kind == "literal_error":
        known = [word.strip(" '") for word in context["expected"].replace(" or ", ",").split(",")]
        choice = (
            f"{_did_you_mean(str(value), known)}must be one of {', '.join(known)}"
            if len(known) > 1
            else f'must be "{known[0]}"'
        )
        return [(place, choice, _found(value))]
    if kind == "too_long":
        return [(place, f"may have {context['max_length']} values, not {context['actual_length']}", _found(value))]
    message = _CURES.get(kind) or detail["msg"].removeprefix("Value error, ").rstrip(".")
    return [(place, message, "" if "found" in message or loc[-1:] == ("[key]",) else _found(value))]


_ABSENT = object()


def _found(value: Any) -> str:
    return "" if value is _ABSENT else f"; found {_shortened(toml_literal(value))}"


def _shortened(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word[:80], list(known), n=1)
    return f'did you mean "{close[0]}"? ' if close else ""


def _unknown_key(key: str, models: list[Any]) -> str:
    known = sorted(_keys(models))
    spelt = [word for m in models for field in sorted(_keys([m])) for word in m.spellings(field)]
    # The bare names first: of two that are equally close they are the plainer.
    hint = _did_you_mean(key, known) or _did_you_mean(key, spelt)
    return f"unknown key; {hint}known keys: {', '.join(known)}"


def _place(model: type[BaseModel], data: Any, loc: tuple[str | int, ...], kind: str) -> tuple[str, Any]:
    """The path of a value as written in the file (without the names that the validator adds), and the value that stands
    there.
    """
    words: list[str] = []
    for depth, part in enumerate(loc):
        added = kind in ("extra_forbidden", "missing") and depth == len(loc) - 1
        if part in SHAPES or part == "[key]":
            continue
        if isinstance(part, int):
            # A short form such as `depth = "d"` for `depth = {columns = ["d"]}` has no such element in the file.
            if isinstance(data, list) and part < len(data):
                words.append(f"[{part}]")
                data = data[part]
            continue
        before = loc[:depth]
        if not (added or part in _keys(_models_at(model, before)) or _is_free(model, before)):
            continue
        written = _written(part, data, _models_at(model, before))
        if written is not None:
            data = data[written]
        elif added:
            data = _ABSENT
        else:
            continue
        key = toml_key(str(written or part))
        words.append(f".{key}" if words else key)
    return "".join(words) or "the file", data


def _written(field: str, table: Any, models: list[Any]) -> str | None:
    """The key by which the file gives a field; None where it does not."""
    if not isinstance(table, Mapping):
        return None
    spelt = [field, *(word for m in models if issubclass(m, Strict) for word in m.spellings(field))]
    return next((key for key in spelt if key in table), None)


def _size_at(model: type[BaseModel], loc: tuple[str | int, ...]) -> int:
    return max((len(typing.get_args(t)) for t in _types_at(model, loc) if typing.get_origin(t) is tuple), default=0)


def _keys(models: list[Any]) -> set[str]:
    return {field.alias or name for m in models for name, field in m.model_fields.items()}


def _is_free(model: type[BaseModel], loc: tuple[str | int, ...]) -> bool:
    """True where a table has names of the user's choosing (a dict)."""
    return any(typing.get_origin(t) is dict for t in _types_at(model, loc))


def _models_at(model: type[BaseModel], loc: tuple[str | int, ...]) -> list[Any]:
    return [t for t in _types_at(model, loc) if isinstance(t, type) and issubclass(t, BaseModel)]


def _types_at(model: type[BaseModel], loc: tuple[str | int, ...]) -> list[Any]:
    types: list[Any] = [model]
    for part in loc:
        stepped: list[Any] = []
        if part in SHAPES:
            types = [t for t in types if _has_shape(t, str(part))]
            continue
        for t in types:
            if isinstance(t, type) and issubclass(t, BaseModel):
                fields = {field.alias or name: field for name, field in t.model_fields.items()}
                if part in fields:
                    stepped += _alternatives(fields[str(part)].annotation)
                elif not (tags := _tags(t)) or part in tags:
                    stepped.append(t)
            elif typing.get_origin(t) in (dict, list, tuple):
                arguments = [a for a in typing.get_args(t) if a is not Ellipsis]
                stepped += [b for a in arguments[-1:] for b in _alternatives(a)]
            else:
                stepped.append(t)
        types = stepped
    return types


def _has_shape(t: Any, shape: str) -> bool:
    if shape == "<sum>":
        return typing.get_origin(t) is list
    axes = isinstance(t, type) and issubclass(t, Strict) and t.per_axis
    return axes if shape == "<axes>" else typing.get_origin(t) is None and not axes


def _tags(model: type[BaseModel]) -> tuple[object, ...]:
    """The values of the key that tells alternatives apart."""
    return tuple(
        tag
        for field in model.model_fields.values()
        if typing.get_origin(field.annotation) is typing.Literal and field.is_required()
        for tag in typing.get_args(field.annotation)
    )


def _alternatives(annotation: Any) -> list[Any]:
    """The members of a union, looked at through Annotated."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _alternatives(typing.get_args(annotation)[0])
    arguments = typing.get_args(annotation)
    if arguments and typing.get_origin(annotation) not in (dict, list, tuple, typing.Literal):
        return [b for a in arguments for b in _alternatives(a)]
    return [annotation]

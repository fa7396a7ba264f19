"""Strict models for .toml files, and their errors in words: every mistake at once, with place, value and cure."""

from __future__ import annotations

import difflib
import tomllib
import typing
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError


class Strict(BaseModel):
    """A table in which every key must be known."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


Model = TypeVar("Model", bound=Strict)

#: Tags with which a model tells alternatives of different shape apart; they are no part of a place in the file.
SHAPES = {"<one>": None, "<sensor>": None, "<sum>": list, "<axes>": dict}


def read_toml(path: Path, error: type[ValueError]) -> dict[str, Any]:
    """Parse a .toml file; whatever is wrong with it becomes one line of type `error`."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{path}: no such file.") from None
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"{path} cannot be read: {reason}.") from None
    except tomllib.TOMLDecodeError as reason:
        raise error(f"{path} is not valid TOML: {reason}.") from None


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
        lines = list(dict.fromkeys(_sentence(model, detail) for detail in found.errors()))
        if len(lines) == 1:
            raise error(f"{path}: {lines[0]}") from None
        raise error(f"{path}: {len(lines)} mistakes:\n" + "\n".join(f"  {line}" for line in lines)) from None


def _sentence(model: type[BaseModel], detail: Any) -> str:
    kind, value = detail["type"], detail.get("input")
    place = _place(model, detail["loc"], kind)
    if kind == "extra_forbidden":
        known = sorted(_keys(_models_at(model, detail["loc"][:-1])))
        key = str(detail["loc"][-1])
        close = difflib.get_close_matches(key, known, n=1)
        hint = f'did you mean "{close[0]}"? ' if close else ""
        return f"{place}: unknown key; {hint}known keys: {', '.join(known)}."
    if kind == "missing":
        return f"{place}: this key is missing; add it."
    if kind == "union_tag_not_found":
        return f"{place}: the key {detail['ctx']['discriminator']} is missing; it says which kind of table this is."
    if kind == "union_tag_invalid":
        tag, expected = detail["ctx"]["tag"], detail["ctx"]["expected_tags"]
        return f'{place}: there is no kind "{tag}" (known: {expected}).'
    message = detail["msg"].removeprefix("Value error, ").rstrip(".")
    shown = repr(value)
    return f"{place}: {message}; found {shown if len(shown) <= 80 else shown[:77] + '...'}."


def _place(model: type[BaseModel], loc: tuple[str | int, ...], kind: str) -> str:
    """The path of a value as written in the file (without the names that the validator adds for alternatives)."""
    words: list[str] = []
    for depth, part in enumerate(loc):
        if isinstance(part, int):
            words.append(f"[{part}]")
        elif part in SHAPES:
            continue
        elif (
            (depth == len(loc) - 1 and kind in ("extra_forbidden", "missing"))
            or part in _keys(_models_at(model, loc[:depth]))
            or _is_free(model, loc[:depth])
        ):
            words.append(f".{part}" if words else part)
    return "".join(words) or "the file"


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
            types = [t for t in types if typing.get_origin(t) is SHAPES[str(part)]]
            continue
        for t in types:
            if isinstance(t, type) and issubclass(t, BaseModel):
                fields = {field.alias or name: field for name, field in t.model_fields.items()}
                if part in fields:
                    stepped += _alternatives(fields[str(part)].annotation)
                elif not _is_tagged(t) or part in _tags(t):
                    stepped.append(t)
            elif typing.get_origin(t) in (dict, list, tuple):
                arguments = [a for a in typing.get_args(t) if a is not Ellipsis]
                stepped += [b for a in arguments[-1:] for b in _alternatives(a)]
            else:
                stepped.append(t)
        types = stepped
    return types


def _tags(model: type[BaseModel]) -> tuple[object, ...]:
    """The values of the key that tells alternatives apart."""
    return tuple(
        tag
        for field in model.model_fields.values()
        if typing.get_origin(field.annotation) is typing.Literal and field.is_required()
        for tag in typing.get_args(field.annotation)
    )


def _is_tagged(model: type[BaseModel]) -> bool:
    return bool(_tags(model))


def _alternatives(annotation: Any) -> list[Any]:
    """The members of a union, looked at through Annotated."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _alternatives(typing.get_args(annotation)[0])
    arguments = typing.get_args(annotation)
    if arguments and typing.get_origin(annotation) not in (dict, list, tuple, typing.Literal):
        return [b for a in arguments for b in _alternatives(a)]
    return [annotation]

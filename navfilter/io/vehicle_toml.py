"""vehicle.toml <-> Vehicle.

The tables of the file are made from the dataclasses themselves: ``type = "body-velocity"`` is `BodyVelocity` and its
keys are the fields of that class, ``model = "gauss-markov"`` is `GaussMarkov`. A new sensor or error model needs no
change here. Every number may carry another unit in its key: ``mounting_deg`` for ``mounting_rad``, ``sd_deg`` or
``density_deg_per_sqrt_h`` for ``sd`` and ``density`` (see `navfilter.io.units.SUFFIXES`). An error is one table, a
list of tables (their sum) or a table with one error per axis (``{x = .., y = .., z = ..}``). The model that a
``learned-arma`` has adopted is a table of its own: ``adopted = {ar = [..], ma = [..], sd = ..}``, with its slow part as
``slow = [{model = "gauss-markov", ..}, ..]`` beside it.

The keys of a vehicle.toml: what a number of that name may be, and its spelling in another unit.
"""

import dataclasses
import os
import re
import tomllib
import types
import typing
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Union

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, create_model, model_validator

from navfilter.foundation.quoting import toml_key, toml_literal
from navfilter.io.units import SUFFIXES
from navfilter.io.validation import Strict, inside, listed, read_toml, validate
from navfilter.models.during import instrument, is_alias
from navfilter.models.error_models import ErrorModel, Sum
from navfilter.models.fault_bias import FaultBias
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import DeadReckoningLane, Imu, Mechanisation
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.traits import kind_name, kinds_below
from navfilter.models.vehicle import RESERVED, Vehicle
from navfilter.timeseries.model import ArmaModel

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


Kinds = tuple[type, ...]
#: Fields whose name in a file is another one: `model` is taken by the kind of the error.
_IN_FILES: dict[tuple[type, str], str] = {(LearnedArma, "model"): "adopted"}
#: Fields that do not stand in a file: what a report draws can be learnt again.
_NOT_IN_FILES = {(LearnedArma, "spectrum"), (LearnedArma, "level")}
#: What an adopted model consists of in a file: lists for arrays.
_ADOPTED: dict[str, Any] = {
    "ar": tuple[float, ...],
    "ma": tuple[float, ...],
    "sd": float,
    "covariance": tuple[tuple[float, ...], ...] | None,
    "sd_log_s0": float | None,
    "effective_window": float | None,
    "flags": tuple[str, ...],
}


class VehicleError(ValueError):
    """A vehicle.toml cannot be read; lists every mistake with its place, its value and a cure."""

    code = "vehicle"


def read_vehicle(path: str | os.PathLike[str]) -> Vehicle:
    """Read the description of a vehicle.

    Parameters
    ----------
    path : path-like
        A vehicle.toml, or a folder that holds one.

    Returns
    -------
    Vehicle

    Raises
    ------
    VehicleError
        A ValueError that lists every mistake in the file with its place, its value and a cure.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... [drive]
    ... type = "imu"
    ... rate_hz = 100
    ... gyro = [{model = "white", density_deg_per_sqrt_h = 0.3}, {model = "random-walk", density = 1e-6}]
    ... [sensors.compass]
    ... type = "heading"
    ... rate_hz = 8
    ... error = {model = "gauss-markov", sd_deg = 0.5, tau_s = 30}
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "vehicle.toml"
    ...     _ = path.write_text(text)
    ...     read_vehicle(path).sensors["compass"].error.tau_s
    30.0
    """
    path = vehicle_file(path)
    spec: Any = validate(_vehicle_spec(_kinds()), read_toml(path, VehicleError), path, VehicleError)
    wrong: list[tuple[str, str]] = []
    drive = None if spec.drive is None else _built(spec.drive, "drive", wrong, {})
    imus = {name: _built(unit, f"imus.{name}", wrong, {}) for name, unit in spec.imus.items()}
    if (drive is None) == (not imus) and not wrong:
        wrong.append(("drive", "a vehicle has a [drive], or inertial units as [imus.a], [imus.b]: one of the two"))
    sensors = {name: _built(sensor, f"sensors.{name}", wrong, {}) for name, sensor in spec.sensors.items()}
    if wrong:
        raise listed(path, [f"{place}: {text}" for place, text in wrong], VehicleError)
    try:
        parts = drive, sensors, spec.name or path.resolve().parent.name
        return Vehicle(*parts, imus=imus, dead_reckoning_lane=spec.dead_reckoning_lane)
    except ValueError as error:
        raise VehicleError(f"{path}: {error}") from None


def vehicle_file(path: str | os.PathLike[str]) -> Path:
    """A vehicle.toml that was named, or that of a folder."""
    return Path(path) / "vehicle.toml" if Path(path).is_dir() else Path(path)


def write_vehicle(vehicle: Vehicle, path: str | os.PathLike[str]) -> Path:
    """Write a vehicle as a .toml that `read_vehicle` reads back as an equal vehicle (SI and radians throughout)."""
    given = {"name": vehicle.name, "dead_reckoning_lane": vehicle.dead_reckoning_lane}
    lines = [f"{key} = {toml_literal(value)}" for key, value in given.items() if value is not None]
    units: list[Any] = [(f"imus.{toml_key(name)}", unit) for name, unit in vehicle.imus.items()]
    for place, drive in units or [("drive", vehicle.drive)]:
        lines += ["", f"[{place}]", *_lines(drive)]
    for name, sensor in vehicle.sensors.items():
        lines += ["", f"[sensors.{toml_key(name)}]", *_lines(sensor)]
    path = Path(path)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read_learnt(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The table ``[learnt]`` of a vehicle.toml as plain values, its descriptions as error models by axis; None without
    one.

    Raises
    ------
    VehicleError
        As `read_vehicle`.
    """
    path = vehicle_file(path)
    whole: Any = validate(_vehicle_spec(_kinds()), read_toml(path, VehicleError), path, VehicleError)
    spec = whole.learnt
    if spec is None:
        return None
    wrong: list[tuple[str, str]] = []
    table: dict[str, Any] = {"dives": spec.dives, "together": spec.together, "sensors": {}}
    for name, sensor in spec.sensors.items():
        axes = tuple(_object(parts, f"learnt.sensors.{name}.described", wrong, {}) for parts in sensor.described)
        given = {key: getattr(sensor, key) for key in ("quick", "slow", "evidence")}
        table["sensors"][name] = {"described": axes, **given}
    if wrong:
        raise listed(path, [f"{place}: {text}" for place, text in wrong], VehicleError)
    return table


def error_text(error: ErrorModel | tuple[ErrorModel, ...], axes: tuple[str, ...]) -> str:
    """An error as the value of its key in a vehicle.toml, in SI; of a tuple one for each of the axes."""
    if isinstance(error, tuple):
        return toml_literal({axis: _part_text(model) for axis, model in zip(axes, error, strict=True)})
    return toml_literal(_part_text(error))


def described_text(models: tuple[ErrorModel, ...]) -> str:
    """Error models by axis, each as the list of its parts, as `read_learnt` takes them."""
    return toml_literal([[_table(part) for part in model.terms] for model in models])


def _part_text(model: ErrorModel) -> Any:
    return [_table(part) for part in model.parts] if isinstance(model, Sum) else _table(model)


def learnt_keys(part: LearnedArma) -> dict[str, str]:
    """What a learner has adopted, as `read_vehicle` takes it: values as text by the keys of the model's table."""
    table = _table(part)
    return {key: toml_literal(table[key]) for key in ("adopted", "slow", "frozen") if key in table}


def changed(part: Any, keys: dict[str, Any], place: str) -> Any:
    """A sensor with some keys of its table changed.

    Parameters
    ----------
    part : Sensor
    keys : dict
        As they stand in a file, perhaps with another unit: ``mounting_deg``.
    place : str
        For messages.

    Raises
    ------
    VehicleError
        For a key that it has not, or a value that it cannot have.
    """
    kind: Any = type(part)
    spec, table = _spec_of(kind, _kinds()), _table(part)
    for key, value in keys.items():
        table.pop(plain_key(key, set(spec.model_fields))[0], None)
        table[key] = list(value) if isinstance(value, tuple) else value
    wrong: list[tuple[str, str]] = []
    data = tomllib.loads("\n".join(f"{key} = {toml_literal(value)}" for key, value in table.items()))
    found = _built(validate(spec, data, Path(place), VehicleError), place, wrong, {})
    if wrong:
        raise VehicleError("; ".join(f"{where}: {text}" for where, text in wrong) + ".")
    return found


# --- classes -> tables ----------------------------------------------------------------------------------------------


def _concrete(base: type, kinds: Kinds) -> dict[str, type]:
    """Every kind below `base`, by the name it has in a file."""
    return {kind_name(cls): cls for cls in kinds if issubclass(cls, base)}


def _kinds() -> Kinds:
    """Every kind of error model, sensor and drive that there is now; those of a user's own come with the import of
    their module, and those that only a run makes are none.
    """
    bases = ErrorModel, Sensor, Mechanisation
    return tuple(
        c for base in bases for c in kinds_below(base) if not issubclass(c, Sum | FaultBias | DeadReckoningLane)
    )


def _base_of(cls: type) -> tuple[str, type]:
    """The key that tells the class, and the family it belongs to."""
    for base in (ErrorModel, Sensor, Mechanisation):
        if issubclass(cls, base):
            return ("model" if base is ErrorModel else "type"), base
    raise TypeError(f"{cls.__name__} is no error model, sensor or drive")


class _Spec(Strict):
    """A table made from a dataclass; keys with the suffix of another unit are converted first."""

    builds: ClassVar[type]

    @classmethod
    def spellings(cls, field: str) -> list[str]:
        """The keys by which a file may give a field: itself, and with other units."""
        return spellings(field)

    @model_validator(mode="before")
    @classmethod
    def _convert(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        result: dict[str, Any] = {}
        for key, value in data.items():
            name, factor = plain_key(key, set(cls.model_fields))
            if name in result or (name != key and name in data):
                raise ValueError(f'"{name}" is given twice, once with a unit in its key')
            result[name] = value if factor is None else times(value, factor)
        return result

    @model_validator(mode="after")
    def _buildable(self) -> "_Spec":
        # Built here and thrown away, so that what the class itself refuses stands beside the mistakes in other tables.
        wrong: list[tuple[str, str]] = []
        _built(self, "", wrong, {"rate_hz": 1.0})
        if wrong:
            raise inside(wrong)
        return self


class _Axes(Strict):
    """One error per axis."""

    per_axis = True


@cache
def _spec_of(cls: type, kinds: Kinds) -> type[_Spec]:
    key, _ = _base_of(cls)
    hints = typing.get_type_hints(cls)
    fields: dict[str, Any] = {key: (Literal[kind_name(cls)], ...)}
    for field in dataclasses.fields(cls):
        if not field.init or (cls, field.name) in _NOT_IN_FILES:
            continue
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        name = _IN_FILES.get((cls, field.name), field.name)
        fields[name] = (_type_of(hints[field.name], field.name, cls, kinds), ... if required else Field(default=None))
    spec = create_model(f"{cls.__name__}Table", __base__=_Spec, **fields)
    spec.builds = cls
    return spec


@cache
def _adopted_spec() -> type[_Spec]:
    fields: dict[str, Any] = {
        name: (checked(hint, name), ... if name in ("ar", "ma", "sd") else None) for name, hint in _ADOPTED.items()
    }
    spec = create_model("AdoptedTable", __base__=_Spec, **fields)
    spec.builds = ArmaModel
    return spec


def _type_of(hint: Any, name: str, owner: type, kinds: Kinds) -> Any:
    """What a field may hold in a file: numbers as they are, errors and nested sensors as tables."""
    if name == "calibrated":
        pair: Any = tuple[checked(float, ""), checked(float, "sd")]  # type: ignore[misc]
        return Annotated[dict[str, pair], AfterValidator(constants)]
    members = _members(hint)
    if ArmaModel in members:
        return _adopted_spec() | None
    classes = [m for m in members if isinstance(m, type) and issubclass(m, ErrorModel | Sensor | Mechanisation)]
    if not classes:
        return checked(hint, name)
    choices: list[Any] = []
    if any(issubclass(c, ErrorModel) for c in classes):
        # The prior of a learnt error is none itself.
        models = {kind: cls for kind, cls in _concrete(ErrorModel, kinds).items() if cls is not owner}
        one: Any = _union("model", models, kinds)
        several: Any = Annotated[list[one], AfterValidator(_not_empty)]
        either = Annotated[Annotated[one, Tag("<one>")] | Annotated[several, Tag("<sum>")], Discriminator(_one_or_sum)]
        choices += [Annotated[one, Tag("<one>")], Annotated[several, Tag("<sum>")]]
        if not issubclass(owner, ErrorModel):
            axes: dict[str, Any] = dict.fromkeys(_axes_of(owner, name), (either, ...))
            choices.append(
                Annotated[create_model(f"{owner.__name__}{name.title()}Axes", __base__=_Axes, **axes), Tag("<axes>")]
            )
    sensors = {kind_name(c): c for c in classes if issubclass(c, Sensor)}
    if sensors:
        choices.append(Annotated[_union("type", sensors, kinds), Tag("<sensor>")])
    # A learnt error is that of one axis.
    return Annotated[Union[tuple(choices)], Discriminator(_one_or_sum if issubclass(owner, ErrorModel) else _shape)]  # noqa: UP007


def _not_empty(parts: list[Any]) -> list[Any]:
    if not parts:
        raise ValueError('an empty list is no error model; give at least one, such as {model = "white", sd = 0.1}')
    return parts


def _members(hint: Any) -> list[Any]:
    if typing.get_origin(hint) in (Union, types.UnionType, tuple):
        return [m for argument in typing.get_args(hint) for m in _members(argument)]
    return [hint]


def _union(key: str, classes: dict[str, type], kinds: Kinds) -> Any:
    tables = tuple(_spec_of(cls, kinds) for cls in classes.values())
    return tables[0] if len(tables) == 1 else Annotated[Union[tables], Field(discriminator=key)]  # noqa: UP007


def _one_or_sum(value: Any) -> str:
    return "<sum>" if isinstance(value, list) else "<one>"


def _shape(value: Any) -> str:
    if isinstance(value, list):
        return "<sum>"
    if isinstance(value, dict) and "type" in value:
        return "<sensor>"
    if (
        isinstance(value, dict)
        and "model" not in value
        and value
        and all(isinstance(v, dict | list) for v in value.values())
    ):
        return "<axes>"
    return "<one>"


@cache
def _learnt_spec(kinds: Kinds) -> type[Strict]:
    """What `navfilter learn` keeps of the dives that taught a description: no part of the vehicle, see
    `navfilter.io.toml_editing`.
    """
    pair: Any = Annotated[list[float], Field(min_length=2, max_length=2)]
    grid: Any = Annotated[list[list[float]], Field(min_length=1)]
    one: Any = _union("model", _concrete(ErrorModel, kinds), kinds)
    fields: dict[str, Any] = {"described": (list[Annotated[list[one], AfterValidator(_not_empty)]], ...)}
    fields |= {"quick": (pair, ...), "slow": (pair, ...), "evidence": (grid, ...)}
    sensor = create_model("LearntSensorTable", __base__=Strict, **fields)
    whole: dict[str, Any] = {
        "dives": (list[Annotated[list[str], Field(min_length=2, max_length=2)]], ...),
        "sensors": (Annotated[dict[str, sensor], Field(min_length=1)], ...),  # type: ignore[valid-type]
        "together": (grid | None, None),
    }
    return create_model("LearntTable", __base__=Strict, **whole)


@cache
def _vehicle_spec(kinds: Kinds) -> type[Strict]:
    sensors: Any = _union("type", _concrete(Sensor, kinds), kinds)
    fields: dict[str, Any] = {
        "name": (str | None, None),
        "drive": (_union("type", _concrete(Mechanisation, kinds), kinds) | None, None),
        "imus": (dict[str, _spec_of(Imu, kinds)], Field(default_factory=dict)),  # type: ignore[misc]
        "dead_reckoning_lane": (Annotated[bool, Field(strict=True)] | None, None),
        "sensors": (dict[Annotated[str, AfterValidator(_sensor_name)], sensors], Field(default_factory=dict)),
        "learnt": (_learnt_spec(kinds) | None, None),
    }
    return create_model("VehicleTable", __base__=Strict, **fields)


def _sensor_name(name: str) -> str:
    if name in RESERVED:
        raise ValueError(f'"{name}" is reserved for the drive; give the sensor another name')
    if not name.strip() or not name.isprintable():
        raise ValueError("a sensor needs a name of printable characters: that of its stream in the mission")
    if is_alias(name):
        raise ValueError(f'"{name}" would be {instrument(name)}, described otherwise for a time; give it another name')
    return name


# --- tables -> objects ----------------------------------------------------------------------------------------------


def _built(spec: Any, place: str, wrong: list[tuple[str, str]], defaults: dict[str, Any]) -> Any:
    """The object that a table describes; what its own class refuses is added to `wrong`."""
    cls: Any = spec.builds
    of_class = {_IN_FILES.get((cls, field.name), field.name): field.name for field in dataclasses.fields(cls)}
    given: dict[str, Any] = {}
    before = len(wrong)
    for name in [name for name in of_class if name in spec.model_fields_set]:
        value = getattr(spec, name)
        inherited = {"rate_hz": spec.rate_hz} if isinstance(spec, _Spec) and hasattr(spec, "rate_hz") else {}
        given[of_class[name]] = _object(value, f"{place}.{name}", wrong, inherited)
    given = {**{name: value for name, value in defaults.items() if name in of_class}, **given}
    if len(wrong) > before:
        return None
    if cls is ArmaModel and given.get("covariance") == ():
        given["covariance"] = np.zeros(
            (0, 0)
        )  # of a model without coefficients: no list tells a matrix of 0 x 0 from an empty row
    try:
        item = cls(**given)
        _discretise(item)
        return item
    except (ValueError, TypeError) as error:
        wrong.append((place, str(error).rstrip(".")))
        return None


def _discretise(item: Any) -> None:
    """Try the error models of a sensor or drive: what the filter could not use is refused here, not when the run
    begins.
    """
    if isinstance(item, Sensor | Mechanisation):
        for model in dict.fromkeys(item.models):
            model.block(1.0 / item.rate_hz)


def _object(value: Any, place: str, wrong: list[tuple[str, str]], inherited: dict[str, Any]) -> Any:
    if isinstance(value, _Spec):
        return _built(value, place, wrong, inherited)
    if isinstance(value, list) and value and isinstance(value[0], _Spec):
        parts = [_built(part, f"{place}[{k}]", wrong, inherited) for k, part in enumerate(value)]
        parts = [part for part in parts if part is not None]
        return sum(parts[1:], start=parts[0]) if parts else None
    if isinstance(value, _Axes):
        return tuple(
            _object(getattr(value, name), f"{place}.{name}", wrong, inherited) for name in type(value).model_fields
        )
    return tuple(value) if isinstance(value, list) else value


def _axes_of(owner: type, field: str) -> tuple[str, ...]:
    if issubclass(owner, Mechanisation):
        return ("roll", "pitch", "yaw") if field == "attitude" else ("x", "y", "z")
    return tuple(getattr(owner, "axis_names", ("x", "y", "z")))


# --- objects -> text ------------------------------------------------------------------------------------------------


def _lines(item: Any) -> list[str]:
    return [f"{key} = {toml_literal(value)}" for key, value in _table(item).items()]


def _table(item: Any) -> dict[str, Any]:
    """The table of an object; fields at their default are left out."""
    key, _ = _base_of(type(item))
    table: dict[str, Any] = {key: kind_name(type(item))}
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if (
            field.init
            and (type(item), field.name) not in _NOT_IN_FILES
            and value is not None
            and not (field.default is not dataclasses.MISSING and value == field.default)
        ):
            table[_IN_FILES.get((type(item), field.name), field.name)] = _plain(value, type(item), field.name)
    return table


def _adopted(model: ArmaModel) -> dict[str, Any]:
    """The table of an adopted model; what is not known is left out."""
    values = {name: getattr(model, name) for name in _ADOPTED}
    values["flags"] = sorted(model.flags) or None
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
        if value is not None
    }


def _plain(value: Any, owner: type, field: str) -> Any:
    if isinstance(value, Sum):
        return [_table(part) for part in value.parts]
    if isinstance(value, Sensor):
        # Inside a drive the default of the rate is that of the drive, not that of the class.
        return _table(value) | {"rate_hz": value.rate_hz}
    if isinstance(value, ErrorModel | Mechanisation):
        return _table(value)
    if isinstance(value, ArmaModel):
        return _adopted(value)
    if field == "calibrated":
        return {name: (found, sd) for name, found, sd in value}
    if isinstance(value, tuple) and value and isinstance(value[0], ErrorModel):
        return {name: _plain(part, owner, field) for name, part in zip(_axes_of(owner, field), value, strict=True)}
    return value

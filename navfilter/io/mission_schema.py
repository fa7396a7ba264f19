"""What may stand in a mission.toml: the tables and keys, their defaults and their checks.

A mission names its streams as the vehicle names its sensors. A stream is made of one or more sources (files); a source
has a clock (`time`) and groups of columns (`rate`, `velocity`, `position`, ...), which the kinds of drives and sensors
state. With several sources the first gives the clock and the others are interpolated onto it; a group in several of
them is their mean.
"""

import datetime
import math
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model, field_validator, model_validator

from navfilter.io.table import TableOptions
from navfilter.io.units import UNITS, parse_quantity, unit
from navfilter.io.validation import Strict, at_least_one
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.traits import Columns, kinds_below

TRUTH_GROUPS = ("position", "ecef", "local", "velocity_n", "velocity_ecef", "attitude", "quaternion")
Reference = str | int
#: Lengths, angles and the like: what is computed from them stays a number.
Amount = Annotated[float, Field(ge=-1e12, le=1e12)]
Sd = Annotated[float, Field(ge=0, le=1e12)]
#: Forms of a group that are turned into it when they are read: ECEF or local coordinates into geodetic ones, a
#: quaternion into angles.
FORMS: dict[str, tuple[Columns, ...]] = {
    "position": (
        Columns("ecef", ("ecef_x_m", "ecef_y_m", "ecef_z_m"), ("length",) * 3),
        Columns("local", ("north_m", "east_m", "down_m"), ("length",) * 3),
    ),
    "attitude": (Columns("quaternion", ("q_w", "q_x", "q_y", "q_z"), ("number",) * 4),),
}
#: What only the truth has.
TRUTH_ONLY = (Columns("velocity_ecef", ("v_ecef_x_m_s", "v_ecef_y_m_s", "v_ecef_z_m_s"), ("speed",) * 3),)
#: A group of any columns, for streams that no sensor reads.
SERIES = "series"
#: Standard deviations of the single readings, beside those of a sensor.
SD = "sd"


def each_of(given: Reference | tuple[Reference, ...] | None) -> set[Reference]:
    """The columns of one or several."""
    return set(given) if isinstance(given, tuple) else set() if given is None else {given}


def _known_units(given: str | tuple[str, ...] | None) -> str | tuple[str, ...] | None:
    for name in (given,) if isinstance(given, str) else given or ():
        unit(name)
    return given


def _known_quantity(value: float | str | None) -> float | str | None:
    if isinstance(value, str):
        parse_quantity(value)
    return value


class Component(Strict):
    """One component of a group: a column, a constant or the mean of several columns."""

    column: Reference | tuple[Reference, ...] | None = None
    constant: float | None = None
    mean: tuple[Reference, ...] | None = None
    unit: Annotated[str | None, AfterValidator(_known_units)] = None
    scale: float | None = None
    offset: Annotated[float | str | None, AfterValidator(_known_quantity)] = None
    absolute: bool | None = None
    radius_m: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _one_origin(self) -> "Component":
        if sum(v is not None for v in (self.column, self.constant, self.mean)) != 1:
            raise ValueError("give exactly one of column, constant and mean")
        if self.mean is not None and not self.mean:
            raise ValueError("mean needs the columns that it is of")
        return self


class Origin(Strict):
    """Where local coordinates have their zero."""

    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=360)
    height_m: Amount = 0.0


class Group(Strict):
    """Columns that belong together. Per column: SI = unit(scale * raw + offset), with |raw| if `absolute`."""

    columns: tuple[Component, ...]
    unit: Annotated[str | tuple[str, ...], AfterValidator(_known_units)] = ""
    scale: float = 1.0
    offset: Annotated[float | str, AfterValidator(_known_quantity)] = 0.0
    absolute: bool = False
    radius_m: float | None = Field(default=None, gt=0)
    invalid: tuple[float, ...] = ()
    invalid_above: float | None = Field(default=None, gt=0)
    valid_range: tuple[float, float] | None = None
    invalid_together: bool = True
    axes: str | None = None
    mounting_deg: tuple[Amount, Amount, Amount] | None = None
    origin: Origin | None = None
    order: Literal["wxyz", "xyzw"] = "wxyz"
    reference: Literal["ned", "enu", "ecef"] = "ned"
    body: Literal["frd", "flu"] = "frd"
    names: tuple[str, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _short_forms(cls, data: Any) -> Any:
        if isinstance(data, str | int):
            data = {"columns": [data]}
        elif isinstance(data, list):
            data = {"columns": data}
        elif isinstance(data, dict) and "columns" not in data:
            data = dict(data)
            one = {key: data.pop(key) for key in ("column", "constant", "mean") if key in data}
            if one:
                data["columns"] = [one]
        if isinstance(data, dict) and isinstance(data.get("columns"), list):
            whole = [{"column": c} if isinstance(c, str | int) else c for c in data["columns"]]
            data = {**data, "columns": whole}
        return data

    @field_validator("axes")
    @classmethod
    def _axes(cls, value: str | None) -> str | None:
        if value is not None and sorted(word.strip(" +-") for word in value.split(",")) != ["x", "y", "z"]:
            raise ValueError('axes names each of x, y, z once, with signs, such as "x,-y,-z"')
        return value


class Clock(Strict):
    """Times of a source: a column, or a rate."""

    file: str | None = None
    table: str = ""
    transpose: bool = False
    column: Reference | tuple[Reference, ...] | None = None
    unit: str = "s"
    order: Literal["dmy", "mdy", "ymd"] | None = None
    scale: float = Field(default=1.0, gt=0)
    rollover: float | None = Field(default=None, gt=0)
    from_first: bool = False
    ends_only: bool = False
    rate_hz: float | None = Field(default=None, gt=0)
    start_s: float = 0.0
    offset_s: float = 0.0

    @field_validator("unit")
    @classmethod
    def _time_unit(cls, value: str) -> str:
        if value != "iso8601" and unit(value).dimension != "time":
            times = [name for name, known in UNITS.items() if known.dimension == "time"]
            raise ValueError(f"not a unit of time (known: {', '.join(times)}, iso8601)")
        return value

    @model_validator(mode="after")
    def _column_or_rate(self) -> "Clock":
        if (self.column is None) == (self.rate_hz is None):
            raise ValueError("give either the column of times or rate_hz (with start_s)")
        if self.unit != "iso8601" and (self.order is not None or isinstance(self.column, tuple)):
            raise ValueError('several columns, and order, are of dates: unit = "iso8601"')
        return self


class Source(TableOptions):
    """One file, its layout and the groups of columns taken from it; their keys are those of `groups`, see
    `mission_spec`.
    """

    file: str
    run: int | None = Field(default=None, ge=1)
    time: Clock
    only_changes: bool | tuple[Reference, ...] = False
    max_gap_s: float | None = Field(default=None, gt=0)
    series: Group | None = None
    sd: Group | None = None

    def references(self) -> set[Reference]:
        """The columns that are named anywhere in this source."""
        named = {condition.column for condition in self.where}
        named |= set(self.only_changes) if isinstance(self.only_changes, tuple) else set()
        if self.time.file is None:
            named |= each_of(self.time.column)
        for part in (part for group in self.groups().values() for part in group.columns):
            named |= each_of(part.column if part.column is not None else part.mean)
        return named

    def groups(self) -> dict[str, Group]:
        """The groups given, in the order of their definition."""
        given = {name: getattr(self, name, None) for name in (*groups(), SERIES, SD)}
        return {name: group for name, group in given.items() if group is not None}

    @model_validator(mode="after")
    def _sizes(self) -> "Source":
        if not set(self.groups()) - {SD}:
            raise ValueError(f"a source needs at least one group of columns (known: {', '.join(groups())}, {SERIES})")
        for name, group in self.groups().items():
            if name in (SERIES, SD):
                continue
            dimensions = groups()[name].dimensions
            sizes = range(groups()[name].least or len(dimensions), len(dimensions) + 1)
            if len(group.columns) not in sizes:
                raise ValueError(f"{name} has {len(group.columns)} columns, it needs {' or '.join(map(str, sizes))}")
            self.check_dimensions(name, group, dimensions)
            if name == "local" and group.origin is None:
                raise ValueError("local coordinates need origin = {latitude_deg = .., longitude_deg = ..}")
        return self

    @staticmethod
    def check_dimensions(name: str, group: Group, dimensions: tuple[str, ...]) -> None:
        """Refuse units of the columns of a group that measure something else."""
        if not isinstance(group.unit, str) and len(group.unit) != len(group.columns):
            raise ValueError(f"{name} has {len(group.columns)} columns and {len(group.unit)} units")
        for k, part in enumerate(group.columns):
            given = part.unit or (group.unit if isinstance(group.unit, str) else group.unit[k])
            wanted = dimensions[k]
            if part.radius_m or group.radius_m:
                wanted = "angular rate"
            if given and part.constant is None and unit(given).dimension != wanted:
                fitting = [u for u, known in UNITS.items() if known.dimension == wanted and u]
                raise ValueError(f'{name}: "{given}" is no unit of {wanted} (use {", ".join(fitting) or "no unit"})')


class StreamSpec(Strict):
    """A stream: its sources and what is kept of them."""

    sources: Annotated[tuple[Source, ...], AfterValidator(at_least_one("a stream needs at least one source"))]
    average: int = Field(default=1, ge=1)
    every: int = Field(default=1, ge=1)
    resample_hz: float | None = Field(default=None, gt=0)
    windows: tuple[tuple[float, float], ...] = ()
    hide: tuple[tuple[float, float], ...] = ()
    stands_in: bool = False
    lever_arm_b_m: tuple[Amount, Amount, Amount] | None = None

    @model_validator(mode="before")
    @classmethod
    def _single_source(cls, data: Any) -> Any:
        if isinstance(data, dict) and "sources" not in data:
            own = {key: value for key, value in data.items() if key in cls.model_fields}
            rest = {key: value for key, value in data.items() if key not in cls.model_fields}
            return {**own, "sources": [rest]}
        return data

    def groups(self) -> list[str]:
        """Names of the groups of all sources, each once, in the order of `groups`."""
        given = {name for source in self.sources for name in source.groups()}
        return [name for name in (*groups(), SERIES, SD) if name in given]


class SensorStream(StreamSpec):
    """A stream of readings: its groups must form one of `contents`."""

    @model_validator(mode="after")
    def _contents(self) -> "SensorStream":
        given = set(self.groups()) - {SD}
        if self.lever_arm_b_m is not None:
            raise ValueError("the lever arm of a sensor belongs into vehicle.toml; here only [truth] has one")
        known = [([c.group for c in must], [c.group for c in may]) for must, may in contents()] + [([SERIES], [])]
        if not any(set(must) <= given <= {*must, *may} for must, may in known):
            allowed = "; ".join(" + ".join(must) + "".join(f" (+ {m})" for m in may) for must, may in known)
            raise ValueError(f"a stream cannot consist of {' + '.join(self.groups())} (allowed: {allowed})")
        self._check_sd(given)
        return self

    def _check_sd(self, given: set[str]) -> None:
        own = [source.sd for source in self.sources if source.sd is not None]
        if not own:
            return
        kind = kind_of(given)
        if kind is None:
            raise ValueError(
                "sd belongs to a sensor that corrects; what drives takes none (see its errors in vehicle.toml)"
            )
        if len(own) > 1:
            raise ValueError("only one of the sources of a stream can give sd")
        sd, axes, one = own[0], kind.axes, kind.axes // kind.tracks
        if len(sd.columns) not in (1, one, axes):
            each = f"{axes}" if one == axes else f"{one} (or {axes})"
            raise ValueError(f"sd has {len(sd.columns)} columns, it needs 1, or one for each of the {each} axes")
        if sd.axes is not None or sd.mounting_deg is not None:
            raise ValueError("sd takes no axes and no mounting_deg: give its columns in the order of the sensor's axes")
        known = [name.replace("_", "/") for name in (kind.axis_units or (kind.unit,) * axes)]
        dimensions = [UNITS[name].dimension if name in UNITS else "number" for name in known]
        Source.check_dimensions(SD, sd, tuple(dimensions[: len(sd.columns)]))


class TruthStream(StreamSpec):
    """The reference trajectory; the lever arm leads from the point the vehicle navigates to the point of the truth."""

    @model_validator(mode="after")
    def _contents(self) -> "TruthStream":
        given = set(self.groups())
        if not given <= set(TRUTH_GROUPS):
            raise ValueError(
                f"truth cannot have {', '.join(sorted(given - set(TRUTH_GROUPS)))} ({', '.join(TRUTH_GROUPS)})"
            )
        for choice in (("position", "ecef", "local"), ("velocity_n", "velocity_ecef"), ("attitude", "quaternion")):
            if len(given & set(choice)) > 1:
                raise ValueError(f"truth can have only one of {', '.join(choice)}")
        return self


class StartSpec(Strict):
    """How the mission begins: given, or taken from the truth; what is given wins."""

    source: Literal["truth", "given"] = Field(default="given", alias="from")
    time_s: float | None = None
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    longitude_deg: float | None = Field(default=None, ge=-180, le=360)
    height_m: Amount | None = None
    velocity_n: tuple[Amount, Amount, Amount] | None = None
    roll_deg: Amount | None = None
    pitch_deg: Amount | None = None
    heading_deg: Amount | None = None
    position_sd_m: Sd | tuple[Sd, Sd, Sd] | None = None
    velocity_sd_m_s: Sd | tuple[Sd, Sd, Sd] | None = None
    tilt_sd_deg: Sd | None = None
    heading_sd_deg: Sd | None = None

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: Any) -> Any:
        return {"from": data} if isinstance(data, str) else data


class LogSpec(Strict):
    """The log of ``navfilter run``: readings of all streams in the order of their arrival, and the names of their
    columns.
    """

    file: str
    columns: dict[str, tuple[str, ...]] = Field(default_factory=dict)


class DuringSpec(Strict):
    """An instruction for a part of the mission."""

    sensor: str
    from_s: float = -math.inf
    to_s: float = math.inf
    off: bool = False
    noise: float = Field(default=1.0, gt=0)
    keys: dict[str, Any] = Field(default_factory=dict)
    why: str = ""

    @model_validator(mode="after")
    def _says_something(self) -> "DuringSpec":
        if not self.from_s < self.to_s:
            raise ValueError(f"from_s must be before to_s, found {self.from_s:g} and {self.to_s:g}")
        if not (self.off or self.noise != 1.0 or self.keys):
            raise ValueError("give off = true, noise = 3.0 (times as large), or keys = {..} of the sensor's table")
        return self


class MissionSpec(Strict):
    """A whole mission.toml."""

    name: str | None = None
    date: datetime.date | None = None
    zero_s: float | Literal["first"] = 0.0
    epoch: datetime.datetime | Literal["unknown"] | None = None
    windows: tuple[tuple[float, float], ...] = ()
    start: StartSpec | None = None
    truth: TruthStream | None = None
    log: LogSpec | None = None
    streams: dict[str, SensorStream] = Field(default_factory=dict)
    during: tuple[DuringSpec, ...] = ()

    @field_validator("epoch", mode="before")
    @classmethod
    def _with_zone(cls, value: Any) -> Any:
        if value == "unknown" or (isinstance(value, datetime.datetime) and value.tzinfo is not None):
            return value
        raise ValueError('must be the UTC at which the stamps read zero, such as 2026-06-01T08:30:00Z, or "unknown"')

    @model_validator(mode="after")
    def _something(self) -> "MissionSpec":
        if not self.streams and self.truth is None and self.log is None:
            raise ValueError("there is no stream; add [streams.NAME], named as the sensor in vehicle.toml")
        if self.start is not None and self.start.source == "truth" and self.truth is None:
            raise ValueError('start is to come from "truth", but there is no [truth]')
        return self


def mission_spec() -> type[MissionSpec]:
    """The tables of a mission.toml, with a key for every group of columns that there is now.

    Raises
    ------
    ValueError
        When the group of a user's own kind takes a key that means something else.
    """
    return _mission_spec(tuple(groups()))


@cache
def _mission_spec(names: tuple[str, ...]) -> type[MissionSpec]:
    taken = set(names) & set(Source.model_fields)
    if taken:
        raise ValueError(
            f'"{taken.pop()}" is a key of every source; a kind of sensor must call its group of columns otherwise.'
        )
    given: Any = dict.fromkeys(names, (Group | None, None))
    source: Any = create_model("Source", __base__=Source, **given)
    sensor: Any = create_model("SensorStream", __base__=SensorStream, sources=(tuple[source, ...], ...))
    truth: Any = create_model("TruthStream", __base__=TruthStream, sources=(tuple[source, ...], ...))
    return create_model(
        "MissionSpec",
        __base__=MissionSpec,
        truth=(truth | None, None),
        streams=(dict[str, sensor], Field(default_factory=dict)),
    )


# --- groups of columns -----------------------------------------------------------------------------------------------


def contents() -> tuple[tuple[tuple[Columns, ...], tuple[Columns, ...]], ...]:
    """What a stream may consist of, as the kinds state it: the groups that must be there, then those that may."""
    found = []
    for kind in (*kinds_below(Mechanisation), *kinds_below(Sensor)):
        found += [(given, kind.beside) for given in _readable(kind)]  # type: ignore[attr-defined]
    return tuple(dict.fromkeys(found))


def _readable(kind: Any) -> Iterator[tuple[Columns, ...]]:
    """The groups that a kind must be given, in all their forms."""
    for must in kind.contents:
        yield must
        if len(must) == 1:
            yield from ((form,) for form in FORMS.get(must[0].group, ()))


def kind_of(given: set[str]) -> Any:
    """The kind of sensor that reads these groups; None where only a drive does."""
    for kind in kinds_below(Sensor):
        if any({columns.group for columns in must} <= given for must in _readable(kind)):
            return kind
    return None


def driving() -> set[str]:
    """Groups of streams that drive a mechanisation: a repeated stamp would be a step of no length."""
    first = {must[0].group for kind in kinds_below(Mechanisation) for must in kind.contents}  # type: ignore[attr-defined]
    return first | {form.group for group in first for form in FORMS.get(group, ())}


def groups() -> dict[str, Columns]:
    """Every group of columns that a file may give, by its key.

    Raises
    ------
    ValueError
        When two kinds mean different columns by one key.
    """
    streams = contents()
    every = [columns for must, _ in streams for columns in must]
    every += [columns for _, may in streams for columns in may]
    found: dict[str, Columns] = {}
    for columns in (*every, *TRUTH_ONLY):
        if found.setdefault(columns.group, columns) != columns:
            raise ValueError(
                f'two kinds of sensors mean different columns by "{columns.group}"; give one of them another name.'
            )
    return found

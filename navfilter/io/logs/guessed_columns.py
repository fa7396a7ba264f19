"""What the columns of a table are, by their names, their units and their values: for ``navfilter mission --init``.

A name says what a column may be; its values have to agree, and tell the unit where the name does not. Whatever is so
found is a guess, and marked as one.

What the topics of known kinds give: which readings, in which fields, units and axes (known_topics.toml).
"""

import datetime
import itertools
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from navfilter.foundation.arrays import AnyArray, Array
from navfilter.io.axis_columns import bare_name, found_axes, size_of_axes
from navfilter.io.columns import date_seconds, since_1970, unit_of_times
from navfilter.io.logs.formats import Format
from navfilter.io.logs.survey import Survey, Topic
from navfilter.io.table import Table, TableOptions, Where, listing
from navfilter.io.text_tables import delimiter_of, fields_of, first_lines, read_table
from navfilter.io.trust import UNPACKED_BYTES, Allowance, Place
from navfilter.io.units import ALIASES, UNITS, angles, unit
from navfilter.models.magnetic import believable, declination
from navfilter.models.mission import MissionError

#: Senders share a topic where they speak at once in no more than this share of cases [1].
AT_ONCE = 0.1
_TOPICS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("known_topics.toml").read_text(encoding="utf-8"))
#: What a topic may read -> how that is said.
READINGS: dict[str, str] = _TOPICS["readings"]


@dataclass(frozen=True)
class Use:
    """How a topic becomes a stream.

    Parameters
    ----------
    format : str
        Module of the format.
    pattern : str
        Regular expression for the type of the topic's messages, or for its name where the format has no types; that of
        a topic of several senders is as of the first.
    reading : str
        Key of `READINGS`.
    lines : tuple of str
        Groups of the mission.toml.
    fields : tuple of str
        Fields that must be there, with a value.
    where : str
        Condition on the rows; empty: all.
    guess : str
        What is not known for certain; empty: nothing.
    when : str
        Condition under which all this holds; it is not one on the rows.
    """

    format: str
    pattern: str
    reading: str
    lines: tuple[str, ...]
    fields: tuple[str, ...] = ()
    where: str = ""
    guess: str = ""
    when: str = ""

    def fits(self, topic: Topic) -> bool:
        """Whether a topic is of this kind, with values in its fields."""
        named = re.search(self.pattern, topic.kind or topic.name.replace("*", "..")) is not None
        if not (named and all(map(topic.has, self.fields))):
            return False
        rows = np.ones(next(iter(topic.columns.values())).size, dtype=bool)
        if self.when:
            condition = Where(**tomllib.loads(f"when = {self.when}")["when"])
            rows = condition.rows(Table(topic.name, topic.columns))
        return bool(rows.any()) and all(_some(topic.columns[field][rows]) for field in self.fields)


_KNOWN = [Use(**{**row, "lines": tuple(row["lines"]), "fields": tuple(row["fields"])}) for row in _TOPICS["use"]]


def uses_of(found: Survey) -> list[tuple[Topic, Use]]:
    """The topics of a log that are of a known kind, each with all that it can give; the preferred first."""
    if found.uses:
        return list(found.uses)
    rows = [use for use in _KNOWN if use.format == found.format.module]
    topics = sorted([*found.topics, *_together(found)], key=lambda topic: -topic.count)
    return [(topic, use) for use in rows for topic in topics if use.fits(topic)]


def _together(found: Survey) -> Iterator[Topic]:
    """Topics that several senders share one after the other, as when a receiver begins to use a second system."""
    short: Callable[[str], str] | None = getattr(found.format.load(), "short_name", None)
    if short is None:
        return
    for name in sorted({short(topic.name) for topic in found.topics}):
        senders = [topic for topic in found.topics if short(topic.name) == name]
        times = np.sort(np.concatenate([topic.time_s for topic in senders]))
        step_s = float(np.median(np.diff(times))) if times.size > 2 else 0.0
        # two receivers that speak at the same time are two
        alone = step_s > 0.0 and float(np.mean(np.diff(times) < 0.5 * step_s)) < AT_ONCE
        if len(senders) > 1 and alone:
            columns = {field: np.concatenate([t.columns[field] for t in senders]) for field in _shared(senders)}
            yield Topic(f"*{name}", senders[0].kind, times.size, times, columns, senders[0].units)


def _shared(senders: list[Topic]) -> list[str]:
    return [field for field in senders[0].columns if all(topic.has(field) for topic in senders)]


def _some(column: AnyArray) -> bool:
    return column.dtype.kind not in "fc" or bool((column == column).any())


TABLE = Format("a table", "guessed_columns", (".csv", ".txt", ".dat", ".tsv", ".log", ".asc"))
_TOLD = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: Quantity -> what its column may be called, in lower case and without its unit.
_NAMES: dict[str, str] = _TOLD["names"]
#: Names of three columns of a velocity; units that mean nothing else behind a name: "time_ms", "depth_mm".
_VELOCITIES, _ENDINGS = _TOLD["velocities"], _TOLD["endings"]
#: Units by their names in lower case.
_UNITS = {name.lower(): known for name, known in [*ALIASES.items(), *zip(UNITS, UNITS, strict=True)]}
_UNIT_CELLS = {*_UNITS, "", "-", "utc", "gmt"}
#: What a speed over ground may be in, and the share within which the fixes say so [1].
_SPEEDS, _WITHIN = ("m/s", "kn", "km/h"), 0.2
#: What fixes say of heading and speed means nothing below this speed [m/s].
_SLOWEST_M_S = 0.5
#: No vehicle under water is faster [m/s]: larger numbers are millimetres.
_FASTEST_M_S = 50.0
#: A whole circle, and what rounding makes of it [deg].
_WHOLE_DEG = 361.0
#: More numbers than this are no marks.
_MOST_MARKS = 3
#: How many readings a course needs to tell magnetic from true north, and how much they must differ [rad].
_COURSES, _APART = 100, math.radians(3.0)


@dataclass(frozen=True)
class _Clock:
    """How the times are to be read: the value of ``time`` in the mission.toml, and what is not known of it."""

    line: str
    guess: str
    time_s: Array


def survey_table(path: Path, unpacked_bytes: int = UNPACKED_BYTES) -> Survey:
    """Look at a table as `navfilter.io.logs.survey` does at a log, with a guess of what its columns are.

    Raises
    ------
    MissionError
        Where the table has no names of columns, or none that is known as a time.
    """
    skip, names = _layout(path)
    options = TableOptions(skip_lines=skip, header=names if names else None)
    table = read_table(Place(path, str(path), True, Allowance(unpacked_bytes)), options)
    clock = _clock(table)
    topic = Topic("", "", clock.time_s.size, clock.time_s[np.isfinite(clock.time_s)], dict(table.columns), {})
    layout: tuple[str, ...] = (f"skip_lines = {skip}",) if skip else ()
    layout += (f"header = {json.dumps(names, ensure_ascii=False)}",) if names else ()
    uses = tuple((topic, use) for use in _uses(table, clock))
    return Survey(path, TABLE, (topic,), table.notes, unpacked_bytes, "", layout, clock.line, uses, clock.guess)


def _layout(path: Path) -> tuple[int, tuple[str, ...]]:
    """Lines before the names, which have as many fields as the line behind them, and that has numbers; and the names,
    where the reader does not find them so: of a line of comment, or with their units from a line of its own.
    """
    rows = first_lines(path)
    found: list[tuple[int, tuple[str, ...]]] = []
    for number, (line, after) in enumerate(itertools.pairwise(rows)):
        bare = line.strip("\r\n\ufeff")
        comment = bare[:1] in ("#", "%")
        bare = bare.lstrip("#% ") if comment else bare
        delimiter = delimiter_of(bare, None, after.strip())
        names, cells = ([cell.strip() for cell in fields_of(text.strip(), delimiter)] for text in (bare, after))
        numeric = sum(_is_value(cell) for cell in cells)
        if (
            len(names) > 1
            and not any(map(_is_value, names))
            and abs(len(cells) - len(names)) <= 1
            and 2 * numeric >= len(names)
        ):
            above = fields_of(rows[number - 1].strip("\r\n\ufeff "), delimiter) if number else []
            if len(above) == len(names) and all(cell.strip("[]() ").lower() in _UNIT_CELLS for cell in names):
                units = (f" [{cell.strip('[]() ')}]" if cell.strip("[]()- ") else "" for cell in names)
                found.append((number + 1, tuple(a.strip() + b for a, b in zip(above, units, strict=True))))
            else:
                found.append((number + 1, tuple(names)) if comment else (number, ()))
            if any(
                re.fullmatch(f"{_NAMES['time']}|{_NAMES['date']}", _bare(name)[0]) for name in found[-1][1] or names
            ):
                return found[-1]
    if found:
        return found[0]
    raise MissionError(
        f"{path}: no line of names with a row of numbers behind it among the first {len(rows)}: nothing to guess from. "
        "Write a mission.toml by hand (docs/pages/mission-toml.md)."
    )


def _is_value(cell: str) -> bool:
    return re.fullmatch(r"\s*[-+]?[\d.,:/\-T ]*\d[\d.,:/\-eET °'\"′″]*[NSEWZ]?\s*", cell) is not None


def _named(table: Table, quantity: str, *others: str) -> tuple[str, str] | None:
    """A column that may be this quantity, and the unit that its name says."""
    for name in table.columns:
        bare, stated = _bare(name)
        if re.fullmatch(_NAMES[quantity], bare) and name not in others:
            return name, stated
    return None


def _bare(name: str) -> tuple[str, str]:
    """A column's name in lower case, its words parted by underscores, and the unit behind it, if it is known."""
    text, stated = bare_name(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name.strip()))
    text = text.replace(" ", "_")
    before, _, ending = text.rpartition("_")
    if not stated and before and ending in _ENDINGS:
        text, stated = before, ending
    return text, _UNITS.get(stated, "")


# --- times ----------------------------------------------------------------------------------------------------------


def _clock(table: Table) -> _Clock:
    date, time = _named(table, "date"), _named(table, "time")
    if time is None and date is None:
        names = listing("columns", list(table.columns))
        raise MissionError(f"{table.path}: no column looks like a time ({names}). Write a mission.toml by hand.")
    columns = tuple(one[0] for one in (date, time) if one is not None)
    raw = table.joined(columns if len(columns) > 1 else columns[0])
    # a header that is repeated makes texts of numbers
    if len(columns) > 1 or np.isfinite(table.numbers(columns[0])[0]).mean() < 0.5:
        return _dated(table, columns, raw)
    assert time is not None or date is not None
    name, stated = time or date  # type: ignore[misc]
    values = table.numbers(name)[0]
    known = stated if stated and UNITS[stated].dimension == "time" else _unit_of_time(values)
    shown = f', unit = "{known}"' if known != "s" else ""
    if known == "iso8601":
        return _dated(table, (name,), table.raw(name))
    if known == "day":
        values, _ = since_1970(values)
    guess = "" if stated else f"the times are in {known}, by their size"
    return _Clock(f"{{column = {json.dumps(name)}{shown}}}", guess, values * UNITS[known].factor)


def _dated(table: Table, columns: tuple[str, ...], raw: npt.NDArray[Any]) -> _Clock:
    column = json.dumps(columns[0]) if len(columns) == 1 else json.dumps(list(columns))
    line, words = f'{{column = {column}, unit = "iso8601"', "the times are UTC"
    try:
        found = date_seconds(raw, None, None)
    except ValueError as error:
        try:
            found = date_seconds(raw, "dmy", None)
        except ValueError:
            raise MissionError(f"{table.path}: {error}") from None
        line, words = f'{line}, order = "dmy"', f"{words}, and dates are day, month, year"
    return _Clock(f"{line}}}", "; ".join(filter(None, [words, found.note])), found.time_s)


def _unit_of_time(values: Array) -> str:
    """Times since 1970 tell their unit by their size; others are seconds, or milliseconds of a fast instrument."""
    if (told := unit_of_times(values)) != "":
        return told
    steps = np.diff(values[np.isfinite(values)])
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    if step < 0.01 and since_1970(values)[1]:
        return "day"
    return "us" if step >= 1e4 else "ms" if step >= 5.0 else "s"


# --- what the columns are -------------------------------------------------------------------------------------------


def _uses(table: Table, clock: _Clock) -> Iterator[Use]:
    """What the table can give, the preferred first."""
    for give in (_inertial, _headings, _velocity, _water, _depth, _position, _over_ground):
        yield from give(table, clock)


def _use(reading: str, lines: tuple[str, ...], fields: tuple[str, ...], guess: str, where: str = "") -> Use:
    return Use("table", "", reading, lines, fields, where, guess)


def _inertial(table: Table, _: _Clock) -> Iterator[Use]:
    gyro, accel = (found_axes(table, group) for group in ("gyro", "accel"))
    if not (gyro and accel):
        return
    up = float(np.nanmean(table.numbers(accel[2])[0])) > 0.0
    axes = ', axes = "x,-y,-z"' if up else ""
    lines, words = [], []
    for group, names in (("gyro", gyro), ("accel", accel)):
        name = size_of_axes(table, group, names)
        key = "rate" if group == "gyro" else "force"
        lines.append(f'{key} = {{columns = {json.dumps(list(names))}, unit = "{name}"{axes}}}')
        words.append(f"{', '.join(names)} in {name}")
    words.append(f"axes: {'forward, left, up' if up else 'forward, right, down'}, because gravity points that way")
    yield _use("imu", tuple(lines), (*gyro, *accel), "; ".join(words))


def _headings(table: Table, clock: _Clock) -> Iterator[Use]:
    heading = _named(table, "heading")
    if heading is None:
        return
    if (name := _unit_of_angle(table, *heading)) == "":
        return
    north = _which_north(table, clock, heading[0], name)
    roll, pitch = _named(table, "roll"), _named(table, "pitch")
    words = f"{heading[0]} in {name}, from {north} north"
    marks = _marks(table, heading[0], 360.0) if name == "deg" else []
    invalid = f", invalid = {json.dumps(marks)}" if marks else ""
    words += f"; {', '.join(f'{mark:g}' for mark in marks)} for no reading" if marks else ""
    prefix = "magnetic" if north == "magnetic" else ""
    if roll and pitch:
        units = json.dumps([one[1] or name for one in (roll, pitch, heading)])  # small tilts do not tell
        columns = json.dumps([one[0] for one in (roll, pitch, heading)])
        tilt = f"{roll[0]} and {pitch[0]} positive to starboard and bow up"
        line = f"attitude = {{columns = {columns}, unit = {units}{invalid}}}"
        yield _use(f"{prefix}-attitude".lstrip("-"), (line,), (heading[0],), f"{words}; {tilt}")
    line = f'heading = {{column = {json.dumps(heading[0])}, unit = "{name}"{invalid}}}'
    yield _use(prefix or "heading", (line,), (heading[0],), words)


def _velocity(table: Table, _: _Clock) -> Iterator[Use]:
    bare = {_bare(name)[0]: name for name in table.columns}
    for names in _VELOCITIES:
        if all(name in bare for name in names):
            columns = [bare[name] for name in names]
            stated = _bare(columns[0])[1]
            size = float(np.nanquantile(np.abs(table.numbers(columns[0])[0]), 0.99))
            name = stated if stated else "mm/s" if size > _FASTEST_M_S else "m/s"
            line = f'velocity = {{columns = {json.dumps(columns)}, unit = "{name}"}}'
            words = f"{', '.join(columns)}: velocity over ground forward, right, down, in {name}"
            yield _use("velocity", (line,), tuple(columns), words)
            return


def _water(table: Table, _: _Clock) -> Iterator[Use]:
    if (speed := _named(table, "water_speed")) is not None:
        name = speed[1] or "kn"
        columns = f"{json.dumps(speed[0])}, {{constant = 0.0}}, {{constant = 0.0}}"
        line = f'velocity = {{columns = [{columns}], unit = "{name}"}}'
        yield _use("water", (line,), (speed[0],), f"{speed[0]} in {name}, through the water; no leeway: all forward")


def _depth(table: Table, _: _Clock) -> Iterator[Use]:
    if (depth := _named(table, "depth")) is not None:
        values = table.numbers(depth[0])[0]
        up = float(np.nanmedian(values)) < 0.0
        name = depth[1] if depth[1] and UNITS[depth[1]].dimension == "length" else "m"
        line = f'depth = {{column = {json.dumps(depth[0])}, unit = "{name}"{", scale = -1.0" if up else ""}}}'
        yield _use("depth", (line,), (depth[0],), f"{depth[0]}: depth of the vehicle, not of the water, in {name}")
    elif (pressure := _named(table, "pressure")) is not None and pressure[1]:
        values = table.numbers(pressure[0])[0] * unit(pressure[1]).factor
        absolute = float(np.nanmin(values)) > 5e4
        offset = "" if absolute else ', offset = "1013.25 hPa"'
        line = f'pressure = {{column = {json.dumps(pressure[0])}, unit = "{pressure[1]}"{offset}}}'
        words = f"{pressure[0]}: pressure of the water, {'absolute' if absolute else 'above that of the air'}"
        yield _use("pressure" if absolute else "gauge-pressure", (line,), (pressure[0],), words)


def _position(table: Table, _: _Clock) -> Iterator[Use]:
    latitude, longitude = _named(table, "latitude"), _named(table, "longitude")
    if latitude is None or longitude is None:
        return
    names = [_unit_of_place(table, one[0], one[1]) for one in (latitude, longitude)]
    heading = _named(table, "heading")
    small = all(np.nanmax(np.abs(table.numbers(one[0])[0]), initial=0.0) <= math.pi for one in (latitude, longitude))
    if small and not (latitude[1] or longitude[1]) and heading and _unit_of_angle(table, *heading) == "rad":
        names = ["rad", "rad"]  # as the other angles of the table
    whole = [_with_letter(table, latitude[0], "NS"), _with_letter(table, longitude[0], "EW")]
    columns = [json.dumps(w[0]) if len(w) == 1 else f"{{column = {json.dumps(w)}}}" for w in whole]
    units = names
    if "" in names:
        return
    words = f"{latitude[0]}, {longitude[0]} in {names[0]}"
    height = _named(table, "height")
    if height is not None and np.isfinite(table.numbers(height[0])[0]).any():
        columns, units = [*columns, json.dumps(height[0])], [*names, height[1] or "m"]
        words += f"; {height[0]}: its height"
    marks = [_marks(table, one[0], most) for one, most in ((latitude, 90.0), (longitude, 360.0)) if names[0] == "deg"]
    degrees = [table.numbers(one[0])[0] for one in (latitude, longitude)]
    nowhere = (degrees[0] == 0.0) & (degrees[1] == 0.0)
    invalid = sorted(
        {mark for some in marks for mark in some} | ({0.0} if nowhere.any() and not nowhere.all() else set())
    )
    said = f", invalid = {json.dumps(invalid)}" if invalid else ""
    words += f"; {', '.join(f'{mark:g}' for mark in invalid)} for no fix" if invalid else ""
    line = (
        f"position = {{columns = [{', '.join(columns)}], unit = {json.dumps(units)}{said}, invalid_together = false}}"
    )
    yield _use("position", (line,), (latitude[0], longitude[0]), words)


def _marks(table: Table, name: str, most: float) -> list[float]:
    """Numbers that stand for no reading: beyond what an angle may be [deg], or -1 where no other is below zero."""
    values = table.numbers(name)[0]
    levels = np.unique(values[np.isfinite(values)])
    beyond = levels[np.abs(levels) > most].tolist()
    rest = levels[np.abs(levels) <= most]
    lone = [-1.0] if rest.size > 2 and rest[0] == -1.0 and rest[1] >= 0.0 and np.sum(values == -1.0) > 1 else []
    return [*beyond, *lone] if 0 < len(beyond) + len(lone) <= _MOST_MARKS else []


def _over_ground(table: Table, clock: _Clock) -> Iterator[Use]:
    """Speed and course of a receiver: as its velocity, and in place of a log and a compass where there are none."""
    speed, course = _named(table, "ground_speed"), _named(table, "course")
    if speed is None:
        return
    name, why = _unit_of_speed(table, clock, *speed)
    told = f"{speed[0]} in {name}{why}, over ground"
    values = np.abs(table.numbers(speed[0])[0]) * UNITS[name].factor
    under_way = bool(np.isfinite(values).any()) and float(np.nanmedian(values)) >= _SLOWEST_M_S
    angle = "" if course is None else _unit_of_angle(table, *course)
    if course is not None and angle:
        line = f'course = {{columns = {json.dumps([speed[0], course[0]])}, unit = ["{name}", "{angle}"]}}'
        words = f"{told}; {course[0]} in {angle}, its course, from true north"
        yield _use("ground-velocity", (line,), (speed[0], course[0]), words)
    if course is not None and angle and under_way:
        columns = f"{{constant = 0.0}}, {{constant = 0.0}}, {json.dumps(course[0])}"
        words = f"the heading is {course[0]}, the course over ground: no column is a heading"
        yield _use("course", (f'attitude = {{columns = [{columns}], unit = "{angle}"}}',), (course[0],), words)
    if under_way:
        columns = f"{json.dumps(speed[0])}, {{constant = 0.0}}, {{constant = 0.0}}"
        line = f'velocity = {{columns = [{columns}], unit = "{name}"}}'
        yield _use("speed", (line,), (speed[0],), f"{told}, is taken as all forward: there is no log")


def _unit_of_speed(table: Table, clock: _Clock, name: str, stated: str) -> tuple[str, str]:
    """Unit of a speed over ground, and how that is known: its name, else the way between the fixes, else its kind."""
    if stated and UNITS[stated].dimension == "speed":
        return stated, ""
    usual = "kn" if "sog" in name.lower() else "m/s"
    fixes = _places(table)
    if fixes is None:
        return usual, ""
    moved, _ = _moves(clock.time_s, *fixes)
    speed = np.abs(table.numbers(name)[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        known = np.abs(moved)[np.abs(moved) > _SLOWEST_M_S], speed[speed > 0.0]
    if min(part.size for part in known) < _COURSES:
        return usual, ""
    factor = float(np.median(known[0]) / np.median(known[1]))
    nearest = min(_SPEEDS, key=lambda unit: abs(math.log(factor / UNITS[unit].factor)))
    return (nearest, ", by the fixes") if abs(factor / UNITS[nearest].factor - 1.0) < _WITHIN else (usual, "")


def _unit_of_angle(table: Table, name: str, stated: str) -> str:
    if stated and UNITS[stated].dimension == "angle":
        return stated
    angle = np.abs(table.numbers(name)[0])
    few = np.unique(angle[angle > _WHOLE_DEG]).size <= _MOST_MARKS  # they are marks for no reading
    usual = angle[angle <= _WHOLE_DEG] if few and (angle <= _WHOLE_DEG).any() else angle
    largest = float(np.nanmax(usual, initial=0.0))
    sizes = (("rad", 2.0 * math.pi + 0.01), ("deg", _WHOLE_DEG), ("", 3610.0), ("cdeg", 36100.0))
    return next((unit for unit, most in sizes if largest <= most), "")


def _unit_of_place(table: Table, name: str, stated: str) -> str:
    if stated and UNITS[stated].dimension == "angle":
        return stated
    raw = table.raw(name)
    if raw.dtype.kind in "OUT":
        degrees, plain = angles(raw, "ddmm"), angles(raw, "deg")
        if np.isnan(plain).all():
            return ""
        whole = np.nanmedian(np.abs(plain))
        return "ddmm" if whole > 180.0 or (np.isfinite(degrees).all() and whole > 90.0) else "deg"
    largest = float(np.nanmedian(np.abs(table.numbers(name)[0])))
    return "degE7" if largest > 1e6 else "ddmm" if largest > 180.0 else "deg"


def _with_letter(table: Table, name: str, letters: str) -> tuple[str, ...]:
    """A column of latitudes or longitudes, with the letters of the half of the Earth where they stand behind it."""
    behind = list(table.columns)[list(table.columns).index(name) + 1 :][:1]
    cells = {str(cell).strip().upper() for one in behind for cell in table.raw(one).tolist()} - {"", "NAN"}
    return (name, *behind) if cells and cells <= set(letters) else (name,)


def _places(table: Table) -> tuple[Array, Array] | None:
    """Latitudes and longitudes [deg], if there are columns of both."""
    pairs = (("latitude", "NS"), ("longitude", "EW"))
    named = [(_named(table, quantity), letters) for quantity, letters in pairs]
    found = []
    for one, letters in named:
        if one is None or (unit := _unit_of_place(table, *one)) == "":
            return None
        degrees = angles(table.joined(_with_letter(table, one[0], letters)), unit)
        found.append(1e-7 * degrees if unit == "degE7" else degrees)
    return found[0], found[1]


def _which_north(table: Table, clock: _Clock, heading: str, name: str) -> str:
    """Whether a heading counts from magnetic north: by its name, else by the course over ground and the declination."""
    if re.search(r"mag|hdm", heading.lower()):
        return "magnetic"
    if re.search(r"true|hdt", heading.lower()):
        return "true"
    fixes = _places(table)
    moment = float(np.nanmedian(clock.time_s))
    if fixes is None or not 1e9 < moment < 4.1e9:
        return "magnetic" if re.search(r"compass|hdg", heading.lower()) else "true"
    north, east = fixes
    off, count = _course_off(clock.time_s, north, east, angles(table.raw(heading), name) * UNITS[name].factor)
    day = believable(datetime.datetime.fromtimestamp(moment, datetime.UTC).date())
    turned = declination(float(np.nanmedian(north)), float(np.nanquantile(east, 0.5, method="nearest")), 0.0, day)
    if count < _COURSES or abs(turned) < _APART:
        return "magnetic" if re.search(r"compass|hdg", heading.lower()) else "true"
    return "magnetic" if abs(off - turned) < abs(off) else "true"


def _course_off(time_s: Array, latitude: Array, longitude: Array, heading: Array) -> tuple[float, int]:
    """By how much the course over ground is to the right of the heading, mostly [rad], and of how many readings."""
    if np.count_nonzero(known := np.isfinite(np.column_stack([latitude, longitude, heading])).all(axis=1)) < 3:
        return 0.0, 0
    moved, at = _moves(time_s[known], latitude[known], longitude[known])
    speed, heading = np.abs(moved), heading[known][at]
    fast = (speed > 0.5) & (speed < 30.0)
    apart = np.exp(1j * (np.angle(moved) - heading))[fast]
    if not apart.size:
        return 0.0, 0
    middle = float(np.angle(apart.sum()))
    return middle + float(np.median(np.angle(apart * np.exp(-1j * middle)))), int(fast.sum())


def _moves(time_s: Array, latitude: Array, longitude: Array) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.intp]]:
    """Velocities between fixes [deg], north + i east [m/s], each over two steps, and the rows in their middle."""
    moved = np.r_[True, (np.diff(latitude) != 0.0) | (np.diff(longitude) != 0.0)]
    good = np.flatnonzero(moved & np.isfinite(np.column_stack([time_s, latitude, longitude])).all(axis=1))
    step_s, up, right = (x[good[2:]] - x[good[:-2]] for x in (time_s, latitude, longitude))
    right = (right + 180.0) % 360.0 - 180.0
    metres = 111.2e3 * (up + 1j * right * math.cos(math.radians(float(np.nanmedian(latitude)))))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(metres / step_s), good[1:-1]

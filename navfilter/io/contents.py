"""What streams of files may consist of, as the kinds of drives and sensors state it, and other forms of the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from navfilter.models.mechanisation import Mechanisation
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.traits import Columns, kinds_below

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

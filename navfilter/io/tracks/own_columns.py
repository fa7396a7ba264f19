"""Tables as a user's own software wants them: columns, order, names, numbers and separators from a file."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from navfilter.foundation.atomic_files import pieces, replacing
from navfilter.io.validation import Strict, at_least_one, read_toml, validate
from navfilter.track.heave import heave
from navfilter.track.track import Track

_BREAKS = {"tab": "\t", "blank": " "}


class FormatError(ValueError):
    """A format file cannot be read, or asks for what there is not."""

    code = "format"


class Column(Strict):
    """One column.

    SI or degrees as in track.csv: written is ``scale * value + offset``.
    """

    of: str
    name: str | None = None
    format: str = ".6f"
    scale: float = 1.0
    offset: float = 0.0

    @field_validator("format")
    @classmethod
    def _formats(cls, value: str) -> str:
        try:
            if "%" not in value:
                format(1.0, value)
        except ValueError:
            raise ValueError(
                'must be a format of Python for a number, such as ".3f", or of a date: "%H:%M:%S"'
            ) from None
        return value


class OwnFormat(Strict):
    """A whole format file."""

    file: str
    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    header: bool = True
    head: tuple[str, ...] = ()
    heave_period_s: float = Field(default=30.0, gt=0)
    columns: Annotated[tuple[Column, ...], AfterValidator(at_least_one("a table needs at least one column"))]

    @field_validator("file")
    @classmethod
    def _plain(cls, value: str) -> str:
        if Path(value).name != value or value.startswith("."):
            raise ValueError("must be the name of a file, without a folder")
        return value


def read_format(path: str | Path) -> OwnFormat:
    """Read a format file.

    Raises
    ------
    FormatError
        In one line where one thing is wrong; several mistakes are listed together.
    """
    path = Path(path)
    return validate(OwnFormat, read_toml(path, FormatError), path, FormatError)


def write_own(track: Track, folder: Path, form: OwnFormat) -> Path:
    """Write the table that a format asks for.

    Parameters
    ----------
    track : Track
    folder : Path
        Where `OwnFormat.file` is written to.
    form : OwnFormat

    Raises
    ------
    FormatError
        For a column that this track has not.
    """
    path, between = folder / form.file, _BREAKS.get(form.delimiter, form.delimiter)
    up = heave(track, form.heave_period_s) if any(c.of == "heave_m" for c in form.columns) else None
    with replacing(path) as file:
        file.writelines(f"{line}\n" for line in form.head)
        if form.header:
            file.write(between.join(column.name or column.of for column in form.columns) + "\n")
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            north, east = (frame[f"velocity_{axis}_m_s"] for axis in ("north", "east"))
            frame["speed_m_s"], frame["course_deg"] = np.hypot(north, east), np.degrees(np.arctan2(east, north)) % 360.0
            if up is not None:
                frame["heave_m"] = up[rows]
            cells = [_cells(frame, column, form) for column in form.columns]
            file.writelines(between.join(row) + "\n" for row in zip(*cells, strict=True))
    return path


def _cells(frame: Any, column: Column, form: OwnFormat) -> list[str]:
    if column.of not in frame.columns:
        utc = " (UTC is unknown: give epoch in the mission.toml)" if column.of == "time_utc" else ""
        have = ", ".join(frame.columns)
        raise FormatError(f'{form.file}: there is no column "{column.of}"{utc}. There are: {have}, heave_m.')
    if column.of == "time_utc":
        wanted = column.format if "%" in column.format else "%Y-%m-%dT%H:%M:%S.%fZ"
        return [str(text) for text in frame["time_utc"].dt.strftime(wanted)]
    if "%" in column.format:
        raise FormatError(f'{form.file}: "{column.of}" is a number; its format is such as ".3f".')
    values = (column.scale * frame[column.of].to_numpy(dtype=float) + column.offset).tolist()
    texts = [format(value, column.format) for value in values]
    return [text.replace(".", ",") for text in texts] if form.decimal == "," else texts

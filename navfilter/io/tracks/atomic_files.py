"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

#: Rows that are worked on at a time: a long track costs no second one in memory.
ROWS = 5_000


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[TextIO]:
    """Write text beside the file and move it there at the end: nobody ever reads half a file."""
    with _part(Path(path)) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        yield file


@contextmanager
def replacing_binary(path: str | os.PathLike[str]) -> Iterator[Any]:
    """The same with bytes."""
    with _part(Path(path)) as part, part.open("wb") as file:
        yield file


@contextmanager
def _part(path: Path) -> Iterator[Path]:
    part = path.with_name(path.name + ".part")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def replaced_by(folder: Path) -> Iterator[Path]:
    """A place for files that are moved to a folder, each whole, once all are there."""
    with tempfile.TemporaryDirectory(prefix=".navfilter-", dir=folder) as beside:
        yield Path(beside)
        for file in sorted(Path(beside).iterdir()):
            file.replace(folder / file.name)


@contextmanager
def replacing_tree(path: Path, mark: str) -> Iterator[Path]:
    """A folder to make in place of `path`, of the same name.

    Raises
    ------
    ValueError
        When something else stands at `path`: a file, or a folder without the file `mark`.
    """
    if path.exists() and not (path / mark).is_file():
        raise ValueError(f"{path} is there, and is no folder with a {mark}: it is not replaced. Give another name.")
    with tempfile.TemporaryDirectory(prefix=".navfilter-", dir=path.parent) as beside:
        yield Path(beside) / path.name
        if path.exists():
            shutil.rmtree(path)
        (Path(beside) / path.name).replace(path)


def pieces(rows: int, size: int = ROWS) -> Iterator[slice]:
    """Slices that together are so many rows."""
    yield from (slice(begin, min(begin + size, rows)) for begin in range(0, rows, size))

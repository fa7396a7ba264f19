"""Files that are there whole or not at all."""

import io
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
    with replacing_binary(path) as raw, io.TextIOWrapper(raw, "utf-8", newline="\n") as file:
        yield file


@contextmanager
def replacing_binary(path: str | os.PathLike[str], *, synced: bool = False) -> Iterator[Any]:
    """The same with bytes; synced: whatever happens, even to the power, one whole file stands there.

    Neither is a link followed that lies beside the file, nor a pipe waited for.
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    try:
        with part.open("xb") as file:
            yield file
            if synced:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    if synced:
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


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

"""How far files from elsewhere are trusted: what they may unpack to, where they may lie, what messages say of them."""

import bz2
import gzip
import lzma
import os
import re
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navfilter.models.mission import MissionError

#: All that the compressed files of one mission may unpack to: a month of inertial samples at 100 Hz is 14 GB, a day
#: half a GB.
UNPACKED_BYTES = 4 << 30
#: What opens a compressed file, by the end of its name, and what it raises for one that is damaged.
OPENERS: dict[str, Any] = {".gz": gzip.open, ".xz": lzma.open, ".bz2": bz2.open}
BROKEN = (OSError, EOFError, lzma.LZMAError, zlib.error)


class Allowance:
    """Bytes that may still be unpacked; shared by all files of a mission.

    Parameters
    ----------
    unpacked_bytes : int
    """

    def __init__(self, unpacked_bytes: int = UNPACKED_BYTES) -> None:
        self._whole = self.left = unpacked_bytes

    def take(self, size: int) -> None:
        """So many bytes are about to be unpacked, or have been.

        Raises
        ------
        MissionError
            When that is more than is left.
        """
        self.left -= size
        self.has(0)

    def has(self, size: int) -> None:
        """So many bytes are about to be unpacked, and forgotten before the next: a piece of a log.

        Raises
        ------
        MissionError
            When that is more than is left.
        """
        if size > self.left:
            raise MissionError(
                f"it unpacks to more than {self._whole / (1 << 30):.3g} GiB"
                " (all compressed files of a mission together). If that is right, raise the limit with --max-unpacked."
            )


@dataclass(frozen=True)
class Place:
    """A file, and how it may be spoken of.

    Parameters
    ----------
    path : Path
        Where it is.
    shown : str
        As messages show it; without the values of environment variables.
    quoted : bool
        Whether messages may show what is written in it.
    allowance : Allowance
    """

    path: Path
    shown: str
    quoted: bool = True
    allowance: Allowance = field(default_factory=Allowance, compare=False)

    @classmethod
    def of(cls, path: Path) -> "Place":
        """A file that the user named."""
        return cls(path, str(path))

    @classmethod
    def of_mission(cls, file: str, folder: Path, confine: bool, allowance: Allowance) -> "Place":
        """A file that a mission.toml names (see `expand`).

        Raises
        ------
        MissionError
            When a variable is not set, or `confine` and the file lies outside the folder.
        """
        varies = re.search(r"[$~]", file) is not None
        if confine and varies:
            raise MissionError(
                f'"{file}": a confined mission names no variables and no homes. Leave out --confine if you trust it.'
            )
        path = expand(file, folder)
        inside = path.resolve().is_relative_to(folder.resolve())
        if confine and not inside:
            raise MissionError(f'"{file}" leads out of the folder of the mission. Leave out --confine if you trust it.')
        return cls(path, file if varies else str(path), inside, allowance)


def expand(path: str, folder: Path) -> Path:
    """A path of a .toml: ``${NAME}`` is taken from the environment, the rest is relative to the folder of the .toml."""

    if "\0" in path:
        raise MissionError(f"{path!r} is no name of a file: it has a zero byte. Write the name without it.")

    def value(match: re.Match[str]) -> str:
        name = match.group(1) or match.group(2)
        if name not in os.environ:
            raise MissionError(f'the environment variable {name} is not set; set it to the folder that "{path}" means.')
        return os.environ[name]

    expanded = re.sub(r"\$\{(\w+)\}|\$(\w+)", value, path)
    return folder / Path(expanded).expanduser()

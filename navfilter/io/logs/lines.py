"""Lines of a text log, plain or compressed, one at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from navfilter.io.logs.progress import byte_bar
from navfilter.io.trust import BROKEN, OPENERS, Allowance
from navfilter.models.mission import MissionError

#: Read at a time; a longer "line" than the second is no line of text.
_BLOCK, _LONGEST = 1 << 18, 1 << 16


def lines(path: Path, tally: Counter[str], allowance: Allowance) -> Iterator[bytes]:
    """All lines, without their ends (LF, CR LF or CR).

    A compressed file that is cut short gives what it holds, and is counted.

    Raises
    ------
    MissionError
        When a compressed file has more than it may unpack to.
    """
    with path.open("rb") as raw, byte_bar(path, path.stat().st_size) as bar:
        opener = OPENERS.get(path.suffix.lower())
        file = raw if opener is None else opener(raw, "rb")
        rest, told = b"", 0
        try:
            while block := file.read1(_BLOCK):
                if file is not raw:
                    _take(path, allowance, len(block))
                *whole, rest = (rest + block).splitlines(keepends=True)
                if rest.endswith(b"\n"):
                    whole, rest = [*whole, rest], b""
                for line in whole:
                    yield line.rstrip(b"\r\n")
                if len(rest) > _LONGEST:
                    yield rest.rstrip(b"\r\n")
                    rest = b""
                at = raw.tell()
                bar.update(at - told)
                told = at
        except BROKEN:
            tally["place where the file is damaged or cut short, nothing read behind it"] += 1
        if rest:
            yield rest.rstrip(b"\r\n")


def _take(path: Path, allowance: Allowance, size: int) -> None:
    try:
        allowance.take(size)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from None


def first_bytes(path: Path, most: int = 1 << 16) -> bytes:
    """The first bytes, unpacked; of a broken file as many as it has."""
    found = b""
    try:
        with OPENERS.get(path.suffix.lower(), open)(path, "rb") as file:
            while len(found) < most and (piece := file.read(4096)):
                found += piece
    except BROKEN:
        pass
    return found

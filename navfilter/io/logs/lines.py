"""Lines of a text log, plain or compressed, one at a time."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from navfilter.io.trust import BROKEN, OPENERS, Allowance
from navfilter.models.mission import MissionError

#: Read at a time; a longer "line" than the second is no line of text.
_BLOCK, _LONGEST = 1 << 18, 1 << 16
Item = TypeVar("Item")
#: Reading that is done sooner shows no bar [s].
_PATIENCE_S = 1.0


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


# --- progress --------------------------------------------------------------------------------------------------------


def bar(items: Iterable[Item], path: Path, total: int | None, unit: str) -> Iterator[Item]:
    """Pass items on, with a bar on standard error where that is a terminal and reading takes long."""
    from tqdm import tqdm

    yield from tqdm(
        items,
        desc=path.name,
        total=total,
        unit=f" {unit}",
        delay=_PATIENCE_S,
        disable=None,
        leave=False,
        unit_scale=True,
    )


def byte_bar(path: Path, total: int) -> Any:
    """A bar of bytes, to be told of progress with ``update(bytes)`` and closed."""
    from tqdm import tqdm

    return tqdm(desc=path.name, total=total, unit="B", unit_scale=True, delay=_PATIENCE_S, disable=None, leave=False)

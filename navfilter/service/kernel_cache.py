"""The compiled kernels on disk: found damaged they are compiled again, and where nothing can be kept that is said in one line.

numba believes its files: one that a power cut left torn ends every start, and one with wrong bytes inside ends the process. So a list of
checksums is written beside them when a warm-up has succeeded, and held against them before the next start.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import hashlib
import importlib
import json
import os
import pickletools
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = ["LIST", "compile_kernels", "discard_damaged", "make_usable", "seal", "warm"]

#: File of the checksums, in the folder of the kernels.
LIST = "navfilter-kernels.json"
#: A cache needs about so much [bytes]; on a fuller disk numba would fail in the middle of a compilation.
ROOM = 64 << 20

#: Any file of kernels: all are kept in one folder.
_ANY = "navfilter.kernels.measurement"

Say = Callable[[str], None]


def make_usable(say: Say) -> None:
    """Before the first kernel is imported: find a folder to keep them in, and discard damaged ones.

    Where neither the package's own folder nor the user's can be written, a temporary one serves this process.

    Raises
    ------
    OSError
        When there is no temporary folder either.
    """
    from numba import config

    try:
        folder = _folder()
    except RuntimeError:  # of numba: no folder can be written
        folder = None
    if folder is not None and (_room(folder) or (folder / LIST).exists()):
        if damaged := discard_damaged(folder):
            say(f"{damaged} damaged files of compiled kernels discarded in {folder}; they are compiled again.")
        return
    why = "no folder for them can be written" if folder is None else f"the disk of {folder} is full"
    say(f"compiled kernels cannot be kept ({why}): every start compiles. Set NUMBA_CACHE_DIR to a folder that can be written.")
    settings: Any = config
    settings.CACHE_DIR = tempfile.mkdtemp(prefix="navfilter-kernels-")
    atexit.register(shutil.rmtree, settings.CACHE_DIR, ignore_errors=True)
    sys.modules.pop(_ANY, None)  # numba has chosen its folder when it was imported


def compile_kernels(say: Say) -> None:
    """Compile, or load what has been compiled; kernels that cannot be loaded are compiled again."""
    from navfilter.playback import warm_up

    folder = _folder()
    try:
        warm_up()
    except Exception as error:  # of numba, llvmlite or pickle, whatever a damaged file makes of them
        if folder is None or not _files(folder):
            raise
        say(f"the compiled kernels in {folder} cannot be used ({type(error).__name__}: {error}); compiling them again")
        _remove(_files(folder))
        warm_up()
    if folder is not None:
        seal(folder)


def warm(say: Say) -> None:
    """Make everything ready for a live run."""
    say("warming up ...")
    began = time.perf_counter()
    compile_kernels(say)
    # What is here now stays: the collector need not look at it again and again.
    gc.collect()
    gc.freeze()
    say(f"ready ({time.perf_counter() - began:.1f} s)")


def discard_damaged(folder: Path) -> int:
    """Remove the kernels that are not what the list says, and those on no list that are torn; how many there were."""
    sums = _sums(folder)
    damaged = [path for path in _files(folder) if _is_damaged(path, sums.get(path.name))]
    _remove(damaged)
    return len(damaged)


def seal(folder: Path) -> None:
    """Write the list of checksums, when what lies there has changed; a folder that cannot be written is left as it is."""
    with contextlib.suppress(OSError):
        sums = {path.name: _digest(path) for path in _files(folder)}
        if sums == _sums(folder):
            return
        for path in _files(folder):
            with path.open("rb") as file:  # on the disk before the list says that it is
                os.fsync(file.fileno())
        part = folder / f"{LIST}.{os.getpid()}.part"
        part.write_text(json.dumps(sums), encoding="utf-8")
        part.replace(folder / LIST)


def _folder() -> Path | None:
    """Where numba keeps the kernels; None where nothing is compiled."""
    kernel = importlib.import_module(_ANY).heading
    return Path(kernel.stats.cache_path) if hasattr(kernel, "stats") else None


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.nb[ic]") if path.is_file())


def _remove(paths: list[Path]) -> None:
    for path in paths:
        with contextlib.suppress(OSError):
            path.unlink()


def _room(folder: Path) -> bool:
    return shutil.disk_usage(folder).free >= ROOM


def _sums(folder: Path) -> dict[str, str]:
    """The list; empty where there is none that can be read."""
    try:
        sums = json.loads((folder / LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return sums if isinstance(sums, dict) else {}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_damaged(path: Path, known: str | None) -> bool:
    try:
        return _digest(path) != known if known is not None else not _is_whole(path)
    except OSError:
        return False


def _is_whole(path: Path) -> bool:
    """Whether a file that is on no list has the form that numba writes: one pickle, or two in an index. Nothing of it is executed."""
    data = memoryview(path.read_bytes())
    try:
        for _ in range(2 if path.suffix == ".nbi" else 1):
            data = data[_end_of_pickle(data) :]
    except Exception:  # pickletools raises many unrelated types on garbage
        return False
    return not data


def _end_of_pickle(data: memoryview) -> int:
    stop: Iterator[int] = (at + 1 for code, _, at in pickletools.genops(bytes(data)) if at is not None and code.name == "STOP")
    return next(stop)

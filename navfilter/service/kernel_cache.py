"""The compiled kernels on disk: damaged ones are compiled again, and where none can be kept that is said in one line.

numba believes its files: one that a power cut left torn ends every start, and one with wrong bytes inside ends the
process. So a list of checksums is written beside them when a warm-up has succeeded, and held against them before the
next start.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import hashlib
import importlib
import json
import os
import pickle
import pickletools
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from navfilter.models.vehicle import Vehicle

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

    from navfilter.kernels.compiling.progress import FILTER, is_compiled
    from navfilter.kernels.compiling.shipped import SHIPPED

    try:
        folder = _folder()
    except RuntimeError:  # of numba: no folder can be written
        folder = None
    for shipped in [each for each in SHIPPED if each != folder and _damaged(each)]:
        say(f"damaged files of compiled kernels in {shipped}, which cannot be written: none of them is used.")
        SHIPPED.remove(shipped)
    if folder is not None and (_files(folder) or _room(folder)):
        if damaged := discard_damaged(folder):
            say(f"{damaged} damaged files of compiled kernels discarded in {folder}; they are compiled again.")
        return
    if not is_compiled(*FILTER):
        why = "no folder for them can be written" if folder is None else f"the disk of {folder} is full"
        say(
            f"compiled kernels cannot be kept ({why}): every start compiles."
            " Set NUMBA_CACHE_DIR to a folder that can be written."
        )
    settings: Any = config
    settings.CACHE_DIR = tempfile.mkdtemp(prefix="navfilter-kernels-")
    atexit.register(shutil.rmtree, settings.CACHE_DIR, ignore_errors=True)
    sys.modules.pop(_ANY, None)  # numba has chosen its folder when it was imported


def compile_kernels(say: Say, vehicle: Vehicle | None = None, *, smoother: bool = True) -> None:
    """Compile, or load what has been compiled; kernels that cannot be loaded are compiled again.

    Given a vehicle, only what that one needs; without what only the smoother needs, if so asked.
    """
    from navfilter.playback.warm_up import warm_up

    folder = _folder()
    try:
        with warnings.catch_warnings(record=True) as unkept:
            warm_up(vehicle, smoother=smoother)
        for text in sorted({str(warning.message) for warning in unkept}):
            say(text)
    except Exception as error:  # of numba, llvmlite or pickle, whatever a damaged file makes of them
        if folder is None or not _files(folder):
            raise
        say(f"the compiled kernels in {folder} cannot be used ({type(error).__name__}: {error}); compiling them again")
        _remove(_files(folder))
        warm_up(vehicle, smoother=smoother)
    if folder is not None:
        seal(folder)


def warm(say: Say, vehicle: Vehicle) -> None:
    """Make everything ready for a live run of a vehicle."""
    say("warming up ...")
    began = time.perf_counter()
    compile_kernels(say, vehicle, smoother=False)
    # What is here now stays: the collector need not look at it again and again.
    gc.collect()
    gc.freeze()
    say(f"ready ({time.perf_counter() - began:.1f} s)")


def discard_damaged(folder: Path) -> int:
    """Remove compiled kernels that are not what the list says, and torn ones on no list; how many there were."""
    sums, damaged = _sums(folder), _damaged(folder)
    _remove(damaged)
    if any(path.name in sums for path in damaged):
        with contextlib.suppress(OSError):  # what is compiled now is another file of the same name
            _write(folder, {name: digest for name, digest in sums.items() if (folder / name).exists()})
    return len(damaged)


def _damaged(folder: Path) -> list[Path]:
    sums = _sums(folder)
    return [path for path in _files(folder) if _is_damaged(path, sums)]


def seal(folder: Path) -> None:
    """Write the list of checksums, when what lies there has changed and the folder can be written."""
    with contextlib.suppress(OSError):
        sums = {path.name: _digest(path) for path in _files(folder) if path.suffix == ".nbc"}
        if sums == _sums(folder):
            return
        for path in _files(folder):
            with path.open("rb") as file:  # on the disk before the list says that it is
                os.fsync(file.fileno())
        _write(folder, sums)


def _write(folder: Path, sums: dict[str, str]) -> None:
    part = folder / f"{LIST}.{os.getpid()}.part"
    kept = {name: [digest, _source(name)] for name, digest in sums.items()}
    part.write_text(json.dumps(kept), encoding="utf-8")
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
    """Checksums by name; empty where there is no list that can be read.

    Those of a kernel whose source has changed say nothing: it has been, or will be, compiled anew.
    """
    try:
        kept = json.loads((folder / LIST).read_text(encoding="utf-8"))
        return {name: digest for name, (digest, source) in kept.items() if source == _source(name)}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _source(name: str) -> str:
    """Checksum of the module that a file of compiled code belongs to, and of what that imports."""
    from navfilter.kernels.compiling.decorators import checksum

    return checksum(f"navfilter.kernels.{name.split('.')[0]}")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_damaged(path: Path, sums: dict[str, str]) -> bool:
    """An index changes with every signature that is added: that it can be read is enough. Code must be what it was."""
    try:
        if path.suffix == ".nbi":
            return not _is_index(path)
        return _digest(path) != sums[path.name] if path.name in sums else not _is_pickle(path.read_bytes())
    except OSError:
        return False


def _is_index(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            pickle.load(file)
            _, names = pickle.load(file)
            return isinstance(names, dict) and not file.read(1)
    except OSError:
        raise
    except Exception:  # pickle raises many unrelated types on garbage
        return False


def _is_pickle(data: bytes) -> bool:
    """Whether this is one pickle from its beginning to its end; nothing of it is executed."""
    try:
        return any(code.name == "STOP" and at == len(data) - 1 for code, _, at in pickletools.genops(data))
    except Exception:  # as above
        return False

"""What is being compiled, shown while it is: the first use of the kernels takes a while, and something moves."""

import pickle
import sys
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import event

from navfilter.kernels.compiling.decorators import checksum
from navfilter.kernels.compiling.shipped import SHIPPED

#: Elsewhere than on a terminal one line is written in so many seconds [s].
_EVERY_S = 10.0
_WIDTH = 79
_KERNELS = "navfilter.kernels."
_FOLDER = Path(__file__).parents[1]
#: Files of kernels that every filter needs.
FILTER = ("strapdown", "kalman", "measurement")
#: Files of kernels that no navigation needs: `navfilter identify --online` does.
_APART = {"recursive_arma", "recursive_arma_window"}


class _Shown(event.Listener):
    """Writes which kernel is being compiled, how many are done and how long it has taken, to standard error."""

    def __init__(self) -> None:
        self.depth, self.done, self.most, self.began, self.said_s = 0, 0, 0, 0.0, 0.0

    def on_start(self, found: event.Event) -> None:
        if not self.done and not self.depth:
            self.began = self.said_s = time.monotonic()
        self.depth += 1
        function = found.data["dispatcher"].py_func
        now = time.monotonic()
        if function.__module__.startswith("navfilter.") and (sys.stderr.isatty() or now - self.said_s >= _EVERY_S):
            self.said_s = now
            name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
            self._say(
                f"compiling, once: {self.progress()} in {now - self.began:.0f} s{self._left(now)}, now {name} ..."
            )

    def on_end(self, found: event.Event) -> None:
        self.depth -= 1
        self.done += found.data["dispatcher"].py_func.__module__.startswith("navfilter.")
        if not self.depth and sys.stderr.isatty():
            self._say(f"compiling, once: {self.progress()} done in {time.monotonic() - self.began:.0f} s", end="\r")

    def _left(self, now: float) -> str:
        """By what it has taken so far: kernels take about as long as each other, ten of them say it."""
        left_s = (now - self.began) * (self.most - self.done) / max(self.done, 1)
        return f", {left_s:.0f} s left" if 10 <= self.done < self.most else ""

    def progress(self) -> str:
        return f"{self.done} of at most {self.most} kernels" if self.most >= self.done else f"{self.done} kernels"

    def _say(self, text: str, end: str | None = None) -> None:
        terminal = sys.stderr.isatty()
        text = text[:_WIDTH].ljust(_WIDTH) if terminal else text
        print(text, end=end or ("\r" if terminal else "\n"), file=sys.stderr, flush=True)


class _Told(event.Listener):
    """Tells whoever started this process of each kernel that is compiled: a line each on standard output."""

    def on_start(self, found: event.Event) -> None:
        pass

    def on_end(self, found: event.Event) -> None:
        if found.data["dispatcher"].py_func.__module__.startswith(_KERNELS):
            print("kernel", flush=True)


@cache
def show_compilation() -> _Shown:
    """Show on standard error, from now on, whatever numba has to compile; what is cached is not compiled.

    On a terminal one line says which kernel it is, and how many are done; elsewhere a line is written every ten
    seconds.
    """
    shown = _Shown()
    event.register("numba:compile", shown)
    return shown


def announce_each() -> None:
    """Write a line on standard output for each kernel that this process compiles: what `count_announced` reads."""
    event.register("numba:compile", _Told())


def count_announced(lines: Iterable[str], most: int) -> None:
    """Count what another process compiles with what is compiled here, and say what all may compile at most."""
    shown = expect(most)
    for _ in lines:
        shown.done += 1


def expect(most: int) -> _Shown:
    """Let what is shown say how many kernels may be compiled, and how long it will take."""
    shown = show_compilation() if show_compilation.cache_info().currsize else _Shown()  # else nobody looks
    shown.most = most
    return shown


def is_compiled(*files: str) -> bool:
    """Whether numba has kept kernels of each of these files of `navfilter.kernels` as it is, for this processor."""
    from numba import config
    from numba.core.registry import cpu_target

    settings: Any = config
    if settings.DISABLE_JIT:
        return True
    folders = [Path(settings.CACHE_DIR)] if settings.CACHE_DIR else [Path.home() / ".cache" / "numba"]
    processor = cpu_target.target_context.codegen().magic_tuple()
    tag = f".py{sys.version_info.major}{sys.version_info.minor}."
    indices = [i for folder in (*SHIPPED, *folders) for i in folder.rglob("*.nbi") if tag in i.name]
    return all(
        any(i.name.startswith(f"{name}.") and _holds(i, checksum(_KERNELS + name), processor) for i in indices)
        for name in files
    )


def _holds(index: Path, stamp: str, processor: tuple[str, ...]) -> bool:
    """Whether an index of numba's is of this source, and has a kernel for this processor."""
    try:
        with index.open("rb") as file:
            pickle.load(file)
            found, kept = pickle.load(file)
            return found == stamp and any(key[1] == processor for key in kept)
    except Exception:  # pickle raises many unrelated types on garbage
        return False


def kernel_count(*files: str) -> int:
    """How many kernels these files of `navfilter.kernels` hold, those left out that are compiled within others.
    Default: all that navigation may need.
    """
    import importlib

    names = files or {file.stem for file in _FOLDER.glob("[a-z]*.py")} - _APART
    modules = [importlib.import_module(_KERNELS + name) for name in names]
    kernels = {function for module in modules for function in vars(module).values() if hasattr(function, "py_func")}
    own = {_KERNELS + name for name in names}
    return sum(k.targetoptions.get("inline") != "always" for k in kernels if k.py_func.__module__ in own)

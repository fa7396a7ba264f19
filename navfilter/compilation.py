"""What is being compiled, shown while it is: the first use of the kernels takes a minute, and something moves."""

from __future__ import annotations

import sys
import time
from functools import cache

from numba.core import event

__all__ = ["show_compilation"]

#: Elsewhere than on a terminal one line is written in so many seconds [s].
_EVERY_S = 10.0
_WIDTH = 79


class _Shown(event.Listener):
    """Writes which kernel is being compiled, how many are done and how long it has taken, to standard error."""

    def __init__(self) -> None:
        self.depth, self.done, self.began, self.said_s = 0, 0, 0.0, 0.0

    def on_start(self, found: event.Event) -> None:
        if not self.done and not self.depth:
            self.began = self.said_s = time.monotonic()
        self.depth += 1
        function = found.data["dispatcher"].py_func
        now = time.monotonic()
        if function.__module__.startswith("navfilter.") and (sys.stderr.isatty() or now - self.said_s >= _EVERY_S):
            self.said_s = now
            name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
            self._say(f"compiling, once: {self.done} kernels done in {now - self.began:.0f} s, now {name} ...")

    def on_end(self, found: event.Event) -> None:
        self.depth -= 1
        self.done += found.data["dispatcher"].py_func.__module__.startswith("navfilter.")
        if not self.depth and sys.stderr.isatty():
            self._say(f"compiling, once: {self.done} kernels done in {time.monotonic() - self.began:.0f} s", end="\r")

    def _say(self, text: str, end: str | None = None) -> None:
        terminal = sys.stderr.isatty()
        text = text[:_WIDTH].ljust(_WIDTH) if terminal else text
        print(text, end=end or ("\r" if terminal else "\n"), file=sys.stderr, flush=True)


@cache
def show_compilation() -> None:
    """Show on standard error, from now on, whatever numba has to compile; what is cached is not compiled.

    On a terminal one line says which kernel it is, and how many are done; elsewhere a line is written every ten
    seconds.
    """
    event.register("numba:compile", _Shown())

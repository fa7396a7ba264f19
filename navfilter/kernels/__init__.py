"""Compiled functions on arrays: they import only math, numpy, numba, each other, and what compiles them (`compiling`).

Those that allocate nothing are compiled with ``_nrt=False`` (`UNCOUNTED`): numba does not count references to arrays in
them, which took a third of a replay, for a slice of an array is counted twice, each time by an atomic instruction. Such
a kernel must not return an array. What it calls is compiled in the same way unless it says ``_nrt=True`` (`COUNTED`).

A kernel that cannot be kept, for the disk is full, has been compiled all the same, and goes on from memory.
"""

import warnings
from collections.abc import Callable
from typing import Any

from numba.core.caching import Cache

__all__: list[str] = []


def _kept_or_said(save: Callable[..., None]) -> Callable[..., None]:
    def kept(self: Any, sig: Any, data: Any) -> None:
        try:
            save(self, sig, data)
        except OSError as error:
            if not self._py_func.__module__.startswith(__name__):
                raise
            said = f"{error.strerror or error}. This process has compiled them, and so will the next"
            warnings.warn(f"compiled kernels cannot be kept: {said}.", RuntimeWarning, stacklevel=2)

    return kept


# numba takes a file that cannot be written for a compilation that has failed, in the middle of a dive
setattr(Cache, "save_overload", _kept_or_said(Cache.save_overload))  # noqa: B010

"""Compiled functions on arrays: they import only math, numpy and numba, the decorators that they are compiled by
(`decorators.py`), and `checksum` where they call each other.

Those that allocate nothing are compiled with ``_nrt=False`` (`UNCOUNTED`): numba does not count references to arrays in
them, which took a third of a replay, for a slice of an array is counted twice, each time by an atomic instruction. Such
a kernel must not return an array. What it calls is compiled in the same way unless it says ``_nrt=True`` (`COUNTED`).

A kernel that cannot be kept, for the disk is full, has been compiled all the same, and goes on from memory.
"""

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from numba.core.caching import Cache

__all__ = ["checksum"]


def checksum(*modules: ModuleType) -> str:
    """Of the source of modules: what a kernel encloses whose callees stand in them, so that numba's cache knows when
    they change.

    Parameters
    ----------
    *modules : module

    Returns
    -------
    str
        Hexadecimal.
    """
    found = hashlib.sha256()
    for module in modules:
        assert module.__file__ is not None
        found.update(Path(module.__file__).read_bytes())
    return found.hexdigest()


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

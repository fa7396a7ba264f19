"""Compiled functions on arrays: they import only math, numpy and numba, and `checksum` where they call each other.

Those that allocate nothing are compiled with ``_nrt=False`` (`UNCOUNTED`): numba does not count references to arrays in
them, which took a third of a replay, for a slice of an array is counted twice, each time by an atomic instruction. Such
a kernel must not return an array. What it calls is compiled in the same way unless it says ``_nrt=True`` (`COUNTED`).
"""

import hashlib
from pathlib import Path
from types import ModuleType

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

"""Kernels that are kept. One that cannot be, for the disk is full, has been compiled all the same, and goes on from
memory. Those that lie beside their source, as in an image that was made for a vehicle's computer, serve whoever may
read them.
"""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core.caching import Cache, IndexDataCacheFile

#: Folders of kernels that are looked at where one is not in the folder that numba keeps them in; none where one was
#: asked for.
SHIPPED = [] if os.environ.get("NUMBA_CACHE_DIR") else [Path(__file__).parents[1] / "__pycache__"]
_KERNELS = "navfilter.kernels."


def _kept_or_said(save: Callable[..., None]) -> Callable[..., None]:
    def kept(self: Any, sig: Any, data: Any) -> None:
        try:
            save(self, sig, data)
        except OSError as error:
            if not self._py_func.__module__.startswith(_KERNELS):
                raise
            said = f"{error.strerror or error}. This process has compiled them, and so will the next"
            warnings.warn(f"compiled kernels cannot be kept: {said}.", RuntimeWarning, stacklevel=2)

    return kept


def _kept_or_shipped(load: Callable[..., Any]) -> Callable[..., Any]:
    def loaded(self: Any, sig: Any, target_context: Any) -> Any:
        found = load(self, sig, target_context)
        if found is not None or not self._py_func.__module__.startswith(_KERNELS):
            return found
        kept = self._cache_file
        for folder in SHIPPED:
            if folder != Path(self.cache_path):
                self._cache_file = IndexDataCacheFile(str(folder), self._impl.filename_base, kept._source_stamp)
                try:
                    found = load(self, sig, target_context)
                finally:
                    self._cache_file = kept
        return found

    return loaded


# numba takes a file that cannot be written for a compilation that has failed, in the middle of a dive
setattr(Cache, "save_overload", _kept_or_said(Cache.save_overload))  # noqa: B010
# and a folder that cannot be written for one that holds nothing
setattr(Cache, "load_overload", _kept_or_shipped(Cache.load_overload))  # noqa: B010

"""Arrays that lie in a file and not in memory: recordings that are larger than it."""

import mmap
import shutil
import tempfile
from typing import IO, Any

import numpy as np
import numpy.typing as npt

#: So many bytes are copied to the file at a time.
PIECE = 1 << 20


def mapped(source: IO[bytes], shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """An array of float64 in a temporary file, which goes when the array does.

    Parameters
    ----------
    source : binary file
        All that is left of it is the array, row by row.
    shape : tuple of int

    Raises
    ------
    ValueError
        When it is not as long as that.
    OSError
        When the temporary file cannot be written (disk full).
    """
    size = 8 * int(np.prod(shape, dtype=np.int64))
    with tempfile.TemporaryFile(prefix="navfilter-") as file:
        shutil.copyfileobj(source, file, PIECE)
        if file.tell() != size:
            raise ValueError(f"it holds {file.tell()} bytes where its header says {size}")
        file.flush()
        return np.memmap(file, np.float64, "r+", shape=shape)


def give_back(*arrays: Any) -> None:
    """Let go of the pages of arrays that are mapped from files; they are read again where they are needed.

    Any other array stays as it is, and so does one mapped as ``"c"``: what was written to it is nowhere else.
    """
    for array in arrays:
        in_file = False
        while isinstance(array, np.ndarray) and not (isinstance(array, np.memmap) and array.mode == "c"):
            in_file |= isinstance(array, np.memmap)
            array = array.base
        if in_file and isinstance(array, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            array.madvise(mmap.MADV_DONTNEED)

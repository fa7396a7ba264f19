"""Arrays inside .npy, .npz and .mat files (version 5 and 7.3), by name; nested names are joined with dots."""

import contextlib
import zipfile
from pathlib import Path

import numpy as np

from navfilter.foundation.arrays import AnyArray
from navfilter.foundation.mapped_arrays import mapped
from navfilter.io.trust import Allowance, Place
from navfilter.models.mission import MissionError

_NPY_MAGIC = b"\x93NUMPY"
#: A larger array of an archive is not held in memory [bytes]: four hours of inertial samples at 100 Hz.
_LARGE = 64 << 20
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_arrays(file: Path | Place) -> dict[str, AnyArray]:
    """Read every array of a container.

    Parameters
    ----------
    file : Path or Place
        A .npy file (its one array gets the name ``""``), a .npz file or a .mat file of either version.

    Returns
    -------
    dict of str to ndarray
        A matrix of a version 7.3 file has the shape that MATLAB shows, like one of version 5.

    Raises
    ------
    MissionError
        If the file is truncated, is not what its name says, needs pickle, or unpacks to more than is allowed.
    """
    place = Place.of(file) if isinstance(file, Path) else file
    path, allowance = place.path, place.allowance
    try:
        if path.suffix.lower() == ".npy":
            arrays = {"": _read_npy(path)}
        elif path.suffix.lower() == ".npz":
            arrays = read_npz(path, allowance)
        elif _is_hdf5(path):
            arrays = _read_hdf5(path, allowance)
        else:
            arrays = _read_mat5(path, allowance)
    except MissionError as error:
        raise MissionError(f"{place.shown}: {error}") from None
    except Exception as error:  # numpy, zipfile, scipy and h5py raise a dozen unrelated types on broken files
        reason = str(error).splitlines()[0].rstrip(".") if str(error) and place.quoted else type(error).__name__
        raise MissionError(
            f"{place.shown} cannot be read: {reason}. It is truncated or not what its name says."
        ) from None
    arrays = {name: array for name, array in arrays.items() if array.dtype.kind in "fiubU" or array.dtype.names}
    if not arrays:
        raise MissionError(f"{place.shown} holds no array of numbers.")
    return arrays


def read_npz(path: Path, allowance: Allowance | None = None) -> dict[str, AnyArray]:
    """Read every array of a .npz file, each held against its checksum.

    Parameters
    ----------
    path : Path
    allowance : Allowance, optional
        What it may unpack to.

    Returns
    -------
    dict of str to ndarray

    Raises
    ------
    ValueError, OSError, zipfile.BadZipFile, ...
        When anything about the file is wrong; arrays of Python objects are refused.

    Notes
    -----
    ``numpy.load`` reads as much of a member as the header of its array asks for. A damaged header that asks for less
    would give a shorter array without a word: the checksum is only compared at the end of the member.
    """
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        # No member gives more than it says of itself: zipfile stops reading there.
        (allowance or Allowance()).take(sum(entry.file_size for entry in archive.infolist()))
        for entry in archive.namelist():
            with archive.open(entry) as member:
                if member.read(len(_NPY_MAGIC)) != _NPY_MAGIC:
                    continue
            # piece by piece; opened anew, for after a seek nothing is held against the checksum
            name, size = entry.removesuffix(".npy"), archive.getinfo(entry).file_size
            arrays[name] = _member(archive, entry) if size < _LARGE else _large_member(archive, entry)
    return arrays


def _member(archive: zipfile.ZipFile, entry: str) -> AnyArray:
    with archive.open(entry) as member:
        array: AnyArray = np.lib.format.read_array(member, allow_pickle=False)
        if member.read(1):  # to the end, where the checksum is compared
            raise ValueError(f"{entry} is longer than it says")
    return array


def _large_member(archive: zipfile.ZipFile, entry: str) -> AnyArray:
    """In a file and not in memory, where it is of float64, row by row, and the disk has room for it."""
    with contextlib.suppress(OSError), archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        if version == (1, 0):
            shape, by_columns, dtype = np.lib.format.read_array_header_1_0(member)
            if dtype == np.dtype("<f8") and not by_columns:
                return mapped(member, shape)
    return _member(archive, entry)


def _read_npy(path: Path) -> AnyArray:
    found = np.load(path, allow_pickle=False)
    if not isinstance(found, np.ndarray):
        found.close()
        raise ValueError("it is an archive of several arrays; name it .npz")
    return found


def _is_hdf5(path: Path) -> bool:
    # A version 7.3 file is HDF5 behind a user block of 512 bytes; one written by other software may have none.
    with path.open("rb") as file:
        head = file.read(520)
    return head[:8] == _HDF5_SIGNATURE or head[512:520] == _HDF5_SIGNATURE


def _read_hdf5(path: Path, allowance: Allowance) -> dict[str, AnyArray]:
    import h5py

    arrays: dict[str, AnyArray] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#") and item.dtype.kind in "fiub":
            if item.external or item.is_virtual:
                raise ValueError(f"{name} takes its numbers from other files")
            allowance.take(item.nbytes)
            arrays[name.replace("/", ".")] = np.asarray(item[()]).T

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return arrays


def _read_mat5(path: Path, allowance: Allowance) -> dict[str, AnyArray]:
    from scipy.io import loadmat

    from navfilter.io.mat5 import check_mat5

    check_mat5(path, allowance)
    arrays: dict[str, AnyArray] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, dict):
            for key, inner in item.items():
                if not str(key).startswith("__"):
                    visit(f"{name}.{key}" if name else str(key), inner)
        elif isinstance(item, np.ndarray | float | int):
            arrays[name] = np.asarray(item)

    visit("", loadmat(path, simplify_cells=True))
    return arrays

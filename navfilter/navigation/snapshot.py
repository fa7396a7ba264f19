"""Snapshots: what a navigator needs to go on, as bytes and back, so that a vehicle goes on after a restart as if
nothing had happened.

A snapshot is a line that says what it is, a line of JSON (format, fingerprint of the vehicle, checksum, size), and an
npz archive without pickled objects, see `navfilter.foundation.state_values.to_arrays`. It holds the oldest checkpoint
of the history and everything that was fed since: feeding it again gives the present state to the last bit, and late
readings still find their place.
"""

import hashlib
import io
import json
import os
import stat
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.faults.clocks.imu_clock import DriveClockMemory
from navfilter.faults.sensor_monitor import SensorMonitor
from navfilter.filter.events import Measurement
from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array
from navfilter.foundation.atomic_files import replacing_binary
from navfilter.foundation.state_values import from_arrays, to_arrays
from navfilter.models.error_models import ErrorModel
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle

MAGIC = b"navfilter snapshot\n"
FORMAT = 32
#: No snapshot is larger [bytes]: it holds seconds of samples, and the minutes that learning begins again with.
LARGEST = 256 << 20


@dataclass
class SnapshotContent:
    """What a snapshot holds.

    Attributes
    ----------
    start : Start
    history_s : float
        Length of the history [s]; 0 without one.
    memory : object
        Of the navigator, at the oldest checkpoint.
    inputs : list of ndarray or Measurement
        Samples and readings since.
    watches : dict of str to Watch
    clock : DriveClockMemory
    waiting : list of Measurement
        Those that are still to be taken.
    """

    start: Start
    history_s: float
    memory: Any
    inputs: list[Array | Measurement]
    watches: dict[str, SensorMonitor]
    clock: DriveClockMemory
    waiting: list[Measurement]


def fingerprint(vehicle: Vehicle) -> str:
    """Hexadecimal digest of everything that describes a vehicle."""
    parts = vehicle.name, vehicle.drive, dict(vehicle.sensors)
    lanes = vehicle.lanes()
    if lanes:
        parts += ({name: lane.drive for name, lane in lanes.items()},)  # type: ignore[assignment]
    return hashlib.sha256(_spelt(parts).encode()).hexdigest()


def _spelt(value: Any) -> str:
    """Every field of a description that is compared: what `repr` leaves out because it is at its default today may have
    another one in the next version. Whether a number was typed as 8 or 8.0, or is one of NumPy, makes no difference.
    """
    if isinstance(value, np.ndarray | np.generic):
        return _spelt(value.tolist())
    if is_dataclass(value):
        parts = (f"{f.name}={_spelt(getattr(value, f.name))}" for f in fields(value) if f.compare)
        return f"{type(value).__qualname__}({', '.join(parts)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_spelt(part)}' for key, part in value.items())}}}"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_spelt, value))})"
    if isinstance(value, frozenset):
        return f"({', '.join(sorted(map(_spelt, value)))})"
    return repr(float(value)) if type(value) is int else repr(value)


def write(saved: SnapshotContent, vehicle: Vehicle, time_s: float, path: str | PathLike[str] | None) -> bytes:
    """See `navfilter.navigation.navigator.Navigator.snapshot`."""
    out = io.BytesIO()
    np.savez(out, **to_arrays(saved))  # type: ignore[arg-type]
    payload = out.getvalue()
    header = {
        "format": FORMAT,
        "vehicle": fingerprint(vehicle),
        "name": vehicle.name,
        "time_s": time_s,
        "sha256": hashlib.sha256(payload).hexdigest(),
        "size": len(payload),
    }
    data = MAGIC + json.dumps(header).encode() + b"\n" + payload
    if path is not None:
        with replacing_binary(path, synced=True) as file:
            file.write(data)
    return data


def unreadable(error: Exception | str) -> ValueError:
    """What is raised for a snapshot that is no good, whatever the reason."""
    return ValueError(f"the snapshot cannot be read ({error}). Start afresh, or take an older one.")


def content(path: str | PathLike[str]) -> bytes:
    """What a file that should be a snapshot holds.

    Raises
    ------
    ValueError
        For a device, a pipe or a folder, which may never end, and for more than any snapshot has.
    OSError
        When it cannot be read.
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST:
        found = f"has {status.st_size >> 20} MiB" if stat.S_ISREG(status.st_mode) else "is no file"
        raise ValueError(f"{path} {found}: it is no snapshot. Move it away to start afresh.")
    return Path(path).read_bytes()


def read(vehicle: Vehicle, source: bytes | str | PathLike[str], kinds: Iterable[type]) -> SnapshotContent:
    """What a snapshot of this vehicle holds; nothing of it is checked against the vehicle but the fingerprint.

    Parameters
    ----------
    vehicle : Vehicle
    source : bytes or path-like
    kinds : iterable of class
        Classes that memory consists of, beside error models and what fields are said to hold.

    Raises
    ------
    ValueError
        When it is damaged, of another version, or of another vehicle.
    OSError
        When the file cannot be read.
    """
    needs("restore: vehicle", vehicle, Vehicle, hint="The one that the snapshot was taken with.")
    needs("restore: source", source, bytes, PathLike, str, hint="Give the file that Navigator.snapshot(path) wrote.")
    data = source if isinstance(source, bytes) else content(source)
    payload = _checked(data, vehicle)
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as whole:
            # as `write` makes them: what is compressed could unpack to a thousand times as much
            if any(member.compress_type != zipfile.ZIP_STORED for member in whole.infolist()):
                raise ValueError("it is compressed")
            # numpy reads as much as the header of an array says; only a member read to its end is held against its
            # checksum.
            if damaged := whole.testzip():
                raise ValueError(f"{damaged} is damaged")
        with np.load(io.BytesIO(payload), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("meta", "floats", "integers")}
        saved = from_arrays(arrays, [SnapshotContent, ErrorModel, *kinds])
    except Exception as error:  # numpy, zipfile, zlib and json raise many unrelated types on broken archives
        raise unreadable(error) from error
    if not isinstance(saved, SnapshotContent):
        raise unreadable(f"it holds a {type(saved).__name__}")
    return saved


def _checked(data: bytes, vehicle: Vehicle) -> bytes:
    """The payload of a snapshot that is whole, of this format and of this vehicle."""
    if not data.startswith(MAGIC):
        raise ValueError("this is no snapshot of navfilter. Give the file that Navigator.snapshot(path) wrote.")
    line, _, payload = data[len(MAGIC) :].partition(b"\n")
    try:
        header = json.loads(line)
        number, digest, size, whose = header["format"], header["sha256"], header["size"], header["vehicle"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            "the snapshot is damaged: its header cannot be read. Start afresh, or take an older one."
        ) from error
    if number != FORMAT:
        raise ValueError(f"the snapshot has format {number}, this version of navfilter reads {FORMAT}. Start afresh.")
    if len(payload) != size or hashlib.sha256(payload).hexdigest() != digest:
        raise ValueError(
            f"the snapshot is damaged: {len(payload)} of {size} bytes, or changed ones. Start afresh, or take an older "
            "one."
        )
    if whose != fingerprint(vehicle):
        raise ValueError(
            f'the snapshot is of another vehicle ("{header.get("name")}", or one with other settings). Use the vehicle '
            "it was taken with."
        )
    return payload

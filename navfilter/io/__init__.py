"""Files: the only place with column names, degrees and other people's units."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navfilter.io.trust import UNPACKED_BYTES
from navfilter.models.mission import Mission, MissionError

if TYPE_CHECKING:
    from navfilter.io.vehicle_toml import VehicleError, read_vehicle, write_vehicle

__all__ = ["VehicleError", "read_mission", "read_vehicle", "write_vehicle"]


def __getattr__(name: str) -> Any:
    """What reads vehicles brings all that they may consist of, and its kernels: only when it is asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from navfilter.io import vehicle_toml

    return getattr(vehicle_toml, name)


def read_mission(
    path: str | os.PathLike[str], *, confine: bool = False, unpacked_bytes: int = UNPACKED_BYTES
) -> Mission:
    """Read a recorded mission.

    Parameters
    ----------
    path : path-like
        A folder with a ``mission.toml``, a .toml file itself, or a .npz file written by `Mission.save`.
    confine : bool
        Refuse whatever leads out of the folder of the mission.toml: for missions of people you do not know.
    unpacked_bytes : int
        What its compressed files may unpack to, together.

    Returns
    -------
    Mission
        Streams in SI and radians, sorted by time; `Mission.notes` counts what had to be dropped or mended.

    Raises
    ------
    MissionError
        A ValueError that says in one line which file cannot be read, why, and what to do. A mission.toml with several
        mistakes gets them all listed.

    Examples
    --------
    >>> from navfilter.models.mission import Stream
    >>> import tempfile
    >>> mission = Mission("dive", {"depth": Stream([0.0, 1.0], [5.0, 5.1], ("depth_m",))})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     read_mission(mission.save(Path(folder) / "dive.npz")).streams["depth"].value[1, 0]
    np.float64(5.1)
    """
    path = Path(path)
    if path.exists() and path.suffix not in (".toml", ".npz") and not (path / "mission.toml").exists():
        from navfilter.io.logs import format_of

        if known := format_of(path):
            raise MissionError(
                f'{path} is {known.title}, not a mission: "navfilter mission --init {path} --out DIR" writes one for '
                "it."
            )
    if path.is_dir():
        if not (path / "mission.toml").exists():
            raise MissionError(f"{path}: this folder has no mission.toml; write one that maps its files to streams.")
        path = path / "mission.toml"
    if not path.exists():
        raise MissionError(f"{path}: no such file or folder.")
    if path.suffix == ".toml":
        from navfilter.io.mission_toml import read_mission_toml

        return read_mission_toml(path, confine=confine, unpacked_bytes=unpacked_bytes)
    if path.suffix == ".npz":
        from navfilter.io.mission_npz import read_mission_npz

        return read_mission_npz(path, unpacked_bytes)
    raise MissionError(
        f'{path} is no mission: expected a folder with a mission.toml, a .toml or a .npz, found "{path.name}".'
    )

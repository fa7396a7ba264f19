"""track.nc: a trajectory by the CF conventions (1.8, discrete sampling geometry), as NetCDF with 64-bit offsets.

Every column of track.csv is a variable of the dimension ``obs``; its name has letters, digits and underscores only:
``gyro_x[0]_deg_s`` is ``gyro_x_0_deg_s``. Where UTC is unknown, ``time`` counts seconds of the
mission clock, and no reader takes it for a date.
"""

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.atomic_files import pieces, replacing_binary
from navfilter.io.tracks.geojson import degrees_east
from navfilter.models.mission import Mission
from navfilter.track.track import Track

#: Column of track.csv -> standard name of the CF conventions.
_STANDARD = {
    "latitude_deg": "latitude",
    "longitude_deg": "longitude",
    "height_m": "height_above_reference_ellipsoid",
    "heading_deg": "platform_orientation",
    "roll_deg": "platform_roll_starboard_down",
    "pitch_deg": "platform_pitch_fore_up",
}
#: Units of the columns before the states, the longest first.
_UNITS = ("m_s", "m2", "deg", "m")
_POSITION = {"latitude_deg": "degrees_north", "longitude_deg": "degrees_east"}


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track."""
    from scipy.io import netcdf_file

    # with its own file the library maps what it writes; a buffer of bytes it only appends to
    with replacing_binary(path) as raw, netcdf_file(raw, "w", version=2) as file:
        _about(file, track)
        file.createDimension("obs", len(track))
        _trajectory(file, track.mission_name)
        _time(file, track)
        variables: dict[str, Any] = {}
        for column, unit in _columns(track):
            variables[column] = _variable(file, column, unit)
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            for name, variable in variables.items():
                variable[rows] = frame[name].to_numpy()
            variables["longitude_deg"][rows] = degrees_east(track.longitude[rows])


def _about(file: Any, track: Track) -> None:
    file.Conventions = "CF-1.8"
    file.featureType = "trajectory"
    file.title = f"{track.mission_name}, {track.label}".encode()  # of a string the library takes ASCII only
    file.history = "written by navfilter"
    file.source = f"navfilter, vehicle {track.vehicle.name}".encode()


def _trajectory(file: Any, name: str) -> None:
    text = np.frombuffer(name.encode() or b" ", dtype="S1")
    file.createDimension("name_length", len(text))
    variable = file.createVariable("trajectory", "S1", ("name_length",))
    variable.cf_role, variable.long_name = "trajectory_id", "mission"
    variable[:] = text


def _time(file: Any, track: Track) -> None:
    variable = file.createVariable("time", "d", ("obs",))
    variable[:] = track.time_s
    variable.axis = "T"
    if track.epoch_utc_s is None:
        variable.long_name, variable.units = "time on the mission clock, UTC unknown", "s"
        return
    # whole seconds in the unit, the rest in the values
    whole = np.floor(track.epoch_utc_s)
    variable[:] = track.time_s + (track.epoch_utc_s - whole)
    since = utc.text(np.zeros(1), float(whole), "s")[0].replace("T", " ").replace("Z", " UTC")
    variable.standard_name, variable.units, variable.calendar = "time", f"seconds since {since}", "standard"


def _columns(track: Track) -> Iterator[tuple[str, str]]:
    """Columns of track.csv behind the times, with their units as the columns have them."""
    columns = list(track.keep(slice(0, 1)).to_frame().columns.drop(["time_s", "time_utc"], errors="ignore"))
    states = len(columns) - 2 * len(track.state_names)
    for column in columns[:states]:
        yield column, next(unit for unit in _UNITS if column.endswith(f"_{unit}"))
    for column, unit in zip(columns[states:], np.repeat(track.state_units, 2).tolist(), strict=True):
        yield column, unit.replace("rad", "deg")


def _variable(file: Any, column: str, unit: str) -> Any:
    variable = file.createVariable(_name(column, file.variables), "d", ("obs",))
    variable.units = _POSITION.get(column) or _udunits(unit)
    variable.long_name = column.removesuffix(f"_{unit}").replace("_", " ")
    if column in _STANDARD:
        variable.standard_name = _STANDARD[column]
    if column in _POSITION:
        variable.axis = "Y" if column == "latitude_deg" else "X"
    else:
        variable.coordinates = "time latitude_deg longitude_deg height_m"
    if column == "height_m":
        variable.axis, variable.positive = "Z", "up"
    return variable


def _name(column: str, taken: Collection[str]) -> str:
    name = re.sub(r"[^A-Za-z0-9]+", "_", column)
    name = name if name[0].isalpha() else f"state_{name}"
    while name in taken:
        name += "_"
    return name


def _udunits(unit: str) -> str:
    """``m_s2`` -> ``m s-2``."""
    first, *below = unit.replace("deg", "degree").split("_")
    return " ".join([first, *(re.sub(r"^([a-z]+)(\d?)$", lambda m: f"{m[1]}-{m[2] or 1}", part) for part in below)])

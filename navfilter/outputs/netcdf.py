"""track.nc: a trajectory by the CF conventions (1.8, discrete sampling geometry), as NetCDF with 64-bit offsets.

Every column of track.csv is a variable of the dimension ``obs``. Where UTC is unknown, ``time`` counts seconds of the
mission clock, and no reader takes it for a date.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from navfilter import utc
from navfilter.mission import Mission
from navfilter.outputs.geojson import degrees_east
from navfilter.outputs.replacing import pieces, replacing_binary
from navfilter.track import Track

__all__ = ["write"]

#: Column of track.csv -> standard name of the CF conventions.
_STANDARD = {
    "latitude_deg": "latitude",
    "longitude_deg": "longitude",
    "height_m": "height_above_reference_ellipsoid",
    "heading_deg": "platform_orientation",
    "roll_deg": "platform_roll_starboard_down",
    "pitch_deg": "platform_pitch_fore_up",
}
#: Ending of a column -> unit as UDUNITS has it, the longest first.
_UNITS = {"_m_s": "m s-1", "_m2": "m2", "_deg": "degree", "_m": "m"}
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
        columns = track.keep(slice(0, 1)).to_frame().columns.drop(["time_s", "time_utc"], errors="ignore")
        variables = {name: _variable(file, name) for name in columns}
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            for name, variable in variables.items():
                variable[rows] = frame[name].to_numpy()
            variables["longitude_deg"][rows] = degrees_east(track.longitude[rows])


def _about(file: Any, track: Track) -> None:
    file.Conventions = "CF-1.8"
    file.featureType = "trajectory"
    file.title = f"{track.mission_name}, {track.label}"
    file.source = f"navfilter, vehicle {track.vehicle.name}"


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


def _variable(file: Any, column: str) -> Any:
    variable = file.createVariable(column, "d", ("obs",))
    ending = next((end for end in _UNITS if column.endswith(end)), "")
    variable.units = _POSITION.get(column) or _UNITS.get(ending, "1")
    variable.long_name = column.removesuffix(ending).replace("_", " ")
    if column in _STANDARD:
        variable.standard_name = _STANDARD[column]
    if column in _POSITION:
        variable.axis = "Y" if column == "latitude_deg" else "X"
    else:
        variable.coordinates = "time latitude_deg longitude_deg height_m"
    if column == "height_m":
        variable.axis, variable.positive = "Z", "up"
    return variable

"""The formats in which a track is written: what each is for, by which module, and what that needs."""

from __future__ import annotations

import importlib
import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navfilter.foundation.arguments import needs

if TYPE_CHECKING:
    from navfilter.models.mission import Mission
    from navfilter.track.track import Track

#: What begins this near to latitude 0, longitude 0 began at a place that nobody gave: 64 m [rad], 1 m [deg].
_NOWHERE = 1e-5


@dataclass(frozen=True)
class TrackFormat:
    """A format of tracks.

    Parameters
    ----------
    suffix : str
        Ending of its files; without the dot its option of ``navfilter replay``.
    about : str
        For whom it is, in one line.
    module : str
        Module of this folder; its ``write(track, path, mission)`` writes it.
    package, extra : str
        What it is written with, and the extra of navfilter that brings it; empty: nothing beside navfilter.
    always : bool
        Every replay writes it.
    utc : bool
        Its times are dates: it cannot be written without UTC.
    place : bool
        It says nothing without a place on the Earth.
    """

    suffix: str
    about: str
    module: str
    package: str = ""
    extra: str = ""
    always: bool = False
    utc: bool = False
    place: bool = False

    @property
    def name(self) -> str:
        """The suffix without its dot."""
        return self.suffix[1:]

    def check(self, known: Mission | Track, nowhere: bool) -> None:
        """Say before a long run what would be wrong after it.

        Parameters
        ----------
        known : Mission or Track
            Whose `epoch_utc_s` counts.
        nowhere : bool
            Whether the place on the Earth is unknown.

        Raises
        ------
        ValueError
            Where a package is missing, or UTC or place is unknown and the format cannot do without.
        """
        if self.package and importlib.util.find_spec(self.package) is None:
            raise ValueError(
                f"{self.suffix} is written with {self.package}, which is not installed:"
                f' pip install "navfilter[{self.extra}]"'
            )
        if self.utc and known.epoch_utc_s is None:
            raise ValueError(
                f"{self.suffix} has dates for times, and this mission does not know UTC: say at what UTC its stamps"
                " read zero, with epoch = 2026-06-01T08:30:00Z in the mission.toml."
            )
        if self.place and nowhere:
            raise ValueError(
                f"{self.suffix} is about places on the Earth, and this mission begins at latitude 0, longitude 0,"
                " which stands for nowhere: give latitude_deg and longitude_deg of [start] in the mission.toml."
            )


FORMATS: tuple[TrackFormat, ...] = (
    TrackFormat(".csv", "tables and scripts: every column in degrees and metres, with its sd", "table", always=True),
    TrackFormat(".tum", "evo and other tools that compare trajectories", "tum", always=True),
    TrackFormat(".geojson", "QGIS and web maps: track with times and sd, truth, fixes", "geojson", always=True),
    TrackFormat(".kml", "Google Earth: track with times and sd", "kml", place=True),
    TrackFormat(".kmz", "the same in a tenth of the room", "kml", place=True),
    TrackFormat(".gpx", "chart plotters and GPS tools: track with times", "kml", place=True),
    TrackFormat(".gpkg", "GIS: GeoPackage with the line, and its rows as points with time and sd", "gis", place=True),
    TrackFormat(".shp", "GIS and charting: the same as shapefiles", "gis", "shapefile", "gis", place=True),
    TrackFormat(".mcap", "Foxglove, PlotJuggler: odometry, fix, NIS and health of sensors", "ros", "rosbags", "ros"),
    TrackFormat(".rosbag", "the same as a ROS 2 bag, for 'ros2 bag play'", "ros", "rosbags", "ros"),
    TrackFormat(".sbet", "survey software (multibeam, lidar): Applanix's SBET", "sbet", utc=True, place=True),
    TrackFormat(".mat", "MATLAB and Octave: track, covariances, states, residuals of each sensor", "mat"),
    TrackFormat(".nc", "NetCDF archives: a CF trajectory", "netcdf"),
)


def write_track(track: Track, path: str | os.PathLike[str], mission: Mission | None = None) -> Path:
    """Write a track in the format that the file's ending says.

    Parameters
    ----------
    track : Track
    path : path-like
        One of .csv, .tum, .geojson, .kml, .kmz, .gpx, .gpkg, .shp, .mcap, .rosbag (a folder), .sbet, .mat, .nc. What is
        there is replaced, whole.
    mission : Mission, optional
        Puts truth and fixes beside the track in a .geojson.

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        For an ending that is not in the list, a track without rows, a package that is not installed, and where UTC or
        the place on the Earth is unknown and the format cannot do without.

    Examples
    --------
    >>> from navfilter.io.tracks.formats import FORMATS
    >>> [form.name for form in FORMATS if form.utc]
    ['sbet']
    """
    from navfilter.models.mission import Mission
    from navfilter.track.track import Track

    needs("write_track: track", track, Track, hint="It is write_track(track, path).")
    needs("write_track: mission", mission, Mission, type(None))
    path = Path(path)
    known = {form.suffix: form for form in FORMATS}
    if path.suffix.lower() not in known:
        raise ValueError(f"{path}: no format of tracks has this ending; take one of {', '.join(known)}.")
    form = known[path.suffix.lower()]
    if not len(track):
        raise ValueError(f"{path}: this track has no rows: there is nothing to write.")
    form.check(track, is_nowhere(float(track.latitude[0]), float(track.longitude[0])))
    importlib.import_module(f"navfilter.io.tracks.{form.module}").write(track, path, mission)
    return path


def is_nowhere(latitude: float, longitude: float) -> bool:
    """Whether a place, in radians or degrees, is the 0, 0 that stands for no place at all."""
    return abs(latitude) < _NOWHERE and abs(longitude) < _NOWHERE

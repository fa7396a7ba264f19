"""track.kml for Google Earth: a ``gx:Track`` with times and sd; without UTC a line without times.

Heights are those of the track, above the ellipsoid where fixes gave them; KML means them above the sea.

track.gpx for chart plotters and GPS tools (GPX 1.1): a track with heights, and with times where UTC is known.
"""

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO
from xml.sax.saxutils import escape

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.atomic_files import pieces, replacing, replacing_binary
from navfilter.io.tracks.geojson import degrees_east
from navfilter.models.mission import Mission
from navfilter.track.track import Track

_GPX_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="navfilter" xmlns="http://www.topografix.com/GPX/1/1">
<trk><name>{name}</name><src>{vehicle}</src><trkseg>
"""
_GPX_TAIL = "</trkseg></trk></gpx>\n"


def _write_gpx(track: Track, file: TextIO) -> None:
    name = f"{track.mission_name}, {track.label}"
    file.write(_GPX_HEAD.format(name=xml_text(name), vehicle=xml_text(track.vehicle.name)))
    times = iter(_times(track))
    for east, north, up in _places(track):
        time = "" if track.epoch_utc_s is None else f"<time>{next(times)}</time>"
        file.write(f'<trkpt lat="{north}" lon="{east}"><ele>{up}</ele>{time}</trkpt>\n')
    file.write(_GPX_TAIL)


_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
<Document><name>{mission}</name>
<Style id="track"><LineStyle><color>ffb27200</color><width>3</width></LineStyle></Style>
<Schema id="sd"><gx:SimpleArrayField name="sd_horizontal_m" type="float"/></Schema>
<Placemark><name>{label}</name><description>{about}</description><styleUrl>#track</styleUrl>
"""
_TAIL = "</Placemark></Document></kml>\n"


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track; as .kmz a .kml, packed."""
    if path.suffix.lower() != ".kmz":
        with replacing(path) as file:
            (_write_gpx if path.suffix.lower() == ".gpx" else _write)(track, file)
        return
    with (
        replacing_binary(path) as packed,
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("doc.kml", "w", force_zip64=True) as plain,
        io.TextIOWrapper(plain, "utf-8", newline="\n") as file,
    ):
        _write(track, file)


def _write(track: Track, file: TextIO) -> None:
    about = f"{track.vehicle.name}, {track.distance_m:.0f} m"
    file.write(_HEAD.format(mission=xml_text(track.mission_name), label=xml_text(track.label), about=xml_text(about)))
    if track.epoch_utc_s is None:
        file.write("<LineString><altitudeMode>absolute</altitudeMode><coordinates>\n")
        file.writelines(f"{','.join(place)}\n" for place in _places(track))
        file.write("</coordinates></LineString>\n")
    else:
        file.write("<gx:Track><altitudeMode>absolute</altitudeMode>\n")
        file.writelines(f"<when>{time}</when>\n" for time in _times(track))
        file.writelines(f"<gx:coord>{' '.join(place)}</gx:coord>\n" for place in _places(track))
        file.write('<ExtendedData><SchemaData schemaUrl="#sd"><gx:SimpleArrayData name="sd_horizontal_m">\n')
        file.writelines(f"<gx:value>{value:.3f}</gx:value>\n" for value in track.horizontal_sd())
        file.write("</gx:SimpleArrayData></SchemaData></ExtendedData></gx:Track>\n")
    file.write(_TAIL)


def _times(track: Track) -> Iterator[str]:
    for rows in pieces(0 if track.epoch_utc_s is None else len(track)):
        yield from utc.text(track.time_s[rows], track.epoch_utc_s or 0.0, "ms")


def _places(track: Track) -> Iterator[tuple[str, str, str]]:
    """Longitude, latitude [deg], height [m] of each row, as text."""
    for rows in pieces(len(track)):
        longitude, latitude = degrees_east(track.longitude[rows]), np.degrees(track.latitude[rows])
        for east, north, up in zip(longitude, latitude, track.height[rows], strict=True):
            yield f"{east:.9f}", f"{north:.9f}", f"{up:.3f}"


def xml_text(text: str) -> str:
    """Text as it may stand in XML, which has no control characters."""
    return escape("".join(c for c in text if c.isprintable()))

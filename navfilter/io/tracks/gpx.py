"""track.gpx for chart plotters and GPS tools (GPX 1.1): a track with heights, and with times where UTC is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.atomic_files import pieces, replacing
from navfilter.io.tracks.geojson import degrees_east
from navfilter.io.tracks.kml import xml_text
from navfilter.models.mission import Mission
from navfilter.track.track import Track

_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="navfilter" xmlns="http://www.topografix.com/GPX/1/1">
<trk><name>{name}</name><src>{vehicle}</src><trkseg>
"""
_TAIL = "</trkseg></trk></gpx>\n"


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track."""
    with replacing(path) as file:
        name = f"{track.mission_name}, {track.label}"
        file.write(_HEAD.format(name=xml_text(name), vehicle=xml_text(track.vehicle.name)))
        for rows in pieces(len(track)):
            longitude, latitude = degrees_east(track.longitude[rows]), np.degrees(track.latitude[rows])
            times = [""] * len(longitude)
            if track.epoch_utc_s is not None:
                times = [f"<time>{t}</time>" for t in utc.text(track.time_s[rows], track.epoch_utc_s, "ms")]
            for east, north, up, time in zip(longitude, latitude, track.height[rows], times, strict=True):
                file.write(f'<trkpt lat="{north:.9f}" lon="{east:.9f}"><ele>{up:.3f}</ele>{time}</trkpt>\n')
        file.write(_TAIL)

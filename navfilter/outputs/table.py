"""track.csv: `Track.to_frame` as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navfilter import utc
from navfilter.mission import Mission
from navfilter.outputs.replacing import pieces, replacing
from navfilter.track import Track

__all__ = ["write"]

# 1e-10 degrees are 0.01 mm; seven digits are more than any other quantity has.
_FORMATS = {
    "time_s": "%.6f",
    "time_utc": "%s",
    "latitude_deg": "%.10f",
    "longitude_deg": "%.10f",
    "height_m": "%.5f",
    "depth_m": "%.5f",
}


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """One row per time, degrees and metres, the unit in the name of every column."""
    with replacing(path) as file:
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            values = frame.to_numpy(dtype=object if "time_utc" in frame else float)
            if track.epoch_utc_s is not None:
                values[:, frame.columns.get_loc("time_utc")] = utc.text(track.time_s[rows], track.epoch_utc_s)
            formats = [_FORMATS.get(name, "%.7g") for name in frame.columns]
            header = ",".join(frame.columns) if rows.start == 0 else ""
            if header:
                file.write(f"{header}\n")
            np.savetxt(file, values, fmt=formats, delimiter=",")

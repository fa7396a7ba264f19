"""track.csv: `Track.to_frame` as text."""

from __future__ import annotations

from pathlib import Path

from navfilter.foundation import utc
from navfilter.io.tracks.atomic_files import pieces, replacing_binary
from navfilter.io.tracks.rows import LONG, text_of_rows
from navfilter.models.mission import Mission
from navfilter.track.track import Track

#: Decimals; 1e-10 degrees are 0.01 mm. Of any other quantity seven significant figures are more than it has.
_DIGITS = {"time_s": 6, "latitude_deg": 10, "longitude_deg": 10, "height_m": 5, "depth_m": 5}
_FIGURES = -7


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """One row per time, degrees and metres, the unit in the name of every column."""
    with replacing_binary(path) as file:
        for rows in pieces(len(track)):
            frame = track.keep(rows).to_frame()
            if rows.start == 0:
                file.write(f"{','.join(frame.columns)}\n".encode())
            marks = None if track.epoch_utc_s is None else utc.text(track.time_s[rows], track.epoch_utc_s)
            frame = frame.drop(columns="time_utc", errors="ignore")
            digits = [_DIGITS.get(name, _FIGURES) for name in frame.columns]
            compiled = len(track) * len(digits) >= LONG
            file.write(text_of_rows(frame.to_numpy(dtype=float), digits, marks, compiled=compiled))

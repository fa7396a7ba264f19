"""Tables of a run: for the terminal as text, for the report as rows."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from navfilter.evaluation.comparison import number_text
from navfilter.filter.records import OUTCOMES
from navfilter.io.write import summarise
from navfilter.models.mission import Mission
from navfilter.rendering.page import table_text
from navfilter.track.track import Track, Tracks

Rows = list[list[str]]

#: Columns of the headline table: heading, key of ``summary.json``, format.
HEADLINES = (
    ("position rms [m]", "position_rms_m", "{:.2f}"),
    ("max [m]", "position_max_m", "{:.2f}"),
    ("end [m]", "position_end_m", "{:.2f}"),
    ("end [% of distance]", "position_end_pct", "{:.3f}"),
    ("heading rms [deg]", "heading_rms_deg", "{:.3f}"),
    ("velocity rms [m/s]", "velocity_rms_m_s", "{:.4f}"),
    ("NEES position", "nees_position", "{:.2f}"),
    ("NEES heading", "nees_heading", "{:.2f}"),
)


def headline_table(tracks: Tracks, mission: Mission) -> str:
    """Errors and consistency of every run as text, one line per run; a dash where there is no truth."""
    return table_text(*headline_rows(tracks, mission))


def sensor_table(track: Track) -> str:
    """What became of the readings of every sensor, and its mean NIS, as text."""
    return table_text(*sensor_rows(track))


def headline_rows(tracks: Tracks, mission: Mission) -> tuple[list[str], Rows]:
    """Header and rows of `headline_table`; a figure that no run has is left out."""
    runs = summarise(tracks, mission)["runs"]
    rows = [
        [label, *(number_text(run[key], form) for _, key, form in HEADLINES), number_text(_mean_nis(run), "{:.2f}")]
        for label, run in runs.items()
    ]
    header = ["", *(name for name, _, _ in HEADLINES), "NIS"]
    told = [i for i in range(len(header)) if not i or any(row[i] != number_text(None, "") for row in rows)]
    return [header[i] for i in told], [[row[i] for i in told] for row in rows]


def _mean_nis(run: Mapping[str, Any]) -> float | None:
    values = [nis for nis in run["nis"].values() if nis is not None]
    return float(np.mean(values)) if values else None


def sensor_rows(track: Track) -> tuple[list[str], Rows]:
    """Header and rows of `sensor_table`."""
    present = [
        o for o in OUTCOMES if any(r.count(o) for r in track.residuals.values()) or o in ("used", "rejected", "invalid")
    ]
    nis = track.summary()["nis"]
    rows = [
        [name, *(str(r.count(o)) for o in present), number_text(nis[name], "{:.2f}")]
        for name, r in track.residuals.items()
    ]
    return ["sensor", *present, "NIS"], rows

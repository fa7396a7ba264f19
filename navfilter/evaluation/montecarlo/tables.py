"""What a campaign says: figures with intervals over its runs, ratios between models, as text, CSV, JSON and npz."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from navfilter.evaluation.montecarlo.campaign import Results
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES
from navfilter.evaluation.montecarlo.slot_tables import SlotRow, figures, slot_rows, slot_table
from navfilter.evaluation.montecarlo.slots import SLOT_SCORES
from navfilter.evaluation.montecarlo.statistics import interval_text
from navfilter.evaluation.montecarlo.store import write_whole
from navfilter.foundation.quoting import json_value
from navfilter.rendering.page import table_text

#: By reference, track, quantity and model.
_Found = dict[tuple[str, str, str, str], SlotRow]
#: What is divided by that of other models, and by which.
_DIVIDED = ("heading_rms_deg", "position_rms_m")
REFERENCES: dict[str, tuple[str, ...]] = {"gm1-fitted": _DIVIDED, "oracle": _DIVIDED}
_MAIN = {
    "heading_rms_deg": ("heading rms [deg]", ".4f"),
    "position_rms_m": ("position rms [m]", ".2f"),
    "end_m": ("end of dive [m]", ".2f"),
    "end_pct": ("[% of way]", ".3f"),
    "anees_position": ("ANEES position", ".2f"),
    "anees_heading": ("ANEES heading", ".2f"),
}
_INNOVATIONS = {
    "nis_sensor": ("NIS", ".3f"),
    "nis_all": ("NIS of all sensors", ".3f"),
    "white": ("white", ".0%"),
    "ljung_box": ("Ljung-Box/dof", ".1f"),
    "rejected_pct": ("rejected [%]", ".2f"),
    "adopted": ("runs with adoptions", ".0%"),
    "adoptions": ("adoptions", ".1f"),
}


def rows(results: Results) -> list[SlotRow]:
    """All figures of all models and tracks, and their ratios to those of the references."""
    return [
        SlotRow(model, track, math.nan, math.nan, *figure)
        for m, model in enumerate(results.models)
        for t, track in enumerate(results.tracks)
        for figure in figures(results.models, results.scores[:, t], m, SCORES, REFERENCES)
    ]


def table(results: Results) -> str:
    """Everything that is worth reading on a terminal."""
    campaign, found = results.campaign, {(r.reference, r.track, r.quantity, r.model): r for r in rows(results)}
    study, learnt = campaign.staged.study, campaign.staged.learnt
    begin, end = float(campaign.score_from_s or 0.0), float(campaign.duration_s or 0.0)
    parts = [
        f"{campaign.name}: {study.sensor} - {study.about}\n{len(results.seeds)} runs (seeds {results.seeds[0]} to "
        f"{results.seeds[-1]}), "
        f"{end:g} s each, scored from {begin:g} s; 95 % intervals over the runs."
    ]
    for track in results.tracks:
        parts.append(f"{track}\n{_block(results.models, track, _MAIN, found)}")
    parts.append(f"innovations of {learnt}, forward\n{_block(results.models, 'forward', _INNOVATIONS, found)}")
    for reference in REFERENCES:
        others = [model for model in results.models if model != reference]
        if others and reference in results.models:
            ratios = _ratio_block(others, reference, results.tracks, found)
            parts.append(f"divided by {reference} on the same missions\n{ratios}")
    apart = slot_rows(results)
    if apart:
        parts.append(slot_table(results, apart))
    return "\n\n".join(parts)


def _block(models: Iterable[str], track: str, columns: dict[str, tuple[str, str]], found: _Found) -> str:
    lines = [
        [model, *(_cell(found.get(("", track, key, model)), form) for key, (_, form) in columns.items())]
        for model in models
    ]
    return table_text(["model", *(title for title, _ in columns.values())], lines)


def _ratio_block(models: Iterable[str], reference: str, tracks: Iterable[str], found: _Found) -> str:
    keys = [(track, quantity) for quantity in _DIVIDED for track in tracks]
    header = ["model", *(f"{quantity.split('_')[0]} rms, {track}" for track, quantity in keys)]
    lines = [[model, *(_cell(found.get((reference, *key, model)), ".3f") for key in keys)] for model in models]
    return table_text(header, lines)


def _cell(row: SlotRow | None, form: str) -> str:
    return "-" if row is None else interval_text(row.value, row.low, row.high, form)


def write_tables(results: Results, folder: Path) -> list[str]:
    """Write table.txt, results.csv, slots.csv, results.json and runs.npz; returns the names."""
    names = ("model", "track", "quantity", "reference", "value", "low", "high", "runs")
    found = [{name: row[name] for name in names} for row in map(_dict, rows(results))]
    content = {
        "campaign": results.campaign.settings,
        "models": list(results.models),
        "seeds": results.seeds.tolist(),
        "results": found,
        "slots": [_dict(row) for row in slot_rows(results)],
    }
    write_whole(folder / "table.txt", (table(results) + "\n").encode())
    write_whole(folder / "results.csv", _csv(found, names))
    write_whole(folder / "slots.csv", _csv(content["slots"], [field.name for field in fields(SlotRow)]))
    write_whole(folder / "results.json", (json.dumps(content, indent=1) + "\n").encode())
    write_whole(folder / "runs.npz", _npz(results))
    return ["table.txt", "results.csv", "slots.csv", "results.json", "runs.npz"]


def _dict(row: SlotRow) -> dict[str, Any]:
    return {key: json_value(value) for key, value in asdict(row).items()}


def _csv(found: list[dict[str, Any]], columns: Sequence[str]) -> bytes:
    text: str = pd.DataFrame(found, columns=columns, dtype=object).to_csv(index=False, lineterminator="\n")
    return text.encode()


def _npz(results: Results) -> bytes:
    buffer, n = io.BytesIO(), len(results.tracks)
    np.savez_compressed(
        buffer,
        models=np.array(results.models),
        tracks=np.array(results.tracks),
        score_names=np.array(SCORES),
        slot_score_names=np.array(SLOT_SCORES),
        curve_names=np.array(CURVES),
        time_s=results.time_s,
        slot_times_s=np.array(results.campaign.slots).reshape(-1, 2),
        seeds=results.seeds,
        scores=results.scores[:, :n],
        slots=results.slots[:, :n],
        curves=results.curves[:, :n],
        cpu_s=results.cpu_s,
    )
    return buffer.getvalue()

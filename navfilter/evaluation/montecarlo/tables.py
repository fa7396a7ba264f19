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
from navfilter.evaluation.montecarlo.slot_tables import SlotRow, slot_rows, slot_table
from navfilter.evaluation.montecarlo.slots import SLOT_SCORES
from navfilter.evaluation.montecarlo.statistics import estimate, interval_text, ratio_interval
from navfilter.evaluation.montecarlo.store import write_whole
from navfilter.foundation.quoting import json_value
from navfilter.rendering.page import table_text

#: No slot.
_WHOLE = (math.nan, math.nan)
#: Models that the others are divided by.
REFERENCES = ("gm1-fitted", "oracle")
_RATIOS = ("heading_rms_deg", "position_rms_m")
_MAIN = {
    "heading_rms_deg": ("heading rms [deg]", ".4f"),
    "position_rms_m": ("position rms [m]", ".2f"),
    "end_m": ("end of dive [m]", ".2f"),
    "end_pct": ("[% of way]", ".3f"),
    "anees_position": ("ANEES position", ".2f"),
    "anees_heading": ("ANEES heading", ".2f"),
}
_FIRST = {
    f"{key}_first": _MAIN[key] for key in ("heading_rms_deg", "position_rms_m", "anees_position", "anees_heading")
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
    """All figures of all models and tracks."""
    found = []
    for m, model in enumerate(results.models):
        for t, track in enumerate(results.tracks):
            for q, quantity in enumerate(SCORES):
                values = results.scores[m, t, :, q]
                n = int(np.isfinite(values).sum())
                if n:
                    found.append(SlotRow(model, track, *_WHOLE, quantity, "", *estimate(quantity, values), runs=n))
    return found


def ratios(results: Results) -> list[SlotRow]:
    """Root mean squares of the models, divided by those of the references on the same missions."""
    found = []
    for reference in REFERENCES:
        if reference not in results.models:
            continue
        r = results.models.index(reference)
        for m, model in enumerate(results.models):
            for t, track in enumerate(results.tracks):
                for quantity in _RATIOS if m != r else ():
                    q = SCORES.index(quantity)
                    pair = results.scores[m, t, :, q], results.scores[r, t, :, q]
                    n = int((np.isfinite(pair[0]) & np.isfinite(pair[1])).sum())
                    found.append(SlotRow(model, track, *_WHOLE, quantity, reference, *ratio_interval(*pair), runs=n))
    return found


def table(results: Results) -> str:
    """Everything that is worth reading on a terminal."""
    campaign, found = results.campaign, {(r.model, r.track, r.quantity): r for r in rows(results)}
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
    if begin > 0.0:
        for track in results.tracks:
            parts.append(f"before {begin:g} s (not scored), {track}\n{_block(results.models, track, _FIRST, found)}")
    compared = ratios(results)
    for reference in dict.fromkeys(row.reference for row in compared):
        parts.append(f"divided by {reference} on the same missions\n{_ratio_block(results, compared, reference)}")
    apart = slot_rows(results)
    if apart:
        parts.append(slot_table(results, apart))
    return "\n\n".join(parts)


def _block(
    models: Iterable[str], track: str, columns: dict[str, tuple[str, str]], found: dict[tuple[str, str, str], SlotRow]
) -> str:
    lines = [
        [model, *(_cell(found.get((model, track, key)), form) for key, (_, form) in columns.items())]
        for model in models
    ]
    return table_text(["model", *(title for title, _ in columns.values())], lines)


def _ratio_block(results: Results, compared: list[SlotRow], reference: str) -> str:
    found = {(r.model, r.track, r.quantity): r for r in compared if r.reference == reference}
    keys = [(quantity, track) for quantity in _RATIOS for track in results.tracks]
    header = ["model", *(f"{quantity.split('_')[0]} rms, {track}" for quantity, track in keys)]
    lines = [
        [m, *(_cell(found.get((m, track, q)), ".3f") for q, track in keys)] for m in results.models if m != reference
    ]
    return table_text(header, lines)


def _cell(row: SlotRow | None, form: str) -> str:
    return "-" if row is None else interval_text(row.value, row.low, row.high, form)


def write_tables(results: Results, folder: Path) -> list[str]:
    """Write table.txt, results.csv, slots.csv, results.json and runs.npz; returns the names."""
    names = ("model", "track", "quantity", "reference", "value", "low", "high", "runs")
    each, apart = map(_dict, (*rows(results), *ratios(results))), slot_rows(results)
    found = [{name: row[name] for name in names} for row in each]
    content = {
        "campaign": results.campaign.settings,
        "models": list(results.models),
        "seeds": results.seeds.tolist(),
        "results": found,
        "slots": [_dict(row) for row in apart],
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

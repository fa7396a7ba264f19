"""What a campaign says slot by slot: figures with intervals over its runs, and how they compare with those of the truth
and of other models.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from navfilter.evaluation.montecarlo.campaign import Results
from navfilter.evaluation.montecarlo.slots import RMS, SLOT_SCORES, Slots
from navfilter.evaluation.montecarlo.statistics import Estimate, estimate, interval_text, ratio_interval
from navfilter.foundation.arrays import Array
from navfilter.rendering.page import table_text

#: By reference: what is divided by its own.
_RATIOS = {
    "oracle": tuple(name for name in SLOT_SCORES if not name.startswith("beyond")),
    "gm1-fitted": tuple(name for name in SLOT_SCORES if "_rms_" in name),
    "vehicle": tuple(name for name in SLOT_SCORES if "_rms_" in name),
}
#: By figure: the columns of its table, as (quantity, reference, title, format, factor).
_TABLES = {
    "heading": (
        ("heading_rms_deg", "", "rms [deg]", ".4f", 1.0),
        *(("heading_rms_deg", name, f"/ {name}", ".3f", 1.0) for name in _RATIOS),
        ("anees_heading", "", "ANEES", ".2f", 1.0),
        ("anees_heading", "oracle", "/ oracle's", ".2f", 1.0),
        ("beyond_heading", "", "beyond 3 sigma [%]", ".2f", 100.0),
    ),
    "position": (
        ("position_rms_m", "", "rms [m]", ".3f", 1.0),
        *(("position_rms_m", name, f"/ {name}", ".3f", 1.0) for name in _RATIOS),
        ("anees_position", "", "ANEES", ".2f", 1.0),
        ("anees_position", "oracle", "/ oracle's", ".2f", 1.0),
        ("beyond_position", "", "beyond 3 sigma [%]", ".2f", 100.0),
    ),
}


@dataclass(frozen=True)
class SlotRow:
    """One figure of one model in one slot, with its 95 % interval over the runs.

    Attributes
    ----------
    model, track : str
    begin_s, end_s : float
        The slot; the last one is all of them together. NaN: what is scored of the whole run.
    quantity : str
        One of `navfilter.evaluation.montecarlo.slots.SLOT_SCORES`, or of the whole run of `SCORES`.
    reference : str
        Of a ratio: the model that is divided by, on the same missions; else empty.
    value, low, high : float
        NaN where there is none.
    runs : int
        That it rests on.
    """

    model: str
    track: str
    begin_s: float
    end_s: float
    quantity: str
    reference: str
    value: float
    low: float
    high: float
    runs: int


def slot_rows(results: Results) -> list[SlotRow]:
    """All figures of all models, tracks and slots, and those of all slots together."""
    cut, values = _with_all(results)
    found = []
    for m, model in enumerate(results.models):
        for t, track in enumerate(results.tracks):
            for s, (begin, end) in enumerate(cut):
                for figure in figures(results.models, values[:, t, :, s], m, SLOT_SCORES, _RATIOS):
                    found.append(SlotRow(model, track, begin, end, *figure))
    return found


def _with_all(results: Results) -> tuple[Slots, Array]:
    """Slots and figures of the runs, all slots together as one more."""
    cut, values = results.campaign.slots, results.slots
    if not cut:
        return cut, values
    weights = np.diff(np.array(cut), axis=1)
    power = values ** np.where(np.char.find(SLOT_SCORES, "rms") >= 0, 2.0, 1.0)
    known = np.isfinite(power) * weights
    with np.errstate(divide="ignore", invalid="ignore"):
        together = np.nansum(power * weights, axis=-2) / known.sum(axis=-2)
    together[..., RMS] = np.sqrt(together[..., RMS])
    return (*cut, (cut[0][0], cut[-1][1])), np.concatenate([values, together[..., None, :]], axis=-2)


def figures(
    models: tuple[str, ...], values: Array, m: int, names: tuple[str, ...], ratios: dict[str, tuple[str, ...]]
) -> Iterator[tuple[str, str, float, float, float, int]]:
    """Figures of one model over its runs, and their ratios to those of the references on the same missions.

    Parameters
    ----------
    models : tuple of str
    values : ndarray, shape (models, runs, figures)
    m : int
        Which model.
    names : tuple of str
        Of the figures.
    ratios : dict of str to tuple of str
        By reference: what is divided by its own.

    Yields
    ------
    quantity, reference, value, low, high, runs
        As in `SlotRow`.
    """
    for q, quantity in enumerate(names):
        own = values[m, :, q]
        if not np.isfinite(own).any():
            continue
        yield quantity, "", *estimate(quantity, own), int(np.isfinite(own).sum())
        for reference, compared in ratios.items():
            if quantity in compared and reference in models and reference != models[m]:
                other = values[models.index(reference), :, q]
                yield quantity, reference, *_ratio(quantity, own, other), int(np.isfinite(own + other).sum())


def _ratio(quantity: str, values: Array, others: Array) -> Estimate:
    """Of root mean squares, or of means."""
    if "rms" in quantity:
        return ratio_interval(values, others)
    value, low, high = ratio_interval(np.sqrt(values), np.sqrt(others))
    return value**2, low**2, high**2


def named(begin_s: float, end_s: float) -> str:
    """A slot as it stands in tables."""
    return f"{begin_s:g}-{end_s:g} s"


def slot_table(results: Results, found: Iterable[SlotRow]) -> str:
    """Tables of heading and position by slots, for every track."""
    by = {(r.track, r.begin_s, r.end_s, r.model, r.quantity, r.reference): r.value for r in found}
    cut, parts = list(dict.fromkeys((r.begin_s, r.end_s) for r in found)), []
    for track in results.tracks:
        for what, columns in _TABLES.items():
            there = [c for c in columns if not c[1] or (c[1] in results.models and len(results.models) > 1)]
            lines = []
            for slot in cut:
                for model in results.models:
                    of = (track, *slot, model)
                    values = (
                        factor * by.get((*of, key, reference), math.nan) for key, reference, _, _, factor in there
                    )
                    cells = (interval_text(value, form=c[3]) for value, c in zip(values, there, strict=True))
                    lines.append([named(*slot), model, *cells])
            header = ["slot", "model", *(title for _, _, title, _, _ in there)]
            parts.append(f"{what} by slots, {track}\n{table_text(header, lines)}")
    return "\n\n".join(parts)

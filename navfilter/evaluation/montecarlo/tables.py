"""What a campaign says: figures with intervals over its runs, ratios between models, as text, CSV, JSON and npz.

Intervals over the runs of a campaign. Within a run the errors depend on each other; the runs do not.
"""

import io
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from navfilter.evaluation.montecarlo.campaign import Results, write_whole
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES
from navfilter.evaluation.montecarlo.slots import RMS, SLOT_SCORES, Slots
from navfilter.foundation.arrays import Array, ArrayLike, Ints
from navfilter.foundation.quoting import json_value
from navfilter.rendering.page import table_text

#: Value, lower end, upper end.
Estimate = tuple[float, float, float]

RESAMPLES = 4000
#: All intervals hold 95 %.
_TAILS = (0.5 - 0.5 * 0.95, 0.5 + 0.5 * 0.95)
_NOTHING: Estimate = (math.nan, math.nan, math.nan)


def mean_interval(values: ArrayLike) -> Estimate:
    """Mean over runs with its interval by Student's t.

    Parameters
    ----------
    values : array_like, shape (n,)
        One per run; NaN is left out.

    Returns
    -------
    value, low, high : float
        No interval (NaN) for a single run.

    Examples
    --------
    >>> [round(v, 4) for v in mean_interval([1.0, 2.0, 3.0])]
    [2.0, -0.4841, 4.4841]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    mean = float(x.mean())
    if x.size == 1:
        return mean, math.nan, math.nan
    half = float(stats.t.ppf(_TAILS[1], x.size - 1) * x.std(ddof=1) / math.sqrt(x.size))
    return mean, mean - half, mean + half


def rms_interval(values: ArrayLike) -> Estimate:
    """Root mean square over runs of their root mean squares, with its percentile bootstrap interval (Efron &
    Tibshirani, 1993, ch. 13).
    """
    return ratio_interval(values, np.ones_like(values, dtype=np.float64))


def ratio_interval(values: ArrayLike, others: ArrayLike) -> Estimate:
    """Ratio of the root mean squares of two models over the same missions, resampled in pairs.

    Parameters
    ----------
    values, others : array_like, shape (n,)
        Of the model and of the one that it is compared with, run by run; a run that one of them lacks (NaN) is left
        out.

    Returns
    -------
    value, low, high : float

    Examples
    --------
    >>> ratio_interval([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    (0.5, 0.5, 0.5)
    """
    a, b = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"the two models must have the same runs, found {a.shape} and {b.shape}.")
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both] ** 2, b[both] ** 2
    if a.size == 0 or not b.any():
        return _NOTHING
    value = math.sqrt(a.mean() / b.mean())
    if a.size == 1:
        return value, math.nan, math.nan
    pick = _resampled(a.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sqrt(a[pick].mean(axis=1) / b[pick].mean(axis=1))
    low, high = np.quantile(ratios, _TAILS)
    return value, float(low), float(high)


def share_interval(values: ArrayLike) -> Estimate:
    """Share of the runs for which something holds (1, not 0), with Wilson's interval (1927).

    Examples
    --------
    >>> [round(v, 4) for v in share_interval([1, 1, 1, 0])]
    [0.75, 0.3006, 0.9544]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    n, p, z = x.size, float(x.mean()), float(stats.norm.ppf(_TAILS[1]))
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return p, max(centre - half, 0.0), min(centre + half, 1.0)


def estimate(quantity: str, values: ArrayLike) -> Estimate:
    """A figure of a campaign by its kind: a root mean square, a share of the runs, or a mean."""
    if "rms" in quantity or quantity == "end_m":
        return rms_interval(values)
    if quantity in ("white", "adopted"):
        return share_interval(values)
    value, low, high = mean_interval(values)
    # with few runs Student's interval does not know that no figure is negative, and that no share is more than all
    most = 1.0 if quantity.startswith("beyond") else math.inf
    return value, max(low, 0.0) if math.isfinite(low) else low, min(high, most) if math.isfinite(high) else high


def interval_text(value: float, low: float = math.nan, high: float = math.nan, form: str = ".3f") -> str:
    """A value with its interval, as far as there are any.

    Examples
    --------
    >>> interval_text(1.0, 0.5, 2.0, ".1f"), interval_text(1.0), interval_text(math.nan)
    ('1.0 (0.5..2.0)', '1.000', '-')
    """
    if not math.isfinite(value):
        return "-"
    return format(value, form) + (f" ({format(low, form)}..{format(high, form)})" if math.isfinite(low) else "")


def _finite(values: ArrayLike) -> Array:
    x = np.asarray(values, dtype=np.float64).ravel()
    return x[np.isfinite(x)]


def _resampled(n: int) -> Ints:
    """Rows of resampled runs; the same ones every time, so that a table can be made again."""
    return np.random.default_rng(20030501).integers(0, n, size=(RESAMPLES, n))


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
#: By reference: what is divided by its own.
_SLOT_RATIOS = {
    "oracle": tuple(name for name in SLOT_SCORES if not name.startswith("beyond")),
    "gm1-fitted": tuple(name for name in SLOT_SCORES if "_rms_" in name),
    "vehicle": tuple(name for name in SLOT_SCORES if "_rms_" in name),
}
#: By figure: the columns of its table, as (quantity, reference, title, format, factor).
_TABLES = {
    what: (
        (rms, "", f"rms [{unit}]", form, 1.0),
        *((rms, name, f"/ {name}", ".3f", 1.0) for name in _SLOT_RATIOS),
        (f"anees_{what}", "", "ANEES", ".2f", 1.0),
        (f"anees_{what}", "oracle", "/ oracle's", ".2f", 1.0),
        (f"beyond_{what}", "", "beyond 3 sigma [%]", ".2f", 100.0),
    )
    for what, rms, unit, form in (
        ("heading", "heading_rms_deg", "deg", ".4f"),
        ("position", "position_rms_m", "m", ".3f"),
    )
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


#: By reference, track, quantity and model.
_Found = dict[tuple[str, str, str, str], SlotRow]


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
        f"{results.seeds[-1]}), {end:g} s each, scored from {begin:g} s; 95 % intervals over the runs."
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


# --- slot by slot -----------------------------------------------------------------------------------------------------


def slot_rows(results: Results) -> list[SlotRow]:
    """All figures of all models, tracks and slots, and those of all slots together."""
    cut, values = _with_all(results)
    found = []
    for m, model in enumerate(results.models):
        for t, track in enumerate(results.tracks):
            for s, (begin, end) in enumerate(cut):
                for figure in figures(results.models, values[:, t, :, s], m, SLOT_SCORES, _SLOT_RATIOS):
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

"""What a campaign says slot by slot: figures with intervals over its runs, and how they compare with those of the truth
and of other models.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from navfilter.evaluation.montecarlo.campaign import Campaign, Results
from navfilter.evaluation.montecarlo.slots import RMS, SLOT_SCORES, SURPRISED_S, Slots
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
#: The model that is judged.
JUDGED = "arma"
#: Before this time [s] a model has little to go by; after this one [s] it has seen enough.
_EARLY_S, _LEARNT_S = 120.0, 520.0
#: ANEES over that of the truth, by gyro: a poor one hides more of a sensor's error.
_HONEST = {"tactical": (0.5, 1.6), "mems": (0.3, 1.6)}
_HONEST_EARLY = (0.0, 2.5)
#: Share of errors beyond three sigma.
_BEYOND = 0.015
#: Root mean squares over those of the truth: heading until and after `_LEARNT_S`, position, and where the truth is
#: white.
_HEADING, _HEADING_LEARNT, _POSITION, _WHITE = 1.15, 1.06, 1.05, 1.03
#: Over Gauss-Markov fitted to the whole mission beforehand.
_FITTED = 1.02
#: Than the vehicle's description.
_BETTER = math.nextafter(1.0, 0.0)
#: ANEES after a change.
_CHANGED = (0.5, 2.0)
_TITLES = {
    "heading_rms_deg": "heading rms", "position_rms_m": "position rms", "down_rms_m": "down rms",
    "anees_heading": "ANEES heading", "anees_position": "ANEES position",
    "beyond_heading": "heading beyond 3 sigma", "beyond_position": "position beyond 3 sigma",
}  # fmt: skip
#: Quantity, reference (empty: none), least and most.
_Limit = tuple[str, str, float, float]


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
                for quantity, reference, found_as, runs in _figures(results.models, values[:, t, :, s], m):
                    found.append(SlotRow(model, track, begin, end, quantity, reference, *found_as, runs=runs))
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


def _figures(models: tuple[str, ...], values: Array, m: int) -> Iterator[tuple[str, str, Estimate, int]]:
    """Of one model in one slot: quantity, reference, estimate and runs; values (models, runs, figures)."""
    for q, quantity in enumerate(SLOT_SCORES):
        own = values[m, :, q]
        if not np.isfinite(own).any():
            continue
        yield quantity, "", estimate(quantity, own), int(np.isfinite(own).sum())
        for reference, compared in _RATIOS.items():
            if quantity in compared and reference in models and reference != models[m]:
                other = values[models.index(reference), :, q]
                yield quantity, reference, _ratio(quantity, own, other), int(np.isfinite(own + other).sum())


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


# --- what the learnt model is held to --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bar(SlotRow):
    """One figure and where it has to lie.

    Attributes
    ----------
    least, most : float
        Both count as met.
    """

    least: float
    most: float

    @property
    def met(self) -> bool:
        """Whether the figure lies where it has to; its interval says how sure that is."""
        return self.least <= self.value <= self.most


def bars(campaign: Campaign, found: Iterable[SlotRow]) -> list[Bar]:
    """The bars that apply to the learnt model of a campaign; those whose figure is missing are left out.

    Parameters
    ----------
    campaign : Campaign
    found : iterable of SlotRow
        See `navfilter.evaluation.montecarlo.slot_tables.slot_rows`.
    """
    by = {(r.track, r.begin_s, r.end_s, r.quantity, r.reference): r for r in found if r.model == JUDGED}
    result = []
    for track, begin, end in dict.fromkeys(key[:3] for key in by):
        for quantity, reference, least, most in _limits(campaign, begin, end):
            row = by.get((track, begin, end, quantity, reference))
            if row is not None and math.isfinite(row.value):
                result.append(Bar(**asdict(row), least=least, most=most))
    return result


def _limits(campaign: Campaign, begin_s: float, end_s: float) -> Iterator[_Limit]:
    whole = len(campaign.slots) > 1 and (begin_s, end_s) == (campaign.slots[0][0], campaign.slots[-1][1])
    changes_s = campaign.staged.changes_s
    if changes_s is not None:
        if whole:
            yield "heading_rms_deg", "gm1-fitted", 0.0, 1.0
        elif begin_s >= changes_s + SURPRISED_S:
            yield "anees_heading", "", *_CHANGED
            yield "anees_position", "", *_CHANGED
    elif not whole:
        yield from _honest(campaign, begin_s)
        yield from _accurate(campaign, begin_s)


def _honest(campaign: Campaign, begin_s: float) -> Iterator[_Limit]:
    early = begin_s < _EARLY_S
    # a slow error too small to be excluded makes modest; that is told and not judged where the truth is white
    if campaign.staged.study.kind != "white":
        limits = _HONEST_EARLY if early else _HONEST[campaign.gyro]
        yield "anees_heading", "oracle", *limits
        yield "anees_position", "oracle", *limits
    if not early:
        yield "beyond_heading", "", 0.0, _BEYOND
        yield "beyond_position", "", 0.0, _BEYOND


def _accurate(campaign: Campaign, begin_s: float) -> Iterator[_Limit]:
    study, learnt = campaign.staged.study, begin_s >= _LEARNT_S
    white = study.kind == "white" and begin_s >= _EARLY_S
    yield "heading_rms_deg", "oracle", 0.0, _WHITE if white else _HEADING_LEARNT if learnt else _HEADING
    place = ("position_rms_m", "down_rms_m") if study.sensor == "depth" else ("position_rms_m",)
    for quantity in place:
        yield quantity, "oracle", 0.0, _WHITE if white else _POSITION
    if learnt:
        for quantity in ("heading_rms_deg", *place):
            yield quantity, "gm1-fitted", 0.0, _FITTED
        if study.misled:
            yield ("heading_rms_deg" if study.sensor == "compass" else place[-1]), "vehicle", 0.0, _BETTER


def bar_table(found: Sequence[Bar], tracks: Sequence[str]) -> str:
    """One row per slot and figure, PASS or miss for every track."""
    by = {(b.begin_s, b.end_s, b.quantity, b.reference, b.track): b for b in found}
    lines = []
    for key in dict.fromkeys(key[:4] for key in by):
        there = [by.get((*key, track)) for track in tracks]
        one = next(bar for bar in there if bar is not None)
        lines.append([named(*key[:2]), _title(one), _where(one), *map(_verdict, there)])
    missed = sum(not bar.met for bar in found)
    return f"bars for {JUDGED}: {len(found) - missed} of {len(found)} met\n" + table_text(
        ["slot", "figure", "bar", *tracks], lines
    )


def _title(bar: Bar) -> str:
    return _TITLES[bar.quantity] + (f" / {bar.reference}" if bar.reference else "")


def _where(bar: Bar) -> str:
    form, factor, unit = (".1f", 100.0, " %") if bar.quantity.startswith("beyond") else ("g", 1.0, "")
    most = f"{factor * bar.most:{form}}{unit}"
    if bar.least > 0.0:
        return f"{bar.least:g} to {most}"
    return f"{'<' if bar.most == _BETTER else '<='} {most}"


def _verdict(bar: Bar | None) -> str:
    if bar is None:
        return "-"
    form, factor = (".2f", 100.0) if bar.quantity.startswith("beyond") else (".3f", 1.0)
    text = interval_text(factor * bar.value, factor * bar.low, factor * bar.high, form)
    return f"{text} {'PASS' if bar.met else 'miss'}"

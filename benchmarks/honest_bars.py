"""What the learnt model of a campaign is held to, slot by slot: `honest.py` counts what holds."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass

from navfilter.evaluation.montecarlo.campaign import Campaign, SlotRow
from navfilter.evaluation.montecarlo.slots import SURPRISED_S

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
#: Quantity, reference (empty: none), least and most.
_Limit = tuple[str, str, float, float]


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
        See `navfilter.evaluation.montecarlo.campaign.slot_rows`.
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

"""What happened on the way: times without a sensor, surfacings, adoptions of learnt models."""

from __future__ import annotations

import numpy as np

from navfilter.evaluation.fix_reacquisition import OUTAGE_S, OUTAGE_STEPS, Surfacing
from navfilter.evaluation.learned_text import LearnedText
from navfilter.models.during import same_sensor
from navfilter.rendering.panels import Mark, short
from navfilter.report.lane_figures import lane_marks
from navfilter.track.track import Track

SURFACING, ADOPTION = "#006d2c", "#d94801"
#: Of the outages of one sensor after the other.
OUTAGES = ("#8c6bb1", "#7fa8c9", "#c9a227", "#b0647a")
#: Of more adoptions than this the figures over all sensors show every n-th.
MOST = 60


def marks(track: Track, surfacings: tuple[Surfacing, ...], learnt: tuple[LearnedText, ...]) -> tuple[Mark, ...]:
    """Everything worth a mark in the figures over time.

    Parameters
    ----------
    track : Track
        For its outages.
    surfacings : tuple of Surfacing
    learnt : tuple of LearnedText
    """
    found = [mark for name in track.residuals for mark in outages(track, name)]
    found += [Mark(s.time_s, s.time_s, "surfacing", str(s), SURFACING) for s in surfacings]
    adopted = adoptions(learnt, float(track.time_s[0]))
    return (*found, *lane_marks(track), *adopted[:: -(-len(adopted) // MOST) or 1])


def outages(track: Track, name: str) -> list[Mark]:
    """Times in which no reading of a sensor was used: longer than 30 s and than five of its usual steps.

    Parameters
    ----------
    track : Track
    name : str
        The sensor.
    """
    run = track.forward or track
    names = same_sensor(name, run.vehicle.sensors)
    if name not in run.residuals or not names:
        return []
    hue = OUTAGES[list(run.vehicle.sensors).index(name) % len(OUTAGES)]
    used = np.sort(np.concatenate([r.time_s[r.used] for r in map(run.residuals.get, names) if r is not None]))
    ends = np.concatenate([[run.time_s[0]], used, [run.time_s[-1]]])
    steps = np.diff(ends)
    least_s = max(OUTAGE_S, OUTAGE_STEPS * float(np.median(np.diff(used))) if len(used) > 1 else 0.0)
    return [
        Mark(float(ends[k]), float(ends[k + 1]), f"no {short(name)}", f"no {name} used for {steps[k]:.0f} s", hue)
        for k in np.flatnonzero(steps > least_s)
    ]


def adoptions(learnt: tuple[LearnedText, ...], begin_s: float) -> list[Mark]:
    """The moments after `begin_s` at which a learnt model came into force; a run may begin with one."""
    return [
        Mark(t, t, "model adopted", f"{history.title}: model of order ({model.p}, {model.q}) adopted", ADOPTION)
        for history in learnt
        for t, model in zip(history.time_s, history.models, strict=True)
        if t > begin_s
    ]

"""All that is said of a run beside its figures against a truth, gathered once for console, summary and report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from navfilter.calibration.lights import Light
from navfilter.evaluation.calibration_states import constant_lights
from navfilter.evaluation.control_points import Control, ControlPoint, control_residuals
from navfilter.evaluation.fix_reacquisition import Evidence, evidence
from navfilter.evaluation.learned_text import LearnedText, learnt
from navfilter.evaluation.survey_figures import SurveyFigures, survey_figures
from navfilter.evaluation.verdict import Verdict, judge
from navfilter.models.mission import Mission
from navfilter.playback.backward import Apart, apart
from navfilter.playback.held_out import Score, Withheld, drift, score
from navfilter.track.track import Track, Tracks


@dataclass(frozen=True)
class Assessment:
    """What a run says of itself.

    Attributes
    ----------
    evidence : Evidence
        By its fixes, its covariance and its smoothed track.
    verdict : Verdict
        What speaks against the track.
    learnt : tuple of LearnedText
        What every axis has learnt.
    scores : dict of str to tuple of Score
        Against the fixes withheld, by label of the run; empty where none were.
    lights : tuple of Light
        How far each constant is told.
    survey : SurveyFigures or None
        Of the result.
    control : tuple of Control
        The result at surveyed places.
    apart : Apart or None
        The run against an independent one from the end to the beginning.
    """

    evidence: Evidence
    verdict: Verdict
    learnt: tuple[LearnedText, ...] = ()
    scores: dict[str, tuple[Score, ...]] = field(default_factory=dict)
    lights: tuple[Light, ...] = ()
    survey: SurveyFigures | None = None
    control: tuple[Control, ...] = ()
    apart: Apart | None = None

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, to be added to ``summary.json``."""
        scores = {label: {s.sensor: s.to_dict() for s in found} for label, found in self.scores.items()}
        own: dict[str, Any] = {"verdict": self.verdict.to_dict(), "without_truth": self.evidence.to_dict()}
        if self.learnt:
            own["learnt"] = {found.title: found.to_dict() for found in self.learnt}
        if self.survey is not None:
            own["survey"] = self.survey.to_dict()
        if self.control:
            own["control"] = [one.to_dict() for one in self.control]
        if self.apart is not None:
            own["backward"] = self.apart.to_dict()
        if self.lights:
            own["constants"] = {light.name: light.to_dict() for light in self.lights}
        return {**own, **({"withheld": scores} if scores else {})}

    def remarks(self, mission: str) -> dict[str, str]:
        """What was learnt as one line of plain text by sensor or part of the drive, for vehicle_learned.toml."""
        found: dict[str, list[str]] = {}
        for axis in self.learnt:
            found.setdefault(axis.title.split(" ")[0], []).append(f"{axis.title}: {axis.words}")
        where = " ".join(mission.split())
        return {name: f"learnt on {where}: {'; '.join(words)}" for name, words in found.items()}

    def lines(self) -> Iterator[str]:
        """Evidence and scores in words, one line per fact."""
        for label, found in self.scores.items():
            yield from (f"{label}: {s}" for s in found)
        yield from self.evidence.lines()
        yield from () if self.apart is None else (str(self.apart),)
        yield from self.survey.lines() if self.survey is not None else ()
        yield from map(str, self.control)


def assess(
    tracks: Tracks,
    mission: Mission,
    withheld: Sequence[Withheld] = (),
    limits: Sequence[tuple[str, float, str]] = (),
    control: Sequence[ControlPoint] = (),
    back: Track | None = None,
) -> Assessment:
    """Assess a run.

    Parameters
    ----------
    tracks : dict of str to Track
        By label, the result last, see `navfilter.io.write.labelled`.
    mission : Mission
        As it was replayed.
    withheld : sequence of Withheld
        Readings that the filter did not get, see `navfilter.playback.held_out.withhold`.
    limits : sequence of (str, float, str)
        Of the sds of constants, see `navfilter.calibration.lights.limit_of`.
    control : sequence of ControlPoint
        Surveyed places.
    back : Track, optional
        Of `navfilter.playback.backward.backward`.

    Raises
    ------
    ValueError
        For a limit of no constant.
    """
    scores = {}
    for label, track in tracks.items():
        found = tuple(s for s in (score(track, readings) for readings in withheld) if s is not None)
        if found:
            scores[label] = found
    result = list(tracks.values())[-1]
    own = evidence(result)
    tested = [drift(result.vehicle, mission, one) for one in withheld]
    drifts = [one for one in tested if one is not None]
    lights = constant_lights(result, limits)
    at = control_residuals(result, control)
    separated = None if back is None else apart(result, back)
    verdict = judge(result, mission, own, drifts=drifts, separated=separated)
    return Assessment(own, verdict, learnt(result), scores, lights, survey_figures(result), at, separated)

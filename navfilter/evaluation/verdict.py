"""The verdict on a run: whether its track is to be trusted, what speaks against it, and how to look further."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from navfilter.check.finding import Finding
from navfilter.evaluation.diagnostics import LIMITS, Limits, doubts
from navfilter.evaluation.fix_reacquisition import Evidence
from navfilter.models.mission import Mission
from navfilter.track.track import Track

__all__ = ["Verdict", "judge"]

#: The console shows so many findings; the report has all.
MOST_LINES = 6


@dataclass(frozen=True)
class Verdict:
    """What speaks against a track.

    Attributes
    ----------
    findings : tuple of Finding
        The gravest first: "error": the track is not to be trusted; "warning": to be used with care; "info": a remark.
    praise : str
        What speaks for it.
    """

    findings: tuple[Finding, ...]
    praise: str

    @property
    def trusted(self) -> bool:
        """Whether nothing is wrong: the exit code of the command is 0."""
        return not any(finding.severity == "error" for finding in self.findings)

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        doubts = [finding for finding in self.findings if finding.severity == "warning"]
        if not self.trusted:
            return "This track is not to be trusted."
        return "This track is to be used with care." if doubts else f"Nothing speaks against this track: {self.praise}."

    def lines(self) -> list[str]:
        """What was found, one line each."""
        return [
            f"{'remark: ' if f.severity == 'info' else ''}{f'{f.stream}: ' if f.stream else ''}{f.text}"
            for f in self.findings
        ]

    def cures(self) -> list[str]:
        """How to look further, without repeating what serves several findings."""
        return list(dict.fromkeys(finding.cure for finding in self.findings if finding.cure))

    def __str__(self) -> str:
        found, cures = self.lines(), self.cures()
        text = [f"Verdict: {self.headline}", *(f"  - {line}" for line in found[:MOST_LINES])]
        if len(found) > MOST_LINES:
            text.append(f"  - and {len(found) - MOST_LINES} more, see report.html")
        return "\n".join([*text, *(f"  -> {cure}" for cure in cures[:MOST_LINES])])

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values."""
        findings = [{"severity": f.severity, "sensor": f.stream, "text": f.text, "cure": f.cure} for f in self.findings]
        return {"trusted": self.trusted, "headline": self.headline, "findings": findings}


def judge(track: Track, mission: Mission, evidence: Evidence, limits: Limits = LIMITS) -> Verdict:
    """Judge a run by its own figures; a truth is not asked.

    Parameters
    ----------
    track : Track
        Forward or smoothed.
    mission : Mission
        As it was replayed.
    evidence : Evidence
        Of the run.
    limits : Limits
    """
    run = track.forward or track
    rank = {"error": 0, "warning": 1, "info": 2}
    found = sorted(doubts(run, mission, evidence, limits), key=lambda finding: rank[finding.severity])
    return Verdict(tuple(found), _praise(run, evidence))


def _praise(run: Track, evidence: Evidence) -> str:
    judged = {n: (r.count("used"), r.count("rejected")) for n, r in run.residuals.items() if n in run.vehicle.sensors}
    used, rejected = (sum(pair[i] for pair in judged.values()) for i in (0, 1))
    share = f"{100 * used / max(used + rejected, 1):.1f} % of the readings of {', '.join(judged) or 'no sensor'} fit"
    sd = f"predicted sd of the position {evidence.sd_end_m:.2f} m at the end"
    inside = sum(s.inside for s in evidence.surfacings)
    back = f", {inside} of {len(evidence.surfacings)} surfacings where they should be" if evidence.surfacings else ""
    return f"{share}{back}, {sd}"

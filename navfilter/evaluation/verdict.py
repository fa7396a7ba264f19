"""The verdict on a run: whether its track is to be trusted, what speaks against it, and how to look further. A track
that nothing in the mission could contradict is not judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navfilter.check import data_findings
from navfilter.check.finding import Finding, by_severity
from navfilter.evaluation.diagnostics import LIMITS, Limits, doubts
from navfilter.evaluation.fix_reacquisition import Evidence
from navfilter.io.mission_toml import STANDS_IN
from navfilter.models.mission import Mission
from navfilter.playback.backward import Apart
from navfilter.playback.held_out import Drift
from navfilter.track.track import Track

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
    lacking : tuple of str
        Evidence that is missing for any judgement; empty: none.
    """

    findings: tuple[Finding, ...]
    praise: str
    lacking: tuple[str, ...] = ()

    @property
    def wrong(self) -> bool:
        """Whether something speaks against the track."""
        return any(finding.severity == "error" for finding in self.findings)

    @property
    def judged(self) -> bool:
        """Whether the mission holds what a track can be judged by."""
        return not self.lacking

    @property
    def trusted(self) -> bool:
        """Whether the track is judged, and nothing is wrong: the exit code of the command is 0."""
        return self.judged and not self.wrong

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        doubts = [finding for finding in self.findings if finding.severity == "warning"]
        lacking = f": {'; '.join(self.lacking)}." if self.lacking else "."
        if self.wrong:
            return f"This track is not to be trusted{lacking}"
        if not self.judged:
            return f"This track is not judged{lacking}"
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
        findings = [
            {"severity": f.severity, "code": f.code, "sensor": f.stream, "text": f.text, "cure": f.cure}
            for f in self.findings
        ]
        judged = {"trusted": self.trusted, "judged": self.judged}
        return {**judged, "headline": self.headline, "findings": findings}


def judge(
    track: Track,
    mission: Mission,
    evidence: Evidence,
    limits: Limits = LIMITS,
    drifts: Sequence[Drift] = (),
    separated: Apart | None = None,
) -> Verdict:
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
    drifts : sequence of Drift
        What fixes say that were withheld.
    separated : Apart, optional
        The run against an independent one backward.
    """
    run = track.forward or track
    # first what the data say of each other: what the run shows comes of it
    found = [f for f in data_findings(replace(mission, truth=None), run.vehicle) if not _estimated(f, run)]
    found += [
        *doubts(run, mission, evidence, limits),
        *_drifted(drifts, limits),
        *_separated(separated, limits),
        *_remarks(mission),
    ]
    return Verdict(by_severity(found), _praise(run, evidence), tuple(_lacking(run, mission)))


#: Code of a finding -> words in the names of the states that hold the same.
_STATES = {"mounting": ("misalignment", ".bias"), "delay": ("time_offset",), "scale": ("scale",)}
#: What a zero velocity that stands in may be corrected by.
_VELOCITIES = ("velocity",)


def _estimated(finding: Finding, run: Track) -> bool:
    """Whether the filter had states for what a finding is about."""
    return any(word in state for word in _STATES.get(finding.code, ()) for state in run.state_names)


def _drifted(drifts: Sequence[Drift], limits: Limits) -> Iterator[Finding]:
    """Fixes withheld that find more drift than was predicted."""
    for found in drifts:
        if found.chance < limits.chance:
            text = f"{found.count} of the fixes withheld, {found.apart_s:.0f} s apart, find a drift of a mean NIS of "
            text += f"{found.nis:.1f}, where 1 is honest, that goes on in one direction by {found.lasting:.1f} sd."
            cure = "Give what drives, and its velocity, larger or slower errors in vehicle.toml."
            yield Finding("error" if found.nis > limits.nis[1] else "warning", "drift", found.sensor, text, cure)


def _separated(found: Apart | None, limits: Limits) -> Iterator[Finding]:
    """Runs forward and backward that are farther apart than two honest ones."""
    if found is not None and found.chance < limits.chance:
        text = f"the runs forward and backward are {np.sqrt(found.nis):.1f} times as far apart as both predict."
        cure = "See in report.html, at Forward and backward, where they part: what is read there contradicts the rest."
        yield Finding("error" if found.nis > limits.nis[1] ** 2 else "warning", "backward", "", text, cure)


def _remarks(mission: Mission) -> Iterator[Finding]:
    """What the reader says of the times."""
    for note in mission.notes:
        if "UTC is unknown" in note:
            yield Finding("info", "clock", "", note.removesuffix("."))


def _lacking(run: Track, mission: Mission) -> Iterator[str]:
    """Why a track is not judged: what drives was not measured, or nothing could have contradicted it."""
    heard = {name: r.count("used") for name, r in run.residuals.items() if name in run.vehicle.sensors}
    used = [run.vehicle.sensors[name].observes.corrects for name, count in heard.items() if count]
    for name in run.vehicle.driving:
        stream = mission.streams.get(name)
        said = f"{name} {STANDS_IN}" in mission.notes
        still = stream is not None and name == "velocity" and not np.nan_to_num(stream.value).any()
        if said or (still and not set(used) & set(_VELOCITIES)):
            yield f"{name} {STANDS_IN}"
    if not set(used) - {"depth", ""}:
        yield "nothing on board corrects what drives" + (", but the depth" if used else "")


def _praise(run: Track, evidence: Evidence) -> str:
    judged = {n: (r.count("used"), r.count("rejected")) for n, r in run.residuals.items() if n in run.vehicle.sensors}
    used, rejected = (sum(pair[i] for pair in judged.values()) for i in (0, 1))
    share = f"{100 * used / max(used + rejected, 1):.1f} % of the readings of {', '.join(judged) or 'no sensor'} fit"
    sd = f"predicted sd of the position {evidence.sd_end_m:.2f} m at the end"
    inside = sum(s.inside for s in evidence.surfacings)
    back = f", {inside} of {len(evidence.surfacings)} surfacings where they should be" if evidence.surfacings else ""
    return f"{share}{back}, {sd}"

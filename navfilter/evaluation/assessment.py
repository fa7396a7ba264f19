"""All that is said of a run beside its figures against a truth, gathered once for console, summary and report.

The verdict on a run: whether its track is to be trusted, what speaks against it, and how to look further. A track
that nothing in the mission could contradict is not judged.

Surveyed places against a track: where it was at their times, or how near it came to them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from navfilter.calibration.lights import Light
from navfilter.check import data_findings
from navfilter.check.finding import Finding, by_severity
from navfilter.evaluation.correlations import constant_lights
from navfilter.evaluation.diagnostics import LIMITS, Evidence, Limits, doubts, evidence
from navfilter.evaluation.over_dives_text import LearnedText, learnt
from navfilter.foundation.arrays import Array
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.foundation.quoting import one_line
from navfilter.io.mission_toml import STANDS_IN
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import read_table
from navfilter.io.trust import Place
from navfilter.models.mission import Mission, MissionError
from navfilter.playback.replay import Apart, Drift, Score, Withheld, apart, drift, score
from navfilter.track.heave import heave
from navfilter.track.track import Track, Tracks


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed place.

    Attributes
    ----------
    name : str
    latitude, longitude : float
        [rad].
    height : float
        Above the ellipsoid [m]; NaN: not known.
    time_s : float
        When the vehicle was there [s]; NaN: where it came nearest.
    """

    name: str
    latitude: float
    longitude: float
    height: float = math.nan
    time_s: float = math.nan


@dataclass(frozen=True)
class Control:
    """The track at a surveyed place, minus that place.

    Attributes
    ----------
    name : str
    time_s : float
        Of the comparison [s].
    nearest : bool
        At the nearest approach: only what is across the way counts.
    north_m, east_m, up_m : float
        [m]; `up_m` is NaN where the place has no height.
    sd_m : float
        Predicted standard deviation of the horizontal distance, along it [m]; the place itself counts as known.
    inside : bool or None
        Whether it lies where 95 % of honest ones do; None, and NaN for all lengths, where no track is at its time.
    """

    name: str
    time_s: float
    nearest: bool
    north_m: float
    east_m: float
    up_m: float
    sd_m: float
    inside: bool | None

    @property
    def distance_m(self) -> float:
        """Horizontal [m]."""
        return math.hypot(self.north_m, self.east_m)

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        return {**asdict(self), "distance_m": self.distance_m}

    def __str__(self) -> str:
        if self.inside is None:
            return f"control point {self.name}: there is no track at its {self.time_s:.1f} s"
        where = "inside" if self.inside else "outside"
        how = "nearest" if self.nearest else "passed"
        return (
            f"control point {self.name}, {how} at {self.time_s:.1f} s: {self.distance_m:.2f} m off "
            f"({self.north_m:+.2f} north, {self.east_m:+.2f} east), predicted sd {self.sd_m:.2f} m, "
            f"{where} the 95 % range"
        )


def read_control_points(path: Path) -> tuple[ControlPoint, ...]:
    """Places of a table with the columns name, latitude_deg, longitude_deg, and perhaps height_m and time_s.

    Raises
    ------
    MissionError
        Where a column is missing, or a place cannot be one.
    """
    table = read_table(Place.of(path), TableOptions())
    missing = [name for name in ("name", "latitude_deg", "longitude_deg") if name not in table.columns]
    if missing:
        raise MissionError(
            f"{path}: no column {' and '.join(missing)}. Control points have the columns name, latitude_deg, "
            "longitude_deg, and perhaps height_m and time_s (of the mission clock; empty: the nearest approach)."
        )
    unknown = np.full(len(table.raw("name")), np.nan)
    latitude, longitude, height, time_s = (
        table.numbers(name)[0] if name in table.columns else unknown
        for name in ("latitude_deg", "longitude_deg", "height_m", "time_s")
    )
    wrong = ~((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0))
    if wrong.any():
        row = int(wrong.argmax())
        raise MissionError(f"{path}: row {row + 1} is no place: latitude_deg and longitude_deg are decimal degrees.")
    rows = zip(table.raw("name").tolist(), np.radians(latitude), np.radians(longitude), height, time_s, strict=True)
    return tuple(ControlPoint(one_line(str(name)), *map(float, numbers)) for name, *numbers in rows)


def control_residuals(track: Track, points: Sequence[ControlPoint]) -> tuple[Control, ...]:
    """The track against surveyed places.

    Parameters
    ----------
    track : Track
    points : sequence of ControlPoint
    """
    return tuple(_control(track, point) for point in points)


def _control(track: Track, point: ControlPoint) -> Control:
    nearest = math.isnan(point.time_s)
    time_s = _nearest_s(track, point) if nearest else point.time_s
    if not track.time_s[0] <= time_s <= track.time_s[-1]:
        return Control(point.name, time_s, nearest, math.nan, math.nan, math.nan, math.nan, None)
    there = track.at(time_s)
    offset = there.local(point.latitude, point.longitude)[0, :2]
    covariance = there.covariance[0, :2, :2]
    distance = math.hypot(*offset)
    along = offset / distance if distance > 0.0 else np.array([1.0, 0.0])
    sd = math.sqrt(max(float(along @ covariance @ along), 0.0))
    # across the way there is one degree of freedom
    square = (distance / sd) ** 2 if nearest and sd > 0.0 else float(offset @ np.linalg.pinv(covariance) @ offset)
    inside = square <= chi_square_limit(0.95, 1.0 if nearest else 2.0)
    up = float(there.height[0]) - point.height
    return Control(point.name, time_s, nearest, float(offset[0]), float(offset[1]), up, sd, bool(inside))


def _nearest_s(track: Track, point: ControlPoint) -> float:
    """When the way between the rows comes nearest."""
    offsets = track.local(point.latitude, point.longitude)[:, :2]
    step = np.diff(offsets, axis=0)
    square = (step**2).sum(axis=1)
    share = np.divide(-(offsets[:-1] * step).sum(axis=1), square, out=np.zeros_like(square), where=square > 0.0)
    share = np.clip(share, 0.0, 1.0)
    k = int(np.argmin(np.hypot(*(offsets[:-1] + share[:, np.newaxis] * step).T)))
    return float(track.time_s[k] + share[k] * (track.time_s[k + 1] - track.time_s[k]))


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


#: Orders of IHO S-44 (edition 6) -> total horizontal and vertical uncertainty that it allows at depth 0, 95 % [m]. In
#: deep water they allow more; 1a and 1b are alike in both.
ORDERS = {"exclusive": (1.0, 0.15), "special": (2.0, 0.25), "1a/1b": (5.0, 0.5), "2": (20.0, 1.0)}


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
    survey: "SurveyFigures | None" = None
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
        Readings that the filter did not get, see `navfilter.playback.replay.withhold`.
    limits : sequence of (str, float, str)
        Of the sds of constants, see `navfilter.calibration.lights.limit_of`.
    control : sequence of ControlPoint
        Surveyed places.
    back : Track, optional
        Of `navfilter.playback.replay.backward`.

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


# --- figures of a survey ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SurveyFigures:
    """Predicted uncertainty along a track.

    Attributes
    ----------
    cep50_mean_m, cep50_most_m : float
        Radius of the circle that holds the horizontal error in one case of two [m].
    r95_mean_m, r95_most_m : float
        The same in 95 of 100 cases: what S-44 calls THU [m].
    tvu_mean_m, tvu_most_m : float
        Bound of the vertical error in 95 of 100 cases [m].
    orders : dict of str to float
        Share of the way on which the vehicle's position meets an order, in per cent.
    horizontal : dict of str to float
        The same of the horizontal position alone: all there is of a mission without depths or heights.
    heave_rms_m : float or None
        Rms of `navfilter.track.heave.heave` [m]; None without an inertial unit, and for rows too far apart.
    """

    cep50_mean_m: float
    cep50_most_m: float
    r95_mean_m: float
    r95_most_m: float
    tvu_mean_m: float
    tvu_most_m: float
    orders: dict[str, float]
    horizontal: dict[str, float]
    heave_rms_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        return asdict(self)

    def lines(self) -> Iterator[str]:
        """The same in words."""
        yield (
            f"CEP50 {self.cep50_mean_m:.2f} m on average ({self.cep50_most_m:.2f} m at most), R95 "
            f"{self.r95_mean_m:.2f} m ({self.r95_most_m:.2f}), vertical 95 % {self.tvu_mean_m:.2f} m "
            f"({self.tvu_most_m:.2f})"
        )
        if self.heave_rms_m is not None:
            yield f"heave (up and down faster than 30 s) {self.heave_rms_m:.3f} m rms"
        both, alone = (
            ", ".join(f"{name} {share:.0f} %" for name, share in shares.items())
            for shares in (self.orders, self.horizontal)
        )
        both += f"; horizontally alone: {alone}" * (alone != both)
        yield f"of the way within the orders of IHO S-44 (position of the vehicle alone, limits of depth 0): {both}"


def survey_figures(track: Track) -> SurveyFigures:
    """Figures of a track from its covariance; only as good as that is honest.

    Parameters
    ----------
    track : Track
    """
    cep50, r95 = (radius(track.covariance[:, :2, :2], share) for share in (0.5, 0.95))
    vertical = float(ndtri(0.975)) * np.sqrt(np.maximum(track.covariance[:, 2, 2], 0.0))
    way = np.diff(track.travelled(), append=track.distance_m)
    way = way if way.sum() > 0.0 else np.ones(len(track))
    level = {name: r95 <= thu for name, (thu, _) in ORDERS.items()}
    whole = {name: level[name] & (vertical <= tvu) for name, (_, tvu) in ORDERS.items()}
    orders, horizontal = (
        {name: float(100.0 * way[met].sum() / way.sum()) for name, met in each.items()} for each in (whole, level)
    )
    return SurveyFigures(
        *(float(cep50.mean()), float(cep50.max())),
        *(float(r95.mean()), float(r95.max())),
        *(float(vertical.mean()), float(vertical.max())),
        orders=orders,
        horizontal=horizontal,
        heave_rms_m=_heave_rms_m(track),
    )


def _heave_rms_m(track: Track) -> float | None:
    try:
        return float(np.sqrt(np.mean(heave(track) ** 2)))
    except ValueError:  # nobody asked for it
        return None


def radius(covariance: Array, share: float) -> Array:
    """Radius of the circle around a horizontal position that holds it with a given probability [m].

    Parameters
    ----------
    covariance : ndarray, shape (n, 2, 2)
    share : float
        The probability.

    Examples
    --------
    >>> radius(np.eye(2)[np.newaxis], 0.95).round(3).tolist()
    [2.448]
    """
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0)).T
    ratio = np.divide(small, large, out=np.zeros_like(small), where=large > 0.0)
    ratios, radii = _radii(share)
    return np.asarray(large * np.interp(ratio, ratios, radii))


@cache
def _radii(share: float) -> tuple[Array, Array]:
    """Ratio of the two standard deviations, and the radius for that in units of the larger one.

    Notes
    -----
    In polar coordinates the density can be integrated along the radius; along the angle the rule of rectangles is exact
    to all digits for a smooth function of a whole turn.
    """
    ratios = np.linspace(0.0, 1.0, 101)
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    radii = np.empty(ratios.size)
    radii[0] = ndtri(0.5 * (1.0 + share))  # all along one line
    for k, ratio in enumerate(ratios[1:], start=1):
        weight = np.cos(angle) ** 2 + (np.sin(angle) / ratio) ** 2
        low, high = 0.0, 5.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            inside = np.mean(-np.expm1(-0.5 * weight * middle**2) / weight) / ratio
            low, high = (middle, high) if inside < share else (low, middle)
        radii[k] = 0.5 * (low + high)
    return ratios, radii

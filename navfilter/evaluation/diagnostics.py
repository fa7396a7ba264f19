"""What may speak against a track: impossible motion, lost samples, clocks, sensors that are rejected or dishonest.

How good a track is where no truth is known: what returning fixes say, and what the smoother changed.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import bdtrc, gammaincc

from navfilter.check.course import north_findings
from navfilter.check.finding import Finding, Severity
from navfilter.evaluation.correlations import constant_doubts, correlation_doubts
from navfilter.evaluation.omitted_parameters import left_out_doubts
from navfilter.faults.imu.monitor import COUNTED
from navfilter.filter.records import OUTCOMES, Residuals
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.foundation.display import counted
from navfilter.models.error_models import per_axis
from navfilter.models.fault_bias import descriptions, has_offset
from navfilter.models.lane_missions import last_unit, of_one_unit
from navfilter.models.mission import Mission
from navfilter.models.sensors.traits import shown_unit
from navfilter.models.vehicle import DEAD_RECKONING
from navfilter.track.track import Track

#: A time without fixes is an outage when it is longer than this [s], and than so many of their usual steps.
OUTAGE_S, OUTAGE_STEPS = 30.0, 5.0


@dataclass(frozen=True)
class Surfacing:
    """The first fix after a time without, against what was predicted for it.

    Attributes
    ----------
    sensor : str
    time_s : float
        Of the fix [s].
    without_s : float
        Since the fix before, or since the start of the run [s].
    distance_m : float
        Travelled since then [m].
    error_m : float
        Horizontal distance of the fix from its prediction [m].
    sd_m : float
        Predicted rms of that distance [m], the error of the fix included.
    inside : bool
        Whether the fix lies where 95 % of such fixes should (NIS against chi-square).
    used : bool
        False: the gate rejected it.
    chance : float
        Probability of one so far off, by NIS.
    """

    sensor: str
    time_s: float
    without_s: float
    distance_m: float
    error_m: float
    sd_m: float
    inside: bool
    used: bool
    chance: float = math.nan

    @property
    def percent(self) -> float:
        """The error in per cent of the distance travelled; NaN at a standstill."""
        return 100.0 * self.error_m / self.distance_m if self.distance_m > 0.0 else math.nan

    def __str__(self) -> str:
        # of less than it is off, a share says nothing
        share = f", {self.percent:.2f} % of {self.distance_m:.0f} m" if self.percent < 100.0 else ""
        where = "inside the 95 % range" if self.inside else "outside the 95 % range"
        return (
            f"{self.sensor} at {self.time_s:.0f} s, after {self.without_s:.0f} s without: {self.error_m:.2f} m "
            f"off{share}; predicted sd {self.sd_m:.2f} m, {where}{'' if self.used else ', rejected'}"
        )


@dataclass(frozen=True)
class Outage:
    """The longest time without a fix.

    Attributes
    ----------
    begin_s, end_s : float
        [s].
    drift_m : float or None
        Error that the fix at its end found [m]; None where the run ended without one.
    sd_m : float
        Predicted rms of the horizontal position at its end [m].
    """

    begin_s: float
    end_s: float
    drift_m: float | None
    sd_m: float


@dataclass(frozen=True)
class Separation:
    """Horizontal distance between the forward and the smoothed track.

    Attributes
    ----------
    rms_m, most_m : float
    most_s : float
        Time of the largest one [s].
    sd_most_m : float
        Largest predicted rms of the smoothed horizontal position [m].
    predicted_m : float
        Rms that the covariances predict: the difference of an honest pair has the covariance P_forward - P_smoothed.
    """

    rms_m: float
    most_m: float
    most_s: float
    sd_most_m: float
    predicted_m: float


@dataclass(frozen=True)
class Evidence:
    """What a run says of its own quality.

    Attributes
    ----------
    surfacings : tuple of Surfacing
    outage : Outage or None
        None where no time without fixes was long enough to be one.
    sd_end_m, sd_most_m, sd_most_s : float
        Predicted rms of the forward run's horizontal position [m]: at the end, the largest, and when [s].
    separation : Separation or None
        None without a smoothed track.
    """

    surfacings: tuple[Surfacing, ...]
    outage: Outage | None
    sd_end_m: float
    sd_most_m: float
    sd_most_s: float
    separation: Separation | None

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, as it stands in ``summary.json``."""
        plain = dataclasses.asdict(self)
        for entry, found in zip(plain["surfacings"], self.surfacings, strict=True):
            entry["percent"] = found.percent
        return plain

    def lines(self, most: int = 5) -> Iterator[str]:
        """The same in words, one line per fact; of many surfacings the worst `most`, in the order of their times."""
        if self.outage is not None:
            o = self.outage
            drift = "no fix ended it" if o.drift_m is None else f"{o.drift_m:.2f} m of drift found by the next fix"
            length = f"{o.end_s - o.begin_s:.0f} s ({o.begin_s:.0f} to {o.end_s:.0f} s)"
            yield f"longest time without a fix: {length}, {drift}; predicted sd {o.sd_m:.2f} m"
        worst = sorted(self.surfacings, key=lambda s: s.error_m / max(s.sd_m, 1e-9))[-most:]
        yield from (f"surfacing: {found}" for found in sorted(worst, key=lambda s: s.time_s))
        if len(self.surfacings) > most:
            inside = sum(s.inside for s in self.surfacings)
            yield f"surfacings: {len(self.surfacings)} (above the worst {most}), {inside} inside the 95 % range"
        yield (
            f"predicted sd of the horizontal position: {self.sd_end_m:.2f} m at the end, "
            f"{self.sd_most_m:.2f} m at most (at {self.sd_most_s:.0f} s)"
            f"{'' if self.separation is None else f', {self.separation.sd_most_m:.2f} m at most when smoothed'}"
        )
        if self.separation is not None:
            s = self.separation
            yield (
                f"forward and smoothed track differ by {s.rms_m:.2f} m rms (predicted {s.predicted_m:.2f} m), "
                f"{s.most_m:.2f} m at most (at {s.most_s:.0f} s)"
            )


def evidence(track: Track) -> Evidence:
    """Judge a run by itself: by its fixes, its covariance and its smoothed track, without a truth.

    Parameters
    ----------
    track : Track
        Surfacings, outage and predicted sd are those of its forward run.
    """
    run = track.forward or track
    predicted = run.horizontal_sd()
    worst = int(np.argmax(predicted))
    found = surfacings(track)
    return Evidence(
        surfacings=found,
        outage=_longest_outage(track, found),
        sd_end_m=float(predicted[-1]),
        sd_most_m=float(predicted[worst]),
        sd_most_s=float(run.time_s[worst]),
        separation=None if track.forward is None else _separation(track.forward, track),
    )


def surfacings(track: Track) -> tuple[Surfacing, ...]:
    """Every first fix after an outage, in the order of their times.

    Notes
    -----
    Residual and variance are those of the filter before it took the fix. A rejected fix whose successor is used was an
    outlier and no surfacing: the successor is one. Where the successor is rejected too, the state is in doubt.
    """
    run = track.forward or track
    rows = _heard(run)
    travelled = run.travelled()
    found = []
    for name, i, before_s in _after_outages(run, rows):
        r = run.residuals[name]
        now = float(r.time_s[i])
        begin_m, end_m = np.interp([before_s, now], run.time_s, travelled)
        found.append(
            Surfacing(
                sensor=name,
                time_s=now,
                without_s=now - before_s,
                distance_m=float(end_m - begin_m),
                error_m=float(np.hypot(*r.value[i, :2])),
                sd_m=float(np.hypot(*r.sd[i, :2])),
                inside=bool(r.nis[i] <= chi_square_limit(0.95, max(r.dof[i], 1.0))),
                used=bool(r.used[i]),
                chance=float(gammaincc(0.5 * max(r.dof[i], 1.0), 0.5 * r.nis[i])),
            )
        )
    return tuple(found)


def _heard(run: Track) -> list[tuple[float, str, int]]:
    """Time, sensor and row of every fix that says where the vehicle is, of all sensors together."""
    rows = []
    for name, r in run.residuals.items():
        if name not in run.vehicle.sensors or run.vehicle.sensors[name].gives != "position" or not len(r.time_s):
            continue
        judged = np.flatnonzero(
            (r.used | (r.outcome == OUTCOMES.index("rejected"))) & np.isfinite(r.value[:, :2]).all(axis=1)
        )
        used = r.used[judged]
        outlier = ~used & np.append(used[1:], False)
        rows += [(float(r.time_s[i]), name, int(i)) for i in judged[~outlier]]
    return sorted(rows)


def _least_outage_s(rows: list[tuple[float, str, int]]) -> float:
    steps = np.diff([time_s for time_s, _, _ in rows])
    return max(OUTAGE_S, OUTAGE_STEPS * float(np.median(steps)) if steps.size else 0.0)


def _after_outages(run: Track, rows: list[tuple[float, str, int]]) -> Iterator[tuple[str, int, float]]:
    """Sensor and row of the first fix after each outage, and when the outage began."""
    least_s = _least_outage_s(rows)
    before_s = float(run.time_s[0])
    for time_s, name, i in rows:
        if time_s - before_s > least_s:
            yield name, i, before_s
        before_s = time_s


def _longest_outage(track: Track, found: tuple[Surfacing, ...]) -> Outage | None:
    run = track.forward or track
    rows, predicted = _heard(run), run.horizontal_sd()
    begin_s, end_s = (rows[-1][0] if rows else float(run.time_s[0])), float(run.time_s[-1])
    outages = [Outage(s.time_s - s.without_s, s.time_s, s.error_m, s.sd_m) for s in found]
    if end_s - begin_s > _least_outage_s(rows):
        outages.append(Outage(begin_s, end_s, None, float(predicted[-1])))
    return max(outages, key=lambda o: o.end_s - o.begin_s, default=None)


def _separation(forward: Track, smoothed: Track) -> Separation:
    origin = float(forward.latitude[0]), float(forward.longitude[0])
    if not np.array_equal(forward.time_s, smoothed.time_s):  # of lanes, whose rows stand at times of their own
        smoothed = smoothed.at(forward.time_s)
    apart = np.hypot(*(forward.local(*origin) - smoothed.local(*origin))[:, :2].T)
    after = smoothed.horizontal_sd()
    variance = np.maximum(forward.horizontal_sd() ** 2 - after**2, 0.0)
    worst = int(np.argmax(apart))
    return Separation(
        rms_m=float(np.sqrt(np.mean(apart**2))),
        most_m=float(apart[worst]),
        most_s=float(forward.time_s[worst]),
        sd_most_m=float(after.max()),
        predicted_m=float(np.sqrt(np.mean(variance))),
    )


@dataclass(frozen=True)
class Limits:
    """From where on a figure is doubtful, and from where on it is wrong.

    Attributes
    ----------
    rejected : (float, float)
        Share rejected of the readings that the gate judged. That of an honest sensor rejects one in
        ten thousand.
    nis : (float, float)
        Mean NIS of the readings used; an honest one is 1, and beyond 15 the gate rejects.
    modest : float
        Mean NIS below which vehicle.toml believes the sensor ten times worse than it is: a remark.
    lost : float
        Share of readings that are invalid, or come where the drive has no samples.
    speed_m_s, height_m : float
        No vehicle is faster, deeper or higher.
    speed_sd_m_s : (float, float)
        Predicted sd of the horizontal velocity, at the worst.
    rate : (float, float)
        The drive's usual step over its period in vehicle.toml, or the inverse.
    gaps : float
        Share of the run without samples of the drive.
    repaired : float
        Share of the drive's samples that were impossible or out of order.
    chance : float
        Surfacings as bad as these by chance. A fix that is refused, but no less likely than this, is a remark, and so
        is what the filter did because of it: after a dive it refuses one honest fix in a hundred.
    far : float
        A constant so many of its sd from what vehicle.toml says is not what it says.
    untold : float
        Share of its sd that is left of a constant which the mission does not tell.
    least : int
        Readings below which a share says nothing.
    """

    rejected: tuple[float, float] = (0.1, 0.35)
    nis: tuple[float, float] = (2.0, 4.0)
    modest: float = 0.01
    lost: float = 0.5
    speed_m_s: float = 100.0
    height_m: float = 12000.0
    speed_sd_m_s: tuple[float, float] = (3.0, 10.0)
    rate: tuple[float, float] = (3.0, 30.0)
    gaps: float = 0.05
    repaired: float = 0.05
    chance: float = 1e-3
    far: float = 2.5
    untold: float = 0.8
    least: int = 5


LIMITS = Limits()
#: Share of honest fixes after a dive that are refused [1].
REFUSED = 0.01
#: Faults of a drive's axes that no unit has for a moment: the description of its file is wrong.
DESCRIBED_WRONGLY = frozenset({"wrong-unit", "gravity", "swapped"})
#: An axis that is the worst of so many of the rejected readings is named [1].
MOSTLY = 0.8
#: So often axes are contradicted where all six were left out three times [1]: a bias that has shifted is learnt after
#: the first, what fails again and again is broken, or its signs and axes are.
CONTRADICTED = 18
#: Beyond this share of a run a sensor whose changes alone are used is wrong, not disturbed [1].
LONG_JUMPED = 0.1
_CHECK = "Run 'navfilter check MISSION --vehicle VEHICLE': it looks for wrong units, signs, axes and clocks."


def doubts(run: Track, mission: Mission, evidence: Evidence, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Everything that speaks against a forward run, and remarks.

    Parameters
    ----------
    run : Track
    mission : Mission
        As it was replayed.
    evidence : Evidence
        Of the run.
    limits : Limits
    """
    if run.vehicle.lanes():
        yield from _lanes(run)
        unit = last_unit(run.vehicle, run.lanes)
        vehicle, mission = of_one_unit(run.vehicle, mission, unit)
        for finding in doubts(replace(run, vehicle=vehicle), mission, evidence, limits):
            yield replace(finding, stream=unit) if finding.stream == "imu" else finding
        return
    told = list(left_out_doubts(run, mission))  # first: the others say what comes of it
    yield from told
    yield from _state(run, limits)
    yield from _drive(run, mission, limits)
    for name, sensor in run.vehicle.sensors.items():
        if not sensor.from_drive:
            yield from _sensor(name, run, mission, limits, bool(told), _unlucky(evidence, limits))
    yield from north_findings(mission, run.vehicle)
    yield from _surfaced(evidence, limits)
    yield from constant_doubts(run, limits.far, limits.untold)
    yield from _mended(run, len(_unlucky(evidence, limits)))
    yield from correlation_doubts(run, mission)
    yield from _given_up(run)
    yield from _described_wrongly(run)


# --- the track itself -----------------------------------------------------------------------------------------------


def _state(run: Track, limits: Limits) -> Iterator[Finding]:
    """What no vehicle does, and what nobody knows."""
    speed = np.hypot(run.velocity_n[:, 0], run.velocity_n[:, 1])
    if not (np.isfinite(speed).all() and np.isfinite(run.latitude).all() and np.isfinite(run.covariance).all()):
        text = "the track holds values that are not finite: the filter has diverged."
        yield Finding("error", "diverged", "", text, _CHECK)
        return
    cure = "Is what drives in the right unit (deg/s for rad/s, g, mm/s)? Does anything bound the velocity?"
    worst = int(np.argmax(speed))
    if speed[worst] > limits.speed_m_s:
        at = f"{speed[worst]:.0f} m/s at {run.time_s[worst]:.0f} s"
        text = f"a speed of {at}, {run.distance_m:.0f} m travelled: impossible."
        yield Finding("error", "impossible", "", text, cure)
    deepest = float(run.height[int(np.argmax(np.abs(run.height)))])
    if abs(deepest) > limits.height_m:
        yield Finding("error", "impossible", "", f"a height of {deepest:.0f} m: impossible.", cure)
    sd = np.sqrt(np.maximum(run.covariance[:, 3, 3] + run.covariance[:, 4, 4], 0.0))
    # the start may well be unknown: what counts is what the sensors make of it
    later = run.time_s > run.time_s[0] + min(60.0, 0.5 * float(run.time_s[-1] - run.time_s[0]))
    worst = int(np.argmax(np.where(later, sd, 0.0)))
    if later.any() and sd[worst] > limits.speed_sd_m_s[0]:
        known = f"the velocity is known to {sd[worst]:.1f} m/s only (predicted sd)"
        text = f"at {run.time_s[worst]:.0f} s {known}: nothing bounded it there."
        cure = "See in report.html which sensor was silent or rejected then; a velocity (DVL) or fixes bound it."
        yield Finding(_grade(sd[worst], limits.speed_sd_m_s), "unbounded", "", text, cure)


def _drive(run: Track, mission: Mission, limits: Limits) -> Iterator[Finding]:
    """Samples that are missing, impossible, out of order, or come at another rate."""
    name, period_s = run.vehicle.drive.streams[-1], run.vehicle.drive.period_s
    time_s = mission.streams[name].time_s
    usual = float(np.median(np.diff(time_s))) if len(time_s) > 1 else period_s
    factor = max(usual, 1e-9) / period_s
    if max(factor, 1.0 / factor) > limits.rate[0]:
        text = f"its samples come every {usual:.4g} s, vehicle.toml says every {period_s:.4g} s."
        cure = "Milliseconds read as seconds (time.unit in mission.toml), or another rate_hz?"
        yield Finding(_grade(max(factor, 1.0 / factor), limits.rate), "rate", name, text, cure)
    heard = time_s[(time_s >= run.time_s[0]) & (time_s <= run.time_s[-1])]
    step, length = np.diff(heard), float(run.time_s[-1] - run.time_s[0])
    missing = float(step[step > max(1.0, 10.0 * period_s, 3.0 * usual)].sum())
    if missing > limits.gaps * length:
        text = f"{missing:.0f} of {length:.0f} s have no samples: the state was carried across by what it was before."
        cure = "Was the log cut, or are stamps lost? 'navfilter check MISSION' lists the gaps."
        yield Finding("warning", "gap", name, text, cure)
    odd = run.counts.get("bad-sample", 0) + run.counts.get("backward", 0)
    if odd > limits.repaired * len(time_s):
        text = f"{odd} of {len(time_s)} samples are impossible or go back in time."
        yield Finding("warning", "samples", name, text, "Check unit, sentinels (invalid = ...) and the time column.")


def _lanes(run: Track) -> Iterator[Finding]:
    """Which lanes were left, and when."""
    reasons = ("",) * len(run.lanes) if run.lane_history is None else run.lane_history.reasons
    for (_, left), (time_s, taken), why in zip(run.lanes, run.lanes[1:], reasons, strict=False):
        yield Finding("info", "lane", left, f"its lane was left for {taken} at {time_s:.1f} s: {why}.", "")
    if run.lanes[-1][1] == DEAD_RECKONING:
        text = f"no inertial unit is in force since {run.lanes[-1][0]:.1f} s: compass and velocity carry the state."
        cure = "See in report.html, at the lanes, what the units read then."
        yield Finding("warning", "lane", "", text, cure)


def _mended(run: Track, unlucky: int) -> Iterator[Finding]:
    """What contradicted everything else, and was left out or set anew for that; so often for fixes that may be."""
    where = "See in report.html, at the innovations, when and against which sensor; is the start right?"
    if count := run.counts.get("reset", 0):
        text = f"{counted(count, 'times')} readings that agree with each other set the state anew: it had been wrong."
        yield Finding("warning" if count > unlucky else "info", "reset", "", text, where)
    name = run.vehicle.drive.streams[-1]
    found = {fault: run.counts[fault] for fault in COUNTED if run.counts.get(fault, 0)}
    if count := found.pop("noisy", 0):
        text = f"{counted(count, 'times')} an axis was noisier than vehicle.toml says: believed less meanwhile."
        yield Finding("info", "noisy", name, text)
    found.pop("spike", 0)
    if found.pop("silent", 0):
        text = "it said nothing for a while, or nothing that can be: compass and DVL carried the state as far as heard."
        yield Finding("warning", "silent", name, text, "Was the log cut, or did the unit or its driver fail?")
    if count := run.counts.get("realigned", 0):
        text = (
            f"{counted(count, 'times')} the attitude was set anew: by accelerometers and DVL, or the start's was wrong."
        )
        yield Finding("info", "realigned", name, text, where)
    if count := run.counts.get("shifted", 0):
        text = f"{counted(count, 'times')} the bias of a gyro shifted by more than its error model allows: learnt anew."
        cure = "If it goes on, give its RandomWalk a larger density in vehicle.toml."
        yield Finding("info", "shifted", name, text, cure)
    if found:
        text = "axes were found " + ", ".join(f"{fault} ({counted(n, 'times')})" for fault, n in found.items())
        again = found.get("contradicted", 0) >= CONTRADICTED
        grade: Severity = "error" if again or found.keys() & DESCRIBED_WRONGLY else "warning"
        cure = "Check axes, units and signs in mission.toml; where these are right, the unit is broken."
        yield Finding(grade, "left-out", name, f"{text}, and left out.", cure)


def _given_up(run: Track) -> Iterator[Finding]:
    if count := run.counts.get("opened", 0):
        text = f"all sensors contradicted the state {count} times, so that it was given up and established anew."
        cure = "See in report.html, at the innovations, when, and which sensor was first."
        yield Finding("error", "opened", "", text, cure)


def _described_wrongly(run: Track) -> Iterator[Finding]:
    """Lever arm, clock and mounting of velocities that were found to be wrong, as they stand at the end."""
    for name, history in run.error_models.items():
        sensor = run.vehicle.sensors.get(name)
        if sensor is None:
            continue
        models = per_axis(history[-1][1], sensor.axes, name)
        found = descriptions(models, 1.0 / sensor.rate_hz)
        axis = "_".join(part for part in (name, sensor.axis_names[0]) if part)
        at = {component: run.state_names.index(f"{axis}[{place}]") for place, component in found}
        parts = []
        for what, unit, factor, components in _DESCRIPTION:
            # one that has jumped may have been turned then
            if components[0] in at and not (components == (6,) and has_offset(models)):
                values = factor * run.states[-1, [at[component] for component in components]]
                parts.append(f"{what} about {', '.join(f'{value:.2f}' for value in values)} {unit}")
        if parts:
            text = f"it agrees with the others only if it is described wrongly: {'; '.join(parts)}."
            cure = f"Measure it, and correct [sensors.{name}] in vehicle.toml; or say there how far it is known, as by"
            cure += " lever_arm_sd_m, time_offset_sd_s, misalignment_sd_deg."
            yield Finding("warning", "arm-or-clock", name, text, cure)


#: What of a description was found to be wrong: words, unit, and components of `navfilter.models.fault_bias`.
_DESCRIPTION = (
    ("its place differs from lever_arm_b_m by", "m", 1.0, (0, 1, 2)),
    ("its stamps are late by", "s", 1.0, (3,)),
    ("it is turned in roll and pitch by", "deg", math.degrees(1.0), (4, 5)),
    ("it is turned in heading by", "deg", math.degrees(1.0), (6,)),
)


# --- sensors --------------------------------------------------------------------------------------------------------


def _sensor(
    name: str, run: Track, mission: Mission, limits: Limits, explained: bool, unlucky: Sequence[float]
) -> Iterator[Finding]:
    """What became of the readings of one sensor; with what is left out, and has been said, none scatters too much."""
    clock = _clock(name, run, mission, limits)
    if clock is not None:
        yield clock
        return
    r = run.residuals.get(name)
    if r is None or not len(r.time_s):
        cure = "Does its stream hold readings after the start?"
        yield Finding("warning", "unheard", name, "not one reading was heard during the run.", cure)
        return
    if not r.count("used"):
        what = ", ".join(f"{r.count(outcome)} {outcome}" for outcome in OUTCOMES if r.count(outcome))
        yield Finding("error", "unused", name, f"not one of its {len(r.time_s)} readings was used ({what}).", _CHECK)
        return
    yield from _jumped(name, run, unlucky)
    yield from _lost(name, r, limits)
    yield from _refused(name, run, r, limits)
    yield from _honesty(name, run, r, limits, explained)


def _jumped(name: str, run: Track, unlucky: Sequence[float]) -> Iterator[Finding]:
    """A sensor that was off by a constant from one reading to the next; a remark where fixes that may be made it so."""
    history = run.error_models.get(name, [])
    ends = [*(time_s for time_s, _ in history[1:]), float(run.time_s[-1])]
    whole = [(begin, end) for (begin, models), end in zip(history, ends, strict=True) if has_offset(models)]
    spans = [end - begin for begin, end in whole]
    timeout_s = max((s.gate_timeout_s for s in run.vehicle.sensors.values() if s.gives == "position"), default=0.0)
    if spans:
        by_fixes = all(any(0.0 <= begin - at <= timeout_s for at in unlucky) for begin, _ in whole)
        share = sum(spans) / max(float(run.time_s[-1] - run.time_s[0]), 1e-9)
        text = f"jumped by a constant {len(spans)} times; for {sum(spans):.0f} s only its changes were used."
        cure = f"Is it fixed to the vehicle, and its mounting right? Replay with --without {name}."
        yield Finding("error" if share > LONG_JUMPED else "info" if by_fixes else "warning", "jumped", name, text, cure)


def _refused(name: str, run: Track, r: Residuals, limits: Limits) -> Iterator[Finding]:
    """Many readings that the gate rejected, or many on end."""
    share = r.count("rejected") / (r.count("used") + r.count("rejected"))
    longest, timeout_s = _longest_rejection(r), run.vehicle.sensors[name].gate_timeout_s
    widened = ""
    if longest > timeout_s:
        widened = f" Rejected for {longest:.0f} s on end, its gate was widened until it was let in."
    if r.count("rejected") >= limits.least and share > limits.rejected[0]:
        much = f"{100 * share:.0f} % of its readings were rejected{_typically(r, run.vehicle.sensors[name].axis_names)}"
        text = f"{much}: they contradict the others, or vehicle.toml.{widened}"
        yield Finding(_grade(share, limits.rejected), "rejected", name, text, _CHECK)
    elif widened:
        cure = f"Replay with --without {name} and see whether the others then agree."
        yield Finding("warning", "widened", name, widened.strip(), cure)
    yield from _left_out_alone(name, run, r, limits)


def _left_out_alone(name: str, run: Track, r: Residuals, limits: Limits) -> Iterator[Finding]:
    """A component of many readings that contradicted the others, and was left out without them."""
    used = r.used
    if np.count_nonzero(used) < limits.least:
        return
    alone = np.isfinite(r.value[used]) & ~np.isfinite(r.sd[used])
    for axis, share in enumerate(alone.mean(axis=0).tolist()):
        if share > limits.rejected[0]:
            sensor = run.vehicle.sensors[name]
            unit, factor = shown_unit(sensor.units[axis])
            off = factor * abs(float(np.median(r.value[used][alone[:, axis], axis])))
            text = f"{sensor.axis_names[axis]} was left out of {100 * share:.0f} % of the readings used,"
            yield Finding("warning", "component", name, f"{text} typically {off:.3g} {unit} off.", _CHECK)


def _honesty(name: str, run: Track, r: Residuals, limits: Limits, explained: bool) -> Iterator[Finding]:
    """Readings that scatter otherwise than vehicle.toml believes."""
    if r.count("used") < limits.least:
        return
    nis = float(np.mean(r.nis[r.used] / np.maximum(r.dof[r.used], 1.0)))
    learn = ' error = {model = "learned-arma"}, or' if run.vehicle.sensors[name].open_loop else ""
    cure = f"In vehicle.toml, give {name}{learn} another sd."
    if nis > limits.nis[0]:
        believed = f"the filter believes it {math.sqrt(nis):.1f} times too well"
        why = "not with that which is left out" if explained else believed
        text = f"its mean NIS is {nis:.1f} where 1 is honest: {why}."
        cure = "Describe first what is left out." if explained else cure
        yield Finding(_grade(nis, limits.nis), "nis", name, text, cure)
    elif nis < limits.modest:
        times = 1.0 / math.sqrt(max(nis, 1e-12))
        text = (
            f"its mean NIS is {nis:.1g} where 1 is honest: vehicle.toml believes it {times:.0f} times worse than it is."
        )
        yield Finding("info", "nis", name, text, cure)


def _clock(name: str, run: Track, mission: Mission, limits: Limits) -> Finding | None:
    """Readings that lie beside the drive's in time."""
    if name not in mission.streams or not len(mission.streams[name]):
        return None
    t, drive = mission.streams[name].time_s, mission.streams[run.vehicle.drive.streams[-1]].time_s
    beside = float(np.mean((t < drive[0] - 1.0) | (t > drive[-1] + 1.0)))
    if beside <= limits.lost:
        return None
    spans = f"{t[0]:.1f} to {t[-1]:.1f} s, what drives from {drive[0]:.1f} to {drive[-1]:.1f} s"
    if beside == 1.0:
        cure = "Another time zone, epoch or unit? Set time.offset_s or time.unit of one of them in mission.toml."
        return Finding("error", "clock", name, f"the clocks do not overlap: its readings lie from {spans}.", cure)
    text = f"{100 * beside:.0f} % of its readings lie beside the run: {spans}."
    cure = "If it was not switched on alone, its clock is off: see time.offset_s in mission.toml."
    return Finding("warning", "span", name, text, cure)


def _lost(name: str, r: Residuals, limits: Limits) -> Iterator[Finding]:
    """Readings that never came to the gate."""
    causes = {
        "invalid": "are invalid (out of range, no lock, or missing): for all that time the sensor did not help.",
        "ahead": "came where what drives had no samples for too long.",
        "too-late": "came too late to be taken.",
        "duplicate": "repeat the stamp of the one before.",
    }
    for outcome, text in causes.items():
        if r.count(outcome) > limits.lost * len(r.time_s):
            cure = f"'navfilter check MISSION' shows the gaps, repeats and sentinels of {name}."
            yield Finding("warning", "lost", name, f"{r.count(outcome)} of {len(r.time_s)} readings {text}", cure)


def _typically(r: Residuals, axes: Sequence[str]) -> str:
    """How far off the rejected readings were on their worst axis, and which that mostly is, if there is one."""
    off = np.abs(r.value / r.sd)[r.outcome == OUTCOMES.index("rejected")]
    if not len(off):
        return ""
    off = np.where(np.isfinite(off), off, 0.0)
    worst = int(np.argmax(np.bincount(off.argmax(axis=1), minlength=off.shape[1])))
    alone = off.shape[1] > 1 and np.mean(off.argmax(axis=1) == worst) > MOSTLY
    return f", typically {np.median(off.max(axis=1)):.0f} predicted sd off{f' {axes[worst]}' if alone else ''}"


def _longest_rejection(r: Residuals) -> float:
    """Longest time in which every reading was rejected [s]."""
    judged = r.used | (r.outcome == OUTCOMES.index("rejected"))
    t, used = r.time_s[judged], r.used[judged]
    ends = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(int)))
    return max((float(t[b - 1] - t[a]) for a, b in zip(ends[::2], ends[1::2], strict=True)), default=0.0)


# --- surfacings -----------------------------------------------------------------------------------------------------


def _unlucky(evidence: Evidence, limits: Limits) -> list[float]:
    """Times of fixes after a dive that were refused, but are not too far off to be [s]; none where these are many."""
    found = [s.time_s for s in evidence.surfacings if not s.used and s.chance > limits.chance]
    many = found and bdtrc(len(found) - 1, len(evidence.surfacings), REFUSED) < limits.chance
    return [] if many else found


def _surfaced(evidence: Evidence, limits: Limits) -> Iterator[Finding]:
    """Fixes that come back where they should not be."""
    found = evidence.surfacings
    refused = [s for s in found if not s.used]
    outside = sum(not s.inside for s in found)
    cure = "The drift is larger than predicted: is the heading or the DVL worse than vehicle.toml says, or misaligned?"
    if refused:
        worst = max(refused, key=lambda s: s.error_m / max(s.sd_m, 1e-9))
        text = (
            f"the first fix after {worst.without_s:.0f} s without was rejected, {worst.error_m:.1f} m off "
            f"where {worst.sd_m:.1f} m were predicted ({len(refused)} of {len(found)} surfacings)."
        )
        grave = len(refused) > len(_unlucky(evidence, limits))
        yield Finding("warning" if grave else "info", "surfacing", worst.sensor, text, cure if grave else "")
    elif outside and bdtrc(outside - 1, len(found), 0.05) < limits.chance:
        text = f"{outside} of {len(found)} surfacings lie outside the range that should hold 95 % of them."
        yield Finding("warning", "surfacing", "", text, cure)


def _grade(value: float, limits: tuple[float, float]) -> Severity:
    return "error" if value > limits[1] else "warning"

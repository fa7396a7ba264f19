"""`learn`: how the sensors of a vehicle err, from the fixes that come after the gaps of several dives."""

import math
import os
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second

from navfilter.foundation.arguments import needs
from navfilter.foundation.arrays import Array
from navfilter.foundation.display import Shown
from navfilter.io import read_mission
from navfilter.models.error_models import ErrorModel, per_axis
from navfilter.models.learned_arma import as_described, learned_part, parts_of, scaled
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track

#: Candidates that are run: so many times the quick and the slow errors that are described, in steps of one standard
#: deviation of the prior. Files ten times too good are common, such as ten times too bad rare.
QUICK: Array = 2.0 ** np.arange(-3.0, 7.0)
SLOW: Array = 2.0 ** np.arange(-3.0, 4.0)
#: Between two of them the likelihood is interpolated in so many steps: several dives know it better than one step.
FINER = 4
#: Of ln of such a factor, before any dive [1]; its median is such that the mean of its square is 1: a data sheet states
#: the whole of an error (`navfilter.learning.slow_prior`).
SPREAD = math.log(2.0)
MEDIAN = -(SPREAD**2)
#: Fixes farther apart than this have a gap between them that tells of the sensors [s] (by choice).
LEAST_GAP_S = 30.0
#: Where gaps are made, fixes are given for so long between them [s].
GIVEN_S = 10.0
#: A fix in a hundred may be anywhere within a kilometre: none of them decides alone (by choice).
STRAY, REACH_M = 0.01, 1000.0
#: Rows of a track: what a covariance gains within a second is nothing beside what it gained in a gap [Hz].
ROWS_HZ = 1.0
#: In place of a sensor's name: all of them, larger by the same factors, for a file may be too good throughout.
TOGETHER = ""


class Known(NamedTuple):
    """How far the description of a sensor is known.

    Attributes
    ----------
    quick, slow : float
        Its quick and slow errors over those that were described: root of the posterior mean of the square. 1 for what
        it has none of.
    quick_within, slow_within : float
        Factors within which they are known, one standard deviation of the logarithm; 2 before any dive.
    """

    quick: float
    quick_within: float
    slow: float
    slow_within: float


@dataclass(frozen=True, eq=False)
class Dive:
    """What one dive says.

    Attributes
    ----------
    name, digest : str
        Of the mission, and of its fixes: the same dive is not counted twice.
    gaps : int
        Fixes after gaps.
    longest_s : float
        The longest gap [s].
    missed_m, believed_m : float
        By how far the vehicle as described misses those fixes, and by how far it believes it does, rms [m].
    nees : float
        Mean of the squared misses over what is believed of them, per axis; 1 is honest.
    evidence : dict of str to ndarray, shape (quick, slow)
        By sensor: ln of the likelihood of those fixes with its errors larger by `QUICK` and `SLOW`, over that of the
        vehicle as described.
    """

    name: str
    digest: str
    gaps: int
    longest_s: float
    missed_m: float
    believed_m: float
    nees: float
    evidence: Mapping[str, Array]

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.gaps} fix{'es' * (self.gaps > 1)} after gaps of up to {self.longest_s:.0f} s, missed "
            f"by {self.missed_m:.2f} m (believed {self.believed_m:.2f} m, NEES {self.nees:.1f})"
        )


@dataclass(frozen=True, repr=False, eq=False)
class OverDives(Shown):
    """Result of `learn`.

    Attributes
    ----------
    vehicle : Vehicle
        With the errors of its sensors as they are believed after all dives.
    described : Vehicle
        As it was before the first of them.
    known : dict of str to Known
        How far, by sensor.
    evidence : dict of str to ndarray
        As of a `Dive`, of all of them.
    dives : tuple of Dive
        Those of this call.
    counted : tuple of (str, str)
        Names and digests of all, earlier ones too.
    """

    vehicle: Vehicle
    described: Vehicle
    known: Mapping[str, Known]
    evidence: Mapping[str, Array]
    dives: tuple[Dive, ...]
    counted: tuple[tuple[str, str], ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {name: known_words(one) for name, one in self.known.items()}
        return f"What {len(self.counted)} dives say of {self.vehicle.name}: {self.gain:+.1f} nats", rows

    @property
    def gain(self) -> float:
        """By how much likelier all fixes after gaps are than by the vehicle as it was described: ln of the ratio of
        their probabilities, each as the dives before it foretold it [nat].
        """
        return evidence_of(self.evidence)

    @property
    def tells(self) -> bool:
        """Whether the dives have moved anything by more than a twentieth, or made it known better by as much."""
        return any(
            abs(math.log(moved)) > MOVED or within < math.exp((1.0 - MOVED) * SPREAD)
            for one in self.known.values()
            for moved, within in ((one.quick, one.quick_within), (one.slow, one.slow_within))
            if within > 1.0
        )


#: What counts as moved, of ln of a factor, and as better known, of its standard deviation [1] (by choice).
MOVED = 0.05


def known_words(one: Known) -> str:
    """As a line says it."""
    pairs = (("quick", one.quick, one.quick_within), ("slow", one.slow, one.slow_within))
    return ", ".join(f"{what} x {f:.2f} (within {within:.2f})" for what, f, within in pairs if within > 1.0)


def learn(
    missions: Iterable[Mission | str | os.PathLike[str]] | Mission,
    vehicle: Vehicle,
    *,
    sensors: Sequence[str] | None = None,
    gap_s: float | None = None,
    before: OverDives | None = None,
    report: Callable[[str], None] | None = None,
) -> OverDives:
    """Learn from dives how the sensors of a vehicle err, for the next one.

    Parameters
    ----------
    missions : iterable of Mission or path-like
        Dives with fixes after gaps; one at the end suffices.
    vehicle : Vehicle
        As described: what it says of its sensors is the prior.
    sensors : sequence of str, optional
        Which ones; "attitude", "velocity", "gyro" and "accel" are those of the drive. Default: the headings and
        velocities.
    gap_s : float, optional
        Withhold fixes for so long at a time [s], where they hardly ever fail. Infinite: all between the first and the
        last ones.
    before : OverDives, optional
        What earlier dives said: they count, too, and `vehicle` is then what came of them.
    report : callable, optional
        Told what each dive says.

    Returns
    -------
    OverDives

    Raises
    ------
    ValueError
        For a dive without a fix after a gap, one that was counted already, an unknown sensor, one with nothing that
        could be scaled, or that has a learnt model in force, and as `navfilter.replay`.

    Notes
    -----
    Candidates have the quick errors of a sensor larger by `QUICK`, the slow ones by `SLOW`, or those of all sensors at
    once. Each is replayed, and nothing is learnt on the way. The score is the likelihood of the fixes after gaps,
    ``N(fix; predicted, P + R)``; it adds up over dives. What is handed out has the mean variances of the posterior
    (and with them its mean spectrum), not those of its peak, so that few dives change little. That one sensor alone is
    described wrongly, or all by the same factor, is as likely beforehand for each.
    """
    needs("learn: vehicle", vehicle, Vehicle, hint="It is learn(missions, vehicle).")
    given = [missions] if isinstance(missions, Mission | str | os.PathLike) else list(missions)
    read = [one if isinstance(one, Mission) else read_mission(one) for one in given]
    for mission in read:
        needs("learn: missions", mission, Mission)
    if not read:
        raise ValueError("learn needs at least one dive.")
    base = vehicle if before is None else before.described
    names = _chosen(base, sensors, before)
    counted = [] if before is None else list(before.counted)
    said = [] if before is None else [before.evidence]
    runs = []
    for mission in read:  # what is wrong with a dive shall not cost the others' replays
        runs.append(_looked_at(_frozen(base), mission, gap_s, counted))
        counted.append((mission.name, runs[-1].digest))
    dives: list[Dive] = []
    for run in runs:
        dives.append(_dive(run, names))
        said.append(dives[-1].evidence)
        if report is not None:
            known, _ = pooled(base, names, said)
            report(f"{dives[-1]} -> {'; '.join(f'{name} {known_words(one)}' for name, one in known.items())}")
    known, learnt = pooled(base, names, said)
    return OverDives(learnt, base, known, summed(said), tuple(dives), tuple(counted))


# --- the posterior --------------------------------------------------------------------------------------------------


class Weighed(NamedTuple):
    """Candidates and their weights, on finer steps than were run.

    Attributes
    ----------
    quick, slow : ndarray
        Factors of its rows and columns; one alone where there is nothing to choose.
    weight : ndarray, shape (quick, slow)
    """

    quick: Array
    slow: Array
    weight: Array


def posterior(evidence: Mapping[str, Array]) -> dict[str, Weighed]:
    """Weights of all candidates, by sensor, whose sum is one."""
    grids = {name: _finer(grid) for name, grid in evidence.items()}
    top = max(float(score.max()) for *_, score in grids.values())
    total = sum(float(np.exp(score - top).sum()) for *_, score in grids.values())
    return {name: Weighed(q, s, np.exp(score - top) / total) for name, (q, s, score) in grids.items()}


def evidence_of(evidence: Mapping[str, Array]) -> float:
    """ln of the mean likelihood over the prior."""
    scores = np.concatenate([np.ravel(_finer(grid)[2]) for grid in evidence.values()])
    return float(np.logaddexp.reduce(scores)) - math.log(len(evidence))


def _finer(grid: Array) -> tuple[Array, Array, Array]:
    """Factors of rows and columns, and ln of prior times likelihood; an axis of one is no choice."""
    factors: list[Array] = []
    score = np.asarray(grid, dtype=np.float64)
    for axis, coarse in enumerate((QUICK, SLOW)):
        if score.shape[axis] == 1:
            factors.append(np.ones(1))
            continue
        log = np.log(coarse)
        at = np.linspace(log[0], log[-1], FINER * (len(log) - 1) + 1)
        score = np.asarray(scipy.interpolate.PchipInterpolator(log, score, axis=axis)(at))
        factors.append(np.exp(at))
    rows, columns = (ln_prior(f) if len(f) > 1 else np.zeros(1) for f in factors)
    return factors[0], factors[1], score + rows[:, None] + columns[None, :]


def ln_prior(factors: Array) -> Array:
    """ln of the prior of each factor; their sum is one."""
    score = -0.5 * ((np.log(factors) - MEDIAN) / SPREAD) ** 2
    return np.asarray(score - np.logaddexp.reduce(score), dtype=np.float64)


def summed(said: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """The evidence of several dives."""
    return {name: np.sum([one[name] for one in said], axis=0) for name in said[0]}


def pooled(
    vehicle: Vehicle, names: Sequence[str], said: Sequence[Mapping[str, Array]]
) -> tuple[dict[str, Known], Vehicle]:
    """How far the sensors are known after dives, and the vehicle with them.

    Parameters
    ----------
    vehicle : Vehicle
        As described.
    names : sequence of str
        Of the sensors.
    said : sequence of dict
        Evidence of each dive; of none the vehicle stays.
    """
    known: dict[str, Known] = {}
    if not said:
        return known, vehicle
    weights = posterior(summed(said))
    for name in names:
        numbers = [number for axis in (0, 1) for number in _factor(weights, name, axis)]
        known[name] = Known(*numbers)
        vehicle = with_factors(vehicle, name, known[name].quick, known[name].slow)
    return known, vehicle


def _factor(weights: Mapping[str, Weighed], name: str, axis: int) -> tuple[float, float]:
    """A factor of a sensor, and within which it is known."""
    own = {of: weights[of] for of in (name, TOGETHER) if of in weights}
    if own[name].weight.shape[axis] == 1:
        return 1.0, 1.0
    factors = own[name][axis]
    mass = np.sum([one.weight.sum(axis=1 - axis) for one in own.values()], axis=0)
    rest, log = 1.0 - float(mass.sum()), np.log(factors) - MEDIAN
    # the mean of the square is 1 beforehand, also on the candidates that there are
    square = rest + float(mass @ factors**2) / float(np.exp(ln_prior(factors)) @ factors**2)
    variance = float(mass @ log**2) - float(mass @ log) ** 2 + rest * SPREAD**2
    return math.sqrt(square), math.exp(math.sqrt(max(variance, 0.0)))


# --- sensors --------------------------------------------------------------------------------------------------------


def _chosen(vehicle: Vehicle, sensors: Sequence[str] | None, before: OverDives | None) -> tuple[str, ...]:
    """Names of the sensors to learn of; refuses those of which nothing can be learnt."""
    have = _learnable(vehicle)
    if sensors is not None:
        sensors = (sensors,) if isinstance(sensors, str) else tuple(sensors)
    if before is not None:
        names = tuple(before.known)
        if sensors is not None and set(sensors) != set(names):
            raise ValueError(
                f"the earlier dives were about {', '.join(names)}, found {', '.join(sensors)}: their evidence is of "
                "all of them together. Name the same ones or none, or begin anew with the vehicle as it was."
            )
        return names
    names = tuple(have) if sensors is None else sensors
    for name in names:
        if name not in (*vehicle.sensors, *_DRIVEN) or (name in _DRIVEN and not hasattr(vehicle.drive, name)):
            raise ValueError(
                f'"{name}" is no sensor of this vehicle; there are: {", ".join((*vehicle.sensors, *_driven(vehicle)))}.'
            )
        models, period_s = models_of(vehicle, name)
        if any((part := learned_part(model)) is not None and part.model is not None for model in models):
            raise ValueError(
                f'"{name}" has a model in force that one dive has taught: what several teach is about a description. '
                "Take `adopted` and `slow` out of its table, or leave the sensor out."
            )
        if name in vehicle.sensors and vehicle.sensors[name].gives == "position":
            raise ValueError(f'"{name}" gives the fixes that all others are judged by: leave it out.')
        if not any(p.slow or p.quick for p in (parts_of(model, period_s) for model in as_described(models))):
            raise ValueError(f'"{name}" has no error that could be larger or smaller: describe one, or leave it out.')
    if not names:
        raise ValueError(
            "this vehicle has neither a heading nor a velocity to learn of: name sensors, such as gyro or accel."
        )
    return names


#: Parts of a drive that have error models, and those of them that are learnt of unasked.
_DRIVEN, _UNASKED = ("attitude", "velocity", "gyro", "accel"), ("attitude", "velocity")


def _driven(vehicle: Vehicle) -> list[str]:
    return [name for name in _DRIVEN if hasattr(vehicle.drive, name)]


def _learnable(vehicle: Vehicle) -> list[str]:
    found = [
        name
        for name, sensor in vehicle.sensors.items()
        if sensor.observes.corrects in ("heading", "velocity") and not sensor.from_drive
    ]
    return [*(name for name in _driven(vehicle) if name in _UNASKED), *found]


def models_of(vehicle: Vehicle, name: str) -> tuple[tuple[ErrorModel, ...], float]:
    """Error models of a sensor, or of a part of the drive, by axis, and its period [s]."""
    if name in vehicle.sensors:
        return vehicle.sensors[name].models, 1.0 / vehicle.sensors[name].rate_hz
    part: Any = getattr(vehicle.drive, name)
    models = part.models if hasattr(part, "models") else per_axis(part, 3, name)
    return models, vehicle.drive.period_s


def with_factors(vehicle: Vehicle, name: str, quick: float, slow: float) -> Vehicle:
    """The vehicle with the errors of one sensor larger by factors."""
    models, period_s = models_of(vehicle, name)
    return with_models(vehicle, name, tuple(scaled(model, period_s, quick, slow) for model in models))


def with_models(vehicle: Vehicle, name: str, models: tuple[ErrorModel, ...]) -> Vehicle:
    """The vehicle with other error models of one sensor: one for all axes where they are the same."""
    return vehicle.with_error(**{name: models[0] if len(set(models)) == 1 else models})


# --- one dive -------------------------------------------------------------------------------------------------------


class _Fix(NamedTuple):
    """A fix after a gap: of which sensor, when [s], the gap [s], and the variance of its own error (2,) [m^2]."""

    sensor: str
    time_s: float
    gap_s: float
    variance: Array


class _Run(NamedTuple):
    """A dive, the vehicle as described in which nothing is learnt, its track, and the fixes after gaps."""

    vehicle: Vehicle
    mission: Mission
    track: Track
    fixes: list[_Fix]
    digest: str


def _looked_at(vehicle: Vehicle, mission: Mission, gap_s: float | None, counted: Sequence[tuple[str, str]]) -> _Run:
    """Run a dive as described; refuses one that tells nothing, or nothing new."""
    giving = [name for name, sensor in vehicle.sensors.items() if sensor.gives == "position" and not sensor.from_drive]
    if not giving:
        raise ValueError("this vehicle has no sensor that gives fixes: add a position to its description.")
    for name in giving:
        _ = mission.stream(name)  # of another vehicle: says so
    if gap_s is not None:
        mission = with_gaps(mission, giving, gap_s)
    track = replay(vehicle, mission, output_rate_hz=ROWS_HZ)
    fixes = _after_gaps(track, giving)
    if not fixes:
        raise ValueError(_no_gap(mission, track, giving))
    digest = _digest(vehicle, mission)
    if same := [name for name, other in counted if other == digest]:
        raise ValueError(
            f'mission "{mission.name}" holds the same readings as "{same[0]}", which was counted already: given twice, '
            "it would be believed twice. Leave it out."
        )
    return _Run(vehicle, mission, track, fixes, digest)


def _dive(run: _Run, names: Sequence[str]) -> Dive:
    """What one dive says of the sensors."""
    missed, S = _misses(run.track, run.fixes)
    whole = _score(missed, S)
    evidence = {name: _grid(run, (name,)) - whole for name in names}
    if len(names) > 1:
        evidence[TOGETHER] = _grid(run, names) - whole
    return Dive(
        name=run.mission.name,
        digest=run.digest,
        gaps=len(run.fixes),
        longest_s=max(fix.gap_s for fix in run.fixes),
        missed_m=float(np.sqrt(np.mean(np.sum(missed**2, axis=1)))),
        believed_m=float(np.sqrt(np.mean(S[:, 0, 0] + S[:, 1, 1]))),
        nees=float(np.mean(_nis(missed, S))) / 2.0,
        evidence=evidence,
    )


def with_gaps(mission: Mission, names: Sequence[str], gap_s: float) -> Mission:
    """The mission with the fixes of some sensors withheld for so long at a time [s]; between, and at the end, some are
    given.

    Raises
    ------
    ValueError
        For a gap too short to tell anything.
    """
    if not gap_s >= LEAST_GAP_S:
        raise ValueError(f"a gap must last {LEAST_GAP_S:g} s at least, found {gap_s:g} s: a shorter one tells nothing.")
    times = np.concatenate([mission.stream(name).time_s for name in names])
    if not len(times):
        return mission
    begin, last = float(times.min()), float(times.max())
    begins = np.arange(begin + GIVEN_S, last, gap_s + GIVEN_S) if math.isfinite(gap_s) else np.array([begin + GIVEN_S])
    hidden = [(float(a), float(np.nextafter(min(a + gap_s, last), -math.inf))) for a in begins]
    hidden = [(a, b) for a, b in hidden if b > a]
    for name in names:
        mission = mission.hide(name, *hidden) if hidden else mission
    return mission


def _frozen(vehicle: Vehicle) -> Vehicle:
    """The vehicle as it is described: nothing is learnt under way."""
    for name in (*vehicle.sensors, *_driven(vehicle)):
        models, _ = models_of(vehicle, name)
        if any(learned_part(model) is not None for model in models):
            vehicle = with_models(vehicle, name, as_described(models))
    return vehicle


def _after_gaps(track: Track, giving: Sequence[str]) -> list[_Fix]:
    """The first fix after each gap: between fixes, or from the start to the first one."""
    fixes, last = [], float(track.time_s[0])
    for time_s, name in _read_fixes(track, giving):
        if time_s - last >= LEAST_GAP_S:
            sensor = track.vehicle.sensors[name]
            blocks = [model.block(1.0 / sensor.rate_hz) for model in sensor.models[:2]]
            variance = np.array([b.variance for b in blocks])
            fixes.append(_Fix(name, time_s, time_s - last, variance))
        last = time_s
    return fixes


def _read_fixes(track: Track, giving: Sequence[str]) -> list[tuple[float, str]]:
    """Times [s] of all fixes that were read, and of which sensor."""
    found: list[tuple[float, str]] = []
    for name in giving:
        if name in track.residuals:
            residuals = track.residuals[name]
            good = np.isfinite(residuals.value[:, :2]).all(axis=1)
            found += [(float(time_s), name) for time_s in residuals.time_s[good]]
    return sorted(found)


def _misses(track: Track, fixes: Sequence[_Fix]) -> tuple[Array, Array]:
    """By how much fixes are missed, north and east (n, 2) [m], and what is believed of it beforehand (n, 2, 2); NaN
    where a run did not come to one.
    """
    missed, S = np.full((len(fixes), 2), np.nan), np.zeros((len(fixes), 2, 2))
    for k, fix in enumerate(fixes):
        residuals = track.residuals[fix.sensor]
        row = int(np.searchsorted(residuals.time_s, fix.time_s - 1e-6))
        before = int(np.searchsorted(track.time_s, fix.time_s - 1e-6)) - 1
        S[k] = np.diag(fix.variance)
        if row < len(residuals.time_s) and abs(residuals.time_s[row] - fix.time_s) < 1e-3 and before >= 0:
            # the row before it: at the fix itself a monitor may have widened the covariance to let it in
            missed[k] = residuals.value[row, :2]
            S[k] += track.covariance[before, :2, :2]
    return missed, S


def _score(missed: Array, S: Array) -> float:
    """ln of the likelihood of fixes, each of which may stray."""
    log = -0.5 * (_nis(missed, S) + np.log(np.linalg.det(S))) - math.log(2.0 * math.pi)
    log = np.where(np.isfinite(log), log, -math.inf)
    floor = math.log(STRAY) - math.log(math.pi * REACH_M**2)
    return float(np.logaddexp(log + math.log1p(-STRAY), floor).sum())


def _nis(missed: Array, S: Array) -> Array:
    return np.asarray(np.einsum("ni,ni->n", missed, np.linalg.solve(S, missed[:, :, None])[:, :, 0]))


def _grid(run: _Run, names: Sequence[str]) -> Array:
    """Scores of all candidates of some sensors at once, shape (quick, slow); one where there is nothing to choose."""
    each = [models_of(run.vehicle, name) for name in names]
    parts = [parts_of(model, period_s) for models, period_s in each for model in models]
    quick = QUICK if any(part.quick or part.white for part in parts) else np.ones(1)
    slow = SLOW if any(part.slow for part in parts) else np.ones(1)
    scores = np.empty((len(quick), len(slow)))
    for i, q in enumerate(quick):
        for j, s in enumerate(slow):
            candidate = run.vehicle
            for name in names:
                candidate = with_factors(candidate, name, float(q), float(s))
            track = replay(candidate, run.mission, output_rate_hz=ROWS_HZ)
            scores[i, j] = _score(*_misses(track, run.fixes))
    return scores


def _digest(vehicle: Vehicle, mission: Mission) -> str:
    """What tells a dive from another, whichever of its fixes are given: what its drive has read."""
    of = 0
    for name in vehicle.driving:
        stream = mission.stream(name)
        of = zlib.crc32(np.ascontiguousarray(stream.value).tobytes(), zlib.crc32(stream.time_s.tobytes(), of))
    return f"{of:08x}"


def _no_gap(mission: Mission, track: Track, giving: Sequence[str]) -> str:
    """Why a dive tells nothing, and what can be done."""
    count = len(_read_fixes(track, giving))
    if not count:
        return (
            f'mission "{mission.name}" has no fix of {", ".join(giving)} that was read: a dive is judged by one at its '
            "end. Give a dive with one, or leave this one out."
        )
    return (
        f'mission "{mission.name}" has no gap with a fix after it: its {count} fixes of {", ".join(giving)} are never '
        f"{LEAST_GAP_S:g} s apart. Withhold some of them: --gap 120 (gap_s=120), --gap inf for all but the first and "
        "the last."
    )


# --- what stays in a file -------------------------------------------------------------------------------------------


def to_table(result: OverDives) -> dict[str, Any]:
    """What is kept of the dives, as `navfilter.io.toml_editing.write_over_dives` takes it."""
    sensors = {
        name: {
            "described": models_of(result.described, name)[0],
            "quick": (known.quick, known.quick_within),
            "slow": (known.slow, known.slow_within),
            "evidence": result.evidence[name],
        }
        for name, known in result.known.items()
    }
    return {"dives": result.counted, "sensors": sensors, "together": result.evidence.get(TOGETHER)}


def from_table(vehicle: Vehicle, table: Mapping[str, Any]) -> OverDives:
    """What earlier dives said, from a file.

    Parameters
    ----------
    vehicle : Vehicle
        Of that file.
    table : dict
        As `navfilter.io.vehicle_toml.read_learnt` gives it.

    Raises
    ------
    ValueError
        When the descriptions are no longer those that were written, or the evidence is of other candidates.
    """
    sensors = table["sensors"]
    described, evidence, known = vehicle, {}, {}
    for name, one in sensors.items():
        if name not in vehicle.sensors and not hasattr(vehicle.drive, name):
            raise ValueError(f'[learnt] is about "{name}", which is no sensor of this vehicle: take that table out.')
        now, period_s = models_of(vehicle, name)
        factors = one["quick"][0], one["slow"][0]
        if len(one["described"]) != len(now) or now != tuple(
            scaled(model, period_s, *factors) for model in one["described"]
        ):
            raise ValueError(
                f'the error of "{name}" is no longer what navfilter learn has written: its evidence is about another '
                "one. Put it back, or take the tables [learnt] out of the file and begin anew."
            )
        described = with_models(described, name, one["described"])
        evidence[name] = np.array(one["evidence"])
        known[name] = Known(*map(float, (*one["quick"], *one["slow"])))
    if len(sensors) > 1:
        evidence[TOGETHER] = np.array(table["together"] if table["together"] is not None else [[]])
    for name, grid in evidence.items():
        if grid.ndim != 2 or grid.shape[0] not in (1, len(QUICK)) or grid.shape[1] not in (1, len(SLOW)):
            raise ValueError(
                f"the evidence about {name} in [learnt] is of other candidates than today's ({len(QUICK)} quick, "
                f"{len(SLOW)} slow). Take the tables [learnt] out and give all dives again."
            )
    return OverDives(vehicle, described, known, evidence, (), tuple((str(a), str(b)) for a, b in table["dives"]))

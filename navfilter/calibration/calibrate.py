"""`calibrate`: the constants of a vehicle from missions, kept only when they predict what they have not seen.

What a calibration is worth: it must predict what it has not seen, stretch by stretch.

Constants by the likelihood of whole missions: Gauss-Newton, each step a run of the filter.
"""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from navfilter.calibration.lights import check_limits, lit
from navfilter.calibration.parts import KINDS, Constant, closed, constants_of, described, kind_of, opened
from navfilter.check.units_text import amount
from navfilter.foundation.arguments import needs, within
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.foundation.display import Shown
from navfilter.foundation.quoting import json_value
from navfilter.models.error_models import White
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors import Position
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import Withheld, at_the_end, replay, score
from navfilter.track.track import Track

#: The constants have settled when a step moves none of them by more than this share of its standard deviation.
SETTLED = 0.1
#: A later step lets them wander by so many of the standard deviations of the step before: around where it is linear.
AROUND = 3.0
#: Steps at most.
ROUNDS = 8
#: A scatter between missions is chance up to this share of what chance does.
BY_CHANCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """Constants of a vehicle after missions.

    Attributes
    ----------
    constants : tuple of Constant
        As described before: the prior.
    value, sd : ndarray, shape (k,)
        As found.
    covariance : ndarray, shape (k, k)
        By their likelihood.
    rounds : int
        Steps that it took.
    settled : bool
        Whether the last step moved none of them by more than `SETTLED`.
    between : ndarray, shape (k,)
        Standard deviations by leaving out a mission at a time (jackknife); zero of one mission, and of a scatter that
        is no more than chance.
    unsettled : ndarray, shape (k,)
        What the second half of the steps moved them by, in quadrature; zero where they have settled.
    """

    constants: tuple[Constant, ...]
    value: Array
    covariance: Array
    rounds: int
    settled: bool
    between: Array
    unsettled: Array

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (k,): of the likelihood, and of what has not settled."""
        return np.sqrt(np.diag(self.covariance) + self.unsettled**2)

    def told(self, untold: float) -> Mask:
        """Which of them the missions have told: less than this share of the prior's sd is left."""
        return self.sd <= untold * np.array([one.sd for one in self.constants])

    def shown(self, untold: float) -> Mask:
        """The same, and of which they say something, although it has not settled."""
        return np.sqrt(np.diag(self.covariance)) <= untold * np.array([one.sd for one in self.constants])


def estimate(
    vehicle: Vehicle,
    missions: Sequence[Mission],
    guess: Array | None = None,
    spread: Array | None = None,
    rounds: int = ROUNDS,
    weight: float = 1.0,
    each: Collection[str] = (),
    report: Callable[[int], None] | None = None,
) -> Estimate:
    """The constants that a vehicle is unsure of, from one or several missions.

    Parameters
    ----------
    vehicle : Vehicle
        Its values and standard deviations of them are the prior.
    missions : sequence of Mission
    guess, spread : ndarray, shape (k,), optional
        Where the first step is linearised, and how far the constants may wander from there; default: the prior.
    rounds : int
        Steps at most.
    weight : float
        Of what the missions say, where their readings scatter more than described.
    each : collection of str
        Kinds, or names, of constants that are others in each mission: states with the prior of the vehicle in each,
        and not estimated together.
    report : callable, optional
        Told before each run how many runs have been done.

    Returns
    -------
    Estimate

    Raises
    ------
    ValueError
        When the vehicle is sure of all its constants, and as `navfilter.replay`.

    Notes
    -----
    A constant state at the end of a forward run is what the smoother gives for the whole run. The run of a mission with
    the constants at ``c``, each with the sd ``s`` of this step, ends with the posterior ``N(x, P)``; what the mission
    itself says is ``J = inv(P) - inv(diag(s^2))`` and ``i = inv(P) x - inv(diag(s^2)) c``. Information of several
    missions adds to that of the prior. The next step is taken around what this one found (Gauss-Newton; Kay, 1993,
    sec. 7.7), with a smaller ``s``, so that the filter stays where it is linear. A step back goes half the way. Where
    they have not settled, the variances are larger by the squares of what the second half of the steps moved: constants
    that ran away by fifteen sds of their prior were believed to a third of one.
    """
    constants = constants_of(vehicle, each)
    if not constants:
        raise ValueError(
            "this vehicle is sure of all its constants: give those in doubt a standard deviation (time_offset_sd_s, "
            "lever_arm_sd_m, scale_sd, misalignment_sd_deg, ..), or name the kinds to open."
        )
    prior, prior_sd = (np.array([getattr(one, key) for one in constants]) for key in ("value", "sd"))
    value = prior if guess is None else guess
    s = prior_sd if spread is None else np.minimum(prior_sd, spread)
    J0 = np.diag(prior_sd**-2)
    done, number, settled, covariance = 0, 0, False, np.diag(prior_sd**2)
    move, moves = np.zeros(len(value)), []
    while number < rounds and not settled:
        number += 1
        J, i = J0.copy(), J0 @ prior
        at, each_said = described(vehicle, _moved(constants, value, s)), []
        for mission in missions:
            if report is not None:
                report(done)
            more = said(at, mission, constants, value, s)
            each_said.append((weight * more[0], weight * more[1]))
            J, i, done = J + each_said[-1][0], i + each_said[-1][1], done + 1
        covariance = _inverse(J)
        before, move = move, covariance @ i - value
        sd = np.sqrt(np.diag(covariance))
        settled = bool(np.all(np.abs(move) < SETTLED * sd))
        if move @ J @ before < 0.0 and not settled:
            move = 0.5 * move  # it goes to and fro about where it will be
        value = value + move
        moves.append(np.abs(move))
        s = np.minimum(prior_sd, AROUND * sd)
    # where a step still leads elsewhere, what it was linear around does not hold for less than that
    last = moves[-max(2, len(moves) // 2) :]
    unsettled = np.zeros(len(value)) if settled else np.sqrt(np.sum(np.square(last), axis=0))
    between = _between(J, i, each_said, np.sqrt(np.diag(covariance)))
    return Estimate(constants, value, covariance, number, settled, between, unsettled)


def _between(J: Array, i: Array, each_said: Sequence[tuple[Array, Array]], sd: Array) -> Array:
    """How the constants scatter between the missions that told them, by what is found without each in turn; 0 where it
    is no more than chance makes of these standard deviations.
    """
    n = len(each_said)
    if n < 2:
        return np.zeros(len(i))
    without = np.array([_inverse(J - of) @ (i - times_value) for of, times_value in each_said])
    variance = (n - 1) / n * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    most = chi_square_limit(BY_CHANCE, n - 1) / (n - 1)
    return np.where(variance > most * sd**2, np.sqrt(variance), 0.0)


def _moved(constants: Sequence[Constant], value: Array, sd: Array) -> list[Constant]:
    return [one._replace(value=float(v), sd=float(s)) for one, v, s in zip(constants, value, sd, strict=True)]


def said(
    vehicle: Vehicle, mission: Mission, constants: Sequence[Constant], value: Array, s: Array
) -> tuple[Array, Array]:
    """Information of one mission on the constants, and that times their value.

    Parameters
    ----------
    vehicle : Vehicle
        That begins with these constants at `value`, with the standard deviations `s`.
    mission : Mission
    constants : sequence of Constant
        All of the vehicle.
    value, s : ndarray, shape (k,)

    Returns
    -------
    information : ndarray, shape (k, k)
    vector : ndarray, shape (k,)
    """
    nav = at_the_end(vehicle, mission)
    layout = nav.filter.layout
    at = np.array([layout.names.index(one.name) for one in constants])
    P = nav.filter.P[np.ix_(9 + at, 9 + at)]
    x = value + nav.filter.x[at] - layout.start_states()[at]
    inverse = _inverse(P)
    J = inverse - np.diag(s**-2)
    i = inverse @ x - value / s**2
    values, vectors = np.linalg.eigh(J * np.outer(s, s))
    if values.min() < 0.0:
        # rounding, or a state that was given up on the way: nothing can be told less than nothing
        positive = (vectors * np.maximum(values, 0.0)) @ vectors.T / np.outer(s, s)
        return positive, i + (positive - J) @ value
    return J, i


def _inverse(P: Array) -> Array:
    """Inverse of a covariance or an information, scaled to a unit diagonal first."""
    d = np.sqrt(np.diag(P))
    inverse = np.linalg.inv(P / np.outer(d, d)) / np.outer(d, d)
    return 0.5 * (inverse + inverse.T)


Interval = tuple[float, float]
#: The stretches of a mission are dealt out to so many parts; each is withheld once.
FOLDS = 4
#: A stretch is so long [s]: with fixes, and without any, when all sensors are withheld.
FIXES_S, ALL_S = 60.0, 30.0
#: At least so many stretches are cut.
LEAST = 2 * FOLDS
#: Fixes farther apart than this lie in different spells [s].
SPELL_S = 10.0
#: What one reading may cost at most: an outlier tells nothing of the constants.
MOST_NIS = 30.0


@dataclass(frozen=True)
class Stretches:
    """What is withheld of a mission, part by part.

    Attributes
    ----------
    sensors : tuple of str
        Whose readings are withheld: those that give fixes, or without fixes all that correct.
    fixes : bool
    parts : tuple of tuples of (float, float)
        Intervals on the mission clock [s] of each part.
    """

    sensors: tuple[str, ...]
    fixes: bool
    parts: tuple[tuple[Interval, ...], ...]

    def without(self, mission: Mission, part: int) -> Mission:
        """The mission without what this part withholds."""
        for name in self.sensors:
            mission = mission.hide(name, *self.parts[part])
        return mission


@dataclass(frozen=True)
class Prediction:
    """How well readings that were withheld are predicted.

    Attributes
    ----------
    count : int
        Readings.
    rms_m : float
        Horizontal error at the fixes; NaN without fixes.
    sd_m : float
        The same as predicted.
    inside : float
        Share of the fixes inside the 95 % ellipse; NaN without fixes.
    cost : float
        Minus the mean log-likelihood of a reading, up to a constant. Of fixes, each as those before it predict it.
    """

    count: int
    rms_m: float
    sd_m: float
    inside: float
    cost: float

    @property
    def loss(self) -> float:
        """What is compared: the cost, or the error at fixes where none was worked out."""
        return self.rms_m if math.isnan(self.cost) else self.cost


def stretches_of(vehicle: Vehicle, mission: Mission) -> Stretches:
    """Cut a mission into stretches, and deal them out; what it begins with is never withheld.

    Raises
    ------
    ValueError
        When it is too short to be cut.
    """
    correcting = [
        name for name, sensor in vehicle.sensors.items() if not sensor.from_drive and len(mission.stream(name))
    ]
    fixes = tuple(name for name in correcting if vehicle.sensors[name].gives == "position")
    names = fixes or tuple(correcting)
    time_s = np.unique(np.concatenate([np.empty(0), *(_valid_times(mission, name) for name in names)]))
    if len(time_s) < 2 * LEAST:
        raise ValueError(
            f'mission "{mission.name}" holds {len(time_s)} readings of {", ".join(names) or "no correcting sensor"}: '
            "too few to calibrate by, and to see what that is worth."
        )
    steps = np.diff(time_s)
    length = min(FIXES_S if fixes else ALL_S, float(steps[steps < SPELL_S].sum()) / LEAST)
    number = np.unique(np.floor((time_s - time_s[0]) / max(length, 1e-3)))[1:]
    begins = time_s[0] + number * length
    parts = tuple(
        tuple((float(begin), float(np.nextafter(begin + length, -math.inf))) for begin in begins[k::FOLDS])
        for k in range(FOLDS)
    )
    return Stretches(names, bool(fixes), parts)


def _valid_times(mission: Mission, name: str) -> Array:
    stream = mission.stream(name)
    return stream.time_s[np.isfinite(stream.value).any(axis=1)]


def predicted(
    vehicle: Vehicle, mission: Mission, stretches: Stretches, part: int, whole: Track | None = None
) -> Prediction | None:
    """How a vehicle predicts what one part withholds; None where nothing of it can be compared.

    Parameters
    ----------
    vehicle : Vehicle
        With constants that were found without this part.
    mission : Mission
    stretches : Stretches
    part : int
    whole : Track, optional
        Of the vehicle by all of the mission; default: it is run.

    Notes
    -----
    Compared is the likelihood of the readings of the part in a run that is given them, each as those before it predict
    it: the product is that of all of them together (prediction error decomposition; Harvey, 1989, sec. 3.4). The error
    at fixes that a run is not given is what their own errors make of it, which last as long as a stretch: constants
    that erred by a third were refused as often as they were kept.
    """
    whole = whole or replay(vehicle, mission, output_rate_hz=1.0)
    of_all = _by_innovations(whole, stretches, part)
    if not stretches.fixes or of_all is None:
        return of_all
    fixes = _at_fixes(replay(vehicle, stretches.without(mission, part)), mission, stretches, part)
    return None if fixes is None else replace(fixes, cost=of_all.cost * of_all.count / fixes.count)


def _at_fixes(track: Track, mission: Mission, stretches: Stretches, part: int) -> Prediction | None:
    found = []
    for name in stretches.sensors:
        stream = mission.stream(name)
        scored = score(track, Withheld(name, stream.keep(within(stream.time_s, stretches.parts[part]))))
        if scored is not None:
            found.append(Prediction(scored.count, scored.rms_m, scored.sd_m, scored.inside, math.nan))
    return together(found)


def _by_innovations(track: Track, stretches: Stretches, part: int) -> Prediction | None:
    cost, count = 0.0, 0
    for name in stretches.sensors:
        r = track.residuals[name]
        rows = within(r.time_s, stretches.parts[part]) & np.isfinite(r.nis) & (r.dof > 0)
        spread = np.log(np.where(np.isfinite(r.sd[rows]), np.maximum(r.sd[rows], 1e-12), 1.0)).sum()
        cost += float(0.5 * np.minimum(r.nis[rows], MOST_NIS).sum() + spread)
        count += int(rows.sum())
    return Prediction(count, math.nan, math.nan, math.nan, cost / count) if count else None


def together(found: Sequence[Prediction]) -> Prediction | None:
    """Several predictions as one."""
    if not found:
        return None
    weight = np.array([one.count for one in found], dtype=float)
    square, sd, inside, cost = (
        float(np.average(values, weights=weight))
        for values in zip(*((one.rms_m**2, one.sd_m**2, one.inside, one.cost) for one in found), strict=True)
    )
    return Prediction(int(weight.sum()), math.sqrt(square), math.sqrt(sd), inside, cost)


#: A mission that leaves more of the prior's sd than this share has not told a constant.
UNTOLD = 0.8
#: Rounds of an estimate that begins at that from everything.
FEW = 3
#: The parts scatter more than the likelihood says by so much in variance: the missions are given less weight.
TOO_MUCH = 3.0
#: At least this share of the parts must be predicted no worse: not less likely by more than this, in ln of the
#: likelihood [1]. Constants that are no different do that by chance.
MOST, CHANCE = 0.75, 2.0
#: Farther from its prior than so many of its sds is hardly a constant: one in 370 would be. What the description has no
#: state for may look like one; it is kept only where the constants predict better with it than without.
FAR = 3.0
REFERENCE = "reference"
#: Units in which constants are shown: name and size in SI.
_SHOWN = {"rad": ("deg", math.pi / 180.0), "1": ("%", 1e-2)}
_WIDTH = 30


@dataclass(frozen=True)
class Found:
    """What became of one constant.

    Attributes
    ----------
    name, unit : str
        Of its state.
    part : tuple of str
        Its table in vehicle.toml.
    before, before_sd : float
        As described.
    value, sd : float
        As found; the sd is the larger of that of the likelihood and that of the scatter between the parts.
    scatter : float
        By leaving out a part, or a mission, at a time (jackknife).
    told : bool
        Whether the missions say anything of it.
    believed : bool
        Not where it left its prior, and what was withheld was predicted better without it.
    """

    name: str
    unit: str
    part: tuple[str, ...]
    before: float
    before_sd: float
    value: float
    sd: float
    scatter: float
    told: bool
    believed: bool = True


@dataclass(frozen=True, repr=False)
class Calibration(Shown):
    """Result of `calibrate`.

    Attributes
    ----------
    found : tuple of Found
    vehicle : Vehicle
        With the constants found; as it was before where they are not kept.
    kept : bool
        Whether the constants found are kept: they predict better what was withheld.
    before, after : Prediction or None
        Of what was withheld, by the vehicle as it was and with the constants found without it.
    factor : float
        Variance of the constants by the scatter of the parts over that of the likelihood; 1 is honest.
    settled : bool
    rounds : int
    constants : tuple of Constant
        With the values and sds found, as they go into a file.
    """

    found: tuple[Found, ...]
    vehicle: Vehicle
    kept: bool
    before: Prediction | None
    after: Prediction | None
    factor: float
    settled: bool
    rounds: int
    constants: tuple[Constant, ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        rows: dict[str, object] = {}
        for one in self.found:
            as_found = f"{one.value:.4g} +- {one.sd:.2g} {one.unit}" if one.told else "not told"
            doubt = "" if one.believed else ", not believed"
            rows[one.name] = f"{one.before:.4g} +- {one.before_sd:.2g} -> {as_found}{doubt}"
        return f"Calibration of {self.vehicle.name}, {'kept' if self.kept else 'not kept'}: {self.why}", rows

    @property
    def why(self) -> str:
        """Why they are kept, or not."""
        if not any(one.told for one in self.found):
            return "these missions tell none of the constants"
        if self.before is None or self.after is None:
            return "nothing that was withheld could be compared"
        what = "the withheld fixes are" if not math.isnan(self.after.rms_m) else "withheld readings are"
        return f"{what} predicted {'better' if self.kept else 'no better'} than before"


def with_reference(vehicle: Vehicle, mission: Mission, sd_m: float) -> tuple[Vehicle, Mission]:
    """The truth of a mission as fixes.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
    sd_m : float
        Standard deviation of each of its components [m].

    Raises
    ------
    ValueError
        When the mission has no truth.
    """
    if mission.truth is None:
        raise ValueError(f'mission "{mission.name}" has no truth: describe it in mission.toml, or calibrate by fixes.')
    known = np.isfinite(mission.truth.value[:, :2]).all(axis=1)
    time_s = mission.truth.time_s[known]
    rows = np.flatnonzero(known)[np.unique(np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], 1.0)))]
    stream = Stream(mission.truth.time_s[rows], mission.truth.value[rows, :3], mission.truth.columns[:3])
    sensors = {**vehicle.sensors, REFERENCE: Position(rate_hz=1.0, error=White(sd=sd_m))}
    return Vehicle(vehicle.drive, sensors, vehicle.name), mission.with_stream(REFERENCE, stream)


def calibrate(
    vehicle: Vehicle,
    missions: Sequence[Mission],
    *,
    kinds: Sequence[str] | None = None,
    each: Collection[str] = (),
    report: Callable[[str], None] | None = None,
) -> Calibration:
    """Estimate the constants that a vehicle is unsure of, from one or several missions, and test what they are worth.

    Parameters
    ----------
    vehicle : Vehicle
        Its values and standard deviations are the prior.
    missions : sequence of Mission
        Of the same vehicle, with the same sensors and constants.
    kinds : sequence of str, optional
        Kinds of constants (`navfilter.calibration.parts.KINDS`) to open where the vehicle says nothing of them.
        Default: none where it is unsure of any constant, else all.
    each : collection of str
        Kinds, or names of constants, that are others in each mission, such as clocks that are set by hand. They are
        estimated in each run, and stay as described.
    report : callable, optional
        Told before each run what is done.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        For no mission, one that is given twice, an unknown kind, nothing to calibrate, a mission too short, and as
        `navfilter.replay`.

    Notes
    -----
    Each mission is cut into stretches of up to a minute, and these are dealt out to four parts. The constants are
    estimated from everything, and four times without the fixes of one part (without any fixes: without all readings of
    it), which are then predicted by the filter, with the vehicle as it was and with those constants. The scatter of
    the four estimates, and of those without each mission where there are several and it is more than chance, bounds the
    standard deviations from below (jackknife; Efron, 1982); where it is far more than the
    likelihood says, all that the missions say counts less by that factor (the variance of unit weight of geodesy), and
    the prior more.

    Where some of the constants have left their prior, it is tried once more with those as described, and sure, and what
    predicts better is taken: a rotation of wheels about the way they roll, say, is told only by how a car leans.
    """
    missions = [missions] if isinstance(missions, Mission) else missions
    needs("calibrate: vehicle", vehicle, Vehicle)
    if not missions:
        raise ValueError("calibrate needs at least one mission.")
    for mission in missions:
        needs("calibrate: missions", mission, Mission)
    if kinds is None:
        kinds = () if constants_of(vehicle) else tuple(KINDS)
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ValueError(f'no kind of constants is called "{unknown[0]}"; known: {", ".join(KINDS)}.')
    wide = opened(vehicle, kinds, missions)
    _check(missions, each, wide)
    tell = report or (lambda text: None)
    asked = _Asked(vehicle, missions, [stretches_of(vehicle, mission) for mission in missions], each, tell)
    result = asked.calibrated(wide)
    far = [one for one in result.found if one.told and abs(one.value - one.before) > FAR * one.before_sd]
    if not far:
        return result
    tell(f"again, with {', '.join(one.name for one in far)} as described")
    names = [one.name for one in far]
    sure = described(wide, [one._replace(sd=0.0) for one in constants_of(wide, each) if one.name in names])
    if not constants_of(sure, each):
        return result
    other = asked.calibrated(sure)
    if not other.kept or (result.kept and _loss(other) > _loss(result)):
        return result
    order = {one.name: i for i, one in enumerate(result.found)}
    found = [*other.found, *(replace(one, believed=False) for one in far)]
    return replace(other, found=tuple(sorted(found, key=lambda one: order[one.name])))


def _check(missions: Sequence[Mission], each: Collection[str], wide: Vehicle) -> None:
    """Refuse what would be counted twice, and names that mean nothing."""
    for k, mission in enumerate(missions):
        for other in missions[:k]:
            if _same(mission, other):
                raise ValueError(
                    f'missions "{other.name}" and "{mission.name}" hold the same readings: given twice, they would be '
                    "believed twice. Give each mission once."
                )
    constants = constants_of(wide)
    known = {*KINDS, *(name for one in constants for name in (one.name, kind_of(one.own)))}
    for name in each:
        if name and name not in known:
            raise ValueError(
                f'no kind and no constant in doubt is called "{name}"; kinds: {", ".join(KINDS)}; constants in doubt: '
                f"{', '.join(one.name for one in constants) or 'none'}."
            )
    if constants and not constants_of(wide, each):
        raise ValueError("all constants in doubt are others in each mission: that leaves none to calibrate.")


def _same(mission: Mission, other: Mission) -> bool:
    """Whether two missions hold the same readings of any sensor, at the same times."""
    return any(
        len(stream) > 1
        and np.array_equal(stream.time_s, other.streams[name].time_s)
        and np.array_equal(stream.value, other.streams[name].value, equal_nan=True)
        and np.ptp(np.nan_to_num(stream.value), axis=0).any()
        for name, stream in mission.streams.items()
        if name in other.streams
    )


def _loss(result: Calibration) -> float:
    """The error at withheld fixes, which a constant that is none makes larger; without fixes the cost."""
    if result.after is None:
        return math.inf
    return result.after.cost if math.isnan(result.after.rms_m) else result.after.rms_m


@dataclass(frozen=True)
class _Folds:
    """The parts, each withheld once: scatter of the constants, and predictions by what they were and are."""

    scatter: Array
    before: tuple[Prediction, ...] = ()
    after: tuple[Prediction, ...] = ()

    @property
    def better(self) -> bool:
        """Whether the new constants predict better altogether, and most of the parts no worse."""
        pairs = zip(self.after, self.before, strict=True)
        gained = [other.loss * other.count - one.loss * one.count for one, other in pairs]
        parts = sum(gain > -CHANCE for gain in gained)
        return sum(gained) > 0.0 and parts >= MOST * len(gained)


@dataclass(frozen=True)
class _Asked:
    """What `calibrate` was asked: the vehicle as it was, missions and how they are cut, constants that are others in
    each, and who is told what is done.
    """

    vehicle: Vehicle
    missions: Sequence[Mission]
    cut: Sequence[Stretches]
    each: Collection[str]
    tell: Callable[[str], None]

    def calibrated(self, wide: Vehicle) -> Calibration:
        """Estimate and test the constants that `wide` is unsure of."""
        whole, first, wide = self._whole(wide)
        told = whole.told(UNTOLD)
        if not told.any():
            return _result(self.vehicle, wide, whole, first, _Folds(np.zeros(len(told))), 1.0)
        folds = self._folds(wide, whole, 1.0)
        factor = float(np.mean((folds.scatter / whole.sd)[told] ** 2))
        if factor > TOO_MUCH:
            self.tell("again, with less weight")
            again = self._again(wide, self.missions, whole, 1.0 / factor)
            whole = _no_surer(again, whole, range(len(whole.value)))
            folds = self._folds(wide, whole, 1.0 / factor)
        return _result(self.vehicle, wide, whole, first, folds, factor)

    def _again(self, wide: Vehicle, missions: Sequence[Mission], whole: Estimate, weight: float) -> Estimate:
        """An estimate that begins at that from everything."""
        return estimate(wide, missions, whole.value, 2.0 * AROUND * whole.sd, FEW, weight, self.each)

    def _folds(self, wide: Vehicle, whole: Estimate, weight: float) -> _Folds:
        values: list[Array] = []
        whole_runs = [replay(self.vehicle, mission, output_rate_hz=1.0) for mission in self.missions]
        before: list[Prediction] = []
        after: list[Prediction] = []
        for part in range(FOLDS):
            self.tell(f"without part {part + 1} of {FOLDS}")
            rest = [s.without(mission, part) for s, mission in zip(self.cut, self.missions, strict=True)]
            fold = self._again(wide, rest, whole, weight)
            values.append(fold.value)
            of_fold = described(wide, _written(fold.constants, fold.value, fold.sd, whole.told(UNTOLD)))
            pairs = [
                [predicted(self.vehicle, mission, s, part, run), predicted(of_fold, mission, s, part)]
                for mission, s, run in zip(self.missions, self.cut, whole_runs, strict=True)
            ]
            for all_of, found in zip((before, after), zip(*pairs, strict=True), strict=True):
                one = together([prediction for prediction in found if prediction is not None])
                if one is not None:
                    all_of.append(one)
        scatter = np.sqrt((FOLDS - 1) / FOLDS * np.sum((np.array(values) - np.mean(values, axis=0)) ** 2, axis=0))
        scatter = np.maximum(scatter, whole.between)
        return _Folds(scatter, tuple(before), tuple(after)) if len(before) == len(after) else _Folds(scatter)

    def _whole(self, wide: Vehicle) -> tuple[Estimate, Estimate, Vehicle]:
        """The estimate from everything, without the constants that were opened in vain; the one with them; the
        vehicle.
        """
        count, tell = len(self.missions), self.tell
        first = estimate(
            wide, self.missions, each=self.each, report=lambda run: tell(f"all of it, step {run // count + 1}")
        )
        shown = zip(first.constants, first.shown(UNTOLD), strict=True)
        narrow = closed(wide, self.vehicle, [one for one, is_shown in shown if not is_shown])
        left = [one.name for one in constants_of(narrow, self.each)]
        if len(left) == len(first.constants) or not left:
            return first, first, wide
        rows = [i for i, one in enumerate(first.constants) if one.name in left]
        tell("again, without what these missions do not tell")
        whole = estimate(narrow, self.missions, first.value[rows], AROUND * first.sd[rows], each=self.each)
        return _no_surer(whole, first, rows), first, narrow


def _no_surer(whole: Estimate, first: Estimate, rows: Sequence[int]) -> Estimate:
    """An estimate beside constants that were closed again: these are what they were described as only as far as anybody
    knows, and what that does to the others was in their variances as long as all were open.
    """
    wider = np.maximum(np.sqrt(np.diag(first.covariance)[rows] / np.diag(whole.covariance)), 1.0)
    return replace(whole, covariance=whole.covariance * np.outer(wider, wider))


def _written(constants: Sequence[Constant], value: Array, sd: Array, told: Mask) -> tuple[Constant, ...]:
    """Constants as they go into a file: those that are not told stay as described."""
    rows = zip(constants, value, sd, told, strict=True)
    return tuple(one._replace(value=float(v), sd=min(float(s), one.sd)) if t else one for one, v, s, t in rows)


def _result(
    vehicle: Vehicle, wide: Vehicle, whole: Estimate, first: Estimate, folds: _Folds, factor: float
) -> Calibration:
    scatter, told = folds.scatter, whole.told(UNTOLD)
    sd = np.where(told, np.minimum(np.maximum(whole.sd, scatter), [one.sd for one in whole.constants]), whole.sd)
    found = _listed(whole, sd, scatter, told)
    for name, one in _listed(first, first.sd, np.zeros(len(first.sd)), np.zeros(len(first.sd), bool)).items():
        found.setdefault(name, one)
    constants = _written(whole.constants, whole.value, sd, told)
    kept = bool(told.any()) and folds.better
    new = described(wide, constants) if kept else vehicle
    order = {one.name: i for i, one in enumerate(first.constants)}
    listed = tuple(sorted(found.values(), key=lambda one: order[one.name]))
    predictions = together(folds.before), together(folds.after)
    return Calibration(listed, new, kept, *predictions, factor, whole.settled, whole.rounds, constants)


def _listed(of: Estimate, sd: Array, scatter: Array, told: Mask) -> dict[str, Found]:
    rows = zip(of.constants, of.value.tolist(), sd.tolist(), scatter.tolist(), told.tolist(), strict=True)
    return {one.name: Found(one.name, one.unit, one.part, one.value, one.sd, *numbers) for one, *numbers in rows}


def to_dict(result: Calibration) -> dict[str, Any]:
    """The same as plain values, for a JSON file."""

    before, after = (one and json_value(asdict(one)) for one in (result.before, result.after))
    return {
        "kept": result.kept,
        "why": result.why,
        "settled": result.settled,
        "rounds": result.rounds,
        "variance_factor": result.factor,
        "before": before,
        "after": after,
        "constants": [asdict(one) | {"part": ".".join(one.part)} for one in result.found],
    }


# --- in words --------------------------------------------------------------------------------------------------------


def calibration_text(result: Calibration, limits: Sequence[tuple[str, float, str]] = ()) -> str:
    """The table of a calibration, what it is worth, and remarks.

    Parameters
    ----------
    result : Calibration
    limits : sequence of (str, float, str)
        Of the sds that may be left, see `navfilter.calibration.lights.limit_of`.

    Raises
    ------
    ValueError
        For a limit that fits no constant, or has another dimension.
    """
    described = [
        Constant(f.name, f.part, f.name.rpartition(".")[2], f.unit, f.before, f.before_sd, False) for f in result.found
    ]
    check_limits(limits, described)
    lights = [lit(one, f.value, f.sd, limits).colour for one, f in zip(described, result.found, strict=True)]
    lines = [f"{'constant':{_WIDTH}} {'described':>20}  {'found':>20}  {'light':>7}"]
    lines += [_row(one, light) for one, light in zip(result.found, lights, strict=True)]
    lines += ["", *_worth(result)]
    return "\n".join([*lines, *_remarks(result)])


def _row(one: Found, light: str) -> str:
    unit, size = _SHOWN.get(one.unit, (one.unit.replace("_per_", "/").replace("_", "/"), 1.0))
    digits = max(3, 2 - math.floor(math.log10(one.before_sd / size)))  # a field may be in tesla
    both = (one.before, one.before_sd), (one.value, one.sd)
    before, found = (f"{v / size:.{digits}f} +- {sd / size:.{digits}f}" for v, sd in both)
    label = f"{one.name} [{unit}]"
    if not one.told:
        return f"{label:{_WIDTH}} {before:>20}  {'not told':>20}  {light:>7}"
    away = abs(one.value - one.before) / one.before_sd
    if not one.believed:
        return f"{label:{_WIDTH}} {before:>20}  {'not believed':>20}  {light:>7}  {away:.1f} sd off"
    return f"{label:{_WIDTH}} {before:>20}  {found:>20}  {light:>7}" + (f"  {away:.1f} sd off" if away > 2.5 else "")


def _worth(result: Calibration) -> Iterator[str]:
    if result.before is not None and result.after is not None:
        for name, one in (("described", result.before), ("found", result.after)):
            yield f"withheld, by the constants as {name}: {_predicted(one)}"
        if not math.isnan(result.after.rms_m) and not math.isnan(result.after.cost):
            gain = result.before.cost * result.before.count - result.after.cost * result.after.count
            yield f"ln of the likelihood of these fixes, each by those before it: {gain:+.1f} by the constants found"
    yield f"{'Kept' if result.kept else 'Not kept'}: {result.why}."


def _predicted(one: Prediction) -> str:
    if math.isnan(one.rms_m):
        return f"cost {one.cost:.4f} a reading, of {one.count} (minus the mean log-likelihood)"
    return (
        f"rms {amount(one.rms_m, 'm')} at {one.count} fixes, predicted {amount(one.sd_m, 'm')}; "
        f"{100.0 * one.inside:.0f} % inside the 95 % ellipse"
    )


def _remarks(result: Calibration) -> Iterator[str]:
    untold = [one.name for one in result.found if not one.told]
    if untold:
        yield f"Not told, more than 80 % of its sd is left: {', '.join(untold)}. These stay as described."
    doubtful = [one for one in result.found if not one.believed]
    if doubtful:
        each = ", ".join(f"{one.name} ({amount(one.value, one.unit)})" for one in doubtful)
        yield (
            f"Not believed: {each}. It is far from what is described, and without it what was withheld is predicted "
            "better: something that vehicle.toml has no state for looks like it. It stays as described, and sure."
        )
    if result.factor > TOO_MUCH:
        yield (
            f"The parts of the missions scatter {math.sqrt(result.factor):.1f} times as much as their likelihood says: "
            "they count less by that. An error model of vehicle.toml is too small, or a constant changes."
        )
    wide = [one.name for one in result.found if one.told and one.believed and one.scatter >= one.sd * 0.999]
    if wide:
        yield (
            f"The parts of the missions scatter more than their likelihood says in {', '.join(wide)}: the sd is that "
            "of the scatter. Is an error model too small, or does a constant change?"
        )
    if not result.settled:
        yield (
            f"The constants had not settled after {result.rounds} steps: their sds hold what the last ones moved them "
            "by. Start from a better description."
        )
    if result.kept and result.after is not None and result.after.inside < 0.8:
        yield "The withheld fixes lie outside the ellipse too often: an error model is too small."
    wheels = [one for one in result.found if one.told and one.believed and one.name.endswith(".scale") and result.kept]
    if wheels:
        factors = ", ".join(f"{one.name} {1.0 / (1.0 + one.value):.5f}" for one in wheels)
        yield f"Of a velocity that comes from wheels, the true radius is the described one times: {factors}."
